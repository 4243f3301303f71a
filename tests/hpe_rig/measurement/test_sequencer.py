"""The sequencer alone: programmed settings, times of shots, calls of the observer."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise

import pytest

from drivers.interfaces import InstrumentError
from hpe_rig.bench import Bench, open_bench
from hpe_rig.measurement import Progress, Setup, ShotBlock, Step, acquire, prepare_text, program_shot, sequencer
from hpe_rig.measurement.sequencer import ShotReady, ShotRows
from hpe_rig.scene import shipped_scenes

# Two tonebursts and 16 pulses on prescribed motion: every instrument is used, the physics costs nothing.
SHORT = (
    ("burst_count = 20", "burst_count = 2"),
    ("pulse_rate_hz = 4000.0", "pulse_rate_hz = 1000.0"),
    ("delay_s = 130e-6", "delay_s = 130e-6\npulse_count = 16"),
    ("window_start_s = 50e-3", "frequencies_hz = [100.0] #"),
    ("[simulation.specimen]", "[[simulation.motion]]\nfrequency_hz = 100.0\namplitude_m = 1e-6 #"),
    ('preset = "bovine_muscle" ', "#"),
    ("force_density_n_per_m3 = 2.2e6 ", "#"),
    ("[simulation.receiver]", "[simulation.scatterers]\nper_cell = 0.05\n[simulation.receiver]"),
    ("[acquisition]\n", "[acquisition]\nrepeats = 3\n"),
)


@pytest.fixture(scope="module")
def setup() -> Setup:
    text = shipped_scenes()["bovine-muscle-synchronous"]
    for old, new in SHORT:
        assert old in text, old
        text = text.replace(old, new)
    return prepare_text("short", text)


@pytest.mark.parametrize("period_s", [0.0, 7.3])
def test_shots_fire_a_shot_period_apart_where_the_instruments_are_ready_by_then(setup: Setup, period_s: float) -> None:
    fired_s, waits = [], Counter[int]()
    with open_bench(setup.scene.scene, setup.bench.bench, setup.plan.roles) as bench:

        def observe(progress: Progress) -> None:
            if progress.step is Step.FIRE:
                fired_s.append(bench.clock.now_s())
            waits[progress.shot.index] += progress.step is Step.WAIT

        begun_s = bench.clock.now_s()
        for _ in acquire(replace(setup.plan, shot_period_s=period_s), bench, observe):
            pass
    apart_s = [later - earlier for earlier, later in pairwise(fired_s)]
    # What comes between takes less than 0.1 s of the twin: nobody waits for the first shot, nor for one that is due.
    assert fired_s[0] - begun_s < 1.0
    assert waits[0] == 0
    if period_s:
        assert apart_s == pytest.approx([period_s] * 2, abs=1e-6)
        assert all(waits[shot] for shot in (1, 2))
    else:
        assert 0 < min(apart_s) <= max(apart_s) < 1.0
        assert not sum(waits.values())


def test_the_observer_is_called_five_times_a_second_while_a_shot_waits(setup: Setup) -> None:
    asked_s, fired_s = list[float](), list[float]()
    with open_bench(setup.scene.scene, setup.bench.bench, setup.plan.roles) as bench:

        def observe(progress: Progress) -> None:
            if progress.shot.index == 1 and progress.step is Step.WAIT:
                asked_s.append(bench.clock.now_s())
            if progress.step is Step.FIRE:
                fired_s.append(bench.clock.now_s())

        for _ in acquire(replace(setup.plan, shots=setup.plan.shots[:2], shot_period_s=3.05), bench, observe):
            pass
    assert len(asked_s) >= 10
    assert [later - earlier for earlier, later in pairwise(asked_s)] == pytest.approx([0.2] * (len(asked_s) - 1))
    assert 0 < fired_s[1] - asked_s[-1] < 0.5


def test_the_observer_gets_every_step_and_the_number_of_records(setup: Setup) -> None:
    seen: dict[int, list[tuple[Step, int]]] = {shot.index: [] for shot in setup.plan.shots}
    came = Counter[int]()
    with open_bench(setup.scene.scene, setup.bench.bench, setup.plan.roles) as bench:
        plan = replace(setup.plan, shot_period_s=0.0)
        for event in acquire(plan, bench, lambda step: seen[step.shot.index].append((step.step, step.records))):
            if isinstance(event, ShotBlock):
                came[event.shot.index] += event.block.codes.shape[0]
    assert came == dict.fromkeys(range(3), 16)
    before = (Step.CONFIGURE, Step.VERIFY, Step.ARM, Step.ENABLE, Step.FIRE)
    for shot, steps in seen.items():
        told = [step for step in steps if step[0] is not Step.MOVE]
        assert told[:5] == [(step, 0) for step in before]
        collected = [records for step, records in told[5:-1] if step is Step.COLLECT]
        assert collected[0] == 0
        assert collected[-1] == 16
        assert collected == sorted(collected)
        assert told[-1] == (Step.SAFE, 16), shot


def test_every_instrument_of_the_plan_is_programmed_and_no_output_is_on(setup: Setup) -> None:
    shot = setup.plan.shots[0]
    with open_bench(setup.scene.scene, setup.bench.bench, setup.plan.roles) as bench:
        settings = program_shot(shot, bench)
        assert bench.world is not None
        assert not any(bench.world.outputs_on().values())
    assert set(settings) == {"master", "burst_train", "toneburst", "tracking_train", "tracking_pulser", "digitizer"}
    assert shot.toneburst is not None
    assert shot.burst_train is not None
    assert settings["toneburst"]["amplitude_vpp"] == pytest.approx(shot.toneburst.amplitude_vpp, rel=1e-3)
    assert settings["toneburst"]["cycles"] == shot.toneburst.cycles
    assert settings["burst_train"]["cycles"] == shot.burst_train.count
    # The reference of the phase is the burst's trigger: nothing may come later.
    assert shot.toneburst.delay_s == 0.0


def test_the_log_has_every_step_and_not_every_block_of_records(setup: Setup, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO", "hpe_rig")
    with open_bench(setup.scene.scene, setup.bench.bench, setup.plan.roles) as bench:
        for _ in acquire(replace(setup.plan, shots=setup.plan.shots[:1]), bench):
            pass
    lines = [record.getMessage() for record in caplog.records if record.getMessage().startswith("shot 1: ")]
    steps = (Step.MOVE, Step.CONFIGURE, Step.VERIFY, Step.ARM, Step.ENABLE, Step.FIRE, Step.COLLECT)
    assert lines == [f"shot 1: {step.value}" for step in steps]


def test_outputs_and_settings_are_read_back_once_after_a_short_train(
    setup: Setup, monkeypatch: pytest.MonkeyPatch
) -> None:
    looked: list[float] = []
    with open_bench(setup.scene.scene, setup.bench.bench, setup.plan.roles) as bench:
        # Long after the world began, as in the last of many shots.
        bench.clock.sleep(1000.0)
        recheck = type(bench).recheck
        monkeypatch.setattr(type(bench), "recheck", lambda self: (looked.append(0.0), recheck(self))[1])
        for _ in acquire(replace(setup.plan, shots=setup.plan.shots[:1]), bench):
            pass
    assert len(looked) == 1


def events_of(
    setup: Setup, at: Step, commands: Mapping[str, str], records: bool = False, **changes: object
) -> tuple[list[str], int]:
    """Return the events of one shot and its number of records; another program sends ``commands`` at the step ``at``.

    ``records``: after the first records of that step instead of at its start.
    """
    events, count = list[str](), 0
    plan = replace(setup.plan, shots=setup.plan.shots[:1], **changes)  # type: ignore[arg-type]
    with open_bench(setup.scene.scene, setup.bench.bench, plan.roles) as bench:

        def observe(progress: Progress) -> None:
            if progress.step is at and bool(progress.records) == records and bench.world is not None:
                for role, command in commands.items():
                    bench.world.connect(role).write(command)

        try:
            for event in acquire(plan, bench, observe):
                events.extend(event.rows if isinstance(event, ShotRows) else [type(event).__name__])
                count += event.block.codes.shape[0] if isinstance(event, ShotBlock) else 0
                assert bench.world is not None
                if not isinstance(event, ShotBlock | ShotReady):
                    assert not any(bench.world.outputs_on().values())
        except InstrumentError as error:
            events.append(str(error))
        assert not any(bench.world.outputs_on().values())
    return events, count


def test_a_setting_that_another_program_changes_during_a_shot_makes_it_untrusted(
    setup: Setup, monkeypatch: pytest.MonkeyPatch
) -> None:
    changed = {"toneburst": "VOLT 0.3"}
    names = ["ShotReady", "ShotBlock", "changed_settings", "untrusted"]
    events, count = events_of(setup, Step.COLLECT, changed)
    assert (list(dict.fromkeys(events))[:-1], count) == (names, 16)
    assert events[-1].startswith("bench: shot 1 is not to be trusted: toneburst: settings after the shot: ")
    assert 'acquisition.changed_settings = "continue" accepts changes' in events[-1]
    events, _ = events_of(setup, Step.COLLECT, changed, stops_on_changed_settings=False)
    assert list(dict.fromkeys(events)) == [*names, "ShotDone"]
    # In a long shot the settings are read back between records, and a change ends it.
    monkeypatch.setattr(sequencer, "RECHECK_INTERVAL_S", 0.0)
    assert events_of(setup, Step.COLLECT, {}) == (["ShotReady", *["ShotBlock"] * 8, "ShotDone"], 16)
    events, count = events_of(setup, Step.COLLECT, changed, records=True)
    assert (events[:-1], count) == (names, 2)


def test_missing_records_are_an_error_unless_some_came_or_a_change_explains_it(
    setup: Setup, monkeypatch: pytest.MonkeyPatch
) -> None:
    off = {"tracking_train": "OUTP 0"}
    events, count = events_of(setup, Step.FIRE, off)
    assert (events[:-1], count) == (["ShotReady", "untrusted"], 0)
    assert "tracking_train" in events[-1]
    monkeypatch.setattr(Bench, "recheck", lambda bench: ())
    events, count = events_of(setup, Step.FIRE, off)
    assert (events[0], count) == ("ShotReady", 0)
    assert "0 of 16 records delivered by the deadline" in events[-1]
    shots = setup.plan.shots
    longer = replace(shots[0], capture=replace(shots[0].capture, record_count=24))
    longer_setup = replace(setup, plan=replace(setup.plan, shots=(longer,)))
    events, count = events_of(longer_setup, Step.FIRE, {})
    assert (list(dict.fromkeys(events)), count) == (["ShotReady", "ShotBlock", "ShotDone"], 16)


def test_a_control_shot_has_its_toneburst_off_and_the_transducer_moves_once_for_each_offset(setup: Setup) -> None:
    first, second, third = setup.plan.shots
    shots = (first, replace(second, is_control=True, lateral_offset_m=1e-3), replace(third, lateral_offset_m=1e-3))
    moves, outputs = list[tuple[float, bool]](), list[bool]()
    with open_bench(setup.scene.scene, setup.bench.bench, setup.plan.roles) as bench:
        assert bench.world is not None
        world = bench.world

        def observe(progress: Progress) -> None:
            if progress.step is Step.FIRE:
                outputs.append(world.outputs_on()["toneburst"])

        def move(lateral_offset_m: float) -> None:
            moves.append((lateral_offset_m, any(world.outputs_on().values())))

        for _ in acquire(replace(setup.plan, shots=shots, shot_period_s=0.0), bench, observe, move):
            pass
    assert moves == [(first.lateral_offset_m, False), (1e-3, False)]
    assert outputs == [True, False, True]
