"""Rate of the tonebursts from their carrier at the second input."""

from __future__ import annotations

import dataclasses
import shutil
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import h5py
import numpy as np
import pytest
from scipy.stats import t as student

import hpe_rig as hpe
from hpe_rig.bench import read_bench
from hpe_rig.processing.estimators import spec_of
from hpe_rig.processing.harmonics.rate_error import RateError
from hpe_rig.processing.shot_tracking import read_shot
from hpe_rig.processing.shot_warnings import clock_warnings, toneburst_warnings
from hpe_rig.processing.time_base import TimeBase, clocks_of, measured_error, timed_motion
from hpe_rig.processing.toneburst_phases import (
    ToneburstPhases,
    predicted_uncertainty,
    toneburst_phases,
    within_tonebursts,
)
from hpe_rig.result import frequency_error_text

PPM = 1e-6
STEP_S, CARRIER_HZ, BURST_HZ, BURST_S, RECORD_S, PULSE_HZ = 10e-9, 3e6, 100.0, 100e-6, 5.12e-6, 3990.0
T_PIECE = """
[[wiring]]
source = "toneburst.output"
target = "digitizer.channel_b"
delay_s = 5e-9
"""
TRUE_ERROR = (1 + 1.5e-6) / (1 - 4.3e-6) - 1
"""Rate error of the burst train by the clock of the tracking train, from the shipped scene."""


def drawn(accuracy: float, length_s: float, seed: int, jitter_s: float = 1e-9) -> tuple[ToneburstPhases, float]:
    """Return phases of records that start at ticks of the digitizer, and the true rate error; clocks are drawn."""
    rng = np.random.default_rng(seed)
    motion, tone, pulses, digitizer = accuracy * rng.standard_normal(4)
    pulse, tick_s = np.arange(round(length_s * PULSE_HZ)), STEP_S / (1 + digitizer)
    onset_s = rng.uniform(0, 1e-3) + pulse / PULSE_HZ / (1 + pulses)
    start_s = np.ceil(onset_s / tick_s) * tick_s + jitter_s * rng.standard_normal(pulse.size)
    since_s = start_s % (1 / BURST_HZ / (1 + motion))
    pulse, since_s = pulse[since_s < BURST_S - RECORD_S], since_s[since_s < BURST_S - RECORD_S]
    # 30 000 carrier periods fit between tonebursts, so that the number of the toneburst changes no phase.
    phase_rad = 2 * np.pi * CARRIER_HZ * ((1 + tone) * since_s - pulse / PULSE_HZ)
    phases = ToneburstPhases(
        pulse=pulse.astype(np.float64),
        phase_rad=np.angle(np.exp(1j * phase_rad)),
        expected=pulse.size,
        pulse_rate_hz=PULSE_HZ,
        burst_rate_hz=BURST_HZ,
        carrier_hz=CARRIER_HZ,
        sample_rate_hz=1 / STEP_S,
    )
    return phases, (1 + motion) / (1 + pulses) - 1


@pytest.mark.parametrize("length_s", [0.2, 1.0])
def test_the_95_percent_interval_holds_for_clocks_of_2_to_50_ppm(length_s: float) -> None:
    ratios, relative_u = list[float](), list[float]()
    for seed in range(120):
        accuracy = (2 * PPM, 10 * PPM, 50 * PPM)[seed % 3]
        phases, true_error = drawn(accuracy, length_s, seed)
        # The displacement has narrowed the rate error to 3 ppm.
        known = RateError(true_error + 3 * PPM * np.random.default_rng(1000 + seed).standard_normal(), 3 * PPM)
        error = phases.rate_error(known)
        assert error is not None
        # u of a slope: rounding to ticks and 1 ns of jitter.
        scatter_s = np.hypot(STEP_S / np.sqrt(12), 1e-9)
        expected_u = scatter_s / np.sqrt(phases.pulse.size) / np.std(phases.pulse / PULSE_HZ)
        relative_u.append(error.uncertainty / expected_u)
        ratios.append((error.value - true_error) / error.uncertainty / student.ppf(0.975, error.degrees_of_freedom))
    # 120 draws: 95 % with a standard error of 2 %.
    assert 0.89 <= np.mean(np.abs(ratios) < 1) <= 1
    assert 0.4 < 1.96 * np.std(ratios) < 1.25
    assert np.mean(relative_u) == pytest.approx(1, abs=0.2)


def test_rate_errors_a_carrier_period_apart_are_not_distinguished_by_the_phases_alone() -> None:
    """33.3 ppm of 10 ms are one period of 3 MHz."""
    phases, true_error = drawn(2 * PPM, 0.2, 0)
    alias = BURST_HZ / CARRIER_HZ
    for shift in (-alias, 0.0, alias):
        error = phases.rate_error(RateError(true_error + shift, 3 * PPM))
        assert error is not None
        assert error.value == pytest.approx(true_error + shift, abs=0.1 * PPM)
    assert phases.rate_error(RateError(true_error, 30 * PPM)) is None


