"""Echoes of proportional motion from sums over the resting scatterers: nearly free in the number of echoes.

With delays tau_n + sum_r b_kr g_rn (b the motion as a delay, g its shapes), an exponential of the pulse turns by

    exp(-j w sum_r b_kr g_rn) = sum_a  (-j w)^|a|  b_k^a / a!  g_n^a          (a: one exponent a shape)

so every echo is a short combination, with coefficients b_k^a / a!, of the sums ``U_a(t) = sum_n I_n g_n^a p^(|a|)(t -
tau_n)`` (sign aside) over scatterers at rest. That moves the exponentials but not the ends of the support; the few
samples that an end crosses while its scatterer moves are corrected one by one with the pulse's Taylor series there.
Both parts converge geometrically, whatever the pulse: no derivative has to be continuous at the ends.
"""

from __future__ import annotations

import functools
import itertools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim_backend.pulse import Pulse, phasors

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]
Indices = NDArray[np.int64]
Booleans = NDArray[np.bool_]

MOST_ANGLE_RAD = 3.0
"""Largest turn of the highest frequency: beyond, the series' terms grow and take digits with them."""

_VALUES_AT_ONCE = 1 << 18
# Shares of the tolerance: the tail of the series, and the crossings left out or cut short.
_TAIL_SHARE = 0.25
CROSSING_SHARE = 0.1


@dataclass(frozen=True, slots=True)
class Resting:
    """Scatterers of one or more scenes (rows) and their motion, in ascending row and, within one, delay."""

    row: Indices
    """(scatterer,), the scene each belongs to."""
    rest_s: Floats
    """(scatterer,), echo delay about which it moves."""
    weight: Floats
    """(scatterer,)."""
    shape: Floats
    """(shape, scatterer), g."""
    amplitude_s: Floats
    """(row, echo, shape), b: the delay that a shape of 1 adds."""


def terms_needed(angle_rad: float, tolerance: float) -> int:
    """Return how many orders keep the tail of exp(j angle) below ``tolerance``'s share."""
    tail, order = 1.0, 0
    while tail > _TAIL_SHARE * tolerance and order < 64:
        order += 1
        tail *= angle_rad / order
    return max(1, order)


def exponents(shapes: int, orders: int) -> list[tuple[int, ...]]:
    """Return every exponent tuple of ``shapes`` numbers with a sum below ``orders``, zero first."""
    every = (powers for powers in itertools.product(range(orders), repeat=shapes) if sum(powers) < orders)
    return sorted(every, key=sum)


def largest_angle(pulse: Pulse, shape: Floats, amplitude_s: Floats) -> float:
    """Return a bound on the turn of the pulse's highest frequency, rad."""
    if shape.size == 0 or amplitude_s.size == 0:
        return 0.0
    reach_s = sum(largest_size(amplitude_s[..., axis]) * largest_size(shape[axis]) for axis in range(len(shape)))
    return 2 * math.pi * max(abs(hz) for hz in pulse.frequency_hz) * reach_s


def series(scene: Resting, pulse: Pulse, sample_time_s: Floats, tolerance: float) -> Floats:
    """Return the echoes, float64 (row, echo, sample), to ``tolerance`` of their rms; samples within one pulse length.

    Raises ValueError where the motion turns the pulse by more than `MOST_ANGLE_RAD`.
    """
    tables = series_tables(scene, pulse, sample_time_s, tolerance)
    enter = sample_time_s.searchsorted(scene.rest_s + pulse.start_s)
    leave = sample_time_s.searchsorted(scene.rest_s + pulse.end_s)
    sums = _rest_sums(scene, enter, leave, tables, pulse, len(sample_time_s))
    rms = math.sqrt(float(np.vdot(sums[:, 0], sums[:, 0])) / sums[:, 0].size)
    out: Floats = np.matmul(_coefficients(scene.amplitude_s * tables.scale, tables.powers), sums)
    budget = CROSSING_SHARE * tolerance * rms * math.sqrt(len(sample_time_s))
    _correct_crossings(out, scene, (enter, leave), tables, pulse, sample_time_s, budget)
    return out


