"""Panels as SVG text, ready to stand in a page: styled, named for readers who do not see them, ids their own."""

from __future__ import annotations

import base64
import io
import re
from dataclasses import dataclass
from html import escape
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter

from hpe_rig.arrays import FloatArray
from hpe_rig.result.figure import PALETTE
from hpe_rig.result.print_symbols import svg_symbols

SIZE_IN = (4.8, 3.1)
BLUE, ORANGE, GREEN, PURPLE, GREY, _, SKY, _ = PALETTE
MARKS = tuple(zip("os^DvxP*", PALETTE, strict=True))
"""Marker and colour of each curve of a panel: told apart without colours too."""
MOST_POINTS = 1500
VARIABLES = {
    **{colour.lower(): f"c{place}" for place, colour in enumerate(PALETTE[:-1])},
    "#000000": "ink",
    "#333333": "ink",
    "#c4804a": "echo",
    "#b0b0b0": "grid",
}
"""Colours that a page may set otherwise, such as on a dark screen, by the name of the variable."""
ON_DARK = {**VARIABLES, "#ffffff": "paper", "#e6e6e6": "line", "#d9d9d9": "line"}
"""Colours of a figure that is a file of its own, by the variable that has them on a dark screen."""
PAPER = re.compile(r'(id="[^"]*patch_\d+">\s*<path [^>]*?fill: )#ffffff')
"""What stands before the white of a figure's background, of a panel's and of a legend's."""

STYLE: Any = {
    "svg.fonttype": "none",
    "svg.hashsalt": "hpe_rig",
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.edgecolor": "#333333",
    "grid.alpha": 0.3,
    "grid.linewidth": 0.6,
    "lines.linewidth": 1.2,
}


@dataclass(frozen=True, slots=True)
class Picture:
    """One picture: ``svg`` carries ``title`` and ``alt`` for readers who do not see it."""

    key: str
    title: str
    alt: str
    svg: str


def page_style() -> str:
    """Return the style sheet that all pages share: it sets the variables of `VARIABLES`, for light and dark screens."""
    return (resources.files("hpe_rig.result") / "page.css").read_text(encoding="utf-8")


