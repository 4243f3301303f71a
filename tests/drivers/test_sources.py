"""The sections that drivers and twin cite exist in the repository."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from drivers.agilent import MODELS as GENERATORS
from drivers.alazar.models import MODELS as BOARDS, BoardModel

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


TEXT = (ROOT / PAGE).read_text(encoding="utf-8")


def rows_below(heading: str) -> list[list[str]]:
    """Return the cells of the rows of the first table below ``heading``."""
    table = TEXT.partition(heading)[2].partition("\n|")[2].partition("\n\n")[0]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in table.splitlines() if "---" not in line]


def test_the_clock_accuracies_are_those_of_the_page() -> None:
    ppm = {}
    for cells in rows_below("### Clocks"):
        for names, number in ((cells[0], cells[1]), (cells[3], cells[4])):
            ppm |= {name: number.partition(",")[0] for name in names.split(", ") if number[:1].isdigit()}
    stated = {model.name: model.clock_accuracy for model in (*GENERATORS, *BOARDS)}
    assert {name: float(number) * 1e-6 for name, number in ppm.items()} == pytest.approx(stated)


@pytest.mark.parametrize("model", BOARDS, ids=lambda model: model.name)
def test_the_row_of_a_board_is_its_row_of_the_page(model: BoardModel) -> None:
    titles, *rows = rows_below("### 2.10 Other boards")
    (row,) = (cells for cells in rows if cells[0] == model.name)
    facts = {title: cell.partition(",")[0] for title, cell in zip(titles, row, strict=True)}
    multiples = re.findall(r"\d+", facts["record, a multiple of"])
    assert facts["kind"] == str(model.kind)
    assert facts["bits"] == str(model.code_bits)
    assert facts["trigger input, V"] == f"{model.trigger_range_v:g}"
    assert facts["shortest record"] == str(model.record_minimum)
    assert (multiples[0], multiples[-1]) == (str(model.record_multiple), str(model.npt_record_multiple))
    assert facts["pre-trigger, a multiple of"] == str(model.pre_trigger_multiple)
    assert facts["trigger delay, a multiple of"] == str(model.trigger_delay_multiple)
    assert facts["samples a count in headers"] in (str(model.samples_per_timestamp), "assumed; the board is queried")
    assert model.samples_per_timestamp == 2
    assert facts["dual-port memory"] == ("always" if model.always_dual_port else "option")
    assert facts["buffer"] == f"< {model.buffer_limit_bytes // 2**20} MiB"
    assert model.buffer_limit_bytes % 2**20 == 0
    # Sections 2.3, 2.5 and 2.6 hold for all boards; old FPGA versions are those of the ATS460.
    assert "0 to 9 999 999 samples" in TEXT
    assert model.max_trigger_delay_samples == 9_999_999
    assert "record length plus 16, and to 256 000" in TEXT
    # 48 samples of memory for each record: 32 and the overhead.
    assert model.most_records(48 * 255_999 + 47, 32) == 255_999
    assert model.most_records(48 * 300_000, 32) == 256_000
    assert model.record_limit(19) == 256_000
    assert model.record_limit(18) == (1000 if model.name == "ATS460" else 256_000)
    assert model.stamped_records == 1000
