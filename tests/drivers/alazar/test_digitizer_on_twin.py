"""Records of the digitizer driver on the simulated board and trigger chain, in both capture modes."""

from __future__ import annotations

import contextlib
import ctypes
import dataclasses
from collections.abc import Sequence
from types import SimpleNamespace

import numpy as np
import pytest

from drivers.alazar.api import SIGNATURES
from drivers.alazar.board import AlazarBoard
from drivers.alazar.digitizer import AlazarDigitizer
from drivers.alazar.return_codes import UNSUPPORTED_FUNCTION
from drivers.interfaces import Capture, DeadlineError, Digitizer
from sim_backend.settings import TriggerFaults
from sim_backend.settings.instruments import StampJump

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


def test_the_driver_satisfies_its_interface(rig) -> None:
    digitizer: Digitizer = rig.digitizer
    assert digitizer.role == "digitizer"
    assert digitizer.identify().model == "ATS460"


def test_a_with_statement_ends_the_capture_and_frees_its_memory(rig) -> None:
    with rig.digitizer as digitizer:
        digitizer.configure(CAPTURE)
        digitizer.arm()
        assert rig.library.AlazarBusy(0x460)
        assert (rig.memory.held > 0) == (digitizer.snapshot()["acquisition_mode"] != "single_port")
    assert not rig.library.AlazarBusy(0x460)
    assert rig.memory.held == 0


def test_records_state_the_codes_of_the_board(rig) -> None:
    rig.fire(CAPTURE)
    assert {block.code_limits for block in rig.digitizer.records(rig.deadline_s())} == {(-8192, 8191)}


# A board's range before it is set could be one of the two.
@pytest.mark.parametrize("input_range_v", [0.8, 2.0])
def test_records_are_the_volts_at_the_input_within_half_a_code(volts, rig, input_range_v: float) -> None:
    rig.fire(dataclasses.replace(CAPTURE, input_range_v=input_range_v))
    expected = volts(CAPTURE.record_count, CAPTURE.record_samples)
    for block in rig.digitizer.records(rig.deadline_s()):
        read = block.codes * block.volts_per_code + block.volts_offset
        last = block.first_record + len(block.codes)
        # Half a code, and the rounding of sums up to full scale.
        assert np.max(np.abs(read - expected[block.first_record : last])) <= 0.5 * block.volts_per_code * (1 + 1e-9)
        assert block.codes.dtype == np.int16
    assert last == CAPTURE.record_count


def test_single_and_dual_port_captures_give_the_same_records_and_times(make_rig) -> None:
    single, dual = (make_rig(dual).shot(LONG_CAPTURE) for dual in (False, True))
    np.testing.assert_array_equal(single[0], dual[0])
    # Arming takes other calls in the two modes, so the counter starts at another time.
    np.testing.assert_allclose(np.diff(single[1]), np.diff(dual[1]), rtol=0, atol=1e-12)


def test_more_buffers_than_are_in_the_ring_arrive_complete_and_in_order(make_rig, volts) -> None:
    rig = make_rig(dual=True)
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


def test_trigger_times_come_at_the_pulse_rate_within_the_counters_step(rig) -> None:
    times_s = rig.shot(CAPTURE)[1]
    assert np.all(np.abs(np.diff(times_s) - 1 / RATE_HZ) <= 2 / CAPTURE.sample_rate_hz)
    assert 0 < times_s[0] < 1


def test_a_second_shot_starts_its_times_and_records_again(rig) -> None:
    first, second = rig.shot(CAPTURE), rig.shot(CAPTURE)
    np.testing.assert_array_equal(first[0], second[0])
    assert second[1][0] < 1


@pytest.mark.parametrize("delay", [-128, 0, 1, 9000])
def test_delays_and_pre_triggers_give_the_same_records_in_both_captures(make_rig, delay: int) -> None:
    capture = dataclasses.replace(CAPTURE, trigger_delay_samples=delay)
    single, dual = (make_rig(dual).shot(capture) for dual in (False, True))
    np.testing.assert_array_equal(single[0], dual[0])


@SINGLE_AND_DUAL_PORT
@pytest.mark.parametrize(("amplitude_v", "clipped"), [(0.5, False), (1.2, True)])
def test_an_input_beyond_its_range_is_reported(make_rig, dual: bool, amplitude_v: float, clipped: bool) -> None:
    rig = make_rig(dual, amplitude_v)
    rig.shot(CAPTURE)
    assert rig.digitizer.clipped() is clipped
    # It is a state, and no setting.
    assert "clipped" not in rig.digitizer.snapshot()
    rig.digitizer.arm()
    assert rig.digitizer.clipped() is False
    rig.digitizer.make_safe()


