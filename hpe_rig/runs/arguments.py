"""Types of the arguments of public functions: every wrong one is named in one error."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from numbers import Integral, Real
from typing import Any

import numpy as np

from hpe_rig.scene import Mistake, SettingsError


def require_numbers(function: str, *, whole: bool = False, **arguments: Any) -> None:
    """Raise ``TypeError`` that names each argument of ``function`` that is no number, or no ``whole`` number.

    A tuple argument is checked number by number. Numbers of NumPy are numbers; truth values and texts are not.
    """
    kind, expected = ("a whole number", Integral) if whole else ("a number", Real)
    mistakes = []
    for name, value in arguments.items():
        numbers = value if isinstance(value, tuple) else (value,)
        if any(isinstance(number, bool | np.bool_) or not isinstance(number, expected) for number in numbers):
            texts = f"numbers, each {kind}" if isinstance(value, tuple) else kind
            mistakes.append(f"{name} as {texts}, not {value!r}")
    if mistakes:
        raise TypeError(f"{function} expects {'; '.join(mistakes)}")


def number_list(function: str, name: str, values: Any) -> Sequence[float]:
    """Return ``values``, a list or array of one axis, as floats; raise ``TypeError`` if they are none."""
    array = np.asarray(values) if isinstance(values, np.ndarray | Sequence) else np.asarray("")
    if array.dtype.kind not in "iuf" or array.ndim != 1:
        raise TypeError(f"{function} expects {name} as a list of numbers, such as [100.0], not {values!r}")
    return [float(value) for value in array]


def text_list(function: str, name: str, values: Any) -> Sequence[str]:
    """Return ``values``, a list of texts; raise ``TypeError`` if they are none, also for a single text."""
    if isinstance(values, str) or not isinstance(values, Sequence) or not all(isinstance(text, str) for text in values):
        raise TypeError(f'{function} expects {name} as a list of texts, such as ["{values}"], not {values!r}')
    return values


def known_laws(function: str, laws: Any) -> list[str]:
    """Return the laws of media in ``laws``, all for none, in their usual order; raise ``SettingsError`` for others."""
    from hpe_rig.medium import law_names

    if unknown := [law for law in text_list(function, "laws", laws) if law not in law_names()]:
        raise SettingsError(
            "moduli", [Mistake("law", f"there is no {law} medium", ", ".join(law_names())) for law in unknown]
        )
    return [law for law in law_names() if law in laws] or list(law_names())


def require_axes(axes: Any) -> None:
    """Raise ``TypeError`` unless ``axes`` of a sweep are a mapping."""
    if not isinstance(axes, Mapping):
        raise TypeError(f"sweep expects axes as a mapping from key to values, not {type(axes).__name__}")
