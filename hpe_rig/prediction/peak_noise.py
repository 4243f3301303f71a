"""Noise of an estimator that reads the phase at the peak of the cross-spectrum.

Noise adds to the phase and also moves the peak, between pulse pairs by different amounts. Three noisy pulses p_1, p_2,
p_3 are drawn for each echo, hence two steps, read at the peaks f_1 and f_2 of their cross-spectra:

    s_1 = p_2(f_1) - p_1(f_1),    s_2 = p_3(f_2) - p_2(f_2),    Var s = 2 v + w,    Cov(s_1, s_2) = -v

v is the variance of a pulse. w is the part of a step's variance that the next step does not cancel: the variance of a
sum of steps grows by it from pulse to pulse. Two control variates, with known v or w, reduce the scatter of a finite
number of draws (from 13 % of the noise to 3 % for muscle at 30 dB).
"""

from __future__ import annotations

import math

import numpy as np

from hpe_rig.arrays import ComplexArray, FloatArray, Int64Array
from hpe_rig.prediction.conditions import Conditions
from hpe_rig.prediction.speckle import INSTANTS, Speckle, matmul, to_band
from hpe_rig.processing import hann

PADDED_INSTANTS = 4 * INSTANTS
"""Bins of the spectrum; the peak is searched in the band."""
GROUPS = 32
"""Groups of draws by echo strength; each has its noise variances."""
EXTRA_NOISE_DRAWS = 6
"""Further noise draws for the weakest eighth of the echoes, which has nearly all of w."""
NEGLIGIBLE_SINGULAR_VALUE = 1e-6
"""Relative to the largest."""


def peak_ratio(conditions: Conditions, speckle: Speckle) -> FloatArray:
    """Return tracked over peak displacement (draw,) of an estimator that reads the phase at the spectral peak.

    Without noise, for each draw of speckle: the displaced over the resting spectrum, at the peak of the resting one.
    """
    matrix = to_band(conditions, PADDED_INSTANTS, hann(INSTANTS))
    resting, displaced = matmul(speckle.resting, matrix), matmul(speckle.displaced, matrix)
    peak = np.argmax(np.abs(resting), axis=-1)[:, None]
    return np.asarray(_values_at(displaced / resting, peak).real)


