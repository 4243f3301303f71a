"""Motion within the burst period: the displacements of all periods laid over one another.

Bursts repeat and so does the motion; pulses that shift against them see it at other instants in every period.
"""

from __future__ import annotations

import numpy as np

from hpe_rig.plan import Shot, reference_gate, select
from hpe_rig.processing.echoes import FloatArray, relative_to
from hpe_rig.processing.motion import coherent
from hpe_rig.processing.shots import margin_needed, samples_needed, shot_echoes, shot_motion
from hpe_rig.scene import Scene
from hpe_rig.store import StoredRun

PARTS = (8, 200)
"""Fewest and most parts of the burst period."""


def burst_period_motion(scene: Scene, shot: Shot, stored: StoredRun) -> tuple[FloatArray, FloatArray]:
    """Return times (time,) after a toneburst's arrival at the gate, s, and the mean displacement then, m.

    The middles of equal parts of the burst period, as many as pulses fit into it; the displacement of the pulses in the
    processing window, by the estimator "coherent", about its mean; NaN where no pulse fell. Empty where nothing pushes
    or the echoes carry no displacement.
    """
    nothing = np.zeros(0), np.zeros(0)
    if scene.excitation is None:
        return nothing
    margin, gate, chosen = margin_needed(scene, shot), reference_gate(scene, shot), select(scene, shot)
    try:
        records = stored.records.in_blocks(shot.index, samples_needed(scene, shot), margin=margin)
        motion = shot_motion(scene, shot, shot_echoes(scene, shot, records, chosen), coherent)
        if gate is not None:
            still = stored.records.in_blocks(shot.index, gate, margin=margin)
            motion = relative_to(motion, coherent(shot_echoes(scene, shot, still, chosen)))
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
