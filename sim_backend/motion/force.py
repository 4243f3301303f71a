"""Radiation force at the focus: the square of the pressure, rectified and low-passed, eq. (17).

drive voltage -> hybrid, amplifier, matching -> transducer at the carrier -> pressure^2 -> body force
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim_backend.settings import Specimen, Transmitter
from sim_backend.wiring import Bursts, Picoseconds, to_ps

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class ForcePulses:
    """Rectangular pulses of body force at the focus; every array has shape (pulse,)."""

    onset_ps: Picoseconds
    end_ps: Picoseconds
    force_density_n_per_m3: Floats


def transmit_response(frequency_hz: Floats, resonance_hz: float, quality: float) -> Floats:
    """Return the transducer's pressure a volt at ``frequency_hz``, relative to its resonance: one damped mode.

    The single mode has no third harmonic; its quality is set from the one figure known (see `Specimen`).
    """
    ratio = frequency_hz / resonance_hz
    return np.asarray(1 / np.hypot(1.0, quality * (ratio - 1 / ratio)))


def radiation_force(
    tonebursts: Bursts, specimen: Specimen, travel_time_s: float, transmitter: Transmitter | None = None
) -> ForcePulses:
    """Return the force pulse of every toneburst: on while it passes the focus, proportional to its pressure squared.

    ``travel_time_s`` is z_F/c. The force of a burst is its mean over the carrier, so a burst cut short by the
    generator gives a shorter pulse of the same height. Without ``transmitter`` the amplifier is linear. Eq. (17).
    """
    pressure = relative_pressure(tonebursts.amplitude_vpp, specimen, transmitter)
    pressure *= transmit_response(tonebursts.carrier_hz, specimen.resonance_hz, specimen.resonance_quality)
    travel_ps = to_ps(travel_time_s)
    return ForcePulses(
        tonebursts.onset_ps + travel_ps,
        tonebursts.end_ps + travel_ps,
        specimen.force_density_n_per_m3 * np.square(pressure),
    )


def relative_pressure(drive_vpp: Floats, specimen: Specimen, transmitter: Transmitter | None = None) -> Floats:
    """Return the pressure at resonance relative to that of the reference drive, shape of ``drive_vpp``."""
    relative = drive_vpp / specimen.reference_drive_vpp
    if transmitter is None or transmitter.saturation_v is None:
        return relative
    from sim_backend.motion.transmitter import harmonic_v

    reference_v = harmonic_v(np.array([specimen.reference_drive_vpp]), transmitter)
    return np.asarray(harmonic_v(drive_vpp, transmitter) / reference_v)
