"""Checks of the generators: tasks that their drivers refuse, and the drive that the bench allows at the transducer."""

from __future__ import annotations

import math
from collections.abc import Iterator

from drivers.agilent import mistakes, model_named
from hpe_rig.bench import GENERATOR_ROLES, TRANSDUCERS, BenchFile, Drive, drive_mistakes
from hpe_rig.plan.checks.check_result import CheckResult, pass_or_refuse
from hpe_rig.plan.shots import Plan, Shot
from hpe_rig.scene import Scene


def generators(scene: Scene, bench: BenchFile, plan: Plan) -> Iterator[CheckResult]:
    """Yield the tasks of the plan that the generators of the bench file's models cannot perform."""
    refused = [
        CheckResult("generators", "refused", f"{role}: {text}", f"{_KEYS[role]} within that")
        for role in GENERATOR_ROLES
        for text in _refused_tasks(role, bench, plan)
    ]
    yield from refused or [CheckResult("generators", "passed", "every generator can perform its task")]


_KEYS = {
    "master": "generators.master.load_ohm",
    "burst_train": "excitation.burst_rate_hz, burst_length_s and burst_count",
    "toneburst": "excitation.force_fraction, carrier_hz and burst_length_s, limits.full_drive_vpp",
    "tracking_train": "tracking.pulse_rate_hz, pulse_count and delay_s",
    "tracking_pulser": "tracking.carrier_hz and cycles, generators.tracking_pulser.amplitude_vpp",
}
"""Settings keys that determine the task of each role."""


def _refused_tasks(role: str, bench: BenchFile, plan: Plan) -> dict[str, None]:
    """Return each mistake of the tasks of ``role`` once, in order."""
    generator = bench.generators.by_role.get(role)
    model = model_named(generator.model) if generator is not None else None
    if generator is None or model is None:
        return {}
    tasks = {task for shot in plan.shots if (task := getattr(shot, role)) is not None}
    return dict.fromkeys(text for task in tasks for text in mistakes(task, model, generator.max_vpp or math.inf))


def drive(scene: Scene, bench: BenchFile, plan: Plan) -> Iterator[CheckResult]:
    """Yield whether every generator that drives the transducer stays within ``limits.max_drive_vpp``."""
    max_vpp = bench.limits.max_drive_vpp
    if max_vpp is None:
        return
    # A scene without [excitation] has no tonebursts.
    bursts_vpp = {shot.toneburst.amplitude_vpp for shot in plan.shots if shot.toneburst is not None}
    if bursts_vpp:
        text = f"toneburst of {max(bursts_vpp):g} Vpp, limits.max_drive_vpp = {max_vpp:g} Vpp"
        remedy = f"limits.full_drive_vpp of at most {max_vpp:g}"
        yield pass_or_refuse("drive", max(bursts_vpp) <= max_vpp, text, remedy)
    pulse_vpp = max(shot.tracking_pulser.amplitude_vpp for shot in plan.shots)
    text = f"tracking pulse of {pulse_vpp:g} Vpp, limits.max_drive_vpp = {max_vpp:g} Vpp"
    remedy = f"generators.tracking_pulser.amplitude_vpp of at most {max_vpp:g}"
    yield pass_or_refuse("drive", pulse_vpp <= max_vpp, text, remedy)


def transducer_limits(scene: Scene, bench: BenchFile, plan: Plan) -> Iterator[CheckResult]:
    """Yield the limits of each output at a transducer that no other check covers.

    All limits are compared once more with the settings read back, before an output is enabled.
    """
    drives = {drive for shot in plan.shots for drive in _drives(shot) if drive.role in bench.generators.by_role}
    mistakes = [(drive.role, *mistake) for drive in drives for mistake in drive_mistakes(bench, drive)]
    texts = {text for role, key, text in mistakes if key in _LIMITS[role]}
    remedy = "fewer cycles, a lower rate, or a carrier in the band"
    refused = [CheckResult("transducer limits", "refused", text, remedy) for text in sorted(texts)]
    yield from refused or [CheckResult("transducer limits", "passed", "carriers and tracking pulses are within them")]
    driving = {cable.source.removesuffix(".output") for cable in bench.wiring if cable.target in TRANSDUCERS}
    for role, generator in bench.generators.by_role.items():
        if generator.carrier_band_hz is not None and role not in driving:
            text = f"generators.{role}.carrier_band_hz has no effect: no cable leads from {role}.output to a transducer"
            yield CheckResult("transducer limits", "warning", text, "the key at the generator that drives it")


_LIMITS = {
    "toneburst": ("carrier_band_hz",),
    "tracking_pulser": ("max_duty", "max_burst_length_s", "carrier_band_hz"),
}
"""Limits by role that the checks of excitation and drive do not cover."""


def _drives(shot: Shot) -> Iterator[Drive]:
    """Yield the drives of ``shot`` at its transducers."""
    for role, burst, train in (
        ("tracking_pulser", shot.tracking_pulser, shot.tracking_train),
        ("toneburst", shot.toneburst, shot.burst_train),
    ):
        if burst is not None and train is not None:
            yield Drive(role, burst.carrier_hz, burst.cycles, burst.amplitude_vpp, train.rate_hz)
