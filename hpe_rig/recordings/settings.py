"""Settings of a recording: what a sidecar file or an option may say of it; SI units, the unit in every key."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, model_validator

from hpe_rig.scene import (
    DelayS,
    FrequencyHz,
    Mistake,
    Section,
    SettingsError,
    SpeedMPerS,
    VoltageV,
    mistakes_of,
    parse_toml,
    read_settings_text,
)

Axis = Literal["line", "shot", "pulse", "sample", "iq"]
AXES: tuple[Axis, ...] = ("line", "shot", "pulse", "sample", "iq")
MOST_SIDECAR_BYTES = 50_000_000
"""Length of a sidecar, which may list the times of a million pulses and is not stored."""
Positive = Annotated[int, Field(ge=1, le=2**40, strict=True)]


def _as_axes(value: Any) -> Any:
    return [part.strip() for part in value.split(",")] if isinstance(value, str) else value


def _as_number(value: Any) -> Any:
    return float(value) if isinstance(value, int) and not isinstance(value, bool) else value


Offset = Annotated[float, Field(ge=-0.1, le=0.1, strict=True)]


class RecordingSettings(Section):
    """What is known of a recording beside its samples; what is absent is taken from the file, or from the scene."""

    format: str | None = None
    """Format: npy, npz, mat, hdf5, csv, raw, alazar, or an installed importer; absent: by the file's ending."""
    variable: str | None = None
    """Name of the samples in a file that holds several arrays, such as "RF" or "/data/rf"."""
    axes: Annotated[tuple[Axis, ...], BeforeValidator(_as_axes), Field(min_length=1)] | None = None
    """Axes of the samples in the order of the file: line, shot, pulse, sample, and iq where I and Q alternate."""
    sample_rate_hz: FrequencyHz | None = None
    """Sampling rate F_s; of I and Q that of the pairs."""
    pulse_rate_hz: FrequencyHz | None = None
    """Repetition rate f_prf of the tracking pulses."""
    carrier_hz: FrequencyHz | None = None
    """Frequency f_f of the tracking pulse."""
    demodulation_hz: FrequencyHz | None = None
    """Frequency that I and Q were mixed down by; only for these."""
    sound_speed_m_per_s: SpeedMPerS | None = None
    """Sound speed with which depths are counted."""
    pulse_time_s: Annotated[tuple[float, ...], Field(min_length=2)] | None = None
    """Time of every tracking pulse after the first toneburst (or after whatever phases are counted from)."""
    first_pulse_s: DelayS | None = None
    """Time of the first tracking pulse after that; absent: 0."""
    first_sample_s: DelayS | None = None
    """Time of the first sample after the onset of its tracking pulse; absent: 0."""
    first_sample_depth_m: Annotated[float, Field(ge=0, le=10, strict=True)] | None = None
    """The same as a depth."""
    line_position_m: Annotated[tuple[Offset, ...], Field(min_length=1)] | None = None
    """Where each line lies beside the push."""
    line_pitch_m: Annotated[float, Field(gt=0, le=0.01, strict=True)] | None = None
    """Distance from line to line; the middle of all lines lies at 0."""
    lines: str | None = None
    """Lines taken, counted from 1: "12", "10-20", "all": each a place; "mean" or "mean:10-20": their mean."""
    samples: tuple[Annotated[int, Field(ge=0)], Annotated[int, Field(ge=1)]] | None = None
    """Samples taken of every record: from the first, counted from 0, up to before the second."""
    scale_v: Annotated[VoltageV | float, BeforeValidator(_as_number), Field(gt=0, le=1e6)] | None = None
    """Volts of a value 1; absent: values are volts, whole numbers are codes of a range of 1 V."""
    sign: Literal[1, -1] = 1
    """-1 turns the samples over; of I and Q it says that they turn the other way, as I - jQ: motion then reverses."""
    not_finite: Literal["refuse", "missing"] = "refuse"
    """What to do with records that hold values which are not finite: refuse, or count them as missing."""
    dtype: Literal["int8", "uint8", "int16", "uint16", "int32", "float32", "float64"] | None = None
    """Type of raw values."""
    byte_order: Literal["little", "big"] = "little"
    """Byte order of raw values."""
    header_bytes: Annotated[int, Field(ge=0, le=2**30, strict=True)] = 0
    """Bytes before the first raw value."""
    shape: Annotated[tuple[Positive, ...], Field(min_length=1)] | None = None
    """Lengths of the axes of raw values, the first the slowest."""
    board: Literal["ATS460", "ATS9350", "ATS9440", "ATS9462", "ATS9870"] | None = None
    """AlazarTech board that wrote the records."""
    record_samples: Positive | None = None
    """Samples of a record of that board, of one channel."""
    records_per_buffer: Positive | None = None
    """Records of a channel in a buffer; of records without headers with two channels."""
    channels: Literal[1, 2] = 1
    """Channels that the board recorded."""
    channel: Literal["A", "B"] = "A"
    """Channel taken."""
    headers: bool | None = None
    """Whether 16 bytes stand before every record (traditional AutoDMA); absent: as the file's size and bytes say."""
    input_range_v: VoltageV | None = None
    """Input range, plus and minus; absent: as the headers say."""

    @model_validator(mode="after")
    def _axes_that_fit(self) -> RecordingSettings:
        axes = self.axes or ("pulse", "sample")
        if len(set(axes)) < len(axes):
            raise ValueError("an axis is named twice: each of line, shot, pulse, sample, iq at most once")
        if not {"pulse", "sample"} <= set(axes):
            raise ValueError('axes lacks pulse or sample: both are needed, such as axes = "line,pulse,sample"')
        return self

    @model_validator(mode="after")
    def _one_of_two(self) -> RecordingSettings:
        for one, other in (
            ("pulse_time_s", "first_pulse_s"),
            ("pulse_time_s", "pulse_rate_hz"),
            ("first_sample_s", "first_sample_depth_m"),
            ("line_position_m", "line_pitch_m"),
        ):
            if getattr(self, one) is not None and getattr(self, other) is not None:
                raise ValueError(f"{one} and {other} say the same: give one of them")
        if self.samples is not None and self.samples[0] >= self.samples[1]:
            raise ValueError("samples ends before it begins: [first, end] with first < end")
        return self


