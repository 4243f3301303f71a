"""A scripted instrument, for behaviour that the twin lacks, and the twin over every transport."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass

import pytest

from drivers.interfaces import Connection
from drivers.visa import PrologixAdapter, VisaConnection
from sim_backend.generator.instrument import Generator33250A
from sim_backend.transports.emulator import TRANSPORTS, Emulator
from sim_backend.wiring import SimulatedClock
from sim_backend.world import GeneratorConnection

IDENTITY = "Agilent Technologies,33250A,0,2.04-1.01-2.00-03-2"


class ScriptedInstrument:
    """Keeps each header's last argument and answers with it, except where the script says otherwise."""

    def __init__(self, replies: dict[str, str] | None = None, errors: list[str] | None = None) -> None:
        self.replies = {"*IDN": IDENTITY, **(replies or {})}
        self.errors = deque(errors or [])
        self.messages: list[str] = []
        self.held: dict[str, str] = {}
        self.outbox: deque[str] = deque()
        self.closed = False

    @property
    def commands(self) -> list[str]:
        """Every command and query so far, one by one, without the leading colon."""
        return [part.lstrip(":") for message in self.messages for part in message.split(";")]

    def write(self, message: str) -> None:
        self.messages.append(message)
        replies = [reply for part in message.split(";") if (reply := self._obey(part.lstrip(":"))) is not None]
        if replies:
            self.outbox.append(";".join(replies))

    def read(self) -> str:
        if not self.outbox:
            raise TimeoutError("nothing to read")
        return self.outbox.popleft()

    def close(self) -> None:
        self.closed = True

    def _obey(self, part: str) -> str | None:
        header, _, argument = part.partition(" ")
        if header == "SYST:ERR?":
            return self.errors.popleft() if self.errors else '+0,"No error"'
        if header.endswith("?"):
            return self.replies.get(header[:-1], self.held.get(header[:-1]))
        if header == "*CLS":
            self.errors.clear()
        elif header == "*RST":
            self.held = {"OUTP": "0"}
        else:
            self.held[header] = "+9.9000000000000E+37" if argument == "INF" else argument
        return None


@pytest.fixture
def scripted() -> Callable[..., ScriptedInstrument]:
    return ScriptedInstrument


IN_PROCESS = "in process"
REACHES = [IN_PROCESS, *TRANSPORTS]
# Long enough for a busy machine, short enough to wait for.
TIMEOUT_S = 0.4


@dataclass(frozen=True)
class Line:
    """A simulated instrument and a connection that reaches it."""

    transport: str
    instrument: Generator33250A
    connection: Connection


@contextmanager
def reaching(transport: str, instrument: Generator33250A) -> Iterator[Connection]:
    if transport == IN_PROCESS:
        yield instrument
        return

    def connect(role: str, over_serial: bool) -> GeneratorConnection:
        return GeneratorConnection(instrument, SimulatedClock(), 0.0, over_serial)

    with ExitStack() as stack:
        served = stack.enter_context(Emulator(transport, connect, ("instrument",))).served["instrument"]
        interface = PrologixAdapter(served.interface, TIMEOUT_S) if served.interface else None
        if interface:
            stack.callback(interface.close)
        connection = VisaConnection(served.address, TIMEOUT_S, "@py", interface)
        stack.callback(connection.close)
        yield connection


@pytest.fixture
def reach() -> Callable[[str, Generator33250A], AbstractContextManager[Connection]]:
    return reaching


@pytest.fixture(scope="module", params=REACHES)
def line(request: pytest.FixtureRequest) -> Iterator[Line]:
    """Yield one simulated 33250A for the whole module, over one transport after the other."""
    instrument = Generator33250A(SimulatedClock(), 100e-9)
    with reaching(request.param, instrument) as connection:
        yield Line(request.param, instrument, connection)
