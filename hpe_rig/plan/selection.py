"""Selection of the pulses and frequencies that a fit uses.

pulses       those in the processing window, without those that a toneburst disturbs if the scene skips them
wanted       processing.frequencies_hz: amplitude and phase are reported
driven       every harmonic of the burst rate that the tonebursts drive: part of the fit, so that it is no noise
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hpe_rig.arrays import BoolArray, FloatArray
from hpe_rig.plan.interference import disturbed_pulses
from hpe_rig.plan.shots import Shot, pulse_count
from hpe_rig.scene import Excitation, Scene

MAX_DRIVEN_HZ = 2e4
"""Highest frequency of a specimen's motion: at 20 kHz a shear wave is far shorter than the beam is wide."""
MAX_CONDITION = 100.0
"""Condition number of a fit above which its frequencies are refused as not resolved."""


@dataclass(frozen=True, slots=True)
class Selection:
    """Pulses and frequencies that the fit of one shot uses, as planned, without missing records.

    ``window`` (pulse of the shot,): whether a pulse is in the processing window. For the pulses in it: ``time_s``
    (pulse,), when each senses the motion, from ``Timeline.time_zero_s``, and ``used`` (pulse,), False for disturbed
    pulses that the scene skips. ``wanted_hz`` (frequency,) are estimated; ``driven_hz`` (frequency,) are also fitted as
    far as the pulses resolve them, and empty without tonebursts.
    """

    window: BoolArray
    time_s: FloatArray
    used: BoolArray
    wanted_hz: FloatArray
    driven_hz: FloatArray


def select(scene: Scene, shot: Shot, max_pulses: int | None = None) -> Selection:
    """Return the selection for the fit of ``shot``, with at most the first ``max_pulses`` of the window."""
    onset_s = shot.timeline.pulse_onset_s
    window = _in_window(scene, onset_s - onset_s[0], shot.tracking_train.rate_hz)
    if max_pulses is not None:
        window &= np.cumsum(window) <= max_pulses
    skipped = disturbed_pulses(shot) if scene.tracking.disturbed == "skip" else np.zeros_like(window)
    return Selection(
        window=window,
        time_s=shot.timeline.sensing_s[window] - shot.timeline.time_zero_s,
        used=~skipped[window],
        wanted_hz=np.array(scene.wanted_frequencies_hz, dtype=np.float64),
        driven_hz=driven_frequencies_hz(scene),
    )


def driven_frequencies_hz(scene: Scene) -> FloatArray:
    """Return every harmonic of the burst rate up to 1/T_b (frequency,); empty without tonebursts."""
    if scene.excitation is None:
        return np.zeros(0)
    rate_hz = scene.excitation.burst_rate_hz
    # Beyond the first zero of the tonebursts' spectrum the force is small, beyond the other limit the motion.
    count = math.floor(min(MAX_DRIVEN_HZ, burst_bandwidth_hz(scene.excitation)) / rate_hz)
    return rate_hz * np.arange(1.0, count + 1)


def burst_bandwidth_hz(excitation: Excitation) -> float:
    """Return 1/T_b of the shortest toneburst, the first zero of its spectrum."""
    return 1 / min(excitation.burst_length_s)


def window_pulse_count(scene: Scene) -> int:
    """Return how many pulses are in the processing window, at least 1, without making a plan."""
    rate_hz = scene.tracking.pulse_rate_hz
    return max(1, int(_in_window(scene, np.arange(pulse_count(scene)) / rate_hz, rate_hz).sum()))


def _in_window(scene: Scene, delay_s: FloatArray, rate_hz: float) -> BoolArray:
    """Return which pulses (pulse,), ``delay_s`` after the first one, are in the processing window."""
    processing = scene.processing
    end_s = math.inf if processing.window_length_s is None else processing.window_start_s + processing.window_length_s
    # The edges are moved by half a period, so that rounding does not matter for pulses at an edge.
    half_s = 0.5 / rate_hz
    return np.asarray((delay_s > processing.window_start_s - half_s) & (delay_s < end_s - half_s))
