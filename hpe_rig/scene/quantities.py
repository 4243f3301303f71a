"""Types of the values in settings files, each with its bounds.

The bounds are a decade or more beyond any bench or specimen. They detect a forgotten unit or a wrong exponent at the
key that has it, and keep the arithmetic far from overflow.
"""

from __future__ import annotations

import math
from datetime import date, datetime, time
from typing import Annotated, Any

from pydantic import AfterValidator, BeforeValidator, Field, ValidationInfo, WithJsonSchema

from hpe_rig.scene.estimator_table import BUILT_IN_ESTIMATORS, checked_estimator
from hpe_rig.scene.validation import STORED

FrequencyHz = Annotated[float, Field(ge=1e-3, le=1e9, strict=True)]
"""Rates and carriers: from a period of a quarter of an hour to 1 GHz."""
SampleRateHz = Annotated[float, Field(ge=1e-3, le=1e11, strict=True)]
"""Sampling rates: up to 100 GS/s; the digitizer's driver knows the rates of its board."""
VibrationHz = Annotated[float, Field(ge=1e-3, le=1e6, strict=True)]
"""Vibration frequencies; tissue follows none near 1 MHz."""
DurationS = Annotated[float, Field(ge=1e-9, le=1e5, strict=True)]
"""Lengths of bursts, windows and shots: up to a day."""
DelayS = Annotated[float, Field(ge=0, le=1e3, strict=True)]
"""Programmed delays, and delays of windows."""
SampleTimeS = Annotated[float, Field(ge=-1.0, le=1e3, strict=True)]
"""Times of samples after the onset of a pulse: oscilloscopes also record before their trigger."""
LatencyS = Annotated[float, Field(ge=0, le=1.0, strict=True)]
"""Delays of cables and latencies of instruments."""
LengthM = Annotated[float, Field(ge=1e-9, le=10.0, strict=True)]
"""Depths, gates and beam widths."""
OffsetM = Annotated[float, Field(ge=-0.1, le=0.1, strict=True)]
"""Offsets of the tracking transducer and of gates."""
AmplitudeM = Annotated[float, Field(ge=1e-15, le=1e-2, strict=True)]
"""Vibration amplitudes: up to 1 cm."""
SpeedMPerS = Annotated[float, Field(ge=10.0, le=1e5, strict=True)]
"""Longitudinal sound speeds; diamond has 18 km/s."""
ModulusPa = Annotated[float, Field(ge=1e-2, le=1e12, strict=True)]
"""Shear moduli; diamond has 0.5 TPa."""
ViscosityPaS = Annotated[float, Field(ge=0, le=1e6, strict=True)]
"""Shear viscosities."""
DensityKgPerM3 = Annotated[float, Field(ge=0.1, le=1e5, strict=True)]
"""Densities, from a gas to beyond any metal."""
VoltageV = Annotated[float, Field(ge=1e-6, le=1e4, strict=True)]
"""Amplitudes, ranges and levels."""
PressurePa = Annotated[float, Field(ge=1.0, le=1e9, strict=True)]
"""Sound pressures; water cavitates far below 1 GPa."""
IntensityWPerM2 = Annotated[float, Field(ge=1e-6, le=1e12, strict=True)]
"""Acoustic intensities; 1e12 W/m2 correspond to 1 GPa in water."""
RatioDb = Annotated[float, Field(ge=-100.0, le=200.0, strict=True)]
"""Ratios of powers."""
Fraction = Annotated[float, Field(ge=1e-12, le=1, strict=True)]
"""Fractions of a whole, above zero."""
Count = Annotated[int, Field(ge=1, le=1_000_000, strict=True)]
"""Numbers of things."""
Seed = Annotated[int, Field(ge=0, le=2**63 - 1, strict=True)]
"""Seeds of random numbers, as HDF5 stores them."""
Widths = tuple[LengthM, LengthM, LengthM]
"""Standard deviations of a Gaussian in x, y and z."""


def _as_list(value: Any) -> Any:
    return value if isinstance(value, list | tuple) else [value]


OneOrMoreDurations = Annotated[
    tuple[DurationS, ...],
    BeforeValidator(_as_list, json_schema_input_type=DurationS | list[DurationS]),
    Field(min_length=1),
]
OneOrMoreFractions = Annotated[
    tuple[Fraction, ...],
    BeforeValidator(_as_list, json_schema_input_type=Fraction | list[Fraction]),
    Field(min_length=1),
]


def _finite_number(value: Any) -> Any:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise ValueError(f"{str(value)[:40]!r} is no number: a finite number without quotes")
    return value


AnyNumber = Annotated[Any, AfterValidator(_finite_number), WithJsonSchema({"type": "number"})]
"""A value of a swept key; the key has its own bounds."""


def _installed_estimator(name: str, info: ValidationInfo) -> str:
    return checked_estimator(name, stored=info.context == STORED)


Estimator = Annotated[
    str,
    Field(strict=True, json_schema_extra={"examples": list(BUILT_IN_ESTIMATORS)}),
    AfterValidator(_installed_estimator),
]
"""Name of an estimator, of this package or of an installed one."""

MAX_TITLE_CHARACTERS = 300
MAX_NOTES, MAX_NOTE_NAME_CHARACTERS, MAX_NOTE_CHARACTERS = 100, 60, 2000


def _one_line(text: str) -> str:
    if len(text) > MAX_TITLE_CHARACTERS or not text.isprintable():
        raise ValueError(
            f"a title is one line of at most {MAX_TITLE_CHARACTERS} characters: shorten it, without line breaks"
        )
    return text


Title = Annotated[str, AfterValidator(_one_line)]


def _note(value: Any) -> Any:
    """Return a note: a text, a number, or true or false; a date or time of TOML becomes its ISO 8601 text."""
    if isinstance(value, datetime | date | time):
        return value.isoformat()
    if not isinstance(value, str | int | float):
        raise ValueError("a note is a text, a number, a date, or true or false: one key a note, no table or list")
    if isinstance(value, str) and (len(value) > MAX_NOTE_CHARACTERS or not value.replace("\n", "").isprintable()):
        raise ValueError(f"a note is a text of at most {MAX_NOTE_CHARACTERS} printable characters: shorten it")
    # JSON and HDF5 store whole numbers of 64 bits.
    if isinstance(value, int) and value.bit_length() > 63:
        raise ValueError("a whole number of more than 63 bits: put it in quotes")
    return value


def _notes_with_names(notes: dict[str, Any]) -> dict[str, Any]:
    for name in notes:
        if not 0 < len(name) <= MAX_NOTE_NAME_CHARACTERS or not name.isprintable():
            limit = MAX_NOTE_NAME_CHARACTERS
            raise ValueError(f"{name[:limit]!r} cannot be the name of a note: 1 to {limit} printable characters")
    return notes


_NoteValue = Annotated[Any, BeforeValidator(_note), WithJsonSchema({"type": ["string", "number", "boolean"]})]
Notes = Annotated[dict[str, _NoteValue], Field(max_length=MAX_NOTES), AfterValidator(_notes_with_names)]
"""Notes of the operator by name, in the order of the scene's file."""
