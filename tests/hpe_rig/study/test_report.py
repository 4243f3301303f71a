"""The studies' page: needs nothing else, says what it shows; tables download whole, figures show every point."""

from __future__ import annotations

import base64
import csv
import io
import itertools
import math
import re
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.collections import PolyCollection, QuadMesh

from hpe_rig.report.page_writer import (
    MAX_EMBEDDED_ROWS,
    MAX_ROWS,
    PageSection,
    cell_text,
    page_table,
    render_sections,
)
from hpe_rig.result import Picture
from hpe_rig.store import StoreError, write_file
from hpe_rig.study.curve_figures import BAND, curve_alt, curve_figure
from hpe_rig.study.definition import Definition
from hpe_rig.study.map_figures import map_figure
from hpe_rig.study.report import _headline, study_section, write_study_report
from hpe_rig.study.results import StudyResult
from hpe_rig.study.run import run_study
from hpe_rig.study.series import is_map, refused_text, value_text, views
from hpe_rig.validation.paper.reproduction import reproduction_part

TINY = """
title = "<b>tiny</b> & small"
scene = "table-1"
scatterers = 16
common = "all"
readings = { physical = ["cross_spectrum"], literal = ["cross_spectrum"] }
set = { "tracking.pulse_count" = 40 }
[[axes]]
name = "D_0"
unit = "m"
keys = { "simulation.motion[0].amplitude_m" = [500e-9, 1e-6] }
[[axes]]
name = "SNR"
unit = "dB"
keys = { "simulation.receiver.snr_db" = [10.0, 40.0] }
"""


