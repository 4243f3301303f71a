"""State of a run, read from its file while another process writes it."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol, final

import numpy as np

from hpe_rig.live.history import RemainingTime, ShotHistory, estimates_with_sources, setting_text, warnings_of
from hpe_rig.live.state import State, harmonic_state, image_state, level_state, motion_state, rf_state
from hpe_rig.measurement import awaited_offset_m, pause_requested, request_stop, stop_path, stop_requested, toggle_pause
from hpe_rig.plan import scene_of_shot
from hpe_rig.prediction import beam_widths
from hpe_rig.processing import fit_motion, options_of, shot_prior
from hpe_rig.report import echo_view, motion_view, selected_pulses, tracked_motion
from hpe_rig.runs import Run, open_run
from hpe_rig.store import ShotRecords, StoredRun, StoreError, is_locked, read_run

MAX_HISTORY = 240
"""States in the history of amplitudes."""


class Source(Protocol):
    """Provider of the live page's state, and receiver of its requests."""

    def poll(self) -> State | None:
        """Return the state, None without a change; called from one thread at a time."""
        ...

    def stop(self) -> None:
        """Request a safe stop; raise ``StoreError`` if nothing is running."""
        ...

    def pause(self) -> None:
        """Request a pause after the shot, or a continuation; raise ``StoreError`` if nothing is running."""
        ...


