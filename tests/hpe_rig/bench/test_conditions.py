"""Conditions are read within their time-out, and a failure is a reason in words, never an exception."""

from __future__ import annotations

import json
import math
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from typer.testing import CliRunner

from hpe_rig.bench import Condition, conditions, parse_bench, read_bench, read_conditions
from hpe_rig.cli import commands
from hpe_rig.scene import SettingsError


def of_program(text: str, **keys: object) -> Condition:
    return Condition.model_validate({"name": "level", "command": [sys.executable, "-c", text], **keys})


@pytest.fixture
def plugin(monkeypatch: pytest.MonkeyPatch) -> Callable[[Callable[[], object]], Condition]:
    """Return a function that installs a function as a plug-in and returns its condition."""

    def install(function: Callable[[], object]) -> Condition:
        monkeypatch.setattr(conditions, "installed", lambda group: ("thermometer",))
        monkeypatch.setattr(conditions, "load", lambda group, name: function)
        monkeypatch.setattr(conditions, "_BUSY", set())
        return Condition(name="temperature", plugin="thermometer", timeout_s=0.2)

    return install


def test_a_command_and_a_plugin_give_their_number(plugin: Callable[[Callable[[], object]], Condition]) -> None:
    level, temperature = read_conditions([of_program("print(' 12.5e-1 ')"), plugin(lambda: 21)])
    assert (level.value, temperature.value) == (1.25, 21.0)
    assert not level.why + temperature.why


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("import sys; print(1); sys.exit('no sensor')", "exit code 1: no sensor; try the command in a terminal"),
        ("import sys; sys.exit(1)", "exit code 1: no message; try"),
        ("print('20,5')", "printed '20,5', not one number; let it print only a number with a decimal point"),
        ("import sys; sys.stdout.buffer.write(b'\\x1b[31m\\xff')", r"printed '\x1b[31m\xff', not one number"),
        ("print('21 degC')", "printed '21 degC', not one number"),
        ("print('1\\n2')", "not one number"),
        ("print('nan')", "nan is no finite number"),
        ("", "printed '', not one number"),
    ],
)
def test_a_command_without_a_number_is_not_read(text: str, why: str) -> None:
    (reading,) = read_conditions([of_program(text)])
    assert math.isnan(reading.value)
    assert why in reading.why


def test_a_program_that_does_not_exist_is_not_read() -> None:
    (reading,) = read_conditions([Condition(name="level", command=("no-such-program-here",))])
    assert math.isnan(reading.value)
    assert "no-such-program-here cannot be started (" in reading.why
    assert "check the key command in the bench file" in reading.why


def test_a_command_that_hangs_is_given_up_at_its_time_out_whatever_it_has_started() -> None:
    child = "import subprocess, sys; subprocess.run([sys.executable, '-c', 'import time; time.sleep(8)'])"
    start_s = time.monotonic()
    (reading,) = read_conditions([of_program(child, timeout_s=0.5)])
    assert time.monotonic() - start_s < 4.0
    assert "within 0.5 s" in reading.why


@pytest.mark.skipif(sys.platform == "win32", reason="a shell starts the processes")
def test_a_command_that_hangs_is_ended_with_the_processes_that_it_has_started(tmp_path: Path) -> None:
    line = "sleep 30 & echo $! > child; sleep 30"
    command = ("sh", "-c", f"cd '{tmp_path}'; {line}")
    read_conditions([Condition(name="level", command=command, timeout_s=0.5)])
    child = int((tmp_path / "child").read_text())
    end_s = time.monotonic() + 5.0
    while is_running(child) and time.monotonic() < end_s:
        time.sleep(0.02)
    assert not is_running(child)


def is_running(pid: int) -> bool:
    """Return whether a process is neither ended nor waits for its parent to ask for its exit code."""
    done = subprocess.run(["ps", "-o", "stat=", "-p", str(pid)], capture_output=True, text=True, check=False)
    return done.stdout.strip()[:1] not in ("", "Z")


