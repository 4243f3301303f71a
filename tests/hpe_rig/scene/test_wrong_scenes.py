"""Wrong scenes end in messages that name the key, the numbers and the remedy."""

from pathlib import Path

import pytest

from hpe_rig.bench import check_simulation, parse_bench, read_bench
from hpe_rig.plan.checks.check_result import PlanError, refuse_conflicts
from hpe_rig.plan.checks.checklist import check_plan
from hpe_rig.plan.shots import make_plan
from hpe_rig.scene import SettingsError, parse_scene, scene_text, shipped_scenes

MUSCLE = shipped_scenes()["bovine-muscle-synchronous"]
TABLE_1 = shipped_scenes()["table-1"]


def message_of(text: str, section: str = "title", changes: dict[str, object] | None = None) -> str:
    """Return the message that a scene of this text earns on the shipped bench with ``changes`` in ``section``."""
    bench = read_bench().bench
    if changes is not None:
        bench = bench.model_copy(update={section: getattr(bench, section).model_copy(update=changes)})
    try:
        scene = parse_scene("wrong", text, check_simulation).scene
        refuse_conflicts(check_plan(scene, bench, make_plan(scene, bench)))
    except (SettingsError, PlanError) as error:
        return str(error)
    pytest.fail("the wrong scene was accepted")


def edited(text: str, old: str, new: str) -> str:
    assert old in text
    return text.replace(old, new)


