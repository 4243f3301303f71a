"""The digitizer driver on the simulated board and trigger chain; the physics is a closed form known to the tests."""

from __future__ import annotations

import contextlib
import ctypes
import dataclasses
import gc
import math
import weakref
from collections.abc import Callable, Iterator, Sequence
from types import SimpleNamespace

import numpy as np
import pytest

from drivers.agilent.generator import Agilent33250A
from drivers.alazar.api import SIGNATURES
from drivers.alazar.board import AlazarBoard
from drivers.alazar.digitizer import AlazarDigitizer
from drivers.alazar.models import ATS460_BOARD
from drivers.alazar.page_buffer import PageBuffer
from drivers.alazar.return_codes import UNSUPPORTED_FUNCTION
from drivers.interfaces import Capture, DeadlineError, Digitizer, InstrumentError, PulseTrain, TriggerPulse
from sim_backend.digitizer.boards import IMPEDANCE_50_OHM
from sim_backend.settings import Instruments, SimulationSettings, TriggerFaults
from sim_backend.settings.instruments import StampJump
from sim_backend.world import World

WIRING = [
    ("master.output", "tracking_train.trigger", 5e-9),
    ("tracking_train.output", "digitizer.trigger", 5e-9),
    ("digitizer.aux", "tracking_pulser.trigger", 5e-9),
]
RATE_HZ = 5e3
CAPTURE = Capture(
    sample_rate_hz=100e6,
    record_samples=256,
    trigger_delay_samples=9000,
    record_count=60,
    input_range_v=0.8,
    trigger_level_v=1.5,
)
# 32 KiB a record: AutoDMA takes 12 of them a buffer, so that 96 come in eight. Each fits the pulse period.
LONG_CAPTURE = dataclasses.replace(CAPTURE, record_samples=16384, trigger_delay_samples=0, record_count=96)
SINGLE_AND_DUAL_PORT = pytest.mark.parametrize("dual", [False, True], ids=["single_port", "dual_port"])


def volts(records: int, samples: int, amplitude_v: float = 0.5) -> np.ndarray:
    record, sample = np.ogrid[:records, :samples]
    return amplitude_v * np.sin(2 * np.pi * (sample / 37.3 + record / 11.1)) + 1e-3 * record


class ClosedForm:
    """Receives ``volts`` whatever was transmitted."""

    def __init__(self, amplitude_v: float = 0.5) -> None:
        self.amplitude_v = amplitude_v

    def record_volts(self, tonebursts, pulses, capture) -> np.ndarray:
        last = capture.first_record + len(capture.first_sample_ps)
        return volts(last, capture.samples, self.amplitude_v)[capture.first_record :]


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


def test_the_driver_satisfies_its_interface(rig: Rig) -> None:
    digitizer: Digitizer = rig.digitizer
    assert digitizer.role == "digitizer"
    assert digitizer.identify().model == "ATS460"


def test_a_with_statement_ends_the_capture_and_frees_its_memory(rig: Rig) -> None:
    with rig.digitizer as digitizer:
        digitizer.configure(CAPTURE)
        digitizer.arm()
        assert rig.library.AlazarBusy(0x460)
        assert (rig.memory.held > 0) == (digitizer.snapshot()["acquisition_mode"] != "single_port")
    assert not rig.library.AlazarBusy(0x460)
    assert rig.memory.held == 0


def test_records_state_the_codes_of_the_board(rig: Rig) -> None:
    rig.fire(CAPTURE)
    assert {block.code_limits for block in rig.digitizer.records(rig.deadline_s())} == {(-8192, 8191)}