def test_a_plugin_that_hangs_is_not_called_again_until_it_returns(
    plugin: Callable[[Callable[[], object]], Condition],
) -> None:
    release, calls = threading.Event(), list[int]()

    def hang() -> float:
        calls.append(1)
        release.wait()
        return 4.0

    condition = plugin(hang)
    reasons = [read_conditions([condition])[0].why for _ in range(2)]
    assert "within 0.2 s" in reasons[0]
    assert "has not returned" in reasons[1]
    assert len(calls) == 1
    release.set()


def test_a_plugin_that_fails_or_is_absent_is_not_read(plugin: Callable[[Callable[[], object]], Condition]) -> None:
    absent = Condition(name="temperature", plugin="no_such_plugin")
    assert "no_such_plugin in the group hpe_rig.conditions" in read_conditions([absent])[0].why
    assert "division by zero" in read_conditions([plugin(lambda: 1 / 0)])[0].why
    assert "failed (SystemExit: 0)" in read_conditions([plugin(lambda: sys.exit(0))])[0].why


@pytest.mark.parametrize(
    ("limits", "value", "accepted", "text"),
    [
        ({}, math.nan, True, ""),
        ({"min": 0.0}, math.nan, False, "at least 0"),
        ({"max": 0.0}, 0.0, True, "at most 0"),
        ({"min": -1.0, "max": 1.0}, 1.5, False, "-1 to 1"),
    ],
)
def test_only_a_condition_with_limits_can_hold_up_a_shot(
    limits: dict[str, float], value: float, accepted: bool, text: str
) -> None:
    condition = Condition.model_validate({"name": "level", "command": ["x"], **limits})
    assert condition.accepts(value) is accepted
    assert condition.limits_text == text


def test_mistakes_of_conditions_are_reported_together() -> None:
    text = (
        read_bench().text
        + '\n[[conditions]]\nname = "a"\n\n[[conditions]]\nname = "a"\nplugin = "p"\nmin = 2.0\nmax = 1.0\n'
    )
    with pytest.raises(SettingsError) as refused:
        parse_bench("bench", text)
    for words in ("a needs a command or a plug-in", "a occurs twice", "min = 2 is above max = 1"):
        assert words in str(refused.value)
    with pytest.raises(SettingsError, match=r"conditions\[0\]\.name"):
        parse_bench("bench", read_bench().text + '\n[[conditions]]\nname = "water level"\ncommand = ["x"]\n')


def test_more_conditions_than_a_run_file_has_room_for_are_refused() -> None:
    tables = [f'\n[[conditions]]\nname = "c{number}"\ncommand = ["x"]\n' for number in range(65)]
    assert len(parse_bench("bench", read_bench().text + "".join(tables[:64])).bench.conditions) == 64
    with pytest.raises(SettingsError, match=r"conditions.*64"):
        parse_bench("bench", read_bench().text + "".join(tables))


def test_a_bench_file_without_the_table_has_no_conditions() -> None:
    assert read_bench().bench.conditions == ()


def test_a_bench_report_with_a_condition_that_would_stop_every_run_ends_with_exit_code_1(tmp_path: Path) -> None:
    path, limits = tmp_path / "bench.toml", "max = 22.0\nmax_wait_s = 90.0\n"
    for text, exit_code in (("import sys; sys.exit(1)", 1), ("print(30)", 1), ("print(20)", 0)):
        condition = of_program(text)
        lines = f'\n[[conditions]]\nname = "level"\ncommand = {json.dumps(condition.command)}\n{limits}'
        path.write_text(read_bench().text + lines, encoding="utf-8")
        done = CliRunner().invoke(commands, ["bench", str(path)])
        assert done.exit_code == exit_code, done.output
        assert ("a run would wait before its first shot for level, and end after 90 s" in done.output) == exit_code
