"""The journal between HDF5 and the disk: what reaches the file and when, and whose file it is."""

from __future__ import annotations

import errno
import io
import os
import signal
import threading
from pathlib import Path

import h5py
import numpy as np
import pytest

from hpe_rig.bench import uninterrupted
from hpe_rig.store import StoreError, is_locked, journal as journal_module
from hpe_rig.store.journal import Journal, lookup3, make_or_undo
from hpe_rig.store.writer import open_on


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """Return a small HDF5 file."""
    path = tmp_path / "file.h5"
    with h5py.File(path, "w", libver=("v110", "v110")) as file:
        file.create_dataset("echo", (4, 10), "<i2", chunks=(1, 10), fillvalue=-1)
        file["rows"] = np.zeros(4)
    return path


def test_the_checksum_of_metadata_is_that_of_its_authors_and_of_the_library(path: Path) -> None:
    # The values that the author of lookup3 gives for his examples, and a superblock that the library wrote.
    assert lookup3(b"") == 0xDEADBEEF
    assert lookup3(b"Four score and seven years ago") == 0x17770551
    superblock = path.read_bytes()[:48]
    assert lookup3(superblock[:-4]) == int.from_bytes(superblock[-4:], "little")


def test_nothing_reaches_the_file_before_a_commit_and_the_file_is_whole_after_each(path: Path) -> None:
    before = path.read_bytes()
    journal = Journal(path)
    file = open_on(journal)
    for row in range(4):
        file["echo"][row] = row
        file["rows"][row] = row
        file.flush()
        # The library itself reads what it wrote.
        assert file["echo"][row].tolist() == [row] * 10
        assert row or path.read_bytes() == before
        journal.commit()
        # In the plain way, as programs do that know of no writer.
        with h5py.File(path, "r") as other:
            assert other["echo"][:, 0].tolist() == [*range(row + 1), *[-1] * (3 - row)]
            assert other["rows"][row] == row
    file.close()
    journal.commit(sync=True)
    journal.close()
    with h5py.File(path, "r") as other:
        assert other["echo"][3].tolist() == [3] * 10


@pytest.mark.skipif(os.name == "nt", reason="a console's signals cannot be sent to one process on Windows")
@pytest.mark.parametrize("to_thread", [False, True], ids=["to the process", "to a thread that waits for nobody"])
def test_what_is_made_while_an_interrupt_comes_is_undone_before_the_program_goes_on(
    tmp_path: Path, to_thread: bool
) -> None:
    new = tmp_path / "new.h5"

    def make(given_up: threading.Event) -> Path:
        new.touch()
        if to_thread:
            # As where it comes just before the main thread falls asleep: nothing wakes that.
            signal.pthread_kill(threading.get_ident(), signal.SIGINT)
        else:
            os.kill(os.getpid(), signal.SIGINT)
        assert given_up.wait(5.0)
        return new

    # as where a run file is made: signals wait until somebody lets them through
    with pytest.raises(KeyboardInterrupt), uninterrupted():
        make_or_undo(make, Path.unlink)
    assert not new.exists()


class Dribbling:
    """A file on a share that brings a few bytes a read."""

    def __init__(self, file: io.FileIO) -> None:
        self._file, self.seek, self.close = file, file.seek, file.close

    def readinto(self, buffer: memoryview) -> int:
        return self._file.readinto(buffer[:7]) or 0


def test_a_disk_that_brings_less_than_was_asked_for_is_asked_again(path: Path) -> None:
    journal, content = Journal(path), path.read_bytes()
    vars(journal)["_view"] = Dribbling(vars(journal)["_view"])
    found = bytearray(b"?" * (len(content) + 20))
    journal.write(memoryview(b"written"))
    journal.seek(0)
    assert journal.readinto(memoryview(found)) == len(found)
    assert found == b"written" + content[7:] + bytes(20)
    assert journal.tell() == len(found)
    journal.close()


def test_a_file_cut_under_its_writer_is_noticed_and_left_alone_from_then_on(path: Path) -> None:
    journal = Journal(path)
    file = open_on(journal)
    rows = file["rows"]
    os.truncate(path, 100)
    rows[0] = 1.0
    file.flush()
    for _ in range(2):
        with pytest.raises(StoreError, match=r"changed by another program: it has 100 bytes"):
            journal.commit()
    file.close()
    journal.close()
    assert path.stat().st_size == 100


