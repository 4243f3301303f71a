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

import numpy as np
from numpy.typing import NDArray

from sim_backend.arrays import ComplexArray, FloatArray
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
    """Add the echoes in one block of samples to ``out`` (echo, sample), some echoes and scatterers at a time.

    ``delay_s`` (echo, scatterer), ``weight`` (scatterer,), ``sample_time_s``: of the block. ``response`` (frequency,
    scatterer): of the beam, None for 1.
    """
    origin_s = local_origin_s(sample_time_s, pulse)
    time_s = sample_time_s - origin_s
    # (frequency, sample): c_m exp(j w_m t).
    rotation = phasors(pulse, time_s, 1) * np.array(pulse.amplitude)[:, None]
    echoes_per_chunk = max(1, _PAIRS_PER_CHUNK // max(1, len(weight)))
    for first in range(0, len(delay_s), echoes_per_chunk):
        echoes = slice(first, first + echoes_per_chunk)
        for cut in range(0, len(weight), _PAIRS_PER_CHUNK):
            pairs = slice(cut, cut + _PAIRS_PER_CHUNK)
            pair_response = None if response is None else response[:, pairs]
            tau = delay_s[echoes, pairs] - origin_s
            out[echoes] += _block(tau, weight[pairs], pulse, time_s, rotation, pair_response)


def _block(
    tau: FloatArray,
    weight: FloatArray,
    pulse: Pulse,
    sample_time_s: FloatArray,
    rotation: ComplexArray,
    response: ComplexArray | None,
) -> FloatArray:
    """Return the echoes in one block of samples, (echo, sample), by running sums over the scatterers.

    ``tau`` (echo, scatterer): delays. ``rotation`` (exponential m, sample): c_m exp(j w_m t) of the pulse. A scatterer
    contributes while its pulse lasts ("alive"); the sum over these changes only where a pulse begins or ends.
    """
    echo_count, samples = len(tau), len(sample_time_s)
    row = np.arange(echo_count)[:, None]
    # First samples at or after start and end of each support, (echo, scatterer).
    enter = np.searchsorted(sample_time_s, tau + pulse.start_s)
    leave = np.searchsorted(sample_time_s, tau + pulse.end_s)
    holds_sample = (enter < leave) & (enter < samples) & (leave > 0)
    # Two rows of cells an echo: scatterers alive at the first sample, by the sample they leave at, backwards; and
    # scatterers that enter later, by the sample they enter at.
    leaving, entering = 2 * row * samples + samples - leave, (2 * row + 1) * samples + enter
    cell = np.where(enter == 0, leaving, entering)[holds_sample]
    weight_in, tau_in = np.broadcast_to(weight, tau.shape)[holds_sample], tau[holds_sample]
    # exp(-j w_m tau) of every exponential m and delay tau, times the beam's response.
    phasor = phasors(pulse, tau_in, -1)
    if response is not None:
        phasor *= np.broadcast_to(response[:, None], (len(response), *tau.shape))[:, holds_sample]
    # Sum S_m(t) over the scatterers alive at t, for each exponential; the echo is Re c_m exp(j w_m t) S_m(t).
    echoes = np.zeros((echo_count, samples))
    for terms, factor in zip(phasor, rotation, strict=True):
        real, imag = (
            _alive_sums(np.bincount(cell, weights=weight_in * component, minlength=2 * echo_count * samples), samples)
            for component in (terms.real, terms.imag)
        )
        echoes += real * factor.real - imag * factor.imag
    return echoes


def _alive_sums(cells: NDArray[np.floating | np.integer], samples: int) -> FloatArray:
    """Return the sum over the scatterers alive at each sample, (echo, sample), from both rows of cells."""
    summed = np.cumsum(cells.reshape(-1, 2, samples), axis=2)
    return np.asarray(summed[:, 0, ::-1] + summed[:, 1])
