"""Studies of scenes with a specimen: every realisation a measurement, and the gate alone agrees where both can tell."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hpe_rig import measure
from hpe_rig.bench import read_bench
from hpe_rig.study import cases as study_cases
from hpe_rig.study.cases import points_of
from hpe_rig.study.definition import Definition
from hpe_rig.study.measured import measure_case
from hpe_rig.study.measured_case import MeasuredCase
from hpe_rig.study.results import CaseRecord
from hpe_rig.study.run import compute
from hpe_rig.study.series import warned_text

FORCES = [[1.0], [0.25]]


def cases_of(**changed: Any) -> list[MeasuredCase]:
    tables = {
        "title": "own",
        "scene": "bovine-muscle",
        "scatterers": 2,
        "noise": 2,
        "corrected": True,
        "common": ["force"],
        "readings": {"physical": ["coherent"]},
        "set": {
            "processing.frequencies_hz": [200.0],
            "excitation.burst_count": 15,
            "processing.window_length_s": 50e-3,
        },
        "axes": [{"name": "force", "keys": {"excitation.force_fraction": FORCES}, "shown": [1.0, 0.25]}],
    } | changed
    cases = [point.case for point in points_of("own", Definition.model_validate(tables))]
    return [case for case in cases if isinstance(case, MeasuredCase)]


def estimate(record: CaseRecord) -> dict[str, Any]:
    (row,) = record["estimates"]
    return dict(row)


def test_a_medium_under_its_tonebursts_is_studied_over_any_key_of_its_scene() -> None:
    full, quarter = (estimate(record) for record in compute(cases_of(scatterers=1)))
    # The force is proportional to the drive squared, which force_fraction is; the medium is linear.
    assert quarter["amplitude_true_m"] / full["amplitude_true_m"] == pytest.approx(0.25, rel=1e-3)
    assert full["phase_true_rad"] == pytest.approx(quarter["phase_true_rad"], abs=1e-3)
    for row in (full, quarter):
        assert row["refused"] == 0
        assert 0 < row["amplitude_jitter_m"] < 0.2 * row["amplitude_true_m"]


def test_a_realisation_is_the_measurement_of_its_seed(tmp_path: Path) -> None:
    case = cases_of(scatterers=1)[0]
    row = estimate(measure_case(case))
    deviations = []
    for shot in measure(case.seeded(0), path=tmp_path / "run.h5").estimate("coherent").shots:
        (found,) = shot.estimates
        assert found.corrected
        assert found.true_amplitude_m is not None
        deviations.append(found.amplitude_m - found.true_amplitude_m)
    assert len(deviations) == 2
    assert row["amplitude_bias_m"] == pytest.approx(np.mean(deviations), rel=1e-12)
    assert row["amplitude_jitter_m"] == pytest.approx(np.std(deviations), rel=1e-12)


def test_realisations_that_their_result_warns_of_are_counted() -> None:
    (case,) = cases_of(
        scatterers=1, axes=[{"name": "force", "keys": {"excitation.force_fraction": [[1e-3]]}, "shown": [1e-3]}]
    )
    row = estimate(measure_case(case))
    assert (row["refused"], row["warned"]) == (0, 2)
    text = warned_text([{**row, "draws": 1, "noise": 2}, {**row, "warned": 0, "draws": 1, "noise": 2}])
    assert text.startswith(
        "2 of 4 estimates are of shots with warnings. The worst case has 2 of 2, at 200 Hz with coherent."
    )
    assert warned_text([{**row, "warned": 0}, {"refused": 0}]) == ""


def test_a_case_measured_by_another_version_or_on_another_bench_is_another(monkeypatch: pytest.MonkeyPatch) -> None:
    keys = {cases_of()[0].key, cases_of()[0].key}
    monkeypatch.setattr(study_cases, "version", lambda _: "another")
    keys.add(cases_of()[0].key)
    monkeypatch.undo()
    own = dataclasses.replace(read_bench(), text=read_bench().text.replace("[limits]", "[limits] # lower"))
    monkeypatch.setattr(study_cases, "read_bench", lambda: own)
    keys.add(cases_of()[0].key)
    assert len(keys) == 3


def test_seeds_are_common_along_an_axis_where_asked_and_no_two_draws_share_one() -> None:
    def seeds(**changed: Any) -> list[list[int]]:
        return [[(case.seeded(k).simulation or {})["seed"] for k in range(3)] for case in cases_of(**changed)]

    full, quarter = seeds()
    assert full == quarter
    assert len({*full, *seeds(common=[])[0], *seeds(common=[])[1], *seeds(seed=2)[0]}) == 12 - 3
    assert seeds(scatterers=7) == [full, quarter]


@pytest.mark.parametrize(
    ("scene", "key", "values"),
    [
        ("muscle-pulse-rate", "tracking.pulse_rate_hz", [3000.0, 4000.0]),
        ("muscle-window", "processing.window_length_s", [0.1, 0.2]),
    ],
)
def test_an_axis_counts_where_the_scene_takes_the_same_setting_in_turn(
    scene: str, key: str, values: list[float]
) -> None:
    cases = cases_of(scene=scene, set={}, axes=[{"name": "own", "keys": {key: values}}], common=[])
    section, name = key.split(".")
    assert [getattr(getattr(case.scene, section), name) for case in cases] == values
    assert len({case.key for case in cases}) == 2


@pytest.mark.slow
def test_whole_measurements_and_the_gate_alone_find_the_same_bias() -> None:
    tables = {
        "title": "own",
        "scene": "table-1",
        "scatterers": 200,
        "readings": {"physical": ["coherent"]},
        "axes": [{"name": "SNR", "keys": {"simulation.receiver.snr_db": [30.0]}}],
    }
    rows = []
    for how in ("gate", "bench"):
        (point,) = points_of("own", Definition.model_validate(tables | {"simulate": how}))
        rows.append(estimate(compute([point.case])[0]))
    for name, unit in (("amplitude_bias", "m"), ("phase_bias", "rad")):
        difference = rows[0][f"{name}_{unit}"] - rows[1][f"{name}_{unit}"]
        # Independent draws: four standard errors of the difference are passed by one study in 16 000.
        assert abs(difference) < 4 * np.hypot(rows[0][f"{name}_se_{unit}"], rows[1][f"{name}_se_{unit}"])
