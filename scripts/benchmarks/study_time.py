"""Time the studies of the paper and compare the error that several sampling methods reach per run time.

First table: the paper's studies at their own sizes, in one process with one thread. That is 1000 realisations of every
point of Fig. 4 to 11 (500 draws of scatterers with two of the noise) and 100 of every point of Fig. 12 and 13. Printed:
processor time, and the part of it that draws random numbers, a lower limit. `--workers` repeats it in processes.

Second table: independent random numbers at every point, the same numbers along an axis (`common`), and a stop at a
stated standard error (`standard_error_m`). Errors are standard deviations over the seeds.

    python scripts/benchmarks/study_time.py --workers 2
"""

# ruff: noqa: E402
from __future__ import annotations

import os

# One thread, as in a worker of a study: threads that wait for each other would count as processor time. The libraries
# read these variables when NumPy is imported.
for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_variable] = "1"

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

from hpe_rig.study import StudyResult, processes, run_study

CURVE_SIZES = {
    "scatterers": 500,
    "noise": 2,
    "readings": {"physical": ["cross_spectrum", "coherent"], "literal": ["cross_spectrum"]},
}
MAP_SIZES = {"scatterers": 50, "noise": 2, "readings": {"physical": ["cross_spectrum"], "literal": ["cross_spectrum"]}}
PAPER_STUDIES = ((range(4, 12), CURVE_SIZES), (range(12, 14), MAP_SIZES))
"""Numbers of the figures, and the sizes of their studies."""
SNR_DB = (20.0, 40.0)
DRAWS = 400
STANDARD_ERROR_M = 5e-9
METHODS: dict[str, Mapping[str, Any]] = {
    "independent numbers": {"common": []},
    "common numbers": {"common": ["SNR"]},
    f"stop at {STANDARD_ERROR_M * 1e9:g} nm": {"common": ["SNR"], "standard_error_m": STANDARD_ERROR_M},
}
STUDY = f"""
title = "Table I at two levels of noise"
scene = "table-1"
scatterers = {DRAWS}
readings = {{ physical = ["coherent"] }}
[set]
"tracking.pulse_count" = 100
[[axes]]
name = "SNR"
unit = "dB"
keys = {{ "simulation.receiver.snr_db" = {list(SNR_DB)} }}
"""


class TimedGenerator(np.random.Generator):
    """Random generator that sums the processor time of the distributions that studies use."""

    seconds = 0.0


def _timed(name: str) -> Callable[..., Any]:
    def draw(rng: TimedGenerator, *args: Any, **kwargs: Any) -> Any:
        start_s = time.process_time()
        values = getattr(np.random.Generator, name)(rng, *args, **kwargs)
        TimedGenerator.seconds += time.process_time() - start_s
        return values

    return draw


for _name in ("standard_normal", "random", "standard_exponential", "binomial"):
    setattr(TimedGenerator, _name, _timed(_name))


class SynchronousExecutor(Executor):
    """Executor that computes each task when it is submitted, in this process."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = Future()
        future.set_result(fn(*args, **kwargs))
        return future


@contextmanager
def this_process() -> Iterator[Executor]:
    """Open this process as the only worker of a study."""
    yield SynchronousExecutor()


def run_paper_studies(open_pool: Callable[[], Any]) -> list[StudyResult]:
    """Run the studies of the paper's figures at its sizes."""
    results = []
    with tempfile.TemporaryDirectory() as folder:
        for figures, sizes in PAPER_STUDIES:
            collection = Path(folder) / f"from-{figures.start}.toml"
            names = [f"fig-{number}" for number in figures]
            collection.write_text(f'title = "Fig. {names}"\nstudies = {names}\n', encoding="utf-8")
            results += run_study(collection, Path(folder) / "paper", replaced=sizes, open_pool=open_pool)
    return results


def print_processor_time_of_paper() -> None:
    """Print processor time and memory of the paper's studies in this process, and the time spent in random numbers."""
    np.random.default_rng = lambda seed=None: TimedGenerator(np.random.PCG64(seed))
    results = run_paper_studies(this_process)
    # Figures share cases; each case is computed and counted once.
    cases = {key: row for result in results for key, row in result.cases.items()}
    total_s = sum(row["seconds"] for row in cases.values())
    print(f"{len(cases)} cases, {sum(row['draws'] * row['noise'] for row in cases.values())} realisations")
    print(f"processor time {total_s:.1f} s, including {TimedGenerator.seconds:.1f} s for random numbers")
    print(f"peak memory {max(result.peak_memory_mib for result in results):.0f} MiB")


def print_elapsed_time_of_paper(workers: int) -> None:
    """Print elapsed time and memory of the paper's studies in ``workers`` processes."""
    start_s = time.perf_counter()
    results = run_paper_studies(partial(processes, workers))
    peak_mib = max(result.peak_memory_mib for result in results)
    print(f"{workers} workers: {time.perf_counter() - start_s:.1f} s elapsed, {peak_mib:.0f} MiB per worker\n")


def print_sampling_methods(seeds: int) -> None:
    """Print for each method the bias, its change with SNR, their errors, and the processor time of one study."""
    print(f"{'':24}{'bias at 20 dB':>18}{'change to 40 dB':>20}{'draws':>8}{'time':>10}")
    with tempfile.TemporaryDirectory() as folder:
        study = Path(folder) / "two-levels.toml"
        study.write_text(STUDY, encoding="utf-8")
        for name, settings in METHODS.items():
            results = []
            for seed in range(1, seeds + 1):
                target = Path(folder) / name / f"{seed}"
                results += run_study(study, target, this_process, replaced={**settings, "seed": seed})
            biases_nm = [[row["amplitude_bias_m"] * 1e9 for row in result.rows] for result in results]
            bias = mean_and_deviation([low for low, _ in biases_nm])
            change = mean_and_deviation([high - low for low, high in biases_nm])
            draws = statistics.mean(row["draws"] for result in results for row in result.rows)
            time_ms = statistics.median(result.seconds for result in results) * 1e3
            print(f"{name:24}{bias:>18}{change:>20}{draws:8.0f}{time_ms:7.0f} ms")


def mean_and_deviation(values_nm: list[float]) -> str:
    """Return the mean over the seeds and the standard deviation of a single study."""
    return f"{statistics.mean(values_nm):.2f} +- {statistics.stdev(values_nm):.2f} nm"


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--seeds", type=int, default=24, help="studies of each method in the second table")
    parser.add_argument("--workers", type=int, help="also print the elapsed time in this number of processes")
    parser.add_argument("--ways", action="store_true", help="print the second table only")
    options = parser.parse_args()
    if options.seeds < 2:
        parser.error("--seeds must be at least 2: the table has standard deviations over the seeds")
    if not options.ways:
        print_processor_time_of_paper()
        if options.workers:
            print_elapsed_time_of_paper(options.workers)
    print_sampling_methods(options.seeds)


if __name__ == "__main__":
    main()
