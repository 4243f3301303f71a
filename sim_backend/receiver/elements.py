"""Elements of the receive chain: band-pass, notch, T/R switch, logarithmic amplifier.

The filters are Butterworth prototypes by their frequency response at the records' own Fourier frequencies, factor by
factor: scipy.signal's polynomials lose digits at order 5, and loading it takes longer than a run.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from sim_backend.arrays import ComplexArray, FloatArray, Int64Array
from sim_backend.settings import BandFilter, LogAmplifier
from sim_backend.wiring import PS_PER_S, Bursts, Capture, to_ps

# After this many recovery times the switch passes all but 2e-9.
_OPEN = 20.0


def band_pass(band: BandFilter, frequency_hz: FloatArray) -> ComplexArray:
    """Return the Butterworth band-pass response at ``frequency_hz`` (frequency,) >= 0: 1 at the centre, -3 dB edges."""
    return _low_pass(*_detuning(band, frequency_hz), band.order)


def notch(band: BandFilter, frequency_hz: FloatArray) -> ComplexArray:
    """Return the Butterworth band-stop response at ``frequency_hz`` (frequency,): 0 at the centre, -3 dB edges."""
    away, width = _detuning(band, frequency_hz)
    return _low_pass(width, away, band.order)


def sampled(response: ComplexArray, at_infinity: float) -> ComplexArray:
    """Return ``response`` (frequency,) from 0 to half the sampling rate, led to its limit there without a step.

    A step would ring before and after every edge of the signal like 1/t; this does like 1/t^3. It leaves what lies
    below six tenths of half the rate alone: 30 MHz of 100 MHz sampling.
    """
    place = np.linspace(0.0, 1.0, len(response))
    share = np.cos(np.pi / 2 * np.clip((place - 0.6) / 0.4, 0.0, 1.0)) ** 2
    return np.asarray(at_infinity + (response - at_infinity) * share)


def ringing_s(bands: Iterable[BandFilter], tolerance: float) -> float:
    """Return after which time a cascade of ``bands`` has rung down to ``tolerance``; notch and band-pass alike."""
    slowest_s = 0.0
    for band in bands:
        roots = np.concatenate([np.roots([1.0, -band.bandwidth * pole, 1.0]) for pole in _poles(band.order)])
        slowest_s = max(slowest_s, float(-1 / (2 * np.pi * band.centre_hz * roots.real.max())))
    # Equal filters in cascade ring longer than one, by powers of t / slowest: a factor of 100 covers four of them.
    return slowest_s * math.log(100 / tolerance)


def _poles(order: int) -> ComplexArray:
    angle = np.pi * (2 * np.arange(order) + order + 1) / (2 * order)
    return np.asarray(np.exp(1j * angle))


def _detuning(band: BandFilter, frequency_hz: FloatArray) -> tuple[ComplexArray, ComplexArray]:
    """Return j (f / f0 - f0 / f) over the bandwidth as numerator and denominator: neither is infinite at 0 Hz."""
    f = frequency_hz / band.centre_hz
    return np.asarray(1j * (f * f - 1), np.complex128), np.asarray(band.bandwidth * f, np.complex128)


def _low_pass(above: ComplexArray, below: ComplexArray, order: int) -> ComplexArray:
    """Return the low-pass prototype at p = above / below."""
    response = np.ones(above.shape, np.complex128)
    for pole in _poles(order):
        response *= below / (above - pole * below)
    return response


def switch_gain(sent: Bursts, capture: Capture, recovery_s: float) -> FloatArray | None:
    """Return what the switch passes, float64 (record, sample) from 0 to 1, or None where it passes everything.

    Shut from a burst's onset to its end, then ``1 - exp(-t / recovery)``. ``sent`` is by time and does not overlap
    itself: of bursts at once the one that began last counts.
    """
    open_ps = sent.end_ps + to_ps(_OPEN * recovery_s)
    length_ps = capture.samples * capture.sample_period_ps
    # The last burst that began before each record's end, and whether the switch is still affected by it then.
    begin = np.searchsorted(sent.onset_ps, capture.first_sample_ps + length_ps, side="left") - 1
    met = begin >= 0
    met[met] &= open_ps[begin[met]] > capture.first_sample_ps[met]
    if not met.any():
        return None
    gain = np.ones((len(capture.first_sample_ps), capture.samples))
    offset_ps = np.arange(capture.samples) * capture.sample_period_ps
    for record in np.flatnonzero(met):
        gain[record] = _share_passed(sent, int(capture.first_sample_ps[record]) + offset_ps, recovery_s)
    return gain


def _share_passed(sent: Bursts, time_ps: Int64Array, recovery_s: float) -> FloatArray:
    last = np.searchsorted(sent.onset_ps, time_ps, side="right") - 1
    since_s = np.where(last >= 0, time_ps - sent.end_ps[np.maximum(last, 0)], 1 << 60) / PS_PER_S
    if recovery_s == 0:
        return np.where(since_s >= 0, 1.0, 0.0)
    return np.asarray(-np.expm1(-np.clip(since_s / recovery_s, 0.0, 700.0)))


def compressed(volts: FloatArray, amplifier: LogAmplifier) -> FloatArray:
    """Return the output ``slope asinh(v / 2 knee) / ln 10`` of the input ``volts``, any shape, limited to saturation.

    Odd and smooth, so that it keeps the sign of the carrier and, after a band-pass, its phase.
    """
    out = volts / (2 * amplifier.knee_v)
    np.arcsinh(out, out=out)
    out *= amplifier.slope_v_per_decade / np.log(10)
    if amplifier.saturation_v is not None:
        np.clip(out, -amplifier.saturation_v, amplifier.saturation_v, out=out)
    return out