def test_accuracies_and_displacement_that_select_different_carrier_periods_determine_no_rate() -> None:
    phases, true_error = drawn(2 * PPM, 0.2, 0)
    stated, alias = RateError(0.0, 3 * PPM), BURST_HZ / CARRIER_HZ
    assert measured_error(phases, stated, RateError(true_error, PPM)) == phases.rate_error(stated)
    assert measured_error(phases, stated, RateError(true_error + 2 * alias, PPM)) is None
    # The displacement differs by far more than its u from the nearest rate that the phases allow.
    assert measured_error(phases, RateError(0.0, 50 * PPM), RateError(true_error + 0.6 * alias, PPM)) is None
    # A wide prior selects none, the displacement does.
    error = measured_error(phases, RateError(0.0, 50 * PPM), RateError(true_error, PPM))
    assert error is not None
    assert error.value == pytest.approx(true_error, abs=4 * error.uncertainty)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> hpe.Run:
    folder = tmp_path_factory.mktemp("tonebursts")
    bench = folder / "bench.toml"
    text = read_bench().text.replace("[digitizer]", "[digitizer]\nmonitor_range_v = 4.0") + T_PIECE
    bench.write_text(text, encoding="utf-8")
    scene = hpe.load_scene("free-running-clocks").with_({"excitation.burst_count": 20, "processing.window_start_s": 0})
    return hpe.measure(scene, bench=bench, path=folder / "run.h5")


def phases_of(
    run: hpe.Run, change: Any = lambda codes, _: codes, damaged: Any = (), **shot_changes: Any
) -> ToneburstPhases | None:
    """Return the phases in ``run`` with the codes (record, sample) of the second input changed by ``change``.

    The records ``damaged`` fail their checksums.
    """
    shot, stored = dataclasses.replace(run.plan.shots[0], **shot_changes), run.stored

    def blocks(index: int, size: int, name: str) -> Iterator[tuple[int, np.ndarray, np.ndarray]]:
        for first, codes in stored.records.chunks(index, size, name):
            yield first, change(codes.copy(), first), np.isin(np.arange(first, first + len(codes)), damaged)

    records = SimpleNamespace(shape=stored.records.shape, blocks=blocks)
    return toneburst_phases(shot, SimpleNamespace(records=records), stored.records.placement(0))  # type: ignore[arg-type]


def check_rate(phases: ToneburstPhases | None, records: int) -> None:
    assert phases is not None
    assert (phases.pulse.size, phases.expected) == (records, 8)
    error = phases.rate_error(RateError(0.0, 5 * PPM))
    assert error is not None
    assert error.value == pytest.approx(TRUE_ERROR, abs=student.ppf(0.975, records - 2) * error.uncertainty)


def test_a_run_on_the_twin_states_the_rate_that_its_tonebursts_have(run: hpe.Run) -> None:
    (shot,) = run.estimate().shots
    assert shot.frequency_error is not None
    assert shot.frequency_error_uncertainty is not None
    # Rounding to samples of 10 ns, rms 2.9 ns, in 8 records: 0.02 ppm; the displacement gives 2 ppm.
    assert shot.frequency_error_uncertainty == pytest.approx(0.02 * PPM, rel=0.5)
    assert shot.frequency_error == pytest.approx(TRUE_ERROR, abs=2.5 * shot.frequency_error_uncertainty)
    assert "tonebursts at the second input" in frequency_error_text(shot)
    assert not [text for text in shot.warnings if "second input" in text]


def test_missing_and_clipped_tonebursts_leave_the_rate_right(run: hpe.Run) -> None:
    check_rate(phases_of(run), 8)
    limit = int(np.abs(run.stored.records.monitor(0).codes).max()) // 3  # type: ignore[union-attr]
    check_rate(phases_of(run, lambda codes, _: np.clip(codes, -limit, limit)), 8)
    missing = int(within_tonebursts(run.plan.shots[0])[2])

    def without_one(codes: np.ndarray, first: int) -> np.ndarray:
        codes[missing - first : missing - first + 1] = 0
        return codes

    check_rate(phases_of(run, without_one), 7)


def test_a_damaged_record_is_left_out_and_a_warning_says_so(run: hpe.Run) -> None:
    phases = phases_of(run, damaged=within_tonebursts(run.plan.shots[0])[2:3])
    check_rate(phases, 7)
    (text,) = toneburst_warnings(phases, TimeBase(RateError(), RateError(), None))
    assert text.startswith("1 records of the second input fail their checksums")


