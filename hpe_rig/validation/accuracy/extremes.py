"""Errors in stiff and extreme cases: default settings, no noise, compared with an exact reference.

References: cases of the medium come with theirs from `specimen`; echoes are compared with the direct sum, estimators
with the motion of a single scatterer, and fits with the displacement that they are given.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np

from hpe_rig.arrays import FloatArray
from hpe_rig.processing import EchoGate, HarmonicFit, Motion, estimate, kalman, least_squares
from hpe_rig.scene import Estimator
from hpe_rig.validation.accuracy.work_precision import Point, grouped, timed

SOUND_SPEED, CARRIER_HZ, SAMPLE_RATE_HZ = 1540.0, 9e6, 100e6
DEFAULT_SETTING = "32 nodes, 24 degrees"


@dataclass(frozen=True, slots=True)
class Extreme:
    """Error and run time of one method in one case."""

    stage: str
    case: str
    hard_because: str
    method: str
    error: float
    """Relative error as defined by ``measure``; NaN if the method failed."""
    measure: str
    time_s: float


def extremes(medium: Iterable[Point] = (), longest_cycles: float = 1e4) -> Iterator[Extreme]:
    """Yield the cases of every stage.

    ``medium`` holds the points of `specimen`; of each case the default method, the best competitor and every failing
    competitor are yielded. ``longest_cycles`` is the length of the longest train of the estimators, in cycles.
    """
    yield from _medium_cases(medium)
    yield from _echoes()
    yield from _estimators(longest_cycles)
    yield from _fits()


def _medium_cases(points: Iterable[Point]) -> Iterator[Extreme]:
    reasons = {
        "elastic": "no damping: the wave front stays sharp",
        "Voigt": "a time constant of 100 s pushed every 10 ms",
        "power law": "the response decays as a power of time, without a time constant",
        "Maxwell": "unlimited creep, time constant 0.1 us",
        "Zener": "moduli that differ by a factor of 10 000",
        "lumped": "time constants over 12 decades",
    }
    measure = "largest error / largest displacement"
    for case, case_points in grouped(points, lambda point: point.case).items():
        reason = next((text for name, text in reasons.items() if case.startswith(name)), None)
        if reason is None:
            continue
        default = next(point for point in case_points if point.setting == DEFAULT_SETTING)
        yield Extreme("medium", case, reason, f"default: {DEFAULT_SETTING}", default.error, measure, default.time_s)
        competitors = [point for point in case_points if point.method != default.method]
        best = min(competitors, key=lambda point: np.nan_to_num(point.error, nan=np.inf))
        failed = {point.method: point for point in competitors if not point.error < 1}
        for point in [best, *failed.values()]:
            method = f"{point.method}, {point.setting}"
            yield Extreme("medium", case, reason, method, point.error, measure, point.time_s)


def _echoes() -> Iterator[Extreme]:
    for case, reason, changes in (
        ("1 pm of motion", "the delay changes by 1.3 fs", {"amplitude_m": 1e-12}),
        ("10 um of motion", "upper end of the paper", {"amplitude_m": 10e-6}),
        ("1 mm of motion", "12 wavelengths: no expansion for small motion converges", {"amplitude_m": 1e-3}),
        ("75 % bandwidth", "pulse of 1.3 cycles", {"bandwidth": 0.75}),
        ("1 % bandwidth", "pulse nine times the gate", {"bandwidth": 0.01}),
        ("W = 0.1", "motion ten times narrower than the beam", {"ratio": 0.1}),
        ("1 scatterer", "errors do not average out", {"scatterers": 1}),
        ("100 000 scatterers", "rounding of long sums", {"scatterers": 100_000, "pulses": 10}),
        ("2000 echoes", "a long train", {"pulses": 2000}),
        ("pairs that cancel", "the echo is 10 000 times smaller than its terms", {"cancelling": True}),
        ("20 MHz sampling", "little more than twice the carrier", {"sample_rate_hz": 20e6}),
    ):
        error, time_s = _echo_error(**changes)
        yield Extreme("echoes", case, reason, "default: tolerance 1e-6", error, "rms error / rms echo", time_s)


def _echo_error(
    amplitude_m: float = 1e-6,
    bandwidth: float = 0.065,
    ratio: float = 2.19,
    scatterers: int = 1600,
    pulses: int = 100,
    sample_rate_hz: float = SAMPLE_RATE_HZ,
    cancelling: bool = False,
) -> tuple[float, float]:
    """Return the rms error of the echoes relative to the direct sum, and the run time, s.

    ``ratio``: width of the motion over that of the tracking beam. ``cancelling``: echoes of scatterers cancel in pairs.
    """
    from sim_backend.echoes import EchoDelays, direct_sum, hann_pulse, running_sum, synthesise

    rng = np.random.default_rng(0)
    # Table I: beam widths, and a box that holds all scatterers with an echo; a single scatterer lies at the focus.
    width_m = np.array([0.078e-3, 0.078e-3, 0.83e-3])
    box_m = np.array([1e-3, 1e-3, 5e-3]) * (scatterers > 1)
    position_m = rng.uniform(-0.5, 0.5, (scatterers, 3)) * box_m
    weight = np.exp(-0.5 * np.square(position_m / width_m).sum(axis=1))
    shape = np.exp(-0.5 * np.square(position_m / (ratio * width_m)).sum(axis=1))
    if cancelling:
        # Every second scatterer is placed on its predecessor with the opposite weight.
        position_m[1::2], shape[1::2], weight[1::2] = position_m[::2], shape[::2], -weight[::2] * (1 - 1e-4)
    delay_amplitude_s = 2 / SOUND_SPEED * amplitude_m * np.sin(2 * np.pi * np.arange(pulses) / 20 + 0.1)
    motion = EchoDelays(position_m[:, 2] * (2 / SOUND_SPEED), shape[None], delay_amplitude_s[:, None])
    pulse = hann_pulse(CARRIER_HZ, bandwidth)
    gate_s: FloatArray = (np.arange(round(1.3e-6 * sample_rate_hz), dtype=np.float64) + 0.5) / sample_rate_hz - 0.65e-6
    echo_v, time_s = timed(lambda: synthesise(motion, weight, pulse, gate_s).echo)
    # The direct sum is slow: it is compared for six echoes, and replaced by the exact running sum of many scatterers.
    compared = np.unique(np.linspace(0, pulses - 1, 6).astype(int))
    delay_s = EchoDelays(motion.rest_s, motion.shape, motion.amplitude_s[compared]).delay_s()
    exact = (direct_sum if scatterers <= 10_000 else running_sum)(delay_s, weight, pulse, gate_s)
    return float(np.sqrt(np.mean((echo_v[compared] - exact) ** 2) / np.mean(exact**2))), time_s


def _estimators(longest_cycles: float) -> Iterator[Extreme]:
    names: tuple[Estimator, ...] = ("coherent", "cross_spectrum")
    for name in names:
        for case, reason, amplitude_m, points, cycles in (
            ("1 pm", "phase of 7e-8 rad", 1e-12, 20.0, 5.0),
            ("10 um", "phase of 0.7 rad", 10e-6, 20.0, 5.0),
            ("100 um", "phase of several cycles, three quarters of the largest step between pulses", 100e-6, 20.0, 5.0),
            ("2.5 pulses a cycle", "little above the Nyquist rate", 1e-6, 2.5, 40.0),
            ("one cycle", "harmonic and constant are barely resolved", 1e-6, 20.0, 1.0),
            (f"{longest_cycles:g} cycles", f"{20 * longest_cycles:g} pulses", 1e-6, 20.0, longest_cycles),
        ):
            error, time_s = _one_scatterer_error(name, amplitude_m, points, cycles)
            yield Extreme("estimators", case, reason, name, error, "amplitude error / amplitude", time_s)


def _one_scatterer_error(name: Estimator, amplitude_m: float, points: float, cycles: float) -> tuple[float, float]:
    """Return the relative error of an amplitude at 200 Hz and the run time, s; NaN if the estimator fails.

    The echoes are those of a single scatterer in closed form, with ``points`` pulses per cycle.
    """
    from sim_backend.echoes import hann_pulse, waveform

    time_s = np.arange(round(points * cycles)) / (points * 200.0)
    displacement_m = amplitude_m * np.sin(2 * np.pi * 200.0 * time_s)
    gate_s = (np.arange(130) - 64.5) / SAMPLE_RATE_HZ
    volts = waveform(hann_pulse(CARRIER_HZ, 0.065), gate_s - 2 / SOUND_SPEED * displacement_m[:, None])
    gate = EchoGate(volts, SAMPLE_RATE_HZ, time_s, CARRIER_HZ, SOUND_SPEED, np.ones(len(time_s), dtype=bool))
    try:
        fit, elapsed_s = timed(lambda: estimate(gate, [200.0], name))
    except ValueError:
        return float("nan"), 0.0
    return abs(float(fit.amplitude_m[0]) / amplitude_m - 1), elapsed_s


def _fits() -> Iterator[Extreme]:
    # 400 pulses at 4 kHz; amplitudes of 1 nm.
    time_s = np.arange(400) / 4000.0
    for case, reason, frequencies_hz, drift_m, order in (
        ("19 harmonics", "39 unknowns, up to the Nyquist frequency", np.arange(1, 20) * 100.0, 0.0, 0),
        (
            "100 and 101 Hz in 0.1 s",
            "they differ by a tenth of a cycle in the record",
            np.array([100.0, 101.0]),
            0.0,
            0,
        ),
        ("1 mm of acceleration", "background a million times the motion", np.array([200.0]), 1e-3, 2),
    ):
        harmonics = np.sin(2 * np.pi * np.outer(time_s, frequencies_hz)).sum(axis=1)
        truth_m = 1e-9 * harmonics + drift_m * (time_s / 0.1) ** 2
        motion = Motion(time_s, truth_m, np.full(time_s.shape, 1e-18), np.ones(time_s.shape, dtype=bool))
        methods: dict[str, Callable[..., HarmonicFit]] = {"least squares": least_squares, "Kalman": kalman}
        for name, method in methods.items():
            fit, elapsed_s = timed(partial(method, motion, frequencies_hz, background_order=order))
            error = float(np.abs(fit.amplitude_m / 1e-9 - 1).max())
            yield Extreme("fit", case, reason, name, error, "largest amplitude error / amplitude", elapsed_s)
