"""SCPI session: joined commands, queries, the error queue and read-back, with one place where errors surface."""

from __future__ import annotations

import logging
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Final, final

from drivers.agilent.read_back import Register, argument
from drivers.interfaces import Connection, InstrumentError, RemoteConnection

_LOG: Final = logging.getLogger("drivers")
# A 33250A queues 20 errors; a few reads more, so that the final "no error" is seen as well.
QUEUE_READS: Final = 25
IDENTITY_QUERY: Final = "*IDN?"
ERROR_QUERY: Final = "SYST:ERR?"
# Keeps a message and its reply, of 21 characters a number, within the 256 that even the smallest RS-232 buffer takes.
MOST_QUERIES: Final = 10
STALE_READS: Final = 32
HIGHEST_TOKEN: Final = 255
# A 33250A is busy for up to 0.7 s with one setting; what is asked in haste is asked again before it counts as mute.
HASTE_S: Final = 0.4

CAUSES: Final[Mapping[int, str]] = {
    -113: "the instrument does not know a command: another model or firmware answered",
    -211: "the trigger was ignored: the source is not BUS or a burst is still running",
    -221: "two settings conflict, and the instrument changed one of them by itself",
    -222: "a value is beyond the instrument's limit, and was clipped to it",
    -350: "more errors came than the queue holds; the first ones are listed",
    -410: "a reply was not read before the next command: another program talks to the instrument",
    514: "the command works over RS-232 only",
    550: "the instrument is in local mode (RS-232 needs SYST:REM first)",
}
# An output that is not as it was switched is no matter of the scene.
RELAY: Final = (
    "the relay at the output is stuck, or it opened by itself against an overload or a voltage from outside",
    "take off what hangs on the output, then hpe-rig bench; a relay that stays stuck has to be repaired",
)


@dataclass(frozen=True, slots=True)
class QueuedError:
    """One entry of the instrument's error queue."""

    number: int
    text: str

    def __str__(self) -> str:
        return f"{self.number:+d} {self.text}"


@final
class RefusedError(InstrumentError):
    """The instrument queued ``errors`` or holds other settings than it was sent."""

    def __init__(self, role: str, what: str, why: str, remedy: str, errors: tuple[QueuedError, ...]) -> None:
        super().__init__(role, what, why, remedy)
        self.errors = errors


@final
class DroppedError(InstrumentError):
    """The connection is not there any more."""


