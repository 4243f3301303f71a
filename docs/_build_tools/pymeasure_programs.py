"""Write docs/reference/pymeasure.md: PyMeasure's drivers on the simulated generators, over every transport.

Usage: python docs/_build_tools/pymeasure_programs.py

Needs PyMeasure, an independent package of drivers. Each property is set to each of its values from the state after
*RST and read back, and the error queue is read.
"""

import argparse
import logging
import math
import re
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import pyvisa

from sim_backend.generator import MODELS, Generator33250A
from sim_backend.transports import Emulator
from sim_backend.wiring import SimulatedClock
from sim_backend.world import GeneratorConnection

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "reference" / "pymeasure.md"
TRANSPORTS = ("socket", "serial", "hislip", "vxi11", "prologix")
IN_LOCAL, NOT_SIMULATED = 550, -241
READ_ONLY = {"complete", "id", "status", "options", "next_error"}
NOT_OFFERED = {"adapter", "read_termination"}


class Tried(NamedTuple):
    """Values of a property, and what has to be sent before them so that they are possible."""

    values: tuple[Any, ...]
    before: str = ""


def tried(*values: Any, before: str = "") -> Tried:
    return Tried(values, before)


ON_OFF = tried(True, False)
COMMON: Mapping[str, Tried] = {
    "frequency": tried(1.0, 5e3, 2e7),
    "amplitude": tried(0.05, 1.5, 10.0),
    "amplitude_unit": tried("VRMS", "DBM", "VPP"),
    "offset": tried(-1.5, 4.0),
    "voltage_high": tried(0.25, 5.0),
    "voltage_low": tried(-0.25, -5.0),
    "square_dutycycle": tried(20.0, 80.0),
    "ramp_symmetry": tried(0.0, 25.5, 100.0),
    "burst_mode": tried("TRIG", "GAT"),
    "trigger_source": tried("EXT", "BUS", "IMM"),
}
VALUES: Mapping[str, Mapping[str, Tried]] = {
    "33250A": {
        **COMMON,
        "shape": tried("SQU", "RAMP", "PULS", "NOIS", "DC", "USER", "SIN"),
        "frequency": tried(1e-6, 5e3, 8e7),
        "pulse_period": tried(2e-4, 2000.0),
        "pulse_width": tried(8e-9, 5e-4),
        "pulse_transition": tried(5e-9, 5e-5),
        "burst_ncycles": tried(1, 1_000_000, "INF", before="TRIG:SOUR BUS"),
        "output_load": tried(1.0, 75.0, 10_000.0, math.inf),
        "output_enabled": ON_OFF,
        "output_polarity": tried("INV", "NORM"),
        "sync_output_enabled": tried(False, True),
        "burst_enabled": ON_OFF,
        "burst_period": tried(0.02, 500.0),
        "burst_phase": tried(-360.0, 90.0),
        "trigger_delay": tried(0.0, 85.0, before="TRIG:SOUR EXT"),
        "trigger_slope": tried("NEG", "POS"),
        "trigger_output_enabled": ON_OFF,
        "trigger_output_slope": tried("NEG", "POS"),
    },
    "33220A": {
        **COMMON,
        "shape": tried("SQUARE", "RAMP", "PULSE", "NOISE", "DC", "USER", "SINUSOID"),
        "pulse_period": tried(2e-4, 2000.0),
        "pulse_hold": tried("DCYC", "WIDTH"),
        "pulse_width": tried(5e-4, 1e-4),
        "pulse_dutycycle": tried(25.0, 50.0),
        "pulse_transition": tried(5e-9, 1e-7),
        "output": ON_OFF,
        "burst_state": ON_OFF,
        "burst_ncycles": tried(1, 50_000, before="TRIG:SOUR BUS"),
        "trigger_state": ON_OFF,
        "beeper_state": tried(False, True),
        "remote_local_state": tried("RWL", "REM"),
    },
    "33500B": {
        **COMMON,
        "shape": tried("SQU", "TRI", "RAMP", "PULS", "PRBS", "NOIS", "ARB", "DC", "SIN"),
        "phase": tried(-360.0, 90.0),
        "square_dutycycle": tried(0.01, 99.98),
        "pulse_period": tried(2e-4, 1e5),
        "pulse_hold": tried("DCYC", "WIDT"),
        "pulse_width": tried(16e-9, 5e-4),
        "pulse_dutycycle": tried(25.0, 50.0),
        "pulse_transition": tried(8.4e-9, 1e-6),
        "output": ON_OFF,
        "output_load": tried(75.0, "INF"),
        "burst_state": ON_OFF,
        "burst_period": tried(0.02, 8000.0),
        "burst_ncycles": tried(1, 99_999, before="TRIG:SOUR BUS"),
        "arb_file": tried("SINC"),
        "arb_advance": tried("TRIG", "SRAT"),
        "arb_filter": tried("STEP", "OFF", "NORM"),
        "arb_srate": tried(1e6, 2.5e8),
        "ext_trig_out": ON_OFF,
        "display": tried("hello"),
    },
}


