"""Draw the packages and their imports: docs/figures/architecture.svg.

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
BOX_WIDTH, BOX_HEIGHT, GUTTER = 2.5, 0.66, 0.6
NOT_DRAWN = ("hpe_rig.startup", "hpe_rig.queued_file", "hpe_rig.arrays", "sim_backend.arrays")
"""Modules that hold no step of the flow: the start of the program, and types of arrays."""


class Panel(NamedTuple):
    """A top-level package in the picture.

    ``left_edge`` is that of the first column; ``boxes`` maps a package to (column, row, purpose). Packages in
    ``shared`` may be imported by all others of the panel, so no arrows lead to them.
    """

    title: str
    colour: str
    background: str
    left_edge: float
    shared: tuple[str, ...]
    boxes: dict[str, tuple[int, float, str]]


PANELS = {
    "drivers": Panel(
        *("drivers: instruments", "#B3500F", "#FBF0E8", 0.0, ("interfaces",)),
        {
            "agilent": (0, 5, "generators"),
            "alazar": (0, 4, "digitizer"),
            "visa": (0, 3, "connections"),
            "interfaces": (0, 1, "interface of each driver"),
        },
    ),
    "hpe_rig": Panel(
        *("hpe_rig: application", "#0B62A0", "#EBF2F8", 3.8, ("scene", "result", "extensions")),
        {
            "cli": (0, 14, "commands"),
            "validation": (1, 13, "accuracy, paper"),
            "design": (1, 12, "best scene"),
            "study": (1, 11, "Monte Carlo studies"),
            "live": (0, 11, "live page"),
            "report": (0, 10, "HTML pages"),
            "runs": (0, 9, "stored runs, API"),
            "measurement": (0, 8, "scene to run file"),
            "moduli": (0, 7, "moduli of the medium"),
            "prediction": (0, 6, "expected errors"),
            "processing": (0, 5, "echoes to estimates"),
            "medium": (1, 4, "physics of the specimen"),
            "recordings": (1, 6, "files of other programs"),
            "store": (0, 3, "run files"),
            "plan": (0, 2, "shots, edges, checks"),
            "bench": (0, 1, "instruments in use"),
            "scene": (0, 0, "settings"),
            "result": (1, 1, "estimates"),
            "extensions": (1, 0, "plug-ins"),
        },
    ),
    "sim_backend": Panel(
        *("sim_backend: digital twin", "#00705A", "#E8F4F0", 10.8, ("settings", "wiring")),
        {
            "world": (1, 9, "simulated bench"),
            "transports": (2, 9, "TCP, serial, HiSLIP"),
            "acoustics": (0, 7, "bursts to volts"),
            "digitizer": (1, 7, "volts to codes"),
            "generator": (2, 7, "registers to bursts"),
            "receiver": (0, 5, "front end, noise"),
            "motion": (1, 4, "force to displacement"),
            "echoes": (0, 3, "echo synthesis"),
            "transducer": (1, 2, "field of the aperture"),
            "settings": (0, 1, "[simulation]"),
            "wiring": (1, 1, "edges, in ps"),
        },
    ),
}


def box_centre(panel: str, package: str) -> tuple[float, float]:
    """Return the centre of a package's box."""
    column, row, _ = PANELS[panel].boxes[package]
    return PANELS[panel].left_edge + BOX_WIDTH / 2 + column * (BOX_WIDTH + GUTTER), row


def imported_modules(node: ast.AST, deferred: bool = False) -> Iterator[tuple[str, bool]]:
    """Yield every module imported below ``node``, and whether the import is deferred.

    An import is deferred inside a function and under ``TYPE_CHECKING``.
    """
    for child in ast.iter_child_nodes(node):
        child_deferred = deferred or isinstance(child, ast.FunctionDef | ast.Lambda)
        child_deferred = child_deferred or (isinstance(child, ast.If) and "TYPE_CHECKING" in ast.dump(child.test))
        if isinstance(child, ast.ImportFrom) and child.module:
            yield child.module, child_deferred
        elif isinstance(child, ast.Import):
            yield from ((alias.name, child_deferred) for alias in child.names)
        yield from imported_modules(child, child_deferred)