def test_missing_triggers_end_at_the_deadline_and_not_later(rig) -> None:
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
def test_records_of_whole_buffers_survive_a_board_without_software_triggers(make_rig, answer: int) -> None:
    rig = make_rig(dual=True, answers={"AlazarForceTrigger": answer})
    rig.fire(LONG_CAPTURE, pulses=70)
    blocks = []
    with pytest.raises(DeadlineError, match=r"60 of 96 .*70 captured"):
        blocks.extend(rig.digitizer.records(rig.deadline_s(0.5)))
    assert sum(len(block.codes) for block in blocks) == 60
    assert not rig.world.board.running


def test_software_triggers_are_sent_only_for_a_part_filled_buffer(make_rig) -> None:
    rig = make_rig(dual=True)
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
def test_faults_of_the_twins_triggers_reach_the_records(
    make_rig, dual: bool, faults: TriggerFaults, periods: Sequence
) -> None:
    rig = make_rig(dual, trigger_faults=faults)
    rig.fire(dataclasses.replace(CAPTURE, record_count=32))
    times_s: list[float] = []
    with contextlib.suppress(DeadlineError):
        for block in rig.digitizer.records(rig.deadline_s()):
            times_s.extend(block.trigger_time_s)
    relative_s = np.array(times_s) - times_s[0]
    np.testing.assert_allclose(relative_s, (np.array(periods) - periods[0]) / RATE_HZ, rtol=0, atol=41e-9)


def test_a_board_that_does_not_report_its_counter_is_timed_by_its_model(make_rig) -> None:
    rig = make_rig(dual=True)
    rig.fire(CAPTURE)
    rig.library.answers["AlazarGetParameter"] = UNSUPPORTED_FUNCTION
    times_s = np.concatenate([block.trigger_time_s for block in rig.digitizer.records(rig.deadline_s())])
    np.testing.assert_allclose(np.diff(times_s), 1 / RATE_HZ, rtol=0, atol=41e-9)


@pytest.mark.parametrize("records", [(200, 100), (100, 100), (-1, 5)])
def test_a_freeze_of_the_twins_counter_that_does_nothing_is_refused(records: tuple[int, int]) -> None:
    with pytest.raises(ValueError, match="the first record must be at least 0 and before the last"):
        TriggerFaults(frozen_stamps=records)


def test_a_step_back_of_the_counter_below_zero_keeps_its_sign(make_rig) -> None:
    rig = make_rig(dual=True, trigger_faults=TriggerFaults(stamp_jumps=(StampJump(record=20, jump_s=-100.0),)))
    times_s = rig.shot(CAPTURE)[1]
    assert times_s[20] - times_s[19] == pytest.approx(1 / RATE_HZ - 100.0, abs=41e-9)


def test_the_twins_counter_wraps_at_its_width(make_rig) -> None:
    rig = make_rig(dual=True, trigger_faults=TriggerFaults(stamp_bits=16))
    times_s = rig.shot(CAPTURE)[1]
    wrap_s = 2**16 * 2 / CAPTURE.sample_rate_hz
    assert np.all(times_s < wrap_s)
    step_s = np.diff(times_s)
    np.testing.assert_allclose(step_s % wrap_s, 1 / RATE_HZ % wrap_s, rtol=0, atol=41e-9)
    assert np.any(step_s < 0)


def test_records_from_before_the_deadline_reach_a_slow_reader(rig) -> None:
    rig.fire(CAPTURE)
    rig.world.clock.sleep(5.0)
    assert sum(len(block.codes) for block in rig.digitizer.records(rig.deadline_s(-1.0))) == CAPTURE.record_count


@pytest.mark.parametrize("mode", ["single_port", "traditional", "npt"])
@pytest.mark.parametrize("monitor_range_v", [pytest.param(None, marks=pytest.mark.slow), 0.2])
def test_every_mode_with_one_channel_or_two_gives_the_same_echoes(
    make_rig, mode: str, monitor_range_v: float | None
) -> None:
    expected, _ = make_rig(dual=False).shot(LONG_CAPTURE)
    rig = make_rig(dual=True)
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


def through_c(library) -> SimpleNamespace:
    """Return the functions behind C function pointers: every argument passes through the C calling convention."""
    table = {}
    for name, (result, arguments) in SIGNATURES.items():
        table[name] = ctypes.CFUNCTYPE(result, *arguments)(getattr(library, name))
        table[name].__name__ = name
    return SimpleNamespace(**table)


@SINGLE_AND_DUAL_PORT
def test_through_the_c_calling_convention_the_records_are_the_same(make_rig, dual: bool) -> None:
    direct, in_c = make_rig(dual), make_rig(dual)
    in_c.digitizer = AlazarDigitizer(AlazarBoard(through_c(in_c.library)), in_c.world.clock)
    for expected, read in zip(direct.shot(CAPTURE), in_c.shot(CAPTURE), strict=True):
        np.testing.assert_array_equal(expected, read)
    assert {**in_c.digitizer.snapshot()} == {**direct.digitizer.snapshot()}
