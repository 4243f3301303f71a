"""Prediction of the error of each estimate of a shot: noise by the error model, bias and speckle as in the budget."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

from hpe_rig.plan import Shot
from hpe_rig.prediction import conditions_of, predict
from hpe_rig.result import Estimate, ShotResult
from hpe_rig.scene import Estimator, Scene


@dataclass(frozen=True, slots=True)
class Prediction:
    """Predicted bias, noise of a quadrature, and standard deviation from speckle, of one estimate."""

    estimate: Estimate
    bias_m: float
    noise_m: float
    speckle_m: float
    phase_rad: float


def predictions(scene: Scene, planned: Shot, shot: ShotResult, estimator: Estimator) -> Iterator[Prediction]:
    """Yield the prediction for each estimate of ``shot``, for its amplitude and the pulses of ``planned``.

    Nothing without [beams] or without a stated noise level.
    """
    for estimate in shot.estimates:
        # The noise of the phase is not defined without an amplitude.
        if not estimate.amplitude_m > 0:
            continue
        conditions = conditions_of(scene, planned, estimate.frequency_hz, estimator)
        if conditions is None:
            return
        (error,) = predict(replace(conditions, amplitude_m=estimate.amplitude_m), (estimator,)).expected
        bias_m, speckle_m = _averaging_errors(estimate)
        yield Prediction(estimate, bias_m, error.quadrature_m, speckle_m, error.phase_jitter_rad)


def _averaging_errors(estimate: Estimate) -> tuple[float, float]:
    """Return tracked minus peak amplitude, and its standard deviation over speckle, as in the budget."""
    factor = estimate.averaging_factor or 1.0
    by_source = {component.source: component.amplitude_m * factor for component in estimate.components}
    speckle_m = math.hypot(by_source.get("speckle", 0.0), by_source.get("carrier", 0.0))
    return estimate.amplitude_m * (1 - 1 / factor), speckle_m
