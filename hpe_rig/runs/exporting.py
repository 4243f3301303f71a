"""Export of a run to a file of zea, USTB (UFF) or MATLAB; ``import_records`` reads it again."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hpe_rig.arrays import Int16Array
from hpe_rig.plan import Shot, scene_of_shot
from hpe_rig.recordings import Echoes, ExportFormat, Label, differing_setting, export_image
from hpe_rig.runs.run import Run, open_run
from hpe_rig.scene import Mistake, SettingsError, plural
from hpe_rig.store import Placement, StoreError, refuse_output, write_file

SUFFIXES: Mapping[str, ExportFormat] = {".hdf5": "zea", ".uff": "uff", ".mat": "mat"}
"""Format by the ending of the file."""
ENDINGS: Mapping[ExportFormat, tuple[str, ...]] = {"zea": (".hdf5", ".h5"), "uff": (".uff", ".h5"), "mat": (".mat",)}
"""Endings by which readers, ``import_records`` among them, detect a format."""
MAX_BYTES = 2**31 - 1
"""Most bytes of echoes in a file: the limit of MATLAB's format, and the file is in memory until it is whole."""
SAME_PULSE_TIME_S = 1e-12


def export_run(
    run: Run | str | os.PathLike[str],
    path: str | os.PathLike[str],
    file_format: ExportFormat | None = None,
    shots: Sequence[int] | None = None,
    *,
    overwrite: bool = False,
) -> tuple[str, ...]:
    """Write the echoes of ``run`` to ``path`` for other programs; return in words what is absent, and how to read it.

    ``file_format``: "zea", "uff" of USTB, or "mat"; default: by the ending .hdf5, .uff or .mat. ``shots``, counted
    from 0; default: all complete ones that are not marked as bad. Missing records are NaN, or -32768 in MATLAB. A
    simulated run has its truth as labels. ``overwrite`` replaces a file at ``path``, never the run file. Raises
    ``SettingsError`` if the format cannot hold the shots, and ``StoreError`` if the file exists or cannot be written.

    >>> export_run("bovine-muscle.h5", "bovine-muscle.hdf5")
    """
    from hpe_rig.processing import assign_pulses

    run, path = run if isinstance(run, Run) else open_run(run), Path(path)
    refuse_output(path, overwrite and path.resolve() != run.path.resolve())
    selected, omitted = _selected_shots(run, shots)
    selected_format = _format_of(path, file_format)
    mistakes = list(_conflicts(run, selected, selected_format))
    if mistakes:
        raise SettingsError("export", mistakes)
    placements = [assign_pulses(shot, run.stored).placement for shot in selected]
    echoes = _echoes_of(run, selected, placements)
    image, missing = export_image(echoes, selected_format)
    write_file(path, image, overwrite)
    counts = [(shot.index + 1, count) for shot, count in zip(selected, missing.tolist(), strict=True) if count]
    gaps = [f"shot {shot}: {plural(count, 'missing record')}" for shot, count in counts]
    lateral_offset_m = np.array([shot.lateral_offset_m for shot in selected])
    if key := differing_setting(echoes.pulse_time_s, lateral_offset_m):
        advice = f"for other programs only: its shots differ in {key}, and hpe-rig import needs one value of it. "
        advice += f"Try: hpe-rig export {run.path} --shot for shots of one {key}"
    else:
        option = " --set not_finite=missing" if gaps else ""
        advice = f"hpe-rig import {path} --scene SCENE{option} reads it again"
    return (*omitted, *gaps, f"{path}: {advice}")


def _format_of(path: Path, file_format: ExportFormat | None) -> ExportFormat:
    """Return ``file_format``, by default that of the ending of ``path``; raise ``SettingsError`` for another."""
    selected = file_format or SUFFIXES.get(path.suffix.lower())
    if selected is None or selected not in SUFFIXES.values():
        what = f"{selected!r} is unknown" if selected else f"the ending of {path.name} implies no format"
        raise SettingsError("export", [Mistake("format", what, f"one of {', '.join(SUFFIXES.values())}")])
    if path.suffix.lower() not in ENDINGS[selected]:
        what = f"{path.name} is no name of a {selected} file, and readers detect a format by the ending"
        remedy = " or ".join(f"{path.stem}{ending}" for ending in ENDINGS[selected])
        raise SettingsError("export", [Mistake("format", what, remedy)])
    return selected


