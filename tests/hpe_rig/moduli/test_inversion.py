"""Inversion for moduli on the twin's spectra: exact without noise, true uncertainties with it, wrong laws found out."""

from __future__ import annotations

import itertools
import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hpe_rig.medium import PushForce
from hpe_rig.medium.material_laws import LAWS
from hpe_rig.moduli.inversion import bound, compare_media, fit_medium
from hpe_rig.moduli.problem import Problem
from hpe_rig.moduli.vibration_model import Push, Vibration
from sim_backend.motion.field import field_transfer
from sim_backend.settings import Specimen

FREQUENCY_HZ = np.arange(100.0, 1001.0, 100.0)
PUSH = Push(PushForce((0.34e-3,), 3.6e-3), 100.0, 100e-6)
FIVE = (1e-3, 2.25e-3, 3.5e-3, 4.75e-3, 6e-3)
NOISE_M = 0.7e-9
SPECKLE = 0.02


def vibrations(
    specimen: Specimen,
    places_m: Sequence[float],
    rng: np.random.Generator | None = None,
    push: Push = PUSH,
    frequency_hz: np.ndarray = FREQUENCY_HZ,
) -> list[Vibration]:
    """Return the twin's motion at ``places_m``, 800 nm at 100 Hz on the axis, with noise and speckle where drawn."""
    width = (push.force.across_m[0], push.force.across_m[0], push.force.along_m)
    field = field_transfer(specimen, width, np.array([0.0, *places_m]), np.zeros(1), frequency_hz)[:, :, 0]
    motion = field * push.spectrum(frequency_hz)[:, None]
    motion *= 800e-9 / abs(motion[0, 0])
    found = []
    for place, lateral_m in enumerate(places_m):
        phasor = motion[:, place + 1].copy()
        if rng is not None:
            phasor *= 1 + SPECKLE * complex(*rng.standard_normal(2))
            phasor += NOISE_M * rng.standard_normal((frequency_hz.size, 2)).view(complex)[:, 0]
        covariance = NOISE_M**2 * np.eye(2 * frequency_hz.size)
        speckle = {"gain_uncertainty": SPECKLE, "phase_uncertainty_rad": SPECKLE}
        found.append(Vibration(f"{lateral_m * 1e3:g} mm", frequency_hz, phasor, covariance, lateral_m, **speckle))
    return found


@pytest.mark.parametrize("places", [FIVE, (0.0,), pytest.param((0.0, 20e-3), marks=pytest.mark.slow)])
@pytest.mark.parametrize(
    "medium",
    [
        (9e3, 2.0),
        *(pytest.param(each, marks=pytest.mark.slow) for each in ((4e3, 1.0), (13.5e3, 1.0), (12e3, 5.7))),
        pytest.param((0.6e3, 0.05), marks=pytest.mark.slow),
        pytest.param((3e5, 20.0), marks=pytest.mark.slow),
    ],
)
def test_noise_free_vibrations_give_the_moduli_to_1e_6(medium: tuple[float, float], places: tuple[float, ...]) -> None:
    specimen = Specimen(shear_modulus_pa=medium[0], shear_viscosity_pa_s=medium[1])
    fit = fit_medium(vibrations(specimen, places), PUSH)
    assert fit.values["shear_modulus_pa"] == pytest.approx(medium[0], rel=1e-6)
    assert fit.values["viscosity_pa_s"] == pytest.approx(medium[1], rel=1e-6)
    assert fit.chi_square < 1e-6
    assert not fit.at_limit


HELD = json.loads((Path(__file__).parents[2] / "fixtures" / "held_shear_field.json").read_text(encoding="utf-8"))


@pytest.mark.parametrize(
    "medium",
    [HELD["media"][0], *(pytest.param(medium, marks=pytest.mark.slow) for medium in HELD["media"][1:])],
    ids=lambda medium: f"{medium['shear_modulus_pa']:g} Pa",
)
def test_spectra_by_an_independent_quadrature_give_the_moduli_to_1e_6(medium: dict[str, Any]) -> None:
    """scripts/validation/held_shear_field.py uses none of our code: converged to 2e-11 of the largest amplitude."""
    push = Push(
        PushForce(tuple(HELD["width_m"][:1]), HELD["width_m"][1]), HELD["burst_rate_hz"], HELD["burst_length_s"]
    )
    assert push == PUSH
    phasors = np.array(medium["real_m"]) + 1j * np.array(medium["imaginary_m"])
    covariance = NOISE_M**2 * np.eye(2 * FREQUENCY_HZ.size)
    places = [
        Vibration(f"{place_m:g} m", FREQUENCY_HZ, phasor, covariance, place_m)
        for place_m, phasor in zip(HELD["lateral_m"], phasors, strict=True)
    ]
    fit = fit_medium(places, PUSH)
    for name, value in fit.values.items():
        assert value == pytest.approx(medium[name], rel=1e-6)
    assert fit.chi_square < 1e-6


