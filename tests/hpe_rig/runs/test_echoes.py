"""Echoes as an array and as an imported run file: the same estimates, budget and warnings."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import hpe_rig as hpe
from hpe_rig.processing import ESTIMATORS, margin_samples

RATES: dict[str, Any] = {"sample_rate_hz": 50e6, "pulse_rate_hz": 4000.0, "carrier_hz": 5e6}
MOVED_HZ, SPEED = 200.0, 1540.0
PULSES, SAMPLES = 80, 240
SCENE = """
title = "Echoes of another program"
[tracking]
cycles = 2
[acquisition]
gate_depth_m = 1.8e-3
gate_length_m = 1.0e-3
[processing]
frequencies_hz = [200.0]
"""


def codes(
    motion_m: NDArray[np.float64], noise: float = 0.02, codes_rms: float = 3000.0, seed: int = 3
) -> NDArray[np.int16]:
    """Return the echoes (pulse, sample) of scatterers with the rigid ``motion_m`` (pulse,), rounded to codes."""
    rng = np.random.default_rng(seed)
    depth_m, weight = rng.uniform(-0.5e-3, 4.2e-3, 60), rng.normal(size=60)
    late_s = np.arange(SAMPLES) / RATES["sample_rate_hz"] - 2 * (depth_m[:, None] + motion_m[:, None, None]) / SPEED
    pulse = np.exp(-2 * (late_s * RATES["carrier_hz"] / 1.5) ** 2) * np.cos(2 * np.pi * RATES["carrier_hz"] * late_s)
    echo = np.einsum("s,pst->pt", weight, pulse)
    echo = echo / echo.std() + noise * rng.normal(size=echo.shape)
    return np.rint(codes_rms * echo).astype(np.int16)


def sine_m(amplitude_m: float, frequency_hz: float = MOVED_HZ) -> NDArray[np.float64]:
    return np.asarray(amplitude_m * np.sin(2 * np.pi * frequency_hz * np.arange(PULSES) / RATES["pulse_rate_hz"] + 0.5))


def disturbed(echoes: NDArray[np.int16]) -> NDArray[np.int16]:
    """Return the echoes with a pulse of other energy and one that reaches full scale."""
    echoes = echoes.copy()
    echoes[20] *= 4
    echoes[40, SAMPLES // 2] = 32767
    return echoes


CASES: dict[str, Callable[[], NDArray[np.int16]]] = {
    "noise": lambda: codes(sine_m(500e-9)),
    "coarse codes": lambda: codes(sine_m(500e-9), noise=0.0, codes_rms=12.0),
    "motion that is not fitted": lambda: codes(sine_m(500e-9) + sine_m(200e-9, 730.0)),
    "growing": lambda: codes(sine_m(500e-9) * np.linspace(0.5, 1.5, PULSES)),
    "large steps": lambda: codes(sine_m(250e-6)),
    "disturbed": lambda: disturbed(codes(sine_m(500e-9))),
}
SAID = {
    "motion that is not fitted": "the residual has a line",
    "growing": "the motion changes: from the first pulse",
    "large steps": "quarter wavelengths",
    "disturbed": "energy differs",
}
DEFAULT_CASES = ("disturbed",)


@pytest.mark.parametrize(
    "case", [case if case in DEFAULT_CASES else pytest.param(case, marks=pytest.mark.slow) for case in CASES]
)
def test_an_array_has_estimates_budget_and_warnings_of_the_imported_run(case: str, tmp_path: Path) -> None:
    echoes, scene = CASES[case](), tmp_path / "scene.toml"
    scene.write_text(SCENE, encoding="utf-8")
    run = hpe.import_records(echoes, scene, tmp_path / "run.h5", axes="pulse,sample", **RATES)
    (planned,) = run.plan.shots
    count = margin_samples(RATES["sample_rate_hz"], RATES["carrier_hz"])
    rf = echoes[:, planned.gate.start - count : planned.gate.stop + count]
    # Phases of the run count from the master trigger; the first pulse senses the motion later.
    late_rad = 2 * math.pi * MOVED_HZ * planned.timeline.sensing_s[0]
    for estimator in ESTIMATORS:
        (shot,) = hpe.estimate(rf, **RATES, frequencies_hz=[MOVED_HZ], estimator=estimator, margin=(count, count)).shots
        (expected_shot,) = run.estimate(estimator).shots
        (estimate,), (expected,) = shot.estimates, expected_shot.estimates
        assert estimate.tracked_amplitude_m == pytest.approx(expected.tracked_amplitude_m, rel=1e-6), estimator
        assert math.remainder(
            estimate.tracked_phase_rad - expected.tracked_phase_rad - late_rad, 2 * math.pi
        ) == pytest.approx(0, abs=1e-6)
        assert [part.source for part in estimate.budget] == [part.source for part in expected.budget]
        for part, expected_part in zip(estimate.budget, expected.budget, strict=True):
            assert part.amplitude_m == pytest.approx(expected_part.amplitude_m, rel=1e-3, abs=1e-14), part.source
            assert part.phase_rad == pytest.approx(expected_part.phase_rad, rel=1e-3, abs=1e-8), part.source
        assert shot.warnings == expected_shot.warnings
        assert (shot.pulses_used, shot.pulses_missing) == (expected_shot.pulses_used, expected_shot.pulses_missing)
        if case in SAID:
            assert any(SAID[case] in warning for warning in shot.warnings), (estimator, shot.warnings)


def test_a_linear_drift_gives_the_amplitude_at_the_first_pulse() -> None:
    """500 nm grow by 22 %: the mean is 11 % larger, more than three u of the noise."""
    echoes = codes(sine_m(500e-9) * np.exp(np.linspace(0.0, 0.2, PULSES)))
    settings: dict[str, Any] = RATES | {"frequencies_hz": [MOVED_HZ], "frequency_accuracy": 0.0}
    (mean,) = hpe.estimate(echoes, **settings).shots[0].estimates
    (first,) = hpe.estimate(echoes, **settings, drift="linear").shots[0].estimates
    parts = {part.source: part.amplitude_m for part in first.budget}
    u_m = math.hypot(parts["drift"], parts["noise"])
    assert u_m < 0.03 * first.tracked_amplitude_m
    # Mean of exp(0.2 u) over u from 0 to 1.
    assert first.tracked_amplitude_m / mean.amplitude_m == pytest.approx(
        0.2 / math.expm1(0.2), abs=3 * u_m / mean.amplitude_m
    )
    with pytest.raises(ValueError, match="'none' or 'linear'"):
        hpe.estimate(echoes, **settings, drift="quadratic")


@pytest.mark.parametrize("estimator", ESTIMATORS)
@pytest.mark.parametrize("rounded", [True, False])
def test_identical_echoes_have_the_amplitude_of_a_motion_that_changes_no_code_and_no_phase(
    estimator: str, rounded: bool
) -> None:
    echo = np.random.default_rng(4).normal(size=SAMPLES)
    rf = np.tile(np.rint(200 * echo).astype(np.int16) if rounded else echo, (PULSES, 1))
    (shot,) = hpe.estimate(rf, **RATES, frequencies_hz=[MOVED_HZ, 600.0], estimator=estimator).shots
    # White noise has a slope of pi / sqrt(3) times its rms and the sampling rate.
    slope_per_m = 200 * math.pi / math.sqrt(3) * RATES["sample_rate_hz"] * 2 / SPEED
    expected_m = 1 / (math.sqrt(2) * SAMPLES * math.sqrt(2 / math.pi) * slope_per_m)
    assert all("not significant" in warning for warning in shot.warnings)
    for estimate in shot.estimates:
        rounding = {part.source: part for part in estimate.budget}["quantisation"]
        if rounded:
            assert rounding.amplitude_m == pytest.approx(expected_m, rel=0.1)
        assert 0 < estimate.tracked_amplitude_m < rounding.amplitude_m < 1e-9
        assert 1.8 < estimate.phase_uncertainty_rad < math.inf


def test_an_estimate_depends_neither_on_the_unit_of_the_samples_nor_on_the_type_of_codes() -> None:
    settings: dict[str, Any] = RATES | {"frequencies_hz": [MOVED_HZ]}
    echoes = codes(sine_m(500e-9), noise=0.0, codes_rms=12.0)
    (of_codes,) = hpe.estimate(echoes, **settings).shots
    rounding = {part.source: part for part in of_codes.estimates[0].budget}["quantisation"]
    assert rounding.amplitude_m > 0
    for typed in (echoes.astype(np.int32), echoes.astype(np.float64), (echoes.astype(int) + 32768).astype(np.uint16)):
        (shot,) = hpe.estimate(typed, **settings).shots
        assert shot.estimates[0].tracked_amplitude_m == pytest.approx(
            of_codes.estimates[0].tracked_amplitude_m, rel=1e-5
        )
        budget = {part.source: part for part in shot.estimates[0].budget}
        assert budget["quantisation"].amplitude_m == pytest.approx(rounding.amplitude_m, rel=1e-3)
    for unit in (1.37e-30, 1.37e-3, 1.37e30):
        (shot,) = hpe.estimate(echoes * unit, **settings).shots
        assert shot.estimates[0].tracked_amplitude_m == pytest.approx(
            of_codes.estimates[0].tracked_amplitude_m, rel=1e-5
        )


def test_a_spike_is_left_out_and_a_pulse_that_is_not_finite_is_missing() -> None:
    echoes = codes(sine_m(500e-9)).astype(float)
    (undisturbed,) = hpe.estimate(echoes, **RATES, frequencies_hz=[MOVED_HZ]).shots
    echoes[30] *= 1000.0
    echoes[50, 7] = np.inf
    (shot,) = hpe.estimate(echoes, **RATES, frequencies_hz=[MOVED_HZ]).shots
    assert (shot.pulses_used, shot.pulses_missing) == (PULSES - 2, 1)
    assert any("1 of 80 records are missing" in warning for warning in shot.warnings)
    assert any("1 of 80 pulses are omitted" in warning for warning in shot.warnings)
    u_m = undisturbed.estimates[0].tracked_amplitude_uncertainty_m
    assert abs(shot.estimates[0].tracked_amplitude_m - undisturbed.estimates[0].tracked_amplitude_m) < u_m


@pytest.mark.slow
@pytest.mark.parametrize("fraction", [0.02, 0.3, 1.0])
def test_a_motion_no_larger_than_one_that_changes_no_code_is_within_its_interval(fraction: float) -> None:
    """Of 40 draws at least 34 are within 2 u; the smallest motion leaves nearly all echoes identical."""
    slope_per_m = 12.0 * 2 * math.pi * RATES["carrier_hz"] * 2 / SPEED
    hidden_m = 1 / (SAMPLES * math.sqrt(2 / math.pi) * slope_per_m)
    within = 0
    for seed in range(40):
        echoes = codes(sine_m(fraction * hidden_m), noise=0.0, codes_rms=12.0, seed=seed)
        (shot,) = hpe.estimate(echoes, **RATES, frequencies_hz=[MOVED_HZ]).shots
        estimate = shot.estimates[0]
        within += abs(estimate.amplitude_m - fraction * hidden_m) < 2 * estimate.amplitude_uncertainty_m
    assert within >= 34


def test_a_frequency_that_is_off_is_estimated_and_corrected_and_one_clock_can_be_stated() -> None:
    """In 1 s a frequency 50 ppm too high shifts the phase by 1.8 degrees at the mean time of the pulses."""
    settings = RATES | {"frequencies_hz": [MOVED_HZ], "pulse_rate_hz": 450.0}
    time_s = np.arange(450) / 450.0
    echoes = codes(1e-6 * np.sin(2 * np.pi * MOVED_HZ * (1 + 5e-5) * time_s))
    (shot,) = hpe.estimate(echoes, **settings).shots
    assert shot.frequency_error is not None
    assert shot.frequency_error_uncertainty is not None
    assert shot.frequency_error == pytest.approx(5e-5, abs=3.5 * shot.frequency_error_uncertainty)
    assert abs(shot.estimates[0].tracked_phase_rad) < 3 * shot.estimates[0].phase_uncertainty_rad
    assert "the clock of the motion's frequencies is 5" in " ".join(shot.warnings)
    (wrong,) = hpe.estimate(echoes, **settings, frequency_accuracy=0.0).shots
    assert wrong.frequency_error is None
    assert abs(wrong.estimates[0].tracked_phase_rad) > 5 * wrong.estimates[0].phase_uncertainty_rad
    with pytest.raises(ValueError, match="frequency_accuracy is -1"):
        hpe.estimate(echoes, **settings, frequency_accuracy=-1.0)
