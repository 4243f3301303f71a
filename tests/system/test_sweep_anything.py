"""Sweeps over any number: of scene, specimen or bench, each with each or together, checked before the first shot."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import hpe_rig as hpe
from hpe_rig.bench import read_bench
from hpe_rig.measurement import prepare, prepare_resumption, record_run, resume
from hpe_rig.plan import PlanError
from hpe_rig.report.sweep import make_sweep
from hpe_rig.result import result_csv
from hpe_rig.scene import SettingsError, parse_scene, shipped_scenes

AXES = {"tracking.delay_s": [0.0, 50e-6], "snr_db": [20.0, 40.0]}


@pytest.fixture(scope="module")
def swept(tmp_path_factory: pytest.TempPathFactory) -> hpe.Run:
    return hpe.sweep("table-1", AXES, path=tmp_path_factory.mktemp("sweep") / "run.h5")


def test_each_value_goes_with_each_and_stands_beside_its_result(swept: hpe.Run) -> None:
    result = swept.estimate()
    found = [tuple(shot.swept.values()) for shot in result.shots]
    assert found == [(0.0, 20.0), (0.0, 40.0), (50e-6, 20.0), (50e-6, 40.0)]
    noise_m = [shot.residual_m for shot in result.shots]
    # 20 dB less noise power is a tenth of its amplitude; of what 101 pulses leave it is known to 7 %.
    assert noise_m[0] / noise_m[1] == pytest.approx(10, rel=0.3)
    assert [shot.timeline.pulse_onset_s[0] for shot in swept.plan.shots[::2]] == pytest.approx(
        [swept.plan.shots[0].timeline.pulse_onset_s[0], swept.plan.shots[0].timeline.pulse_onset_s[0] + 50e-6]
    )
    header, *rows = result_csv(result).splitlines()
    column = header.split(",").index("simulation.receiver.snr_db")
    assert [row.split(",")[column] for row in rows] == ["20.0", "40.0", "20.0", "40.0"]
    sweep = make_sweep(result.shots)
    assert sweep is not None
    assert sweep.label == "tracking.delay_s"
    assert {curve.group for curve in sweep.curves} == {f"simulation.receiver.snr_db = {snr}" for snr in (20, 40)}


def test_the_first_point_is_the_scene_measured_alone(swept: hpe.Run, tmp_path: Path) -> None:
    alone = hpe.load_scene("table-1").with_({"tracking.delay_s": 0.0, "simulation.receiver.snr_db": 20.0})
    run = hpe.measure(alone, path=tmp_path / "alone.h5")
    np.testing.assert_array_equal(run.records[0].codes, swept.records[0].codes)


@pytest.mark.slow
def test_a_sweep_of_the_specimen_goes_on_where_it_stopped(swept: hpe.Run, tmp_path: Path) -> None:
    def stop(progress: object) -> None:
        if progress.shot.index == 2 and progress.records:  # type: ignore[attr-defined]
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        record_run(prepare(swept.path), tmp_path / "cut.h5", stop)
    rest = hpe.open_run(resume(prepare_resumption(tmp_path / "cut.h5"), tmp_path / "rest.h5"))
    assert rest.stored.predecessor == "cut.h5"
    for shot in range(4):
        np.testing.assert_array_equal(rest.records[shot].codes, swept.records[shot].codes)


def test_together_the_values_go_in_step_and_may_move_the_frequencies(tmp_path: Path) -> None:
    """A burst rate of 200 Hz has harmonics of its own; the bench's drive of 0.5 Vpp pushes with a quarter."""
    scene = hpe.load_scene("bovine-muscle").with_({"excitation.burst_count": 8, "processing.window_start_s": 20e-3})
    axes = {"burst_rate_hz": [100.0, 200.0, 200.0], "bench.limits.full_drive_vpp": [1.0, 1.0, 0.5]}
    run = hpe.sweep(scene, axes, together=True, path=tmp_path / "run.h5")
    result = run.estimate()
    assert [len(shot.estimates) for shot in result.shots] == [10, 9, 9]
    assert [shot.estimates[0].frequency_hz for shot in result.shots] == [100.0, 200.0, 200.0]
    full, half = (result.shots[index].estimates[0].true_amplitude_m or 0.0 for index in (1, 2))
    assert half / full == pytest.approx(0.25, rel=1e-3)
    sweep = make_sweep(result.shots)
    assert sweep is not None
    at_200 = next(curve for curve in sweep.curves if curve.frequency_hz == 200.0)
    assert at_200.x.tolist() == [100.0, 200.0]


