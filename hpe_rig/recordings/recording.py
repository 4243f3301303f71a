"""Recording: contents of a foreign file and what is said of it -> samples on fixed axes, with every inference in words.

Nothing is assumed silently: each value that was not said by an option or the sidecar is in ``Recording.inferred`` with
where it comes from.
"""

from __future__ import annotations

import hashlib
import itertools
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hpe_rig.arrays import BoolArray, FloatArray
from hpe_rig.recordings.baseband import to_radio_frequency
from hpe_rig.recordings.contents import Contents
from hpe_rig.recordings.importers import read_contents
from hpe_rig.recordings.lines import chosen_lines
from hpe_rig.recordings.settings import AXES, Axis, RecordingSettings
from hpe_rig.recordings.statements import Known, Statements
from hpe_rig.scene import Mistake, SettingsError

SHOWN = 4
"""Records that a message lists by their place."""
DEFAULT_AXES: Mapping[int, tuple[Axis, ...]] = {
    2: ("pulse", "sample"),
    3: ("line", "pulse", "sample"),
    4: ("line", "shot", "pulse", "sample"),
}


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
    recorded: BoolArray
    scale_v: float | None
    sample_rate_hz: float
    pulse_rate_hz: float
    carrier_hz: float
    sound_speed_m_per_s: float | None
    pulse_time_s: FloatArray
    regular: bool
    first_sample_s: float
    line_position_m: FloatArray | None
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
    name = source.name if isinstance(source, Path) else "array"
    format_, contents, sha256 = _opened(source, settings, name)
    said = Statements(settings, contents, known or Known(), where or {})
    return _Reading(said, name, for_map).recording(format_, sha256)


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
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


