"""Measure the coverage of ratios and differences, with uncertainties from the covariance of a result.

Seeds draw all quantities that the uncertainty treats as unknown, as in ``interval_coverage.py``; every run has two
repeats. Three combinations of the complex values are compared with their u and 95 % interval from
``Result.covariance()``:

    ratio        amplitude ratio and phase difference of each harmonic and the first
    repeats      difference of in-phase and quadrature values between the repeats of a frequency
    offsets      amplitude ratio and phase difference of a frequency between two lateral offsets

Harmonics below ten times their noise are left out: the logarithm of a ratio is not linear there. Results are stored in
a folder, one file per scene and seed, and are used again; delete the folder when the source code has changed. The table
of the page docs/validation/coverage.md is replaced.

    python scripts/validation/covariance_coverage.py --parts covariance-parts --seeds 0:200
    python scripts/validation/covariance_coverage.py --parts covariance-parts --seeds 0:0        # the page only
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from interval_coverage import PAGE, WRAPS, draw_scene, thinned

import hpe_rig as hpe
from hpe_rig.arrays import ComplexArray
from hpe_rig.plan import PlanError
from hpe_rig.result import Covariance, Result
from hpe_rig.scene import with_default_specimen

CASES = (
    ("bovine-muscle", "coherent"),
    ("bovine-muscle", "cross_spectrum"),
    ("bovine-muscle-synchronous", "coherent"),
    ("gelatin-moduli", "coherent"),
    ("table-1", "coherent"),
)
TABLE_HEAD = """\
| scene | estimator | combination | amplitude or in-phase 95 % | NEV | phase or quadrature 95 % | NEV | runs |
|---|---|---|---:|---:|---:|---:|---:|"""
MIN_SNR = 10.0
"""Amplitude over the standard uncertainty of its noise below which a harmonic is left out."""
OFFSETS_M = (1e-3, 3.5e-3)
"""Lateral offsets of a scene that sweeps them: near the push and in the middle of the range."""


def main() -> None:
    """Measure the missing seeds and update the table of the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--parts", type=Path, required=True, help="folder of the results")
    parser.add_argument("--seeds", default="0:200", help="A:B, seeds from A to B - 1")
    parser.add_argument("--scene", action="append", help="repeatable; default: all")
    arguments = parser.parse_args()
    first, last = (int(seed) for seed in arguments.seeds.split(":"))
    arguments.parts.mkdir(parents=True, exist_ok=True)
    names = arguments.scene or list(dict.fromkeys(name for name, _ in CASES))
    for seed in range(first, last):
        for name in names:
            path = arguments.parts / f"{name}.{seed}.json"
            if not path.exists():
                path.write_text(json.dumps(measured_ratios(name, seed)), encoding="utf-8")
    page = PAGE.read_text(encoding="utf-8")
    before, _, after = page.partition(f"{TABLE_HEAD}\n")
    _, _, after = after.partition("\n\n")
    lines = [line for name, estimator in CASES for line in table_rows(arguments.parts, name, estimator)]
    PAGE.write_text("\n".join([f"{before}{TABLE_HEAD}", *lines, "", after]), encoding="utf-8")


def measured_ratios(name: str, seed: int) -> dict[str, dict[str, list[list[list[float]]]]]:
    """Return the ratios of ``combination_ratios`` of one run by estimator.

    A run with too strong a drive, refused or with a warning, is left out, as in ``interval_coverage.py``.
    """
    scene = draw_scene(thinned(with_default_specimen(hpe.load_scene(name))), seed)
    values: dict[str, object] = {"acquisition.repeats": 2}
    if scene.sweep.lateral_offset_m:
        values["sweep.lateral_offset_m"] = OFFSETS_M
    estimators = [estimator for scene_name, estimator in CASES if scene_name == name]
    with TemporaryDirectory() as folder:
        try:
            run = hpe.measure(scene.with_(values), path=Path(folder) / "run.h5")
        except PlanError:
            return {}
        results = {estimator: run.estimate(estimator) for estimator in estimators}
    return {
        estimator: combination_ratios(result)
        for estimator, result in results.items()
        if not any(WRAPS in text for shot in result.shots for text in shot.warnings)
    }