def series_tables(scene: Resting, pulse: Pulse, sample_time_s: Floats, tolerance: float) -> Tables:
    """Return what pulse, gate and number of orders fix; raises ValueError where the motion is too large."""
    angle = largest_angle(pulse, scene.shape, scene.amplitude_s)
    if angle > MOST_ANGLE_RAD:
        raise ValueError(
            f"the motion turns the pulse by {angle:.3g} rad, the series holds up to {MOST_ANGLE_RAD} rad: "
            "take the running sum"
        )
    orders = terms_needed(angle, tolerance)
    return _tables(pulse, sample_time_s.tobytes(), len(scene.shape), orders)


@dataclass(frozen=True, slots=True)
class Tables:
    """What a pulse and a gate fix."""

    powers: list[tuple[int, ...]]
    scale: float
    """Highest angular frequency of the pulse, rad/s, to which moments and coefficients are referred."""
    real: Floats
    imag: Floats
    """c_m (-j w_m / scale)^|a| exp(j w_m t), (frequency, exponent, sample)."""
    jumps: tuple[list[float], list[float]]
    """Start and end: sizes of the jumping derivatives over their factorials, referred to the carrier, (order,)."""
    taylor: Floats
    """Taylor coefficients of the exponentials about start and end, (end, order)."""


@functools.lru_cache(maxsize=32)
def _tables(pulse: Pulse, sample_time: bytes, shapes: int, orders: int) -> Tables:
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
        powers,
        float(2 * math.pi * np.abs(hz).max()),
        np.ascontiguousarray(rotation.real),
        np.ascontiguousarray(rotation.imag),
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


def _coefficients(amplitude_rad: Floats, powers: list[tuple[int, ...]]) -> Floats:
    """Return b^a / a!, (row, echo, exponent)."""
    out = np.empty((len(powers), *amplitude_rad.shape[:2]))
    out[0] = 1.0
    place = {power: index for index, power in enumerate(powers)}
    for index, power in enumerate(powers[1:], 1):
        shape, lower = _one_less(power)
        np.multiply(out[place[lower]], amplitude_rad[..., shape] / power[shape], out=out[index])
    return np.ascontiguousarray(np.moveaxis(out, 0, -1))


def _one_less(power: tuple[int, ...]) -> tuple[int, tuple[int, ...]]:
    shape = next(axis for axis, count in enumerate(power) if count)
    return shape, tuple(count - (axis == shape) for axis, count in enumerate(power))


