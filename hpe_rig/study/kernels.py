"""Kernels that turn echoes and noise into amplitude and phase, for many realisations of one train of pulses.

Every estimator sees a gate only through its spectrum in the transmitted band, that is through the projections of its
hundred or more samples onto some fifty orthonormal vectors (`orthonormal_rows`). White noise in the samples is white
noise in these projections, so it is drawn there: the same statistics exactly, from fewer random numbers. The way from
displacements to amplitude and phase is linear (least squares, or the paper's band-pass, Hann window and Kalman filter),
so it is one matrix (`functional`).

    samples --of_volts--> spectrum <--of_numbers-- projections      (per form: peak, plain, volts)
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
    Estimator,
    Motion,
    Options,
    band_grid,
    band_of,
    fit_motion,
    fourier_columns,
    hann,
    motion_of,
    noisy_peak_steps,
    orthonormal_rows,
    spec_of,
)

PADDING = 8
"""The paper's chain: how finely its spectrum is sampled, as `processing.cross_spectrum`'s default."""


@dataclass(frozen=True, slots=True)
class Train:
    """When the pulses are fired, what the gate is and what is wanted of it; hashable."""

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
        """When each pulse senses the motion, (pulse,)."""
        return self.delay_s + np.arange(self.pulses) / self.pulse_rate_hz

    def gate(self, volts: FloatArray) -> EchoGate:
        """Return echoes (..., pulse, sample) as the estimators take them."""
        valid = np.ones(self.pulses, dtype=bool)
        return EchoGate(volts, self.sample_rate_hz, self.pulse_time_s, self.carrier_hz, self.sound_speed_m_per_s, valid)


Form = Literal["peak", "plain", "volts"]
"""How an estimator takes a gate: its spectrum under the Hann window on the padded grid, the plain one, or samples."""


def form_of(estimator: Estimator) -> Form:
    """Return the form in which an estimator takes a gate."""
    spec = spec_of(estimator)
    return "peak" if spec.reads_peak else "plain" if spec.band_phase is not None else "volts"


@dataclass(frozen=True, slots=True)
class SpectralKernels:
    """What a train fixes of the spectra; `spectral_kernels` makes it."""

    basis: dict[Form, FloatArray]
    """(number, sample), orthonormal rows: how many numbers say all that an estimator of a form sees of a gate."""
    grid_hz: dict[Form, FloatArray]
    """(bin,)"""
    band: Band
    """The plain spectrum's."""
    of_volts: dict[Form, FloatArray]
    """(sample, 2 * bin), from samples to spectra: real parts, then imaginary parts."""
    of_numbers: dict[Form, FloatArray]
    """The same from the numbers, (number, 2 * bin), and of "volts" (number, sample), orthonormal rows."""


def spectral_kernels(train: Train) -> SpectralKernels:
    """Return what the estimators see of a gate; raises ``ValueError`` for a gate too short for the band."""
    return _spectral_kernels(train.carrier_hz, train.sample_rate_hz, train.samples)


@functools.lru_cache(maxsize=16)
def _spectral_kernels(carrier_hz: float, sample_rate_hz: float, samples: int) -> SpectralKernels:
    # The grids are those of one pulse, whenever it is fired and whatever the sound speed.
    one = EchoGate(np.zeros((1, samples)), sample_rate_hz, np.zeros(1), carrier_hz, 1.0, np.ones(1, dtype=bool))
    band = band_of(one)
    grid_hz: dict[Form, FloatArray] = {
        "peak": band_grid(one, 1 << (PADDING * samples - 1).bit_length()),
        "plain": band.frequency_hz,
    }
    of_volts = {form: fourier_columns(samples, sample_rate_hz, hz) for form, hz in grid_hz.items()}
    of_volts["peak"] *= hann(samples)[:, None]
    basis: dict[Form, FloatArray] = {"peak": orthonormal_rows(np.hstack([of_volts["plain"], of_volts["peak"]]))}
    # All others see the tapered spectrum, from numbers of their own: the chain's noise does not hang on who else runs.
    of_volts["plain"] = np.hstack([band.analysis.real, band.analysis.imag])
    basis["plain"] = basis["volts"] = orthonormal_rows(of_volts["plain"])
    of_numbers: dict[Form, FloatArray] = {form: basis[form] @ columns for form, columns in of_volts.items()}
    return SpectralKernels(basis, grid_hz, band, of_volts, of_numbers | {"volts": basis["volts"]})


