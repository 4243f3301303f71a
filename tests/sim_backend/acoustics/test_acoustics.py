"""Bursts in, volts out: against the sum of eq. (10) and (16) written as plain loops in absolute time."""

import numpy as np
import pytest

from sim_backend.acoustics.acoustics import Acoustics
from sim_backend.echoes.delays import EchoDelays, distinct_echoes
from sim_backend.echoes.engine import synthesise
from sim_backend.echoes.pulse import echo_pulse, hann_pulse, rectangular_burst, waveform
from sim_backend.echoes.scatterers import depth_delay_s, draw_field
from sim_backend.receiver.front_end import echo_gain_v
from sim_backend.settings import MotionComponent, Receiver, Scatterers, SimulationSettings, Specimen
from sim_backend.wiring import Bursts, Capture

FOCUS_S = 70e-3 / 1540.0
MOTION = (MotionComponent(frequency_hz=200.0, amplitude_m=1e-6, phase_rad=0.4),)
FEW = Scatterers(per_cell=2.0)
"""A fifth of the default density, because the plain sums are slow."""
ONE_SCATTERER = Scatterers(volume_m=(1e-9, 1e-9, 1e-9), per_cell=3.4535e16)


def bursts(onset_ps, carrier_hz=9.0e6, cycles=3.0, amplitude_vpp=1.0):
    onset_ps = np.asarray(onset_ps, dtype=np.int64)
    count = len(onset_ps)
    length_ps = round(cycles / carrier_hz * 1e12)
    return Bursts(
        onset_ps,
        onset_ps + length_ps,
        np.full(count, carrier_hz),
        np.full(count, cycles),
        np.full(count, amplitude_vpp),
    )


