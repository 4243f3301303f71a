"""Checks of a real bench: generators known by serial number, cables proven to lead where the bench file says."""

from __future__ import annotations

from collections.abc import Iterator

from hpe_rig.bench import BenchFile
from hpe_rig.plan.checks.check_result import CheckResult, Level
from hpe_rig.plan.shots import Plan
from hpe_rig.scene import Scene


def identity(scene: Scene, bench: BenchFile, plan: Plan) -> Iterator[CheckResult]:
    """Yield whether exchanged generators would be noticed before tonebursts are triggered at the pulse rate.

    Settings read back cannot show an exchange: every generator reports the settings of the role at its address. The
    plan is refused where an exchange exceeds ``limits.max_duty``, a generator's ``serial`` is not stated, and the bench
    was not commissioned as it is.
    """
    if bench.simulated or scene.excitation is None:
        return
    generators = bench.generators.by_role
    missing = [role for role in plan.roles if role in generators and generators[role].serial is None]
    unknown = [role for role in plan.roles if role in generators and role not in bench.serials]
    if not unknown:
        yield CheckResult("identity", "passed", "every generator is known by its serial number or label")
        return
    rates = [
        (shot.toneburst.cycles / shot.toneburst.carrier_hz, shot.tracking_train.rate_hz)
        for shot in plan.shots
        if shot.toneburst is not None
    ]
    duty = max((length_s * rate_hz for length_s, rate_hz in rates), default=0.0)
    text = (
        f"generators without serial: {', '.join(unknown)}; if two of them were exchanged, tonebursts at the pulse "
        f"rate would have duty {duty:.3g}, limits.max_duty = {bench.limits.max_duty:g}"
    )
    commissioned = bench.commissioning is not None and bench.commissioning.digest == bench.commissioned_digest
    remedy = 'hpe-rig bench BENCH --identify, or serial = "none" for an instrument that keeps no label'
    level: Level = "refused" if missing and not commissioned and duty > bench.limits.max_duty else "warning"
    yield CheckResult("identity", level, text, remedy if missing else "hpe-rig bench before every run")


def commissioned(scene: Scene, bench: BenchFile, plan: Plan) -> Iterator[CheckResult]:
    """Yield whether every cable of a real bench was seen to lead where the bench file says."""
    if bench.simulated:
        return
    record, remedy = bench.commissioning, "hpe-rig commission BENCH, with the power amplifier off"
    if record is None:
        text = "no cable of this bench was proven to lead where [[wiring]] says, and the delays are as stated"
        yield CheckResult("commissioning", "warning", text, remedy)
    elif record.digest != bench.commissioned_digest:
        text = f"instruments or cables in the bench file were changed since the commissioning of {record.date}"
        yield CheckResult("commissioning", "warning", text, remedy)
    else:
        text = f"{len(record.cables)} cables were proven on {record.date}"
        yield CheckResult("commissioning", "passed", text)
