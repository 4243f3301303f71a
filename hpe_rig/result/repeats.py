"""Mean over repeats: shots that share every setting, taken together and tested against their stated uncertainties.

Noise and trigger jitter differ from repeat to repeat; speckle, sound speed and what else a place and a bench have are
the same in each, so that no number of repeats makes them less.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from statistics import fmean

from hpe_rig.result.interval import (
    NORMAL,
    by_residual,
    combined_kurtosis,
    half_widths,
    phase_half_widths,
    phase_kurtosis,
    residual_kurtosis,
)
from hpe_rig.result.phase import phase_variance_rad2, rectified_variance_m2
from hpe_rig.result.values import RECTIFIED, Estimate, Headline, ShotResult

INDEPENDENT = ("noise", "trigger jitter")
"""Components that are drawn anew in every repeat; all others are common to them, but what noise has of its own."""
OUT_OF_NOISE = 4.0
"""Amplitude over its u from which on no phase is that of noise."""
DISAGREE = 0.01
"""Probability of as large a chi-square by chance below which the repeats disagree with their uncertainties."""


@dataclass(frozen=True, slots=True)
class RepeatMean:
    """Mean of one frequency over the complete repeats of one setting.

    ``amplitude_m`` and ``phase_rad`` are those of the mean phasor of the headline values (``corrected`` to the peak
    displacement where beams are known), with combined standard uncertainties. ``amplitude_sd_m`` and ``phase_sd_rad``
    are the standard deviations found between the repeats; ``chi_square`` compares them, both together, with what the
    independent components state, over ``degrees_of_freedom``; as large a one comes by chance with ``probability``.
    Where that is below 1 %, ``agrees`` is False and the uncertainties are enlarged to the scatter found. The kurtoses
    are those of the errors; ``interval_95_m`` says how far to either side of the mean the truth lies with 95 %, the
    others alike.
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
    amplitude_kurtosis: float = NORMAL
    phase_kurtosis: float = NORMAL
    interval_68_m: float = math.nan
    interval_95_m: float = math.nan
    interval_68_rad: float = math.nan
    interval_95_rad: float = math.nan
    swept: Mapping[str, float] = field(default_factory=dict)


def repeat_means(shots: Sequence[ShotResult]) -> tuple[RepeatMean, ...]:
    """Return the mean of every frequency over each group of complete, trusted repeats of the same settings."""
    groups: dict[tuple[float | None, ...], list[ShotResult]] = {}
    for shot in shots:
        if shot.complete and not shot.untrusted:
            groups.setdefault(_setting(shot), []).append(shot)
    return tuple(
        _mean(group, index)
        for group in groups.values()
        if len({shot.repeat for shot in group}) > 1
        for index in range(len(group[0].estimates))
    )


def _setting(shot: ShotResult) -> tuple[float | None, ...]:
    place = shot.lateral_offset_m, shot.axial_offset_m
    own = shot.burst_length_s, shot.force_fraction, shot.pulse_rate_hz, shot.window_length_s
    return *own, *place, *shot.swept.values()


def _mean(shots: Sequence[ShotResult], index: int) -> RepeatMean:
    from scipy.special import gammaincc

    estimates = [shot.estimates[index] for shot in shots]
    each = [item.headline for item in estimates]
    count, freedom = len(each), 2 * (len(each) - 1)
    mean = sum(cmath.rect(item.amplitude_m, item.phase_rad) for item in each) / count
    along_m, turned_rad = _deviations(each, mean)
    independent = [_parts(item, independent=True) for item in estimates]
    chi_square = sum(
        _squared_ratio(deviation, stated[axis])
        for axis, deviations in enumerate((along_m, turned_rad))
        for deviation, stated in zip(deviations, independent, strict=True)
    )
    probability = float(gammaincc(freedom / 2, chi_square / 2))
    agrees = probability >= DISAGREE
    common = [_parts(item, independent=False) for item in estimates]
    together = sum(item.noise_freedom for item in estimates)
    stated = _of_the_mean(each, _with_freedom(estimates, independent, together), abs(mean))
    own_m, own_rad = (
        # Scatter beyond what is stated has a cause that nobody listed: then what was found counts.
        max(stated[axis], 0.0 if agrees else _spread(deviations) / math.sqrt(count))
        for axis, deviations in enumerate((along_m, turned_rad))
    )
    u_m, u_rad = (
        math.hypot(own, sum(part[axis] for part in common) / count) for axis, own in enumerate((own_m, own_rad))
    )
    kurtosis_m, kurtosis_rad = _kurtoses(estimates, (u_m, u_rad), (own_m, own_rad), residual_kurtosis(together))
    (narrow_m, wide_m), (narrow_rad, wide_rad) = half_widths(u_m, kurtosis_m), phase_half_widths(u_rad, kurtosis_rad)
    known = all(item.true_amplitude_m is not None for item in estimates)
    truth = sum(cmath.rect(i.true_amplitude_m or 0.0, i.true_phase_rad or 0.0) for i in estimates) / count
    first = shots[0]
    return RepeatMean(
        shots=tuple(shot.shot for shot in shots),
        burst_length_s=first.burst_length_s,
        force_fraction=first.force_fraction,
        pulse_rate_hz=first.pulse_rate_hz,
        window_length_s=first.window_length_s,
        swept=first.swept,
        lateral_offset_m=first.lateral_offset_m,
        axial_offset_m=first.axial_offset_m,
        frequency_hz=estimates[0].frequency_hz,
        corrected=all(item.corrected for item in each),
        amplitude_m=abs(mean),
        amplitude_uncertainty_m=u_m,
        phase_rad=cmath.phase(mean),
        phase_uncertainty_rad=u_rad,
        amplitude_kurtosis=kurtosis_m,
        phase_kurtosis=kurtosis_rad,
        interval_68_m=narrow_m,
        interval_95_m=wide_m,
        interval_68_rad=narrow_rad,
        interval_95_rad=wide_rad,
        amplitude_sd_m=_spread(along_m),
        phase_sd_rad=_spread(turned_rad),
        chi_square=chi_square,
        degrees_of_freedom=freedom,
        probability=probability,
        agrees=agrees,
        true_amplitude_m=abs(truth) if known else None,
        true_phase_rad=cmath.phase(truth) if known else None,
    )


