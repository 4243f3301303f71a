"""Open the instruments a scene needs, and nothing else; leave every output off and verified off on every exit.

The one place that chooses wires: the real drivers stand on VISA and the vendor's library, or on the twin.
"""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from types import FrameType
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray

from drivers.interfaces import (
    Clock,
    Digitizer,
    Instrument,
    InstrumentError,
    MasterTrigger,
    PulseGenerator,
    Setting,
    ToneburstGenerator,
)
from drivers.interfaces import Wire as InstrumentWire
from hpe_rig.bench_file import BenchFile
from hpe_rig.mistakes import Mistake, mistakes_of
from hpe_rig.scene import Scene

if TYPE_CHECKING:
    from sim_backend.world import World

SAFE_ATTEMPTS = 2
"""How often an instrument is asked to be safe before it counts as unreachable: one lost reply is no lost bench."""
SAFE_ORDER = ("toneburst", "burst_train", "master", "tracking_pulser", "tracking_train", "digitizer")
"""Order of making safe: what pushes first."""


class UnsafeBenchError(Exception):
    """Some output could not be proven off."""

    def __init__(self, failures: Sequence[tuple[str, BaseException]]) -> None:
        lines = "\n".join(f"  {role}: {error}" for role, error in failures)
        super().__init__(
            f"THE BENCH MAY STILL BE DRIVING: not proven off: {', '.join(role for role, _ in failures)}\n{lines}\n"
            "Switch these outputs off by hand, now; programmed trains are finite and end by themselves."
        )
        self.roles = tuple(role for role, _ in failures)


class WallClock:
    """The clock of a real bench."""

    def now_s(self) -> float:
        return time.monotonic()

    def sleep(self, duration_s: float) -> None:
        time.sleep(duration_s)


@dataclass(frozen=True, slots=True)
class Bench:
    """The open instruments of a bench; ``burst_train`` and ``toneburst`` are None where nothing pushes."""

    simulated: bool
    clock: Clock
    master: MasterTrigger
    burst_train: PulseGenerator | None
    toneburst: ToneburstGenerator | None
    tracking_train: PulseGenerator
    tracking_pulser: ToneburstGenerator
    digitizer: Digitizer
    world: World | None

    @property
    def instruments(self) -> tuple[Instrument, ...]:
        """Every open instrument, in the order of making safe."""
        return tuple(getattr(self, role) for role in SAFE_ORDER if getattr(self, role) is not None)

    @property
    def generators(self) -> tuple[MasterTrigger | PulseGenerator | ToneburstGenerator, ...]:
        """The open generators, in the order of the trigger's way."""
        chain = (self.master, self.burst_train, self.toneburst, self.tracking_train, self.tracking_pulser)
        return tuple(generator for generator in chain if generator is not None)

    def make_safe(self) -> None:
        """Switch every output off and abort the capture, each guarded on its own; raise ``UnsafeBenchError``."""
        make_safe(self.instruments)

    def snapshot(self) -> dict[str, Mapping[str, Setting]]:
        """Return every instrument's settings as read back, by role."""
        return {instrument.role: instrument.snapshot() for instrument in self.instruments}

    def true_displacement_m(self) -> NDArray[np.float64] | None:
        """Return the true displacement at the focus for each record of the last capture; None on a real bench."""
        return None if self.world is None else self.world.true_displacement_m()


def check_simulation(tables: Mapping[str, Any]) -> list[Mistake]:
    """Return the mistakes of a ``[simulation]`` section, by the twin's own rules."""
    from sim_backend.settings import SimulationSettings

    return mistakes_of(SimulationSettings, tables, ("simulation",))


def simulation_schema() -> dict[str, Any]:
    """Return the JSON schema of the ``[simulation]`` section."""
    from sim_backend.settings import SimulationSettings

    return SimulationSettings.model_json_schema()


@contextmanager
def open_bench(scene: Scene, bench: BenchFile, roles: Sequence[str], first_shot: int = 0) -> Iterator[Bench]:
    """Yield the bench with the instruments of ``roles`` open; make it safe, verified, on every way out.

    ``first_shot`` is the index of the first shot to come: a twin that goes on with a run draws on its noise from there.
    """
    with interruptible(), ExitStack() as stack:
        if bench.simulated:
            opened = _open_twin(scene, bench, roles, stack, first_shot)
        else:
            opened = _open_metal(scene, bench, roles, stack)
        for instrument in opened.instruments:
            stack.callback(_close_quietly, instrument)
        # Nothing is sent to a stranger at a wrong address, not even to switch it off.
        known: list[Instrument] = []
        try:
            for instrument in opened.instruments:
                instrument.identify()
                known.append(instrument)
            opened.make_safe()
            yield opened
        finally:
            make_safe(known)


