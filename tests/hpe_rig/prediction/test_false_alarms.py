"""The detection floor by simulation: echoes that do not move exceed it as often as it says."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from hpe_rig.acquire.run import prepare
from hpe_rig.plan import select
from hpe_rig.prediction.detection import FALSE_ALARMS, detection_floor
from hpe_rig.processing import EchoGate, estimate, margin_samples
from hpe_rig.scene.scene import load_scene
from sim_backend.echoes import drawn_echoes, hann_pulse
from sim_backend.settings import SimulationSettings

AT_ONCE = 50


def share_above_the_floor(snr_db: float, estimator: str, trials: int) -> float:
    """Return the share of ``trials``, new scatterers and new noise in each, that are taken for a motion."""
    asked = {"processing.expected_snr_db": snr_db, "processing.estimator": estimator}
    setup = prepare(load_scene("table-1").with_(asked))
    scene, shot = setup.scene.scene, setup.plan.shots[0]
    floor_m = detection_floor(scene, True, shot).detected_m
    time_s, speed_m_per_s = select(scene, shot).time_s, scene.acquisition.sound_speed_m_per_s
    # As in a record, echo goes on at both ends of the gate.
    margin = margin_samples(100e6, 9e6)
    samples = shot.gate.stop - shot.gate.start + 2 * margin
    gate_s = (np.arange(samples) - (samples - 1) / 2) / 100e6
    settings, pulse = SimulationSettings(), hann_pulse(9e6, 0.065)
    scatterers, noise = np.random.default_rng([7, 0]), np.random.default_rng([7, 1])
    found: list[NDArray[np.float64]] = []
    # At rest all pulses bring the same echo.
    for still in drawn_echoes(settings, np.zeros(1), pulse, gate_s, scatterers, trials, 1e-6):
        for some in np.array_split(still, max(1, len(still) // AT_ONCE)):
            held = some[..., margin : samples - margin]
            rms = np.sqrt(np.mean(held**2, axis=(-2, -1), keepdims=True) / 10 ** (snr_db / 10))
            volts = some + rms * noise.standard_normal((len(some), time_s.size, samples))
            gate = EchoGate(
                volts, 100e6, time_s, 9e6, speed_m_per_s, np.ones(time_s.size, dtype=bool), margin=(margin, margin)
            )
            found.append(estimate(gate, [200.0], estimator).amplitude_m[:, 0])
    amplitude_m = np.concatenate(found)
    assert amplitude_m.size == trials
    return float(np.mean(amplitude_m > floor_m))


def within(trials: int) -> float:
    """Return three standard deviations of a binomial share of one in twenty."""
    return 3 * float(np.sqrt(FALSE_ALARMS * (1 - FALSE_ALARMS) / trials))


@pytest.mark.parametrize("snr_db", [10.0, 40.0])
def test_one_in_twenty_without_motion_exceeds_the_floor(snr_db: float) -> None:
    assert share_above_the_floor(snr_db, "coherent", 600) == pytest.approx(FALSE_ALARMS, abs=within(600))


@pytest.mark.slow
@pytest.mark.parametrize("estimator", ["coherent", "joint", "cross_spectrum"])
@pytest.mark.parametrize("snr_db", [0.0, 10.0, 20.0, 40.0])
def test_one_in_twenty_at_any_snr_exceeds_the_floor(snr_db: float, estimator: str) -> None:
    # Where a peak is read its noise is drawn as well and known to 10 %: 2 ln(20) times that of the share.
    drawn = 0.1 * 2 * np.log(1 / FALSE_ALARMS) * FALSE_ALARMS if estimator == "cross_spectrum" else 0.0
    found = share_above_the_floor(snr_db, estimator, 4000)
    assert found == pytest.approx(FALSE_ALARMS, abs=float(np.hypot(within(4000), drawn)))
