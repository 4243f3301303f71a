"""Warnings of one shot: each function yields sentences with cause and remedy."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from hpe_rig.arrays import BoolArray, FloatArray
from hpe_rig.processing.first_pulse import PulseAssignment, triggers
from hpe_rig.processing.harmonics.drift import Drift
from hpe_rig.processing.harmonics.fit_checks import Line
from hpe_rig.processing.harmonics.harmonic_fit import HarmonicFit
from hpe_rig.processing.harmonics.rate_error import SIGNIFICANT
from hpe_rig.processing.motion.displacement import Motion
from hpe_rig.processing.shot_tracking import DAMAGED
from hpe_rig.processing.time_base import TimeBase
from hpe_rig.processing.toneburst_phases import MIN_RECORDS, ToneburstPhases
from hpe_rig.result import DETECTED, Estimate, probability_text, with_u
from hpe_rig.scene import Scene

LARGE_STEP = 0.8
"""Largest step between pulses, in quarter wavelengths, without a warning; at 1 the phase becomes ambiguous."""
LARGE_CONDITION = 10.0
"""Largest condition number of the model without a warning that the frequencies are barely resolved."""
VISIBLE_U = 0.5
"""Smallest change by a drift, in standard uncertainties, that is reported."""
TINY = float(np.finfo(np.float64).tiny)
LATE_FRACTION = 0.02
"""Fraction of pulses after the last toneburst's period that is reported."""


def missing_record_warnings(recorded: BoolArray, damaged: BoolArray) -> Iterator[str]:
    """Yield warnings of records that a complete shot lacks.

    ``recorded`` (pulse,): an intact record exists. ``damaged`` (pulse,): its checksum fails; these are reported
    elsewhere.
    """
    missing = int((~recorded & ~damaged).sum())
    if missing:
        yield (
            f"{missing} of {recorded.size} records are missing: triggers were lost or came while the digitizer was busy"
        )


def first_pulse_warnings(assignment: PulseAssignment) -> Iterator[str]:
    """Yield a warning if it is unknown which pulse a shot's records start with."""
    max_shift, missing = max(assignment.shifts), assignment.placement.unlocated
    if max_shift:
        later = "one pulse" if max_shift == 1 else f"up to {max_shift} pulses"
        yield (
            f"{triggers(missing)} lost, and it is unknown which: the records may come {later} later than assumed, "
            "which the uncertainty of the phase includes; record the toneburst at the second input "
            "(digitizer.monitor_range_v), or check the trigger cable and digitizer.trigger_level_v"
        )


DEVIATION_CAUSES = {
    "after toneburst": "all come directly after a toneburst, which seems longer than planned: compare the toneburst at "
    "the transducer with excitation.burst_length_s",
    "before toneburst": "all come directly before a toneburst, which seems earlier than planned: connect the 10 MHz "
    "reference (common_reference in the bench file), or change tracking.delay_s",
    "": "something disturbs them; see tracking.delay_s and processing.flag_pulses",
}
"""Likely cause of pulses with deviating energy, by their position."""


def record_warnings(damaged: BoolArray, deviating: int, clipped: int, position: str) -> Iterator[str]:
    """Yield warnings of damaged records, of pulses omitted for their energy, and of clipped records.

    ``damaged`` (pulse,): which records fail their checksums. ``deviating``: number of pulses omitted for their energy,
    all at one ``position``, a key of `DEVIATION_CAUSES`. ``clipped``: number of other pulses at full scale.
    """
    if damaged.any():
        yield f"{int(damaged.sum())} of {damaged.size} records {DAMAGED}"
    if deviating:
        yield (
            f"{deviating} of {damaged.size} pulses are omitted because their energy differs from the others': "
            f"{DEVIATION_CAUSES[position]}"
        )
    if clipped:
        records = "1 record reaches" if clipped == 1 else f"{clipped} records reach"
        yield f"{records} the digitizer's full scale in the gate: raise acquisition.input_range_v"


def fit_warnings(fit: HarmonicFit, largest_step: float) -> Iterator[str]:
    """Yield warnings of large steps, of frequencies that are barely resolved or not detected, and of a poor model.

    ``largest_step``: of the displacement from pulse to pulse, in quarter wavelengths.
    """
    if largest_step > LARGE_STEP:
        yield (
            f"the echo moves by up to {largest_step:.2f} quarter wavelengths from pulse to pulse: at 1 the "
            "displacement jumps by a half wavelength; raise tracking.pulse_rate_hz, or the echoes drown in noise"
        )
    if fit.quality.condition > LARGE_CONDITION:
        yield (
            f"the pulses barely resolve the frequencies, or these and the background (condition "
            f"{fit.quality.condition:.3g}, 1 is best): the uncertainties include it; use a longer window"
        )
    undetected = fit.amplitude_m < DETECTED * np.sqrt(fit.covariance[:, 0, 0])
    if undetected.any():
        yield (
            f"not significant at {', '.join(f'{f:g}' for f in fit.frequency_hz[undetected])} Hz: the tracked "
            f"amplitude is below {DETECTED:g} u; ignore its phase, or take more cycles, pulses or drive"
        )
    # Innovations: measured minus predicted displacement of the Kalman filter. They may exceed the predicted noise,
    # which lacks trigger jitter, so only their correlation is reported.
    correlation, tolerance = fit.quality.innovation_correlation or (0.0, 0.0)
    if abs(float(correlation)) > tolerance:
        yield (
            f"the Kalman filter's innovations are correlated ({float(correlation):+.2f} "
            "from pulse to pulse, 0 is best): the model lacks some motion; raise processing.background_order or "
            "process_noise"
        )


