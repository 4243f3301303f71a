"""Writer of a run file: records go to disk as they arrive, in whole chunks, while other programs may read.

The order of writing makes the file safe to read at any time, also after a crash: first a chunk of echoes, then the
marks in ``recorded`` that its records have arrived, then the checksums of both. So every mark with a matching checksum
is valid. A chunk is the piece of a dataset that HDF5 stores at once: the echoes of consecutive records.
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
from hpe_rig.arrays import BoolArray, FloatArray, Int16Array
from hpe_rig.bench import BenchText, uninterrupted
from hpe_rig.plan import Plan, Shot
from hpe_rig.result import Provenance
from hpe_rig.scene import SceneText
from hpe_rig.store.atomic import atomic_file, synchronise
from hpe_rig.store.checksum import AT_ONCE, BY_SHOT, GROUP, digest, stored_bytes
from hpe_rig.store.format import SNAPSHOT_BYTES, STAGES, STATUSES, UNTRUSTED_BYTES, StoreError, reason
from hpe_rig.store.journal import Journal, Write, make_or_undo
from hpe_rig.store.layout import LIBVER, TRUE_HARMONICS, Predecessor, empty_run, volts_of_codes
from hpe_rig.store.lock import is_locked
from hpe_rig.store.reader import StoredRun, read_run
from hpe_rig.store.records import MISSING

CHECKPOINT_S = 1.0
"""Interval between two syncs of the disk, checked at the end of each shot."""
MAX_CHUNKS_WITHOUT_CHECKSUM = 8
"""Maximum number of chunks that are written before their marks and checksums, if many arrive at once."""
CHECK_INTERVAL_S = 0.25
"""How often a run that writes nothing checks that its file still exists."""
LIBRARY_ERRORS = (OSError, RuntimeError, KeyError, MemoryError)
"""Errors of the HDF5 library; after any of them its further writes are unreliable."""


@dataclass(frozen=True, slots=True)
class WriteOptions:
    """Options of a run file; ``predecessor`` is the run that a resumed run continues.

    ``run_id``: identifier of the run, for programs that may request its stop. ``provenance``: time and place of the
    start; without it, equal simulated runs give files that are equal bit for bit.
    """

    compress: bool = False
    overwrite: bool = False
    predecessor: Predecessor = field(default_factory=Predecessor)
    run_id: str = ""
    provenance: Provenance | None = None


@final
class RunWriter:
    """Open run file: appends records as they arrive, and writes the status when closed.

    A context manager. The status becomes complete, failed (an exception) or aborted (Ctrl-C, SIGTERM).
    """

    def __init__(
        self,
        path: Path,
        scene: SceneText,
        bench: BenchText,
        plan: Plan,
        options: WriteOptions = WriteOptions(),
        clock: Callable[[], float] = time.monotonic,
        cancelled: threading.Event | None = None,
    ) -> None:
        """Create the run file ``path``, without records.

        As soon as ``cancelled`` is set, a disk that does not answer is not waited for any longer.
        Raises ``StoreError`` if it exists, cannot be written, or the disk has no room for the records.
        """
        self.path = path
        self._clock = clock
        self._checkpoint_s = self._checked_s = self._started_s = clock()
        self._provenance = options.provenance
        self._broken = False
        try:
            image = empty_run(
                scene, bench, plan, options.compress, options.predecessor, options.run_id, options.provenance
            )
            record_bytes = 0 if options.compress else plan.record_bytes
            self._journal = _new_file(image, path, options.overwrite, record_bytes, cancelled)
            try:
                with uninterrupted():
                    self._open(plan, bench)
            except BaseException:
                # An empty file would keep the status "running" for ever.
                with contextlib.suppress(OSError, MemoryError):
                    self._journal.close()
                self.remove()
                raise
        except LIBRARY_ERRORS as error:
            # An error of the library, or of Python if memory for a thread is missing.
            raise StoreError(f"{path} cannot be created ({reason(error)}). Try: again, with fewer programs.") from error

    def _open(self, plan: Plan, bench: BenchText) -> None:
        """Open the new file with the library and prepare its datasets for writing."""
        self._file = open_on(self._journal)
        self._endings = _endings(self._file, self._journal)
        if not self._journal.locked:
            logging.getLogger("hpe_rig").warning("%s: its disk has no locks. Let no other run write it.", self.path)
        self._volts = volts_of_codes(plan.shots[0].capture.input_range_v, bench.bench.digitizer.board_model.code_limits)
        self._tables = {name: _Table(self._file, name) for name in (*BY_SHOT, *AT_ONCE)}
        # A checksum takes as long as writing the chunk: both run at the same time, for two chunks at once.
        self._executor = ThreadPoolExecutor(2, thread_name_prefix="checksum")
        names = ["records/echo", *(["records/monitor"] if "records/monitor" in self._file else [])]
        self._chunks = [
            _Chunk(self._file, name, _ChunkSums(self._file, name, self._journal), self._executor) for name in names
        ]
        self._chunk = self._chunks[0]
        sums = _ChunkSums(self._file, "records/recorded", self._journal)
        self._arrivals = _Arrivals(self._file, self._chunk.rows, sums)
        self._shot_arrivals: _ShotArrivals | None = None

    def __enter__(self) -> RunWriter:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        """Write the remaining data and the status (complete, aborted or failed), and close the file."""
        failed = "failed" if kind is not None and issubclass(kind, Exception) else "aborted"
        if kind is not None and failed == "aborted":
            self._journal.shorten_timeout()
        try:
            with uninterrupted():
                self._end("complete" if kind is None else failed)
        except StoreError:
            # The exception that ended the run is the better message.
            if kind is None:
                raise

    def shorten_timeout(self) -> None:
        """Give a disk that does not answer less time, because the run was interrupted; for any thread."""
        self._journal.shorten_timeout()

    def check_file(self) -> None:
        """Raise ``StoreError`` if the run file was moved or replaced; it is checked once per ``CHECK_INTERVAL_S``."""
        if self._clock() - self._checked_s >= CHECK_INTERVAL_S:
            with self._committing():
                pass

    def remove(self) -> None:
        """Delete the closed file, unless the path names another file."""
        with contextlib.suppress(OSError):
            if self._journal.is_in_place():
                self.path.unlink()

    def write_settings(self, shot: Shot, settings: Mapping[str, Mapping[str, Any]]) -> None:
        """Write the settings read back for ``shot``, the force that they give, and the planned pulse onsets."""
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
        """Add the records of ``block``, in the order of arrival, to the chunks of the run file.

        Full chunks go to disk; the records of the last chunk stay in memory until a later call or ``finish`` writes it.
        """
        if not block.codes.size:
            return
        self._refuse_unplanned_volts_per_code(block)
        # The disk writes full chunks while the next records arrive; ``finish`` waits for it.
        with self._committing(only_if_written=True, wait_for_disk=False):
            arrivals = self._arrivals_of(shot)
            # Writes each chunk that these records fill, then the checksums of those chunks.
            self._add_records(arrivals, block)
            self._write_checksums()

    def write_clipped(self, shot: Shot, clipped: bool) -> None:
        """Write whether the input of the digitizer left its range during ``shot``."""
        with self._writing():
            self._tables["records/clipped"].put(shot.index, clipped)

    def write_untrusted(self, shot: Shot, why: str) -> None:
        """Write why the records of ``shot`` are untrusted."""
        with self._committing():
            self._tables["untrusted"].put(shot.index, why.encode("ascii", "replace")[:UNTRUSTED_BYTES])

    def write_changed_settings(self, shot: Shot, changes: str) -> None:
        """Write the differences between the settings before and after ``shot``."""
        with self._committing():
            self._tables["changed_settings"].put(shot.index, changes.encode("ascii", "replace")[:UNTRUSTED_BYTES])

    def write_conditions(self, shot: Shot, before: Sequence[float], after: Sequence[float]) -> None:
        """Write the conditions before and after ``shot``, each (condition,), NaN if not read."""
        with self._committing():
            self._tables["conditions/before"].put(shot.index, before)
            self._tables["conditions/after"].put(shot.index, after)

    def write_ground_truth(self, shot: Shot, displacement_m: FloatArray) -> None:
        """Write the true displacement at the focus at each record of ``shot``, (record,)."""
        recorded = np.zeros(0, bool) if self._shot_arrivals is None else self._shot_arrivals.recorded
        valid = np.flatnonzero(recorded)
        row_m = np.full(recorded.size, np.nan)
        row_m[valid] = displacement_m[: valid.size]
        if valid.size:
            with self._writing():
                self._tables["truth/displacement_m"].put(shot.index, row_m)

    def write_true_harmonics(self, shot: Shot, harmonics_m: FloatArray) -> None:
        """Write A cos(phase) and A sin(phase) of the true displacement at the wanted frequencies, (frequency, 2)."""
        with self._writing():
            for name, column_m in zip(TRUE_HARMONICS, harmonics_m.T, strict=True):
                table = self._tables[f"true_harmonics/{name}"]
                table.put(shot.index, np.concatenate([column_m, np.full(table.width - column_m.size, np.nan)]))

    def write_run_times(self, run_time_s: Mapping[str, float]) -> None:
        """Write the wall time of each stage so far."""
        with self._committing():
            self._tables["run_time/run_time_s"].put(None, [run_time_s.get(name, math.nan) for name in STAGES])

    def finish(self, shot: Shot) -> None:
        """Write the remaining data of ``shot``, then mark it complete; sync the disk once per ``CHECKPOINT_S``."""
        due = self._clock() - self._checkpoint_s >= CHECKPOINT_S
        with self._committing(sync=due):
            self._write_chunk()
            self._write_checksums()
            self._file.flush()
            self._tables["records/shot_complete"].put(shot.index, 1)
        if due:
            self._checkpoint_s = self._clock()

    def copy_shots(self, earlier: StoredRun, shots: int) -> None:
        """Copy the first ``shots`` shots of another run of the same plan into this file, to resume that run.

        Raises ``StoreError`` if one of them is damaged.
        """
        for shot in range(shots):
            rows = earlier.rows(shot)
            with self._committing():
                for chunk in self._chunks:
                    for start, codes in earlier.records.chunks(shot, chunk.rows, chunk.short_name):
                        chunk.write(shot, start, codes)
                        self._file.flush()
                        chunk.write_checksums()
                        self._commit()
                self._arrivals.put(shot, range(self._arrivals.count), rows.recorded, rows.trigger_time_s)
                for name, row in rows.tables.items():
                    self._tables[name].put(shot, row)
                self._file.flush()
                self._tables["records/shot_complete"].put(shot, 1)

    def _arrivals_of(self, shot: Shot) -> _ShotArrivals:
        """Return the arrival marks and trigger times of ``shot``, to which further records are added.

        For a new shot none has arrived; the remaining records of the previous shot are written first.
        """
        if self._shot_arrivals is None or self._shot_arrivals.shot != shot.index:
            self._write_chunk()
            self._write_checksums()
            self._shot_arrivals = _ShotArrivals(shot)
        return self._shot_arrivals

    def _add_records(self, arrivals: _ShotArrivals, block: RecordBlock) -> None:
        """Add the records of ``block`` to their chunks and to ``arrivals``; full chunks go to the file."""
        codes = (block.codes, *([] if block.monitor is None else [block.monitor.codes]))
        rows, first = self._chunk.rows, block.first_record
        last = first + block.codes.shape[0]
        # A block can span several chunks, and a delayed one can belong to an earlier chunk.
        for number in range(first // rows, -(-last // rows)):
            if (arrivals.shot, number) != self._chunk.shot_and_number:
                self._write_chunk()
                for chunk in self._chunks:
                    chunk.start(arrivals.shot, number)
                    chunk.reload(arrivals.recorded[number * rows : (number + 1) * rows])
            start, stop = max(first, number * rows), min(last, (number + 1) * rows)
            selection = slice(start - first, stop - first)
            for chunk, input_codes in zip(self._chunks, codes, strict=True):
                chunk.put(start - number * rows, input_codes[selection])
            arrivals.recorded[start:stop] = True
            arrivals.trigger_time_s[start:stop] = block.trigger_time_s[selection]
            if stop == (number + 1) * rows:
                self._write_chunk()

    def _write_chunk(self) -> None:
        """Write the current chunk of records to the file; do nothing if no record was added since the last time."""
        if not self._chunk.has_unwritten:
            return
        for chunk in self._chunks:
            chunk.flush()
        if len(self._chunk.pending_checksums) >= MAX_CHUNKS_WITHOUT_CHECKSUM:
            self._write_checksums()

    def _write_checksums(self) -> None:
        """Write checksums of the chunks written since the last call, and the marks that their records are present."""
        if self._shot_arrivals is None or not self._chunk.pending_checksums:
            return
        # The library's index of the chunks must be in the file before the marks.
        self._file.flush()
        numbers = tuple(self._chunk.pending_checksums)
        for chunk in self._chunks:
            chunk.write_checksums()
        arrivals = self._shot_arrivals
        self._arrivals.put(arrivals.shot, numbers, arrivals.recorded, arrivals.trigger_time_s)

    def _write_end(self) -> None:
        """Write the end time of the run: start plus duration by the monotonic clock, which is never adjusted."""
        if self._provenance is not None and self._provenance.started:
            duration = timedelta(seconds=round(self._clock() - self._started_s))
            ended = datetime.fromisoformat(self._provenance.started) + duration
            self._tables["provenance/ended"].put(None, ended.isoformat(timespec="seconds").encode("ascii"))

    def _end(self, status: str) -> None:
        """Write the remaining data and ``status``, and close the file.

        Every step is tried; the first error is raised at the end.
        """
        failure = self._write_remaining()
        try:
            self._file.close()
        except LIBRARY_ERRORS as error:
            # Later writes of the library do not reach the file, which is complete without them.
            failure = failure or self._cannot_be_written(error)
        failure = self._write_status(status, failure)
        with contextlib.suppress(OSError, MemoryError):
            self._journal.close()
        self._executor.shutdown()
        if failure is not None:
            raise failure

    def _write_remaining(self) -> StoreError | None:
        """Write the last chunk, its checksums and the end time; return the error, if any."""
        if self._broken:
            return None
        try:
            with self._committing(sync=True):
                self._write_chunk()
                self._write_checksums()
                self._write_end()
                self._file.flush()
        except StoreError as error:
            return error
        return None

    def _write_status(self, status: str, failure: StoreError | None) -> StoreError | None:
        """Write ``status``, or "failed" after a ``failure``, and return the first error.

        The bytes are written without the HDF5 library, which may have failed.
        """
        try:
            # An empty commit checks the file: before the status is written, and for the last time after it.
            if failure is None and not self._broken:
                self._commit(sync=True)
            self._journal.overwrite(self._endings[status if failure is None else "failed"])
            if failure is None and not self._broken:
                self._commit()
        except (OSError, MemoryError, StoreError) as error:
            failure = failure or self._cannot_be_written(error)
            with contextlib.suppress(OSError, MemoryError):
                self._journal.overwrite(self._endings["failed"])
        return failure

    def _refuse_unplanned_volts_per_code(self, block: RecordBlock) -> None:
        """Raise ``StoreError`` if the digitizer's conversion of codes to volts is not that of the planned range."""
        if not np.allclose((block.volts_per_code, block.volts_offset), self._volts, rtol=1e-9, atol=0):
            raise StoreError(
                f"the digitizer reports {block.volts_per_code:g} V per code, its range implies {self._volts[0]:g}: its "
                "input range is not the programmed one. Try: hpe-rig bench, then another acquisition.input_range_v."
            )

    @contextlib.contextmanager
    def _committing(
        self, only_if_written: bool = False, sync: bool = False, wait_for_disk: bool = True
    ) -> Iterator[None]:
        """Commit the writes of the ``with`` block to the disk when it ends.

        An empty commit checks that the file is in place; with ``only_if_written`` it is left out. ``sync`` flushes the
        disk too. Without ``wait_for_disk`` the commit is only started.
        """
        with self._writing():
            yield
        if self._journal.pending or not only_if_written:
            self._commit(sync, wait_for_disk)

    def _commit(self, sync: bool = False, wait_for_disk: bool = True) -> None:
        """Commit the changes to the file; raise ``StoreError`` and refuse further writes if that fails."""
        # Signals may interrupt this: a disk that does not respond must not keep the outputs on.
        try:
            self._journal.commit(sync, wait_for_disk)
        except (OSError, MemoryError) as error:
            self._broken = True
            raise self._cannot_be_written(error) from error
        except StoreError:
            self._broken = True
            raise
        self._checked_s = self._clock()

    @contextlib.contextmanager
    def _writing(self) -> Iterator[None]:
        """Delay signals while the HDF5 library works in the block: an interrupt would corrupt its state."""
        try:
            with uninterrupted():
                yield
        except LIBRARY_ERRORS as error:
            self._broken = True
            raise self._cannot_be_written(error) from error

    def _cannot_be_written(self, error: Exception) -> StoreError:
        """Return the error that the run file cannot be written any further, with its cause and the remedy."""
        if isinstance(error, StoreError):
            return error
        return StoreError(
            f"{self.path} cannot be written any further ({reason(error)}). What was written before is kept. "
            f"Try: make room or bring the folder back, then hpe-rig resume {self.path.name}."
        )


