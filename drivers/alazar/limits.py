"""What an ATS460 accepts, and what it calls it (reference 2.4 and 2.5); nothing here talks to the board."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Final, Literal

from drivers.interfaces import Capture, InstrumentError

RATE_IDS: Final[Mapping[float, int]] = MappingProxyType(
    {
        1e3: 0x01,
        2e3: 0x02,
        5e3: 0x04,
        10e3: 0x08,
        20e3: 0x0A,
        50e3: 0x0C,
        100e3: 0x0E,
        200e3: 0x10,
        500e3: 0x12,
        1e6: 0x14,
        2e6: 0x18,
        5e6: 0x1A,
        10e6: 0x1C,
        20e6: 0x1E,
        50e6: 0x22,
        100e6: 0x24,
        125e6: 0x25,
    }
)
# Accepted at 50 ohm, from memory of the data sheet; the board answers 513 where this is wrong.
RANGE_IDS: Final[Mapping[float, int]] = MappingProxyType(
    {
        0.02: 1,
        0.04: 2,
        0.05: 3,
        0.08: 4,
        0.1: 5,
        0.2: 6,
        0.4: 7,
        0.5: 8,
        0.8: 9,
        1.0: 10,
        2.0: 11,
        4.0: 12,
    }
)
LEAST_RECORD_SAMPLES: Final = 128
RECORD_ALIGNMENT: Final = 16
RECORD_ALIGNMENT_NPT: Final = 32
PRE_TRIGGER_ALIGNMENT: Final = 64
LONGEST_DELAY_SAMPLES: Final = 9_999_999
MOST_RECORDS: Final = 0x7FFF_FFFE
TRIGGER_RANGE_V: Final = 5.0
HEADER_BYTES: Final = 16
BUFFER_LIMIT_BYTES: Final = 4 * 2**20
BUFFER_WANTED_BYTES: Final = 2**20
# The part of a capture that is lost, at most, when its last trigger does not come: a part-filled buffer stays unread.
LARGEST_BUFFER_SHARE: Final = 1 / 8
OLD_FPGA: Final = 18
OLD_FPGA_RECORDS: Final = 1000

Mode = Literal["single_port", "traditional", "npt"]


def refuse(role: str, mistakes: Sequence[str]) -> None:
    """Raise one ``InstrumentError`` with all of ``mistakes``; nothing when there are none."""
    if mistakes:
        why = "the ATS460 cannot do this, and nothing was sent to it"
        raise InstrumentError(role, "; ".join(mistakes), why, "change the value in the scene or bench file")


def capture_mistakes(capture: Capture, mode: Mode = "traditional", fpga: int = OLD_FPGA + 1) -> list[str]:
    """Return what an ATS460 with FPGA version ``fpga`` cannot do of ``capture`` in ``mode``."""
    return [
        *([] if capture.monitor_range_v is None else _one_of("monitor_range_v", capture.monitor_range_v, RANGE_IDS)),
        *(_npt_mistakes(capture) if mode == "npt" else []),
        *(_old_fpga_mistakes(capture, fpga) if mode == "single_port" else []),
        *_one_of("sample_rate_hz", capture.sample_rate_hz, RATE_IDS),
        *_one_of("input_range_v", capture.input_range_v, RANGE_IDS),
        *_record_mistakes(capture.record_samples, capture.channels),
        *_delay_mistakes(capture.trigger_delay_samples, capture.record_samples),
        *_outside("record_count", capture.record_count, 1, MOST_RECORDS),
        *_outside("trigger_level_v", capture.trigger_level_v, -TRIGGER_RANGE_V, TRIGGER_RANGE_V),
    ]


def pre_trigger_samples(capture: Capture) -> int:
    """Return the samples before the trigger; a negative delay is a pre-trigger."""
    return max(0, -capture.trigger_delay_samples)


def level_code(level_v: float) -> int:
    """Return the comparator's code of a level at the +-5 V external trigger input; truncated as in the SDK guide."""
    return int(128 + 127 * level_v / TRIGGER_RANGE_V)


def records_per_buffer(capture: Capture, channels: int = 1) -> int:
    """Return the largest divisor of the record count that fills at most 1 MiB and an eighth of the capture."""
    size_bytes = channels * (HEADER_BYTES + 2 * capture.record_samples)
    most = min(BUFFER_WANTED_BYTES / size_bytes, capture.record_count * LARGEST_BUFFER_SHARE)
    return max(count for count in _divisors(capture.record_count) if count <= max(1.0, most))


def _divisors(count: int) -> list[int]:
    small = [d for d in range(1, math.isqrt(count) + 1) if count % d == 0]
    return sorted({*small, *(count // d for d in small)})


def _record_mistakes(samples: int, channels: int) -> list[str]:
    # A buffer holds at least one record of every channel.
    longest = (BUFFER_LIMIT_BYTES // channels - HEADER_BYTES) // 2 - RECORD_ALIGNMENT
    name = "record_samples" if channels == 1 else f"record_samples of {channels} channels"
    return [
        *_outside(name, samples, LEAST_RECORD_SAMPLES, longest),
        *_no_multiple("record_samples", samples, RECORD_ALIGNMENT),
    ]


def _npt_mistakes(capture: Capture) -> list[str]:
    before = pre_trigger_samples(capture)
    return [
        *_no_multiple("record_samples of NPT records", capture.record_samples, RECORD_ALIGNMENT_NPT),
        *([f"{before} pre-trigger samples, NPT records have none"] if before else []),
    ]


def _old_fpga_mistakes(capture: Capture, fpga: int) -> list[str]:
    if fpga > OLD_FPGA or capture.record_count <= OLD_FPGA_RECORDS:
        return []
    held = f"a board with FPGA version {fpga} (up to {OLD_FPGA}) holds {OLD_FPGA_RECORDS}"
    return [f"record_count = {capture.record_count}, {held}"]


def _delay_mistakes(delay: int, record_samples: int) -> list[str]:
    if delay >= 0:
        return _outside("trigger_delay_samples", delay, 0, LONGEST_DELAY_SAMPLES)
    return [
        *_outside("pre-trigger samples", -delay, 0, record_samples - PRE_TRIGGER_ALIGNMENT),
        *_no_multiple("pre-trigger samples", -delay, PRE_TRIGGER_ALIGNMENT),
    ]


def _no_multiple(name: str, value: int, step: int) -> list[str]:
    if value % step == 0:
        return []
    below = value - value % step
    return [f"{name} = {value} is no multiple of {step} (next: {below} or {below + step})"]


def _outside(name: str, value: float, lowest: float, highest: float) -> list[str]:
    # Written so that a nan is outside as well.
    return [] if lowest <= value <= highest else [f"{name} = {value:.10g} is outside {lowest:.10g} .. {highest:.10g}"]


def _one_of(name: str, value: float, accepted: Mapping[float, int]) -> list[str]:
    return [] if value in accepted else [f"{name} = {value:.10g} is none of {', '.join(f'{v:g}' for v in accepted)}"]
