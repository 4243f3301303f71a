"""The twin's trigger chain and digitizer on their drivers; the echoes are a closed form."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import numpy as np
import pytest

from drivers.agilent.generator import Agilent33250A
from drivers.alazar.board import AlazarBoard
from drivers.alazar.digitizer import AlazarDigitizer
from drivers.alazar.page_buffer import PageBuffer
from drivers.interfaces import Capture, PulseTrain, TriggerPulse
from sim_backend.settings import Instruments, SimulationSettings
from sim_backend.world import World

WIRING = [
    ("master.output", "tracking_train.trigger", 5e-9),
    ("tracking_train.output", "digitizer.trigger", 5e-9),
    ("digitizer.aux", "tracking_pulser.trigger", 5e-9),
]
RATE_HZ = 5e3


def echo_volts(records: int, samples: int, amplitude_v: float = 0.5) -> np.ndarray:
    record, sample = np.ogrid[:records, :samples]
    return amplitude_v * np.sin(2 * np.pi * (sample / 37.3 + record / 11.1)) + 1e-3 * record


class ClosedForm:
    """Receives ``echo_volts`` whatever was transmitted."""

    def __init__(self, amplitude_v: float = 0.5) -> None:
        self.amplitude_v = amplitude_v

    def record_volts(self, tonebursts, pulses, capture) -> np.ndarray:
        last = capture.first_record + len(capture.first_sample_ps)
        return echo_volts(last, capture.samples, self.amplitude_v)[capture.first_record :]


class Spy:
    """Passes calls on and notes their names; ``answers`` replaces results by name, a list one after the other."""

    def __init__(self, library, answers: dict[str, object] | None = None) -> None:
        self.library, self.answers = library, answers or {}
        self.calls: list[str] = []

    def __getattr__(self, name: str):
        def function(*arguments):
            self.calls.append(name)
            if name in self.answers:
                answer = self.answers[name]
                return answer() if callable(answer) else answer
            return getattr(self.library, name)(*arguments)

        function.__name__ = name
        return function


class Memory:
    """Hands out page buffers and knows which are still held."""

    def __init__(self) -> None:
        self.buffers: list[PageBuffer] = []

    def __call__(self, size_bytes: int) -> PageBuffer:
        self.buffers.append(PageBuffer(size_bytes))
        return self.buffers[-1]

    @property
    def held(self) -> int:
        return sum(not buffer.freed for buffer in self.buffers)


class Rig:
    """The twin with the trigger chain on drivers: master, tracking train, digitizer."""

    def __init__(self, dual: bool, amplitude_v: float = 0.5, answers=None, **instruments) -> None:
        settings = SimulationSettings(instruments=Instruments(dual_port_memory=dual, **instruments))
        self.world = World(settings, WIRING, acoustics=ClosedForm(amplitude_v))
        self.library = Spy(self.world.alazar_library(), answers)
        self.memory = Memory()
        self.master = Agilent33250A(self.world.connect("master"), "master")
        self.train = Agilent33250A(self.world.connect("tracking_train"), "tracking_train")
        self.digitizer = AlazarDigitizer(AlazarBoard(self.library), self.world.clock, allocate=self.memory)

    def fire(self, capture: Capture, pulses: int | None = None) -> None:
        """Program everything, arm and fire; ``pulses`` other than the record count starve the digitizer."""
        self.digitizer.configure(capture)
        self.digitizer.verify()
        self.master.configure(TriggerPulse(10e-6, 4.0, math.inf))
        self.train.configure(PulseTrain(RATE_HZ, pulses or capture.record_count, 1e-3, 10e-6, 4.0, math.inf))
        self.digitizer.arm()
        self.digitizer.verify()
        self.train.enable_output()
        self.master.enable_output()
        self.master.fire()

    def deadline_s(self, after_s: float = 1.0) -> float:
        return self.world.clock.now_s() + after_s

    def shot(self, capture: Capture) -> tuple[np.ndarray, np.ndarray]:
        self.fire(capture)
        blocks = list(self.digitizer.records(self.deadline_s()))
        assert [block.first_record for block in blocks] == list(
            np.cumsum([0, *(len(block.codes) for block in blocks[:-1])])
        )
        return np.concatenate([b.codes for b in blocks]), np.concatenate([b.trigger_time_s for b in blocks])


@pytest.fixture(params=[False, True], ids=["single_port", "dual_port"])
def rig(request) -> Iterator[Rig]:
    new_rig = Rig(request.param)
    yield new_rig
    new_rig.digitizer.close()
    assert new_rig.memory.held == 0


@pytest.fixture
def make_rig() -> type[Rig]:
    """Return the class of the twin on drivers, called with ``dual`` and options."""
    return Rig


@pytest.fixture
def volts() -> Callable[..., np.ndarray]:
    """Return the function of the echoes (record, sample) that the twin receives."""
    return echo_volts
