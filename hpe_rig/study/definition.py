"""Definition of a study as its file gives it: base scene, what is varied, number of realisations, estimators."""

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

MOST_POINTS = 1_000_000
"""Far more cases than anyone waits for; each is a file."""
COLUMNS = (
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
"""Columns of every result, beside those of amplitude and phase: no axis has their names."""


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
            raise ValueError("equal ratios never pass zero: give start and stop one sign, or spacing = 'linear'")
        return self

    def values(self) -> list[float]:
        """Return the values in order, rounded to 12 digits so that a written value is the same value."""
        spaced = np.linspace if self.spacing == "linear" else np.geomspace
        return [float(f"{value:.12g}") for value in spaced(self.start, self.stop, self.count)]


def _kind(values: Any) -> str:
    return "range" if isinstance(values, Mapping | AxisRange) else "list"


AxisValues = Annotated[Annotated[list[Any], Tag("list")] | Annotated[AxisRange, Tag("range")], Discriminator(_kind)]
"""A mistake in a range is not also one of a list."""


class Axis(Section):
    """What is varied together: the n-th value of every key at once (zip). Several axes: each with each (product)."""

    name: Annotated[str, Field(min_length=1, max_length=40)]
    """Name of the axis: its column in the table."""
    unit: str = ""
    """Unit of the values shown."""
    keys: Annotated[dict[str, AxisValues], Field(min_length=1)]
    """Scene keys, such as "tracking.pulse_rate_hz" or "simulation.motion[0].amplitude_m", each with its values."""
    shown: list[Finite | str] | None = None
    """AxisValues that tables and figures show; absent: those of the first key."""

    @model_validator(mode="after")
    def _as_many_values_everywhere(self) -> Axis:
        counts = {key: len(values) for key, values in self.columns().items()}
        if self.shown is not None:
            counts["shown"] = len(self.shown)
        if len(set(counts.values())) > 1 or 0 in counts.values():
            listed = ", ".join(f"{key} {count}" for key, count in counts.items())
            raise ValueError(f"keys varied together need equally many values, not {listed}: give one each, at least 1")
        return self

    def columns(self) -> dict[str, list[Any]]:
        """Return the values of every key."""
        return {key: values.values() if isinstance(values, AxisRange) else values for key, values in self.keys.items()}

    def values(self) -> list[Any]:
        """Return what is shown of every point along the axis."""
        return list(self.shown) if self.shown is not None else next(iter(self.columns().values()))


class Definition(Section):
    """One study."""

    title: Title
    """One line that says what is varied."""
    scene: str
    """Base scene: a shipped scene's name, or a TOML file beside the study's."""
    scatterers: Count = 500
    """Draws of scatterers a case; with ``standard_error_m`` the most of them."""
    noise: Count = 2
    """Noise draws for each draw of scatterers; from 2 on the jitter is split into speckle and noise."""
    standard_error_m: AmplitudeM | None = None
    """Stop a case once the standard error of its mean amplitudes is below this."""
    seed: Seed = 1
    """Seed of every random number."""
    common: Literal["all"] | tuple[str, ...] = ()
    """Axes along which the random numbers are the same, so that chance does not hide differences; "all": they are the
    same everywhere, also in other studies of this seed, and a case that two studies share is computed once."""
    readings: dict[Reading, Annotated[tuple[Estimator, ...], Field(min_length=1)]] = Field(
        default={"physical": ("cross_spectrum", "coherent")}, min_length=1
    )
    """Estimators by reading of the paper: "physical", the scene's own; "literal", eq. (11) without delay of depth,
    scatterers in the gate alone; "as_printed", the same with the gain of a difference of pulses left in the amplitude;
    "one_draw", physical with one draw of scatterers for ``scatterers`` times ``noise`` realisations of noise."""
    simulate: Literal["gate", "bench"] | None = None
    """"gate": the gate's echoes of a prescribed motion with white noise, thousands a second; "bench": every realisation
    a whole measurement of the scene, whichever it is; absent: "gate" where the base scene has nothing beyond it."""
    corrected: bool = False
    """Of "bench": amplitude and phase are those of the report, corrected for the averaging of the beams."""
    set: dict[str, Any] = Field(default_factory=dict)
    """Scene keys that differ from the base scene everywhere."""
    axes: Annotated[tuple[Axis, ...], Field(min_length=1)]
    """What is varied."""

    @model_validator(mode="after")
    def _names_are_known_and_unique(self) -> Definition:
        names = [axis.name for axis in self.axes]
        if len(set(names)) < len(names):
            raise ValueError(f"axes are named {', '.join(names)}: give each a name of its own")
        taken = [name for name in names if name in COLUMNS or name.startswith(("amplitude_", "phase_"))]
        if taken:
            raise ValueError(f"axes are named {', '.join(taken)}, as columns of every result are: give others")
        if (points := math.prod(len(axis.values()) for axis in self.axes)) > MOST_POINTS:
            raise ValueError(f"its axes have {points:.3g} points in all, a study at most {MOST_POINTS}: take fewer")
        unknown = [name for name in self.common if name not in names] if self.common != "all" else []
        if unknown:
            raise ValueError(f"common names {', '.join(unknown)}, which is no axis: take from {', '.join(names)}")
        return self


class Collection(Section):
    """Several studies in one run; cases that they share are computed once."""

    title: Title
    """One line that says what they are."""
    studies: Annotated[tuple[str, ...], Field(min_length=1)]
    """Names of shipped studies, or files."""


def shipped_studies() -> dict[str, str]:
    """Return the shipped definitions' texts by name, in the order of their figures."""
    folder = resources.files("hpe_rig.study") / "definitions"
    files = [file for file in folder.iterdir() if file.name.endswith(".toml")]
    texts = {file.name.removesuffix(".toml"): file.read_text(encoding="utf-8") for file in files}
    return dict(sorted(texts.items(), key=lambda item: [part.zfill(3) for part in item[0].split("-")]))


def read_studies(
    name_or_path: str | os.PathLike[str], replaced: Mapping[str, Any] | None = None
) -> dict[str, tuple[Definition, Path]]:
    """Return the definitions by name, each with the folder of its file, of a study or of a collection's studies.

    ``replaced`` are top-level keys given on the command line; ``points`` among them is the count of every range.
    Raises ``SettingsError`` with every mistake, and ``TypeError`` for what is neither name nor path.
    """
    if not isinstance(name_or_path, str | os.PathLike):
        taken = "the name of a shipped one or the path of a TOML file"
        raise TypeError(f"a study is taken as {taken}, not as {type(name_or_path).__name__}")
    shipped, folder = shipped_studies(), Path(name_or_path).parent
    name, text = named_text(name_or_path, shipped, "study")
    tables = parse_toml(text, f"study {name}")
    if "studies" not in tables:
        return {name: (_definition(name, tables, replaced or {}), folder)}
    out: dict[str, tuple[Definition, Path]] = {}
    mistakes: list[Mistake] = []
    for inner in validated(Collection, tables, f"study {name}").studies:
        try:
            own, text = named_text(inner, shipped, "study", folder)
            definition = _definition(own, parse_toml(text, f"study {own}"), replaced or {})
        except SettingsError as error:
            mistakes += [replace(each, path=f"{inner} {each.path}".rstrip()) for each in error.mistakes]
            continue
        if own in out:
            mistakes.append(Mistake(inner, f"its results would replace those of another {own}", "another file name"))
        out[own] = (definition, (folder / inner).parent)
    if mistakes:
        raise SettingsError(f"study {name}", mistakes)
    return out


def _definition(name: str, tables: dict[str, Any], replaced: Mapping[str, Any]) -> Definition:
    tables = tables | {key: value for key, value in replaced.items() if key != "points" and value is not None}
    if (points := replaced.get("points")) is not None:
        # What is no axis is refused below.
        with contextlib.suppress(AttributeError, LookupError, TypeError):
            for values in itertools.chain(*(axis["keys"].values() for axis in tables["axes"])):
                if isinstance(values, dict):
                    values["count"] = points
    return validated(Definition, tables, f"study {name}")
