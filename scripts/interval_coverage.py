"""Measure how often the stated intervals hold the truth: every shipped scene, every estimator, many seeds on the twin.

A seed draws scatterers, noise and trigger jitter anew, the medium where the scene declares none, and the twin's sound
speed about the scene's by its stated uncertainty, with the gate on the focus as an operator puts it there. What each
headline estimate says, amplitude and phase of the peak displacement with combined standard uncertainties u, is compared
with the twin's truth: share of errors within u and within 1.96 u, and NEV, the mean of (error / u)^2. A run's
frequencies and shots share their speckle, so that the Monte Carlo error of a row is that of its seeds, not of its
errors.

    python scripts/interval_coverage.py                   # writes docs/coverage.md, about three hours on one core
    python scripts/interval_coverage.py --seeds 20 --scenes table-1 bovine-muscle --estimators coherent kasai
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

import hpe_rig as hpe
from hpe_rig.processing import ESTIMATORS
from hpe_rig.result import Result
from hpe_rig.scene import Scene, shipped_scenes, with_default_specimen
from hpe_rig.store import StoreError

PAGE = Path(__file__).parent.parent / "docs" / "coverage.md"
SEEDS = 200
MODULUS_PA, VISCOSITY_PA_S = (1e3, 60e3), (0.2, 15.0)
"""Between which media are drawn: the ranges of docs/theory/medium-prior.md."""
WIDTH_SPREAD = 0.3
"""Standard deviation of the logarithm of the force's widths, from the same page."""
K_95 = 1.959964
"""Half width of the 95 % interval of a normal error, in standard deviations."""


@dataclass(frozen=True)
class Row:
    """Coverage of one scene and estimator: of amplitude and of phase, over ``errors`` errors from ``seeds`` runs."""

    scene: str
    estimator: str
    seeds: int
    refused: int
    within_68: tuple[float, float]
    within_95: tuple[float, float]
    nev: tuple[float, float]


