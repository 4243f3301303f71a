"""Echoes and their carrier: their spectrum compared with the stated one, samples below the Nyquist rate, I and Q.

Samples at the rate F_s hold a frequency f at f - m F_s, with an integer m: the spectrum alone does not determine m.

I and Q become real samples around the carrier by interpolation, mixing up, and the real part:

    r(t) = Re[ (I(t) + j Q(t)) exp(2 pi j f_d t) ],    f_d the demodulation frequency

The phase of the mixer is unknown. It is constant, so it does not affect the estimated motion. Interpolation leaves
images of the band at multiples of the sampling rate. Mixed up, one of them can lie at the negative carrier, and the
real part adds it to the echoes. So the filter suppresses images by 100 dB.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hpe_rig.arrays import ComplexArray, FloatArray, SingleArray

MAX_RECORDS = 64
"""Records, evenly spaced, for the mean spectrum."""
MAX_POWER = 1e60
"""Largest power of a bin."""
SMOOTHING_BINS = 16
"""The lowest mean of this part of the spectrum's bins is its noise floor."""
USED_BAND = 0.5
"""Half the width of the band that the estimators use, relative to the carrier."""
MIN_BAND_ENERGY, MIN_REAL_BAND_ENERGY = 0.1, 1e-3
"""Smallest part of the energy near a plausible carrier, in I and Q and in real samples.

Interference of 30 dB outside their band does not disturb the estimators of real samples.
"""
BAND_EDGE = 2.15
"""Half the width at -10 dB of a Gaussian spectrum, in standard deviations of its power."""
CLEAN_WIDTHS = 2.0
"""Distance of a folded carrier from the ends of the spectrum that excludes overlap (-40 dB), in half widths."""
MIN_DEVIATION = 0.1
"""Deviation of the centre from the carrier that attenuation may cause, relative to the carrier."""
MIN_SAMPLES_PER_PERIOD = 4.0
"""Samples per period of the highest frequency in the band, after interpolation."""
BAND_END = 1.5
"""Upper end of the band that the estimators use, in units of the carrier."""
FILTER_SAMPLES = 32
"""Half the length of the interpolation filter in input samples: its band ends at 0.45 of their rate."""
IMAGE_DB = 100.0
"""Suppression of the images."""


@dataclass(frozen=True, slots=True)
class EchoBand:
    """Mean spectrum of echoes: frequencies (bin,), Hz, and energies above the noise floor (bin,), of sum 1."""

    frequency_hz: FloatArray
    energy: FloatArray

    def moments(self) -> tuple[float, float]:
        """Return the mean frequency and half the width at -10 dB, Hz."""
        mean_hz = float(self.energy @ self.frequency_hz)
        return mean_hz, BAND_EDGE * float(np.sqrt(self.energy @ (self.frequency_hz - mean_hz) ** 2))

    def near(self, carrier_hz: float) -> tuple[EchoBand, float]:
        """Return the band that estimators use around ``carrier_hz``, and its part of the energy."""
        energy = np.where(np.abs(self.frequency_hz - carrier_hz) <= USED_BAND * carrier_hz, self.energy, 0.0)
        fraction = float(energy.sum())
        return EchoBand(self.frequency_hz, energy / (fraction or 1.0)), fraction


