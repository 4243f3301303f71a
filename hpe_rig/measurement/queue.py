"""Queue of runs: all checked before the first, one after another under one lock, each into a file of its own.

What became of each stands in ``queue.json`` beside the run files, so that a queue that was stopped, or whose program
was killed, goes on where it was.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import asdict, dataclass, replace
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any, Literal

from pydantic import Field, TypeAdapter, ValidationError

from drivers.interfaces import InstrumentError
from hpe_rig.bench import BenchFile, hold, resources, uninterrupted
from hpe_rig.measurement.mover import Mover
from hpe_rig.measurement.provenance import provenance_now
from hpe_rig.measurement.resumption import Rest, prepare_rest, resume
from hpe_rig.measurement.run import record_run
from hpe_rig.measurement.sequencer import Observer
from hpe_rig.measurement.setup import Setup, prepare_text, source_text
from hpe_rig.measurement.stop_request import StopRequested, clear_stop, stop_requested
from hpe_rig.plan import PlanError
from hpe_rig.result import Result
from hpe_rig.runs import open_run, process
from hpe_rig.scene import Mistake, Section, SettingsError, parse_toml, validated
from hpe_rig.store import StoreError, WriteOptions, atomic_file, new_run_id, reason, refuse_unwritable

QUEUE_FILE = "queue.json"
MOST_RUNS = 1000
State = Literal["waiting", "running", "done", "failed", "stopped"]
Failure = (InstrumentError, StoreError, PlanError, SettingsError, OSError, MemoryError)
"""What ends one run of a queue and not the queue; an output that is not proven off ends it."""


class QueueItem(Section):
    """One run of a list."""

    scene: str
    """A shipped scene, a TOML file or a run file, from the list's folder on."""
    bench: str | None = None
    """Bench file; absent: the list's."""


class QueueList(Section):
    """A list of runs for ``hpe-rig queue``."""

    bench: str | None = None
    """Bench file of the runs that name none; absent: the simulated bench."""
    on_failure: Literal["go on", "stop"] | None = None
    """What follows a run that fails; absent: the others go on."""
    run: tuple[QueueItem, ...] = Field(min_length=1, max_length=MOST_RUNS)
    """The runs in order."""


@dataclass(frozen=True, slots=True)
class QueueRun:
    """One run of a queue: its scene as it was read, bench file and run file, and what became of it."""

    name: str
    scene_toml: str
    bench: str | None
    run_file: str
    state: State = "waiting"
    why: str = ""
    planned_s: float = 0.0
    """How long it takes by its plan."""
    took_s: float = 0.0
    """How long it took, its result included; 0 where it is not done, or was done in more than one go."""


@dataclass(frozen=True, slots=True)
class Watching:
    """Who watches a queue: ``tell`` is told of every step; ``watch`` gives the observer of a run, by its identity.

    And who moves the tracking transducer between places, None where nobody does.
    """

    tell: Callable[[str], None]
    watch: Callable[[Setup, Path, str], AbstractContextManager[tuple[Observer, Mover | None]]]


def listed(sources: Sequence[str], bench: Path | None) -> tuple[list[tuple[str, Path | None]], bool]:
    """Return scenes and benches of a queue, and whether a failure stops it, from scenes or from the TOML of a list."""
    if len(sources) == 1 and sources[0].endswith(".toml"):
        path = Path(sources[0])
        tables = parse_toml(source_text(sources[0])[1], f"queue {path}")
        if "run" in tables:
            found = validated(QueueList, tables, f"queue {path}")
            default = bench or _beside(path, found.bench)
            runs = [(_scene_beside(path, item.scene), _beside(path, item.bench) or default) for item in found.run]
            return runs, found.on_failure == "stop"
    return [(source, bench) for source in sources], False


