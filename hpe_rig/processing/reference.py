"""Motion against echoes that do not move: what both share, the jitter of trigger and clock, cancels."""

from __future__ import annotations

import numpy as np

from hpe_rig.processing.echoes import Motion


def relative_to(motion: Motion, reference: Motion) -> Motion:
    """Return ``motion`` less ``reference``, at the pulses that are valid in both; their variances add.

    Both come from the same records: a pulse fired late, or a clock read late, delays every echo of a record alike.
    Raises ``ValueError`` where their pulses differ.
    """
    if not np.array_equal(motion.time_s, reference.time_s):
        raise ValueError("motion and reference stand at different times: estimate both from the same records")
    walks = [each.walk for each in (motion, reference) if each.walk is not None]
    return Motion(
        motion.time_s,
        motion.displacement_m - reference.displacement_m,
        motion.variance_m2 + reference.variance_m2,
        motion.valid & reference.valid,
        motion.largest_step,
        np.asarray(sum(walks) / 2) if walks else None,
    )
