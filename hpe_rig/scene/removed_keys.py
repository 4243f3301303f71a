"""Keys of [simulation] that earlier versions had: what to do instead. The twin of a run file is read without them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

REMOVED_KEYS: Final[Mapping[str, str]] = {
    "simulation.transmitter": "remove it; the power stage of the twin is linear",
    "simulation.instruments.sample_clock_offset": "set simulation.instruments.clock_error.digitizer, of opposite sign",
    "simulation.scatterers.measured_pulse": 'set simulation.scatterers.pulse = "gaussian" and its bandwidth',
    "simulation.scatterers.measured_pulse_rate_hz": "remove it together with measured_pulse",
}
"""Remedy by the full path of a key or table."""


def removal_remedy(path: str) -> str | None:
    """Return what to do about the key ``path`` if an earlier version had it, in this table or another; else None."""
    name = path.rpartition(".")[2]
    elsewhere = (remedy for key, remedy in REMOVED_KEYS.items() if key.rpartition(".")[2] == name)
    return REMOVED_KEYS.get(path) or next(elsewhere, None)


def omitted_keys(simulation: Mapping[str, Any]) -> list[str]:
    """Return the removed keys in [simulation] of a stored scene that ``current_simulation`` drops, by their path."""
    scatterers = simulation.get("scatterers") or {}
    present = {
        "simulation.transmitter": "transmitter" in simulation,
        "simulation.scatterers.measured_pulse": "measured_pulse" in scatterers,
    }
    return [key for key, is_present in present.items() if is_present]


def current_simulation(simulation: Mapping[str, Any]) -> dict[str, Any]:
    """Return [simulation] of a stored scene without its removed keys; the clock error that one of them set remains."""
    tables = _without_removed_keys(simulation, "simulation")
    match simulation:
        case {"instruments": {"sample_clock_offset": float() as offset}} if offset:
            # A sample period longer by the factor 1 + offset is a clock rate of 1 / (1 + offset).
            tables["instruments"].setdefault("clock_error", {})["digitizer"] = -offset / (1 + offset)
    return tables


def _without_removed_keys(table: Mapping[str, Any], path: str) -> dict[str, Any]:
    """Return a copy of ``table``, the one at ``path`` of a scene, without the keys that only earlier versions have."""
    current = {key: value for key, value in table.items() if f"{path}.{key}" not in REMOVED_KEYS}
    return {
        key: _without_removed_keys(value, f"{path}.{key}") if isinstance(value, Mapping) else value
        for key, value in current.items()
    }
