"""Locks of instruments: who holds one, where the files are, and what other users may place there."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from drivers.interfaces import InstrumentError
from hpe_rig.bench import hold, lock, parse_bench, read_bench, resources
from hpe_rig.bench.lock import BenchInUseError, exclusive, holder_of, lock_folder, locked

NAME = "An instrument of this test"
CHILD = f"from hpe_rig.bench.lock import locked\nwith locked([{NAME!r}]): pass"


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the folder of the locks of this test."""
    monkeypatch.setenv("HPE_RIG_LOCKS", str(tmp_path))
    return tmp_path


@pytest.fixture
def path(folder: Path) -> Path:
    """Return the file of this test's lock, which does not exist yet."""
    with locked([NAME]):
        (file,) = folder.iterdir()
    file.unlink()
    return file


def other_program(**options: object) -> subprocess.CompletedProcess[str]:
    """Return the end of another program that locks the instrument."""
    return subprocess.run([sys.executable, "-c", CHILD], capture_output=True, text=True, timeout=60, **options)  # type: ignore[call-overload, no-any-return]


def refused_to_another_user() -> bool:
    """Return whether another process is refused the lock by this one; as another user if this one may do that."""
    child = os.fork()
    if not child:
        with suppress(BaseException):
            # Only root can become another user; for anybody else this is the test of two programs.
            if os.geteuid() == 0:
                os.setgroups([])
                os.setgid(65534)
                os.setuid(65534)
            try:
                with locked([NAME]):
                    os._exit(0)
            except BenchInUseError as error:
                os._exit(1 if f"process {os.getppid()} " in error.holder else 2)
        os._exit(3)
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    assert code in (0, 1)
    return code == 1


def test_the_holder_is_named_by_process_program_and_arguments(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "argv", ["/somewhere/hpe-rig", "run", "a" * 200])
    assert holder_of(NAME) is None
    with locked([NAME]):
        holder = holder_of(NAME)
        assert holder is not None
        # A hundred characters of the command line.
        assert holder.startswith(f"process {os.getpid()} (hpe-rig run {'a' * 88}), since ")
        with pytest.raises(BenchInUseError, match="hpe-rig run aaa"), locked([NAME]):
            pass
    assert holder_of(NAME) is None


def test_an_unnamed_holder_is_another_program(path: Path) -> None:
    with locked([NAME]):
        path.write_text("", encoding="utf-8")
        assert holder_of(NAME) == "another program"


def test_what_another_user_writes_into_a_lock_is_printed_as_one_short_line(path: Path) -> None:
    with locked([NAME]):
        path.write_bytes(b"\x1b[2Jevil\nname\xff" + b"a" * 5000)
        holder = holder_of(NAME)
    assert holder is not None
    assert holder.startswith("\\x1b[2Jevil name")
    assert len(holder) < 310


def test_programs_with_other_temporary_folders_exclude_each_other(tmp_path: Path) -> None:
    with locked([NAME]):
        refused = other_program(env={**os.environ, "TMPDIR": str(tmp_path), "TEMP": str(tmp_path)})
    assert refused.returncode != 0
    assert f"in use by process {os.getpid()}" in refused.stderr


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such folders")
def test_the_folder_is_that_of_the_system_whatever_the_temporary_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("HPE_RIG_LOCKS")
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    assert lock_folder() in (Path("/run/lock"), Path("/tmp"))
    # Permissions that keep other users out make the second folder the one for all.
    private = tmp_path / "private"
    private.mkdir(mode=0o755)
    monkeypatch.setattr(lock, "SYSTEM_FOLDERS", (private, tmp_path))
    assert lock_folder() == tmp_path


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such permissions")
def test_every_user_reaches_the_lock_of_another_one(path: Path, folder: Path) -> None:
    umask = os.umask(0o077)
    try:
        with locked([NAME]):
            assert path.stat().st_mode & 0o777 == 0o666
            # Every folder up to that of temporary files; with parallel tests there is one more.
            for parent in folder.parents:
                if parent.stat().st_mode & 0o055 == 0o055:
                    break
                parent.chmod(parent.stat().st_mode | 0o055)
            # Linux protects files in such a folder from being created again by other users.
            folder.chmod(0o1777)
            assert refused_to_another_user()
    finally:
        os.umask(umask)
    assert not refused_to_another_user()


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such permissions")
def test_a_lock_that_may_only_be_read_is_respected(path: Path) -> None:
    path.touch(0o444)
    with locked([NAME]):
        assert other_program().returncode != 0
    assert other_program().returncode == 0


