"""Motion within the burst period: the displacements of all periods laid over one another.

Bursts repeat and so does the motion; pulses that shift against them see it at other instants in every period.
"""

from __future__ import annotations

import numpy as np

from hpe_rig.arrays import FloatArray
from hpe_rig.plan import Selection, Shot, reference_gate, select
from hpe_rig.processing.echo.echoes import Motion, relative_to
from hpe_rig.processing.harmonics.model import linear_model
from hpe_rig.processing.motion.phase_shift import coherent
from hpe_rig.processing.shots import margin_needed, samples_needed, shot_echoes, shot_motion
from hpe_rig.scene import Scene
from hpe_rig.store import StoredRun

PARTS = (8, 200)
"""Fewest and most parts of the burst period."""


def shot_displacement(scene: Scene, shot: Shot, stored: StoredRun) -> tuple[Motion, Selection]:
    """Return the motion in the processing window by the estimator "coherent", and which pulses it is of.

    Raises ``ValueError`` where the echoes carry no displacement.
    """
    margin, gate, chosen = margin_needed(scene, shot), reference_gate(scene, shot), select(scene, shot)
    records = stored.records.in_blocks(shot.index, samples_needed(scene, shot), margin=margin)
    motion = shot_motion(scene, shot, shot_echoes(scene, shot, records, chosen), coherent)
    if gate is not None:
        still = stored.records.in_blocks(shot.index, gate, margin=margin)
        motion = relative_to(motion, coherent(shot_echoes(scene, shot, still, chosen)))
    return motion, chosen


def residual_m(scene: Scene, shot: Shot, stored: StoredRun) -> FloatArray | None:
    """Return what least squares leave of the displacement, (pulse,), m, NaN where there is none; None without any."""
    try:
        motion, chosen = shot_displacement(scene, shot, stored)
        order = scene.processing.background_order
        found = motion.time_s, motion.valid, chosen.wanted_hz
        matrix = linear_model(*found, background_order=order, also_hz=chosen.driven_hz).matrix
    except ValueError:
        return None
    rest, moved_m = np.full(motion.time_s.size, np.nan), motion.displacement_m[motion.valid]
    rest[motion.valid] = moved_m - matrix @ np.linalg.lstsq(matrix, moved_m, rcond=None)[0]
    return rest


def burst_period_motion(scene: Scene, shot: Shot, stored: StoredRun) -> tuple[FloatArray, FloatArray]:
    """Return times (time,) after a toneburst's arrival at the gate, s, and the mean displacement then, m.

    The middles of equal parts of the burst period, as many as pulses fit into it; the displacement of the pulses in the
    processing window, by the estimator "coherent", about its mean; NaN where no pulse fell. Empty where nothing pushes
    or the echoes carry no displacement.
    """
    nothing = np.zeros(0), np.zeros(0)
    if scene.excitation is None:
        return nothing
    try:
        motion, _ = shot_displacement(scene, shot, stored)
    except ValueError:
        return nothing
    burst_rate_hz = scene.excitation.burst_rate_hz
    parts = int(np.clip(round(shot.tracking_train.rate_hz / burst_rate_hz), *PARTS))
    moved_m = motion.displacement_m[motion.valid]
    part = np.floor(motion.time_s[motion.valid] * burst_rate_hz % 1 * parts).astype(np.int64) % parts
    count = np.bincount(part, minlength=parts)
    with np.errstate(invalid="ignore"):
        mean_m = np.bincount(part, moved_m - moved_m.mean(), parts) / count
    return (np.arange(parts) + 0.5) / parts / burst_rate_hz, mean_m
