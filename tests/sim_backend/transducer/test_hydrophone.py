"""Hydrophone scans: what a bowl's field becomes when it is scanned, in every format, and what a scan may lack."""

import hashlib
import os
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import h5py
import numpy as np
import pytest
from scipy.io import savemat

import hpe_rig as hpe
from hpe_rig.bench import check_declared
from hpe_rig.measurement.resumption import _refuse_differences
from hpe_rig.measurement.setup import prepare_text, with_scan_in_folder
from hpe_rig.prediction import push_force
from hpe_rig.processing import Estimates
from hpe_rig.runs.result_warnings import run_warnings
from hpe_rig.scene import SettingsError, load_scene, scene_text
from hpe_rig.store import StoreError, sha256_of_scan
from sim_backend.settings import SimulationSettings, Transducer
from sim_backend.transducer import bowl_pressure, pulse_echo_beam, push_intensity, read_scan, wave_number

OLD_RUN = next((Path(__file__).parents[2] / "fixtures" / "run_files").glob("*.h5"))


def scanned(frequency_hz: float, across_m: float, along_m: float, steps: tuple[int, int]) -> dict[str, np.ndarray]:
    """Return a scan of the x-z plane, both sides of the axis, as a hydrophone would make it."""
    x, z = np.linspace(-across_m, across_m, 2 * steps[0] + 1), np.linspace(-along_m, along_m, 2 * steps[1] + 1)
    field = bowl_pressure(Transducer(), wave_number(frequency_hz, 1540.0), np.abs(x), z)
    z_m, x_m = (each.ravel() for each in np.meshgrid(z, x, indexing="ij"))
    columns = {"x_m": x_m, "y_m": np.zeros(x_m.size), "z_m": z_m}
    return columns | {"pressure_pa": 2e4 * np.abs(field).ravel(), "phase_rad": np.angle(field).ravel() + 0.7}


def written(columns: dict[str, np.ndarray], path: Path) -> str:
    match path.suffix:
        case ".csv":
            table = np.stack(list(columns.values()), axis=1)
            np.savetxt(path, table, delimiter=",", header=",".join(columns), comments="", fmt="%.17g")
        case ".mat":
            savemat(path, columns)
        case _:
            with h5py.File(path, "w") as file:
                for name, each in columns.items():
                    file[name] = each
    return str(path)


@pytest.fixture(scope="module")
def tracking() -> dict[str, np.ndarray]:
    return scanned(9.0e6, 0.9e-3, 2.0e-3, (36, 20))


@pytest.mark.parametrize("suffix", [".csv", ".h5", ".mat"])
def test_a_scan_of_the_bowl_gives_the_bowls_beam(suffix, tracking, tmp_path: Path) -> None:
    path = written(tracking, tmp_path / f"tracking{suffix}")
    beams = {"field": "measured", "excitation_scan": path, "tracking_scan": path}
    measured, own = (
        pulse_echo_beam(SimulationSettings.model_validate({"beams": each}), (9.0e6,), 0.5e-3, 1.2e-3)
        for each in (beams, {"field": "aperture"})
    )
    rng = np.random.default_rng(3)
    points_m = rng.uniform(0, 0.5e-3, 40), rng.uniform(-1.2e-3, 1.2e-3, 40)
    # Cubic splines over steps of 25 and 100 um.
    assert np.abs(measured.at(*points_m)[0] - own.at(*points_m)[0]).max() < 2e-3
    assert np.abs(measured.at(*points_m)[1] - own.at(*points_m)[1])[np.abs(own.at(*points_m)[0][0]) > 0.1].max() < 2e-3


