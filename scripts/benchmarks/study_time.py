"""Time of `hpe-rig study paper`, what drawing its random numbers alone costs, and the error each way buys in what time.

At the paper's own sizes: 1000 realisations of every point of Fig. 4 to 11, 500 draws of scatterers with two of the
noise, and 100 of every point of Fig. 12 and 13; read physically by two estimators and literally by one. The first table
is one run in this process: processor time, and of it what the generators of random numbers took, the floor. With
``--workers`` the same run follows in processes, by the clock.

The second table: random numbers of their own at every point, the same ones along an axis (``common``), and a stop at a
stated standard error (``standard_error_m``), over ``--seeds`` seeds. Error is the standard deviation over the seeds.
The last two lines are the same bias without a study, with and without a control variate, which studies do not have.

    python scripts/benchmarks/study_time.py --workers 2
"""

# ruff: noqa: E402
from __future__ import annotations

import os

from hpe_rig.arrays import FloatArray

# One thread, as a worker of a study has: two that wait for one another count as processor time. Before any import of
# what has threads.
for _threads in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_threads] = "1"

import argparse
import statistics
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Executor, Future
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from hpe_rig.processing import estimate
from hpe_rig.study import StudyResult, processes, run_study
from hpe_rig.validation import MotionCase, gate, twin_echoes

POINTS = {
    "scatterers": 500,
    "noise": 2,
    "readings": {"physical": ["cross_spectrum", "coherent"], "literal": ["cross_spectrum"]},
}
MAPS = {"scatterers": 50, "noise": 2, "readings": {"physical": ["cross_spectrum"], "literal": ["cross_spectrum"]}}
PAPER = ((range(4, 12), POINTS), (range(12, 14), MAPS))
SNR_DB = (20.0, 40.0)
STATED_M = 5e-9
CONTROL_DRAWS = 20_000
WAYS: dict[str, Mapping[str, Any]] = {
    "own random numbers": {"common": []},
    "common random numbers": {"common": ["SNR"]},
    f"stop at {STATED_M * 1e9:g} nm": {"common": ["SNR"], "standard_error_m": STATED_M},
}
DEFINITION = f"""
title = "Table I at two levels of noise"
scene = "table-1"
scatterers = 400
readings = {{ physical = ["coherent"] }}
[set]
"tracking.pulse_count" = 100
[[axes]]
name = "SNR"
unit = "dB"
keys = {{ "simulation.receiver.snr_db" = {list(SNR_DB)} }}
"""


class Timed(np.random.Generator):
    """A generator that adds up the processor time of what studies draw."""

    seconds = 0.0


def _timed(name: str) -> Callable[..., Any]:
    def draw(rng: Timed, *args: Any, **kwargs: Any) -> Any:
        since = time.process_time()
        drawn = getattr(np.random.Generator, name)(rng, *args, **kwargs)
        Timed.seconds += time.process_time() - since
        return drawn

    return draw


for _name in ("standard_normal", "random", "standard_exponential", "binomial"):
    setattr(Timed, _name, _timed(_name))


class _Here(Executor):
    """Computes at once, in this process."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = Future()
        future.set_result(fn(*args, **kwargs))
        return future


@contextmanager
def here() -> Iterator[Executor]:
    """Open this process as the one worker."""
    yield _Here()


def paper(folder: Path, **how: Any) -> list[StudyResult]:
    """Run the figures of the paper at its sizes."""
    results = []
    for figures, sizes in PAPER:
        collection = folder / f"from-{figures.start}.toml"
        names = [f"fig-{number}" for number in figures]
        collection.write_text(f'title = "Fig. {names}"\nstudies = {names}\n', encoding="utf-8")
        results += run_study(collection, folder / "paper", replaced=sizes, **how)
    return results


def timed_paper() -> None:
    """Print processor time and memory of the paper's figures, and what of it draws random numbers."""
    np.random.default_rng = lambda seed=None: Timed(np.random.PCG64(seed))  # type: ignore[arg-type]
    with tempfile.TemporaryDirectory() as folder:
        results = paper(Path(folder), open_pool=here)
    cases = {key: row for result in results for key, row in result.cases.items()}
    total = sum(row["seconds"] for row in cases.values())
    print(f"{len(cases)} cases, {sum(row['draws'] * row['noise'] for row in cases.values())} realisations")
    print(f"processor time {total:.1f} s, of which {Timed.seconds:.1f} s draw random numbers")
    print(f"peak memory {max(result.peak_memory_mib for result in results):.0f} MiB")


