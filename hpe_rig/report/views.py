"""Views of one shot for pictures: echoes over depth, displacement of each pulse, fit and residual."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hpe_rig.arrays import FloatArray
from hpe_rig.plan import Selection, Shot, phase_reference_of, select
from hpe_rig.processing import (
    Motion,
    aliased_hz,
    coherent,
    fitted_motion,
    margin_needed,
    samples_needed,
    shot_echoes,
    shot_motion,
)
from hpe_rig.result import Estimate
from hpe_rig.scene import Scene
from hpe_rig.store import ShotRecords

MAX_PULSES = 20_000
"""Pulses of a shot in a view, a limit on memory; a picture resolves no more."""
MAX_COLUMNS, MAX_ROWS = 480, 160
"""Pixels of an M-mode image."""


@dataclass(frozen=True, slots=True)
class EchoView:
    """Echoes of a shot in volts: one RF line over the record's depth, and the gate over slow time.

    ``line_v`` and ``line_depth_m`` (sample,). ``image_v`` (row, column), NaN for missing records, over
    ``image_depth_m`` (row,) and ``image_time_s`` (column,), the time after the first tracking pulse. ``gate_m``: start
    and end of the gate.
    """

    line_v: FloatArray
    line_depth_m: FloatArray
    image_v: FloatArray
    image_depth_m: FloatArray
    image_time_s: FloatArray
    gate_m: tuple[float, float]


@dataclass(frozen=True, slots=True)
class MotionView:
    """Displacement of every valid pulse in the window, and the fit; all arrays (pulse,).

    ``time_s``: time after the phase reference. ``fitted_m``: the result's harmonics, the other driven harmonics and the
    background. ``noise_m2``: variance predicted from the misfit of each echo. ``matrix`` (pulse, unknown): model of the
    fit. ``frequencies_hz``: fitted frequencies after aliasing by the pulse rate.
    """

    time_s: FloatArray
    displacement_m: FloatArray
    fitted_m: FloatArray
    noise_m2: FloatArray
    matrix: FloatArray
    frequencies_hz: FloatArray
    pulse_rate_hz: float

    @property
    def residual_m(self) -> FloatArray:
        """Displacement minus fit, (pulse,)."""
        return self.displacement_m - self.fitted_m


def echo_view(scene: Scene, shot: Shot, records: ShotRecords, line: int = 0, first_sample: int = 0) -> EchoView | None:
    """Return the echoes of ``shot``; None without a valid record.

    ``records`` begin at sample ``first_sample`` and contain at least the gate. ``line`` is the index of the RF line
    among the valid records, -1 for the last.
    """
    valid = np.flatnonzero(records.valid[:MAX_PULSES])
    if not valid.size:
        return None
    # The centre of the echo at each sample comes from this depth.
    sample = first_sample + np.arange(records.codes.shape[1])
    delay_s = sample / shot.capture.sample_rate_hz + shot.timeline.record_offset_s[0]
    depth_m = np.asarray(delay_s * scene.acquisition.sound_speed_m_per_s / 2)
    count = min(records.valid.size, MAX_PULSES)
    # Every n-th pulse and row: a screen resolves no more.
    pulses = np.arange(0, count, -(-count // MAX_COLUMNS))
    start, stop = shot.gate.start - first_sample, shot.gate.stop - first_sample
    rows = np.arange(start, stop, -(-(stop - start) // MAX_ROWS))
    image = records.codes[pulses][:, rows] * np.float64(records.volts_per_code) + records.volts_offset
    image[~records.valid[pulses]] = np.nan
    half_m = scene.acquisition.gate_length_m / 2
    return EchoView(
        line_v=records.codes[valid[line]] * np.float64(records.volts_per_code) + records.volts_offset,
        line_depth_m=depth_m,
        image_v=image.T,
        image_depth_m=depth_m[rows],
        image_time_s=pulses / shot.tracking_train.rate_hz,
        gate_m=(scene.gate_depth_m - half_m, scene.gate_depth_m + half_m),
    )


def grey_limit_v(image_v: FloatArray) -> float:
    """Return the echo that is white in an M-mode image (row, column): 1.2 times the median maximum of a column.

    The largest echo is unsuitable: a pulse disturbed by a toneburst would make all others grey.
    """
    columns = np.abs(image_v[:, np.isfinite(image_v).all(axis=0)])
    return (1.2 * float(np.median(columns.max(axis=0))) if columns.size else 0.0) or 1.0


def tracked_motion(scene: Scene, shot: Shot, records: ShotRecords, first_sample: int = 0) -> Motion:
    """Return the displacement of the selected pulses by the estimator "coherent".

    ``records`` begin at sample ``first_sample`` and contain gate and margins. Raises ``ValueError`` for echoes without
    displacement.
    """
    needed = samples_needed(scene, shot)
    gate = slice(needed.start - first_sample, needed.stop - first_sample)
    gated = records.cut(gate, margin_needed(scene, shot))
    return shot_motion(scene, shot, shot_echoes(scene, shot, gated, selected_pulses(scene, shot)), coherent)


def motion_view(scene: Scene, shot: Shot, motion: Motion, estimates: Sequence[Estimate]) -> MotionView:
    """Return the tracked ``motion`` of ``shot`` and the fit of ``estimates``, which may be of any estimator."""
    selection, valid = selected_pulses(scene, shot), motion.valid
    # The harmonics of the result stay; other driven harmonics and the background are fitted to the remainder.
    frequency_hz = np.array([item.frequency_hz for item in estimates], dtype=np.float64)
    other_driven_hz, rate_hz = selection.driven_hz, shot.tracking_train.rate_hz
    reference, order = phase_reference_of(scene, shot), scene.processing.background_order
    fitted_m, matrix = fitted_motion(motion, estimates, reference, other_driven_hz, order)
    return MotionView(
        time_s=motion.time_s[valid] - reference.delay_s,
        displacement_m=motion.displacement_m[valid],
        fitted_m=fitted_m,
        noise_m2=motion.variance_m2[valid],
        matrix=matrix,
        frequencies_hz=np.unique(np.round(aliased_hz(np.concatenate([frequency_hz, other_driven_hz]), rate_hz), 9)),
        pulse_rate_hz=rate_hz,
    )


def selected_pulses(scene: Scene, shot: Shot) -> Selection:
    """Return at most ``MAX_PULSES`` pulses of the processing window."""
    return select(scene, shot, MAX_PULSES)
