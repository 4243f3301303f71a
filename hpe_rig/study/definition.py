"""Definition of a study in its TOML file: base scene, axes, number of realisations, estimators."""

from __future__ import annotations

import contextlib
import itertools
import math
import os
from collections.abc import Mapping
from dataclasses import replace
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Discriminator, Field, Tag, model_validator

from hpe_rig.scene import (
    AmplitudeM,
    Axis,
    Count,
    Estimator,
    Mistake,
    Section,
    Seed,
    SettingsError,
    Title,
    named_text,
    parse_toml,
    validated,
)

Reading = Literal["physical", "literal", "as_printed", "one_draw"]
Finite = Annotated[float, Field(ge=-1e100, le=1e100)]

MAX_POINTS = 1_000_000
"""Limit on the cases of a study; each is a file."""
RESULT_COLUMNS = (
    "reading",
    "estimator",
    "frequency_hz",
    "refused",
    "warned",
    "draws",
    "noise",
    "seconds",
    "peak_memory_bytes",
    "case",
)
"""Columns of every result, in addition to those of amplitude and phase: no axis may have their names."""


class AxisRange(Section):
    """Evenly or logarithmically spaced values, both ends included."""

    start: Finite
    """First value."""
    stop: Finite
    """Last value."""
    count: Annotated[int, Field(ge=2, le=100_000, strict=True)]
    """Number of values."""
    spacing: Literal["linear", "log"] = "linear"
    """Equal differences or equal ratios."""

    @model_validator(mode="after")
    def _ratios_need_one_sign(self) -> AxisRange:
        if self.spacing == "log" and not self.start * self.stop > 0:
            raise ValueError("equal ratios cannot cross zero: give start and stop the same sign, or spacing = 'linear'")
        return self

    def values(self) -> list[float]:
        """Return the values in order, rounded to 12 digits so that a value in a file equals the computed one."""
        spaced = np.linspace if self.spacing == "linear" else np.geomspace
        return [float(f"{value:.12g}") for value in spaced(self.start, self.stop, self.count)]


def _kind(values: Any) -> str:
    return "range" if isinstance(values, Mapping | AxisRange) else "list"


AxisValues = Annotated[Annotated[list[Any], Tag("list")] | Annotated[AxisRange, Tag("range")], Discriminator(_kind)]
"""The tags keep a mistake in a range from being reported for the list too."""


class AxisTable(Section):
    """Keys varied together: point n takes value n of every key (zip). Several axes form their product."""

    name: Annotated[str, Field(min_length=1, max_length=40)]
    """Name of the axis: its column in the table."""
    unit: str = ""
    """Unit of the displayed values."""
    keys: Annotated[dict[str, AxisValues], Field(min_length=1)]
    """Scene keys, such as "tracking.pulse_rate_hz" or "simulation.motion[0].amplitude_m", each with its values."""
    shown: list[Finite | str] | None = None
    """Values in tables and figures; absent: those of the first key."""

    @model_validator(mode="after")
    def _equal_counts(self) -> AxisTable:
        counts = {key: len(values) for key, values in self.axis().columns.items()}
        if self.shown is not None:
            counts["shown"] = len(self.shown)
        if len(set(counts.values())) > 1 or 0 in counts.values():
            listed = ", ".join(f"{key} {count}" for key, count in counts.items())
            raise ValueError(f"keys of one axis need the same number of values, at least 1, not {listed}")
        return self

    def axis(self) -> Axis:
        """Return the axis with the values of every range."""
        columns = {
            key: tuple(values.values() if isinstance(values, AxisRange) else values)
            for key, values in self.keys.items()
        }
        labels = next(iter(columns.values())) if self.shown is None else tuple(self.shown)
        return Axis(self.name, columns, self.unit, labels)