@dataclass
class Outcome:
    """What became of the properties of one driver over one transport."""

    kept: int = 0
    not_simulated: int = 0
    in_local: int = 0
    wrong: list[str] = field(default_factory=list)


def properties(driver: type) -> set[str]:
    """Return the properties of a driver that can be set."""
    found = {name for name in dir(driver) if isinstance(getattr(driver, name), property) and not name.startswith("_")}
    return {name for name in found if getattr(driver, name).fset} - READ_ONLY - NOT_OFFERED


class Logged(logging.Handler):
    """The numbers of errors that a driver reads from the queue itself: it raises nothing, it logs them."""

    def __init__(self) -> None:
        super().__init__()
        self.numbers: list[int] = []

    def emit(self, record: logging.LogRecord) -> None:
        found = re.search(r": ([+-]?[0-9]+)(?:\.0)?, ", record.getMessage())
        self.numbers += [int(found[1])] if found else []


LOGGED = Logged()


def drivers() -> dict[str, type]:
    """Return PyMeasure's driver of each model."""
    from pymeasure.instruments.agilent import Agilent33220A, Agilent33500
    from pymeasure.instruments.keysight import Keysight33250A

    return {"33250A": Keysight33250A, "33220A": Agilent33220A, "33500B": Agilent33500}


@contextmanager
def opened(model: str, transport: str) -> Iterator[Any]:
    """Yield PyMeasure's driver of ``model``, connected to a fresh twin of it over ``transport``."""
    from pymeasure.adapters import VISAAdapter

    clock = SimulatedClock()
    twin = Generator33250A(clock, 0.0, MODELS[model])
    with ExitStack() as stack:
        emulator = stack.enter_context(
            Emulator(transport, lambda role, serial: GeneratorConnection(twin, clock, 0.0, serial), ("x",))
        )
        served = emulator.served["x"]
        if served.interface:
            interface = pyvisa.ResourceManager("@py").open_resource(served.interface)
            stack.callback(interface.close)
        # A Prologix session takes no read terminator.
        ends = {"write_termination": "\n", **({} if served.interface else {"read_termination": "\n"})}
        adapter = VISAAdapter(served.address, visa_library="@py", timeout=2000, **ends)
        stack.callback(adapter.close)
        yield drivers()[model](adapter)


def errors(instrument: Any) -> list[int]:
    """Return and clear the numbers in the error queue, and those that the driver has read from it."""
    numbers, LOGGED.numbers = LOGGED.numbers, []
    while (number := int(instrument.ask("SYST:ERR?").split(",")[0])) != 0:
        numbers.append(number)
    return numbers


