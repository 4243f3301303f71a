"""Content of a run file, read shot by shot when asked for, also while the run goes on.

Nothing is taken for what was measured unless its checksum says so: a record whose bytes or whose mark fail theirs
counts as missing, and as damaged. Files from before there were checksums are read as they are, but for chunks that they
do not hold.
"""

from __future__ import annotations

import json
import math
import tempfile
import time
import weakref
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, final, overload

import h5py
import numpy as np
from numpy.typing import NDArray

from drivers.interfaces import Setting
from hpe_rig.arrays import BoolArray, FloatArray, Int16Array
from hpe_rig.plan import Plan
from hpe_rig.result import UNKNOWN, Provenance
from hpe_rig.store.checksum import BY_SHOT, GROUP, blank, digest, stored_bytes
from hpe_rig.store.format import (
    MOST_STAGES,
    SNAPSHOT_BYTES,
    STAGE_BYTES,
    STATUSES,
    TIME_BYTES,
    UNTRUSTED_BYTES,
    StoreError,
)
from hpe_rig.store.layout import TRUE_HARMONICS, volts_of_codes
from hpe_rig.store.records import MISSING, GatedRecords, ShotRecords, with_margin
from hpe_rig.store.validation import Trusted, UntrustedError, trusted

Shape = tuple[int, int, int]
CODE_LIMITS_UNSTATED: Final = (-8192, 8191)
"""Lowest and highest code in files from before these were written: the 14 bits of the only digitizer then."""
MOST_UNHELD_BYTES: Final = 256_000_000
"""Most memory that a shot may take beyond what the file holds, for records that never came."""
MOST_SHOTS: Final = 1_000_000
LOOKS: Final = 3
"""How often a chunk of a run that goes on is read before it counts as damaged: it may be in the middle of a change."""
LOOK_PAUSE_S: Final = 0.02
MOST_HELD_SAMPLES: Final = 1 << 25
"""Samples up to which the records of a shot are read at once; those of a longer one stay in the file."""
MOST_AT_ONCE: Final = 1 << 22
"""Samples of a shot that are compared with their checksums at a time."""
MOST_COPIED_BYTES: Final = 1 << 30
"""Most of a long shot that is kept in a temporary file once it was compared; of more the run file is read again."""


@dataclass(frozen=True, slots=True)
class StoredShot:
    """Records of one shot that stay in the file, see `GatedRecords`; of each the samples ``around`` its gate.

    ``copy`` holds these samples of every record, where there is room for them.
    """

    path: Path
    name: str
    shot: int
    around: slice
    valid: BoolArray
    volts_per_code: float
    code_limits: tuple[int, int]
    margin: tuple[int, int]
    damaged: BoolArray
    copy: CodesCopy | None = None

    @property
    def shape(self) -> tuple[int, int]:
        """Numbers of pulses and of samples."""
        return self.valid.size, self.around.stop - self.around.start

    def block(self, pulses: slice) -> Int16Array:
        """Return the codes of some ``pulses``, (pulse, sample); they were compared with their checksums before."""
        codes: Int16Array
        if self.copy is not None and self.copy.whole:
            codes = self.copy.block(*pulses.indices(self.valid.size)[:2])
        else:
            with trusted(self.path) as trust:
                echo = trust.dataset(f"records/{self.name}", "<i2", (None, self.valid.size, None))
                codes = echo[self.shot, pulses, self.around]
        codes[~self.valid[pulses]] = MISSING
        return codes


