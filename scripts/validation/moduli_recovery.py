"""Measure how well the moduli come back on the twin: bias, spread, coverage, and the plane wave from the same records.

A seed draws what a stated uncertainty covers: scatterers and noise; the widths of the force (5 % each); the place of
the transducer (20 um), its gain (0.5 %) and phase (2 mrad); and the bursts' onset at the focus (0.5 us). The fit knows
of them only what the scene states. The drive is set so that the first harmonic on the axis is as large as in the scene,
half as large in 13.5 kPa, which else moves too fast between pulses for some of the draws. Noise is the scene's, 40 dB
below the echoes. "Five" is the scene's places from 1 to 6 mm, "one" the first of them, from the same records.

What was measured is kept in a folder, a file a medium and seed, and is not measured again: it can be stopped and gone
on with, and the fits changed without measuring.

    python scripts/validation/moduli_recovery.py FOLDER                     # some 6 s a medium and seed; then the tables
    python scripts/validation/moduli_recovery.py FOLDER --seeds 5 --media 4 7.25
    python scripts/validation/moduli_recovery.py FOLDER --seeds 0           # the tables of what is there
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

import hpe_rig as hpe
from hpe_rig.arrays import FloatArray
from hpe_rig.bench import twin_of
from hpe_rig.moduli import (
    Push,
    Source,
    Vibration,
    bound,
    fit_medium,
    plane_wave_of,
    push_of,
    vibration_at,
    vibrations_of,
)
from hpe_rig.scene import Scene

SCENE = "gelatin-moduli"
MEDIA = {"4": (4e3, 1.0), "7.25": (7.25e3, 1.0), "13.5": (13.5e3, 1.0), "9": (9e3, 2.0), "12": (12e3, 5.7)}
"""Shear modulus (Pa) and viscosity (Pa s) by the name given on the command line, kPa."""
ZENER = {"medium": "zener", "shear_modulus_pa": 7.25e3, "branch_modulus_pa": 10e3, "shear_viscosity_pa_s": 2.0}
DRIVE = {"13.5": 0.5}
"""First harmonic over that of the scene, where it is not 1."""
WIDTH_SPREAD = 0.05
K_95 = 1.959964


@dataclass(frozen=True)
class Trial:
    """One seed: moduli (2,), their stated uncertainties and bounds, by number of places; whether a law is excluded."""

    values: dict[str, FloatArray]
    stated: dict[str, FloatArray]
    bounds: dict[str, FloatArray]
    excluded: dict[str, bool]
    lateral: FloatArray
    """How far the fit moved every place, in units of what is known of it, (place,)."""


def main() -> None:
    """Measure what is missing, then print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--seeds", type=int, default=50)
    parser.add_argument("--media", nargs="+", choices=[*MEDIA, "zener"], default=[*MEDIA, "zener"])
    asked = parser.parse_args()
    asked.folder.mkdir(parents=True, exist_ok=True)
    # seed by seed, so that what is there is worth a table whenever it is stopped
    for seed in range(asked.seeds):
        for name in asked.media:
            path = asked.folder / f"{name}-{seed}.json"
            if not path.exists():
                draft = path.with_suffix(".part")
                draft.write_text(json.dumps(measured(name, seed)), encoding="utf-8")
                draft.replace(path)
    for name in asked.media:
        paths = sorted(asked.folder.glob(f"{name}-*.json"), key=lambda path: int(path.stem.rpartition("-")[2]))
        if paths:
            trials = [trial(name, int(path.stem.rpartition("-")[2]), path) for path in paths]
            print("\n".join(rows(name, trials)), flush=True)


def measured(name: str, seed: int) -> list[dict[str, Any]]:
    """Return the vibration at every place that ``seed`` gives in the medium ``name``, as plain values."""
    scene = drawn(hpe.load_scene(SCENE), name, seed, np.random.default_rng(seed))
    with TemporaryDirectory() as folder:
        run = hpe.measure(scene, path=Path(folder) / "run.h5")
        vibrations, _ = vibrations_of([Source("", run.scene, run.plan, run.stored)])
    return [_plain(one) for one in vibrations]


def trial(name: str, seed: int, path: Path) -> Trial:
    """Return what the fits make of the vibrations in ``path``."""
    scene, rng = hpe.load_scene(SCENE), np.random.default_rng([seed, 1])
    push = push_of([scene])
    vibrations = [_vibration(scene, each) for each in json.loads(path.read_text(encoding="utf-8"))]
    off_s = push.onset_uncertainty_s * rng.standard_normal()
    places = [as_read(one, scene.tracking.offset_uncertainty_m, off_s, rng) for one in vibrations]
    parts = {"five": places, "one": places[:1]}
    fits = {key: fit_medium(part, push) for key, part in parts.items()}
    zener, least = fit_medium(places, push, "zener"), np.full(2, np.nan)
    truth = MEDIA.get(name)
    bounds = {} if truth is None else {key: _bound(part, push, truth) for key, part in parts.items()}
    return Trial(
        values={**{key: np.array(list(fit.values.values())) for key, fit in fits.items()}, "plane": plane_wave(places)},
        stated={key: np.array(list(fit.uncertainty.values())) for key, fit in fits.items()},
        bounds={key: bounds.get(key, least) for key in parts},
        excluded={"voigt": fits["five"].excluded, "zener": zener.excluded},
        lateral=np.array([value for name, value in fits["five"].adjusted.items() if name.startswith("lateral")]),
    )


