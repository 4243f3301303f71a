"""Linear model of slow time: sinusoids, a smooth background, and what pulses can resolve.

State order: in-phase and quadrature (A cos phi, A sin phi) of each wanted frequency, the background, then frequencies
that are there and not wanted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from hpe_rig.arrays import BoolArray, FloatArray
from hpe_rig.plan import LARGEST_CONDITION as LARGEST_CONDITION

SURE_CONDITION = 1e4
"""Condition number up to which products of columns, its square, leave half of the digits; QR keeps them all."""
LARGEST_KEPT = 1 << 16
"""Pulses up to which a model is kept for the next train with the same times."""


@dataclass(frozen=True, slots=True)
class LinearModel:
    """A model matrix (valid pulse, state), and the condition number of what is wanted (columns scaled to unit length).

    ``every_pulse`` (pulse, state) has the rows of the other pulses as well; ``root`` (state, state), upper triangular,
    times its transpose is the states' covariance for data of unit variance. All are read-only.
    """

    matrix: FloatArray
    every_pulse: FloatArray
    root: FloatArray
    condition: float
    wanted: slice

    def solve(self, data: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the least-squares states (..., state) of ``data`` (..., valid pulse), and what they leave of it."""
        state = np.zeros((*data.shape[:-1], self.root.shape[0]))
        # from what the first solution leaves, a second has the accuracy of QR (corrected seminormal equations)
        for _ in range(2):
            change = (data @ self.matrix) @ self.root @ self.root.T
            state, data = state + change, data - change @ self.matrix.T
        return state, data


def harmonic_columns(time_s: FloatArray, frequency_hz: FloatArray, out: FloatArray | None = None) -> FloatArray:
    """Return sin and cos of 2 pi f t, interleaved (pulse, 2 * frequency), in ``out`` if given.

    The cycles before the first pulse are counted exactly, in fractions: a start at 1e5 s loses no phase.
    """
    start, unit = float(time_s[0]).as_integer_ratio()
    ratios = [float(f).as_integer_ratio() for f in frequency_hz]
    before = np.array([cycles * start % (of * unit) / (of * unit) for cycles, of in ratios])
    angle = 2 * np.pi * (np.outer(time_s - time_s[0], frequency_hz) + before)
    columns = np.empty((time_s.size, 2 * len(before))) if out is None else out
    np.sin(angle, out=columns[:, ::2])
    np.cos(angle, out=columns[:, 1::2])
    return columns


def background_columns(time_s: FloatArray, order: int) -> FloatArray:
    """Return Legendre polynomials 0 to ``order`` over the train (pulse, order + 1); none for order -1."""
    if order <= 0:
        return np.ones((time_s.size, order + 1))
    return np.asarray(np.polynomial.legendre.legvander(scaled_time(time_s), order))


def scaled_time(time_s: FloatArray) -> FloatArray:
    """Return times from -1 at the first pulse to 1 at the last."""
    return np.asarray((time_s - time_s[0]) * (2 / (time_s[-1] - time_s[0])) - 1)


def linear_model(
    time_s: FloatArray,
    valid: BoolArray,
    frequency_hz: FloatArray,
    largest_condition: float = LARGEST_CONDITION,
    *,
    background_order: int = 0,
    also_hz: FloatArray | Sequence[float] = (),
) -> LinearModel:
    """Return the model of the valid pulses: wanted frequencies, background polynomial, then the others (``also_hz``).

    Of the others, those stay, from the lowest up, that the pulses can resolve.

    ``background_order`` 0 is a constant, 1 a velocity, 2 an acceleration, more a drift; -1 leaves it out. Raises
    ``ValueError`` for no or non-positive or repeated frequencies, a frequency at or above half the pulse rate, too few
    pulses, or frequencies too close for the time they are watched.
    """
    choice = tuple(frequency_hz.tolist()), tuple(np.asarray(also_hz).tolist()), background_order, largest_condition
    if time_s.size > LARGEST_KEPT:
        return _model(time_s, valid, *choice)
    return _kept_model(time_s.tobytes(), valid.tobytes(), *choice)


