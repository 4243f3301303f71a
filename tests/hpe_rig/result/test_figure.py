"""Figures for papers: no setting is dropped, repeats are averaged, and the caller's axes are used."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from typer.testing import CliRunner

import hpe_rig as hpe
from hpe_rig.cli.app import app
from hpe_rig.result import Result, ShotResult, common_settings, setting_table, varied_settings
from hpe_rig.result.values import Estimate

FORCES = np.linspace(0.1, 1.0, 12)
FREQUENCIES_HZ = (100.0, 200.0)


def shot(number: int, force_fraction: float, repeat: int, **changes: Any) -> ShotResult:
    """Return a shot of two frequencies with amplitudes in proportion to the force; repeats differ by 2 nm."""
    estimates = tuple(
        Estimate(
            frequency_hz=hz,
            tracked_amplitude_m=force_fraction * 1e-4 / hz + repeat * 2e-9,
            tracked_amplitude_uncertainty_m=2e-9,
            # Phases of 170 and 190 degrees, the latter as -170.
            tracked_phase_rad=math.radians(170 if hz == FREQUENCIES_HZ[0] else -170),
            tracked_phase_uncertainty_rad=0.01,
        )
        for hz in FREQUENCIES_HZ
    )
    settings: dict[str, Any] = {"burst_length_s": 1e-4, "pulse_rate_hz": 4000.0, "window_length_s": 0.1} | changes
    return ShotResult(
        index=number, repeat=repeat, force_fraction=force_fraction, pulses_used=400, pulses_missing=0,
        residual_m=1e-8, estimates=estimates, warnings=(), **settings,
    )  # fmt: skip


def result_of(*shots: ShotResult) -> Result:
    return Result(
        title="drives", run_file="", simulated=True, status="complete", estimator="coherent", phase_reference="",
        shots=shots, warnings=(), omitted=(), versions={}, run_time_s={},
    )  # fmt: skip


@pytest.fixture(scope="module")
def drives() -> Result:
    """Twelve drives, each measured twice."""
    cases = [(force, repeat) for force in FORCES for repeat in (0, 1)]
    return result_of(*(shot(number, force, repeat) for number, (force, repeat) in enumerate(cases)))


def curves(axes: Axes) -> list[list[tuple[float, float]]]:
    return [[tuple(point) for point in bars.lines[0].get_xydata()] for bars in axes.containers]  # type: ignore[attr-defined]


def test_every_setting_has_a_curve_of_its_mean_and_a_line_of_the_legend(drives: Result) -> None:
    figure = drives.figure()
    amplitude, phase = figure.axes
    expected_nm = [FORCES * 1e5 / hz + 1 for hz in FREQUENCIES_HZ]
    drawn = curves(amplitude)
    assert len(drawn) == len(curves(phase)) == FORCES.size
    assert pytest.approx(np.array(expected_nm)) == np.array(drawn)[:, :, 1].T
    texts = [text.get_text() for text in figure.legends[0].get_texts()]
    assert texts == [f"F = {force:.4g} F_0" for force in FORCES]
    # Phases continue through half a turn.
    assert curves(phase)[0] == [(100.0, pytest.approx(170.0)), (200.0, pytest.approx(190.0))]
    # Each curve differs from all others without colours too.
    lines = [bars.lines[0] for bars in amplitude.containers]  # type: ignore[attr-defined]
    assert len({(line.get_marker(), line.get_fillstyle(), line.get_linestyle()) for line in lines}) == FORCES.size


def test_forces_that_differ_in_the_fifth_digit_have_different_labels_and_cells() -> None:
    result = result_of(*(shot(2 * n + r, force, r) for n, force in enumerate((0.18181, 0.18182)) for r in (0, 1)))
    texts = [text.get_text() for text in result.figure().legends[0].get_texts()]
    assert texts == ["F = 0.18181 F_0", "F = 0.18182 F_0"]
    first = [mean for mean in result.means if mean.frequency_hz == FREQUENCIES_HZ[0]]
    assert varied_settings(first) == (["F\nF_0"], [["0.18181"], ["0.18182"]])
    assert "F_0" not in common_settings(first)


def test_a_figure_over_the_drive_has_one_curve_for_each_frequency(drives: Result) -> None:
    drawn = curves(drives.figure("drive", frequencies_hz=[200.0]).axes[0])
    assert drawn == [[(pytest.approx(force), pytest.approx(force * 500 + 1)) for force in FORCES]]
    assert [text.get_text() for text in drives.figure("drive").legends[0].get_texts()] == ["100 Hz", "200 Hz"]


def test_a_figure_over_the_lateral_offset_is_in_order_of_the_offset() -> None:
    result = result_of(*(shot(number, 1.0, 0, lateral_offset_m=x) for number, x in enumerate((3e-3, 1e-3, 2e-3))))
    assert [x for x, _ in curves(result.figure("distance").axes[0])[0]] == pytest.approx([1.0, 2.0, 3.0])


def test_a_lateral_offset_of_zero_is_named_beside_others_and_else_omitted() -> None:
    shots = [shot(number, 1.0, 0, lateral_offset_m=offset_m) for number, offset_m in enumerate((0.0, 1e-3))]
    names = [table["lateral_offset_m"] for table in setting_table(shots)]
    assert names == ["0 mm lateral offset", "1 mm lateral offset"]
    assert "offset" not in common_settings(shots[:1])


def test_an_undetermined_phase_is_not_drawn() -> None:
    weak = shot(0, 1.0, 0)
    unknown = Estimate(300.0, 1e-10, 2e-9, 1.0, 1.6)
    result = result_of(ShotResult(**{name: getattr(weak, name) for name in weak.__slots__} | {
        "estimates": (*weak.estimates, unknown)
    }))  # fmt: skip
    amplitude, phase = result.figure().axes
    assert [len(curves(axes)[0]) for axes in (amplitude, phase)] == [3, 2]


def test_the_axes_and_sizes_of_the_caller_are_used(drives: Result) -> None:
    axes = Figure(figsize=(5, 4)).subplots(2, 1)
    figure = drives.figure(ax=axes)
    assert figure is axes[0].figure
    assert tuple(figure.get_size_inches()) == (5, 4)
    assert tuple(drives.figure(figsize=(3, 7)).get_size_inches()) == (3, 7)
    with rc_context({"figure.figsize": (3.35, 3)}):
        width_in, height_in = drives.figure().get_size_inches()
    # Without a size of the caller the legend adds height.
    assert width_in == 3.35
    assert height_in > 3


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"kind": "polar"}, "no kind of figure is called 'polar'; try one of spectrum"),
        ({"kind": "distance"}, "two values of: lateral offset"),
        ({"kind": "profile"}, "two values of: depth"),
        ({"kind": "displacement"}, "no displacement over time"),
        ({"frequencies_hz": [77.0]}, "none of the frequencies 77 Hz"),
        ({"ax": [Figure().subplots()]}, "ax must hold the 2 matplotlib axes"),
    ],
)
def test_a_figure_without_its_data_is_refused_in_words(drives: Result, arguments: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        drives.figure(**arguments)


def test_simulated_results_are_marked_in_every_figure(drives: Result) -> None:
    assert drives.figure("drive").axes[0].get_title(loc="right") == "SIMULATED"


@pytest.mark.parametrize(
    "kind",
    ["spectrum", pytest.param("displacement", marks=pytest.mark.slow), pytest.param("profile", marks=pytest.mark.slow)],
)
def test_the_command_writes_a_figure_as_wide_as_asked(kind: str, tmp_path: Path) -> None:
    run, figure = tmp_path / "run.h5", tmp_path / "figure.pdf"
    hpe.measure("table-1", path=run)
    step = ["--gate-profile-step", "1mm"] if kind == "profile" else []
    command = ["figure", str(run), "--kind", kind, "--width", "85mm", "-o", str(figure), *step]
    assert CliRunner().invoke(app, command, catch_exceptions=False).exit_code == 0
    # The page of a PDF is in points of 1/72 inch.
    width_pt = float(figure.read_bytes().split(b"/MediaBox [ 0 0 ")[1].split()[0])
    assert width_pt == pytest.approx(85 / 25.4 * 72, abs=0.01)
