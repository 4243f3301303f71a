"""Measure how often the stated intervals hold the truth: shipped scenes, every estimator, many seeds on the twin.

A seed draws everything that a stated uncertainty covers: scatterers, noise and trigger jitter; the twin's sound speed
about the scene's, with the gate on the focus as an operator puts it there; and, where tonebursts push a medium that
the scene does not declare, the medium and the widths of the force, from the distributions that the prior of media has
(docs/explanation/medium-prior.md). The drive is set so that the first harmonic stays as large as in the scene. What each
headline estimate says, amplitude and phase of the peak displacement with combined standard uncertainties u and
95 % intervals, is compared with the twin's truth: share of errors within the intervals, and NEV, the mean of (error
/ u)^2. A run's frequencies and shots share their speckle, so that the Monte Carlo error of a row is that of its
seeds, not of its errors.

What has been measured stays in a folder, a file for every scene, estimator and few seeds, as long as the scene and
the source of what measures it stay the same. So a long campaign can be stopped, continued and spread over processes,
and the page is made of what is there.

    python scripts/validation/interval_coverage.py --parts coverage-parts --seeds 0:200
    python scripts/validation/interval_coverage.py --parts coverage-parts --seeds 0:20 --scene table-1 --scene bovine-muscle
    python scripts/validation/interval_coverage.py --parts coverage-parts --seeds 0:0        # the page alone
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
    PRIOR_RANGES,
)
from hpe_rig.plan import PlanError
from hpe_rig.processing import ESTIMATORS
from hpe_rig.result import Result
from hpe_rig.scene import Scene, shipped_scenes, with_default_specimen
from hpe_rig.store import StoreError

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "validation" / "coverage.md"
ROOMS = ("scene", "bench", "plan", "acquire", "processing", "prediction", "result")
SOURCES = (*(f"hpe_rig/{room}" for room in ROOMS), "drivers", "sim_backend")
"""Folders whose source decides what is measured."""
BLOCK = 5
"""Seeds of a file: what a stopped campaign loses of each process at most."""
ALIKE = {
    "gelatin-12": "gelatin-8",
    "gelatin-15": "gelatin-8",
    "muscle-repeats": "muscle-force",
}
"""Scenes left out: each is another one once the medium is drawn, but for settings that change no interval."""
WRAPS = "quarter wavelengths from pulse to pulse"
"""Of the warning that the displacement may be off by half wavelengths: the drive is too strong for the pulse rate."""
TOO_FAST = "motion between pulses"
"""The check that refuses the same before the run, where the twin tells."""
FORCES = 3
"""Of a sweep over the force so many are measured, the strongest, the weakest and one between; and no repeats."""
FAMILIES = ("voigt", "zener", "power_law", "elastic voigt", "maxwell")
"""The prior's."""
CREEP_ORDER = 2
"""Background that is fitted along where nobody knows the medium: under the bursts' mean force some creep."""
WIDTH_SPREAD = 0.3
"""Standard deviation of the logarithm of the force's widths: that of the prior's `BeamWidths`."""


@dataclass(frozen=True)
class Row:
    """Coverage of one scene and estimator: of amplitude and of phase, over ``errors`` errors from ``seeds`` runs."""

    scene: str
    estimator: str
    seeds: int
    refused: int
    warned: int
    within_95: tuple[float, float]
    nev: tuple[float, float]
    nev_error: tuple[float, float]


