"""Detection floor: the smallest amplitude that stands out of noise and trigger jitter."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hpe_rig.plan import Shot, window_pulse_count
from hpe_rig.prediction.forecast import conditions_of, predict
from hpe_rig.prediction.linear_fit import echo_noise_m, noise_gain, trigger_noise_m
from hpe_rig.processing import spec_of
from hpe_rig.scene import Scene

FloatArray = NDArray[np.float64]

FALSE_ALARMS = 0.05
"""Share of measurements without motion in which noise alone exceeds the floor."""


@dataclass(frozen=True, slots=True)
class Floor:
    """Noise of a displacement amplitude; standard deviations of one quadrature, m."""

    noise_m: float
    trigger_jitter_m: float

    @property
    def quadrature_m(self) -> float:
        """Noise and trigger jitter together."""
        return math.hypot(self.noise_m, self.trigger_jitter_m)

    @property
    def detected_m(self) -> float:
        """The amplitude that noise alone exceeds with ``FALSE_ALARMS``: a quantile of the Rayleigh distribution."""
        return self.quadrature_m * math.sqrt(2 * math.log(1 / FALSE_ALARMS))


def detection_floor(scene: Scene, simulated: bool = True, shot: Shot | None = None) -> Floor:
    """Return the floor of an amplitude at the worst wanted frequency: echo noise, and trigger jitter.

    ``shot`` says which pulses the estimate uses, and so what it costs to fit the other driven harmonics along; absent,
    every frequency counts as fitted alone to all pulses. Echo noise is the error model's (`predict`) for echoes that
    hardly move, where the beams are declared, else that of the whole gate; trigger jitter that of the twin, a real
    bench's is not known. See docs/theory/prediction.md, "Detection floor".
    """
    spec, gain, worst = spec_of(scene.processing.estimator), _worst_gain(scene, shot), None
    if scene.wanted_frequencies_hz:
        worst = scene.wanted_frequencies_hz[int(np.argmax(gain))]
    conditions = conditions_of(scene, shot, worst)
    noise_m = echo_noise_m(scene, spec) * float(gain.max())
    if conditions is not None:
        still = replace(conditions, amplitude_m=0.0, trigger_jitter_s=0.0)
        noise_m = predict(still, (spec.name,)).expected[0].quadrature_m
    return Floor(noise_m, trigger_noise_m(scene, simulated) * float(gain.max()))


def _worst_gain(scene: Scene, shot: Shot | None) -> FloatArray:
    """Return the noise gain (frequency,), that of a sinusoid fitted alone where no plan or no fit is known."""
    if shot is not None:
        # A plan with conflicts may have no fit at all.
        with suppress(ValueError):
            return noise_gain(scene, shot)
    alone = 2 * spec_of(scene.processing.estimator).slow_time_noise / window_pulse_count(scene)
    return np.full(max(1, len(scene.wanted_frequencies_hz)), math.sqrt(alone))
