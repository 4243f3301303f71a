"""Bench files of real benches: what a copy of the simulated one must not keep."""

from __future__ import annotations

import os
import re
import sys
import time
from itertools import count
from pathlib import Path

import pytest
import pyvisa
from typer.testing import CliRunner

from hpe_rig.bench import BenchInUseError, inventory, opening, parse_bench, read_bench, resources, survey
from hpe_rig.bench.lock import holder_of, locked
from hpe_rig.bench.opening import visa_addresses
from hpe_rig.cli.app import app
from hpe_rig.cli.bench import print_calibration
from hpe_rig.measurement import prepare
from hpe_rig.plan import PlanError
from hpe_rig.scene import SettingsError
from sim_backend.generator.instrument import Generator33250A
from sim_backend.transports import Emulator
from sim_backend.wiring import SimulatedClock
from sim_backend.world import GeneratorConnection

TITLE = read_bench().bench.title


def real(path: Path, *edits: tuple[str, str]) -> Path:
    text = read_bench().text
    for old, new in (("simulated = true", "simulated = false"), *edits):
        assert old in text
        text = text.replace(old, new)
    number = count(10)
    text = re.sub(
        r'(?<=model = "33250A"\n)', lambda _: f'address = "GPIB0::{next(number)}::INSTR"\nserial = "none"\n', text
    )
    path.write_text(text, encoding="utf-8")
    return path


def test_no_instrument_is_found_where_there_is_no_visa(monkeypatch: pytest.MonkeyPatch) -> None:
    def none_there(backend: str) -> None:
        raise ValueError(f"no backend {backend!r}")

    monkeypatch.setattr(pyvisa, "ResourceManager", none_there)
    assert visa_addresses() == ()


def test_a_search_for_instruments_that_hangs_ends_after_a_bounded_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(opening, "SEARCH_TIMEOUT_S", 0.2)
    monkeypatch.setattr(opening, "_search_addresses", lambda: time.sleep(3.0) or ("GPIB0::31::INSTR",))
    start_s = time.monotonic()
    assert visa_addresses() == ()
    assert time.monotonic() - start_s < 2.5


