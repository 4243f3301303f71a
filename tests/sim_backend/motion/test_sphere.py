"""A rigid sphere in a viscoelastic medium, against limits, the compressible medium's formula, mpmath's transform."""

import mpmath
import numpy as np
import pytest

from sim_backend.motion.force import ForcePulses
from sim_backend.motion.specimen import frequency_response, tabulate_step_response, transient_displacement
from sim_backend.motion.sphere import sphere_response
from sim_backend.settings import Specimen, Sphere

STEEL = Sphere()
A = STEEL.radius_m
MASS_KG = 4 / 3 * np.pi * A**3 * STEEL.density_kg_per_m3


def specimen(**changed) -> Specimen:
    return Specimen.model_validate({"preset": "gelatin_12", "field": "gaussian", "sphere": {}} | changed)


def oestreicher(modulus_pa: complex, density: float, hz: float, sound_speed_m_per_s: float) -> complex:
    """Return Oestreicher's impedance, N s/m, time factor exp(-jwt), compression waves included (form from memory)."""
    w = 2 * np.pi * hz
    # The shear wave number decays outwards with his sign of time: the conjugate of the modulus.
    h, k = w * np.sqrt(density / np.conj(modulus_pa)), w / sound_speed_m_per_s
    ah, ak = A * h, A * k
    compression = ak**2 / (1 - 1j * ak)
    first = (1 + 3j / ah - 3 / ah**2) - 2 * (-1j / ah + 1 / ah**2) * (3 - compression)
    second = (-1j / ah + 1 / ah**2) * compression + 2 - compression
    return -1j * 4 / 3 * np.pi * A**3 * density * w * first / second


def test_a_constant_force_is_held_by_six_pi_a_mu():
    found = sphere_response(STEEL, np.array([7250.0 + 0j]), 1000.0, np.array([1e-9 + 0j]))
    assert found[0].real * 6 * np.pi * A * 7250.0 == pytest.approx(1.0, rel=1e-9)


def test_in_a_viscous_fluid_the_slow_drag_is_stokes_and_the_fast_one_the_mass_that_moves_along():
    viscosity = 2.0

    def drag(s: float) -> float:
        """Return force over velocity without the sphere's own mass; a fluid's modulus is s times its viscosity."""
        moved = sphere_response(STEEL, np.array([s * viscosity + 0j]), 1000.0, np.array([s + 0j]))[0].real
        return 1 / (moved * s) - MASS_KG * s

    # Basset's term is the first that is left: a sqrt(rho s / eta) = 1.8e-5 at s = 1e-6.
    assert drag(1e-6) == pytest.approx(6 * np.pi * A * viscosity, rel=3e-5)
    added_kg = 2 / 3 * np.pi * A**3 * 1000.0
    # And the last at high rates, relative 9 / (a sqrt(rho s / eta)) = 5e-5.
    assert drag(1e14) / 1e14 == pytest.approx(added_kg, rel=1e-4)


def test_it_is_oestreicher_s_impedance_where_the_medium_hardly_compresses():
    for hz in (100.0, 400.0, 1000.0):
        s = 2j * np.pi * hz
        modulus = 7250.0 + s
        ours = 1 / sphere_response(STEEL, np.array([modulus]), 1000.0, np.array([s]))[0] - MASS_KG * s**2
        # Force over velocity, s; his sign of time is the other one. What compression adds goes with (a k)^2 < 1e-5.
        theirs = np.conj(oestreicher(modulus, 1000.0, hz, 1540.0)) * s
        assert abs(ours / theirs - 1) < 1e-4


def test_the_step_response_is_the_inverse_laplace_transform():
    own = specimen()
    response = tabulate_step_response(own, (1.0, 1.0, 1.0))

    def transform(s):
        mu = 7250 + s
        wave = A * s * mpmath.sqrt(1000 / mu)
        force = STEEL.force_n / own.force_density_n_per_m3
        return force / (6 * mpmath.pi * A * mu * (1 + wave + wave**2 / 9) + MASS_KG * s**2) / s

    static = float(response.at(np.array(10.0)))
    for time_s in (1e-4, 5e-4, 1e-3, 2e-3, 4e-3, 2e-2):
        exact = float(mpmath.invertlaplace(transform, time_s, method="dehoog"))
        assert float(response.at(np.array(time_s))) == pytest.approx(exact, abs=2e-6 * static)


def test_a_train_of_tonebursts_settles_to_the_sum_of_its_harmonics():
    own = specimen()
    rate_hz, length_ps = 100.0, 100_000_000
    onset_ps = (np.arange(20) * 1e10).astype(np.int64)
    force = ForcePulses(onset_ps, onset_ps + length_ps, np.full(20, own.force_density_n_per_m3))
    time_ps = np.int64(19e10) + np.arange(0, 10_000_000_000, 50_000_000, dtype=np.int64)
    moved_m = transient_displacement(tabulate_step_response(own, (1.0, 1.0, 1.0)), force, time_ps)
    hz = rate_hz * np.arange(0, 2001)
    share = rate_hz * 1e-4 * np.sinc(hz * 1e-4) * np.exp(-1j * np.pi * hz * 1e-4)
    phasor = own.force_density_n_per_m3 * share * frequency_response(own, (1.0, 1.0, 1.0), hz)
    phasor[1:] *= 2
    time_s = (time_ps - onset_ps[-1]) * 1e-12
    expected_m = (np.exp(2j * np.pi * np.outer(time_s, hz)) @ phasor).real
    # The tail beyond 200 kHz falls as 1 / f^3: 1e-7 of the whole; the table is good to 1e-6.
    assert np.abs(moved_m - expected_m).max() < 5e-6 * np.abs(expected_m).max()
