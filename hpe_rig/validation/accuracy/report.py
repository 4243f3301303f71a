"""Reports of ``hpe-rig accuracy``: table and figure of one part, or one page of them all."""

from __future__ import annotations

import math
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from matplotlib import rc_context

from hpe_rig.report import PageSection, PageTable, cell_text, page_table, render_sections, write_text
from hpe_rig.result import STYLE, Picture, inline
from hpe_rig.scene import Mistake, SettingsError
from hpe_rig.store import unwritable, versions
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
    faster_than_shipped,
    rows as end_to_end_rows,
    variants,
)
from hpe_rig.validation.accuracy.extremes import Extreme, extremes
from hpe_rig.validation.accuracy.work_precision import Point, draw_points, grouped, points_text, write_rows

Row = TypeVar("Row")
Step = Callable[[int, int, str], None]
"""What is told (parts done, of how many, doing what)."""


@dataclass(frozen=True, slots=True)
class Effort:
    """How much is tried: sizes of the echo engine's scenes, draws a case of the estimators; by default a minute's."""

    largest: int = 100_000
    most_echoes: int = 1_000
    longest_s: float = 0.5
    draws: int = 10

    @property
    def realisations(self) -> tuple[int, ...]:
        """Realisations end to end."""
        most = 10 * self.draws
        return (*(count for count in (1, 10, 100) if count < most), most)


FULL = Effort(1_000_000, 10_000, 5.0, 100)
"""Minutes: every size that the engine is made for."""


def write_accuracy(
    part: str, output: Path | None, figure: Path | None, effort: Effort, show: Callable[[str], None]
) -> None:
    """Run one accuracy study and write or show its table; raises ``SettingsError`` before anything is measured."""
    if part == "echo":
        accuracy_echo.write_accuracy(output, figure, effort.largest, effort.most_echoes, effort.longest_s, show)
    elif part == "motion":
        write_rows(accuracy_motion.rows(draws=effort.draws), output, figure, accuracy_motion.draw_motion, show)
    elif part == "harmonic":
        write_rows(accuracy_harmonic.rows(), output, figure, accuracy_harmonic.draw_harmonic, show)
    elif part in ("specimen", "chain"):
        points = {"specimen": accuracy_specimen, "chain": accuracy_chain}[part].points()
        write_rows(points, output, figure, draw_points, show, points_text)
    else:
        mistake = Mistake("PART", f"{part} is no part", "echo, motion, harmonic, specimen or chain")
        raise SettingsError("command line", [mistake])


def write_accuracy_report(
    path: Path,
    figure: Path | None,
    effort: Effort,
    tell: Callable[[str], None],
    step: Step = lambda done, total, doing: None,
) -> None:
    """Run every accuracy study and write the report, part by part; raises ``SettingsError`` where it cannot.

    ``step`` hears of every row, ``tell`` of every part.
    """
    refuse(path, figure, effort)
    parts: list[PageSection] = []
    seconds: dict[str, float] = {}
    medium: list[Point] = []

    def watched(rows: Iterable[Row]) -> Iterator[Row]:
        for count, row in enumerate(rows, 1):
            yield row
            step(len(seconds), len(studies), f"{name}, {count} tried")

    studies: dict[str, Callable[[], PageSection]] = {
        "end to end": lambda: end_to_end_part(end_to_end_rows(effort.realisations, watched(variants()))),
        "specimen": lambda: specimen_part(medium, list(watched(accuracy_specimen.points()))),
        "stiff and extreme": lambda: extremes_part(list(watched(extremes(medium)))),
        "echo": lambda: echo_part(list(watched(echo_rows(effort)))),
        "chain": lambda: chain_part(list(watched(accuracy_chain.points()))),
        "motion": lambda: motion_part(list(watched(accuracy_motion.rows(draws=effort.draws))), effort.draws),
        "harmonic": lambda: harmonic_part(list(watched(accuracy_harmonic.rows()))),
    }
    for name, study in studies.items():
        start_s = time.perf_counter()
        step(len(seconds), len(studies), name)
        try:
            parts.append(study())
        except KeyboardInterrupt as interrupt:
            interrupt.add_note(f"{path} holds the parts before {name}" if parts else "no part was finished")
            raise
        seconds[name] = time.perf_counter() - start_s
        told = ", ".join(f"{part} {value:.0f}" for part, value in seconds.items())
        # After every part, so that an interruption costs that part alone.
        facts = {**versions(), "seconds by part": told}
        write_text(path, render_sections("Error against run time", lead(parts[0].tables[0]), parts, facts))
        tell(f"{name}: {seconds[name]:.1f} s, in {path}")
    tell(f"{path}: open it in any browser")