def test_instruments_are_searched_for_with_the_bench_locked_and_its_outputs_off(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench = read_bench(real(tmp_path / "metal.toml", (TITLE, "Room 12"))).bench
    holders: list[str | None] = []

    def search() -> tuple[str, ...]:
        holders.extend(holder_of(name) for name in resources(bench))
        return ("GPIB0::31::INSTR",)

    monkeypatch.setattr(inventory, "visa_addresses", search)
    report = survey(bench)
    assert [holder is not None and f"process {os.getpid()} " in holder for holder in holders] == [True] * 6
    # No driver for GPIB is installed here, so that every generator gets a suggestion.
    assert all("GPIB0::31::INSTR" in item.problems[-1] for item in report.instruments[:-1])
    with locked(resources(bench)):
        holders.clear()
        with pytest.raises(BenchInUseError):
            survey(bench)
    assert holders == []


def test_a_copied_bench_has_a_title_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert CliRunner().invoke(app, ["new", "room-12", "--like", "bench"]).exit_code == 0
    copied, shipped = read_bench(tmp_path / "room-12.toml"), read_bench()
    assert copied.bench.title == "Bench room-12"
    assert copied.bench.model_copy(update={"title": TITLE}) == shipped.bench
    assert copied.text.splitlines()[2:] == shipped.text.splitlines()[2:]


def test_a_real_bench_by_the_name_of_the_simulated_one_is_refused_and_its_runs_stay_readable(tmp_path: Path) -> None:
    path = real(tmp_path / "metal.toml")
    with pytest.raises(SettingsError, match="the title of the simulated bench"):
        read_bench(path)
    assert parse_bench("metal", path.read_text(encoding="utf-8")).bench.title == TITLE
    # What switches off is kept from it by nothing.
    assert read_bench(path, lenient=True).bench.title == TITLE


def test_an_assumed_calibration_is_refused_on_a_real_bench_with_how_to_measure_one(tmp_path: Path) -> None:
    path = real(tmp_path / "metal.toml", (TITLE, "Room 12"))
    with pytest.raises(PlanError, match=r"calibration.source = 'assumed: .*assumed numbers.*hydrophone at the focus"):
        prepare("bovine-muscle", path)
    # Numbers that nobody measured are good enough for a bench that drives nothing.
    prepare("bovine-muscle")


@pytest.mark.parametrize("source", ["A. Tester with a 0.2 mm needle, 12 May 2026", "as assumed before, then measured"])
def test_a_measured_calibration_is_taken(tmp_path: Path, source: str) -> None:
    edits = (TITLE, "Room 12"), ("assumed: no hydrophone has seen it", source)
    prepare("bovine-muscle", real(tmp_path / "metal.toml", *edits))


def test_a_sweep_lowers_the_limits_of_a_real_bench_and_raises_none(tmp_path: Path) -> None:
    bench = read_bench(real(tmp_path / "metal.toml", (TITLE, "Room 12")), lenient=True).bench
    assert bench.with_({("limits", "max_duty"): 0.04}).limits.max_duty == 0.04
    raised: dict[tuple[str | int, ...], int | float] = {
        ("limits", "max_duty"): 0.06,
        ("limits", "max_drive_vpp"): 3.0,
        ("generators", "toneburst", "max_vpp"): 5.0,
        ("calibration", "u"): 0.1,
    }
    with pytest.raises(SettingsError) as caught:
        bench.with_(raised)
    assert [(mistake.path, mistake.remedy) for mistake in caught.value.mistakes] == [
        ("bench.limits.max_duty", "at most 0.05"),
        ("bench.limits.max_drive_vpp", "at most 2"),
        # The bench file states no limit of this generator.
        ("bench.generators.toneburst.max_vpp", "no sweep of it"),
        ("bench.calibration.u", "the bench file"),
    ]
    # Limits protect nothing on the twin.
    assert read_bench().bench.with_({("limits", "max_duty"): 0.06}).limits.max_duty == 0.06


@pytest.mark.skipif(sys.platform == "win32", reason="needs a pseudo terminal")
def test_serial_lines_have_the_settings_of_the_bench_file(tmp_path: Path) -> None:
    import termios

    generator = GeneratorConnection(Generator33250A(SimulatedClock(), 100e-9), SimulatedClock(), 0.0)
    roles = tuple(read_bench().bench.generators.by_role)
    with Emulator("serial", lambda role, over_serial: generator, roles) as emulator:
        path = real(tmp_path / "metal.toml", (TITLE, "Room 12"))
        text = path.read_text(encoding="utf-8")
        for number, role in enumerate(roles, 10):
            lines = f'\naddress = "{emulator.served[role].address}"\nbaud = 19200\nhandshake = "xon_xoff"'
            text = text.replace(f'\naddress = "GPIB0::{number}::INSTR"', lines)
        path.write_text(text, encoding="utf-8")
        with opening.open_each(read_bench(path).bench) as instruments:
            identified = [role for role, item in instruments.items() if not isinstance(item, Exception)]
            assert sorted(identified) == sorted(roles)
            for role in roles:
                device = emulator.served[role].address.removeprefix("ASRL").removesuffix("::INSTR")
                terminal = os.open(device, os.O_RDWR | os.O_NOCTTY)
                flags, _, _, _, speed, *_ = termios.tcgetattr(terminal)
                os.close(terminal)
                assert (speed, bool(flags & termios.IXON)) == (termios.B19200, True)


def test_a_wrong_setting_of_a_serial_line_is_a_mistake_with_the_choices(tmp_path: Path) -> None:
    path = real(tmp_path / "metal.toml", (TITLE, "Room 12"))
    wrong = '\nbaud = "fast"\nhandshake = "hardware"\ntermination = "\\n"\naddress = "GPIB0::10::INSTR"'
    text = path.read_text(encoding="utf-8").replace('\naddress = "GPIB0::10::INSTR"', wrong)
    path.write_text(text, encoding="utf-8")
    with pytest.raises(SettingsError, match=r"3 mistakes") as caught:
        read_bench(path)
    keys = [mistake.path for mistake in caught.value.mistakes]
    assert keys == [f"generators.master.{key}" for key in ("baud", "handshake", "termination")]
    assert "'dtr_dsr'" in str(caught.value)


@pytest.mark.parametrize(
    ("table", "lines", "words"),
    [
        ("generators.toneburst", "carrier_band_hz = [9e6, 1e6]", "carrier_band_hz: the lower limit.*the two exchanged"),
        ("generators.toneburst", 'serial = ""', "toneburst.serial: the serial number is empty.*--identify"),
        ("digitizer", 'serial = " "', "digitizer.serial: the serial number is empty"),
        ("generators.toneburst", 'serial = "NONE"', 'did you mean "none"'),
    ],
)
def test_a_value_that_no_bench_can_mean_is_a_mistake_of_the_file(
    tmp_path: Path, table: str, lines: str, words: str
) -> None:
    path = tmp_path / "bench.toml"
    text = read_bench().text.replace(f"\n[{table}]\n", f"\n[{table}]\n{lines}\n")
    path.write_text(text, encoding="utf-8")
    with pytest.raises(SettingsError, match=words):
        read_bench(path)
    # Outputs are switched off with such a file too.
    read_bench(path, lenient=True)


def test_an_address_is_suggested_where_only_its_number_may_be_wrong() -> None:
    bench = read_bench().bench.model_copy(update={"simulated": False})
    found = ("ASRL/dev/ttyS0::INSTR", "ASRL/dev/ttyUSB1::INSTR")
    (suggestion,) = inventory._address_suggestion("master", "ASRL/dev/ttyUSB0::INSTR", bench, found)
    assert suggestion.endswith("did you mean ASRL/dev/ttyUSB1::INSTR?")
    (suggestion,) = inventory._address_suggestion("master", "ASRL/dev/null::INSTR", bench, found[:1])
    assert suggestion == "generators.master.address: the addresses found are ASRL/dev/ttyS0::INSTR"


def test_the_state_of_a_real_bench_reports_an_expired_calibration(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source = 'source = "assumed: no hydrophone has seen it"'
    path = real(tmp_path / "metal.toml", (TITLE, "Room 12"), (source, f"{source}\nvalid_until = 2026-03-05"))
    print_calibration(read_bench(path).bench)
    assert "calibration: expired: calibration.valid_until = 2026-03-05" in capsys.readouterr().out
