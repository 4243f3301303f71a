"""The Voigt medium: table of docs/explanation/medium.md, double integrals, and the transient against Fourier series."""

import numpy as np
import pytest
from scipy.integrate import quad

from sim_backend.motion.force import ForcePulses
from sim_backend.motion.specimen import (
    frequency_response,
    legendre,
    tabulate_step_response,
    transient_displacement,
)
from sim_backend.settings import Specimen

WIDTH_M = (0.17e-3, 0.17e-3, 1.80e-3)
BURST_PS = 100_000_000


def train(onset_ps, strength=1.0, burst_ps=BURST_PS):
    onset_ps = np.asarray(onset_ps, dtype=np.int64)
    return ForcePulses(onset_ps, onset_ps + burst_ps, np.full(len(onset_ps), strength))


def periodic_displacement(specimen, rate_hz, time_s, harmonics, width_m=WIDTH_M, burst_s=100e-6):
    """The steady state as the Fourier series sum of F_n U(n f_r), eq. (18)."""
    n = np.arange(harmonics + 1)
    x = n * rate_hz * burst_s
    coefficient = rate_hz * burst_s * np.sinc(x) * np.exp(-1j * np.pi * x)
    coefficient = coefficient * frequency_response(specimen, width_m, n * rate_hz)
    coefficient[1:] *= 2
    turns = np.outer(time_s, n * rate_hz) % 1.0
    return (np.exp(2j * np.pi * turns) @ coefficient).real


def series_rest_m(specimen, cut_hz):
    """Bound of the terms beyond the cut: |2 F_n U| <= 4 f_r |U| / w, and U falls like w^-2 there: U / pi in all."""
    return abs(frequency_response(specimen, WIDTH_M, np.array([cut_hz]))[0]) / np.pi


@pytest.mark.parametrize(
    ("modulus_pa", "magnitude", "phase_deg"),
    [
        (4.00e3, (18.6, 17.8, 16.0, 11.8, 8.65, 5.07), (-19, -61, -97)),
        (7.25e3, (10.3, 10.1, 9.58, 8.12, 6.65, 4.49), (-13, -45, -82)),
        (13.5e3, (5.51, 5.47, 5.34, 4.91, 4.38, 3.40), (-8, -31, -64)),
    ],
)
def test_frequency_response_reproduces_the_table_of_the_model_notes(modulus_pa, magnitude, phase_deg):
    specimen = Specimen(shear_modulus_pa=modulus_pa)
    response = frequency_response(specimen, WIDTH_M, np.array([1.0, 100.0, 200.0, 400.0, 600.0, 1000.0]))
    # Half a unit of the table's last digit: three digits for the magnitude, one degree for the phase.
    digit = 10.0 ** (np.floor(np.log10(magnitude)) - 2)
    assert (np.abs(np.abs(response) * 1e12 - magnitude) <= 0.5001 * digit).all()
    assert np.degrees(np.angle(response[[1, 3, 5]])) == pytest.approx(phase_deg, abs=0.5)


@pytest.mark.parametrize(
    "frequency_hz",
    [
        *(pytest.param(each, marks=pytest.mark.slow) for each in (0.0, 30.0)),
        400.0,
        pytest.param(5000.0, marks=pytest.mark.slow),
    ],
)
def test_frequency_response_equals_the_double_integral_over_wave_vectors(frequency_hz):
    specimen = Specimen()
    omega = 2 * np.pi * frequency_hz
    modulus = specimen.shear_modulus_pa + 1j * omega * specimen.shear_viscosity_pa_s
    k2 = specimen.density_kg_per_m3 * omega**2 / modulus
    sx, _, sz = WIDTH_M

    # In units of 1/sx, so that quad sees numbers of order one; the pole's neighbourhood |k| is made a break point.
    def over_k(m):
        half = (1 - m**2 + (sz / sx) ** 2 * m**2) / 2
        pole = k2 * sx**2
        points = [min(abs(pole) ** 0.5, 8.9)]
        value = quad(
            lambda k: k**2 * np.exp(-half * k**2) / (k**2 - pole) if k > 0 else 0.0 if pole else 1.0,
            0.0,
            9.0,
            complex_func=True,
            points=points,
            limit=200,
            epsabs=1e-13,
            epsrel=1e-11,
        )[0]
        return value / sx

    node, weight = np.polynomial.legendre.leggauss(60)
    m = (node + 1) / 2
    expected = sum(w / 2 * 2 * (1 - x**2) * over_k(x) for x, w in zip(m, weight, strict=True)) / modulus
    expected *= sx**2 * sz / np.sqrt(2 * np.pi)
    assert frequency_response(specimen, WIDTH_M, np.array([frequency_hz]))[0] == pytest.approx(expected, rel=1e-9)


