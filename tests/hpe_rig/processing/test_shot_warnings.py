"""What an estimate warns of: nothing detected, one toneburst, pulses after the last one, a reference without echo."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from hpe_rig import measure
from hpe_rig.bench import read_bench
from hpe_rig.measurement.setup import plan_and_check
from hpe_rig.plan import follow_tonebursts, precede_tonebursts
from hpe_rig.plan.interference import forbidden_window_s
from hpe_rig.processing import Motion, estimate_run, least_squares
from hpe_rig.processing.shot_warnings import fit_warnings, setting_warnings
from hpe_rig.scene import Scene, load_scene, parse_scene, scene_text


def _scene(bursts: int) -> Scene:
    name, text = scene_text("bovine-muscle")
    return parse_scene(name, text.replace("burst_count = 20", f"burst_count = {bursts}")).scene


def _motion(amplitude_m: float) -> Motion:
    time_s = np.arange(400) / 4000
    noise_m = 1e-8 * np.random.default_rng(1).standard_normal(400)
    moved_m = amplitude_m * np.sin(2 * np.pi * 200 * time_s) + noise_m
    return Motion(time_s, moved_m, np.full(400, 1e-16), np.ones(400, dtype=bool))


def test_a_harmonic_below_three_uncertainties_is_named_and_no_other() -> None:
    found = list(fit_warnings(least_squares(_motion(1e-7), [200.0, 300.0]), 0.1))
    assert len(found) == 1
    assert "not significant at 300 Hz" in found[0]
    assert not list(fit_warnings(least_squares(_motion(1e-7), [200.0]), 0.1))
    # noise of 10 nm over 400 pulses: 0.7 nm, so 3.5 nm is five times that
    assert not list(fit_warnings(least_squares(_motion(3.5e-9), [200.0]), 0.1))


def test_a_step_near_a_quarter_wavelength_is_a_warning(tmp_path: Path) -> None:
    # 42.8 um are a quarter wavelength; 125 um at 200 Hz move by up to 39 um in 250 us.
    moved = {"simulation.motion": [{"frequency_hz": 200.0, "amplitude_m": 125e-6}]}
    moved |= {"tracking.pulse_count": 41}
    run = measure(load_scene("table-1").with_(moved), path=tmp_path / "run.h5")
    told = [text for text in run.estimate().shots[0].warnings if "quarter wavelengths from pulse to pulse" in text]
    assert len(told) == 1
    # What the beam averages is a little less than the peak.
    assert 0.85 < float(told[0].partition(" up to ")[2].partition(" ")[0]) < 39.2 / 42.8


def test_tonebursts_longer_than_planned_are_reported_by_their_echoes(tmp_path: Path) -> None:
    planned = load_scene("bovine-muscle")
    run = measure(planned.with_({"excitation.burst_length_s": 150e-6}), path=tmp_path / "run.h5")
    plan = plan_and_check(planned, read_bench().bench)[0]
    warnings = estimate_run(planned, plan, run.stored, "coherent", (None,) * 10).shots[0].warnings
    assert any("all come directly after a toneburst, which seems longer than planned" in text for text in warnings)


def test_pulses_after_the_echoes_of_a_toneburst_follow_it_within_its_length() -> None:
    shot = plan_and_check(load_scene("bovine-muscle"), read_bench().bench)[0].shots[0]
    line = shot.timeline
    after_s = (line.pulse_onset_s[:, None] - line.burst_onset_s + 1e-12) % 0.01
    end_s = forbidden_window_s(shot)[1]
    direct = (after_s[:, 0] >= end_s) & (after_s[:, 0] < end_s + 100e-6)
    assert direct.sum() >= 4
    assert follow_tonebursts(shot, direct)
    later = np.flatnonzero(after_s[:, 0] >= end_s + 100e-6)[0]
    assert not follow_tonebursts(shot, direct | (np.arange(direct.size) == later))
    assert not follow_tonebursts(shot, np.zeros_like(direct))


def test_pulses_before_a_toneburst_precede_it_within_its_length() -> None:
    shot = plan_and_check(load_scene("bovine-muscle"), read_bench().bench)[0].shots[0]
    line = shot.timeline
    start_s = -forbidden_window_s(shot)[0]
    # All bursts, one period apart, begin this long after each pulse.
    before_s = (line.burst_onset_s[0] - line.pulse_onset_s) % 0.01
    direct = (before_s >= start_s) & (before_s < start_s + 100e-6) & (line.pulse_onset_s < line.burst_onset_s[-1])
    assert direct.sum() >= 4
    assert precede_tonebursts(shot, direct)
    assert not follow_tonebursts(shot, direct)
    # The last pulse has no toneburst after it.
    for other in (np.flatnonzero(before_s >= start_s + 100e-6)[0], direct.size - 1):
        assert not precede_tonebursts(shot, direct | (np.arange(direct.size) == other))
    assert not precede_tonebursts(shot, np.zeros_like(direct))


def test_one_toneburst_and_pulses_after_the_last_toneburst_are_reported() -> None:
    time_s = np.arange(400) / 4000
    found = plan_and_check(_scene(1), read_bench().bench)[1]
    assert [str(each) for each in found if each.level == "warning" and "one toneburst leaves" in str(each)]
    # 5 bursts at 100 Hz end after 50 of the 100 ms; 20 go on
    assert "199 of 400 pulses come after the last toneburst" in next(setting_warnings(_scene(5), time_s, None))
    assert not list(setting_warnings(_scene(20), time_s, None))


def test_a_reference_gate_without_echo_is_reported() -> None:
    time_s, still = np.arange(400) / 4000, replace(_motion(0.0), largest_step=0.1)
    assert not list(setting_warnings(_scene(20), time_s, still))
    noise = replace(still, largest_step=0.98)
    assert "reference_gate_depth_m" in next(setting_warnings(_scene(20), time_s, noise))
