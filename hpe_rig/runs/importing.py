"""Import of a recording of another program: it becomes a run file, processed and reported like a measured one.

The scene states gate, frequencies and beams. The rates, counts and ranges of the recording replace those of the
scene. The bench file in the run file describes no real bench. It holds the name and hash of the recording and
every value that was inferred from the file or the scene. An imported run cannot be resumed.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from drivers.interfaces import RecordBlock
from hpe_rig.arrays import Int16Array
from hpe_rig.bench import parse_bench
from hpe_rig.measurement import plan_and_check
from hpe_rig.plan import Plan, refuse_conflicts
from hpe_rig.recordings import Recording, Source, as_source, read_recording, read_settings
from hpe_rig.runs.echoes import FULL_SCALE_CODES, MAX_CODE, UNSTATED_SCALE_V, are_codes, signed_codes, zero_code
from hpe_rig.runs.run import Run, open_run
from hpe_rig.scene import (
    KeyPath,
    Mistake,
    SceneSource,
    SettingsError,
    edited_text,
    parse_scene,
    parse_toml,
    path_of,
    scene_text,
)
from hpe_rig.store import RunWriter, WriteOptions, free_path

MIN_GATE_RMS_CODES = 30.0
"""RMS of the gate in codes below which quantisation adds noticeably to the noise."""
MIN_RANGE_V, MAX_RANGE_V = 1e-6, 1e4
ToCodes = Callable[[NDArray[Any]], Int16Array]
"""Function from values of a recording to codes of its run file."""
SCENE_KEYS: Mapping[str, str] = {
    "sample_rate_hz": "acquisition.sample_rate_hz",
    "pulse_rate_hz": "tracking.pulse_rate_hz",
    "carrier_hz": "tracking.carrier_hz",
    "sound_speed_m_per_s": "acquisition.sound_speed_m_per_s",
    "first_pulse_s": "tracking.delay_s",
}
"""Key of a scene for each setting of a recording."""


def import_records(
    recording: str | os.PathLike[str] | Sequence[str | os.PathLike[str]] | ArrayLike,
    scene: SceneSource,
    path: str | os.PathLike[str] | None = None,
    *,
    sidecar: str | os.PathLike[str] | None = None,
    **settings: Any,
) -> Run:
    """Return ``recording`` of another program as a run; its run file is written to ``path``.

    ``recording``: a file of echoes, a list of files with one pulse or frame each, or an array.

    ``settings`` are those of a sidecar file (docs/how-to/import.md), such as ``axes="line,pulse,sample"`` and
    ``lines="12"``. They take precedence over the sidecar, then the file, then the scene. ``run.bench.recording``
    lists the inferred values and the file's SHA-256. Raises ``SettingsError`` with every mistake of recording, sidecar
    or scene, ``PlanError`` if the records do not contain the scene's gate or frequencies, and ``StoreError`` if the run
    file cannot be written.

    >>> run = import_records("rf.npy", "my-scene.toml", axes="pulse,sample", sample_rate_hz=50e6, pulse_rate_hz=4e3)
    >>> print(run.estimate())
    """
    run_file = None if path is None else Path(path)
    sidecar_file = None if sidecar is None else Path(sidecar)
    return open_run(import_recording(as_source(recording), scene, run_file, sidecar_file, settings)[0])


def import_recording(
    source: Source,
    scene: SceneSource,
    path: Path | None = None,
    sidecar: Path | None = None,
    options: Mapping[str, Any] | None = None,
    write: WriteOptions | None = None,
) -> tuple[Path, tuple[str, ...]]:
    """Write the run file of ``source``; return its path and, in words, every value that was not stated.

    Raises as ``import_records``.
    """
    name, text = scene_text(scene)
    tables = parse_toml(text, f"scene {name}")
    settings, origins = read_settings(source if isinstance(source, Path) else None, sidecar, options)
    if settings.quantity is not None:
        what = f"{settings.quantity} is stated, and a run file holds echoes"
        remedy = "hpe-rig map, or hpe_rig.estimate_motion for single points"
        raise SettingsError("recording", [Mistake("quantity", what, remedy)])
    recording = read_recording(source, settings, origins, stated_by_scene(name, text))
    to_codes, scale_v, assumptions = _quantisation(recording)
    # Full scale is half a code above the highest code.
    code_limits = parse_bench("imported", _bench_text(recording, ())).bench.digitizer.board_model.code_limits
    values = _scene_values(tables, recording, scale_v * (2 * code_limits[1] + 1) / 2)
    _refuse_sweeps(tables, f"scene {name}")
    scene_as_recorded = parse_scene(name, edited_text(text, values))

    # The bench file holds the inferred values, but the warnings about quantisation need a plan, which needs a bench.
    # So the bench file is made twice.
    inferred = (*recording.inferred, *assumptions, *_replacements(tables, values), *_settings_in_turn(tables))
    bench = parse_bench("imported", _bench_text(recording, inferred))
    plan, findings = plan_and_check(scene_as_recorded.scene, bench.bench)
    refuse_conflicts(findings)
    _refuse_other_shot_count(plan, recording)
    inferred = (*inferred, *_quantisation_warnings(recording, to_codes, plan))
    bench = parse_bench("imported", _bench_text(recording, inferred))

    path = path or free_path(recording.name.partition(".")[0] or "recording", Path())
    plan = _with_recorded_times(plan, recording)
    with RunWriter(path, scene_as_recorded, bench, plan, write or WriteOptions()) as writer:
        _write_records(writer, plan, recording, to_codes, scale_v=scale_v, limits=code_limits)
    return path, inferred


def stated_by_scene(name: str, text: str) -> dict[str, float]:
    """Return the settings of a recording that the scene's ``text`` states, by key, without defaults."""
    tables = parse_toml(text, f"scene {name}")
    sections = {section: tables.get(section, {}) for section in ("tracking", "acquisition")}
    # A malformed scene is reported when it is parsed.
    if not all(isinstance(section, Mapping) for section in sections.values()):
        return {}
    values: dict[str, float] = {}
    for key, scene_key in SCENE_KEYS.items():
        section, _, last = scene_key.partition(".")
        if isinstance(value := sections[section].get(last), int | float) and not isinstance(value, bool):
            values[key] = float(value)
    for section, key in (("tracking", "pulse_count"), ("acquisition", "record_samples")):
        if isinstance(count := sections[section].get(key), int):
            values[key] = count
    return values


