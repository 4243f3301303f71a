"""Forecast of a scene: bias and jitter of every estimator before a measurement, and what brings a jitter down."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from hpe_rig.bench import twin_of
from hpe_rig.plan import Shot, select, window_pulse_count
from hpe_rig.prediction.aliasing import each_fitted_over_true
from hpe_rig.prediction.amplitude import expected_amplitude_m, expected_snr_db
from hpe_rig.prediction.beam_averaging import motion_width_m, predicted_averaging, resting_conditions
from hpe_rig.prediction.error_model import Conditions, Expected, expected, seeded_speckle
from hpe_rig.prediction.linear_fit import noise_gain
from hpe_rig.processing import ESTIMATORS, spec_of
from hpe_rig.result import Averaging
from hpe_rig.scene import Scene

PEAK_DRAWS = 4
"""How many times the draws are needed where the phase is read at a peak."""
LEAST_CYCLES = 1.0
LEAST_POINTS = 2.5
"""Cycles and pulses a cycle below which no estimate is made, however little noise there is."""


@dataclass(frozen=True, slots=True)
class Prediction:
    """Bias and jitter of every estimator for one vibration frequency of a scene."""

    conditions: Conditions
    expected: tuple[Expected, ...]
    aliasing: tuple[complex, ...] = ()
    """Fitted over true of every estimator, without noise, less 1; empty where no medium is known or nothing pushes."""

    def error_m(self, place: int) -> float:
        """Return what the stated uncertainty of an estimator is to cover: its noise, and what aliasing adds, m."""
        aliased = abs(self.aliasing[place]) * self.conditions.amplitude_m if self.aliasing else 0.0
        return math.hypot(self.expected[place].quadrature_m, aliased)


def conditions_of(
    scene: Scene, shot: Shot | None = None, frequency_hz: float | None = None, estimator: str | None = None
) -> Conditions | None:
    """Return what bias and jitter of a wanted frequency, absent: the first, depend on; None without beams or SNR.

    ``shot`` says which pulses the estimate uses, by what force they were moved, and what it costs to fit the other
    driven harmonics along; where its plan resolves no frequencies that cost is left out.
    """
    snr_db, resting = expected_snr_db(scene), resting_conditions(scene)
    if snr_db is None or resting is None:
        return None
    frequency_hz = resting.frequency_hz if frequency_hz is None else frequency_hz
    pulses = window_pulse_count(scene) if shot is None else max(1, int(select(scene, shot).used.sum()))
    twin = twin_of(scene)
    # A reference gate takes the jitter away and adds its own echo noise, as much as that of the gate where it is alike.
    subtracted = scene.processing.reference_gate_depth_m is not None
    return replace(
        resting,
        excitation_width_m=motion_width_m(scene, frequency_hz),
        pulses=pulses,
        frequency_hz=frequency_hz,
        amplitude_m=expected_amplitude_m(scene, frequency_hz, shot),
        snr=10 ** (snr_db / 10) / (2 if subtracted else 1),
        trigger_jitter_s=0.0 if twin is None or subtracted else twin.trigger_jitter_s,
        fit_gain=1.0 if shot is None else _fit_gain(scene, shot, frequency_hz, pulses, estimator),
    )


def _fit_gain(scene: Scene, shot: Shot, frequency_hz: float, pulses: int, estimator: str | None) -> float:
    """Return the noise of a quadrature over that of a sinusoid fitted alone to all used pulses, 1 for windows."""
    if not spec_of(estimator or scene.processing.estimator).fits_all_at_once:
        return 1.0
    # A plan with conflicts may have no fit at all.
    with suppress(ValueError):
        index = scene.wanted_frequencies_hz.index(frequency_hz)
        return float(noise_gain(scene, shot, estimator)[index]) / math.sqrt(2 / pulses)
    return 1.0


def forecast_of(
    scene: Scene,
    shot: Shot,
    frequency_hz: float | None = None,
    estimators: tuple[str, ...] = ESTIMATORS,
    simulated: bool = True,
) -> Prediction | None:
    """Return bias, jitter and aliasing of every estimator at one wanted frequency, absent: the first.

    The one forecast that ``check``, report and design print; None without beams or SNR.
    """
    each = [conditions_of(scene, shot, frequency_hz, name) for name in estimators]
    known = [conditions for conditions in each if conditions is not None]
    if not known:
        return None
    place = scene.wanted_frequencies_hz.index(known[0].frequency_hz)
    found = [
        as_averaged(predict(conditions, (name,)).expected[0], conditions, predicted_averaging(scene, name)[place])
        for name, conditions in zip(estimators, known, strict=True)
    ]
    ratios = each_fitted_over_true(scene, shot, estimators, simulated)
    aliasing = tuple(complex(ratio[place]) - 1 for ratio in ratios if ratio is not None)
    own = known[estimators.index(scene.processing.estimator)] if scene.processing.estimator in estimators else known[0]
    return Prediction(own, tuple(found), aliasing if len(aliasing) == len(estimators) else ())


def as_averaged(expected: Expected, conditions: Conditions, averaging: Averaging | None) -> Expected:
    """Return ``expected`` with bias and speckle of ``averaging``, as a result's budget has them.

    The error model's own are those of a Gaussian motion, and of as many draws as it has.
    """
    if averaging is None:
        return expected
    tracked_m = averaging.factor * conditions.amplitude_m
    return replace(
        expected,
        bias_m=expected.bias_m + tracked_m - expected.tracked * conditions.amplitude_m,
        speckle_jitter_m=tracked_m * math.hypot(averaging.speckle_relative, averaging.carrier_relative),
        tracked=averaging.factor,
    )


def predict(conditions: Conditions, estimators: tuple[str, ...] = ESTIMATORS, draws: int = 1000) -> Prediction:
    """Return bias and jitter of every estimator; the seeds are fixed, so equal conditions give equal figures.

    Where noise moves the peak that is read, its variance comes from the draws too: it takes more of them.
    """
    return Prediction(conditions, tuple(_expected(conditions, name, draws) for name in estimators))


def _expected(conditions: Conditions, estimator: str, draws: int) -> Expected:
    many = PEAK_DRAWS * draws if spec_of(estimator).reads_peak else draws
    # All that speckle does not depend on is left out, so that estimators share their draws.
    echoes = replace(conditions, pulses=1, frequency_hz=0.0, amplitude_m=0.0, snr=np.inf, trigger_jitter_s=0.0)
    speckle = seeded_speckle(replace(echoes, fit_gain=1.0), many)
    return expected(conditions, estimator, speckle, np.random.default_rng(1))


@dataclass(frozen=True, slots=True)
class Remedy:
    """What alone would reach a wanted uncertainty: a factor on the cycles, the pulse rate, or dB of SNR."""

    cycles: float
    pulse_rate_hz: float
    snr_db: float
    reachable_rate_hz: float


def remedies(prediction: Prediction, target_m: float, depth_m: float, estimator: str = "coherent") -> Remedy:
    """Return N_c, f_prf and SNR of which each alone brings the noise jitter of ``estimator`` to ``target_m``.

    Noise variance goes with 1 / (N_c f_prf SNR) where a pulse's phase is well above noise; of trigger jitter SNR takes
    nothing, so ``snr_db`` is inf where that alone exceeds the target, -inf where there is nothing else.
    ``reachable_rate_hz`` is c / 2z: no faster pulse rate can be.
    """
    conditions = prediction.conditions
    found = next(each for each in prediction.expected if each.estimator == estimator)
    factor = (found.noise_jitter_m / target_m) ** 2
    cycles = conditions.pulses / conditions.pulse_rate_hz * conditions.frequency_hz
    spec = spec_of(estimator)
    worse = conditions.fit_gain**2 if spec.fits_all_at_once else spec.slow_time_noise
    jitter = 2 * worse * conditions.trigger_jitter_variance / conditions.pulses * conditions.metres_per_radian**2
    left = target_m**2 - jitter
    snr_factor = (found.noise_jitter_m**2 - jitter) / left if left > 0 else math.inf
    return Remedy(
        max(cycles * factor, LEAST_CYCLES),
        max(conditions.pulse_rate_hz * factor, LEAST_POINTS * conditions.frequency_hz),
        10 * math.log10(conditions.snr * snr_factor) if snr_factor > 0 else -math.inf,
        conditions.sound_speed_m_per_s / (2 * depth_m),
    )
