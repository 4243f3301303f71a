"""Error against run time on one's own scene: estimators, harmonic fits, gates, echo tolerances and fields.

One thing is varied at a time; all else, field, chain and jitter among it, is as the scene has it. Every seed draws new
scatterers and new noise, the same for all ways, so that their differences are better known than each. Ways that differ
in the estimation alone share the records: they are measured once a seed, through the same functions as
``hpe-rig run``. Everything is done twice, and the second time is timed: what is imported, compiled or kept for later is
so by then, for all ways alike.
"""

from __future__ import annotations

import math
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, get_args

import numpy as np

from hpe_rig.arrays import FloatArray
from hpe_rig.bench import twin_of
from hpe_rig.measurement import planned, prepare
from hpe_rig.processing import ESTIMATORS
from hpe_rig.result import Result, text_table
from hpe_rig.runs import Run, measure
from hpe_rig.scene import Mistake, Processing, Scene, SettingsError
from hpe_rig.store import StoreError
from hpe_rig.study import one_shot
from hpe_rig.validation.accuracy.work_precision import draw_panels, file_mistakes, grouped, write_rows

SEEDS, QUICK_SEEDS = 20, 8
QUICK_S = 50.0
"""Processor time after which no further seed is begun, at the pace of those before, where it has to be quick."""
TOLERANCES = (1e-3, 1e-5, 1e-10)
GATES = (0.5, 1.5, 2.0)
"""Gate lengths over the scene's own."""
OWN = "own settings"
ALIKE = 0.05
"""Times and errors that differ by less than this share are taken for the same."""
SURE = 3.0
"""Standard errors, over the seeds, by which one way must be better than another."""
BUYS: Mapping[str, str] = {
    "estimator": "least noise at any SNR, and motion of many wavelengths is followed",
    "harmonic": "a fit that stays true for media, noise and gaps other than this scene's",
    "gate": "resolution in depth: a longer gate averages over more of the medium",
    "echo tolerance": "echoes good to a thousandth of a code of the digitizer, whatever is compared on them",
    "field": "the medium's own field in the twin, which the Gaussian of eq. (12) replaces by an assumption",
}
"""What the scene's own choice is good for besides error and run time, by what is varied."""


@dataclass(frozen=True, slots=True)
class Way:
    """One change of the scene; ``acquired``: of what is simulated, so that it needs records of its own."""

    varied: str
    setting: str
    values: Mapping[str, Any]
    acquired: bool = False


@dataclass(frozen=True, slots=True)
class SceneRow:
    """One way: errors of the amplitudes of all wanted frequencies together, relative to the true ones.

    Of the amplitude corrected for the beams' averaging, where it is predicted. NaN where the way gives no estimate.
    """

    varied: str
    setting: str
    bias: float
    """Length of the mean error over the seeds; known to ``sd`` over the root of their number."""
    sd: float
    """Standard deviation over the seeds."""
    error: float
    """Root mean square: bias and standard deviation together."""
    time_s: float
    """Processor time from scene to result, the least over the seeds: the work is the same, what comes on top is not."""
    estimation_s: float
    """Of it, from records to result."""
    seeds: int
    own: bool
    """Whether this is the scene as it is."""
    on_front: bool = False
    """Whether no other way beats it: by more than chance better in time or error, and worse in neither."""
    beats_own: bool = False
    """Whether it beats the scene as it is."""


def write_own_scene(
    source: str, bench: Path | None, seeds: int | None, quick: bool, output: Path | None, figure: Path | None,
    show: Callable[[str], None], tell: Callable[[str], None],
) -> None:  # fmt: skip
    """Measure every way on the scene ``source`` and write or show the table; ``tell`` gets the progress.

    Raises ``SettingsError`` for a scene with mistakes, for names of files that cannot be and a bench that is none of
    the simulated ones, all before anything is measured.
    """
    if mistakes := file_mistakes(output, figure):
        raise SettingsError("command line", mistakes)
    setup = prepare(source, bench)
    if not setup.bench.bench.simulated:
        what = "errors are known where the truth is: on a simulated bench"
        raise SettingsError("command line", [Mistake("--bench", what, "none, or another")])
    scene = one_shot(setup.scene.scene)
    most = seeds or (QUICK_SEEDS if quick else SEEDS)
    rows = scene_rows(scene, bench, ways(scene), most, QUICK_S if quick else math.inf, tell)
    write_rows(rows, output, figure, draw_scene, show, scene_text)


