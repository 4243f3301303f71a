"""Kalman filter in square-root form with harmonic and background states: displacement to amplitude and phase.

    x_k = x_{k-1} + w_k        states: (in-phase, quadrature) of each frequency, background polynomial
    y_k = h_k x_k + n_k        h_k: row k of H of harmonics/model.py

w is the process noise, n the measurement noise; all variances are in units of the measurement noise. Two forms of one
filter: ``filter_constant`` (w = 0) accumulates information over many pulses at a time, ``filter_changing`` moves the
states between pulses, one pulse at a time. docs/explanation/estimation.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hpe_rig.arrays import FloatArray
from hpe_rig.processing.harmonics.harmonic_fit import (
    FitQuality,
    HarmonicFit,
    InnovationCorrelation,
    fit_from_state,
)
from hpe_rig.processing.harmonics.model import linear_model
from hpe_rig.processing.motion.displacement import Motion

PRIOR = 1e10
"""Initial variance of a state over the measurement variance: a diffuse prior."""
BLOCK = 16
"""Pulses, or states if more, in one joint covariance of innovations."""
CHUNK = 10_000
"""Pulses processed at once."""
MAX_CONDITION_OF_PRODUCTS = 1e4
"""Condition number of F up to which F'F is used: it has the square of it, and half of the digits remain."""

Information = tuple[FloatArray, FloatArray]
"""Estimate from all pulses so far: triangular F, with F'F the inverse covariance of the states x, and F x."""


@dataclass(frozen=True, slots=True)
class Filtered:
    """Result of a filter, in units of the measurement noise.

    ``state`` (..., state). ``root`` (state, state): root @ root.T is the covariance. ``squared_innovations`` (...): sum
    of squares of the normalised innovations. ``innovations`` (..., pulse), normalised; empty if not requested.
    """

    state: FloatArray
    root: FloatArray
    squared_innovations: FloatArray
    innovations: FloatArray


def kalman(
    motion: Motion,
    frequencies_hz: FloatArray | Sequence[float],
    *,
    also_hz: FloatArray | Sequence[float] = (),
    background_order: int = 0,
    process_noise: float = 0.0,
    prior: float = PRIOR,
    innovations: bool = True,
) -> HarmonicFit:
    """Return all amplitudes and phases of a displacement from a square-root Kalman filter over the valid pulses.

    Variances are in units of the measurement noise, which is estimated from the innovations: ``process_noise`` is that
    of a harmonic state's change per pulse, ``prior`` that of a state at the start. Without process noise the result is
    that of least squares, and leaving out the ``innovations`` is faster. ``also_hz``: further driven frequencies,
    fitted but not returned. Raises ``ValueError`` if the pulses cannot resolve the frequencies.

    Sources: harmonic states of Zheng et al. (2007), background states of Zheng et al. (2006); information form without
    process noise, Potter's form with it.
    """
    frequency_hz = np.asarray(frequencies_hz, dtype=np.float64)
    times = motion.time_s, motion.valid
    model = linear_model(*times, frequency_hz, background_order=background_order, also_hz=also_hz)
    displacement = motion.displacement_m[..., motion.valid]
    pulses, states = model.matrix.shape
    if process_noise == 0:
        filtered = filter_constant(model.matrix, displacement, prior, innovations)
    else:
        # Each harmonic state has its own random change before each pulse; a gap of n pulses has n times the variance.
        used, harmonic = np.flatnonzero(motion.valid), np.arange(2 * frequency_hz.size)
        drive = np.zeros((pulses, states, harmonic.size))
        drive[:, harmonic, harmonic] = np.sqrt(process_noise * np.diff(used, prepend=used[0]))[:, None]
        filtered = filter_changing(model.matrix, displacement, drive, prior)
    # The noise variance scales the covariance, which the filter states for unit noise.
    variance = filtered.squared_innovations / (pulses - states)
    covariance = variance[..., None, None] * (filtered.root @ filtered.root.T)
    wanted_states = model.wanted_states
    correlation = innovation_correlation(filtered.innovations, states) if filtered.innovations.size else None
    quality = FitQuality(
        residual_rms_m=np.sqrt(variance),
        degrees_of_freedom=pulses - states,
        pulses=pulses,
        condition=model.condition,
        innovation_correlation=correlation,
    )
    return fit_from_state(
        frequency_hz, filtered.state[..., wanted_states], covariance[..., wanted_states, wanted_states], quality
    )


