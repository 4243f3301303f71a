"""A bench that cannot be opened: no earlier run is lost, no stub is left, and the message names what is wrong."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from click.testing import Result
from typer.testing import CliRunner

from drivers.interfaces import InstrumentError
from drivers.visa import NoVisaError, VisaConnection
from hpe_rig.bench import opening
from hpe_rig.cli.app import app
from hpe_rig.measurement.run import record_run
from hpe_rig.measurement.setup import prepare
from hpe_rig.store import WriteOptions, read_run


@pytest.fixture
def metal(real_bench: Callable[..., Path]) -> Path:
    """Return the file of a bench at addresses that refuse connections."""
    return real_bench(address="TCPIP0::127.0.0.1::{}::SOCKET")


def rig(folder: Path, monkeypatch: pytest.MonkeyPatch, *arguments: str) -> Result:
    monkeypatch.chdir(folder)
    return CliRunner().invoke(app, arguments)


def test_overwriting_with_a_bench_at_a_wrong_address_loses_nothing(
    tmp_path: Path, metal: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = record_run(prepare("table-1"), tmp_path / "run.h5")
    before = path.read_bytes()
    done = rig(
        tmp_path, monkeypatch, "run", "bovine-muscle", "--bench", str(metal), "--output", "run.h5", "--overwrite"
    )
    assert done.exit_code == 1, done.stderr
    assert path.read_bytes() == before
    assert "no record had arrived: run.h5 is unchanged" in done.stderr
    assert "holds the records" not in done.stderr


def test_a_failed_open_leaves_no_stub_and_claims_no_records(
    tmp_path: Path, metal: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = set(tmp_path.iterdir())
    done = rig(tmp_path, monkeypatch, "run", "bovine-muscle", "--bench", str(metal), "--output", "run.h5")
    assert done.exit_code == 1
    assert set(tmp_path.iterdir()) == before
    assert "nothing was measured, and there is no run file" in done.stderr
    assert "not identified, so not proven off: master, burst_train, toneburst" in done.stderr


def test_an_earlier_run_is_replaced_once_a_record_has_arrived(tmp_path: Path) -> None:
    path = record_run(prepare("table-1"), tmp_path / "run.h5")
    record_run(prepare("bovine-muscle-synchronous"), path, options=WriteOptions(overwrite=True))
    assert read_run(path).scene_name == "bovine-muscle-synchronous"
    assert [item.name for item in tmp_path.glob("*.h5")] == ["run.h5"]


def test_reachable_instruments_are_made_safe_if_another_cannot_be_reached(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    setup = prepare("bovine-muscle-synchronous")
    worlds, make = [], opening._world

    def left_on(*arguments: object) -> object:
        worlds.append(make(*arguments))  # type: ignore[arg-type]
        for role in ("master", "toneburst"):
            worlds[0].connect(role).write("OUTP 1")
        return worlds[0]

    instrument = opening.Connections.instrument

    def without_burst_train(connections: opening.Connections, role: str, bench: object) -> object:
        if role == "burst_train":
            raise InstrumentError(role, "cannot open", "the address is wrong", "correct it")
        return instrument(connections, role, bench)  # type: ignore[arg-type]

    monkeypatch.setattr(opening, "_world", left_on)
    monkeypatch.setattr(opening.Connections, "instrument", without_burst_train)
    with pytest.raises(InstrumentError, match="burst_train: cannot open") as caught:
        record_run(setup, tmp_path / "run.h5")
    assert not any(worlds[0].outputs_on().values())
    assert any("not proven off: burst_train: look" in note for note in caught.value.__notes__)


def test_a_missing_driver_is_named(tmp_path: Path, metal: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(NoVisaError, match="no VISA driver for GPIB is installed") as caught:
        VisaConnection("GPIB0::10::INSTR", backend="@py")
    assert "NI-VISA or Keysight IO Libraries, or linux-gpib" in caught.value.remedy
    text = metal.read_text(encoding="utf-8").replace("TCPIP0::127.0.0.1", "GPIB0").replace("SOCKET", "INSTR")
    metal.write_text(text, encoding="utf-8")
    done = rig(tmp_path, monkeypatch, "run", "bovine-muscle", "--bench", str(metal))
    assert done.exit_code == 1
    assert "has no driver for such an address, which may be right. Try: install NI-VISA" in done.stderr
    assert "the address, the cable or the power is wrong" not in done.stderr
