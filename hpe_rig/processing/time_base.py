"""Time base of a shot: the rate error of the motion's frequencies, and its effect on every amplitude and phase.

The clocks of the motion, of the tracking train and of the digitizer have the relative rate errors m, p and q. Their
covariance C follows from the accuracies in the bench file. The fit needs e = m - p; the trigger times measure p - q:

    e ~ N(0, w'C w),  w = (1, -1, 0)      without trigger times
    e given p - q                         with them (normal distribution, conditional)

The displacement then narrows e (harmonics/rate_error.py). Tonebursts at the second input, if it recorded them, measure
e far better than both (toneburst_phases.py). Pulse times are multiplied by 1 + e.
"""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Final

import numpy as np

from hpe_rig.arrays import ComplexArray, FloatArray
from hpe_rig.bench import BenchFile, clock_covariance, parse_bench
from hpe_rig.medium import BeamWidths
from hpe_rig.plan import Selection, Shot, select
from hpe_rig.processing.control import ControlMotion
from hpe_rig.processing.estimators import spec_of
from hpe_rig.processing.harmonics.drift import with_drift_uncertainty
from hpe_rig.processing.harmonics.harmonic_fit import HarmonicFit, with_state_error
from hpe_rig.processing.harmonics.medium_prior import MediumPrior
from hpe_rig.processing.harmonics.rate_error import SIGNIFICANT, RateError, estimate_rate_error, with_rate_error
from hpe_rig.processing.motion.displacement import Motion
from hpe_rig.processing.shot_fitting import HarmonicFitter, available_prior, options_of, shot_drift, shot_prior
from hpe_rig.processing.shot_tracking import (
    ALL_CLIPPED,
    MotionFunction,
    ShotRecords,
    WindowMotion,
    clipped_count,
    read_shot,
    window_motion,
)
from hpe_rig.processing.toneburst_phases import ToneburstPhases
from hpe_rig.processing.tracking_rate import TrackingRate
from hpe_rig.scene import UNSTATED_FREQUENCY_ACCURACY, Scene

if TYPE_CHECKING:
    from hpe_rig.store import StoredRun

MOTION_MINUS_PULSES: Final = np.array([1.0, -1.0, 0.0])
"""w: weights of the rate errors of motion, pulses and digitizer; the sum is that of the motion by the pulses' clock."""
PULSES_MINUS_DIGITIZER: Final = np.array([0.0, 1.0, -1.0])
"""As above, for the rate error of the pulses as measured with the digitizer's clock."""


@dataclass(frozen=True, slots=True)
class TimeBase:
    """Relative error of the motion's frequencies as measured with the pulses' clock, and its origin.

    ``by_pulses``: all that is known of it. ``by_clocks``: what is known before the displacement is analysed.
    ``tracking_rate``: rate of the pulses measured with the digitizer's clock, None if it was not measured.
    ``differs_from_bench``: that rate is off by more than the clocks' accuracies explain. ``by_tonebursts``: the rate
    error that the second input measured, None if it did not. ``bursts_differ``: that error is larger than the stated
    accuracies explain.
    """

    by_pulses: RateError
    by_clocks: RateError
    tracking_rate: TrackingRate | None
    differs_from_bench: bool = False
    by_tonebursts: RateError | None = None
    bursts_differ: bool = False

    @property
    def exceeds_accuracy(self) -> bool:
        """Whether the rate error is larger than the accuracies of the clocks explain."""
        return abs(self.by_pulses.value - self.by_clocks.value) > SIGNIFICANT * self.by_clocks.uncertainty

    @property
    def is_uncertain(self) -> bool:
        """Whether the rate error has an uncertainty; not for one common clock, nor if a linear drift contains it."""
        return self.by_pulses.uncertainty > 0

    @property
    def by_digitizer(self) -> RateError | None:
        """Relative error of the motion's frequencies by the digitizer's clock; None without trigger times."""
        if self.tracking_rate is None:
            return None
        return RateError(
            self.by_pulses.value + self.tracking_rate.error,
            math.hypot(self.by_pulses.uncertainty, self.tracking_rate.uncertainty),
        )


def clocks_of(scene: Scene, stored: StoredRun) -> FloatArray:
    """Return the covariance (3, 3) of the rate errors of motion, pulses and digitizer in a stored run."""
    return clock_covariance(scene, _parsed(stored.bench_name, stored.bench_toml))


@lru_cache(maxsize=4)
def _parsed(name: str, text: str) -> BenchFile:
    """Return the bench of a stored run; cached, because every shot and every gate needs it."""
    return parse_bench(name, text).bench


