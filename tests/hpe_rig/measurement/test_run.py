"""A run as a whole: how often its bench is opened, what waits for the disk, and which times are stored."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from hpe_rig.measurement import Progress, Setup, Step, prepare_text, record_run, run as run_module
from hpe_rig.result import Stages
from hpe_rig.scene import shipped_scenes
from hpe_rig.store import StoreError, WriteOptions, read_run

TEXT = shipped_scenes()["table-1"].replace("pulse_count = 101", "pulse_count = 41").replace("snr_db = 40.0", "")
SWEEP_OF_THE_TWIN = '\n[sweep]\n"simulation.seed" = [1, 2]\n'


@pytest.fixture(scope="module")
def setup() -> Setup:
    return prepare_text("short", TEXT, refuse=False)


def test_a_sweep_of_the_twin_opens_a_simulated_bench_for_each_point_and_a_real_one_once(
    real_bench: Callable[..., Path],
) -> None:
    def shots_by_segment(bench: Path | None) -> list[list[int]]:
        swept = prepare_text("sweep", TEXT + SWEEP_OF_THE_TWIN, bench, refuse=False)
        return [[shot.index for shot in segment.shots] for _, segment in run_module._segments(swept, 0)]

    assert shots_by_segment(None) == [[0], [1]]
    assert shots_by_segment(real_bench()) == [[0, 1]]


@dataclass
class WaitsOfChecks:
    """Recorder that stores for each check of the run file whether it waits for the disk."""

    waits: list[bool] = field(default_factory=list)

    def check_file_present(self, wait: bool) -> None:
        self.waits.append(wait)


def test_no_check_of_the_run_file_waits_for_the_disk_while_outputs_are_on(setup: Setup) -> None:
    recorder = WaitsOfChecks()
    observe = run_module._checking_file(lambda _: None, recorder)  # type: ignore[arg-type]
    for step in Step:
        observe(Progress(step, setup.plan.shots[0]))
    without_wait = [step.value for step, wait in zip(Step, recorder.waits, strict=True) if not wait]
    assert without_wait == ["wait", "fire", "collect"]


@pytest.mark.parametrize("step", [Step.ARM, Step.COLLECT])
def test_a_run_whose_file_is_removed_ends_before_the_next_shot(step: Step, tmp_path: Path) -> None:
    three = prepare_text("three", TEXT.replace("[acquisition]", "[acquisition]\nrepeats = 3"), refuse=False)
    shots: list[int] = []

    def remove(progress: Progress) -> None:
        if progress.step is step:
            shots.append(progress.shot.index)
            for file in tmp_path.iterdir():
                file.unlink()

    with pytest.raises(StoreError, match=r"run\.h5.*removed"):
        record_run(three, tmp_path / "run.h5", remove)
    assert set(shots) == {0}


def test_the_observer_of_a_simulated_run_is_called_in_the_thread_of_the_run(setup: Setup, tmp_path: Path) -> None:
    threads = set[int]()
    record_run(setup, tmp_path / "run.h5", lambda _: threads.add(threading.get_ident()))
    assert threads == {threading.get_ident()}


def test_a_run_file_has_the_name_of_its_scene_unless_it_is_stated(
    setup: Setup, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert record_run(setup) == Path("short.h5")
    # Permission to replace a file that does not exist.
    assert record_run(setup, "stated.h5", options=WriteOptions(overwrite=True)) == Path("stated.h5")


def test_run_times_are_stored_by_step_if_they_are_asked_for(setup: Setup, tmp_path: Path) -> None:
    untimed, timed = (
        record_run(setup, tmp_path / "untimed.h5"),
        record_run(setup, tmp_path / "timed.h5", stages=Stages()),
    )
    assert not read_run(untimed).run_time_s
    times_s = read_run(timed).run_time_s
    assert {"open bench", "configure", "verify", "arm", "enable outputs", "fire", "collect", "store"} <= times_s.keys()
