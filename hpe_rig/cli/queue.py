"""Command ``queue``: several runs one after another, the progress of each, and a closing table."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from hpe_rig.cli.console import EXIT_INSTRUMENT, announce, print_json, progress
from hpe_rig.cli.options import WatchOptions
from hpe_rig.cli.tables import wide_console
from hpe_rig.cli.watch import live_page, supervise
from hpe_rig.measurement import (
    Mover,
    Observer,
    QueueHooks,
    QueueRun,
    Setup,
    new_queue,
    queue_entries,
    read_queue,
    run_queue,
)
from hpe_rig.result import Estimate, RepeatMean, Result, amplitude_text, rich_table
from hpe_rig.runs import process
from hpe_rig.scene import Mistake, SettingsError, plural, printable

MAX_REASON = 120
"""Characters of a failure in the closing table; ``queue.json`` holds the whole message."""


def start_queue(
    sources: Sequence[str], bench: Path | None, output: Path | None
) -> tuple[Path, tuple[QueueRun, ...], bool]:
    """Check all ``sources``; return the folder of the new queue, its runs, and whether a failure stops it."""
    if not sources:
        what = "a queue needs scenes, or --resume FOLDER"
        raise SettingsError("command line", [Mistake("", what, "hpe-rig queue a.toml b.toml --bench bench.toml")])
    entries, stop_on_failure = queue_entries(sources, bench)
    folder = output or _free_folder()
    return folder, new_queue(entries, folder), stop_on_failure


def continue_queue(folder: Path, is_alone: bool) -> tuple[Path, tuple[QueueRun, ...], bool]:
    """Return the queue in ``folder`` as ``start_queue``; refuse --resume unless it ``is_alone``."""
    if not is_alone:
        what = "a continued queue has its scenes, benches and folder already"
        raise SettingsError("command line", [Mistake("--resume", what, "--resume FOLDER alone")])
    return folder, read_queue(folder, announce), False


def measure_queue(
    folder: Path, queue: Sequence[QueueRun], stop_on_failure: bool, watch: WatchOptions, json: bool = False
) -> int:
    """Measure the runs of a queue, print the state of each as a table or as ``json``, and return the exit code."""
    announce(f"{plural(len(queue), 'run')} into {folder}, checked")

    @contextmanager
    def supervise_run(setup: Setup, path: Path, run_id: str) -> Iterator[tuple[Observer, Mover | None]]:
        supervision = supervise(setup, path, run_id, watch, announce, in_queue=True)
        with supervision as (watched, move), progress(setup, quiet=False) as observer:
            yield watched(observer), move

    with live_page(folder, watch, announce):
        hooks = QueueHooks(announce, supervise_run, process)
        runs, results = run_queue(folder, queue, hooks, stop_on_failure)
        if json:
            rows = [_as_dict(run, results.get(index)) for index, run in enumerate(runs)]
            print_json({"folder": str(folder), "runs": rows})
        else:
            _print_table(runs, results)
        unfinished = sum(run.state != "done" for run in runs)
        if unfinished:
            remedy = f"hpe-rig queue --resume {folder} measures them"
            announce(f"{unfinished} of {len(runs)} runs are not done: {remedy}")
    return EXIT_INSTRUMENT if unfinished else 0


def _print_table(runs: Sequence[QueueRun], results: Mapping[int, Result]) -> None:
    rows = [
        (f"{index + 1}", run.name, run.state, run.run_file, _result_text(run, results.get(index)))
        for index, run in enumerate(runs)
    ]
    table = rich_table(("run", "scene", "state", "file", "strongest harmonic, or reason"), rows, words=5)
    wide_console().print(table)


def _as_dict(run: QueueRun, result: Result | None) -> dict[str, Any]:
    """Return the values of a row of the table; those of the strongest harmonic are None without a new result."""
    lead = result and _strongest(result)
    return {
        "scene": run.name,
        "state": run.state,
        "run_file": run.run_file,
        "why": run.why,
        "planned_s": run.planned_s,
        "took_s": run.took_s,
        "frequency_hz": lead and lead.frequency_hz,
        "amplitude_m": lead and lead.amplitude_m,
        "amplitude_uncertainty_m": lead and lead.amplitude_uncertainty_m,
    }


def _strongest(result: Result) -> Estimate | RepeatMean | None:
    """Return the harmonic with the largest amplitude, of the means over repeats if any, else of trusted shots."""
    shots = [estimate for shot in result.shots if not shot.untrusted for estimate in shot.estimates]
    estimates: Sequence[Estimate | RepeatMean] = result.means or shots
    return max(estimates, key=lambda item: item.amplitude_m, default=None)


def _result_text(run: QueueRun, result: Result | None) -> str:
    """Return the strongest harmonic of a run in words, or why it has no result."""
    if result is None:
        # The first line up to its remedy states the reason.
        reason = printable(run.why.partition("\n")[0].partition(". Try")[0])
        return reason[:MAX_REASON] or ("measured earlier" if run.state == "done" else "")
    lead = _strongest(result)
    if lead is None:
        return "NOT TO BE TRUSTED" if any(shot.untrusted for shot in result.shots) else "the scene has no frequency"
    return f"{amplitude_text(lead.amplitude_m, lead.amplitude_uncertainty_m)} at {lead.frequency_hz:g} Hz"


def _free_folder() -> Path:
    folder, number = Path("queue"), 2
    while folder.exists():
        folder, number = Path(f"queue-{number}"), number + 1
    return folder
