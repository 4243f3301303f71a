"""A file is there whole or as it was, and a draft never stays behind."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from hpe_rig.store.atomic import atomic_file, replace_text


def test_what_fails_halfway_leaves_the_file_as_it_was(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_text("before", encoding="utf-8")

    def half() -> None:
        with atomic_file(path) as file:
            file.write(b"half")
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        half()
    assert path.read_text(encoding="utf-8") == "before"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("overwrite", [True, False])
def test_a_taken_name_is_replaced_only_where_that_is_wanted(tmp_path: Path, overwrite: bool) -> None:
    path = tmp_path / "a.txt"
    for text in ("first", "second"):
        try:
            with atomic_file(path, overwrite) as file:
                file.write(text.encode())
        except FileExistsError:
            assert not overwrite
    assert path.read_text(encoding="utf-8") == ("second" if overwrite else "first")
    assert list(tmp_path.iterdir()) == [path]


def open_elsewhere(monkeypatch: pytest.MonkeyPatch, times: int) -> None:
    """Have a file be replaced as on Windows, where another program has it open for the first ``times`` attempts."""
    left, replace = [times], Path.replace

    def refused(self: Path, target: Path) -> Path:
        if left[0] > 0:
            left[0] -= 1
            error = PermissionError(13, "Access is denied")
            error.winerror = 32  # type: ignore[attr-defined]
            raise error
        return replace(self, target)

    monkeypatch.setattr(Path, "replace", refused)


def test_a_file_that_is_open_elsewhere_is_waited_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.txt"
    path.write_text("before", encoding="utf-8")
    open_elsewhere(monkeypatch, 3)
    with atomic_file(path) as file:
        file.write(b"after")
    assert path.read_text(encoding="utf-8") == "after"


def test_a_file_that_stays_open_elsewhere_is_an_error_that_says_so_and_leaves_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.txt"
    path.write_text("before", encoding="utf-8")
    open_elsewhere(monkeypatch, 10_000)
    monkeypatch.setattr("hpe_rig.store.atomic.REPLACE_TIMEOUT_S", 0.1)
    with pytest.raises(PermissionError, match="another program has it open"), atomic_file(path) as file:
        file.write(b"after")
    assert path.read_text(encoding="utf-8") == "before"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.skipif(os.name != "posix", reason="links and access rights of POSIX")
def test_a_file_with_another_text_keeps_its_link_rights_and_line_ends(tmp_path: Path) -> None:
    path, link = tmp_path / "bench.toml", tmp_path / "link.toml"
    path.write_text("old")
    path.chmod(0o640)
    link.symlink_to(path)
    replace_text(link, "new\r\n")
    assert link.is_symlink()
    assert (path.read_bytes(), path.stat().st_mode & 0o777) == (b"new\r\n", 0o640)
