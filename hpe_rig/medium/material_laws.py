"""Material laws: the complex shear modulus G(s), s = jw, of each law, with its derivatives by the law's parameters.

    Voigt        G = mu1 + s mu2
    Zener        G = mu1 + s mu2 / (1 + s mu2 / E)
    Maxwell      G = s mu2 / (1 + s mu2 / mu1)
    power law    G = mu1 (s / 2 pi f_0)^p,    f_0 = ``POWER_REFERENCE_HZ``

mu1 (Pa) is the shear modulus, mu2 (Pa s) the viscosity, E (Pa) the spring in series with the dashpot, p the exponent.

A fit varies a *coordinate* of each parameter: ln mu for a stiffness, asinh(mu2 / 0.05 Pa s) for a viscosity. The
asinh is logarithmic for large viscosities and still includes zero.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from hpe_rig.arrays import ComplexArray, FloatArray
from hpe_rig.extensions import MEDIA, ExtensionError, call, installed, load, origin

MediumLaw = str
"""Name of a law: one of ``LAWS`` or one of an installed package."""

Modulus = Callable[[ComplexArray, FloatArray], tuple[ComplexArray, ComplexArray]]
Transform = Callable[[FloatArray | float], FloatArray]

POWER_REFERENCE_HZ = 100.0
"""Frequency where a power-law medium has its modulus."""
SMALL_VISCOSITY_PA_S = 0.05
"""Viscosity below which its coordinate is linear."""


@dataclass(frozen=True, slots=True)
class Parameter:
    """One parameter of a law: its name with unit, its range, the ``starts`` of a fit, and its coordinate."""

    name: str
    limits: tuple[float, float]
    starts: tuple[float, ...]
    to_coordinate: Transform
    to_value: Transform
    slope: Transform
    """Derivative of the value by the coordinate, as a function of the value."""

    @classmethod
    def logarithmic(cls, name: str, limits: tuple[float, float], starts: tuple[float, ...]) -> Parameter:
        """Return a parameter with the coordinate ln(value), for example a stiffness."""
        return cls(name=name, limits=limits, starts=starts, to_coordinate=np.log, to_value=np.exp, slope=np.asarray)

    @classmethod
    def linear(cls, name: str, limits: tuple[float, float], starts: tuple[float, ...]) -> Parameter:
        """Return a parameter that a fit varies as it is, without a transformation: an exponent, for example."""
        return cls(
            name=name,
            limits=limits,
            starts=starts,
            to_coordinate=_identity,
            to_value=_identity,
            slope=lambda value: np.ones_like(_identity(value)),
        )

    @property
    def bounds(self) -> tuple[float, float]:
        """The coordinates of the limits."""
        return float(self.to_coordinate(self.limits[0])), float(self.to_coordinate(self.limits[1]))


@dataclass(frozen=True, slots=True)
class Law:
    """A material law: its parameters, and its modulus with derivatives by their values.

    ``modulus(s, values)`` takes s (frequency,) in rad/s and values (..., parameter). It returns the modulus
    (..., frequency) and its derivatives (..., frequency, parameter). It must be analytic in s except on the negative
    real axis, because the twin moves by it too. ``title`` is the name in tables. ``creeps`` states that a constant
    force moves the medium without limit.
    """

    name: MediumLaw
    parameters: tuple[Parameter, ...]
    modulus: Modulus
    title: str = ""
    creeps: bool = False

    def __post_init__(self) -> None:
        """Derive the title from the name if none is given."""
        object.__setattr__(self, "title", self.title or self.name.replace("_", " ").capitalize())

    def values(self, coordinates: FloatArray) -> FloatArray:
        """Return the parameter values at ``coordinates`` (..., parameter)."""
        columns = [parameter.to_value(coordinates[..., i]) for i, parameter in enumerate(self.parameters)]
        return np.stack(columns, axis=-1)

    def coordinates(self, values: FloatArray) -> FloatArray:
        """Return the coordinates of ``values`` (parameter,)."""
        pairs = zip(self.parameters, values, strict=True)
        return np.array([parameter.to_coordinate(value) for parameter, value in pairs])

    def slopes(self, values: FloatArray) -> FloatArray:
        """Return the derivatives of the values by the coordinates, (..., parameter)."""
        columns = [parameter.slope(values[..., i]) for i, parameter in enumerate(self.parameters)]
        return np.stack(columns, axis=-1)

    def bounds(self) -> FloatArray:
        """Return the coordinates of the limits, (parameter, 2)."""
        return np.array([parameter.bounds for parameter in self.parameters])

    def starts(self) -> FloatArray:
        """Return the coordinates (start, parameter) of a coarse grid over soft media."""
        axes = (parameter.to_coordinate(np.array(parameter.starts)) for parameter in self.parameters)
        return np.stack([axis.ravel() for axis in np.meshgrid(*axes, indexing="ij")], axis=-1)


@dataclass(frozen=True, slots=True, eq=False)
class HarmonicMedium:
    """A medium under steady vibration: complex modulus (..., frequency) at ``frequency_hz``, and density."""

    frequency_hz: FloatArray
    modulus_pa: ComplexArray
    density_kg_per_m3: float = 1000.0

    @classmethod
    def voigt(cls, modulus_pa: float, viscosity_pa_s: float, frequency_hz: FloatArray) -> HarmonicMedium:
        """Return a Voigt medium with the density of water."""
        return cls(frequency_hz, np.asarray(modulus_pa + 2j * np.pi * frequency_hz * viscosity_pa_s))

    @property
    def shear_k2(self) -> ComplexArray:
        """Squared wave number q^2 = rho w^2 / G of shear waves, (..., frequency)."""
        return np.asarray(self.density_kg_per_m3 * (2 * np.pi * self.frequency_hz) ** 2 / self.modulus_pa)


def _identity(value: FloatArray | float) -> FloatArray:
    return np.asarray(value, dtype=np.float64)


def _viscosity(starts: tuple[float, ...]) -> Parameter:
    """Return the parameter viscosity, which a fit varies as arcsinh(value / SMALL_VISCOSITY_PA_S).

    This coordinate is logarithmic, but finite at zero viscosity.
    """
    small = SMALL_VISCOSITY_PA_S
    return Parameter(
        name="viscosity_pa_s",
        limits=(0.0, 500.0),
        starts=starts,
        to_coordinate=lambda value: np.asarray(np.arcsinh(np.asarray(value) / small)),
        to_value=lambda coordinate: np.asarray(small * np.sinh(coordinate)),
        slope=lambda value: np.asarray(np.hypot(value, small)),
    )


def _voigt(s: ComplexArray, values: FloatArray) -> tuple[ComplexArray, ComplexArray]:
    """Return the modulus G = mu1 + s mu2 (..., frequency) and its derivatives by (mu1, mu2), (..., frequency, 2).

    ``s`` (frequency,): complex frequency, j w for vibration. ``values`` (..., 2): mu1 in Pa, mu2 in Pa s.
    """
    mu1, mu2 = (values[..., i, None] for i in range(2))
    modulus = mu1 + s * mu2
    return modulus, np.stack(np.broadcast_arrays(np.ones_like(modulus), s + 0 * modulus), axis=-1)


def _spring_and_dashpot(
    s: ComplexArray, spring: FloatArray, dashpot: FloatArray
) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
    """Return the modulus s eta k / (k + s eta) of a spring k in series with a dashpot eta, and its derivatives by both.

    ``s``: complex frequency, j w for vibration.
    """
    ratio = s * dashpot / spring
    return s * dashpot / (1 + ratio), (ratio / (1 + ratio)) ** 2, s / (1 + ratio) ** 2


def _zener(s: ComplexArray, values: FloatArray) -> tuple[ComplexArray, ComplexArray]:
    """Return the modulus of a spring parallel to a spring and dashpot in series, (..., frequency), and its derivatives.

    ``s`` (frequency,): complex frequency. ``values`` and derivatives: along the last axis, in the order spring, spring
    of the branch, dashpot.
    """
    mu1, spring, dashpot = (values[..., i, None] for i in range(3))
    branch, by_spring, by_dashpot = _spring_and_dashpot(s, spring, dashpot)
    return mu1 + branch, np.stack([np.ones_like(branch), by_spring, by_dashpot], axis=-1)


def _maxwell(s: ComplexArray, values: FloatArray) -> tuple[ComplexArray, ComplexArray]:
    """Return the modulus of a spring and a dashpot in series, and its derivatives by both."""
    branch, by_spring, by_dashpot = _spring_and_dashpot(s, values[..., 0, None], values[..., 1, None])
    return branch, np.stack([by_spring, by_dashpot], axis=-1)


def _power_law(s: ComplexArray, values: FloatArray) -> tuple[ComplexArray, ComplexArray]:
    """Return the modulus G = mu (s / w_0)^p (..., frequency) and its derivatives by (mu, p), (..., frequency, 2).

    w_0 = 2 pi POWER_REFERENCE_HZ. ``s`` (frequency,): complex frequency. ``values`` (..., 2): mu in Pa, p.
    """
    relative_s = s / (2 * np.pi * POWER_REFERENCE_HZ)
    powers = relative_s ** values[..., 1, None]
    modulus = values[..., 0, None] * powers
    return modulus, np.stack([powers, modulus * np.log(relative_s)], axis=-1)


# Starting values span soft tissue and phantoms: neighbours lie within one basin of attraction of the fit.
_SHEAR_MODULUS = Parameter.logarithmic("shear_modulus_pa", (100.0, 2e6), (0.7e3, 2e3, 6e3, 18e3, 60e3, 250e3))
# At its upper limit the branch is rigid, so that Zener includes Voigt: within 2 Pa at 1 kHz and 5.7 Pa s.
_BRANCH_MODULUS = Parameter.logarithmic("branch_modulus_pa", (100.0, 1e9), (2e3, 15e3, 100e3, 1e6))
_POWER = Parameter.linear("power", (0.0, 0.95), (0.02, 0.15, 0.3, 0.5))
LAWS: dict[MediumLaw, Law] = {
    law.name: law
    for law in (
        Law("voigt", (_SHEAR_MODULUS, _viscosity((0.02, 0.5, 2.0, 8.0, 30.0))), _voigt),
        Law("zener", (_SHEAR_MODULUS, _BRANCH_MODULUS, _viscosity((0.5, 2.0, 8.0))), _zener),
        Law("power_law", (_SHEAR_MODULUS, _POWER), _power_law),
        Law("maxwell", (_SHEAR_MODULUS, _viscosity((0.5, 2.0, 8.0, 30.0))), _maxwell),
    )
}
"""The laws of this package by name."""


def law_names() -> tuple[MediumLaw, ...]:
    """Return the names of all laws: those of this package, then those of installed packages."""
    return (*LAWS, *(name for name in installed(MEDIA) if name not in LAWS))


@cache
def law_of(name: MediumLaw) -> Law:
    """Return the material law ``name``, built in or from a plug-in; raise ``ValueError`` without a valid one."""
    if name in LAWS:
        return LAWS[name]
    if name not in law_names():
        raise ValueError(f"there is no {name} medium: one of {', '.join(law_names())}")
    law, source = load(MEDIA, name), f"medium {origin(MEDIA, name)}"
    if not isinstance(law, Law):
        raise ExtensionError(f"{source} is no medium.Law. Try: its newest version")
    checked = replace(law, name=name, modulus=_with_shape_check(law.modulus, len(law.parameters), source))
    _require_true_derivatives(checked, source)
    return checked


def _with_shape_check(modulus: Modulus, parameters: int, source: str) -> Modulus:
    """Wrap the ``modulus`` of a plug-in's law: its errors name ``source``, and results of a wrong shape are errors."""

    def checked(s: ComplexArray, values: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        """Return the result of ``modulus``; raise ``ExtensionError`` if it fails."""
        value, slopes = call(source, lambda: modulus(s, values))
        shape = (*values.shape[:-1], *s.shape)
        if np.shape(value) != shape or np.shape(slopes) != (*shape, parameters):
            raise ExtensionError(
                f"{source} returned shapes {np.shape(value)} and {np.shape(slopes)}, not {shape} and "
                f"{(*shape, parameters)}. Try: report it there"
            )
        if not (np.isfinite(value).all() and np.isfinite(slopes).all()):
            raise ExtensionError(f"{source} returned values that are not finite. Try: report it there")
        return value, slopes

    return checked


def _require_true_derivatives(law: Law, source: str) -> None:
    """Raise ``ExtensionError`` if a derivative of a plug-in's law differs from a central difference of its modulus.

    A fit with wrong derivatives would not converge.
    """
    s = 2j * np.pi * np.array([50.0, 400.0])
    values = np.array([parameter.starts[len(parameter.starts) // 2] for parameter in law.parameters])
    modulus, slopes = law.modulus(s, values)
    for index, (parameter, value) in enumerate(zip(law.parameters, values.tolist(), strict=True)):
        size = max(abs(value), 1e-3)
        step = np.zeros(values.size)
        step[index] = 1e-5 * size
        change = (law.modulus(s, values + step)[0] - law.modulus(s, values - step)[0]) / (2 * step[index])
        rounding_error = 1e-6 * float(np.abs(modulus).max()) / size
        if not np.allclose(change, slopes[:, index], rtol=1e-3, atol=rounding_error):
            raise ExtensionError(
                f"{source}: its derivative by {parameter.name} is not that of its modulus. Try: report it there"
            )
