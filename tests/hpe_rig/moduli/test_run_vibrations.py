"""Vibrations of stored runs: what cannot serve is left out and said so; places may have a strength of their own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import hpe_rig as hpe
from hpe_rig.medium import law_of
from hpe_rig.moduli import ModuliResult, Source, moduli_of, push_of
from hpe_rig.moduli.inversion import fit_medium
from hpe_rig.moduli.problem import Problem
from hpe_rig.moduli.run_vibrations import vibrations_of
from hpe_rig.moduli.vibration_model import APERTURE_SHAPE, Vibration
from hpe_rig.prediction import draw_speckle, resting_conditions, tracked_over_peak
from hpe_rig.store import StoredRun

TRUTH = {"shear_modulus_pa": 7.25e3, "viscosity_pa_s": 1.0}
FORCE = "simulation.specimen.force_density_n_per_m3"


def measured(path: Path, places_m: list[float], **values: object) -> hpe.Run:
    scene = hpe.load_scene("gelatin-moduli").with_(
        {
            "sweep.lateral_offset_m": places_m,
            "excitation.burst_count": 10,
            "processing.window_start_s": 40e-3,
            **values,
        }
    )
    return hpe.measure(scene, path=path)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> hpe.Run:
    return measured(tmp_path_factory.mktemp("places") / "run.h5", [1e-3, 2.25e-3, 3.5e-3, 14e-3])


def fitted(run: hpe.Run, stored: StoredRun) -> ModuliResult:
    return moduli_of([Source(run.path.name, run.scene, run.plan, stored)], ["voigt"])


def require_truth(result: ModuliResult) -> None:
    assert not result.best.excluded
    for name, true in TRUTH.items():
        assert abs(result.best.values[name] - true) < 3 * result.best.uncertainty[name]


@pytest.mark.slow
@pytest.mark.parametrize("count", [5, 1])
def test_the_heavy_tail_of_speckle_keeps_the_coverage_of_intervals(run: hpe.Run, count: int) -> None:
    """To first order: what moves a place is drawn as speckle has it, kurtosis 5 to 6, all else is normal.

    12 000 draws of scatterers, and the 2000 of the stated spread, leave sd uncertain by sqrt(5 / 4 / n): 1.0 and 2.5 %.
    """
    scene, found = run.scene.places[0], hpe.fit_moduli(run, laws=["voigt"]).vibrations
    places = [replace(found[0], lateral_m=at, position="") for at in (1e-3, 2.25e-3, 3.5e-3, 4.75e-3, 6e-3)][:count]
    problem = Problem.of(places, push_of([scene]), law_of("voigt"))
    jacobian = problem.jacobian(problem.start(np.array([np.log(7.25e3), np.arcsinh(1 / 0.05)]))[0])
    inverse, data = np.linalg.pinv(jacobian)[:2], jacobian[: problem.data_count]
    stated = np.linalg.norm(inverse, axis=1)
    resting = resting_conditions(scene)
    assert resting is not None
    rng, unit_m = np.random.default_rng(3), resting.tracking_width_m[0]
    speckle = draw_speckle(resting, rng, 12_000, lambda place: np.asarray(place[0] / unit_m))
    middle_m = unit_m * tracked_over_peak(resting, "coherent", speckle)
    own = rng.standard_normal((20_000, len(problem.nuisances)))
    for index, (kind, _, sigma_m) in enumerate(problem.nuisances):
        if kind == "lateral":
            stage_m = scene.tracking.offset_uncertainty_m * own[:, index]
            own[:, index] = (rng.choice(middle_m - middle_m.mean(), len(own)) + stage_m) / sigma_m
    noise = rng.standard_normal((len(own), problem.data_count))
    ratio = (own @ data[:, problem.free_count :].T + noise) @ inverse[:, : problem.data_count].T / stated
    assert np.all(np.abs(ratio.std(axis=0) - 1) < 0.1)
    assert np.all(np.abs(np.mean(np.abs(ratio) < 1, axis=0) - 0.683) < 0.03)
    assert np.all(np.abs(np.mean(np.abs(ratio) < 1.96, axis=0) - 0.95) < 0.015)


def from_result_file(run: hpe.Run, direct: Sequence[Vibration]) -> list[Vibration]:
    """Return the vibrations ``direct`` with phasors and covariances of the result file."""
    result = run.estimate()
    covariance = hpe.read_covariance(run.save(result))
    vibrations = []
    for row, vibration in enumerate(direct):
        # From the peak to the tracked displacement, by the stated ratio and lag of beam averaging.
        factor = np.array(
            [
                estimate.tracked_amplitude_m * np.exp(1j * estimate.tracked_phase_rad) / estimate.phasor_m
                for estimate in result.shots[row].estimates
            ]
        )
        influences_m = covariance.influences_m(["noise", "aliasing"])[row] * factor[:, None]
        selected = np.isin(covariance.frequency_hz[row], vibration.frequency_hz)
        states = np.stack([influences_m.real, influences_m.imag], axis=1)[selected]
        states = states.reshape(2 * vibration.frequency_hz.size, -1)
        phasor_m = (covariance.phasor_m[row] * factor)[selected]
        vibrations.append(replace(vibration, phasor_m=phasor_m, covariance_m2=states @ states.T))
    return vibrations


def test_the_covariance_of_the_result_file_is_that_of_the_vibrations(tmp_path: Path) -> None:
    """Tolerance: 1e-6, of variances that may lose 1e-8 when the file stores many media as few variables."""
    run = measured(tmp_path / "run.h5", [2.25e-3])
    direct, _ = vibrations_of([Source(run.path.name, run.scene, run.plan, run.stored)])
    for stored, vibration in zip(from_result_file(run, direct), direct, strict=True):
        scale_m2 = float(np.diag(vibration.covariance_m2).max())
        np.testing.assert_allclose(stored.phasor_m, vibration.phasor_m, rtol=1e-9)
        np.testing.assert_allclose(stored.covariance_m2, vibration.covariance_m2, rtol=0, atol=1e-6 * scale_m2)


@pytest.mark.slow
def test_moduli_from_the_covariance_of_the_result_file_are_those_of_the_run(run: hpe.Run, whole: ModuliResult) -> None:
    direct = whole
    from_file = fit_medium(from_result_file(run, direct.vibrations), push_of([run.scene.places[0]]))
    for name, value in direct.best.values.items():
        assert from_file.values[name] == pytest.approx(value, rel=1e-6)
        assert from_file.uncertainty[name] == pytest.approx(direct.best.uncertainty[name], rel=1e-6)


@pytest.fixture(scope="module")
def whole(run: hpe.Run) -> ModuliResult:
    """Return the moduli from all shots of the run."""
    return fitted(run, run.stored)


def test_harmonics_below_their_noise_are_omitted_and_named(whole: ModuliResult) -> None:
    result = whole
    require_truth(result)
    (line,) = result.omitted
    assert line.startswith("14 mm: ")
    assert "1000 Hz, less than 3 times its uncertainty" in line
    assert result.vibrations[-1].frequency_hz.size < 10
    assert f"omitted: {line}" in str(result)


def test_missing_and_untrusted_shots_are_omitted_and_named(run: hpe.Run, whole: ModuliResult) -> None:
    complete = np.array(run.stored.shot_complete)
    complete[1] = False
    harmed = replace(run.stored, shot_complete=complete, untrusted={2: "the settings changed"})
    result = fitted(run, harmed)
    require_truth(result)
    assert [one.label for one in result.vibrations] == ["1 mm", "14 mm"]
    said = "\n".join(result.omitted)
    for words in (
        "2.25 mm: shot 2, incomplete",
        "2.25 mm: no shot can be estimated",
        "3.5 mm: shot 3, untrusted: the settings changed",
    ):
        assert words in said
    assert result.best.uncertainty["shear_modulus_pa"] > whole.best.uncertainty["shear_modulus_pa"]


def test_a_run_without_a_usable_shot_is_refused_with_the_reasons(run: hpe.Run) -> None:
    nothing = replace(run.stored, shot_complete=np.zeros(4, bool))
    with pytest.raises(ValueError, match=r"no vibration exceeds its noise.*1 mm: shot 1, incomplete"):
        fitted(run, nothing)


def test_a_force_that_differs_between_offsets_needs_one_amplitude_for_each(run: hpe.Run, whole: ModuliResult) -> None:
    weak = [0.5, 0.5, 1.0, 1.0]
    scaled = [
        replace(one, phasor_m=factor * one.phasor_m, covariance_m2=factor**2 * one.covariance_m2)
        for factor, one in zip(weak, whole.vibrations, strict=True)
    ]
    push = push_of([run.scene.places[0]])
    assert fit_medium(scaled, push).excluded
    fit = fit_medium([one.with_free_gain() for one in scaled], push)
    assert not fit.excluded
    for name, true in TRUTH.items():
        assert abs(fit.values[name] - true) < 3 * fit.uncertainty[name]


@pytest.mark.slow
def test_runs_of_different_force_need_one_amplitude_for_each_offset(tmp_path: Path) -> None:
    strong = measured(tmp_path / "strong.h5", [1e-3, 2.25e-3])
    weak = measured(tmp_path / "weak.h5", [3.5e-3, 4.75e-3], **{FORCE: 3.5e6})
    common = hpe.fit_moduli(strong, weak, laws=["voigt"])
    assert common.best.excluded
    own = hpe.fit_moduli(strong, weak, laws=["voigt"], common_amplitude=False)
    require_truth(own)


def test_a_declared_aperture_pushes_with_its_intensity_and_two_transducers_with_a_gaussian() -> None:
    scene = hpe.load_scene("gelatin-moduli")
    one = scene.with_({"beams.transducer_diameter_m": 45e-3})
    two = one.with_({"beams.focus_depth_m": 70e-3, "beams.push_focus_depth_m": 60e-3})
    gaussian, aperture = push_of([scene]), push_of([one])
    assert push_of([two]) == gaussian
    assert (gaussian.force.across_m, gaussian.force.along_m) == ((0.34e-3,), 3.6e-3)
    assert (gaussian.shape_relative, aperture.shape_relative) == (0.0, APERTURE_SHAPE)
    assert [name for name, _ in aperture.force.weight_changes] == ["reach", "loss"]
