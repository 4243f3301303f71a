"""The digitizer driver on the simulated board: ends, memory, failures, refused settings and changed states."""

from __future__ import annotations

import ctypes
import dataclasses
import gc
import weakref
from collections.abc import Callable

import pytest

from drivers.alazar.board import AlazarBoard
from drivers.alazar.digitizer import AlazarDigitizer
from drivers.alazar.models import ATS460_BOARD
from drivers.interfaces import Capture, InstrumentError
from sim_backend.digitizer.boards import IMPEDANCE_50_OHM

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


def test_the_board_is_idle_and_the_memory_free_after_success(rig) -> None:
    rig.shot(CAPTURE)
    assert rig.memory.buffers
    assert rig.memory.held == 0
    assert not rig.library.AlazarBusy(0x460)


def test_the_board_is_idle_and_the_memory_free_when_the_reader_fails(rig) -> None:
    rig.fire(LONG_CAPTURE)
    blocks = rig.digitizer.records(rig.deadline_s())
    next(blocks)
    with pytest.raises(ZeroDivisionError):
        blocks.throw(ZeroDivisionError())
    assert rig.memory.held == 0
    assert not rig.library.AlazarBusy(0x460)


def test_make_safe_between_two_blocks_ends_the_capture_and_frees_the_memory(make_rig) -> None:
    rig = make_rig(dual=True)
    rig.fire(LONG_CAPTURE)
    blocks = rig.digitizer.records(rig.deadline_s())
    next(blocks)
    rig.digitizer.make_safe()
    assert rig.memory.held == 0
    assert not rig.world.board.running
    with pytest.raises(InstrumentError, match="aborted"):
        next(blocks)


@pytest.mark.parametrize("end", [AlazarDigitizer.make_safe, AlazarDigitizer.prove_off])
def test_a_capture_that_was_not_read_is_ended(rig, end: Callable[[AlazarDigitizer], str]) -> None:
    rig.digitizer.configure(CAPTURE)
    rig.digitizer.arm()
    assert rig.world.board.running
    end(rig.digitizer)
    assert not rig.world.board.running
    assert rig.memory.held == 0
    with pytest.raises(InstrumentError, match="before arm"):
        rig.digitizer.records(rig.deadline_s())


def test_make_safe_works_without_configure_and_on_a_capture_of_another_program(rig) -> None:
    rig.digitizer.make_safe()
    handle = rig.library.AlazarGetBoardBySystemID(1, 1)
    assert rig.library.AlazarSetRecordSize(handle, 0, 256) == 512
    assert rig.library.AlazarStartCapture(handle) == 512
    rig.digitizer.make_safe()
    assert not rig.world.board.running


@pytest.mark.parametrize("failing", ["AlazarBeforeAsyncRead", "AlazarPostAsyncBuffer", "AlazarStartCapture"])
def test_a_failure_while_arming_aborts_and_frees(make_rig, failing: str) -> None:
    rig = make_rig(dual=True, answers={failing: 553})
    rig.digitizer.configure(CAPTURE)
    with pytest.raises(InstrumentError, match=rf"{failing} returned 553 \(ApiInsufficientResources\)"):
        rig.digitizer.arm()
    assert rig.library.calls[-1] == "AlazarAbortAsyncRead"
    assert rig.memory.held == 0


def test_an_interrupt_in_a_wait_aborts_and_frees(make_rig) -> None:
    def interrupt() -> int:
        raise KeyboardInterrupt

    rig = make_rig(dual=True, answers={"AlazarWaitAsyncBufferComplete": interrupt})
    rig.fire(CAPTURE)
    with pytest.raises(KeyboardInterrupt):
        list(rig.digitizer.records(rig.deadline_s()))
    assert rig.memory.held == 0
    assert not rig.world.board.running


def test_memory_is_kept_until_the_abort_succeeds(make_rig) -> None:
    rig = make_rig(dual=True, answers={"AlazarAbortAsyncRead": 571})
    rig.digitizer.configure(CAPTURE)
    rig.digitizer.arm()
    with pytest.raises(InstrumentError, match="AlazarAbortAsyncRead returned 571"):
        rig.digitizer.make_safe()
    assert rig.memory.held > 0
    rig.library.answers.clear()
    rig.digitizer.make_safe()
    assert rig.memory.held == 0


