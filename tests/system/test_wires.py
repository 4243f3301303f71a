"""Whole measurements over every real transport, siblings of the 33250A, and the emulator for other VISA programs."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

import numpy as np
import pytest
import pyvisa

from drivers.interfaces import InstrumentError
from hpe_rig.bench import TRANSPORTS, BenchFile, parse_bench, read_bench
from hpe_rig.bench.emulation import addressed
from hpe_rig.bench.opening import open_bench, open_each
from hpe_rig.measurement.run import record_run
from hpe_rig.measurement.setup import prepare
from hpe_rig.plan.checks.check_result import PlanError
from hpe_rig.store import read_run
from sim_backend.transports import emulator
from sim_backend.transports.lines import SerialServer
from sim_backend.transports.loopback import Port

needs_pty = pytest.mark.skipif(sys.platform == "win32", reason="needs a pseudo terminal")
FAST = {"socket"}
"""The other transports are marked slow."""
OVER = [
    pytest.param(name, marks=[*[needs_pty] * (name == "serial"), *[pytest.mark.slow] * (name not in FAST)])
    for name in TRANSPORTS
]
SIMULATED = read_bench().text


def bench_over(folder: Path, transport: str, *edits: tuple[str, str]) -> Path:
    text = SIMULATED.replace("simulated = true", f'simulated = true\ntransport = "{transport}"')
    for old, new in edits:
        assert old in text
        text = text.replace(old, new)
    path = folder / f"{transport}.toml"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.fixture(scope="module", params=[pytest.param("table-1", marks=pytest.mark.slow), "bovine-muscle"])
def in_process(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[str, Path]:
    path = tmp_path_factory.mktemp("in_process") / "run.h5"
    return request.param, record_run(prepare(request.param), path)


@needs_pty
def test_a_measurement_over_serial_lines_that_lose_bytes_beyond_256_gives_the_records_of_the_one_in_process(
    in_process: tuple[str, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene, path = in_process
    lines: list[SerialServer] = []

    def narrow_line(port: Port) -> SerialServer:
        lines.append(SerialServer(port, buffer_bytes=256, busy_s=0.002))
        return lines[-1]

    monkeypatch.setattr(emulator, "SERVERS", {**emulator.SERVERS, "serial": narrow_line})
    over = read_run(record_run(prepare(scene, bench_over(tmp_path, "serial")), tmp_path / "run.h5"))
    direct = read_run(path)
    assert over.status == "complete"
    assert len(lines) == 5
    assert sum(line.lost_bytes for line in lines) == 0
    for one, other in zip(over.records, direct.records, strict=True):
        np.testing.assert_array_equal(one.codes, other.codes)


@pytest.mark.parametrize(
    "transport", [TRANSPORTS[0], *(pytest.param(name, marks=pytest.mark.slow) for name in TRANSPORTS[1:])]
)
def test_a_measurement_over_a_real_transport_gives_the_records_of_the_one_in_process(
    in_process: tuple[str, Path], transport: str, tmp_path: Path
) -> None:
    scene, path = in_process
    over = read_run(record_run(prepare(scene, bench_over(tmp_path, transport)), tmp_path / "run.h5"))
    direct = read_run(path)
    assert over.status == direct.status == "complete"
    for one, other in zip(over.records, direct.records, strict=True):
        np.testing.assert_array_equal(one.codes, other.codes)
        np.testing.assert_array_equal(one.trigger_time_s, other.trigger_time_s)


@pytest.mark.slow
def test_a_measurement_over_a_serial_line_behind_tcp_gives_the_same_records(
    in_process: tuple[str, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As on Windows, where there are no pseudo terminals."""
    monkeypatch.delattr(os, "openpty", raising=False)
    scene, path = in_process
    over = read_run(record_run(prepare(scene, bench_over(tmp_path, "serial")), tmp_path / "run.h5"))
    for one, other in zip(over.records, read_run(path).records, strict=True):
        np.testing.assert_array_equal(one.codes, other.codes)


MODELS = {"33500B": "Agilent Technologies,33522B", "33600A": "Keysight Technologies,33622A"}


@pytest.mark.parametrize("in_process", ["bovine-muscle"], indirect=True)
@pytest.mark.parametrize("model", ["33500B", pytest.param("33600A", marks=pytest.mark.slow)])
def test_pulse_trains_from_a_sibling_give_the_same_records(
    in_process: tuple[str, Path], model: str, tmp_path: Path
) -> None:
    edits = [
        (f'[generators.{role}]\nmodel = "33250A"', f'[generators.{role}]\nmodel = "{model}"')
        for role in ("master", "burst_train", "tracking_train")
    ]
    bench = bench_over(tmp_path, "socket", *edits)
    other = read_run(record_run(prepare("bovine-muscle", bench), tmp_path / "b.h5"))
    np.testing.assert_array_equal(other.records[0].codes, read_run(in_process[1]).records[0].codes)


@pytest.mark.parametrize("model", ["33220A", *MODELS])
def test_a_sibling_as_the_tracking_pulser_at_9_mhz_is_refused_with_the_plan(model: str, tmp_path: Path) -> None:
    role = "[generators.tracking_pulser]\nmodel = "
    bench = bench_over(tmp_path, "socket", (f'{role}"33250A"', f'{role}"{model}"'))
    refused = rf"tracking_pulser: carrier_hz = 9000000 is outside .* for counted bursts of a {model}.*Try: tracking"
    with pytest.raises(PlanError, match=refused):
        prepare("bovine-muscle", bench)


