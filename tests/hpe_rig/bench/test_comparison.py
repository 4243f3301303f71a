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


def test_the_flag_of_a_clipped_shot_in_earlier_run_files_is_no_setting() -> None:
    assert settings_differences({"digitizer": {"clipped": False}}, {"digitizer": {"clipped": True}}) == []


def test_an_entry_of_one_bench_file_only_is_not_stated_in_the_other() -> None:
    (difference,) = file_differences({"limits": {"max_pressure_pa": 2e6}}, {"limits": {}})
    assert difference.text("a", "b") == "bench file: limits max pressure 2 MPa in a, not stated in b"


@pytest.mark.parametrize(
    ("key", "value", "text"),
    [
        ("delay_s", 1.5e-6, "delay 1.5 us"),
        ("high_v", 0.0025, "high 2.5 mV"),
        ("amplitude_vpp", 2.0, "amplitude 2 Vpp"),
        ("load_ohm", 10000.0, "load 10000 ohm"),
        ("burst_phase_deg", 0.1234567891, "burst phase 0.1234567891 deg"),
        ("record_samples", 2048, "record 2048 samples"),
        ("focus_depth_m", 0.007, "focus depth 7 mm"),
        ("max_spta_w_per_m2", 7200.0, "max spta 7200 W/m2"),
        ("cycles", 12, "cycles 12"),
        ("polarity", "NORM", "polarity NORM"),
        ("trigger_output_on", True, "trigger output on"),
        ("width_m", 1.2345678901e-3, "width 1.23456789 mm"),
    ],
)
def test_a_setting_is_named_in_words_with_its_unit(key: str, value: object, text: str) -> None:
    (difference,) = settings_differences({"digitizer": {key: value}}, {"digitizer": {key: "?"}})
    assert difference.text("a", "b") == f"digitizer: {text} in a, {difference._value('?')} in b"


def test_entries_of_tables_are_named_by_their_path_and_name() -> None:
    before = {"title": "a", "conditions": [{"name": "water", "max": 21.0}], "cables": ["one"], "limits": {"u": 0.1}}
    after = {"title": "a", "conditions": [{"name": "water", "max": 22.0}], "cables": ["two"], "limits": {"u": 0.1}}
    texts = [difference.text("a", "b") for difference in file_differences(before, after)]
    assert texts == [
        "bench file: conditions.water max 21 in a, 22 in b",
        "bench file: cables entry one in a, two in b",
    ]


def test_roles_are_compared_in_the_order_of_the_triggers() -> None:
    one = {"digitizer": {"a": 1}, "master": {"a": 1}, "toneburst": {"a": 1}}
    other = {"digitizer": {"a": 2}, "master": {"a": 1.0}, "toneburst": {"a": 1 + 2e-10}}
    assert [item.where for item in settings_differences(one, other)] == ["toneburst generator", "digitizer"]
    assert settings_differences(one, one) == []