def test_memory_of_a_failed_abort_outlives_the_driver(make_rig) -> None:
    rig = make_rig(dual=True, answers={"AlazarAbortAsyncRead": 571})
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


def test_memory_of_a_finished_capture_does_not_outlive_the_driver(make_rig) -> None:
    rig = make_rig(dual=True)
    rig.shot(CAPTURE)
    buffers = [weakref.ref(buffer) for buffer in rig.memory.buffers]
    del rig
    gc.collect()
    assert all(buffer() is None for buffer in buffers)


def test_an_overflow_is_an_error_with_its_cause(make_rig) -> None:
    rig = make_rig(dual=True, answers={"AlazarWaitAsyncBufferComplete": 582})
    rig.fire(CAPTURE)
    with pytest.raises(InstrumentError, match=r"582 \(ApiBufferOverflow\).*faster than they were read"):
        list(rig.digitizer.records(rig.deadline_s()))
    assert rig.memory.held == 0


def test_buffers_are_posted_before_the_capture_starts_and_the_abort_comes_last(make_rig) -> None:
    rig = make_rig(dual=True)
    rig.shot(LONG_CAPTURE)
    calls = rig.library.calls
    begin_call, start_call = calls.index("AlazarBeforeAsyncRead"), calls.index("AlazarStartCapture")
    assert calls[begin_call:start_call].count("AlazarPostAsyncBuffer") >= 2
    assert calls.index("AlazarSetRecordSize") < begin_call
    assert calls[-1] == "AlazarAbortAsyncRead"


def test_a_board_without_dual_port_memory_gets_no_autodma_calls(make_rig) -> None:
    rig = make_rig(dual=False)
    rig.shot(CAPTURE)
    assert not any("Async" in call for call in rig.library.calls)


def test_invalid_captures_are_refused_before_anything_is_sent(rig) -> None:
    rig.library.calls.clear()
    with pytest.raises(InstrumentError) as caught:
        rig.digitizer.configure(dataclasses.replace(CAPTURE, record_samples=250, input_range_v=3.0))
    assert "record_samples = 250" in str(caught.value)
    assert "input_range_v = 3" in str(caught.value)
    assert all(call == "AlazarQueryCapability" for call in rig.library.calls)


def test_more_records_than_the_memory_holds_are_refused_with_both_numbers(make_rig) -> None:
    rig = make_rig(dual=False, samples_per_channel=16384)
    with pytest.raises(InstrumentError, match=r"record_count = 100 of 256 samples, the memory holds 60"):
        rig.digitizer.configure(dataclasses.replace(CAPTURE, record_count=100))


def test_an_old_fpga_holds_a_thousand_records_in_single_port_mode(make_rig) -> None:
    rig = make_rig(dual=False, fpga_version=18)
    rig.digitizer.configure(dataclasses.replace(CAPTURE, record_count=1000))
    with pytest.raises(InstrumentError, match=r"1001.*1000"):
        rig.digitizer.configure(dataclasses.replace(CAPTURE, record_count=1001))


def test_a_changed_data_format_is_found_by_verify(rig) -> None:
    rig.digitizer.configure(CAPTURE)
    rig.digitizer.verify()
    handle = rig.library.AlazarGetBoardBySystemID(1, 1)
    assert rig.library.AlazarSetParameter(handle, 1, 0x10000041, 1) == 512
    with pytest.raises(InstrumentError, match="data format expected 0, the board reports 1"):
        rig.digitizer.verify()


def test_a_capture_started_by_another_program_is_found_by_verify(rig) -> None:
    rig.digitizer.configure(CAPTURE)
    assert rig.library.AlazarStartCapture(rig.library.AlazarGetBoardBySystemID(1, 1)) == 512
    with pytest.raises(InstrumentError, match="capture running expected 0, the board reports 1"):
        rig.digitizer.verify()
    rig.digitizer.make_safe()