def _selected_shots(run: Run, shots: Sequence[int] | None) -> tuple[list[Shot], tuple[str, ...]]:
    """Return the shots to export, and a sentence for those that are left out."""
    complete, marks = run.stored.shot_complete, run.stored.marks
    total = len(run.plan.shots)
    mistakes = [
        Mistake("shots", f"shot {shot + 1} does not exist", f"1 to {total}")
        for shot in shots or ()
        if not 0 <= shot < total
    ]
    if mistakes:
        raise SettingsError("export", mistakes)
    indices, omitted = list[int](), list[str]()
    for shot in range(total) if shots is None else sorted(set(shots)):
        if complete[shot] and (shots is not None or shot not in marks):
            indices.append(shot)
        else:
            omitted.append(f"shot {shot + 1} is left out: {marks[shot] if complete[shot] else 'incomplete'}")
    if not indices:
        raise StoreError(f"{run.path} has no complete shot to export. Try: another run, or hpe-rig resume.")
    return [run.plan.shots[shot] for shot in indices], tuple(omitted)


def _conflicts(run: Run, shots: Sequence[Shot], file_format: ExportFormat) -> Iterator[Mistake]:
    """Yield a mistake for each setting with several values in ``shots`` that the format holds once."""
    remedy = "--shot for shots with one value of it, and another file for the others"
    scenes = [scene_of_shot(run.scene, shot) for shot in shots]
    settings: dict[str, list[Any]] = {
        "acquisition.sample_rate_hz": [shot.capture.sample_rate_hz for shot in shots],
        "acquisition.input_range_v": [shot.capture.input_range_v for shot in shots],
        "tracking.carrier_hz": [scene.tracking.carrier_hz for scene in scenes],
        "start of the record, s": [shot.timeline.record_offset_s[0] for shot in shots],
        "processing.frequencies_hz": [scene.wanted_frequencies_hz for scene in scenes],
    }
    for name, values in settings.items():
        if len(distinct := list(dict.fromkeys(values))) > 1:
            yield Mistake("shots", f"the shots have several values: {name}, {distinct[0]}, {distinct[1]}", remedy)
    intervals_s = np.stack([np.diff(shot.timeline.pulse_onset_s) for shot in shots])
    if file_format == "uff" and np.ptp(intervals_s) > SAME_PULSE_TIME_S:
        what = f"UFF holds one pulse rate, the intervals are {intervals_s.min():g} to {intervals_s.max():g} s"
        yield Mistake("format", what, "zea or mat, or --shot for shots of one rate")
    size = len(shots) * run.records.shape[1] * run.records.shape[2] * (2 if file_format == "mat" else 4)
    if size > MAX_BYTES:
        what = f"the echoes take {size / 1e9:.1f} GB, a file holds {MAX_BYTES / 1e9:.1f} GB"
        yield Mistake("shots", what, "--shot for some of the shots, and further files for the others")


def _echoes_of(run: Run, shots: Sequence[Shot], placements: Sequence[Placement]) -> Echoes:
    """Return the echoes of ``shots``, whose records have the pulses of ``placements``."""

    def codes_of(index: int) -> Int16Array:
        samples = slice(0, run.records.shape[2])
        return run.records.gated(shots[index].index, samples, placement=placements[index]).codes

    scene, first = scene_of_shot(run.scene, shots[0]), shots[0]
    record = run.records.gated(first.index, slice(0, 1))
    bursts_s = first.timeline.burst_onset_s
    # Time zero of an import: the first toneburst, or the edge of the master trigger.
    zero_s = [float(onset_s[0]) if (onset_s := shot.timeline.burst_onset_s).size else 0.0 for shot in shots]
    pulse_time_s = np.stack([shot.timeline.pulse_onset_s - zero for shot, zero in zip(shots, zero_s, strict=True)])
    focus_m = scene.beams.focus_depth_m if scene.beams is not None else None
    settings: dict[str, Any] = {
        "scale_v": record.volts_per_code,
        "offset_v": record.volts_offset,
        "sample_rate_hz": first.capture.sample_rate_hz,
        "carrier_hz": scene.tracking.carrier_hz,
        "sound_speed_m_per_s": scene.acquisition.sound_speed_m_per_s,
        "first_sample_s": first.timeline.record_offset_s[0],
        "pulse_time_s": pulse_time_s,
    }
    labels = {name: Label(value, *MEANINGS[name]) for name, value in (settings | _values(run, shots)).items()}
    if bursts_s.size:
        labels["burst_time_s"] = Label(bursts_s - bursts_s[0], *MEANINGS["burst_time_s"])
    return Echoes(
        title=scene.title,
        shape=(len(shots), *run.records.shape[1:]),
        codes_of=codes_of,
        focus_m=scene.acquisition.gate_depth_m if focus_m is None else focus_m,
        labels=labels,
        **settings,
    )


