"""Dual-port AutoDMA: the queue of posted buffers, and records packed as the board would write them."""

from __future__ import annotations

import ctypes
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from sim_backend.arrays import ByteArray, FloatArray, Int64Array
from sim_backend.digitizer import codes
from sim_backend.digitizer.board import AcceptedTriggers, Arming, BoardSettings, is_clipped, words
from sim_backend.digitizer.boards import MILLIVOLTS_BY_ID
from sim_backend.digitizer.codes import Code
from sim_backend.settings import TriggerFaults
from sim_backend.wiring import to_ps

RESOLUTION_CODES = {8: 0, 12: 1, 14: 2, 16: 3}
SYSTEM_NUMBER, BOARD_NUMBER = 1, 1
"""Numbers of the only simulated board and its system, from 1."""
ADDRESS_MULTIPLE, ADDRESS_MULTIPLE_NPT = 32, 64
SIMULATED_FLAGS = codes.ADMA_EXTERNAL_STARTCAPTURE | codes.ADMA_RECORD_HEADERS | codes.ADMA_NPT


@dataclass(frozen=True, slots=True)
class Transfer:
    """Arguments of AlazarBeforeAsyncRead."""

    channels: tuple[int, ...]
    record_samples: int
    records_per_buffer: int
    record_count: int
    flags: int
    bytes_per_sample: int = 2

    @property
    def headers(self) -> bool:
        """Whether a header precedes every record."""
        return bool(self.flags & codes.ADMA_RECORD_HEADERS)

    @property
    def npt(self) -> bool:
        """Whether records have no pre-trigger part and no headers (no pre-trigger mode)."""
        return bool(self.flags & codes.ADMA_NPT)

    @property
    def buffer_bytes(self) -> int:
        """Size of a buffer."""
        record_bytes = self.bytes_per_sample * self.record_samples + (codes.HEADER_BYTES if self.headers else 0)
        return record_bytes * self.records_per_buffer * len(self.channels)

    def refusal(self, settings: BoardSettings, offset: int) -> Code:
        """Return the error code of a board with dual-port memory for this transfer, or success.

        ``offset``: first sample relative to the trigger.
        """
        if self.flags & ~SIMULATED_FLAGS or (self.npt and self.headers):
            return Code.UNSUPPORTED_FUNCTION
        board = settings.board
        if len(self.channels) not in (1, 2, board.channels) or max(self.channels) >= board.channels:
            return Code.NOT_SUPPORT_THIS_CHANNEL
        multiple = board.npt_multiple if self.npt else board.record_multiple
        if self.record_samples != settings.record_samples or self.record_samples % multiple:
            return Code.INVALID_SIZE
        if offset != -settings.pre_samples or (self.npt and offset):
            return Code.INVALID_OFFSET
        if not self._is_record_count_valid():
            return Code.INVALID_RECORDS_PER_BUFFER
        return Code.SUCCESS if self.buffer_bytes < board.max_buffer_bytes else Code.INVALID_SIZE

    def _is_record_count_valid(self) -> bool:
        """Return whether the records fill a whole number of buffers, or never end."""
        per_buffer, count = self.records_per_buffer, self.record_count
        return per_buffer >= 1 and count >= 1 and (count == codes.ENDLESS_RECORDS or count % per_buffer == 0)


