"""What a plan would put out against what generators can and the bench allows, up to the estimated acoustic output."""

from __future__ import annotations

import math
from collections.abc import Iterator

from drivers.agilent import (
    GeneratorModel,
    model_named,
    pulse_train_mistakes,
    toneburst_mistakes,
    trigger_pulse_mistakes,
    wiring_mistakes,
)
from drivers.interfaces import PulseTrain, Toneburst, TriggerPulse
from hpe_rig.bench import GENERATOR_ROLES, BenchFile, Limits
from hpe_rig.plan.checks.acoustic_output import AcousticOutput, highest_output, uncalibrated
from hpe_rig.plan.checks.check_result import Finding, judged
from hpe_rig.plan.shots import Plan

Task = TriggerPulse | PulseTrain | Toneburst


def generators(bench: BenchFile, plan: Plan) -> Iterator[Finding]:
    """Yield what of the plan the generators of the bench file's models cannot do; their drivers would refuse it."""
    found = False
    for role in GENERATOR_ROLES:
        generator = bench.generators.by_role.get(role)
        model = model_named(generator.model) if generator is not None else None
        tasks = {task for shot in plan.shots if (task := getattr(shot, role)) is not None}
        if generator is None or model is None:
            continue
        most_v = math.inf if generator.max_vpp is None else generator.max_vpp
        for text in dict.fromkeys(text for task in tasks for text in _mistakes(task, model, most_v)):
            found = True
            yield Finding("generators", "refused", f"{role}: {text}", f"{_KEYS[role]} within that")
    if not found:
        yield Finding("generators", "passed", "every generator can do what it is asked for")


_KEYS = {
    "master": "generators.master.load_ohm",
    "burst_train": "excitation.burst_rate_hz, burst_length_s and burst_count",
    "toneburst": "excitation.force_fraction, carrier_hz and burst_length_s, limits.full_drive_vpp",
    "tracking_train": "tracking.pulse_rate_hz, pulse_count and delay_s",
    "tracking_pulser": "tracking.carrier_hz and cycles, generators.tracking_pulser.amplitude_vpp",
}


def _mistakes(task: Task, model: GeneratorModel, most_v: float) -> list[str]:
    match task:
        case TriggerPulse():
            return [*trigger_pulse_mistakes(task, model), *wiring_mistakes("high_v", task.high_v, most_v)]
        case PulseTrain():
            return [*pulse_train_mistakes(task, model), *wiring_mistakes("high_v", task.high_v, most_v)]
        case Toneburst():
            return [*toneburst_mistakes(task, model), *wiring_mistakes("amplitude_vpp", task.amplitude_vpp, most_v)]


def drive(bench: BenchFile, plan: Plan) -> Iterator[Finding]:
    """Yield whether every generator that drives the transducer stays below ``limits.max_drive_vpp``."""
    most_vpp = bench.limits.max_drive_vpp
    if most_vpp is None:
        return
    bursts = {shot.toneburst.amplitude_vpp for shot in plan.shots if shot.toneburst is not None}
    pulses = {shot.tracking_pulser.amplitude_vpp for shot in plan.shots}
    for name, key, values in (
        ("toneburst", "limits.full_drive_vpp", bursts),
        ("tracking pulse", "generators.tracking_pulser.amplitude_vpp", pulses),
    ):
        text = f"{name} of {max(values, default=0.0):g} Vpp, limits.max_drive_vpp = {most_vpp:g} Vpp"
        yield judged("drive", max(values, default=0.0) <= most_vpp, text, f"{key} of at most {most_vpp:g}")


def acoustic_output(bench: BenchFile, plan: Plan) -> Iterator[Finding]:
    """Yield whether the estimated output stays below the limits, and what could not be estimated."""
    unknown = dict.fromkeys(words for shot in plan.shots for words in uncalibrated(bench.calibration, shot))
    if unknown:
        text = f"not estimated in full: {'; '.join(unknown)}"
        yield Finding("acoustic output", "warning", text, "a hydrophone measurement in [calibration] of the bench file")
    if bench.calibration is None:
        return
    limits, output = bench.limits, highest_output(bench, plan.shots)
    text = (
        f"derated MI {output.mechanical_index:.3g} (limit {limits.max_mechanical_index:g}) or "
        f"I_sppa {output.sppa_w_per_m2 / 1e4:.3g} W/cm2 (limit {limits.max_sppa_w_per_m2 / 1e4:g}), "
        f"I_spta {output.spta_w_per_m2 / 10:.3g} mW/cm2 (limit {limits.max_spta_w_per_m2 / 10:g})"
    )
    yield judged("acoustic output", output.within(limits), text, _quieter(output, limits))


def _quieter(output: AcousticOutput, limits: Limits) -> str:
    average = limits.max_spta_w_per_m2 / max(output.spta_w_per_m2, 1e-300)
    index = limits.max_mechanical_index / max(output.mechanical_index, 1e-300)
    peak = max(index, math.sqrt(limits.max_sppa_w_per_m2 / max(output.sppa_w_per_m2, 1e-300)))
    share = min(peak, math.sqrt(average))
    words = f"amplitudes of at most {100 * share:.3g} % (limits.full_drive_vpp, generators.tracking_pulser)"
    return words + (f", or excitation.burst_length_s of {100 * average:.3g} %" if average < 1 <= peak else "")