def new_queue(runs: Sequence[tuple[str, Path | None]], folder: Path) -> tuple[QueueRun, ...]:
    """Return the queue of ``runs``, every one checked, and write it to the new ``folder``.

    Raises ``SettingsError`` with everything that is wrong with any of them, and ``StoreError`` where the folder cannot
    be made.
    """
    found, mistakes = list[QueueRun](), list[Mistake]()
    for number, (source, bench) in enumerate(runs, 1):
        try:
            name, text = source_text(source)
            setup = prepare_text(name, text, bench)
        except Failure as error:
            mistakes += _mistakes(f"run {number}, {source}", error)
            continue
        path = None if bench is None else str(bench.resolve())
        found.append(QueueRun(name, text, path, f"{number:02d}-{name}.h5", planned_s=setup.plan.duration_s))
    if mistakes:
        raise SettingsError("the queue", mistakes)
    try:
        folder.mkdir(parents=True)
    except OSError as error:
        raise StoreError(f"{folder} cannot be made ({reason(error)}). Try: another --output.") from None
    queue = tuple(found)
    write_queue(folder, queue)
    return queue


def read_queue(folder: Path) -> tuple[QueueRun, ...]:
    """Return the queue in ``folder``; raise ``StoreError`` where there is none."""
    path = folder / QUEUE_FILE
    try:
        if queue := TypeAdapter(tuple[QueueRun, ...]).validate_json(path.read_bytes(), strict=False):
            return queue
        raise ValueError
    except (OSError, ValidationError, ValueError) as error:
        why = reason(error) if isinstance(error, OSError) else "it lists no runs of a queue"
        raise StoreError(f"{path} cannot be read ({why}). Try: the folder that hpe-rig queue made.") from None


def write_queue(folder: Path, queue: Sequence[QueueRun]) -> None:
    """Write what became of the runs so far, whole or not at all."""
    with atomic_file(folder / QUEUE_FILE) as draft:
        draft.write_text(json.dumps([asdict(run) for run in queue], indent=1), encoding="utf-8")


def run_queue(
    folder: Path, queue: Sequence[QueueRun], watching: Watching, stops: bool = False
) -> tuple[tuple[QueueRun, ...], dict[int, Result]]:
    """Measure every run of the ``queue`` that is not done, and return what became of each and the results by index.

    The benches are locked for the whole of it; every output is off, verified, after each run. A run that fails is
    reported and the others go on, unless a failure ``stops`` the queue; an output that is not proven off always does.
    An interrupt ends run and queue: ``run_queue`` of what ``read_queue`` returns goes on. Raises as ``prepare`` and
    ``BenchInUseError`` where another program has a bench.
    """
    runs, results = list(queue), dict[int, Result]()
    setups = [prepare_text(run.name, run.scene_toml, _bench(run)) for run in runs]
    runs = [replace(run, planned_s=setup.plan.duration_s) for run, setup in zip(runs, setups, strict=True)]
    with hold(_resources([setup.bench.bench for setup in setups])):
        clear_stop(folder / QUEUE_FILE)
        for index, run in enumerate(runs):
            if run.state == "done":
                continue
            watching.tell(f"run {index + 1} of {len(runs)}: {run.name} -> {run.run_file}; {_end(runs, index)}")
            try:
                _look_for_stop(folder)
                runs[index] = _set(folder, runs, index, state="running", why="")
                begun, start_s = (folder / run.run_file).exists(), time.monotonic()
                results[index] = _measure(folder, runs, index, setups[index], watching)
                took_s = 0.0 if begun else time.monotonic() - start_s
                runs[index] = _set(folder, runs, index, state="done", took_s=took_s)
            except Failure as error:
                runs[index] = _set(folder, runs, index, state="failed", why=_said(error))
                watching.tell(f"run {index + 1} failed: {_said(error)}")
                if stops:
                    watching.tell("the queue stops here, as asked")
                    break
            except BaseException as error:
                with uninterrupted():
                    runs[index] = _set(folder, runs, index, state="stopped", why=type(error).__name__)
                error.add_note(f"the queue goes on with hpe-rig queue --resume {folder}")
                raise
        clear_stop(folder / QUEUE_FILE)
    return tuple(runs), results


def _look_for_stop(folder: Path) -> None:
    """Raise ``StopRequested`` where the live page asked for a stop while no run was being measured."""
    if stop_requested(folder / QUEUE_FILE):
        clear_stop(folder / QUEUE_FILE)
        raise StopRequested


