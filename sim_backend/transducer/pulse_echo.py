"""Pulse-echo beam of a transducer: relative echo of a scatterer at each point and frequency.

    G(r, z, f) = (P(r, z, f) / P(0, 0, f))^2 exp(+2 j k z)

    G       echo relative to that of a scatterer at the focus, without the delay 2 z / c of a plane wave
    P       pressure of the transducer, squared by reciprocity
    r, z    distance from the axis and from the focal plane, m
    f, k    frequency, Hz; wave number, 1/m

G is 1 at the focus, and smooth. Its phase changes along the beam: converging waves travel obliquely, so a displacement
u along the axis delays the echo by slightly less than 2 u / c. See docs/explanation/transducer.md, section 2.
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
"""Weights (table, frequency), for tables that are weighted sums over frequencies."""

STEPS_PER_WIDTH = 25
"""Lateral steps of the table per lambda F / D, at the highest frequency."""
STEPS_PER_DEPTH = 60
"""Axial steps per 7.1 lambda (F / D)²; with cubic splines exact to 1e-5 of the echo of the focus."""
MIN_DELAY_RATIO, MAX_DELAY_RATIO = 0.8, 1.2
"""Bounds of the delay caused by a displacement, over 2 u / c; only the dark rings of the beam exceed them."""
# Additional steps at the ends: the mirror condition of the spline falsifies the last dozen, by a quarter each.
_MARGIN_STEPS = 12


@dataclass(frozen=True, slots=True)
class PulseEchoBeam:
    """Tables of G around the focus, at a few frequencies or as weighted sums of them."""

    lateral_step_m: float
    axial_step_m: float
    axial_reach_m: float
    coefficient: ComplexArray
    """Spline coefficients of G, (table, axial, lateral)."""
    delay_ratio: FloatArray
    """Delay caused by a displacement, over 2 u / c, at the middle frequency, (axial, lateral)."""

    def at(self, lateral_m: FloatArray, axial_m: FloatArray) -> tuple[ComplexArray, FloatArray]:
        """Return the echo of a scatterer at each point, (table, point), and its delay ratio, (point,).

        ``lateral_m``, ``axial_m`` (point,): distance from the axis and from the focal plane. The echo is relative to
        that of a scatterer at the focus. The delay ratio is the delay caused by a displacement u, over 2 u / c.
        """
        from scipy.ndimage import map_coordinates

        index = np.stack([(axial_m + self.axial_reach_m) / self.axial_step_m, lateral_m / self.lateral_step_m])
        echo = [map_coordinates(table, index, order=3, prefilter=False, mode="mirror") for table in self.coefficient]
        return np.stack(echo), np.asarray(map_coordinates(self.delay_ratio, index, order=1, mode="nearest"))


def pulse_echo_beam(
    settings: SimulationSettings,
    frequency_hz: tuple[float, ...],
    lateral_reach_m: float,
    axial_reach_m: float,
    mixture: Mixture | None = None,
    of_push: bool = False,
) -> PulseEchoBeam:
    """Return the pulse-echo beam at ``frequency_hz``: the relative echo of a scatterer at any point around the focus.

    With ``mixture`` (table, frequency) it is weighted sums over the frequencies. The beam is computed in the
    attenuating medium of ``settings``, or measured by a scan and then equal at all frequencies. ``of_push`` selects the
    scan of the push. Tables are cached by transducer, medium and band.
    """
    scan = settings.beams.excitation_scan if of_push else settings.beams.tracking_scan
    return _tabulated_beam(
        settings.beams.transducer,
        read_scan(scan) if scan is not None and settings.beams.field == "measured" else None,
        settings.sound_speed_m_per_s,
        settings.echo_attenuation_db_per_cm_mhz,
        frequency_hz,
        # Rounded up to two digits, so that random scatterers share a table.
        _rounded_up(lateral_reach_m),
        _rounded_up(axial_reach_m),
        mixture,
    )


def _rounded_up(value: float) -> float:
    """Return ``value`` rounded up to two significant digits."""
    unit = 10.0 ** (math.floor(math.log10(max(value, 1e-5))) - 1)
    return math.ceil(value / unit) * unit


@lru_cache(maxsize=8)
def _tabulated_beam(
    transducer: Transducer,
    scan: Scan | None,
    sound_speed_m_per_s: float,
    attenuation_db_per_cm_mhz: float,
    frequency_hz: tuple[float, ...],
    lateral_reach_m: float,
    axial_reach_m: float,
    mixture: Mixture | None,
) -> PulseEchoBeam:
    """Return the pulse-echo beam tabulated over the given reach around the focus, as an array of tables.

    One table for each of ``frequency_hz``, or with ``mixture`` (table, frequency) sums with these weights. ``scan``: a
    measured beam instead of the computed one.
    """
    from scipy.ndimage import spline_filter

    # Steps are fractions of the beam's width and of the length of its focus.
    width_m = diffraction_width_m(transducer, max(frequency_hz), sound_speed_m_per_s)
    f_number = transducer.focal_length_m / transducer.diameter_m
    lateral_step_m, axial_step_m = width_m / STEPS_PER_WIDTH, 7.1 * width_m * f_number / STEPS_PER_DEPTH
    lateral_steps = math.ceil(lateral_reach_m / lateral_step_m) + _MARGIN_STEPS
    lateral_m = np.asarray(np.arange(lateral_steps) * lateral_step_m, np.float64)
    axial_steps = math.ceil(axial_reach_m / axial_step_m) + _MARGIN_STEPS
    axial_m = np.asarray(np.arange(-axial_steps, axial_steps + 1) * axial_step_m, np.float64)
    # Relative echo G at each frequency, (axial, lateral): pressure over that at the focus, squared by reciprocity,
    # without the phase of a plane wave.
    echo_tables = []
    for hz in frequency_hz:
        k = wave_number(hz, sound_speed_m_per_s, attenuation_db_per_cm_mhz)
        if scan is not None:
            echo_tables.append(np.square(round_field(scan, k.real, lateral_m, axial_m)))
            continue
        pressure = bowl_pressure(transducer, k, lateral_m, axial_m)
        echo_tables.append(np.square(pressure / pressure[axial_steps, 0]) * np.exp(2j * k.real * axial_m)[:, None])
    # A displacement u changes the phase of an echo by -2 k u plus u times the gradient of G's phase along the axis. The
    # delay is in proportion to the phase. Where G is nearly 0, its phase is undefined.
    middle = len(echo_tables) // 2
    echo, k = echo_tables[middle], 2 * math.pi * frequency_hz[middle] / sound_speed_m_per_s
    phase_gradient = (np.gradient(echo, axial_step_m, axis=0) * echo.conj()).imag / np.maximum(
        np.square(np.abs(echo)), 1e-12
    )
    delay_ratio = 1 - phase_gradient / (2 * k)
    if mixture is not None:
        echo_tables = list(np.tensordot(np.array(mixture), np.stack(echo_tables), axes=1))
    return PulseEchoBeam(
        lateral_step_m=lateral_step_m,
        axial_step_m=axial_step_m,
        axial_reach_m=axial_steps * axial_step_m,
        # The mirror condition at the axis is the symmetry of the beam.
        coefficient=np.stack([spline_filter(t, order=3, output=np.complex128, mode="mirror") for t in echo_tables]),
        delay_ratio=np.clip(delay_ratio, MIN_DELAY_RATIO, MAX_DELAY_RATIO),
    )
