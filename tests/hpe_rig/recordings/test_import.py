"""Recordings of every format become the same run; what is wrong with one is said at once, each mistake in one line."""

from __future__ import annotations

import json
import sys
import tempfile
from collections.abc import Callable, Mapping
from csv import DictReader
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.io import savemat
from typer.testing import CliRunner

import hpe_rig as hpe
from hpe_rig.cli.app import app
from hpe_rig.measurement import prepare_resumption
from hpe_rig.recordings import as_source
from hpe_rig.result import main_shot
from hpe_rig.runs import import_recording
from hpe_rig.scene import SettingsError
from hpe_rig.store import StoreError, verify

RATE_HZ, PULSE_RATE_HZ, CARRIER_HZ, SPEED = 50e6, 4000.0, 5e6, 1540.0
PULSES, SAMPLES, LINES = 40, 160, 3
AMPLITUDE_M, PHASE_RAD, MOVED_HZ = 500e-9, 0.5, 200.0
SCENE = """
title = "Echoes of another program"
[tracking]
cycles = 2
[acquisition]
gate_depth_m = 1.2e-3
gate_length_m = 1.0e-3
[processing]
frequencies_hz = [200.0]
harmonic = "least_squares"
"""
RATES = {"sample_rate_hz": RATE_HZ, "pulse_rate_hz": PULSE_RATE_HZ, "carrier_hz": CARRIER_HZ}


def echoes(pulse_time_s: NDArray[np.float64], lines: int = LINES, demodulated: bool = False) -> NDArray[Any]:
    """Return echoes (line, pulse, sample) of rigid scatterers, directly by their formula; |values| below 1."""
    rng = np.random.default_rng(5)
    depth_m, weight = rng.uniform(-1e-3, 3.5e-3, (lines, 1, 300)), rng.normal(size=(lines, 1, 300))
    at_s = pulse_time_s[:, None] + depth_m / SPEED
    moved_m = AMPLITUDE_M * np.sin(2 * np.pi * MOVED_HZ * at_s + PHASE_RAD)
    late_s = np.arange(SAMPLES) / RATE_HZ - (2 * (depth_m + moved_m) / SPEED)[..., None]
    of_length = late_s * CARRIER_HZ / 1.5
    # exp(-2 * 4.3**2) is 1e-16
    near = np.abs(of_length) < 4.3
    each = np.zeros(late_s.shape, np.complex128 if demodulated else np.float64)
    phase_rad = 2 * np.pi * CARRIER_HZ * late_s[near]
    if demodulated:
        at_rest_rad = 2 * np.pi * CARRIER_HZ * np.arange(SAMPLES) / RATE_HZ
        phase_rad -= np.broadcast_to(at_rest_rad, late_s.shape)[near]
    each[near] = np.exp(-2 * of_length[near] ** 2) * (np.exp(1j * phase_rad) if demodulated else np.cos(phase_rad))
    summed = np.einsum("lps,lpst->lpt", np.broadcast_to(weight, each.shape[:3]), each)
    return np.asarray(summed / (1.01 * np.abs(summed).max()))


TIME_S = np.arange(PULSES) / PULSE_RATE_HZ
RF = echoes(TIME_S)


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    path = tmp_path / "scene.toml"
    path.write_text(SCENE, encoding="utf-8")
    return path


def npy(path: Path) -> dict[str, Any]:
    np.save(path.with_suffix(".npy"), RF[0].T)
    return RATES | {"axes": "sample,pulse"}


def npz(path: Path) -> dict[str, Any]:
    rates = {"fs": RATE_HZ, "prf": PULSE_RATE_HZ, "fc": CARRIER_HZ, "c": SPEED}
    np.savez(path.with_suffix(".npz"), rf=RF[0].astype(np.float32), pulse_time_s=TIME_S, **rates)  # type: ignore[arg-type]
    return {}


def matlab_5(path: Path) -> dict[str, Any]:
    savemat(path.with_suffix(".mat"), {"RF": RF[0].T, "param": {"fs": RATE_HZ, "fc": CARRIER_HZ, "PRF": PULSE_RATE_HZ}})
    return {"axes": "sample,pulse", "variable": "RF"}


