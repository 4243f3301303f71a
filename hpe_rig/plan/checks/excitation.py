"""Check of the excitation: generators, duty, length, count and whole cycles of the tonebursts."""

from __future__ import annotations

from collections.abc import Iterator

from hpe_rig.bench import BenchFile
from hpe_rig.plan.checks.check_result import CheckResult, in_us, is_whole, judged
from hpe_rig.plan.shots import Plan
from hpe_rig.scene import Scene


def excitation(scene: Scene, bench: BenchFile, plan: Plan) -> Iterator[CheckResult]:
    """Yield whether the bench can push as asked, and whether its limits allow it."""
    excitation, limits = scene.excitation, bench.limits
    if excitation is None:
        return
    if bench.generators.burst_train is None or bench.generators.toneburst is None:
        remedy = (
            "[generators.burst_train] and [generators.toneburst] in the bench file, or a scene without [excitation]"
        )
        yield CheckResult("excitation generators", "refused", "the bench has no generators for [excitation]", remedy)
    length_s, rate_hz = max(excitation.burst_length_s), excitation.burst_rate_hz
    duty = length_s * rate_hz
    text = f"duty f_r T_b = {duty:.3g}, limits.max_duty = {limits.max_duty:g}"
    yield judged(
        "duty",
        duty <= limits.max_duty,
        text,
        f"excitation.burst_length_s of at most {in_us(limits.max_duty / rate_hz)}",
    )
    text = (
        f"excitation.burst_length_s = {in_us(length_s)}, limits.max_burst_length_s = {in_us(limits.max_burst_length_s)}"
    )
    yield judged(
        "burst length", length_s <= limits.max_burst_length_s, text, f"at most {in_us(limits.max_burst_length_s)}"
    )
    text = f"excitation.burst_count = {excitation.burst_count}, limits.max_bursts = {limits.max_bursts}"
    yield judged("bursts", excitation.burst_count <= limits.max_bursts, text, f"at most {limits.max_bursts}")
    if excitation.burst_count == 1:
        yield CheckResult("harmonics", "warning", "one toneburst leaves a transient, no harmonics", "burst_count = 20")
    for burst_length_s in excitation.burst_length_s:
        cycles = burst_length_s * excitation.carrier_hz
        nearest_s = max(1, round(cycles)) / excitation.carrier_hz
        text = f"a toneburst of {in_us(burst_length_s)} at {excitation.carrier_hz:g} Hz has {cycles:.6g} cycles"
        good = cycles >= 1 - 1e-9 and is_whole(cycles)
        yield judged(
            "whole cycles", good, text, f"excitation.burst_length_s = {nearest_s:.9g}, a whole number of cycles"
        )
