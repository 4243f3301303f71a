"""Queue of runs: all are checked before the first, then measured one after another under one lock.

The file ``queue.json`` in the folder of the run files holds the state of each run. With it a stopped or killed queue
can continue.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import asdict, dataclass, replace
from datetime import datetime, timedelta
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Any, Literal

from pydantic import Field, TypeAdapter, ValidationError

from drivers.interfaces import InstrumentError
from hpe_rig.bench import hold, resources, uninterrupted
from hpe_rig.measurement.between_shots import Mover
from hpe_rig.measurement.provenance import provenance_now
from hpe_rig.measurement.requests import StopRequested, clear_stop, stop_requested, write_stop
from hpe_rig.measurement.resumption import Resumption, prepare_resumption, resume
from hpe_rig.measurement.run import record_run
from hpe_rig.measurement.sequencer import Observer
from hpe_rig.measurement.setup import Setup, prepare_text, source_text
from hpe_rig.plan import PlanError
from hpe_rig.result import Result
from hpe_rig.scene import Mistake, Section, SettingsError, parse_toml, printable, validated
from hpe_rig.store import (
    StoreError,
    WriteOptions,
    acquire,
    make_folder,
    new_run_id,
    open_ordinary,
    read_run,
    read_sealed,
    reason,
    refuse_unwritable,
    sealed_json,
    write_file,
)

QUEUE_FILE, QUEUE_COPY = "queue.json", "queue-copy.json"
QUEUE_LOCK = "queue.lock"
QUEUE_FORMAT = "hpe_rig queue"
MAX_RUNS = 1000
State = Literal["waiting", "running", "done", "failed", "stopped"]
RUN_FAILURES = (InstrumentError, StoreError, PlanError, SettingsError, OSError, MemoryError)
"""Errors that end one run and not the queue. An output that is not verified off ends the queue."""


class QueueItem(Section):
    """One run of a list."""

    scene: str
    """A shipped scene, or a TOML or run file relative to the list's folder."""
    bench: str | None = None
    """Bench file; default: the list's."""


class QueueList(Section):
    """A list of runs for ``hpe-rig queue``."""

    bench: str | None = None
    """Bench file of the runs without one; default: the simulated bench."""
    on_failure: Literal["go on", "stop"] | None = None
    """What happens after a run fails; default: the other runs are measured."""
    run: tuple[QueueItem, ...] = Field(min_length=1, max_length=MAX_RUNS)
    """The runs in order."""


@dataclass(frozen=True, slots=True)
class QueueRun:
    """One run of a queue: text of its scene, bench file, run file and state."""

    name: str
    scene_toml: str
    bench: str | None
    run_file: str
    state: State = "waiting"
    why: str = ""
    """Reason of a failure or stop."""
    planned_s: float = 0.0
    """Duration by its plan."""
    took_s: float = 0.0
    """Measured duration with its processing; 0 if it is not done or was resumed."""


@dataclass(frozen=True, slots=True)
class QueueHooks:
    """Functions that the caller of a queue provides.

    ``report`` gets a message for each step. ``watch`` (setup, run file, run identity) is a context with the observer of
    a run and, if there is one, the mover of the tracking transducer. ``process`` estimates a run file and stores the
    result.
    """

    report: Callable[[str], None]
    watch: Callable[[Setup, Path, str], AbstractContextManager[tuple[Observer, Mover | None]]]
    process: Callable[[Path], Result]


def queue_entries(sources: Sequence[str], bench: Path | None) -> tuple[list[tuple[str, Path | None]], bool]:
    """Return the (scene, bench file) pairs of a queue, and whether a failure stops it.

    ``sources`` are scenes or run files, or one TOML file with a list of runs.
    """
    if len(sources) == 1 and sources[0].endswith(".toml"):
        path = Path(sources[0])
        tables = parse_toml(source_text(sources[0])[1], f"queue {path}")
        if "run" in tables:
            queue = validated(QueueList, tables, f"queue {path}")
            default = bench or _in_folder_of(path, queue.bench)
            entries = []
            for item in queue.run:
                # A name without suffix is that of a shipped scene.
                scene = os.fspath(path.parent / item.scene) if Path(item.scene).suffix else item.scene
                entries.append((scene, _in_folder_of(path, item.bench) or default))
            return entries, queue.on_failure == "stop"
    return [(source, bench) for source in sources], False


def new_queue(entries: Sequence[tuple[str, Path | None]], folder: Path) -> tuple[QueueRun, ...]:
    """Check all ``entries`` (scene, bench file), write their queue to the new ``folder`` and return it.

    Raises ``SettingsError`` with all mistakes of all runs, and ``StoreError`` if the folder cannot be created.
    """
    runs, mistakes = list[QueueRun](), list[Mistake]()
    for number, (source, bench) in enumerate(entries, 1):
        try:
            name, text = source_text(source)
            setup = prepare_text(name, text, bench)
        except RUN_FAILURES as error:
            mistakes += _mistakes(f"run {number}, {source}", error)
            continue
        # The queue may be continued from another folder.
        path = None if bench is None else str(bench.resolve())
        runs.append(QueueRun(name, text, path, f"{number:02d}-{name}.h5", planned_s=setup.plan.duration_s))
    if mistakes:
        raise SettingsError("the queue", mistakes)
    make_folder(folder, exist_ok=False)
    write_queue(folder, runs)
    return tuple(runs)


