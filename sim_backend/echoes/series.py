"""Series in the motion's amplitudes over sums of resting scatterers: nearly free in the number of echoes.

With delays tau_n + sum_r b_kr g_rn (b the motion as a delay, g its shapes), an exponential of the pulse turns by

    exp(-j w sum_r b_kr g_rn) = sum_a  (-j w)^|a|  b_k^a / a!  g_n^a          (a: one exponent a shape)

so every echo is a short combination, with coefficients b_k^a / a!, of the sums ``U_a(t) = sum_n I_n g_n^a p^(|a|)(t -
tau_n)`` (sign aside) over scatterers at rest. That moves the exponentials but not the ends of the support; the few
samples that an end crosses while its scatterer moves are corrected one by one with the pulse's Taylor series there.
Both parts converge geometrically, whatever the pulse: no derivative has to be continuous at the ends.
docs/theory/echoes.md, section 5.
"""

from __future__ import annotations

import functools
import itertools
import math
from dataclasses import dataclass

import numpy as np

from sim_backend.arrays import BoolArray, ComplexArray, FloatArray, Int64Array
from sim_backend.echoes.pulse import Pulse, phasors

MOST_ANGLE_RAD = 3.0
"""Largest turn of the highest frequency: beyond, the series' terms grow and take digits with them."""

_VALUES_AT_ONCE = 1 << 18
# Orders of the jumps that are counted for coloured echoes.
_JUMPS = 4
# Share of the tolerance for crossings left out or cut short.
CROSSING_SHARE = 0.1
# Share of the tolerance for the tail of the series.
_TAIL_SHARE = 0.25


@dataclass(frozen=True, slots=True)
class ScattererRows:
    """Scatterers of one or more scenes (rows) and their motion, in ascending row and, within one, delay."""

    row: Int64Array
    """(scatterer,), the scene each belongs to."""
    rest_s: FloatArray
    """(scatterer,), echo delay about which it moves."""
    weight: FloatArray
    """(scatterer,)."""
    shape: FloatArray
    """(shape, scatterer), g."""
    amplitude_s: FloatArray
    """(row, echo, shape), b: the delay that a shape of 1 adds."""
    colour: ComplexArray | None = None
    """(frequency, scatterer), what its echo has of every frequency of the pulse; None: all alike."""


def largest_angle(pulse: Pulse, shape: FloatArray, amplitude_s: FloatArray) -> float:
    """Return a bound on the turn of the pulse's highest frequency, rad."""
    if shape.size == 0 or amplitude_s.size == 0:
        return 0.0
    reach_s = sum(largest_size(amplitude_s[..., axis]) * largest_size(shape[axis]) for axis in range(len(shape)))
    return 2 * math.pi * max(abs(hz) for hz in pulse.frequency_hz) * reach_s


def series(
    scene: ScattererRows, pulse: Pulse, sample_time_s: FloatArray, tolerance: float, made: FloatArray | None = None
) -> FloatArray:
    """Return the echoes, float64 (row, echo, sample), to ``tolerance`` of their rms; samples within one pulse length.

    Written to ``made`` where there is one, of the same shape.
    Raises ValueError where the motion turns the pulse by more than `MOST_ANGLE_RAD`.
    """
    tables = series_tables(scene, pulse, sample_time_s, tolerance)
    enter = sample_time_s.searchsorted(scene.rest_s + pulse.start_s)
    leave = sample_time_s.searchsorted(scene.rest_s + pulse.end_s)
    # U_a(t), then every echo as a short combination of them, then the samples that a support's end crosses.
    sums = _rest_sums(scene, enter, leave, tables, pulse, len(sample_time_s))
    rms = math.sqrt(float(np.vdot(sums[:, 0], sums[:, 0])) / sums[:, 0].size)
    coefficients = _coefficients(scene.amplitude_s * tables.scale, tables.recurrence)
    out: FloatArray = np.matmul(coefficients, sums, out=made)
    budget = CROSSING_SHARE * tolerance * rms * math.sqrt(len(sample_time_s))
    _correct_crossings(out, scene, (enter, leave), tables, pulse, sample_time_s, budget)
    return out


