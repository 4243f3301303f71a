"""Linear model of displacement over slow time: sinusoids at known frequencies and a polynomial background.

    d(t_k) = sum_i [a_i sin(2 pi f_i t_k) + b_i cos(2 pi f_i t_k)] + sum_p c_p P_p(t_k) + noise        paper eq. (1)

a_i = A_i cos(phase_i) and b_i = A_i sin(phase_i) are the in-phase and quadrature states of frequency f_i, P_p the
Legendre polynomials over the pulse train, t_k the pulse times. In matrix form d = H x + noise.

State order in x: (a_i, b_i) of each wanted frequency, then c_p, then the states of further driven frequencies.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from hpe_rig.arrays import BoolArray, FloatArray, IndexArray, numbers_text
from hpe_rig.plan import MAX_CONDITION as MAX_CONDITION

MAX_CACHED_PULSES = 1 << 16
"""Longest train that keeps its model for the next train with the same pulse times."""


@dataclass(frozen=True, slots=True)
class PulseTimes:
    """Pulse times and validity as bytes: a hashable key for caches that shots of the same timing share."""

    time_bytes: bytes
    valid_bytes: bytes

    @classmethod
    def of(cls, time_s: FloatArray, valid: BoolArray) -> PulseTimes:
        """Return the key of ``time_s`` and ``valid`` (pulse,)."""
        return cls(time_s.tobytes(), valid.tobytes())

    @property
    def time_s(self) -> FloatArray:
        """Pulse times (pulse,), read-only."""
        return np.frombuffer(self.time_bytes)

    @property
    def valid(self) -> BoolArray:
        """Which pulses are valid (pulse,), read-only."""
        return np.frombuffer(self.valid_bytes, dtype=bool)


@dataclass(frozen=True, slots=True)
class LinearModel:
    """The matrix H of the valid pulses and what follows from it; arrays are read-only.

    ``matrix`` (valid pulse, state) is H; ``every_pulse`` (pulse, state) has the rows of invalid pulses too. ``root``
    (state, state), upper triangular, is R^-1 with H'H = R'R: root @ root.T is the covariance of the states for noise of
    unit variance. ``condition``: condition number of the wanted and background columns scaled to unit length.
    ``wanted_states``: slice of the wanted and background states. ``column_hz`` (state,): frequency of each column, sin
    before cos; 0 for the background and for the single column of half the pulse rate.
    """

    matrix: FloatArray
    every_pulse: FloatArray
    root: FloatArray
    condition: float
    wanted_states: slice
    column_hz: FloatArray

    def velocity(self, state: FloatArray) -> FloatArray:
        """Return the derivative by time (valid pulse,) of the sinusoids with ``state`` (state,), per second."""
        # sin and cos have the derivatives w cos and -w sin: each pair of states is exchanged.
        sines = np.flatnonzero(self.column_hz)[::2]
        exchanged = np.zeros_like(state)
        exchanged[sines], exchanged[sines + 1] = -state[sines + 1], state[sines]
        return np.asarray(self.matrix @ (2 * np.pi * self.column_hz * exchanged))

    def solve(self, data: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the least-squares states x (..., state) of ``data`` d (..., valid pulse), and the residual d - H x.

        x = (H'H)^-1 H'd, with (H'H)^-1 = root @ root.T.
        """
        state, residual = np.zeros((*data.shape[:-1], self.root.shape[0])), data
        # Corrected seminormal equations: solving again for the residual reaches the accuracy of QR.
        for _ in range(2):
            change = (residual @ self.matrix) @ self.root @ self.root.T
            state, residual = state + change, residual - change @ self.matrix.T
        return state, residual


