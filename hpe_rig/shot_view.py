"""One shot as people look at it: echoes over depth, displacement per pulse, the fitted harmonics and what is left."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hpe_rig.estimation import driven_frequencies_hz, slow_time_window
from hpe_rig.plan import Shot
from hpe_rig.processing import EchoGate, coherent
from hpe_rig.processing.conditioning import codes_to_volts, remove_offset
from hpe_rig.records import ShotRecords
from hpe_rig.result import Estimate
from hpe_rig.scene import Scene

FloatArray = NDArray[np.float64]

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
    and a constant; ``noise_m2`` is the variance that each echo's own misfit predicts; ``unknowns``: how many numbers
    were fitted; ``frequencies_hz``: of which frequencies. Missing pulses are left out.
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

    @property
    def unknowns(self) -> int:
        """How many numbers were fitted."""
        return int(self.matrix.shape[1])


def echo_view(scene: Scene, shot: Shot, records: ShotRecords, line: int = 0) -> EchoView | None:
    """Return the echoes of ``shot``, the RF line that of its record ``line`` (-1: the last); None without a record."""
    valid = np.flatnonzero(records.valid[:MOST_PULSES])
    if not valid.size:
        return None
    depth_m = depths_m(scene, shot)
    pulses = np.arange(
        0, min(records.valid.size, MOST_PULSES), -(-min(records.valid.size, MOST_PULSES) // MOST_COLUMNS)
    )
    rows = np.arange(shot.gate.start, shot.gate.stop, -(-(shot.gate.stop - shot.gate.start) // MOST_ROWS))
    image = codes_to_volts(records.codes[pulses][:, rows], records.volts_per_code, records.volts_offset)
    image[~records.valid[pulses]] = np.nan
    half_m = scene.acquisition.gate_length_m / 2
    return EchoView(
        line_v=codes_to_volts(records.codes[valid[line]], records.volts_per_code, records.volts_offset),
        line_depth_m=depth_m,
        image_v=image.T,
        image_depth_m=depth_m[rows],
        image_time_s=pulses / shot.tracking_train.rate_hz,
        gate_m=(scene.acquisition.gate_depth_m - half_m, scene.acquisition.gate_depth_m + half_m),
    )


def motion_view(scene: Scene, shot: Shot, records: ShotRecords, estimates: Sequence[Estimate]) -> MotionView:
    """Return displacement and fit of ``shot``; raises ``ValueError`` where the echoes carry no displacement.

    The displacement is that of the estimator "coherent", whichever one ``estimates`` come from.
    """
    echoes = echo_gate(scene, shot, records)
    motion = coherent(echoes)
    kept = motion.valid
    frequency_hz = np.array([item.frequency_hz for item in estimates], dtype=np.float64)
    also_hz = driven_frequencies_hz(scene)
    new_hz = also_hz[~np.isclose(also_hz[:, None], frequency_hz, rtol=1e-9, atol=0).any(axis=1)]
    rate_hz = shot.tracking_train.rate_hz
    wanted = _columns(motion.time_s, frequency_hz)[kept]
    others = _columns(motion.time_s, new_hz)[kept]
    # at half the pulse rate sine and cosine are one and the same column
    others = others[:, ~_repeats(new_hz, rate_hz)]
    rest = np.hstack([np.ones((int(kept.sum()), 1)), others])
    displacement_m = motion.displacement_m[kept]
    harmonics_m = wanted @ _state(estimates)
    fitted_m = harmonics_m + rest @ np.linalg.lstsq(rest, displacement_m - harmonics_m, rcond=None)[0]
    return MotionView(
        time_s=motion.time_s[kept],
        displacement_m=displacement_m,
        fitted_m=fitted_m,
        noise_m2=motion.variance_m2[kept],
        matrix=np.hstack([wanted, rest]),
        frequencies_hz=np.concatenate([frequency_hz, new_hz]),
        pulse_rate_hz=rate_hz,
    )


def echo_gate(scene: Scene, shot: Shot, records: ShotRecords) -> EchoGate:
    """Return the gated echoes of the processing window, of at most ``MOST_PULSES`` pulses."""
    inside = np.flatnonzero(slow_time_window(scene, shot))[:MOST_PULSES]
    codes = np.asarray(records.codes[inside])[:, shot.gate]
    return EchoGate(
        volts=remove_offset(codes_to_volts(codes, records.volts_per_code, records.volts_offset)),
        sample_rate_hz=shot.capture.sample_rate_hz,
        pulse_time_s=shot.timeline.sensing_s[inside] - shot.timeline.reference_s,
        carrier_hz=scene.tracking.carrier_hz,
        sound_speed_m_per_s=scene.acquisition.sound_speed_m_per_s,
        valid=records.valid[inside],
    )


def depths_m(scene: Scene, shot: Shot) -> FloatArray:
    """Return the depth (sample,) whose echo's middle arrives with each sample of the record."""
    after_s = np.arange(shot.capture.record_samples) / shot.capture.sample_rate_hz + shot.timeline.record_offset_s[0]
    return np.asarray(after_s * scene.acquisition.sound_speed_m_per_s / 2)


def _columns(time_s: FloatArray, frequency_hz: FloatArray) -> FloatArray:
    """Return sin and cos of 2 pi f t, interleaved (pulse, 2 * frequency)."""
    angle = 2 * np.pi * np.outer(time_s, frequency_hz)
    return np.stack([np.sin(angle), np.cos(angle)], axis=-1).reshape(time_s.size, -1)


def _state(estimates: Sequence[Estimate]) -> FloatArray:
    """Return (A cos phi, A sin phi) of every estimate in turn."""
    pairs = [
        (item.amplitude_m * math.cos(item.phase_rad), item.amplitude_m * math.sin(item.phase_rad)) for item in estimates
    ]
    return np.array(pairs, dtype=np.float64).reshape(-1)


def _repeats(frequency_hz: FloatArray, rate_hz: float) -> NDArray[np.bool_]:
    """Return which of the columns (2 * frequency,) are sines at half the pulse rate."""
    half = np.isclose(frequency_hz, rate_hz / 2, rtol=1e-6, atol=0)
    return np.stack([half, np.zeros_like(half)], axis=-1).reshape(-1)
