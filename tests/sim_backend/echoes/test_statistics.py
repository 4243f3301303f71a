"""Statistics of many draws: speckle, correlation and what the model options do, against closed forms."""

import numpy as np
import pytest
from mpmath import hyp1f1

from sim_backend.echoes.many_draws import drawn_echoes
from sim_backend.echoes.pulse import echo_pulse, gaussian_pulse, hann_pulse
from sim_backend.echoes.scatterers import depth_delay_s, draw_field, field_at, reflector_points
from sim_backend.settings import Beams, Reflector, Scatterers, SimulationSettings

GATE_S = (np.arange(130) - 64.5) * 1e-8


def drawn(settings, displacement_m, gate_s, draws, seed=0):
    pulse = echo_pulse(settings, 9.0e6)
    rng = np.random.default_rng(seed)
    return np.concatenate(list(drawn_echoes(settings, displacement_m, pulse, gate_s, rng, draws)))


@pytest.mark.parametrize("per_cell", [11.0, pytest.param(22.0, marks=pytest.mark.slow)])
def test_envelope_of_fully_developed_speckle_has_a_ratio_of_mean_to_deviation_of_1_91(per_cell):
    """Rayleigh: sqrt(pi / (4 - pi)) = 1.913. The pulse reaches 0.66 mm of depth, so some 20 cells are summed."""
    settings, draws = SimulationSettings(scatterers=Scatterers(per_cell=per_cell)), 2000
    quarter_s = 1 / (4 * 9.0e6)
    pair = drawn(settings, np.zeros(1), np.array([-quarter_s / 2, quarter_s / 2]), draws)[:, 0]
    envelope = np.hypot(pair[:, 0], pair[:, 1])
    ratio = envelope.mean() / envelope.std()
    # Standard error of the ratio of a Rayleigh sample: 1.1 / sqrt(n) by the delta method; five of them. A quarter
    # period apart, the two are in quadrature but for the band, 1e-3.
    assert ratio == pytest.approx(np.sqrt(np.pi / (4 - np.pi)), abs=5 * 1.1 / np.sqrt(draws))


def test_few_scatterers_do_not_make_fully_developed_speckle():
    settings = SimulationSettings(scatterers=Scatterers(per_cell=0.2))
    quarter_s = 1 / (4 * 9.0e6)
    pair = drawn(settings, np.zeros(1), np.array([-quarter_s / 2, quarter_s / 2]), 2000)[:, 0]
    envelope = np.hypot(pair[:, 0], pair[:, 1])
    assert envelope.mean() / envelope.std() < 1.6


@pytest.mark.parametrize(
    "displacement_m", [pytest.param(1e-6, marks=pytest.mark.slow), 1e-5, pytest.param(2e-5, marks=pytest.mark.slow)]
)
def test_correlation_of_echoes_is_the_kummer_function_of_the_closed_form(displacement_m):
    """rho exp(j psi) = M(a, a + 1, j theta), a = p W^2, p = 2, theta = 4 pi f u0 / c, for axially uniform motion."""
    ratio, draws = 2.19, 1000
    # Phase alone: a pulse of 55 us, whose envelope does not feel 26 ns of delay (that decorrelates by 1e-3 at 6.5 %).
    settings = SimulationSettings(
        beams=Beams(width_ratio=(ratio, ratio, np.inf)), scatterers=Scatterers(bandwidth=0.002)
    )
    pair_s = np.array([-1, 1]) / (8 * 9.0e6)
    echo = drawn(settings, np.array([0.0, displacement_m]), pair_s, draws)
    # Two samples a quarter period apart give the analytic signal at the middle, within so narrow a band.
    signal = (echo[..., 0] + echo[..., 1]) / np.sqrt(2) - 1j * (echo[..., 1] - echo[..., 0]) / np.sqrt(2)
    products = signal[:, 0] * np.conj(signal[:, 1])
    rho = products.sum() / np.sqrt(np.sum(np.abs(signal[:, 0]) ** 2) * np.sum(np.abs(signal[:, 1]) ** 2))
    a, theta = 2 * ratio**2, 4 * np.pi * 9.0e6 * displacement_m / 1540.0
    expected = complex(hyp1f1(a, a + 1, 1j * theta))
    # Spread of rho over n draws: (1 - |rho|^2) / sqrt(n), of its phase sqrt((1/|rho|^2 - 1) / 2 n); five of each.
    size = abs(expected)
    assert abs(rho) == pytest.approx(size, abs=5 * (1 - size**2) / np.sqrt(draws) + 1e-6)
    spread = np.sqrt((1 / size**2 - 1) / (2 * draws))
    assert abs(np.angle(rho)) == pytest.approx(abs(np.angle(expected)), abs=5 * spread)


