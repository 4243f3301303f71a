"""Where a run is written: a new one, one that replaces another, and one that continues another."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from hpe_rig.measurement import Progress, Setup, prepare_resumption, prepare_text, record_run, resume
from hpe_rig.scene import shipped_scenes
from hpe_rig.store import StoreError, WriteOptions, read_run


@pytest.fixture
def setup() -> Setup:
    """Return a small measurement of two shots."""
    text = shipped_scenes()["table-1"].replace("pulse_count = 101", "pulse_count = 48")
    return prepare_text("small", text.replace("[acquisition]", "[acquisition]\nrepeats = 2\nrecord_samples = 256"))


def stop_at_shot_2(progress: Progress) -> None:
    if progress.shot.index == 1:
        raise KeyboardInterrupt


@pytest.mark.parametrize(
    ("path_of", "name"),
    [
        (lambda folder: None, "stopped/run-2.h5"),
        pytest.param(lambda folder: folder / "continued.h5", "continued.h5", marks=pytest.mark.slow),
    ],
    ids=["beside the stopped run", "as named"],
)
def test_a_resumed_run_is_a_new_file(
    setup: Setup, tmp_path: Path, path_of: Callable[[Path], Path | None], name: str
) -> None:
    stopped = tmp_path / "stopped" / "run.h5"
    stopped.parent.mkdir()
    with pytest.raises(KeyboardInterrupt):
        record_run(setup, stopped, stop_at_shot_2)
    content = stopped.read_bytes()
    path = resume(prepare_resumption(stopped), path_of(tmp_path))
    assert path == tmp_path / name
    assert read_run(path).shot_complete.all()
    assert stopped.read_bytes() == content


def test_only_a_run_that_may_replace_others_does_so(setup: Setup, tmp_path: Path) -> None:
    path = tmp_path / "run.h5"
    record_run(setup, path, options=WriteOptions(overwrite=True))
    content, steps = path.read_bytes(), list[Progress]()
    with pytest.raises(StoreError, match="exists"):
        record_run(setup, path, steps.append)
    assert path.read_bytes() == content
    # Refused before the bench is opened.
    assert not steps