def main() -> None:
    """Measure what is not there yet, and write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--parts", type=Path, required=True, help="folder of what has been measured")
    parser.add_argument("--seeds", default="0:200", help="A:B, from A up to B - 1")
    parser.add_argument("--scene", action="append", choices=measured_scenes(), help="repeatable; default: all")
    parser.add_argument("--estimator", action="append", choices=ESTIMATORS, help="repeatable; default: all")
    parser.add_argument("--workers", type=int, default=os.cpu_count())
    parser.add_argument("--output", type=Path, default=PAGE)
    asked = parser.parse_args()
    first, last = (int(each) for each in asked.seeds.split(":"))
    asked.parts.mkdir(parents=True, exist_ok=True)
    estimators = tuple(asked.estimator or ESTIMATORS)
    # A block of every scene, then the next one: a campaign that is stopped has as many seeds of each.
    blocks = [
        (name, seeds)
        for at in range(first - first % BLOCK, last, BLOCK)
        for name in asked.scene or measured_scenes()
        if (seeds := range(max(at, first), min(at + BLOCK, last)))
    ]
    start_s = time.monotonic()
    with ProcessPoolExecutor(asked.workers) as pool:
        runs = {pool.submit(measured, asked.parts, name, estimators, seeds): (name, seeds) for name, seeds in blocks}
        for count, run in enumerate(as_completed(runs), 1):
            name, seeds = runs[run]
            run.result()
            at = f"seeds {seeds[0]} to {seeds[-1]}"
            print(f"{time.monotonic() - start_s:6.0f} s  {count}/{len(blocks)}  {name}, {at}", flush=True)
    rows = [row for name in measured_scenes() for row in _rows(asked.parts, name)]
    asked.output.write_text(page(rows), encoding="utf-8")


def measured_scenes() -> list[str]:
    """Return the shipped scenes that are measured."""
    return [name for name in shipped_scenes() if name not in ALIKE]


def measured(folder: Path, name: str, estimators: Sequence[str], seeds: Sequence[int]) -> None:
    """Measure ``seeds`` of the shipped scene ``name`` and put them into ``folder``, a file an estimator.

    What is there already is not measured again.
    """
    paths = {each: folder / f"{name}.{each}.{seeds[0]}-{seeds[-1]}.{_key(name)}.json" for each in estimators}
    missing = tuple(each for each, path in paths.items() if not path.exists())
    if not missing:
        return
    runs = [errors_over_u(name, missing, seed) for seed in seeds]
    for each in missing:
        errors = [None if (found := run[each]) is None else found.tolist() for run in runs]
        part = paths[each].with_suffix(".part")
        part.write_text(json.dumps(dict(zip(seeds, errors, strict=True))), encoding="utf-8")
        part.replace(paths[each])


@functools.cache
def _key(name: str) -> str:
    """Return a name for what decides the errors of a scene: the scene, and the source of what measures it."""
    digest = hashlib.sha256(thinned(with_default_specimen(hpe.load_scene(name))).model_dump_json().encode())
    for folder in SOURCES:
        for path in sorted((ROOT / folder).rglob("*.py")):
            digest.update(path.read_bytes())
    for part in (errors_over_u, thinned, drawn, _bowl, _as_large, drawn_medium, _ratios, _each_ratio):
        digest.update(inspect.getsource(part).encode())
    digest.update(repr((FORCES, FAMILIES, CREEP_ORDER, WIDTH_SPREAD)).encode())
    return digest.hexdigest()[:12]


def _rows(folder: Path, name: str) -> Iterator[Row]:
    """Yield a row for each estimator of which ``folder`` holds seeds."""
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
    speed, rng, bowl = scene.acquisition.sound_speed_m_per_s, np.random.default_rng(seed), _bowl(scene)
    relative = scene.acquisition.sound_speed_uncertainty * rng.standard_normal()
    values: dict[str, Any] = {
        "simulation.seed": seed + 1,
        "simulation.sound_speed_m_per_s": speed * (1 + relative),
        "simulation.beams.focus_depth_m": scene.acquisition.gate_depth_m * (1 + relative),
    }
    if places_m := scene.sweep.lateral_offset_m:
        # A seed at each place in turn: beside the push the twin takes seconds a place.
        values["sweep.lateral_offset_m"] = (places_m[seed % len(places_m)],)
    if bowl:
        values["simulation.beams.transducer.focal_length_m"] = values["simulation.beams.focus_depth_m"]
    if scene.medium is None and "specimen" in (scene.simulation or {}):
        values |= {f"simulation.specimen.{name}": value for name, value in drawn_medium(rng).items()}
        values["processing.background_order"] = max(scene.processing.background_order, CREEP_ORDER)
        # Nor has anyone measured how wide the force is in the medium: the prior takes its widths for uncertain.
        wide, deep = np.exp(WIDTH_SPREAD * rng.standard_normal(2)).tolist()
        if scene.beams is not None:
            x, y, z = scene.beams.excitation_width_m
            # A bowl's field is what it is: then what the scene says of it is drawn.
            key = "beams.excitation_width_m" if bowl else "simulation.beams.excitation_width_m"
            values[key] = (x * wide, y * wide, z * deep)
    return _as_large(scene.with_(values), scene)


def _bowl(scene: Scene) -> bool:
    """Return whether the twin's beams are those of an aperture, not Gaussians."""
    return (scene.simulation or {}).get("beams", {}).get("field") == "aperture"


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
    modulus_pa = log_even(PRIOR_RANGES.modulus_pa)
    found: dict[str, Any] = {"medium": family.removeprefix("elastic "), "shear_modulus_pa": modulus_pa}
    match family:
        case "voigt":
            found["shear_viscosity_pa_s"] = log_even(PRIOR_RANGES.viscosity_pa_s)
        case "elastic voigt":
            found["shear_viscosity_pa_s"] = log_even(PRIOR_RANGES.low_viscosity_pa_s)
        case "zener":
            found["shear_viscosity_pa_s"] = log_even(PRIOR_RANGES.viscosity_pa_s)
            found["branch_modulus_pa"] = modulus_pa * log_even(PRIOR_RANGES.branch_over_modulus)
        case "power_law":
            found["power"] = float(rng.uniform(*PRIOR_RANGES.power))
            found["reference_frequency_hz"] = PRIOR_RANGES.power_modulus_hz
        case "maxwell":
            found["shear_viscosity_pa_s"] = log_even(PRIOR_RANGES.maxwell_viscosity_pa_s)
    return found


