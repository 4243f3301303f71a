"""Media of other packages, by the entry points of the group ``hpe_rig.media``: their modulus moves the twin.

An object there has ``parameters``, each with ``name`` and ``limits``, and ``modulus(s, values)``, which takes s
(frequency,) and the parameters' values and returns the modulus (frequency,), Pa, before its derivatives; ``creeps``
says that a constant force moves the medium without end. The modulus is analytic in s off the negative real axis.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any, Final

import numpy as np

from sim_backend.arrays import ComplexArray

GROUP: Final = "hpe_rig.media"
OWN_MEDIA: Final = ("voigt", "maxwell", "zener", "power_law")


@cache
def _installed() -> dict[str, EntryPoint]:
    return {each.name: each for each in entry_points(group=GROUP) if each.name not in OWN_MEDIA}


def known_medium(name: str) -> str:
    """Return ``name``; raise ``ValueError`` where it is neither a medium of ours nor an installed one."""
    if name not in OWN_MEDIA and name not in _installed():
        names = ", ".join(map(repr, (*OWN_MEDIA, *_installed())))
        raise ValueError(f"{name[:80]!r} is not one of the choices: one of {names}")
    return name


def refuse_parameters(medium: str, given: Mapping[str, float]) -> None:
    """Raise ``ValueError`` unless ``given`` are the parameters of an installed ``medium``, each within its limits."""
    wanted = {each.name: each.limits for each in _law(medium).parameters}
    if set(given) != set(wanted):
        raise ValueError(f"parameters of {medium} are {', '.join(given) or 'absent'}: {', '.join(wanted)}")
    for name, (low, high) in wanted.items():
        if not low <= given[name] <= high:
            raise ValueError(f"parameters.{name} of {medium} is {given[name]:g}: from {low:g} to {high:g}")


def modulus_of(medium: str, given: Mapping[str, float], s_per_s: ComplexArray) -> ComplexArray:
    """Return the modulus of an installed ``medium``, Pa, shape of ``s_per_s``."""
    law = _law(medium)
    values = np.array([given[each.name] for each in law.parameters])
    s = np.asarray(s_per_s, np.complex128)
    try:
        # Its derivatives are not needed, and may not exist at rest.
        with np.errstate(divide="ignore", invalid="ignore"):
            found = np.asarray(law.modulus(s.reshape(-1), values)[0], np.complex128)
    except Exception as error:
        raise ValueError(f"{_whose(medium)} failed ({type(error).__name__}: {error}): report it there") from error
    if found.shape != (s.size,):
        raise ValueError(f"{_whose(medium)} gave a modulus of shape {found.shape}: one of {(s.size,)}")
    return found.reshape(s.shape)


def creeps(medium: str) -> bool:
    """Return whether a constant force moves an installed ``medium`` without end."""
    return bool(getattr(_law(medium), "creeps", False))


@cache
def _law(medium: str) -> Any:
    try:
        law = _installed()[medium].load()
    except Exception as error:
        raise ValueError(f"{_whose(medium)} does not load ({type(error).__name__}: {error}): uninstall it") from error
    if not callable(getattr(law, "modulus", None)) or not getattr(law, "parameters", None):
        raise ValueError(f"{_whose(medium)} has no parameters or no modulus: its newest version")
    return law


def _whose(medium: str) -> str:
    package = _installed()[medium].dist
    of = "an unknown package" if package is None else f"{package.name} {package.version}"
    return f"medium {medium} ({GROUP}, of {of})"
