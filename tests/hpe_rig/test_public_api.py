"""The public API: names, paths and Scenes are taken alike, and the numbers are those of the command line."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Callable
from doctest import DocTestParser
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from numpy.typing import NDArray
from typer.testing import CliRunner

import hpe_rig as hpe
from hpe_rig.cli.app import app
from hpe_rig.measurement import prepare, prepare_resumption, record_run, resume
from hpe_rig.plan import disturbed_pulses
from hpe_rig.report.page import render
from hpe_rig.scene import SettingsError, parse_scene, scene_text, shipped_scenes, with_default_specimen
from hpe_rig.scene.loading import DEFAULT_SPECIMEN

ROOT = Path(__file__).parents[2]
ECHOES: dict[str, Any] = {
    "sample_rate_hz": 100e6,
    "pulse_rate_hz": 4000.0,
    "carrier_hz": 9e6,
    "frequencies_hz": [200.0],
}


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> hpe.Run:
    return hpe.measure("table-1", path=tmp_path_factory.mktemp("api") / "run.h5")


def moving_echo(amplitude_m: float = 1e-6, phase_rad: float = 0.5, pulses: int = 100) -> NDArray[np.float64]:
    """Return the echo (pulse, sample) of one point that moves by amplitude sin(2 pi 200 Hz t + phase)."""
    time_s = np.arange(pulses) / ECHOES["pulse_rate_hz"]
    displacement_m = amplitude_m * np.sin(2 * np.pi * 200.0 * time_s + phase_rad)
    sample_s = np.arange(200) / ECHOES["sample_rate_hz"] - 1e-6 - 2 * displacement_m[:, None] / 1540.0
    return np.asarray(np.exp(-((sample_s / 0.3e-6) ** 2)) * np.cos(2 * np.pi * ECHOES["carrier_hz"] * sample_s))


def test_importing_the_package_loads_no_module_of_it_and_defines_every_name() -> None:
    code = "import sys, hpe_rig; print(*sys.modules); [getattr(hpe_rig, name) for name in hpe_rig.__all__]"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    assert not {"numpy", "pydantic", "h5py", "hpe_rig.scene"} & set(done.stdout.split())
    named = set(re.findall(r"hpe\.(\w+)\(", hpe.__doc__ or ""))
    assert named <= set(hpe.__all__)
    assert set(hpe.__all__) >= {"load_scene", "measure", "open_run", "estimate", "check", "run_study", "open_bench"}


def test_the_example_of_the_package_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {"rf": moving_echo(), "Path": Path}
    examples = [example.source for example in DocTestParser().get_examples(hpe.__doc__ or "")]
    for source in examples:
        # A whole study takes minutes; test_run.py of the studies runs small ones.
        if "run_study" not in source:
            exec(source, names)
    assert len(examples) > 6
    assert names["run"].scene.tracking.pulse_rate_hz == 3890.0


def test_a_name_a_path_and_a_scene_measure_the_same(run: hpe.Run, tmp_path: Path) -> None:
    path = tmp_path / "copy.toml"
    path.write_text(shipped_scenes()["table-1"], encoding="utf-8")
    sources = {"path": path, "scene": hpe.load_scene("table-1")}
    for name, source in sources.items():
        other = hpe.measure(source, path=str(tmp_path / f"{name}.h5"))
        assert other.scene == run.scene
        np.testing.assert_array_equal(other.records[0].codes, run.records[0].codes)
    assert hpe.load_scene(str(path)) == run.scene
    assert hpe.check(sources["scene"]).text == hpe.check("table-1").text


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=[] if name in ("table-1", "muscle-force") else pytest.mark.slow)
        for name in shipped_scenes()
    ],
)
def test_a_scene_is_read_back_unchanged_from_a_run_file(name: str) -> None:
    scene = hpe.load_scene(name).with_({"acquisition.gate_length_m": 1.1e-3})
    setup = prepare(scene, refuse=False)
    assert setup.scene.scene == scene
    assert scene.with_({"acquisition.gate_length_m": 1.0e-3}) == hpe.load_scene(name)


def test_with_changes_numbers_lists_and_sections_that_are_absent_and_refuses_all_mistakes_at_once() -> None:
    scene = hpe.load_scene("bovine-muscle")
    changed = scene.with_(
        {
            "tracking.pulse_rate_hz": 3890.0,
            "excitation.force_fraction": [0.5, 1.0],
            "medium.shear_modulus_pa": 9e3,
            "medium.shear_viscosity_pa_s": 2.0,
        }
    )
    assert changed.tracking.pulse_rate_hz == 3890.0
    assert changed.excitation is not None
    assert changed.excitation.force_fraction == (0.5, 1.0)
    assert changed.medium is not None
    assert changed.with_({"excitation.force_fraction[0]": 0.25}).excitation.force_fraction == (0.25, 1.0)  # type: ignore[union-attr]
    assert scene.medium is None
    with pytest.raises(SettingsError, match=r"(?s)2 mistakes.*pulse_rate_hz.*gate_dept.*gate_depth_m") as caught:
        scene.with_({"tracking.pulse_rate_hz": -1.0, "acquisition.gate_dept": 1.0})
    assert len(caught.value.mistakes) == 2
    with pytest.raises(
        SettingsError, match=r"(?s)2 mistakes.*title\.x: .*no such entry.*force_fraction\[9\]: .*no such"
    ):
        scene.with_({"title.x": 1, "excitation.force_fraction[9]": 1.0})
    with pytest.raises(SettingsError, match=r"force_fraction\[2\]: .*no such entry"):
        changed.with_({"excitation.force_fraction[2]": 1.0})


def test_a_wrong_type_is_refused_with_the_expected_type(tmp_path: Path) -> None:
    for function in (hpe.load_scene, hpe.check, hpe.measure):
        with pytest.raises(TypeError, match=r"path of a TOML file or a Scene, not (as )?int"):
            function(3)  # type: ignore[operator]
    with pytest.raises(TypeError, match="expected the path of a bench file or None, not dict"):
        hpe.check("table-1", bench={})  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="expected the path of a run file or None, not bytes"):
        hpe.measure("table-1", path=b"run.h5")  # type: ignore[arg-type]
    with pytest.raises(TypeError, match=r"mapping from path to value, not (as )?int"):
        hpe.load_scene("table-1").with_(3)  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="the path of a setting must be text, not int 3"):
        hpe.load_scene("table-1").with_({3: 1.0})  # type: ignore[dict-item]
    with pytest.raises(TypeError, match=r"name of a shipped one or the path of a TOML file, not (as )?int"):
        hpe.run_study(3, tmp_path)  # type: ignore[arg-type]
    with pytest.raises(TypeError, match=r"path of a folder, not (as )?int"):
        hpe.run_study("fig-7", 3)  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="path of a run file, not int"):
        hpe.open_run(3)  # type: ignore[arg-type]
    for wrong in (moving_echo().astype(complex), np.array([["a"]]), np.array([[None]])):
        with pytest.raises(TypeError, match="real numbers"):
            hpe.estimate(wrong, **ECHOES)
    with pytest.raises(ValueError, match="axes"):
        hpe.estimate(moving_echo()[0], **ECHOES)
    with pytest.raises(SettingsError, match="estimator"):
        hpe.estimate(moving_echo(), **ECHOES, estimator="kasia")


def test_the_displacement_is_the_prescribed_one_averaged_over_the_beam(run: hpe.Run) -> None:
    """1000 nm at 200 Hz; eq. (12)'s Gaussian is tracked at 0.89 of its peak."""
    displacement_m, (shot,) = run.displacement_m(0), run.plan.shots
    assert displacement_m.shape == (101,)
    angle = 2 * np.pi * 200.0 * shot.timeline.sensing_s
    columns = np.stack([np.sin(angle), np.cos(angle), np.ones(101)], axis=1)
    in_phase, quadrature, _ = np.linalg.lstsq(columns, displacement_m, rcond=None)[0]
    (estimate,) = run.estimate("coherent").shots[0].estimates
    assert np.hypot(in_phase, quadrature) == pytest.approx(estimate.tracked_amplitude_m, rel=1e-6)
    assert 0.8e-6 < estimate.tracked_amplitude_m < 1e-6


