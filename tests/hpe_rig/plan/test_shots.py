"""The plan's edges and the interference rule against their plain forms."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, strategies as st

from hpe_rig.bench import read_bench
from hpe_rig.plan.checks.check_result import CheckResult
from hpe_rig.plan.checks.checklist import check_plan
from hpe_rig.plan.interference import SETTLING_S, admissible_delays_s, disturbed_pulses, effective_rate_hz
from hpe_rig.plan.shots import Plan, Shot, burst_path_s, make_plan, tracking_path_s
from hpe_rig.plan.timeline import plan_text
from hpe_rig.scene import Scene, SettingsError, load_scene, parse_scene, shipped_scenes

BENCH = read_bench().bench
MUSCLE = parse_scene("bovine-muscle", shipped_scenes()["bovine-muscle-synchronous"]).scene
TABLE_1 = parse_scene("table-1", shipped_scenes()["table-1"]).scene


def muscle(delay_s: float, pulse_rate_hz: float = 4000.0, burst_length_s: float = 100e-6) -> Scene:
    tracking = MUSCLE.tracking.model_copy(update={"delay_s": delay_s, "pulse_rate_hz": pulse_rate_hz})
    assert MUSCLE.excitation is not None
    excitation = MUSCLE.excitation.model_copy(update={"burst_length_s": (burst_length_s,)})
    return MUSCLE.model_copy(update={"tracking": tracking, "excitation": excitation})


def plainly_disturbed(shot: Shot) -> list[bool]:
    """Interval by interval: pulse against toneburst, gate against toneburst, gate against every echo of it."""
    line, result = shot.timeline, []
    for pulse_s in line.pulse_onset_s:
        gate = (pulse_s + line.gate_offset_s[0], pulse_s + line.gate_offset_s[1] + line.pulse_length_s)
        hit = False
        for burst_s in line.burst_onset_s:
            busy = (burst_s, burst_s + line.burst_length_s)
            heard = (burst_s, busy[1] + line.gate_offset_s[1] + SETTLING_S)
            hit |= pulse_s < busy[1] and pulse_s + line.pulse_length_s > busy[0]
            hit |= gate[0] < heard[1] and gate[1] > heard[0]
        result.append(hit)
    return result


@given(
    delay_s=st.floats(0, 1e-3),
    pulse_rate_hz=st.sampled_from([2000.0, 2500.0, 3000.0, 3333.0, 4000.0, 5000.0]),
    burst_length_s=st.sampled_from([50e-6, 100e-6, 200e-6]),
)
def test_disturbed_pulses_are_those_whose_intervals_overlap(
    delay_s: float, pulse_rate_hz: float, burst_length_s: float
) -> None:
    shot = make_plan(muscle(delay_s, pulse_rate_hz, burst_length_s), BENCH).shots[0]
    assert disturbed_pulses(shot).tolist() == plainly_disturbed(shot)


def test_a_scene_that_pushes_nothing_has_no_toneburst_and_bursts_of_no_length() -> None:
    (shot,) = make_plan(TABLE_1, BENCH).shots
    assert shot.toneburst is None
    assert shot.timeline.burst_length_s == 0.0
    assert shot.timeline.burst_onset_s.size == 0


FAST = ((2500.0, 200e-6), (5000.0, 50e-6))
"""Two rates and two burst lengths; the other pairs are marked slow."""


@pytest.mark.parametrize(
    ("pulse_rate_hz", "burst_length_s"),
    [
        pytest.param(rate_hz, length_s, marks=() if (rate_hz, length_s) in FAST else pytest.mark.slow)
        for rate_hz in (2000.0, 2500.0, 3000.0, 4000.0, 5000.0)
        for length_s in (50e-6, 100e-6, 200e-6)
    ],
)
def test_admissible_delays_are_exactly_the_undisturbed_ones(pulse_rate_hz: float, burst_length_s: float) -> None:
    intervals = admissible_delays_s(make_plan(muscle(0.0, pulse_rate_hz, burst_length_s), BENCH).shots[0])
    period_s = 1 / pulse_rate_hz
    for delay_s in np.linspace(0.05e-6, period_s, 400, endpoint=False):
        shot = make_plan(muscle(float(delay_s + period_s), pulse_rate_hz, burst_length_s), BENCH).shots[0]
        free = not disturbed_pulses(shot).any()
        margin_s = min((abs(delay_s - edge) for interval in intervals for edge in interval), default=1.0)
        if margin_s > 1e-9:
            inside = any(low < delay_s + turn * period_s < high for low, high in intervals for turn in (0, 1))
            assert free == inside, delay_s


def test_the_papers_pulse_rates_are_the_highest_free_of_interference() -> None:
    # Sec. IV.C: f_prf = 4.0, 4.0 and 2.5 kHz for T_b = 50, 100, 200 us; at 200 us, 4 kHz has no admissible delay.
    for burst_length_s, rate_hz in ((50e-6, 4000.0), (100e-6, 4000.0), (200e-6, 2500.0)):
        assert admissible_delays_s(make_plan(muscle(0.0, rate_hz, burst_length_s), BENCH).shots[0])
    assert not admissible_delays_s(make_plan(muscle(0.0, 4000.0, 200e-6), BENCH).shots[0])


def test_edges_follow_the_wiring_cable_by_cable() -> None:
    # Shipped bench: 5 ns a cable, 10 ns to the transducer, 100 ns a triggered generator.
    trigger_s, onset_s = tracking_path_s(BENCH)
    assert trigger_s == pytest.approx(5e-9 + 100e-9 + 5e-9)
    assert onset_s == pytest.approx(trigger_s + 5e-9 + 100e-9 + 10e-9)
    assert burst_path_s(BENCH) == pytest.approx(5e-9 + 100e-9 + 5e-9 + 100e-9 + 10e-9)
    shot = make_plan(MUSCLE, BENCH).shots[0]
    np.testing.assert_allclose(np.diff(shot.timeline.burst_onset_s), 0.01, rtol=1e-12)
    np.testing.assert_allclose(np.diff(shot.timeline.pulse_onset_s), 250e-6, rtol=1e-9)
    assert shot.timeline.pulse_onset_s[0] == pytest.approx(130e-6 + onset_s)


def test_the_record_is_placed_around_the_gate() -> None:
    shot = make_plan(MUSCLE, BENCH).shots[0]
    middle = (shot.gate.start + shot.gate.stop) / 2
    assert abs(middle - shot.capture.record_samples / 2) <= 1
    assert shot.gate.stop - shot.gate.start == round(2 * 1e-3 / 1540 * 100e6)


def test_a_pulser_that_waits_for_the_trigger_delay_gets_none() -> None:
    digitizer = BENCH.digitizer.model_copy(update={"aux_waits_for_trigger_delay": True})
    bench = BENCH.model_copy(update={"digitizer": digitizer})
    plan = make_plan(MUSCLE, bench)
    assert plan.shots[0].capture.trigger_delay_samples == 0
    refused = [item for item in check_plan(MUSCLE, bench, plan) if item.level == "refused"]
    assert [item.check for item in refused] == ["gate in record"]
    assert "record_samples = 9168" in refused[0].remedy


def test_force_goes_with_the_square_of_the_drive() -> None:
    assert MUSCLE.excitation is not None
    excitation = MUSCLE.excitation.model_copy(update={"force_fraction": (1.0, 0.81, 0.49)})
    plan = make_plan(MUSCLE.model_copy(update={"excitation": excitation}), BENCH)
    drives = [shot.toneburst.amplitude_vpp for shot in plan.shots if shot.toneburst]
    np.testing.assert_allclose(drives, [1.0, 0.9, 0.7], rtol=1e-12)


def test_a_sweep_takes_every_length_force_and_repeat() -> None:
    assert MUSCLE.excitation is not None
    excitation = MUSCLE.excitation.model_copy(update={"burst_length_s": (50e-6, 100e-6), "force_fraction": (1.0, 0.5)})
    acquisition = MUSCLE.acquisition.model_copy(update={"repeats": 3})
    plan = make_plan(MUSCLE.model_copy(update={"excitation": excitation, "acquisition": acquisition}), BENCH)
    rows = [(shot.timeline.burst_length_s, shot.force_fraction, shot.repeat) for shot in plan.shots]
    assert len(set(rows)) == len(plan.shots) == 2 * 2 * 3
    assert [shot.index for shot in plan.shots] == list(range(12))


def test_a_scene_without_excitation_needs_no_excitation_generator() -> None:
    plan = make_plan(TABLE_1, BENCH)
    assert plan.roles == ("master", "tracking_train", "tracking_pulser", "digitizer")
    assert any("burst_train and toneburst" in what for what, _ in plan.omitted)
    assert plan.shots[0].timeline.time_zero_s == 0.0


def test_times_are_those_at_the_gate() -> None:
    line = make_plan(MUSCLE, BENCH).shots[0].timeline
    way_s = 70e-3 / 1540
    np.testing.assert_allclose(line.sensing_s - line.pulse_onset_s, way_s, rtol=1e-9)
    assert line.time_zero_s == pytest.approx(line.burst_onset_s[0] + way_s)


@pytest.mark.parametrize("name", sorted(shipped_scenes()))
def test_shipped_scenes_have_no_conflicts(name: str) -> None:
    scene = parse_scene(name, shipped_scenes()[name]).scene
    levels = {item.check: item.level for item in check_plan(scene, BENCH, make_plan(scene, BENCH))}
    assert "refused" not in levels.values()
    assert [check for check, level in levels.items() if level == "warning"] in ([], ["aliasing harmonics"])


def test_an_unwired_bench_has_no_path() -> None:
    assert math.isnan(BENCH.path_delay_s("master.output", "toneburst.trigger"))


@pytest.mark.parametrize(
    ("pulse_rate_hz", "expected_hz"), [(4000.0, 4000.0), (4050.0, 8100.0), (3980.0, 19900.0), (3990.0, 39900.0)]
)
def test_the_effective_rate_counts_the_distinct_instants_of_a_burst_period(
    pulse_rate_hz: float, expected_hz: float
) -> None:
    # The plain count: distinct places of all pulses in a burst period of 10 ms, over 20 periods.
    places = {round(k * 100 / pulse_rate_hz * 1e6) % 1_000_000 for k in range(round(0.2 * pulse_rate_hz))}
    assert len(places) == round(expected_hz / 100)
    assert effective_rate_hz(pulse_rate_hz, 100.0, 20) == pytest.approx(expected_hz)


def test_aliasing_harmonics_are_warned_of_unless_the_pulses_shift_from_burst_to_burst() -> None:
    def found(pulse_rate_hz: float) -> str:
        scene = muscle(130e-6, pulse_rate_hz)
        results = check_plan(scene, BENCH, make_plan(scene, BENCH))
        return next(item.level for item in results if item.check == "aliasing harmonics")

    assert found(4000.0) == "warning"
    assert found(3990.0) == "passed"


def test_the_remedy_for_aliasing_harmonics_removes_the_warning_and_causes_no_conflict() -> None:
    remedy = {"tracking.pulse_rate_hz": 3990.0, "tracking.disturbed": "skip", "processing.synchronous": False}
    aliased = check_plan(MUSCLE, BENCH, make_plan(MUSCLE, BENCH))
    text = next(item.remedy for item in aliased if item.check == "aliasing harmonics")
    assert text.startswith('tracking.pulse_rate_hz = 3990 with disturbed = "skip" and processing.synchronous = false')
    changed = MUSCLE.with_(remedy)
    assert {item.level for item in check_plan(changed, BENCH, make_plan(changed, BENCH))} == {"passed"}


def test_u_of_synchronous_pulses_is_said_to_hold_for_smooth_media_or_without_prior_not_at_all() -> None:
    def text(scene: Scene) -> str:
        results = check_plan(scene, BENCH, make_plan(scene, BENCH))
        return next(item.text for item in results if item.check == "aliasing harmonics")

    assert "u holds on average over smooth media" in text(MUSCLE)
    assert "a narrow resonance above 2000 Hz" in text(MUSCLE)
    assert "u does not include their error (the scene has no [beams])" in text(MUSCLE.with_({"beams": None}))


def test_aliasing_harmonics_are_those_of_the_shortest_toneburst() -> None:
    def text(*burst_length_s: float) -> str:
        scene = muscle(130e-6, 4000.0).with_({"excitation.burst_length_s": list(burst_length_s)})
        results = check_plan(scene, BENCH, make_plan(scene, BENCH))
        return next(item.text for item in results if item.check == "aliasing harmonics")

    assert "up to 1/T_b = 20000 Hz" in text(50e-6)
    assert text(50e-6, 100e-6) == text(100e-6, 50e-6) == text(50e-6)


@pytest.mark.parametrize(
    ("setting", "values"),
    [
        ("tracking.pulse_count", [101, 102]),
        ("acquisition.record_samples", [256, 512]),
        ("acquisition.sample_rate_hz", [50e6, 100e6]),
        ("acquisition.input_range_v", [0.4, 0.8]),
    ],
)
def test_points_whose_records_would_not_go_into_one_file_are_refused(setting: str, values: list[float]) -> None:
    def plan_of(values: list[float]) -> Plan:
        listed = f"\n[sweep]\n{setting} = {values}\n"
        return make_plan(parse_scene("a", shipped_scenes()["table-1"] + listed).scene, BENCH)

    assert len(plan_of([values[0]] * 2).shots) == 2
    with pytest.raises(SettingsError, match="its points differ in the records of a shot"):
        plan_of(values)


def test_a_sweep_of_pulse_rates_has_the_shots_of_each() -> None:
    scene = load_scene("table-1").with_({"sweep.pulse_rate_hz": [2500.0, 4000.0], "processing.window_length_s": 0.02})
    plan = make_plan(scene, BENCH)
    assert [shot.tracking_train.rate_hz for shot in plan.shots] == [2500.0, 4000.0]


def test_a_measurement_lasts_to_the_end_of_its_last_train() -> None:
    scene = load_scene("bovine-muscle").with_({"acquisition.repeats": 3, "acquisition.shot_period_s": 5.0})
    plan = make_plan(scene, BENCH)
    assert plan.duration_s == pytest.approx(2 * 5.0 + plan.shots[-1].train_end_s)
    train = replace(plan.shots[-1].tracking_train, count=2 * plan.shots[-1].tracking_train.count)
    longer = replace(plan.shots[-1], tracking_train=train)
    assert longer.train_end_s > plan.shots[0].train_end_s
    unequal = replace(plan, shots=(*plan.shots[:-1], longer))
    assert unequal.duration_s == pytest.approx(2 * 5.0 + longer.train_end_s)


def test_what_is_refused_is_said_before_what_is_warned_of() -> None:
    plan = make_plan(TABLE_1, BENCH)
    found = [CheckResult("first", "warning", "a", "b"), CheckResult("second", "refused", "c", "d")]
    text = plan_text("title", plan, found)
    assert "CANNOT BE MEASURED: 1 conflict and 1 warning" in text
    assert text.index("REFUSED second") < text.index("WARNING first")


def test_records_take_two_bytes_a_sample_of_every_input() -> None:
    plan = make_plan(TABLE_1, BENCH)
    [shot] = plan.shots
    one = replace(plan, shots=(replace(shot, capture=replace(shot.capture, monitor_range_v=None)),))
    two = replace(plan, shots=(replace(shot, capture=replace(shot.capture, monitor_range_v=4.0)),))
    assert one.record_bytes == 2 * 101 * shot.capture.record_samples
    assert two.record_bytes == 2 * one.record_bytes


@pytest.mark.parametrize("depth_m", [67e-3, 73e-3])
def test_a_pulse_whose_reference_gate_a_toneburst_reaches_is_disturbed(depth_m: float) -> None:
    scene = load_scene("limits-muscle").with_({"processing.reference_gate_depth_m": depth_m})
    plan = make_plan(scene, BENCH)
    [shot] = plan.shots
    line, speed = shot.timeline, scene.acquisition.sound_speed_m_per_s
    # Interval by interval: from the near end of the nearer gate to the far end of the deeper one, against the toneburst
    # and its echoes from as deep.
    depths_m = (70e-3, depth_m)
    far_s = 2 * (max(depths_m) + 0.5e-3) / speed
    expected = np.zeros(line.pulse_onset_s.size, np.bool_)
    for burst_s in line.burst_onset_s:
        end_s = burst_s + line.burst_length_s + far_s + SETTLING_S
        from_s = line.pulse_onset_s + 2 * (min(depths_m) - 0.5e-3) / speed
        until_s = line.pulse_onset_s + far_s + line.pulse_length_s
        expected |= (from_s < end_s) & (until_s > burst_s)
    assert disturbed_pulses(shot).tolist() == expected.tolist()
    alone = replace(shot, timeline=replace(line, reference_offset_s=None))
    assert disturbed_pulses(alone).sum() < expected.sum()
