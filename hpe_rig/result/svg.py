"""Figures as SVG elements of a page: style, palette, unique ids, titles and alternative texts for screen readers."""

from __future__ import annotations

import base64
import io
import re
from dataclasses import dataclass
from enum import StrEnum
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
from hpe_rig.result.print_symbols import svg_symbols


class Colour(StrEnum):
    """Colours of every figure, after Okabe and Ito: safe for colour-blind readers, contrast 3:1 or more on white."""

    BLUE = "#0072B2"
    ORANGE = "#D55E00"
    GREEN = "#007A5A"
    PURPLE = "#8A4F7D"
    GREY = "#5A5A5A"
    AMBER = "#A87400"
    SKY = "#2F8FC4"
    BLACK = "#000000"


PALETTE = tuple(Colour)
MARKS = tuple(zip("os^DvxP*", PALETTE, strict=True))
"""Marker and colour of each curve; the markers differ without colours too."""
SIZE_IN = (4.8, 3.1)
MAX_POINTS = 1500
VARIABLES = {
    **{colour.lower(): f"c{index}" for index, colour in enumerate(PALETTE[:-1])},
    "#000000": "ink",
    "#333333": "ink",
    "#c4804a": "echo",
    "#b0b0b0": "grid",
}
"""CSS variable of each colour, which a page sets for light or dark screens."""
ON_DARK = {**VARIABLES, "#ffffff": "paper", "#e6e6e6": "line", "#d9d9d9": "line"}
"""CSS variable of each colour of a separate SVG file on a dark screen."""
_BACKGROUND = re.compile(r'(id="[^"]*patch_\d+">\s*<path [^>]*?fill: )#ffffff')
"""Prefix of the white of the background of a figure, panel or legend."""

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
    """One picture: ``svg`` contains ``title`` and ``alt`` for screen readers."""

    key: str
    title: str
    alt: str
    svg: str


def page_style() -> str:
    """Return the style sheet of all pages; it sets the variables of `VARIABLES` for light and dark screens."""
    return (resources.files("hpe_rig.result") / "page.css").read_text(encoding="utf-8")


