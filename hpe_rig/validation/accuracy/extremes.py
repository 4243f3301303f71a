"""Stiff and extreme cases, each with its error: shipped settings against an exact reference, no noise.

The medium's cases come from `specimen`; here are the echoes' (against the direct sum), the estimators' (one
scatterer, whose motion is the truth) and the fit's (prescribed displacement).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import TypeVar

import numpy as np

from hpe_rig.arrays import FloatArray
from hpe_rig.processing import EchoGate, Estimator, HarmonicFit, Motion, estimate, kalman, least_squares
from hpe_rig.validation.accuracy.work_precision import Point, grouped

T = TypeVar("T")

SOUND_SPEED, CARRIER_HZ, SAMPLE_RATE_HZ = 1540.0, 9e6, 100e6
SHIPPED_SETTING = "32 nodes, 24 degrees"


@dataclass(frozen=True, slots=True)
class Extreme:
    """One case computed in one way."""

    stage: str
    case: str
    hard_because: str
    method: str
    error: float
    """Relative, as ``measure`` says; NaN where the method gave up."""
    measure: str
    time_s: float


def extremes(medium: Iterable[Point] = (), longest_cycles: float = 1e4) -> Iterator[Extreme]:
    """Yield every stage's cases, ``longest_cycles`` those of the longest train that the estimators get.

    ``medium`` are the points of `specimen`: ours, the best of the others and each that fails.
    """
    yield from _of_medium(medium)
    yield from _echoes()
    yield from _estimators(longest_cycles)
    yield from _fits()


def _of_medium(points: Iterable[Point]) -> Iterator[Extreme]:
    reasons = {
        "elastic": "no damping: the wave front stays sharp",
        "Voigt": "a time constant of 100 s pushed every 10 ms",
        "power law": "a memory that fades as a power of time, without a time constant",
        "Maxwell": "creeps for ever, time constant 0.1 us",
        "Zener": "two moduli a factor 10 000 apart",
        "lumped": "time constants over 12 decades at once",
    }
    measure = "largest error / largest displacement"
    for case, own in grouped(points, lambda point: point.case).items():
        reason = next((text for name, text in reasons.items() if case.startswith(name)), None)
        if reason is None:
            continue
        ours = next(point for point in own if point.setting == SHIPPED_SETTING)
        yield Extreme("medium", case, reason, f"shipped: {SHIPPED_SETTING}", ours.error, measure, ours.time_s)
        others = [point for point in own if point.method != ours.method]
        best = min(others, key=lambda other: np.nan_to_num(other.error, nan=np.inf))
        failed = {point.method: point for point in others if not point.error < 1}
        for point in [best, *failed.values()]:
            method = f"{point.method}, {point.setting}"
            yield Extreme("medium", case, reason, method, point.error, measure, point.time_s)


def _echoes() -> Iterator[Extreme]:
    for case, reason, changed in (
        ("1 pm of motion", "the delay changes by 1.3 fs", {"amplitude_m": 1e-12}),
        ("10 um of motion", "upper end of the paper", {"amplitude_m": 10e-6}),
        ("1 mm of motion", "12 wavelengths: beyond every expansion in small motion", {"amplitude_m": 1e-3}),
        ("75 % bandwidth", "pulse of 1.3 cycles", {"bandwidth": 0.75}),
        ("1 % bandwidth", "pulse nine times the gate", {"bandwidth": 0.01}),
        ("W = 0.1", "motion ten times narrower than the beam", {"ratio": 0.1}),
        ("1 scatterer", "nothing averages an error away", {"scatterers": 1}),
        ("100 000 scatterers", "rounding of long sums", {"scatterers": 100_000, "pulses": 10}),
        ("2000 echoes", "a long train", {"pulses": 2000}),
        ("pairs that cancel", "echo 10 000 times below that of its parts", {"cancelling": True}),
        ("20 MHz sampling", "hardly above twice the carrier", {"sample_rate_hz": 20e6}),
    ):
        yield _echo(case, reason, **changed)


def _echo(
    case: str,
    reason: str,
    amplitude_m: float = 1e-6,
    bandwidth: float = 0.065,
    ratio: float = 2.19,
    scatterers: int = 1600,
    pulses: int = 100,
    sample_rate_hz: float = SAMPLE_RATE_HZ,
    cancelling: bool = False,
) -> Extreme:
    from sim_backend.echoes import EchoDelays, direct_sum, hann_pulse, running_sum, synthesise

    rng = np.random.default_rng(0)
    width_m = np.array([0.078e-3, 0.078e-3, 0.83e-3])
    box_m = np.array([1e-3, 1e-3, 5e-3]) * (scatterers > 1)
    place_m = rng.uniform(-0.5, 0.5, (scatterers, 3)) * box_m
    weight = np.exp(-0.5 * np.square(place_m / width_m).sum(axis=1))
    shape = np.exp(-0.5 * np.square(place_m / (ratio * width_m)).sum(axis=1))
    if cancelling:
        place_m[1::2], shape[1::2], weight[1::2] = place_m[::2], shape[::2], -weight[::2] * (1 - 1e-4)
    moved_s = 2 / SOUND_SPEED * amplitude_m * np.sin(2 * np.pi * np.arange(pulses) / 20 + 0.1)
    motion = EchoDelays(place_m[:, 2] * (2 / SOUND_SPEED), shape[None], moved_s[:, None])
    pulse = hann_pulse(CARRIER_HZ, bandwidth)
    gate_s: FloatArray = (np.arange(round(1.3e-6 * sample_rate_hz), dtype=np.float64) + 0.5) / sample_rate_hz - 0.65e-6
    made, time_s = _timed(lambda: synthesise(motion, weight, pulse, gate_s).echo)
    checked = np.unique(np.linspace(0, pulses - 1, 6).astype(int))
    few = EchoDelays(motion.rest_s, motion.shape, motion.amplitude_s[checked])
    exact = (direct_sum if scatterers <= 10_000 else running_sum)(few.delay_s(), weight, pulse, gate_s)
    error = float(np.sqrt(np.mean((made[checked] - exact) ** 2) / np.mean(exact**2)))
    return Extreme("echoes", case, reason, "shipped: tolerance 1e-6", error, "rms error / rms echo", time_s)


def _estimators(longest_cycles: float) -> Iterator[Extreme]:
    names: tuple[Estimator, ...] = ("coherent", "joint", "cross_spectrum")
    for name in names:
        for case, reason, amplitude_m, points, cycles in (
            ("1 pm", "phase of 7e-8 rad", 1e-12, 20.0, 5.0),
            ("10 um", "phase of 0.7 rad", 10e-6, 20.0, 5.0),
            ("100 um", "phase over several turns, three quarters of the largest step", 100e-6, 20.0, 5.0),
            ("2.5 pulses a cycle", "hardly above the sampling theorem", 1e-6, 2.5, 40.0),
            ("one cycle", "harmonic and constant hardly apart", 1e-6, 20.0, 1.0),
            (f"{longest_cycles:g} cycles", f"{20 * longest_cycles:g} pulses", 1e-6, 20.0, longest_cycles),
        ):
            yield _one_scatterer(name, case, reason, amplitude_m, points, cycles)


def _one_scatterer(
    name: Estimator, case: str, reason: str, amplitude_m: float, points: float, cycles: float
) -> Extreme:
    """Return the error of one harmonic from echoes of a single scatterer in closed form, its motion the truth."""
    from sim_backend.echoes import hann_pulse, waveform

    time_s = np.arange(round(points * cycles)) / (points * 200.0)
    moved_m = amplitude_m * np.sin(2 * np.pi * 200.0 * time_s)
    gate_s = (np.arange(130) - 64.5) / SAMPLE_RATE_HZ
    volts = waveform(hann_pulse(CARRIER_HZ, 0.065), gate_s - 2 / SOUND_SPEED * moved_m[:, None])
    gate = EchoGate(volts, SAMPLE_RATE_HZ, time_s, CARRIER_HZ, SOUND_SPEED, np.ones(len(time_s), dtype=bool))
    measure = "amplitude error / amplitude"
    try:
        fit, taken_s = _timed(lambda: estimate(gate, [200.0], name))
    except ValueError:
        return Extreme("estimators", case, reason, name, float("nan"), measure, 0.0)
    return Extreme("estimators", case, reason, name, abs(float(fit.amplitude_m[0]) / amplitude_m - 1), measure, taken_s)


def _fits() -> Iterator[Extreme]:
    time_s = np.arange(400) / 4000.0
    for case, reason, frequencies_hz, drift_m, order in (
        ("19 harmonics", "39 unknowns, up to the sampling limit", np.arange(1, 20) * 100.0, 0.0, 0),
        ("100 and 101 Hz in 0.1 s", "a tenth of a cycle apart", np.array([100.0, 101.0]), 0.0, 0),
        ("1 mm of acceleration", "background a million times the motion", np.array([200.0]), 1e-3, 2),
    ):
        harmonics = np.sin(2 * np.pi * np.outer(time_s, frequencies_hz)).sum(axis=1)
        truth_m = 1e-9 * harmonics + drift_m * (time_s / 0.1) ** 2
        motion = Motion(time_s, truth_m, np.full(time_s.shape, 1e-18), np.ones(time_s.shape, dtype=bool))
        methods: dict[str, Callable[..., HarmonicFit]] = {"least squares": least_squares, "Kalman": kalman}
        for name, method in methods.items():
            fit, taken_s = _timed(partial(method, motion, frequencies_hz, background_order=order))
            error = float(np.abs(fit.amplitude_m / 1e-9 - 1).max())
            yield Extreme("fit", case, reason, name, error, "largest amplitude error / amplitude", taken_s)


def _timed(run: Callable[[], T]) -> tuple[T, float]:
    start_s = time.perf_counter()
    found = run()
    return found, time.perf_counter() - start_s
