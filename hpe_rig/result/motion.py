"""Displacement of one shot over its pulses, with its uncertainty and the fitted model."""

from __future__ import annotations

from dataclasses import dataclass

from hpe_rig.arrays import FloatArray, Int64Array

MOST_PULSES = 5_000_000
"""Pulses of all shots up to which a result stores their displacements, about 200 MB."""


@dataclass(frozen=True, slots=True, eq=False)
class ShotMotion:
    """Displacement D(t) of the pulses in a shot's window, up to a constant; all arrays (pulse,).

    ``pulse``: number of the pulse in the shot, from 0. ``time_s``: its time of sampling the motion, after the phase
    reference. ``displacement_m``: positive away from the transducer, NaN for missing or excluded records.
    ``uncertainty_m``: standard uncertainty of a pulse relative to the others, the larger of the scatter of its echo and
    the residual of the fit; the budgets of the estimates list the sources common to all pulses. ``model_m``: the
    result's harmonics, plus the other driven harmonics and the background fitted to the remainder; NaN without a model.
    ``tracked_by``: the motion estimator.
    """

    pulse: Int64Array
    time_s: FloatArray
    displacement_m: FloatArray
    uncertainty_m: FloatArray
    model_m: FloatArray
    tracked_by: str

    @property
    def residual_m(self) -> FloatArray:
        """Displacement minus model, (pulse,)."""
        return self.displacement_m - self.model_m