def filter_constant(matrix: FloatArray, data: FloatArray, prior: float, innovations: bool = False) -> Filtered:
    """Return the states that a Kalman filter estimates from ``data`` (..., pulse), for states that never change.

    The model is data = ``matrix`` (pulse, state) @ states + noise of unit variance; ``prior`` is the initial variance
    of every state. ``innovations``: whether they are computed too. Information form: the triangular factor F of the
    inverse covariance F'F grows by QR, many pulses at a time; F'F always stays positive definite.
    """
    states = matrix.shape[1]
    values = data.reshape(-1, data.shape[-1]).T  # (pulse, realisation)
    information: Information = np.eye(states) / np.sqrt(prior), np.zeros((states, values.shape[1]))
    innovation_blocks, start, well_conditioned = [], 0, not innovations
    while start < len(matrix):
        # The first pulses form their own block, while the prior still contributes.
        first = innovations and start == 0
        if not well_conditioned and not first:
            well_conditioned = bool(np.linalg.cond(information[0]) < MAX_CONDITION_OF_PRODUCTS)
        size = states + 1 if first else CHUNK if well_conditioned else BLOCK
        rows = slice(start, start + size)
        block, measured, start = matrix[rows], values[rows], rows.stop
        # The innovations of a block are predicted from the information before it.
        if first:
            innovation_blocks.append(_first_innovations(block, measured, prior))
        elif innovations:
            innovations_of = _innovations if well_conditioned else _block_innovations
            innovation_blocks.append(innovations_of(information, block, measured))
        information = _updated(information, block, measured, by_products=well_conditioned and innovations)
    factor, scaled_state = information
    root: FloatArray = np.asarray(np.linalg.inv(factor))
    state = root @ scaled_state
    residual = values - matrix @ state
    # The sum of squared normalised innovations equals that of the residual plus that of the states over the prior.
    squares = np.einsum("ij,ij->j", residual, residual) + np.einsum("ij,ij->j", state, state) / prior
    shape = data.shape[:-1]
    normalised = np.concatenate(innovation_blocks).T.reshape(data.shape) if innovations else np.zeros((*shape, 0))
    return Filtered(
        state=state.T.reshape(*shape, states),
        root=root,
        squared_innovations=squares.reshape(shape),
        innovations=normalised,
    )


def _updated(information: Information, block: FloatArray, measured: FloatArray, *, by_products: bool) -> Information:
    """Return the estimate after further pulses: factor F of the inverse covariance F'F of the states x, and F x.

    ``information``: the same before them. ``block`` H (pulse, state): rows of the model, ``measured`` y (pulse,
    realisation): their values. ``by_products``: from F'F, which is faster but needs a well conditioned F.
    """
    factor, scaled_state = information
    if by_products:
        # F'F grows by H'H and F'F x by H'y. The Cholesky factor takes a fraction of the time of QR.
        moment = factor.T @ scaled_state + block.T @ measured
        lower: FloatArray = np.asarray(np.linalg.cholesky(factor.T @ factor + block.T @ block))
        return lower.T, np.asarray(np.linalg.solve(lower, moment), dtype=np.float64)
    # Least squares of the rows F x and y: the R of a QR decomposition of F stacked on H is the new F.
    q, triangle = np.linalg.qr(np.vstack([factor, block]))
    return np.asarray(triangle), np.asarray(q.T @ np.vstack([scaled_state, measured]))


def filter_changing(matrix: FloatArray, data: FloatArray, drive: FloatArray, prior: float) -> Filtered:
    """Return the states that a Kalman filter estimates from ``data`` (..., pulse), if they change between pulses.

    The model is data = ``matrix`` (pulse, state) @ states + noise of unit variance. ``drive`` (pulse, state, cause):
    before each pulse, independent random causes of unit variance change the states by drive @ causes. ``prior``:
    initial variance of every state. Potter's form keeps the covariance positive for every ratio of prior to noise.
    """
    states = matrix.shape[1]
    # The covariance P of the states is root @ root.T: positive whatever the rounding.
    root = np.sqrt(prior) * np.eye(states)
    state = np.zeros((*data.shape[:-1], states))
    innovations = np.empty(data.shape)
    for k, row in enumerate(matrix):
        # Time update: with the drive G the covariance P + G G' has the root [root, G]; QR makes it square again.
        if k:
            root = np.linalg.qr(np.vstack([root.T, drive[k].T]))[1].T
        # Measurement update in Potter's form, with S the root, h the row, K the gain:
        # S <- S - K a' / (1 + 1/sqrt(alpha)), projection a = S'h, innovation variance alpha = 1 + a'a.
        projection = root.T @ row
        innovation_variance = 1.0 + projection @ projection
        gain = root @ projection / innovation_variance
        innovation = data[..., k] - state @ row
        state = state + innovation[..., None] * gain
        root = root - np.outer(gain, projection) / (1.0 + 1.0 / np.sqrt(innovation_variance))
        innovations[..., k] = innovation / np.sqrt(innovation_variance)
    return Filtered(
        state=state,
        root=root,
        squared_innovations=np.einsum("...i,...i->...", innovations, innovations),
        innovations=innovations,
    )


