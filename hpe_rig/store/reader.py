"""Content of a run file, read shot by shot when asked for, also while the run goes on."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, overload

import h5py
import numpy as np
from numpy.typing import NDArray

from drivers.interfaces import Setting
from hpe_rig.plan import Plan
from hpe_rig.store.format import MOST_STAGES, SNAPSHOT_BYTES, STAGE_BYTES, UNTRUSTED_BYTES, StoreError
from hpe_rig.store.layout import TRUE_HARMONICS, volts_of_codes
from hpe_rig.store.records import MISSING, GatedRecords, ShotRecords, with_margin
from hpe_rig.store.validation import Trusted, UntrustedError, trusted

Shape = tuple[int, int, int]
STATUSES: Final = ("running", "complete", "aborted", "failed")
CODE_LIMITS_UNSTATED: Final = (-8192, 8191)
"""Lowest and highest code in files from before these were written: the 14 bits of the only digitizer then."""
MOST_UNHELD_BYTES: Final = 256_000_000
"""Most memory that a shot may take beyond what the file holds, for records that never came."""
MOST_SHOTS: Final = 1_000_000
MOST_HELD_SAMPLES: Final = 1 << 25
"""Samples up to which the records of a shot are read at once; those of a longer one stay in the file."""


@dataclass(frozen=True, slots=True)
class StoredShot:
    """Records of one shot that stay in the file, see `GatedRecords`; of each the samples ``around`` its gate."""

    path: Path
    name: str
    shot: int
    around: slice
    valid: NDArray[np.bool_]
    volts_per_code: float
    code_limits: tuple[int, int]
    margin: tuple[int, int]

    @property
    def shape(self) -> tuple[int, int]:
        """Numbers of pulses and of samples."""
        return self.valid.size, self.around.stop - self.around.start

    def block(self, pulses: slice) -> NDArray[np.int16]:
        """Return the codes of some ``pulses``, (pulse, sample), as the file has them by now."""
        with trusted(self.path) as trust:
            echo = trust.dataset(f"records/{self.name}", "<i2", (None, self.valid.size, None))
            codes: NDArray[np.int16] = echo[self.shot, pulses, self.around]
        codes[~self.valid[pulses]] = MISSING
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
        with trusted(self.path) as trust:
            stored, offset, trigger_time_s = self._of_shot(trust, shot, gate, name, margin)
            codes = _echo(trust, self.shape, name)[stored.shot, :, stored.around]
        codes[~stored.valid] = MISSING
        time_s = np.where(stored.valid, trigger_time_s, np.nan)
        return ShotRecords(codes, time_s, stored.volts_per_code, offset, stored.code_limits, stored.margin)

    def in_blocks(self, shot: int, gate: slice, margin: int = 0, most_held: int = MOST_HELD_SAMPLES) -> GatedRecords:
        """Return what ``gated`` does; of more samples than ``most_held`` the codes stay in the file until asked for."""
        if self.shape[1] * (gate.stop - gate.start + 2 * margin) <= most_held:
            return self.gated(shot, gate, margin=margin)
        with trusted(self.path) as trust:
            return self._of_shot(trust, shot, gate, "echo", margin)[0]

    def _of_shot(
        self, trust: Trusted, shot: int, gate: slice, name: str, margin: int
    ) -> tuple[StoredShot, float, NDArray[np.float64]]:
        """Return the records of ``shot``, their offset in volts and their triggers' times (pulse,)."""
        shot = _within(shot, self.shape[0])
        if not 0 <= gate.start < gate.stop <= self.shape[2]:
            raise StoreError(
                f"{self.path}: the gate takes samples {gate.start} to {gate.stop}, a record has {self.shape[2]}. "
                "Try: a run whose scene passes hpe-rig check."
            )
        around, margins = with_margin(gate, margin, self.shape[2])
        recorded = self._recorded(trust, _echo(trust, self.shape, name), shot, around.stop - around.start)
        scale, offset = (trust.attribute(key, float, f"records/{name}") for key in ("scale_factor", "add_offset"))
        limits = _code_limits(trust, f"records/{name}")
        trigger_time_s = _rows(trust, "records/trigger_time_s", self.shape)[shot]
        return StoredShot(self.path, name, shot, around, recorded, scale, limits, margins), offset, trigger_time_s

    def chunks(self, shot: int, pulses: int, name: str = "echo") -> Iterator[tuple[int, NDArray[np.int16]]]:
        """Yield the codes of ``shot`` as (first pulse, codes) in steps of ``pulses``, opening the file once."""
        with trusted(self.path) as trust:
            echo = _echo(trust, self.shape, name)
            recorded = _rows(trust, "records/recorded", self.shape, "u1")[shot] == 1
            for first in range(0, self.shape[1], pulses):
                codes = echo[shot, first : first + pulses]
                codes[~recorded[first : first + pulses]] = MISSING
                yield first, codes

    def _recorded(self, trust: Trusted, echo: h5py.Dataset, shot: int, samples: int) -> NDArray[np.bool_]:
        recorded: NDArray[np.bool_] = _rows(trust, "records/recorded", self.shape, "u1")[shot] == 1
        held, plain = echo.id.get_storage_size(), echo.id.get_create_plist().get_nfilters() == 0
        if plain and int(recorded.sum()) * self.shape[2] * 2 > held:
            raise UntrustedError(f"{int(recorded.sum())} records are said to be there, in {held} bytes")
        if 2 * self.shape[1] * samples > held + MOST_UNHELD_BYTES:
            raise UntrustedError(f"it declares {self.shape[1]} records a shot and holds {held} bytes")
        return recorded


