"""Content of a run, from its run file or, during the run, from its log.

Every value is compared with its checksum. A record counts as missing and damaged if its echoes, or the mark in
``recorded`` that it arrived, fail their checksum. Early files without checksums are read unchecked, except for chunks
beyond the end of the file.
"""

from __future__ import annotations

import hashlib
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
from hpe_rig.store.codes import code_limits_of
from hpe_rig.store.damage import Damage
from hpe_rig.store.datasets import BY_SHOT
from hpe_rig.store.foreign_hdf5 import InvalidContentError
from hpe_rig.store.format import CONDITION_BYTES, STAGE_BYTES, STATUSES, StoreError
from hpe_rig.store.layout import code_scale_and_offset_v
from hpe_rig.store.marks import identity_of, read_marks, write_marks
from hpe_rig.store.rows import checked_row, checked_rows
from hpe_rig.store.source import open_checked
from hpe_rig.store.stored_records import StoredGroundTruth, StoredRecords
from hpe_rig.store.validation import CheckedFile

REQUIRED: Final = ("snapshot", "records/pulse_onset_s", "records/shot_complete", "records/clipped")
"""Datasets with a row for each shot that every run file has."""
TEXTS: Final = ("untrusted", "changed_settings")
READ_AT_ONCE: Final = (
    *TEXTS,
    "conditions/before",
    "conditions/after",
    "records/shot_complete",
    "records/clipped",
    "records/force_set",
)
AXIS_NAMES: Final = {"run_time/stage": f"S{STAGE_BYTES}", "conditions/condition": f"S{CONDITION_BYTES}"}


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
    damage: tuple[Damage, ...]
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

    @property
    def digest(self) -> str:
        """Hexadecimal digits that differ between two runs, also of one scene into one file; results repeat them."""
        # Runs of scripts may have neither an identifier nor a start.
        parts = (self.run_id, self.provenance.started, self.scene_toml, self.bench_toml)
        return hashlib.sha256("\0".join(parts).encode()).hexdigest()[:16]

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

    def rows(self, shot: int) -> dict[str, Any]:
        """Return the values of ``shot``, by name of the dataset, so that another run can copy them.

        Echoes, marks and trigger times of records are left out, and whether the shot is complete. Values that were not
        written or fail their checksum are blank: zeros, NaN or an empty text.
        """
        names = [name for name in BY_SHOT if name != "records/shot_complete"]
        with self.records.open() as checked:
            return {name: checked_row(checked, name, shot)[0] for name in names if checked.has(name)}

    def is_intact(self, shot: int) -> bool:
        """Return whether everything of ``shot`` matches its checksums; reads the echoes of the shot."""
        return all(damage.shot != shot for damage in self.damage) and not self.records.damaged(shot).any()

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
    return replace(stored, marks=marks, damage=(*stored.damage, *([Damage(why_ignored)] if why_ignored else [])))


def read_snapshots(path: Path) -> tuple[Mapping[str, Mapping[str, Setting]], ...]:
    """Return the instruments' settings of each acquired shot, as read back, by role of the instrument.

    Raises ``StoreError`` if the file is no readable run file.
    """
    with open_checked(path) as checked:
        return tuple(_settings(text.item()) for text, _ in checked_rows(checked, "snapshot") if text.item())


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
    """Return the content of a run file, without its echoes, and the damage of the parts left out."""
    simulated = checked.attribute("simulated", bool)
    status = checked.attribute("status", str)
    if status not in STATUSES:
        raise InvalidContentError(f"its status is {status!r}")
    for name in ("records/recorded", "records/trigger_time_s", *(["truth/displacement_m"] if simulated else [])):
        # Refuses another type or shape.
        checked.dataset(name)
    rows, damage = _rows(checked)
    run_time_s, times_damage = _run_time_s(checked)
    provenance, provenance_damage = _provenance(checked)
    records, shots = StoredRecords(path, checked.shape), checked.shape[0]
    shot_complete, clipped = (np.array(rows[f"records/{name}"]) == 1 for name in ("shot_complete", "clipped"))
    return StoredRun(
        path=path,
        scene_name=checked.attribute("scene_name", str),
        scene_toml=checked.text("scene"),
        bench_name=checked.attribute("bench_name", str),
        bench_toml=checked.text("bench"),
        simulated=simulated,
        status=status,
        records=records,
        true_displacement_m=StoredGroundTruth(records) if simulated else None,
        shot_complete=shot_complete,
        clipped=tuple(np.flatnonzero(clipped).tolist()),
        predecessor=checked.attribute("predecessor", str),
        run_time_s=run_time_s,
        force_set=np.array(rows.get("records/force_set", [np.nan] * shots)),
        untrusted=_texts(rows.get("untrusted", ())),
        damage=(*_damaged_end(checked), *times_damage, *provenance_damage, *damage),
        has_checksums=checked.has_checksums,
        run_id=checked.attribute("run_id", str) if "run_id" in checked.file.attrs else "",
        provenance=provenance,
        scan_sha256=checked.attribute("scan_sha256", str) if "scan_sha256" in checked.file.attrs else "",
        changed_settings=_texts(rows.get("changed_settings", ())),
        conditions=_conditions(checked, rows),
    )


