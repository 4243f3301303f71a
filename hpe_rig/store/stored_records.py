"""Records and true displacement of each shot of a run, read on demand.

The records of a long shot stay in the file and are read block by block.
"""

from __future__ import annotations

import tempfile
import weakref
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, final, overload

import numpy as np

from hpe_rig.arrays import BoolArray, FloatArray, Int16Array, Int64Array
from hpe_rig.store.codes import Arrival, arrival_of, code_limits_of, placement_of, read_codes, refuse_excessive_size
from hpe_rig.store.datasets import TRUE_HARMONICS
from hpe_rig.store.foreign_hdf5 import InvalidContentError
from hpe_rig.store.format import StoreError
from hpe_rig.store.placement import Placement
from hpe_rig.store.records import MISSING, GatedRecords, ShotRecords, with_margin
from hpe_rig.store.rows import row_or_blank, shot_index
from hpe_rig.store.source import open_checked
from hpe_rig.store.validation import CheckedFile, Shape

MAX_SAMPLES_IN_MEMORY: Final = 1 << 25
"""Maximum number of samples of a shot that are read into memory; the records of a longer shot stay in the file."""
MAX_SAMPLES_PER_STEP: Final = 1 << 22
"""Maximum number of samples that are compared with their checksums in one step."""
MAX_COPY_BYTES: Final = 1 << 30
"""Maximum size of a long shot's copy in a temporary file; for a larger shot the run file is read again."""


@dataclass(frozen=True, slots=True)
class StoredShot:
    """Records of one shot that stay in the file (`GatedRecords`), limited to ``samples``: the gate and its margins.

    ``valid`` (pulse,): pulses with an intact record. ``copy``: these samples of every record in a temporary file,
    unless they are too many. ``record`` (pulse,): the number of each pulse's record, -1 for none; None if the numbers
    are equal.
    """

    path: Path
    name: str
    shot: int
    samples: slice
    valid: BoolArray
    volts_per_code: float
    code_limits: tuple[int, int]
    margin: tuple[int, int]
    damaged: BoolArray
    copy: CodesCopy | None = None
    record: Int64Array | None = None

    def placed(self, placement: Placement) -> StoredShot:
        """Return these records, numbered by their arrival, assigned to the pulses of ``placement``."""
        record = placement.record
        has_record = record >= 0
        valid, damaged = (has_record & values[np.maximum(record, 0)] for values in (self.valid, self.damaged))
        return replace(self, valid=valid, damaged=damaged, record=record)

    @property
    def shape(self) -> tuple[int, int]:
        """Numbers of pulses and of samples."""
        return self.valid.size, self.samples.stop - self.samples.start

    def block(self, pulses: slice) -> Int16Array:
        """Return the codes of ``pulses``, (pulse, sample), from the temporary copy or else from the run file.

        Pulses without a record, or with a damaged one, are filled with ``MISSING``: ``valid``, from the checksums
        compared before, marks the intact ones.
        """
        if self.record is None:
            codes = self._block(pulses)
        else:
            # One contiguous block contains the records of all these pulses; each pulse's record is selected from it.
            record_of_pulse = self.record[pulses]
            has_record = record_of_pulse >= 0
            stop = int(record_of_pulse.max(initial=-1)) + 1
            first = int(record_of_pulse.min(initial=stop, where=has_record))
            codes = np.full((record_of_pulse.size, self.shape[1]), MISSING)
            codes[has_record] = self._block(slice(first, stop))[record_of_pulse[has_record] - first]
        codes[~self.valid[pulses]] = MISSING
        return codes

    def _block(self, records: slice) -> Int16Array:
        """Return the codes of consecutive ``records``, (record, sample)."""
        first, last, _ = records.indices(self.valid.size)
        if self.copy is not None and self.copy.complete:
            return self.copy.block(first, last)
        with open_checked(self.path) as checked:
            rows = slice(first, max(first, last))
            return read_codes(checked, self.name, self.shot, self.valid, self.samples, rows)[0]