def _deviations(each: Sequence[Headline], mean: complex) -> tuple[list[float], list[float]]:
    """Return by how much each amplitude, m, and phase, rad, differs from the mean amplitude and the mean's phase."""
    middle_m = sum(item.amplitude_m for item in each) / len(each)
    turned = [math.remainder(item.phase_rad - cmath.phase(mean), 2 * math.pi) for item in each]
    middle_rad = sum(turned) / len(turned)
    return [item.amplitude_m - middle_m for item in each], [angle - middle_rad for angle in turned]


def _of_the_mean(
    each: Sequence[Headline], parts: Sequence[tuple[float, float]], amplitude_m: float
) -> tuple[float, float]:
    """Return what independent ``parts`` of u of amplitude and phase leave of the mean phasor's, m and rad."""
    u_m, u_rad = (_root_mean_square(part[axis] for part in parts) / math.sqrt(len(parts)) for axis in (0, 1))
    if all(item.amplitude_m > OUT_OF_NOISE * part[0] for item, part in zip(each, parts, strict=True)):
        return u_m, u_rad
    # Phases of amplitudes that may be noise say little each, and their mean nothing that the mean phasor does not.
    rectified_m = math.sqrt(rectified_variance_m2(amplitude_m, u_m**2, u_m**2))
    return math.hypot(u_m, rectified_m), math.sqrt(phase_variance_rad2(amplitude_m, u_m**2, u_m**2))


def _with_freedom(
    estimates: Sequence[Estimate], parts: Sequence[tuple[float, float]], freedom: float
) -> list[tuple[float, float]]:
    """Return the independent ``parts`` of u as they are where all repeats together, ``freedom``, tell their noise."""
    factors = [math.sqrt(by_residual(freedom) / by_residual(item.noise_freedom)) for item in estimates]
    return [(u_m * factor, u_rad * factor) for (u_m, u_rad), factor in zip(parts, factors, strict=True)]


def _parts(estimate: Estimate, independent: bool) -> tuple[float, float]:
    """Return u of amplitude, m, and phase, rad, from the components that are independent between repeats, or not."""
    listed = [each for each in estimate.budget if each.source != RECTIFIED]
    parts = [each for each in listed if (each.source in INDEPENDENT) is independent]
    return math.hypot(*(each.amplitude_m for each in parts)), math.hypot(*(each.phase_rad for each in parts))


def _kurtoses(
    estimates: Sequence[Estimate], u: tuple[float, float], own: tuple[float, float], few: float
) -> tuple[float, float]:
    """Return the kurtoses of the mean's errors of amplitude and phase, of uncertainties ``u``.

    What is common to all repeats has its kurtosis; what is the mean's ``own`` that of ``few`` degrees of freedom, or of
    a phase that may be noise.
    """
    budgets = [[each for each in item.budget if each.source not in INDEPENDENT] for item in estimates]
    unknown = phase_kurtosis(own[1] ** 2)
    noise_m, noise_rad = (own[0], few), (own[1], unknown if unknown < NORMAL else few)
    along = [
        combined_kurtosis(u[0], [noise_m, *((each.amplitude_m, each.amplitude_kurtosis) for each in common)])
        for common in budgets
    ]
    turned = [
        combined_kurtosis(u[1], [noise_rad, *((each.phase_rad, each.phase_kurtosis) for each in common)])
        for common in budgets
    ]
    return fmean(along), fmean(turned)


def _squared_ratio(deviation: float, stated: float) -> float:
    if stated > 0:
        return (deviation / stated) ** 2
    return 0.0 if deviation == 0 else math.inf


def _root_mean_square(values: Iterable[float]) -> float:
    return math.sqrt(fmean(value**2 for value in values))


def _spread(deviations: Sequence[float]) -> float:
    return math.hypot(*deviations) / math.sqrt(len(deviations) - 1)
