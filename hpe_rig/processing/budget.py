"""Uncertainty budget of an estimate: one standard uncertainty for each independent source of error.

    u² = sum_i u_i²        for amplitude and phase (GUM, 5.1.2)

Every u_i is that of the value corrected to the peak displacement. docs/explanation/numbers.md describes the sources.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hpe_rig.arrays import ComplexArray, FloatArray
from hpe_rig.bench import twin_of
from hpe_rig.plan import PhaseReference
from hpe_rig.processing.control import ControlMotion
from hpe_rig.processing.harmonics.harmonic_fit import HarmonicFit, polar_covariance
from hpe_rig.result import PHASE_VARIANCE_LIMIT, RECTIFIED, Averaging, Component, Estimate
from hpe_rig.scene import Scene

NO_AVERAGING = Averaging(1.0, 0.0, 0.0)
"""Averaging if no beams are declared: the tracked displacement is not corrected."""
SPECKLE_KURTOSIS = 6.0
"""Kurtosis of the speckle error: fully developed speckle, gate of 1 mm (docs/explanation/prediction.md)."""


@dataclass(frozen=True, slots=True)
class ErrorSources:
    """Error sources that the fit does not contain.

    ``sound_speed_uncertainty``: relative; without a statement that of a scene's default. ``trigger_jitter_s``: root
    mean square; 0 if unknown, the residual then contains it as noise. ``subtracts_jitter``: the motion of a reference
    gate has been subtracted, and trigger jitter with it. ``gate_edge``: relative amplitude error from the ends of the
    gate. ``quantisation_m``: for each frequency along and across its phasor; empty if noise dithers the codes.
    ``carrier_relative``: difference of the echo's mean frequency from the carrier, for estimators that divide by the
    carrier, unless the averaging predicts it. ``control``: motion without tonebursts, already subtracted.
    ``time_base_m`` (frequency,): change of each phasor by one standard uncertainty of the rate error, its effect on the
    stated time zero included, with ``time_base_freedom`` degrees of freedom; None for one common clock.
    ``time_base_clock_fraction``: part of its variance that is common to all shots.
    """

    sound_speed_m_per_s: float = 1540.0
    sound_speed_uncertainty: float = 0.005
    trigger_jitter_s: float = 0.0
    subtracts_jitter: bool = False
    gate_edge: float = 0.0
    quantisation_m: tuple[tuple[float, float], ...] = ()
    carrier_relative: float = 0.0
    control: ControlMotion | None = None
    time_base_m: ComplexArray | None = None
    time_base_freedom: float = math.inf
    time_base_clock_fraction: float = 1.0

    @property
    def rounding_m(self) -> float:
        """Largest standard uncertainty of a harmonic from rounding to codes; 0 if noise dithers the codes."""
        return float(np.max(self.quantisation_m, initial=0.0))

    @property
    def jitter_m(self) -> float:
        """Displacement noise of one pulse from trigger jitter, c t / 2."""
        return 0.0 if self.subtracts_jitter else self.sound_speed_m_per_s * self.trigger_jitter_s / 2


def error_sources_of(scene: Scene, simulated: bool) -> ErrorSources:
    """Return the error sources that ``scene`` gives: sound speed and, on the twin only, trigger jitter."""
    twin = twin_of(scene) if simulated else None
    return ErrorSources(
        sound_speed_m_per_s=scene.acquisition.sound_speed_m_per_s,
        sound_speed_uncertainty=scene.acquisition.sound_speed_uncertainty,
        trigger_jitter_s=0.0 if twin is None else twin.settings.instruments.trigger_jitter_s,
    )


def estimates_of(
    fit: HarmonicFit,
    sources: ErrorSources | None = None,
    averaging: Sequence[Averaging | None] | None = None,
    true_m: FloatArray | None = None,
    reference: PhaseReference | None = None,
    true_reference: PhaseReference | None = None,
) -> tuple[Estimate, ...]:
    """Return amplitude and phase of every frequency of one ``fit``, each with its uncertainty budget.

    ``averaging`` (frequency,): predicted ratio of tracked to peak displacement, None if unknown. ``true_m`` (frequency,
    2): ground truth, A cos(phase) and A sin(phase), NaN or None if unknown. Phases in ``fit`` and ``true_m`` count from
    the physical time zero. Those of the estimates count from the time zero of ``reference``, true ones from that of
    ``true_reference``, by the clock of the motion's frequencies; without a reference from the physical time zero.
    """
    count = fit.frequency_hz.size
    averagings = averaging if averaging is not None else (None,) * count
    estimates = (_estimate(fit, index, sources or ErrorSources(), averagings[index], true_m) for index in range(count))
    stated, true = reference or PhaseReference(), true_reference or reference or PhaseReference()
    return tuple(_with_phases_from(stated, true, estimate) for estimate in estimates)


def _with_phases_from(reference: PhaseReference, true_reference: PhaseReference, estimate: Estimate) -> Estimate:
    """Return ``estimate`` with its measured phase from ``reference`` and its true one from ``true_reference``."""
    frequency_hz, true_rad = estimate.frequency_hz, estimate.true_phase_rad
    return replace(
        estimate,
        tracked_phase_rad=reference.stated_rad(estimate.tracked_phase_rad, frequency_hz),
        true_phase_rad=None if true_rad is None else true_reference.stated_rad(true_rad, frequency_hz),
    )


def _estimate(
    fit: HarmonicFit, index: int, sources: ErrorSources, averaging: Averaging | None, true_m: FloatArray | None
) -> Estimate:
    """Return amplitude, phase and budget of frequency ``index`` of ``fit``; phases count from the physical time zero.

    ``sources``: error sources outside the fit. ``averaging``: tracked over peak displacement, None if unknown.
    ``true_m`` (frequency, 2): ground truth, A cos(phase) and A sin(phase).
    """
    # The tracked amplitude is that of ``fit``. The peak displacement is corrected for beam averaging and for the
    # expected aliasing: its budget is that of ``best``.
    best = fit if averaging is None or fit.aliasing_corrected is None else fit.aliasing_corrected
    tracked_m, best_m = float(fit.amplitude_m[index]), float(best.amplitude_m[index])
    has_truth = true_m is not None and bool(np.isfinite(true_m[index]).all())
    in_phase_m, quadrature_m = true_m[index] if true_m is not None and has_truth else (0.0, 0.0)
    return Estimate(
        frequency_hz=float(fit.frequency_hz[index]),
        tracked_amplitude_m=tracked_m,
        tracked_amplitude_uncertainty_m=math.sqrt(fit.covariance[index, 0, 0]),
        tracked_phase_rad=float(fit.phase_rad[index]),
        tracked_phase_uncertainty_rad=math.sqrt(fit.covariance[index, 1, 1]),
        averaging_factor=None if averaging is None else averaging.factor,
        speckle_relative=None if averaging is None else averaging.speckle_relative,
        true_amplitude_m=math.hypot(in_phase_m, quadrature_m) if has_truth else None,
        true_phase_rad=math.atan2(quadrature_m, in_phase_m) if has_truth else None,
        averaging_phase_rad=None if averaging is None else averaging.phase_rad,
        components=components(best, index, sources, averaging or NO_AVERAGING),
        aliasing_factor=tracked_m / best_m if tracked_m and best_m else 1.0,
        aliasing_phase_rad=math.remainder(float(fit.phase_rad[index] - best.phase_rad[index]), 2 * math.pi),
        noise_freedom=float(best.quality.degrees_of_freedom),
    )


def components(fit: HarmonicFit, index: int, sources: ErrorSources, averaging: Averaging) -> tuple[Component, ...]:
    """Return the standard uncertainties of frequency ``index`` of ``fit``, source by source (GUM: uncertainty budget).

    They are those of the peak displacement: the tracked displacement over ``averaging.factor``, which is tracked over
    peak.
    """
    amplitude_m = float(fit.amplitude_m[index])
    peak_m = amplitude_m / averaging.factor
    # All arrays of two hold (amplitude, phase). ``to_metres`` converts relative amplitudes and leaves phases.
    to_metres = np.array([amplitude_m, 1.0])
    aliasing = np.zeros(2) if fit.aliasing is None else np.diagonal(fit.aliasing[index])
    averaging_u = np.array([averaging.factor_uncertainty / averaging.factor, averaging.phase_uncertainty_rad])
    averaging_u = averaging_u * to_metres
    covariance = np.array([averaging.shared_relative, averaging.shared_phase_rad2]) * to_metres**2
    rounding_m = sources.quantisation_m[index] if sources.quantisation_m else (0.0, 0.0)
    # The error across the phasor over the amplitude is the phase error. It is at most that of an unknown phase.
    rounding = np.array(rounding_m) / (1.0, max(amplitude_m, np.finfo(np.float64).tiny))
    rounding_variance = np.minimum(rounding, (np.inf, math.sqrt(PHASE_VARIANCE_LIMIT))) ** 2
    carrier_relative = averaging.carrier_relative or sources.carrier_relative
    drift = np.zeros(2) if fit.drift_m2 is None else np.diagonal(polar_covariance(fit.drift_m2, fit)[index])
    noise = _noise_components(fit, index, sources, averaging, aliasing + drift)
    # Aliasing and beam averaging both depend on the medium, so that their errors have a covariance.
    aliasing, averaging_variance = _with_covariance(aliasing, averaging_u**2, covariance)
    optional = (("carrier", carrier_relative), ("beam shape", averaging.shape_relative))
    return (
        *noise,
        *_control_components(sources.control, index, amplitude_m, averaging),
        _from_tracked_variance("quantisation", rounding_variance, averaging),
        _from_tracked_variance("aliasing", aliasing, averaging),
        Component("speckle", averaging.speckle_relative * peak_m, averaging.speckle_phase_rad),
        _from_tracked_variance("beam averaging", averaging_variance, averaging),
        Component("gate edge", sources.gate_edge * peak_m, 0.0),
        Component("sound speed", sources.sound_speed_uncertainty * peak_m, 0.0),
        Component("gate off focus", averaging.offset_relative * peak_m, 0.0),
        *(Component(source, relative * peak_m, 0.0) for source, relative in optional if relative),
        *((_from_tracked_variance("drift", drift, averaging),) if drift.any() else ()),
        *_time_base_components(fit, index, sources, averaging),
    )


def _control_components(
    control: ControlMotion | None, index: int, amplitude_m: float, averaging: Averaging
) -> Iterator[Component]:
    """Yield the uncertainties from subtracting a control: its noise, and how much controls differ beyond their noise.

    ``amplitude_m``: tracked amplitude of the shot at frequency ``index``.
    """
    if control is None:
        return
    for source, variance_m2, freedom in (
        ("control", control.noise_m2[index], float(control.fit.quality.degrees_of_freedom)),
        ("control scatter", control.scatter_m2[index], control.scatter_freedom),
    ):
        phase_variance = min(variance_m2 / max(amplitude_m**2, np.finfo(np.float64).tiny), PHASE_VARIANCE_LIMIT)
        yield _from_tracked_variance(source, np.array([variance_m2, phase_variance]), averaging, freedom)


def _time_base_components(
    fit: HarmonicFit, index: int, sources: ErrorSources, averaging: Averaging
) -> tuple[Component, ...]:
    """Return the uncertainty of frequency ``index`` of ``fit`` from the clocks' rate error; empty for one clock.

    ``sources.time_base_m``: change of the complex displacement by one standard uncertainty of the rate error.
    """
    if sources.time_base_m is None:
        return ()
    # Rotated to the phasor: the real part changes the amplitude, the imaginary part over the amplitude is the phase.
    change_m = complex(sources.time_base_m[index]) * np.exp(-1j * float(fit.phase_rad[index]))
    phase_error_rad = abs(change_m.imag) / max(float(fit.amplitude_m[index]), np.finfo(np.float64).tiny)
    variance = np.array([change_m.real**2, min(phase_error_rad**2, PHASE_VARIANCE_LIMIT)])
    return (_from_tracked_variance("time base", variance, averaging, sources.time_base_freedom),)


def with_first_pulse(
    estimates: Sequence[Estimate], alternatives: Sequence[Sequence[Estimate]], late_part_s: float
) -> tuple[Estimate, ...]:
    """Return ``estimates`` with the uncertainty of the times of all pulses, if it is unknown which pulse came first.

    ``alternatives``: the estimates for every other possible first pulse; all are equally likely. ``late_part_s``:
    largest additional delay if triggers were lost within the shot, which delays only the later pulses.
    """
    return tuple(
        replace(estimate, components=(*estimate.budget, _first_pulse(estimate, of_frequency, late_part_s)))
        for estimate, *of_frequency in zip(estimates, *alternatives, strict=True)
    )


def _first_pulse(estimate: Estimate, alternatives: Sequence[Estimate], late_part_s: float) -> Component:
    """Return the uncertainty component of an unknown first pulse: how amplitude and phase depend on it.

    Root mean square deviations of the ``alternatives``, the estimate itself included. If only a later part of the
    pulses comes ``late_part_s`` later, the parts of the motion differ in phase and partly cancel.
    """
    root_count = math.sqrt(len(alternatives) + 1)
    change_m = math.hypot(*(item.amplitude_m - estimate.amplitude_m for item in alternatives)) / root_count
    # Differences of phase beyond half a turn count as the smaller angle on the other side.
    changes_rad = (math.remainder(item.phase_rad - estimate.phase_rad, 2 * math.pi) for item in alternatives)
    change_rad = math.hypot(*changes_rad) / root_count
    # Two parts of equal length, apart by an angle, have a sum shorter by the cosine of half the angle.
    apart_rad = min(2 * math.pi * estimate.frequency_hz * late_part_s, math.pi)
    loss_m = estimate.amplitude_m * (1 - math.cos(apart_rad / 2))
    return Component("first pulse", math.hypot(change_m, loss_m), min(change_rad, math.sqrt(PHASE_VARIANCE_LIMIT)))


def _noise_components(
    fit: HarmonicFit, index: int, sources: ErrorSources, averaging: Averaging, model_error: FloatArray
) -> tuple[Component, ...]:
    """Return the uncertainties that the scatter of the pulses contains: noise, trigger jitter and Rician bias.

    ``model_error`` (2,): variances of amplitude and phase in the covariance of ``fit`` that are not noise. The Rician
    bias is the amplitude that noise alone would have. Jitter and noise share the remaining variance in proportion to
    their variances for one pulse.
    """
    random = np.maximum(np.diagonal(fit.covariance[index]) - model_error, 0.0)
    residual_m2 = float(fit.quality.residual_rms_m) ** 2
    jitter_fraction = min(sources.jitter_m**2 / residual_m2, 1.0) if residual_m2 > 0 else 0.0
    # Jitter is known from elsewhere (type B); noise is the remaining variance of the residual. With these degrees of
    # freedom of noise, both together have those of the residual (Welch-Satterthwaite).
    nu = float(fit.quality.degrees_of_freedom)
    noise_nu, jitter_nu = (nu * (1 - jitter_fraction) ** 2, math.inf) if jitter_fraction < 1 else (nu, nu)
    return (
        _from_tracked_variance("noise", random * (1 - jitter_fraction), averaging, noise_nu),
        _from_tracked_variance("trigger jitter", random * jitter_fraction, averaging, jitter_nu),
        Component(
            source=RECTIFIED,
            amplitude_m=math.sqrt(fit.rician_bias_m2[index]) / averaging.factor,
            phase_rad=0.0,
            degrees_of_freedom=nu,
        ),
    )


def _from_tracked_variance(
    source: str, variance: FloatArray, averaging: Averaging, degrees_of_freedom: float = math.inf
) -> Component:
    """Return the budget's component of an error of the tracked displacement, from its ``variance`` (2,).

    The variance is that of (amplitude, phase). Division by the averaging factor converts it to peak displacement.
    """
    u_m, u_rad = np.sqrt(variance).tolist()
    return Component(
        source=source, amplitude_m=u_m / averaging.factor, phase_rad=u_rad, degrees_of_freedom=degrees_of_freedom
    )


def with_second_order_speckle(averaging: Averaging) -> Averaging:
    """Return ``averaging`` with the second-order effect of speckle on the amplitude added to ``speckle_relative``.

    The tracked phasor is (1 + x + j t) times its mean. A relative error t across it also raises the amplitude by t²/2.
    Its root mean square is sqrt(k) u² / 2, with u the standard deviation and k the kurtosis of t. Both orders are
    added as independent errors.
    """
    second_order = math.sqrt(SPECKLE_KURTOSIS) / 2 * averaging.speckle_phase_rad**2
    return replace(averaging, speckle_relative=math.hypot(averaging.speckle_relative, second_order))


def _with_covariance(
    aliasing: FloatArray, averaging: FloatArray, covariance: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the variances of aliasing and beam averaging, adjusted so that their sum includes twice their covariance.

    Neither is negative: twice the covariance is added to beam averaging, and what would make that negative is taken
    from aliasing. All arrays are (amplitude, phase).
    """
    # The covariance is at most the product of the standard deviations (Cauchy-Schwarz).
    limit = np.sqrt(aliasing * averaging)
    combined = averaging + 2 * np.clip(covariance, -limit, limit)
    return aliasing + np.minimum(combined, 0.0), np.maximum(combined, 0.0)
