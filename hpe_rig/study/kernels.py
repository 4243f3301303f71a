"""Linear kernels from echoes and noise to amplitude and phase, for many realisations of one pulse train.

An estimator depends on a gate only through its spectrum in the transmitted band. The spectrum is a projection of the
gate's hundred or more samples onto about fifty orthonormal vectors (`orthonormal_rows`). White noise in the samples is
white noise in these coefficients, so it is drawn there: the same statistics exactly, from fewer random numbers. The
step from displacements to amplitude and phase is linear (least squares, or the paper's band-pass, Hann window and
Kalman filter), so it is one matrix (`functional`).

    samples --of_volts--> spectrum <--of_coefficients-- noise coefficients      (by form: peak, plain, volts)
    spectrum of echoes + level * spectrum of noise -> phase -> displacement --functional--> A cos(phi), A sin(phi)
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from hpe_rig.arrays import ComplexArray, FloatArray, IndexArray
from hpe_rig.processing import (
    Band,
    EchoGate,
    Motion,
    Options,
    band_frequencies_hz,
    band_of,
    fit_motion,
    fourier_columns,
    hann,
    motion_of,
    noisy_peak_steps,
    orthonormal_rows,
    padded_bins,
    spec_of,
)
from hpe_rig.scene import Estimator


@dataclass(frozen=True, slots=True)
class Train:
    """Pulse times, gate and wanted frequencies; hashable."""

    pulse_rate_hz: float
    pulses: int
    delay_s: float
    carrier_hz: float
    sound_speed_m_per_s: float
    sample_rate_hz: float
    samples: int
    frequencies_hz: tuple[float, ...]
    options: Options

    @property
    def pulse_time_s(self) -> FloatArray:
        """Sampling time of the motion by each pulse, (pulse,)."""
        return self.delay_s + np.arange(self.pulses) / self.pulse_rate_hz

    @property
    def state_count(self) -> int:
        """Number of states: A cos(phi) and A sin(phi) of each frequency."""
        return 2 * len(self.frequencies_hz)

    def gate(self, volts: FloatArray) -> EchoGate:
        """Return echoes (..., pulse, sample) as the estimators' input."""
        valid = np.ones(self.pulses, dtype=bool)
        return EchoGate(volts, self.sample_rate_hz, self.pulse_time_s, self.carrier_hz, self.sound_speed_m_per_s, valid)


Form = Literal["peak", "plain", "volts"]
"""Input of an estimator: spectrum under the Hann window on the padded grid, plain spectrum, or samples."""


def form_of(estimator: Estimator) -> Form:
    """Return the input form of an estimator."""
    spec = spec_of(estimator)
    return "peak" if spec.reads_peak else "plain" if spec.band_phase is not None else "volts"


@dataclass(frozen=True, slots=True)
class SpectralKernels:
    """Matrices from samples and noise coefficients to spectra, fixed by carrier, sample rate and gate length."""

    basis: dict[Form, FloatArray]
    """(coefficient, sample), orthonormal rows that span all that an estimator of a form uses."""
    grid_hz: dict[Form, FloatArray]
    """(bin,)"""
    band: Band
    """Band of the plain spectrum."""
    of_volts: dict[Form, FloatArray]
    """(sample, 2 * bin), from samples to spectra: real parts, then imaginary parts."""
    of_coefficients: dict[Form, FloatArray]
    """(coefficient, 2 * bin), from noise coefficients to spectra; for "volts" (coefficient, sample)."""


def spectral_kernels(train: Train) -> SpectralKernels:
    """Return the kernels of a train's gate; raise ``ValueError`` for a gate too short for the band."""
    return _spectral_kernels(train.carrier_hz, train.sample_rate_hz, train.samples)


