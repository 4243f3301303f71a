"""The main job end to end: scene, plan, real drivers on the twin, file, estimates."""

from __future__ import annotations

import json
import math
import tomllib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
import xarray as xr
from click.testing import Result as CommandResult
from typer.testing import CliRunner

import hpe_rig as hpe
from drivers.agilent.generator import Agilent33250A
from drivers.interfaces import GeneratorTask, PulseTrain
from hpe_rig.bench import read_bench
from hpe_rig.bench.opening import open_bench
from hpe_rig.cli.app import app
from hpe_rig.measurement.run import record_run
from hpe_rig.measurement.sequencer import Progress, ShotBlock, acquire
from hpe_rig.measurement.setup import Setup, prepare
from hpe_rig.prediction import force_spectrum, predicted_averaging
from hpe_rig.result import Result
from hpe_rig.runs.run import process
from hpe_rig.scene import Scene, shipped_scenes
from hpe_rig.store import StoreError, read_run, result_path
from sim_backend.motion.specimen import frequency_response
from sim_backend.settings import Specimen

Prepare = Callable[..., Setup]
Measure = Callable[..., Result]
NOISE = "snr_db = 40.0"


def analytic_truth(harmonic: int) -> tuple[float, float]:
    """Return amplitude and phase (sine, from a burst's onset) of the shipped muscle's steady state at n f_r.

    Specimen's response in closed form times the coefficient of eq. (18): no sampling, no transient.
    """
    scene = prepare("bovine-muscle").scene.scene
    assert scene.simulation is not None
    assert scene.excitation is not None
    assert scene.beams is not None
    specimen = Specimen.model_validate(scene.simulation["specimen"])
    response = frequency_response(specimen, scene.beams.excitation_width_m, np.array([100.0 * harmonic]))[0]
    force = specimen.force_density_n_per_m3 * force_spectrum(harmonic, 100.0, scene.excitation.burst_length_s[0])
    phasor = 2 * response * complex(force)
    return abs(phasor), float(np.angle(phasor) + np.pi / 2)


@pytest.mark.parametrize("scene", ["bovine-muscle-synchronous", pytest.param("bovine-muscle", marks=pytest.mark.slow)])
def test_the_truth_of_bovine_muscle_is_the_analytic_steady_state(measured: Measure, scene: str) -> None:
    (shot,) = measured(scene).shots
    for estimate in shot.estimates:
        amplitude_m, phase_rad = analytic_truth(round(estimate.frequency_hz / 100))
        # The transient of the first bursts has died out to 1e-3 when the window starts, 50 ms after them.
        assert estimate.true_amplitude_m == pytest.approx(amplitude_m, rel=1e-3)
        assert abs(math.remainder((estimate.true_phase_rad or 0) - phase_rad, 2 * math.pi)) < 1e-3


def test_bovine_muscle_finds_every_harmonic_of_the_specimen_within_the_speckle_spread(measured: Measure) -> None:
    result = measured("bovine-muscle")
    assert result.simulated
    assert result.status == "complete"
    assert not result.warnings
    (shot,) = result.shots
    assert not shot.warnings
    assert [estimate.frequency_hz for estimate in shot.estimates] == [100.0 * n for n in range(1, 11)]
    averaging = predicted_averaging(prepare("bovine-muscle").scene.scene, "coherent")
    for estimate, tracked in zip(shot.estimates, averaging, strict=True):
        amplitude_m, phase_rad = analytic_truth(round(estimate.frequency_hz / 100))
        assert tracked is not None
        assert estimate.averaging_factor is not None
        assert estimate.speckle_relative is not None
        predicted_m = amplitude_m * estimate.averaging_factor
        # Three standard deviations of the one speckle draw and of the noise together.
        tolerance_m = 3 * np.hypot(estimate.speckle_relative * predicted_m, estimate.tracked_amplitude_uncertainty_m)
        assert abs(estimate.tracked_amplitude_m - predicted_m) < tolerance_m
        # Three standard deviations of noise and aliasing, which u states, and of the lag: the field lags beside the
        # focus, by how much depends on a medium that nobody declares.
        error_rad = math.remainder(estimate.tracked_phase_rad - phase_rad - tracked.phase_rad, 2 * math.pi)
        assert abs(error_rad) < 3 * np.hypot(estimate.tracked_phase_uncertainty_rad, tracked.phase_uncertainty_rad)