def test_what_cannot_be_swept_is_refused_with_every_reason_before_anything_is_opened(tmp_path: Path) -> None:
    with pytest.raises(
        SettingsError, match=r"(?s)2 mistakes.*sweep\.pulse_cont: .*tracking\.pulse_count.*sweep\.offset: "
    ):
        hpe.sweep("table-1", {"pulse_cont": [1], "offset": [1.0]})
    with pytest.raises(SettingsError, match=r"(?s)2 mistakes.*at tracking\.cycles = 2\.5.*whole.*-1"):
        hpe.sweep("table-1", {"cycles": [2.5, 3.0], "gate_length_m": [1e-3, -1.0]}, together=True)
    with pytest.raises(SettingsError, match="equally many values"):
        hpe.sweep("table-1", {"cycles": [2], "delay_s": [0.0, 1.0]}, together=True)
    with pytest.raises(SettingsError, match="50 of 512 samples; 60 of 512 samples"):
        hpe.sweep("table-1", {"pulse_count": [50, 60]})
    with pytest.raises(SettingsError, match=r"(?s)2 mistakes.*bandwidth: .*bandwidth: "):
        hpe.sweep("table-1", {"simulation.scatterers.bandwidth": [0.065, -1.0, 5.0]})
    listed = hpe.load_scene("table-1").with_(
        {"sweep.pulse_rate_hz": [4000.0, 2000.0], "sweep.window_length_s": [5e-3], "sweep.lateral_offset_m": [0.0]}
    )
    with pytest.raises(
        SettingsError, match=r"(?s)2 mistakes.*sweep\.pulse_rate_hz = \[4000.*without sweep.*\[0\.005\]"
    ):
        hpe.sweep(listed, {"tracking.pulse_rate_hz": [3000.0], "processing.window_length_s": [6e-3, 7e-3]})
    with pytest.raises(PlanError, match="12000 Hz"):
        hpe.sweep("table-1", {"tracking.pulse_rate_hz": [4000.0, 12000.0]}, path=tmp_path / "no.h5")
    with pytest.raises(TypeError, match="mapping"):
        hpe.sweep("table-1", ["cycles"])  # type: ignore[arg-type]
    assert list(tmp_path.iterdir()) == []


def test_axes_stand_in_the_scene_as_tables_or_in_quotes() -> None:
    base = shipped_scenes()["table-1"]
    nested = parse_scene("a", base + "\n[sweep]\ntracking.delay_s = [0.0, 1e-4]\n").scene
    quoted = parse_scene("a", base + '\n[sweep]\n"tracking.delay_s" = [0.0, 1e-4]\n').scene
    assert nested == quoted
    assert [point.scene.tracking.delay_s for point in nested.points] == [0.0, 1e-4]
    with pytest.raises(SettingsError, match=r"sweep\.tracking\.delay_s.*'a' is no number"):
        parse_scene("a", base + '\n[sweep]\n"tracking.delay_s" = ["a"]\n')


def test_a_sweep_loosens_no_limit_of_a_real_bench() -> None:
    bench = read_bench().bench.model_copy(update={"simulated": False})
    lower = bench.with_({("limits", "max_duty"): 0.01, ("generators", "toneburst", "latency_s"): 1e-7})
    assert lower.limits.max_duty == 0.01
    values = {("limits", "max_duty"): 0.9, ("calibration", "toneburst", "amplitude_vpp"): 9.0}
    with pytest.raises(SettingsError, match=r"(?s)2 mistakes.*max_duty.*at most 0\.05.*calibration"):
        bench.with_(values)
