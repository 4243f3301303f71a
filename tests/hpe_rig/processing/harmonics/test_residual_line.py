"""Lines in the residual: motion that nobody fits is told where the spectrum shows it, and noise is not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hpe_rig import measure
from hpe_rig.processing import Motion
from hpe_rig.processing.harmonics.fit_checks import residual_line
from hpe_rig.scene import load_scene

RATE_HZ, PULSES = 4000.0, 200
TIME_S = np.arange(PULSES) / RATE_HZ
NOISE_M = 5e-9


def _motion(displacement_m: np.ndarray, noise: np.ndarray, valid: np.ndarray | None = None) -> Motion:
    everything = np.ones(PULSES, bool) if valid is None else valid
    return Motion(TIME_S, displacement_m + NOISE_M * noise, np.full(PULSES, NOISE_M**2), everything)


def test_white_noise_has_a_line_as_often_as_it_is_said_to_have() -> None:
    noise = np.random.default_rng(1).standard_normal((600, PULSES))
    wanted = 1e-6 * np.sin(2 * np.pi * 200 * TIME_S)
    found = [residual_line(_motion(wanted, each), [200.0], also_hz=[400.0]) for each in noise]
    said = np.array([line.probability for line in found if line is not None])
    assert said.size == 600
    # the first term of Fisher's sum is a bound, close where it is small
    assert np.mean(said < 0.05) == pytest.approx(0.05, abs=3 * np.sqrt(0.05 / 600))


@pytest.mark.parametrize("line_hz", [738.0, 3262.0, 4738.0])
def test_a_line_is_found_at_its_alias(line_hz: float) -> None:
    generator = np.random.default_rng(2)
    valid = generator.random(PULSES) > 0.1
    moved = 1e-6 * np.sin(2 * np.pi * 200 * TIME_S) + 5e-9 * np.sin(2 * np.pi * line_hz * TIME_S + 1)
    line = residual_line(_motion(moved, generator.standard_normal(PULSES), valid), [200.0])
    assert line is not None
    assert line.probability < 1e-4
    # a bin is 20 Hz wide
    assert line.frequency_hz == pytest.approx(738.0, abs=10.0)
    assert line.amplitude_m == pytest.approx(5e-9, rel=0.4)


def test_a_line_in_a_bin_is_measured_to_every_digit_and_none_at_half_the_pulse_rate() -> None:
    wanted = 1e-6 * np.sin(2 * np.pi * 200 * TIME_S)
    alone = residual_line(_motion(wanted + 5e-9 * np.sin(2 * np.pi * 740 * TIME_S), np.zeros(PULSES)), [200.0])
    assert alone is not None
    assert (alone.frequency_hz, alone.amplitude_m) == pytest.approx((740.0, 5e-9), rel=1e-6)
    # Up and down from pulse to pulse: amplitude and phase of it cannot be told apart.
    noise = np.random.default_rng(4).standard_normal(PULSES)
    other = residual_line(_motion(wanted + 1e-7 * (-1.0) ** np.arange(PULSES), noise), [200.0])
    assert other is not None
    assert other.frequency_hz < RATE_HZ / 2
    assert other.amplitude_m < 1e-8


def test_aliases_of_a_wanted_frequency_leave_no_line_and_too_few_bins_give_none() -> None:
    moved = 1e-6 * np.sin(2 * np.pi * 200 * TIME_S) + 1e-6 * np.sin(2 * np.pi * 3800 * TIME_S)
    line = residual_line(_motion(moved, np.random.default_rng(3).standard_normal(PULSES)), [200.0])
    assert line is not None
    assert line.probability > 0.01
    few = Motion(TIME_S[:20], moved[:20], np.full(20, NOISE_M**2), np.ones(20, bool))
    assert residual_line(few, [200.0, 600.0]) is None


@pytest.mark.parametrize(
    ("line_hz", "warned"), [pytest.param(3300.0, True, marks=pytest.mark.slow), (800.0, True), (None, False)]
)
def test_a_run_warns_of_motion_that_nobody_asked_for(line_hz: float | None, warned: bool, tmp_path: Path) -> None:
    scene = load_scene("table-1")
    motions = [{"frequency_hz": 200.0, "amplitude_m": 1e-6}]
    motions += [] if line_hz is None else [{"frequency_hz": line_hz, "amplitude_m": 2e-7}]
    run = measure(scene.with_({"simulation.motion": motions}), path=tmp_path / "run.h5")
    told = [text for text in run.estimate().shots[0].warnings if "the residual has a line" in text]
    assert bool(told) == warned
    if line_hz == 3300.0:
        # 4000 - 3300 Hz, to half a bin of 40 Hz
        assert float(told[0].partition(" at ")[2].partition(" Hz")[0]) == pytest.approx(700, abs=20)