def matlab_73(path: Path) -> dict[str, Any]:
    # As MATLAB writes it: axes in reverse order, numbers as arrays of 1 x 1, behind 512 bytes of its own.
    with h5py.File(path.with_suffix(".mat"), "w", userblock_size=512) as file:
        file["RF"] = RF[0]
        for name, value in (("fs", RATE_HZ), ("fc", CARRIER_HZ), ("PRF", PULSE_RATE_HZ)):
            file[f"param/{name}"] = np.array([[value]])
    return {"axes": "sample,pulse"}


def hdf5(path: Path) -> dict[str, Any]:
    with h5py.File(path.with_suffix(".h5"), "w") as file:
        file["data/raw_data"] = RF[0]
        file["scan/sampling_frequency"], file["scan/center_frequency"] = RATE_HZ, CARRIER_HZ
        file["data"].attrs["prf"] = PULSE_RATE_HZ
    return {"axes": ["pulse", "sample"]}


def csv(path: Path) -> dict[str, Any]:
    np.savetxt(path.with_suffix(".csv"), RF[0], delimiter=",", header="echoes, volts")
    return RATES | {"axes": "pulse,sample"}


def raw_float32(path: Path) -> dict[str, Any]:
    path.with_suffix(".raw").write_bytes(b"head" + RF[0].astype(">f4").tobytes())
    sidecar = {"dtype": "float32", "byte_order": "big", "header_bytes": 4, "axes": "pulse,sample"} | RATES
    lines = [f"{key} = {json.dumps(value)}" for key, value in sidecar.items()]
    lines.append(f"shape = [{PULSES}, {SAMPLES}]")
    path.with_suffix(".raw.toml").write_text("\n".join(lines), encoding="utf-8")
    return {}


def raw_int16(path: Path) -> dict[str, Any]:
    path.with_suffix(".bin").write_bytes(np.rint(RF[0] * 30000).astype("<i2").tobytes())
    return RATES | {"dtype": "int16", "shape": [PULSES, SAMPLES], "axes": "pulse,sample", "scale_v": 1 / 30000}


def alazar_words() -> NDArray[np.uint16]:
    """Return the words that a board of 14 bits makes of plus and minus 1 V: codes from -8192 on in the upper bits."""
    codes = np.floor(RF[0] * (2**14 - 1) / 2).astype(np.int32) + 8192
    return np.asarray(codes << 2, np.uint16)


def alazar_headers(path: Path) -> dict[str, Any]:
    # 50 MS/s and 1 V by the vendor's numbers; a count of the time stamp is two samples.
    header = np.zeros((PULSES, 4), "<u4")
    header[:, 1] = np.arange(PULSES)
    header[:, 2] = np.rint(TIME_S * RATE_HZ / 2) + 12345
    header[:, 3] = 0x22 << 11 | 10 << 18
    data = np.concatenate([header.view(np.uint8), alazar_words().astype("<u2").view(np.uint8)], axis=1)
    path.with_suffix(".alz").write_bytes(data.tobytes())
    return {"board": "ATS460", "record_samples": SAMPLES, "carrier_hz": CARRIER_HZ}


