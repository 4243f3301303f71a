"""Unresolved harmonics: what the tonebursts' other harmonics leave in a fit that has no prior of media.

Such a fit knows nothing of the harmonics that alias onto the wanted ones, but how strong they may be is known: its
error on a motion x is M x = x - W A x, W the fit's weights, which need not be known: the fit itself is given the
motions. The mean of its square over the ensemble, each member as large and as likely as the data have it, is the
covariance of the fit's error without noise. The data say more: what the prior makes of them, x', tells an error M x' of
which the fit can be corrected, and M (x - x') is what then remains (Guide to the expression of uncertainty in
measurement, 3.2.3 and 3.2.4).
"""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np

from hpe_rig.arrays import BoolArray, FloatArray
from hpe_rig.processing.echo.echoes import Motion
from hpe_rig.processing.estimators import Options, fit_motion
from hpe_rig.processing.harmonics.harmonic_fit import HarmonicFit, moved_by, with_aliasing
from hpe_rig.processing.harmonics.medium_prior import MediumPrior, likely_states, medium_fit, medium_posterior


def with_unresolved(
    fit: HarmonicFit, motion: Motion, prior: MediumPrior, estimator: str, also_hz: FloatArray, options: Options
) -> HarmonicFit:
    """Return ``fit`` with the covariance of what other harmonics leave, and with what ``motion`` says of the medium.

    As it is, and ``unaliased`` by what the prior makes of ``motion``, which is of one train and tells how likely the
    members of ``prior`` are. ``estimator``, ``also_hz`` and ``options`` are those of the fit. Raises ``ValueError`` as
    ``medium_fit``.
    """
    order = options.background_order
    seen = medium_fit(motion, fit.frequency_hz, prior, background_order=order)
    when = motion.time_s.tobytes(), motion.valid.tobytes()
    missed = _missed(prior, *when, tuple(fit.frequency_hz.tolist()), tuple(also_hz.tolist()), estimator, options)
    evidence, by_member, free = seen.evidence, prior.members @ missed.T, prior.misfit[:, None] * missed.T
    square = (
        by_member.T * (evidence.likelihood * evidence.square_m2)
    ) @ by_member + evidence.scale_m**2 * free.T @ free
    mean_m, rest, left = likely_states(motion, seen, prior, missed, order)
    unaliased = moved_by(fit, mean_m)
    medium = medium_posterior(prior, evidence, unaliased, left)
    unaliased = with_aliasing(unaliased, rest, seen.fit, medium)
    return replace(with_aliasing(fit, square, seen.fit, medium), unaliased=unaliased)


@functools.lru_cache(maxsize=8)
def _missed(
    prior: MediumPrior,
    time_s: bytes,
    valid: bytes,
    wanted_hz: tuple[float, ...],
    also_hz: tuple[float, ...],
    estimator: str,
    options: Options,
) -> FloatArray:
    """Return by how much the fit misses the wanted states of every direction of the prior, (state, direction)."""
    times, used = np.frombuffer(time_s), np.frombuffer(valid, dtype=bool)
    places = prior.places(np.array(wanted_hz))
    directions, basis = prior.columns(times, places)[0], prior.states(places)
    return np.asarray(basis - _states(times, used, directions.T, wanted_hz, also_hz, estimator, options).T)


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
