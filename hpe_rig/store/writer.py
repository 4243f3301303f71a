"""Writer of a run: records are appended to a log as they arrive; at the end the run file is made from it.

Frames of the log (``log.py``) are whole or cut off at its end, so that a crash or a full disk never harms earlier ones.
The disk is synchronised after each shot.
"""

from __future__ import annotations

import contextlib
import json
import logging
import math
import shutil
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any, final

import numpy as np

from drivers.interfaces import RecordBlock
from hpe_rig.arrays import FloatArray, Int16Array
from hpe_rig.bench import BenchText, interruptible, uninterrupted
from hpe_rig.plan import Plan, Shot
from hpe_rig.result import Provenance
from hpe_rig.scene import SceneText
from hpe_rig.store.assembly import DamagedLogError, assemble
from hpe_rig.store.atomic import atomic_file, refuse_unwritable, synchronise
from hpe_rig.store.damage import ranges
from hpe_rig.store.datasets import DATASETS, TRUE_HARMONICS
from hpe_rig.store.foreign_hdf5 import InvalidContentError
from hpe_rig.store.format import SNAPSHOT_BYTES, STAGES, StoreError, reason
from hpe_rig.store.layout import Predecessor, chunk_records, code_scale_and_offset_v, empty_run
from hpe_rig.store.lock import is_locked
from hpe_rig.store.log import CODES, SHOT_COMPLETE, STATUS, TRIGGER_TIMES, LogWriter, new_log
from hpe_rig.store.reader import StoredRun, read_run
from hpe_rig.store.task import make_or_undo

