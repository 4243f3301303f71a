"""Displacement from the phase of echoes: `coherent` against the mean of the others, `kasai` and `loupas` by steps.

    phi_k = arg <sum of the other aligned echoes, r_k>       coherent
    phi_k = sum over n < k of arg <r_n, r_n+1>               kasai, loupas
    u_k = -c phi_k / (4 pi f)                                f: carrier or mean frequency

An echo from farther away is delayed by tau = 2 u / c and changes phase at frequency f by -2 pi f tau. Derivations and
sources: docs/explanation/estimation.md.
"""

from __future__ import annotations

import functools
import math
import sys
from dataclasses import dataclass, replace

import numpy as np

from hpe_rig.arrays import BoolArray, ComplexArray, FloatArray
from hpe_rig.processing.compilation import numba_installed
from hpe_rig.processing.echo.band import Band, real_inner_product, real_matmul
from hpe_rig.processing.echo.gate import EchoGate, expand_to_pulses
from hpe_rig.processing.echo.spectrum import advanced, band_spectrum, inner_products, release_pages
from hpe_rig.processing.motion.displacement import Motion

STEP_CHUNK = 512
"""Pulses per chunk of consecutive products: few enough that they stay in the cache."""
ALIGNED_CHUNK = 1 << 13
"""Pulses aligned together: a longer train is never aligned in memory as a whole."""
NOISE_DEVIATIONS = 3.1
"""Standard deviations of a normal variable that are exceeded once in a thousand."""
COMPILED_ECHOES = 10_000
"""Minimum number of echoes for which the compiled loop is faster; used only if Numba is loaded already."""


def coherent(echoes: EchoGate) -> Motion:
    """Return the displacement of every pulse from its phase against the mean of all other, aligned echoes.

    The phase is that of the inner product over the gate and the whole transmitted band, without a gate window, divided
    by the energy-weighted mean frequency. The accumulated phases of consecutive pulses align the echoes first, so that
    motion of many wavelengths is followed if each step is below a quarter wavelength. The gate cuts the aligned echoes.
    Raises ``ValueError`` for fewer than two valid pulses and if no train has an echo in the band; a single train
    without an echo is NaN. Source: maximum likelihood for a known echo in white noise.
    """
    spectrum, band = band_spectrum(echoes)
    trains, pulses = math.prod(spectrum.shape[:-2]), spectrum.shape[-2]
    use_compiled = trains > 1 and trains * pulses >= COMPILED_ECHOES and "numba" in sys.modules
    phase, variance, mean_hz = coherent_phase(spectrum, band, use_compiled)
    return motion_of_phase(echoes, phase, variance, mean_hz[..., None])


def coherent_phase(spectrum: ComplexArray, band: Band, use_compiled: bool) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return phase and its variance (..., pulse) against the sum of all other echoes, and the mean frequency (...), Hz.

    ``spectrum`` (..., pulse, bin). Two passes align the echoes: the first by the accumulated phase steps between
    consecutive pulses, the second by the phases of the first pass. ``use_compiled``: by the compiled loop if Numba is
    installed; the results differ by rounding. Raises ``ValueError`` if no train has an echo.
    """
    # The compiled loop keeps a whole aligned train in memory; a longer train is aligned in chunks of ALIGNED_CHUNK.
    if use_compiled and numba_installed() and spectrum.shape[-2] <= ALIGNED_CHUNK:
        result = _compiled_phase(spectrum, band)
        if np.isfinite(result[2]).any():
            return result
        # Without an echo in any train, the NumPy form below raises the error that names the cause.
    # The product of each pair of echoes is large for a long train and not needed: its memory is released.
    steps = replace(pulse_steps(spectrum, band), product=np.empty(0, np.complex128))
    # First pass: delays from the accumulated steps, which add up the noise of single echoes.
    first = compare_with_others(spectrum, band, steps, steps.delay_s, steps.energy)
    phase = steps.phase + np.angle(first.product)
    delay_s = -phase / (2 * np.pi * first.mean_hz[..., None])
    # Second pass: delays from the phase against the sum of the other echoes, with less noise.
    # Arrays of the first pass are released before the second allocates its own.
    steps = replace(steps, phase=np.empty(0), energy=np.empty(0))
    del first
    second = compare_with_others(spectrum, band, steps, delay_s)
    phase += np.angle(second.product)
    return phase, second.variance, second.mean_hz


def _compiled_phase(spectrum: ComplexArray, band: Band) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the phase of each echo against the sum of all others, its variance, and the mean frequency of each train.

    ``spectrum`` (..., pulse, bin). Phase, rad, and variance, rad², are (..., pulse), the frequency, Hz, is (...). All
    are NaN for a train without an echo. Computed train by train, in a loop that Numba compiles.
    """
    from hpe_rig.processing.motion.phase_shift_numba import coherent_phase as compiled_loop

    pulses, bins = spectrum.shape[-2:]
    trains = np.ascontiguousarray(spectrum, dtype=np.complex128).reshape(-1, pulses, bins)
    phase, variance, mean_hz = np.empty((len(trains), pulses)), np.empty((len(trains), pulses)), np.empty(len(trains))
    # Consecutive echoes that correlate less are noise: the train has no echo.
    threshold = min_correlation(pulses - 1, band.independent_samples)
    # The loop cuts echoes to the gate by ``margin_root``, which projects spectra onto the margins around the gate. The
    # variance follows from the noise's covariance between bins, and from its energy in the gate. The loop writes the
    # last three arrays.
    compiled_loop(
        trains,
        band.margin_root,
        band.noise,
        band.noise_energy,
        band.frequency_hz,
        threshold,
        phase,
        variance,
        mean_hz,
    )
    shape = spectrum.shape[:-1]
    return phase.reshape(shape), variance.reshape(shape), mean_hz.reshape(shape[:-1])


