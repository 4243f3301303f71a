"""Result of an inversion: the laws that explain the vibrations, most likely first."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, fields, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from hpe_rig.medium import MediumLaw, law_of
from hpe_rig.moduli.inversion import Contribution, Moduli, compare_media
from hpe_rig.moduli.map_vibrations import push_of_map, vibrations_of_map
from hpe_rig.moduli.run_vibrations import Source, vibrations_of
from hpe_rig.moduli.scene_geometry import WIDTH_UNCERTAINTY, push_of
from hpe_rig.moduli.vibration_model import Push, Vibration
from hpe_rig.moduli.wavenumber_fit import DispersionCurve, curve_of_law
from hpe_rig.result import MotionMap, dataclass_schema, json_values, object_schema, titled, with_u
from hpe_rig.scene import Scene

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

TESTED_RANGES = {"shear_modulus_pa": (500.0, 500e3), "viscosity_pa_s": (0.0, 50.0)}
"""Ranges of the comparison of the field with independent ones."""
UNITS = {"_pa_s": (1.0, "Pa s"), "_pa": (1e-3, "kPa")}
"""Factor and unit in text, by the suffix of a parameter's name."""
NAMES = {
    "shear_modulus_pa": "shear modulus mu1",
    "branch_modulus_pa": "branch modulus E",
    "viscosity_pa_s": "viscosity mu2",
    "power": "power p",
}


@dataclass(frozen=True, slots=True)
class ModuliResult:
    """Media fitted to the vibrations of one or more runs, the most likely first.

    ``probability`` of each, from equal priors; ``dispersion``: phase velocity and attenuation in each. ``omitted``:
    data that were left out, in words.
    """

    title: str
    simulated: bool
    fits: tuple[Moduli, ...]
    probability: tuple[float, ...]
    dispersion: tuple[DispersionCurve, ...]
    vibrations: tuple[Vibration, ...]
    omitted: tuple[str, ...]

    @property
    def best(self) -> Moduli:
        """The most likely medium."""
        return self.fits[0]

    @property
    def headline(self) -> str:
        """The most likely medium with its parameters and their standard uncertainties, one line."""
        best = self.best
        values = [f"{_name(name)} {_with_uncertainty(best, name, '±')}" for name in best.values]
        return f"{law_of(best.law).title}: {', '.join(values)}"

    def figure(self, *, ax: Axes | Sequence[Axes] | None = None, figsize: tuple[float, float] | None = None) -> Figure:
        """Return a figure of measured amplitude and phase over frequency, with lines of the most likely medium.

        ``ax``: axes for amplitude and phase; ``figsize``: width and height of a new figure, inches.
        """
        from hpe_rig.moduli.figure import PAGE_SIZE_IN, moduli_figure

        return moduli_figure(
            self.vibrations,
            self.best.modelled_m,
            self.headline,
            simulated=self.simulated,
            ax=ax,
            figsize=figsize or PAGE_SIZE_IN,
        )

    def _repr_html_(self) -> str:
        """Return figure and text for a notebook."""
        from html import escape

        from hpe_rig.result import image, picture

        drawing = image(picture(self.figure(), "moduli", "Measured and fitted vibrations", self.headline))
        return f"{drawing}<pre>{escape(str(self))}</pre>"

    def __str__(self) -> str:
        """Return the moduli with their uncertainties, the other laws, and the omitted data."""
        return "\n".join(_lines(self))

    def as_dict(self) -> dict[str, Any]:
        """Return the result as a dictionary of plain values for JSON, with the keys of ``moduli_schema``."""
        laws = zip(self.fits, self.probability, self.dispersion, strict=True)
        modelled = zip(self.vibrations, self.best.modelled_m, strict=True)
        plain: dict[str, Any] = json_values(
            {
                "title": self.title,
                "simulated": self.simulated,
                "omitted": self.omitted,
                "fits": [_fit_as_dict(*law) for law in laws],
                "places": [
                    {
                        "label": vibration.label,
                        "lateral_m": vibration.lateral_m,
                        "axial_m": vibration.axial_m,
                        "frequency_hz": vibration.frequency_hz.tolist(),
                        "amplitude_m": np.abs(vibration.phasor_m).tolist(),
                        "phase_rad": np.angle(vibration.phasor_m).tolist(),
                        "modelled_amplitude_m": np.abs(model_m).tolist(),
                        "modelled_phase_rad": np.angle(model_m).tolist(),
                    }
                    for vibration, model_m in modelled
                ],
            }
        )
        return plain


