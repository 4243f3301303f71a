"""The run file: what other programs read, what is refused before anything is written, what stays."""

from __future__ import annotations

import csv
import inspect
import io
import json
import os
import shutil
import signal
import subprocess
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import h5py
import numpy as np
import pytest
import xarray as xr

from drivers.interfaces import RecordBlock
from hpe_rig.bench import parse_bench, uninterrupted
from hpe_rig.cli.measuring import resume, run
from hpe_rig.measurement.run import record_run
from hpe_rig.measurement.setup import Setup, prepare_text
from hpe_rig.result import headline_sentence, symbols
from hpe_rig.result.html_repr import result_html
from hpe_rig.result.rows import result_csv, result_frame
from hpe_rig.runs.checked_scene import check
from hpe_rig.runs.run import open_run, process
from hpe_rig.scene import shipped_scenes
from hpe_rig.store import (
    RunWriter,
    StoreError,
    WriteOptions,
    acquire,
    check_replaceable,
    free_path,
    is_locked,
    layout,
    read_run,
    read_snapshots,
    refuse_output,
    result_path,
    verify,
    write_result,
    writer as writer_module,
)
from hpe_rig.store.format import STAGES, reason, versions
from hpe_rig.store.layout import empty_run
from hpe_rig.store.log import LogWriter
from hpe_rig.store.records import MISSING


@pytest.fixture(scope="module")
def setup() -> Setup:
    """Return a small measurement of two shots."""
    text = shipped_scenes()["table-1"].replace("pulse_count = 101", "pulse_count = 48")
    return prepare_text("small", text.replace("[acquisition]", "[acquisition]\nrepeats = 2\nrecord_samples = 256"))


