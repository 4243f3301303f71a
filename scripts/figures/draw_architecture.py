"""Picture of the architecture, drawn from the packages' imports: docs/figures/architecture.svg.

Usage: python scripts/figures/draw_architecture.py [OUTPUT]
"""

import argparse
import ast
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import NamedTuple

from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch, FancyBboxPatch
from matplotlib.path import Path as Line

ROOT = Path(__file__).parents[2]
OUTPUT = ROOT / "docs" / "figures" / "architecture.svg"
INK = "#4A4A4A"
WIDTH, HEIGHT, GUTTER = 2.5, 0.66, 0.6


class Panel(NamedTuple):
    """A package in the picture: ``left`` edge of its first column; ``spots`` (column, row, purpose) of its rooms.

    ``ground`` rooms are known to all others of the package, so no arrows lead to them.
    """

    title: str
    colour: str
    fill: str
    left: float
    ground: tuple[str, ...]
    spots: dict[str, tuple[int, float, str]]


PANELS = {
    "drivers": Panel(
        *("drivers: metal", "#B3500F", "#FBF0E8", 0.0, ("interfaces",)),
        {
            "agilent": (0, 5, "the generators"),
            "alazar": (0, 4, "the digitizer"),
            "visa": (0, 3, "the wire"),
            "interfaces": (0, 1, "what a driver offers"),
        },
    ),
    "hpe_rig": Panel(
        *("hpe_rig: the application", "#0B62A0", "#EBF2F8", 3.8, ("scene", "result", "extensions")),
        {
            "cli": (0, 12, "the commands"),
            "validation": (1, 11, "accuracy, paper"),
            "live": (0, 9, "the live page"),
            "study": (1, 9, "Monte Carlo studies"),
            "report": (0, 8, "the page of a run"),
            "design": (1, 10, "the best scene"),
            "acquire": (0, 7, "scene to result"),
            "prediction": (0, 5, "expected errors"),
            "moduli": (0, 6, "moduli of the medium"),
            "processing": (0, 4, "echoes to estimates"),
            "recordings": (1, 3, "foreign files"),
            "store": (0, 3, "run files"),
            "plan": (0, 2, "shots, edges, checks"),
            "bench": (0, 1, "the instruments"),
            "scene": (0, 0, "what is measured"),
            "result": (1, 1, "estimates"),
            "extensions": (1, 0, "what others bring"),
        },
    ),
    "sim_backend": Panel(
        *("sim_backend: the twin", "#00705A", "#E8F4F0", 10.8, ("settings", "wiring")),
        {
            "world": (1, 9, "the bench as one"),
            "transports": (2, 9, "TCP, serial, HiSLIP"),
            "acoustics": (0, 7, "bursts to volts"),
            "digitizer": (1, 7, "volts to codes"),
            "generator": (2, 7, "registers to bursts"),
            "receiver": (0, 5, "front end, noise"),
            "motion": (1, 5, "force to displacement"),
            "echoes": (0, 3, "the echo engine"),
            "transducer": (1, 2, "field of the aperture"),
            "settings": (0, 1, "[simulation]"),
            "wiring": (1, 1, "edges, in ps"),
        },
    ),
}


def place(package: str, room: str) -> tuple[float, float]:
    """Return the centre of a room's box."""
    column, row, _ = PANELS[package].spots[room]
    return PANELS[package].left + WIDTH / 2 + column * (WIDTH + GUTTER), row


def imported(node: ast.AST, deferred: bool = False) -> Iterator[tuple[str, bool]]:
    """Yield every module imported below ``node``, and whether only a call or a type checker imports it."""
    for child in ast.iter_child_nodes(node):
        later = deferred or isinstance(child, ast.FunctionDef | ast.Lambda)
        later = later or (isinstance(child, ast.If) and "TYPE_CHECKING" in ast.dump(child.test))
        if isinstance(child, ast.ImportFrom) and child.module:
            yield child.module, later
        elif isinstance(child, ast.Import):
            yield from ((alias.name, later) for alias in child.names)
        yield from imported(child, later)


NO_ROOMS = ("hpe_rig.startup",)
"""What the package itself loads first: no room, and of no interest to any."""


@cache
def room_imports() -> dict[tuple[str, str], bool]:
    """Return (source, target) of every import of one room in another, and whether it is deferred everywhere."""
    found: dict[tuple[str, str], bool] = {}
    for package, panel in PANELS.items():
        gone = [room for room in panel.spots if not any((ROOT / package).glob(f"{room}*"))]
        if gone:
            raise SystemExit(f"{package} has no {', '.join(gone)} any more: take it out of PANELS")
        for file in sorted((ROOT / package).glob("*/**/*.py")) + sorted((ROOT / package).glob("[!_]*.py")):
            source = f"{package}.{file.relative_to(ROOT / package).with_suffix('').parts[0]}"
            if source in NO_ROOMS:
                continue
            if source.rpartition(".")[2] not in panel.spots:
                raise SystemExit(f"{source} has no place in the picture: add it to PANELS")
            for module, later in imported(ast.parse(file.read_text(encoding="utf-8"))):
                target = ".".join(module.split(".")[:2])
                if target.partition(".")[0] in PANELS and "." in target and target not in (source, *NO_ROOMS):
                    found[source, target] = found.get((source, target), True) and later
    return found


def below(package: str, room: str) -> list[str]:
    """Return the rooms of ``package`` that ``room`` imports, those that all may know left out; refuse one above it."""
    panel = PANELS[package]
    pairs = (pair for pair in room_imports() if pair[0] == f"{package}.{room}")
    names = (target.rpartition(".")[2] for _, target in pairs if target.startswith(f"{package}."))
    found = [name for name in names if name not in panel.ground]
    if up := [other for other in found if panel.spots[other][1] >= panel.spots[room][1]]:
        raise SystemExit(f"{package}.{room} imports {', '.join(up)}, drawn no lower: move it in PANELS")
    return found


