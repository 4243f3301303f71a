"""Recording: contents of a foreign file and what is said of it -> samples on fixed axes, with every inference in words.

What is said counts in this order: an option, the sidecar, the file itself, the scene. Nothing is assumed silently: each
value that was not said by an option or the sidecar is in ``Recording.inferred`` with where it comes from.
"""

from __future__ import annotations

import hashlib
import itertools
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hpe_rig.recordings.baseband import to_radio_frequency
from hpe_rig.recordings.contents import Contents
from hpe_rig.recordings.importers import read_contents
from hpe_rig.recordings.lines import chosen_lines
from hpe_rig.recordings.settings import AXES, Axis, RecordingSettings
from hpe_rig.scene import Mistake, SettingsError

REGULAR = 1e-3
"""Deviation from a fixed rate, in pulse periods, up to which times are those of a fixed rate."""
SHOWN = 4
"""Records that a message lists by their place."""
CHUNK_BYTES = 1 << 22
DEFAULT_AXES: Mapping[int, tuple[Axis, ...]] = {
    2: ("pulse", "sample"),
    3: ("line", "pulse", "sample"),
    4: ("line", "shot", "pulse", "sample"),
}


@dataclass(frozen=True, slots=True)
class Known:
    """What the scene says already: numbers of pulses and samples, rates; None or absent where it is silent."""

    pulse_count: int | None = None
    record_samples: int | None = None
    values: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Recording:
    """Samples of a foreign recording on fixed axes.

    ``values`` (line, shot, pulse, sample): int16 codes or real values, ``scale_v`` volts each. ``recorded``
    (line, shot, pulse): False where a record counts as missing. ``pulse_time_s`` (pulse,), from what phases count from;
    ``regular``: whether they are those of ``pulse_rate_hz``. ``line_position_m`` (line,) or None where nobody says.
    ``inferred``: in words, what was not stated by options or sidecar. ``board``: the digitizer whose codes these are.
    """

    name: str
    sha256: str
    format: str
    values: NDArray[Any]
    recorded: NDArray[np.bool_]
    scale_v: float | None
    sample_rate_hz: float
    pulse_rate_hz: float
    carrier_hz: float
    sound_speed_m_per_s: float | None
    pulse_time_s: NDArray[np.float64]
    regular: bool
    first_sample_s: float
    line_position_m: NDArray[np.float64] | None
    inferred: tuple[str, ...]
    board: str | None = None
    demodulation_hz: float | None = None


def read_recording(
    source: Path | NDArray[Any],
    settings: RecordingSettings,
    where: Mapping[str, str] | None = None,
    known: Known | None = None,
    for_map: bool = False,
) -> Recording:
    """Return the recording in the file or array ``source``; ``where``: who states each of ``settings``.

    ``for_map``: all lines where none is chosen, placed or not, I and Q as they are, and whatever is wrong with single
    values left to the map, which marks them.
    Raises ``SettingsError`` with every mistake: what cannot be read, is not stated, or contradicts itself.
    """
    known = known or Known()
    name = source.name if isinstance(source, Path) else "array"
    format_, contents, sha256 = _opened(source, settings, name)
    reading = _Reading(settings, contents, known, dict(where or {}), name, for_map)
    return reading.recording(format_, sha256)


def _opened(source: Path | NDArray[Any], settings: RecordingSettings, name: str) -> tuple[str, Contents, str]:
    if not isinstance(source, Path):
        values = np.asarray(source)
        if values.dtype.kind not in "iufc":
            raise SettingsError("recording", [Mistake("", f"values of type {values.dtype}", "real or complex numbers")])
        digest = hashlib.sha256(np.ascontiguousarray(values).tobytes()).hexdigest()
        return "array", Contents({"array": values}), digest
    try:
        if not source.is_file():
            what = "is a folder" if source.is_dir() else "does not exist"
            raise SettingsError(f"recording {name}", [Mistake("", f"{source} {what}", "the path of a recording")])
        if not source.stat().st_size:
            raise ValueError("it is empty: a file with samples")
        format_, contents = read_contents(source, settings)
        return format_, contents, _sha256(source)
    except OSError as error:
        what = f"{source} cannot be read ({error.strerror or error})"
        raise SettingsError(f"recording {name}", [Mistake("", what, "a readable copy")]) from error
    except ValueError as error:
        what, _, remedy = str(error).rpartition(": ")
        mistake = Mistake("", what or str(error), remedy if what else "a whole copy of it")
        raise SettingsError(f"recording {name}", [mistake]) from error


