"""Displacement from the phase of the gate's mean after demodulation with the carrier."""

import numpy as np

from hpe_rig.processing import EchoGate, EstimatorSpec, Motion


def demodulated(echoes: EchoGate) -> Motion:
    """Return the displacement of every pulse.

    z_k is one complex number for each pulse: u_k = -c arg(z_k / z_0) / (4 pi f). Pulses that are not valid get NaN.
    """
    volts = np.asarray(echoes.volts[...], np.float64)[..., echoes.gate]
    samples = np.arange(volts.shape[-1])
    mixer = np.hanning(samples.size) * np.exp(-2j * np.pi * echoes.carrier_hz / echoes.sample_rate_hz * samples)
    mixed = (volts @ mixer)[..., echoes.valid]
    if mixed.shape[-1] < 2 or not np.abs(mixed).any():
        raise ValueError("the gate has no echo or fewer than two valid pulses. Try: check gate and carrier")
    phase = np.unwrap(np.angle(mixed * mixed[..., :1].conj()))
    metres_per_radian = -echoes.sound_speed_m_per_s / (4 * np.pi * echoes.carrier_hz)
    displacement_m = np.full(volts.shape[:-1], np.nan)
    displacement_m[..., echoes.valid] = phase * metres_per_radian
    # The scatter of |z_k| is noise. Along the phasor it is as large as across it, where it becomes phase noise.
    scatter = np.var(np.abs(mixed), axis=-1, keepdims=True) / np.mean(np.abs(mixed) ** 2, axis=-1, keepdims=True)
    variance_m2 = np.where(echoes.valid, scatter * metres_per_radian**2, np.nan)
    step = np.abs(np.diff(phase, axis=-1)).max(axis=-1) / np.pi
    return Motion(echoes.pulse_time_s, displacement_m, variance_m2, echoes.valid, step)


# Properties for the prediction of noise: a Hann window over the gate, phase divided by the carrier.
DEMODULATED = EstimatorSpec("demodulated", demodulated, gate_window="hann", by_carrier=True)
