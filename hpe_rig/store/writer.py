"""Writer of a run file: records go to disk as they arrive, in whole chunks, while others may read.

The order of writing carries the promise: a chunk of echoes is handed to the operating system before the marks in
``recorded`` that say its records are there. A reader, or the next program after a crash, may trust every mark.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import shutil
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, final

import h5py
import numpy as np
from h5py import h5f, h5p
from numpy.typing import NDArray

from drivers.interfaces import RecordBlock
from hpe_rig.bench import BenchText, uninterrupted
from hpe_rig.plan import Plan, Shot
from hpe_rig.scene import SceneText
from hpe_rig.store.atomic import atomic_file
from hpe_rig.store.format import SNAPSHOT_BYTES, STAGES, UNTRUSTED_BYTES, StoreError, reason
from hpe_rig.store.layout import TRUE_HARMONICS, Predecessor, empty_run, volts_of_codes
from hpe_rig.store.reader import StoredRun
from hpe_rig.store.records import MISSING, Placed, place

ROWS = ("recorded", "trigger_time_s", "pulse_onset_s", "shot_complete", "clipped")
CHECKPOINT_S = 1.0
"""Longest time between two syncs to the disk itself, checked at the end of each shot."""


@dataclass(frozen=True, slots=True)
class WriteOptions:
    """Options of writing a run file; ``predecessor`` is the run that a resumed run continues."""

    compress: bool = False
    overwrite: bool = False
    predecessor: Predecessor = field(default_factory=Predecessor)


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
        self._checkpoint_s = clock()
        self._broken = False
        image = empty_run(scene, bench, plan, options.compress, options.predecessor)
        _refuse_small_disk(path, len(image) + (0 if options.compress else plan.record_bytes))
        _publish(image, path, options.overwrite)
        with self._writing():
            self._file = open_for_readers(path)
        self._volts = volts_of_codes(plan.shots[0].capture.input_range_v, bench.bench.digitizer.board_model.code_limits)
        # Held, since looking a dataset up takes longer than writing to it.
        self._rows = {name: self._file[f"records/{name}"] for name in ROWS}
        self._chunk = _Chunk(self._file["records/echo"])
        monitor = self._file["records"].get("monitor")
        self._chunks = (self._chunk, *([] if monitor is None else [_Chunk(monitor)]))
        self._shot: _ShotRows | None = None

    def __enter__(self) -> RunWriter:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        failed = "failed" if kind is not None and issubclass(kind, Exception) else "aborted"
        try:
            with uninterrupted(), self._writing():
                self._end("complete" if kind is None else failed)
            if not self.path.exists():
                raise StoreError(f"{self.path} vanished while it was written. Try: another folder, measure again.")
        except StoreError:
            # What broke the run is the better message.
            if kind is None:
                raise

    def settings(self, shot: Shot, settings: Mapping[str, Mapping[str, Any]]) -> None:
        """Write the instruments' settings as read back for ``shot``, and when its pulses are due."""
        text = json.dumps(settings, sort_keys=True, separators=(",", ":"))
        if len(text) > SNAPSHOT_BYTES:
            raise StoreError(
                f"the settings of shot {shot.index + 1} take {len(text)} bytes, a run file has room for "
                f"{SNAPSHOT_BYTES}. Try: report this with the bench file."
            )
        with self._writing():
            self._file["snapshot"][shot.index] = text
            self._rows["pulse_onset_s"][shot.index] = shot.timeline.pulse_onset_s

    def append(self, shot: Shot, block: RecordBlock) -> None:
        """Write the records of ``block`` at the places of their pulses; full chunks go to disk."""
        if not block.codes.size:
            return
        self._refuse_other_volts(block)
        with self._writing():
            rows = self._rows_of(shot)
            index, rows.latest = place(block, rows.latest, shot)
            kept = index >= 0
            # Indexing copies, so it is done only where a record is left out.
            inputs = (block.codes, *([] if block.monitor is None else [block.monitor.codes]))
            codes = inputs if kept.all() else tuple(of_input[kept] for of_input in inputs)
            self._put(rows, index[kept], codes, block.trigger_time_s[kept])

    def clipped(self, shot: Shot, clipped: bool) -> None:
        """Write whether the input of the digitizer left its range during ``shot``."""
        with self._writing():
            self._rows["clipped"][shot.index] = clipped

    def untrusted(self, shot: Shot, why: str) -> None:
        """Write why the records of ``shot`` are not to be trusted."""
        with self._writing():
            self._file["untrusted"][shot.index] = why.encode("ascii", "replace")[:UNTRUSTED_BYTES]
            self._file["untrusted"].flush()

    def ground_truth(self, shot: Shot, displacement_m: NDArray[np.float64]) -> None:
        """Write the true displacement at the focus at each record of ``shot``, (record,)."""
        recorded = np.zeros(0, bool) if self._shot is None else self._shot.recorded
        valid = np.flatnonzero(recorded)
        row_m = np.full(recorded.size, np.nan)
        row_m[valid] = displacement_m[: valid.size]
        if valid.size:
            with self._writing():
                self._file["truth/displacement_m"][shot.index] = row_m

    def true_harmonics(self, shot: Shot, harmonics_m: NDArray[np.float64]) -> None:
        """Write A cos(phase) and A sin(phase) of the true displacement at the wanted frequencies, (frequency, 2)."""
        with self._writing():
            for name, column_m in zip(TRUE_HARMONICS, harmonics_m.T, strict=True):
                self._file[f"true_harmonics/{name}"][shot.index] = column_m

    def run_time(self, run_time_s: Mapping[str, float]) -> None:
        """Write the wall time of each stage so far."""
        with self._writing():
            self._file["run_time/run_time_s"][...] = [run_time_s.get(name, math.nan) for name in STAGES]

    def finish(self, shot: Shot) -> None:
        """Flush everything of ``shot``, then mark it complete; sync to disk if ``CHECKPOINT_S`` have passed."""
        with self._writing():
            self._write_chunk()
            self._file.flush()
            self._mark_complete(shot.index)
            if self._clock() - self._checkpoint_s >= CHECKPOINT_S:
                self._sync()
                self._checkpoint_s = self._clock()

    def take_over(self, earlier: StoredRun, shots: int) -> None:
        """Copy the first ``shots`` shots of another run of the same plan, chunk by chunk."""
        for shot in range(shots):
            with self._writing():
                for name, row in earlier.rows(shot).items():
                    self._file[name][shot] = row
                for chunk in self._chunks:
                    for start, codes in earlier.records.chunks(shot, chunk.rows, chunk.name):
                        chunk.write(shot, start, codes)
                self._file.flush()
                self._mark_complete(shot)

    def _rows_of(self, shot: Shot) -> _ShotRows:
        if self._shot is None or self._shot.index != shot.index:
            self._write_chunk()
            self._shot = _ShotRows(shot)
        return self._shot

    def _put(
        self,
        rows: _ShotRows,
        index: NDArray[np.int64],
        codes: tuple[NDArray[np.int16], ...],
        time_s: NDArray[np.float64],
    ) -> None:
        # Records of one block may reach over several chunks, and late ones may belong to an earlier chunk.
        for number in np.unique(index // self._chunk.rows):
            here = index // self._chunk.rows == number
            if (rows.index, number) != self._chunk.place:
                self._write_chunk()
                for chunk in self._chunks:
                    chunk.begin(rows.index, int(number))
            for chunk, of_input in zip(self._chunks, codes, strict=True):
                chunk.put(index[here] % chunk.rows, of_input[here])
            rows.recorded[index[here]] = True
            rows.trigger_time_s[index[here]] = time_s[here]
            if index[here][-1] % self._chunk.rows == self._chunk.rows - 1:
                self._write_chunk()

    def _write_chunk(self) -> None:
        """Write the current chunk, then the marks of its records; do nothing if no record was added since."""
        if self._chunk.place is None or self._shot is None or not self._chunk.fresh:
            return
        shot, number = self._chunk.place
        for chunk in self._chunks:
            chunk.flush()
        rows = slice(number * self._chunk.rows, (number + 1) * self._chunk.rows)
        for name in ("trigger_time_s", "recorded"):
            self._rows[name][shot, rows] = getattr(self._shot, name)[rows]
            self._rows[name].flush()

    def _mark_complete(self, shot: int) -> None:
        self._rows["shot_complete"][shot] = 1
        self._rows["shot_complete"].flush()

    def _end(self, status: str) -> None:
        try:
            if not self._broken:
                self._write_chunk()
                self._file.flush()
        finally:
            # The status is of fixed size and has its place: it can be written even on a full disk.
            with contextlib.suppress(OSError, RuntimeError):
                self._file.attrs.modify("status", np.bytes_(status))
                self._sync()
            self._file.close()

    def _sync(self) -> None:
        self._file.flush()
        os.fsync(self._file.id.get_vfd_handle())

    def _refuse_other_volts(self, block: RecordBlock) -> None:
        expected = self._volts
        found = block.volts_per_code, block.volts_offset
        if not all(math.isclose(one, other, rel_tol=1e-9) for one, other in zip(found, expected, strict=True)):
            raise StoreError(
                f"the digitizer reports {block.volts_per_code:g} V per code, its range implies {expected[0]:g}: its "
                "input range is not the programmed one. Try: hpe-rig bench, then another acquisition.input_range_v."
            )

    @contextlib.contextmanager
    def _writing(self) -> Iterator[None]:
        try:
            yield
        except (OSError, RuntimeError) as error:
            self._broken = True
            raise StoreError(
                f"{self.path} cannot be written any further ({reason(error)}). What was written before is kept. "
                f"Try: make room or bring the folder back, then hpe-rig resume {self.path.name}."
            ) from error


@final
class _Chunk:
    """Chunk of echoes being filled; ``place`` is its (shot, number), None before the first.

    ``fresh`` is True while it holds records that the file does not. A chunk stays in memory after it is written, so
    that a late record only means writing it once more.
    """

    def __init__(self, echo: h5py.Dataset) -> None:
        self._echo = echo
        self.name = str(echo.name).rpartition("/")[2]
        self._plain = echo.id.get_create_plist().get_nfilters() == 0
        self.rows: int = echo.chunks[1]
        self.codes = np.empty(echo.chunks[1:], "<i2")
        self.place: tuple[int, int] | None = None
        self.fresh = False

    def begin(self, shot: int, number: int) -> None:
        """Start another chunk, all records missing."""
        self.codes.fill(MISSING)
        self.place = (shot, number)

    def put(self, rows: NDArray[np.int64], codes: NDArray[np.int16]) -> None:
        """Put ``codes`` (row, sample) into the rows ``rows``."""
        self.codes[rows] = codes
        self.fresh = True

    def write(self, shot: int, first: int, codes: NDArray[np.int16]) -> None:
        """Write whole ``codes`` (pulse, sample) from pulse ``first`` on, a multiple of the chunk's rows."""
        self.begin(shot, first // self.rows)
        self.codes[: codes.shape[0]] = codes
        self.flush()

    def flush(self) -> None:
        """Write the chunk to the file; it stays in memory."""
        if self.place is None:
            return
        shot, first = self.place[0], self.place[1] * self.rows
        if self._plain:
            # Bypasses the library's cache: on a full disk nothing is left in it to fail again when the file is closed.
            self._echo.id.write_direct_chunk((shot, first, 0), self.codes)
        else:
            rows = min(self.rows, self._echo.shape[1] - first)
            self._echo[shot, first : first + rows] = self.codes[:rows]
        self._echo.flush()
        self.fresh = False


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


def _publish(image: bytes, path: Path, overwrite: bool) -> None:
    """Create ``path`` with the bytes ``image``, whole or not at all; raise ``StoreError`` where it cannot be."""
    try:
        with atomic_file(path, overwrite) as draft, draft.open("xb") as file:
            file.write(image)
            file.flush()
            os.fsync(file.fileno())
    except FileExistsError:
        raise StoreError(f"{path} already exists. Try: another path, or --overwrite on the command line.") from None
    except OSError as error:
        raise StoreError(f"{path} cannot be created ({reason(error)}). Try: another folder.") from None


def open_for_readers(path: Path) -> h5py.File:
    """Open ``path`` in HDF5's single-writer-multiple-reader mode, so that it stays readable if its writer is killed."""
    access = h5p.create(h5p.FILE_ACCESS)
    access.set_libver_bounds(h5f.LIBVER_V110, h5f.LIBVER_V110)
    return h5py.File(h5f.open(os.fsencode(path), h5f.ACC_RDWR | h5f.ACC_SWMR_WRITE, access))
