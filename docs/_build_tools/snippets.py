"""What the pages show that can be run or followed: blocks of commands and Python, settings files, links.

`tests/system/test_documentation.py` runs it, `counts_page` says how much that is: the site has it as a page.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import astuple, dataclass
from pathlib import Path

DOCS = Path(__file__).parents[1]
ROOT = DOCS.parent
WRITTEN = [path for path in sorted(DOCS.rglob("*.md")) if not {"generated", "_build"} & set(path.parts)]
PAGES = {path.relative_to(ROOT).as_posix(): path for path in [ROOT / "README.md", *WRITTEN]}
NOT_RUN = (r"pip install .*", r"pytest.*", r"python -m sphinx .*", r"python scripts/mutation\.py .*")
"""Commands of a page that change the environment or run everything: `.ci/run` runs the first three."""

COUNTS = """# What is run of these pages

{} pages show {} commands, {} blocks of Python and {} settings files, which `tests/system/test_documentation.py` runs
in the order of their page (`-m slow` runs all of them, the default a few pages), and {} links, of which {} are broken.
Counted while this page was written.
"""


@dataclass(frozen=True)
class Block:
    """A fenced block: language, text, and the line that it begins on."""

    language: str
    text: str
    line: int

    @property
    def runs(self) -> bool:
        """Whether it is Python of the page; a file that a reader's own package would hold is none."""
        return self.language == "python" and not self.text.startswith("# my_stage.py")

    @property
    def file_name(self) -> str | None:
        """Name of the settings file that it is, as its first line says."""
        named = re.match(r"# ([\w-]+\.toml)\n", self.text)
        return named[1] if self.language == "toml" and named else None


@dataclass(frozen=True)
class Shown:
    """How many of a page's commands, blocks of Python and settings files are run, and its links and broken links."""

    commands: int
    python: int
    files: int
    links: int
    broken: int


def blocks(page: Path) -> Iterator[Block]:
    """Yield the fenced blocks of a page; a block in a list is indented."""
    text = page.read_text(encoding="utf-8")
    for found in re.finditer(r"^( *)```([^\s`]*)[^\n`]*\n(.*?)^\1```$", text, flags=re.MULTILINE | re.DOTALL):
        indent, language, inner = found.groups()
        lines = [line.removeprefix(indent) for line in inner.splitlines()]
        yield Block(language, "\n".join(lines) + "\n", text[: found.start()].count("\n") + 1)


def commands(block: Block) -> Iterator[tuple[str, int]]:
    """Yield the commands of a console block that are run, with the exit code that each ends with, as a comment says."""
    for line in block.text.splitlines() if block.language == "console" else ():
        shown, _, comment = line.removeprefix("$ ").partition("  #")
        command = shown.strip()
        if command and not any(re.fullmatch(pattern, command) for pattern in NOT_RUN):
            code = re.search(r"exit (\d+)", comment)
            yield command, int(code[1]) if code else 0


def anchors(page: Path) -> set[str]:
    """Return the anchors of a page's headings."""
    headings = re.findall(r"^#+ (.+)$", page.read_text(encoding="utf-8"), flags=re.MULTILINE)
    return {re.sub(r"[^\w -]", "", heading).strip().lower().replace(" ", "-") for heading in headings}


def links(page: Path) -> list[str]:
    """Return where a page's links lead to."""
    return re.findall(r"\]\(([^)]+)\)", page.read_text(encoding="utf-8"))


def is_broken(page: Path, link: str) -> bool:
    """Return whether ``link`` leads to no file or heading of this repository; nothing else is linked to."""
    place, _, anchor = link.partition("#")
    linked = (page.parent / place).resolve() if place else page
    return "://" in place or not linked.exists() or bool(anchor and anchor not in anchors(linked))


def shown(page: Path) -> Shown:
    """Return how much of a page is run and followed."""
    found = list(blocks(page))
    leading = links(page)
    return Shown(
        commands=sum(len(list(commands(block))) for block in found),
        python=sum(block.runs for block in found),
        files=sum(block.file_name is not None for block in found),
        links=len(leading),
        broken=sum(is_broken(page, link) for link in leading),
    )


def counts_page() -> str:
    """Return the page of what the pages show and a test runs."""
    counted = {name: astuple(shown(page)) for name, page in PAGES.items()}
    totals = [sum(column) for column in zip(*counted.values(), strict=True)]
    lines = [COUNTS.format(len(PAGES), *totals)]
    lines += ["| page | commands | Python | files | links | broken |", "|---|---:|---:|---:|---:|---:|"]
    lines += [f"| `{name}` | {' | '.join(map(str, counts))} |" for name, counts in counted.items() if any(counts)]
    return "\n".join([*lines, ""])
