"""The truth is that of the wanted frequencies alone, whatever else moves."""

import numpy as np
import pytest

from hpe_rig.measurement.run import record_run
from hpe_rig.measurement.setup import prepare, prepare_text
from hpe_rig.processing.ground_truth import true_harmonics_m
from hpe_rig.runs.run import open_run
from hpe_rig.scene import shipped_scenes

TABLE_1 = shipped_scenes()["table-1"]


def moving(*components):
    tables = "".join(
        f"\n[[simulation.motion]]\nfrequency_hz = {hz}\namplitude_m = {metres}\nphase_rad = {phase}\n"
        for hz, metres, phase in components
    )
    # What moves by a quarter wavelength between pulses cannot be tracked: the truth is the truth.
    return prepare_text("moving", TABLE_1 + tables, refuse=False)


def unasked(time_s):
    raise AssertionError("a prescribed motion needs no fit")


@pytest.mark.parametrize("breathing_m", [1e-4, 1e-3, 5e-3])
def test_breathing_does_not_change_the_truth(breathing_m):
    setup = moving((1.2, breathing_m, 0.3))
    shot = setup.plan.shots[0]
    ((in_phase_m, quadrature_m),) = true_harmonics_m(setup.scene.scene, shot, unasked)
    assert np.hypot(in_phase_m, quadrature_m) == pytest.approx(1000e-9, rel=1e-12)


def test_components_of_one_frequency_add_up_with_their_phases():
    setup = moving((200.0, 1000e-9, np.pi / 2), (200.5, 1e-3, 0.0))
    ((in_phase_m, quadrature_m),) = true_harmonics_m(setup.scene.scene, setup.plan.shots[0], unasked)
    assert np.hypot(in_phase_m, quadrature_m) == pytest.approx(np.sqrt(2) * 1000e-9, rel=1e-12)


def test_the_phase_of_the_truth_is_that_of_the_motion_at_the_pulses(tmp_path):
    text = TABLE_1.replace("amplitude_m = 1000e-9", "amplitude_m = 1000e-9\nphase_rad = 0.7")
    text = text.replace("pulse_count = 101", "pulse_count = 101\ndelay_s = 1.1e-3")
    run = open_run(record_run(prepare_text("late", text), tmp_path / "late.h5"))
    shot, truth = run.plan.shots[0], run.stored.true_displacement_m
    ((in_phase_m, quadrature_m),) = truth.harmonics_m(0, 1)
    angle = 2 * np.pi * 200.0 * (shot.timeline.sensing_s - shot.timeline.time_zero_s)
    # instants are whole picoseconds: 2 pi 200 Hz times 1 ps of a phase
    assert in_phase_m * np.sin(angle) + quadrature_m * np.cos(angle) == pytest.approx(truth[0], abs=1e-6 * 2e-9)


def test_nothing_is_true_where_nothing_moves():
    text = TABLE_1.replace("frequencies_hz = [200.0]", "frequencies_hz = [200.0, 300.0]")
    setup = prepare_text("two", text)
    found = true_harmonics_m(setup.scene.scene, setup.plan.shots[0], unasked)
    np.testing.assert_allclose(np.hypot(*found.T), [1000e-9, 0.0], rtol=1e-12, atol=0)


def test_tonebursts_do_not_leak_into_a_frequency_that_they_do_not_drive():
    """Driven harmonics of a micrometre; 130 Hz fits no whole number of times into the burst periods of the window."""
    setup = prepare("bovine-muscle-synchronous", refuse=False)
    scene, shot = setup.scene.scene, setup.plan.shots[0]
    asked = {"frequencies_hz": (130.0, 200.0)}
    other = scene.model_copy(update={"processing": scene.processing.model_copy(update=asked)})

    def motion_m(time_s):
        angle = 2 * np.pi * np.outer(time_s - shot.timeline.time_zero_s, 100.0 * np.arange(1, 21))
        return 1e-6 * np.sin(angle).sum(axis=1)

    idle, driven = np.hypot(*true_harmonics_m(other, shot, motion_m).T)
    assert idle < 1e-12
    assert driven == pytest.approx(1e-6, rel=1e-6)


def test_a_medium_that_creeps_leaves_no_trace_in_the_truth():
    """A ramp has a part at every harmonic; over whole periods it is told by how far each lies beyond the one before."""
    setup = prepare("bovine-muscle-synchronous", refuse=False)
    scene, shot = setup.scene.scene, setup.plan.shots[0]

    def motion_m(time_s):
        t = time_s - shot.timeline.time_zero_s
        return 800e-9 * np.sin(2 * np.pi * 100.0 * t + 0.3) + 200e-9 * np.sin(2 * np.pi * 4200.0 * t)

    still, creeping = (
        true_harmonics_m(scene, shot, lambda time_s, v=v: motion_m(time_s) + v * time_s) for v in (0.0, 1e-4)
    )
    np.testing.assert_allclose(np.hypot(*still[0]), 800e-9, rtol=1e-9)
    np.testing.assert_allclose(creeping, still, rtol=0, atol=1e-15)