def peak_statistics(
    conditions: Conditions, speckle: Speckle, generator: np.random.Generator
) -> tuple[FloatArray, list[tuple[float, float]]]:
    """Return tracked over peak displacement (draw,) at noisy spectral peaks, and the phase variances of the noise.

    The variances (rad^2) are pairs, one for each of ``GROUPS`` equal groups of draws from the weakest echo to the
    strongest: that of a pulse, and the part of a pulse-to-pulse step's variance that the next step does not cancel.
    """
    matrix = to_band(conditions, PADDED_INSTANTS, hann(INSTANTS))
    # Standard deviation of noise in each of INSTANTS samples of the envelope, for the SNR in the gate's real samples.
    power = np.mean(np.abs(speckle.resting) ** 2, axis=-1, keepdims=True)
    noise_sd = np.sqrt(power * INSTANTS / (conditions.gate_samples * conditions.snr))
    noise_free, displaced = matmul(speckle.resting, matrix), matmul(speckle.displaced, matrix)
    # Noise in a bin over the power of the peak: the variance of a pulse is proportional to it.
    relative_noise = np.square(noise_sd[:, 0] / np.abs(noise_free).max(axis=-1), dtype=np.float64)
    groups = np.array_split(np.argsort(-relative_noise), GROUPS)
    first_peak, second_peak, pulse_excess, step_variance = _two_steps(noise_free, noise_sd, matrix, generator)
    ratios = [_values_at(displaced / noise_free, peak).real for peak in (first_peak, second_peak)]
    # The weakest eighth of the echoes has nearly all of the steps' variance: average it over more noise.
    weakest = np.concatenate(groups[: GROUPS // 8])
    redraws = [
        _two_steps(noise_free[weakest], noise_sd[weakest], matrix, generator)[2:] for _ in range(EXTRA_NOISE_DRAWS)
    ]
    for estimates, redrawn in zip((pulse_excess, step_variance), zip(*redraws, strict=True), strict=True):
        estimates[weakest] = np.mean([estimates[weakest], *redrawn], axis=0)
    # The motion between two pulses is read at two different peaks: their ratios differ, which adds to every step.
    motion_step = 2 * np.square(conditions.amplitude_m / conditions.metres_per_radian * conditions.half_step)
    step_variance += float(np.mean((ratios[0] - ratios[1]) ** 2)) / 2 * motion_step
    # Mean variance of a pulse: that of the linear approximation, plus the mean excess of the draws.
    linear_variance = float(np.square(hann(INSTANTS)).sum() * relative_noise.mean())
    mean_pulse_variance = max(linear_variance + float(pulse_excess.mean()), 0.0)
    relative_pulse = [float(relative_noise[group].mean() / relative_noise.mean()) for group in groups]
    variances = [
        (mean_pulse_variance * relative, max(float(step_variance[group].mean()), 0.0))
        for group, relative in zip(groups, relative_pulse, strict=True)
    ]
    return (ratios[0] + ratios[1]) / 2, variances


def _two_steps(
    noise_free: ComplexArray, noise_sd: FloatArray, matrix: ComplexArray, generator: np.random.Generator
) -> tuple[Int64Array, Int64Array, FloatArray, FloatArray]:
    """Return the spectral peaks of two phase steps between noisy pulses, and estimates of two noise variances.

    Each draw has three noisy pulses, hence two steps; a step is read at the peak of its cross-spectrum. The peaks
    (draw, 1) are indices of bins. The estimates (draw,), rad^2, are scattered about the true values: the variance of a
    pulse beyond that of the linear approximation, and the variance of a step that the next step does not cancel.
    ``noise_free`` (draw, bin): spectrum of the echo. ``noise_sd`` (draw, 1): standard deviation of noise in a sample.
    ``matrix`` (sample, bin) leads from samples to the spectrum.
    """
    shape = (len(noise_free), 3, noise_free.shape[1])
    noise = _band_noise(matrix, math.prod(shape[:2]), generator).reshape(shape)
    noisy = noise * noise_sd[:, None] + noise_free[:, None]
    power = noisy.real**2 + noisy.imag**2
    # The squared cross-spectrum of pulses k and k + 1 is the product of their powers.
    first_peak, second_peak = (np.argmax(power[:, k] * power[:, k + 1], axis=-1)[:, None] for k in (0, 1))
    steps = [_phase_step(noisy[:, k], noisy[:, k + 1], peak) for k, peak in ((0, first_peak), (1, second_peak))]
    # A control variate has a known mean: subtracted, it reduces the scatter of few draws. For the variance of a step:
    # steps of the phases against the noise-free echo, at one peak. Each is cancelled by the next, so the mean is 0.
    phases = [_phase_step(noise_free, noisy[:, k], first_peak) for k in range(3)]
    chance = _unreturned_variance(phases[1] - phases[0], phases[2] - phases[1])
    # For the variance of a pulse: the linear approximation of the phases at the noise-free peak.
    noise_free_peak = np.argmax(np.abs(noise_free), axis=-1)[:, None]
    reference = _values_at(noise_free, noise_free_peak)
    linear_phases = [
        (np.conj(reference) * _values_at(noisy[:, k], noise_free_peak)).imag / np.abs(reference) ** 2 for k in range(3)
    ]
    # Minus the product of consecutive steps has the variance of their common pulse as its mean.
    linear_product = (linear_phases[1] - linear_phases[0]) * (linear_phases[2] - linear_phases[1])
    pulse_excess = np.asarray(linear_product - steps[0] * steps[1], dtype=np.float64)
    return first_peak, second_peak, pulse_excess, _unreturned_variance(*steps) - chance


def _unreturned_variance(first: FloatArray, second: FloatArray) -> FloatArray:
    """Return estimates (draw,) of Var s + 2 Cov(s_1, s_2): the variance of a step that the next does not cancel."""
    return np.asarray((first**2 + second**2) / 2 + 2 * first * second, dtype=np.float64)


def _band_noise(matrix: ComplexArray, count: int, generator: np.random.Generator) -> ComplexArray:
    """Return ``count`` draws (draw, bin) of the noise of a spectrum, from white noise of the samples.

    ``matrix`` (sample, bin) leads from samples to bins. The white noise has variance 1 in real and imaginary part.
    Neighbouring bins are strongly correlated: some sixteen singular directions carry all of the noise.
    """
    _, size, direction = np.linalg.svd(matrix, full_matrices=False)
    significant = size > NEGLIGIBLE_SINGULAR_VALUE * size[0]
    real_and_imaginary = generator.standard_normal((count, np.count_nonzero(significant), 2), dtype=np.float32)
    basis = size[significant, None] * direction[significant]
    return np.asarray(real_and_imaginary.view(np.complex64)[..., 0] @ basis, dtype=np.complex64)


def _values_at(values: ComplexArray, index: Int64Array) -> ComplexArray:
    return np.take_along_axis(values, index, axis=-1)[:, 0]


def _phase_step(before: ComplexArray, after: ComplexArray, index: Int64Array) -> FloatArray:
    return np.asarray(np.angle(np.conj(_values_at(before, index)) * _values_at(after, index)))