def kasai(echoes: EchoGate) -> Motion:
    """Return the displacement as a sum of steps, each from the phase between consecutive echoes averaged over the gate.

    The phase is that of the complex echoes' lag-one correlation, divided by the carrier frequency as published. Raises
    ``ValueError`` for fewer than two valid pulses and without an echo. Source: Kasai et al. (1985).
    """
    spectrum, band = band_spectrum(echoes)
    steps = pulse_steps(spectrum, band)
    carrier_hz = np.full(steps.product.shape, echoes.carrier_hz)
    variance, step_noise_ratio = noise_of_steps(np.abs(steps.product), steps.energy, band.independent_samples)
    return motion_of_steps(echoes, np.angle(steps.product), carrier_hz, variance, step_noise_ratio)


def loupas(echoes: EchoGate) -> Motion:
    """Return the displacement as a sum of steps, each phase divided by the centre frequency of its two echoes.

    The centre frequency is the phase of the autocorrelation over one sample in depth. Raises ``ValueError`` for fewer
    than two valid pulses and without an echo. Source: Loupas et al. (1995), two-dimensional autocorrelation with two
    pulses.
    """
    spectrum, band = band_spectrum(echoes)
    lag_one = _depth_correlation(spectrum, band, echoes.sample_rate_hz)
    centre_hz = np.angle(lag_one[..., :-1] + lag_one[..., 1:]) / (2 * np.pi) * echoes.sample_rate_hz
    steps = pulse_steps(spectrum, band)
    variance, step_noise_ratio = noise_of_steps(np.abs(steps.product), steps.energy, band.independent_samples)
    return motion_of_steps(echoes, np.angle(steps.product), centre_hz, variance, step_noise_ratio)


def motion_of_phase(echoes: EchoGate, phase: FloatArray, variance: FloatArray, frequency_hz: FloatArray) -> Motion:
    """Return the displacement -c phase / (4 pi f) of ``phase`` (..., valid pulse), with its variance.

    ``variance`` (..., valid pulse): that of the phase, rad². ``frequency_hz`` f (..., 1): that of the train's echoes.
    """
    # A phase of pi is a quarter wavelength of displacement.
    metres_per_radian = -echoes.sound_speed_m_per_s / (4 * np.pi * frequency_hz)
    return Motion(
        time_s=echoes.pulse_time_s,
        displacement_m=expand_to_pulses(phase * metres_per_radian, echoes.valid),
        variance_m2=expand_to_pulses(variance * metres_per_radian**2, echoes.valid),
        valid=echoes.valid,
        # Largest phase step as a fraction of pi, where the phase becomes ambiguous.
        largest_step=np.abs(np.diff(phase, axis=-1)).max(axis=-1) / np.pi,
    )