def _sha256(path: Path) -> str:
    digest = hashlib.sha256()
    with path.open("rb") as file:
        while block := file.read(CHUNK_BYTES):
            digest.update(block)
    return digest.hexdigest()


class _Reading:
    """One recording being made sense of: mistakes and inferences are gathered as they are found."""

    def __init__(
        self,
        settings: RecordingSettings,
        contents: Contents,
        known: Known,
        where: dict[str, str],
        name: str,
        for_map: bool,
    ) -> None:
        self.settings, self.contents, self.known, self.where, self.name = settings, contents, known, where, name
        self.for_map = for_map
        self.mistakes: list[Mistake] = []
        self.inferred: list[str] = []

    def recording(self, format_: str, sha256: str) -> Recording:
        """Return the recording; raise ``SettingsError`` with all that was found wrong."""
        label, array = self._samples()
        axes = None if array is None else self._axes(array, label)
        rate_hz, carrier_hz = self._number("sample_rate_hz"), self._number("carrier_hz")
        speed = self._number("sound_speed_m_per_s", needed=False)
        count = None if axes is None or array is None else array.shape[axes.index("pulse")]
        time_s, pulse_rate_hz, regular = self._times(count)
        first_s = self._first_sample_s(speed)
        if array is None or axes is None:
            raise self._error()
        values = self._arranged(array, axes)
        values = self._cut(values)
        is_iq = np.iscomplexobj(values)
        mixed_hz = self._number("demodulation_hz", needed=is_iq)
        if mixed_hz is not None and not is_iq and self.settings.demodulation_hz is not None:
            what = "demodulation_hz is stated, and the samples are real"
            self._wrong("demodulation_hz", what, 'I and Q as complex numbers, or as an axis "iq" of two')
        recorded = np.ones(values.shape[:3], np.bool_) if self.for_map else self._finite(values)
        if not self.for_map:
            self._not_constant(values, recorded)
        position_m = self._positions(values.shape[0])
        values, recorded, position_m = self._lines(values, recorded, position_m)
        if rate_hz is not None and carrier_hz is not None and not is_iq and carrier_hz >= rate_hz / 2:
            what = f"a carrier of {carrier_hz:g} Hz does not fit a sampling rate of {rate_hz:g} Hz"
            self._wrong("carrier_hz", what, "the right one of the two, or demodulation_hz for I and Q")
        if self.mistakes or rate_hz is None or carrier_hz is None or time_s is None or pulse_rate_hz is None:
            raise self._error()
        if self.settings.samples is not None:
            first_s += self.settings.samples[0] / rate_hz
        values = np.where(recorded[..., None], values, 0) if not recorded.all() else values
        if is_iq and self.settings.sign < 0:
            values = values.conj()
        if is_iq and not self.for_map:
            values, finer_hz = to_radio_frequency(values, rate_hz, float(mixed_hz or 0.0), carrier_hz)
            self.inferred.append(
                f"I and Q are mixed up by {mixed_hz:g} Hz and interpolated from {rate_hz:g} Hz to {finer_hz:g} Hz"
            )
            rate_hz = finer_hz
        elif self.settings.sign < 0 and not is_iq:
            values = -values.astype(np.int32) if values.dtype.kind == "i" else -values
        return Recording(
            name=self.name,
            sha256=sha256,
            format=format_,
            values=values,
            recorded=recorded,
            scale_v=self._number("scale_v", needed=False),
            sample_rate_hz=rate_hz,
            pulse_rate_hz=pulse_rate_hz,
            carrier_hz=carrier_hz,
            sound_speed_m_per_s=speed,
            pulse_time_s=time_s,
            regular=regular,
            first_sample_s=first_s,
            line_position_m=position_m,
            inferred=tuple(self.inferred),
            board=self.contents.board,
            demodulation_hz=mixed_hz if is_iq else None,
        )

    def _error(self) -> SettingsError:
        return SettingsError(f"recording {self.name}", list(dict.fromkeys(self.mistakes)))

    def _wrong(self, key: str, what: str, remedy: str) -> None:
        self.mistakes.append(Mistake(key, what, remedy))

    def _samples(self) -> tuple[str, NDArray[Any] | None]:
        """Return name and array of the samples: the one that is named, else the only one, else the largest."""
        arrays, wanted = self.contents.arrays, self.settings.variable
        if wanted is not None:
            found = {name.strip("/"): array for name, array in arrays.items()}
            if wanted.strip("/") in found:
                return wanted, found[wanted.strip("/")]
            self._wrong(
                "variable",
                f"{wanted!r} is no array of two axes or more in the file",
                f"one of {', '.join(arrays)}" if arrays else "a file with samples",
            )
            return wanted, None
        if not arrays:
            self._wrong("", "the file holds no array of numbers with two axes or more", "a file with samples")
            return "", None
        sizes = sorted(((array.size, name) for name, array in arrays.items()), reverse=True)
        if len(sizes) > 1 and sizes[0][0] == sizes[1][0]:
            real = {name: array for name, array in arrays.items() if array.size == sizes[0][0]}
            self._wrong("variable", f"several arrays may be the samples: {', '.join(real)}", f'"{sizes[0][1]}"')
            return "", None
        if len(arrays) > 1:
            self.inferred.append(f"samples: {sizes[0][1]!r}, the largest array of {', '.join(arrays)}")
        return sizes[0][1], arrays[sizes[0][1]]

    def _axes(self, array: NDArray[Any], label: str) -> tuple[Axis, ...] | None:
        stated = self.settings.axes or self.contents.axes
        if stated is not None:
            if len(stated) == array.ndim:
                iq = stated.index("iq") if "iq" in stated else None
                if iq is not None and array.shape[iq] != 2:
                    self._wrong("axes", f"axis iq has a length of {array.shape[iq]}", "one of 2, for I and Q")
                    return None
                return stated
            what = f"{', '.join(stated)} are {len(stated)} axes, {label!r} has {array.ndim}: {array.shape}"
            self._wrong("axes", what, f"{array.ndim} names in the order of the file")
            return None
        default = DEFAULT_AXES.get(array.ndim)
        if default is None:
            what = f"{label!r} has {array.ndim} axes: {array.shape}"
            self._wrong("axes", what, f"axes with {array.ndim} names of {', '.join(AXES)}, or another array")
            return None
        return self._guessed(array, default)

    def _guessed(self, array: NDArray[Any], default: tuple[Axis, ...]) -> tuple[Axis, ...] | None:
        """Return the one order of axes with the lengths that are known; a mistake where there is none or another."""
        lengths = {name: length for name, length in self._lengths().items() if length is not None}
        orders = [
            order
            for order in itertools.permutations(default)
            if all(lengths.get(name, length) == length for name, length in zip(order, array.shape, strict=True))
        ]
        told = ", ".join(f"{length} along {name}" for name, length in lengths.items())
        if len(orders) == 1:
            self.inferred.append(f"axes: {', '.join(orders[0])} for {array.shape}, the only order with {told}")
            return orders[0]
        what = f"the order of axes of {array.shape} is not stated"
        if told:
            what += f", and {'several orders have' if orders else 'none has'} {told}"
        self._wrong("axes", what, f'such as axes = "{",".join(default)}"')
        return None

    def _lengths(self) -> dict[str, int | None]:
        times, positions = self._stated("pulse_time_s"), self._stated("line_position_m")
        return {
            "pulse": self.known.pulse_count if times is None else len(times[0]),
            "sample": self.known.record_samples if self.settings.samples is None else None,
            "line": None if positions is None else len(positions[0]),
        }

    def _stated(self, key: str) -> tuple[Any, str] | None:
        """Return what options, sidecar or file say of ``key``, and which of them."""
        own = getattr(self.settings, key, None)
        if own is not None:
            return own, self.where.get(key, "an option")
        return self.contents.stated.get(key)

    def _number(self, key: str, needed: bool = True) -> float | None:
        """Return the value of ``key``; where nobody states it and it is ``needed`` that is a mistake."""
        own = getattr(self.settings, key, None)
        of_file = self.contents.stated.get(key)
        if own is not None:
            if of_file is not None and not np.isclose(float(of_file[0]), own, rtol=1e-6):
                self.inferred.append(
                    f"{key} = {own:g} as {self.where.get(key, 'an option')} says, the file says {of_file[0]:g}"
                )
            return float(own)
        if of_file is not None:
            value = float(of_file[0])
            check = self._within(key, value)
            if check is not None:
                self._wrong(
                    key, f"{of_file[1]!r} of the file says {value:g}, {check.what}", f"{key} with the right one"
                )
                return None
            self.inferred.append(f"{key} = {value:g}, by {of_file[1]!r} of the file")
            return value
        if key in self.known.values:
            value = self.known.values[key]
            self.inferred.append(f"{key} = {value:g}, by the scene")
            return value
        if needed:
            self._wrong(key, "neither options, sidecar, file nor scene state it", f"--set {key}=... or a sidecar file")
        return None

    @staticmethod
    def _within(key: str, value: float) -> Mistake | None:
        from hpe_rig.scene import mistakes_of

        found = mistakes_of(RecordingSettings, {key: value})
        return found[0] if found else None

    def _times(self, count: int | None) -> tuple[NDArray[np.float64] | None, float | None, bool]:
        """Return the times of the pulses, their rate and whether it is regular."""
        stated = self._stated("pulse_time_s")
        if stated is None or (self.settings.pulse_time_s is None and self.settings.pulse_rate_hz is not None):
            rate_hz = self._number("pulse_rate_hz")
            first_s = self.settings.first_pulse_s
            if first_s is None:
                first_s = self.known.values.get("first_pulse_s", 0.0)
                said = "by the scene's tracking.delay_s" if "first_pulse_s" in self.known.values else "as nobody says"
                self.inferred.append(f"the first pulse is fired at {first_s:g} s, {said}: phases count from there")
            if rate_hz is None or count is None:
                return None, rate_hz, True
            return first_s + np.arange(count) / rate_hz, rate_hz, True
        times, origin = stated
        time_s = np.array(times, dtype=np.float64)
        if count is not None and time_s.size != count:
            self._wrong("pulse_time_s", f"{time_s.size} times ({origin}) for {count} pulses", "one time a pulse")
            return None, None, True
        if not np.isfinite(time_s).all() or not np.all(np.diff(time_s) > 0):
            where = int(np.argmax(~(np.diff(time_s) > 0))) + 1
            what = f"times ({origin}) do not ascend: pulse {where + 1} comes at {time_s[where]:g} s after "
            what += f"{time_s[where - 1]:g} s"
            self._wrong("pulse_time_s", what, "the times of the pulses in their order, s")
            return None, None, True
        if time_s[0] < 0 or time_s[-1] > 1e3:
            what = f"times ({origin}) run from {time_s[0]:g} to {time_s[-1]:g} s"
            self._wrong("pulse_time_s", what, "seconds from 0 on")
            return None, None, True
        rate_hz = float(1 / np.median(np.diff(time_s)))
        fitted_hz = (time_s.size - 1) / (time_s[-1] - time_s[0])
        even = time_s[0] + np.arange(time_s.size) / fitted_hz
        regular = bool(np.abs(time_s - even).max() * fitted_hz < REGULAR)
        rate_hz = float(fitted_hz) if regular else rate_hz
        kind = "even to 0.1 %" if regular else "not even: each is taken as it is"
        if self.settings.pulse_time_s is None:
            self.inferred.append(f"pulses: {time_s.size} times by {origin!r} of the file")
        self.inferred.append(f"pulse_rate_hz = {rate_hz:.6g}, from {time_s.size} times, {kind}")
        return time_s, rate_hz, regular

    def _first_sample_s(self, speed: float | None) -> float:
        depth_m = self.settings.first_sample_depth_m
        if depth_m is None:
            if self.settings.first_sample_s is None and "first_sample_s" not in self.contents.stated:
                self.inferred.append("the first sample is taken at the onset of its pulse (depth 0), as nobody says")
                return 0.0
            return self._number("first_sample_s") or 0.0
        if speed is None:
            self._wrong("first_sample_depth_m", "a depth needs a sound speed", "sound_speed_m_per_s = 1540.0")
            return 0.0
        return 2 * depth_m / speed

    def _arranged(self, array: NDArray[Any], axes: tuple[Axis, ...]) -> NDArray[Any]:
        """Return the samples as (line, shot, pulse, sample), I and Q as complex numbers."""
        order = [axes.index(name) for name in AXES if name in axes]
        values = np.transpose(array, order)
        names = [name for name in AXES if name in axes]
        if "iq" in names:
            values = values[..., 0] + 1j * values[..., 1]
            names.remove("iq")
        for index, name in enumerate(AXES[:4]):
            if name not in names:
                values = np.expand_dims(values, index)
        if values.shape[2] < 2 or values.shape[3] < 8:
            what = f"{values.shape[2]} pulses of {values.shape[3]} samples carry no motion"
            self._wrong("axes", what, "at least 4 pulses of 8 samples, or another order of axes")
        return values

    def _cut(self, values: NDArray[Any]) -> NDArray[Any]:
        if self.settings.samples is None:
            return values
        first, end = self.settings.samples
        if end > values.shape[-1]:
            what = f"{first} to {end} reach over the {values.shape[-1]} samples of a record"
            self._wrong("samples", what, f"[{min(first, values.shape[-1] - 8)}, {values.shape[-1]}]")
            return values
        return values[..., first:end]

    def _finite(self, values: NDArray[Any]) -> NDArray[np.bool_]:
        """Return which records (line, shot, pulse) are there; a mistake for others, unless they count as missing."""
        recorded: NDArray[np.bool_] = np.isfinite(values).all(axis=-1)
        if recorded.all() or self.settings.not_finite == "missing":
            if not recorded.all():
                self.inferred.append(f"{int((~recorded).sum())} records hold values that are not finite: missing")
            if not recorded.any():
                self._wrong("", "no record holds finite values alone", "another file")
            return recorded
        what = f"{int((~recorded).sum())} of {recorded.size} records hold values that are not finite: "
        what += _places(~recorded)
        self._wrong("", what, 'numbers, or not_finite = "missing"')
        return recorded

    def _not_constant(self, values: NDArray[Any], recorded: NDArray[np.bool_]) -> None:
        """Add a mistake for lines that never change: a channel that is not connected."""
        with np.errstate(invalid="ignore"):
            first = values[..., :1]
            constant = (values == first).all(axis=-1) & recorded
        if not constant.any():
            return
        dead = (constant | ~recorded).all(axis=(1, 2))
        if dead.any():
            numbers = ", ".join(str(int(line) + 1) for line in np.flatnonzero(dead)[:SHOWN])
            what = f"{int(dead.sum())} of {dead.size} lines hold the same value everywhere: line {numbers}"
            if self._chosen_alive(dead):
                self.inferred.append(f"{what}; none of these is taken")
            else:
                self._wrong("lines", what, "other lines, or another array")
        alive = constant & ~dead[:, None, None]
        if alive.any() and self._chosen_alive(alive.any(axis=(1, 2))) is False:
            what = f"{int(alive.sum())} records hold one value throughout: {_places(alive)}"
            self._wrong("", what, 'records with echoes; NaN in them and not_finite = "missing" leaves them out')

    def _chosen_alive(self, dead: NDArray[np.bool_]) -> bool:
        chosen = chosen_lines(self.settings.lines, dead.size)
        return not isinstance(chosen, Mistake) and not dead[chosen[0]].any()

    def _positions(self, lines: int) -> NDArray[np.float64] | None:
        pitch_m = self.settings.line_pitch_m
        if pitch_m is not None:
            return np.asarray((np.arange(lines) - (lines - 1) / 2) * pitch_m, np.float64)
        stated = self._stated("line_position_m")
        if stated is None:
            return None
        position_m = np.array(stated[0], dtype=np.float64)
        if position_m.size != lines:
            self._wrong("line_position_m", f"{position_m.size} positions for {lines} lines", "one a line")
            return None
        if self.settings.line_position_m is None:
            self.inferred.append(f"line_position_m: {lines} positions by {stated[1]!r} of the file")
        return position_m

    def _lines(
        self, values: NDArray[Any], recorded: NDArray[np.bool_], position_m: NDArray[np.float64] | None
    ) -> tuple[NDArray[Any], NDArray[np.bool_], NDArray[np.float64] | None]:
        chosen = chosen_lines(self.settings.lines or ("all" if self.for_map else None), values.shape[0])
        if isinstance(chosen, Mistake):
            self.mistakes.append(chosen)
            return values[:1], recorded[:1], None if position_m is None else position_m[:1]
        lines, mean = chosen
        values, recorded = values[lines], recorded[lines]
        position_m = None if position_m is None else position_m[lines]
        if not mean:
            if values.shape[0] > 1 and position_m is None and not self.for_map:
                what = f"{values.shape[0]} lines as places, and nobody says where they lie"
                self._wrong("line_position_m", what, "line_pitch_m = 0.3e-3, or line_position_m with one a line")
            return values, recorded, position_m
        count = values.shape[0]
        self.inferred.append(f"the mean of {count} lines is taken")
        there = np.asarray(recorded.all(axis=0, keepdims=True), np.bool_)
        return (
            values.mean(axis=0, keepdims=True),
            there,
            None if position_m is None else position_m.mean(keepdims=True),
        )


def _places(which: NDArray[np.bool_]) -> str:
    """Return the first of the records (line, shot, pulse) in words, counted from 1."""
    found = np.argwhere(which)
    words = [f"line {line + 1} shot {shot + 1} pulse {pulse + 1}" for line, shot, pulse in found[:SHOWN].tolist()]
    return ", ".join(words) + (f" and {len(found) - SHOWN} more" if len(found) > SHOWN else "")
