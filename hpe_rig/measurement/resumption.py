"""Resumption of a stopped run: its complete shots are copied to a new file, the others are measured."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from hpe_rig.bench import GENERATOR_ROLES, BenchFile
from hpe_rig.measurement.between_shots import Mover
from hpe_rig.measurement.run import record_run
from hpe_rig.measurement.sequencer import Observer, ignore_progress
from hpe_rig.measurement.setup import Setup, prepare_text, setup_of_run, source_text
from hpe_rig.result import Stages
from hpe_rig.scene import SceneSource
from hpe_rig.store import (
    Predecessor,
    StoredRun,
    StoreError,
    WriteOptions,
    free_path,
    identity_of,
    is_locked,
    read_run,
    sha256_of_scan,
    write_marks,
)


@dataclass(frozen=True, slots=True)
class Resumption:
    """A stopped run and the setup that continues it after its first ``complete`` shots."""

    setup: Setup
    earlier: StoredRun
    complete: int


def prepare_resumption(
    path: Path, scene: SceneSource | None = None, bench_path: Path | None = None, stages: Stages | None = None
) -> Resumption:
    """Return the resumption of the run in ``path``; ``scene`` must equal the run's scene, None uses that.

    The bench is the caller's, never the file's: a run file must not decide which instruments are addressed, nor their
    limits. A shot with wrong checksums is measured again, with all shots after it. Raises ``StoreError`` if the run is
    still being written, its scene or bench differ, or all shots are complete; else raises as ``prepare``.
    """
    earlier = read_run(path)
    earlier_setup = setup_of_run(earlier)
    recording = earlier_setup.bench.bench.recording
    if recording is not None:
        raise StoreError(
            f"{path} was imported from {recording.source}: no instrument can continue it. "
            f"Try: hpe-rig import {recording.source} again."
        )
    if is_locked(path):
        raise StoreError(f"{path} is being written by a run. Try: wait for its end, or stop it.")
    if scene is None:
        setup = prepare_text(earlier.scene_name, earlier.scene_toml, bench_path, stages, stored=path)
    else:
        setup = prepare_text(*source_text(scene), bench_path, stages)
    _refuse_differences(earlier, earlier_setup, setup)
    complete = _count_sound_shots(earlier)
    if complete == len(setup.plan.shots):
        raise StoreError(f"{path} has all of its {complete} shots. Try: hpe-rig process {path}.")
    return Resumption(setup, earlier, complete)


def resume(
    resumption: Resumption,
    path: Path | None = None,
    observer: Observer = ignore_progress,
    stages: Stages | None = None,
    options: WriteOptions | None = None,
    *,
    move: Mover | None = None,
) -> Path:
    """Copy the complete shots into a new run file, measure the others, and return its path; see ``record_run``."""
    earlier = resumption.earlier
    path = path or free_path(earlier.path.stem, earlier.path.parent)
    predecessor = Predecessor(earlier.path.name, resumption.complete)
    options = replace(options or WriteOptions(), predecessor=predecessor)
    _copy_marks(resumption, path, options)
    return record_run(resumption.setup, path, observer, stages, options, earlier=earlier, move=move)


def _copy_marks(resumption: Resumption, path: Path, options: WriteOptions) -> None:
    """Write the marks of the shots to be copied for the new run file, so that none of them counts as good there."""
    marks = {shot: why for shot, why in resumption.earlier.marks.items() if shot < resumption.complete}
    if marks:
        started = "" if options.provenance is None else options.provenance.started
        write_marks(path, identity_of(options.run_id, started), marks)


def _count_sound_shots(stored: StoredRun) -> int:
    """Return how many shots, from the first on, are complete and match their checksums."""
    shots = range(stored.shot_complete.size)
    return next((shot for shot in shots if not stored.shot_complete[shot] or not stored.is_intact(shot)), len(shots))


def _refuse_differences(earlier: StoredRun, earlier_setup: Setup, setup: Setup) -> None:
    """Raise ``StoreError`` if scene, bench or scan differ; comments, the order of keys and serial numbers do not."""
    if earlier_setup.scene.scene != setup.scene.scene:
        raise StoreError(
            f"{earlier.path} was measured with another scene than {setup.scene.name} is now. "
            "Try: resume without a scene, which uses the scene of the run, or measure anew."
        )
    if _without_serials(earlier_setup.bench.bench) != _without_serials(setup.bench.bench):
        raise StoreError(
            f"{earlier.path} was measured on bench {earlier.bench_name}, which differs from bench {setup.bench.name}. "
            "Try: --bench with the bench file of that run, or measure anew."
        )
    if earlier.scan_sha256 not in ("", sha256_of_scan(setup.scene.scene)):
        raise StoreError(
            f"{earlier.path} was measured with another content of the file beams.excitation_scan, and one run "
            "has one scan. Try: put that file back, or measure anew."
        )


def _without_serials(bench: BenchFile) -> dict[str, Any]:
    """Return the settings of ``bench`` without serial numbers, which change no measurement."""
    serials: Any = {role: {"serial"} for role in GENERATOR_ROLES}
    return bench.model_dump(exclude={"digitizer": {"serial"}, "generators": serials})
