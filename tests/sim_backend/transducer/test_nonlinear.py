"""Nonlinear propagation against closed forms, against the linear field, and what the twin makes of it."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.special import jv

from sim_backend.motion import force_scale
from sim_backend.settings import Beams, Propagation, SimulationSettings, Specimen, Transducer
from sim_backend.transducer import (
    Accuracy,
    Beam,
    Layer,
    Push,
    advance,
    bowl_pressure,
    nonlinear_beam,
    path,
    push_of,
    water_output,
    wave_number,
)
from sim_backend.transducer.push import equivalent_force

FREQUENCY_HZ, SPEED, SOURCE_PA = 3e6, 1540.0, 1e6
LOSSLESS = Layer(math.inf, SPEED, 1000.0, 4.0, 1e-12, 2.0)
BOWL = Transducer()


def plane_wave(harmonics: int, sigma: float) -> tuple[np.ndarray, np.ndarray]:
    """Harmonics of a sine after ``sigma`` shock formation lengths, and the intensity lost."""
    start = np.zeros((1, harmonics), dtype=np.complex128)
    start[0, 0] = -1j * SOURCE_PA
    length_m = SPEED**3 * 1000.0 / (4.0 * 2 * np.pi * FREQUENCY_HZ * SOURCE_PA)
    found, lost = advance(start, sigma * length_m, FREQUENCY_HZ, LOSSLESS)
    return found[0] / SOURCE_PA, lost


def test_before_the_shock_a_plane_wave_is_fubinis() -> None:
    n = np.arange(1, 7)
    found, _ = plane_wave(48, 0.5)
    np.testing.assert_allclose(found[:6] * 1j, 2 * jv(n, 0.5 * n) / (0.5 * n), atol=1e-8)


@pytest.mark.parametrize("sigma", [1.5, 3.0])
def test_behind_the_shock_a_plane_wave_is_blackstocks(sigma: float) -> None:
    """Weak shock theory (1966); 64 harmonics leave 1e-4 of the source (scripts/validation/nonlinear_push.py)."""
    n = np.arange(1, 6)
    shock = np.pi
    for _ in range(200):
        shock -= (shock - sigma * np.sin(shock)) / (1 - sigma * np.cos(shock))
    node, weight = np.polynomial.legendre.leggauss(200)
    x = shock + (np.pi - shock) * (node + 1) / 2
    waves = np.cos(n[:, None] * (x - sigma * np.sin(x))) @ weight * (np.pi - shock) / 2
    expected = 2 / (n * np.pi) * np.sin(shock) + 2 / (n * np.pi * sigma) * waves
    found, _ = plane_wave(64, sigma)
    np.testing.assert_allclose(np.abs(found[:5]), expected, atol=1e-4)


def test_the_loss_of_a_shock_is_the_missing_energy() -> None:
    found, lost = plane_wave(48, 2.0)
    gone = (1 - (np.abs(found) ** 2).sum()) * SOURCE_PA**2 / (2 * LOSSLESS.impedance)
    # Fourth order in steps of at most a radian of the last harmonic, which itself is damped.
    assert lost[0] == pytest.approx(gone, rel=1e-3)
    assert lost[0] > 0.3 * SOURCE_PA**2 / (2 * LOSSLESS.impedance)


def test_a_weak_beam_is_the_linear_field_to_1e_6_of_its_focus() -> None:
    beam = nonlinear_beam(
        BOWL, [LOSSLESS], FREQUENCY_HZ, 1.0, Accuracy(harmonics=4, relative_step=0.2, min_step_m=2e-3)
    )
    there = beam.depth_m > 50e-3
    axial_m = beam.depth_m[there] - BOWL.focal_length_m
    exact = bowl_pressure(BOWL, 2 * np.pi * FREQUENCY_HZ / SPEED + 0j, np.zeros(1), axial_m)[:, 0]
    assert np.abs(np.abs(beam.harmonic_pa[there, 0]) - np.abs(exact)).max() < 1e-6 * np.abs(exact).max()


def test_an_interface_and_attenuation_act_as_on_a_plane_wave() -> None:
    heavy = replace(LOSSLESS, density_kg_per_m3=1500.0, attenuation_db_per_cm_mhz=0.5, attenuation_power=1.0)
    coarse = Accuracy(harmonics=4, relative_step=0.2, min_step_m=2e-3)
    water = replace(LOSSLESS, thickness_m=60e-3)
    plain = nonlinear_beam(BOWL, [water, LOSSLESS], FREQUENCY_HZ, 1.0, coarse)
    layered = nonlinear_beam(BOWL, [water, heavy], FREQUENCY_HZ, 1.0, coarse)
    focus = [np.interp(70e-3, each.depth_m, np.abs(each.harmonic_pa[:, 0])) for each in (plain, layered)]
    loss = 10 ** (-0.5 * 3 * 1.0 / 20) * 2 * 1.5 / 2.5
    # The bowl's waves come at up to 18.8 degrees: their way is up to 5.6 % longer, and so is the loss in dB.
    longer = 10 ** (-0.5 * 3 * 0.056 / 20)
    assert longer * loss < focus[1] / focus[0] < loss


def test_a_weak_push_is_equivalent_to_its_own_gaussian() -> None:
    """A beam that is a Gaussian force on the nodes gives back that force."""
    specimen = Specimen(preset="bovine_muscle")
    layers = path(specimen, Propagation(), SPEED, 70e-3)
    coarse = Accuracy(harmonics=4, relative_step=0.1, min_step_m=0.4e-3)
    beam = nonlinear_beam(BOWL, layers, FREQUENCY_HZ, 1e3, coarse)
    depth_m, lateral_m, volume, _ = beam.force_at
    width_m = (0.34e-3, 0.34e-3, 3.6e-3)
    gaussian = 5.0 * np.exp(-0.5 * ((lateral_m / width_m[0]) ** 2 + ((depth_m - 70e-3) / width_m[2]) ** 2))
    own = replace(beam, force_at=np.stack([depth_m, lateral_m, volume, gaussian]))
    assert equivalent_force(own, 70e-3, width_m, layers[0].thickness_m) == pytest.approx(5.0, rel=1e-12)
    # The bowl's own intensity has these widths at half maximum; its flanks and side lobes push as well.
    linear = equivalent_force(beam, 70e-3, width_m, layers[0].thickness_m)
    assert 1.0 < linear / (beam.heat_w_per_m3[beam.depth_m > 57.5e-3].max() / SPEED) < 1.6


def cubic() -> Push:
    """A push whose force grows as the cube of the pressure."""
    surface_pa = np.geomspace(1e4, 1e6, 7)
    return Push(surface_pa, 1e-9 * surface_pa**3, *[surface_pa] * 5)


def test_the_force_over_drive_is_the_tables_and_linear_below_it() -> None:
    push = cubic()
    assert push.surface_for(1e6) == pytest.approx(1e5, rel=1e-9)
    assert push.exponent(1e6) == pytest.approx(1.5, rel=1e-6)
    share = push.relative_force(np.array([0.0, 0.01, 0.5, 1.0, 20.0]), 1e6)
    # From 1e4 Pa down as the square, above 1e6 Pa with the last slope.
    np.testing.assert_allclose(share, [0, 1e-3 * 1e-2, 0.125, 1.0, 8000.0], rtol=1e-6)


def test_a_force_that_no_drive_makes_is_refused_with_the_largest() -> None:
    surface_pa = np.geomspace(1e4, 1e6, 7)
    # Shocks take all that more pressure adds beyond 1e5 Pa.
    saturated = Push(surface_pa, 1e-2 * np.minimum(surface_pa, 1e5) ** 2, *[surface_pa] * 5)
    assert saturated.surface_for(1e6) == pytest.approx(1e4, rel=1e-9)
    with pytest.raises(ValueError, match=r"no drive makes a force density of 1e\+09 N/m\^3 .* ends at 1e\+08 N/m"):
        saturated.surface_for(1e9)


def test_without_nonlinear_propagation_the_force_is_the_square() -> None:
    assert force_scale(SimulationSettings(specimen=Specimen())) is None
    assert force_scale(SimulationSettings(beams=Beams(), propagation=Propagation())) is None


COARSE = {"beams": Beams(excitation_width_m=(0.34e-3, 0.34e-3, 3.6e-3)), "propagation": Propagation(harmonics=8)}


def test_the_force_of_a_carrier_is_the_push_of_that_carrier_computed_once(monkeypatch: pytest.MonkeyPatch) -> None:
    marched = list[float]()

    def counted(*given: Any) -> Beam:
        marched.append(given[2])
        return nonlinear_beam(*given[:4], Accuracy(harmonics=8, relative_step=0.2, min_step_m=2e-3))

    monkeypatch.setattr("sim_backend.transducer.push.nonlinear_beam", counted)
    specimen = Specimen(force_density_n_per_m3=2.345e6)
    settings = SimulationSettings(specimen=specimen, **COARSE)
    share = force_scale(settings)
    assert share is not None
    assert not marched, "a scene without tonebursts computes no push"
    carrier_hz, pressure = np.array([0.5e6, 0.4e6, 0.5e6]), np.array([0.5, 0.7, 1.0])
    found = share(pressure, carrier_hz)
    assert set(marched) == {0.4e6, 0.5e6}
    for each, hz, force in zip(pressure, carrier_hz, found, strict=True):
        push = push_of(settings, float(hz))
        assert push is not None
        assert force == push.relative_force(np.array(each), 2.345e6)
    assert found[0] != share(pressure[:1], np.array([0.4e6]))[0]
    # nothing of the medium's motion, nor another draw, marches again
    before = len(marched)
    other = specimen.model_copy(update={"shear_modulus_pa": 7e3})
    assert push_of(settings.model_copy(update={"specimen": other}), 0.4e6) is push_of(settings, 0.4e6)
    assert len(marched) == before


@pytest.mark.slow
def test_muscle_is_pushed_by_more_than_the_square_where_shocks_form() -> None:
    """Errors by scripts/validation/nonlinear_push.py: force 1 % at 24 harmonics."""
    specimen = Specimen(preset="bovine_muscle", force_density_n_per_m3=2.2e6)
    beams = Beams(excitation_width_m=(0.34e-3, 0.34e-3, 3.6e-3))
    settings = SimulationSettings(specimen=specimen, beams=beams, propagation=Propagation())
    share = force_scale(settings)
    assert share is not None
    at = share(np.sqrt(np.array([0.01, 0.25, 0.49, 1.0])), np.full(4, 3e6))
    assert at[-1] == pytest.approx(1.0)
    assert (at / [0.01, 0.25, 0.49, 1.0]).tolist() == pytest.approx([0.57, 0.63, 0.76, 1.0], abs=0.02)


def test_a_push_between_its_levels_follows_powers_of_the_drive() -> None:
    surface_pa = np.array([1e3, 1e4, 1e5])
    table = Push(surface_pa, 1e-9 * surface_pa**2, *[3.0 * surface_pa**2] * 5)
    at_pa = np.array([1e2, 3e3, 5e4, 1e6])
    here = table.at(at_pa)
    np.testing.assert_allclose(here.surface_pa, at_pa)
    np.testing.assert_allclose(here.sppa_w_per_m2, 3.0 * at_pa**2)


def test_the_output_of_a_weak_beam_in_water_is_the_linear_focus() -> None:
    settings = SimulationSettings(specimen=Specimen(), beams=Beams(), propagation=Propagation(harmonics=8))
    weak = water_output(settings, 1e3)
    k = wave_number(3e6, 1540.0, 0.0018 * 3)
    gain = np.abs(bowl_pressure(settings.beams.transducer, k, np.zeros(1), np.linspace(-3e-3, 1e-3, 41))).max()
    # steps of 0.2 mm around the focus and the water's attenuation: within 1 %
    assert weak.positive_pa == pytest.approx(1e3 * gain, rel=0.01)
    assert weak.negative_pa == pytest.approx(1e3 * gain, rel=0.01)
    assert weak.sppa_w_per_m2 == pytest.approx((1e3 * gain) ** 2 / (2 * 995 * 1540), rel=0.02)
    with pytest.raises(ValueError, match=r"simulation\.propagation"):
        water_output(SimulationSettings(), 1e3)
