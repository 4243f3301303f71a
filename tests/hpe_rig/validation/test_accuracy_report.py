"""End-to-end and extreme cases: reference solutions, Pareto front, and the page of all studies."""

from __future__ import annotations

import itertools
import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from hpe_rig import validation
from hpe_rig.cli.app import app
from hpe_rig.validation.accuracy import end_to_end, report as accuracy_report
from hpe_rig.validation.accuracy.end_to_end import EndToEnd, Variant, pareto
from hpe_rig.validation.accuracy.extremes import extremes
from hpe_rig.validation.accuracy.report import FULL, Effort, end_to_end_section, lead, write_accuracy_report
from hpe_rig.validation.accuracy.work_precision import Point


def test_the_true_amplitude_in_closed_form_equals_a_fit_of_the_computed_displacement() -> None:
    time_s = 50e-3 + np.arange(399) / 3990.0
    angle = 2 * np.pi * 100.0 * np.outer(time_s, np.arange(1, 11))
    model = np.column_stack([np.sin(angle), np.cos(angle), np.ones(len(time_s))])
    fitted = np.linalg.lstsq(model, end_to_end.displacement(32, 24), rcond=None)[0]
    # Tolerance: the transient after 50 ms and harmonics above 1 kHz.
    assert np.hypot(fitted[1], fitted[11]) == pytest.approx(end_to_end.true_amplitude_m(), rel=1e-4)


def test_the_numerical_error_of_default_settings_is_negligible_and_grows_with_coarser_settings() -> None:
    shipped = end_to_end.numerical_error(Variant())
    assert shipped < Variant().tolerance
    assert end_to_end.numerical_error(replace(Variant(), nodes=6, degrees=6)) > 1e3 * shipped
    assert shipped < end_to_end.numerical_error(replace(Variant(), tolerance=1e-2)) < 1e-2


def test_the_final_amplitude_is_true_within_its_standard_error() -> None:
    relative = end_to_end.amplitudes(Variant(), 32, 5) / end_to_end.true_amplitude_m()
    # Tolerance: 0.5 % of the averaging factor, and three standard errors of 32 realisations.
    assert relative.mean() == pytest.approx(1.0, abs=0.005 + 3 * relative.std(ddof=1) / math.sqrt(32))
    assert relative.std(ddof=1) == pytest.approx(0.07, abs=3 * 0.07 / math.sqrt(2 * 31))


def test_no_other_point_is_better_than_one_of_the_front_in_both_time_and_error() -> None:
    rng = np.random.default_rng(3)
    times, errors = rng.integers(0, 12, 60).tolist(), rng.integers(0, 12, 60).astype(float).tolist()
    errors[7] = math.nan
    front = pareto(times, errors)
    for k, (time, error) in enumerate(zip(times, errors, strict=True)):
        beaten = any(t <= time and e <= error and (t, e) != (time, error) for t, e in zip(times, errors, strict=True))
        same = [(times[j], errors[j]) for j in front]
        assert ((time, error) in same) == (not beaten and not math.isnan(error)), k
    assert all(times[a] < times[b] and errors[a] > errors[b] for a, b in itertools.pairwise(front))


def test_errors_of_extreme_cases_are_within_the_limits_of_their_stage() -> None:
    medium = [
        Point("elastic 7.25 kPa", "hyperbola, panels of log time", "32 nodes, 24 degrees", 2e-10, 0.01),
        Point("elastic 7.25 kPa", "Fourier synthesis, padded", "1 s, 10 kHz", 3e-3, 0.5),
        Point("elastic 7.25 kPa", "Fourier synthesis, padded", "0.25 s, 2 kHz", 6e-1, 0.02),
        Point("bovine muscle", "hyperbola, panels of log time", "32 nodes, 24 degrees", 1e-12, 0.01),
    ]
    cases = list(extremes(medium, longest_cycles=40.0))
    assert [row.error for row in cases if row.stage == "medium"] == [2e-10, 3e-3]
    limits = {"echoes": 1e-6, "fit": 1e-6}
    for row in cases:
        if row.stage in limits:
            assert row.error <= limits[row.stage], row
        if row.stage == "estimators":
            # The gate is shorter than the pulse and cuts its edges; the paper's chain also applies a window.
            assert row.error <= (2e-3 if row.method == "cross_spectrum" else 1e-3), row


