"""Names of instruments: equal for all spellings of one address, different for different instruments."""

from __future__ import annotations

import socket
import sys
import time
from collections.abc import Mapping
from itertools import combinations
from pathlib import Path

import pytest
from typer.testing import CliRunner

from drivers.agilent import Agilent33250A
from hpe_rig.bench import open_bench, parse_bench, read_bench, resource_name, survey
from hpe_rig.bench.lock import BenchInUseError, exclusive, locked
from hpe_rig.bench.resource_name import (
    canonical_resource,
    literal_host,
    resolved_host,
    resolved_names,
    resource_names,
    windows_device,
)
from hpe_rig.cli.app import app
from hpe_rig.measurement import prepare
from hpe_rig.scene import SettingsError

ADAPTER = "PRLGX-TCPIP0::192.168.1.20::1234::INTFC"
# Each line is one instrument: all of its spellings have one name, which no other line has.
INSTRUMENTS = [
    ["GPIB0::10::INSTR", "GPIB::10", "gpib0::10::instr", "GPIB00::010::INSTR", "GPIB::10::INSTR"],
    ["GPIB1::10::INSTR", "GPIB1::10"],
    ["GPIB0::11::INSTR"],
    ["GPIB0::10::1::INSTR"],
    [
        "TCPIP0::192.168.1.21::inst0::INSTR",
        "TCPIP::192.168.1.21",
        "tcpip0::192.168.1.21::hislip0::INSTR",
        "TCPIP0::192.168.1.21::HISLIP0,4880::INSTR",
        "TCPIP0::192.168.1.21::5025::SOCKET",
        "TCPIP0::[::ffff:192.168.1.21]::inst0::INSTR",
        "ASRLsocket://192.168.1.21:5025::INSTR",
    ],
    ["TCPIP0::192.168.1.21::inst1::INSTR", "TCPIP0::192.168.1.21::hislip1::INSTR"],
    ["TCPIP0::192.168.1.22::inst0::INSTR"],
    ["TCPIP0::192.168.1.30::gpib0,10::INSTR", "TCPIP::192.168.1.30::GPIB0,10"],
    ["TCPIP0::192.168.1.30::gpib0,11::INSTR"],
    ["TCPIP0::192.168.1.30::inst0::INSTR"],
    [
        "TCPIP0::127.0.0.1::40001::SOCKET",
        "TCPIP0::localhost::40001::SOCKET",
        "TCPIP0::LOCALHOST.::40001::SOCKET",
        "TCPIP0::[::1]::40001::SOCKET",
        "TCPIP0::0.0.0.0::40001::SOCKET",
        "TCPIP0::[::]::40001::SOCKET",
        "TCPIP0::127.0.0.1::hislip0,40001::INSTR",
    ],
    ["TCPIP0::127.0.0.1::40002::SOCKET"],
    ["TCPIP0::127.0.0.1,40003::gpib0,10::INSTR", "TCPIP0::localhost,40003::gpib0,10::INSTR"],
    ["TCPIP0::127.0.0.1,40003::gpib0,11::INSTR"],
    ["TCPIP0::127.0.0.1,40004::gpib0,10::INSTR"],
    ["TCPIP0::generator.example::inst0::INSTR", "TCPIP0::Generator.EXAMPLE.::5025::SOCKET"],
    ["USB0::0x0957::0x0407::MY44012345::INSTR", "USB::2391::1031::my44012345::0::INSTR"],
    ["USB0::0x0957::0x0407::MY44012346::INSTR"],
    ["ASRL/dev/no-such-line::INSTR", "asrl/dev/no-such-line"],
    ["master generator", "MASTER GENERATOR "],
]
BEHIND_ADAPTERS = [
    [("GPIB0::10::INSTR", ADAPTER), ("GPIB1::10", "prlgx-tcpip::192.168.1.20::INTFC")],
    [("GPIB0::11::INSTR", ADAPTER)],
    [("GPIB0::10::INSTR", "PRLGX-TCPIP0::192.168.1.20::1235::INTFC")],
    [
        ("GPIB0::10::INSTR", "PRLGX-ASRL::/dev/no-such-line::INTFC"),
        ("GPIB0::10", "PRLGX-ASRL0::/dev/no-such-line::INTFC"),
    ],
]


