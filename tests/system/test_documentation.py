"""Commands and Python of the documentation run, its links exist, and it contains every name and key."""

from __future__ import annotations

import importlib
import inspect
import json
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import h5py
import pytest
from typer.testing import CliRunner

import hpe_rig
from hpe_rig.cli.app import app

DOCS = Path(__file__).parents[2] / "docs"
FAST = (
    "docs/how-to/hook-up.md",
    "docs/tutorials/own-data.md",
)
"""Pages that run by default; together the others take minutes."""
PREPARATION = {
    "docs/reference/run-file.md": "hpe-rig run bovine-muscle",
    "docs/how-to/bench-safety.md": "hpe-rig new my-bench --like bench",
}
"""Commands that the text of a page assumes to have been run."""

EVENING = "docs/tutorials/an-evening.md"
SHORT_EVENING = """
[excitation]
burst_count = 6
[acquisition]
repeats = 1
[processing]
window_start_s = 40e-3
frequencies_hz = [50.0, 100.0, 200.0]
[sweep]
lateral_offset_m = [1.0e-3, 2.25e-3, 3.5e-3]
"""


def program(name: str) -> ModuleType:
    """Import a module of ``docs/_build_tools``, which is not part of a package."""
    sys.path.insert(0, str(DOCS / "_build_tools"))
    try:
        return importlib.import_module(name)
    finally:
        sys.path.remove(str(DOCS / "_build_tools"))


SNIPPETS = program("snippets")
PAGES: dict[str, Path] = SNIPPETS.PAGES


def invoke(command: str, code: int) -> str:
    """Run ``hpe-rig ...`` in the current folder, assert its exit code, and return its output; "> FILE" writes it."""
    typed, _, file_name = command.partition(" > ")
    program, *words = shlex.split(typed)
    assert program == "hpe-rig", f"{command}: neither run nor named in NOT_RUN"
    done = CliRunner().invoke(app, words)
    assert done.exit_code == code, f"{command}: exit code {done.exit_code}\n{done.output}"
    if file_name:
        Path(file_name).write_text(done.stdout, encoding="utf-8")
    return done.output


def pages_to_run() -> list[object]:
    """Return the pages with commands or Python; those not in `FAST` are marked as slow."""
    blocks = {name: list(SNIPPETS.blocks(page)) for name, page in PAGES.items()}
    names = [name for name in PAGES if any(block.runs or list(SNIPPETS.commands(block)) for block in blocks[name])]
    return [pytest.param(name, id=name, marks=() if name in FAST else pytest.mark.slow) for name in names]


def run_page(name: str, folder: Path, changes: str = "") -> str:
    """Run commands and Python of a page in ``folder``, the current one, and return the printed text.

    ``changes`` are further settings, made after the page's first change of a settings file.
    """
    namespace: dict[str, object] = {}
    outputs = [invoke(PREPARATION[name], 0)] if name in PREPARATION else []
    for block in SNIPPETS.blocks(PAGES[name]):
        outputs += [invoke(command, code) for command, code in SNIPPETS.commands(block)]
        if block.runs:
            # Blank lines before the code make line numbers in a traceback those of the page.
            exec(compile("\n" * block.line + block.text, PAGES[name], "exec"), namespace)
        if block.file_name:
            (folder / block.file_name).write_text(block.text, encoding="utf-8")
        if block.changed_file:
            file = folder / block.changed_file
            settings = SNIPPETS.with_changes(file.read_text(encoding="utf-8"), block.text)
            file.write_text(SNIPPETS.with_changes(settings, changes), encoding="utf-8")
            changes = ""
        for file_name, dataset in SNIPPETS.matlab_datasets(block):
            with h5py.File(folder / file_name) as opened:
                assert dataset in opened, f"{file_name}{dataset}"
    return "\n".join(outputs)


