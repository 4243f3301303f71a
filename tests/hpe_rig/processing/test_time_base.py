"""Rate error known from clocks and trigger times: the mean and width of a conditional normal distribution."""

from __future__ import annotations

import numpy as np
import pytest

import hpe_rig as hpe
from hpe_rig.processing.time_base import differs_from_bench, prior_rate_error
from hpe_rig.processing.tracking_rate import TrackingRate

SCENE = hpe.load_scene("free-running-clocks")
PPM = 1e-6


def clocks(motion: float, pulses: float, digitizer: float) -> np.ndarray:
    return np.diag(np.square([motion * PPM, pulses * PPM, digitizer * PPM]))


def test_without_trigger_times_the_accuracies_of_burst_train_and_tracking_train_add() -> None:
    known = prior_rate_error(SCENE, clocks(3, 4, 50), None)
    assert (known.value, known.uncertainty) == (0.0, pytest.approx(5 * PPM))


@pytest.mark.parametrize(
    ("accuracies", "value", "uncertainty"),
    [
        ((3, 4, 0), -6.0, 3.0),  # the digitizer is right: the train is off by all of the measured rate
        ((3, 0, 4), 0.0, 3.0),  # the train is right
        ((3, 4, 4), -3.0, np.sqrt(3**2 + 4**2 / 2)),  # either: half of it, and half of the variance remains
    ],
)
def test_trigger_times_move_and_narrow_the_rate_error(
    accuracies: tuple[float, float, float], value: float, uncertainty: float
) -> None:
    known = prior_rate_error(SCENE, clocks(*accuracies), TrackingRate(6 * PPM, 1e-12))
    assert known.value == pytest.approx(value * PPM, abs=1e-11)
    assert known.uncertainty == pytest.approx(uncertainty * PPM, rel=1e-6)


def test_locked_clocks_have_no_rate_error_whatever_the_trigger_times() -> None:
    locked = np.full((3, 3), (2 * PPM) ** 2)
    locked[2, 2], locked[:2, 2], locked[2, :2] = (25 * PPM) ** 2, 0.0, 0.0
    assert prior_rate_error(SCENE, locked, None).uncertainty == 0
    # Burst train and tracking train share a reference: the measured rate is the digitizer's error alone.
    known = prior_rate_error(SCENE, locked, TrackingRate(20 * PPM, 1e-9))
    assert (known.value, known.uncertainty) == (0.0, 0.0)


def test_clocks_that_differ_by_more_than_stated_widen_the_rate_error() -> None:
    rate = TrackingRate(100 * PPM, 1e-9)
    assert differs_from_bench(clocks(2, 2, 2), rate)
    assert not differs_from_bench(clocks(2, 2, 40), rate)
    known = prior_rate_error(SCENE, clocks(2, 2, 2), rate)
    # Either clock may be wrong by the whole difference: half of it, known to 100 ppm / sqrt(2).
    assert known.value == pytest.approx(-50 * PPM, rel=0.01)
    assert known.uncertainty == pytest.approx(100 * PPM / np.sqrt(2), rel=0.01)


def test_a_stated_accuracy_of_the_frequencies_replaces_the_clocks() -> None:
    stated = SCENE.with_({"processing.frequency_accuracy": 7e-6})
    known = prior_rate_error(stated, clocks(2, 2, 2), TrackingRate(100 * PPM, 1e-9))
    assert (known.value, known.uncertainty) == (0.0, 7e-6)
    assert prior_rate_error(SCENE, None, None).uncertainty == 50e-6
