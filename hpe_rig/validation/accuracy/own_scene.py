"""Error against run time on a scene: estimators, harmonic fits, gates, echo tolerances and fields.

A *variant* changes one setting of the scene and keeps all others. Every seed draws new scatterers and new noise, the
same for all variants, so that differences between variants have less scatter than the errors themselves. Variants that
change the estimation alone share the records, which are measured once per seed by the functions of ``hpe-rig run``.
Every measurement is made twice and the second is timed: imports, compilation and caches are then complete.
"""

from __future__ import annotations

import contextlib
import math
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar, get_args

import numpy as np

from hpe_rig.arrays import FloatArray
from hpe_rig.bench import twin_of
from hpe_rig.measurement import plan_and_check, prepare
from hpe_rig.processing import ESTIMATORS
from hpe_rig.result import text_table
from hpe_rig.runs import Run, measure
from hpe_rig.scene import Mistake, Processing, Scene, SettingsError
from hpe_rig.store import StoreError
from hpe_rig.study import one_shot
from hpe_rig.validation.accuracy.work_precision import draw_panels, file_mistakes, grouped, timed, write_rows

Value = TypeVar("Value")

SEEDS, QUICK_SEEDS = 20, 8
QUICK_S = 50.0
"""Processor time of a quick run, s: a further seed starts only if it is expected to end within it."""
TOLERANCES = (1e-3, 1e-5, 1e-10)
RELATIVE_GATE_LENGTHS = (0.5, 1.5, 2.0)
"""Gate lengths relative to that of the scene."""
UNCHANGED = "own settings"
EQUALITY_TOLERANCE = 0.05
"""Relative difference below which two times or two errors count as equal."""
SIGNIFICANT_STANDARD_ERRORS = 3.0
"""Errors of two variants are different if they differ by this number of standard errors over the seeds."""
BENEFITS: Mapping[str, str] = {
    "estimator": "the lowest noise at any SNR, and motion of many wavelengths can be tracked",
    "harmonic": "a fit that remains valid for other media, noise levels and gaps than those of this scene",
    "gate": "resolution in depth: a longer gate averages over more of the medium",
    "echo tolerance": "echoes exact to a thousandth of a code of the digitizer",
    "field": "the shear field of the medium, which the Gaussian of eq. (12) only approximates",
}
"""Benefit of the scene's setting that neither error nor run time shows, by the setting that is varied."""


@dataclass(frozen=True, slots=True)
class Variant:
    """One change of the scene: ``values`` by key path. ``new_records``: it changes the simulation, not only the fit."""

    varied: str
    setting: str
    values: Mapping[str, Any]
    new_records: bool = False


@dataclass(frozen=True, slots=True)
class SceneRow:
    """Errors and times of one variant.

    Errors are norms over all wanted frequencies, relative to the norm of the true amplitudes. They are errors of the
    amplitude corrected for beam averaging where that is predicted. NaN: the variant gives no estimate.
    """

    varied: str
    setting: str
    bias: float
    """Norm of the mean error over the seeds; its standard error is ``sd`` over the root of the number of seeds."""
    sd: float
    """Standard deviation over the seeds."""
    error: float
    """Root mean square error: bias and standard deviation combined."""
    time_s: float
    """Processor time from scene to result, s: the minimum over the seeds, because disturbances only add to it."""
    estimation_s: float
    """Part of ``time_s`` from records to result, s."""
    seeds: int
    own: bool
    """Whether this is the scene without a change."""
    on_front: bool = False
    """Whether no other variant beats it (see ``_beats``)."""
    beats_own: bool = False
    """Whether it beats the scene without a change."""
    is_more_exact: bool = False
    """Whether its error is below that of the scene without a change by more than chance allows."""


