"""Records find their pulses by the board's trigger times."""

from dataclasses import replace

import numpy as np
import pytest

from drivers.interfaces import RecordBlock
from hpe_rig.bench import read_bench
from hpe_rig.plan.shots import Shot, make_plan
from hpe_rig.scene import parse_scene, shipped_scenes
from hpe_rig.store.records import MISSING, assemble, pulse_indices

CODE_LIMITS = (-8192, 8191)


@pytest.fixture
def shot() -> Shot:
    return make_plan(parse_scene("table-1", shipped_scenes()["table-1"]).scene, read_bench().bench).shots[0]


def block(shot: Shot, pulses: np.ndarray, start_s: float = 0.1) -> RecordBlock:
    codes = np.repeat(pulses.astype(np.int16)[:, None], shot.capture.record_samples, axis=1)
    return RecordBlock(0, codes, start_s + pulses / shot.tracking_train.rate_hz, 1e-4, 5e-5, CODE_LIMITS)


def test_a_lost_trigger_leaves_its_pulse_missing_and_shifts_no_other(shot: Shot) -> None:
    pulses = np.delete(np.arange(101), [7, 50, 51])
    records = assemble([block(shot, pulses[:40]), block(shot, pulses[40:])], shot)
    assert records.codes[pulses, 0].tolist() == pulses.tolist()
    assert np.flatnonzero(~records.valid).tolist() == [7, 50, 51]
    assert (records.codes[[7, 50, 51]] == MISSING).all()


def test_a_trigger_between_the_pulses_is_no_pulse(shot: Shot) -> None:
    period_s = 1 / shot.tracking_train.rate_hz
    stray = RecordBlock(0, np.zeros((3, 512), np.int16), np.array([0.0, 0.4, 1.0]) * period_s, 1.0, 0.0, CODE_LIMITS)
    assert pulse_indices(stray, None, shot)[0].tolist() == [0, -1, 1]


def test_a_shot_without_records_is_all_missing(shot: Shot) -> None:
    assert not assemble([], shot).valid.any()


@pytest.mark.parametrize("clock_error", [-100e-6, 50e-6, 100e-6])
def test_a_board_whose_clock_is_off_loses_no_record(shot: Shot, clock_error: float) -> None:
    long = replace(shot, capture=replace(shot.capture, record_count=20_000))
    pulses = np.delete(np.arange(20_000), [5_000, 12_345])
    latest, found = None, []
    for part in np.array_split(pulses, 16):
        time_s = part / shot.tracking_train.rate_hz * (1 + clock_error)
        index, latest = pulse_indices(
            RecordBlock(0, np.zeros((part.size, 1), np.int16), time_s, 1.0, 0.0, CODE_LIMITS), latest, long
        )
        found += index.tolist()
    assert found == pulses.tolist()


def test_records_without_a_time_count_on_from_the_last_that_has_one(shot: Shot) -> None:
    """As single-port records above 1000 do: what was lost before them shifts none of them."""
    pulses = np.delete(np.arange(60), [7])
    timed = block(shot, pulses)
    times_s = np.where(np.arange(59) < 40, timed.trigger_time_s, np.nan)
    records = assemble([replace(timed, trigger_time_s=times_s)], shot)
    assert records.codes[pulses, 0].tolist() == pulses.tolist()
    assert np.flatnonzero(~records.valid[:60]).tolist() == [7]
    untimed = replace(timed, first_record=20, trigger_time_s=np.full(59, np.nan))
    assert pulse_indices(untimed, None, shot)[0].tolist() == list(range(20, 79))
