"""Command ``hpe-rig design``: from its options to the search, the table before and after, and the new scene."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from hpe_rig.design.comparison import compare
from hpe_rig.design.model import baseline
from hpe_rig.design.problem import GOALS, Problem
from hpe_rig.design.search import find_design
from hpe_rig.design.variables import variables
from hpe_rig.measurement import prepare
from hpe_rig.moduli import push_of
from hpe_rig.result import json_text
from hpe_rig.scene import Mistake, SettingsError, edited_text, length_m, parse_toml
from hpe_rig.store import unwritable, write_file

TIME_MARGIN = 1.01
"""Default time limit relative to the starting scene's time."""
MAX_DRAWS = 1_000_000

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Request:
    """The options of the command line."""

    scene: str
    over: str
    minimise: str = "jitter"
    bench: Path | None = None
    bounds: tuple[str, ...] = ()
    longest_s: float | None = None
    target: str | None = None
    draws: int = 200
    seed: int = 0
    output: Path | None = None
    report: bool = False
    json: bool = False


def write_design(
    request: Request,
    show: Callable[[str], None],
    announce: Callable[[str], None],
    report_progress: Callable[[int, int, str], None],
) -> None:
    """Search, show the table and write the new scene; raise ``SettingsError`` with all mistakes before the search.

    ``report_progress`` gets the curve points of the report that are computed, their number, and the varied key. With
    ``json``, ``show`` gets the comparison as JSON alone, and ``announce`` the names of the files.
    """
    problem, text = _problem(request)
    announce(f"searching {', '.join(str(variable.key) for variable in problem.space)}")
    design = find_design(problem, request.seed)
    if request.draws > 0:
        announce(f"simulating {request.draws} draws of scatterers and noise")
    comparison = compare(design, request.draws, request.seed)
    show(json_text(comparison.as_dict(), indent=2) if request.json else "\n".join(comparison.lines()))
    show_file = announce if request.json else show
    bench = "" if request.bench is None else f" --bench {request.bench}"
    command = f"hpe-rig design {request.scene}{bench} --minimise {request.minimise} --over {request.over}"
    if request.report:
        from hpe_rig.design.page import write_page

        announce("computing the goal over each number")
        page = write_page(design, comparison, request.scene, command, report_progress)
        show_file(f"{page}: open it in any browser")
    if request.output is not None and design.best.values:
        write_file(request.output, f"# {command}\n{edited_text(text, design.best.values)}", overwrite=False)
        show_file(f"{request.output}: hpe-rig check {request.output}{bench}")
    elif request.output is not None:
        show_file(f"{request.output}: not written, {request.scene} stays the best scene")


def _problem(request: Request) -> tuple[Problem, str]:
    """Return the problem and the scene's text; raise ``SettingsError`` with every mistake of request and scene."""
    setup = prepare(request.scene, request.bench, refuse=False)
    text, scene = setup.scene.text, setup.scene.scene
    tables, mistakes = parse_toml(text, request.scene), list(_option_mistakes(request))

    def collecting_mistakes(action: Callable[[], T]) -> T | None:
        try:
            return action()
        except SettingsError as error:
            mistakes.extend(error.mistakes)
            return None

    longest_s = TIME_MARGIN * setup.plan.duration_s if request.longest_s is None else request.longest_s
    target = request.target
    target_m = None if target is None else collecting_mistakes(lambda: length_m(target, "--target"))
    names = [name.strip() for name in request.over.split(",") if name.strip()]
    # Mistakes of all options are collected, so that one error reports them.
    space = collecting_mistakes(lambda: variables(tables, scene, setup.bench.bench, longest_s, names, request.bounds))
    collecting_mistakes(lambda: baseline(scene))
    if request.minimise == "modulus-uncertainty":
        collecting_mistakes(lambda: push_of([scene]))
    if request.output is not None and space is not None:
        # Keys that cannot be edited in the text are reported before the search.
        first_values = {variable.key.path: variable.value(0) for variable in space}
        collecting_mistakes(lambda: edited_text(text, first_values))
    if mistakes or space is None:
        raise SettingsError("design", mistakes)
    # The option is a text; this is the same text as one of the literals.
    goal = next(goal for goal in GOALS if goal == request.minimise)
    return Problem(setup, tables, space, goal, longest_s=longest_s, target_m=target_m), text


def _option_mistakes(request: Request) -> Iterator[Mistake]:
    if request.minimise not in GOALS:
        yield Mistake("--minimise", f"{request.minimise!r} cannot be minimised", f"one of {', '.join(GOALS)}")
    if request.minimise == "time" and request.target is None:
        yield Mistake("--target", "the shortest scene needs a limit on the jitter", "--target 20nm")
    if request.longest_s is not None and not 0 < request.longest_s < math.inf:
        yield Mistake("--longest-s", f"{request.longest_s:g} s is no duration", "seconds, such as 0.5")
    if request.draws < 0 or request.draws in (1, 2):
        yield Mistake("--draws", f"{request.draws} draws give no jitter", "100 or more, or 0 for none")
    if request.draws > MAX_DRAWS:
        yield Mistake("--draws", f"{request.draws} draws take too long", f"{MAX_DRAWS} or fewer")
    if not 0 <= request.seed < 2**32:
        yield Mistake("--seed", "the seed is out of range", "0 or more, below 2^32")
    if request.output is not None:
        if request.output.exists():
            yield Mistake("--output", f"{request.output} exists and is never overwritten", "another name")
        elif reason := unwritable(request.output):
            yield Mistake("--output", f"{request.output} cannot be written ({reason})", "another path")
