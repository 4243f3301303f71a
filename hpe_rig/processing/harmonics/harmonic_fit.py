"""Harmonic fit of a displacement: D(t) = sum_i A_i sin(2 pi f_i t + phi_i) + background, eq. (1).

The state of a frequency is (A cos phi, A sin phi), so the model is linear; all frequencies and the background are
estimated at once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hpe_rig.arrays import BoolArray, ComplexArray, FloatArray
from hpe_rig.processing.echo.echoes import Motion
from hpe_rig.processing.harmonics.model import LARGEST_CONDITION, linear_model
from hpe_rig.result import phase_variance_at_rad2, phase_variance_rad2, rectified_variance_m2


@dataclass(frozen=True, slots=True)
class Innovations:
    """Innovations of a filter: what it did not foresee, a test of its model.

    ``normalised`` (..., pulse): innovations over their own standard deviation, NaN where no pulse; ``nis`` (...): their
    mean square with the noise that the echoes themselves state (NaN where they state none), 1 when that is true;
    ``nis_tolerance``: three standard deviations of it by chance; ``autocorrelation`` (...) from one pulse to the next,
    0 when the noise is white, ``autocorrelation_tolerance``: four standard deviations of it by chance; ``outliers``
    (..., pulse): beyond 5 robust standard deviations.
    """

    normalised: FloatArray
    nis: FloatArray
    nis_tolerance: float
    autocorrelation: FloatArray
    autocorrelation_tolerance: float
    outliers: BoolArray


@dataclass(frozen=True, slots=True)
class MediumPosterior:
    """What the motion says of the medium, where the fit had a prior of media.

    ``significance`` (...): probability that a medium of the ensemble gives data as unlikely as these.
    ``peak_over_tracked``, complex (..., frequency): the motion's peak over what the beam tracks of it, and
    ``peak_covariance`` (..., frequency, 2, 2) of its relative amplitude and its phase. ``steepness`` (..., frequency,
    2): root mean square of the changes of tracked amplitude, relative, and phase with the logarithm of the beam's area.
    ``shared``, the same shape: covariance of the error of ``peak_over_tracked`` with that of aliasing, relative
    amplitude and phase: both depend on the medium.
    """

    significance: FloatArray
    peak_over_tracked: ComplexArray
    peak_covariance: FloatArray
    steepness: FloatArray
    shared: FloatArray


@dataclass(frozen=True, slots=True)
class HarmonicFit:
    """Amplitude and phase per frequency, with covariance.

    ``frequency_hz`` (frequency,); ``amplitude_m`` and ``phase_rad`` (..., frequency), phase in (-pi, pi];
    ``covariance`` (..., frequency, 2, 2) of (amplitude, phase); ``state`` (..., state) and ``state_covariance``
    (..., state, state) in m and m^2; ``background_m`` (...), its mean, 0 where the chain removes it;
    ``rectified_m2`` (..., frequency): what noise across a phasor, where it may be all there is, adds to the variance of
    its amplitude; ``residual_rms_m`` (...), displacement noise of one pulse; ``pulses``: how many were used;
    ``condition``: of the model, 1 when every state is seen on its own; ``innovations`` where a filter was asked for
    them. Where there is a prior of media ``aliasing`` (..., frequency, 2, 2) is the part of ``covariance`` that
    harmonics which the fit does not tell apart and shrinkage leave, and ``medium`` what is known of the medium
    afterwards. ``unaliased``, where a fit without the prior is beside it: without the aliasing that the prior tells.
    ``freedom`` (...): degrees of freedom of the residual from which the noise is estimated.
    """

    frequency_hz: FloatArray
    amplitude_m: FloatArray
    phase_rad: FloatArray
    covariance: FloatArray
    state: FloatArray
    state_covariance: FloatArray
    background_m: FloatArray
    rectified_m2: FloatArray
    residual_rms_m: FloatArray
    pulses: int
    condition: float = np.nan
    innovations: Innovations | None = None
    aliasing: FloatArray | None = None
    medium: MediumPosterior | None = None
    unaliased: HarmonicFit | None = None
    freedom: FloatArray | float = np.inf


def least_squares(
    motion: Motion,
    frequencies_hz: FloatArray | Sequence[float],
    *,
    also_hz: FloatArray | Sequence[float] = (),
    background_order: int = 0,
    largest_condition: float = LARGEST_CONDITION,
) -> HarmonicFit:
    """Return all amplitudes and phases from one least-squares fit, with covariance from the residual.

    ``also_hz`` are frequencies that are there as well: fitted, so that they are no residual, and not returned; half
    the pulse rate may be among them. ``background_order`` is that of the polynomial fitted along. Every valid pulse has
    the same weight; the residual is taken as white, for accumulated steps as white plus a random walk. Raises
    ``ValueError`` when the pulses cannot resolve the frequencies (see ``model.linear_model``).
    """
    frequency_hz = np.asarray(frequencies_hz, dtype=np.float64)
    times = motion.time_s, motion.valid
    model = linear_model(*times, frequency_hz, largest_condition, background_order=background_order, also_hz=also_hz)
    wanted, (pulses, states) = model.wanted, model.matrix.shape
    state, residual = model.solve(motion.displacement_m[..., motion.valid])
    freedom = np.full(motion.displacement_m.shape[:-1], float(pulses - states))
    variance = np.einsum("...i,...i->...", residual, residual) / (pulses - states)
    if motion.walk is not None:
        q, walk = model.matrix @ model.root, np.asarray(motion.walk)
        energy, freedom = of_changes(q, np.ones(states), walk)
        variance, covariance = step_covariance(residual, walk, model.root[wanted] @ q.T, energy)
    else:
        covariance = variance[..., None, None] * (model.root[wanted] @ model.root[wanted].T)
    return fit_from_state(
        frequency_hz, state[..., wanted], covariance, variance, pulses, model.condition, freedom=freedom
    )


def of_changes(columns: FloatArray, taken: FloatArray, walk: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return energy (...) of a residual's changes between pulses, over that of one pulse's noise, and their freedom.

    The noise is a sum of steps: white, and ``walk`` (...) times as much variance that a step adds to all later pulses.
    The fit has taken the share ``taken`` (..., column) of what lies along each of the orthonormal ``columns`` (pulse,
    column). A sum of squares with the covariance A has the freedom (tr A)^2 / tr A^2 (Satterthwaite, 1946): that of
    white noise, times what ``walk`` makes of it where nothing is fitted.
    """
    changes = np.diff(columns, axis=0)
    onwards = np.cumsum(columns[:0:-1], axis=0)[::-1]
    count, energy = len(changes), np.einsum("ij,ij->j", changes, changes)
    gone, inner = taken * (2 - taken), changes.T @ changes
    white = 2 * count - gone @ energy
    # |D (1 - Q h Q') L|^2: D takes the changes, L adds steps up, D L = 1
    along = np.einsum("ij,ij->j", onwards, changes)
    products = inner * (onwards.T @ onwards)
    steps = count - 2 * taken @ along + np.einsum("...i,ij,...j->...", taken, products, taken)
    # A = D (1 - Q g Q') D', and |D' D q|^2 = 2 |D q|^2 - 2 sum of neighbours' products
    again = 2 * (energy - np.einsum("ij,ij->j", changes[1:], changes[:-1]))
    square = 6 * count - 2 - 2 * gone @ again
    square = square + np.einsum("...i,ij,...j->...", gone, inner**2, gone)
    freedom = white**2 / np.maximum(square, np.finfo(np.float64).tiny) * _of_walk(walk)
    return np.asarray(white + walk * steps), np.asarray(freedom)


