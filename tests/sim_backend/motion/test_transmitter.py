"""Amplifier and hybrid against closed forms, and what saturation does to the force."""

import numpy as np
import pytest

from sim_backend.motion.acoustic_dose import dose
from sim_backend.motion.force import harmonic_v, radiation_force
from sim_backend.settings import SimulationSettings, Specimen, Transmitter
from sim_backend.wiring import Bursts

DRIVE_VPP = np.array([1e-3, 0.1, 0.5, 1.0])


def force_at(drive_vpp, transmitter=None):
    count = len(drive_vpp)
    onset_ps = np.arange(count) * 10_000_000_000
    carrier_hz, cycles = np.full(count, 3.0e6), np.full(count, 300.0)
    bursts = Bursts(onset_ps, onset_ps + 100_000_000, carrier_hz, cycles, drive_vpp)
    return radiation_force(bursts, Specimen(), 0.0, transmitter).force_density_n_per_m3


def test_linear_amplifier_gives_forty_decibels_less_the_hybrid():
    assert harmonic_v(DRIVE_VPP, Transmitter()) == pytest.approx(DRIVE_VPP / 2 * 10 ** (37 / 20))
    assert (harmonic_v(DRIVE_VPP, Transmitter(), 3) == 0.0).all()


def test_voltage_sweep_is_a_parabola_in_drive_and_a_line_in_force():
    force = force_at(np.sqrt(np.array([0.1, 0.5, 1.0])))
    assert force / force[-1] == pytest.approx([0.1, 0.5, 1.0], rel=1e-12)


def test_deep_saturation_tends_to_a_square_wave():
    """A square wave's harmonics are 4 / pi / n of its height."""
    hard = Transmitter(saturation_v=1e-3, saturation_sharpness=5.0)
    fundamental, third = (harmonic_v(np.array([1.0]), hard, n)[0] for n in (1, 3))
    # The corner of a sine 3.5e4 times the ceiling takes 3e-5 rad; the rule over 64 phases errs by 1 / 64^2.
    assert fundamental == pytest.approx(4 / np.pi * 1e-3, rel=3e-3)
    assert third == pytest.approx(4 / np.pi / 3 * 1e-3, rel=3e-3)


def test_gentle_saturation_grows_a_third_harmonic_with_the_cube_of_the_drive():
    """At sharpness 1, v / sqrt(1 + v^2) = v - v^3 / 2 + ...: third harmonic a^3 / 8, in phase with the sine."""
    soft = Transmitter(gain_db=0.0, hybrid_loss_db=0.0, saturation_v=1.0, saturation_sharpness=1.0)
    amplitude = np.array([0.01, 0.02])
    assert harmonic_v(2 * amplitude, soft, 3) == pytest.approx(amplitude**3 / 8, rel=2e-3)
    assert harmonic_v(2 * amplitude, soft) == pytest.approx(amplitude - 3 / 8 * amplitude**3, rel=1e-7)


def test_a_hybrid_saturates_before_the_amplifier_as_an_amplifier_would_at_that_voltage():
    """At sharpness 1 two ceilings in a row are one: 1 / ceiling^2 of both, added."""
    gain = 10 ** (37 / 20)
    both = Transmitter(hybrid_saturation_v=1.0, saturation_v=0.5 * gain, saturation_sharpness=1.0)
    one = Transmitter(saturation_v=gain / np.sqrt(1 + 4), saturation_sharpness=1.0)
    for harmonic in (1, 3):
        assert harmonic_v(DRIVE_VPP, both, harmonic) == pytest.approx(harmonic_v(DRIVE_VPP, one, harmonic), rel=1e-9)
    far = Transmitter(hybrid_saturation_v=1e6)
    assert harmonic_v(DRIVE_VPP, far) == pytest.approx(harmonic_v(DRIVE_VPP, Transmitter()), rel=1e-9)


