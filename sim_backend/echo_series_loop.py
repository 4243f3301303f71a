"""The loop that Numba compiles; imported by `echo_series_fast` alone, and only where Numba is installed."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@numba.njit(inline="always", cache=True)  # type: ignore[untyped-decorator]
def _place(time_s: Floats, edge_s: float, rate_hz: float) -> int:
    """Return the first sample at or after ``edge_s``; guessed as if evenly spaced, then exact."""
    guess = (edge_s - time_s[0]) * rate_hz
    place = 0 if guess < 0 else (len(time_s) if guess > len(time_s) else int(guess))
    while place > 0 and time_s[place - 1] >= edge_s:
        place -= 1
    while place < len(time_s) and time_s[place] < edge_s:
        place += 1
    return place


@numba.njit(nogil=True, cache=True)  # type: ignore[untyped-decorator]
def rows(
    first: NDArray[np.int64],
    rest_s: Floats,
    weight: Floats,
    shape: Floats,
    amplitude_s: Floats,
    time_s: Floats,
    ends_s: Floats,
    omega: float,
    step: float,
    scale: float,
    real: Floats,
    imag: Floats,
    jump_order: NDArray[np.int64],
    largest: Floats,
    taylor: Floats,
    orders: int,
    farthest_s: float,
    crossing: float,
    share: float,
    out: Floats,
) -> None:
    frequencies, powers, samples = real.shape
    row_count, echoes = amplitude_s.shape
    rate_hz = (samples - 1) / (time_s[-1] - time_s[0]) if samples > 1 else 0.0
    cells_real = np.empty((2 * samples, frequencies, powers))
    cells_imag = np.empty((2 * samples, frequencies, powers))
    sums = np.empty((powers, samples))
    line, moment = np.empty(samples), np.empty(powers)
    for row in range(row_count):
        cells_real[:] = 0.0
        cells_imag[:] = 0.0
        for n in range(first[row], first[row + 1]):
            if rest_s[n] + ends_s[0] > time_s[samples - 1] or rest_s[n] + ends_s[1] <= time_s[0]:
                continue
            enter = _place(time_s, rest_s[n] + ends_s[0], rate_hz)
            leave = _place(time_s, rest_s[n] + ends_s[1], rate_hz)
            if enter >= leave or enter >= samples or leave <= 0:
                continue
            cell = samples - leave if enter == 0 else samples + enter
            c, s = np.cos(omega * rest_s[n]), -np.sin(omega * rest_s[n])
            turn_c, turn_s = np.cos(step * rest_s[n]), -np.sin(step * rest_s[n])
            moment[0] = weight[n]
            for q in range(1, powers):
                moment[q] = moment[q - 1] * shape[n]
            for m in range(frequencies):
                for q in range(powers):
                    cells_real[cell, m, q] += moment[q] * c
                    cells_imag[cell, m, q] += moment[q] * s
                c, s = c * turn_c - s * turn_s, c * turn_s + s * turn_c
        for i in range(1, samples):
            cells_real[i] += cells_real[i - 1]
            cells_imag[i] += cells_imag[i - 1]
            cells_real[samples + i] += cells_real[samples + i - 1]
            cells_imag[samples + i] += cells_imag[samples + i - 1]
        power = 0.0
        for q in range(powers):
            for i in range(samples):
                value = 0.0
                for m in range(frequencies):
                    a = cells_real[samples - 1 - i, m, q] + cells_real[samples + i, m, q]
                    b = cells_imag[samples - 1 - i, m, q] + cells_imag[samples + i, m, q]
                    value += real[m, q, i] * a - imag[m, q, i] * b
                sums[q, i] = value
                if q == 0:
                    power += value * value
        for k in range(echoes):
            coefficient = 1.0
            line[:] = sums[0]
            for q in range(1, powers):
                coefficient *= amplitude_s[row, k] * scale / q
                for i in range(samples):
                    line[i] += coefficient * sums[q, i]
            for i in range(samples):
                out[row, k, i] = line[i]
        if farthest_s == 0.0:
            continue
        # rms * sqrt(samples) = sqrt(power), shared among the crossings that may happen.
        each = share * np.sqrt(power) / (2 * max(1, first[row + 1] - first[row]) * crossing)
        spread_s = np.abs(amplitude_s[row]).max()
        for n in range(first[row], first[row + 1]):
            reach_s = spread_s * abs(shape[n])
            for end in range(2):
                edge_s = rest_s[n] + ends_s[end]
                if edge_s + reach_s < time_s[0] or edge_s - reach_s > time_s[samples - 1]:
                    continue
                bound = abs(weight[n]) * largest[end]
                for _ in range(jump_order[end]):
                    bound *= reach_s / farthest_s
                if bound <= each:
                    continue
                low = _place(time_s, edge_s - reach_s, rate_hz)
                if low == samples or time_s[low] > edge_s + reach_s:
                    continue
                rest_place = _place(time_s, edge_s, rate_hz)
                i = low
                while i < samples and time_s[i] <= edge_s + reach_s:
                    past_s = time_s[i] - edge_s
                    was = 1.0 if i >= rest_place else 0.0
                    signed = weight[n] if end == 0 else -weight[n]
                    for k in range(echoes):
                        x = past_s - amplitude_s[row, k] * shape[n]
                        change = (1.0 if x >= 0 else 0.0) - was
                        if change != 0.0:
                            value = taylor[end, orders - 1]
                            for q in range(orders - 2, -1, -1):
                                value = value * x + taylor[end, q]
                            out[row, k, i] += signed * change * value
                    i += 1