def test_random_reflectivity_has_zero_mean_and_unit_power_and_unit_draws_nothing():
    for kind, fourth in (("sign", 1.0), ("normal", 3.0)):
        field = draw_field(Scatterers(reflectivity=kind, per_cell=100.0), Beams(), np.random.default_rng(1))
        plain = field_at(field.offset_m, Beams()).tracking_weight
        value = (field.tracking_weight / plain)[plain > 1e-200]
        assert value.mean() == pytest.approx(0.0, abs=5 / np.sqrt(len(value)))
        assert np.mean(value**2) == pytest.approx(1.0, abs=5 * np.sqrt(max(fourth - 1, 1e-9) / len(value)))
    one, two = (np.random.default_rng(2) for _ in range(2))
    draw_field(Scatterers(), Beams(), one)
    two.uniform(size=(1593, 3))
    assert one.random() == two.random()


def test_lateral_offset_moves_the_tracking_beam_and_not_the_motion():
    point_m = np.array([[1e-4, -5e-5, 0.0]])
    field = field_at(point_m, Beams(lateral_offset_m=(1e-4, -5e-5)))
    assert field.tracking_weight[0] == 1.0
    assert field.motion_weight[0] == field_at(point_m, Beams()).motion_weight[0] < 1.0


def test_a_point_reflector_stands_where_it_is_put_with_its_strength_and_may_rest():
    reflector = Reflector(position_m=(0.0, 0.0, 5e-4), strength=50.0, moves=False)
    scatterers = Scatterers(per_cell=0.0, reflectors=(reflector,))
    field = draw_field(scatterers, Beams(), np.random.default_rng(0))
    assert field.motion_weight.tolist() == [0.0]
    assert field.tracking_weight[0] == pytest.approx(50.0 * np.exp(-((5e-4 / 0.83e-3) ** 2) / 2), rel=1e-14)
    assert depth_delay_s(field, "two_way", 1540.0)[0] == pytest.approx(1e-3 / 1540.0, rel=1e-14)


def test_a_plane_reflector_is_the_integral_over_the_tracking_beam():
    """At rest its strength; moving, each lateral axis averages g: 1 / sqrt(1 + T^2 / E^2) to first order."""
    beams = Beams()
    point_m, share = reflector_points(Reflector(kind="plane", strength=3.0), beams)
    field = field_at(point_m, beams, share)
    assert field.tracking_weight.sum() == pytest.approx(3.0, rel=1e-12)
    mean = field.tracking_weight @ field.motion_weight / field.tracking_weight.sum()
    w2 = (0.17 / 0.078) ** 2
    assert mean == pytest.approx(w2 / (1 + w2), rel=1e-6)


def test_pulse_kinds_of_the_settings_are_the_pulses_by_name():
    def pulse(**scatterers):
        return echo_pulse(SimulationSettings(scatterers=Scatterers(**scatterers)), 9.0e6)

    assert pulse() == hann_pulse(9.0e6, 0.065)
    assert pulse(pulse="gaussian", bandwidth=0.5) == gaussian_pulse(9.0e6, 0.5)
    assert pulse(pulse="burst", bandwidth=0.5).start_s < 0 < 3 / 9.0e6 < pulse(pulse="burst", bandwidth=0.5).end_s


def test_attenuation_weakens_deeper_scatterers_and_lowers_the_pulse_s_centre():
    settings = SimulationSettings(
        scatterers=Scatterers(attenuation_db_per_cm_mhz=0.5, pulse="gaussian", bandwidth=0.3, per_cell=1.0)
    )
    pulse = echo_pulse(settings, 9.0e6)
    power = np.abs(pulse.amplitude) ** 2
    centre_hz = power @ np.array(pulse.frequency_hz) / power.sum()
    sigma_hz = 0.3 * 9.0e6 / (2 * np.sqrt(2 * np.log(2)))
    # 0.5 dB/cm/MHz over 14 cm is 8.06e-7 Np/Hz; the amplitude's centre falls by that times sigma squared.
    expected_hz = 9.0e6 - 0.5 * 14.0 / 1e6 * np.log(10) / 20 * sigma_hz**2
    assert centre_hz == pytest.approx(expected_hz, rel=1e-3)
    field = draw_field(settings.scatterers, settings.beams, np.random.default_rng(0))
    loss_db = -20 * np.log10(field.tracking_weight / field_at(field.offset_m, settings.beams).tracking_weight)
    assert loss_db == pytest.approx(0.5 * 9 * 2 * field.offset_m[:, 2] * 100, abs=1e-9)
