"""Tables and figures of the accuracy studies, one study at a time or all on one page."""

from __future__ import annotations

import math
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from matplotlib import rc_context

from hpe_rig.report import PageSection, PageTable, cell_text, page_table, render_sections
from hpe_rig.result import STYLE, Picture, inline
from hpe_rig.scene import Mistake, SettingsError
from hpe_rig.store import unwritable, versions, write_file
from hpe_rig.validation.accuracy import (
    chain as accuracy_chain,
    echo as accuracy_echo,
    harmonic as accuracy_harmonic,
    motion as accuracy_motion,
    specimen as accuracy_specimen,
)
from hpe_rig.validation.accuracy.end_to_end import (
    EndToEnd,
    draw_end_to_end,
    rows as end_to_end_rows,
    variants,
)
from hpe_rig.validation.accuracy.extremes import extremes
from hpe_rig.validation.accuracy.work_precision import Point, draw_points, grouped, points_text, write_rows

Row = TypeVar("Row")
ReportStep = Callable[[int, int, str], None]
"""Called with the number of completed studies, of all studies, and the name of the present one."""


@dataclass(frozen=True, slots=True)
class Effort:
    """Largest scenes of the echo engine and draws per case of the estimators; the defaults take about a minute."""

    largest: int = 100_000
    most_echoes: int = 1_000
    longest_s: float = 0.5
    draws: int = 10

    @property
    def realisations(self) -> tuple[int, ...]:
        """Numbers of realisations of the end-to-end study, ascending."""
        largest = 10 * self.draws
        return (*(count for count in (1, 10, 100) if count < largest), largest)


FULL = Effort(1_000_000, 10_000, 5.0, 100)
"""All sizes that the engine supports; takes minutes."""


def write_accuracy(
    part: str, output: Path | None, figure: Path | None, effort: Effort, show: Callable[[str], None]
) -> None:
    """Run one accuracy study and write or show its table.

    Raises ``SettingsError`` for mistakes in the arguments before the first measurement.
    """
    if part == "echo":
        sizes = effort.largest, effort.most_echoes, effort.longest_s
        write_rows(accuracy_echo.rows_within(*sizes), output, figure, accuracy_echo.draw_echo, show)
    elif part == "motion":
        write_rows(accuracy_motion.rows(draws=effort.draws), output, figure, accuracy_motion.draw_motion, show)
    elif part == "harmonic":
        write_rows(accuracy_harmonic.rows(), output, figure, accuracy_harmonic.draw_harmonic, show)
    elif part in ("specimen", "chain"):
        points = {"specimen": accuracy_specimen, "chain": accuracy_chain}[part].points()
        write_rows(points, output, figure, draw_points, show, points_text)
    else:
        mistake = Mistake("PART", f"there is no part {part}", "echo, motion, harmonic, specimen or chain")
        raise SettingsError("command line", [mistake])


