"""Listing of the runs in a folder: date, title, status, strongest harmonic of the latest result, and notes."""

from __future__ import annotations

import glob
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from hpe_rig.result import dataclass_schema, titled
from hpe_rig.scene import SettingsError, parse_toml
from hpe_rig.store.checksum import ATTRIBUTE, kind_of
from hpe_rig.store.foreign_hdf5 import InvalidContentError, open_bounded
from hpe_rig.store.format import RESULT_VERSION, StoreError, reason
from hpe_rig.store.marks import MARKED_BAD
from hpe_rig.store.reader import StoredRun, read_run
from hpe_rig.store.validation import CheckedFile

MAX_JSON_BYTES = 64_000_000
"""Maximum size of a result's JSON that the listing reads."""

EARLIER_NAMES = {
    "amplitude_m": "corrected_amplitude_m",
    "amplitude_uncertainty_m": "corrected_uncertainty_m",
    "phase_rad": "corrected_phase_rad",
    "phase_uncertainty_rad": "corrected_phase_uncertainty_rad",
}
"""Names of the values of a harmonic, and those in single shots of result files of version 1."""


@dataclass(frozen=True, slots=True)
class Harmonic:
    """One harmonic of a result; the listing shows the strongest one."""

    estimator: str
    frequency_hz: float
    amplitude_m: float
    amplitude_uncertainty_m: float
    phase_rad: float
    phase_uncertainty_rad: float


@dataclass(frozen=True, slots=True)
class RunEntry:
    """One run file of a folder; ``date``: start of the run, or else the file's time of modification.

    ``imported``: name of the recording from which the records were imported, "" if they were measured.
    ``shots_marked_bad``: shots that results leave out; ``lead`` is None if the latest result has other shots.
    ``conditions``: mean over the readings of the run, by name with the unit.
    """

    path: Path
    date: datetime
    title: str
    status: str
    shots_complete: int
    shots: int
    simulated: bool
    imported: str
    user: str
    host: str
    notes: Mapping[str, Any]
    lead: Harmonic | None
    shots_marked_bad: int = 0
    conditions: Mapping[str, float] = field(default_factory=dict)

    def as_dict(self) -> dict[str, Any]:
        """Return the entry of a run in ``hpe-rig list --json``, as JSON values."""
        names = ("title", "status", "shots_complete", "shots", "simulated", "imported", "user", "host")
        fields = {name: getattr(self, name) for name in (*names, "shots_marked_bad")}
        lead = self.lead and {name: _finite(value) for name, value in asdict(self.lead).items()}
        notes = {name: note if isinstance(note, str | int | float) else str(note) for name, note in self.notes.items()}
        conditions = {name: _finite(value) for name, value in self.conditions.items()}
        date = self.date.isoformat(timespec="seconds")
        return {"date": date, "file": str(self.path), **fields, "lead": lead, "notes": notes, "conditions": conditions}

    def words(self) -> str:
        """Return the text that ``hpe-rig list`` searches for words, one item per line."""
        kind = "imported" if self.imported else "simulated" if self.simulated else "measured"
        notes = [f"{name}: {note}" for name, note in self.notes.items()]
        return "\n".join([self.path.name, self.title, self.status, kind, self.imported, self.user, self.host, *notes])


def listing_schema() -> dict[str, Any]:
    """Return the JSON schema of ``hpe-rig list --json``."""
    note = {"type": ["string", "number", "boolean"]}
    entry = dataclass_schema(RunEntry, file={"type": "string"}, notes={"type": "object", "additionalProperties": note})
    del entry["properties"]["path"]
    entry["required"] = list(entry["properties"])
    return titled("Listing of hpe-rig", {"type": "array", "items": entry})


def list_runs(folder: Path, below: bool = False) -> tuple[list[RunEntry], list[str]]:
    """Return the runs in ``folder``, sorted by date, and a message for each unreadable file.

    ``below``: also runs in subfolders. Result files and files of other programs are skipped. Raises ``StoreError`` if
    ``folder`` is not a folder.
    """
    if not folder.is_dir():
        raise StoreError(f"{folder} is no folder. Try: the folder that holds the run files.")
    entries, unreadable = list[RunEntry](), list[str]()
    for path in sorted(folder.rglob("*.h5") if below else folder.glob("*.h5")):
        if kind_of(path) in ("run", None):
            try:
                entries.append(_entry(read_run(path)))
            except (StoreError, OSError) as error:
                unreadable.append(str(error))
    return sorted(entries, key=lambda entry: entry.date), unreadable


def results_of_other_runs(run: Path) -> list[Path]:
    """Return the result files beside the run file ``run`` that are of another run, such as one that it replaced."""
    digest = read_run(run).digest.encode()
    return [path for path in _results_beside(run) if _run_digest(path) not in (b"", digest)]


def _results_beside(run: Path) -> list[Path]:
    return [path for path in run.parent.glob(f"{glob.escape(run.stem)}.*.h5") if kind_of(path) == "result"]


def _run_digest(result: Path) -> bytes:
    """Return the digest of a result's run; empty for one of an earlier release, or one that cannot be read."""
    try:
        with open_bounded(result) as file:
            return bytes(file.attrs.get("run_digest", b""))
    except (OSError, KeyError, ValueError, TypeError, RuntimeError, InvalidContentError):
        return b""