CHECK_INTERVAL_S = 0.25
"""How often a run that writes nothing checks that its file still exists."""
COPIES_OF_RECORDS = 2
"""At the end of a run the disk holds its log and its run file."""


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
    """Log of a run: appends records as they arrive; replaced by the run file when it is closed.

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
        """Create the log at ``path``, without records. When it is closed, a run file made from it replaces it.

        Another thread may set ``cancelled`` to end the program soon, for example if a disk does not answer. Creating
        the log then raises ``StoreError`` instead of waiting. Closing it leaves the log at ``path`` as it is, and a
        later command can make the run file. Raises ``StoreError`` too if ``path`` exists, cannot be written, or the
        disk has no room for the records.
        """
        self.path = path
        self.progress = 0
        """Number of steps so far; a thread that waits for a long one sees that the disk answers."""
        self._clock, self._cancelled = clock, cancelled or threading.Event()
        self._checked_s = self._started_s = clock()
        self._provenance = options.provenance
        capture = plan.shots[0].capture
        self._scale_and_offset_v = code_scale_and_offset_v(
            capture.input_range_v, bench.bench.digitizer.board_model.code_limits
        )
        self._chunk_records = chunk_records(capture)
        self._inputs = ("echo",) if capture.monitor_range_v is None else ("echo", "monitor")
        self._frequencies = max(len(point.scene.wanted_frequencies_hz) for point in scene.scene.points)
        self._recorded = np.zeros(0, bool)
        self._shot = -1
        self._is_broken = False
        try:
            run_file = empty_run(
                scene, bench, plan, options.compress, options.predecessor, options.run_id, options.provenance
            )
            record_bytes = 0 if options.compress else plan.record_bytes
            self._log = _new_log(run_file, path, options.overwrite, COPIES_OF_RECORDS * record_bytes, self._cancelled)
        except (OSError, RuntimeError, MemoryError) as error:
            # An error of the library, or of Python if memory for a thread is missing.
            raise StoreError(f"{path} cannot be created ({reason(error)}). Try: again, with fewer programs.") from error
        if not self._log.has_lock:
            logging.getLogger("hpe_rig").warning("%s: its disk has no locks. Let no other run write it.", path)

    def __enter__(self) -> RunWriter:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        """Write the status (complete, aborted or failed) to the log, and replace the log by a run file made from it."""
        failed = "failed" if kind is not None and issubclass(kind, Exception) else "aborted"
        try:
            with uninterrupted():
                self._end("complete" if kind is None else failed)
        except StoreError:
            # The exception that ended the run is the better message.
            if kind is None:
                raise

    def check_file(self) -> None:
        """Raise ``StoreError`` if the log was moved or replaced; it is checked once per ``CHECK_INTERVAL_S``."""
        if self._clock() - self._checked_s >= CHECK_INTERVAL_S:
            with self._writing():
                self._log.refuse_another_file()

    def remove(self) -> None:
        """Delete the closed file, unless the path names another file."""
        with contextlib.suppress(OSError):
            if self._log.is_in_place():
                self.path.unlink()

    def write_settings(self, shot: Shot, settings: Mapping[str, Mapping[str, Any]]) -> None:
        """Write the settings read back for ``shot``, the force that they give, and the planned pulse onsets."""
        text = json.dumps(settings, sort_keys=True, separators=(",", ":"))
        if len(text) > SNAPSHOT_BYTES:
            raise StoreError(
                f"the settings of shot {shot.index + 1} take {len(text)} bytes, a run file has room for "
                f"{SNAPSHOT_BYTES}. Try: report this with the bench file."
            )
        self.write_rows(shot, {"snapshot": text, "records/pulse_onset_s": shot.timeline.pulse_onset_s})
        if (amplitude_vpp := settings.get("toneburst", {}).get("amplitude_vpp")) is not None:
            self.write_rows(shot, {"records/force_set": shot.force_fraction_at(amplitude_vpp)})

    def write_rows(self, shot: Shot, rows: Mapping[str, Any]) -> None:
        """Write the rows of ``shot``, numbers or a text, by dataset of the table ``DATASETS``."""
        for name, values in rows.items():
            self._put(name, shot.index, _encoded(name, values))

    def append(self, shot: Shot, block: RecordBlock) -> None:
        """Append the records of ``block``, in the order of arrival."""
        if not block.codes.size:
            return
        self._refuse_unplanned_volts_per_code(block)
        if shot.index != self._shot:
            self._shot, self._recorded = shot.index, np.zeros(shot.capture.record_count, bool)
        codes = [block.codes, *([] if block.monitor is None else [block.monitor.codes])]
        self._append_records(shot.index, block.first_record, codes, block.trigger_time_s)
        self._recorded[block.first_record : block.first_record + block.codes.shape[0]] = True

    def write_ground_truth(self, shot: Shot, displacement_m: FloatArray) -> None:
        """Write the true displacement at the focus at each record of ``shot``, (record,)."""
        # A shot without any record has no row: the marks are still those of the shot before.
        valid = np.flatnonzero(self._recorded) if shot.index == self._shot else np.zeros(0, int)
        row_m = np.full(self._recorded.size, np.nan)
        row_m[valid] = displacement_m[: valid.size]
        if valid.size:
            self.write_rows(shot, {"truth/displacement_m": row_m})

    def write_true_harmonics(self, shot: Shot, harmonics_m: FloatArray) -> None:
        """Write A cos(phase) and A sin(phase) of the true displacement at the wanted frequencies, (frequency, 2)."""
        for name, column_m in zip(TRUE_HARMONICS, harmonics_m.T, strict=True):
            missing = np.full(self._frequencies - column_m.size, np.nan)
            self.write_rows(shot, {name: np.concatenate([column_m, missing])})

    def write_run_times(self, run_time_s: Mapping[str, float]) -> None:
        """Write the wall time of each stage so far."""
        name = "run_time/run_time_s"
        self._put(name, -1, _encoded(name, [run_time_s.get(stage, math.nan) for stage in STAGES]))

    def finish(self, shot: Shot) -> None:
        """Mark ``shot`` complete and wait until the disk has stored it."""
        self._put(SHOT_COMPLETE, shot.index, b"\x01", sync=True)

    def copy_shot(self, earlier: StoredRun, shot: int) -> None:
        """Copy ``shot`` of another run of the same plan into this one; raise ``StoreError`` if it is damaged."""
        arrival = earlier.records.arrival(shot)
        inputs = [earlier.records.chunks(shot, self._chunk_records, name) for name in self._inputs]
        for blocks in zip(*inputs, strict=True):
            first, codes = blocks[0]
            # The records of a chunk that arrived, in series of consecutive ones.
            for start, stop in ranges(arrival.recorded[first : first + codes.shape[0]]):
                series, last = slice(start, stop + 1), first + stop + 1
                time_s = arrival.trigger_time_s[first + start : last]
                self._append_records(shot, first + start, [codes[series] for _, codes in blocks], time_s)
        for name, row in earlier.rows(shot).items():
            self._put(name, shot, np.asarray(row).tobytes())
        self._put(SHOT_COMPLETE, shot, b"\x01", sync=True)

    def _append_records(
        self, shot: int, first_record: int, codes: Sequence[Int16Array], trigger_time_s: FloatArray
    ) -> None:
        """Append consecutive records: their ``codes`` at each input (record, sample), then their trigger times.

        A frame holds records of one chunk of the run file.
        """
        first, last = first_record, first_record + codes[0].shape[0]
        with self._writing():
            while first < last:
                number = first // self._chunk_records
                stop = min(last, (number + 1) * self._chunk_records)
                rows = slice(first - first_record, stop - first_record)
                for name, values in zip(CODES, codes, strict=False):
                    self._log.append(name, shot, np.ascontiguousarray(values[rows], "<i2").data, (shot, number), first)
                times = _encoded(TRIGGER_TIMES, trigger_time_s[rows])
                self._log.append(TRIGGER_TIMES, shot, times, (shot, number), first)
                first = stop

    def _put(self, name: str, shot: int, row: bytes, sync: bool = False) -> None:
        """Append to the log the bytes of dataset ``name`` in row ``shot``, or of the whole dataset if ``shot`` is -1.

        With ``sync``, wait until the disk has stored them.
        """
        with self._writing():
            self._log.append(name, shot, row, () if shot < 0 else (shot,))
            if sync:
                self._log.sync()

    def _end(self, status: str) -> None:
        """Write the end of the run and ``status``, and replace the log by the run file; raise the first error."""
        failure = None
        try:
            if not self._is_broken:
                self._write_end(status)
        except StoreError as error:
            failure = error
        try:
            # A write has failed and may have left part of a frame at the end of the log, which is cut off.
            if self._is_broken:
                self._log.cut_back()
                self._is_broken = False
                self._put(STATUS, -1, b"failed", sync=True)
            self._assemble()
        except (StoreError, OSError, MemoryError) as error:
            failure = failure or self._cannot_be_written(error)
        finally:
            with contextlib.suppress(OSError):
                self._log.close()
        if failure is not None:
            raise failure

    def _write_end(self, status: str) -> None:
        """Write the end time of the run and ``status``."""
        if self._provenance is not None and self._provenance.started:
            # Start plus duration by the monotonic clock, which is never adjusted.
            duration = timedelta(seconds=round(self._clock() - self._started_s))
            ended = (datetime.fromisoformat(self._provenance.started) + duration).isoformat(timespec="seconds")
            self._put("provenance/ended", -1, _encoded("provenance/ended", ended))
        self._put(STATUS, -1, status.encode("ascii"), sync=True)

    def _assemble(self) -> None:
        """Make a run file of the log and replace it; leave the log as it is and raise ``StoreError`` if that fails."""
        try:
            assemble(self.path, self._log.close, self._proceed, self._cancelled)
            self._log.moved_to(self.path)
        except (OSError, MemoryError, RuntimeError, DamagedLogError, InvalidContentError) as error:
            why = "its records were read back with errors" if isinstance(error, DamagedLogError) else reason(error)
            raise StoreError(
                f"{self.path} holds the run as it was recorded, but cannot be made an HDF5 file ({why}). "
                f"Try: make room there, then hpe-rig process {self.path.name}."
            ) from error

    def _proceed(self) -> None:
        """Count a step of the assembly of the run file, and raise if the program shall end."""
        self.progress += 1
        if self._cancelled.is_set():
            raise InterruptedError
        with interruptible():
            # Raises a signal that has arrived since the last step.
            pass

    def _refuse_unplanned_volts_per_code(self, block: RecordBlock) -> None:
        """Raise ``StoreError`` if the digitizer's conversion of codes to volts is not that of the planned range."""
        planned = self._scale_and_offset_v
        if not np.allclose((block.volts_per_code, block.volts_offset), planned, rtol=1e-9, atol=0):
            raise StoreError(
                f"the digitizer reports {block.volts_per_code:g} V per code, its range implies {planned[0]:g}: its "
                "input range is not the programmed one. Try: hpe-rig bench, then another acquisition.input_range_v."
            )

    @contextlib.contextmanager
    def _writing(self) -> Iterator[None]:
        """Delay signals in the block, which would leave half a frame; after an error refuse all further writes."""
        if self._is_broken:
            raise StoreError(f"{self.path} is not written any further after an error.")
        try:
            with uninterrupted():
                yield
        except (OSError, MemoryError, StoreError) as error:
            self._is_broken = True
            raise self._cannot_be_written(error) from error
        self.progress += 1
        self._checked_s = self._clock()

    def _cannot_be_written(self, error: Exception) -> StoreError:
        """Return the error that the run cannot be written any further, with its cause and the remedy."""
        if isinstance(error, StoreError):
            return error
        return StoreError(
            f"{self.path} cannot be written any further ({reason(error)}). What was written before is kept. "
            f"Try: make room or bring the folder back, then hpe-rig resume {self.path.name}."
        )


