"""Import: a recording of any other program becomes a run file, processed and reported like a measured one.

The scene says what is measured; the recording says how it was recorded, and its rates, counts and ranges take the place
of the scene's. The bench file in the run file stands for a bench that nobody here knows: it holds the recording's name
and hash, and every value that was taken from the file or the scene without being stated. Nothing is resumed.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from drivers.interfaces import RecordBlock
from hpe_rig.arrays import Int16Array
from hpe_rig.bench import BenchText, parse_bench
from hpe_rig.measurement import planned
from hpe_rig.plan import Plan, refuse_conflicts
from hpe_rig.recordings import Known, Recording, read_recording, read_settings
from hpe_rig.runs.run import Run, open_run
from hpe_rig.scene import (
    KeyPath,
    Mistake,
    SceneSource,
    SceneText,
    SettingsError,
    edited_text,
    parse_scene,
    parse_toml,
    path_of,
    scene_text,
)
from hpe_rig.store import RunWriter, WriteOptions, free_path

HIGHEST_CODE = 32766
"""Code of the largest value: one below full scale, which would count as clipped."""
FEWEST_CODES = 30.0
"""Root mean square of the gate in codes below which their steps add noticeably to the noise."""
LEAST_RANGE_V, MOST_RANGE_V = 1e-6, 1e4
SAID_BY_SCENE: Mapping[str, str] = {
    "sample_rate_hz": "acquisition.sample_rate_hz",
    "pulse_rate_hz": "tracking.pulse_rate_hz",
    "carrier_hz": "tracking.carrier_hz",
    "sound_speed_m_per_s": "acquisition.sound_speed_m_per_s",
    "first_pulse_s": "tracking.delay_s",
}
"""Where a scene states what a recording needs."""


@dataclass(frozen=True, slots=True)
class Imported:
    """A run file that was imported, and in words every value that was not stated, with where it was taken from."""

    path: Path
    inferred: tuple[str, ...]


def import_records(
    recording: str | os.PathLike[str] | ArrayLike,
    scene: SceneSource,
    path: str | os.PathLike[str] | None = None,
    *,
    sidecar: str | os.PathLike[str] | None = None,
    **settings: Any,
) -> Run:
    """Return ``recording``, a file or an array of anybody's echoes, as a run; its file is written to ``path``.

    ``settings`` are those of a sidecar file (docs/how-to/import.md), such as ``axes="line,pulse,sample"`` and
    ``lines="12"``; they count before the sidecar's, these before what the file says, this before the scene.
    ``run.bench.recording`` says what was inferred, with the file's SHA-256. Raises ``SettingsError`` with every mistake
    of recording, sidecar or scene, ``PlanError`` where the records do not hold the scene's gate or frequencies, and
    ``StoreError`` where the run file cannot be written.

    >>> run = import_records("rf.npy", "my-scene.toml", axes="pulse,sample", sample_rate_hz=50e6, pulse_rate_hz=4e3)
    >>> print(run.estimate())
    """
    source = Path(recording) if isinstance(recording, str | os.PathLike) else np.asarray(recording)
    where = None if path is None else Path(path)
    beside = None if sidecar is None else Path(sidecar)
    return open_run(import_recording(source, scene, where, beside, settings).path)


def import_recording(
    source: Path | NDArray[Any],
    scene: SceneSource,
    path: Path | None = None,
    sidecar: Path | None = None,
    options: Mapping[str, Any] | None = None,
    write: WriteOptions | None = None,
) -> Imported:
    """Write the run file of ``source`` and return its path with what was inferred; raises as ``import_records``."""
    name, text = scene_text(scene)
    tables = parse_toml(text, f"scene {name}")
    settings, where = read_settings(source if isinstance(source, Path) else None, sidecar, options)
    recording = read_recording(source, settings, where, known_of_scene(name, text))
    codes, scale_v, said = _coded(recording)
    limits = parse_bench("imported", _bench_text(recording, ())).bench.digitizer.board_model.code_limits
    range_v = scale_v * (2 * limits[1] + 1) / 2
    replaced = dict(_replaced(tables, recording, range_v))
    changes = [f"{'.'.join(map(str, key))} = {new}, not {old} as in the scene" for key, (old, new) in replaced.items()]
    values = _values(tables, recording, range_v)
    _refuse_other_sweeps(tables, f"scene {name}")
    own = parse_scene(name, edited_text(text, values))
    inferred = (*recording.inferred, *said, *changes)
    bench = parse_bench("imported", _bench_text(recording, inferred))
    plan, findings = planned(own.scene, bench.bench)
    refuse_conflicts(findings)
    _refuse_other_shots(plan, codes, f"recording {recording.name}")
    inferred = (*inferred, *_few_codes(recording, codes, plan))
    bench = parse_bench("imported", _bench_text(recording, inferred))
    written = path or free_path(recording.name.partition(".")[0] or "recording", Path())
    _write(written, own, bench, _at_times(plan, recording), recording, codes, scale_v, write or WriteOptions())
    return Imported(written, inferred)


def known_of_scene(name: str, text: str) -> Known:
    """Return what the scene's ``text`` itself states, not what it would assume."""
    tables = parse_toml(text, f"scene {name}")
    tracking, acquisition = (tables.get(name, {}) for name in ("tracking", "acquisition"))
    if not isinstance(tracking, Mapping) or not isinstance(acquisition, Mapping):
        return Known()
    sections = {"tracking": tracking, "acquisition": acquisition}
    values = {}
    for key, place in SAID_BY_SCENE.items():
        section, _, last = place.partition(".")
        if isinstance(value := sections[section].get(last), int | float) and not isinstance(value, bool):
            values[key] = float(value)
    counts = (tracking.get("pulse_count"), acquisition.get("record_samples"))
    pulses, samples = (count if isinstance(count, int) else None for count in counts)
    return Known(pulses, samples, values)


