"""Scenes with a few keys changed, and whole measurements on the twin."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from hpe_rig.measurement.run import record_run
from hpe_rig.measurement.setup import Setup, prepare
from hpe_rig.result import Result
from hpe_rig.runs.run import process
from hpe_rig.scene import shipped_scenes

Prepare = Callable[..., Setup]
Measure = Callable[..., Result]


@pytest.fixture(autouse=True)
def ctrl_c_is_heard() -> Iterator[None]:
    """Have SIGINT interrupt here and in processes started here even where the suite runs in the background.

    A shell starts what it puts there with SIGINT ignored.
    """
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.fixture
def prepared(tmp_path: Path) -> Prepare:
    """Return a function that prepares a shipped scene with pieces of its text replaced."""

    def prepare_edited(name: str, *edits: tuple[str, str], bench: Path | None = None) -> Setup:
        text = shipped_scenes()[name]
        for old, new in edits:
            assert old in text, old
            text = text.replace(old, new)
        path = tmp_path / f"{name}.toml"
        path.write_text(text, encoding="utf-8")
        return prepare(str(path), bench)

    return prepare_edited


@pytest.fixture
def measured(tmp_path: Path, prepared: Prepare) -> Measure:
    """Return a function that measures a shipped scene with pieces of its text replaced, and returns the result."""

    def measure_edited(
        name: str, *edits: tuple[str, str], bench: Path | None = None, estimator: str | None = None
    ) -> Result:
        run_file = record_run(
            prepared(name, *edits, bench=bench), tmp_path / f"{name}-{len(list(tmp_path.iterdir()))}.h5"
        )
        return process(run_file, estimator)

    return measure_edited