def clocked_paper(workers: int) -> None:
    """Print how long the same takes in processes."""
    since = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        results = paper(Path(folder), open_pool=partial(processes, workers))
    peak = max(result.peak_memory_mib for result in results)
    print(f"{workers} workers: {time.perf_counter() - since:.1f} s by the clock, {peak:.0f} MiB a worker\n")


def ways(seeds: int) -> None:
    """Print of every way the bias and its change with SNR, their errors, and the processor time of one study."""
    print(f"{'':24}{'bias at 20 dB':>18}{'change to 40 dB':>20}{'draws':>8}{'time':>10}")
    with tempfile.TemporaryDirectory() as folder:
        study = Path(folder) / "own.toml"
        study.write_text(DEFINITION, encoding="utf-8")
        for name, way in WAYS.items():
            rows, seconds = [], []
            for seed in range(1, seeds + 1):
                replaced = {**way, "seed": seed}
                (result,) = run_study(study, Path(folder) / name / f"{seed}", here, replaced=replaced)
                rows.append(result.rows)
                seconds.append(result.seconds)
            bias_nm = [[row["amplitude_bias_m"] * 1e9 for row in each] for each in rows]
            shown = (spread([low for low, _ in bias_nm]), spread([high - low for low, high in bias_nm]))
            draws = statistics.mean(row["draws"] for each in rows for row in each)
            print(f"{name:24}{shown[0]:>18}{shown[1]:>20}{draws:8.0f}{statistics.median(seconds) * 1e3:7.0f} ms")


def control_variate(seeds: int) -> None:
    """Print what a control variate would gain: the same bias with its draws' energy times what they are off by.

    Tracked motion is a ratio of sums over pairs of scatterers, N / D. Of D (N / D - E N / E D), without noise, the mean
    is zero, and it goes with the estimate. E N / E D is taken from more draws, whose time is not counted.
    """

    def drawn(seed: int, draws: int) -> tuple[FloatArray, FloatArray, FloatArray, list[float]]:
        generator, times = np.random.default_rng(seed), [time.process_time()]
        clean = twin_echoes(case, draws, generator)
        energy = np.square(clean).mean(axis=(1, 2))
        noise = generator.standard_normal(clean.shape) * np.sqrt(energy / 10 ** (case.snr_db / 10))[:, None, None]
        found = []
        for volts in (clean + noise, clean):
            found.append(1e9 * estimate(gate(case, volts), [case.frequency_hz], "coherent").amplitude_m[:, 0])
            times.append(time.process_time())
        return found[0], found[1], energy, times

    case = MotionCase(snr_db=SNR_DB[0])
    _, clean_nm, energy, _ = drawn(0, CONTROL_DRAWS)
    mean_nm = (energy * clean_nm).mean() / energy.mean()
    plain, controlled, times = [], [], []
    for seed in range(1, seeds + 1):
        noisy_nm, clean_nm, energy, read = drawn(seed, 400)
        control = energy * (clean_nm - mean_nm)
        slope = np.cov(noisy_nm, control)[0, 1] / control.var(ddof=1)
        error_nm = noisy_nm - case.amplitude_m * 1e9
        plain.append(float(error_nm.mean()))
        controlled.append(float((error_nm - slope * control).mean()))
        times.append(read)
    for name, values, last in (("plain", plain, 1), ("control variate", controlled, 2)):
        seconds = statistics.median(read[last] - read[0] for read in times)
        print(f"{name:24}{spread(values):>18}{'':20}{400:8}{seconds * 1e3:7.0f} ms")


def spread(values_nm: list[float]) -> str:
    """Return the mean of ``values_nm`` and their standard deviation, that of a single study."""
    return f"{statistics.mean(values_nm):.2f} +- {statistics.stdev(values_nm):.2f} nm"


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--seeds", type=int, default=24, help="studies of every way")
    parser.add_argument("--workers", type=int, help="processes, by the clock as well")
    parser.add_argument("--ways", action="store_true", help="the ways to a figure alone")
    asked = parser.parse_args()
    if asked.seeds < 2:
        parser.error("--seeds: at least 2, of which the standard deviation is printed")
    if not asked.ways:
        timed_paper()
        if asked.workers:
            clocked_paper(asked.workers)
    ways(asked.seeds)
    control_variate(asked.seeds)


if __name__ == "__main__":
    main()