def echo_band(values: NDArray[Any], rate_hz: float, demodulation_hz: float, carrier_hz: float) -> EchoBand | None:
    """Return the band of ``values`` (line, shot, pulse, sample); None without finite echoes of two samples or more.

    Real samples have ``demodulation_hz`` 0. Complex samples determine a frequency up to multiples of the rate: the one
    nearest to ``carrier_hz`` counts.
    """
    if values.shape[-1] < 2:
        return None
    count, power, is_real = math.prod(values.shape[:-1]), np.zeros(values.shape[-1]), np.isrealobj(values)
    window = np.hanning(power.size)
    # One record at a time: the spectra of long records take more memory than all samples.
    for index in range(0, count, max(1, count // MAX_RECORDS)):
        record = values[np.unravel_index(index, values.shape[:-1])]
        with np.errstate(invalid="ignore", over="ignore"):
            spectrum = np.abs(np.fft.fft((record - record.mean() if is_real else record) * window)) ** 2
        # Values that are not finite, or no echoes, have no spectrum; NaN fails the comparison.
        if spectrum.max() <= MAX_POWER:
            power += spectrum
    frequency_hz = np.asarray(np.fft.fftfreq(power.size, 1 / rate_hz), np.float64)
    if is_real:
        frequency_hz, power = frequency_hz[: power.size // 2], power[: power.size // 2]
    else:
        nearest = np.round((carrier_hz - demodulation_hz - frequency_hz) / rate_hz)
        frequency_hz = demodulation_hz + frequency_hz + rate_hz * nearest
    width = max(1, power.size // SMOOTHING_BINS)
    sums = np.concatenate([[0.0], np.cumsum(power)])
    floor = (sums[width:] - sums[:-width]).min() / width
    energy = np.maximum(power - floor, 0.0)
    return EchoBand(frequency_hz, energy / energy.sum()) if energy.sum() > 0 else None


def compare_with_carrier(band: EchoBand, carrier_hz: float, is_iq: bool) -> tuple[str, bool]:
    """Return a sentence if the echoes are not centred at the carrier, and whether they exclude that carrier."""
    near, fraction = band.near(carrier_hz)
    dominated = fraction < MIN_BAND_ENERGY
    centre_hz, half_width_hz = (band if dominated else near).moments()
    if not dominated and abs(centre_hz - carrier_hz) <= max(half_width_hz, MIN_DEVIATION * carrier_hz):
        return "", False
    low, high = ((centre_hz + sign * half_width_hz) / 1e6 for sign in (-1, 1))
    sentence = f"echoes are centred at {centre_hz / 1e6:.3g} MHz ({low:.3g} to {high:.3g} MHz)"
    excluded = fraction < (MIN_BAND_ENERGY if is_iq else MIN_REAL_BAND_ENERGY)
    return f"{sentence}, the carrier is {carrier_hz / 1e6:.3g} MHz", excluded


def unfold(values: NDArray[Any], rate_hz: float, carrier_hz: float) -> tuple[ComplexArray, float, str] | None:
    """Return band-pass samples as I and Q, their demodulation frequency, Hz, and a sentence with the folded carrier.

    ``values`` (..., sample): real samples at less than twice ``carrier_hz``. Returns None if the band of their
    echoes is not centred at the folded carrier, or reaches an end of the spectrum, where it folds onto itself.
    """
    from scipy.signal import hilbert

    demodulation_hz = rate_hz * round(carrier_hz / rate_hz)
    offset_hz = carrier_hz - demodulation_hz
    band = echo_band(values, rate_hz, 0.0, abs(offset_hz))
    if band is None:
        return None
    centre_hz, half_width_hz = band.moments()
    distance_hz = min(abs(offset_hz), rate_hz / 2 - abs(offset_hz))
    if distance_hz < half_width_hz or abs(centre_hz - abs(offset_hz)) > half_width_hz:
        return None
    sentence = f"band-pass sampling: the carrier of {carrier_hz:g} Hz is folded to {abs(offset_hz):g} Hz"
    if distance_hz < CLEAN_WIDTHS * half_width_hz:
        sentence = f"WARNING {sentence}, where the ends of the band of +- {half_width_hz:.3g} Hz overlap"
    analytic = np.asarray(hilbert(values, axis=-1))
    # Below a multiple of the rate the folded spectrum is reversed.
    return (analytic.conj() if offset_hz < 0 else analytic), demodulation_hz, sentence


def to_radio_frequency(
    values: NDArray[np.complexfloating[Any, Any]], rate_hz: float, demodulation_hz: float, carrier_hz: float
) -> tuple[SingleArray, float]:
    """Return real samples (..., sample) of complex ``values`` (..., sample), and their rate.

    The rate is the smallest integer multiple of ``rate_hz`` that samples the band twice as fast as needed.
    """
    from scipy.signal import firwin, kaiser_beta, resample_poly

    # The band of the carrier and that of I and Q around the demodulation frequency must both fit.
    highest_hz = max(BAND_END * carrier_hz, demodulation_hz + rate_hz / 2)
    factor = max(1, math.ceil(MIN_SAMPLES_PER_PERIOD * highest_hz / rate_hz / 2))
    interpolated = values
    if factor > 1:
        taps: Any = firwin(2 * FILTER_SAMPLES * factor + 1, 1 / factor, window=("kaiser", kaiser_beta(IMAGE_DB)))
        interpolated = resample_poly(values, factor, 1, axis=-1, window=taps)
    output_hz = rate_hz * factor
    # Mix up: multiply by exp(2 pi j f_d t).
    carrier = np.exp(2j * np.pi * demodulation_hz / output_hz * np.arange(interpolated.shape[-1]))
    return np.asarray((interpolated * carrier).real, np.float32), output_hz