def test_a_shot_beyond_the_last_is_refused_with_their_number(run: hpe.Run) -> None:
    for shot in (7, -2):
        with pytest.raises(IndexError, match=f"shot {shot} does not exist: the run has 1"):
            run.displacement_m(shot)
    np.testing.assert_array_equal(run.displacement_m(-1), run.displacement_m(0))


def test_a_pulse_that_is_missing_or_omitted_has_no_displacement(run: hpe.Run, tmp_path: Path) -> None:
    lost = tmp_path / "lost.h5"
    lost.write_bytes(run.path.read_bytes())
    with h5py.File(lost, "r+") as file:
        # As files of early releases are, which may be changed unnoticed.
        file.attrs.modify("format_version", 2)
        del file["checksum"]
        file["records/recorded"][0, [3, 50]] = 0
    assert np.flatnonzero(np.isnan(hpe.open_run(lost).displacement_m(0))).tolist() == [3, 50]
    skipping = hpe.measure("bovine-muscle", path=tmp_path / "skip.h5")
    omitted = disturbed_pulses(skipping.plan.shots[0])
    assert omitted.any()
    np.testing.assert_array_equal(np.isnan(skipping.displacement_m(0)), omitted)
    with pytest.raises(IndexError):
        skipping.displacement_m(1)