class Outline(HTMLParser):
    """Every element's attributes, and whether the tags are balanced."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.open: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))
        if tag not in {"meta", "br", "img"}:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("studies")


@pytest.fixture(scope="module")
def tiny(folder: Path) -> StudyResult:
    (folder / "fig-5.toml").write_text(TINY, encoding="utf-8")
    return run_study(str(folder / "fig-5.toml"), folder, lambda: ThreadPoolExecutor(1))[0]


@pytest.fixture(scope="module")
def page(folder: Path, tiny: StudyResult) -> str:
    return write_study_report("fig-5", [tiny], folder, filter(None, [reproduction_part([tiny])])).read_text(
        encoding="utf-8"
    )


def test_the_page_is_whole_and_asks_nothing_of_the_network(page: str) -> None:
    outline = Outline(page)
    assert outline.open == []
    assert {tag for tag, _ in outline.elements}.isdisjoint({"script", "link", "iframe", "img"})
    for _, attributes in outline.elements:
        for name in ("href", "src", "xlink:href"):
            assert (attributes.get(name) or "#").startswith(("#", "data:"))
    ids = [attributes["id"] for _, attributes in outline.elements if "id" in attributes]
    assert len(ids) == len(set(ids))
    assert "<b>tiny</b>" not in page
    assert "&lt;b&gt;tiny&lt;/b&gt; &amp; small" in page


def test_every_picture_is_named_and_told_in_words(page: str) -> None:
    pictures = [attributes for tag, attributes in Outline(page).elements if tag == "svg"]
    assert len(pictures) == 3
    for attributes in pictures:
        assert attributes["role"] == "img"
        for key in (attributes["aria-labelledby"] or "").split():
            assert re.search(rf'id="{key}">[^<]{{10,}}<', page)


def test_the_table_behind_a_study_downloads_in_full_precision(page: str, tiny: StudyResult) -> None:
    links = {a["download"]: a["href"] for tag, a in Outline(page).elements if tag == "a" and "download" in a}
    assert set(links) == {"reproduction.csv", "overview.csv", "fig-5.csv", "time-by-study.csv", "realisations.csv"}
    text = base64.b64decode((links["fig-5.csv"] or "").partition("base64,")[2]).decode()
    rows = list(csv.DictReader(io.StringIO(text)))
    assert [float(row["amplitude_bias_m"]) for row in rows] == [row["amplitude_bias_m"] for row in tiny.rows]
    assert rows[0]["reading"] == "physical"


def test_every_figure_stands_beside_the_results_as_svg_and_png(folder: Path, page: str) -> None:
    names = {path.name for path in (folder / "fig-5").iterdir()}
    for reading in ("physical", "literal"):
        assert {f"fig-5-{reading}-cross_spectrum-200.{suffix}" for suffix in ("svg", "png")} <= names
    assert (folder / "fig-5" / "fig-5-physical-cross_spectrum-200.png").read_bytes().startswith(b"\x89PNG")


def test_the_page_counts_the_verdicts_and_a_link_shows_those_rows_alone(page: str, tiny: StudyResult) -> None:
    elements = Outline(page).elements
    places = {attributes.get("id") for _, attributes in elements}
    links = re.findall(r'href="#(reproduction-[^"]*)">(\d+) ([^<]*)</a>', page)
    told = reproduction_part([tiny])
    assert told is not None
    for reading in ("physical", "literal"):
        verdicts = Counter(row[f"verdict, {reading}"] for row in told.tables[0].rows)
        found = {verdict: int(count) for anchor, count, verdict in links if f"-{reading}-" in anchor}
        assert found == verdicts
    for anchor, count, _ in links:
        assert anchor in places
        assert f"#{anchor}:target ~ .scroll tbody tr:not(.{anchor})" in page
        rows = [a for tag, a in elements if tag == "tr" and anchor in (a.get("class") or "").split()]
        assert len(rows) == int(count)


def test_the_page_begins_with_what_was_found_and_ends_with_how_long_it_took(page: str) -> None:
    heads = re.findall(r'<h2 id="([^"]*)"', page)
    assert heads == ["reproduction-section", "overview-section", "fig-5-section", "run-time-section", "made"]
    first = page[page.index('class="headline"') :].partition("</p>")[0]
    assert "Statements of the paper" in first


def test_what_refused_estimates_leave_out_is_said(tiny: StudyResult, tmp_path: Path) -> None:
    assert refused_text(tiny.rows) == ""
    words = refused_text([{**row, "refused": 3} for row in tiny.rows[:2]])
    assert words == (
        "6 estimates were refused. Bias and jitter exclude them and all others of the same draw of scatterers."
    )
    holed = replace(tiny, rows=[{**row, "refused": 3} for row in views(tiny)[0].rows])
    assert refused_text(holed.rows) in study_section(holed, tmp_path).paragraphs


def test_the_four_panels_have_units_and_bands_of_two_errors(tiny: StudyResult) -> None:
    one = views(tiny)[0]
    panels = curve_figure(tiny, one).axes
    labels = [axes.get_ylabel() for axes in panels]
    assert [label[:3] for label in labels] == ["(a)", "(b)", "(c)", "(d)"]
    assert all(label.endswith(("(nm)", "(degrees)")) for label in labels)
    assert panels[2].get_xlabel() == "SNR (dB)"
    band = next(part for part in panels[0].collections if isinstance(part, PolyCollection))
    height_nm = np.ptp(band.get_paths()[0].vertices[:, 1][band.get_paths()[0].vertices[:, 0] == 40.0])
    row = next(r for r in one.rows if r["D_0"] == 500e-9 and r["SNR"] == 40.0)
    assert height_nm == pytest.approx(2 * BAND * row["amplitude_bias_se_m"] * 1e9, rel=1e-9)
    assert "D_0 = 500 nm" in curve_alt(tiny, one)


@pytest.mark.parametrize(
    "axis",
    [
        {"name": "pulse", "keys": {"simulation.scatterers.pulse": ["hann", "gaussian"]}},
        pytest.param(
            {"name": "W", "keys": {"simulation.beams.width_ratio": [[2.19, 2.19, 2.18]]}}, marks=pytest.mark.slow
        ),
    ],
)
def test_axes_of_words_and_single_draws_are_drawn_too(tiny: StudyResult, tmp_path: Path, axis: dict[str, Any]) -> None:
    definition = Definition.model_validate({**tiny.definition.model_dump(), "axes": [axis]})
    (values,) = axis["keys"].values()
    silent = {name: math.nan for name in tiny.rows[0] if "_se_" in name}
    rows = [{**tiny.rows[0], **silent, axis["name"]: value} for value in values]
    study = StudyResult("words", definition, rows, ("0",))
    page = write_study_report("words", [study], tmp_path).read_text(encoding="utf-8")
    assert all(str(value) in page for value in values)
    assert "one draw has no standard error" in page
    assert "nan %" not in page
    ticks = curve_figure(study, views(study)[0]).axes[0].get_xticklabels()
    assert [tick.get_text() for tick in ticks] == [str(value) for value in values]


def test_a_map_shows_every_computed_point_and_no_other(tiny: StudyResult) -> None:
    places = {"W_z": [2.18], "W_x": np.geomspace(0.1, 10, 9).tolist(), "W_y": np.geomspace(0.1, 10, 7).tolist()}
    axes = [{"name": name, "keys": {name: values}} for name, values in places.items()]
    definition = Definition.model_validate({**tiny.definition.model_dump(), "axes": axes})
    rows = [
        {
            **tiny.rows[0],
            **dict(zip(places, at, strict=True)),
            "amplitude_true_m": 1e-6,
            "amplitude_bias_m": -1e-6 / (1 + at[1]),
        }
        for at in itertools.product(*places.values())
    ]
    study, w_x = StudyResult("map", definition, rows, ("0",)), np.array(places["W_x"])
    assert is_map(study)
    mesh = next(part for part in map_figure(study, views(study)[0]).axes[0].collections if isinstance(part, QuadMesh))
    values = np.asarray(mesh.get_array())
    assert values.shape == (7, 9)
    assert values[3] == pytest.approx(1 - 1 / (1 + w_x), rel=1e-12)


def test_numbers_and_long_tables_are_shown_as_a_person_reads_them() -> None:
    assert [cell_text(value) for value in (float("nan"), None, True, 3, 0.81453, 2.5e-9)] == [
        "–",
        "–",
        "yes",
        "3",
        "0.8145",
        "2.50e-09",
    ]
    assert [value_text(v, u) for v, u in ((1e-6, "m"), (5e-4, "m"), (1e8, "Hz"), (0.065, ""))] == [
        "1000 nm",
        "0.5 mm",
        "100 MHz",
        "0.065",
    ]
    rows = [{"a": k} for k in range(MAX_ROWS + 5)]
    text = render_sections(
        "t",
        [],
        [PageSection("p", "P", (), (Picture("k", "t", "a", "<svg></svg>"),), (page_table("rows", "Many.", rows),))],
    )
    assert text.count("<tr>") == MAX_ROWS + 1
    assert f"of {MAX_ROWS + 5} rows" in text


def test_a_table_too_long_for_the_page_is_the_file_beside_it() -> None:
    few, many = ([{"a": k} for k in range(count)] for count in (MAX_EMBEDDED_ROWS, MAX_EMBEDDED_ROWS + 1))
    text = render_sections(
        "t",
        [],
        [
            PageSection(
                "p", "P", (), (), tuple(page_table("x", "X", rows, csv_path="my study/s.csv") for rows in (few, many))
            )
        ],
    )
    assert text.count("data:text/csv") == 1
    assert 'href="my%20study/s.csv"' in text


def test_a_page_that_cannot_be_written_says_so(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(StoreError, match="cannot be written"):
        write_file(tmp_path / "file" / "page.html", "")


def test_figures_of_several_frequencies_state_theirs(tiny: StudyResult) -> None:
    assert not [view.title for view in views(tiny) if view.title.endswith("Hz")]
    several = replace(tiny, rows=[*tiny.rows, *({**row, "frequency_hz": 400.0} for row in tiny.rows)])
    titles = [view.title for view in views(several)]
    assert len(set(titles)) == len(titles) == 2 * len(views(tiny))
    assert all(title.endswith(" Hz") for title in titles)


def test_the_headline_is_that_of_the_most_exact_estimator_in_the_first_reading(tiny: StudyResult) -> None:
    exact = views(tiny)[0]
    inexact = [{**row, "estimator": "loupas", "amplitude_bias_m": 10 * row["amplitude_true_m"]} for row in exact.rows]
    other_reading = [
        {**row, "reading": "literal", "amplitude_bias_m": 0.0, "amplitude_jitter_m": 0.0} for row in inexact
    ]
    headline = _headline([replace(tiny, rows=[*inexact, *exact.rows, *other_reading])])
    assert headline.startswith(f"{exact.title}: over {len(exact.rows)} cases")
