"""Opening a bench: each reachable output is off at once, and each address without an answer is explained soon."""

from __future__ import annotations

import gc
import os
import signal
import socket
import threading
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from typing import Any

import numpy as np
import pytest

from drivers.agilent import Agilent33250A
from drivers.interfaces import Identity, Instrument, InstrumentError
from drivers.visa import PrologixAdapter
from hpe_rig.bench import TRANSPORTS, BenchFile, interruptible, parse_bench, read_bench
from hpe_rig.bench.emulation import addressed
from hpe_rig.bench.instruments import SAFE_ORDER
from hpe_rig.bench.inventory import switch_off
from hpe_rig.bench.opening import open_bench, open_each
from hpe_rig.measurement import ShotBlock, acquire, prepare_text
from hpe_rig.scene import shipped_scenes
from sim_backend.settings import SimulationSettings
from sim_backend.transports import Emulator
from sim_backend.world import World

SIMULATED = read_bench()
ROLES = tuple(SIMULATED.bench.generators.by_role)
REACHABLE = "tracking_train"
OFF_S = 2.0
"""On an idle computer 0.1 s; the first connection attempt ends after 2.5 s, so that no output waits for one."""
ANSWER_S = 7.0
"""On an idle computer 3 to 4 s; one after another five addresses take 15 s."""

FORMS = {
    "socket": "TCPIP0::{host}::{port}::SOCKET",
    "hislip": "TCPIP0::{host}::hislip0,{port}::INSTR",
    "vxi11": "TCPIP0::{host},{port}::gpib0,{number}::INSTR",
    "prologix": "PRLGX-TCPIP0::{host}::{port}::INTFC",
    "serial": "ASRLsocket://{host}:{port}::INSTR",
}

# pyvisa-py leaves the sockets of failed opens to the garbage collector.
pytestmark = pytest.mark.filterwarnings("ignore:unclosed <socket:ResourceWarning")


@pytest.fixture(scope="module", autouse=True)
def collect_sockets_of_failed_opens() -> Iterator[None]:
    before = set(threading.enumerate())
    yield
    # The listeners are closed, so that the calls of abandoned threads fail.
    for thread in set(threading.enumerate()) - before:
        thread.join(5.0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ResourceWarning)
        gc.collect()


def dropping(stack: ExitStack) -> tuple[str, int]:
    """Return host and port of a listener with a full backlog, which drops every further connection."""
    listener = stack.enter_context(socket.socket())
    listener.bind(("127.0.0.1", 0))
    listener.listen(0)
    for _ in range(3):
        client = stack.enter_context(socket.socket())
        client.setblocking(False)
        with suppress(BlockingIOError):
            client.connect(listener.getsockname())
    return listener.getsockname()


def silent(stack: ExitStack) -> tuple[str, int]:
    """Return host and port of a listener that accepts every connection and never answers."""
    listener = stack.enter_context(socket.create_server(("127.0.0.1", 0)))
    return listener.getsockname()


def refusing(stack: ExitStack) -> tuple[str, int]:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        return listener.getsockname()


def unknown(stack: ExitStack) -> tuple[str, int]:
    return "no-such-host.invalid", 5025


HOLES: dict[str, tuple[Callable[[ExitStack], tuple[str, int]], str]] = {
    "dropping": (dropping, "nothing answers there"),
    "silent": (silent, "accepts the connection but does not answer"),
    "refusing": (refusing, "refuses the connection"),
    "unknown": (unknown, "host name is unknown"),
}


def hole(kind: str, transport: str, number: int, stack: ExitStack) -> tuple[str, str | None]:
    """Return address and interface at which no instrument answers."""
    host, port = HOLES[kind][0](stack)
    address = FORMS[transport].format(host=host, port=port, number=10 + number)
    return (f"GPIB0::{10 + number}::INSTR", address) if transport == "prologix" else (address, None)


def metal(addresses: dict[str, tuple[str, str | None]]) -> BenchFile:
    """Return a real bench with generators at ``addresses``; there is no digitizer."""
    text = addressed(SIMULATED, "socket", addresses).replace('transport = "socket"\n', "")
    text = text.replace("simulated = true", "simulated = false")
    text = text.replace("[digitizer]", '[digitizer]\nlibrary = "no-such-library"')
    return parse_bench("metal", text).bench