def test_without_phase_the_amplitude_is_the_beams(tracking, tmp_path: Path) -> None:
    path = written({name: each for name, each in tracking.items() if name != "phase_rad"}, tmp_path / "plain.h5")
    beams = {"field": "measured", "excitation_scan": path, "tracking_scan": path}
    beam = pulse_echo_beam(SimulationSettings.model_validate({"beams": beams}), (9.0e6,), 0.3e-3, 0.5e-3)
    own = pulse_echo_beam(SimulationSettings.model_validate({"beams": {"field": "aperture"}}), (9.0e6,), 0.3e-3, 0.5e-3)
    points_m = np.array([0.0, 0.08e-3]), np.array([0.3e-3, 0.0])
    assert np.abs(beam.at(*points_m)[0] - np.abs(own.at(*points_m)[0])).max() < 2e-3
    assert beam.at(*points_m)[1] == pytest.approx(1.0, abs=1e-9)


def test_a_scan_of_the_push_gives_its_force(tmp_path: Path) -> None:
    path = written(scanned(3.0e6, 8e-3, 17e-3, (100, 68)), tmp_path / "push.h5")
    beams = {"field": "measured", "excitation_scan": path, "tracking_scan": path}
    specimen = {"attenuation_db_per_cm_mhz": 1e-4}
    measured, own = (
        push_intensity(SimulationSettings.model_validate({"beams": each, "specimen": specimen}))
        for each in (beams, {"field": "aperture"})
    )
    points_m = np.array([0.0, 0.2e-3, 0.5e-3, 0.1e-3, 1.0e-3]), np.array([0.0, 1e-3, -2e-3, 5e-3, -4e-3])
    assert np.abs(measured.at(*points_m) - own.at(*points_m)).max() < 5e-3


def test_a_changed_scan_is_read_again(tracking, tmp_path: Path) -> None:
    path = written(tracking, tmp_path / "scan.h5")
    measured = {"field": "measured", "excitation_scan": path, "tracking_scan": path}
    settings = SimulationSettings.model_validate({"beams": measured})
    points_m = np.array([0.2e-3]), np.array([0.0])

    def seen() -> tuple[float, float]:
        beam = pulse_echo_beam(settings, (9.0e6,), 0.3e-3, 0.5e-3)
        return float(abs(beam.at(*points_m)[0][0, 0])), float(push_intensity(settings).at(*points_m)[0])

    assert read_scan(path) is read_scan(path), "a file that stays is read once"
    before = seen()
    written(tracking | {"x_m": 0.5 * tracking["x_m"], "y_m": np.full(tracking["x_m"].size, 0.0)}, tmp_path / "scan.h5")
    os.utime(path, ns=(0, 1))
    assert all(abs(now - then) > 0.01 for now, then in zip(seen(), before, strict=True))


def test_all_mistakes_of_a_scan_are_reported_at_once(tracking, tmp_path: Path) -> None:
    broken = {"x_m": tracking["x_m"], "z_m": tracking["z_m"][:-1], "pressure_pa": -tracking["pressure_pa"]}
    broken["pressure_pa"][3] = np.nan
    with pytest.raises(ValueError, match="y_m is missing") as error:
        read_scan(written(broken, tmp_path / "broken.h5"))
    for words in ("differ in length", "pressure_pa contains a value that is not a finite number", "below 0"):
        assert words in str(error.value)
    few = {name: each[tracking["z_m"] > 1.7e-3] for name, each in tracking.items()}
    with pytest.raises(ValueError, match="planes of equal z_m"):
        read_scan(written(few, tmp_path / "few.h5"))
    cut = {name: each[np.abs(tracking["x_m"]) < 0.16e-3] for name, each in tracking.items()}
    with pytest.raises(ValueError, match="scan a wider area"):
        read_scan(written(cut, tmp_path / "cut.h5"))
    behind = {name: each[tracking["z_m"] > 0.1e-3] for name, each in tracking.items()}
    with pytest.raises(ValueError, match="from before the focus"):
        read_scan(written(behind, tmp_path / "behind.csv"))
    (tmp_path / "scan.txt").write_text("x_m\n0\n", encoding="utf-8")
    with pytest.raises(ValueError, match=r"\.csv, \.h5"):
        read_scan(str(tmp_path / "scan.txt"))
    with pytest.raises(ValueError, match="does not exist"):
        read_scan(str(tmp_path / "absent.csv"))


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("empty.csv", b"", "cannot be read as a table with commas between columns: it is empty"),
        ("empty.mat", b"", "cannot be read as a MAT file: it is empty"),
        ("truncated.mat", b"MATLAB", "cannot be read as a MAT file"),
        ("text.h5", b"x_m,y_m,z_m,pressure_pa", "cannot be read as an HDF5 file"),
        ("semicolons.csv", b"x_m;y_m\n0;0\n", "with commas between columns"),
        ("binary.csv", bytes(range(256)), "cannot be read as a table with commas between columns"),
    ],
)
def test_a_file_that_is_no_scan_is_refused_with_the_reason(
    name: str, content: bytes, words: str, tmp_path: Path
) -> None:
    (tmp_path / name).write_bytes(content)
    scene = load_scene("bovine-muscle").with_({"beams.excitation_scan": str(tmp_path / name)})
    (mistake,) = check_declared(scene)
    assert words in mistake.what
    assert name in mistake.what


