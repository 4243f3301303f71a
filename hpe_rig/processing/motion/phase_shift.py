"""Displacement from the phase of echoes, against their mean or from pulse to pulse: one function an estimator.

Positive displacement is away from the transducer: the echo's delay tau = 2 u / c grows, its phase at frequency f
changes by -2 pi f tau. Derivations and sources: docs/explanation/estimation.md.
"""

from __future__ import annotations

import functools
import math
import sys
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from hpe_rig.arrays import BoolArray, ComplexArray, FloatArray
from hpe_rig.processing.echo.band import (
    Band,
    band_spectrum,
    compiled,
    energy_of,
    inner,
    let_go,
    products_with,
    real_product,
    turned,
)
from hpe_rig.processing.echo.echoes import EchoGate, Motion, scatter

DivideBy = Literal["centre", "carrier"]

STEPS_AT_ONCE = 512
"""Pulses whose steps are found together: few enough that all of their products stay in the cache."""
NOISE_DEVIATIONS = 3.1
"""Normal deviations that a train of noise exceeds once in a thousand."""
LEAST_INDEPENDENT = 3.0

LOOP_WORTH = 10_000
"""Echoes of several trains from which on the compiled loop is taken, if Numba is loaded already."""
ALIGNED_AT_ONCE = 1 << 13
"""Pulses that are aligned together: a longer train never lies aligned in memory as a whole."""


def coherent(echoes: EchoGate) -> Motion:
    """Return the displacement of every pulse from its phase against the mean of all other, aligned echoes.

    The phase is that of the inner product over the gate and the whole transmitted band, without a gate window, divided
    by the energy-weighted mean frequency. A first guess from accumulated consecutive phases aligns the echoes, so
    motion of many wavelengths is followed as long as one step stays below a quarter wavelength; the gate cuts them
    after that. Raises ``ValueError`` for fewer than two valid pulses and where no train has an echo in the band; a
    train that has none is NaN. Source: maximum likelihood for a known echo in white noise.
    """
    spectrum, band = band_spectrum(echoes, 2)
    phase, variance, mean_hz = coherent_phase(spectrum, band)
    return motion_of_phase(echoes, phase, variance, mean_hz[..., None])


