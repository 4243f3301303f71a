"""The report: one file that needs nothing else, says what it shows, and shows what was measured."""

from __future__ import annotations

import math
import re
from collections import Counter
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import h5py
import numpy as np
import pytest

from hpe_rig.measurement.run import record_run
from hpe_rig.measurement.setup import prepare
from hpe_rig.report.figures import sweep_pictures
from hpe_rig.report.page import error_stages, render, write_report
from hpe_rig.report.page_tables import budget_table
from hpe_rig.report.sweep import Sweep, SweepCurve
from hpe_rig.result import PALETTE, Estimate, Result, ShotResult, headline_sentence, shot_warnings, symbols
from hpe_rig.runs.run import process
from hpe_rig.scene import shipped_scenes
from hpe_rig.store import StoreError

VOID = {"meta", "br", "link", "img", "input", "hr"}
SVG_ALONE = {"path", "use", "rect", "image", "stop", "circle", "line"}


def measured(folder: Path, *edits: tuple[str, str], scene: str = "bovine-muscle") -> Path:
    text = shipped_scenes()[scene]
    for old, new in edits:
        assert old in text, old
        text = text.replace(old, new)
    path = folder / f"{scene}.toml"
    path.write_text(text, encoding="utf-8")
    return record_run(prepare(str(path)), folder / "run.h5")


@pytest.fixture(scope="module")
def run_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    hostile = ('title = "Bovine', 'title = "<script>alert(1)</script>{{ 7*7 }} Bovine')
    return measured(tmp_path_factory.mktemp("report"), hostile, ("burst_count = 20", "burst_count = 10"))


@pytest.fixture(scope="module")
def page(run_file: Path) -> str:
    return write_report(run_file).read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def result(run_file: Path) -> Result:
    return process(run_file)


