"""Fitted displacement of each pulse: harmonics as estimated, background and further driven frequencies fitted to the
rest."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress

import numpy as np

from hpe_rig.arrays import FloatArray
from hpe_rig.plan import PhaseReference, Selection
from hpe_rig.processing.harmonics.model import linear_model
from hpe_rig.processing.motion.displacement import Motion
from hpe_rig.result import Estimate, ShotMotion

MAX_FITTED_PULSES = 20_000
"""Longest train for which the fitted displacement is computed: its matrix has a column for each state."""


def fitted_motion(
    motion: Motion,
    estimates: Sequence[Estimate],
    reference: PhaseReference,
    also_hz: FloatArray,
    background_order: int,
) -> tuple[FloatArray, FloatArray]:
    """Return the fitted displacement of the valid pulses, and the matrix (pulse, state) of all fitted columns.

    The harmonics of ``estimates`` are kept as they are; their phases count from the event of ``reference``. Background
    and ``also_hz`` are fitted to ``motion`` without them. Raises ``ValueError`` if the pulses cannot resolve the
    frequencies.
    """
    rows = [
        [item.frequency_hz, item.tracked_amplitude_m, reference.physical_rad(item.tracked_phase_rad, item.frequency_hz)]
        for item in estimates
    ]
    frequency_hz, amplitude_m, phase_rad = np.array(rows, dtype=np.float64).reshape(-1, 3).T
    matrix = linear_model(
        motion.time_s, motion.valid, frequency_hz, background_order=background_order, also_hz=also_hz
    ).matrix
    # The wanted harmonics as estimated, then the background and further frequencies fitted to the remainder.
    wanted_columns, further_columns = np.split(matrix, [2 * frequency_hz.size], axis=1)
    state = (amplitude_m[:, None] * np.stack([np.cos(phase_rad), np.sin(phase_rad)], axis=1)).ravel()
    harmonics_m = wanted_columns @ state
    remaining_m = motion.displacement_m[motion.valid] - harmonics_m
    return harmonics_m + further_columns @ np.linalg.lstsq(further_columns, remaining_m, rcond=None)[0], matrix


def stored_motion(
    motion: Motion,
    estimates: Sequence[Estimate],
    reference: PhaseReference,
    residual_m: float,
    selection: Selection,
    background_order: int,
    tracked_by: str,
) -> ShotMotion:
    """Return the displacement of every pulse with its uncertainty and the fitted displacement, as a result stores it.

    ``residual_m``: rms residual of the harmonic fit; the uncertainty of a pulse is at least as large.
    """
    valid, model_m = motion.valid, np.full(motion.valid.size, np.nan)
    variance_m2 = np.where(valid, motion.variance_m2, np.nan)
    if motion.valid.size <= MAX_FITTED_PULSES:
        with suppress(ValueError):
            model_m[valid], _ = fitted_motion(motion, estimates, reference, selection.driven_hz, background_order)
            residual_m2 = float(np.mean((motion.displacement_m[valid] - model_m[valid]) ** 2))
            residual_m2 = max(residual_m2, residual_m**2)
            # The variance of a pulse contains only the noise of its echo, 0 for identical echoes. Trigger jitter and
            # motion within the gate are in the residual.
            mean_m2 = max(float(np.mean(variance_m2[valid])), float(np.finfo(np.float64).tiny))
            variance_m2 *= max(1.0, residual_m2 / mean_m2)
    return ShotMotion(
        pulse=np.flatnonzero(selection.window),
        time_s=motion.time_s - reference.delay_s,
        displacement_m=motion.displacement_m,
        uncertainty_m=np.sqrt(variance_m2),
        model_m=model_m,
        tracked_by=tracked_by,
    )