MEANINGS: Mapping[str, tuple[str, str]] = {
    "scale_v": ("V", "volts = code * scale_v + offset_v"),
    "offset_v": ("V", "volts of the code 0"),
    "sample_rate_hz": ("Hz", "sampling rate of a record"),
    "carrier_hz": ("Hz", "frequency of the tracking pulses"),
    "sound_speed_m_per_s": ("m/s", "sound speed that converts times to depths"),
    "first_sample_s": ("s", "time of the first sample after the onset of its pulse"),
    "pulse_time_s": ("s", "onset of every pulse after the first toneburst, without tonebursts after the trigger"),
    "burst_time_s": ("s", "onset of every toneburst after the first one"),
    "shot_number": ("1", "number of every shot in the run, from 1"),
    "lateral_offset_m": ("m", "lateral offset of the tracking transducer in every shot"),
    "burst_length_s": ("s", "length of the tonebursts in every shot, 0 without any"),
    "force_fraction": ("1", "force of every shot as a fraction of that at full drive, NaN without tonebursts"),
    "simulated": ("1", "1: the echoes are simulated, 0: they are measured"),
    "origin": ("1", "run file, and recording of an imported one"),
    "scene_toml": ("1", "scene of the run"),
    "frequencies_hz": ("Hz", "wanted frequencies of the motion"),
    "true_displacement_m": ("m", "simulated displacement at the focus at every pulse, positive away from the probe"),
    "true_amplitude_m": ("m", "simulated amplitude at every wanted frequency"),
    "true_phase_rad": ("rad", "simulated phase of sin(2 pi f t + phase), t from the arrival of the first toneburst"),
}
"""Unit and meaning of the exported values by name."""


def _values(run: Run, shots: Sequence[Shot]) -> dict[str, Any]:
    """Return the values of every shot and, of a simulated run, its truth, (shot, ...)."""
    stored, frequencies_hz = run.stored, scene_of_shot(run.scene, shots[0]).wanted_frequencies_hz
    recording = run.bench.recording
    values: dict[str, Any] = {
        "shot_number": np.array([shot.index + 1 for shot in shots]),
        "lateral_offset_m": np.array([shot.lateral_offset_m for shot in shots]),
        "burst_length_s": np.array([shot.timeline.burst_length_s for shot in shots]),
        "force_fraction": np.array([np.nan if shot.force_fraction is None else shot.force_fraction for shot in shots]),
        "simulated": int(stored.simulated),
        "origin": run.path.name if recording is None else f"{run.path.name}, {recording.words}",
        "scene_toml": stored.scene_toml,
        "frequencies_hz": np.array(frequencies_hz),
    }
    truth = stored.true_displacement_m
    if truth is not None:
        quadratures_m = np.stack([truth.harmonics_m(shot.index, len(frequencies_hz)) for shot in shots])
        values["true_displacement_m"] = np.stack([truth[shot.index] for shot in shots])
        values["true_amplitude_m"] = np.hypot(quadratures_m[..., 0], quadratures_m[..., 1])
        values["true_phase_rad"] = np.arctan2(quadratures_m[..., 1], quadratures_m[..., 0])
    return values
