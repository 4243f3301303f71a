"""AlazarTech's binary records: AutoDMA buffers written one after the other, as the vendor's programs write them.

Traditional AutoDMA writes a header of 16 bytes before every record of every channel, R1A R1B R2A R2B ...: the time of
its trigger, sampling rate and input range by the vendor's numbers. NPT mode writes no headers, and all records of a
channel in a buffer follow each other, R1A R2A ... R1B R2B ... Layout: docs/explanation/instruments.md, 2.5 and 2.6.
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


def read_alazar(path: Path, settings: RecordingSettings) -> Contents:
    """Return the codes (pulse, sample) of one channel of a stated board, and the settings in the headers."""
    if settings.board is None or settings.record_samples is None:
        absent = [name for name in ("board", "record_samples") if getattr(settings, name) is None]
        raise ValueError(
            f"the file does not state {' and '.join(absent)}: "
            'board = "ATS460", record_samples = 512, in a sidecar file or with --set'
        )
    model = DigitizerBoard(model=settings.board).board_model
    channel_index = "AB".index(settings.channel)
    if channel_index >= settings.channels:
        raise ValueError("channel B of a recording of one channel: channels = 2")
    data = np.fromfile(path, np.uint8)
    record_bytes = settings.record_samples * model.sample_bytes
    if _has_headers(data, record_bytes, settings):
        records = _split(data, record_bytes + HEADER_BYTES, settings, buffer_records=1)[:, channel_index]
        headers = np.ascontiguousarray(records[:, :HEADER_BYTES]).view("<u4")
        words, stated = records[:, HEADER_BYTES:], _stated_by_headers(headers, model, settings)
        signed = bool(headers[0, 0] >> 30 & 1)
    else:
        total = data.size // (record_bytes * settings.channels)
        records = _split(data, record_bytes, settings, settings.records_per_buffer or total)
        words, stated, signed = records[:, channel_index], {}, False
    header_range_v = stated.pop("input_range_v", (None, ""))[0]
    range_v = settings.input_range_v or header_range_v
    if range_v is None:
        raise ValueError("the input range is not stated: input_range_v = 0.8, plus and minus")
    # The codes span plus and minus the input range.
    stated["scale_v"] = (2 * range_v / ((1 << model.code_bits) - 1), f"an input range of {range_v:g} V")
    codes = _codes(words, model, signed)
    return Contents({path.stem: codes}, stated, axes=("pulse", "sample"), board=settings.board)


def _split(data: ByteArray, length: int, settings: RecordingSettings, buffer_records: int) -> ByteArray:
    """Return the bytes as (record, channel, byte); ``buffer_records`` records of a channel follow each other."""
    channels = settings.channels
    if not data.size or data.size % (length * channels):
        raise ValueError(
            f"it has {data.size} bytes, which are no whole records of {settings.record_samples} samples on {channels} "
            f"channels ({length * channels} bytes): the right record_samples, channels, board or headers"
        )
    total = data.size // (length * channels)
    if total % buffer_records:
        raise ValueError(
            f"it has {total} records per channel, no whole buffers of records_per_buffer = {buffer_records}: "
            "the number with which it was written"
        )
    buffers = data.reshape(-1, channels, buffer_records, length)
    return np.swapaxes(buffers, 1, 2).reshape(-1, channels, length)


def _codes(words: ByteArray, model: Any, signed: bool) -> Any:
    """Return zero-centred int16 codes (record, sample); samples are left-aligned in their words."""
    kind, zero = ("i", 0) if signed else ("u", 1 << (model.code_bits - 1))
    raw = np.ascontiguousarray(words).view(f"<{kind}{model.sample_bytes}").astype(np.int32)
    codes = (raw >> (8 * model.sample_bytes - model.code_bits)) - zero
    return np.maximum(codes, model.code_limits[0]).astype(np.int16)


def _has_headers(data: ByteArray, record_bytes: int, settings: RecordingSettings) -> bool:
    """Return whether records have headers: as stated, by the size of the file, or by ascending record numbers."""
    if settings.headers is not None:
        return settings.headers
    channels = settings.channels
    fits_with_headers = data.size > 0 and data.size % ((record_bytes + HEADER_BYTES) * channels) == 0
    fits_without = data.size % (record_bytes * channels) == 0
    if not fits_with_headers or not fits_without:
        return fits_with_headers
    # Both layouts fit the size of the file. With headers, the record numbers in the second word ascend by one.
    headers = np.ascontiguousarray(data.reshape(-1, record_bytes + HEADER_BYTES)[::channels, :HEADER_BYTES]).view("<u4")
    numbers = (headers[:, 1] & 0xFFFFFF).astype(np.int64)
    return bool(numbers.size > 1 and np.all(np.diff(numbers) == 1))


def _stated_by_headers(headers: UInt32Array, model: Any, settings: RecordingSettings) -> dict[str, tuple[Any, str]]:
    """Return rate and range, by the vendor's numbers, and the trigger times in the ``headers`` (record, 4)."""
    stated: dict[str, tuple[Any, str]] = {}
    # Rate and range are bit fields in the fourth word.
    rate_id = int(headers[0, 3] >> RATE_SHIFT) & ((1 << RATE_BITS) - 1)
    range_id = int(headers[0, 3] >> RANGE_SHIFT) & ((1 << RANGE_BITS) - 1)
    rates_hz = {number: rate_hz for rate_hz, number in model.rate_ids.items()}
    ranges_v = {number: range_v for range_v, number in model.range_ids.items()}
    if rate_id in rates_hz:
        stated["sample_rate_hz"] = (rates_hz[rate_id], "the record headers")
    if range_id in ranges_v:
        stated["input_range_v"] = (ranges_v[range_id], "the record headers")
    rate_hz = settings.sample_rate_hz or rates_hz.get(rate_id)
    # The time stamp has 40 bits: 32 in the third word, 8 in the fourth.
    low, high = headers[:, 2].astype(np.int64), headers[:, 3].astype(np.int64) & 0xFF
    counts = (high << 32) | low
    if rate_hz and counts.size > 1 and np.ptp(counts):
        time_s = (counts - counts[0]) * model.samples_per_timestamp / rate_hz
        stated["pulse_time_s"] = (tuple(time_s.tolist()), "the record headers")
    return stated
