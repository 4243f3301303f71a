"""The prior of a rigid sphere that is pushed in place of the medium: its formula, what it removes, what it states."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from sphere import sphere_phasors

import hpe_rig as hpe
from hpe_rig.bench import contradictions
from hpe_rig.medium import RigidSphere, medium_ensemble
from hpe_rig.medium.ensemble import prior_modulus
from hpe_rig.moduli import push_of
from hpe_rig.runs import Run
from hpe_rig.scene import SettingsError
from sim_backend.motion.sphere import sphere_response
from sim_backend.settings import Sphere

QUIET = {
    "simulation.receiver.snr_db": 80.0,
    "simulation.instruments.trigger_jitter_s": 0.0,
    "excitation.burst_count": 10,
}
STEEL = RigidSphere(0.795e-3, 7650.0)


def test_the_sphere_of_the_prior_moves_as_the_twins_does() -> None:
    s = np.asarray(2j * np.pi * np.geomspace(100.0, 4e4, 30))
    modulus_pa = 7250.0 + s * 1.0
    its = sphere_response(Sphere(radius_m=0.795e-3, density_kg_per_m3=7650.0), modulus_pa, 1000.0, s)
    assert STEEL.response(modulus_pa, 1000.0, s) == pytest.approx(its, rel=1e-12)


def test_between_its_nodes_a_members_resonance_is_kept() -> None:
    hz = 100.0 * np.arange(1.0, 401.0)
    s = np.asarray(2j * np.pi * hz)
    found = medium_ensemble(STEEL, 100.0, 4e4)
    exact = STEEL.response(prior_modulus(s, 240), 1000.0, s)
    off = np.linalg.norm(found.tracked @ found.interpolation(hz).T - exact, axis=1) / np.linalg.norm(exact, axis=1)
    assert off.max() < 2e-4
    assert np.array_equal(found.tracked, found.peak)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    scene = hpe.load_scene("steel-sphere").with_(QUIET)
    return hpe.measure(scene, path=tmp_path_factory.mktemp("sphere") / "run.h5")


def errors_m(run: Run, **changed: object) -> tuple[NDArray[np.complex128], NDArray[np.float64]]:
    """Return complex errors (frequency,) of the tracked values and their u, root sum of squares of both quadratures."""
    scene = run.scene.with_({name.replace("__", "."): value for name, value in changed.items()})
    estimates = replace(run, scene=scene).estimate("coherent").shots[0].estimates
    phasor = np.array([each.tracked_amplitude_m * np.exp(1j * each.tracked_phase_rad) for each in estimates])
    true = np.array([(each.true_amplitude_m or 0) * np.exp(1j * (each.true_phase_rad or 0)) for each in estimates])
    u = [
        np.hypot(each.tracked_amplitude_uncertainty_m, each.tracked_phase_uncertainty_rad * each.tracked_amplitude_m)
        for each in estimates
    ]
    return phasor - true, np.array(u)


def test_what_aliases_is_the_error_without_a_prior_and_next_to_nothing_with_it(run: Run) -> None:
    bare, _ = errors_m(run, sphere=None)
    with_prior, u_m = errors_m(run)
    # The harmonic f_prf - f, and those beyond it: the burst moves a sphere by 1/f^2 there, 16 nm for 137 at 1 kHz.
    assert np.abs(bare[-1]) > 8e-9
    assert np.abs(bare).max() > 10 * np.abs(with_prior).max()
    assert np.all(np.abs(with_prior) < 3 * u_m)


def test_without_noise_the_error_of_least_squares_is_what_the_closed_form_has_alias_at_the_pulses(run: Run) -> None:
    bare, _ = errors_m(run, sphere=None)
    met, steady = (sphere_phasors(run.scene, 7250.0, 1.0, sampled) for sampled in (True, False))
    # 0.1 % of the 1 um by the ends of the gate and what is left of the start
    assert np.abs(bare - (met - steady)).max() < 1e-9


def test_least_squares_include_aliasing_in_u(run: Run) -> None:
    off, u_m = errors_m(run, processing__harmonic="least_squares")
    assert np.abs(off[-1]) > 8e-9
    assert np.all(np.abs(off) < 3 * u_m)


def test_a_run_of_a_sphere_has_no_gates_over_depth(run: Run) -> None:
    with pytest.raises(SettingsError, match="gates over depth measure the medium"):
        run.with_profile(1e-3)


def test_a_scene_has_a_sphere_or_beams_and_check_reports_a_different_one_on_the_twin() -> None:
    scene = hpe.load_scene("steel-sphere")
    assert scene.without_prior is None
    assert not list(contradictions(scene))
    other = scene.with_({"sphere.radius_m": 1e-3})
    assert [key for key, *_ in contradictions(other)] == ["sphere.radius_m"]
    undeclared = scene.with_({"sphere": None})
    assert list(contradictions(undeclared)) == [("sphere.radius_m", "0", "0.000795")]
    assert undeclared.without_prior == "the scene has no [beams]"
    with pytest.raises(SettingsError, match=r"\[sphere\] moves as a whole"):
        scene.with_({"beams": {"excitation_width_m": [1e-3] * 3, "tracking_width_m": [1e-3] * 3}})
    with pytest.raises(SettingsError, match="gates over depth measure the medium"):
        scene.with_({"processing.gate_profile_step_m": 1e-3})
    with pytest.raises(SettingsError, match="a rigid sphere moves") as refused:
        push_of([scene])
    assert "[beams]" not in str(refused.value)