@lru_cache(maxsize=4)
def _kept_model(time_s: bytes, valid: bytes, *choice: Any) -> LinearModel:
    return _model(np.frombuffer(time_s), np.frombuffer(valid, dtype=bool), *choice)


def _model(
    time_s: FloatArray,
    valid: BoolArray,
    frequencies_hz: tuple[float, ...],
    also_hz: tuple[float, ...],
    background_order: int,
    largest_condition: float,
) -> LinearModel:
    frequency_hz = np.array(frequencies_hz)
    _require_frequencies(time_s, frequency_hz)
    wanted = 2 * frequency_hz.size
    every_pulse = np.empty((time_s.size, wanted + background_order + 1))
    harmonic_columns(time_s, frequency_hz, every_pulse[:, :wanted])
    every_pulse[:, wanted:] = background_columns(time_s, background_order)
    matrix: FloatArray = every_pulse if valid.all() else every_pulse[valid]
    found, states = matrix.shape
    if found <= states:
        raise ValueError(
            f"{found} valid pulses cannot give {states} unknowns and their uncertainty: too few; "
            f"try at least {states + 1} pulses or fewer frequencies"
        )
    products = matrix.T @ matrix
    condition = _condition(matrix, products)
    if not condition <= largest_condition:
        raise ValueError(_unresolved(time_s[valid], frequency_hz, condition, largest_condition))
    if also_hz:
        # Half of what is left stays for the noise.
        others = _other_columns(time_s, frequency_hz, np.array(also_hz))[:, : (found - states) // 2]
        every_pulse = np.hstack([every_pulse, others])
        kept = states + _resolvable(every_pulse[valid], states, largest_condition)
        every_pulse = every_pulse[:, :kept]
        matrix = every_pulse if valid.all() else every_pulse[valid]
        products = matrix.T @ matrix
    root = triangular_root(matrix, products, max(condition, largest_condition if also_hz else 1.0))
    for array in (matrix, every_pulse, root):
        array.flags.writeable = False
    return LinearModel(matrix, every_pulse, root, condition, slice(0, states))


def triangular_root(matrix: FloatArray, products: FloatArray, condition: float) -> FloatArray:
    """Return the upper triangular root (state, state) of the inverse of the ``products`` of a matrix's columns."""
    if condition > SURE_CONDITION:
        return np.asarray(np.linalg.inv(np.linalg.qr(matrix, mode="r")))
    return np.asarray(np.linalg.inv(np.linalg.cholesky(products)).T)


def _condition(matrix: FloatArray, products: FloatArray) -> float:
    length = np.sqrt(np.diagonal(products)).clip(min=np.finfo(np.float64).tiny)
    # products of columns have the condition's square: good up to 1e4, beyond it QR has the digits
    smallest, *_, largest = np.linalg.eigvalsh(products / np.outer(length, length)).tolist()
    if smallest > largest / SURE_CONDITION**2:
        return float(np.sqrt(largest / smallest))
    values = np.linalg.svd(np.linalg.qr(matrix / length, mode="r"), compute_uv=False)
    return float(values[0] / values[-1]) if values[-1] > 0 else np.inf


def _resolvable(matrix: FloatArray, wanted: int, largest_condition: float) -> int:
    """Return how many columns after the ``wanted`` the pulses can resolve, from those and from each other."""
    scaled = matrix / np.linalg.norm(matrix, axis=0).clip(min=np.finfo(np.float64).tiny)
    gram = scaled.T @ scaled
    # More columns never lower the condition, so a bisection finds the last good number.
    few, many = 0, matrix.shape[1] - wanted
    # The first look is at all: often all can be resolved.
    middle = many
    while few < many:
        smallest, *_, largest = np.linalg.eigvalsh(gram[: wanted + middle, : wanted + middle])
        if largest <= largest_condition**2 * smallest:
            few = middle
        else:
            many = middle - 1
        middle = (few + many + 1) // 2
    return few


def _other_columns(time_s: FloatArray, frequency_hz: FloatArray, also_hz: FloatArray) -> FloatArray:
    """Return the columns of ``also_hz`` without those of ``frequency_hz``, from the lowest frequency up.

    Half the pulse rate has only one. Frequencies above it are there when the pulses see them in another place than
    every lower one: those of a burst rate that is no divisor of the pulse rate.
    """
    rate_hz = pulse_rate_hz(time_s)
    apart_hz = 0.9 / float(time_s[-1] - time_s[0])
    seen_hz, new_hz = aliased_hz(frequency_hz, rate_hz), []
    for frequency, aliased in zip(np.sort(also_hz), aliased_hz(np.sort(also_hz), rate_hz), strict=True):
        if aliased >= apart_hz and np.abs(seen_hz - aliased).min() >= apart_hz:
            seen_hz = np.append(seen_hz, aliased)
            new_hz.append(frequency)
    if not new_hz:
        return np.zeros((time_s.size, 0))
    one_sided = np.isclose(new_hz, rate_hz / 2, rtol=1e-6, atol=0)
    columns = harmonic_columns(time_s, np.where(one_sided, 0.0, new_hz))
    if one_sided.any():
        alternating = np.cos(np.pi * np.round((time_s - time_s[0]) * rate_hz))
        place = 2 * int(np.argmax(one_sided))
        columns = np.hstack([columns[:, :place], alternating[:, None], columns[:, place + 2 :]])
    return columns


def pulse_rate_hz(time_s: FloatArray) -> float:
    """Return the rate of pulses at ``time_s``, two at least: over the median interval, which gaps leave as it is."""
    # np.median loads NumPy's masked arrays, for a sixtieth of the time of a check
    interval_s = np.diff(time_s)
    middle = interval_s.size // 2
    return 1 / float(np.partition(interval_s, middle)[middle])


def aliased_hz(frequency_hz: FloatArray, rate_hz: float) -> FloatArray:
    """Return where pulses at ``rate_hz`` see a frequency, from 0 to half the rate."""
    return np.asarray(np.abs(frequency_hz - rate_hz * np.round(frequency_hz / rate_hz)))


def _require_frequencies(time_s: FloatArray, frequency_hz: FloatArray) -> None:
    if frequency_hz.ndim != 1 or frequency_hz.size == 0:
        raise ValueError("no vibration frequency given: name at least one")
    if not np.all(np.isfinite(frequency_hz) & (frequency_hz > 0)):
        raise ValueError(f"frequencies {frequency_hz.tolist()} Hz: each must be finite and above zero")
    if len(set(frequency_hz.tolist())) != frequency_hz.size:
        raise ValueError(f"frequencies {frequency_hz.tolist()} Hz name one twice: give each once")
    if time_s.size < 2:
        raise ValueError(f"{time_s.size} pulse: no motion can be seen; try more tracking pulses")
    rate_hz = pulse_rate_hz(time_s)
    if frequency_hz.max() >= rate_hz / 2 * (1 - 1e-9):
        why = (
            "only one of its two quadratures can be seen" if np.isclose(frequency_hz.max(), rate_hz / 2) else "aliased"
        )
        raise ValueError(
            f"frequency {frequency_hz.max():g} Hz is not below half the pulse rate of {rate_hz:g} Hz: "
            f"{why}; try a higher pulse rate or fewer harmonics"
        )


def _unresolved(time_s: FloatArray, frequency_hz: FloatArray, condition: float, limit: float) -> str:
    span_s = float(time_s[-1] - time_s[0])
    closest_hz = float(np.min(np.diff(np.sort(frequency_hz), prepend=0.0)))
    return (
        f"frequencies {frequency_hz.tolist()} Hz cannot be resolved (condition {condition:.3g}, limit {limit:g}): "
        f"the closest two, zero included, are {closest_hz:g} Hz apart in a window of {span_s:g} s, or the valid "
        f"pulses are spaced badly; try at least {1 / closest_hz:g} s or other frequencies"
    )