def refuse(path: Path, figure: Path | None, effort: Effort) -> None:
    """Raise ``SettingsError`` with every mistake of the command line, before the minutes are spent."""
    mistakes = []
    if path.suffix not in (".html", ".htm"):
        mistakes.append(Mistake("--output", f"{path.suffix!r} is no format of the report", "a name that ends in .html"))
    elif why := unwritable(path):
        mistakes.append(Mistake("--output", f"{path} cannot be written ({why})", "a folder that exists, another name"))
    if figure is not None:
        mistakes.append(Mistake("--figure", "the report has a figure of every part inside", "a PART beside it"))
    if not (effort.largest >= 100 and effort.most_echoes >= 10):
        mistakes.append(Mistake("--largest, --most-echoes", "no scene is that small", "100 or more, and 10 or more"))
    if mistakes:
        raise SettingsError("command line", mistakes)


def lead(end_to_end: PageTable) -> list[str]:
    """Return what matters most: how far the shipped default is from the front."""
    shipped = [row for row in end_to_end.rows if row["shipped"]]
    each = (f"{row['error'] * 100:.2g} % in {row['time_s']:.2g} s from {row['realisations']}" for row in shipped)
    return [
        f"Shipped default, error of the final amplitude by number of realisations: {'; '.join(each)}.",
        f"Tolerance and nodes contribute {shipped[0]['numerical_error']:.1g}; the rest is scatterers and noise. Below: "
        "every way the twin and the estimators can work, with how wrong and how long: times on one core of this "
        "machine (processor time end to end, else wall time), errors against exact references.",
    ]


def end_to_end_part(rows: Sequence[EndToEnd]) -> PageSection:
    """Return the end-to-end section."""
    front = [row for row in rows if row.on_front]
    alt = "; ".join(
        f"{row.estimator}, {row.realisations} realisations: {row.error:.1e} in {row.time_s:.2g} s" for row in front
    )
    words = (
        "From tonebursts through medium, echoes and noise (40 dB) to the mean amplitude at 200 Hz over its beam "
        "averaging, against the steady state in closed form. Error: bias and standard error together, rms; "
        f"the bias is known to its own uncertainty, from {max(row.realisations for row in rows)} realisations.",
        "The bias of cross_spectrum, the paper's chain, is its Hann window's: pulses at 3990 Hz alias what moves at "
        "3.8 kHz onto 190 Hz, of which the window lets half into 200 Hz.",
        _bought(rows),
    )
    title = "Error of the final amplitude against seconds"
    caption = "End to end: errors relative to the true amplitude; on front: nothing else is as good in less time."
    return _part("end-to-end", "End to end", rows, draw_end_to_end, title, f"Front: {alt}.", caption, words)


def _bought(rows: Sequence[EndToEnd]) -> str:
    """Return what the shipped default buys where others are as right in less time."""
    shipped = max((row for row in rows if row.shipped), key=lambda row: row.realisations)
    each = "; ".join(
        f"{_changed(row, shipped)} in {100 * share:.0f} % of its time, numerical error "
        f"{row.numerical_error:.1g} in place of {shipped.numerical_error:.1g}"
        for row, share in faster_than_shipped(rows)
    )
    if not each:
        return "Nothing is as right as the shipped default in less time, beyond what times and draws leave open."
    return (
        f"As right as the shipped default in less time, within chance: {each}. What it buys instead: an estimator with "
        "the least noise at any SNR that follows motion of many wavelengths, and echoes and a medium that are exact "
        "next to any noise, whatever is measured on them."
    )


def _changed(row: EndToEnd, shipped: EndToEnd) -> str:
    """Return the settings of ``row`` that are not the shipped ones."""
    both = zip(_settings(row), _settings(shipped), strict=True)
    return ", ".join(own for own, other in both if own != other)


def _settings(row: EndToEnd) -> tuple[str, ...]:
    numbers = f"tolerance {row.tolerance:g}", f"{row.nodes} nodes", f"{row.degrees} degrees"
    return row.estimator, f"gate of {1e3 * row.gate_length_m:g} mm", *numbers


