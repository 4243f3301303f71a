"""Stated carriers that the echoes contradict are refused or reported, and band-pass samples keep their motion."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import hpe_rig as hpe
from hpe_rig.recordings import Recording, RecordingSettings, read_recording
from hpe_rig.scene import SettingsError

CARRIER_HZ, PULSE_RATE_HZ, SPEED = 5e6, 4e3, 1540.0
AMPLITUDE_M, PHASE_RAD, VIBRATION_HZ = 1e-6, 0.5, 200.0
TIME_S = np.arange(40) / PULSE_RATE_HZ
MOTION_M = AMPLITUDE_M * np.sin(2 * np.pi * VIBRATION_HZ * TIME_S + PHASE_RAD)
Scene = Callable[[float, float, float], Path]


def analytic_echoes(rate_hz: float, carrier_hz: float = CARRIER_HZ, duration_s: float = 12.8e-6) -> NDArray[Any]:
    """Return the analytic signal (pulse, sample) of rigid scatterers with a little noise."""
    rng = np.random.default_rng(3)
    fast_s = np.arange(round(duration_s * rate_hz)) / rate_hz
    echoes = np.zeros((TIME_S.size, fast_s.size), complex)
    for depth_m, weight in zip(rng.uniform(3e-3, 7e-3, 60), rng.normal(size=60), strict=True):
        late_s = fast_s - 2 * (depth_m + MOTION_M[:, None]) / SPEED
        echoes += weight * np.exp(-((late_s / 0.5e-6) ** 2) + 2j * np.pi * carrier_hz * late_s)
    noise = rng.normal(size=(2, *echoes.shape)) * 1e-3
    return np.asarray(echoes / np.abs(echoes).max() + noise[0] + 1j * noise[1])


def read(values: NDArray[Any], rate_hz: float, for_map: bool = False, **options: Any) -> Recording:
    stated = {"carrier_hz": CARRIER_HZ, "pulse_rate_hz": PULSE_RATE_HZ, "axes": "pulse,sample"} | options
    settings = RecordingSettings.model_validate(stated | {"sample_rate_hz": rate_hz})
    return read_recording(values, settings, for_map=for_map)


@pytest.mark.parametrize("for_map", [True, False])
def test_a_carrier_that_remains_in_depth_is_refused_unless_it_is_stated(for_map: bool) -> None:
    echoes = analytic_echoes(40e6)
    with pytest.raises(SettingsError, match=r"centred at 10(\.\d)? MHz .*carrier is 5 MHz, demodulation_hz is 5e\+06"):
        read(echoes, 40e6, for_map, demodulation_hz=CARRIER_HZ)
    assert not any("WARNING" in text for text in read(echoes, 40e6, for_map, demodulation_hz=0.0).inferred)


def test_velocity_of_a_map_with_the_carrier_in_depth_is_that_of_the_echoes(scene_of_gate: Scene) -> None:
    scene = scene_of_gate(5e-3, 2e-3, VIBRATION_HZ)
    settings = {
        "axes": "pulse,sample",
        "sample_rate_hz": 40e6,
        "pulse_rate_hz": PULSE_RATE_HZ,
        "carrier_hz": CARRIER_HZ,
    }
    motion_map = hpe.map_motion(analytic_echoes(40e6), scene, demodulation_hz=0.0, **settings)
    inside = (motion_map.depth_m > 4e-3) & (motion_map.depth_m < 6e-3)
    np.testing.assert_allclose(motion_map.amplitude_m[0, inside, 0], AMPLITUDE_M, rtol=0.02)


@pytest.mark.parametrize("carrier_hz", [3.4e6, 7.5e6])
def test_a_carrier_beside_the_echoes_is_reported_with_their_frequency(carrier_hz: float) -> None:
    texts = read(analytic_echoes(40e6).real, 40e6, carrier_hz=carrier_hz).inferred
    (warning,) = (text for text in texts if text.startswith("WARNING"))
    assert f"the carrier is {carrier_hz / 1e6:g} MHz" in warning
    centre_mhz = float(warning.split()[5])
    # At 3.4 MHz the upper end of the estimators' band cuts the echoes at 5.1 MHz.
    assert centre_mhz == pytest.approx(5, abs=0.4)


def test_a_wrong_sampling_rate_is_refused() -> None:
    with pytest.raises(SettingsError, match=r"echoes are centred at 12\.\d MHz .*, the carrier is 5 MHz"):
        read(analytic_echoes(40e6).real, 100e6)


def test_strong_interference_below_the_band_is_no_reason_to_refuse() -> None:
    hum = 5 * np.sin(2 * np.pi * 0.5e6 * np.arange(512) / 40e6)
    texts = read(analytic_echoes(40e6).real + hum, 40e6).inferred
    assert sum(text.startswith("WARNING echoes are centred at 0.5") for text in texts) == 1


@pytest.mark.parametrize("carrier_hz", [5e6, 8.34e6])
def test_band_pass_samples_give_the_motion_of_their_carrier(
    carrier_hz: float, scene_of_gate: Scene, tmp_path: Path
) -> None:
    # The first carrier lies below a multiple of the rate, where the spectrum is reversed, the second one above.
    scene, rate_hz = scene_of_gate(5e-3, 2e-3, VIBRATION_HZ), 6.67e6
    rates = {"sample_rate_hz": rate_hz, "pulse_rate_hz": PULSE_RATE_HZ, "carrier_hz": carrier_hz}
    echoes = analytic_echoes(rate_hz, carrier_hz).real
    run = hpe.import_records(echoes, scene, tmp_path / "run.h5", axes="pulse,sample", **rates)
    assert run.bench.recording is not None
    assert "is folded to 1.67e+06 Hz" in " ".join(run.bench.recording.inferred)
    (estimate,) = run.estimate().shots[0].estimates
    # Noise of 60 dB below the echoes leaves 3 nm with 40 pulses; the phase is that of the motion when a pulse arrives.
    assert estimate.tracked_amplitude_uncertainty_m < 3e-9
    assert estimate.tracked_amplitude_m == pytest.approx(AMPLITUDE_M, abs=3 * estimate.tracked_amplitude_uncertainty_m)
    phase_rad = PHASE_RAD - 2 * np.pi * VIBRATION_HZ * 5e-3 / SPEED
    assert estimate.tracked_phase_rad == pytest.approx(phase_rad, abs=3 * estimate.tracked_phase_uncertainty_rad)


@pytest.mark.parametrize("rate_hz", [5.1e6, 9e6])
def test_a_band_that_folds_onto_itself_is_refused(rate_hz: float) -> None:
    with pytest.raises(SettingsError, match="do not fold cleanly"):
        read(analytic_echoes(rate_hz).real, rate_hz, carrier_hz=CARRIER_HZ)


def test_overlap_at_the_ends_of_a_folded_band_is_reported() -> None:
    texts = read(analytic_echoes(8e6).real, 8e6, carrier_hz=CARRIER_HZ).inferred
    assert sum(text.startswith("WARNING band-pass sampling") and "overlap" in text for text in texts) == 1
