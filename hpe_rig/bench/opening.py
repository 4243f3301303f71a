"""Opening the instruments that a scene needs; on exit every output is switched off and verified, whatever happens.

Only this module connects the drivers: to VISA and the vendor's library, or to the twin.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, cast

from drivers.interfaces import Clock, Connection, Instrument, InstrumentError
from hpe_rig.bench.bench_file import BenchFile
from hpe_rig.bench.identity import require_serials
from hpe_rig.bench.instruments import SAFE_ORDER, Bench, UnsafeBenchError, make_safe, proven_off
from hpe_rig.bench.interrupts import interruptible, uninterrupted
from hpe_rig.bench.lock import locked, resources
from hpe_rig.bench.twin import twin_tables
from hpe_rig.scene import Scene

if TYPE_CHECKING:
    from sim_backend.transports import Emulator, Transport
    from sim_backend.world import World


class WallClock:
    """The clock of a real bench."""

    def now_s(self) -> float:
        return time.monotonic()

    def sleep(self, duration_s: float) -> None:
        time.sleep(duration_s)


@contextmanager
def open_bench(scene: Scene, bench: BenchFile, roles: Sequence[str], first_shot: int = 0) -> Iterator[Bench]:
    """Yield the bench with the instruments of ``roles`` open; on exit make it safe and verify that.

    ``first_shot`` is the index of the next shot; the random numbers of a resumed twin continue there. Raises
    ``BenchInUseError`` before anything is opened if another program uses an instrument of a real bench.
    """
    # Only identified instruments are sent commands; an unknown one at a wrong address is left alone.
    identified: list[Instrument] = []
    # Interrupts end the inner block; after it they are deferred until every output is off.
    with uninterrupted(), ExitStack() as stack:
        stack.enter_context(locked(resources(bench)))
        try:
            with interruptible():
                simulation = twin_tables(scene) if bench.simulated else {}
                connections = _connect(simulation, bench, first_shot, stack, lock=True)
                drivers = _identify_all(connections, roles, bench, identified, stack)
                instruments = Bench(bench.simulated, connections.clock, connections.world, file=bench, **drivers)
                instruments.make_safe()
                require_serials(bench, instruments.instruments)
                yield instruments
        except BaseException as error:
            # An UnsafeBenchError about all of these instruments means that switching them off has just been tried.
            if not (isinstance(error, UnsafeBenchError) and error.concerns(identified)):
                proofs = make_safe(identified)
                # An unidentified real instrument may be on, and the operator must look.
                if identified or not bench.simulated:
                    error.add_note(proven_off(roles, proofs))
            raise
        make_safe(identified)


@contextmanager
def open_each(bench: BenchFile, lock: bool = True) -> Iterator[Mapping[str, Instrument | Exception]]:
    """Yield every instrument of the bench file by role, identified, or the error instead; no setting is changed.

    On exit the identified ones are made safe and verified. Without ``lock`` another program may be using them.
    """
    instruments: dict[str, Instrument | Exception] = {}
    with uninterrupted(), ExitStack() as stack:
        stack.enter_context(locked(resources(bench) if lock else []))
        try:
            with interruptible():
                connections = _connect({}, bench, 0, stack, lock)
                for role in (*bench.generators.by_role, "digitizer"):
                    try:
                        instruments[role] = _identify(connections, role, bench, stack)
                    except (InstrumentError, OSError) as error:
                        instruments[role] = error
                yield instruments
        finally:
            make_safe([item for item in instruments.values() if not isinstance(item, Exception)])


def _identify(connections: Connections, role: str, bench: BenchFile, stack: ExitStack) -> Instrument:
    """Return the driver of ``role`` after its instrument has identified itself; ``stack`` closes it."""
    instrument: Instrument = connections.instrument(role, bench)
    stack.callback(_close_quietly, instrument)
    instrument.identify()
    return instrument


def _identify_all(
    connections: Connections, roles: Sequence[str], bench: BenchFile, identified: list[Instrument], stack: ExitStack
) -> dict[str, Any]:
    """Return the drivers of ``roles`` by role, and add each to ``identified`` as soon as its instrument answers.

    All instruments are asked even if one fails, so that each that answers can be made safe. Raises the first failure
    with the others as notes.
    """
    failures: list[Exception] = []
    for role in sorted(roles, key=SAFE_ORDER.index):
        try:
            identified.append(_identify(connections, role, bench, stack))
        except Exception as error:
            failures.append(error)
    if failures:
        for failure in failures[1:]:
            failures[0].add_note(str(failure))
        raise failures[0]
    return {instrument.role: instrument for instrument in identified}


def visa_addresses() -> tuple[str, ...]:
    """Return the addresses of all VISA instruments; empty without instruments or without VISA."""
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
    """Connections to the instruments of one bench: one for each generator, one digitizer library, one clock."""

    connect: Callable[[str], Connection]
    library: Callable[[], Any]
    clock: Clock
    world: World | None

    def instrument(self, role: str, bench: BenchFile) -> Any:
        """Return the driver of ``role`` on its connection."""
        from drivers.agilent import Agilent33250A
        from drivers.alazar import AlazarBoard, AlazarDigitizer

        if role == "digitizer":
            settings = bench.digitizer
            ids = {"system_id": settings.system_id, "board_id": settings.board_id}
            board = AlazarBoard(self.library(), role, settings.board_model, **ids)
            return AlazarDigitizer(board, self.clock, settings.acquisition_mode)
        generator = getattr(bench.generators, role)
        max_vpp = generator.max_vpp or math.inf
        if role in ("toneburst", "tracking_pulser"):
            max_vpp = min(max_vpp, bench.limits.max_drive_vpp or math.inf)
        return Agilent33250A(self.connect(role), role, generator.model, max_vpp)


def _connect(
    simulation: Mapping[str, Any], bench: BenchFile, first_shot: int, stack: ExitStack, lock: bool
) -> Connections:
    """Return the connections to the real instruments, or to a twin with the settings ``simulation``."""
    if not bench.simulated:
        from drivers.alazar import load_library

        addresses = {role: (item.address or "", item.interface) for role, item in bench.generators.by_role.items()}
        connect = _visa_connections(addresses, "", stack, lock)
        return Connections(connect, lambda: load_library(name=bench.digitizer.library), WallClock(), None)
    world = _world(simulation, bench, first_shot)
    if bench.transport is None:
        return Connections(lambda role: cast(Connection, world.connect(role)), world.alazar_library, world.clock, world)
    addresses = _addresses(stack.enter_context(_emulator(world, bench, bench.transport)))
    return Connections(_visa_connections(addresses, "@py", stack), world.alazar_library, world.clock, world)


def _world(simulation: Mapping[str, Any], bench: BenchFile, first_shot: int = 0) -> World:
    from sim_backend.settings import SimulationSettings
    from sim_backend.world import World

    settings = SimulationSettings.model_validate(simulation)
    wiring = [(cable.source, cable.target, cable.delay_s) for cable in bench.wiring]
    models = {role: generator.model for role, generator in bench.generators.by_role.items()}
    return World(settings, wiring, first_capture=first_shot, models=models, board=bench.digitizer.model)


def _emulator(world: World, bench: BenchFile, transport: Transport) -> Emulator:
    from sim_backend.transports import Emulator

    try:
        return Emulator(transport, world.connect, tuple(bench.generators.by_role))
    except OSError as error:
        what = f"the generators cannot be served over {transport}"
        raise InstrumentError("simulated bench", what, str(error), "take another transport") from error


def _addresses(emulator: Emulator) -> dict[str, tuple[str, str | None]]:
    """Return by role the VISA address of each simulated generator, and of the interface before it."""
    return {role: (server.address, server.interface) for role, server in emulator.served.items()}


@contextmanager
def open_emulator(
    scene: Scene, bench: BenchFile, transport: Transport
) -> Iterator[Mapping[str, tuple[str, str | None]]]:
    """Yield by role the VISA address of each simulated generator, and the interface before it if there is one.

    They listen on loopback only, share one world and one clock, and end on exit.
    """
    with interruptible(), _emulator(_world(twin_tables(scene), bench), bench, transport) as emulator:
        yield _addresses(emulator)


def _visa_connections(
    addresses: Mapping[str, tuple[str, str | None]], backend: str, stack: ExitStack, lock: bool = False
) -> Callable[[str], Connection]:
    """Return the function that opens the connection of a role; an adapter that several share is opened once."""
    from drivers.visa import NoVisaError, PrologixAdapter, VisaConnection

    adapters: dict[str, PrologixAdapter] = {}

    def connect(role: str) -> Connection:
        address, interface = addresses[role]
        try:
            if interface and interface not in adapters:
                adapters[interface] = PrologixAdapter(interface, backend=backend)
                stack.callback(adapters[interface].close)
            adapter = adapters[interface] if interface else None
            connection = VisaConnection(address, backend=backend, adapter=adapter, lock=lock)
        except NoVisaError as error:
            why = "this computer has no driver for such an address, which may be right"
            raise InstrumentError(role, str(error), why, error.remedy) from error
        except ConnectionError as error:
            remedy = f"correct generators.{role}.address, or see what hpe-rig bench finds"
            raise InstrumentError(role, str(error), "the address, the cable or the power is wrong", remedy) from error
        stack.callback(connection.close)
        return connection

    return connect


def _close_quietly(instrument: Instrument) -> None:
    # The output is verified to be off before; a failure to close the connection does not change that.
    with suppress(InstrumentError, OSError):
        instrument.close()
