"""Values of the shipped scenes, and the suggestion for a number that lacks the prefix of its unit.

A value is suspicious if it is ``SUSPICIOUS_FACTOR`` above or below all shipped scenes, and 1e3, 1e6 or 1e9 times more
or less than it would be within ``USUAL_FACTOR`` of them.
"""

from __future__ import annotations

import re
from functools import cache
from importlib import resources
from typing import Final

from hpe_rig.scene.keys import Number, keys_of, plain_tables
from hpe_rig.scene.mistakes import Mistake
from hpe_rig.scene.settings_file import parse_toml
from hpe_rig.scene.units import engineering, unit_of
from hpe_rig.scene.validation import Section

SUSPICIOUS_FACTOR: Final = 100.0
USUAL_FACTOR: Final = 10.0


def shipped_scenes() -> dict[str, str]:
    """Return the shipped scenes' texts by name."""
    folder = resources.files("hpe_rig.scene") / "shipped"
    files = sorted((file for file in folder.iterdir() if file.name.endswith(".toml")), key=lambda file: file.name)
    return {file.name.removesuffix(".toml"): file.read_text(encoding="utf-8") for file in files}


def forgotten_units(scene: Section) -> list[Mistake]:
    """Return the suspicious numbers of ``scene``, each with the value that was perhaps meant.

    They are likely causes of other mistakes, and are not mistakes if the scene can be measured.
    """
    mistakes, keys = [], keys_of(scene, plain_tables(scene))
    lists = {_without_index(str(key)) for key in keys if str(key).endswith("[1]")}
    for key in keys:
        name = _without_index(str(key))
        if key.value is not None and (meant := likely_value(type(scene), name, key.value)):
            low, high = (engineering(value, unit_of(name)) for value in _shipped_range(type(scene))[name])
            usual = low if low == high else f"{low} to {high}"
            what = f"{engineering(key.value, unit_of(name))}, where the shipped scenes have {usual}"
            # A list with one value is written without brackets.
            mistakes.append(Mistake(str(key) if name in lists else name, what, f"perhaps {meant}?"))
    return mistakes


def likely_value(scene_type: type[Section], key: str, value: Number) -> str:
    """Return a suspicious ``value`` with the missing power of ten, such as 100e-6; empty for other values."""
    low, high = _shipped_range(scene_type).get(_without_index(key), (0.0, 0.0))
    if value <= 0 or not high or low / SUSPICIOUS_FACTOR <= value <= high * SUSPICIOUS_FACTOR:
        return ""
    # Powers of ten towards the usual range, the smallest correction first.
    for power in (-3, -6, -9) if value > high else (3, 6, 9):
        if low / USUAL_FACTOR <= value * 10.0**power <= high * USUAL_FACTOR:
            return f"{value:g}e{power}" if "e" not in f"{value:g}" else f"{value * 10.0**power:g}"
    return ""


def _without_index(key: str) -> str:
    return re.sub(r"\[\d+\]", "", key)


@cache
def _shipped_range(scene_type: type[Section]) -> dict[str, tuple[float, float]]:
    """Return by key the smallest and largest positive value with a unit in the shipped scenes, defaults included.

    ``scene_type`` is ``Scene``, which imports this module.
    """
    values: dict[str, list[float]] = {}
    for source, text in shipped_scenes().items():
        tables = parse_toml(text, source)
        for key in keys_of(scene_type.model_validate(tables), tables):
            name = _without_index(str(key))
            if key.value is not None and key.value > 0 and unit_of(name):
                values.setdefault(name, []).append(float(key.value))
    return {name: (min(numbers), max(numbers)) for name, numbers in values.items()}
