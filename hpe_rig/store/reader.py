"""Content of a run, read shot by shot on demand, from its run file or, during the run, from its log.

Every value is compared with its checksum. A record counts as missing and damaged if its echoes, or the mark in
``recorded`` that it arrived, fail their checksum. Early files without checksums are read unchecked, except for chunks
beyond the end of the file.
"""

from __future__ import annotations

import json
import math
import tempfile
import weakref
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final, final, overload

import h5py
import numpy as np
from numpy.typing import NDArray

from drivers.interfaces import Setting
from hpe_rig.arrays import BoolArray, FloatArray, Int16Array, Int64Array
from hpe_rig.plan import Plan
from hpe_rig.result import Provenance
from hpe_rig.scene import printable
from hpe_rig.store.checksum import BY_SHOT, GROUP, blank, digest, stored_bytes
from hpe_rig.store.foreign_hdf5 import InvalidContentError
from hpe_rig.store.format import (
    BITSHUFFLE,
    CONDITION_BYTES,
    MAX_CONDITIONS,
    MAX_STAGES,
    SNAPSHOT_BYTES,
    STAGE_BYTES,
    STATUSES,
    TIME_BYTES,
    UNTRUSTED_BYTES,
    StoreError,
)
from hpe_rig.store.layout import TRUE_HARMONICS, volts_of_codes
from hpe_rig.store.marks import identity_of, read_marks, write_marks
from hpe_rig.store.placement import Placement, place_records
from hpe_rig.store.records import MISSING, GatedRecords, ShotRecords, with_margin
from hpe_rig.store.source import open_checked
from hpe_rig.store.validation import CheckedFile, stored_values

Shape = tuple[int, int, int]
CODE_LIMITS_UNSTATED: Final = (-8192, 8191)
"""Lowest and highest code in early files that do not state them: the 14 bits of the only digitizer at that time."""
MAX_MISSING_BYTES: Final = 256_000_000
"""Maximum memory for the missing records of a shot, which take no space in the file."""
MAX_SHOTS: Final = 1_000_000
MAX_SAMPLES_IN_MEMORY: Final = 1 << 25
"""Maximum number of samples of a shot that are read into memory; the records of a longer shot stay in the file."""
MAX_SAMPLES_PER_STEP: Final = 1 << 22
"""Maximum number of samples that are compared with their checksums in one step."""
MAX_COPY_BYTES: Final = 1 << 30
"""Maximum size of a long shot's copy in a temporary file; for a larger shot the run file is read again."""


