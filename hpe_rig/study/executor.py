"""Executors of `concurrent.futures`: a few batches ahead, and the batch of a lost worker computed again."""

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

Piece = TypeVar("Piece")
Result = TypeVar("Result")
OpenPool = Callable[[], AbstractContextManager[Executor]]

MOST_LOSSES = 5
"""Losses of a worker in a row, without a piece finished between, that end a study."""
WORKER_S = 10.0
"""How long a scheduler may have no worker, such as right after a cluster has started."""
_ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def completed(
    open_pool: OpenPool, run: Callable[[Piece], Result], pieces: Sequence[Piece], ahead: int
) -> Generator[Result, None, None]:
    """Yield the result of every piece as it is done, in any order, with at most ``ahead`` handed out at once.

    Where a worker dies the pool is opened anew and what it had not finished is done again. Raises ``SettingsError``
    when that does not help, and whatever ``run`` raises. On leaving early what is not begun is cancelled.
    """
    waiting = deque(pieces)
    losses = 0
    while waiting:
        with open_pool() as pool:
            running: dict[Future[Result], Piece] = {}
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
                if not _lost(error):
                    raise
                losses += 1
                waiting.extendleft(running.values())
                if losses >= MOST_LOSSES:
                    what = f"workers died {losses} times in a row ({type(error).__name__}), so something kills them"
                    remedy = "fewer workers or fewer realisations where memory is short; finished cases are kept"
                    raise SettingsError("study", [Mistake("", what, remedy)]) from None
            finally:
                for future in running:
                    future.cancel()


def _lost(error: Exception) -> bool:
    """Return whether a worker died rather than its work failed; by name, for dask is not imported where not used."""
    return isinstance(error, BrokenExecutor) or type(error).__name__ in ("KilledWorker", "CommClosedError")


@contextmanager
def processes(workers: int) -> Iterator[Executor]:
    """Open ``workers`` processes of one thread each; on an exception they are ended at once, whatever they do."""
    before = {name: os.environ.get(name) for name in _ONE_THREAD}
    os.environ.update(dict.fromkeys(_ONE_THREAD, "1"))
    others = multiprocessing.active_children()
    # Started anew on every system alike: a fork would copy the locks of the progress display's thread.
    context = multiprocessing.get_context("spawn")
    # Ctrl-C is left to this process.
    pool = ProcessPoolExecutor(workers, context, signal.signal, (signal.SIGINT, signal.SIG_IGN))
    try:
        with _interrupts_held():
            for _ in range(workers):
                pool.submit(os.getpid)
        yield pool
    except BaseException:
        for child in multiprocessing.active_children():
            if child not in others:
                child.terminate()
        raise
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
        for name, value in before.items():
            os.environ.pop(name)
            if value is not None:
                os.environ[name] = value


@contextmanager
def _interrupts_held() -> Iterator[None]:
    """Hold Ctrl-C back while processes are started, which inherit that: none is interrupted while it imports."""
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
    """Files with which a client and a scheduler know each other: authority, own certificate, own key; PEM."""

    ca: Path | None = None
    cert: Path | None = None
    key: Path | None = None

    def mistakes(self) -> list[Mistake]:
        """Return which of the files are missing; all or none are needed."""
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
    """Return what must be known of a scheduler that is reached without TLS; empty where there is no danger."""
    host = address.partition("://")[2].rpartition(":")[0].strip("[]")
    if address == "local" or address.startswith("tls://") or host in ("localhost", "127.0.0.1", "::1"):
        return ""
    return (
        f"{address} is reached without TLS: whoever is on that network can read the cases and run code on the workers "
        "and here. For trusted networks only; else tls://HOST:8786 with --tls-ca, --tls-cert and --tls-key"
    )


@contextmanager
def cluster(address: str, workers: int, tls: TlsFiles = NO_TLS) -> Iterator[Executor]:
    """Open the dask cluster at ``address``, or one of ``workers`` processes on this machine for "local".

    ``tls`` makes the client and the scheduler prove who they are, and refuses a connection that is not encrypted;
    without it dask's own configuration holds. Raises ``SettingsError`` where nothing answers or files are missing.
    """
    # By name: whether the package is installed, with types or without, is nobody's business who does not use it.
    distributed: Any = importlib.import_module("distributed")
    if mistakes := tls.mistakes():
        raise SettingsError("command line", mistakes)

    quiet = _quiet()
    if address == "local":
        with (
            distributed.LocalCluster(workers, threads_per_worker=1, silence_logs=quiet, dashboard_address=None) as own,
            distributed.Client(own) as client,
        ):
            yield client.get_executor(pure=False, retries=MOST_LOSSES)
        return
    try:
        client = distributed.Client(address, timeout="10s", security=_security(distributed.Security, tls))
    except (OSError, ValueError, TypeError, RuntimeError) as error:
        remedy = "tcp://HOST:8786, tls://HOST:8786 with the files of its certificates, or local"
        mistake = Mistake("--scheduler", f"{address} does not answer ({error})", remedy)
        raise SettingsError("command line", [mistake]) from None
    with client:
        _require_worker(client, address)
        yield client.get_executor(pure=False, retries=MOST_LOSSES)


def _quiet() -> int:
    """Let dask's loggers be heard where details are asked for, else in nothing: return the level from which on.

    Its processes tell at length of every interrupt, which they all get. Importing it has set their levels.
    """
    if logging.getLogger("hpe_rig").isEnabledFor(logging.INFO):
        return logging.INFO
    names = [name for name in logging.Logger.manager.loggerDict if name.split(".")[0] in ("distributed", "tornado")]
    for name in names:
        logging.getLogger(name).setLevel(logging.CRITICAL)
    return logging.CRITICAL


def _require_worker(client: Any, address: str) -> None:
    """Raise ``SettingsError`` where the scheduler has no worker, and gets none in ``WORKER_S``: nothing would begin."""
    try:
        client.wait_for_workers(1, timeout=WORKER_S)
    except TimeoutError:
        what = f"{address} has no workers, so that no case would ever begin"
        raise SettingsError("command line", [Mistake("--scheduler", what, f"dask worker {address}, first")]) from None


def _security(security: Callable[..., Any], tls: TlsFiles) -> Any:
    """Return dask's own settings of TLS with the given files, None for those of its configuration."""
    if tls == NO_TLS:
        return None
    ca, cert, key = str(tls.ca), str(tls.cert), str(tls.key)
    return security(tls_ca_file=ca, tls_client_cert=cert, tls_client_key=key, require_encryption=True)
