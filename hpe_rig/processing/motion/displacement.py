"""Displacement and velocity of each pulse: the results of every motion estimator."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hpe_rig.arrays import BoolArray, FloatArray


@dataclass(frozen=True, slots=True)
class Motion:
    """Displacement per pulse, up to a constant; positive is away from the transducer.

    ``time_s`` (pulse,). ``displacement_m`` (..., pulse): NaN at invalid pulses. ``variance_m2`` (..., pulse): noise
    variance, estimated from the scatter of the echoes. ``valid`` (pulse,).
    ``largest_step`` (...): largest change between consecutive valid pulses in quarter wavelengths; near 1 the phase is
    ambiguous by a whole period.
    ``step_noise_ratio`` (...): for estimators that add up steps, the variance of the noise of one step, which stays in
    all later pulses, over that of one pulse; None if the noise of pulses is independent.
    """

    time_s: FloatArray
    displacement_m: FloatArray
    variance_m2: FloatArray
    valid: BoolArray
    largest_step: FloatArray | float = 0.0
    step_noise_ratio: FloatArray | None = None


@dataclass(frozen=True, slots=True)
class Velocity:
    """Mean velocity between consecutive pulses; interval n lies between pulses n and n + 1.

    ``time_s`` (interval,): its middle; ``interval_s`` (interval,): its length; ``velocity_m_per_s`` (..., interval):
    NaN at invalid intervals; ``valid`` (interval,): both pulses are valid.
    """

    time_s: FloatArray
    interval_s: FloatArray
    velocity_m_per_s: FloatArray
    valid: BoolArray


def velocity_between_pulses(motion: Motion) -> Velocity:
    """Return the mean velocity in every interval between consecutive pulses; valid where both its pulses are."""
    interval_s = np.diff(motion.time_s)
    return Velocity(
        time_s=motion.time_s[:-1] + interval_s / 2,
        interval_s=interval_s,
        velocity_m_per_s=np.diff(motion.displacement_m, axis=-1) / interval_s,
        valid=motion.valid[:-1] & motion.valid[1:],
    )


def relative_to(motion: Motion, reference: Motion) -> Motion:
    """Return ``motion`` minus the apparent motion of a stationary ``reference``, at pulses valid in both.

    Both come from the same records. Trigger jitter delays every echo of a record equally and cancels; variances add.
    Raises ``ValueError`` if their pulses differ.
    """
    if not np.array_equal(motion.time_s, reference.time_s):
        raise ValueError("motion and reference have different times: estimate both from the same records")
    # For sums of noisy steps: each step adds this many variances of a pulse; of the difference, their mean.
    ratios = [ratio for ratio in (motion.step_noise_ratio, reference.step_noise_ratio) if ratio is not None]
    return Motion(
        time_s=motion.time_s,
        displacement_m=motion.displacement_m - reference.displacement_m,
        variance_m2=motion.variance_m2 + reference.variance_m2,
        valid=motion.valid & reference.valid,
        largest_step=motion.largest_step,
        step_noise_ratio=np.asarray(sum(ratios) / 2) if ratios else None,
    )
