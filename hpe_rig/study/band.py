"""From echoes and noise to amplitude and phase, for many realisations: what a train of pulses and a gate fix.

Every estimator here looks at a gate through its spectrum in the transmitted band alone, that is through some fifty
numbers (`basis`) of its hundred or more samples. White noise in the samples is white noise in those numbers, so it is
drawn there: exactly the same statistics for fewer random numbers. And the way from displacements to amplitude and
phase is linear (least squares, or the paper's band-pass, Hann window and Kalman filter), so it is one matrix.
"""

from __future__ import annotations

import functools
import importlib
import importlib.util
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hpe_rig.processing import EchoGate, Estimator, Motion, Options, estimate, fit_motion, motion_of
from hpe_rig.processing.conditioning import hann
from hpe_rig.processing.echoes import band_grid
from hpe_rig.processing.motion import peak_phase

Floats = NDArray[np.float64]

NEGLIGIBLE = 1e-13
"""Singular values below this share of the largest are rounding."""
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
    def pulse_time_s(self) -> Floats:
        """When each pulse senses the motion, (pulse,)."""
        return self.delay_s + np.arange(self.pulses) / self.pulse_rate_hz

    def gate(self, volts: Floats) -> EchoGate:
        """Return echoes (..., pulse, sample) as the estimators take them."""
        valid = np.ones(self.pulses, dtype=bool)
        return EchoGate(volts, self.sample_rate_hz, self.pulse_time_s, self.carrier_hz, self.sound_speed_m_per_s, valid)


@dataclass(frozen=True, slots=True)
class Band:
    """What a train fixes of the spectra; `band_of` makes it."""

    basis: Floats
    """(number, sample), orthonormal rows: all that any estimator sees of a gate."""
    peak_hz: Floats
    """(bin,), the padded grid of the paper's chain."""
    of_volts: Floats
    """(sample, 2 * bin), Fourier transform of the Hann gate on that grid: real parts, then imaginary parts."""
    of_numbers: Floats
    """(number, 2 * bin), the same of the basis."""


@functools.lru_cache(maxsize=16)
def band_of(train: Train) -> Band:
    """Return what the estimators see of a gate; raises ``ValueError`` for a gate too short for the band."""
    empty = train.gate(np.zeros((train.pulses, train.samples)))
    time_s = np.arange(train.samples) / train.sample_rate_hz
    peak_hz = band_grid(empty, 1 << (PADDING * train.samples - 1).bit_length())
    plain_hz = band_grid(empty, train.samples)
    peak, plain = _fourier(time_s, peak_hz) * hann(train.samples)[:, None], _fourier(time_s, plain_hz)
    left, strength, _ = np.linalg.svd(np.hstack([peak, plain]), full_matrices=False)
    basis = np.ascontiguousarray(left[:, strength > NEGLIGIBLE * strength[0]].T)
    return Band(basis, peak_hz, peak, basis @ peak)


def _fourier(time_s: Floats, frequency_hz: Floats) -> Floats:
    angle = 2 * np.pi * np.outer(time_s, frequency_hz)
    return np.hstack([np.cos(angle), -np.sin(angle)])


@functools.lru_cache(maxsize=64)
def functional(train: Train, estimator: Estimator) -> Floats:
    """Return the matrix (pulse, 2 * frequency) from displacements to A cos(phi), A sin(phi), interleaved."""
    unit = np.eye(train.pulses)
    motion = Motion(train.pulse_time_s, unit, np.ones_like(unit), np.ones(train.pulses, dtype=bool))
    fit = fit_motion(motion, train.frequencies_hz, estimator, options=train.options)
    return np.asarray(fit.state[:, : 2 * len(train.frequencies_hz)])


@functools.lru_cache(maxsize=64)
def step_functional(train: Train) -> Floats:
    """Return the matrix (step, 2 * frequency) of the paper's chain from displacement steps between pulses."""
    onwards = np.cumsum(functional(train, "cross_spectrum")[::-1], axis=0)[::-1]
    return np.ascontiguousarray(onwards[1:])


def peaks_state(train: Train, clean: Floats, which: NDArray[np.intp], level: Floats, noise: Floats) -> Floats:
    """Return the states (draw, noise, 2 * frequency) of the paper's chain.

    ``clean`` (draw, echo, 2 * bin) and ``noise`` (draw, noise, pulse, 2 * bin) as `Band.of_volts` makes them;
    ``which`` (pulse,) the echo of every pulse; ``level`` (draw,) of the noise.
    """
    grid_hz = band_of(train).peak_hz
    if compiled():
        shape = (*noise.shape[:2], train.pulses - 1)
        step, peak = np.empty(shape), np.empty(shape, dtype=np.intp)
        _loop()(clean, which, level, noise, step, peak)
        peak_hz = grid_hz[peak]
    else:
        both = clean[:, None, which] + level[:, None, None, None] * noise
        step, peak_hz = peak_phase(both[..., : grid_hz.size] + 1j * both[..., grid_hz.size :], grid_hz)
    return np.asarray(step / peak_hz * (-train.sound_speed_m_per_s / (4 * np.pi)) @ step_functional(train))


@functools.cache
def compiled() -> bool:
    """Return whether Numba is installed; without it results differ by rounding."""
    return importlib.util.find_spec("numba") is not None


@functools.cache
def _loop() -> Callable[..., None]:
    loop: Callable[..., None] = importlib.import_module("hpe_rig.study.peak_loop").peak_steps
    return loop


def volts_state(train: Train, volts: Floats, estimator: Estimator) -> Floats:
    """Return the states (draw, noise, 2 * frequency) of ``volts`` (draw, noise, pulse, sample) by any estimator.

    NaN where the estimator refuses a realisation, as one that is noise without echo.
    """
    try:
        return _state(train, volts, estimator)
    except ValueError:
        each = [_state_or_nan(train, one, estimator) for one in volts.reshape(-1, *volts.shape[2:])]
        return np.reshape(each, (*volts.shape[:2], -1))


def _state(train: Train, volts: Floats, estimator: Estimator) -> Floats:
    if estimator == "joint":
        fit = estimate(train.gate(volts), train.frequencies_hz, estimator, options=train.options)
        return fit.state[..., : 2 * len(train.frequencies_hz)]
    return np.asarray(motion_of(train.gate(volts), estimator).displacement_m @ functional(train, estimator))


def _state_or_nan(train: Train, volts: Floats, estimator: Estimator) -> Floats:
    try:
        return _state(train, volts, estimator)
    except ValueError:
        return np.full(2 * len(train.frequencies_hz), np.nan)


def refuse_unusable(train: Train, estimators: Sequence[Estimator]) -> None:
    """Raise ``ValueError`` where the train cannot carry an estimate, before anything is drawn."""
    band_of(train)
    for estimator in estimators:
        functional(train, estimator if estimator != "joint" else "coherent")