def _first_innovations(matrix: FloatArray, values: FloatArray, prior: float) -> FloatArray:
    """Return the normalised innovations (pulse, realisation) of the first pulses of a Kalman filter.

    ``matrix`` H (pulse, state) and ``values`` (pulse, realisation): model and data of these pulses. ``prior``: initial
    variance of each state, in units of the noise. With R the root of the values' covariance prior H H' + 1 = R'R,
    innovations are R'^-1 times the values.
    """
    # By QR with the largest rows first: the product H H' would lose the noise, 1, beside the far larger prior.
    stacked = np.vstack([np.sqrt(prior) * matrix.T, np.eye(len(matrix))])
    root: FloatArray = np.asarray(np.linalg.qr(stacked, mode="r"))
    # QR leaves the signs of the rows of R open: a positive diagonal makes the innovations unique.
    return np.asarray(np.linalg.solve(root.T, values) * np.sign(np.diagonal(root))[:, None])


def _block_innovations(information: Information, block: FloatArray, measured: FloatArray) -> FloatArray:
    """Return the normalised innovations (pulse, realisation) of one block of pulses of a Kalman filter.

    ``information``: factor F of the states' inverse covariance F'F, and F x, from all pulses before. ``block`` H
    (pulse, state), ``measured`` y (pulse, realisation). Values minus predictions, y - H x, have the covariance
    1 + B B' with B = H F^-1. Its Cholesky factor L makes L^-1 (y - H x) the innovations of one pulse after the other.
    """
    # numpy's general solver is several times faster than scipy's triangular one for few states.
    factor, scaled_state = information
    from_scaled = np.linalg.solve(factor.T, block.T).T  # B, with H x = B (F x)
    lower = np.linalg.cholesky(np.eye(len(block)) + from_scaled @ from_scaled.T)
    return np.asarray(np.linalg.solve(lower, measured - from_scaled @ scaled_state))


def _innovations(information: Information, matrix: FloatArray, values: FloatArray) -> FloatArray:
    """Return the normalised innovations (pulse, realisation) of many pulses of a Kalman filter.

    Arguments and formulas are those of ``_block_innovations``, applied to blocks of pulses all at once: the inverse
    covariance F'F and F'F x before each block are cumulative sums of H'H and H'y.
    """
    pulses, states = matrix.shape
    size = max(BLOCK, states)
    if pulses <= size:
        return _block_innovations(information, matrix, values)
    factor, scaled_state = information
    covered = pulses // size * size
    blocks, measured = matrix[:covered].reshape(-1, size, states), values[:covered].reshape(-1, size, values.shape[1])
    transposed = np.swapaxes(blocks, -1, -2)
    # H'H and H'y of each block, and their sums before each block: F'F and F'F x.
    products, moments = transposed @ blocks, transposed @ measured
    products_before = factor.T @ factor + np.cumsum(products, axis=0) - products
    moments_before = factor.T @ scaled_state + np.cumsum(moments, axis=0) - moments
    # F'^-1 times H' and times F'F x, for each block: B' and F x.
    solved = np.linalg.solve(np.linalg.cholesky(products_before), np.concatenate([transposed, moments_before], axis=-1))
    from_scaled = np.swapaxes(solved[..., :size], -1, -2)
    lower = np.linalg.cholesky(np.eye(size) + from_scaled @ solved[..., :size])
    innovations = np.linalg.solve(lower, measured - from_scaled @ solved[..., size:]).reshape(covered, -1)
    if covered == pulses:
        return np.asarray(innovations)
    # The last, shorter block.
    root = np.linalg.cholesky(products_before[-1] + products[-1])
    last = np.asarray(root.T), np.linalg.solve(root, moments_before[-1] + moments[-1])
    return np.concatenate([innovations, _block_innovations(last, matrix[covered:], values[covered:])])


def innovation_correlation(innovations: FloatArray, states: int) -> InnovationCorrelation:
    """Return the correlation of a Kalman filter's innovations at a lag of one pulse, and its tolerance.

    It is 0 for a complete model; the tolerance is four standard deviations. The innovations (..., valid pulse) of the
    first ``states`` pulses depend on the prior and are excluded.
    """
    later = innovations[..., states:]
    energy = np.einsum("...i,...i->...", later, later)
    neighbours = np.einsum("...i,...i->...", later[..., 1:], later[..., :-1])
    return neighbours / np.maximum(energy, np.finfo(np.float64).tiny), 4 / np.sqrt(later.shape[-1])