@final
class _Table:
    """Dataset with checksums that is written row by row or as a whole."""

    def __init__(self, file: h5py.File, name: str) -> None:
        """Use dataset ``name``; it may be absent if it is never written, as the ground truth on a real bench."""
        self._name = name
        self._values, self._sums = file.get(name), file.get(f"{GROUP}/{name}")

    @property
    def width(self) -> int:
        """Length of a row."""
        return int(self._values.shape[-1])

    def put(self, row: int | None, values: Any) -> None:
        """Write ``values`` as row ``row`` (None: the whole dataset), then their checksum."""
        index = () if row is None else (row,)
        self._values[index] = values
        self._values.flush()
        self._sums[index] = digest(self._name, index, stored_bytes(values, self._values.dtype))
        self._sums.flush()


@final
class _ChunkSums:
    """Checksums of a dataset by shot and chunk, ``count`` chunks per shot.

    The journal writes them and not the library: their dataset is contiguous and its offset never changes.
    """

    def __init__(self, file: h5py.File, name: str, journal: Journal) -> None:
        """Find the checksums of the chunks of dataset ``name`` in the file; they are written through ``journal``."""
        sums = file[f"{GROUP}/{name}"]
        self._start, self._journal, self.count = sums.id.get_offset(), journal, int(sums.shape[1])

    def put(self, shot: int, by_chunk: Mapping[int, int]) -> None:
        """Write the checksums of chunks of ``shot``, by number."""
        for number, checksum in by_chunk.items():
            self._journal.put(self._start + 8 * (shot * self.count + number), checksum.to_bytes(8, "little"))