def write_own_scene(
    source: str, bench: Path | None, seeds: int | None, quick: bool, output: Path | None, figure: Path | None,
    show: Callable[[str], None], report_progress: Callable[[str], None],
) -> None:  # fmt: skip
    """Measure every variant of the scene ``source``, and write the table or pass it to ``show``.

    Raises ``SettingsError``, before anything is measured, for mistakes in the scene, for file names that cannot be
    written, and for a real bench, where the truth is unknown.
    """
    if mistakes := file_mistakes(output, figure):
        raise SettingsError("command line", mistakes)
    setup = prepare(source, bench)
    if not setup.bench.bench.simulated:
        what = "the errors need the true motion, which only a simulated bench knows"
        raise SettingsError("command line", [Mistake("--bench", what, "a simulated bench, or omit --bench")])
    scene = one_shot(setup.scene.scene)
    max_seeds = seeds or (QUICK_SEEDS if quick else SEEDS)
    rows = scene_rows(scene, bench, variants(scene), max_seeds, QUICK_S if quick else math.inf, report_progress)
    write_rows(rows, output, figure, draw_scene, show, scene_text)


def variants(scene: Scene) -> list[Variant]:
    """Return the variants of ``scene``: first the scene without a change, then every change that is valid for it."""
    twin, processing, gate_m = twin_of(scene), scene.processing, scene.acquisition.gate_length_m
    candidates = [Variant(UNCHANGED, processing.estimator, {})]
    candidates += [
        Variant("estimator", name, {"processing.estimator": name})
        for name in ESTIMATORS
        if name != processing.estimator
    ]
    candidates += [Variant("harmonic", name, {"processing.harmonic": name}) for name in _alternative_fits(scene)]
    candidates += [
        Variant("gate", f"{gate_m * factor * 1e3:g} mm", {"acquisition.gate_length_m": gate_m * factor})
        for factor in RELATIVE_GATE_LENGTHS
    ]
    candidates += [
        Variant("echo tolerance", f"{value:g}", {"simulation.scatterers.echo_tolerance": value}, new_records=True)
        for value in TOLERANCES
    ]
    if twin is not None and twin.settings.specimen is not None:
        field = "gaussian" if twin.settings.specimen.field == "medium" else "medium"
        candidates.append(Variant("field", field, {"simulation.specimen.field": field}, new_records=True))
    valid = []
    for variant in candidates:
        with contextlib.suppress(SettingsError):
            scene.with_(variant.values)
            valid.append(variant)
    return valid


def scene_rows(
    scene: Scene,
    bench: Path | None,
    tried: Sequence[Variant],
    seeds: int,
    max_time_s: float = math.inf,
    report_progress: Callable[[str], None] = lambda _: None,
) -> list[SceneRow]:
    """Return a row for every variant, from two to ``seeds`` seeds: as many as ``max_time_s`` is expected to allow."""
    trials_by_seed: list[list[_Trial]] = []
    start_s = time.process_time()
    for seed in range(1, seeds + 1):
        elapsed_s = time.process_time() - start_s
        time_per_seed_s = elapsed_s / max(len(trials_by_seed), 1)
        if len(trials_by_seed) >= 2 and elapsed_s + time_per_seed_s > max_time_s:
            report_progress(f"no time for more than {len(trials_by_seed)} of {seeds} seeds")
            break
        trials_by_seed.append(_trials_of_seed(scene, bench, tried, seed, report_progress, f"seed {seed} of {seeds}"))
    trials = [list(of_variant) for of_variant in zip(*trials_by_seed, strict=True)]
    unchanged = next((trials[i] for i, variant in enumerate(tried) if variant.varied == UNCHANGED), trials[0])
    return [
        replace(
            _row(variant, variant_trials),
            on_front=not any(_beats(competitor, variant_trials) for competitor in trials),
            beats_own=_beats(variant_trials, unchanged),
            is_more_exact=_is_significantly_less(_error_norms_m(variant_trials), _error_norms_m(unchanged)),
        )
        for variant, variant_trials in zip(tried, trials, strict=True)
    ]


@dataclass(frozen=True, slots=True)
class _Trial:
    """One variant at one seed: errors and true amplitudes (frequency,), m, and processor times."""

    error_m: FloatArray
    true_m: FloatArray
    time_s: float
    estimation_s: float