def write_accuracy_report(
    path: Path,
    figure: Path | None,
    effort: Effort,
    announce: Callable[[str], None],
    report_step: ReportStep = lambda done, total, name: None,
) -> None:
    """Run every accuracy study and write the page, anew after each study.

    ``report_step`` is called after every row, ``announce`` after every study. Raises ``SettingsError`` for mistakes in
    the arguments before the first measurement.
    """
    _check_files(path, figure)
    sections: list[PageSection] = []
    times_s: dict[str, float] = {}
    medium: list[Point] = []

    def reporting(rows: Iterable[Row]) -> Iterator[Row]:
        for count, row in enumerate(rows, 1):
            yield row
            report_step(len(times_s), len(studies), f"{name}, {count} measured")

    def medium_section() -> PageSection:
        # The points of the medium are also cases of the stiff and extreme study.
        medium.extend(reporting(accuracy_specimen.points()))
        return points_section("specimen", "Medium: response to a burst train", medium)

    sizes = effort.largest, effort.most_echoes, effort.longest_s
    studies: dict[str, Callable[[], PageSection]] = {
        "end to end": lambda: end_to_end_section(end_to_end_rows(effort.realisations, reporting(variants()))),
        "specimen": medium_section,
        "stiff and extreme": lambda: _extremes_section(list(reporting(extremes(medium)))),
        "echo": lambda: _echo_section(list(reporting(accuracy_echo.rows_within(*sizes)))),
        "chain": lambda: points_section(
            "chain", "Receive chain: truncation and oversampling", list(reporting(accuracy_chain.points()))
        ),
        "motion": lambda: _motion_section(list(reporting(accuracy_motion.rows(draws=effort.draws))), effort.draws),
        "harmonic": lambda: _harmonic_section(list(reporting(accuracy_harmonic.rows()))),
    }
    for name, study in studies.items():
        start_s = time.perf_counter()
        report_step(len(times_s), len(studies), name)
        try:
            sections.append(study())
        except KeyboardInterrupt as interrupt:
            interrupt.add_note(f"{path} holds the parts before {name}" if sections else "no part was finished")
            raise
        times_s[name] = time.perf_counter() - start_s
        # The page is written after every study, so that an interruption loses one study only.
        facts = {**versions(), "seconds by part": ", ".join(f"{key} {value:.0f}" for key, value in times_s.items())}
        introduction = lead(sections[0].tables[0])
        write_file(path, render_sections("Error against run time", introduction, sections, facts))
        announce(f"{name}: {times_s[name]:.1f} s, in {path}")
    announce(f"{path}: open it in any browser")


def _check_files(path: Path, figure: Path | None) -> None:
    """Raise ``SettingsError`` with every mistake in the names of the files."""
    mistakes = []
    if path.suffix not in (".html", ".htm"):
        what = f"the report cannot be a {path.suffix!r} file"
        mistakes.append(Mistake("--output", what, "a name that ends in .html"))
    elif why := unwritable(path):
        mistakes.append(Mistake("--output", f"{path} cannot be written ({why})", "an existing folder, or another name"))
    if figure is not None:
        mistakes.append(Mistake("--figure", "the report already holds a figure of every part", "--figure with a PART"))
    if mistakes:
        raise SettingsError("command line", mistakes)


def lead(end_to_end: PageTable) -> list[str]:
    """Return the introduction of the page: the error of the default settings by number of realisations."""
    shipped = [row for row in end_to_end.rows if row["shipped"]]
    errors = (f"{row['error'] * 100:.2g} % in {row['time_s']:.2g} s from {row['realisations']}" for row in shipped)
    return [
        "Root mean square error of the final amplitude with default settings, by number of realisations: "
        f"{'; '.join(errors)}.",
        f"Echo tolerance and contour nodes contribute {shipped[0]['numerical_error']:.1g}, scatterers and noise the "
        "remainder. The sections below compare all methods and settings of the twin and of the estimators by error and "
        "run time. Times are for one core of this machine: processor time end to end, else wall time. Errors are "
        "relative to exact references.",
    ]


def end_to_end_section(rows: Sequence[EndToEnd]) -> PageSection:
    """Return the end-to-end section."""
    front = "; ".join(
        f"{row.estimator}, {row.realisations} realisations: {row.error:.1e} in {row.time_s:.2g} s"
        for row in rows
        if row.on_front
    )
    paragraphs = (
        "Tonebursts, medium, echoes and noise (SNR 40 dB) to the mean amplitude at 200 Hz, corrected for beam "
        "averaging and compared with the steady state in closed form. The error combines bias and standard error. The "
        f"bias is estimated from {max(row.realisations for row in rows)} realisations and has their uncertainty.",
        "The bias of cross_spectrum, the paper's chain, is due to its Hann window: pulses at 3990 Hz alias motion at "
        "3.8 kHz onto 190 Hz, and the window passes half of it into 200 Hz.",
        "Variants on the front may reach the error of the default settings in less run time. The default settings have "
        "other benefits: their estimator has the lowest noise at any SNR and tracks motion of many wavelengths. Their "
        "numerical errors of echoes and medium are far below any noise.",
    )
    title = "Error of the final amplitude against run time"
    caption = "End to end: errors relative to the true amplitude. On front: no row is better in both time and error."
    alt = f"Pareto front: {front}."
    return _section("end-to-end", "End to end", rows, draw_end_to_end, title, alt, caption, paragraphs)