def motion_of_steps(
    echoes: EchoGate, step: FloatArray, frequency_hz: FloatArray, variance: FloatArray, step_noise_ratio: FloatArray
) -> Motion:
    """Return the displacement as the sum of phase steps (..., valid pulse - 1), each divided by its own frequency.

    ``variance`` (..., valid pulse): of a pulse's phase. ``step_noise_ratio`` (...): variance that each step adds to all
    later pulses, over that of a pulse.
    """
    metres_per_radian = -echoes.sound_speed_m_per_s / (4 * np.pi * frequency_hz)
    # The displacement starts at 0 and accumulates the steps.
    start = np.zeros((*step.shape[:-1], 1))
    displacement_m = np.concatenate([start, np.cumsum(step * metres_per_radian, axis=-1)], axis=-1)
    # The first pulse has no step before it and takes the factor of the next.
    square_metres = np.concatenate([metres_per_radian[..., :1], metres_per_radian], axis=-1) ** 2
    return Motion(
        time_s=echoes.pulse_time_s,
        displacement_m=expand_to_pulses(displacement_m, echoes.valid),
        variance_m2=expand_to_pulses(variance * square_metres, echoes.valid),
        valid=echoes.valid,
        largest_step=np.abs(step).max(axis=-1) / np.pi,
        step_noise_ratio=step_noise_ratio,
    )


@dataclass(frozen=True, slots=True)
class PulseSteps:
    """Products of consecutive echoes over the gate, before alignment.

    ``product`` (..., pulse - 1): of each echo with the next. ``phase`` (..., pulse): accumulated against the first
    pulse. ``mean_hz`` (...): mean frequency of the part common to neighbours. ``energy`` (..., pulse) in the gate;
    ``energy_with_margins`` (..., pulse). ``moment`` (...): energy times frequency, summed over pulses.
    """

    product: ComplexArray
    phase: FloatArray
    mean_hz: FloatArray
    energy: FloatArray
    moment: FloatArray
    energy_with_margins: FloatArray

    @property
    def delay_s(self) -> FloatArray:
        """Delay of each echo (..., pulse) against the first."""
        return np.asarray(-self.phase / (2 * np.pi * self.mean_hz[..., None]))


def pulse_steps(spectrum: ComplexArray, band: Band) -> PulseSteps:
    """Return the inner products of consecutive echoes over the gate, with their phases, energies and mean frequency.

    ``spectrum`` (..., pulse, bin) is that of gate and margins; the part of the margins is subtracted from each product.
    Raises ``ValueError`` if no train has an echo.
    """
    trains, pulses = spectrum.shape[:-2], spectrum.shape[-2]
    # Every product is summed over bins twice: plain, and weighted by frequency (moment) for the mean frequency.
    weights = np.stack([np.ones(band.frequency_hz.size), band.frequency_hz])
    to_margins = np.vstack([band.margin_root.T, band.margin_root.T * band.frequency_hz])
    cross, cross_moment = (np.empty((*trains, pulses - 1), dtype=np.complex128) for _ in range(2))
    energy, energy_with_margins = (np.empty((*trains, pulses)) for _ in range(2))
    moment = np.zeros(trains)
    by_bin = np.swapaxes(spectrum, -1, -2)
    for first in range(0, pulses, STEP_CHUNK):
        chunk = slice(first, first + STEP_CHUNK)
        # The last pulse of the chunk before is included, for the step to the first pulse of this one.
        start = max(first - 1, 0)
        echo = np.ascontiguousarray(by_bin[..., start : chunk.stop], dtype=np.complex128)
        margin, weighted_margin = np.split(real_matmul(to_margins, echo), 2, axis=-2)
        product = _products_with_next(echo, weights, margin, weighted_margin)
        intervals = slice(start, chunk.stop - 1)
        cross[..., intervals], cross_moment[..., intervals] = product[..., 0, :], product[..., 1, :]
        # Energies of the pulses of this chunk alone.
        chunk_pulses = slice(first - start, None)
        with_margins, gated = (sums[..., chunk_pulses] for sums in _energies(echo, weights, margin, weighted_margin))
        energy_with_margins[..., chunk], energy[..., chunk] = with_margins[..., 0, :], gated[..., 0, :]
        moment += gated[..., 1, :].sum(axis=-1)
        if chunk.stop % ALIGNED_CHUNK == 0:
            release_pages(spectrum)
    magnitude = np.abs(cross)
    cross[~are_correlated(magnitude, energy, band.independent_samples)] = np.nan
    # Mean frequency of the part that consecutive echoes have in common: after removal of its phase step, this part of
    # the frequency-weighted product is real, and noise averages to zero.
    conjugate_phasor = np.conj(cross) / np.where(magnitude > 0, magnitude, 1.0)
    common_moment = np.einsum("...i,...i->...", conjugate_phasor, cross_moment).real
    del cross_moment
    mean_hz = mean_frequency(common_moment, np.abs(cross).sum(axis=-1), band)
    phase = np.zeros((*trains, pulses))
    np.cumsum(np.angle(cross), axis=-1, out=phase[..., 1:])
    return PulseSteps(
        product=cross,
        phase=phase,
        mean_hz=mean_hz,
        energy=energy,
        moment=moment,
        energy_with_margins=energy_with_margins,
    )


