"""Hydrophone scans: what a bowl's field becomes when it is scanned, in every format, and what a scan may lack."""

import os
from pathlib import Path

import h5py
import numpy as np
import pytest
from scipy.io import savemat

from hpe_rig.bench.twin import check_declared
from hpe_rig.scene import load_scene
from sim_backend.settings import SimulationSettings, Transducer
from sim_backend.transducer import bowl_pressure, pulse_echo_beam, push_intensity, read_scan, wave_number


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
    place = rng.uniform(0, 0.5e-3, 40), rng.uniform(-1.2e-3, 1.2e-3, 40)
    # Cubic splines over steps of 25 and 100 um.
    assert np.abs(measured.at(*place)[0] - own.at(*place)[0]).max() < 2e-3
    assert np.abs(measured.at(*place)[1] - own.at(*place)[1])[np.abs(own.at(*place)[0][0]) > 0.1].max() < 2e-3


def test_without_phase_the_amplitude_is_the_beams(tracking, tmp_path: Path) -> None:
    path = written({name: each for name, each in tracking.items() if name != "phase_rad"}, tmp_path / "plain.h5")
    beams = {"field": "measured", "excitation_scan": path, "tracking_scan": path}
    beam = pulse_echo_beam(SimulationSettings.model_validate({"beams": beams}), (9.0e6,), 0.3e-3, 0.5e-3)
    own = pulse_echo_beam(SimulationSettings.model_validate({"beams": {"field": "aperture"}}), (9.0e6,), 0.3e-3, 0.5e-3)
    place = np.array([0.0, 0.08e-3]), np.array([0.3e-3, 0.0])
    assert np.abs(beam.at(*place)[0] - np.abs(own.at(*place)[0])).max() < 2e-3
    assert beam.at(*place)[1] == pytest.approx(1.0, abs=1e-9)


def test_a_scan_of_the_push_gives_its_force(tmp_path: Path) -> None:
    path = written(scanned(3.0e6, 8e-3, 17e-3, (100, 68)), tmp_path / "push.h5")
    beams = {"field": "measured", "excitation_scan": path, "tracking_scan": path}
    specimen = {"attenuation_db_per_cm_mhz": 1e-4}
    measured, own = (
        push_intensity(SimulationSettings.model_validate({"beams": each, "specimen": specimen}))
        for each in (beams, {"field": "aperture"})
    )
    place = np.array([0.0, 0.2e-3, 0.5e-3, 0.1e-3, 1.0e-3]), np.array([0.0, 1e-3, -2e-3, 5e-3, -4e-3])
    assert np.abs(measured.at(*place) - own.at(*place)).max() < 5e-3


def test_a_scan_that_is_written_anew_is_read_anew(tracking, tmp_path: Path) -> None:
    path = written(tracking, tmp_path / "scan.h5")
    measured = {"field": "measured", "excitation_scan": path, "tracking_scan": path}
    settings = SimulationSettings.model_validate({"beams": measured})
    place = np.array([0.2e-3]), np.array([0.0])

    def seen() -> tuple[float, float]:
        beam = pulse_echo_beam(settings, (9.0e6,), 0.3e-3, 0.5e-3)
        return float(abs(beam.at(*place)[0][0, 0])), float(push_intensity(settings).at(*place)[0])

    assert read_scan(path) is read_scan(path), "a file that stays is read once"
    before = seen()
    written(tracking | {"x_m": 0.5 * tracking["x_m"], "y_m": np.full(tracking["x_m"].size, 0.0)}, tmp_path / "scan.h5")
    os.utime(path, ns=(0, 1))
    assert all(abs(now - then) > 0.01 for now, then in zip(seen(), before, strict=True))


def test_everything_that_a_scan_lacks_is_said_at_once(tracking, tmp_path: Path) -> None:
    broken = {"x_m": tracking["x_m"], "z_m": tracking["z_m"][:-1], "pressure_pa": -tracking["pressure_pa"]}
    broken["pressure_pa"][3] = np.nan
    with pytest.raises(ValueError, match="y_m is missing") as found:
        read_scan(written(broken, tmp_path / "broken.h5"))
    for words in ("differ in length", "pressure_pa holds a value that is no number", "below 0"):
        assert words in str(found.value)
    few = {name: each[tracking["z_m"] > 1.7e-3] for name, each in tracking.items()}
    with pytest.raises(ValueError, match="planes of equal z_m"):
        read_scan(written(few, tmp_path / "few.h5"))
    cut = {name: each[np.abs(tracking["x_m"]) < 0.16e-3] for name, each in tracking.items()}
    with pytest.raises(ValueError, match="a wider scan"):
        read_scan(written(cut, tmp_path / "cut.h5"))
    behind = {name: each[tracking["z_m"] > 0.1e-3] for name, each in tracking.items()}
    with pytest.raises(ValueError, match="from before the focus"):
        read_scan(written(behind, tmp_path / "behind.csv"))
    (tmp_path / "scan.txt").write_text("x_m\n0\n", encoding="utf-8")
    with pytest.raises(ValueError, match=r"\.csv, \.h5"):
        read_scan(str(tmp_path / "scan.txt"))
    with pytest.raises(ValueError, match="is no file here"):
        read_scan(str(tmp_path / "absent.csv"))


def test_a_scene_with_unreadable_scans_says_so_of_each(tmp_path: Path) -> None:
    absent = str(tmp_path / "absent.h5")
    scene = load_scene("bovine-muscle").with_(
        {
            "simulation.beams.field": "measured",
            "simulation.beams.excitation_scan": absent,
            "simulation.beams.tracking_scan": absent,
        }
    )
    assert [each.path for each in check_declared(scene)] == [
        "simulation.beams.excitation_scan",
        "simulation.beams.tracking_scan",
    ]
