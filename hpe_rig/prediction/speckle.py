"""Random draws of speckle: complex envelopes of echoes in the gate, at rest and weighted by their displacement.

Scatterers of the stated density are placed at random in a box around the focus and summed into cells of depth. The
pulse blurs the cells into the gate. Neither the carrier nor pulses in slow time are simulated.

Arrays are in single precision, which halves the time: a finite number of draws limits the accuracy to about 1 %.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np

from hpe_rig.arrays import ComplexArray, FloatArray, Int64Array, SingleArray
from hpe_rig.prediction.conditions import Conditions, Triple

Displacement = Callable[[SingleArray], SingleArray]
"""Displacement (scatterer,) at the positions (3, scatterer), m from the focus, relative to any unit."""

INSTANTS = 64
"""Instants of the gate."""
BAND_OVER_CARRIER = 1.0
"""Width of the band over the carrier."""
MAX_SCATTERERS = 5000
"""Largest mean number of scatterers of one draw. With tens in every resolution cell the sums are nearly normal.

The excess of their fourth moment is inversely proportional to the number in a cell."""
BLOCK_DRAWS = 50
"""Draws summed at a time: a block fits into the processor's cache, which halves the time."""
BOX_HALF_WIDTH_SIGMAS = 3.5
"""Half width of the box in sigmas of the tracking beam: scatterers outside echo with 2e-3 of the peak."""


@dataclass(frozen=True, slots=True, eq=False)
class Speckle:
    """Envelopes (draw, instant) of echoes, at rest and weighted by their displacement."""

    resting: ComplexArray
    displaced: ComplexArray


@dataclass(frozen=True, slots=True, eq=False)
class Scattering:
    """Scatterers summed into cells of depth, (draw, cell): echo, and echo weighted by the displacement."""

    echo: ComplexArray
    displaced: ComplexArray
    depth_m: FloatArray

    def speckle(self, gate_length_m: float, pulse_length_m: float) -> Speckle:
        """Return the complex envelopes (draw, instant) of the echoes in a gate around the focus, for a Hann pulse.

        Draws without an echo in the gate, which sparse scatterers have, carry no information and are left out.
        """
        instant_m = ((np.arange(INSTANTS) + 0.5) / INSTANTS - 0.5) * gate_length_m
        distance = (instant_m - self.depth_m[:, None]) / pulse_length_m
        pulse = np.where(np.abs(distance) < 0.5, np.cos(np.pi * distance) ** 2, 0.0)
        resting, displaced = matmul(self.echo, pulse), matmul(self.displaced, pulse)
        with_echo = np.any(resting != 0, axis=-1)
        if with_echo.all() or not with_echo.any():
            return Speckle(resting, displaced)
        return Speckle(resting[with_echo], displaced[with_echo])


def draw_speckle(
    conditions: Conditions,
    generator: np.random.Generator | None,
    draws: int = 1000,
    displacement: Displacement | None = None,
) -> Speckle:
    """Return the echo envelopes of ``draws`` random draws of scatterers, at rest and weighted by their displacement.

    ``generator`` None: fixed seeds. ``displacement``: function of position (default: the Gaussian of the paper).
    """
    scattering = draw_scattering(conditions, generator, draws, *_cells(conditions), displacement)
    return scattering.speckle(conditions.gate_length_m, conditions.pulse_length_m)


def seeded_speckle(conditions: Conditions, draws: int, displacement: Displacement | None = None) -> Speckle:
    """Return ``draw_speckle`` with fixed seeds, so that a prediction is a function of the scene; cached.

    Conditions with equal echoes have the same scatterers for any displacement.
    """
    # Speckle does not depend on noise, fit, and the time course of the motion: fixed values give equal cache keys.
    echoes = replace(conditions, pulses=1, frequency_hz=0.0, amplitude_m=0.0, snr=np.inf)
    return _cached_speckle(replace(echoes, trigger_jitter_s=0.0, fit_gain=1.0), None, draws, displacement)


_cached_speckle = functools.lru_cache(maxsize=4)(draw_speckle)


def draw_scattering(
    conditions: Conditions,
    generator: np.random.Generator | None,
    draws: int,
    depth_m: float,
    cells: int,
    displacement: Displacement | None = None,
) -> Scattering:
    """Return ``draws`` random sets of scatterers around the focus, each summed into ``cells`` depth cells.

    ``generator`` None: fixed seeds, so that a larger number of draws begins with the same ones. ``depth_m``: total
    depth of the cells, centred on the focus; the draws serve any gate and pulse within it. The default ``displacement``
    is the Gaussian of the paper, eq. (12). The mean number of scatterers of a draw is at most ``MAX_SCATTERERS``: more
    would change only the echo's strength, which predictions do not depend on.
    """
    displacement = displacement or functools.partial(_gaussian, conditions.excitation_width_m)
    blocks = []
    for block, first in enumerate(range(0, draws, BLOCK_DRAWS)):
        block_generator = generator or np.random.default_rng([0, block])
        size = min(BLOCK_DRAWS, draws - first)
        blocks.append(_draw_block(conditions, block_generator, size, depth_m, cells, displacement))
    echo, displaced = (np.concatenate(block_echoes) for block_echoes in zip(*blocks, strict=True))
    return Scattering(echo, displaced, ((np.arange(cells) + 0.5) / cells - 0.5) * depth_m)


