"""Sentence that a result leads with: amplitude and phase with uncertainties, of what, and whether it is simulated."""

from __future__ import annotations

import math
from collections.abc import Sequence

from hpe_rig.result.repeats import RepeatMean
from hpe_rig.result.values import Estimate, Headline, Result, ShotResult

UNITS = ((1e-3, "mm"), (1e-6, "um"), (1e-9, "nm"), (1e-12, "pm"))


def headline_sentence(result: Result) -> str:
    """Return the result in one sentence.

    One setting: its mean over repeats, or its only shot, at the frequency that moves most. Several: how far these
    reach at one frequency, so that no single lucky shot stands for all.
    """
    kind = result.origin.replace("SIMULATED", "simulated").replace("IMPORTED", "imported")
    shots = [shot for shot in result.shots if shot.estimates]
    if not shots:
        return f"no shot gave a result; {kind}"
    frequency_hz = lead_frequency_hz(shots)
    found = [mean for mean in result.means if mean.frequency_hz == frequency_hz]
    each = [estimate_at(shot, frequency_hz) for shot in shots]
    sources = "" if len(shots) == 1 else f", {len(shots)} shots"
    # Settings that were not repeated stand beside means: then every shot is told of.
    repeated = sum(len(mean.shots) for mean in found) == len(shots)
    values = [_headline(row) for row in (found if repeated else each)]
    flags = f"; {count} NOT TO BE TRUSTED" if (count := sum(bool(shot.untrusted) for shot in shots)) else ""
    what = "corrected" if values[0].corrected else "as tracked"
    if len(values) == 1:
        (value,) = values
        low, high = interval_m(value)
        scale, _ = scale_of(value.amplitude_m)
        between = f"95 %: {plain(low / scale, value.amplitude_uncertainty_m / scale)} to "
        between += f"{plain(high / scale, value.amplitude_uncertainty_m / scale)}"
        return (
            f"{amplitude_text(value.amplitude_m, value.amplitude_uncertainty_m)} at {frequency_hz:g} Hz ({what}, "
            f"{between}), phase {phase_text(value.phase_rad, value.phase_uncertainty_rad)}{sources}; {kind}{flags}"
        )
    least, most = min(values, key=lambda item: item.amplitude_m), max(values, key=lambda item: item.amplitude_m)
    scale, unit = scale_of(most.amplitude_m)
    span = " to ".join(
        _with_u(item.amplitude_m / scale, item.amplitude_uncertainty_m / scale) for item in (least, most)
    )
    return f"{span} {unit} at {frequency_hz:g} Hz ({what}) over {len(values)} settings{sources}; {kind}{flags}"


def lead_frequency_hz(shots: Sequence[ShotResult]) -> float:
    """Return the frequency that moves most in the shot that moves most."""
    return max((each for shot in shots for each in shot.estimates), key=lambda each: each.amplitude_m).frequency_hz


def estimate_at(shot: ShotResult, frequency_hz: float) -> Estimate:
    """Return the estimate of ``shot`` at ``frequency_hz``, or the nearest one that it has."""
    return min(shot.estimates, key=lambda each: abs(each.frequency_hz - frequency_hz))


def interval_m(value: Headline) -> tuple[float, float]:
    """Return the interval of 95 % about an amplitude, which is not below zero."""
    return max(value.amplitude_m - value.interval_95_m, 0.0), value.amplitude_m + value.interval_95_m


def amplitude_text(amplitude_m: float, uncertainty_m: float) -> str:
    """Return an amplitude with its standard uncertainty: 787 +- 14 nm."""
    scale, unit = scale_of(max(amplitude_m, uncertainty_m))
    return f"{_with_u(amplitude_m / scale, uncertainty_m / scale)} {unit}"


def phase_text(phase_rad: float, uncertainty_rad: float) -> str:
    """Return a phase with its standard uncertainty: 73.4 +- 0.5 deg."""
    return f"{_with_u(math.degrees(phase_rad), math.degrees(uncertainty_rad))} deg"


def _with_u(value: float, uncertainty: float) -> str:
    return f"{plain(value, uncertainty)} +- {plain(uncertainty, uncertainty)}"


def plain(value: float, uncertainty: float) -> str:
    """Return ``value`` with the decimals that two digits of its uncertainty have; at most six."""
    if not (math.isfinite(uncertainty) and uncertainty > 0):
        return f"{value:.4g}"
    decimals = 1 - math.floor(math.log10(float(f"{uncertainty:.1e}")))
    return f"{value:z.{min(max(decimals, 0), 6)}f}"


def scale_of(length_m: float) -> tuple[float, str]:
    """Return the unit in which a length has one to four digits before the point, and its name."""
    return next(((scale, unit) for scale, unit in UNITS if length_m >= scale * 9.9995), UNITS[-1])


def _headline(row: RepeatMean | Estimate) -> Headline:
    if isinstance(row, Estimate):
        return row.headline
    return Headline(
        amplitude_m=row.amplitude_m,
        amplitude_uncertainty_m=row.amplitude_uncertainty_m,
        phase_rad=row.phase_rad,
        phase_uncertainty_rad=row.phase_uncertainty_rad,
        corrected=row.corrected,
        interval_95_m=row.interval_95_m,
        interval_95_rad=row.interval_95_rad,
    )