def main() -> None:
    """Measure and write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=SEEDS)
    parser.add_argument("--scenes", nargs="+", default=list(shipped_scenes()))
    parser.add_argument("--estimators", nargs="+", default=list(ESTIMATORS))
    parser.add_argument("--workers", type=int, default=os.cpu_count())
    parser.add_argument("--output", type=Path, default=PAGE)
    asked = parser.parse_args()
    rows: list[Row] = []
    for name in asked.scenes:
        rows += coverage(name, asked.estimators, range(asked.seeds), asked.workers)
        asked.output.write_text(page(rows, asked.seeds), encoding="utf-8")
        print(f"{name}: {asked.seeds} seeds", flush=True)


def coverage(name: str, estimators: Sequence[str], seeds: Sequence[int], workers: int | None = 1) -> list[Row]:
    """Return a row for each estimator of the shipped scene ``name``."""
    measure = partial(errors_over_u, name, tuple(estimators))
    if workers == 1:
        runs = [measure(seed) for seed in seeds]
    else:
        with ProcessPoolExecutor(workers) as pool:
            runs = list(pool.map(measure, seeds))
    return [_row(name, estimator, [run[estimator] for run in runs]) for estimator in estimators]


def errors_over_u(name: str, estimators: tuple[str, ...], seed: int) -> dict[str, NDArray[np.float64] | None]:
    """Return error over u of amplitude and phase, (estimate, 2), by estimator; None where it refuses the records."""
    scene = drawn(with_default_specimen(hpe.load_scene(name)), seed)
    with TemporaryDirectory() as folder:
        run = hpe.measure(scene, path=Path(folder) / "run.h5")
        return {estimator: _ratios(run, estimator) for estimator in estimators}


def drawn(scene: Scene, seed: int) -> Scene:
    """Return ``scene`` with everything drawn by ``seed`` that a stated uncertainty covers."""
    speed, rng = scene.acquisition.sound_speed_m_per_s, np.random.default_rng(seed)
    relative = scene.acquisition.sound_speed_uncertainty * rng.standard_normal()
    values: dict[str, Any] = {
        "simulation.seed": seed + 1,
        "simulation.sound_speed_m_per_s": speed * (1 + relative),
        "simulation.beams.focus_depth_m": scene.acquisition.gate_depth_m * (1 + relative),
    }
    if scene.medium is None and "specimen" in (scene.simulation or {}):
        # What nobody declares is not known: a Voigt medium of the ensemble's ranges, evenly in logarithm.
        for name, (low, high) in (("shear_modulus_pa", MODULUS_PA), ("shear_viscosity_pa_s", VISCOSITY_PA_S)):
            values[f"simulation.specimen.{name}"] = float(low * (high / low) ** rng.uniform())
        # Nor has anyone measured how wide the force is in the medium: the prior takes its widths for that uncertain.
        wide, deep = np.exp(WIDTH_SPREAD * rng.standard_normal(2)).tolist()
        if scene.beams is not None:
            x, y, z = scene.beams.excitation_width_m
            values["simulation.beams.excitation_width_m"] = (x * wide, y * wide, z * deep)
    return scene.with_(values)


def _ratios(run: hpe.Run, estimator: str) -> NDArray[np.float64] | None:
    try:
        result = run.estimate(estimator)
    except StoreError:
        return None
    return np.array(list(_each_ratio(result)))


def _each_ratio(result: Result) -> Iterator[tuple[float, float]]:
    for shot in result.shots:
        for item in shot.estimates:
            stated = item.headline
            error_m = (item.corrected_amplitude_error or 0.0) * (item.true_amplitude_m or 0.0)
            error_rad = item.corrected_phase_error_rad or 0.0
            yield error_m / stated.amplitude_uncertainty_m, error_rad / stated.phase_uncertainty_rad


def _row(name: str, estimator: str, runs: Sequence[NDArray[np.float64] | None]) -> Row:
    """Return the coverage over ``runs``, the errors over u of each."""
    found = [run for run in runs if run is not None]
    ratio = np.concatenate(found) if found else np.full((1, 2), np.nan)
    within = (np.abs(ratio)[:, None] < np.array([1.0, K_95])[:, None]).mean(axis=0)
    nev = (ratio**2).mean(axis=0)
    pairs = [(float(pair[0]), float(pair[1])) for pair in (*within, nev)]
    return Row(name, estimator, len(found), len(runs) - len(found), *pairs)


def page(rows: Sequence[Row], seeds: int) -> str:
    """Return the page in Markdown."""
    scenes = dict.fromkeys(row.scene for row in rows)
    some = "" if len(scenes) == len(shipped_scenes()) else f" --scenes {' '.join(scenes)}"
    error = 100 * np.sqrt(np.array([0.68 * 0.32, 0.95 * 0.05]) / seeds)
    lines = [
        "# Coverage",
        "",
        "How often the 68 and 95 % intervals of the headline amplitude and phase (corrected to the peak displacement, "
        "combined u; [what they mean](numbers.md)) hold the twin's truth, and NEV, the mean of (error / u)^2, which is "
        "1 where u is true. Each seed draws scatterers, noise, trigger jitter and, by its stated uncertainty, the "
        "sound speed; where the scene declares no medium a Voigt medium of 1 to 60 kPa and 0.2 to 15 Pa s too, and the "
        "width of the force by 30 %. Frequencies and shots of a run share their speckle: with "
        f"{seeds} seeds, coverage is known to about {error[0]:.1f} and {error[1]:.1f} percentage points.",
        "",
        f"Made by `python scripts/interval_coverage.py --seeds {seeds}{some}`.",
        "",
        "| scene | estimator | amplitude 68 % | 95 % | NEV | phase 68 % | 95 % | NEV | runs |",
        "|---|---|---:|---:|---:|---:|---:|---:|---:|",
    ]
    return "\n".join([*lines, *(_line(row) for row in rows), ""])


def _line(row: Row) -> str:
    cells = [
        text
        for axis in (0, 1)
        for text in (
            f"{100 * row.within_68[axis]:.0f}",
            f"{100 * row.within_95[axis]:.0f}",
            f"{row.nev[axis]:.2f}",
        )
    ]
    runs = f"{row.seeds}" + (f", {row.refused} refused" if row.refused else "")
    return f"| {row.scene} | {row.estimator} | {' | '.join(cells)} | {runs} |"


if __name__ == "__main__":
    main()
