"""What the board cannot do is found with the plan, by the rules of its driver, before anything is opened."""

from __future__ import annotations

from pathlib import Path

import pytest

from drivers.interfaces import InstrumentError
from hpe_rig.acquire.sequencer import acquire
from hpe_rig.bench.bench_file import BenchFile, read_bench
from hpe_rig.bench.opening import open_bench
from hpe_rig.plan.checks.checklist import check_plan
from hpe_rig.plan.shots import make_plan
from hpe_rig.scene.scene import Scene, parse_scene, shipped_scenes

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
    ("acquisition", "sample_rate_hz = 25e6", ["sample rate", "acquisition.sample_rate_hz = 2.5e+07", "20, 50"]),
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
