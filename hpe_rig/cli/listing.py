"""Commands ``list`` and ``extensions``: the runs of a folder, and the extensions of other packages."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any

import typer

from hpe_rig.cli.console import announce, print_json
from hpe_rig.cli.tables import wide_console
from hpe_rig.extensions import CONDITIONS, ESTIMATORS, IMPORTERS, MEDIA, installed, load, origin
from hpe_rig.result import amplitude_text, csv_text, phase_text, rich_table
from hpe_rig.scene import Mistake, SettingsError, printable
from hpe_rig.store import RunEntry, list_runs, matching_runs

MAX_NOTE = 40
"""Characters of a note in the table."""


def print_runs(
    folder: Path, below: bool, words: Sequence[str], dates: tuple[str | None, str | None], *, json: bool, csv: bool
) -> None:
    """Print the runs of ``folder`` that contain all ``words``, from the first to the last of ``dates``.

    ``below`` includes subfolders. Unreadable files are announced. Raises ``SettingsError`` for invalid dates.
    """
    since, until = _time(dates[0], "--since"), _time(dates[1], "--until", end=True)
    entries, unreadable = list_runs(folder, below)
    selected = matching_runs(entries, words, since, until)
    for text in unreadable:
        announce(f"hpe-rig: {printable(text)}")
    if json:
        print_json([entry.as_dict() for entry in selected])
    elif csv:
        typer.echo(csv_text([_csv_row(entry) for entry in selected]), nl=False)
    elif not selected:
        typer.echo(f"none of {len(entries)} runs in {folder} matches" if entries else f"no run in {folder}")
    else:
        headers = ("date", "file", "title", "state", "strongest harmonic", "notes")
        console = wide_console()
        console.print(rich_table(headers, [_row(entry, folder) for entry in selected], words=6))


def _row(entry: RunEntry, folder: Path) -> tuple[str, ...]:
    state = entry.status if entry.shots_complete == entry.shots else f"{entry.shots_complete} of {entry.shots} shots"
    state = f"imported, {state}" if entry.imported else state
    state += f", {entry.shots_marked_bad} marked bad" if entry.shots_marked_bad else ""
    notes = [f"{name}: {_short(note)}" for name, note in entry.notes.items()]
    quantities = ((*name.partition(" "), value) for name, value in entry.conditions.items())
    notes += [f"{name}: {value:.4g} {unit}".strip() for name, _, unit, value in quantities]
    date = f"{entry.date:%Y-%m-%d %H:%M}"
    texts = (date, str(entry.path.relative_to(folder)), entry.title, state, _result(entry), ", ".join(notes))
    return tuple(printable(text) for text in texts)


def _short(note: Any) -> str:
    text = " ".join(str(note).split())
    return text if len(text) <= MAX_NOTE else f"{text[:MAX_NOTE]}..."


def _result(entry: RunEntry) -> str:
    lead = entry.lead
    if lead is None:
        return "-"
    amplitude = amplitude_text(lead.amplitude_m, lead.amplitude_uncertainty_m)
    return f"{amplitude}, {phase_text(lead.phase_rad, lead.phase_uncertainty_rad)} at {lead.frequency_hz:g} Hz"


def _csv_row(entry: RunEntry) -> dict[str, Any]:
    """Return the entry as one row, with a column for each value of the result and each note."""
    # A cell holds one value: nested tables become further columns.
    row = entry.as_dict()
    lead, notes, conditions = row.pop("lead") or {}, row.pop("notes"), row.pop("conditions")
    columns = {"note": notes, "condition": conditions}
    more = {f"{kind}_{key.replace(' ', '_')}": value for kind, texts in columns.items() for key, value in texts.items()}
    return {**row, **lead, **more}


def _time(text: str | None, option: str, end: bool = False) -> datetime | None:
    """Return the time in ``text``; for a date the begin or, with ``end``, the end of the day."""
    if text is None:
        return None
    try:
        time = datetime.fromisoformat(text)
    except ValueError:
        what = f"{text!r} is no date"
        raise SettingsError(
            "command line", [Mistake(option, what, "one such as 2026-03-05 or 2026-03-05T14:30")]
        ) from None
    # A date without time ends at the last moment of its day.
    if end and len(text) <= len("2026-03-05"):
        time = time.replace(hour=23, minute=59, second=59, microsecond=999_999)
    return time.astimezone()


def extension_lines() -> tuple[list[str], bool]:
    """Return a line for every installed extension, and whether all of them load and fit their entry point group."""
    from hpe_rig.medium import law_of
    from hpe_rig.processing import spec_of
    from hpe_rig.recordings import foreign_importer

    checks: dict[str, Callable[[str], object]] = {
        ESTIMATORS: spec_of,
        MEDIA: law_of,
        IMPORTERS: foreign_importer,
        CONDITIONS: partial(load, CONDITIONS),
    }
    lines, all_load = list[str](), True
    for group, check in checks.items():
        for name in installed(group):
            try:
                check(name)
                lines.append(origin(group, name))
            except ValueError as error:
                lines.append(f"FAILS {error}")
                all_load = False
    return lines, all_load
