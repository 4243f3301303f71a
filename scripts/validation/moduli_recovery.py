"""Measure bias, standard deviation and coverage of fitted moduli on the twin.

A seed draws all quantities with a stated uncertainty: scatterers and noise; the widths of the force (5 % each);
lateral offset (20 um), gain (0.5 %) and phase (2 mrad) of the transducer; and the onset of the bursts at the focus
(0.5 us). The fit uses only the values stated in the scene. The drive gives the first harmonic on the axis the size
that it has in the scene, or half of it in 13.5 kPa, which otherwise moves too fast between pulses for some draws. The
SNR is 40 dB. "Five" are all lateral offsets of the scene, from 1 to 6 mm, "one" is the first, from the same records.

Measurements are stored in a folder, one file per medium and seed, and are used again: a campaign can be stopped and
continued, and the fits can be changed without new measurements.

    python scripts/validation/moduli_recovery.py FOLDER                     # about 6 s per medium and seed
    python scripts/validation/moduli_recovery.py FOLDER --seeds 5 --media 4 7.25
    python scripts/validation/moduli_recovery.py FOLDER --seeds 0           # tables of the stored measurements
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
    push_of,
    vibration_at,
    vibrations_of,
)
from hpe_rig.scene import Scene

SCENE = "gelatin-moduli"
MEDIA = {"4": (4e3, 1.0), "7.25": (7.25e3, 1.0), "13.5": (13.5e3, 1.0), "9": (9e3, 2.0), "12": (12e3, 5.7)}
"""Shear modulus (Pa) and viscosity (Pa s) by the name on the command line, kPa."""
ZENER = {"medium": "zener", "shear_modulus_pa": 7.25e3, "branch_modulus_pa": 10e3, "shear_viscosity_pa_s": 2.0}
DRIVE = {"13.5": 0.5}
"""First harmonic relative to that of the scene; default 1."""
WIDTH_LOG_SD = 0.05
K_95 = 1.959964


@dataclass(frozen=True)
class Trial:
    """Fits of one seed by number of offsets: moduli (2,), stated uncertainties and bounds; excluded laws."""

    values: dict[str, FloatArray]
    stated: dict[str, FloatArray]
    bounds: dict[str, FloatArray]
    excluded: dict[str, bool]
    lateral: FloatArray
    """Correction of each lateral offset by the fit, relative to its stated uncertainty, (offset,)."""


def main() -> None:
    """Measure the missing seeds, then print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--seeds", type=int, default=50)
    parser.add_argument("--media", nargs="+", choices=[*MEDIA, "zener"], default=[*MEDIA, "zener"])
    arguments = parser.parse_args()
    arguments.folder.mkdir(parents=True, exist_ok=True)
    # Seed by seed, so that a stopped campaign has equally many seeds of every medium.
    for seed in range(arguments.seeds):
        for name in arguments.media:
            path = arguments.folder / f"{name}-{seed}.json"
            if not path.exists():
                # The file is complete or absent: it is renamed after writing.
                draft = path.with_suffix(".part")
                draft.write_text(json.dumps(measured(name, seed)), encoding="utf-8")
                draft.replace(path)
    for name in arguments.media:
        paths = sorted(arguments.folder.glob(f"{name}-*.json"), key=lambda path: int(path.stem.rpartition("-")[2]))
        if paths:
            trials = [trial(name, int(path.stem.rpartition("-")[2]), path) for path in paths]
            print("\n".join(rows(name, trials)), flush=True)


def measured(name: str, seed: int) -> list[dict[str, Any]]:
    """Measure the vibration at every lateral offset with ``seed`` in the medium ``name``; return JSON values."""
    scene = draw_scene(hpe.load_scene(SCENE), name, seed, np.random.default_rng(seed))
    with TemporaryDirectory() as folder:
        run = hpe.measure(scene, path=Path(folder) / "run.h5")
        vibrations, _ = vibrations_of([Source("", run.scene, run.plan, run.stored)])
    return [_plain(vibration) for vibration in vibrations]


def trial(name: str, seed: int, path: Path) -> Trial:
    """Fit the vibrations stored in ``path``."""
    scene, rng = hpe.load_scene(SCENE), np.random.default_rng([seed, 1])
    push = push_of([scene])
    vibrations = [_vibration(scene, item) for item in json.loads(path.read_text(encoding="utf-8"))]
    onset_error_s = push.onset_uncertainty_s * rng.standard_normal()
    vibrations = [
        with_reading_errors(vibration, scene.tracking.offset_uncertainty_m, onset_error_s, rng)
        for vibration in vibrations
    ]
    groups = {"five": vibrations, "one": vibrations[:1]}
    fits = {key: fit_medium(group, push) for key, group in groups.items()}
    zener, unknown = fit_medium(vibrations, push, "zener"), np.full(2, np.nan)
    truth = MEDIA.get(name)
    bounds = {} if truth is None else {key: _bound(group, push, truth) for key, group in groups.items()}
    return Trial(
        values={key: np.array(list(fit.values.values())) for key, fit in fits.items()},
        stated={key: np.array(list(fit.uncertainty.values())) for key, fit in fits.items()},
        bounds={key: bounds.get(key, unknown) for key in groups},
        excluded={"voigt": fits["five"].excluded, "zener": zener.excluded},
        lateral=np.array([value for name, value in fits["five"].adjusted.items() if name.startswith("lateral")]),
    )


