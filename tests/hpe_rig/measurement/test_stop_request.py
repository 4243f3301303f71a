"""Requests to stop a run in a folder where other users may place files."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest

from hpe_rig.measurement.stop_request import clear_stop, stop_path, stop_requested, write_stop
from hpe_rig.store import StoreError


def test_a_request_applies_to_its_run_and_an_empty_one_to_any_run(tmp_path: Path) -> None:
    write_stop(tmp_path / "run.h5", "one")
    assert stop_requested(tmp_path / "run.h5", "one")
    assert not stop_requested(tmp_path / "run.h5", "other")
    stop_path(tmp_path / "run.h5").write_text("", encoding="ascii")
    assert stop_requested(tmp_path / "run.h5", "other")


@pytest.mark.skipif(sys.platform == "win32", reason="Windows makes links and pipes in other ways")
@pytest.mark.parametrize("planted", ["link", "pipe"])
@pytest.mark.parametrize("exchanged", [False, True], ids=["before", "between check and opening"])
def test_a_planted_link_or_pipe_is_no_request_and_delays_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, planted: str, exchanged: bool
) -> None:
    path = stop_path(tmp_path / "run.h5")
    secret = tmp_path / "secret"
    secret.write_text("", encoding="ascii")
    if planted == "pipe":
        os.mkfifo(path)
    else:
        path.symlink_to(secret)
    if exchanged:
        monkeypatch.setattr(Path, "lstat", lambda _: secret.stat())
    assert not stop_requested(tmp_path / "run.h5")


def test_a_name_that_cannot_be_cleared_refuses_the_run_with_its_path(tmp_path: Path) -> None:
    stop_path(tmp_path / "run.h5").mkdir()
    with pytest.raises(StoreError, match=r"run\.h5\.stop has the name of a request to stop this run"):
        clear_stop(tmp_path / "run.h5")
