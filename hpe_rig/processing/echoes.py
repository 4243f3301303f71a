"""Gated echoes, displacement and velocity: the values that every motion estimator shares, and spectra in the band."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.fft import rfft

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
BoolArray = NDArray[np.bool_]
Volts = NDArray[np.floating[Any]]

BAND = (0.5, 1.5)
"""The transmitted band in units of the carrier: DC and the tonebursts' band stay outside, 75 % bandwidth inside."""
LEAST_IN_BAND = 1e-20
LEAST_IN_FLOAT32 = 1e-12
"""Share of a train's energy that must lie in the band: below it there is nothing but rounding."""
FFT_WORTH = 6.0
"""Products a point and doubling from which on a whole FFT costs less than the wanted bins one by one, measured."""


@dataclass(frozen=True, slots=True)
class EchoGate:
    """Gated echoes of one train, ready for estimation; raises ``ValueError`` when shapes or values do not fit.

    ``volts`` (..., pulse, sample), float64 or float32: leading axes are independent realisations. ``pulse_time_s``
    (pulse,): when each pulse senses the displacement (fired plus z/c), increasing. ``valid`` (pulse,): False where a
    record is missing or flagged; the samples of such a pulse do not matter. ``energy`` (..., pulse): the gate's, V^2.
    """

    volts: Volts
    sample_rate_hz: float
    pulse_time_s: FloatArray
    carrier_hz: float
    sound_speed_m_per_s: float
    valid: BoolArray
    energy: FloatArray = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        pulses = self.volts.shape[-2] if self.volts.ndim >= 2 else 0
        if pulses == 0 or self.pulse_time_s.shape != (pulses,) or self.valid.shape != (pulses,):
            raise ValueError(
                f"volts {self.volts.shape}, pulse_time_s {self.pulse_time_s.shape} and valid {self.valid.shape} do not "
                "fit: volts needs the axes (..., pulse, sample), the others (pulse,)"
            )
        if self.volts.dtype not in (np.float64, np.float32):
            raise ValueError(f"volts of type {self.volts.dtype}: turn codes into volts, float64 or float32, first")
        if not np.all(np.diff(self.pulse_time_s) > 0):
            raise ValueError("pulse_time_s does not increase: records are out of order; sort them by pulse time")
        object.__setattr__(self, "energy", pulse_energy(self.volts))
        if not np.isfinite(self.energy[..., self.valid]).all():
            raise ValueError("a pulse marked valid holds samples that are not finite: mark it invalid or read it again")

    def without(self, pulses: BoolArray) -> EchoGate:
        """Return the same gate, its ``pulses`` (pulse,) no longer valid."""
        fewer = copy(self)
        object.__setattr__(fewer, "valid", self.valid & ~pulses)
        return fewer


@dataclass(frozen=True, slots=True)
class Motion:
    """Displacement per pulse, up to a constant.

    ``time_s`` (pulse,); ``displacement_m`` (..., pulse), NaN where not valid; ``variance_m2`` (..., pulse), from the
    echoes' own scatter, not from the displacement; ``valid`` (pulse,). ``largest_step`` (...): the largest change
    between consecutive valid pulses in quarter wavelengths: near 1 the next period cannot be told from this one.
    ``walk`` (...): where the displacement is a sum of steps, the variance of the noise that is a step's own and adds up
    from pulse to pulse, over that of a pulse; None where each pulse stands for itself.
    """

    time_s: FloatArray
    displacement_m: FloatArray
    variance_m2: FloatArray
    valid: BoolArray
    largest_step: FloatArray | float = 0.0
    walk: FloatArray | None = None


@dataclass(frozen=True, slots=True)
class Velocity:
    """Mean velocity between consecutive pulses; interval n lies between pulses n and n + 1.

    ``time_s`` (interval,): its middle; ``interval_s`` (interval,): its length; ``velocity_m_per_s`` (..., interval),
    NaN where not valid; ``valid`` (interval,): both pulses are there.
    """

    time_s: FloatArray
    interval_s: FloatArray
    velocity_m_per_s: FloatArray
    valid: BoolArray


def velocity_between_pulses(motion: Motion) -> Velocity:
    """Return the mean velocity of every interval whose two pulses are valid."""
    interval_s = np.diff(motion.time_s)
    return Velocity(
        motion.time_s[:-1] + interval_s / 2,
        interval_s,
        np.diff(motion.displacement_m, axis=-1) / interval_s,
        motion.valid[:-1] & motion.valid[1:],
    )


def relative_to(motion: Motion, reference: Motion) -> Motion:
    """Return ``motion`` less that of a ``reference`` that stands still, at the pulses valid in both; variances add.

    Both come from the same records: a pulse fired late, or a clock read late, delays every echo of a record alike, so
    that the trigger jitter that both share cancels.
    Raises ``ValueError`` where their pulses differ.
    """
    if not np.array_equal(motion.time_s, reference.time_s):
        raise ValueError("motion and reference stand at different times: estimate both from the same records")
    walks = [each.walk for each in (motion, reference) if each.walk is not None]
    return Motion(
        motion.time_s,
        motion.displacement_m - reference.displacement_m,
        motion.variance_m2 + reference.variance_m2,
        motion.valid & reference.valid,
        motion.largest_step,
        np.asarray(sum(walks) / 2) if walks else None,
    )


def valid_volts(echoes: EchoGate) -> Volts:
    """Return the echoes (..., valid pulse, sample); no copy where every pulse is valid."""
    return echoes.volts if echoes.valid.all() else echoes.volts[..., echoes.valid, :]


def pulse_energy(volts: Volts) -> FloatArray:
    """Return the energy (...) of volts (..., sample), in the precision that these have."""
    with np.errstate(invalid="ignore"):
        return np.asarray(np.einsum("...i,...i->...", volts, volts), dtype=np.float64)