@dataclass(slots=True)
class BufferQueue:
    """Buffers of the program, in the order of posting."""

    transfer: Transfer
    memory_records: int
    max_bytes: int
    posted: deque[int] = field(default_factory=deque)
    delivered: int = 0
    overflowed: bool = False

    def post(self, address: int, size: int) -> Code:
        """Append the program's buffer at ``address``, of ``size`` bytes, to the queue; return success or error code."""
        if not address:
            return Code.NULL_PARAM
        if address in self.posted:
            return Code.INVALID_BUFFER
        if address % (ADDRESS_MULTIPLE_NPT if self.transfer.npt else ADDRESS_MULTIPLE):
            return Code.INVALID_ADDRESS
        if not 0 < size < self.max_bytes:
            return Code.INVALID_SIZE
        if size < self.transfer.buffer_bytes:
            return Code.BUFFER_TOO_SMALL
        self.posted.append(address)
        return Code.SUCCESS

    def wait_refusal(self, address: int) -> Code:
        """Return whether the program can wait for the buffer at ``address``: success, or the code of refusal.

        Only the head of the queue of posted buffers can be waited for.
        """
        if not address:
            return Code.NULL_PARAM
        if address not in self.posted:
            return Code.BUFFER_NOT_READY
        return Code.SUCCESS if address == self.posted[0] else Code.DMA_IN_PROGRESS

    def update_overflow(self, records_complete: int) -> None:
        """Set ``overflowed`` if more records are complete than buffers and memory can hold."""
        # Buffers handed back, posted buffers, and the board's memory.
        capacity = (self.delivered + len(self.posted)) * self.transfer.records_per_buffer + self.memory_records
        self.overflowed = self.overflowed or records_complete > capacity

    def full(self, records_complete: int) -> int:
        """Return how many posted buffers are full."""
        return min(len(self.posted), max(0, records_complete // self.transfer.records_per_buffer - self.delivered))

    def head_full_ps(self, triggers: AcceptedTriggers) -> int | None:
        """Return when the buffer at the head is full; None if ``triggers`` never fill it."""
        record_count = (self.delivered + 1) * self.transfer.records_per_buffer
        return int(triggers.end_ps[record_count - 1]) if triggers.end_ps.size >= record_count else None

    @property
    def next_records(self) -> slice:
        """The records of the buffer at the head."""
        count = self.transfer.records_per_buffer
        return slice(self.delivered * count, (self.delivered + 1) * count)

    def deliver(
        self, arming: Arming, triggers: AcceptedTriggers, volts: Sequence[FloatArray], stamps: Int64Array
    ) -> None:
        """Write the next records into the buffer at the head of the queue, and remove it.

        ``volts`` (record, sample) of each channel, ``stamps`` (record,): their time stamps.
        """
        data = packed(self.transfer, arming, triggers, volts, self.next_records, stamps)
        # Written straight into the program's memory, as by DMA; `post` has checked its size.
        ctypes.memmove(self.posted.popleft(), data.ctypes.data, data.nbytes)
        self.delivered += 1


def packed(
    transfer: Transfer,
    arming: Arming,
    triggers: AcceptedTriggers,
    volts: Sequence[FloatArray],
    records: slice,
    stamps: Int64Array,
) -> ByteArray:
    """Return the bytes that the board writes into a buffer: ``volts`` (record, sample) as codes, with any headers.

    The order is R1A R1B R2A R2B ... (record, channel), in NPT mode R1A R2A ... R1B R2B ... ``records``: their numbers.
    """
    header = codes.HEADER_BYTES if transfer.headers else 0
    record_bytes = header + transfer.bytes_per_sample * transfer.record_samples
    count, channels = len(volts[0]), len(transfer.channels)
    data = np.empty((channels, count, record_bytes) if transfer.npt else (count, channels, record_bytes), np.uint8)
    for index, channel in enumerate(transfer.channels):
        channel_data = data[index] if transfer.npt else data[:, index]
        channel_words = words(volts[index], arming.settings.inputs[channel], arming.settings)
        channel_data[:, header:] = channel_words.view(np.uint8)
        if header:
            channel_data[:, :header] = headers(arming, triggers, channel, records, stamps)
    return data


def headers(arming: Arming, triggers: AcceptedTriggers, channel: int, records: slice, stamps: Int64Array) -> ByteArray:
    """Return the headers of ``records`` as uint8 (record, 16): four little-endian words of bit fields.

    ``stamps`` (record,): time stamps. See docs/explanation/instruments.md, 2.6. Assumed: records count from 0,
    resolution codes 0 to 3 for 8 to 16 bits, format 0 for unsigned, "this channel" on channel A only.
    """
    settings = arming.settings
    record_number = np.arange(records.start, records.stop)
    external = (~triggers.is_forced[records]).astype(np.int64)
    rate_id = next(
        rate_id for rate_id, rate_hz in settings.board.rates_hz.items() if rate_hz == settings.sample_rate_hz
    )
    channel_input = settings.inputs[channel]
    range_id = next(key for key, mv in MILLIVOLTS_BY_ID.items() if mv / 1000 == channel_input.range_v)
    # Each field is shifted to its lowest bit. Fields that are not set here are 0: rising edge, triggered by B, A or a
    # time-out.
    words32 = np.empty((stamps.size, 4), np.int64)
    serial_number, resolution = codes.SERIAL_NUMBER & 0x3FFFF, RESOLUTION_CODES[settings.board.bits]
    words32[:, 0] = serial_number | SYSTEM_NUMBER << 18 | channel << 22 | BOARD_NUMBER << 23 | resolution << 27
    words32[:, 0] |= int(settings.signed) << 30
    words32[:, 1] = (record_number & 0xFFFFFF) | settings.board.kind << 24
    # Low and high part of the time stamp.
    words32[:, 2] = stamps & 0xFFFFFFFF
    words32[:, 3] = stamps >> 32 | codes.INTERNAL_CLOCK << 8 | rate_id << 11 | range_id << 18
    words32[:, 3] |= codes.COUPLING_DC << 23 | channel_input.impedance << 25 | external << 27
    on_channel_a = 1 - channel
    words32[:, 3] |= on_channel_a << 31
    return words32.astype("<u4").view(np.uint8)


def timestamps(
    arming: Arming, triggers: AcceptedTriggers, records: slice, reset_ps: int, faults: TriggerFaults
) -> Int64Array:
    """Return the time stamps of consecutive ``records`` in counts of some samples: int64 (record,)."""
    period_ps = arming.settings.board.samples_per_count * arming.settings.clock_period_ps
    number = np.arange(records.start, records.stop)
    # A frozen counter repeats the time of its first record.
    first, last = faults.frozen_stamps or (0, 0)
    tick_ps = triggers.clock_ps[np.where((number > first) & (number <= last), first, number)]
    time_ps = tick_ps - arming.by_clock(np.array(reset_ps))
    for jump in faults.stamp_jumps:
        time_ps[number >= jump.record] += to_ps(jump.jump_s)
    if period_ps.denominator == 1:
        counts = time_ps // int(period_ps)
    else:
        # A tick is rounded to a whole picosecond: half of one keeps its count.
        counts = np.floor((time_ps + 0.5) / float(period_ps)).astype(np.int64)
    return np.asarray(counts & ((1 << faults.stamp_bits) - 1))


def clipped_status(arming: Arming, peak_v: float) -> int:
    """Return the clipped bits of the status: 2 if ``peak_v`` exceeds the range of channel A, the only one simulated."""
    return 2 if is_clipped(peak_v, arming.settings.inputs[0]) else 0
