"""The commands, blocks of Python, settings files and links of the documentation, for the tests that run them."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

DOCS = Path(__file__).parents[1]
ROOT = DOCS.parent
SOURCES = [path for path in sorted(DOCS.rglob("*.md")) if not {"generated", "_build"} & set(path.parts)]
PAGES = {path.relative_to(ROOT).as_posix(): path for path in [ROOT / "README.md", *SOURCES]}
NOT_RUN = (r"pip install .*", r"pytest.*", r"python -m sphinx .*", r"python scripts/mutation\.py .*")
"""Commands that no test runs, because they change the environment or run everything; `.ci/run` runs the first three."""


@dataclass(frozen=True)
class Block:
    """A fenced block: language, text, and number of its first line."""

    language: str
    text: str
    line: int

    @property
    def runs(self) -> bool:
        """Whether it is Python to run; a module of a reader's package is not."""
        return self.language == "python" and not self.text.startswith("# my_stage.py")

    @property
    def file_name(self) -> str | None:
        """Name of the settings file in the block, from its first line; None for other blocks."""
        match = re.match(r"# ([\w-]+\.toml)\n", self.text)
        return match[1] if self.language == "toml" and match else None

    @property
    def changed_file(self) -> str | None:
        """Name of the settings file that the block changes; None for other blocks."""
        match = re.match(r"# change in ([\w-]+\.toml)\n", self.text)
        return match[1] if self.language == "toml" and match else None


def with_changes(settings: str, changes: str) -> str:
    """Return the text of a settings file with the values of ``changes``; keys that it lacks are added to their table.

    >>> with_changes("title = 'a'\\n[x]\\nb = 1  # why\\n", "[x]\\nb = 2\\nc = 3\\n")
    "title = 'a'\\n[x]\\nc = 3\\nb = 2\\n"
    """
    header = ""
    for line in changes.splitlines():
        key = line.partition(" = ")[0]
        if line.startswith("["):
            header = line + "\n"
        elif key != line:
            table = re.search(rf"(?:^|(?<=\n)){re.escape(header)}(?:[^\[\n].*\n|\n)*", settings)
            assert table, f"{header.strip()} is not in the file"
            lines = table[0].removeprefix(header)
            present = re.search(rf"^{key} = .*", lines, flags=re.MULTILINE)
            body = lines.replace(present[0], line) if present else f"{line}\n{lines}"
            settings = settings[: table.start()] + header + body + settings[table.end() :]
    return settings


def printed(page: Path) -> list[str]:
    """Return the lines of output that a page shows: indented, outside fences; without lines of dots."""
    outside = re.sub(r"^( *)```.*?^\1```$", "", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    return [line for line in re.findall(r"^    (.+)$", outside, flags=re.MULTILINE) if line.strip() != "..."]


def blocks(page: Path) -> Iterator[Block]:
    """Yield the fenced blocks of a page; blocks in lists are indented."""
    text = page.read_text(encoding="utf-8")
    for match in re.finditer(r"^( *)```([^\s`]*)[^\n`]*\n(.*?)^\1```$", text, flags=re.MULTILINE | re.DOTALL):
        indent, language, inner = match.groups()
        lines = [line.removeprefix(indent) for line in inner.splitlines()]
        yield Block(language, "\n".join(lines) + "\n", text[: match.start()].count("\n") + 1)


def commands(block: Block) -> Iterator[tuple[str, int]]:
    """Yield (command, exit code) of a console block; a comment states an exit code other than 0."""
    for line in block.text.splitlines() if block.language == "console" else ():
        typed, _, comment = line.removeprefix("$ ").partition("  #")
        command = typed.strip()
        if command and not any(re.fullmatch(pattern, command) for pattern in NOT_RUN):
            code = re.search(r"exit (\d+)", comment)
            yield command, int(code[1]) if code else 0


def matlab_datasets(block: Block) -> list[tuple[str, str]]:
    """Return file name and path of the datasets that a block of MATLAB reads."""
    is_matlab = block.language == "matlab"
    return re.findall(r"h5read\('([^']+)', '([^']+)'", block.text) if is_matlab else []


def anchors(page: Path) -> set[str]:
    """Return the anchors of a page's headings."""
    headings = re.findall(r"^#+ (.+)$", page.read_text(encoding="utf-8"), flags=re.MULTILINE)
    return {re.sub(r"[^\w -]", "", heading).strip().lower().replace(" ", "-") for heading in headings}


def links(page: Path) -> list[str]:
    """Return the targets of the links of a page."""
    return re.findall(r"\]\(([^)]+)\)", page.read_text(encoding="utf-8"))


def is_broken(page: Path, link: str) -> bool:
    """Return whether ``link`` leads outside the repository or to a missing file or heading."""
    target, _, anchor = link.partition("#")
    linked = (page.parent / target).resolve() if target else page
    return "://" in target or not linked.exists() or bool(anchor and anchor not in anchors(linked))
