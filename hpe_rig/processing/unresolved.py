"""Unresolved harmonics: what the tonebursts' other harmonics leave in a fit that has no prior of media.

Such a fit knows nothing of the harmonics that alias onto the wanted ones, but how strong they may be is known: its
error on every motion x_m of the ensemble is (x_m - W A x_m), W the fit's weights, and the mean of its square, each
member as large and as likely as the data have it, is the covariance of the fit's error without noise. The weights need
not be known: the fit itself is given the members' motions.
"""

from __future__ import annotations

import functools

import numpy as np

from hpe_rig.processing.echoes import BoolArray, FloatArray, Motion
from hpe_rig.processing.estimators import Options, fit_motion
from hpe_rig.processing.harmonic import HarmonicFit, with_aliasing
from hpe_rig.processing.prior import MediumPrior, medium_fit, medium_posterior


def with_unresolved(
    fit: HarmonicFit, motion: Motion, prior: MediumPrior, estimator: str, also_hz: FloatArray, options: Options
) -> HarmonicFit:
    """Return ``fit`` with the covariance of what other harmonics leave, and with what ``motion`` says of the medium.

    ``motion``, of one train, tells how likely the members of ``prior`` are; ``estimator``, ``also_hz`` and ``options``
    are those of the fit. Raises ``ValueError`` as ``medium_fit``.
    """
    seen = medium_fit(motion, fit.frequency_hz, prior, background_order=options.background_order)
    when = motion.time_s.tobytes(), motion.valid.tobytes()
    missed, free = _missed(prior, *when, tuple(fit.frequency_hz.tolist()), tuple(also_hz.tolist()), estimator, options)
    share = seen.evidence.likelihood * seen.evidence.square_m2
    covariance = (missed.T * share) @ missed + seen.evidence.scale_m**2 * (free.T @ free)
    return with_aliasing(fit, covariance, seen.fit, medium_posterior(prior, seen.evidence, seen.fit, missed))


@functools.lru_cache(maxsize=8)
def _missed(
    prior: MediumPrior,
    time_s: bytes,
    valid: bytes,
    wanted_hz: tuple[float, ...],
    also_hz: tuple[float, ...],
    estimator: str,
    options: Options,
) -> tuple[FloatArray, FloatArray]:
    """Return by how much the fit misses the wanted states (member, state), and (direction, state) of misfit ones."""
    times, used = np.frombuffer(time_s), np.frombuffer(valid, dtype=bool)
    places = prior.places(np.array(wanted_hz))
    directions, basis = prior.columns(times, places)[0], prior.states(places)
    each = np.vstack([prior.members, np.diag(prior.misfit)])
    found = _states(times, used, each @ directions.T, wanted_hz, also_hz, estimator, options)
    missed = each @ basis.T - found
    return missed[: len(prior.members)], missed[len(prior.members) :]


def _states(
    time_s: FloatArray,
    valid: BoolArray,
    displacement_m: FloatArray,
    wanted_hz: tuple[float, ...],
    also_hz: tuple[float, ...],
    estimator: str,
    options: Options,
) -> FloatArray:
    """Return the states (motion, state) that the fit finds of displacements (motion, pulse) without noise."""
    # The variance of a pulse scales the uncertainty alone; its value does not matter.
    moving = np.where(valid, displacement_m, np.nan)
    motion = Motion(time_s, moving, np.ones_like(moving), valid)
    return fit_motion(motion, wanted_hz, estimator, also_hz, options).state[..., : 2 * len(wanted_hz)]