def _damaged_end(checked: CheckedFile) -> Iterator[Damage]:
    """Yield the damage of the end of the file."""
    if checked.missing_bytes > 0 and checked.codes:
        yield Damage(f"the log of the run is damaged: its last {checked.missing_bytes} bytes are left out")
    elif checked.missing_bytes > 0:
        yield Damage(f"the file is cut short: {checked.missing_bytes} bytes are missing at its end")
    elif checked.missing_bytes < 0 and checked.is_written_once:
        yield Damage(f"{-checked.missing_bytes} bytes follow the end of the file: another program has appended them")


CONSEQUENCES: Final = {
    "snapshot": "its settings are left out",
    "conditions/before": "they are left out",
    "conditions/after": "they are left out",
    "records/shot_complete": "the shot does not count as complete",
    "records/clipped": "the shot may have been clipped",
    "records/force_set": "the force is left out",
    "records/pulse_onset_s": "its records are counted in the order of arrival",
}
"""Consequence of a damaged row, by dataset; that of the others is a truth that is left out."""


def _rows(checked: CheckedFile) -> tuple[dict[str, list[Any]], list[Damage]]:
    """Return the rows of the datasets ``READ_AT_ONCE`` that the file has, and the damaged rows of all datasets.

    A damaged text is replaced by one that says so; other damaged rows are blank.
    """
    rows, damage = dict[str, list[Any]](), list[Damage]()
    for name in BY_SHOT:
        if not checked.has(name) and name not in REQUIRED:
            # Early releases did not write it, or the run has no such values.
            continue
        rows[name] = []
        for shot, (row, is_intact) in enumerate(checked_rows(checked, name)):
            if not is_intact:
                consequence = "" if name in TEXTS else f": {CONSEQUENCES.get(name, 'its truth is left out')}"
                damage.append(Damage(f"/{name} fails its checksum{consequence}", shot))
                row = f"its state is unknown, /{name} is damaged".encode("ascii") if name in TEXTS else row
            if name in READ_AT_ONCE:
                rows[name].append(row)
    return rows, damage


def _texts(rows: Sequence[bytes]) -> dict[int, str]:
    """Return the texts of a dataset by shot, such as why a shot is untrusted; shots without a text are absent."""
    return {shot: bytes(text).decode("ascii", "replace") for shot, text in enumerate(rows) if text}


def _conditions(checked: CheckedFile, rows: Mapping[str, Sequence[FloatArray]]) -> dict[str, FloatArray]:
    """Return the readings of each condition by name, (shot, 2): before and after each shot.

    A condition is a quantity that may affect the measurement, such as the water's temperature. NaN: not read, or
    damaged.
    """
    if not checked.has("conditions"):
        return {}
    values = np.stack([rows["conditions/before"], rows["conditions/after"]], axis=-1)
    names = _names(checked, "conditions/condition", values.shape[1])
    return {printable(name): values[:, index] for index, name in enumerate(names)}


def _run_time_s(checked: CheckedFile) -> tuple[dict[str, float], list[Damage]]:
    """Return the time that each stage of the run took, s, and the damage of the times."""
    if not checked.has("run_time"):
        # The earliest run files of this version have none.
        return {}, []
    times_s, intact = checked_row(checked, "run_time/run_time_s", None)
    names = _names(checked, "run_time/stage", times_s.size)
    pairs = zip(names, times_s.tolist(), strict=True)
    times = {stage: time_s for stage, time_s in pairs if stage.isprintable() and 0 <= time_s < math.inf}
    return times, [] if intact else [Damage("/run_time fails its checksum: the run times are left out")]


def _names(checked: CheckedFile, name: str, size: int) -> list[str]:
    """Return the ``size`` names along an axis; raise ``InvalidContentError`` if they are damaged."""
    dataset = checked.dataset_of_type(name, AXIS_NAMES[name], (size,))
    checked.refuse_damaged(name, dataset)
    return [text.decode("ascii", "replace") for text in dataset[()]]


def _provenance(checked: CheckedFile) -> tuple[Provenance, list[Damage]]:
    """Return start, end, host, user and drivers of the run, and the damage of its end."""
    has_copied_shots = "predecessor_shots" in checked.file.attrs and checked.attribute("predecessor_shots", int) > 0
    continues = checked.attribute("predecessor", str) if has_copied_shots else ""
    if not checked.has("provenance"):
        return Provenance(continues=continues), []
    texts = {name: checked.text(f"provenance/{name}") for name in ("started", "host", "user", "drivers")}
    ended, intact = checked_row(checked, "provenance/ended", None)
    text = ended.item().decode("ascii", "replace")
    damage = [] if intact else [Damage("/provenance/ended fails its checksum: when the run ended is left out")]
    return Provenance(**texts, ended=text if text.isprintable() else "", continues=continues), damage