def same(one: Any, other: Any) -> bool:
    """Return whether what was read is what was set: numbers to six digits, words in their short form."""
    if isinstance(one, str) and isinstance(other, str):
        short = other.strip().strip('"').upper()
        return one.upper().startswith(short) or one == short
    if isinstance(one, str) or isinstance(other, str):
        return math.isinf(float(one)) and float(other) > 9e37
    return math.isclose(float(one), float(other), rel_tol=1e-5, abs_tol=1e-12)


def exercise(part: Any, instrument: Any, name: str, value: Any, outcome: Outcome) -> None:
    """Set a property, read it back, ask the error queue, and count what happened."""
    where = f"{name} = {value}"
    try:
        setattr(part, name, value)
        readable = getattr(type(part), name).fget is not None and name not in ("display", "remote_local_state")
        read = getattr(part, name) if readable else value
    except Exception as error:
        outcome.wrong.append(f"{where}: {error}")
        instrument.clear()
        return
    queued = errors(instrument)
    if NOT_SIMULATED in queued:
        outcome.not_simulated += 1
    elif queued and set(queued) == {IN_LOCAL}:
        outcome.in_local += 1
    elif queued or not same(value, read):
        outcome.wrong.append(f"{where}: read {read}, errors {queued}")
    else:
        outcome.kept += 1


def run(model: str, transport: str, remote: bool = True) -> Outcome:
    """Return what becomes of every property; on RS-232 the instrument is put in remote first, or never."""
    outcome = Outcome()
    with opened(model, transport) as instrument:
        parts = [(instrument, properties(type(instrument)))]
        if model == "33500B":
            parts += [(channel, properties(type(channel))) for channel in (instrument.ch_1, instrument.ch_2)]
        for part, names in parts:
            for name in sorted(names):
                for value in VALUES[model][name].values:
                    if transport == "serial" and remote:
                        instrument.write("SYST:REM")
                    instrument.write("*RST;*CLS")
                    if VALUES[model][name].before:
                        before = VALUES[model][name].before
                        instrument.write(before if part is instrument else before.replace("TRIG", f"TRIG{part.id}"))
                    # Never put in remote, even these were refused.
                    errors(instrument)
                    exercise(part, instrument, name, value, outcome)
    return outcome


HEAD = """\
# PyMeasure on the twin

The drivers `Keysight33250A`, `Agilent33220A` and `Agilent33500` of PyMeasure, an independent package, on the
simulated generators. Each property is set to every value of a list from the state after `*RST` and read back, and the
error queue is read; both channels of the 33500 are tested. `python docs/_build_tools/pymeasure_programs.py` writes this
page; a test with the marker `external` runs the same and compares.

*Kept*: read back as set, no error. *Not simulated*: arbitrary waveforms and bit sequences, refused with -241. *In
local*: refused with 550, since PyMeasure sends no `SYST:REM` over RS-232, as an instrument in local mode refuses it.

| driver | transport | settings | kept | not simulated | in local | wrong |
|---|---|---|---|---|---|---|
"""


def rows() -> Iterator[tuple[str, str, Outcome]]:
    """Yield driver, transport and outcome of every row of the page."""
    for model, driver in drivers().items():
        for transport in TRANSPORTS:
            over = f"{transport}, in remote" if transport == "serial" else transport
            yield driver.__name__, over, run(model, transport)
    yield drivers()["33250A"].__name__, "serial, never put in remote", run("33250A", "serial", remote=False)


def page() -> str:
    """Return the whole page."""
    logging.getLogger("pymeasure").addHandler(LOGGED)
    lines = []
    for driver, over, outcome in rows():
        counts = outcome.kept, outcome.not_simulated, outcome.in_local, len(outcome.wrong)
        lines.append(f"| {' | '.join(map(str, (driver, over, sum(counts), *counts)))} |")
        for wrong in outcome.wrong:
            print(driver, over, wrong)
    return HEAD + "\n".join(lines) + "\n"


if __name__ == "__main__":
    argparse.ArgumentParser(description=__doc__).parse_args()
    PAGE.write_text(page(), encoding="utf-8")
    print(f"{PAGE.relative_to(ROOT)} written")
