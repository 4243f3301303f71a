"""A file is there whole or as it was, and a draft never stays behind."""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path

import pytest

from hpe_rig.store import StoreError
from hpe_rig.store.atomic import (
    atomic_file,
    make_folder,
    open_ordinary,
    refuse_unwritable,
    replace_text,
    sync_folder,
    unwritable,
    write_file,
)


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


def current_umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


@pytest.mark.skipif(os.name != "posix", reason="links and pipes of POSIX")
def test_only_an_ordinary_file_of_one_name_is_opened_and_nothing_is_waited_for(tmp_path: Path) -> None:
    plain, link, pipe, second = (tmp_path / name for name in ("plain", "link", "pipe", "second"))
    with open(plain, "wb", opener=open_ordinary) as file:
        file.write(b"a")
    assert plain.stat().st_mode & 0o777 == 0o666 & ~current_umask()
    link.symlink_to(plain)
    os.mkfifo(pipe)
    for path in (link, pipe, tmp_path):
        with pytest.raises(OSError, match=r"it is a link or no ordinary file|Is a directory"):
            open_ordinary(str(path), os.O_WRONLY)
    with pytest.raises(FileNotFoundError):
        open_ordinary(str(tmp_path / "absent"), os.O_RDONLY)
    second.hardlink_to(plain)
    with pytest.raises(OSError, match="it is a link or no ordinary file"):
        open_ordinary(str(plain), os.O_RDONLY)
    assert plain.read_bytes() == b"a"


@pytest.mark.skipif(os.name != "posix", reason="links of POSIX")
def test_a_link_at_the_name_of_a_file_is_replaced_and_its_target_kept(tmp_path: Path) -> None:
    target, link = tmp_path / "target", tmp_path / "link"
    target.write_text("secret", "utf-8")
    link.symlink_to(target)
    write_file(link, "new")
    assert not link.is_symlink()
    assert (target.read_text("utf-8"), link.read_text("utf-8")) == ("secret", "new")


def test_a_file_that_cannot_be_written_is_an_error_with_its_path_and_cause(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    write_file(path, "\u00fc")
    assert path.read_bytes() == b"\xc3\xbc"
    with pytest.raises(StoreError, match=r"a\.txt already exists and is not overwritten"):
        write_file(path, b"b", overwrite=False)
    for wrong in (tmp_path / "absent" / "a.txt", path / "b"):
        with pytest.raises(StoreError, match=r"cannot be written \(.*\)\. Try: free space there"):
            write_file(wrong, "a")
    with pytest.raises(StoreError, match="null"):
        write_file(tmp_path / "a\0b", "a")
    with pytest.raises(StoreError, match="cannot be written"):
        replace_text(tmp_path / "absent.txt", "a")
    assert unwritable(tmp_path / "new.txt") == ""
    assert unwritable(tmp_path) == "Is a directory"
    refuse_unwritable(tmp_path / "new.txt")
    with pytest.raises(StoreError, match=r"the folder .*absent does not exist\. Try: make it"):
        refuse_unwritable(tmp_path / "absent" / "a.txt")
    with pytest.raises(StoreError, match=r"cannot be written \(Is a directory\)"):
        refuse_unwritable(tmp_path)
    assert list(tmp_path.iterdir()) == [path]


def test_draft_and_folder_are_on_the_disk_before_a_file_counts_as_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A sync of the draft before its new name, and of the folder after it; a made folder is synced in its parent."""
    events, sync, replace = list[str](), os.fsync, Path.replace

    def note_sync(number: int) -> None:
        is_folder = stat.S_ISDIR(os.fstat(number).st_mode)
        events.append("folder" if is_folder else f"{os.fstat(number).st_size} bytes")
        sync(number)

    def note_replace(draft: Path, path: Path) -> Path:
        events.append("rename")
        return replace(draft, path)

    monkeypatch.setattr(os, "fsync", note_sync)
    monkeypatch.setattr(Path, "replace", note_replace)
    write_file(tmp_path / "a", "four")
    assert events == ["4 bytes", "rename", *["folder"] * (os.name == "posix")]
    events.clear()
    make_folder(tmp_path / "b" / "c")
    make_folder(tmp_path / "b" / "c")
    assert events == ["folder"] * 2 * (os.name == "posix")
    with pytest.raises(StoreError, match="exist"):
        make_folder(tmp_path / "b", exist_ok=False)


@pytest.mark.skipif(os.name != "posix", reason="Windows cannot synchronise a folder")
def test_a_file_system_that_cannot_synchronise_a_folder_is_no_error_and_a_failing_disk_is_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail_with(number: int) -> None:
        def fail(descriptor: int) -> None:
            raise OSError(number, os.strerror(number))

        monkeypatch.setattr(os, "fsync", fail)

    for number in (errno.EINVAL, errno.ENOTSUP, errno.EACCES):
        fail_with(number)
        sync_folder(tmp_path)
    fail_with(errno.EIO)
    with pytest.raises(OSError, match="Input/output"):
        sync_folder(tmp_path)


@pytest.mark.skipif(os.name != "posix", reason="hard links of POSIX")
@pytest.mark.parametrize("exists", [False, True])
def test_without_hard_links_a_new_name_is_renamed_to_unless_it_exists(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, exists: bool
) -> None:
    def refuse(path: Path, target: Path) -> None:
        raise OSError(errno.EPERM, "no hard links")

    monkeypatch.setattr(Path, "hardlink_to", refuse)
    path = tmp_path / "a.txt"
    if exists:
        path.write_text("before", "utf-8")
        with pytest.raises(StoreError, match="already exists"):
            write_file(path, "after", overwrite=False)
    else:
        write_file(path, "after", overwrite=False)
    assert path.read_text("utf-8") == ("before" if exists else "after")
    assert list(tmp_path.iterdir()) == [path]