class _Reading:
    """One recording being made sense of, by what is ``said`` of it."""

    def __init__(self, said: Statements, name: str, for_map: bool) -> None:
        self.said, self.settings, self.name, self.for_map = said, said.settings, name, for_map

    def recording(self, format_: str, sha256: str) -> Recording:
        """Return the recording; raise ``SettingsError`` with all that was found wrong."""
        said = self.said
        label, array = self._samples()
        axes = None if array is None else self._axes(array, label)
        rate_hz, carrier_hz = said.number("sample_rate_hz"), said.number("carrier_hz")
        speed = said.number("sound_speed_m_per_s", needed=False)
        time_s, pulse_rate_hz, regular = said.times(
            None if axes is None or array is None else array.shape[axes.index("pulse")]
        )
        first_s = said.first_sample_s(speed)
        if array is None or axes is None:
            raise self._error()
        values = self._cut(self._arranged(array, axes))
        mixed_hz = self._demodulation_hz(values)
        recorded = self._recorded(values)
        values, recorded, position_m = self._lines(values, recorded, said.positions_m(values.shape[0]))
        if not np.iscomplexobj(values):
            self._compare(rate_hz, carrier_hz)
        if said.mistakes or rate_hz is None or carrier_hz is None or time_s is None or pulse_rate_hz is None:
            raise self._error()
        if self.settings.samples is not None:
            first_s += self.settings.samples[0] / rate_hz
        values, rate_hz = self._signed(values, recorded, rate_hz, carrier_hz, mixed_hz)
        return Recording(
            name=self.name,
            sha256=sha256,
            format=format_,
            values=values,
            recorded=recorded,
            scale_v=said.number("scale_v", needed=False),
            sample_rate_hz=rate_hz,
            pulse_rate_hz=pulse_rate_hz,
            carrier_hz=carrier_hz,
            sound_speed_m_per_s=speed,
            pulse_time_s=time_s,
            regular=regular,
            first_sample_s=first_s,
            line_position_m=position_m,
            inferred=tuple(said.inferred),
            board=said.contents.board,
            demodulation_hz=mixed_hz,
        )

    def _demodulation_hz(self, values: NDArray[Any]) -> float | None:
        """Return what I and Q were mixed down by; None of real samples, for which nobody may state it."""
        is_iq = np.iscomplexobj(values)
        mixed_hz = self.said.number("demodulation_hz", needed=is_iq)
        if mixed_hz is not None and not is_iq and self.settings.demodulation_hz is not None:
            what = "demodulation_hz is stated, and the samples are real"
            self.said.wrong("demodulation_hz", what, 'I and Q as complex numbers, or as an axis "iq" of two')
        return mixed_hz if is_iq else None

    def _recorded(self, values: NDArray[Any]) -> BoolArray:
        """Return which records (line, shot, pulse) are there; of a map all, which marks its pixels itself."""
        if self.for_map:
            return np.ones(values.shape[:3], np.bool_)
        recorded = self._finite(values)
        self._not_constant(values, recorded)
        return recorded

    def _compare(self, rate_hz: float | None, carrier_hz: float | None) -> None:
        """Add a mistake where real samples are too few for their carrier."""
        if rate_hz is not None and carrier_hz is not None and carrier_hz >= rate_hz / 2:
            what = f"a carrier of {carrier_hz:g} Hz does not fit a sampling rate of {rate_hz:g} Hz"
            self.said.wrong("carrier_hz", what, "the right one of the two, or demodulation_hz for I and Q")

    def _signed(
        self,
        values: NDArray[Any],
        recorded: BoolArray,
        rate_hz: float,
        carrier_hz: float,
        mixed_hz: float | None,
    ) -> tuple[NDArray[Any], float]:
        """Return the values with their sign and zeros for what is missing, and their rate.

        I and Q as samples around the carrier, unless for a map.
        """
        values = np.where(recorded[..., None], values, 0) if not recorded.all() else values
        if mixed_hz is None:
            if self.settings.sign < 0:
                values = -values.astype(np.int32) if values.dtype.kind == "i" else -values
            return values, rate_hz
        values = values.conj() if self.settings.sign < 0 else values
        if self.for_map:
            return values, rate_hz
        values, finer_hz = to_radio_frequency(values, rate_hz, mixed_hz, carrier_hz)
        self.said.inferred.append(
            f"I and Q are mixed up by {mixed_hz:g} Hz and interpolated from {rate_hz:g} Hz to {finer_hz:g} Hz"
        )
        return values, finer_hz

    def _error(self) -> SettingsError:
        return SettingsError(f"recording {self.name}", list(dict.fromkeys(self.said.mistakes)))

    def _samples(self) -> tuple[str, NDArray[Any] | None]:
        """Return name and array of the samples: the one that is named, else the only one, else the largest."""
        arrays, wanted = self.said.contents.arrays, self.settings.variable
        if wanted is not None:
            found = {name.strip("/"): array for name, array in arrays.items()}
            if wanted.strip("/") in found:
                return wanted, found[wanted.strip("/")]
            self.said.wrong(
                "variable",
                f"{wanted!r} is no array of two axes or more in the file",
                f"one of {', '.join(arrays)}" if arrays else "a file with samples",
            )
            return wanted, None
        if not arrays:
            self.said.wrong("", "the file holds no array of numbers with two axes or more", "a file with samples")
            return "", None
        sizes = sorted(((array.size, name) for name, array in arrays.items()), reverse=True)
        if len(sizes) > 1 and sizes[0][0] == sizes[1][0]:
            real = {name: array for name, array in arrays.items() if array.size == sizes[0][0]}
            self.said.wrong("variable", f"several arrays may be the samples: {', '.join(real)}", f'"{sizes[0][1]}"')
            return "", None
        if len(arrays) > 1:
            self.said.inferred.append(f"samples: {sizes[0][1]!r}, the largest array of {', '.join(arrays)}")
        return sizes[0][1], arrays[sizes[0][1]]

    def _axes(self, array: NDArray[Any], label: str) -> tuple[Axis, ...] | None:
        stated = self.settings.axes or self.said.contents.axes
        if stated is not None:
            if len(stated) == array.ndim:
                iq = stated.index("iq") if "iq" in stated else None
                if iq is not None and array.shape[iq] != 2:
                    self.said.wrong("axes", f"axis iq has a length of {array.shape[iq]}", "one of 2, for I and Q")
                    return None
                return stated
            what = f"{', '.join(stated)} are {len(stated)} axes, {label!r} has {array.ndim}: {array.shape}"
            self.said.wrong("axes", what, f"{array.ndim} names in the order of the file")
            return None
        default = DEFAULT_AXES.get(array.ndim)
        if default is None:
            what = f"{label!r} has {array.ndim} axes: {array.shape}"
            self.said.wrong("axes", what, f"axes with {array.ndim} names of {', '.join(AXES)}, or another array")
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
            self.said.inferred.append(f"axes: {', '.join(orders[0])} for {array.shape}, the only order with {told}")
            return orders[0]
        what = f"the order of axes of {array.shape} is not stated"
        if told:
            what += f", and {'several orders have' if orders else 'none has'} {told}"
        self.said.wrong("axes", what, f'such as axes = "{",".join(default)}"')
        return None

    def _lengths(self) -> dict[str, int | None]:
        times, positions = self.said.stated("pulse_time_s"), self.said.stated("line_position_m")
        return {
            "pulse": self.said.known.pulse_count if times is None else len(times[0]),
            "sample": self.said.known.record_samples if self.settings.samples is None else None,
            "line": None if positions is None else len(positions[0]),
        }

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
            self.said.wrong("axes", what, "at least 4 pulses of 8 samples, or another order of axes")
        return values

    def _cut(self, values: NDArray[Any]) -> NDArray[Any]:
        if self.settings.samples is None:
            return values
        first, end = self.settings.samples
        if end > values.shape[-1]:
            what = f"{first} to {end} reach over the {values.shape[-1]} samples of a record"
            self.said.wrong("samples", what, f"[{min(first, values.shape[-1] - 8)}, {values.shape[-1]}]")
            return values
        return values[..., first:end]

    def _finite(self, values: NDArray[Any]) -> BoolArray:
        """Return which records (line, shot, pulse) are there; a mistake for others, unless they count as missing."""
        recorded: BoolArray = np.isfinite(values).all(axis=-1)
        if recorded.all() or self.settings.not_finite == "missing":
            if not recorded.all():
                self.said.inferred.append(f"{int((~recorded).sum())} records hold values that are not finite: missing")
            if not recorded.any():
                self.said.wrong("", "no record holds finite values alone", "another file")
            return recorded
        what = f"{int((~recorded).sum())} of {recorded.size} records hold values that are not finite: "
        what += _places(~recorded)
        self.said.wrong("", what, 'numbers, or not_finite = "missing"')
        return recorded

    def _not_constant(self, values: NDArray[Any], recorded: BoolArray) -> None:
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
                self.said.inferred.append(f"{what}; none of these is taken")
            else:
                self.said.wrong("lines", what, "other lines, or another array")
        alive = constant & ~dead[:, None, None]
        if alive.any() and self._chosen_alive(alive.any(axis=(1, 2))) is False:
            what = f"{int(alive.sum())} records hold one value throughout: {_places(alive)}"
            self.said.wrong("", what, 'records with echoes; NaN in them and not_finite = "missing" leaves them out')

    def _chosen_alive(self, dead: BoolArray) -> bool:
        chosen = chosen_lines(self.settings.lines, dead.size)
        return not isinstance(chosen, Mistake) and not dead[chosen[0]].any()

    def _lines(
        self, values: NDArray[Any], recorded: BoolArray, position_m: FloatArray | None
    ) -> tuple[NDArray[Any], BoolArray, FloatArray | None]:
        chosen = chosen_lines(self.settings.lines or ("all" if self.for_map else None), values.shape[0])
        if isinstance(chosen, Mistake):
            self.said.mistakes.append(chosen)
            return values[:1], recorded[:1], None if position_m is None else position_m[:1]
        lines, mean = chosen
        values, recorded = values[lines], recorded[lines]
        position_m = None if position_m is None else position_m[lines]
        if not mean:
            if values.shape[0] > 1 and position_m is None and not self.for_map:
                what = f"{values.shape[0]} lines as places, and nobody says where they lie"
                self.said.wrong("line_position_m", what, "line_pitch_m = 0.3e-3, or line_position_m with one a line")
            return values, recorded, position_m
        count = values.shape[0]
        self.said.inferred.append(f"the mean of {count} lines is taken")
        there = np.asarray(recorded.all(axis=0, keepdims=True), np.bool_)
        return (
            values.mean(axis=0, keepdims=True),
            there,
            None if position_m is None else position_m.mean(keepdims=True),
        )


def _places(which: BoolArray) -> str:
    """Return the first of the records (line, shot, pulse) in words, counted from 1."""
    found = np.argwhere(which)
    words = [f"line {line + 1} shot {shot + 1} pulse {pulse + 1}" for line, shot, pulse in found[:SHOWN].tolist()]
    return ", ".join(words) + (f" and {len(found) - SHOWN} more" if len(found) > SHOWN else "")
