"""The sections that drivers and twin cite exist in the repository."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGE = "docs/explanation/instruments.md"
CITATION = re.compile(rf"{re.escape(PAGE)},\s+(\d(?:\.\d)?(?:(?:,| and| to)\s+\d\.\d)*)")


def cited() -> dict[str, set[str]]:
    """Return the section numbers by the file that cites them."""
    citations: dict[str, set[str]] = {}
    for package in ("drivers", "sim_backend"):
        for path in sorted((ROOT / package).rglob("*.py")):
            for numbers in CITATION.findall(path.read_text(encoding="utf-8")):
                citations.setdefault(str(path.relative_to(ROOT)), set()).update(re.findall(r"\d(?:\.\d)?", numbers))
    return citations


def test_every_cited_section_is_there() -> None:
    headings = re.findall(r"^#+ (\d(?:\.\d)?) ", (ROOT / PAGE).read_text(encoding="utf-8"), flags=re.MULTILINE)
    missing = {path: numbers - set(headings) for path, numbers in cited().items() if numbers - set(headings)}
    assert missing == {}


def test_drivers_and_twin_cite_their_sources() -> None:
    files = cited()
    assert {"drivers/agilent/programs.py", "drivers/alazar/models.py"} <= files.keys()
    assert {"sim_backend/generator/commands.py", "sim_backend/digitizer/codes.py"} <= files.keys()