def read_queue(folder: Path, report: Callable[[str], None] = lambda text: None) -> tuple[QueueRun, ...]:
    """Return the queue in ``folder``, from the copy of its list if the list is damaged, with a message to ``report``.

    Raises ``StoreError`` if both are absent or damaged.
    """
    whys = list[str]()
    for name in (QUEUE_FILE, QUEUE_COPY):
        try:
            queue = _read_list(folder / name)
        except (OSError, ValueError) as error:
            whys.append(reason(error) if isinstance(error, OSError) else f"it lists no runs of a queue: {error}")
            continue
        if whys:
            report(f"{folder / QUEUE_FILE} cannot be read ({whys[0]}): its copy {QUEUE_COPY} is used")
        return queue
    raise StoreError(
        f"{folder / QUEUE_FILE} cannot be read ({whys[0]}). Try: the folder that hpe-rig queue made, or hpe-rig resume "
        "for each of its run files."
    )


def _read_list(path: Path) -> tuple[QueueRun, ...]:
    """Return the runs of a queue's list; raise ``ValueError`` if it is damaged, and ``OSError`` if unreadable."""
    tables, has_checksum = read_sealed(path)
    if tables.get("format") != QUEUE_FORMAT or not has_checksum:
        raise ValueError("it has no checksum, as lists of earlier releases")
    try:
        queue = TypeAdapter(tuple[QueueRun, ...]).validate_python(tables.get("runs"), strict=False)
    except ValidationError:
        raise ValueError("its runs have other keys") from None
    for run in queue:
        # Both kinds of system: a name with a folder would lead out of the queue's folder.
        if any(kind(run.run_file).name != run.run_file for kind in (PurePosixPath, PureWindowsPath)):
            raise ValueError(f"the run file {printable(run.run_file)!r} is no plain name")
        if Path(run.run_file).suffix != ".h5":
            raise ValueError(f"the run file {printable(run.run_file)!r} does not end in .h5")
    if not queue:
        raise ValueError("it is empty")
    return queue


def write_queue(folder: Path, queue: Sequence[QueueRun]) -> None:
    """Replace the list of runs with their states, then its copy, each in one step."""
    text = sealed_json({"format": QUEUE_FORMAT, "runs": [asdict(run) for run in queue]})
    for name in (QUEUE_FILE, QUEUE_COPY):
        write_file(folder / name, text)


@contextmanager
def _only_queue(folder: Path) -> Iterator[None]:
    """Keep other programs from measuring the queue in ``folder``; raise ``StoreError`` if one does already."""
    with open(folder / QUEUE_LOCK, "ab", opener=open_ordinary) as file:
        try:
            acquire(file)
        except BlockingIOError:
            what = f"another program measures the queue in {folder}"
            raise StoreError(f"{what}. Try: hpe-rig live {folder}, which shows it, or wait for its end.") from None
        yield


def run_queue(
    folder: Path, queue: Sequence[QueueRun], hooks: QueueHooks, stop_on_failure: bool = False
) -> tuple[tuple[QueueRun, ...], dict[int, Result]]:
    """Measure every run of the ``queue`` that is not done; return all runs with their states, and results by index.

    The benches stay locked throughout; every output is verified off after each run. After a failed run the others
    follow, unless ``stop_on_failure``. An output that is not verified off always ends the queue. An interrupt ends it
    too; ``run_queue`` of the result of ``read_queue`` continues it. Raises as ``prepare``, and ``BenchInUseError`` if
    another program uses a bench.
    """
    runs, results = list(queue), dict[int, Result]()
    # All runs are planned before the first one: a mistake must not appear in the middle of the night.
    setups = [prepare_text(run.name, run.scene_toml, _bench(run)) for run in runs]
    runs = [replace(run, planned_s=setup.plan.duration_s) for run, setup in zip(runs, setups, strict=True)]
    with _only_queue(folder), hold(sorted({name for setup in setups for name in resources(setup.bench.bench)})):
        clear_stop(folder / QUEUE_FILE)
        for index, run in enumerate(runs):
            if run.state == "done":
                continue
            hooks.report(f"run {index + 1} of {len(runs)}: {run.name} -> {run.run_file}; {_end_text(runs, index)}")
            try:
                results[index] = _measure(folder, runs, index, setups[index], hooks)
            except RUN_FAILURES as error:
                _set(folder, runs, index, state="failed", why=_error_text(error))
                hooks.report(f"run {index + 1} failed: {_error_text(error)}")
                if stop_on_failure:
                    hooks.report("the queue stops after this failure, as requested")
                    break
            except BaseException as error:
                # A second interrupt must not leave the state at "running".
                with uninterrupted():
                    _set(folder, runs, index, state="stopped", why=type(error).__name__)
                error.add_note(f"hpe-rig queue --resume {folder} continues the queue")
                raise
        clear_stop(folder / QUEUE_FILE)
    return tuple(runs), results