def with_reading_errors(
    vibration: Vibration, stage_m: float, onset_error_s: float, rng: np.random.Generator
) -> Vibration:
    """Return ``vibration`` with errors of position, gain and phase drawn from their stated uncertainties.

    The transducer of the twin is at the nominal offset; the reading of the operator has the error.
    """
    # Independent normal errors with the stated standard uncertainties.
    scale_m, gain, phase = rng.standard_normal(3) * [
        stage_m,
        vibration.gain_uncertainty,
        vibration.phase_uncertainty_rad,
    ]
    phasor = np.exp(1j * (phase - 2 * np.pi * vibration.frequency_hz * onset_error_s))
    return replace(
        vibration, lateral_m=vibration.lateral_m + scale_m, phasor_m=vibration.phasor_m * (1 + gain) * phasor
    )


def medium_of(name: str) -> dict[str, Any]:
    """Return the settings of the twin for the medium ``name``."""
    if name == "zener":
        return ZENER
    return {"medium": "voigt", "shear_modulus_pa": MEDIA[name][0], "shear_viscosity_pa_s": MEDIA[name][1]}


def draw_scene(scene: Scene, name: str, seed: int, rng: np.random.Generator) -> Scene:
    """Return ``scene`` in the medium ``name``, with seed and widths of the force drawn and the drive adjusted."""
    assert scene.beams is not None
    x, y, z = scene.beams.excitation_width_m
    width_scale, length_scale = np.exp(WIDTH_LOG_SD * rng.standard_normal(2)).tolist()
    values: dict[str, Any] = {f"simulation.specimen.{key}": value for key, value in medium_of(name).items()}
    values |= {
        "simulation.seed": seed + 1,
        "simulation.beams.excitation_width_m": (x * width_scale, y * width_scale, z * length_scale),
    }
    changed = scene.with_(values)
    before, after = twin_of(scene), twin_of(changed)
    assert before is not None
    assert after is not None
    assert before.settings.specimen is not None
    hz = scene.wanted_frequencies_hz[0]
    # The drive compensates for the medium, so that the first harmonic has its size in the scene.
    ratio = DRIVE.get(name, 1.0) * before.steady_response_m(hz) / after.steady_response_m(hz)
    force = before.settings.specimen.force_density_n_per_m3 * ratio
    return changed.with_({"simulation.specimen.force_density_n_per_m3": force})


def _plain(vibration: Vibration) -> dict[str, Any]:
    arrays = {
        "frequency_hz": vibration.frequency_hz,
        "real_m": vibration.phasor_m.real,
        "imaginary_m": vibration.phasor_m.imag,
    }
    arrays["covariance_m2"] = vibration.covariance_m2
    return {"lateral_m": vibration.lateral_m, **{key: value.tolist() for key, value in arrays.items()}}


def _vibration(scene: Scene, plain: dict[str, Any]) -> Vibration:
    """Return a stored vibration with the stated uncertainties of its lateral offset."""
    [scene_at_offset] = [item for item in scene.places if item.tracking.lateral_offset_m == plain["lateral_m"]]
    arrays = {key: np.array(value) for key, value in plain.items() if key != "lateral_m"}
    phasor_m = arrays["real_m"] + 1j * arrays["imaginary_m"]
    label = f"{plain['lateral_m'] * 1e3:g} mm"
    measured = arrays["frequency_hz"], phasor_m, arrays["covariance_m2"]
    return vibration_at(scene_at_offset, scene.processing.estimator, label, measured)


def _bound(vibrations: Sequence[Vibration], push: Push, truth: tuple[float, float]) -> FloatArray:
    return np.asarray(np.sqrt(np.diag(bound(vibrations, push, "voigt", truth))))


def rows(name: str, trials: Sequence[Trial]) -> list[str]:
    """Return the lines of the tables for one medium."""
    lines = [
        f"| {name} | {law} excluded | {sum(item.excluded[law] for item in trials)} of {len(trials)} |"
        for law in ("voigt", "zener")
    ]
    if name not in MEDIA:
        return lines
    truth = np.array(MEDIA[name])
    medium = f"{truth[0] * 1e-3:g} kPa, {truth[1]:g} Pa s"
    for key in ("five", "one"):
        error = np.array([item.values[key] - truth for item in trials])
        stated, bounds = (np.array([getattr(item, field)[key] for item in trials]) for field in ("stated", "bounds"))
        ratio, sd = np.abs(error / stated), np.std(error, axis=0, ddof=1)
        # Standard deviation relative to the Cramer-Rao bound.
        relative_sd = sd / np.sqrt(np.mean(bounds**2, axis=0))
        cells = [
            f"{100 * error[:, i].mean() / truth[i]:+.2f} ± {100 * sd[i] / truth[i] / np.sqrt(len(trials)):.2f} | "
            f"{100 * sd[i] / truth[i]:.2f} | {100 * np.sqrt(np.mean(stated[:, i] ** 2)) / truth[i]:.2f} | "
            f"{100 * np.mean(ratio[:, i] < 1):.0f}, {100 * np.mean(ratio[:, i] < K_95):.0f} | {relative_sd[i]:.2f}"
            for i in range(2)
        ]
        lines.append(f"| {medium} | {len(trials)} | {key} | {' | '.join(cells)} |")
    corrections = np.concatenate([item.lateral for item in trials])
    return [
        *lines,
        f"{medium}: corrections of the offsets, rms {np.sqrt(np.mean(corrections**2)):.2f} of their stated u",
    ]


if __name__ == "__main__":
    main()
