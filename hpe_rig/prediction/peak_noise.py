"""Noise of an estimator that reads the phase at the peak of the cross-spectrum.

Noise adds to the phase and also moves the peak, between pulse pairs by different amounts. Three noisy pulses p_1, p_2,
p_3 are drawn for each echo, hence two steps, read at the peaks f_1 and f_2 of their cross-spectra:

    s_1 = p_2(f_1) - p_1(f_1),    s_2 = p_3(f_2) - p_2(f_2),    Var s = 2 v + w,    Cov(s_1, s_2) = -v

v is the variance of a pulse, w the part of a step that the next step does not return. Two control variates reduce the
scatter of a finite number of draws: steps q at f_1 of phases against the clean echo, which have w = 0, so that their
Var q + 2 Cov(q_1, q_2) is chance; and the linear form of the phases at the clean peak, with v known exactly as the
noise in a bin over the peak's power.
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
"""Groups of draws by echo strength; each has its unreturned noise."""
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
    """Return tracked over peak (draw,) at the noisy peaks, and phase variances (v, w), rad^2, of each group of draws.

    v is the variance of a pulse, w the part of a step's variance that the next step does not cancel. Groups of draws
    are of equal size, from the weakest echo to the strongest.
    """
    matrix = to_band(conditions, PADDED_INSTANTS, hann(INSTANTS))
    # Standard deviation of noise in each of INSTANTS samples of the envelope, for the SNR in the gate's real samples.
    power = np.mean(np.abs(speckle.resting) ** 2, axis=-1, keepdims=True)
    scale = np.sqrt(power * INSTANTS / (conditions.gate_samples * conditions.snr))
    clean, displaced = matmul(speckle.resting, matrix), matmul(speckle.displaced, matrix)
    # Noise in a bin over the power of the peak: v is proportional to it.
    relative_noise = np.square(scale[:, 0] / np.abs(clean).max(axis=-1), dtype=np.float64)
    groups = np.array_split(np.argsort(-relative_noise), GROUPS)
    first, second, pulse, step = _two_steps(clean, scale, matrix, generator)
    ratios = [_values_at(displaced / clean, peak).real for peak in (first, second)]
    # The weakest echoes have nearly all of w: average over more noise.
    weakest = np.concatenate(groups[: GROUPS // 8])
    more = [_two_steps(clean[weakest], scale[weakest], matrix, generator)[2:] for _ in range(EXTRA_NOISE_DRAWS)]
    for values, redrawn in zip((pulse, step), zip(*more, strict=True), strict=True):
        values[weakest] = np.mean([values[weakest], *redrawn], axis=0)
    # A step of the motion read at the two peaks differs as well.
    motion_step = 2 * np.square(conditions.amplitude_m / conditions.metres_per_radian * conditions.half_step)
    step += float(np.mean((ratios[0] - ratios[1]) ** 2)) / 2 * motion_step
    # Mean v: its linear form, plus the mean excess of the draws.
    linear_form = float(np.square(hann(INSTANTS)).sum() * relative_noise.mean())
    mean_pulse = max(linear_form + float(pulse.mean()), 0.0)
    variances = [
        (mean_pulse * float(relative_noise[group].mean() / relative_noise.mean()), max(float(step[group].mean()), 0.0))
        for group in groups
    ]
    return (ratios[0] + ratios[1]) / 2, variances


def _two_steps(
    clean: ComplexArray, scale: FloatArray, matrix: ComplexArray, generator: np.random.Generator
) -> tuple[Int64Array, Int64Array, FloatArray, FloatArray]:
    """Return both peaks (draw, 1), and estimates (draw,) of a pulse's variance v beyond its linear form, and of w.

    Each draw has three noisy pulses, hence two phase steps. w is the part of a step that the next step does not cancel.
    ``scale`` (draw, 1): noise of a sample. ``matrix``: from samples to the bins of ``clean`` (draw, bin).
    """
    shape = (len(clean), 3, clean.shape[1])
    noise = _band_noise(matrix, math.prod(shape[:2]), generator).reshape(shape)
    noisy = noise * scale[:, None] + clean[:, None]
    level = noisy.real**2 + noisy.imag**2
    first, second = (np.argmax(level[:, k] * level[:, k + 1], axis=-1)[:, None] for k in (0, 1))
    steps = [_phase_step(noisy[:, k], noisy[:, k + 1], peak) for k, peak in ((0, first), (1, second))]
    # Control variates have a known mean; subtracted, they reduce the scatter of few draws. For w: steps read at the
    # first peak against the clean echo, for which w is 0.
    phases = [_phase_step(clean, noisy[:, k], first) for k in range(3)]
    unreturned = _unreturned_variance(*steps) - _unreturned_variance(phases[1] - phases[0], phases[2] - phases[1])
    # Control variate for v: the linear form of the phases at the clean peak.
    clean_peak = np.argmax(np.abs(clean), axis=-1)[:, None]
    reference = _values_at(clean, clean_peak)
    linear = [
        (np.conj(reference) * _values_at(noisy[:, k], clean_peak)).imag / np.abs(reference) ** 2 for k in range(3)
    ]
    beyond_linear = (linear[1] - linear[0]) * (linear[2] - linear[1]) - steps[0] * steps[1]
    return first, second, np.asarray(beyond_linear, dtype=np.float64), unreturned


def _unreturned_variance(first: FloatArray, second: FloatArray) -> FloatArray:
    """Return Var s + 2 Cov(s_1, s_2) of two consecutive steps, one estimate for each draw."""
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
