"""Measure the coverage of the stated intervals: shipped scenes, every estimator, many seeds on the twin.

A seed draws all quantities that the uncertainty treats as unknown: scatterers, noise and trigger jitter; the sound
speed of the twin, with the gate on the focus; and, for an undeclared medium pushed by tonebursts, the medium and the
widths of the force, from the distributions of the medium prior (docs/explanation/medium-prior.md). The drive is set so
that the first harmonic is as large as in the scene.

The errors of the headline amplitudes and phases are compared with their standard uncertainty u and their 95 % interval:
the fraction within the interval, and NEV, the mean of (error / u)^2. Estimates of one run share their speckle, so the
Monte Carlo error of a row is computed over seeds.

Results are stored in a folder, one file per scene, estimator and block of seeds, and are used again while the scene and
the source code remain the same. A campaign can be stopped, continued and spread over processes. The results table of
the page docs/validation/coverage.md is replaced; its other text is not changed.

    python scripts/validation/interval_coverage.py --parts coverage-parts --seeds 0:200
    python scripts/validation/interval_coverage.py --parts coverage-parts --seeds 0:20 --scene table-1
    python scripts/validation/interval_coverage.py --parts coverage-parts --seeds 0:0        # the page only
"""

from __future__ import annotations

import argparse
import functools
import hashlib
import inspect
import json
import os
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

import hpe_rig as hpe
from hpe_rig.arrays import FloatArray
from hpe_rig.bench import twin_of
from hpe_rig.medium import (
    PRIOR_POWER_MODULUS_HZ,
    PRIOR_RANGES,
)
from hpe_rig.plan import PlanError
from hpe_rig.processing import ESTIMATORS
from hpe_rig.result import Result
from hpe_rig.scene import Scene, shipped_scenes, with_default_specimen
from hpe_rig.store import StoreError

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "validation" / "coverage.md"
TABLE_HEAD = """\
| scene | estimator | amplitude 95 % | NEV | phase 95 % | NEV | runs |
|---|---|---:|---:|---:|---:|---:|"""
PACKAGES = ("scene", "bench", "plan", "measurement", "processing", "medium", "prediction", "result")
SOURCES = (*(f"hpe_rig/{package}" for package in PACKAGES), "drivers", "sim_backend")
"""Folders with the source code that determines the results."""
BLOCK = 5
"""Seeds per file: the largest number of seeds that each process of a stopped campaign loses."""
EQUIVALENT = {"gelatin-12": "gelatin-8", "gelatin-15": "gelatin-8", "muscle-repeats": "muscle-force"}
"""Omitted scenes, by the scene that equals each once the medium is drawn, up to settings without effect on u."""
WRAPS = "quarter wavelengths from pulse to pulse"
"""Part of the warning that the displacement may be wrong by half wavelengths: the drive is too strong."""
TOO_FAST = "motion between pulses"
"""Check that refuses too strong a drive before the run."""
FORCES = 3
"""Number of measured forces of a sweep: weakest, strongest and one between."""
FAMILIES = ("voigt", "zener", "power_law", "elastic voigt", "maxwell")
"""Families of the medium prior."""
CREEP_ORDER = 2
"""Order of the background fitted for an undeclared medium: some media creep under the mean force of the bursts."""
WIDTH_LOG_SD = 0.3
"""Standard deviation of the logarithm of the widths of the force, as in the prior's `BeamWidths`."""


@dataclass(frozen=True)
class Row:
    """Coverage of one scene and estimator. Pairs are of amplitude and phase; ``seeds`` is the number of runs."""

    scene: str
    estimator: str
    seeds: int
    refused: int
    warned: int
    within_95: tuple[float, float]
    nev: tuple[float, float]
    nev_error: tuple[float, float]


