"""Differences between two benches in words: settings that were read back, instruments and cables."""

from __future__ import annotations

import dataclasses

import pytest

from hpe_rig.bench.comparison import BenchSettings, file_differences, settings_differences


def test_numbers_that_came_through_text_are_the_same_and_others_are_not() -> None:
    one = {"master": {"width_s": 1e-5, "burst_on": True, "load_ohm": float("inf")}}
    assert (
        settings_differences(
            one, {"master": {"width_s": 1e-5 * (1 + 1e-12), "burst_on": True, "load_ohm": float("inf")}}
        )
        == []
    )
    (difference,) = settings_differences(
        one, {"master": {"width_s": 1e-5, "burst_on": False, "load_ohm": float("inf")}}
    )
    assert dataclasses.astuple(difference) == ("master trigger", "burst", "", True, False)
    assert difference.text("a", "b") == "master trigger: burst on in a, off in b"


def test_cables_are_compared_by_their_ends() -> None:
    cable = {"source": "master.output", "target": "burst_train.trigger", "delay_s": 5e-9}
    (difference,) = file_differences({"wiring": [cable]}, {"wiring": [cable | {"delay_s": 7e-9}]})
    assert difference.text("a", "b") == (
        "bench file: wiring.master.output to burst_train.trigger delay 5 ns in a, 7 ns in b"
    )


@pytest.mark.parametrize(
    ("before", "after", "text"),
    [
        ({"master": {"high_v": 4.0}}, {}, "master trigger: instrument opened in a, not opened in b"),
        ({}, {"digitizer": {"delay_samples": 16}}, "digitizer: instrument not opened in a, opened in b"),
    ],
)
def test_an_instrument_of_one_bench_only_is_one_difference(
    before: BenchSettings, after: BenchSettings, text: str
) -> None:
    (difference,) = settings_differences(before, after)
    assert difference.text("a", "b") == text


def test_a_setting_that_only_one_release_reads_is_no_difference() -> None:
    assert settings_differences({"master": {"high_v": 4.0, "polarity": "normal"}}, {"master": {"high_v": 4.0}}) == []


def test_an_entry_of_one_bench_file_only_is_not_stated_in_the_other() -> None:
    (difference,) = file_differences({"limits": {"max_pressure_pa": 2e6}}, {"limits": {}})
    assert difference.text("a", "b") == "bench file: limits max pressure 2 MPa in a, not stated in b"
