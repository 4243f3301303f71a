"""Tables on the terminal: the peak displacement and the means lead, and no table is wider than it may be."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from hpe_rig.cli.tables import TABLE_WIDTH, print_result
from hpe_rig.result import Component, Estimate, Result, ShotResult

BUDGET = (Component("noise", 1.234e-6, 0.0456), Component("speckle", 1.1e-6, 0.01), Component("gate edge", 1e-12, 1e-9))
ESTIMATE = Estimate(
    1000.0, 1.23456e-5, 1.1e-6, -3.1, 0.0456, 0.89, 0.06, 1.45678e-5, 3.1, averaging_phase_rad=-0.02, components=BUDGET
)
SHOT = ShotResult(0, 0, 1e-4, 0.8, 588, 7, 1.2345e-6, (ESTIMATE,), (), 4000.0, 0.1)


def result_of(*shots: ShotResult) -> Result:
    return Result("A title", "run.h5", True, "complete", "coherent", "of the sine", shots, (), (), {}, {})


def printed(capsys: pytest.CaptureFixture[str], *shots: ShotResult) -> list[str]:
    print_result(result_of(*shots))
    return capsys.readouterr().out.splitlines()


def test_a_table_leads_with_the_peak_and_names_what_its_uncertainty_is_of(capsys: pytest.CaptureFixture[str]) -> None:
    lines = printed(capsys, SHOT)
    assert max(map(len, lines)) <= TABLE_WIDTH
    (row,) = [line.split() for line in lines if line.startswith("1000 ")]
    lead = ESTIMATE.headline
    cells = [float(cell) for cell in row[1:9]]
    assert cells[0] == pytest.approx(lead.amplitude_m * 1e9, rel=1e-4)
    assert cells[1] == pytest.approx(math.hypot(1.234e-6, 1.1e-6) * 1e9, rel=0.05)
    assert cells[2:4] == pytest.approx([math.degrees(-3.08), math.degrees(lead.phase_uncertainty_rad)], abs=0.01)
    assert cells[4] == pytest.approx(12345.6, rel=1e-4)
    (budget,) = [line for line in lines if line.startswith("u at 1000 Hz: ")]
    assert budget.index("noise") < budget.index("speckle")
    assert "gate edge" not in budget


def test_means_over_repeats_come_first_and_the_shots_after_them(capsys: pytest.CaptureFixture[str]) -> None:
    shots = [replace(SHOT, shot=index, repeat=index) for index in range(3)]
    lines = printed(capsys, *shots)
    starts = [line.split(",")[0] for line in lines if line.startswith(("MEAN", "shot "))]
    assert starts == ["MEAN of 3 repeats", "shot 1", "shot 2", "shot 3"]
    assert "0.0 of 4" in next(line for line in lines if line.startswith("1000 "))


def test_without_beams_the_tracked_values_stand_alone_and_the_legend_says_so(
    capsys: pytest.CaptureFixture[str],
) -> None:
    bare = replace(ESTIMATE, averaging_factor=None, true_amplitude_m=None, true_phase_rad=None)
    lines = printed(capsys, replace(SHOT, estimates=(bare,), complete=False))
    assert not any("peak" in line for line in lines if line.startswith(("   f", "  Hz")))
    assert any("INCOMPLETE" in line for line in lines)
    assert any("no [beams]" in line for line in lines)
