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

from hpe_rig.result.interval import interval_95, phase_interval_95_rad, student_widening
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
    Where that is below 1 %, ``agrees`` is False and the uncertainties are enlarged to the scatter found.
    ``interval_95_m`` and ``interval_95_rad`` are the half widths of the 95 % intervals.
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
        _squared_ratio(deviation, stated[axis] * student_widening(item.noise_freedom))
        for axis, deviations in enumerate((along_m, turned_rad))
        for deviation, stated, item in zip(deviations, independent, estimates, strict=True)
    )
    probability = float(gammaincc(freedom / 2, chi_square / 2))
    agrees = probability >= DISAGREE
    common = [_parts(item, independent=False) for item in estimates]
    stated = _of_the_mean(each, independent, abs(mean))
    scatter = [_spread(deviations) / math.sqrt(count) for deviations in (along_m, turned_rad)]
    # Scatter beyond the stated uncertainties has a cause that no component lists: the scatter then replaces them.
    pooled = sum(item.noise_freedom for item in estimates)
    independent_sources = [
        (scatter[axis], count - 1.0) if not agrees and scatter[axis] > stated[axis] else (stated[axis], pooled)
        for axis in (0, 1)
    ]
    # Common errors are fully correlated between the repeats, so that their standard uncertainties are averaged.
    shared = [sum(part[axis] for part in common) / count for axis in (0, 1)]
    sources_m, sources_rad = ([independent_sources[axis], (shared[axis], math.inf)] for axis in (0, 1))
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
        amplitude_uncertainty_m=math.hypot(*(u_m for u_m, _ in sources_m)),
        phase_rad=cmath.phase(mean),
        phase_uncertainty_rad=math.hypot(*(u_rad for u_rad, _ in sources_rad)),
        interval_95_m=interval_95(sources_m),
        interval_95_rad=phase_interval_95_rad(sources_rad),
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


def _parts(estimate: Estimate, independent: bool) -> tuple[float, float]:
    """Return u of amplitude, m, and phase, rad, from the components that are independent between repeats, or not."""
    listed = [each for each in estimate.budget if each.source != RECTIFIED]
    parts = [each for each in listed if (each.source in INDEPENDENT) is independent]
    return math.hypot(*(each.amplitude_m for each in parts)), math.hypot(*(each.phase_rad for each in parts))


def _squared_ratio(deviation: float, stated: float) -> float:
    if stated > 0:
        return (deviation / stated) ** 2
    return 0.0 if deviation == 0 else math.inf


def _root_mean_square(values: Iterable[float]) -> float:
    return math.sqrt(fmean(value**2 for value in values))


def _spread(deviations: Sequence[float]) -> float:
    return math.hypot(*deviations) / math.sqrt(len(deviations) - 1)
