"""Displacement of one shot over its pulses, with its uncertainty and the model fitted to it."""

from __future__ import annotations

from dataclasses import dataclass

from hpe_rig.arrays import FloatArray, Int64Array

MOST_PULSES = 5_000_000
"""Pulses of all shots up to which a result keeps their displacements: about 200 MB; they can be had again any time."""


@dataclass(frozen=True, slots=True, eq=False)
class ShotMotion:
    """Displacement D(t) of the pulses in a shot's window, up to a constant, all (pulse,).

    ``pulse``: number of the pulse in the shot, from 0; ``time_s`` when it senses the motion, from the phase reference
    on; ``displacement_m``, positive away from the transducer, NaN where the record is missing or left out;
    ``uncertainty_m``: standard uncertainty of a pulse against the others, what the scatter of its echo states, enlarged
    to what the fit leaves where that is more: the sources that all pulses share are in the estimates' budgets;
    ``model_m``: the result's harmonics, and the other driven harmonics and the background fitted to what they leave,
    NaN where no model is fitted. ``tracked_by``: the motion estimator.
    """

    pulse: Int64Array
    time_s: FloatArray
    displacement_m: FloatArray
    uncertainty_m: FloatArray
    model_m: FloatArray
    tracked_by: str

    @property
    def residual_m(self) -> FloatArray:
        """What the model does not explain, (pulse,)."""
        return self.displacement_m - self.model_m
