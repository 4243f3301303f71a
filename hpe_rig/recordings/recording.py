"""Samples of a foreign recording on fixed axes, from the content of its file and its settings.

Nothing is assumed silently: ``Recording.inferred`` describes each value that neither an option nor the sidecar states,
with its origin.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from hpe_rig.arrays import BoolArray, FloatArray
from hpe_rig.recordings.axes import select_array, select_lines, with_axes
from hpe_rig.recordings.carrier import compare_with_carrier, echo_band, to_radio_frequency, unfold
from hpe_rig.recordings.contents import Contents
from hpe_rig.recordings.importers import BUILT_IN, read_contents
from hpe_rig.recordings.motion import NOMINAL_SPEED_M_PER_S, depth_rate_hz, kind_of, si_motion
from hpe_rig.recordings.series import read_series, series_name
from hpe_rig.recordings.settings import DIMENSIONS, KEYS_OF_FORMAT, Dimension, RecordingSettings
from hpe_rig.recordings.statements import Statements
from hpe_rig.scene import Mistake, SettingsError, plural

MIN_PULSES, MIN_SAMPLES = 2, 8
MAX_LISTED = 4
"""Records that a message lists."""
MAX_VALUE = 1e18
"""Largest value of an echo in any unit; its square fits into single precision."""
Source = Path | tuple[Path, ...] | NDArray[Any]
"""A file, files with one pulse or frame each, or an array."""


@dataclass(frozen=True, slots=True)
class Recording:
    """Samples of a foreign recording on fixed axes.

    ``values`` (line, shot, pulse, sample): int16 codes or real values of ``scale_v`` volts each; complex I and Q for a
    map; m or m/s of a ``quantity``. ``recorded`` (line, shot, pulse): False if a record is missing. ``pulse_time_s``
    (pulse,): after time zero of the phases; ``regular``: they have the fixed rate ``pulse_rate_hz``.
    ``line_position_m`` (line,): None if unknown. ``inferred``: values that options and sidecar do not state.
    ``board``: the digitizer of the codes, if known. ``quantity``: "displacement" or "velocity" of a motion without
    echoes, which has no carrier (0).
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
    quantity: Literal["displacement", "velocity"] | None = None

    @property
    def depth_m(self) -> FloatArray:
        """Depths of the samples (sample,), by the sound speed if it is known, else by 1540 m/s."""
        time_s = self.first_sample_s + np.arange(self.values.shape[3]) / self.sample_rate_hz
        return np.asarray(time_s * (self.sound_speed_m_per_s or NOMINAL_SPEED_M_PER_S) / 2)


def read_recording(
    source: Source,
    settings: RecordingSettings,
    origins: Mapping[str, str] | None = None,
    scene: Mapping[str, float] | None = None,
    for_map: bool = False,
) -> Recording:
    """Return the recording in ``source``: a file, files with a pulse or frame each, or an array.

    ``origins``: of each of ``settings``. ``scene``: settings that the scene states, by key; also ``pulse_count`` and
    ``record_samples``. ``for_map``: by default all lines are selected, without positions; I and Q are not mixed up;
    invalid values are kept, since the map marks its pixels. Raises ``SettingsError`` with every unreadable, missing or
    wrong value.
    """
    name = source_name(source)
    file_format, contents, sha256 = _open_source(source, settings, name)
    statements = Statements(settings, contents, scene or {}, origins or {})
    return _Reader(statements, name, for_map).read(file_format, sha256)


def as_source(recording: Any) -> Source:
    """Return a path, a sequence of paths or an array as the source of a recording."""
    if isinstance(recording, str | os.PathLike):
        return Path(recording)
    if isinstance(recording, list | tuple) and recording and all(isinstance(p, str | os.PathLike) for p in recording):
        return tuple(Path(path) for path in recording)
    return np.asarray(recording)


def source_name(source: Source) -> str:
    """Return the name of ``source`` in messages and results."""
    if isinstance(source, tuple):
        return series_name(source)
    return source.name if isinstance(source, Path) else "array"