def _ratios(run: hpe.Run, estimator: str) -> FloatArray | None:
    """Return error over u and over the half width of the 95 % interval, (estimate, 2, 2).

    None where records are refused, no estimate where a warning rules it out.
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
            stated = item.headline
            error_m = (item.corrected_amplitude_error or 0.0) * (item.true_amplitude_m or 0.0)
            error_rad = item.corrected_phase_error_rad or 0.0
            widths_m = stated.amplitude_uncertainty_m, stated.interval_95_m
            widths_rad = stated.phase_uncertainty_rad, stated.interval_95_rad
            yield np.stack([error_m / np.array(widths_m), error_rad / np.array(widths_rad)])


def _row(name: str, estimator: str, runs: Sequence[FloatArray | None]) -> Row:
    """Return the coverage over ``runs``, what ``_ratios`` has of each."""
    answered = [run for run in runs if run is not None]
    found = [run for run in answered if len(run)]
    ratio = np.concatenate(found) if found else np.full((1, 2, 2), np.nan)
    within = (np.abs(ratio[..., 1]) < 1).mean(axis=0)
    nev, each = (ratio[..., 0] ** 2).mean(axis=0), [(run[..., 0] ** 2).mean(axis=0) for run in found]
    error = np.std(each, axis=0) / np.sqrt(max(len(each), 1)) if each else np.full(2, np.nan)
    pairs = [(float(pair[0]), float(pair[1])) for pair in (within, nev, error)]
    return Row(name, estimator, len(found), len(runs) - len(answered), len(answered) - len(found), *pairs)


def page(rows: Sequence[Row]) -> str:
    """Return the page in Markdown."""
    return "\n".join(
        [
            "# Coverage",
            "",
            HEAD,
            "Made by `python scripts/validation/interval_coverage.py`; the last column has the number of runs.",
            "",
            "| scene | estimator | amplitude 95 % | NEV | phase 95 % | NEV | runs |",
            "|---|---|---:|---:|---:|---:|---:|",
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
            f"{100 * row.within_95[axis]:.0f}",
            f"{row.nev[axis]:.2f} ± {row.nev_error[axis]:.2f}",
        )
    ]
    runs = f"{row.seeds}" + "".join(
        f", {count} {what}" for count, what in ((row.refused, "refused"), (row.warned, "warned")) if count
    )
    return f"| {row.scene} | {row.estimator} | {' | '.join(cells if row.seeds else ['-'] * len(cells))} | {runs} |"


HEAD = """\
How often the stated 95 % intervals of the headline amplitude and phase (corrected to the peak displacement;
[what they mean](numbers.md)) hold the twin's truth, and NEV, the mean of (error / u)^2, which is 1 where u is true,
with its standard error over the seeds. Frequencies and shots of a run share their speckle: with n runs, shares are
known to about 22 percentage points over the root of n, 1.5 for 200.

What a seed draws is what the uncertainty says is not known, and nothing else:

* scatterers, noise, trigger jitter, and the sound speed by its stated uncertainty, with the gate on the focus;
* where tonebursts push a medium that the scene does not declare: the medium, of the families and ranges of [the
  prior](theory/medium-prior.md), and the width and length of the force, each by 30 %. The drive then makes the first
  wanted harmonic as large as in the scene, as an operator sets it. Maxwell and power-law media creep under the bursts'
  mean force, so `background_order = 2` is fitted along, for all media alike.

The medium that the scene's own twin has is one of these. Coverage is an average over all of them: for a medium and
a force in the middle of the ranges u is too wide, for a force half as wide as `[beams]` says it is too narrow. Shots
are thinned: no repeats, three of sixteen forces, and of five places beside the push one a seed, in turn. A stiff,
nearly elastic medium can move so fast that the echo jumps by a quarter wavelength from pulse to pulse. `check` refuses
that or the result warns, and asks for less drive or a higher pulse rate: such runs are counted as warned and are in no
share.
"""

NOTES = """\
## Errors that are not normal

