"""Records of one shot: arriving blocks -> codes on the plan's axes (pulse, sample), with missing records marked."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from drivers.interfaces import RecordBlock
from hpe_rig.arrays import BoolArray, FloatArray, Int16Array
from hpe_rig.plan import Shot
from hpe_rig.store.placement import Placement, place_records

MISSING = np.int16(-32768)
"""Code of a sample that was never recorded; below the code limits of every digitizer."""


class GatedRecords(Protocol):
    """Records of one shot, in memory (`ShotRecords`) or in the file (`StoredShot`), read in blocks of pulses.

    ``shape``: (pulse, sample); ``valid`` (pulse,): True for pulses with a record; the others as in `ShotRecords`.
    """

    @property
    def shape(self) -> tuple[int, int]: ...
    @property
    def valid(self) -> BoolArray: ...
    @property
    def volts_per_code(self) -> float: ...
    @property
    def code_limits(self) -> tuple[int, int]: ...
    @property
    def margin(self) -> tuple[int, int]: ...
    @property
    def damaged(self) -> BoolArray | None: ...

    def block(self, pulses: slice) -> Int16Array:
        """Return the codes of ``pulses``, (pulse, sample); ``MISSING`` for a missing record."""
        ...


@dataclass(frozen=True, slots=True)
class ShotRecords:
    """The records of one shot on the plan's axes.

    codes: int16 (pulse, sample), ``MISSING`` for missing records.
    trigger_time_s: float64 (pulse,), NaN for missing records and for capture modes without times.
    code_limits: the digitizer's lowest and highest code; a sample with one of them is clipped.
    margin: numbers of samples before and after the gate.
    damaged: (pulse,), True for missing records that fail their checksums; None for records not read from a file.
    """

    codes: Int16Array
    trigger_time_s: FloatArray
    volts_per_code: float
    volts_offset: float
    code_limits: tuple[int, int]
    margin: tuple[int, int] = (0, 0)
    damaged: BoolArray | None = None

    @property
    def shape(self) -> tuple[int, int]:
        """Numbers of pulses and of samples."""
        return self.codes.shape[0], self.codes.shape[1]

    def block(self, pulses: slice) -> Int16Array:
        """Return the codes of ``pulses``, (pulse, sample)."""
        return self.codes[pulses]

    def cut(self, gate: slice, margin: int = 0) -> ShotRecords:
        """Return the samples in ``gate`` and up to ``margin`` existing samples on either side."""
        samples, margins = with_margin(gate, margin, self.codes.shape[1])
        return replace(self, codes=self.codes[:, samples], margin=margins)

    def placed(self, placement: Placement) -> ShotRecords:
        """Return these records, numbered by their arrival, assigned to the pulses of ``placement``."""
        if placement.is_identity:
            return self
        record = placement.record
        has_record = record >= 0
        codes, time_s, damaged = np.full_like(self.codes, MISSING), np.full(record.size, np.nan), None
        codes[has_record] = self.codes[record[has_record]]
        time_s[has_record] = self.trigger_time_s[record[has_record]]
        if self.damaged is not None:
            damaged = np.zeros(record.size, bool)
            damaged[has_record] = self.damaged[record[has_record]]
        return replace(self, codes=codes, trigger_time_s=time_s, damaged=damaged)

    @property
    def valid(self) -> BoolArray:
        """True for pulses with a record, (pulse,)."""
        valid: BoolArray = self.codes[:, 0] != MISSING
        return valid


def with_margin(gate: slice, margin: int, samples: int) -> tuple[slice, tuple[int, int]]:
    """Return ``gate`` extended by up to ``margin`` samples within a record of ``samples``, and both extensions."""
    extended = slice(max(0, gate.start - margin), min(samples, gate.stop + margin))
    return extended, (gate.start - extended.start, extended.stop - gate.stop)


def assemble(blocks: Iterable[RecordBlock], shot: Shot) -> ShotRecords:
    """Return all records of ``shot`` as one array (pulse, sample), from ``blocks`` of records as they arrived.

    Pulses without a record hold the code for missing records.
    """
    codes = np.full((shot.capture.record_count, shot.capture.record_samples), MISSING)
    trigger_time_s = np.full(shot.capture.record_count, np.nan)
    scale, offset, limits = np.nan, np.nan, (0, 0)
    for block in blocks:
        scale, offset, limits = block.volts_per_code, block.volts_offset, block.code_limits
        rows = slice(block.first_record, block.first_record + block.codes.shape[0])
        codes[rows], trigger_time_s[rows] = block.codes, block.trigger_time_s
    records = ShotRecords(codes, trigger_time_s, scale, offset, limits)
    return records.placed(place_records(records.valid, trigger_time_s, shot.tracking_train.rate_hz))
