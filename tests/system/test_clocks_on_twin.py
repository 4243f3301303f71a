"""Clocks of the bench that are not synchronised: the shipped scene, from the instruments to the stored time stamps."""

from pathlib import Path

import h5py
import numpy as np
import pytest

import hpe_rig as hpe


def test_stored_trigger_times_drift_by_the_difference_of_two_clocks(tmp_path: Path) -> None:
    scene = hpe.load_scene("free-running-clocks").with_({"excitation.burst_count": 10})
    hpe.measure(scene, path=tmp_path / "run.h5")
    with h5py.File(tmp_path / "run.h5") as file:
        time_s = file["records/trigger_time_s"][0]
    period_s = np.polyfit(np.arange(time_s.size), time_s, 1)[0]
    errors = scene.simulation["instruments"]["clock_error"]
    rate = (1 + errors["tracking_train"]) / (1 + errors["digitizer"])
    # Time stamps have steps of 20 ns, in 0.1 s.
    assert 1 / (period_s * 3990.0) - 1 == pytest.approx(rate - 1, abs=0.05e-6)
    assert abs(rate - 1) > 5e-6