def two_variants() -> list[EndToEnd]:
    common = {"tolerance": 1e-6, "degrees": 24, "gate_length_m": 1e-3, "bias": 0.0, "bias_uncertainty": 0.0, "cores": 1}
    return [
        EndToEnd(
            **common, varied="nodes", estimator="coherent", nodes=nodes, realisations=count, numerical_error=1e-9,
            standard_error=0.07 / count, error=0.07 / count, time_s=0.1 * count, shipped=nodes == 32, on_front=True,
        )
        for nodes in (32, 6)
        for count in (1, 4)
    ]  # fmt: skip


def test_the_report_marks_the_default_settings_and_the_front() -> None:
    section = end_to_end_section(two_variants())
    assert "default settings" in section.pictures[0].svg
    assert "Pareto front" in section.pictures[0].svg
    assert re.search(r"7 % in 0.1 s from 1; 1.8 % in 0.4 s from 4\.", lead(section.tables[0])[0])


def test_all_mistakes_of_the_command_line_are_reported_before_the_first_measurement(tmp_path: Path) -> None:
    done = CliRunner().invoke(app, ["accuracy", "--output", str(tmp_path / "x.csv"), "--figure", "x.svg"])
    assert done.exit_code == 2
    assert all(word in done.output for word in ("2 mistakes", "--output", "--figure"))
    assert list(tmp_path.iterdir()) == []


def interrupted() -> None:
    raise KeyboardInterrupt


def test_an_interruption_keeps_the_parts_before_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(accuracy_report, "end_to_end_rows", lambda realisations, tried: two_variants())
    monkeypatch.setattr(accuracy_report.accuracy_specimen, "points", interrupted)
    done = CliRunner().invoke(app, ["accuracy", "--output", str(tmp_path / "a.html")])
    assert done.exit_code == 130
    assert "a.html holds the parts before specimen" in done.output
    page = (tmp_path / "a.html").read_text(encoding="utf-8")
    assert 'download="end-to-end.csv"' in page
    # The line that unfolds the table is its caption.
    assert re.findall(r"<(?:summary|caption)>(End to end.*?)<", page) == re.findall(r"<summary>(.*?)<", page)


def test_full_raises_every_limit_and_stated_options_take_precedence(monkeypatch: pytest.MonkeyPatch) -> None:
    efforts: list[Effort] = []
    monkeypatch.setattr(validation, "write_accuracy_report", lambda path, figure, effort, *_: efforts.append(effort))
    for arguments in ([], ["--full"], ["--full", "--draws", "7"], ["--largest", "500"]):
        assert CliRunner().invoke(app, ["accuracy", *arguments]).exit_code == 0
    quick, full, stated, small = efforts
    assert (quick, full) == (Effort(), FULL)
    assert all(getattr(full, name) > getattr(quick, name) for name in ("largest", "most_echoes", "longest_s", "draws"))
    assert (stated, small) == (replace(FULL, draws=7), replace(Effort(), largest=500))


def test_every_study_reports_its_progress(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(accuracy_report, "end_to_end_rows", lambda realisations, tried: list(tried) and two_variants())
    monkeypatch.setattr(accuracy_report.accuracy_specimen, "points", interrupted)
    steps: list[tuple[int, int, str]] = []
    with pytest.raises(KeyboardInterrupt):
        write_accuracy_report(tmp_path / "a.html", None, Effort(), lambda text: None, lambda *step: steps.append(step))
    assert steps[0] == (0, 7, "end to end")
    assert steps[1] == (0, 7, "end to end, 1 measured")
    assert steps[-1] == (1, 7, "specimen")


@pytest.mark.slow
def test_accuracy_without_a_part_writes_one_report_of_all(tmp_path: Path) -> None:
    path = tmp_path / "accuracy.html"
    small = ["--largest", "100", "--most-echoes", "10", "--longest-s", "0.1", "--draws", "2"]
    done = CliRunner().invoke(app, ["accuracy", "--output", str(path), *small])
    assert done.exit_code == 0, done.output
    page = path.read_text(encoding="utf-8")
    names = ("end-to-end", "specimen", "extremes", "echo", "chain", "motion", "harmonic")
    for name in names:
        assert f'download="{name}.csv"' in page
    assert page.count('role="img"') == len(names) - 1