@final
class _Arrivals:
    """Datasets of arrival marks and trigger times, written for each chunk of echoes, with their checksums."""

    def __init__(self, file: h5py.File, rows: int, sums: _ChunkSums) -> None:
        """Open the marks and trigger times of the records; ``rows`` is the number of records in a chunk."""
        self._recorded, self._time_s = file["records/recorded"], file["records/trigger_time_s"]
        self._sums, self._rows = sums, rows
        self.count = sums.count

    def put(self, shot: int, numbers: Sequence[int], recorded: BoolArray, time_s: FloatArray) -> None:
        """Write the marks and trigger times of the records in chunks ``numbers`` of a shot, then their checksums.

        ``recorded`` and ``time_s`` (pulse,): those of the whole shot.
        """
        chunks = [slice(number * self._rows, (number + 1) * self._rows) for number in numbers]
        times_s = [np.ascontiguousarray(time_s[rows], self._time_s.dtype) for rows in chunks]
        marks = [np.ascontiguousarray(recorded[rows], self._recorded.dtype) for rows in chunks]
        checksums = {
            number: digest("records/recorded", (shot, number), chunk_marks.tobytes(), chunk_times.tobytes())
            for number, chunk_marks, chunk_times in zip(numbers, marks, times_s, strict=True)
        }
        starts = [rows.start for rows in chunks]
        _write_slices(self._time_s, shot, starts, times_s)
        _write_slices(self._recorded, shot, starts, marks)
        self._sums.put(shot, checksums)


