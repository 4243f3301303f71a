"""The log of a run: what a crash leaves of it is read and becomes a run file, and later damage is reported."""

from __future__ import annotations

import io
from pathlib import Path

import h5py
import numpy as np
import pytest

from drivers.interfaces import RecordBlock
from hpe_rig.measurement import Setup, prepare_resumption, prepare_text
from hpe_rig.runs import open_run
from hpe_rig.scene import shipped_scenes
from hpe_rig.store import RunWriter, StoreError, read_run, recover, verify
from hpe_rig.store.log import HEADER_BYTES, SHOT_COMPLETE, SIGNATURE, STATUS, Frame, LogWriter, is_log, read_log

RECORDS, SAMPLES = 48, 256


@pytest.fixture(scope="module")
def setup() -> Setup:
    """Return a measurement of three shots, each written in two blocks."""
    text = shipped_scenes()["table-1"].replace("pulse_count = 101", f"pulse_count = {RECORDS}")
    return prepare_text(
        "small", text.replace("[acquisition]", f"[acquisition]\nrepeats = 3\nrecord_samples = {SAMPLES}")
    )


@pytest.fixture(scope="module")
def killed(setup: Setup, tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """Return the log of a run that was killed during its third shot."""
    path = tmp_path_factory.mktemp("killed") / "run.h5"
    with RunWriter(path, setup.scene, setup.bench, setup.plan) as writer:
        for shot in setup.plan.shots:
            writer.write_settings(shot, {})
            for first in (0, RECORDS // 2):
                writer.append(shot, block_of(setup, shot.index, first))
            if shot.index < 2:
                writer.finish(shot)
        return path.read_bytes()


@pytest.fixture
def path(killed: bytes, tmp_path: Path) -> Path:
    """Return a log of a killed run."""
    path = tmp_path / "run.h5"
    path.write_bytes(killed)
    return path


def block_of(setup: Setup, shot: int, first: int) -> RecordBlock:
    """Return half of the records of a shot; their codes differ from record to record."""
    numbers = np.arange(first, first + RECORDS // 2)
    codes = np.repeat((100 * shot + numbers + 1).astype(np.int16)[:, None], SAMPLES, axis=1)
    scale_v = setup.plan.shots[0].capture.input_range_v / 8191.5
    return RecordBlock(first, codes, numbers / 4000.0, scale_v, scale_v / 2, (-8192, 8191))


def frames(path: Path) -> list[Frame]:
    with path.open("rb") as file:
        log = read_log(file)
    assert log is not None
    return [Frame._make(row) for row in log.frames.tolist()]


def flip(path: Path, offset: int) -> None:
    """Invert one bit of a file."""
    content = bytearray(path.read_bytes())
    content[offset] ^= 1
    path.write_bytes(content)


def codes(path: Path) -> list[list[int]]:
    """Return the first code of every record that is there, by shot."""
    return [records.codes[records.valid, 0].tolist() for records in read_run(path).records]


WHOLE = [(100 * shot + np.arange(RECORDS) + 1).tolist() for shot in range(3)]


def test_the_log_of_a_killed_run_is_read_and_becomes_a_run_file_when_it_is_opened(path: Path) -> None:
    assert path.read_bytes().startswith(SIGNATURE)
    stored = read_run(path)
    assert (stored.status, stored.shot_complete.tolist(), codes(path)) == ("killed", [True, True, False], WHOLE)
    assert not verify(path).damage
    assert is_log(path)
    assert open_run(path).stored.status == "killed"
    assert not is_log(path)
    assert not verify(path).damage
    assert codes(path) == WHOLE
    with h5py.File(path) as file:
        np.testing.assert_array_equal(file["records/echo"][:, :, 7], WHOLE)
        assert all(file[f"records/{name}"].fletcher32 for name in ("echo", "recorded", "trigger_time_s"))


def test_a_log_cut_anywhere_loses_only_what_follows_the_cut(path: Path, killed: bytes) -> None:
    ends = [frame.offset + frame.size for frame in frames(path)]
    for cut in np.random.default_rng(1).integers(ends[0], len(killed), 2).tolist():
        path.write_bytes(killed[:cut])
        shots_complete = sum(
            frame.name == "records/shot_complete" and end <= cut
            for frame, end in zip(frames_of(killed, path), ends, strict=True)
        )
        path.write_bytes(killed[:cut])
        assert int(read_run(path).shot_complete.sum()) == shots_complete
        recover(path)
        assert not is_log(path)
        assert not verify(path).damage
        for stored, whole in zip(codes(path), WHOLE, strict=True):
            assert stored == whole[: len(stored)]


def test_a_cut_is_an_interrupted_write_and_damage_before_it_stays_damage(path: Path, killed: bytes) -> None:
    log = frames(path)
    sync = next(frame for frame in log if frame.name == SHOT_COMPLETE)
    damaged = bytearray(killed)
    # In the header of the first row of the first shot.
    damaged[log[0].offset - HEADER_BYTES + 40] ^= 1
    for frame in log:
        start, end = frame.offset - HEADER_BYTES, frame.offset + frame.size
        # Nothing of the frame, a part of its header, all of it, a part of the payload, and all of it but a byte.
        for cut in sorted({start, start + 1, frame.offset - 1, frame.offset, frame.offset + frame.size // 2, end - 1}):
            assert torn_end(killed[:cut]) == (True, start)
            assert torn_end(killed[:start] + bytes(cut - start)) == (True, start)
            assert torn_end(damaged[:cut]) == (start <= sync.offset, log[0].offset - HEADER_BYTES)
    # A disk that fails before the mark of a complete shot is written.
    path.write_bytes(killed[: sync.offset])
    verification = verify(path)
    assert (verification.damage, verification.torn_bytes, codes(path)[0]) == ((), HEADER_BYTES, WHOLE[0])


def torn_end(content: bytes) -> tuple[bool, int]:
    """Return whether a log ends with an interrupted write, and the end of the last frame before it."""
    log = read_log(io.BytesIO(content))
    assert log is not None
    return log.is_torn, log.end


def test_a_payload_that_a_power_loss_left_unwritten_is_an_interrupted_write(path: Path) -> None:
    last = frames(path)[-1]
    content = path.read_bytes()
    path.write_bytes(content[: last.offset] + bytes(last.size))
    verification = verify(path)
    assert (verification.damage, verification.torn_bytes) == ((), HEADER_BYTES + last.size)
    assert codes(path)[:2] == WHOLE[:2]


def frames_of(content: bytes, path: Path) -> list[Frame]:
    path.write_bytes(content)
    return frames(path)


def test_damaged_records_of_a_log_are_reported_and_it_stays_a_log(path: Path) -> None:
    echo = next(frame for frame in frames(path) if frame.name == "records/echo" and frame.shot == 1)
    flip(path, echo.offset + 5)
    assert any("fail their checksums" in str(damage) and damage.shot == 1 for damage in verify(path).damage)
    recover(path)
    assert is_log(path)
    assert verify(path).status == open_run(path).stored.status == "killed"
    assert codes(path)[0] == WHOLE[0]
    assert prepare_resumption(path).complete == 1


def test_a_damaged_header_of_a_synced_frame_is_reported_and_nothing_is_discarded(path: Path) -> None:
    echo = next(frame for frame in frames(path) if frame.name == "records/echo" and frame.shot == 1)
    flip(path, echo.offset - HEADER_BYTES + 40)
    assert any("the log of the run is damaged" in str(damage) for damage in verify(path).damage)
    recover(path)
    assert is_log(path)
    assert read_run(path).shot_complete.tolist() == [True, False, False]


def test_a_frame_that_only_another_version_writes_is_omitted_and_those_after_it_are_read(path: Path) -> None:
    writer = LogWriter(path)
    writer.append("records/of_another_version", 2, b"1234", (2,))
    writer.append(STATUS, -1, b"aborted", ())
    writer.close()
    assert not verify(path).damage
    assert read_run(path).status == "aborted"
    recover(path)
    assert not is_log(path)
    assert (read_run(path).status, codes(path)) == ("aborted", WHOLE)


def test_damage_after_the_last_sync_is_what_a_crash_leaves(path: Path) -> None:
    echo = [frame for frame in frames(path) if frame.name == "records/echo"][-1]
    flip(path, echo.offset + 5)
    recover(path)
    assert not is_log(path)
    assert codes(path)[:2] == WHOLE[:2]
    assert codes(path)[2] == WHOLE[2][: RECORDS // 2]


def test_the_log_of_a_run_in_progress_is_left_alone(setup: Setup, tmp_path: Path) -> None:
    path = tmp_path / "run.h5"
    with RunWriter(path, setup.scene, setup.bench, setup.plan) as writer:
        writer.append(setup.plan.shots[0], block_of(setup, 0, 0))
        assert open_run(path).stored.status == "running"
        assert is_log(path)
        writer.append(setup.plan.shots[0], block_of(setup, 0, RECORDS // 2))
        assert codes(path)[0] == WHOLE[0]
    assert not is_log(path)


def test_a_row_of_another_length_leaves_the_log_of_a_run_as_it_is(setup: Setup, tmp_path: Path) -> None:
    path = tmp_path / "run.h5"
    writer = RunWriter(path, setup.scene, setup.bench, setup.plan)
    vars(writer)["_log"].append("records/clipped", 0, bytes(2), (0,))
    with pytest.raises(StoreError, match=r"cannot be made an HDF5 file \(a row of /records/clipped has 2 bytes, not 1"):
        writer.__exit__(None)
    assert is_log(path)


def test_a_log_whose_first_frame_is_damaged_is_a_message(path: Path) -> None:
    flip(path, len(SIGNATURE) + 8 + HEADER_BYTES + 100)
    with pytest.raises(StoreError, match=r"the start of the log is damaged.*Try:"):
        read_run(path)


def test_appended_bytes_zeroed_chunks_and_exchanged_chunks_of_a_run_file_are_reported(path: Path) -> None:
    recover(path)
    whole = path.read_bytes()
    path.write_bytes(whole + b"garbage")
    assert ["7 bytes follow the end" in str(damage) for damage in verify(path).damage] == [True]
    with h5py.File(path) as file:
        chunks = [file["records/echo"].id.get_chunk_info(shot) for shot in range(2)]
    first, second = (slice(chunk.byte_offset, chunk.byte_offset + chunk.size) for chunk in chunks)
    zeroed, exchanged = bytearray(whole), bytearray(whole)
    zeroed[first] = bytes(chunks[0].size)
    exchanged[first], exchanged[second] = whole[second], whole[first]
    for content, shots in ((zeroed, [0]), (exchanged, [0, 1])):
        path.write_bytes(content)
        with h5py.File(path) as file:
            # Fletcher-32 alone accepts both.
            assert file["records/echo"][:2].shape
        assert [damage.shot for damage in verify(path).damage] == shots
