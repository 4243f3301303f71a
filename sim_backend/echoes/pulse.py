"""Echo of one scatterer for a tracking pulse: a few complex exponentials on a compact support, eq. (9) of the paper.

    p(t) = Re sum_m c_m exp(j w_m t)   for start <= t < end, else 0

    c_m, w_m    amplitude and angular frequency of exponential m, 1 and rad/s

The Hann pulse of eq. (9) has three exponentials. A Gaussian and a burst through a transducer's band are the
Fourier series of their support, without the terms below a tolerance.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sim_backend.arrays import ComplexArray, FloatArray
from sim_backend.settings import SimulationSettings

# Full width at -6 dB of a Gaussian amplitude spectrum, in standard deviations.
_WIDTH_OVER_SIGMA = 2 * math.sqrt(2 * math.log(2))
_FINEST_TOLERANCE = 1e-13
_BURST_CYCLES = 3.0


@dataclass(frozen=True, slots=True)
class Pulse:
    """A sum of exponentials on a compact support; time 0 is its nominal arrival."""

    start_s: float
    end_s: float
    frequency_hz: tuple[float, ...]
    """(exponential,), w_m / 2 pi."""
    amplitude: tuple[complex, ...]
    """(exponential,), c_m."""


def echo_pulse(settings: SimulationSettings, carrier_hz: float) -> Pulse:
    """Return the echo of one scatterer at the focus for a tracking pulse of ``carrier_hz``.

    Attenuation lowers its amplitude, and its centre frequency by alpha L sigma_f^2 for a Gaussian spectrum of variance
    sigma_f^2 (alpha L in Np/Hz).
    """
    scatterers = settings.scatterers
    pulse = _ideal_pulse(scatterers.pulse, carrier_hz, scatterers.bandwidth, scatterers.band_centre_hz)
    return attenuated_to_focus(settings, pulse)


def attenuated_to_focus(settings: SimulationSettings, pulse: Pulse) -> Pulse:
    """Return ``pulse`` after the loss in water and specimen, to the focus and back."""
    loss_db = tuple(map(settings.loss_to_focus_db, pulse.frequency_hz))
    return attenuated(pulse, loss_db) if any(loss_db) else pulse


@functools.lru_cache(maxsize=64)
def _ideal_pulse(kind: str, carrier_hz: float, bandwidth: float, band_centre_hz: float) -> Pulse:
    """Return the echo of one scatterer for a pulse of the named ``kind``: "gaussian", "burst" or "hann"."""
    if kind == "gaussian":
        return gaussian_pulse(carrier_hz, bandwidth)
    if kind == "burst":
        return band_limited_burst(carrier_hz, _BURST_CYCLES, band_centre_hz, bandwidth)
    return hann_pulse(carrier_hz, bandwidth)


def hann_pulse(carrier_hz: float, bandwidth: float) -> Pulse:
    """Return the echo of eq. (9) of the paper: a cosine under a Hann window of length 1/(BW f), centred at 0."""
    half = 0.5 / (bandwidth * carrier_hz)
    frequency_hz = (carrier_hz * (1 - bandwidth), carrier_hz, carrier_hz * (1 + bandwidth))
    # The Hann window is 1/2 plus two half cosines: three exponentials.
    return Pulse(-half, half, frequency_hz, (0.25, 0.5, 0.25))


def rectangular_burst(carrier_hz: float, duration_s: float) -> Pulse:
    """Return a sine burst of unit amplitude that begins at its arrival with a rising zero crossing."""
    return Pulse(0.0, duration_s, (carrier_hz,), (-1j,))


def gaussian_pulse(carrier_hz: float, bandwidth: float, tolerance: float = 1e-10) -> Pulse:
    """Return a cosine under a Gaussian; the -6 dB width of its spectrum is ``bandwidth`` times the carrier.

    The support ends where the Gaussian falls below ``tolerance`` (at least 1e-13) of its peak.
    """
    width_hz = bandwidth * carrier_hz / _WIDTH_OVER_SIGMA
    half = math.sqrt(-2 * math.log(max(tolerance, _FINEST_TOLERANCE))) / (2 * math.pi * width_hz)

    def spectrum(frequency_hz: FloatArray) -> ComplexArray:
        """Return the Fourier transform of the pulse: Gaussians at the carrier and at minus the carrier."""
        upper = np.exp(-0.5 * np.square((frequency_hz - carrier_hz) / width_hz))
        lower = np.exp(-0.5 * np.square((frequency_hz + carrier_hz) / width_hz))
        return np.asarray((upper + lower) / (2 * math.sqrt(2 * math.pi) * width_hz), dtype=np.complex128)

    return from_spectrum(spectrum, -half, half, tolerance)


def band_limited_burst(
    carrier_hz: float, cycles: float, centre_hz: float, bandwidth: float, tolerance: float = 1e-10
) -> Pulse:
    """Return a sine burst of ``cycles`` from time 0 through the two-way Gaussian band of a transducer.

    ``bandwidth`` is the band's -6 dB width divided by ``centre_hz``. A long burst at the band's centre has amplitude 1.
    """
    # The band's impulse response rings on either side of the burst until it falls below the tolerance.
    width_hz = bandwidth * centre_hz / _WIDTH_OVER_SIGMA
    ringing = math.sqrt(-2 * math.log(max(tolerance, _FINEST_TOLERANCE))) / (2 * math.pi * width_hz)
    duration_s = cycles / carrier_hz

    def spectrum(frequency_hz: FloatArray) -> ComplexArray:
        """Return the pulse's spectrum: that of the sine burst times the band of the transducer."""
        # The band at positive and negative frequencies, times the spectrum of the sine burst.
        upper, lower = ((frequency_hz - side * centre_hz) / width_hz for side in (1, -1))
        band = np.exp(-0.5 * np.square(upper)) + np.exp(-0.5 * np.square(lower))

        def rectangle(offset_hz: FloatArray) -> ComplexArray:
            """Return the Fourier transform of the rectangular window of the burst."""
            delay = np.exp(-1j * np.pi * offset_hz * duration_s)
            return np.asarray(duration_s * np.sinc(offset_hz * duration_s) * delay)

        return np.asarray(band * (rectangle(frequency_hz - carrier_hz) - rectangle(frequency_hz + carrier_hz)) / 2j)

    return from_spectrum(spectrum, -ringing, duration_s + ringing, tolerance)


