"""Signals of a commissioning: a waveform for each instrument, which identifies it in records, and its arrival time.

The generators' pulses differ in width, their bursts in carrier and cycles. The digitizer's trigger output stays high
for the rest of the record.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache

import numpy as np

from drivers.interfaces import Capture, GeneratorTask, PulseTrain, Toneburst, TriggerPulse
from hpe_rig.arrays import FloatArray
from hpe_rig.bench import BenchFile

SAMPLE_RATE_HZ = 100e6
"""A rate of every supported board."""
RECORD_SAMPLES, PRE_TRIGGER_SAMPLES = 1024, 192
"""Multiples that every board accepts; 1.9 us before the trigger contain the master's edge with 200 m of cable."""
BASELINE_SAMPLES = 64
PULSE_WIDTHS_S = {"master": 1e-6, "burst_train": 2e-6, "tracking_train": 4e-6}
BURSTS = {"toneburst": (1e6, 3), "tracking_pulser": (2e6, 4)}
"""Carrier in Hz, and cycles."""
TRAIN_RATE_HZ = 10e3
TTL_HIGH_V = 5.0
"""Without load; behind a T piece with 50 ohm at its third end 2.5 V are left, above the 2.0 V of a TTL input."""
BURST_VPP = 0.1
"""Amplitude at the transducer's cables: 20 dB below the usual drive."""
TTL_RANGE_V = 4.0
MIN_PEAK = 0.05
"""Smallest signal, relative to the input range."""
SYNCHRONOUS = 1e-3
"""Largest scatter of synchronous edges, relative to the sample period."""
MIN_EXPLAINED = 0.8
"""Smallest fraction of a record's energy that the waveform of the best instrument explains; others reach 0.5."""


@dataclass(frozen=True, slots=True)
class Arrival:
    """A signal in the records: its role, its time after the trigger with standard uncertainty u, and its polarity."""

    role: str
    time_s: float
    u_s: float
    inverted: bool


def tasks(bench: BenchFile) -> dict[str, GeneratorTask]:
    """Return the task of each generator: one pulse or burst for each trigger."""
    return {"master": command_pulse(bench)} | {
        role: _task(role, bench) for role in bench.generators.by_role if role != "master"
    }


def command_pulse(bench: BenchFile) -> TriggerPulse:
    """Return the pulse of the master, or of another generator that is triggered by command."""
    high_v = min(TTL_HIGH_V, bench.generators.master.max_vpp or math.inf)
    # Declared as without load, so that no input of any impedance gets more than ``high_v``.
    return TriggerPulse(PULSE_WIDTHS_S["master"], high_v, math.inf)


def _task(role: str, bench: BenchFile) -> GeneratorTask:
    generator = bench.generators.by_role[role]
    limit_vpp = generator.max_vpp or math.inf
    if role in BURSTS:
        carrier_hz, cycles = BURSTS[role]
        amplitude_vpp = min(BURST_VPP, limit_vpp, bench.limits.max_drive_vpp or math.inf)
        return Toneburst(carrier_hz, cycles, amplitude_vpp, 0.0, generator.load_ohm)
    return PulseTrain(TRAIN_RATE_HZ, 1, 0.0, PULSE_WIDTHS_S[role], min(TTL_HIGH_V, limit_vpp), math.inf)


def capture_of(role: str, bench: BenchFile, count: int) -> Capture:
    """Return the capture of ``count`` records that contain the signal of ``role``."""
    range_v = bench.digitizer.board_model.range_from_v(BURST_VPP if role in BURSTS else TTL_RANGE_V)
    level_v = bench.digitizer.trigger_level_v
    return Capture(SAMPLE_RATE_HZ, RECORD_SAMPLES, -PRE_TRIGGER_SAMPLES, count, range_v, level_v, range_v)


@cache
def _waveforms() -> Mapping[str, FloatArray]:
    """Return the waveform of each role from its onset on: (sample,)."""
    time_s = np.arange(RECORD_SAMPLES) / SAMPLE_RATE_HZ
    pulses = {role: (time_s < width_s) * 1.0 for role, width_s in PULSE_WIDTHS_S.items()}
    bursts = {
        role: np.where(time_s < cycles / carrier_hz, np.sin(2 * np.pi * carrier_hz * time_s), 0.0)
        for role, (carrier_hz, cycles) in BURSTS.items()
    }
    return {**pulses, **bursts, "digitizer": np.ones(RECORD_SAMPLES)}


def arrival(volts: FloatArray, range_v: float) -> Arrival | None:
    """Return the signal in ``volts`` (record, sample), None if there is none or it is no instrument's."""
    level_v = volts - volts[:, :BASELINE_SAMPLES].mean(axis=1, keepdims=True)
    if not len(volts) or np.abs(level_v).max(axis=1).min() < MIN_PEAK * range_v:
        return None
    matches = {role: _match(level_v, waveform) for role, waveform in _waveforms().items()}
    role, (explained, lag, sign) = max(matches.items(), key=lambda item: float(item[1][0].mean()))
    if explained.mean() < MIN_EXPLAINED:
        return None
    time_s = (lag - PRE_TRIGGER_SAMPLES) / SAMPLE_RATE_HZ
    count, period_s = len(volts), 1 / SAMPLE_RATE_HZ
    scatter_s = float(time_s.std(ddof=1)) if count > 1 else period_s
    # Rounding to samples: an edge that is synchronous with the sample clock is rounded by the same amount in every
    # record, other edges by amounts that average out. The carrier of a burst shows fractions of a sample.
    is_synchronous = role not in BURSTS and scatter_s < SYNCHRONOUS * period_s
    rounding_s = period_s / math.sqrt(12) if is_synchronous else period_s / count
    u_s = math.hypot(scatter_s / math.sqrt(count), rounding_s)
    return Arrival(role, float(time_s.mean()), u_s, bool(sign.mean() < 0))


def _match(level_v: FloatArray, waveform: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the energy fraction that the delayed ``waveform`` explains, its delay in samples, and its sign.

    The delay is that of the largest fraction, refined by a parabola; each has shape (record,).
    """
    samples = level_v.shape[1]
    spectrum = np.fft.rfft(level_v, 2 * samples) * np.conj(np.fft.rfft(waveform, 2 * samples))
    correlation = np.fft.irfft(spectrum)[:, :samples]
    # Energy of the part of the waveform that is inside the record, by its delay.
    energy = np.maximum(np.cumsum(waveform**2)[::-1], 1e-12)
    explained = correlation**2 / energy / (level_v**2).sum(axis=1, keepdims=True)
    record = np.arange(len(level_v))
    peak = np.clip(explained.argmax(axis=1), 1, samples - 2)
    before, at, after = (explained[record, peak + step] for step in (-1, 0, 1))
    curvature = before - 2 * at + after
    fraction = np.divide(before - after, 2 * curvature, out=np.zeros(len(peak)), where=curvature < 0)
    return at, peak + fraction, np.sign(correlation[record, peak])
