"""Definitions and their cases: shipped ones, mistakes, random numbers that belong to a case."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hpe_rig.scene import SettingsError, shipped_scenes
from hpe_rig.study.cases import GridPoint, points_of
from hpe_rig.study.definition import AxisRange, AxisTable, Definition, read_studies, shipped_studies
from hpe_rig.study.measured_case import MeasuredCase

SIZES = {"fig-4": 1, "fig-5": 5, "fig-6": 5, "fig-7": 6, "fig-8": 5, "fig-9": 3, "fig-10": 3, "fig-11": 4}

PLAIN = """
title = "two SNR"
scene = "table-1"
[set]
"tracking.pulse_count" = 40
[[axes]]
name = "SNR"
keys = { "simulation.receiver.snr_db" = [10.0, 20.0] }
"""


def _points(text: str, tmp_path: Path, **replaced: object) -> list[GridPoint]:
    (tmp_path / "own.toml").write_text(text, encoding="utf-8")
    ((name, (definition, folder)),) = read_studies(str(tmp_path / "own.toml"), replaced).items()
    return points_of(name, definition, folder)


def _mistakes(text: str, tmp_path: Path) -> str:
    with pytest.raises(SettingsError) as caught:
        _points(text, tmp_path)
    return str(caught.value)


def test_the_shipped_studies_are_the_paper_s_figures_at_its_sizes() -> None:
    studies = {name: definition for name, (definition, _) in read_studies("paper").items()}
    assert list(studies) == [f"fig-{n}" for n in range(4, 14)]
    counts = {name: [len(axis) for axis in one.sweep_axes] for name, one in studies.items()}
    assert {name: int(np.prod(counts[name])) for name in SIZES} == {name: 7 * size for name, size in SIZES.items()}
    assert (counts["fig-12"], counts["fig-13"]) == ([1, 11, 11], [4, 11, 11])
    assert {studies[name].scatterers for name in SIZES} == {160}
    assert {studies[name].scatterers for name in ("fig-12", "fig-13")} == {112}
    readings = {"physical", "literal", "as_printed", "one_draw"}
    assert all(set(studies[name].readings) == readings for name in SIZES)
    assert len(points_of("fig-4", studies["fig-4"])) == 7 * 4


def test_figures_share_the_cases_they_have_in_common() -> None:
    default = {point.case.key for point in points_of("fig-4", *read_studies("fig-4")["fig-4"])}
    for name in ("fig-5", "fig-7", "fig-9"):
        assert default <= {point.case.key for point in points_of(name, *read_studies(name)[name])}


def test_points_refine_every_range_and_nothing_else() -> None:
    (definition, _) = read_studies("fig-12", {"points": 101})["fig-12"]
    assert [len(axis) for axis in definition.sweep_axes] == [1, 101, 101]
    coarse = read_studies("fig-12")["fig-12"][0].sweep_axes[1].labels
    assert set(coarse) <= set(definition.sweep_axes[1].labels)
    np.testing.assert_allclose(coarse, np.geomspace(0.1, 10, 11), rtol=1e-11)


def test_axes_multiply_and_keys_of_an_axis_go_together(tmp_path: Path) -> None:
    text = PLAIN + '[[axes]]\nname = "N_p"\nshown = [10, 20]\n[axes.keys]\n'
    text += '"tracking.pulse_rate_hz" = [2000.0, 4000.0]\n"tracking.pulse_count" = [50, 100]\n'
    points = _points(text, tmp_path)
    assert [(p.coordinates["SNR"], p.coordinates["N_p"]) for p in points] == [(10, 10), (10, 20), (20, 10), (20, 20)]
    assert [(p.case.train.pulse_rate_hz, p.case.train.pulses) for p in points[:2]] == [(2000.0, 50), (4000.0, 100)]


def test_the_literal_reading_has_no_delay_of_depth_and_scatterers_in_the_gate_alone(tmp_path: Path) -> None:
    physical, literal = (
        _points(PLAIN + f'[readings]\n{reading} = ["coherent"]\n', tmp_path)[0].case.twin.scatterers
        for reading in ("physical", "literal")
    )
    assert (physical.axial_delay, physical.volume_m) == ("two_way", (1e-3, 1e-3, 5e-3))
    assert (literal.axial_delay, literal.volume_m) == ("none", (1e-3, 1e-3, 1e-3))


def test_random_numbers_are_common_where_asked_and_else_each_case_s_own(tmp_path: Path) -> None:
    def streams(common: str) -> set[int]:
        return {point.case.stream for point in _points(f"common = {common}\n" + PLAIN, tmp_path)}

    assert len(streams("[]")) == 2
    assert len(streams('["SNR"]')) == 1
    assert streams('["SNR"]') != streams('"all"')
    assert streams('["SNR"]') == {_points('common = ["SNR"]\n' + PLAIN, tmp_path, scatterers=7)[0].case.stream}
    assert streams('["SNR"]') != {_points('common = ["SNR"]\n' + PLAIN, tmp_path, seed=2)[0].case.stream}


def test_a_case_s_name_changes_with_whatever_changes_its_numbers(tmp_path: Path) -> None:
    plain = _points(PLAIN, tmp_path)[0].case.key
    others = [
        _points(PLAIN, tmp_path, **{key: value})[0].case.key
        for key, value in (("scatterers", 7), ("noise", 3), ("seed", 2), ("standard_error_m", 1e-9))
    ]
    others.append(_points(PLAIN.replace("40", "41"), tmp_path)[0].case.key)
    others.append(_points(PLAIN + '[readings]\nphysical = ["kasai"]\n', tmp_path)[0].case.key)
    assert len({plain, *others}) == 7
    assert _points(PLAIN.replace("two SNR", "another title"), tmp_path)[0].case.key == plain


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("tracking.delay_s", 1e-4),
        ("processing.background_order", 1),
        ("processing.process_noise", 1e-3),
        ("processing.harmonic", "kalman"),
    ],
)
def test_what_the_scene_says_of_train_and_estimate_reaches_the_case(
    key: str, value: float | str, tmp_path: Path
) -> None:
    plain = _points(PLAIN, tmp_path)[0].case
    # only the Kalman filter takes process noise
    filtered = '"processing.harmonic" = "kalman"' if key == "processing.process_noise" else ""
    case = _points(PLAIN.replace("[set]", f'[set]\n"{key}" = {value!r}\n{filtered}'), tmp_path)[0].case
    train = case.train
    assert value in (train.delay_s, train.options.background_order, train.options.process_noise, train.options.harmonic)
    assert case.key != plain.key


def test_a_scene_file_beside_the_study_is_its_base(tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_text(shipped_scenes()["table-1"], encoding="utf-8")
    assert len(_points(PLAIN.replace("table-1", "mine.toml"), tmp_path)) == 2


def test_every_mistake_of_a_definition_is_told_at_once(tmp_path: Path) -> None:
    text = _mistakes('title = "x"\nscene = "table-1"\nscaterers = 5\nnoise = 0\naxes = []\n', tmp_path)
    assert "3 mistakes" in text
    assert "did you mean scatterers" in text
    assert "noise: 0 is out of bounds" in text


def test_every_mistake_of_every_scene_is_told_once(tmp_path: Path) -> None:
    text = PLAIN + '[[axes]]\nname = "a"\nkeys = { "simulation.scatterers.per_sell" = [1, 2] }\n'
    text += '[[axes]]\nname = "b"\nkeys = { "tracking.pulse_rate_hz" = [-1.0, 4000.0] }\n'
    told = _mistakes(text, tmp_path)
    assert "2 mistakes" in told
    assert "did you mean per_cell" in told
    assert "tracking.pulse_rate_hz: -1.0 is out of bounds" in told


def test_a_mistake_stands_where_the_file_has_it_and_is_told_once(tmp_path: Path) -> None:
    text = PLAIN.replace("[10.0, 20.0]", '{ start = "x", stop = 20.0, count = 1 }')
    told = _mistakes(text + '[readings]\nphysical = ["coherant"]\nimaginary = ["kasai"]\n', tmp_path)
    assert "4 mistakes" in told
    assert "axes[0].keys.simulation.receiver.snr_db.start: 'x' is not a number" in told
    assert "axes[0].keys.simulation.receiver.snr_db.count: 1 is out of bounds" in told
    assert "readings.physical[0]: 'coherant'" in told
    assert "readings.imaginary: 'imaginary'" in told


@pytest.mark.parametrize("axes", ['["a"]', "3", '[{ name = "x", keys = ["a"] }]'])
def test_points_of_what_is_no_axis_are_a_mistake_like_others(axes: str, tmp_path: Path) -> None:
    (tmp_path / "own.toml").write_text(f'title = "x"\nscene = "table-1"\naxes = {axes}\n', encoding="utf-8")
    with pytest.raises(SettingsError, match="axes"):
        read_studies(str(tmp_path / "own.toml"), {"points": 5})


def test_a_key_that_two_axes_vary_is_refused(tmp_path: Path) -> None:
    again = '[[axes]]\nname = "again"\nkeys = { "simulation.receiver.snr_db" = [30.0] }\n'
    assert "simulation.receiver.snr_db: 2 axes vary it" in _mistakes(PLAIN + again, tmp_path)


def test_a_collection_tells_the_mistakes_of_all_its_studies_and_loses_none(tmp_path: Path) -> None:
    for place, text in {"a": PLAIN, "b": PLAIN, "c": "noise = 0\n" + PLAIN, "d": "seed = -1\n" + PLAIN}.items():
        (tmp_path / place).mkdir()
        (tmp_path / place / "own.toml").write_text(text, encoding="utf-8")
    (tmp_path / "all.toml").write_text(
        'title = "all"\nstudies = ["a/own.toml", "b/own.toml", "c/own.toml", "d/own.toml"]\n', encoding="utf-8"
    )
    with pytest.raises(SettingsError) as caught:
        read_studies(str(tmp_path / "all.toml"))
    told = str(caught.value)
    assert "3 mistakes" in told
    assert "b/own.toml: its results would replace those of another own" in told
    assert "c/own.toml noise: 0 is out of bounds" in told
    assert "d/own.toml seed: -1 is out of bounds" in told


@pytest.mark.parametrize(
    ("key", "values", "told"),
    [
        ("excitation.burst_rate_hz", "[100.0]", "does not depend on it"),
        ("simulation.motion[3].amplitude_m", "[1e-6]", "no such entry"),
        ("simulation.receiver.snr_db.x", "[1e-6]", "no such entry"),
        ("processing.frequencies_hz", "[[300.0]]", "no true value"),
        ("acquisition.gate_length_m", "[20e-6]", "gate is too short"),
        ("simulation.scatterers.reflectors", "[[{}]]", "draws only scatterers"),
        ("simulation.receiver.snr_db", "{ start = 0, stop = 10, count = 3, spacing = 'log' }", "cannot cross zero"),
    ],
)
def test_what_a_study_cannot_vary_is_refused(key: str, values: str, told: str, tmp_path: Path) -> None:
    assert told in _mistakes(PLAIN + f'[[axes]]\nname = "own"\nkeys = {{ "{key}" = {values} }}\n', tmp_path)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (
            'simulate = "gate"\n'
            + PLAIN.replace("table-1", "gelatin-12")
            .replace("simulation.receiver.snr_db", "tracking.delay_s")
            .replace("10.0", "0.0"),
            "prescribes none",
        ),
        (PLAIN.replace("table-1", "no-such"), "no shipped scene and no file"),
        (PLAIN.replace("[10.0, 20.0]", "[]"), "at least 1"),
        ('common = ["depth"]\n' + PLAIN, "which is no axis"),
        (PLAIN + '[readings]\nphysical = ["coherant"]\n', "is not one of the choices"),
        (
            'simulate = "bench"\n' + PLAIN + '[readings]\nliteral = ["coherent"]\n',
            "a study of the gate alone supports it",
        ),
        (
            'simulate = "bench"\n' + PLAIN.replace("tracking.pulse_count", "acquisition.repeats"),
            "sets repeats and varied values itself",
        ),
        (
            'simulate = "bench"\n' + PLAIN.replace("simulation.receiver.snr_db", "sweep.pulse_rate_hz"),
            "sets repeats and varied values itself",
        ),
        (
            'simulate = "bench"\n' + PLAIN.replace('"tracking.pulse_count" = 40', '"processing.window_length_s" = 1.0'),
            "window:",
        ),
        ("corrected = true\n" + PLAIN, "corrects nothing"),
        ("title = ", "not valid TOML"),
        ('title = "all"\nstudies = ["fig-99"]\n', "no shipped study and no file"),
    ],
)
def test_a_wrong_definition_says_what_to_do(text: str, told: str, tmp_path: Path) -> None:
    assert told in _mistakes(text, tmp_path)


@pytest.mark.parametrize("scene", shipped_scenes())
def test_every_shipped_scene_may_be_studied_and_all_but_the_gate_alone_is_measured_whole(scene: str) -> None:
    axis = AxisTable(name="gate", unit="m", keys={"acquisition.gate_length_m": [1e-3, 1.5e-3]})
    cases = [point.case for point in points_of("own", Definition(title="own", scene=scene, axes=(axis,)))]
    assert {isinstance(case, MeasuredCase) for case in cases} == {scene != "table-1"}
    assert len({case.key for case in cases}) == 2


def test_shipped_studies_are_listed_in_the_order_of_their_figures() -> None:
    figures = [name for name in shipped_studies() if name.startswith("fig-")]
    assert figures == [f"fig-{n}" for n in range(4, 14)]
    assert Definition.model_fields["scatterers"].default * Definition.model_fields["noise"].default == 1000
    assert AxisRange(start=1, stop=100, count=3, spacing="log").values() == [1.0, 10.0, 100.0]
