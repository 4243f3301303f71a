"""Limits of a digitizer board, checked before anything is sent to it; the numbers of a board are in `models`."""

from __future__ import annotations

import math
from collections.abc import Collection
from typing import Final, Literal, NamedTuple

from drivers.alazar.models import ATS460_BOARD, BoardModel
from drivers.alazar.samples import HEADER_BYTES, buffer_bytes
from drivers.interfaces import Capture

MAX_RECORD_COUNT: Final = 0x7FFF_FFFE
BUFFER_TARGET_BYTES: Final = 2**20
# If software triggers do not complete the last buffer, a missing trigger loses this fraction of the capture at most.
MAX_BUFFER_FRACTION: Final = 1 / 8

Mode = Literal["single_port", "traditional", "npt"]


class Refusal(NamedTuple):
    """A capture setting that the board does not accept: the field of ``Capture``, and a text with value and limits."""

    field: str
    text: str


def mistakes(
    capture: Capture, model: BoardModel = ATS460_BOARD, mode: Mode = "traditional", fpga: int | None = None
) -> list[Refusal]:
    """Return every setting that ``model`` does not accept in ``mode``; ``fpga`` None means a recent version."""
    monitor_v, level_v, level_limit_v = capture.monitor_range_v, capture.trigger_level_v, model.trigger_range_v
    texts_by_field = {
        "monitor_range_v": [] if monitor_v is None else _not_in("monitor_range_v", monitor_v, model.input_ranges_v),
        "sample_rate_hz": _not_in("sample_rate_hz", capture.sample_rate_hz, model.sample_rates_hz),
        "input_range_v": _not_in("input_range_v", capture.input_range_v, model.input_ranges_v),
        "record_samples": _record_samples(capture, model, mode),
        "trigger_delay_samples": _delay(capture, model, mode),
        "record_count": _record_count(capture.record_count, model, mode, fpga),
        "trigger_level_v": _outside("trigger_level_v", level_v, -level_limit_v, level_limit_v)
        or _below_comparator_step(level_v, level_limit_v),
    }
    return [Refusal(field, text) for field, texts in texts_by_field.items() for text in texts]


def pre_trigger_samples(capture: Capture) -> int:
    """Return the samples before the trigger; a negative delay is a pre-trigger."""
    return max(0, -capture.trigger_delay_samples)


def level_code(level_v: float, range_v: float = ATS460_BOARD.trigger_range_v) -> int:
    """Return the comparator's code of a level at the external trigger input; truncated as in the SDK guide."""
    return int(128 + 127 * level_v / range_v)


def records_per_buffer(capture: Capture, channels: int = 1, model: BoardModel = ATS460_BOARD) -> int:
    """Return the largest divisor of the record count that fills at most 1 MiB and an eighth of the capture."""
    record_bytes = buffer_bytes(capture.record_samples, channels, True, model)
    limit = min(BUFFER_TARGET_BYTES / record_bytes, capture.record_count * MAX_BUFFER_FRACTION)
    return max(count for count in _divisors(capture.record_count) if count <= max(1.0, limit))


def _below_comparator_step(level_v: float, range_v: float) -> list[str]:
    """Return the mistake of a level with the code of 0 V, which a pulse from 0 V upwards never crosses."""
    if level_code(level_v, range_v) != level_code(0.0, range_v):
        return []
    return [f"trigger_level_v = {level_v:g} is less than a step of the comparator, {range_v / 127:.2g} V"]


def _divisors(count: int) -> list[int]:
    divisors = [divisor for divisor in range(1, math.isqrt(count) + 1) if count % divisor == 0]
    return sorted({*divisors, *(count // divisor for divisor in divisors)})


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
    delay, pre_trigger = capture.trigger_delay_samples, pre_trigger_samples(capture)
    if not pre_trigger:
        outside = _outside("trigger_delay_samples", delay, 0, model.max_trigger_delay_samples)
        return outside or _no_multiple("trigger_delay_samples", delay, model.trigger_delay_multiple)
    return [
        *([f"{pre_trigger} pre-trigger samples, NPT records have none"] if mode == "npt" else []),
        *_outside("pre-trigger samples", pre_trigger, 0, capture.record_samples - model.pre_trigger_multiple),
        *_no_multiple("pre-trigger samples", pre_trigger, model.pre_trigger_multiple),
    ]


def _record_count(count: int, model: BoardModel, mode: Mode, fpga: int | None) -> list[str]:
    outside = _outside("record_count", count, 1, MAX_RECORD_COUNT)
    if mode != "single_port" or fpga is None or count <= model.record_limit(fpga):
        return outside
    return [f"record_count = {count}, a board with FPGA version {fpga} holds {model.record_limit(fpga)}", *outside]


def _no_multiple(name: str, value: int, step: int) -> list[str]:
    below = value - value % step
    return [] if below == value else [f"{name} = {value} is no multiple of {step} (next: {below} or {below + step})"]


def _outside(name: str, value: float, lowest: float, highest: float) -> list[str]:
    # Written so that NaN counts as outside.
    return [] if lowest <= value <= highest else [f"{name} = {value:.10g} is outside {lowest:.10g} .. {highest:.10g}"]


def _not_in(name: str, value: float, accepted: Collection[float]) -> list[str]:
    return [] if value in accepted else [f"{name} = {value:.10g} is none of {', '.join(f'{v:g}' for v in accepted)}"]
