"""Limits of a digitizer board, checked before anything is sent to it; the numbers of a board are in `models`."""

from __future__ import annotations

import math
from collections.abc import Collection
from typing import Final, Literal, NamedTuple

from drivers.alazar.models import ATS460_BOARD, BoardModel
from drivers.alazar.samples import HEADER_BYTES, buffer_bytes
from drivers.interfaces import Capture

MOST_RECORDS: Final = 0x7FFF_FFFE
BUFFER_WANTED_BYTES: Final = 2**20
# The part of a capture that is lost, at most, when its last trigger does not come: a part-filled buffer stays unread.
LARGEST_BUFFER_SHARE: Final = 1 / 8

Mode = Literal["single_port", "traditional", "npt"]


class Refusal(NamedTuple):
    """What a board cannot do of a capture: which field of ``Capture``, and in words with the value and the limits."""

    field: str
    text: str


def mistakes(
    capture: Capture, model: BoardModel = ATS460_BOARD, mode: Mode = "traditional", fpga: int | None = None
) -> list[Refusal]:
    """Return what ``model`` cannot do of ``capture`` in ``mode``; without ``fpga`` version a recent one is assumed."""
    monitor_v, level_v, highest_v = capture.monitor_range_v, capture.trigger_level_v, model.trigger_range_v
    found = {
        "monitor_range_v": [] if monitor_v is None else _one_of("monitor_range_v", monitor_v, model.input_ranges_v),
        "sample_rate_hz": _one_of("sample_rate_hz", capture.sample_rate_hz, model.sample_rates_hz),
        "input_range_v": _one_of("input_range_v", capture.input_range_v, model.input_ranges_v),
        "record_samples": _record_samples(capture, model, mode),
        "trigger_delay_samples": _delay(capture, model, mode),
        "record_count": _record_count(capture.record_count, model, mode, fpga),
        "trigger_level_v": _outside("trigger_level_v", level_v, -highest_v, highest_v) or _no_step(level_v, highest_v),
    }
    return [Refusal(field, text) for field, texts in found.items() for text in texts]


def pre_trigger_samples(capture: Capture) -> int:
    """Return the samples before the trigger; a negative delay is a pre-trigger."""
    return max(0, -capture.trigger_delay_samples)


def level_code(level_v: float, range_v: float = ATS460_BOARD.trigger_range_v) -> int:
    """Return the comparator's code of a level at the external trigger input; truncated as in the SDK guide."""
    return int(128 + 127 * level_v / range_v)


def records_per_buffer(capture: Capture, channels: int = 1, model: BoardModel = ATS460_BOARD) -> int:
    """Return the largest divisor of the record count that fills at most 1 MiB and an eighth of the capture."""
    size_bytes = buffer_bytes(capture.record_samples, channels, True, model)
    most = min(BUFFER_WANTED_BYTES / size_bytes, capture.record_count * LARGEST_BUFFER_SHARE)
    return max(count for count in _divisors(capture.record_count) if count <= max(1.0, most))


def _no_step(level_v: float, range_v: float) -> list[str]:
    """Return that the comparator cannot tell a level from 0 V, which a pulse from 0 V up never crosses."""
    if level_code(level_v, range_v) != level_code(0.0, range_v):
        return []
    return [f"trigger_level_v = {level_v:g} is less than a step of the comparator, {range_v / 127:.2g} V"]


def _divisors(count: int) -> list[int]:
    small = [d for d in range(1, math.isqrt(count) + 1) if count % d == 0]
    return sorted({*small, *(count // d for d in small)})


def _record_samples(capture: Capture, model: BoardModel, mode: Mode) -> list[str]:
    samples, channels = capture.record_samples, capture.channels
    # A buffer holds at least one record of every channel.
    longest = (model.buffer_limit_bytes // channels - HEADER_BYTES) // model.sample_bytes - model.record_multiple
    name = "record_samples" if channels == 1 else f"record_samples of {channels} channels"
    npt = _no_multiple("record_samples of NPT records", samples, model.npt_record_multiple) if mode == "npt" else []
    return [
        *npt,
        *_outside(name, samples, model.record_minimum, longest),
        *_no_multiple("record_samples", samples, model.record_multiple),
    ]


def _delay(capture: Capture, model: BoardModel, mode: Mode) -> list[str]:
    delay, before = capture.trigger_delay_samples, pre_trigger_samples(capture)
    if not before:
        outside = _outside("trigger_delay_samples", delay, 0, model.max_trigger_delay_samples)
        return outside or _no_multiple("trigger_delay_samples", delay, model.trigger_delay_multiple)
    return [
        *([f"{before} pre-trigger samples, NPT records have none"] if mode == "npt" else []),
        *_outside("pre-trigger samples", before, 0, capture.record_samples - model.pre_trigger_multiple),
        *_no_multiple("pre-trigger samples", before, model.pre_trigger_multiple),
    ]


def _record_count(count: int, model: BoardModel, mode: Mode, fpga: int | None) -> list[str]:
    outside = _outside("record_count", count, 1, MOST_RECORDS)
    if mode != "single_port" or fpga is None or count <= model.record_limit(fpga):
        return outside
    return [f"record_count = {count}, a board with FPGA version {fpga} holds {model.record_limit(fpga)}", *outside]


def _no_multiple(name: str, value: int, step: int) -> list[str]:
    below = value - value % step
    return [] if below == value else [f"{name} = {value} is no multiple of {step} (next: {below} or {below + step})"]


def _outside(name: str, value: float, lowest: float, highest: float) -> list[str]:
    # Written so that a nan is outside as well.
    return [] if lowest <= value <= highest else [f"{name} = {value:.10g} is outside {lowest:.10g} .. {highest:.10g}"]


def _one_of(name: str, value: float, accepted: Collection[float]) -> list[str]:
    return [] if value in accepted else [f"{name} = {value:.10g} is none of {', '.join(f'{v:g}' for v in accepted)}"]
