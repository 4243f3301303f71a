"""Errors that come back from another process as they left: a study's workers raise what a measurement raises."""

from __future__ import annotations

import pickle

import pytest

from drivers.interfaces import DeadlineError
from hpe_rig.plan import CheckResult, PlanError
from hpe_rig.scene import Mistake, SettingsError


@pytest.mark.parametrize(
    "error",
    [
        PlanError([CheckResult("duty", "refused", "too much", "less"), CheckResult("depth", "refused", "far", "near")]),
        SettingsError("scene a", [Mistake("tracking.delay_s", "negative", "a positive one")]),
        DeadlineError("digitizer", "no record", "no trigger came", "look at the cable"),
    ],
)
def test_an_error_comes_back_whole(error: Exception) -> None:
    again = pickle.loads(pickle.dumps(error))
    assert type(again) is type(error)
    assert str(again) == str(error)
    assert vars(again) == vars(error)