@functools.lru_cache(maxsize=16)
def _spectral_kernels(carrier_hz: float, sample_rate_hz: float, samples: int) -> SpectralKernels:
    # The grids depend on neither pulse time nor sound speed: one pulse at time 0 defines them.
    gate = EchoGate(np.zeros((1, samples)), sample_rate_hz, np.zeros(1), carrier_hz, 1.0, np.ones(1, dtype=bool))
    band = band_of(gate)
    grid_hz: dict[Form, FloatArray] = {
        "peak": band_frequencies_hz(gate, padded_bins(samples)),
        "plain": band.frequency_hz,
    }
    of_volts = {form: fourier_columns(samples, sample_rate_hz, hz) for form, hz in grid_hz.items()}
    of_volts["peak"] *= hann(samples)[:, None]
    basis: dict[Form, FloatArray] = {"peak": orthonormal_rows(np.hstack([of_volts["plain"], of_volts["peak"]]))}
    # All other estimators use the tapered spectrum and separate noise coefficients, so that the noise of the paper's
    # chain does not depend on the other estimators of a study.
    of_volts["plain"] = np.hstack([band.analysis.real, band.analysis.imag])
    basis["plain"] = basis["volts"] = orthonormal_rows(of_volts["plain"])
    of_coefficients: dict[Form, FloatArray] = {form: basis[form] @ columns for form, columns in of_volts.items()}
    return SpectralKernels(basis, grid_hz, band, of_volts, of_coefficients | {"volts": basis["volts"]})


@functools.lru_cache(maxsize=64)
def functional(train: Train, estimator: Estimator) -> FloatArray:
    """Return the matrix (pulse, state) from displacements to A cos(phi), A sin(phi), interleaved."""
    # Row k of the matrix is the fit of a train that moves at pulse k only.
    unit = np.eye(train.pulses)
    motion = Motion(train.pulse_time_s, unit, np.ones_like(unit), np.ones(train.pulses, dtype=bool))
    fit = fit_motion(motion, train.frequencies_hz, estimator, options=train.options)
    return np.asarray(fit.state[:, : train.state_count])


@functools.lru_cache(maxsize=64)
def step_functional(train: Train, estimator: Estimator) -> FloatArray:
    """Return the matrix (step, state) from displacement steps between pulses to A cos(phi), A sin(phi)."""
    # A step before pulse k moves all pulses from k on: its weight is the sum of their weights.
    sums_from_pulse = np.cumsum(functional(train, estimator)[::-1], axis=0)[::-1]
    return np.ascontiguousarray(sums_from_pulse[1:])


def states(
    train: Train, estimator: Estimator, clean: FloatArray, echo_index: IndexArray, level: FloatArray, noise: FloatArray
) -> FloatArray:
    """Return the states (draw, noise, state), NaN for realisations that the estimator refuses.

    ``clean`` (draw, echo, ...) and ``noise`` (draw, noise, pulse, ...) in the form of the estimator, ``echo_index``
    (pulse,) the echo of every pulse, ``level`` (draw,) of the noise.
    """
    if spec_of(estimator).reads_peak:
        step, peak = noisy_peak_steps(clean, echo_index, level, noise)
        step_m = step * _metre_hertz(train) / spectral_kernels(train).grid_hz["peak"][peak]
        return np.asarray(step_m @ step_functional(train, estimator))
    noisy = clean[:, None, echo_index] + level[:, None, None, None] * noise
    # The states of a realisation without an echo are NaN; estimators raise if all realisations are without one.
    try:
        return _states(train, estimator, noisy)
    except ValueError:
        return np.full((*noisy.shape[:2], train.state_count), np.nan)


def _states(train: Train, estimator: Estimator, noisy: FloatArray) -> FloatArray:
    spec = spec_of(estimator)
    if spec.band_phase is not None:
        phase, _, mean_hz = spec.band_phase(_complex(noisy), spectral_kernels(train).band, True)
        return np.asarray((phase * _metre_hertz(train) / mean_hz[..., None]) @ functional(train, estimator))
    return np.asarray(motion_of(train.gate(noisy), estimator).displacement_m @ functional(train, estimator))


def _complex(spectra: FloatArray) -> ComplexArray:
    """Return complex spectra (..., bin) of real and imaginary parts (..., 2 * bin)."""
    bins = spectra.shape[-1] // 2
    return np.asarray(spectra[..., :bins] + 1j * spectra[..., bins:])


def _metre_hertz(train: Train) -> float:
    """Return displacement over phase times frequency, -c / (4 pi), m Hz/rad."""
    return -train.sound_speed_m_per_s / (4 * np.pi)


def refuse_unusable(train: Train, estimators: Sequence[Estimator]) -> None:
    """Raise ``ValueError`` if the train cannot carry an estimate, before anything is drawn."""
    spectral_kernels(train)
    for estimator in estimators:
        functional(train, estimator)
