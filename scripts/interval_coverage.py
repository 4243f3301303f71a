"""Measure how often the stated intervals hold the truth: shipped scenes, every estimator, many seeds on the twin.

A seed draws everything that a stated uncertainty covers: scatterers, noise and trigger jitter; the twin's sound speed
about the scene's, with the gate on the focus as an operator puts it there; and, where tonebursts push a medium that the
scene does not declare, the medium and the widths of the force, from the distributions that the prior of media has
(docs/theory/medium-prior.md). The drive is set so that the first harmonic stays as large as in the scene. What each
headline estimate says, amplitude and phase of the peak displacement with combined standard uncertainties u, is compared
with the twin's truth: share of errors within u and within 1.96 u, and NEV, the mean of (error / u)^2. A run's
frequencies and shots share their speckle, so that the Monte Carlo error of a row is that of its seeds, not of its
errors.

    python scripts/interval_coverage.py                    # writes docs/coverage.md, about half an hour
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
from hpe_rig.bench import twin_of
from hpe_rig.plan import PlanError
from hpe_rig.processing import (
    BRANCH_OVER_MODULUS,
    ESTIMATORS,
    LOW_VISCOSITY_PA_S,
    MAXWELL_VISCOSITY_PA_S,
    MODULUS_PA,
    POWER,
    POWER_REFERENCE_HZ,
    VISCOSITY_PA_S,
)
from hpe_rig.result import Result
from hpe_rig.scene import Scene, shipped_scenes, with_default_specimen
from hpe_rig.store import StoreError

PAGE = Path(__file__).parent.parent / "docs" / "coverage.md"
SEEDS = 200
ALIKE = {
    "gelatin-12": "gelatin-8",
    "gelatin-15": "gelatin-8",
    "muscle-repeats": "muscle-force",
}
"""Scenes left out: each is another one once the medium is drawn, but for settings that change no interval."""
BESIDE = "gelatin-moduli"
"""Scene left out: its results are moduli, from places beside the push that take a member of the prior some ms each."""
WRAPS = "quarter wavelengths from pulse to pulse"
"""Of the warning that the displacement may be off by half wavelengths: the drive is too strong for the pulse rate."""
TOO_FAST = "motion between pulses"
"""The check that refuses the same before the run, where the twin tells."""
FORCES = 3
"""Of a sweep over the force so many are measured, the strongest, the weakest and one between; and no repeats."""
FAMILIES = ("voigt", "zener", "power_law", "elastic voigt")
"""Of the prior's families all but Maxwell's, whose motion under the bursts' mean force is not periodic."""
WIDTH_SPREAD = 0.3
"""Standard deviation of the logarithm of the force's widths: that of the prior's `BeamWidths`."""
K_95 = 1.959964
"""Half width of the 95 % interval of a normal error, in standard deviations."""


@dataclass(frozen=True)
class Row:
    """Coverage of one scene and estimator: of amplitude and of phase, over ``errors`` errors from ``seeds`` runs."""

    scene: str
    estimator: str
    seeds: int
    refused: int
    warned: int
    within_68: tuple[float, float]
    within_95: tuple[float, float]
    nev: tuple[float, float]
    nev_error: tuple[float, float]


