"""``hpe-rig bench BENCH --identify`` at a terminal: displays, answers, the bench file, Ctrl-C."""

from __future__ import annotations

import os
import re
import select
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest
from typer.testing import CliRunner

from hpe_rig.bench import GENERATOR_ROLES, parse_bench, read_bench
from hpe_rig.bench.emulation import addressed
from hpe_rig.cli.app import app
from sim_backend.settings import SimulationSettings
from sim_backend.transports.emulator import Emulator
from sim_backend.world import World

posix = pytest.mark.skipif(os.name != "posix", reason="needs a pseudo-terminal")


@pytest.fixture
def bench(tmp_path: Path) -> Path:
    path = tmp_path / "my-bench.toml"
    path.write_text(read_bench().text, encoding="utf-8")
    return path


class Terminal:
    """A person at a terminal with ``hpe-rig bench BENCH --identify``."""

    def __init__(self, bench: Path) -> None:
        controller, terminal = os.openpty()
        command = [sys.executable, "-m", "hpe_rig", "bench", str(bench), "--identify"]
        streams = {"stdin": terminal, "stdout": terminal, "stderr": terminal}
        self.process = subprocess.Popen(command, start_new_session=True, **streams)
        os.close(terminal)
        self._controller, self.text, self._answered = controller, "", 0

    def read_until(self, words: str) -> None:
        """Wait until ``words`` appear after those that were waited for before."""
        deadline_s = time.monotonic() + 60
        while words not in self.text[self._answered :]:
            assert time.monotonic() < deadline_s, self.text
            if select.select([self._controller], [], [], 0.5)[0]:
                self.text += os.read(self._controller, 4096).decode(errors="replace")
        self._answered = self.text.index(words, self._answered) + len(words)

    def answer(self, text: str) -> None:
        os.write(self._controller, f"{text}\n".encode())

    def end(self) -> int:
        """Return the exit code, after the rest of the output was read."""
        while True:
            try:
                assert select.select([self._controller], [], [], 60)[0], self.text
                part = os.read(self._controller, 4096)
            except OSError:
                break
            if not part:
                break
            self.text += part.decode(errors="replace")
        return self.process.wait(timeout=30)

    def close(self) -> None:
        """End the process if a test failed before its end."""
        os.close(self._controller)
        self.process.kill()
        self.process.wait()


@pytest.fixture
def start(bench: Path) -> Iterator[Callable[[], Terminal]]:
    """Yield a function that starts the command; its process ends with the test."""
    with ExitStack() as stack:

        def started() -> Terminal:
            terminal = Terminal(bench)
            stack.callback(terminal.close)
            return terminal

        yield started


@pytest.mark.slow
@posix
def test_a_dry_run_writes_every_serial_number_and_keeps_comments_layout_and_rights(
    bench: Path, start: Callable[[], Terminal]
) -> None:
    bench.chmod(0o640)
    before = bench.read_text(encoding="utf-8")
    person = start()
    for role in GENERATOR_ROLES:
        person.read_until(f"shows {role.replace('_', ' ').upper()}. ")
        person.answer("y")
    assert person.end() == 0
    after = bench.read_text(encoding="utf-8")
    assert read_bench(bench).bench.serials == {
        **{role: f"SIM_BOX_{number}" for number, role in enumerate(GENERATOR_ROLES, 1)},
        "digitizer": "460001",
    }
    assert re.sub(r"^serial = .*\n", "", after, flags=re.M) == before
    assert bench.stat().st_mode & 0o777 == 0o640
    assert CliRunner().invoke(app, ["bench", str(bench)]).exit_code == 0


