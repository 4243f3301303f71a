"""Radiation force at the focus: the square of the pressure, rectified and low-passed, eq. (17).

    drive voltage -> hybrid, amplifier, diodes, matching -> transducer at the carrier -> pressure^2 -> body force

A saturating hybrid or amplifier flattens the carrier: the fundamental grows less than the drive, and odd harmonics
appear, of which a 3 MHz toneburst's third falls on the 9 MHz of the tracking pulses. The diodes of the bridge behind it
take their threshold off every half wave: the force then grows faster than the drive's square, from an offset on.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from sim_backend.arrays import FloatArray, Int64Array
from sim_backend.settings import SimulationSettings, Specimen, Transmitter
from sim_backend.wiring import Bursts, to_ps

Share = Callable[[FloatArray, FloatArray], FloatArray]
"""Force over the reference's, of pressure over the reference's and the carrier in Hz, all (pulse,)."""

_PHASES, _PHASES_OF_DIODES = 64, 4096


@dataclass(frozen=True, slots=True)
class ForcePulses:
    """Rectangular pulses of body force at the focus; every array has shape (pulse,)."""

    onset_ps: Int64Array
    end_ps: Int64Array
    force_density_n_per_m3: FloatArray


def transmit_response(frequency_hz: FloatArray, resonance_hz: float, quality: float) -> FloatArray:
    """Return the transducer's pressure a volt at ``frequency_hz``, relative to its resonance: one damped mode.

    The single mode has no third harmonic; its quality is set from the one figure known (see `Specimen`).
    """
    ratio = frequency_hz / resonance_hz
    return np.asarray(1 / np.hypot(1.0, quality * (ratio - 1 / ratio)))


def radiation_force(
    tonebursts: Bursts,
    specimen: Specimen,
    travel_time_s: float,
    transmitter: Transmitter | None = None,
    share: Share | None = None,
) -> ForcePulses:
    """Return the force pulse of every toneburst: on while it passes the focus, proportional to its pressure squared.

    Where propagation is nonlinear, ``share`` takes the pressure to the force instead, see `force_share`.

    ``travel_time_s`` is z_F/c. The force of a burst is its mean over the carrier, so a burst cut short by the
    generator gives a shorter pulse of the same height. Without ``transmitter`` the amplifier is linear. Eq. (17).
    """
    pressure = relative_pressure(tonebursts.amplitude_vpp, specimen, transmitter)
    pressure *= transmit_response(tonebursts.carrier_hz, specimen.resonance_hz, specimen.resonance_quality)
    travel_ps = to_ps(travel_time_s)
    return ForcePulses(
        tonebursts.onset_ps + travel_ps,
        tonebursts.end_ps + travel_ps,
        specimen.force_density_n_per_m3
        * (np.square(pressure) if share is None else share(pressure, tonebursts.carrier_hz)),
    )


def force_share(settings: SimulationSettings) -> Share | None:
    """Return what takes the pressure to the force, both relative to the reference's; None where it is a square.

    The push is computed when the first toneburst of a carrier comes, and kept for it.
    """
    specimen = settings.specimen
    if settings.propagation is None or specimen is None:
        return None

    def share(pressure: FloatArray, carrier_hz: FloatArray) -> FloatArray:
        from sim_backend.transducer import push_of

        found = np.zeros_like(pressure)
        for each_hz in np.unique(carrier_hz):
            push, own = push_of(settings, float(each_hz)), carrier_hz == each_hz
            if push is not None:
                found[own] = push.share(pressure[own], specimen.force_density_n_per_m3)
        return found

    return share


def relative_pressure(drive_vpp: FloatArray, specimen: Specimen, transmitter: Transmitter | None = None) -> FloatArray:
    """Return the pressure at resonance relative to that of the reference drive, shape of ``drive_vpp``."""
    relative = drive_vpp / specimen.reference_drive_vpp
    if transmitter is None or transmitter.linear:
        return relative
    reference_v = harmonic_v(np.array([specimen.reference_drive_vpp]), transmitter)
    return np.asarray(harmonic_v(drive_vpp, transmitter) / reference_v)


def harmonic_v(drive_vpp: FloatArray, transmitter: Transmitter, harmonic: int = 1) -> FloatArray:
    """Return the amplitude of a harmonic of the carrier at the transducer, V, shape of ``drive_vpp``.

    ``drive_vpp`` at the hybrid's input, from one generator alone. Negative where the harmonic is in counterphase.
    """
    amplifier_v = np.asarray(drive_vpp / 2 * transmitter.amplifier_gain)
    if transmitter.linear:
        out_v = amplifier_v if harmonic == 1 else np.zeros_like(amplifier_v)
    else:
        out_v = _distorted_v(amplifier_v, transmitter, harmonic)
    return np.asarray(out_v * 10 ** (transmitter.matching_gain_db / 20))


def _distorted_v(amplitude_v: FloatArray, transmitter: Transmitter, harmonic: int) -> FloatArray:
    """Return the Fourier sine coefficient of a sine through the hybrid's and the amplifier's ceiling, and diodes.

    v / (1 + |v / ceiling|^2p)^(1/2p), the Rapp law, then less by the threshold of the diodes, and nothing below it.
    """
    # The midpoint rule over a half period: the sine's other half has the same odd harmonics. It errs by 1 / phases^2
    # where the diodes open, and by far less without them.
    phases = _PHASES if transmitter.diode_threshold_v == 0 else _PHASES_OF_DIODES
    phase = (np.arange(phases) + 0.5) * np.pi / phases
    wave_v = amplitude_v[..., None] * np.sin(phase)
    sharpness = 2 * transmitter.saturation_sharpness
    core_v = transmitter.hybrid_saturation_v
    for ceiling_v in (None if core_v is None else core_v * transmitter.amplifier_gain, transmitter.saturation_v):
        if ceiling_v is not None:
            wave_v = wave_v / (1 + np.abs(wave_v / ceiling_v) ** sharpness) ** (1 / sharpness)
    passed_v = np.maximum(wave_v - transmitter.diode_threshold_v, 0.0) if transmitter.diode_threshold_v else wave_v
    return np.asarray(passed_v @ np.sin(harmonic * phase) * (2 / phases))