def specimen_part(found: list[Point], points: Sequence[Point]) -> PageSection:
    """Return the medium's section; its ``points`` are added to ``found``."""
    found += points
    return _points_part("specimen", "Medium: response to a burst train", found)


def extremes_part(cases: Sequence[Extreme]) -> PageSection:
    """Return the table of stiff and extreme cases."""
    words = (
        "Cases chosen to break a method, noise-free, shipped settings; stages whose result is exact in closed form are "
        "compared with it. A dash: the method gave up.",
    )
    return PageSection(
        "stiff", "Stiff and extreme cases", words, (), (page_table("extremes", "Error by case.", cases, folded=False),)
    )


def echo_rows(effort: Effort) -> Iterator[accuracy_echo.Measurement]:
    """Yield every evaluation of the scenes that ``effort`` allows for."""
    scatterers = tuple(count for count in accuracy_echo.SCATTERERS if count <= effort.largest)
    echoes = tuple(count for count in accuracy_echo.ECHOES if count <= effort.most_echoes)
    return accuracy_echo.measurements(scatterers, echoes, longest_s=effort.longest_s)


def echo_part(rows: Sequence[accuracy_echo.Measurement]) -> PageSection:
    """Return the echo engine's section."""
    least, most = (bound(row.scatterers for row in rows) for bound in (min, max))
    alt = f"Relative error against run time, {least} to {most} scatterers: the table has the numbers."
    caption = "Echo engine: error relative to the direct sum, every evaluation."
    title = "Echoes: error against run time"
    return _part("echo", "Echo engine", rows, accuracy_echo.write_figure, title, alt, caption)


def chain_part(points: Sequence[Point]) -> PageSection:
    """Return the receive chain's section."""
    return _points_part("chain", "Receive chain: tails and oversampling", points)


def motion_part(rows: list[accuracy_motion.MotionRow], draws: int) -> PageSection:
    """Return the section of the estimators of displacement."""
    alt = "; ".join(_best(rows, name) for name in dict.fromkeys(row.estimator for row in rows))
    title = "Estimators: noise jitter over its bound against time"
    caption = f"Estimators, the paper's parameters one at a time, {draws} draws a case."
    draw = accuracy_motion.draw_motion
    return _part("motion", "Echoes to amplitude and phase", rows, draw, title, f"{alt}.", caption)


def harmonic_part(rows: Sequence[accuracy_harmonic.HarmonicRow]) -> PageSection:
    """Return the section of the fits."""
    alt = "; ".join(
        f"{row.method}, {row.pulses} pulses: {row.jitter_m / row.bound_m:.2f} in {row.time_s:.2g} s" for row in rows
    )
    title = "Fits: jitter over its bound against time"
    caption = "Displacement to amplitude and phase, 200 realisations."
    draw = accuracy_harmonic.draw_harmonic
    return _part("harmonic", "Displacement to harmonics", rows, draw, title, f"{alt}.", caption)


def _points_part(key: str, title: str, points: Sequence[Point]) -> PageSection:
    known = grouped((point for point in points if not math.isnan(point.error)), lambda point: point.case)
    best = [min(own, key=lambda point: point.error) for own in known.values()]
    alt = "; ".join(f"{p.case}: {cell_text(p.error)} by {p.method}, {p.setting}" for p in best)
    drawn = f"{title}: error against run time"
    return _part(key, title, points, draw_points, drawn, f"Least errors: {alt}.", "Largest error over largest value.")


def _part(
    key: str,
    title: str,
    rows: Sequence[Any],
    draw: Callable[[Any, Path], None],
    drawn: str,
    alt: str,
    caption: str,
    words: tuple[str, ...] = (),
) -> PageSection:
    """Return a section with the picture that ``draw`` writes of ``rows``, entitled ``drawn``, and their table."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "drawn.svg"
        with rc_context(STYLE):
            draw(rows, path)
        svg = inline(path.read_text(encoding="utf-8"), key, drawn, alt)
    return PageSection(f"{key}-part", title, words, (Picture(key, drawn, alt, svg),), (page_table(key, caption, rows),))


def _best(rows: Sequence[accuracy_motion.MotionRow], name: str) -> str:
    own = [row.noise_jitter_m / row.bound_m for row in rows if row.estimator == name]
    return f"{name}: {min(own):.2f} to {max(own):.2f} of the bound"
