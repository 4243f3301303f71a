"""Kalman filter, in square-root form, with harmonic and background states: displacement to amplitude and phase.

x = (in-phase, quadrature of each frequency, background polynomial), constant but for process noise; y_k = h_k x + n_k.
Two forms of one filter: without process noise information adds up and many pulses are taken at a time
(``filter_constant``); with it the states move between pulses, one pulse at a time (``filter_changing``). Both in units
of the measurement noise, docs/explanation/estimation.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import comb, factorial

import numpy as np

from hpe_rig.arrays import FloatArray
from hpe_rig.processing.echo.echoes import Motion
from hpe_rig.processing.harmonics.harmonic_fit import HarmonicFit, Innovations, fit_from_state
from hpe_rig.processing.harmonics.model import LARGEST_CONDITION, SURE_CONDITION, linear_model, scaled_time

PRIOR = 1e10
"""Prior variance over measurement variance: nothing known."""
BLOCK = 16
"""Pulses, or states if these are more, whose innovations are found from their joint covariance."""
CHUNK = 10_000
"""Pulses that are in work at once."""
FEW_STATES, MANY_PULSES = 8, 4096
"""States up to which, and pulses from which on, a factor a pulse, all of them at once, costs less than blocks."""


@dataclass(frozen=True, slots=True)
class Filtered:
    """State (..., state), root (state, state) of its covariance, sum of squared normalised innovations (...).

    ``innovations`` (..., pulse), normalised, empty where not asked for; all in units of the measurement noise.
    """

    state: FloatArray
    root: FloatArray
    fitness: FloatArray
    innovations: FloatArray


def kalman(
    motion: Motion,
    frequencies_hz: FloatArray | Sequence[float],
    *,
    also_hz: FloatArray | Sequence[float] = (),
    background_order: int = 0,
    process_noise: float = 0.0,
    background_noise: float = 0.0,
    prior: float = PRIOR,
    largest_condition: float = LARGEST_CONDITION,
    innovations: bool = True,
) -> HarmonicFit:
    """Return all amplitudes and phases from a square-root Kalman filter over the valid pulses, others skipped.

    ``process_noise``, ``background_noise`` and ``prior`` are variances of a harmonic state's change per pulse, of a
    change per pulse of the background's highest derivative (time in half lengths of the train), and of a state's start,
    all in units of the measurement noise, which itself follows from the innovations. Without process noise this is
    recursive least squares. ``background_order`` 0, 1, 2: constant, velocity, acceleration. Raises ``ValueError`` as
    ``least_squares``. Source: harmonic state of Zheng et al. (2007), background states of Zheng et al. (2006);
    information form without, Potter's form with process noise.
    """
    frequency_hz = np.asarray(frequencies_hz, dtype=np.float64)
    times = motion.time_s, motion.valid
    model = linear_model(*times, frequency_hz, largest_condition, background_order=background_order, also_hz=also_hz)
    displacement = motion.displacement_m[..., motion.valid]
    if process_noise == background_noise == 0:
        found = filter_constant(model.matrix, displacement, prior, innovations)
    else:
        drive = _process_roots(motion, model.matrix.shape[1], 2 * frequency_hz.size, background_order)
        strength = np.sqrt([process_noise, background_noise])
        found = filter_changing(
            model.matrix, displacement, [d * s for d, s in zip(drive, strength, strict=True)], prior
        )
    freedom = model.matrix.shape[0] - model.matrix.shape[1]
    variance = found.fitness / freedom
    covariance = variance[..., None, None] * (found.root @ found.root.T)
    wanted = model.wanted
    state, covariance = found.state[..., wanted], covariance[..., wanted, wanted]
    report = None if not found.innovations.size else innovation_test(motion, found.innovations, model.matrix.shape[1])
    known = len(model.matrix), model.condition, report
    return fit_from_state(frequency_hz, state, covariance, variance, *known, freedom=freedom)


def filter_constant(matrix: FloatArray, data: FloatArray, prior: float, innovations: bool = False) -> Filtered:
    """Return the filtered state of a constant ``matrix`` (pulse, state) model and ``data`` (..., pulse).

    Information form: a triangular factor grows by QR, many pulses at a time, and never loses its definiteness.
    Innovations are those of one pulse after the other, from the Cholesky factor of the joint covariance of a block.
    """
    states = matrix.shape[1]
    values = data.reshape(-1, data.shape[-1]).T
    factor, transformed = np.eye(states) / np.sqrt(prior), np.zeros((states, values.shape[1]))
    parts, start, sure = [], 0, not innovations
    while start < len(matrix):
        # the first pulses stand alone, while the prior is still felt
        first = innovations and start == 0
        sure = sure or (not first and bool(np.linalg.cond(factor) < SURE_CONDITION))
        rows = slice(start, start + (states + 1 if first else CHUNK if sure else BLOCK))
        block, seen, start = matrix[rows], values[rows], rows.stop
        if first:
            parts.append(_first_innovations(block, seen, prior))
        elif innovations:
            parts.append((_innovations if sure else _block_innovations)(factor, transformed, block, seen))
        if sure and innovations:
            # Well conditioned, so that products have the digits as well, at a fraction of the time.
            known = factor.T @ transformed + block.T @ seen
            factor = np.linalg.cholesky(factor.T @ factor + block.T @ block).T
            transformed = np.linalg.solve(factor.T, known)
            continue
        # Information adds up: with F'F = sum h h', the stack of F and the new rows has the new F as its R.
        q, factor = np.linalg.qr(np.vstack([factor, block]))
        transformed = q.T @ np.vstack([transformed, seen])
    root = np.linalg.inv(factor)
    state = root @ transformed
    residual = values - matrix @ state
    fitness = np.einsum("ij,ij->j", residual, residual) + np.einsum("ij,ij->j", state, state) / prior
    shape = data.shape[:-1]
    found = np.concatenate(parts).T.reshape(data.shape) if innovations else np.zeros((*shape, 0))
    return Filtered(state.T.reshape(*shape, states), root, fitness.reshape(shape), found)


def filter_changing(matrix: FloatArray, data: FloatArray, drive: Sequence[FloatArray], prior: float) -> Filtered:
    """Return the filtered state of a model whose states change by ``drive``, arrays (pulse, state, cause).

    The causes are independent and of unit variance; Potter's form keeps the covariance positive whatever the ratio of
    prior to noise.
    """
    states = matrix.shape[1]
    # the covariance is root @ root.T: a square of something real stays positive whatever is rounded off
    root = np.sqrt(prior) * np.eye(states)
    state = np.zeros((*data.shape[:-1], states))
    found = np.empty(data.shape)
    for k, row in enumerate(matrix):
        # Time update. P + G G' has the root [root, G]; QR makes it square again.
        if k and drive:
            root = np.linalg.qr(np.vstack([root.T, *[each[k].T for each in drive]]))[1].T
        # Measurement update in Potter's form: S <- S - K a' / (1 + 1/sqrt(alpha)), a = S' h, alpha = 1 + a'a.
        seen = root.T @ row
        innovation_variance = 1.0 + seen @ seen
        gain = root @ seen / innovation_variance
        innovation = data[..., k] - state @ row
        state = state + innovation[..., None] * gain
        root = root - np.outer(gain, seen) / (1.0 + 1.0 / np.sqrt(innovation_variance))
        found[..., k] = innovation / np.sqrt(innovation_variance)
    return Filtered(state, root, np.einsum("...i,...i->...", found, found), found)


def _first_innovations(matrix: FloatArray, values: FloatArray, prior: float) -> FloatArray:
    """Return the normalised innovations (pulse, realisation) of the first pulses, whatever the prior."""
    # the root of their joint covariance by QR, largest rows first: its square would lose the noise beside the prior
    stacked = np.vstack([np.sqrt(prior) * matrix.T, np.eye(len(matrix))])
    root: FloatArray = np.asarray(np.linalg.qr(stacked, mode="r"))
    return np.asarray(np.linalg.solve(root.T, values) * np.sign(np.diagonal(root))[:, None])


def _block_innovations(factor: FloatArray, transformed: FloatArray, block: FloatArray, seen: FloatArray) -> FloatArray:
    """Return the normalised innovations (pulse, realisation) of one block of pulses."""
    # numpy's general solver is several times quicker than scipy's triangular one for few states
    spread = np.linalg.solve(factor.T, block.T).T
    joint = np.linalg.cholesky(np.eye(len(block)) + spread @ spread.T)
    return np.asarray(np.linalg.solve(joint, seen - spread @ transformed))


def _innovations(factor: FloatArray, transformed: FloatArray, matrix: FloatArray, values: FloatArray) -> FloatArray:
    """Return what ``_block_innovations`` does, of many blocks at once: products of factors instead of factors."""
    pulses, states = matrix.shape
    if states <= FEW_STATES and pulses >= MANY_PULSES:
        return _pulse_innovations(factor, transformed, matrix, values)
    size = max(BLOCK, states)
    if pulses <= size:
        return _block_innovations(factor, transformed, matrix, values)
    # Every block starts from the information of all before it: cumulative sums give that for all blocks at once, and
    # the factorisations run as one batch. Only where the factor is well conditioned, for products square that.
    whole = pulses // size * size
    blocks, seen = matrix[:whole].reshape(-1, size, states), values[:whole].reshape(-1, size, values.shape[1])
    across = np.swapaxes(blocks, -1, -2)
    information, moment = across @ blocks, across @ seen
    before = factor.T @ factor + np.cumsum(information, axis=0) - information
    known = factor.T @ transformed + np.cumsum(moment, axis=0) - moment
    solved = np.linalg.solve(np.linalg.cholesky(before), np.concatenate([across, known], axis=-1))
    spread = np.swapaxes(solved[..., :size], -1, -2)
    joint = np.linalg.cholesky(np.eye(size) + spread @ solved[..., :size])
    found = np.linalg.solve(joint, seen - spread @ solved[..., size:]).reshape(whole, -1)
    if whole == pulses:
        return np.asarray(found)
    root = np.linalg.cholesky(before[-1] + information[-1])
    last = np.linalg.solve(root, known[-1] + moment[-1])
    return np.concatenate([found, _block_innovations(root.T, last, matrix[whole:], values[whole:])])


def _pulse_innovations(
    factor: FloatArray, transformed: FloatArray, matrix: FloatArray, values: FloatArray
) -> FloatArray:
    """Return what ``_block_innovations`` does, of few states: y - h x over sqrt(1 + h P h') before each pulse.

    The information of all pulses before, cumulative sums, is factored for every pulse at once, element by element of
    its Cholesky factor L: with w = L^-1 h and z = L^-1 m of the moments m, h P h' = w'w and h x = w'z.
    """
    states, columns = matrix.shape[1], np.ascontiguousarray(matrix.T)
    information, moment = factor.T @ factor, factor.T @ transformed
    root, spread, known = dict[tuple[int, int], FloatArray](), list[FloatArray](), list[FloatArray]()
    variance, forecast = np.ones(len(matrix)), np.zeros_like(values)
    for i in range(states):
        for j in range(i + 1):
            element = _sum_before(columns[i], columns[j], information[i, j])
            for k in range(j):
                element -= root[i, k] * root[j, k]
            root[i, j] = np.sqrt(element) if i == j else element / root[j, j]
        own, seen = columns[i].copy(), _sum_before(columns[i][:, None], values, moment[i])
        for j in range(i):
            own -= root[i, j] * spread[j]
            seen -= root[i, j][:, None] * known[j]
        own /= root[i, i]
        seen /= root[i, i][:, None]
        spread.append(own)
        known.append(seen)
        variance += own * own
        forecast += own[:, None] * seen
    return np.asarray((values - forecast) / np.sqrt(variance)[:, None])


def _sum_before(one: FloatArray, other: FloatArray, start: FloatArray | float) -> FloatArray:
    """Return ``start`` and the sum of all products of ``one`` and ``other`` (pulse, ...) before each pulse."""
    total = np.empty(other.shape)
    total[0] = start
    np.multiply(one[:-1], other[:-1], out=total[1:])
    return np.asarray(np.cumsum(total, axis=0, out=total))


def _process_roots(motion: Motion, states: int, harmonic: int, order: int) -> tuple[FloatArray, FloatArray]:
    """Return how unit noise enters before each valid pulse: harmonic states alone, and the highest derivative.

    A jump w of the p-th derivative at time s adds w (t - s)^p / p! from then on, which the filter's constant polynomial
    takes over whole: it never asks about the past again.
    """
    used = np.flatnonzero(motion.valid)
    gaps = np.sqrt(np.diff(used, prepend=used[0]))
    alone = np.zeros((used.size, states, harmonic))
    alone[:, np.arange(harmonic), np.arange(harmonic)] = gaps[:, None]
    jump = np.zeros((used.size, states, 1))
    if order >= 0:
        start = scaled_time(motion.time_s)[used]
        powers = np.stack([comb(order, i) * (-start) ** (order - i) for i in range(order + 1)]) / factorial(order)
        legendre = np.polynomial.legendre
        turn = np.stack([np.pad(legendre.poly2leg(row), (0, order + 1))[: order + 1] for row in np.eye(order + 1)])
        jump[:, harmonic : harmonic + order + 1, 0] = (turn.T @ powers).T * gaps[:, None]
    return alone, jump


def innovation_test(motion: Motion, normalised: FloatArray, states: int) -> Innovations:
    """Return the test of the innovations (..., valid pulse), each over its deviation in units of a pulse's noise.

    Those of the first ``states`` pulses belong to the prior and are left out.
    """
    later = normalised[..., states:]
    degrees = later.shape[-1]
    energy = np.einsum("...i,...i->...", later, later)
    stated = motion.variance_m2[..., motion.valid].mean(axis=-1)
    tiny = np.finfo(np.float64).tiny
    nis = np.where(stated > 0, energy / degrees / np.maximum(stated, tiny), np.nan)
    neighbours = np.einsum("...i,...i->...", later[..., 1:], later[..., :-1])
    size = np.abs(later)
    robust = np.partition(size, degrees // 2, axis=-1)[..., degrees // 2, None] / 0.6745
    # a slice where it does, which costs a fraction of a list
    used = slice(states, None) if motion.valid.all() else np.flatnonzero(motion.valid)[states:]
    placed = np.full((*normalised.shape[:-1], motion.valid.size), np.nan)
    placed[..., used] = later / np.maximum(robust, tiny)
    outliers = np.zeros(placed.shape, dtype=bool)
    outliers[..., used] = size > 5 * robust
    correlation, tolerance = neighbours / np.maximum(energy, tiny), 4 / np.sqrt(degrees)
    return Innovations(placed, nis, 3 * np.sqrt(2 / degrees), correlation, tolerance, outliers)
