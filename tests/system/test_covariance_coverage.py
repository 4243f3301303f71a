"""Coverage of ratios and differences: subsets of the measurements of ``scripts/validation/covariance_coverage.py``."""

from __future__ import annotations

import importlib
import math
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

FOLDER = Path(__file__).parents[2] / "scripts" / "validation"
SEEDS = 40
HEAVY = 2.0
"""Kurtosis of the errors over that of normal ones: speckle has rare large errors."""


@pytest.fixture
def script(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(FOLDER))
    return importlib.import_module("covariance_coverage")


def test_the_page_has_a_row_for_each_combination(script: ModuleType, tmp_path: Path) -> None:
    one = {"coherent": {"ratio": [], "repeats": [[[0.5, 0.25], [1.0, 0.5]]], "offsets": []}}
    other = {"coherent": {"ratio": [], "repeats": [[[3.0, 1.5], [1.0, 0.5]]], "offsets": []}}
    for seed, ratios in enumerate((one, other, {})):
        (tmp_path / f"table-1.{seed}.json").write_text(script.json.dumps(ratios), encoding="utf-8")
    assert list(script.table_rows(tmp_path, "table-1", "coherent")) == [
        "| table-1 | coherent | repeats | 50 | 4.62 ± 3.09 | 100 | 1.00 ± 0.00 | 2 |"
    ]


@pytest.mark.slow
@pytest.mark.parametrize(("scene", "estimator"), [("bovine-muscle", "coherent"), ("table-1", "coherent")])
def test_intervals_of_ratios_and_differences_hold_the_truth(script: ModuleType, scene: str, estimator: str) -> None:
    """95 % +- 3 %, and three standard deviations for this number of seeds: a run counts as one trial."""
    runs = [ratios[estimator] for seed in range(SEEDS) if (ratios := script.measured_ratios(scene, seed))]
    for combination in ("ratio", "repeats"):
        by_run = [np.array(run[combination]) for run in runs if run[combination]]
        if scene == "table-1" and combination == "ratio":
            assert not by_run
            continue
        within = np.mean(np.abs(np.concatenate(by_run)[..., 1]) < 1, axis=0)
        assert within == pytest.approx(0.95, abs=0.03 + 3 * math.sqrt(0.95 * 0.05 / len(by_run)))
        nev = np.mean(np.concatenate(by_run)[..., 0] ** 2, axis=0)
        assert np.all(nev < 1.25 + 3 * math.sqrt(2 * HEAVY / len(by_run)))
