"""Headline sentence of a result: amplitude and phase with uncertainties, the quantity, and whether it is simulated."""

from __future__ import annotations

import math
import operator
from collections.abc import Sequence

from hpe_rig.result.repeats import RepeatMean, setting_of
from hpe_rig.result.result_data import ResultData
from hpe_rig.result.values import Estimate, ShotResult

MIN_PROBABILITY = 1e-16
"""Probability below which its numerical value means nothing, about the resolution of double precision."""
PREFIXES = ((1.0, ""), (1e-3, "m"), (1e-6, "u"), (1e-9, "n"), (1e-12, "p"))


def headline_sentence(result: ResultData) -> str:
    """Return the result in one sentence, at the frequency with the largest amplitude.

    One setting: its mean over repeats, or its only shot. Several settings, or shots without a mean: the range of their
    amplitudes. Incomplete and untrusted shots count only if there are no others.
    """
    kind = result.origin.partition(", SHA")[0].replace("SIMULATED", "simulated").replace("IMPORTED", "imported")
    shots = [shot for shot in result.shots if shot.estimates]
    if not shots:
        return f"no shot gave a result; {kind}"
    usable_shots = [shot for shot in shots if shot.complete and not shot.untrusted]
    sentence = f"{_values_sentence(usable_shots or shots, result.means)}; {kind}"
    untrusted = sum(bool(shot.untrusted) for shot in shots)
    if untrusted == len(shots):
        return f"NOT TO BE TRUSTED: {sentence}"
    return f"{sentence}; {untrusted} NOT TO BE TRUSTED" if untrusted else sentence


def _values_sentence(shots: Sequence[ShotResult], means: Sequence[RepeatMean]) -> str:
    """Return the mean over the repeats ``shots``, the value of the only shot, or the range over the settings."""
    frequency_hz = lead_frequency_hz(shots)
    lead_means = [mean for mean in means if mean.frequency_hz == frequency_hz]
    values: Sequence[Estimate | RepeatMean] = lead_means
    # Without a mean for every shot, the single shots represent the settings.
    if sum(len(mean.shots) for mean in lead_means) != len(shots):
        values = [estimate_at(shot, frequency_hz) for shot in shots]
    quantity = "corrected" if values[0].corrected else "as tracked"
    count = "" if len(shots) == 1 else f", {len(shots)} shots"
    if len(values) == 1:
        return _single_sentence(values[0], frequency_hz, quantity) + count
    settings = len({setting_of(shot) for shot in shots})
    over = f" over {settings} settings" if settings > 1 else ""
    return _range_sentence(values, frequency_hz, quantity) + over + count


def _range_sentence(values: Sequence[Estimate | RepeatMean], frequency_hz: float, quantity: str) -> str:
    by_amplitude = operator.attrgetter("amplitude_m")
    smallest, largest = min(values, key=by_amplitude), max(values, key=by_amplitude)
    scale, unit = scale_of(largest.amplitude_m)
    span = " to ".join(
        with_u(item.amplitude_m / scale, item.amplitude_uncertainty_m / scale) for item in (smallest, largest)
    )
    return f"{span} {unit} at {frequency_hz:g} Hz ({quantity})"


def _single_sentence(value: Estimate | RepeatMean, frequency_hz: float, quantity: str) -> str:
    amplitude_m, u_m, half_width_m = value.amplitude_m, value.amplitude_uncertainty_m, value.interval_95_m
    scale, _ = scale_of(amplitude_m)
    # An amplitude has no negative values.
    limits_m = max(amplitude_m - half_width_m, 0.0), amplitude_m + half_width_m
    low, high = (plain(limit_m / scale, u_m / scale) for limit_m in limits_m)
    phase = phase_text(value.phase_rad, value.phase_uncertainty_rad)
    return (
        f"{amplitude_text(amplitude_m, u_m)} at {frequency_hz:g} Hz ({quantity}, 95 %: {low} to {high}), phase {phase}"
    )


def amplitude_text(amplitude_m: float, u_m: float) -> str:
    """Return an amplitude with its uncertainty in the unit that suits the larger of both."""
    scale, unit = scale_of(max(amplitude_m, u_m))
    return f"{with_u(amplitude_m / scale, u_m / scale)} {unit}"


def phase_text(phase_rad: float, u_rad: float) -> str:
    """Return a phase with its uncertainty in degrees."""
    return f"{with_u(math.degrees(phase_rad), math.degrees(u_rad))} deg"


def lead_frequency_hz(shots: Sequence[ShotResult]) -> float:
    """Return the frequency with the largest amplitude of all shots."""
    estimates = (estimate for shot in shots for estimate in shot.estimates)
    return max(estimates, key=lambda estimate: estimate.amplitude_m).frequency_hz


def estimate_at(shot: ShotResult, frequency_hz: float) -> Estimate:
    """Return the estimate of ``shot`` nearest to ``frequency_hz``."""
    return min(shot.estimates, key=lambda estimate: abs(estimate.frequency_hz - frequency_hz))


def frequency_error_text(shot: ShotResult) -> str:
    """Return the rate error of the motion's clock in words; "" for one common clock."""
    if shot.frequency_error is None or shot.frequency_error_uncertainty is None:
        return ""
    error, u = shot.frequency_error * 1e6, shot.frequency_error_uncertainty * 1e6
    source = " (tonebursts at the second input)" if shot.frequency_error_from_tonebursts else ""
    return f"motion's frequencies {with_u(error, u)} ppm from nominal by the clock of the pulses{source}, corrected"


def probability_text(probability: float) -> str:
    """Return a probability with two digits; one below the precision of the computation as a bound."""
    return f"< {MIN_PROBABILITY:g}" if probability < MIN_PROBABILITY else f"{probability:.2g}"


def with_u(value: float, uncertainty: float) -> str:
    """Return ``value`` +- ``uncertainty``, both with the decimals of two digits of the uncertainty."""
    return f"{plain(value, uncertainty)} +- {plain(uncertainty, uncertainty)}"


def plain(value: float, uncertainty: float) -> str:
    """Return ``value`` with as many decimals as two digits of its uncertainty; beyond six, with four digits."""
    # An uncertainty that six decimals would show as zero keeps its own digits.
    if not (math.isfinite(uncertainty) and uncertainty >= 5e-7):
        return f"{value:.4g}"
    decimals = 1 - math.floor(math.log10(float(f"{uncertainty:.1e}")))
    return f"{value:z.{min(max(decimals, 0), 6)}f}"


def scale_of(largest: float, unit: str = "m") -> tuple[float, str]:
    """Return size and name of the unit with a prefix in which ``largest``, in ``unit``, has two to four digits."""
    scale, prefix = next((item for item in PREFIXES if largest >= item[0] * 9.9995), PREFIXES[-1])
    return scale, prefix + unit