WRONG = [
    # old, new, words that must appear
    ("burst_rate_hz = 100.0", "burst_rate_hz = -100.0", ["excitation.burst_rate_hz", "-100.0", "at least 0.001 Hz"]),
    ("burst_rate_hz = 100.0", "burst_rate_hz = inf", ["excitation.burst_rate_hz", "inf", "finite"]),
    ("burst_rate_hz = 100.0", 'burst_rate_hz = "100"', ["excitation.burst_rate_hz", "'100'", "number without quotes"]),
    ("burst_rate_hz = 100.0", "burst_rat_hz = 100.0", ["excitation.burst_rat_hz", "did you mean burst_rate_hz"]),
    ("burst_rate_hz = 100.0", "", ["excitation.burst_rate_hz", "required"]),
    ("burst_rate_hz = 100.0", "burst_rate_hz = = 1", ["not valid TOML", "line 4"]),
    ("burst_length_s = 100e-6", "burst_length_s = []", ["excitation.burst_length_s", "0 entries"]),
    (
        "burst_length_s = 100e-6",
        "burst_length_s = [100e-6, 0.0]",
        ["excitation.burst_length_s[1]", "0.0", "at least 1e-09 s"],
    ),
    ("burst_length_s = 100e-6", "burst_length_s = 100.1e-6", ["whole cycles", "300.3", "0.0001"]),
    ("burst_length_s = 100e-6", "burst_length_s = 300e-6", ["max_burst_length_s", "300 us", "250 us"]),
    (
        "burst_length_s = 100e-6",
        "burst_length_s = 200e-6",
        ["interference", "200 us", "tracking.pulse_rate_hz", "below"],
    ),
    (
        "window_start_s = 50e-3",
        'harmonic = "medium_prior"\nestimator = "cross_spectrum"',
        ["cross_spectrum includes a fit", 'harmonic = "medium_prior"', 'set estimator = "coherent"'],
    ),
    ("window_start_s = 50e-3", "process_noise = 1e-3", ["process_noise", 'set harmonic = "kalman"']),
    ("burst_count = 20", "burst_count = 0", ["excitation.burst_count", "0", "at least 1"]),
    ("burst_count = 20", "burst_count = 20.5", ["excitation.burst_count", "20.5", "whole number"]),
    ("burst_count = 20", "burst_count = 400", ["excitation.burst_count = 400", "limits.max_bursts = 200"]),
    ("burst_count = 20", "force_fraction = 1.2", ["excitation.force_fraction", "1.2", "at most 1"]),
    ("delay_s = 130e-6", "delay_s = 20e-6", ["tracking.delay_s = 20 us", "100 us", "105.8 to 158.1 us"]),
    ("delay_s = 130e-6", "delay_s = -1e-6", ["tracking.delay_s", "at least 0"]),
    ("pulse_rate_hz = 4000.0", "pulse_rate_hz = 12000.0", ["depth", "12000 Hz", "10922 Hz"]),
    ("pulse_rate_hz = 4000.0", "pulse_rate_hz = 4050.0", ["synchronous", "40.5", "tracking.pulse_rate_hz = 4000"]),
    ("[processing]", "[processing]\nfrequencies_hz = [100.0, 2000.0]", ["aliasing", "2000 Hz", "4000 Hz"]),
    ("[processing]", "[processing]\nfrequencies_hz = [100.0, 101.0]", ["resolution", "1 Hz apart", "1000 ms"]),
    ("window_start_s = 50e-3", "window_start_s = 195e-3", ["window_start_s of at most 190 ms, or more excitation."]),
    ("[processing]", "[processing]\nwindow_length_s = 5e-3", ["resolution", "10 ms (processing.window_length_s)"]),
    ("[processing]", "[processing]\nwindow_length_s = 0.5", ["window", "200 ms", "tracking.pulse_count"]),
    ("[processing]", '[processing]\nestimator = "fast"', ["processing.estimator", "'fast'", "'coherent'"]),
    ("synchronous = true", 'synchronous = "yes"', ["processing.synchronous", "'yes'", "true or false"]),
    ("gate_depth_m = 70.0e-3", "gate_depth_m = 0.4e-3", ["gate depth", "-0.1 mm"]),
    (
        "gate_length_m = 1.0e-3",
        "gate_length_m = 8.0e-3",
        ["gate in record", "-263 to 776", "512", "record_samples = 1072"],
    ),
    ("gate_length_m = 1.0e-3", "record_samples = 500", ["record length", "500", "record_samples = 512"]),
    ("gate_length_m = 1.0e-3", "record_samples = 32768", ["record in period", "250 us"]),
    ("gate_length_m = 1.0e-3", "sample_rate_hz = 80e6", ["sample rate", "80 MHz", "100, 125 MHz"]),
    ("gate_length_m = 1.0e-3", "sample_rate_hz = 10e6", ["carrier", "9 MHz", "18 MHz"]),
    ("gate_length_m = 1.0e-3", "input_range_v = 0.3", ["input range", "0.3 V", "0.2, 0.4"]),
    ("gate_length_m = 1.0e-3", "shot_period_s = 0.1", ["master period", "200.1 ms", "100 ms"]),
    ("gate_length_m = 1.0e-3", "repeats = 0", ["acquisition.repeats", "at least 1"]),
    ("seed = 1", "seed = -1", ["simulation.seed", "-1", "at least 0"]),
    ("seed = 1", "sede = 1", ["simulation.sede", "did you mean seed"]),
    (
        "force_density_n_per_m3 = 2.2e6",
        "shear_modulus_pa = 0",
        ["simulation.specimen.shear_modulus_pa", "at least 0.01 Pa"],
    ),
    (
        "[simulation.specimen]",
        "[[simulation.motion]]\nfrequency_hz = 1.0\namplitude_m = 1e-6\n[simulation.specimen]",
        ["simulation", "exclude"],
    ),
    ("[tracking]", "[traking]", ["traking", "did you mean tracking"]),
]


@pytest.mark.parametrize(
    ("old", "new", "words"), WRONG, ids=[f"{index}-{row[1][:32]}" for index, row in enumerate(WRONG)]
)
def test_a_wrong_scene_earns_a_message_that_names_key_numbers_and_remedy(old: str, new: str, words: list[str]) -> None:
    message = message_of(edited(MUSCLE, old, new))
    missing = [word for word in words if word not in message]
    assert not missing, f"{missing} not in:\n{message}"
    assert "Try: " in message or "did you mean" in message


@pytest.mark.parametrize(
    ("section", "changes", "words"),
    [
        ("digitizer", {"dual_port_memory": False, "max_records": 500}, ["memory", "800 records", "500"]),
        ("limits", {"max_duty": 0.005}, ["duty", "0.01", "0.005"]),
        ("generators", {"toneburst": None}, ["no generators for [excitation]"]),
    ],
)
def test_a_scene_beyond_the_bench_is_refused_with_both_numbers(
    section: str, changes: dict[str, object], words: list[str]
) -> None:
    message = message_of(MUSCLE, section, changes)
    assert not [word for word in words if word not in message], message


