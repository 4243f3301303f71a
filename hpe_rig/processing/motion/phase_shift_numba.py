"""Phase of every pulse against its train's other echoes in one loop, compiled; `motion` imports it where Numba is."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import numba
import numpy as np

from hpe_rig.arrays import ComplexArray, FloatArray

Loop = TypeVar("Loop", bound=Callable[..., object])

_compiled: Callable[[Loop], Loop] = numba.njit(
    nogil=True, cache=True, error_model="numpy", fastmath={"nsz", "contract", "reassoc"}
)


@_compiled
def _gate(echo: ComplexArray, root: FloatArray, gated: ComplexArray) -> None:
    """Write what `band.Band.gated` makes of an echo (bin,)."""
    gated[:] = echo
    for column in range(root.shape[1]):
        outside = 0j
        for m in range(len(echo)):
            outside += echo[m] * root[m, column]
        for m in range(len(echo)):
            gated[m] -= outside * root[m, column]


@_compiled
def _product(one: ComplexArray, other: ComplexArray, hz: FloatArray) -> tuple[complex, complex]:
    """Return the inner product of two echoes (bin,), and the same weighted by frequency."""
    real, imag, by_real, by_imag = 0.0, 0.0, 0.0, 0.0
    for m in range(len(one)):
        a = one[m].real * other[m].real + one[m].imag * other[m].imag
        b = one[m].real * other[m].imag - one[m].imag * other[m].real
        real += a
        imag += b
        by_real += a * hz[m]
        by_imag += b * hz[m]
    return complex(real, imag), complex(by_real, by_imag)


@_compiled
def _mean_hz(moment: float, energy: float, hz: FloatArray) -> float:
    """Return what `motion.mean_frequency` does, NaN where there is nothing in common in the band."""
    mean_hz = moment / energy if energy > 0 else np.nan
    return mean_hz if hz[0] <= mean_hz <= hz[-1] else np.nan


@_compiled
def _follow(
    echoes: ComplexArray, gated: ComplexArray, hz: FloatArray, least: float, phase: FloatArray, own: FloatArray
) -> tuple[float, float]:
    """Write `motion.PulseSteps.phase` and ``energy``; return its mean frequency and moment."""
    size, common, correlation, moments = 0.0, 0.0, 0.0, 0.0
    for k in range(len(echoes)):
        energy, moment = _product(echoes[k], gated[k], hz)
        own[k], moments = energy.real, moments + moment.real
        if k == 0:
            phase[0] = 0.0
            continue
        step, before = _product(echoes[k - 1], gated[k], hz)
        after = _product(gated[k - 1], echoes[k], hz)[1]
        length = np.sqrt(step.real**2 + step.imag**2)
        size += length
        correlation += length / np.sqrt(own[k - 1] * own[k])
        if length > 0:
            common += (step.conjugate() * (before + after)).real / (2 * length)
        phase[k] = phase[k - 1] + np.arctan2(step.imag, step.real)
    if not correlation > least * (len(echoes) - 1):
        return np.nan, moments
    return _mean_hz(common, size, hz), moments


@_compiled
def _align(
    echoes: ComplexArray, delay_s: FloatArray, hz: FloatArray, aligned: ComplexArray, total: ComplexArray
) -> None:
    """Write echoes (pulse, bin) advanced by their delay, about its mean, and their sum: `band.turned`."""
    step_hz, middle_s = (hz[-1] - hz[0]) / (len(hz) - 1), delay_s.mean()
    total[:] = 0
    for k in range(len(echoes)):
        angle = 2 * np.pi * (delay_s[k] - middle_s)
        factor = complex(np.cos(angle * hz[0]), np.sin(angle * hz[0]))
        step = complex(np.cos(angle * step_hz), np.sin(angle * step_hz))
        for m in range(len(hz)):
            aligned[k, m] = echoes[k, m] * factor
            total[m] += aligned[k, m]
            factor *= step


@_compiled
def coherent_phase(
    spectrum: ComplexArray,
    root: FloatArray,
    noise: ComplexArray,
    noise_energy: float,
    hz: FloatArray,
    least: float,
    phase: FloatArray,
    variance: FloatArray,
    mean_hz: FloatArray,
) -> None:
    """Write what `motion.coherent_phase` returns of spectra (train, pulse, bin), NaN of trains without an echo.

    ``root``, ``noise`` and ``noise_energy`` are the band's; ``least``: what neighbours must correlate by, in the mean.
    """
    trains, pulses, bins = spectrum.shape
    tiny = np.finfo(np.float64).tiny
    aligned, gated = np.empty((pulses, bins), np.complex128), np.empty((pulses, bins), np.complex128)
    total, along, own = np.empty(bins, np.complex128), np.empty(bins, np.complex128), np.empty(pulses)
    for train in range(trains):
        echoes = spectrum[train]
        for k in range(pulses):
            _gate(echoes[k], root, gated[k])
        mean, moments = _follow(echoes, gated, hz, least, phase[train], own)
        for second in range(2):
            _align(echoes, -phase[train] / (2 * np.pi * mean), hz, aligned, total)
            _gate(total, root, along)
            energy, moment = _product(along, total, hz)
            # of the noise in the gate, what lies along the echo turns its phase, the rest is misfit
            turning = 0.0
            for m in range(bins * second):
                for n in range(bins):
                    turning += (along[m].conjugate() * noise[m, n] * along[n]).real
            turning /= max(energy.real, tiny)
            for k in range(pulses):
                if second:
                    _gate(aligned[k], root, gated[k])
                    own[k] = _product(aligned[k], gated[k], hz)[0].real
                with_total = _product(along, aligned[k], hz)[0]
                others = with_total - own[k]
                reference = max(energy.real - 2 * with_total.real + own[k], tiny)
                misfit = max(own[k] - (others.real**2 + others.imag**2) / reference, 0.0)
                variance[train, k] = misfit * turning / (noise_energy - turning) / (2 * reference) * (pulses - 1) ** 2
                phase[train, k] += np.arctan2(others.imag, others.real)
            mean = _mean_hz(moment.real - moments, energy.real - own.sum(), hz)
        mean_hz[train] = mean
