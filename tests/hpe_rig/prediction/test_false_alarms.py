"""The detection floor by simulation: what does not move exceeds it as often as it says, and jitter hardly raises it."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from hpe_rig.prediction.detection import FALSE_ALARMS

SCRIPT = Path(__file__).parents[3] / "scripts" / "validation" / "detection.py"


@pytest.fixture(scope="module")
def detection() -> ModuleType:
    spec = importlib.util.spec_from_file_location("detection_script", SCRIPT)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def share_above_the_floor(detection: ModuleType, snr_db: float, estimator: str, trials: int) -> float:
    """Return the share of ``trials``, new scatterers and new noise in each, that are taken for a motion."""
    floor_m, amplitude_m, _ = detection.at_rest(snr_db, estimator, trials)
    assert amplitude_m.shape == (trials,)
    return float(np.mean(amplitude_m > floor_m))


def within(trials: int) -> float:
    """Return three standard deviations of a binomial share of one in twenty."""
    return 3 * float(np.sqrt(FALSE_ALARMS * (1 - FALSE_ALARMS) / trials))


@pytest.mark.parametrize("snr_db", [10.0, pytest.param(40.0, marks=pytest.mark.slow)])
def test_one_in_twenty_without_motion_exceeds_the_floor(detection: ModuleType, snr_db: float) -> None:
    assert share_above_the_floor(detection, snr_db, "coherent", 200) == pytest.approx(FALSE_ALARMS, abs=within(200))


@pytest.mark.slow
@pytest.mark.parametrize("estimator", ["coherent", "cross_correlation", "kasai", "loupas", "cross_spectrum"])
@pytest.mark.parametrize("snr_db", [0.0, 10.0, 20.0, 40.0])
def test_one_in_twenty_at_any_snr_exceeds_the_floor(detection: ModuleType, snr_db: float, estimator: str) -> None:
    # Where a peak is read its noise is drawn as well, and repeats to 2 %, at 0 dB to 5 %: 2 ln(20) times that of the
    # share.
    known_to = (0.1 if snr_db == 0 else 0.06) if estimator == "cross_spectrum" else 0.0
    drawn = known_to * 2 * np.log(1 / FALSE_ALARMS) * FALSE_ALARMS
    found = share_above_the_floor(detection, snr_db, estimator, 4000)
    assert found == pytest.approx(FALSE_ALARMS, abs=float(np.hypot(within(4000), drawn)))


def test_the_prior_takes_most_of_trigger_jitter_out_of_the_muscles_floor(detection: ModuleType) -> None:
    free_m, free = detection.muscle_at_rest(1e-9, "least_squares", 200)
    held_m, held = detection.muscle_at_rest(1e-9, "medium_prior", 200)
    assert free_m > 5 * held_m
    # One of the two quadratures has nearly all of the noise. What is noise alone the prior shrinks.
    assert np.mean(free > free_m, axis=0).max() == pytest.approx(FALSE_ALARMS, abs=within(200))
    assert np.mean(held > held_m, axis=0).max() < FALSE_ALARMS + within(200)
    assert np.quantile(free, 1 - FALSE_ALARMS, axis=0).max() > 5 * np.quantile(held, 1 - FALSE_ALARMS, axis=0).max()
