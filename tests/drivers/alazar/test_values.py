"""Limits, sizes, words and memory of the ATS460 driver; nothing here needs a board."""

from __future__ import annotations

import dataclasses
import mmap

import numpy as np
import pytest
from hypothesis import given, strategies as st

from drivers.alazar.limits import level_code, mistakes, records_per_buffer
from drivers.alazar.models import MODELS, BoardModel
from drivers.alazar.page_buffer import PageBuffer
from drivers.alazar.samples import (
    any_at_full_scale,
    codes,
    header_record_dtype,
    timestamp_counts,
    volts_offset,
    volts_per_code,
    word_dtype,
)
from drivers.interfaces import Capture
from sim_backend.digitizer.boards import BOARDS, HERTZ_BY_ID, IMPEDANCE_50_OHM, MILLIVOLTS_BY_ID

CAPTURE = Capture(
    sample_rate_hz=100e6,
    record_samples=2048,
    trigger_delay_samples=8000,
    record_count=1000,
    input_range_v=0.8,
    trigger_level_v=1.5,
)

# The vendor's numbers for the internal clock's rates, as its header lists them.
RATES = [
    (1e3, 0x01), (2e3, 0x02), (5e3, 0x04), (10e3, 0x08), (20e3, 0x0A), (50e3, 0x0C), (100e3, 0x0E), (200e3, 0x10),
    (500e3, 0x12), (1e6, 0x14), (2e6, 0x18), (5e6, 0x1A), (10e6, 0x1C), (20e6, 0x1E), (50e6, 0x22), (100e6, 0x24),
]  # fmt: skip


@pytest.mark.parametrize(("rate_hz", "number"), RATES)
def test_rates_up_to_100_mhz_have_the_vendors_numbers(rate_hz: float, number: int) -> None:
    assert {model.rate_ids[rate_hz] for model in MODELS if rate_hz in model.sample_rates_hz} == {number}
    assert HERTZ_BY_ID[number] == rate_hz
    assert mistakes(dataclasses.replace(CAPTURE, sample_rate_hz=rate_hz, trigger_delay_samples=0)) == []


@pytest.mark.parametrize("model", MODELS, ids=lambda model: model.name)
def test_the_rows_of_driver_and_twin_agree_for_every_board(model: BoardModel) -> None:
    board = BOARDS[model.name]
    assert (model.kind, model.code_bits, model.sample_bytes) == (board.kind, board.bits, board.bytes_per_sample)
    assert {number: rate_hz for rate_hz, number in model.rate_ids.items()} == board.rates_hz
    ranges_v = {MILLIVOLTS_BY_ID[number] / 1000: number for number in board.ranges[IMPEDANCE_50_OHM]}
    assert model.range_ids == ranges_v
    assert board.trigger_ranges_v[model.trigger_range_id] == model.trigger_range_v
    sizes = (model.record_minimum, model.record_multiple, model.npt_record_multiple, model.pre_trigger_multiple)
    assert sizes == (board.min_record, board.record_multiple, board.npt_multiple, board.pre_trigger_multiple)
    # Coarser than the twin's if the board's multiple is uncertain.
    assert model.trigger_delay_multiple % board.delay_multiple == 0


@pytest.mark.parametrize("model", MODELS, ids=lambda model: model.name)
def test_no_code_of_a_board_is_that_of_a_missing_record(model: BoardModel) -> None:
    lowest, highest = model.code_limits
    assert lowest == max(-(2 ** (model.code_bits - 1)), np.iinfo(np.int16).min + 1)
    assert highest == 2 ** (model.code_bits - 1) - 1


REFUSED = [
    ({"record_samples": 112}, ["record_samples = 112", "128"]),
    ({"record_samples": 2040}, ["record_samples = 2040", "16", "2032", "2048"]),
    ({"sample_rate_hz": 25e6}, ["sample_rate_hz = 25000000", "2e+07", "5e+07"]),
    ({"input_range_v": 8.0}, ["input_range_v = 8", "4"]),
    ({"trigger_delay_samples": 10_000_000}, ["trigger_delay_samples = 10000000", "9999999"]),
    ({"trigger_delay_samples": -100}, ["pre-trigger samples = 100", "64", "128"]),
    ({"trigger_delay_samples": -2048}, ["pre-trigger samples = 2048", "1984"]),
    ({"record_count": 0}, ["record_count = 0", "1"]),
    # The library records without end for this count.
    ({"record_count": 0x7FFF_FFFF}, ["record_count = 2147483647", "2147483646"]),
    ({"trigger_level_v": 6.0}, ["trigger_level_v = 6", "5"]),
    ({"record_samples": 2_097_152}, ["record_samples = 2097152"]),
    ({"record_samples": 1_048_576, "monitor_range_v": 1.0}, ["record_samples of 2 channels = 1048576", "1048552"]),
    ({"monitor_range_v": 3.0}, ["monitor_range_v = 3", "4"]),
]


@pytest.mark.parametrize(("change", "texts"), REFUSED)
def test_a_refusal_names_value_and_limit(change, texts) -> None:
    (refusal,) = mistakes(dataclasses.replace(CAPTURE, **change))
    assert refusal.field in change
    assert all(text in refusal.text for text in texts)


