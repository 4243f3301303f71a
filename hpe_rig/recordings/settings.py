"""Settings of a recording from a sidecar file or options; SI units, the unit in every key."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, model_validator

from hpe_rig.bench import BoardName
from hpe_rig.scene import (
    DelayS,
    FrequencyHz,
    Mistake,
    SampleRateHz,
    SampleTimeS,
    Section,
    SettingsError,
    SpeedMPerS,
    VoltageV,
    mistakes_of,
    parse_toml,
    read_settings_text,
)

Dimension = Literal["line", "shot", "pulse", "sample", "iq"]
DIMENSIONS: tuple[Dimension, ...] = ("line", "shot", "pulse", "sample", "iq")
MAX_SIDECAR_BYTES = 50_000_000
"""A sidecar may list the times of a million pulses. It is not stored."""
EXCLUSIVE_KEYS = (
    ("pulse_time_s", "first_pulse_s"),
    ("pulse_time_s", "pulse_rate_hz"),
    ("first_sample_s", "first_sample_depth_m"),
    ("line_position_m", "line_pitch_m"),
    ("sample_rate_hz", "depth_step_m"),
)
"""Pairs of settings with the same meaning: only one of each pair may be given."""


KEYS_OF_FORMAT: Mapping[str, tuple[str, ...]] = {
    "csv": ("skip_rows", "columns", "delimiter", "decimal", "encoding", "transpose"),
    "raw": ("dtype", "byte_order", "header_bytes", "shape"),
    "alazar": ("board", "records_per_buffer", "channels", "channel", "headers", "input_range_v"),
}
"""Settings that one format alone uses."""


def _split_names(value: Any) -> Any:
    return [name.strip() for name in value.split(",")] if isinstance(value, str) else value


def _as_float(value: Any) -> Any:
    return float(value) if isinstance(value, int) and not isinstance(value, bool) else value


def _as_text(value: Any) -> Any:
    values = value if isinstance(value, list | tuple) else [value]
    return ",".join(map(str, values)) if all(type(item) is int for item in values) else value


Quantity = Literal[
    "displacement_m",
    "displacement_mm",
    "displacement_um",
    "displacement_nm",
    "velocity_m_per_s",
    "velocity_mm_per_s",
    "velocity_um_per_s",
]
Positive = Annotated[int, Field(ge=1, le=2**40, strict=True)]
Offset = Annotated[float, Field(ge=-0.1, le=0.1, strict=True)]


class RecordingSettings(Section):
    """Settings of a recording. The file or the scene supplies absent ones."""

    format: str | None = None
    """npy, npz, mat, hdf5, csv, wav, oscilloscope, raw, alazar, or an installed importer; default: by suffix."""
    variable: str | None = None
    """Name of the samples in a file that holds several arrays, such as "RF" or "/data/rf"."""
    axes: Annotated[tuple[Dimension, ...], BeforeValidator(_split_names), Field(min_length=1)] | None = None
    """Axes of the samples in the order of the file: line, shot, pulse, sample, and iq if I and Q alternate."""
    quantity: Quantity | None = None
    """What the values are, with its unit, if they are a motion that was estimated already; default: echoes."""
    depth_step_m: Annotated[float, Field(gt=0, le=0.1, strict=True)] | None = None
    """Distance in depth between the samples of such a motion."""
    sample_rate_hz: SampleRateHz | None = None
    """Sampling rate F_s; for I and Q the rate of the pairs."""
    pulse_rate_hz: FrequencyHz | None = None
    """Repetition rate f_prf of the tracking pulses."""
    carrier_hz: FrequencyHz | None = None
    """Frequency f_f of the tracking pulse."""
    demodulation_hz: Annotated[float, Field(ge=0, le=1e9, strict=True)] | None = None
    """Demodulation frequency of I and Q, 0 if they still hold the carrier; not for real samples."""
    sound_speed_m_per_s: SpeedMPerS | None = None
    """Sound speed that converts times to depths."""
    pulse_time_s: Annotated[tuple[float, ...], Field(min_length=2)] | None = None
    """Time of every tracking pulse after the first toneburst (or after another time zero of the phases)."""
    first_pulse_s: DelayS | None = None
    """Time of the first tracking pulse after that time zero; default: 0."""
    first_sample_s: SampleTimeS | None = None
    """Time of the first sample after the onset of its tracking pulse, negative if earlier; default: 0."""
    first_sample_depth_m: Annotated[float, Field(ge=0, le=10, strict=True)] | None = None
    """Depth of the first sample, instead of its time."""
    line_position_m: Annotated[tuple[Offset, ...], Field(min_length=1)] | None = None
    """Lateral offset of each line from the push."""
    line_pitch_m: Annotated[float, Field(gt=0, le=0.01, strict=True)] | None = None
    """Distance between lines; the middle of all lines is at 0."""
    lines: str | None = None
    """Selected lines, counted from 1: "12", "10-20", "all": one result each; "mean" or "mean:10-20": their mean."""
    samples: tuple[Annotated[int, Field(ge=0)], Annotated[int, Field(ge=1)]] | None = None
    """Range of samples of every record, counted from 0: [first, end], without the sample at end."""
    scale_v: Annotated[VoltageV | float, BeforeValidator(_as_float), Field(gt=0, le=1e6)] | None = None
    """Volts of a value of 1; default: unit of a text column, or 1 V; integers are codes of a range of 1 V."""
    sign: Literal[1, -1] = 1
    """-1 negates real samples; it reads I and Q as I - jQ, which reverses the motion."""
    not_finite: Literal["refuse", "missing"] = "refuse"
    """Treatment of records with values that are not finite: refuse them, or count them as missing."""
    skip_rows: Annotated[int, Field(ge=0, le=10**9, strict=True)] = 0
    """Lines of a text file to skip; the lines before the first numbers are skipped in any case."""
    columns: Annotated[str, BeforeValidator(_as_text)] | None = None
    """Columns of a text file with samples, counted from 1, such as "2-61" or "2,4"; default: all but times."""
    delimiter: Annotated[str, Field(min_length=1, max_length=10)] | None = None
    """Delimiter of a text file: comma, semicolon, tab, blank, or another character; default: inferred."""
    decimal: Literal[".", ","] | None = None
    """Decimal sign of a text file; default: inferred."""
    encoding: Annotated[str, Field(min_length=1, max_length=40)] | None = None
    """Encoding of a text file, such as utf-16 or latin-1; default: by its byte-order mark, or UTF-8."""
    transpose: bool = False
    """Whether the rows of a text file are its columns, as if it had been transposed before it was written."""
    dtype: Literal["int8", "uint8", "int16", "uint16", "int32", "float32", "float64"] | None = None
    """Type of raw values."""
    byte_order: Literal["little", "big"] = "little"
    """Byte order of raw values."""
    header_bytes: Annotated[int, Field(ge=0, le=2**30, strict=True)] = 0
    """Bytes before the first raw value."""
    shape: Annotated[tuple[Positive, ...], Field(min_length=1)] | None = None
    """Lengths of the axes of raw values, the slowest first."""
    board: BoardName | None = None
    """AlazarTech board that wrote the records."""
    record_samples: Positive | None = None
    """Samples of one record: of that board and one channel, or of a signal that holds one record after the other."""
    records_per_buffer: Positive | None = None
    """Records of one channel in a buffer; for records of two channels without headers."""
    channels: Literal[1, 2] = 1
    """Number of channels that the board recorded."""
    channel: Literal["A", "B"] = "A"
    """Channel to read."""
    headers: bool | None = None
    """Whether each record has a header of 16 bytes (traditional AutoDMA); default: inferred from the file."""
    input_range_v: VoltageV | None = None
    """Input range, plus and minus; default: from the headers."""

    @model_validator(mode="after")
    def _check_axes(self) -> RecordingSettings:
        axes = self.axes or ("pulse", "sample")
        if len(set(axes)) < len(axes):
            raise ValueError("an axis is named twice: each of line, shot, pulse, sample, iq at most once")
        if self.quantity is not None and "pulse" in axes:
            return self
        consecutive = self.record_samples is not None
        needed = {"pulse": not consecutive, "sample": consecutive or self.quantity is None}
        if missing := [axis for axis, is_needed in needed.items() if is_needed and axis not in axes]:
            raise ValueError(f'axes lacks {" and ".join(missing)}, such as axes = "line,pulse,sample"')
        return self

    @model_validator(mode="after")
    def _check_exclusive_keys(self) -> RecordingSettings:
        if self.depth_step_m is not None and self.quantity is None:
            raise ValueError("depth_step_m belongs to a motion: quantity as well, or sample_rate_hz of echoes")
        for first, second in EXCLUSIVE_KEYS:
            if getattr(self, first) is not None and getattr(self, second) is not None:
                raise ValueError(f"{first} and {second} exclude each other: give one of them")
        if self.samples is not None and self.samples[0] >= self.samples[1]:
            raise ValueError("samples ends before it begins: [first, end] with first < end")
        return self


def read_settings(
    recording: Path | None, sidecar: Path | None = None, options: Mapping[str, Any] | None = None
) -> tuple[RecordingSettings, dict[str, str]]:
    """Return the settings of ``recording`` and the origin of each; options take precedence over the sidecar.

    ``sidecar`` is a TOML file. By default it is ``RECORDING.toml``, or the recording's name with that suffix, if such a
    file exists and is no scene. Raises ``SettingsError`` with every mistake.
    """
    options = dict(options or {})
    path = sidecar or _default_sidecar(recording)
    stated = {} if path is None else _read_sidecar(path)
    if sidecar is None and {"tracking", "acquisition"} & stated.keys():
        # A scene has the name of the recording.
        path, stated = None, {}
    # An option also replaces the settings of the sidecar that have the same meaning.
    replaced = {old for pair in EXCLUSIVE_KEYS for key, old in (pair, pair[::-1]) if key in options}
    stated = {key: value for key, value in stated.items() if key not in replaced}
    merged = stated | options
    if mistakes := mistakes_of(RecordingSettings, merged):
        raise SettingsError(_source_text(recording, path, options), mistakes)
    origins = dict.fromkeys(stated, "" if path is None else path.name) | dict.fromkeys(options, "an option")
    return RecordingSettings.model_validate(merged), origins


def _read_sidecar(path: Path) -> dict[str, Any]:
    try:
        return parse_toml(read_settings_text(path, MAX_SIDECAR_BYTES), f"sidecar {path.name}", MAX_SIDECAR_BYTES)
    except (OSError, UnicodeDecodeError) as error:
        why = getattr(error, "strerror", None) or "it is no UTF-8 text"
        raise SettingsError(f"sidecar {path}", [Mistake("", f"cannot be read ({why})", "its path")]) from None


def _default_sidecar(recording: Path | None) -> Path | None:
    if recording is None:
        return None
    paths = (recording.with_name(f"{recording.name}.toml"), recording.with_suffix(".toml"))
    return next((path for path in paths if path.is_file() and path != recording), None)


def _source_text(recording: Path | None, sidecar: Path | None, options: Mapping[str, Any]) -> str:
    """Return the name of the recording and of the sources of its settings."""
    name = "recording" if recording is None else f"recording {recording.name}"
    sources = [*([sidecar.name] if sidecar else []), *(["options"] if options else [])]
    return f"{name}, {' and '.join(sources)}" if sources else name
