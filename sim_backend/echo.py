"""Echoes of moving point scatterers, eq. (7) to (13): one equation, three evaluations.

Symbols: ``tau`` delay of a scatterer's echo (s), ``I`` its weight, ``g`` its share of the focus displacement ``A`` (m),
``w_m`` and ``c_m`` angular frequency and complex amplitude of the pulse's m-th exponential. One echo is

    r(t) = sum_n I_n p(t - tau_n),    p(t) = Re sum_m c_m exp(j w_m t) for start <= t < end, else 0.

Delays and sample times share one origin. Put it near the echo (the focus), not at the pulse's onset 90 us earlier:
then ``w t`` stays below some hundred radians and its rounding near 1e-14.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

# Echo-scatterer pairs handled at once: 8 MB a complex array, still inside the caches that matter.
_PAIRS_AT_ONCE = 1 << 19
MOST_NODES = 256
"""Node counts from here on mean that interpolation does not pay."""


@dataclass(frozen=True, slots=True)
class Pulse:
    """A pulse on a compact support that is a sum of exponentials; time 0 is its nominal arrival."""

    start_s: float
    end_s: float
    frequency_hz: tuple[float, ...]
    amplitude: tuple[complex, ...]


def hann_pulse(carrier_hz: float, bandwidth: float) -> Pulse:
    """Return the tracking echo of eq. (9): a cosine under a Hann window of length 1/(BW f), centred on its arrival."""
    half = 0.5 / (bandwidth * carrier_hz)
    frequency_hz = (carrier_hz, carrier_hz * (1 - bandwidth), carrier_hz * (1 + bandwidth))
    return Pulse(-half, half, frequency_hz, (0.5, 0.25, 0.25))


def rectangular_burst(carrier_hz: float, duration_s: float) -> Pulse:
    """Return a sine burst of unit amplitude that begins at its arrival with a rising zero crossing."""
    return Pulse(0.0, duration_s, (carrier_hz,), (-1j,))


def waveform(pulse: Pulse, time_s: Floats) -> Floats:
    """Return the pulse at ``time_s``, any shape, relative to its arrival."""
    value = np.zeros(time_s.shape)
    for frequency_hz, amplitude in zip(pulse.frequency_hz, pulse.amplitude, strict=True):
        value += (amplitude * np.exp(2j * np.pi * frequency_hz * time_s)).real
    return np.where((time_s >= pulse.start_s) & (time_s < pulse.end_s), value, 0.0)


def direct(delay_s: Floats, weight: Floats, pulse: Pulse, sample_time_s: Floats) -> Floats:
    """Return the double sum as written, float64 (echo, sample): the reference for the other evaluations.

    ``delay_s`` (echo, scatterer), ``weight`` (scatterer,), ``sample_time_s`` (sample,). Eq. (10).
    """
    echoes_out = np.empty((len(delay_s), len(sample_time_s)))
    for echo, tau in zip(echoes_out, delay_s, strict=True):
        echo[:] = waveform(pulse, sample_time_s[:, None] - tau) @ weight
    return echoes_out


def running_sum(delay_s: Floats, weight: Floats, pulse: Pulse, sample_time_s: Floats) -> Floats:
    """Return the same as `direct` in O(scatterers + samples) an echo, exact to rounding.

    A scatterer enters the sum ``I_n exp(-j w_m tau_n)`` where its support begins and leaves where it ends, so one
    cumulative sum over samples serves all of them. ``sample_time_s`` must ascend. Model notes, section 2.
    """
    out = np.empty((len(delay_s), len(sample_time_s)))
    step = max(1, _PAIRS_AT_ONCE // max(1, len(weight)))
    carriers = [np.exp(2j * np.pi * frequency_hz * sample_time_s) for frequency_hz in pulse.frequency_hz]
    for first in range(0, len(delay_s), step):
        out[first : first + step] = _running_block(
            delay_s[first : first + step], weight, pulse, sample_time_s, carriers
        )
    return out


def _running_block(
    tau: Floats, weight: Floats, pulse: Pulse, sample_time_s: Floats, carriers: list[NDArray[np.complex128]]
) -> Floats:
    echoes_in_block, samples = len(tau), len(sample_time_s)
    row = (np.arange(echoes_in_block) * (samples + 1))[:, None]
    enter = (row + np.searchsorted(sample_time_s, tau + pulse.start_s)).ravel()
    leave = (row + np.searchsorted(sample_time_s, tau + pulse.end_s)).ravel()
    # Scatterers outside the gate on either side enter and leave at the same sample: spare their exponentials.
    seen = enter < leave
    enter, leave, tau_seen = enter[seen], leave[seen], tau.ravel()[seen]
    weight_seen = np.broadcast_to(weight, tau.shape).ravel()[seen]
    cells = echoes_in_block * (samples + 1)
    total = np.zeros((echoes_in_block, samples))
    for carrier, frequency_hz, amplitude in zip(carriers, pulse.frequency_hz, pulse.amplitude, strict=True):
        angle = (2 * np.pi * frequency_hz) * tau_seen
        parts = []
        for part in (weight_seen * np.cos(angle), -weight_seen * np.sin(angle)):
            change = np.bincount(enter, part, cells) - np.bincount(leave, part, cells)
            parts.append(np.cumsum(change.reshape(echoes_in_block, samples + 1)[:, :-1], axis=1))
        rotation = amplitude * carrier
        total += parts[0] * rotation.real - parts[1] * rotation.imag
    return total


def node_count(pulse: Pulse, half_range_s: float, edge_share: float, tolerance: float) -> int:
    """Return how many Chebyshev nodes keep the relative rms error below ``tolerance``.

    ``half_range_s`` is the largest departure of a delay from its middle. Two errors add: the phase, whose expansion
    falls like its Bessel coefficients, and the support edges that cross a sample, where the p-th derivative jumps and
    the error falls like M^-(p+1/2) in the ``edge_share`` of the echo's energy (`edge_share`). The estimate errs on the
    safe side by some ten; the tests hold it against the exact sum.
    """
    if half_range_s == 0:
        return 1
    theta = 2 * np.pi * max(abs(frequency_hz) for frequency_hz in pulse.frequency_hz) * half_range_s
    order, jump = _edge_jump(pulse)
    edge = jump * half_range_s**order / math.factorial(order) * math.sqrt(edge_share)
    for nodes in range(max(2, math.ceil(theta)), MOST_NODES):
        smooth = 4 * math.exp(nodes * math.log(theta / 2) - math.lgamma(nodes + 1))
        if smooth + edge * nodes ** -(order + 0.5) <= tolerance / 2:
            return nodes
    return MOST_NODES


def edge_share(delay_s: Floats, weight: Floats, pulse: Pulse, half_range_s: float, sample_time_s: Floats) -> float:
    """Return the share of an echo's energy in samples that a scatterer's support edge may cross, 0 to 1."""
    first_s, last_s = float(sample_time_s[0]), float(sample_time_s[-1])
    # At least one sample an edge: where all edges coincide, chance does not average.
    reach_s = max(half_range_s, (last_s - first_s) / (2 * len(sample_time_s)))

    def energy(begin_s: Floats, end_s: Floats) -> float:
        inside_s = np.minimum(end_s, last_s + reach_s) - np.maximum(begin_s, first_s - reach_s)
        return float(weight**2 @ np.maximum(inside_s, 0.0))

    start_s, end_s = delay_s + pulse.start_s, delay_s + pulse.end_s
    crossed = energy(start_s - reach_s, start_s + reach_s) + energy(end_s - reach_s, end_s + reach_s)
    lit = energy(start_s, end_s)
    return min(1.0, crossed / lit) if lit > 0 else 1.0


def _edge_jump(pulse: Pulse) -> tuple[int, float]:
    """Return order and size of the lowest derivative that jumps where the support begins or ends."""
    omega = 2 * np.pi * np.array(pulse.frequency_hz)
    scale = float(np.abs(pulse.amplitude).sum())
    edges = np.exp(1j * np.outer([pulse.start_s, pulse.end_s], omega)) * pulse.amplitude
    # Referred to the first component, whose phase a derivative of the envelope does not see.
    for order in range(3):
        jump = float(np.abs(edges @ (omega - omega[0]) ** order).max())
        if jump > 1e-9 * scale * max(1.0, float(np.abs(omega - omega[0]).max())) ** order:
            return order, jump
    return 2, jump


def interpolated(
    depth_delay_s: Floats,
    weight: Floats,
    motion_weight: Floats,
    displacement_m: Floats,
    pulse: Pulse,
    sample_time_s: Floats,
    sound_speed_m_per_s: float,
    nodes: int,
) -> Floats:
    """Return the echoes of proportional displacement from ``nodes`` echoes at Chebyshev points of its range.

    Every echo is a smooth function of the one number A_k (eq. 12): synthesise few, interpolate all. Shapes as `echoes`.
    """
    low, high = float(displacement_m.min()), float(displacement_m.max())
    middle, half = (high + low) / 2, (high - low) / 2
    angle = (np.arange(nodes) + 0.5) * np.pi / nodes
    delay = _delays(depth_delay_s, motion_weight, middle + half * np.cos(angle), sound_speed_m_per_s)
    at_nodes = running_sum(delay, weight, pulse, sample_time_s)
    if half == 0.0:
        return np.repeat(at_nodes[:1], len(displacement_m), axis=0)
    degree = np.arange(nodes)
    wanted = np.arccos(np.clip((displacement_m - middle) / half, -1.0, 1.0))
    to_coefficients = np.cos(np.outer(degree, angle)) * (2 / nodes)
    to_coefficients[0] /= 2
    return np.asarray((np.cos(np.outer(wanted, degree)) @ to_coefficients) @ at_nodes)


def echoes(
    depth_delay_s: Floats,
    weight: Floats,
    motion_weight: Floats,
    displacement_m: Floats,
    pulse: Pulse,
    sample_time_s: Floats,
    sound_speed_m_per_s: float,
    tolerance: float = 1e-9,
    shift_s: Floats | None = None,
) -> Floats:
    """Return the echoes of proportionally moving scatterers, float64 (echo, sample), eq. (7) to (13).

    ``depth_delay_s``, ``weight``, ``motion_weight`` (scatterer,); ``displacement_m`` (echo,) at the focus;
    ``sample_time_s`` (sample,) ascending, same origin as the delays; ``shift_s`` (echo,) added to the sample times of
    each echo. ``tolerance`` is the rms error against the exact sum over the echoes' rms; where few nodes meet it the
    echoes are interpolated, otherwise, and for 0 or unequal shifts, the sum is exact.
    """
    if min(len(displacement_m), len(weight), len(sample_time_s)) == 0:
        return np.zeros((len(displacement_m), len(sample_time_s)))
    if shift_s is None or not shift_s.any():
        half_range_s = float(np.ptp(displacement_m)) / sound_speed_m_per_s
        share = edge_share(depth_delay_s, weight, pulse, half_range_s, sample_time_s)
        nodes = node_count(pulse, half_range_s, share, tolerance)
        if nodes < min(len(displacement_m), MOST_NODES):
            moved = (depth_delay_s, weight, motion_weight, displacement_m)
            return interpolated(*moved, pulse, sample_time_s, sound_speed_m_per_s, nodes)
    delay_s = _delays(depth_delay_s, motion_weight, displacement_m, sound_speed_m_per_s)
    if shift_s is not None:
        delay_s -= shift_s[:, None]
    return running_sum(delay_s, weight, pulse, sample_time_s)


def _delays(depth_delay_s: Floats, motion_weight: Floats, displacement_m: Floats, sound_speed_m_per_s: float) -> Floats:
    return depth_delay_s + np.outer(displacement_m * (2 / sound_speed_m_per_s), motion_weight)
