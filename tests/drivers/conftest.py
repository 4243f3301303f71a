"""Wires that play an instrument by a script, for what the twin does not do: misbehave."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

import pytest

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
        for part in message.split(";"):
            self._obey(part.lstrip(":"))

    def read(self) -> str:
        if not self.outbox:
            raise TimeoutError("nothing to read")
        return self.outbox.popleft()

    def close(self) -> None:
        self.closed = True

    def _obey(self, part: str) -> None:
        header, _, argument = part.partition(" ")
        if header == "SYST:ERR?":
            self.outbox.append(self.errors.popleft() if self.errors else '+0,"No error"')
        elif header == "*CLS":
            self.errors.clear()
        elif header == "*RST":
            self.held = {"OUTP": "0"}
        elif header.endswith("?"):
            name = header[:-1]
            reply = self.replies.get(name, self.held.get(name))
            if reply is not None:
                self.outbox.append(reply)
        else:
            self.held[header] = "+9.9000000000000E+37" if argument == "INF" else argument


@pytest.fixture
def scripted() -> Callable[..., ScriptedInstrument]:
    return ScriptedInstrument
