"""Media by their complex shear modulus, with its derivatives by coordinates in which a fit is well scaled.

    Voigt mu1 + s mu2,    Zener mu1 + s mu2 / (1 + s mu2 / E),    power law mu1 (s / 2 pi 100 Hz)^p,
    Maxwell s mu2 / (1 + s mu2 / mu1),    s = jw

A stiffness runs over its logarithm; a viscosity v over asinh(v / 0.05 Pa s), which is logarithmic above and takes 0.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from hpe_rig.arrays import ComplexArray, FloatArray
from hpe_rig.extensions import MEDIA, ExtensionError, installed, load, origin

MediumLaw = str
"""Name of a law, one of ours or of an installed package's."""

Modulus = Callable[[ComplexArray, FloatArray], tuple[ComplexArray, ComplexArray]]

SMALL_VISCOSITY_PA_S = 0.05
POWER_REFERENCE_HZ = 100.0
STIFFNESS_PA = (100.0, 2e6)
BRANCH_PA = (100.0, 1e9)
"""To where the branch's spring is rigid, so that a Zener medium holds the Voigt one: at 1 kHz and 5.7 Pa s to 2 Pa."""
VISCOSITY_PA_S = (0.0, 500.0)
POWER = (0.0, 0.95)


@dataclass(frozen=True, slots=True)
class Parameter:
    """One parameter of a medium: its name with unit, its range, the ``start`` values tried, and its coordinate."""

    name: str
    limits: tuple[float, float]
    starts: tuple[float, ...]
    to_coordinate: Callable[[FloatArray | float], FloatArray]
    to_value: Callable[[FloatArray | float], FloatArray]
    slope: Callable[[FloatArray | float], FloatArray]
    """Derivative of the value by the coordinate, at the value."""

    @classmethod
    def logarithmic(cls, name: str, limits: tuple[float, float], starts: tuple[float, ...]) -> Parameter:
        """Return a parameter that runs over its logarithm, such as a stiffness."""
        return cls(name, limits, starts, np.log, np.exp, np.asarray)

    @classmethod
    def linear(cls, name: str, limits: tuple[float, float], starts: tuple[float, ...]) -> Parameter:
        """Return a parameter that runs as it is, such as an exponent."""
        return cls(name, limits, starts, _same, _same, _one)

    @property
    def bounds(self) -> tuple[float, float]:
        """The coordinates of the limits."""
        return float(self.to_coordinate(self.limits[0])), float(self.to_coordinate(self.limits[1]))


@dataclass(frozen=True, slots=True)
class Law:
    """A medium's law: its parameters, and its modulus with the derivatives by their values.

    ``modulus(s, values)`` takes s (frequency,) and parameter values (..., parameter) and returns the modulus
    (..., frequency) and its derivatives (..., frequency, parameter). It is analytic in s off the negative real axis,
    so that the twin may move by it. ``title``: what tables call it; ``creeps``: a constant force moves it without end.
    """

    name: MediumLaw
    parameters: tuple[Parameter, ...]
    modulus: Callable[[ComplexArray, FloatArray], tuple[ComplexArray, ComplexArray]]
    title: str = ""
    creeps: bool = False

    def __post_init__(self) -> None:
        """Take the name as the title where none is given."""
        object.__setattr__(self, "title", self.title or self.name.replace("_", " ").capitalize())

    def values(self, coordinates: FloatArray) -> FloatArray:
        """Return parameter values at ``coordinates`` (..., parameter)."""
        each = [one.to_value(coordinates[..., i]) for i, one in enumerate(self.parameters)]
        return np.stack(each, axis=-1)

    def slopes(self, values: FloatArray) -> FloatArray:
        """Return the derivatives of values by coordinates, (..., parameter)."""
        return np.stack([one.slope(values[..., i]) for i, one in enumerate(self.parameters)], axis=-1)

    def starts(self) -> FloatArray:
        """Return the coordinates (start, parameter) of a coarse grid over what soft media show."""
        grid = np.meshgrid(*(one.to_coordinate(np.array(one.starts)) for one in self.parameters), indexing="ij")
        return np.stack([each.ravel() for each in grid], axis=-1)


def _stiffness(name: str, starts: tuple[float, ...]) -> Parameter:
    return Parameter.logarithmic(name, STIFFNESS_PA, starts)


def _asinh(value: FloatArray | float) -> FloatArray:
    return np.asarray(np.arcsinh(np.asarray(value) / SMALL_VISCOSITY_PA_S))


def _sinh(coordinate: FloatArray | float) -> FloatArray:
    return np.asarray(SMALL_VISCOSITY_PA_S * np.sinh(coordinate))


def _sinh_slope(value: FloatArray | float) -> FloatArray:
    return np.asarray(np.hypot(value, SMALL_VISCOSITY_PA_S))


def _viscosity(starts: tuple[float, ...]) -> Parameter:
    return Parameter("viscosity_pa_s", VISCOSITY_PA_S, starts, _asinh, _sinh, _sinh_slope)


def _same(value: FloatArray | float) -> FloatArray:
    return np.asarray(value, dtype=np.float64)


def _one(value: FloatArray | float) -> FloatArray:
    return np.ones_like(np.asarray(value, dtype=np.float64))


