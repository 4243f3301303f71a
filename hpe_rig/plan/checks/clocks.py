"""Check of the clocks: how accurate they are, and how far they may shift a phase before the fit corrects it."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from hpe_rig.bench import BenchFile, clock_covariance
from hpe_rig.plan.checks.check_result import CheckResult
from hpe_rig.plan.shots import Plan
from hpe_rig.scene import Scene


def clocks(scene: Scene, bench: BenchFile, plan: Plan) -> Iterator[CheckResult]:
    """Yield the accuracies of the clocks of motion, pulses and digitizer, unless all share one or nothing is fitted."""
    covariance = clock_covariance(scene, bench)
    motion_by_pulses = float(np.sqrt(covariance[0, 0] + covariance[1, 1] - 2 * covariance[0, 1]))
    stated = scene.processing.frequency_accuracy
    accuracy = motion_by_pulses if stated is None else stated
    if not accuracy or not scene.wanted_frequencies_hz:
        return
    motion_ppm, pulses_ppm, digitizer_ppm = np.sqrt(np.diag(covariance)) * 1e6
    source = f"motion {motion_ppm:g} ppm, pulses {pulses_ppm:g} ppm, digitizer {digitizer_ppm:g} ppm (clock_accuracy)"
    if stated is not None:
        source = f"frequencies {stated * 1e6:g} ppm (processing.frequency_accuracy)"
    timeline, highest_hz = plan.shots[0].timeline, max(scene.wanted_frequencies_hz)
    length_s = scene.processing.window_length_s or float(timeline.pulse_onset_s[-1] - timeline.pulse_onset_s[0])
    shift_deg = 360 * highest_hz * accuracy * length_s
    text = (
        f"{source}: in {length_s:.3g} s they may shift {highest_hz:g} Hz by {shift_deg:.2g} deg, which the fit corrects"
    )
    yield CheckResult("clocks", "passed", text)
