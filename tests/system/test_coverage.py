"""Coverage of the stated intervals: subsets of the measurements of ``scripts/validation/interval_coverage.py``."""

from __future__ import annotations

import importlib.util
import math
import sys
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from hpe_rig.bench import twin_of
from hpe_rig.scene import load_scene

SCRIPT = Path(__file__).parents[2] / "scripts" / "validation" / "interval_coverage.py"
HEAVY = 2.0
"""Kurtosis of the errors over that of normal ones: speckle has rare large errors."""


@pytest.fixture(scope="module")
def coverage() -> ModuleType:
    spec = importlib.util.spec_from_file_location("interval_coverage", SCRIPT)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    # A dataclass of the module needs its entry in sys.modules.
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


def check(coverage: ModuleType, scene: str, estimators: list[str], seeds: int, deviations: float) -> None:
    """Compare coverage and NEV with their goals, within ``deviations`` standard deviations for this number of seeds.

    The errors of a run share their speckle, so a run counts as one trial. The goals also have a tolerance.
    """
    for row in coverage.coverage(scene, estimators, range(seeds)):
        for axis, name in enumerate(("amplitude", "phase")):
            label = f"{scene}, {row.estimator}, {name}: {row}"
            chance = math.sqrt(0.95 * 0.05 / seeds)
            assert row.within_95[axis] == pytest.approx(0.95, abs=deviations * chance + 0.03), label
            spread = math.sqrt(2 * HEAVY / seeds)
            assert 0.8 - deviations * spread < row.nev[axis] < 1.25 + deviations * spread, label


@pytest.mark.slow
def test_the_coverage_table_is_written_from_the_stored_parts(
    coverage: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    coverage.measured(tmp_path, "table-1", ["coherent"], range(1))
    coverage.measured(tmp_path, "table-1", ["coherent", "kasai"], range(1))
    coverage.measured(tmp_path, "table-1", ["coherent"], range(1, 2))
    times = {path: path.stat().st_mtime_ns for path in tmp_path.iterdir()}
    coverage.measured(tmp_path, "table-1", ["coherent", "kasai"], range(1))
    assert {path: path.stat().st_mtime_ns for path in tmp_path.iterdir()} == times
    rows = list(coverage._rows(tmp_path, "table-1"))
    assert [(row.estimator, row.seeds) for row in rows] == [("coherent", 2), ("kasai", 1)]
    at_once = coverage.coverage("table-1", ["coherent"], range(2))[0]
    # Files are read in any order, which changes the rounding of sums.
    for sums in ("nev", "nev_error"):
        assert getattr(rows[0], sums) == pytest.approx(getattr(at_once, sums), rel=1e-12)
    assert replace(rows[0], nev=at_once.nev, nev_error=at_once.nev_error) == at_once
    page = coverage.with_table(coverage.PAGE.read_text(encoding="utf-8"), rows)
    assert "| table-1 | coherent |" in page
    assert "| table-1 | kasai |" in page
    assert "| steel-sphere |" not in page
    assert "## Distributions of the errors" in page
    # A change of the drawn quantities invalidates the parts.
    monkeypatch.setattr(coverage, "WIDTH_LOG_SD", 0.2)
    coverage._key.cache_clear()
    assert not list(coverage._rows(tmp_path, "table-1"))


def test_media_are_drawn_for_scenes_without_a_declared_medium(coverage: ModuleType) -> None:
    muscle, declared, prescribed = (
        load_scene("bovine-muscle"),
        load_scene("bovine-muscle").with_({"medium.shear_modulus_pa": 9e3, "medium.shear_viscosity_pa_s": 2.0}),
        load_scene("table-1"),
    )
    drawn = [coverage.draw_scene(muscle, seed).simulation for seed in range(40)]
    assert {twin["specimen"]["medium"] for twin in drawn} == {"voigt", "zener", "power_law", "maxwell"}
    log_width = np.log([twin["beams"]["excitation_width_m"][0] / 0.17e-3 for twin in drawn])
    assert log_width.std() == pytest.approx(0.3, rel=3 / math.sqrt(2 * 40))
    for scene in (declared, prescribed):
        specimen = (scene.simulation or {}).get("specimen")
        assert (coverage.draw_scene(scene, 3).simulation or {}).get("specimen") == specimen


def test_the_first_harmonic_in_a_drawn_medium_is_as_large_as_in_the_scene(coverage: ModuleType) -> None:
    scene = load_scene("bovine-muscle")
    amplitudes_m = []
    for variant in (scene, coverage.draw_scene(scene, 1), coverage.draw_scene(scene, 2)):
        twin = twin_of(variant)
        assert twin is not None
        assert twin.settings.specimen is not None
        amplitudes_m.append(twin.steady_response_m(100.0))
    assert amplitudes_m[1:] == pytest.approx(amplitudes_m[:1] * 2)


@pytest.mark.slow
def test_intervals_of_the_prescribed_motion_hold_the_truth(coverage: ModuleType) -> None:
    check(coverage, "table-1", ["coherent", "cross_spectrum"], seeds=14, deviations=3.0)


@pytest.mark.slow
@pytest.mark.parametrize("seeds", [4, pytest.param(14, marks=pytest.mark.slow)])
def test_intervals_hold_the_truth_in_unknown_media_with_and_without_a_prior(coverage: ModuleType, seeds: int) -> None:
    check(coverage, "bovine-muscle", ["coherent", "cross_spectrum"], seeds=seeds, deviations=3.0)


@pytest.mark.slow
@pytest.mark.parametrize("scene", ["table-1", "bovine-muscle"])
def test_intervals_of_every_estimator_hold_the_truth(coverage: ModuleType, scene: str) -> None:
    from hpe_rig.processing import ESTIMATORS

    check(coverage, scene, list(ESTIMATORS), seeds=60, deviations=3.0)


@pytest.mark.slow
def test_intervals_hold_the_truth_with_unresolved_aliasing(coverage: ModuleType) -> None:
    check(coverage, "bovine-muscle-synchronous", ["coherent"], seeds=40, deviations=3.0)


@pytest.mark.slow
def test_intervals_hold_the_truth_of_a_sphere_in_unknown_media(coverage: ModuleType) -> None:
    check(coverage, "steel-sphere", ["coherent", "cross_spectrum"], seeds=20, deviations=3.0)
