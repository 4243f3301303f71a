"""The field around the focus: against quadrature, the axis' closed form, and the tracked displacement of a column."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import j0, jv

from sim_backend.acoustics.acoustics import Acoustics
from sim_backend.echoes.pulse import hann_pulse, waveform
from sim_backend.echoes.scatterers import depth_delay_s, draw_field
from sim_backend.motion.field import _BesselOnRay, field_transfer, focus_field, medium_motion
from sim_backend.motion.force import ForcePulses
from sim_backend.motion.specimen import frequency_response, tabulate_step_response, transient_displacement, transients
from sim_backend.receiver.front_end import echo_gain_v
from sim_backend.settings import Receiver, SimulationSettings, Specimen
from sim_backend.wiring import Bursts, Capture

WIDTH_M = (0.17e-3, 0.17e-3, 1.80e-3)
REACH_M = (0.71e-3, 2.5e-3)


@pytest.fixture(scope="module")
def gelatin():
    return focus_field(Specimen(), WIDTH_M, *REACH_M)


@pytest.mark.parametrize(
    "medium", [{}, {"shear_viscosity_pa_s": 0.0}, {"medium": "maxwell"}, {"medium": "power_law", "power": 0.3}]
)
def test_field_on_the_axis_is_the_closed_form(medium):
    specimen, frequency_hz = Specimen.model_validate(medium), np.array([10.0, 200.0, 1000.0, 5000.0])
    ours = field_transfer(specimen, WIDTH_M, np.zeros(1), np.zeros(1), frequency_hz)[:, 0, 0]
    expected = frequency_response(specimen, WIDTH_M, frequency_hz)
    # What the ray's quadrature promises: twelve nodes an octave, a pole 0.55 rad off.
    assert np.abs(ours / expected - 1).max() < 1e-6


@pytest.mark.parametrize(
    ("lateral_m", "axial_m"),
    [(0.3e-3, 0.0), (0.0, 1.5e-3), (0.5e-3, 2.0e-3), (0.71e-3, 0.0), (1.0e-3, 2.5e-3), (2.0e-3, 0.0)],
)
def test_field_off_the_axis_equals_the_double_integral_over_wave_vectors(lateral_m, axial_m):
    """Real wave numbers, an adaptive quadrature in each direction: viscosity keeps the pole away."""
    specimen = Specimen(shear_viscosity_pa_s=3.0)
    omega = 800 * np.pi
    modulus = specimen.shear_modulus_pa + 1j * omega * specimen.shear_viscosity_pa_s
    k2 = specimen.density_kg_per_m3 * omega**2 / modulus
    sx, _, sz = WIDTH_M
    node, weight = np.polynomial.legendre.leggauss(80)

    def over_direction(k):
        # In units of 1 / sx; as narrow in m as the needle of the force's spectrum.
        top = min(1.0, 8.0 / max(k * sz / sx, 1e-9))
        m = (node + 1) / 2 * top
        half = (sx**2 * (1 - m**2) + sz**2 * m**2) / 2
        waves = j0(k / sx * lateral_m * np.sqrt(1 - m**2)) * np.cos(k / sx * axial_m * m)
        inner = top / 2 * weight @ (2 * (1 - m**2) * np.exp(-((k / sx) ** 2) * half) * waves)
        return inner * k**2 / (k**2 - k2 * sx**2)

    # The integrand bends at the shear wave number and where the needle narrows.
    value = quad(over_direction, 0, 9, complex_func=True, points=[0.1, 0.3, 0.8, 2.0], limit=300, epsrel=1e-9)[0]
    expected = value / sx / modulus * sx**2 * sz / np.sqrt(2 * np.pi)
    ours = field_transfer(specimen, WIDTH_M, np.array([lateral_m]), np.array([axial_m]), np.array([400.0]))[0, 0, 0]
    peak = abs(frequency_response(specimen, WIDTH_M, np.array([400.0]))[0])
    assert abs(ours - expected) < 1e-6 * peak


def test_tracked_over_peak_displacement_is_that_of_the_theory():
    """docs/explanation/medium.md: a column of 0.34 mm in 4 kPa gelatin, tracked by exp(-r^2 / T^2), T = 0.155 mm."""
    specimen, tracking_m = Specimen(preset="gelatin_8"), 0.155e-3
    node, weight = np.polynomial.legendre.leggauss(24)
    lateral_m = 3.5 * tracking_m * (node + 1) / 2
    weight = weight * lateral_m * np.exp(-((lateral_m / tracking_m) ** 2))
    frequency_hz = np.array([100.0, 200.0, 400.0, 1000.0])
    field = field_transfer(specimen, (0.34e-3, 0.34e-3, 0.5), lateral_m, np.zeros(1), frequency_hz)[..., 0]
    axis = field_transfer(specimen, (0.34e-3, 0.34e-3, 0.5), np.zeros(1), np.zeros(1), frequency_hz)[:, 0, 0]
    ratio = (field @ weight) / weight.sum() / axis
    # Half a unit of the notes' last digit; the gate's edge at 3.5 T leaves out exp(-12).
    assert np.abs(ratio) == pytest.approx([0.984, 0.980, 0.973, 0.955], abs=6e-4)
    assert (np.angle(ratio) < 0).all()
    assert np.degrees(np.angle(ratio)) == pytest.approx([-0.6, -0.9, -1.2, -1.6], abs=0.45)


def test_real_field_is_tracked_nearer_to_its_peak_than_the_gaussian_of_eq_12():
    specimen, tracking_m = Specimen(), 0.078e-3
    node, quadrature = np.polynomial.legendre.leggauss(20)
    lateral_m = 4 * tracking_m * (node + 1) / 2
    weight = quadrature * lateral_m * np.exp(-((lateral_m / tracking_m) ** 2))
    field = field_transfer(specimen, WIDTH_M, lateral_m, np.zeros(1), np.array([200.0]))[0, :, 0]
    peak = frequency_response(specimen, WIDTH_M, np.array([200.0]))[0]
    gaussian = np.exp(-(lateral_m**2) / (2 * WIDTH_M[0] ** 2))
    tracked = abs(weight @ field / peak) / weight.sum()
    assert weight @ gaussian / weight.sum() == pytest.approx(0.9048, abs=1e-4)
    assert tracked > 0.955


def test_modes_on_the_axis_follow_the_exact_transient(gelatin):
    onset_ps = np.arange(4) * 10_000_000_000
    force = ForcePulses(onset_ps, onset_ps + 100_000_000, np.full(4, 4e6))
    time_ps = np.arange(-1_000_000_000, 45_000_000_000, 133_000_000)
    ours = transients(gelatin.response, force, time_ps) @ gelatin.shapes(np.zeros(1), np.zeros(1))[0]
    expected = transient_displacement(tabulate_step_response(Specimen(), WIDTH_M), force, time_ps)
    static_m = 4e6 * frequency_response(Specimen(), WIDTH_M, np.zeros(1))[0].real
    # The tolerance that the field promises, of the static displacement.
    assert np.abs(ours - expected).max() < 2e-5 * static_m
    assert (ours[time_ps <= 0] == 0.0).all()


@pytest.mark.parametrize(
    "medium",
    [
        pytest.param(
            {"medium": "maxwell", "shear_modulus_pa": 1.9e3, "shear_viscosity_pa_s": 6.5}, marks=pytest.mark.slow
        ),
        {"medium": "maxwell", "shear_modulus_pa": 48e3, "shear_viscosity_pa_s": 0.97},
        {"medium": "power_law", "power": 0.6},
    ],
)
def test_modes_of_a_medium_that_creeps_hold_the_motion_under_single_bursts(medium):
    specimen = Specimen.model_validate(medium)
    field = focus_field(specimen, WIDTH_M, *REACH_M)
    onset_ps = np.arange(20) * 10_000_000_000
    force = ForcePulses(onset_ps, onset_ps + 100_000_000, np.full(20, 4e6))
    time_ps = np.arange(0, 200_000_000_000, 133_000_000)
    ours = transients(field.response, force, time_ps) @ field.shapes(np.zeros(1), np.zeros(1))[0]
    expected = transient_displacement(tabulate_step_response(specimen, WIDTH_M), force, time_ps)
    under_one_burst_m = expected[: len(time_ps) // 20].max()
    # The field's 1e-5 counts against what a steady force moves the medium in a millisecond, ten times a burst's length.
    assert np.abs(ours - expected).max() < 2e-4 * under_one_burst_m


def test_motion_arrives_later_the_farther_out(gelatin):
    """A shear wave at 2.7 m/s crosses 0.6 mm in 0.22 ms; so near its source it is not yet that late."""
    force = ForcePulses(np.array([0]), np.array([100_000_000]), np.array([4e6]))
    time_ps = np.arange(0, 3_000_000_000, 10_000_000)
    course = (
        transients(gelatin.response, force, time_ps) @ gelatin.shapes(np.array([0.0, 0.3e-3, 0.6e-3]), np.zeros(3)).T
    )
    peak_ps = time_ps[np.argmax(course, axis=0)]
    assert (np.diff(peak_ps) > 0).all()
    assert peak_ps[2] - peak_ps[0] < 0.22e9
    assert (np.diff(course.max(axis=0)) < 0).all()


@pytest.mark.slow
@pytest.mark.parametrize(("reach_m", "tolerance"), [(2.2e-3, 2e-5), (4.4e-3, 2e-5)])
def test_a_field_that_reaches_far_holds_what_a_near_one_does(gelatin, reach_m, tolerance):
    far = focus_field(Specimen(), WIDTH_M, reach_m, REACH_M[1])
    place_m, depth_m = np.array([0.0, 0.1e-3, 0.35e-3, 0.7e-3]), np.array([0.0, 2.0e-3, 0.5e-3, 0.0])
    force = ForcePulses(np.array([0]), np.array([100_000_000]), np.array([4e6]))
    time_ps = np.arange(0, 10_000_000_000, 50_000_000)
    near, wide = (
        transients(each.response, force, time_ps) @ each.shapes(place_m, depth_m).T for each in (gelatin, far)
    )
    # Each promises 1e-5 of the static displacement.
    static_m = 4e6 * frequency_response(Specimen(), WIDTH_M, np.zeros(1))[0].real
    assert np.abs(wide - near).max() < tolerance * static_m


def test_field_is_few_modes(gelatin):
    assert gelatin.shape.shape[0] <= 16


def test_points_outside_the_table_and_oval_beams_are_refused(gelatin):
    with pytest.raises(ValueError, match="lies outside the tabulated field"):
        gelatin.shapes(np.array([2e-3]), np.zeros(1))
    with pytest.raises(ValueError, match="needs a round beam"):
        focus_field(Specimen(), (0.1e-3, 0.2e-3, 1e-3), *REACH_M)


def test_scatterers_move_by_the_field_at_their_positions():
    """Records of the twin against the plain sum of eq. (10) with the field's displacement of every scatterer."""
    settings = SimulationSettings(specimen=Specimen(field="medium"), receiver=Receiver(toneburst_leak_v=0.0))
    onset_ps = np.array([0, 2_000_000_000], np.int64)
    pulses = Bursts(onset_ps, onset_ps + 333_333, np.full(2, 9e6), np.full(2, 3.0), np.ones(2))
    begin_ps = np.array([500_000_000], np.int64)
    tonebursts = Bursts(begin_ps, begin_ps + 100_000_000, np.full(1, 3e6), np.full(1, 300.0), np.ones(1))
    capture = Capture(0, 0, onset_ps + 90_000_000, 10_000, 200)
    ours = Acoustics(settings).record_volts(tonebursts, pulses, capture)
    places = draw_field(
        settings.scatterers, settings.beams, np.random.default_rng(np.random.SeedSequence(1, spawn_key=(0,)))
    )
    tau = depth_delay_s(places, "two_way", 1540.0)
    motion = medium_motion(settings, places.offset_m, 70e-3 / 1540.0)
    passage_ps = onset_ps + round(70e-3 / 1540.0 * 1e12)
    moved_m = motion.amplitudes_m(tonebursts, passage_ps) @ motion.shape
    assert np.abs(moved_m[0]).max() == 0.0
    assert 1e-8 < np.abs(moved_m[1]).max() < 1e-4
    age_s = (90_000_000 + np.arange(200) * 10_000) * 1e-12
    gain_v = echo_gain_v(settings, tau, places.tracking_weight)
    for record in range(2):
        delay_s = 2 * 70e-3 / 1540.0 + tau + 2 * moved_m[record] / 1540.0
        plain = gain_v * waveform(hann_pulse(9e6, 0.065), age_s[:, None] - delay_s) @ places.tracking_weight
        # Rounding of phases of 5000 rad in the plain form.
        assert np.abs(ours[record] - plain).max() < 1e-10 * np.abs(plain).max()


