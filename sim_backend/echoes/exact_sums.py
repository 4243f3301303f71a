"""Exact echoes: the double sum of eq. (10) of the paper, directly and in O(scatterers + samples) by running sums.

    r_k(t) = sum_n I_n p(t - tau_kn)
           = Re sum_m c_m exp(j w_m t) S_km(t),    S_km(t) = sum_(n alive at t) I_n exp(-j w_m tau_kn)

    k, n, m       echo, scatterer, exponential of the pulse
    I_n, tau_kn   weight; delay, s
    c_m, w_m      amplitude and angular frequency of an exponential, 1 and rad/s
    alive         t lies in the support of the delayed pulse, [tau_kn + start, tau_kn + end)

S changes only where a support begins or ends. Nothing is ever subtracted, since that would cost digits. The gate is cut
into blocks no longer than the pulse; in a block no scatterer both enters and leaves. S is one running sum forwards over
the scatterers that enter, and one backwards over those that leave. See docs/explanation/echoes.md, section 2.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim_backend.arrays import BoolArray, ComplexArray, FloatArray, Int64Array
from sim_backend.echoes.pulse import Pulse, extended, phasors

# Pairs of echo and scatterer in one array: 2 MB of complex values, which fits the cache.
_PAIRS_PER_CHUNK = 1 << 17


def direct_sum(delay_s: FloatArray, weight: FloatArray, pulse: Pulse, sample_time_s: FloatArray) -> FloatArray:
    """Return the sum over scatterers of weighted, delayed pulses, float64 (echo, sample), eq. (10) of the paper.

    ``delay_s`` (echo, scatterer), ``weight`` (scatterer,), ``sample_time_s`` (sample,).
    """
    echoes = np.empty((len(delay_s), len(sample_time_s)))
    for echo, tau in zip(echoes, delay_s, strict=True):
        # Compare as in all evaluations, so that an end on a sample falls on the same side.
        alive = (sample_time_s[:, None] >= tau + pulse.start_s) & (sample_time_s[:, None] < tau + pulse.end_s)
        echo[:] = np.where(alive, extended(pulse, sample_time_s[:, None] - tau), 0.0) @ weight
    return echoes


def running_sum(
    delay_s: FloatArray,
    weight: FloatArray,
    pulse: Pulse,
    sample_time_s: FloatArray,
    response: ComplexArray | None = None,
) -> FloatArray:
    """Return the echoes of `direct_sum` (echo, sample), exact to rounding but far faster for many samples.

    ``delay_s`` (echo, scatterer), ``weight`` (scatterer,); ``sample_time_s`` (sample,) must ascend. ``response``
    (frequency, scatterer) multiplies each exponential of a scatterer's pulse; None: 1.
    """
    out = np.zeros((len(delay_s), len(sample_time_s)))
    if min(delay_s.shape) == 0:
        return out
    gate_blocks = blocks(sample_time_s, pulse)
    # In ascending delay the scatterers that can reach a block are neighbours.
    early_s, late_s = delay_s.min(axis=0), delay_s.max(axis=0)
    if len(gate_blocks) > 1 and (early_s[1:] < early_s[:-1]).any():
        order = np.argsort(early_s, kind="stable")
        delay_s, weight, early_s, late_s = delay_s[:, order], weight[order], early_s[order], late_s[order]
        response = None if response is None else response[:, order]
    spread_s = float((late_s - early_s).max())
    for block in gate_blocks:
        time_s = sample_time_s[block]
        near = slice(0, len(weight))
        if len(gate_blocks) > 1:
            earliest_s, latest_s = float(time_s[0]) - pulse.end_s - spread_s, float(time_s[-1]) - pulse.start_s
            first, end = early_s.searchsorted([earliest_s, latest_s])
            # One more on either side, because the limits are rounded.
            near = slice(max(0, int(first) - 1), int(end) + 1)
        near_response = None if response is None else response[:, near]
        _add_block(out[:, block], delay_s[:, near], weight[near], pulse, time_s, near_response)
    return out


def blocks(sample_time_s: FloatArray, pulse: Pulse) -> list[slice]:
    """Return slices that divide the samples into blocks no longer than the pulse.

    A scatterer's echo then does not both begin and end within a block.
    """
    slices, start = [], 0
    while start < len(sample_time_s):
        end = int(np.searchsorted(sample_time_s, sample_time_s[start] + (pulse.end_s - pulse.start_s), side="left"))
        slices.append(slice(start, max(end, start + 1)))
        start = max(end, start + 1)
    return slices


def local_origin_s(time_s: FloatArray, pulse: Pulse) -> float:
    """Return the origin of a block's times: 0 if it is near, else the block's middle, since far phases lose digits."""
    middle_s = float(time_s[len(time_s) // 2])
    return middle_s if abs(middle_s) > pulse.end_s - pulse.start_s else 0.0


def _add_block(
    out: FloatArray,
    delay_s: FloatArray,
    weight: FloatArray,
    pulse: Pulse,
    sample_time_s: FloatArray,
    response: ComplexArray | None,
) -> None:
    """Add the echoes in one block of samples to ``out`` (echo, sample), in chunks of echoes and scatterers.

    ``delay_s`` (echo, scatterer), ``weight`` (scatterer,), ``sample_time_s``: times of the block. ``response``
    (frequency, scatterer): response of the beam, None for 1.
    """
    origin_s = local_origin_s(sample_time_s, pulse)
    time_s = sample_time_s - origin_s
    # c_m exp(j w_m t), (frequency, sample): the exponentials whose sum is the pulse.
    exponentials = phasors(pulse, time_s, 1) * np.array(pulse.amplitude)[:, None]
    # Chunks of echoes and scatterers, so that the temporary arrays stay in the cache.
    echoes_per_chunk = max(1, _PAIRS_PER_CHUNK // max(1, len(weight)))
    for first_echo in range(0, len(delay_s), echoes_per_chunk):
        echoes = slice(first_echo, first_echo + echoes_per_chunk)
        for first in range(0, len(weight), _PAIRS_PER_CHUNK):
            scatterers = slice(first, first + _PAIRS_PER_CHUNK)
            chunk_response = None if response is None else response[:, scatterers]
            tau_s = delay_s[echoes, scatterers] - origin_s
            out[echoes] += _chunk_echoes(tau_s, weight[scatterers], pulse, time_s, exponentials, chunk_response)


def _chunk_echoes(
    tau_s: FloatArray,
    weight: FloatArray,
    pulse: Pulse,
    sample_time_s: FloatArray,
    exponentials: ComplexArray,
    response: ComplexArray | None,
) -> FloatArray:
    """Return the sum of delayed, weighted pulses over some scatterers, (echo, sample), in one block of samples.

    ``tau_s`` (echo, scatterer): delays. ``exponentials`` (m, sample): c_m exp(j w_m t) of the pulse. A scatterer is
    alive, and contributes, while its pulse lasts. The block is no longer than the pulse.
    """
    echo_count, samples = len(tau_s), len(sample_time_s)
    # First samples at or after start and end of each pulse, (echo, scatterer).
    enter = np.searchsorted(sample_time_s, tau_s + pulse.start_s)
    leave = np.searchsorted(sample_time_s, tau_s + pulse.end_s)
    is_alive = is_alive_in_block(enter, leave, samples)
    cell = running_sum_cell(np.arange(echo_count)[:, None], enter, leave, samples)[is_alive]
    # The pair's weight times exp(-j w_m tau), times the beam's response, for every exponential m: (m, pair).
    pair_weight = np.broadcast_to(weight, tau_s.shape)[is_alive]
    phasor = phasors(pulse, tau_s[is_alive], -1)
    if response is not None:
        phasor *= np.broadcast_to(response[:, None], (len(response), *tau_s.shape))[:, is_alive]
    # The echo is the sum over m of Re c_m exp(j w_m t) S_m(t), with S_m(t) the sum over the scatterers alive at t.
    echoes = np.zeros((echo_count, samples))
    for pair_phasor, exponential in zip(phasor, exponentials, strict=True):
        sums = []
        for part in (pair_phasor.real, pair_phasor.imag):
            cells = np.bincount(cell, weights=pair_weight * part, minlength=echo_count * 2 * samples)
            sums.append(running_sums(cells.reshape(echo_count, 2, samples)))
        echoes += sums[0] * exponential.real - sums[1] * exponential.imag
    return echoes


def is_alive_in_block(enter: Int64Array, leave: Int64Array, samples: int) -> BoolArray:
    """Return whether a pulse contains a sample of a block, from the first samples at or after its start and its end."""
    return np.asarray((enter < leave) & (enter < samples) & (leave > 0))


def running_sum_cell(row: Int64Array, enter: Int64Array, leave: Int64Array, samples: int) -> Int64Array:
    """Return the cell, in a flat array (row, 2, sample), to which each scatterer adds its term for `running_sums`.

    ``enter`` and ``leave``: first samples of the block at or after start and end of its pulse. The block is no longer
    than the pulse, so a scatterer either enters or leaves in it. One that enters goes into the second half, at the
    sample it enters at. One that is alive at the first sample goes into the first half, which is reversed in time.
    """
    return np.asarray(row * (2 * samples) + np.where(enter == 0, samples - leave, samples + enter))


def running_sums(cells: NDArray[Any]) -> NDArray[Any]:
    """Return the sum over the scatterers alive at each sample, (..., sample), from ``cells`` (..., 2, sample).

    Overwrites ``cells``. A scatterer that enters counts from that sample on, one that leaves up to the sample before.
    """
    np.cumsum(cells, axis=-1, out=cells)
    return np.asarray(cells[..., 0, ::-1] + cells[..., 1, :])