@contextmanager
def emulated(transport: str, folder: Path, *arguments: str) -> Iterator[BenchFile]:
    """Yield the bench file that ``hpe-rig emulate`` prints in a process of its own."""
    command = [sys.executable, "-m", "hpe_rig", "emulate", "--transport", transport, *arguments]
    with (folder / "bench.toml").open("w+b") as printed, subprocess.Popen(command, stdout=printed) as process:
        try:
            deadline_s = time.monotonic() + 30
            while "transducer.drive" not in (text := Path(printed.name).read_text(encoding="utf-8")):
                assert process.poll() is None
                assert time.monotonic() < deadline_s
                time.sleep(0.05)
            time.sleep(0.1)
            yield parse_bench("emulated", Path(printed.name).read_text(encoding="utf-8") or text).bench
        finally:
            process.send_signal(signal.SIGINT if sys.platform != "win32" else signal.SIGTERM)
            status = process.wait(timeout=20)
    assert sys.platform == "win32" or status == 0


@pytest.fixture(scope="module", params=OVER)
def served(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[str, BenchFile]]:
    """Yield a transport and the bench file of an emulator that serves it while this module's tests use it."""
    with emulated(request.param, tmp_path_factory.mktemp(request.param)) as bench:
        yield request.param, bench


def test_the_printed_bench_file_leads_another_visa_program_to_every_generator(served: tuple[str, BenchFile]) -> None:
    transport, bench = served
    assert bench.transport == transport
    manager = pyvisa.ResourceManager("@py")
    opened = {}
    for role, generator in bench.generators.by_role.items():
        assert generator.interface is None or transport == "prologix"
        if generator.interface and "interface" not in opened:
            opened["interface"] = manager.open_resource(generator.interface)
        opened[role] = manager.open_resource(generator.address)
        opened[role].write_termination = "\n"
        if transport == "socket":
            opened[role].read_termination = "\n"
        if transport == "serial":
            opened[role].write("SYST:REM")
        opened[role].write(f"FREQ {1000 + len(opened)}")
        assert "33250A" in opened[role].query("*IDN?")
    rates = [float(opened[role].query("FREQ?")) for role in bench.generators.by_role]
    assert len(set(rates)) == len(rates) == 5
    for resource in reversed(opened.values()):
        resource.close()


def metal(bench: BenchFile, text: str) -> BenchFile:
    """Return the bench as a real one that reaches its generators at the same addresses."""
    places = {role: (item.address or "", item.interface) for role, item in bench.generators.by_role.items()}
    file = parse_bench("simulated", text)
    text = addressed(file, "socket", places).replace('transport = "socket"\n', "")
    return parse_bench("metal", text.replace("simulated = true", "simulated = false")).bench


@pytest.mark.parametrize("served", ["socket", pytest.param("prologix", marks=pytest.mark.slow)], indirect=True)
def test_a_real_bench_file_reaches_its_generators_at_their_addresses(served: tuple[str, BenchFile]) -> None:
    with open_each(metal(served[1], SIMULATED)) as found:
        for role in served[1].generators.by_role:
            assert found[role].identify().model == "33250A"
        assert isinstance(found["digitizer"], InstrumentError)


@pytest.mark.parametrize("served", ["socket"], indirect=True)
def test_another_model_than_the_bench_file_says_is_refused_by_name(served: tuple[str, BenchFile]) -> None:
    text = SIMULATED.replace('[generators.master]\nmodel = "33250A"', '[generators.master]\nmodel = "33600A"')
    with open_each(metal(served[1], text)) as found:
        assert "33250A" in str(found["master"])
        assert "expected model 33600A" in str(found["master"])
        assert not isinstance(found["toneburst"], Exception)


@pytest.mark.slow
def test_ctrl_c_ends_an_emulator_whose_clients_read_no_reply(tmp_path: Path) -> None:
    with ExitStack() as stack, emulated("socket", tmp_path) as bench:
        host, port = (bench.generators.by_role["master"].address or "").split("::")[1:3]
        for _ in range(20):
            peer = stack.enter_context(socket.create_connection((host, int(port)), timeout=5))
            peer.setblocking(False)
            with suppress(BlockingIOError):
                for _ in range(2000):
                    peer.send(b"*IDN?" + b";*IDN?" * 20 + b"\n")


@pytest.mark.slow
def test_a_bench_that_nobody_serves_is_refused_by_role_and_address() -> None:
    with ExitStack() as stack:
        places = {}
        for role in read_bench().bench.generators.by_role:
            deaf = stack.enter_context(socket.socket())
            # Bound and not listening: nobody else can take the port, and whoever knocks is refused.
            deaf.bind(("127.0.0.1", 0))
            places[role] = (f"TCPIP0::127.0.0.1::{deaf.getsockname()[1]}::SOCKET", None)
        nobody = places["master"][0]
        text = addressed(read_bench(), "socket", places).replace('transport = "socket"\n', "")
        bench = parse_bench("metal", text.replace("simulated = true", "simulated = false")).bench
        setup = prepare("bovine-muscle")
        with (
            pytest.raises(InstrumentError, match=rf"master: cannot open .*{nobody}"),
            open_bench(setup.scene.scene, bench, setup.plan.roles),
        ):
            pass