def _draw_block(
    conditions: Conditions,
    generator: np.random.Generator,
    draws: int,
    depth_m: float,
    cells: int,
    displacement: Displacement,
) -> tuple[ComplexArray, ComplexArray]:
    """Return the echoes (draw, cell) of random scatterers in a box, at rest and weighted by their ``displacement``.

    The box is ``depth_m`` deep and divided into ``cells`` over its depth.
    """
    sides_m = [2 * BOX_HALF_WIDTH_SIGMAS * width for width in conditions.tracking_width_m[:2]]
    box_m = np.array([*sides_m, depth_m], dtype=np.float32)
    mean_count = min(conditions.scatterers_per_m3 * float(np.prod(box_m)), MAX_SCATTERERS)
    count = generator.poisson(mean_count, draws)
    # Positions are uniform in the box and phases uniform over a turn: fully random interference.
    unit_position, phase = (generator.random((rows, count.sum()), dtype=np.float32) for rows in (3, 1))
    position_m = (unit_position - np.float32(0.5)) * box_m[:, None]
    angle = np.float32(2 * np.pi) * phase[0]
    strength = _gaussian(conditions.tracking_width_m, position_m)
    real, imaginary = strength * np.cos(angle), strength * np.sin(angle)
    # Cells are numbered over all draws of the block.
    cell = np.minimum((unit_position[2] * np.float32(cells)).astype(np.int64), cells - 1)
    cell += cells * np.repeat(np.arange(draws), count)
    weight = displacement(position_m)
    echo = _sum_into_cells(cell, (real, imaginary), (draws, cells))
    return echo, _sum_into_cells(cell, (real * weight, imaginary * weight), (draws, cells))


def _sum_into_cells(cell: Int64Array, components: Iterable[SingleArray], shape: tuple[int, ...]) -> ComplexArray:
    """Return the complex sums (draw, cell) of the scatterers' real and imaginary ``components`` in each cell."""
    # bincount sums real numbers; complex exponentials would take three times as long.
    real, imaginary = (np.bincount(cell, component, math.prod(shape)) for component in components)
    return (real + 1j * imaginary).reshape(shape).astype(np.complex64)


def _cells(conditions: Conditions) -> tuple[float, int]:
    """Return the depth range of a gate's scatterers, m, and the number of its cells."""
    depth_m = conditions.gate_length_m + conditions.pulse_length_m
    return depth_m, int(np.clip(4 * np.ceil(depth_m / conditions.pulse_length_m), 48, 192))


def _gaussian(width_m: Triple, position_m: SingleArray) -> SingleArray:
    """Return a Gaussian of the sigmas ``width_m`` at ``position_m`` (3, scatterer)."""
    return np.asarray(np.exp((-0.5 / np.square(width_m)).astype(np.float32) @ np.square(position_m)))


def matmul(draws: ComplexArray, matrix: ComplexArray | FloatArray) -> ComplexArray:
    """Return ``draws @ matrix`` in the precision of ``draws``."""
    return np.asarray(draws @ matrix.astype(draws.dtype))


def instant_s(conditions: Conditions) -> float:
    """Return the time between two instants of the gate."""
    return 2 * conditions.gate_length_m / conditions.sound_speed_m_per_s / INSTANTS


def to_band(conditions: Conditions, bins: int, window: FloatArray | float = 1.0) -> ComplexArray:
    """Return the matrix (instant, bin) from envelopes to their spectrum in the transmitted band.

    The envelopes are multiplied by ``window``. The spectrum is that of a Fourier transform with ``bins`` bins; only
    those in the band are kept, a sixth, which takes a third of the time of the full transform.
    """
    frequency_hz = np.fft.fftfreq(bins, instant_s(conditions))
    band_hz = frequency_hz[np.abs(frequency_hz) <= conditions.carrier_hz * BAND_OVER_CARRIER / 2]
    phase_rad = 2 * np.pi * instant_s(conditions) * np.outer(band_hz, np.arange(INSTANTS))
    return np.asarray((window * np.exp(-1j * phase_rad)).T)