@final
class CodesCopy:
    """Codes of records of so many ``samples`` in a temporary file; ``whole`` is False where its disk had no room."""

    def __init__(self, samples: int) -> None:
        self._samples, self.whole = samples, True
        try:
            self._file = tempfile.TemporaryFile()  # noqa: SIM115
        except OSError:
            self.whole = False
        else:
            # And so removed, with the last of those who may read it.
            weakref.finalize(self, self._file.close)

    def add(self, codes: Int16Array) -> None:
        """Append the next records, (pulse, sample)."""
        if self.whole:
            try:
                self._file.write(np.ascontiguousarray(codes).data)
                self._file.flush()
            except OSError:
                self.whole = False
                with suppress(OSError):
                    self._file.close()

    def block(self, first: int, last: int) -> Int16Array:
        """Return the codes of the records from ``first`` to before ``last``, (pulse, sample)."""
        codes = np.empty((max(0, last - first), self._samples), np.int16)
        self._file.seek(2 * first * self._samples)
        if self._file.readinto(codes.data) != codes.nbytes:
            raise StoreError(
                "records of a long shot, copied to a temporary file, cannot be read back: another program has cut it. "
                "Try: again, and leave the folder of temporary files alone meanwhile."
            )
        return codes


@dataclass(frozen=True, slots=True)
class StoredRecords(Sequence[ShotRecords]):
    """Records of every shot, (shot,), each read when asked for, as the file has it by then."""

    path: Path
    shape: Shape

    def __len__(self) -> int:
        return self.shape[0]

    @overload
    def __getitem__(self, shot: int) -> ShotRecords: ...

    @overload
    def __getitem__(self, shot: slice) -> tuple[ShotRecords, ...]: ...

    def __getitem__(self, shot: int | slice) -> ShotRecords | tuple[ShotRecords, ...]:
        if isinstance(shot, slice):
            return tuple(self[index] for index in range(*shot.indices(len(self))))
        return self.gated(shot, slice(0, self.shape[2]))

    def monitor(self, shot: int) -> ShotRecords | None:
        """Return the records of ``shot`` at the monitor input, (pulse, sample), or None where it was not recorded."""
        with trusted(self.path) as trust:
            if not trust.has("records/monitor"):
                return None
        return self.gated(shot, slice(0, self.shape[2]), "monitor")

    def gated(self, shot: int, gate: slice, name: str = "echo", margin: int = 0) -> ShotRecords:
        """Return the samples in ``gate`` and up to ``margin`` around it of each record of ``shot``, (pulse, sample)."""
        for look in range(LOOKS):
            with trusted(self.path) as trust:
                stored, offset, arrival = self._of_shot(trust, shot, gate, name, margin)
                echo = _echo(trust, self.shape, name)
                codes, damaged = _codes(trust, echo, f"records/{name}", stored.shot, arrival, stored.around)
                going_on = trust.attribute("status", str) == STATUSES[0]
            if not (damaged.any() and going_on) or look == LOOKS - 1:
                break
            time.sleep(LOOK_PAUSE_S)
        time_s = np.where(arrival.recorded & ~damaged, arrival.trigger_time_s, np.nan)
        return ShotRecords(codes, time_s, stored.volts_per_code, offset, stored.code_limits, stored.margin, damaged)

    def in_blocks(
        self,
        shot: int,
        gate: slice,
        margin: int,
        most_held: int = MOST_HELD_SAMPLES,
        look: Callable[[Int16Array], None] | None = None,
    ) -> GatedRecords:
        """Return what ``gated`` does; of more samples than ``most_held`` the codes stay in the file until asked for.

        All of these are read once to compare them with their checksums: ``look`` is given those in the gate meanwhile,
        some pulses after the other, and those in and around it are kept in a temporary file.
        """
        if self.shape[1] * (gate.stop - gate.start + 2 * margin) <= most_held:
            return self.gated(shot, gate, margin=margin)
        with trusted(self.path) as trust:
            stored, _, _ = self._of_shot(trust, shot, gate, "echo", margin)
        pulses, samples = stored.shape
        inside = slice(stored.margin[0], samples - stored.margin[1])
        copy = CodesCopy(samples) if 2 * pulses * samples <= MOST_COPIED_BYTES else None

        def see(codes: Int16Array) -> None:
            if copy is not None:
                copy.add(codes)
            if look is not None:
                look(codes[:, inside])

        damaged = self.damaged(stored.shot, look=see, samples=stored.around)
        return replace(stored, valid=stored.valid & ~damaged, damaged=damaged, copy=copy)

    def _of_shot(
        self, trust: Trusted, shot: int, gate: slice, name: str, margin: int
    ) -> tuple[StoredShot, float, _Arrival]:
        """Return the records of ``shot`` whose marks are sound, their offset in volts and when they came."""
        shot = _within(shot, self.shape[0])
        if not 0 <= gate.start < gate.stop <= self.shape[2]:
            raise StoreError(
                f"{self.path}: the gate takes samples {gate.start} to {gate.stop}, a record has {self.shape[2]}. "
                "Try: a run whose scene passes hpe-rig check."
            )
        around, margins = with_margin(gate, margin, self.shape[2])
        arrival = _arrival(trust, self.shape, shot)
        _refuse_unheld(_echo(trust, self.shape, name), arrival.recorded, self.shape, around.stop - around.start)
        scale, offset = (trust.attribute(key, float, f"records/{name}") for key in ("scale_factor", "add_offset"))
        limits = _code_limits(trust, f"records/{name}")
        sound = arrival.recorded
        return (
            StoredShot(self.path, name, shot, around, sound, scale, limits, margins, arrival.damaged),
            offset,
            arrival,
        )

    def chunks(self, shot: int, pulses: int, name: str = "echo") -> Iterator[tuple[int, Int16Array]]:
        """Yield the codes of ``shot`` as (first pulse, codes) in steps of ``pulses``, opening the file once.

        Raises ``StoreError`` where one of its records is damaged.
        """
        with trusted(self.path) as trust:
            echo, arrival = _echo(trust, self.shape, name), _arrival(trust, self.shape, shot)
            for first in range(0, self.shape[1], pulses):
                rows = slice(first, first + pulses)
                codes, damaged = _codes(trust, echo, f"records/{name}", shot, arrival, slice(0, self.shape[2]), rows)
                if damaged.any():
                    raise UntrustedError(f"shot {shot + 1} has records that fail their checksums")
                yield first, codes

    def damaged(
        self,
        shot: int,
        pulses: int = 4096,
        look: Callable[[Int16Array], None] | None = None,
        samples: slice = slice(0, 0),
    ) -> BoolArray:
        """Return which records of ``shot`` are damaged at any input, (pulse,), holding at most ``pulses`` of them.

        ``look`` is given the codes of some ``samples`` of all echoes (pulse, sample), some pulses after the other.
        """
        with trusted(self.path) as trust:
            arrival = _arrival(trust, self.shape, shot)
            found = arrival.damaged.copy()
            for name in ("echo", *(["monitor"] if trust.has("records/monitor") else [])):
                echo = _echo(trust, self.shape, name)
                at_once = min(pulses, MOST_AT_ONCE // self.shape[2])
                step = max(1, at_once // echo.chunks[1]) * echo.chunks[1]
                for first in range(0, self.shape[1], step):
                    rows = slice(first, first + step)
                    codes, damaged = _codes(trust, echo, f"records/{name}", shot, arrival, samples, rows)
                    found[rows] |= damaged
                    if look is not None and name == "echo":
                        look(codes)
        return found

    def recorded(self, shot: int) -> BoolArray:
        """Return which records of ``shot`` are marked as there, (pulse,); their echoes may yet prove damaged."""
        with trusted(self.path) as trust:
            return _arrival(trust, self.shape, shot).recorded

    def unvouched(self, shot: int) -> BoolArray:
        """Return which records of ``shot`` are marked as there without a checksum of the mark, (pulse,)."""
        with trusted(self.path) as trust:
            marked: BoolArray = _rows(trust, "records/recorded", self.shape, "u1")[shot] == 1
            arrival = _arrival(trust, self.shape, shot)
            return marked & ~arrival.recorded & ~arrival.damaged


@dataclass(frozen=True, slots=True)
class StoredGroundTruth:
    """True displacement of every shot, float64 (pulse,) in m, each read when asked for."""

    path: Path
    shape: Shape

    def __getitem__(self, shot: int) -> FloatArray:
        name = "truth/displacement_m"
        with trusted(self.path) as trust:
            row_m: FloatArray
            row_m, _ = _row(trust, name, _rows(trust, name, self.shape), _within(shot, self.shape[0]))
            return row_m

    def harmonics_m(self, shot: int, frequencies: int) -> FloatArray:
        """Return A cos(phase) and A sin(phase) of the true displacement at the wanted frequencies, (frequency, 2)."""
        shape, shot = (self.shape[0], None), _within(shot, self.shape[0])
        with trusted(self.path) as trust:
            names = [f"true_harmonics/{name}" for name in TRUE_HARMONICS]
            rows = [_row(trust, name, trust.dataset(name, "<f8", shape), shot)[0] for name in names]
            if rows[0].size < frequencies:
                raise UntrustedError(f"/true_harmonics has {rows[0].size} frequencies, its scene {frequencies}")
            return np.stack(rows, axis=-1)[:frequencies]


@dataclass(frozen=True, slots=True)
class ShotRows:
    """Everything of one shot but its echoes: which records came, (pulse,), when, and the rows of the other datasets."""

    recorded: BoolArray
    trigger_time_s: FloatArray
    tables: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class StoredRun:
    """Content of a run file; ``true_displacement_m``, (pulse,) for each shot, is None for a real bench.

    ``shot_complete`` (shot,) tells which shots are complete. ``clipped`` lists the shots during which the digitizer's
    input left its range, ``untrusted`` says why a shot is not to be trusted. ``predecessor`` names the run that this
    one continued, "" where there is none. ``run_time_s`` is the wall time of the acquisition by stage, empty where it
    was not measured. ``force_set`` (shot,) is the force over F_0 as the toneburst generator was read back to hold it,
    NaN where nothing pushes, nothing was set or the file does not say. ``damage`` says what of the file but its echoes
    cannot be trusted, and what stands for it; ``vouched`` whether the file has checksums at all. ``provenance`` is
    empty in files of earlier releases and of scripts that leave it out. ``scan_sha256`` is that of the file that
    ``beams.excitation_scan`` named, "" where it named none or the file does not say.
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
    vouched: bool
    run_id: str
    provenance: Provenance
    scan_sha256: str

    def rows(self, shot: int) -> ShotRows:
        """Return everything of ``shot`` but its echoes; blank where the file has nothing that can be trusted."""
        shape = self.records.shape
        with trusted(self.path) as trust:
            arrival = _arrival(trust, shape, shot)
            named = [(name, dataset) for name, dataset in _tables(trust, shape) if not name.endswith("shot_complete")]
            tables = {name: _row(trust, name, dataset, shot)[0] for name, dataset in named}
        return ShotRows(arrival.recorded, arrival.trigger_time_s, tables)

    def is_sound(self, shot: int) -> bool:
        """Return whether everything that the file holds of ``shot`` is as its checksums say; reads all of it."""
        return not damage_by_shot(self, shot) and not self.records.damaged(shot).any()

    def refuse_unlike(self, plan: Plan) -> None:
        """Raise ``StoreError`` where the records do not fit ``plan``: the file was changed, or its scene."""
        capture = plan.shots[0].capture
        planned = (len(plan.shots), capture.record_count, capture.record_samples)
        if planned != self.records.shape:
            raise StoreError(
                f"{self.path} holds (shot, pulse, sample) = {self.records.shape}, its scene asks for {planned}. "
                "It was changed. Try: an untouched copy."
            )
        for shot, force in zip(plan.shots, self.force_set, strict=True):
            # What an instrument rounds is some per cent of its least amplitude, and far less above it.
            if np.isfinite(force) and not math.isclose(force, shot.force_fraction or 0.0, rel_tol=0.1):
                raise StoreError(
                    f"{self.path} has a force of {force:g} F_0 in shot {shot.index + 1}, its scene asks for "
                    f"{shot.force_fraction or 0.0:g}. It was changed. Try: an untouched copy."
                )
        with trusted(self.path) as trust:
            stored = tuple(trust.attribute(name, float, "records/echo") for name in ("scale_factor", "add_offset"))
            expected = volts_of_codes(capture.input_range_v, _code_limits(trust, "records/echo"))
        if not np.allclose(stored, expected, rtol=1e-9, atol=0):
            raise StoreError(
                f"{self.path} has {stored[0]:g} V per code, its scene's input range of {capture.input_range_v:g} V "
                f"gives {expected[0]:g}. It was changed. Try: an untouched copy."
            )


def read_run(path: Path) -> StoredRun:
    """Return the run in ``path``, also one that goes on or was killed; raise ``StoreError`` if it is not a run file."""
    with trusted(path) as trust:
        return _stored_run(trust, path)


def read_snapshots(path: Path) -> tuple[Mapping[str, Mapping[str, Setting]], ...]:
    """Return the settings of each acquired shot as read back, by role; raise ``StoreError`` as ``read_run`` does."""
    with trusted(path) as trust:
        dataset = trust.dataset("snapshot", f"S{SNAPSHOT_BYTES}", (None,))
        texts = [_row(trust, "snapshot", dataset, shot)[0].item() for shot in range(dataset.shape[0])]
        return tuple(_settings(text) for text in texts if text)


def _settings(text: bytes) -> Mapping[str, Mapping[str, Setting]]:
    try:
        roles = json.loads(text)
    except (ValueError, RecursionError):
        raise UntrustedError("a shot's settings are not JSON") from None
    if not isinstance(roles, dict) or not all(isinstance(values, dict) for values in roles.values()):
        raise UntrustedError("a shot's settings are not listed by role")
    if not all(isinstance(value, str | int | float) for values in roles.values() for value in values.values()):
        raise UntrustedError("a setting is not a single value")
    return roles


def _stored_run(trust: Trusted, path: Path) -> StoredRun:
    echo = trust.dataset("records/echo", "<i2", (None, None, None))
    shape: Shape = echo.shape
    if min(shape) < 1 or shape[0] > MOST_SHOTS:
        raise UntrustedError(f"/records/echo has shape {shape}")
    _echo(trust, shape)
    for name, dtype in (("recorded", "u1"), ("trigger_time_s", "<f8"), ("pulse_onset_s", "<f8")):
        _rows(trust, f"records/{name}", shape, dtype)
    simulated = trust.attribute("simulated", bool)
    if simulated:
        _rows(trust, "truth/displacement_m", shape)
    status = trust.attribute("status", str)
    if status not in STATUSES:
        raise UntrustedError(f"its status is {status!r}")
    flags, damage = {}, list[str]()
    for name, instead in (("shot_complete", "does not count as complete"), ("clipped", "may have been clipped")):
        dataset = trust.dataset(f"records/{name}", "u1", shape[:1])
        values, sound = _all_rows(trust, f"records/{name}", dataset)
        flags[name] = values == 1
        damage += [
            f"shot {shot + 1}: /records/{name} fails its checksum: the shot {instead}"
            for shot in np.flatnonzero(~sound)
        ]
    run_time_s, times_sound = _run_time_s(trust)
    damage += [] if times_sound else ["/run_time fails its checksum: the run times are left out"]
    provenance, end_sound = _provenance(trust)
    damage += [] if end_sound else ["/provenance/ended fails its checksum: when the run ended is left out"]
    damage += _damaged_truth(trust, shape) if simulated else []
    if trust.missing_bytes:
        damage.insert(0, f"the file is cut short: {trust.missing_bytes} bytes are missing at its end")
    return StoredRun(
        path=path,
        scene_name=trust.attribute("scene_name", str),
        scene_toml=trust.text("scene"),
        bench_name=trust.attribute("bench_name", str),
        bench_toml=trust.text("bench"),
        simulated=simulated,
        status=status,
        records=StoredRecords(path, shape),
        true_displacement_m=StoredGroundTruth(path, shape) if simulated else None,
        shot_complete=flags["shot_complete"],
        clipped=tuple(int(shot) for shot in np.flatnonzero(flags["clipped"])),
        predecessor=trust.attribute("predecessor", str),
        run_time_s=run_time_s,
        force_set=_force_set(trust, shape[0]),
        untrusted=_untrusted_shots(trust, shape),
        damage=tuple(damage),
        vouched=trust.vouched,
        run_id=trust.attribute("run_id", str) if "run_id" in trust.file.attrs else "",
        provenance=provenance,
        scan_sha256=trust.attribute("scan_sha256", str) if "scan_sha256" in trust.file.attrs else "",
    )


def _force_set(trust: Trusted, shots: int) -> FloatArray:
    if not trust.has("records/force_set"):
        # Files from before it was asked what the generator holds.
        return np.full(shots, np.nan)
    return _all_rows(trust, "records/force_set", trust.dataset("records/force_set", "<f8", (shots,)))[0]


def _untrusted_shots(trust: Trusted, shape: Shape) -> dict[int, str]:
    if not trust.has("untrusted"):
        # Files from before settings were read back after a shot.
        return {}
    dataset = trust.dataset("untrusted", f"S{UNTRUSTED_BYTES}", shape[:1])
    unknown = b"whether it is cannot be told, /untrusted is damaged"
    texts = [text if sound else unknown for text, sound in zip(*_all_rows(trust, "untrusted", dataset), strict=True)]
    return {shot: text.decode("ascii", "replace") for shot, text in enumerate(texts) if text}


def _run_time_s(trust: Trusted) -> tuple[dict[str, float], bool]:
    """Return the run times by stage, and whether they are sound."""
    if not trust.has("run_time"):
        # The earliest run files of this version have none.
        return {}, True
    names = trust.dataset("run_time/stage", f"S{STAGE_BYTES}", (None,))
    if names.shape[0] > MOST_STAGES:
        raise UntrustedError(f"/run_time has {names.shape[0]} stages")
    trust.refuse_damaged("run_time/stage", names)
    times_s, sound = _row(trust, "run_time/run_time_s", trust.dataset("run_time/run_time_s", "<f8", names.shape), None)
    stages = [name.decode("ascii", "replace") for name in names[()]]
    pairs = zip(stages, times_s, strict=True)
    return {stage: float(time_s) for stage, time_s in pairs if stage.isprintable() and 0 <= time_s < math.inf}, sound


def _provenance(trust: Trusted) -> tuple[Provenance, bool]:
    """Return who measured where and when, and whether the time of the end is sound."""
    if not trust.has("provenance"):
        return UNKNOWN, True
    texts = {name: trust.text(f"provenance/{name}") for name in ("started", "host", "user", "drivers")}
    ended, sound = _row(trust, "provenance/ended", trust.dataset("provenance/ended", f"S{TIME_BYTES}", ()), None)
    text = ended.item().decode("ascii", "replace")
    return Provenance(**texts, ended=text if text.isprintable() else ""), sound


def _damaged_truth(trust: Trusted, shape: Shape) -> Iterator[str]:
    for name, dataset in _tables(trust, shape):
        if name.startswith("tru"):
            for shot in np.flatnonzero(~_all_rows(trust, name, dataset)[1]):
                yield f"shot {shot + 1}: /{name} fails its checksum: its truth is left out"


def damage_by_shot(stored: StoredRun, shot: int) -> tuple[str, ...]:
    """Return what of ``shot`` but its records fails its checksum."""
    with trusted(stored.path) as trust:
        tables = _tables(trust, stored.records.shape)
        return tuple(f"/{name} fails its checksum" for name, of in tables if not _row(trust, name, of, shot)[1])


def _tables(trust: Trusted, shape: Shape) -> Iterator[tuple[str, h5py.Dataset]]:
    """Yield name and dataset of everything that has a row a shot and is no record."""
    kinds: dict[str, tuple[str, tuple[int | None, ...]]] = {
        "snapshot": (f"S{SNAPSHOT_BYTES}", shape[:1]),
        "untrusted": (f"S{UNTRUSTED_BYTES}", shape[:1]),
        "records/shot_complete": ("u1", shape[:1]),
        "records/clipped": ("u1", shape[:1]),
        "records/force_set": ("<f8", shape[:1]),
        "records/pulse_onset_s": ("<f8", shape[:2]),
        "truth/displacement_m": ("<f8", shape[:2]),
    }
    for name in BY_SHOT:
        dtype, expected = kinds.get(name, ("<f8", (shape[0], None)))
        if trust.has(name):
            yield name, trust.dataset(name, dtype, expected)


def _row(trust: Trusted, name: str, dataset: h5py.Dataset, row: int | None) -> tuple[Any, bool]:
    """Return row ``row`` of a dataset, None for all of it, blank where none was written, and whether it is sound."""
    place = () if row is None else (row,)
    values = np.asarray(dataset[place], dataset.dtype)
    if not trust.vouched:
        return values, True
    expected = int(trust.dataset(f"{GROUP}/{name}", "<u8", dataset.shape[: len(place)])[place])
    sound = expected in (0, digest(name, place, stored_bytes(values, dataset.dtype)))
    return (values if expected and sound else blank(dataset.dtype, values.shape)), sound


def _all_rows(trust: Trusted, name: str, dataset: h5py.Dataset) -> tuple[NDArray[Any], BoolArray]:
    """Return every row of a dataset, blank where none was written or it cannot be trusted, and which are sound."""
    values: NDArray[Any] = dataset[()]
    if not trust.vouched:
        return values, np.ones(values.shape[0], bool)
    expected = trust.dataset(f"{GROUP}/{name}", "<u8", dataset.shape[:1])[()].tolist()
    found = [digest(name, (row,), stored_bytes(of_row, dataset.dtype)) for row, of_row in enumerate(values)]
    sound = np.array([one in (0, other) for one, other in zip(expected, found, strict=True)], bool)
    unwritten = np.array(expected) == 0
    values[unwritten | ~sound] = blank(dataset.dtype, ())
    return values, sound


@dataclass(frozen=True, slots=True)
class _Arrival:
    """Which records of a shot are in the file, when they were triggered, and of which this cannot be told; (pulse,)."""

    recorded: BoolArray
    trigger_time_s: FloatArray
    damaged: BoolArray


def _arrival(trust: Trusted, shape: Shape, shot: int) -> _Arrival:
    marks = _rows(trust, "records/recorded", shape, "u1")[shot]
    time_s = _rows(trust, "records/trigger_time_s", shape)[shot]
    recorded, damaged = marks == 1, np.zeros(shape[1], bool)
    if trust.vouched:
        name, size = "records/recorded", trust.file["records/echo"].chunks[1]
        for number, expected in enumerate(_sums(trust, name, shape, size)[shot]):
            rows = slice(number * size, (number + 1) * size)
            if not expected:
                # Its writer was killed before it came to vouch for them.
                recorded[rows] = False
            elif digest(name, (shot, number), marks[rows].tobytes(), time_s[rows].tobytes()) != expected:
                recorded[rows], damaged[rows] = False, True
    return _Arrival(recorded, np.where(recorded, time_s, np.nan), damaged)


def _sums(trust: Trusted, name: str, shape: Shape, rows: int) -> h5py.Dataset:
    return trust.dataset(f"{GROUP}/{name}", "<u8", (shape[0], -(-shape[1] // rows)))


def _codes(
    trust: Trusted,
    echo: h5py.Dataset,
    name: str,
    shot: int,
    arrival: _Arrival,
    samples: slice,
    rows: slice | None = None,
) -> tuple[Int16Array, BoolArray]:
    """Return the codes of ``samples`` of the records ``rows``, (pulse, sample), and which are damaged, (pulse,).

    Chunk by chunk, each checked before it is decompressed. A file that has no checksums may be of any chunks.
    """
    whole = slice(0, echo.shape[1]) if rows is None else slice(rows.start, min(rows.stop, echo.shape[1]))
    recorded, damaged = arrival.recorded[whole], arrival.damaged[whole].copy()
    size: int = echo.chunks[1]
    if not trust.vouched and (echo.chunks[0] != 1 or echo.chunks[2] != echo.shape[2]):
        codes = echo[shot, whole, samples]
        codes[~recorded] = MISSING
        return codes, damaged
    codes = np.full((recorded.size, samples.stop - samples.start), MISSING)
    sums = _sums(trust, name, echo.shape, size) if trust.vouched and recorded.any() else None
    for number in range(whole.start // size, -(-whole.stop // size)):
        first, last = max(number * size, whole.start), min((number + 1) * size, whole.stop)
        here = slice(first - whole.start, last - whole.start)
        if recorded[here].any():
            of_chunk = _chunk(trust, echo, name, shot, number, sums)
            if of_chunk is None:
                damaged[here] |= recorded[here]
            else:
                codes[here] = of_chunk[first - number * size : last - number * size, samples]
    codes[~recorded | damaged] = MISSING
    return codes, damaged


def _chunk(
    trust: Trusted, echo: h5py.Dataset, name: str, shot: int, number: int, sums: h5py.Dataset | None
) -> Int16Array | None:
    """Return the codes of chunk ``number`` of a shot, (pulse, sample), None where it is damaged.

    ``sums`` (shot, chunk) is None in a file without checksums.
    """
    rows, plain = echo.chunks[1], echo.id.get_create_plist().get_nfilters() == 0
    first = number * rows
    if sums is None:
        where = echo.id.get_chunk_info_by_coord((shot, first, 0))
        if where.byte_offset is None or where.byte_offset + where.size > trust.size:
            return None
    else:
        try:
            _, stored = echo.id.read_direct_chunk((shot, first, 0))
        except (OSError, RuntimeError, ValueError):
            # It lies where the file has nothing, or nowhere.
            return None
        if digest(name, (shot, number), stored) != int(sums[shot, number]):
            return None
        if plain:
            return np.frombuffer(stored, "<i2").reshape(echo.chunks[1:])
    try:
        codes: Int16Array = echo[shot, first : first + rows]
    except OSError:
        return None
    return codes


def _refuse_unheld(echo: h5py.Dataset, recorded: BoolArray, shape: Shape, samples: int) -> None:
    held, plain = echo.id.get_storage_size(), echo.id.get_create_plist().get_nfilters() == 0
    if plain and int(recorded.sum()) * shape[2] * 2 > held:
        raise UntrustedError(f"{int(recorded.sum())} records are said to be there, in {held} bytes")
    if 2 * shape[1] * samples > held + MOST_UNHELD_BYTES:
        raise UntrustedError(f"it declares {shape[1]} records a shot and holds {held} bytes")


def _echo(trust: Trusted, shape: Shape, name: str = "echo") -> h5py.Dataset:
    echo = trust.dataset(f"records/{name}", "<i2", shape)
    if echo.chunks is None:
        raise UntrustedError(f"/records/{name} is in one piece")
    if trust.vouched and (echo.chunks[0] != 1 or echo.chunks[2] != shape[2]):
        raise UntrustedError(f"/records/{name} has chunks of {echo.chunks}")
    return echo


def _code_limits(trust: Trusted, name: str) -> tuple[int, int]:
    """Return the lowest and the highest code of the records at ``name``."""
    if "valid_min" not in trust.file[name].attrs:
        return CODE_LIMITS_UNSTATED
    lowest, highest = (trust.attribute(key, int, name) for key in ("valid_min", "valid_max"))
    if not MISSING < lowest < highest <= np.iinfo(np.int16).max:
        raise UntrustedError(f"/{name} has codes from {lowest} to {highest}")
    return lowest, highest


def _rows(trust: Trusted, name: str, shape: Shape, dtype: str = "<f8") -> h5py.Dataset:
    return trust.dataset(name, dtype, shape[:2])


def _within(shot: int, shots: int) -> int:
    if not -shots <= shot < shots:
        raise IndexError(f"shot {shot} of {shots}")
    return shot % shots
