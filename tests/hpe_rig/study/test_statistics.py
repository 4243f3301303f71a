"""Bias, jitter, their split and their stated errors, against samples whose values are known."""

from __future__ import annotations

import numpy as np
import pytest

from hpe_rig.study.statistics import errors, phase_errors, wrapped

STUDIES = 400


def _nested(rng: np.random.Generator, draws: int, repeats: int) -> np.ndarray:
    """Return deviations (draw, noise): bias 0.5, speckle 2, noise 3."""
    return 0.5 + 2 * rng.standard_normal((draws, 1)) + 3 * rng.standard_normal((draws, repeats))


def test_bias_and_jitter_are_those_of_the_paper() -> None:
    sample = _nested(np.random.default_rng(1), 50, 3)
    found = errors(sample)
    assert found.bias == pytest.approx(sample.mean(), abs=1e-14)
    assert found.jitter == pytest.approx(np.sqrt(np.mean((sample - sample.mean()) ** 2)), abs=1e-14)


def test_noise_and_speckle_add_up_to_the_jitter() -> None:
    found = errors(_nested(np.random.default_rng(2), 200, 4))
    assert found.noise_jitter**2 + found.speckle_jitter**2 == pytest.approx(found.jitter**2, rel=1e-12)


def test_two_draws_say_nothing_of_how_far_their_jitter_is_known() -> None:
    two, three = (errors(_nested(np.random.default_rng(4), draws, 1)) for draws in (2, 3))
    assert np.isfinite([two.bias_se, two.jitter]).all()
    assert np.isnan(two.jitter_se)
    assert three.jitter_se > 0


@pytest.mark.parametrize("repeats", [2, 8])
def test_the_split_and_the_stated_errors_are_true(repeats: int) -> None:
    rng = np.random.default_rng(3)
    every = [errors(_nested(rng, 100, repeats)) for _ in range(STUDIES)]
    truth = {"bias": 0.5, "jitter": np.sqrt(13), "noise_jitter": 3.0, "speckle_jitter": 2.0}
    for name, value in truth.items():
        found = np.array([getattr(one, name) for one in every])
        stated = np.array([getattr(one, f"{name}_se") for one in every])
        # A standard deviation from 400 studies is known to 1/sqrt(800) = 3.5 %: three of them, and twice that for
        # speckle, whose root bends where one study knows it to 20 % only.
        assert found.std() == pytest.approx(stated.mean(), rel=0.11 if name != "speckle_jitter" else 0.22)
        # Squares average to the variances: three errors of their mean, and 1 / draws, as eq. (15) is not corrected.
        square = found**2 if name != "bias" else found
        assert square.mean() == pytest.approx(
            value**2 if name != "bias" else value, abs=_three(square) + value**2 / 100
        )


def _three(values: np.ndarray) -> float:
    return float(3 * values.std() / np.sqrt(values.size))


def test_without_repeats_there_is_no_split_and_without_speckle_it_is_zero() -> None:
    rng = np.random.default_rng(4)
    assert np.isnan(errors(rng.standard_normal((20, 1))).noise_jitter)
    alone = errors(np.tile(rng.standard_normal((20, 1)), 3))
    assert alone.noise_jitter == pytest.approx(0.0, abs=1e-8)
    assert alone.speckle_jitter == pytest.approx(alone.jitter, rel=1e-12)


def test_a_phase_is_averaged_on_the_circle() -> None:
    rng = np.random.default_rng(5)
    phase = 3.0 + 0.4 * rng.standard_normal((300, 2))
    plain = errors(phase - 2.9)
    for turned in (phase, wrapped(phase), phase + 2 * np.pi):
        found = phase_errors(turned, 2.9)
        assert found.jitter == pytest.approx(plain.jitter, rel=1e-2)
        # Circular and plain mean of 600 normal phases differ by their skewness alone.
        assert found.bias == pytest.approx(plain.bias, abs=0.4**3 / np.sqrt(600) * 3)


def test_a_phase_about_which_nothing_is_known_has_the_jitter_of_a_uniform_one() -> None:
    phase = np.random.default_rng(6).uniform(-np.pi, np.pi, (20_000, 2))
    # 40 000 values: 1/sqrt(40 000) of a mean square, three times, halved by the root; and the mean's freedom.
    assert phase_errors(phase, 0.0).jitter == pytest.approx(np.pi / np.sqrt(3), rel=0.01)


@pytest.mark.parametrize("spread_rad", [pytest.param(0.2, marks=pytest.mark.slow), 1.5])
def test_the_stated_error_of_a_phase_bias_is_true_however_wide_the_phases_are(spread_rad: float) -> None:
    rng = np.random.default_rng(8)
    every = [phase_errors(2.0 + spread_rad * _halves(rng), 0.5) for _ in range(STUDIES)]
    found, stated = np.array([(one.bias, one.bias_se) for one in every]).T
    # As above; and 400 phases know a resultant of exp(-1.5^2 / 2) = 0.32 to 12 %, which bends the mean by its square.
    assert found.std() == pytest.approx(stated.mean(), rel=0.11 + 0.12**2)
    assert found.mean() == pytest.approx(1.5, abs=_three(found))


def _halves(rng: np.random.Generator) -> np.ndarray:
    """Return normal values (draw, noise) of variance 1, half of which is the draw's."""
    return (rng.standard_normal((200, 1)) + rng.standard_normal((200, 2))) / np.sqrt(2)


def test_the_error_of_a_phase_bias_is_never_above_that_of_an_unknown_phase() -> None:
    opposite = np.array([[0.0, 0.0], [np.pi - 1e-6, np.pi - 1e-6]])
    assert phase_errors(opposite, 0.0).bias_se == pytest.approx(np.pi / np.sqrt(3))
    assert np.isnan(phase_errors(np.array([[0.1, 0.2]]), 0.0).bias_se)


def test_draws_with_a_refused_realisation_are_left_out() -> None:
    sample = _nested(np.random.default_rng(7), 30, 2)
    holed = np.vstack([sample, [[np.nan, 1e9]]])
    assert errors(holed) == errors(sample)
    assert np.isnan(errors(np.full((3, 2), np.nan)).bias)
    assert np.isnan(phase_errors(np.full((3, 2), np.nan), 0.0).jitter)
