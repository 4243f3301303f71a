"""Two runs side by side: what differs in their settings, and which differences of their results are none of chance."""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace
from pathlib import Path

import jsonschema
import pytest
from scipy.special import chdtrc
from typer.testing import CliRunner

import hpe_rig as hpe
from hpe_rig.cli.app import app
from hpe_rig.report import compare_runs
from hpe_rig.report.comparison import _flat, _probability
from hpe_rig.result.svg import ON_DARK


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, Path]:
    """Return a run, one of another specimen of the same kind, and one of a motion half as large."""
    folder, scene = tmp_path_factory.mktemp("compare"), hpe.load_scene("table-1")
    changes = ({}, {"simulation.seed": 7}, {"simulation.motion[0].amplitude_m": 500e-9, "tracking.delay_s": 1e-4})
    names = ("a.h5", "b.h5", "c.h5")
    for name, change in zip(names, changes, strict=True):
        hpe.measure(scene.with_(change), path=folder / name)
    first, second, third = (folder / name for name in names)
    return first, second, third


def test_a_run_agrees_with_itself(runs: tuple[Path, Path, Path]) -> None:
    found = compare_runs(runs[0], runs[0])
    assert found.settings == ()
    assert [row.verdict for row in found.results] == ["agrees"]
    assert [(row.p_all, row.p_noise) for row in found.results] == [(1.0, 1.0)]


def test_a_default_and_an_absent_setting_are_equal(tmp_path: Path, runs: tuple[Path, Path, Path]) -> None:
    scene = hpe.load_scene("table-1")
    hpe.measure(scene.with_({"tracking.delay_s": 0.0, "processing.flag_pulses": True}), path=tmp_path / "stated.h5")
    assert compare_runs(runs[0], tmp_path / "stated.h5").settings == ()


def test_an_imported_recording_differs_from_a_bench_in_one_setting_and_the_result_comes_first(
    tmp_path: Path, runs: tuple[Path, Path, Path]
) -> None:
    hpe.export_run(runs[0], tmp_path / "a.hdf5")
    again = hpe.import_records(tmp_path / "a.hdf5", "table-1", tmp_path / "again.h5")
    of_bench = [item for item in compare_runs(runs[0], again.path).settings if item.where != "scene"]
    assert [(item.where, item.what, item.before) for item in of_bench] == [("bench file", "imported from", None)]
    done = CliRunner().invoke(app, ["compare", str(runs[0]), str(again.path)])
    assert 0 <= done.output.index("agrees") < done.output.index("settings differ")


def test_other_speckle_differs_only_if_the_place_were_the_same(runs: tuple[Path, Path, Path]) -> None:
    found = compare_runs(runs[0], runs[1])
    assert [(each.where, each.what, each.before, each.after) for each in found.settings] == [
        ("scene", "simulation.seed", 1, 7)
    ]
    (row,) = found.results
    assert row.verdict == "differs if alike"
    assert row.p_noise < 1e-6 < 0.01 < row.p_all
    first, second = found.sentence().split(". If ")
    assert first.startswith("the only result does not differ; most changed at 200 Hz: amplitude ")
    assert second == "position, beams and specimen are the same in both runs, 1 of 1 result differs"


def test_half_the_motion_is_told_from_chance_whatever_else_differs(runs: tuple[Path, Path, Path]) -> None:
    found = compare_runs(runs[0], runs[2])
    changed = {(each.where, each.what): (each.before, each.after) for each in found.settings}
    assert changed[("scene", "tracking.delay_s")] == (0.0, 1e-4)
    assert changed[("scene", "simulation.motion[0].amplitude_m")] == (1e-6, 5e-7)
    assert changed[("set: tracking pulse train", "delay (s)")] == (0.0, 1e-4)
    (row,) = found.results
    assert row.amplitude_change == pytest.approx(-0.5, abs=0.01)
    assert row.verdict == "differs"
    assert row.phase_change_over_u == pytest.approx(row.phase_change_rad / math.hypot(*row.phase_uncertainty_rad))
    assert row.p_all == pytest.approx(chdtrc(2, row.amplitude_change_over_u**2 + row.phase_change_over_u**2))
    u = abs(row.amplitude_change_over_u)
    assert found.sentence().startswith(f"1 of 1 result differs; most changed at 200 Hz: amplitude -50.0 % ({u:.1f} u)")
    figure = found.figure()
    # Both runs above, and their difference in u below.
    assert [len(panel.lines) for panel in figure.axes] == [2, 2, 1, 1]
    assert figure.axes[2].lines[0].get_ydata()[0] < -5


def test_runs_whose_phases_count_from_different_events_are_refused_in_one_sentence(
    runs: tuple[Path, Path, Path], tmp_path: Path
) -> None:
    pushed = hpe.measure("bovine-muscle", path=tmp_path / "m.h5")
    done = CliRunner().invoke(app, ["compare", str(runs[0]), str(pushed.path)])
    assert done.exit_code == 2
    message = " ".join(done.stderr.split())
    assert "a.h5 and m.h5 cannot be compared" in message
    assert "from the master trigger's edge and from the first toneburst's arrival at the gate" in message


