"""What ``check`` says of aliased harmonics, against the twin's own motion."""

import h5py
import numpy as np
import pytest

from hpe_rig.measurement.run import record_run
from hpe_rig.measurement.setup import prepare, prepare_text
from hpe_rig.prediction.linear_fit import fitted_over_true, fitted_over_true_by_estimator
from hpe_rig.prediction.text import aliasing_text
from hpe_rig.scene import scene_text
from hpe_rig.store.datasets import TRUE_HARMONICS


def plain_text(name):
    """Return a shipped scene that is fitted by least squares, without a prior of media."""
    text = scene_text(name)[1]
    assert "[processing]\n" in text
    return text.replace("[processing]\n", '[processing]\nharmonic = "least_squares"\n')


@pytest.mark.parametrize(("name", "largest"), [("bovine-muscle", 0.002), ("bovine-muscle-synchronous", 0.01)])
def test_with_the_medium_prior_aliasing_is_negligible(name, largest):
    setup = prepare(name)
    ratio = fitted_over_true(setup.scene.scene, setup.plan.shots[0])
    assert np.abs(ratio - 1).max() < largest
    paper = fitted_over_true_by_estimator(setup.scene.scene, setup.plan.shots[0], ("cross_spectrum",))[0]
    assert np.abs(paper - 1).max() > 5 * largest


def test_aliasing_of_synchronous_pulses_equals_that_of_the_twins_motion(tmp_path):
    """40 instants a burst period: the discrete transform of one period holds what is aliased.

    The twin's motion is that of the peak. Of aliased harmonics, less than a tenth of the wanted ones, the beam tracks
    up to a tenth less of the peak than of the wanted ones: 0.01.
    """
    setup = prepare_text("plain", plain_text("bovine-muscle-synchronous"))
    shot = setup.plan.shots[0]
    with h5py.File(record_run(setup, tmp_path / "run.h5")) as file:
        motion_m = file["truth/displacement_m"][0]
        in_phase_m, quadrature_m = (file[part][0] for part in TRUE_HARMONICS)
    period_m, time_s = motion_m[-40:], shot.timeline.sensing_s[-40:] - shot.timeline.time_zero_s
    angle = 2 * np.pi * np.outer(setup.scene.scene.wanted_frequencies_hz, time_s)
    aliased = (np.sin(angle) + 1j * np.cos(angle)) @ period_m / 20
    ratio = fitted_over_true(setup.scene.scene, shot)
    np.testing.assert_allclose(ratio, aliased / (in_phase_m + 1j * quadrature_m), atol=0.01)
    assert np.abs(ratio - 1).max() > 0.1


def test_check_prints_the_aliasing_of_a_delay_of_shifting_pulses():
    text = plain_text("bovine-muscle")
    later = prepare_text("later", text.replace("delay_s = 131e-6", "delay_s = 130e-6"))
    own = prepare_text("own", text)
    worse, good = (np.abs(fitted_over_true(s.scene.scene, s.plan.shots[0]) - 1).max() for s in (later, own))
    assert good < 0.02 < 0.05 < worse
    (line,) = aliasing_text(own.scene.scene, own.plan.shots[0])
    ratio = fitted_over_true(own.scene.scene, own.plan.shots[0])
    largest = 100 * np.abs(np.abs(ratio) - 1).max(), np.degrees(np.abs(np.angle(ratio)).max())
    assert "at most {:.2g} % and {:.2g} deg".format(*largest) in line


def test_a_real_bench_has_no_line_about_the_twins_medium():
    setup = prepare("bovine-muscle")
    scene, shot = setup.scene.scene, setup.plan.shots[0]
    assert [len(list(aliasing_text(scene, shot, simulated))) for simulated in (True, False)] == [1, 0]


@pytest.mark.parametrize("simulated", [True, False])
def test_a_scene_without_push_has_no_aliasing_line(simulated):
    setup = prepare("table-1")
    assert not list(aliasing_text(setup.scene.scene, setup.plan.shots[0], simulated))