def test_a_spreadsheets_mark_of_the_encoding_is_no_part_of_a_name(tracking, tmp_path: Path) -> None:
    plain = Path(written(tracking, tmp_path / "plain.csv"))
    (tmp_path / "marked.csv").write_bytes(b"\xef\xbb\xbf" + plain.read_bytes())
    marked = read_scan(str(tmp_path / "marked.csv"))
    assert np.array_equal(marked.pressure_pa, read_scan(str(plain)).pressure_pa)


def test_a_scan_that_cuts_the_push_or_has_no_focus_is_no_force(tracking, tmp_path: Path) -> None:
    scene = load_scene("bovine-muscle").model_copy(update={"simulation": None})
    short = written(scanned(3.0e6, 8e-3, 3e-3, (40, 12)), tmp_path / "short.h5")
    error = check_declared(scene.with_({"beams.excitation_scan": short}))
    assert [words for each in error for words in ("z_m = -0.003", "z_m = 0.003") if words in each.what] == [
        "z_m = -0.003",
        "z_m = 0.003",
    ]
    with pytest.raises(SettingsError, match="the push extends beyond the scan"):
        push_force(scene.with_({"beams.excitation_scan": short}))
    long = written(scanned(3.0e6, 8e-3, 17e-3, (40, 68)), tmp_path / "long.h5")
    assert check_declared(scene.with_({"beams.excitation_scan": long})) == []
    dark = written(tracking | {"pressure_pa": 0 * tracking["pressure_pa"]}, tmp_path / "dark.h5")
    with pytest.raises(ValueError, match="the pressure at the focus is 0"):
        read_scan(dark)


def test_a_scene_with_unreadable_scans_says_so_of_each(tmp_path: Path) -> None:
    absent = str(tmp_path / "absent.h5")
    scene = load_scene("bovine-muscle").with_(
        {
            "simulation.beams.field": "measured",
            "simulation.beams.excitation_scan": absent,
            "simulation.beams.tracking_scan": absent,
        }
    )
    assert [each.path for each in check_declared(scene.with_({"beams.excitation_scan": absent}))] == [
        "beams.excitation_scan",
        "simulation.beams.excitation_scan",
        "simulation.beams.tracking_scan",
    ]
    bench_alone = scene.model_copy(update={"simulation": None}).with_({"beams.excitation_scan": absent})
    assert [each.path for each in check_declared(bench_alone)] == ["beams.excitation_scan"]
    with pytest.raises(SettingsError, match=r"beams\.excitation_scan.*does not exist"):
        push_force(bench_alone)


@pytest.mark.parametrize("path", ["push.csv", "/gone/push.csv", r"C:\scans\push.csv"])
def test_a_missing_scan_is_read_from_the_folder_of_the_run_file(path: str, tmp_path: Path) -> None:
    scene = load_scene("bovine-muscle").with_({"beams.excitation_scan": path})
    assert with_scan_in_folder(scene, tmp_path) == scene
    (tmp_path / "push.csv").touch()
    error = with_scan_in_folder(scene, tmp_path)
    assert error.beams is not None
    assert error.beams.excitation_scan == str(tmp_path / "push.csv")
    assert with_scan_in_folder(error, tmp_path / "elsewhere") == error, "it is where it says"


