"""Echoes of proportional motion from sums over the resting scatterers: nearly free in the number of echoes.

With delays tau_n + sum_r b_kr g_rn (b the motion as a delay, g its shapes), an exponential of the pulse turns by

    exp(-j w sum_r b_kr g_rn) = sum_a  (-j w)^|a|  b_k^a / a!  g_n^a          (a: one exponent a shape)

so every echo is a short combination, with coefficients b_k^a / a!, of the sums ``U_a(t) = sum_n I_n g_n^a p^(|a|)(t -
tau_n)`` (sign aside) over scatterers at rest. That moves the exponentials but not the ends of the support; the few
samples that an end crosses while its scatterer moves are corrected one by one with the pulse's Taylor series there.
Both parts converge geometrically, whatever the pulse: no derivative has to be continuous at the ends.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim_backend.pulse import Pulse, phasors

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]
Indices = NDArray[np.int64]

MOST_ANGLE_RAD = 3.0
"""Largest turn of the highest frequency: beyond, the series' terms grow and take digits with them."""

_VALUES_AT_ONCE = 1 << 18
# Shares of the tolerance: the tail of the series, and the crossings left out or cut short.
_TAIL_SHARE = 0.25
_CROSSING_SHARE = 0.1


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
    reach_s = np.abs(amplitude_s).max(axis=(0, 1)) @ np.abs(shape).max(axis=1)
    return float(2 * math.pi * max(abs(hz) for hz in pulse.frequency_hz) * reach_s)


def series(scene: Resting, pulse: Pulse, sample_time_s: Floats, tolerance: float) -> Floats:
    """Return the echoes, float64 (row, echo, sample), to ``tolerance`` of their rms; samples within one pulse length.

    Raises ValueError where the motion turns the pulse by more than `MOST_ANGLE_RAD`.
    """
    angle = largest_angle(pulse, scene.shape, scene.amplitude_s)
    if angle > MOST_ANGLE_RAD:
        raise ValueError(
            f"the motion turns the pulse by {angle:.3g} rad, the series holds up to {MOST_ANGLE_RAD} rad: "
            "take the running sum"
        )
    rows, echoes, shapes = scene.amplitude_s.shape
    orders = terms_needed(angle, tolerance)
    powers = exponents(shapes, orders)
    enter = np.searchsorted(sample_time_s, scene.rest_s + pulse.start_s)
    leave = np.searchsorted(sample_time_s, scene.rest_s + pulse.end_s)
    sums = _rest_sums(scene, enter, leave, powers, pulse, sample_time_s)
    rms = float(np.sqrt(np.mean(np.square(sums[0]))))
    scale = 2 * math.pi * max(abs(hz) for hz in pulse.frequency_hz)
    out = np.matmul(_coefficients(scene.amplitude_s * scale, powers), np.moveaxis(sums, 0, 1))
    budget = _CROSSING_SHARE * tolerance * rms * math.sqrt(len(sample_time_s))
    _correct_crossings(out, scene, (enter, leave), pulse, sample_time_s, budget)
    return out


def _coefficients(amplitude_rad: Floats, powers: list[tuple[int, ...]]) -> Floats:
    out = np.ones((*amplitude_rad.shape[:2], len(powers)))
    place = {power: index for index, power in enumerate(powers)}
    for index, power in enumerate(powers[1:], 1):
        shape = next(axis for axis, count in enumerate(power) if count)
        lower = tuple(count - (axis == shape) for axis, count in enumerate(power))
        out[..., index] = out[..., place[lower]] * amplitude_rad[..., shape] / power[shape]
    return out


