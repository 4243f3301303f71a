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
PUSH, TRACK, PLAIN = "#b5521b", "#1f6f8b", "0.35"
PLACES = {
    "master": (0.0, 1.0, "Master", "one pulse", PLAIN),
    "burst_train": (2.6, 2.0, "Burst train", "pulses at $f_r$", PUSH),
    "toneburst": (5.2, 2.0, "Toneburst", "3 MHz, $T_b$ long", PUSH),
    "tracking_train": (2.6, 0.0, "Tracking train", "$t_d$ later, pulses at $f_{prf}$", TRACK),
    "digitizer": (5.2, 0.0, "Digitizer", "a record a pulse", TRACK),
    "tracking_pulser": (7.8, 0.0, "Tracking pulser", "9 MHz, 3 cycles", TRACK),
    "transducer": (7.8, 2.0, "Transducer", "hybrid junction, amplifier", PLAIN),
}
"""Lower left corner, two lines of text and colour of every box."""


def main() -> None:
    """Draw a box an instrument and an arrow a cable; a cable of the bench file that has no place is an error."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    figure = Figure(figsize=(9.6, 3.1), layout="constrained")
    axes = figure.subplots()
    axes.set_axis_off()
    axes.set(xlim=(-0.2, 9.7), ylim=(-0.2, 2.8), aspect="equal")
    for x, y, name, what, colour in PLACES.values():
        box = FancyBboxPatch((x, y), WIDTH, HEIGHT, boxstyle="round,pad=0.04", fc="white", ec=colour, lw=1.6)
        axes.add_patch(box)
        middle = x + WIDTH / 2
        axes.text(middle, y + 0.43, name, ha="center", va="center", fontsize=9.5, weight="bold", color="0.1")
        axes.text(middle, y + 0.16, what, ha="center", va="center", fontsize=7.6, color="0.25")
    for cable in read_bench().bench.wiring:
        (source, outlet), (target, inlet) = cable.source.split("."), cable.target.split(".")
        _arrow(axes, source, target, "AUX to Trig" if outlet == "aux" else "Trig" if inlet == "trigger" else "")
    _receiver(axes)
    TARGET.parent.mkdir(exist_ok=True)
    with rc_context({"svg.hashsalt": "hpe_rig", "svg.fonttype": "none"}):
        figure.savefig(TARGET, metadata={"Date": None})


def _arrow(axes: Axes, source: str, target: str, label: str) -> None:
    (x0, y0, *_, colour), (x1, y1, *_) = PLACES[source], PLACES[target]
    if x0 == x1:
        ends = (x0 + WIDTH / 2, y0 + HEIGHT + 0.05), (x1 + WIDTH / 2, y1 - 0.05)
    else:
        ends = (x0 + WIDTH + 0.05, y0 + HEIGHT / 2), (x1 - 0.05, y1 + HEIGHT / 2)
    axes.add_patch(FancyArrowPatch(*ends, arrowstyle="-|>", mutation_scale=12, color=colour, lw=1.4, shrinkA=0))
    if label:
        (x0, y0), (x1, y1) = ends
        # Beside a slanted arrow, above a level one.
        x, y = (x0 + x1) / 2, (y0 + y1) / 2 + (0.1 if y0 == y1 else 0.0)
        side = {"ha": "center", "va": "bottom"} if y0 == y1 else {"ha": "right", "va": "bottom" if y1 > y0 else "top"}
        axes.text(x - (0.0 if y0 == y1 else 0.1), y, label, fontsize=7.2, color="0.25", **side)


def _receiver(axes: Axes) -> None:
    """The way back of the echoes, which no bench file lists: nothing on it is programmed."""
    x_from, x_to = PLACES["transducer"][0] + 0.5, PLACES["digitizer"][0] + WIDTH / 2
    y_from, y_to = PLACES["transducer"][1] - 0.06, PLACES["digitizer"][1] + HEIGHT + 0.05
    style = {"color": "0.35", "lw": 1.4, "linestyle": (0, (4, 2))}
    across = 1.38
    axes.plot((x_from, x_from, x_to), (y_from, across, across), **style)
    axes.add_patch(FancyArrowPatch((x_to, across), (x_to, y_to), arrowstyle="-|>", mutation_scale=12, **style))
    label = "echoes: notch at 3 MHz,\nT/R switch, band-pass\nat 9 MHz, log amplifier"
    axes.text(x_to - 0.12, across, label, ha="right", va="center", fontsize=7.2, color="0.25", linespacing=1.25)
    axes.text(x_to + 0.06, y_to + 0.06, "CH A", ha="left", va="bottom", fontsize=7.2, color="0.25")


if __name__ == "__main__":
    main()