def test_a_run_is_resumed_with_the_scan_beside_its_file(tmp_path: Path) -> None:
    lost, here = tmp_path / "push.csv", tmp_path / "elsewhere" / "push.csv"
    written(scanned(3.0e6, 8e-3, 17e-3, (40, 68)), lost)
    text = scene_text(load_scene("bovine-muscle").with_({"beams.excitation_scan": str(lost)}))[1]
    here.parent.mkdir()
    lost.rename(here)
    with pytest.raises(SettingsError, match="does not exist"):
        prepare_text("scanned", text)
    beams = prepare_text("scanned", text, stored=here.with_name("run.h5")).scene.scene.beams
    assert beams is not None
    assert beams.excitation_scan == str(here)


def warnings_of(run: hpe.Run) -> list[str]:
    return list(run_warnings(run.scene, run.plan, run.findings, run.stored, Estimates((), {})))


def test_a_result_says_that_the_scan_is_no_longer_the_one_of_the_run(tmp_path: Path) -> None:
    path = tmp_path / "push.csv"
    path.write_text("x_m\n")
    scene = load_scene("bovine-muscle").with_({"beams.excitation_scan": str(path)})
    assert sha256_of_scan(load_scene("bovine-muscle")) is None
    stated = hashlib.sha256(b"x_m\n").hexdigest()
    assert sha256_of_scan(scene) == stated
    run = hpe.open_run(OLD_RUN)
    assert run.stored.scan_sha256 == "", "files of earlier releases do not say"
    run = replace(run, scene=scene)
    of_the_file = [sum("has changed since" in each for each in warnings_of(run))]
    for stored in (stated, "0" * 64):
        known = replace(run, stored=replace(run.stored, scan_sha256=stored))
        of_the_file.append(sum("has changed since" in each for each in warnings_of(known)))
        setup: Any = SimpleNamespace(
            scene=SimpleNamespace(scene=scene, name="scene"), bench=SimpleNamespace(bench=run.bench)
        )
        with pytest.raises(StoreError, match="one run has one scan") if stored != stated else nullcontext():
            _refuse_differences(known.stored, setup, setup)
    assert of_the_file == [0, 0, 1]
    path.unlink()
    (lost,) = [each for each in warnings_of(known) if each.startswith("beams.excitation_scan")]
    assert "cannot be read (no such file or directory)" in lost


@pytest.mark.slow
def test_a_run_finds_its_scan_again_beside_the_run_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    written(scanned(3.0e6, 8e-3, 17e-3, (40, 68)), tmp_path / "push.csv")
    scene = load_scene("bovine-muscle").with_({"beams.excitation_scan": "push.csv", "excitation.burst_count": 5})
    scene = scene.with_({"processing.window_start_s": 0.0})
    hpe.measure(scene, path=tmp_path / "run.h5")
    before = push_force(scene)
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    monkeypatch.chdir(elsewhere)
    run = hpe.open_run(tmp_path / "run.h5")
    assert push_force(run.scene) == before
    with (tmp_path / "push.csv").open("rb") as scan:
        assert run.stored.scan_sha256 == hashlib.file_digest(scan, "sha256").hexdigest()
    assert not any("has changed since" in warning for warning in run.estimate().warnings)
    with (tmp_path / "push.csv").open("a", encoding="utf-8") as scan:
        scan.write("\n")
    assert any("has changed since" in warning for warning in hpe.open_run(tmp_path / "run.h5").estimate().warnings)
    (tmp_path / "push.csv").rename(tmp_path / "lost.csv")
    with pytest.raises(SettingsError, match="beside the run file"):
        push_force(hpe.open_run(tmp_path / "run.h5").scene)