def _open_source(source: Source, settings: RecordingSettings, name: str) -> tuple[str, Contents, Callable[[], str]]:
    """Return format and content of the files or array, and a function that computes their SHA-256."""
    if not isinstance(source, Path | tuple):
        values = np.asarray(source)
        if values.dtype.kind not in "iufc":
            raise SettingsError("recording", [Mistake("", f"values of type {values.dtype}", "real or complex numbers")])
        return (
            "array",
            Contents({"array": values}),
            lambda: hashlib.sha256(np.ascontiguousarray(values).data).hexdigest(),
        )
    try:
        _check_files(source if isinstance(source, tuple) else (source,), name)
        if isinstance(source, tuple):
            file_format, contents, digest = read_series(source, settings)
            return file_format, contents, lambda: digest
        return *read_contents(source, settings), lambda: _sha256(source)
    except OSError as error:
        what = f"{error.filename or name} cannot be read ({error.strerror or error})"
        raise SettingsError(f"recording {name}", [Mistake("", what, "a readable copy")]) from error
    except ValueError as error:
        what, _, remedy = str(error).rpartition(": ")
        mistake = Mistake("", what or str(error), remedy if what else "an undamaged copy")
        raise SettingsError(f"recording {name}", [mistake]) from error


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _check_files(paths: tuple[Path, ...], name: str) -> None:
    """Raise ``SettingsError`` or ``ValueError`` for a path that is no file or an empty one."""
    for path in paths:
        if not path.is_file():
            what = "is a folder" if path.is_dir() else "does not exist"
            raise SettingsError(f"recording {name}", [Mistake("", f"{path} {what}", "the path of a recording")])
        if not path.stat().st_size:
            raise ValueError(f"{'it' if len(paths) == 1 else path.name} is empty: a file with samples")