def _write_slices(dataset: h5py.Dataset, shot: int, starts: Sequence[int], slices: Sequence[NDArray[Any]]) -> None:
    """Write each of ``slices`` (pulse,) into the row ``shot`` of ``dataset``, from its start in ``starts``, and flush.

    Uses the library's low-level interface: h5py takes ten times as long to interpret an index as to write.
    """
    # Adjacent slices are written in one call.
    if all(start + values.size == end for start, values, end in zip(starts, slices, starts[1:], strict=False)):
        starts, slices = starts[:1], [np.concatenate(slices)]
    selection = dataset.id.get_space()
    for start, values in zip(starts, slices, strict=True):
        selection.select_hyperslab((shot, start), (1, values.size))
        dataset.id.write(h5s.create_simple((values.size,)), selection, values)
    dataset.id.flush()


@final
class _Chunk:
    """Chunk of echoes being filled; its ``shot_and_number`` is None before the first.

    ``has_unwritten``: whether it has records that the file does not have. A chunk stays in memory after it is written,
    so that a delayed record only requires writing it again. ``pending_checksums``: by number, of the chunks of one shot
    written since ``write_checksums``, computed in threads; their codes stay in memory until then.
    """

    def __init__(self, file: h5py.File, name: str, sums: _ChunkSums, executor: Executor) -> None:
        """Prepare the current chunk of dataset ``name``: records are collected in it and written at once."""
        self._name, self.short_name, self._executor = name, name.rpartition("/")[2], executor
        self._echo = echo = file[name]
        self._sums = sums
        self._uncompressed = echo.id.get_create_plist().get_nfilters() == 0
        self.rows: int = echo.chunks[1]
        self._codes = np.empty(echo.chunks[1:], "<i2")
        self._filled = np.zeros(self.rows, bool)
        self._spare_buffers, self._buffers_in_use = list[Int16Array](), list[Int16Array]()
        self.shot_and_number: tuple[int, int] | None = None
        self.has_unwritten = False
        self.pending_checksums: dict[int, Future[int]] = {}

    def start(self, shot: int, number: int) -> None:
        """Start chunk ``number`` of ``shot`` with all records missing."""
        # The checksum of the previous chunk may still be computed from its buffer: another buffer is used.
        if self.pending_checksums:
            self._buffers_in_use.append(self._codes)
            self._codes = self._spare_buffers.pop() if self._spare_buffers else np.empty_like(self._codes)
        self._filled[:] = False
        self.shot_and_number = (shot, number)

    def reload(self, recorded: BoolArray) -> None:
        """Read the ``recorded`` (pulse,) records of the current chunk from the file, to add a delayed one."""
        if self.shot_and_number is None or not recorded.any():
            return
        shot, number = self.shot_and_number
        first = number * self.rows
        self._codes[: recorded.size] = self._echo[shot, first : first + recorded.size]
        self._filled[: recorded.size] = recorded

    def put(self, first: int, codes: Int16Array) -> None:
        """Put ``codes`` (record, sample) into the rows of the current chunk from ``first`` on, in memory."""
        rows = slice(first, first + codes.shape[0])
        self._codes[rows] = codes
        self._filled[rows] = True
        self.has_unwritten = True

    def write(self, shot: int, first: int, codes: Int16Array) -> None:
        """Write ``codes`` (pulse, sample), a whole chunk that starts at pulse ``first``, to the file."""
        self.start(shot, first // self.rows)
        self.put(0, codes)
        self.flush()

    def flush(self) -> None:
        """Write the current chunk to the file and start the computation of its checksum; it stays in memory."""
        if self.shot_and_number is None:
            return
        shot, number = self.shot_and_number
        first = number * self.rows
        if not self._filled.all():
            self._codes[~self._filled] = MISSING
        if self._uncompressed:
            checksum = self._executor.submit(digest, self._name, self.shot_and_number, self._codes.data)
            # Bypasses the library's cache, which would only copy.
            self._echo.id.write_direct_chunk((shot, first, 0), self._codes)
        else:
            rows = min(self.rows, self._echo.shape[1] - first)
            self._echo[shot, first : first + rows] = self._codes[:rows]
            self._echo.flush()
            _, stored = self._echo.id.read_direct_chunk((shot, first, 0))
            checksum = self._executor.submit(digest, self._name, self.shot_and_number, stored)
        self.pending_checksums[number] = checksum
        self.has_unwritten = False

    def write_checksums(self) -> None:
        """Wait for the checksums of the chunks written since the last call, and write them."""
        if self.shot_and_number is None:
            return
        self._sums.put(
            self.shot_and_number[0], {number: checksum.result() for number, checksum in self.pending_checksums.items()}
        )
        self._spare_buffers += self._buffers_in_use
        self.pending_checksums, self._buffers_in_use = {}, []


@final
class _ShotArrivals:
    """Marks that the records of the current shot have arrived, and their trigger times, both (record,)."""

    def __init__(self, shot: Shot) -> None:
        """Start a shot: no record has arrived."""
        self.shot = shot.index
        self.recorded = np.zeros(shot.capture.record_count, bool)
        self.trigger_time_s = np.full(shot.capture.record_count, np.nan)


def _refuse_small_disk(path: Path, needed: int) -> None:
    """Raise ``StoreError`` if the disk of ``path`` has less than ``needed`` bytes free."""
    try:
        free = shutil.disk_usage(path.parent).free
    except OSError:
        # An error of the folder is reported when the file is created.
        return
    if free < needed:
        raise StoreError(
            f"{path}: the run needs {needed / 1e6:.6g} MB, the disk has {free / 1e6:.6g} MB free. "
            "Try: another folder with --output, --compress, or fewer repeats."
        )


def _new_file(
    image: bytes, path: Path, overwrite: bool, record_bytes: int, cancelled: threading.Event | None
) -> Journal:
    """Create ``path`` atomically with the bytes ``image`` and return its journal; raise ``StoreError``.

    Outputs may be on, so an interrupt ends the wait for a disk that does not respond; an existing file stays then.
    """

    def make(cancelled: threading.Event) -> Journal:
        """Create the file and return its journal; raise ``InterruptedError`` if ``cancelled`` is set meanwhile."""
        _refuse_small_disk(path, len(image) + record_bytes)
        if overwrite and path.exists():
            refuse_to_replace(path)
        with atomic_file(path, overwrite) as file:
            file.write(image)
            synchronise(file)
            if cancelled.is_set():
                raise InterruptedError
        return Journal(path)

    def undo(journal: Journal) -> None:
        """Close and delete a new file that is no longer wanted."""
        # Closed first: Windows deletes no open file.
        journal.close()
        with contextlib.suppress(OSError):
            if not overwrite and journal.is_in_place():
                path.unlink()

    try:
        return make_or_undo(make, undo, cancelled)
    except FileExistsError:
        raise StoreError(f"{path} already exists. Try: another path, or --overwrite on the command line.") from None
    except OSError as error:
        raise StoreError(f"{path} cannot be created ({reason(error)}). Try: another folder.") from None


def refuse_to_replace(path: Path) -> None:
    """Raise ``StoreError`` unless ``path`` is a run file that no run is writing, so that it may be replaced."""
    try:
        read_run(path)
    except StoreError:
        raise StoreError(
            f"{path} exists and is not a readable run file of hpe-rig, so it is not replaced. Try: move it away."
        ) from None
    if is_locked(path):
        raise StoreError(f"{path} is being written by another run. Try: another path, or wait for its end.")


def open_on(journal: Journal) -> h5py.File:
    """Return the run file of ``journal``, opened with the HDF5 library; all its writes go through the journal."""
    access = h5p.create(h5p.FILE_ACCESS)
    access.set_libver_bounds(*(h5f.LIBVER_V110 for _ in LIBVER))
    access.set_fileobj_driver(h5fd.fileobj_driver, journal)
    try:
        return h5py.File(h5f.open(os.fsencode(journal.path), h5f.ACC_RDWR, access))
    finally:
        # Closed when the program ends, it would call into Python after Python has ended.
        access.close()


def _endings(file: h5py.File, journal: Journal) -> Mapping[str, tuple[Write, ...]]:
    """Return, for each status of a run, the bytes that the HDF5 library would write to the file to store it.

    The journal can then write the status without the library, also on a full disk: its size and offset are fixed.
    """
    endings = {}
    # The last one, "running", stays in the file.
    for status in (*STATUSES[1:], STATUSES[0]):
        journal.pop_pending()
        file.attrs.modify("status", np.bytes_(status))
        file.flush()
        endings[status] = tuple(write for write in journal.pop_pending() if write[0])
    return endings
