"""Programs that nobody here wrote, on the simulated generators over every transport: PyMeasure and raw pyvisa."""

from __future__ import annotations

import runpy
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest
import pyvisa
from pyvisa.resources import MessageBasedResource

from sim_backend.generator.command_tree import tree_of
from sim_backend.generator.instrument import Generator33250A
from sim_backend.generator.models import MODELS
from sim_backend.transports.emulator import TRANSPORTS, Emulator
from sim_backend.wiring import SimulatedClock
from sim_backend.world import GeneratorConnection

ROOT = Path(__file__).parents[2]
EXAMPLES = runpy.run_path(str(ROOT / "tests" / "sim_backend" / "generator" / "command_examples.py"))["EXAMPLES"]
needs_pty = pytest.mark.skipif(sys.platform == "win32", reason="needs a pseudo terminal")


@pytest.mark.external
@pytest.mark.filterwarnings("default")
def test_pymeasure_gets_what_the_page_says_over_every_transport() -> None:
    page = runpy.run_path(str(ROOT / "docs" / "_build_tools" / "pymeasure_programs.py"))["page"]()
    assert page == (ROOT / "docs" / "reference" / "pymeasure.md").read_text(encoding="utf-8")
    rows = [row.split("|")[2:-1] for row in page.splitlines() if row.startswith(("| Keysight", "| Agilent"))]
    assert len(rows) == 16
    assert {row[-1].strip() for row in rows} == {"0"}
    assert [row[0].strip() for row in rows if row[-2].strip() != "0"] == ["serial, never put in remote"]


@contextmanager
def opened(transport: str, model: str) -> Iterator[MessageBasedResource]:
    """Yield a session of pyvisa alone to a fresh twin of ``model``."""
    clock = SimulatedClock()
    twin = Generator33250A(clock, 0.0, MODELS[model])
    manager = pyvisa.ResourceManager("@py")
    with ExitStack() as stack:
        emulator = stack.enter_context(
            Emulator(transport, lambda role, serial: GeneratorConnection(twin, clock, 0.0, serial), ("x",))
        )
        served = emulator.served["x"]
        if served.interface:
            stack.callback(manager.open_resource(served.interface).close)
        session = manager.open_resource(served.address, write_termination="\n")
        stack.callback(session.close)
        session.timeout = 5000
        if not served.interface:
            session.read_termination = "\n"
        yield session


def runs() -> Iterator[object]:
    """Yield transport and model; small messages wait for one another on a raw socket and at an adapter: slow."""
    for transport in TRANSPORTS:
        for model in MODELS:
            quick = model == "33250A" and transport not in ("socket", "prologix")
            marks = [*([] if quick else [pytest.mark.slow]), *([needs_pty] if transport == "serial" else [])]
            yield pytest.param(transport, model, marks=marks)


@pytest.mark.parametrize(("transport", "model"), list(runs()))
def test_raw_pyvisa_has_every_example_of_every_command_answered(transport: str, model: str) -> None:
    known = tree_of(MODELS[model])
    wrong = []
    with opened(transport, model) as session:
        for form, (message, query, reply, error) in EXAMPLES.items():
            # What survives a reset, and RS-232 commands over RS-232, have other replies than on a fresh instrument.
            if form not in known or form in ("*ESR", "*OPC", "*WAI", "*CLS", "SYSTem:LOCal") or error == 514:
                continue
            lines = [*(["SYST:REM"] if transport == "serial" else []), "*RST;*CLS", *message.splitlines()]
            for line in filter(None, lines):
                session.write(line)
            told = session.query(query).strip() if query else reply
            number = int(session.query("SYST:ERR?").split(",")[0])
            expected = told if form == "*IDN" or "*ESR?" in query else reply
            if (told, number) != (expected, 0 if query == "SYST:ERR?" else error):
                wrong.append((form, told, number))
            session.write("MEM:STAT:NAME 1,STATE_1;:SYST:BEEP:STAT 1")
    assert wrong == []