def stop_queue(folder: Path) -> None:
    """Request that the queue in ``folder`` starts no other run; raise ``StoreError`` if that is impossible."""
    write_stop(folder / QUEUE_FILE)


def _measure(folder: Path, runs: list[QueueRun], index: int, setup: Setup, hooks: QueueHooks) -> Result:
    """Measure one run, or resume it if its file exists; return its result. The queue stores its states and duration."""
    if stop_requested(folder / QUEUE_FILE):
        # The live page requested a stop between two runs.
        clear_stop(folder / QUEUE_FILE)
        raise StopRequested
    _set(folder, runs, index, state="running", why="")
    path, start_s = folder / runs[index].run_file, time.monotonic()
    has_file, resumption = path.exists(), _resumption(path, runs[index])
    if resumption is not None:
        path = _next_free_path(path)
        shots = f"{resumption.complete} of {len(setup.plan.shots)} shots are complete"
        hooks.report(f"{shots}: the others are written to {path.name}")
        _set(folder, runs, index, run_file=path.name)
    # A file with all shots and without the state "done" needs processing alone: the program ended in between.
    if resumption is not None or not has_file:
        run_id = new_run_id()
        options = WriteOptions(run_id=run_id, provenance=provenance_now(setup.bench.bench))
        refuse_unwritable(path)
        with hooks.watch(setup, path, run_id) as (observer, move):
            if resumption is None:
                record_run(setup, path, observer, options=options, move=move)
            else:
                resume(resumption, path, observer, options=options, move=move)
    result = hooks.process(path)
    _set(folder, runs, index, state="done", took_s=0.0 if has_file else time.monotonic() - start_s)
    return result


def _resumption(path: Path, run: QueueRun) -> Resumption | None:
    """Return the resumption of a run; None if it has no file yet, or all of its shots."""
    if not path.exists():
        return None
    stored = read_run(path)
    if stored.status == "complete" and stored.shot_complete.all():
        return None
    return prepare_resumption(path, bench_path=_bench(run))


def _set(folder: Path, runs: list[QueueRun], index: int, **changes: Any) -> None:
    """Change fields of one run, in ``runs`` and in the file."""
    runs[index] = replace(runs[index], **changes)
    write_queue(folder, runs)


def time_left_s(queue: Sequence[QueueRun], index: int) -> float:
    """Return the expected duration of the runs from ``index`` on: each as planned, plus the mean excess of those done.

    The excess is mostly opening and computing, which take the same time in each run.
    """
    # Resumed runs have no measured duration.
    excess_s = [run.took_s - run.planned_s for run in queue if run.state == "done" and run.took_s]
    mean_excess_s = max(sum(excess_s), 0.0) / len(excess_s) if excess_s else 0.0
    return sum(run.planned_s + mean_excess_s for run in queue[index:] if run.state != "done")


def _end_text(queue: Sequence[QueueRun], index: int) -> str:
    """Return when the queue is expected to end, at the start of run ``index``."""
    basis = "from the plans and the runs so far" if any(run.took_s for run in queue) else "from the plans"
    end = datetime.now().astimezone() + timedelta(seconds=time_left_s(queue, index))
    return f"the queue ends at about {end.isoformat(' ', 'minutes')}, {basis}"


def _mistakes(where: str, error: Exception) -> Iterator[Mistake]:
    if isinstance(error, SettingsError):
        where = f"{where}, {error.source}" if error.source.startswith("bench") else where
        for mistake in error.mistakes:
            yield Mistake(f"{where}: {mistake.path}".removesuffix(": "), mistake.what, mistake.remedy)
    elif isinstance(error, PlanError):
        for conflict in error.conflicts:
            yield Mistake(f"{where}: {conflict.check}", conflict.text, conflict.remedy)
    else:
        what, _, remedy = str(error).partition(". Try: ")
        yield Mistake(where, what, remedy.removesuffix(".") or "another scene")


def _error_text(error: BaseException) -> str:
    return "; ".join([str(error) or type(error).__name__, *getattr(error, "__notes__", ())])


def _bench(run: QueueRun) -> Path | None:
    return None if run.bench is None else Path(run.bench)


def _in_folder_of(path: Path, name: str | None) -> Path | None:
    return None if name is None else path.parent / name


def _next_free_path(path: Path) -> Path:
    """Return the first path NAME-2.h5, NAME-3.h5 ... that does not exist."""
    # The earlier file of a resumed run stays: its shots are copied.
    number = 2
    while (free_path := path.with_name(f"{path.stem}-{number}.h5")).exists():
        number += 1
    return free_path