def source_files(panel: str) -> Iterator[tuple[str, Path]]:
    """Yield every source file of a panel with the package it belongs to; exit if that package has no box."""
    for file in sorted((ROOT / panel).glob("*/**/*.py")) + sorted((ROOT / panel).glob("[!_]*.py")):
        package = file.relative_to(ROOT / panel).with_suffix("").parts[0]
        if f"{panel}.{package}" in NOT_DRAWN:
            continue
        if package not in PANELS[panel].boxes:
            raise SystemExit(f"{panel}.{package} has no box in the picture: add it to PANELS")
        yield f"{panel}.{package}", file


@cache
def package_imports() -> dict[tuple[str, str], bool]:
    """Return (source, target) of every import between packages, and whether all imports of the pair are deferred."""
    deferred_pairs: dict[tuple[str, str], bool] = {}
    for panel in PANELS:
        missing = [package for package in PANELS[panel].boxes if not any((ROOT / panel).glob(f"{package}*"))]
        if missing:
            raise SystemExit(f"{panel} has no {', '.join(missing)}: remove it from PANELS")
        for source, file in source_files(panel):
            for module, deferred in imported_modules(ast.parse(file.read_text(encoding="utf-8"))):
                target = ".".join(module.split(".")[:2])
                if target.partition(".")[0] in PANELS and "." in target and target not in (source, *NOT_DRAWN):
                    deferred_pairs[source, target] = deferred_pairs.get((source, target), True) and deferred
    return deferred_pairs


def direct_imports(panel: str, package: str) -> list[str]:
    """Return the packages of the same panel that ``package`` imports, without shared ones; exit if one is not lower."""
    boxes, shared = PANELS[panel].boxes, PANELS[panel].shared
    pairs = (pair for pair in package_imports() if pair[0] == f"{panel}.{package}")
    names = (target.rpartition(".")[2] for _, target in pairs if target.startswith(f"{panel}."))
    lower = [name for name in names if name not in shared]
    if upward := [name for name in lower if boxes[name][1] >= boxes[package][1]]:
        raise SystemExit(f"{panel}.{package} imports {', '.join(upward)}, drawn no lower: move it in PANELS")
    return lower


def all_imports(panel: str, package: str) -> set[str]:
    """Return the packages that ``package`` imports, directly or through others."""
    return set().union(*({lower} | all_imports(panel, lower) for lower in direct_imports(panel, package)))


def drawn_imports(panel: str, package: str) -> list[str]:
    """Return the direct imports of ``package`` that are not implied by its other imports."""
    direct = direct_imports(panel, package)
    return [
        target for target in direct if not any(target in all_imports(panel, via) for via in direct if via != target)
    ]


def draw_rounded(axes: Axes, corner: tuple[float, float], width: float, height: float, **style: object) -> None:
    axes.add_patch(FancyBboxPatch(corner, width, height, "round,pad=0,rounding_size=0.1", **style))


def draw_arrow(axes: Axes, points: list[tuple[float, float]], colour: str, linestyle: object = "-") -> None:
    """Draw an arrow along ``points``."""
    style = {"lw": 1.1, "ls": linestyle, "color": colour, "zorder": 2, "joinstyle": "round"}
    axes.add_patch(FancyArrowPatch(path=Line(points), arrowstyle="-|>", mutation_scale=9, **style))


def arrow_path(panel: str, package: str, target: str) -> list[tuple[float, float]]:
    """Return the corners of an arrow between two boxes: straight, or through the gutter if a box is in between."""
    (x, y), (to_x, to_y) = box_centre(panel, package), box_centre(panel, target)
    centres = (box_centre(panel, name) for name in PANELS[panel].boxes)
    blocked = any(to_y < centre_y < y and centre_x in (x, to_x) for centre_x, centre_y in centres)
    side = (to_x > x) - (to_x < x)
    if not blocked or not side:
        return [
            (x + side * 0.3 * BOX_WIDTH, y - BOX_HEIGHT / 2),
            (to_x - side * 0.3 * BOX_WIDTH, to_y + BOX_HEIGHT / 2),
        ]
    lane = x + side * (BOX_WIDTH + GUTTER) / 2
    return [(x + side * BOX_WIDTH / 2, y), (lane, y), (lane, to_y), (to_x - side * BOX_WIDTH / 2, to_y)]