def prior_rate_error(scene: Scene, clocks: FloatArray | None, rate: TrackingRate | None) -> RateError:
    """Return the rate error that the clocks let expect, before the displacement is analysed.

    The rate error is the relative error of the motion's frequencies as timed by the pulses' clock. The value is its
    mean, the uncertainty its standard deviation. ``clocks`` (3, 3): covariance of the relative rate errors of the
    clocks of motion, pulses and digitizer, None if nothing is known of them. ``rate``: rate of the pulses measured with
    the digitizer's clock, None if it was not. A stated ``processing.frequency_accuracy`` replaces both.
    """
    stated = scene.processing.frequency_accuracy
    if stated is not None or clocks is None:
        return RateError(0.0, UNSTATED_FREQUENCY_ACCURACY if stated is None else stated)
    variance = float(MOTION_MINUS_PULSES @ clocks @ MOTION_MINUS_PULSES)
    if rate is None:
        return RateError(0.0, math.sqrt(variance))
    if differs_from_bench(clocks, rate):
        # Either of the two clocks may be wrong by the whole difference.
        clocks = clocks + rate.error**2 * np.diag([0.0, 1.0, 1.0])
        variance = float(MOTION_MINUS_PULSES @ clocks @ MOTION_MINUS_PULSES)
    # Condition on the measured pulse rate (Gaussian regression).
    rate_variance = _pulse_rate_variance(clocks, rate)
    covariance = float(MOTION_MINUS_PULSES @ clocks @ PULSES_MINUS_DIGITIZER)
    conditional_variance = max(variance - covariance**2 / rate_variance, 0.0)
    return RateError(covariance / rate_variance * rate.error, math.sqrt(conditional_variance))


def differs_from_bench(clocks: FloatArray, rate: TrackingRate) -> bool:
    """Return whether ``rate`` is off by more than the accuracies of train and digitizer, in ``clocks``, explain."""
    return rate.error**2 > SIGNIFICANT**2 * _pulse_rate_variance(clocks, rate)


def _pulse_rate_variance(clocks: FloatArray, rate: TrackingRate) -> float:
    """Return the expected variance of the pulse rate measured with the digitizer's clock, its noise included."""
    return float(PULSES_MINUS_DIGITIZER @ clocks @ PULSES_MINUS_DIGITIZER) + rate.uncertainty**2


def timed_motion(
    scene: Scene,
    shot: Shot,
    records: ShotRecords,
    motion: MotionFunction,
    clocks: FloatArray | None,
    beams: BeamWidths | None,
    control: ControlMotion | None = None,
) -> tuple[WindowMotion, TimeBase]:
    """Return the displacement of the selected pulses at corrected times, and the error of their time base.

    The times are those by the clock of the motion's frequencies: a rate error of the pulses' clock against it is
    estimated from the clocks and from the displacement, and removed. ``motion``: displacement from echoes. ``clocks``
    (3, 3): covariance of the rate errors of motion, pulses and digitizer; None if nothing is known of them.
    ``control``: motion without tonebursts, subtracted. Raises ``ValueError`` if the echoes have no displacement.
    """
    selection = select(scene, shot)
    window = window_motion(scene, shot, records, selection, motion)
    if control is not None:
        window = window.without(control.displacement_m(window.tracked.time_s))
    error = by_clocks = prior_rate_error(scene, clocks, records.tracking_rate)
    if scene.processing.drift == "linear":
        # A growing delay is the same motion as a rate error; the drift is far less limited and contains it.
        error = replace(by_clocks, uncertainty=0.0)
    # The coherent displacement has the least noise.
    if window.coherent is not None and error.uncertainty:
        prior = available_prior(scene, shot, beams)
        error = _narrowed(by_clocks, window.coherent, selection, scene.processing.background_order, prior)
    by_tonebursts = None if records.tonebursts is None else measured_error(records.tonebursts, by_clocks, error)
    error = by_tonebursts or error
    if error.value:
        coherent = None if window.coherent is None else with_rate_error(window.coherent, error.value)
        window = replace(window, tracked=with_rate_error(window.tracked, error.value), coherent=coherent)
    rate = records.tracking_rate
    differs = rate is not None and clocks is not None and differs_from_bench(clocks, rate)
    # The accuracies alone: ``by_clocks`` is wider if the pulses already differ from the digitizer.
    stated_u = prior_rate_error(scene, clocks, None).uncertainty
    bursts_differ = by_tonebursts is not None and abs(error.value) > SIGNIFICANT * math.hypot(
        stated_u, error.uncertainty
    )
    return window, TimeBase(error, by_clocks, rate, differs, by_tonebursts, bursts_differ)


