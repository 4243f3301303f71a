"""Gate tracking: a gate that stays on the tissue it holds at first, however far background motion carries that."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from hpe_rig.arrays import ComplexArray, FloatArray
from hpe_rig.processing.echo.band import BAND
from hpe_rig.processing.echo.echoes import EchoGate, Motion, Volts, margin_samples, scatter, valid_volts

LARGEST_STEP = 0.95
"""Quarter wavelengths between pulses from which on a step may be one in the other direction."""
_RECORDS_AT_ONCE = 256


def follow(records: EchoGate, gate: slice) -> tuple[EchoGate, Motion]:
    """Return the gate cut out of whole records where its echoes have gone, and how far each cut was moved.

    ``records`` (pulse, sample), whole and without margins, hold what moves into and out of the ``gate``, which stays
    with what it holds in the first valid pulse. The cuts' motion is known exactly, without variance, also between
    samples: a record is shifted by its Fourier transform. Add it to the displacement found in the cut echoes
    (``added``). What has moved away is reached later, and the times of the cut echoes say so. Cuts have margins as far
    as every record reaches. Raises ``ValueError`` for more than one train, where a step passes a quarter wavelength,
    and where the echoes leave the records.
    """
    if records.volts.ndim != 2:
        raise ValueError(f"volts {records.volts.shape}: one train (pulse, sample) at a time can be followed")
    volts = valid_volts(records)
    moved = _moved_samples(volts, gate, records)
    wanted, reach = margin_samples(records.sample_rate_hz, records.carrier_hz), (moved.min(), moved.max())
    before = min(wanted, int(gate.start + min(reach[0], 0)))
    behind = min(wanted, int(volts.shape[1] - gate.stop - max(reach[1], 0)))
    margin = max(before, 0), max(behind, 0)
    wide = slice(gate.start - margin[0], gate.stop + margin[1])
    cut = np.zeros((records.valid.size, wide.stop - wide.start), volts.dtype)
    cut[records.valid] = _cut_where_moved(volts, wide, moved)
    moved_m = moved * records.sound_speed_m_per_s / (2 * records.sample_rate_hz)
    time_s = records.pulse_time_s
    later_s = np.interp(time_s, time_s[records.valid], moved_m / records.sound_speed_m_per_s)
    followed = replace(records, volts=cut, pulse_time_s=time_s + later_s, margin=margin)
    still = np.zeros(records.valid.size)
    return followed, Motion(followed.pulse_time_s, scatter(moved_m, records.valid), still, records.valid)


def added(motion: Motion, cuts: Motion) -> Motion:
    """Return the displacement found in followed echoes plus that of the cuts."""
    return replace(motion, displacement_m=motion.displacement_m + cuts.displacement_m)


def _moved_samples(volts: Volts, gate: slice, records: EchoGate) -> FloatArray:
    """Return how many samples later than in the first pulse the gate's echo comes, (valid pulse,).

    The sum of steps between consecutive pulses, each by the phase of their correlation in the gate where it is by then.
    """
    length, most = gate.stop - gate.start, volts.shape[1]
    moved, phase, before = np.zeros(len(volts)), np.zeros(len(volts)), None
    turn = _turn_a_sample(volts, records)
    for pulse, echo in enumerate(_analytic(volts, records)):
        first = gate.start + round(moved[pulse - 1]) if pulse else gate.start
        if first < 0 or first + length > most:
            raise ValueError(
                f"the echoes of the gate move through samples {first} to {first + length}, a record has {most}: "
                "take longer records (acquisition.record_samples) or a shorter window"
            )
        here = slice(first, first + length)
        if before is not None:
            phase[pulse] = np.angle(np.vdot(before[here], echo[here]))
            moved[pulse] = moved[pulse - 1] - phase[pulse] / turn
        before = echo
    largest = float(np.abs(phase).max()) / np.pi
    if largest > LARGEST_STEP:
        raise ValueError(
            f"a step of {largest:.2f} quarter wavelengths is ambiguous with one in the other direction: raise the "
            "pulse rate"
        )
    return moved


def _analytic(volts: Volts, records: EchoGate) -> Iterator[ComplexArray]:
    """Yield the analytic signal of each record in the transmitted band, (sample,)."""
    from scipy.fft import ifft, rfft

    samples = volts.shape[1]
    frequency_hz = np.arange(samples // 2 + 1) * records.sample_rate_hz / samples
    outside = (frequency_hz < BAND[0] * records.carrier_hz) | (frequency_hz > BAND[1] * records.carrier_hz)
    for first in range(0, len(volts), _RECORDS_AT_ONCE):
        spectrum = rfft(volts[first : first + _RECORDS_AT_ONCE], axis=1)
        spectrum[:, outside] = 0.0
        yield from ifft(spectrum, samples, axis=1)


def _turn_a_sample(volts: Volts, records: EchoGate) -> float:
    """Return by what angle the echoes turn from sample to sample: their mean frequency."""
    return float(np.angle(sum(np.vdot(echo[:-1], echo[1:]) for echo in _analytic(volts[:_RECORDS_AT_ONCE], records))))


def _cut_where_moved(volts: Volts, gate: slice, moved: FloatArray) -> Volts:
    """Return the gate of each record shifted back by ``moved`` samples (pulse,), (pulse, sample)."""
    from scipy.fft import irfft, rfft

    samples = volts.shape[1]
    omega = 2 * np.pi * np.arange(samples // 2 + 1) / samples
    out = np.empty((len(volts), gate.stop - gate.start), volts.dtype)
    for first in range(0, len(volts), _RECORDS_AT_ONCE):
        some = slice(first, first + _RECORDS_AT_ONCE)
        spectrum = rfft(volts[some], axis=1) * np.exp(1j * moved[some, None] * omega)
        out[some] = irfft(spectrum, samples, axis=1)[:, gate]
    return out
