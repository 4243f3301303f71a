"""Vibrations at the lines of a motion map, in the depth of the focus, with their covariance."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from hpe_rig.arrays import ComplexArray, FloatArray
from hpe_rig.moduli.problem import MAX_LATERAL_M
from hpe_rig.moduli.scene_geometry import detected_part, focus_depth_m, push_of, vibration_at
from hpe_rig.moduli.vibration_model import Push, Vibration
from hpe_rig.result import PHASE_VARIANCE_LIMIT, MotionMap
from hpe_rig.scene import Scene

MAX_LINES = 12
"""Lines that are fitted: each has six unknowns, and the fit takes some seconds."""


def vibrations_of_map(motion_map: MotionMap, scene: Scene) -> tuple[list[Vibration], list[str]]:
    """Return the vibrations of all lines in the depth nearest to the focus, and a list of omitted lines in words.

    ``scene`` states tonebursts and [beams]; phases of the map count from the onset of a toneburst. Raises
    ``ValueError`` if the lines have no positions, or none of the depths is at the focus.
    """
    if not motion_map.lines_are_placed:
        raise ValueError("the lines of the map have no positions. Try: line_pitch_m, or line_position_m")
    depth_m, focus_m = motion_map.depth_m, focus_depth_m(scene)
    index = int(np.argmin(np.abs(depth_m - focus_m)))
    # A focus less than one pixel beyond the edge of the map still counts.
    step_m = float(np.diff(depth_m).mean()) if depth_m.size > 1 else scene.acquisition.gate_length_m
    if abs(depth_m[index] - focus_m) > step_m:
        range_mm = f"{depth_m.min() * 1e3:.4g} to {depth_m.max() * 1e3:.4g} mm"
        raise ValueError(
            f"the focus at {focus_m * 1e3:.4g} mm lies outside the depths of the map, {range_mm}. "
            "Try: beams.focus_depth_m, or first_sample_depth_m of the recording"
        )
    vibrations, omitted = list[Vibration](), list[str]()
    for line, lateral_m in enumerate(motion_map.line_m.tolist()):
        label = f"{lateral_m * 1e3:.4g} mm"
        if abs(lateral_m) > MAX_LATERAL_M:
            omitted.append(f"{label}: more than {MAX_LATERAL_M * 1e3:g} mm from the push")
            continue
        if motion_map.bad[line, index]:
            omitted.append(f"{label}: no estimate in this pixel")
            continue
        scene_at_line = scene.with_({"tracking.lateral_offset_m": lateral_m})
        vibration = vibration_at(scene_at_line, "coherent", label, _pixel(motion_map, line, index))
        vibrations += detected_part(vibration, omitted)
    if len(vibrations) <= MAX_LINES:
        return vibrations, omitted
    omitted.append(f"{len(vibrations) - MAX_LINES} of {len(vibrations)} lines: {MAX_LINES}, evenly spread, are fitted")
    fitted_lines = np.rint(np.linspace(0, len(vibrations) - 1, MAX_LINES)).astype(int)
    return [vibrations[line] for line in fitted_lines], omitted


def push_of_map(motion_map: MotionMap, scene: Scene, width_uncertainty: float) -> Push:
    """Return the push of ``scene``; the uncertainty of its onset includes that of the delay by the clocks.

    All lines of the map share the push and this delay. ``width_uncertainty``: relative uncertainty of the widths of
    the force.
    """
    push = push_of([scene], width_uncertainty)
    return replace(push, onset_uncertainty_s=math.hypot(push.onset_uncertainty_s, motion_map.clock_delay_u_s))


def _pixel(motion_map: MotionMap, line: int, depth: int) -> tuple[FloatArray, ComplexArray, FloatArray]:
    """Return frequencies and phasors (frequency,), m, of the pixel at the indices ``line`` and ``depth``, and their u.

    u is the covariance (2 * frequency, 2 * frequency), m², of real and imaginary parts. It has no terms between
    frequencies, which a long train separates, and not the delay by the clocks, which all lines share.
    """
    pixel = line, depth
    amplitude_m, phase_rad = motion_map.amplitude_m[pixel], motion_map.phase_rad[pixel]
    clock_rad = np.minimum(
        2 * np.pi * motion_map.frequency_hz * motion_map.clock_delay_u_s, np.sqrt(PHASE_VARIANCE_LIMIT)
    )
    noise_rad = np.sqrt(np.maximum(motion_map.phase_uncertainty_rad[pixel] ** 2 - clock_rad**2, 0.0))
    along_m, across_m = motion_map.amplitude_uncertainty_m[pixel], amplitude_m * noise_rad
    covariance = np.zeros((2 * phase_rad.size, 2 * phase_rad.size))
    for index, (angle, *sigma) in enumerate(zip(phase_rad, along_m, across_m, strict=True)):
        # From errors along and across the phasor to those of its real and imaginary parts.
        rotation = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        pair = slice(2 * index, 2 * index + 2)
        covariance[pair, pair] = rotation @ np.diag(np.square(sigma)) @ rotation.T
    phasor_m = np.asarray(amplitude_m * np.exp(1j * phase_rad), np.complex128)
    return motion_map.frequency_hz, phasor_m, covariance
