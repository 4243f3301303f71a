"""The first tracking pulse of a shot: trigger times, tonebursts in the records, or an uncertainty of whole periods."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hpe_rig import load_scene, measure
from hpe_rig.bench import read_bench
from hpe_rig.moduli import Source
from hpe_rig.moduli.run_vibrations import vibrations_of
from hpe_rig.plan import CLEAN, INSIDE, NEAR, pulse_kinds
from hpe_rig.plan.shots import Shot, make_plan
from hpe_rig.processing.first_pulse import PulseAssignment, assign_pulses
from hpe_rig.result import ShotResult
from hpe_rig.store import Placement, StoreError, place_records

FAULTS = "simulation.instruments.trigger_faults"
PERIODS_RAD = 2 * math.pi / 4000
NPT = 'acquisition_mode = "npt"'
T_PIECE = """
[[wiring]]
source = "toneburst.output"
target = "digitizer.channel_b"
delay_s = 5e-9
"""


@pytest.fixture(scope="module")
def muscle() -> Shot:
    return make_plan(load_scene("bovine-muscle"), read_bench().bench).shots[0]


def bench(folder: Path, lines: str, cables: str = "") -> Path:
    path = folder / "bench.toml"
    path.write_text(read_bench().text.replace("[digitizer]", f"[digitizer]\n{lines}") + cables, encoding="utf-8")
    return path


def estimated(folder: Path, scene: str, bench_file: Path | None = None, **faults: Any) -> ShotResult:
    settings = {f"{FAULTS}.{name}": value for name, value in faults.items()}
    run = measure(load_scene(scene).with_(settings), bench=bench_file, path=folder / "run.h5")
    return run.estimate().shots[0]


def phase_errors(shot: ShotResult) -> Iterator[tuple[float, float]]:
    """Yield error and half width of the 95 % interval of each phase."""
    for item in shot.estimates:
        assert item.true_phase_rad is not None
        yield math.remainder(item.phase_rad - item.true_phase_rad, 2 * math.pi), item.interval_95_rad


def test_a_lost_first_trigger_without_tonebursts_is_part_of_the_uncertainty(tmp_path: Path) -> None:
    shot = estimated(tmp_path, "table-1", lost=[0])
    (error_rad, interval_rad) = next(phase_errors(shot))
    assert error_rad == pytest.approx(200 * PERIODS_RAD, rel=0.02)
    assert abs(error_rad) < interval_rad < 2 * error_rad
    assert [text for text in shot.warnings if "a trigger was lost, and it is unknown which" in text]
    assert [item.source for item in shot.estimates[0].components].count("first pulse") == 1


@pytest.mark.parametrize(
    ("lines", "cables", "faults", "remark"),
    [
        pytest.param("", "", {"lost": [0]}, "the first trigger was lost", marks=pytest.mark.slow),
        ("monitor_range_v = 4.0", T_PIECE, {"lost": [0, 1, 300]}, "the first 2 triggers were lost"),
        pytest.param(NPT, "", {"lost": [300]}, "a trigger was lost between record", marks=pytest.mark.slow),
        pytest.param(NPT, "", {"stray_s": [0.1001]}, "a trigger was too many", marks=pytest.mark.slow),
        pytest.param(NPT, "", {"lost": [0]}, "the first trigger was lost", marks=pytest.mark.slow),
    ],
)
def test_tonebursts_in_the_records_show_which_pulse_came_first(
    tmp_path: Path, lines: str, cables: str, faults: dict[str, Any], remark: str
) -> None:
    shot = estimated(tmp_path, "bovine-muscle", bench(tmp_path, lines, cables), **faults)
    assert [text for text in shot.warnings if remark in text]
    for error_rad, interval_rad in phase_errors(shot):
        assert abs(error_rad) < 1.2 * interval_rad
        # A pulse period is 9 degrees at 100 Hz.
        assert interval_rad < math.radians(5)
    assert all(item.source != "first pulse" for estimate in shot.estimates for item in estimate.components)


@pytest.mark.parametrize(
    "faults",
    [
        {"stamp_jumps": [{"record": 31, "jump_s": 0.25}]},
        pytest.param({"stray_s": [10.125e-3]}, marks=pytest.mark.slow),
        pytest.param({"frozen_stamps": [20, 60]}, marks=pytest.mark.slow),
    ],
)
def test_faults_that_the_trigger_times_reveal_change_no_result(tmp_path: Path, faults: dict[str, Any]) -> None:
    shot = estimated(tmp_path, "table-1", **faults)
    assert [text for text in shot.warnings if "stray trigger" in text or "trigger times" in text]
    for error_rad, interval_rad in phase_errors(shot):
        assert abs(error_rad) < 1.2 * interval_rad < math.radians(1)


def test_kinds_of_pulses_follow_the_tonebursts(muscle: Shot) -> None:
    kinds, line = pulse_kinds(muscle), muscle.timeline
    start_s = line.pulse_onset_s + line.record_offset_s[0]
    for kind in (NEAR, INSIDE):
        assert 0 < np.count_nonzero(kinds == kind) < 0.1 * kinds.size
    for pulse in np.flatnonzero(kinds == INSIDE):
        after_s = start_s[pulse] - line.burst_onset_s
        assert np.any((after_s > -6e-6) & (after_s < line.burst_length_s))
    assert set(pulse_kinds(make_plan(load_scene("table-1"), read_bench().bench).shots[0])) == {CLEAN}


class Records:
    """Records of one shot in memory, with the interface of stored ones."""

    def __init__(self, shot: Shot, pulse: np.ndarray, time_s: np.ndarray, disturbed: np.ndarray, seed: int) -> None:
        self.shape = (1, shot.capture.record_count, 64)
        padding = self.shape[1] - pulse.size
        delivered = np.arange(self.shape[1]) < pulse.size
        self.by_times = place_records(delivered, np.pad(time_s, (0, padding), constant_values=np.nan), 3990.0)
        random = np.random.default_rng(seed)
        self.codes = np.round(300 * random.standard_normal(self.shape[1:])).astype(np.int16)
        self.codes[: pulse.size][disturbed] *= 20

    def placement(self, shot: int) -> Placement:
        return self.by_times

    def chunks(self, shot: int, pulses: int, name: str) -> Iterator[tuple[int, np.ndarray]]:
        if name != "echo":
            raise StoreError(name)
        yield 0, self.codes


class Stored:
    """One complete shot of a run file."""

    shot_complete, imported = np.ones(1, bool), False

    def __init__(self, records: Records) -> None:
        self.records = records


def drawn(shot: Shot, seed: int, timed: bool, visible: bool) -> tuple[np.ndarray, PulseAssignment]:
    """Return the pulse of each delivered record, -1 for stray ones, and the assignment, for drawn faults."""
    random = np.random.default_rng(seed)
    count = shot.capture.record_count
    pulse = np.arange(count, dtype=float)[random.integers(0, 4) :]
    pulse = np.delete(pulse, random.integers(40, pulse.size, random.integers(0, 3) if timed else 0))
    if random.random() < 0.5:
        pulse = pulse[: pulse.size - random.integers(0, 30)]
    if timed and pulse[0] == 0 and random.random() < 0.5:
        pulse = np.sort([*pulse, *(random.integers(20, 600, 2) + random.uniform(0.1, 0.9, 2))])[:count]
    time_s = np.full(pulse.size, np.nan)
    if timed:
        time_s = 0.2 + pulse / 3990.0 * (1 + random.uniform(-1e-4, 1e-4))
        if random.random() < 0.5:
            time_s[random.integers(2, pulse.size - 2) :] += random.choice([0.25, -0.25, 1.3e-3, -86.1])
    train_pulse = np.where(pulse % 1 == 0, pulse, -1).astype(int)
    near = pulse_kinds(shot)[np.maximum(train_pulse, 0)]
    disturbed = visible & (train_pulse >= 0) & ((near == INSIDE) | ((near == NEAR) & (random.random(near.size) < 0.5)))
    return train_pulse, assign_pulses(shot, Stored(Records(shot, pulse, time_s, disturbed, seed)))  # type: ignore[arg-type]


@pytest.mark.parametrize("visible", [True, pytest.param(False, marks=pytest.mark.slow)])
@pytest.mark.parametrize("timed", [pytest.param(True, marks=pytest.mark.slow), False])
@pytest.mark.parametrize("draws", [5, pytest.param(400, marks=pytest.mark.slow)])
def test_drawn_faults_are_corrected_or_stated(muscle: Shot, draws: int, timed: bool, visible: bool) -> None:
    corrected = 0
    for seed in range(draws):
        pulse, assignment = drawn(muscle, seed, timed, visible)
        assigned = assignment.placement.pulse[: pulse.size]
        later = pulse[assigned >= 0] - assigned[assigned >= 0]
        # Every possible shift is stated; a shift within the shot concerns a part of it.
        stated = range(max(assignment.shifts) + 1) if assignment.within_shot else assignment.shifts
        assert set(later.tolist()) <= set(stated), seed
        assert assignment.within_shot or np.unique(later).size == 1, seed
        assert np.count_nonzero(assigned >= 0) > 0.6 * pulse.size, seed
        corrected += bool(pulse[0] > 0 and not later.any())
    assert not visible or corrected > draws / 3


@pytest.mark.parametrize(
    ("lost", "jump_periods", "remark"),
    [
        (50, 0.9999, "a trigger was lost before record 51"),
        (400, 0.9999, "a trigger was lost between record 400 and 401"),
        (400, -1.0, "a trigger was lost between record"),
    ],
)
def test_a_trigger_lost_at_a_jump_of_the_times_shifts_no_record(
    muscle: Shot, lost: int, jump_periods: float, remark: str
) -> None:
    pulse = np.delete(np.arange(muscle.capture.record_count), lost)
    time_s = 0.2 + (pulse + np.where(pulse > lost, jump_periods, 0.0)) / 3990.0
    stored = Stored(Records(muscle, pulse, time_s, pulse_kinds(muscle)[pulse] == INSIDE, 1))
    assignment = assign_pulses(muscle, stored)  # type: ignore[arg-type]
    assigned = assignment.placement.pulse[: pulse.size]
    placed = assigned >= 0
    np.testing.assert_array_equal(assigned[placed], pulse[placed])
    assert np.count_nonzero(placed) > 0.6 * pulse.size
    assert assignment.shifts == (0,)
    assert assignment.remarks[-1].startswith(remark)


def test_an_aborted_shot_has_lost_no_trigger(muscle: Shot) -> None:
    pulse = np.arange(300)
    stored = Stored(Records(muscle, pulse, 0.2 + pulse / 3990.0, np.zeros(300, bool), 1))
    assert assign_pulses(muscle, stored).shifts == tuple(range(499))  # type: ignore[arg-type]
    stored.shot_complete = np.zeros(1, bool)
    assert assign_pulses(muscle, stored).shifts == (0,)  # type: ignore[arg-type]


def test_amplitudes_that_depend_on_the_first_pulse_through_the_prior_are_uncertain(tmp_path: Path) -> None:
    """The medium prior relates phases to media: phases off by a pulse period shift its amplitudes by 7 %."""
    run = measure(load_scene("bovine-muscle-synchronous").with_({f"{FAULTS}.lost": [0]}), path=tmp_path / "run.h5")
    shot = run.estimate().shots[0]
    _, omitted = vibrations_of([Source("run", run.scene, run.plan, run.stored)])
    assert "shot 1, triggers were lost, and it is unknown which pulse came first" in omitted[0]
    for estimate, (error_rad, interval_rad) in zip(shot.estimates, phase_errors(shot), strict=True):
        assert abs(error_rad) < interval_rad
        assert estimate.true_amplitude_m is not None
        error_m = estimate.amplitude_m - estimate.true_amplitude_m
        assert 0.02 * estimate.true_amplitude_m < abs(error_m) < estimate.interval_95_m


def test_the_motion_of_a_run_follows_the_same_assignment(tmp_path: Path) -> None:
    scene = load_scene("bovine-muscle").with_({"excitation.burst_count": 8, "processing.window_start_s": 40e-3})
    lost = scene.with_({f"{FAULTS}.lost": [0, 1, 2]})
    complete, shifted = (measure(item, path=tmp_path / f"{name}.h5") for item, name in ((scene, "a"), (lost, "b")))
    difference_m = shifted.displacement_m(0)[3:] - complete.displacement_m(0)[3:]
    assert np.isnan(shifted.displacement_m(0)[:3]).all()
    # Noise is that of other pulses; a shift by three pulses would be 30 % of the motion.
    assert np.nanstd(difference_m) < 0.1 * np.nanstd(complete.displacement_m(0))
