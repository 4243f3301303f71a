"""State of a queue: the state of the current run, its number in the queue, and the remaining time of all runs."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import final

from hpe_rig.live.source import RunSource
from hpe_rig.live.state import State
from hpe_rig.measurement import QueueRun, read_queue, stop_queue, time_left_s
from hpe_rig.store import StoreError

MAX_GAP_S = 2.0
"""Time without an active run after which a queue has ended; the gap between runs takes milliseconds."""


@final
class QueueSource:
    """The folder of a queue that another process measures."""

    def __init__(self, folder: Path, clock: Callable[[], float] = time.monotonic) -> None:
        """Follow ``folder``; the state reports a queue that cannot be read."""
        self._folder, self._clock = folder, clock
        self._queue: tuple[QueueRun, ...] = ()
        self._file = ""
        self._run = RunSource(folder)
        self._state: State = {}
        self._idle_since_s: float | None = None
        self._ended = False

    def poll(self) -> State | None:
        """Return the state; None if neither the list nor the run file has changed."""
        try:
            queue = read_queue(self._folder)
        except StoreError as error:
            return {"mode": "run", "status": "waiting", "title": self._folder.name, "why": str(error)}
        index = _current(queue)
        if queue[index].run_file != self._file:
            self._file = queue[index].run_file
            self._run, self._state = RunSource(self._folder / self._file), {}
        run_state, ended = self._run.poll(), self._has_ended(queue)
        if run_state is None and (queue, ended) == (self._queue, self._ended):
            return None
        self._queue, self._ended, self._state = queue, ended, self._state if run_state is None else run_state
        return self._state | _queue_state(queue, index, ended, self._state)

    def stop(self) -> None:
        """Request a stop of the current run and of the queue; between runs the queue stops before the next one."""
        if self._ended:
            raise StoreError(f"the queue in {self._folder} has ended: there is nothing to stop. Try: reload the page.")
        try:
            self._run.stop()
        except StoreError:
            stop_queue(self._folder)

    def pause(self) -> None:
        """Request a pause of the current run after its shot, or a continuation; raise ``StoreError`` between runs."""
        self._run.pause()

    def _has_ended(self, queue: Sequence[QueueRun]) -> bool:
        states, now_s = {run.state for run in queue}, self._clock()
        if "running" in states:
            self._idle_since_s = None
            return False
        if self._idle_since_s is None or queue != self._queue:
            # A change of the list shows that a run was active in the meantime.
            self._idle_since_s = now_s
        return "waiting" not in states or now_s - self._idle_since_s > MAX_GAP_S


def _current(queue: Sequence[QueueRun]) -> int:
    """Return the index of the active run, else of the last one that started."""
    running = [index for index, run in enumerate(queue) if run.state == "running"]
    started = [index for index, run in enumerate(queue) if run.state != "waiting"]
    return (running or started[-1:] or [0])[0]


def _queue_state(queue: Sequence[QueueRun], index: int, ended: bool, state: State) -> State:
    """Return the page's values for the queue. The page ends with the queue, not with a run."""
    states = [run.state for run in queue]
    run_left_s = state.get("left_s")
    # The rate of the current run's records is more accurate than its plan.
    left_s = time_left_s(queue, index) if run_left_s is None else run_left_s + time_left_s(queue, index + 1)
    counts = {name: states.count(name) for name in ("done", "failed")}
    progress = {"run": index + 1, "runs": len(queue), "name": queue[index].name, **counts}
    if not ended:
        status = state.get("status", "waiting")
        active_status = "running" if status in ("complete", "aborted", "failed", "killed") else status
        return {"status": active_status, "queue": progress | {"left_s": round(left_s, 1)}}
    status = "complete" if counts["done"] == len(queue) else "failed" if counts["failed"] else "aborted"
    text = f"The queue has ended: {counts['done']} of {len(queue)} runs are done; every output is off."
    return {"status": status, "queue": progress, "ended": text}
