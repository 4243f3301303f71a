"""Gate tracking: 100 nm in tissue that moves by centimetres with heart beat and breathing."""

from pathlib import Path

import numpy as np
import pytest

import hpe_rig as hpe
from hpe_rig.bench import read_bench
from hpe_rig.plan import check_plan, make_plan
from hpe_rig.processing import EchoGate
from hpe_rig.processing.motion.gate_tracking import track_gate
from hpe_rig.scene import Scene, SettingsError, load_scene

HEART = {"frequency_hz": 1.2, "amplitude_m": 5e-3, "harmonics": [0.3, 0.15]}
BREATHING = {"frequency_hz": 0.25, "amplitude_m": 20e-3}
PHASE_RAD = 0.7
# The motion is uniform, so that the beam averages nothing.
EVERYWHERE = [float("inf")] * 3


def moving(background: list[dict[str, object]], seed: int, **values: object) -> Scene:
    rigid = {"simulation.seed": seed, "simulation.beams.width_ratio": EVERYWHERE}
    phase = {"simulation.motion[0].phase_rad": PHASE_RAD, "simulation.background": background}
    return load_scene("cardiac-background").with_({**rigid, **phase, **values})


def measured(scene: Scene, path: Path) -> tuple[float, float]:
    """Return the errors of amplitude and phase in units of their u."""
    estimate = hpe.measure(scene, path=path).estimate().shots[0].estimates[0]
    assert estimate.true_amplitude_m == pytest.approx(100e-9, rel=1e-5)
    phase = (estimate.tracked_phase_rad - PHASE_RAD) / estimate.tracked_phase_uncertainty_rad
    return (estimate.tracked_amplitude_m - 100e-9) / estimate.tracked_amplitude_uncertainty_m, phase


@pytest.mark.parametrize(
    "background", [[HEART], pytest.param([BREATHING], marks=pytest.mark.slow)], ids=["heart", "breathing"]
)
def test_100_nm_are_measured_in_moving_tissue(background: list[dict[str, object]], tmp_path: Path) -> None:
    short = {"tracking.pulse_count": 400, "acquisition.record_samples": 2048, "processing.background_order": 10}
    errors = measured(moving(background, seed=3, **short), tmp_path / "run.h5")
    assert np.abs(errors).max() < 3


@pytest.mark.slow
def test_the_stated_uncertainty_holds_with_heart_beat_and_breathing(tmp_path: Path) -> None:
    """0.25 s, 11 mm, 20 seeds: the mean of 40 squared errors over u has a standard deviation of sqrt(2 / 40)."""
    errors = [measured(moving([HEART, BREATHING], seed), tmp_path / f"{seed}.h5") for seed in range(1, 21)]
    assert np.mean(np.square(errors)) < 1 + 3 * np.sqrt(2 / 40)


def test_tissue_farther_away_is_sensed_later() -> None:
    time_s = np.arange(200) / 4000
    moved_m = 1e-3 * time_s / time_s[-1]
    delay_s = 2e-8 * np.arange(-512, 512)[None] / 2 - 2 * moved_m[:, None] / 1540.0
    volts = np.exp(-((delay_s / 0.3e-6) ** 2)) * np.cos(2 * np.pi * 9e6 * delay_s)
    echoes = EchoGate(volts, 100e6, time_s, 9e6, 1540.0, np.ones(200, dtype=bool))
    tracked, gate_motion = track_gate(echoes, slice(447, 577))
    # The echo is of one frequency but for its envelope: the mean frequency is right to 1e-3.
    assert np.abs(gate_motion.displacement_m - moved_m).max() < 2e-3 * 1e-3
    assert np.abs(tracked.pulse_time_s - time_s - gate_motion.displacement_m / 1540.0).max() < 1e-15
    # The gate moves by fractions of a sample: the echo inside it moves only by the tracking error.
    error_m = (moved_m - gate_motion.displacement_m)[:, None]
    sample_s = 1e-8 * (np.arange(447, 577) - 512) - 2 * error_m / 1540.0
    expected = np.exp(-((sample_s / 0.3e-6) ** 2)) * np.cos(2 * np.pi * 9e6 * sample_s)
    assert np.abs(tracked.gate_volts - expected).max() < 1e-9


def test_check_names_the_record_length_that_the_background_needs() -> None:
    bench = read_bench(None).bench
    scene = load_scene("cardiac-background").with_({"acquisition.record_samples": 1024})
    findings = {finding.check: finding for finding in check_plan(scene, bench, make_plan(scene, bench))}
    assert findings["gate follows"].level == "refused"
    longer = int(findings["gate follows"].remedy.split("= ")[1].split(",")[0])
    scene = scene.with_({"acquisition.record_samples": longer})
    assert all(finding.level == "passed" for finding in check_plan(scene, bench, make_plan(scene, bench)))


def test_check_warns_that_a_fixed_gate_loses_moving_tissue() -> None:
    bench = read_bench(None).bench
    scene = load_scene("cardiac-background").with_({"processing.follow_gate": False})
    findings = {finding.check: finding for finding in check_plan(scene, bench, make_plan(scene, bench))}
    assert findings["background"].level == "warning"
    assert findings["background"].remedy == "processing.follow_gate = true"


def test_a_reference_gate_cannot_follow() -> None:
    with pytest.raises(SettingsError, match="follow"):
        load_scene("cardiac-background").with_({"processing.reference_gate_depth_m": 60e-3})
