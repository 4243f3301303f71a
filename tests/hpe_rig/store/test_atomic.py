"""A file is there whole or as it was, and a draft never stays behind."""

from __future__ import annotations

from pathlib import Path

import pytest

from hpe_rig.store.atomic import atomic_file


def test_what_fails_halfway_leaves_the_file_as_it_was(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_text("before", encoding="utf-8")

    def half() -> None:
        with atomic_file(path) as draft:
            draft.write_text("half", encoding="utf-8")
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
            with atomic_file(path, overwrite) as draft:
                draft.write_text(text, encoding="utf-8")
        except FileExistsError:
            assert not overwrite
    assert path.read_text(encoding="utf-8") == ("second" if overwrite else "first")
    assert list(tmp_path.iterdir()) == [path]
