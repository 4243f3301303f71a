"""Shipped scenes with edited text, and the table of a run's result, for the other scripts of this folder."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from hpe_rig.measurement import Setup, prepare_text
from hpe_rig.runs import process
from hpe_rig.scene import shipped_scenes


def prepare_edited(name: str, *edits: tuple[str, str]) -> Setup:
    """Prepare a shipped scene on the simulated bench, each (old, new) pair of ``edits`` replaced in its text."""
    text = shipped_scenes()[name]
    for old, new in edits:
        if old not in text:
            raise SystemExit(f"the scene {name} does not contain {old!r}")
        text = text.replace(old, new)
    return prepare_text(name, text)


def result_table(path: Path) -> dict[str, Any]:
    """Process a run file and return its result without the file's name and the run times."""
    result = process(path).as_dict()
    return {key: value for key, value in result.items() if key not in ("run_file", "run_time_s")}
