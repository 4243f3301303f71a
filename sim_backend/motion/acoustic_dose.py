"""Acoustic output of a train of tonebursts relative to its limits, and the force and displacement at the limit.

    F = 2 a I / c        body force

    a    attenuation, Np/m
    I    intensity, W/m²
    c    sound speed, m/s

Limits of FDA track 3, derated at the focus: I_SPTA <= 720 mW/cm² and I_SPPA <= 190 W/cm². The mechanical index of 1.9
may replace the latter. For a linear wave at 3 MHz it allows 351 W/cm², which matters only below a duty cycle of 0.4 %.
See docs/explanation/medium.md, section 7.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim_backend.arrays import FloatArray
from sim_backend.motion.field import Force, focus_transfer
from sim_backend.settings import Specimen

SPTA_LIMIT_W_PER_M2 = 7200.0
SPPA_LIMIT_W_PER_M2 = 1.9e6
_DB_PER_NEPER = 8.685889638065036


@dataclass(frozen=True, slots=True)
class Dose:
    """Acoustic output of a train of tonebursts."""

    intensity_w_per_m2: float
    """Intensity at the focus during a toneburst of the reference drive."""
    limit_w_per_m2: float
    """Highest pulse-average intensity within both limits for this train."""
    force_limit_n_per_m3: float
    """Body force at that intensity."""
    reference_drive_vpp: float
    """Drive that causes the specimen's reference force."""
    displacement_limit_m: FloatArray
    """Displacement amplitude at the focus at that intensity, (frequency,)."""


def dose(
    specimen: Specimen,
    force: Force,
    burst_rate_hz: float,
    burst_length_s: float,
    frequency_hz: FloatArray,
    sound_speed_m_per_s: float,
    carrier_hz: float = 3.0e6,
) -> Dose:
    """Return the intensity of a train of tonebursts, and the motion at the regulatory limits of intensity.

    ``frequency_hz`` (frequency,): multiples of the burst rate, for the motion at the focus. ``force``: shape of the
    push.
    """
    attenuation_np_per_m = specimen.attenuation_db_per_cm_mhz * 100 / _DB_PER_NEPER * carrier_hz * 1e-6
    duty = burst_rate_hz * burst_length_s
    limit = min(SPPA_LIMIT_W_PER_M2, SPTA_LIMIT_W_PER_M2 / duty)
    # Radiation force density 2 alpha I / c.
    force_limit = 2 * attenuation_np_per_m * limit / sound_speed_m_per_s
    # Amplitude of a harmonic of the rectangular train, eq. (18) of the paper, times the response of the medium.
    relative_force = 2 * duty * np.abs(np.sinc(frequency_hz * burst_length_s))
    response = np.abs(focus_transfer(specimen, force, frequency_hz))
    intensity = specimen.force_density_n_per_m3 * sound_speed_m_per_s / (2 * attenuation_np_per_m)
    displacement_m = np.asarray(force_limit * relative_force * response)
    return Dose(
        intensity_w_per_m2=intensity,
        limit_w_per_m2=limit,
        force_limit_n_per_m3=force_limit,
        reference_drive_vpp=specimen.reference_drive_vpp,
        displacement_limit_m=displacement_m,
    )
