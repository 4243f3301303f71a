"""Error against run time of the echo engine: every evaluation, from small scenes to large ones.

A scene has scatterers in Table I's volume, so that their density grows with their number, and echoes of Table I's pulse
from motion of 1 um with 20 pulses per cycle. Errors are relative to the direct double sum.
"""

from __future__ import annotations

import os
import statistics
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hpe_rig.arrays import FloatArray
from hpe_rig.validation.accuracy.work_precision import MIN_DRAWN_ERROR, draw_panels, grouped

if TYPE_CHECKING:
    from sim_backend.echoes import EchoDelays, Method, Pulse


TOLERANCES = (1e-2, 1e-4, 1e-6, 1e-8, 1e-10, 1e-12)
SCATTERERS = (100, 1_000, 10_000, 100_000, 1_000_000)
ECHOES = (10, 100, 1_000, 10_000)

_SAMPLES = 130
_SAMPLE_PERIOD_S = 1e-8
_CARRIER_HZ = 9.0e6
_SOUND_SPEED_M_PER_S = 1540.0
_AMPLITUDE_M = 1e-6
_COMPARED_ECHOES = 6
# Approximate run time per scatterer and echo, s: evaluations that would take too long are omitted.
_DIRECT_PAIR_S, _EXACT_PAIR_S = 6e-6, 2.5e-7
ENGINE = "engine"
"""Evaluation selected by the engine for the tolerance."""
REFERENCE = "direct"
"""The double sum as written, which the engine never selects."""


@dataclass(frozen=True, slots=True)
class Measurement:
    """Error and run time of one evaluation of one scene."""

    scatterers: int
    echoes: int
    samples: int
    evaluation: str
    """Name of the method, or ``engine`` if the engine selected it."""
    method: str
    """Method that was run."""
    tolerance: float
    terms: int
    """Terms of the series; 0 for an exact sum."""
    error: float
    """Root mean square difference from the direct sum, relative to it, in up to 6 of the echoes."""
    time_s: float
    """Median wall time."""
    displacement_error_m: float
    """``error`` as displacement: error times c / (4 pi f)."""
    cores: int


def measurements(
    scatterers: tuple[int, ...] = SCATTERERS,
    echoes: tuple[int, ...] = ECHOES,
    tolerances: tuple[float, ...] = TOLERANCES,
    longest_s: float = 5.0,
    seed: int = 0,
) -> Iterator[Measurement]:
    """Yield every evaluation of every scene that is expected to take at most ``longest_s``."""
    for count in scatterers:
        for echo_count in echoes:
            yield from _of_scene(count, echo_count, tolerances, longest_s, seed)


def _of_scene(
    count: int, echoes: int, tolerances: tuple[float, ...], longest_s: float, seed: int
) -> Iterator[Measurement]:
    from sim_backend.echoes import direct_sum, method_times_s, running_sum, synthesise

    delays, weight, pulse, gate_s = _scene(count, echoes, seed)
    compared = np.unique(np.linspace(0, echoes - 1, _COMPARED_ECHOES).astype(int))
    compared_delay_s = delays.rest_s + delays.amplitude_s[compared] @ delays.shape
    # The running sum is exact too: it equals the direct sum to 1e-13 and is faster for many scatterers.
    exact_sum = direct_sum if count <= 10_000 else running_sum
    exact = exact_sum(compared_delay_s, weight, pulse, gate_s)
    repeated_s, cores = min(0.3, longest_s / 10), os.cpu_count() or 1

    def row(name: str, method: str, tolerance: float, terms: int, echo: FloatArray, time_s: float) -> Measurement:
        error = float(np.sqrt(np.mean(np.square(echo[compared] - exact)) / np.mean(np.square(exact))))
        error_m = float(error * _SOUND_SPEED_M_PER_S / (4 * np.pi * _CARRIER_HZ))
        return Measurement(count, echoes, _SAMPLES, name, method, tolerance, terms, error, time_s, error_m, cores)

    def measured(method: Method | None, tolerance: float) -> Measurement:
        result = synthesise(delays, weight, pulse, gate_s, tolerance, method)
        time_s = median_s(lambda: synthesise(delays, weight, pulse, gate_s, tolerance, method), repeated_s)
        return row(method or ENGINE, result.method, tolerance, result.terms, result.echo, time_s)

    if count * echoes * _DIRECT_PAIR_S <= longest_s:
        delay_s = delays.delay_s()
        time_s = median_s(lambda: direct_sum(delay_s, weight, pulse, gate_s), repeated_s)
        yield row(REFERENCE, REFERENCE, 0.0, 0, direct_sum(delay_s, weight, pulse, gate_s), time_s)
    if count * echoes * _EXACT_PAIR_S <= longest_s:
        yield measured("running_sum", 0.0)
    for tolerance in tolerances:
        times_s = method_times_s(delays, pulse, gate_s, tolerance)
        for method, time_s in times_s.items():
            # The running sum does not depend on the tolerance and was measured above.
            if method != "running_sum" and time_s <= longest_s:
                yield measured(method, tolerance)
        if min(times_s.values()) <= longest_s:
            yield measured(None, tolerance)


