"""Opening of the instruments a scene needs, and no others; every output is off, and verified off, on every way out.

The one place that chooses what drivers stand on: VISA and the vendor's library, or the twin.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, cast

from drivers.interfaces import Clock, Connection, Instrument, InstrumentError
from hpe_rig.bench.bench_file import GENERATOR_ROLES, BenchFile
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
    """Yield the bench with the instruments of ``roles`` open; make it safe, verified, on every way out.

    ``first_shot`` is the index of the first shot to come: a twin that goes on with a run draws on its noise from there.
    Raises ``BenchInUseError`` where another program holds an instrument of a real bench, before anything is opened.
    """
    # Nothing is sent to a stranger at a wrong address, not even to switch it off.
    known: list[Instrument] = []
    # Interrupts end what is in the inner block, and are held back from where it ends until every output is off.
    with uninterrupted(), ExitStack() as stack:
        stack.enter_context(locked(resources(bench)))
        try:
            with interruptible():
                reached = _reach(twin_tables(scene) if bench.simulated else {}, bench, first_shot, stack, lock=True)
                drivers = _all_identified(reached, roles, bench, known, stack)
                opened = Bench(bench.simulated, reached.clock, reached.world, **drivers)
                opened.make_safe()
                yield opened
        except BaseException as error:
            if not (isinstance(error, UnsafeBenchError) and error.concerns(known)):
                proven = make_safe(known)
                # Of a simulated bench that nobody reached yet nothing is on, and nobody can go and look.
                if known or not bench.simulated:
                    error.add_note(proven_off(roles, proven))
            # Else just tried, as stubbornly as it is worth.
            raise
        make_safe(known)


@contextmanager
def open_each(bench: BenchFile, lock: bool = True) -> Iterator[Mapping[str, Instrument | Exception]]:
    """Yield every instrument of the bench file by role, identified, or why it is not there; nothing is changed.

    On the way out those that are there are made safe, verified. Without ``lock`` another program may be at them.
    """
    roles = [role for role in GENERATOR_ROLES if getattr(bench.generators, role) is not None]
    found: dict[str, Instrument | Exception] = {}
    with uninterrupted(), ExitStack() as stack:
        stack.enter_context(locked(resources(bench) if lock else []))
        try:
            with interruptible():
                reached = _reach({}, bench, 0, stack, lock)
                for role in (*roles, "digitizer"):
                    try:
                        found[role] = _identified(reached, role, bench, stack)
                    except (InstrumentError, OSError) as error:
                        found[role] = error
                yield found
        finally:
            make_safe([item for item in found.values() if not isinstance(item, Exception)])


def _identified(reached: Reach, role: str, bench: BenchFile, stack: ExitStack) -> Instrument:
    """Return the driver of ``role``, who has said who it is; ``stack`` closes it."""
    instrument: Instrument = reached.instrument(role, bench)
    stack.callback(_close_quietly, instrument)
    instrument.identify()
    return instrument


def _all_identified(
    reached: Reach, roles: Sequence[str], bench: BenchFile, known: list[Instrument], stack: ExitStack
) -> dict[str, Any]:
    """Return the drivers of ``roles``, and add to ``known`` each one that is who it should be.

    All are asked whatever the others answer, so that each one that is there can be made safe. Raises the first failure,
    the others as its notes.
    """
    failures: list[Exception] = []
    for role in sorted(roles, key=SAFE_ORDER.index):
        try:
            known.append(_identified(reached, role, bench, stack))
        except Exception as error:
            failures.append(error)
    if failures:
        for other in failures[1:]:
            failures[0].add_note(str(other))
        raise failures[0]
    return {instrument.role: instrument for instrument in known}


def visa_addresses() -> tuple[str, ...]:
    """Return the addresses of the VISA instruments that can be found; empty where none or no VISA is there."""
    import warnings

    import pyvisa

    for backend in ("", "@py"):
        try:
            with warnings.catch_warnings():
                # Which of its optional parts pyvisa-py lacks is no concern of who looks for instruments.
                warnings.simplefilter("ignore")
                return tuple(pyvisa.ResourceManager(backend).list_resources())
        except (pyvisa.Error, ValueError, OSError):
            continue
    return ()


@dataclass(frozen=True, slots=True)
class Reach:
    """How the instruments of one bench are reached: a connection a generator, one library, one clock."""

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
        most_vpp = generator.max_vpp or math.inf
        if role in ("toneburst", "tracking_pulser"):
            most_vpp = min(most_vpp, bench.limits.max_drive_vpp or math.inf)
        return Agilent33250A(self.connect(role), role, generator.model, most_vpp)


def _reach(simulation: Mapping[str, Any], bench: BenchFile, first_shot: int, stack: ExitStack, lock: bool) -> Reach:
    if not bench.simulated:
        from drivers.alazar import load_library

        addresses = {role: (item.address or "", item.interface) for role, item in bench.generators.by_role.items()}
        connect = _visa_connections(addresses, "", stack, lock)
        return Reach(connect, lambda: load_library(name=bench.digitizer.library), WallClock(), None)
    world = _world(simulation, bench, first_shot)
    if bench.transport is None:
        return Reach(lambda role: cast(Connection, world.connect(role)), world.alazar_library, world.clock, world)
    served = stack.enter_context(_emulator(world, bench, bench.transport)).served
    addresses = {role: (there.address, there.interface) for role, there in served.items()}
    return Reach(_visa_connections(addresses, "@py", stack), world.alazar_library, world.clock, world)


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


@contextmanager
def open_emulator(
    scene: Scene, bench: BenchFile, transport: Transport
) -> Iterator[Mapping[str, tuple[str, str | None]]]:
    """Yield the VISA address, and the interface before it if any, of each simulated generator by role.

    They listen on loopback alone, share one world and one clock, and are gone on the way out.
    """
    with interruptible(), _emulator(_world(twin_tables(scene), bench), bench, transport) as emulator:
        yield {role: (there.address, there.interface) for role, there in emulator.served.items()}


def _visa_connections(
    addresses: Mapping[str, tuple[str, str | None]], backend: str, stack: ExitStack, lock: bool = False
) -> Callable[[str], Connection]:
    """Return what opens the connection of a role; an adapter that several share is opened once."""
    from drivers.visa import NoVisaError, PrologixAdapter, VisaConnection

    interfaces: dict[str, PrologixAdapter] = {}

    def connect(role: str) -> Connection:
        address, before = addresses[role]
        try:
            if before and before not in interfaces:
                interfaces[before] = PrologixAdapter(before, backend=backend)
                stack.callback(interfaces[before].close)
            interface = interfaces[before] if before else None
            opened = VisaConnection(address, backend=backend, adapter=interface, lock=lock)
        except NoVisaError as error:
            why = "this computer lacks the driver for such an address, which may be right"
            raise InstrumentError(role, str(error), why, error.remedy) from error
        except ConnectionError as error:
            remedy = f"correct generators.{role}.address, or see what hpe-rig bench finds"
            raise InstrumentError(role, str(error), "the address, the cable or the power is wrong", remedy) from error
        stack.callback(opened.close)
        return opened

    return connect


def _close_quietly(instrument: Instrument) -> None:
    # The output is proven off by then; a transport that fails to close changes nothing about that.
    with suppress(InstrumentError, OSError):
        instrument.close()