def mark(index: int) -> tuple[str, str]:
    """Return marker and colour of curve number ``index``; a combination repeats after 64 curves."""
    count = len(MARKS)
    return MARKS[index % count][0], PALETTE[(index + index // count) % count]


def legend(axes: Axes, position: Any, columns: int = 2, handles: Any = ()) -> None:
    """Add a legend without frame; "above" puts it in one line of ``columns`` entries above the panel.

    ``handles``: artists and labels of other axes.
    """
    if position == "above":
        axes.legend(*handles, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=columns, frameon=False, fontsize=8)
    else:
        axes.legend(*handles, loc=position, frameon=False, fontsize=8)


def thin(x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return at most about ``MAX_POINTS`` points: the lowest and highest value of each interval."""
    if x.size <= MAX_POINTS:
        return x, y
    intervals = np.array_split(np.arange(x.size), MAX_POINTS // 2)
    extrema = np.unique([[span[np.argmin(y[span])], span[np.argmax(y[span])]] for span in intervals])
    return x[extrema], y[extrema]


def panel(left: float = 0.15) -> tuple[Figure, Axes]:
    """Return a figure of one panel; ``left`` is the left margin relative to the width."""
    with rc_context(STYLE):
        figure = Figure(figsize=SIZE_IN)
        axes = figure.subplots()
        # Transparent: the page provides a light or dark background.
        figure.set_facecolor("none")
        axes.set_facecolor("none")
        # Fixed margins and label positions: Matplotlib's layout engine takes as long as all the drawing.
        right, bottom, top = 0.96, 0.155, 0.9
        figure.subplots_adjust(left=left, right=right, bottom=bottom, top=top)
        axes.xaxis.set_label_coords((left + right) / 2, 0.065, figure.transFigure)
        axes.yaxis.set_label_coords(0.034, (bottom + top) / 2, figure.transFigure)
        return figure, axes


def picture(figure: Figure, key: str, title: str, alt: str) -> Picture:
    """Return ``figure`` as a picture with the id ``key``."""
    text = io.StringIO()
    with rc_context(STYLE):
        figure.savefig(text, format="svg", metadata={"Date": None, "Creator": None}, dpi=110)
    return Picture(key, title, alt, inline(text.getvalue(), key, title, alt))


def figure_bytes(figure: Figure, path: Path, dpi: float = 150.0, adaptive: bool = True) -> bytes:
    """Return the file of ``figure`` in the format of the suffix of ``path``; an SVG file adapts to dark screens.

    Not ``adaptive``: the SVG file keeps its light colours. Raises ``ValueError`` for a suffix that Matplotlib does not
    support.
    """
    kind, memory = path.suffix.lower().removeprefix("."), io.BytesIO()
    figure.savefig(memory, format=kind, dpi=dpi, metadata={"Date": None} if kind == "svg" else None)
    if kind != "svg" or not adaptive:
        return memory.getvalue()
    return memory.getvalue().replace(b"<defs>", f"<style>{_dark_rules()}</style>\n <defs>".encode(), 1)


def _dark_rules() -> str:
    """Return the CSS rules for dark screens. The drawing states plain colours, since many programs ignore variables."""
    _, _, dark = page_style().partition("(prefers-color-scheme: dark)")
    colours = dict(re.findall(r"--(\w+): (#\w+)", dark))
    rules = [
        f'[style*="{kind}: {light}"] {{ {kind}: {colours[name]} !important }}'
        for light, name in ON_DARK.items()
        for kind in ("fill", "stroke")
    ]
    # Elements without a colour, such as texts, are black by default.
    return "\n".join(
        ["@media screen and (prefers-color-scheme: dark) {", f"svg {{ fill: {colours['ink']} }}", *rules, "}"]
    )


def image(source: Picture, width_em: float = 28.0) -> str:
    """Return ``source`` as an <img> element on white; inline drawings of one notebook would share ids."""
    data = base64.b64encode(source.svg.encode()).decode("ascii")
    style = f"width:{width_em:g}em;max-width:100%;background:#fff"
    return f'<img alt="{escape(source.alt)}" style="{style}" src="data:image/svg+xml;base64,{data}">'


def inline(svg: str, key: str, title: str, alt: str) -> str:
    """Return ``svg`` as an inline element: titled, with unique ids, as wide as its container."""
    body = svg[svg.index("<svg") :].strip()
    body = re.sub(r"<metadata>.*?</metadata>\s*", "", body, flags=re.DOTALL)
    # Ids and references get the key as prefix: several figures share a page.
    body = re.sub(r'\bid="', f'id="{key}-', body)
    body = re.sub(r'(url\(#|xlink:href="#)', rf"\g<1>{key}-", body)
    body = _BACKGROUND.sub(r"\g<1>var(--paper, #ffffff)", body)
    body = svg_symbols(re.sub(r"((?:fill|stroke): )(#[0-9a-f]{6})", _variable, body))
    head, _, content = body.partition(">")
    # Without width and height the figure scales with its container.
    head = re.sub(r' (?:width|height)="[^"]*"', "", head)
    labels = (
        f'<title id="{key}-t">{escape(title, quote=False)}</title><desc id="{key}-d">{escape(alt, quote=False)}</desc>'
    )
    return f'{head} role="img" aria-labelledby="{key}-t {key}-d">{labels}{content}'


def _variable(match: re.Match[str]) -> str:
    name = VARIABLES.get(match[2])
    return match[0] if name is None else f"{match[1]}var(--{name}, {match[2]})"


def label_decades(axis: Axis, most: int = 6) -> None:
    """Label a logarithmic axis with at most ``most`` numbers that do not overlap.

    Labels are 1, 2, 5 for less than ``most`` / 3 decades, else powers of ten. A range below a factor of 5 has round
    numbers.
    """
    low, high = axis.get_view_interval()
    if not low > 0:
        return  # the axis is empty
    # 1, 2 and 5 are three numbers a decade.
    few_decades = high < 10 ** (most / 3) * low
    if high < 5 * low:
        axis.set_major_locator(MaxNLocator(max(2, most - 3)))
    else:
        axis.set_major_locator(
            LogLocator(subs=(1.0, 2.0, 5.0) if few_decades else (1.0,), numticks=2 * most if few_decades else most)
        )
    if few_decades:
        axis.set_major_formatter(FuncFormatter(lambda value, _position: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())
