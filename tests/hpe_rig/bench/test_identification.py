"""Identification of generators by a person: roles on the displays, lasting labels, serial numbers in the bench file."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

from hpe_rig.bench import GENERATOR_ROLES, read_bench
from hpe_rig.bench.inventory import displayed_roles, lasting_serial, with_serials
from hpe_rig.scene import SettingsError
from sim_backend.world import World


@pytest.fixture
def worlds(monkeypatch: pytest.MonkeyPatch) -> list[World]:
    """Return a list that gets the simulated world of each generator when the generator is opened."""
    world_by_opening: list[World] = []
    connect = World.connect

    def connect_noted(world: World, *arguments: Any) -> Any:
        world_by_opening.append(world)
        return connect(world, *arguments)

    monkeypatch.setattr(World, "connect", connect_noted)
    return world_by_opening


def displays(world: World) -> list[str]:
    return [world._generators[role].registers.display_text for role in GENERATOR_ROLES]


@pytest.mark.parametrize("interrupted", [False, True])
def test_every_generator_displays_its_role_with_its_output_off_until_the_end(
    worlds: list[World], interrupted: bool
) -> None:
    try:
        with displayed_roles(read_bench().bench) as instruments:
            assert list(instruments) == [*GENERATOR_ROLES, "digitizer"]
            assert displays(worlds[0]) == [role.replace("_", " ").upper() for role in GENERATOR_ROLES]
            assert not any(worlds[0].outputs_on().values())
            if interrupted:
                raise KeyboardInterrupt
    except KeyboardInterrupt:
        assert interrupted
    assert displays(worlds[0]) == [""] * len(GENERATOR_ROLES)


class Unlabelled:
    """A generator without serial number and label."""

    label = ""

    def serial_number(self) -> str:
        return self.label

    def store_label(self, label: str) -> None:
        self.label = label


def test_a_generator_without_serial_number_keeps_the_label_that_it_is_given() -> None:
    generator = Unlabelled()
    label = lasting_serial(generator)
    assert re.fullmatch("HPE_[0-9A-F]{6}", label)
    assert lasting_serial(generator) == label
    assert lasting_serial(Unlabelled()) != label


def test_serial_numbers_are_written_into_the_bench_file_and_nothing_else_changes(tmp_path: Path) -> None:
    path, serials = tmp_path / "bench.toml", {"toneburst": "SIM_BOX_3", "digitizer": "460001"}
    text = "# Serial numbers are at the back.\r\n" + read_bench().text.replace("\n", "\r\n")
    path.write_bytes(text.encode())
    edited = with_serials(path, serials)
    added = [line for line in edited.splitlines() if line not in text.splitlines()]
    assert added == ['serial = "SIM_BOX_3"', 'serial = "460001"']
    assert [line for line in edited.splitlines(keepends=True) if line.strip() not in added] == text.splitlines(True)
    with pytest.raises(SettingsError, match="SIM_BOX_3"):
        with_serials(path, {"toneburst": "SIM_BOX_3", "master": "SIM_BOX_3"})