def draw_panel(axes: Axes, name: str) -> tuple[float, float]:
    """Draw a top-level package with its boxes and arrows; return the left and right edge of its background."""
    panel = PANELS[name]
    columns, rows, _ = zip(*panel.boxes.values(), strict=True)
    x_min, x_max = panel.left_edge - 0.25, panel.left_edge + max(columns) * (BOX_WIDTH + GUTTER) + BOX_WIDTH + 0.25
    y_min, y_max = min(rows) - 0.6, max(rows) + 1.0
    draw_rounded(axes, (x_min, y_min), x_max - x_min, y_max - y_min, fc=panel.background, ec="none", zorder=0)
    axes.text(x_min + 0.25, y_max - 0.32, panel.title, fontsize=11, color=panel.colour, weight="bold", va="center")
    for package, (_, _, purpose) in panel.boxes.items():
        x, y = box_centre(name, package)
        fill = "white" if package not in panel.shared else panel.background
        style = {"fc": fill, "ec": panel.colour, "lw": 1.2, "zorder": 3, "ls": "-"}
        draw_rounded(axes, (x - BOX_WIDTH / 2, y - BOX_HEIGHT / 2), BOX_WIDTH, BOX_HEIGHT, **style)
        axes.text(x, y + 0.13, package, ha="center", va="center", weight="bold", fontsize=10, zorder=4)
        axes.text(x, y - 0.17, purpose, ha="center", va="center", fontsize=8, color=INK, zorder=4)
        for target in drawn_imports(name, package):
            draw_arrow(axes, arrow_path(name, package, target), INK)
    return x_min, x_max


def draw_imports_between_panels(axes: Axes, panel: str, edge: float, side: int) -> None:
    """Draw the arrows from the application to the background of another top-level package, at ``edge``."""
    interfaces = {f"{panel}.{package}" for package in PANELS["drivers"].shared}
    for package in PANELS["hpe_rig"].boxes:
        pairs = (pair for pair in package_imports().items() if pair[0][0] == f"hpe_rig.{package}")
        deferred = [
            is_deferred
            for (_, target), is_deferred in pairs
            if target.startswith(f"{panel}.") and target not in interfaces
        ]
        if deferred:
            x, y = box_centre("hpe_rig", package)
            linestyle = (0, (4, 2)) if all(deferred) else "-"
            draw_arrow(axes, [(x + side * BOX_WIDTH / 2, y), (edge, y)], PANELS[panel].colour, linestyle)


def draw() -> Figure:
    """Return the picture of the three top-level packages side by side."""
    figure = Figure(figsize=(13.2, 9.9))
    axes = figure.add_axes((0, 0, 1, 1))
    edges = {panel: draw_panel(axes, panel) for panel in PANELS}
    draw_imports_between_panels(axes, "drivers", edges["drivers"][1], -1)
    draw_imports_between_panels(axes, "sim_backend", edges["sim_backend"][0], 1)
    legend = (
        "An arrow points to an imported",
        "package. Arrows implied by",
        "others are omitted. Dashed:",
        "imported inside functions only.",
        "Tinted: may be imported by",
        "every package of the panel.",
    )
    for line, text in enumerate(legend):
        axes.text(edges["drivers"][0] + 0.1, 14.7 - 0.36 * line, text, fontsize=8.5, color=INK, va="center")
    axes.set(xlim=(edges["drivers"][0] - 0.2, edges["sim_backend"][1] + 0.2), ylim=(-0.8, 15.2), aspect="equal")
    axes.axis("off")
    return figure


def main() -> None:
    """Draw the picture into a file; the file's ending selects the format."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("output", nargs="?", default=str(OUTPUT), help="file to write; its ending selects the format")
    output = parser.parse_args().output
    with rc_context({"svg.hashsalt": "hpe_rig", "svg.fonttype": "none"}):
        draw().savefig(output, metadata={"Date": None} if output.endswith(".svg") else {}, dpi=110)


if __name__ == "__main__":
    main()
