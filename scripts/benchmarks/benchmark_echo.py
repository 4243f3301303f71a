"""Compare the echo engine with the direct sum and with public simulators: same scatterers, echoes and samples.

Processor time of one core. All run once per round and medians over the rounds are compared, so that a busy machine
slows all of them alike. Simulators are optional (`echo_peers.py`); missing ones are named.

    python scripts/benchmarks/benchmark_echo.py [--rounds 7] [--output table.json]
"""

# ruff: noqa: E402
from __future__ import annotations

import os

# One thread per library. They read these variables when they are imported.
for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ[_variable] = "1"

import argparse
import json
import statistics
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from echo_peers import CARRIER_HZ, DEPTH_M, GATE_S, PEER_MODELS, PULSE, SOUND_SPEED, available_peers
from process_cost import processor_times_s

from sim_backend.echoes import (
    EchoDelays,
    ScattererRows,
    batch,
    depth_delay_s,
    direct_sum,
    draw_field,
    drawn_echoes,
    running_sum,
    synthesise,
)
from sim_backend.settings import Beams, Scatterers, SimulationSettings

DISPLACEMENT_M = 1e-6 * np.sin(2 * np.pi * np.arange(101) / 20)
ECHOES = len(DISPLACEMENT_M)
FIELD = draw_field(Scatterers(), Beams(), np.random.default_rng(0))
MOTION = EchoDelays(
    depth_delay_s(FIELD, "two_way", SOUND_SPEED), FIELD.motion_weight[None], DISPLACEMENT_M[:, None] * 2 / SOUND_SPEED
)
WEIGHT = FIELD.tracking_weight
PEERS, MISSING_PEERS = available_peers()
TOLERANCES = (1e-6, 1e-8, 1e-13)
REFERENCE = "batch, 1e-08"
"""Contender that the others are compared with: the engine as studies use it."""


@dataclass(frozen=True)
class Contender:
    """A program that computes ``echo_count`` of the echoes per call, and where they are in its result."""

    compute: Callable[[], object]
    echo_count: int
    echo_of: Callable[[object], object] = lambda result: result


@dataclass(frozen=True)
class Timing:
    """Times for all echoes, and the relative rms error of the echoes; None if the model differs."""

    median_s: float
    best_s: float
    error: float | None


