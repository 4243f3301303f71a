"""Phase reference: stated phases follow the stated time zero; amplitudes, errors and the fitted motion do not."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

import hpe_rig as hpe
from hpe_rig.plan import PhaseReference, phase_reference_of
from hpe_rig.processing import shots


def test_stated_phases_count_from_a_later_time_zero() -> None:
    reference = PhaseReference("the first pulse", delay_s=1e-3)
    # sin(2 pi f t + p) = sin(2 pi f (t - d) + p + 2 pi f d)
    assert reference.stated_rad(0.3, 100.0) == pytest.approx(0.3 + 0.2 * math.pi)
    assert reference.physical_rad(reference.stated_rad(3.0, 700.0), 700.0) == pytest.approx(3.0)


def test_without_a_delay_a_phase_stays_the_same_number() -> None:
    assert PhaseReference("the master trigger's edge").stated_rad(-math.pi, 123.4) == -math.pi


@pytest.mark.parametrize(("scene", "event"), [("table-1", "master trigger"), ("bovine-muscle", "first toneburst")])
def test_a_result_states_its_phase_reference_in_words(scene: str, event: str) -> None:
    assert event in phase_reference_of(hpe.load_scene(scene)).words


def test_another_time_zero_changes_the_stated_phases_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run = hpe.measure(hpe.load_scene("table-1"), path=tmp_path / "run.h5")
    (before,) = run.estimate("coherent").shots
    later = PhaseReference("the first pulse", delay_s=7e-4)
    monkeypatch.setattr(shots, "phase_reference_of", lambda scene, shot: later)
    (after,) = run.estimate("coherent").shots
    for one, other in zip(before.estimates, after.estimates, strict=True):
        shift_rad = math.remainder(
            other.tracked_phase_rad - one.tracked_phase_rad - 2 * math.pi * one.frequency_hz * 7e-4, 2 * math.pi
        )
        assert shift_rad == pytest.approx(0.0, abs=1e-12)
        assert other.tracked_phase_error_rad == pytest.approx(one.tracked_phase_error_rad, abs=1e-12)
        assert (other.tracked_amplitude_m, other.interval_95_rad) == (one.tracked_amplitude_m, one.interval_95_rad)
    assert before.motion is not None
    assert after.motion is not None
    np.testing.assert_allclose(after.motion.time_s, before.motion.time_s - 7e-4, atol=1e-15)
    np.testing.assert_allclose(after.motion.model_m, before.motion.model_m, rtol=1e-9, atol=1e-15)
