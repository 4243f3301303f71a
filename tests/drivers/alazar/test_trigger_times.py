"""Trigger times against the pulse rate, for driver, simulated board and compiled library separately.

Driver and twin once misread the unit of single-port trigger times alike, so that no test of one on the other saw it.
Here each is compared with a fact that needs no manual: pulses programmed at 5 kHz come every 200 us.
"""

from __future__ import annotations

import ctypes
import dataclasses
import itertools
import math

import numpy as np
import pytest

from drivers.agilent.generator import Agilent33250A
from drivers.alazar.board import AlazarBoard
from drivers.alazar.digitizer import AlazarDigitizer
from drivers.alazar.return_codes import SUCCESS
from drivers.interfaces import Capture, PulseTrain, TriggerPulse
from sim_backend.settings import Instruments, SimulationSettings
from sim_backend.world import World

WIRING = [("master.output", "tracking_train.trigger", 5e-9), ("tracking_train.output", "digitizer.trigger", 5e-9)]
RATE_HZ, SAMPLE_RATE_HZ, PULSES = 5e3, 100e6, 40
CAPTURE = Capture(SAMPLE_RATE_HZ, 128, 0, PULSES, 0.8, 1.5)


def fired(pulses: int) -> tuple[World, object]:
    """Return a simulated bench, and its digitizer's library, after a single-port capture set up without the driver."""
    settings = SimulationSettings(instruments=Instruments(dual_port_memory=False))
    world = World(settings, WIRING)
    library = world.alazar_library()
    board = library.AlazarGetBoardBySystemID(1, 1)
    for code in (
        library.AlazarSetCaptureClock(board, 1, 0x24, 0, 0),
        library.AlazarSetTriggerOperation(board, 0, 0, 2, 1, 166, 1, 3, 1, 128),
        library.AlazarSetRecordSize(board, 0, 128),
        library.AlazarSetRecordCount(board, pulses),
        library.AlazarStartCapture(board),
    ):
        assert code == SUCCESS
    master = Agilent33250A(world.connect("master"), "master")
    train = Agilent33250A(world.connect("tracking_train"), "tracking_train")
    train.configure(PulseTrain(RATE_HZ, pulses, 1e-3, 10e-6, 4.0, math.inf))
    master.configure(TriggerPulse(10e-6, 4.0, math.inf))
    train.enable_output()
    master.enable_output()
    master.fire()
    world.clock.sleep(1.0)
    return world, library


def stamped(library: object, record: int) -> tuple[int, int]:
    value = ctypes.c_uint64()
    board = library.AlazarGetBoardBySystemID(1, 1)
    return library.AlazarGetTriggerTimestamp(board, record, ctypes.byref(value)), value.value


def test_the_simulated_boards_single_port_times_are_sample_clock_periods() -> None:
    _, library = fired(PULSES)
    assert not library.AlazarBusy(library.AlazarGetBoardBySystemID(1, 1))
    values = [stamped(library, record)[1] for record in range(1, PULSES + 1)]
    np.testing.assert_allclose(np.diff(values) / SAMPLE_RATE_HZ, 1 / RATE_HZ, rtol=0, atol=2 / SAMPLE_RATE_HZ)


def test_the_simulated_board_states_the_times_of_a_thousand_records_and_no_more() -> None:
    _, library = fired(1001)
    assert stamped(library, 1000)[0] == SUCCESS
    assert stamped(library, 1001)[0] == 604


class Board:
    """The smallest board that a driver can capture with: records of zeros, triggered every 200 us."""

    def __init__(self) -> None:
        self.record_count = 0

    def __getattr__(self, name: str):
        def function(*arguments: object) -> int:
            return SUCCESS

        function.__name__ = name
        return function

    def AlazarGetBoardKind(self, handle: object) -> int:
        return 7

    def AlazarBusy(self, handle: object) -> int:
        return 0

    def AlazarGetStatus(self, handle: object) -> int:
        return 0

    def AlazarGetMaxRecordsCapable(self, handle: object, samples: int, most: object) -> int:
        most._obj.value = 256_000
        return SUCCESS

    def AlazarQueryCapability(self, handle: object, capability: int, reserved: int, value: object) -> int:
        value._obj.value = {0x1000002C: 19}.get(capability, 0)
        return SUCCESS

    def AlazarGetTriggerTimestamp(self, handle: object, record: int, value: object) -> int:
        if record > 1000:
            return 604
        value._obj.value = record * round(SAMPLE_RATE_HZ / RATE_HZ)
        return SUCCESS


class FixedClock:
    """A clock at time zero that must not sleep."""

    def now_s(self) -> float:
        return 0.0

    def sleep(self, duration_s: float) -> None:
        raise AssertionError(duration_s)


def captured(pulses: int) -> np.ndarray:
    digitizer = AlazarDigitizer(AlazarBoard(Board()), FixedClock(), mode="single_port")
    digitizer.configure(dataclasses.replace(CAPTURE, record_count=pulses))
    digitizer.arm()
    blocks = list(digitizer.records(1.0))
    ends = itertools.accumulate(len(block.codes) for block in blocks)
    assert [block.first_record + len(block.codes) for block in blocks] == list(ends)
    return np.concatenate([block.trigger_time_s for block in blocks])


def test_the_driver_reads_single_port_times_as_sample_clock_periods() -> None:
    np.testing.assert_allclose(np.diff(captured(PULSES)), 1 / RATE_HZ, rtol=1e-9)


@pytest.mark.parametrize("pulses", [1001, 2500])
def test_a_record_without_a_trigger_time_is_delivered_with_nan(pulses: int) -> None:
    times_s = captured(pulses)
    assert times_s.size == pulses
    np.testing.assert_array_equal(np.isnan(times_s), np.arange(pulses) >= 1000)