@pytest.mark.skipif(os.name == "nt", reason="an open file keeps its name there")
def test_a_disk_that_hangs_is_waited_for_once_and_nothing_more_is_asked_of_it(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(journal_module, "STEP_TIMEOUT_S", 0.05)
    journal, answers, asked = Journal(path), threading.Event(), list[str]()

    class Hanging:
        def write(self, data: memoryview) -> int:
            asked.append("write")
            answers.wait(10.0)
            return len(data)

        def __getattr__(self, name: str) -> object:
            return getattr(file, name)

    file, vars(journal)["_file"] = vars(journal)["_file"], Hanging()
    journal.write(memoryview(b"new"))
    with pytest.raises(OSError, match=r"the disk has not answered for 0\.05 s"):
        journal.commit()
    for ask in (lambda: journal.overwrite(((0, b"later"),)), lambda: journal.overwrite(((0, b"again"),))):
        with pytest.raises(OSError, match="the disk does not answer"):
            ask()
    # Returns without the disk, which keeps the file.
    journal.close()
    assert not file.closed
    assert asked == ["write"]
    answers.set()
    for each in (file, vars(journal)["_view"]):
        each.close()


def test_a_file_that_was_moved_or_replaced_is_noticed(path: Path) -> None:
    journal = Journal(path)
    path.rename(path.with_name("elsewhere.h5"))
    with pytest.raises(StoreError, match="moved or removed"):
        journal.commit()
    journal.close()
    other = path.with_name("elsewhere.h5")
    journal = Journal(other)
    other.unlink()
    other.write_bytes(b"another")
    with pytest.raises(StoreError, match="replaced by another file"):
        journal.commit()
    assert not journal.is_in_place()
    journal.close()
    assert other.read_bytes() == b"another"


def test_a_file_has_one_writer_and_any_number_of_readers(path: Path) -> None:
    assert is_locked(path) is False
    journal = Journal(path)
    assert journal.locked
    with h5py.File(path, "r") as reader:
        assert reader["rows"].shape == (4,)
    # The lock is of the open file: no reader's end in this program releases it.
    assert is_locked(path) is True
    with pytest.raises(StoreError, match="is being written by another run"):
        Journal(path)
    journal.close()
    assert is_locked(path) is False


class Waiting:
    """A file on a disk that takes nothing until ``answers`` is set, and then fails where it is told to."""

    def __init__(self, file: io.FileIO, error: Exception | None = None) -> None:
        self._file, self._error, self.answers = file, error, threading.Event()
        self.fileno, self.seek, self.truncate, self.close = file.fileno, file.seek, file.truncate, file.close

    def write(self, data: memoryview) -> int:
        assert self.answers.wait(10)
        if self._error is not None:
            raise self._error
        return self._file.write(data) or 0


def test_a_commit_goes_on_while_the_next_is_prepared_and_the_library_reads_both(path: Path) -> None:
    journal, before = Journal(path), path.read_bytes()
    file, disk = open_on(journal), Waiting(vars(journal)["_file"])
    vars(journal)["_file"] = disk
    file["echo"][0] = 7
    file["rows"][0] = 1.0
    file.flush()
    journal.commit(wait=False)
    file["rows"][1] = 2.0
    file.flush()
    assert path.read_bytes() == before
    # As the library would read it, which keeps most of it in memory: what is under way, and what waits for its turn.
    content = bytearray(journal.seek(0, 2))
    journal.seek(0)
    journal.readinto(memoryview(content))
    with h5py.File(io.BytesIO(content), "r") as other:
        assert other["rows"][:2].tolist() == [1.0, 2.0]
        assert other["echo"][0].tolist() == [7] * 10
    disk.answers.set()
    journal.commit()
    file.close()
    journal.commit()
    journal.close()
    with h5py.File(path, "r") as other:
        assert other["rows"][:2].tolist() == [1.0, 2.0]


def test_after_an_interrupt_a_disk_that_hangs_already_is_waited_for_a_moment_only(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Ctrl-C may come before anybody waits for the step that hangs: then it was 60 s until the program ended."""
    monkeypatch.setattr(journal_module, "LAST_STEP_TIMEOUT_S", 0.05)
    journal = Journal(path)
    disk = vars(journal)["_file"] = Waiting(vars(journal)["_file"])
    journal.shorten_timeout()
    assert not vars(journal)["_interrupted"]
    journal.write(memoryview(b"new"))
    journal.commit(wait=False)
    journal.shorten_timeout()
    with pytest.raises(OSError, match=r"the disk has not answered for 0\.05 s"):
        journal.commit()
    disk.answers.set()
    for each in (disk, vars(journal)["_view"]):
        each.close()


@pytest.mark.parametrize("error", [OSError(errno.ENOSPC, "no room"), MemoryError("no room")])
def test_what_a_commit_failed_with_that_nobody_waited_for_is_raised_by_every_further_one(
    path: Path, error: Exception
) -> None:
    journal, before = Journal(path), path.read_bytes()
    file, disk = open_on(journal), Waiting(vars(journal)["_file"], error)
    vars(journal)["_file"] = disk
    file["rows"][0] = 1.0
    file.flush()
    journal.commit(wait=False)
    disk.answers.set()
    # Once would be too little: the next batch would come to a file that lacks this one.
    for _ in range(2):
        with pytest.raises(type(error), match="no room"):
            journal.commit()
    assert path.read_bytes() == before
    file.close()
    journal.close()
