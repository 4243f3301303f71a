"""Motion that another program has estimated: displacement or velocity instead of echoes, in SI units."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from hpe_rig.arrays import largest_change
from hpe_rig.recordings.settings import Quantity
from hpe_rig.recordings.statements import Statements
from hpe_rig.scene import engineering

UNITS = {"m": 1.0, "mm": 1e-3, "um": 1e-6, "nm": 1e-9}
"""Metres, or metres per second, of the units in the names of quantities."""
NOMINAL_SPEED_M_PER_S = 1540.0
"""Sound speed that converts the depths of a motion to times, and back to the same depths."""
ECHO_KEYS = ("scale_v", "demodulation_hz", "record_samples", "board")
"""Settings of echoes alone."""


def kind_of(quantity: Quantity | None) -> Literal["displacement", "velocity"] | None:
    """Return the kind of ``quantity`` without its unit; None for echoes."""
    if quantity is None:
        return None
    return "displacement" if quantity.startswith("displacement") else "velocity"


def si_motion(statements: Statements, values: NDArray[Any], quantity: Quantity) -> NDArray[Any]:
    """Return ``values`` (line, shot, pulse, sample) in m or m/s; add mistakes for settings that contradict them."""
    if np.iscomplexobj(values):
        statements.add_mistake("quantity", f"{quantity} is stated, and the values are complex", "real numbers")
        return values.real
    for key in ECHO_KEYS:
        if getattr(statements.settings, key) is not None:
            statements.add_mistake(key, f"echoes have it, and the values are a {quantity}", f"no {key}, or no quantity")
    name, unit = quantity.split("_")[:2]
    with np.errstate(invalid="ignore", over="ignore"):
        motion = values * UNITS[unit]
    change = engineering(largest_change(motion, axis=2), "m" if name == "displacement" else "m/s")
    statements.inferred.append(f"the {name} changes by up to {change} within the train")
    return motion


def depth_rate_hz(statements: Statements, sound_speed_m_per_s: float, has_samples: bool) -> float | None:
    """Return the sampling rate of echoes that are as far apart in depth as the values of a motion.

    A mistake and None if there are several samples (``has_samples``) and their distance is not stated.
    """
    step_m = statements.settings.depth_step_m
    if step_m is not None:
        return sound_speed_m_per_s / 2 / step_m
    if has_samples and statements.stated("sample_rate_hz") is None:
        statements.add_mistake("depth_step_m", "the distance of the samples in depth is not stated", "0.2e-3")
        return None
    return statements.number("sample_rate_hz") if has_samples else 1.0
