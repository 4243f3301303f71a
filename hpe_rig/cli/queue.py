"""Command ``queue``: several runs one after another, each with its progress, and what became of all of them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from hpe_rig.cli.console import EXIT_INSTRUMENT, announce, progress
from hpe_rig.cli.tables import wide_console
from hpe_rig.cli.watch import PageOptions, live_page, watched
from hpe_rig.measurement import Mover, Observer, QueueRun, Setup, Watching, listed, new_queue, read_queue, run_queue
from hpe_rig.result import Result, rich_table
from hpe_rig.scene import Mistake, SettingsError, printable

LONGEST_WHY = 120
"""Characters of a failure in the closing table; the whole of it was said when it came, and is in ``queue.json``."""


def queue_command(
    sources: Sequence[str],
    bench: Path | None,
    output: Path | None,
    resume: Path | None,
    stops: bool,
    live: PageOptions | None,
    verbose: bool,
    yes: bool,
) -> int:
    """Measure the runs of a queue, print what became of each, and return the exit code."""
    if (resume is None) == (not sources):
        what = "a queue is of scenes, or goes on with --resume FOLDER"
        raise SettingsError("command line", [Mistake("", what, "hpe-rig queue a.toml b.toml --bench bench.toml")])
    if resume is not None:
        if bench is not None or output is not None:
            what = "a queue that goes on has its benches and its folder already"
            raise SettingsError("command line", [Mistake("--resume", what, "--resume FOLDER alone")])
        folder, queue = resume, read_queue(resume)
    else:
        runs, list_stops = listed(sources, bench)
        stops = stops or list_stops
        folder = output or _free_folder()
        queue = new_queue(runs, folder)
    announce(f"{len(queue)} runs into {folder}, all of them checked")

    @contextmanager
    def watch(setup: Setup, path: Path, run_id: str) -> Iterator[tuple[Observer, Mover | None]]:
        run = watched(setup, path, run_id, None, verbose, announce, yes, live is not None)
        with run as watching, progress(setup, quiet=False) as observer:
            yield watching.observed(observer), watching.move

    with live_page(folder, live, announce):
        ended, results = run_queue(folder, queue, Watching(announce, watch), stops)
        _print(ended, results)
        left = [run for run in ended if run.state != "done"]
        if left:
            again = f"hpe-rig queue --resume {folder} takes them up again"
            announce(f"{len(left)} of {len(ended)} runs are not done: {again}")
    return EXIT_INSTRUMENT if left else 0


def _print(queue: Sequence[QueueRun], results: dict[int, Result]) -> None:
    rows = [
        (f"{index + 1}", run.name, run.state, run.run_file, _words(run, results.get(index)))
        for index, run in enumerate(queue)
    ]
    table = rich_table(("run", "scene", "state", "file", "strongest harmonic, or why there is none"), rows, words=5)
    wide_console().print(table)


def _words(run: QueueRun, result: Result | None) -> str:
    if result is None:
        why = printable(run.why.partition("\n")[0].partition(". Try")[0])
        return why[:LONGEST_WHY] or ("from before" if run.state == "done" else "")
    found = [(each.headline, each.frequency_hz) for shot in result.shots for each in shot.estimates]
    if not found:
        return "no frequency is wanted"
    lead, frequency_hz = max(found, key=lambda each: each[0].amplitude_m)
    amplitude = f"{lead.amplitude_m * 1e9:.4g} +- {lead.amplitude_uncertainty_m * 1e9:.2g} nm"
    return f"{amplitude} at {frequency_hz:g} Hz"


def _free_folder() -> Path:
    folder, number = Path("queue"), 2
    while folder.exists():
        folder, number = Path(f"queue-{number}"), number + 1
    return folder