def _measure(folder: Path, runs: list[QueueRun], index: int, setup: Setup, watching: Watching) -> Result:
    """Measure one run, or what is left of it, and return its result."""
    path = folder / runs[index].run_file
    rest = _rest(path, runs[index])
    if path.exists() and rest is None:
        # All of its shots are there: the program ended before it could say so.
        return process(path)
    run_id = new_run_id()
    options = WriteOptions(run_id=run_id, provenance=provenance_now(setup.bench.bench))
    if rest is not None:
        path = _next(path)
        watching.tell(f"{rest.complete} of {len(setup.plan.shots)} shots are complete: the others go to {path.name}")
        runs[index] = _set(folder, runs, index, run_file=path.name)
    refuse_unwritable(path)
    with watching.watch(setup, path, run_id) as (observer, move):
        if rest is None:
            record_run(setup, path, observer, options=options, move=move)
        else:
            resume(rest, path, observer, options=options, move=move)
    return process(path)


def _rest(path: Path, run: QueueRun) -> Rest | None:
    """Return what is left of a run that was begun; None where nothing was, or nothing is left."""
    if not path.exists():
        return None
    stored = open_run(path).stored
    if stored.status == "complete" and stored.shot_complete.all():
        return None
    return prepare_rest(path, bench_path=_bench(run))


def _set(folder: Path, runs: Sequence[QueueRun], index: int, **changes: Any) -> QueueRun:
    """Return a run with ``changes``, written down before anything follows from them."""
    changed = replace(runs[index], **changes)
    write_queue(folder, [changed if number == index else run for number, run in enumerate(runs)])
    return changed


def time_left_s(queue: Sequence[QueueRun], index: int) -> float:
    """Return how long the runs from ``index`` on take: by their plans, at the pace of those that are done."""
    done = [run for run in queue if run.state == "done" and run.took_s]
    pace = sum(run.took_s for run in done) / sum(run.planned_s for run in done) if done else 1.0
    return pace * sum(run.planned_s for run in queue[index:] if run.state != "done")


def _end(queue: Sequence[QueueRun], index: int) -> str:
    """Return in words when the queue ends, seen from the start of run ``index``."""
    how = "as the runs so far went" if any(run.took_s for run in queue) else "by the plans alone"
    end = datetime.now().astimezone() + timedelta(seconds=time_left_s(queue, index))
    return f"the queue ends at about {end.isoformat(' ', 'seconds')}, {how}"


def _mistakes(where: str, error: Exception) -> Iterator[Mistake]:
    if isinstance(error, SettingsError):
        where = f"{where}, {error.source}" if error.source.startswith("bench") else where
        for each in error.mistakes:
            yield Mistake(f"{where}: {each.path}".removesuffix(": "), each.what, each.remedy)
    elif isinstance(error, PlanError):
        for found in error.conflicts:
            yield Mistake(f"{where}: {found.check}", found.text, found.remedy)
    else:
        what, _, remedy = str(error).partition(". Try: ")
        yield Mistake(where, what, remedy.removesuffix(".") or "another scene")


def _said(error: BaseException) -> str:
    return "; ".join([str(error) or type(error).__name__, *getattr(error, "__notes__", ())])


def _bench(run: QueueRun) -> Path | None:
    return None if run.bench is None else Path(run.bench)


def _resources(benches: Sequence[BenchFile]) -> list[str]:
    return sorted({name for bench in benches for name in resources(bench)})


def _beside(path: Path, name: str | None) -> Path | None:
    return None if name is None else path.parent / name


def _scene_beside(path: Path, name: str) -> str:
    """Return a list's scene from the list's folder on, unless it is a shipped one's name."""
    return os.fspath(path.parent / name) if Path(name).suffix else name


def _next(path: Path) -> Path:
    """Return the name of the file that goes on from ``path``, the first numbered one that is free."""
    stem, number = path.stem, 2
    while (found := path.with_name(f"{stem}-{number}.h5")).exists():
        number += 1
    return found