def _rest_sums(
    scene: Resting, enter: Indices, leave: Indices, powers: list[tuple[int, ...]], pulse: Pulse, sample_time_s: Floats
) -> Floats:
    """Return U_a, real (exponent, row, sample), of the scatterers whose support at rest holds a sample."""
    samples, rows = len(sample_time_s), len(scene.amplitude_s)
    seen = np.flatnonzero((enter < leave) & (enter < samples) & (leave > 0))
    cell = np.where(enter == 0, samples - leave, samples + enter) + 2 * samples * scene.row
    cells = np.zeros((len(powers), len(pulse.frequency_hz), 2 * samples * rows), dtype=np.complex128)
    at_once = max(64, _VALUES_AT_ONCE // (len(powers) * len(pulse.frequency_hz)))
    for first in range(0, len(seen), at_once):
        part = seen[first : first + at_once]
        key = cell[part]
        run = np.flatnonzero(np.concatenate(([True], key[1:] != key[:-1])))
        values = _moments(scene, part, powers)[:, None] * phasors(pulse, scene.rest_s[part], -1)
        cells[..., key[run]] += np.add.reduceat(values, run, axis=-1)
    summed = np.cumsum(cells.reshape(len(powers), len(pulse.frequency_hz), rows, 2, samples), axis=-1)
    alive = summed[..., 0, ::-1] + summed[..., 1, :]
    return _turned(alive, powers, pulse, sample_time_s)


def _moments(scene: Resting, part: Indices, powers: list[tuple[int, ...]]) -> Floats:
    """Return I_n g_n^a, (exponent, scatterer)."""
    out = np.empty((len(powers), len(part)))
    out[0] = scene.weight[part]
    shape = scene.shape[:, part]
    place = {power: index for index, power in enumerate(powers)}
    for index, power in enumerate(powers[1:], 1):
        axis = next(axis for axis, count in enumerate(power) if count)
        lower = tuple(count - (other == axis) for other, count in enumerate(power))
        np.multiply(out[place[lower]], shape[axis], out=out[index])
    return out


def _turned(alive: Complexes, powers: list[tuple[int, ...]], pulse: Pulse, sample_time_s: Floats) -> Floats:
    """Return Re sum_m c_m (-j w_m / w_max)^|a| exp(j w_m t) alive_m, real (exponent, row, sample)."""
    hz = np.array(pulse.frequency_hz)
    order = np.array([sum(power) for power in powers])
    slope = np.power((-1j * hz / np.abs(hz).max())[None], order[:, None]) * np.array(pulse.amplitude)
    rotation = slope[:, :, None, None] * phasors(pulse, sample_time_s, 1)[None, :, None]
    return np.asarray((rotation.real * alive.real - rotation.imag * alive.imag).sum(axis=1))


def _correct_crossings(
    out: Floats, scene: Resting, index: tuple[Indices, Indices], pulse: Pulse, sample_time_s: Floats, budget: float
) -> None:
    """Add, at each sample that an end of a support crosses, what the motion lets in or out; in place.

    ``index`` (start, end): first sample from each scatterer's end on, at rest. Crossings that together add less than
    ``budget`` to one echo are left out.
    """
    largest_s = np.abs(scene.amplitude_s).max(axis=(0, 1))
    reach_s = largest_s @ np.abs(scene.shape)
    if not reach_s.any():
        return
    period_s = float(np.ptp(sample_time_s)) / max(1, len(sample_time_s) - 1)
    likely = 2 * len(reach_s) * (2 * float(reach_s.max()) / period_s + 1) if period_s > 0 else 2 * len(reach_s)
    for edge_s, first, sign in zip((pulse.start_s, pulse.end_s), index, (1.0, -1.0), strict=True):
        bound = np.abs(scene.weight) * _largest_near(pulse, edge_s, reach_s)
        matter = np.flatnonzero(bound > budget / likely)
        edge_time_s = scene.rest_s[matter] + edge_s
        low = np.searchsorted(sample_time_s, edge_time_s - reach_s[matter])
        high = np.searchsorted(sample_time_s, edge_time_s + reach_s[matter], side="right")
        count = high - low
        pair = np.repeat(np.arange(len(matter)), count)
        sample = np.repeat(low, count) + np.arange(len(pair)) - np.repeat(np.cumsum(count) - count, count)
        who = matter[pair]
        taylor = _taylor(pulse, edge_s, float(reach_s.max()), budget / likely, float(np.abs(scene.weight).max()))
        at_once = max(1, _VALUES_AT_ONCE // out.shape[1])
        for begin in range(0, len(who), at_once):
            some = slice(begin, begin + at_once)
            was_past = sample[some] >= first[who[some]]
            early_s = sample_time_s[sample[some]] - edge_time_s[pair[some]]
            _add_pairs(out, scene, who[some], sample[some], early_s, was_past, sign * taylor)


def _add_pairs(
    out: Floats, scene: Resting, who: Indices, sample: Indices, past_s: Floats, was_past: NDArray[np.bool_], taylor: Floats
) -> None:
    row = scene.row[who]
    x = past_s[:, None] - np.einsum("pkr,rp->pk", scene.amplitude_s[row], scene.shape[:, who])
    change = (x >= 0).astype(np.float64) - was_past[:, None]
    value = np.full_like(x, taylor[-1])
    for coefficient in taylor[-2::-1]:
        value *= x
        value += coefficient
    value *= change
    value *= scene.weight[who][:, None]
    place = row * out.shape[2] + sample
    order = np.argsort(place, kind="stable")
    place = place[order]
    run = np.flatnonzero(np.concatenate(([True], place[1:] != place[:-1])))
    out[place[run] // out.shape[2], :, place[run] % out.shape[2]] += np.add.reduceat(value[order], run, axis=0)


def _edge_derivatives(pulse: Pulse, edge_s: float, about_hz: float, orders: int) -> Complexes:
    """Return derivative over factorial of the exponentials at a support's end, (order,), turned back by ``about_hz``."""
    omega = 2 * np.pi * np.array(pulse.frequency_hz)
    parts = np.array(pulse.amplitude) * np.exp(1j * omega * edge_s)
    rate = 1j * (omega - 2 * np.pi * about_hz)
    out = np.empty(orders, dtype=np.complex128)
    for order in range(orders):
        out[order] = parts.sum()
        parts = parts * rate / (order + 1)
    # What cancels exactly on paper (the Hann pulse and its slope are 0 at its ends) must not count as a jump.
    unit = np.abs(pulse.amplitude).sum() * np.abs(rate).max() ** np.arange(orders)
    out[np.abs(out) * [math.factorial(order) for order in range(orders)] < 1e-12 * unit] = 0.0
    return out


def _largest_near(pulse: Pulse, edge_s: float, reach_s: Floats) -> Floats:
    """Return a bound on the pulse's exponentials within ``reach_s`` of an end of its support."""
    strongest = int(np.argmax(np.abs(pulse.amplitude)))
    jumps = np.abs(_edge_derivatives(pulse, edge_s, pulse.frequency_hz[strongest], 10))
    bound = np.full_like(reach_s, jumps[-1])
    for jump in jumps[-2::-1]:
        bound = bound * reach_s + jump
    return bound


def _taylor(pulse: Pulse, edge_s: float, reach_s: float, budget: float, weight: float) -> Floats:
    """Return Taylor coefficients of the exponentials about an end, good to ``budget`` over ``weight`` within reach."""
    angle = 2 * math.pi * max(abs(hz) for hz in pulse.frequency_hz) * reach_s
    strength, orders = weight * float(np.abs(pulse.amplitude).sum()), 1
    tail = strength * angle
    while tail > budget and orders < 40:
        orders += 1
        tail *= angle / orders
    return np.asarray(_edge_derivatives(pulse, edge_s, 0.0, orders).real)