def _rest_sums(scene: Resting, enter: Indices, leave: Indices, tables: Tables, pulse: Pulse, samples: int) -> Floats:
    """Return U_a, real (row, exponent, sample), of the scatterers whose support at rest holds a sample."""
    rows, shape = len(scene.amplitude_s), (len(pulse.frequency_hz), len(tables.powers))
    seen = np.flatnonzero((enter < leave) & (enter < samples) & (leave > 0))
    cell = np.where(enter == 0, samples - leave, samples + enter)
    if rows > 1:
        cell += 2 * samples * scene.row
    columns = shape[0] * shape[1]
    cells = np.zeros((2 * samples * rows, columns), dtype=np.complex128)
    at_once = max(64, _VALUES_AT_ONCE // columns)
    for first in range(0, len(seen), at_once):
        part = seen[first : first + at_once]
        key = cell[part]
        run = _runs(key)
        values = phasors(pulse, scene.rest_s[part], -1)[:, None] * _moments(scene, part, tables.powers)
        cells[key[run]] += np.add.reduceat(values.reshape(columns, -1), run, axis=1).T
    summed = np.cumsum(cells.T.reshape(*shape, rows, 2, samples), axis=-1)
    alive = summed[..., 0, ::-1] + summed[..., 1, :]
    turned = tables.real[:, :, None] * alive.real - tables.imag[:, :, None] * alive.imag
    return np.ascontiguousarray(np.moveaxis(turned.sum(axis=0), 0, 1))


def _runs(key: Indices) -> Indices:
    """Return where a new value begins."""
    new = np.empty(len(key), dtype=np.bool_)
    new[:1] = True
    np.not_equal(key[1:], key[:-1], out=new[1:])
    return np.flatnonzero(new)


def _moments(scene: Resting, part: Indices, powers: list[tuple[int, ...]]) -> Floats:
    """Return I_n g_n^a, (exponent, scatterer)."""
    out = np.empty((len(powers), len(part)))
    out[0] = scene.weight[part]
    shape = scene.shape[:, part]
    place = {power: index for index, power in enumerate(powers)}
    for index, power in enumerate(powers[1:], 1):
        axis, lower = _one_less(power)
        np.multiply(out[place[lower]], shape[axis], out=out[index])
    return out


def _correct_crossings(
    out: Floats,
    scene: Resting,
    index: tuple[Indices, Indices],
    tables: Tables,
    pulse: Pulse,
    sample_time_s: Floats,
    budget: float,
) -> None:
    """Add, at each sample that an end of a support crosses, what the motion lets in or out; in place.

    ``index`` (start, end): first sample from each scatterer's end on, at rest. Crossings that together add less than
    ``budget`` to one echo are left out.
    """
    reach_s = np.abs(scene.amplitude_s).max(axis=(0, 1)) @ np.abs(scene.shape)
    farthest_s, heaviest = float(reach_s.max(initial=0.0)), float(np.abs(scene.weight).max(initial=0.0))
    if farthest_s == 0:
        return
    samples = len(sample_time_s)
    duration_s = float(sample_time_s[-1] - sample_time_s[0])
    likely = 2 * len(reach_s) * (1 + (2 * farthest_s * (samples - 1) / duration_s if duration_s > 0 else 0))
    each = budget / likely
    for end, edge_s in enumerate((pulse.start_s, pulse.end_s)):
        order, largest = largest_near(tables.jumps[end], farthest_s)
        bound = np.abs(scene.weight) * (reach_s / farthest_s) ** order * largest
        matter = np.flatnonzero(bound > each)
        edge_time_s = scene.rest_s[matter] + edge_s
        low = sample_time_s.searchsorted(edge_time_s - reach_s[matter])
        count = sample_time_s.searchsorted(edge_time_s + reach_s[matter], side="right") - low
        crossed = np.flatnonzero(count)
        count = count[crossed]
        pair = np.repeat(crossed, count)
        sample = np.repeat(low[crossed] - np.cumsum(count) + count, count) + np.arange(len(pair))
        who = matter[pair]
        angle = tables.scale * farthest_s
        taylor = enough_taylor(
            tables.taylor[end], angle, each / heaviest / max(1.0, float(np.abs(pulse.amplitude).sum()))
        )
        at_once = max(1, _VALUES_AT_ONCE // out.shape[1])
        for begin in range(0, len(who), at_once):
            some = slice(begin, begin + at_once)
            past_s = sample_time_s[sample[some]] - edge_time_s[pair[some]]
            was_past = sample[some] >= index[end][who[some]]
            _add_pairs(out, scene, who[some], sample[some], past_s, was_past, -taylor if end else taylor)


def _add_pairs(
    out: Floats, scene: Resting, who: Indices, sample: Indices, past_s: Floats, was_past: Booleans, taylor: Floats
) -> None:
    row = scene.row[who]
    order = np.lexsort((sample, row))
    row, sample, who = row[order], sample[order], who[order]
    if len(scene.amplitude_s) == 1:
        moved_s = scene.shape[:, who].T @ scene.amplitude_s[0].T
    else:
        moved_s = np.matmul(scene.amplitude_s[row], scene.shape[:, who].T[:, :, None])[:, :, 0]
    x = past_s[order, None] - moved_s
    change = scene.weight[who, None] * ((x >= 0) * 1.0 - was_past[order, None])
    value = np.full_like(x, taylor[-1])
    for coefficient in taylor[-2::-1]:
        value *= x
        if coefficient != 0:
            value += coefficient
    value *= change
    run = _runs(row * out.shape[2] + sample)
    out[row[run], :, sample[run]] += np.add.reduceat(value, run, axis=0)


def largest_near(jumps: list[float], reach_s: float) -> tuple[int, float]:
    """Return the lowest order that jumps, and a bound on the exponentials within ``reach_s`` of the support's end."""
    bound = 0.0
    for jump in reversed(jumps):
        bound = bound * reach_s + jump
    return next((order for order, jump in enumerate(jumps) if jump > 0), 0), bound


def largest_size(value: Floats) -> float:
    """Return the largest magnitude, 0 of nothing."""
    return max(abs(float(value.max())), abs(float(value.min()))) if value.size else 0.0


def enough_taylor(taylor: Floats, angle: float, tolerance: float) -> Floats:
    """Return as many Taylor coefficients as keep the rest below ``tolerance``, ``angle`` from the end."""
    tail, orders = angle, 1
    while tail > tolerance and orders < len(taylor):
        orders += 1
        tail *= angle / orders
    return taylor[:orders]
