"""Resumption of a stopped run: a new file takes over its complete shots and measures the others."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from hpe_rig.measurement.mover import Mover
from hpe_rig.measurement.run import record_run
from hpe_rig.measurement.sequencer import Observer, unobserved
from hpe_rig.measurement.setup import Setup, prepare_text, source_text
from hpe_rig.result import Stages
from hpe_rig.runs import Run, open_run
from hpe_rig.scene import SceneSource
from hpe_rig.store import Predecessor, StoredRun, StoreError, WriteOptions, free_path, is_taken, sha256_of_scan


@dataclass(frozen=True, slots=True)
class Rest:
    """What is left of a run: the measurement, the run that stopped, and how many of its shots are complete."""

    setup: Setup
    earlier: Run
    complete: int


def prepare_rest(
    path: Path, scene: SceneSource | None = None, bench_path: Path | None = None, stages: Stages | None = None
) -> Rest:
    """Return what is left of the run in ``path``; ``scene``: one to compare with, None: the run's own.

    The bench is the caller's, never the file's: a run file decides neither which instruments are addressed nor their
    limits. A shot that fails its checksums is measured again, and all behind it. Raises ``StoreError`` where the run
    goes on, where scene or bench differ from the run's or nothing is left, else as ``prepare``.
    """
    earlier = open_run(path)
    if earlier.bench.recording is not None:
        source = earlier.bench.recording.source
        raise StoreError(
            f"{path} was imported from {source}: no instrument can go on with it. Try: hpe-rig import {source} anew."
        )
    if is_taken(path):
        raise StoreError(f"{path} is being written by a run that goes on. Try: wait for its end, or stop it.")
    if scene is None:
        setup = prepare_text(earlier.stored.scene_name, earlier.stored.scene_toml, bench_path, stages, stored=path)
    else:
        setup = prepare_text(*source_text(scene), bench_path, stages)
    _refuse_other(earlier, setup)
    complete = _sound_shots(earlier.stored)
    if complete == len(setup.plan.shots):
        raise StoreError(f"{path} has all of its {complete} shots. Try: hpe-rig process {path}.")
    return Rest(setup, earlier, complete)


def resume(
    rest: Rest,
    path: Path | None = None,
    observer: Observer = unobserved,
    stages: Stages | None = None,
    options: WriteOptions | None = None,
    move: Mover | None = None,
) -> Path:
    """Copy the complete shots into a new run file, measure the others, and return its path; as ``record_run``."""
    old = rest.earlier.path
    path = path or free_path(old.stem, old.parent)
    going_on = replace(options or WriteOptions(), predecessor=Predecessor(old.name, rest.complete))
    return record_run(rest.setup, path, observer, stages, going_on, rest.earlier.stored, move)


def _sound_shots(stored: StoredRun) -> int:
    """Return how many shots from the first on are complete and as their checksums say: no other is taken over."""
    shots = range(stored.shot_complete.size)
    return next((shot for shot in shots if not stored.shot_complete[shot] or not stored.is_sound(shot)), len(shots))


def _refuse_other(earlier: Run, setup: Setup) -> None:
    """Raise ``StoreError`` where scene, bench or scan are not those of the run, comments and order apart."""
    if earlier.scene != setup.scene.scene:
        raise StoreError(
            f"{earlier.path} was measured with another scene than {setup.scene.name} is now. "
            "Try: resume without a scene, which takes the run's own, or measure anew."
        )
    if earlier.bench != setup.bench.bench:
        raise StoreError(
            f"{earlier.path} was measured on bench {earlier.stored.bench_name}, which is not what bench "
            f"{setup.bench.name} says now. Try: --bench with the bench file of that run, or measure anew."
        )
    if earlier.stored.scan_sha256 not in ("", sha256_of_scan(setup.scene.scene)):
        raise StoreError(
            f"{earlier.path} was measured when beams.excitation_scan named another file than it is now, and one run "
            "has one scan. Try: put that file back, or measure anew."
        )