def test_all_mistakes_of_a_scene_are_reported_at_once() -> None:
    text = edited(edited(MUSCLE, "burst_count = 20", "burst_count = 0"), "delay_s = 130e-6", "delay_s = -1.0")
    text = edited(text, "seed = 1", "seed = -1")
    with pytest.raises(SettingsError) as caught:
        parse_scene("wrong", text, check_simulation)
    assert [mistake.path for mistake in caught.value.mistakes] == [
        "excitation.burst_count",
        "tracking.delay_s",
        "simulation.seed",
    ]


def test_all_conflicts_of_a_plan_are_reported_at_once() -> None:
    text = edited(MUSCLE, "delay_s = 130e-6", "delay_s = 20e-6")
    text = edited(text, "gate_length_m = 1.0e-3", "record_samples = 500\ninput_range_v = 0.3")
    message = message_of(text)
    assert "the plan has 3 conflicts" in message


def test_a_prescribed_motion_needs_frequencies_and_a_pulse_count() -> None:
    assert "processing.frequencies_hz" in message_of(edited(TABLE_1, "frequencies_hz = [200.0]", ""))
    assert "tracking.pulse_count" in message_of(edited(TABLE_1, "pulse_count = 101", ""))


@pytest.mark.parametrize(
    ("source", "target", "words"),
    [
        (
            "master.output",
            "digitizer.trigger",
            ["digitizer.trigger has 2 sources", "tracking_train.output", "one cable"],
        ),
        ("digitizer.aux", "tracking_train.trigger", ["tracking_train.trigger has 2 sources", "master.output"]),
    ],
)
def test_crossed_cables_are_refused(source: str, target: str, words: list[str]) -> None:
    text = read_bench().text + f'\n[[wiring]]\nsource = "{source}"\ntarget = "{target}"\n'
    with pytest.raises(SettingsError) as caught:
        parse_bench("crossed", text)
    assert not [word for word in words if word not in str(caught.value)], str(caught.value)


def test_a_scene_saved_with_a_byte_order_mark_is_read(tmp_path: Path) -> None:
    path = tmp_path / "notepad.toml"
    path.write_text(MUSCLE, encoding="utf-8-sig")
    assert parse_scene(*scene_text(str(path))).scene.title.startswith("Bovine")


@pytest.mark.parametrize("stored", [False, True])
def test_a_number_swept_twice_is_refused_when_the_scene_is_read(stored: bool) -> None:
    twice = '[sweep]\nlateral_offset_m = [0.0, 1e-3]\n"tracking.lateral_offset_m" = [0.0, 2e-3]\n\n[processing]'
    with pytest.raises(SettingsError) as caught:
        parse_scene("twice", edited(MUSCLE, "[processing]", twice), stored=stored)
    words = ["scene twice", "sweep.lateral_offset_m = [0.0, 0.001]", "Try: one of the two"]
    assert not [word for word in words if word not in str(caught.value)], str(caught.value)


@pytest.mark.parametrize("path", [r"C:\Users\me\push.csv", r"D:\scans\push.csv", r"D:\ua0\push.csv", "\\"])
def test_a_path_of_windows_between_double_quotes_is_told_how_to_be_written(path: str) -> None:
    double, single = (edited(MUSCLE, "[beams]", f"[beams]\nexcitation_scan = {q}{path}{q}") for q in ('"', "'"))
    message = message_of(double)
    assert "a backslash begins a special character" in message
    assert "single quotes" in message
    assert parse_scene("right", single).scene.beams.excitation_scan == path


def test_a_backslash_is_not_blamed_for_what_stands_after_the_string() -> None:
    message = message_of(edited(MUSCLE, "[beams]", '[beams]\nexcitation_scan = "C:\\\\push.csv" mm'))
    assert "not valid TOML" in message
    assert "backslash" not in message
