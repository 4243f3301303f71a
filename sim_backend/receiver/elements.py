"""Elements of the receive chain: band-pass, notch, T/R switch, logarithmic amplifier.

    H(p) = prod_i 1 / (p - p_i),      p = j (f / f0 - f0 / f) / B      Butterworth

    f, f0, B    frequency; centre frequency, Hz; relative bandwidth at -3 dB
    p_i         poles of the low-pass prototype

The response is computed at the Fourier frequencies of the records, factor by factor. The polynomials of scipy.signal
lose digits at order 5, and loading it takes longer than a run.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from sim_backend.arrays import ComplexArray, FloatArray, Int64Array
from sim_backend.settings import BandFilter, LogAmplifier
from sim_backend.wiring import PS_PER_S, Bursts, Capture, to_ps

# After this many recovery times the switch transmits all but 2e-9.
_RECOVERY_TIMES = 20.0


def band_pass(band: BandFilter, frequency_hz: FloatArray) -> ComplexArray:
    """Return the Butterworth band-pass response at ``frequency_hz`` (frequency,) >= 0: 1 at the centre, -3 dB edges."""
    return _low_pass(*_detuning(band, frequency_hz), band.order)


def notch(band: BandFilter, frequency_hz: FloatArray) -> ComplexArray:
    """Return the Butterworth band-stop response at ``frequency_hz`` (frequency,): 0 at the centre, -3 dB edges."""
    detuning, width = _detuning(band, frequency_hz)
    return _low_pass(width, detuning, band.order)


def sampled(response: ComplexArray, at_infinity: float) -> ComplexArray:
    """Return a filter's ``response`` (frequency,), smoothly continued to ``at_infinity`` at half the sampling rate.

    A step there would ring around every edge of the signal like 1/t; the transition rings like 1/t³. Frequencies below
    six tenths of half the rate are unchanged: 30 MHz at 100 MHz sampling.
    """
    position = np.linspace(0.0, 1.0, len(response))
    taper = np.cos(np.pi / 2 * np.clip((position - 0.6) / 0.4, 0.0, 1.0)) ** 2
    return np.asarray(at_infinity + (response - at_infinity) * taper)


def ringing_s(bands: Iterable[BandFilter], tolerance: float) -> float:
    """Return how long a cascade of band-passes or notches ``bands`` rings above ``tolerance``, s."""
    slowest_s = 0.0
    for band in bands:
        # A pole p of the low-pass becomes two poles x = s / w0 of the band-pass, with (x + 1 / x) / B = p.
        poles = np.concatenate([np.roots([1.0, -band.bandwidth * pole, 1.0]) for pole in _poles(band.order)])
        # The pole nearest to the imaginary axis decays most slowly.
        slowest_s = max(slowest_s, float(-1 / (2 * np.pi * band.centre_hz * poles.real.max())))
    # Equal filters in cascade ring longer than one, by powers of t / slowest: a factor of 100 covers four of them.
    return slowest_s * math.log(100 / tolerance)


def _poles(order: int) -> ComplexArray:
    """Return the poles p_i of the low-pass prototype, (pole,)."""
    angle = np.pi * (2 * np.arange(order) + order + 1) / (2 * order)
    return np.asarray(np.exp(1j * angle))


def _detuning(band: BandFilter, frequency_hz: FloatArray) -> tuple[ComplexArray, ComplexArray]:
    """Return numerator and denominator of p = j (f / f0 - f0 / f) / B; neither is infinite at 0 Hz."""
    f = frequency_hz / band.centre_hz
    return np.asarray(1j * (f * f - 1), np.complex128), np.asarray(band.bandwidth * f, np.complex128)


def _low_pass(numerator: ComplexArray, denominator: ComplexArray, order: int) -> ComplexArray:
    """Return the frequency response of a low-pass filter of this order at p = numerator / denominator.

    A band-pass or notch is this low-pass at a transformed frequency p, which may be infinite, hence the quotient.
    """
    response = np.ones(numerator.shape, np.complex128)
    for pole in _poles(order):
        response *= denominator / (numerator - pole * denominator)
    return response


def switch_gain(bursts: Bursts, capture: Capture, recovery_s: float) -> FloatArray | None:
    """Return the transmission of the transmit/receive switch, float64 (record, sample) from 0 to 1, or None if it is 1.

    The switch is shut during a burst, and then transmits ``1 - exp(-t / recovery)``. ``bursts`` ascend in time; if
    they overlap, the last one to begin determines the transmission.
    """
    open_ps = bursts.end_ps + to_ps(_RECOVERY_TIMES * recovery_s)
    length_ps = capture.samples * capture.sample_period_ps
    # The last burst before the end of each record; affected are records that start before the switch has recovered.
    last = np.searchsorted(bursts.onset_ps, capture.first_sample_ps + length_ps, side="left") - 1
    affected = last >= 0
    affected[affected] &= open_ps[last[affected]] > capture.first_sample_ps[affected]
    if not affected.any():
        return None
    gain = np.ones((len(capture.first_sample_ps), capture.samples))
    offset_ps = np.arange(capture.samples) * capture.sample_period_ps
    for record in np.flatnonzero(affected):
        gain[record] = _transmission(bursts, int(capture.first_sample_ps[record]) + offset_ps, recovery_s)
    return gain


def _transmission(bursts: Bursts, time_ps: Int64Array, recovery_s: float) -> FloatArray:
    """Return the transmission of the transmit/receive switch at ``time_ps`` (time,), 0 to 1."""
    last = np.searchsorted(bursts.onset_ps, time_ps, side="right") - 1
    since_s = np.where(last >= 0, time_ps - bursts.end_ps[np.maximum(last, 0)], 1 << 60) / PS_PER_S
    if recovery_s == 0:
        return np.where(since_s >= 0, 1.0, 0.0)
    return np.asarray(-np.expm1(-np.clip(since_s / recovery_s, 0.0, 700.0)))


def compressed(volts: FloatArray, amplifier: LogAmplifier) -> FloatArray:
    """Return the output of the logarithmic amplifier, ``slope asinh(v / 2 knee) / ln 10``, limited to saturation.

    The function is odd and smooth, so it preserves the sign of the carrier and, after a band-pass, its phase.
    """
    out = volts / (2 * amplifier.knee_v)
    np.arcsinh(out, out=out)
    out *= amplifier.slope_v_per_decade / np.log(10)
    if amplifier.saturation_v is not None:
        np.clip(out, -amplifier.saturation_v, amplifier.saturation_v, out=out)
    return out