# A board's range before it is set could be one of the two.
@pytest.mark.parametrize("input_range_v", [0.8, 2.0])
def test_records_are_the_volts_at_the_input_within_half_a_code(rig: Rig, input_range_v: float) -> None:
    rig.fire(dataclasses.replace(CAPTURE, input_range_v=input_range_v))
    expected = volts(CAPTURE.record_count, CAPTURE.record_samples)
    for block in rig.digitizer.records(rig.deadline_s()):
        read = block.codes * block.volts_per_code + block.volts_offset
        last = block.first_record + len(block.codes)
        # Half a code, and the rounding of sums up to full scale.
        assert np.max(np.abs(read - expected[block.first_record : last])) <= 0.5 * block.volts_per_code * (1 + 1e-9)
        assert block.codes.dtype == np.int16
    assert last == CAPTURE.record_count


def test_single_and_dual_port_captures_give_the_same_records_and_times() -> None:
    single, dual = (Rig(dual).shot(LONG_CAPTURE) for dual in (False, True))
    np.testing.assert_array_equal(single[0], dual[0])
    # Arming takes other calls in the two modes, so the counter starts at another time.
    np.testing.assert_allclose(np.diff(single[1]), np.diff(dual[1]), rtol=0, atol=1e-12)


def test_more_buffers_than_are_in_the_ring_arrive_complete_and_in_order() -> None:
    rig = Rig(dual=True)
    capture = dataclasses.replace(LONG_CAPTURE, record_count=7 * 32)
    rig.fire(capture)
    expected = volts(capture.record_count, capture.record_samples)
    firsts = []
    for block in rig.digitizer.records(rig.deadline_s()):
        firsts.append(block.first_record)
        read = block.codes * block.volts_per_code + block.volts_offset
        np.testing.assert_allclose(read, expected[firsts[-1] :][:28], rtol=0, atol=block.volts_per_code)
    assert firsts == list(range(0, 224, 28))
    assert len(rig.memory.buffers) < len(firsts)


def test_trigger_times_come_at_the_pulse_rate_within_the_counters_step(rig: Rig) -> None:
    times_s = rig.shot(CAPTURE)[1]
    assert np.all(np.abs(np.diff(times_s) - 1 / RATE_HZ) <= 2 / CAPTURE.sample_rate_hz)
    assert 0 < times_s[0] < 1


def test_a_second_shot_starts_its_times_and_records_again(rig: Rig) -> None:
    first, second = rig.shot(CAPTURE), rig.shot(CAPTURE)
    np.testing.assert_array_equal(first[0], second[0])
    assert second[1][0] < 1


@pytest.mark.parametrize("delay", [-128, 0, 1, 9000])
def test_delays_and_pre_triggers_give_the_same_records_in_both_captures(delay: int) -> None:
    capture = dataclasses.replace(CAPTURE, trigger_delay_samples=delay)
    single, dual = (Rig(dual).shot(capture) for dual in (False, True))
    np.testing.assert_array_equal(single[0], dual[0])


@SINGLE_AND_DUAL_PORT
@pytest.mark.parametrize(("amplitude_v", "clipped"), [(0.5, False), (1.2, True)])
def test_an_input_beyond_its_range_is_reported(dual: bool, amplitude_v: float, clipped: bool) -> None:
    rig = Rig(dual, amplitude_v)
    rig.shot(CAPTURE)
    assert rig.digitizer.clipped() is clipped
    # It is a state, and no setting.
    assert "clipped" not in rig.digitizer.snapshot()
    rig.digitizer.arm()
    assert rig.digitizer.clipped() is False
    rig.digitizer.make_safe()


def test_missing_triggers_end_at_the_deadline_and_not_later(rig: Rig) -> None:
    rig.fire(LONG_CAPTURE, pulses=70)
    deadline_s = rig.deadline_s(0.5)
    blocks = []
    with pytest.raises(DeadlineError) as caught:
        blocks.extend(rig.digitizer.records(deadline_s))
    arrived = sum(len(block.codes) for block in blocks)
    assert arrived == 70
    assert "70 of 96" in str(caught.value)
    # Waits are whole milliseconds; two software triggers complete the sixth buffer of 12.
    assert deadline_s <= rig.world.clock.now_s() <= deadline_s + 2e-3
    assert not rig.world.board.running


