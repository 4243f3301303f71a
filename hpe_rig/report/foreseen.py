"""Prediction of the error model for the amplitudes found, to stand beside the stated uncertainties."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

from hpe_rig.prediction import predict, setting_of
from hpe_rig.result import Estimate, ShotResult
from hpe_rig.scene import Estimator, Scene

DRAWS = 300
"""Speckles drawn for a prediction: its standard deviations are good to 4 %, 1 / sqrt(2 DRAWS)."""


@dataclass(frozen=True, slots=True)
class Foreseen:
    """Predicted and stated for one frequency: bias and standard deviations from noise and from speckle."""

    estimate: Estimate
    bias_m: float
    noise_m: float
    speckle_m: float
    phase_rad: float


def foreseen(scene: Scene, shot: ShotResult, estimator: Estimator) -> tuple[Foreseen, ...]:
    """Return the prediction for each estimate of ``shot``, for its amplitude and the number of its pulses.

    Empty where the scene has no [beams] or nothing says how strong the noise is.
    """
    return tuple(_each(scene, shot, estimator))


def _each(scene: Scene, shot: ShotResult, estimator: Estimator) -> Iterator[Foreseen]:
    for item in shot.estimates:
        if not item.amplitude_m > 0:
            continue
        # The prediction is for a scene's first frequency, at the amplitude that it expects.
        asked = {"frequencies_hz": (item.frequency_hz,), "expected_amplitude_m": item.amplitude_m}
        setting = setting_of(scene.model_copy(update={"processing": scene.processing.model_copy(update=asked)}))
        if setting is None:
            return
        (found,) = predict(replace(setting, pulses=shot.pulses_used), (estimator,), DRAWS).expected
        yield Foreseen(item, found.bias_m, found.noise_jitter_m, found.speckle_jitter_m, found.phase_jitter_rad)