@dataclass(frozen=True, slots=True)
class StoredShot:
    """Records of one shot that stay in the file (`GatedRecords`), limited to ``samples``: the gate and its margins.

    ``copy``: these samples of every record in a temporary file, unless they are too many. ``record`` (pulse,): the
    number of each pulse's record, -1 for none; None if the numbers are equal.
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
        """Return records in the order of arrival at the pulses of ``placement``."""
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

        They were compared with their checksums before. Missing and damaged records hold the code for missing ones.
        """
        if self.record is None:
            codes = self._block(pulses)
        else:
            # One block contains the records of all these pulses; each is selected from it.
            record = self.record[pulses]
            has_record = record >= 0
            stop = int(record.max(initial=-1)) + 1
            first = int(record.min(initial=stop, where=has_record))
            codes = np.full((record.size, self.shape[1]), MISSING)
            codes[has_record] = self._block(slice(first, stop))[record[has_record] - first]
        codes[~self.valid[pulses]] = MISSING
        return codes

    def _block(self, records: slice) -> Int16Array:
        """Return the codes of consecutive ``records``, (record, sample)."""
        first, last, _ = records.indices(self.valid.size)
        if self.copy is not None and self.copy.complete:
            return self.copy.block(first, last)
        with open_checked(self.path) as checked:
            echo = checked.dataset(f"records/{self.name}", "<i2", (None, self.valid.size, None))
            arrival = _Arrival(self.valid, np.full(self.valid.size, np.nan), self.damaged)
            rows = slice(first, max(first, last))
            codes, _ = _codes(checked, echo, f"records/{self.name}", self.shot, arrival, self.samples, rows)
        return codes


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
        """Append the next records, (pulse, sample); after an error of the disk ``complete`` is False."""
        if self.complete:
            try:
                self._file.write(np.ascontiguousarray(codes).data)
                self._file.flush()
            except OSError:
                self.complete = False
                with suppress(OSError):
                    self._file.close()

    def block(self, first: int, last: int) -> Int16Array:
        """Return the codes of the records ``first`` to ``last`` - 1, (pulse, sample)."""
        codes = np.empty((max(0, last - first), self._samples), np.int16)
        self._file.seek(2 * first * self._samples)
        if self._file.readinto(codes.data) != codes.nbytes:
            raise StoreError(
                "records of a long shot, copied to a temporary file, cannot be read back: another program has cut it. "
                "Try: again, and leave the folder of temporary files alone meanwhile."
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

    def monitor(self, shot: int) -> ShotRecords | None:
        """Return the records of ``shot`` at the monitor input, (pulse, sample), None if it was not recorded."""
        with open_checked(self.path) as checked:
            if not checked.has("records/monitor"):
                return None
        return self.gated(shot, slice(0, self.shape[2]), "monitor")

    def placement(self, shot: int) -> Placement:
        """Return the pulse of each record of ``shot`` by the trigger times."""
        with open_checked(self.path) as checked:
            shot = _within(shot, self.shape[0])
            return _placement(checked, self.shape, shot, _arrival(checked, self.shape, shot))

    def trigger_time_s(self, shot: int) -> FloatArray:
        """Return the trigger time of each record of ``shot``, s (record,); NaN for missing records and times."""
        with open_checked(self.path) as checked:
            return _arrival(checked, self.shape, _within(shot, self.shape[0])).trigger_time_s

    def gated(
        self, shot: int, gate: slice, name: str = "echo", margin: int = 0, placement: Placement | None = None
    ) -> ShotRecords:
        """Return the samples in ``gate`` and up to ``margin`` around it of each record of ``shot``, (pulse, sample).

        ``placement``: pulses of the records; None: by the trigger times.
        """
        with open_checked(self.path) as checked:
            stored, offset_v, arrival = self._of_shot(checked, shot, gate, name, margin)
            echo = _echo(checked, self.shape, name)
            codes, damaged = _codes(checked, echo, f"records/{name}", stored.shot, arrival, stored.samples)
            record_placement = placement or _placement(checked, self.shape, stored.shot, arrival)
        time_s = np.where(arrival.recorded & ~damaged, arrival.trigger_time_s, np.nan)
        scale, limits = stored.volts_per_code, stored.code_limits
        records = ShotRecords(codes, time_s, scale, offset_v, limits, stored.margin, damaged)
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
        with open_checked(self.path) as checked:
            stored, _, arrival = self._of_shot(checked, shot, gate, "echo", margin)
            placement = placement or _placement(checked, self.shape, stored.shot, arrival)
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
    ) -> tuple[StoredShot, float, _Arrival]:
        """Return the records of ``shot`` without reading their codes, their offset in volts, and which of them arrived.

        ``gate``: samples wanted, with up to ``margin`` around it. ``name``: dataset of the input.
        """
        shot = _within(shot, self.shape[0])
        if not 0 <= gate.start < gate.stop <= self.shape[2]:
            raise StoreError(
                f"{self.path}: the gate takes samples {gate.start} to {gate.stop}, a record has {self.shape[2]}. "
                "Try: a run whose scene passes hpe-rig check."
            )
        samples, margins = with_margin(gate, margin, self.shape[2])
        arrival = _arrival(checked, self.shape, shot)
        _refuse_excessive_size(
            checked, _echo(checked, self.shape, name), arrival.recorded, samples.stop - samples.start
        )
        scale, offset = (checked.attribute(key, float, f"records/{name}") for key in ("scale_factor", "add_offset"))
        limits = _code_limits(checked, f"records/{name}")
        stored = StoredShot(self.path, name, shot, samples, arrival.recorded, scale, limits, margins, arrival.damaged)
        return stored, offset, arrival

    def chunks(self, shot: int, pulses: int, name: str = "echo") -> Iterator[tuple[int, Int16Array]]:
        """Yield (first pulse, codes (pulse, sample)) of ``shot`` in blocks of ``pulses``, opening the file once.

        ``name``: the input, "echo" or "monitor". Raises ``StoreError`` if a record is damaged.
        """
        with open_checked(self.path) as checked:
            echo, arrival = _echo(checked, self.shape, name), _arrival(checked, self.shape, shot)
            for first in range(0, self.shape[1], pulses):
                rows = slice(first, first + pulses)
                codes, damaged = _codes(checked, echo, f"records/{name}", shot, arrival, slice(0, self.shape[2]), rows)
                if damaged.any():
                    raise InvalidContentError(f"shot {shot + 1} has records that fail their checksums")
                yield first, codes

    def damaged(
        self,
        shot: int,
        pulses: int = 4096,
        visit: Callable[[Int16Array], None] | None = None,
        samples: slice = slice(0, 0),
    ) -> BoolArray:
        """Return which records of ``shot`` are damaged at any input, (record,), reading at most ``pulses`` at a time.

        ``visit`` is called with the codes of ``samples`` of all echoes (record, sample), block by block, in the order
        of the file.
        """
        damaged = np.zeros(self.shape[1], bool)
        # An error of ``visit`` does not pass through ``open_checked``, which would report a damaged file.
        with closing(self._checked_blocks(shot, pulses, samples)) as blocks:
            for name, rows, codes, damaged_rows in blocks:
                damaged[rows] |= damaged_rows
                if visit is not None and name == "echo":
                    visit(codes)
        return damaged

    def _checked_blocks(
        self, shot: int, pulses: int, samples: slice
    ) -> Generator[tuple[str, slice, Int16Array, BoolArray], None, None]:
        """Yield input, records, codes of ``samples`` (record, sample) and damage (record,) block by block."""
        with open_checked(self.path) as checked:
            arrival = _arrival(checked, self.shape, shot)
            for name in ("echo", *(["monitor"] if checked.has("records/monitor") else [])):
                echo = _echo(checked, self.shape, name)
                # Whole chunks, so that each is read and compared once.
                max_pulses = min(pulses, MAX_SAMPLES_PER_STEP // self.shape[2])
                step = max(1, max_pulses // echo.chunks[1]) * echo.chunks[1]
                for first in range(0, self.shape[1], step):
                    rows = slice(first, first + step)
                    codes, damaged_rows = _codes(checked, echo, f"records/{name}", shot, arrival, samples, rows)
                    yield name, rows, codes, damaged_rows | arrival.damaged[rows]

    def recorded(self, shot: int) -> BoolArray:
        """Return which records of ``shot`` have an intact mark, (pulse,); their echoes can still be damaged."""
        with open_checked(self.path) as checked:
            return _arrival(checked, self.shape, shot).recorded

    def unverified(self, shot: int) -> BoolArray:
        """Return which records of ``shot`` are marked as recorded but have no checksum, (pulse,)."""
        with open_checked(self.path) as checked:
            marked: BoolArray = stored_values(_rows(checked, "records/recorded", self.shape, "u1"), (shot,)) == 1
            arrival = _arrival(checked, self.shape, shot)
            return marked & ~arrival.recorded & ~arrival.damaged


@dataclass(frozen=True, slots=True)
class StoredGroundTruth:
    """True displacement of every shot, float64 (pulse,) in m, each read on demand."""

    path: Path
    shape: Shape

    def __getitem__(self, shot: int) -> FloatArray:
        """Return the true displacement at every record of ``shot``, m; NaN if missing or damaged."""
        name = "truth/displacement_m"
        with open_checked(self.path) as checked:
            shot = _within(shot, self.shape[0])
            row_m: FloatArray = _row_or_blank(checked, name, _rows(checked, name, self.shape), shot)
            record = _placement(checked, self.shape, shot, _arrival(checked, self.shape, shot)).record
            return np.where(record >= 0, row_m[np.maximum(record, 0)], np.nan)

    def harmonics_m(self, shot: int, frequencies: int) -> FloatArray:
        """Return A cos(phase) and A sin(phase) of the true displacement at the wanted frequencies, (frequency, 2)."""
        shape, shot = (self.shape[0], None), _within(shot, self.shape[0])
        with open_checked(self.path) as checked:
            names = [f"true_harmonics/{name}" for name in TRUE_HARMONICS]
            rows = [_row_or_blank(checked, name, checked.dataset(name, "<f8", shape), shot) for name in names]
            if rows[0].size < frequencies:
                raise InvalidContentError(f"/true_harmonics has {rows[0].size} frequencies, its scene {frequencies}")
            return np.stack(rows, axis=-1)[:frequencies]


@dataclass(frozen=True, slots=True)
class ShotRows:
    """One shot without its echoes: which records arrived and when, (pulse,), and its rows of the other datasets."""

    recorded: BoolArray
    trigger_time_s: FloatArray
    tables: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class StoredRun:
    """Content of a run file.

    true_displacement_m: (pulse,) for each shot; None for a real bench.
    shot_complete: (shot,).
    clipped: shots during which the digitizer's input left its range.
    predecessor: name of the run that this run continued, "" without one.
    run_time_s: wall time of the acquisition by stage; empty if not measured.
    force_set: (shot,), force over F_0 from the amplitude read back from the toneburst generator; NaN without a push,
        without a setting or in early files.
    untrusted: why a shot is untrusted, by shot.
    damage: damaged content other than echoes, and the value used instead.
    provenance: empty in early files and in those of scripts that omit it.
    scan_sha256: SHA-256 of the file ``beams.excitation_scan``; "" without one and in early files.
    changed_settings: differences of the settings after a shot from those before it, in words, by shot.
    conditions: by name, (shot, 2), read before and after each shot; NaN if not read.
    marks: why results leave a shot out, for each shot that was marked as bad after the run.
    """

    path: Path
    scene_name: str
    scene_toml: str
    bench_name: str
    bench_toml: str
    simulated: bool
    status: str
    records: StoredRecords
    true_displacement_m: StoredGroundTruth | None
    shot_complete: BoolArray
    clipped: tuple[int, ...]
    predecessor: str
    run_time_s: Mapping[str, float]
    force_set: FloatArray
    untrusted: Mapping[int, str]
    damage: tuple[str, ...]
    has_checksums: bool
    run_id: str
    provenance: Provenance
    scan_sha256: str
    changed_settings: Mapping[int, str] = field(default_factory=dict)
    conditions: Mapping[str, FloatArray] = field(default_factory=dict)
    marks: Mapping[int, str] = field(default_factory=dict)

    @property
    def identity(self) -> dict[str, str]:
        """The identity of the run, which its marks repeat."""
        return identity_of(self.run_id, self.provenance.started)

    def mark(self, shots: Sequence[int], why: str | None) -> Path:
        """Mark ``shots``, counted from 0, as bad for the reason ``why`` or, with None, as good; return the marks' path.

        The marks of this value stay as they were read.
        """
        marks = {shot: text for shot, text in self.marks.items() if shot not in shots}
        return write_marks(self.path, self.identity, marks if why is None else marks | dict.fromkeys(shots, why))

    @property
    def imported(self) -> bool:
        """Whether the records are those of another program, which states the pulse of each."""
        return "[recording]" in self.bench_toml.splitlines()

    def rows(self, shot: int) -> ShotRows:
        """Return the values of ``shot`` other than its echoes, to copy them; missing or damaged values are blank."""
        shape = self.records.shape
        with open_checked(self.path) as checked:
            arrival = _arrival(checked, shape, shot)
            tables = {
                name: _row_or_blank(checked, name, dataset, shot)
                for name, dataset in _datasets_by_shot(checked, shape)
                if not name.endswith("shot_complete")
            }
        return ShotRows(arrival.recorded, arrival.trigger_time_s, tables)

    def is_intact(self, shot: int) -> bool:
        """Return whether everything of ``shot`` matches its checksums; reads the whole shot."""
        return not damage_by_shot(self, shot) and not self.records.damaged(shot).any()

    def refuse_other_plan(self, plan: Plan) -> None:
        """Raise ``StoreError`` if the records do not fit ``plan``: the file or its scene was changed."""
        capture = plan.shots[0].capture
        planned = (len(plan.shots), capture.record_count, capture.record_samples)
        if planned != self.records.shape:
            raise StoreError(
                f"{self.path} holds (shot, pulse, sample) = {self.records.shape}, its scene asks for {planned}. "
                "It was changed. Try: an untouched copy."
            )
        for shot, force in zip(plan.shots, self.force_set, strict=True):
            # Instruments round by some per cent of their lowest amplitude, and by far less at higher amplitudes.
            if np.isfinite(force) and not math.isclose(force, shot.force_fraction or 0.0, rel_tol=0.1):
                raise StoreError(
                    f"{self.path} has a force of {force:g} F_0 in shot {shot.index + 1}, its scene asks for "
                    f"{shot.force_fraction or 0.0:g}. It was changed. Try: an untouched copy."
                )
        with open_checked(self.path) as checked:
            stored = tuple(checked.attribute(name, float, "records/echo") for name in ("scale_factor", "add_offset"))
            expected = volts_of_codes(capture.input_range_v, _code_limits(checked, "records/echo"))
        if not np.allclose(stored, expected, rtol=1e-9, atol=0):
            raise StoreError(
                f"{self.path} has {stored[0]:g} V per code, its scene's input range of {capture.input_range_v:g} V "
                f"gives {expected[0]:g}. It was changed. Try: an untouched copy."
            )


def read_run(path: Path) -> StoredRun:
    """Return the run in ``path``, also of a running or killed program; raise ``StoreError`` if it is not a run file."""
    with open_checked(path) as checked:
        stored = _stored_run(checked, path)
    marks, why_ignored = read_marks(path, stored.identity, stored.shot_complete.size)
    return replace(stored, marks=marks, damage=(*stored.damage, *([why_ignored] if why_ignored else [])))


def read_snapshots(path: Path) -> tuple[Mapping[str, Mapping[str, Setting]], ...]:
    """Return the instruments' settings of each acquired shot, as read back, by role of the instrument.

    Raises ``StoreError`` if the file is no readable run file.
    """
    with open_checked(path) as checked:
        dataset = checked.dataset("snapshot", f"S{SNAPSHOT_BYTES}", (None,))
        texts = [_row_or_blank(checked, "snapshot", dataset, shot).item() for shot in range(dataset.shape[0])]
        return tuple(_settings(text) for text in texts if text)


def _settings(text: bytes) -> Mapping[str, Mapping[str, Setting]]:
    """Return the instruments' settings of a shot by role, from their JSON ``text``.

    Raises ``InvalidContentError`` for any other content.
    """
    try:
        roles = json.loads(text)
    except (ValueError, RecursionError):
        raise InvalidContentError("a shot's settings are not JSON") from None
    if not isinstance(roles, dict) or not all(isinstance(values, dict) for values in roles.values()):
        raise InvalidContentError("a shot's settings are not listed by role")
    if not all(isinstance(value, str | int | float) for values in roles.values() for value in values.values()):
        raise InvalidContentError("a setting is not a single value")
    return roles


def _stored_run(checked: CheckedFile, path: Path) -> StoredRun:
    """Return the content of a run file, without its echoes, and with a message for each damaged part left out."""
    simulated = checked.attribute("simulated", bool)
    shape = _checked_shape(checked, simulated)
    status = checked.attribute("status", str)
    if status not in STATUSES:
        raise InvalidContentError(f"its status is {status!r}")
    damage = list[str]()
    if (remark := _remark_on_length(checked)) is not None:
        damage.append(remark)
    shot_complete, damaged_shots = _flags(checked, shape, "shot_complete", "does not count as complete")
    clipped, damaged_clipping = _flags(checked, shape, "clipped", "may have been clipped")
    damage += damaged_shots + damaged_clipping
    run_time_s, times_intact = _run_time_s(checked)
    damage += [] if times_intact else ["/run_time fails its checksum: the run times are left out"]
    provenance, end_intact = _provenance(checked)
    damage += [] if end_intact else ["/provenance/ended fails its checksum: when the run ended is left out"]
    damage += _damaged_rows(checked, shape)
    return StoredRun(
        path=path,
        scene_name=checked.attribute("scene_name", str),
        scene_toml=checked.text("scene"),
        bench_name=checked.attribute("bench_name", str),
        bench_toml=checked.text("bench"),
        simulated=simulated,
        status=status,
        records=StoredRecords(path, shape),
        true_displacement_m=StoredGroundTruth(path, shape) if simulated else None,
        shot_complete=shot_complete,
        clipped=tuple(int(shot) for shot in np.flatnonzero(clipped)),
        predecessor=checked.attribute("predecessor", str),
        run_time_s=run_time_s,
        force_set=_force_set(checked, shape[0]),
        untrusted=_texts_by_shot(checked, shape, "untrusted"),
        damage=tuple(damage),
        has_checksums=checked.has_checksums,
        run_id=checked.attribute("run_id", str) if "run_id" in checked.file.attrs else "",
        provenance=provenance,
        scan_sha256=checked.attribute("scan_sha256", str) if "scan_sha256" in checked.file.attrs else "",
        changed_settings=_texts_by_shot(checked, shape, "changed_settings"),
        conditions=_conditions(checked, shape[0]),
    )


def _remark_on_length(checked: CheckedFile) -> str | None:
    """Return a message if the end of the file is damaged."""
    if checked.missing_bytes > 0 and checked.codes:
        return f"the log of the run is damaged: its last {checked.missing_bytes} bytes are left out"
    if checked.missing_bytes > 0:
        return f"the file is cut short: {checked.missing_bytes} bytes are missing at its end"
    if checked.missing_bytes < 0 and checked.is_written_once:
        return f"{-checked.missing_bytes} bytes follow the end of the file: another program has appended them"
    return None


def _checked_shape(checked: CheckedFile, simulated: bool) -> Shape:
    """Return the shape (shot, pulse, sample) of the echoes.

    Raises ``InvalidContentError`` unless all datasets with a value for each pulse have the same shots and pulses.
    """
    shape: Shape = checked.dataset("records/echo", "<i2", (None, None, None)).shape
    if min(shape) < 1 or shape[0] > MAX_SHOTS:
        raise InvalidContentError(f"/records/echo has shape {shape}")
    _echo(checked, shape)
    for name, dtype in (("recorded", "u1"), ("trigger_time_s", "<f8"), ("pulse_onset_s", "<f8")):
        _rows(checked, f"records/{name}", shape, dtype)
    if simulated:
        _rows(checked, "truth/displacement_m", shape)
    return shape


def _flags(checked: CheckedFile, shape: Shape, name: str, consequence: str) -> tuple[BoolArray, list[str]]:
    """Return the flag ``name`` of each shot (shot,), and a message for each that fails its checksum.

    ``consequence``: the end of that message.
    """
    values, intact = _all_rows(checked, f"records/{name}", checked.dataset(f"records/{name}", "u1", shape[:1]))
    damage = [
        f"shot {shot + 1}: /records/{name} fails its checksum: the shot {consequence}"
        for shot in np.flatnonzero(~intact)
    ]
    return values == 1, damage


def _force_set(checked: CheckedFile, shots: int) -> FloatArray:
    """Return the relative force that the generator was set to in each shot, as read back, (shot,), NaN if unknown."""
    if not checked.has("records/force_set"):
        # Early releases did not read the generator's setting back.
        return np.full(shots, np.nan)
    force, _ = _all_rows(checked, "records/force_set", checked.dataset("records/force_set", "<f8", (shots,)))
    return force


def _texts_by_shot(checked: CheckedFile, shape: Shape, name: str) -> dict[int, str]:
    """Return the texts of a dataset by shot, such as why a shot is untrusted; shots without a text are absent."""
    if not checked.has(name):
        # Early releases did not read settings back after a shot.
        return {}
    dataset = checked.dataset(name, f"S{UNTRUSTED_BYTES}", shape[:1])
    unknown = f"its state is unknown, /{name} is damaged".encode("ascii")
    rows = zip(*_all_rows(checked, name, dataset), strict=True)
    texts = [text if intact else unknown for text, intact in rows]
    return {shot: text.decode("ascii", "replace") for shot, text in enumerate(texts) if text}


def _conditions(checked: CheckedFile, shots: int) -> dict[str, FloatArray]:
    """Return the readings of each condition by name, (shot, 2): before and after each shot.

    A condition is a quantity that may affect the measurement, such as the water's temperature. NaN: not read, or
    damaged.
    """
    if not checked.has("conditions"):
        return {}
    names = checked.dataset("conditions/condition", f"S{CONDITION_BYTES}", (None,))
    if names.shape[0] > MAX_CONDITIONS:
        raise InvalidContentError(f"/conditions has {names.shape[0]} conditions")
    checked.refuse_damaged("conditions/condition", names)
    shape = (shots, names.shape[0])
    columns = [
        _all_rows(checked, name, checked.dataset(name, "<f8", shape))[0]
        for name in ("conditions/before", "conditions/after")
    ]
    values = np.stack(columns, axis=-1)
    return {printable(name.decode("ascii", "replace")): values[:, index] for index, name in enumerate(names[()])}


def _run_time_s(checked: CheckedFile) -> tuple[dict[str, float], bool]:
    """Return the time that each stage of the run took, s, and whether the times match their checksum."""
    if not checked.has("run_time"):
        # The earliest run files of this version have none.
        return {}, True
    names = checked.dataset("run_time/stage", f"S{STAGE_BYTES}", (None,))
    if names.shape[0] > MAX_STAGES:
        raise InvalidContentError(f"/run_time has {names.shape[0]} stages")
    checked.refuse_damaged("run_time/stage", names)
    dataset = checked.dataset("run_time/run_time_s", "<f8", names.shape)
    times_s, intact = _row(checked, "run_time/run_time_s", dataset, None)
    pairs = zip([name.decode("ascii", "replace") for name in names[()]], times_s, strict=True)
    return {stage: float(time_s) for stage, time_s in pairs if stage.isprintable() and 0 <= time_s < math.inf}, intact


def _provenance(checked: CheckedFile) -> tuple[Provenance, bool]:
    """Return start, end, host, user and drivers of the run, and whether the end matches its checksum."""
    if not checked.has("provenance"):
        return Provenance(), True
    texts = {name: checked.text(f"provenance/{name}") for name in ("started", "host", "user", "drivers")}
    ended, intact = _row(checked, "provenance/ended", checked.dataset("provenance/ended", f"S{TIME_BYTES}", ()), None)
    text = ended.item().decode("ascii", "replace")
    return Provenance(**texts, ended=text if text.isprintable() else ""), intact


def _damaged_rows(checked: CheckedFile, shape: Shape) -> Iterator[str]:
    """Yield a message for each shot and dataset of planned onsets or simulated truth that fails its checksum."""
    consequences = {
        "records/pulse_onset_s": "its records are counted in the order of arrival",
        "truth/displacement_m": "its truth is left out",
        **{f"true_harmonics/{name}": "its truth is left out" for name in TRUE_HARMONICS},
    }
    for name, dataset in _datasets_by_shot(checked, shape):
        if name in consequences:
            _, intact = _all_rows(checked, name, dataset)
            for shot in np.flatnonzero(~intact):
                yield f"shot {shot + 1}: /{name} fails its checksum: {consequences[name]}"


def damage_by_shot(stored: StoredRun, shot: int) -> tuple[str, ...]:
    """Return a message for each dataset with one checksum per shot that fails it in the row of ``shot``."""
    with open_checked(stored.path) as checked:
        datasets = _datasets_by_shot(checked, stored.records.shape)
        rows = [(name, _row(checked, name, dataset, shot)) for name, dataset in datasets]
    return tuple(f"/{name} fails its checksum" for name, (_, intact) in rows if not intact)


def _datasets_by_shot(checked: CheckedFile, shape: Shape) -> Iterator[tuple[str, h5py.Dataset]]:
    """Yield name and dataset of those datasets in the file that have one checksum for each shot.

    Echoes and their trigger times are not among them, because their checksums are by chunk.
    """
    # Type and shape of each dataset; the others hold one float64 for each shot and frequency.
    layouts: dict[str, tuple[str, tuple[int | None, ...]]] = {
        "snapshot": (f"S{SNAPSHOT_BYTES}", shape[:1]),
        # Why the settings of a shot cannot be relied on; empty if they can.
        "untrusted": (f"S{UNTRUSTED_BYTES}", shape[:1]),
        "changed_settings": (f"S{UNTRUSTED_BYTES}", shape[:1]),
        "records/shot_complete": ("u1", shape[:1]),
        "records/clipped": ("u1", shape[:1]),
        "records/force_set": ("<f8", shape[:1]),
        "records/pulse_onset_s": ("<f8", shape[:2]),
        "truth/displacement_m": ("<f8", shape[:2]),
    }
    for name in BY_SHOT:
        dtype, dataset_shape = layouts.get(name, ("<f8", (shape[0], None)))
        if checked.has(name):
            yield name, checked.dataset(name, dtype, dataset_shape)


def _row(checked: CheckedFile, name: str, dataset: h5py.Dataset, row: int | None) -> tuple[Any, bool]:
    """Return row ``row`` of a dataset (None: all of it), and whether it matches its checksum.

    Values that were never written or are damaged are blank. ``name``: path of the dataset.
    """
    index = () if row is None else (row,)
    values = stored_values(dataset, index)
    if not checked.has_checksums:
        return values, True
    expected = int(checked.dataset(f"{GROUP}/{name}", "<u8", dataset.shape[: len(index)])[index])
    matches = expected == checked.row_checksum(name, index, stored_bytes(values, dataset.dtype))
    # In files of version 2 a checksum of 0 is that of values that were never written.
    intact = matches or (expected == 0 and not checked.is_written_once)
    return (values if matches else blank(dataset.dtype, values.shape)), intact


def _row_or_blank(checked: CheckedFile, name: str, dataset: h5py.Dataset, row: int) -> Any:
    """Return row ``row`` of a dataset, blank if it was never written or is damaged. ``name``: path of the dataset."""
    values, _ = _row(checked, name, dataset, row)
    return values


def _all_rows(checked: CheckedFile, name: str, dataset: h5py.Dataset) -> tuple[NDArray[Any], BoolArray]:
    """Return every row of a dataset, and which rows match their checksums, (row,).

    Rows that were never written or are damaged are blank.
    """
    values = stored_values(dataset)
    if not checked.has_checksums:
        return values, np.ones(values.shape[0], bool)
    expected = checked.dataset(f"{GROUP}/{name}", "<u8", dataset.shape[:1])[()]
    content = [stored_bytes(row, dataset.dtype) for row in values]
    actual = [checked.row_checksum(name, (index,), row) for index, row in enumerate(content)]
    matches = expected == np.array(actual, "<u8")
    values[~matches] = blank(dataset.dtype, ())
    # In files of version 2 a checksum of 0 is that of a row that was never written.
    return values, matches | ((expected == 0) & (not checked.is_written_once))


@dataclass(frozen=True, slots=True)
class _Arrival:
    """Which records of a shot are in the file, their trigger times, and which marks are damaged; each (pulse,)."""

    recorded: BoolArray
    trigger_time_s: FloatArray
    damaged: BoolArray


def _arrival(checked: CheckedFile, shape: Shape, shot: int) -> _Arrival:
    """Return which records of ``shot`` are in the file, with their trigger times.

    The marks of each chunk of records have a checksum; records with a missing or wrong one do not count.
    """
    marks = stored_values(_rows(checked, "records/recorded", shape, "u1"), (shot,))
    time_s = stored_values(_rows(checked, "records/trigger_time_s", shape), (shot,))
    recorded, damaged = marks == 1, np.zeros(shape[1], bool)
    if checked.has_checksums:
        # Marks and trigger times have one checksum for each chunk of records.
        name, size = "records/recorded", checked.file["records/echo"].chunks[1]
        for number, expected in enumerate(_sums(checked, name, shape, size)[shot]):
            rows = slice(number * size, (number + 1) * size)
            if not expected and not checked.is_written_once:
                # The writer was killed before it wrote this checksum.
                recorded[rows] = False
            elif checked.row_checksum(name, (shot, number), marks[rows].tobytes(), time_s[rows].tobytes()) != expected:
                recorded[rows], damaged[rows] = False, True
    return _Arrival(recorded, np.where(recorded, time_s, np.nan), damaged)


def _placement(checked: CheckedFile, shape: Shape, shot: int, arrival: _Arrival) -> Placement:
    """Return the pulse of each record of ``shot`` by the trigger times; damaged records count as arrived.

    The pulse rate is that of the planned onsets; without them, or for one pulse, it is not finite.
    """
    name = "records/pulse_onset_s"
    onset_s = _row_or_blank(checked, name, _rows(checked, name, shape), shot)
    with np.errstate(divide="ignore", invalid="ignore"):
        rate_hz = float((shape[1] - 1) / (onset_s[-1] - onset_s[0]))
    return place_records(arrival.recorded | arrival.damaged, arrival.trigger_time_s, rate_hz)


def _sums(checked: CheckedFile, name: str, shape: Shape, rows: int) -> h5py.Dataset:
    """Return the checksums of dataset ``name``, (shot, chunk), for chunks of ``rows`` records."""
    return checked.dataset(f"{GROUP}/{name}", "<u8", (shape[0], -(-shape[1] // rows)))


def _codes(
    checked: CheckedFile,
    echo: h5py.Dataset,
    name: str,
    shot: int,
    arrival: _Arrival,
    samples: slice,
    rows: slice | None = None,
) -> tuple[Int16Array, BoolArray]:
    """Return the codes of ``samples`` of the records ``rows``, (pulse, sample), and which are damaged, (pulse,).

    A record is damaged if its mark in ``arrival`` is, or if the chunk that holds it fails its checksum. Each chunk is
    checked before it is decompressed.
    """
    rows = slice(0, echo.shape[1]) if rows is None else slice(rows.start, min(rows.stop, echo.shape[1]))
    # Damaged marks are carried in from ``arrival``; damaged chunks are added below.
    recorded, damaged = arrival.recorded[rows], arrival.damaged[rows].copy()
    records_per_chunk: int = echo.chunks[1]
    # A file without checksums can have chunks of any shape. If its chunks span several shots or only part of a record,
    # HDF5 assembles the selection itself.
    if not checked.has_checksums and (echo.chunks[0] != 1 or echo.chunks[2] != echo.shape[2]):
        codes = echo[shot, rows, samples]
        codes[~recorded] = MISSING
        return codes, damaged
    codes = np.full((recorded.size, samples.stop - samples.start), MISSING)
    sums = _sums(checked, name, echo.shape, records_per_chunk) if checked.has_checksums and recorded.any() else None
    for number in range(rows.start // records_per_chunk, -(-rows.stop // records_per_chunk)):
        # Records that the chunk and ``rows`` share: indices in the shot, then in the result.
        first, last = max(number * records_per_chunk, rows.start), min((number + 1) * records_per_chunk, rows.stop)
        block = slice(first - rows.start, last - rows.start)
        if recorded[block].any():
            chunk_codes = _chunk(checked, echo, name, shot, number, sums)
            if chunk_codes is None:
                damaged[block] |= recorded[block]
            else:
                codes[block] = chunk_codes[
                    first - number * records_per_chunk : last - number * records_per_chunk, samples
                ]
    codes[~recorded | damaged] = MISSING
    return codes, damaged


def _chunk(
    checked: CheckedFile, echo: h5py.Dataset, name: str, shot: int, number: int, sums: h5py.Dataset | None
) -> Int16Array | None:
    """Return the codes of chunk ``number`` of a shot, (pulse, sample), None if it is damaged.

    A chunk is the piece that HDF5 stores at once. ``sums`` (shot, chunk): checksums, None in a file without.
    """
    rows = echo.chunks[1]
    first = number * rows
    shape = (min(rows, echo.shape[1] - first), echo.shape[2])
    if checked.codes is not None:
        chunk = checked.codes(name, shot, number, shape, first)
        return None if chunk is None else chunk[0]
    if checked.is_written_once:
        return _checked_chunk(checked, echo, name, shot, number, sums)
    if sums is None:
        location = echo.id.get_chunk_info_by_coord((shot, first, 0))
        if location.byte_offset is None or location.byte_offset + location.size > checked.size:
            return None
    else:
        stored = _stored_chunk(echo, shot, first)
        if stored is None or digest(name, (shot, number), stored) != int(sums[shot, number]):
            return None
        if not _is_compressed(echo):
            return np.frombuffer(stored, "<i2").reshape(echo.chunks[1:])
    try:
        codes: Int16Array = echo[shot, first : first + rows]
    except OSError:
        return None
    return codes


def _checked_chunk(
    checked: CheckedFile, echo: h5py.Dataset, name: str, shot: int, number: int, sums: h5py.Dataset | None
) -> Int16Array | None:
    """As ``_chunk``, in a file that was written after its run: the checksum is that of the codes."""
    first, samples = number * echo.chunks[1], echo.shape[2]
    rows = min(echo.chunks[1], echo.shape[1] - first)
    if _is_compressed(echo):
        try:
            # HDF5 compares its own checksum before it decompresses the chunk.
            codes: Int16Array = echo[shot, first : first + rows]
        except OSError:
            return None
    else:
        # HDF5's own checksum follows the codes; comparing one checksum takes half the time.
        stored = _stored_chunk(echo, shot, first)
        if stored is None or len(stored) < 2 * rows * samples:
            return None
        codes = np.frombuffer(stored, "<i2", rows * samples).reshape(rows, samples)
    matches = sums is not None and checked.row_checksum(name, (shot, number), codes.data) == int(sums[shot, number])
    return codes if matches else None


def _stored_chunk(echo: h5py.Dataset, shot: int, first: int) -> bytes | None:
    """Return the stored bytes of the chunk that begins with record ``first`` of ``shot``; None if it is not there."""
    try:
        _, stored = echo.id.read_direct_chunk((shot, first, 0))
    except (OSError, RuntimeError, ValueError):
        # The chunk lies beyond the end of the file or has no location.
        return None
    content: bytes = stored
    return content


def _refuse_excessive_size(checked: CheckedFile, echo: h5py.Dataset, recorded: BoolArray, samples: int) -> None:
    """Raise ``InvalidContentError`` if the declared records need far more memory than the file has bytes for them.

    ``samples``: number of samples that are read from each record.
    """
    _, pulses, record_samples = echo.shape
    size = checked.size if checked.codes else echo.id.get_storage_size()
    if (checked.codes or not _is_compressed(echo)) and int(recorded.sum()) * record_samples * 2 > size:
        raise InvalidContentError(f"it declares {int(recorded.sum())} stored records in {size} bytes")
    if 2 * pulses * samples > size + MAX_MISSING_BYTES:
        raise InvalidContentError(f"it declares {pulses} records a shot and holds {size} bytes")


def _is_compressed(echo: h5py.Dataset) -> bool:
    """Return whether the chunks of ``echo`` are compressed."""
    properties = echo.id.get_create_plist()
    return any(properties.get_filter(number)[0] == BITSHUFFLE for number in range(properties.get_nfilters()))


def _echo(checked: CheckedFile, shape: Shape, name: str = "echo") -> h5py.Dataset:
    """Return the dataset of the records at input ``name``.

    Raises ``InvalidContentError`` unless each chunk, the piece that HDF5 stores at once, holds whole records of one
    shot.
    """
    echo = checked.dataset(f"records/{name}", "<i2", shape)
    if echo.chunks is None:
        raise InvalidContentError(f"/records/{name} is in one piece")
    # Only files without checksums may have other chunks.
    if checked.has_checksums and (echo.chunks[0] != 1 or echo.chunks[2] != shape[2]):
        raise InvalidContentError(f"/records/{name} has chunks of {echo.chunks}")
    return echo


def _code_limits(checked: CheckedFile, name: str) -> tuple[int, int]:
    """Return the lowest and the highest code of the digitizer for the records in dataset ``name``."""
    if "valid_min" not in checked.file[name].attrs:
        return CODE_LIMITS_UNSTATED
    lowest, highest = (checked.attribute(key, int, name) for key in ("valid_min", "valid_max"))
    if not MISSING < lowest < highest <= np.iinfo(np.int16).max:
        raise InvalidContentError(f"/{name} has codes from {lowest} to {highest}")
    return lowest, highest


def _rows(checked: CheckedFile, name: str, shape: Shape, dtype: str = "<f8") -> h5py.Dataset:
    """Return the dataset ``name`` (shot, pulse)."""
    return checked.dataset(name, dtype, shape[:2])


def _within(shot: int, shots: int) -> int:
    """Return the index of ``shot``, which may count from the end; raise ``IndexError`` if there is none."""
    if not -shots <= shot < shots:
        raise IndexError(f"shot {shot} of {shots}")
    return shot % shots