def test_a_state_that_the_board_does_not_report_is_not_compared(make_rig) -> None:
    rig = make_rig(dual=True, answers={"AlazarGetParameter": 533})
    rig.digitizer.configure(CAPTURE)
    rig.digitizer.verify()


def test_steps_out_of_order_are_refused(rig) -> None:
    for step in (rig.digitizer.verify, rig.digitizer.arm, lambda: rig.digitizer.records(1.0)):
        with pytest.raises(InstrumentError, match="before configure"):
            step()
    rig.digitizer.configure(CAPTURE)
    with pytest.raises(InstrumentError, match="before arm"):
        rig.digitizer.records(1.0)


def test_the_trigger_output_is_programmed_after_another_programs_use(rig) -> None:
    level_output = 14
    rig.library.AlazarConfigureAuxIO(rig.library.AlazarGetBoardBySystemID(1, 1), level_output, 0)
    rig.shot(CAPTURE)
    assert rig.world.board.settings.aux_mode == 0


def test_the_trigger_range_of_the_model_is_sent_to_the_board(rig) -> None:
    model = dataclasses.replace(ATS460_BOARD, trigger_range_v=1.0)
    digitizer = AlazarDigitizer(AlazarBoard(rig.library, model=model), rig.world.clock)
    digitizer.configure(dataclasses.replace(CAPTURE, trigger_level_v=0.5))
    settings = rig.world.board.settings
    assert settings.external_range_v == 1.0
    # 0.5 V is half of the range: code 128 + 63.5, truncated.
    assert settings.engines[0].level_code == 191


def test_an_absent_board_is_named_by_its_ids(make_rig) -> None:
    rig = make_rig(dual=True)
    with pytest.raises(InstrumentError, match="system_id 1 and board_id 2"):
        AlazarBoard(rig.library, board_id=2)


def test_another_kind_of_board_is_refused(make_rig) -> None:
    rig = make_rig(dual=True)
    with pytest.raises(InstrumentError, match=r"kind 13 \(ATS9870\), expected 7 \(ATS460\)"):
        AlazarBoard(type(rig.library)(rig.library, {"AlazarGetBoardKind": 13}))


def test_the_snapshot_holds_what_was_programmed_and_what_the_board_reports(rig) -> None:
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


def test_autodma_without_dual_port_memory_is_refused_with_the_remedy(make_rig) -> None:
    rig = make_rig(dual=False)
    digitizer = AlazarDigitizer(AlazarBoard(rig.library), rig.world.clock, mode="npt")
    with pytest.raises(InstrumentError, match=r'npt needs dual-port memory.*"single_port"'):
        digitizer.configure(CAPTURE)


def test_a_board_stops_even_if_its_memory_cannot_be_freed(make_rig) -> None:
    rig = make_rig(dual=True, answers={"AlazarAbortAsyncRead": 571})
    rig.digitizer.configure(CAPTURE)
    rig.digitizer.arm()
    with pytest.raises(InstrumentError, match="AlazarAbortAsyncRead returned 571"):
        rig.digitizer.make_safe()
    assert not rig.world.board.running
    rig.library.answers.clear()
    rig.digitizer.make_safe()


@pytest.mark.parametrize(("major", "name"), [(5, "ApiTooManyRecords"), (7, "ApiNetworkError")])
def test_a_code_that_changed_its_meaning_is_read_by_the_installed_sdks_version(make_rig, major: int, name: str) -> None:
    rig = make_rig(dual=True, answers={"AlazarStartCapture": 607})

    def version(*parts) -> int:
        for part, value in zip(parts, (major, 2, 0), strict=True):
            part._obj.value = value
        return 512

    rig.library.AlazarGetSDKVersion = version
    rig.digitizer = AlazarDigitizer(AlazarBoard(rig.library), rig.world.clock)
    rig.digitizer.configure(CAPTURE)
    with pytest.raises(InstrumentError, match=rf"AlazarStartCapture returned 607 \({name}\)"):
        rig.digitizer.arm()