def test_echoes_of_any_real_type_give_their_true_motion() -> None:
    rf = moving_echo()
    for typed, tolerance in (
        (rf, 2e-3),
        (rf.astype(np.float32), 2e-3),
        (np.round(8000 * rf + 30).astype(np.int16), 5e-3),
    ):
        (estimate,) = hpe.estimate(typed, **ECHOES).shots[0].estimates
        assert estimate.tracked_amplitude_m == pytest.approx(1e-6, rel=tolerance)
        assert estimate.tracked_phase_rad == pytest.approx(0.5, abs=tolerance)
    rf[7, 3] = np.nan
    result = hpe.estimate(np.stack([[rf, moving_echo(2e-6)]]), **ECHOES)
    assert [shot.pulses_missing for shot in result.shots] == [1, 0]
    assert result.shots[1].estimates[0].tracked_amplitude_m == pytest.approx(2e-6, rel=2e-3)
    assert not result.simulated


@pytest.mark.parametrize(
    ("setting", "value"),
    [("pulse_rate_hz", 0.0), ("pulse_rate_hz", -4e3), ("pulse_rate_hz", np.nan), ("sample_rate_hz", 17e6),
     ("carrier_hz", np.nan), ("sound_speed_m_per_s", 0.0), ("frequencies_hz", []), ("margin", (100, 100))],
)  # fmt: skip
def test_invalid_settings_of_echoes_are_refused(setting: str, value: Any) -> None:
    with pytest.raises(ValueError, match=r"rate|carrier|sound_speed|frequency|margins"):
        hpe.estimate(moving_echo(), **ECHOES | {setting: value})


@pytest.mark.parametrize("shape", [(0, 200), (0, 100, 200), (100, 0)])
def test_empty_echoes_are_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match="holds no echo"):
        hpe.estimate(np.zeros(shape), **ECHOES)


def test_a_train_without_an_echo_does_not_affect_other_trains() -> None:
    silent = np.zeros_like(moving_echo())
    result = hpe.estimate(np.stack([moving_echo(), silent, moving_echo(2e-6)]), **ECHOES)
    assert [shot.index for shot in result.shots] == [0, 2]
    assert result.shots[1].estimates[0].tracked_amplitude_m == pytest.approx(2e-6, rel=2e-3)
    ((number, why),) = result.shots_without_result
    assert number == 2
    assert result.warnings == (f"shot 2 left out: {why}",)
    # Entries of a batch are not repeats of one setting: nobody said so.
    assert not result.means
    with pytest.raises(ValueError, match="no echo"):
        hpe.estimate(np.stack([silent, silent]), **ECHOES)


def test_the_records_of_a_run_can_be_estimated_as_echoes(run: hpe.Run) -> None:
    records, (shot,) = run.records[0], run.plan.shots
    around = slice(shot.gate.start - 67, shot.gate.stop + 67)
    result = hpe.estimate(records.codes[:, around] * records.volts_per_code, **ECHOES, margin=(67, 67))
    expected = run.estimate("coherent").shots[0].estimates[0]
    assert result.shots[0].estimates[0].tracked_amplitude_m == pytest.approx(expected.tracked_amplitude_m, rel=1e-5)


