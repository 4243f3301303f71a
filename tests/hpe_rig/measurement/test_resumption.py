"""Where a run is written: a new one, one that replaces another, and one that continues another."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hpe_rig.measurement import (
    Progress,
    Setup,
    prepare_resumption,
    prepare_text,
    provenance_now,
    record_run,
    resume,
    resumption as resumption_module,
)
from hpe_rig.scene import shipped_scenes
from hpe_rig.store import StoreError, WriteOptions, new_run_id, read_run


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


@pytest.fixture(scope="module")
def stopped_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a run with its first shot of two, made on the shipped bench."""
    path = tmp_path_factory.mktemp("stopped") / "run.h5"
    text = shipped_scenes()["table-1"].replace("pulse_count = 101", "pulse_count = 48")
    scene = prepare_text("small", text.replace("[acquisition]", "[acquisition]\nrepeats = 2\nrecord_samples = 256"))
    with pytest.raises(KeyboardInterrupt):
        record_run(scene, path, stop_at_shot_2)
    return path


def test_another_scene_bench_or_scan_than_that_of_the_run_is_refused(
    stopped_run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stored = read_run(stopped_run)
    scene, bench = tmp_path / "small.toml", tmp_path / "bench.toml"
    scene.write_text(f"# A comment changes nothing.\n{stored.scene_toml}", "utf-8")
    bench.write_text(stored.bench_toml.replace("[digitizer]", '[digitizer]\nserial = "460001"'), "utf-8")
    for chosen in (None, scene):
        resumption = prepare_resumption(stopped_run, chosen, bench)
        assert (resumption.complete, len(resumption.setup.plan.shots)) == (1, 2)
    scene.write_text(stored.scene_toml.replace("seed = 1", "seed = 2"), "utf-8")
    bench.write_text(stored.bench_toml.replace("max_duty = 0.05", "max_duty = 0.04"), "utf-8")
    with pytest.raises(StoreError, match=r"measured with another scene than small is now.*Try: resume without"):
        prepare_resumption(stopped_run, scene)
    with pytest.raises(StoreError, match=r"measured on bench simulated, which differs from bench bench.*Try: --bench"):
        prepare_resumption(stopped_run, None, bench)
    for digest, other in (("0" * 64, "1" * 64), ("0" * 64, "0" * 64)):
        monkeypatch.setattr(resumption_module, "read_run", lambda path, d=digest: replace(stored, scan_sha256=d))
        monkeypatch.setattr(resumption_module, "sha256_of_scan", lambda scene, d=other: d)
        if digest == other:
            assert prepare_resumption(stopped_run).complete == 1
        else:
            with pytest.raises(StoreError, match=r"another content of the file beams\.excitation_scan"):
                prepare_resumption(stopped_run)


def test_a_run_that_is_complete_in_progress_or_imported_is_not_resumed_and_a_damaged_shot_is_measured_again(
    stopped_run: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stored = read_run(stopped_run)
    whole = replace(stored, shot_complete=np.ones(2, bool))
    monkeypatch.setattr(resumption_module, "read_run", lambda path: whole)
    monkeypatch.setattr(type(stored), "is_intact", lambda run, shot: True)
    with pytest.raises(StoreError, match=r"has all of its 2 shots\. Try: hpe-rig process"):
        prepare_resumption(stopped_run)
    # Every shot after a damaged one is measured again too.
    monkeypatch.setattr(type(stored), "is_intact", lambda run, shot: shot != 0)
    assert prepare_resumption(stopped_run).complete == 0
    monkeypatch.setattr(resumption_module, "is_locked", lambda path: True)
    with pytest.raises(StoreError, match="is being written by a run"):
        prepare_resumption(stopped_run)
    recording = {"source": "a.npy", "sha256": "0" * 64, "format": "npy", "first_sample_s": 0.0}
    lines = "".join(f"{key} = {value!r}\n" for key, value in recording.items())
    imported = replace(stored, bench_toml=f"{stored.bench_toml}\n[recording]\n{lines}")
    monkeypatch.setattr(resumption_module, "read_run", lambda path: imported)
    with pytest.raises(StoreError, match=r"was imported from a\.npy: no instrument can continue it"):
        prepare_resumption(stopped_run)


def test_marks_of_copied_shots_stay_and_those_of_shots_that_are_measured_again_do_not(
    stopped_run: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    resumption = prepare_resumption(stopped_run)
    marked = replace(resumption, earlier=replace(resumption.earlier, marks={0: "the bottle moved", 1: "the pump"}))
    provenance = provenance_now(resumption.setup.bench.bench)
    options = WriteOptions(run_id=new_run_id(), provenance=provenance)
    path = resume(marked, tmp_path / "continued.h5", options=options)
    stored = read_run(path)
    assert list(stored.marks) == [0]
    assert "the bottle moved" in stored.marks[0]
    assert stored.predecessor == "run.h5"
    copied, first = stored.records[0].codes, resumption.earlier.records[0].codes
    assert np.array_equal(copied, first)


def test_only_a_run_that_may_replace_others_does_so(setup: Setup, tmp_path: Path) -> None:
    path = tmp_path / "run.h5"
    record_run(setup, path, options=WriteOptions(overwrite=True))
    content, steps = path.read_bytes(), list[Progress]()
    with pytest.raises(StoreError, match="exists"):
        record_run(setup, path, steps.append)
    assert path.read_bytes() == content
    # Refused before the bench is opened.
    assert not steps