def test_all_spellings_of_an_address_have_one_name_and_different_instruments_have_different_ones() -> None:
    named = [{canonical_resource(address) for address in spellings} for spellings in INSTRUMENTS]
    named += [{canonical_resource(*pair) for pair in spellings} for spellings in BEHIND_ADAPTERS]
    assert [names for names in named if len(names) != 1] == []
    assert [pair for pair in combinations(named, 2) if pair[0] & pair[1]] == []


@pytest.mark.parametrize(
    "address", ["", "GPIB", "GPIB0::ten", "TCPIP0", "TCPIP0::h::x::SOCKET", "USB0::1::INSTR", "::"]
)
def test_an_address_of_unknown_form_is_its_own_name(address: str) -> None:
    assert canonical_resource(address) == address.upper()


def test_a_serial_port_of_windows_is_named_by_its_number() -> None:
    names = {
        canonical_resource(text, device=windows_device) for text in ("ASRL3::INSTR", "ASRLCOM3", "asrlcom3::instr")
    }
    assert names == {"ASRLCOM3"}


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no device files")
def test_a_link_to_a_device_and_the_device_have_one_name(tmp_path: Path) -> None:
    link = tmp_path / "usb-FTDI_FT232R-if00-port0"
    link.symlink_to("/dev/null")
    assert canonical_resource(f"ASRL{link}::INSTR") == canonical_resource("ASRL/dev/null::INSTR")
    adapters = [f"PRLGX-ASRL::{path}::INTFC" for path in (link, "/dev/null")]
    assert len({canonical_resource("GPIB0::5", adapter) for adapter in adapters}) == 1


def resolver(answers: dict[str, list[str]]) -> object:
    def getaddrinfo(host: str, port: None) -> list[tuple[int, int, int, str, tuple[str, int]]]:
        if host not in answers:
            raise socket.gaierror(socket.EAI_NONAME, "unknown")
        return [(0, 0, 0, "", (address, 0)) for address in answers[host]]

    return getaddrinfo


def test_a_host_name_is_resolved_to_one_of_its_addresses(monkeypatch: pytest.MonkeyPatch) -> None:
    answers = {"gen": ["fe80::1", "10.0.0.9", "10.0.0.10"], "gen.lab": ["10.0.0.10", "10.0.0.9"], "own": ["::1"]}
    monkeypatch.setattr(socket, "getaddrinfo", resolver(answers))
    assert resolved_host("GEN") == resolved_host("gen.lab.") == "10.0.0.10"
    assert resolved_host("own") == "127.0.0.1"
    assert resolved_host("absent") == literal_host("absent")


def without_end(*_: object) -> None:
    time.sleep(3.0)
    raise socket.gaierror(socket.EAI_AGAIN, "no answer")


def bench_text(serials: Mapping[str, str] = {}, first_address: int = 10, **addresses: str) -> str:
    """Return the text of a real bench, each generator at its own GPIB address unless stated."""
    text = read_bench().text.replace("simulated = true", "simulated = false")
    text = text.replace("Simulated bench, wired as Fig. 2 of the paper", "Room 12")
    text = text.replace("assumed: no hydrophone has seen it", "A. Tester, with a hydrophone")
    for number, role in enumerate(read_bench().bench.generators.by_role, first_address):
        address = addresses.get(role, f"GPIB0::{number}::INSTR")
        stated = f'address = "{address}"\nserial = "{serials.get(role, "none")}"\n'
        text = text.replace(f"[generators.{role}]\n", f"[generators.{role}]\n{stated}")
    return text


SHARED = {"toneburst": "TCPIP0::localhost::40001::SOCKET", "tracking_pulser": "TCPIP::127.0.0.1::40001::SOCKET"}
MESSAGE = r"generators\.tracking_pulser\.address: toneburst and tracking_pulser have the same instrument"


