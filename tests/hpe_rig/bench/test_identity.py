"""Who is who: serial numbers and labels of a bench file against those of the instruments that answer."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from typer.testing import CliRunner

from drivers.interfaces import InstrumentError
from hpe_rig.bench import GENERATOR_ROLES, read_bench
from hpe_rig.bench.opening import open_bench
from hpe_rig.cli.app import app
from hpe_rig.measurement import prepare
from hpe_rig.measurement.run import record_run
from hpe_rig.scene import SettingsError
from sim_backend.world import World

BOXES = {role: f"SIM_BOX_{number}" for number, role in enumerate(GENERATOR_ROLES, 1)}
"""Labels of the simulated 33250As, which report no serial number."""
SWAPPED = BOXES | {"toneburst": BOXES["tracking_pulser"], "tracking_pulser": BOXES["toneburst"]}


def bench_with(serials: dict[str, str], folder: Path, *edits: tuple[str, str]) -> Path:
    text = read_bench().text
    for role, serial in serials.items():
        table = "[digitizer]" if role == "digitizer" else f"[generators.{role}]"
        text = text.replace(table, f'{table}\nserial = "{serial}"')
    for old, new in edits:
        assert old in text
        text = text.replace(old, new)
    path = folder / "bench.toml"
    path.write_text(text, encoding="utf-8")
    return path


def run(*arguments: str) -> tuple[int, str]:
    result = CliRunner().invoke(app, arguments)
    return result.exit_code, result.output


def test_a_bench_with_its_own_instruments_measures(tmp_path: Path) -> None:
    bench = bench_with(BOXES | {"digitizer": "460001"}, tmp_path)
    assert record_run(prepare("table-1", bench), tmp_path / "run.h5").exists()
    code, output = run("bench", str(bench))
    assert code == 0
    assert "SIM_BOX_3" in output


def test_swapped_generators_are_refused_by_every_opening(tmp_path: Path) -> None:
    bench = bench_with(SWAPPED, tmp_path)
    swapped = "toneburst and tracking_pulser are swapped: exchange their addresses"
    with pytest.raises(InstrumentError, match=swapped) as refused:
        record_run(prepare("bovine-muscle", bench), tmp_path / "run.h5")
    assert "every output is off, verified" in "".join(refused.value.__notes__)
    assert not (tmp_path / "run.h5").exists()
    code, output = run("bench", str(bench))
    assert code == 1
    assert "toneburst: serial number SIM_BOX_3, which is that of tracking_pulser, answers at" in output
    assert f"Try: {swapped}" in " ".join(output.split())


def test_swapped_generators_are_switched_off_all_the_same(tmp_path: Path) -> None:
    code, output = run("bench", str(bench_with(SWAPPED, tmp_path)), "--off")
    assert code == 0
    assert "tracking_pulser: serial number SIM_BOX_5, which is that of toneburst" in output
    assert output.count("read back as off") == 5
    assert "Try: toneburst and tracking_pulser are swapped: exchange their addresses" in output


def test_an_exchange_is_reported_also_where_another_instrument_is_missing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def missing(world: World) -> None:
        raise InstrumentError("digitizer", "the library is not installed", "it is absent", "install it")

    monkeypatch.setattr(World, "alazar_library", missing)
    bench = bench_with(SWAPPED, tmp_path)
    with pytest.raises(InstrumentError, match="the library is not installed") as refused:
        record_run(prepare("bovine-muscle", bench), tmp_path / "run.h5")
    assert "toneburst and tracking_pulser are swapped: exchange" in "".join(refused.value.__notes__)
    code, output = run("bench", str(bench))
    assert code == 1
    assert "is safe: outputs off, verified" in output


def test_another_instrument_is_named_with_role_address_and_both_numbers(tmp_path: Path) -> None:
    bench = bench_with(BOXES | {"master": "MY1", "digitizer": "460002"}, tmp_path)
    with pytest.raises(InstrumentError) as refused:
        record_run(prepare("table-1", bench), tmp_path / "run.h5")
    assert "master: serial number SIM_BOX_1 answers at in process, expected MY1;" in str(refused.value)
    assert "digitizer: serial number 460001 answers at system 1, board 1, expected 460002" in str(refused.value)
    assert "--identify" in str(refused.value)


def test_an_instrument_without_serial_number_and_label_is_not_the_stated_one(tmp_path: Path) -> None:
    bench = bench_with({"master": "SIM_BOX_1"}, tmp_path)
    setup = prepare("table-1", bench)
    scene = setup.scene.scene.model_copy(update={"simulation": {"instruments": {"serial_numbers": False}}})
    without = "an instrument without serial number and label answers at in process, expected SIM_BOX_1"
    with pytest.raises(InstrumentError, match=without), open_bench(scene, setup.bench.bench, setup.plan.roles):
        pass


def test_a_model_with_a_serial_number_is_known_by_it(tmp_path: Path) -> None:
    table = '[generators.master]\nserial = "MY44000001"\nmodel = '
    bench = bench_with({"master": "MY44000001"}, tmp_path, (f'{table}"33250A"', f'{table}"33600A"'))
    record_run(prepare("table-1", bench), tmp_path / "run.h5")


def test_one_serial_number_for_two_roles_is_a_mistake_of_the_file(tmp_path: Path) -> None:
    path = bench_with(BOXES | {"master": BOXES["toneburst"]}, tmp_path)
    with pytest.raises(SettingsError, match=r"toneburst.serial: SIM_BOX_3 is stated for master and toneburst"):
        read_bench(path)


def metal(serials: dict[str, str], folder: Path) -> Path:
    path = bench_with(serials, folder, ("simulated = true", "simulated = false"), ("Simulated bench", "Bench"))
    text = re.sub(r"^\[calibration.*?(?=^\[generators)", "", path.read_text(encoding="utf-8"), flags=re.M | re.S)
    for number, role in enumerate(GENERATOR_ROLES, 10):
        table = f"[generators.{role}]"
        text = text.replace(table, f'{table}\naddress = "GPIB0::{number}::INSTR"')
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("serials", "level"), [({}, "refused"), (dict.fromkeys(BOXES, "none"), "warning"), (BOXES, "passed")]
)
def test_tonebursts_from_unknown_generators_are_refused_on_a_real_bench(
    serials: dict[str, str], level: str, tmp_path: Path
) -> None:
    setup = prepare("bovine-muscle", metal(serials, tmp_path), refuse=False)
    identity = next(item for item in setup.findings if item.check == "identity")
    assert identity.level == level
    assert ("duty 0.399, limits.max_duty = 0.05" in identity.text) == (level != "passed")


def test_a_scene_without_tonebursts_needs_no_serial_numbers(tmp_path: Path) -> None:
    assert not any(item.check == "identity" for item in prepare("table-1", metal({}, tmp_path)).findings)
