"""Response of an aperture's beam to each scatterer, at every frequency of the pulse.

A Gaussian beam only weakens an echo. A real beam weakens high frequencies more off the axis, and changes their phase.
See docs/explanation/transducer.md, section 2.
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


_BAND_NODES = 9
"""Frequencies between which the response is interpolated over the band of a pulse."""
_MAX_WINDOW_EXPONENTIALS = 3
"""Pulses of at most so many exponentials are windows; only a response linear in frequency keeps the window's shape."""
_FAINT_AMPLITUDE = 1e-5
"""Relative amplitude below which an exponential does not extend the band."""


@dataclass(frozen=True, slots=True)
class BeamResponse:
    """Response of a beam to the echo of each scatterer."""

    weight: FloatArray
    """(scatterer,), largest magnitude over the frequencies of the pulse, relative to the focus."""
    response: ComplexArray | None = None
    """(frequency, scatterer), complex response at each frequency, divided by ``weight``; None: 1."""
    delay_ratio: FloatArray | None = None
    """(scatterer,), delay caused by a displacement u, divided by 2 u / c; None: 1."""


def beam_response(
    settings: SimulationSettings, offset_m: FloatArray, pulse: Pulse, of_push: bool = False
) -> BeamResponse:
    """Return the response of the aperture to echoes of ``pulse`` from ``offset_m`` (scatterer, 3) from the focus.

    It is split into a weight, the largest magnitude over the frequencies, which selects the scatterers that matter, and
    the response relative to it. ``of_push``: the pulse is a toneburst, centred on the axis of the push instead of that
    of the tracking.
    """
    # Imported in the function: a Gaussian beam does not need this package, which takes long to load.
    from sim_backend.transducer import pulse_echo_beam

    x, y = (0.0, 0.0) if of_push else settings.beams.lateral_offset_m
    lateral_m, axial_m = np.hypot(offset_m[:, 0] - x, offset_m[:, 1] - y), offset_m[:, 2]
    # The beam is computed at a few frequencies, tabulated, and interpolated to the exponentials of the pulse. With a
    # ``mixture`` each table is a weighted sum over these frequencies.
    computed_hz, mixture, from_tables = _frequency_interpolation(pulse)
    reach_m = float(lateral_m.max(initial=0.0)), float(np.abs(axial_m).max(initial=0.0))
    beam = pulse_echo_beam(settings, computed_hz, *reach_m, mixture, of_push)
    # ``delay_ratio``: delay by a displacement u over 2 u / c; oblique waves make it differ from 1.
    tabulated, delay_ratio = beam.at(lateral_m, axial_m)
    response = from_tables @ tabulated
    weight = np.abs(response).max(axis=0)
    relative_response = response / np.where(weight > 0, weight, 1.0)
    return BeamResponse(weight=weight, response=relative_response, delay_ratio=delay_ratio)


def _frequency_interpolation(pulse: Pulse) -> tuple[tuple[float, ...], Mixture | None, FloatArray]:
    """Return at which frequencies to compute a beam for ``pulse``, and how to interpolate to all its exponentials.

    * The frequencies, Hz.
    * Weights (table, frequency) of the tables that are sums over these frequencies; None: one table a frequency.
    * The matrix (exponential, table) from the tables to the beam at each exponential of the pulse.

    A window of up to three exponentials takes a straight line in frequency, fitted with energy as weight, since any
    other function would make steps where the window ends. More exponentials take the polynomial through the Chebyshev
    points of the band.
    """
    exponential_hz, amplitude = np.array(pulse.frequency_hz), np.abs(pulse.amplitude)
    if len(exponential_hz) == 1:
        return pulse.frequency_hz, None, np.ones((1, 1))
    if len(exponential_hz) <= _MAX_WINDOW_EXPONENTIALS:
        energy = amplitude**2 / (amplitude**2).sum()
        offset_hz = exponential_hz - energy @ exponential_hz
        # Two tables: the line's value at the mean frequency, and its change from there to the largest offset.
        max_offset_hz = np.abs(offset_hz).max()
        change = energy * offset_hz * max_offset_hz / (energy @ offset_hz**2)
        line = np.stack([np.ones(len(exponential_hz)), offset_hz / max_offset_hz], axis=1)
        return pulse.frequency_hz, (tuple(energy.tolist()), tuple(change.tolist())), line
    strong_hz = exponential_hz[amplitude > _FAINT_AMPLITUDE * amplitude.max()]
    low_hz, high_hz = float(strong_hz.min()), float(strong_hz.max())
    # Values at the Chebyshev points -> coefficients of the polynomials -> values at the exponentials.
    chebyshev = np.polynomial.chebyshev
    points = chebyshev.chebpts1(_BAND_NODES)
    to_coefficients = chebyshev.chebvander(points, _BAND_NODES - 1).T * (2 / _BAND_NODES)
    to_coefficients[0] /= 2
    position = np.clip(2 * (exponential_hz - low_hz) / (high_hz - low_hz) - 1, -1.0, 1.0)
    point_hz = tuple((low_hz + (high_hz - low_hz) * (points + 1) / 2).tolist())
    return point_hz, None, chebyshev.chebvander(position, _BAND_NODES - 1) @ to_coefficients