class Definition(Section):
    """One study."""

    title: Title
    """One line that names the varied quantity."""
    scene: str
    """Base scene: a shipped scene's name, or a TOML file in the folder of the study's."""
    scatterers: Count = 500
    """Draws of scatterers for each case; with ``standard_error_m`` their maximum."""
    noise: Count = 2
    """Noise draws for each draw of scatterers; from 2 on the jitter is split into speckle and noise."""
    standard_error_m: AmplitudeM | None = None
    """Stop a case once the standard error of its mean amplitudes is below this."""
    seed: Seed = 1
    """Seed of every random number."""
    common: Literal["all"] | tuple[str, ...] = ()
    """Axes along which the random numbers are the same, so that chance does not hide differences. "all": the same in
    all cases, and in other studies with this seed; a case that two studies share is then computed once."""
    readings: dict[Reading, Annotated[tuple[Estimator, ...], Field(min_length=1)]] = Field(
        default={"physical": ("cross_spectrum", "coherent")}, min_length=1
    )
    """Estimators by reading of the paper. "physical": the scene as it is. "literal": eq. (11) without axial delay, and
    scatterers in the gate only. "as_printed": literal, and the amplitude keeps the gain of a difference of pulses.
    "one_draw": physical, with one draw of scatterers for ``scatterers`` times ``noise`` realisations of noise."""
    simulate: Literal["gate", "bench"] | None = None
    """"gate": echoes of the gate under a prescribed motion with white noise, thousands a second. "bench": every
    realisation is a whole measurement of any scene. Absent: "gate" if the base scene has nothing beyond it."""
    corrected: bool = False
    """For "bench": amplitude and phase are those of the report, corrected for beam averaging."""
    set: dict[str, Any] = Field(default_factory=dict)
    """Scene keys with values that replace those of the base scene in every case."""
    axes: Annotated[tuple[AxisTable, ...], Field(min_length=1)]
    """The varied quantities."""

    @property
    def sweep_axes(self) -> tuple[Axis, ...]:
        """Axes with all their values."""
        return tuple(table.axis() for table in self.axes)

    @model_validator(mode="after")
    def _names_are_known_and_unique(self) -> Definition:
        names = [axis.name for axis in self.axes]
        if len(set(names)) < len(names):
            raise ValueError(f"axes are named {', '.join(names)}: give each a different name")
        reserved = [name for name in names if name in RESULT_COLUMNS or name.startswith(("amplitude_", "phase_"))]
        if reserved:
            raise ValueError(f"axes are named {', '.join(reserved)}, as columns of every result are: rename them")
        if (points := math.prod(len(axis) for axis in self.sweep_axes)) > MAX_POINTS:
            raise ValueError(
                f"its axes have {points:.3g} points in all, more than {MAX_POINTS}: reduce the number of values"
            )
        unknown = [name for name in self.common if name not in names] if self.common != "all" else []
        if unknown:
            raise ValueError(f"common names {', '.join(unknown)}, which is no axis; the axes are {', '.join(names)}")
        return self


class Collection(Section):
    """Several studies in one run; a case that several of them share is computed once."""

    title: Title
    """One line that describes them."""
    studies: Annotated[tuple[str, ...], Field(min_length=1)]
    """Names of shipped studies, or files."""


def shipped_studies() -> dict[str, str]:
    """Return the shipped definitions' texts by name, in the order of their figures."""
    folder = resources.files("hpe_rig.study") / "definitions"
    files = [file for file in folder.iterdir() if file.name.endswith(".toml")]
    texts = {file.name.removesuffix(".toml"): file.read_text(encoding="utf-8") for file in files}
    return dict(sorted(texts.items(), key=lambda item: [word.zfill(3) for word in item[0].split("-")]))


def read_studies(
    name_or_path: str | os.PathLike[str], replaced: Mapping[str, Any] | None = None
) -> dict[str, tuple[Definition, Path]]:
    """Return the definitions by name, each with the folder of its file, of a study or of a collection's studies.

    ``replaced``: top-level keys from the command line; its ``points`` is the count of every range. Raises
    ``SettingsError`` with every mistake, and ``TypeError`` for anything but a name or path.
    """
    if not isinstance(name_or_path, str | os.PathLike):
        kind = type(name_or_path).__name__
        raise TypeError(f"a study must be the name of a shipped one or the path of a TOML file, not {kind}")
    # A collection lists studies by name or path, relative to its own folder.
    shipped, folder = shipped_studies(), Path(name_or_path).parent
    name, text = named_text(name_or_path, shipped, "study")
    tables = parse_toml(text, f"study {name}")
    if "studies" not in tables:
        return {name: (_definition(name, tables, replaced or {}), folder)}
    studies: dict[str, tuple[Definition, Path]] = {}
    mistakes: list[Mistake] = []
    for entry in validated(Collection, tables, f"study {name}").studies:
        try:
            study_name, text = named_text(entry, shipped, "study", folder)
            definition = _definition(study_name, parse_toml(text, f"study {study_name}"), replaced or {})
        except SettingsError as error:
            mistakes += [replace(mistake, path=f"{entry} {mistake.path}".rstrip()) for mistake in error.mistakes]
            continue
        if study_name in studies:
            what = f"its results would replace those of another {study_name}"
            mistakes.append(Mistake(entry, what, "another file name"))
        studies[study_name] = (definition, (folder / entry).parent)
    if mistakes:
        raise SettingsError(f"study {name}", mistakes)
    return studies


def _definition(name: str, tables: dict[str, Any], replaced: Mapping[str, Any]) -> Definition:
    tables = tables | {key: value for key, value in replaced.items() if key != "points" and value is not None}
    if (points := replaced.get("points")) is not None:
        # Validation below reports malformed axes.
        with contextlib.suppress(AttributeError, LookupError, TypeError):
            for values in itertools.chain(*(axis["keys"].values() for axis in tables["axes"])):
                if isinstance(values, dict):
                    values["count"] = points
    return validated(Definition, tables, f"study {name}")
