"""Media of other packages, from the entry points of the group ``hpe_rig.media``.

An entry is an object with ``parameters``, each with ``name`` and ``limits``, and ``modulus(s, values)``. That function
takes s (frequency,) and the parameters' values, and returns the modulus (frequency,), Pa, and its derivatives. The
modulus is analytic in s off the negative real axis. ``creeps`` is True if a constant force moves the medium for ever.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from queue import Empty, SimpleQueue
from typing import Any, Final

import numpy as np

from sim_backend.arrays import ComplexArray

GROUP: Final = "hpe_rig.media"
BUILT_IN_MEDIA: Final = ("voigt", "maxwell", "zener", "power_law")

TIMEOUT_S: Final = 60.0
"""Longest duration of one call of another package's code, as for its estimators."""


@cache
def _installed() -> dict[str, EntryPoint]:
    return {entry.name: entry for entry in entry_points(group=GROUP) if entry.name not in BUILT_IN_MEDIA}


def known_medium(name: str) -> str:
    """Return ``name``; raise ``ValueError`` unless it is a built-in or installed medium."""
    if name not in BUILT_IN_MEDIA and name not in _installed():
        names = ", ".join(map(repr, (*BUILT_IN_MEDIA, *_installed())))
        raise ValueError(f"{name[:80]!r} is not one of the choices: one of {names}")
    return name


def check_parameters(medium: str, values: Mapping[str, float]) -> None:
    """Raise ``ValueError`` unless ``values`` are the parameters of an installed ``medium``, each within its limits."""
    limits = {parameter.name: parameter.limits for parameter in _law(medium).parameters}
    if set(values) != set(limits):
        raise ValueError(f"parameters of {medium} are {', '.join(values) or 'absent'}: {', '.join(limits)}")
    for name, (low, high) in limits.items():
        if not low <= values[name] <= high:
            raise ValueError(f"parameters.{name} of {medium} is {values[name]:g}: from {low:g} to {high:g}")


def modulus_of(medium: str, parameters: Mapping[str, float], s_per_s: ComplexArray) -> ComplexArray:
    """Return the complex shear modulus of an installed ``medium``, Pa, in the shape of ``s_per_s``.

    ``s_per_s``: complex frequencies. Raises ``ValueError`` if the medium's package fails.
    """
    law = _law(medium)
    values = np.array([parameters[parameter.name] for parameter in law.parameters])
    s = np.asarray(s_per_s, np.complex128)

    def modulus() -> Any:
        # The derivatives are not used, and may not exist at s = 0.
        with np.errstate(divide="ignore", invalid="ignore"):
            return law.modulus(s.reshape(-1), values)[0]

    try:
        modulus_pa = np.asarray(_in_time(modulus), np.complex128)
    except (Exception, SystemExit) as error:
        raise ValueError(f"{_description(medium)} failed ({type(error).__name__}: {error}): report it there") from error
    if modulus_pa.shape != (s.size,):
        raise ValueError(f"{_description(medium)} gave a modulus of shape {modulus_pa.shape}: one of {(s.size,)}")
    if not np.isfinite(modulus_pa[s.reshape(-1) != 0]).all():
        raise ValueError(f"{_description(medium)} gave a modulus that is not finite: report it there")
    return modulus_pa.reshape(s.shape)


def creeps(medium: str) -> bool:
    """Return whether a constant force moves an installed ``medium`` without end."""
    return bool(getattr(_law(medium), "creeps", False))


@cache
def _law(medium: str) -> Any:
    """Return the material law of ``medium``: the object that its package installs under that name.

    A law has ``parameters`` and a function ``modulus``. Raises ``ValueError`` if the law does not load or lacks them.
    """
    try:
        law = _in_time(_installed()[medium].load)
    except (Exception, SystemExit) as error:
        raise ValueError(
            f"{_description(medium)} does not load ({type(error).__name__}: {error}): uninstall it"
        ) from error
    if not callable(getattr(law, "modulus", None)) or not getattr(law, "parameters", None):
        raise ValueError(
            f"{_description(medium)} has no parameters or no modulus: install the newest version of its package"
        )
    return law


def _in_time(function: Callable[[], Any]) -> Any:
    """Return ``function()``, which runs in a thread; raise ``TimeoutError`` if it lasts longer than ``TIMEOUT_S``."""
    outcomes = SimpleQueue[tuple[Any, BaseException | None]]()

    def run() -> None:
        try:
            outcomes.put((function(), None))
        except BaseException as error:
            outcomes.put((None, error))

    threading.Thread(target=run, daemon=True).start()
    try:
        value, failure = outcomes.get(timeout=TIMEOUT_S)
    except Empty:
        raise TimeoutError(f"it has not returned within {TIMEOUT_S:g} s") from None
    if failure is not None:
        raise failure
    return value


def _description(medium: str) -> str:
    """Return the name of an installed medium with its package and version, for messages."""
    package = _installed()[medium].dist
    source = "an unknown package" if package is None else f"{package.name} {package.version}"
    return f"medium {medium} ({GROUP}, of {source})"