def reached(package: str, room: str) -> set[str]:
    """Return the rooms that ``room`` imports, directly or through others."""
    return set().union(*({other} | reached(package, other) for other in below(package, room)))


def drawn(package: str, room: str) -> list[str]:
    """Return the imports of ``room`` that do not follow from its others."""
    direct = below(package, room)
    return [other for other in direct if not any(other in reached(package, each) for each in direct if each != other)]


def rounded(axes: Axes, left: float, bottom: float, width: float, height: float, **look: object) -> None:
    axes.add_patch(FancyBboxPatch((left, bottom), width, height, "round,pad=0,rounding_size=0.1", **look))


def draw_arrow(axes: Axes, points: list[tuple[float, float]], colour: str, style: object = "-") -> None:
    """Draw an arrow along ``points``."""
    look = {"lw": 1.1, "ls": style, "color": colour, "zorder": 2, "joinstyle": "round"}
    axes.add_patch(FancyArrowPatch(path=Line(points), arrowstyle="-|>", mutation_scale=9, **look))


def route(package: str, room: str, target: str) -> list[tuple[float, float]]:
    """Return the corners of an arrow between two boxes: straight down, or by the gutter past boxes between them."""
    (x, y), (to_x, to_y) = place(package, room), place(package, target)
    between = (place(package, other) for other in PANELS[package].spots)
    free = not any(to_y < other_y < y and other_x in (x, to_x) for other_x, other_y in between)
    side = (to_x > x) - (to_x < x)
    if free or not side:
        return [(x + side * 0.3 * WIDTH, y - HEIGHT / 2), (to_x - side * 0.3 * WIDTH, to_y + HEIGHT / 2)]
    lane = x + side * (WIDTH + GUTTER) / 2
    return [(x + side * WIDTH / 2, y), (lane, y), (lane, to_y), (to_x - side * WIDTH / 2, to_y)]


def draw_panel(axes: Axes, package: str) -> tuple[float, float]:
    """Draw a package with its boxes and arrows; return the left and right edge of its background."""
    panel = PANELS[package]
    columns, rows, _ = zip(*panel.spots.values(), strict=True)
    left, right = panel.left - 0.25, panel.left + max(columns) * (WIDTH + GUTTER) + WIDTH + 0.25
    bottom, top = min(rows) - 0.6, max(rows) + 1.0
    rounded(axes, left, bottom, right - left, top - bottom, fc=panel.fill, ec="none", zorder=0)
    axes.text(left + 0.25, top - 0.32, panel.title, fontsize=11, color=panel.colour, weight="bold", va="center")
    for room, (_, _, purpose) in panel.spots.items():
        x, y = place(package, room)
        face = "white" if room not in panel.ground else panel.fill
        look = {"fc": face, "ec": panel.colour, "lw": 1.2, "zorder": 3, "ls": "-"}
        rounded(axes, x - WIDTH / 2, y - HEIGHT / 2, WIDTH, HEIGHT, **look)
        axes.text(x, y + 0.13, room, ha="center", va="center", weight="bold", fontsize=10, zorder=4)
        axes.text(x, y - 0.17, purpose, ha="center", va="center", fontsize=8, color=INK, zorder=4)
        for target in drawn(package, room):
            draw_arrow(axes, route(package, room, target), INK)
    return left, right


def draw_crossings(axes: Axes, package: str, edge: float, side: int) -> None:
    """Draw the arrows from the application to the background of another package, at ``edge``."""
    known = {f"{package}.{room}" for room in PANELS["drivers"].ground}
    for room in PANELS["hpe_rig"].spots:
        pairs = (pair for pair in room_imports().items() if pair[0][0] == f"hpe_rig.{room}")
        later = [late for (_, target), late in pairs if target.startswith(f"{package}.") and target not in known]
        if later:
            x, y = place("hpe_rig", room)
            style = (0, (4, 2)) if all(later) else "-"
            draw_arrow(axes, [(x + side * WIDTH / 2, y), (edge, y)], PANELS[package].colour, style)


def draw() -> Figure:
    """Return the picture of the three packages side by side."""
    figure = Figure(figsize=(13.2, 8.8))
    axes = figure.add_axes((0, 0, 1, 1))
    edges = {package: draw_panel(axes, package) for package in PANELS}
    draw_crossings(axes, "drivers", edges["drivers"][1], -1)
    draw_crossings(axes, "sim_backend", edges["sim_backend"][0], 1)
    notes = (
        "An arrow points to a room that is",
        "imported; arrows that follow from",
        "others are left out. Dashed: only",
        "inside functions, when needed.",
        "Tinted: known to every room",
        "of the package.",
    )
    for line, text in enumerate(notes):
        axes.text(edges["drivers"][0] + 0.1, 12.7 - 0.36 * line, text, fontsize=8.5, color=INK, va="center")
    axes.set(xlim=(edges["drivers"][0] - 0.2, edges["sim_backend"][1] + 0.2), ylim=(-0.8, 13.2), aspect="equal")
    axes.axis("off")
    return figure


def main() -> None:
    """Draw the picture into the file asked for, whose ending says the format."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("output", nargs="?", default=str(OUTPUT), help="its ending says the format")
    output = parser.parse_args().output
    with rc_context({"svg.hashsalt": "hpe_rig", "svg.fonttype": "none"}):
        draw().savefig(output, metadata={"Date": None} if output.endswith(".svg") else {}, dpi=110)


if __name__ == "__main__":
    main()