def _open_twin(scene: Scene, bench: BenchFile, roles: Sequence[str], stack: ExitStack, first_shot: int) -> Bench:
    from drivers.alazar_api import AlazarLibrary
    from sim_backend.settings import SimulationSettings
    from sim_backend.world import World

    declared: dict[str, Any] = {"sound_speed_m_per_s": scene.acquisition.sound_speed_m_per_s}
    if scene.beams is not None:
        declared["beams"] = scene.beams.model_dump(exclude={"pulse_length_m"})
    settings = SimulationSettings.model_validate(declared | (scene.simulation or {}))
    wiring = [(wire.source, wire.target, wire.delay_s) for wire in bench.wiring]
    world = World(settings, wiring, first_capture=first_shot)
    wires = {role: cast(InstrumentWire, world.wire(role)) for role in roles if role != "digitizer"}
    library = cast(AlazarLibrary, world.alazar_library())
    return _assemble(bench, wires, library, world.clock, world, stack)


def _open_metal(scene: Scene, bench: BenchFile, roles: Sequence[str], stack: ExitStack) -> Bench:
    from drivers.alazar_api import load_library
    from drivers.visa_wire import VisaWire

    wires: dict[str, InstrumentWire] = {}
    for role in roles:
        if role != "digitizer":
            wires[role] = VisaWire(getattr(bench.generators, role).address)
            stack.callback(wires[role].close)
    return _assemble(bench, wires, load_library(), WallClock(), None, stack)


def _assemble(
    bench: BenchFile,
    wires: Mapping[str, InstrumentWire],
    library: Any,
    clock: Clock,
    world: World | None,
    stack: ExitStack,
) -> Bench:
    from drivers.agilent_33250a import MasterTrigger33250A, PulseGenerator33250A, ToneburstGenerator33250A
    from drivers.ats460 import Ats460

    def pulses(role: str) -> PulseGenerator33250A:
        return PulseGenerator33250A(wires[role], role)

    def bursts(role: str) -> ToneburstGenerator33250A:
        return ToneburstGenerator33250A(wires[role], role)

    board = bench.digitizer
    return Bench(
        simulated=bench.simulated,
        clock=clock,
        master=MasterTrigger33250A(wires["master"], "master"),
        burst_train=pulses("burst_train") if "burst_train" in wires else None,
        toneburst=bursts("toneburst") if "toneburst" in wires else None,
        tracking_train=pulses("tracking_train"),
        tracking_pulser=bursts("tracking_pulser"),
        digitizer=Ats460(library, clock, system_id=board.system_id, board_id=board.board_id),
        world=world,
    )


def make_safe(instruments: Sequence[Instrument]) -> None:
    """Make each of ``instruments`` safe, whatever happens to the others; raise ``UnsafeBenchError`` for those left."""
    with uninterrupted():
        failures = [(item.role, error) for item in instruments if (error := _unsafe(item)) is not None]
        # Inside, so that an interrupt that was held back cannot take this message's place.
        if failures:
            raise UnsafeBenchError(failures)


def _unsafe(instrument: Instrument) -> Exception | None:
    """Return why ``instrument`` could not be proven safe; None where it was."""
    failure: Exception | None = None
    for _ in range(SAFE_ATTEMPTS):
        try:
            instrument.make_safe()
        except Exception as error:
            failure = error
        else:
            return None
    return failure


def _close_quietly(instrument: Instrument) -> None:
    # The output is proven off by then; a transport that fails to close changes nothing about that.
    try:
        instrument.close()
    except (InstrumentError, OSError):
        return


class Terminated(BaseException):
    """SIGTERM arrived; derived like KeyboardInterrupt so that no ``except Exception`` swallows it."""


@contextmanager
def interruptible() -> Iterator[None]:
    """Turn SIGTERM into ``Terminated`` while the bench is open, so that it unwinds like Ctrl-C."""

    def terminate(number: int, frame: FrameType | None) -> None:
        raise Terminated

    with _handlers({signal.SIGTERM: terminate}):
        yield


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Hold Ctrl-C and SIGTERM back until the block is done, then let the first of them through."""
    held: list[int] = []

    def hold(number: int, frame: FrameType | None) -> None:
        held.append(number)

    with _handlers({signal.SIGINT: hold, signal.SIGTERM: hold}):
        yield
    if held:
        signal.raise_signal(held[0])


@contextmanager
def _handlers(handlers: Mapping[signal.Signals, Any]) -> Iterator[None]:
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.signal(number, handler) for number, handler in handlers.items()}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
