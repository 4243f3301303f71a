"""Displacement from the delay of maximum correlation between each echo and the others.

    u_k = c/2 argmax over tau of <sum of the other echoes delayed by tau, r_k>

The correlation is evaluated at samples `UPSAMPLING` times as dense as those of the echoes, which is exact for a
band-limited signal, and searched within half a carrier period of the accumulated consecutive phases. Between samples
the maximum is that of a natural cubic spline. Source: the usual time-domain estimator (Viola and Walker 2003 compare
several).
"""

from __future__ import annotations

import functools
import math

import numpy as np

from hpe_rig.arrays import ComplexArray, FloatArray, IndexArray
from hpe_rig.processing.echo.gate import EchoGate, expand_to_pulses
from hpe_rig.processing.echo.spectrum import advanced, band_spectrum
from hpe_rig.processing.motion.displacement import Motion
from hpe_rig.processing.motion.phase_shift import compare_with_others, pulse_steps

UPSAMPLING = 6
"""At 11 samples per period, the spline's error for small motion is 2.5 % without upsampling and falls with its cube."""
SPLINE_MARGIN = 3
"""Samples of the correlation beyond half a period on either side, so that the spline's ends are far from its peak."""


def cross_correlation(echoes: EchoGate) -> Motion:
    """Return the displacement of every pulse from the peak of its correlation with the sum of all other echoes.

    If the taper of the records reaches into the gate, the cross-spectrum is weighted by inverse frequency. The peak is
    then at the delay where the cross-spectrum, summed over the band, has zero phase, which a taper biases least. Raises
    ``ValueError`` for fewer than two valid pulses and if no train has an echo.
    """
    spectrum, band = band_spectrum(echoes)
    # A first guess of the delays (..., pulse), from the phases of consecutive echoes.
    consecutive = pulse_steps(spectrum, band)
    guess_s = consecutive.delay_s - consecutive.delay_s.mean(axis=-1, keepdims=True)
    # Sum of all echoes aligned by these delays, and the noise variance of each echo's phase against it.
    comparison = compare_with_others(spectrum, band, consecutive, guess_s)

    # The others are aligned at their first guess. Each pulse is advanced by its guess in whole upsampled samples.
    rate_hz = echoes.sample_rate_hz * UPSAMPLING
    guess_lag = np.round(guess_s * rate_hz)
    reference = comparison.gated_sum[..., None, :] - band.gated(advanced(spectrum, guess_s, band.frequency_hz))
    cross = np.conj(reference) * advanced(spectrum, guess_lag / rate_hz, band.frequency_hz)
    if band.tapers_gate:
        # A peak weights phases by frequency, and a taper over a moving echo changes phases in proportion to frequency.
        cross *= consecutive.mean_hz[..., None, None] / band.frequency_hz

    half_period = math.ceil(rate_hz / np.nanmin(consecutive.mean_hz) / 2)
    correlation = _correlation(cross, band.frequency_hz / rate_hz, half_period + SPLINE_MARGIN)
    # The delay that remains after the guess, in upsampled samples.
    residual_lag = _peak_lag(correlation, half_period)
    metres_per_second = echoes.sound_speed_m_per_s / 2
    # ``comparison.variance`` is that of a phase, rad^2.
    variance_m2 = comparison.variance / (2 * np.pi * consecutive.mean_hz[..., None]) ** 2 * metres_per_second**2
    return Motion(
        time_s=echoes.pulse_time_s,
        displacement_m=expand_to_pulses((guess_lag + residual_lag) / rate_hz * metres_per_second, echoes.valid),
        variance_m2=expand_to_pulses(variance_m2, echoes.valid),
        valid=echoes.valid,
        # A quarter wavelength of displacement is a phase of pi.
        largest_step=np.abs(np.diff(consecutive.phase, axis=-1)).max(axis=-1) / np.pi,
    )


def _correlation(cross: ComplexArray, cycles: FloatArray, reach: int) -> FloatArray:
    """Return the correlation (..., pulse, lag) at lags of -``reach`` to ``reach`` samples from its cross-spectrum.

    ``cycles`` (bin,): frequency in cycles per sample of the correlation.
    """
    phase = 2 * np.pi * np.outer(cycles, np.arange(-reach, reach + 1))
    return np.asarray(cross.real @ np.cos(phase) - cross.imag @ np.sin(phase))


def _peak_lag(correlation: FloatArray, half_period: int) -> FloatArray:
    """Return the lag (..., pulse), in samples, of the peak of ``correlation`` (..., pulse, lag), refined by a spline.

    Lags run from -reach to reach samples; the peak is searched within ``half_period``. At a distance x from the largest
    sample, a natural cubic spline has the slope s + m x + d x² / 2: s and m are slope and second derivative at that
    sample, d the change of m to the neighbour on the side of the peak. The peak is where the slope is zero.
    """
    reach = correlation.shape[-1] // 2
    inner = correlation[..., reach - half_period : reach + half_period + 1]
    largest = np.argmax(inner, axis=-1) + reach - half_period
    second_derivative = correlation @ _second_derivatives(correlation.shape[-1]).T
    # Second derivatives before, at and after the largest sample.
    m_before, m, m_after = (_at(second_derivative, largest + shift) for shift in (-1, 0, 1))
    # The sign of the slope, from the interval after the sample, decides on which side of it the peak lies.
    slope = _at(correlation, largest + 1) - _at(correlation, largest) - (2 * m + m_after) / 6
    change = np.where(slope > 0, m_after - m, m - m_before)
    # Root of the slope, in the form that stays exact for a small change of the second derivative.
    denominator = np.sqrt(np.maximum(m**2 - 2 * change * slope, 0.0)) - m
    offset = np.clip(2 * slope / np.where(denominator > 0, denominator, np.inf), -1, 1)
    return np.asarray(largest + offset - reach)


def _at(values: FloatArray, index: IndexArray) -> FloatArray:
    """Return the values (...) at an ``index`` (...) of the last axis."""
    return np.take_along_axis(values, index[..., None], axis=-1)[..., 0]


@functools.lru_cache(maxsize=8)
def _second_derivatives(count: int) -> FloatArray:
    """Return the matrix (count, count) from values at unit spacing to second derivatives of their cubic spline."""
    from scipy.interpolate import CubicSpline

    knots = np.arange(count)
    return np.asarray(CubicSpline(knots, np.eye(count), bc_type="natural")(knots, 2))
