"""Acoustic output at the focus, estimated from the bench's calibration before anything is switched on.

The output is derated by 0.3 dB/cm/MHz and compared as in the FDA's track 3: I_spta with its limit, and the mechanical
index or I_sppa with theirs. Pressure is proportional to the generator's amplitude, intensity to its square. The
forecast states the error of that at another drive than the calibrated one, due to shocks.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import date
from typing import Final

from drivers.interfaces import Toneburst
from hpe_rig.bench import BenchFile, Calibration, DriveCalibration, OutputLimits
from hpe_rig.plan.checks.check_result import CheckResult, pass_or_refuse
from hpe_rig.plan.shots import Plan, Shot
from hpe_rig.scene import Scene

DERATING_DB_PER_M_HZ: Final = 0.3 / (1e-2 * 1e6)
CARRIER_TOLERANCE: Final = 0.01
"""Relative deviation from the calibrated carrier within which a transducer's response hardly changes."""
ASSUMED: Final = re.compile(r"\s*assumed\b", re.IGNORECASE)
"""Source of a calibration that was not measured, as on the simulated bench."""
MEASURE: Final = (
    "put a calibrated hydrophone at the focus in degassed water, drive one toneburst and one tracking pulse at a few "
    "amplitudes, enter pressure and intensity as not derated, and who measured them when as the source "
    "(docs/how-to/bench-safety.md); or remove [calibration], and the output is not estimated"
)

RENEW: Final = (
    "measure the output again (docs/how-to/hydrophone.md) and enter the new values with their date and valid_until; or "
    "remove [calibration], and the output is not estimated"
)


@dataclass(frozen=True, slots=True)
class AcousticOutput:
    """Estimated derated output of one shot at the focus."""

    mechanical_index: float
    sppa_w_per_m2: float
    spta_w_per_m2: float

    def within(self, limits: OutputLimits) -> bool:
        """Return whether time average, and peak pressure or pulse average, are within the bench's limits."""
        peak = self.mechanical_index <= limits.max_mechanical_index or self.sppa_w_per_m2 <= limits.max_sppa_w_per_m2
        return peak and self.spta_w_per_m2 <= limits.max_spta_w_per_m2


NO_OUTPUT: Final = AcousticOutput(0.0, 0.0, 0.0)


def derating_db(carrier_hz: float, depth_m: float) -> float:
    """Return the attenuation, in dB, that derates the output in water."""
    return DERATING_DB_PER_M_HZ * carrier_hz * depth_m


def drive_output(drive: DriveCalibration, depth_m: float, amplitude_vpp: float, duty: float) -> AcousticOutput:
    """Return the output of one drive of ``amplitude_vpp`` with the duty cycle ``duty``, derated over ``depth_m``."""
    attenuation_db = derating_db(drive.carrier_hz, depth_m)
    relative_amplitude = amplitude_vpp / drive.amplitude_vpp
    rarefaction_pa = drive.rarefaction_pa * relative_amplitude * 10 ** (-attenuation_db / 20)
    sppa_w_per_m2 = drive.sppa_w_per_m2 * relative_amplitude**2 * 10 ** (-attenuation_db / 10)
    # Mechanical index: peak rarefactional pressure in MPa over the root of the frequency in MHz.
    index = rarefaction_pa / 1e6 / math.sqrt(drive.carrier_hz / 1e6)
    return AcousticOutput(index, sppa_w_per_m2, sppa_w_per_m2 * duty)


def combined(outputs: Sequence[AcousticOutput]) -> AcousticOutput:
    """Return the output of alternating drives at one focus: the largest peak, the sum of the averages."""
    return AcousticOutput(
        max(output.mechanical_index for output in outputs),
        max(output.sppa_w_per_m2 for output in outputs),
        sum(output.spta_w_per_m2 for output in outputs),
    )


def shot_output(calibration: Calibration, shot: Shot) -> AcousticOutput:
    """Return the output of ``shot``, averaged over its trains, without drives that are not calibrated."""
    outputs = [
        drive_output(drive, calibration.focus_depth_m, burst.amplitude_vpp, burst.cycles / burst.carrier_hz * rate_hz)
        for _, drive, burst, rate_hz in _drives(calibration, shot)
        if drive is not None
    ]
    return combined(outputs) if outputs else NO_OUTPUT


def highest_output(bench: BenchFile, shots: Sequence[Shot]) -> AcousticOutput:
    """Return the largest of each quantity over ``shots``; zero without calibration."""
    if bench.calibration is None:
        return NO_OUTPUT
    outputs = [shot_output(bench.calibration, shot) for shot in shots]
    # Shots do not add up: the time average is the largest of the shots'.
    peak = combined(outputs)
    return AcousticOutput(peak.mechanical_index, peak.sppa_w_per_m2, max(output.spta_w_per_m2 for output in outputs))


