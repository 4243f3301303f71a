"""Records and true displacement of each shot of a run, read on demand.

The records of a long shot stay in the file and are read block by block.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Final, overload

import numpy as np

from hpe_rig.arrays import BoolArray, FloatArray, Int16Array, Int64Array
from hpe_rig.store.codes import Arrival, arrival_of, code_limits_of, placement_of, read_codes, refuse_excessive_size
from hpe_rig.store.datasets import TRUE_HARMONICS
from hpe_rig.store.foreign_hdf5 import InvalidContentError
from hpe_rig.store.format import StoreError
from hpe_rig.store.placement import Placement
from hpe_rig.store.records import MISSING, GatedRecords, ShotRecords, with_margin
from hpe_rig.store.rows import checked_row, shot_index
from hpe_rig.store.source import open_checked
from hpe_rig.store.validation import CheckedFile, Shape

MAX_SAMPLES_IN_MEMORY: Final = 1 << 25
"""Maximum number of samples of a shot that are read into memory; the records of a longer shot stay in the file."""
MAX_SAMPLES_PER_STEP: Final = 1 << 22
"""Maximum number of samples that are compared with their checksums in one step."""


@dataclass(frozen=True, slots=True)
class StoredShot:
    """Echoes of one shot that stay in the file (`GatedRecords`), limited to ``samples``: the gate and its margins.

    ``intact`` (record,): records with an intact mark and intact echoes. ``record`` (pulse,): the number of each pulse's
    record, -1 for none. ``valid`` and ``damaged`` (pulse,): pulses with an intact and with a damaged record.
    """

    records: StoredRecords
    shot: int
    samples: slice
    intact: BoolArray
    record: Int64Array
    valid: BoolArray
    damaged: BoolArray
    volts_per_code: float
    code_limits: tuple[int, int]
    margin: tuple[int, int]

    @property
    def shape(self) -> tuple[int, int]:
        """Numbers of pulses and of samples."""
        return self.valid.size, self.samples.stop - self.samples.start

    def block(self, pulses: slice) -> Int16Array:
        """Return the codes of ``pulses``, (pulse, sample); ``MISSING`` for a missing or damaged record."""
        record = self.record[pulses]
        codes = np.full((record.size, self.shape[1]), MISSING)
        if (has_record := record >= 0).any():
            # One contiguous block contains the records of all these pulses; each pulse's record is selected from it.
            first, stop = int(record[has_record].min()), int(record.max()) + 1
            with self.records.open() as checked:
                block, damaged = read_codes(
                    checked, "records/echo", self.shot, self.intact, self.samples, slice(first, stop)
                )
                if damaged.any():
                    raise InvalidContentError(f"shot {self.shot + 1} was changed while it was read")
            codes[has_record] = block[record[has_record] - first]
        return codes


@dataclass(frozen=True, slots=True)
class _Gate:
    """Samples of a shot that are read, the gate and its margins, the records that arrived and their pulses."""

    samples: slice
    margin: tuple[int, int]
    arrival: Arrival
    placement: Placement
    volts_per_code: float
    volts_offset: float
    code_limits: tuple[int, int]


@dataclass(frozen=True, slots=True)
class StoredRecords(Sequence[ShotRecords]):
    """Records of every shot, (shot,), each read from the file on demand."""

    path: Path
    shape: Shape

    def __len__(self) -> int:
        return self.shape[0]

    @overload
    def __getitem__(self, shot: int) -> ShotRecords: ...

    @overload
    def __getitem__(self, shot: slice) -> tuple[ShotRecords, ...]: ...

    def __getitem__(self, shot: int | slice) -> ShotRecords | tuple[ShotRecords, ...]:
        """Return all records of ``shot``, or of each shot in a slice."""
        if isinstance(shot, slice):
            return tuple(self[index] for index in range(*shot.indices(len(self))))
        return self.gated(shot, slice(0, self.shape[2]))

    @contextmanager
    def open(self) -> Iterator[CheckedFile]:
        """Yield the content of the run; raise ``StoreError`` if it has another shape by now."""
        with open_checked(self.path) as checked:
            if checked.shape != self.shape:
                raise InvalidContentError(f"it was replaced by a run of {checked.shape} instead of {self.shape}")
            yield checked

    def monitor(self, shot: int) -> ShotRecords | None:
        """Return the records of ``shot`` at the monitor input, (pulse, sample), None if it was not recorded."""
        with self.open() as checked:
            if not checked.has("records/monitor"):
                return None
        return self.gated(shot, slice(0, self.shape[2]), "monitor")

    def arrival(self, shot: int) -> Arrival:
        """Return which records of ``shot`` have an intact mark, and their trigger times; echoes may be damaged."""
        with self.open() as checked:
            return arrival_of(checked, shot_index(shot, self.shape[0]))

    def placement(self, shot: int) -> Placement:
        """Return the pulse of each record of ``shot`` by the trigger times."""
        with self.open() as checked:
            shot = shot_index(shot, self.shape[0])
            return placement_of(checked, shot, arrival_of(checked, shot))

    def gated(
        self, shot: int, gate: slice, name: str = "echo", margin: int = 0, placement: Placement | None = None
    ) -> ShotRecords:
        """Return the samples in ``gate`` and up to ``margin`` around it of each record of ``shot``, (pulse, sample).

        ``name``: the input, "echo" or "monitor". ``placement``: pulses of the records; None: by the trigger times.
        """
        shot = shot_index(shot, self.shape[0])
        with self.open() as checked:
            read = self._gate(checked, shot, gate, name, margin, placement)
            codes, damaged = read_codes(checked, f"records/{name}", shot, read.arrival.recorded, read.samples)
        time_s, damaged_marks = np.where(damaged, np.nan, read.arrival.trigger_time_s), read.arrival.damaged
        scale, offset, limits = read.volts_per_code, read.volts_offset, read.code_limits
        records = ShotRecords(codes, time_s, scale, offset, limits, read.margin, damaged | damaged_marks)
        return records.placed(read.placement)

    def gated_or_stored(
        self,
        shot: int,
        gate: slice,
        margin: int,
        max_samples: int = MAX_SAMPLES_IN_MEMORY,
        visit: Callable[[Int16Array], None] | None = None,
        placement: Placement | None = None,
    ) -> GatedRecords:
        """Return the echoes of ``shot`` in ``gate``; if they exceed ``max_samples`` their codes stay in the file.

        Codes that stay in the file are read once here, block by block, and compared with their checksums. ``visit`` is
        called with each block, the codes in the gate (record, sample). It is not called if the codes are in memory, nor
        if records and pulses have different numbers.
        """
        if self.shape[1] * (gate.stop - gate.start + 2 * margin) <= max_samples:
            return self.gated(shot, gate, margin=margin, placement=placement)
        shot = shot_index(shot, self.shape[0])
        with self.open() as checked:
            read = self._gate(checked, shot, gate, "echo", margin, placement)
        damaged = self.damaged(shot, visit if read.placement.is_identity else None, gate)
        intact, record = read.arrival.recorded & ~damaged, read.placement.record
        # From records to pulses; a pulse without a record, -1, is neither valid nor damaged.
        has_record, record_index = record >= 0, np.maximum(record, 0)
        valid, damaged_pulses = has_record & intact[record_index], has_record & damaged[record_index]
        return StoredShot(
            records=self,
            shot=shot,
            samples=read.samples,
            intact=intact,
            record=record,
            valid=valid,
            damaged=damaged_pulses,
            volts_per_code=read.volts_per_code,
            code_limits=read.code_limits,
            margin=read.margin,
        )

    def _gate(
        self, checked: CheckedFile, shot: int, gate: slice, name: str, margin: int, placement: Placement | None
    ) -> _Gate:
        """Return samples, arrival, pulses and volts per code of the records of ``shot`` in ``gate``; as ``gated``."""
        if not 0 <= gate.start < gate.stop <= self.shape[2]:
            raise StoreError(
                f"{self.path}: the gate takes samples {gate.start} to {gate.stop}, a record has {self.shape[2]}. "
                "Try: a run whose scene passes hpe-rig check."
            )
        samples, margins = with_margin(gate, margin, self.shape[2])
        arrival, name = arrival_of(checked, shot), f"records/{name}"
        refuse_excessive_size(checked, name, arrival.recorded, samples.stop - samples.start)
        scale, offset = (checked.attribute(key, float, name) for key in ("scale_factor", "add_offset"))
        pulses = placement or placement_of(checked, shot, arrival)
        return _Gate(samples, margins, arrival, pulses, scale, offset, code_limits_of(checked, name))

    def chunks(self, shot: int, max_records: int, name: str = "echo") -> Iterator[tuple[int, Int16Array]]:
        """Yield first record and codes (record, sample) of ``shot``, block by block; raise ``StoreError`` for damage.

        A block has as many whole chunks as ``max_records`` allow, at least one. ``name``: the input, "echo" or
        "monitor".
        """
        for first, codes, damaged in self.blocks(shot, max_records, name):
            if damaged.any():
                raise StoreError(
                    f"{self.path}: records of shot {shot + 1} fail their checksums. Try: hpe-rig verify {self.path}."
                )
            yield first, codes

    def blocks(
        self, shot: int, max_records: int, name: str, samples: slice = slice(None)
    ) -> Generator[tuple[int, Int16Array, BoolArray], None, None]:
        """Yield first record, codes of ``samples`` (record, sample) and which are damaged, in blocks as ``chunks``."""
        samples = slice(*samples.indices(self.shape[2]))
        with self.open() as checked:
            arrival = arrival_of(checked, shot)
            step = max(1, max_records // checked.chunk_records) * checked.chunk_records
            for first in range(0, self.shape[1], step):
                rows = slice(first, first + step)
                codes, damaged = read_codes(checked, f"records/{name}", shot, arrival.recorded, samples, rows)
                yield first, codes, damaged | arrival.damaged[rows]

    def damaged(
        self, shot: int, visit: Callable[[Int16Array], None] | None = None, samples: slice = slice(0, 0)
    ) -> BoolArray:
        """Return which records of ``shot`` are damaged at any input, (record,).

        ``visit`` is called with the codes of ``samples`` of all echoes (record, sample), block by block, in the order
        of the file.
        """
        damaged = np.zeros(self.shape[1], bool)
        with self.open() as checked:
            names = ("echo", *(["monitor"] if checked.has("records/monitor") else []))
        for name in names:
            # An error of ``visit`` does not pass through ``open_checked``, which would report a damaged file.
            with closing(self.blocks(shot, MAX_SAMPLES_PER_STEP // self.shape[2], name, samples)) as blocks:
                for first, codes, damaged_records in blocks:
                    damaged[first : first + damaged_records.size] |= damaged_records
                    if visit is not None and name == "echo":
                        visit(codes)
        return damaged


@dataclass(frozen=True, slots=True)
class StoredGroundTruth:
    """True displacement of every shot, float64 (pulse,) in m, each read on demand."""

    records: StoredRecords

    def __getitem__(self, shot: int) -> FloatArray:
        """Return the true displacement (pulse,) of ``shot``, m; NaN for a pulse without a record or if damaged."""
        with self.records.open() as checked:
            shot = shot_index(shot, checked.shape[0])
            row_m, _ = checked_row(checked, "truth/displacement_m", shot)
            # The row (record,) is NaN if damaged. ``record`` (pulse,): index of each pulse's record in it, -1 for none.
            record = placement_of(checked, shot, arrival_of(checked, shot)).record
            return np.where(record >= 0, row_m[np.maximum(record, 0)], np.nan)

    def harmonics_m(self, shot: int, frequencies: int) -> FloatArray:
        """Return A cos(phase) and A sin(phase) of the true displacement at the wanted frequencies, (frequency, 2)."""
        with self.records.open() as checked:
            rows = [checked_row(checked, name, shot_index(shot, checked.shape[0]))[0] for name in TRUE_HARMONICS]
            if rows[0].size < frequencies:
                raise InvalidContentError(f"/true_harmonics has {rows[0].size} frequencies, its scene {frequencies}")
            return np.stack(rows, axis=-1)[:frequencies]
