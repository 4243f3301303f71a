"""Views of one shot: echoes over depth, displacement per pulse, the fitted harmonics and the residual."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hpe_rig.arrays import FloatArray
from hpe_rig.plan import Selection, Shot, select
from hpe_rig.processing import (
    aliased_hz,
    codes_to_volts,
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

MOST_PULSES = 20_000
"""Pulses of a shot that are looked at; a picture shows no more, and memory stays bounded."""
MOST_COLUMNS, MOST_ROWS = 480, 160
"""Pixels of an M-mode image."""


@dataclass(frozen=True, slots=True)
class EchoView:
    """Echoes of a shot in volts: one RF line over the record's depth, and the gate over slow time.

    ``line_v`` and ``line_depth_m`` (sample,); ``image_v`` (row, column), NaN where a record is missing, over
    ``image_depth_m`` (row,) and ``image_time_s`` (column,), the time after the first tracking pulse; ``gate_m``: its
    start and end.
    """

    line_v: FloatArray
    line_depth_m: FloatArray
    image_v: FloatArray
    image_depth_m: FloatArray
    image_time_s: FloatArray
    gate_m: tuple[float, float]


@dataclass(frozen=True, slots=True)
class MotionView:
    """Displacement of every pulse in the window, with the result's harmonics laid through it; all (pulse,).

    ``time_s`` counts from the phase reference; ``fitted_m`` holds the result's harmonics, every other driven harmonic
    and the background; ``noise_m2`` is the variance that each echo's own misfit predicts; ``matrix``
    (pulse, unknown) is the fit's model; ``frequencies_hz``: where the pulses see what was fitted. Missing pulses are
    left out.
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
        """What the fit does not explain, shape (pulse,)."""
        return self.displacement_m - self.fitted_m


def echo_view(scene: Scene, shot: Shot, records: ShotRecords, line: int = 0, first_sample: int = 0) -> EchoView | None:
    """Return the echoes of ``shot``; None where it has no record.

    ``records`` begin with the record's sample ``first_sample`` and hold the gate at least; the RF line is that of the
    record ``line`` among those that arrived (-1: the last).
    """
    valid = np.flatnonzero(records.valid[:MOST_PULSES])
    if not valid.size:
        return None
    depth_m = _depth_m(scene, shot, first_sample, records.codes.shape[1])
    seen = min(records.valid.size, MOST_PULSES)
    pulses = np.arange(0, seen, -(-seen // MOST_COLUMNS))
    start, stop = shot.gate.start - first_sample, shot.gate.stop - first_sample
    rows = np.arange(start, stop, -(-(stop - start) // MOST_ROWS))
    image = codes_to_volts(records.codes[pulses][:, rows], records.volts_per_code, records.volts_offset)
    image[~records.valid[pulses]] = np.nan
    half_m = scene.acquisition.gate_length_m / 2
    return EchoView(
        line_v=codes_to_volts(records.codes[valid[line]], records.volts_per_code, records.volts_offset),
        line_depth_m=depth_m,
        image_v=image.T,
        image_depth_m=depth_m[rows],
        image_time_s=pulses / shot.tracking_train.rate_hz,
        gate_m=(scene.gate_depth_m - half_m, scene.gate_depth_m + half_m),
    )


def grey_limit_v(image_v: FloatArray) -> float:
    """Return the echo drawn white in an M-mode image (row, column): a fifth above what a typical column reaches.

    The largest one would not do: a pulse that a toneburst drowns would leave all others grey.
    """
    columns = np.abs(image_v[:, np.isfinite(image_v).all(axis=0)])
    return (1.2 * float(np.median(columns.max(axis=0))) if columns.size else 0.0) or 1.0


def motion_view(scene: Scene, shot: Shot, gated: ShotRecords, estimates: Sequence[Estimate]) -> MotionView:
    """Return displacement and fit of ``shot``; raises ``ValueError`` where the echoes carry no displacement.

    ``gated`` holds of each record the ``samples_needed``. The displacement is that of the estimator "coherent",
    whichever one ``estimates`` come from.
    """
    shown = shown_pulses(scene, shot)
    motion = shot_motion(scene, shot, shot_echoes(scene, shot, gated, shown), coherent)
    kept = motion.valid
    frequency_hz = np.array([item.frequency_hz for item in estimates], dtype=np.float64)
    also_hz, rate_hz = shown.driven_hz, shot.tracking_train.rate_hz
    fitted = fitted_motion(motion, estimates, also_hz, scene.processing.background_order)
    return MotionView(
        time_s=motion.time_s[kept],
        displacement_m=motion.displacement_m[kept],
        fitted_m=fitted.displacement_m,
        noise_m2=motion.variance_m2[kept],
        matrix=fitted.matrix,
        frequencies_hz=np.unique(np.round(aliased_hz(np.concatenate([frequency_hz, also_hz]), rate_hz), 9)),
        pulse_rate_hz=rate_hz,
    )


def shown_pulses(scene: Scene, shot: Shot) -> Selection:
    """Return the pulses that are looked at: of those in the processing window at most ``MOST_PULSES``."""
    return select(scene, shot, MOST_PULSES)


def gate_alone(scene: Scene, shot: Shot, records: ShotRecords, first_sample: int = 0) -> ShotRecords:
    """Return of ``records``, which begin with the sample ``first_sample``, the gate and what its edges need."""
    needed = samples_needed(scene, shot)
    gate = slice(needed.start - first_sample, needed.stop - first_sample)
    return records.cut(gate, margin_needed(scene, shot))


def _depth_m(scene: Scene, shot: Shot, first_sample: int, samples: int) -> FloatArray:
    """Return the depth (sample,) whose echo's middle arrives with each sample."""
    place = first_sample + np.arange(samples)
    after_s = place / shot.capture.sample_rate_hz + shot.timeline.record_offset_s[0]
    return np.asarray(after_s * scene.acquisition.sound_speed_m_per_s / 2)
