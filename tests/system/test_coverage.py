"""Stated intervals hold the truth as often as they say: subsets of what ``scripts/validation/interval_coverage.py`` measures."""

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
"""Kurtosis of the errors over that of normal ones: speckle has dark spots."""


@pytest.fixture(scope="module")
def coverage() -> ModuleType:
    spec = importlib.util.spec_from_file_location("interval_coverage", SCRIPT)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    # Its dataclass asks for the module by name.
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


def check(coverage: ModuleType, scene: str, estimators: list[str], seeds: int, deviations: float) -> None:
    """Compare coverage and NEV with what they should be, within ``deviations`` standard deviations of so many seeds.

    The errors of a run share their speckle, so that a run counts as one trial; beyond chance, the goal's own tolerance.
    """
    for row in coverage.coverage(scene, estimators, range(seeds)):
        for axis, name in enumerate(("amplitude", "phase")):
            found = f"{scene}, {row.estimator}, {name}: {row}"
            chance = math.sqrt(0.95 * 0.05 / seeds)
            assert row.within_95[axis] == pytest.approx(0.95, abs=deviations * chance + 0.03), found
            spread = math.sqrt(2 * HEAVY / seeds)
            assert 0.8 - deviations * spread < row.nev[axis] < 1.25 + deviations * spread, found


def test_a_coverage_page_is_made_of_the_parts_that_are_there(
    coverage: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    coverage.measured(tmp_path, "table-1", ["coherent"], range(2))
    coverage.measured(tmp_path, "table-1", ["coherent", "kasai"], range(2))
    coverage.measured(tmp_path, "table-1", ["coherent"], range(2, 3))
    kept = {path: path.stat().st_mtime_ns for path in tmp_path.iterdir()}
    coverage.measured(tmp_path, "table-1", ["coherent", "kasai"], range(2))
    assert {path: path.stat().st_mtime_ns for path in tmp_path.iterdir()} == kept
    rows = list(coverage._rows(tmp_path, "table-1"))
    assert [(row.estimator, row.seeds) for row in rows] == [("coherent", 3), ("kasai", 2)]
    at_once = coverage.coverage("table-1", ["coherent"], range(3))[0]
    # files come in any order, and so do sums
    for sums in ("nev", "nev_error"):
        assert getattr(rows[0], sums) == pytest.approx(getattr(at_once, sums), rel=1e-12)
    assert replace(rows[0], nev=at_once.nev, nev_error=at_once.nev_error) == at_once
    page = coverage.page(rows)
    assert "| table-1 | coherent |" in page
    assert "| table-1 | kasai |" in page
    # Whatever else is drawn makes other runs: the parts no longer count.
    monkeypatch.setattr(coverage, "WIDTH_SPREAD", 0.2)
    coverage._key.cache_clear()
    assert not list(coverage._rows(tmp_path, "table-1"))


def test_media_are_drawn_where_the_scene_declares_none(coverage: ModuleType) -> None:
    muscle, declared, prescribed = (
        load_scene("bovine-muscle"),
        load_scene("bovine-muscle").with_({"medium.shear_modulus_pa": 9e3, "medium.shear_viscosity_pa_s": 2.0}),
        load_scene("table-1"),
    )
    drawn = [coverage.drawn(muscle, seed).simulation for seed in range(40)]
    assert {each["specimen"]["medium"] for each in drawn} == {"voigt", "zener", "power_law", "maxwell"}
    wide = np.log([each["beams"]["excitation_width_m"][0] / 0.17e-3 for each in drawn])
    assert wide.std() == pytest.approx(0.3, rel=3 / math.sqrt(2 * 40))
    for scene in (declared, prescribed):
        kept = (scene.simulation or {}).get("specimen")
        assert (coverage.drawn(scene, 3).simulation or {}).get("specimen") == kept


def test_a_drawn_medium_moves_as_far_as_the_scene_s(coverage: ModuleType) -> None:
    scene = load_scene("bovine-muscle")
    moved = []
    for each in (scene, coverage.drawn(scene, 1), coverage.drawn(scene, 2)):
        twin = twin_of(each)
        assert twin is not None
        assert twin.settings.specimen is not None
        moved.append(twin.steady_response_m(100.0))
    assert moved[1:] == pytest.approx(moved[:1] * 2)


def test_intervals_of_the_prescribed_motion_hold_the_truth(coverage: ModuleType) -> None:
    check(coverage, "table-1", ["coherent", "cross_spectrum"], seeds=14, deviations=3.0)


def test_intervals_hold_the_truth_in_unknown_media_with_and_without_a_prior(coverage: ModuleType) -> None:
    check(coverage, "bovine-muscle", ["coherent", "cross_spectrum"], seeds=6, deviations=3.0)


@pytest.mark.slow
@pytest.mark.parametrize("scene", ["table-1", "bovine-muscle"])
def test_intervals_of_every_estimator_hold_the_truth(coverage: ModuleType, scene: str) -> None:
    from hpe_rig.processing import ESTIMATORS

    check(coverage, scene, list(ESTIMATORS), seeds=60, deviations=3.0)


@pytest.mark.slow
def test_intervals_hold_the_truth_where_harmonics_alias_unseen(coverage: ModuleType) -> None:
    check(coverage, "bovine-muscle-synchronous", ["coherent"], seeds=40, deviations=3.0)


@pytest.mark.slow
def test_intervals_hold_the_truth_of_a_sphere_in_unknown_media(coverage: ModuleType) -> None:
    check(coverage, "steel-sphere", ["coherent", "cross_spectrum"], seeds=20, deviations=3.0)
