"""Compiled form of `phase_shift.coherent_phase`, one loop over trains; imported only if Numba is installed."""

from __future__ import annotations

import numpy as np

from hpe_rig.arrays import ComplexArray, FloatArray
from hpe_rig.processing.compilation import compiler

_compile = compiler("nsz", "contract", "reassoc")


@_compile
def _gate(echo: ComplexArray, margin_root: FloatArray, gated: ComplexArray) -> None:
    """Write the part of an echo's spectrum (bin,) in the gate into ``gated``: the echo minus its part in the margins.

    ``margin_root`` B (bin, column): the part in the margins is B B' echo.
    """
    gated[:] = echo
    for column in range(margin_root.shape[1]):
        in_margins = 0j
        for m in range(len(echo)):
            in_margins += echo[m] * margin_root[m, column]
        for m in range(len(echo)):
            gated[m] -= in_margins * margin_root[m, column]


@_compile
def _product(first: ComplexArray, second: ComplexArray, hz: FloatArray) -> tuple[complex, complex]:
    """Return the inner product of two echoes (bin,), and the inner product weighted by frequency."""
    real, imag, real_moment, imag_moment = 0.0, 0.0, 0.0, 0.0
    # a + j b is the conjugate of ``first`` times ``second`` in one bin.
    for m in range(len(first)):
        a = first[m].real * second[m].real + first[m].imag * second[m].imag
        b = first[m].real * second[m].imag - first[m].imag * second[m].real
        real += a
        imag += b
        real_moment += a * hz[m]
        imag_moment += b * hz[m]
    return complex(real, imag), complex(real_moment, imag_moment)


@_compile
def _mean_hz(moment: float, energy: float, hz: FloatArray) -> float:
    """Return `phase_shift.mean_frequency`, NaN without a common part in the band."""
    mean_hz = moment / energy if energy > 0 else np.nan
    return mean_hz if hz[0] <= mean_hz <= hz[-1] else np.nan


@_compile
def _pulse_steps(
    echoes: ComplexArray, gated: ComplexArray, hz: FloatArray, threshold: float, phase: FloatArray, energy: FloatArray
) -> tuple[float, float]:
    """Write the accumulated ``phase`` steps between consecutive echoes and the ``energy`` of each echo, (pulse,).

    ``echoes`` (pulse, bin): spectra of gate and margins; ``gated``: the same cut to the gate. Returned: mean frequency
    of the part that neighbours have in common, NaN if their mean correlation is below ``threshold``, and the sum of
    energy times frequency over all echoes. Compiled form of `phase_shift.pulse_steps`.
    """
    # Sums over pairs of consecutive echoes: magnitude of their product, the same times mean frequency, correlation.
    magnitude, common_moment, correlation = 0.0, 0.0, 0.0
    # Sum over echoes of energy times mean frequency.
    echo_moment = 0.0
    for k in range(len(echoes)):
        square, moment = _product(echoes[k], gated[k], hz)
        energy[k] = square.real
        echo_moment += moment.real
        if k == 0:
            phase[0] = 0.0
            continue
        # The product weighted by frequency is that of one gated and one whole echo, averaged over both choices.
        step, weighted_by_one = _product(echoes[k - 1], gated[k], hz)
        _, weighted_by_other = _product(gated[k - 1], echoes[k], hz)
        length = np.sqrt(step.real**2 + step.imag**2)
        magnitude += length
        correlation += length / np.sqrt(energy[k - 1] * energy[k])
        # Mean frequency of the part in common, times the length of the inner product.
        if length > 0:
            common_moment += (step.conjugate() * (weighted_by_one + weighted_by_other)).real / (2 * length)
        phase[k] = phase[k - 1] + np.arctan2(step.imag, step.real)
    if not correlation > threshold * (len(echoes) - 1):
        return np.nan, echo_moment
    return _mean_hz(common_moment, magnitude, hz), echo_moment


