"""Recording of a run: what the sequencer yields goes into a run file, which replaces another only with its own records.

A run file that is to be overwritten stays what it is until the first record has arrived, and a new one is removed again
where not even a shot was programmed: a wrong address costs nobody a run and leaves nothing behind.
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

NOTHING_LEFT = "nothing was measured, and no run file is left"


@final
class Recording:
    """Run file of a measurement; ``create`` makes its writer, at once or, where ``late``, with the first record."""

    def __init__(self, path: Path, create: Callable[[], RunWriter], late: bool) -> None:
        self._path = path
        self._create = create
        self._late = late
        self._writer: RunWriter | None = None
        self._ready: ShotReady | None = None
        self._programmed = self._arrived = False

    def __enter__(self) -> Self:
        if not self._late:
            try:
                self._begin()
            except INTERRUPTS as interrupt:
                if not self._path.exists():
                    interrupt.add_note(NOTHING_LEFT)
                raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._writer is not None:
            self._writer.__exit__(kind, error, trace)
        if error is None:
            return
        error.add_note(self._left())

    def take_over(self, earlier: StoredRun, shots: int) -> None:
        """Copy the first ``shots`` shots of an earlier run of the same plan."""
        self._begin().take_over(earlier, shots)
        self._arrived = self._arrived or shots > 0

    def take(self, event: Event, scene: Scene, bench: Bench, stages: Stages) -> None:
        """Write what ``event`` brings; a shot counts as complete only once everything of it is in the file."""
        self._programmed = True
        match event:
            case ShotReady() if self._writer is None:
                self._ready = event
            case ShotReady(shot, settings):
                self._begin().settings(shot, settings)
            case ShotBlock(shot, block):
                self._begin().append(shot, block)
                self._arrived = self._arrived or block.codes.size > 0
            case ShotUntrusted(shot, why):
                self._begin().untrusted(shot, why)
            case ShotDone(shot, clipped):
                writer = self._begin()
                writer.clipped(shot, clipped)
                if bench.world is not None:
                    with stages("truth"):
                        pulses_m = bench.world.true_displacement_m()
                        harmonics_m = true_harmonics_m(scene, shot, bench.world.true_motion_m)
                    writer.ground_truth(shot, pulses_m)
                    writer.true_harmonics(shot, harmonics_m)
                writer.finish(shot)

    def look(self) -> None:
        """Raise ``StoreError`` where the file was lost, also while nothing is written."""
        if self._writer is not None:
            self._writer.look()

    def run_time(self, stages: Stages) -> None:
        """Write the wall time of each stage so far."""
        self._begin().run_time(stages.run_time_s)

    def _left(self) -> str:
        """Return in words what a run that ended early leaves; remove a file in which there is nothing at all."""
        if self._arrived:
            then = f"hpe-rig process {self._path} estimates them, hpe-rig resume {self._path} measures the rest"
            return f"{self._path} holds the records that had arrived: {then}"
        if self._writer is None:
            return f"no record had arrived: {self._path} is what it was before"
        if self._programmed:
            return f"{self._path} holds no records: none had arrived"
        self._writer.remove()
        return NOTHING_LEFT

    def _begin(self) -> RunWriter:
        """Return the writer, made now where it was not before."""
        if self._writer is None:
            with uninterrupted():
                # A signal between the file's appearance and this would leave it "running" for ever.
                self._writer = self._create()
            if self._ready is not None:
                self._writer.settings(self._ready.shot, self._ready.settings)
        return self._writer
