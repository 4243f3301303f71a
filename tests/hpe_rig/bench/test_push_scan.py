"""The push by a hydrophone scan: its intensity around the focus, and scans that do not cover it."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from hpe_rig.bench.push_scan import push_scan_mistakes, scanned_push
from hpe_rig.scene import SettingsError

FREQUENCY_HZ, SOUND_SPEED_M_PER_S = 3e6, 1540.0
WIDTH_M, LENGTH_M = 1e-3, 8e-3
"""Distances from the axis and from the focus where the pressure of the scanned Gaussian beam falls to 1/e."""


def scan_file(path: Path, ends_m: tuple[float, float]) -> str:
    """Write a scan of a Gaussian beam with plane wave fronts, in 41 planes of points on a line; return its path."""
    wave_number_per_m = 2 * math.pi * FREQUENCY_HZ / SOUND_SPEED_M_PER_S
    rows = ["x_m,y_m,z_m,pressure_pa,phase_rad"]
    for z_m in np.linspace(*ends_m, 41):
        for x_m in np.arange(-12, 13) * 0.25e-3:
            pressure_pa = 1e6 * math.exp(-((x_m / WIDTH_M) ** 2) - (z_m / LENGTH_M) ** 2)
            rows.append(f"{x_m},0.0,{z_m},{pressure_pa},{-wave_number_per_m * z_m}")
    path.write_text("\n".join(rows), encoding="utf-8")
    return str(path)


def test_the_intensity_between_the_points_of_a_scan_is_that_of_the_beam(tmp_path: Path) -> None:
    intensity = scanned_push(scan_file(tmp_path / "scan.csv", (-16e-3, 16e-3)), FREQUENCY_HZ, SOUND_SPEED_M_PER_S)
    lateral_m, axial_m = np.array([0.0, 0.4e-3, 0.9e-3]), np.array([-7.6e-3, -0.5e-3, 3.3e-3])
    expected = np.exp(-2 * (lateral_m / WIDTH_M) ** 2 - 2 * (axial_m[:, None] / LENGTH_M) ** 2)
    # Cubic splines through points at a quarter and an eighth of the 1/e distances.
    np.testing.assert_allclose(intensity(lateral_m, axial_m), expected, rtol=5e-3)


def test_a_scan_that_ends_within_the_push_is_refused(tmp_path: Path) -> None:
    # The pressure is exp(-9/4) = 11 % of the focus at 12 mm, and 78 % at 4 mm.
    path = scan_file(tmp_path / "scan.csv", (-12e-3, 4e-3))
    (mistake,) = push_scan_mistakes(path)
    assert "ends at z_m = 0.004, where the pressure on the axis is still 78%" in mistake.what
    with pytest.raises(SettingsError, match="ends at"):
        scanned_push(path, FREQUENCY_HZ, SOUND_SPEED_M_PER_S)


def test_a_missing_scan_is_named(tmp_path: Path) -> None:
    (mistake,) = push_scan_mistakes(str(tmp_path / "absent.csv"))
    assert "absent.csv" in mistake.what
    assert "the file at that path" in mistake.remedy
