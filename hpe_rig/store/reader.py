"""Content of a run, from its run file or, during the run, from its log.

Every value is compared with its checksum. A record counts as missing and damaged if its echoes, or the mark in
``recorded`` that it arrived, fail their checksum. Early files without checksums are read unchecked, except for chunks
beyond the end of the file.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from drivers.interfaces import Setting
from hpe_rig.arrays import BoolArray, FloatArray
from hpe_rig.plan import Plan
from hpe_rig.result import Provenance
from hpe_rig.scene import printable
from hpe_rig.store.codes import arrival_of, code_limits_of, echo_dataset
from hpe_rig.store.foreign_hdf5 import InvalidContentError
from hpe_rig.store.format import (
    CONDITION_BYTES,
    MAX_CONDITIONS,
    MAX_STAGES,
    SNAPSHOT_BYTES,
    STAGE_BYTES,
    STATUSES,
    TIME_BYTES,
    UNTRUSTED_BYTES,
    StoreError,
)
from hpe_rig.store.layout import TRUE_HARMONICS, code_scale_and_offset_v
from hpe_rig.store.marks import identity_of, read_marks, write_marks
from hpe_rig.store.rows import Shape, checked_row, checked_rows, dataset_by_pulse, datasets_by_shot, row_or_blank
from hpe_rig.store.source import open_checked
from hpe_rig.store.stored_records import StoredGroundTruth, StoredRecords
from hpe_rig.store.validation import CheckedFile

MAX_SHOTS: Final = 1_000_000


@dataclass(frozen=True, slots=True)
class ShotRows:
    """One shot without its echoes: which records arrived and when, (pulse,), and its rows of the other datasets."""

    recorded: BoolArray
    trigger_time_s: FloatArray
    tables: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class StoredRun:
    """Content of a run file.

    true_displacement_m: (pulse,) for each shot; None for a real bench.
    shot_complete: (shot,).
    clipped: shots during which the digitizer's input left its range.
    predecessor: name of the run that this run continued, "" without one.
    run_time_s: wall time of the acquisition by stage; empty if not measured.
    force_set: (shot,), force over F_0 from the amplitude read back from the toneburst generator; NaN without a push,
        without a setting or in early files.
    untrusted: why a shot is untrusted, by shot.
    damage: damaged content other than echoes, and the value used instead.
    provenance: empty in early files and in those of scripts that omit it.
    scan_sha256: SHA-256 of the file ``beams.excitation_scan``; "" without one and in early files.
    changed_settings: differences of the settings after a shot from those before it, in words, by shot.
    conditions: by name, (shot, 2), read before and after each shot; NaN if not read.
    marks: why results leave a shot out, for each shot that was marked as bad after the run.
    """

    path: Path
    scene_name: str
    scene_toml: str
    bench_name: str
    bench_toml: str
    simulated: bool
    status: str
    records: StoredRecords
    true_displacement_m: StoredGroundTruth | None
    shot_complete: BoolArray
    clipped: tuple[int, ...]
    predecessor: str
    run_time_s: Mapping[str, float]
    force_set: FloatArray
    untrusted: Mapping[int, str]
    damage: tuple[str, ...]
    has_checksums: bool
    run_id: str
    provenance: Provenance
    scan_sha256: str
    changed_settings: Mapping[int, str] = field(default_factory=dict)
    conditions: Mapping[str, FloatArray] = field(default_factory=dict)
    marks: Mapping[int, str] = field(default_factory=dict)

    @property
    def identity(self) -> dict[str, str]:
        """The identity of the run, which its marks repeat."""
        return identity_of(self.run_id, self.provenance.started)

    def mark(self, shots: Sequence[int], why: str | None) -> Path:
        """Mark ``shots``, counted from 0, as bad for the reason ``why`` or, with None, as good; return the marks' path.

        The marks of this value stay as they were read.
        """
        marks = {shot: text for shot, text in self.marks.items() if shot not in shots}
        return write_marks(self.path, self.identity, marks if why is None else marks | dict.fromkeys(shots, why))

    @property
    def imported(self) -> bool:
        """Whether the records are those of another program, which states the pulse of each."""
        return "[recording]" in self.bench_toml.splitlines()

    def rows(self, shot: int) -> ShotRows:
        """Return the values of ``shot`` other than its echoes, to copy them; missing or damaged values are blank."""
        shape = self.records.shape
        with open_checked(self.path) as checked:
            arrival = arrival_of(checked, shape, shot)
            tables = {
                name: row_or_blank(checked, name, dataset, shot)
                for name, dataset in datasets_by_shot(checked, shape)
                if not name.endswith("shot_complete")
            }
        return ShotRows(arrival.recorded, arrival.trigger_time_s, tables)

    def is_intact(self, shot: int) -> bool:
        """Return whether everything of ``shot`` matches its checksums; reads the whole shot."""
        return not damage_by_shot(self, shot) and not self.records.damaged(shot).any()

    def refuse_other_plan(self, plan: Plan) -> None:
        """Raise ``StoreError`` if the records do not fit ``plan``: the file or its scene was changed."""
        capture = plan.shots[0].capture
        planned = (len(plan.shots), capture.record_count, capture.record_samples)
        if planned != self.records.shape:
            raise StoreError(
                f"{self.path} holds (shot, pulse, sample) = {self.records.shape}, its scene asks for {planned}. "
                "It was changed. Try: an untouched copy."
            )
        for shot, force in zip(plan.shots, self.force_set, strict=True):
            # Instruments round by some per cent of their lowest amplitude, and by far less at higher amplitudes.
            if np.isfinite(force) and not math.isclose(force, shot.force_fraction or 0.0, rel_tol=0.1):
                raise StoreError(
                    f"{self.path} has a force of {force:g} F_0 in shot {shot.index + 1}, its scene asks for "
                    f"{shot.force_fraction or 0.0:g}. It was changed. Try: an untouched copy."
                )
        with open_checked(self.path) as checked:
            stored = tuple(checked.attribute(name, float, "records/echo") for name in ("scale_factor", "add_offset"))
            expected = code_scale_and_offset_v(capture.input_range_v, code_limits_of(checked, "records/echo"))
        if not np.allclose(stored, expected, rtol=1e-9, atol=0):
            raise StoreError(
                f"{self.path} has {stored[0]:g} V per code, its scene's input range of {capture.input_range_v:g} V "
                f"gives {expected[0]:g}. It was changed. Try: an untouched copy."
            )


def read_run(path: Path) -> StoredRun:
    """Return the run in ``path``, also of a running or killed program; raise ``StoreError`` if it is not a run file."""
    with open_checked(path) as checked:
        stored = _stored_run(checked, path)
    marks, why_ignored = read_marks(path, stored.identity, stored.shot_complete.size)
    return replace(stored, marks=marks, damage=(*stored.damage, *([why_ignored] if why_ignored else [])))


def read_snapshots(path: Path) -> tuple[Mapping[str, Mapping[str, Setting]], ...]:
    """Return the instruments' settings of each acquired shot, as read back, by role of the instrument.

    Raises ``StoreError`` if the file is no readable run file.
    """
    with open_checked(path) as checked:
        dataset = checked.dataset("snapshot", f"S{SNAPSHOT_BYTES}", (None,))
        texts = [row_or_blank(checked, "snapshot", dataset, shot).item() for shot in range(dataset.shape[0])]
        return tuple(_settings(text) for text in texts if text)


def _settings(text: bytes) -> Mapping[str, Mapping[str, Setting]]:
    """Return the instruments' settings of a shot by role, from their JSON ``text``.

    Raises ``InvalidContentError`` for any other content.
    """
    try:
        roles = json.loads(text)
    except (ValueError, RecursionError):
        raise InvalidContentError("a shot's settings are not JSON") from None
    if not isinstance(roles, dict) or not all(isinstance(values, dict) for values in roles.values()):
        raise InvalidContentError("a shot's settings are not listed by role")
    if not all(isinstance(value, str | int | float) for values in roles.values() for value in values.values()):
        raise InvalidContentError("a setting is not a single value")
    return roles


def _stored_run(checked: CheckedFile, path: Path) -> StoredRun:
    """Return the content of a run file, without its echoes, and with a message for each damaged part left out."""
    simulated = checked.attribute("simulated", bool)
    shape = _checked_shape(checked, simulated)
    status = checked.attribute("status", str)
    if status not in STATUSES:
        raise InvalidContentError(f"its status is {status!r}")
    damage = list[str]()
    if (remark := _remark_on_length(checked)) is not None:
        damage.append(remark)
    shot_complete, damaged_shots = _flags(checked, shape, "shot_complete", "does not count as complete")
    clipped, damaged_clipping = _flags(checked, shape, "clipped", "may have been clipped")
    damage += damaged_shots + damaged_clipping
    run_time_s, times_intact = _run_time_s(checked)
    damage += [] if times_intact else ["/run_time fails its checksum: the run times are left out"]
    provenance, end_intact = _provenance(checked)
    damage += [] if end_intact else ["/provenance/ended fails its checksum: when the run ended is left out"]
    damage += _damaged_rows(checked, shape)
    return StoredRun(
        path=path,
        scene_name=checked.attribute("scene_name", str),
        scene_toml=checked.text("scene"),
        bench_name=checked.attribute("bench_name", str),
        bench_toml=checked.text("bench"),
        simulated=simulated,
        status=status,
        records=StoredRecords(path, shape),
        true_displacement_m=StoredGroundTruth(path, shape) if simulated else None,
        shot_complete=shot_complete,
        clipped=tuple(int(shot) for shot in np.flatnonzero(clipped)),
        predecessor=checked.attribute("predecessor", str),
        run_time_s=run_time_s,
        force_set=_force_set(checked, shape[0]),
        untrusted=_texts_by_shot(checked, shape, "untrusted"),
        damage=tuple(damage),
        has_checksums=checked.has_checksums,
        run_id=checked.attribute("run_id", str) if "run_id" in checked.file.attrs else "",
        provenance=provenance,
        scan_sha256=checked.attribute("scan_sha256", str) if "scan_sha256" in checked.file.attrs else "",
        changed_settings=_texts_by_shot(checked, shape, "changed_settings"),
        conditions=_conditions(checked, shape[0]),
    )


def _remark_on_length(checked: CheckedFile) -> str | None:
    """Return a message if the end of the file is damaged."""
    if checked.missing_bytes > 0 and checked.codes:
        return f"the log of the run is damaged: its last {checked.missing_bytes} bytes are left out"
    if checked.missing_bytes > 0:
        return f"the file is cut short: {checked.missing_bytes} bytes are missing at its end"
    if checked.missing_bytes < 0 and checked.is_written_once:
        return f"{-checked.missing_bytes} bytes follow the end of the file: another program has appended them"
    return None


def _checked_shape(checked: CheckedFile, simulated: bool) -> Shape:
    """Return the shape (shot, pulse, sample) of the echoes.

    Raises ``InvalidContentError`` unless all datasets with a value for each pulse have the same shots and pulses.
    """
    shape: Shape = checked.dataset("records/echo", "<i2", (None, None, None)).shape
    if min(shape) < 1 or shape[0] > MAX_SHOTS:
        raise InvalidContentError(f"/records/echo has shape {shape}")
    echo_dataset(checked, shape)
    for name, dtype in (("recorded", "u1"), ("trigger_time_s", "<f8"), ("pulse_onset_s", "<f8")):
        dataset_by_pulse(checked, f"records/{name}", shape, dtype)
    if simulated:
        dataset_by_pulse(checked, "truth/displacement_m", shape)
    return shape


def _flags(checked: CheckedFile, shape: Shape, name: str, consequence: str) -> tuple[BoolArray, list[str]]:
    """Return the flag ``name`` of each shot (shot,), and a message for each that fails its checksum.

    ``consequence``: the end of that message.
    """
    values, intact = checked_rows(checked, f"records/{name}", checked.dataset(f"records/{name}", "u1", shape[:1]))
    damage = [
        f"shot {shot + 1}: /records/{name} fails its checksum: the shot {consequence}"
        for shot in np.flatnonzero(~intact)
    ]
    return values == 1, damage


def _force_set(checked: CheckedFile, shots: int) -> FloatArray:
    """Return the relative force that the generator was set to in each shot, as read back, (shot,), NaN if unknown."""
    if not checked.has("records/force_set"):
        # Early releases did not read the generator's setting back.
        return np.full(shots, np.nan)
    force, _ = checked_rows(checked, "records/force_set", checked.dataset("records/force_set", "<f8", (shots,)))
    return force


def _texts_by_shot(checked: CheckedFile, shape: Shape, name: str) -> dict[int, str]:
    """Return the texts of a dataset by shot, such as why a shot is untrusted; shots without a text are absent."""
    if not checked.has(name):
        # Early releases did not read settings back after a shot.
        return {}
    dataset = checked.dataset(name, f"S{UNTRUSTED_BYTES}", shape[:1])
    unknown = f"its state is unknown, /{name} is damaged".encode("ascii")
    rows = zip(*checked_rows(checked, name, dataset), strict=True)
    texts = [text if intact else unknown for text, intact in rows]
    return {shot: text.decode("ascii", "replace") for shot, text in enumerate(texts) if text}


def _conditions(checked: CheckedFile, shots: int) -> dict[str, FloatArray]:
    """Return the readings of each condition by name, (shot, 2): before and after each shot.

    A condition is a quantity that may affect the measurement, such as the water's temperature. NaN: not read, or
    damaged.
    """
    if not checked.has("conditions"):
        return {}
    names = checked.dataset("conditions/condition", f"S{CONDITION_BYTES}", (None,))
    if names.shape[0] > MAX_CONDITIONS:
        raise InvalidContentError(f"/conditions has {names.shape[0]} conditions")
    checked.refuse_damaged("conditions/condition", names)
    shape = (shots, names.shape[0])
    columns = [
        checked_rows(checked, name, checked.dataset(name, "<f8", shape))[0]
        for name in ("conditions/before", "conditions/after")
    ]
    values = np.stack(columns, axis=-1)
    return {printable(name.decode("ascii", "replace")): values[:, index] for index, name in enumerate(names[()])}


def _run_time_s(checked: CheckedFile) -> tuple[dict[str, float], bool]:
    """Return the time that each stage of the run took, s, and whether the times match their checksum."""
    if not checked.has("run_time"):
        # The earliest run files of this version have none.
        return {}, True
    names = checked.dataset("run_time/stage", f"S{STAGE_BYTES}", (None,))
    if names.shape[0] > MAX_STAGES:
        raise InvalidContentError(f"/run_time has {names.shape[0]} stages")
    checked.refuse_damaged("run_time/stage", names)
    dataset = checked.dataset("run_time/run_time_s", "<f8", names.shape)
    times_s, intact = checked_row(checked, "run_time/run_time_s", dataset, None)
    pairs = zip([name.decode("ascii", "replace") for name in names[()]], times_s, strict=True)
    return {stage: float(time_s) for stage, time_s in pairs if stage.isprintable() and 0 <= time_s < math.inf}, intact


def _provenance(checked: CheckedFile) -> tuple[Provenance, bool]:
    """Return start, end, host, user and drivers of the run, and whether the end matches its checksum."""
    if not checked.has("provenance"):
        return Provenance(), True
    texts = {name: checked.text(f"provenance/{name}") for name in ("started", "host", "user", "drivers")}
    ended, intact = checked_row(
        checked, "provenance/ended", checked.dataset("provenance/ended", f"S{TIME_BYTES}", ()), None
    )
    text = ended.item().decode("ascii", "replace")
    return Provenance(**texts, ended=text if text.isprintable() else ""), intact


def _damaged_rows(checked: CheckedFile, shape: Shape) -> Iterator[str]:
    """Yield a message for each shot and dataset of planned onsets or simulated truth that fails its checksum."""
    consequences = {
        "records/pulse_onset_s": "its records are counted in the order of arrival",
        "truth/displacement_m": "its truth is left out",
        **{f"true_harmonics/{name}": "its truth is left out" for name in TRUE_HARMONICS},
    }
    for name, dataset in datasets_by_shot(checked, shape):
        if name in consequences:
            _, intact = checked_rows(checked, name, dataset)
            for shot in np.flatnonzero(~intact):
                yield f"shot {shot + 1}: /{name} fails its checksum: {consequences[name]}"


def damage_by_shot(stored: StoredRun, shot: int) -> tuple[str, ...]:
    """Return a message for each dataset with one checksum per shot that fails it in the row of ``shot``."""
    with open_checked(stored.path) as checked:
        datasets = datasets_by_shot(checked, stored.records.shape)
        rows = [(name, checked_row(checked, name, dataset, shot)) for name, dataset in datasets]
    return tuple(f"/{name} fails its checksum" for name, (_, intact) in rows if not intact)