@functools.lru_cache(maxsize=64)
def functional(train: Train, estimator: Estimator) -> FloatArray:
    """Return the matrix (pulse, 2 * frequency) from displacements to A cos(phi), A sin(phi), interleaved."""
    # A linear map's matrix is what it makes of the unit vectors: a fit of many trains, each moved at one pulse alone.
    unit = np.eye(train.pulses)
    motion = Motion(train.pulse_time_s, unit, np.ones_like(unit), np.ones(train.pulses, dtype=bool))
    fit = fit_motion(motion, train.frequencies_hz, estimator, options=train.options)
    return np.asarray(fit.state[:, : 2 * len(train.frequencies_hz)])


@functools.lru_cache(maxsize=64)
def step_functional(train: Train, estimator: Estimator) -> FloatArray:
    """Return the matrix (step, 2 * frequency) from displacement steps between pulses to A cos(phi), A sin(phi)."""
    # A step before pulse k moves all pulses from k on: it weighs as much as their weights together.
    onwards = np.cumsum(functional(train, estimator)[::-1], axis=0)[::-1]
    return np.ascontiguousarray(onwards[1:])


def states(
    train: Train, estimator: Estimator, clean: FloatArray, which: IndexArray, level: FloatArray, noise: FloatArray
) -> FloatArray:
    """Return the states (draw, noise, 2 * frequency), NaN where the estimator refuses a realisation.

    ``clean`` (draw, echo, ...) and ``noise`` (draw, noise, pulse, ...) in the form of the estimator, ``which`` (pulse,)
    the echo of every pulse, ``level`` (draw,) of the noise.
    """
    if spec_of(estimator).reads_peak:
        return _peaks_states(train, estimator, clean, which, level, noise)
    noisy = clean[:, None, which] + level[:, None, None, None] * noise
    # A realisation without an echo is NaN; an estimator refuses an array that has no other.
    try:
        return _states(train, estimator, noisy)
    except ValueError:
        return np.full((*noisy.shape[:2], 2 * len(train.frequencies_hz)), np.nan)


def _states(train: Train, estimator: Estimator, noisy: FloatArray) -> FloatArray:
    spec = spec_of(estimator)
    if spec.band_phase is not None:
        phase, _, mean_hz = spec.band_phase(_complex(noisy), spectral_kernels(train).band, True)
        return np.asarray((phase * _metres(train) / mean_hz[..., None]) @ functional(train, estimator))
    return np.asarray(motion_of(train.gate(noisy), estimator).displacement_m @ functional(train, estimator))


def _peaks_states(
    train: Train, estimator: Estimator, clean: FloatArray, which: IndexArray, level: FloatArray, noise: FloatArray
) -> FloatArray:
    step, peak = noisy_peak_steps(clean, which, level, noise)
    step_m = step * _metres(train) / spectral_kernels(train).grid_hz["peak"][peak]
    return np.asarray(step_m @ step_functional(train, estimator))


def _complex(both: FloatArray) -> ComplexArray:
    """Return spectra (..., bin) of their real and imaginary parts (..., 2 * bin)."""
    bins = both.shape[-1] // 2
    return np.asarray(both[..., :bins] + 1j * both[..., bins:])


def _metres(train: Train) -> float:
    """Return displacement over phase, times the frequency: m Hz/rad."""
    return -train.sound_speed_m_per_s / (4 * np.pi)


def refuse_unusable(train: Train, estimators: Sequence[Estimator]) -> None:
    """Raise ``ValueError`` where the train cannot carry an estimate, before anything is drawn."""
    spectral_kernels(train)
    for estimator in estimators:
        functional(train, estimator)