def _encoded(name: str, values: Any) -> bytes:
    """Return the bytes of ``values`` in dataset ``name``: a text as ASCII, cut to its length, or numbers."""
    dtype = np.dtype(DATASETS[name].dtype)
    if dtype.kind == "S":
        encoded: bytes = values.encode("ascii", "replace")
        return encoded[: dtype.itemsize].ljust(dtype.itemsize, b"\0")
    return np.ascontiguousarray(values, dtype).tobytes()


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


def _new_log(run_file: bytes, path: Path, overwrite: bool, record_bytes: int, cancelled: threading.Event) -> LogWriter:
    """Create the log ``path`` with the bytes of an empty ``run_file``; raise ``StoreError`` if that is impossible.

    Outputs may be on, so an interrupt ends the wait for a disk that does not respond; an existing file stays then.
    """

    def make(cancelled: threading.Event) -> LogWriter:
        """Create the log, locked by its ``LogWriter``; raise ``InterruptedError`` if ``cancelled`` is set meanwhile."""
        _refuse_small_disk(path, len(run_file) + record_bytes)
        if overwrite and path.exists():
            check_replaceable(path)
        with atomic_file(path, overwrite) as draft:
            draft.write(new_log(run_file))
            synchronise(draft)
            # An exception inside the block deletes the draft, so that no file appears at ``path``.
            if cancelled.is_set():
                raise InterruptedError
        return LogWriter(path)

    def undo(log: LogWriter) -> None:
        """Close and delete a new log that is no longer wanted."""
        # Closed first: Windows deletes no open file.
        log.close()
        with contextlib.suppress(OSError):
            if not overwrite and log.is_in_place():
                path.unlink()

    try:
        return make_or_undo(make, undo, cancelled)
    except FileExistsError:
        raise _already_exists(path) from None
    except OSError as error:
        raise StoreError(f"{path} cannot be created ({reason(error)}). Try: another folder.") from None


def _already_exists(path: Path) -> StoreError:
    return StoreError(f"{path} already exists. Try: another path, or --overwrite on the command line.")


def refuse_output(path: Path, overwrite: bool) -> None:
    """Raise ``StoreError`` if the run file ``path`` exists and may not be overwritten, or cannot be written."""
    if path.exists() and not overwrite:
        raise _already_exists(path)
    refuse_unwritable(path)


def check_replaceable(path: Path) -> None:
    """Raise ``StoreError`` unless ``path`` is a run file that no run is writing, so that it may be replaced."""
    try:
        read_run(path)
    except StoreError:
        raise StoreError(
            f"{path} exists and is not a readable run file of hpe-rig, so it is not replaced. Try: move it away."
        ) from None
    if is_locked(path):
        raise StoreError(f"{path} is being written by another run. Try: another path, or wait for its end.")
