"""Text fits the terminal, progress is reported without a terminal, and an early interrupt ends with one line."""

from __future__ import annotations

import logging
import os
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from hpe_rig.cli import terminal
from hpe_rig.cli.app import app
from hpe_rig.cli.terminal import duration_text, progress_reporter, wrapped
from hpe_rig.scene import engineering

ROOT = Path(__file__).parents[3]


def test_a_long_line_is_wrapped_and_indented_like_its_text() -> None:
    broken = wrapped("  WARNING aliasing: " + "word " * 20, 40).splitlines()
    assert len(broken) > 2
    assert max(map(len, broken)) <= 40
    assert all(line.startswith("          word") for line in broken[1:])
    table = wrapped("   instruments  " + "master, " * 10, 40).splitlines()
    assert all(line.startswith(" " * 16 + "master") for line in table[1:])


def test_an_address_is_not_wrapped() -> None:
    address = "http://127.0.0.1:8765/?token=" + "a-" * 40
    assert address in wrapped(f"live page: {address}", 60)


def test_text_for_a_file_is_not_wrapped() -> None:
    assert wrapped("word " * 100, None) == "word " * 100


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [
        (9e6, "Hz", "9 MHz"),
        (3990.0, "Hz", "3990 Hz"),
        (131e-6, "s", "131 us"),
        (999999.7, "Hz", "1 MHz"),
        (10922.4, "Hz", "10922 Hz"),
        (0.0, "s", "0 s"),
        (-2.5e-9, "m", "-2.5 nm"),
        (1.5e8, "B", "150 MB"),
    ],
)
def test_numbers_are_in_engineering_notation(value: float, unit: str, text: str) -> None:
    assert engineering(value, unit) == text


def test_progress_is_reported_in_lines_without_a_terminal(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    now_s = 0.0
    monkeypatch.setattr(terminal.time, "monotonic", lambda: now_s)
    with progress_reporter("cases") as report:
        for done in range(1, 101):
            now_s = float(done)
            report(done, 100, "")
    lines = capsys.readouterr().err.splitlines()
    # It begins at 0 s with one case per second.
    assert lines[0] == "cases: 10 of 100, about 2 min left"
    assert len(lines) == 9


def test_a_quiet_command_reports_nothing(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(terminal, "REPORT_INTERVAL_S", 0.0)
    with progress_reporter("cases", quiet=True) as report:
        report(5, 10, "")
    assert capsys.readouterr().err == ""


def test_durations_have_a_convenient_unit() -> None:
    assert [duration_text(duration_s) for duration_s in (40.2, 200.0, 7200.0)] == ["40 s", "3 min", "2.0 h"]


def test_check_begins_with_its_verdict_and_lists_passed_checks_with_verbose() -> None:
    quiet, full = (CliRunner().invoke(app, ["check", "table-1", *more]).stdout for more in ((), ("--verbose",)))
    assert quiet.splitlines()[2].startswith("CAN BE MEASURED")
    assert "  ok " not in quiet
    assert full.count("  ok ") > 10
    assert set(quiet.splitlines()) - set(full.splitlines()) == {
        line for line in quiet.splitlines() if line.startswith("checks:")
    }


@pytest.mark.parametrize("columns", [80, 120])
def test_check_fits_the_terminal(columns: int) -> None:
    said = CliRunner().invoke(app, ["check", "table-1", "--verbose"], env={"COLUMNS": f"{columns}"}).stdout
    assert max(map(len, said.splitlines())) <= columns


def test_the_version_is_printed() -> None:
    done = CliRunner().invoke(app, ["--version"])
    assert (done.exit_code, done.stdout.split()[0]) == (0, "hpe-rig")


def test_every_package_logs_under_its_own_name(caplog: pytest.LogCaptureFixture, tmp_path: Path) -> None:
    before = {name: logging.getLogger(name).level for name in ("hpe_rig", "drivers", "sim_backend")}
    try:
        with caplog.at_level(logging.DEBUG):
            run = ["--log-level", "debug", "run", "table-1", "--output", str(tmp_path / "run.h5"), "--json"]
            assert CliRunner().invoke(app, run).exit_code == 0
    finally:
        for name, level in before.items():
            logging.getLogger(name).setLevel(level)
    named = {record.name for record in caplog.records}
    assert named <= {"hpe_rig", "drivers", "sim_backend", "h5py", "pyvisa"} | {name for name in named if "." in name}
    said = [record.getMessage() for record in caplog.records]
    assert "shot 1: fire" in said
    assert "master <- *TRG" in " ".join(said)
    assert any("AlazarStartCapture returns 512" in text for text in said)


@pytest.mark.skipif(sys.platform == "win32", reason="Windows sends no SIGINT to one process")
def test_an_interrupt_while_the_program_loads_ends_with_one_line() -> None:
    # The interrupt comes after the entry point has begun and before other modules are loaded.
    code = "import os, signal; from hpe_rig.cli import entry; import sys\n"
    code += "sys.meta_path.insert(0, type('Hook', (), {'find_spec': staticmethod(lambda name, *_: "
    code += "os.kill(os.getpid(), signal.SIGINT) if name == 'typer' else None)}))\nentry.main()"
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment)
    assert (done.returncode, done.stderr) == (130, "hpe-rig: interrupted\n")


@pytest.mark.skipif(sys.platform == "win32", reason="Windows sends no SIGINT to one process")
def test_an_interrupt_while_the_package_loads_ends_the_program_with_one_line_and_raises_in_other_processes(
    tmp_path: Path,
) -> None:
    # lazy_loader is the first package that hpe_rig loads. The one in this folder interrupts, and is found first.
    (tmp_path / "lazy_loader.py").write_text(
        "import os, signal, time\nos.kill(os.getpid(), signal.SIGINT)\ntime.sleep(1)\n"
    )
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join((str(tmp_path), str(ROOT)))}
    for words, code in ((["-m", "hpe_rig"], 130), (["-c", "import hpe_rig"], -2)):
        done = subprocess.run([sys.executable, *words], capture_output=True, text=True, env=environment, cwd=tmp_path)
        assert done.returncode == code
        assert ("Traceback" in done.stderr) == (code != 130)
        assert ("hpe-rig: interrupted" in done.stderr) == (code == 130)
