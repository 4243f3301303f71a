"""Check that the cables of a real bench were commissioned, and not changed since."""

from __future__ import annotations

from collections.abc import Iterator

from hpe_rig.bench import BenchFile, commissioned_digest
from hpe_rig.plan.checks.check_result import CheckResult
from hpe_rig.plan.shots import Plan
from hpe_rig.scene import Scene


def commissioned(scene: Scene, bench: BenchFile, plan: Plan) -> Iterator[CheckResult]:
    """Yield whether every cable of a real bench was seen to lead where the bench file says."""
    if bench.simulated:
        return
    record, remedy = bench.commissioning, "hpe-rig commission BENCH, with the power amplifier off"
    if record is None:
        text = "no cable of this bench was proven to lead where [[wiring]] says, and the delays are as stated"
        yield CheckResult("commissioning", "warning", text, remedy)
    elif record.digest != commissioned_digest(bench):
        text = f"instruments or cables in the bench file were changed since the commissioning of {record.date}"
        yield CheckResult("commissioning", "warning", text, remedy)
    else:
        text = f"{len(record.cables)} cables were proven on {record.date}"
        yield CheckResult("commissioning", "passed", text)