@pytest.mark.parametrize("name", pages_to_run())
def test_commands_and_python_of_a_page_run_and_print_the_shown_lines(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Indented lines of a page are the beginnings of lines that its commands print."""
    monkeypatch.chdir(tmp_path)
    lines = {" ".join(line.split()) for line in run_page(name, tmp_path).splitlines()}
    shown = [" ".join(line.split()) for line in SNIPPETS.printed(PAGES[name])]
    assert [line for line in shown if not any(printed.startswith(line) for printed in lines)] == []


@pytest.mark.slow
def test_every_line_of_the_evening_runs_with_fewer_settings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    output = run_page(EVENING, tmp_path, SHORT_EVENING)
    assert "omitted: 1 mm: shots 2 to 3, of a weaker force or another burst length" in output
    figure = (tmp_path / "gelatin.pdf").read_bytes()
    # 85 mm are 240.9 points.
    assert re.search(rb"/MediaBox \[ 0 0 240\.9\d* ", figure)
    assert (tmp_path / "gelatin-8pc.csv").read_text(encoding="utf-8").count("\n") == 1 + 3 * 3 * 3
    assert (tmp_path / "gelatin-8pc.mat").stat().st_size > 0


def test_the_documentation_shows_many_commands_and_blocks_of_python() -> None:
    blocks = [block for page in PAGES.values() for block in SNIPPETS.blocks(page)]
    assert sum(len(list(SNIPPETS.commands(block))) for block in blocks) > 50
    assert sum(block.runs for block in blocks) > 12


@pytest.mark.parametrize("name", PAGES)
def test_the_target_of_every_link_exists(name: str) -> None:
    assert [link for link in SNIPPETS.links(PAGES[name]) if SNIPPETS.is_broken(PAGES[name], link)] == []


RUN_ELSEWHERE = {
    "README.md": "test_readme.py",
    "docs/how-to/cluster.md": "a cluster is needed; tests/hpe_rig/study/test_run.py starts a scheduler",
    "docs/how-to/rehearse.md": "tests/hpe_rig/bench/test_emulation.py, which interrupts emulate as Ctrl-C does",
    "docs/how-to/import-simulations.md": "test_import_of_simulations.py, which needs the simulators",
    "docs/how-to/research-scanners.md": "tests/hpe_rig/recordings/test_scanners.py, which makes a buffer of Verasonics",
}
"""Pages with a command that these tests do not run, and the test that runs it."""


def test_every_command_shown_is_run_by_a_test() -> None:
    """Commands in indented or unnamed blocks would not be run."""
    not_run = set()
    for name, page in PAGES.items():
        text = page.read_text(encoding="utf-8")
        outside = re.sub(r"^( *)```.*?^\1```$", "", text, flags=re.MULTILINE | re.DOTALL)
        assert not re.findall(r"^    (?:\$ )?hpe-rig .*", outside, flags=re.MULTILINE), name
        named = [block for block in SNIPPETS.blocks(page) if block.language != "console"]
        not_run |= {name for block in named if re.search(r"^(\$ |.*&& )?hpe-rig ", block.text, flags=re.MULTILINE)}
    assert not_run == set(RUN_ELSEWHERE)


@pytest.fixture(scope="module")
def generate() -> ModuleType:
    """Return the module that generates pages."""
    return program("generate")


@pytest.fixture(scope="module")
def generated(generate: ModuleType) -> dict[str, str]:
    """Return the generated pages that these tests read; `test_messages.py` provokes the messages of another one."""
    settings = {f"{subject}.md": generate.settings_page(subject) for subject in ("scene", "bench", "simulation")}
    return {**settings, "commands.md": generate.commands_page(), "api.md": generate.api_page()}


def test_the_reference_lists_every_command_with_its_options(generated: dict[str, str], generate: ModuleType) -> None:
    page = generated["commands.md"]
    names = generate.command_names()
    assert ("run",) in names
    assert len(names) > 15
    for words in names:
        assert f"## hpe-rig {' '.join(words)}".rstrip() in page
    assert page.count("Usage: hpe-rig") == len(names)
    assert "--estimator" in page


def test_the_reference_lists_every_key_with_an_example(generated: dict[str, str]) -> None:
    from hpe_rig.runs import settings_tables

    for subject in ("scene", "bench", "simulation"):
        rows = [line for line in generated[f"{subject}.md"].splitlines() if line.startswith("| `")]
        keys = [key.name for table in settings_tables(subject) for key in table.keys]
        assert [re.match(r"\| `([^`]+)`", row)[1] for row in rows] == keys  # type: ignore[index]
        assert [row for row in rows if row.endswith("|  |")] == []


def test_every_public_name_is_documented(generated: dict[str, str], generate: ModuleType) -> None:
    for name in hpe_rig.__all__:
        assert inspect.getdoc(getattr(hpe_rig, name)), name
        assert f":: hpe_rig.{name}\n" in generated["api.md"]
        public = getattr(hpe_rig, name)
        for member, value in vars(public).items() if inspect.isclass(public) else ():
            if not member.startswith("_") and (inspect.isroutine(value) or isinstance(value, property)):
                assert inspect.getdoc(value), f"{name}.{member}"
    bare = [
        f"{package}.{name}"
        for package in generate.PACKAGES
        for name, text in generate.described_names(importlib.import_module(package))
        if text in ("", ".")
    ]
    assert bare == []
    assert {"hpe_rig.recordings", "hpe_rig.extensions", "drivers.alazar", "sim_backend.echoes"} <= set(
        generate.PACKAGES
    )


SEARCHES = {
    "verasonics": "how-to/research-scanners",
    "uff": "how-to/research-scanners",
    "cite": "project/citing",
    "licence": "project/citing",
    "license": "project/citing",
    "phase velocity": "how-to/dispersion",
    "oscilloscope": "how-to/oscilloscopes",
    "excel": "how-to/cookbook",
}
"""Searches of readers, and the page that each has to find."""


@pytest.mark.external
def test_the_site_is_built_without_warning_and_its_search_finds_the_page_of_a_task(tmp_path: Path) -> None:
    from sphinx.search.en import SearchEnglish

    command = [sys.executable, "-m", "sphinx", "-q", "-W", str(DOCS), str(tmp_path)]
    subprocess.run(command, check=True, cwd=DOCS.parent)
    index = json.loads(re.sub(r"^Search\.setIndex\(|\)$", "", (tmp_path / "searchindex.js").read_text("utf-8")))
    stem = SearchEnglish({}).stem

    def pages_with(word: str) -> set[str]:
        """Return the pages whose text or titles contain a word with the same stem, as the search of the site does."""
        entries = [index[terms].get(stem(word), []) for terms in ("terms", "titleterms")]
        numbers = [number for entry in entries for number in (entry if isinstance(entry, list) else [entry])]
        return {index["docnames"][number] for number in numbers}

    found = {search: set.intersection(*map(pages_with, search.split())) for search in SEARCHES}
    assert {search: page for search, page in SEARCHES.items() if page not in found[search]} == {}


def test_every_page_is_in_the_contents() -> None:
    """Sphinx warns of a page that is in no table of contents; this test needs no Sphinx."""
    listed = {"docs/index.md"}
    for page in PAGES.values():
        if page.is_relative_to(DOCS):
            for block in SNIPPETS.blocks(page):
                if block.language == "{toctree}":
                    listed |= set(_entries(page, block.text))
    missing = [name for name in PAGES if name.startswith("docs/") and name not in listed]
    assert missing == []


def _entries(page: Path, toctree: str) -> Iterator[str]:
    for line in toctree.splitlines():
        entry = re.sub(r".*<(.*)>", r"\1", line.strip())
        if entry == "*":
            yield from (path.relative_to(DOCS.parent).as_posix() for path in page.parent.glob("*.md"))
        elif entry and not entry.startswith(":"):
            yield (page.parent / f"{entry}.md").resolve().relative_to(DOCS.parent).as_posix()