def main() -> None:
    """Measure and write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=SEEDS)
    parser.add_argument("--scenes", nargs="+", default=measured_scenes())
    parser.add_argument("--estimators", nargs="+", default=list(ESTIMATORS))
    parser.add_argument("--workers", type=int, default=os.cpu_count())
    parser.add_argument("--output", type=Path, default=PAGE)
    asked = parser.parse_args()
    rows: list[Row] = []
    for name in asked.scenes:
        rows += coverage(name, asked.estimators, range(asked.seeds), asked.workers)
        asked.output.write_text(page(rows, asked.seeds), encoding="utf-8")
        print(f"{name}: done", flush=True)


def measured_scenes() -> list[str]:
    """Return the shipped scenes that are measured by default."""
    return [name for name in shipped_scenes() if name not in ALIKE and name != BESIDE]


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
    scene = drawn(thinned(with_default_specimen(hpe.load_scene(name))), seed)
    with TemporaryDirectory() as folder:
        try:
            run = hpe.measure(scene, path=Path(folder) / "run.h5")
        except PlanError as error:
            if TOO_FAST not in str(error):
                raise
            return dict.fromkeys(estimators, np.zeros((0, 2)))
        return {estimator: _ratios(run, estimator) for estimator in estimators}


def thinned(scene: Scene) -> Scene:
    """Return ``scene`` without repeats and with few forces: they share their speckle and tell little that is new."""
    values: dict[str, Any] = {"acquisition.repeats": 1}
    if scene.excitation is not None and len(forces := scene.excitation.force_fraction) > FORCES:
        values["excitation.force_fraction"] = (forces[0], forces[len(forces) // 2], forces[-1])
    return scene.with_(values)


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
        values |= {f"simulation.specimen.{name}": value for name, value in drawn_medium(rng).items()}
        # Nor has anyone measured how wide the force is in the medium: the prior takes its widths for uncertain.
        wide, deep = np.exp(WIDTH_SPREAD * rng.standard_normal(2)).tolist()
        if scene.beams is not None:
            x, y, z = scene.beams.excitation_width_m
            values["simulation.beams.excitation_width_m"] = (x * wide, y * wide, z * deep)
    return _as_large(scene.with_(values), scene)


def _as_large(scene: Scene, before: Scene) -> Scene:
    """Return ``scene`` driven so that its first harmonic is as large as ``before``: as an operator sets the drive."""
    drawn, own = twin_of(scene), twin_of(before)
    if drawn is None or own is None or not drawn.has_specimen:
        return scene
    force, hz = own.settings.specimen, scene.wanted_frequencies_hz[0]
    assert force is not None
    ratio = own.steady_response_m(hz) / drawn.steady_response_m(hz)
    return scene.with_({"simulation.specimen.force_density_n_per_m3": force.force_density_n_per_m3 * ratio})


def drawn_medium(rng: np.random.Generator) -> dict[str, Any]:
    """Return a medium as the prior of media has them: of one of its families, parameters even over their ranges."""

    def log_even(limits: tuple[float, float]) -> float:
        return float(limits[0] * (limits[1] / limits[0]) ** rng.uniform())

    family = FAMILIES[rng.integers(len(FAMILIES))]
    modulus_pa = log_even(MODULUS_PA)
    found: dict[str, Any] = {"medium": family.removeprefix("elastic "), "shear_modulus_pa": modulus_pa}
    match family:
        case "voigt":
            found["shear_viscosity_pa_s"] = log_even(VISCOSITY_PA_S)
        case "elastic voigt":
            found["shear_viscosity_pa_s"] = log_even(LOW_VISCOSITY_PA_S)
        case "zener":
            found["shear_viscosity_pa_s"] = log_even(VISCOSITY_PA_S)
            found["branch_modulus_pa"] = modulus_pa * log_even(BRANCH_OVER_MODULUS)
        case "power_law":
            found["power"] = float(rng.uniform(*POWER))
            found["reference_frequency_hz"] = POWER_REFERENCE_HZ
        case "maxwell":
            found["shear_viscosity_pa_s"] = log_even(MAXWELL_VISCOSITY_PA_S)
    return found


def _ratios(run: hpe.Run, estimator: str) -> NDArray[np.float64] | None:
    """Return error over u (estimate, 2): None where records are refused, no estimate where a warning rules it out."""
    try:
        result = run.estimate(estimator)
    except StoreError:
        return None
    if any(WRAPS in text for shot in result.shots for text in shot.warnings):
        return np.zeros((0, 2))
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
    answered = [run for run in runs if run is not None]
    found = [run for run in answered if len(run)]
    ratio = np.concatenate(found) if found else np.full((1, 2), np.nan)
    within = (np.abs(ratio)[:, None] < np.array([1.0, K_95])[:, None]).mean(axis=0)
    nev, each = (ratio**2).mean(axis=0), [(run**2).mean(axis=0) for run in found]
    error = np.std(each, axis=0) / np.sqrt(max(len(each), 1)) if each else np.full(2, np.nan)
    pairs = [(float(pair[0]), float(pair[1])) for pair in (*within, nev, error)]
    return Row(name, estimator, len(found), len(runs) - len(answered), len(answered) - len(found), *pairs)


def page(rows: Sequence[Row], seeds: int) -> str:
    """Return the page in Markdown."""
    scenes = dict.fromkeys(row.scene for row in rows)
    some = "" if list(scenes) == measured_scenes() else f" --scenes {' '.join(scenes)}"
    error = 100 * np.sqrt(np.array([0.68 * 0.32, 0.95 * 0.05]) / seeds)
    return "\n".join(
        [
            "# Coverage",
            "",
            HEAD.format(seeds=seeds, error_68=error[0], error_95=error[1]),
            f"Made by `python scripts/interval_coverage.py --seeds {seeds}{some}`.",
            "",
            "| scene | estimator | amplitude 68 % | 95 % | NEV | phase 68 % | 95 % | NEV | runs |",
            "|---|---|---:|---:|---:|---:|---:|---:|---:|",
            *(_line(row) for row in rows),
            "",
            NOTES,
        ]
    )


def _line(row: Row) -> str:
    cells = [
        text
        for axis in (0, 1)
        for text in (
            f"{100 * row.within_68[axis]:.0f}",
            f"{100 * row.within_95[axis]:.0f}",
            f"{row.nev[axis]:.2f} ± {row.nev_error[axis]:.2f}",
        )
    ]
    runs = f"{row.seeds}" + "".join(
        f", {count} {what}" for count, what in ((row.refused, "refused"), (row.warned, "warned")) if count
    )
    return f"| {row.scene} | {row.estimator} | {' | '.join(cells if row.seeds else ['-'] * len(cells))} | {runs} |"


HEAD = """\
How often the 68 and 95 % intervals of the headline amplitude and phase (corrected to the peak displacement, combined
u; [what they mean](numbers.md)) hold the twin's truth, and NEV, the mean of (error / u)^2, which is 1 where u is true,
with its standard error over the seeds. Frequencies and shots of a run share their speckle: with {seeds} seeds, shares
are known to about {error_68:.1f} and {error_95:.1f} percentage points.

