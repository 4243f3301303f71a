"""RS-232: settings of a line, and pacing to the input buffer of the instrument.

pyserial has no DTR/DSR handshake on Linux and macOS, so that an instrument that is busy cannot stop the computer there.
The line is therefore paced by queries: their replies prove that the bytes before them have been read.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Final, Literal, final

from drivers.visa.sockets import TextLine

Handshake = Literal["none", "xon_xoff", "rts_cts", "dtr_dsr"]
Termination = Literal["lf", "cr_lf", "cr"]
LINE_ENDS: Final[dict[Termination, str]] = {"lf": "\n", "cr_lf": "\r\n", "cr": "\r"}

INPUT_BUFFER_BYTES: Final = 256
"""The smallest input buffer of the supported instruments, that of the 33250A (assumed, from its input overflow 521)."""
PROBE: Final = b"*ESE?"
"""Query without side effects. ``*OPC?`` would wait for the end of a burst."""
PROBE_ATTEMPTS: Final = 2
"""Time-outs that a probe waits: a 33250A is busy with a message of several pulse settings for longer than one."""
COMMAND_END: Final = re.compile(rb";(?=[:*])")


@dataclass(frozen=True, slots=True)
class SerialSettings:
    """Settings of an RS-232 line with 8 data bits, no parity and 1 stop bit; default: those of a new 33250A."""

    baud: int = 57600
    handshake: Handshake = "dtr_dsr"
    termination: Termination = "lf"

    @property
    def line_end(self) -> str:
        """The end of commands and replies."""
        return LINE_ENDS[self.termination]


FACTORY_SETTINGS: Final = SerialSettings()


@final
class PacedLine:
    """An RS-232 ``line`` on which at most ``INPUT_BUFFER_BYTES`` wait to be read by the instrument.

    A longer message is sent command by command, unless it contains a query or a single command is too long.
    """

    is_rs232 = True

    def __init__(self, line: TextLine, line_end: str = "\n") -> None:
        self._line = line
        self._line_end = line_end.encode()
        self._probe = PROBE + self._line_end
        self._unread_bytes = 0
        self._missing_replies = 0

    @property
    def timeout_s(self) -> float:
        """The time that ``read`` waits for a reply."""
        return self._line.timeout_s

    @timeout_s.setter
    def timeout_s(self, timeout_s: float) -> None:
        self._line.timeout_s = timeout_s

    def write(self, message: bytes) -> None:
        """Send ``message``; raise ``ConnectionError`` if the instrument does not read the bytes before it."""
        for command in self._messages(message):
            if self._unread_bytes + len(command) > self._limit_bytes:
                self._wait_until_read()
            self._line.write(command)
            self._unread_bytes += len(command)

    def read(self) -> bytes:
        """Return one reply; raise ``TimeoutError`` if there is none."""
        try:
            # An interrupt can leave a probe without its reply, which comes first.
            while self._missing_replies:
                self._line.read()
                self._missing_replies -= 1
            reply = self._line.read()
        except TimeoutError:
            self._missing_replies = 0
            raise
        self._unread_bytes = 0
        return reply

    def discard_replies(self) -> None:
        """Drop what has arrived and was not read."""
        self._line.discard_replies()

    def close(self) -> None:
        """Close the line."""
        self._line.close()

    @property
    def _limit_bytes(self) -> int:
        return INPUT_BUFFER_BYTES - len(self._probe)

    def _messages(self, message: bytes) -> list[bytes]:
        """Return ``message``, or its commands as separate messages if they do not fit into the buffer together."""
        if len(message) <= self._limit_bytes or b"?" in message:
            return [message]
        commands = COMMAND_END.split(message.removesuffix(self._line_end))
        return [command + self._line_end for command in commands]

    def _wait_until_read(self) -> None:
        """Return when the instrument has read every byte."""
        self._missing_replies += 1
        self._line.write(self._probe)
        if any(self._has_reply() for _ in range(PROBE_ATTEMPTS)):
            self._missing_replies -= 1
            self._unread_bytes = 0
            return
        waited_s = PROBE_ATTEMPTS * self.timeout_s
        raise ConnectionError(f"the instrument has not read {self._unread_bytes} bytes within {waited_s:g} s")

    def _has_reply(self) -> bool:
        try:
            self._line.read()
        except TimeoutError:
            return False
        return True
