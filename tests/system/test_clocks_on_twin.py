"""Clocks of the bench that are not synchronised: from the instruments to the stored time stamps and the result."""

from pathlib import Path

import h5py
import numpy as np
import pytest

import hpe_rig as hpe

CLOCKS = "simulation.instruments.clock_error"


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> hpe.Run:
    """Return a run of the shipped scene with a tenth of its tonebursts."""
    scene = hpe.load_scene("free-running-clocks").with_({"excitation.burst_count": 10})
    return hpe.measure(scene, path=tmp_path_factory.mktemp("clocks") / "run.h5")


def true_rate_error() -> float:
    errors = hpe.load_scene("free-running-clocks").simulation["instruments"]["clock_error"]
    return (1 + errors["tracking_train"]) / (1 + errors["digitizer"]) - 1


def test_stored_trigger_times_drift_by_the_difference_of_two_clocks(run: hpe.Run) -> None:
    with h5py.File(run.path) as file:
        time_s = file["records/trigger_time_s"][0]
    period_s = np.polyfit(np.arange(time_s.size), time_s, 1)[0]
    # Time stamps have steps of 20 ns, in 0.1 s.
    assert 1 / (period_s * 3990.0) - 1 == pytest.approx(true_rate_error(), abs=0.05e-6)
    assert abs(true_rate_error()) > 5e-6


def test_the_result_states_the_rate_error_of_the_train(run: hpe.Run) -> None:
    result = run.estimate()
    (shot,) = result.as_dict()["shots"]
    assert shot["pulse_rate_error"] == pytest.approx(true_rate_error(), abs=2 * shot["pulse_rate_uncertainty"])
    assert 0 < shot["pulse_rate_uncertainty"] < 0.3e-6
    # In 0.1 s the error of the phase is far below its uncertainty.
    assert not [text for text in result.shots[0].warnings if "clock" in text]


def test_a_rate_error_that_exceeds_the_uncertainty_of_a_phase_is_a_warning(tmp_path: Path) -> None:
    """An error of 1e-4 shifts 300 Hz by 360 deg x 1e-4 x 300 Hz x 60 ms, the mean time of the pulses: 0.65 deg."""
    changes = {"excitation.burst_count": 10, f"{CLOCKS}.tracking_train": 1e-4, f"{CLOCKS}.digitizer": 0.0}
    scene = hpe.load_scene("free-running-clocks").with_(changes | {"processing.window_start_s": 0.02})
    (shot,) = hpe.measure(scene, path=tmp_path / "run.h5").estimate().shots
    (text,) = (text for text in shot.warnings if "digitizer's clock" in text)
    assert "tracking train is 100." in text
    assert "ppm fast" in text
    assert "at 300 Hz is off by 0.65 deg" in text