def matching_runs(
    entries: Sequence[RunEntry], words: Sequence[str], since: datetime | None = None, until: datetime | None = None
) -> list[RunEntry]:
    """Return the entries from ``since`` to ``until`` that contain all ``words``, ignoring case."""
    return [
        entry
        for entry in entries
        if all(word.casefold() in entry.words().casefold() for word in words)
        and (since is None or entry.date >= since)
        and (until is None or entry.date <= until)
    ]


def _entry(stored: StoredRun) -> RunEntry:
    """Return the entry of a run in the list of runs, with the strongest harmonic of its latest result."""
    scene, bench = _parsed(stored.scene_toml, stored.scene_name), _parsed(stored.bench_toml, stored.bench_name)
    notes = scene.get("notes")
    return RunEntry(
        path=stored.path,
        date=_date(stored),
        title=str(scene.get("title", stored.scene_name)),
        status=stored.status,
        shots_complete=int(stored.shot_complete.sum()),
        shots=stored.shot_complete.size,
        simulated=stored.simulated,
        imported=_source(bench),
        user=stored.provenance.user,
        host=stored.provenance.host,
        notes=notes if isinstance(notes, dict) else {},
        # Strongest harmonic of the latest result.
        lead=_lead(stored),
        shots_marked_bad=len(stored.marks),
        conditions=_mean_conditions(stored, bench),
    )


def _mean_conditions(stored: StoredRun, bench: Mapping[str, Any]) -> dict[str, float]:
    """Return the mean of each condition that was read, by its name with the unit in the tables of the bench file."""
    entries = bench.get("conditions")
    tables = [entry for entry in entries if isinstance(entry, dict)] if isinstance(entries, list) else []
    units = {entry.get("name"): entry.get("unit", "") for entry in tables}
    finite = {name: values[np.isfinite(values)] for name, values in stored.conditions.items()}
    return {
        f"{name} {units.get(name, '')}".strip(): float(values.mean()) for name, values in finite.items() if values.size
    }


def _finite(value: Any) -> Any:
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _source(bench: Mapping[str, Any]) -> str:
    """Return the name of the imported recording in the tables of a bench file, "" for a measured or simulated run."""
    recording = bench.get("recording")
    return str(recording.get("source", "")) if isinstance(recording, dict) else ""


def _parsed(text: str, name: str) -> Mapping[str, Any]:
    """Return the tables of a scene or bench file from its TOML ``text``; no tables if it cannot be parsed."""
    try:
        return parse_toml(text, name)
    except SettingsError:
        return {}


def _date(stored: StoredRun) -> datetime:
    """Return the start of the run, or the file's time of modification if the run does not state it."""
    try:
        return datetime.fromisoformat(stored.provenance.started).astimezone()
    except ValueError:
        return datetime.fromtimestamp(stored.path.stat().st_mtime).astimezone()


def _lead(stored: StoredRun) -> Harmonic | None:
    """Return the strongest harmonic of the latest result of a run; None without a result.

    Also None if that result is of an earlier run of the same file name, or if shots were marked bad, or unmarked, after
    it. Raises ``StoreError`` if that result file cannot be read.
    """
    run = stored.path
    latest = max(_results_beside(run), key=lambda path: path.stat().st_mtime, default=None)
    if latest is None:
        return None
    try:
        with open_bounded(latest) as file:
            text = file["json"]
            if ATTRIBUTE in text.attrs and not CheckedFile(file).matches_checksum("json", text):
                raise InvalidContentError("it fails its checksum")
            result = json.loads(text.asstr()[()]) if text.dtype.itemsize <= MAX_JSON_BYTES else {}
            is_earlier = file.attrs.get("version", 1) < RESULT_VERSION
            # Results of earlier releases do not state their run.
            is_of_run = file.attrs.get("run_digest", b"") in (b"", stored.digest.encode())
        left_out = result.get("shots_without_result", ())
        counted_from = 0 if is_earlier else 1
        marks = {int(shot) - counted_from: why for shot, why in left_out if why.startswith(MARKED_BAD)}
        if not is_of_run or marks != stored.marks:
            # It is of an earlier run, or marks were given or taken back after it.
            return None
        return max(_harmonics(result, is_earlier), key=lambda harmonic: harmonic.amplitude_m, default=None)
    except InvalidContentError as error:
        why = str(error)
    except (OSError, KeyError, ValueError, TypeError, RuntimeError, AttributeError, ArithmeticError) as error:
        why = reason(error)
    raise StoreError(f"{latest} is no readable result file ({why}). Try: hpe-rig process {run}.")


def _harmonics(result: Mapping[str, Any], is_earlier: bool) -> Iterator[Harmonic]:
    """Yield the harmonics of a result, given as its parsed JSON: of the means over repeats, or else of trusted shots.

    Incomplete shots count only if there are no others. A value that is null in the JSON is NaN. In an earlier version
    (``is_earlier``) an estimate with a corrected value calls its values by ``EARLIER_NAMES``.
    """
    estimator, means = str(result["estimator"]), result.get("means", ())
    trusted = [shot for shot in result["shots"] if not shot.get("untrusted")]
    shots = [shot for shot in trusted if shot.get("complete", True)] or trusted
    for estimate in means or [estimate for shot in shots for estimate in shot["estimates"]]:
        has_earlier_names = is_earlier and estimate.get("corrected_amplitude_m") is not None
        values = {name: estimate[old if has_earlier_names else name] for name, old in EARLIER_NAMES.items()}
        numbers = {name: math.nan if value is None else float(value) for name, value in values.items()}
        yield Harmonic(estimator=estimator, frequency_hz=float(estimate["frequency_hz"]), **numbers)
