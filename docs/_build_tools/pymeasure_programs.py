"""Write docs/reference/pymeasure.md: PyMeasure's drivers on the simulated generators, over every transport.

Usage: python docs/_build_tools/pymeasure_programs.py

Needs PyMeasure, an independent package of drivers. After *RST each property is set to each of its values and read back,
and the error queue is read.
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
NOT_OFFERED = {"adapter", "read_termination", "arb_file", "arb_advance", "arb_filter", "arb_srate"}
"""Properties that are left out: those of the adapter, and of arbitrary waveforms, which the twin does not simulate."""


class PropertyValues(NamedTuple):
    """Values of a property, and the command that makes them valid."""

    values: tuple[Any, ...]
    before: str = ""


def values_of(*values: Any, before: str = "") -> PropertyValues:
    return PropertyValues(values, before)


ON_OFF = values_of(True, False)
COMMON: Mapping[str, PropertyValues] = {
    "frequency": values_of(1.0, 5e3, 2e7),
    "amplitude": values_of(0.05, 1.5, 10.0),
    "amplitude_unit": values_of("VRMS", "DBM", "VPP"),
    "offset": values_of(-1.5, 4.0),
    "voltage_high": values_of(0.25, 5.0),
    "voltage_low": values_of(-0.25, -5.0),
    "square_dutycycle": values_of(20.0, 80.0),
    "ramp_symmetry": values_of(0.0, 25.5, 100.0),
    "burst_mode": values_of("TRIG", "GAT"),
    "trigger_source": values_of("EXT", "BUS", "IMM"),
}
VALUES: Mapping[str, Mapping[str, PropertyValues]] = {
    "33250A": {
        **COMMON,
        "shape": values_of("SQU", "RAMP", "PULS", "NOIS", "DC", "USER", "SIN"),
        "frequency": values_of(1e-6, 5e3, 8e7),
        "pulse_period": values_of(2e-4, 2000.0),
        "pulse_width": values_of(8e-9, 5e-4),
        "pulse_transition": values_of(5e-9, 5e-5),
        "burst_ncycles": values_of(1, 1_000_000, "INF", before="TRIG:SOUR BUS"),
        "output_load": values_of(1.0, 75.0, 10_000.0, math.inf),
        "output_enabled": ON_OFF,
        "output_polarity": values_of("INV", "NORM"),
        "sync_output_enabled": values_of(False, True),
        "burst_enabled": ON_OFF,
        "burst_period": values_of(0.02, 500.0),
        "burst_phase": values_of(-360.0, 90.0),
        "trigger_delay": values_of(0.0, 85.0, before="TRIG:SOUR EXT"),
        "trigger_slope": values_of("NEG", "POS"),
        "trigger_output_enabled": ON_OFF,
        "trigger_output_slope": values_of("NEG", "POS"),
    },
    "33220A": {
        **COMMON,
        "shape": values_of("SQUARE", "RAMP", "PULSE", "NOISE", "DC", "USER", "SINUSOID"),
        "pulse_period": values_of(2e-4, 2000.0),
        "pulse_hold": values_of("DCYC", "WIDTH"),
        "pulse_width": values_of(5e-4, 1e-4),
        "pulse_dutycycle": values_of(25.0, 50.0),
        "pulse_transition": values_of(5e-9, 1e-7),
        "output": ON_OFF,
        "burst_state": ON_OFF,
        "burst_ncycles": values_of(1, 50_000, before="TRIG:SOUR BUS"),
        "trigger_state": ON_OFF,
        "beeper_state": values_of(False, True),
        "remote_local_state": values_of("RWL", "REM"),
    },
    "33500B": {
        **COMMON,
        "shape": values_of("SQU", "TRI", "RAMP", "PULS", "PRBS", "NOIS", "ARB", "DC", "SIN"),
        "phase": values_of(-360.0, 90.0),
        "square_dutycycle": values_of(0.01, 99.98),
        "pulse_period": values_of(2e-4, 1e5),
        "pulse_hold": values_of("DCYC", "WIDT"),
        "pulse_width": values_of(16e-9, 5e-4),
        "pulse_dutycycle": values_of(25.0, 50.0),
        "pulse_transition": values_of(8.4e-9, 1e-6),
        "output": ON_OFF,
        "output_load": values_of(75.0, "INF"),
        "burst_state": ON_OFF,
        "burst_period": values_of(0.02, 8000.0),
        "burst_ncycles": values_of(1, 99_999, before="TRIG:SOUR BUS"),
        "ext_trig_out": ON_OFF,
        "display": values_of("hello"),
    },
}


@dataclass
class Outcome:
    """Numbers of settings by result, for one driver over one transport."""

    confirmed: int = 0
    not_simulated: int = 0
    in_local: int = 0
    wrong: list[str] = field(default_factory=list)


def properties(driver: type) -> set[str]:
    """Return the properties of a driver that can be set."""
    names = {name for name in dir(driver) if isinstance(getattr(driver, name), property) and not name.startswith("_")}
    return {name for name in names if getattr(driver, name).fset} - READ_ONLY - NOT_OFFERED


class ErrorNumbers(logging.Handler):
    """Collects the numbers of errors that a driver reads from the queue: it logs them and raises no exception."""

    def __init__(self) -> None:
        super().__init__()
        self.numbers: list[int] = []

    def emit(self, record: logging.LogRecord) -> None:
        match = re.search(r": ([+-]?[0-9]+)(?:\.0)?, ", record.getMessage())
        self.numbers += [int(match[1])] if match else []


LOGGED_ERRORS = ErrorNumbers()


def drivers() -> dict[str, type]:
    """Return PyMeasure's driver of each model."""
    from pymeasure.instruments.agilent import Agilent33220A, Agilent33500
    from pymeasure.instruments.keysight import Keysight33250A

    return {"33250A": Keysight33250A, "33220A": Agilent33220A, "33500B": Agilent33500}


