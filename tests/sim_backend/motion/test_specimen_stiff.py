"""Stiff media against mpmath: moduli, viscosities, frequencies and bursts over many decades, to 1e-10."""

import math

import mpmath
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.special import wofz

from sim_backend.motion.inverse_laplace import panels_of
from sim_backend.motion.specimen import (
    frequency_response,
    inertia_factor,
    shear_modulus,
    tabulate_step_response,
    transfer,
)
from sim_backend.settings import Specimen

WIDTH_M = (0.17e-3, 0.17e-3, 1.80e-3)
DIGITS = 30


def exact_transfer(specimen, width_m, s):
    """The formula of docs/explanation/medium.md, section 2: quadrature over m, with digits for its cancellation."""
    with mpmath.workdps(DIGITS):
        mp = mpmath.mp
        s = mp.mpc(s)
        mu1, mu2 = mp.mpf(specimen.shear_modulus_pa), mp.mpf(specimen.shear_viscosity_pa_s)
        branch = mp.mpf(specimen.branch_modulus_pa)
        modulus = {
            "voigt": lambda: mu1 + s * mu2,
            "maxwell": lambda: s * mu1 * mu2 / (mu1 + s * mu2),
            "zener": lambda: mu1 + s * branch * mu2 / (branch + s * mu2),
            "power_law": lambda: mu1 * (s / (2 * mp.pi * specimen.reference_frequency_hz)) ** mp.mpf(specimen.power),
        }[specimen.medium]()
        k2 = -mp.mpf(specimen.density_kg_per_m3) * s**2 / modulus
        # The root in the upper half plane; without viscosity its limit, an outgoing wave's.
        q = mp.sqrt(k2)
        q = -q if q.imag < 0 or (q.imag == 0 and q.real > 0) else q
        sx, _, sz = (mp.mpf(width) for width in width_m)

        def over_direction(m):
            a = (sx**2 * (1 - m**2) + sz**2 * m**2) / 2
            z = q * mp.sqrt(a)
            faddeeva = mp.exp(-(z**2)) * mp.erfc(-1j * z)
            return 2 * (1 - m**2) * (mp.sqrt(mp.pi / a) / 2 + k2 * 1j * mp.pi / (2 * q) * faddeeva)

        edges = [0, 0.01, 0.03, 0.08, 0.2, 0.5, 1] if sz > sx else [0, 0.5, 0.9, 1]
        value = mp.quad(over_direction, edges, method="gauss-legendre", maxdegree=5)
        return complex(sx**2 * sz / mp.sqrt(2 * mp.pi) * value / modulus)


@pytest.mark.slow
@pytest.mark.parametrize("modulus_pa", [1.0, 4e3, 1e9])
@pytest.mark.parametrize("viscosity_pa_s", [0.0, 1.0, 1e4])
def test_every_corner_of_moduli_and_frequencies_equals_mpmath(modulus_pa, viscosity_pa_s):
    specimen = Specimen(shear_modulus_pa=modulus_pa, shear_viscosity_pa_s=viscosity_pa_s)
    for frequency_hz in (1e-3, 1.0, 200.0, 3e4, 1e6):
        ours = frequency_response(specimen, WIDTH_M, np.array([frequency_hz]))[0]
        expected = exact_transfer(specimen, WIDTH_M, 2j * math.pi * frequency_hz)
        assert abs(ours - expected) < 1e-10 * abs(expected)


@pytest.mark.parametrize(
    ("modulus_pa", "viscosity_pa_s", "frequency_hz"),
    [
        (1.0, 0.0, 1e6),
        *(
            pytest.param(*each, marks=pytest.mark.slow)
            for each in ((1.0, 0.0, 200.0), (1.0, 1e4, 1e-3), (4e3, 1.0, 3e4), (1e9, 0.0, 1e6))
        ),
        pytest.param(1e9, 1e4, 1e6, marks=pytest.mark.slow),
    ],
)
def test_voigt_response_equals_mpmath_from_soft_to_hard(modulus_pa, viscosity_pa_s, frequency_hz):
    specimen = Specimen(shear_modulus_pa=modulus_pa, shear_viscosity_pa_s=viscosity_pa_s)
    ours = frequency_response(specimen, WIDTH_M, np.array([frequency_hz]))[0]
    expected = exact_transfer(specimen, WIDTH_M, 2j * math.pi * frequency_hz)
    assert abs(ours - expected) < 1e-10 * abs(expected)