@pytest.fixture(scope="module")
def measured(setup: Setup, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a run file of ``setup`` that lies beside its result file, for tests that only read it."""
    path = record_run(setup, tmp_path_factory.mktemp("measured") / "run.h5")
    process(path)
    return path


def block_of(setup: Setup, first: int, count: int, time_s: float | None = None) -> RecordBlock:
    """Return records whose codes say which they are."""
    shot = setup.plan.shots[0]
    codes = np.repeat(np.arange(first, first + count, dtype=np.int16)[:, None], shot.capture.record_samples, axis=1)
    start_s = np.nan if time_s is None else time_s
    trigger_time_s = start_s + np.arange(first, first + count) / shot.tracking_train.rate_hz
    scale = shot.capture.input_range_v / 8191.5
    return RecordBlock(first, codes, trigger_time_s, scale, scale / 2, (-8192, 8191))


@contextmanager
def nobody() -> Iterator[None]:
    """Be a user without rights, where this is the superuser, who may write anywhere."""
    before = os.geteuid()
    if before == 0:
        os.seteuid(65534)
    try:
        yield
    finally:
        os.seteuid(before)


def written(setup: Setup, path: Path, *blocks: RecordBlock) -> Path:
    """Write ``blocks`` as the first shot's."""
    shot = setup.plan.shots[0]
    with RunWriter(path, setup.scene, setup.bench, setup.plan) as writer:
        writer.write_settings(shot, {})
        for block in blocks:
            writer.append(shot, block)
        writer.finish(shot)
    return path


def test_blocks_of_any_size_land_in_their_pulses_places(setup: Setup, tmp_path: Path) -> None:
    cuts = [0, 1, 7, 30, 48]
    blocks = [block_of(setup, low, high - low, 0.5) for low, high in pairwise(cuts)]
    records = read_run(written(setup, tmp_path / "run.h5", *blocks)).records[0]
    np.testing.assert_array_equal(records.codes[:, 0], np.arange(48))
    assert records.valid.all()


def test_a_lost_record_stays_missing_and_shifts_no_other(setup: Setup, tmp_path: Path) -> None:
    blocks = block_of(setup, 0, 5, 0.5), block_of(setup, 6, 42, 0.5)
    records = read_run(written(setup, tmp_path / "run.h5", *blocks)).records[0]
    assert np.flatnonzero(~records.valid).tolist() == [5]
    assert (records.codes[5] == MISSING).all()
    np.testing.assert_array_equal(records.codes[6:, 0], np.arange(6, 48))


def test_records_without_trigger_times_count_from_the_first(setup: Setup, tmp_path: Path) -> None:
    blocks = block_of(setup, 0, 16), block_of(setup, 16, 16)
    records = read_run(written(setup, tmp_path / "run.h5", *blocks)).records[0]
    assert records.valid.tolist() == [True] * 32 + [False] * 16
    np.testing.assert_array_equal(records.codes[:32, 0], np.arange(32))


def test_the_next_shot_leaves_the_last_one_as_it_is(setup: Setup, tmp_path: Path) -> None:
    first, second = setup.plan.shots
    with RunWriter(tmp_path / "run.h5", setup.scene, setup.bench, setup.plan) as writer:
        writer.append(first, block_of(setup, 0, 20, 0.5))
        writer.append(second, block_of(setup, 0, 48, 0.5))
    stored = read_run(tmp_path / "run.h5")
    assert [int(records.valid.sum()) for records in stored.records] == [20, 48]
    assert not stored.shot_complete.any()


def test_shots_are_taken_one_by_one_or_by_a_slice(setup: Setup, tmp_path: Path) -> None:
    records = read_run(written(setup, tmp_path / "run.h5", block_of(setup, 0, 48))).records
    first, second = records[:]
    assert first.valid.all()
    assert not second.valid.any()
    (last,) = records[1:5]
    np.testing.assert_array_equal(last.codes, records[1].codes)


def test_every_delivered_record_is_stored_with_its_number_and_time(setup: Setup, tmp_path: Path) -> None:
    """Also records of stray triggers, and those after a step of the digitizer's counter."""
    period_s = 1 / setup.plan.shots[0].tracking_train.rate_hz
    block = block_of(setup, 0, 40, 0.5)
    time_s = block.trigger_time_s + np.where(np.arange(40) < 30, 0.0, 0.25)
    time_s[10] -= 0.4 * period_s
    path = written(setup, tmp_path / "run.h5", replace(block, trigger_time_s=time_s))
    with h5py.File(path) as file:
        np.testing.assert_array_equal(file["records/echo"][0, :40, 0], np.arange(40))
        np.testing.assert_array_equal(file["records/trigger_time_s"][0, :40], time_s)
    stored = read_run(path).records
    assert np.flatnonzero(~stored[0].valid).tolist() == [10, *range(40, 48)]
    assert stored.placement(0).stray == (10,)
    assert stored.placement(0).remarks == ("the trigger times jump by 0.25 s at record 31",)
    np.testing.assert_array_equal(stored[0].codes[30:40, 0], np.arange(30, 40))


def test_blocks_of_a_long_shot_follow_the_placement(setup: Setup, tmp_path: Path) -> None:
    early, late = block_of(setup, 0, 12, 0.5), block_of(setup, 14, 30, 0.5)
    stored = read_run(written(setup, tmp_path / "run.h5", early, replace(late, first_record=12))).records
    gate, visited = slice(100, 130), list[np.ndarray]()
    held, by_block = stored.gated(0, gate, margin=5), stored.gated_or_stored(0, gate, 5, 0, visited.append)
    np.testing.assert_array_equal(held.valid, by_block.valid)
    assert np.flatnonzero(~held.valid).tolist() == [12, 13, 44, 45, 46, 47]
    for pulses in (slice(0, 48), slice(10, 15), slice(12, 14), slice(44, 48)):
        np.testing.assert_array_equal(by_block.block(pulses), held.block(pulses))
    assert not visited


@pytest.mark.parametrize(
    "error",
    [KeyError("gate"), *(pytest.param(error, marks=pytest.mark.slow) for error in (ValueError("few"), MemoryError()))],
)
def test_an_error_in_the_processing_of_a_block_is_not_called_damage(
    setup: Setup, tmp_path: Path, error: Exception
) -> None:
    stored = read_run(written(setup, tmp_path / "run.h5", block_of(setup, 0, 48, 0.5))).records

    def fail(codes: np.ndarray) -> None:
        raise error

    with pytest.raises(type(error)) as caught:
        stored.gated_or_stored(0, slice(100, 130), 5, 0, fail)
    assert caught.value is error


def test_the_true_displacement_is_stored_for_the_records_of_its_shot_alone(setup: Setup, tmp_path: Path) -> None:
    """A shot whose settings changed may end without any record."""
    first, second = setup.plan.shots
    with RunWriter(tmp_path / "run.h5", setup.scene, setup.bench, setup.plan) as writer:
        writer.append(first, block_of(setup, 0, 20, 0.5))
        writer.write_ground_truth(first, np.full(20, 1e-6))
        writer.write_ground_truth(second, np.full(48, 2e-6))
    with h5py.File(tmp_path / "run.h5") as file:
        np.testing.assert_array_equal(file["truth/displacement_m"][0], [1e-6] * 20 + [np.nan] * 28)
        np.testing.assert_array_equal(file["truth/displacement_m"][1], np.full(48, np.nan))


@pytest.mark.parametrize("compress", [False, True])
def test_a_late_record_of_an_earlier_chunk_costs_none_of_those_that_came_in_time(
    setup: Setup, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, compress: bool
) -> None:
    monkeypatch.setattr(layout, "CHUNK_BYTES", 8 * 2 * 256)
    path, shot = tmp_path / "run.h5", setup.plan.shots[0]
    with RunWriter(path, setup.scene, setup.bench, setup.plan, WriteOptions(compress=compress)) as writer:
        for first, count in ((0, 3), (4, 17), (21, 27), (3, 1)):
            writer.append(shot, block_of(setup, first, count, 0.0))
        writer.finish(shot)
    found = read_run(path).records[0]
    assert found.valid.all()
    np.testing.assert_array_equal(found.codes[:, 100], np.arange(48))
    with h5py.File(path) as file:
        assert file["records/echo"].chunks[1] == 8


def test_run_times_are_those_of_the_stages_that_were_measured(setup: Setup, tmp_path: Path) -> None:
    path = tmp_path / "run.h5"
    with RunWriter(path, setup.scene, setup.bench, setup.plan) as writer:
        writer.write_run_times(dict(zip(STAGES, (1.5, -1.0, np.inf), strict=False)))
    assert read_run(path).run_time_s == {STAGES[0]: 1.5}


def test_a_gate_is_read_alone(measured: Path) -> None:
    stored = read_run(measured)
    gate = slice(100, 130)
    np.testing.assert_array_equal(stored.records.gated(1, gate).codes, stored.records[1].codes[:, gate])


@pytest.mark.parametrize("pulses", [1, 17, *(pytest.param(pulses, marks=pytest.mark.slow) for pulses in (7, 48, 100))])
def test_codes_come_in_steps_of_whole_chunks_each_once(
    setup: Setup, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, pulses: int
) -> None:
    monkeypatch.setattr(layout, "CHUNK_BYTES", 8 * 2 * 256)
    records = read_run(written(setup, tmp_path / "run.h5", block_of(setup, 0, 48, 0.5))).records
    steps = list(records.chunks(0, pulses))
    assert [first for first, _ in steps] == list(range(0, 48, max(1, pulses // 8) * 8))
    np.testing.assert_array_equal(np.concatenate([codes for _, codes in steps])[:, 0], np.arange(48))


def test_a_block_in_other_volts_than_the_range_says_is_refused(setup: Setup, tmp_path: Path) -> None:
    other = replace(block_of(setup, 0, 4, 0.5), volts_per_code=1e-3)
    with pytest.raises(StoreError, match="V per code"):
        written(setup, tmp_path / "run.h5", other)
    assert read_run(tmp_path / "run.h5").status == "failed"


def test_an_empty_run_is_the_same_bytes_every_time(setup: Setup) -> None:
    images = [empty_run(setup.scene, setup.bench, setup.plan) for _ in range(2)]
    assert images[0] == images[1]


def test_offsets_of_the_gate_are_stored_in_metres() -> None:
    scene = shipped_scenes()["table-1"].replace("[tracking]", "[tracking]\nlateral_offset_m = 1e-3")
    offset = prepare_text("offset", scene)
    with h5py.File(io.BytesIO(empty_run(offset.scene, offset.bench, offset.plan))) as file:
        dataset = file["records/lateral_offset_m"]
        assert (dataset[0], dataset.attrs["units"]) == (1e-3, "m")


def test_overwriting_happens_only_when_told(setup: Setup, tmp_path: Path) -> None:
    path = tmp_path / "run.h5"
    path.write_bytes(b"precious")
    with pytest.raises(StoreError, match="--overwrite"):
        record_run(setup, path)
    with pytest.raises(StoreError, match="not replaced"):
        record_run(setup, path, options=WriteOptions(overwrite=True))
    assert path.read_bytes() == b"precious"
    path.unlink()
    for _ in range(2):
        record_run(setup, path, options=WriteOptions(overwrite=True))
        assert read_run(path).status == "complete"
    assert free_path("run", tmp_path).name == "run-2.h5"


def test_an_output_is_refused_before_a_run_if_it_exists_or_its_folder_does_not(setup: Setup, tmp_path: Path) -> None:
    path = written(setup, tmp_path / "run.h5", block_of(setup, 0, 48, 0.5))
    refuse_output(path, overwrite=True)
    refuse_output(tmp_path / "new.h5", overwrite=False)
    with pytest.raises(StoreError, match=r"run\.h5 already exists.*--overwrite"):
        refuse_output(path, overwrite=False)
    with pytest.raises(StoreError, match=r"the folder .*absent does not exist"):
        refuse_output(tmp_path / "absent" / "run.h5", overwrite=False)
    check_replaceable(path)
    (tmp_path / "thesis.h5").write_bytes(b"a")
    with pytest.raises(StoreError, match=r"thesis\.h5 exists and is not a readable run file"):
        check_replaceable(tmp_path / "thesis.h5")
    with path.open("rb+") as file:
        acquire(file)
        with pytest.raises(StoreError, match=r"run\.h5 is being written by another run"):
            check_replaceable(path)


def test_readings_of_conditions_are_stored_by_shot_and_read_by_name(setup: Setup, tmp_path: Path) -> None:
    tables = "".join(f'\n[[conditions]]\nname = "{name}"\nplugin = "p"\n' for name in ("water", "air", "level"))
    setup = replace(setup, bench=parse_bench("bench", setup.bench.text + tables))
    first, second = setup.plan.shots
    path = tmp_path / "run.h5"
    with RunWriter(path, setup.scene, setup.bench, setup.plan) as writer:
        for shot, value in ((first, 20.0), (second, 21.0)):
            writer.write_settings(shot, {})
            writer.append(shot, block_of(setup, 0, 48, 0.5))
            before, after = (value, 1.0, np.nan), (value + 0.5, 2.0, np.nan)
            writer.write_rows(shot, {"conditions/before": before, "conditions/after": after})
            writer.finish(shot)
    conditions = read_run(path).conditions
    assert list(conditions) == ["water", "air", "level"]
    assert conditions["water"].tolist() == [[20.0, 20.5], [21.0, 21.5]]
    assert conditions["air"].tolist() == [[1.0, 2.0], [1.0, 2.0]]
    assert np.isnan(conditions["level"]).all()


def test_a_missing_folder_is_a_message(setup: Setup, tmp_path: Path) -> None:
    with pytest.raises(StoreError, match="cannot be created"):
        record_run(setup, tmp_path / "nowhere" / "run.h5")


@pytest.mark.skipif(os.name == "nt", reason="a folder's mode means nothing there")
def test_a_read_only_folder_is_a_message(setup: Setup) -> None:
    # Beside the tests' own folder, which is closed to the user that a superuser turns into here, as packages may be.
    versions()
    with tempfile.TemporaryDirectory() as name:
        Path(name).chmod(0o555)
        with nobody(), pytest.raises(StoreError, match=r"cannot be created \(Permission denied\)"):
            record_run(setup, Path(name) / "run.h5")
        Path(name).chmod(0o755)


@pytest.mark.skipif(os.name == "nt", reason="an open file keeps its folder there")
def test_a_folder_that_vanishes_while_it_is_written_is_a_message(setup: Setup, tmp_path: Path) -> None:
    folder = tmp_path / "share"
    folder.mkdir()
    writer = RunWriter(folder / "run.h5", setup.scene, setup.bench, setup.plan)
    shutil.rmtree(folder)
    with pytest.raises(StoreError, match="moved or removed"), writer:
        writer.append(setup.plan.shots[0], block_of(setup, 0, 48, 0.5))


@pytest.mark.parametrize(
    "words", ["Disable slist failed (unable to allocate memory block of 131072 bytes)", "can't start new thread"]
)
def test_too_little_memory_is_said_in_plain_words(words: str) -> None:
    """As the library and Python say it under a limit of memory, of which nobody foresaw the first."""
    assert reason(RuntimeError(words)) == "it needs more memory than is available"


class ShortOfMemory:
    """The run file, of which one write, the ``number``-th, finds too little memory."""

    def __init__(self, file: io.FileIO, number: int) -> None:
        self._file, self._left, self.struck = file, number, False

    def write(self, data: memoryview) -> int:
        self._left -= 1
        if self._left == 0:
            self.struck = True
            raise MemoryError
        return self._file.write(data) or 0

    def __getattr__(self, name: str) -> object:
        return getattr(self._file, name)


@pytest.mark.parametrize("stride", [40, pytest.param(1, marks=pytest.mark.slow)])
def test_too_little_memory_for_one_write_ends_the_run_with_a_message_and_a_whole_file(
    setup: Setup, tmp_path: Path, stride: int
) -> None:
    whole = read_run(written(setup, tmp_path / "whole.h5", block_of(setup, 0, 48, 0.5))).records[0]
    number, struck, shot = 1 - stride, True, setup.plan.shots[0]
    while struck:
        number += stride
        path = tmp_path / f"{number}.h5"
        writer = RunWriter(path, setup.scene, setup.bench, setup.plan)
        log = vars(writer)["_log"]
        disk = vars(log)["_file"] = ShortOfMemory(vars(log)["_file"], number)
        message = ""
        try:
            with writer:
                for first in range(0, 48, 16):
                    writer.append(shot, block_of(setup, first, 16, 0.5))
                writer.finish(shot)
        except StoreError as error:
            message = str(error)
        struck, stored = disk.struck, read_run(path)
        assert struck == ("cannot be written any further (it needs more memory than is available)" in message)
        assert stored.status == ("failed" if struck else "complete")
        assert not verify(path).damage
        records = stored.records[0]
        np.testing.assert_array_equal(records.codes[records.valid], whole.codes[records.valid])
        assert records.valid.all() or not stored.shot_complete[0]
    assert number > 5


@pytest.mark.skipif(os.name == "nt", reason="a console's signals cannot be sent to one process on Windows")
def test_a_file_whose_making_is_interrupted_is_closed_before_it_is_removed(
    setup: Setup, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Windows removes no file that is open; an open one is locked."""
    path, unlink, locked = tmp_path / "run.h5", Path.unlink, list[bool | None]()

    def interrupted(made: Path) -> LogWriter:
        log = LogWriter(made)
        os.kill(os.getpid(), signal.SIGINT)
        return log

    def noted(file: Path, missing_ok: bool = False) -> None:
        if file == path:
            locked.append(is_locked(file))
        unlink(file, missing_ok)

    monkeypatch.setattr(writer_module, "LogWriter", interrupted)
    monkeypatch.setattr(Path, "unlink", noted)
    with pytest.raises(KeyboardInterrupt), uninterrupted():
        RunWriter(path, setup.scene, setup.bench, setup.plan)
    assert locked == [False]
    assert not path.exists()


def test_a_disk_too_small_for_the_run_is_refused_before_anything_is_written(
    setup: Setup, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    usage = shutil.disk_usage(tmp_path)
    monkeypatch.setattr(shutil, "disk_usage", lambda path: usage._replace(free=40_000))
    with pytest.raises(StoreError, match=r"the disk has 0.04 MB free"):
        record_run(setup, tmp_path / "run.h5")
    assert not list(tmp_path.glob("*.h5"))


def test_a_result_never_replaces_a_file_that_is_none(measured: Path, tmp_path: Path) -> None:
    path = Path(shutil.copy(measured, tmp_path))
    result = process(path)
    process(path)
    foreign = result_path(path, "coherent")
    foreign.write_bytes(b"precious")
    with pytest.raises(StoreError, match="not replaced"):
        write_result(foreign, result)
    assert foreign.read_bytes() == b"precious"


def test_compressed_records_are_the_same_records(setup: Setup, measured: Path, tmp_path: Path) -> None:
    packed = record_run(setup, tmp_path / "packed.h5", options=WriteOptions(compress=True))
    with h5py.File(packed) as file:
        assert [item[0] for item in _filters(file["records/echo"])] == [32008, 3]
    for one, other in zip(read_run(measured).records, read_run(packed).records, strict=True):
        np.testing.assert_array_equal(one.codes, other.codes)


def test_records_are_compressed_only_where_that_is_asked_for(setup: Setup, measured: Path, tmp_path: Path) -> None:
    images = [empty_run(setup.scene, setup.bench, setup.plan, *asked) for asked in ((), (False,), (True,))]
    (tmp_path / "empty.h5").write_bytes(images[0])
    assert images[0] == images[1] != images[2]
    for path in (measured, tmp_path / "empty.h5"):
        with h5py.File(path) as file:
            assert 32008 not in [item[0] for item in _filters(file["records/echo"])]
            assert file["records/echo"].compression is None


@pytest.mark.parametrize("command", [run, resume])
def test_the_commands_do_not_compress_unless_told(command: Callable[..., None]) -> None:
    assert inspect.signature(command).parameters["compress"].default is False


def _filters(dataset: h5py.Dataset) -> list[tuple[int, ...]]:
    plist = dataset.id.get_create_plist()
    return [plist.get_filter(index) for index in range(plist.get_nfilters())]


@pytest.mark.external
def test_h5dump_reads_a_run_and_a_result(measured: Path) -> None:
    result = result_path(measured, "coherent")
    for file, name, word in ((measured, "/records/shot_complete", "1, 1"), (result, "/json", "{")):
        done = subprocess.run(["h5dump", "-d", name, file], capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        assert word in done.stdout
    header = subprocess.run(["h5dump", "-H", measured], capture_output=True, text=True, check=True).stdout
    assert 'DATASET "echo"' in header


def test_every_object_is_of_a_type_and_format_that_hdf5_1_10_knows(measured: Path) -> None:
    plain: list[str] = []

    def look(name: str, item: h5py.HLObject) -> None:
        if isinstance(item, h5py.Dataset):
            # Classes: 0 integer, 1 float, 3 string; all of them old, none of them compound or nested.
            plain.append(name)
            assert item.id.get_type().get_class() in (0, 1, 3), name

    for file_path in (measured, result_path(measured, "coherent")):
        # The superblock's version is the format's: 3 came with HDF5 1.10, 4 with 2.0.
        assert file_path.read_bytes()[8] <= 3
        with h5py.File(file_path) as file:
            file.visititems(look)
    assert {"records/echo", "results/amplitude_m", "truth/displacement_m"} <= set(plain)


def test_the_axis_of_the_samples_is_the_time_after_the_pulse(setup: Setup, measured: Path) -> None:
    shot = setup.plan.shots[0]
    with h5py.File(measured) as file:
        sample_s = file["records/sample"][()]
        assert file["records/echo"].dims[2][0] == file["records/sample"]
    assert sample_s[0] == shot.timeline.record_offset_s[0]
    np.testing.assert_allclose(np.diff(sample_s), 1 / shot.capture.sample_rate_hz, rtol=1e-6)


def test_a_missing_record_is_nan_in_xarray(setup: Setup, tmp_path: Path) -> None:
    path = written(setup, tmp_path / "run.h5", block_of(setup, 0, 5, 0.5), block_of(setup, 6, 42, 0.5))
    with xr.open_dataset(path, group="records", engine="h5netcdf") as records:
        echo = records["echo"].isel(shot=0)
        assert np.flatnonzero(echo.isnull().all("sample")).tolist() == [5]
        expected_v = (7 + 0.5) * setup.plan.shots[0].capture.input_range_v / 8191.5
        assert float(echo.isel(pulse=7, sample=0)) == pytest.approx(expected_v, rel=1e-6)


def test_a_table_goes_to_csv_and_to_pandas_with_every_digit(measured: Path) -> None:
    result = open_run(measured).estimate()
    read, frame = list(csv.DictReader(io.StringIO(result_csv(result)))), result_frame(result)
    assert len(read) == len(frame) == 2
    estimate = result.shots[1].estimates[0]
    for row in (read[1], frame.iloc[1]):
        assert float(row["amplitude_m"]) == estimate.amplitude_m
        assert float(row["tracked_phase_uncertainty_rad"]) == estimate.tracked_phase_uncertainty_rad
        assert int(row["shot"]) == 2
    assert frame.attrs["simulated"] is True


def test_a_notebook_shows_figure_table_and_that_it_was_simulated(measured: Path) -> None:
    result = open_run(measured).estimate()
    page = result._repr_html_()
    assert "SIMULATED" in page
    assert page.count('src="data:image/svg+xml;base64,') == 2
    assert '<img alt="Amplitude in nm: ' in page
    assert str(symbols(headline_sentence(result))) in page
    run_page = open_run(measured)._repr_html_()
    assert "2 of 2 shots, simulated" in run_page
    assert '<img alt="Timing over ' in run_page
    assert check("table-1")._repr_html_().count('<img alt="Timing over ') == 2
    assert f"{result.shots[0].estimates[0].amplitude_m * 1e9:.4g}" in page
    hostile = result_html(replace(result, title="<script>alert(1)</script>"))
    assert "<script>" not in hostile


def test_settings_are_kept_shot_by_shot(setup: Setup, measured: Path) -> None:
    snapshots = read_snapshots(measured)
    assert [set(snapshot) for snapshot in snapshots] == [set(setup.plan.roles)] * 2
    with h5py.File(measured) as file:
        assert json.loads(file["snapshot"].asstr()[1]) == snapshots[1]
