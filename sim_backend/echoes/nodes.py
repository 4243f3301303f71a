"""Interpolation between echoes at Chebyshev nodes of the amplitude: every echo is a smooth function of one number.

docs/theory/echoes.md, section 4.
"""

from __future__ import annotations

import functools
import math
from dataclasses import replace

import numpy as np

from sim_backend.arrays import ComplexArray, FloatArray
from sim_backend.echoes.delays import EchoDelays
from sim_backend.echoes.exact_sums import running_sum
from sim_backend.echoes.pulse import Pulse

MOST_NODES = 256
"""Node counts from here on mean that interpolation does not pay."""
CHECKED = 8
"""Echoes by which interpolation is checked."""
# Delays held at once: 64 MB.
_PAIRS_AT_ONCE = 1 << 23


def node_count(
    pulse: Pulse, half_range_s: float, edge_share: float, tolerance: float, colour: ComplexArray | None = None
) -> int:
    """Return how many Chebyshev nodes keep the relative rms error below ``tolerance``.

    ``half_range_s`` is the largest departure of a delay from its middle. Two errors add: the phase, whose expansion
    falls like its Bessel coefficients, and the support edges that cross a sample, where the p-th derivative jumps and
    the error falls like M^-(p+1/2) in the ``edge_share`` of the echo's energy (`edge_share`). The estimate errs on the
    safe side by some ten; the tests hold it against the exact sum. A ``colour`` adds the jumps of a tilted spectrum.
    """
    if half_range_s == 0:
        return 1
    # Bessel coefficients of exp(j theta x) fall from the order theta on: no fewer nodes are worth a try.
    theta = 2 * np.pi * max(abs(frequency_hz) for frequency_hz in pulse.frequency_hz) * half_range_s
    jumps = np.array(_edge_jumps(pulse))
    if colour is not None and len(colour) > 1:
        place = np.linspace(-1.0, 1.0, len(colour))
        tilted = replace(pulse, amplitude=tuple((np.array(pulse.amplitude) * place).tolist()))
        jumps = jumps + float(np.abs(colour[-1] - colour[0]).max(initial=0.0)) / 2 * np.array(_edge_jumps(tilted))
    edges = [jump * half_range_s**order * math.sqrt(edge_share) for order, jump in enumerate(jumps.tolist())]
    for nodes in range(max(2, math.ceil(theta)), MOST_NODES):
        smooth = 4 * math.exp(nodes * math.log(theta / 2) - math.lgamma(nodes + 1))
        crossing = sum(edge * nodes ** -(order + 0.5) for order, edge in enumerate(edges))
        if smooth + crossing <= tolerance / 2:
            return nodes
    return MOST_NODES


def edge_share(
    delay_s: FloatArray, weight: FloatArray, pulse: Pulse, half_range_s: float, sample_time_s: FloatArray
) -> float:
    """Return the share of an echo's energy in samples that a scatterer's support edge may cross, 0 to 1."""
    first_s, last_s = float(sample_time_s[0]), float(sample_time_s[-1])
    # At least one sample an edge: where all edges coincide, chance does not average.
    reach_s = max(half_range_s, (last_s - first_s) / (2 * len(sample_time_s)))

    weighted, begin_s, end_s = np.square(weight), first_s - reach_s, last_s + reach_s

    def energy(from_s: float, until_s: float) -> float:
        """Return the summed energy times the time that ``delay_s`` plus from and until share with the gate."""
        inside_s = np.minimum(delay_s + until_s, end_s) - np.maximum(delay_s + from_s, begin_s)
        return float(weighted @ np.maximum(inside_s, 0.0, out=inside_s))

    lit = energy(pulse.start_s, pulse.end_s)
    if lit <= 0:
        return 1.0
    crossed = energy(pulse.start_s - reach_s, pulse.start_s + reach_s)
    return min(1.0, (crossed + energy(pulse.end_s - reach_s, pulse.end_s + reach_s)) / lit)


@functools.lru_cache(maxsize=32)
def _edge_jumps(pulse: Pulse) -> tuple[float, ...]:
    """Return by how much each derivative, from the pulse itself on, jumps where the support begins or ends.

    Over its factorial and the sum of the pulse's amplitudes, so that a weaker pulse has the same; 1/s^order.
    """
    omega = 2 * np.pi * np.array(pulse.frequency_hz)
    scale = float(np.abs(pulse.amplitude).sum())
    edges = np.exp(1j * np.outer([pulse.start_s, pulse.end_s], omega)) * pulse.amplitude / scale
    # Referred to the strongest component, whose phase a derivative of the envelope does not see.
    offset = omega - omega[int(np.argmax(np.abs(pulse.amplitude)))]
    sizes = [float(np.abs(edges @ offset**order).max()) / math.factorial(order) for order in range(3)]
    fastest = max(1.0, float(np.abs(offset).max()))
    # What cancels exactly on paper is no jump; of the second derivative it is counted all the same.
    return tuple(
        size if order == 2 or size * math.factorial(order) > 1e-9 * fastest**order else 0.0
        for order, size in enumerate(sizes)
    )


def interpolated_within(
    delays: EchoDelays, weight: FloatArray, pulse: Pulse, sample_time_s: FloatArray, nodes: int, tolerance: float
) -> FloatArray | None:
    """Return the echoes of a motion of one shape by `interpolated`; None where it misses ``tolerance``.

    That is told by some echoes that are summed exactly: few scatterers in the gate may all lie where a support ends.
    """
    echo = interpolated(delays, weight, pulse, sample_time_s, nodes)
    ascending = np.argsort(delays.amplitude_s[:, 0], kind="stable")
    checked = ascending[np.unique(np.linspace(0, len(echo) - 1, CHECKED).astype(np.int64))]
    some_s = delays.rest_s + delays.amplitude_s[checked] @ delays.shape
    exact = running_sum(some_s, weight, pulse, sample_time_s, delays.colour)
    error = echo[checked] - exact
    # Half of the tolerance: the others may be worse than those checked.
    if 4 * np.vdot(error, error) > tolerance**2 * np.vdot(exact, exact):
        return None
    echo[checked] = exact
    return echo


def interpolated(
    delays: EchoDelays, weight: FloatArray, pulse: Pulse, sample_time_s: FloatArray, nodes: int
) -> FloatArray:
    """Return the echoes (echo, sample) of a motion of one shape.

    They are exact at ``nodes`` Chebyshev points of the amplitude's range and a polynomial in between.
    """
    amplitude_s = delays.amplitude_s[:, 0]
    low, high = float(amplitude_s.min()), float(amplitude_s.max())
    middle, half = (high + low) / 2, (high - low) / 2
    angle = (np.arange(nodes) + 0.5) * np.pi / nodes
    parts = replace(delays, amplitude_s=(middle + half * np.cos(angle))[:, None]).parts(_PAIRS_AT_ONCE)
    at_nodes = np.concatenate([running_sum(delay_s, weight, pulse, sample_time_s, delays.colour) for delay_s in parts])
    if half == 0.0:
        return np.repeat(at_nodes[:1], len(amplitude_s), axis=0)
    degree = np.arange(nodes)
    wanted = np.arccos(np.clip((amplitude_s - middle) / half, -1.0, 1.0))
    # Values at the nodes -> Chebyshev coefficients -> values at the amplitudes wanted: two small matrices.
    to_coefficients = np.cos(np.outer(degree, angle)) * (2 / nodes)
    to_coefficients[0] /= 2
    return np.asarray((np.cos(np.outer(wanted, degree)) @ to_coefficients) @ at_nodes)
