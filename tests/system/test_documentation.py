"""The documentation works: its commands and Python run, its contents are whole, every name and key is in it."""

from __future__ import annotations

import importlib
import importlib.util
import inspect
import re
import shlex
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import pytest
from typer.testing import CliRunner

import hpe_rig
from hpe_rig.cli.app import app

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
WRITTEN = [path for path in sorted(DOCS.rglob("*.md")) if "generated" not in path.parts]
PAGES = {path.relative_to(ROOT).as_posix(): path for path in [ROOT / "README.md", *WRITTEN]}
FAST = (
    "README.md",
    "docs/how-to/bench-file.md",
    "docs/how-to/hook-up.md",
    "docs/tutorials/own-data.md",
)
"""Pages whose blocks run by default; the others take minutes together."""
NOT_RUN = (r"pip install .*", r"pytest.*", r"python -m sphinx .*", r"python scripts/mutation\.py .*")
"""Commands of a page that change the environment or run everything: `.ci/run` runs the first three."""
FIRST = {
    "docs/run-file.md": "hpe-rig run bovine-muscle",
    "docs/bench-safety.md": "hpe-rig new my-bench --like bench",
}
"""Commands that a page supposes to have been run."""


@dataclass(frozen=True)
class Block:
    """A fenced block: language, text, and the line that it begins on."""

    language: str
    text: str
    line: int


def blocks(page: Path) -> Iterator[Block]:
    """Yield the fenced blocks of a page; a block in a list is indented."""
    text = page.read_text(encoding="utf-8")
    for found in re.finditer(r"^( *)```(\S*)\n(.*?)^\1```$", text, flags=re.MULTILINE | re.DOTALL):
        indent, language, inner = found.groups()
        lines = [line.removeprefix(indent) for line in inner.splitlines()]
        yield Block(language, "\n".join(lines) + "\n", text[: found.start()].count("\n") + 1)


def commands(block: Block) -> Iterator[tuple[str, int]]:
    """Yield the commands of a block of a console with the exit code that each ends with; a comment may name it."""
    for line in block.text.splitlines():
        shown, _, comment = line.removeprefix("$ ").partition("  #")
        if shown.strip():
            code = re.search(r"exit (\d+)", comment)
            yield shown.strip(), int(code[1]) if code else 0


def invoke(command: str, code: int) -> None:
    """Run ``hpe-rig ...`` in the current folder; fail where it ends with another exit code."""
    program, *words = shlex.split(command)
    assert program == "hpe-rig", f"{command}: neither run nor named in NOT_RUN"
    done = CliRunner().invoke(app, words)
    assert done.exit_code == code, f"{command}: exit code {done.exit_code}\n{done.output}"


def pages_with_blocks() -> list[object]:
    """Return the pages that show something to run, those that are not `FAST` marked as slow."""
    shown = {"console", "python"}
    names = [name for name, page in PAGES.items() if shown & {block.language for block in blocks(page)}]
    return [pytest.param(name, id=name, marks=() if name in FAST else pytest.mark.slow) for name in names]


@pytest.mark.parametrize("name", pages_with_blocks())
def test_what_a_page_shows_runs(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    if name in FIRST:
        invoke(FIRST[name], 0)
    for block in blocks(PAGES[name]):
        if block.language == "console":
            for command, code in commands(block):
                if not any(re.fullmatch(pattern, command) for pattern in NOT_RUN):
                    invoke(command, code)
        elif block.language == "python" and not block.text.startswith("# my_stage.py"):
            # Compiled with its line, so that a failure says where it stands on the page.
            exec(compile("\n" * block.line + block.text, PAGES[name], "exec"), names)
        elif block.language == "toml" and (named := re.match(r"# ([\w-]+\.toml)\n", block.text)):
            (tmp_path / named[1]).write_text(block.text, encoding="utf-8")


def test_no_command_is_shown_where_nothing_runs_it() -> None:
    """An indented or unnamed block with a command is one that nobody tries."""
    for name, page in PAGES.items():
        text = page.read_text(encoding="utf-8")
        outside = re.sub(r"^( *)```.*?^\1```$", "", text, flags=re.MULTILINE | re.DOTALL)
        assert not re.findall(r"^    (?:\$ )?hpe-rig .*", outside, flags=re.MULTILINE), name


@pytest.fixture(scope="module")
def generate() -> ModuleType:
    """Return the program that writes the generated pages, which is no part of a package."""
    spec = importlib.util.spec_from_file_location("generate", DOCS / "generate.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["generate"] = module
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def generated(generate: ModuleType) -> dict[str, str]:
    return dict(generate.pages())


def test_the_reference_holds_every_command_with_its_options(generated: dict[str, str], generate: ModuleType) -> None:
    page = generated["commands.md"]
    names = generate.command_names()
    assert ("run",) in names
    assert len(names) > 15
    for words in names:
        assert f"## hpe-rig {' '.join(words)}".rstrip() in page
    assert page.count("Usage: hpe-rig") == len(names)
    assert "--estimator" in page


def test_the_reference_holds_every_key_of_the_schemas_with_an_example(generated: dict[str, str]) -> None:
    from hpe_rig.acquire import settings_tables

    for of in ("scene", "bench", "simulation"):
        rows = [line for line in generated[f"{of}.md"].splitlines() if line.startswith("| `")]
        keys = [key.name for table in settings_tables(of) for key in table.keys]
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
        f"{room}.{name}"
        for room in generate.ROOMS
        for name, about in generate.offered_names(importlib.import_module(f"hpe_rig.{room}"))
        if about in ("", ".")
    ]
    assert bare == []


def test_every_page_is_in_the_contents() -> None:
    """Sphinx would warn of a page that no table of contents leads to; this says so without Sphinx."""
    listed = {"docs/index.md"}
    for page in PAGES.values():
        if page.is_relative_to(DOCS):
            for block in blocks(page):
                if block.language == "{toctree}":
                    listed |= set(_entries(page, block.text))
    missing = [name for name in PAGES if name.startswith("docs/") and name not in listed]
    assert missing == []


def _entries(page: Path, toctree: str) -> Iterator[str]:
    for line in toctree.splitlines():
        entry = re.sub(r".*<(.*)>", r"\1", line.strip())
        if entry == "*":
            yield from (path.relative_to(ROOT).as_posix() for path in page.parent.glob("*.md"))
        elif entry and not entry.startswith(":"):
            yield (page.parent / f"{entry}.md").resolve().relative_to(ROOT).as_posix()