def coherent_phase(
    spectrum: ComplexArray, band: Band, fast: bool | None = None
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return phase and its variance (..., pulse) against all other echoes, and the mean frequency (...).

    ``fast``: in a compiled loop where there is one; by default for many trains, once Numba is loaded. Both differ by
    rounding. Raises ``ValueError`` where no train has an echo.
    """
    trains, pulses = math.prod(spectrum.shape[:-2]), spectrum.shape[-2]
    if fast is None:
        fast = trains > 1 and trains * pulses >= LOOP_WORTH and "numba" in sys.modules
    if fast and compiled() and pulses <= ALIGNED_AT_ONCE:
        made = _compiled_phase(spectrum, band)
        if np.isfinite(made[2]).any():
            return made
        # what is missing, the other way says
    # of a long train only what is asked for is held: the steps' own products are not
    steps = replace(pulse_steps(spectrum, band), product=np.empty(0, np.complex128))
    # the first pass aligns with single-echo noise, the second with the noise of the mean echo
    found = against_others(spectrum, band, steps, steps.delay_s, steps.energy)
    phase = steps.phase + np.angle(found.product)
    delay_s = -phase / (2 * np.pi * found.mean_hz[..., None])
    # the first pass' arrays make room for the second's
    steps = replace(steps, phase=np.empty(0), energy=np.empty(0))
    del found
    found = against_others(spectrum, band, steps, delay_s)
    phase += np.angle(found.product)
    return phase, found.variance, found.mean_hz


def _compiled_phase(spectrum: ComplexArray, band: Band) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return what `coherent_phase` does, NaN where there is no echo."""
    from hpe_rig.processing.motion.phase_shift_numba import coherent_phase as loop

    pulses, bins = spectrum.shape[-2:]
    every = np.ascontiguousarray(spectrum, dtype=np.complex128).reshape(-1, pulses, bins)
    phase, variance, mean_hz = np.empty((len(every), pulses)), np.empty((len(every), pulses)), np.empty(len(every))
    least = least_alike(pulses - 1, band.independent)
    loop(every, band.root, band.noise, band.noise_energy, band.frequency_hz, least, phase, variance, mean_hz)
    shape = spectrum.shape[:-1]
    return phase.reshape(shape), variance.reshape(shape), mean_hz.reshape(shape[:-1])


def kasai(echoes: EchoGate, *, divide_by: DivideBy = "carrier") -> Motion:
    """Return the displacement as the sum of steps from consecutive echoes' phase, averaged over the gate.

    The phase is that of the complex echoes' lag-one correlation, divided by the carrier, as published, or by the
    train's mean frequency. Raises ``ValueError`` as ``coherent``. Source: Kasai et al. (1985).
    """
    spectrum, band = band_spectrum(echoes, 2)
    steps = pulse_steps(spectrum, band)
    divisor_hz = steps.mean_hz if divide_by == "centre" else np.full_like(steps.mean_hz, echoes.carrier_hz)
    variance, walk = noise_of_steps(np.abs(steps.product), steps.energy, band.independent)
    return motion_of_phase(echoes, steps.phase, variance, divisor_hz[..., None], walk)


def loupas(echoes: EchoGate) -> Motion:
    """Return the displacement as the sum of steps, each phase divided by the centre frequency of its own two echoes.

    The centre frequency is that of the correlation over one sample in depth. Raises ``ValueError`` as ``coherent``.
    Source: Loupas et al. (1995), two-dimensional autocorrelation with two pulses.
    """
    spectrum, band = band_spectrum(echoes, 2)
    turn = _sample_turn(spectrum, band, 2 * np.pi * band.frequency_hz / echoes.sample_rate_hz)
    centre_hz = np.angle(turn[..., :-1] + turn[..., 1:]) / (2 * np.pi) * echoes.sample_rate_hz
    steps = pulse_steps(spectrum, band)
    noise = noise_of_steps(np.abs(steps.product), steps.energy, band.independent)
    return motion_of_steps(echoes, np.angle(steps.product), centre_hz, *noise)


def motion_of_phase(
    echoes: EchoGate, phase: FloatArray, variance: FloatArray, frequency_hz: FloatArray, walk: FloatArray | None = None
) -> Motion:
    """Return the motion of phases (..., valid pulse) and their variance, at a frequency (..., 1) of the train."""
    metres = -echoes.sound_speed_m_per_s / (4 * np.pi * frequency_hz)
    return Motion(
        echoes.pulse_time_s,
        scatter(phase * metres, echoes.valid),
        scatter(variance * metres**2, echoes.valid),
        echoes.valid,
        np.abs(np.diff(phase, axis=-1)).max(axis=-1) / np.pi,
        walk,
    )


def motion_of_steps(
    echoes: EchoGate, step: FloatArray, frequency_hz: FloatArray, pulse_variance: FloatArray, walk: FloatArray
) -> Motion:
    """Return the motion whose phase changes by ``step`` (..., valid pulse - 1), each at its own frequency."""
    metres = -echoes.sound_speed_m_per_s / (4 * np.pi * frequency_hz)
    start = np.zeros((*step.shape[:-1], 1))
    displacement_m = np.concatenate([start, np.cumsum(step * metres, axis=-1)], axis=-1)
    scale = np.concatenate([metres[..., :1], metres], axis=-1) ** 2
    return Motion(
        echoes.pulse_time_s,
        scatter(displacement_m, echoes.valid),
        scatter(pulse_variance * scale, echoes.valid),
        echoes.valid,
        np.abs(step).max(axis=-1) / np.pi,
        walk,
    )


@dataclass(frozen=True, slots=True)
class PulseSteps:
    """Echoes of every train from pulse to pulse, over the gate, none of them aligned.

    ``product`` (..., pulse - 1) of each with the next; ``phase`` (..., pulse) against the first by adding theirs;
    ``mean_hz`` (...) of what neighbours have in common. ``energy`` (..., pulse) and ``moment`` (...), energy times
    frequency of all; ``whole`` (..., pulse): energy with the margins.
    """

    product: ComplexArray
    phase: FloatArray
    mean_hz: FloatArray
    energy: FloatArray
    moment: FloatArray
    whole: FloatArray

    @property
    def delay_s(self) -> FloatArray:
        """By how much each echo (..., pulse) is late."""
        return np.asarray(-self.phase / (2 * np.pi * self.mean_hz[..., None]))


def pulse_steps(spectrum: ComplexArray, band: Band) -> PulseSteps:
    """Return how echoes (..., pulse, bin) step from pulse to pulse."""
    trains, pulses = spectrum.shape[:-2], spectrum.shape[-2]
    # of bins and of columns in the margins: sums, and sums weighted by frequency
    weights = np.stack([np.ones(band.frequency_hz.size), band.frequency_hz])
    columns = np.vstack([band.root.T, band.root.T * band.frequency_hz])
    cross, moment = (np.empty((*trains, pulses - 1), dtype=np.complex128) for _ in range(2))
    power, whole = (np.empty((*trains, pulses)) for _ in range(2))
    power_moment = np.zeros(trains)
    by_bin = np.swapaxes(spectrum, -1, -2)
    # a few pulses at a time, and the one before: what is made of them stays in the cache
    for first in range(0, pulses, STEPS_AT_ONCE):
        here = slice(first, first + STEPS_AT_ONCE)
        echo = np.ascontiguousarray(by_bin[..., max(first - 1, 0) : here.stop], dtype=np.complex128)
        outside, weighted = np.split(real_product(columns, echo), 2, axis=-2)
        product = real_product(weights, np.conj(echo[..., :-1]) * echo[..., 1:])
        product[..., 0, :] -= _neighbours(outside, outside)
        product[..., 1, :] -= (_neighbours(outside, weighted) + _neighbours(weighted, outside)) / 2
        both = slice(max(first - 1, 0), here.stop - 1)
        cross[..., both], moment[..., both] = product[..., 0, :], product[..., 1, :]
        new = slice(min(first, 1), None)
        squares = weights @ np.square(echo.view(np.float64))
        energy = (squares[..., ::2] + squares[..., 1::2])[..., new]
        whole[..., here] = energy[..., 0, :]
        energy[..., 0, :] -= _overlap(outside, outside)[..., new]
        energy[..., 1, :] -= _overlap(outside, weighted)[..., new]
        power[..., here] = energy[..., 0, :]
        power_moment += energy[..., 1, :].sum(axis=-1)
        if here.stop % ALIGNED_AT_ONCE == 0:
            let_go(spectrum)
    size = np.abs(cross)
    cross[~alike(size, power, band.independent)] = np.nan
    # what neighbours have in common is in phase once their step is undone
    common = np.einsum("...i,...i->...", np.conj(cross) / np.where(size > 0, size, 1.0), moment).real
    del moment
    mean_hz = mean_frequency(common, np.abs(cross).sum(axis=-1), band)
    phase = np.zeros((*trains, pulses))
    np.cumsum(np.angle(cross), axis=-1, out=phase[..., 1:])
    return PulseSteps(cross, phase, mean_hz, power, power_moment, whole)


def alike(cross: FloatArray, energy: FloatArray, independent: float) -> BoolArray:
    """Return which trains (...) correlate from pulse to pulse by more than noise alone would, once in a thousand.

    ``cross`` (..., pulse - 1) is the magnitude of every echo's product with the next, ``energy`` (..., pulse) theirs.
    Two echoes of noise, of M independent numbers each, correlate by rho, of which rho^2 follows a beta distribution
    (1, M - 1); the mean over the train, every pair alike so that one spike does not count for all, is nearly normal.
    What correlates no more has no phase to follow. Raises ``ValueError`` where no train does.
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        rho = cross / np.sqrt(energy[..., :-1] * energy[..., 1:])
    found = np.asarray(rho.mean(axis=-1) > least_alike(rho.shape[-1], independent))
    if not found.any():
        whose = "the echoes" if found.size == 1 else f"echoes of all {found.size} trains"
        raise ValueError(
            f"{whose} have no more in common from pulse to pulse than noise alone: noise without echo, or the wrong "
            "gate or carrier; check gate, tracking pulser and input range"
        )
    return found


def least_alike(pairs: int, independent: float) -> float:
    """Return the mean correlation of so many ``pairs`` of echoes that noise alone exceeds once in a thousand trains."""
    # a gate of hardly more than one independent number cannot tell: there all is taken that is not clearly noise
    many = max(independent, LEAST_INDEPENDENT)
    mean = math.exp(math.lgamma(1.5) + math.lgamma(many) - math.lgamma(many + 0.5))
    return mean + NOISE_DEVIATIONS * math.sqrt(max(1 / many - mean**2, 0.0) / pairs)


def _neighbours(before: ComplexArray, after: ComplexArray) -> ComplexArray:
    """Return the product (..., pulse - 1) of every echo (..., column, pulse) with the next of the others."""
    return np.asarray(np.einsum("...ij,...ij->...j", np.conj(before[..., :-1]), after[..., 1:]))


def _overlap(one: ComplexArray, other: ComplexArray) -> FloatArray:
    """Return the real part of the product (..., pulse) of every echo (..., column, pulse) with its other."""
    return np.asarray(
        np.einsum("...ij,...ij->...j", one.real, other.real) + np.einsum("...ij,...ij->...j", one.imag, other.imag)
    )


@dataclass(frozen=True, slots=True)
class Compared:
    """Aligned echoes of every train against the sum of its other echoes, over the gate.

    The ``gated`` sum of all (..., bin); ``product`` (..., pulse) of the others with each; ``variance`` (..., pulse) of
    its phase; ``mean_hz`` (...) of what they have in common.
    """

    gated: ComplexArray
    product: ComplexArray
    variance: FloatArray
    mean_hz: FloatArray


def against_others(
    spectrum: ComplexArray, band: Band, steps: PulseSteps, delay_s: FloatArray, energy: FloatArray | None = None
) -> Compared:
    """Return how echoes (..., pulse, bin) compare with their others once advanced by ``delay_s`` (..., pulse).

    ``energy`` (..., pulse), that of each echo in the gate once it is aligned, is found where not given.
    """
    # echoes meet in the middle of their motion: what the gate cuts is then nearest to what all of them hold
    delay_s = delay_s - delay_s.mean(axis=-1, keepdims=True)
    blocks = [slice(first, first + ALIGNED_AT_ONCE) for first in range(0, spectrum.shape[-2], ALIGNED_AT_ONCE)]

    @functools.lru_cache(maxsize=1)
    def aligned(block: int) -> ComplexArray:
        """Return some of the pulses; a long train is aligned twice and never as a whole."""
        pulses = blocks[block]
        let_go(spectrum)
        return turned(spectrum[..., pulses, :], delay_s[..., pulses], band.frequency_hz)

    total = np.sum([aligned(block).sum(axis=-2) for block in range(len(blocks))], axis=0)
    gated = band.gated(total)
    total_energy = inner(gated, total)
    others, tiny = spectrum.shape[-2] - 1, np.finfo(np.float64).tiny
    # of the noise in the gate, what lies along the echo turns its phase, the rest is misfit
    along = band.noise_along(gated, total_energy)[..., None]
    own_energy = np.zeros(spectrum.shape[:-2])
    product, variance = np.empty(spectrum.shape[:-1], np.complex128), np.empty(spectrum.shape[:-1])
    # block by block also what is made of each pulse: of a long train two arrays are held, not ten
    for block, here in enumerate(blocks):
        with_total = products_with(gated, aligned(block))
        own = steps.whole[..., here] - energy_of(band.outside(aligned(block))) if energy is None else energy[..., here]
        # a pulse's own noise in its reference would pull its phase to zero: the reference is the total less the pulse
        product[..., here] = with_others = with_total - own
        reference = np.maximum(total_energy[..., None] - 2 * with_total.real + own, tiny)
        misfit = np.maximum(own - np.abs(with_others) ** 2 / reference, 0.0)
        variance[..., here] = misfit * along / (band.noise_energy - along) / (2 * reference) * others**2
        own_energy += own.sum(axis=-1)
    # the moment of single echoes changes in second order only as they move about their middle
    moment = inner(gated, total * band.frequency_hz) - steps.moment
    mean_hz = mean_frequency(moment, total_energy - own_energy, band)
    return Compared(gated, product, variance, mean_hz)


def _sample_turn(spectrum: ComplexArray, band: Band, angle: FloatArray) -> ComplexArray:
    """Return the correlation (..., pulse) of every echo over one sample, with ``angle`` (bin,) a sample."""
    turn = np.exp(1j * angle)
    # half of it with the next sample and half with the one before: the gate's two ends then count alike
    spectrum = spectrum.astype(np.complex128, copy=False)
    outside, next_, last = (band.outside(spectrum * each) for each in (1.0, turn, np.conj(turn)))
    margins = np.conj(outside) * next_ + np.conj(last) * outside
    return np.asarray((spectrum.real**2 + spectrum.imag**2) @ turn - margins.sum(axis=-1) / 2)


def mean_frequency(moment: FloatArray, energy: FloatArray, band: Band) -> FloatArray:
    """Return the mean frequency (...) of the ``energy`` (...) that aligned echoes have in common, from its ``moment``.

    Real parts of inner products between pulses, not magnitudes: noise then averages to zero instead of pulling the mean
    to the middle of the band. NaN for trains that have nothing in common in the band; raises ``ValueError`` where no
    train has.
    """
    low_hz, high_hz = band.frequency_hz[[0, -1]]
    mean_hz = moment / np.where(energy > 0, energy, 1.0)
    usable = (energy > 0) & (mean_hz >= low_hz) & (mean_hz <= high_hz)
    if not usable.any():
        raise ValueError(
            f"echoes of all {usable.size} trains have no common part between {low_hz:g} and {high_hz:g} Hz: noise "
            "without echo, or the wrong carrier; check both"
        )
    return np.where(usable, mean_hz, np.nan)


def noise_of_steps(cross: FloatArray, energy: FloatArray, independent: float) -> tuple[FloatArray, FloatArray]:
    """Return the phase variance (..., pulse) that the correlation of consecutive echoes implies, and its walk (...).

    Two echoes that correlate by rho over M independent numbers differ in phase by (1/rho^2 - 1) / (2 M); half of that
    is one pulse's. A pulse takes the better of its two neighbours. The walk is the variance of a step's own noise over
    that of a pulse: noise times noise of two pulses does not return with the other sign in the next step; it is noise
    over signal power, and rho is signal over signal plus noise.
    """
    tiny = np.finfo(np.float64).tiny
    both = energy[..., :-1] * energy[..., 1:]
    step = np.maximum(np.maximum(both, tiny) / np.maximum(cross**2, tiny) - 1, 0.0) / (4 * independent)
    variance = np.minimum(np.concatenate([step[..., :1], step], -1), np.concatenate([step, step[..., -1:]], -1))
    walk = np.sqrt(both).sum(axis=-1) / np.maximum(cross.sum(axis=-1), tiny) - 1
    return np.asarray(variance), np.asarray(np.maximum(walk, 0.0))
