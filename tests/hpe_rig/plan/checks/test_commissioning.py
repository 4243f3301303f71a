"""Warnings of real benches with unproven cables, in ``check`` and before a run."""

from __future__ import annotations

from datetime import date
from pathlib import Path

import pytest

from hpe_rig.bench import parse_bench, read_bench
from hpe_rig.measurement import CableResult, prepare, record_commissioning
from hpe_rig.plan import CheckResult


def bench_file(folder: Path, *edits: tuple[str, str]) -> Path:
    text = read_bench().text
    for old, new in (
        ("simulated = true", "simulated = false"),
        ("Simulated bench, wired as Fig. 2 of the paper", "Bench on metal"),
        ("assumed: no hydrophone has seen it", "A. Tester, with a hydrophone"),
        ('model = "33250A"\n', 'model = "33250A"\naddress = "GPIB0::10::INSTR"\n'),
    ):
        assert old in text
        text = text.replace(old, new)
    # Every generator has its address.
    for number in range(5):
        text = text.replace('address = "GPIB0::10::INSTR"', f'address = "GPIB0::{11 + number}::INSTR"', 1)
    for old, new in edits:
        assert old in text, old
        text = text.replace(old, new)
    path = folder / "metal.toml"
    path.write_text(text, encoding="utf-8")
    return path


def commissioned(path: Path) -> Path:
    before = read_bench(path)
    results = [CableResult(cable.source, cable.target, 5e-9, 1e-9) for cable in before.bench.wiring]
    record_commissioning(path, before, results, date(2026, 11, 25))
    return path


def commissioning_checks(path: Path | None) -> list[CheckResult]:
    findings = prepare("bovine-muscle", path, refuse=False).findings
    return [finding for finding in findings if finding.check == "commissioning"]


def test_a_real_bench_that_was_never_commissioned_gets_a_warning(tmp_path: Path) -> None:
    (finding,) = commissioning_checks(bench_file(tmp_path))
    assert finding.level == "warning"
    assert "hpe-rig commission" in finding.remedy


def test_a_commissioned_bench_passes_until_an_instrument_or_a_cable_changes(tmp_path: Path) -> None:
    path = commissioned(bench_file(tmp_path))
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
def test_a_mistake_in_the_record_is_reported_with_its_key(tmp_path: Path, key: str, value: str) -> None:
    text = commissioned(bench_file(tmp_path)).read_text(encoding="utf-8")
    lines = [f"{key} = {value}" if line.startswith(f"{key} = ") else line for line in text.splitlines()]
    with pytest.raises(Exception, match=f"commissioning.{key}"):
        parse_bench("metal", "\n".join(lines))
