"""Recording of a run: the events of the sequencer are written to a run file.

An existing run file that is to be replaced stays untouched until the first record arrives. A new run file is removed if
not even one shot was programmed. So a wrong address neither destroys a run nor leaves an empty file.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Self, final

from hpe_rig.bench import INTERRUPTS, Bench, uninterrupted
from hpe_rig.measurement.sequencer import Event, ShotBlock, ShotDone, ShotReady, ShotUntrusted
from hpe_rig.processing import true_harmonics_m
from hpe_rig.result import Stages
from hpe_rig.scene import Scene
from hpe_rig.store import RunWriter, StoredRun

NOTHING_MEASURED = "nothing was measured, and there is no run file"


@final
class RunRecorder:
    """Writes the events of a run to the file that ``create`` opens: at once or, with ``defer``, at the first record."""

    def __init__(self, path: Path, create: Callable[[], RunWriter], defer: bool) -> None:
        self._path = path
        self._create = create
        self._defer = defer
        self._writer: RunWriter | None = None
        self._first_settings: ShotReady | None = None
        self._has_event = self._has_record = False

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
        if self._writer is not None:
            self._writer.__exit__(kind, error, trace)
        if error is not None:
            error.add_note(self._content_after_error())

    def copy_shots(self, earlier: StoredRun, shots: int) -> None:
        """Copy the first ``shots`` shots of an earlier run of the same plan."""
        self._open().copy_shots(earlier, shots)
        self._has_record = self._has_record or shots > 0

    def write(self, event: Event, scene: Scene, bench: Bench, stages: Stages) -> None:
        """Write ``event``; a shot is marked as complete after all of its data."""
        self._has_event = True
        match event:
            case ShotReady() if self._writer is None:
                self._first_settings = event
            case ShotReady(shot, settings):
                self._open().write_settings(shot, settings)
            case ShotBlock(shot, block):
                self._open().append(shot, block)
                self._has_record = self._has_record or block.codes.size > 0
            case ShotUntrusted(shot, why):
                self._open().write_untrusted(shot, why)
            case ShotDone():
                self._finish_shot(event, scene, bench, stages)

    def _finish_shot(self, event: ShotDone, scene: Scene, bench: Bench, stages: Stages) -> None:
        writer = self._open()
        writer.write_clipped(event.shot, event.clipped)
        if bench.world is not None:
            with stages("truth"):
                displacement_m = bench.world.true_displacement_m()
                harmonics_m = true_harmonics_m(scene, event.shot, bench.world.true_motion_m)
            writer.write_ground_truth(event.shot, displacement_m)
            writer.write_true_harmonics(event.shot, harmonics_m)
        writer.finish(event.shot)

    def check_file_present(self) -> None:
        """Raise ``StoreError`` if the run file was removed or replaced."""
        if self._writer is not None:
            self._writer.check_file()

    def write_run_time(self, stages: Stages) -> None:
        """Write the wall time of each stage so far."""
        self._open().write_run_times(stages.run_time_s)

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
                self._writer = self._create()
            if self._first_settings is not None:
                self._writer.write_settings(self._first_settings.shot, self._first_settings.settings)
        return self._writer