def uncalibrated(calibration: Calibration | None, shot: Shot) -> Iterator[str]:
    """Yield in words the drives of ``shot`` that the calibration does not cover."""
    if calibration is None:
        yield "the bench file has no [calibration]"
        return
    for name, drive, burst, _ in _drives(calibration, shot):
        if drive is None:
            yield f"the {name} is not calibrated"
        elif abs(burst.carrier_hz / drive.carrier_hz - 1) > CARRIER_TOLERANCE:
            yield f"the {name} of {burst.carrier_hz / 1e6:g} MHz was calibrated at {drive.carrier_hz / 1e6:g} MHz"


def _drives(calibration: Calibration, shot: Shot) -> Iterator[tuple[str, DriveCalibration | None, Toneburst, float]]:
    """Yield name, calibration, programmed burst and repetition rate of each drive in ``shot``."""
    yield "tracking pulse", calibration.tracking_pulse, shot.tracking_pulser, shot.tracking_train.rate_hz
    if shot.toneburst is not None and shot.burst_train is not None:
        yield "toneburst", calibration.toneburst, shot.toneburst, shot.burst_train.rate_hz


def acoustic_output(scene: Scene, bench: BenchFile, plan: Plan) -> Iterator[CheckResult]:
    """Yield whether the estimated output is within the limits, and the drives that could not be estimated."""
    unknown = dict.fromkeys(words for shot in plan.shots for words in uncalibrated(bench.calibration, shot))
    if unknown:
        text = f"not estimated in full: {'; '.join(unknown)}"
        remedy = "a hydrophone measurement in [calibration] of the bench file"
        yield CheckResult("acoustic output", "warning", text, remedy)
    if bench.calibration is None:
        return
    if not bench.simulated and ASSUMED.match(bench.calibration.source):
        text = f"calibration.source = {bench.calibration.source!r}: assumed numbers cannot ensure a limit"
        yield CheckResult("acoustic output", "refused", text, MEASURE)
        return
    limits, output, u = bench.limits, highest_output(bench, plan.shots), bench.calibration.u
    text = (
        f"derated MI {_with_u(output.mechanical_index, u)} (limit {limits.max_mechanical_index:g}) or "
        f"I_sppa {_with_u(output.sppa_w_per_m2 / 1e4, u, 2)} W/cm2 (limit {limits.max_sppa_w_per_m2 / 1e4:g}), "
        f"I_spta {_with_u(output.spta_w_per_m2 / 10, u, 2)} mW/cm2 (limit {limits.max_spta_w_per_m2 / 10:g})"
    )
    yield pass_or_refuse("acoustic output", output.within(limits), text, _reduction(output, limits))


def calibration_expiry(bench: BenchFile, day: date) -> Iterator[CheckResult]:
    """Yield whether the calibration is valid on ``day``; an expired or later one is refused on a real bench."""
    calibration = bench.calibration
    if calibration is None or bench.recording is not None:
        return
    if calibration.date is not None and calibration.date > day:
        text = f"calibration.date = {calibration.date} lies in the future, today is {day}"
        remedy = "the day of the measurement as calibration.date, or the right date of this computer"
        yield CheckResult("calibration", "warning" if bench.simulated else "refused", text, remedy)
    if calibration.valid_until is None:
        return
    text = f"calibration.valid_until = {calibration.valid_until}, today is {day}"
    if day <= calibration.valid_until:
        yield CheckResult("calibration", "passed", text)
    else:
        yield CheckResult("calibration", "warning" if bench.simulated else "refused", f"expired: {text}", RENEW)


def _with_u(value: float, u_pressure: float | None, power: int = 1) -> str:
    """Return ``value`` and its standard uncertainty, for a quantity that is the pressure to ``power``."""
    return f"{value:.3g}" if u_pressure is None else f"{value:.3g} +- {value * power * u_pressure:.2g}"


def _reduction(output: AcousticOutput, limits: OutputLimits) -> str:
    """Return in words how much amplitudes or burst lengths must be reduced."""
    tiny = 1e-300  # instead of a division by zero
    average = limits.max_spta_w_per_m2 / max(output.spta_w_per_m2, tiny)
    index = limits.max_mechanical_index / max(output.mechanical_index, tiny)
    peak = max(index, math.sqrt(limits.max_sppa_w_per_m2 / max(output.sppa_w_per_m2, tiny)))
    amplitude = min(peak, math.sqrt(average))
    words = f"amplitudes of at most {100 * amplitude:.3g} % (limits.full_drive_vpp, generators.tracking_pulser)"
    # Shorter bursts reduce the time average only.
    return words + (f", or excitation.burst_length_s of {100 * average:.3g} %" if average < 1 <= peak else "")
