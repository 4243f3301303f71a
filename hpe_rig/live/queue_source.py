"""State of a queue: of the run that goes on, read from its file, with which of how many it is and when all are done."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import final

from hpe_rig.live.source import RunSource
from hpe_rig.live.state import State
from hpe_rig.measurement import QUEUE_FILE, QueueRun, read_queue, time_left_s, write_stop
from hpe_rig.store import StoreError

LONGEST_BETWEEN_S = 2.0
"""Time without a run that goes on after which a queue has ended; from one run to the next takes milliseconds."""


@final
class QueueSource:
    """A queue's folder, in which another process measures one run after another."""

    def __init__(self, folder: Path, clock: Callable[[], float] = time.monotonic) -> None:
        """Take ``folder``; raises nothing: what cannot be read is said in the state."""
        self._folder, self._clock = folder, clock
        self._queue: tuple[QueueRun, ...] = ()
        self._file = ""
        self._run = RunSource(folder)
        self._state: State = {}
        self._idle_since_s: float | None = None
        self._ended = False

    def poll(self) -> State | None:
        """Return the state; None where neither the list nor the run's file has changed."""
        try:
            queue = read_queue(self._folder)
        except StoreError as error:
            return {"mode": "run", "status": "waiting", "title": self._folder.name, "why": str(error)}
        index = _current(queue)
        if queue[index].run_file != self._file:
            self._file = queue[index].run_file
            self._run, self._state = RunSource(self._folder / self._file), {}
        new, ended = self._run.poll(), self._has_ended(queue)
        if new is None and (queue, ended) == (self._queue, self._ended):
            return None
        self._queue, self._ended, self._state = queue, ended, self._state if new is None else new
        return self._state | _of_queue(queue, index, ended, self._state)

    def stop(self) -> None:
        """Ask the run that goes on to stop, and with it the queue; between two runs the queue, before the next one."""
        if self._ended:
            raise StoreError(f"the queue in {self._folder} has ended: there is nothing to stop. Try: reload the page.")
        try:
            self._run.stop()
        except StoreError:
            write_stop(self._folder / QUEUE_FILE)

    def pause(self) -> None:
        """Ask the run that goes on to pause after its shot, or to go on; raise ``StoreError`` between two runs."""
        self._run.pause()

    def _has_ended(self, queue: Sequence[QueueRun]) -> bool:
        states, now_s = {run.state for run in queue}, self._clock()
        if "running" in states:
            self._idle_since_s = None
            return False
        if self._idle_since_s is None or queue != self._queue:
            # A change since the last look says that runs went on between, however long ago that was.
            self._idle_since_s = now_s
        return "waiting" not in states or now_s - self._idle_since_s > LONGEST_BETWEEN_S


def _current(queue: Sequence[QueueRun]) -> int:
    """Return the run that goes on, else the last that did."""
    running = [index for index, run in enumerate(queue) if run.state == "running"]
    begun = [index for index, run in enumerate(queue) if run.state != "waiting"]
    return (running or begun[-1:] or [0])[0]


def _of_queue(queue: Sequence[QueueRun], index: int, ended: bool, state: State) -> State:
    """Return what the page says of the queue; it ends with the queue and not with a run of it."""
    states = [run.state for run in queue]
    own_s = state.get("left_s")
    # Of the run that goes on its own records tell more than the plan.
    left_s = time_left_s(queue, index) if own_s is None else own_s + time_left_s(queue, index + 1)
    counts = {name: states.count(name) for name in ("done", "failed")}
    said = {"run": index + 1, "runs": len(queue), "name": queue[index].name, **counts}
    if not ended:
        status = state.get("status", "waiting")
        going = "running" if status in ("complete", "aborted", "failed") else status
        return {"status": going, "queue": said | {"left_s": round(left_s, 1)}}
    status = "complete" if counts["done"] == len(queue) else "failed" if counts["failed"] else "aborted"
    words = f"The queue has ended: {counts['done']} of {len(queue)} runs are done; every output is off."
    return {"status": status, "queue": said, "ended": words}