@pytest.mark.skipif(sys.platform == "win32", reason="Windows makes links and pipes in other ways")
@pytest.mark.parametrize("planted", ["link", "hard link", "link to nothing", "pipe", "folder"])
def test_anything_but_an_ordinary_file_is_refused_untouched_and_at_once(
    path: Path, folder: Path, tmp_path_factory: pytest.TempPathFactory, planted: str
) -> None:
    victim = tmp_path_factory.mktemp("victim") / "file"
    victim.write_text("precious", encoding="utf-8")
    victim.chmod(0o600)
    if planted == "hard link":
        path.hardlink_to(victim)
    elif planted == "pipe":
        os.mkfifo(path)
    elif planted == "folder":
        path.mkdir()
    else:
        path.symlink_to(victim if planted == "link" else folder / "nothing")
    start_s = time.monotonic()
    expected = "link" if "link" in planted else "no ordinary file"
    what = rf"cannot be locked\. {re.escape(str(path))}.*cannot be used: it is .*{expected}, which user \d+ has placed"
    with pytest.raises(InstrumentError, match=f"(?i){what}"), locked([NAME]):
        pass
    # An emergency is not stopped by it.
    assert holder_of(NAME) is None
    assert time.monotonic() - start_s < 5.0
    assert (victim.read_text(encoding="utf-8"), victim.stat().st_mode & 0o777) == ("precious", 0o600)


def test_a_missing_folder_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("HPE_RIG_LOCKS", str(tmp_path / "absent"))
    with pytest.raises(InstrumentError, match=r"absent.*No such file"), locked([NAME]):
        pass


def test_a_lock_without_room_for_its_holder_excludes_others(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> int:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "write", full)
    with locked([NAME]), pytest.raises(BenchInUseError, match="another program"), locked([NAME]):
        pass


def test_a_real_bench_locks_each_generator_by_name_and_text_each_serial_number_and_its_board(
    real_bench: Callable[..., Path],
) -> None:
    path = real_bench(("board_id = 1", "board_id = 2"), address="TCPIP::127.0.0.1::{}::SOCKET")
    bench = parse_bench("metal", path.read_text("utf-8").replace('serial = "none"', 'serial = "MY7"', 1)).bench
    names = [f"TCPIP::127.0.0.1:{port}" for port in range(10, 15)]
    assert resources(bench) == sorted([*names, "serial number MY7", "Alazar system 1 board 2"])
    assert resources(bench, resolve=False) == resources(bench)
    assert resources(read_bench().bench) == []
    with exclusive(bench):
        assert all(holder_of(name) for name in resources(bench))
    assert not any(holder_of(name) for name in resources(bench))
    with locked([names[0]]), exclusive(read_bench().bench):
        pass
    with locked([names[0]]), pytest.raises(BenchInUseError) as refused, exclusive(bench):
        pass
    assert (refused.value.resource, refused.value.role) == (names[0], "bench")
    assert f"process {os.getpid()} " in refused.value.holder
    # A lock that was taken before the refused one is released.
    assert holder_of("Alazar system 1 board 2") is None


def test_locks_held_for_several_runs_are_taken_once_and_released_by_the_one_that_took_them() -> None:
    with hold([NAME]):
        with hold([NAME, "another"]), locked([NAME, "another"]):
            assert holder_of("another")
        assert holder_of("another") is None
        assert holder_of(NAME)
    assert holder_of(NAME) is None
    with locked([NAME]), pytest.raises(BenchInUseError), locked([NAME]):
        pass


def test_a_lock_left_by_a_crashed_program_is_taken_over_with_an_announcement(path: Path, capsys: Any) -> None:
    announced = list[str]()
    path.write_text("process 1 (hpe-rig run), since yesterday", "utf-8")
    words = "the bench was left locked by process 1 (hpe-rig run), since yesterday, which has ended: taken over"
    with locked([NAME], announced.append):
        assert announced == [words]
        assert f"process {os.getpid()} " in path.read_text("utf-8")
    assert path.read_text("utf-8") == ""
    with locked([NAME], announced.append):
        pass
    assert announced == [words]
    path.write_text("process 1", "utf-8")
    with locked([NAME]):
        pass
    assert capsys.readouterr().err == "hpe-rig: the bench was left locked by process 1, which has ended: taken over\n"