def test_a_shot_is_estimated_with_a_warning_if_a_part_of_the_second_input_is_damaged(
    run: hpe.Run, tmp_path: Path
) -> None:
    path = Path(shutil.copy(run.path, tmp_path / "damaged.h5"))
    with h5py.File(path) as file:
        monitor = file["records/monitor"]
        part = int(within_tonebursts(run.plan.shots[0])[-1]) // monitor.chunks[1]
        place = monitor.id.get_chunk_info_by_coord((0, part * monitor.chunks[1], 0)).byte_offset
    with path.open("r+b") as raw:
        raw.seek(place + 5)
        raw.write(b"\x55\xaa\x55")
    (shot,) = hpe.open_run(path).estimate().shots
    assert any("records of the second input fail their checksums" in text for text in shot.warnings)


def test_noise_without_tonebursts_measures_nothing_and_a_warning_says_so(run: hpe.Run) -> None:
    rng = np.random.default_rng(1)
    phases = phases_of(run, lambda codes, _: rng.integers(-3, 4, codes.shape).astype(np.int16))
    assert phases is not None
    assert phases.pulse.size == 0
    clocks = RateError(0.0, 5 * PPM)
    assert phases.rate_error(clocks) is None
    (text,) = toneburst_warnings(phases, TimeBase(clocks, clocks, None))
    assert "a toneburst in 0 records, where 8 are expected" in text
    assert not list(toneburst_warnings(phases, TimeBase(RateError(), RateError(), None)))


def test_records_that_may_hold_two_tonebursts_are_not_used(run: hpe.Run) -> None:
    train = run.plan.shots[0].burst_train
    assert train is not None
    # 5.12 us of record, and 4 us between tonebursts of 100 us.
    assert phases_of(run, burst_train=dataclasses.replace(train, rate_hz=1 / 104e-6)) is None


def test_a_record_longer_than_a_toneburst_is_not_used(run: hpe.Run) -> None:
    timeline = run.plan.shots[0].timeline
    shot = dataclasses.replace(run.plan.shots[0], timeline=dataclasses.replace(timeline, burst_length_s=5e-6))
    assert phases_of(run, timeline=shot.timeline) is None
    assert within_tonebursts(shot).size == 0
    assert predicted_uncertainty(shot, PPM) is None


def test_records_of_one_toneburst_determine_no_rate() -> None:
    phases, true_error = drawn(2 * PPM, 0.2, 0)
    in_one = dataclasses.replace(phases, pulse=np.arange(8.0), phase_rad=np.zeros(8))
    assert in_one.rate_error(RateError(true_error, 30 * PPM)) is None


def test_records_in_every_second_toneburst_halve_the_largest_uncertainty_that_selects_a_rate(run: hpe.Run) -> None:
    """Rate errors 33.3 ppm apart have the same phases, or 16.7 ppm if two periods are between the tonebursts."""
    shot = run.plan.shots[0]
    train = dataclasses.replace(shot.tracking_train, rate_hz=4050.0)
    onset_s = shot.timeline.burst_onset_s[0] + 50e-6 + np.arange(800) / 4050
    timeline = dataclasses.replace(shot.timeline, pulse_onset_s=onset_s - shot.timeline.record_offset_s[0])
    every_second = dataclasses.replace(shot, tracking_train=train, timeline=timeline)
    for changed, largest_u in ((shot, 33.3 * PPM / 6), (every_second, 16.7 * PPM / 6)):
        assert within_tonebursts(changed).size >= 8
        assert predicted_uncertainty(changed, 0.98 * largest_u) is not None
        assert predicted_uncertainty(changed, 1.02 * largest_u) is None


def test_with_a_linear_drift_a_rate_within_the_accuracies_is_no_contradiction(run: hpe.Run) -> None:
    scene, shot = run.scene.with_({"processing.drift": "linear"}), run.plan.shots[0]
    records, clocks = read_shot(scene, shot, run.stored), clocks_of(scene, run.stored)
    _, time_base = timed_motion(scene, shot, records, spec_of("coherent").motion, clocks, None)
    assert time_base.by_tonebursts is not None
    assert time_base.by_pulses.value == pytest.approx(TRUE_ERROR, abs=0.1 * PPM)
    assert not time_base.exceeds_accuracy


def test_bursts_beyond_the_stated_accuracies_are_named_also_if_the_pulses_are(run: hpe.Run) -> None:
    scene, shot, (found,) = run.scene, run.plan.shots[0], run.estimate().shots
    records, motion = read_shot(scene, shot, run.stored), spec_of("coherent").motion
    texts = []
    for clocks in (np.eye(3) * (0.05 * PPM) ** 2, clocks_of(scene, run.stored)):
        _, time_base = timed_motion(scene, shot, records, motion, clocks, None)
        assert time_base.by_tonebursts is not None
        warnings = clock_warnings(time_base, found.estimates, shot.timeline.pulse_onset_s, True)
        texts.append([text for text in warnings if "clock_accuracy" in text])
    by_digitizer, bursts = texts[0]
    assert by_digitizer.startswith("by the digitizer's clock the tracking train is 6.0")
    assert bursts.startswith("the burst generator's clock is 5.799 +- 0.022 ppm fast")
    # 5.8 ppm between clocks of 2 ppm are 2.05 u.
    assert not texts[1]
