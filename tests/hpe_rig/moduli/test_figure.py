"""The figure of moduli at the width of a column: the legend hides no point."""

from __future__ import annotations

import numpy as np

from hpe_rig.moduli.figure import moduli_figure
from hpe_rig.moduli.vibration_model import Vibration


def test_the_legend_of_a_high_figure_is_below_both_panels() -> None:
    frequency_hz = 100.0 * np.arange(1, 11)
    phasors = [np.exp(-frequency_hz * offset_m) * 1e-6 + 0j for offset_m in (1e-3, 2e-3)]
    vibrations = [
        Vibration(f"{index} mm", frequency_hz, phasor, 1e-18 * np.eye(20), index * 1e-3)
        for index, phasor in enumerate(phasors, start=1)
    ]
    figure = moduli_figure(vibrations, phasors, "title", simulated=True, figsize=(3.35, 3.7))
    figure.draw_without_rendering()
    (legend,) = figure.legends
    top_px = legend.get_window_extent().y1
    assert all(axes.get_tightbbox().y0 > top_px for axes in figure.axes)