def main() -> None:
    """Measure the missing seeds and update the table of the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--parts", type=Path, required=True, help="folder of the results")
    parser.add_argument("--seeds", default="0:200", help="A:B, seeds from A to B - 1")
    parser.add_argument("--scene", action="append", choices=measured_scenes(), help="repeatable; default: all")
    parser.add_argument("--estimator", action="append", choices=ESTIMATORS, help="repeatable; default: all")
    parser.add_argument("--workers", type=int, default=os.cpu_count())
    parser.add_argument("--output", type=Path, default=PAGE)
    arguments = parser.parse_args()
    first, last = (int(seed) for seed in arguments.seeds.split(":"))
    arguments.parts.mkdir(parents=True, exist_ok=True)
    estimators = tuple(arguments.estimator or ESTIMATORS)
    # Blocks are ordered by seed, so that a stopped campaign has equally many seeds of every scene.
    blocks = [
        (name, seeds)
        for at in range(first - first % BLOCK, last, BLOCK)
        for name in arguments.scene or measured_scenes()
        if (seeds := range(max(at, first), min(at + BLOCK, last)))
    ]
    start_s = time.monotonic()
    with ProcessPoolExecutor(arguments.workers) as pool:
        runs = {
            pool.submit(measured, arguments.parts, name, estimators, seeds): (name, seeds) for name, seeds in blocks
        }
        for count, run in enumerate(as_completed(runs), 1):
            name, seeds = runs[run]
            run.result()
            at = f"seeds {seeds[0]} to {seeds[-1]}"
            print(f"{time.monotonic() - start_s:6.0f} s  {count}/{len(blocks)}  {name}, {at}", flush=True)
    rows = [row for name in measured_scenes() for row in _rows(arguments.parts, name)]
    arguments.output.write_text(with_table(PAGE.read_text(encoding="utf-8"), rows), encoding="utf-8")


def measured_scenes() -> list[str]:
    """Return the names of the measured scenes."""
    return [name for name in shipped_scenes() if name not in EQUIVALENT]


def measured(folder: Path, name: str, estimators: Sequence[str], seeds: Sequence[int]) -> None:
    """Measure ``seeds`` of the shipped scene ``name`` and store them in ``folder``, one file per estimator.

    Existing files are not measured again.
    """
    paths = {
        estimator: folder / f"{name}.{estimator}.{seeds[0]}-{seeds[-1]}.{_key(name)}.json" for estimator in estimators
    }
    missing = tuple(estimator for estimator, path in paths.items() if not path.exists())
    if not missing:
        return
    runs = [errors_over_u(name, missing, seed) for seed in seeds]
    for estimator in missing:
        errors = [None if (ratios := run[estimator]) is None else ratios.tolist() for run in runs]
        # The file is complete or absent: it is renamed after writing.
        part = paths[estimator].with_suffix(".part")
        part.write_text(json.dumps(dict(zip(seeds, errors, strict=True))), encoding="utf-8")
        part.replace(paths[estimator])


@functools.cache
def _key(name: str) -> str:
    """Return a checksum of the scene and of the source code that determines its errors."""
    digest = hashlib.sha256(thinned(with_default_specimen(hpe.load_scene(name))).model_dump_json().encode())
    for folder in SOURCES:
        for path in sorted((ROOT / folder).rglob("*.py")):
            digest.update(path.read_bytes())
    for part in (errors_over_u, thinned, draw_scene, _bowl, _as_large, draw_medium, _ratios, _each_ratio):
        digest.update(inspect.getsource(part).encode())
    digest.update(repr((FORCES, FAMILIES, CREEP_ORDER, WIDTH_LOG_SD)).encode())
    return digest.hexdigest()[:12]


def _rows(folder: Path, name: str) -> Iterator[Row]:
    """Yield a row for each estimator with seeds in ``folder``."""
    for estimator in ESTIMATORS:
        runs: dict[str, list[list[float]] | None] = {}
        for path in folder.glob(f"{name}.{estimator}.*.{_key(name)}.json"):
            runs |= json.loads(path.read_text(encoding="utf-8"))
        if runs:
            errors = [None if run is None else np.reshape(run, (-1, 2, 2)) for run in runs.values()]
            yield _row(name, estimator, errors)


def coverage(name: str, estimators: Sequence[str], seeds: Sequence[int]) -> list[Row]:
    """Return a row for each estimator of the shipped scene ``name``."""
    runs = [errors_over_u(name, tuple(estimators), seed) for seed in seeds]
    return [_row(name, estimator, [run[estimator] for run in runs]) for estimator in estimators]


def errors_over_u(name: str, estimators: tuple[str, ...], seed: int) -> dict[str, FloatArray | None]:
    """Return the ratios of ``_ratios`` by estimator; None if the estimator refuses the records."""
    scene = draw_scene(thinned(with_default_specimen(hpe.load_scene(name))), seed)
    with TemporaryDirectory() as folder:
        try:
            run = hpe.measure(scene, path=Path(folder) / "run.h5")
        except PlanError as error:
            if TOO_FAST not in str(error):
                raise
            return dict.fromkeys(estimators, np.zeros((0, 2)))
        return {estimator: _ratios(run, estimator) for estimator in estimators}


def thinned(scene: Scene) -> Scene:
    """Return ``scene`` without repeats and with few forces, which share their speckle and add little information."""
    values: dict[str, Any] = {"acquisition.repeats": 1}
    if scene.excitation is not None and len(forces := scene.excitation.force_fraction) > FORCES:
        values["excitation.force_fraction"] = (forces[0], forces[len(forces) // 2], forces[-1])
    return scene.with_(values)


def draw_scene(scene: Scene, seed: int) -> Scene:
    """Return ``scene`` with all quantities drawn that the stated uncertainty covers."""
    speed, rng, bowl = scene.acquisition.sound_speed_m_per_s, np.random.default_rng(seed), _bowl(scene)
    # Relative error of the stated sound speed.
    relative = scene.acquisition.sound_speed_uncertainty * rng.standard_normal()
    values: dict[str, Any] = {
        "simulation.seed": seed + 1,
        "simulation.sound_speed_m_per_s": speed * (1 + relative),
        "simulation.beams.focus_depth_m": scene.acquisition.gate_depth_m * (1 + relative),
    }
    if offsets_m := scene.sweep.lateral_offset_m:
        # One lateral offset per seed: off the axis the twin needs seconds per offset.
        values["sweep.lateral_offset_m"] = (offsets_m[seed % len(offsets_m)],)
    if bowl:
        values["simulation.beams.transducer.focal_length_m"] = values["simulation.beams.focus_depth_m"]
    if scene.medium is None and "specimen" in (scene.simulation or {}):
        values |= {f"simulation.specimen.{name}": value for name, value in draw_medium(rng).items()}
        values["processing.background_order"] = max(scene.processing.background_order, CREEP_ORDER)
        # The widths of the force in the medium are unknown too, and uncertain in the prior.
        width_scale, length_scale = np.exp(WIDTH_LOG_SD * rng.standard_normal(2)).tolist()
        if scene.beams is not None:
            x, y, z = scene.beams.excitation_width_m
            # The field of an aperture is computed, not set: the width stated by the scene is drawn instead.
            key = "beams.excitation_width_m" if bowl else "simulation.beams.excitation_width_m"
            values[key] = (x * width_scale, y * width_scale, z * length_scale)
    return _as_large(scene.with_(values), scene)


def _bowl(scene: Scene) -> bool:
    """Return whether the twin computes its beams from an aperture."""
    return (scene.simulation or {}).get("beams", {}).get("field") == "aperture"


def _as_large(scene: Scene, before: Scene) -> Scene:
    """Return ``scene`` with the drive that makes its first harmonic as large as in ``before``."""
    twin, twin_before = twin_of(scene), twin_of(before)
    if twin is None or twin_before is None or twin.settings.specimen is None:
        return scene
    force, hz = twin_before.settings.specimen, scene.wanted_frequencies_hz[0]
    assert force is not None
    ratio = twin_before.steady_response_m(hz) / twin.steady_response_m(hz)
    return scene.with_({"simulation.specimen.force_density_n_per_m3": force.force_density_n_per_m3 * ratio})


def draw_medium(rng: np.random.Generator) -> dict[str, Any]:
    """Return the settings of a medium drawn from the prior: a family, and parameters uniform over their ranges."""

    def log_even(limits: tuple[float, float]) -> float:
        return float(limits[0] * (limits[1] / limits[0]) ** rng.uniform())

    family = FAMILIES[rng.integers(len(FAMILIES))]
    modulus_pa = log_even(PRIOR_RANGES["modulus_pa"])
    medium: dict[str, Any] = {"medium": family.removeprefix("elastic "), "shear_modulus_pa": modulus_pa}
    match family:
        case "voigt":
            medium["shear_viscosity_pa_s"] = log_even(PRIOR_RANGES["viscosity_pa_s"])
        case "elastic voigt":
            medium["shear_viscosity_pa_s"] = log_even(PRIOR_RANGES["low_viscosity_pa_s"])
        case "zener":
            medium["shear_viscosity_pa_s"] = log_even(PRIOR_RANGES["viscosity_pa_s"])
            medium["branch_modulus_pa"] = modulus_pa * log_even(PRIOR_RANGES["branch_over_modulus"])
        case "power_law":
            medium["power"] = float(rng.uniform(*PRIOR_RANGES["power"]))
            medium["reference_frequency_hz"] = PRIOR_POWER_MODULUS_HZ
        case "maxwell":
            medium["shear_viscosity_pa_s"] = log_even(PRIOR_RANGES["maxwell_viscosity_pa_s"])
    return medium


def _ratios(run: hpe.Run, estimator: str) -> FloatArray | None:
    """Return errors relative to u and to the half width of the 95 % interval, (estimate, quantity, 2).

    None if the records are refused; empty if a warning excludes the run.
    """
    try:
        result = run.estimate(estimator)
    except StoreError:
        return None
    if any(WRAPS in text for shot in result.shots for text in shot.warnings):
        return np.zeros((0, 2, 2))
    return np.array(list(_each_ratio(result)))


def _each_ratio(result: Result) -> Iterator[FloatArray]:
    for shot in result.shots:
        for item in shot.estimates:
            error_m = (item.amplitude_error or 0.0) * (item.true_amplitude_m or 0.0)
            error_rad = item.phase_error_rad or 0.0
            widths_m = item.amplitude_uncertainty_m, item.interval_95_m
            widths_rad = item.phase_uncertainty_rad, item.interval_95_rad
            yield np.stack([error_m / np.array(widths_m), error_rad / np.array(widths_rad)])


def _row(name: str, estimator: str, runs: Sequence[FloatArray | None]) -> Row:
    """Return the coverage over the ratios of all runs."""
    answered = [run for run in runs if run is not None]
    valid_runs = [run for run in answered if len(run)]
    ratio = np.concatenate(valid_runs) if valid_runs else np.full((1, 2, 2), np.nan)
    # Fraction of errors within the half width of the 95 % interval.
    within = (np.abs(ratio[..., 1]) < 1).mean(axis=0)
    nev, run_nevs = (ratio[..., 0] ** 2).mean(axis=0), [(run[..., 0] ** 2).mean(axis=0) for run in valid_runs]
    error = np.std(run_nevs, axis=0) / np.sqrt(max(len(run_nevs), 1)) if run_nevs else np.full(2, np.nan)
    pairs = [(float(pair[0]), float(pair[1])) for pair in (within, nev, error)]
    return Row(name, estimator, len(valid_runs), len(runs) - len(answered), len(answered) - len(valid_runs), *pairs)


def with_table(page: str, rows: Sequence[Row]) -> str:
    """Return ``page`` (Markdown) with its results table replaced by ``rows``; all other text remains."""
    before, _, after = page.partition(f"{TABLE_HEAD}\n")
    _, _, after = after.partition("\n\n")
    return "\n".join([f"{before}{TABLE_HEAD}", *(_line(row) for row in rows), "", after])


def _line(row: Row) -> str:
    cells = []
    for within, nev, nev_error in zip(row.within_95, row.nev, row.nev_error, strict=True):
        cells += [f"{100 * within:.0f}", f"{nev:.2f} ± {nev_error:.2f}"]
    runs = f"{row.seeds}" + "".join(
        f", {count} {verdict}" for count, verdict in ((row.refused, "refused"), (row.warned, "warned")) if count
    )
    return f"| {row.scene} | {row.estimator} | {' | '.join(cells if row.seeds else ['-'] * len(cells))} | {runs} |"


if __name__ == "__main__":
    main()
