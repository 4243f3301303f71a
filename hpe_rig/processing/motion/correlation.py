"""Displacement from the delay of maximum correlation between each echo and the others.

    u_k = c/2 argmax over tau of <sum of the other echoes delayed by tau, r_k>

The correlation is evaluated on a grid within half a carrier period of the accumulated consecutive phases. Its maximum
is then refined by Newton's method, which is exact for a band-limited signal. Source: the usual time-domain estimator
(Viola and Walker 2003 compare several).
"""

from __future__ import annotations

import numpy as np

from hpe_rig.arrays import ComplexArray, FloatArray
from hpe_rig.processing.echo.gate import EchoGate
from hpe_rig.processing.echo.spectrum import advanced, band_spectrum
from hpe_rig.processing.motion.displacement import Motion
from hpe_rig.processing.motion.phase_shift import compare_with_others, motion_of_phase, pulse_steps

GRID = 16
"""Intervals of the grid in a carrier period; from 1/32 period Newton's method converges to 1e-8 of it in two steps."""
NEWTON_STEPS = 3


def cross_correlation(echoes: EchoGate) -> Motion:
    """Return the displacement of every pulse from the peak of its correlation with the sum of all other echoes.

    The cross-spectrum is weighted by inverse frequency. The peak is then at the delay where the cross-spectrum, summed
    over the band, has zero phase, which the ends of the gate and a taper bias least. Raises ``ValueError`` for fewer
    than two valid pulses and if no train has an echo.
    """
    spectrum, band = band_spectrum(echoes)
    # A first guess of the delays (..., pulse), from the phases of consecutive echoes.
    consecutive = pulse_steps(spectrum, band)
    guess_s = consecutive.delay_s - consecutive.delay_s.mean(axis=-1, keepdims=True)
    # Sum of all echoes aligned by these delays, and the noise variance of each echo's phase against it.
    comparison = compare_with_others(spectrum, band, consecutive, guess_s)

    # Each pulse is advanced by its guess; the others are aligned at theirs.
    echo = advanced(spectrum, guess_s, band.frequency_hz)
    cross = np.conj(comparison.gated_sum[..., None, :] - band.gated(echo)) * echo
    # A peak weights phases by frequency, and the ends of a gate over a moving echo change phases in proportion to
    # frequency: without this weight the error of rigid motion is 1e-4 in a gate of 1 mm, and 4e-3 without margins.
    cross *= consecutive.mean_hz[..., None, None] / band.frequency_hz
    delay_s = guess_s + _peak_delay_s(cross, band.frequency_hz, float(np.nanmin(consecutive.mean_hz)))
    mean_hz = consecutive.mean_hz[..., None]
    return motion_of_phase(echoes, -2 * np.pi * mean_hz * delay_s, comparison.variance, mean_hz)


def _peak_delay_s(cross: ComplexArray, frequency_hz: FloatArray, carrier_hz: float) -> FloatArray:
    """Return the delay tau (..., pulse) within half a carrier period at which the correlation R is largest.

        R(tau) = Re sum_f C(f) exp(j w tau),    w = 2 pi f,    tau <- tau - R'(tau) / R''(tau)

    ``cross`` C (..., pulse, bin): cross-spectrum at ``frequency_hz`` (bin,).
    """
    omega, grid_s = 2 * np.pi * frequency_hz, (np.arange(GRID + 1) / GRID - 0.5) / carrier_hz
    phase = np.outer(omega, grid_s)
    delay_s = grid_s[np.argmax(cross.real @ np.cos(phase) - cross.imag @ np.sin(phase), axis=-1)]
    for _ in range(NEWTON_STEPS):
        delayed = cross * np.exp(1j * omega * delay_s[..., None])
        slope, curvature = -(delayed.imag @ omega), -(delayed.real @ omega**2)
        step_s = -slope / np.where(curvature < 0, curvature, -np.inf)
        # At the end of the range the maximum may lie outside.
        delay_s = delay_s + np.clip(step_s, -1 / (GRID * carrier_hz), 1 / (GRID * carrier_hz))
    return np.asarray(delay_s)