def series_tables(scene: ScattererRows, pulse: Pulse, sample_time_s: FloatArray, tolerance: float) -> Tables:
    """Return what pulse, gate and number of orders fix; raises ValueError where the motion is too large."""
    angle = largest_angle(pulse, scene.shape, scene.amplitude_s)
    if angle > MOST_ANGLE_RAD:
        raise ValueError(
            f"the motion turns the pulse by {angle:.3g} rad, the series holds up to {MOST_ANGLE_RAD} rad: "
            "take the running sum"
        )
    orders = terms_needed(angle, tolerance)
    return tables_of(pulse, sample_time_s.tobytes(), len(scene.shape), orders)


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


def recurrence(powers: list[tuple[int, ...]]) -> list[tuple[int, int, int]]:
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

    recurrence: list[tuple[int, int, int]]
    """How each monomial of the shapes but the first follows from an earlier one (`recurrence`)."""
    scale: float
    """Highest angular frequency of the pulse, rad/s, to which moments and coefficients are referred."""
    turn: ComplexArray
    """c_m (-j w_m / scale)^|a| exp(j w_m t), (frequency, exponent, sample)."""
    jumps: tuple[list[float], list[float]]
    """Start and end: sizes of the jumping derivatives over their factorials, referred to the carrier, (order,)."""
    taylor: FloatArray
    """Taylor coefficients of the exponentials about start and end, (end, order)."""
    lines: tuple[ComplexArray, ComplexArray]
    """What each frequency adds to the jumps, (end, frequency, order), and to the Taylor coefficients."""


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
        recurrence(powers),
        float(2 * math.pi * np.abs(hz).max()),
        rotation,
        (jumps[0], jumps[1]),
        taylor,
        (
            np.stack([_line_derivatives(pulse, edge_s, carrier_hz, _JUMPS) for edge_s in ends]),
            np.stack([_line_derivatives(pulse, edge_s, 0.0, 40) for edge_s in ends]),
        ),
    )


def _line_derivatives(pulse: Pulse, edge_s: float, about_hz: float, orders: int) -> ComplexArray:
    """Return each exponential's derivative over factorial at an end, (frequency, order), turned by ``about_hz``."""
    omega = 2 * np.pi * np.array(pulse.frequency_hz)
    rate = 1j * (omega - 2 * np.pi * about_hz)
    out = np.empty((len(omega), orders), dtype=np.complex128)
    out[:, 0] = np.array(pulse.amplitude) * np.exp(1j * omega * edge_s)
    for order in range(1, orders):
        out[:, order] = out[:, order - 1] * rate / order
    return out


def _edge_derivatives(pulse: Pulse, edge_s: float, about_hz: float, orders: int) -> ComplexArray:
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


def _coefficients(amplitude_rad: FloatArray, recurrence: list[tuple[int, int, int]]) -> FloatArray:
    """Return b^a / a!, (row, echo, exponent)."""
    out = np.empty((len(recurrence) + 1, *amplitude_rad.shape[:2]))
    out[0] = 1.0
    for index, (lower, shape, power) in enumerate(recurrence, 1):
        np.multiply(out[lower], amplitude_rad[..., shape] / power, out=out[index])
    return np.ascontiguousarray(np.moveaxis(out, 0, -1))