def as_read(one: Vibration, stage_m: float, off_s: float, rng: np.random.Generator) -> Vibration:
    """Return ``one`` as read with a scale, a gain and a phase that are off by as much as is stated of them.

    The transducer stood where the twin had it; its operator read the scale off by so much.
    """
    scale_m, gain, phase = rng.standard_normal(3) * [stage_m, one.gain_uncertainty, one.phase_uncertainty_rad]
    turned = np.exp(1j * (phase - 2 * np.pi * one.frequency_hz * off_s))
    return replace(one, lateral_m=one.lateral_m + scale_m, phasor_m=one.phasor_m * (1 + gain) * turned)


def medium_of(name: str) -> dict[str, Any]:
    """Return the twin's settings of the medium ``name``."""
    if name == "zener":
        return ZENER
    return {"medium": "voigt", "shear_modulus_pa": MEDIA[name][0], "shear_viscosity_pa_s": MEDIA[name][1]}


def drawn(scene: Scene, name: str, seed: int, rng: np.random.Generator) -> Scene:
    """Return ``scene`` in the medium ``name``, widths of the force and seed drawn, driven as hard as before."""
    assert scene.beams is not None
    x, y, z = scene.beams.excitation_width_m
    wide, deep = np.exp(WIDTH_SPREAD * rng.standard_normal(2)).tolist()
    values: dict[str, Any] = {f"simulation.specimen.{key}": value for key, value in medium_of(name).items()}
    values |= {"simulation.seed": seed + 1, "simulation.beams.excitation_width_m": (x * wide, y * wide, z * deep)}
    changed = scene.with_(values)
    before, after = twin_of(scene), twin_of(changed)
    assert before is not None
    assert after is not None
    assert before.settings.specimen is not None
    hz = scene.wanted_frequencies_hz[0]
    ratio = DRIVE.get(name, 1.0) * before.steady_response_m(hz) / after.steady_response_m(hz)
    force = before.settings.specimen.force_density_n_per_m3 * ratio
    return changed.with_({"simulation.specimen.force_density_n_per_m3": force})


def plane_wave(places: Sequence[Vibration]) -> FloatArray:
    """Return the Voigt moduli (2,) of the phase's fall with distance; NaN where it does not fall."""
    wave, _ = plane_wave_of(places, 1000.0)
    if wave is None:
        return np.full(2, np.nan)
    return np.array([wave.elasticity_pa, wave.viscosity_pa_s])


def _plain(one: Vibration) -> dict[str, Any]:
    arrays = {"frequency_hz": one.frequency_hz, "real_m": one.phasor_m.real, "imaginary_m": one.phasor_m.imag}
    arrays["covariance_m2"] = one.covariance_m2
    return {"lateral_m": one.lateral_m, **{key: value.tolist() for key, value in arrays.items()}}


def _vibration(scene: Scene, plain: dict[str, Any]) -> Vibration:
    """Return a vibration with what is said by now of its place."""
    [place] = [each for each in scene.places if each.tracking.lateral_offset_m == plain["lateral_m"]]
    arrays = {key: np.array(value) for key, value in plain.items() if key != "lateral_m"}
    phasor_m = arrays["real_m"] + 1j * arrays["imaginary_m"]
    label = f"{plain['lateral_m'] * 1e3:g} mm"
    measured = arrays["frequency_hz"], phasor_m, arrays["covariance_m2"]
    return vibration_at(place, scene.processing.estimator, label, measured)


def _bound(places: Sequence[Vibration], push: Push, truth: tuple[float, float]) -> FloatArray:
    return np.asarray(np.sqrt(np.diag(bound(places, push, "voigt", truth))))


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
        lines.append(f"| {medium} | {len(trials)} | {key} | {' | '.join(cells)} |")
    plane = np.array([each.values["plane"] for each in trials]) / truth - 1
    kept = np.isfinite(plane[:, 0])
    cells = [f"{100 * plane[kept, i].mean():+.0f} | {100 * plane[kept, i].std(ddof=1):.1f} | | | |" for i in range(2)]
    lines.append(f"| {medium} | {kept.sum()} | plane wave | {' '.join(cells)}")
    moved = np.concatenate([each.lateral for each in trials])
    return [*lines, f"{medium}: places moved by the fit, rms {np.sqrt(np.mean(moved**2)):.2f} of what is stated"]


if __name__ == "__main__":
    main()
