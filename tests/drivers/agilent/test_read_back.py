"""Programmed against read back; the oracle is the 33250A's reply format as recorded from one."""

from __future__ import annotations

import math

import pytest
from hypothesis import given, strategies as st

from drivers.agilent.read_back import Register, argument, number, short_form, whole_number


def as_the_instrument_replies(value: float) -> str:
    return f"{value:+.13E}"


@given(st.floats(min_value=1e-9, max_value=1e9))
def test_a_number_survives_sending_and_reading_back(value: float) -> None:
    sent = float(argument(value))
    assert Register("x", "FREQ", value).matches(as_the_instrument_replies(sent))
    assert sent == pytest.approx(value, rel=1e-12)


@given(st.floats(min_value=1e-9, max_value=1e9), st.sampled_from([-1, 1]))
def test_a_change_in_the_ninth_digit_is_found(value: float, sign: int) -> None:
    assert not Register("x", "FREQ", value).matches(as_the_instrument_replies(value * (1 + sign * 1e-9)))


@pytest.mark.parametrize("value", [5000.001, 1 / 3, 80e6, 2e-7])
def test_numbers_are_sent_with_at_least_ten_significant_digits(value: float) -> None:
    mantissa = argument(value).partition("E")[0]
    assert len(mantissa.replace(".", "").replace("-", "")) >= 10


def test_infinity_goes_out_as_a_keyword_and_comes_back_as_a_large_number() -> None:
    register = Register("load_ohm", "OUTP:LOAD", math.inf)
    assert register.command == "OUTP:LOAD INF"
    assert register.matches("+9.9000000000000E+37")
    assert not register.matches("+5.0000000000000E+01")
    assert whole_number("+9.9000000000000E+37") == math.inf


def test_zero_within_the_tolerance_of_a_level_is_zero() -> None:
    assert Register("low_v", "VOLT:LOW", 0.0, 1e-9).matches("-2.2204460492503E-16")
    assert not Register("low_v", "VOLT:LOW", 0.0, 1e-9).matches("-1.0000000000000E-03")


@pytest.mark.parametrize(
    ("long", "short"),
    [
        ("EXTernal", "EXT"),
        ("PULSe", "PULS"),
        ("SINusoid", "SIN"),
        ("TRIGgered", "TRIG"),
        ("BUS", "BUS"),
        ("vpp", "VPP"),
    ],
)
def test_long_and_short_form_of_a_keyword_are_the_same(long: str, short: str) -> None:
    assert short_form(long) == short
    assert Register("k", "H", long).matches(short)
    assert Register("k", "H", short).matches(long)


def test_another_keyword_is_a_difference() -> None:
    assert not Register("trigger_source", "TRIG:SOUR", "EXT").matches("IMM")


def test_a_reply_without_a_number_is_a_difference_not_a_crash() -> None:
    assert not Register("rate_hz", "FREQ", 100.0).matches("SIN")


@pytest.mark.parametrize(("on", "sent"), [(True, "OUTP 1"), (False, "OUTP 0")])
def test_switches_are_sent_as_digits(on: bool, sent: str) -> None:
    assert Register("output_on", "OUTP", on).command == sent


def test_counts_are_sent_whole_and_read_in_either_format() -> None:
    assert Register("cycles", "BURS:NCYC", 20).command == "BURS:NCYC 20"
    assert Register("cycles", "BURS:NCYC", 20).matches("+2.0000000000000E+01")
    assert number("+4096") == 4096
