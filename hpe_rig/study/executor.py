"""Executors of `concurrent.futures`: a few batches ahead; the batch of a lost worker is computed again."""

from __future__ import annotations

import importlib
import logging
import multiprocessing
import os
import signal
import sys
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, ProcessPoolExecutor, wait
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from hpe_rig.scene import Mistake, SettingsError

Task = TypeVar("Task")
Result = TypeVar("Result")
OpenPool = Callable[[], AbstractContextManager[Executor]]

MAX_LOSSES = 5
"""Consecutive losses of a worker, without a completed task between them, that end a study."""
WORKER_TIMEOUT_S = 10.0
"""Time that a scheduler may have no worker, such as right after the start of a cluster."""
_THREAD_COUNTS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
_LOCAL_WORKERS = {
    # The sampling profiler of dask takes a quarter of a worker's time.
    "distributed.worker.profile.enabled": False,
    # Dask's threshold returns every freed array to the system, which clears its pages again for the next one.
    "distributed.nanny.pre-spawn-environ": {"MALLOC_TRIM_THRESHOLD_": 2**30, "MALLOC_MMAP_THRESHOLD_": 2**25}
    | dict.fromkeys(_THREAD_COUNTS, 1),
}
"""Settings of dask for workers on this machine."""


def completed(
    open_pool: OpenPool, run: Callable[[Task], Result], tasks: Sequence[Task], ahead: int
) -> Generator[Result, None, None]:
    """Yield the result of every task on completion, in any order, with at most ``ahead`` tasks submitted at once.

    After the death of a worker the pool is opened again and its pending tasks are repeated. Raises ``SettingsError``
    after ``MAX_LOSSES`` deaths, and any exception of ``run``. Closing the generator cancels the pending tasks.
    """
    # Few tasks are submitted ahead, so that a broken pool loses little.
    waiting = deque(tasks)
    losses = 0
    while waiting:
        with open_pool() as pool:
            running: dict[Future[Result], Task] = {}
            try:
                while waiting or running:
                    while waiting and len(running) < ahead:
                        running[pool.submit(run, waiting[0])] = waiting[0]
                        waiting.popleft()
                    for future in wait(running, return_when=FIRST_COMPLETED).done:
                        yield future.result()
                        del running[future]
                        losses = 0
            except Exception as error:
                if not _is_worker_death(error):
                    raise
                losses += 1
                waiting.extendleft(running.values())
                if losses >= MAX_LOSSES:
                    what = f"workers died {losses} times in succession ({type(error).__name__})"
                    remedy = "fewer workers, or fewer realisations if memory is short; completed cases are stored"
                    raise SettingsError("study", [Mistake("", what, remedy)]) from None
            finally:
                for future in running:
                    future.cancel()


def _is_worker_death(error: Exception) -> bool:
    """Return whether a worker died; dask's errors are compared by name, since dask may not be imported."""
    return isinstance(error, BrokenExecutor) or type(error).__name__ in ("KilledWorker", "CommClosedError")


@contextmanager
def processes(workers: int) -> Iterator[Executor]:
    """Open ``workers`` processes of one thread each; an exception terminates them at once."""
    before = {name: os.environ.get(name) for name in _THREAD_COUNTS}
    os.environ.update(dict.fromkeys(_THREAD_COUNTS, "1"))
    other_children = multiprocessing.active_children()
    # "spawn" on every system: a fork would copy the locks of the progress display's thread.
    context = multiprocessing.get_context("spawn")
    # Only this process handles Ctrl-C.
    pool = ProcessPoolExecutor(workers, context, signal.signal, (signal.SIGINT, signal.SIG_IGN))
    try:
        with _interrupts_blocked():
            for _ in range(workers):
                pool.submit(os.getpid)
        yield pool
    except BaseException:
        for child in multiprocessing.active_children():
            if child not in other_children:
                child.terminate()
        raise
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
        for name, value in before.items():
            os.environ.pop(name)
            if value is not None:
                os.environ[name] = value


