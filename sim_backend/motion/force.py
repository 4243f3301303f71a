"""Radiation force at the focus: the square of the pressure, rectified and low-passed, eq. (17) of the paper.

    drive voltage -> hybrid, amplifier, diodes, matching -> transducer at the carrier -> pressure² -> body force

    F / F_ref = (p / p_ref)²

A saturating hybrid or amplifier flattens the carrier. The fundamental then grows less than the drive, and odd harmonics
appear; the third of a 3 MHz toneburst is at the 9 MHz of the tracking pulses. The diodes of the bridge subtract their
threshold from every half wave, so the force grows faster than the square of the drive and starts at an offset.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from sim_backend.arrays import FloatArray, Int64Array
from sim_backend.settings import SimulationSettings, Specimen, Transmitter
from sim_backend.wiring import PS_PER_S, Bursts, to_ps

ForceScale = Callable[[FloatArray, FloatArray], FloatArray]
"""Force over the reference force, from pressure over the reference pressure and carrier in Hz, all (pulse,)."""

# Points in a half period of the carrier. The diodes cause kinks, and the midpoint rule then errs by 1 / points².
_PHASES, _PHASES_WITH_DIODES = 64, 4096


@dataclass(frozen=True, slots=True)
class ForcePulses:
    """Rectangular pulses of body force at the focus; every array has shape (pulse,)."""

    onset_ps: Int64Array
    end_ps: Int64Array
    force_density_n_per_m3: FloatArray


def transmit_response(frequency_hz: FloatArray, resonance_hz: float, quality: float) -> FloatArray:
    """Return the transducer's pressure per volt at ``frequency_hz``, relative to its resonance: one damped mode.

    The single mode has no third harmonic. Its quality factor follows from the one published figure (see `Specimen`).
    """
    ratio = frequency_hz / resonance_hz
    return np.asarray(1 / np.hypot(1.0, quality * (ratio - 1 / ratio)))


def radiation_force(
    tonebursts: Bursts,
    specimen: Specimen,
    travel_time_s: float,
    transmitter: Transmitter | None = None,
    force_scale: ForceScale | None = None,
) -> ForcePulses:
    """Return the pulses of body force at the focus, one while each toneburst passes it, eq. (17) of the paper.

    ``travel_time_s`` is z_F/c. The force is the mean over the carrier, so a burst that the generator cuts short gives a
    shorter pulse of the same height. Without ``transmitter`` the amplifier is linear. With nonlinear propagation
    ``force_scale``, a function of relative pressure and carrier, replaces the square of the pressure. A
    specimen that changes is simulated by its force: later pulses are stronger (``growth_per_s``) and delayed
    (``delay_growth_s_per_s``).
    """
    pressure = relative_pressure(tonebursts.amplitude_vpp, specimen, transmitter)
    pressure *= transmit_response(tonebursts.carrier_hz, specimen.resonance_hz, specimen.resonance_quality)
    relative_force = np.square(pressure) if force_scale is None else force_scale(pressure, tonebursts.carrier_hz)
    delay_ps = np.full(tonebursts.onset_ps.shape, to_ps(travel_time_s))
    if tonebursts.onset_ps.size and (specimen.growth_per_s or specimen.delay_growth_s_per_s):
        elapsed_ps = tonebursts.onset_ps - tonebursts.onset_ps[0]
        relative_force = relative_force * (1 + specimen.growth_per_s * elapsed_ps / PS_PER_S)
        delay_ps += np.rint(specimen.delay_growth_s_per_s * elapsed_ps).astype(np.int64)
    return ForcePulses(
        tonebursts.onset_ps + delay_ps,
        tonebursts.end_ps + delay_ps,
        specimen.force_density_n_per_m3 * relative_force,
    )


def force_scale(settings: SimulationSettings) -> ForceScale | None:
    """Return the function from pressure to force, both over their reference values, for nonlinear propagation.

    None for linear propagation, where the force is the square of the pressure.
    """
    specimen = settings.specimen
    if settings.propagation is None or specimen is None:
        return None

    def relative_force(pressure_ratio: FloatArray, carrier_hz: FloatArray) -> FloatArray:
        """Return the force over ``specimen.force_density_n_per_m3``, (burst,), of bursts with nonlinear propagation.

        ``pressure_ratio`` (burst,): pressure at the transducer over the one that gives this force density.
        """
        from sim_backend.transducer import push_of

        force = np.zeros_like(pressure_ratio)
        # The beam is computed once for each carrier, and then cached.
        for hz in np.unique(carrier_hz):
            push, selected = push_of(settings, float(hz)), carrier_hz == hz
            if push is not None:
                force[selected] = push.relative_force(pressure_ratio[selected], specimen.force_density_n_per_m3)
        return force

    return relative_force


def relative_pressure(drive_vpp: FloatArray, specimen: Specimen, transmitter: Transmitter | None = None) -> FloatArray:
    """Return the pressure at resonance over that of the reference drive, in the shape of ``drive_vpp``.

    Without ``transmitter`` the amplifier is linear.
    """
    relative = drive_vpp / specimen.reference_drive_vpp
    if transmitter is None or transmitter.linear:
        return relative
    reference_v = harmonic_v(np.array([specimen.reference_drive_vpp]), transmitter)
    return np.asarray(harmonic_v(drive_vpp, transmitter) / reference_v)


def harmonic_v(drive_vpp: FloatArray, transmitter: Transmitter, harmonic: int = 1) -> FloatArray:
    """Return the amplitude of a harmonic of the carrier at the transducer, V, shape of ``drive_vpp``.

    ``drive_vpp`` is at the hybrid's input, from one generator. A negative amplitude is in counterphase.
    """
    amplifier_v = np.asarray(drive_vpp / 2 * transmitter.amplifier_gain)
    if transmitter.linear:
        out_v = amplifier_v if harmonic == 1 else np.zeros_like(amplifier_v)
    else:
        out_v = _distorted_v(amplifier_v, transmitter, harmonic)
    return np.asarray(out_v * 10 ** (transmitter.matching_gain_db / 20))


def _distorted_v(amplitude_v: FloatArray, transmitter: Transmitter, harmonic: int) -> FloatArray:
    """Return the amplitude of a harmonic of a sine after hybrid, amplifier and diodes, V, shape of ``amplitude_v``.

    ``amplitude_v``: at the amplifier's output if nothing saturated. ``harmonic`` is odd: the distortion is the same for
    both signs, so there are no even ones. Hybrid and amplifier saturate by the Rapp law v / (1 + |v / ceiling|^2p)^(1 /
    2p). The diodes subtract their threshold. The amplitude is a Fourier sine coefficient.
    """
    # The midpoint rule over the positive half period; the negative half is its mirror image and contributes as much.
    phases = _PHASES if transmitter.diode_threshold_v == 0 else _PHASES_WITH_DIODES
    phase = (np.arange(phases) + 0.5) * np.pi / phases
    wave_v = amplitude_v[..., None] * np.sin(phase)
    sharpness = 2 * transmitter.saturation_sharpness
    # The hybrid comes before the amplifier: its ceiling, amplified, acts first.
    hybrid_v = transmitter.hybrid_saturation_v
    for ceiling_v in (None if hybrid_v is None else hybrid_v * transmitter.amplifier_gain, transmitter.saturation_v):
        if ceiling_v is not None:
            wave_v = wave_v / (1 + np.abs(wave_v / ceiling_v) ** sharpness) ** (1 / sharpness)
    if transmitter.diode_threshold_v:
        wave_v = np.maximum(wave_v - transmitter.diode_threshold_v, 0.0)
    return np.asarray(wave_v @ np.sin(harmonic * phase) * (2 / phases))