@pytest.mark.parametrize(
    ("law", "settings"),
    [
        pytest.param(
            "zener",
            {"shear_modulus_pa": 5e3, "shear_viscosity_pa_s": 3.0, "branch_modulus_pa": 12e3},
            marks=pytest.mark.slow,
        ),
        ("power_law", {"shear_modulus_pa": 8e3, "power": 0.25}),
        pytest.param("maxwell", {"shear_modulus_pa": 9e3, "shear_viscosity_pa_s": 8.0}, marks=pytest.mark.slow),
    ],
)
def test_every_law_is_recovered_and_the_most_likely(law: str, settings: dict[str, float]) -> None:
    specimen = Specimen(medium=law, **settings)  # type: ignore[arg-type]
    names = {"viscosity_pa_s": "shear_viscosity_pa_s"}
    fit = fit_medium(vibrations(specimen, FIVE), PUSH, law)  # type: ignore[arg-type]
    for name, value in fit.values.items():
        assert value == pytest.approx(settings[names.get(name, name)], rel=1e-6)
    fits, probability = compare_media(vibrations(specimen, FIVE[::2], np.random.default_rng(3)), PUSH)
    assert fits[0].law == law
    assert probability[0] > 0.99
    assert not fits[0].excluded
    assert next(each for each in fits if each.law == "voigt").excluded


def test_voigt_data_do_not_exclude_a_zener_medium_that_includes_it() -> None:
    specimen = Specimen(shear_modulus_pa=9e3, shear_viscosity_pa_s=2.0)
    fits, _ = compare_media(vibrations(specimen, FIVE, np.random.default_rng(4)), PUSH, ("voigt", "zener"))
    assert not any(each.excluded for each in fits)
    assert fits[0].law == "voigt"  # the simpler of two that fit as well


@pytest.mark.parametrize(
    ("places", "trials"),
    [pytest.param(FIVE, 40, marks=pytest.mark.slow), pytest.param((0.0,), 40, marks=pytest.mark.slow), ((0.0,), 4)],
)
def test_intervals_hold_the_truth_as_often_as_they_say(places: tuple[float, ...], trials: int) -> None:
    """Draws of noise, speckle and widths: z^2 has mean 1 within 3 sqrt(2/trials), the misfit a mean of 1."""
    rng, truth = np.random.default_rng(5), np.array([9e3, 2.0])
    specimen = Specimen(shear_modulus_pa=truth[0], shear_viscosity_pa_s=truth[1])
    z, chi_square = [], []
    for _ in range(trials):
        wide, deep = np.exp(0.05 * rng.standard_normal(2))
        drawn = Push(PushForce((0.34e-3 * wide,), 3.6e-3 * deep), 100.0, 100e-6)
        fit = fit_medium(vibrations(specimen, places, rng, drawn), PUSH)
        z.append((np.array(list(fit.values.values())) - truth) / np.array(list(fit.uncertainty.values())))
        chi_square.append(fit.chi_square / fit.freedom)
    nev = np.mean(np.square(z), axis=0)
    assert np.all(np.abs(nev - 1) < 3 * np.sqrt(2 / trials))
    assert abs(np.mean(chi_square) - 1) < 4 * np.sqrt(2 / fit.freedom / trials)


def test_the_stated_uncertainty_is_the_bound_at_the_truth() -> None:
    specimen = Specimen(shear_modulus_pa=9e3, shear_viscosity_pa_s=2.0)
    exact = vibrations(specimen, FIVE)
    fit = fit_medium(exact, PUSH)
    np.testing.assert_allclose(bound(exact, PUSH, "voigt", (9e3, 2.0)), fit.covariance, rtol=1e-4)
    u_mu1, u_mu2 = np.sqrt(np.diag(fit.covariance)) / [9e3, 2.0]
    # docs/explanation/moduli.md: 0.33 and 0.75 % with five places, widths known to 5 %
    assert u_mu1 == pytest.approx(0.0033, abs=2e-4)
    assert u_mu2 == pytest.approx(0.0075, abs=3e-4)


def test_contributions_equal_the_growth_of_the_uncertainty_without_the_data() -> None:
    specimen = Specimen(shear_modulus_pa=9e3, shear_viscosity_pa_s=2.0)
    fit = fit_medium(vibrations(specimen, FIVE), PUSH)
    for part in (*fit.by_place, *fit.by_frequency):
        assert min(part.growth) >= 1 - 1e-9
    left = fit_medium(vibrations(specimen, FIVE[1:]), PUSH)
    grown = [left.uncertainty[name] / fit.uncertainty[name] for name in fit.values]
    # what was known of the place itself stays behind as data of nothing else
    np.testing.assert_allclose(fit.by_place[0].growth, grown, rtol=1e-6)


def test_a_wrong_width_is_adjusted_if_uncertain_and_excluded_if_certain() -> None:
    specimen = Specimen(shear_modulus_pa=9e3, shear_viscosity_pa_s=2.0)
    narrow = Push(PushForce((0.27e-3,), 3.6e-3), 100.0, 100e-6, width_uncertainty=(0.3, 0.3))
    measured = vibrations(specimen, FIVE, np.random.default_rng(6))
    fit = fit_medium(measured, narrow)
    assert abs(fit.values["shear_modulus_pa"] - 9e3) < 3 * fit.uncertainty["shear_modulus_pa"]
    assert not fit.excluded
    assert fit.adjusted["across"] == pytest.approx(np.log(0.34 / 0.27) / 0.3, abs=0.2)
    sure = Push(PushForce((0.17e-3,), 1.8e-3), 100.0, 100e-6, width_uncertainty=(1e-3, 1e-3))
    assert fit_medium(measured, sure).excluded