def read_settings(
    recording: Path | None, sidecar: Path | None = None, options: Mapping[str, Any] | None = None
) -> tuple[RecordingSettings, dict[str, str]]:
    """Return the settings of ``recording`` and where each is stated; options count before the sidecar.

    ``sidecar``: its TOML file; absent, ``RECORDING.toml`` or the recording's name with that ending, if there is one
    and it is no scene.
    Raises ``SettingsError`` with every mistake.
    """
    options = dict(options or {})
    path = sidecar or _beside(recording)
    stated: dict[str, Any] = {}
    if path is not None:
        try:
            text = read_settings_text(path, MOST_SIDECAR_BYTES)
            stated = parse_toml(text, f"sidecar {path.name}", MOST_SIDECAR_BYTES)
        except (OSError, UnicodeDecodeError) as error:
            why = getattr(error, "strerror", None) or "it is no UTF-8 text"
            raise SettingsError(f"sidecar {path}", [Mistake("", f"cannot be read ({why})", "its path")]) from None
    if sidecar is None and {"tracking", "acquisition"} & stated.keys():
        # The scene, which has the recording's name.
        path, stated = None, {}
    where = dict.fromkeys(stated, "" if path is None else path.name) | dict.fromkeys(options, "an option")
    merged = stated | options
    for ours, others in (("pulse_time_s", ("pulse_rate_hz", "first_pulse_s")), ("line_position_m", ("line_pitch_m",))):
        # An option takes the place of what the sidecar says in another way.
        for one, rest in ((ours, others), *((other, (ours,)) for other in others)):
            if one in options:
                for other in rest:
                    if other not in options:
                        merged.pop(other, None)
    if mistakes := mistakes_of(RecordingSettings, merged):
        raise SettingsError(_named(recording, path, options), mistakes)
    return RecordingSettings.model_validate(merged), {name: where[name] for name in merged}


def parse_options(texts: Sequence[str]) -> dict[str, Any]:
    """Return ``KEY=VALUE`` texts as settings, values as in TOML, and as text where they are none of it."""
    options: dict[str, Any] = {}
    mistakes = []
    for text in texts:
        key, equals, value = text.partition("=")
        if not equals:
            mistakes.append(Mistake(text, "this is no setting", "KEY=VALUE, such as sample_rate_hz=50e6"))
            continue
        try:
            options[key.strip()] = tomllib.loads(f"value = {value}")["value"]
        except (tomllib.TOMLDecodeError, ValueError):
            options[key.strip()] = value.strip()
    if mistakes:
        raise SettingsError("--set", mistakes)
    return options


def _beside(recording: Path | None) -> Path | None:
    if recording is None:
        return None
    names = (recording.with_name(f"{recording.name}.toml"), recording.with_suffix(".toml"))
    return next((path for path in names if path.is_file() and path != recording), None)


def _named(recording: Path | None, sidecar: Path | None, options: Mapping[str, Any]) -> str:
    what = "recording" if recording is None else f"recording {recording.name}"
    said = [*([sidecar.name] if sidecar else []), *(["options"] if options else [])]
    return f"{what}, {' and '.join(said)}" if said else what
