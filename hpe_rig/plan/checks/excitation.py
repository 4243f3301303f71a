"""Checks of the excitation: tonebursts against limits, pulses and gates; tasks that generators refuse; drive."""

from __future__ import annotations

import math
from collections.abc import Iterator

from drivers.agilent import mistakes, model_named
from hpe_rig.bench import GENERATOR_ROLES, TRANSDUCERS, BenchFile, Drive, drive_mistakes
from hpe_rig.plan.checks.check_result import CheckResult, Level, in_hz, in_us, is_whole, pass_or_refuse
from hpe_rig.plan.interference import admissible_delays_s, disturbed_pulses, forbidden_window_s
from hpe_rig.plan.shots import Plan, Shot
from hpe_rig.scene import Scene


def excitation(scene: Scene, bench: BenchFile, plan: Plan) -> Iterator[CheckResult]:
    """Yield whether the bench can generate the tonebursts, and whether its limits allow them."""
    excitation, limits = scene.excitation, bench.limits
    if excitation is None:
        return
    if bench.generators.burst_train is None or bench.generators.toneburst is None:
        text = "the bench has no generators for [excitation]"
        remedy = "[generators.burst_train] and [generators.toneburst] in the bench file, "
        remedy += "or a scene without [excitation]"
        yield CheckResult("excitation generators", "refused", text, remedy)
    length_s, max_s = max(excitation.burst_length_s), limits.max_burst_length_s
    duty = length_s * excitation.burst_rate_hz
    text = f"duty f_r T_b = {duty:.3g}, limits.max_duty = {limits.max_duty:g}"
    remedy = f"excitation.burst_length_s of at most {in_us(limits.max_duty / excitation.burst_rate_hz)}"
    yield pass_or_refuse("duty", duty <= limits.max_duty, text, remedy)
    text = f"excitation.burst_length_s = {in_us(length_s)}, limits.max_burst_length_s = {in_us(max_s)}"
    yield pass_or_refuse("burst length", length_s <= max_s, text, f"at most {in_us(max_s)}")
    text = f"excitation.burst_count = {excitation.burst_count}, limits.max_bursts = {limits.max_bursts}"
    yield pass_or_refuse("bursts", excitation.burst_count <= limits.max_bursts, text, f"at most {limits.max_bursts}")
    if excitation.burst_count == 1:
        yield CheckResult("harmonics", "warning", "one toneburst leaves a transient, no harmonics", "burst_count = 20")
    for burst_length_s in excitation.burst_length_s:
        cycles = burst_length_s * excitation.carrier_hz
        nearest_s = max(1, round(cycles)) / excitation.carrier_hz
        text = f"a toneburst of {in_us(burst_length_s)} at {in_hz(excitation.carrier_hz)} has {cycles:.6g} cycles"
        remedy = f"excitation.burst_length_s = {nearest_s:.9g}, a whole number of cycles"
        yield pass_or_refuse("whole cycles", cycles >= 1 - 1e-9 and is_whole(cycles), text, remedy)


def interference(scene: Scene, bench: BenchFile, plan: Plan) -> Iterator[CheckResult]:
    """Yield, for every toneburst length, how many pulses or gates are disturbed."""
    if scene.excitation is None or any(shot.toneburst is None for shot in plan.shots):
        return
    # Shots with equal burst lengths have equal edges, so one of each length is checked.
    for shot in {shot.timeline.burst_length_s: shot for shot in plan.shots}.values():
        count, burst = int(disturbed_pulses(shot).sum()), in_us(shot.timeline.burst_length_s)
        if not count:
            yield CheckResult("interference", "passed", f"no pulse or gate meets a {burst} toneburst or its echo")
            continue
        text = (
            f"tracking.delay_s = {in_us(scene.tracking.delay_s)} lets tonebursts of "
            f"excitation.burst_length_s = {burst} or their echoes disturb {count} of {shot.capture.record_count} "
            "pulses or gates"
        )
        if scene.tracking.disturbed == "skip":
            yield CheckResult("interference", "passed", f"{text}; the estimate skips them")
            continue
        level: Level = "warning" if scene.tracking.disturbed == "keep" else "refused"
        yield CheckResult("interference", level, text, _delay_remedy(shot))


def _delay_remedy(shot: Shot) -> str:
    """Return in words the delays t_d without interference, or the pulse rates that have such delays."""
    period_s, (start_s, end_s) = 1 / shot.tracking_train.rate_hz, forbidden_window_s(shot)
    intervals = admissible_delays_s(shot)
    if intervals:
        # Rounded inwards: every printed value is admissible.
        inner_us = [(math.ceil(low * 1e7) / 10, math.floor(high * 1e7) / 10) for low, high in intervals]
        words = " or ".join(f"{low:g} to {high:g} us" for low, high in inner_us)
        return f"tracking.delay_s within {words} (plus any multiple of the pulse period, {in_us(period_s)})"
    max_hz = 1 / (end_s - start_s)
    rate = f"a tracking.pulse_rate_hz that is a multiple of the burst rate and below {in_hz(max_hz)}"
    return f'{rate} (no t_d is free at {in_hz(shot.tracking_train.rate_hz)}), or tracking.disturbed = "skip"'


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