@contextmanager
def connect(model: str, transport: str) -> Iterator[Any]:
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
    """Return and clear the error numbers of the queue and of the driver's log."""
    numbers, LOGGED_ERRORS.numbers = LOGGED_ERRORS.numbers, []
    while (number := int(instrument.ask("SYST:ERR?").split(",")[0])) != 0:
        numbers.append(number)
    return numbers


def are_equal(value: Any, reply: Any) -> bool:
    """Return whether the reply confirms the value: numbers to six digits, words in their short form."""
    if isinstance(value, str) and isinstance(reply, str):
        short = reply.strip().strip('"').upper()
        return value.upper().startswith(short) or value == short
    if isinstance(value, str) or isinstance(reply, str):
        return math.isinf(float(value)) and float(reply) > 9e37
    return math.isclose(float(value), float(reply), rel_tol=1e-5, abs_tol=1e-12)


def exercise(target: Any, instrument: Any, name: str, value: Any, outcome: Outcome) -> None:
    """Set a property of the instrument or channel ``target``, read it and the error queue, and count the result."""
    where = f"{name} = {value}"
    try:
        setattr(target, name, value)
        readable = getattr(type(target), name).fget is not None and name not in ("display", "remote_local_state")
        read = getattr(target, name) if readable else value
    except Exception as error:
        outcome.wrong.append(f"{where}: {error}")
        instrument.clear()
        return
    queued = errors(instrument)
    if NOT_SIMULATED in queued:
        outcome.not_simulated += 1
    elif queued and set(queued) == {IN_LOCAL}:
        outcome.in_local += 1
    elif queued or not are_equal(value, read):
        outcome.wrong.append(f"{where}: read {read}, errors {queued}")
    else:
        outcome.confirmed += 1


def run(model: str, transport: str, remote: bool = True) -> Outcome:
    """Set every property of a driver; on RS-232 ``remote`` sends `SYST:REM` first."""
    outcome = Outcome()
    with connect(model, transport) as instrument:
        targets = [(instrument, properties(type(instrument)))]
        if model == "33500B":
            targets += [(channel, properties(type(channel))) for channel in (instrument.ch_1, instrument.ch_2)]
        for target, names in targets:
            for name in sorted(names):
                for value in VALUES[model][name].values:
                    if transport == "serial" and remote:
                        instrument.write("SYST:REM")
                    instrument.write("*RST;*CLS")
                    if VALUES[model][name].before:
                        before = VALUES[model][name].before
                        instrument.write(before if target is instrument else before.replace("TRIG", f"TRIG{target.id}"))
                    # An instrument in local mode has refused even these commands.
                    errors(instrument)
                    exercise(target, instrument, name, value, outcome)
    return outcome


HEAD = """\
# PyMeasure on the twin

The drivers `Keysight33250A`, `Agilent33220A` and `Agilent33500` of PyMeasure, an independent package, are tested on the
simulated generators. After `*RST` each property is set to every value of a list and read back, and the
error queue is read. Both channels of the 33500 are tested, without the properties of its arbitrary waveforms.

`python docs/_build_tools/pymeasure_programs.py` writes this page; a test with the marker `external` compares it.

* *Confirmed*: read back as set, no error.
* *Not simulated*: arbitrary waveforms and bit sequences, refused with -241.
* *In local*: refused with 550. PyMeasure sends no `SYST:REM` over RS-232, and an instrument in local mode refuses
  settings.

| driver | transport | settings | confirmed | not simulated | in local | wrong |
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
    logging.getLogger("pymeasure").addHandler(LOGGED_ERRORS)
    lines = []
    for driver, over, outcome in rows():
        counts = outcome.confirmed, outcome.not_simulated, outcome.in_local, len(outcome.wrong)
        lines.append(f"| {' | '.join(map(str, (driver, over, sum(counts), *counts)))} |")
        for wrong in outcome.wrong:
            print(driver, over, wrong)
    return HEAD + "\n".join(lines) + "\n"


if __name__ == "__main__":
    argparse.ArgumentParser(description=__doc__).parse_args()
    PAGE.write_text(page(), encoding="utf-8")
    print(f"{PAGE.relative_to(ROOT)} written")
