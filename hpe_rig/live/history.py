"""History of a run over its shots: amplitudes of the complete ones, means over repeats, remaining time, warnings."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from typing import final

import numpy as np

from hpe_rig.live.state import State, harmonic_state
from hpe_rig.plan import Shot, off_axis_offsets_m, phase_reference_of, scene_of_shot
from hpe_rig.prediction import beam_widths, predicted_averaging
from hpe_rig.processing import HarmonicFit, error_sources_of, estimates_of, shot_averaging, shot_fit
from hpe_rig.result import Estimate, ShotResult, repeat_means, setting_of
from hpe_rig.runs import Run

MAX_SHOTS = 2_000
"""Shots with amplitudes in the state; a screen resolves no more."""
MAX_HARMONICS = 6
UPDATE_TIME_S, FINAL_UPDATE_TIME_S = 0.25, 3.0
"""Time for estimates in one state, during and after the run; further complete shots wait for the next state."""


def estimates_with_sources(run: Run, shot: Shot, fit: HarmonicFit, estimator: str) -> tuple[Estimate, ...]:
    """Return the estimates of ``fit`` with beam averaging and the scene's error sources, as in a result.

    The sources that need all records are missing: ends of the gate, rounding to codes, lost first pulses, and in a shot
    that is not complete the rate error of the clocks. Phases count from a stated time zero at its nominal delay.
    """
    scene = scene_of_shot(run.scene, shot)
    predicted = predicted_averaging(scene, estimator, off_axis_offsets_m(run.plan))
    sources = error_sources_of(scene, run.stored.simulated)
    averaging = shot_averaging(scene, fit, predicted)
    return estimates_of(fit, sources, averaging, reference=phase_reference_of(scene, shot))


@final
class ShotHistory:
    """Estimates of the complete shots, each computed once."""

    def __init__(self) -> None:
        self._next = 0
        self._states: list[State] = []
        self._results: list[ShotResult] = []

    def advance(self, run: Run) -> int:
        """Estimate newly completed shots for the time of one state; return the number that remain."""
        until_s = time.monotonic() + (UPDATE_TIME_S if run.stored.status == "running" else FINAL_UPDATE_TIME_S)
        while self._next < len(run.plan.shots) and run.stored.shot_complete[self._next]:
            self._append(run, run.plan.shots[self._next])
            self._next += 1
            if time.monotonic() > until_s:
                return int(np.count_nonzero(run.stored.shot_complete[self._next :]))
        return 0

    def _append(self, run: Run, shot: Shot) -> None:
        if shot.is_control or shot.index in run.stored.marks:
            return
        scene = scene_of_shot(run.scene, shot)
        estimator = scene.processing.estimator
        try:
            fit = shot_fit(scene, shot, run.stored, estimator, beam_widths(scene, estimator))
        except ValueError:
            # A shot without an estimate leaves a gap in the curve.
            return
        estimates = estimates_with_sources(run, shot, fit, estimator)
        self._results.append(_shot_result(shot, estimates, run.stored.untrusted.get(shot.index, "")))
        harmonics = harmonic_state(estimates)[:MAX_HARMONICS]
        self._states.append(
            {"shot": shot.index + 1, **{key: [item[key] for item in harmonics] for key in ("hz", "nm", "u_nm")}}
        )
        self._states = self._states[-MAX_SHOTS:]

    def means(self, shot: Shot) -> State:
        """Return the means over the complete shots with the settings of ``shot``, as in a result; empty below two."""
        setting = setting_of(_shot_result(shot))
        means = repeat_means([result for result in self._results if setting_of(result) == setting])
        return {"means": harmonic_state(means), "mean_of": len(means[0].shots)} if means else {}

    @property
    def state(self) -> list[State]:
        """Shot number, frequencies, amplitudes in nm and their standard uncertainties, of the first harmonics."""
        return self._states


def _shot_result(shot: Shot, estimates: tuple[Estimate, ...] = (), untrusted: str = "") -> ShotResult:
    """Return the fields of the shot's result that its mean over repeats depends on; pulses are not counted."""
    return ShotResult(
        shot.index,
        shot.repeat,
        shot.timeline.burst_length_s,
        shot.force_fraction,
        pulses_used=0,
        pulses_missing=0,
        residual_m=math.nan,
        estimates=estimates,
        warnings=(),
        pulse_rate_hz=shot.tracking_train.rate_hz,
        lateral_offset_m=shot.lateral_offset_m,
        axial_offset_m=shot.axial_offset_m,
        # Points of a sweep differ in any setting; their number is as distinct as their values.
        swept={"point": shot.point},
        untrusted=untrusted,
    )


@final
class RemainingTime:
    """Time until the last record, from the rate of arrival since the page started."""

    def __init__(self) -> None:
        self._start: tuple[float, int] | None = None

    def remaining_s(self, records: int, planned: int, running: bool) -> float | None:
        """Return the remaining time; None before any new record, and while the run is not active."""
        now_s = time.monotonic()
        if not running:
            # A pause must not reduce the rate of arrival.
            self._start = None
            return None
        if self._start is None:
            self._start = now_s, records
        start_s, first_records = self._start
        if records <= first_records or now_s <= start_s:
            return None
        return round((planned - records) * (now_s - start_s) / (records - first_records), 1)


def warnings_of(run: Run, shot: Shot, clipped: bool) -> Iterator[str]:
    """Yield the warnings of the plan's checks, then those of the records, the newest last."""
    yield from (str(check) for check in run.findings if check.level == "warning")
    yield from (f"shot {index + 1} is not to be trusted: {reason}" for index, reason in run.stored.untrusted.items())
    yield from (f"shot {index + 1} {why}" for index, why in run.stored.marks.items())
    missing = [int(np.count_nonzero(~run.stored.records.arrival(index).recorded)) for index in range(shot.index)][-1:]
    if any(missing):
        yield f"{missing[0]} records of shot {shot.index} are missing"
    # The echo on the page may be that of a disturbed pulse, which a larger range does not mend.
    if clipped and run.scene.tracking.disturbed != "skip":
        yield f"an echo of shot {shot.index + 1} reaches full scale: increase the input range, or reduce the gain"


def setting_text(shot: Shot) -> str:
    """Return the settings of ``shot`` in words."""
    texts = [f"{shot.tracking_train.rate_hz:g} pulses a second", f"repeat {shot.repeat + 1}"]
    if shot.lateral_offset_m:
        texts.insert(0, f"{shot.lateral_offset_m * 1e3:g} mm from the push")
    if shot.force_fraction is not None and not shot.is_control:
        texts.insert(0, f"force {shot.force_fraction:.4g} F₀")
    if shot.is_control:
        texts.insert(0, "control with tonebursts off")
    elif shot.burst_train is not None:
        texts.insert(0, f"tonebursts of {shot.timeline.burst_length_s * 1e6:g} µs")
    return ", ".join(texts)
