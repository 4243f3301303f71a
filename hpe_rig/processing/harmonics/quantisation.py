"""Quantisation: what rounding to the digitizer's codes leaves in amplitudes and phases that noise does not dither away.

Rounding in steps of q takes a voltage v to v + e(v), e a sawtooth of period q. With noise of standard deviation sigma
added before, what is left of it on the mean is

    e(v) = sum_n (-1)^n q / (pi n) sin(2 pi n v / q) D_n,   D_n = exp(-2 (pi n sigma / q)^2).

A sample rests anywhere between two codes and moves by s u, s = dv / du its slope and u the displacement: the same error
comes back whenever the motion does, so that no number of pulses averages it. A displacement is the samples' mean,
weighted by their slopes; samples err independently. Where the motion crosses many codes the error is as good as white:
that part the fit's residual has already, and it is no part of this.

How large sigma is, the echoes' scatter about their mean tells. Rounding has q^2 / 12 in all, of which the mean echo
holds what does not change with the motion, so that the scatter is

    sigma^2 + q^2 / 12 - sum_n (q / pi n)^2 / 2 D_n^2 |mean over pulses of exp(2 pi j n s u / q)|^2.

Source: Widrow and Kollar, Quantization Noise (2008), chapters 4
and 5.
"""

from __future__ import annotations

import numpy as np

from hpe_rig.arrays import FloatArray
from hpe_rig.processing.echo.echoes import EchoGate, Motion
from hpe_rig.processing.harmonics.harmonic_fit import HarmonicFit
from hpe_rig.processing.harmonics.model import background_columns, harmonic_columns

LEAST_DITHER = 0.6
"""Noise of a sample, in codes, from which on less than a thousandth of the first harmonic is left."""
HARMONICS = 8
"""Of the sawtooth; without noise those above have 7 % of its power, in noise of a tenth of a code none."""
BISECTIONS = 30
"""Halvings of the noise's range: to 1e-9 of it."""
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
    scatter_v2 = float(np.mean(motion.variance_m2[used])) * slope_energy
    if not code_v > 0 or scatter_v2 - code_v**2 / 12 > (LEAST_DITHER * code_v) ** 2:
        return ()
    slope = _slopes(echoes)
    turn = 2 * np.pi / code_v * np.outer(slope, motion.displacement_m[used])
    rows, basis = _rows(motion, fit)
    waves = [np.exp(1j * n * turn) for n in range(1, HARMONICS + 1)]
    resting = np.array([np.mean(np.abs(wave.mean(axis=1)) ** 2) for wave in waves])
    left_v2 = _left_v2(code_v, _noise_v2(scatter_v2, code_v, resting))
    white, (pulses, states) = np.sum(rows**2, axis=1), basis.shape
    for wave, each_v2 in zip(waves, left_v2, strict=True):
        # what the fit leaves of it is in the residual, and so in the fit's noise: it counts once
        seen = (pulses - np.sum(np.abs(wave @ basis) ** 2, axis=1)) / max(pulses - states, 1)
        beyond = np.abs(wave @ rows.T) ** 2 - seen[:, None] * white
        # over all voltages at which a sample may rest
        found += (slope**2 @ (each_v2 * beyond)).reshape(found.shape)
    samples = echoes.gate_samples / slope.size
    along, across = (np.sqrt(np.maximum(found, 0.0) / samples) / np.sum(slope**2)).T.tolist()
    return tuple(zip(along, across, strict=True))


def _left_v2(code_v: float, noise_v2: float) -> FloatArray:
    """Return the mean squares (harmonic,) of the sawtooth's harmonics that noise leaves."""
    return np.array([sawtooth_v(n, code_v, noise_v2) ** 2 / 2 for n in range(1, HARMONICS + 1)])


def _noise_v2(scatter_v2: float, code_v: float, resting: FloatArray) -> float:
    """Return the noise of a sample before rounding, by bisection; ``resting`` (harmonic,): shares in the mean echo."""
    low, high = 0.0, scatter_v2
    for _ in range(BISECTIONS):
        middle = (low + high) / 2
        seen_v2 = middle + code_v**2 / 12 - float(resting @ _left_v2(code_v, middle))
        low, high = (middle, high) if seen_v2 < scatter_v2 else (low, middle)
    return low


def sawtooth_v(harmonic: int, code_v: float, noise_v2: float) -> float:
    """Return the amplitude of a ``harmonic`` (1, 2, ...) of the mean rounding error over volts, V.

    Noise of variance ``noise_v2`` smooths the sawtooth of ``code_v``: its characteristic function.
    """
    return float(code_v / (np.pi * harmonic) * np.exp(-2 * (np.pi * harmonic / code_v) ** 2 * noise_v2))


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


def _rows(motion: Motion, fit: HarmonicFit) -> tuple[FloatArray, FloatArray]:
    """Return the rows (2 * frequency, pulse) that give the parts along and across each phasor from a displacement.

    And an orthonormal basis (pulse, state) of what is fitted.
    """
    used, count = motion.valid, 2 * fit.frequency_hz.size
    columns = [harmonic_columns(motion.time_s, fit.frequency_hz), background_columns(motion.time_s, 0)]
    basis, triangle = np.linalg.qr(np.hstack(columns)[used])
    states = np.linalg.pinv(triangle)[:count] @ basis.T
    states = states.reshape(-1, 2, int(used.sum()))
    cos, sin = np.cos(fit.phase_rad)[:, None], np.sin(fit.phase_rad)[:, None]
    along = cos * states[:, 0] + sin * states[:, 1]
    across = cos * states[:, 1] - sin * states[:, 0]
    return np.stack([along, across], axis=1).reshape(count, -1), basis