@_compile
def _align(
    echoes: ComplexArray, delay_s: FloatArray, hz: FloatArray, aligned: ComplexArray, total: ComplexArray
) -> None:
    """Write echoes (pulse, bin), each advanced by its delay relative to the mean delay, into ``aligned``.

    Their sum over pulses (bin,) is written into ``total``.
    """
    step_hz, middle_s = (hz[-1] - hz[0]) / (len(hz) - 1), delay_s.mean()
    total[:] = 0
    for k in range(len(echoes)):
        angle = 2 * np.pi * (delay_s[k] - middle_s)
        phasor = complex(np.cos(angle * hz[0]), np.sin(angle * hz[0]))
        step = complex(np.cos(angle * step_hz), np.sin(angle * step_hz))
        for m in range(len(hz)):
            aligned[k, m] = echoes[k, m] * phasor
            total[m] += aligned[k, m]
            phasor *= step


@_compile
def coherent_phase(
    spectrum: ComplexArray,
    margin_root: FloatArray,
    noise: ComplexArray,
    noise_energy: float,
    hz: FloatArray,
    threshold: float,
    phase: FloatArray,
    variance: FloatArray,
    mean_hz: FloatArray,
) -> None:
    """Write phase and variance (train, pulse) of each echo against the sum of the others, and mean frequency (train,).

    Compiled form of `phase_shift.coherent_phase` for spectra (train, pulse, bin); NaN without an echo. Of the band:
    ``margin_root`` B (the part of an echo in the margins of the gate is B B' echo), ``noise`` the covariance of white
    noise (bin, bin), and ``noise_energy`` its energy in the gate. ``threshold`` is the smallest mean correlation of an
    echo.
    """
    trains, pulses, bins = spectrum.shape
    tiny = np.finfo(np.float64).tiny
    aligned, gated = np.empty((pulses, bins), np.complex128), np.empty((pulses, bins), np.complex128)
    total, gated_sum, echo_energy = np.empty(bins, np.complex128), np.empty(bins, np.complex128), np.empty(pulses)
    for train in range(trains):
        echoes = spectrum[train]
        for k in range(pulses):
            _gate(echoes[k], margin_root, gated[k])
        train_hz, echo_moment = _pulse_steps(echoes, gated, hz, threshold, phase[train], echo_energy)
        # Two passes: aligned by the accumulated steps, then by the phases of the first pass.
        for second in range(2):
            _align(echoes, -phase[train] / (2 * np.pi * train_hz), hz, aligned, total)
            _gate(total, margin_root, gated_sum)
            total_energy, total_moment = _product(gated_sum, total, hz)
            # Energy of white noise along the echo, which changes its phase; only the second pass needs it.
            noise_along = 0.0
            if second:
                for m in range(bins):
                    for n in range(bins):
                        noise_along += (gated_sum[m].conjugate() * noise[m, n] * gated_sum[n]).real
            noise_along /= max(total_energy.real, tiny)
            for k in range(pulses):
                if second:
                    _gate(aligned[k], margin_root, gated[k])
                    echo_energy[k] = _product(aligned[k], gated[k], hz)[0].real
                with_total = _product(gated_sum, aligned[k], hz)[0]
                with_others = with_total - echo_energy[k]
                reference_energy = max(total_energy.real - 2 * with_total.real + echo_energy[k], tiny)
                # Energy of echo k that the reference does not explain: noise orthogonal to the echo.
                misfit = max(echo_energy[k] - (with_others.real**2 + with_others.imag**2) / reference_energy, 0.0)
                # The misfit times the ratio of white noise along and orthogonal to the echo is the noise along it. Half
                # of it, over the energy of a mean echo, is the variance of the phase. The reference is the sum of
                # pulses - 1 echoes, with (pulses - 1)² times the energy of their mean.
                variance[train, k] = (
                    misfit * noise_along / (noise_energy - noise_along) / (2 * reference_energy) * (pulses - 1) ** 2
                )
                phase[train, k] += np.arctan2(with_others.imag, with_others.real)
            # Mean frequency of the part that all echoes have in common: their sum without the sum of single echoes.
            train_hz = _mean_hz(total_moment.real - echo_moment, total_energy.real - echo_energy.sum(), hz)
        mean_hz[train] = train_hz
