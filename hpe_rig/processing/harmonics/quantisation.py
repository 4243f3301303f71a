"""Quantisation error of amplitudes and phases: rounding to the digitizer's codes that noise does not dither.

Rounding in steps of q takes a voltage v to v + e(v), e a sawtooth of period q. Noise of standard deviation sigma before
rounding smooths it to the mean

    e(v) = sum_n (-1)^n q / (pi n) sin(2 pi n v / q) D_n,    D_n = exp(-2 (pi n sigma / q)²)

A sample lies anywhere between two codes and moves by s u: s = dv/du its slope, u the displacement. The same error
returns whenever the motion does, so no number of pulses averages it. A displacement is the mean of the samples weighted
by their slopes; the errors of samples are independent. Where the motion crosses many codes the error is nearly white:
that part is in the residual of the fit already and is not counted here.

A displacement u takes the samples through sum |s| u / q codes. Identical echoes therefore do not exclude a motion: a
sine of amplitude A sweeps 2 A and changes no code with probability exp(-2 A sum |s| / q). If all amplitudes are equally
likely before, the root mean square of A is q / (sqrt(2) sum |s|), and the phase is unknown.

sigma follows from the scatter of the echoes about their mean. Rounding contributes q²/12 minus the part in the mean
echo, which does not change with the motion:

    scatter = sigma² + q²/12 - sum_n (q / pi n)² / 2 D_n² |mean over pulses of exp(2 pi j n s u / q)|²

Source: Widrow and Kollar, Quantization Noise (2008), chapters 4 and 5.
"""

from __future__ import annotations

import math

import numpy as np

from hpe_rig.arrays import FloatArray
from hpe_rig.processing.echo.gate import EchoGate
from hpe_rig.processing.harmonics.harmonic_fit import HarmonicFit
from hpe_rig.processing.harmonics.model import background_columns, harmonic_columns
from hpe_rig.processing.motion.displacement import Motion

DITHER_CODES = 0.6
"""Noise of a sample, in codes, that leaves less than a thousandth of the sawtooth's first harmonic."""
HARMONICS = 8
"""Harmonics of the sawtooth: without noise the higher ones have 7 % of its power, with noise of 0.1 codes none."""
BISECTIONS = 30
"""Bisections of the noise: to 1e-9 of its range."""
PHASE_RESOLUTION_RAD = float(np.finfo(np.float32).eps)
"""Phase below which a motion is not resolved: volts are numbers of single precision."""
SLOPES = 24
"""Number of slopes, quantiles of the samples' slopes, for which the error is computed."""


def quantisation_m(
    echoes: EchoGate, code_v: float, motion: Motion, fit: HarmonicFit
) -> tuple[tuple[float, float], ...]:
    """Return the standard uncertainty of each harmonic from rounding to the digitizer's codes, m (frequency, 2).

    The two values are along and across its phasor. ``code_v``: volts of one code. ``motion``: displacement of one
    train, ``fit``: its harmonics. If the echoes are identical, both are that of a motion which changes no code. Empty
    if noise dithers the codes, so that the residual of the fit contains the error.
    """
    used = motion.valid
    radians_per_m = 4 * np.pi * echoes.carrier_hz / echoes.sound_speed_m_per_s
    # Variance of the voltage about its mean, from the displacement noise and the energy of dv/du. It includes that of
    # rounding, code_v² / 12 if it is random.
    slope_energy = radians_per_m**2 * float(np.mean(echoes.energy[used]))
    scatter_v2 = float(np.mean(motion.variance_m2[used])) * slope_energy
    if not code_v > 0 or scatter_v2 - code_v**2 / 12 > (DITHER_CODES * code_v) ** 2:
        return ()
    # Quantiles of the samples' slopes dv/du, and number of samples that each of them stands for.
    slope = _slopes(echoes)
    samples = echoes.gate_samples / slope.size
    # Largest motion that may change no code, or that is below the resolution of the volts.
    hidden_m = max(code_v / (samples * float(np.sum(slope))), PHASE_RESOLUTION_RAD / radians_per_m)
    if np.ptp(motion.displacement_m[used]) < hidden_m:
        return ((hidden_m / math.sqrt(2),) * 2,) * fit.frequency_hz.size
    # The mean rounding error is a sawtooth of the voltage. Waves: its harmonics n, (slope, pulse), of amplitude 1.
    angle = 2 * np.pi / code_v * np.outer(slope, motion.displacement_m[used])
    waves = [np.exp(1j * n * angle) for n in range(1, HARMONICS + 1)]
    constant_fraction = np.array([np.mean(np.abs(wave.mean(axis=1)) ** 2) for wave in waves])
    harmonics_v2 = _harmonics_v2(code_v, _noise_v2(scatter_v2, code_v, constant_fraction))
    # Each wave's error of the fitted values, (slope, value), beyond that of white noise as strong as its residual.
    weights, basis = _phasor_weights(motion, fit)
    white, (pulses, states) = np.sum(weights**2, axis=1), basis.shape
    variance = np.zeros((fit.frequency_hz.size, 2))
    for wave, harmonic_v2 in zip(waves, harmonics_v2, strict=True):
        in_residual = (pulses - np.sum(np.abs(wave @ basis) ** 2, axis=1)) / max(pulses - states, 1)
        beyond_noise = np.abs(wave @ weights.T) ** 2 - in_residual[:, None] * white
        # harmonic_v2 is the mean over all voltages that a sample may have.
        variance += (slope**2 @ (harmonic_v2 * beyond_noise)).reshape(variance.shape)
    along, across = (np.sqrt(np.maximum(variance, 0.0) / samples) / np.sum(slope**2)).T.tolist()
    return tuple(zip(along, across, strict=True))