def _scene_values(tables: Mapping[str, Any], recording: Recording, range_v: float) -> dict[KeyPath, Any]:
    """Return the values of the recording that belong in its scene, by key."""
    lines, shots, pulses, samples = recording.values.shape
    values: dict[str, Any] = {
        "tracking.pulse_rate_hz": recording.pulse_rate_hz,
        "tracking.pulse_count": pulses,
        "tracking.carrier_hz": recording.carrier_hz,
        "tracking.delay_s": float(recording.pulse_time_s[0]),
        "acquisition.sample_rate_hz": recording.sample_rate_hz,
        "acquisition.record_samples": samples,
        "acquisition.input_range_v": range_v,
        # As many shots as there are forces times burst lengths are no repeats.
        "acquisition.repeats": max(1, shots // math.prod(map(len, _lists(tables).values()))),
    }
    # Values that the recording does not state are those of the scene.
    if recording.sound_speed_m_per_s is not None:
        values["acquisition.sound_speed_m_per_s"] = recording.sound_speed_m_per_s
    if recording.line_position_m is not None and lines == 1:
        values["tracking.lateral_offset_m"] = float(recording.line_position_m[0])
    elif recording.line_position_m is not None:
        values["sweep.lateral_offset_m"] = recording.line_position_m.tolist()
    return {path_of(key): value for key, value in values.items()}


def _replacements(tables: Mapping[str, Any], values: Mapping[KeyPath, Any]) -> Iterator[str]:
    """Yield a line for each setting of the scene that differs from the recording's."""
    for key, value in values.items():
        section = tables.get(str(key[0]), {})
        stated = section.get(key[1]) if isinstance(section, Mapping) else None
        if key[1] == "input_range_v" or not isinstance(stated, int | float):
            continue
        if not math.isclose(stated, value, rel_tol=1e-9):
            yield f"{'.'.join(map(str, key))} = {value}, not {stated} as in the scene"


def _lists(tables: Mapping[str, Any]) -> dict[str, list[Any]]:
    """Return the lists of forces and of burst lengths in the scene by key, empty ones left out."""
    excitation = tables.get("excitation", {})
    if not isinstance(excitation, dict):
        return {}
    lists = {key: excitation.get(key) for key in ("burst_length_s", "force_fraction")}
    return {key: values for key, values in lists.items() if isinstance(values, list) and values}


def _settings_in_turn(tables: Mapping[str, Any]) -> Iterator[str]:
    """Yield a line for each list of the scene: the file itself does not say which shot has which value."""
    for key, values in _lists(tables).items():
        if len(values) > 1:
            yield f"the shots have excitation.{key} = {', '.join(map(str, values))} of the scene in turn"


def _refuse_sweeps(tables: Mapping[str, Any], source: str) -> None:
    """Raise ``SettingsError`` if the scene sweeps a setting of the acquisition."""
    sweep = tables.get("sweep", {})
    if not isinstance(sweep, Mapping):
        return
    what = "a recording has one value of it"
    remedy = "one scene and recording per value; hpe-rig process RUN.h5 --sweep varies the processing"
    keys = [key for key in sweep if key not in ("window_length_s", "lateral_offset_m")]
    if keys:
        raise SettingsError(source, [Mistake(f"sweep.{key}", what, remedy) for key in keys])


def _refuse_other_shot_count(plan: Plan, recording: Recording) -> None:
    lines, shots = recording.values.shape[:2]
    if len(plan.shots) != lines * shots:
        what = f"the scene has {len(plan.shots)} shots, the recording {lines} lines of {shots}"
        remedy = "forces times burst lengths times repeats equal to the length of the recording's axis shot"
        raise SettingsError(f"recording {recording.name}", [Mistake("axes", what, remedy)])


def _quantisation(recording: Recording) -> tuple[ToCodes, float, list[str]]:
    """Return the function from values to codes of 16 bits, the volts of one code, and the assumptions in words.

    Integers of up to 16 bits are kept, other values are quantised.
    """
    values = recording.values
    if are_codes(values):
        return _integer_quantisation(recording)
    # One shot in memory at a time.
    largest = max(float(np.abs(shot).max()) for line in values for shot in line)
    unit_v = 1.0 if recording.scale_v is None else recording.scale_v
    # The largest value gets the code MAX_CODE. Full scale is one and a half codes above it.
    range_v = largest * unit_v * (2 * MAX_CODE + 3) / (2 * MAX_CODE)
    inferred = []
    if not MIN_RANGE_V <= range_v <= MAX_RANGE_V:
        inferred.append(f"values up to {largest:.3g} are scaled to 1 V: they are no plausible volts")
        range_v = (2 * MAX_CODE + 3) / (2 * MAX_CODE)
    elif recording.scale_v is None:
        inferred.append("volts are not stated: a value of 1 counts as 1 V")

    def to_codes(selected: NDArray[Any]) -> Int16Array:
        """Return ``selected`` values, rounded, with MAX_CODE for the largest of the recording."""
        return np.asarray(np.rint(selected * (MAX_CODE / largest)), np.int16)

    return to_codes, 2 * range_v / (2 * MAX_CODE + 3), inferred


def _integer_quantisation(recording: Recording) -> tuple[ToCodes, float, list[str]]:
    """Return the function from integers of up to 16 bits to codes around zero, and as ``_quantisation``."""
    values, scale_v = recording.values, recording.scale_v
    zero, inferred = zero_code(values), []
    lowest = (int((shot.astype(np.int32) - zero < -FULL_SCALE_CODES).sum()) for line in values for shot in line)
    if raised := sum(lowest):
        inferred.append(f"{raised} samples of the lowest code are replaced by the next higher code")
    if zero:
        inferred.append(f"integers without sign: {zero} is zero volts")
    if scale_v is None:
        scale_v = UNSTATED_SCALE_V
        inferred.append("volts are not stated: the codes of 16 bits span plus and minus 1 V")
    return signed_codes, scale_v, inferred


def _quantisation_warnings(recording: Recording, to_codes: ToCodes, plan: Plan) -> tuple[str, ...]:
    """Return a warning if quantisation adds noticeable noise to the echoes of the gate."""
    if recording.values.dtype.kind != "f":
        return ()
    gate = to_codes(recording.values[..., plan.shots[0].gate]).astype(np.float32)
    # The mean is the offset of the digitizer.
    rms = float(np.sqrt(np.mean((gate - gate.mean()) ** 2)))
    if rms >= MIN_GATE_RMS_CODES:
        return ()
    return (
        f"WARNING the gate's echoes have an rms of {rms:.2g} codes of 16 bits, since the largest value of the record "
        "lies elsewhere: samples = [first, end] around the gate reduces the quantisation noise",
    )


def _bench_text(recording: Recording, inferred: tuple[str, ...]) -> str:
    shipped = resources.files("hpe_rig.bench") / "shipped" / "imported.toml"
    text = shipped.read_text(encoding="utf-8")
    if recording.board is not None:
        text = text.replace('model = "ATS9462"', f"model = {json.dumps(recording.board)}")
    values = {
        "source": recording.name[:1000],
        "sha256": recording.sha256,
        "format": recording.format,
        "first_sample_s": recording.first_sample_s,
        "inferred": list(inferred),
    }
    # Strings, numbers and lists have the same notation in JSON and TOML.
    return text + "".join(f"{key} = {json.dumps(value)}\n" for key, value in values.items())


def _with_recorded_times(plan: Plan, recording: Recording) -> Plan:
    """Return ``plan`` with the pulse times of the recording, unless they are regular."""
    if recording.regular:
        return plan
    shots = (
        replace(shot, timeline=replace(shot.timeline, pulse_onset_s=recording.pulse_time_s)) for shot in plan.shots
    )
    return replace(plan, shots=tuple(shots))


def _write_records(
    writer: RunWriter, plan: Plan, recording: Recording, to_codes: ToCodes, *, scale_v: float, limits: tuple[int, int]
) -> None:
    """Write the records of every line and shot as the shots of the run, one shot in memory at a time."""
    shots_of_lines = (
        (line, shot) for line in range(len(recording.values)) for shot in range(recording.values.shape[1])
    )
    for shot, index in zip(plan.shots, shots_of_lines, strict=True):
        codes, recorded = to_codes(recording.values[index]), recording.recorded[index]
        writer.write_settings(shot, {})
        # The records of a block without times are consecutive. So each run of existing records is one block.
        for rows in np.split(np.arange(recorded.size), np.flatnonzero(np.diff(recorded.astype(np.int8))) + 1):
            if recorded[rows[0]]:
                block = np.ascontiguousarray(codes[rows])
                times = np.full(rows.size, np.nan)
                writer.append(shot, RecordBlock(int(rows[0]), block, times, scale_v, scale_v / 2, limits))
        clipped = bool((codes <= limits[0]).any() or (codes >= limits[1]).any())
        writer.write_rows(shot, {"records/clipped": clipped})
        writer.finish(shot)
