"""SCPI session: joined commands, queries, the error queue and read-back; all errors are raised here."""

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
# A 33250A queues 20 errors; a few more reads reach the final "no error".
QUEUE_READS: Final = 25
IDENTITY_QUERY: Final = "*IDN?"
ERROR_QUERY: Final = "SYST:ERR?"
# A message and its reply of 21 characters a number fit into 256 characters, the smallest RS-232 buffer.
MAX_QUERIES: Final = 10
STALE_READS: Final = 32
MAX_TOKEN: Final = 255
# A 33250A is busy with a setting for up to 0.7 s, so a query with this time-out is repeated before it fails.
SHORT_TIMEOUT_S: Final = 0.4

CAUSES: Final[Mapping[int, str]] = {
    -113: "the instrument does not know a command: another model or firmware answered",
    -211: "the trigger was ignored: the source is not BUS or a burst is still running",
    -221: "two settings conflict, and the instrument changed one of them",
    -222: "a value is beyond the instrument's limit, and was clipped to it",
    -350: "more errors came than the queue holds; the first ones are listed",
    -410: "a reply was not read before the next command: another program talks to the instrument",
    514: "the command works over RS-232 only",
    550: "the instrument is in local mode (RS-232 needs SYST:REM first)",
}
# Cause and remedy for an output that is not in the switched state.
RELAY: Final = (
    "the relay at the output is stuck, or it opened because of an overload or an external voltage",
    "disconnect the output, then run hpe-rig bench; a relay that stays stuck must be repaired",
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
    """The instrument queued ``errors``, or a setting differs from the programmed value."""

    def __init__(self, role: str, what: str, why: str, remedy: str, errors: tuple[QueuedError, ...]) -> None:
        super().__init__(role, what, why, remedy)
        self.errors = errors


@final
class DroppedError(InstrumentError):
    """The connection is lost."""


@final
class NoReplyError(InstrumentError):
    """No reply to a query came in time."""


@final
class ScpiSession:
    """Commands and replies over ``connection``; every failure is an ``InstrumentError`` that names ``role``.

    A reply may arrive after its time-out. The session is therefore dirty from each query to its reply. A dirty session
    first discards late replies, then proves by two test queries that replies fit. One thread at a time uses the
    session, from a setting to its read-back.
    """

    def __init__(self, connection: Connection, role: str) -> None:
        self.role = role
        self._connection = connection
        self._lock = threading.RLock()
        self._dirty = False
        self._token = 0

    @property
    def bus(self) -> str:
        """Name of the bus; empty for an instrument in the same process."""
        return self._connection.bus if isinstance(self._connection, RemoteConnection) else ""

    @contextmanager
    def short_timeout(self) -> Iterator[None]:
        """Limit the wait for each reply in the block to ``SHORT_TIMEOUT_S``."""
        connection = self._connection
        if not isinstance(connection, RemoteConnection):
            yield
            return
        with self._lock:
            timeout_s = connection.timeout_s
            connection.timeout_s = min(SHORT_TIMEOUT_S, timeout_s)
            try:
                yield
            finally:
                connection.timeout_s = timeout_s

    def reopen(self) -> bool:
        """Open a lost connection again; return whether that succeeded."""
        if not isinstance(self._connection, RemoteConnection):
            return False
        try:
            self._connection.reopen()
        except OSError:
            return False
        # Behind an adapter the instrument may still hold the reply to the last query.
        self._dirty = True
        return True

    def write(self, *commands: str) -> None:
        """Send ``commands`` as one message, on a dirty session too, so that an output can always be switched off."""
        with self._lock:
            self._send(joined(commands))

    def query(self, command: str, timeouts: int = 1) -> str:
        """Return the reply to ``command``, never that of an earlier query; wait for ``timeouts`` time-outs."""
        with self._lock:
            if self._dirty:
                self._resynchronise()
            return self._ask(command, timeouts)

    def identify(self) -> str:
        """Return the reply to ``*IDN?``, asked twice before it counts as missing; nothing else is sent.

        A reply is lost if another program sends a message before it is read. On a dirty session late replies are
        discarded before.
        """
        with self._lock:
            if self._dirty:
                self._discard_late_replies()
            try:
                return self._ask(IDENTITY_QUERY)
            except DroppedError:
                raise
            except InstrumentError as error:
                with self.short_timeout():
                    self._send(IDENTITY_QUERY)
                    try:
                        # A late first reply has the same text; the session stays dirty for the second one.
                        return self._receive(IDENTITY_QUERY)
                    except InstrumentError:
                        raise error from None

    def query_all(self, commands: Sequence[str]) -> tuple[str, ...]:
        """Return the replies to ``commands``, in as few messages as the buffers allow; no reply may contain ``;``."""
        with self._lock:
            chunks = (commands[start : start + MAX_QUERIES] for start in range(0, len(commands), MAX_QUERIES))
            return tuple(reply for chunk in chunks for reply in self._query_joined(chunk))

    def drain_errors(self) -> tuple[QueuedError, ...]:
        """Empty the error queue and return its errors, oldest first."""
        with self._lock:
            return self._drain(self.query(ERROR_QUERY))

    def program(self, group: str, registers: Sequence[Register]) -> None:
        """Send ``registers`` as one message, then verify them."""
        with self._lock:
            self.write(*(register.command for register in registers))
            self.verify(group, registers)

    def verify(self, group: str, registers: Sequence[Register], more_headers: Sequence[str] = ()) -> Mapping[str, str]:
        """Return the replies by header, of ``registers`` and of ``more_headers``, which are not compared.

        Raises ``RefusedError`` for queued errors and for registers that differ from their programmed value.
        """
        replies, errors = self.read_back([*(register.header for register in registers), *more_headers])
        pairs = [(register, replies[register.header]) for register in registers]
        changed = [(register, reply) for register, reply in pairs if not register.matches(reply)]
        if errors or changed:
            raise _refused(self.role, group, errors, changed)
        return replies

    def read_back(self, headers: Sequence[str]) -> tuple[Mapping[str, str], tuple[QueuedError, ...]]:
        """Return the replies by header, and the errors of the queue, which is empty afterwards."""
        names = list(dict.fromkeys(headers))
        with self._lock:
            # The error queue comes last, so that it includes errors of the read-back.
            *values, entry = self.query_all([*(f"{header}?" for header in names), ERROR_QUERY])
            errors = self._drain(entry)
        return dict(zip(names, values, strict=True)), errors

    def close(self) -> None:
        """Close the connection."""
        self._connection.close()

    def _query_joined(self, commands: Sequence[str]) -> list[str]:
        """Return the replies to ``commands`` in one message; only the last reply may contain ``;``."""
        reply = self.query(joined(commands))
        replies = reply.split(";", len(commands) - 1)
        if len(replies) == len(commands):
            return replies
        errors = ", ".join(map(str, self.drain_errors())) or "nothing"
        # The next reply may belong to another query.
        self._dirty = True
        raise InstrumentError(
            self.role,
            f"{len(commands)} queries had {len(replies)} replies: {joined(commands)!r} was answered with {reply!r}",
            f"a query was not understood, a part was lost, or the reply is another's; the error queue holds {errors}",
            "compare the instrument's model with the bench file, end other programs that talk to it",
        )

    def _drain(self, entry: str) -> tuple[QueuedError, ...]:
        """Return the error of ``entry`` and all that follow in the queue."""
        errors: list[QueuedError] = []
        while (error := self._queued(entry)).number != 0:
            errors.append(error)
            if len(errors) == QUEUE_READS:
                raise InstrumentError(
                    self.role,
                    f"the error queue is not empty after {QUEUE_READS} reads, the last one {errors[-1]}",
                    "a source of errors persists, or the replies are not those of SYST:ERR?",
                    "end other programs that talk to the instrument, power it off and on",
                )
            entry = self.query(ERROR_QUERY)
        return tuple(errors)

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

    def _ask(self, command: str, timeouts: int = 1) -> str:
        # An interrupt before the reply would leave it to the next query.
        self._dirty = True
        self._send(command)
        reply = self._receive(command, timeouts)
        self._dirty = False
        return reply

    def _send(self, message: str) -> None:
        _LOG.debug("%s <- %s", self.role, message)
        try:
            self._connection.write(message)
        except OSError as error:
            raise self._lost(f"could not send {message!r}", error) from error

    def _receive(self, command: str, timeouts: int = 1) -> str:
        try:
            reply = self._connection.read().strip()
            _LOG.debug("%s -> %s", self.role, reply)
            return reply
        except TimeoutError as error:
            if timeouts > 1:
                return self._receive(command, timeouts - 1)
            raise NoReplyError(
                self.role,
                f"no reply to {command!r}",
                "the instrument does not know the query, is busy, is off, or has another address",
                "check power, cable and address, and send *IDN? with another program",
            ) from error
        except OSError as error:
            raise self._lost(f"the connection broke while waiting for the reply to {command!r}", error) from error

    def _lost(self, what: str, error: OSError) -> DroppedError:
        remedy = "check power, cable and the address in the bench file, then open the bench again"
        return DroppedError(self.role, what, f"the connection is lost: {error}", remedy)

    def _resynchronise(self) -> None:
        """Discard late replies, then verify that two test numbers, one after the other, come back.

        A single number could equal a late reply by chance.
        """
        self._discard_late_replies()
        self._send("*CLS")
        for _ in range(2):
            self._token = self._token % MAX_TOKEN + 1
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
        # A reply that is later than this short silence is recognised by the test numbers.
        with self.short_timeout():
            for _ in range(STALE_READS):
                try:
                    self._connection.read()
                except TimeoutError:
                    return
                except OSError as error:
                    raise self._lost("could not resume after a lost reply", error) from error


def joined(commands: Sequence[str]) -> str:
    """Return one message; each header after the first starts at the root, except the common commands."""
    return commands[0] + "".join(";" + ("" if text.startswith("*") else ":") + text for text in commands[1:])


def _refused(
    role: str, group: str, errors: tuple[QueuedError, ...], changed: Sequence[tuple[Register, str]]
) -> RefusedError:
    differences = [
        f"{register.key} ({register.header}) programmed {argument(register.value)}, read back {reply}"
        for register, reply in changed
    ]
    queue = ["error queue: " + ", ".join(map(str, errors))] if errors else []
    if {register.key for register, _ in changed} == {"output_on"}:
        return RefusedError(role, f"{group}: " + "; ".join(differences + queue), *RELAY, errors)
    causes = dict.fromkeys(CAUSES[error.number] for error in errors if error.number in CAUSES)
    why = "; ".join(causes) or "the instrument rounded or refused the value, or the front panel was used"
    keys = ", ".join(register.key for register, _ in changed) or group
    remedy = f"change {keys} in the scene or bench file to what the instrument can do"
    return RefusedError(role, f"{group}: " + "; ".join(differences + queue), why, remedy, errors)