@pytest.mark.parametrize("answer", [513, 512])
def test_records_of_whole_buffers_survive_a_board_without_software_triggers(answer: int) -> None:
    rig = Rig(dual=True, answers={"AlazarForceTrigger": answer})
    rig.fire(LONG_CAPTURE, pulses=70)
    blocks = []
    with pytest.raises(DeadlineError, match=r"60 of 96 .*70 captured"):
        blocks.extend(rig.digitizer.records(rig.deadline_s(0.5)))
    assert sum(len(block.codes) for block in blocks) == 60
    assert not rig.world.board.running


def test_software_triggers_are_sent_only_for_a_part_filled_buffer() -> None:
    rig = Rig(dual=True)
    rig.fire(LONG_CAPTURE, pulses=72)
    with pytest.raises(DeadlineError, match="72 of 96"):
        list(rig.digitizer.records(rig.deadline_s(0.5)))
    assert "AlazarForceTrigger" not in rig.library.calls


@pytest.mark.parametrize(
    ("faults", "periods"),
    [
        (TriggerFaults(), range(32)),
        (TriggerFaults(lost=(0, 5)), [1, 2, 3, 4, *range(6, 32)]),
        (TriggerFaults(stray_s=(-0.5 / RATE_HZ, 2.5 / RATE_HZ)), [-0.5, 0, 1, 2, 2.5, *range(3, 30)]),
        (TriggerFaults(stamp_jumps=(StampJump(record=20, jump_s=0.25),)), [*range(20), *(np.arange(20, 32) + 1250)]),
        (TriggerFaults(frozen_stamps=(3, 30)), [0, 1, 2, *[3] * 28, 31]),
    ],
    ids=["none", "lost", "stray", "jump", "freeze"],
)
@SINGLE_AND_DUAL_PORT
def test_faults_of_the_twins_triggers_reach_the_records(dual: bool, faults: TriggerFaults, periods: Sequence) -> None:
    rig = Rig(dual, trigger_faults=faults)
    rig.fire(dataclasses.replace(CAPTURE, record_count=32))
    times_s: list[float] = []
    with contextlib.suppress(DeadlineError):
        for block in rig.digitizer.records(rig.deadline_s()):
            times_s.extend(block.trigger_time_s)
    relative_s = np.array(times_s) - times_s[0]
    np.testing.assert_allclose(relative_s, (np.array(periods) - periods[0]) / RATE_HZ, rtol=0, atol=41e-9)


def test_a_board_that_does_not_report_its_counter_is_timed_by_its_model() -> None:
    rig = Rig(dual=True)
    rig.fire(CAPTURE)
    rig.library.answers["AlazarGetParameter"] = UNSUPPORTED_FUNCTION
    times_s = np.concatenate([block.trigger_time_s for block in rig.digitizer.records(rig.deadline_s())])
    np.testing.assert_allclose(np.diff(times_s), 1 / RATE_HZ, rtol=0, atol=41e-9)


@pytest.mark.parametrize("records", [(200, 100), (100, 100), (-1, 5)])
def test_a_freeze_of_the_twins_counter_that_does_nothing_is_refused(records: tuple[int, int]) -> None:
    with pytest.raises(ValueError, match="the first record must be at least 0 and before the last"):
        TriggerFaults(frozen_stamps=records)


def test_a_step_back_of_the_counter_below_zero_keeps_its_sign() -> None:
    rig = Rig(dual=True, trigger_faults=TriggerFaults(stamp_jumps=(StampJump(record=20, jump_s=-100.0),)))
    times_s = rig.shot(CAPTURE)[1]
    assert times_s[20] - times_s[19] == pytest.approx(1 / RATE_HZ - 100.0, abs=41e-9)


