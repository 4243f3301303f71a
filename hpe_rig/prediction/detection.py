"""Detection floor: the smallest amplitude that stands out of noise and trigger jitter."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from hpe_rig.bench import twin_of
from hpe_rig.plan import Shot, window_pulse_count
from hpe_rig.prediction.forecast import expected_snr_db
from hpe_rig.processing import shot_model, spec_of
from hpe_rig.scene import Scene

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
    """Return the floor of an amplitude: echo noise, and the trigger jitter between pulse and sampling clock.

    ``shot`` says which pulses the estimate skips, and so what it costs to fit the other driven harmonics along.

    A pulse's phase in white noise has the variance 1 / (samples in the gate x SNR), its time of flight that of the
    trigger jitter (twin alone; a real bench's is not known); over N pulses a quadrature has 2/N of either. See
    docs/theory/prediction.md, "Detection floor".
    """
    acquisition, snr_db = scene.acquisition, expected_snr_db(scene)
    samples = 2 * acquisition.gate_length_m / acquisition.sound_speed_m_per_s * acquisition.sample_rate_hz
    metres_per_radian = acquisition.sound_speed_m_per_s / (4 * math.pi * scene.tracking.carrier_hz)
    spec, twin = spec_of(scene.processing.estimator), twin_of(scene) if simulated else None
    over_pulses = math.sqrt(2 * spec.slow_time_noise / window_pulse_count(scene))
    if shot is not None and spec.fits_all_at_once:
        # A plan with conflicts may have no fit at all.
        with suppress(ValueError):
            over_pulses = _quadrature_gain(scene, shot)
    noise_m = 0.0
    if snr_db is not None:
        noise_m = metres_per_radian * math.sqrt(spec.gate_noise / (samples * 10 ** (snr_db / 10)))
    jitter_s = 0.0 if twin is None else twin.trigger_jitter_s
    return Floor(noise_m * over_pulses, jitter_s * acquisition.sound_speed_m_per_s / 2 * over_pulses)


def fit_gain(scene: Scene, shot: Shot) -> float:
    """Return the noise of the worst wanted quadrature over that of a sinusoid fitted alone to all pulses; else 1.

    Above 1 where pulses are skipped and barely resolve the wanted from the other driven harmonics, fitted along.
    """
    with suppress(ValueError):
        return _quadrature_gain(scene, shot) / math.sqrt(2 / window_pulse_count(scene))
    return 1.0


def _quadrature_gain(scene: Scene, shot: Shot) -> float:
    """Return the noise of the worst wanted quadrature over that of a pulse, by the least squares that are fitted."""
    _, model = shot_model(scene, shot)
    return float(np.linalg.norm(model.root[: 2 * len(scene.wanted_frequencies_hz)], axis=1).max())
