"""Colour of the echoes: what each scatterer's echo has of every frequency of the pulse, in the beam of an aperture.

A Gaussian beam weakens an echo and no more; a real one weakens its high frequencies more off the axis and turns its
phase. docs/theory/transducer.md, section 2.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from sim_backend.arrays import ComplexArray, FloatArray
from sim_backend.echoes.pulse import Pulse
from sim_backend.settings import SimulationSettings

if TYPE_CHECKING:
    from sim_backend.transducer import Mixture


_NODES = 9
"""Frequencies that a pulse's band is interpolated between."""
_LINES = 3
"""Frequencies up to which a pulse is a window's few lines, whose shape only a colour linear in frequency keeps."""
_FAINT = 1e-5


@dataclass(frozen=True, slots=True)
class Colouring:
    """What a beam makes of the echo of each scatterer."""

    weight: FloatArray
    """(scatterer,) largest share of any of the pulse's frequencies, relative to the focus."""
    colour: ComplexArray
    """(frequency, scatterer) share of each frequency, phase included, over ``weight``."""
    sensed: FloatArray
    """(scatterer,) delay that a displacement makes, over 2 u / c."""


def coloured(settings: SimulationSettings, offset_m: FloatArray, pulse: Pulse, of_push: bool = False) -> Colouring:
    """Return what the aperture's beam makes of the echo of ``pulse`` from ``offset_m`` (scatterer, 3) off the focus.

    ``of_push``: of a toneburst, whose axis is that of the push, not of the tracking.
    """
    # here, so that Gaussian beams load nothing of it
    from sim_backend.transducer import pulse_echo_beam

    x, y = (0.0, 0.0) if of_push else settings.beams.lateral_offset_m
    lateral_m, axial_m = np.hypot(offset_m[:, 0] - x, offset_m[:, 1] - y), offset_m[:, 2]
    node_hz, mixture, to_lines = _band(pulse)
    reach_m = float(lateral_m.max(initial=0.0)), float(np.abs(axial_m).max(initial=0.0))
    seen, sensed = pulse_echo_beam(settings, node_hz, *reach_m, mixture, of_push).at(lateral_m, axial_m)
    share = to_lines @ seen
    weight = np.abs(share).max(axis=0)
    return Colouring(weight, share / np.where(weight > 0, weight, 1.0), sensed)


def _band(pulse: Pulse) -> tuple[tuple[float, ...], Mixture | None, FloatArray]:
    """Return frequencies to know the beam at, what to tabulate of them, and what leads to the pulse's (line, table).

    Of three lines, a window's, the least squares straight line by their energies: anything else would make steps where
    the window ends. Of many, the polynomial through Chebyshev's points of the band.
    """
    line_hz, size = np.array(pulse.frequency_hz), np.abs(pulse.amplitude)
    if len(line_hz) == 1:
        return pulse.frequency_hz, None, np.ones((1, 1))
    if len(line_hz) <= _LINES:
        energy = size**2 / (size**2).sum()
        off_hz = line_hz - energy @ line_hz
        # Two tables: the mean, and the slope times the largest departure from the mean's frequency.
        most_hz = np.abs(off_hz).max()
        slope = energy * off_hz * most_hz / (energy @ off_hz**2)
        mixture = tuple(energy.tolist()), tuple(slope.tolist())
        return pulse.frequency_hz, mixture, np.stack([np.ones(len(line_hz)), off_hz / most_hz], axis=1)
    heard = line_hz[size > _FAINT * size.max()]
    low, high = float(heard.min()), float(heard.max())
    point = np.cos((np.arange(_NODES) + 0.5) * np.pi / _NODES)[::-1]
    degree = np.arange(_NODES)
    at = np.clip(2 * (line_hz - low) / (high - low) - 1, -1.0, 1.0)
    to_series = np.cos(np.outer(degree, np.arccos(point))) * (2 / _NODES)
    to_series[0] /= 2
    node_hz = tuple((low + (high - low) * (point + 1) / 2).tolist())
    return node_hz, None, np.cos(np.outer(np.arccos(at), degree)) @ to_series