def test_the_twins_counter_wraps_at_its_width() -> None:
    rig = Rig(dual=True, trigger_faults=TriggerFaults(stamp_bits=16))
    times_s = rig.shot(CAPTURE)[1]
    wrap_s = 2**16 * 2 / CAPTURE.sample_rate_hz
    assert np.all(times_s < wrap_s)
    step_s = np.diff(times_s)
    np.testing.assert_allclose(step_s % wrap_s, 1 / RATE_HZ % wrap_s, rtol=0, atol=41e-9)
    assert np.any(step_s < 0)


def test_records_from_before_the_deadline_reach_a_slow_reader(rig: Rig) -> None:
    rig.fire(CAPTURE)
    rig.world.clock.sleep(5.0)
    assert sum(len(block.codes) for block in rig.digitizer.records(rig.deadline_s(-1.0))) == CAPTURE.record_count


def test_the_board_is_idle_and_the_memory_free_after_success(rig: Rig) -> None:
    rig.shot(CAPTURE)
    assert rig.memory.buffers
    assert rig.memory.held == 0
    assert not rig.library.AlazarBusy(0x460)


def test_the_board_is_idle_and_the_memory_free_when_the_reader_fails(rig: Rig) -> None:
    rig.fire(LONG_CAPTURE)
    blocks = rig.digitizer.records(rig.deadline_s())
    next(blocks)
    with pytest.raises(ZeroDivisionError):
        blocks.throw(ZeroDivisionError())
    assert rig.memory.held == 0
    assert not rig.library.AlazarBusy(0x460)


def test_make_safe_between_two_blocks_ends_the_capture_and_frees_the_memory() -> None:
    rig = Rig(dual=True)
    rig.fire(LONG_CAPTURE)
    blocks = rig.digitizer.records(rig.deadline_s())
    next(blocks)
    rig.digitizer.make_safe()
    assert rig.memory.held == 0
    assert not rig.world.board.running
    with pytest.raises(InstrumentError, match="aborted"):
        next(blocks)


@pytest.mark.parametrize("end", [AlazarDigitizer.make_safe, AlazarDigitizer.prove_off])
def test_a_capture_that_was_not_read_is_ended(rig: Rig, end: Callable[[AlazarDigitizer], str]) -> None:
    rig.digitizer.configure(CAPTURE)
    rig.digitizer.arm()
    assert rig.world.board.running
    end(rig.digitizer)
    assert not rig.world.board.running
    assert rig.memory.held == 0
    with pytest.raises(InstrumentError, match="before arm"):
        rig.digitizer.records(rig.deadline_s())


def test_make_safe_works_without_configure_and_on_a_capture_of_another_program(rig: Rig) -> None:
    rig.digitizer.make_safe()
    handle = rig.library.AlazarGetBoardBySystemID(1, 1)
    assert rig.library.AlazarSetRecordSize(handle, 0, 256) == 512
    assert rig.library.AlazarStartCapture(handle) == 512
    rig.digitizer.make_safe()
    assert not rig.world.board.running


@pytest.mark.parametrize("failing", ["AlazarBeforeAsyncRead", "AlazarPostAsyncBuffer", "AlazarStartCapture"])
def test_a_failure_while_arming_aborts_and_frees(failing: str) -> None:
    rig = Rig(dual=True, answers={failing: 553})
    rig.digitizer.configure(CAPTURE)
    with pytest.raises(InstrumentError, match=rf"{failing} returned 553 \(ApiInsufficientResources\)"):
        rig.digitizer.arm()
    assert rig.library.calls[-1] == "AlazarAbortAsyncRead"
    assert rig.memory.held == 0


def test_an_interrupt_in_a_wait_aborts_and_frees() -> None:
    def interrupt() -> int:
        raise KeyboardInterrupt

    rig = Rig(dual=True, answers={"AlazarWaitAsyncBufferComplete": interrupt})
    rig.fire(CAPTURE)
    with pytest.raises(KeyboardInterrupt):
        list(rig.digitizer.records(rig.deadline_s()))
    assert rig.memory.held == 0
    assert not rig.world.board.running