def scatter(values: FloatArray, valid: BoolArray) -> FloatArray:
    """Return values (..., valid pulse) at their places among all pulses, NaN elsewhere."""
    if valid.all():
        return values
    placed = np.full((*values.shape[:-1], valid.size), np.nan)
    placed[..., valid] = values
    return placed


def band_spectrum(echoes: EchoGate, least_pulses: int) -> tuple[ComplexArray, FloatArray]:
    """Return the spectrum (..., valid pulse, bin) of the unwindowed gate in the band, and its frequencies (bin,).

    Raises ``ValueError`` for too few valid pulses, a gate too short to hold two frequencies of the band, and trains
    without echo in it.
    """
    require_pulses(echoes, least_pulses)
    frequency_hz = band_grid(echoes, echoes.volts.shape[-1])
    spectrum = valid_spectrum(echoes, frequency_hz)
    require_echo(spectrum, echoes)
    return spectrum, frequency_hz


def valid_spectrum(echoes: EchoGate, frequency_hz: FloatArray, window: FloatArray | None = None) -> ComplexArray:
    """Return the spectrum (..., valid pulse, bin) of the gate, times a window (sample,) where wanted."""
    volts = echoes.volts if window is None else echoes.volts * window.astype(echoes.volts.dtype)
    # a few bins of what is not valid cost less than a copy of all samples that are; they may hold anything
    with np.errstate(invalid="ignore"):
        spectrum = spectrum_at(volts, echoes.sample_rate_hz, frequency_hz)
    if echoes.valid.all():
        return spectrum
    return np.swapaxes(np.compress(echoes.valid, np.swapaxes(spectrum, -1, -2), axis=-1), -1, -2)


def require_pulses(echoes: EchoGate, least: int) -> None:
    """Raise ``ValueError`` for fewer than ``least`` valid pulses."""
    found = int(echoes.valid.sum())
    if found < least:
        raise ValueError(f"{found} valid pulses, {least} needed: records are missing; try more tracking pulses")


def require_echo(spectrum: ComplexArray, echoes: EchoGate) -> None:
    """Raise ``ValueError`` where a train's band (..., valid pulse, bin) holds nothing but the rounding of its volts."""
    in_band = (spectrum.real**2 + spectrum.imag**2).sum(axis=(-2, -1))
    total = echoes.energy[..., echoes.valid].sum(axis=-1) * echoes.volts.shape[-1]
    least = LEAST_IN_FLOAT32 if echoes.volts.dtype == np.float32 else LEAST_IN_BAND
    if not np.all(in_band > least * total):
        raise ValueError(
            "no echo: the gate is constant or zero in the transmitted band; check gate, input range and tracking pulser"
        )


def band_grid(echoes: EchoGate, bins: int) -> FloatArray:
    """Return the frequencies (bin,) of a ``bins``-point FFT inside the transmitted band, below half the sample rate."""
    grid_hz = np.arange(bins // 2) * echoes.sample_rate_hz / bins
    low, high = (edge * echoes.carrier_hz for edge in BAND)
    inside = grid_hz[(grid_hz >= low) & (grid_hz <= high)]
    if inside.size < 2:
        raise ValueError(
            f"a gate of {echoes.volts.shape[-1]} samples at {echoes.sample_rate_hz:g} Hz has {inside.size} frequencies "
            f"between {low:g} and {high:g} Hz, 2 needed: the gate is too short or the carrier wrong; try a longer gate"
        )
    return inside


def spectrum_at(volts: Volts, sample_rate_hz: float, frequency_hz: FloatArray) -> ComplexArray:
    """Return the Fourier transform (..., bin) of ``volts`` (..., sample) at the wanted, evenly spaced frequencies only.

    In the precision of ``volts``: of float32, 1e-7 of the largest bin.
    """
    samples, count = volts.shape[-1], frequency_hz.size
    spacing = sample_rate_hz / (frequency_hz[1] - frequency_hz[0])
    bins, first = round(spacing), round(frequency_hz[0] * spacing / sample_rate_hz)
    # bins first in memory: what follows works on whole rows of pulses
    spectrum = np.empty((*volts.shape[:-2], count, volts.shape[-2]), dtype=np.complex128)
    by_pulse = np.swapaxes(spectrum, -1, -2)
    if samples * count > FFT_WORTH * bins * np.log2(bins):
        by_pulse[...] = rfft(volts, bins, axis=-1)[..., first : first + count]
        return by_pulse
    angle = 2 * np.pi * np.outer(np.arange(samples) / sample_rate_hz, frequency_hz)
    # one real product: numpy would turn the volts into complex numbers for a complex one
    both = volts.reshape(-1, samples) @ np.hstack([np.cos(angle), -np.sin(angle)]).astype(volts.dtype)
    both = both.reshape(*volts.shape[:-1], 2 * count)
    by_pulse.real, by_pulse.imag = both[..., :count], both[..., count:]
    return by_pulse


def turned(spectrum: ComplexArray, delay_s: FloatArray, frequency_hz: FloatArray) -> ComplexArray:
    """Return spectra (..., pulse, bin) of evenly spaced bins with every pulse advanced by ``delay_s`` (..., pulse).

    Two exponentials a pulse and a running product in place of one exponential a bin.
    """
    step_hz = (frequency_hz[-1] - frequency_hz[0]) / (frequency_hz.size - 1)
    factor = np.exp(2j * np.pi * frequency_hz[0] * delay_s)
    step = np.exp(2j * np.pi * step_hz * delay_s)
    out = np.empty_like(spectrum)
    for index in range(frequency_hz.size):
        np.multiply(spectrum[..., index], factor, out=out[..., index])
        factor *= step
    return out
