"""Draw how the bench is wired, from the shipped bench file: docs/figures/wiring.svg."""

import argparse
from pathlib import Path

from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch, FancyBboxPatch

from hpe_rig.bench import read_bench

TARGET = Path(__file__).parents[2] / "docs" / "figures" / "wiring.svg"
WIDTH, HEIGHT = 1.7, 0.62
PUSH, TRACK, COMMON = "#b5521b", "#1f6f8b", "0.35"
"""Colours of the two transmit paths and of the instruments that both use."""
BOXES = {
    "master": (0.0, 1.0, "Master", "one pulse", COMMON),
    "burst_train": (2.6, 2.0, "Burst train", "pulses at $f_r$", PUSH),
    "toneburst": (5.2, 2.0, "Toneburst", "3 MHz, $T_b$ long", PUSH),
    "tracking_train": (2.6, 0.0, "Tracking train", "$t_d$ later, pulses at $f_{prf}$", TRACK),
    "digitizer": (5.2, 0.0, "Digitizer", "a record per pulse", TRACK),
    "tracking_pulser": (7.8, 0.0, "Tracking pulser", "9 MHz, 3 cycles", TRACK),
    "transducer": (7.8, 2.0, "Transducer", "hybrid junction, amplifier", COMMON),
}
"""Lower left corner, two lines of text and colour of each instrument's box."""


def main() -> None:
    """Draw a box per instrument and an arrow per cable of the bench file."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    figure = Figure(figsize=(9.6, 3.1), layout="constrained")
    axes = figure.subplots()
    axes.set_axis_off()
    axes.set(xlim=(-0.2, 9.7), ylim=(-0.2, 2.8), aspect="equal")
    for x, y, name, purpose, colour in BOXES.values():
        box = FancyBboxPatch((x, y), WIDTH, HEIGHT, boxstyle="round,pad=0.04", fc="white", ec=colour, lw=1.6)
        axes.add_patch(box)
        axes.text(x + WIDTH / 2, y + 0.43, name, ha="center", va="center", fontsize=9.5, weight="bold", color="0.1")
        axes.text(x + WIDTH / 2, y + 0.16, purpose, ha="center", va="center", fontsize=7.6, color="0.25")
    for cable in read_bench().bench.wiring:
        (source, outlet), (target, inlet) = cable.source.split("."), cable.target.split(".")
        draw_cable(axes, source, target, "AUX to Trig" if outlet == "aux" else "Trig" if inlet == "trigger" else "")
    draw_receiver(axes)
    TARGET.parent.mkdir(exist_ok=True)
    # A fixed salt and no date keep the file the same if the figure is.
    with rc_context({"svg.hashsalt": "hpe_rig", "svg.fonttype": "none"}):
        figure.savefig(TARGET, metadata={"Date": None})


def draw_cable(axes: Axes, source: str, target: str, label: str) -> None:
    """Draw an arrow between two boxes, in the colour of its source."""
    (x0, y0, *_, colour), (x1, y1, *_) = BOXES[source], BOXES[target]
    if x0 == x1:
        ends = (x0 + WIDTH / 2, y0 + HEIGHT + 0.05), (x1 + WIDTH / 2, y1 - 0.05)
    else:
        ends = (x0 + WIDTH + 0.05, y0 + HEIGHT / 2), (x1 - 0.05, y1 + HEIGHT / 2)
    axes.add_patch(FancyArrowPatch(*ends, arrowstyle="-|>", mutation_scale=12, color=colour, lw=1.4, shrinkA=0))
    if label:
        (x0, y0), (x1, y1) = ends
        # The label is above a level arrow and left of a slanted one.
        x, y = (x0 + x1) / 2, (y0 + y1) / 2 + (0.1 if y0 == y1 else 0.0)
        side = {"ha": "center", "va": "bottom"} if y0 == y1 else {"ha": "right", "va": "bottom" if y1 > y0 else "top"}
        axes.text(x - (0.0 if y0 == y1 else 0.1), y, label, fontsize=7.2, color="0.25", **side)


def draw_receiver(axes: Axes) -> None:
    """Draw the path of the echoes. Bench files do not list it, because nothing in it is programmed."""
    x_from, x_to = BOXES["transducer"][0] + 0.5, BOXES["digitizer"][0] + WIDTH / 2
    y_from, y_to = BOXES["transducer"][1] - 0.06, BOXES["digitizer"][1] + HEIGHT + 0.05
    style = {"color": "0.35", "lw": 1.4, "linestyle": (0, (4, 2))}
    y_level = 1.38
    axes.plot((x_from, x_from, x_to), (y_from, y_level, y_level), **style)
    axes.add_patch(FancyArrowPatch((x_to, y_level), (x_to, y_to), arrowstyle="-|>", mutation_scale=12, **style))
    label = "echoes: notch at 3 MHz,\nT/R switch, band-pass\nat 9 MHz, log amplifier"
    axes.text(x_to - 0.12, y_level, label, ha="right", va="center", fontsize=7.2, color="0.25", linespacing=1.25)
    axes.text(x_to + 0.06, y_to + 0.06, "CH A", ha="left", va="bottom", fontsize=7.2, color="0.25")


if __name__ == "__main__":
    main()
