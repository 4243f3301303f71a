"""Bench files: mistakes of wiring, addresses, conditions and transducers with their keys, and derived values."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from pathlib import Path

import pytest

from hpe_rig.bench import BenchFile, parse_bench, read_bench, with_transducers
from hpe_rig.bench.bench_file import Condition, Transducers
from hpe_rig.bench.bench_loading import wrong_values
from hpe_rig.scene import SettingsError, load_scene

TEXT = read_bench().text
BENCH = read_bench().bench
TRANSDUCERS = {
    "push": {"focus_depth_m": 70e-3, "width_m": (0.34e-3, 0.34e-3, 3.6e-3)},
    "tracking": {"focus_depth_m": 40e-3, "width_m": (0.078e-3, 0.078e-3, 0.83e-3), "pulse_length_m": 1.32e-3},
}
TABLES = """
[transducers.push]
focus_depth_m = 70e-3
width_m = [0.34e-3, 0.34e-3, 3.60e-3]
[transducers.tracking]
focus_depth_m = 40e-3
width_m = [0.078e-3, 0.078e-3, 0.83e-3]
"""


def cable(source: str, target: str) -> str:
    return f'source = "{source}"\ntarget = "{target}"\n'


def edited(*edits: tuple[str, str], end: str = "") -> str:
    text = TEXT
    for old, new in edits:
        assert old in text, old
        text = text.replace(old, new)
    return text + end


def condition(**keys: object) -> str:
    lines = "".join(f"{key} = {value!r}\n" for key, value in keys.items())
    return f"\n[[conditions]]\n{lines}"


COMMAND = {"command": ["thermometer"]}
PULSER = cable("tracking_pulser.output", "transducer.drive")
MISTAKES = [
    (
        edited((cable("master.output", "tracking_train.trigger"), cable("master.output", "digitizer.channel_b"))),
        [("wiring", "no cable from master.output to tracking_train.trigger")],
    ),
    (
        edited((cable("burst_train.output", "toneburst.trigger"), cable("master.output", "toneburst.trigger"))),
        [("wiring", "no cable from burst_train.output to toneburst.trigger")],
    ),
    (
        edited(end=f"\n[[wiring]]\n{cable('master.output', 'digitizer.trigger')}"),
        [("wiring", "digitizer.trigger has 2 sources, tracking_train.output and master.output")],
    ),
    (
        edited(end=f"\n[[wiring]]\n{cable('master.output', 'tracking_transducer.drive')}"),
        [("wiring", "a cable goes to tracking_transducer.drive, and there is no [transducers]")],
    ),
    (
        edited((PULSER, f"{PULSER}\n[[wiring]]\n{cable('tracking_pulser.output', 'tracking_transducer.drive')}"))
        + TABLES,
        [("wiring", "tracking_pulser.output drives the transducer that pushes")],
    ),
    (
        edited((PULSER, PULSER.replace("transducer", "tracking_transducer")))
        + f"\n[[wiring]]\n{cable('toneburst.output', 'tracking_transducer.drive')}{TABLES}",
        [
            ("wiring", "tracking_transducer.drive has 2 sources, tracking_pulser.output and toneburst.output"),
            ("wiring", "toneburst.output drives the transducer that tracks"),
        ],
    ),
    (edited() + TABLES, [("wiring", "no cable from tracking_pulser.output to tracking_transducer.drive")]),
    (
        edited(
            ("[generators.master]", '[generators.master]\nserial = "A"'),
            ("[generators.toneburst]", '[generators.toneburst]\nserial = "A"'),
            ("[digitizer]", '[digitizer]\nserial = "A"'),
        ),
        [("generators.toneburst.serial", "A is stated for master and toneburst")],
    ),
    (
        edited(end=condition(name="t") + condition(name="t", plugin="p", **COMMAND)),
        [
            ("conditions[0]", "t needs a command or a plug-in, and not both"),
            ("conditions[1]", "t needs a command or a plug-in, and not both"),
            ("conditions[1].name", "t occurs twice"),
        ],
    ),
    (
        edited(end=condition(name="t", min=2.0, max=1.0, **COMMAND) + condition(name="u", min=1.0, max=1.0, plugin="")),
        [("conditions[0].min", "min = 2 is above max = 1")],
    ),
    (
        edited(("simulated = true", 'simulated = false\ntransport = "socket"')),
        [
            ("transport", "only the simulated bench has one"),
            *(
                (f"generators.{role}.address", "this key is required on a real bench")
                for role in BENCH.generators.by_role
            ),
        ],
    ),
]


@pytest.mark.parametrize(("text", "mistakes"), MISTAKES)
def test_every_mistake_of_a_bench_file_is_named_with_its_key(text: str, mistakes: list[tuple[str, str]]) -> None:
    with pytest.raises(SettingsError) as caught:
        parse_bench("bench", text)
    named = [(mistake.path, mistake.what) for mistake in caught.value.mistakes]
    assert len(named) >= len(mistakes)
    for expected, actual in zip(mistakes, named, strict=False):
        assert actual[0] == expected[0]
        assert actual[1].startswith(expected[1])
    assert caught.value.source == "bench bench"


def test_a_bench_without_tonebursts_needs_no_cables_for_them_and_an_imported_one_no_addresses() -> None:
    without = re.sub(r"\[generators\.(burst_train|toneburst)\][^\[]*", "", TEXT)
    without = re.sub(r"\[\[wiring\]\]\nsource = \"[^\"]*\"\ntarget = \"(burst_train|toneburst)\.[^\[]*", "", without)
    without = re.sub(r"\[\[wiring\]\]\nsource = \"toneburst[^\[]*", "", without)
    bench = parse_bench("tracking", without).bench
    assert list(bench.generators.by_role) == ["master", "tracking_train", "tracking_pulser"]
    recording = f'\n[recording]\nsource = "a.npy"\nsha256 = "{"0" * 64}"\nformat = "npy"\nfirst_sample_s = 0.0\n'
    imported = parse_bench("imported", edited(("simulated = true", "simulated = false"), end=recording)).bench
    assert imported.recording is not None
    assert imported.recording.words == f"a.npy, SHA-256 {'0' * 64}"


def test_a_scene_or_an_absent_file_in_place_of_a_bench_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match="this is a scene, not a bench file"):
        parse_bench("scene", "[tracking]\n[acquisition]\n")
    # One of the two tables alone is a bench file with a wrong table.
    with pytest.raises(SettingsError) as caught:
        parse_bench("bench", TEXT + "\n[tracking]\n")
    assert "this is a scene" not in str(caught.value)
    with pytest.raises(SettingsError, match=r"there is no file of that name.*--like bench"):
        read_bench(tmp_path / "absent.toml")
    (tmp_path / "folder.toml").mkdir()
    with pytest.raises(SettingsError) as caught:
        read_bench(tmp_path / "folder.toml")
    assert "there is no file" not in str(caught.value)


def test_a_board_that_cannot_be_locked_and_exchanged_limits_are_mistakes_and_equal_limits_are_not() -> None:
    def mistakes(**changes: object) -> list[str]:
        return [mistake.path for mistake in wrong_values(BENCH.model_copy(update=changes))]

    assert mistakes() == []
    assert mistakes(digitizer=BENCH.digitizer.model_copy(update={"common_reference": True})) == [
        "digitizer.common_reference"
    ]
    for low_hz, high_hz, expected in ((2e6, 2e6, []), (2e6, 1e6, ["generators.toneburst.carrier_band_hz"])):
        toneburst = BENCH.generators.by_role["toneburst"].model_copy(update={"carrier_band_hz": (low_hz, high_hz)})
        assert mistakes(generators=BENCH.generators.model_copy(update={"toneburst": toneburst})) == expected
    for serial, expected in (("none", []), ("NONE", ["digitizer.serial"]), (" ", ["digitizer.serial"]), ("7", [])):
        assert mistakes(digitizer=BENCH.digitizer.model_copy(update={"serial": serial})) == expected


def test_names_of_models_are_suggested() -> None:
    for old, new, key in (('model = "ATS460"', 'model = "ATS640"', "ATS460"), ('"33250A"', '"33250"', "33250A")):
        with pytest.raises(SettingsError, match=f"is not one of the choices.*did you mean '{key}'"):
            parse_bench("bench", edited((old, new)))
    with pytest.raises(SettingsError) as caught:
        parse_bench("bench", edited(('model = "ATS460"', f'model = "{"x" * 200}"')))
    assert f"'{'x' * 79}... is not one" in str(caught.value)
    assert "did you mean" not in str(caught.value)


def test_derived_values_of_instruments_follow_their_keys_and_models() -> None:
    master, board = BENCH.generators.master, BENCH.digitizer
    assert master.clock_uncertainty == 2e-6
    assert master.model_copy(update={"clock_accuracy": 1e-7}).clock_uncertainty == 1e-7
    assert board.clock_uncertainty == 25e-6
    assert board.model_copy(update={"clock_accuracy": 1e-7}).clock_uncertainty == 1e-7
    assert board.mode == "traditional"
    single = board.model_copy(update={"dual_port_memory": False})
    assert (single.mode, single.has_dual_port_memory) == ("single_port", False)
    assert single.model_copy(update={"model": "ATS9350"}).mode == "traditional"
    assert board.model_copy(update={"acquisition_mode": "npt"}).mode == "npt"
    assert (BENCH.path_delay_s("master.output", "burst_train.trigger"), BENCH.tracked_by) == (5e-9, "transducer.drive")
    assert math.isnan(BENCH.path_delay_s("master.output", "digitizer.trigger"))
    served = BENCH.model_copy(update={"transport": "vxi11"})
    metal = parse_bench("metal", edited(("[generators.master]", '[generators.master]\naddress = "GPIB0::10"'))).bench
    metal = metal.model_copy(update={"simulated": False})
    texts = [bench.address_text("master") for bench in (BENCH, served, metal)]
    assert texts == ["in process", "vxi11 loopback", "GPIB0::10"]
    assert metal.address_text("toneburst") == "-"
    assert BENCH.address_text("digitizer") == "system 1, board 1"
    unknown = {"generators": BENCH.generators, "digitizer": board.model_copy(update={"serial": "none"})}
    assert BENCH.model_copy(update=unknown).serials == {}
    known = BENCH.model_copy(update={"digitizer": board.model_copy(update={"serial": "7"})})
    assert known.serials == {"digitizer": "7"}


def test_limits_of_a_condition_are_part_of_it_and_said_with_its_unit() -> None:
    def bounded(low: float | None, high: float | None) -> Condition:
        return Condition(name="t", unit="C", min=low, max=high, plugin="p")

    cases = [
        (None, None, "", (True, True, True)),
        (20.0, None, "at least 20 C", (False, True, True)),
        (None, 21.0, "at most 21 C", (True, True, False)),
        (20.0, 21.0, "20 to 21 C", (False, True, False)),
        (20.5, 20.5, "20.5 to 20.5 C", (False, True, False)),
    ]
    for low, high, text, accepted in cases:
        limits = bounded(low, high)
        assert limits.limits_text == text
        assert tuple(limits.accepts(value) for value in (19.0, 20.5, 22.0)) == accepted
        assert limits.has_limits == bool(text)
        assert limits.accepts(math.nan) != limits.has_limits
        assert all(limits.accepts(value) for value in (low, high) if value is not None)
    assert bounded(None, None).value_text(20.1234567) == "20.1235 C"
    assert bounded(None, None).value_text(math.nan) == "not read"


def test_the_digest_of_a_commissioning_changes_with_instruments_and_cables_alone(
    real_bench: Callable[..., Path],
) -> None:
    digest = BENCH.commissioned_digest
    assert re.fullmatch("[0-9a-f]{16}", digest)
    same = edited((TEXT.splitlines()[1], 'title = "b"'), ("max_duty = 0.05", "max_duty = 0.04"))
    assert parse_bench("a", same).bench.commissioned_digest == digest
    reordered = BENCH.model_copy(update={"wiring": BENCH.wiring[::-1]})
    assert reordered.commissioned_digest == digest
    others = [
        edited(("board_id = 1", "board_id = 2")),
        edited(("delay_s = 10e-9", "delay_s = 11e-9")),
        edited(("[generators.master]", '[generators.master]\nserial = "1"')),
        edited(("[generators.master]", '[generators.master]\naddress = "GPIB0::1"')),
    ]
    digests = {digest, read_bench(real_bench()).bench.commissioned_digest}
    assert len(digests | {parse_bench("a", text).bench.commissioned_digest for text in others}) == 6


def test_the_beams_of_two_transducers_are_added_to_a_scene_and_must_not_contradict_it() -> None:
    two = BENCH.model_copy(update={"transducers": Transducers.model_validate(TRANSDUCERS)})
    scene = load_scene("gelatin-moduli").with_({"beams.focus_depth_m": 40e-3, "acquisition.gate_depth_m": 40e-3})
    beams = {
        "excitation_width_m": (0.34e-3, 0.34e-3, 3.6e-3),
        "tracking_width_m": (0.078e-3, 0.078e-3, 0.83e-3),
        "focus_depth_m": 40e-3,
        "push_focus_depth_m": 70e-3,
        "pulse_length_m": 1.32e-3,
    }
    bare = scene.model_copy(update={"beams": None})
    added = with_transducers(bare, two).beams
    assert added is not None
    assert {key: getattr(added, key) for key in beams} == beams
    assert added.transducer_diameter_m is None
    # The same values in both are no contradiction.
    assert with_transducers(with_transducers(bare, two), two).beams == added
    other = with_transducers(bare, two).with_({"beams.focus_depth_m": 41e-3, "beams.pulse_length_m": 1e-3})
    with pytest.raises(SettingsError) as caught:
        with_transducers(other, two)
    assert [mistake.path for mistake in caught.value.mistakes] == ["beams.focus_depth_m", "beams.pulse_length_m"]
    assert "0.041 here and 0.04 in the bench file" in str(caught.value)
    with pytest.raises(SettingsError, match=r"beams\.push_focus_depth_m: the bench has one transducer"):
        with_transducers(other, BENCH)
    imported = BENCH.model_copy(update={"recording": object()})
    assert with_transducers(other, imported) is other
    assert with_transducers(scene, BENCH) is scene
    assert with_transducers(bare, BENCH) is bare
    assert two.tracked_by == "tracking_transducer.drive"


def test_a_sweep_of_a_bench_file_without_values_is_that_bench_and_a_wrong_value_a_mistake() -> None:
    assert BENCH.with_({}) is BENCH
    assert isinstance(BENCH.with_({("wiring", 0, "delay_s"): 7e-9}), BenchFile)
    assert BENCH.with_({("wiring", 0, "delay_s"): 7e-9}).wiring[0].delay_s == 7e-9
    with pytest.raises(SettingsError) as caught:
        BENCH.with_({("limits", "max_duty"): 2.0})
    assert [mistake.path for mistake in caught.value.mistakes] == ["bench.limits.max_duty"]