@contextmanager
def bench_of_holes(kind: str, transport: str, reachable: bool = True) -> Iterator[tuple[World, BenchFile]]:
    """Yield a bench of which ``REACHABLE`` alone answers, with its output on."""
    wiring = [(cable.source, cable.target, cable.delay_s) for cable in SIMULATED.bench.wiring]
    world = World(SimulationSettings(), wiring, models={"digitizer": SIMULATED.bench.digitizer.model})
    with ExitStack() as stack:
        # One adapter carries all instruments, as on a bench.
        places = {role: hole(kind, transport, number, stack) for number, role in enumerate(ROLES)}
        if transport == "prologix":
            adapter = next(iter(places.values()))[1]
            places = {role: (address, adapter) for role, (address, _) in places.items()}
        if reachable:
            emulator = stack.enter_context(Emulator(transport, world.connect, ROLES))
            served = emulator.served[REACHABLE]
            places[REACHABLE] = (served.address, served.interface)
            world.connect(REACHABLE).write("OUTP 1")
        yield world, metal(places)


class Watch:
    """Time from the start until the output of ``REACHABLE`` is off, watched from a thread."""

    def __init__(self, world: World) -> None:
        self._world, self._start_s = world, time.monotonic()
        self._off_s = float("inf")
        self._thread = threading.Thread(target=self._wait, daemon=True)
        self._thread.start()

    @property
    def off_s(self) -> float:
        """The time, once the opening has ended."""
        self._thread.join(1.0)
        return self._off_s

    @property
    def elapsed_s(self) -> float:
        return time.monotonic() - self._start_s

    def _wait(self) -> None:
        while self._world.outputs_on()[REACHABLE] and self.elapsed_s < 60.0:
            time.sleep(0.005)
        self._off_s = self.elapsed_s


def cases(*fast: tuple[str, str]) -> list[Any]:
    """Return every kind on every transport; all but the ``fast`` ones are marked slow, as each waits three seconds."""
    return [
        pytest.param(kind, transport, marks=[] if (kind, transport) in fast else pytest.mark.slow)
        for transport in TRANSPORTS
        for kind in HOLES
    ]


@pytest.mark.parametrize(("kind", "transport"), cases(("dropping", "socket"), ("silent", "vxi11")))
def test_the_only_instrument_that_answers_is_off_at_once_and_the_others_are_explained(
    kind: str, transport: str
) -> None:
    with bench_of_holes(kind, transport) as (world, bench):
        watch = Watch(world)
        states = {state.role: state for state in switch_off(bench, print)}
        assert watch.elapsed_s < ANSWER_S
        assert watch.off_s < OFF_S
    assert states[REACHABLE].proven
    for role, generator in bench.generators.by_role.items():
        if role != REACHABLE:
            assert not states[role].proven
            assert (generator.interface or generator.address) in states[role].reason
            assert HOLES[kind][1] in states[role].reason
            assert "-10738" not in states[role].reason
    print(f"{kind} {transport}: off after {watch.off_s:.2f} s")


@pytest.mark.parametrize(("kind", "transport"), cases(("dropping", "socket")))
def test_five_addresses_without_an_answer_are_explained_within_seconds(kind: str, transport: str) -> None:
    with bench_of_holes(kind, transport, reachable=False) as (_, bench):
        start_s = time.monotonic()
        with open_each(bench, lock=False) as instruments:
            elapsed_s = time.monotonic() - start_s
        assert elapsed_s < ANSWER_S
    for role in ROLES:
        assert isinstance(instruments[role], InstrumentError)
        assert HOLES[kind][1] in str(instruments[role])
    print(f"{kind} {transport}: answered after {elapsed_s:.2f} s")