def _trials_of_seed(
    scene: Scene,
    bench: Path | None,
    tried: Sequence[Variant],
    seed: int,
    report_progress: Callable[[str], None],
    label: str,
) -> list[_Trial]:
    seeded, trials = scene.with_({"simulation.seed": seed}), []
    with tempfile.TemporaryDirectory() as folder:
        # Variants of the estimation share these records.
        shared_run, shared_s = _measure_twice(seeded, bench, Path(folder), "shared")
        for number, variant in enumerate(tried):
            report_progress(f"{label}: {variant.varied} {variant.setting}")
            run, run_s = shared_run, shared_s
            if variant.new_records:
                run, run_s = _measure_twice(seeded.with_(variant.values), bench, Path(folder), str(number))
            elif variant.values:
                # The same records, with the plan and the processing settings of the variant.
                changed = seeded.with_(variant.values)
                plan, findings = plan_and_check(changed, shared_run.bench)
                run = replace(shared_run, scene=changed, plan=plan, findings=findings)
            trials.append(_trial(run, run_s))
    return trials


def _measure_twice(scene: Scene, bench: Path | None, folder: Path, name: str) -> tuple[Run, float]:
    """Return the run of ``scene`` in a new file, and the processor time of the second of two measurements, s."""
    paths = iter([folder / f"{name}-first.h5", folder / f"{name}.h5"])
    return _timed_again(lambda: measure(scene, bench, next(paths)))


def _trial(run: Run, run_s: float) -> _Trial:
    try:
        result, estimation_s = _timed_again(run.estimate)
    except StoreError:
        missing = np.full(len(run.scene.wanted_frequencies_hz), np.nan)
        return _Trial(missing, missing, run_s, math.nan)
    estimates = result.shots[0].estimates
    estimated = [e.amplitude_m for e in estimates]
    true_m = np.array([e.true_amplitude_m or 0.0 for e in estimates])
    return _Trial(np.array(estimated) - true_m, true_m, run_s + estimation_s, estimation_s)


def _beats(trials: Sequence[_Trial], competitor: Sequence[_Trial]) -> bool:
    """Return whether ``trials`` are better than ``competitor`` in time or in error, and not worse in the other.

    The error of a seed is the norm over all wanted frequencies; the time is the minimum over the seeds. Times must
    differ by ``EQUALITY_TOLERANCE``, errors by that and by ``SIGNIFICANT_STANDARD_ERRORS``. A variant without an
    estimate is beaten by every variant with one.
    """
    time_s, competitor_s = (min(trial.time_s for trial in group) for group in (trials, competitor))
    error_m, competitor_m = _error_norms_m(trials), _error_norms_m(competitor)
    if np.isnan(error_m).any() or np.isnan(competitor_m).any():
        return _is_significantly_less(error_m, competitor_m)
    # Better in one quantity and not worse in the other.
    faster = time_s < (1 - EQUALITY_TOLERANCE) * competitor_s
    not_slower = time_s <= (1 + EQUALITY_TOLERANCE) * competitor_s
    not_worse = error_m.mean() <= (1 + EQUALITY_TOLERANCE) * competitor_m.mean()
    return bool((faster and not_worse) or (not_slower and _is_significantly_less(error_m, competitor_m)))


def _error_norms_m(trials: Sequence[_Trial]) -> FloatArray:
    """Return the norm of the errors over all wanted frequencies (seed,), m."""
    return np.array([np.linalg.norm(trial.error_m) for trial in trials])


def _is_significantly_less(error_m: FloatArray, competitor_m: FloatArray) -> bool:
    """Return whether the mean of ``error_m`` (seed,) is below that of ``competitor_m`` by more than chance allows.

    NaN stands for a seed without an estimate, which counts as the larger error.
    """
    if np.isnan(error_m).any() or np.isnan(competitor_m).any():
        return bool(np.isnan(competitor_m).any() and not np.isnan(error_m).any())
    # Both share scatterers and noise at each seed, so the difference per seed is tested.
    gain_m = competitor_m - error_m
    chance_m = SIGNIFICANT_STANDARD_ERRORS * gain_m.std(ddof=1) / math.sqrt(gain_m.size)
    return bool(gain_m.mean() > max(chance_m, EQUALITY_TOLERANCE * competitor_m.mean()))


