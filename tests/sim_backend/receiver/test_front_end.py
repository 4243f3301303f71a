"""Gain, pulse strength, noise and leak of the receive chain."""

import numpy as np
import pytest

from sim_backend.echoes.exact_sums import running_sum
from sim_backend.echoes.pulse import hann_pulse
from sim_backend.echoes.scatterers import depth_delay_s, draw_field
from sim_backend.receiver.front_end import (
    echo_gain_v,
    leak_per_vpp_v,
    leak_v,
    noise_v,
    pulse_strength,
    reference_gate_s,
    toneburst_echo_strength,
)
from sim_backend.settings import Receiver, SimulationSettings, Specimen
from sim_backend.wiring import Bursts


def bursts(carrier_hz, cycles, amplitude_vpp):
    zero = np.zeros(len(cycles), dtype=np.int64)
    return Bursts(zero, zero, np.full(len(cycles), carrier_hz), np.array(cycles), np.array(amplitude_vpp))


def test_reference_gate_fills_its_length_around_the_focus():
    gate_s = reference_gate_s(Receiver(reference_gate_m=1e-3), 1540.0)
    step_s = gate_s[1] - gate_s[0]
    assert gate_s[-1] - gate_s[0] + step_s == pytest.approx(2e-3 / 1540.0, rel=1e-12)
    assert gate_s.sum() == pytest.approx(0.0, abs=1e-16)


@pytest.mark.parametrize("axial_delay", ["two_way", "none"])
def test_gain_gives_the_resting_echo_its_rms_as_the_digitizer_samples_it(axial_delay):
    settings = SimulationSettings.model_validate({"scatterers": {"axial_delay": axial_delay}})
    field = draw_field(settings.scatterers, settings.beams, np.random.default_rng(1))
    tau = depth_delay_s(field, axial_delay, 1540.0)
    gain_v = echo_gain_v(settings, tau, field.tracking_weight)
    gate_s = (np.arange(130) - 64.5) * 1e-8
    echo_v = gain_v * running_sum(tau[None], field.tracking_weight, hann_pulse(9.0e6, 0.065), gate_s)
    # 11.7 carrier cycles in the gate, and 1.3000 us instead of 1.2987 us: about 1 / (4 pi 11.7) and 0.1 %.
    assert np.sqrt(np.mean(echo_v**2)) == pytest.approx(0.1, rel=0.01)


def test_gain_is_zero_where_nothing_echoes():
    assert echo_gain_v(SimulationSettings(), np.zeros(0), np.zeros(0)) == 0.0


def test_pulse_strength_scales_with_amplitude_and_cycles():
    pulses = bursts(9.0e6, [3.0, 3.0, 1.0, 6.0], [1.0, 0.5, 1.0, 2.0])
    assert pulse_strength(pulses, Receiver()) == pytest.approx([1.0, 0.5, 1 / 3, 4.0])
    assert pulse_strength(pulses, Receiver(reference_pulse_vpp=2.0)) == pytest.approx([0.5, 0.25, 1 / 6, 2.0])


def test_noise_is_white_and_as_far_below_the_echo_as_stated():
    noise = noise_v(Receiver(snr_db=20.0, echo_rms_v=0.2), 400, 500, np.random.default_rng(2))
    count = noise.size
    # Five standard errors of a variance and of a correlation from `count` normal numbers.
    assert np.mean(noise**2) == pytest.approx(0.2**2 / 100, rel=5 * np.sqrt(2 / count))
    neighbours = np.mean(noise[:, 1:] * noise[:, :-1]) / np.mean(noise**2)
    assert neighbours == pytest.approx(0.0, abs=5 / np.sqrt(count))


def test_first_records_of_a_longer_capture_have_the_same_noise():
    few = noise_v(Receiver(snr_db=0.0), 3, 50, np.random.default_rng(4))
    many = noise_v(Receiver(snr_db=0.0), 9, 50, np.random.default_rng(4))
    assert np.array_equal(few, many[:3])


def test_toneburst_leak_is_a_sine_in_proportion_to_the_drive():
    settings = SimulationSettings(specimen=Specimen(reference_drive_vpp=0.5), receiver=Receiver(toneburst_leak_v=2.0))
    assert leak_per_vpp_v(settings) == 4.0
    assert leak_per_vpp_v(SimulationSettings()) == 2.0
    age_ps = np.array([0, 83_333, 250_000])
    assert leak_v(4.0, 3.0e6, age_ps) == pytest.approx(4.0 * np.sin(6e6 * np.pi * age_ps * 1e-12), abs=1e-12)


def test_toneburst_echo_has_the_strength_of_a_tracking_echo_of_the_same_drive():
    tonebursts = bursts(3.0e6, [300.0, 300.0], [1.0, 0.2])
    assert toneburst_echo_strength(tonebursts, Receiver(toneburst_echo_gain=0.5)) == pytest.approx([0.5, 0.1])
