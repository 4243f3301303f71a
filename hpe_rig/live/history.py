"""History of a run over its shots: amplitude and phase of each complete one, the time left, the last warning."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import final

import numpy as np

from hpe_rig.live.state import State, harmonic_state
from hpe_rig.plan import Shot, scene_of_shot
from hpe_rig.prediction import beam_widths
from hpe_rig.processing import estimates_of, shot_fit
from hpe_rig.runs import Run

MOST_SHOTS = 2_000
"""Shots whose amplitudes are kept; a screen shows no more."""
MOST_HARMONICS = 6
LONGEST_LOOK_S = 0.25
"""Time that one state may spend on shots that have ended; the rest of them wait for the next one."""


@final
class ShotHistory:
    """Estimates of the complete shots, each made once, as ``Run.estimate`` tracks them: not corrected for the beams."""

    def __init__(self) -> None:
        self._next = 0
        self._states: list[State] = []

    def advance(self, run: Run) -> bool:
        """Estimate the shots that are complete since, as many as there is time for; return whether any are left."""
        until_s = time.monotonic() + LONGEST_LOOK_S
        while self._next < len(run.plan.shots) and run.stored.shot_complete[self._next]:
            if time.monotonic() > until_s:
                return True
            self._put(run, run.plan.shots[self._next])
            self._next += 1
        return False

    def _put(self, run: Run, shot: Shot) -> None:
        scene = scene_of_shot(run.scene, shot)
        estimator = scene.processing.estimator
        try:
            fit = shot_fit(scene, shot, run.stored, estimator, beam_widths(scene, estimator))
        except ValueError:
            # A shot that carries no estimate leaves a gap.
            return
        found = harmonic_state(estimates_of(fit))[:MOST_HARMONICS]
        self._states.append(
            {"shot": shot.index + 1, **{key: [item[key] for item in found] for key in ("hz", "nm", "u_nm")}}
        )
        self._states = self._states[-MOST_SHOTS:]

    @property
    def state(self) -> list[State]:
        """Shot number, frequencies, amplitudes in nm and their standard uncertainties, of the first harmonics."""
        return self._states


@final
class TimeLeft:
    """Time until the last record, from how fast they have come since the page began to look."""

    def __init__(self) -> None:
        self._since: tuple[float, int] | None = None

    def left_s(self, records: int, planned: int, running: bool) -> float | None:
        """Return the time left; None where none is known: nothing has come since, or the run does not go on."""
        now_s = time.monotonic()
        if not running:
            # A pause must not count as a slow run afterwards.
            self._since = None
            return None
        if self._since is None:
            self._since = now_s, records
        since_s, before = self._since
        if records <= before or now_s <= since_s:
            return None
        return round((planned - records) * (now_s - since_s) / (records - before), 1)


def warnings_of(run: Run, shot: Shot, clipped: bool) -> Iterator[str]:
    """Yield what is not as it should be, the newest last: by the plan's checks, then by what has been recorded."""
    yield from (str(each) for each in run.findings if each.level == "warning")
    yield from (f"shot {index + 1} is not to be trusted: {why}" for index, why in run.stored.untrusted.items())
    before = [int(np.count_nonzero(~run.stored.records.recorded(index))) for index in range(shot.index)][-1:]
    if any(before):
        yield f"{before[0]} records of shot {shot.index} are missing"
    if clipped:
        yield f"an echo of shot {shot.index + 1} reaches full scale: a larger input range, or less gain"


def setting_of(shot: Shot) -> str:
    """Return the settings of ``shot`` that a scene may sweep, in words."""
    parts = [f"{shot.tracking_train.rate_hz:g} pulses a second", f"repeat {shot.repeat + 1}"]
    if shot.lateral_offset_m:
        parts.insert(0, f"{shot.lateral_offset_m * 1e3:g} mm beside the push")
    if shot.force_fraction is not None:
        parts.insert(0, f"force {shot.force_fraction:.4g} F₀")
    if shot.burst_train is not None:
        parts.insert(0, f"tonebursts of {shot.timeline.burst_length_s * 1e6:g} µs")
    return ", ".join(parts)
