"""Writer of a run file: records go to disk as they arrive, in whole chunks, while others may read.

The order of writing carries the promise: a chunk of echoes is handed to the operating system before the marks in
``recorded`` that say its records are there, and the checksums of both after them. A reader, or the next program after a
crash, may trust every mark that has its checksum.
"""

from __future__ import annotations

import contextlib
import json
import logging
import math
import os
import shutil
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any, final

import h5py
import numpy as np
from h5py import h5f, h5fd, h5p, h5s
from numpy.typing import NDArray

from drivers.interfaces import RecordBlock
from hpe_rig.arrays import BoolArray, FloatArray, Int16Array, Int64Array
from hpe_rig.bench import BenchText, uninterrupted
from hpe_rig.plan import Plan, Shot
from hpe_rig.result import Provenance
from hpe_rig.scene import SceneText
from hpe_rig.store.atomic import atomic_file
from hpe_rig.store.checksum import AT_ONCE, BY_SHOT, GROUP, digest, stored_bytes
from hpe_rig.store.format import SNAPSHOT_BYTES, STAGES, STATUSES, UNTRUSTED_BYTES, StoreError, reason
from hpe_rig.store.journal import Journal, Write, in_time
from hpe_rig.store.layout import LIBVER, TRUE_HARMONICS, Predecessor, empty_run, volts_of_codes
from hpe_rig.store.lock import is_taken
from hpe_rig.store.reader import StoredRun, read_run
from hpe_rig.store.records import MISSING, Placed, place

CHECKPOINT_S = 1.0
"""Longest time between two syncs to the disk itself, checked at the end of each shot."""
MOST_UNVOUCHED = 8
"""Chunks that are written before what says that they are there, if as many arrive at once."""
LOOK_S = 0.25
"""How often a run that writes nothing looks whether its file is still there."""
LIBRARY_ERRORS = (OSError, RuntimeError, KeyError, MemoryError)
"""What the HDF5 library raises; after any of these nothing more that it writes can be relied on."""


@dataclass(frozen=True, slots=True)
class WriteOptions:
    """Options of writing a run file; ``predecessor`` is the run that a resumed run continues.

    ``run_id``: hexadecimal digits that tell the run from others of its name, for those who may ask it to stop.
    ``provenance``: when and where the run starts; without it the same simulated run gives the same file bit for bit.
    """

    compress: bool = False
    overwrite: bool = False
    predecessor: Predecessor = field(default_factory=Predecessor)
    run_id: str = ""
    provenance: Provenance | None = None


