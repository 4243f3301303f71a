"""Page of a design, ``hpe-rig design SCENE --report``: before and after, the goal over each number that may change."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hpe_rig.design.problem import OUTSIDE, Goal
from hpe_rig.design.search import DesignResult
from hpe_rig.design.variables import Variable
from hpe_rig.report import PageSection, page_table, render_sections, write_text
from hpe_rig.result import BLUE, GREY, ORANGE, Picture, label_decades, legend_above, panel, picture
from hpe_rig.store import versions

if TYPE_CHECKING:
    from hpe_rig.design.command import Comparison

POINTS = 33
"""Places along a number at which the goal is computed, the other numbers being those of the best scene."""
SHOWN: dict[Goal, tuple[str, str, float, str]] = {
    "jitter": ("jitter over amplitude", "jitter over amplitude", 100.0, "%"),
    "bias": ("bias, predicted", "bias over amplitude", 100.0, "%"),
    "phase-jitter": ("phase jitter, predicted", "phase jitter", math.degrees(1), "deg"),
    "time": ("time", "time", 1.0, "s"),
    "modulus-uncertainty": ("u of mu1", "u of mu1 over mu1", 100.0, "%"),
}
"""What each goal minimises: its row before and after; in the figures its name, factor from the cost, and unit."""


def write_page(found: DesignResult, comparison: Comparison, name: str, command: str) -> Path:
    """Write SCENE-design.html into this folder and return its path; raise ``SettingsError`` where that is impossible.

    ``name`` is the scene's, or its file; ``command`` is what made the page.
    """
    scene = found.best.scene
    assert scene is not None  # noqa: S101
    path = Path(f"{Path(name).name.removesuffix('.toml')}-design.html")
    parts = (
        _before_and_after(comparison),
        PageSection("over-part", "Over each number", _WORDS, tuple(_pictures(found))),
    )
    page = render_sections(
        f"A better scene: {scene.title}", _lead(found, comparison), parts, {"made by": command, **versions()}
    )
    write_text(path, page)
    return path


_WORDS = (
    "The goal over one number, the others as in the best scene. Where the curve has a gap, hpe-rig check refuses the "
    "scene, or it exceeds a limit of time or target. The search counts few draws of scatterers and a Gaussian motion, "
    "the same for all scenes: its figures compare scenes with one another, the table above has the better ones.",
)


def _lead(found: DesignResult, comparison: Comparison) -> tuple[str, ...]:
    row = SHOWN[found.problem.goal][0]
    before, after = next((before, after) for name, before, after in comparison.outcome if name == row)
    first = f"{row[0].upper()}{row[1:]}: {after} instead of {before}."
    return first, f"{comparison.asked}.", *(f"{remark[0].upper()}{remark[1:]}." for remark in comparison.remarks)


def _before_and_after(comparison: Comparison) -> PageSection:
    tables = (
        page_table("varied", "Numbers that may change.", _rows(comparison.varied), folded=False),
        page_table(
            "outcome",
            "What comes of it: predicted, and simulated with standard errors.",
            _rows(comparison.outcome),
            folded=False,
        ),
    )
    return PageSection("before-part", "Before and after", (), (), tables)


def _rows(rows: Sequence[tuple[str, str, str]]) -> list[dict[str, str]]:
    return [{"": name, "before": before, "after": after} for name, before, after in rows]


def _pictures(found: DesignResult) -> Iterator[Picture]:
    """Yield the goal over each number that the search may change."""
    problem, (_, name, scale, unit) = found.problem, SHOWN[found.problem.goal]
    for place, variable in enumerate(problem.space):
        x, cost = _curve(found, variable)
        shown = np.where(cost < OUTSIDE, scale * np.exp(np.minimum(cost, OUTSIDE)), np.nan)
        figure, axes = panel()
        axes.plot(x, shown, ".-", color=BLUE, ms=4)
        now = found.best.values.get(variable.key.path, variable.key.value)
        if now is not None:
            axes.plot(
                [now], [scale * math.exp(problem.cost(found.best.values))], "*", color=ORANGE, ms=12, label="best"
            )
        if variable.key.value is not None:
            axes.axvline(variable.key.value, color=GREY, ls="--", lw=1, label="before")
        axes.set(xlabel=str(variable.key), ylabel=f"{name} ({unit})")
        if variable.low > 0 and variable.high > 20 * variable.low:
            axes.set_xscale("log")
            label_decades(axes.xaxis)
        legend_above(axes)
        known = shown[np.isfinite(shown)]
        ends = f"{known.min():.3g} to {known.max():.3g} {unit}" if known.size else "no scene that keeps the limits"
        alt = f"{name} over {variable.key} from {variable.low:g} to {variable.high:g}: {ends}."
        yield picture(figure, f"over-{place}", f"{variable.key}", alt)


def _curve(found: DesignResult, variable: Variable) -> tuple[np.ndarray, np.ndarray]:
    """Return values along ``variable`` and the cost of each, (point,)."""
    places = np.linspace(0.0, variable.last, POINTS)
    values = sorted({variable.value(round(place) if variable.discrete else place) for place in places})
    best = found.best.values
    costs = [found.problem.cost({**best, variable.key.path: value}) for value in values]
    return np.array(values, dtype=np.float64), np.array(costs)
