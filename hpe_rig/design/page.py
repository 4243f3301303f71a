"""Page of a design, ``hpe-rig design SCENE --report``: before and after, and the goal over each varied number."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hpe_rig.arrays import FloatArray
from hpe_rig.design.comparison import Comparison, Row
from hpe_rig.design.problem import INFEASIBLE_COST, Goal
from hpe_rig.design.search import DesignResult
from hpe_rig.report import PageSection, page_table, render_sections
from hpe_rig.result import Colour, Picture, label_decades, legend, panel, picture
from hpe_rig.store import versions, write_file

CURVE_POINTS = 33
"""Values of a number for the curve of the goal."""


@dataclass(frozen=True, slots=True)
class _GoalLabel:
    row: str
    """Row of the comparison that states the goal."""
    quantity: str
    unit: str
    scale: float
    """Displayed value over exp(cost)."""


GOAL_LABELS: dict[Goal, _GoalLabel] = {
    "jitter": _GoalLabel("jitter over amplitude", "jitter over amplitude", "%", 100.0),
    "bias": _GoalLabel("bias, predicted", "bias over amplitude", "%", 100.0),
    "phase-jitter": _GoalLabel("phase jitter, predicted", "phase jitter", "deg", math.degrees(1)),
    "time": _GoalLabel("time", "time", "s", 1.0),
    "modulus-uncertainty": _GoalLabel("u of mu1", "u of mu1 over mu1", "%", 100.0),
}

CURVES_TEXT = (
    "The goal over one number; the others are those of the best scene. At a gap in the curve hpe-rig check refuses the "
    "scene, or it exceeds the limit on time or jitter. The search uses few draws of scatterers and a Gaussian motion, "
    "the same for all scenes. Its values serve to compare scenes; those of the table above are more accurate.",
)


def write_page(
    design: DesignResult,
    comparison: Comparison,
    scene_name: str,
    command: str,
    report_progress: Callable[[int, int, str], None],
) -> Path:
    """Write SCENE-design.html into the current folder and return its path; raise ``StoreError`` if impossible.

    ``scene_name`` is the scene's name or file; the page states ``command``. ``report_progress`` gets the points of the
    curves that are computed, their number, and the key that varies.
    """
    scene, _, _ = design.best.inputs()
    path = Path(f"{Path(scene_name).name.removesuffix('.toml')}-design.html")
    curves = PageSection(
        "over-section", "Goal over each number", CURVES_TEXT, tuple(_pictures(design, report_progress))
    )
    sections = (_before_and_after(comparison), curves)
    facts = {"command": command, **versions()}
    write_file(path, render_sections(f"Design: {scene.title}", _introduction(design, comparison), sections, facts))
    return path


def _introduction(design: DesignResult, comparison: Comparison) -> tuple[str, ...]:
    row = GOAL_LABELS[design.problem.goal].row
    before, after = next((before, after) for name, before, after in comparison.outcome_rows() if name == row)
    headline = f"{_capitalised(row)}: {f'{after} instead of {before}' if design.best.values else before}."
    return (
        headline,
        f"{_capitalised(comparison.request)}.",
        *(f"{_capitalised(remark)}." for remark in comparison.remarks),
    )


def _capitalised(text: str) -> str:
    return text[0].upper() + text[1:]


def _before_and_after(comparison: Comparison) -> PageSection:
    outcome_caption = "Outcome: predicted, and simulated with standard errors."
    tables = (
        page_table("varied", "Varied numbers.", _rows(comparison.varied_rows()), folded=False),
        page_table("outcome", outcome_caption, _rows(comparison.outcome_rows()), folded=False),
    )
    return PageSection("before-section", "Before and after", tables=tables)


def _rows(rows: Sequence[Row]) -> list[dict[str, str]]:
    return [{"": name, "before": before, "after": after} for name, before, after in rows]


def _pictures(design: DesignResult, report_progress: Callable[[int, int, str], None]) -> Iterator[Picture]:
    """Yield the goal over each varied number."""
    problem, label = design.problem, GOAL_LABELS[design.problem.goal]
    for index, variable in enumerate(problem.space):
        x, cost = _curve(design, index, report_progress)
        # The cost is the logarithm of the goal; infeasible scenes make a gap.
        goal = np.where(cost < INFEASIBLE_COST, label.scale * np.exp(np.minimum(cost, INFEASIBLE_COST)), np.nan)
        figure, axes = panel()
        axes.plot(x, goal, ".-", color=Colour.BLUE, ms=4)
        best = design.best.values.get(variable.key.path, variable.key.value)
        if best is not None:
            best_goal = label.scale * math.exp(problem.cost(design.best.values))
            axes.plot([best], [best_goal], "*", color=Colour.ORANGE, ms=12, label="best")
        if variable.key.value is not None:
            axes.axvline(variable.key.value, color=Colour.GREY, ls="--", lw=1, label="before")
        axes.set(xlabel=str(variable.key), ylabel=f"{label.quantity} ({label.unit})")
        if variable.low > 0 and variable.high > 20 * variable.low:
            axes.set_xscale("log")
            label_decades(axes.xaxis)
        legend(axes, "above")
        finite = goal[np.isfinite(goal)]
        span = f"{finite.min():.3g} to {finite.max():.3g} {label.unit}" if finite.size else "no scene within the limits"
        alt = f"{label.quantity} over {variable.key} from {variable.low:g} to {variable.high:g}: {span}."
        yield picture(figure, f"over-{index}", f"{variable.key}", alt)


def _curve(
    design: DesignResult, index: int, report_progress: Callable[[int, int, str], None]
) -> tuple[FloatArray, FloatArray]:
    """Return values of the variable ``index`` and the cost of the best scene with each, (point,)."""
    space, best = design.problem.space, design.best.values
    variable = space[index]
    axis = variable.axis(CURVE_POINTS)
    costs = list[float]()
    for value in axis.labels:
        costs.append(design.problem.cost({**best, variable.key.path: value}))
        report_progress(index * CURVE_POINTS + len(costs), len(space) * CURVE_POINTS, str(variable.key))
    return np.array(axis.labels, dtype=np.float64), np.array(costs)