def _voigt(s: ComplexArray, values: FloatArray) -> tuple[ComplexArray, ComplexArray]:
    mu1, mu2 = (values[..., i, None] for i in range(2))
    modulus = mu1 + s * mu2
    return modulus, np.stack(np.broadcast_arrays(np.ones_like(modulus), s + 0 * modulus), axis=-1)


def _branch(
    s: ComplexArray, spring: FloatArray, dashpot: FloatArray
) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
    """Return the modulus of a spring and a dashpot in series, and its derivatives by both."""
    ratio = s * dashpot / spring
    return s * dashpot / (1 + ratio), (ratio / (1 + ratio)) ** 2, s / (1 + ratio) ** 2


def _zener(s: ComplexArray, values: FloatArray) -> tuple[ComplexArray, ComplexArray]:
    mu1, spring, dashpot = (values[..., i, None] for i in range(3))
    branch, by_spring, by_dashpot = _branch(s, spring, dashpot)
    return mu1 + branch, np.stack([np.ones_like(branch), by_spring, by_dashpot], axis=-1)


def _maxwell(s: ComplexArray, values: FloatArray) -> tuple[ComplexArray, ComplexArray]:
    branch, by_spring, by_dashpot = _branch(s, values[..., 0, None], values[..., 1, None])
    return branch, np.stack([by_spring, by_dashpot], axis=-1)


def _power_law(s: ComplexArray, values: FloatArray) -> tuple[ComplexArray, ComplexArray]:
    relative = s / (2 * np.pi * POWER_REFERENCE_HZ)
    powers = relative ** values[..., 1, None]
    modulus = values[..., 0, None] * powers
    return modulus, np.stack([powers, modulus * np.log(relative)], axis=-1)


_STIFF = (0.7e3, 2e3, 6e3, 18e3, 60e3, 250e3)
_VISCOUS = (0.02, 0.5, 2.0, 8.0, 30.0)
LAWS: dict[MediumLaw, Law] = {
    "voigt": Law("voigt", (_stiffness("shear_modulus_pa", _STIFF), _viscosity(_VISCOUS)), _voigt),
    "zener": Law(
        "zener",
        (
            _stiffness("shear_modulus_pa", _STIFF),
            Parameter.logarithmic("branch_modulus_pa", BRANCH_PA, (2e3, 15e3, 100e3, 1e6)),
            _viscosity((0.5, 2.0, 8.0)),
        ),
        _zener,
    ),
    "power_law": Law(
        "power_law",
        (_stiffness("shear_modulus_pa", _STIFF), Parameter.linear("power", POWER, (0.02, 0.15, 0.3, 0.5))),
        _power_law,
    ),
    "maxwell": Law("maxwell", (_stiffness("shear_modulus_pa", _STIFF), _viscosity((0.5, 2.0, 8.0, 30.0))), _maxwell),
}
"""Our laws by their names."""


def law_names() -> tuple[MediumLaw, ...]:
    """Return the names of all laws: ours, then those that other packages bring."""
    return (*LAWS, *(name for name in installed(MEDIA) if name not in LAWS))


@cache
def law_of(name: MediumLaw) -> Law:
    """Return the law of that name; raise ``ValueError`` where there is none, or its package fails."""
    if name in LAWS:
        return LAWS[name]
    if name not in law_names():
        raise ValueError(f"there is no {name} medium: one of {', '.join(law_names())}")
    law, whose = load(MEDIA, name), f"medium {origin(MEDIA, name)}"
    if not isinstance(law, Law):
        raise ExtensionError(f"{whose} is no moduli.Law. Try: its newest version")
    found = replace(law, name=name, modulus=_watched(law.modulus, len(law.parameters), whose))
    _refuse_wrong_derivatives(found, whose)
    return found


def _watched(modulus: Modulus, parameters: int, whose: str) -> Modulus:
    """Return ``modulus`` such that it names its package where it fails or gives other shapes than it should."""

    def watched(s: ComplexArray, values: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        try:
            found, slopes = modulus(s, values)
        except Exception as error:
            raise ExtensionError(f"{whose} failed ({type(error).__name__}: {error}). Try: report it there") from error
        wanted = (*values.shape[:-1], *s.shape)
        if np.shape(found) != wanted or np.shape(slopes) != (*wanted, parameters):
            raise ExtensionError(f"{whose} gave shapes {np.shape(found)} and {np.shape(slopes)}, not {wanted} and more")
        return found, slopes

    return watched


def _refuse_wrong_derivatives(law: Law, whose: str) -> None:
    """Raise ``ExtensionError`` where the derivatives are not those of the modulus: a fit would go astray."""
    s = 2j * np.pi * np.array([50.0, 400.0])
    values = np.array([each.starts[len(each.starts) // 2] for each in law.parameters])
    found, slopes = law.modulus(s, values)
    for index, value in enumerate(values):
        step = np.zeros(values.size)
        step[index] = 1e-5 * max(abs(value), 1e-3)
        change = (law.modulus(s, values + step)[0] - law.modulus(s, values - step)[0]) / (2 * step[index])
        rounding = 1e-6 * float(np.abs(found).max()) / max(abs(value), 1e-3)
        if not np.allclose(change, slopes[:, index], rtol=1e-3, atol=rounding):
            name = law.parameters[index].name
            raise ExtensionError(f"{whose}: its derivative by {name} is not that of its modulus. Try: report it there")