def from_spectrum(
    spectrum: Callable[[FloatArray], ComplexArray], start_s: float, end_s: float, tolerance: float
) -> Pulse:
    """Return the pulse with the Fourier transform ``spectrum(frequency_hz)``, as a sum of exponentials.

    It is zero before ``start_s`` and after ``end_s``. The exponentials are those of the Fourier series of this
    interval, without the ones that add up to less than ``tolerance``.
    """
    period_s = end_s - start_s
    # Double the number of terms until the last eighth of them is negligible.
    count = 64
    while True:
        frequency_hz = np.arange(count) / period_s
        amplitude = 2 / period_s * spectrum(frequency_hz)
        amplitude[0] /= 2
        size = np.abs(amplitude)
        if size[-count // 8 :].sum() < 0.1 * tolerance * size.sum() or count >= 1 << 16:
            break
        count *= 2
    # Consecutive terms that hold all but ``tolerance`` of the summed amplitude.
    budget = tolerance * size.sum() / 2
    first = int(np.searchsorted(np.cumsum(size), budget))
    last = len(size) - int(np.searchsorted(np.cumsum(size[::-1]), budget))
    terms = slice(first, max(last, first + 1))
    return Pulse(start_s, end_s, tuple(frequency_hz[terms].tolist()), tuple(amplitude[terms].tolist()))


def attenuated(pulse: Pulse, loss_db: Sequence[float]) -> Pulse:
    """Return the pulse with each exponential attenuated by its ``loss_db`` (frequency,).

    The support stays, and must have room for the broader pulse. The Hann pulse gets steps at its ends of the order of
    (loss across its band in Np)^2 / 4.
    """
    pairs = zip(loss_db, pulse.amplitude, strict=True)
    return replace(pulse, amplitude=tuple(amplitude * 10 ** (-loss / 20) for loss, amplitude in pairs))


def waveform(pulse: Pulse, time_s: FloatArray) -> FloatArray:
    """Return the pulse at ``time_s``, any shape, relative to its arrival."""
    inside = (time_s >= pulse.start_s) & (time_s < pulse.end_s)
    return np.where(inside, extended(pulse, time_s), 0.0)


def extended(pulse: Pulse, time_s: FloatArray) -> FloatArray:
    """Return the sum of the pulse's exponentials at ``time_s``, any shape, also where the pulse itself has ended."""
    value = np.zeros(time_s.shape)
    for frequency_hz, amplitude in zip(pulse.frequency_hz, pulse.amplitude, strict=True):
        angle = 2 * np.pi * frequency_hz * time_s
        value += amplitude.real * np.cos(angle)
        if amplitude.imag != 0:
            value -= amplitude.imag * np.sin(angle)
    return value


def phasors(pulse: Pulse, time_s: FloatArray, sign: int) -> ComplexArray:
    """Return the exponentials exp(sign j w_m t) of the pulse's angular frequencies w_m, (frequency, *time).

    Evenly spaced frequencies need two exponentials; the others follow by multiplication.
    """
    rate, step = angular_rates(pulse)
    out = np.empty((len(rate), *time_s.shape), dtype=np.complex128)
    imaginary_s = sign * 1j * time_s
    np.exp(rate[0] * imaginary_s, out=out[0])
    step_phasor = None if step is None or len(rate) < 2 else np.exp(step * imaginary_s)
    for term in range(1, len(rate)):
        # Every sixteenth one is computed directly, so that rounding does not accumulate.
        if step_phasor is None or term % 16 == 0:
            np.exp(rate[term] * imaginary_s, out=out[term])
        else:
            np.multiply(out[term - 1], step_phasor, out=out[term])
    return out


@functools.lru_cache(maxsize=32)
def angular_rates(pulse: Pulse) -> tuple[tuple[float, ...], float | None]:
    """Return the angular frequencies of the pulse, rad/s, and their step, None if they are not evenly spaced."""
    rate = 2 * np.pi * np.array(pulse.frequency_hz)
    step = float(rate[-1] - rate[0]) / max(1, len(rate) - 1)
    even = len(rate) < 3 or bool(np.abs(np.diff(rate) - step).max() <= 1e-14 * np.abs(rate).max())
    return tuple(rate.tolist()), step if even else None
