"""Receive chain from the transducer's terminals to the digitizer; an absent element costs nothing.

    notch -> T/R switch -> (preamplifier noise) -> band-pass -> logarithmic amplifier -> band-pass

Adjacent linear elements are one filter: without switch and logarithm the whole chain is one product in frequency.
"""

from __future__ import annotations

import math

import numpy as np

from sim_backend.arrays import ComplexArray, FloatArray
from sim_backend.receiver.elements import band_pass, compressed, notch, ringing_s, sampled
from sim_backend.settings import ReceiveChain

_RECORDS_PER_CHUNK = 64
TRAILING_SAMPLES = 24
"""Samples that the chain needs after the last output sample, since the sampled filters are not exactly causal."""


def settling_s(chain: ReceiveChain) -> float:
    """Return how much earlier than its output the chain's input must begin, for ``chain.tail_tolerance``."""
    bands = [band for band in (chain.notch, chain.band_pass, chain.second_band_pass) if band is not None]
    return ringing_s(bands, chain.tail_tolerance)


def fast_fft_length(samples: int) -> int:
    """Return the smallest number from ``samples`` on without a prime factor above 5, for a fast Fourier transform."""
    # Imported here: a scene whose receiver distorts nothing has no receive chain and does not need SciPy.
    from scipy.fft import next_fast_len

    return int(next_fast_len(samples, real=True))


def receive(
    volts: FloatArray,
    chain: ReceiveChain,
    sample_period_s: float,
    switch: FloatArray | None = None,
    rng: np.random.Generator | None = None,
) -> FloatArray:
    """Return the output of the chain, float64 (record, sample), for ``volts`` (record, sample) at the transducer.

    The filters are periodic in each record, so its first `settling_s` and its last `TRAILING_SAMPLES` samples are not
    valid. ``switch`` (record, sample) is the transmission of the T/R switch, None for 1. ``rng`` draws the
    preamplifier's noise, if the chain has any.
    """
    frequency_hz: FloatArray = np.fft.rfftfreq(volts.shape[1], sample_period_s).astype(np.float64)
    out = np.empty_like(volts)
    for first in range(0, len(volts), _RECORDS_PER_CHUNK):
        chunk = slice(first, first + _RECORDS_PER_CHUNK)
        chunk_switch = None if switch is None else switch[chunk]
        out[chunk] = _receive(volts[chunk], chain, frequency_hz, sample_period_s, chunk_switch, rng)
    return out


def _receive(
    volts: FloatArray,
    chain: ReceiveChain,
    frequency_hz: FloatArray,
    period_s: float,
    switch: FloatArray | None,
    rng: np.random.Generator | None,
) -> FloatArray:
    """Return the volts (record, sample) after notch, switch, preamplifier noise, filters and logarithmic amplifier.

    ``switch`` (record, sample): transmission of the T/R switch.
    """
    # Collect filters in one response (frequency,), and apply it before an element that is not a filter.
    pending: ComplexArray | None = None
    if chain.notch is not None:
        pending = sampled(notch(chain.notch, frequency_hz), 1.0)
    if switch is not None:
        volts, pending = _filtered(volts, pending) * switch, None
    if chain.noise_v_per_sqrt_hz and rng is not None:
        # White noise of the preamplifier's density, up to half the sampling rate of the chain.
        level_v = chain.noise_v_per_sqrt_hz * math.sqrt(0.5 / period_s)
        volts, pending = _filtered(volts, pending) + rng.standard_normal(volts.shape) * level_v, None
    if chain.band_pass is not None:
        pending = _product(pending, sampled(band_pass(chain.band_pass, frequency_hz), 0.0))
    if chain.log_amplifier is not None:
        volts, pending = compressed(_filtered(volts, pending), chain.log_amplifier), None
    if chain.second_band_pass is not None:
        pending = _product(pending, sampled(band_pass(chain.second_band_pass, frequency_hz), 0.0))
    return _filtered(volts, pending)


def _filtered(volts: FloatArray, response: ComplexArray | None) -> FloatArray:
    """Return the volts (record, sample) after a filter with this frequency response; unchanged without one."""
    if response is None:
        return volts
    return np.asarray(np.fft.irfft(np.fft.rfft(volts) * response, volts.shape[1]))


def _product(first: ComplexArray | None, second: ComplexArray) -> ComplexArray:
    return second if first is None else first * second
