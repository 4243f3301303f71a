"""Scenes by name, path or value, and the specimen that the twin uses for a scene without one."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

from hpe_rig.scene.keys import Key, keys_of, plain_tables
from hpe_rig.scene.mistakes import Mistake, SettingsError
from hpe_rig.scene.scene import Scene, axes_replaced_by_lists, scene_mistakes
from hpe_rig.scene.settings_file import named_text, parse_toml
from hpe_rig.scene.usual_values import shipped_scenes
from hpe_rig.scene.validation import STORED

SceneSource = str | os.PathLike[str] | Scene
"""A scene: the name of a shipped one, the path of a TOML file, or a ``Scene``."""
DEFAULT_SPECIMEN = "default muscle"
"""Name of the specimen that the twin uses for a scene without [simulation]."""
DEFAULT_SPECIMEN_SCENE = "bovine-muscle"
"""The shipped scene with that specimen; its comments give the sources of the values."""


@dataclass(frozen=True, slots=True)
class SceneText:
    """A scene with the text it was read from, which run files store unchanged."""

    name: str
    text: str
    scene: Scene


def load_scene(source: SceneSource) -> Scene:
    """Return the scene that ``source`` names: a shipped one's name, a TOML file's path, or a ``Scene`` itself.

    Raises ``SettingsError`` with every mistake, and ``TypeError`` for other types.

    >>> load_scene("table-1").tracking.pulse_rate_hz
    4000.0
    """
    return source if isinstance(source, Scene) else parse_scene(*scene_text(source)).scene


def parse_scene(
    name: str,
    text: str,
    simulation_check: Callable[[Mapping[str, Any]], list[Mistake]] | None = None,
    stored: bool = False,
) -> SceneText:
    """Return the scene in ``text``; raise ``SettingsError`` with every mistake.

    ``simulation_check`` returns the twin's mistakes in [simulation] of the scene's tables; None leaves it unchecked.
    ``stored`` is as in ``scene_mistakes``.
    """
    tables = parse_toml(text, f"scene {name}")
    # The two kinds of files are easily exchanged on the command line.
    if {"generators", "limits"} <= tables.keys():
        mistake = Mistake("", "this is a bench file, not a scene", "a scene, and this file behind --bench")
        raise SettingsError(f"scene {name}", [mistake])
    mistakes = scene_mistakes(tables, stored)
    if simulation_check is not None:
        mistakes += simulation_check(tables)
    # Axes are resolved on a valid scene only.
    if not mistakes:
        scene = Scene.model_validate(tables, context=STORED if stored else None)
        mistakes = axes_replaced_by_lists(scene) if scene.sweep.axes else []
    if mistakes:
        raise SettingsError(f"scene {name}", mistakes)
    return SceneText(name, text, scene)


def scene_text(source: SceneSource) -> tuple[str, str]:
    """Return the name and the TOML text of a scene; raises as ``load_scene``, naming the shipped scenes."""
    if isinstance(source, Scene):
        return "scene", _toml(source)
    if not isinstance(source, str | os.PathLike):
        kinds = "the name of a shipped one, the path of a TOML file or a Scene"
        raise TypeError(f"a scene must be {kinds}, not {type(source).__name__}")
    return named_text(source, shipped_scenes(), "scene")


def _toml(scene: Scene) -> str:
    import tomlkit

    tables = plain_tables(scene)
    if scene.default_specimen is not None:
        # The default specimen is not a setting of the scene; a twin adds it again.
        del tables["simulation"]
    return tomlkit.dumps(tables)


def number_keys(tables: Mapping[str, Any]) -> list[Key]:
    """Return every number that the scene in ``tables`` has or could have; entries of lists one by one."""
    return keys_of(Scene.model_validate(tables), tables)


def with_default_specimen(scene: Scene) -> Scene:
    """Return ``scene`` with the default muscle, in focus at the gate, if it has no [simulation].

    A scene without [beams] gets the beams of the muscle's scene.
    """
    if scene.simulation is not None:
        return scene
    muscle = _default_specimen()
    # With two transducers the scene's own distances to the focus apply.
    two_transducers = scene.beams is not None and scene.beams.push_focus_depth_m is not None
    beams: dict[str, Any] = {} if two_transducers else {"focus_depth_m": scene.acquisition.gate_depth_m}
    if scene.beams is None and muscle.beams is not None:
        beams["excitation_width_m"] = muscle.beams.excitation_width_m
    simulation = {**(muscle.simulation or {}), "beams": beams}
    with_muscle = scene.model_copy(update={"simulation": simulation})
    with_muscle._default_specimen = DEFAULT_SPECIMEN
    return with_muscle


@cache
def _default_specimen() -> Scene:
    return load_scene(DEFAULT_SPECIMEN_SCENE)