class Outline(HTMLParser):
    """Every element's attributes, and whether the tags are balanced."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.open: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        assert self.open, tag
        assert self.open.pop() == tag


def test_the_page_is_one_file_below_a_megabyte_that_asks_for_nothing(page: str) -> None:
    assert len(page.encode()) < 1_000_000
    named = set(re.findall(r"https?://[^\"'\s<>)]+", page))
    # names of vocabularies, which nothing fetches
    assert all(address.startswith(("http://www.w3.org/", "https://www.w3.org/")) for address in named), named
    outline = Outline(page)
    assert not {"script", "link", "iframe", "object", "embed", "form"} & {tag for tag, _ in outline.elements}
    for tag, attributes in outline.elements:
        for name in ("src", "href", "xlink:href"):
            assert (attributes.get(name) or "#").startswith(("#", "data:")), (tag, attributes)
    assert "default-src 'none'" in page


def test_tags_are_balanced_and_no_two_elements_share_an_id(page: str) -> None:
    outline = Outline(page)
    assert not outline.open
    counts = Counter(attributes["id"] for _, attributes in outline.elements if "id" in attributes)
    assert [name for name, count in counts.items() if count > 1] == []
    references = set(re.findall(r'url\(#([^)]+)\)|xlink:href="#([^"]+)"', page))
    assert {left or right for left, right in references} <= set(counts)


def test_every_picture_is_named_and_described_in_words_and_numbers(page: str) -> None:
    pictures = re.findall(r"<svg\b.*?</svg>", page, flags=re.DOTALL)
    assert len(pictures) == 10
    for picture in pictures:
        assert re.search(r'role="img" aria-labelledby="[\w-]+-t [\w-]+-d"', picture)
        description = re.search(r"<desc [^>]*>(.*?)</desc>", picture, flags=re.DOTALL)
        assert description is not None
        assert re.search(r"\d", description.group(1))
    assert re.search(r'<html lang="en">', page)
    assert all('scope="' in head for head in re.findall(r"<th\b[^>]*>", page))


def test_colours_of_text_stand_out_from_their_background(page: str) -> None:
    def luminance(colour: str) -> float:
        digits = colour[1:] if len(colour) == 7 else "".join(2 * digit for digit in colour[1:])
        parts = [int(digits[i : i + 2], 16) / 255 for i in (0, 2, 4)]
        red, green, blue = (c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in parts)
        return 0.2126 * red + 0.7152 * green + 0.0722 * blue

    def contrast(one: str, other: str) -> float:
        light, dark = sorted((luminance(one), luminance(other)), reverse=True)
        return (light + 0.05) / (dark + 0.05)

    roots = [
        dict(re.findall(r"--(\w+): (#[0-9a-fA-F]{3,6});", root))
        for root in re.findall(r":root \{(.*?)\}", page, re.DOTALL)
    ]
    assert len(roots) == 2  # light and dark
    for named in roots:
        pairs = [(named[text], named["paper"]) for text in ("ink", "soft", "accent", "warn", "good")]
        pairs += [(named[text], named["tint"]) for text in ("ink", "soft", "warn")]
        pairs += [(named["warn"], named["alert"])]
        for text, paper in pairs:
            # WCAG 2.2, success criterion 1.4.3
            assert contrast(text, paper) >= 4.5, (text, paper)
        for name in ("c0", "c1", "c2", "c3", "c4", "c5", "c6", "echo"):
            # and 1.4.11, of what is drawn
            assert contrast(named[name], named["paper"]) >= 3.0, name
    drawn = [(colour, roots[0]["paper"]) for colour in PALETTE]
    assert all(contrast(*pair) >= 3.0 for pair in drawn)
    for text, paper in (("#4a2500", "#ffe9c7"), ("#003f2c", "#e3f4ec"), ("#ffdca8", "#45300e"), ("#a9ecd0", "#0f2f24")):
        assert contrast(text, paper) >= 4.5, (text, paper)


def test_the_first_screen_has_sentence_badges_and_figure_and_the_rest_is_folded(page: str) -> None:
    body = page[page.index("<body>") : page.index("<details")]
    for part in ('<p class="headline">', '<ul class="badges"', 'id="amplitude-t"', 'id="phase-t"'):
        assert part in body
    ids = {attributes["id"] for _, attributes in Outline(page).elements if "id" in attributes}
    badges = re.findall(r'<a class="(passed|noticed|open)" href="#([\w-]+)"><b>(.)</b>', body)
    assert len(badges) >= 8
    assert {part for _, part, _ in badges} <= ids
    assert {(verdict, sign) for verdict, _, sign in badges} <= {("passed", "✓"), ("noticed", "!"), ("open", "–")}


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("787 +- 14 nm, 73.4 +- 0.5 deg", "787\u00a0±\u00a014 nm, 73.4\u00a0±\u00a00.5°"),
        ("media (+-0.3 between them)", "media (±0.3 between them)"),
        ("100 us at f_r, F_0 and sigma_J", "100 µs at f<sub>r</sub>, F<sub>0</sub> and σ<sub>J</sub>"),
        ("<b>3 um</b>", "&lt;b&gt;3 µm&lt;/b&gt;"),
        ("out/f_r.h5 of my_f_r and a_very_long_name", "out/f_r.h5 of my_f_r and a_very_long_name"),
    ],
)
def test_units_and_symbols_are_those_of_print_and_names_of_files_stay(text: str, shown: str) -> None:
    assert symbols(text) == shown


def test_simulated_is_said_first_and_in_large(page: str) -> None:
    assert "<title>SIMULATED: " in page
    body = page[page.index("<body>") :]
    assert body.index("<strong>SIMULATED</strong>") < body.index("<h1>")
    assert "MEASURED" not in body


def test_the_table_holds_the_results_numbers(page: str, result: Result) -> None:
    for estimate in result.shots[0].estimates:
        row = re.search(rf'<tr><th scope="row">{estimate.frequency_hz:g}</th>(.*?)</tr>', page)
        assert row is not None
        cells = re.findall(r"<td>(.*?)</td>", row.group(1))
        for first, prefix in ((0, ""), (4, "tracked_")):
            assert float(cells[first]) == pytest.approx(getattr(estimate, f"{prefix}amplitude_m") * 1e9, rel=1e-3)
            u_m = getattr(estimate, f"{prefix}amplitude_uncertainty_m")
            assert float(cells[first + 1]) == pytest.approx(u_m * 1e9, rel=0.06)
            assert float(cells[first + 2]) == pytest.approx(
                np.degrees(getattr(estimate, f"{prefix}phase_rad")), abs=0.006
            )
            u_rad = getattr(estimate, f"{prefix}phase_uncertainty_rad")
            assert float(cells[first + 3]) == pytest.approx(np.degrees(u_rad), rel=0.06)
    assert f'<p class="headline">{symbols(headline_sentence(result))}.</p>' in page


def test_every_part_is_there(page: str) -> None:
    for heading in (
        "Measurement", "Amplitude and phase", "Displacement", "Echoes", "Timing", "Residual of the fit",
        "Error and run time by stage", "Omitted stages", "Provenance",
    ):  # fmt: skip
        assert f">{heading}<" in page
    assert "SHA-256" in page
    for test in ("white residual", "no spectral line", "normal residual", "steady noise", "innovations"):
        assert re.search(f'<th scope="row"[^>]*>{test}</th>', page)


def test_a_title_that_is_markup_stays_text(page: str) -> None:
    assert "<script" not in page
    assert "&lt;script&gt;alert(1)&lt;/script&gt;{{ 7*7 }}" in page


def test_a_shot_that_does_not_exist_is_refused_with_those_that_do(run_file: Path) -> None:
    with pytest.raises(StoreError, match=r"shot 9 has no result.*--shot 1"):
        render(run_file, shot_number=9)


def test_a_report_replaces_a_report_and_nothing_else(
    run_file: Path, tmp_path: Path, page_without_pictures: None
) -> None:
    copy = tmp_path / "run.h5"
    before = run_file.read_bytes()
    copy.write_bytes(before)
    with pytest.raises(StoreError, match=r"run\.h5 exists and is no HTML page"):
        write_report(copy, output=copy)
    assert copy.read_bytes() == before
    page = tmp_path / "run.html"
    page.write_text("<!DOCTYPE html>\nan earlier report", encoding="utf-8")
    assert "SIMULATED" in write_report(copy).read_text(encoding="utf-8")


@pytest.mark.slow
def test_an_aborted_sweep_gets_its_regressions_says_what_is_missing_and_stays_below_a_megabyte(tmp_path: Path) -> None:
    run_file = measured(
        tmp_path,
        ("burst_count = 20", "burst_count = 10\nforce_fraction = [0.25, 0.5, 1.0]"),
    )
    with h5py.File(run_file, "r+") as file:
        file.attrs.modify("status", b"aborted")
        # As files of early releases are, which may be changed unnoticed.
        file.attrs.modify("format_version", 2)
        del file["checksum"]
        file["records/recorded"][0, 350:] = 0
    page = render(run_file)
    Outline(page)
    assert len(page.encode()) < 1_000_000
    assert "the run is aborted" in page
    assert re.search(r"shot 1: (?:49|50) of \d+ records are missing", page)
    assert "Over force F / F<sub>0</sub>" in page
    (described,) = re.findall(r'<desc id="amplitude-settings-d">.*: (F = .*)\.</desc>', page)
    assert re.fullmatch(r"F = 0.25\d* F_0; F = 0.5\d* F_0; F = 1 F_0", described), described
    slopes = re.findall(
        r'<tr><th scope="row">100</th><td class="word">T<sub>b</sub> = 100 µs</td><td>([\d.]+)</td>', page
    )
    last = process(run_file).shots[-1].estimates[0].amplitude_m * 1e9
    # the twin's force is linear: the slope is the amplitude at full force
    assert float(slopes[0]) == pytest.approx(last, rel=0.02)


def test_sources_without_effect_are_in_the_caption_of_the_budget(result: Result) -> None:
    (shot,) = result.shots
    table = budget_table(shot)
    _, _, zero = table.caption.removesuffix(".").partition("Zero at every frequency: ")
    zero_sources = zero.split(", ")
    assert "trigger jitter" in zero_sources
    displayed = {name.rpartition(" ")[0] for name in table.columns} - {"f", "u"}
    assert displayed | set(zero_sources) == {item.source for item in shot.estimates[0].budget}
    for source in zero_sources:
        components = [item for estimate in shot.estimates for item in estimate.budget if item.source == source]
        assert {(item.amplitude_m, item.phase_rad) for item in components} == {(0.0, 0.0)}


def test_the_checksum_of_a_recording_is_not_in_the_headline(result: Result) -> None:
    imported = replace(result, simulated=False, imported=f"scan.npz, SHA-256 {'0f' * 32}")
    assert headline_sentence(imported).endswith("; imported from scan.npz")


def test_controls_do_not_count_as_shots_without_result(tmp_path: Path, page_without_pictures: None) -> None:
    edits = ("[acquisition]", "[acquisition]\ncontrol = true"), ("burst_count = 20", "burst_count = 10")
    assert "<dd>1 of 1 planned, each with a control</dd>" in render(measured(tmp_path, *edits))


def test_warnings_alike_but_for_their_numbers_stand_once_with_their_shots(result: Result) -> None:
    (shot,) = result.shots
    texts = [f"not significant at {90 + n}, 100 Hz: take more" for n in range(20)]
    shots = [replace(shot, index=n, warnings=(text, "clipped") if n == 3 else (text,)) for n, text in enumerate(texts)]
    assert shot_warnings(shots) == [
        f"shot {', '.join(map(str, range(1, 13)))} ... (20 of 20 shots): such as in shot 1, {texts[0]}",
        "shot 4: clipped",
    ]
    assert shot_warnings(shots[3:4]) == [texts[3], "clipped"]


def test_phases_of_a_sweep_are_followed_from_the_strongest_point() -> None:
    # A point drowned in noise, -179 degrees, and then 60 degrees: followed from the left all would stand at -300.
    phase_rad, x = np.radians([-179.0, 60.0, 60.0]), np.arange(3.0)
    curve = SweepCurve(100.0, "", x, np.array([1e-9, 5e-8, 1e-7]), np.zeros(3), phase_rad, np.zeros(3), 1, None)
    _, phase = sweep_pictures(Sweep("force F / F_0", (curve,)))
    assert "between 60.00 and 181.00 degrees" in phase.alt


def test_what_is_told_of_aliasing_and_taken_off_has_its_line_among_the_errors() -> None:
    as_it_is = Estimate(100.0, 1e-7, 1e-9, 0.1, 0.01, averaging_factor=0.9, averaging_phase_rad=0.0)
    told = replace(as_it_is, aliasing_factor=1.1, aliasing_phase_rad=math.radians(-3.0))
    lines = [
        {stage: size for stage, size, _ in error_stages(ShotResult(0, 0, 1e-4, 1.0, 9, 0, 1e-9, (each,), ()), None)}
        for each in (as_it_is, told)
    ]
    assert "mean aliasing" not in lines[0]
    assert lines[1]["mean aliasing"] == "+10.0 %, -3.00 degrees"