What a seed draws is what the uncertainty says is not known, and nothing else:

* scatterers, noise, trigger jitter, and the sound speed by its stated uncertainty, with the gate on the focus;
* where tonebursts push a medium that the scene does not declare: the medium, of the families and ranges of [the
  prior](theory/medium-prior.md), and the width and length of the force, each by 30 %. The drive then makes the first
  wanted harmonic as large as in the scene, as an operator sets it. Maxwell's family is not drawn: such a medium flows
  under the bursts' mean force, and in the 200 ms of these trains that creep is neither periodic nor even. There u is
  too small (of 16 such media under `bovine-muscle` with `background_order = 1`: NEV 2.9 in amplitude, 24 in phase), and
  a warning came in five of them.

The medium that the scene's own twin has is one of these. Coverage is an average over all of them: for a medium and
a force in the middle of the ranges u is too wide, for a force half as wide as `[beams]` says it is too narrow. Shots
are thinned: no repeats, three of sixteen forces. A stiff, nearly elastic medium can move so fast that the echo jumps by
a quarter wavelength from pulse to pulse. `check` refuses that or the result warns, and asks for less drive or a higher
pulse rate: such runs are counted as warned and are in no share.
"""

NOTES = """\
Speckle has dark spots, where its error is far larger than elsewhere: with u true on the mean (NEV 1) the 68 % interval
holds more than 68 %. Where least squares or the paper's chain meet harmonics that alias unseen, the error is nearly the
same in every run on a medium, and shares say little there; NEV does.

`joint` finds no displacement of single pulses and cannot follow tissue that moves by millimetres: `cardiac-background`
has a gate that follows, so it is refused there.

The weakest of the three forces of `muscle-force` and `muscle-force-200us`, 1 % of the drive, moves a fifth of u at
100 Hz: no motion is found there, and its phase may be anything. u says so
([the phase of a weak amplitude](theory/estimation.md#uncertainties)); a phase's u that is noise over amplitude whatever
the amplitude gave NEV 1.58 and 3.16 in these two scenes, 3 to 6 for that force alone and 0.96 where the amplitude is
above 5 u. Neither speckle, trigger timing nor the start-up had a part in it. The price: at amplitudes of one to three u
the phase's u is wider than its error (NEV 0.4 to 0.6); `cross_spectrum` has 0.62 and 0.72 in these scenes.

Where every burst period is sampled alike, phase has NEV 0.64 to 0.8 (`bovine-muscle-synchronous`, `gelatin-8`,
`muscle-window`): u is up to a quarter too wide. A large part of it is aliasing that no pulse can see, for which u
counts Maxwell's family as well, which is not drawn here.

Left out: `gelatin-12` and `gelatin-15`, which are `gelatin-8` once the medium is drawn; `muscle-repeats`, which is
`muscle-force` with fewer forces; `gelatin-moduli`, whose results are moduli, from places beside the push.
"""


if __name__ == "__main__":
    main()
