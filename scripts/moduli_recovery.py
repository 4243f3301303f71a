"""Measure how well the moduli come back on the twin: bias, spread, coverage, and the plane wave from the same records.

A seed draws what a stated uncertainty covers: scatterers, noise and trigger jitter; the widths of the force (5 % each)
and the transducer's place (20 um), which the fit knows only as the scene states them. The drive is set so that the
first harmonic on the axis is as large as in the scene. Noise is the scene's, 40 dB below the echoes. "Five" is the
scene's places from 1 to 6 mm, "one" the first of them, from the same records.

    python scripts/moduli_recovery.py                      # prints the tables of docs/moduli.md, half an hour on a core
    python scripts/moduli_recovery.py --seeds 5 --media 4 7.25
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

import hpe_rig as hpe
from hpe_rig.bench import twin_of
from hpe_rig.moduli import Push, Vibration, bound, fit_medium, push_of
from hpe_rig.scene import Scene

SCENE = "gelatin-moduli"
MEDIA = {"4": (4e3, 1.0), "7.25": (7.25e3, 1.0), "13.5": (13.5e3, 1.0), "9": (9e3, 2.0), "12": (12e3, 5.7)}
"""Shear modulus (Pa) and viscosity (Pa s) by the name given on the command line, kPa."""
ZENER = {"medium": "zener", "shear_modulus_pa": 7.25e3, "branch_modulus_pa": 10e3, "shear_viscosity_pa_s": 2.0}
WIDTH_SPREAD = 0.05
K_95 = 1.959964


@dataclass(frozen=True)
class Trial:
    """One seed: moduli (2,), their stated uncertainties and bounds, by number of places; whether a law is excluded."""

    values: dict[str, NDArray[np.float64]]
    stated: dict[str, NDArray[np.float64]]
    bounds: dict[str, NDArray[np.float64]]
    excluded: dict[str, bool]
    omitted: int


def main() -> None:
    """Print the tables, a medium as soon as it is measured."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=50)
    parser.add_argument("--media", nargs="+", choices=[*MEDIA, "zener"], default=[*MEDIA, "zener"])
    parser.add_argument("--workers", type=int, default=os.cpu_count())
    asked = parser.parse_args()
    with ProcessPoolExecutor(asked.workers) as pool:
        for name in asked.media:
            trials = list(pool.map(partial(trial, name), range(asked.seeds)))
            print("\n".join(rows(name, trials)), flush=True)


def trial(name: str, seed: int) -> Trial:
    """Return what ``seed`` gives in the medium ``name``."""
    rng = np.random.default_rng(seed)
    scene = drawn(hpe.load_scene(SCENE), medium_of(name), seed, rng)
    with TemporaryDirectory() as folder:
        run = hpe.measure(scene, path=Path(folder) / "run.h5")
        result = hpe.fit_moduli(run, laws=["voigt"])
    push = push_of([scene])
    off_m = scene.tracking.offset_uncertainty_m * rng.standard_normal(len(result.vibrations))
    # the transducer stood where the twin had it; its operator read the scale off by so much
    places = [replace(one, lateral_m=one.lateral_m + off) for one, off in zip(result.vibrations, off_m, strict=True)]
    found = {"five": _fit(places, push, name), "one": _fit(places[:1], push, name)}
    wave = result.plane_wave
    plane = np.full(2, np.nan) if wave is None else np.array([wave.elasticity_pa, wave.viscosity_pa_s])
    return Trial(
        values={**{key: each[0] for key, each in found.items()}, "plane": plane},
        stated={key: each[1] for key, each in found.items()},
        bounds={key: each[2] for key, each in found.items()},
        excluded={law: fit_medium(places, push, law).excluded for law in ("voigt", "zener")},
        omitted=len(result.omitted),
    )


def medium_of(name: str) -> dict[str, Any]:
    """Return the twin's settings of the medium ``name``."""
    if name == "zener":
        return ZENER
    return {"medium": "voigt", "shear_modulus_pa": MEDIA[name][0], "shear_viscosity_pa_s": MEDIA[name][1]}


def drawn(scene: Scene, medium: dict[str, Any], seed: int, rng: np.random.Generator) -> Scene:
    """Return ``scene`` with ``medium``, widths of the force and seed drawn, driven as hard as before."""
    assert scene.beams is not None
    x, y, z = scene.beams.excitation_width_m
    wide, deep = np.exp(WIDTH_SPREAD * rng.standard_normal(2)).tolist()
    values: dict[str, Any] = {f"simulation.specimen.{key}": value for key, value in medium.items()}
    values |= {"simulation.seed": seed + 1, "simulation.beams.excitation_width_m": (x * wide, y * wide, z * deep)}
    changed = scene.with_(values)
    before, after = twin_of(scene), twin_of(changed)
    assert before is not None
    assert after is not None
    assert before.settings.specimen is not None
    hz = scene.wanted_frequencies_hz[0]
    force = before.settings.specimen.force_density_n_per_m3 * before.steady_response_m(hz) / after.steady_response_m(hz)
    return changed.with_({"simulation.specimen.force_density_n_per_m3": force})


def _fit(
    places: Sequence[Vibration], push: Push, name: str
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return the Voigt moduli, their uncertainties and the bound at the truth, each (2,); NaN where it has none."""
    fit = fit_medium(places, push)
    truth = MEDIA.get(name)
    least = np.full(2, np.nan) if truth is None else np.sqrt(np.diag(bound(places, push, "voigt", truth)))
    return np.array(list(fit.values.values())), np.array(list(fit.uncertainty.values())), least


def rows(name: str, trials: Sequence[Trial]) -> list[str]:
    """Return the lines of the tables for one medium."""
    lines = [
        f"| {name} | {law} excluded | {sum(each.excluded[law] for each in trials)} of {len(trials)} |"
        for law in ("voigt", "zener")
    ]
    if name not in MEDIA:
        return lines
    truth = np.array(MEDIA[name])
    medium = f"{truth[0] * 1e-3:g} kPa, {truth[1]:g} Pa s"
    for key in ("five", "one"):
        error = np.array([each.values[key] - truth for each in trials])
        stated, least = (np.array([getattr(each, what)[key] for each in trials]) for what in ("stated", "bounds"))
        ratio, spread = np.abs(error / stated), np.std(error, axis=0, ddof=1)
        over = spread / np.sqrt(np.mean(least**2, axis=0))
        cells = [
            f"{100 * error[:, i].mean() / truth[i]:+.2f} ± {100 * spread[i] / truth[i] / np.sqrt(len(trials)):.2f} | "
            f"{100 * spread[i] / truth[i]:.2f} | {100 * np.sqrt(np.mean(stated[:, i] ** 2)) / truth[i]:.2f} | "
            f"{100 * np.mean(ratio[:, i] < 1):.0f}, {100 * np.mean(ratio[:, i] < K_95):.0f} | {over[i]:.2f}"
            for i in range(2)
        ]
        lines.append(f"| {medium} | {key} | {' | '.join(cells)} |")
    plane = np.array([each.values["plane"] for each in trials]) / truth - 1
    kept = np.isfinite(plane[:, 0])
    cells = [f"{100 * plane[kept, i].mean():+.0f} | {100 * plane[kept, i].std(ddof=1):.1f} | | |" for i in range(2)]
    lines.append(f"| {medium} | plane wave ({kept.sum()} of {len(trials)}) | {' '.join(cells)}")
    lines.append(f"left out, a run: {np.mean([each.omitted for each in trials]):.1f}")
    return lines


if __name__ == "__main__":
    main()
