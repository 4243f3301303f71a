"""The computer is kept awake during a run of a real bench, and released after it, also after a crash."""

from __future__ import annotations

import logging
import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from drivers.interfaces import InstrumentError
from hpe_rig.measurement import awake, prepare, record_run
from hpe_rig.scene import load_scene

HOLDER = (
    "import pathlib, sys; p = pathlib.Path(sys.argv[1]); p.write_text('held'); sys.stdin.read(); p.write_text('free')"
)
"""Stands for the system's command: it holds a request until its standard input is closed."""


@pytest.fixture
def request_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the file in which the stand-in states whether the request is held."""
    path = tmp_path / "request.txt"
    monkeypatch.setattr(awake.sys, "platform", "linux")
    monkeypatch.setattr(awake, "INHIBIT", (sys.executable, "-c", HOLDER, str(path)))
    return path


def wait_for(path: Path, text: str) -> None:
    deadline_s = time.monotonic() + 20.0
    while not (path.is_file() and path.read_text(encoding="utf-8") == text):
        assert time.monotonic() < deadline_s, text
        time.sleep(0.02)


def test_the_request_lasts_as_long_as_the_block_and_ends_with_an_error_too(request_file: Path) -> None:
    def interrupted() -> None:
        with awake.kept_awake(True):
            wait_for(request_file, "held")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert request_file.read_text(encoding="utf-8") == "free"


def test_a_killed_program_releases_the_request(request_file: Path) -> None:
    program = (
        "import sys, time; from hpe_rig.measurement import awake; sys.platform = 'linux'\n"
        f"awake.INHIBIT = {awake.INHIBIT!r}\n"
        "with awake.kept_awake(True):\n    time.sleep(60)"
    )
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    killed = subprocess.Popen([sys.executable, "-c", program], env=environment)
    wait_for(request_file, "held")
    killed.kill()
    killed.wait()
    wait_for(request_file, "free")


def test_a_system_without_the_command_is_noted_in_the_log_alone(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(awake.sys, "platform", "linux")
    monkeypatch.setattr(awake, "INHIBIT", ("no-such-program-here",))
    with caplog.at_level(logging.INFO, "hpe_rig"), awake.kept_awake(True):
        pass
    assert "no-such-program-here" in caplog.text
    assert not [record for record in caplog.records if record.levelno > logging.INFO]


def test_only_a_run_of_a_real_bench_keeps_the_computer_awake(
    request_file: Path, tmp_path: Path, real_bench: Callable[..., Path]
) -> None:
    scene = load_scene("bovine-muscle-synchronous").with_({"excitation.burst_count": 2, "processing.window_start_s": 0})
    record_run(prepare(scene), tmp_path / "simulated.h5")
    assert not request_file.exists()
    bench = real_bench(address="TCPIP::127.0.0.1::{}::SOCKET")
    with pytest.raises(InstrumentError):
        record_run(prepare(scene, bench), tmp_path / "real.h5")
    wait_for(request_file, "free")
