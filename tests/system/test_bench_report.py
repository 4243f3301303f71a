"""``hpe-rig bench``: what stands on the bench, and how it differs from what a run remembers."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from typer.testing import CliRunner

from hpe_rig.bench import inventory as bench_report, read_bench
from hpe_rig.bench.inventory import survey
from hpe_rig.cli.app import app
from hpe_rig.cli.bench import bench_state, compare_with
from hpe_rig.measurement.run import record_run
from hpe_rig.measurement.setup import Setup, prepare
from sim_backend.world import World

Prepare = Callable[..., Setup]


def edited(tmp_path: Path, *edits: tuple[str, str]) -> Path:
    text = read_bench().text
    for old, new in edits:
        assert old in text, old
        text = text.replace(old, new)
    path = tmp_path / "edited.toml"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.fixture
def absent_bench(real_bench: Callable[..., Path]) -> Path:
    """Return the file of a bench at addresses that refuse connections."""
    return real_bench(address="TCPIP::127.0.0.1::{}::SOCKET")


def test_a_simulated_bench_behind_sockets_is_surveyed_through_them(tmp_path: Path) -> None:
    served = edited(tmp_path, ("simulated = true", 'simulated = true\ntransport = "socket"'))
    report = survey(read_bench(served).bench)
    assert report.complete
    assert [found.address for found in report.instruments[:-1]] == ["socket loopback"] * 5


def test_an_output_found_on_is_reported_and_switched_off(monkeypatch: pytest.MonkeyPatch) -> None:
    worlds: list[World] = []
    wire = World.connect

    def left_on(world: World, role: str):
        worlds.append(world)
        opened = wire(world, role)
        if role == "toneburst":
            opened.write("OUTP 1")
        return opened

    monkeypatch.setattr(World, "connect", left_on)
    report = survey(read_bench().bench)
    problems = {found.role: found.problems for found in report.instruments if found.problems}
    assert list(problems) == ["toneburst"]
    assert "its output was on; it is off now" in problems["toneburst"][0]
    assert not worlds[0].outputs_on()["toneburst"]


def test_an_instrument_whose_settings_cannot_be_read_is_one_row_of_the_table(monkeypatch: pytest.MonkeyPatch) -> None:
    """It says who it is, and answers joined queries in part."""
    wire = World.connect

    class Garbled:
        def __init__(self, inner) -> None:
            self.write, self.close, self.inner = inner.write, inner.close, inner

        def read(self) -> str:
            reply = self.inner.read()
            return reply.rpartition(";")[0] if reply.count(";") > 3 else reply

    monkeypatch.setattr(
        World, "connect", lambda world, role: Garbled(wire(world, role)) if role == "toneburst" else wire(world, role)
    )
    report = survey(read_bench().bench)
    assert [found.role for found in report.instruments if found.identity is None] == ["toneburst"]
    assert "queries had" in report.instruments[2].problems[0]
    assert len(report.settings) == 5


def test_a_bench_where_nobody_answers_is_a_table_of_errors_with_suggestions(
    absent_bench: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench = read_bench(absent_bench).bench
    address = bench.generators.master.address
    assert address is not None
    near = address.replace("127.0.0.1", "127.0.0.2")
    monkeypatch.setattr(bench_report, "visa_addresses", lambda: (near, "ASRL/dev/ttyS0::INSTR"))
    report = survey(bench)
    assert not report.complete
    assert all(found.identity is None for found in report.instruments)
    for found in report.instruments[:-1]:
        assert f"generators.{found.role}.address: did you mean {near}" in found.problems[1]
    assert "install the AlazarTech driver" in report.instruments[-1].problems[0]


def test_an_address_that_is_none_is_an_error_of_that_role(absent_bench: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # The first opening loads pyvisa, which takes long on a busy machine.
    monkeypatch.setattr("drivers.visa.connection.OPEN_TIMEOUT_S", 60.0)
    bench = read_bench(absent_bench).bench
    wrong = bench.generators.master.model_copy(update={"address": "not an address"})
    bench = bench.model_copy(update={"generators": bench.generators.model_copy(update={"master": wrong})})
    first = survey(bench).instruments[0]
    assert first.role == "master"
    assert "not an address" in first.problems[0]
    assert "hpe-rig bench" in first.problems[0]


def test_the_command_prints_the_table_and_exits_by_what_it_found(
    tmp_path: Path, absent_bench: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    bad = CliRunner().invoke(app, ["bench", str(absent_bench)])
    assert bad.exit_code == 1
    assert isinstance(bad.exception, SystemExit)
    assert bad.stdout.count(" problem") == 6
    good = CliRunner().invoke(app, ["bench"])
    assert good.exit_code == 0, good.stderr
    assert "SIMULATED" in good.stdout
    assert "tracking_pulser" in good.stdout
    assert CliRunner().invoke(app, ["bench", "--compare", "absent.h5"]).exit_code == 2
    refused = CliRunner().invoke(app, ["bench", "run.h5"])
    assert refused.exit_code == 2
    assert "records a bench but gives no access" in refused.stderr


def test_two_runs_are_compared_in_the_fields_words(prepared: Prepare, tmp_path: Path) -> None:
    first = record_run(prepared("bovine-muscle"), tmp_path / "first.h5")
    wider = edited(tmp_path, ("max_duty = 0.05", "max_duty = 0.04"))
    second = record_run(
        prepared("bovine-muscle", ("delay_s = 131e-6", "delay_s = 140e-6"), bench=wider), tmp_path / "second.h5"
    )
    lines = compare_with(first, bench_state(second)).splitlines()
    assert lines == [
        "2 differences",
        "  bench file: limits max duty 0.05 in first.h5, 0.04 in second.h5",
        "  tracking pulse train: delay 131 us in first.h5, 140 us in second.h5",
    ]
    assert compare_with(first, bench_state(first)) == "first.h5 and first.h5 do not differ"


def test_a_run_is_compared_with_the_bench_as_it_stands(tmp_path: Path) -> None:
    run = record_run(prepare("table-1"), tmp_path / "run.h5")
    # Programmed with programmed: an idle bench would differ in nearly everything.
    assert compare_with(run, bench_state(None)) == "run.h5 and the bench now do not differ"
    other = edited(
        tmp_path,
        ("max_duty = 0.05", "max_duty = 0.04"),
        ("amplitude_vpp = 1.0\n\n[digitizer]", "amplitude_vpp = 0.8\n\n[digitizer]"),
    )
    lines = compare_with(run, bench_state(other)).splitlines()
    assert lines[0] == "5 differences"
    assert "  tracking pulser: high 0.5 V in run.h5, 0.4 V in the bench now" in lines