def measured_error(tonebursts: ToneburstPhases, by_clocks: RateError, by_displacement: RateError) -> RateError | None:
    """Return the rate error that ``tonebursts`` at the second input measure; None if it is not certain.

    Their phases alone do not determine the whole carrier periods between tonebursts. ``by_clocks`` and
    ``by_displacement``, used as priors, select them. The result is None if neither prior does, if the two select
    different periods, or if the displacement contradicts the selection: accuracies may be wrong, and tissue that warms
    looks like a rate error. An uncertainty of 0 in ``by_displacement`` means that a drift contains the rate error: the
    displacement then neither selects nor contradicts.
    """
    selected = [error for prior in (by_clocks, by_displacement) if (error := tonebursts.rate_error(prior)) is not None]
    if not selected or abs(selected[0].value - selected[-1].value) > SIGNIFICANT * selected[0].uncertainty:
        return None
    differs = abs(selected[0].value - by_displacement.value) > SIGNIFICANT * by_displacement.uncertainty > 0
    # Without information in the displacement, ``by_displacement`` states the accuracies only.
    return None if differs and by_displacement != by_clocks else selected[0]


def _narrowed(
    by_clocks: RateError, motion: Motion, selection: Selection, background_order: int, prior: MediumPrior | None
) -> RateError:
    """Return the rate error that ``by_clocks`` and the displacement ``motion`` (pulse,) give together.

    If the fit with the ``prior`` of media fails, least squares replaces it; if that fails too, ``by_clocks`` is the
    result.
    """
    for fit_prior in dict.fromkeys((prior, None)):
        with suppress(ValueError):
            return estimate_rate_error(
                motion,
                selection.wanted_hz,
                by_clocks,
                also_hz=selection.driven_hz,
                background_order=background_order,
                prior=fit_prior,
            )
    return by_clocks


def _states_with_rate_errors(
    fitter: HarmonicFitter, motion: WindowMotion, time_base: TimeBase
) -> tuple[FloatArray, FloatArray]:
    """Return the fitted states (state,), m, one standard uncertainty of the rate error above and below its estimate.

    ``motion`` has the times of the estimated rate error.
    """
    u = time_base.by_pulses.uncertainty
    fast, slow = (fitter(with_rate_error(motion.tracked, error)) for error in (u, -u))
    return fast.state, slow.state


def state_influence_m(fitter: HarmonicFitter, motion: WindowMotion, time_base: TimeBase) -> FloatArray:
    """Return the change (state,) of the fitted states by one standard uncertainty of the rate error, m."""
    fast, slow = _states_with_rate_errors(fitter, motion, time_base)
    return np.asarray((fast - slow) / 2)


def phasor_influence_m(
    fitter: HarmonicFitter, motion: WindowMotion, time_base: TimeBase, delay_s: float
) -> ComplexArray | None:
    """Return the change of each wanted A exp(j phase) by one standard uncertainty of the rate error, m.

    The phase is stated at ``delay_s`` after the physical time zero, by the clock of the pulses. None if the rate error
    is certain.
    """
    if not time_base.is_uncertain:
        return None
    wanted_hz = np.array(fitter.wanted_hz)
    fast_m, slow_m = (
        state[: 2 * wanted_hz.size : 2] + 1j * state[1 : 2 * wanted_hz.size : 2]
        for state in _states_with_rate_errors(fitter, motion, time_base)
    )
    # The rate error also moves the stated time zero, which is delay_s (1 + e) by the clock of the motion's frequencies.
    # Both shifts of the phase may be large, so that they are combined before the difference is taken.
    shift = np.exp(2j * np.pi * wanted_hz * delay_s * time_base.by_pulses.uncertainty)
    return np.asarray((fast_m * shift - slow_m * shift.conj()) / 2)


def shot_fit(
    scene: Scene,
    shot: Shot,
    stored: StoredRun,
    estimator: str,
    beams: BeamWidths | None = None,
    control: ControlMotion | None = None,
) -> HarmonicFit:
    """Return amplitude and phase of one shot in the processing window, with the covariance between all harmonics.

    ``stored``: run with its records. ``control``: motion without tonebursts, which is subtracted. The covariances of
    the fit include those of the rate error and of the control. Raises ``ValueError`` if the shot cannot be estimated,
    or if all its records are clipped.
    """
    spec, selection = spec_of(estimator), select(scene, shot)
    clocks, records = clocks_of(scene, stored), read_shot(scene, shot, stored)
    motion, time_base = timed_motion(scene, shot, records, spec.motion, clocks, beams, control)
    if clipped_count(records, selection, motion) == motion.echoes.valid.sum():
        raise ValueError(ALL_CLIPPED)
    options = options_of(scene.processing, shot_prior(scene, shot, spec.name, beams))
    fitter = HarmonicFitter.of(selection, spec.name, options)
    if scene.processing.drift == "none":
        fit = fitter(motion.tracked)
    else:
        drift = shot_drift(motion, selection, replace(options, prior=available_prior(scene, shot, beams)))
        fit = with_drift_uncertainty(fitter(motion.without(drift.change_m(motion.tracked.time_s)).tracked), drift)
    if time_base.is_uncertain:
        influence_m = state_influence_m(fitter, motion, time_base)
        fit = with_state_error(fit, np.outer(influence_m, influence_m))
    return fit if control is None else control.with_error(fit)