class _Reader:
    """Reader of one recording; mistakes and inferred values are collected in ``statements``."""

    def __init__(self, statements: Statements, name: str, for_map: bool) -> None:
        self.statements, self.settings = statements, statements.settings
        self.name, self.for_map = name, for_map

    def read(self, file_format: str, sha256: Callable[[], str]) -> Recording:
        """Return the recording with the result of ``sha256``; raise ``SettingsError`` with all mistakes."""
        statements = self.statements
        statements.inferred += statements.contents.inferred
        self._refuse_unused_settings(file_format)
        label, array = select_array(statements)
        array, axes = (None, None) if array is None else with_axes(statements, array, label)
        rate_hz, carrier_hz, sound_speed = self._rates(axes or ())
        pulse_count = None if axes is None or array is None else array.shape[axes.index("pulse")]
        pulse_time_s, pulse_rate_hz, regular = statements.pulse_times(pulse_count)
        first_s = statements.first_sample_s(sound_speed)
        if array is None or axes is None:
            raise self._error()
        # All further steps collect mistakes, so that one error reports all of them.
        values = self._in_si(self._cut_samples(self._arrange(array, axes)))
        demodulation_hz = self._demodulation_hz(values)
        recorded = self._find_recorded(values)
        position_m = statements.line_positions_m(values.shape[0])
        empty_lines = np.flatnonzero(~recorded.any(axis=(1, 2))) + 1
        values, recorded, position_m = self._select_lines(values, recorded, position_m)
        self._check_any_echo(recorded, empty_lines)
        if rate_hz is not None and carrier_hz:
            values, demodulation_hz = self._with_checked_carrier(values, rate_hz, carrier_hz, demodulation_hz)
        if (
            statements.mistakes
            or rate_hz is None
            or carrier_hz is None
            or pulse_rate_hz is None
            or pulse_time_s is None
        ):
            raise self._error()
        # Cut samples shift the time of the first one.
        if self.settings.samples is not None:
            first_s += self.settings.samples[0] / rate_hz
        values = self._with_sign(values, recorded)
        if demodulation_hz is not None and not self.for_map:
            values, rate_hz = self._mix_up(values, rate_hz, demodulation_hz, carrier_hz)
        return Recording(
            name=self.name,
            sha256=sha256(),
            format=file_format,
            values=values,
            recorded=recorded,
            scale_v=statements.number("scale_v", needed=False),
            sample_rate_hz=rate_hz,
            pulse_rate_hz=pulse_rate_hz,
            carrier_hz=carrier_hz,
            sound_speed_m_per_s=sound_speed,
            pulse_time_s=pulse_time_s,
            regular=regular,
            first_sample_s=first_s,
            line_position_m=position_m,
            inferred=tuple(statements.inferred),
            board=statements.contents.board,
            demodulation_hz=demodulation_hz,
            quantity=kind_of(self.settings.quantity),
        )

    def _check_any_echo(self, recorded: NDArray[np.bool_], empty_lines: NDArray[np.intp]) -> None:
        """Add a mistake if no selected record holds an echo. ``empty_lines``: numbers of the lines without any."""
        if recorded.any():
            return
        listed = ", ".join(map(str, empty_lines[:MAX_LISTED]))
        # A record of a mean is missing if it is missing in one of the lines.
        what = f"no selected record holds an echo ({plural(empty_lines.size, 'line')} without any: {listed or '-'})"
        self.statements.add_mistake("lines", what, "other lines, or another array")

    def _rates(self, axes: tuple[Dimension, ...]) -> tuple[float | None, float | None, float | None]:
        """Return sampling rate, carrier and sound speed; the carrier of a motion is 0."""
        number = self.statements.number
        if self.settings.quantity is None:
            sample_rate_hz, carrier_hz = number("sample_rate_hz"), number("carrier_hz")
            return sample_rate_hz, carrier_hz, number("sound_speed_m_per_s", needed=False)
        sound_speed_m_per_s = number("sound_speed_m_per_s", needed=False) or NOMINAL_SPEED_M_PER_S
        return depth_rate_hz(self.statements, sound_speed_m_per_s, "sample" in axes), 0.0, sound_speed_m_per_s

    def _in_si(self, values: NDArray[Any]) -> NDArray[Any]:
        """Return a motion in m or m/s, and echoes unchanged."""
        quantity = self.settings.quantity
        return values if quantity is None else si_motion(self.statements, values, quantity)

    def _error(self) -> SettingsError:
        return SettingsError(f"recording {self.name}", list(dict.fromkeys(self.statements.mistakes)))

    def _refuse_unused_settings(self, file_format: str) -> None:
        """Add a mistake for each setting that only another built-in format uses; importers may use any."""
        if file_format not in (*BUILT_IN, "array"):
            return
        changed = self.settings.model_dump(exclude_defaults=True)
        for used_by, keys in KEYS_OF_FORMAT.items():
            for key in keys:
                if key in changed and used_by != file_format:
                    what = f"only the format {used_by} uses {key}, the recording has the format {file_format}"
                    self.statements.add_mistake(key, what, f"without {key}, or format = {used_by}")

    def _arrange(self, array: NDArray[Any], axes: tuple[Dimension, ...]) -> NDArray[Any]:
        """Return the samples as (line, shot, pulse, sample), with I and Q as complex numbers."""
        names = [name for name in DIMENSIONS if name in axes]
        values = np.transpose(array, [axes.index(name) for name in names])
        if "iq" in names:
            values = values[..., 0] + 1j * values[..., 1]
        # Absent axes get a length of 1.
        for index, name in enumerate(DIMENSIONS[:4]):
            if name not in names:
                values = np.expand_dims(values, index)
        is_motion = self.settings.quantity is not None
        if values.shape[2] < MIN_PULSES or (values.shape[3] < MIN_SAMPLES and not is_motion):
            what = f"{values.shape[2]} pulses of {values.shape[3]} samples carry no motion"
            self.statements.add_mistake("axes", what, "at least 4 pulses of 8 samples, or another order of axes")
        return values

    def _cut_samples(self, values: NDArray[Any]) -> NDArray[Any]:
        """Return the stated range of samples; a mistake and all samples if the records are shorter."""
        if self.settings.samples is None:
            return values
        first, end = self.settings.samples
        if end > values.shape[-1]:
            what = f"{first} to {end} exceeds the {values.shape[-1]} samples of a record"
            self.statements.add_mistake("samples", what, f"[{min(first, values.shape[-1] - 8)}, {values.shape[-1]}]")
            return values
        return values[..., first:end]

    def _demodulation_hz(self, values: NDArray[Any]) -> float | None:
        """Return the demodulation frequency of I and Q; None for real samples, and a mistake if it is stated."""
        is_iq = np.iscomplexobj(values)
        demodulation_hz = self.statements.number("demodulation_hz", needed=is_iq)
        if demodulation_hz is not None and not is_iq and self.settings.demodulation_hz is not None:
            what = "demodulation_hz is stated, and the samples are real"
            self.statements.add_mistake("demodulation_hz", what, 'I and Q as complex numbers, or as an axis "iq" of 2')
        return demodulation_hz if is_iq else None

    def _find_recorded(self, values: NDArray[Any]) -> BoolArray:
        """Return which records (line, shot, pulse) hold an echo. A map marks its pixels itself: then all do.

        Values that are not finite are a mistake, unless they may be missing. Constant records, as of a channel that is
        not connected, are missing.
        """
        if self.for_map:
            return np.ones(values.shape[:3], np.bool_)
        # One shot in memory at a time.
        flags = np.array([[(_are_finite(shot), _are_constant(shot)) for shot in line] for line in values], np.bool_)
        finite, constant = flags[:, :, 0], flags[:, :, 1]
        not_finite = int((~finite).sum())
        if not_finite and self.settings.not_finite != "missing":
            what = f"{not_finite} of {finite.size} records hold values that are not finite: {_list_records(~finite)}"
            remedy = f'numbers of up to {MAX_VALUE:g}, or not_finite = "missing"'
            self.statements.add_mistake("", what, remedy)
        for marked, what in ((~finite, "values that are not finite"), (constant & finite, "one value throughout")):
            if marked.any():
                text = f"{plural(int(marked.sum()), 'record')} with {what}: missing ({_list_records(marked)})"
                self.statements.inferred.append(text)
        return np.asarray(finite & ~constant)

    def _select_lines(
        self, values: NDArray[Any], recorded: BoolArray, position_m: FloatArray | None
    ) -> tuple[NDArray[Any], BoolArray, FloatArray | None]:
        """Return values, existing records and positions of the selected lines, or of their mean as one line."""
        selection = select_lines(self.settings.lines or ("all" if self.for_map else None), values.shape[0])
        if isinstance(selection, Mistake):
            self.statements.mistakes.append(selection)
        selected, mean = (slice(0, 1), False) if isinstance(selection, Mistake) else selection
        values, recorded = values[selected], recorded[selected]
        position_m = None if position_m is None else position_m[selected]
        if not mean:
            if values.shape[0] > 1 and position_m is None and not self.for_map:
                what = f"{values.shape[0]} lines are selected, and their positions are not stated"
                remedy = "line_pitch_m = 0.3e-3, or line_position_m with one position per line"
                self.statements.add_mistake("line_position_m", what, remedy)
            return values, recorded, position_m
        self.statements.inferred.append(f"the mean of {values.shape[0]} lines is used")
        # A record of the mean exists if it exists in every line.
        recorded = np.asarray(recorded.all(axis=0, keepdims=True), np.bool_)
        position_m = None if position_m is None else position_m.mean(keepdims=True)
        return values.mean(axis=0, keepdims=True), recorded, position_m

    def _with_checked_carrier(
        self, values: NDArray[Any], rate_hz: float, carrier_hz: float, demodulation_hz: float | None
    ) -> tuple[NDArray[Any], float | None]:
        """Return samples and demodulation frequency; a mistake or warning if the echoes are not at the carrier.

        Real samples below twice the carrier become I and Q.
        """
        is_iq, add_mistake = np.iscomplexobj(values), self.statements.add_mistake
        if not is_iq and carrier_hz >= rate_hz / 2:
            unfolded = unfold(values, rate_hz, carrier_hz)
            if unfolded is None:
                what = f"a carrier of {carrier_hz:g} Hz does not fit a sampling rate of {rate_hz:g} Hz"
                what += ", and the echoes do not fold cleanly"
                add_mistake("carrier_hz", what, "the right one of the two, or demodulation_hz for I and Q")
                return values, demodulation_hz
            values, demodulation_hz, sentence = unfolded
            self.statements.inferred.append(sentence)
        if is_iq and demodulation_hz is None:
            return values, demodulation_hz
        band = echo_band(values, rate_hz, demodulation_hz or 0.0, carrier_hz)
        what, excluded = ("", False) if band is None else compare_with_carrier(band, carrier_hz, is_iq)
        if excluded and is_iq:
            remedy = "demodulation_hz = 0.0 if the carrier remains in depth, or the right carrier_hz or sample_rate_hz"
            add_mistake("demodulation_hz", f"{what}, demodulation_hz is {demodulation_hz:g}", remedy)
        elif excluded:
            remedy = "the right carrier_hz or sample_rate_hz, or samples = [first, end] around the echoes"
            add_mistake("carrier_hz", what, remedy)
        elif what:
            self.statements.inferred.append(f"WARNING {what}. Try: the right carrier_hz, or samples around the echoes")
        return values, demodulation_hz

    def _with_sign(self, values: NDArray[Any], recorded: BoolArray) -> NDArray[Any]:
        """Return the values with their sign, and zeros for missing records."""
        values = np.where(recorded[..., None], values, 0) if not recorded.all() else values
        if self.settings.sign > 0:
            return values
        if np.iscomplexobj(values):
            return values.conj()
        # The lowest integer has no negative of its type.
        return -values.astype(np.int32) if values.dtype.kind == "i" else -values

    def _mix_up(
        self, values: NDArray[Any], rate_hz: float, demodulation_hz: float, carrier_hz: float
    ) -> tuple[NDArray[Any], float]:
        """Return real samples of I and Q, and their rate."""
        samples, output_hz = to_radio_frequency(values, rate_hz, demodulation_hz, carrier_hz)
        self.statements.inferred.append(
            f"I and Q are mixed up by {demodulation_hz:g} Hz and interpolated from {rate_hz:g} Hz to {output_hz:g} Hz"
        )
        return samples, output_hz


