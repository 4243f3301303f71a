"""Budget of an estimate: its components in squares are its uncertainty, each from what is known of it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.special import stdtrit

from hpe_rig.processing.budget import SPECKLE_KURTOSIS, ErrorSources, estimates_of, with_second_order_speckle
from hpe_rig.processing.harmonics.harmonic_fit import FitQuality, HarmonicFit, fit_from_state
from hpe_rig.processing.motion.displacement import Motion
from hpe_rig.processing.shot_fitting import carrier_error
from hpe_rig.result import Averaging, Component, Estimate

AVERAGING = Averaging(0.9, -0.02, 0.03, 0.018, 0.004, speckle_phase_rad=0.002, offset_relative=0.01)


def fit(residual_m: float = 1e-8, degrees_of_freedom: float = math.inf) -> HarmonicFit:
    """Return a fit of 100 nm and 0.3 rad with 1 nm of noise in either quadrature."""
    state = 1e-7 * np.array([math.cos(0.3), math.sin(0.3)])
    return fit_from_state(
        np.array([200.0]), state, 1e-18 * np.eye(2), FitQuality(np.asarray(residual_m), degrees_of_freedom, 100)
    )


def parts(estimate: Estimate) -> dict[str, Component]:
    return {each.source: each for each in estimate.budget}


def test_the_root_sum_of_squares_of_the_components_is_the_headlines_uncertainty() -> None:
    (estimate,) = estimates_of(
        fit(), ErrorSources(1540.0, 0.005, gate_edge=2e-4, quantisation_m=((3e-9, 4e-9),)), (AVERAGING,)
    )
    found = parts(estimate)
    peak_m = 1e-7 / 0.9
    assert estimate.corrected
    assert estimate.amplitude_m == pytest.approx(peak_m)
    assert estimate.phase_rad == pytest.approx(0.32)
    assert estimate.amplitude_uncertainty_m == pytest.approx(math.hypot(*(each.amplitude_m for each in found.values())))
    assert estimate.phase_uncertainty_rad == pytest.approx(math.hypot(*(each.phase_rad for each in found.values())))
    stated = {
        "noise": (1e-9 / 0.9, 0.01),
        "trigger jitter": (0, 0),
        "rectified noise": (0, 0),
        "quantisation": (3e-9 / 0.9, 0.04),
        "aliasing": (0, 0),
        "speckle": (0.03 * peak_m, 0.002),
        "beam averaging": (0.02 * peak_m, 0.004),
        "gate edge": (2e-4 * peak_m, 0.0),
        "sound speed": (0.005 * peak_m, 0),
        "gate off focus": (0.01 * peak_m, 0),
    }
    assert list(found) == list(stated)
    for name, pair in stated.items():
        assert (found[name].amplitude_m, found[name].phase_rad) == pytest.approx(pair), name


def test_aliasing_is_subtracted_from_noise_so_that_nothing_is_counted_twice() -> None:
    of_noise = fit()
    aliasing = np.array([[[3e-18, 0], [0, 5e-4]]])
    whole = replace(of_noise, covariance=of_noise.covariance + aliasing, aliasing=aliasing)
    (plain,), (total,) = estimates_of(of_noise), estimates_of(whole)
    assert parts(total)["noise"].amplitude_m == pytest.approx(parts(plain)["noise"].amplitude_m)
    assert parts(total)["aliasing"].phase_rad == pytest.approx(math.sqrt(5e-4))
    assert total.tracked_amplitude_uncertainty_m == pytest.approx(2e-9)


@pytest.mark.parametrize("shared", [0.5, -0.2, -0.9])
def test_the_covariance_of_aliasing_and_beam_averaging_is_in_the_sum(shared: float) -> None:
    # 0.02 rad of aliasing, 0.01 of averaging, correlated by `shared`; 3 and 2 % of the amplitude
    aliasing = np.array([[[9e-18, 0], [0, 4e-4]]])
    whole = replace(fit(), covariance=fit().covariance + aliasing, aliasing=aliasing)
    averaging = Averaging(
        1.0, 0.0, 0.0, 0.02, 0.01, shared_relative=shared * 0.03 * 0.02, shared_phase_rad2=shared * 0.02 * 0.01
    )
    (estimate,) = estimates_of(whole, ErrorSources(sound_speed_uncertainty=0.0), (averaging,))
    noise = parts(estimate)["noise"]
    relative = (estimate.amplitude_uncertainty_m**2 - noise.amplitude_m**2) / 1e-14
    assert relative == pytest.approx(0.03**2 + 0.02**2 + 2 * shared * 0.03 * 0.02)
    square_rad2 = estimate.phase_uncertainty_rad**2 - noise.phase_rad**2
    assert square_rad2 == pytest.approx(0.02**2 + 0.01**2 + 2 * shared * 0.02 * 0.01)


@pytest.mark.parametrize(("jitter_s", "share"), [(5e-12, 0.148), (1e-10, 1.0)])
def test_trigger_jitter_is_a_fraction_of_the_residual(jitter_s: float, share: float) -> None:
    # 1540 m/s * 5 ps / 2 is 3.85 nm, of a residual of 10 nm; 100 ps would be more than there is.
    (estimate,) = estimates_of(fit(), ErrorSources(1540.0, 0.0, jitter_s))
    noise, jitter = parts(estimate)["noise"], parts(estimate)["trigger jitter"]
    assert jitter.amplitude_m**2 == pytest.approx(share * 1e-18, rel=2e-3)
    assert noise.amplitude_m**2 + jitter.amplitude_m**2 == pytest.approx(1e-18)
    (still,) = estimates_of(fit(), ErrorSources(1540.0, 0.0, jitter_s, subtracts_jitter=True))
    assert parts(still)["trigger jitter"].amplitude_m == 0


def test_dividing_by_the_carrier_errs_by_the_echos_mean_frequency() -> None:
    time_s, valid = np.arange(100) / 4000, np.ones(100, dtype=bool)
    moved_m = 1e-6 * np.sin(2 * np.pi * 200 * time_s) + 3e-6
    by_echo, by_carrier = (Motion(time_s, scale * moved_m, np.ones(100), valid) for scale in (1.0, 0.98))
    assert carrier_error(by_carrier, by_echo) == pytest.approx(0.02)
    assert carrier_error(by_carrier, None) == 0
    (estimate,) = estimates_of(fit(), ErrorSources(carrier_relative=0.02))
    assert parts(estimate)["carrier"].amplitude_m == pytest.approx(2e-9)
    (with_beams,) = estimates_of(
        fit(), ErrorSources(carrier_relative=0.02), (replace(AVERAGING, carrier_relative=0.018),)
    )
    assert parts(with_beams)["carrier"].amplitude_m == pytest.approx(0.018e-7 / 0.9)


def test_without_beams_the_headline_is_the_tracked_displacement() -> None:
    (estimate,) = estimates_of(fit(), ErrorSources(1540.0, 0.005))
    assert (estimate.amplitude_m, estimate.phase_rad) == (estimate.tracked_amplitude_m, estimate.tracked_phase_rad)
    assert not estimate.corrected
    assert estimate.amplitude_uncertainty_m == pytest.approx(math.hypot(1e-9, 0.005 * 1e-7))


def test_noise_alone_has_the_degrees_of_freedom_of_the_residual() -> None:
    (estimate,) = estimates_of(fit(degrees_of_freedom=12.0), ErrorSources(), (AVERAGING,))
    degrees = {name: each.degrees_of_freedom for name, each in parts(estimate).items()}
    assert degrees.pop("noise") == degrees.pop("rectified noise") == 12
    assert set(degrees.values()) == {math.inf}


def test_the_interval_of_an_unknown_phase_is_the_whole_circle() -> None:
    state = 1e-12 * np.array([1.0, 0.0])
    of_noise = fit_from_state(np.array([200.0]), state, 1e-18 * np.eye(2), FitQuality(np.asarray(1e-8), math.inf, 100))
    (unknown,) = estimates_of(replace(of_noise, covariance=np.array([[[1e-18, 0], [0, math.pi**2 / 3]]])))
    assert unknown.interval_95_rad == math.pi


@pytest.mark.parametrize("jitter_s", [0.0, 5e-12, 1e-10])
def test_the_interval_of_few_pulses_is_that_of_students_distribution(jitter_s: float) -> None:
    few = fit(degrees_of_freedom=7.0)
    (estimate,) = estimates_of(few, ErrorSources(1540.0, 0.0, jitter_s))
    assert estimate.noise_freedom == 7
    # noise and trigger jitter are parts of one residual: together they have its degrees of freedom
    assert estimate.interval_95_m == pytest.approx(1e-9 * stdtrit(7, 0.975))
    assert estimate.interval_95_rad == pytest.approx(0.01 * stdtrit(7, 0.975))


def test_a_speckle_error_across_the_phasor_raises_the_amplitude() -> None:
    """Mean square change of |1 + x + j t|, x normal and t of the kurtosis of speckle.

    What is neglected is 1 + x for 1, x^2 t^4, and t^6 beside t^4, 3 %. Of 400 000
    draws the mean square is known to sqrt(kurtosis / 400 000), at most 2 %.
    """
    random, scale = np.random.default_rng(1), math.sqrt(math.log(SPECKLE_KURTOSIS / 3) / 4)
    # a normal number of log-normal scale has the kurtosis 3 exp(4 scale^2)
    turn = 0.05 * random.standard_normal(400_000) * np.exp(scale * random.standard_normal(400_000))
    length = np.abs(1 + 0.003 * random.standard_normal(turn.size) + 1j * turn) - 1
    before = replace(AVERAGING, speckle_relative=0.003, speckle_phase_rad=0.05 * math.exp(scale**2))
    assert with_second_order_speckle(before).speckle_relative ** 2 == pytest.approx(np.mean(length**2), rel=0.06)
    in_phase = replace(before, speckle_phase_rad=0.0)
    assert with_second_order_speckle(in_phase) == in_phase