def harmonic_columns(time_s: FloatArray, frequency_hz: FloatArray, out: FloatArray | None = None) -> FloatArray:
    """Return sin and cos of 2 pi f t, interleaved, (pulse, 2 * frequency); written into ``out`` if given.

    The phase at the first pulse has no rounding error of its time: a train that starts at 1e5 s loses no phase.
    """
    # As exact fractions of integers, the first pulse is at start / start_divisor s and a frequency is cycles / seconds
    # Hz. Their product modulo one cycle is computed in integers, without rounding.
    start, start_divisor = float(time_s[0]).as_integer_ratio()
    ratios = [float(frequency).as_integer_ratio() for frequency in frequency_hz]
    cycles_before = np.array(
        [cycles * start % (seconds * start_divisor) / (seconds * start_divisor) for cycles, seconds in ratios]
    )
    angle = 2 * np.pi * (np.outer(time_s - time_s[0], frequency_hz) + cycles_before)
    columns = np.empty((time_s.size, 2 * len(cycles_before))) if out is None else out
    np.sin(angle, out=columns[:, ::2])
    np.cos(angle, out=columns[:, 1::2])
    return columns


def background_columns(time_s: FloatArray, order: int) -> FloatArray:
    """Return the Legendre polynomials 0 to ``order`` over the train (pulse, order + 1); no column for order -1."""
    if order <= 0:
        return np.ones((time_s.size, order + 1))
    # Scaled to -1 at the first pulse and 1 at the last.
    scaled = (time_s - time_s[0]) * (2 / (time_s[-1] - time_s[0])) - 1
    return np.asarray(np.polynomial.legendre.legvander(scaled, order))


def linear_model(
    time_s: FloatArray,
    valid: BoolArray,
    frequency_hz: FloatArray,
    *,
    background_order: int = 0,
    also_hz: FloatArray | Sequence[float] = (),
) -> LinearModel:
    """Return the linear model, sinusoids and a polynomial background, of the displacement at the valid pulses.

    ``background_order``: degree of the polynomial (0 constant, 1 velocity, 2 acceleration, more: drift), -1 for none.
    ``also_hz``: further frequencies that the tonebursts drive; those that the pulses resolve are fitted as well, from
    the lowest up. Raises ``ValueError`` for frequencies that are missing, repeated, not positive or at least half the
    pulse rate, for too few pulses, and for frequencies too close to resolve in the length of the train.
    """
    terms = tuple(frequency_hz.tolist()), tuple(np.asarray(also_hz).tolist()), background_order
    if time_s.size > MAX_CACHED_PULSES:
        return _model(time_s, valid, *terms)
    return _cached_model(PulseTimes.of(time_s, valid), *terms)


@lru_cache(maxsize=4)
def _cached_model(pulses: PulseTimes, *terms: Any) -> LinearModel:
    return _model(pulses.time_s, pulses.valid, *terms)


def _model(
    time_s: FloatArray,
    valid: BoolArray,
    frequencies_hz: tuple[float, ...],
    also_hz: tuple[float, ...],
    background_order: int,
) -> LinearModel:
    """Return the matrix H (pulse, state) of sinusoids and background polynomials at the pulses, and its inverse root.

    Columns: sin and cos of each of ``frequencies_hz``, polynomials up to ``background_order``, then sin and cos of
    those of ``also_hz`` that the valid pulses resolve. Raises ``ValueError`` if they do not resolve the sinusoids of
    ``frequencies_hz`` and the background.
    """
    frequency_hz = np.array(frequencies_hz)
    _check_frequencies(time_s, frequency_hz)
    harmonic_states = 2 * frequency_hz.size
    every_pulse = np.empty((time_s.size, harmonic_states + background_order + 1))
    harmonic_columns(time_s, frequency_hz, every_pulse[:, :harmonic_states])
    every_pulse[:, harmonic_states:] = background_columns(time_s, background_order)
    matrix: FloatArray = every_pulse if valid.all() else every_pulse[valid]
    pulses, states = matrix.shape
    if pulses <= states:
        raise ValueError(
            f"{pulses} valid pulses cannot give {states} unknowns and their uncertainty: too few; "
            f"try at least {states + 1} pulses or fewer frequencies"
        )
    products = matrix.T @ matrix
    # Columns in each group: sin and cos of a frequency, or one polynomial.
    sizes = [2] * frequency_hz.size + [1] * (background_order + 1)
    column_hz = np.repeat(np.append(frequency_hz, np.zeros(background_order + 1)), sizes)
    # Condition number: 1 is best, it grows as the pulses resolve the frequencies less. The eigenvalues of H'H are the
    # squared singular values of H.
    smallest, *_, largest = np.linalg.eigvalsh(_normalised(products, sizes)).tolist()
    condition = float(np.sqrt(largest / smallest)) if smallest > 0 else np.inf
    if not condition <= MAX_CONDITION:
        raise ValueError(_unresolved_message(time_s[valid], frequency_hz, condition))
    if also_hz:
        further_hz, groups = _further_columns(time_s, frequency_hz, np.array(also_hz))
        further_sizes = [group.shape[1] for group in groups]
        column_hz = np.append(column_hz, np.repeat(np.array(further_hz), np.array(further_sizes, dtype=np.intp)))
        every_pulse = _resolved(np.hstack([every_pulse, *groups]), valid, sizes + further_sizes, states)
        matrix = every_pulse if valid.all() else every_pulse[valid]
        products = matrix.T @ matrix
    # R^-1 with R'R = H'H. Products lose half of the digits at a condition of 1e8, none that count at the limit.
    root = np.asarray(np.linalg.inv(np.linalg.cholesky(products)).T)
    column_hz = column_hz[: matrix.shape[1]]
    for array in (matrix, every_pulse, root, column_hz):
        array.flags.writeable = False
    return LinearModel(
        matrix=matrix,
        every_pulse=every_pulse,
        root=root,
        condition=condition,
        wanted_states=slice(0, states),
        column_hz=column_hz,
    )


