"""The projection of a medium prior onto the pulses of a train, of which many may sense the same instant."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.typing import NDArray

from hpe_rig.medium import BeamWidths
from hpe_rig.processing.harmonics.medium_prior import medium_prior
from hpe_rig.processing.harmonics.projected_prior import HARMONIC_DEVIATION, project_prior

BEAMS = BeamWidths((0.17e-3, 0.17e-3, 1.80e-3), (0.078e-3, 0.078e-3, 0.83e-3), 0.3e-3)
RATE_HZ, LENGTH_S = 100.0, 100e-6
WANTED_HZ = RATE_HZ * np.arange(1.0, 11.0)
PRIOR = medium_prior(BEAMS, RATE_HZ, LENGTH_S)


@dataclass(frozen=True)
class Pulses:
    """When pulses sense the motion, s after a burst's onset, and which of them no burst disturbs."""

    time_s: NDArray[np.float64]
    valid: NDArray[np.bool_]


def pulses(rate_hz: float, delay_s: float) -> Pulses:
    """Return the pulses of 0.15 s."""
    time_s = 0.05 + delay_s + np.arange(round(0.15 * rate_hz)) / rate_hz
    inside = time_s % (1 / RATE_HZ)
    return Pulses(time_s, (inside > 105e-6) & (inside < 1 / RATE_HZ - 95e-6))


SHIFTING, AT_4000 = pulses(3990.0, 131e-6), pulses(4000.0, 130e-6)


def test_a_train_of_the_same_times_is_not_worked_out_again() -> None:
    first = project_prior(PRIOR, SHIFTING.time_s, SHIFTING.valid, WANTED_HZ)
    assert project_prior(PRIOR, SHIFTING.time_s.copy(), SHIFTING.valid.copy(), WANTED_HZ) is first
    assert medium_prior(BEAMS, RATE_HZ, LENGTH_S) is medium_prior(BEAMS, RATE_HZ, LENGTH_S)


@pytest.mark.parametrize(("rate_hz", "pulse_rate_hz", "instants"), [(100, 5000, 50), (100, 200, 2), (50, 3990, 399)])
def test_instants_are_counted_for_trains_of_any_length(rate_hz: float, pulse_rate_hz: float, instants: int) -> None:
    prior = replace(PRIOR, burst_rate_hz=rate_hz)
    for delay_s in (0.0, 131e-6):
        # a minute, in whose last periods an angle is known to 1e-11, and the middle of a period, where it turns over
        time_s = delay_s + np.arange(round(60 * pulse_rate_hz)) / pulse_rate_hz
        assert prior.instant_count(time_s) == pytest.approx(instants, rel=1e-9)


def test_imported_times_with_jitter_count_as_one_instant() -> None:
    """50 ns: far less than any harmonic takes, and what the model leaves untold is the same in every period."""
    time_s = np.arange(6000) / 5000.0 + 50e-9 * np.random.default_rng(5).standard_normal(6000)
    assert PRIOR.instant_count(time_s) == pytest.approx(50, rel=1e-9)
    everywhere = np.sort(np.random.default_rng(6).uniform(0, 1, 40_000))
    assert 6_500 < PRIOR.instant_count(everywhere) < 10_000


@pytest.mark.parametrize("order", [0, 1])
def test_repeated_instants_give_the_projection_of_separate_pulses(order: int) -> None:
    """One row for each instant; with a background of order 1, one for each pulse."""
    train = AT_4000
    projected = project_prior(PRIOR, train.time_s, train.valid, WANTED_HZ, order)
    used = train.time_s[train.valid]
    rows, wanted_columns = PRIOR.displacement_matrices(used, range(10))
    power = np.sum((PRIOR.states_of_response(range(10)) @ PRIOR.response_root) ** 2, axis=1).reshape(-1, 2).mean(axis=1)
    factor = np.hstack([rows @ PRIOR.response_root, wanted_columns * HARMONIC_DEVIATION * np.sqrt(np.repeat(power, 2))])
    moving = factor - projected.background @ (projected.background.T @ factor)
    left, value = projected.patterns, projected.pattern_sd
    # A F F' A' = U diag(l²) U', which a decomposition has whatever its signs
    np.testing.assert_allclose((left * value**2) @ left.T, moving @ moving.T, atol=1e-9 * value[0] ** 2)
    np.testing.assert_allclose(left.T @ left, np.eye(value.size), atol=1e-4)


@pytest.mark.parametrize("train", [SHIFTING, AT_4000], ids=["shifting", "synchronous"])
def test_what_pulses_of_an_instant_share_is_in_the_residual_or_in_the_allowance(train: Pulses) -> None:
    projected = project_prior(PRIOR, train.time_s, train.valid, WANTED_HZ)
    instant = np.round(train.time_s[train.valid] * RATE_HZ % 1, 9)
    _, first, repeats = np.unique(instant, return_index=True, return_inverse=True)
    shared_error = np.random.default_rng(9).standard_normal((400, first.size))[:, repeats]
    shared_error -= (shared_error @ projected.background) @ projected.background.T
    left = shared_error - (shared_error @ projected.patterns) @ projected.patterns.T
    degrees = instant.size - 1 - projected.pattern_sd.size
    residual = np.mean(np.sum(left**2, axis=-1)) / degrees
    # all of it: of the mean over an instant's pulses, counted for each as if they were independent
    assert residual + projected.hidden_variance_factor == pytest.approx(instant.size / first.size, rel=0.02)


def test_pulses_at_distinct_instants_have_no_hidden_model_error() -> None:
    train = pulses(3989.0, 131e-6)
    assert project_prior(PRIOR, train.time_s, train.valid, WANTED_HZ).hidden_variance_factor == pytest.approx(
        0, abs=1e-9
    )
