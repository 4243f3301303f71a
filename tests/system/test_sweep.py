"""Sweeps over pulse rates and windows: one run, one report, resumed as if it had not stopped."""

import numpy as np
import pytest

from hpe_rig.measurement.resumption import prepare_resumption, resume
from hpe_rig.measurement.run import record_run
from hpe_rig.measurement.sequencer import Step
from hpe_rig.report.sweep import make_sweep
from hpe_rig.runs.run import process
from hpe_rig.scene import SettingsError, parse_scene, shipped_scenes

SHORT = (
    ("repeats = 5", "repeats = 1"),
    ("burst_count = 20", "burst_count = 6"),
    ("window_start_s = 50e-3", "window_start_s = 20e-3"),
    ("window_length_s = 100e-3", "window_length_s = 40e-3"),
    ("pulse_rate_hz = [2000.0, 2500.0, 3000.0, 4000.0]", "pulse_rate_hz = [2500.0, 4000.0]"),
)


def test_every_pulse_rate_is_a_shot_with_the_same_frequencies_and_pulses(prepared):
    setup = prepared("muscle-pulse-rate", *SHORT)
    shots = setup.plan.shots
    assert [shot.tracking_train.rate_hz for shot in shots] == [2500.0, 4000.0]
    assert [shot.index for shot in shots] == [0, 1]
    assert {shot.capture.record_count for shot in shots} == {240}
    assert setup.scene.scene.wanted_frequencies_hz == tuple(100.0 * n for n in range(1, 11))


@pytest.mark.slow
def test_a_sweep_that_was_interrupted_goes_on_to_the_same_result(prepared, tmp_path):
    setup = prepared("muscle-pulse-rate", *SHORT)
    whole = process(record_run(setup, tmp_path / "whole.h5"))

    def stop(progress):
        if progress.shot.index == 1 and progress.step is Step.COLLECT:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        record_run(setup, tmp_path / "cut.h5", stop)
    rest = process(resume(prepare_resumption(tmp_path / "cut.h5"), tmp_path / "rest.h5"))
    assert [shot.estimates for shot in rest.shots] == [shot.estimates for shot in whole.shots]
    sweep = make_sweep(whole.shots)
    assert sweep is not None
    assert sweep.label == "pulse rate f_prf (Hz)"
    assert sweep.curves[0].x.tolist() == [2500.0, 4000.0]


def test_windows_are_taken_from_the_same_records(prepared, tmp_path):
    both = ("window_length_s = [50e-3, 100e-3, 150e-3, 200e-3]", "window_length_s = [20e-3, 40e-3]")
    edits = (*SHORT[:1], ("burst_count = 20", "burst_count = 5"), both)
    setup = prepared("muscle-window", *edits)
    shots = process(record_run(setup, tmp_path / "a.h5")).shots
    assert len(setup.plan.shots) == 1
    assert [shot.window_length_s for shot in shots] == [20e-3, 40e-3]
    assert [shot.pulses_used for shot in shots] == [80, 160]
    found = [shot.estimates[0].tracked_amplitude_uncertainty_m for shot in shots]
    # Twice the pulses: the variance halves, and is itself known to sqrt(2 / 40).
    assert found[0] / found[1] == pytest.approx(np.sqrt(2), rel=0.5)


def test_slower_trains_need_a_window():
    text = shipped_scenes()["muscle-pulse-rate"].replace("window_length_s = 100e-3", "#")
    with pytest.raises(
        SettingsError, match=r"sweep.pulse_rate_hz gives slower trains .* set processing.window_length_s"
    ):
        parse_scene("a", text)


def test_every_rate_of_a_sweep_is_checked(prepared):
    from hpe_rig.plan.checks.check_result import PlanError

    with pytest.raises(PlanError, match="12000"):
        prepared("muscle-pulse-rate", *SHORT[:4], ("3000.0, 4000.0]", "3000.0, 12000.0]"))