@pytest.mark.parametrize(
    "command", [["bench"], ["check", "bovine-muscle", "--bench"], ["run", "bovine-muscle", "--bench"]]
)
def test_two_roles_with_one_instrument_are_refused_with_both_named(tmp_path: Path, command: list[str]) -> None:
    path = tmp_path / "metal.toml"
    path.write_text(bench_text(**SHARED), encoding="utf-8")
    done = CliRunner().invoke(app, [*command, str(path)])
    assert done.exit_code == 2
    output = " ".join(done.output.split())
    assert "toneburst and tracking_pulser have the same instrument" in output
    assert "'TCPIP::127.0.0.1::40001::SOCKET' and 'TCPIP0::localhost::40001::SOCKET'" in output


def test_all_mistakes_of_a_real_bench_are_reported_together(tmp_path: Path) -> None:
    path = tmp_path / "metal.toml"
    shared = bench_text(**SHARED).replace("Room 12", read_bench().bench.title)
    path.write_text(shared, encoding="utf-8")
    with pytest.raises(SettingsError, match=f"(?s)2 mistakes.*{MESSAGE}.*title of the simulated bench"):
        read_bench(path)
    # Neither prevents switching off.
    assert read_bench(path, lenient=True).bench.simulated is False


def test_one_instrument_by_its_name_and_by_its_number_is_refused_at_opening(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(socket, "getaddrinfo", resolver({"generator": ["192.0.2.7"], "192.0.2.7": ["192.0.2.7"]}))
    shared = bench_text(toneburst="TCPIP0::generator::inst0::INSTR", tracking_pulser="TCPIP::192.0.2.7::5025::SOCKET")
    bench = parse_bench("metal", shared)
    setup = prepare("bovine-muscle")
    with pytest.raises(SettingsError, match=MESSAGE), open_bench(setup.scene.scene, bench.bench, setup.plan.roles):
        pass
    with pytest.raises(SettingsError, match=MESSAGE):
        survey(bench.bench)


def test_programs_with_other_spellings_of_an_address_exclude_each_other(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(socket, "getaddrinfo", resolver({"generator": ["192.0.2.7"]}))
    first = parse_bench("one", bench_text(master="TCPIP0::generator::hislip0::INSTR")).bench
    other = bench_text(first_address=20, master="TCPIP::192.0.2.7").replace("board_id = 1", "board_id = 2")
    second = parse_bench("other", other).bench
    with exclusive(first), pytest.raises(BenchInUseError, match=r"TCPIP::192\.0\.2\.7 is in use"), exclusive(second):
        pass
    with exclusive(second):
        pass


def test_programs_that_reach_one_instrument_by_different_interfaces_exclude_each_other_by_its_serial_number() -> None:
    serials = {"toneburst": "MY44000001"}
    first = parse_bench("one", bench_text(serials)).bench
    other = bench_text(serials, 20, toneburst="USB0::0x0957::0x0407::MY44000001::INSTR")
    second = parse_bench("other", other.replace("board_id = 1", "board_id = 2")).bench
    with (
        exclusive(first),
        pytest.raises(BenchInUseError, match="serial number MY44000001 is in use"),
        exclusive(second),
    ):
        pass


def test_an_instrument_that_answers_at_two_addresses_is_named_by_the_inventory(monkeypatch: pytest.MonkeyPatch) -> None:
    serial_number = Agilent33250A.serial_number

    def same(generator: Agilent33250A) -> str:
        return "MY1" if generator.role in ("master", "toneburst") else serial_number(generator)

    monkeypatch.setattr(Agilent33250A, "serial_number", same)
    problems = {item.role: item.problems for item in survey(read_bench().bench).instruments if item.problems}
    assert list(problems) == ["toneburst"]
    assert "serial number MY1 answers for master too" in problems["toneburst"][0]


def test_a_resolver_that_hangs_delays_an_opening_by_a_bounded_time_and_the_name_as_written_is_locked_too(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(resource_name, "RESOLUTION_TIMEOUT_S", 0.2)
    bench = parse_bench("one", bench_text(master="TCPIP0::generator::inst0::INSTR")).bench
    monkeypatch.setattr(socket, "getaddrinfo", resolver({"generator": ["192.0.2.7"]}))
    with exclusive(bench):
        monkeypatch.setattr(socket, "getaddrinfo", without_end)
        start_s = time.monotonic()
        assert resolved_names(bench) == resource_names(bench)
        assert time.monotonic() - start_s < 2.5
        with pytest.raises(BenchInUseError), locked([resource_names(bench)["master"]]):
            pass
