"""Recording of a run: the events of the sequencer are written to a run file.

A thread writes everything. Records arrive while outputs are on: the measuring thread does not wait for them, so that a
slow disk keeps no output on. For everything else it waits, with outputs off, but not for a disk that does not answer.

An existing run file that is to be replaced stays untouched until the first record arrives. A new run file is removed if
not even one shot was programmed. So a wrong address neither destroys a run nor leaves an empty file.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Self, final

from drivers.interfaces import RecordBlock
from hpe_rig.bench import INTERRUPTS, Bench, interruptible, uninterrupted
from hpe_rig.measurement.background import POLL_S, BackgroundTasks
from hpe_rig.measurement.sequencer import Event, ShotBlock, ShotDone, ShotReady, ShotRows
from hpe_rig.plan import Shot
from hpe_rig.processing import true_harmonics_m
from hpe_rig.result import Stages
from hpe_rig.scene import Scene
from hpe_rig.store import RunWriter, StoredRun, StoreError

NOTHING_MEASURED = "nothing was measured, and there is no run file"
MAX_BACKLOG_BYTES = 256_000_000
"""Records in memory that wait for the disk; beyond it the shot ends."""
MAX_SIMULATED_BACKLOG_BYTES = 16_000_000
"""As above on a simulated bench, which drives nothing: there the measurement waits for the disk."""
DISK_TIMEOUT_S = 60.0
"""Time limit of one write; network shares that fail over to another server take tens of seconds."""
GIVE_UP_S = 5.0
"""Time limit of one write after the run was interrupted: the user is waiting for it to end."""


@final
class RunRecorder:
    """Writes the events of a run to the file that ``create`` opens: at once or, with ``defer``, at the first record.

    ``create`` gives up as soon as its argument ``cancelled`` is set.
    """

    def __init__(self, path: Path, create: Callable[..., RunWriter], defer: bool) -> None:
        self._path = path
        self._create = create
        self._defer = defer
        self._writer: RunWriter | None = None
        self._first_settings: ShotReady | None = None
        self._has_event = self._has_record = self._is_stuck = False
        self._storage, self._cancelled = BackgroundTasks("storage"), threading.Event()

    def __enter__(self) -> Self:
        if not self._defer:
            try:
                self._open()
            except INTERRUPTS as interrupt:
                if not self._path.exists():
                    interrupt.add_note(NOTHING_MEASURED)
                raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self._close(kind, error, trace)
        finally:
            self._storage.end()

    def _close(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Wait for the records so far, close the run file in a thread, and note in ``error`` what the file holds."""
        limit_s = DISK_TIMEOUT_S if error is None or isinstance(error, Exception) else GIVE_UP_S
        if limit_s == GIVE_UP_S and self._writer is None:
            # A file that is being created is given up at once.
            self._cancelled.set()
        is_closed = not self._is_stuck and self._wait_for(self._storage, error, limit_s)
        closing = BackgroundTasks("close")
        if is_closed and self._writer is not None:
            closing.submit(partial(self._writer.__exit__, kind, error, trace))
            try:
                is_closed = self._wait_for(closing, error, limit_s)
            finally:
                closing.end()
        closing.check()
        if error is not None:
            unwritten = f"the disk of {self._path} does not answer: its last records may be missing"
            error.add_note(self._content_after_error() if is_closed else unwritten)
        elif not is_closed:
            raise self._disk_timeout()

    def _wait_for(self, tasks: BackgroundTasks, error: BaseException | None, limit_s: float) -> bool:
        """Wait for the end of ``tasks`` and return whether the disk answers, each time within ``limit_s``.

        A signal discards records that wait for the disk, and leaves the log of the run as it is. It is raised
        afterwards unless the run ends by an ``error``.
        """
        try:
            with interruptible():
                return tasks.wait(limit_s, self._progress)
        except INTERRUPTS as interrupt:
            self._storage.discard()
            self._cancelled.set()
            is_finished = tasks.wait(GIVE_UP_S, self._progress)
            if error is None:
                interrupt.add_note(f"{self._path} holds the run: the next command that reads it makes it an HDF5 file")
                raise
            return is_finished

    def _progress(self) -> int:
        return 0 if self._writer is None else self._writer.progress

    def _run(self, task: Callable[[], None]) -> None:
        """Run ``task`` in the thread after all records so far, and wait for it.

        Raises its error or theirs, and ``StoreError`` if the disk does not answer.
        """
        self._storage.submit(task)
        self._drain()

    def _drain(self) -> None:
        """Wait until all records are written; raise their error, and ``StoreError`` if the disk does not answer."""
        self._is_stuck = not self._storage.wait(DISK_TIMEOUT_S, self._progress)
        if self._is_stuck:
            raise self._disk_timeout()
        self._storage.check()

    def _disk_timeout(self) -> StoreError:
        return StoreError(
            f"{self._path} cannot be written any further (the disk has not answered for {DISK_TIMEOUT_S:g} s). What "
            f"was written before is kept. Try: bring the disk back, then hpe-rig resume {self._path.name}."
        )

    def copy_shots(self, earlier: StoredRun, shots: int) -> None:
        """Copy the first ``shots`` shots of an earlier run of the same plan."""
        writer = self._open()
        for shot in range(shots):
            self._run(partial(writer.copy_shot, earlier, shot))
            self._has_record = True

    def write(self, event: Event, scene: Scene, bench: Bench, stages: Stages) -> None:
        """Write ``event``; a shot is marked as complete after all of its data.

        Records are handed to the thread. Raises the error of earlier records, and ``StoreError`` if the disk of a real
        bench has fallen too far behind, or does not answer.
        """
        self._has_event = True
        if isinstance(event, ShotBlock):
            self._hand_over(event, bench.simulated)
            return
        self._drain()
        match event:
            case ShotReady() if self._writer is None:
                self._first_settings = event
            case ShotReady(shot, settings):
                self._run(partial(self._open().write_settings, shot, settings))
            case ShotRows(shot, rows):
                self._run(partial(self._open().write_rows, shot, rows))
            case ShotDone():
                self._finish_shot(event, scene, bench, stages)

    def _hand_over(self, event: ShotBlock, simulated: bool) -> None:
        monitor_bytes = 0 if event.block.monitor is None else event.block.monitor.codes.nbytes
        self._storage.submit(partial(self._append, event.shot, event.block), event.block.codes.nbytes + monitor_bytes)
        while simulated and self._storage.backlog_bytes > MAX_SIMULATED_BACKLOG_BYTES:
            self._storage.wait_for_one(POLL_S)
        if self._storage.backlog_bytes > MAX_BACKLOG_BYTES:
            raise StoreError(
                f"the disk of {self._path} has fallen behind by {self._storage.backlog_bytes / 1e6:.4g} MB of records, "
                f"more than the {MAX_BACKLOG_BYTES / 1e6:.4g} MB that are kept in memory. Try: a local disk for "
                "--output, fewer samples per record, or a shorter train."
            )

    def _append(self, shot: Shot, block: RecordBlock) -> None:
        self._open().append(shot, block)
        self._has_record = self._has_record or block.codes.size > 0

    def _finish_shot(self, event: ShotDone, scene: Scene, bench: Bench, stages: Stages) -> None:
        writer, truth = self._open(), None
        if bench.world is not None:
            with stages("truth"):
                displacement_m = bench.world.true_displacement_m()
                truth = displacement_m, true_harmonics_m(scene, event.shot, bench.world.true_motion_m)

        def finish() -> None:
            writer.write_rows(event.shot, {"records/clipped": event.clipped})
            if truth is not None:
                writer.write_ground_truth(event.shot, truth[0])
                writer.write_true_harmonics(event.shot, truth[1])
            writer.finish(event.shot)

        self._run(finish)

    def check_file_present(self, wait: bool) -> None:
        """Raise ``StoreError`` if the run file was removed or replaced; without ``wait``, at one of the next calls."""
        if wait:
            self._run(self._check_file)
            return
        self._storage.check()
        # Each block of records checks the file too.
        if not self._storage.unfinished:
            self._storage.submit(self._check_file)

    def _check_file(self) -> None:
        if self._writer is not None:
            self._writer.check_file()

    def write_run_time(self, stages: Stages) -> None:
        """Write the wall time of each stage so far."""
        self._run(partial(self._open().write_run_times, stages.run_time_s))

    def _content_after_error(self) -> str:
        """Return the content of the file after an early end; remove a file without any event."""
        if self._has_record:
            commands = f"hpe-rig process {self._path} estimates them, hpe-rig resume {self._path} measures the others"
            return f"{self._path} holds the records that had arrived: {commands}"
        if self._writer is None:
            return f"no record had arrived: {self._path} is unchanged"
        if self._has_event:
            return f"{self._path} holds no records: none had arrived"
        self._writer.remove()
        return NOTHING_MEASURED

    def _open(self) -> RunWriter:
        """Return the writer; create the run file at the first call."""
        if self._writer is None:
            with uninterrupted():
                # A signal between the creation of the file and this assignment would leave its status at "running".
                self._writer = self._create(cancelled=self._cancelled)
            if self._first_settings is not None:
                self._writer.write_settings(self._first_settings.shot, self._first_settings.settings)
        return self._writer