def medium_warnings(fit: HarmonicFit, max_probability: float, *, uses_prior: bool) -> Iterator[str]:
    """Yield a warning if no medium of the prior's ensemble explains the motion.

    Data as improbable as these then have less than ``max_probability`` under the ensemble. ``uses_prior``: the fit does
    so itself, else only its uncertainty by aliasing.
    """
    if fit.medium is not None and float(fit.medium.significance) < max_probability:
        yield (
            f"the medium lies outside the ensemble of the prior (significance {fit.medium.significance:.1g}): "
            "reflections, layers, a force that differs from [beams] and the burst length, a medium that differs from "
            "[medium], or motion that is not periodic; check these and the start-up (processing.window_start_s)"
            + (', or compare with processing.harmonic = "least_squares"' if uses_prior else "")
        )


def setting_warnings(scene: Scene, pulse_time_s: FloatArray, reference: Motion | None) -> Iterator[str]:
    """Yield warnings of a window beyond the last toneburst, and of a moving echo in the reference gate."""
    excitation = scene.excitation
    if excitation is not None and excitation.burst_count > 1:
        decaying = int((pulse_time_s > excitation.burst_count / excitation.burst_rate_hz).sum())
        if decaying > LATE_FRACTION * pulse_time_s.size:
            yield (
                f"{decaying} of {pulse_time_s.size} pulses come after the last toneburst's period, where the motion "
                "decays: shorten processing.window_length_s or raise excitation.burst_count"
            )
    if reference is not None and float(reference.largest_step) > LARGE_STEP:
        yield (
            f"the reference gate's echo moves by up to {float(reference.largest_step):.2f} quarter wavelengths from "
            "pulse to pulse, but must be stationary: there is no echo, or it drowns in noise; choose another "
            "processing.reference_gate_depth_m"
        )


def line_warnings(line: Line | None, pulse_rate_hz: float, max_probability: float, rounding_m: float) -> Iterator[str]:
    """Yield a warning of a spectral line in the residual that white noise has with less than ``max_probability``.

    A line below ``rounding_m``, the uncertainty from rounding to codes, is not motion.
    """
    if line is not None and line.probability < max_probability and line.amplitude_m > rounding_m:
        yield (
            f"the residual has a line of {line.amplitude_m * 1e9:.3g} nm at {line.frequency_hz:.4g} Hz: motion that is "
            "not fitted, at this frequency or at one that aliases onto it, such as "
            f"{pulse_rate_hz - line.frequency_hz:.5g} Hz; more of it may alias onto the wanted frequencies: "
            "compare another tracking.pulse_rate_hz, or fit it too (processing.frequencies_hz)"
        )


def toneburst_warnings(tonebursts: ToneburstPhases | None, time_base: TimeBase) -> Iterator[str]:
    """Yield warnings of damaged records of the second input, and if its tonebursts do not measure their rate.

    ``tonebursts``: their phases, None if the second input was not recorded.
    """
    if tonebursts is not None and tonebursts.damaged:
        yield f"{tonebursts.damaged} records of the second input {DAMAGED}"
    is_needed = time_base.is_uncertain and time_base.by_tonebursts is None
    if tonebursts is None or not is_needed or tonebursts.expected < MIN_RECORDS:
        return
    count, expected = tonebursts.pulse.size, tonebursts.expected
    observation = (
        f"the second input shows a toneburst in {count} records, where {expected} are expected"
        if count < MIN_RECORDS
        else f"the phases of {count} records within tonebursts at the second input fit no rate, several, or one that "
        "differs from that of the motion"
    )
    yield (
        f"{observation}: the rate of the tonebursts is not measured there; check the T piece at the output of the "
        "toneburst generator and digitizer.monitor_range_v"
    )