def combination_ratios(result: Result) -> dict[str, list[list[list[float]]]]:
    """Return the errors of each combination over u and over the half width of the 95 % interval, (item, part, 2)."""
    covariance, shots = result.covariance(), result.shots
    true_m = np.array(
        [
            [(item.true_amplitude_m or 0) * np.exp(1j * (item.true_phase_rad or 0)) for item in s.estimates]
            for s in shots
        ]
    )
    noise = covariance.influences_m(["noise"])
    noise_m = np.sqrt(np.sum(np.abs(noise) ** 2, axis=-1) / 2)
    strong = np.abs(covariance.phasor_m) > MIN_SNR * noise_m
    ratios: dict[str, list[list[list[float]]]] = {"ratio": [], "repeats": [], "offsets": []}
    for row, shot in enumerate(shots):
        for index in range(1, strong.shape[1]):
            if shot.repeat == 0 and strong[row, 0] and strong[row, index]:
                ratios["ratio"].append(_logarithm(covariance, true_m, (row, 0), (row, index)))
        for later in range(row + 1, len(shots)):
            same_offset = shots[later].lateral_offset_m == shot.lateral_offset_m
            for index in range(strong.shape[1]):
                pair = (row, index), (later, index)
                if same_offset:
                    ratios["repeats"].append(_difference(covariance, true_m, *pair))
                elif shot.repeat == shots[later].repeat == 0 and strong[row, index] and strong[later, index]:
                    ratios["offsets"].append(_logarithm(covariance, true_m, *pair))
    return ratios


def _logarithm(
    covariance: Covariance, true_m: ComplexArray, first: tuple[int, int], second: tuple[int, int]
) -> list[list[float]]:
    """Return the error of ln(y_2 / y_1), relative amplitude and phase, over u and over the half width."""
    weights = np.zeros(true_m.shape, np.complex128)
    weights[first], weights[second] = -1 / covariance.phasor_m[first], 1 / covariance.phasor_m[second]
    relative = covariance.phasor_m / true_m
    return _over_widths(covariance, weights, complex(np.log(relative[second] / relative[first])))


def _difference(
    covariance: Covariance, true_m: ComplexArray, first: tuple[int, int], second: tuple[int, int]
) -> list[list[float]]:
    """Return the error of y_2 - y_1, in-phase and quadrature, over u and over the half width."""
    weights = np.zeros(true_m.shape, np.complex128)
    weights[first], weights[second] = -1, 1
    error_m = covariance.phasor_m - true_m
    return _over_widths(covariance, weights, complex(error_m[second] - error_m[first]))


def _over_widths(covariance: Covariance, weights: ComplexArray, error: complex) -> list[list[float]]:
    """Return real and imaginary part of ``error`` over u and over the half width, (part, 2)."""
    combined = covariance.combined(weights)
    components = np.array([error.real, error.imag])
    return np.stack([components / combined.uncertainty, components / combined.interval_95], axis=-1).tolist()


def table_rows(folder: Path, name: str, estimator: str) -> Iterator[str]:
    """Yield the row of each combination of one scene and estimator."""
    runs = [json.loads(path.read_text(encoding="utf-8")) for path in sorted(folder.glob(f"{name}.*.json"))]
    ratios = [run[estimator] for run in runs if estimator in run]
    for combination in ("ratio", "repeats", "offsets"):
        by_run = [np.array(run[combination]) for run in ratios if run[combination]]
        if not by_run:
            continue
        pooled, cells = np.concatenate(by_run), []
        for component in (0, 1):
            within = np.mean(np.abs(pooled[:, component, 1]) < 1)
            run_nevs = [np.mean(run[:, component, 0] ** 2) for run in by_run]
            error = np.std(run_nevs) / np.sqrt(len(run_nevs))
            cells += [f"{100 * within:.0f}", f"{np.mean(pooled[:, component, 0] ** 2):.2f} ± {error:.2f}"]
        yield f"| {name} | {estimator} | {combination} | {' | '.join(cells)} | {len(by_run)} |"


if __name__ == "__main__":
    main()