def alazar_npt(path: Path) -> dict[str, Any]:
    words = alazar_words().reshape(4, 1, -1, SAMPLES)
    both = np.concatenate([np.full_like(words, 1 << 15), words], axis=1)
    path.with_suffix(".bin").write_bytes(both.astype("<u2").tobytes())
    board = {"board": "ATS460", "record_samples": SAMPLES, "channels": 2, "channel": "B", "headers": False}
    return RATES | board | {"records_per_buffer": PULSES // 4, "input_range_v": 1.0}


def iq(path: Path) -> dict[str, Any]:
    np.save(path.with_suffix(".npy"), echoes(TIME_S, 1, demodulated=True)[0].astype(np.complex64))
    return RATES | {"axes": "pulse,sample", "demodulation_hz": CARRIER_HZ}


def iq_pairs_reversed(path: Path) -> dict[str, Any]:
    values = echoes(TIME_S, 1, demodulated=True)[0].conj()
    np.save(path.with_suffix(".npy"), np.stack([values.real, values.imag], axis=-1))
    return RATES | {"axes": "pulse,sample,iq", "demodulation_hz": CARRIER_HZ, "sign": -1}


FORMATS = [npy, npz, matlab_73, hdf5, raw_float32, raw_int16, alazar_headers, alazar_npt]


@pytest.mark.parametrize(
    "write",
    [*FORMATS, iq_pairs_reversed, *(pytest.param(write, marks=pytest.mark.slow) for write in (matlab_5, csv, iq))],
)
def test_every_format_gives_the_true_motion_of_its_echoes(
    write: Callable[[Path], dict[str, Any]], scene: Path, tmp_path: Path
) -> None:
    settings = write(tmp_path / "rf")
    (source,) = (each for each in tmp_path.iterdir() if each.name.startswith("rf.") and each.suffix != ".toml")
    run = hpe.import_records(source, scene, tmp_path / "run.h5", **settings)
    records = run.records[0]
    volts = records.codes * records.volts_per_code + records.volts_offset
    if not write.__name__.startswith("iq"):
        # Half a step of the board's 14 bits; of 16 bits a whole one, of which half is the offset of code 0.
        most = 1.0 / (2**14 - 1) if "alazar" in write.__name__ else 2.0 / 2**15
        assert np.abs(volts - RF[0]).max() <= most * (1 + 1e-6)
    assert run.bench.recording is not None
    assert not run.stored.simulated
    if write not in (npz, iq, iq_pairs_reversed):
        # Equal volts and rates have the same estimates.
        assert (run.scene.acquisition.sample_rate_hz, run.scene.tracking.pulse_rate_hz) == (RATE_HZ, PULSE_RATE_HZ)
        return
    (found,) = run.estimate().shots[0].estimates
    # What 40 pulses of exact echoes leave: gate edge 0.1 %, and 5 nm of speckle's own motion within the gate.
    assert found.tracked_amplitude_m == pytest.approx(
        AMPLITUDE_M, abs=3 * found.tracked_amplitude_uncertainty_m + 1e-3 * AMPLITUDE_M
    )
    assert found.tracked_phase_rad == pytest.approx(PHASE_RAD, abs=3e-3)


def test_forces_of_the_scene_that_the_shots_of_a_file_receive_are_named(scene: Path, tmp_path: Path) -> None:
    excitation = "[excitation]\nburst_rate_hz = 200.0\nburst_length_s = 1e-4\nburst_count = 2"
    tables = f'{excitation}\nforce_fraction = [0.5, 1.0]\n[tracking]\ndisturbed = "skip"'
    scene.write_text(SCENE.replace("[tracking]", tables), encoding="utf-8")
    settings = RATES | {"axes": "shot,pulse,sample"}
    _, inferred = import_recording(as_source(np.stack([RF[0], RF[0]])), scene, tmp_path / "run.h5", options=settings)
    assert "the shots have excitation.force_fraction = 0.5, 1.0 of the scene in turn" in inferred


def test_an_imported_run_is_sound_states_its_origin_and_is_not_resumed(scene: Path, tmp_path: Path) -> None:
    path = tmp_path / "rf.npz"
    npz(tmp_path / "rf")
    run_file, inferred = import_recording(path, scene, tmp_path / "run.h5")
    assert any("carrier_hz = 5e+06, from 'fc' of the file" in text for text in inferred)
    assert verify(run_file).as_dict()["sound"]
    result = hpe.open_run(run_file).estimate()
    assert result.origin.startswith("IMPORTED from rf.npz, SHA-256 ")
    assert str(result.as_dict()["imported"]) in result.origin
    # The recording states no master trigger.
    assert result.phase_reference.endswith("t from time zero of the recording's pulses")
    with pytest.raises(StoreError, match=r"imported from rf\.npz: no instrument can continue it"):
        prepare_resumption(run_file)


def test_an_imported_run_is_swept_over_its_processing_settings(scene: Path) -> None:
    run = hpe.import_records(RF, scene, scene.parent / "run.h5", axes="line,pulse,sample", lines="1", **RATES)
    result = run.sweep({"gate_length_m": [0.6e-3, 1e-3], "gate_depth_m": [1.2e-3, 1.0e-3]})
    names = ("acquisition.gate_length_m", "acquisition.gate_depth_m")
    assert [tuple(shot.swept[name] for name in names) for shot in result.shots] == [
        (0.6e-3, 1.2e-3),
        (0.6e-3, 1.0e-3),
        (1e-3, 1.2e-3),
        (1e-3, 1.0e-3),
    ]
    # Each point is what an import with a scene of these values would have given.
    other = scene.parent / "other.toml"
    other.write_text(SCENE.replace("1.2e-3", "1.0e-3").replace("gate_length_m = 1.0e-3", "gate_length_m = 0.6e-3"))
    alone = hpe.import_records(RF, other, scene.parent / "alone.h5", axes="line,pulse,sample", lines="1", **RATES)
    assert result.shots[1].estimates == alone.estimate().shots[0].estimates
    assert len({shot.estimates for shot in result.shots}) == 4
    together = run.sweep({"gate_length_m": [0.6e-3, 1e-3], "background_order": [0, 1]}, together=True)
    assert len(together.shots) == 2
    assert together.shots[1].estimates[0].tracked_amplitude_m != result.shots[2].estimates[0].tracked_amplitude_m


def test_a_swept_window_replaces_the_windows_of_the_scene(scene: Path) -> None:
    scene.write_text(f"{SCENE}[sweep]\nwindow_length_s = [5e-3, 10e-3]\n")
    run = hpe.import_records(RF[0], scene, scene.parent / "run.h5", axes="pulse,sample", **RATES)
    assert [shot.window_length_s for shot in run.estimate().shots] == [5e-3, 10e-3]
    found = run.sweep({"window_length_s": [7.5e-3, 10e-3]}).shots
    assert [(shot.window_length_s, shot.pulses_used) for shot in found] == [(7.5e-3, 30), (10e-3, 40)]
    assert len(run.sweep({"background_order": [0, 1]}).shots) == 4


def test_a_shot_without_result_at_some_points_of_a_sweep_names_them(scene: Path) -> None:
    holed = RF.copy()
    holed[1, 18:] = np.nan
    settings = RATES | {"axes": "line,pulse,sample", "line_pitch_m": 0.3e-3, "not_finite": "missing"}
    run = hpe.import_records(holed, scene, scene.parent / "run.h5", lines="all", **settings)
    result = run.sweep({"window_start_s": [0.0, 5e-3]})
    assert [(shot.index, shot.swept["processing.window_start_s"]) for shot in result.shots] == [
        *((0, 0.0), (1, 0.0), (2, 0.0)),
        *((0, 5e-3), (2, 5e-3)),
    ]
    ((number, why),) = result.shots_without_result
    assert number == 2
    assert why.startswith("at processing.window_start_s = 0.005: ")
    assert any(text.startswith("at processing.window_start_s = 0.005: shot 2 left out") for text in result.warnings)


def test_conflicting_options_of_a_sweep_are_refused(scene: Path) -> None:
    run = hpe.import_records(RF[0], scene, scene.parent / "run.h5", axes="pulse,sample", **RATES)
    alone = CliRunner().invoke(app, ["process", str(run.path), "--together"])
    profile = ["--sweep", "background_order=0,1", "--gate-profile-step", "1mm"]
    both = CliRunner().invoke(app, ["process", str(run.path), *profile])
    assert "no --sweep is given" in alone.output
    assert "no depth profile" in both.output
    assert alone.exit_code == both.exit_code == 2


@pytest.mark.parametrize(
    ("axes", "said"),
    [
        ({"pulse_rate_hz": [1e3], "snr": [1.0], "carrier_hz": [1e6]}, "snr"),
        pytest.param(
            {"pulse_rate_hz": [1e3], "carrier_hz": [1e6]},
            r"(?s)2 mistakes.*pulse_rate_hz.*carrier_hz.*hpe-rig run",
            marks=pytest.mark.slow,
        ),
        ({"gate_depth_m": [1.2e-3, 20e-3]}, "a gate leaves the records, which go from 0 to 2.464 mm"),
        pytest.param({"background_order": [-3]}, "background_order", marks=pytest.mark.slow),
        pytest.param({"gate_profile_step_m": [1e-3]}, "a sweep has no depth profile", marks=pytest.mark.slow),
        pytest.param({"gate_length_m": []}, "gate_length_m", marks=pytest.mark.slow),
    ],
)
def test_an_axis_of_the_acquisition_is_not_swept_after_it(
    axes: Mapping[str, list[float]], said: str, scene: Path
) -> None:
    run = hpe.import_records(RF[0], scene, scene.parent / "run.h5", axes="pulse,sample", **RATES)
    with pytest.raises(SettingsError, match=said):
        run.sweep(axes)


def test_the_command_sweeps_a_stored_run_and_the_list_marks_it_as_imported(scene: Path) -> None:
    path = scene.parent / "run.h5"
    hpe.import_records(RF[0], scene, path, axes="pulse,sample", **RATES)
    options = ["--sweep", "gate_length_m=0.6e-3,1e-3", "--sweep", "background_order=0,1"]
    done = CliRunner().invoke(app, ["process", str(path), *options, "--together", "--csv"])
    rows = list(DictReader(done.stdout.splitlines()))
    assert [float(row["acquisition.gate_length_m"]) for row in rows] == [0.6e-3, 1e-3]
    assert list(path.parent.glob("run.*.h5")) == []
    wrong = CliRunner().invoke(app, ["process", str(path), "--sweep", "x", "--sweep", "gate_length_m=a"])
    assert wrong.exit_code == 2
    assert "2 mistakes" in wrong.stderr
    assert "imported, complete" in CliRunner().invoke(app, ["list", str(path.parent)]).stdout
    (row,) = json.loads(CliRunner().invoke(app, ["list", str(path.parent), "--find", "imported", "--json"]).stdout)
    assert row["imported"] == "array"


def test_a_full_disk_of_temporary_files_is_no_damaged_file(scene: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    resource = pytest.importorskip("resource", reason="no limits of this kind on Windows")
    path = scene.parent / "rf.mat"
    savemat(path, {"rf": RF[0]}, do_compression=True)
    # The limit below would cut compiled modules short as well, for everybody who shares them.
    monkeypatch.setenv("PYTHONDONTWRITEBYTECODE", "1")
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    # The reader in its own process meets what a full disk does: an OSError at its first larger write.
    resource.setrlimit(resource.RLIMIT_FSIZE, (RF[0].nbytes // 2, hard))
    try:
        with pytest.raises(SettingsError, match=r"cannot be written to temporary files in .*File too large.*TMPDIR"):
            hpe.import_records(path, scene, scene.parent / "run.h5", axes="pulse,sample", **RATES)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    monkeypatch.setattr(tempfile, "tempdir", str(scene.parent / "absent"))
    with pytest.raises(SettingsError, match=r"no temporary file can be made for its numbers \(No such file.*TMPDIR"):
        hpe.import_records(path, scene, scene.parent / "run.h5", axes="pulse,sample", **RATES)


@pytest.mark.slow
def test_the_report_of_a_stored_runs_sweep_follows_its_axes(scene: Path) -> None:
    path, page = scene.parent / "run.h5", scene.parent / "swept.html"
    hpe.import_records(RF[0], scene, path, axes="pulse,sample", **RATES)
    options = ["--sweep", "gate_length_m=0.6e-3,1e-3", "--sweep", "background_order=0,1", "--output", str(page)]
    done = CliRunner().invoke(app, ["report", str(path), *options])
    assert done.exit_code == 0, done.output
    html = page.read_text(encoding="utf-8")
    assert "<h2>Over acquisition.gate_length_m</h2>" in html
    for words in ("background_order = 0", "background_order = 1", 'id="sweep-amplitude-200', 'id="sweep-phase-200'):
        assert words in html, words
    # All four points stand in the table; what is drawn of one shot is with its own gate.
    assert (
        html.count('<th scope="col">acquisition.gate_length_m</th><th scope="col">processing.background_order</th>')
        == 1
    )
    shown = main_shot(hpe.open_run(path).sweep({"gate_length_m": [0.6e-3, 1e-3], "background_order": [0, 1]}))
    length_mm = shown.swept["acquisition.gate_length_m"] * 1e3
    assert f"{length_mm:g} mm at 1.2 mm depth" in html
    assert f"acquisition.gate_length_m = {length_mm * 1e-3:g}." in html
    assert list(path.parent.glob("run.*.h5")) == []
    wrong = CliRunner().invoke(app, ["report", str(path), "--together", "--sweep", "pulse_rate_hz=1e3,2e3"])
    assert (wrong.exit_code, "the records hold one value" in " ".join(wrong.output.split())) == (2, True)
    alone = CliRunner().invoke(app, ["report", str(path), "--together"])
    assert (alone.exit_code, "no --sweep is given" in alone.output) == (2, True)


def test_lines_become_lateral_offsets_or_their_mean(scene: Path) -> None:
    rates = RATES | {"axes": "line,pulse,sample", "line_pitch_m": 0.3e-3}
    places = hpe.import_records(RF, scene, scene.parent / "all.h5", lines="all", **rates)
    assert [shot.lateral_offset_m for shot in places.plan.shots] == pytest.approx([-0.3e-3, 0.0, 0.3e-3])
    assert len(places.estimate().shots) == LINES
    mean = hpe.import_records(RF, scene, scene.parent / "mean.h5", lines="mean:2-3", **rates)
    volts = mean.records[0].codes * mean.records[0].volts_per_code
    assert np.abs(volts - RF[1:].mean(axis=0)).max() <= 2.0 / 2**15


def test_irregular_pulses_keep_their_times(scene: Path) -> None:
    # Every fourth pulse late by a third of the period: at even times the estimate would be off by many per cent.
    time_s = TIME_S + np.where(np.arange(PULSES) % 4 == 3, 0.3 / PULSE_RATE_HZ, 0.0)
    settings = RATES | {"axes": "pulse,sample", "pulse_time_s": time_s.tolist()}
    del settings["pulse_rate_hz"]
    run = hpe.import_records(echoes(time_s, 1)[0], scene, scene.parent / "uneven.h5", **settings)
    (found,) = run.estimate().shots[0].estimates
    assert found.tracked_amplitude_m == pytest.approx(AMPLITUDE_M, rel=1e-3)


def test_records_that_are_not_finite_may_count_as_missing(scene: Path) -> None:
    holed = RF[0].copy()
    holed[[3, 17, 18]] = np.nan
    settings = RATES | {"axes": "pulse,sample"}
    with pytest.raises(SettingsError, match="3 of 40 records hold values that are not finite: line 1 shot 1 pulse 4"):
        hpe.import_records(holed, scene, scene.parent / "run.h5", **settings)
    run = hpe.import_records(holed, scene, scene.parent / "run.h5", not_finite="missing", **settings)
    assert np.flatnonzero(~run.records[0].valid).tolist() == [3, 17, 18]
    assert run.estimate().shots[0].pulses_missing == 3


def test_constant_records_are_missing_and_a_recording_of_them_alone_is_refused(scene: Path) -> None:
    settings = RATES | {"axes": "pulse,sample"}
    constant = RF[0].copy()
    constant[[5, 6]] = 0.25
    run = hpe.import_records(constant, scene, scene.parent / "pulse.h5", **settings)
    assert run.bench.recording is not None
    said = "2 records with one value throughout: missing (line 1 shot 1 pulse 6, line 1 shot 1 pulse 7)"
    assert said in run.bench.recording.inferred
    (shot,) = run.estimate().shots
    assert shot.pulses_missing == 2
    assert shot.estimates[0].tracked_amplitude_m == pytest.approx(AMPLITUDE_M, rel=1e-3)
    lines = np.stack([RF[0], np.ones((PULSES, SAMPLES))])
    settings |= {"axes": "line,pulse,sample", "line_pitch_m": 1e-4}
    for selected in ("2", "mean"):
        with pytest.raises(SettingsError, match=r"no selected record holds an echo \(1 line without any: 2\)"):
            hpe.import_records(lines, scene, scene.parent / "lines.h5", lines=selected, **settings)
    hpe.import_records(lines, scene, scene.parent / "first.h5", lines="1", **settings)


def test_a_scene_with_the_name_of_the_recording_is_no_sidecar(tmp_path: Path) -> None:
    (tmp_path / "rf.toml").write_text(SCENE, encoding="utf-8")
    np.save(tmp_path / "rf.npy", RF[0])
    run = hpe.import_records(tmp_path / "rf.npy", tmp_path / "rf.toml", axes="pulse,sample", **RATES)
    assert run.scene.title == "Echoes of another program"
    # Asked for by name it is one, with mistakes.
    with pytest.raises(SettingsError, match="unknown key"):
        hpe.import_records(tmp_path / "rf.npy", tmp_path / "rf.toml", sidecar=tmp_path / "rf.toml", **RATES)
