"""Aliasing error of a harmonic fit without a prior of media.

Tonebursts drive harmonics far above half the pulse rate. A fit of the wanted harmonics ignores them, so they alias onto
the wanted ones. The fit is linear. With x the states (in-phase and quadrature) of all harmonics, its aliasing error is

    e = M x,    M = S - W A

S selects the wanted states, A samples the motion at the pulses, W are the weights of the fit. The motion x is linear in
the response of the medium (medium_prior.py), so M is needed for each component of the response only. W is never
formed: column j of M is the error of the fit on the noise-free motion of response component j.

The prior of media gives the statistics of x, hence of e:

    before correction    Cov e = sum_m p_m s_m² (M x_m)(M x_m)' + s² (M D)(M D)'
    correction           mean of e given the data = M (mean of x given the data)
    after correction     Cov(e | data) = M Cov(x | data) M'

m are the members of the ensemble with posterior probability p_m and scale s_m, D the deviations from their span with
the scale s of the ensemble.

A known systematic effect is corrected, and the uncertainty of the correction remains (GUM, 3.2.3 and 3.2.4).
Derivation: docs/explanation/medium-prior.md.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from hpe_rig.arrays import FloatArray
from hpe_rig.processing.harmonics.harmonic_fit import AliasingCauses, HarmonicFit, corrected_by, with_aliasing
from hpe_rig.processing.harmonics.medium_fit import (
    error_covariance,
    influences_m,
    medium_fit,
    medium_posterior,
    posterior_of_states,
)
from hpe_rig.processing.harmonics.medium_prior import MediumPrior
from hpe_rig.processing.harmonics.model import PulseTimes
from hpe_rig.processing.motion.displacement import Motion

FitFunction = Callable[[Motion], HarmonicFit]
"""A linear harmonic fit. It must compare equal for equal settings, because the error matrix is cached by it."""


def with_aliasing_error(
    fit: HarmonicFit, motion: Motion, prior: MediumPrior, fit_function: FitFunction, background_order: int = 0
) -> HarmonicFit:
    """Return ``fit`` with the covariance of its aliasing error added, and with the corrected fit attached to it.

    Harmonics above half the pulse rate alias onto the wanted ones. ``fit`` is ``fit_function`` of a displacement with
    the timing of ``motion``. A fit of ``motion`` with the ``prior`` of media estimates all harmonics and thereby the
    aliasing error of ``fit``. The corrected fit, ``aliasing_corrected``, is ``fit`` minus the mean of that error given
    the data, with the error's covariance given the data. Raises ``ValueError`` if the pulses are too few for the prior.
    """
    fit_with_prior = medium_fit(motion, fit.frequency_hz, prior, background_order=background_order)
    evidence = fit_with_prior.evidence
    pulses = PulseTimes.of(motion.time_s, motion.valid)
    error_matrix = _error_matrix(prior, pulses, tuple(fit.frequency_hz.tolist()), fit_function)
    # The error given the data: its mean and its covariance.
    mean_m, causes = posterior_of_states(fit_with_prior, prior, error_matrix)
    corrected = corrected_by(fit, mean_m)
    medium = medium_posterior(prior, evidence, corrected, causes.media_influences_m)
    corrected = with_aliasing(corrected, causes, fit_with_prior.fit, medium)
    # Before the correction the error has a larger covariance: the error M x in all samples of the prior.
    errors = prior.sample_responses @ error_matrix.T
    deviations_m2 = np.full(len(errors) - prior.members, evidence.scale_m**2)
    ensemble_causes = AliasingCauses(error_covariance(errors, evidence, deviations_m2), influences_m(evidence, errors))
    uncorrected = with_aliasing(fit, ensemble_causes, fit_with_prior.fit, medium)
    return replace(uncorrected, aliasing_corrected=corrected)


@functools.lru_cache(maxsize=8)
def _error_matrix(
    prior: MediumPrior, pulses: PulseTimes, wanted_hz: tuple[float, ...], fit_function: FitFunction
) -> FloatArray:
    """Return the matrix (wanted state, response component) from a medium's response to the fit's error in its motion.

    The error is true minus fitted states. The fit ignores harmonics above half the pulse rate, so they alias. Cached
    for shots of the same timing.
    """
    indices = prior.harmonic_indices(np.array(wanted_hz))
    displacement_m, _ = prior.displacement_matrices(pulses.time_s, indices)
    fitted_states = _fit_noise_free(displacement_m.T, pulses, fit_function)[..., : 2 * len(wanted_hz)]
    return np.asarray(prior.states_of_response(indices) - fitted_states.T)


def _fit_noise_free(displacement_m: FloatArray, pulses: PulseTimes, fit_function: FitFunction) -> FloatArray:
    """Return the states (motion, state) that ``fit_function`` fits to noise-free displacements (motion, pulse)."""
    displacement_m = np.where(pulses.valid, displacement_m, np.nan)
    # The variance only scales uncertainties, which are not used: any value will do.
    return fit_function(
        Motion(
            time_s=pulses.time_s,
            displacement_m=displacement_m,
            variance_m2=np.ones_like(displacement_m),
            valid=pulses.valid,
        )
    ).state
