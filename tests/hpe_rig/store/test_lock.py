"""Lock of a run file: one writer at a time, held by the open file."""

from __future__ import annotations

from pathlib import Path

import pytest

from hpe_rig.store import acquire, is_locked, lock


def test_a_file_is_locked_while_its_writer_has_it_open_and_readers_are_not_disturbed(tmp_path: Path) -> None:
    path = tmp_path / "a.h5"
    assert is_locked(path) is None
    with path.open("ab") as file:
        assert is_locked(path) is False
        assert acquire(file)
        assert is_locked(path) is True
        with path.open("ab") as second, pytest.raises(BlockingIOError):
            acquire(second)
        # The lock belongs to the open file: closing another one does not release it.
        assert path.read_bytes() == b""
        assert is_locked(path) is True
        moved = path.rename(tmp_path / "b.h5")
        assert is_locked(moved) is True
    assert is_locked(moved) is False


def test_a_file_system_without_locks_is_no_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(number: int, exclusive: bool) -> None:
        raise OSError(95, "not supported")

    monkeypatch.setattr(lock, "_lock", refuse)
    with (tmp_path / "a.h5").open("ab") as file:
        assert not acquire(file)
    assert is_locked(tmp_path / "a.h5") is None