@final
class CodesCopy:
    """Codes of records of ``samples`` each in a temporary file; ``complete`` is False if its disk is full."""

    def __init__(self, samples: int) -> None:
        """Create the temporary file; without room for it ``complete`` is False and the copy is not used."""
        self._samples, self.complete = samples, True
        try:
            self._file = tempfile.TemporaryFile()  # noqa: SIM115
        except OSError:
            self.complete = False
        else:
            # Closing deletes the file, when the last reference to the copy is gone.
            weakref.finalize(self, self._file.close)

    def add(self, codes: Int16Array) -> None:
        """Append the codes of the next records, (record, sample); after an error of the disk ``complete`` is False."""
        if self.complete:
            try:
                self._file.write(np.ascontiguousarray(codes).data)
                self._file.flush()
            except OSError:
                self.complete = False
                with suppress(OSError):
                    self._file.close()

    def block(self, first: int, last: int) -> Int16Array:
        """Return the codes of the records ``first`` to ``last`` - 1, (record, sample)."""
        codes = np.empty((max(0, last - first), self._samples), np.int16)
        self._file.seek(2 * first * self._samples)
        if self._file.readinto(codes.data) != codes.nbytes:
            raise StoreError(
                "records of a long shot, copied to a temporary file, cannot be read back: another program has cut it. "
                "Try: repeat the command, and leave the folder of temporary files alone meanwhile."
            )
        return codes


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
        with self.open() as checked:
            stored, offset_v, arrival = self._of_shot(checked, shot, gate, name, margin)
            codes, damaged = read_codes(checked, f"records/{name}", stored.shot, arrival.recorded, stored.samples)
            record_placement = placement or placement_of(checked, stored.shot, arrival)
        time_s = np.where(damaged, np.nan, arrival.trigger_time_s)
        scale, limits = stored.volts_per_code, stored.code_limits
        records = ShotRecords(codes, time_s, scale, offset_v, limits, stored.margin, damaged | arrival.damaged)
        return records.placed(record_placement)

    def shot_blocks(
        self,
        shot: int,
        gate: slice,
        margin: int,
        max_samples: int = MAX_SAMPLES_IN_MEMORY,
        visit: Callable[[Int16Array], None] | None = None,
        placement: Placement | None = None,
    ) -> GatedRecords:
        """Return the records of ``shot`` in ``gate``; if they exceed ``max_samples`` their codes stay in the file.

        Codes that stay in the file are read once and compared with their checksums. Meanwhile ``visit`` is called with
        the codes in the gate, block by block, and the codes in the gate and its margins are copied to a temporary file.
        ``visit`` is called only if every record has the number of its pulse.
        """
        if self.shape[1] * (gate.stop - gate.start + 2 * margin) <= max_samples:
            return self.gated(shot, gate, margin=margin, placement=placement)
        with self.open() as checked:
            stored, _, arrival = self._of_shot(checked, shot, gate, "echo", margin)
            placement = placement or placement_of(checked, stored.shot, arrival)
        records_are_pulses = placement.is_identity
        pulses, samples = stored.shape
        gate_samples = slice(stored.margin[0], samples - stored.margin[1])
        copy = CodesCopy(samples) if 2 * pulses * samples <= MAX_COPY_BYTES else None

        def copy_and_visit(codes: Int16Array) -> None:
            """Copy a block of codes (record, sample) to the temporary file, and call ``visit`` with those in the gate.

            ``visit`` takes blocks of consecutive pulses: it is not called if records have other numbers than pulses.
            """
            if copy is not None:
                copy.add(codes)
            if visit is not None and records_are_pulses:
                visit(codes[:, gate_samples])

        damaged = self.damaged(stored.shot, visit=copy_and_visit, samples=stored.samples)
        stored = replace(stored, valid=stored.valid & ~damaged, damaged=damaged, copy=copy)
        return stored if records_are_pulses else stored.placed(placement)

    def _of_shot(
        self, checked: CheckedFile, shot: int, gate: slice, name: str, margin: int
    ) -> tuple[StoredShot, float, Arrival]:
        """Return the records of ``shot`` without reading their codes, their offset in volts, and which of them arrived.

        ``gate``: samples wanted, with up to ``margin`` around it. ``name``: dataset of the input.
        """
        shot = shot_index(shot, self.shape[0])
        if not 0 <= gate.start < gate.stop <= self.shape[2]:
            raise StoreError(
                f"{self.path}: the gate takes samples {gate.start} to {gate.stop}, a record has {self.shape[2]}. "
                "Try: a run whose scene passes hpe-rig check."
            )
        samples, margins = with_margin(gate, margin, self.shape[2])
        arrival, name = arrival_of(checked, shot), f"records/{name}"
        refuse_excessive_size(checked, name, arrival.recorded, samples.stop - samples.start)
        scale, offset = (checked.attribute(key, float, name) for key in ("scale_factor", "add_offset"))
        limits = code_limits_of(checked, name)
        stored = StoredShot(self.path, name, shot, samples, arrival.recorded, scale, limits, margins, arrival.damaged)
        return stored, offset, arrival

    def blocks(
        self, shot: int, max_records: int, name: str = "echo", samples: slice = slice(None)
    ) -> Generator[tuple[int, Int16Array, BoolArray], None, None]:
        """Yield first record, codes of ``samples`` (record, sample) and which records are damaged, block by block.

        A block has as many whole chunks as ``max_records`` allow, at least one. ``name``: the input, "echo" or
        "monitor".
        """
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
        """Return the true displacement at every record of ``shot``, m; NaN if missing or damaged."""
        with self.records.open() as checked:
            shot = shot_index(shot, checked.shape[0])
            row_m: FloatArray = row_or_blank(checked, "truth/displacement_m", shot)
            record = placement_of(checked, shot, arrival_of(checked, shot)).record
            return np.where(record >= 0, row_m[np.maximum(record, 0)], np.nan)

    def harmonics_m(self, shot: int, frequencies: int) -> FloatArray:
        """Return A cos(phase) and A sin(phase) of the true displacement at the wanted frequencies, (frequency, 2)."""
        with self.records.open() as checked:
            rows = [row_or_blank(checked, name, shot_index(shot, checked.shape[0])) for name in TRUE_HARMONICS]
            if rows[0].size < frequencies:
                raise InvalidContentError(f"/true_harmonics has {rows[0].size} frequencies, its scene {frequencies}")
            return np.stack(rows, axis=-1)[:frequencies]
