"""Settings files as a whole: scene with the twin's ``[simulation]``, bench; their schemas, and files with every key."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from functools import partial
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
    settings_schema,
)

SIMULATION = "What the twin simulates; read by the simulated bench alone. Without it the default muscle is measured."


def json_schema(of: str, others: Mapping[str, Callable[[], dict[str, Any]]] | None = None) -> dict[str, Any]:
    """Return the JSON schema of a scene, a bench file, the twin's settings, a queue's list or what --json prints.

    ``others`` are known besides. Raises ``SettingsError`` for one that is not known.
    """
    from hpe_rig.measurement import QueueList
    from hpe_rig.moduli import moduli_schema
    from hpe_rig.store import listing_schema, verification_schema

    schemas: dict[str, Callable[[], dict[str, Any]]] = {
        "scene": partial(settings_schema, Scene),
        "bench": partial(settings_schema, BenchFile),
        "simulation": simulation_schema,
        "queue": partial(settings_schema, QueueList),
        "result": result_schema,
        "list": listing_schema,
        "verify": verification_schema,
        "moduli": moduli_schema,
        **(others or {}),
    }
    if of not in schemas:
        raise SettingsError(f"schema {of}", [Mistake("", "there is no such schema", f"one of {', '.join(schemas)}")])
    return schemas[of]()


def settings_tables(of: str) -> list[DescribedTable]:
    """Return every table and key of a ``"scene"``, a ``"bench"`` file or the scene's ``"simulation"``, described."""
    if of == "simulation":
        return described(json_schema(of), ("simulation",), SIMULATION)
    top, *rest = described(json_schema(of))
    # A scene knows [simulation] as a table of the twin's own: `settings_tables("simulation")`.
    kept = tuple(key for key in top.keys if key.name != "simulation")
    return [dataclasses.replace(top, keys=kept), *rest]


def full_text(of: str, text: str) -> str:
    """Return the settings file ``text``, a ``"scene"`` or a ``"bench"``, with every other key in a comment."""
    tables = settings_tables(of) + (settings_tables("simulation") if of == "scene" else [])
    return annotated(tables, parse_toml(text, of))