def _fit_as_dict(fit: Moduli, probability: float, dispersion: DispersionCurve) -> dict[str, Any]:
    """Return the fit of one law as a dictionary for JSON, with the keys of ``moduli_schema``.

    ``probability`` of the law among the fitted ones. ``freedom``: degrees of freedom of ``chi_square``. ``adjusted``:
    nuisance parameters, in units of their uncertainty. ``second``: another minimum that is nearly as good, with its
    chi-square above the best, or None. ``at_limit``: parameters at the end of their range. ``dispersion``: phase
    velocity and attenuation by frequency.
    """
    second_minimum = None
    if fit.second is not None:
        second_values, chi_square_excess = fit.second
        second_minimum = {"values": second_values, "chi_square": chi_square_excess}
    names = "law", "values", "uncertainty", "chi_square", "freedom", "significance"
    return {
        **{name: getattr(fit, name) for name in names},
        "probability": probability,
        "dispersion": {name: values.tolist() for name, values in asdict(dispersion).items()},
        "excluded": fit.excluded,
        "covariance": fit.covariance.tolist(),
        "adjusted": fit.adjusted,
        "second": second_minimum,
        "at_limit": fit.at_limit,
        "beyond_tested": beyond_tested(fit),
        "by_place": [asdict(contribution) for contribution in fit.by_place],
        "by_frequency": [asdict(contribution) for contribution in fit.by_frequency],
    }


def moduli_schema() -> dict[str, Any]:
    """Return the JSON schema of the output of ``hpe-rig moduli --json``."""
    second = object_schema("Another minimum.", {"values": dict[str, float], "chi_square": float})
    contributions = {"type": "array", "items": dataclass_schema(Contribution)}
    curve_names = [field.name for field in fields(DispersionCurve)]
    fit = {
        "law": str,
        "values": dict[str, float],
        "uncertainty": dict[str, float],
        "chi_square": float,
        "freedom": int,
        "significance": float,
        "probability": float,
        "dispersion": object_schema(DispersionCurve.__doc__ or "", dict.fromkeys(curve_names, tuple[float, ...])),
        "excluded": bool,
        "covariance": tuple[tuple[float, ...], ...],
        "adjusted": dict[str, float],
        "second": {"anyOf": [{"type": "null"}, second]},
        "at_limit": tuple[str, ...],
        "beyond_tested": tuple[str, ...],
        "by_place": contributions,
        "by_frequency": contributions,
    }
    curves = ("frequency_hz", "amplitude_m", "phase_rad", "modelled_amplitude_m", "modelled_phase_rad")
    gate = {"label": str, "lateral_m": float, "axial_m": float, **dict.fromkeys(curves, tuple[float, ...])}
    result = {
        "title": str,
        "simulated": bool,
        "omitted": tuple[str, ...],
        "fits": {"type": "array", "items": object_schema(Moduli.__doc__ or "", fit)},
        "places": {"type": "array", "items": object_schema("Measured and fitted vibration in one gate.", gate)},
    }
    return titled("Moduli of hpe-rig", object_schema(ModuliResult.__doc__ or "", result))


def beyond_tested(fit: Moduli) -> tuple[str, ...]:
    """Return the parameters of ``fit`` outside ``TESTED_RANGES``."""
    limits = ((name, *limits) for name, limits in TESTED_RANGES.items() if name in fit.values)
    return tuple(name for name, low, high in limits if not low <= fit.values[name] <= high)


def moduli_of(
    sources: Sequence[Source],
    laws: Sequence[MediumLaw] | None = None,
    estimator: str | None = None,
    width_uncertainty: float = WIDTH_UNCERTAINTY,
    common_amplitude: bool = True,
) -> ModuliResult:
    """Return the moduli of the medium from the vibrations measured in the runs ``sources``.

    ``width_uncertainty``: relative, of the widths of the force. ``common_amplitude``: the force was equally strong at
    all lateral offsets. Raises ``SettingsError`` if a scene states no push or scenes push differently, and
    ``ValueError`` if no vibration exceeds its noise.
    """
    push = push_of([source.scene for source in sources], width_uncertainty)
    vibrations, omitted = vibrations_of(sources, estimator, common_amplitude)
    result = _fitted(sources[0].scene.title, vibrations, omitted, push, laws)
    return replace(result, simulated=any(source.stored.simulated for source in sources))


def moduli_of_map(
    motion_map: MotionMap,
    scene: Scene,
    laws: Sequence[MediumLaw] | None = None,
    width_uncertainty: float = WIDTH_UNCERTAINTY,
) -> ModuliResult:
    """Return the moduli of the medium from the lines of a map in the depth of the focus; raise as ``moduli_of``.

    ``scene`` states the push and the tracking beam.
    """
    push = push_of_map(motion_map, scene, width_uncertainty)
    vibrations, omitted = vibrations_of_map(motion_map, scene)
    return _fitted(scene.title, vibrations, omitted, push, laws)


