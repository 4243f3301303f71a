"""Time the echo engine against the direct sum and public simulators: same scatterers, echoes and samples, one run.

Usage: python scripts/benchmarks/benchmark_echo.py [--rounds 7] [--output table.json].
Peers are optional (`echo_peers.py`); missing ones are named.
Processor time of one core. Every contender runs once a round and medians over rounds are compared, so that a busy
machine slows all alike.
"""

# ruff: noqa: E402
from __future__ import annotations

import os

# One core each, whatever the libraries would like: before any of them is imported.
for _threads in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ[_threads] = "1"

import argparse
import json
import statistics
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from echo_peers import CARRIER_HZ, DEPTH_M, GATE_S, PEER_SAYS, PULSE, C, found_peers

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
FIELD = draw_field(Scatterers(), Beams(), np.random.default_rng(0))
REST_S = depth_delay_s(FIELD, "two_way", C)
WEIGHT, G = FIELD.tracking_weight, FIELD.motion_weight
AMPLITUDE_S = DISPLACEMENT_M[:, None] * 2 / C
PEERS, MISSING = found_peers()


def vectorised_direct(delay_s: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Return the double sum with one array of samples by scatterers an echo: eq. (10) as printed."""
    out = np.empty((len(delay_s), len(GATE_S)))
    window, carrier = 2 * np.pi * CARRIER_HZ * 0.065, 2 * np.pi * CARRIER_HZ
    for echo, tau in zip(out, delay_s, strict=True):
        age = GATE_S[:, None] - tau
        echo[:] = (
            np.where(np.abs(age) < PULSE.end_s, (0.5 + 0.5 * np.cos(window * age)) * np.cos(carrier * age), 0.0)
            @ weight
        )
    return out


def masked_direct(delay_s: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Return the same by matrix products of each echo's supports, which spares the cosines: the fairest denominator."""
    omega = 2 * np.pi * np.array(PULSE.frequency_hz)
    rotation = np.array(PULSE.amplitude)[:, None] * np.exp(1j * omega[:, None] * GATE_S)
    out = np.empty((len(delay_s), len(GATE_S)))
    for echo, tau in zip(out, delay_s, strict=True):
        inside = (np.abs(GATE_S[:, None] - tau) < PULSE.end_s).astype(float)
        turns = weight * np.exp(-1j * omega[:, None] * tau)
        sums = inside @ np.concatenate([turns.real, turns.imag]).T
        echo[:] = (rotation.T * (sums[:, :3] + 1j * sums[:, 3:])).real.sum(axis=1)
    return out


def contenders() -> tuple[dict[str, tuple[Callable[[], object], float]], list[str]]:
    """Return what runs, and how much of the 101 echoes one run makes; and who is missing."""
    motion = EchoDelays(REST_S, G[None], AMPLITUDE_S)
    delay_s = motion.delay_s()
    still = ScattererRows(np.zeros(len(REST_S), dtype=np.int64), REST_S, WEIGHT, G[None], AMPLITUDE_S[None])
    ten = delay_s[:10]
    runs: dict[str, tuple[Callable[[], object], float]] = {
        "NumPy direct, vectorised": (lambda: vectorised_direct(ten, WEIGHT), 10 / 101),
        "NumPy direct, by products": (lambda: masked_direct(ten, WEIGHT), 10 / 101),
        "running sum": (lambda: running_sum(delay_s, WEIGHT, PULSE, GATE_S), 1.0),
    }
    for tolerance in (1e-6, 1e-8, 1e-13):
        runs[f"engine, {tolerance:g}"] = (
            lambda tolerance=tolerance: synthesise(motion, WEIGHT, PULSE, GATE_S, tolerance),
            1.0,
        )
        runs[f"batch, {tolerance:g}"] = (lambda tolerance=tolerance: batch(still, PULSE, GATE_S, tolerance), 1.0)
    x_m, z_m = FIELD.offset_m[:, 0], FIELD.offset_m[:, 2]
    for name, peer in PEERS.items():
        runs[name] = (lambda peer=peer: peer(x_m, z_m, WEIGHT), 1 / 101)
    if "finufft" in PEERS:
        # It sums the same echoes as ours, so all of them are made, moved, and compared.
        runs["finufft"] = (lambda: np.stack([PEERS["finufft"](x_m, C / 2 * tau, WEIGHT) for tau in delay_s]), 1.0)
    return runs, MISSING


def draw_time_s(draws: int, tolerance: float) -> float:
    """Return seconds a study draw, new scatterers, weights, 101 echoes: median of five batches of ``draws``."""
    settings = SimulationSettings()

    def batch_of_draws() -> None:
        rng = np.random.default_rng(0)
        for _ in drawn_echoes(settings, DISPLACEMENT_M, PULSE, GATE_S, rng, draws, tolerance):
            pass

    return _median_s(batch_of_draws, 5) / draws


def displacement_error_m(make: Callable[[np.ndarray], np.ndarray]) -> float:
    """Return the rms error, as motion, of ``make(moved_m (echo,))``: one scatterer at 70 mm that moves 100 nm.

    The phase of every echo against the first, and what is left of it when a straight line in the true motion has been
    taken off: whatever the contender's pulse and centre frequency are, its own phase per metre is fitted.
    """
    moved_m = 100e-9 * np.sin(2 * np.pi * np.arange(100) / 20 + 0.3)
    echo = np.asarray(make(moved_m), dtype=np.float64)
    spectrum = np.fft.rfft(echo, axis=1)
    phase = np.angle(np.sum(spectrum * np.conj(spectrum[0]), axis=1))
    line = np.polynomial.Polynomial.fit(moved_m, phase, 1).convert().coef
    return float(np.sqrt(np.mean((phase - line[0] - line[1] * moved_m) ** 2)) / abs(line[1]))


def accuracy_rows() -> dict[str, float]:
    """Return displacement error in nm: the engine, its positions in float32, and the peers."""

    def engine(moved_m: np.ndarray, tolerance: float) -> np.ndarray:
        motion = EchoDelays(np.zeros(1), np.ones((1, 1)), moved_m[:, None] * 2 / C)
        return synthesise(motion, np.ones(1), PULSE, GATE_S, tolerance).echo

    def single(moved_m: np.ndarray) -> np.ndarray:
        depth_m = (DEPTH_M + moved_m).astype(np.float32).astype(float) - float(np.float32(DEPTH_M))
        return direct_sum(2 / C * depth_m[:, None], np.ones(1), PULSE, GATE_S)

    rows = {
        f"engine, {tolerance:g}": displacement_error_m(lambda m, tolerance=tolerance: engine(m, tolerance)) * 1e9
        for tolerance in (1e-6, 1e-8, 1e-13)
    }
    rows["direct sum, positions in float32"] = displacement_error_m(single) * 1e9
    nothing, one = np.zeros(1), np.ones(1)
    for name, peer in PEERS.items():
        rows[name] = displacement_error_m(lambda m, peer=peer: np.stack([peer(nothing, z[None], one) for z in m])) * 1e9
    return rows


def scaling() -> list[tuple[str, int, float]]:
    """Return seconds against scatterers (101 echoes) and against echoes (Table I's scatterers), tolerance 1e-8."""
    rows = []
    for count in (1_000, 10_000, 100_000, 1_000_000):
        place = np.random.default_rng(1).uniform(-0.5, 0.5, (count, 3)) * np.array([1e-3, 1e-3, 5e-3])
        tau = np.sort(2 * place[:, 2] / C)
        motion, weight = (
            EchoDelays(tau, np.exp(-np.square(place[:, :1].T) / 5e-8), AMPLITUDE_S),
            np.exp(-np.square(place[:, 1]) / 1e-8),
        )
        rows.append(
            ("scatterers", count, _median_s(lambda m=motion, w=weight: synthesise(m, w, PULSE, GATE_S, 1e-8), 3))
        )
    for echoes in (10, 100, 1_000, 10_000):
        amplitude_s = 2e-6 / C * np.sin(np.arange(echoes))[:, None]
        motion = EchoDelays(REST_S, G[None], amplitude_s)
        rows.append(("echoes", echoes, _median_s(lambda m=motion: synthesise(m, WEIGHT, PULSE, GATE_S, 1e-8), 5)))
    return rows


def _times_s(run: Callable[[], object], rounds: int) -> list[float]:
    taken = []
    for _ in range(rounds):
        begin = time.process_time()
        run()
        taken.append(time.process_time() - begin)
    return taken


def _median_s(run: Callable[[], object], rounds: int) -> float:
    return statistics.median(_times_s(run, rounds))


def main() -> None:
    """Run every contender in turn and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--output", type=Path)
    options = parser.parse_args()
    runs, missing = contenders()
    taken: dict[str, list[float]] = {name: [] for name in runs}
    # A slow contender once a round, a fast one 25 times.
    repeats = {name: 1 if min(_times_s(run, 2)) > 0.05 else 25 for name, (run, _) in runs.items()}
    for _ in range(options.rounds):
        for name, (run, share) in runs.items():
            taken[name] += [one / share for one in _times_s(run, repeats[name])]
    time_s = {name: statistics.median(values) for name, values in taken.items()}
    best_s = {name: min(values) for name, values in taken.items()}
    exact = direct_sum(REST_S + AMPLITUDE_S @ G[None], WEIGHT, PULSE, GATE_S)
    ours = "batch, 1e-08"
    base_s, base_best_s = (
        min(some["NumPy direct, vectorised"], some["NumPy direct, by products"]) for some in (time_s, best_s)
    )
    print(f"Table I, {len(WEIGHT)} scatterers, 101 echoes x 130 samples; medians of {options.rounds} rounds")
    print(f"{os.cpu_count()} cores, one used; ratios to the faster of the direct sums, and to '{ours}'")
    print("best: the fastest run and the ratio of the fastest, which a busy machine disturbs least")
    print(f"{'':28}{'ms':>11}{'best':>11}{'direct / this':>15}{'best':>9}{'this / ours':>13}{'best':>10}{'error':>10}")
    errors = {}
    for name, (run, share) in runs.items():
        made = run()
        echo = (
            np.asarray(getattr(made, "echo", made)[0] if name.startswith("batch") else getattr(made, "echo", made))
            if share == 1
            else None
        )
        error = (
            float(np.sqrt(np.mean((echo - exact) ** 2) / np.mean(exact**2)))
            if echo is not None and echo.shape == exact.shape
            else None
        )
        errors[name] = error
        shown = "" if error is None else f"{error:.1e}"
        faster = f"{base_s / time_s[name]:15.2f}{base_best_s / best_s[name]:9.2f}"
        slower = f"{time_s[name] / time_s[ours]:13.1f}{best_s[name] / best_s[ours]:10.1f}"
        print(f"{name:28}{time_s[name] * 1e3:11.3f}{best_s[name] * 1e3:11.3f}{faster}{slower}{shown:>10}")
    for name in missing:
        print(f"not run: {name}")
    for name, says in PEER_SAYS.items():
        print(f"{name} computes {says}")
    print("Ours computes neither apertures nor diffraction: the beams are the Gaussians of eq. (8) and (12).")
    draws = {f"{tolerance:g}": draw_time_s(1000, tolerance) for tolerance in (1e-6, 1e-8)}
    for name, value in draws.items():
        print(f"study draw, {name}: {value * 1e3:.3f} ms")
    moved = accuracy_rows()
    for name, value in moved.items():
        print(f"rms displacement error, one scatterer at 70 mm moving 100 nm, {name}: {value:.2e} nm")
    grown = scaling()
    for kind, count, value in grown:
        print(f"{count:>8} {kind}: {value * 1e3:9.2f} ms")
    if options.output:
        table = {
            "time_s": time_s,
            "best_s": best_s,
            "error": errors,
            "missing": missing,
            "draw_s": draws,
            "moved_nm": moved,
            "scaling": grown,
        }
        options.output.write_text(json.dumps(table, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