def test_synchronous_pulses_alias_higher_harmonics_and_the_result_says_so(measured: Measure) -> None:
    free = ("[processing]", '[processing]\nharmonic = "least_squares"')
    result = measured("bovine-muscle-synchronous", free)
    assert any("aliasing harmonics" in warning for warning in result.warnings)
    last = result.shots[0].estimates[-1]
    # 16 degrees at 1 kHz by the analytic series summed at the pulses' own times, far outside the noise: u says so
    noise = next(part.phase_rad for part in last.components if part.source == "noise")
    assert abs(last.tracked_phase_error_rad or 0) > np.radians(10) > 10 * noise
    assert abs(last.tracked_phase_error_rad or np.inf) < 3 * last.tracked_phase_uncertainty_rad
    with_prior = measured("bovine-muscle-synchronous").shots[0].estimates[-1]
    assert (
        abs(with_prior.tracked_phase_error_rad or np.inf) < 3 * with_prior.tracked_phase_uncertainty_rad < np.radians(5)
    )


@pytest.mark.slow
def test_the_same_scene_gives_the_same_file_bit_for_bit(prepared: Prepare, tmp_path: Path) -> None:
    setup = prepared("bovine-muscle-synchronous")
    first, second = (record_run(setup, tmp_path / f"{name}.h5") for name in "ab")
    assert first.read_bytes() == second.read_bytes()


def test_another_seed_gives_another_file(prepared: Prepare, tmp_path: Path) -> None:
    first = record_run(prepared("table-1"), tmp_path / "a.h5")
    second = record_run(prepared("table-1", ("seed = 1", "seed = 2")), tmp_path / "b.h5")
    assert not np.array_equal(read_run(first).records[0].codes, read_run(second).records[0].codes)


@pytest.mark.slow
def test_single_port_and_dual_port_boards_record_the_same(prepared: Prepare, tmp_path: Path) -> None:
    single = ("[simulation]\n", "[simulation]\ninstruments = {dual_port_memory = false}\n")
    first = record_run(prepared("table-1"), tmp_path / "a.h5")
    second = record_run(prepared("table-1", single), tmp_path / "b.h5")
    np.testing.assert_array_equal(read_run(first).records[0].codes, read_run(second).records[0].codes)


@pytest.mark.slow
def test_force_components_vanish_at_multiples_of_the_inverse_burst_length(measured: Measure, tmp_path: Path) -> None:
    # eq. (18): |F_n| has its zeros at n f_r = m / T_b; 1 kHz at T_b = 1 ms, against 900 and 1100 Hz beside it.
    bench = tmp_path / "long-bursts.toml"
    text = read_bench().text.replace("max_duty = 0.05", "max_duty = 0.2").replace("250e-6", "2e-3")
    bench.write_text(text, encoding="utf-8")
    result = measured(
        "bovine-muscle-synchronous",
        ("burst_length_s = 100e-6", "burst_length_s = 1e-3"),
        ("delay_s = 130e-6", 'delay_s = 130e-6\ndisturbed = "keep"'),
        ("synchronous = true", "synchronous = true\nfrequencies_hz = [100, 900, 1000, 1100]"),
        bench=bench,
    )
    _, below_m, zero_m, above_m = (estimate.true_amplitude_m or 0.0 for estimate in result.shots[0].estimates)
    assert zero_m < 1e-3 * min(below_m, above_m)


