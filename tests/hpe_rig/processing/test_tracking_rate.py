"""Rate of the tracking train from trigger times: true within its uncertainty, and absent where it is not certain."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hpe_rig.arrays import BoolArray, FloatArray
from hpe_rig.processing.tracking_rate import TrackingRate, measured_rate
from hpe_rig.store import Placement

RATE_HZ, SAMPLE_RATE_HZ = 3990.0, 100e6


def placement(delivered: BoolArray) -> Placement:
    """Return the placement of records of which each has the number of its pulse."""
    return Placement(np.where(delivered, np.arange(delivered.size), -1), delivered, np.zeros(delivered.size, bool))


def stamps(error: float, start_s: float, pulses: int = 800, step: int = 2, jitter_s: float = 0.0) -> FloatArray:
    """Return trigger times of a train whose rate is off by ``error``, in steps of ``step`` samples."""
    rng = np.random.default_rng(1)
    time_s = start_s + np.arange(pulses) / (RATE_HZ * (1 + error)) + jitter_s * rng.standard_normal(pulses)
    return np.floor(time_s * SAMPLE_RATE_HZ / step) * step / SAMPLE_RATE_HZ


def rate_of(time_s: FloatArray, rate_hz: float = RATE_HZ) -> TrackingRate:
    rate = measured_rate(time_s, placement(np.isfinite(time_s)), rate_hz, SAMPLE_RATE_HZ)
    assert rate is not None
    return rate


@pytest.mark.parametrize("step", [1, 2, 16])
@pytest.mark.parametrize("jitter_s", [0.0, 1e-9, 100e-9])
def test_the_rate_is_within_twice_its_uncertainty(step: int, jitter_s: float) -> None:
    rng = np.random.default_rng(2)
    errors = rng.normal(0, 1e-5, 200)
    deviations = []
    for error in errors:
        rate = rate_of(stamps(error, rng.uniform(0.01, 0.02), step=step, jitter_s=jitter_s))
        deviations.append((rate.error - error) / rate.uncertainty)
    # The stamps of one seed share their jitter, so that its deviation is common to all.
    assert np.abs(deviations).max() < 2.0


def test_a_drift_below_one_step_of_the_counter_is_not_taken_for_a_perfect_clock() -> None:
    """At 4 kHz every period has whole steps: a drift of 16 ns in 0.2 s leaves all stamps but the last as they were."""
    time_s = np.floor((0.01 + np.arange(800) * 250e-6 * (1 + 8e-8)) * 50e6) / 50e6
    rate = rate_of(time_s, 4000.0)
    assert abs(rate.error + 8e-8) < 2 * rate.uncertainty


def test_missing_records_do_not_change_the_rate() -> None:
    time_s = stamps(2e-5, 0.01)
    time_s[100:400] = np.nan
    rate = rate_of(time_s)
    assert rate.error > 3 * rate.uncertainty
    assert rate.error == pytest.approx(2e-5, abs=2 * rate.uncertainty)


def test_no_rate_is_stated_without_certain_times() -> None:
    time_s = stamps(2e-5, 0.01)
    certain = placement(np.ones(800, bool))
    assert measured_rate(np.full(800, np.nan), certain, RATE_HZ, SAMPLE_RATE_HZ) is None
    assert measured_rate(time_s[:9], placement(np.ones(9, bool)), RATE_HZ, SAMPLE_RATE_HZ) is None
    for fault in ({"remarks": ("the trigger times jump",)}, {"loose": np.arange(800) == 400}):
        assert measured_rate(time_s, replace(certain, **fault), RATE_HZ, SAMPLE_RATE_HZ) is None