u is a standard deviation, whatever the distribution of an error: NEV is 1 where it is true. The shares within u and
1.96 u are those of a normal error only where the error is one, and speckle's is not: u holds more than 68 %, 1.96 u
still holds 95 % (`python scripts/validation/error_distributions.py`):

| error | within u | within 1.96 u | NEV | kurtosis |
|---|---:|---:|---:|---:|
| speckle, `table-1` | 73 % | 95 % | 1.00 | 5.7 |
| speckle, gate with Hann window (`cross_spectrum`) | 77 % | 95 % | 1.00 | 9.3 |
| speckle, force of unknown width (phase of `bovine-muscle`) | 81 % | 94 % | 1.00 | 14.9 |

![Densities of these errors over u beside a normal one](figures/error-distributions.svg)

* Speckle has dark spots, where its error is far larger than elsewhere. How dark the spot is that a gate holds, its
  echoes do not say: nothing tells how bright they would be elsewhere.
* Over 400 seeds of `bovine-muscle` (`coherent`) u and 1.96 u hold 74 and 96 % of the amplitudes, 80 and 96 % of the
  phases. NEV is 1.06 ± 0.15 and 0.95 ± 0.18: a few runs in dark spots decide it.
* The phase's error by speckle goes with the inverse square of the force's width, which the motion at one spot cannot
  tell from the medium: with a width known to 30 %, the mean of its square is twice the median. Ten times the media in
  the prior, at ten times the cost, narrow what is said of the averaging by a tenth.
* Of a phase about which nothing is known u is 104 degrees, the standard deviation of a phase even over the circle,
  and its interval is the whole circle. In `limits-muscle`
  that is most of what `cross_spectrum` has: 1 ns of trigger jitter moves the echo by a hundred times the motion, and
  where the peak of its spectrum jumps from bin to bin the reference gate does not take it off. The pulses that are
  skipped about every toneburst let the noise along one direction of the phasors grow to 9 to 110 nm, while across it
  there are 3 nm; the motion of 2 to 8 nm lies within some 30 degrees of that direction in most media, so that noise
  alone decides whether the phase found is about right or nearly opposite. Errors are then below 40 or above 100
  degrees, and an interval of 110 degrees holds 56 %. u assumes that the true phase may be any.

u holds one thing that no seed draws. The prior allows reflections and layers, which no medium without end has, 3 % of
each harmonic, and so much of them as its shrinkage takes counts as aliasing: where amplitudes are ten to twenty times
their noise, as in `limits-muscle` and `limits-gelatin-8`, about 6 % of u's square.

The weakest of the three forces of `muscle-force` and `muscle-force-200us`, 1 % of the drive, moves a fifth of u at
100 Hz: no motion is found there, its phase may be anything, and its amplitude is that of noise. u says so
([amplitudes and phases that may be noise](theory/estimation.md#uncertainties)); at amplitudes of one to three u it is
then wider than the error.

In `gelatin-moduli` the medium's creep after the bursts counts as noise where noise is most of u: in 60 of 75 Maxwell
media and 27 of 64 of the power law (400 seeds, `coherent`) a line at 10 to 20 Hz remains that a background of order 2
does not hold, and `report` warns of it. NEV of these estimates is 0.62, and 1.05 with `processing.background_order =
4`. Runs whose motion is lost between pulses, 27 %, are left out, and they are those that move most. Where these too
are driven at a half or a quarter, as the warning asks, the intervals of 400 seeds hold 71 and 95 % of the amplitudes
and 68 and 94 % of the phases, with NEV of 0.94 ± 0.08 and 1.02 ± 0.08 (`coherent`). Beside the push there are media
and harmonics of which two waves leave hardly anything, whose relative change over the beam has no bound: such a medium
counts with half of the likely media's rms motion. Without that, NEV of the amplitudes was 0.57 and that of the phases
0.62.

In `steel-sphere` the pulses stand still against the bursts, and the sphere's inertia alone decides how its harmonics
beyond 2 kHz fall, as 1 / f^2: what aliases is the same in every run, -12 nm at 1 kHz, a whole u of the noise. Without
noise and jitter the error of least squares is that of the closed form at the pulses' instants and nothing else. The
scene therefore declares its `[sphere]`, and the prior is that of a sphere in the media.

In `bovine-muscle-aperture` the bowl's focal length is drawn with the sound speed, so that its focus is in the
gate, and in place of the twin's force the widths that `[beams]` says it has. These err less than u allows: the declared
aperture, from which the force is computed, corrects them, while u keeps their 30 % for what the specimen does to
the beam.

Left out: `gelatin-12` and `gelatin-15`, which are `gelatin-8` once the medium is drawn; `muscle-repeats`, which is
`muscle-force` with fewer forces.
"""


if __name__ == "__main__":
    main()