def _normalised(products: FloatArray, sizes: Sequence[int]) -> FloatArray:
    """Return the inner products H'H after each column of H is divided by the rms length of its group of columns.

    ``products``: H'H. ``sizes``: number of columns of each group, 2 for sin and cos of a frequency. A shift of time
    zero rotates sin into cos; with a common length the condition number then stays the same.
    """
    ends = np.cumsum(np.array(sizes, dtype=np.intp))
    starts = ends - np.array(sizes, dtype=np.intp)
    mean_square = np.add.reduceat(np.diagonal(products), starts) / sizes
    lengths = np.repeat(np.sqrt(mean_square).clip(min=np.finfo(np.float64).tiny), sizes)
    return np.asarray(products / np.outer(lengths, lengths))


def _resolved(every_pulse: FloatArray, valid: BoolArray, sizes: Sequence[int], states: int) -> FloatArray:
    """Return as many columns of ``every_pulse`` (pulse, column), from the first, as the ``valid`` pulses distinguish.

    The first ``states`` columns are always returned, further ones in whole groups of ``sizes`` columns, as long as the
    condition number of the columns allows. ``valid`` (pulse,).
    """
    matrix, counts = every_pulse[valid], np.cumsum(sizes)
    # At most half of the remaining degrees of freedom: noise is estimated from the others.
    counts = counts[(counts >= states) & (counts <= states + (len(matrix) - states) // 2)]
    return every_pulse[:, : _resolved_columns(_normalised(matrix.T @ matrix, sizes), counts)]


def _resolved_columns(products: FloatArray, counts: IndexArray) -> int:
    """Return the largest of ``counts`` for which so many first columns of H have a condition up to ``MAX_CONDITION``.

    H (pulse, column) is the matrix of a linear model; beyond that condition its columns are too similar at the pulses
    to be distinguished. ``counts``: numbers of columns, ascending; the first one is always accepted. ``products``: H'H
    of columns of equal length.
    """
    # The condition number grows with the number of columns, so bisection finds the largest acceptable number. It lies
    # between the indices ``low`` and ``high`` of ``counts``.
    low, high = 0, len(counts) - 1
    # The first trial is the number of all columns, since they are often distinguishable.
    trial = high
    while low < high:
        smallest, *_, largest = np.linalg.eigvalsh(products[: counts[trial], : counts[trial]])
        # The eigenvalues of H'H are the squared singular values of H.
        if largest <= MAX_CONDITION**2 * smallest:
            low = trial
        else:
            high = trial - 1
        trial = (low + high + 1) // 2
    return int(counts[low])


def _further_columns(
    time_s: FloatArray, frequency_hz: FloatArray, also_hz: FloatArray
) -> tuple[list[float], list[FloatArray]]:
    """Return the further frequencies of ``also_hz`` that the train can distinguish, and sin and cos (pulse, 2) of each.

    From the lowest up, a frequency is left out if it aliases within the train's resolution of zero or of a lower one.
    Half the pulse rate has one column only, and is returned as frequency 0.
    """
    # Frequencies closer than this, after aliasing, cannot be distinguished.
    rate_hz = pulse_rate_hz(time_s)
    resolution_hz = 0.9 / float(time_s[-1] - time_s[0])
    used_hz, further_hz, groups = aliased_hz(frequency_hz, rate_hz), list[float](), list[FloatArray]()
    for frequency, aliased in zip(np.sort(also_hz), aliased_hz(np.sort(also_hz), rate_hz), strict=True):
        if aliased < resolution_hz or np.abs(used_hz - aliased).min() < resolution_hz:
            continue
        used_hz = np.append(used_hz, aliased)
        if np.isclose(frequency, rate_hz / 2, rtol=1e-6, atol=0):
            # At half the pulse rate only the alternating column (-1)^k remains.
            further_hz.append(0.0)
            groups.append(np.cos(np.pi * np.round((time_s - time_s[0]) * rate_hz))[:, None])
        else:
            further_hz.append(float(frequency))
            groups.append(harmonic_columns(time_s, np.array([frequency])))
    return further_hz, groups


def pulse_rate_hz(time_s: FloatArray) -> float:
    """Return the rate of two or more pulses at ``time_s``: one over the median interval, which gaps do not change."""
    # np.partition instead of np.median, which imports NumPy's masked arrays: 1/60 of the time of a check.
    interval_s = np.diff(time_s)
    middle = interval_s.size // 2
    return 1 / float(np.partition(interval_s, middle)[middle])


def aliased_hz(frequency_hz: FloatArray, rate_hz: float) -> FloatArray:
    """Return the alias frequencies, from 0 to half the rate, of ``frequency_hz`` sampled at ``rate_hz``."""
    return np.asarray(np.abs(frequency_hz - rate_hz * np.round(frequency_hz / rate_hz)))


def _check_frequencies(time_s: FloatArray, frequency_hz: FloatArray) -> None:
    """Raise ``ValueError`` for frequencies that pulses at these times cannot measure: repeated or aliased, say."""
    if frequency_hz.ndim != 1 or frequency_hz.size == 0:
        raise ValueError("no vibration frequency given: name at least one")
    if not np.all(np.isfinite(frequency_hz) & (frequency_hz > 0)):
        raise ValueError(f"frequencies {numbers_text(frequency_hz)} Hz: each must be finite and above zero")
    if len(set(frequency_hz.tolist())) != frequency_hz.size:
        raise ValueError(f"frequencies {numbers_text(frequency_hz)} Hz name one twice: give each once")
    if time_s.size < 2:
        raise ValueError(f"{time_s.size} pulse: no motion can be measured; try more tracking pulses")
    rate_hz = pulse_rate_hz(time_s)
    if frequency_hz.max() >= rate_hz / 2 * (1 - 1e-9):
        at_nyquist = np.isclose(frequency_hz.max(), rate_hz / 2)
        cause = "only one of its two quadratures can be measured" if at_nyquist else "aliased"
        raise ValueError(
            f"frequency {frequency_hz.max():g} Hz is not below half the pulse rate of {rate_hz:g} Hz: "
            f"{cause}; try a higher pulse rate or fewer harmonics"
        )


def _unresolved_message(time_s: FloatArray, frequency_hz: FloatArray, condition: float) -> str:
    """Return the error message for frequencies that a train with pulses at ``time_s`` cannot resolve."""
    span_s = float(time_s[-1] - time_s[0])
    closest_hz = float(np.min(np.diff(np.sort(frequency_hz), prepend=0.0)))
    return (
        f"frequencies {numbers_text(frequency_hz)} Hz cannot be resolved (condition {condition:.3g}, "
        f"limit {MAX_CONDITION:g}): the closest two, zero included, are {closest_hz:g} Hz apart in a window of "
        f"{span_s:g} s, or the valid pulses are spaced badly; try at least {1 / closest_hz:g} s or other frequencies"
    )
