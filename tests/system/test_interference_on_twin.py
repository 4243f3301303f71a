"""Where the plan says that a toneburst disturbs a gate, the twin's receive chain shows it, and nowhere else."""

import numpy as np
import pytest

from hpe_rig.bench import read_bench
from hpe_rig.plan.interference import disturbed_pulses
from hpe_rig.plan.shots import make_plan
from hpe_rig.scene import parse_scene, shipped_scenes
from sim_backend.acoustics.acoustics import Acoustics
from sim_backend.receiver.reception import with_reception
from sim_backend.settings import SimulationSettings
from sim_backend.wiring import Bursts, Capture, no_bursts


def bursts(onset_s, length_s, carrier_hz):
    onset_ps = np.rint(np.asarray(onset_s) * 1e12).astype(np.int64)
    same = np.ones(onset_ps.size)
    cycles = length_s * carrier_hz * same
    return Bursts(onset_ps, onset_ps + round(length_s * 1e12), carrier_hz * same, cycles, same)


def change_in_gates(delay_s):
    """Return which pulses the plan calls disturbed, and the toneburst's part of each gate over the resting echo."""
    text = shipped_scenes()["muscle-repeats"].replace("delay_s = 130e-6", f"delay_s = {delay_s}")
    text = text.replace("burst_count = 20", "burst_count = 2")
    scene = parse_scene("edited", text).scene
    shot = make_plan(scene, read_bench().bench).shots[0]
    chain = {"preset": "paper", "third_harmonic": 0.01, "noise_v_per_sqrt_hz": None}
    receiver = {"echo_rms_v": 1e-3, "toneburst_echo_gain": 40.0}
    settings = SimulationSettings.model_validate({"receive_chain": chain, "receiver": receiver})
    physics, timeline = with_reception(Acoustics(settings), settings), shot.timeline
    pulses = bursts(timeline.pulse_onset_s, timeline.pulse_length_s, 9e6)
    tonebursts = bursts(timeline.burst_onset_s, timeline.burst_length_s, 3e6)
    first_ps = pulses.onset_ps + round(timeline.record_offset_s[0] * 1e12)
    capture = Capture(0, 0, first_ps, 10_000, shot.capture.record_samples)
    resting = physics.record_volts(no_bursts(), pulses, capture)[:, shot.gate]
    changed = physics.record_volts(tonebursts, pulses, capture)[:, shot.gate] - resting
    return disturbed_pulses(shot), np.sqrt(np.mean(changed**2, axis=1) / np.mean(resting**2, axis=1))


@pytest.mark.parametrize("delay_us", range(0, 250, 50))
def test_clean_pulses_stay_clean_whatever_the_delay(delay_us):
    disturbed, change = change_in_gates(delay_us * 1e-6)
    # Filters ring and the switch recovers for some us past the toneburst: 1e-3 of the echo is 14 pm of motion.
    assert change[~disturbed].max(initial=0.0) < 1e-3


@pytest.mark.slow
def test_gates_change_exactly_where_the_plan_says():
    """Every 2 us of t_d through toneburst, its echo and the pulse before it: blocked or leaking, or clean."""
    for delay_us in np.arange(0.0, 250.0, 2.0):
        disturbed, change = change_in_gates(delay_us * 1e-6)
        assert change[~disturbed].max(initial=0.0) < 1e-3, delay_us
        assert not disturbed.any() or change[disturbed].max() > 1e-3, delay_us
