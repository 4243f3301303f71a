"""Errors and run times of the harmonic fits, from prescribed displacement with white noise."""

from __future__ import annotations

import os
import statistics
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hpe_rig.processing import (
    HarmonicFit,
    Motion,
    kalman,
    least_squares,
    velocity_between_pulses,
    velocity_to_harmonics,
)
from hpe_rig.validation.accuracy.work_precision import draw_panels, grouped, timed

AMPLITUDE_M = 1e-6
PHASE_RAD = 0.4
NOISE_M = 100e-9
FREQUENCY_HZ = 200.0
PULSE_RATE_HZ = 4000.0
REALISATIONS = 200

METHODS: dict[str, Callable[[Motion, list[float]], HarmonicFit]] = {
    "least_squares": least_squares,
    "kalman": kalman,
    "kalman_process_noise": lambda motion, f: kalman(motion, f, process_noise=1e-6),
    "kalman_acceleration": lambda motion, f: kalman(motion, f, background_order=2),
    "velocity_kalman": lambda motion, f: _fit_velocity(motion, f, with_band_pass=False, with_hann=False),
    "velocity_hann_kalman": lambda motion, f: _fit_velocity(motion, f, with_band_pass=False),
    "velocity_band_pass_hann_kalman": lambda motion, f: _fit_velocity(motion, f),
}
"""Fits by name. The last is the slow-time chain of the paper; the two before it omit its optional steps."""


@dataclass(frozen=True, slots=True)
class HarmonicRow:
    """Errors and run time of one method for one number of pulses.

    ``normalised_error`` is the mean square error over the stated variance: 1 if the stated uncertainty is right.
    """

    method: str
    pulses: int
    cycles: float
    realisations: int
    bias_m: float
    jitter_m: float
    phase_jitter_rad: float
    bound_m: float
    normalised_error: float
    time_s: float
    """Median wall time for all realisations."""
    cores: int


def rows(pulses: Sequence[int] = (60, 100, 400, 2000), seed: int = 0, repeats: int = 3) -> Iterator[HarmonicRow]:
    """Yield a row for every number of pulses and method."""
    for count in pulses:
        motion = noisy_motion(count, np.random.default_rng([seed, count]))
        for name, method in METHODS.items():
            yield _row(name, method, motion, repeats)


def draw_harmonic(rows: Sequence[HarmonicRow], path: Path) -> None:
    """Draw amplitude jitter over its bound against run time, one panel per number of pulses."""
    panels = {
        f"{count} pulses": {row.method: [(row.time_s, row.jitter_m / row.bound_m)] for row in count_rows}
        for count, count_rows in sorted(grouped(rows, lambda row: row.pulses).items())
    }
    draw_panels(panels, path, f"run time of {REALISATIONS} fits (s)", "jitter / bound", over_bound=True)


def noisy_motion(pulses: int, generator: np.random.Generator, realisations: int = REALISATIONS) -> Motion:
    """Return the displacement (realisation, pulse) of one sinusoid with white noise."""
    time_s = np.arange(pulses) / PULSE_RATE_HZ
    truth_m = AMPLITUDE_M * np.sin(2 * np.pi * FREQUENCY_HZ * time_s + PHASE_RAD)
    noisy = truth_m + NOISE_M * generator.standard_normal((realisations, pulses))
    return Motion(time_s, noisy, np.full(noisy.shape, NOISE_M**2), np.ones(pulses, dtype=bool))


def _row(name: str, method: Callable[[Motion, list[float]], HarmonicFit], motion: Motion, repeats: int) -> HarmonicRow:
    fits, times_s = zip(*(timed(lambda: method(motion, [FREQUENCY_HZ])) for _ in range(repeats)), strict=True)
    fit = fits[-1]
    error_m = fit.amplitude_m[:, 0] - AMPLITUDE_M
    pulses = motion.time_s.size
    return HarmonicRow(
        method=name,
        pulses=pulses,
        cycles=pulses / PULSE_RATE_HZ * FREQUENCY_HZ,
        realisations=len(error_m),
        bias_m=float(error_m.mean()),
        jitter_m=float(error_m.std()),
        phase_jitter_rad=float(fit.phase_rad[:, 0].std()),
        # Cramer-Rao bound of the amplitude of a sinusoid in white noise.
        bound_m=NOISE_M * float(np.sqrt(2 / pulses)),
        normalised_error=float(np.mean(error_m**2 / fit.covariance[:, 0, 0, 0])),
        time_s=statistics.median(times_s),
        cores=os.cpu_count() or 1,
    )


def _fit_velocity(
    motion: Motion, frequencies_hz: list[float], with_band_pass: bool = True, with_hann: bool = True
) -> HarmonicFit:
    velocity = velocity_between_pulses(motion)
    return velocity_to_harmonics(velocity, frequencies_hz, with_band_pass=with_band_pass, with_hann=with_hann)
