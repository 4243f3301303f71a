"""`check`, report and design print the same detection floor, noise, bias and speckle for the same scene."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest

from hpe_rig.design.comparison import _outcome
from hpe_rig.design.problem import Problem
from hpe_rig.measurement.setup import prepare
from hpe_rig.prediction.detection import detection_floor
from hpe_rig.prediction.forecast import conditions_of, forecast_of, predict
from hpe_rig.processing import ESTIMATORS
from hpe_rig.report.page import write_report
from hpe_rig.runs import check, measure
from hpe_rig.scene import load_scene, shipped_scenes
from hpe_rig.study import one_shot

FAST = {"table-1"}
NAMES = [pytest.param(name, marks=() if name in FAST else pytest.mark.slow) for name in shipped_scenes()]


def printed(pattern: str, text: str) -> str:
    found = re.search(pattern, text)
    assert found, (pattern, text[-2000:])
    return found[1]


@pytest.mark.parametrize("name", NAMES)
def test_every_page_prints_the_same_floor_and_the_same_noise(name: str, tmp_path: Path) -> None:
    scene = one_shot(load_scene(name))
    checked = str(check(scene))
    floor = printed(r"detection floor: (\S+) nm", checked)
    page = tmp_path / "report.html"
    run = measure(scene, path=tmp_path / "run.h5")
    write_report(run.path, output=page)
    html = page.read_text(encoding="utf-8")
    assert printed(r"<dt>detection floor</dt><dd>(\S+) nm", html) == floor
    if "prediction: omitted" in checked:
        return
    setup = prepare(scene, refuse=False)
    problem = Problem(setup, tomllib.loads(setup.scene.text), (), "jitter", longest_s=1.0)
    designed = _outcome(problem, problem.judged(problem.start), 0, 0).values
    assert f"{designed['detection_floor_m'] * 1e9:.3g}" == floor
    estimator, hz = scene.processing.estimator, scene.wanted_frequencies_hz[0]
    noise = printed(rf"\n  {estimator} +\S+ nm +(\S+) nm", checked)
    assert f"{designed['quadrature_noise_m'] * 1e9:.3g}" == noise
    figures = re.findall(r"(\S+) nm", printed(rf"\n  ({estimator} .*)", checked))
    for key, figure in (("predicted_bias_m", figures[0]), ("speckle_m", figures[-1])):
        assert designed[key] * 1e9 == pytest.approx(float(figure), rel=6e-3)
    row = printed(rf'<tr><th scope="row">{hz:g}</th>((?:<td>[^<]*</td>){{6}})\s*</tr>', html)
    assert re.findall(r"<td>([^<]*)</td>", row)[2] == noise


def test_the_floor_has_the_noise_of_the_worst_frequency() -> None:
    setup = prepare("bovine-muscle", refuse=False)
    scene, shot = setup.scene.scene, setup.plan.shots[0]
    each = [conditions_of(scene, shot, hz, "coherent") for hz in scene.wanted_frequencies_hz]
    worst = max(predict(one, ("coherent",)).expected[0].quadrature_m for one in each if one is not None)
    assert detection_floor(scene, True, shot).noise_m == pytest.approx(worst, rel=1e-9)


def test_the_stated_uncertainty_is_the_predicted_noise(tmp_path: Path) -> None:
    run = measure("bovine-muscle", path=tmp_path / "run.h5")
    found = forecast_of(run.scene, run.plan.shots[0])
    assert found is not None
    first = run.estimate().shots[0].estimates[0]
    # SNR of this draw of scatterers, noise of 598 residuals, and 0.19 nm of aliasing on 0.77
    assert first.tracked_amplitude_uncertainty_m == pytest.approx(found.error_m(ESTIMATORS.index("coherent")), rel=0.25)


@pytest.mark.parametrize(
    "name",
    [
        "bovine-muscle",
        *(pytest.param(name, marks=pytest.mark.slow) for name in ("bovine-muscle-synchronous", "muscle-force")),
    ],
)
def test_an_estimator_that_aliasing_biases_is_not_recommended(name: str) -> None:
    setup = prepare(name, refuse=False)
    found = forecast_of(setup.scene.scene, setup.plan.shots[0])
    assert found is not None
    names = [each.estimator for each in found.expected]
    coherent, paper = (found.error_m(names.index(each)) for each in ("coherent", "cross_spectrum"))
    assert coherent < paper
    best = re.search(r"smallest noise and aliasing together: (\w+)", str(check(name)))
    assert best is not None
    assert best[1] != "cross_spectrum"