def _row(variant: Variant, trials: Sequence[_Trial]) -> SceneRow:
    error_m, scale_m = np.array([t.error_m for t in trials]), np.linalg.norm(trials[0].true_m)
    bias_m, sd_m = np.linalg.norm(error_m.mean(axis=0)), np.linalg.norm(error_m.std(axis=0, ddof=1))
    return SceneRow(
        varied=variant.varied,
        setting=variant.setting,
        bias=float(bias_m / scale_m),
        sd=float(sd_m / scale_m),
        error=float(np.sqrt(np.mean(np.sum(error_m**2, axis=1))) / scale_m),
        time_s=min(t.time_s for t in trials),
        estimation_s=min(t.estimation_s for t in trials),
        seeds=len(trials),
        own=variant.varied == UNCHANGED,
    )


def scene_text(rows: Sequence[SceneRow]) -> str:
    """Return the table, and the variants that beat the scene's settings with the benefit of those settings."""
    cells = (
        (
            *(row.varied, row.setting),
            *("no estimate" if math.isnan(x) else f"{100 * x:.3g}" for x in (row.bias, row.sd, row.error)),
            *(f"{row.time_s:.3f}", f"{row.estimation_s:.3f}"),
            ", ".join(["this scene"] * row.own + ["Pareto front"] * row.on_front),
        )
        for row in rows
    )
    headers = ("varied", "setting", "bias %", "sd %", "rms error %", "time s", "estimation s", "")
    return "\n".join([text_table(headers, cells, words=2), "", *_conclusions(rows)])


def _conclusions(rows: Sequence[SceneRow]) -> Iterator[str]:
    unchanged = next(row for row in rows if row.own)
    # The relative standard error of a root mean square of n Gaussian errors is 1 / sqrt(2 n).
    yield (
        f"{unchanged.seeds} seeds: the relative standard error of an rms error is "
        f"{100 / math.sqrt(2 * unchanged.seeds):.2g} %, that of a difference is smaller; times are processor times"
    )
    if unchanged.on_front:
        yield (
            "the scene's settings lie on the Pareto front: no variant is better in time or error without being worse "
            "in the other"
        )
    for row in rows:
        if row.beats_own:
            instead = "no estimate" if math.isnan(unchanged.error) else f"{100 * unchanged.error:.3g} %"
            errors = f"rms error {100 * row.error:.3g} instead of {instead}"
            times = f"{row.time_s:.3g} instead of {unchanged.time_s:.3g} s"
            is_faster = row.time_s < (1 - EQUALITY_TOLERANCE) * unchanged.time_s
            gains = [errors] * row.is_more_exact + [times] * is_faster
            equal = "" if row.is_more_exact else ", its error is as good within that of the seeds"
            yield (
                f"{row.varied} {row.setting} beats the scene's settings: {', '.join(gains)}{equal}; the benefit of the "
                f"scene's setting: {BENEFITS[row.varied]}"
            )


def draw_scene(rows: Sequence[SceneRow], path: Path) -> None:
    """Draw error against run time: one panel for each setting varied, with the unchanged scene in each."""
    unchanged = next(row for row in rows if row.own)
    drawable = (row for row in rows if row.error > 0 and not row.own)
    panels = {
        varied: {row.setting: [(row.time_s, row.error)] for row in (unchanged, *group)}
        for varied, group in grouped(drawable, lambda row: row.varied).items()
    }
    draw_panels(panels, path, "processor time (s)", "rms error / true amplitude")


def _timed_again(run: Callable[[], Value]) -> tuple[Value, float]:
    """Call ``run`` twice; return the second value and its processor time, s."""
    run()
    return timed(run, time.process_time)


def _alternative_fits(scene: Scene) -> list[str]:
    """Return the harmonic fits that the scene could use instead of its present one."""
    default, impossible = "medium_prior", set()
    if scene.without_prior is not None:
        default, impossible = "least_squares", {"medium_prior"}
    excluded = {scene.processing.harmonic or default, *impossible}
    names, _ = get_args(Processing.model_fields["harmonic"].annotation)
    return [name for name in get_args(names) if name not in excluded]
