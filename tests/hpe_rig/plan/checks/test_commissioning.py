"""Warnings of real benches with unproven cables, in ``check`` and before a run."""

from __future__ import annotations

from collections.abc import Callable
from datetime import date
from pathlib import Path

import pytest

from hpe_rig.bench import parse_bench, read_bench
from hpe_rig.measurement import CableResult, prepare, record_commissioning
from hpe_rig.plan import CheckResult

RealBench = Callable[..., Path]


def commissioned(path: Path) -> Path:
    before = read_bench(path)
    results = [CableResult(cable.source, cable.target, 5e-9, 1e-9) for cable in before.bench.wiring]
    record_commissioning(path, before, results, date(2026, 11, 25))
    return path


def commissioning_checks(path: Path | None) -> list[CheckResult]:
    findings = prepare("bovine-muscle", path, refuse=False).findings
    return [finding for finding in findings if finding.check == "commissioning"]


def test_a_real_bench_that_was_never_commissioned_gets_a_warning(real_bench: RealBench) -> None:
    (finding,) = commissioning_checks(real_bench())
    assert finding.level == "warning"
    assert "hpe-rig commission" in finding.remedy


def test_a_commissioned_bench_passes_until_an_instrument_or_a_cable_changes(real_bench: RealBench) -> None:
    path = commissioned(real_bench())
    (finding,) = commissioning_checks(path)
    assert (finding.level, finding.text) == ("passed", "7 cables were proven on 2026-11-25")
    text = path.read_text(encoding="utf-8")
    for old, new in (
        ("GPIB0::13::INSTR", "GPIB0::23::INSTR"),
        ("delay_s = 5e-09", "delay_s = 6e-09"),
        ("33250A", "33600A"),
    ):
        path.write_text(text.replace(old, new, 1), encoding="utf-8")
        (finding,) = commissioning_checks(path)
        assert (finding.level, "changed since" in finding.text) == ("warning", True), old
    # Limits and comments prove nothing about cables.
    path.write_text(f"# Room 12\n{text}".replace("max_duty = 0.05", "max_duty = 0.04"), encoding="utf-8")
    assert commissioning_checks(path)[0].level == "passed"


def test_a_simulated_bench_needs_no_commissioning() -> None:
    assert commissioning_checks(None) == []


@pytest.mark.parametrize(("key", "value"), [("digest", '"5"'), ("date", '"today"'), ("cables", '"all"')])
def test_a_mistake_in_the_record_is_reported_with_its_key(real_bench: RealBench, key: str, value: str) -> None:
    text = commissioned(real_bench()).read_text(encoding="utf-8")
    lines = [f"{key} = {value}" if line.startswith(f"{key} = ") else line for line in text.splitlines()]
    with pytest.raises(Exception, match=f"commissioning.{key}"):
        parse_bench("metal", "\n".join(lines))
