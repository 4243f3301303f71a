"""Checklist of a plan: every conflict before anything is opened, each with keys, both numbers and the remedy."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Final

from hpe_rig.bench import BenchFile
from hpe_rig.plan.checks.acoustic_output import acoustic_output
from hpe_rig.plan.checks.check_result import CheckResult
from hpe_rig.plan.checks.depth_gates import gates_over_depth
from hpe_rig.plan.checks.digitizer import background, board, capture_mode, gate_in_record, memory, trigger_times
from hpe_rig.plan.checks.excitation import drive, excitation, generators, interference, transducer_limits
from hpe_rig.plan.checks.identity import commissioned, identity
from hpe_rig.plan.checks.sampling import driven_harmonics, fit_condition, fit_size, resolution, wanted_frequencies
from hpe_rig.plan.checks.simulation import simulation
from hpe_rig.plan.checks.timing import clocks, depth, periods, record_in_period, tracking_train
from hpe_rig.plan.checks.tracking import motion_between_pulses, trackable
from hpe_rig.plan.shots import Plan
from hpe_rig.scene import Scene, ScenePoint, forgotten_units

Check = Callable[[Scene, BenchFile, Plan], Iterator[CheckResult]]

TRACKING: Final[tuple[Check, ...]] = (interference, tracking_train)
ESTIMATE: Final[tuple[Check, ...]] = (
    *(wanted_frequencies, driven_harmonics, resolution, fit_size, fit_condition),
    *(gate_in_record, gates_over_depth, background, clocks),
)
CHECKS: Final[tuple[Check, ...]] = (
    *(simulation, identity, trackable, motion_between_pulses, excitation),
    *(generators, drive, transducer_limits, acoustic_output),
    *TRACKING,
    *(record_in_period, depth),
    *ESTIMATE,
    *(board, capture_mode, trigger_times, memory, periods, commissioned),
)
"""Every check, in the order of ``hpe-rig check``."""
RECORD_CHECKS: Final = (*TRACKING, *ESTIMATE)
"""Checks of imported records, which do not concern instruments."""
BEFORE_MEASUREMENT: Final = frozenset({motion_between_pulses})
"""Checks that only refuse, so that a measured run passed them. They compute the motion of the specimen."""


def check_plan(scene: Scene, bench: BenchFile, plan: Plan, measured: bool = False) -> list[CheckResult]:
    """Return the results of every check, passed ones included; equal results of a sweep's points occur once.

    Imported records are checked without the checks of instruments, a ``measured`` plan without `BEFORE_MEASUREMENT`.
    """
    checks = CHECKS if bench.recording is None else RECORD_CHECKS
    if measured:
        checks = tuple(check for check in checks if check not in BEFORE_MEASUREMENT)
    settings = [item for index, point in enumerate(scene.points) for item in _settings_at(index, point, bench, plan)]
    # Shots with equal settings give equal results, and each result is reported once.
    return list(dict.fromkeys(result for check in checks for item in settings for result in check(*item)))


def _settings_at(
    index: int, point: ScenePoint, bench: BenchFile, plan: Plan
) -> Iterator[tuple[Scene, BenchFile, Plan]]:
    """Yield scene, bench and shots of every offset, rate and window at point ``index`` of a sweep."""
    point_bench = bench.with_(point.bench)
    point_shots = [shot for shot in plan.shots if shot.point == index]
    for scene in (rate_scene for offset_scene in point.scene.places for rate_scene in offset_scene.rates):
        tracking = scene.tracking
        settings = tracking.pulse_rate_hz, tracking.lateral_offset_m, tracking.axial_offset_m
        shots = tuple(
            shot
            for shot in point_shots
            if (shot.tracking_train.rate_hz, shot.lateral_offset_m, shot.axial_offset_m) == settings
        )
        yield from ((window_scene, point_bench, replace(plan, shots=shots)) for window_scene in scene.windows)


def likely_causes(scene: Scene, results: Sequence[CheckResult]) -> Iterator[CheckResult]:
    """Yield the values that lack a unit's prefix, if ``results`` refuse the plan: they are probably the cause."""
    if any(result.level == "refused" for result in results):
        for mistake in forgotten_units(scene):
            yield CheckResult("forgotten unit", "refused", f"{mistake.path} = {mistake.what}", mistake.remedy)
