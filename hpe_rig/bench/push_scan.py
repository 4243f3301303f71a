"""Hydrophone scan of the push: whether it can serve as the shape of the force, and its intensity around the focus."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hpe_rig.arrays import FloatArray
from hpe_rig.scene import Mistake, SettingsError

if TYPE_CHECKING:
    from sim_backend.transducer import Scan

Intensity = Callable[[FloatArray, FloatArray], FloatArray]
"""Intensity (axial, lateral), in any unit, at distances from the axis (lateral,) and from the focus (axial,)."""
MAX_PRESSURE_AT_ENDS = 0.25
"""Largest pressure on the axis, relative to the focus, at the ends of a scan.

Cutting off the rest of a Gaussian beam then changes the motion of a medium by half a percent."""


def scanned_push(path: str, frequency_hz: float, sound_speed_m_per_s: float) -> Intensity:
    """Return the intensity of the scanned beam; an unchanged file gives the same function.

    Raises ``SettingsError`` if the file cannot be read or does not cover the push.
    """
    if mistakes := push_scan_mistakes(path):
        raise SettingsError("the scene", mistakes)
    from sim_backend.transducer import read_scan

    return _intensity(read_scan(path), 2 * math.pi * frequency_hz / sound_speed_m_per_s)


@lru_cache(maxsize=8)
def _intensity(scan: Scan, wave_number_per_m: float) -> Intensity:
    from sim_backend.transducer import round_field

    # Intensity is proportional to the square of the pressure amplitude.
    return lambda lateral_m, axial_m: np.abs(round_field(scan, wave_number_per_m, lateral_m, axial_m)) ** 2


def push_scan_mistakes(path: str) -> list[Mistake]:
    """Return the reasons why the scan in ``path`` cannot be the shape of the force, as mistakes of [beams]."""
    from sim_backend.transducer import read_scan

    if mistakes := scan_file_mistakes("beams.excitation_scan", path):
        return mistakes
    return [
        Mistake(
            "beams.excitation_scan",
            f"the scan {path} ends at z_m = {end_m:g}, where the pressure on the axis is still {pressure:.0%} of the "
            "focus': the push extends beyond the scan, its force would not",
            f"a scan to where the pressure falls below {MAX_PRESSURE_AT_ENDS:.0%}",
        )
        for end_m, pressure in _pressure_at_ends(read_scan(path))
        if pressure > MAX_PRESSURE_AT_ENDS
    ]


def scan_file_mistakes(key: str, path: str) -> list[Mistake]:
    """Return the reason why the scan in ``path`` cannot be read, as a mistake of ``key``."""
    from sim_backend.transducer import read_scan

    try:
        read_scan(path)
    except (OSError, ValueError) as error:
        remedy = "a scan as docs/explanation/transducer.md describes"
        if not Path(path).is_file():
            remedy = "the file at that path, or in the folder of the run file"
        return [Mistake(key, str(error), remedy)]
    return []


@lru_cache(maxsize=8)
def _pressure_at_ends(scan: Scan) -> tuple[tuple[float, float], ...]:
    """Return both ends of a scan along the axis and the pressure on the axis there relative to the focus."""
    from sim_backend.transducer import round_field

    axial_m = scan.position_m[:, 2]
    ends_m = np.array([axial_m.min(), axial_m.max()])
    # The magnitude of the mean around the axis does not depend on the wave number.
    pressure = np.abs(round_field(scan, 0.0, np.zeros(1), ends_m)[:, 0])
    return tuple(zip(ends_m.tolist(), pressure.tolist(), strict=True))