def test_diodes_take_their_threshold_off_every_half_wave():
    """Of a sine of amplitude a, open from the phase asin(d) on, d = threshold / a: a closed form of either harmonic."""
    bridge = Transmitter(gain_db=0.0, hybrid_loss_db=0.0, diode_threshold_v=0.3)
    amplitude = np.array([0.2, 0.3, 0.5, 1.0, 10.0])
    d = np.minimum(0.3 / amplitude, 1.0)
    opens = np.arcsin(d)
    fundamental = amplitude * (1 - 2 / np.pi * (opens + d * np.sqrt(1 - d**2)))
    third = -4 / (3 * np.pi) * amplitude * d * np.cos(opens) ** 3
    assert harmonic_v(2 * amplitude, bridge) == pytest.approx(fundamental, abs=1e-6)
    assert harmonic_v(2 * amplitude, bridge, 3) == pytest.approx(third, abs=1e-6)


def test_diodes_make_the_force_grow_faster_than_the_drive_squared():
    drive_vpp = np.sqrt(np.linspace(0.3, 1.0, 8))
    force = force_at(drive_vpp, Transmitter(diode_threshold_v=1.4))
    slope, offset = np.polyfit(drive_vpp**2, force / force[-1], 1)
    assert force[-1] == pytest.approx(force_at(np.ones(1))[0], rel=1e-12)
    assert -0.1 < offset / slope < -0.02


def test_a_reference_drive_below_the_threshold_is_refused():
    with pytest.raises(ValueError, match="does not pass"):
        SimulationSettings.model_validate({"specimen": {}, "transmitter": {"diode_threshold_v": 40.0}})


def test_saturation_leaves_the_reference_force_and_lifts_what_is_below_it():
    saturating = Transmitter(saturation_v=40.0)
    force = force_at(DRIVE_VPP, saturating)
    assert force[-1] == pytest.approx(force_at(DRIVE_VPP)[-1], rel=1e-12)
    assert (force[:-1] > force_at(DRIVE_VPP)[:-1]).all()


def test_displacement_at_the_limit_is_that_of_the_theory():
    """docs/explanation/medium.md, 6: 1 % duty, 4 kPa, column of 0.34 mm: 72 W/cm^2, 16.1 kN/m^3, 18.7 nm at 200 Hz."""
    column_m = (0.34e-3, 0.34e-3, 1.0)
    what = dose(Specimen(preset="gelatin_8"), column_m, 100.0, 100e-6, np.array([200.0]), 1540.0)
    assert what.limit_w_per_m2 == pytest.approx(72e4)
    assert what.force_limit_n_per_m3 == pytest.approx(16.1e3, rel=5e-3)
    assert what.displacement_limit_m[0] == pytest.approx(18.7e-9, rel=5e-3)


def test_short_tonebursts_are_limited_by_their_own_intensity_and_long_ones_by_the_mean():
    """FDA track 3: 190 W/cm^2 while on, 720 mW/cm^2 on average; equal at a duty of 0.72 / 190."""
    limits = [
        dose(Specimen(), (0.17e-3, 0.17e-3, 1.8e-3), 100.0, length_s, np.array([200.0]), 1540.0).limit_w_per_m2
        for length_s in (10e-6, 37e-6, 39e-6)
    ]
    assert limits == pytest.approx([190e4, 190e4, 0.72e4 / 39e-4])


def test_intensity_over_the_limit_is_two_attenuations_over_the_sound_speed():
    """5 MN/m^3 in 0.5 dB/cm/MHz: 17.27 Np/m at 3 MHz, 22.3 kW/cm^2, 310 times 72 W/cm^2."""
    specimen = Specimen(attenuation_db_per_cm_mhz=0.5, force_density_n_per_m3=5e6)
    what = dose(specimen, (0.17e-3, 0.17e-3, 1.8e-3), 100.0, 100e-6, np.array([200.0]), 1540.0)
    assert what.intensity_w_per_m2 / what.limit_w_per_m2 == pytest.approx(309.6, rel=1e-3)
