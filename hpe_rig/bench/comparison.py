"""Comparison of two benches, or of one at two times: settings read back and bench files, in words."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from drivers.interfaces import Setting
from hpe_rig.scene import engineering

ROLES: Final = {
    "master": "master trigger",
    "burst_train": "burst train",
    "toneburst": "toneburst generator",
    "tracking_train": "tracking pulse train",
    "tracking_pulser": "tracking pulser",
    "digitizer": "digitizer",
}
UNITS: Final = {
    "hz": "Hz", "s": "s", "v": "V", "vpp": "Vpp", "ohm": "ohm", "deg": "deg", "samples": "samples", "m": "m",
    "pa": "Pa", "w_per_m2": "W/m2",
}  # fmt: skip
"""Unit by the ending of a key, those of instruments included."""
WITHOUT_PREFIX: Final = ("ohm", "deg", "samples", "W/m2", "")
RELATIVE_TOLERANCE: Final = 1e-10
"""Relative difference of numbers that counts as equal: rounding in text and back."""

BenchSettings = Mapping[str, Mapping[str, Setting]]
"""Settings read back, by role."""


@dataclass(frozen=True, slots=True)
class Difference:
    """One setting with two different values; ``unit`` is empty if it has none."""

    where: str
    what: str
    unit: str
    before: Any
    after: Any

    def text(self, before: str, after: str) -> str:
        """Return the difference as a sentence, with the names of the two benches."""
        return f"{self.where}: {self.what} {self._value(self.before)} in {before}, {self._value(self.after)} in {after}"

    def _value(self, value: Any) -> str:
        if value is None:
            return "not stated"
        if isinstance(value, bool):
            return "on" if value else "off"
        if isinstance(value, int | float) and self.unit not in WITHOUT_PREFIX:
            return engineering(float(value), self.unit, digits=10)
        number = f"{value:.10g}" if isinstance(value, float) else str(value)
        return f"{number} {self.unit}".strip()


def settings_differences(before: BenchSettings, after: BenchSettings) -> list[Difference]:
    """Return the differences between settings read back, role by role in the order of the triggers."""
    differences = []
    for role, name in ROLES.items():
        first, second = before.get(role), after.get(role)
        if first is not None and second is not None:
            # A setting that only one release reads is no difference, nor is the flag of earlier releases that records
            # of the previous shot were clipped.
            common = [key for key in first if key in second and key != "clipped"]
            differences += _differences(name, *({key: item[key] for key in common} for item in (first, second)))
        elif first is not second:
            states = ("not opened" if settings is None else "opened" for settings in (first, second))
            differences.append(Difference(name, "instrument", "", *states))
    return differences


def file_differences(before: Mapping[str, Any], after: Mapping[str, Any]) -> list[Difference]:
    """Return the differences between the tables of two bench files."""
    return _differences("bench file", dict(_flat(before)), dict(_flat(after)))


def _differences(where: str, before: Mapping[str, Any], after: Mapping[str, Any]) -> list[Difference]:
    keys = [key for key in dict.fromkeys([*before, *after]) if not _equal(before.get(key), after.get(key))]
    return [Difference(where, *_words_and_unit(key), before.get(key), after.get(key)) for key in keys]


def _equal(first: Any, second: Any) -> bool:
    if isinstance(first, int | float) and isinstance(second, int | float):
        return math.isclose(first, second, rel_tol=RELATIVE_TOLERANCE)
    return bool(first == second)


def _words_and_unit(key: str) -> tuple[str, str]:
    """Return a key as words and its unit: ``delay_s`` is "delay" in s."""
    table, _, name = key.rpartition(".")
    for ending, unit in UNITS.items():
        if name.endswith(f"_{ending}"):
            return f"{table} {name.removesuffix(f'_{ending}').replace('_', ' ')}".strip(), unit
    return f"{table} {name.removesuffix('_on').replace('_', ' ')}".strip(), ""


def _flat(tables: Any, path: Sequence[str] = ()) -> Iterator[tuple[str, Any]]:
    """Yield the values of nested tables by dotted path."""
    if isinstance(tables, Mapping):
        for key, value in tables.items():
            yield from _flat(value, (*path, key))
    elif isinstance(tables, list | tuple):
        for value in tables:
            # A cable is named by its ends, so that cables match in any order.
            is_cable = isinstance(value, Mapping) and "source" in value
            entry = value.get("name", "entry") if isinstance(value, Mapping) else "entry"
            name = f"{value['source']} to {value['target']}" if is_cable else str(entry)
            yield from _flat(value, (*path, name))
    else:
        yield ".".join(path), tables