def test_memory_is_kept_until_the_abort_succeeds() -> None:
    rig = Rig(dual=True, answers={"AlazarAbortAsyncRead": 571})
    rig.digitizer.configure(CAPTURE)
    rig.digitizer.arm()
    with pytest.raises(InstrumentError, match="AlazarAbortAsyncRead returned 571"):
        rig.digitizer.make_safe()
    assert rig.memory.held > 0
    rig.library.answers.clear()
    rig.digitizer.make_safe()
    assert rig.memory.held == 0


def test_memory_of_a_failed_abort_outlives_the_driver() -> None:
    rig = Rig(dual=True, answers={"AlazarAbortAsyncRead": 571})
    rig.digitizer.configure(CAPTURE)
    rig.digitizer.arm()
    with pytest.raises(InstrumentError):
        rig.digitizer.close()
    buffers = [weakref.ref(buffer) for buffer in rig.memory.buffers]
    del rig
    gc.collect()
    assert buffers
    for buffer in buffers:
        assert buffer() is not None
        # As by the board; writing to freed memory would end the process.
        ctypes.memset(buffer().address, 0xEE, buffer().size_bytes)


def test_memory_of_a_finished_capture_does_not_outlive_the_driver() -> None:
    rig = Rig(dual=True)
    rig.shot(CAPTURE)
    buffers = [weakref.ref(buffer) for buffer in rig.memory.buffers]
    del rig
    gc.collect()
    assert all(buffer() is None for buffer in buffers)


def test_an_overflow_is_an_error_with_its_cause() -> None:
    rig = Rig(dual=True, answers={"AlazarWaitAsyncBufferComplete": 582})
    rig.fire(CAPTURE)
    with pytest.raises(InstrumentError, match=r"582 \(ApiBufferOverflow\).*faster than they were read"):
        list(rig.digitizer.records(rig.deadline_s()))
    assert rig.memory.held == 0


def test_buffers_are_posted_before_the_capture_starts_and_the_abort_comes_last() -> None:
    rig = Rig(dual=True)
    rig.shot(LONG_CAPTURE)
    calls = rig.library.calls
    begin_call, start_call = calls.index("AlazarBeforeAsyncRead"), calls.index("AlazarStartCapture")
    assert calls[begin_call:start_call].count("AlazarPostAsyncBuffer") >= 2
    assert calls.index("AlazarSetRecordSize") < begin_call
    assert calls[-1] == "AlazarAbortAsyncRead"


def test_a_board_without_dual_port_memory_gets_no_autodma_calls() -> None:
    rig = Rig(dual=False)
    rig.shot(CAPTURE)
    assert not any("Async" in call for call in rig.library.calls)


def test_invalid_captures_are_refused_before_anything_is_sent(rig: Rig) -> None:
    rig.library.calls.clear()
    with pytest.raises(InstrumentError) as caught:
        rig.digitizer.configure(dataclasses.replace(CAPTURE, record_samples=250, input_range_v=3.0))
    assert "record_samples = 250" in str(caught.value)
    assert "input_range_v = 3" in str(caught.value)
    assert all(call == "AlazarQueryCapability" for call in rig.library.calls)


def test_more_records_than_the_memory_holds_are_refused_with_both_numbers() -> None:
    rig = Rig(dual=False, samples_per_channel=16384)
    with pytest.raises(InstrumentError, match=r"record_count = 100 of 256 samples, the memory holds 60"):
        rig.digitizer.configure(dataclasses.replace(CAPTURE, record_count=100))


def test_an_old_fpga_holds_a_thousand_records_in_single_port_mode() -> None:
    rig = Rig(dual=False, fpga_version=18)
    rig.digitizer.configure(dataclasses.replace(CAPTURE, record_count=1000))
    with pytest.raises(InstrumentError, match=r"1001.*1000"):
        rig.digitizer.configure(dataclasses.replace(CAPTURE, record_count=1001))