@pytest.mark.slow
def test_a_driver_that_programs_half_the_bursts_is_caught_by_the_result(
    measured: Measure, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = Agilent33250A.configure

    def half(self: Agilent33250A, task: GeneratorTask) -> None:
        wrong = self.role == "burst_train" and isinstance(task, PulseTrain)
        whole(self, replace(task, count=task.count // 2) if wrong else task)

    monkeypatch.setattr(Agilent33250A, "configure", half)
    (shot,) = measured("bovine-muscle-synchronous").shots
    assert any("tonebursts are missing" in warning for warning in shot.warnings)


def test_interference_that_is_forced_through_shows_in_the_echoes(prepared: Prepare, tmp_path: Path) -> None:
    clean = prepared("bovine-muscle-synchronous")
    forced = prepared("bovine-muscle-synchronous", ("delay_s = 130e-6", 'delay_s = 20e-6\ndisturbed = "keep"'))
    warned = {finding.check: finding.level for finding in forced.findings if finding.level != "passed"}
    assert warned == {"interference": "warning", "aliasing harmonics": "warning"}
    rms = []
    for index, setup in enumerate((clean, forced)):
        run = read_run(record_run(setup, tmp_path / f"{index}.h5"))
        gate = setup.plan.shots[0].gate
        codes = run.records[0].codes[:, gate].astype(float)
        rms.append(np.sqrt((codes**2).mean(axis=1)))
    # Every fortieth pulse, the one that follows a burst, stands out of the forced run and none out of the clean one.
    middle = np.median(rms[1])
    loud = np.flatnonzero(rms[1] > 1.5 * middle)
    assert loud.tolist() == list(range(0, 800, 40))
    assert (rms[0] < 1.5 * np.median(rms[0])).all()


def test_a_wrong_burst_rate_in_the_driver_shows_as_a_wrong_measurement(
    measured: Measure, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = Agilent33250A.configure

    def fast(self: Agilent33250A, task: GeneratorTask) -> None:
        wrong = self.role == "burst_train" and isinstance(task, PulseTrain)
        whole(self, replace(task, rate_hz=200.0) if wrong else task)

    monkeypatch.setattr(Agilent33250A, "configure", fast)
    edits = (
        ("burst_count = 20", "burst_count = 40"),
        ("delay_s = 130e-6", "delay_s = 130e-6\npulse_count = 800"),
    )
    result = measured("bovine-muscle-synchronous", *edits)
    estimates = {estimate.frequency_hz: estimate for estimate in result.shots[0].estimates}
    # Motion of every second harmonic alone is of no medium, which the prior tells and does not believe.
    assert estimates[100.0].tracked_amplitude_m < 3 * estimates[100.0].tracked_amplitude_uncertainty_m
    assert any("outside the ensemble" in warning for warning in result.shots[0].warnings)


def test_both_estimators_agree_on_one_run(prepared: Prepare, tmp_path: Path) -> None:
    run_file = record_run(prepared("table-1", (NOISE, "")), tmp_path / "run.h5")
    coherent, paper = (process(run_file, name).shots[0].estimates[0] for name in ("coherent", "cross_spectrum"))
    assert coherent.true_amplitude_m == pytest.approx(1e-6, rel=1e-3)
    # Two gates' speckle averages of the same echoes: 6 and 8 % apart from the mean (docs/explanation/echoes.md).
    assert paper.tracked_amplitude_m == pytest.approx(coherent.tracked_amplitude_m, rel=0.2)
    for estimate in (coherent, paper):
        assert abs(estimate.tracked_phase_rad) < np.radians(0.5)
        assert abs(estimate.tracked_phase_error_rad or 0) < np.radians(0.5)
        assert (tmp_path / "run.cross_spectrum.h5").exists()


def test_records_and_results_open_in_xarray_with_coordinates_and_units(measured: Measure, tmp_path: Path) -> None:
    result = measured("table-1")
    run_file = tmp_path / result.run_file
    with xr.open_dataset(run_file, group="records", engine="h5netcdf") as records:
        assert dict(records.sizes) == {"shot": 1, "pulse": 101, "sample": 512}
        assert records["echo"].attrs["units"] == "V"
        assert float(abs(records["echo"]).max()) < 0.8
        assert records["sample"].attrs["units"] == "s"
    with xr.open_dataset(result_path(run_file, "coherent"), group="results", engine="h5netcdf") as table:
        assert float(table["amplitude_m"].sel(frequency=200.0, shot=1)) == result.shots[0].estimates[0].amplitude_m


def test_the_run_file_keeps_scene_settings_and_provenance(prepared: Prepare, tmp_path: Path) -> None:
    setup = prepared("bovine-muscle-synchronous")
    path = record_run(setup, tmp_path / "run.h5")
    with h5py.File(path) as file:
        assert file["scene"].asstr()[()] == setup.scene.text
        settings = json.loads(file["snapshot"].asstr()[0])
        assert set(settings) == set(setup.plan.roles)
        assert file.attrs["status"] == b"complete"
        assert bool(file.attrs["simulated"])
        assert {"version_hpe_rig", "version_numpy", "version_commit"} <= set(file.attrs)


def test_an_existing_run_file_is_never_overwritten(prepared: Prepare, tmp_path: Path) -> None:
    path = tmp_path / "run.h5"
    path.write_bytes(b"precious")
    with pytest.raises(StoreError, match="already exists"):
        record_run(prepared("table-1"), path)
    assert path.read_bytes() == b"precious"


@pytest.mark.parametrize("content", [b"", b"no HDF5 at all", b"\x89HDF\r\n\x1a\n" + b"\0" * 100])
def test_a_foreign_file_is_refused_with_a_message(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "foreign.h5"
    path.write_bytes(content)
    with pytest.raises(StoreError, match="foreign"):
        process(path)


@pytest.mark.slow
def test_an_interrupted_run_can_be_processed_as_far_as_it_came(prepared: Prepare, tmp_path: Path) -> None:
    setup = prepared("table-1", ("[acquisition]", "[acquisition]\nrepeats = 3"))
    path = tmp_path / "run.h5"

    def stop_in_the_second_shot(progress: Progress) -> None:
        if progress.shot.index == 1:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        record_run(setup, path, stop_in_the_second_shot)
    result = process(path)
    assert result.status == "aborted"
    assert [shot.index for shot in result.shots] == [0]
    assert any("aborted" in warning for warning in result.warnings)


def test_a_scene_without_excitation_opens_no_excitation_generator(prepared: Prepare) -> None:
    setup = prepared("table-1")
    with open_bench(setup.scene.scene, setup.bench.bench, setup.plan.roles) as bench:
        assert bench.burst_train is None
        assert bench.toneburst is None
        blocks = [event for event in acquire(setup.plan, bench) if isinstance(event, ShotBlock)]
    assert sum(event.block.codes.shape[0] for event in blocks) == 101


def test_the_command_line_runs_checks_lists_copies_and_processes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)

    def rig(*arguments: str) -> CommandResult:
        return CliRunner().invoke(app, arguments)

    assert "bovine-muscle-synchronous" in rig("scenes").stdout
    assert rig("new", "mine", "--like", "table-1").exit_code == 0
    assert rig("new", "mine", "--like", "table-1").exit_code == 2
    assert "checks:" in rig("check", "mine.toml").stdout
    done = rig("run", "mine.toml", "--json")
    assert done.exit_code == 0, done.stderr
    assert json.loads(done.stdout)["shots"][0]["estimates"][0]["frequency_hz"] == 200.0
    assert "SIMULATED" in rig("process", "mine.h5").stdout
    assert json.loads(rig("schema").stdout)["properties"]["tracking"]
    wrong = rig("run", "nowhere")
    assert wrong.exit_code == 2
    assert "bovine-muscle-synchronous" in wrong.stderr
    assert "Traceback" not in wrong.stderr
    (tmp_path / "mine.toml").write_text("[tracking]\npulse_rate_hz = 0\n", encoding="utf-8")
    assert rig("check", "mine.toml").exit_code == 2


def test_a_run_that_is_refused_leaves_run_and_log_of_that_name_as_they_are(tmp_path: Path) -> None:
    run_file, log = tmp_path / "run.log", tmp_path / "run.log.log"
    run_file.write_bytes(b"records")
    log.write_text("how they came\n", encoding="utf-8")
    done = CliRunner().invoke(app, ["run", "table-1", "--output", str(run_file), "--verbose"])
    assert done.exit_code == 2
    assert "already exists" in done.stderr
    assert run_file.read_bytes() == b"records"
    assert log.read_text(encoding="utf-8").startswith("how they came\n")
    done = CliRunner().invoke(app, ["run", "table-1", "--output", str(tmp_path), "--overwrite"])
    assert (done.exit_code, tmp_path.is_dir()) == (2, True)
    assert "is not a readable run file of hpe-rig, so it is not replaced" in done.stderr


def test_a_shell_completes_commands_shipped_scenes_and_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "bovine-liver.toml").write_text("")
    monkeypatch.chdir(tmp_path)

    def completed(line: str) -> list[str]:
        asked = {"_HPE_RIG_COMPLETE": "complete_bash", "COMP_WORDS": line, "COMP_CWORD": str(line.count(" "))}
        return CliRunner().invoke(app, [], env=asked, prog_name="hpe-rig").output.split()

    assert {"report", "resume"} <= set(completed("hpe-rig re"))
    variants = "bovine-muscle-synchronous", "bovine-muscle-aperture"
    assert {"bovine-liver.toml", "bovine-muscle", *variants} == set(completed("hpe-rig run bov"))


def test_a_repeat_keeps_the_scatterers_and_draws_new_noise(prepared: Prepare, tmp_path: Path) -> None:
    setup = prepared("table-1", ("[acquisition]", "[acquisition]\nrepeats = 2"))
    first, second = (records.codes for records in read_run(record_run(setup, tmp_path / "run.h5")).records)
    assert not np.array_equal(first, second)
    echo = first[:, setup.plan.shots[0].gate].astype(float), second[:, setup.plan.shots[0].gate].astype(float)
    assert np.corrcoef(echo[0].ravel(), echo[1].ravel())[0, 1] > 0.99


def test_prepare_accepts_a_bench_file(tmp_path: Path) -> None:
    path = tmp_path / "other.toml"
    path.write_text(read_bench().text.replace("delay_s = 10e-9", "delay_s = 1e-6"), encoding="utf-8")
    setup = prepare("bovine-muscle-synchronous", path)
    assert setup.plan.shots[0].timeline.time_zero_s == pytest.approx(
        5e-9 + 100e-9 + 5e-9 + 100e-9 + 1e-6 + 70e-3 / 1540
    )


@pytest.mark.parametrize(("seeds", "limit"), [(1, 10.83), pytest.param(8, 3.27, marks=pytest.mark.slow)])
def test_a_rigid_motion_at_60_db_is_found_within_its_uncertainty(tmp_path: Path, seeds: int, limit: float) -> None:
    """All scatterers move by 1000 nm, no beam is declared to correct for: what is left is noise and the gate's edge."""
    tables = tomllib.loads(shipped_scenes()["table-1"])
    del tables["beams"]
    tables["simulation"] |= {"beams": {"width_ratio": [math.inf] * 3}, "receiver": {"snr_db": 60.0}}
    tables["acquisition"]["sound_speed_uncertainty"] = 0.0
    rigid = Scene.model_validate(tables)
    deviations: dict[str, list[float]] = {}
    for seed in range(1, seeds + 1):
        run = hpe.measure(rigid.with_({"simulation.seed": seed}), path=tmp_path / f"{seed}.h5")
        for estimator in ("coherent", "cross_correlation", "loupas", "cross_spectrum"):
            found = run.estimate(estimator).shots[0].estimates[0]
            most_m = 5e-9 if estimator == "cross_spectrum" else 0.3e-9
            assert found.amplitude_uncertainty_m < most_m, estimator
            deviations.setdefault(estimator, []).append((found.amplitude_m - 1e-6) / found.amplitude_uncertainty_m)
    for estimator, each in deviations.items():
        # Of chi-square with a degree of freedom for each seed, 0.1 % lie above the limit of each.
        assert np.mean(np.square(each)) < limit, estimator