@contextmanager
def _interrupts_blocked() -> Iterator[None]:
    """Block Ctrl-C while processes start. They inherit the mask, so that none is interrupted during its imports."""
    if sys.platform == "win32":
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@dataclass(frozen=True, slots=True)
class TlsFiles:
    """PEM files for the authentication of client and scheduler: authority, client certificate, client key."""

    ca: Path | None = None
    cert: Path | None = None
    key: Path | None = None

    def mistakes(self) -> list[Mistake]:
        """Return the missing files; all or none are needed."""
        options = {"--tls-ca": self.ca, "--tls-cert": self.cert, "--tls-key": self.key}
        if not any(options.values()):
            return []
        remedy = "the three PEM files that the scheduler was started with, or none of the options"
        return [
            Mistake(option, "is not given" if path is None else f"{path} is no file", remedy)
            for option, path in options.items()
            if path is None or not path.is_file()
        ]


NO_TLS = TlsFiles()


def untrusted_network(address: str) -> str:
    """Return the warning for a scheduler that is reached without TLS; empty if the connection is safe."""
    host = address.partition("://")[2].rpartition(":")[0].strip("[]")
    if address == "local" or address.startswith("tls://") or host in ("localhost", "127.0.0.1", "::1"):
        return ""
    return (
        f"{address} is reached without TLS: anyone on that network can read the cases and run code on the workers and "
        "on this machine. Use it in trusted networks only, else tls://HOST:8786 with --tls-ca, --tls-cert and --tls-key"
    )


@contextmanager
def cluster(address: str, workers: int, tls: TlsFiles = NO_TLS) -> Iterator[Executor]:
    """Open the dask cluster at ``address``; for "local" start one of ``workers`` processes on this machine.

    ``tls`` authenticates client and scheduler and refuses an unencrypted connection; without it dask's configuration
    applies. Raises ``SettingsError`` if nothing answers or files are missing.
    """
    # By name: type checking and imports then work without the package.
    distributed: Any = importlib.import_module("distributed")
    if mistakes := tls.mistakes():
        raise SettingsError("command line", mistakes)

    level = _set_log_level()
    if address == "local":
        with (
            importlib.import_module("dask.config").set(_LOCAL_WORKERS),
            distributed.LocalCluster(
                n_workers=workers, threads_per_worker=1, silence_logs=level, dashboard_address=None
            ) as local,
            distributed.Client(local) as client,
        ):
            yield client.get_executor(pure=False, retries=MAX_LOSSES)
        return
    security = None
    if tls != NO_TLS:
        files = {"tls_ca_file": str(tls.ca), "tls_client_cert": str(tls.cert), "tls_client_key": str(tls.key)}
        security = distributed.Security(**files, require_encryption=True)
    try:
        client = distributed.Client(address, timeout="10s", security=security)
    except (OSError, ValueError, TypeError, RuntimeError) as error:
        remedy = "tcp://HOST:8786, tls://HOST:8786 with the files of its certificates, or local"
        mistake = Mistake("--scheduler", f"{address} does not answer ({error})", remedy)
        raise SettingsError("command line", [mistake]) from None
    with client:
        _require_worker(client, address)
        yield client.get_executor(pure=False, retries=MAX_LOSSES)


def _set_log_level() -> int:
    """Silence dask's loggers unless this package logs details; return the level.

    Its processes log every interrupt at length, and all of them receive it. The import of dask sets their levels.
    """
    if logging.getLogger("hpe_rig").isEnabledFor(logging.INFO):
        return logging.INFO
    names = [name for name in logging.Logger.manager.loggerDict if name.split(".")[0] in ("distributed", "tornado")]
    for name in names:
        logging.getLogger(name).setLevel(logging.CRITICAL)
    return logging.CRITICAL


def _require_worker(client: Any, address: str) -> None:
    """Raise ``SettingsError`` if the scheduler has no worker within ``WORKER_TIMEOUT_S``: no case would start."""
    try:
        client.wait_for_workers(1, timeout=WORKER_TIMEOUT_S)
    except TimeoutError:
        what = f"{address} has no workers, so that no case would ever start"
        raise SettingsError("command line", [Mistake("--scheduler", what, f"dask worker {address}, first")]) from None
