"""Predicted uncertainty of the time base: what the fit of the rate error leaves, and nothing where clocks are one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import hpe_rig as hpe
from hpe_rig.bench import read_bench
from hpe_rig.plan import make_plan, select
from hpe_rig.prediction import expected_amplitude_m, noise_gain, time_base_text
from hpe_rig.prediction.linear_fit import echo_noise_m
from hpe_rig.prediction.time_base import time_base_uncertainty
from hpe_rig.processing import Motion, RateError, estimate_rate_error, spec_of

MONITORED = "[digitizer]\nmonitor_range_v = 4.0"
CHANNEL_B = """
[[wiring]]
source = "toneburst.output"
target = "digitizer.channel_b"
"""


def test_the_predicted_rate_uncertainty_is_that_of_the_fit() -> None:
    scene = hpe.load_scene("free-running-clocks")
    bench = read_bench().bench
    shot = make_plan(scene, bench).shots[0]
    accuracy, uncertainty, phase_u = time_base_uncertainty(scene, bench, shot)
    pulses, noise_m = select(scene, shot), echo_noise_m(scene, spec_of("coherent"))
    rng = np.random.default_rng(1)
    displacement_m = noise_m * rng.normal(size=pulses.time_s.size)
    for hz in pulses.wanted_hz:
        amplitude_m = expected_amplitude_m(scene, float(hz), shot)
        displacement_m += amplitude_m * np.sin(2 * np.pi * hz * pulses.time_s + rng.uniform(0, 6))
    motion = Motion(pulses.time_s, displacement_m, np.full(displacement_m.size, noise_m**2), pulses.used)
    fitted = estimate_rate_error(motion, pulses.wanted_hz, RateError(0.0, accuracy), also_hz=np.zeros(0))
    # The noise of 3724 pulses is estimated to 1.2 %; the gaps of the bursts correlate time and phase by a few percent.
    assert uncertainty == pytest.approx(fitted.uncertainty, rel=0.06)
    assert uncertainty < accuracy / 5
    # In proportion to the frequency, and comparable with the noise of the phase.
    assert phase_u[-1] == pytest.approx(10 * phase_u[0])
    noise_rad = noise_m * noise_gain(scene, shot)[-1] / expected_amplitude_m(scene, 1000.0, shot)
    assert 0.05 < phase_u[-1] / noise_rad < 20


def test_one_clock_adds_nothing() -> None:
    scene = hpe.load_scene("bovine-muscle")
    bench = read_bench().bench
    assert not list(time_base_text(scene, bench, make_plan(scene, bench).shots[0]))


@pytest.mark.parametrize("pulse_rate_hz", [3990.0, 4000.0])
def test_tonebursts_at_the_second_input_leave_far_less_if_pulses_fall_into_them(
    tmp_path: Path, pulse_rate_hz: float
) -> None:
    file = tmp_path / "bench.toml"
    file.write_text(read_bench().text.replace("[digitizer]", MONITORED) + CHANNEL_B, encoding="utf-8")
    scene = hpe.load_scene("free-running-clocks").with_({"tracking.pulse_rate_hz": pulse_rate_hz})
    without, monitored = (
        time_base_uncertainty(scene, bench, make_plan(scene, bench).shots[0])[1]
        for bench in (read_bench().bench, read_bench(file).bench)
    )
    if pulse_rate_hz == 4000.0:
        assert monitored == without
    else:
        # 40 records, uniform over 1 s, rounded to 10 ns.
        assert monitored == pytest.approx(10e-9 / np.sqrt(12) * np.sqrt(12) / np.sqrt(40), rel=0.03)
        assert monitored < without / 100


def test_a_second_input_without_a_cable_promises_nothing_and_its_cable_is_named(tmp_path: Path) -> None:
    file = tmp_path / "bench.toml"
    scene = hpe.load_scene("free-running-clocks")
    lines = []
    for cable in ("", CHANNEL_B):
        file.write_text(read_bench().text.replace("[digitizer]", MONITORED) + cable, encoding="utf-8")
        bench = read_bench(file).bench
        lines.append(list(time_base_text(scene, bench, make_plan(scene, bench).shots[0])))
    shipped = read_bench().bench
    assert lines[0][:1] == list(time_base_text(scene, shipped, make_plan(scene, shipped).shots[0]))
    assert 'target = "digitizer.channel_b"' in lines[0][1]
    assert len(lines[1]) == 1
    assert lines[1] != lines[0][:1]