def test_on_a_shared_bus_an_instrument_does_not_wait_for_four_silent_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each silent instrument is first asked for a tenth of a second."""
    world = World(SimulationSettings(), [], models={"digitizer": SIMULATED.bench.digitizer.model})
    with Emulator("prologix", world.connect, ROLES) as emulator:
        served = emulator.served[REACHABLE]
        places = {role: (f"GPIB0::{20 + n}::INSTR", served.interface) for n, role in enumerate(ROLES)}
        places[REACHABLE] = (served.address, served.interface)
        world.connect(REACHABLE).write("OUTP 1")
        watch, adapters, waits_s = Watch(world), list[PrologixAdapter](), dict[str, set[float]]()
        open_adapter, identify = PrologixAdapter.__init__, Agilent33250A.identify

        def note_adapter(adapter: PrologixAdapter, *arguments: Any, **options: Any) -> None:
            adapters.append(adapter)
            open_adapter(adapter, *arguments, **options)

        def note_wait(generator: Agilent33250A) -> Identity:
            waits_s.setdefault(generator.role, set()).add(generator._session._connection.timeout_s)  # type: ignore[attr-defined]
            return identify(generator)

        monkeypatch.setattr(PrologixAdapter, "__init__", note_adapter)
        monkeypatch.setattr(Agilent33250A, "identify", note_wait)
        states = {state.role: state for state in switch_off(metal(places), print)}
        assert watch.elapsed_s < ANSWER_S
        assert watch.off_s < OFF_S
    # The second questions to the four silent instruments share 0.6 s.
    assert waits_s == {role: {0.1} if role == REACHABLE else {0.1, 0.15} for role in ROLES}
    assert [adapter._line._socket.fileno() for adapter in adapters] == [-1]  # type: ignore[attr-defined]
    assert [role for role in ROLES if states[role].proven] == [REACHABLE]
    assert "behind PRLGX-TCPIP0" in states["toneburst"].reason


@pytest.mark.skipif(os.name == "nt", reason="a console's Ctrl-C cannot be sent to one process on Windows")
def test_an_interrupt_ends_the_opening_at_once_with_the_output_off() -> None:
    with bench_of_holes("dropping", "socket") as (world, bench):
        watch = Watch(world)
        timer = threading.Timer(1.0, signal.raise_signal, (signal.SIGINT,))
        timer.start()
        with pytest.raises(KeyboardInterrupt) as caught, interruptible():
            switch_off(bench, print)
        assert f"off, verified: {REACHABLE} read back as off" in caught.value.__notes__[0]
        assert watch.elapsed_s < 2.5
        assert not world.outputs_on()[REACHABLE]
        timer.join()


def test_settings_are_read_before_an_output_is_switched_off() -> None:
    world = World(SimulationSettings(), [], models={"digitizer": SIMULATED.bench.digitizer.model})
    with Emulator("socket", world.connect, ROLES) as emulator:
        world.connect(REACHABLE).write("OUTP 1")
        places = {role: (served.address, served.interface) for role, served in emulator.served.items()}
        output_on: dict[str, object] = {}

        def read(instrument: Instrument) -> None:
            output_on[instrument.role] = instrument.snapshot()["output_on"]

        watch = Watch(world)
        with open_each(metal(places), lock=False, before_off=read):
            # The instrument has the command, and carries it out in its own thread.
            assert watch.off_s < OFF_S
    assert [role for role in ROLES if output_on[role]] == [REACHABLE]


def test_a_real_bench_without_any_answer_names_every_output_that_may_be_on() -> None:
    roles = sorted((*ROLES, "digitizer"), key=SAFE_ORDER.index)
    with (
        bench_of_holes("refusing", "socket", reachable=False) as (_, bench),
        pytest.raises(InstrumentError) as caught,
        open_bench(None, bench, roles),
    ):
        pass
    outputs = ", ".join(role for role in roles if role != "digitizer")
    wanted = f"not identified, so not proven off: {outputs}: look whether they are on; there are no others"
    assert wanted in caught.value.__notes__


def test_a_generator_in_this_process_of_another_model_is_refused() -> None:
    text = SIMULATED.text.replace('model = "33250A"', 'model = "33220A"', 1)
    with (
        pytest.raises(InstrumentError, match=r"33250A.*33220A|33220A.*33250A"),
        open_bench(None, parse_bench("other", text).bench, ROLES, world=World(SimulationSettings(), [])),
    ):
        pass


def test_a_bench_that_is_opened_without_a_shot_draws_the_random_numbers_of_the_first_one() -> None:
    text = shipped_scenes()["table-1"].replace("pulse_count = 101", "pulse_count = 48")
    setup = prepare_text("small", text.replace("[acquisition]", "[acquisition]\nrecord_samples = 256"))
    codes = list[Any]()
    for first_shot in ((), (0,), (1,)):
        with open_bench(setup.scene.scene, SIMULATED.bench, setup.plan.roles, *first_shot) as bench:
            events = acquire(setup.plan, bench)
            codes.append(np.concatenate([event.block.codes for event in events if isinstance(event, ShotBlock)]))
    assert np.array_equal(codes[0], codes[1])
    assert not np.array_equal(codes[0], codes[2])