@pytest.mark.parametrize(
    "medium",
    [
        {"medium": "maxwell", "shear_viscosity_pa_s": 1e-3},
        pytest.param({"medium": "maxwell", "shear_viscosity_pa_s": 1e4}, marks=pytest.mark.slow),
        pytest.param({"medium": "zener", "branch_modulus_pa": 1e6}, marks=pytest.mark.slow),
        {"medium": "zener", "shear_viscosity_pa_s": 1e4, "branch_modulus_pa": 1.0},
        pytest.param({"medium": "power_law", "power": 0.0}, marks=pytest.mark.slow),
        {"medium": "power_law", "power": 0.9},
    ],
)
@pytest.mark.parametrize("frequency_hz", [1e6, pytest.param(1e-3, marks=pytest.mark.slow)])
def test_other_media_equal_mpmath(medium, frequency_hz):
    specimen = Specimen.model_validate(medium)
    ours = frequency_response(specimen, WIDTH_M, np.array([frequency_hz]))[0]
    expected = exact_transfer(specimen, WIDTH_M, 2j * math.pi * frequency_hz)
    assert abs(ours - expected) < 1e-10 * abs(expected)


@pytest.mark.parametrize(
    "width_m",
    [pytest.param((1e-5, 1e-5, 1e-2), marks=pytest.mark.slow), (1.8e-3, 1.8e-3, 0.17e-3), (1e-3, 1e-3, 1e-3)],
)
def test_needles_discs_and_balls_of_force_equal_mpmath(width_m):
    for specimen in (Specimen(), Specimen(shear_viscosity_pa_s=0.0)):
        ours = frequency_response(specimen, width_m, np.array([300.0]))[0]
        expected = exact_transfer(specimen, width_m, 600j * math.pi)
        assert abs(ours - expected) < 1e-10 * abs(expected)


def test_infinitely_long_focus_tends_to_that_of_a_cylinder():
    """u = s^2 / (2 mu) exp(z) E1(z), docs/explanation/medium.md; a focus of finite length differs by (s/sz)^2 log."""
    specimen, s = Specimen(shear_modulus_pa=4e3), 0.34e-3
    for frequency_hz in (200.0, 1000.0):
        omega = 2 * np.pi * frequency_hz
        modulus = 4e3 + 1j * omega
        zeta = -1000.0 * omega**2 * s**2 / (2 * modulus)
        cylinder = complex(s**2 / (2 * modulus) * mpmath.exp(zeta) * mpmath.e1(zeta))
        ours = frequency_response(specimen, (s, s, 1.0), np.array([frequency_hz]))[0]
        # The wave is 10 mm long at most: (10 mm / 2 pi / 1 m)^2 = 3e-6.
        assert abs(ours - cylinder) < 1e-5 * abs(cylinder)


def test_inertia_factor_equals_mpmath_in_both_half_planes_and_far_out_where_its_terms_cancel():
    rng = np.random.default_rng(3)
    z = 10 ** rng.uniform(-8, 12, 4000) * np.exp(1j * rng.uniform(0, np.pi, 4000))
    with mpmath.workdps(DIGITS):
        for point in [*z[np.abs(z) < 30][:60].tolist(), 5.99j, 6.01j, 6.01, -5.99, 6.01 - 0.001j, -6.2 - 1j, 2 - 3j]:
            w = mpmath.exp(-(mpmath.mpc(point) ** 2)) * mpmath.erfc(-1j * mpmath.mpc(point))
            expected = complex(1 + 1j * mpmath.sqrt(mpmath.pi) * point * w)
            assert abs(inertia_factor(np.array([point]))[0] - expected) < 1e-12 * abs(expected)
    far = z[np.abs(z) > 1e5]
    assert np.abs(inertia_factor(far) * (-2 * far**2) - 1).max() < 1e-9
    # The difference as written has no digit left there.
    assert np.abs((1 + 1j * np.sqrt(np.pi) * far * wofz(far)) * (-2 * far**2) - 1).max() > 1


