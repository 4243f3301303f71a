"""Inventory and switching off on the twin: settings, times, self-tests and problems of each instrument."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import Any

import pytest

from drivers.interfaces import InstrumentError
from hpe_rig.bench import BenchFile, inventory, read_bench, survey
from hpe_rig.bench.inventory import OffState, switch_off
from hpe_rig.bench.lock import locked, resources
from sim_backend.world import GeneratorConnection, World

BENCH = read_bench().bench
ROLES = (*BENCH.generators.by_role, "digitizer")
SERIALS = {role: f"SIM_BOX_{number}" for number, role in enumerate(BENCH.generators.by_role, 1)}


def with_serials(serials: Mapping[str, str]) -> BenchFile:
    roles = BENCH.generators.by_role
    items = {role: roles[role].model_copy(update={"serial": serial}) for role, serial in serials.items()}
    return BENCH.model_copy(update={"generators": BENCH.generators.model_copy(update=items)})


class Connected:
    """The twin's line to a generator; ``replies`` replaces replies by query.

    Keeps the messages that are sent while any output is on.
    """

    def __init__(self, world: World, role: str, line: GeneratorConnection, replies: Mapping[str, str]) -> None:
        self.world, self.role, self.line, self.replies = world, role, line, replies
        self.last, self.sent_with_outputs_on = "", list[str]()

    def write(self, message: str) -> None:
        self.last = message
        if any(self.world.outputs_on().values()):
            self.sent_with_outputs_on.append(message)
        self.line.write(message)

    def read(self) -> str:
        reply = self.line.read()
        return self.replies.get(self.last, reply)

    def close(self) -> None:
        self.line.close()


@pytest.fixture
def connect(monkeypatch: pytest.MonkeyPatch) -> Callable[..., list[Connected]]:
    """Return a function that sets the replies by role, and whose list gets the lines that are opened."""
    wire = World.connect

    def set_replies(commands: Mapping[str, str] = {}, **replies: Mapping[str, str]) -> list[Connected]:
        lines = list[Connected]()

        def connect_line(world: World, role: str) -> Any:
            line = wire(world, role)
            if role in commands:
                line.write(commands[role])
            lines.append(Connected(world, role, line, replies.get(role, {})))
            return lines[-1]

        monkeypatch.setattr(World, "connect", connect_line)
        return lines

    return set_replies


def test_every_instrument_is_reported_with_its_settings_and_the_median_of_five_round_trips(
    connect: Callable[..., list[Connected]],
) -> None:
    lines = connect({"toneburst": "OUTP 1"})
    # A clock whose first interval of each instrument is long: the median of 5 ignores it.
    ticks = count()

    def clock_s() -> float:
        tick = next(ticks)
        return tick + (100.0 if tick % 10 else 0.0)

    report = survey(BENCH, clock_s)
    assert (report.title, report.simulated, report.addresses) == (BENCH.title, True, ())
    assert [item.role for item in report.instruments] == list(ROLES)
    assert [item.latency_s for item in report.instruments] == [1.0] * 6
    assert [item.identity.serial for item in report.instruments if item.identity] == [*SERIALS.values(), "460001"]
    assert [item.self_test for item in report.instruments] == [None] * 6
    # Settings are those from before: the output of the toneburst was on.
    assert {role: settings.get("output_on", False) for role, settings in report.settings.items()} == {
        role: role == "toneburst" for role in ROLES
    }
    problems = {item.role: item.problems for item in report.instruments if item.problems}
    assert list(problems) == ["toneburst"]
    assert problems["toneburst"][0].startswith("its output was on; it is off now. Try: ")
    assert not report.complete
    assert not any(lines[0].world.outputs_on().values())


def test_self_tests_run_on_request_with_all_outputs_off_and_a_failed_one_is_a_problem(
    connect: Callable[..., list[Connected]],
) -> None:
    lines = connect(toneburst={"*TST?": "+1"}, master={"*TST?": "?"})
    report = survey(BENCH, self_test=True)
    tests = {item.role: item.self_test for item in report.instruments}
    assert tests == dict.fromkeys(ROLES, True) | {"toneburst": False, "master": False, "digitizer": None}
    problems = {item.role: item.problems for item in report.instruments if item.problems}
    assert list(problems) == ["master", "toneburst"]
    assert problems["toneburst"] == (
        "its self-test failed (*TST?). Try: power it off and on, test again, then have it repaired",
    )
    assert "self-test" in problems["master"][0]
    assert not any("*TST?" in line.sent_with_outputs_on for line in lines)
    assert survey(with_serials(SERIALS)).complete


def test_an_instrument_without_answer_is_reported_without_identity_and_the_others_as_usual(
    connect: Callable[..., list[Connected]],
) -> None:
    connect(toneburst={"*IDN?": "HAL,9000,1,1"})
    report = survey(BENCH, self_test=True)
    by_role = {item.role: item for item in report.instruments}
    missing = by_role["toneburst"]
    assert (missing.identity, missing.latency_s, dict(missing.settings), missing.self_test) == (None, None, {}, None)
    assert "expected model 33250A" in missing.problems[0]
    assert list(report.settings) == [role for role in ROLES if role != "toneburst"]
    assert all(not item.problems for role, item in by_role.items() if role != "toneburst")


def test_differences_of_a_board_from_the_bench_file_are_problems_with_the_line_to_write() -> None:
    board = BENCH.digitizer
    settings: dict[str, Any] = {
        "dual_port_memory": True,
        "memory_samples_per_channel": board.samples_per_channel,
        "firmware": "FPGA 19, driver 5.0.0, SDK 5.8.0",
    }

    def problems(**changes: Any) -> list[str]:
        limit = changes.pop("max_records", 1000)
        stated = board.model_copy(update={"max_records": limit})
        return list(inventory._digitizer_problems(stated, settings | changes))

    assert problems() == []
    assert problems(max_records=5000) == []
    assert problems(dual_port_memory=False) == [
        "the board reports dual_port_memory = False. Try: digitizer.dual_port_memory = false"
    ]
    assert problems(memory_samples_per_channel=4096) == [
        "the board reports memory_samples_per_channel = 4096. Try: digitizer.samples_per_channel = 4096"
    ]
    # What a board does not report cannot differ.
    assert problems(memory_samples_per_channel=None, dual_port_memory=None) == []
    old = {"firmware": "FPGA 18, driver 5.0.0, SDK 5.8.0"}
    assert problems(**old) == []
    assert problems(max_records=1001, **old) == [
        "FPGA version 18 holds 1000 single-port records. Try: digitizer.max_records = 1000"
    ]
    assert problems(max_records=1001, firmware="unknown") == []


def test_an_address_is_suggested_for_a_generator_that_does_not_answer() -> None:
    real = BENCH.model_copy(update={"simulated": False})
    report = inventory.InstrumentReport("master", "GPIB0::10::INSTR", problems=("no answer",))

    def suggested(*addresses: str, report: inventory.InstrumentReport = report, bench: BenchFile = real) -> Any:
        return inventory._with_suggestions(report, bench, addresses).problems

    assert suggested() == ("no answer",)
    near = "generators.master.address: did you mean GPIB0::11::INSTR?"
    assert suggested("GPIB0::11::INSTR") == ("no answer", near)
    assert suggested("USB0::0x1::0x2::M::RAW")[1] == (
        "generators.master.address: the addresses found are USB0::0x1::0x2::M::RAW"
    )
    assert suggested("GPIB0::10::INSTR")[1].startswith("an instrument answers at GPIB0::10::INSTR, but it is no")
    assert suggested("GPIB0::11::INSTR", bench=BENCH) == ("no answer",)
    board = replace(report, role="digitizer", address="system 1, board 1")
    assert suggested("GPIB0::11::INSTR", report=board) == ("no answer",)


def test_switching_off_proves_each_output_and_names_exchanges_and_failures(
    connect: Callable[..., list[Connected]],
) -> None:
    lines = connect(
        dict.fromkeys(SERIALS, "OUTP 1"),
        burst_train={"*IDN?": "HAL,9000,1,1"},
        master={"OUTP?;:SYST:ERR?": '1;+0,"No error"'},
    )
    announced = list[str]()
    swapped = {"toneburst": "SIM_BOX_5", "tracking_pulser": "SIM_BOX_3"}
    states = {state.role: state for state in switch_off(with_serials(swapped), announced.append)}
    assert list(states) == list(ROLES)
    assert [role for role, state in states.items() if not state.proven] == ["master", "burst_train"]
    assert "output_on" in states["master"].reason
    assert "HAL" in states["burst_train"].reason
    assert states["toneburst"] == OffState("toneburst", "in process", True, "read back as off")
    on = lines[0].world.outputs_on()
    # Nothing is sent to an instrument of another kind.
    assert [role for role, is_on in on.items() if is_on] == ["burst_train"]
    assert announced == []
    connect()
    assert all(state.proven for state in switch_off(with_serials(swapped), announced.append))
    remedy = "Try: toneburst and tracking_pulser are swapped: exchange their addresses in the bench file"
    assert [text.partition(":")[0] for text in announced] == ["toneburst", "tracking_pulser"]
    assert all(text.endswith(remedy) for text in announced)


def test_a_bench_in_use_is_switched_off_anyway_and_its_user_named(real_bench: Callable[..., Path]) -> None:
    bench, announced = read_bench(real_bench(address="TCPIP::127.0.0.1::{}::SOCKET")).bench, list[str]()
    name = resources(bench)[0]
    with locked([name]):
        states = switch_off(bench, announced.append)
    assert [text for text in announced if text.startswith(f"{name} is in use by process ")] == announced
    assert len(announced) == 1
    assert announced[0].endswith(": it is switched off anyway")
    assert not any(state.proven for state in states)


def test_errors_of_a_board_are_its_problem(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(world: World) -> Any:
        raise InstrumentError("digitizer", "no library", "it is absent", "install it")

    monkeypatch.setattr(World, "alazar_library", fail)
    (board,) = [item for item in survey(BENCH).instruments if item.problems]
    assert (board.role, board.address, board.identity) == ("digitizer", "system 1, board 1", None)
    assert board.problems == ("digitizer: no library. It is absent. Try: install it.",)
