"""What the live page is told of a run: estimates of its shots, time left, how it ended."""

from __future__ import annotations

import json
import math
import re
from importlib import resources
from pathlib import Path

import pytest

from hpe_rig import sweep
from hpe_rig.live.history import RemainingTime
from hpe_rig.live.server import ENDED
from hpe_rig.live.source import RunSource
from hpe_rig.measurement.requests import request_stop, stop_path
from hpe_rig.measurement.run import record_run
from hpe_rig.measurement.sequencer import Progress, Step
from hpe_rig.measurement.setup import prepare
from hpe_rig.runs.run import process
from hpe_rig.scene import load_scene
from hpe_rig.store import StoreError
from hpe_rig.store.format import STATUSES


@pytest.fixture(scope="module")
def run_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record_run(prepare("table-1"), tmp_path_factory.mktemp("live") / "run.h5")


def test_a_run_that_has_ended_is_not_asked_to_stop(run_file: Path) -> None:
    with pytest.raises(StoreError, match="nothing to stop"):
        RunSource(run_file).stop()
    assert not stop_path(run_file).exists()


def test_the_source_shows_what_the_result_says(run_file: Path) -> None:
    source = RunSource(run_file)
    state = source.poll()
    assert state is not None
    (estimate,) = process(run_file).shots[0].estimates
    (harmonic,) = state["harmonics"]
    assert estimate.corrected
    assert harmonic["nm"] == pytest.approx(estimate.amplitude_m * 1e9, rel=1e-5)
    # The page has no ends of the gate in u, 1e-4 of the amplitude.
    assert harmonic["u_nm"] == pytest.approx(estimate.amplitude_uncertainty_m * 1e9, rel=1e-4)
    assert harmonic["deg"] == pytest.approx(math.degrees(estimate.phase_rad), rel=1e-5)
    assert harmonic["u_deg"] == pytest.approx(math.degrees(estimate.phase_uncertainty_rad), rel=1e-4)
    assert (state["records"], state["records_planned"], state["status"]) == (101, 101, "complete")
    assert state["simulated"] is True
    (shot,) = state["over_shots"]
    assert shot["nm"] == [harmonic["nm"]]
    assert shot["u_nm"] == [harmonic["u_nm"]]
    assert len(json.dumps(state, allow_nan=False)) < 100_000
    assert source.poll() is None


def test_shots_at_different_points_of_a_sweep_have_no_common_mean(tmp_path: Path) -> None:
    scene = load_scene("table-1").with_(
        {"acquisition.repeats": 2, "tracking.pulse_count": 20, "acquisition.record_samples": 256}
    )
    path = sweep(scene, {"tracking.delay_s": [0.0, 1e-4]}, path=tmp_path / "run.h5").path
    # Estimates of many shots take several states.
    *_, state = iter(RunSource(path).poll, None)
    assert (len(state["over_shots"]), state["mean_of"], len(state["means"])) == (4, 2, 1)


def test_the_time_left_follows_from_the_records_so_far_and_a_pause_does_not_count(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    now_s = [100.0]
    monkeypatch.setattr("hpe_rig.live.history.time.monotonic", lambda: now_s[0])
    clock = RemainingTime()
    assert clock.remaining_s(10, 110, running=True) is None
    now_s[0] += 5.0
    assert clock.remaining_s(60, 110, running=True) == 5.0
    now_s[0] += 1000.0
    assert clock.remaining_s(60, 110, running=False) is None
    assert clock.remaining_s(60, 110, running=True) is None
    now_s[0] += 1.0
    assert clock.remaining_s(85, 110, running=True) == 1.0


def test_a_file_that_is_not_there_yet_is_waited_for(tmp_path: Path, run_file: Path) -> None:
    source = RunSource(tmp_path / "later.h5")
    first = source.poll()
    assert first is not None
    assert first["status"] == "waiting"
    assert source.poll() is None
    (tmp_path / "later.h5").write_bytes(run_file.read_bytes())
    state = source.poll()
    assert state is not None
    assert state["status"] == "complete"


def test_nothing_is_estimated_for_the_page_while_somebody_waits_for_the_run_to_stop(tmp_path: Path) -> None:
    run_file, states = tmp_path / "run.h5", []
    source = RunSource(run_file)

    def look(progress: Progress) -> None:
        if progress.step is Step.SAFE:
            states.append(source.poll() or {})
            request_stop(run_file)
            states.append(source.poll() or {})

    record_run(prepare("table-1"), run_file, look)
    states.append(source.poll() or {})
    assert [state["status"] for state in states] == ["running", "running", "complete"]
    # Of a run that has ended nobody waits for a stop any more.
    assert [state["stop_requested"] for state in states] == [False, True, False]
    assert ["harmonics" in state for state in states] == [True, False, True]
    assert states[1]["records"] == states[0]["records"] > 0


def test_every_way_in_which_a_run_ends_has_words_of_its_own() -> None:
    """A killed program has verified no output off, so that its words must not be those of a stopped run."""
    page = (resources.files("hpe_rig.live") / "live.html").read_text(encoding="utf-8")
    for status in set(STATUSES) - {"running"}:
        assert status in ENDED
        assert re.search(rf'\b{status}: "\w', page)
    assert re.search(r'killed: "[^"]*MAY STILL BE ON', page)