def _harmonics_v2(code_v: float, noise_v2: float) -> FloatArray:
    """Return the mean squares (harmonic,) of the harmonics of the smoothed sawtooth."""
    return np.array([sawtooth_v(n, code_v, noise_v2) ** 2 / 2 for n in range(1, HARMONICS + 1)])


def _noise_v2(scatter_v2: float, code_v: float, constant_fraction: FloatArray) -> float:
    """Return sigma², the noise variance of a sample before rounding, V², from the scatter after rounding, by bisection.

    ``scatter_v2``: variance of the echoes about their mean. The mean rounding error is a sawtooth of the voltage, with
    a period of one code, ``code_v``. ``constant_fraction`` (harmonic,): the fraction of each of its harmonics' power
    that does not change with the motion. That part is in the mean echo and not in the scatter.
    """
    low, high = 0.0, scatter_v2
    for _ in range(BISECTIONS):
        middle = (low + high) / 2
        # Scatter for this sigma²: noise, plus rounding (q² / 12), minus the constant part of each harmonic.
        predicted_v2 = middle + code_v**2 / 12 - float(constant_fraction @ _harmonics_v2(code_v, middle))
        low, high = (middle, high) if predicted_v2 < scatter_v2 else (low, middle)
    return low


def sawtooth_v(harmonic: int, code_v: float, noise_v2: float) -> float:
    """Return the amplitude q / (pi n) D_n of a ``harmonic`` n = 1, 2, ... of the mean rounding error, V."""
    return float(code_v / (np.pi * harmonic) * np.exp(-2 * (np.pi * harmonic / code_v) ** 2 * noise_v2))


def _slopes(echoes: EchoGate) -> FloatArray:
    """Return quantiles (slope,) of the slopes |dv/du| of the gate's samples, V/m, in rising order.

    v is the voltage of a sample, u the displacement. Only the first valid echo is used: all echoes of a train have
    nearly the same waveform, so their slopes have the same distribution.
    """
    blocks = ((echoes.valid[pulses], volts) for pulses, volts in echoes.blocks(echoes.gate))
    volts = next(block[valid][0] for valid, block in blocks if valid.any())
    # dv/dt: the spectrum times j omega.
    spectrum = np.fft.rfft(volts) * 2j * np.pi * np.fft.rfftfreq(volts.size, 1 / echoes.sample_rate_hz)
    per_second = np.sort(np.abs(np.fft.irfft(spectrum, volts.size)))
    quantile = (np.arange(SLOPES) + 0.5) / SLOPES
    # Quantiles by interpolation of the sorted slopes.
    slopes_per_second = np.interp(quantile * (volts.size - 1), np.arange(volts.size), per_second)
    # A displacement u delays the echo by 2 u / c.
    return np.asarray(slopes_per_second * (2 / echoes.sound_speed_m_per_s))


def _phasor_weights(motion: Motion, fit: HarmonicFit) -> tuple[FloatArray, FloatArray]:
    """Return the weights (2 * frequency, pulse) of each pulse's displacement in the fitted harmonics.

    Times the errors of the pulses they are the errors of each harmonic, along and across its phasor. The second value
    is an orthonormal basis (pulse, state) of the fitted columns.
    """
    used, count = motion.valid, 2 * fit.frequency_hz.size
    columns = [harmonic_columns(motion.time_s, fit.frequency_hz), background_columns(motion.time_s, 0)]
    # Weights of the pulses in the states: the pseudoinverse of the fitted columns, by QR.
    basis, triangle = np.linalg.qr(np.hstack(columns)[used])
    states = np.linalg.pinv(triangle)[:count] @ basis.T
    states = states.reshape(-1, 2, int(used.sum()))
    cos, sin = np.cos(fit.phase_rad)[:, None], np.sin(fit.phase_rad)[:, None]
    # Rotated from in-phase and quadrature to along and across the phasor.
    along = cos * states[:, 0] + sin * states[:, 1]
    across = cos * states[:, 1] - sin * states[:, 0]
    return np.stack([along, across], axis=1).reshape(count, -1), basis