def test_a_changed_data_format_is_found_by_verify(rig: Rig) -> None:
    rig.digitizer.configure(CAPTURE)
    rig.digitizer.verify()
    handle = rig.library.AlazarGetBoardBySystemID(1, 1)
    assert rig.library.AlazarSetParameter(handle, 1, 0x10000041, 1) == 512
    with pytest.raises(InstrumentError, match="data format expected 0, the board reports 1"):
        rig.digitizer.verify()


def test_a_capture_started_by_another_program_is_found_by_verify(rig: Rig) -> None:
    rig.digitizer.configure(CAPTURE)
    assert rig.library.AlazarStartCapture(rig.library.AlazarGetBoardBySystemID(1, 1)) == 512
    with pytest.raises(InstrumentError, match="capture running expected 0, the board reports 1"):
        rig.digitizer.verify()
    rig.digitizer.make_safe()


def test_a_state_that_the_board_does_not_report_is_not_compared() -> None:
    rig = Rig(dual=True, answers={"AlazarGetParameter": 533})
    rig.digitizer.configure(CAPTURE)
    rig.digitizer.verify()


def test_steps_out_of_order_are_refused(rig: Rig) -> None:
    for step in (rig.digitizer.verify, rig.digitizer.arm, lambda: rig.digitizer.records(1.0)):
        with pytest.raises(InstrumentError, match="before configure"):
            step()
    rig.digitizer.configure(CAPTURE)
    with pytest.raises(InstrumentError, match="before arm"):
        rig.digitizer.records(1.0)


def test_the_trigger_output_is_programmed_after_another_programs_use(rig: Rig) -> None:
    level_output = 14
    rig.library.AlazarConfigureAuxIO(rig.library.AlazarGetBoardBySystemID(1, 1), level_output, 0)
    rig.shot(CAPTURE)
    assert rig.world.board.settings.aux_mode == 0


def test_the_trigger_range_of_the_model_is_sent_to_the_board(rig: Rig) -> None:
    model = dataclasses.replace(ATS460_BOARD, trigger_range_v=1.0)
    digitizer = AlazarDigitizer(AlazarBoard(rig.library, model=model), rig.world.clock)
    digitizer.configure(dataclasses.replace(CAPTURE, trigger_level_v=0.5))
    settings = rig.world.board.settings
    assert settings.external_range_v == 1.0
    # 0.5 V is half of the range: code 128 + 63.5, truncated.
    assert settings.engines[0].level_code == 191


def test_an_absent_board_is_named_by_its_ids() -> None:
    rig = Rig(dual=True)
    with pytest.raises(InstrumentError, match="system_id 1 and board_id 2"):
        AlazarBoard(rig.library, board_id=2)


def test_another_kind_of_board_is_refused() -> None:
    rig = Rig(dual=True)
    with pytest.raises(InstrumentError, match=r"kind 13 \(ATS9870\), expected 7 \(ATS460\)"):
        AlazarBoard(Spy(rig.library, {"AlazarGetBoardKind": 13}))


def test_the_snapshot_holds_what_was_programmed_and_what_the_board_reports(rig: Rig) -> None:
    before = rig.digitizer.snapshot()
    assert before["bits_per_sample"] == 14
    assert "record_count" not in before
    rig.digitizer.configure(CAPTURE)
    after = rig.digitizer.snapshot()
    assert rig.digitizer.verify() == after
    programmed = {key: value for key, value in dataclasses.asdict(CAPTURE).items() if value is not None}
    assert programmed.items() <= after.items()
    assert after["trigger_level_code"] == 166
    assert after["input_impedance_ohm"] == 50.0
    assert {channel.impedance for channel in rig.world.board.settings.inputs[:2]} == {IMPEDANCE_50_OHM}
    assert after["acquisition_mode"] == ("traditional" if after["dual_port_memory"] else "single_port")


