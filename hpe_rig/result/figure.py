"""Figure of a result for matplotlib: amplitude and phase over frequency of the first shots."""

from __future__ import annotations

import math

from matplotlib.figure import Figure

from hpe_rig.result.result_data import ResultData
from hpe_rig.result.svg import PALETTE

PANELS = (
    ("amplitude_m", "amplitude_uncertainty_m", "amplitude / nm", 1e9),
    ("phase_rad", "phase_uncertainty_rad", "phase / deg", 180 / math.pi),
)


def result_figure(result: ResultData) -> Figure:
    """Return amplitude and phase of the first shots with bars of twice the standard uncertainty."""
    figure = Figure(figsize=(6.0, 5.0), layout="constrained")
    title = result.title if result.origin == "measured" else f"{result.origin.partition(',')[0]}: {result.title}"
    figure.suptitle(title, wrap=True, fontsize="medium")
    for panel, (value, uncertainty, label, factor) in zip(figure.subplots(2, sharex=True), PANELS, strict=True):
        for shot, colour in zip(result.shots, PALETTE, strict=False):
            panel.errorbar(
                [item.frequency_hz for item in shot.estimates],
                [getattr(item.headline, value) * factor for item in shot.estimates],
                yerr=[2 * getattr(item.headline, uncertainty) * factor for item in shot.estimates],
                fmt="o",
                color=colour,
                label=f"shot {shot.shot + 1}",
            )
        panel.set_ylabel(f"{label}, bars: 2 u")
        panel.axhline(0.0, color="0.5", linewidth=0.8)
    panel.set_xlabel("frequency / Hz")
    if len(result.shots) > 1:
        panel.legend()
    return figure
