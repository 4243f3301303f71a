"""The table of estimators agrees with their functions, and is all that a new estimator needs."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from hpe_rig.processing import ESTIMATORS, estimate, hann, spec_of
from hpe_rig.scene import BUILT_IN_ESTIMATORS, load_scene
from hpe_rig.scene.estimator_table import WINDOW_NOISE, EstimatorProperties

if TYPE_CHECKING:
    from conftest import TableOne


def test_every_estimator_a_scene_may_name_has_a_row() -> None:
    assert tuple(BUILT_IN_ESTIMATORS) == ESTIMATORS
    assert [spec_of(name).name for name in ESTIMATORS] == list(ESTIMATORS)
    with pytest.raises(ValueError, match="'best' is not one of the choices"):
        spec_of("best")


def test_a_row_is_all_that_a_new_estimator_needs(table_one: TableOne, monkeypatch: pytest.MonkeyPatch) -> None:
    row = EstimatorProperties("new", function="hpe_rig.processing.motion.phase_shift:kasai", by_carrier=True)
    monkeypatch.setitem(BUILT_IN_ESTIMATORS, "new", row)
    assert load_scene("table-1").with_({"processing.estimator": "new"}).processing.estimator == "new"
    echoes = table_one.gate(table_one.rigid(1e-6 * np.sin(400 * np.pi * table_one.pulse_time_s)))
    assert estimate(echoes, [200.0], "new").amplitude_m == estimate(echoes, [200.0], "kasai").amplitude_m
    assert spec_of("new").by_carrier
    assert spec_of("new").takes_prior
    spec_of.cache_clear()


@pytest.mark.parametrize("name", ["coherent", "cross_correlation", "kasai", "loupas"])
def test_displacement_noise_accumulates_only_for_estimators_that_add_up_steps(table_one: TableOne, name: str) -> None:
    """A stationary target in noise of equal power: the errors of steps add up, or those of pulses are independent."""
    long_train = replace(table_one, pulses=600)
    echoes = long_train.rigid(np.zeros(600))
    noisy = echoes + np.sqrt(np.mean(echoes**2)) * np.random.default_rng(3).normal(size=(8, *echoes.shape))
    displacement_m = spec_of(name).motion(long_train.gate(noisy)).displacement_m
    growth = np.std(displacement_m[:, 300:] - displacement_m[:, :300]) / np.std(np.diff(displacement_m))
    assert spec_of(name).steps_add_up == (growth > 1.5), growth


def test_the_noise_factor_of_a_window_follows_from_its_samples() -> None:
    window = hann(1000)
    assert WINDOW_NOISE["hann"] == pytest.approx(1000 * np.sum(window**2) / window.sum() ** 2, rel=1e-12)
    assert WINDOW_NOISE["none"] == 1.0


def test_the_label_defaults_to_the_name() -> None:
    assert [spec_of(name).label for name in ("coherent", "cross_spectrum")] == ["coherent", "the paper's chain"]


def test_one_estimator_is_the_papers() -> None:
    assert [name for name in ESTIMATORS if spec_of(name).published] == ["cross_spectrum"]
