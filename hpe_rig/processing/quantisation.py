"""Quantisation: what rounding to the digitizer's codes leaves in amplitudes and phases that noise does not dither away.

Rounding in steps of q takes a voltage v to v + e(v), e a sawtooth of period q. With noise of standard deviation sigma
added before, what is left of it on the mean is

    e(v) = sum_n (-1)^n q / (pi n) sin(2 pi n v / q) D_n,   D_n = exp(-2 (pi n sigma / q)^2).

A sample rests anywhere between two codes and moves by s u, s = dv / du its slope and u the displacement: the same error
comes back whenever the motion does, so that no number of pulses averages it. A displacement is the samples' mean,
weighted by their slopes; samples err independently. Source: Widrow and Kollar, Quantization Noise (2008), chapters 4
and 5.
"""

from __future__ import annotations

import numpy as np

from hpe_rig.processing.echoes import EchoGate, FloatArray, Motion
from hpe_rig.processing.harmonic import HarmonicFit
from hpe_rig.processing.model import background_columns, harmonic_columns

LEAST_DITHER = 0.6
"""Noise of a sample, in codes, from which on less than a thousandth of the first harmonic is left."""
HARMONICS = 8
"""Of the sawtooth; without noise those above have 7 % of its power, in noise of a tenth of a code none."""
SLOPES = 24
"""Slopes, in equal shares of the samples, for which the motion's error is found."""


def rounding_m(echoes: EchoGate, code_v: float, motion: Motion, fit: HarmonicFit) -> tuple[tuple[float, float], ...]:
    """Return the standard uncertainties (frequency, 2) that codes of ``code_v`` leave along and across each phasor, m.

    Of one train, ``motion`` that of its pulses, ``fit`` its harmonics. Nothing where noise dithers the codes.
    """
    found, used = np.zeros((fit.frequency_hz.size, 2)), motion.valid
    per_m = 4 * np.pi * echoes.carrier_hz / echoes.sound_speed_m_per_s
    slope_energy = per_m**2 * float(np.mean(echoes.energy[used]))
    # what the echoes state of their noise has that of rounding in it
    noise_v2 = float(np.mean(motion.variance_m2[used])) * slope_energy - code_v**2 / 12
    if not code_v > 0 or noise_v2 > (LEAST_DITHER * code_v) ** 2:
        return ()
    slope = _slopes(echoes)
    turn = 2 * np.pi / code_v * np.outer(slope, motion.displacement_m[used])
    rows = _rows(motion, fit)
    for n in range(1, HARMONICS + 1):
        left_v = code_v / (np.pi * n) * np.exp(-2 * np.pi**2 * n**2 * max(noise_v2, 0.0) / code_v**2)
        # over all voltages at which a sample may rest
        variance_v2 = left_v**2 / 2 * np.abs(np.exp(1j * n * turn) @ rows.T) ** 2
        found += (slope**2 @ variance_v2).reshape(found.shape)
    samples = echoes.gate_samples / slope.size
    along, across = (np.sqrt(found / samples) / np.sum(slope**2)).T.tolist()
    return tuple(zip(along, across, strict=True))


def _slopes(echoes: EchoGate) -> FloatArray:
    """Return slopes (slope,) that stand for those of the gate's samples, V/m, the smallest first."""
    blocks = ((echoes.valid[pulses], volts) for pulses, volts in echoes.blocks(echoes.gate))
    volts = next(some[valid][0] for valid, some in blocks if valid.any())
    spectrum = np.fft.rfft(volts) * 2j * np.pi * np.fft.rfftfreq(volts.size, 1 / echoes.sample_rate_hz)
    per_second = np.sort(np.abs(np.fft.irfft(spectrum, volts.size)))
    middle = (np.arange(SLOPES) + 0.5) / SLOPES
    return np.asarray(np.interp(middle * (volts.size - 1), np.arange(volts.size), per_second)) * (
        2 / echoes.sound_speed_m_per_s
    )


def _rows(motion: Motion, fit: HarmonicFit) -> FloatArray:
    """Return the rows (2 * frequency, pulse) that give the parts along and across each phasor from a displacement."""
    used, count = motion.valid, 2 * fit.frequency_hz.size
    columns = [harmonic_columns(motion.time_s, fit.frequency_hz), background_columns(motion.time_s, 0)]
    states = np.linalg.pinv(np.hstack(columns)[used])[:count].reshape(-1, 2, int(used.sum()))
    cos, sin = np.cos(fit.phase_rad)[:, None], np.sin(fit.phase_rad)[:, None]
    along = cos * states[:, 0] + sin * states[:, 1]
    across = cos * states[:, 1] - sin * states[:, 0]
    return np.stack([along, across], axis=1).reshape(count, -1)
