"""Opening the instruments that a scene needs; on exit every output is switched off and verified, whatever happens.

Only this module connects the drivers: to VISA and the vendor's library, or to the twin.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any, Final, cast

from drivers.interfaces import Clock, Connection, Instrument, InstrumentError
from drivers.visa import within
from hpe_rig.bench.bench_file import BenchFile
from hpe_rig.bench.identity import reported_serials, require_serials, serial_problems
from hpe_rig.bench.instruments import (
    SAFE_ORDER,
    Bench,
    DigitizerNotIdleError,
    has_tried,
    make_safe,
    proven_off,
)
from hpe_rig.bench.interrupts import interruptible, uninterrupted
from hpe_rig.bench.lines import Answer, Answers, ask_buses
from hpe_rig.bench.lock import exclusive
from hpe_rig.bench.twin import twin_tables
from hpe_rig.scene import Scene

if TYPE_CHECKING:
    from sim_backend.transports import Emulator, Transport
    from sim_backend.world import Silence, World

SEARCH_TIMEOUT_S: Final = 5.0
"""Longest search for the addresses of instruments: a GPIB adapter without a cable does not answer."""
BRIEF_S: Final = 0.1
"""Time-out of the first question to each instrument on a shared bus."""
SHARED_S: Final = 0.6
"""Time-outs of the second questions to the silent instruments on a shared bus, in total; each is asked twice."""


class WallClock:
    """The clock of a real bench."""

    def now_s(self) -> float:
        return time.monotonic()

    def sleep(self, duration_s: float) -> None:
        time.sleep(duration_s)


@contextmanager
def open_bench(
    scene: Scene | None, bench: BenchFile, roles: Sequence[str], first_shot: int = 0, world: World | None = None
) -> Iterator[Bench]:
    """Yield the bench with the instruments of ``roles`` open; on exit make it safe and verify that.

    ``first_shot`` is the index of the next shot; the random numbers of a resumed twin continue there. ``world`` is the
    twin of a simulated bench, by default the one that ``scene`` declares. Raises ``BenchInUseError`` before anything
    is opened if another program uses an instrument of a real bench.
    """
    # Interrupts end the inner block; after it they are deferred until every output is off.
    with uninterrupted(), ExitStack() as stack:
        stack.enter_context(exclusive(bench))
        # Only identified instruments are sent commands; an unknown one at a wrong address is left alone.
        answers = Answers(stack)
        try:
            with interruptible():
                if bench.simulated and world is None and scene is not None:
                    world = _world(twin_tables(scene), bench, first_shot)
                connections = _connect(world, bench, stack, answers, lock=True)
                _open_all(connections, sorted(roles, key=SAFE_ORDER.index), bench, stack, answers)
                drivers = _identified(answers)
                instruments = Bench(bench.simulated, connections.clock, connections.world, file=bench, **drivers)
                instruments.make_safe()
                require_serials(bench, instruments.instruments)
                yield instruments
        except BaseException as error:
            _make_safe_after(error, answers.identified, roles, bench)
            if error in answers.by_role.values():
                _add_exchanges(error, answers.identified, bench)
            raise
        make_safe(answers.identified)


@contextmanager
def open_each(
    bench: BenchFile, lock: bool = True, before_off: Callable[[Instrument], None] = lambda instrument: None
) -> Iterator[Mapping[str, Answer]]:
    """Yield every instrument of the bench file by role, identified, or the error instead.

    Each output is switched off as soon as its instrument has identified itself and ``before_off`` has returned, in a
    thread of each bus. On exit the identified ones are made safe and verified. Without ``lock`` another program may be
    using them.
    """
    with uninterrupted(), ExitStack() as stack:
        if lock:
            stack.enter_context(exclusive(bench))
        answers, roles = Answers(stack), (*bench.generators.by_role, "digitizer")
        try:
            with interruptible():
                connections = _connect(None, bench, stack, answers, lock)
                _open_all(connections, roles, bench, stack, answers, before_off)
                yield answers.by_role
        except BaseException as error:
            _make_safe_after(error, answers.identified, roles, bench)
            raise
        make_safe(answers.identified)


def _make_safe_after(
    error: BaseException, identified: Sequence[Instrument], roles: Sequence[str], bench: BenchFile
) -> None:
    """Make the ``identified`` instruments safe after ``error``, and add to it the outputs that are verified off."""
    # Such an error about all of these instruments means that switching them off has just been tried.
    if has_tried(error, identified):
        return
    try:
        proofs = make_safe(identified)
    except DigitizerNotIdleError as failure:
        # It drives nothing, so that the first error remains the one to report.
        error.add_note(str(failure))
        proofs = failure.proven
    # An unidentified real instrument may be on, and the operator must look.
    if identified or not bench.simulated:
        error.add_note(proven_off(roles, proofs))


def _add_exchanges(error: BaseException, identified: Sequence[Instrument], bench: BenchFile) -> None:
    """Add to ``error``, an instrument that is missing, the exchanged ones among those that answered."""
    serials = {role: item for role, item in reported_serials(bench, identified).items() if isinstance(item, str)}
    for role, text in serial_problems(bench, serials).items():
        error.add_note(f"{role}: {text}")


def _open_all(
    connections: Connections,
    roles: Sequence[str],
    bench: BenchFile,
    stack: ExitStack,
    answers: Answers,
    before_off: Callable[[Instrument], None] = lambda instrument: None,
) -> None:
    """Open, identify and switch off the instruments of ``roles``, on all buses at the same time; see ``open_each``.

    Those in this process come last.
    """

    def switch_off(instrument: Instrument) -> None:
        # A failure here is repeated or repaired when the bench is made safe.
        with suppress(Exception):
            before_off(instrument)
        with suppress(Exception):
            instrument.switch_off()

    buses: dict[str, list[str]] = {}
    for role in sorted(roles, key=SAFE_ORDER.index):
        buses.setdefault(connections.bus(role), []).append(role)
    in_process = buses.pop("", [])
    ask_buses(buses.values(), partial(_identify_on_bus, connections, bench, answers, switch_off), answers)
    for role in in_process:
        try:
            instrument = connections.instrument(role, bench)
            stack.callback(_close_quietly, instrument)
            instrument.identify()
            answers.by_role[role] = instrument
            switch_off(instrument)
        except Exception as error:
            answers.by_role[role] = error
    answers.by_role = {role: answers.by_role[role] for role in roles}


def _identify_on_bus(
    connections: Connections,
    bench: BenchFile,
    answers: Answers,
    switch_off: Callable[[Instrument], None],
    roles: Sequence[str],
) -> None:
    """Add the instruments of ``roles``, which share a bus, to ``answers``, and switch each off.

    On a shared bus each is first asked briefly: an instrument that answers does not wait for silent ones.
    """
    lines: dict[str, Any] = {}
    for role in roles:
        try:
            lines[role] = connections.connect(role)
        except Exception as error:
            answers.add(role, error)

    def identify(role: str, timeout_s: float) -> Exception | None:
        line, default_s = lines[role], lines[role].timeout_s
        line.timeout_s = min(timeout_s, default_s)
        try:
            instrument = connections.generator(role, line, bench)
            instrument.identify()
        except Exception as error:
            return error
        finally:
            line.timeout_s = default_s
        answers.add(role, instrument)
        switch_off(instrument)
        return None

    silent = list(lines)
    if len(lines) > 1:
        silent = [role for role in lines if identify(role, BRIEF_S)]
    for role in silent:
        if failure := identify(role, math.inf if len(lines) == 1 else SHARED_S / len(silent)):
            answers.add(role, _with_address(failure, role, bench))


def _with_address(failure: Exception, role: str, bench: BenchFile) -> Exception:
    """Return ``failure`` with the address of an instrument that did not answer."""
    from drivers.agilent import NoReplyError

    generator = bench.generators.by_role[role]
    if not isinstance(failure, NoReplyError) or bench.simulated:
        return failure
    address = " behind ".join(filter(None, (generator.address, generator.interface)))
    what = f"{address} accepts the connection but does not answer *IDN?"
    why = "the instrument hangs or is off behind its adapter, or the address belongs to something else"
    return InstrumentError(role, what, why, f"power it off and on, check generators.{role}.address")


def _identified(answers: Answers) -> dict[str, Any]:
    """Return the instruments by role; raise the first failure with the others as notes."""
    failures = [answer for answer in answers.by_role.values() if isinstance(answer, Exception)]
    if failures:
        for failure in failures[1:]:
            failures[0].add_note(str(failure))
        raise failures[0]
    return dict(answers.by_role)


def visa_addresses() -> tuple[str, ...]:
    """Return the addresses of all VISA instruments; empty without instruments, without VISA, or if it does not answer.

    The search sends messages to instruments, so the bench must be locked. It takes at most ``SEARCH_TIMEOUT_S``.
    """
    # pyvisa-py reports failures of a bus by exceptions of any kind.
    with suppress(Exception):
        return within(SEARCH_TIMEOUT_S, _search_addresses)
    return ()


def _search_addresses() -> tuple[str, ...]:
    import warnings

    import pyvisa

    for backend in ("", "@py"):
        try:
            with warnings.catch_warnings():
                # pyvisa-py warns about optional parts that are not installed.
                warnings.simplefilter("ignore")
                return tuple(pyvisa.ResourceManager(backend).list_resources())
        except (pyvisa.Error, ValueError, OSError):
            continue
    return ()


@dataclass(frozen=True, slots=True)
class Connections:
    """Connections to the instruments of one bench: one for each generator, one digitizer library, one clock.

    ``addresses`` are those of the generators outside this process, with the interface before each.
    """

    connect: Callable[[str], Connection]
    library: Callable[[], Any]
    clock: Clock
    world: World | None
    addresses: Mapping[str, tuple[str, str | None]] = field(default_factory=dict)

    def bus(self, role: str) -> str:
        """Return the name of the bus of ``role``, empty in this process."""
        address, interface = self.addresses.get(role, ("", None))
        return interface or address

    def instrument(self, role: str, bench: BenchFile) -> Any:
        """Return the driver of ``role`` on its connection."""
        from drivers.alazar import AlazarBoard, AlazarDigitizer

        if role != "digitizer":
            return self.generator(role, self.connect(role), bench)
        settings = bench.digitizer
        ids = {"system_id": settings.system_id, "board_id": settings.board_id}
        board = AlazarBoard(self.library(), role, settings.board_model, **ids)
        return AlazarDigitizer(board, self.clock, settings.acquisition_mode)

    def generator(self, role: str, connection: Connection, bench: BenchFile) -> Any:
        """Return the driver of the generator ``role`` on ``connection``."""
        from drivers.agilent import Agilent33250A

        generator = getattr(bench.generators, role)
        max_vpp = generator.max_vpp or math.inf
        if role in ("toneburst", "tracking_pulser"):
            max_vpp = min(max_vpp, bench.limits.max_drive_vpp or math.inf)
        # The instrument that gives the reference runs on its internal clock.
        is_locked = generator.common_reference is True
        return Agilent33250A(connection, role, generator.model, max_vpp, is_locked)


def _connect(world: World | None, bench: BenchFile, stack: ExitStack, answers: Answers, lock: bool) -> Connections:
    """Return the connections to the real instruments, or to the twin ``world``, by default one as usual."""
    if not bench.simulated:
        from drivers.alazar import load_library

        addresses = {role: (item.address or "", item.interface) for role, item in bench.generators.by_role.items()}
        connect = _visa_connections(addresses, "", answers, lock, bench)
        return Connections(connect, lambda: load_library(name=bench.digitizer.library), WallClock(), None, addresses)
    world = world or _world({}, bench)
    if bench.transport is None:
        return Connections(lambda role: cast(Connection, world.connect(role)), world.alazar_library, world.clock, world)
    addresses = _addresses(stack.enter_context(_emulator(world, bench, bench.transport)))
    connect = _visa_connections(addresses, "@py", answers)
    return Connections(connect, world.alazar_library, world.clock, world, addresses)


def silent_world(bench: BenchFile) -> World:
    """Return a twin of ``bench`` with its amplifier off: nothing is transmitted, and nothing is received."""
    from sim_backend.world import Silence

    return _world({}, bench, acoustics=Silence())


def _world(
    simulation: Mapping[str, Any], bench: BenchFile, first_shot: int = 0, acoustics: Silence | None = None
) -> World:
    from sim_backend.settings import SimulationSettings
    from sim_backend.world import World

    settings = SimulationSettings.model_validate(simulation)
    wiring = [(cable.source, cable.target, cable.delay_s) for cable in bench.wiring]
    models = {role: generator.model for role, generator in bench.generators.by_role.items()}
    models["digitizer"] = bench.digitizer.model
    serials = bench.serials if bench.emulated else None
    return World(settings, wiring, acoustics, models, first_shot, serials=serials)


def _emulator(
    world: World, bench: BenchFile, transport: Transport, tcp_ports: Mapping[str, int] | None = None
) -> Emulator:
    from sim_backend.transports import Emulator

    try:
        return Emulator(transport, world.connect, tuple(bench.generators.by_role), tcp_ports)
    except OSError as error:
        what = f"the generators cannot be served over {transport}"
        remedy = "take another transport"
        if tcp_ports and transport == "socket":
            listed = ", ".join(f"{role} {port}" for role, port in tcp_ports.items())
            remedy += f", or end the program that uses one of the ports of the bench file ({listed})"
        raise InstrumentError("simulated bench", what, str(error), remedy) from error


def _addresses(emulator: Emulator) -> dict[str, tuple[str, str | None]]:
    """Return by role the VISA address of each simulated generator, and of the interface before it."""
    return {role: (server.address, server.interface) for role, server in emulator.served.items()}


@contextmanager
def open_emulator(
    scene: Scene, bench: BenchFile, transport: Transport, tcp_ports: Mapping[str, int]
) -> Iterator[Mapping[str, tuple[str, str | None]]]:
    """Yield by role the VISA address of each simulated generator, and the interface before it if there is one.

    They listen on loopback only, share one world and one clock, and end on exit. Raw sockets have ``tcp_ports`` by
    role, and free ones for the other roles.
    """
    with interruptible(), _emulator(_world(twin_tables(scene), bench), bench, transport, tcp_ports) as emulator:
        yield _addresses(emulator)


def _visa_connections(
    addresses: Mapping[str, tuple[str, str | None]],
    backend: str,
    answers: Answers,
    lock: bool = False,
    bench: BenchFile | None = None,
) -> Callable[[str], Connection]:
    """Return the function that opens the connection of a role; an adapter that several share is opened once.

    The settings of RS-232 lines are those of ``bench``.
    """
    from drivers.visa import OpenError, PrologixAdapter, SerialSettings, VisaConnection

    generators = {} if bench is None else bench.generators.by_role
    lines = {role: SerialSettings(item.baud, item.handshake, item.termination) for role, item in generators.items()}

    # Each adapter, or the reason why it cannot be opened, is used by the thread of its bus alone.
    adapters: dict[str, PrologixAdapter | OpenError] = {}

    def adapter(interface: str) -> PrologixAdapter:
        if interface not in adapters:
            try:
                adapters[interface] = new_adapter = PrologixAdapter(interface, backend=backend)
                answers.close_at_end(new_adapter.close)
            except OpenError as error:
                adapters[interface] = error
        if isinstance(result := adapters[interface], OpenError):
            raise result
        return result

    def connect(role: str) -> Connection:
        address, interface = addresses[role]
        try:
            before = adapter(interface) if interface else None
            serial = lines.get(role, SerialSettings())
            connection = VisaConnection(address, backend=backend, adapter=before, lock=lock, serial=serial)
        except OpenError as error:
            key = f"generators.{role}.{'interface' if interface else 'address'}"
            raise InstrumentError(role, str(error), error.why, f"{error.remedy} (key {key})") from error
        answers.close_at_end(connection.close)
        return connection

    return connect


def _close_quietly(instrument: Instrument) -> None:
    # The output is verified to be off before; a failure to close the connection does not change that.
    with suppress(InstrumentError, OSError):
        instrument.close()