@pytest.mark.parametrize("mode", ["single_port", "traditional", "npt"])
@pytest.mark.parametrize("monitor_range_v", [pytest.param(None, marks=pytest.mark.slow), 0.2])
def test_every_mode_with_one_channel_or_two_gives_the_same_echoes(mode: str, monitor_range_v: float | None) -> None:
    expected, _ = Rig(dual=False).shot(LONG_CAPTURE)
    rig = Rig(dual=True)
    rig.digitizer = AlazarDigitizer(AlazarBoard(rig.library), rig.world.clock, allocate=rig.memory, mode=mode)
    rig.fire(dataclasses.replace(LONG_CAPTURE, monitor_range_v=monitor_range_v))
    blocks = list(rig.digitizer.records(rig.deadline_s()))
    np.testing.assert_array_equal(np.concatenate([block.codes for block in blocks]), expected)
    assert rig.digitizer.snapshot()["acquisition_mode"] == mode
    # NPT records carry no header, so no trigger time.
    assert all(np.isnan(block.trigger_time_s).all() == (mode == "npt") for block in blocks)
    for block in blocks:
        if monitor_range_v is None:
            assert block.monitor is None
        else:
            # Nothing is connected to channel B of the twin: zero volts, which lies between two codes.
            silence = block.monitor.codes * block.monitor.volts_per_code + block.monitor.volts_offset
            assert np.max(np.abs(silence)) <= 0.5 * block.monitor.volts_per_code * (1 + 1e-9)
    assert rig.memory.held == 0


def test_autodma_without_dual_port_memory_is_refused_with_the_remedy() -> None:
    rig = Rig(dual=False)
    digitizer = AlazarDigitizer(AlazarBoard(rig.library), rig.world.clock, mode="npt")
    with pytest.raises(InstrumentError, match=r'npt needs dual-port memory.*"single_port"'):
        digitizer.configure(CAPTURE)


def test_a_board_stops_even_if_its_memory_cannot_be_freed() -> None:
    rig = Rig(dual=True, answers={"AlazarAbortAsyncRead": 571})
    rig.digitizer.configure(CAPTURE)
    rig.digitizer.arm()
    with pytest.raises(InstrumentError, match="AlazarAbortAsyncRead returned 571"):
        rig.digitizer.make_safe()
    assert not rig.world.board.running
    rig.library.answers.clear()
    rig.digitizer.make_safe()


@pytest.mark.parametrize(("major", "name"), [(5, "ApiTooManyRecords"), (7, "ApiNetworkError")])
def test_a_code_that_changed_its_meaning_is_read_by_the_installed_sdks_version(major: int, name: str) -> None:
    rig = Rig(dual=True, answers={"AlazarStartCapture": 607})

    def version(*parts) -> int:
        for part, value in zip(parts, (major, 2, 0), strict=True):
            part._obj.value = value
        return 512

    rig.library.AlazarGetSDKVersion = version
    rig.digitizer = AlazarDigitizer(AlazarBoard(rig.library), rig.world.clock)
    rig.digitizer.configure(CAPTURE)
    with pytest.raises(InstrumentError, match=rf"AlazarStartCapture returned 607 \({name}\)"):
        rig.digitizer.arm()


def through_c(library) -> SimpleNamespace:
    """Return the functions behind C function pointers: every argument passes through the C calling convention."""
    table = {}
    for name, (result, arguments) in SIGNATURES.items():
        table[name] = ctypes.CFUNCTYPE(result, *arguments)(getattr(library, name))
        table[name].__name__ = name
    return SimpleNamespace(**table)


@SINGLE_AND_DUAL_PORT
def test_through_the_c_calling_convention_the_records_are_the_same(dual: bool) -> None:
    direct, in_c = Rig(dual), Rig(dual)
    in_c.digitizer = AlazarDigitizer(AlazarBoard(through_c(in_c.library)), in_c.world.clock)
    for expected, read in zip(direct.shot(CAPTURE), in_c.shot(CAPTURE), strict=True):
        np.testing.assert_array_equal(expected, read)
    assert {**in_c.digitizer.snapshot()} == {**direct.digitizer.snapshot()}
