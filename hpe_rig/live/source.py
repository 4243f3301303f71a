"""State of a run, read from its file by another process while it is written."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol, final

import numpy as np

from hpe_rig.live.history import ShotHistory, TimeLeft, setting_of, warnings_of
from hpe_rig.live.state import State, harmonic_state, image_state, level_state, motion_state, rf_state
from hpe_rig.measurement import awaited_offset_m, pause_requested, request_stop, stop_path, stop_requested, toggle_pause
from hpe_rig.plan import phase_reference, scene_of_shot
from hpe_rig.prediction import beam_widths
from hpe_rig.processing import (
    coherent,
    estimates_of,
    fit_motion,
    options_of,
    shot_echoes,
    shot_motion,
    shot_prior,
)
from hpe_rig.report import echo_view, gate_records, motion_view, selected_pulses
from hpe_rig.runs import Run, open_run
from hpe_rig.store import ShotRecords, StoredRun, StoreError, is_taken, read_run

LONGEST_HISTORY = 240


class Source(Protocol):
    """Where the live page gets its state from, and whom it asks to stop."""

    def poll(self) -> State | None:
        """Return the state, None where nothing has changed; called from one thread at a time."""
        ...

    def stop(self) -> None:
        """Ask for a safe stop; raise ``StoreError`` where nobody can be asked."""
        ...

    def pause(self) -> None:
        """Ask for a pause after the shot, or to go on; raise ``StoreError`` where nobody can be asked."""
        ...


@final
class RunSource:
    """A run file, written by another process or long complete."""

    def __init__(self, path: Path) -> None:
        """Take ``path``; raises nothing: a file that is not there yet is waited for."""
        self._path = path
        self._seen: tuple[int, int, bool, bool] | None = None
        self._run: Run | None = None
        self._shot = 0
        self._before = 0
        self._history: list[State] = []
        self._shots, self._behind, self._time = ShotHistory(), False, TimeLeft()

    def poll(self) -> State | None:
        """Return the state; None where the file has not changed since."""
        try:
            seen = self._fingerprint()
            if seen == self._seen and not self._behind:
                return None
            # Scene and plan stay the same while records arrive.
            self._run = open_run(self._path) if self._run is None else self._run.refreshed()
        except (OSError, StoreError) as error:
            # Just being created, or no run file at all: both may be different a moment later.
            return self._waiting(str(error))
        self._seen = seen
        return self._state(self._run)

    def stop(self) -> None:
        """Ask the run to stop through the file that it looks for; raise ``StoreError`` where none is going on."""
        request_stop(self._path)

    def pause(self) -> None:
        """Ask the run to pause after its shot, or to go on; raise ``StoreError`` where none is going on."""
        if pause_requested(self._path):
            # Also before its file is there: a run may wait for its first place.
            toggle_pause(self._path)
            return
        stored = read_run(self._path)
        if stored.status != "running" or is_taken(self._path) is False:
            raise StoreError(f"the run in {self._path} has ended: there is nothing to pause. Try: reload the page.")
        toggle_pause(self._path, stored.run_id)

    def _fingerprint(self) -> tuple[int, int, bool, bool]:
        """Return what changes whenever there is something new to show, without opening the file."""
        status = self._path.stat()
        return status.st_mtime_ns, status.st_size, stop_path(self._path).exists(), pause_requested(self._path)

    def _waiting(self, why: str) -> State | None:
        asked = pause_requested(self._path)
        if self._seen == (0, 0, False, asked):
            return None
        self._seen = (0, 0, False, asked)
        place = {"pause_requested": asked, "place_mm": _place_mm(self._path)}
        return {"mode": "run", "status": "waiting", "title": self._path.name, "why": why, **place}

    def _state(self, run: Run) -> State:
        stored, plan = run.stored, run.plan
        here = self._advance(stored)
        records, planned = self._before + here, sum(shot.capture.record_count for shot in plan.shots)
        running = stored.status == "running" and not pause_requested(self._path, stored.run_id)
        state: State = {
            "mode": "run",
            "title": run.scene.title,
            "file": self._path.name,
            "simulated": stored.simulated,
            "status": stored.status,
            "pause_requested": stored.status == "running" and pause_requested(self._path, stored.run_id),
            "place_mm": _place_mm(self._path, stored.run_id) if stored.status == "running" else None,
            "stop_requested": stored.status == "running" and stop_requested(self._path, stored.run_id),
            "shot": self._shot + 1,
            "shots": len(plan.shots),
            "setting": setting_of(plan.shots[self._shot]),
            "records": records,
            "records_planned": planned,
            "left_s": self._time.left_s(records, planned, running),
        }
        if not here or (state["stop_requested"] and stored.status == "running"):
            # An estimate would keep the run's core busy while somebody waits for it to stop.
            return state
        self._behind = self._shots.advance(run)
        measured = self._measured(run, here)
        clipped = bool(measured.get("level", {}).get("clipped"))
        warnings = list(warnings_of(run, plan.shots[self._shot], clipped))
        return state | measured | {"over_shots": self._shots.state, "warning": warnings[-1] if warnings else ""}

    def _advance(self, stored: StoredRun) -> int:
        """Move on to the last shot that has records and return how many it has."""
        here = _arrived(stored, self._shot)
        while self._shot + 1 < len(stored.records) and (later := _arrived(stored, self._shot + 1)):
            self._shot, self._before, here = self._shot + 1, self._before + here, later
        return here

    def _measured(self, run: Run, here: int) -> State:
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
            gated = gate_records(scene, shot, records)
            shown = selected_pulses(scene, shot)
            motion = shot_motion(scene, shot, shot_echoes(scene, shot, gated, shown), coherent)
            options = options_of(scene.processing, shot_prior(scene, shot, "coherent", beam_widths(scene, "coherent")))
            fit = fit_motion(motion, shown.wanted_hz, "coherent", shown.driven_hz, options)
            # The same selection and the same fit as the result's, over the pulses that have arrived.
            estimates = estimates_of(fit, reference=phase_reference(scene, shot))
            state["motion"] = motion_state(motion_view(scene, shot, gated, estimates))
        except ValueError as error:
            # Not enough pulses yet; the page says so and shows the echoes.
            return state | {"why": str(error), "history": self._history}
        harmonics = harmonic_state(estimates)
        self._history.append({"records": self._before + here, "nm": [item["nm"] for item in harmonics]})
        self._history = self._history[-LONGEST_HISTORY:]
        return state | {"harmonics": harmonics, "history": self._history}


def _place_mm(run_file: Path, run_id: str = "") -> float | None:
    place_m = awaited_offset_m(run_file, run_id)
    return None if place_m is None else place_m * 1e3


def _arrived(stored: StoredRun, shot: int) -> int:
    return int(np.count_nonzero(stored.records.recorded(shot)))


def _damage_state(records: ShotRecords) -> State:
    """Return what the page says of records that fail their checksums; nothing where none does."""
    if records.damaged is None or not records.damaged.any():
        return {}
    return {"why": f"{int(records.damaged.sum())} records of this shot fail their checksums and are left out"}
