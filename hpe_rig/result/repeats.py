"""Mean over repeats: shots with the same settings, averaged and tested against their stated uncertainties.

Noise and trigger jitter are independent between repeats, so their contribution falls with the number of repeats. The
errors from speckle, sound speed, beams and bench are common to all repeats and do not fall.

    mean phasor         z = sum_k A_k exp(i phi_k) / K
    chi-square          X = sum_k (dA_k / u(A_k))² + (dphi_k / u(phi_k))²,  2 (K - 1) degrees of freedom
    u of the mean       u² = u_independent² / K + u_common²

u(A_k), u(phi_k) are the independent sources' uncertainties. If X is improbably large, the observed scatter replaces
the independent sources.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from statistics import fmean
from typing import TYPE_CHECKING, Any

from hpe_rig.result.interval import interval_95, phase_interval_95_rad, student_widening
from hpe_rig.result.phase import phase_variance_rad2, rectified_variance_m2
from hpe_rig.result.values import RECTIFIED, Estimate, ShotResult, earlier_headline

INDEPENDENT_SOURCES = ("noise", "trigger jitter", "control", "control scatter")
"""Sources that are independent between repeats; all others are common to them."""
DETECTED_AMPLITUDE = 4.0
"""Amplitude over its u above which the phase is not that of noise."""
SIGNIFICANCE = 0.01
"""Probability of the chi-square below which the repeats disagree with their uncertainties."""

REPEAT_SETTINGS = (
    "burst_length_s",
    "force_fraction",
    "pulse_rate_hz",
    "window_length_s",
    "lateral_offset_m",
    "axial_offset_m",
)
"""Settings that the repeats have in common, in addition to the values of a sweep."""

Pair = tuple[float, float]
"""Values for amplitude, m, and phase, rad."""
Source = tuple[float, float]
"""Standard uncertainty and degrees of freedom."""


@dataclass(frozen=True, slots=True)
class RepeatMean:
    """Mean of one frequency over the complete repeats of one setting.

    ``shots``: numbers of the repeats, from 1. ``amplitude_m`` and ``phase_rad`` are those of the mean phasor of the
    headline values (``corrected`` to the peak displacement if beams are declared), with combined standard
    uncertainties. ``amplitude_sd_m`` and ``phase_sd_rad`` are the standard deviations between the repeats.
    ``chi_square`` compares them with the independent components, over ``degrees_of_freedom``; ``probability`` is that
    of a larger value by chance. Below 1 % ``agrees`` is False, and the observed scatter replaces the uncertainties of
    the independent components. ``interval_95_m`` and ``interval_95_rad`` are the half widths of the 95 % intervals.
    """

    shots: tuple[int, ...]
    burst_length_s: float | None
    force_fraction: float | None
    pulse_rate_hz: float | None
    window_length_s: float | None
    frequency_hz: float
    corrected: bool
    amplitude_m: float
    amplitude_uncertainty_m: float
    phase_rad: float
    phase_uncertainty_rad: float
    amplitude_sd_m: float
    phase_sd_rad: float
    chi_square: float
    degrees_of_freedom: int
    probability: float
    agrees: bool
    true_amplitude_m: float | None = None
    true_phase_rad: float | None = None
    lateral_offset_m: float = 0.0
    axial_offset_m: float = 0.0
    interval_95_m: float = math.nan
    interval_95_rad: float = math.nan
    swept: Mapping[str, float] = field(default_factory=dict)

    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> RepeatMean:
            """Return the mean itself, with a warning, as the earlier attribute ``headline``."""
            return earlier_headline(self, name)


def repeat_means(shots: Sequence[ShotResult]) -> tuple[RepeatMean, ...]:
    """Return the mean of every frequency over each group of complete, trusted repeats of the same settings."""
    groups: dict[tuple[float | None, ...], list[ShotResult]] = {}
    for shot in shots:
        if shot.complete and not shot.untrusted:
            groups.setdefault(setting_of(shot), []).append(shot)
    return tuple(
        _repeat_mean(group, index)
        for group in groups.values()
        if len({shot.repeat for shot in group}) > 1
        for index in range(len(group[0].estimates))
    )


def setting_of(item: ShotResult | RepeatMean) -> tuple[float | None, ...]:
    """Return the values of all settings of a shot or mean; repeats have equal ones."""
    return *(getattr(item, name) for name in REPEAT_SETTINGS), *item.swept.values()


def _repeat_mean(shots: Sequence[ShotResult], index: int) -> RepeatMean:
    """Return the mean of the estimates number ``index`` of ``shots``."""
    from scipy.special import gammaincc

    estimates = [shot.estimates[index] for shot in shots]
    # Complex mean: amplitudes alone would average the noise of a weak harmonic to a positive value.
    phasor = _mean_phasor((item.amplitude_m, item.phase_rad) for item in estimates)
    deviations = _deviations(estimates, phasor)
    independent = [_uncertainty(estimate, independent=True) for estimate in estimates]
    chi_square, degrees_of_freedom = _chi_square(deviations, independent, estimates), 2 * (len(shots) - 1)
    probability = float(gammaincc(degrees_of_freedom / 2, chi_square / 2))
    agrees = probability >= SIGNIFICANCE
    sources = _sources_of_mean(estimates, independent, None if agrees else deviations, abs(phasor))
    truth = _mean_truth(estimates)
    settings: dict[str, Any] = {name: getattr(shots[0], name) for name in REPEAT_SETTINGS}
    return RepeatMean(
        **settings,
        swept=shots[0].swept,
        shots=tuple(shot.shot for shot in shots),
        frequency_hz=estimates[0].frequency_hz,
        corrected=all(item.corrected for item in estimates),
        amplitude_m=abs(phasor),
        amplitude_uncertainty_m=math.hypot(*(u_m for u_m, _ in sources[0])),
        phase_rad=cmath.phase(phasor),
        phase_uncertainty_rad=math.hypot(*(u_rad for u_rad, _ in sources[1])),
        interval_95_m=interval_95(sources[0]),
        interval_95_rad=phase_interval_95_rad(sources[1]),
        amplitude_sd_m=_standard_deviation(deviations[0]),
        phase_sd_rad=_standard_deviation(deviations[1]),
        chi_square=chi_square,
        degrees_of_freedom=degrees_of_freedom,
        probability=probability,
        agrees=agrees,
        true_amplitude_m=None if truth is None else abs(truth),
        true_phase_rad=None if truth is None else cmath.phase(truth),
    )


def _mean_truth(estimates: Sequence[Estimate]) -> complex | None:
    """Return the mean of the true phasors, which may differ between repeats; None if one is unknown."""
    if any(estimate.true_amplitude_m is None for estimate in estimates):
        return None
    return _mean_phasor((item.true_amplitude_m or 0.0, item.true_phase_rad or 0.0) for item in estimates)


def _mean_phasor(values: Iterable[Pair]) -> complex:
    phasors = [cmath.rect(amplitude_m, phase_rad) for amplitude_m, phase_rad in values]
    return sum(phasors) / len(phasors)


def _deviations(estimates: Sequence[Estimate], phasor: complex) -> tuple[list[float], list[float]]:
    """Return the deviations (repeat,) of amplitudes, m, and of phases, rad, from their means."""
    mean_m = sum(item.amplitude_m for item in estimates) / len(estimates)
    # Phases relative to that of the mean phasor do not wrap.
    relative = [math.remainder(item.phase_rad - cmath.phase(phasor), 2 * math.pi) for item in estimates]
    mean_rad = sum(relative) / len(relative)
    return [item.amplitude_m - mean_m for item in estimates], [angle - mean_rad for angle in relative]


def _chi_square(
    deviations: tuple[list[float], list[float]], independent: Sequence[Pair], estimates: Sequence[Estimate]
) -> float:
    """Return X of the deviations of amplitudes and phases."""
    # The uncertainties are estimates too: the widening allows for their degrees of freedom.
    return sum(
        _squared_ratio(deviation, stated[axis] * student_widening(estimate.noise_freedom))
        for axis, of_axis in enumerate(deviations)
        for deviation, stated, estimate in zip(of_axis, independent, estimates, strict=True)
    )


def _sources_of_mean(
    estimates: Sequence[Estimate],
    independent: Sequence[Pair],
    deviations: tuple[list[float], list[float]] | None,
    amplitude_m: float,
) -> tuple[list[Source], list[Source]]:
    """Return (uncertainty, degrees of freedom) of the independent and the common source, of amplitude and phase.

    ``deviations`` of repeats that disagree replace smaller stated uncertainties; None for repeats that agree.
    """
    count = len(estimates)
    stated = _independent_uncertainty(estimates, independent, amplitude_m)
    common = [_uncertainty(estimate, independent=False) for estimate in estimates]
    pooled = sum(estimate.noise_freedom for estimate in estimates)

    def sources(axis: int) -> list[Source]:
        source = stated[axis], pooled
        # Scatter beyond the stated uncertainties has a cause that no component lists: the scatter then replaces them.
        if deviations and (scatter := _standard_deviation(deviations[axis]) / math.sqrt(count)) > stated[axis]:
            source = scatter, count - 1.0
        # Common errors are fully correlated between the repeats, so that their standard uncertainties are averaged.
        return [source, (sum(u[axis] for u in common) / count, math.inf)]

    return sources(0), sources(1)


def _independent_uncertainty(estimates: Sequence[Estimate], independent: Sequence[Pair], amplitude_m: float) -> Pair:
    """Return the independent uncertainty of the mean amplitude, m, and phase, rad."""
    # The mean of K independent values has the root mean square of their uncertainties over the root of K.
    u_m, u_rad = (math.sqrt(fmean(u[axis] ** 2 for u in independent)) / math.sqrt(len(independent)) for axis in (0, 1))
    pairs = zip(estimates, independent, strict=True)
    if all(estimate.amplitude_m > DETECTED_AMPLITUDE * u[0] for estimate, u in pairs):
        return u_m, u_rad
    # Phases of single repeats that may be noise hold little information: the mean phasor determines the phase.
    rectified_m = math.sqrt(rectified_variance_m2(amplitude_m, u_m**2, u_m**2))
    return math.hypot(u_m, rectified_m), math.sqrt(phase_variance_rad2(amplitude_m, u_m**2, u_m**2))


def _uncertainty(estimate: Estimate, independent: bool) -> Pair:
    """Return u of amplitude, m, and phase, rad, from the components that are independent between repeats, or common."""
    components = [
        component
        for component in estimate.budget
        if component.source != RECTIFIED and (component.source in INDEPENDENT_SOURCES) is independent
    ]
    return math.hypot(*(item.amplitude_m for item in components)), math.hypot(*(item.phase_rad for item in components))


def _squared_ratio(deviation: float, uncertainty: float) -> float:
    if uncertainty > 0:
        return (deviation / uncertainty) ** 2
    return 0.0 if deviation == 0 else math.inf


def _standard_deviation(deviations: Sequence[float]) -> float:
    return math.hypot(*deviations) / math.sqrt(len(deviations) - 1)
