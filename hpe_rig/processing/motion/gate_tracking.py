"""Gate tracking: a gate that follows the tissue inside it through background motion larger than the gate.

    p_k = sum over the gate at pulse k of conj(z_k-1) z_k          z: analytic signal of a record in the band
    s_k = s_k-1 - arg p_k / omega                                  shift in samples; omega: mean phase per sample

The records are shifted back by s_k with the Fourier shift theorem, so that the shift is exact also between samples.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from hpe_rig.arrays import ComplexArray, FloatArray
from hpe_rig.processing.echo.band import BAND
from hpe_rig.processing.echo.gate import EchoGate, Volts, expand_to_pulses, margin_samples
from hpe_rig.processing.motion.displacement import Motion

MAX_STEP = 0.95
"""Quarter wavelengths between pulses; a larger step may be one in the other direction."""
_CHUNK_RECORDS = 256


def track_gate(records: EchoGate, gate: slice) -> tuple[EchoGate, Motion]:
    """Return the echoes in a gate that follows its tissue, and the motion of that gate.

    ``records`` (pulse, sample) are whole, without margins. The gate keeps the tissue that ``gate`` holds at the first
    valid pulse. The motion of the gate has variance 0; ``add_gate_motion`` adds it to the displacement within the gate,
    estimated from the returned echoes. Their pulse times include the change of travel time. Their margins, samples on
    either side of the gate, are as wide as all records allow. Raises ``ValueError`` for more than one train, if a step
    exceeds a quarter wavelength, and if the echoes leave the records.
    """
    if records.volts.ndim != 2:
        raise ValueError(f"volts {records.volts.shape}: one train (pulse, sample) at a time can be followed")
    volts = records.volts[...]
    volts = volts if records.valid.all() else volts[records.valid]
    shift = _gate_shift_samples(volts, gate, records)

    # All pulses have the same margins: the gate nearest to an end of its record limits them.
    full_margin = margin_samples(records.sample_rate_hz, records.carrier_hz)
    before = min(full_margin, int(gate.start + min(shift.min(), 0)))
    after = min(full_margin, int(volts.shape[1] - gate.stop - max(shift.max(), 0)))
    margin = max(before, 0), max(after, 0)
    with_margins = slice(gate.start - margin[0], gate.stop + margin[1])
    tracked = np.zeros((records.valid.size, with_margins.stop - with_margins.start), volts.dtype)
    tracked[records.valid] = _shifted_back(volts, with_margins, shift)

    gate_m = shift * records.sound_speed_m_per_s / (2 * records.sample_rate_hz)
    time_s = records.pulse_time_s
    # Tissue that has moved away by u is reached u / c later.
    delay_s = np.interp(time_s, time_s[records.valid], gate_m / records.sound_speed_m_per_s)
    echoes = replace(records, volts=tracked, pulse_time_s=time_s + delay_s, margin=margin)
    gate_motion = Motion(
        time_s=echoes.pulse_time_s,
        displacement_m=expand_to_pulses(gate_m, records.valid),
        variance_m2=np.zeros(records.valid.size),
        valid=records.valid,
    )
    return echoes, gate_motion


def add_gate_motion(motion: Motion, gate_motion: Motion) -> Motion:
    """Return the displacement relative to a tracked gate plus that of the gate."""
    return replace(motion, displacement_m=motion.displacement_m + gate_motion.displacement_m)


def _gate_shift_samples(volts: Volts, gate: slice, records: EchoGate) -> FloatArray:
    """Return the delay (valid pulse,) of the gate's echo relative to the first pulse, in samples.

    ``volts`` (valid pulse, sample): whole records. The delay is a sum of steps. Each is the phase of the correlation of
    two consecutive pulses, in the gate at its position of the first of the two.
    """
    length, samples = gate.stop - gate.start, volts.shape[1]
    shift, phase, previous = np.zeros(len(volts)), np.zeros(len(volts)), None
    phase_per_sample = _phase_per_sample(volts, records)
    for pulse, echo in enumerate(_analytic_signals(volts, records)):
        first = gate.start + round(shift[pulse - 1]) if pulse else gate.start
        if first < 0 or first + length > samples:
            raise ValueError(
                f"the echoes of the gate move through samples {first} to {first + length}, a record has {samples}: "
                "take longer records (acquisition.record_samples) or a shorter window"
            )
        position = slice(first, first + length)
        if previous is not None:
            phase[pulse] = np.angle(np.vdot(previous[position], echo[position]))
            shift[pulse] = shift[pulse - 1] - phase[pulse] / phase_per_sample
        previous = echo
    largest = float(np.abs(phase).max()) / np.pi
    if largest > MAX_STEP:
        raise ValueError(
            f"a step of {largest:.2f} quarter wavelengths is ambiguous with one in the other direction: raise the "
            "pulse rate"
        )
    return shift


def _analytic_signals(volts: Volts, records: EchoGate) -> Iterator[ComplexArray]:
    """Yield the analytic signal (sample,) of each record of ``volts`` (pulse, sample) in the transmitted band."""
    from scipy.fft import ifft, rfft

    samples = volts.shape[1]
    frequency_hz = np.arange(samples // 2 + 1) * records.sample_rate_hz / samples
    outside = (frequency_hz < BAND[0] * records.carrier_hz) | (frequency_hz > BAND[1] * records.carrier_hz)
    for first in range(0, len(volts), _CHUNK_RECORDS):
        spectrum = rfft(volts[first : first + _CHUNK_RECORDS], axis=1)
        spectrum[:, outside] = 0.0
        yield from ifft(spectrum, samples, axis=1)


def _phase_per_sample(volts: Volts, records: EchoGate) -> float:
    """Return the mean phase advance of the echoes from sample to sample, rad: their mean frequency."""
    echoes = _analytic_signals(volts[:_CHUNK_RECORDS], records)
    return float(np.angle(sum(np.vdot(echo[:-1], echo[1:]) for echo in echoes)))


def _shifted_back(volts: Volts, gate: slice, shift: FloatArray) -> Volts:
    """Return the samples ``gate`` of each record after its echoes are shifted back by ``shift`` (pulse,) samples.

    ``volts`` (pulse, sample): whole records. The shift is a linear phase of the spectrum.
    """
    from scipy.fft import irfft, rfft

    samples = volts.shape[1]
    omega = 2 * np.pi * np.arange(samples // 2 + 1) / samples
    gated = np.empty((len(volts), gate.stop - gate.start), volts.dtype)
    for first in range(0, len(volts), _CHUNK_RECORDS):
        chunk = slice(first, first + _CHUNK_RECORDS)
        spectrum = rfft(volts[chunk], axis=1) * np.exp(1j * shift[chunk, None] * omega)
        gated[chunk] = irfft(spectrum, samples, axis=1)[:, gate]
    return gated
