"""Limits of the outputs at a transducer, on the settings that the instruments report."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from drivers.interfaces import InstrumentError
from hpe_rig.bench import read_bench
from hpe_rig.bench.opening import open_bench
from hpe_rig.bench.output_limits import Drive, drive_mistakes, require_within_limits, setting_mistakes
from hpe_rig.measurement import prepare, program_shot

BENCH = read_bench().bench


@pytest.fixture(scope="module")
def settings() -> dict[str, Any]:
    setup = prepare("bovine-muscle")
    with open_bench(setup.scene.scene, BENCH, setup.plan.roles) as bench:
        return dict(program_shot(setup.plan.shots[0], bench))


def test_the_settings_of_a_planned_shot_are_within_the_limits(settings: dict[str, Any]) -> None:
    assert list(setting_mistakes(BENCH, settings)) == []


@pytest.mark.parametrize(
    ("role", "key", "value", "words"),
    [
        ("burst_train", "frequency_hz", 3990.0, "duty of 300 cycles of 3 MHz at 3990 Hz is 0.399, max_duty = 0.05"),
        ("toneburst", "cycles", 900, "toneburst: length of 900 cycles of 3 MHz, s, is 0.0003, max_burst_length_s"),
        ("toneburst", "amplitude_vpp", 2.1, "amplitude, Vpp, is 2.1, max_drive_vpp or max_vpp = 2"),
        ("burst_train", "cycles", 201, "number of bursts in a train is 201, max_bursts = 200"),
        ("toneburst", "burst_on", False, "toneburst: its output reads back as no counted burst"),
        ("tracking_pulser", "trigger_source", "IMM", "tracking_pulser: its output reads back as no counted burst"),
        ("tracking_pulser", "cycles", 300, "tracking_pulser: duty of 300 cycles of 9 MHz at"),
        ("toneburst", "cycles", float("nan"), "duty"),
    ],
)
def test_a_setting_beyond_a_limit_is_named_with_both_numbers(
    settings: dict[str, Any], role: str, key: str, value: object, words: str
) -> None:
    changed = settings | {role: {**settings[role], key: value}}
    assert any(words in text for text in setting_mistakes(BENCH, changed))


def test_a_carrier_outside_the_band_of_its_transducer_is_refused_by_plan_and_read_back(
    settings: dict[str, Any], tmp_path: Path
) -> None:
    path = tmp_path / "bench.toml"
    table = "[generators.tracking_pulser]"
    path.write_text(read_bench().text.replace(table, f"{table}\ncarrier_band_hz = [2e6, 4e6]"), encoding="utf-8")
    words = "tracking_pulser: carrier is 9 MHz, carrier_band_hz 2 to 4 MHz"
    assert list(setting_mistakes(read_bench(path).bench, settings)) == [words]
    assert any(item.text == words for item in prepare("bovine-muscle", path, refuse=False).findings)


def test_a_band_at_a_generator_that_drives_no_transducer_is_reported(tmp_path: Path) -> None:
    path = tmp_path / "bench.toml"
    table = "[generators.master]"
    path.write_text(read_bench().text.replace(table, f"{table}\ncarrier_band_hz = [2e6, 4e6]"), encoding="utf-8")
    texts = [item.text for item in prepare("bovine-muscle", path).findings if item.level == "warning"]
    assert any("generators.master.carrier_band_hz has no effect" in text for text in texts)


def test_an_excess_is_refused_before_any_output_is_enabled() -> None:
    setup = prepare("bovine-muscle")
    limits = BENCH.limits.model_copy(update={"max_duty": 0.005})
    with open_bench(setup.scene.scene, BENCH.model_copy(update={"limits": limits}), setup.plan.roles) as bench:
        with pytest.raises(InstrumentError, match=r"at 100 Hz is 0\.01, max_duty = 0\.005.*no output was enabled"):
            program_shot(setup.plan.shots[0], bench)
        assert bench.world is not None
        assert not any(bench.world.outputs_on().values())


def test_a_value_at_its_limit_is_within_it_and_the_next_percent_is_not() -> None:
    """Limits of the shipped bench: duty 0.05, 250 us, 200 bursts, 2 Vpp; 300 cycles of 3 MHz last 100 us."""
    toneburst = BENCH.generators.by_role["toneburst"].model_copy(update={"carrier_band_hz": (1e6, 4e6)})
    bench = BENCH.model_copy(update={"generators": BENCH.generators.model_copy(update={"toneburst": toneburst})})
    usual = Drive("toneburst", 3e6, 300, 1.0, 100.0, 50)
    assert usual.duty == pytest.approx(0.01)
    at_limits = [
        ({"trigger_rate_hz": 500.0}, "max_duty"),
        ({"cycles": 750.0}, "max_burst_length_s"),
        ({"bursts": 200.0}, "max_bursts"),
        ({"amplitude_vpp": 2.0}, "max_drive_vpp or max_vpp"),
        ({"carrier_hz": 4e6}, "carrier_band_hz"),
    ]
    for changes, key in at_limits:
        ((name, value),) = changes.items()
        assert list(drive_mistakes(bench, replace(usual, **changes))) == []
        # A rounding of the setting is no excess.
        assert list(drive_mistakes(bench, replace(usual, **{name: value * (1 + 5e-7)}))) == []
        beyond = list(drive_mistakes(bench, replace(usual, **{name: value * 1.01})))
        assert [(found, text.partition(":")[0]) for found, text in beyond] == [(key, "toneburst")]
    assert list(drive_mistakes(bench, replace(usual, carrier_hz=1e6 * (1 - 5e-7), cycles=10))) == []
    low = [key for key, _ in drive_mistakes(bench, replace(usual, carrier_hz=0.99e6, cycles=10))]
    assert low == ["carrier_band_hz"]
    weaker = toneburst.model_copy(update={"max_vpp": 0.5, "carrier_band_hz": None})
    bench = BENCH.model_copy(update={"generators": BENCH.generators.model_copy(update={"toneburst": weaker})})
    assert [key for key, _ in drive_mistakes(bench, usual)] == ["max_drive_vpp or max_vpp"]
    unlimited = BENCH.model_copy(update={"limits": BENCH.limits.model_copy(update={"max_drive_vpp": None})})
    assert list(drive_mistakes(unlimited, replace(usual, amplitude_vpp=1e3))) == []


def test_only_outputs_at_a_transducer_are_limited_and_a_missing_trigger_has_rate_zero(settings: dict[str, Any]) -> None:
    master = settings | {"master": {**settings["master"], "burst_on": False}}
    assert list(setting_mistakes(BENCH, master)) == []
    alone = {"tracking_pulser": settings["tracking_pulser"]}
    assert list(setting_mistakes(BENCH, alone)) == []
    endless = {"toneburst": {**settings["toneburst"], "burst_mode": "GAT"}}
    assert list(setting_mistakes(BENCH, endless)) == [
        "toneburst: its output reads back as no counted burst on an external trigger"
    ]
    with pytest.raises(InstrumentError, match="toneburst: its output reads back") as refused:
        require_within_limits(BENCH, endless)
    assert refused.value.role == "bench"