@dataclass(frozen=True, slots=True)
class StoredGroundTruth:
    """True displacement of every shot, float64 (pulse,) in m, each read when asked for."""

    path: Path
    shape: Shape

    def __getitem__(self, shot: int) -> NDArray[np.float64]:
        with trusted(self.path) as trust:
            row_m: NDArray[np.float64] = _rows(trust, "truth/displacement_m", self.shape)[_within(shot, self.shape[0])]
            return row_m

    def harmonics_m(self, shot: int, frequencies: int) -> NDArray[np.float64]:
        """Return A cos(phase) and A sin(phase) of the true displacement at the wanted frequencies, (frequency, 2)."""
        shape = (self.shape[0], frequencies)
        with trusted(self.path) as trust:
            names = [f"true_harmonics/{name}" for name in TRUE_HARMONICS]
            rows = [trust.dataset(name, "<f8", shape)[_within(shot, self.shape[0])] for name in names]
            return np.stack(rows, axis=-1)


@dataclass(frozen=True, slots=True)
class StoredRun:
    """Content of a run file; ``true_displacement_m``, (pulse,) for each shot, is None for a real bench.

    ``shot_complete`` (shot,) tells which shots are complete. ``clipped`` lists the shots during which the digitizer's
    input left its range, ``untrusted`` says why a shot is not to be trusted. ``predecessor`` names the run that this
    one continued, "" where there is none. ``run_time_s`` is the wall time of the acquisition by stage, empty where it
    was not measured.
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
    shot_complete: NDArray[np.bool_]
    clipped: tuple[int, ...]
    predecessor: str
    run_time_s: Mapping[str, float]
    untrusted: Mapping[int, str] = field(default_factory=dict)

    def rows(self, shot: int) -> dict[str, Any]:
        """Return everything of ``shot`` but its echoes, keyed by the path of the dataset in the file."""
        shape = self.records.shape
        with trusted(self.path) as trust:
            rows = {
                "snapshot": trust.dataset("snapshot", f"S{SNAPSHOT_BYTES}", (shape[0],))[shot],
                "records/clipped": trust.dataset("records/clipped", "u1", (shape[0],))[shot],
                "records/recorded": _rows(trust, "records/recorded", shape, "u1")[shot],
            }
            if trust.has("untrusted"):
                rows["untrusted"] = _untrusted(trust, shape)[shot]
            names = ["records/trigger_time_s", "records/pulse_onset_s"]
            names += ["truth/displacement_m"] if self.simulated else []
            harmonics = [f"true_harmonics/{name}" for name in TRUE_HARMONICS] if self.simulated else []
            rows |= {name: trust.dataset(name, "<f8", (shape[0], None))[shot] for name in harmonics}
            return rows | {name: _rows(trust, name, shape)[shot] for name in names}

    def refuse_unlike(self, plan: Plan) -> None:
        """Raise ``StoreError`` where the records do not fit ``plan``: the file was changed, or its scene."""
        capture = plan.shots[0].capture
        planned = (len(plan.shots), capture.record_count, capture.record_samples)
        if planned != self.records.shape:
            raise StoreError(
                f"{self.path} holds (shot, pulse, sample) = {self.records.shape}, its scene asks for {planned}. "
                "It was changed. Try: an untouched copy."
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
        texts = [text for shot in range(dataset.shape[0]) if (text := dataset[shot])]
        return tuple(_settings(text) for text in texts)


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
    flags = {name: trust.dataset(f"records/{name}", "u1", shape[:1])[()] == 1 for name in ("shot_complete", "clipped")}
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
        run_time_s=_run_time_s(trust),
        untrusted=_untrusted_shots(trust, shape),
    )


def _untrusted(trust: Trusted, shape: Shape) -> h5py.Dataset:
    return trust.dataset("untrusted", f"S{UNTRUSTED_BYTES}", (shape[0],))


def _untrusted_shots(trust: Trusted, shape: Shape) -> dict[int, str]:
    if not trust.has("untrusted"):
        # Files from before settings were read back after a shot.
        return {}
    texts = enumerate(_untrusted(trust, shape)[()])
    return {shot: text.decode("ascii", "replace") for shot, text in texts if text}


def _run_time_s(trust: Trusted) -> dict[str, float]:
    if not trust.has("run_time"):
        # The earliest run files of this version have none.
        return {}
    names = trust.dataset("run_time/stage", f"S{STAGE_BYTES}", (None,))
    if names.shape[0] > MOST_STAGES:
        raise UntrustedError(f"/run_time has {names.shape[0]} stages")
    times_s = trust.dataset("run_time/run_time_s", "<f8", names.shape)[()]
    stages = [name.decode("ascii", "replace") for name in names[()]]
    pairs = zip(stages, times_s, strict=True)
    return {stage: float(time_s) for stage, time_s in pairs if stage.isprintable() and 0 <= time_s < math.inf}


def _echo(trust: Trusted, shape: Shape, name: str = "echo") -> h5py.Dataset:
    echo = trust.dataset(f"records/{name}", "<i2", shape)
    if echo.chunks is None:
        raise UntrustedError(f"/records/{name} is in one piece")
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