def _of_walk(walk: FloatArray) -> FloatArray:
    """Return the freedom of steps of variance 2 + ``walk``, -1 between neighbours, over that without ``walk``."""
    square = (2 + walk) ** 2
    return np.asarray(1.5 * square / (square + 2))


def step_covariance(
    residual: FloatArray, walk: FloatArray, rows: FloatArray, energy: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the pulse variance (...) and the covariance (..., row, row) of ``rows`` (..., row, pulse) over steps.

    The scale comes from the ``residual``'s changes between pulses (..., pulse) and their energy by ``of_changes``.
    """
    changes = np.diff(residual, axis=-1)
    pulse = np.einsum("...i,...i->...", changes, changes) / energy
    # a step shifts every later pulse
    over_steps = np.cumsum(rows[..., :0:-1], axis=-1)
    white, random_walk = (each @ np.swapaxes(each, -1, -2) for each in (rows, over_steps))
    return pulse, np.asarray(pulse[..., None, None] * (white + walk[..., None, None] * random_walk))


def fit_from_state(
    frequency_hz: FloatArray,
    state: FloatArray,
    state_covariance: FloatArray,
    variance: FloatArray,
    pulses: int,
    condition: float = np.nan,
    innovations: Innovations | None = None,
    aliasing_m2: FloatArray | None = None,
    freedom: FloatArray | float = np.inf,
) -> HarmonicFit:
    """Return amplitude and phase with their covariance, from in-phase, quadrature and (if there) the constant.

    ``aliasing_m2``: the part of ``state_covariance`` that is aliasing; ``freedom``: as of ``HarmonicFit``.
    """
    count = frequency_hz.size
    in_phase, quadrature = state[..., 0 : 2 * count : 2], state[..., 1 : 2 * count : 2]
    amplitude = np.hypot(in_phase, quadrature)
    phase = np.arctan2(quadrature, in_phase)
    radial = _along_phasor(state_covariance, phase)
    unresolved = np.zeros_like(radial) if aliasing_m2 is None else _along_phasor(aliasing_m2, phase)
    noise = radial - unresolved
    weights = _polar_weights(radial, noise, amplitude)
    return HarmonicFit(
        frequency_hz,
        amplitude,
        phase,
        np.asarray(radial * weights),
        state,
        state_covariance,
        state[..., 2 * count] if state.shape[-1] > 2 * count else np.zeros(state.shape[:-1]),
        rectified_variance_m2(amplitude, _along(noise), np.maximum(noise[..., 1, 1], 0.0)),
        np.sqrt(variance),
        pulses,
        condition,
        innovations,
        None if aliasing_m2 is None else np.asarray(unresolved * weights),
        freedom=np.broadcast_to(np.asarray(freedom, dtype=np.float64), variance.shape),
    )


def moved_by(fit: HarmonicFit, missed_m: FloatArray) -> HarmonicFit:
    """Return ``fit`` with ``missed_m`` (..., 2 * frequency) added to its states, their covariance the same."""
    state = fit.state.copy()
    state[..., : 2 * fit.frequency_hz.size] += missed_m
    rest = np.square(fit.residual_rms_m), fit.pulses, fit.condition, fit.innovations
    return fit_from_state(fit.frequency_hz, state, fit.state_covariance, *rest, freedom=fit.freedom)


def with_aliasing(
    fit: HarmonicFit, aliasing_m2: FloatArray, known: HarmonicFit, medium: MediumPosterior
) -> HarmonicFit:
    """Return ``fit`` with the covariance ``aliasing_m2`` (..., 2 * frequency, 2 * frequency) of its states added.

    A ``known`` fit, with a prior of media, tells how large the amplitudes are without that error, which can be as large
    as they: it is a phase's error by them. ``medium`` is what the motion says of it.
    """
    wanted, total = 2 * fit.frequency_hz.size, fit.state_covariance.copy()
    total[..., :wanted, :wanted] += aliasing_m2
    radial, added = (_along_phasor(each, fit.phase_rad) for each in (total, aliasing_m2))
    aliased = 0.0 if known.aliasing is None else known.aliasing[..., 0, 0]
    noise = known.covariance[..., 0, 0] - aliased
    variance = phase_variance_at_rad2(known.amplitude_m, noise, fit.amplitude_m, radial)
    weights = _factors(radial, variance)
    return replace(fit, covariance=radial * weights, state_covariance=total, aliasing=added * weights, medium=medium)


def _along_phasor(state_covariance: FloatArray, phase: FloatArray) -> FloatArray:
    """Return the covariance (..., frequency, 2, 2) along and across each phasor."""
    count = phase.shape[-1]
    turn = np.empty((*phase.shape, 2, 2))
    turn[..., 0, 0] = turn[..., 1, 1] = np.cos(phase)
    turn[..., 0, 1] = np.sin(phase)
    turn[..., 1, 0] = -turn[..., 0, 1]
    pairs = np.arange(2 * count).reshape(count, 2)
    blocks = state_covariance[..., pairs[:, :, None], pairs[:, None, :]]
    turned = turn @ blocks @ np.swapaxes(turn, -1, -2)
    return np.asarray((turned + np.swapaxes(turned, -1, -2)) / 2)


def _polar_weights(radial: FloatArray, noise: FloatArray, amplitude: FloatArray) -> FloatArray:
    """Return the factors (..., frequency, 2, 2) from covariance along and across the phasor to (amplitude, phase).

    ``noise`` is ``radial`` without aliasing. Where the amplitude may be noise alone, the phase's variance is up to that
    of an unknown phase.
    """
    return _factors(radial, phase_variance_rad2(amplitude, radial[..., 1, 1], _along(noise)))


def _along(covariance: FloatArray) -> FloatArray:
    """Return the variance (...) along a phasor of what has none across: it says how likely the phasor is noise."""
    across = np.maximum(covariance[..., 1, 1], np.finfo(np.float64).tiny)
    return np.asarray(np.maximum(covariance[..., 0, 0] - covariance[..., 0, 1] ** 2 / across, 0.0))


def _factors(radial: FloatArray, variance: FloatArray) -> FloatArray:
    across, tiny = radial[..., 1, 1], np.finfo(np.float64).tiny
    scale = np.sqrt(np.where(across > tiny, variance, 0.0) / np.maximum(across, tiny))
    weights = np.stack([np.ones_like(scale), scale], axis=-1)
    return np.asarray(weights[..., :, None] * weights[..., None, :])
