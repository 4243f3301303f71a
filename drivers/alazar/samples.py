"""Samples: from the board's memory layout to codes, volts and trigger times; pure functions.

Layout and scale: docs/theory/instruments.md, 2.5 and 2.6.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from drivers.alazar.models import ATS460_BOARD

CODE_BITS: Final = ATS460_BOARD.code_bits
# Codes stand in the upper bits of their words.
PADDING_BITS: Final = 16 - CODE_BITS
CODE_LIMITS: Final = ATS460_BOARD.code_limits
LOWEST_CODE, HIGHEST_CODE = CODE_LIMITS
# Zero volts lies between two codes, so that a range of +-R spans 2^bits - 1 steps.
CENTRE_CODE: Final = (HIGHEST_CODE - LOWEST_CODE) / 2
TIMESTAMP_HIGH_MASK: Final = 0xFF
SAMPLES_PER_COUNT: Final = 2
HEADER_BYTES: Final = 16


@dataclass(frozen=True, slots=True)
class RawRecords:
    """Consecutive records as the board delivers them.

    ``words`` uint16 (channel, record, sample); ``trigger_samples`` float64 (record,), when each trigger came in periods
    of the sample clock, NaN where the board states no time.
    """

    first_record: int
    words: NDArray[np.uint16]
    trigger_samples: NDArray[np.float64]


def header_record_dtype(record_samples: int) -> np.dtype[Any]:
    """Return the layout of one record of one channel behind its header, as traditional AutoDMA writes it."""
    return np.dtype([("header", "<u4", (4,)), ("words", "<u2", (record_samples,))])


def buffer_bytes(record_samples: int, records: int, channels: int, headers: bool) -> int:
    """Return the size of an AutoDMA buffer."""
    return (2 * record_samples + (HEADER_BYTES if headers else 0)) * records * channels


def unpacked(data: NDArray[np.uint8], first_record: int, channels: int, record_samples: int, npt: bool) -> RawRecords:
    """Return the records of one AutoDMA buffer: R1A R1B R2A R2B ..., in NPT mode R1A R2A ... R1B R2B ..."""
    if npt:
        words = data.view("<u2").reshape(channels, -1, record_samples)
        return RawRecords(first_record, words.astype(np.uint16, copy=False), np.full(words.shape[1], np.nan))
    filled = data.view(header_record_dtype(record_samples)).reshape(-1, channels)
    words = np.ascontiguousarray(filled["words"].swapaxes(0, 1)).astype(np.uint16, copy=False)
    # The counter in the headers advances once in several samples; the function for single-port records counts samples.
    trigger_samples = timestamp_counts(filled["header"][:, 0]).astype(np.float64) * SAMPLES_PER_COUNT
    return RawRecords(first_record, words, trigger_samples)


def timestamp_counts(headers: NDArray[np.uint32]) -> NDArray[np.int64]:
    """Return the 40 bit trigger counter (record,) from ``headers`` (record, 4)."""
    low, high = headers[:, 2].astype(np.int64), headers[:, 3].astype(np.int64) & TIMESTAMP_HIGH_MASK
    return (high << 32) | low


def codes(words: NDArray[np.uint16]) -> NDArray[np.int16]:
    """Return zero-centred codes, within ``CODE_LIMITS``, from left-justified words of any shape."""
    return (words >> PADDING_BITS).astype(np.int16) + np.int16(LOWEST_CODE)


def any_at_full_scale(values: NDArray[np.int16]) -> bool:
    """Return whether any code is the lowest or the highest."""
    return bool(np.any(values == LOWEST_CODE) or np.any(values == HIGHEST_CODE))


def volts_per_code(input_range_v: float) -> float:
    """Return the volts of one code when the input spans +-``input_range_v``."""
    return input_range_v / CENTRE_CODE


def volts_offset(input_range_v: float) -> float:
    """Return the volts of zero-centred code 0: half a code, since zero volts lies between two codes."""
    return 0.5 * volts_per_code(input_range_v)
