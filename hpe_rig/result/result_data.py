"""Contents of a result, and their plain form for JSON."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

from hpe_rig.result.conditions import ConditionSummary
from hpe_rig.result.provenance import Provenance
from hpe_rig.result.repeats import RepeatMean, repeat_means
from hpe_rig.result.values import DERIVED, GateResult, ShotResult
from hpe_rig.scene import Estimator

MAX_LISTED_SHOTS = 12
"""Shots that a warning lists; beyond this it states their number."""


@dataclass(frozen=True, slots=True)
class ResultData:
    """Contents of a ``Result``, which adds the tables and figures."""

    title: str
    run_file: str
    simulated: bool
    status: str
    estimator: Estimator
    phase_reference: str
    shots: tuple[ShotResult, ...]
    warnings: tuple[str, ...]
    omitted: tuple[tuple[str, str], ...]
    versions: Mapping[str, str]
    run_time_s: Mapping[str, float]
    simulated_specimen: str | None = None
    shots_without_result: tuple[tuple[int, str], ...] = ()
    profile: tuple[GateResult, ...] = ()
    notes: Mapping[str, str | int | float | bool] = field(default_factory=dict)
    provenance: Provenance = Provenance()  # noqa: RUF009, a frozen value
    imported: str | None = None
    conditions: tuple[ConditionSummary, ...] = ()

    @property
    def origin(self) -> str:
        """Whether the records were measured, simulated or imported, and from where; stated in every output."""
        if self.imported is not None:
            return f"IMPORTED from {self.imported}"
        return "SIMULATED" if self.simulated else "measured"

    @property
    def has_covariance(self) -> bool:
        """Whether the shots hold the errors that the values have in common; without shots there is none."""
        return bool(self.shots) and all(shot.influences for shot in self.shots)

    @property
    def means(self) -> tuple[RepeatMean, ...]:
        """Mean over repeats of each setting and frequency; empty without repeats."""
        return repeat_means(self.shots)

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON; numbers that JSON cannot hold become None.

        ``left_out`` repeats ``omitted``, which had that name before 1.0.0rc1; 1.0.0 omits it.
        """
        # JSON omits displacements and influences, which are arrays of the result file.
        without_arrays = replace(self, shots=tuple(replace(shot, motion=None, influences=()) for shot in self.shots))
        tables = {**asdict(without_arrays), "left_out": self.omitted}
        for name in ("simulated_specimen", "imported"):
            if tables[name] is None:
                del tables[name]
        if not self.profile:
            del tables["profile"]
        if means := [asdict(mean) for mean in self.means]:
            # The means come first, since they are the main result of a run with repeats.
            tables = {"means": means, **tables}
        shots = [*self.shots, *(gate.shot for gate in self.profile)]
        shot_tables = [*tables["shots"], *(gate["shot"] for gate in tables.get("profile", ()))]
        for shot, table in zip(shots, shot_tables, strict=True):
            del table["motion"], table["influences"], table["index"], table["repeat"]
            _put_first(table, {"shot": shot.shot, "repeat": shot.repeat + 1})
            for estimate, row in zip(
                (*shot.estimates, *shot.control), (*table["estimates"], *table["control"]), strict=True
            ):
                _put_first(row, {name: getattr(estimate, name) for name in ("frequency_hz", *DERIVED)})
        plain: dict[str, Any] = json_values(tables)
        return plain


def _put_first(table: dict[str, Any], values: Mapping[str, Any]) -> None:
    """Change ``table`` so that it begins with ``values``."""
    others = dict(table)
    table.clear()
    table.update({**values, **others})


def shot_warnings(shots: Sequence[ShotResult]) -> list[str]:
    """Return the warnings of ``shots``; warnings that differ in numbers only are merged and list their shots."""
    if len(shots) == 1:
        return list(shots[0].warnings)
    groups: dict[str, dict[int, str]] = {}
    for shot in shots:
        for text in shot.warnings:
            groups.setdefault(re.sub(r"\d[\d., ]*", "#", text), {}).setdefault(shot.shot, text)
    return [_merged_warning(by_shot, len(shots)) for by_shot in groups.values()]


def _merged_warning(by_shot: dict[int, str], shots: int) -> str:
    numbers = ", ".join(map(str, list(by_shot)[:MAX_LISTED_SHOTS]))
    if len(by_shot) > MAX_LISTED_SHOTS:
        numbers += f" ... ({len(by_shot)} of {shots} shots)"
    first, text = next(iter(by_shot.items()))
    example = "" if len(set(by_shot.values())) == 1 else f"such as in shot {first}, "
    return f"shot {numbers}: {example}{text}"


def json_text(value: Any, indent: int | None = None) -> str:
    """Return ``value`` as JSON text, with null for infinite numbers and NaN."""
    return json.dumps(json_values(value), indent=indent, allow_nan=False)


def json_values(value: Any) -> Any:
    """Return nested tables and lists with None for infinite numbers and NaN, which JSON cannot hold."""
    if isinstance(value, Mapping):
        return {key: json_values(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [json_values(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
