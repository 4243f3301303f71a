"""Results on the terminal: one sentence leads, means before shots, and no line is wider than the terminal."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import pytest

from hpe_rig.cli.queue import _result_text
from hpe_rig.cli.tables import TABLE_WIDTH, print_result
from hpe_rig.measurement import QueueRun
from hpe_rig.result import Component, Estimate, Result, ShotResult, headline_sentence

BUDGET = (Component("noise", 1.234e-6, 0.0456), Component("speckle", 1.1e-6, 0.01), Component("gate edge", 1e-12, 1e-9))
ESTIMATE = Estimate(
    1000.0, 1.23456e-5, 1.1e-6, -3.1, 0.0456, 0.89, 0.06, 1.45678e-5, 3.1, averaging_phase_rad=-0.02, components=BUDGET
)
SHOT = ShotResult(0, 0, 1e-4, 0.8, 588, 7, 1.2345e-6, (ESTIMATE,), (), 4000.0, 0.1)
LONG = "a warning that goes on and on, as those of aliasing harmonics do, until no terminal is wide enough for it"


def result_of(*shots: ShotResult) -> Result:
    return Result("A title", "run.h5", True, "complete", "coherent", "of the sine", shots, (), (), {}, {})


def printed(capsys: pytest.CaptureFixture[str], *shots: ShotResult, wide: bool = False) -> list[str]:
    print_result(result_of(*shots), wide)
    return capsys.readouterr().out.splitlines()


def test_a_table_begins_with_the_peak_and_lists_sources_of_uncertainty(
    capsys: pytest.CaptureFixture[str],
) -> None:
    lines = printed(capsys, SHOT)
    assert max(map(len, lines)) <= TABLE_WIDTH
    (row,) = [line.split() for line in lines if line.startswith("1000 ")]
    cells = [float(cell) for cell in row[1:9]]
    # Five digits in nm are two in um.
    assert cells[0] == pytest.approx(ESTIMATE.amplitude_m * 1e6, rel=1e-3)
    assert cells[1] == pytest.approx(math.hypot(1.234, 1.1), rel=0.05)
    assert cells[2:4] == pytest.approx([math.degrees(-3.08), math.degrees(ESTIMATE.phase_uncertainty_rad)], abs=0.01)
    assert cells[4] == pytest.approx(12.3456, rel=1e-3)
    (budget,) = [line for line in lines if line.startswith("u at 1000 Hz: ")]
    assert budget.index("noise") < budget.index("speckle")
    assert "gate edge" not in budget


def test_the_result_begins_with_one_sentence(capsys: pytest.CaptureFixture[str]) -> None:
    part = (Component("noise", 14e-9, math.radians(0.5)),)
    found = Estimate(100.0, 787e-9, 1e-9, math.radians(73.4), 1e-3, 1.0, averaging_phase_rad=0.0, components=part)
    said = "787 +- 14 nm at 100 Hz (corrected, 95 %: 760 to 814), phase 73.40 +- 0.50 deg; simulated"
    shot = replace(SHOT, estimates=(found,))
    assert headline_sentence(result_of(shot)) == said
    assert next(line for line in printed(capsys, shot) if line) == said


def test_the_sentence_of_several_settings_states_their_range() -> None:
    weak = replace(ESTIMATE, tracked_amplitude_m=1.2e-6)
    shots = (SHOT, replace(SHOT, index=1, force_fraction=0.1, estimates=(weak,)))
    said = headline_sentence(result_of(*shots))
    assert said.startswith("1.3 +- 1.7 to 13.9 +- 1.7 um at 1000 Hz")
    assert "over 2 settings, 2 shots" in said


def test_an_incomplete_repeat_changes_neither_the_mean_nor_the_sentence() -> None:
    shots, incomplete = [replace(SHOT, index=index, repeat=index) for index in range(2)], replace(SHOT, index=2)
    said = headline_sentence(result_of(*shots, replace(incomplete, repeat=2, complete=False)))
    assert said == headline_sentence(result_of(*shots))
    assert said.endswith(", 2 shots; simulated")
    assert "phase" in said


def test_the_mean_of_repeats_comes_before_one_line_per_shot(capsys: pytest.CaptureFixture[str]) -> None:
    shots = [replace(SHOT, index=index, repeat=index) for index in range(25)]
    lines = printed(capsys, *shots)
    assert "25 shots; simulated" in lines[1]
    (title,) = [at for at, line in enumerate(lines) if line.startswith("MEAN of 25 repeats, shots 1 to 25")]
    (shots_title,) = [at for at, line in enumerate(lines) if line.startswith("25 shots at 1000 Hz, T_b = 100 us")]
    assert title < shots_title
    rows = lines[shots_title + 3 : shots_title + 28]
    assert [row.split()[0] for row in rows] == [f"{number}" for number in range(1, 26)]
    assert "0.0 of 48" in next(line for line in lines if line.startswith("1000 "))


def test_wide_has_a_table_for_every_shot(capsys: pytest.CaptureFixture[str]) -> None:
    shots = [replace(SHOT, index=index, repeat=index) for index in range(3)]
    lines = printed(capsys, *shots, wide=True)
    starts = [line.split(",")[0] for line in lines if line.startswith(("MEAN", "shot "))]
    assert starts == ["MEAN of 3 repeats", "shot 1", "shot 2", "shot 3"]


@pytest.mark.parametrize("columns", [80, 120])
def test_nothing_is_wider_than_the_terminal(
    columns: int, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", f"{columns}")
    shots = [replace(SHOT, index=index, force_fraction=1 / (index + 1), warnings=(LONG,)) for index in range(4)]
    for printed_shots in (shots[:1], shots, [replace(shot, force_fraction=0.8, repeat=shot.index) for shot in shots]):
        lines = printed(capsys, *printed_shots)
        assert max(map(len, lines)) <= columns
        headers = [line.split() for line in lines if "phase" in line and "u" in line.split()]
        # A narrow table omits derived columns, but not the peak and its u.
        assert all("peak" in header for header in headers)
        assert any("tracked" in header and "true" in header for header in headers) == (
            columns == 120 and len(printed_shots) == 1
        )


def test_without_beams_only_the_tracked_values_are_printed_and_the_legend_explains_it(
    capsys: pytest.CaptureFixture[str],
) -> None:
    bare = replace(ESTIMATE, averaging_factor=None, true_amplitude_m=None, true_phase_rad=None)
    lines = printed(capsys, replace(SHOT, estimates=(bare,), complete=False))
    assert not any("peak" in line for line in lines if line.startswith(("   f", "  Hz")))
    assert any("INCOMPLETE" in line for line in lines)
    assert any("without [beams]" in line for line in lines)
    assert any("(as tracked" in line for line in lines)


def test_an_untrusted_shot_is_named_in_the_first_line_and_in_its_row(
    capsys: pytest.CaptureFixture[str],
) -> None:
    lines = list(_lines(printed(capsys, SHOT, replace(SHOT, index=1, repeat=1, untrusted="the amplitude was changed"))))
    assert lines[0].endswith("; 1 NOT TO BE TRUSTED")
    assert any(line.split()[:1] == ["2"] and line.endswith("UNTRUSTED") for line in lines)


def test_the_row_of_a_queue_states_no_untrusted_shot() -> None:
    run = QueueRun("a", "", None, "a.h5", "done")
    larger = replace(SHOT, index=1, untrusted="clipped", estimates=(replace(ESTIMATE, tracked_amplitude_m=1e-4),))
    assert _result_text(run, result_of(SHOT, larger)) == _result_text(run, result_of(SHOT))
    assert _result_text(run, result_of(larger)) == "NOT TO BE TRUSTED"


def _lines(lines: list[str]) -> Iterator[str]:
    yield from (line.rstrip() for line in lines if line.strip())