def ways(scene: Scene) -> list[Way]:
    """Return what is varied on ``scene``, itself first; without what the scene cannot have."""
    twin, processing, gate_m = twin_of(scene), scene.processing, scene.acquisition.gate_length_m
    found = [Way(OWN, processing.estimator, {})]
    found += [Way("estimator", n, {"processing.estimator": n}) for n in ESTIMATORS if n != processing.estimator]
    found += [Way("harmonic", name, {"processing.harmonic": name}) for name in _other_fits(scene)]
    found += [
        Way("gate", f"{gate_m * share * 1e3:g} mm", {"acquisition.gate_length_m": gate_m * share}) for share in GATES
    ]
    found += [
        Way("echo tolerance", f"{value:g}", {"simulation.scatterers.echo_tolerance": value}, True)
        for value in TOLERANCES
    ]
    if twin is not None and twin.settings.specimen is not None:
        other = "gaussian" if twin.settings.specimen.field == "medium" else "medium"
        found.append(Way("field", other, {"simulation.specimen.field": other}, True))
    return [way for way in found if _possible(scene, way)]


def _possible(scene: Scene, way: Way) -> bool:
    try:
        scene.with_(way.values)
    except SettingsError:
        return False
    return True


def scene_rows(
    scene: Scene,
    bench: Path | None,
    chosen: Sequence[Way],
    seeds: int,
    longest_s: float = math.inf,
    tell: Callable[[str], None] = lambda _: None,
) -> list[SceneRow]:
    """Return a row for every way over at most ``seeds`` seeds, at least two; fewer where ``longest_s`` would pass."""
    found: list[list[_Trial]] = []
    start_s = time.process_time()
    for seed in range(1, seeds + 1):
        pace_s = (time.process_time() - start_s) / max(len(found), 1)
        if len(found) >= 2 and time.process_time() - start_s + pace_s > longest_s:
            tell(f"no time for more than {len(found)} of {seeds} seeds")
            break
        found.append(list(_of_seed(scene, bench, chosen, seed, f"seed {seed} of {seeds}", tell)))
    trials = [[each[k] for each in found] for k in range(len(chosen))]
    own = next((trials[k] for k, way in enumerate(chosen) if way.varied == OWN), trials[0])
    return [
        replace(_row(way, mine), on_front=not any(_beats(other, mine) for other in trials), beats_own=_beats(mine, own))
        for way, mine in zip(chosen, trials, strict=True)
    ]


@dataclass(frozen=True, slots=True)
class _Trial:
    """One way at one seed: errors and true amplitudes (frequency,), m, and processor times."""

    error_m: FloatArray
    true_m: FloatArray
    time_s: float
    estimation_s: float


def _of_seed(
    scene: Scene, bench: Path | None, chosen: Sequence[Way], seed: int, name: str, tell: Callable[[str], None]
) -> Iterator[_Trial]:
    seeded = scene.with_({"simulation.seed": seed})
    with tempfile.TemporaryDirectory() as folder:
        shared, shared_s = _measured(seeded, bench, Path(folder), "shared")
        for number, way in enumerate(chosen):
            tell(f"{name}: {way.varied} {way.setting}")
            run, run_s = shared, shared_s
            if way.acquired:
                run, run_s = _measured(seeded.with_(way.values), bench, Path(folder), str(number))
            elif way.values:
                run = _changed(shared, seeded.with_(way.values))
            yield _trial(run, run_s)


def _measured(scene: Scene, bench: Path | None, folder: Path, name: str) -> tuple[Run, float]:
    """Return the run of ``scene`` in a new file, and the processor time of the second of two."""
    paths = iter([folder / f"{name}-first.h5", folder / f"{name}.h5"])
    run, run_s = _timed(lambda: measure(scene, bench, next(paths)))
    return run, run_s


def _changed(run: Run, scene: Scene) -> Run:
    """Return the run as if ``scene`` had asked for it: the same records, estimated in another way."""
    plan, findings = planned(scene, run.bench)
    return replace(run, scene=scene, plan=plan, findings=findings)


def _trial(run: Run, run_s: float) -> _Trial:
    try:
        result, estimation_s = _timed(run.estimate)
    except StoreError:
        nothing = np.full(len(run.scene.wanted_frequencies_hz), np.nan)
        return _Trial(nothing, nothing, run_s, math.nan)
    found_m, true_m = _amplitudes_m(result)
    return _Trial(found_m - true_m, true_m, run_s + estimation_s, estimation_s)


def _amplitudes_m(result: Result) -> tuple[FloatArray, FloatArray]:
    """Return found, corrected where that is predicted, and true amplitudes (frequency,)."""
    each = result.shots[0].estimates
    found = [e.amplitude_m if e.corrected_amplitude_m is None else e.corrected_amplitude_m for e in each]
    return np.array(found), np.array([e.true_amplitude_m or 0.0 for e in each])