def _extremes_section(cases: Sequence[Any]) -> PageSection:
    paragraphs = (
        "Cases that challenge each method, noise-free, with default settings. Results are compared with closed forms "
        "where they exist. A dash: the method failed.",
    )
    table = page_table("extremes", "Error by case.", cases, folded=False)
    return PageSection("stiff", "Stiff and extreme cases", paragraphs, (), (table,))


def _echo_section(rows: Sequence[accuracy_echo.Measurement]) -> PageSection:
    least, most = (bound(row.scatterers for row in rows) for bound in (min, max))
    alt = f"Relative error against run time, {least} to {most} scatterers: the table has the numbers."
    caption = "Echo engine: error relative to the direct sum, every evaluation."
    draw, title = accuracy_echo.draw_echo, "Echoes: error against run time"
    return _section("echo", "Echo engine", rows, draw, title, alt, caption)


def _motion_section(rows: list[accuracy_motion.MotionRow], draws: int) -> PageSection:
    ratios = {
        name: [row.noise_jitter_m / row.bound_m for row in estimator_rows]
        for name, estimator_rows in grouped(rows, lambda row: row.estimator).items()
    }
    alt = "; ".join(f"{name}: {min(ratio):.2f} to {max(ratio):.2f} of the bound" for name, ratio in ratios.items())
    caption = f"Estimators: the paper's parameters are varied one at a time, with {draws} draws per case."
    draw, title = accuracy_motion.draw_motion, "Estimators: noise jitter relative to its bound, against run time"
    return _section("motion", "Echoes to amplitude and phase", rows, draw, title, f"{alt}.", caption)


def _harmonic_section(rows: Sequence[accuracy_harmonic.HarmonicRow]) -> PageSection:
    alt = "; ".join(
        f"{row.method}, {row.pulses} pulses: {row.jitter_m / row.bound_m:.2f} in {row.time_s:.2g} s" for row in rows
    )
    caption = "Displacement to amplitude and phase, 200 realisations."
    draw, title = accuracy_harmonic.draw_harmonic, "Fits: jitter relative to its bound, against run time"
    return _section("harmonic", "Displacement to harmonics", rows, draw, title, f"{alt}.", caption)


def points_section(key: str, title: str, points: Sequence[Point]) -> PageSection:
    """Return a section with the lowest error of each case in its description."""
    cases = grouped((point for point in points if not math.isnan(point.error)), lambda point: point.case)
    best = [min(case_points, key=lambda point: point.error) for case_points in cases.values()]
    alt = "; ".join(f"{p.case}: {cell_text(p.error)} by {p.method}, {p.setting}" for p in best)
    caption = "Largest error relative to the largest value."
    return _section(
        key, title, points, draw_points, f"{title}: error against run time", f"Lowest errors: {alt}.", caption
    )


def _section(
    key: str,
    title: str,
    rows: Sequence[Any],
    draw: Callable[[Any, Path], None],
    picture_title: str,
    alt: str,
    caption: str,
    paragraphs: tuple[str, ...] = (),
) -> PageSection:
    """Return a section with the picture written by ``draw`` and the table of ``rows``."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "picture.svg"
        with rc_context(STYLE):
            draw(rows, path)
        svg = inline(path.read_text(encoding="utf-8"), key, picture_title, alt)
    picture, table = Picture(key, picture_title, alt, svg), page_table(key, caption, rows)
    return PageSection(f"{key}-part", title, paragraphs, (picture,), (table,))