def test_all_mistakes_are_found_at_once() -> None:
    wrong = dataclasses.replace(CAPTURE, record_samples=100, sample_rate_hz=1.0, record_count=0, input_range_v=3.0)
    assert len(mistakes(wrong)) == 5


@pytest.mark.parametrize("delay", [0, 8000, 1, -64, -1984])
def test_delays_and_pre_triggers_the_board_can_do_are_accepted(delay: int) -> None:
    assert mistakes(dataclasses.replace(CAPTURE, trigger_delay_samples=delay)) == []


@pytest.mark.parametrize("model", MODELS, ids=lambda model: model.name)
def test_only_the_lowest_and_the_highest_code_are_full_scale(model: BoardModel) -> None:
    lowest, highest = model.code_limits
    inside = np.array([lowest + 1, 0, highest - 1], np.int16)
    assert not any_at_full_scale(inside, model)
    for end in (lowest, highest):
        assert any_at_full_scale(np.append(inside, np.int16(end)), model)
        assert any_at_full_scale(np.full(3, end, np.int16), model)


@pytest.mark.parametrize("model", MODELS, ids=lambda model: model.name)
def test_the_codes_of_words_stay_within_the_limits_of_the_board(model: BoardModel) -> None:
    unused_bits = 8 * model.sample_bytes - model.code_bits
    words = np.array([0, 1 << (model.code_bits - 1), (1 << model.code_bits) - 1], word_dtype(model)) << unused_bits
    lowest, highest = model.code_limits
    assert codes(words, model).tolist() == [lowest, 0, highest]


@pytest.mark.parametrize(("level_v", "code"), [(0.0, 128), (1.0, 153), (1.5, 166), (2.0, 178), (5.0, 255)])
def test_level_codes_are_those_of_the_reference(level_v: float, code: int) -> None:
    assert level_code(level_v) == code


@given(st.integers(8, 4096), st.integers(1, 20_000))
def test_records_per_buffer_divide_the_count_and_fit_the_buffer(sixteenths: int, count: int) -> None:
    capture = dataclasses.replace(CAPTURE, record_samples=16 * sixteenths, record_count=count)
    per_buffer = records_per_buffer(capture)
    assert count % per_buffer == 0
    assert per_buffer * header_record_dtype(capture.record_samples).itemsize < 4 * 2**20
    assert per_buffer == 1 or per_buffer <= count / 8


def test_a_buffer_holds_a_mebibyte_of_a_long_capture_and_one_record_of_a_prime_count() -> None:
    assert records_per_buffer(dataclasses.replace(CAPTURE, record_count=10_000)) == 250
    assert records_per_buffer(dataclasses.replace(CAPTURE, record_count=10_000), channels=2) == 125
    assert records_per_buffer(dataclasses.replace(CAPTURE, record_count=997)) == 1


def test_a_last_trigger_that_does_not_come_costs_an_eighth_of_the_capture_at_most() -> None:
    assert records_per_buffer(dataclasses.replace(CAPTURE, record_samples=128, record_count=56)) == 7


def test_npt_records_have_another_multiple_and_no_pre_trigger() -> None:
    wrong = dataclasses.replace(CAPTURE, record_samples=2032, trigger_delay_samples=-64)
    assert mistakes(wrong) == []
    alignment, before = mistakes(wrong, mode="npt")
    assert "2016 or 2048" in alignment.text
    assert "64 pre-trigger samples" in before.text


def test_an_old_fpga_holds_a_thousand_single_port_records_and_any_number_of_autodma_records() -> None:
    many = dataclasses.replace(CAPTURE, record_count=1001)
    assert "FPGA version 18" in mistakes(many, mode="single_port", fpga=18)[0].text
    assert mistakes(many, mode="single_port", fpga=19) == []
    assert mistakes(many, mode="traditional", fpga=18) == []


@given(st.integers(0, 2**14 - 1))
def test_codes_and_volts_invert_the_references_formula(code: int) -> None:
    full_scale_v = 0.8
    volts = full_scale_v * (code - 8191.5) / 8191.5
    word = np.array([code << 2], np.uint16)
    read = codes(word) * volts_per_code(full_scale_v) + volts_offset(full_scale_v)
    # One rounding error a term: the sum is of numbers up to the full scale.
    assert read[0] == pytest.approx(volts, abs=4 * np.finfo(float).eps * full_scale_v)


@given(st.integers(0, 2**40 - 1), st.integers(0, 2**24 - 1))
def test_the_time_stamp_is_forty_bits_regardless_of_other_bits(count: int, other_bits: int) -> None:
    header = np.array([[1, 2, count & 0xFFFF_FFFF, (other_bits << 8) | (count >> 32)]], np.uint32)
    assert timestamp_counts(header)[0] == count


def test_buffers_start_on_a_page_and_are_empty() -> None:
    buffer = PageBuffer(5000)
    assert buffer.address % mmap.PAGESIZE == 0
    assert not buffer.copy(np.dtype("u1"), 5000).any()
    buffer.free()


def test_a_copy_outlives_its_buffer_and_freeing_twice_is_no_error() -> None:
    buffer = PageBuffer(4096)
    copy = buffer.copy(np.dtype("<u2"), 16)
    buffer.free()
    buffer.free()
    assert buffer.freed
    assert copy.shape == (16,)
    with pytest.raises(ValueError, match="freed"):
        buffer.copy(np.dtype("<u2"), 16)