def _beats(one: Sequence[_Trial], other: Sequence[_Trial]) -> bool:
    """Return whether ``one`` is better than ``other`` in time or error by more than chance, and worse in neither.

    An error is that of all wanted frequencies together, its length at each seed; a time is the least of the seeds.
    """
    time_s, other_s = (min(trial.time_s for trial in trials) for trials in (one, other))
    error_m = [np.array([np.linalg.norm(trial.error_m) for trial in trials]) for trials in (one, other)]
    if np.isnan(error_m).any():
        return bool(np.isnan(error_m[1]).any() and not np.isnan(error_m[0]).any())
    faster, no_slower = time_s < (1 - ALIKE) * other_s, time_s <= (1 + ALIKE) * other_s
    no_worse = error_m[0].mean() <= (1 + ALIKE) * error_m[1].mean()
    return bool((faster and no_worse) or (no_slower and _less(*error_m)))


def _less(one: FloatArray, other: FloatArray) -> bool:
    """Return whether ``one`` (seed,) is less than ``other`` by more than chance and by more than counts."""
    gain = other - one
    chance = SURE * gain.std(ddof=1) / math.sqrt(gain.size)
    return bool(gain.mean() > max(chance, ALIKE * other.mean()))


def _row(way: Way, trials: Sequence[_Trial]) -> SceneRow:
    error_m, scale_m = np.array([t.error_m for t in trials]), np.linalg.norm(trials[0].true_m)
    bias, sd = np.linalg.norm(error_m.mean(axis=0)), np.linalg.norm(error_m.std(axis=0, ddof=1))
    return SceneRow(
        varied=way.varied,
        setting=way.setting,
        bias=float(bias / scale_m),
        sd=float(sd / scale_m),
        error=float(np.sqrt(np.mean(np.sum(error_m**2, axis=1))) / scale_m),
        time_s=min(t.time_s for t in trials),
        estimation_s=min(t.estimation_s for t in trials),
        seeds=len(trials),
        own=way.varied == OWN,
    )


def scene_text(rows: Sequence[SceneRow]) -> str:
    """Return the table, and what the scene's own settings buy where they are not on the front."""
    cells = (
        (row.varied, row.setting, *_percents(row), f"{row.time_s:.3f}", f"{row.estimation_s:.3f}", _mark(row))
        for row in rows
    )
    headers = ("varied", "setting", "bias %", "sd %", "rms error %", "time s", "estimation s", "")
    return "\n".join([text_table(headers, cells, words=2), "", *_verdict(rows)])


def _percents(row: SceneRow) -> tuple[str, ...]:
    return tuple("gave up" if math.isnan(each) else f"{100 * each:.3g}" for each in (row.bias, row.sd, row.error))


def _mark(row: SceneRow) -> str:
    return ", ".join(word for word, true in (("own", row.own), ("front", row.on_front)) if true)


def _verdict(rows: Sequence[SceneRow]) -> Iterator[str]:
    own = next(row for row in rows if row.own)
    # Of n seeds and Gaussian errors a root mean square is known to one part in sqrt(2 n).
    yield (
        f"{own.seeds} seeds; rms errors are known to {100 / math.sqrt(2 * own.seeds):.2g} % of themselves, their "
        "differences better; times are of the processor"
    )
    if own.on_front:
        yield "the scene's own settings lie on the Pareto front: nothing tried is better in one and worse in neither"
    for row in (each for each in rows if each.beats_own):
        yield (
            f"{row.varied} {row.setting} beats the scene's own settings: rms error {100 * row.error:.3g} instead of "
            f"{100 * own.error:.3g} %, {row.time_s:.3g} instead of {own.time_s:.3g} s; what they buy: "
            f"{BUYS[row.varied]}"
        )


def draw_scene(rows: Sequence[SceneRow], path: Path) -> None:
    """Draw error against run time, a panel a thing varied, the scene's own settings in each."""
    own, known = next(row for row in rows if row.own), [row for row in rows if row.error > 0]
    panels = {
        varied: {row.setting: [(row.time_s, row.error)] for row in (own, *some)}
        for varied, some in grouped((row for row in known if not row.own), lambda row: row.varied).items()
    }
    draw_panels(panels, path, "processor time (s)", "rms error / true amplitude")


def _timed(run: Callable[[], Any]) -> tuple[Any, float]:
    run()
    start_s = time.process_time()
    found = run()
    return found, time.process_time() - start_s


def _other_fits(scene: Scene) -> list[str]:
    """Return the fits of the harmonics that the scene could have and has not."""
    default, impossible = "medium_prior", set()
    if scene.without_prior is not None:
        default, impossible = "least_squares", {"medium_prior"}
    own = scene.processing.harmonic or default
    return [n for n in _choices(Processing.model_fields["harmonic"].annotation) if n not in {own, *impossible}]


def _choices(annotation: Any) -> list[str]:
    """Return the words that an annotation of literals, optional or not, takes."""
    if isinstance(annotation, str):
        return [annotation]
    return [word for part in get_args(annotation) for word in _choices(part)]