def clock_warnings(
    time_base: TimeBase, estimates: Sequence[Estimate], pulse_time_s: FloatArray, has_bursts: bool
) -> Iterator[str]:
    """Yield a warning of clocks that differ by more than stated, and of a significant rate error that changes a result.

    ``pulse_time_s`` (pulse,): nominal times after the time zero of the stated phases. ``has_bursts``: tonebursts of the
    bench make the motion.
    """
    rate, error = time_base.tracking_rate, time_base.by_pulses
    if rate is not None and time_base.differs_from_bench:
        yield (
            f"by the digitizer's clock the tracking train is {_ppm_text(rate.error, rate.uncertainty)}, more than "
            "clock_accuracy and common_reference of the two explain: correct them in the bench file, or check the "
            "10 MHz reference"
        )
    # The correction depends on the clocks of motion and pulses alone. The rate by a third clock, the digitizer's, helps
    # to find the wrong one.
    also = ""
    if (by_digitizer := time_base.by_digitizer) is not None:
        also = f" ({_ppm_text(by_digitizer.value, by_digitizer.uncertainty)} of the digitizer's)"
    if time_base.bursts_differ:
        yield (
            f"the burst generator's clock is {_ppm_text(error.value, error.uncertainty)} of the tracking train's{also}"
            ", more than clock_accuracy and common_reference of the two explain: correct them in the bench file, or "
            "check the 10 MHz reference"
        )
    if not time_base.is_uncertain or abs(error.value) <= SIGNIFICANT * error.uncertainty:
        return
    # Times that are wrong by e t shift a phase by 2 pi f e t, on average that of the mean time.
    per_hz = 2 * np.pi * abs(error.value * float(pulse_time_s.mean()))
    worst = max(estimates, key=lambda item: item.frequency_hz / max(item.phase_uncertainty_rad, 1e-300))
    shift_rad, u_rad = per_hz * worst.frequency_hz, worst.phase_uncertainty_rad
    if shift_rad > u_rad:
        subject = "the burst generator's clock" if has_bursts else "the clock of the motion's frequencies"
        beyond = ""
        if time_base.exceeds_accuracy and not time_base.bursts_differ:
            beyond = ", more than clock_accuracy explains"
            if time_base.by_tonebursts is None:
                beyond += ", unless its delay grows as in tissue that warms"
        change = f"{np.degrees(shift_rad):.2g} deg (u {np.degrees(u_rad):.2g} deg)"
        yield (
            f"{subject} is {_ppm_text(error.value, error.uncertainty)} of the tracking train's{also}{beyond}: the "
            f"times of the pulses are corrected, which changes the phase at {worst.frequency_hz:g} Hz by {change}; a "
            "common 10 MHz reference (common_reference in the bench file) makes this correction unnecessary"
        )


def _ppm_text(error: float, uncertainty: float) -> str:
    """Return a relative rate error with its standard uncertainty in words."""
    return f"{with_u(abs(error) * 1e6, uncertainty * 1e6)} ppm {'fast' if error > 0 else 'slow'}"


def drift_warnings(
    drift: Drift | None, estimates: Sequence[Estimate], max_probability: float, *, is_removed: bool
) -> Iterator[str]:
    """Yield the ``drift`` of a shot if it ``is_removed``, else a warning if it is significant and changes the results.

    It is significant if steady motion changes as much with less than ``max_probability``. It changes the results if the
    values at the first pulse differ from the ``estimates`` by more than ``VISIBLE_U``.
    """
    if drift is None:
        return
    common = (
        f"from the first pulse of the window to the last the amplitudes grow by "
        f"{with_u(drift.growth * 100, drift.growth_u * 100)} % and the delay by "
        f"{with_u(drift.delay_s * 1e6, drift.delay_u_s * 1e6)} us"
    )
    if is_removed:
        yield f'{common}: removed (processing.drift = "linear"), the results are those at the first pulse'
        return
    # Changes from the mean to the first pulse, in standard uncertainties of the results, (frequency,).
    u_m, u_rad = np.array([[item.amplitude_uncertainty_m, item.phase_uncertainty_rad] for item in estimates]).T
    growth_m = drift.log_change.real * [item.amplitude_m for item in estimates]
    in_u = np.maximum(np.abs(growth_m) / u_m.clip(min=TINY), np.abs(drift.log_change.imag) / u_rad.clip(min=TINY))
    if drift.probability >= max_probability or in_u.max() < VISIBLE_U:
        return
    worst = int(in_u.argmax())
    change, frequency_hz = drift.log_change[worst], estimates[worst].frequency_hz
    yield (
        f"the motion changes: {common} (probability of both together in steady motion "
        f"{probability_text(drift.probability)}). The results are means over the window; at its first pulse the "
        f"amplitude at {frequency_hz:g} Hz differs by {np.expm1(-change.real) * 100:+.2g} % and the phase by "
        f"{-np.degrees(change.imag):+.2g} deg. Tissue warms, "
        "clocks differ, tonebursts are missing, or the start-up is in the window: set "
        'processing.drift = "linear" for the results at the first pulse (hpe-rig process RUN.h5 --set '
        "processing.drift=linear), lower the drive, connect a common 10 MHz reference, compare the bench's burst count "
        "with excitation.burst_count, or move processing.window_start_s past the start-up"
    )
