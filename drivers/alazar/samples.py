"""Samples in the board's memory layout -> codes, volts and trigger times; pure functions.

Layout and scale: docs/explanation/instruments.md, 2.5 and 2.6.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from drivers.alazar.models import ATS460_BOARD, BoardModel

TIMESTAMP_HIGH_MASK: Final = 0xFF
HEADER_BYTES: Final = 16

Words = NDArray[np.uint8] | NDArray[np.uint16]
"""Samples in memory: codes in the upper bits of one or two bytes."""


@dataclass(frozen=True, slots=True)
class RawRecords:
    """Consecutive records in the board's format.

    ``words`` (channel, record, sample); ``trigger_samples`` float64 (record,), trigger times in periods of the sample
    clock, NaN if the board does not state them.
    """

    first_record: int
    words: Words
    trigger_samples: NDArray[np.float64]


def word_dtype(model: BoardModel) -> np.dtype[Any]:
    """Return the type of one sample in the board's memory and buffers."""
    return np.dtype(f"<u{model.sample_bytes}")


def native(words: NDArray[Any]) -> Words:
    """Return little-endian ``words`` in the machine's byte order, without a copy if that is little-endian too."""
    return words.astype(words.dtype.newbyteorder("="), copy=False)


def header_record_dtype(record_samples: int, model: BoardModel = ATS460_BOARD) -> np.dtype[Any]:
    """Return the layout of one record of one channel with its header, as traditional AutoDMA writes it."""
    return np.dtype([("header", "<u4", (4,)), ("words", word_dtype(model), (record_samples,))])


def buffer_bytes(record_samples: int, records: int, headers: bool, model: BoardModel = ATS460_BOARD) -> int:
    """Return the size of an AutoDMA buffer; ``records`` counts those of all channels."""
    return (model.sample_bytes * record_samples + (HEADER_BYTES if headers else 0)) * records


def unpacked(
    data: NDArray[np.uint8], channels: int, record_samples: int, npt: bool, model: BoardModel
) -> tuple[Words, NDArray[np.float64]]:
    """Return words (channel, record, sample) and trigger counts (record,) of one AutoDMA buffer; NPT counts are NaN.

    The upper half of the counter's range is read as negative, so that a step back is one.

    The order in the buffer is R1A R1B R2A R2B ..., in NPT mode R1A R2A ... R1B R2B ...
    """
    if npt:
        words = native(data.view(word_dtype(model)).reshape(channels, -1, record_samples))
        return words, np.full(words.shape[1], np.nan)
    records = data.view(header_record_dtype(record_samples, model)).reshape(-1, channels)
    words = native(np.ascontiguousarray(records["words"].swapaxes(0, 1)))
    counts = timestamp_counts(records["header"][:, 0])
    return words, np.where(counts >> 39, counts - (1 << 40), counts).astype(np.float64)


def timestamp_counts(headers: NDArray[np.uint32]) -> NDArray[np.int64]:
    """Return the 40 bit trigger counter (record,) from ``headers`` (record, 4)."""
    low, high = headers[:, 2].astype(np.int64), headers[:, 3].astype(np.int64) & TIMESTAMP_HIGH_MASK
    return (high << 32) | low


def codes(words: Words, model: BoardModel = ATS460_BOARD) -> NDArray[np.int16]:
    """Return zero-centred codes, within the model's ``code_limits``, from left-justified words of any shape."""
    code = (words >> (8 * model.sample_bytes - model.code_bits)).astype(np.uint16, copy=False)
    # The difference is modulo 2^16; read as two's complement it is the signed code.
    code -= np.uint16(1 << (model.code_bits - 1))
    signed = code.view(np.int16)
    if model.code_limits[0] > -(1 << (model.code_bits - 1)):
        np.maximum(signed, model.code_limits[0], out=signed)
    return signed


def any_at_full_scale(values: NDArray[np.int16], model: BoardModel = ATS460_BOARD) -> bool:
    """Return whether any code is the lowest or the highest one."""
    lowest, highest = model.code_limits
    return bool(np.any(values == lowest) or np.any(values == highest))


def volts_per_code(input_range_v: float, model: BoardModel = ATS460_BOARD) -> float:
    """Return the step of one code (V) for an input of +-``input_range_v``."""
    # 0 V lies between two codes, so a range of +-R spans 2^bits - 1 steps.
    return 2 * input_range_v / ((1 << model.code_bits) - 1)


def volts_offset(input_range_v: float, model: BoardModel = ATS460_BOARD) -> float:
    """Return the voltage of zero-centred code 0: half a step, because 0 V lies between two codes."""
    return 0.5 * volts_per_code(input_range_v, model)
