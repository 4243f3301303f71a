"""Detection floor: the smallest amplitude that exceeds noise and trigger jitter.

The amplitude of two normal quadratures exceeds a with the probability

    P(a) = mean over directions t of exp(-a^2 / 2 v(t)),    v(t) = v_1 cos^2 t + v_2 sin^2 t

v_1 and v_2 are the variances of the principal quadratures. The floor is the a with P = ``FALSE_ALARMS``.
"""

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
"""Fraction of measurements without motion where noise alone exceeds the floor."""
DIRECTIONS = 400
"""Midpoint nodes of the mean over directions."""


@dataclass(frozen=True, slots=True)
class Floor:
    """Noise of a displacement amplitude: standard deviations of one quadrature, rms of the two, m.

    ``larger_quadrature``: noise of the larger principal quadrature over that rms, 1 to sqrt(2). ``relative_variances``:
    noise variances in groups of equally many measurements over their mean, if they differ.
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
        """The displacement amplitude that noise alone exceeds with the probability ``FALSE_ALARMS``, m."""
        if self.quadrature_m == 0:
            return 0.0
        noise_m2 = np.array(self.relative_variances) * self.noise_m**2
        relative = (noise_m2 + self.trigger_jitter_m**2) / self.quadrature_m**2
        return self.quadrature_m * amplitude_quantile(self.larger_quadrature, tuple(relative.tolist()))


def amplitude_quantile(larger_quadrature: float, relative_variances: tuple[float, ...] = (1.0,)) -> float:
    """Return the amplitude that noise alone exceeds in the fraction ``FALSE_ALARMS``, over the rms of a quadrature.

    ``larger_quadrature``: noise of the larger principal quadrature over the rms of both. 1 gives the Rayleigh
    distribution, sqrt(2) that of the magnitude of one normal number. ``relative_variances``: noise variances of groups
    of equally many measurements, over their mean; if they differ, the largest exceed the floor more often.
    """
    # Noise variance of the phasor's component in each direction, (group, direction). The variances v_1 and v_2 of the
    # principal quadratures have the mean 1: v_1 cos^2 + v_2 sin^2 = v_1 + (2 - 2 v_1) sin^2.
    larger_variance = larger_quadrature**2
    sine_squared = np.sin(np.pi * (np.arange(DIRECTIONS) + 0.5) / DIRECTIONS) ** 2
    by_direction = larger_variance + (2 - 2 * larger_variance) * sine_squared
    variance = np.maximum(np.multiply.outer(relative_variances, by_direction), np.finfo(np.float64).tiny)
    # Bisection: `hpe-rig check` must not load SciPy for this alone.
    low, high = 0.0, 2 * math.sqrt(2 * math.log(1 / FALSE_ALARMS) * max(relative_variances))
    for _ in range(50):
        middle = (low + high) / 2
        # Probability that the amplitude exceeds ``middle``: the mean over groups and directions.
        exceeded = float(np.mean(np.exp(-(middle**2) / 2 / variance)))
        low, high = (middle, high) if exceeded > FALSE_ALARMS else (low, middle)
    return high


def detection_floor(scene: Scene, simulated: bool = True, shot: Shot | None = None) -> Floor:
    """Return the noise that limits detection at the worst wanted frequency: echo noise and trigger jitter.

    ``shot`` gives the used pulses and so the cost of fitting the other driven harmonics; without it every frequency
    counts as the only one fitted to all pulses. Echo noise is that of the error model (``predict``) for echoes at rest
    if beams are declared, else that of the whole gate. Trigger jitter is the twin's; that of a real bench is unknown.
    See docs/explanation/prediction.md, "Detection floor".
    """
    spec = spec_of(scene.processing.estimator)
    noise_gains, larger_quadratures = _fit_noise(scene, shot)
    # The worst frequency has the highest floor for equal noise of the pulses.
    quantiles = np.array([amplitude_quantile(larger) for larger in larger_quadratures.tolist()])
    worst = int(np.argmax(noise_gains * quantiles))
    gain = float(noise_gains[worst])
    noise_m = echo_noise_m(scene, spec) * gain
    relative_variances: tuple[float, ...] = (1.0,)
    conditions = conditions_of(scene, shot, scene.wanted_frequencies_hz[worst] if scene.wanted_frequencies_hz else None)
    if conditions is not None:
        at_rest = replace(conditions, amplitude_m=0.0, trigger_jitter_s=0.0)
        errors = predict(at_rest, (spec.name,)).expected[0]
        noise_m, relative_variances = errors.quadrature_m, errors.relative_variances
    return Floor(
        noise_m=noise_m,
        trigger_jitter_m=trigger_noise_m(scene, simulated) * gain,
        larger_quadrature=float(larger_quadratures[worst]),
        relative_variances=relative_variances,
    )


def _fit_noise(scene: Scene, shot: Shot | None) -> tuple[FloatArray, FloatArray]:
    """Return the noise of the fitted quadratures at every wanted frequency: (frequency,) each.

    The first is the rms noise of both quadratures over the displacement noise of a pulse, the second the noise of the
    larger principal quadrature over that rms. They are those of a single fitted sinusoid without plan or fit.
    """
    if shot is not None:
        # A plan with conflicts may have no fit.
        with suppress(ValueError):
            return noise_gain(scene, shot), larger_quadrature(scene, shot)
    single = 2 * spec_of(scene.processing.estimator).slow_time_noise / window_pulse_count(scene)
    count = max(1, len(scene.wanted_frequencies_hz))
    return np.full(count, math.sqrt(single)), np.ones(count)