@pytest.mark.parametrize(("amplitude", "phase"), [(0.3, 0.1), (2.0, 0.0), (1.0, -3.0)])
def test_the_probability_is_that_of_chi_square_with_two_degrees_of_freedom(amplitude: float, phase: float) -> None:
    found = _probability((amplitude * 2e-9, phase * 0.01), (2e-9, 0.01))
    assert found == pytest.approx(chdtrc(2, amplitude**2 + phase**2), rel=1e-12)
    assert _probability((0.0, 0.0), (0.0, 0.0)) == 1.0
    assert _probability((1.0, 0.0), (0.0, 1.0)) == 0.0


def test_a_removed_cable_is_one_difference_and_leaves_the_others_as_they_are() -> None:
    cables = [{"source": f"a{index}.output", "target": "b.trigger", "delay_s": 5e-9} for index in range(3)]
    before, after = dict(_flat({"wiring": cables})), dict(_flat({"wiring": cables[1:]}))
    assert before.items() - after.items() == {("cable a0.output -> b.trigger", "delay_s = 5e-09")}
    assert after.items() <= before.items()


def test_repeats_are_compared_by_their_means_and_what_has_no_partner_is_named(
    runs: tuple[Path, Path, Path], tmp_path: Path
) -> None:
    scene = hpe.load_scene("table-1")
    repeated = hpe.measure(scene.with_({"acquisition.repeats": 2}), path=tmp_path / "twice.h5")
    (row,) = compare_runs(runs[0], repeated.path).results
    assert row.shots == ("1", "mean of 2")
    assert row.amplitude_m[1] == repeated.estimate().means[0].amplitude_m
    swept = hpe.sweep(scene, {"tracking.delay_s": [0.0, 1e-4]}, path=tmp_path / "swept.h5")
    found = compare_runs(runs[0], swept.path)
    assert found.results == ()
    assert len(found.alone) == 3
    assert "tracking.delay_s = 0.0001: in swept.h5 alone" in found.alone[2]


def test_several_settings_have_one_table_with_a_row_each(tmp_path: Path, runs: tuple[Path, Path, Path]) -> None:
    scene = hpe.load_scene("table-1").with_({"tracking.pulse_count": 40})
    swept = hpe.sweep(scene, {"tracking.delay_s": [0.0, 1e-4]}, path=tmp_path / "a.h5")
    other = hpe.sweep(scene.with_({"simulation.seed": 7}), {"tracking.delay_s": [0.0, 1e-4]}, path=tmp_path / "b.h5")
    comparison = compare_runs(swept.path, other.path)
    assert comparison.varied_settings() == ["tracking.delay_s"]
    printed = CliRunner().invoke(app, ["compare", str(swept.path), str(other.path)], env={"COLUMNS": "80"}).stdout
    assert max(map(len, printed.splitlines())) <= 80
    table = [line.split() for line in printed.splitlines() if "200" in line.split()[1:2]]
    assert [cells[0] for cells in table] == ["0", "0.0001"]
    for cells, row in zip(table, comparison.results, strict=True):
        assert float(cells[5]) == pytest.approx(row.amplitude_change_over_u, abs=0.05)
        assert float(cells[7]) == pytest.approx(row.phase_change_over_u, abs=0.05)


def test_the_command_prints_both_and_writes_json_and_figure(runs: tuple[Path, Path, Path], tmp_path: Path) -> None:
    first, _, third = map(str, runs)
    done = CliRunner().invoke(app, ["compare", first, third, "--figure", str(tmp_path / "c.svg")])
    assert done.exit_code == 0
    assert "differs" in done.stdout
    drawn = (tmp_path / "c.svg").read_text(encoding="utf-8")
    assert "prefers-color-scheme: dark" in drawn
    # Nothing keeps a light screen's colour on a dark one.
    _, _, shapes = drawn.partition("</style>")
    assert set(re.findall(r"(?:fill|stroke): (#\w+)", shapes)) - set(ON_DARK) == set()
    printed = json.loads(CliRunner().invoke(app, ["compare", first, third, "--json"]).stdout)
    (row,) = printed["results"]
    assert row["verdict"] == "differs"
    assert math.isfinite(row["amplitude_change"])
    schema = json.loads(CliRunner().invoke(app, ["schema", "compare"]).stdout)
    jsonschema.Draft202012Validator.check_schema(schema)
    validator = jsonschema.Draft202012Validator(schema)
    validator.validate(printed)
    assert {each["where"] for each in printed["settings"]} >= {"scene"}
    del row["p_all"]
    row["amplitude_m"] = [1.0]
    printed["another"] = 1
    assert len(list(validator.iter_errors(printed))) == 3
    assert CliRunner().invoke(app, ["compare", first, "nowhere.h5"]).exit_code == 2


def test_a_difference_of_values_without_uncertainty_has_no_ratio_in_text(runs: tuple[Path, Path, Path]) -> None:
    found = compare_runs(runs[0], runs[2])
    (row,) = found.results
    exact = replace(row, amplitude_uncertainty_m=(0.0, 0.0), phase_uncertainty_rad=(0.0, 0.0), p_all=0.0)
    sentence = replace(found, results=(exact,)).sentence()
    assert sentence.count("(u is 0)") == 2
    assert "inf" not in sentence


def test_a_force_has_the_four_digits_of_its_voltage(runs: tuple[Path, Path, Path]) -> None:
    (row,) = compare_runs(runs[0], runs[2]).results
    assert "force_fraction = 0.5," in replace(row, settings={"force_fraction": 0.49999, "pulse_rate_hz": 4e3}).setting
