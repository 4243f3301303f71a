"""README and documentation are right: first scene, study, commands and their options, Python lines, file names.

Blocks of commands and Python are run by ``test_documentation.py``.
"""

from __future__ import annotations

import re
import shlex
import tomllib
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest
from typer.testing import CliRunner

from hpe_rig.cli.app import app
from hpe_rig.study.definition import Definition

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")
PAGES = sorted(path for path in [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")] if "generated" not in path.parts)


def blocks(text: str, language: str) -> list[str]:
    """Return the fenced blocks of ``text`` in ``language``."""
    return re.findall(rf"```{language}\n(.*?)```", text, flags=re.DOTALL)


def output_of(command: str) -> str:
    """Return the standard output of a command; fail if the command fails."""
    done = CliRunner().invoke(app, shlex.split(command))
    assert done.exit_code == 0, f"{command}: {done.output}"
    return done.stdout


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return an empty folder, the current folder during the test."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_the_first_scene_has_few_lines_and_no_specimen() -> None:
    scene = blocks(README, "toml")[0]
    assert len(scene.splitlines()) <= 12
    assert "simulation" not in tomllib.loads(scene)


def test_the_quick_start_and_the_five_things_to_try_run(folder: Path) -> None:
    section = README.partition("## Quick start")[2].partition("\n## ")[0]
    install, test = (block.strip() for block in blocks(section, ""))
    first, _, second = install.partition(" && hpe-rig ")
    assert (first, test) == ("pip install .", 'pip install -e ".[test]" && pytest')
    assert section.count("```") == 4, "the section has two fenced blocks"
    assert "coherent" in output_of(second)
    # Files named in the text below the commands.
    for name in re.findall(r"`([\w.-]+\.(?:h5|html))`", section):
        assert (folder / name).exists(), name
    section = README.partition("## Five things to try")[2].partition("\n## ")[0]
    shown = re.findall(r"^\| `hpe-rig ([^`]+)` \|", section, flags=re.MULTILINE)
    assert len(shown) == 5
    # A live page serves until Ctrl-C, and a study takes minutes; other tests run small ones.
    cheap = [command for command in shown if "--live" not in command and "study" not in command]
    assert len(cheap) == 3
    for command in cheap:
        output_of(command)
    assert {"bovine-muscle.cross_spectrum.h5", "my-scene.toml"} <= {path.name for path in folder.iterdir()}


def study_of_the_page() -> str:
    """Return the study that the page on studies shows."""
    (study,) = blocks((ROOT / "docs" / "how-to" / "studies.md").read_text(encoding="utf-8"), "toml")
    return study


def test_the_study_of_the_page_is_valid() -> None:
    """`test_json_output.py` runs a study by default."""
    definition = Definition.model_validate(tomllib.loads(study_of_the_page()))
    assert (definition.scatterers, definition.noise) == (500, 2)


@pytest.mark.slow
def test_the_study_is_run_at_its_smallest_size(folder: Path) -> None:
    (folder / "mine.toml").write_text(study_of_the_page(), encoding="utf-8")
    output = output_of("study mine.toml --scatterers 2 --noise 2 --workers 1")
    assert "mine" in output
    rows = (folder / "studies" / "mine" / "summary.csv").read_text(encoding="utf-8").splitlines()
    # Three pulse rates and two estimators.
    assert len(rows) - 1 >= 3 * 2
    assert (folder / "studies" / "mine" / "study.json").exists()


@cache
def commands() -> set[str]:
    """Return the commands that ``hpe-rig --help`` lists."""
    return set(re.findall(r"^  ([\w-]+)  ", output_of("--help").partition("Commands:")[2], flags=re.MULTILINE))


@cache
def options(command: str) -> set[str]:
    """Return the options that a command's help lists."""
    return set(re.findall(r"^  (?:-\w, )?(--[a-z-]+)", output_of(f"{command} --help"), flags=re.MULTILINE))


def shown_commands() -> Iterator[tuple[str, str, list[str]]]:
    """Yield page, command and options of every `hpe-rig ...` in README and docs."""
    for page in PAGES:
        for shown in re.findall(r"`hpe-rig ([a-z][^`]*)`", page.read_text(encoding="utf-8")):
            command, *words = shlex.split(shown)
            yield page.name, command, [word for word in words if word.startswith("--")]


def test_commands_and_options_that_the_pages_show_exist() -> None:
    shown = list(shown_commands())
    assert sum(len(words) for _, _, words in shown) > 10
    for page, command, words in shown:
        assert command in commands(), f"{page}: hpe-rig {command}"
        assert set(words) <= options(command), f"{page}: hpe-rig {command} {' '.join(words)}"


def test_the_readme_has_at_most_80_lines() -> None:
    assert len(README.splitlines()) <= 80


def test_the_python_lines_run(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (lines,) = blocks(README, "python")
    names: dict[str, object] = {}
    exec(compile(lines, "README.md", "exec"), names)
    assert {"hpe", "run"} <= set(names)
    assert (folder / "bovine-muscle.h5").exists()
    printed = capsys.readouterr().out.splitlines()
    assert printed[0].startswith("Bovine muscle")
    # Title, source, header and ten frequencies.
    assert len(printed) == 3 + 10


def named_paths(page: Path) -> set[str]:
    """Return the files and folders of this repository that a page names in code font."""
    pattern = r"`((?:hpe_rig|drivers|sim_backend|scripts|tests|docs)/[\w./-]*)`"
    return set(re.findall(pattern, page.read_text("utf-8")))


def test_a_file_that_a_page_names_exists() -> None:
    named = {(page.name, path) for page in PAGES for path in named_paths(page)}
    assert len(named) > 10
    assert [(page, path) for page, path in sorted(named) if not (ROOT / path).exists()] == []