def _are_finite(records: NDArray[Any]) -> BoolArray:
    """Return which ``records`` (pulse, sample) hold finite values of up to ``MAX_VALUE`` alone."""
    if records.dtype.kind in "iu":
        return np.ones(len(records), np.bool_)
    components = (records.real, records.imag) if records.dtype.kind == "c" else (records,)
    # Maximum and minimum of a record with NaN are NaN, which no comparison accepts.
    in_range = [
        (component.max(axis=-1) <= MAX_VALUE) & (component.min(axis=-1) >= -MAX_VALUE) for component in components
    ]
    return np.asarray(np.logical_and.reduce(in_range))


def _are_constant(records: NDArray[Any]) -> BoolArray:
    """Return which ``records`` (pulse, sample) hold one value throughout."""
    with np.errstate(invalid="ignore"):
        return np.asarray((records == records[:, :1]).all(axis=-1))


def _list_records(marked: BoolArray) -> str:
    """Return the numbers, from 1, of the first of the ``marked`` records (line, shot, pulse)."""
    indices = np.argwhere(marked)
    numbers = [
        f"line {line + 1} shot {shot + 1} pulse {pulse + 1}" for line, shot, pulse in indices[:MAX_LISTED].tolist()
    ]
    return ", ".join(numbers) + (f" and {len(indices) - MAX_LISTED} more" if len(indices) > MAX_LISTED else "")