def _scene(count: int, echoes: int, seed: int) -> tuple[EchoDelays, FloatArray, Pulse, FloatArray]:
    from sim_backend.echoes import EchoDelays, depth_delay_s, field_at, hann_pulse
    from sim_backend.settings import Beams, Scatterers

    scatterers = Scatterers()
    position_m = np.random.default_rng(seed).uniform(-0.5, 0.5, (count, 3)) * np.array(scatterers.volume_m)
    field = field_at(position_m, Beams())
    displacement_m = _AMPLITUDE_M * np.sin(2 * np.pi * np.arange(echoes) / 20 + 0.1)
    gate_s = np.asarray((np.arange(_SAMPLES) - (_SAMPLES - 1) / 2) * _SAMPLE_PERIOD_S, dtype=np.float64)
    rest_s = depth_delay_s(field, scatterers.axial_delay, _SOUND_SPEED_M_PER_S)
    amplitude_s = displacement_m[:, None] * (2 / _SOUND_SPEED_M_PER_S)
    delays = EchoDelays(rest_s, field.motion_weight[None], amplitude_s)
    return delays, field.tracking_weight, hann_pulse(_CARRIER_HZ, scatterers.bandwidth), gate_s


def median_s(run: Callable[[], object], total_s: float) -> float:
    """Return the median wall time of 1 to 15 runs that together take about ``total_s``, after an untimed run."""
    run()
    times_s: list[float] = []
    while len(times_s) < 15 and (not times_s or sum(times_s) < total_s):
        start_s = time.perf_counter()
        run()
        times_s.append(time.perf_counter() - start_s)
    return statistics.median(times_s)


def rows_within(largest: int, most_echoes: int, longest_s: float) -> Iterator[Measurement]:
    """Yield every evaluation of the scenes with at most ``largest`` scatterers and ``most_echoes`` echoes."""
    scatterers = tuple(count for count in SCATTERERS if count <= largest)
    echoes = tuple(count for count in ECHOES if count <= most_echoes)
    return measurements(scatterers, echoes, longest_s=longest_s)


def draw_echo(rows: Sequence[Measurement], path: Path) -> None:
    """Draw error against run time over the tolerance, one panel per scene, one line per evaluation."""
    panels = {
        f"{scatterers:g} scatterers, {echoes:g} echoes": {
            evaluation: [(row.time_s, max(row.error, MIN_DRAWN_ERROR)) for row in evaluation_rows]
            for evaluation, evaluation_rows in grouped(scene_rows, lambda row: row.evaluation).items()
        }
        for (scatterers, echoes), scene_rows in grouped(rows, lambda row: (row.scatterers, row.echoes)).items()
    }
    draw_panels(panels, path, "run time (s)", "relative rms error")