@final
class RunWriter:
    """Open run file: records are appended as they arrive; closing it writes the status.

    Use it as a context manager. The status becomes complete, failed (an exception) or aborted (Ctrl-C, SIGTERM).
    """

    def __init__(
        self,
        path: Path,
        scene: SceneText,
        bench: BenchText,
        plan: Plan,
        options: WriteOptions = WriteOptions(),
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Create ``path``; raise ``StoreError`` if it exists, cannot be written or would not hold the records."""
        self.path = path
        self._clock = clock
        self._checkpoint_s = self._looked_s = self._started_s = clock()
        self._provenance = options.provenance
        self._broken = False
        about = options.compress, options.predecessor, options.run_id, options.provenance
        try:
            image = empty_run(scene, bench, plan, *about)
            self._journal = _begun(image, path, options.overwrite, 0 if options.compress else plan.record_bytes)
            try:
                with uninterrupted():
                    self._open(plan, bench)
            except BaseException:
                # A file that nobody can write holds nothing, and would say "running" for ever.
                with contextlib.suppress(OSError, MemoryError):
                    self._journal.close()
                self.remove()
                raise
        except LIBRARY_ERRORS as error:
            # Of the library, or of Python, which finds no memory for a thread.
            raise StoreError(f"{path} cannot be created ({reason(error)}). Try: again, with fewer programs.") from error

    def _open(self, plan: Plan, bench: BenchText) -> None:
        """Take the datasets of the file that was begun."""
        self._file = open_on(self._journal)
        self._endings = _endings(self._file, self._journal)
        if not self._journal.locked:
            logging.getLogger("hpe_rig").warning("%s: its disk knows no locks. Let no other run write it.", self.path)
        self._volts = volts_of_codes(plan.shots[0].capture.input_range_v, bench.bench.digitizer.board_model.code_limits)
        self._tables = {name: _Table(self._file, name) for name in (*BY_SHOT, *AT_ONCE)}
        # A checksum takes as long as writing what it is of: they go on at the same time, two chunks' at once.
        self._beside = ThreadPoolExecutor(2, thread_name_prefix="checksum")
        names = ["records/echo", *(["records/monitor"] if "records/monitor" in self._file else [])]
        self._chunks = [
            _Chunk(self._file, name, _ChunkSums(self._file, name, self._journal), self._beside) for name in names
        ]
        self._chunk = self._chunks[0]
        sums = _ChunkSums(self._file, "records/recorded", self._journal)
        self._arrivals = _Arrivals(self._file, self._chunk.rows, sums)
        self._shot: _ShotRows | None = None

    def __enter__(self) -> RunWriter:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        failed = "failed" if kind is not None and issubclass(kind, Exception) else "aborted"
        if kind is not None and failed == "aborted":
            self._journal.hurry()
        try:
            with uninterrupted():
                self._end("complete" if kind is None else failed)
        except StoreError:
            # What broke the run is the better message.
            if kind is None:
                raise

    def look(self) -> None:
        """Raise ``StoreError`` where the file is no longer the one that was begun; looks every ``LOOK_S``."""
        if self._clock() - self._looked_s >= LOOK_S:
            with self._committing():
                pass

    def remove(self) -> None:
        """Delete the file, closed before, unless another one has taken its place."""
        with contextlib.suppress(OSError):
            if self._journal.is_in_place():
                self.path.unlink()

    def settings(self, shot: Shot, settings: Mapping[str, Mapping[str, Any]]) -> None:
        """Write the instruments' settings as read back for ``shot``, the force set, and when its pulses are due."""
        text = json.dumps(settings, sort_keys=True, separators=(",", ":"))
        if len(text) > SNAPSHOT_BYTES:
            raise StoreError(
                f"the settings of shot {shot.index + 1} take {len(text)} bytes, a run file has room for "
                f"{SNAPSHOT_BYTES}. Try: report this with the bench file."
            )
        with self._committing():
            self._tables["snapshot"].put(shot.index, text.encode("ascii"))
            self._tables["records/pulse_onset_s"].put(shot.index, shot.timeline.pulse_onset_s)
            if (amplitude_vpp := settings.get("toneburst", {}).get("amplitude_vpp")) is not None:
                self._tables["records/force_set"].put(shot.index, shot.force_fraction_at(amplitude_vpp))

    def append(self, shot: Shot, block: RecordBlock) -> None:
        """Write the records of ``block`` at the places of their pulses; full chunks go to disk."""
        if not block.codes.size:
            return
        self._refuse_other_volts(block)
        # The disk takes these records while the next ones arrive; they are waited for before the shot is complete.
        with self._committing(always=False, wait=False):
            rows = self._rows_of(shot)
            index, rows.latest = place(block, rows.latest, shot)
            kept = index >= 0
            # Indexing copies, so it is done only where a record is left out.
            inputs = (block.codes, *([] if block.monitor is None else [block.monitor.codes]))
            codes = inputs if kept.all() else tuple(of_input[kept] for of_input in inputs)
            self._put(rows, index[kept], codes, block.trigger_time_s[kept])
            self._vouch()

    def clipped(self, shot: Shot, clipped: bool) -> None:
        """Write whether the input of the digitizer left its range during ``shot``."""
        with self._writing():
            self._tables["records/clipped"].put(shot.index, clipped)

    def untrusted(self, shot: Shot, why: str) -> None:
        """Write why the records of ``shot`` are not to be trusted."""
        with self._committing():
            self._tables["untrusted"].put(shot.index, why.encode("ascii", "replace")[:UNTRUSTED_BYTES])

    def ground_truth(self, shot: Shot, displacement_m: FloatArray) -> None:
        """Write the true displacement at the focus at each record of ``shot``, (record,)."""
        recorded = np.zeros(0, bool) if self._shot is None else self._shot.recorded
        valid = np.flatnonzero(recorded)
        row_m = np.full(recorded.size, np.nan)
        row_m[valid] = displacement_m[: valid.size]
        if valid.size:
            with self._writing():
                self._tables["truth/displacement_m"].put(shot.index, row_m)

    def true_harmonics(self, shot: Shot, harmonics_m: FloatArray) -> None:
        """Write A cos(phase) and A sin(phase) of the true displacement at the wanted frequencies, (frequency, 2)."""
        with self._writing():
            for name, column_m in zip(TRUE_HARMONICS, harmonics_m.T, strict=True):
                table = self._tables[f"true_harmonics/{name}"]
                table.put(shot.index, np.concatenate([column_m, np.full(table.width - column_m.size, np.nan)]))

    def run_time(self, run_time_s: Mapping[str, float]) -> None:
        """Write the wall time of each stage so far."""
        with self._committing():
            self._tables["run_time/run_time_s"].put(None, [run_time_s.get(name, math.nan) for name in STAGES])

    def finish(self, shot: Shot) -> None:
        """Write everything of ``shot``, then mark it complete; sync to disk if ``CHECKPOINT_S`` have passed."""
        due = self._clock() - self._checkpoint_s >= CHECKPOINT_S
        with self._committing(sync=due):
            self._write_chunk()
            self._vouch()
            self._file.flush()
            self._tables["records/shot_complete"].put(shot.index, 1)
        if due:
            self._checkpoint_s = self._clock()

    def take_over(self, earlier: StoredRun, shots: int) -> None:
        """Copy the first ``shots`` shots of another run of the same plan, chunk by chunk.

        Raises ``StoreError`` where one of them is damaged.
        """
        for shot in range(shots):
            taken = earlier.rows(shot)
            with self._committing():
                for chunk in self._chunks:
                    for start, codes in earlier.records.chunks(shot, chunk.rows, chunk.short_name):
                        chunk.write(shot, start, codes)
                        self._file.flush()
                        chunk.vouch()
                        self._commit()
                self._arrivals.put(shot, range(self._arrivals.count), taken.recorded, taken.trigger_time_s)
                for name, row in taken.tables.items():
                    self._tables[name].put(shot, row)
                self._file.flush()
                self._tables["records/shot_complete"].put(shot, 1)

    def _rows_of(self, shot: Shot) -> _ShotRows:
        if self._shot is None or self._shot.index != shot.index:
            self._write_chunk()
            self._vouch()
            self._shot = _ShotRows(shot)
        return self._shot

    def _put(
        self,
        rows: _ShotRows,
        index: Int64Array,
        codes: tuple[Int16Array, ...],
        time_s: FloatArray,
    ) -> None:
        # Records of one block may reach over several chunks, and late ones may belong to an earlier chunk.
        for number, here in self._by_chunk(index):
            if (rows.index, number) != self._chunk.place:
                self._write_chunk()
                for chunk in self._chunks:
                    chunk.begin(rows.index, number)
                    chunk.recall(rows.recorded[number * chunk.rows : (number + 1) * chunk.rows])
            for chunk, of_input in zip(self._chunks, codes, strict=True):
                chunk.put(index[here] - number * chunk.rows, of_input[here])
            rows.recorded[index[here]] = True
            rows.trigger_time_s[index[here]] = time_s[here]
            if index[here][-1] % self._chunk.rows == self._chunk.rows - 1:
                self._write_chunk()

    def _by_chunk(self, index: Int64Array) -> Iterator[tuple[int, slice | BoolArray]]:
        """Yield each chunk that records ``index`` (record,) belong to, and which of them do."""
        rows = self._chunk.rows
        if index.size and bool(np.all(np.diff(index) == 1)):
            # One after another, as nearly always: slices copy nothing.
            first, last = int(index[0]), int(index[-1])
            for number in range(first // rows, last // rows + 1):
                yield number, slice(max(0, number * rows - first), (number + 1) * rows - first)
            return
        for number in np.unique(index // rows).tolist():
            yield number, index // rows == number

    def _write_chunk(self) -> None:
        """Write the current chunk; do nothing if no record was added since."""
        if not self._chunk.fresh:
            return
        for chunk in self._chunks:
            chunk.flush()
        if len(self._chunk.unvouched) >= MOST_UNVOUCHED:
            self._vouch()

    def _vouch(self) -> None:
        """Write what says that the chunks written since the last time are there: checksums and marks of records."""
        if self._shot is None or not self._chunk.unvouched:
            return
        # The index of the chunks, before what says that there is something in them.
        self._file.flush()
        numbers = tuple(self._chunk.unvouched)
        for chunk in self._chunks:
            chunk.vouch()
        self._arrivals.put(self._shot.index, numbers, self._shot.recorded, self._shot.trigger_time_s)

    def _write_end(self) -> None:
        """Write when the run ended: by a clock that nobody sets meanwhile, from when it started."""
        if self._provenance is not None and self._provenance.started:
            lasted = timedelta(seconds=round(self._clock() - self._started_s))
            ended = datetime.fromisoformat(self._provenance.started) + lasted
            self._tables["provenance/ended"].put(None, ended.isoformat(timespec="seconds").encode("ascii"))

    def _end(self, status: str) -> None:
        """Write what is left and the status, and close the file; the library never learns of what fails here."""
        failure: StoreError | None = None
        try:
            if not self._broken:
                with self._committing(sync=True):
                    self._write_chunk()
                    self._vouch()
                    self._write_end()
                    self._file.flush()
        except StoreError as error:
            failure, status = error, "failed"
        try:
            self._file.close()
        except LIBRARY_ERRORS as error:
            # Of what it wrote in between nothing reaches the file, which is whole without it.
            failure, status = failure or self._cannot_be_written(error), "failed"
        try:
            if failure is None and not self._broken:
                with self._committing(sync=True):
                    pass
            self._journal.amend(self._endings[status])
            if failure is None and not self._broken:
                # The last look: whatever was done to the file until now is found here.
                with self._committing():
                    pass
        except (OSError, MemoryError, StoreError) as error:
            failure = failure or self._cannot_be_written(error)
            with contextlib.suppress(OSError, MemoryError):
                self._journal.amend(self._endings["failed"])
        with contextlib.suppress(OSError, MemoryError):
            self._journal.close()
        self._beside.shutdown()
        if failure is not None:
            raise failure

    def _refuse_other_volts(self, block: RecordBlock) -> None:
        expected = self._volts
        found = block.volts_per_code, block.volts_offset
        if not all(math.isclose(one, other, rel_tol=1e-9) for one, other in zip(found, expected, strict=True)):
            raise StoreError(
                f"the digitizer reports {block.volts_per_code:g} V per code, its range implies {expected[0]:g}: its "
                "input range is not the programmed one. Try: hpe-rig bench, then another acquisition.input_range_v."
            )

    @contextlib.contextmanager
    def _committing(self, always: bool = True, sync: bool = False, wait: bool = True) -> Iterator[None]:
        """Bring to the file what the block writes; unless ``always`` only where it wrote anything."""
        with self._writing():
            yield
        if always or self._journal.pending:
            self._commit(sync, wait)

    def _commit(self, sync: bool = False, wait: bool = True) -> None:
        # Signals are let through here: a disk that does not answer must not keep the outputs on.
        try:
            self._journal.commit(sync, wait)
        except (OSError, MemoryError) as error:
            self._broken = True
            raise self._cannot_be_written(error) from error
        except StoreError:
            self._broken = True
            raise
        self._looked_s = self._clock()

    @contextlib.contextmanager
    def _writing(self) -> Iterator[None]:
        """Hold signals back while the library works, which nothing may interrupt."""
        try:
            with uninterrupted():
                yield
        except LIBRARY_ERRORS as error:
            self._broken = True
            raise self._cannot_be_written(error) from error

    def _cannot_be_written(self, error: Exception) -> StoreError:
        if isinstance(error, StoreError):
            return error
        return StoreError(
            f"{self.path} cannot be written any further ({reason(error)}). What was written before is kept. "
            f"Try: make room or bring the folder back, then hpe-rig resume {self.path.name}."
        )


@final
class _Table:
    """Dataset of which each row, or the whole, is written at once, and its checksums."""

    def __init__(self, file: h5py.File, name: str) -> None:
        """Take dataset ``name``; one that a real bench has no use for is absent, and never written."""
        self._name = name
        self._values, self._sums = file.get(name), file.get(f"{GROUP}/{name}")

    @property
    def width(self) -> int:
        """Length of a row."""
        return int(self._values.shape[-1])

    def put(self, row: int | None, values: Any) -> None:
        """Write ``values`` as row ``row``, None for the whole, then their checksum."""
        place = () if row is None else (row,)
        self._values[place] = values
        self._values.flush()
        self._sums[place] = digest(self._name, place, stored_bytes(values, self._values.dtype))
        self._sums.flush()


@final
class _ChunkSums:
    """Checksums of a dataset by shot and chunk, ``count`` chunks a shot.

    They lie in one piece, at a place that never changes: they are written there and not by the library.
    """

    def __init__(self, file: h5py.File, name: str, journal: Journal) -> None:
        sums = file[f"{GROUP}/{name}"]
        self._start, self._journal, self.count = sums.id.get_offset(), journal, int(sums.shape[1])

    def put(self, shot: int, by_chunk: Mapping[int, int]) -> None:
        """Write the checksums of some chunks of ``shot``, by number."""
        for number, found in by_chunk.items():
            self._journal.put(self._start + 8 * (shot * self.count + number), found.to_bytes(8, "little"))


@final
class _Arrivals:
    """Marks and trigger times of the records, written chunk by chunk of the echoes, and their checksums."""

    def __init__(self, file: h5py.File, rows: int, sums: _ChunkSums) -> None:
        self._recorded, self._time_s = file["records/recorded"], file["records/trigger_time_s"]
        self._sums, self._rows = sums, rows
        self.count = sums.count

    def put(self, shot: int, numbers: Sequence[int], recorded: BoolArray, time_s: FloatArray) -> None:
        """Write those of the chunks ``numbers`` out of the shot's, each (pulse,)."""
        pieces = [slice(number * self._rows, (number + 1) * self._rows) for number in numbers]
        times_s = [np.ascontiguousarray(time_s[rows], self._time_s.dtype) for rows in pieces]
        marks = [np.ascontiguousarray(recorded[rows], self._recorded.dtype) for rows in pieces]
        found = {
            number: digest("records/recorded", (shot, number), of_records.tobytes(), of_times.tobytes())
            for number, of_records, of_times in zip(numbers, marks, times_s, strict=True)
        }
        first = [rows.start for rows in pieces]
        _put_rows(self._time_s, shot, first, times_s)
        _put_rows(self._recorded, shot, first, marks)
        self._sums.put(shot, found)


def _put_rows(dataset: h5py.Dataset, shot: int, first: Sequence[int], pieces: Sequence[NDArray[Any]]) -> None:
    """Write each of ``pieces`` (place,), of the dataset's own type, from its ``first`` place on, and hand them over.

    Through the library's own interface: to find out what an index means takes h5py ten times as long as writing it.
    """
    if all(start + values.size == after for start, values, after in zip(first, pieces, first[1:], strict=False)):
        first, pieces = first[:1], [np.concatenate(pieces)]
    there = dataset.id.get_space()
    for start, values in zip(first, pieces, strict=True):
        there.select_hyperslab((shot, start), (1, values.size))
        dataset.id.write(h5s.create_simple((values.size,)), there, values)
    dataset.id.flush()


@final
class _Chunk:
    """Chunk of echoes being filled; ``place`` is its (shot, number), None before the first.

    ``fresh`` is True while it holds records that the file does not. A chunk stays in memory after it is written, so
    that a late record only means writing it once more. ``unvouched``: the checksums to come, by number, of the chunks
    of one shot that were written since ``vouch``; what they are of stays in memory until then.
    """

    def __init__(self, file: h5py.File, name: str, sums: _ChunkSums, beside: Executor) -> None:
        self._name, self.short_name, self._beside = name, name.rpartition("/")[2], beside
        self._echo = echo = file[name]
        self._sums = sums
        self._plain = echo.id.get_create_plist().get_nfilters() == 0
        self.rows: int = echo.chunks[1]
        self._codes = np.empty(echo.chunks[1:], "<i2")
        self._filled = np.zeros(self.rows, bool)
        self._spare, self._lent = list[Int16Array](), list[Int16Array]()
        self.place: tuple[int, int] | None = None
        self.fresh = False
        self.unvouched: dict[int, Future[int]] = {}

    def begin(self, shot: int, number: int) -> None:
        """Start another chunk, all records missing."""
        if self.unvouched:
            self._lent.append(self._codes)
            self._codes = self._spare.pop() if self._spare else np.empty_like(self._codes)
        self._filled[:] = False
        self.place = (shot, number)

    def recall(self, recorded: BoolArray) -> None:
        """Take in again which records of the chunk the file holds, (pulse,): one comes late, behind those of others."""
        if self.place is None or not recorded.any():
            return
        shot, number = self.place
        first = number * self.rows
        self._codes[: recorded.size] = self._echo[shot, first : first + recorded.size]
        self._filled[: recorded.size] = recorded

    def put(self, rows: Int64Array, codes: Int16Array) -> None:
        """Put ``codes`` (row, sample) into the rows ``rows``."""
        # As a slice, as nearly always, they take half the time.
        here = slice(rows[0], rows[-1] + 1) if bool(np.all(np.diff(rows) == 1)) else rows
        self._codes[here] = codes
        self._filled[here] = True
        self.fresh = True

    def write(self, shot: int, first: int, codes: Int16Array) -> None:
        """Write whole ``codes`` (pulse, sample) from pulse ``first`` on, a multiple of the chunk's rows."""
        self.begin(shot, first // self.rows)
        self.put(np.arange(codes.shape[0]), codes)
        self.flush()

    def flush(self) -> None:
        """Write the chunk to the file; it stays in memory."""
        if self.place is None:
            return
        shot, number = self.place
        first = number * self.rows
        if not self._filled.all():
            self._codes[~self._filled] = MISSING
        if self._plain:
            found = self._beside.submit(digest, self._name, self.place, self._codes.data)
            # Bypasses the library's cache, which would only copy.
            self._echo.id.write_direct_chunk((shot, first, 0), self._codes)
        else:
            rows = min(self.rows, self._echo.shape[1] - first)
            self._echo[shot, first : first + rows] = self._codes[:rows]
            self._echo.flush()
            _, stored = self._echo.id.read_direct_chunk((shot, first, 0))
            found = self._beside.submit(digest, self._name, self.place, stored)
        self.unvouched[number] = found
        self.fresh = False

    def vouch(self) -> None:
        """Write the checksums of the chunks written since the last time."""
        if self.place is None:
            return
        self._sums.put(self.place[0], {number: found.result() for number, found in self.unvouched.items()})
        self._spare += self._lent
        self.unvouched, self._lent = {}, []


@final
class _ShotRows:
    """Marks and times of the records of the current shot, and where the latest of them was placed."""

    def __init__(self, shot: Shot) -> None:
        self.index = shot.index
        self.latest: Placed | None = None
        self.recorded = np.zeros(shot.capture.record_count, bool)
        self.trigger_time_s = np.full(shot.capture.record_count, np.nan)


def _refuse_small_disk(path: Path, needed: int) -> None:
    """Raise ``StoreError`` where the disk of ``path`` has less than ``needed`` bytes free."""
    try:
        free = shutil.disk_usage(path.parent).free
    except OSError:
        # Whatever is wrong with the folder is reported when the file is created.
        return
    if free < needed:
        raise StoreError(
            f"{path}: the run needs {needed / 1e6:.6g} MB, the disk has {free / 1e6:.6g} MB free. "
            "Try: another folder with --output, --compress, or fewer repeats."
        )


def _begun(image: bytes, path: Path, overwrite: bool, record_bytes: int) -> Journal:
    """Create ``path`` with the bytes ``image``, whole or not at all, and return its journal.

    Raises ``StoreError`` where it cannot be. Outputs may be on: a disk that does not answer keeps nobody waiting who
    interrupts the run, and what was to be replaced stays.
    """

    def make(given_up: threading.Event) -> Journal:
        _refuse_small_disk(path, len(image) + record_bytes)
        if overwrite and path.exists():
            refuse_to_replace(path)
        with atomic_file(path, overwrite) as draft:
            with draft.open("xb") as file:
                file.write(image)
                file.flush()
                os.fsync(file.fileno())
            if given_up.is_set():
                raise InterruptedError
        return Journal(path)

    def undo(journal: Journal) -> None:
        # First: Windows removes no file that is open.
        journal.close()
        with contextlib.suppress(OSError):
            if not overwrite and journal.is_in_place():
                path.unlink()

    try:
        return in_time(make, undo)
    except FileExistsError:
        raise StoreError(f"{path} already exists. Try: another path, or --overwrite on the command line.") from None
    except OSError as error:
        raise StoreError(f"{path} cannot be created ({reason(error)}). Try: another folder.") from None


def refuse_to_replace(path: Path) -> None:
    """Raise ``StoreError`` where ``path`` is no run file, or that of a run that goes on."""
    try:
        read_run(path)
    except StoreError:
        raise StoreError(
            f"{path} exists and is not a readable run file of hpe-rig, so it is not replaced. Try: move it away."
        ) from None
    if is_taken(path):
        raise StoreError(f"{path} is being written by another run. Try: another path, or wait for its end.")


def open_on(journal: Journal) -> h5py.File:
    """Open the run file behind ``journal`` with the HDF5 library."""
    access = h5p.create(h5p.FILE_ACCESS)
    access.set_libver_bounds(*(h5f.LIBVER_V110 for _ in LIBVER))
    access.set_fileobj_driver(h5fd.fileobj_driver, journal)
    try:
        return h5py.File(h5f.open(os.fsencode(journal.path), h5f.ACC_RDWR, access))
    finally:
        # Left for the end of the program it would call into Python when that is gone.
        access.close()


def _endings(file: h5py.File, journal: Journal) -> Mapping[str, tuple[Write, ...]]:
    """Return of each status what the library would write for it: the file can then say it without the library.

    The attribute is of fixed size and has its place, so this works on a full disk too.
    """
    endings = {}
    for status in (*STATUSES[1:], STATUSES[0]):
        journal.take_pending()
        file.attrs.modify("status", np.bytes_(status))
        file.flush()
        endings[status] = tuple(write for write in journal.take_pending() if write[0])
    return endings
