"""What a pulse, a gate and a number of orders fix of the series in `echo_series`."""

from __future__ import annotations

import functools
import itertools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim_backend.echoes.pulse import Pulse, phasors

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]

# Share of the tolerance for the tail of the series.
_TAIL_SHARE = 0.25


def terms_needed(angle_rad: float, tolerance: float) -> int:
    """Return how many orders keep the tail of exp(j angle) below ``tolerance``'s share."""
    tail, order = 1.0, 0
    while tail > _TAIL_SHARE * tolerance and order < 64:
        order += 1
        tail *= angle_rad / order
    return max(1, order)


def exponents(shapes: int, orders: int) -> list[tuple[int, ...]]:
    """Return every exponent tuple of ``shapes`` numbers with a sum below ``orders``, in ascending sum."""
    chosen = (itertools.combinations_with_replacement(range(shapes), degree) for degree in range(orders))
    return [tuple(map(axes.count, range(shapes))) for axes in itertools.chain.from_iterable(chosen)]


def steps(powers: list[tuple[int, ...]]) -> list[tuple[int, int, int]]:
    """Return for every exponent tuple but the first which one it is a shape times, that shape, and its exponent."""
    place = {power: index for index, power in enumerate(powers)}
    found = []
    for power in powers[1:]:
        shape = next(axis for axis, count in enumerate(power) if count)
        lower = tuple(count - (axis == shape) for axis, count in enumerate(power))
        found.append((place[lower], shape, power[shape]))
    return found


@dataclass(frozen=True, slots=True)
class Tables:
    """What a pulse and a gate fix."""

    steps: list[tuple[int, int, int]]
    """How each monomial of the shapes but the first follows from an earlier one (`steps`)."""
    scale: float
    """Highest angular frequency of the pulse, rad/s, to which moments and coefficients are referred."""
    turn: Complexes
    """c_m (-j w_m / scale)^|a| exp(j w_m t), (frequency, exponent, sample)."""
    jumps: tuple[list[float], list[float]]
    """Start and end: sizes of the jumping derivatives over their factorials, referred to the carrier, (order,)."""
    taylor: Floats
    """Taylor coefficients of the exponentials about start and end, (end, order)."""


@functools.lru_cache(maxsize=32)
def tables_of(pulse: Pulse, sample_time: bytes, shapes: int, orders: int) -> Tables:
    """Return the tables; kept, because studies and records repeat few gates many times."""
    sample_time_s = np.frombuffer(sample_time)
    hz = np.array(pulse.frequency_hz)
    powers = exponents(shapes, orders)
    order = np.array([sum(power) for power in powers])
    slope = np.array(pulse.amplitude)[:, None] * np.power((-1j * hz / np.abs(hz).max())[:, None], order)
    rotation = slope[:, :, None] * phasors(pulse, sample_time_s, 1)[:, None]
    carrier_hz = pulse.frequency_hz[int(np.argmax(np.abs(pulse.amplitude)))]
    ends = (pulse.start_s, pulse.end_s)
    jumps = [np.abs(_edge_derivatives(pulse, edge_s, carrier_hz, 20)).tolist() for edge_s in ends]
    taylor = np.stack([_edge_derivatives(pulse, edge_s, 0.0, 40).real for edge_s in ends])
    return Tables(
        steps(powers),
        float(2 * math.pi * np.abs(hz).max()),
        rotation,
        (jumps[0], jumps[1]),
        taylor,
    )


def _edge_derivatives(pulse: Pulse, edge_s: float, about_hz: float, orders: int) -> Complexes:
    """Return derivative over factorial of the exponentials at an end, (order,), turned back by ``about_hz``."""
    omega = 2 * np.pi * np.array(pulse.frequency_hz)
    parts = np.array(pulse.amplitude) * np.exp(1j * omega * edge_s)
    rate = 1j * (omega - 2 * np.pi * about_hz)
    out = np.empty(orders, dtype=np.complex128)
    unit = float(np.abs(pulse.amplitude).sum())
    for order in range(orders):
        out[order] = parts.sum()
        # What cancels exactly on paper (the Hann pulse and its slope are 0 at its ends) must not count as a jump.
        if abs(out[order]) < 1e-12 * unit:
            out[order] = 0.0
        parts = parts * rate / (order + 1)
        unit *= float(np.abs(rate).max()) / (order + 1)
    return out
