"""Accuracy studies of the estimators: values of the rows, tables and figures."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from hpe_rig.scene import SettingsError
from hpe_rig.validation.accuracy import harmonic as accuracy_harmonic
from hpe_rig.validation.accuracy.motion import MotionCase, MotionRow, case_rows, draw_motion
from hpe_rig.validation.accuracy.work_precision import write_rows


@pytest.fixture(scope="module")
def motion_rows() -> list[MotionRow]:
    return list(case_rows(MotionCase(snr_db=30), "snr_db", 30.0, ["coherent", "cross_spectrum"], 48, 0))


def test_rows_of_motion_order_the_estimators_by_the_bound(motion_rows: list[MotionRow]) -> None:
    coherent, paper = motion_rows
    assert coherent.bound_m == paper.bound_m
    # The jitter of 48 draws has a standard error of 10 %; Hann windows in gate and slow time raise it by 1.22 and 1.23.
    assert coherent.noise_jitter_m / coherent.bound_m == pytest.approx(1.0, abs=0.3)
    assert paper.noise_jitter_m > 1.3 * coherent.noise_jitter_m
    assert 0 < coherent.us_per_pulse < paper.us_per_pulse * 5


def test_the_same_seed_gives_the_same_errors(motion_rows: list[MotionRow]) -> None:
    repetition = next(iter(case_rows(MotionCase(snr_db=30), "snr_db", 30.0, ["coherent"], 48, 0)))
    assert repetition.bias_m == motion_rows[0].bias_m
    assert repetition.noise_jitter_m == motion_rows[0].noise_jitter_m


def test_harmonic_fits_reach_the_bound_and_the_paper_s_chain_its_loss() -> None:
    rows = {row.method: row for row in accuracy_harmonic.rows((100,), repeats=1)}
    # Tolerance: three standard errors of 200 realisations, 5 % each.
    assert rows["least_squares"].jitter_m / rows["least_squares"].bound_m == pytest.approx(1.0, abs=0.15)
    assert rows["kalman"].jitter_m == pytest.approx(rows["least_squares"].jitter_m, rel=1e-6)
    loss = rows["velocity_band_pass_hann_kalman"].jitter_m / rows["least_squares"].jitter_m
    assert loss == pytest.approx(1.23, abs=0.15)
    assert np.isfinite([row.normalised_error for row in rows.values()]).all()


def test_tables_read_back_and_figures_are_written(motion_rows: list[MotionRow], tmp_path: Path) -> None:
    messages: list[str] = []
    write_rows(motion_rows, tmp_path / "t.csv", tmp_path / "t.svg", draw_motion, messages.append)
    read = list(csv.DictReader(io.StringIO((tmp_path / "t.csv").read_text(encoding="utf-8"))))
    assert float(read[0]["noise_jitter_m"]) == motion_rows[0].noise_jitter_m
    write_rows(motion_rows, tmp_path / "t.json", None, draw_motion, messages.append)
    assert json.loads((tmp_path / "t.json").read_text(encoding="utf-8"))[1]["estimator"] == "cross_spectrum"
    fits = accuracy_harmonic.rows((60,), repeats=1)
    write_rows(fits, None, tmp_path / "h.svg", accuracy_harmonic.draw_harmonic, messages.append)
    assert (tmp_path / "t.svg").stat().st_size > 1000
    assert (tmp_path / "h.svg").stat().st_size > 1000
    assert "2 rows" in messages[0]


def test_an_unknown_table_format_is_refused_before_the_study_runs(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match="csv or"):
        write_rows(_never(), tmp_path / "t.xls", None, draw_motion, print)


def _never() -> Iterator[MotionRow]:
    raise AssertionError("the study ran")
    yield
