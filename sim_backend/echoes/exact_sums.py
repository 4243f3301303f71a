"""Exact echoes: the double sum of eq. (10) as written, and the same in O(scatterers + samples) by running sums.

    Re sum_m c_m exp(j w_m t) * [sum over the scatterers in whose support t lies of I_n exp(-j w_m tau_n)]

A scatterer joins the inner sum where its support begins and leaves it where it ends. Nothing is ever subtracted, which
would cost digits: the gate is cut into blocks no longer than the pulse, in which a scatterer that enters does not
leave, so the inner sum is one running sum of those that entered since the block began, and one backwards of those that
were there and have yet to leave. docs/theory/echoes.md, section 2.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sim_backend.arrays import ComplexArray, FloatArray
from sim_backend.echoes.pulse import Pulse, extended, phasors

# Echo-scatterer pairs handled at once: 2 MB a complex array, inside the caches that matter.
_PAIRS_AT_ONCE = 1 << 17


def direct_sum(delay_s: FloatArray, weight: FloatArray, pulse: Pulse, sample_time_s: FloatArray) -> FloatArray:
    """Return the sum over scatterers of weighted, delayed pulses, float64 (echo, sample), eq. (10).

    ``delay_s`` (echo, scatterer), ``weight`` (scatterer,), ``sample_time_s`` (sample,).
    """
    echoes_out = np.empty((len(delay_s), len(sample_time_s)))
    for echo, tau in zip(echoes_out, delay_s, strict=True):
        # The support is compared as every evaluation does, so that an edge on a sample falls on the same side.
        inside = (sample_time_s[:, None] >= tau + pulse.start_s) & (sample_time_s[:, None] < tau + pulse.end_s)
        echo[:] = np.where(inside, extended(pulse, sample_time_s[:, None] - tau), 0.0) @ weight
    return echoes_out


def running_sum(
    delay_s: FloatArray, weight: FloatArray, pulse: Pulse, sample_time_s: FloatArray, colour: ComplexArray | None = None
) -> FloatArray:
    """Return the same as `direct_sum`, exact to rounding; shapes as there, ``sample_time_s`` ascending.

    ``colour`` (frequency, scatterer) is what a scatterer's echo has of every frequency of the pulse.
    """
    out = np.zeros((len(delay_s), len(sample_time_s)))
    stretches = blocks(sample_time_s, pulse)
    if min(delay_s.shape) == 0:
        return out
    # In ascending delay those that can reach a block of samples lie next to each other.
    early_s, late_s = delay_s.min(axis=0), delay_s.max(axis=0)
    if len(stretches) > 1 and (early_s[1:] < early_s[:-1]).any():
        order = np.argsort(early_s, kind="stable")
        delay_s, weight, early_s, late_s = delay_s[:, order], weight[order], early_s[order], late_s[order]
        colour = None if colour is None else colour[:, order]
    spread_s = float((late_s - early_s).max())
    for block in stretches:
        # (frequency, sample), c_m exp(j w_m t): what turns the sums over scatterers into an echo.
        origin_s = local_origin_s(sample_time_s[block], pulse)
        time_s = sample_time_s[block] - origin_s
        rotation = phasors(pulse, time_s, 1) * np.array(pulse.amplitude)[:, None]
        near = slice(0, len(weight))
        if len(stretches) > 1:
            first_s, last_s = float(sample_time_s[block][0]), float(sample_time_s[block][-1])
            begin, end = early_s.searchsorted([first_s - pulse.end_s - spread_s, last_s - pulse.start_s])
            # One beyond on each side: the sums above are rounded.
            near = slice(max(0, int(begin) - 1), int(end) + 1)
        own_s, own_weight = delay_s[:, near], weight[near]
        own_colour = None if colour is None else colour[:, near]
        echoes_at_once = max(1, _PAIRS_AT_ONCE // max(1, len(own_weight)))
        for first in range(0, len(own_s), echoes_at_once):
            some = slice(first, first + echoes_at_once)
            for cut in range(0, len(own_weight), _PAIRS_AT_ONCE):
                part = slice(cut, cut + _PAIRS_AT_ONCE)
                part_colour = None if own_colour is None else own_colour[:, part]
                tau = own_s[some, part] - origin_s
                out[some, block] += _block(tau, own_weight[part], pulse, time_s, rotation, part_colour)
    return out


def blocks(sample_time_s: FloatArray, pulse: Pulse) -> list[slice]:
    """Return slices of the samples, none of which lasts longer than the pulse."""
    found, begin = [], 0
    while begin < len(sample_time_s):
        end = int(np.searchsorted(sample_time_s, sample_time_s[begin] + (pulse.end_s - pulse.start_s), side="left"))
        found.append(slice(begin, max(end, begin + 1)))
        begin = max(end, begin + 1)
    return found


def local_origin_s(time_s: FloatArray, pulse: Pulse) -> float:
    """Return what to count a block's times from: 0 near it, else its middle, or phases of far times lose digits."""
    middle_s = float(time_s[len(time_s) // 2])
    return middle_s if abs(middle_s) > pulse.end_s - pulse.start_s else 0.0


def _block(
    tau: FloatArray,
    weight: FloatArray,
    pulse: Pulse,
    sample_time_s: FloatArray,
    rotation: ComplexArray,
    colour: ComplexArray | None = None,
) -> FloatArray:
    """Return the echoes of one block, (echo, sample); ``tau`` (echo, scatterer), ``rotation`` (frequency, sample)."""
    echoes_in_block, samples = len(tau), len(sample_time_s)
    row = np.arange(echoes_in_block)[:, None]
    enter = np.searchsorted(sample_time_s, tau + pulse.start_s)
    leave = np.searchsorted(sample_time_s, tau + pulse.end_s)
    # (echo, scatterer): whether its support holds a sample of this block.
    seen = (enter < leave) & (enter < samples) & (leave > 0)
    # Two rows an echo: those there from the first sample on, by the sample they leave at, backwards; those to come.
    cell = np.where(enter == 0, 2 * row * samples + samples - leave, (2 * row + 1) * samples + enter)[seen]
    weight_seen, tau_seen = np.broadcast_to(weight, tau.shape)[seen], tau[seen]
    total = np.zeros((echoes_in_block, samples))
    # Frequency by frequency: phasors of the scatterers into their cells, running sums over the cells, turned by t.
    turns = phasors(pulse, tau_seen, -1)
    if colour is not None:
        turns *= np.broadcast_to(colour[:, None], (len(colour), *tau.shape))[:, seen]
    for turn, factor in zip(turns, rotation, strict=True):
        real, imag = (
            _alive(np.bincount(cell, weights=weight_seen * part, minlength=2 * echoes_in_block * samples), samples)
            for part in (turn.real, turn.imag)
        )
        total += real * factor.real - imag * factor.imag
    return total


def _alive(cells: NDArray[np.floating | np.integer], samples: int) -> FloatArray:
    """Return at every sample the sum over the scatterers alive there, (echo, sample), from both rows of cells."""
    summed = np.cumsum(cells.reshape(-1, 2, samples), axis=2)
    return np.asarray(summed[:, 0, ::-1] + summed[:, 1])
