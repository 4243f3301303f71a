"""Who holds an instrument: said in words, in files that everybody may open."""

from __future__ import annotations

import os
import stat
import sys
import tempfile
from pathlib import Path

import pytest

from hpe_rig.bench.lock import BenchInUseError, holder_of, locked

NAME = "An instrument of this test"


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return where the locks of this test are."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return tmp_path / "hpe_rig-locks"


def test_who_holds_an_instrument_is_told_by_process_program_and_arguments(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "argv", ["/somewhere/hpe-rig", "run", "a" * 200])
    assert holder_of(NAME) is None
    with locked([NAME]):
        said = holder_of(NAME)
        assert said is not None
        # A hundred characters of it.
        assert said.startswith(f"process {os.getpid()} (hpe-rig run {'a' * 88}), since ")
        with pytest.raises(BenchInUseError, match="hpe-rig run aaa"), locked([NAME]):
            pass
    assert holder_of(NAME) is None


def test_an_instrument_that_nobody_signed_for_is_held_by_another_program(folder: Path) -> None:
    with locked([NAME]):
        next(folder.glob("*.holder")).unlink()
        assert holder_of(NAME) == "another program"


@pytest.mark.skipif(os.name == "nt", reason="Windows has no such permissions")
def test_locks_can_be_opened_by_everybody_and_removed_by_their_owner(folder: Path) -> None:
    before = os.umask(0o077)
    try:
        with locked([NAME]):
            assert stat.S_IMODE(folder.stat().st_mode) == 0o1777
            assert stat.S_IMODE(next(folder.glob("*.lock")).stat().st_mode) == 0o666
    finally:
        os.umask(before)
