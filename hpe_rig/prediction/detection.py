"""Detection floor: the smallest amplitude that stands out of noise and trigger jitter."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from hpe_rig.arrays import FloatArray
from hpe_rig.plan import Shot, window_pulse_count
from hpe_rig.prediction.forecast import conditions_of, predict
from hpe_rig.prediction.linear_fit import echo_noise_m, larger_quadrature, noise_gain, trigger_noise_m
from hpe_rig.processing import spec_of
from hpe_rig.scene import Scene

FALSE_ALARMS = 0.05
"""Share of measurements without motion in which noise alone exceeds the floor."""
DIRECTIONS = 400
"""Directions over which the share is averaged."""


@dataclass(frozen=True, slots=True)
class Floor:
    """Noise of a displacement amplitude; standard deviations of one quadrature, root mean square of the two, m.

    ``larger_quadrature``: deviation of the larger principal quadrature over that, 1 to sqrt(2), as the pulses lie.
    ``relative_variances``: of the noise in equally many media each, over the mean, where it differs among them.
    """

    noise_m: float
    trigger_jitter_m: float
    larger_quadrature: float = 1.0
    relative_variances: tuple[float, ...] = (1.0,)

    @property
    def quadrature_m(self) -> float:
        """Noise and trigger jitter together."""
        return math.hypot(self.noise_m, self.trigger_jitter_m)

    @property
    def detected_m(self) -> float:
        """The amplitude that noise alone exceeds with ``FALSE_ALARMS``."""
        if self.quadrature_m == 0:
            return 0.0
        noise = np.array(self.relative_variances) * self.noise_m**2
        relative = (noise + self.trigger_jitter_m**2) / self.quadrature_m**2
        return self.quadrature_m * amplitude_quantile(self.larger_quadrature, tuple(relative.tolist()))


def amplitude_quantile(larger_quadrature: float, relative_variances: tuple[float, ...] = (1.0,)) -> float:
    """Return what the amplitude of two normal quadratures exceeds with ``FALSE_ALARMS``, over their root mean square.

    ``larger_quadrature``: standard deviation of the larger principal one over the same, from 1, where the amplitude has
    the Rayleigh distribution, to sqrt(2), where it is one normal number's size. ``relative_variances``: of the noise in
    groups of equally many measurements, over their mean; where they differ, the largest exceed more often.
    """
    larger = larger_quadrature**2
    # Two standard normal numbers have an even direction and a length of its own: exp(-length^2 / 2) is its tail. Along
    # each direction the amplitude is the length times a deviation, and the tail's mean over them is the amplitude's.
    across = np.sin(np.pi * (np.arange(DIRECTIONS) + 0.5) / DIRECTIONS) ** 2
    variance = np.multiply.outer(relative_variances, larger + (2 - 2 * larger) * across)
    variance = np.maximum(variance, np.finfo(np.float64).tiny)
    low, high = 0.0, 2 * math.sqrt(2 * math.log(1 / FALSE_ALARMS) * max(relative_variances))
    for _ in range(50):
        middle = (low + high) / 2
        exceeded = float(np.mean(np.exp(-(middle**2) / 2 / variance)))
        low, high = (middle, high) if exceeded > FALSE_ALARMS else (low, middle)
    return high


def detection_floor(scene: Scene, simulated: bool = True, shot: Shot | None = None) -> Floor:
    """Return the floor of an amplitude at the worst wanted frequency: echo noise, and trigger jitter.

    ``shot`` says which pulses the estimate uses, and so what it costs to fit the other driven harmonics along; absent,
    every frequency counts as fitted alone to all pulses. Echo noise is the error model's (`predict`) for echoes that
    hardly move, where the beams are declared, else that of the whole gate; trigger jitter that of the twin, a real
    bench's is not known. See docs/theory/prediction.md, "Detection floor".
    """
    spec, worst = spec_of(scene.processing.estimator), None
    gain, larger = _gain_and_larger_quadrature(scene, shot)
    quantile = np.array([amplitude_quantile(each) for each in larger.tolist()])
    at = int(np.argmax(gain * quantile))
    if scene.wanted_frequencies_hz:
        worst = scene.wanted_frequencies_hz[at]
    conditions = conditions_of(scene, shot, worst)
    noise_m = echo_noise_m(scene, spec) * float(gain[at])
    relative: tuple[float, ...] = (1.0,)
    if conditions is not None:
        still = replace(conditions, amplitude_m=0.0, trigger_jitter_s=0.0)
        foreseen = predict(still, (spec.name,)).expected[0]
        noise_m, relative = foreseen.quadrature_m, foreseen.relative_variances
    return Floor(noise_m, trigger_noise_m(scene, simulated) * float(gain[at]), float(larger[at]), relative)


def _gain_and_larger_quadrature(scene: Scene, shot: Shot | None) -> tuple[FloatArray, FloatArray]:
    """Return the noise gain and how much more the larger quadrature has of it, each (frequency,).

    Those of a sinusoid fitted alone where no plan or no fit is known.
    """
    if shot is not None:
        # A plan with conflicts may have no fit at all.
        with suppress(ValueError):
            return noise_gain(scene, shot), larger_quadrature(scene, shot)
    alone = 2 * spec_of(scene.processing.estimator).slow_time_noise / window_pulse_count(scene)
    count = max(1, len(scene.wanted_frequencies_hz))
    return np.full(count, math.sqrt(alone)), np.ones(count)