@final
class RunSource:
    """A run file, complete or being written by another process."""

    def __init__(self, path: Path) -> None:
        """Follow ``path``; the file need not exist yet."""
        self._path = path
        self._run: Run | None = None
        self._start_anew()

    def _start_anew(self) -> None:
        """Forget what was derived from the records of a run."""
        self._fingerprint: tuple[int, int, int, bool, bool] | None = None
        self._shot = 0
        self._earlier_records = 0
        self._history: list[State] = []
        self._shots, self._pending, self._time = ShotHistory(), 0, RemainingTime()

    def poll(self) -> State | None:
        """Return the state; None if the file has not changed."""
        try:
            fingerprint = self._read_fingerprint()
            if fingerprint == self._fingerprint and not self._pending:
                return None
            run = open_run(self._path) if self._run is None else self._run.refreshed()
        except (OSError, StoreError) as error:
            # The file may be incomplete or still missing: the page waits.
            return self._waiting("" if isinstance(error, FileNotFoundError) else str(error))
        if self._run is not None and run.identity != self._run.identity:
            # Another run has replaced the file, as with --overwrite.
            self._start_anew()
        self._run, self._fingerprint = run, fingerprint
        return self._state(run)

    def stop(self) -> None:
        """Request a stop through the run's stop file; raise ``StoreError`` if the run is not active."""
        request_stop(self._path)

    def pause(self) -> None:
        """Request a pause after the shot, or a continuation; raise ``StoreError`` if the run is not active."""
        if pause_requested(self._path):
            # Before the file exists, a run may wait for its first position.
            toggle_pause(self._path)
            return
        stored = read_run(self._path)
        if stored.status != "running" or is_locked(self._path) is False:
            raise StoreError(f"the run in {self._path} has ended: there is nothing to pause. Try: reload the page.")
        toggle_pause(self._path, stored.run_id)

    def _read_fingerprint(self) -> tuple[int, int, int, bool, bool]:
        """Return values that change with every new state, without opening the file."""
        status = self._path.stat()
        requests = stop_path(self._path).exists(), pause_requested(self._path)
        return status.st_ino, status.st_mtime_ns, status.st_size, *requests

    def _waiting(self, reason: str) -> State | None:
        paused = pause_requested(self._path)
        if self._fingerprint == (0, 0, 0, False, paused):
            return None
        self._fingerprint = (0, 0, 0, False, paused)
        position = {"pause_requested": paused, "place_mm": _place_mm(self._path)}
        return {"mode": "run", "status": "waiting", "title": self._path.name, "why": reason, **position}

    def _state(self, run: Run) -> State:
        stored, plan = run.stored, run.plan
        shot_records = self._advance(stored)
        records, planned = self._earlier_records + shot_records, sum(shot.capture.record_count for shot in plan.shots)
        running = stored.status == "running" and not pause_requested(self._path, stored.run_id)
        state: State = {
            "mode": "run",
            "run": run.identity,
            "title": run.scene.title,
            "file": self._path.name,
            "simulated": stored.simulated,
            "status": stored.status,
            "pause_requested": stored.status == "running" and pause_requested(self._path, stored.run_id),
            "place_mm": _place_mm(self._path, stored.run_id) if stored.status == "running" else None,
            "stop_requested": stored.status == "running" and stop_requested(self._path, stored.run_id),
            "shot": self._shot + 1,
            "shots": len(plan.shots),
            "setting": setting_text(plan.shots[self._shot]),
            "records": records,
            "records_planned": planned,
            "left_s": self._time.remaining_s(records, planned, running),
        }
        if not shot_records or (state["stop_requested"] and stored.status == "running"):
            # An estimate would occupy the run's processor core and delay the stop.
            return state
        self._pending = self._shots.advance(run)
        measured = self._measured(run, shot_records)
        clipped = bool(measured.get("level", {}).get("clipped"))
        warnings = list(warnings_of(run, plan.shots[self._shot], clipped))
        return (
            state
            | measured
            | {
                "over_shots": self._shots.state,
                **self._shots.means(plan.shots[self._shot]),
                "shots_pending": self._pending,
                "warning": warnings[-1] if warnings else "",
            }
        )

    def _advance(self, stored: StoredRun) -> int:
        """Advance to the last shot with records and return their number."""
        count = _arrived(stored, self._shot)
        while self._shot + 1 < len(stored.records) and (later := _arrived(stored, self._shot + 1)):
            self._shot, self._earlier_records, count = self._shot + 1, self._earlier_records + count, later
        return count

    def _measured(self, run: Run, shot_records: int) -> State:
        shot, records = run.plan.shots[self._shot], run.records[self._shot]
        scene = scene_of_shot(run.scene, shot)
        echoes = echo_view(scene, shot, records, line=-1)
        if echoes is None:
            return {}
        state: State = {
            "rf": rf_state(echoes),
            "level": level_state(echoes, shot.capture.input_range_v),
            **_damage_state(records),
            "image": image_state(echoes.image_v, echoes.image_depth_m, float(echoes.image_time_s[-1]) * 1e3, "ms"),
        }
        try:
            # Selection, prior and fit of the result with the estimator "coherent", over the pulses so far.
            motion = tracked_motion(scene, shot, records)
            selection = selected_pulses(scene, shot)
            options = options_of(scene.processing, shot_prior(scene, shot, "coherent", beam_widths(scene, "coherent")))
            fit = fit_motion(motion, selection.wanted_hz, "coherent", selection.driven_hz, options)
            estimates = estimates_with_sources(run, shot, fit, "coherent")
            state["motion"] = motion_state(motion_view(scene, shot, motion, estimates))
        except ValueError as error:
            # Too few pulses so far: the page states it and displays the echoes.
            return state | {"why": str(error), "history": self._history}
        harmonics = harmonic_state(estimates)
        self._history.append(
            {"records": self._earlier_records + shot_records, "nm": [item["nm"] for item in harmonics]}
        )
        self._history = self._history[-MAX_HISTORY:]
        return state | {"harmonics": harmonics, "history": self._history}


def _place_mm(run_file: Path, run_id: str = "") -> float | None:
    place_m = awaited_offset_m(run_file, run_id)
    return None if place_m is None else place_m * 1e3


def _arrived(stored: StoredRun, shot: int) -> int:
    return int(np.count_nonzero(stored.records.arrival(shot).recorded))


def _damage_state(records: ShotRecords) -> State:
    """Return the page's message about records that fail their checksums; empty without any."""
    if records.damaged is None or not records.damaged.any():
        return {}
    return {"why": f"{int(records.damaged.sum())} records of this shot fail their checksums and are excluded"}