def vectorised_direct_sum(delay_s: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Return the double sum of eq. (10) with an array (sample, scatterer) for each echo."""
    echoes = np.empty((len(delay_s), len(GATE_S)))
    window_rad_per_s, carrier_rad_per_s = 2 * np.pi * CARRIER_HZ * 0.065, 2 * np.pi * CARRIER_HZ
    for echo, tau in zip(echoes, delay_s, strict=True):
        age_s = GATE_S[:, None] - tau
        pulse = (0.5 + 0.5 * np.cos(window_rad_per_s * age_s)) * np.cos(carrier_rad_per_s * age_s)
        echo[:] = np.where(np.abs(age_s) < PULSE.end_s, pulse, 0.0) @ weight
    return echoes


def matrix_direct_sum(delay_s: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Return the double sum of eq. (10) as matrix products, which save the cosines: the fairest reference.

    The Hann pulse is a sum of three cosines. The products of each with the mask of scatterers within the pulse give the
    complex amplitudes at every sample.
    """
    omega = 2 * np.pi * np.array(PULSE.frequency_hz)
    rotation = np.array(PULSE.amplitude)[:, None] * np.exp(1j * omega[:, None] * GATE_S)
    echoes = np.empty((len(delay_s), len(GATE_S)))
    for echo, tau in zip(echoes, delay_s, strict=True):
        inside = (np.abs(GATE_S[:, None] - tau) < PULSE.end_s).astype(float)
        phasors = weight * np.exp(-1j * omega[:, None] * tau)
        sums = inside @ np.concatenate([phasors.real, phasors.imag]).T
        echo[:] = (rotation.T * (sums[:, :3] + 1j * sums[:, 3:])).real.sum(axis=1)
    return echoes


def contenders() -> dict[str, Contender]:
    """Return all programs that compute the echoes of Table I."""
    delay_s = MOTION.delay_s()
    rows = ScattererRows(
        np.zeros(len(WEIGHT), dtype=np.int64), MOTION.rest_s, WEIGHT, MOTION.shape, MOTION.amplitude_s[None]
    )
    entries = {
        "NumPy direct, vectorised": Contender(lambda: vectorised_direct_sum(delay_s[:10], WEIGHT), 10),
        "NumPy direct, by products": Contender(lambda: matrix_direct_sum(delay_s[:10], WEIGHT), 10),
        "running sum": Contender(lambda: running_sum(delay_s, WEIGHT, PULSE, GATE_S), ECHOES),
    }
    for tolerance in TOLERANCES:
        engine = lambda tolerance=tolerance: synthesise(MOTION, WEIGHT, PULSE, GATE_S, tolerance)  # noqa: E731
        entries[f"engine, {tolerance:g}"] = Contender(engine, ECHOES, lambda result: result.echo)
        batched = lambda tolerance=tolerance: batch(rows, PULSE, GATE_S, tolerance)  # noqa: E731
        entries[f"batch, {tolerance:g}"] = Contender(batched, ECHOES, lambda result: result[0])
    x_m, z_m = FIELD.offset_m[:, 0], FIELD.offset_m[:, 2]
    for name, peer in PEERS.items():
        entries[name] = Contender(lambda peer=peer: peer(x_m, z_m, WEIGHT), 1)
    if finufft := PEERS.get("finufft"):
        # It has the twin's model, so it computes all echoes of the motion, which are compared.
        moving = lambda: np.stack([finufft(x_m, SOUND_SPEED / 2 * tau, WEIGHT) for tau in delay_s])  # noqa: E731
        entries["finufft"] = Contender(moving, ECHOES)
    return entries


def timings(rounds: int) -> dict[str, Timing]:
    """Run all contenders alternately."""
    entries = contenders()
    # A slow contender once per round, a fast one 25 times; the first calls compile.
    repeats = {name: 1 if min(processor_times_s(entry.compute, 2)) > 0.05 else 25 for name, entry in entries.items()}
    times_s: dict[str, list[float]] = {name: [] for name in entries}
    for _ in range(rounds):
        for name, entry in entries.items():
            calls_s = processor_times_s(entry.compute, repeats[name])
            times_s[name] += [time_s * ECHOES / entry.echo_count for time_s in calls_s]
    exact = direct_sum(MOTION.delay_s(), WEIGHT, PULSE, GATE_S)
    return {
        name: Timing(statistics.median(times_s[name]), min(times_s[name]), relative_error(entry, exact))
        for name, entry in entries.items()
    }


def relative_error(contender: Contender, exact: np.ndarray) -> float | None:
    """Return the relative rms error of all echoes; None if the contender computes fewer."""
    if contender.echo_count != ECHOES:
        return None
    echoes = np.asarray(contender.echo_of(contender.compute()))
    return float(np.sqrt(np.mean((echoes - exact) ** 2) / np.mean(exact**2)))


def print_timings(table: dict[str, Timing], rounds: int) -> None:
    """Print times and ratios to the faster direct sum and to ``REFERENCE``."""
    direct = [timing for name, timing in table.items() if name.startswith("NumPy direct")]
    direct_s, direct_best_s = min(item.median_s for item in direct), min(item.best_s for item in direct)
    reference = table[REFERENCE]
    print(f"Table I, {len(WEIGHT)} scatterers, {ECHOES} echoes x {len(GATE_S)} samples; medians of {rounds} rounds")
    print(f"{os.cpu_count()} cores, one used; ratios to the faster of the direct sums, and to '{REFERENCE}'")
    print("best: the fastest run and the ratio of the fastest, which a busy machine disturbs least")
    print(f"{'':28}{'ms':>11}{'best':>11}{'direct / this':>15}{'best':>9}{'this / ours':>13}{'best':>10}{'error':>10}")
    for name, timing in table.items():
        times = f"{timing.median_s * 1e3:11.3f}{timing.best_s * 1e3:11.3f}"
        speedup = f"{direct_s / timing.median_s:15.2f}{direct_best_s / timing.best_s:9.2f}"
        slowdown = f"{timing.median_s / reference.median_s:13.1f}{timing.best_s / reference.best_s:10.1f}"
        error = "" if timing.error is None else f"{timing.error:.1e}"
        print(f"{name:28}{times}{speedup}{slowdown}{error:>10}")
    for name in MISSING_PEERS:
        print(f"not run: {name}")
    for name, model in PEER_MODELS.items():
        print(f"{name} computes {model}")
    print("The engine computes neither apertures nor diffraction: the beams are the Gaussians of eq. (8) and (12).")


def draw_time_s(draws: int, tolerance: float) -> float:
    """Return the time per study draw (new scatterers, weights, 101 echoes), median of five batches of ``draws``."""
    settings = SimulationSettings()

    def compute_draws() -> None:
        rng = np.random.default_rng(0)
        for _ in drawn_echoes(settings, DISPLACEMENT_M, PULSE, GATE_S, rng, draws, tolerance):
            pass

    return statistics.median(processor_times_s(compute_draws, 5)) / draws


def displacement_error_m(echoes_of: Callable[[np.ndarray], np.ndarray]) -> float:
    """Return the rms displacement error of a simulator, from one scatterer at 70 mm that moves by 100 nm.

    ``echoes_of`` maps displacements (echo,), m, to echoes (echo, sample). The error is the residual of the echo phase
    about a straight line in the displacement. The fitted slope makes it independent of pulse and centre frequency.
    """
    displacement_m = 100e-9 * np.sin(2 * np.pi * np.arange(100) / 20 + 0.3)
    spectrum = np.fft.rfft(np.asarray(echoes_of(displacement_m), dtype=np.float64), axis=1)
    phase_rad = np.angle(np.sum(spectrum * np.conj(spectrum[0]), axis=1))
    offset, slope = np.polynomial.Polynomial.fit(displacement_m, phase_rad, 1).convert().coef
    return float(np.sqrt(np.mean((phase_rad - offset - slope * displacement_m) ** 2)) / abs(slope))


def displacement_errors_nm() -> dict[str, float]:
    """Return the displacement error of the engine, of positions in float32, and of the peers."""
    zero, one = np.zeros(1), np.ones(1)

    def engine(displacement_m: np.ndarray, tolerance: float) -> np.ndarray:
        motion = EchoDelays(zero, one[None], displacement_m[:, None] * 2 / SOUND_SPEED)
        return synthesise(motion, one, PULSE, GATE_S, tolerance).echo

    def single_precision(displacement_m: np.ndarray) -> np.ndarray:
        depth_m = (DEPTH_M + displacement_m).astype(np.float32).astype(float) - float(np.float32(DEPTH_M))
        return direct_sum(2 / SOUND_SPEED * depth_m[:, None], one, PULSE, GATE_S)

    simulators: dict[str, Callable[[np.ndarray], np.ndarray]] = {
        f"engine, {tolerance:g}": lambda z_m, tolerance=tolerance: engine(z_m, tolerance) for tolerance in TOLERANCES
    }
    simulators["direct sum, positions in float32"] = single_precision
    for name, peer in PEERS.items():
        simulators[name] = lambda z_m, peer=peer: np.stack([peer(zero, z[None], one) for z in z_m])
    return {name: displacement_error_m(simulator) * 1e9 for name, simulator in simulators.items()}


def main() -> None:
    """Run all contenders and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--output", type=Path, help="also write the numbers to this JSON file")
    options = parser.parse_args()
    table = timings(options.rounds)
    print_timings(table, options.rounds)
    draws_s = {f"{tolerance:g}": draw_time_s(1000, tolerance) for tolerance in (1e-6, 1e-8)}
    for name, time_s in draws_s.items():
        print(f"study draw, {name}: {time_s * 1e3:.3f} ms")
    errors_nm = displacement_errors_nm()
    for name, error_nm in errors_nm.items():
        print(f"rms displacement error, one scatterer at 70 mm moving 100 nm, {name}: {error_nm:.2e} nm")
    if options.output:
        numbers = {
            "time_s": {name: timing.median_s for name, timing in table.items()},
            "best_s": {name: timing.best_s for name, timing in table.items()},
            "error": {name: timing.error for name, timing in table.items()},
            "missing": MISSING_PEERS,
            "draw_s": draws_s,
            "moved_nm": errors_nm,
        }
        options.output.write_text(json.dumps(numbers, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
