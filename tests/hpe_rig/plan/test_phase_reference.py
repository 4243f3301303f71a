"""Phase reference: stated phases follow the stated time zero; amplitudes, errors and the fitted motion do not."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

import hpe_rig as hpe
from hpe_rig.bench import read_bench
from hpe_rig.plan import PhaseReference, make_plan, phase_definition
from hpe_rig.prediction import time_base
from hpe_rig.processing import shots


def test_stated_phases_count_from_a_later_time_zero() -> None:
    reference = PhaseReference(delay_s=1e-3)
    # sin(2 pi f t + p) = sin(2 pi f (t - d) + p + 2 pi f d)
    assert reference.stated_rad(0.3, 100.0) == pytest.approx(0.3 + 0.2 * math.pi)
    assert reference.physical_rad(reference.stated_rad(3.0, 700.0), 700.0) == pytest.approx(3.0)


def test_without_a_delay_a_phase_stays_the_same_number() -> None:
    assert PhaseReference().stated_rad(-math.pi, 123.4) == -math.pi


@pytest.mark.parametrize(("scene", "event"), [("table-1", "master trigger"), ("bovine-muscle", "first toneburst")])
def test_a_result_states_its_phase_reference_in_words(scene: str, event: str) -> None:
    assert event in phase_definition(hpe.load_scene(scene))


def test_another_time_zero_changes_the_stated_phases_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run = hpe.measure(hpe.load_scene("table-1"), path=tmp_path / "run.h5")
    (before,) = run.estimate("coherent").shots
    later = PhaseReference(delay_s=7e-4)
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


RATE_ERROR, DELAY_S = 1.3e-4, 0.9


def test_clocks_that_differ_hardly_change_phases_from_the_first_pulse(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """From the first pulse the rate error acts over half the train, 12.5 ms, from the master trigger over 0.9 s."""
    scene = hpe.load_scene("table-1").with_(
        {
            "tracking.delay_s": DELAY_S,
            "processing.frequency_accuracy": 1e-4,
            "simulation.instruments.clock_error.tracking_train": 1 / (1 + RATE_ERROR) - 1,
        }
    )
    run = hpe.measure(scene, path=tmp_path / "run.h5")
    timeline = run.plan.shots[0].timeline
    start_s, mean_s = float(timeline.sensing_s[0]), float(timeline.sensing_s.mean())
    references = PhaseReference(), PhaseReference(start_s)
    results = []
    for reference in references:
        monkeypatch.setattr(shots, "phase_reference_of", lambda scene, shot, reference=reference: reference)
        results += run.estimate("coherent").shots
    (master,), (first_pulse,) = (result.estimates for result in results)
    u_rate, hz = results[0].frequency_error_uncertainty or 0.0, master.frequency_hz
    for estimate, lever_s in ((master, mean_s), (first_pulse, mean_s - start_s)):
        (clocks,) = (item for item in estimate.budget if item.source == "time base")
        # The noise of 101 pulses makes the fit depend on the rate error by a few percent of the shorter lever.
        assert clocks.phase_rad == pytest.approx(2 * math.pi * hz * u_rate * lever_s, rel=0.05)
        assert abs(estimate.tracked_phase_error_rad or math.inf) < 3 * estimate.phase_uncertainty_rad
    assert first_pulse.true_phase_rad == pytest.approx(
        math.remainder(master.true_phase_rad + 2 * math.pi * hz * start_s * (1 + RATE_ERROR), 2 * math.pi), abs=1e-9
    )
    # The covariance over frequencies states the same uncertainty as the budget.
    influence_m = [item.influence_m for item in results[1].influences if item.source == "time base"]
    turned_m = np.hstack(influence_m)[0] * np.exp(-1j * first_pulse.tracked_phase_rad)
    assert np.linalg.norm(turned_m.imag) / first_pulse.amplitude_m == pytest.approx(clocks.phase_rad, rel=1e-6)
    # The prediction has the same lever; it knows the accuracies alone, which the rate error's u hardly falls below.
    monkeypatch.setattr(time_base, "phase_reference_of", lambda scene, shot: references[1])
    shot = make_plan(scene, read_bench().bench).shots[0]
    _, predicted_u, phase_u_rad = time_base.time_base_uncertainty(scene, read_bench().bench, shot)
    assert phase_u_rad[0] == pytest.approx(2 * math.pi * hz * (mean_s - start_s) * predicted_u, rel=1e-9)