def test_too_few_data_are_refused() -> None:
    specimen = Specimen(shear_modulus_pa=9e3, shear_viscosity_pa_s=2.0)
    (one,) = vibrations(specimen, (1e-3,), frequency_hz=FREQUENCY_HZ[:1])
    with pytest.raises(ValueError, match="measure at more lateral offsets or frequencies"):
        fit_medium([one], PUSH)
    with pytest.raises(ValueError, match="no vibration"):
        fit_medium([], PUSH)


def test_an_offset_beyond_the_tested_field_is_refused() -> None:
    specimen = Specimen(shear_modulus_pa=9e3, shear_viscosity_pa_s=2.0)
    with pytest.raises(ValueError, match=r"25 mm: the field is tested to 20 mm"):
        fit_medium(vibrations(specimen, (1e-3, 25e-3)), PUSH)


def at_depths(
    medium: tuple[float, float], depths_m: Sequence[float], frequency_hz: np.ndarray = FREQUENCY_HZ[::3]
) -> list[Vibration]:
    """Return the twin's motion at two places and several depths, its force everywhere at once, without noise."""
    specimen = Specimen(shear_modulus_pa=medium[0], shear_viscosity_pa_s=medium[1])
    places_m, width = np.array([0.0, 1e-3, 4e-3]), (0.34e-3, 0.34e-3, 3.6e-3)
    covariance = NOISE_M**2 * np.eye(2 * frequency_hz.size)
    known = {"gain_uncertainty": SPECKLE, "phase_uncertainty_rad": SPECKLE, "area_uncertainty": 0.6}
    known |= {"lateral_uncertainty_m": 35e-6, "stage_uncertainty_m": 20e-6, "tracking_m2": (3e-9, 1e-7)}
    field = field_transfer(specimen, width, places_m, np.abs(depths_m), frequency_hz)
    field = field * (PUSH.spectrum(frequency_hz)[:, None, None] * 800e-9 / abs(field[0, 0, 0]))
    found = []
    for i, j in itertools.product(range(1, 3), range(len(depths_m))):
        x, z = float(places_m[i]), depths_m[j]
        there = {"position": f"{x}", "axial_m": z, "travel_s": z / 1540, "axial_uncertainty_m": 1e-4 if z else 0.0}
        label = f"{x * 1e3:g} mm, {z * 1e3:+g} mm"
        found.append(Vibration(label, frequency_hz, field[:, i, j], covariance, x, **there, **known))
    return found


def test_slopes_with_gates_over_depth_equal_finite_differences() -> None:
    # a force of several Gaussians of which something is not known, as an aperture's
    weight_changes = ("reach", ((0.1, 0.3), (0.0, 0.2))), ("loss", ((0.05, 0.0), (0.0, -0.1)))
    force = PushForce((0.34e-3, 0.8e-3), 3.6e-3, (-1e-3, 4e-3), ((0.7, 0.2), (0.1, 0.2)), weight_changes)
    motion = at_depths((9e3, 2.0), (0.0, 2e-3))
    problem = Problem.of(motion, replace(PUSH, force=force), LAWS["voigt"])
    coordinates = [one.to_coordinate(value) for one, value in zip(problem.law.parameters, (9e3, 2.0), strict=True)]
    unknown = problem.start(np.array(coordinates))[0]
    kinds = [kind for kind, _, _ in problem.nuisances]
    assert {"stage", "travel", "axial", "reach", "loss"} <= set(kinds)
    # one unknown a place for the stage, whatever the number of depths
    assert kinds.count("stage") == 2
    jacobian = problem.jacobian(unknown)
    for i in range(unknown.size):
        step = np.zeros(unknown.size)
        step[i] = 1e-5
        slope = (problem.residual(unknown + step) - problem.residual(unknown - step)) / 2e-5
        np.testing.assert_allclose(jacobian[:, i], slope, atol=2e-6 * np.abs(jacobian[:, i]).max())


def test_depths_share_the_error_of_the_stage() -> None:
    """Three depths share the stage's error: they tell more than one, and less than if each had an error of its own."""
    # a stage so bad that little else counts
    deep = [replace(one, stage_uncertainty_m=0.3e-3) for one in at_depths((9e3, 2.0), (-1e-3, 0.0, 1e-3))]
    alone = [replace(one, position="") for one in deep]
    flat = [one for one in deep if not one.axial_m]
    shared, independent, one = (np.sqrt(bound(each, PUSH, "voigt", (9e3, 2.0))[0, 0]) for each in (deep, alone, flat))
    assert independent < 0.9 * shared
    assert shared < one
    fit = fit_medium(deep, PUSH)
    assert abs(fit.values["shear_modulus_pa"] - 9e3) < fit.uncertainty["shear_modulus_pa"]
    assert "stage at 4 mm" in fit.adjusted