def test_a_result_becomes_a_frame_and_a_figure(run: hpe.Run, monkeypatch: pytest.MonkeyPatch) -> None:
    result = run.estimate()
    (estimate,) = result.shots[0].estimates
    assert result.to_frame()["amplitude_m"].tolist() == [estimate.amplitude_m]
    amplitude, phase = result.figure().axes
    for panel, value in (
        (amplitude, estimate.amplitude_m * 1e9),
        (phase, np.degrees(estimate.phase_rad)),
    ):
        points, _, _ = panel.containers[0]
        assert points.get_xydata().tolist() == [[200.0, pytest.approx(value)]]
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(ModuleNotFoundError, match=r"hpe-rig\[frames\]"):
        result.to_frame()


def test_the_repr_of_a_run_is_one_line_and_its_result_lists_omissions_under_both_names(run: hpe.Run) -> None:
    assert repr(run) == f"<Run {str(run.path)!r}: {run.scene.title!r}, complete, 1 of 1 shots, simulated>"
    table = run.estimate().as_dict()
    assert table["omitted"] == table["left_out"]
    assert ["trigger jitter", "simulation.instruments.trigger_jitter_s is absent or 0"] in table["omitted"]


def test_an_estimate_writes_nothing_until_it_is_saved(run: hpe.Run, tmp_path: Path) -> None:
    copy = tmp_path / "run.h5"
    copy.write_bytes(run.path.read_bytes())
    again = hpe.open_run(str(copy))
    result = again.estimate("kasai")
    assert list(tmp_path.iterdir()) == [copy]
    assert again.save(result) == tmp_path / "run.kasai.h5"
    assert (tmp_path / "run.kasai.h5").exists()


def test_check_returns_the_text_of_the_command_and_its_refusals() -> None:
    checked = hpe.check("table-1", target="20nm")
    done = CliRunner().invoke(app, ["check", "table-1", "--target", "20nm"])
    assert done.stdout == f"{checked}\n"
    assert not checked.refused
    refused = hpe.check(hpe.load_scene("table-1").with_({"tracking.pulse_rate_hz": 20e3}))
    assert refused.refused
    assert {item.check for item in refused.findings if item.level == "refused"} >= {"depth"}


def test_an_open_bench_holds_only_the_instruments_of_the_scene() -> None:
    with hpe.open_bench("table-1") as bench:
        assert bench.simulated
        assert bench.toneburst is None
        assert bench.world is not None
        assert not any(bench.world.outputs_on().values())


def first_scene() -> str:
    """Return the scene on the first screen of the README."""
    found = re.search(r"```toml\n(.*?)```", (ROOT / "README.md").read_text(encoding="utf-8"), flags=re.DOTALL)
    assert found is not None
    return found.group(1)


def test_the_first_scene_of_the_readme_runs_on_the_default_muscle_and_states_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("first.toml").write_text(first_scene(), encoding="utf-8")
    said = f"simulated specimen: {DEFAULT_SPECIMEN}"
    done = CliRunner().invoke(app, ["run", "first.toml"])
    assert done.exit_code == 0, done.output
    assert said in done.output
    stored = hpe.open_run("first.h5").stored
    assert (stored.status, stored.simulated) == ("complete", True)
    # Only the twin uses the default specimen; the run file contains the scene as written.
    assert stored.scene_toml == first_scene()
    result = hpe.open_run("first.h5").estimate().as_dict()
    assert result["simulated_specimen"] == DEFAULT_SPECIMEN
    for estimate in result["shots"][0]["estimates"][:5]:
        assert abs(estimate["amplitude_error"]) < 0.03
        assert estimate["amplitude_m"] > 300e-9
    assert re.search(f"simulated specimen.*{DEFAULT_SPECIMEN}", render(Path("first.h5")), flags=re.DOTALL)


def test_only_a_simulated_bench_without_a_specimen_gets_the_default_one(
    run: hpe.Run, tmp_path: Path, real_bench: Callable[..., Path]
) -> None:
    assert "simulated_specimen" not in run.estimate().as_dict()
    scene = hpe.load_scene("table-1")
    assert with_default_specimen(scene) == scene
    plain = tmp_path / "plain.toml"
    plain.write_text(first_scene(), encoding="utf-8")
    metal = real_bench()
    assert prepare(plain, metal, refuse=False).scene.scene.simulation is None
    assert DEFAULT_SPECIMEN not in hpe.check(plain, metal).text


