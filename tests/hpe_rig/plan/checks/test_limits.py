"""Limits of the checks: a value exactly at a limit and the next one beyond it, on the side each is said to be."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

from hpe_rig.bench import BenchFile, read_bench
from hpe_rig.plan.checks.acoustic_output import AcousticOutput
from hpe_rig.plan.checks.checklist import check_plan
from hpe_rig.plan.checks.digitizer import board, gate_in_record, memory
from hpe_rig.plan.checks.timing import depth, periods, record_in_period, tracking_train
from hpe_rig.plan.interference import admissible_delays_s, disturbed_pulses, forbidden_window_s
from hpe_rig.plan.shots import Plan, Shot, make_plan, reference_gate
from hpe_rig.scene import Scene, parse_scene, shipped_scenes

BENCH = read_bench().bench
MUSCLE = parse_scene("bovine-muscle", shipped_scenes()["bovine-muscle-synchronous"]).scene
PERIOD_S = 1 / 4000.0


def above(value: float) -> float:
    return math.nextafter(value, math.inf)


def below(value: float) -> float:
    return math.nextafter(value, -math.inf)


def limited(**limits: float) -> BenchFile:
    return BENCH.model_copy(update={"limits": BENCH.limits.model_copy(update=limits)})


def levels(scene: Scene, bench: BenchFile = BENCH) -> dict[str, str]:
    return {result.check: result.level for result in check_plan(scene, bench, make_plan(scene, bench))}


def with_shot(**changes: object) -> Plan:
    """Return the plan of one shot with fields of its capture or timeline replaced."""
    plan = make_plan(MUSCLE, BENCH)
    shot = plan.shots[0]
    parts = {
        name: replace(part, **{key: value for key, value in changes.items() if key in part.__slots__})
        for name, part in (("capture", shot.capture), ("timeline", shot.timeline))
    }
    return replace(plan, shots=(replace(shot, **parts),))


def found(results: object) -> dict[str, str]:
    return {result.check: result.level for result in results}  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("limit", "value", "check"),
    [
        ("max_duty", 100e-6 * 100.0, "duty"),
        ("max_burst_length_s", 100e-6, "burst length"),
        ("max_drive_vpp", BENCH.limits.full_drive_vpp, "drive"),
    ],
)
def test_a_toneburst_at_a_limit_of_the_bench_is_allowed_and_above_it_refused(
    limit: str, value: float, check: str
) -> None:
    pulser = BENCH.generators.tracking_pulser.model_copy(update={"amplitude_vpp": 0.5 * value})
    generators = BENCH.generators.model_copy(update={"tracking_pulser": pulser})
    for limit_value, level in ((value, "passed"), (below(value), "refused")):
        bench = limited(**{limit: limit_value}).model_copy(update={"generators": generators})
        results = check_plan(MUSCLE, bench, make_plan(MUSCLE, bench))
        assert level in [result.level for result in results if result.check == check]
        assert (level == "refused") == any(result.level == "refused" for result in results if result.check == check)


def test_as_many_tonebursts_as_the_bench_allows_are_allowed_and_no_more() -> None:
    assert levels(MUSCLE, limited(max_bursts=20))["bursts"] == "passed"
    assert levels(MUSCLE, limited(max_bursts=19))["bursts"] == "refused"


@pytest.mark.parametrize(
    ("index", "sppa", "spta", "within"),
    [
        (1.9, 2e9, 7200.0, True),
        (5.0, 1.9e6, 7200.0, True),
        (above(1.9), above(1.9e6), 7200.0, False),
        (1.9, 1.9e6, above(7200.0), False),
    ],
)
def test_acoustic_output_at_its_limits_is_within_them(index: float, sppa: float, spta: float, within: bool) -> None:
    limits = BENCH.limits.model_copy(
        update={"max_mechanical_index": 1.9, "max_sppa_w_per_m2": 1.9e6, "max_spta_w_per_m2": 7200.0}
    )
    assert AcousticOutput(index, sppa, spta).within(limits) is within


def test_a_record_must_end_before_the_next_pulse_and_a_pulse_before_its_period() -> None:
    for samples, level in ((25_000, "refused"), (24_999, "passed")):
        plan = with_shot(trigger_delay_samples=20_000, record_samples=samples - 20_000)
        assert found(record_in_period(MUSCLE, BENCH, plan)) == {"record in period": level}
    assert found(tracking_train(MUSCLE, BENCH, with_shot(pulse_length_s=PERIOD_S))) == {"pulse length": "refused"}
    assert found(tracking_train(MUSCLE, BENCH, with_shot(pulse_length_s=below(PERIOD_S)))) == {}


def test_four_tracking_pulses_are_the_fewest() -> None:
    assert found(tracking_train(MUSCLE, BENCH, with_shot(record_count=4))) == {}
    assert found(tracking_train(MUSCLE, BENCH, with_shot(record_count=3))) == {"pulse count": "refused"}


def test_echoes_may_be_back_at_the_next_pulse_but_not_after_it() -> None:
    acquisition = MUSCLE.acquisition
    highest_hz = acquisition.sound_speed_m_per_s / (2 * (acquisition.gate_depth_m + acquisition.gate_length_m / 2))
    for rate_hz, level in ((highest_hz, "passed"), (above(highest_hz), "refused")):
        tracking = MUSCLE.tracking.model_copy(update={"pulse_rate_hz": rate_hz})
        scene = MUSCLE.model_copy(update={"tracking": tracking})
        assert found(depth(scene, BENCH, with_shot()))["depth"] == level


def test_a_carrier_at_half_the_sampling_rate_is_refused() -> None:
    rate_hz = with_shot().shots[0].capture.sample_rate_hz
    for carrier_hz, level in ((rate_hz / 2, "refused"), (below(rate_hz / 2), "passed")):
        scene = MUSCLE.model_copy(update={"tracking": MUSCLE.tracking.model_copy(update={"carrier_hz": carrier_hz})})
        assert found(board(scene, BENCH, with_shot()))["carrier"] == level


def test_a_gate_that_begins_at_the_transducer_is_refused() -> None:
    length_m = MUSCLE.acquisition.gate_length_m
    for depth_m, level in ((length_m / 2, "refused"), (above(length_m / 2), "passed")):
        acquisition = MUSCLE.acquisition.model_copy(update={"gate_depth_m": depth_m})
        scene = MUSCLE.model_copy(update={"acquisition": acquisition})
        assert found(depth(scene, BENCH, with_shot()))["gate depth"] == level


def test_the_next_shot_must_come_after_the_trains_end() -> None:
    plan = with_shot()
    end_s = plan.shots[0].train_end_s
    for period_s, level in ((end_s, "refused"), (above(end_s), "passed")):
        acquisition = MUSCLE.acquisition.model_copy(update={"shot_period_s": period_s})
        scene = MUSCLE.model_copy(update={"acquisition": acquisition})
        assert found(periods(scene, BENCH, plan))["master period"] == level


def test_half_the_pulse_rate_itself_is_no_wanted_frequency() -> None:
    for highest_hz, level in ((2000.0, "refused"), (1900.0, "passed")):
        scene = MUSCLE.with_({"processing.frequencies_hz": [100.0, highest_hz]})
        assert levels(scene)["aliasing"] == level


def gate_of(start: int, stop: int, samples: int, **processing: float) -> Mapping[str, str]:
    """Return the checks of a gate that takes these samples of the record."""
    offset_s = (start / 100e6, stop / 100e6)
    plan = with_shot(gate_offset_s=offset_s, record_offset_s=(0.0, samples / 100e6), record_samples=samples)
    assert plan.shots[0].gate == slice(start, stop)
    scene = MUSCLE.model_copy(update={"processing": MUSCLE.processing.model_copy(update=processing)})
    return found(gate_in_record(scene, BENCH, plan))


def test_a_gate_may_fill_its_record_and_not_leave_it() -> None:
    assert gate_of(0, 256, 256)["gate in record"] == "passed"
    assert gate_of(-1, 255, 256)["gate in record"] == "refused"
    assert gate_of(1, 257, 256)["gate in record"] == "refused"


def test_a_gate_holds_at_least_eight_samples_and_two_periods_of_the_carrier() -> None:
    assert gate_of(10, 18, 256)["gate samples"] == "passed"
    assert gate_of(10, 17, 256)["gate samples"] == "refused"
    # 100 MS/s: at 5 MHz two periods are 40 samples.
    scene = MUSCLE.model_copy(update={"tracking": MUSCLE.tracking.model_copy(update={"carrier_hz": 5e6})})
    for length, refused in ((40, False), (39, True)):
        plan = with_shot(gate_offset_s=(10 / 100e6, (10 + length) / 100e6), record_offset_s=(0.0, 256 / 100e6))
        assert ("gate periods" in found(gate_in_record(scene, BENCH, plan))) is refused


def test_a_reference_gate_may_end_with_its_record_and_not_after_it() -> None:
    # In 1540 m/s and at 100 MS/s 77 um are ten samples.
    depth_m, length_m = MUSCLE.acquisition.gate_depth_m, MUSCLE.acquisition.gate_length_m
    length = round(2 * length_m / 1540 * 100e6)
    for start in (0, 100):
        for spare, level in ((10, "passed"), (9, "refused")):
            later = gate_of(start, start + length, start + length + spare, reference_gate_depth_m=depth_m + 77e-6)
            assert later["reference gate in record"] == level
    for start, level in ((10, "passed"), (9, "refused")):
        earlier = gate_of(start, start + length, 1024, reference_gate_depth_m=depth_m - 77e-6)
        assert earlier["reference gate in record"] == level


@pytest.mark.parametrize("depth_m", [60e-3, 70e-3, 75e-3])
@pytest.mark.parametrize("length_m", [None, 0.5e-3, 3e-3])
def test_the_reference_gate_stands_around_its_depth(depth_m: float, length_m: float | None) -> None:
    keys = {"reference_gate_depth_m": depth_m, "reference_gate_length_m": length_m}
    scene = MUSCLE.model_copy(update={"processing": MUSCLE.processing.model_copy(update=keys)})
    shot = make_plan(scene, BENCH).shots[0]
    gate = reference_gate(scene, shot)
    assert gate is not None
    # The plain form: when an echo from either end of it comes back, counted from the record's first sample.
    half_m = (length_m or scene.acquisition.gate_length_m) / 2
    for sample, end_m in ((gate.start, depth_m - half_m), (gate.stop, depth_m + half_m)):
        assert abs(sample - (2 * end_m / 1540 - shot.timeline.record_offset_s[0]) * 100e6) < 2


def test_as_many_records_as_the_memory_holds_fit_into_it() -> None:
    board = BENCH.digitizer.model_copy(update={"dual_port_memory": False, "acquisition_mode": "single_port"})
    bench = BENCH.model_copy(update={"digitizer": board})
    held = min(board.max_records, board.board_model.most_records(board.samples_per_channel, 1024))
    for count, level in ((held, "passed"), (held + 1, "refused")):
        plan = with_shot(record_count=count, record_samples=1024)
        assert found(memory(MUSCLE, bench, plan))["memory"] == level


def shot_with_pulse_at(pulse_s: float) -> Shot:
    return with_shot(burst_onset_s=np.zeros(1), pulse_onset_s=np.array([pulse_s])).shots[0]


def test_a_pulse_at_either_end_of_the_forbidden_window_is_undisturbed() -> None:
    start_s, end_s = forbidden_window_s(shot_with_pulse_at(0.0))
    for free_s, disturbed_s in ((start_s, above(start_s)), (end_s, below(end_s))):
        assert not disturbed_pulses(shot_with_pulse_at(free_s)).any()
        assert disturbed_pulses(shot_with_pulse_at(disturbed_s)).all()


def delayed(delay_s: float, burst_length_s: float = 100e-6) -> Scene:
    return MUSCLE.with_({"tracking.delay_s": delay_s, "excitation.burst_length_s": [burst_length_s]})


@pytest.mark.parametrize("delay_s", [10e-6, 37e-6, 130e-6, 1.01e-3])
def test_free_delays_do_not_depend_on_the_delay_that_the_scene_has(delay_s: float) -> None:
    expected = admissible_delays_s(make_plan(delayed(0.0), BENCH).shots[0])
    np.testing.assert_allclose(
        admissible_delays_s(make_plan(delayed(delay_s), BENCH).shots[0]), expected, rtol=0, atol=2e-12
    )


@pytest.mark.parametrize("delay_s", [0.0, 20e-6, 230e-6, 1.23e-3])
@pytest.mark.parametrize("burst_length_s", [50e-6, 100e-6])
def test_every_delay_that_is_suggested_is_free_at_its_ends_and_not_a_microsecond_beyond(
    delay_s: float, burst_length_s: float
) -> None:
    scene = delayed(delay_s, burst_length_s)
    (result,) = (r for r in check_plan(scene, BENCH, make_plan(scene, BENCH)) if r.check == "interference")
    assert result.level == "refused"
    intervals = re.findall(r"([\d.]+) to ([\d.]+) us", result.remedy)
    assert intervals
    for low_us, high_us in intervals:
        for good_us, bad_us in ((float(low_us), float(low_us) - 1), (float(high_us), float(high_us) + 1)):
            # One period later, so that the delay before the first stays above zero.
            good, bad = (delayed((us + 250) * 1e-6, burst_length_s) for us in (good_us, bad_us))
            assert levels(good)["interference"] == "passed"
            assert levels(bad)["interference"] == "refused"