@pytest.mark.parametrize(
    ("modulus_pa", "viscosity_pa_s", "time_s"),
    [
        (7.25e3, 1.0, 1e-6),
        (7.25e3, 1.0, 1e-4),
        (7.25e3, 0.0, 1e-4),
        (1e9, 1e4, 1e-7),
        (1.0, 1e4, 10.0),
    ],
)
def test_step_response_equals_the_inverse_transform_on_a_straight_line(
    step_response, modulus_pa, viscosity_pa_s, time_s
):
    specimen = Specimen(shear_modulus_pa=modulus_pa, shear_viscosity_pa_s=viscosity_pa_s)
    ours = tabulate_step_response(specimen, WIDTH_M).at(np.array([time_s]))[0]

    # On Bromwich's straight line, far from anything delicate: the trapezoidal rule with period 8 t (Abate and Whitt).
    half = 12.0

    def value(s):
        return (transfer(specimen, WIDTH_M, s) / s).real

    terms = 4000
    a = half / time_s
    k = np.arange(terms + 12)
    series = np.where(k == 0, 0.5, 1.0) * (-1.0) ** k * value(a + 1j * np.pi * k / time_s)
    partial = np.cumsum(series)[-12:]
    while len(partial) > 1:
        partial = (partial[1:] + partial[:-1]) / 2
    expected = math.exp(half) / time_s * partial[0]
    # Its own image error is exp(-2 a t) S(3 t) = 4e-11 S(3 t), and S(3 t) is at most 9 S(t).
    assert ours == pytest.approx(expected, rel=1e-9)


def test_a_step_through_one_pole_is_an_exponential_over_nineteen_decades():
    """The lumped model with time constants from 1e-9 to 1e3 s, whose step response is known."""
    constants_s = np.logspace(-9, 3, 13)
    panels = panels_of(lambda s: 1 / (1 + s[:, None] * constants_s))
    time_s = np.logspace(-11, 4, 160)
    expected = -np.expm1(-time_s[:, None] / constants_s)
    assert np.abs(panels.at(time_s) - expected).max() < 1e-10


@pytest.mark.slow
def test_the_table_follows_a_stiff_lumped_model_that_an_implicit_solver_follows_too():
    """Two masses on springs and dashpots, time constants 1e-7 to 1 s, against scipy's Radau; DOP853 would crawl."""
    stiffness, damping = np.array([[2e6, -1e6], [-1e6, 1.001e6]]), np.array([[1e6, 0.0], [0.0, 1e6]])
    mass = np.array([0.1, 0.1])

    def transfer_of_two(s):
        matrix = stiffness + s[:, None, None] * damping + s[:, None, None] ** 2 * np.diag(mass)
        return np.linalg.solve(matrix, np.broadcast_to(np.array([[1.0], [0.0]]), (len(s), 2, 1)))[..., 0]

    def slope(_t, y):
        return np.concatenate([y[2:], (np.array([1.0, 0.0]) - stiffness @ y[:2] - damping @ y[2:]) / mass])

    time_s = np.logspace(-8, 1, 30)
    reference = solve_ivp(slope, (0, 10), np.zeros(4), "Radau", time_s, rtol=1e-10, atol=1e-20)
    ours = panels_of(transfer_of_two).at(time_s)
    # Radau's own error: rtol 1e-10 a step, some hundreds of steps.
    assert np.abs(ours - reference.y[:2].T).max() < 1e-7 * np.abs(ours).max()


@pytest.mark.parametrize("burst_s", [1e-6, 1e-2])
@pytest.mark.parametrize("viscosity_pa_s", [0.0, 1.0, 1e4])
def test_bursts_of_any_length_are_the_difference_of_two_exact_steps(step_response, viscosity_pa_s, burst_s):
    specimen = Specimen(shear_viscosity_pa_s=viscosity_pa_s)
    response = tabulate_step_response(specimen, WIDTH_M)
    time_s = np.array([1.0, 30.0, 90.0]) * burst_s
    burst = response.at(time_s) - response.at(time_s - burst_s)
    exact = step_response(specimen, WIDTH_M, time_s)
    exact[1:] -= step_response(specimen, WIDTH_M, time_s[1:] - burst_s)
    # Two readings of a table that is good to 1e-10 of itself.
    assert np.abs(burst - exact).max() < 2e-10 * response.at(time_s).max()


def test_modulus_is_that_of_its_springs_and_dashpots():
    s = np.array([0.3 + 2j, 1e5j])
    assert shear_modulus(Specimen(), s) == pytest.approx(7.25e3 + s)
    # One spring and one dashpot in series share the force.
    maxwell = shear_modulus(Specimen(medium="maxwell"), s)
    assert 1 / maxwell == pytest.approx(1 / 7.25e3 + 1 / s)
    zener = shear_modulus(Specimen(medium="zener", branch_modulus_pa=500.0), s)
    assert zener == pytest.approx(7.25e3 + 1 / (1 / 500.0 + 1 / s))
    power = shear_modulus(Specimen(medium="power_law", power=0.5), np.array([200j * np.pi]))
    assert power == pytest.approx(7.25e3 * np.exp(0.25j * np.pi))
