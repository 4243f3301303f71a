"""Figures as SVG: numbers on logarithmic axes that do not meet; files that are dark on a dark screen."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from hpe_rig.result import MotionMap, figure_bytes, label_decades
from hpe_rig.result.svg import ON_DARK


@pytest.mark.parametrize("most", [4, 6])
@pytest.mark.parametrize("span", [1.002, 1.3, 4.0, 12.0, 90.0, 1e4, 1e12])
def test_a_logarithmic_axis_has_two_numbers_at_least_and_never_many(span: float, most: int) -> None:
    axes = Figure().subplots()
    axes.loglog([0.0499, 0.0499 * span], [1.0, 2.0])
    axes.set_xlim(0.0499, 0.0499 * span)
    label_decades(axes.xaxis, most)
    low, high = axes.get_xlim()
    numbers = [tick for tick in axes.xaxis.get_majorticklocs() if low <= tick <= high]
    assert 2 <= len(numbers) <= most


def test_a_map_as_svg_has_no_colour_that_stays_light() -> None:
    each, three = np.full((2, 3), 1e-6), np.full((2, 3, 1), 1e-6)
    each[0, 0] = np.nan
    found = MotionMap(
        line_m=np.arange(2.0), depth_m=np.arange(3.0), frequency_hz=np.array([200.0]), amplitude_m=three,
        amplitude_uncertainty_m=three, phase_rad=three, phase_uncertainty_rad=three, velocity_m_per_s=each,
        velocity_uncertainty_m_per_s=each, residual_m=each, power=each, bad=np.zeros((2, 3), np.uint8), origin="",
        lines_are_placed=False,
    )  # fmt: skip
    figure = replace(found, velocity_m_per_s=0.2 * each / 1e-6).figure()
    labels = [axes.get_ylabel() for axes in figure.axes[4:]]
    assert (labels[0], labels[3]) == ("amplitude / nm", "velocity / (mm/s)")
    assert figure.axes[7].get_ylim()[1] == pytest.approx(200)
    _, _, shapes = figure_bytes(figure, Path("map.svg")).decode().partition("</style>")
    assert set(re.findall(r"(?:fill|stroke): (#\w+)", shapes)) - set(ON_DARK) == set()


def test_the_ending_of_a_figure_s_path_says_its_format() -> None:
    assert figure_bytes(Figure(), Path("map.png")).startswith(b"\x89PNG")