@posix
def test_exchanged_instruments_are_written_by_their_true_roles_and_refused_until_addresses_are_exchanged(
    bench: Path, start: Callable[[], Terminal]
) -> None:
    bench.chmod(0o640)
    before = bench.read_text(encoding="utf-8")
    person = start()
    answers = {"toneburst": "tracking pulser", "tracking_pulser": "toneburst"}
    for role in GENERATOR_ROLES:
        person.read_until(f"shows {role.replace('_', ' ').upper()}. ")
        if role == "toneburst":
            person.answer("perhaps")
            person.read_until("y, n, or one of master,")
            person.read_until("name of its role]: ")
        person.answer(answers.get(role, "y"))
    assert person.end() == 1
    assert "exchange these addresses" in person.text
    assert read_bench(bench).bench.serials["toneburst"] == "SIM_BOX_5"
    # Comments, layout and rights are as before.
    assert re.sub(r"^serial = .*\n", "", bench.read_text(encoding="utf-8"), flags=re.M) == before
    assert bench.stat().st_mode & 0o777 == 0o640
    result = CliRunner().invoke(app, ["bench", str(bench)])
    assert result.exit_code == 1
    assert "toneburst: serial number SIM_BOX_3, which is that of tracking_pulser" in result.output


@contextmanager
def emulated(text: str, **instruments: bool) -> Iterator[tuple[World, str]]:
    """Yield a world of generators on sockets, and a real bench's text with their addresses."""
    simulated = parse_bench("simulated", text).bench
    wiring = [(cable.source, cable.target, cable.delay_s) for cable in simulated.wiring]
    world = World(SimulationSettings.model_validate({"instruments": instruments}), wiring)
    with Emulator("socket", world.connect, GENERATOR_ROLES) as emulator:
        addresses = {role: (server.address, server.interface) for role, server in emulator.served.items()}
        real = addressed(parse_bench("simulated", text), "socket", addresses).replace('transport = "socket"\n', "")
        real = real.replace("simulated = true", "simulated = false").replace("Simulated bench", "Bench")
        yield world, real


def displays(world: World) -> list[str]:
    return [world._generators[role].registers.display_text for role in GENERATOR_ROLES]


@posix
def test_instruments_without_serial_numbers_get_labels_that_they_keep(
    bench: Path, start: Callable[[], Terminal]
) -> None:
    with emulated(read_bench().text, serial_numbers=False) as (world, real):
        bench.write_text(real, encoding="utf-8")
        person = start()
        for role in GENERATOR_ROLES:
            person.read_until(f"shows {role.replace('_', ' ').upper()}. ")
            assert displays(world) == [name.replace("_", " ").upper() for name in GENERATOR_ROLES]
            assert not any(world.outputs_on().values())
            person.answer("n" if role == "master" else "y")
        # There is no digitizer, and the master is not identified.
        assert person.end() == 1
        assert "not identified: master" in person.text
        assert displays(world) == [""] * 5
        serials = read_bench(bench, lenient=True).bench.serials
        assert sorted(serials) == sorted(set(GENERATOR_ROLES) - {"master"})
        assert {role: world._generators[role].states.name(("4",)).strip('"') for role in serials} == serials
        assert all(re.fullmatch("HPE_[0-9A-F]{6}", serial) for serial in serials.values())


@posix
@pytest.mark.parametrize("number", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.slow)])
def test_an_interrupt_clears_the_displays_and_leaves_the_file_as_it_was(
    bench: Path, start: Callable[[], Terminal], number: int
) -> None:
    with emulated(read_bench().text) as (world, real):
        bench.write_text(real, encoding="utf-8")
        person = start()
        person.read_until("shows MASTER. ")
        person.answer("y")
        person.read_until("shows BURST TRAIN. ")
        assert displays(world)[0] == "MASTER"
        person.process.send_signal(number)
        assert person.end() == 128 + number
        assert displays(world) == [""] * 5
        assert bench.read_text(encoding="utf-8") == real


def test_without_a_terminal_or_a_bench_file_it_is_refused(bench: Path) -> None:
    before = bench.read_bytes()
    for arguments, words in (
        ([str(bench)], "this is no terminal"),
        ([], "none is named"),
        ([str(bench), "--off"], "only switches"),
    ):
        result = CliRunner().invoke(app, ["bench", *arguments, "--identify"])
        assert result.exit_code == 2
        assert words in result.output
    assert bench.read_bytes() == before
