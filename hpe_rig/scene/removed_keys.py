"""Keys of [simulation] that earlier versions had: what to do instead. The scene of a run file is read without them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

REMOVED_KEYS: Final[Mapping[str, str]] = {
    "simulation.transmitter": "remove it; the power stage of the twin is linear",
    "simulation.instruments.sample_clock_offset": "simulation.instruments.clock_error.digitizer, of the opposite sign",
    "simulation.scatterers.measured_pulse": 'simulation.scatterers.pulse = "gaussian", with its bandwidth',
    "simulation.scatterers.measured_pulse_rate_hz": "remove it, with measured_pulse",
}
"""Remedy by the full path of a key or table."""


def without_removed_keys(table: Mapping[str, Any], path: str = "simulation") -> dict[str, Any]:
    """Return ``table``, the one at ``path`` of a scene, without the keys that only earlier versions have."""
    current = {key: value for key, value in table.items() if f"{path}.{key}" not in REMOVED_KEYS}
    return {
        key: without_removed_keys(value, f"{path}.{key}") if isinstance(value, Mapping) else value
        for key, value in current.items()
    }
