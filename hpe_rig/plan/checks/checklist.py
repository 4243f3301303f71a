"""Checklist of a plan: every conflict before anything is opened, each with keys, both numbers and the remedy."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Final

from hpe_rig.bench import BenchFile
from hpe_rig.plan.checks.acoustic_output import acoustic_output
from hpe_rig.plan.checks.check_result import CheckResult
from hpe_rig.plan.checks.depth_gates import gates_over_depth
from hpe_rig.plan.checks.digitizer import background, board, capture_mode, gate_in_record, memory
from hpe_rig.plan.checks.excitation import excitation, interference
from hpe_rig.plan.checks.output import drive, generators
from hpe_rig.plan.checks.sampling import driven_harmonics, fit_condition, fit_size, resolution, wanted_frequencies
from hpe_rig.plan.checks.simulation import simulation
from hpe_rig.plan.checks.timing import depth, periods, record_in_period, tracking_train
from hpe_rig.plan.checks.tracking import trackable
from hpe_rig.plan.shots import Plan, Shot
from hpe_rig.scene import Scene, ScenePoint, forgotten_units

Check = Callable[[Scene, BenchFile, Plan], Iterator[CheckResult]]

PUSH: Final[tuple[Check, ...]] = (simulation, trackable, excitation, generators, drive, acoustic_output)
TRACKING: Final[tuple[Check, ...]] = (interference, tracking_train)
PULSE_PERIOD: Final[tuple[Check, ...]] = (record_in_period, depth)
ESTIMATE: Final[tuple[Check, ...]] = (
    wanted_frequencies,
    driven_harmonics,
    resolution,
    fit_size,
    fit_condition,
    gate_in_record,
    gates_over_depth,
    background,
)
BOARD: Final[tuple[Check, ...]] = (board, capture_mode, memory, periods)
CHECKS: Final[tuple[Check, ...]] = (*PUSH, *TRACKING, *PULSE_PERIOD, *ESTIMATE, *BOARD)
"""Every check, in the order in which ``hpe-rig check`` prints them."""
OF_RECORDS: Final[tuple[Check, ...]] = (*TRACKING, *ESTIMATE)
"""The checks that records have to pass which were imported: they ask nothing of instruments."""


def check_plan(scene: Scene, bench: BenchFile, plan: Plan) -> list[CheckResult]:
    """Return what every check found, passed ones included; of a sweep once each.

    Of imported records those alone that ask nothing of instruments.
    """
    checks = CHECKS if bench.recording is None else OF_RECORDS
    parts = [part for number, point in enumerate(scene.points) for part in _parts(number, point, bench, plan)]
    return list(dict.fromkeys(result for check in checks for part in parts for result in check(*part)))


def likely_causes(scene: Scene, found: Sequence[CheckResult]) -> Iterator[CheckResult]:
    """Yield the values that a forgotten unit explains, where ``found`` refuses something: likely they are the cause."""
    if any(result.level == "refused" for result in found):
        for likely in forgotten_units(scene):
            yield CheckResult("forgotten unit", "refused", f"{likely.path} = {likely.what}", likely.remedy)


def _parts(number: int, point: ScenePoint, bench: BenchFile, plan: Plan) -> Iterator[tuple[Scene, BenchFile, Plan]]:
    """Yield scene, bench and shots of every place, rate and window of the point ``number`` of a sweep."""
    there = bench.with_(point.bench)
    here = replace(plan, shots=tuple(shot for shot in plan.shots if shot.point == number))
    for rate in (rate for place in point.scene.places for rate in place.rates):
        yield from ((window, there, _at(rate, here)) for window in rate.windows)


def _at(scene: Scene, plan: Plan) -> Plan:
    """Return the part of ``plan`` that has the scene's pulse rate and place."""
    own = scene.tracking
    wanted = own.pulse_rate_hz, own.lateral_offset_m, own.axial_offset_m
    return replace(plan, shots=tuple(shot for shot in plan.shots if _setting(shot) == wanted))


def _setting(shot: Shot) -> tuple[float, float, float]:
    return shot.tracking_train.rate_hz, shot.lateral_offset_m, shot.axial_offset_m