def are_correlated(cross: FloatArray, energy: FloatArray, independent_samples: float) -> BoolArray:
    """Return which trains (...) have a mean correlation of consecutive echoes above `min_correlation`.

    ``cross`` (..., pulse - 1): magnitude of each echo's product with the next; ``energy`` (..., pulse);
    ``independent_samples``: effective number of them in the gate. The correlation rho is averaged over the train with
    equal weights, so that one spike does not dominate. Raises ``ValueError`` if no train correlates.
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        rho = cross / np.sqrt(energy[..., :-1] * energy[..., 1:])
    correlated = np.asarray(rho.mean(axis=-1) > min_correlation(rho.shape[-1], independent_samples))
    if not correlated.any():
        subject = "the echoes" if correlated.size == 1 else f"echoes of all {correlated.size} trains"
        raise ValueError(
            f"{subject} have no more in common from pulse to pulse than noise alone: noise without echo, or the wrong "
            "gate or carrier; check gate, tracking pulser and input range"
        )
    return correlated


def min_correlation(pairs: int, independent_samples: float) -> float:
    """Return the threshold of a train's mean correlation over ``pairs`` pairs of echoes.

    Pure noise exceeds it in one train of a thousand. ``independent_samples``: effective number M of independent samples
    in each echo. For two echoes of noise, rho² has a beta distribution (1, M - 1), hence E rho = Gamma(3/2) Gamma(M) /
    Gamma(M + 1/2) and E rho² = 1 / M. The mean over a train is nearly normal.
    """
    # With M = 1 even noise correlates fully, so the threshold is that of M = 3 at least.
    m = max(independent_samples, 3.0)
    mean = math.exp(math.lgamma(1.5) + math.lgamma(m) - math.lgamma(m + 0.5))
    return mean + NOISE_DEVIATIONS * math.sqrt(max(1 / m - mean**2, 0.0) / pairs)


def _products_with_next(
    echo: ComplexArray, weights: FloatArray, margin: ComplexArray, weighted_margin: ComplexArray
) -> ComplexArray:
    """Return the inner product over the gate of each echo with the next: sum over bins, and sum weighted by frequency.

    ``echo`` (..., bin, pulse): spectra of gate and margins. ``margin`` (..., column, pulse): their parts in the
    margins, as coefficients of the columns of ``Band.margin_root``; ``weighted_margin``: those of the spectra times
    frequency. ``weights`` (2, bin): ones and frequencies. Result (..., 2, pulse - 1).
    """
    # Products over gate and margins; the part of the margins is then subtracted.
    product = real_matmul(weights, np.conj(echo[..., :-1]) * echo[..., 1:])
    product[..., 0, :] -= _product_with_next(margin, margin)
    # Frequency may weight the first or the second echo. The margins mix frequencies, so that the two differ: their mean
    # is used, which treats both echoes alike.
    weighted_product = _product_with_next(margin, weighted_margin) + _product_with_next(weighted_margin, margin)
    product[..., 1, :] -= weighted_product / 2
    return product


def _energies(
    echo: ComplexArray, weights: FloatArray, margin: ComplexArray, weighted_margin: ComplexArray
) -> tuple[FloatArray, FloatArray]:
    """Return the energy of each echo over gate and margins, and over the gate alone, both (..., 2, pulse).

    Each is a sum over bins, and a sum weighted by frequency. The arguments are those of ``_products_with_next``.
    """
    # Real and imaginary parts alternate along the last axis.
    squares = weights @ np.square(echo.view(np.float64))
    with_margins = squares[..., ::2] + squares[..., 1::2]
    in_margins = np.stack([_real_product(margin, margin), _real_product(margin, weighted_margin)], axis=-2)
    return with_margins, with_margins - in_margins


def _product_with_next(before: ComplexArray, after: ComplexArray) -> ComplexArray:
    """Return the inner product (..., pulse - 1) of ``before`` (..., column, pulse) with ``after`` one pulse later."""
    return np.asarray(np.einsum("...ij,...ij->...j", np.conj(before[..., :-1]), after[..., 1:]))


def _real_product(first: ComplexArray, second: ComplexArray) -> FloatArray:
    """Return the real part of the inner product (..., pulse) of two arrays (..., column, pulse), over columns."""
    return np.asarray(
        np.einsum("...ij,...ij->...j", first.real, second.real)
        + np.einsum("...ij,...ij->...j", first.imag, second.imag)
    )


@dataclass(frozen=True, slots=True)
class Comparison:
    """Each aligned echo against the sum of all others, over the gate.

    ``gated_sum`` (..., bin): of all echoes. ``product`` (..., pulse): of the others with each echo; ``variance``
    (..., pulse) of its phase. ``mean_hz`` (...): mean frequency of the common part.
    """

    gated_sum: ComplexArray
    product: ComplexArray
    variance: FloatArray
    mean_hz: FloatArray


def compare_with_others(
    spectrum: ComplexArray, band: Band, steps: PulseSteps, delay_s: FloatArray, energy: FloatArray | None = None
) -> Comparison:
    """Return the inner product of each echo with the sum of all others, after alignment, and the variance of its phase.

    ``spectrum`` (..., pulse, bin). Echoes are aligned by advancing them by ``delay_s`` (..., pulse). ``steps``:
    products and energies of consecutive echoes before alignment. ``energy`` (..., pulse): of each aligned echo in the
    gate; computed if absent.
    """
    # Echoes are aligned at the mean of their motion: there the gate cuts off the least of their common part.
    delay_s = delay_s - delay_s.mean(axis=-1, keepdims=True)
    chunks = [slice(first, first + ALIGNED_CHUNK) for first in range(0, spectrum.shape[-2], ALIGNED_CHUNK)]

    @functools.lru_cache(maxsize=1)
    def aligned(index: int) -> ComplexArray:
        """Return one chunk of aligned echoes. Only the last one is cached: aligning twice needs less memory."""
        release_pages(spectrum)
        return advanced(spectrum[..., chunks[index], :], delay_s[..., chunks[index]], band.frequency_hz)

    # Sum of all aligned echoes, that sum cut to the gate, and its energy there.
    total = np.sum([aligned(index).sum(axis=-2) for index in range(len(chunks))], axis=0)
    gated_sum = band.gated(total)
    total_energy = real_inner_product(gated_sum, total)
    reference_pulses, tiny = spectrum.shape[-2] - 1, np.finfo(np.float64).tiny
    noise_along = band.noise_along(gated_sum, total_energy)[..., None]
    energy_sum = np.zeros(spectrum.shape[:-2])
    product, variance = np.empty(spectrum.shape[:-1], np.complex128), np.empty(spectrum.shape[:-1])
    # In chunks, so that a long train needs two arrays of its length, not ten.
    for index, chunk in enumerate(chunks):
        with_total = inner_products(gated_sum, aligned(index))
        if energy is None:
            margins = band.in_margins(aligned(index))
            echo_energy = steps.energy_with_margins[..., chunk] - real_inner_product(margins, margins)
        else:
            echo_energy = energy[..., chunk]
        # The reference is the sum of the others: the noise of the pulse itself would bias its phase to zero.
        product[..., chunk] = with_others = with_total - echo_energy
        reference_energy = np.maximum(total_energy[..., None] - 2 * with_total.real + echo_energy, tiny)
        # The reference is a sum of ``reference_pulses`` echoes: its energy is the square of their number times that of
        # their mean.
        variance[..., chunk] = (
            phase_variance(band, with_others, echo_energy, reference_energy, noise_along) * reference_pulses**2
        )
        energy_sum += echo_energy.sum(axis=-1)
    # Energy and moment of the common part: those of the sum minus those of single echoes. The latter's moment, before
    # alignment, differs from that of aligned echoes in second order only.
    moment = real_inner_product(gated_sum, total * band.frequency_hz) - steps.moment
    mean_hz = mean_frequency(moment, total_energy - energy_sum, band)
    return Comparison(gated_sum=gated_sum, product=product, variance=variance, mean_hz=mean_hz)


def phase_variance(
    band: Band, product: ComplexArray, energy: FloatArray, reference_energy: FloatArray, noise_along: FloatArray
) -> FloatArray:
    """Return the variance (..., pulse), rad², of each echo's phase against a reference that is as large as the echo.

    ``product`` (..., pulse): inner product of the reference with each echo, ``energy`` (..., pulse) of the echo, both
    over the gate. ``reference_energy`` and ``noise_along`` (``Band.noise_along``) of the reference: (..., 1) or
    (..., pulse).
    """
    # Only noise along the echo changes its phase. It is estimated from the misfit, the noise orthogonal to the echo.
    misfit = np.maximum(energy - np.abs(product) ** 2 / reference_energy, 0.0)
    return np.asarray(misfit * noise_along / (band.noise_energy - noise_along) / (2 * reference_energy))


def _depth_correlation(spectrum: ComplexArray, band: Band, sample_rate_hz: float) -> ComplexArray:
    """Return the autocorrelation over one sample in depth, in the gate, of each echo: (..., pulse).

    It is the mean of two sums over the samples t of the gate: conj(z_t) z_t+1 and conj(z_t-1) z_t. Both ends of the
    gate then have the same weight. ``spectrum`` (..., pulse, bin): analytic signal z of gate and margins.
    """
    one_sample = np.exp(1j * (2 * np.pi * band.frequency_hz / sample_rate_hz))
    spectrum = spectrum.astype(np.complex128, copy=False)
    # The same two sums over the margins, from the echo and the echo advanced and delayed by one sample.
    margin, advanced_margin, delayed_margin = (
        band.in_margins(spectrum * shift) for shift in (1.0, one_sample, np.conj(one_sample))
    )
    margins = np.conj(margin) * advanced_margin + np.conj(delayed_margin) * margin
    # The power spectrum gives the autocorrelation over gate and margins.
    return np.asarray((spectrum.real**2 + spectrum.imag**2) @ one_sample - margins.sum(axis=-1) / 2)


def mean_frequency(moment: FloatArray, energy: FloatArray, band: Band) -> FloatArray:
    """Return the mean frequency (...) of the part that aligned echoes have in common: ``moment`` over ``energy`` (...).

    The energy is the real part of inner products between pulses, the moment the same weighted by frequency. Noise then
    averages to zero instead of shifting the mean to the middle of the band. NaN for trains without a common part in the
    band; raises ``ValueError`` if no train has one.
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


