"""State of the live page as plain values for JSON: small, whatever the size of the run."""

from __future__ import annotations

import base64
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from hpe_rig.arrays import FloatArray
from hpe_rig.report import EchoView, MotionView, grey_limit_v
from hpe_rig.result import Estimate, RepeatMean

State = dict[str, Any]

MAX_POINTS = 600
MAX_COLUMNS, MAX_ROWS = 240, 96


def rf_state(view: EchoView) -> State:
    """Return the RF line in mV over depth in mm, and the gate."""
    step = -(-view.line_v.size // MAX_POINTS)
    return {
        "depth_mm": _list(view.line_depth_m[::step] * 1e3, 3),
        "mv": _list(view.line_v[::step] * 1e3, 3),
        "gate_mm": _list(np.array(view.gate_m) * 1e3, 3),
    }


def image_state(image_v: FloatArray, depth_m: FloatArray, span: float, unit: str) -> State:
    """Return an M-mode image (row, column) as bytes: 0 for missing, 1 to 255 from minus to plus its grey limit."""
    image = image_v[:: -(-image_v.shape[0] // MAX_ROWS), :: -(-image_v.shape[1] // MAX_COLUMNS)]
    missing = ~np.isfinite(image)
    limit_v = grey_limit_v(image)
    relative = np.clip(np.where(missing, 0.0, image) / limit_v, -1, 1)
    grey = np.where(missing, 0, np.round(128 + 127 * relative)).astype(np.uint8)
    return {
        "rows": grey.shape[0],
        "columns": grey.shape[1],
        "grey": base64.b64encode(grey.tobytes()).decode("ascii"),
        "depth_mm": _list(depth_m[[0, -1]] * 1e3, 3),
        "span": span,
        "unit": unit,
        "limit_mv": round(limit_v * 1e3, 3),
    }


def motion_state(view: MotionView) -> State:
    """Return displacement and fit of the last pulses in nm, over time in ms."""
    last = slice(-MAX_POINTS, None)
    mean_m = float(view.displacement_m[last].mean())
    return {
        "time_ms": _list(view.time_s[last] * 1e3, 4),
        "nm": _list((view.displacement_m[last] - mean_m) * 1e9, 2),
        "fit_nm": _list((view.fitted_m[last] - mean_m) * 1e9, 2),
        "residual_nm": round(float(view.residual_m.std()) * 1e9, 3),
    }


def harmonic_state(estimates: Sequence[Estimate | RepeatMean]) -> list[State]:
    """Return amplitude in nm and phase in degrees of every harmonic, with the standard uncertainties of a result."""
    return [
        {
            "hz": item.frequency_hz,
            "nm": _number(item.amplitude_m * 1e9),
            "u_nm": _number(item.amplitude_uncertainty_m * 1e9),
            "deg": _number(math.degrees(item.phase_rad)),
            "u_deg": _number(math.degrees(item.phase_uncertainty_rad)),
        }
        for item in estimates
    ]


def level_state(view: EchoView, full_scale_v: float) -> State:
    """Return the echo in the gate: rms and largest in mV, and the largest over full scale."""
    in_gate = (view.line_depth_m >= view.gate_m[0]) & (view.line_depth_m <= view.gate_m[1])
    gate_v = view.line_v[in_gate] if in_gate.any() else np.zeros(1)
    largest_v = float(np.abs(gate_v).max())
    return {
        "rms_mv": round(float(gate_v.std()) * 1e3, 3),
        "largest_mv": round(largest_v * 1e3, 3),
        "of_full_scale": round(largest_v / full_scale_v, 4),
        "clipped": bool(np.abs(view.line_v).max() >= 0.999 * full_scale_v),
    }


def band_verdict(level: State, band_percent: tuple[float, float]) -> str:
    """Return whether the largest echo in the gate is within the band of full scale, and a remedy if not, in words."""
    percent, (low, high) = 100 * level["of_full_scale"], band_percent
    if level["clipped"]:
        return "clipped: a larger input_range_v, or a lower gain"
    if percent > high:
        return f"above {high:g} %: a larger input_range_v leaves room for stronger echoes"
    if percent < low:
        return f"below {low:g} %: move to a stronger echo, or a smaller input_range_v"
    return f"within {low:g} to {high:g} % of full scale"


def _list(values: FloatArray, digits: int) -> list[float]:
    return [round(float(value), digits) for value in values]


def _number(value: float) -> float | None:
    return float(f"{value:.6g}") if math.isfinite(value) else None