def test_response_does_not_depend_on_which_lateral_width_is_called_x():
    specimen, frequency_hz = Specimen(), np.array([0.0, 200.0, 1000.0])
    one = frequency_response(specimen, (0.1e-3, 0.3e-3, 1.8e-3), frequency_hz)
    other = frequency_response(specimen, (0.3e-3, 0.1e-3, 1.8e-3), frequency_hz)
    nearly_round = frequency_response(specimen, (0.17e-3, 0.17e-3 * (1 + 1e-9), 1.8e-3), frequency_hz)
    assert one == pytest.approx(other, rel=1e-12)
    # A change of width by 1e-9 changes the response by as much.
    assert nearly_round == pytest.approx(frequency_response(specimen, WIDTH_M, frequency_hz), rel=3e-9)


@pytest.mark.parametrize(
    ("modulus_pa", "viscosity_pa_s"),
    [
        (4.0e3, 1.0),
        pytest.param(13.5e3, 1.0, marks=pytest.mark.slow),
        pytest.param(9.0e3, 1.5, marks=pytest.mark.slow),
        pytest.param(7.25e3, 0.3, marks=pytest.mark.slow),
    ],
)
def test_single_burst_equals_the_inverse_transform(modulus_pa, viscosity_pa_s):
    """Start-up and decay: a period longer than the medium's memory makes the Fourier series a single burst."""
    specimen = Specimen(shear_modulus_pa=modulus_pa, shear_viscosity_pa_s=viscosity_pa_s)
    response = tabulate_step_response(specimen, WIDTH_M)
    rate_hz = 50.0
    assert response.settling_time_s + 100e-6 < 1 / rate_hz
    time_ps = np.arange(3_000_000, 19_990_000_000, 197_000_000)
    time_ps = np.concatenate([np.arange(1_000_000, 1_000_000_000, 23_000_000), time_ps])
    ours = transient_displacement(response, train([0]), time_ps)
    series = periodic_displacement(specimen, rate_hz, time_ps * 1e-12, harmonics=8000)
    peak_m = np.abs(series).max()
    left_out_m = series_rest_m(specimen, rate_hz * 8000)
    assert left_out_m < 1e-4 * peak_m
    assert np.abs(ours - series).max() < left_out_m + 5e-6 * peak_m


def test_train_settles_into_the_fourier_series_of_its_harmonics():
    specimen = Specimen(shear_modulus_pa=4.0e3)
    response = tabulate_step_response(specimen, WIDTH_M)
    force = train(np.arange(20) * 5_000_000_000)
    time_ps = 19 * 5_000_000_000 + np.arange(2_000_000, 4_990_000_000, 11_000_000)
    ours = transient_displacement(response, force, time_ps)
    series = periodic_displacement(specimen, 200.0, time_ps * 1e-12, harmonics=1500)
    # The table is good to 5e-6 of the peak (see below) for each of the bursts that are still felt.
    assert np.abs(ours - series).max() < series_rest_m(specimen, 200.0 * 1500) + 2e-5 * np.abs(series).max()


def test_nothing_moves_before_the_first_force():
    response = tabulate_step_response(Specimen(), WIDTH_M)
    displacement_m = transient_displacement(response, train([1_000_000_000]), np.arange(0, 1_000_000_001, 50_000_000))
    assert (displacement_m == 0.0).all()


def test_no_force_pulses_no_displacement():
    response = tabulate_step_response(Specimen(), WIDTH_M)
    assert (transient_displacement(response, train([]), np.arange(5)) == 0.0).all()


def test_displacement_of_two_trains_is_the_sum_of_each_and_scales_with_force():
    response = tabulate_step_response(Specimen(), WIDTH_M)
    time_ps = np.arange(0, 40_000_000_000, 333_000_000)
    one, two = train([0, 7_000_000_000], 2.0), train([3_000_000_000], 5.0)
    both = ForcePulses(
        np.concatenate([one.onset_ps, two.onset_ps]),
        np.concatenate([one.end_ps, two.end_ps]),
        np.concatenate([one.force_density_n_per_m3, two.force_density_n_per_m3]),
    )
    apart = transient_displacement(response, one, time_ps) + transient_displacement(response, two, time_ps)
    together = transient_displacement(response, both, time_ps)
    assert together == pytest.approx(apart, rel=1e-12, abs=1e-12 * np.abs(apart).max())


