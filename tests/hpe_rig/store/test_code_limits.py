"""The digitizer's code range travels from its records through the run file to the estimator."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from drivers.interfaces import RecordBlock
from hpe_rig.measurement.setup import Setup, prepare
from hpe_rig.processing.echo.conditioning import gate_statistics
from hpe_rig.store.format import StoreError
from hpe_rig.store.layout import code_scale_and_offset_v, empty_run
from hpe_rig.store.reader import read_run
from hpe_rig.store.records import assemble


@pytest.fixture(scope="module")
def setup() -> Setup:
    return prepare("table-1")


@pytest.fixture
def stored(setup: Setup, tmp_path: Path) -> Path:
    path = tmp_path / "run.h5"
    path.write_bytes(empty_run(setup.scene, setup.bench, setup.plan))
    return path


def test_a_run_file_states_the_codes_of_its_board(stored: Path) -> None:
    with h5py.File(stored) as file:
        assert [file["records/echo"].attrs[name] for name in ("valid_min", "valid_max")] == [-8192, 8191]
    assert read_run(stored).records[0].code_limits == (-8192, 8191)


def test_a_run_file_from_before_codes_were_stated_has_those_of_14_bits(stored: Path) -> None:
    with h5py.File(stored, "r+") as file:
        del file["records/echo"].attrs["valid_min"], file["records/echo"].attrs["valid_max"]
    assert read_run(stored).records[0].code_limits == (-8192, 8191)


def test_another_boards_codes_come_back_as_stated_and_impossible_ones_are_refused(stored: Path) -> None:
    with h5py.File(stored, "r+") as file:
        file["records/echo"].attrs.update({"valid_min": np.int16(-2048), "valid_max": np.int16(2047)})
    assert read_run(stored).records[0].code_limits == (-2048, 2047)
    with h5py.File(stored, "r+") as file:
        # The mark of a missing record is no code.
        file["records/echo"].attrs.update({"valid_min": np.int16(-32768), "valid_max": np.int16(2047)})
    with pytest.raises(StoreError, match="codes from -32768 to 2047"):
        read_run(stored).records[0]


@pytest.mark.parametrize("bits", [8, 12, 14])
def test_full_scale_is_that_of_the_digitizer(setup: Setup, bits: int) -> None:
    limits = -(1 << (bits - 1)), (1 << (bits - 1)) - 1
    shot = setup.plan.shots[0]
    shot = replace(shot, capture=replace(shot.capture, record_count=3))
    codes = np.zeros((3, shot.capture.record_samples), np.int16)
    codes[1, 7], codes[2, 7] = limits[1], limits[1] - 1
    block = RecordBlock(0, codes, np.full(3, np.nan), *code_scale_and_offset_v(1.0, limits), limits)
    records = assemble([block], shot)
    assert gate_statistics(records).at_full_scale(records.code_limits).tolist() == [False, True, False]


@pytest.mark.parametrize("bits", [8, 12, 14, 16])
def test_the_lowest_and_highest_code_are_minus_and_plus_the_range(bits: int) -> None:
    limits = -(1 << (bits - 1)), (1 << (bits - 1)) - 1
    scale, offset = code_scale_and_offset_v(0.8, limits)
    assert [limits[0] * scale + offset, limits[1] * scale + offset] == pytest.approx([-0.8, 0.8], rel=1e-12)
