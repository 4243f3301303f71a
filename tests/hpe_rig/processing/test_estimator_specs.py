"""The rows that describe the estimators, against what these do."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from hpe_rig.processing import ESTIMATORS, hann, spec_of
from hpe_rig.scene import BUILT_IN_ESTIMATORS
from hpe_rig.scene.estimator_table import WINDOW_NOISE

if TYPE_CHECKING:
    from conftest import TableOne


def test_every_estimator_a_scene_may_name_has_a_row() -> None:
    assert tuple(BUILT_IN_ESTIMATORS) == ESTIMATORS
    assert [spec_of(name).name for name in ESTIMATORS] == list(ESTIMATORS)
    with pytest.raises(ValueError, match="'best' is not one of the choices"):
        spec_of("best")


@pytest.mark.parametrize("name", ["coherent", "cross_correlation", "kasai", "loupas"])
def test_displacements_walk_off_where_steps_from_pulse_to_pulse_are_added_up(table_one: TableOne, name: str) -> None:
    """A target at rest in noise of its own power: the steps' errors add up, or each pulse has its own."""
    still = replace(table_one, pulses=600)
    echoes = still.rigid(np.zeros(600))
    noisy = echoes + np.sqrt(np.mean(echoes**2)) * np.random.default_rng(3).normal(size=(8, *echoes.shape))
    found = spec_of(name).motion(still.gate(noisy)).displacement_m
    apart = (found[:, 300:] - found[:, :300]).std() / (found[:, 1:] - found[:, :-1]).std()
    assert spec_of(name).steps_add_up == (apart > 1.5), apart


def test_noise_of_a_window_is_that_of_its_samples() -> None:
    window = hann(1000)
    assert WINDOW_NOISE["hann"] == pytest.approx(1000 * np.sum(window**2) / window.sum() ** 2, rel=1e-12)
    assert WINDOW_NOISE["none"] == 1.0


def test_a_label_is_the_name_unless_another_is_given() -> None:
    assert [spec_of(name).label for name in ("coherent", "cross_spectrum")] == ["coherent", "the paper's chain"]


def test_one_estimator_is_the_papers_own() -> None:
    assert [name for name in ESTIMATORS if spec_of(name).published] == ["cross_spectrum"]