def mark(place: int) -> tuple[str, str]:
    """Return marker and colour of the curve number ``place``; the same two come together again after 64."""
    count = len(MARKS)
    return MARKS[place % count][0], PALETTE[(place + place // count) % count]


def legend(axes: Axes, place: Any) -> None:
    """Put a plain legend there."""
    axes.legend(loc=place, frameon=False, fontsize=8)


def legend_above(axes: Axes, columns: int = 2) -> None:
    """Put a legend of one line of so many entries above the panel, where it covers nothing."""
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=columns, frameon=False, fontsize=8)


def thin(x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return at most about ``MOST_POINTS`` points that keep every stretch's lowest and highest value."""
    if x.size <= MOST_POINTS:
        return x, y
    stretches = np.array_split(np.arange(x.size), MOST_POINTS // 2)
    kept = np.unique([[part[np.argmin(y[part])], part[np.argmax(y[part])]] for part in stretches])
    return x[kept], y[kept]


def panel(left: float = 0.15) -> tuple[Figure, Axes]:
    """Return a figure of one panel; ``left`` is the share of the width that the row names take."""
    with rc_context(STYLE):
        figure = Figure(figsize=SIZE_IN)
        axes = figure.subplots()
        # The page's own paper shows through, light or dark.
        figure.set_facecolor("none")
        axes.set_facecolor("none")
        # Fixed margins, names of the axes at the edges: fitting them to every text takes as long as all the drawing.
        right, bottom, top = 0.96, 0.155, 0.9
        figure.subplots_adjust(left=left, right=right, bottom=bottom, top=top)
        axes.xaxis.set_label_coords((left + right) / 2, 0.065, figure.transFigure)
        axes.yaxis.set_label_coords(0.034, (bottom + top) / 2, figure.transFigure)
        return figure, axes


def picture(figure: Figure, key: str, title: str, alt: str) -> Picture:
    """Return ``figure`` as a picture; ``key`` is its name in the page."""
    text = io.StringIO()
    with rc_context(STYLE):
        figure.savefig(text, format="svg", metadata={"Date": None, "Creator": None}, dpi=110)
    return Picture(key, title, alt, inline(text.getvalue(), key, title, alt))


def write_figure(figure: Figure, path: Path, dpi: float = 150.0) -> None:
    """Write ``figure`` as the ending of ``path`` says; an SVG file is dark on a dark screen, as the pages are.

    Raises OSError where nothing can be written and ValueError for an ending that Matplotlib does not know.
    """
    if path.suffix.lower() != ".svg":
        figure.savefig(path, dpi=dpi)
        return
    text = io.StringIO()
    figure.savefig(text, format="svg", metadata={"Date": None})
    path.write_text(text.getvalue().replace("<defs>", f"<style>{_dark_rules()}</style>\n <defs>", 1), encoding="utf-8")


def _dark_rules() -> str:
    """Return what a dark screen changes. The drawing keeps its colours: programs that know no variables read it too."""
    _, _, dark = page_style().partition("(prefers-color-scheme: dark)")
    colours = dict(re.findall(r"--(\w+): (#\w+)", dark))
    rules = [
        f'[style*="{kind}: {light}"] {{ {kind}: {colours[name]} !important }}'
        for light, name in ON_DARK.items()
        for kind in ("fill", "stroke")
    ]
    # What states no colour is black: texts above all.
    return "\n".join(
        ["@media screen and (prefers-color-scheme: dark) {", f"svg {{ fill: {colours['ink']} }}", *rules, "}"]
    )


def image(shown: Picture, width_em: float = 28.0) -> str:
    """Return ``shown`` as an image of its own, on white: inline drawings of one notebook would share their ids."""
    data = base64.b64encode(shown.svg.encode()).decode("ascii")
    style = f"width:{width_em:g}em;max-width:100%;background:#fff"
    return f'<img alt="{escape(shown.alt)}" style="{style}" src="data:image/svg+xml;base64,{data}">'


def inline(svg: str, key: str, title: str, alt: str) -> str:
    """Return ``svg`` as an element to stand in a page: named for readers, its ids its own, its width the page's."""
    body = svg[svg.index("<svg") :].strip()
    body = re.sub(r"<metadata>.*?</metadata>\s*", "", body, flags=re.DOTALL)
    body = re.sub(r'\bid="', f'id="{key}-', body)
    body = re.sub(r'(url\(#|xlink:href="#)', rf"\g<1>{key}-", body)
    body = PAPER.sub(r"\g<1>var(--paper, #ffffff)", body)
    body = svg_symbols(re.sub(r"((?:fill|stroke): )(#[0-9a-f]{6})", _variable, body))
    head, _, rest = body.partition(">")
    head = re.sub(r' (?:width|height)="[^"]*"', "", head)
    names = (
        f'<title id="{key}-t">{escape(title, quote=False)}</title><desc id="{key}-d">{escape(alt, quote=False)}</desc>'
    )
    return f'{head} role="img" aria-labelledby="{key}-t {key}-d">{names}{rest}'


def _variable(found: re.Match[str]) -> str:
    name = VARIABLES.get(found[2])
    return found[0] if name is None else f"{found[1]}var(--{name}, {found[2]})"


def label_decades(axis: Axis, most: int = 6) -> None:
    """Label a logarithmic axis such that at most so many numbers stand on it, and do not meet.

    1, 2, 5 within two decades (of six numbers), powers of ten beyond; what holds fewer than two of 1, 2, 5 gets round
    numbers.
    """
    low, high = axis.get_view_interval()
    if not low > 0:
        return  # nothing is drawn on it
    # Three numbers a decade.
    within = high < 10 ** (most / 3) * low
    if high < 5 * low:
        axis.set_major_locator(MaxNLocator(max(2, most - 3)))
    else:
        axis.set_major_locator(
            LogLocator(subs=(1.0, 2.0, 5.0) if within else (1.0,), numticks=2 * most if within else most)
        )
    if within:
        axis.set_major_formatter(FuncFormatter(lambda value, _place: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())
