"""Moduli from the shipped scene, from the run to the numbers, as a user gets them."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
from typer.testing import CliRunner

import hpe_rig as hpe
from hpe_rig.cli.app import app
from hpe_rig.measurement import prepare
from hpe_rig.measurement.between_shots import require_mover
from hpe_rig.moduli import ModuliResult
from hpe_rig.report.page import _scene_at
from hpe_rig.runs import json_schema
from hpe_rig.runs.api import _refuse_repeated_data
from hpe_rig.scene import SettingsError, load_scene

SHORT = {
    "sweep.lateral_offset_m": [1e-3, 3.5e-3, 6e-3],
    "excitation.burst_count": 15,
    "processing.window_start_s": 50e-3,
    "processing.frequencies_hz": [100.0, 200.0, 300.0, 500.0],
}


@pytest.fixture(scope="module", params=[SHORT, pytest.param({}, marks=pytest.mark.slow)], ids=["short", "shipped"])
def run(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> hpe.Run:
    """Return a run of the shipped scene, by default of fewer offsets, tonebursts and harmonics."""
    scene = load_scene("gelatin-moduli").with_(request.param)
    return hpe.measure(scene, path=tmp_path_factory.mktemp("moduli") / "run.h5")


def as_its_schema_says(result: ModuliResult) -> dict[str, Any]:
    schema = json_schema("moduli")
    jsonschema.Draft202012Validator.check_schema(schema)
    printed: dict[str, Any] = json.loads(json.dumps(result.as_dict(), allow_nan=False))
    validator = jsonschema.Draft202012Validator(schema)
    validator.validate(printed)
    wrong = {**printed, "places": [{**printed["places"][0], "lateral_m": "near"}], "another": 1}
    assert len(list(validator.iter_errors(wrong))) == 2
    return printed


def test_the_moduli_of_the_shipped_scene_are_the_twins(run: hpe.Run) -> None:
    short = run.scene.excitation.burst_count == 15
    result = hpe.fit_moduli(run, laws=["voigt", "maxwell"] if short else ())
    best = result.best
    assert best.law == "voigt"
    for name, true in (("shear_modulus_pa", 7.25e3), ("viscosity_pa_s", 1.0)):
        assert abs(best.values[name] - true) < 3 * best.uncertainty[name]
        assert best.uncertainty[name] < (0.05 if short else 0.015) * true
    assert not best.excluded
    assert {fit.law for fit in result.fits if fit.excluded} == ({"maxwell"} if short else {"power_law", "maxwell"})
    assert "Voigt" in str(result)
    assert as_its_schema_says(result)["fits"][0]["law"] == "voigt"
    assert len(result.figure().axes) == 2


@pytest.mark.slow
@pytest.mark.parametrize("run", [{}], indirect=True)
def test_the_phase_velocity_of_the_shipped_scene_is_the_twins(run: hpe.Run, tmp_path: Path) -> None:
    """gelatin-moduli, seed 1: c and alpha of the Voigt medium of 7.25 kPa and 1 Pa s, and the bias of other methods."""
    printed = CliRunner().invoke(app, ["dispersion", str(run.path), "--json", "--figure", str(tmp_path / "c.svg")])
    assert printed.exit_code == 0, printed.output
    assert (tmp_path / "c.svg").read_text(encoding="utf-8").startswith("<?xml")
    result = json.loads(printed.stdout)
    jsonschema.Draft202012Validator(json_schema("dispersion")).validate(result)
    for row in result["rows"]:
        omega = 2 * np.pi * row["frequency_hz"]
        wavenumber = omega * np.sqrt(1000 / (7.25e3 + 1j * omega))
        speed, attenuation = omega / wavenumber.real, -wavenumber.imag
        true = {"phase_velocity": ("m_per_s", speed), "attenuation": ("np_per_m", attenuation)}
        for quantity, (unit, value) in true.items():
            measured, u, bias = (row[f"{quantity}{kind}_{unit}"] for kind in ("", "_uncertainty", "_bias"))
            if measured is not None:
                assert abs(measured - (bias or 0.0) - value) < 4 * u
    moduli = CliRunner().invoke(app, ["moduli", str(run.path), "--law", "voigt", "--json"])
    fitted = json.loads(moduli.stdout)["fits"][0]["dispersion"]
    near = [row["phase_velocity_m_per_s"] for row in result["rows"] if row["method"] == "near field"]
    assert fitted["phase_velocity_m_per_s"] == pytest.approx(near, rel=0.003)


def test_a_figure_of_dispersion_refuses_frequencies_and_gates_over_depth(run: hpe.Run) -> None:
    options = ["--kind", "dispersion", "--frequency", "100", "--gate-profile-step", "1mm", "-o", "never.pdf"]
    refused = CliRunner().invoke(app, ["figure", str(run.path), *options])
    assert refused.exit_code != 0
    assert "--kind dispersion draws all frequencies" in refused.output
    assert "--kind dispersion uses the gates of the scene" in refused.output
    both = CliRunner().invoke(app, ["dispersion", str(run.path), "--json", "--csv"])
    assert "both formats are requested" in both.output


def test_every_offset_has_a_truth_and_an_estimate(run: hpe.Run) -> None:
    result = run.estimate()
    places = [shot.lateral_offset_m for shot in result.shots]
    assert places == list(run.scene.sweep.lateral_offset_m)
    true_m = [shot.estimates[0].true_amplitude_m or 0.0 for shot in result.shots]
    assert np.all(np.diff(true_m) < 0)
    for shot in result.shots:
        first = shot.estimates[0]
        # 100 Hz: speckle moves the middle of what is tracked by some 30 um, which changes it by less than 3 %
        assert abs(first.amplitude_error or 1.0) < 0.03
    with_places = result.as_dict()["shots"][1]
    assert with_places["lateral_offset_m"] == places[1]


@pytest.mark.slow
def test_two_runs_of_one_offset_each_give_the_moduli(tmp_path: Path) -> None:
    one_place = {"sweep.lateral_offset_m": [1.0e-3]}
    other = {"sweep.lateral_offset_m": [3.5e-3]}
    scene = load_scene("gelatin-moduli")
    parts = [hpe.measure(scene.with_(each), path=tmp_path / f"{i}.h5") for i, each in enumerate((one_place, other))]
    both, alone = hpe.fit_moduli(*parts, laws=["voigt"]), hpe.fit_moduli(parts[0], laws=["voigt"])
    as_its_schema_says(alone)
    name = "shear_modulus_pa"
    assert abs(both.best.values[name] - 7.25e3) < 3 * both.best.uncertainty[name]
    assert both.best.uncertainty[name] < alone.best.uncertainty[name] / 2


def test_the_command_prints_what_the_function_returns(run: hpe.Run, tmp_path: Path) -> None:
    figure = tmp_path / "fit.png"
    done = CliRunner().invoke(app, ["moduli", str(run.path), "--law", "voigt", "--figure", str(figure)])
    assert done.exit_code == 0, done.output
    assert "shear modulus mu1 7." in done.stdout
    assert figure.stat().st_size > 1000
    wrong = CliRunner().invoke(app, ["moduli", str(run.path), "--law", "jelly"])
    assert wrong.exit_code == 2
    assert "voigt, zener, power_law, maxwell" in wrong.output


def test_the_same_run_twice_is_refused_under_any_name(run: hpe.Run, tmp_path: Path) -> None:
    """It would count as independent data, with u too small by the square root of 2."""
    copy = tmp_path / "copy.h5"
    shutil.copyfile(run.path, copy)
    for command in ("moduli", "dispersion"):
        refused = CliRunner().invoke(app, [command, str(run.path), str(copy)])
        assert refused.exit_code == 2
        assert f"{copy} is the same run as {run.path}" in refused.output.replace("\n", "")


def test_two_runs_of_one_scene_are_not_the_same_run_and_a_continued_one_is(run: hpe.Run) -> None:
    again = replace(run, stored=replace(run.stored, provenance=replace(run.stored.provenance, started="later")))
    _refuse_repeated_data("moduli", [run, again])
    continued = replace(again, path=Path("run-1.h5"), stored=replace(again.stored, predecessor=run.path.name))
    with pytest.raises(SettingsError, match=r"run-1\.h5 continues .*run\.h5 and contains its shots"):
        _refuse_repeated_data("moduli", [run, continued])


def test_a_scene_without_push_is_refused_with_all_reasons(tmp_path: Path) -> None:
    lacking = hpe.measure("table-1", path=tmp_path / "run.h5")
    with pytest.raises(SettingsError, match="nothing pushes"):
        hpe.fit_moduli(lacking)
    with pytest.raises(SettingsError, match="no run is named"):
        hpe.fit_moduli()


def test_the_report_describes_the_offset_of_its_shot(run: hpe.Run) -> None:
    last = run.estimate().shots[-1]
    assert _scene_at(run, last).tracking.lateral_offset_m == 6e-3
    assert not _scene_at(run, last).sweep.lateral_offset_m


def test_several_offsets_on_a_bench_need_a_mover() -> None:
    plan = prepare("gelatin-moduli").plan
    require_mover(plan, simulated=True, move=None)
    require_mover(plan, simulated=False, move=lambda lateral_m: None)
    with pytest.raises(SettingsError, match=r"hpe_rig\.stages"):
        require_mover(plan, simulated=False, move=None)
