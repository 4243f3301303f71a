"""Schemas and complete descriptions of settings files: scene with ``[simulation]``, bench, queue."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

from hpe_rig.bench import BenchFile, simulation_schema
from hpe_rig.result import result_schema
from hpe_rig.scene import (
    DescribedTable,
    Mistake,
    Scene,
    SettingsError,
    annotated,
    described,
    parse_toml,
)

SIMULATION = "Settings of the twin, used on the simulated bench alone. Without them the default muscle is simulated."


def json_schema(of: str, additional: Mapping[str, Callable[[], dict[str, Any]]] | None = None) -> dict[str, Any]:
    """Return the JSON schema of a settings file or of an output of --json.

    ``additional``: further schemas by name. Raises ``SettingsError`` for an unknown name.
    """
    # Imported here: pages and editors ask for one schema at a time.
    from hpe_rig.measurement import QueueList
    from hpe_rig.moduli import dispersion_schema, moduli_schema
    from hpe_rig.store import listing_schema, verification_schema

    schemas: dict[str, Callable[[], dict[str, Any]]] = {
        "scene": Scene.model_json_schema,
        "bench": BenchFile.model_json_schema,
        "simulation": simulation_schema,
        "queue": QueueList.model_json_schema,
        "result": result_schema,
        "list": listing_schema,
        "verify": verification_schema,
        "moduli": moduli_schema,
        "dispersion": dispersion_schema,
        **(additional or {}),
    }
    if of not in schemas:
        raise SettingsError(f"schema {of}", [Mistake("", "there is no such schema", f"one of {', '.join(schemas)}")])
    return schemas[of]()


def settings_tables(of: str) -> list[DescribedTable]:
    """Return the descriptions of all tables and keys of a ``"scene"``, a ``"bench"`` file or ``"simulation"``."""
    if of == "simulation":
        return described(json_schema(of), ("simulation",), SIMULATION)
    top, *sections = described(json_schema(of))
    # The keys of [simulation] belong to the twin: `settings_tables("simulation")` describes them.
    keys = tuple(key for key in top.keys if key.name != "simulation")
    return [dataclasses.replace(top, keys=keys), *sections]


def full_text(of: str, text: str) -> str:
    """Return the text of a ``"scene"`` or ``"bench"`` file with all its missing keys added as comments."""
    tables = settings_tables(of) + (settings_tables("simulation") if of == "scene" else [])
    return annotated(tables, parse_toml(text, of))
