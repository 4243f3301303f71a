"""Forecast of a scene: bias and jitter of every estimator before a measurement, and settings that reach a target."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from hpe_rig.bench import twin_of
from hpe_rig.plan import Shot, select, window_pulse_count
from hpe_rig.prediction.beam_averaging import predicted_averaging
from hpe_rig.prediction.conditions import Conditions, expected_amplitude_m, expected_snr_db, resting_conditions
from hpe_rig.prediction.error_model import EstimatorErrors, estimator_errors
from hpe_rig.prediction.linear_fit import fitted_over_true_by_estimator, noise_gain
from hpe_rig.prediction.scene_physics import gaussian_motion_width_m
from hpe_rig.prediction.speckle import seeded_speckle
from hpe_rig.processing import ESTIMATORS, spec_of
from hpe_rig.result import Averaging
from hpe_rig.scene import Scene

PEAK_DRAW_FACTOR = 4
"""Factor on the number of draws for an estimator that reads the phase at a peak: its variance comes from draws too."""
MIN_CYCLES = 1.0
MIN_PULSES_PER_CYCLE = 2.5
"""Cycles, and pulses in a cycle, below which no estimate is made however little noise there is."""


@dataclass(frozen=True, slots=True)
class Prediction:
    """Errors of every estimator for one vibration frequency of a scene.

    ``aliasing``: fitted over true phasor of every estimator without noise, minus 1; empty if no medium is known or
    nothing pushes.
    """

    conditions: Conditions
    expected: tuple[EstimatorErrors, ...]
    aliasing: tuple[complex, ...] = ()

    def error_m(self, index: int) -> float:
        """Return noise and aliasing of an estimator together, m: the errors that its stated uncertainty covers."""
        aliased_m = abs(self.aliasing[index]) * self.conditions.amplitude_m if self.aliasing else 0.0
        return math.hypot(self.expected[index].quadrature_m, aliased_m)

    def errors_of(self, estimator: str) -> EstimatorErrors:
        """Return the errors of ``estimator``."""
        return next(errors for errors in self.expected if errors.estimator == estimator)


def conditions_of(
    scene: Scene, shot: Shot | None = None, frequency_hz: float | None = None, estimator: str | None = None
) -> Conditions | None:
    """Return the conditions for which errors at one wanted frequency (default: the first) are predicted.

    None without beams or SNR. ``shot`` gives the used pulses, the force, and the cost of fitting the other driven
    harmonics; that cost is left out if the plan resolves no frequencies.
    """
    snr_db, resting = expected_snr_db(scene), resting_conditions(scene)
    if snr_db is None or resting is None:
        return None
    frequency_hz = resting.frequency_hz if frequency_hz is None else frequency_hz
    pulses = window_pulse_count(scene) if shot is None else max(1, int(select(scene, shot).used.sum()))
    twin = twin_of(scene)
    # A reference gate removes the jitter and adds its own echo noise, assumed equal to the gate's.
    has_reference = scene.processing.reference_gate_depth_m is not None
    return replace(
        resting,
        excitation_width_m=gaussian_motion_width_m(scene, frequency_hz),
        pulses=pulses,
        frequency_hz=frequency_hz,
        amplitude_m=expected_amplitude_m(scene, frequency_hz, shot),
        snr=10 ** (snr_db / 10) / (2 if has_reference else 1),
        trigger_jitter_s=0.0 if twin is None or has_reference else twin.settings.instruments.trigger_jitter_s,
        fit_gain=1.0 if shot is None else _fit_gain(scene, shot, frequency_hz, pulses, estimator),
    )


def _fit_gain(scene: Scene, shot: Shot, frequency_hz: float, pulses: int, estimator: str | None) -> float:
    """Return the noise of a fitted quadrature over that of one sinusoid fitted to all used pulses.

    It is 1 for an estimator without such a fit, and exceeds 1 if the pulses hardly separate the frequency from the
    other fitted harmonics.
    """
    if not spec_of(estimator or scene.processing.estimator).fits_all_at_once:
        return 1.0
    # A plan with conflicts may have no fit.
    with suppress(ValueError):
        index = scene.wanted_frequencies_hz.index(frequency_hz)
        return float(noise_gain(scene, shot, estimator)[index]) / math.sqrt(2 / pulses)
    return 1.0


def forecast_of(scene: Scene, shot: Shot, simulated: bool = True) -> Prediction | None:
    """Return predicted bias, jitter and aliasing of every estimator at the first wanted frequency.

    ``check``, report and design print this forecast. None without beams or SNR.
    """
    # Beams and SNR are the same for all estimators: conditions exist for all of them or for none.
    by_estimator = [
        conditions for name in ESTIMATORS if (conditions := conditions_of(scene, shot, estimator=name)) is not None
    ]
    if not by_estimator:
        return None
    errors = tuple(
        with_beam_averaging(predict(conditions, (name,)).expected[0], conditions, predicted_averaging(scene, name)[0])
        for name, conditions in zip(ESTIMATORS, by_estimator, strict=True)
    )
    ratios = fitted_over_true_by_estimator(scene, shot, ESTIMATORS, simulated)
    aliasing = tuple(complex(ratio[0]) - 1 for ratio in ratios if ratio is not None)
    conditions = by_estimator[ESTIMATORS.index(scene.processing.estimator)]
    return Prediction(conditions, errors, aliasing if len(aliasing) == len(ESTIMATORS) else ())


def with_beam_averaging(
    errors: EstimatorErrors, conditions: Conditions, averaging: Averaging | None
) -> EstimatorErrors:
    """Return ``errors`` with the bias and speckle jitter of ``averaging``, as in the error budget of a result.

    ``averaging``: effect of averaging the motion over the tracking beam; None leaves ``errors`` unchanged. It replaces
    the effect in ``errors``, which is that of a Gaussian motion in a finite number of draws. The jitter includes the
    variation of the echoes' mean frequency, for an estimator that divides by the carrier.
    """
    if averaging is None:
        return errors
    tracked_m = averaging.factor * conditions.amplitude_m
    # The bias by noise remains; the bias by averaging is replaced.
    return replace(
        errors,
        bias_m=errors.bias_m + tracked_m - errors.averaging_factor * conditions.amplitude_m,
        speckle_jitter_m=tracked_m * math.hypot(averaging.speckle_relative, averaging.carrier_relative),
        averaging_factor=averaging.factor,
    )


def predict(conditions: Conditions, estimators: tuple[str, ...] = ESTIMATORS, draws: int = 1000) -> Prediction:
    """Return bias and jitter of every estimator from ``draws`` random draws of speckle.

    An estimator that reads the phase at a spectral peak gets more draws, by ``PEAK_DRAW_FACTOR``. Seeds are fixed, so
    equal conditions give equal numbers.
    """
    draws_by_estimator = [PEAK_DRAW_FACTOR * draws if spec_of(name).reads_peak else draws for name in estimators]
    errors = (
        estimator_errors(conditions, name, seeded_speckle(conditions, count), np.random.default_rng(1))
        for name, count in zip(estimators, draws_by_estimator, strict=True)
    )
    return Prediction(conditions, tuple(errors))


def remedies(prediction: Prediction, target_m: float, estimator: str = "coherent") -> tuple[float, float, float]:
    """Return cycles N_c, pulse rate (Hz) and SNR (dB) that each bring ``estimator``'s noise jitter to ``target_m``.

    The noise variance is proportional to 1 / (N_c f_prf SNR) if a pulse's phase is well above noise. SNR does not
    reduce trigger jitter: the SNR is inf if jitter alone exceeds the target, -inf if there is nothing else.
    """
    conditions, noise_m = prediction.conditions, prediction.errors_of(estimator).noise_jitter_m
    factor = (noise_m / target_m) ** 2
    # Cycles and pulse rate act through the number of pulses.
    cycles = conditions.pulses / conditions.pulse_rate_hz * conditions.frequency_hz
    spec = spec_of(estimator)
    variance_gain = conditions.fit_gain**2 if spec.fits_all_at_once else spec.slow_time_noise
    jitter_rad2 = 2 * variance_gain * conditions.trigger_jitter_variance / conditions.pulses
    jitter_m2 = jitter_rad2 * conditions.metres_per_radian**2
    echo_target_m2 = target_m**2 - jitter_m2
    snr_factor = (noise_m**2 - jitter_m2) / echo_target_m2 if echo_target_m2 > 0 else math.inf
    return (
        max(cycles * factor, MIN_CYCLES),
        max(conditions.pulse_rate_hz * factor, MIN_PULSES_PER_CYCLE * conditions.frequency_hz),
        10 * math.log10(conditions.snr * snr_factor) if snr_factor > 0 else -math.inf,
    )
