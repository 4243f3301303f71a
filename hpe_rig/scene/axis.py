"""Axes of a sweep: the keys that vary, the values they take, and the points that several axes span.

A scene's [sweep], a study, the reprocessing of a stored run and a design all use ``Axis``.
"""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from hpe_rig.scene.mistakes import KeyPath, Mistake, SettingsError, path_of
from hpe_rig.scene.units import unit_of


@dataclass(frozen=True, slots=True)
class Axis:
    """One direction of a sweep.

    ``columns`` holds the values by key, such as "tracking.pulse_rate_hz"; every key has equally many. At point n of the
    axis, every key takes its n-th value. ``name`` and ``unit`` label the axis, ``labels`` are the values shown for its
    points.
    """

    name: str
    columns: Mapping[str, tuple[Any, ...]]
    unit: str
    labels: tuple[Any, ...]

    @classmethod
    def of_key(cls, key: str, values: Sequence[Any]) -> Axis:
        """Return the axis along which one key takes ``values``; its unit is the one that the key's name ends with."""
        return cls(key, {key: tuple(values)}, unit_of(key), tuple(values))

    def __len__(self) -> int:
        return len(self.labels)

    @property
    def paths(self) -> tuple[KeyPath, ...]:
        """Paths of the keys, in the order of ``columns``."""
        return tuple(path_of(key) for key in self.columns)

    def settings(self, index: int) -> dict[str, Any]:
        """Return the values of all keys at point ``index`` of the axis."""
        return {key: values[index] for key, values in self.columns.items()}


def settings_at_points(
    axes: Sequence[Axis], combine: Literal["product", "zip"], max_points: int, source: str
) -> list[dict[str, Any]]:
    """Return the values by key at every point that ``axes`` span, the last axis fastest.

    "product" combines each value of an axis with each of the others, "zip" the n-th values of all axes. Raises
    ``SettingsError`` about ``source`` for more than ``max_points``, and for a zip of axes of unequal length.
    """
    counts = [len(axis) for axis in axes]
    if combine == "zip" and len(set(counts)) > 1:
        listed = ", ".join(f"{axis.name} {len(axis)}" for axis in axes)
        what = f"axes taken together need equally many values, not {listed}"
        raise SettingsError(source, [Mistake("sweep", what, 'as many values each, or combine = "product"')])
    if combine == "product" and math.prod(counts) > max_points:
        what = f"its axes have {math.prod(counts)} points, a run at most {max_points}"
        raise SettingsError(source, [Mistake("sweep", what, "fewer values, or several runs")])
    # Points as one index for each axis.
    ranges = [range(count) for count in counts]
    indices = zip(*ranges, strict=True) if combine == "zip" else itertools.product(*ranges)
    return [
        {key: value for axis, index in zip(axes, point, strict=True) for key, value in axis.settings(index).items()}
        for point in indices
    ]


def parse_axes(options: Sequence[str]) -> tuple[Axis, ...]:
    """Return the axes of command-line options such as "gate_length_m=0.5e-3,1e-3".

    Raises ``SettingsError`` with every option that is not an axis and every key that occurs twice.
    """
    axes, mistakes = [], []
    for text in options:
        key, _, listed = text.partition("=")
        try:
            axes.append(Axis.of_key(key, [float(number) for number in listed.split(",")]))
        except ValueError:
            mistakes.append(Mistake("--sweep", f"{text!r} is no axis", "KEY=NUMBER,NUMBER without spaces"))
    repeated = [key for key, count in Counter(axis.name for axis in axes).items() if count > 1]
    mistakes += [Mistake("--sweep", f"{key} is given twice", "all its values at once") for key in repeated]
    if mistakes:
        raise SettingsError("command line", mistakes)
    return tuple(axes)
