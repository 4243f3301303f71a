"""Clocks of the bench that are not synchronised: from the instruments to the stored time stamps and the result."""

from pathlib import Path

import h5py
import numpy as np
import pytest

import hpe_rig as hpe
from hpe_rig.bench import read_bench
from hpe_rig.processing import shot_fit

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


def test_no_rate_error_is_claimed_where_a_linear_drift_contains_it(run: hpe.Run) -> None:
    """Its u is part of the drift's: a rate error would be stated with u = 0."""
    (shot,) = run.with_({"processing.drift": "linear"}).estimate().shots
    assert (shot.frequency_error, shot.frequency_error_uncertainty) == (None, None)
    assert not [text for text in shot.warnings if "burst generator's clock" in text]


def test_amplitude_and_phase_of_a_fit_have_the_rate_error_that_its_states_have(run: hpe.Run) -> None:
    scenes = (run.scene.with_({"processing.frequency_accuracy": accuracy}) for accuracy in (0.0, 1e-4))
    exact, uncertain = (shot_fit(scene, run.plan.shots[0], run.stored, "coherent") for scene in scenes)
    # Five strong harmonics, whose u of the phase is that of the error across the phasor to first order.
    for n, (amplitude_m, phase_rad) in enumerate(zip(uncertain.amplitude_m[:5], uncertain.phase_rad[:5], strict=True)):
        across = np.array([-np.sin(phase_rad), np.cos(phase_rad)])
        states_m2 = uncertain.state_covariance[2 * n : 2 * n + 2, 2 * n : 2 * n + 2]
        variance_rad2 = uncertain.covariance[n, 1, 1]
        assert variance_rad2 == pytest.approx(across @ states_m2 @ across / amplitude_m**2, rel=0.01)
        assert variance_rad2 > 1.1 * exact.covariance[n, 1, 1]


@pytest.mark.parametrize("estimator", ["coherent", pytest.param("cross_spectrum", marks=pytest.mark.slow)])
def test_phases_follow_clocks_that_differ_by_more_than_stated_and_warnings_say_so(
    tmp_path: Path, estimator: str
) -> None:
    """60 ppm in 0.3 s shift 1 kHz by 3.2 degrees at the mean time of the pulses, 0.15 s."""
    errors = dict.fromkeys(("master", "toneburst", "tracking_pulser", "digitizer"), 0.0)
    changes = {f"{CLOCKS}.{role}": error for role, error in errors.items()}
    changes |= {f"{CLOCKS}.burst_train": 3e-5, f"{CLOCKS}.tracking_train": -3e-5, "excitation.burst_count": 30}
    run = hpe.measure(hpe.load_scene("free-running-clocks").with_(changes), path=tmp_path / "run.h5")
    (shot,) = run.estimate(estimator).shots
    assert shot.frequency_error is not None
    assert shot.frequency_error_uncertainty is not None
    # 3.5 u: one draw each, and true in 99.95 %.
    assert shot.frequency_error == pytest.approx(6e-5, abs=3.5 * shot.frequency_error_uncertainty)
    for estimate in shot.estimates:
        error_rad, u_rad = estimate.phase_error_rad, estimate.phase_uncertainty_rad
        assert error_rad is not None
        assert abs(error_rad) < 3 * u_rad
        (time_base,) = (component for component in estimate.budget if component.source == "time base")
        assert 0 < time_base.phase_rad < u_rad
    (text,) = (text for text in shot.warnings if "burst generator's clock" in text)
    assert "ppm fast of the digitizer's), more than clock_accuracy explains" in text
    assert "common 10 MHz reference" in text
    # The early tonebursts reach full scale in records before them, whatever the input range.
    assert [text for text in shot.warnings if "all come directly before a toneburst" in text]
    assert not [text for text in shot.warnings if "input_range_v" in text]


def test_clocks_of_one_reference_leave_no_row_and_no_error(tmp_path: Path) -> None:
    changes = {f"{CLOCKS}.{role}": 0.0 for role in ("master", "burst_train", "toneburst", "tracking_train")}
    changes |= {f"{CLOCKS}.{role}": 0.0 for role in ("tracking_pulser", "digitizer")} | {"excitation.burst_count": 10}
    scene = hpe.load_scene("free-running-clocks").with_(changes)
    (shot,) = hpe.measure(scene, path=tmp_path / "run.h5").estimate().shots
    assert shot.frequency_error is None
    assert not [item for estimate in shot.estimates for item in estimate.budget if item.source == "time base"]
    assert not [text for text in shot.warnings if "clock" in text]


def test_a_board_whose_period_is_no_whole_picosecond_has_an_exact_clock(tmp_path: Path) -> None:
    """At 180 MS/s a period of 5556 ps would be 80 ppm too long."""
    bench = tmp_path / "bench.toml"
    bench.write_text(read_bench().text.replace('model = "ATS460"', 'model = "ATS9462"'), encoding="utf-8")
    changes = {"acquisition.sample_rate_hz": 180e6, "excitation.burst_count": 10}
    run = hpe.measure(hpe.load_scene("bovine-muscle").with_(changes), bench=bench, path=tmp_path / "run.h5")
    (shot,) = run.estimate().shots
    assert shot.pulse_rate_error is not None
    assert shot.pulse_rate_uncertainty is not None
    assert abs(shot.pulse_rate_error) < 3 * shot.pulse_rate_uncertainty < 1e-6
    assert not [text for text in shot.warnings if "clock" in text]
