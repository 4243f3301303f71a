"""Series of `sim_backend.echoes.series` as loops that Numba compiles, for studies; without Numba the NumPy form serves.

The same sums, cut at the same tolerance, of one shape and evenly spaced frequencies. Imported only where a batch asks
for it: importing Numba takes longer than most scenes. Written out element by element and in pieces, each compiled for
one kind of arguments: array expressions, inlining by hand and further layouts cost seconds of compilation each, and no
run time is saved. docs/theory/echoes.md, section 5.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import numba
import numpy as np

from sim_backend.arrays import ComplexArray, FloatArray, Int64Array
from sim_backend.echoes.pulse import Pulse, angular_rates
from sim_backend.echoes.series import (
    CROSSING_SHARE,
    ScattererRows,
    enough_taylor,
    largest_near,
    largest_size,
    series_tables,
)

Loop = TypeVar("Loop", bound=Callable[..., object])

_compiled: Callable[[Loop], Loop] = numba.njit(nogil=True, cache=True, error_model="numpy")


def compiled_series(
    scene: ScattererRows, pulse: Pulse, sample_time_s: FloatArray, tolerance: float, out: FloatArray
) -> None:
    """Write the same as `sim_backend.echoes.series.series` to ``out`` (row, echo, sample)."""
    tables = series_tables(scene, pulse, sample_time_s, tolerance)
    shape, amplitude_s = scene.shape[0], scene.amplitude_s[:, :, 0]
    farthest_s = largest_size(amplitude_s) * largest_size(shape)
    duration_s = float(sample_time_s[-1] - sample_time_s[0])
    crossing = 1 + (2 * farthest_s * (len(sample_time_s) - 1) / duration_s if duration_s > 0 else 0.0)
    bounds = [largest_near(jumps, farthest_s) for jumps in tables.jumps]
    omega, step = angular_rates(pulse)
    # The loop is compiled for this one kind of array.
    made = out if out.flags.c_contiguous else np.empty(out.shape)
    parts = (scene.rest_s, scene.weight, shape, amplitude_s, sample_time_s)
    rest_s, weight, shape, amplitude_s, time_s = (np.ascontiguousarray(part, dtype=np.float64) for part in parts)
    echoes_of_rows(
        scene.row.searchsorted(np.arange(len(amplitude_s) + 1)),
        rest_s,
        weight,
        shape,
        amplitude_s,
        time_s,
        np.array([pulse.start_s, pulse.end_s]),
        omega[0],
        step or 0.0,
        tables.scale,
        tables.turn,
        np.array([order for order, _ in bounds]),
        np.array([largest for _, largest in bounds]),
        tables.taylor,
        enough_taylor(tables.taylor, tables.scale * farthest_s, 1e-3 * tolerance).shape[1],
        farthest_s,
        crossing,
        CROSSING_SHARE * tolerance,
        made,
    )
    if made is not out:
        out[:] = made


@_compiled
def _place(time_s: FloatArray, edge_s: float, rate_hz: float) -> int:
    """Return the first sample at or after ``edge_s``; guessed as if evenly spaced, then exact."""
    guess = (edge_s - time_s[0]) * rate_hz
    place = 0 if guess < 0 else (len(time_s) if guess > len(time_s) else int(guess))
    while place > 0 and time_s[place - 1] >= edge_s:
        place -= 1
    while place < len(time_s) and time_s[place] < edge_s:
        place += 1
    return place


@_compiled
def _add_scatterers(
    cells: FloatArray,
    first: int,
    last: int,
    rest_s: FloatArray,
    weight: FloatArray,
    shape: FloatArray,
    time_s: FloatArray,
    ends_s: FloatArray,
    omega: float,
    step: float,
    rate_hz: float,
) -> None:
    """Add to ``cells`` (2 samples, frequency, power, 2) the turned moments where supports begin or end."""
    frequencies, powers, samples = cells.shape[1], cells.shape[2], len(time_s)
    for n in range(first, last):
        if rest_s[n] + ends_s[0] > time_s[samples - 1] or rest_s[n] + ends_s[1] <= time_s[0]:
            continue
        # First samples at or after both ends of its support at rest.
        enter = _place(time_s, rest_s[n] + ends_s[0], rate_hz)
        leave = _place(time_s, rest_s[n] + ends_s[1], rate_hz)
        if enter >= leave or enter >= samples or leave <= 0:
            continue
        # Those there from the first sample on fill the lower half of the cells, by the sample they leave at; those to
        # come the upper half, by the sample they enter at. Sums over either half then never subtract (`_sum_up`).
        cell = samples - leave if enter == 0 else samples + enter
        # Phasor exp(-j w_m tau), frequency by frequency: the step between them is the same.
        c, s = np.cos(omega * rest_s[n]), -np.sin(omega * rest_s[n])
        turn_c, turn_s = np.cos(step * rest_s[n]), -np.sin(step * rest_s[n])
        for m in range(frequencies):
            moment = weight[n]
            for q in range(powers):
                cells[cell, m, q, 0] += moment * c
                cells[cell, m, q, 1] += moment * s
                moment *= shape[n]
            c, s = c * turn_c - s * turn_s, c * turn_s + s * turn_c


@_compiled
def _sum_up(cells: FloatArray, turn: ComplexArray, sums: FloatArray) -> float:
    """Sum ``cells`` from either end, turn them into ``sums`` (power, sample); return the power of the first."""
    frequencies, powers, samples = turn.shape
    flat = cells.reshape(2, samples, frequencies * powers * 2)
    # Running sums over both halves: after them a cell holds everything that is alive at its sample.
    for half in range(2):
        for i in range(1, samples):
            for q in range(flat.shape[2]):
                flat[half, i, q] += flat[half, i - 1, q]
    power = 0.0
    for q in range(powers):
        for i in range(samples):
            value = 0.0
            for m in range(frequencies):
                a = cells[samples - 1 - i, m, q, 0] + cells[samples + i, m, q, 0]
                b = cells[samples - 1 - i, m, q, 1] + cells[samples + i, m, q, 1]
                value += turn[m, q, i].real * a - turn[m, q, i].imag * b
            sums[q, i] = value
            if q == 0:
                power += value * value
    return power


@_compiled
def _combine(sums: FloatArray, scaled: FloatArray, echoes: FloatArray) -> None:
    """Write the series ``sum_q scaled^q / q! sums[q]`` to ``echoes`` (echo, sample)."""
    powers, samples = sums.shape
    for k in range(len(echoes)):
        coefficient = 1.0
        for i in range(samples):
            echoes[k, i] = sums[0, i]
        for q in range(1, powers):
            coefficient *= scaled[k] / q
            for i in range(samples):
                echoes[k, i] += coefficient * sums[q, i]


@_compiled
def _correct(
    echoes: FloatArray,
    strength: float,
    past_s: float,
    shape: float,
    amplitude_s: FloatArray,
    sample: int,
    was: float,
    taylor: FloatArray,
    orders: int,
) -> None:
    """Add to one sample of each echo what the motion of one support end lets in or out."""
    for k in range(len(amplitude_s)):
        x = past_s - amplitude_s[k] * shape
        change = (1.0 if x >= 0 else 0.0) - was
        if change != 0.0:
            value = taylor[orders - 1]
            for q in range(orders - 2, -1, -1):
                value = value * x + taylor[q]
            echoes[k, sample] += strength * change * value


@_compiled
def echoes_of_rows(
    first: Int64Array,
    rest_s: FloatArray,
    weight: FloatArray,
    shape: FloatArray,
    amplitude_s: FloatArray,
    time_s: FloatArray,
    ends_s: FloatArray,
    omega: float,
    step: float,
    scale: float,
    turn: ComplexArray,
    jump_order: Int64Array,
    largest: FloatArray,
    taylor: FloatArray,
    orders: int,
    farthest_s: float,
    crossing: float,
    share: float,
    out: FloatArray,
) -> None:
    """Write the echoes of every row to ``out`` (row, echo, sample); the arguments are those of `compiled_series`."""
    frequencies, powers, samples = turn.shape
    rate_hz = (samples - 1) / (time_s[-1] - time_s[0]) if samples > 1 else 0.0
    sums = np.empty((powers, samples))
    for row in range(len(amplitude_s)):
        begin, end = first[row], first[row + 1]
        cells = np.zeros((2 * samples, frequencies, powers, 2))
        _add_scatterers(cells, begin, end, rest_s, weight, shape, time_s, ends_s, omega, step, rate_hz)
        power = _sum_up(cells, turn, sums)
        _combine(sums, amplitude_s[row] * scale, out[row])
        if farthest_s == 0.0:
            continue
        # What is left: samples that an end of a moving support crosses, scatterer by scatterer, end by end.
        # rms * sqrt(samples) = sqrt(power), shared among the crossings that may happen.
        each = share * np.sqrt(power) / (2 * max(1, end - begin) * crossing)
        spread_s = 0.0
        for k in range(amplitude_s.shape[1]):
            spread_s = max(spread_s, abs(amplitude_s[row, k]))
        for n in range(begin, end):
            reach_s = spread_s * abs(shape[n])
            for edge in range(2):
                edge_s = rest_s[n] + ends_s[edge]
                if edge_s + reach_s < time_s[0] or edge_s - reach_s > time_s[samples - 1]:
                    continue
                # The most this end can add: its jump of the lowest order, as small as its reach makes it.
                bound = abs(weight[n]) * largest[edge]
                for _ in range(jump_order[edge]):
                    bound *= reach_s / farthest_s
                if bound <= each:
                    continue
                i = _place(time_s, edge_s - reach_s, rate_hz)
                if i == samples or time_s[i] > edge_s + reach_s:
                    continue
                rest_place = _place(time_s, edge_s, rate_hz)
                strength = weight[n] if edge == 0 else -weight[n]
                while i < samples and time_s[i] <= edge_s + reach_s:
                    was, past_s = 1.0 if i >= rest_place else 0.0, time_s[i] - edge_s
                    _correct(out[row], strength, past_s, shape[n], amplitude_s[row], i, was, taylor[edge], orders)
                    i += 1
