"""Selection of the pulses and frequencies that a fit uses.

pulses       those in the processing window, less those that a toneburst disturbs where the scene skips them
wanted       processing.frequencies_hz: amplitude and phase are reported
driven       every harmonic of the burst rate that the tonebursts drive: fitted along, so that it is no noise
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hpe_rig.arrays import BoolArray, FloatArray
from hpe_rig.plan.interference import disturbed_pulses
from hpe_rig.plan.shots import Shot, pulse_count
from hpe_rig.scene import Excitation, Scene

HIGHEST_DRIVEN_HZ = 2e4
"""A specimen follows no further: at 20 kHz a shear wave is far shorter than the beam is wide."""
LARGEST_CONDITION = 100.0
"""Condition number of a fit from which on frequencies are refused as not resolved."""


@dataclass(frozen=True, slots=True)
class Selection:
    """Pulses and frequencies that the fit of one shot uses, as planned, no record missing.

    ``window`` (pulse of the shot,): in the processing window. Of the pulses in it, ``time_s`` (pulse,): when each
    senses the motion, from ``Timeline.reference_s``; ``used`` (pulse,): False where the scene leaves a disturbed one
    out. ``wanted_hz`` (frequency,): estimated; ``driven_hz`` (frequency,): fitted along as far as the pulses can tell
    them apart, empty where nothing pushes.
    """

    window: BoolArray
    time_s: FloatArray
    used: BoolArray
    wanted_hz: FloatArray
    driven_hz: FloatArray


def select(scene: Scene, shot: Shot, most_pulses: int | None = None) -> Selection:
    """Return what the fit of ``shot`` uses; of the pulses in the window at most the first ``most_pulses``."""
    onset_s = shot.timeline.pulse_onset_s
    window = _in_window(scene, onset_s - onset_s[0], shot.tracking_train.rate_hz)
    if most_pulses is not None:
        window &= np.cumsum(window) <= most_pulses
    skipped = disturbed_pulses(shot) if scene.tracking.disturbed == "skip" else np.zeros_like(window)
    return Selection(
        window=window,
        time_s=shot.timeline.sensing_s[window] - shot.timeline.reference_s,
        used=~skipped[window],
        wanted_hz=np.array(scene.wanted_frequencies_hz, dtype=np.float64),
        driven_hz=driven_frequencies_hz(scene),
    )


def driven_frequencies_hz(scene: Scene) -> FloatArray:
    """Return every harmonic of the burst rate up to 1/T_b, wanted or not, (frequency,); empty where nothing pushes."""
    if scene.excitation is None:
        return np.zeros(0)
    rate_hz = scene.excitation.burst_rate_hz
    count = math.floor(min(HIGHEST_DRIVEN_HZ, burst_bandwidth_hz(scene.excitation)) / rate_hz)
    return rate_hz * np.arange(1.0, count + 1)


def burst_bandwidth_hz(excitation: Excitation) -> float:
    """Return 1/T_b of the shortest toneburst, which drives the most harmonics: its spectrum's first zero, in Hz."""
    return 1 / min(excitation.burst_length_s)


def window_pulse_count(scene: Scene) -> int:
    """Return how many pulses lie in the processing window, at least 1: what is known of a scene without its plan."""
    rate_hz = scene.tracking.pulse_rate_hz
    return max(1, int(_in_window(scene, np.arange(pulse_count(scene)) / rate_hz, rate_hz).sum()))


def _in_window(scene: Scene, after_first_s: FloatArray, rate_hz: float) -> BoolArray:
    """Return which pulses, ``after_first_s`` after the first, lie in the processing window, (pulse,)."""
    processing = scene.processing
    end_s = math.inf if processing.window_length_s is None else processing.window_start_s + processing.window_length_s
    # Both edges go to the nearest pulse, so that rounding moves no pulse that stands on one.
    half_s = 0.5 / rate_hz
    return np.asarray((after_first_s > processing.window_start_s - half_s) & (after_first_s < end_s - half_s))
