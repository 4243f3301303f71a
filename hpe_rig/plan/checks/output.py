"""Checks of the generators: what their drivers refuse, and the drive that the bench allows at the transducer."""

from __future__ import annotations

import math
from collections.abc import Iterator

from drivers.agilent import mistakes, model_named
from hpe_rig.bench import GENERATOR_ROLES, BenchFile
from hpe_rig.plan.checks.check_result import CheckResult, judged
from hpe_rig.plan.shots import Plan
from hpe_rig.scene import Scene


def generators(scene: Scene, bench: BenchFile, plan: Plan) -> Iterator[CheckResult]:
    """Yield what of the plan the generators of the bench file's models cannot do; their drivers would refuse it."""
    refused = [
        CheckResult("generators", "refused", f"{role}: {text}", f"{_KEYS[role]} within that")
        for role in GENERATOR_ROLES
        for text in _refused_tasks(role, bench, plan)
    ]
    yield from refused or [CheckResult("generators", "passed", "every generator can do what it is asked for")]


_KEYS = {
    "master": "generators.master.load_ohm",
    "burst_train": "excitation.burst_rate_hz, burst_length_s and burst_count",
    "toneburst": "excitation.force_fraction, carrier_hz and burst_length_s, limits.full_drive_vpp",
    "tracking_train": "tracking.pulse_rate_hz, pulse_count and delay_s",
    "tracking_pulser": "tracking.carrier_hz and cycles, generators.tracking_pulser.amplitude_vpp",
}


def _refused_tasks(role: str, bench: BenchFile, plan: Plan) -> dict[str, None]:
    """Return each mistake of the tasks of ``role`` once, in order."""
    generator = bench.generators.by_role.get(role)
    model = model_named(generator.model) if generator is not None else None
    if generator is None or model is None:
        return {}
    tasks = {task for shot in plan.shots if (task := getattr(shot, role)) is not None}
    return dict.fromkeys(text for task in tasks for text in mistakes(task, model, generator.max_vpp or math.inf))


def drive(scene: Scene, bench: BenchFile, plan: Plan) -> Iterator[CheckResult]:
    """Yield whether every generator that drives the transducer stays below ``limits.max_drive_vpp``."""
    most_vpp = bench.limits.max_drive_vpp
    if most_vpp is None:
        return
    bursts = {shot.toneburst.amplitude_vpp for shot in plan.shots if shot.toneburst is not None}
    pulses = {shot.tracking_pulser.amplitude_vpp for shot in plan.shots}
    for name, key, driven_vpp in (
        ("toneburst", "limits.full_drive_vpp", bursts),
        ("tracking pulse", "generators.tracking_pulser.amplitude_vpp", pulses),
    ):
        # A scene without [excitation] has no toneburst to judge.
        for vpp in sorted(driven_vpp)[-1:]:
            text = f"{name} of {vpp:g} Vpp, limits.max_drive_vpp = {most_vpp:g} Vpp"
            yield judged("drive", vpp <= most_vpp, text, f"{key} of at most {most_vpp:g}")
