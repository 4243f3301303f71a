"""Verdicts on the shots of a run, given after the run, in ``RUN.marks.json``; the run file stays unchanged.

The file holds the identity of its run, so that marks never apply to another run of that name.
"""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime
from pathlib import Path
from typing import Any, Final

from hpe_rig.scene import printable
from hpe_rig.store.atomic import write_file
from hpe_rig.store.format import StoreError, reason
from hpe_rig.store.json_checksum import read_sealed, sealed_json

FORMAT: Final = "hpe_rig marks"
MARKED_BAD: Final = "marked bad"
"""Beginning of the reason why results leave out a marked shot."""
MAX_BYTES: Final = 1_000_000
MAX_WHY: Final = 500
"""Characters of the reason of a mark."""


def marks_path(run_file: Path) -> Path:
    """Return the path of the marks of a run file."""
    return run_file.with_name(f"{run_file.stem}.marks.json")


def read_marks(run_file: Path, identity: Mapping[str, str], shots: int) -> tuple[dict[int, str], str]:
    """Return the bad shots of a run, counted from 0, each with its reason, and why the file is not applied, or "".

    Marks of a run with another ``identity`` are not applied. Raises ``StoreError`` if the file cannot be read: a bad
    shot must not enter a result unnoticed.
    """
    path = marks_path(run_file)
    if not path.is_file():
        return {}, ""
    try:
        tables, _ = read_sealed(path, MAX_BYTES)
        if tables.get("format") != FORMAT:
            raise ValueError("it is no file of marks")
        if tables["run"] != identity:
            why = f"{path.name} belongs to another run than {run_file.name}: its marks are not applied"
            return {}, f"{why}. Try: move it to its run file, or away"
        return {_shot(entry, shots): f"{MARKED_BAD}: {_why(entry)}" for entry in tables["bad"]}, ""
    except (OSError, ValueError, KeyError, TypeError) as error:
        cause = reason(error) if isinstance(error, OSError) else f"{type(error).__name__}: {error}"
        raise StoreError(
            f"{path} cannot be read as marks of shots ({cause}). Try: move it away, then hpe-rig mark again."
        ) from None


def identity_of(run_id: str, started: str) -> dict[str, str]:
    """Return the identity of a run to which marks belong."""
    return {"run_id": run_id, "started": started}


def write_marks(run_file: Path, identity: Mapping[str, str], marks: Mapping[int, str]) -> Path:
    """Write which shots of a run are bad, counted from 0, each with its reason; return the path of the file.

    ``identity``: of the run. A reason may begin with ``MARKED_BAD``, which is removed.
    """
    path = marks_path(run_file)
    reasons = {shot: printable(why.removeprefix(f"{MARKED_BAD}: "))[:MAX_WHY] for shot, why in marks.items()}
    bad = [{"shot": shot + 1, "why": why} for shot, why in sorted(reasons.items())]
    marked = datetime.now().astimezone().isoformat(timespec="seconds")
    tables = {"format": FORMAT, "run": identity, "marked": marked, "bad": bad}
    write_file(path, sealed_json(tables))
    return path


def _shot(entry: Mapping[str, Any], shots: int) -> int:
    """Return the index of the shot in an entry of the file, which counts from 1.

    Raises ``ValueError`` if the run has no such shot.
    """
    number = entry["shot"]
    if not isinstance(number, int) or not 1 <= number <= shots:
        raise ValueError(f"shot {number!r} of {shots}")
    return number - 1


def _why(entry: Mapping[str, Any]) -> str:
    return printable(str(entry["why"]))[:MAX_WHY]
