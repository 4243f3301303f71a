"""Background motion in the twin: the whole specimen moves, by many samples, and its echoes with it."""

import numpy as np
import pytest

from sim_backend.acoustics.acoustics import Acoustics
from sim_backend.echoes.pulse import hann_pulse, waveform
from sim_backend.motion.prescribed import background_at
from sim_backend.settings import BackgroundMotion, MotionComponent, Scatterers, SimulationSettings
from sim_backend.wiring import Bursts, Capture, no_bursts

SOUND_SPEED, FOCUS_M, PULSES, SAMPLES = 1540.0, 70e-3, 12, 1200
MOTION = (MotionComponent(frequency_hz=200.0, amplitude_m=1e-6, phase_rad=0.3),)
HEART = BackgroundMotion(frequency_hz=1.2, amplitude_m=5e-3, phase_rad=0.2, harmonics=(0.3, -0.15))


def settings(*background, **others):
    return SimulationSettings(motion=MOTION, background=background, scatterers=Scatterers(per_cell=3.0), **others)


def pulses_and_capture(origin_ps=0, every_ps=20 * 10**9):
    onset_ps = origin_ps + 10**9 + np.arange(PULSES, dtype=np.int64) * every_ps
    ones = np.ones(PULSES)
    pulses = Bursts(onset_ps, onset_ps + 333_333, 9e6 * ones, 3 * ones, ones)
    # Samples come at any time after the pulses, as a trigger's jitter makes them.
    first_ps = onset_ps + 84_000_000 + np.arange(PULSES) * 1_237
    return pulses, Capture(0, origin_ps, first_ps, 10_000, SAMPLES)


def test_background_is_the_sum_of_its_harmonics():
    time_ps = np.arange(40, dtype=np.int64) * 31 * 10**9
    turn = 2 * np.pi * 1.2 * time_ps * 1e-12 + 0.2
    expected = 5e-3 * (np.sin(turn) + 0.3 * np.sin(2 * turn) - 0.15 * np.sin(3 * turn))
    assert np.abs(background_at([HEART], time_ps) - expected).max() < 1e-15


def test_echoes_are_the_plain_sum_over_scatterers_moved_by_the_background():
    """Delays 2 (z + b + g u) / c at the time at which each pulse passes the focus where that then is."""
    what, origin_ps = settings(HEART), 10**11
    pulses, capture = pulses_and_capture(origin_ps)
    twin = Acoustics(what)
    ours = twin.record_volts(no_bursts(), pulses, capture)
    field, shape = twin._field, hann_pulse(9e6, 0.065)
    for record, onset_ps in enumerate(pulses.onset_ps):
        time_s = (onset_ps - origin_ps) * 1e-12 + FOCUS_M / SOUND_SPEED
        for _ in range(3):
            moved_m = float(background_at([HEART], np.array([round(time_s * 1e12)]))[0])
            time_s = (onset_ps - origin_ps) * 1e-12 + (FOCUS_M + moved_m) / SOUND_SPEED
        focus_m = 1e-6 * np.sin(2 * np.pi * 200 * time_s + 0.3)
        depth_m = FOCUS_M + moved_m + field.offset_m[:, 2] + field.motion_weight * focus_m
        age_s = (capture.first_sample_ps[record] - onset_ps + np.arange(SAMPLES) * 10_000) * 1e-12
        echo = waveform(shape, age_s[:, None] - 2 * depth_m / SOUND_SPEED) @ field.tracking_weight
        # Passing times are whole picoseconds, in which the background moves by 0.05 pm; the sum keeps 2e-7.
        assert np.abs(ours[record] - twin._gain_v * echo).max() < 2e-6 * np.abs(twin._gain_v * echo).max()


def test_a_background_that_rests_changes_no_echo():
    pulses, capture = pulses_and_capture()
    still = BackgroundMotion(frequency_hz=1.0, amplitude_m=0.0)
    resting, with_it = (
        Acoustics(each).record_volts(no_bursts(), pulses, capture) for each in (settings(), settings(still))
    )
    assert np.abs(with_it - resting).max() < 1e-6 * np.abs(resting).max()


def test_the_true_displacement_is_without_the_background():
    time_ps = np.arange(50, dtype=np.int64) * 10**9
    moved = Acoustics(settings(HEART)).focus_displacement_m(no_bursts(), time_ps, 0)
    assert np.array_equal(moved, Acoustics(settings()).focus_displacement_m(no_bursts(), time_ps, 0))


@pytest.mark.parametrize("amplitude_m", [0.02, -0.02])
def test_echoes_moved_out_of_the_records_are_silent(amplitude_m):
    far = BackgroundMotion(frequency_hz=1e-3, amplitude_m=0.02, phase_rad=np.copysign(np.pi / 2, amplitude_m))
    pulses, capture = pulses_and_capture()
    assert (Acoustics(settings(far)).record_volts(no_bursts(), pulses, capture) == 0.0).all()
