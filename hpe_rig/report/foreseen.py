"""Prediction for the amplitudes found, to stand beside the stated uncertainties: noise by the error model, bias and
speckle as in the budget."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

from hpe_rig.plan import Shot
from hpe_rig.prediction import conditions_of, predict
from hpe_rig.result import Estimate, ShotResult
from hpe_rig.scene import Estimator, Scene


@dataclass(frozen=True, slots=True)
class Foreseen:
    """Predicted and stated for one frequency: bias, noise of a quadrature, standard deviation from speckle."""

    estimate: Estimate
    bias_m: float
    noise_m: float
    speckle_m: float
    phase_rad: float


def foreseen(scene: Scene, planned: Shot, shot: ShotResult, estimator: Estimator) -> tuple[Foreseen, ...]:
    """Return the prediction for each estimate of ``shot``, for its amplitude and the pulses ``planned``.

    Empty where the scene has no [beams] or nothing says how strong the noise is.
    """
    return tuple(_each(scene, planned, shot, estimator))


def _each(scene: Scene, planned: Shot, shot: ShotResult, estimator: Estimator) -> Iterator[Foreseen]:
    for item in shot.estimates:
        if not item.amplitude_m > 0:
            continue
        conditions = conditions_of(scene, planned, item.frequency_hz, estimator)
        if conditions is None:
            return
        (found,) = predict(replace(conditions, amplitude_m=item.amplitude_m), (estimator,)).expected
        bias_m, speckle_m = _of_averaging(item)
        yield Foreseen(item, bias_m, found.quadrature_m, speckle_m, found.phase_jitter_rad)


def _of_averaging(item: Estimate) -> tuple[float, float]:
    """Return by how much the tracked amplitude lies off the peak, and its spread over speckle: as in the budget."""
    factor = item.averaging_factor or 1.0
    by_source = {each.source: each.amplitude_m * factor for each in item.components}
    speckle_m = math.hypot(by_source.get("speckle", 0.0), by_source.get("carrier", 0.0))
    return item.amplitude_m * (1 - 1 / factor), speckle_m
