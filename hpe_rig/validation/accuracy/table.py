"""Tables and figures of the accuracy studies: rows as CSV or JSON, error against run time as a figure."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hpe_rig.report import label_decades
from hpe_rig.scene import Mistake, SettingsError
from hpe_rig.validation.accuracy.work_precision import COLOURS

if TYPE_CHECKING:
    from hpe_rig.validation.accuracy.harmonic import HarmonicRow
    from hpe_rig.validation.accuracy.motion import Row


def rows_as_text(rows: Sequence[Any], suffix: str) -> str:
    """Return rows of one dataclass as ``.csv`` or ``.json``; raises ``SettingsError`` for another suffix."""
    if suffix == ".json":
        return json.dumps([asdict(row) for row in rows], indent=1) + "\n"
    if suffix != ".csv":
        mistake = Mistake("--output", f"{suffix!r} is no table format here", "a file name that ends in .csv or .json")
        raise SettingsError("command line", [mistake])
    text = io.StringIO(newline="")
    writer = csv.DictWriter(text, [field.name for field in fields(rows[0])] if rows else [], lineterminator="\n")
    writer.writeheader()
    writer.writerows(asdict(row) for row in rows)
    return text.getvalue()


def write_rows(
    rows: Iterable[Any],
    output: Path | None,
    figure: Path | None,
    draw: Callable[[list[Any], Path], None],
    tell: Callable[[str], None],
) -> None:
    """Write rows to ``output`` or tell them as CSV, and draw ``figure`` where wanted."""
    suffix = ".csv" if output is None else output.suffix
    rows_as_text([], suffix)  # a wrong suffix is known before the study runs
    found = list(rows)
    text = rows_as_text(found, suffix)
    if output is None:
        tell(text.rstrip("\n"))
    else:
        output.write_text(text, encoding="utf-8")
        tell(f"{output}: {len(found)} rows")
    if figure is not None:
        draw(found, figure)
        tell(f"{figure}: error against run time")


def draw_motion(rows: list[Row], path: Path) -> None:
    """Draw noise jitter over its bound against time per pulse, a panel a parameter; the best is low and left."""
    from matplotlib.figure import Figure

    names = list(dict.fromkeys(row.parameter for row in rows))
    columns = min(4, len(names))
    lines = math.ceil(len(names) / columns)
    picture = Figure(figsize=(3.2 * columns, 3.2 * lines), layout="constrained")
    axes = picture.subplots(lines, columns, squeeze=False, sharey=True).ravel()
    for spare in axes[len(names) :]:
        spare.set_axis_off()
    for axis, name in zip(axes, names, strict=False):
        for place, estimator in enumerate(dict.fromkeys(row.estimator for row in rows)):
            own = [row for row in rows if row.parameter == name and row.estimator == estimator]
            ratio = [row.noise_jitter_m / row.bound_m for row in own]
            style = {"color": COLOURS[place % len(COLOURS)], "ms": 4, "label": estimator}
            axis.loglog([row.us_per_pulse for row in own], ratio, "os^dvx"[place % 6], **style)
        axis.axhline(1, color="0.6", lw=0.8)
        axis.set(title=name, xlabel="time per pulse (us)")
        label_decades(axis.xaxis)
    for axis in axes[::columns]:
        axis.set_ylabel("noise jitter / bound")
    axes[0].legend(fontsize=7)
    picture.savefig(path)


def draw_harmonic(rows: list[HarmonicRow], path: Path) -> None:
    """Draw amplitude error over its bound against run time, a panel a number of pulses."""
    from matplotlib.figure import Figure

    counts = sorted({row.pulses for row in rows})
    picture = Figure(figsize=(3.0 * len(counts), 3.6), layout="constrained")
    axes = picture.subplots(1, len(counts), squeeze=False, sharey=True)[0]
    for axis, count in zip(axes, counts, strict=True):
        for place, method in enumerate(dict.fromkeys(row.method for row in rows)):
            own = [row for row in rows if row.pulses == count and row.method == method]
            style = {"color": COLOURS[place % len(COLOURS)], "ms": 5, "label": method}
            ratio = [row.jitter_m / row.bound_m for row in own]
            axis.loglog([row.time_s for row in own], ratio, "os^dvx*P"[place % 8], **style)
        axis.axhline(1, color="0.6", lw=0.8)
        axis.set(title=f"{count} pulses", xlabel="run time of 200 fits (s)")
        label_decades(axis.xaxis)
    axes[0].set_ylabel("jitter / bound")
    axes[0].legend(fontsize=7)
    picture.savefig(path)