def test_a_single_reflector_on_an_offset_tracking_axis_moves_by_the_field_at_it():
    settings = SimulationSettings(specimen=Specimen())
    width_m = settings.beams.excitation_width_m
    motion = medium_motion(settings, np.array([[1.0e-3, 0.0, 0.0]]), 70e-3 / 1540.0, lateral_offset_m=1.0e-3)
    exact = focus_field(Specimen(), width_m, 1.5e-3, 1.8e-3)
    time_ps = np.arange(1, 60) * 10**8
    pulse = ForcePulses(np.array([0]), np.array([10**8]), np.array([1e6]))
    ours = transients(motion.field.response, pulse, time_ps) @ motion.shape[:, 0]
    there = exact.shapes(np.array([1.0e-3]), np.zeros(1))[0]
    expected = transients(exact.response, pulse, time_ps) @ there
    assert np.abs(ours - expected).max() < 1e-3 * np.abs(expected).max()


@pytest.mark.parametrize(("ray", "farthest"), [(0.55, 40.0), (0.15, 250.0)])
def test_the_tabulated_bessel_function_is_the_libraries(ray, farthest):
    distance, turn = np.linspace(0.0, farthest, 5001), np.exp(1j * ray)
    found = _BesselOnRay(turn, farthest).at(distance)
    # the argument's own rounding shifts a wave by eps times its phase
    allowed = (4e-15 + 4e-16 * distance) * np.exp(distance * np.sin(ray))
    assert (np.abs(found - jv(0, turn * distance)) < allowed).all()


def test_a_pulse_of_force_is_over_when_its_response_is(gelatin):
    step = gelatin.response
    assert step.settling_time_s < 0.1
    late_s = np.geomspace(step.settling_time_s, 1.0, 50)
    rest = step.panels.at(np.array([1e3]))
    # to a tenth of the tolerance of 1e-5
    assert np.abs(step.panels.at(late_s) - rest).max() < 1e-6 * np.abs(rest).max()


def test_a_force_other_than_the_square_also_applies_off_the_axis():
    motion = medium_motion(SimulationSettings(specimen=Specimen()), np.array([[1.0e-3, 0.0, 0.0]]), 0.0, 1.0e-3)
    twice = replace(motion, force_scale=lambda pressure, carrier_hz: 2 * np.square(pressure))
    begin_ps, time_ps = np.array([0], np.int64), np.arange(1, 20) * 10**9
    burst = Bursts(begin_ps, begin_ps + 100_000_000, np.full(1, 3e6), np.full(1, 300.0), np.ones(1))
    plain_m = motion.displacement_m(burst, time_ps, 1.0e-3)
    assert plain_m.max() > 0
    np.testing.assert_allclose(twice.displacement_m(burst, time_ps, 1.0e-3), 2 * plain_m, rtol=1e-12)
