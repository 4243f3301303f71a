"""What the board cannot do is found with the plan, by the rules of its driver, before anything is opened."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from drivers.alazar import BoardModel
from drivers.interfaces import InstrumentError
from hpe_rig.bench import BenchFile, DigitizerBoard, read_bench
from hpe_rig.bench.opening import open_bench
from hpe_rig.measurement.sequencer import ShotBlock, acquire
from hpe_rig.plan.checks.checklist import check_plan
from hpe_rig.plan.shots import make_plan
from hpe_rig.scene import Scene, parse_scene, shipped_scenes
from hpe_rig.store.records import assemble

TABLE_1 = shipped_scenes()["table-1"]


def edited(text: str, section: str, line: str) -> str:
    assert f"[{section}]\n" in text
    key = line.partition(" ")[0]
    kept = "".join(each for each in text.splitlines(keepends=True) if not each.startswith(f"{key} "))
    return kept.replace(f"[{section}]\n", f"[{section}]\n{line}\n")


def bench_with(path: Path, line: str) -> BenchFile:
    path.write_text(edited(read_bench(None).text, "digitizer", line), encoding="utf-8")
    return read_bench(path).bench


def refusals(scene: Scene, bench: BenchFile) -> list[str]:
    results = check_plan(scene, bench, make_plan(scene, bench))
    return [str(result) for result in results if result.level == "refused"]


# On metal or on the twin: section of the scene or the bench file, the line in it, what is named.
REFUSED = [
    ("acquisition", "sample_rate_hz = 25e6", ["sample rate", "acquisition.sample_rate_hz = 25 MHz", "20, 50"]),
    ("acquisition", "input_range_v = 3.0", ["input range", "acquisition.input_range_v = 3", "2, 4 V"]),
    ("acquisition", "record_samples = 1000", ["record length", "acquisition.record_samples = 1000", "1008"]),
    ("digitizer", "trigger_level_v = 6.0", ["digitizer", "trigger_level_v = 6", "5", "digitizer.trigger_level_v"]),
    ("digitizer", "monitor_range_v = 3.0", ["capture mode", "monitor_range_v = 3", "4"]),
]


@pytest.mark.parametrize(("section", "line", "words"), REFUSED, ids=[line for _, line, _ in REFUSED])
def test_what_the_boards_driver_would_refuse_is_refused_with_the_plan(
    tmp_path: Path, section: str, line: str, words: list[str]
) -> None:
    of_bench = section == "digitizer"
    text = TABLE_1 if of_bench else edited(TABLE_1, section, line)
    scene = parse_scene("edited", text).scene
    bench = bench_with(tmp_path / "bench.toml", line) if of_bench else read_bench(None).bench
    (refused,) = refusals(scene, bench)
    assert all(word in refused for word in [*words, "Try:"]), refused
    # The oracle: the driver itself, at the simulated board.
    plan = make_plan(scene, bench)
    with open_bench(scene, bench, plan.roles) as opened, pytest.raises(InstrumentError, match="nothing was sent to it"):
        list(acquire(plan, opened))


def test_a_plan_that_passes_is_one_that_the_driver_takes() -> None:
    scene, bench = parse_scene("table-1", TABLE_1).scene, read_bench(None).bench
    assert refusals(scene, bench) == []
    plan = make_plan(scene, bench)
    with open_bench(scene, bench, plan.roles) as opened:
        opened.digitizer.configure(plan.shots[0].capture)
        assert opened.digitizer.verify()["record_samples"] == plan.shots[0].capture.record_samples


def test_a_level_at_the_edge_of_the_trigger_range_is_taken(tmp_path: Path) -> None:
    bench = bench_with(tmp_path / "bench.toml", "trigger_level_v = 5.0")
    assert refusals(parse_scene("table-1", TABLE_1).scene, bench) == []


def single_port(folder: Path, *lines: str) -> BenchFile:
    text = read_bench(None).text.replace("dual_port_memory = true", "\n".join(["dual_port_memory = false", *lines]))
    path = folder / "bench.toml"
    path.write_text(text, encoding="utf-8")
    return read_bench(path).bench


def test_a_single_port_capture_is_planned_within_the_records_that_have_a_trigger_time(tmp_path: Path) -> None:
    long = parse_scene("edited", edited(TABLE_1, "tracking", "pulse_count = 1200")).scene
    (refused,) = refusals(long, single_port(tmp_path))
    assert all(word in refused for word in ["memory", "1200 records", "1000", "trigger times", "max_records"]), refused
    bench = single_port(tmp_path, "max_records = 2000")
    results = check_plan(long, bench, make_plan(long, bench))
    (warning,) = [str(result) for result in results if result.check == "trigger times"]
    assert all(word in warning for word in ["above 1000", "counting", "dual-port memory"]), warning
    short = parse_scene("edited", edited(TABLE_1, "tracking", "pulse_count = 1000")).scene
    assert not [each for each in check_plan(short, bench, make_plan(short, bench)) if each.check == "trigger times"]


@pytest.mark.parametrize(("name", "level"), [("table-1", "warning"), ("bovine-muscle", "passed")])
def test_npt_records_without_a_toneburst_in_any_are_warned_of(tmp_path: Path, name: str, level: str) -> None:
    scene = parse_scene(name, shipped_scenes()[name]).scene
    for lines, levels in (('acquisition_mode = "npt"', [level]), ("", [])):
        bench = bench_with(tmp_path / "bench.toml", lines)
        results = check_plan(scene, bench, make_plan(scene, bench))
        assert [result.level for result in results if result.check == "trigger times"] == levels


def test_records_above_a_thousand_are_captured_and_none_is_lost(tmp_path: Path) -> None:
    scene = parse_scene("edited", edited(TABLE_1, "tracking", "pulse_count = 1200")).scene
    bench = single_port(tmp_path, "max_records = 2000")
    # The twin is told of its memory in the scene.
    scene = scene.with_({"simulation.instruments": {"dual_port_memory": False}})
    plan = make_plan(scene, bench)
    with open_bench(scene, bench, plan.roles) as opened:
        blocks = [event.block for event in acquire(plan, opened) if isinstance(event, ShotBlock)]
    records = assemble(blocks, plan.shots[0])
    assert records.valid.all()
    assert np.isnan(records.trigger_time_s).tolist() == [False] * 1000 + [True] * 200


def test_a_board_with_one_range_and_gigasamples_needs_only_a_row_in_the_driver(monkeypatch: pytest.MonkeyPatch) -> None:
    """The fictitious board has 12 bits, 100 MS/s to 2 GS/s and a single input range of 0.4 V."""
    model = BoardModel(
        "ATS0000",
        kind=99,
        code_bits=12,
        sample_rates_hz=(100e6, 200e6, 500e6, 1e9, 1.5e9, 2e9),
        input_ranges_v=(0.4,),
        trigger_range_v=2.5,
    )
    monkeypatch.setattr(DigitizerBoard, "board_model", property(lambda board: model))
    bench = read_bench().bench
    scene = parse_scene("table-1", edited(TABLE_1, "acquisition", "sample_rate_hz = 2e9")).scene
    scene = scene.with_({"acquisition.record_samples": 8192})
    assert make_plan(scene, bench).shots[0].capture.input_range_v == 0.4
    assert refusals(scene, bench) == []
    slower = scene.with_({"acquisition.sample_rate_hz": 50e6})
    assert any("sample rate" in text and "2000 MHz" in text for text in refusals(slower, bench))
    level = bench.model_copy(update={"digitizer": bench.digitizer.model_copy(update={"trigger_level_v": 3.0})})
    assert any("digitizer.trigger_level_v" in text for text in refusals(scene, level))