def test_pulses_looked_up_together_add_up_as_one_by_one():
    response = tabulate_step_response(Specimen(), WIDTH_M)
    time_ps = np.arange(0, 150_000_000_000, 100_000_000)
    # the last comes after all times; the others are felt at so many that several groups are made
    onset_ps, strength = [*range(0, 155_000_000_000, 5_000_000_000), 200_000_000_000], np.arange(1.0, 33.0)
    force = ForcePulses(np.array(onset_ps), np.array(onset_ps) + BURST_PS, strength)
    plain_m = np.zeros(len(time_ps))
    for onset, end, size in zip(force.onset_ps, force.end_ps, strength, strict=True):
        plain_m += size * (response.at((time_ps - onset) / 1e12) - response.at((time_ps - end) / 1e12))
    # beyond a response's memory, which the sum knows and the plain form does not, 1e-11 of the static displacement
    allowed_m = 1e-11 * strength.sum() * response.at(np.array(1e4))
    assert transient_displacement(response, force, time_ps) == pytest.approx(plain_m, rel=1e-13, abs=allowed_m)


def test_nodes_that_all_callers_share_cannot_be_changed():
    for shared in legendre(5):
        with pytest.raises(ValueError, match="read-only"):
            shared[0] = 0.0


def test_times_in_any_order_give_the_same_displacements():
    response = tabulate_step_response(Specimen(), WIDTH_M)
    time_ps = np.arange(0, 40_000_000_000, 333_000_000)
    shuffled = np.random.default_rng(1).permutation(len(time_ps))
    force = train([0, 10_000_000_000])
    in_order = transient_displacement(response, force, time_ps)
    assert np.array_equal(transient_displacement(response, force, time_ps[shuffled]), in_order[shuffled])


@pytest.mark.parametrize("viscosity_pa_s", [0.0, 1e-3, 1.0, 10.0])
def test_step_response_ends_at_the_static_displacement_within_the_memory(viscosity_pa_s):
    specimen = Specimen(shear_viscosity_pa_s=viscosity_pa_s)
    response = tabulate_step_response(specimen, WIDTH_M)
    static_m = frequency_response(specimen, WIDTH_M, np.zeros(1))[0].real
    # It settles where exp(-30) = 1e-13 of the motion is left.
    settled_s = response.settling_time_s * np.array([1, 10])
    assert response.at(settled_s) == pytest.approx(static_m, rel=1e-11)


@pytest.mark.parametrize(
    ("modulus_pa", "viscosity_pa_s"),
    [
        (7.25e3, 0.0),
        pytest.param(7.25e3, 1.0, marks=pytest.mark.slow),
        pytest.param(1e3, 3.0, marks=pytest.mark.slow),
        (3e4, 10.0),
    ],
)
def test_table_interpolates_the_step_response(step_response, modulus_pa, viscosity_pa_s):
    specimen = Specimen(shear_modulus_pa=modulus_pa, shear_viscosity_pa_s=viscosity_pa_s)
    response = tabulate_step_response(specimen, WIDTH_M)
    time_s = response.settling_time_s * np.random.default_rng(2).uniform(0, 1, 150) ** 2
    exact = step_response(specimen, WIDTH_M, time_s)
    peak = np.abs(response.at(time_s) - response.at(time_s - 100e-6)).max()
    # The accuracy that the docstring of the table promises, of the static displacement that both approach.
    assert np.abs(response.at(time_s) - exact).max() < 1e-10 * exact.max()
    assert np.abs(response.at(time_s) - exact).max() < 1e-8 * peak


def test_medium_accelerates_at_first_like_a_free_mass(step_response):
    """At first nothing but inertia acts: u = q f t^2 / 2 rho, q the divergence-free share of the force."""
    specimen = Specimen(shear_viscosity_pa_s=0.0)
    time_s = np.array([1e-6])
    sx, _, sz = WIDTH_M
    free = quad(lambda m: (1 - m**2) / (sx**2 * (1 - m**2) + sz**2 * m**2) ** 1.5, 0, 1)[0] * sx**2 * sz
    # The elastic correction is of order (c t / sx)^2 / 4 = 6e-5.
    assert step_response(specimen, WIDTH_M, time_s)[0] == pytest.approx(free * time_s[0] ** 2 / 2e3, rel=3e-4)


def test_a_medium_that_creeps_for_hours_still_has_its_transient():
    specimen = Specimen(shear_modulus_pa=1.0, shear_viscosity_pa_s=1e4)
    response = tabulate_step_response(specimen, WIDTH_M)
    static_m = frequency_response(specimen, WIDTH_M, np.zeros(1))[0].real
    # Inertia is nothing here: the medium creeps like one dashpot beside one spring, time constant mu2 / mu1.
    creep = -np.expm1(-np.array([1.0, 1e3, 1e4]) / 1e4)
    assert response.at(np.array([1.0, 1e3, 1e4])) == pytest.approx(static_m * creep, rel=1e-6)