@final
class ScpiSession:
    """Commands and answers over ``connection``; every failure is an ``InstrumentError`` that names ``role``.

    A reply that did not come in time may still come late. The session therefore is dirty from each query until a reply
    that fits it, and a dirty session first throws away what still arrives and proves that answers fit questions again.
    One thread at a time holds the session, from a setting to its read-back.
    """

    def __init__(self, connection: Connection, role: str) -> None:
        self.role = role
        self._connection = connection
        self._lock = threading.RLock()
        self._dirty = False
        self._token = 0

    @property
    def bus(self) -> str:
        """Name of the line that leads to the instrument; empty where it is in the same process."""
        return self._connection.bus if isinstance(self._connection, RemoteConnection) else ""

    @contextmanager
    def haste(self) -> Iterator[None]:
        """Wait no longer than ``HASTE_S`` for each reply in the block."""
        line = self._connection
        if not isinstance(line, RemoteConnection):
            yield
            return
        with self._lock:
            before, line.timeout_s = line.timeout_s, min(HASTE_S, line.timeout_s)
            try:
                yield
            finally:
                line.timeout_s = before

    def reopen(self) -> bool:
        """Open a dropped connection again; return whether that is possible and somebody is there."""
        if not isinstance(self._connection, RemoteConnection):
            return False
        try:
            self._connection.reopen()
        except OSError:
            return False
        # Behind an adapter the instrument may still hold the reply to what was asked last.
        self._dirty = True
        return True

    def write(self, *commands: str) -> None:
        """Send ``commands`` as one message; works on a dirty session too, so that an output can always be cut."""
        with self._lock:
            self._send(joined(commands))

    def query(self, command: str, patience: int = 1) -> str:
        """Return the reply to ``command``, never one that belongs to an earlier query.

        ``patience`` counts the time-outs after which no reply is awaited any longer.
        """
        with self._lock:
            if self._dirty:
                self._resynchronise()
            # An interrupt between here and the reply would leave that reply for the next query to find.
            self._dirty = True
            self._send(command)
            reply = self._receive(command, patience)
            self._dirty = False
            return reply

    def ask_who(self) -> str:
        """Return the reply to ``*IDN?``, asked again in haste before nobody is there; a stranger is sent nothing else.

        A reply is lost where another program sends something before it is read.
        """
        with self._lock:
            try:
                return self.query(IDENTITY_QUERY)
            except DroppedError:
                raise
            except InstrumentError as missing:
                with self.haste():
                    self._send(IDENTITY_QUERY)
                    try:
                        # Should the first reply be late, it says the same; the session stays dirty for the other one.
                        return self._receive(IDENTITY_QUERY)
                    except InstrumentError:
                        raise missing from None

    def query_all(self, commands: Sequence[str]) -> tuple[str, ...]:
        """Return the replies to ``commands``, asked in as few messages as the buffers allow; none may hold a ``;``."""
        with self._lock:
            chunks = (commands[start : start + MOST_QUERIES] for start in range(0, len(commands), MOST_QUERIES))
            return tuple(reply for chunk in chunks for reply in self._query_joined(chunk))

    def drain_errors(self) -> tuple[QueuedError, ...]:
        """Return the errors queued since the last drain, oldest first, and leave the queue empty."""
        with self._lock:
            return self._drain(self.query(ERROR_QUERY))

    def program(self, group: str, registers: Sequence[Register]) -> None:
        """Send ``registers`` as one message, then verify them."""
        with self._lock:
            self.write(*(register.command for register in registers))
            self.verify(group, registers)

    def verify(self, group: str, registers: Sequence[Register], others: Sequence[str] = ()) -> Mapping[str, str]:
        """Return the replies by header, of ``registers`` and then of ``others``, which were not programmed.

        Raises ``RefusedError`` for queued errors and for each register that reads back other than programmed.
        """
        headers = list(dict.fromkeys([*(register.header for register in registers), *others]))
        with self._lock:
            # The error queue comes last, so that it tells of the read-back as well.
            *read, entry = self.query_all([*(f"{header}?" for header in headers), ERROR_QUERY])
            errors = self._drain(entry)
        replies = dict(zip(headers, read, strict=True))
        told = [(register, replies[register.header]) for register in registers]
        changed = [(register, reply) for register, reply in told if not register.holds(reply)]
        if errors or changed:
            raise _refused(self.role, group, errors, changed)
        return replies

    def close(self) -> None:
        """Close the connection."""
        self._connection.close()

    def _query_joined(self, commands: Sequence[str]) -> list[str]:
        """Return the replies to ``commands``, asked in one message; only the last reply may hold a ``;``."""
        reply = self.query(joined(commands))
        replies = reply.split(";", len(commands) - 1)
        if len(replies) == len(commands):
            return replies
        errors = ", ".join(map(str, self.drain_errors())) or "nothing"
        # Whatever answered, what it says next need not be meant for what is asked next.
        self._dirty = True
        raise InstrumentError(
            self.role,
            f"{len(commands)} queries had {len(replies)} replies: {joined(commands)!r} was answered with {reply!r}",
            f"a query was not understood, a part was lost, or the reply is another's; the error queue holds {errors}",
            "compare the instrument's model with the bench file, end other programs that talk to it",
        )

    def _drain(self, entry: str) -> tuple[QueuedError, ...]:
        """Return ``entry`` and what is queued behind it."""
        found: list[QueuedError] = []
        while (error := self._queued(entry)).number != 0:
            found.append(error)
            if len(found) == QUEUE_READS:
                raise InstrumentError(
                    self.role,
                    f"the error queue is not empty after {QUEUE_READS} reads, the last one {found[-1]}",
                    "something keeps causing errors, or the replies are not those of SYST:ERR?",
                    "end other programs that talk to the instrument, power it off and on",
                )
            entry = self.query(ERROR_QUERY)
        return tuple(found)

    def _queued(self, entry: str) -> QueuedError:
        code, _, text = entry.partition(",")
        try:
            return QueuedError(int(code), text.strip().strip('"'))
        except ValueError:
            self._dirty = True
            raise InstrumentError(
                self.role,
                f"SYST:ERR? was answered with {entry!r}, not with a number and a text",
                "the address belongs to another kind of instrument, or two programs share the connection",
                "compare the address in the bench file with the instrument's, end the other program",
            ) from None

    def _send(self, message: str) -> None:
        _LOG.debug("%s <- %s", self.role, message)
        try:
            self._connection.write(message)
        except OSError as error:
            raise self._lost(f"could not send {message!r}", error) from error

    def _receive(self, command: str, patience: int = 1) -> str:
        try:
            reply = self._connection.read().strip()
            _LOG.debug("%s -> %s", self.role, reply)
            return reply
        except TimeoutError as error:
            if patience > 1:
                return self._receive(command, patience - 1)
            raise InstrumentError(
                self.role,
                f"no reply to {command!r}",
                "the instrument does not know the query, is busy, is off, or has another address",
                "check power, cable and address, and send *IDN? with another program",
            ) from error
        except OSError as error:
            raise self._lost(f"the connection broke while waiting for the reply to {command!r}", error) from error

    def _lost(self, what: str, error: OSError) -> DroppedError:
        remedy = "check power, cable and the address in the bench file, then open the bench again"
        return DroppedError(self.role, what, f"the connection is not there: {error}", remedy)

    def _resynchronise(self) -> None:
        """Discard late replies, then see two fresh numbers, one after the other, come back as answers.

        One number alone could be met by chance: a late reply may be an integer as well.
        """
        self._discard_late_replies()
        self._send("*CLS")
        for _ in range(2):
            self._token = self._token % HIGHEST_TOKEN + 1
            self._send(f"*ESE {self._token};*ESE?")
            if not any(self._receive("*ESE?").lstrip("+") == str(self._token) for _ in range(STALE_READS)):
                raise InstrumentError(
                    self.role,
                    f"replies do not fit questions after a reply was lost: *ESE {self._token} never read back",
                    "another program talks to the instrument, or its interface hangs",
                    "end the other program, power the instrument off and on",
                )
        self._send("*ESE 0")
        self._dirty = False

    def _discard_late_replies(self) -> None:
        for _ in range(STALE_READS):
            try:
                self._connection.read()
            except TimeoutError:
                return
            except OSError as error:
                raise self._lost("could not resume after a lost reply", error) from error


def joined(commands: Sequence[str]) -> str:
    """Return one message; each header after the first starts at the root, except the common commands."""
    rest = (";" + ("" if command.startswith("*") else ":") + command for command in commands[1:])
    return commands[0] + "".join(rest)


def _refused(
    role: str, group: str, errors: tuple[QueuedError, ...], changed: Sequence[tuple[Register, str]]
) -> RefusedError:
    differences = [f"{r.key} ({r.header}) programmed {argument(r.value)}, read back {reply}" for r, reply in changed]
    queue = ["error queue: " + ", ".join(map(str, errors))] if errors else []
    if {register.key for register, _ in changed} == {"output_on"}:
        return RefusedError(role, f"{group}: " + "; ".join(differences + queue), *RELAY, errors)
    causes = dict.fromkeys(CAUSES[error.number] for error in errors if error.number in CAUSES)
    why = "; ".join(causes) or "the instrument rounded or refused the value, or the front panel was used"
    keys = ", ".join(register.key for register, _ in changed) or group
    remedy = f"change {keys} in the scene or bench file to what the instrument can do"
    return RefusedError(role, f"{group}: " + "; ".join(differences + queue), why, remedy, errors)
