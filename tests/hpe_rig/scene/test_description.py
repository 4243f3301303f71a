"""Files with every key: what they set is unchanged, and every default that they state is the real one."""

from __future__ import annotations

import math
import re
import tomllib
from pathlib import Path

import pytest

from hpe_rig.bench import parse_bench, read_bench
from hpe_rig.runs import full_text, settings_tables
from hpe_rig.scene import parse_scene, shipped_scenes
from hpe_rig.scene.description import toml_value


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=() if name in ("gelatin-8", "muscle-force") else pytest.mark.slow)
        for name in shipped_scenes()
    ],
)
def test_a_scene_with_every_key_is_the_same_scene(name: str) -> None:
    text = shipped_scenes()[name]
    assert parse_scene(name, full_text("scene", text)).scene == parse_scene(name, text).scene


def test_a_bench_with_every_key_is_the_same_bench() -> None:
    bench = read_bench()
    assert parse_bench("full", full_text("bench", bench.text)).bench == bench.bench


def test_the_defaults_that_the_comments_state_are_those_that_hold() -> None:
    """With the mark of a comment taken from every stated default, the scene is the same."""
    text = shipped_scenes()["bovine-muscle"]
    full = full_text("scene", text)
    # Of sections that are there alone: others begin to act by being there, or need keys without a default.
    stated, there = [], True
    for line in full.splitlines():
        if re.match(r"(# )?\[", line):
            there = line.startswith("[") and "simulation" not in line
        stated.append(re.sub(r"^# (\w+ = .+)", r"\1", line) if there else line)
    assert sum(a != b for a, b in zip(full.splitlines(), stated, strict=True)) > 15
    assert parse_scene("stated", "\n".join(stated)).scene == parse_scene("scene", text).scene


def test_every_key_of_a_scene_stands_in_the_full_one_with_words() -> None:
    full = full_text("scene", shipped_scenes()["table-1"])
    for of in ("scene", "simulation"):
        for table in settings_tables(of):
            for key in table.keys:
                assert re.search(rf"^(# )?{key.name} =", full, flags=re.MULTILINE), key.name
                assert len(key.text) > 10, key.name


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (1e-4, "100e-6"),
        (9e6, "9e6"),
        (3990.0, "3990.0"),
        (0.0, "0.0"),
        (1.32e-3, "1.32e-3"),
        (True, "true"),
        (20, "20"),
    ],
)
def test_numbers_are_written_as_people_write_them_and_read_back_the_same(value: float, text: str) -> None:
    assert toml_value(value) == text
    assert tomllib.loads(f"x = {text}")["x"] == value


def test_no_number_changes_by_being_written() -> None:
    for value in (0.1 + 0.2, 1 / 3 * 1e-7, math.inf, 1.7976931348623157e308, 5e-324, 123456.789):
        assert float(toml_value(value)) == value


def test_full_names_a_path_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from typer.testing import CliRunner

    from hpe_rig.cli.app import app

    monkeypatch.chdir(tmp_path)
    assert CliRunner().invoke(app, ["new", "mine", "--full"]).exit_code == 0
    written = (tmp_path / "mine.toml").read_text(encoding="utf-8")
    assert parse_scene("mine", written).scene == parse_scene("mine", shipped_scenes()["bovine-muscle"]).scene
    assert "# shot_period_s =" in written
