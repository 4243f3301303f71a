"""Fits without a prior of media state what the tonebursts' other harmonics leave in them."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from hpe_rig.medium.ensemble import BeamWidths, medium_ensemble
from hpe_rig.processing.estimators import Options, fit_motion
from hpe_rig.processing.harmonics.aliasing_error import with_aliasing_error
from hpe_rig.processing.harmonics.harmonic_fit import HarmonicFit
from hpe_rig.processing.harmonics.medium_prior import MediumPrior, harmonic_range_hz, medium_prior
from hpe_rig.processing.motion.displacement import Motion
from hpe_rig.processing.shot_fitting import HarmonicFitter

BEAMS = BeamWidths((0.17e-3, 0.17e-3, 1.80e-3), (0.078e-3, 0.078e-3, 0.83e-3), 0.27e-3)
BURST_HZ, LENGTH_S = 100.0, 100e-6
WANTED_HZ = np.arange(1.0, 11.0) * BURST_HZ
DRIVEN_HZ = np.arange(11.0, 21.0) * BURST_HZ
"""The others that pulses at 4 kHz tell apart."""
PULSES = np.arange(600) / 4000.0 + 130e-6
"""Fifteen periods, every one at the same forty instants: harmonics alias unseen."""
NOISE_M = 11e-9
RMS_M = 800e-9


@pytest.fixture(scope="module")
def prior() -> MediumPrior:
    return medium_prior(BEAMS, BURST_HZ, LENGTH_S)


def fitter(estimator: str, driven_hz: NDArray[np.float64]) -> HarmonicFitter:
    return HarmonicFitter(tuple(WANTED_HZ.tolist()), estimator, tuple(driven_hz.tolist()), Options())


def other_media(count: int) -> NDArray[np.float64]:
    """Return responses (medium, direction) of media between those of the prior: the next ones of its sequence."""
    ensemble = medium_ensemble(BEAMS, *harmonic_range_hz(BURST_HZ), members=240 + count)
    nodes = ensemble.tracked[240:]
    return np.hstack([nodes.real, nodes.imag])


def fits(prior: MediumPrior, estimator: str, count: int = 60) -> tuple[list[HarmonicFit], NDArray[np.float64]]:
    """Return the fits of other media's motions, in noise, and their true states (medium, state)."""
    random, valid = np.random.default_rng(5), np.ones(PULSES.size, dtype=bool)
    places = prior.harmonic_indices(WANTED_HZ)
    directions, basis = prior.displacement_matrices(PULSES, places)[0], prior.states_of_response(places)
    found, true = [], []
    for response in other_media(count):
        moved = directions @ response
        scale = RMS_M / np.sqrt(np.mean(moved**2))
        displacement_m = scale * moved + NOISE_M * random.standard_normal(moved.size)
        motion = Motion(PULSES, displacement_m, np.full(moved.size, NOISE_M**2), valid)
        fit = fit_motion(motion, WANTED_HZ, estimator, DRIVEN_HZ)
        found.append(with_aliasing_error(fit, motion, prior, fitter(estimator, DRIVEN_HZ)))
        true.append(scale * basis @ response)
    return found, np.array(true)


@pytest.mark.parametrize("estimator", ["coherent", "cross_spectrum"])
def test_least_squares_and_the_papers_chain_state_and_correct_their_aliasing(
    prior: MediumPrior, estimator: str
) -> None:
    each, true = fits(prior, estimator)
    error = np.array([fit.state[:20] for fit in each]) - true
    stated = np.array([np.diagonal(fit.state_covariance)[:20] for fit in each])
    aliasing = np.array([fit.aliasing[:, 0, 0] for fit in each if fit.aliasing is not None])
    # 60 media, whose errors are alike over the harmonics: chi-square of 60 has a deviation of 0.18, three of them
    assert np.mean(error**2 / stated) == pytest.approx(1.0, abs=0.55)
    assert np.mean(error**2) > 100 * NOISE_M**2 * 2 / PULSES.size
    assert aliasing.shape == (60, 10)
    aliasing_corrected = [fit.aliasing_corrected for fit in each if fit.aliasing_corrected is not None]
    before, after = (np.array([fit.state[:20] for fit in some]) - true for some in (each, aliasing_corrected))
    stated = np.array([np.diagonal(fit.state_covariance)[:20] for fit in aliasing_corrected])
    # as above
    assert np.mean(after**2 / stated) == pytest.approx(1.0, abs=0.55)
    assert np.mean(after**2) < np.mean(before**2) / 9


def test_the_uncorrected_estimate_is_unchanged(prior: MediumPrior) -> None:
    random, valid = np.random.default_rng(6), np.ones(PULSES.size, dtype=bool)
    motion = Motion(
        PULSES,
        RMS_M * np.sin(2 * np.pi * 200.0 * PULSES) + NOISE_M * random.standard_normal(PULSES.size),
        np.full(PULSES.size, NOISE_M**2),
        valid,
    )
    fit = fit_motion(motion, WANTED_HZ, "cross_spectrum")
    after = with_aliasing_error(fit, motion, prior, fitter("cross_spectrum", np.zeros(0)))
    np.testing.assert_array_equal(after.amplitude_m, fit.amplitude_m)
    np.testing.assert_array_equal(after.phase_rad, fit.phase_rad)
    assert (after.covariance[:, 0, 0] > fit.covariance[:, 0, 0]).all()
    assert after.medium is not None