def noise_of_steps(cross: FloatArray, energy: FloatArray, independent_samples: float) -> tuple[FloatArray, FloatArray]:
    """Return the noise of accumulated phase steps: variance (..., pulse) of each pulse, and step noise ratio (...).

    The noise of a pulse has opposite signs in the steps before and after it and cancels in their sum. The product of
    the noises of two pulses remains in all later phases; the ratio is its variance over that of a pulse.

    ``cross`` (..., pulse - 1): magnitude of the products of consecutive echoes, ``energy`` (..., pulse). Two echoes
    with correlation rho over M ``independent_samples`` differ in phase by a variance of (1/rho² - 1) / (2 M); half of
    it belongs to each pulse. The ratio is noise over signal power, 1/rho - 1.
    """
    tiny = np.finfo(np.float64).tiny
    energy_product = energy[..., :-1] * energy[..., 1:]
    # Variance (1/rho² - 1) / (4 M) by each step; a pulse has the smaller value of its two steps.
    excess = np.maximum(np.maximum(energy_product, tiny) / np.maximum(cross**2, tiny) - 1, 0.0)
    by_step = excess / (4 * independent_samples)
    before, after = np.concatenate([by_step[..., :1], by_step], -1), np.concatenate([by_step, by_step[..., -1:]], -1)
    variance = np.minimum(before, after)
    step_noise_ratio = np.sqrt(energy_product).sum(axis=-1) / np.maximum(cross.sum(axis=-1), tiny) - 1
    return np.asarray(variance), np.asarray(np.maximum(step_noise_ratio, 0.0))
