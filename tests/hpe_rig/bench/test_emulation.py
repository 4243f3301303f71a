"""A real bench file is served on loopback, and the file written beside it is measured with as the real one would be."""

from __future__ import annotations

import socket
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import patch

import pytest
from typer.testing import CliRunner

from hpe_rig.bench import is_bench_file, read_bench
from hpe_rig.cli.app import app
from hpe_rig.measurement import prepare, record_run
from hpe_rig.store import read_run

SERIALS = {
    **{role: f"HPE_00000{n}" for n, role in enumerate(read_bench().bench.generators.by_role)},
    "digitizer": "460777",
}


@pytest.fixture
def free_port() -> int:
    with closing(socket.create_server(("127.0.0.1", 0))) as server:
        return int(server.getsockname()[1])


@pytest.fixture
def real(tmp_path: Path, free_port: int) -> Path:
    """Return a real bench file: one generator on a socket of this machine, the others on GPIB, all with labels."""
    text = read_bench().text.replace("simulated = true", "simulated = false").replace("Simulated bench", "Bench")
    for number, role in enumerate(read_bench().bench.generators.by_role):
        address = f"TCPIP0::localhost::{free_port}::SOCKET" if role == "master" else f"GPIB0::{10 + number}::INSTR"
        lines = f'[generators.{role}]\naddress = "{address}"\nserial = "{SERIALS[role]}"'
        text = text.replace(f"[generators.{role}]", lines)
    text = text.replace("[digitizer]", f'[digitizer]\nserial = "{SERIALS["digitizer"]}"')
    path = tmp_path / "room-12.toml"
    # TOML allows an indented key.
    path.write_text(text.replace("simulated = false", "  simulated = false"), encoding="utf-8")
    return path


@pytest.fixture
def emulated(real: Path, free_port: int) -> Path:
    """Return the bench file that ``hpe-rig emulate`` writes, after a question to the served master and Ctrl-C."""
    path = real.with_name("emulated.toml")

    def ask_master_and_interrupt(_: float) -> None:
        with socket.create_connection(("127.0.0.1", free_port), timeout=20) as line:
            line.sendall(b"*IDN?\n")
            assert b"33250A" in line.makefile("rb").readline()
        raise KeyboardInterrupt

    with patch("hpe_rig.bench.emulation.time", SimpleNamespace(sleep=ask_master_and_interrupt)):
        done = CliRunner().invoke(app, ["emulate", str(real), "-o", str(path)], catch_exceptions=False)
    assert done.exit_code == 0, done.output
    assert f"hpe-rig commission {path}" in done.output
    return path


def test_a_real_bench_file_is_rehearsed_with_its_serials_wiring_and_limits(
    emulated: Path, real: Path, free_port: int, tmp_path: Path
) -> None:
    bench, before = read_bench(emulated).bench, read_bench(real).bench
    assert (bench.simulated, bench.emulated, bench.transport) == (True, True, "socket")
    assert bench.generators.master.address == f"TCPIP0::127.0.0.1::{free_port}::SOCKET"
    assert all("::127.0.0.1::" in (item.address or "") for item in bench.generators.by_role.values())
    assert (bench.wiring, bench.limits, bench.serials) == (before.wiring, before.limits, SERIALS)

    shown = CliRunner().invoke(app, ["bench", str(emulated), "--json"])
    assert shown.exit_code == 0, shown.output
    assert all(serial in shown.stdout for serial in SERIALS.values())
    run = read_run(record_run(prepare("table-1", emulated), tmp_path / "run.h5"))
    assert (run.status, run.simulated) == ("complete", True)


def test_without_its_key_the_serial_numbers_of_a_file_are_compared_with_those_of_the_twin(emulated: Path) -> None:
    emulated.write_text(emulated.read_text("utf-8").replace("emulated = true\n", ""), encoding="utf-8")
    shown = CliRunner().invoke(app, ["bench", str(emulated)])
    assert shown.exit_code == 1
    assert "expected HPE_000000" in shown.output


def test_a_port_of_the_bench_file_that_another_program_uses_is_named(real: Path, free_port: int) -> None:
    with closing(socket.create_server(("127.0.0.1", free_port))):
        refused = CliRunner().invoke(app, ["emulate", str(real), "-o", str(real.with_name("emulated.toml"))])
    assert refused.exit_code == 1
    assert f"ports of the bench file (master {free_port})" in " ".join(refused.output.split())


def test_a_bench_file_is_told_from_a_scene(real: Path, tmp_path: Path) -> None:
    assert is_bench_file(str(real))
    assert not is_bench_file("bovine-muscle")
    assert CliRunner().invoke(app, ["new", str(tmp_path / "scene.toml")]).exit_code == 0
    assert not is_bench_file(str(tmp_path / "scene.toml"))
    refused = CliRunner().invoke(app, ["emulate", str(real), "--bench", str(real)])
    assert refused.exit_code == 2
    assert "is a bench file too" in refused.output
    absent = CliRunner().invoke(app, ["emulate", str(tmp_path / "nothere.toml")])
    assert absent.exit_code == 2
    assert "there is no file" in absent.output
    assert "path of a bench file or a scene" in " ".join(absent.output.split())
