"""Dose of a train of tonebursts against the acoustic output limits, and the force and displacement that they allow.

Body force 2 a I / c of an intensity I in a medium that attenuates a (Np/m). FDA track 3, derated at the focus:
I_SPTA <= 720 mW/cm^2 and I_SPPA <= 190 W/cm^2. The mechanical index of 1.9 that may stand in for the latter would
allow 351 W/cm^2 of a linear wave at 3 MHz; it matters below a duty of 0.4 % alone. docs/theory/medium.md, section 7.
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
    """A train of tonebursts against the limits."""

    intensity_w_per_m2: float
    """Intensity at the focus while the reference drive's toneburst is on."""
    limit_w_per_m2: float
    """The highest pulse-average intensity that both limits allow for this train."""
    force_limit_n_per_m3: float
    """Body force at that intensity."""
    reference_drive_vpp: float
    """The drive that gives the specimen its force."""
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
    """Return the dose of a train and what could move at ``frequency_hz`` (frequency,), multiples of the burst rate.

    ``force`` is the shape of the push.
    """
    attenuation = specimen.attenuation_db_per_cm_mhz * 100 / _DB_PER_NEPER * carrier_hz * 1e-6
    duty = burst_rate_hz * burst_length_s
    limit = min(SPPA_LIMIT_W_PER_M2, SPTA_LIMIT_W_PER_M2 / duty)
    force_limit = 2 * attenuation * limit / sound_speed_m_per_s
    # Peak of a harmonic of the rectangular train, eq. (18).
    share = 2 * duty * np.abs(np.sinc(frequency_hz * burst_length_s))
    moved = np.abs(focus_transfer(specimen, force, frequency_hz))
    intensity = specimen.force_density_n_per_m3 * sound_speed_m_per_s / (2 * attenuation)
    displacement_m = np.asarray(force_limit * share * moved)
    return Dose(intensity, limit, force_limit, specimen.reference_drive_vpp, displacement_m)