def _fitted(
    title: str,
    vibrations: Sequence[Vibration],
    omitted: Sequence[str],
    push: Push,
    laws: Sequence[MediumLaw] | None,
) -> ModuliResult:
    """Return the moduli fitted to measured ``vibrations``; raise ``ValueError`` if there are none."""
    if not vibrations:
        raise ValueError("no vibration exceeds its noise: " + "; ".join(omitted))
    # Every law is fitted, because the user needs to know which ones the data exclude.
    fits, probability = compare_media(vibrations, push, laws)
    frequency_hz = np.unique(np.concatenate([vibration.frequency_hz for vibration in vibrations]))
    return ModuliResult(
        title=title,
        simulated=False,
        fits=fits,
        probability=tuple(probability.tolist()),
        dispersion=tuple(curve_of_law(fit, frequency_hz, push.density_kg_per_m3) for fit in fits),
        vibrations=tuple(vibrations),
        omitted=tuple(omitted),
    )


def _lines(result: ModuliResult) -> Iterator[str]:
    """Yield the lines of a result's text: data, every law with its fit, and omitted vibrations."""
    yield result.title
    yield _data_line(result)
    yield ""
    for fit, probability, dispersion in zip(result.fits, result.probability, result.dispersion, strict=True):
        misfit = f"chi-square {fit.chi_square:.4g}, {fit.freedom} degrees of freedom"
        verdict = "EXCLUDED by the data" if fit.excluded else f"probability {probability:.2g}"
        yield f"{law_of(fit.law).title}, {verdict} ({misfit})"
        if fit is result.best or not fit.excluded:
            yield from (f"  {line}" for line in _fit_lines(fit))
            yield f"  phase velocity {_speed_text(dispersion, 0)}, {_speed_text(dispersion, -1)}"
    if result.best.excluded:
        yield "no fitted medium explains these vibrations. Try: check widths, lateral offsets and the assumed laws"
    yield from (f"omitted: {line}" for line in result.omitted)


def _data_line(result: ModuliResult) -> str:
    """Return the line with the numbers of lateral offsets, gates and fitted numbers."""
    numbers = sum(2 * vibration.frequency_hz.size for vibration in result.vibrations)
    source, gates = "SIMULATED, " if result.simulated else "", len(result.vibrations)
    # Several gates over depth belong to one lateral offset.
    offsets = len({(vibration.position, vibration.lateral_m) for vibration in result.vibrations})
    gate_count = f", {gates} gates" if gates > offsets else ""
    return f"{source}{offsets} lateral offset{'s' * (offsets > 1)}{gate_count}, {numbers} numbers"


def _fit_lines(fit: Moduli) -> Iterator[str]:
    """Yield the lines on one law: parameters, second minimum, warnings, and the data that contribute most."""
    for name, value in fit.values.items():
        relative = f" ({100 * fit.uncertainty[name] / value:.2g} %)" if value else ""
        yield f"{_name(name)} {_with_uncertainty(fit, name)}{relative}"
    if fit.second is not None:
        values, excess = fit.second
        second = ", ".join(f"{_name(name)} {value * _unit(name)[0]:.3g}" for name, value in values.items())
        yield f"nearly as good: {second} (chi-square {excess:.2g} higher)"
    for name in beyond_tested(fit):
        (low, high), (factor, unit) = TESTED_RANGES[name], _unit(name)
        yield f"WARNING {_name(name)} is outside the tested range, {low * factor:g} to {high * factor:g} {unit}"
    for name in fit.at_limit:
        yield f"{_name(name)} is at the end of its range"
    for kind, contributions in (("gate", fit.by_place), ("frequency", fit.by_frequency)):
        if contributions:
            largest = max(contributions, key=lambda contribution: contribution.growth[0])
            yield (
                f"largest contribution by {kind}: {largest.label}; without it the uncertainty of "
                f"{_name(next(iter(fit.values)))} is {largest.growth[0]:.2f} times as large"
            )


def _speed_text(curve: DispersionCurve, index: int) -> str:
    """Return the text of the phase velocity at the frequency of this index."""
    speed, u = curve.phase_velocity_m_per_s[index], curve.phase_velocity_uncertainty_m_per_s[index]
    return f"{with_u(speed, u)} m/s at {curve.frequency_hz[index]:g} Hz"


def _unit(parameter: str) -> tuple[float, str]:
    """Return the factor and unit for printing a parameter."""
    return next((UNITS[suffix] for suffix in UNITS if parameter.endswith(suffix)), (1.0, ""))


def _name(parameter: str) -> str:
    """Return the printed name of a parameter; for a law of another package, its key without the unit."""
    suffix = next((suffix for suffix in UNITS if parameter.endswith(suffix)), "")
    return NAMES.get(parameter, parameter.removesuffix(suffix).replace("_", " "))


def _with_uncertainty(fit: Moduli, parameter: str, sign: str = "+-") -> str:
    """Return the text of a parameter with its uncertainty and unit, to two digits of the uncertainty."""
    factor, unit = _unit(parameter)
    value, uncertainty = fit.values[parameter] * factor, fit.uncertainty[parameter] * factor
    return f"{with_u(value, uncertainty).replace('+-', sign)} {unit}".rstrip()
