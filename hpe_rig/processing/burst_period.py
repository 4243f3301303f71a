"""Motion within the burst period: the displacement of all periods averaged over the phase of the period.

Bursts repeat, and so does the motion. Pulses that shift against the bursts sample other instants in every period.
"""

from __future__ import annotations

import numpy as np

from hpe_rig.arrays import FloatArray
from hpe_rig.plan import Shot, select
from hpe_rig.processing.harmonics.model import linear_model
from hpe_rig.processing.motion.displacement import Motion
from hpe_rig.processing.motion.phase_shift import coherent
from hpe_rig.processing.shot_tracking import read_shot
from hpe_rig.processing.time_base import clocks_of, timed_motion
from hpe_rig.scene import Scene
from hpe_rig.store import StoredRun

BIN_LIMITS = (8, 200)
"""Smallest and largest number of bins of the burst period."""


def _displacement(scene: Scene, shot: Shot, stored: StoredRun) -> Motion:
    """Return the displacement by the estimator "coherent" in the processing window, timed by the clock of the bursts.

    Raises ``ValueError`` if there are no records or the echoes carry no displacement.
    """
    records, clocks = read_shot(scene, shot, stored), clocks_of(scene, stored)
    return timed_motion(scene, shot, records, coherent, clocks, None)[0].tracked


def displacement_residual_m(scene: Scene, shot: Shot, stored: StoredRun) -> FloatArray | None:
    """Return the displacement of one shot minus its least-squares fit, m (pulse,); None without a fit.

    The fit has all harmonics and the background. Invalid pulses are NaN.
    """
    try:
        selection, motion = select(scene, shot), _displacement(scene, shot, stored)
        matrix = linear_model(
            motion.time_s,
            motion.valid,
            selection.wanted_hz,
            background_order=scene.processing.background_order,
            also_hz=selection.driven_hz,
        ).matrix
    except ValueError:
        return None
    residual_m, displacement_m = np.full(motion.time_s.size, np.nan), motion.displacement_m[motion.valid]
    residual_m[motion.valid] = displacement_m - matrix @ np.linalg.lstsq(matrix, displacement_m, rcond=None)[0]
    return residual_m


def burst_period_motion(scene: Scene, shot: Shot, stored: StoredRun) -> tuple[FloatArray, FloatArray]:
    """Return times (bin,) after a toneburst's arrival at the gate, s, and the mean displacement (bin,) then, m.

    The bins divide the burst period into as many parts as pulses fit into it. The displacement is that of the estimator
    "coherent" in the processing window, minus its mean; NaN in empty bins. Both are empty if nothing pushes or the
    echoes carry no displacement.
    """
    empty = np.zeros(0), np.zeros(0)
    if scene.excitation is None:
        return empty
    try:
        motion = _displacement(scene, shot, stored)
    except ValueError:
        return empty
    # Mean displacement of the pulses in each bin of the burst period.
    burst_rate_hz = scene.excitation.burst_rate_hz
    bins = int(np.clip(round(shot.tracking_train.rate_hz / burst_rate_hz), *BIN_LIMITS))
    displacement_m = motion.displacement_m[motion.valid]
    index = np.floor(motion.time_s[motion.valid] * burst_rate_hz % 1 * bins).astype(np.int64) % bins
    count = np.bincount(index, minlength=bins)
    with np.errstate(invalid="ignore"):
        mean_m = np.bincount(index, displacement_m - displacement_m.mean(), bins) / count
    return (np.arange(bins) + 0.5) / bins / burst_rate_hz, mean_m
