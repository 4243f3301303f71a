"""AlazarTech's binary records: AutoDMA buffers written one after the other, as the vendor's programs write them.

Traditional AutoDMA puts 16 bytes before every record of every channel, R1A R1B R2A R2B ...: the time of its trigger,
sampling rate and input range by the vendor's numbers. NPT mode puts nothing there, and all records of a channel in a
buffer stand together, R1A R2A ... R1B R2B ... Layout: docs/theory/instruments.md, 2.5 and 2.6.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from hpe_rig.arrays import ByteArray, UInt32Array
from hpe_rig.bench import DigitizerBoard
from hpe_rig.recordings.contents import Contents
from hpe_rig.recordings.settings import RecordingSettings

HEADER_BYTES = 16
RATE_SHIFT, RATE_BITS = 11, 7
RANGE_SHIFT, RANGE_BITS = 18, 5


class Alazar:
    """Records of a board that is named, of a length that is stated."""

    suffixes = (".alz", ".atb")

    def read(self, path: Path, settings: RecordingSettings) -> Contents:
        """Return the codes of one channel, (pulse, sample), and what the headers state."""
        if settings.board is None or settings.record_samples is None:
            absent = [name for name in ("board", "record_samples") if getattr(settings, name) is None]
            raise ValueError(
                f"{' and '.join(absent)} is not stated, which the file does not say: "
                'board = "ATS460", record_samples = 512, in a sidecar file or with --set'
            )
        model, samples, channels = (
            DigitizerBoard(model=settings.board).board_model,
            settings.record_samples,
            settings.channels,
        )
        data = np.fromfile(path, np.uint8)
        with_headers = _has_headers(data, samples * model.sample_bytes, channels, settings.headers)
        length = samples * model.sample_bytes + (HEADER_BYTES if with_headers else 0)
        if not data.size or data.size % (length * channels):
            raise ValueError(
                f"it has {data.size} bytes, which are no whole records of {samples} samples on {channels} channels "
                f"({length * channels} bytes): the right record_samples, channels, board or headers"
            )
        which = "AB".index(settings.channel)
        if which >= channels:
            raise ValueError("channel B of a recording of one channel: channels = 2")
        if with_headers:
            records = data.reshape(-1, channels, length)[:, which]
            words, headers = records[:, HEADER_BYTES:], np.ascontiguousarray(records[:, :HEADER_BYTES]).view("<u4")
            stated, signed = _stated(headers, model, settings), bool(headers[0, 0] >> 30 & 1)
        else:
            per_buffer = settings.records_per_buffer or data.size // (length * channels)
            if data.size % (length * channels * per_buffer):
                raise ValueError(
                    f"it has {data.size // (length * channels)} records a channel, no whole buffers of "
                    f"records_per_buffer = {per_buffer}: the number with which it was written"
                )
            words = data.reshape(-1, channels, per_buffer, length)[:, which].reshape(-1, length)
            stated, signed = {}, False
        kind, zero = ("i", 0) if signed else ("u", 1 << (model.code_bits - 1))
        raw = np.ascontiguousarray(words).view(f"<{kind}{model.sample_bytes}").astype(np.int32)
        codes = (raw >> (8 * model.sample_bytes - model.code_bits)) - zero
        limited = np.maximum(codes, model.code_limits[0]).astype(np.int16)
        range_v = settings.input_range_v or stated.pop("input_range_v", (None, ""))[0]
        if range_v is None:
            raise ValueError("the input range is not stated: input_range_v = 0.8, plus and minus")
        stated.pop("input_range_v", None)
        stated["scale_v"] = (2 * range_v / ((1 << model.code_bits) - 1), f"an input range of {range_v:g} V")
        return Contents({path.stem: limited}, stated, axes=("pulse", "sample"), board=settings.board)


def _has_headers(data: ByteArray, record_bytes: int, channels: int, stated: bool | None) -> bool:
    if stated is not None:
        return stated
    with_them, without = record_bytes + HEADER_BYTES, record_bytes
    if data.size % (with_them * channels) == 0 and data.size % (without * channels):
        return True
    if data.size % (without * channels) == 0 and data.size % (with_them * channels):
        return False
    if not data.size or data.size % (with_them * channels):
        return False
    # Both fit: the numbers of the records count up where there are headers.
    headers = np.ascontiguousarray(data.reshape(-1, with_them)[::channels, :HEADER_BYTES]).view("<u4")
    numbers = (headers[:, 1] & 0xFFFFFF).astype(np.int64)
    return bool(numbers.size > 1 and np.all(np.diff(numbers) == 1))


def _stated(headers: UInt32Array, model: Any, settings: RecordingSettings) -> dict[str, tuple[Any, str]]:
    """Return what the headers (record, 4) say: rate and range by the vendor's numbers, the times of the triggers."""
    stated: dict[str, tuple[Any, str]] = {}
    rate_id = int(headers[0, 3] >> RATE_SHIFT) & ((1 << RATE_BITS) - 1)
    range_id = int(headers[0, 3] >> RANGE_SHIFT) & ((1 << RANGE_BITS) - 1)
    rates = {number: rate for rate, number in model.rate_ids.items()}
    ranges = {number: volts for volts, number in model.range_ids.items()}
    if rate_id in rates:
        stated["sample_rate_hz"] = (rates[rate_id], "the record headers")
    if range_id in ranges:
        stated["input_range_v"] = (ranges[range_id], "the record headers")
    rate_hz = settings.sample_rate_hz or rates.get(rate_id)
    low, high = headers[:, 2].astype(np.int64), headers[:, 3].astype(np.int64) & 0xFF
    counts = (high << 32) | low
    if rate_hz and counts.size > 1 and np.ptp(counts):
        time_s = (counts - counts[0]) * model.samples_per_timestamp / rate_hz
        stated["pulse_time_s"] = (tuple(time_s.tolist()), "the record headers")
    return stated
