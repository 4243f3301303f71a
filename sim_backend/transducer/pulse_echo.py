"""Pulse-echo beam of one transducer that sends and hears: what a scatterer adds to the echo, frequency by frequency.

    G(r, z, f) = (P(r, z, f) / P(0, 0, f))^2 exp(+2 j k z)

Twice the same field, by reciprocity, over the echo of a scatterer in the focus and without the delay 2 z / c that a
plane wave would have: 1 at the focus, and smooth. Its phase turns along the beam: waves that converge travel obliquely,
so that a displacement along the axis delays the echo by a little less than 2 u / c. docs/explanation/transducer.md,
section 2.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from sim_backend.arrays import ComplexArray, FloatArray
from sim_backend.settings import SimulationSettings, Transducer
from sim_backend.transducer.hydrophone import Scan, read_scan, round_field
from sim_backend.transducer.intensity import diffraction_width_m
from sim_backend.transducer.radiation import bowl_pressure, wave_number

Mixture = tuple[tuple[float, ...], ...]
"""Shares of the frequencies in each table, where a table is not of one frequency."""

STEPS_A_WIDTH = 25
"""Steps of the table across over lambda F / D, of the highest frequency."""
STEPS_A_DEPTH = 60
"""Steps along over 7.1 lambda (F / D)^2; with cubic splines good to 1e-5 of the focus' echo."""
LEAST_SENSED, MOST_SENSED = 0.8, 1.2
"""Bounds of the delay a displacement makes, over 2 u / c: beyond are the beam's dark rings alone."""
# Steps beyond what is wanted: a spline's mirror at the table's end spoils the first dozen, each a quarter as much.
_EDGE = 12


@dataclass(frozen=True, slots=True)
class PulseEchoBeam:
    """Tables of G around the focus, at a few frequencies or of mixtures of them."""

    frequency_hz: tuple[float, ...]
    lateral_step_m: float
    axial_step_m: float
    axial_reach_m: float
    coefficient: ComplexArray
    """Spline coefficients of G, (table, axial, lateral)."""
    sensed: FloatArray
    """Delay that a displacement makes over 2 u / c, at the middle frequency, (axial, lateral)."""

    def at(self, lateral_m: FloatArray, axial_m: FloatArray) -> tuple[ComplexArray, FloatArray]:
        """Return G (table, place) and what share of a displacement is sensed, (place,)."""
        from scipy.ndimage import map_coordinates

        place = np.stack([(axial_m + self.axial_reach_m) / self.axial_step_m, lateral_m / self.lateral_step_m])
        seen = [map_coordinates(each, place, order=3, prefilter=False, mode="mirror") for each in self.coefficient]
        return np.stack(seen), np.asarray(map_coordinates(self.sensed, place, order=1, mode="nearest"))


def pulse_echo_beam(
    settings: SimulationSettings,
    frequency_hz: tuple[float, ...],
    lateral_reach_m: float,
    axial_reach_m: float,
    mixture: Mixture | None = None,
    of_push: bool = False,
) -> PulseEchoBeam:
    """Return the transducer's beam at ``frequency_hz``, or in mixtures of it, to ``lateral_reach_m`` off its axis.

    In the medium of ``settings``, with its attenuation; or as it was measured, alike at all frequencies near that of
    the scan, that of the push where ``of_push``. Kept: a table for each transducer, medium and band.
    """
    scan = settings.beams.excitation_scan if of_push else settings.beams.tracking_scan
    return _kept(
        settings.beams.transducer,
        read_scan(scan) if scan is not None and settings.beams.field == "measured" else None,
        settings.sound_speed_m_per_s,
        settings.echo_attenuation_db_per_cm_mhz,
        frequency_hz,
        # To two digits up, so that places drawn at random share a table.
        _rounded_up(lateral_reach_m),
        _rounded_up(axial_reach_m),
        mixture,
    )


def _rounded_up(value: float) -> float:
    unit = 10.0 ** (math.floor(math.log10(max(value, 1e-5))) - 1)
    return math.ceil(value / unit) * unit


@lru_cache(maxsize=8)
def _kept(
    transducer: Transducer,
    scan: Scan | None,
    sound_speed_m_per_s: float,
    attenuation_db_per_cm_mhz: float,
    frequency_hz: tuple[float, ...],
    lateral_reach_m: float,
    axial_reach_m: float,
    mixture: Mixture | None,
) -> PulseEchoBeam:
    from scipy.ndimage import spline_filter

    width_m = diffraction_width_m(transducer, max(frequency_hz), sound_speed_m_per_s)
    f_number = transducer.focal_length_m / transducer.diameter_m
    lateral_step_m, axial_step_m = width_m / STEPS_A_WIDTH, 7.1 * width_m * f_number / STEPS_A_DEPTH
    across = np.asarray(np.arange(math.ceil(lateral_reach_m / lateral_step_m) + _EDGE) * lateral_step_m, np.float64)
    steps = math.ceil(axial_reach_m / axial_step_m) + _EDGE
    along = np.asarray(np.arange(-steps, steps + 1) * axial_step_m, np.float64)
    table = []
    for hz in frequency_hz:
        k = wave_number(hz, sound_speed_m_per_s, attenuation_db_per_cm_mhz)
        if scan is not None:
            table.append(np.square(round_field(scan, k.real, across, along)))
            continue
        pressure = bowl_pressure(transducer, k, across, along)
        table.append(np.square(pressure / pressure[steps, 0]) * np.exp(2j * k.real * along)[:, None])
    middle = len(table) // 2
    k = 2 * math.pi * frequency_hz[middle] / sound_speed_m_per_s
    turning = np.gradient(table[middle], axial_step_m, axis=0)
    size = np.maximum(np.square(np.abs(table[middle])), 1e-12)
    sensed = 1 - (turning * table[middle].conj()).imag / size / (2 * k)
    if mixture is not None:
        table = list(np.tensordot(np.array(mixture), np.stack(table), axes=1))
    return PulseEchoBeam(
        frequency_hz,
        lateral_step_m,
        axial_step_m,
        steps * axial_step_m,
        # The mirror at the axis is the beam's own symmetry.
        np.stack([spline_filter(each, order=3, output=np.complex128, mode="mirror") for each in table]),
        np.clip(sensed, LEAST_SENSED, MOST_SENSED),
    )
