"""Comparison of two benches, or of one at two times: settings read back and bench files, in words."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from drivers.interfaces import Setting

ROLES: Final = {
    "master": "master trigger",
    "burst_train": "burst train",
    "toneburst": "toneburst generator",
    "tracking_train": "tracking pulse train",
    "tracking_pulser": "tracking pulser",
    "digitizer": "digitizer",
}
UNITS: Final = ("hz", "s", "v", "vpp", "ohm", "deg", "samples", "m", "pa", "w_per_m2")
SPELLED: Final = {"hz": "Hz", "v": "V", "vpp": "Vpp", "pa": "Pa", "w_per_m2": "W/m2"}
PREFIXED: Final = ("Hz", "s", "V", "Vpp", "Pa", "m")
PREFIXES: Final = {9: "G", 6: "M", 3: "k", 0: "", -3: "m", -6: "u", -9: "n", -12: "p"}
RELATIVE_TOLERANCE: Final = 1e-10
ABSENT: Final = "not stated"
NOT_OPENED: Final = "not opened"

BenchSettings = Mapping[str, Mapping[str, Setting]]
"""Settings read back, by role."""


@dataclass(frozen=True, slots=True)
class Difference:
    """One setting that is not the same; ``unit`` is empty where there is none."""

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
            return ABSENT
        if isinstance(value, bool):
            return "on" if value else "off"
        if self.unit in PREFIXED and isinstance(value, int | float):
            return prefixed(float(value), self.unit)
        number = f"{value:.10g}" if isinstance(value, float) else str(value)
        return f"{number} {self.unit}".strip()


def settings_differences(before: BenchSettings, after: BenchSettings) -> list[Difference]:
    """Return what differs in the settings read back, role by role along the trigger's way."""
    found = []
    for role, name in ROLES.items():
        one, other = before.get(role), after.get(role)
        if one is not None and other is not None:
            found += _differences(name, one, other)
        elif one is not other:
            states = (NOT_OPENED if state is None else "opened" for state in (one, other))
            found.append(Difference(name, "instrument", "", *states))
    return found


def file_differences(before: Mapping[str, Any], after: Mapping[str, Any]) -> list[Difference]:
    """Return what differs between two bench files' tables."""
    return _differences("bench file", dict(_flat(before)), dict(_flat(after)))


def _differences(where: str, before: Mapping[str, Any], after: Mapping[str, Any]) -> list[Difference]:
    keys = [key for key in dict.fromkeys([*before, *after]) if not _same(before.get(key), after.get(key))]
    return [Difference(where, *_words(key), before.get(key), after.get(key)) for key in keys]


def _same(one: Any, other: Any) -> bool:
    if isinstance(one, bool | str | None) or isinstance(other, bool | str | None):
        return bool(one == other)
    return math.isclose(one, other, rel_tol=RELATIVE_TOLERANCE)


def _words(key: str) -> tuple[str, str]:
    """Return a key as words and its unit: ``delay_s`` is the delay in s."""
    table, _, name = key.rpartition(".")
    for unit in sorted(UNITS, key=len, reverse=True):
        if name.endswith(f"_{unit}"):
            return f"{table} {name.removesuffix(f'_{unit}').replace('_', ' ')}".strip(), SPELLED.get(unit, unit)
    return f"{table} {name.removesuffix('_on').replace('_', ' ')}".strip(), ""


def prefixed(value: float, unit: str) -> str:
    """Return a number with its unit as people read it: 130 us, 3 MHz."""
    if value == 0 or not math.isfinite(value):
        return f"{value:g} {unit}"
    power = 3 * math.floor(round(math.log10(abs(value)), 9) / 3)
    power = min(max(power, min(PREFIXES)), max(PREFIXES))
    return f"{value / 10.0**power:.10g} {PREFIXES[power]}{unit}"


def _flat(tables: Any, path: Sequence[str] = ()) -> Iterator[tuple[str, Any]]:
    if isinstance(tables, Mapping):
        for key, value in tables.items():
            yield from _flat(value, (*path, key))
    elif isinstance(tables, list | tuple):
        for value in tables:
            yield from _flat(value, (*path, _name_of(value)))
    else:
        yield ".".join(path), tables


def _name_of(value: Any) -> str:
    """Return a cable's name; other entries of lists have none."""
    return f"{value['source']} to {value['target']}" if isinstance(value, Mapping) and "source" in value else "entry"