def _rest_sums(
    scene: ScattererRows, enter: Int64Array, leave: Int64Array, tables: Tables, pulse: Pulse, samples: int
) -> FloatArray:
    """Return U_a, real (row, exponent, sample), of the scatterers whose support at rest holds a sample.

    In ascending delay those that entered since the first sample follow one another, and so do those that were there
    and have yet to leave: one running sum over each, read at every sample.
    """
    begin = scene.row.searchsorted(np.arange(len(scene.amplitude_s) + 1)).tolist()
    every = np.arange(samples)
    at_once = max(64, _VALUES_AT_ONCE // (tables.turn.shape[0] * tables.turn.shape[1]))
    out = np.zeros((len(scene.amplitude_s), tables.turn.shape[1], samples))
    for row, (first, last) in enumerate(itertools.pairwise(begin)):
        own_enter, own_leave = enter[first:last], leave[first:last]
        # Scatterers before ``middle`` are there from the first sample on. At sample i those from gone[i] to middle are
        # still there, and those from middle to come[i] have come.
        middle = int(own_enter.searchsorted(1))
        gone = own_leave.searchsorted(every, side="right")
        come = np.maximum(own_enter.searchsorted(every, side="right"), middle)
        low, high = int(gone[0]), int(come[-1])
        alive = np.zeros(tables.turn.shape, dtype=np.complex128)
        for cut in range(low, high, at_once):
            length = min(at_once, high - cut)
            part = slice(first + cut, first + cut + length)
            turned, moments = phasors(pulse, scene.rest_s[part], -1)[:, None], _moments(scene, part, tables.recurrence)
            if scene.colour is not None:
                turned *= scene.colour[:, None, part]
            here = min(max(middle - cut, 0), length)
            # Those there already, an empty place, those to come: the sums begin at the empty place and go either way.
            sums = np.zeros((*tables.turn.shape[:2], length + 1), dtype=np.complex128)
            np.multiply(turned[..., :here], moments[:, :here], out=sums[..., :here])
            np.multiply(turned[..., here:], moments[:, here:], out=sums[..., here + 1 :])
            np.cumsum(sums[..., here:], axis=-1, out=sums[..., here:])
            np.cumsum(sums[..., here::-1], axis=-1, out=sums[..., here::-1])
            alive += sums.take(np.minimum(np.maximum(come - cut, here), length), axis=-1)
            alive += sums.take(np.minimum(np.maximum(gone - cut, 0), here), axis=-1)
        out[row] = np.einsum("fqi,fqi->qi", tables.turn, alive).real
    return out


def _runs(key: Int64Array) -> Int64Array:
    """Return where a new value begins."""
    new = np.empty(len(key), dtype=np.bool_)
    new[:1] = True
    np.not_equal(key[1:], key[:-1], out=new[1:])
    return np.flatnonzero(new)


def _moments(scene: ScattererRows, part: slice, recurrence: list[tuple[int, int, int]]) -> FloatArray:
    """Return I_n g_n^a, (exponent, scatterer)."""
    shape, weight = scene.shape[:, part], scene.weight[part]
    out = np.empty((len(recurrence) + 1, len(weight)))
    out[0] = weight
    for index, (lower, axis, _) in enumerate(recurrence, 1):
        np.multiply(out[lower], shape[axis], out=out[index])
    return out


def _correct_crossings(
    out: FloatArray,
    scene: ScattererRows,
    index: tuple[Int64Array, Int64Array],
    tables: Tables,
    pulse: Pulse,
    sample_time_s: FloatArray,
    budget: float,
) -> None:
    """Add, at each sample that an end of a support crosses, what the motion lets in or out; in place.

    ``index`` (start, end): first sample from each scatterer's end on, at rest. Crossings that together add less than
    ``budget`` to one echo are left out.
    """
    reach_s = np.abs(scene.amplitude_s).max(axis=(0, 1)) @ np.abs(scene.shape)
    farthest_s, heaviest = float(reach_s.max(initial=0.0)), float(np.abs(scene.weight).max(initial=0.0))
    if farthest_s == 0 or heaviest == 0:
        return
    duration_s = float(sample_time_s[-1] - sample_time_s[0])
    # How many samples one end can cross at most; an equal share of the budget for each.
    crossing = 1 + (2 * farthest_s * (len(sample_time_s) - 1) / duration_s if duration_s > 0 else 0)
    each = budget / (2 * len(reach_s) * crossing)
    size, share = np.abs(scene.weight), reach_s / farthest_s
    # Ends whose jump could exceed that share, at the start and at the end of the support, and the samples near them.
    bounds = [largest_near(jumps, farthest_s) for jumps in tables.jumps]
    if scene.colour is None:
        matter = [np.flatnonzero(size * (share**order * largest) > each) for order, largest in bounds]
    else:
        matter = [
            np.flatnonzero(size * _coloured_jump(scene.colour, lines, reach_s) > each) for lines in tables.lines[0]
        ]
    who = np.concatenate(matter)
    end = np.repeat([0, 1], [len(part) for part in matter])
    edge_time_s = scene.rest_s[who] + np.array([pulse.start_s, pulse.end_s])[end]
    low = sample_time_s.searchsorted(edge_time_s - reach_s[who])
    count = sample_time_s.searchsorted(edge_time_s + reach_s[who], side="right") - low
    meets = np.flatnonzero(count)
    who, end, edge_time_s, low, count = (part[meets] for part in (who, end, edge_time_s, low, count))
    cut = each / heaviest / max(1.0, float(np.abs(pulse.amplitude).sum()))
    taylor = enough_taylor(tables.taylor, tables.scale * farthest_s, cut) * [[1.0], [-1.0]]
    lines = tables.lines[1][:, :, : taylor.shape[1]] * np.array([1.0, -1.0])[:, None, None]
    at_once = max(1, _VALUES_AT_ONCE // (out.shape[1] * int(count.max(initial=1))))
    for begin in range(0, len(who), at_once):
        some = slice(begin, begin + at_once)
        # (pair,): every such end with every sample within its reach.
        pair = np.repeat(np.arange(len(who[some])), count[some])
        sample = np.arange(len(pair)) + np.repeat(low[some] - np.cumsum(count[some]) + count[some], count[some])
        past_s = sample_time_s[sample] - edge_time_s[some][pair]
        own, own_end = who[some][pair], end[some][pair]
        was_past = sample >= np.where(own_end == 0, index[0][own], index[1][own])
        if scene.colour is None:
            expansion = taylor[own_end]
        else:
            # Each scatterer's own pulse: one expansion for all the samples that its end crosses.
            ends = np.einsum("fs,sfq->sq", scene.colour[:, who[some]], lines[end[some]], optimize=True)
            expansion = ends.real[pair]
        _add_pairs(out, scene, own, sample, past_s, was_past, expansion)


def _coloured_jump(colour: ComplexArray, lines: ComplexArray, reach_s: FloatArray) -> FloatArray:
    """Return a bound on each scatterer's pulse within its reach of an end that jumps, (scatterer,)."""
    jump = np.abs(np.einsum("fs,fq->qs", colour, lines))
    # What cancels on paper is no jump.
    unit = np.abs(lines).sum(axis=0)[:, None]
    bound = np.zeros(len(reach_s))
    for order in range(len(jump) - 1, -1, -1):
        bound = bound * reach_s + np.where(jump[order] < 1e-12 * unit[order], 0.0, jump[order])
    return bound


def _add_pairs(
    out: FloatArray,
    scene: ScattererRows,
    who: Int64Array,
    sample: Int64Array,
    past_s: FloatArray,
    was_past: BoolArray,
    taylor: FloatArray,
) -> None:
    """Add to ``out``, at ``sample`` (pair,), the part of the scatterers ``who`` whose end has moved over it."""
    row = scene.row[who]
    if len(scene.amplitude_s) == 1:
        moved_s = scene.shape[:, who].T @ scene.amplitude_s[0].T
    else:
        moved_s = np.matmul(scene.amplitude_s[row], scene.shape[:, who].T[:, :, None])[:, :, 0]
    # (pair, echo): time since the end passed the sample; the Taylor series there by Horner's rule.
    x = np.subtract(past_s[:, None], moved_s, out=moved_s)
    value = np.zeros_like(x)
    for coefficient in taylor.T[:0:-1]:
        value += coefficient[:, None]
        value *= x
    value += taylor[:, :1]
    # +1 where the motion lets the scatterer in, -1 where it takes it out, 0 where nothing changes.
    weight = scene.weight[who]
    value *= np.where(x >= 0, np.where(was_past, 0.0, weight)[:, None], np.where(was_past, -weight, 0.0)[:, None])
    # Pairs of one row and sample are summed before they are added: fancy indexing adds each place only once.
    place = row * out.shape[2] + sample
    order = np.argsort(place, kind="stable")
    run = _runs(place[order])
    first = order[run]
    out[row[first], :, sample[first]] += np.add.reduceat(value[order], run, axis=0)


def largest_near(jumps: list[float], reach_s: float) -> tuple[int, float]:
    """Return the lowest order that jumps, and a bound on the exponentials within ``reach_s`` of the support's end."""
    bound = 0.0
    for jump in reversed(jumps):
        bound = bound * reach_s + jump
    return next((order for order, jump in enumerate(jumps) if jump > 0), 0), bound


def largest_size(value: FloatArray) -> float:
    """Return the largest magnitude, 0 of nothing."""
    return max(abs(float(value.max())), abs(float(value.min()))) if value.size else 0.0


def enough_taylor(taylor: FloatArray, angle: float, tolerance: float) -> FloatArray:
    """Return as many Taylor coefficients (end, order) as keep the rest below ``tolerance``, ``angle`` from the end."""
    tail, orders = angle, 1
    while tail > tolerance and orders < taylor.shape[1]:
        orders += 1
        tail *= angle / orders
    return taylor[:, :orders]