def _values(tables: Mapping[str, Any], recording: Recording, range_v: float) -> dict[KeyPath, Any]:
    """Return what the recording says of its scene, by key."""
    lines, shots, pulses, samples = recording.values.shape
    values: dict[str, Any] = {
        "tracking.pulse_rate_hz": recording.pulse_rate_hz,
        "tracking.pulse_count": pulses,
        "tracking.carrier_hz": recording.carrier_hz,
        "tracking.delay_s": float(recording.pulse_time_s[0]),
        "acquisition.sample_rate_hz": recording.sample_rate_hz,
        "acquisition.record_samples": samples,
        "acquisition.input_range_v": range_v,
        "acquisition.repeats": max(1, shots // _settings_of(tables)),
    }
    if recording.sound_speed_m_per_s is not None:
        values["acquisition.sound_speed_m_per_s"] = recording.sound_speed_m_per_s
    if recording.line_position_m is not None and lines == 1:
        values["tracking.lateral_offset_m"] = float(recording.line_position_m[0])
    elif recording.line_position_m is not None:
        values["sweep.lateral_offset_m"] = recording.line_position_m.tolist()
    return {path_of(key): value for key, value in values.items()}


def _replaced(tables: Mapping[str, Any], recording: Recording, range_v: float) -> Any:
    """Yield the settings that the scene states otherwise than the recording: both values, by key."""
    for key, new in _values(tables, recording, range_v).items():
        section = tables.get(str(key[0]), {})
        old = section.get(key[1]) if isinstance(section, Mapping) else None
        if key[1] != "input_range_v" and isinstance(old, int | float) and not math.isclose(old, new, rel_tol=1e-9):
            yield key, (old, new)


def _settings_of(tables: Mapping[str, Any]) -> int:
    """Return how many forces times burst lengths the scene lists: that many shots are no repeats."""
    excitation = tables.get("excitation", {})
    lists = (
        [excitation.get(key) for key in ("burst_length_s", "force_fraction")] if isinstance(excitation, dict) else []
    )
    return math.prod(len(each) for each in lists if isinstance(each, list) and each)


def _refuse_other_sweeps(tables: Mapping[str, Any], source: str) -> None:
    swept = tables.get("sweep", {})
    if not isinstance(swept, Mapping):
        return
    others = [key for key in swept if key not in ("window_length_s", "lateral_offset_m")]
    what = "a recording has one value of it"
    remedy = "a scene without it, one recording a value; hpe-rig process RUN.h5 --sweep varies what is made of records"
    mistakes = [Mistake(f"sweep.{key}", what, remedy) for key in others]
    if mistakes:
        raise SettingsError(source, mistakes)


def _refuse_other_shots(plan: Plan, codes: Int16Array, source: str) -> None:
    found = codes.shape[0] * codes.shape[1]
    if len(plan.shots) != found:
        what = (
            f"the scene asks for {len(plan.shots)} shots, the recording has {codes.shape[0]} lines of {codes.shape[1]}"
        )
        remedy = "as many forces and burst lengths as the recording's axis shot holds, times repeats"
        raise SettingsError(source, [Mistake("axes", what, remedy)])


def _coded(recording: Recording) -> tuple[Int16Array, float, tuple[str, ...]]:
    """Return the samples as int16 codes, volts a code, and what was assumed about these."""
    values, scale_v = recording.values, recording.scale_v
    if values.dtype.kind in "iu" and values.dtype.itemsize <= 2:
        zero = 0 if values.dtype.kind == "i" else 1 << (8 * values.dtype.itemsize - 1)
        centred = values.astype(np.int32) - zero
        codes = np.maximum(centred, -HIGHEST_CODE - 1).astype(np.int16)
        lost = int((centred < -HIGHEST_CODE - 1).sum())
        said = [f"{lost} samples of the lowest code count as its neighbour"] if lost else []
        if zero:
            said.append(f"whole numbers without sign: {zero} is zero volts")
        if scale_v is None:
            scale_v = 2.0 / (2 * (HIGHEST_CODE + 1) + 1)
            said.append("volts are not stated: the codes of 16 bits span plus and minus 1 V")
        return codes, scale_v, tuple(said)
    largest = float(np.abs(values).max())
    unit_v = 1.0 if scale_v is None else scale_v
    range_v = largest * unit_v * (2 * HIGHEST_CODE + 3) / (2 * HIGHEST_CODE)
    said = []
    if not LEAST_RANGE_V <= range_v <= MOST_RANGE_V:
        said.append(f"values up to {largest:.3g} are taken as shares of 1 V: they are no volts at any input")
        range_v = (2 * HIGHEST_CODE + 3) / (2 * HIGHEST_CODE)
    elif scale_v is None:
        said.append("volts are not stated: a value of 1 counts as 1 V")
    codes = np.rint(values * (HIGHEST_CODE / largest)).astype(np.int16)
    return codes, 2 * range_v / (2 * HIGHEST_CODE + 3), tuple(said)


def _few_codes(recording: Recording, codes: Int16Array, plan: Plan) -> tuple[str, ...]:
    """Return that the gate's echoes take few codes of 16 bits, where they do: their steps are noise."""
    gate = codes[..., plan.shots[0].gate].astype(np.float32)
    rms = float(np.sqrt(np.mean((gate - gate.mean()) ** 2)))
    if recording.values.dtype.kind != "f" or rms >= FEWEST_CODES:
        return ()
    return (
        f"WARNING the gate's echoes take {rms:.2g} codes of 16 bits, root mean square, since the largest value of the "
        "record lies elsewhere: samples = [first, end] around the gate keeps more of them",
    )


def _bench_text(recording: Recording, inferred: tuple[str, ...]) -> str:
    shipped = resources.files("hpe_rig.bench") / "shipped" / "imported.toml"
    text = shipped.read_text(encoding="utf-8")
    if recording.board is not None:
        text = text.replace('model = "ATS9462"', f"model = {json.dumps(recording.board)}")
    stated = {
        "source": recording.name[:1000],
        "sha256": recording.sha256,
        "format": recording.format,
        "first_sample_s": recording.first_sample_s,
        "inferred": list(inferred),
    }
    # JSON's texts, numbers and lists are TOML's.
    return text + "".join(f"{key} = {json.dumps(value)}\n" for key, value in stated.items())


def _at_times(plan: Plan, recording: Recording) -> Plan:
    """Return ``plan`` with the pulses at the times that the recording states."""
    if recording.regular:
        return plan
    shots = (
        replace(shot, timeline=replace(shot.timeline, pulse_onset_s=recording.pulse_time_s)) for shot in plan.shots
    )
    return replace(plan, shots=tuple(shots))


def _write(
    path: Path,
    scene: SceneText,
    bench: BenchText,
    plan: Plan,
    recording: Recording,
    codes: Int16Array,
    scale_v: float,
    options: WriteOptions,
) -> None:
    limits = bench.bench.digitizer.board_model.code_limits
    of_shots = codes.reshape(-1, *codes.shape[2:])
    recorded = recording.recorded.reshape(-1, codes.shape[2])
    with RunWriter(path, scene, bench, plan, options) as writer:
        for shot, values, there in zip(plan.shots, of_shots, recorded, strict=True):
            writer.settings(shot, {})
            # Without times a block counts on from its first record: one block a row of records that are there.
            for rows in np.split(np.arange(there.size), np.flatnonzero(np.diff(there.astype(np.int8))) + 1):
                if there[rows[0]]:
                    block = np.ascontiguousarray(values[rows])
                    times = np.full(rows.size, np.nan)
                    writer.append(shot, RecordBlock(int(rows[0]), block, times, scale_v, scale_v / 2, limits))
            writer.clipped(shot, bool((values <= limits[0]).any() or (values >= limits[1]).any()))
            writer.finish(shot)
