"""Records find their pulses by the board's trigger times."""

import numpy as np
import pytest

from drivers.alazar.models import MODELS
from drivers.interfaces import RecordBlock
from hpe_rig.bench import read_bench
from hpe_rig.plan.shots import Shot, make_plan
from hpe_rig.scene import parse_scene, shipped_scenes
from hpe_rig.store.records import MISSING, assemble

CODE_LIMITS = (-8192, 8191)


@pytest.fixture
def shot() -> Shot:
    return make_plan(parse_scene("table-1", shipped_scenes()["table-1"]).scene, read_bench().bench).shots[0]


def block(shot: Shot, pulses: np.ndarray, first_record: int = 0) -> RecordBlock:
    codes = np.repeat(pulses.astype(np.int16)[:, None], shot.capture.record_samples, axis=1)
    return RecordBlock(first_record, codes, 0.1 + pulses / shot.tracking_train.rate_hz, 1e-4, 5e-5, CODE_LIMITS)


def test_a_lost_trigger_leaves_its_pulse_missing_and_shifts_no_other(shot: Shot) -> None:
    pulses = np.delete(np.arange(101), [7, 50, 51])
    records = assemble([block(shot, pulses[:40]), block(shot, pulses[40:], 40)], shot)
    assert records.codes[pulses, 0].tolist() == pulses.tolist()
    assert np.flatnonzero(~records.valid).tolist() == [7, 50, 51]
    assert (records.codes[[7, 50, 51]] == MISSING).all()


def test_a_missing_record_has_the_lowest_number_that_fits_which_no_board_gives() -> None:
    assert np.iinfo(np.int16).min == MISSING
    assert all(model.code_limits[0] > MISSING for model in MODELS)


def test_a_shot_without_records_is_all_missing(shot: Shot) -> None:
    assert not assemble([], shot).valid.any()