def joined(*parts):
    names = ("onset_ps", "end_ps", "carrier_hz", "cycles", "amplitude_vpp")
    return Bursts(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


NO_BURSTS = bursts([])


def capture(first_sample_ps, samples=300, index=0, origin_ps=0, period_ps=10_000):
    return Capture(index, origin_ps, np.asarray(first_sample_ps, dtype=np.int64), period_ps, samples)


def plain_tracking_volts(settings, pulses, what, focus_m):
    """Eq. (10) as printed, pulse by pulse and record by record; ``focus_m`` the displacement each pulse senses."""
    field = draw_field(
        settings.scatterers,
        settings.beams,
        np.random.default_rng(np.random.SeedSequence(settings.seed, spawn_key=(0,))),
    )
    tau = depth_delay_s(field, settings.scatterers.axial_delay, settings.sound_speed_m_per_s)
    gain_v = echo_gain_v(settings, tau, field.tracking_weight)
    volts = np.zeros((len(what.first_sample_ps), what.samples))
    for record, first_ps in enumerate(what.first_sample_ps):
        time_ps = first_ps + np.arange(what.samples) * what.sample_period_ps
        for k in range(len(pulses.onset_ps)):
            shape = hann_pulse(pulses.carrier_hz[k], settings.scatterers.bandwidth)
            delay = 2 * FOCUS_S + tau + 2 * focus_m[k] * field.motion_weight / settings.sound_speed_m_per_s
            strength = gain_v * pulses.amplitude_vpp[k] * pulses.cycles[k] / 3
            age_s = (time_ps - pulses.onset_ps[k]) * 1e-12
            if abs(age_s[0] - 2 * FOCUS_S) > 50e-6:
                continue
            volts[record] += strength * waveform(shape, age_s[:, None] - delay) @ field.tracking_weight
    return volts


def prescribed_m(pulses, origin_ps=0):
    passage_ps = pulses.onset_ps - origin_ps + round(FOCUS_S * 1e12)
    return 1e-6 * np.sin(400 * np.pi * passage_ps * 1e-12 + 0.4)


def relative(ours, expected):
    return np.abs(ours - expected).max() / np.abs(expected).max()


@pytest.mark.parametrize("axial_delay", ["two_way", "none"])
def test_records_are_the_plain_sum_over_scatterers(axial_delay):
    settings = SimulationSettings(motion=MOTION, scatterers=Scatterers(axial_delay=axial_delay, per_cell=2.0))
    pulses = bursts(500_000_000 + np.arange(8) * 250_000_000)
    what = capture(pulses.onset_ps + 89_500_000, origin_ps=300_000_000)
    ours = Acoustics(settings).record_volts(NO_BURSTS, pulses, what)
    # Interpolation is asked for 1e-8 rms; its peak error is some ten times that.
    assert relative(ours, plain_tracking_volts(settings, pulses, what, prescribed_m(pulses, 300_000_000))) < 1e-7


def test_uneven_triggers_amplitudes_and_carriers_give_the_plain_sum():
    settings = SimulationSettings(motion=MOTION, scatterers=FEW)
    pulses = joined(
        bursts([0, 500_000_000]),
        bursts([250_000_000], cycles=1.0),
        bursts([750_000_000], carrier_hz=5.0e6, amplitude_vpp=0.3),
    )
    what = capture([89_000_000, 340_012_345, 588_765_432, 839_500_001])
    ours = Acoustics(settings).record_volts(NO_BURSTS, pulses, what)
    # Rounding: the plain form has phases of 5000 rad, 1e-12 each.
    assert relative(ours, plain_tracking_volts(settings, pulses, what, prescribed_m(pulses))) < 1e-11


def test_two_pulses_in_one_record_both_echo_there():
    settings = SimulationSettings(motion=MOTION, scatterers=FEW)
    pulses = bursts([0, 4_000_000, 50_000_000])
    what = capture([85_000_000, 130_000_000], samples=1200)
    ours = Acoustics(settings).record_volts(NO_BURSTS, pulses, what)
    assert relative(ours, plain_tracking_volts(settings, pulses, what, prescribed_m(pulses))) < 1e-11


def test_one_scatterer_at_the_focus_echoes_at_the_focus_delay_plus_its_motion():
    settings = SimulationSettings(motion=MOTION, scatterers=ONE_SCATTERER)
    pulses = bursts(np.arange(5) * 1_000_000_000)
    what = capture(pulses.onset_ps + 90_000_000, samples=200)
    ours = Acoustics(settings).record_volts(NO_BURSTS, pulses, what)
    age_s = (90_000_000 + np.arange(200) * 10_000) * 1e-12
    for record, focus_m in enumerate(prescribed_m(pulses)):
        expected = waveform(hann_pulse(9.0e6, 0.065), age_s - 2 * FOCUS_S - 2 * focus_m / 1540.0)
        scale = np.vdot(expected, ours[record]) / np.vdot(expected, expected)
        # The scatterer stands up to 0.5 nm off the focus: 7.3e4 rad/m times that.
        assert relative(ours[record], scale * expected) < 4e-5


def test_no_scatterers_no_pulses_no_tonebursts_give_zeros():
    what = capture([90_000_000, 340_000_000])
    pulses = bursts([0, 250_000_000])
    nothing = SimulationSettings(scatterers=Scatterers(per_cell=0.0))
    assert (Acoustics(nothing).record_volts(NO_BURSTS, pulses, what) == 0.0).all()
    assert (Acoustics(SimulationSettings()).record_volts(NO_BURSTS, NO_BURSTS, what) == 0.0).all()
    assert Acoustics(SimulationSettings()).record_volts(NO_BURSTS, pulses, capture([])).shape == (0, 300)


def test_records_far_from_any_echo_stay_silent():
    pulses = bursts([0])
    assert (Acoustics(SimulationSettings()).record_volts(NO_BURSTS, pulses, capture([20_000_000])) == 0.0).all()


def test_without_specimen_or_motion_nothing_moves():
    acoustics = Acoustics(SimulationSettings())
    pulses = bursts(np.arange(4) * 250_000_000)
    tonebursts = bursts([0], 3.0e6, 300.0)
    assert (acoustics.focus_displacement_m(tonebursts, pulses.onset_ps, 0) == 0.0).all()
    volts = acoustics.record_volts(NO_BURSTS, pulses, capture(pulses.onset_ps + 90_000_000))
    assert np.array_equal(volts, volts[[0, 0, 0, 0]])


def test_prescribed_motion_counts_from_the_master_trigger():
    time_ps = np.array([7_000_000, 1_257_000_000], dtype=np.int64)
    moved = Acoustics(SimulationSettings(motion=MOTION)).focus_displacement_m(NO_BURSTS, time_ps, 7_000_000)
    assert moved == pytest.approx([1e-6 * np.sin(0.4), 1e-6 * np.sin(np.pi / 2 + 0.4)], rel=1e-12)


def test_specimen_rests_until_the_first_toneburst_reaches_the_focus():
    acoustics = Acoustics(SimulationSettings(specimen=Specimen()))
    tonebursts = bursts([1_000_000_000], 3.0e6, 300.0)
    arrival_ps = 1_000_000_000 + round(FOCUS_S * 1e12)
    moved = acoustics.focus_displacement_m(tonebursts, np.array([0, arrival_ps, arrival_ps + 50_000_000]), 0)
    assert (moved[:2] == 0.0).all()
    assert moved[2] > 1e-8


def test_half_the_drive_moves_the_specimen_a_quarter_as_far():
    acoustics = Acoustics(SimulationSettings(specimen=Specimen()))
    time_ps = np.arange(1, 20) * 100_000_000
    full = acoustics.focus_displacement_m(bursts([0], 3.0e6, 300.0), time_ps, 0)
    half = acoustics.focus_displacement_m(bursts([0], 3.0e6, 300.0, 0.5), time_ps, 0)
    assert half == pytest.approx(full / 4, rel=1e-12)


def test_same_settings_give_the_same_volts_bit_for_bit_and_another_seed_others():
    settings = SimulationSettings(motion=MOTION, receiver=Receiver(snr_db=20.0))
    pulses = bursts(np.arange(30) * 250_000_000)
    what = capture(pulses.onset_ps + 89_500_000)
    one = Acoustics(settings).record_volts(NO_BURSTS, pulses, what)
    assert np.array_equal(one, Acoustics(settings).record_volts(NO_BURSTS, pulses, what))
    other = Acoustics(settings.model_copy(update={"seed": 2})).record_volts(NO_BURSTS, pulses, what)
    assert np.abs(one - other).max() > 0.01


def test_noise_depends_on_the_capture_and_leaves_the_echoes_alone():
    quiet = SimulationSettings(motion=MOTION)
    noisy = quiet.model_copy(update={"receiver": Receiver(snr_db=20.0)})
    pulses = bursts(np.arange(30) * 250_000_000)
    first, third = (capture(pulses.onset_ps + 89_500_000, index=index) for index in (0, 2))
    echo_v = Acoustics(quiet).record_volts(NO_BURSTS, pulses, first)
    acoustics = Acoustics(noisy)
    acoustics.record_volts(NO_BURSTS, pulses, first)
    noise_first = Acoustics(noisy).record_volts(NO_BURSTS, pulses, first) - echo_v
    noise_third = acoustics.record_volts(NO_BURSTS, pulses, third) - echo_v
    assert np.array_equal(noise_third, Acoustics(noisy).record_volts(NO_BURSTS, pulses, third) - echo_v)
    # Standard errors of 9000 samples: variance sqrt(2/n), correlation 1/sqrt(n); five of them.
    assert np.mean(noise_first**2) == pytest.approx(0.01**2, rel=5 * np.sqrt(2 / noise_first.size))
    assert np.corrcoef(noise_first.ravel(), noise_third.ravel())[0, 1] == pytest.approx(0.0, abs=5 / np.sqrt(9000))


def test_toneburst_leaks_only_while_it_is_transmitted():
    settings = SimulationSettings(scatterers=Scatterers(per_cell=0.0))
    tonebursts = bursts([10_000_000], 3.0e6, 300.0, 0.5)
    what = capture([9_995_000, 60_000_003, 109_000_000], samples=150)
    volts = Acoustics(settings).record_volts(tonebursts, NO_BURSTS, what)
    age_ps = what.first_sample_ps[:, None] + np.arange(150) * 10_000 - 10_000_000
    # 2 V leak at the reference drive of 1 Vpp, half of it here; onset and end are zero crossings.
    expected = np.where((age_ps >= 0) & (age_ps <= 100_000_000), np.sin(6.0e6 * np.pi * age_ps * 1e-12), 0.0)
    assert np.abs(volts - expected).max() < 1e-11
    assert (volts[2, 101:] == 0.0).all()
    assert (volts[0, 0] == 0.0).all()


def test_toneburst_echo_comes_back_weighted_by_the_excitation_beam():
    settings = SimulationSettings(receiver=Receiver(toneburst_leak_v=0.0), scatterers=FEW)
    tonebursts = bursts([0, 400_000_000], 3.0e6, 30.0, 0.5)
    what = capture([80_000_000, 86_000_000, 488_000_000, 520_000_000], samples=500)
    volts = Acoustics(settings).record_volts(tonebursts, NO_BURSTS, what)
    field = draw_field(
        settings.scatterers, settings.beams, np.random.default_rng(np.random.SeedSequence(1, spawn_key=(0,)))
    )
    tau = depth_delay_s(field, "two_way", 1540.0)
    gain_v = echo_gain_v(settings, tau, field.tracking_weight)
    expected = np.zeros_like(volts)
    for onset_ps in tonebursts.onset_ps:
        age_s = (what.first_sample_ps[:, None] + np.arange(500) * 10_000 - onset_ps) * 1e-12
        shape = waveform(rectangular_burst(3.0e6, 10e-6), age_s[..., None] - 2 * FOCUS_S - tau)
        expected += 0.5 * gain_v * shape @ field.motion_weight
    # Rounding as above; an edge within 1e-20 s of a sample could fall on either side, where the burst is zero.
    assert relative(volts, expected) < 1e-10
    assert (volts[3] == 0.0).all()


def test_tonebursts_touch_only_the_records_they_overlap():
    settings = SimulationSettings(motion=MOTION)
    pulses = bursts(np.arange(6) * 250_000_000)
    what = capture(pulses.onset_ps + 89_500_000)
    acoustics = Acoustics(settings)
    clean = acoustics.record_volts(NO_BURSTS, pulses, what)
    # The first ends before the gate, its echo after it; the second lies in record 3; the last comes too late.
    tonebursts = bursts([120_000_000, 750_000_000 + 60_000_000, 1_500_000_000], 3.0e6, 100.0)
    touched = acoustics.record_volts(tonebursts, pulses, what) != clean
    assert touched.any(axis=1).tolist() == [False, False, False, True, False, False]


def one_draw(settings, displacement_m, gate_s, rng, tolerance=1e-9):
    """Echoes of one draw of scatterers, (echo, sample), 0 the arrival of the resting focus' echo."""
    field, speed = draw_field(settings.scatterers, settings.beams, rng), settings.sound_speed_m_per_s
    delay_s = depth_delay_s(field, settings.scatterers.axial_delay, speed)
    weight, moves, pulse = field.tracking_weight, field.motion_weight, echo_pulse(settings, 9.0e6)
    delays = EchoDelays.of_motion(delay_s, moves, displacement_m, speed)
    return synthesise(delays, weight, pulse, gate_s, tolerance).echo


def test_echoes_of_a_draw_are_the_plain_sum_with_time_counted_from_the_focus_echo():
    settings, gate_s = SimulationSettings(scatterers=FEW), (np.arange(130) - 64.5) * 1e-8
    displacement_m = 1e-6 * np.sin(np.arange(40) * 0.3)
    ours = one_draw(settings, displacement_m, gate_s, np.random.default_rng(9))
    field = draw_field(settings.scatterers, settings.beams, np.random.default_rng(9))
    tau = depth_delay_s(field, "two_way", 1540.0)
    for echo, moved_m in zip(ours, displacement_m, strict=True):
        delay_s = tau + 2 * moved_m * field.motion_weight / 1540.0
        plain = waveform(hann_pulse(9.0e6, 0.065), gate_s[:, None] - delay_s) @ field.tracking_weight
        # Asked for 1e-9 rms; the peak error is some ten times that.
        assert relative(echo, plain) < 1e-8


def tracked_over_peak(axial_delay, volume_m, seed):
    """Phase of each gate against the mean echo from 5 to 13 MHz, read back with the known motion by least squares."""
    settings = SimulationSettings.model_validate({"scatterers": {"axial_delay": axial_delay, "volume_m": volume_m}})
    gate_s = (np.arange(130) - 64.5) * 1e-8
    motion = np.sin(2 * np.pi * np.arange(100) / 20)
    echo = one_draw(settings, 1e-6 * motion, gate_s, np.random.default_rng(seed))
    frequency_hz = np.fft.rfftfreq(1024, 1e-8)
    band = (frequency_hz > 5e6) & (frequency_hz < 13e6)
    spectrum = np.fft.rfft(echo, 1024)[:, band]
    cross = np.conj(spectrum.mean(axis=0)) * spectrum
    power = np.abs(spectrum.mean(axis=0)) ** 2
    centre_hz = np.sum(power * frequency_hz[band]) / power.sum()
    tracked_m = -np.angle(cross.sum(axis=1)) * 1540.0 / (4 * np.pi * centre_hz)
    return motion @ tracked_m / (motion @ motion) / 1e-6


@pytest.mark.parametrize(
    ("axial_delay", "volume_m", "mean", "spread", "draws"),
    [
        ("two_way", (1e-3, 1e-3, 5e-3), 0.887, 0.060, 50),
        pytest.param("two_way", (1e-3, 1e-3, 5e-3), 0.887, 0.060, 200, marks=pytest.mark.slow),
        pytest.param("none", (1e-3, 1e-3, 5e-3), 0.751, 0.017, 200, marks=pytest.mark.slow),
        pytest.param("none", (1e-3, 1e-3, 1e-3), 0.813, 0.024, 200, marks=pytest.mark.slow),
    ],
)
def test_tracked_over_peak_displacement_is_that_of_the_theory(axial_delay, volume_m, mean, spread, draws):
    ratios = [tracked_over_peak(axial_delay, volume_m, seed) for seed in range(draws)]
    # Four standard errors of the mean, and the last digit of docs/explanation/echoes.md, section 1.
    assert np.mean(ratios) == pytest.approx(mean, abs=4 * spread / np.sqrt(draws) + 5e-4)


def test_echoes_of_a_periodic_motion_are_made_once_each_and_are_those_of_every_pulse():
    # 200 Hz seen at 4 kHz: twenty places, each several times; the last pulse comes late, the one before is weaker
    settings = SimulationSettings(seed=2, motion=MOTION)
    onset_ps = np.arange(90) * 250_000_000
    onset_ps[-1] += 3_000
    strength = np.ones(90)
    strength[-2] = 0.5
    pulses, first_ps = bursts(onset_ps, amplitude_vpp=strength), np.arange(90) * 250_000_000 + 90_000_000
    acoustics = Acoustics(settings)
    together = acoustics.record_volts(NO_BURSTS, pulses, capture(first_ps))
    alone = np.concatenate([acoustics.record_volts(NO_BURSTS, pulses, capture(first_ps[[k]])) for k in range(90)])
    # both to the twin's tolerance of 1e-8 of an echo
    np.testing.assert_allclose(together, alone, rtol=0, atol=3e-8 * np.abs(alone).max())


def test_echoes_count_as_equal_only_within_the_tolerance():
    pulse, shape = hann_pulse(9.0e6, 0.065), np.array([[0.2, -1.0], [1.0, 1.0]])
    highest = 2 * np.pi * max(pulse.frequency_hz)
    # 1e-3 of the tolerance apart in turn are alike, 1 of it are not, in either freedom
    turn = np.array([[0.0, 0.0], [1e-11, 0.0], [1e-8, 0.0], [0.0, 1e-8], [0.0, 0.0]])
    one, kind = distinct_echoes(turn / highest, shape, pulse, 1e-8)
    assert kind[0] == kind[1] == kind[4]
    assert len(set(kind.tolist())) == len(one) == 3
    assert kind[one].tolist() == [0, 1, 2]
    # at tolerance 0 only equal ones
    assert len(distinct_echoes(turn / highest, shape, pulse, 0.0)[0]) == 4