def test_a_scene_with_the_written_default_specimen_has_its_own_specimen() -> None:
    plain = parse_scene("plain", first_scene()).scene
    filled = with_default_specimen(plain)
    written = plain.with_({"simulation": filled.simulation})
    assert written.simulation == filled.simulation
    assert (plain.default_specimen, filled.default_specimen, written.default_specimen) == (None, DEFAULT_SPECIMEN, None)
    assert DEFAULT_SPECIMEN not in hpe.check(written).text
    # A scene out of a run is that of its file: its specimen is filled in anew.
    assert parse_scene(*scene_text(filled)).scene == plain
    assert DEFAULT_SPECIMEN in hpe.check(filled).text


def test_the_default_muscle_has_echoes_at_the_gate_without_a_push(tmp_path: Path) -> None:
    path = tmp_path / "still.toml"
    path.write_text(
        'title = "Aligning"\n[tracking]\npulse_rate_hz = 4000.0\npulse_count = 50\n'
        "[acquisition]\ngate_depth_m = 50e-3\n[processing]\nfrequencies_hz = [200.0]\n",
        encoding="utf-8",
    )
    run = hpe.measure(path, path=tmp_path / "still.h5")
    records, (shot,) = run.records[0], run.plan.shots
    echo_v = records.codes[:, shot.gate] * records.volts_per_code
    # the receiver's 0.1 V at rest, at the gate and not at the 70 mm of the paper's focus
    assert 0.05 < echo_v.std() < 0.2
    assert run.estimate().shots[0].estimates[0].true_amplitude_m == 0


@pytest.mark.slow
def test_a_run_on_the_default_muscle_resumes(tmp_path: Path) -> None:
    scene = tmp_path / "twice.toml"
    scene.write_text(first_scene().replace("[acquisition]", "[acquisition]\nrepeats = 2"), encoding="utf-8")
    setup = prepare(scene)

    def stop(progress: Any) -> None:
        if progress.shot.index == 1:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        record_run(setup, tmp_path / "run.h5", stop)
    whole = hpe.open_run(record_run(setup, tmp_path / "whole.h5"))
    rest = hpe.open_run(resume(prepare_resumption(tmp_path / "run.h5")))
    for one, other in zip(whole.records, rest.records, strict=True):
        np.testing.assert_array_equal(one.codes, other.codes)


@pytest.mark.parametrize("wrong", ["4000", None, True, [4000.0], np.array([1.0, 2.0])])
def test_a_wrong_type_is_refused_by_name(wrong: Any) -> None:
    names = ("sample_rate_hz", "pulse_rate_hz", "carrier_hz", "sound_speed_m_per_s")
    with pytest.raises(TypeError) as raised:
        hpe.estimate(moving_echo(), **ECHOES | dict.fromkeys(names, wrong))
    # All mistakes are in one error.
    assert all(f"{name} as a number, not" in str(raised.value) for name in names)
    if not isinstance(wrong, np.ndarray | list):
        with pytest.raises(TypeError, match="frequencies_hz as a list of numbers"):
            hpe.estimate(moving_echo(), **ECHOES | {"frequencies_hz": wrong})
    with pytest.raises(TypeError, match="margin as"):
        hpe.estimate(moving_echo(), **ECHOES, margin=wrong)
    with pytest.raises(TypeError, match="width_uncertainty as a number"):
        hpe.fit_moduli("run.h5", width_uncertainty=wrong)


def test_numbers_of_numpy_are_numbers() -> None:
    settings = {name: np.float32(value) for name, value in ECHOES.items() if name != "frequencies_hz"}
    expected = hpe.estimate(moving_echo(), **ECHOES).shots[0].estimates
    found = hpe.estimate(moving_echo(), **settings, frequencies_hz=np.array([200]), margin=(np.int64(0), 0))
    assert found.shots[0].estimates == expected


def test_wrong_types_of_the_methods_of_a_run_are_refused_by_name(run: hpe.Run) -> None:
    with pytest.raises(TypeError, match="shot as a whole number, not '0'"):
        run.displacement_m("0")  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="axes as a mapping"):
        run.sweep(5)  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="laws as a list of texts"):
        hpe.fit_moduli("run.h5", laws="voigt")
