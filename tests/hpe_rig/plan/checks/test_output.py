"""What the generators cannot do is found with the plan, by the rules of their drivers, before anything is opened."""

from __future__ import annotations

from pathlib import Path

import pytest

from drivers.agilent.models import MODELS as GENERATOR_MODELS
from drivers.alazar.models import MODELS as BOARD_MODELS
from drivers.interfaces import InstrumentError
from hpe_rig.bench import DigitizerBoard, read_bench
from hpe_rig.bench.bench_file import Generator
from hpe_rig.bench.opening import open_bench
from hpe_rig.measurement.sequencer import acquire
from hpe_rig.measurement.setup import prepare_text
from hpe_rig.plan.checks.check_result import PlanError
from hpe_rig.plan.checks.checklist import check_plan
from hpe_rig.plan.shots import make_plan
from hpe_rig.scene import mistakes_of, parse_scene, shipped_scenes

MUSCLE = shipped_scenes()["bovine-muscle"]


def test_a_bench_file_names_the_models_that_have_a_driver_and_no_others() -> None:
    for section, models, unknown, close in (
        (Generator, GENERATOR_MODELS, "33251A", "33250A"),
        (DigitizerBoard, BOARD_MODELS, "ATS461", "ATS460"),
    ):
        for model in models:
            assert not mistakes_of(section, {"model": model.name})
        (mistake,) = mistakes_of(section, {"model": unknown})
        assert all(model.name in mistake.remedy for model in models)
        assert f"did you mean {close!r}?" in mistake.remedy


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (
            "burst_count = 20",
            "burst_count = 20\nforce_fraction = 1e-9",
            ["toneburst", "0.001", "force_fraction"],
        ),
        ("[tracking]", "[tracking]\ncarrier_hz = 26e6", ["tracking_pulser", "25000000", "tracking.carrier_hz"]),
        ("delay_s = 131e-6", "delay_s = 90.0", ["tracking_train", "85", "delay_s"]),
    ],
)
def test_what_a_driver_would_refuse_is_refused_with_the_plan(old: str, new: str, words: list[str]) -> None:
    assert old in MUSCLE
    text = MUSCLE.replace(old, new)
    with pytest.raises(PlanError) as raised:
        prepare_text("edited", text)
    (line,) = [line for line in str(raised.value).splitlines() if line.strip().startswith("generators:")]
    assert all(word in line for word in [*words, "Try:"]), line
    scene, bench = parse_scene("edited", text).scene, read_bench(None).bench
    plan = make_plan(scene, bench)
    # The oracle: the driver itself, at the simulated instrument.
    with open_bench(scene, bench, plan.roles) as opened, pytest.raises(InstrumentError, match="no setting was sent"):
        list(acquire(plan, opened))


def test_a_swing_above_the_bench_files_bound_is_refused_with_the_plan(tmp_path: Path) -> None:
    text = read_bench(None).text
    assert "[generators.toneburst]" in text
    path = tmp_path / "bench.toml"
    path.write_text(text.replace("[generators.toneburst]", "[generators.toneburst]\nmax_vpp = 0.5"), encoding="utf-8")
    scene, bench = parse_scene("muscle", MUSCLE).scene, read_bench(path).bench
    found = check_plan(scene, bench, make_plan(scene, bench))
    (refused,) = [finding for finding in found if finding.level == "refused"]
    assert "above max_vpp = 0.5" in refused.text


@pytest.mark.parametrize(("name", "drives"), [("bovine-muscle", 2), ("table-1", 1)])
def test_the_drive_is_judged_of_what_drives(name: str, drives: int) -> None:
    found = [
        finding.text for finding in prepare_text(name, shipped_scenes()[name]).findings if finding.check == "drive"
    ]
    assert len(found) == drives
    assert not any(" 0 Vpp" in text.partition(",")[0] for text in found)
