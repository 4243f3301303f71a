"""Outcome of an inversion: the media that explain the vibrations, likeliest first, beside the plane wave's moduli."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from hpe_rig.medium import MediumLaw, law_of
from hpe_rig.moduli.inversion import Contribution, Moduli, compare_media
from hpe_rig.moduli.places import WIDTH_UNCERTAINTY, Source, push_of, vibrations_of
from hpe_rig.moduli.shear_speed import Voigt, fit_voigt, shear_speed
from hpe_rig.moduli.vibration_model import Vibration
from hpe_rig.result import dataclass_schema, json_values, object_schema, titled

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TESTED = {"shear_modulus_pa": (500.0, 500e3), "viscosity_pa_s": (0.0, 50.0)}
"""Between which the field has been compared with independent ones."""
ANY_GAIN = 5.0
"""Uncertainty of the logarithm of a gain of which nothing is known."""
UNITS = {"_pa_s": (1.0, "Pa s"), "_pa": (1e-3, "kPa")}
"""Factor and unit for a reader, by the end of a parameter's name."""
NAMES = {
    "shear_modulus_pa": "shear modulus mu1",
    "branch_modulus_pa": "branch modulus E",
    "viscosity_pa_s": "viscosity mu2",
    "power": "power p",
}


def _unit(name: str) -> tuple[float, str]:
    return next((UNITS[end] for end in UNITS if name.endswith(end)), (1.0, ""))


def _name(name: str) -> str:
    """Return what a parameter is called; of another package's medium its key without the unit."""
    end = next((end for end in UNITS if name.endswith(end)), "")
    return NAMES.get(name, name.removesuffix(end).replace("_", " "))


@dataclass(frozen=True, slots=True)
class ModuliResult:
    """Media fitted to the vibrations of one or more runs, the likeliest first.

    ``probability`` of each, all equally likely beforehand; ``omitted``: what was left out, in words; ``plane_wave``:
    the Voigt moduli that the phase's fall with distance gives, None with one place or where it does not fall
    (``why_not``): for comparison, since near the push the wave is not plane.
    """

    title: str
    simulated: bool
    fits: tuple[Moduli, ...]
    probability: tuple[float, ...]
    vibrations: tuple[Vibration, ...]
    omitted: tuple[str, ...]
    plane_wave: Voigt | None
    why_not: str

    @property
    def best(self) -> Moduli:
        """The likeliest medium."""
        return self.fits[0]

    def __str__(self) -> str:
        """Return the moduli with their uncertainties, what else was tried, and what was left out."""
        return "\n".join(_lines(self))

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        fits = [
            {
                **{name: getattr(fit, name) for name in ("law", "values", "uncertainty", "chi_square", "freedom")},
                "significance": fit.significance,
                "probability": probability,
                "excluded": fit.excluded,
                "covariance": fit.covariance.tolist(),
                "adjusted": fit.adjusted,
                "second": None if fit.second is None else {"values": fit.second[0], "chi_square": fit.second[1]},
                "at_limit": fit.at_limit,
                "beyond_tested": beyond_tested(fit),
                "by_place": [asdict(each) for each in fit.by_place],
                "by_frequency": [asdict(each) for each in fit.by_frequency],
            }
            for fit, probability in zip(self.fits, self.probability, strict=True)
        ]
        places = [
            {
                "label": one.label,
                "lateral_m": one.lateral_m,
                "axial_m": one.axial_m,
                "frequency_hz": one.frequency_hz.tolist(),
                "amplitude_m": np.abs(one.phasor_m).tolist(),
                "phase_rad": np.angle(one.phasor_m).tolist(),
                "modelled_amplitude_m": np.abs(modelled).tolist(),
                "modelled_phase_rad": np.angle(modelled).tolist(),
            }
            for one, modelled in zip(self.vibrations, self.best.modelled_m, strict=True)
        ]
        wave = self.plane_wave
        plane = (
            None if wave is None else {"shear_modulus_pa": wave.elasticity_pa, "viscosity_pa_s": wave.viscosity_pa_s}
        )
        known = {"title": self.title, "simulated": self.simulated, "omitted": self.omitted}
        plain: dict[str, Any] = json_values({**known, "fits": fits, "places": places, "plane_wave": plane})
        return plain

    @property
    def headline(self) -> str:
        """The likeliest medium with its parameters and their standard uncertainties, one line."""
        best = self.best
        values = [f"{_name(name)} {_with_u(best, name, '±')}" for name in best.values]
        return f"{law_of(best.law).title}: {', '.join(values)}"

    def figure(self) -> Figure:
        """Return measured and fitted amplitude and phase over frequency, a colour a place, with bars of 2 u."""
        from hpe_rig.moduli.figure import moduli_figure

        return moduli_figure(self)


def moduli_schema() -> dict[str, Any]:
    """Return the JSON schema of what ``hpe-rig moduli --json`` prints."""
    second = object_schema("Another minimum.", {"values": dict[str, float], "chi_square": float})
    parts = {"type": "array", "items": dataclass_schema(Contribution)}
    fit = {
        "law": str,
        "values": dict[str, float],
        "uncertainty": dict[str, float],
        "chi_square": float,
        "freedom": int,
        "significance": float,
        "probability": float,
        "excluded": bool,
        "covariance": tuple[tuple[float, ...], ...],
        "adjusted": dict[str, float],
        "second": {"anyOf": [{"type": "null"}, second]},
        "at_limit": tuple[str, ...],
        "beyond_tested": tuple[str, ...],
        "by_place": parts,
        "by_frequency": parts,
    }
    curves = ("frequency_hz", "amplitude_m", "phase_rad", "modelled_amplitude_m", "modelled_phase_rad")
    place = {"label": str, "lateral_m": float, "axial_m": float, **dict.fromkeys(curves, tuple[float, ...])}
    wave = object_schema("Voigt moduli of a plane wave.", {"shear_modulus_pa": float, "viscosity_pa_s": float})
    whole = {
        "title": str,
        "simulated": bool,
        "omitted": tuple[str, ...],
        "fits": {"type": "array", "items": object_schema(Moduli.__doc__ or "", fit)},
        "places": {"type": "array", "items": object_schema("What was measured and fitted at one place.", place)},
        "plane_wave": {"anyOf": [{"type": "null"}, wave]},
    }
    return titled("Moduli of hpe-rig", object_schema(ModuliResult.__doc__ or "", whole))


def beyond_tested(fit: Moduli) -> tuple[str, ...]:
    """Return the parameters of ``fit`` whose values lie beyond those that the field was tested with."""
    inside = {name: low <= fit.values.get(name, low) <= high for name, (low, high) in TESTED.items()}
    return tuple(name for name, within in inside.items() if not within)


def moduli_of(
    sources: Sequence[Source],
    laws: Sequence[MediumLaw] | None = None,
    estimator: str | None = None,
    width_uncertainty: float = WIDTH_UNCERTAINTY,
    common_amplitude: bool = True,
) -> ModuliResult:
    """Return what the vibrations in ``sources`` say of the medium.

    ``width_uncertainty``: relative, of the widths of the force; ``common_amplitude``: whether its strength was the same
    at all places. Raises ``SettingsError`` where a scene lacks what that needs or scenes push differently, and
    ``ValueError`` where no place has a vibration.
    """
    push = push_of([source.scene for source in sources], width_uncertainty)
    vibrations, omitted = vibrations_of(sources, estimator)
    if not common_amplitude:
        vibrations = [replace(one, gain_uncertainty=ANY_GAIN) for one in vibrations]
    if not vibrations:
        raise ValueError("no place has a vibration that stands out of its noise: " + "; ".join(omitted))
    fits, probability = compare_media(vibrations, push, laws)
    wave, why_not = plane_wave_of(vibrations, push.density_kg_per_m3)
    simulated = any(source.stored.simulated for source in sources)
    title = sources[0].scene.title
    return ModuliResult(
        title, simulated, fits, tuple(probability.tolist()), tuple(vibrations), tuple(omitted), wave, why_not
    )


def plane_wave_of(vibrations: Sequence[Vibration], density_kg_per_m3: float) -> tuple[Voigt | None, str]:
    """Return the moduli by phase gradient, of the frequencies that all places have; None and why where it fails."""
    common = set.intersection(*(set(one.frequency_hz.tolist()) for one in vibrations))
    ordered = sorted(vibrations, key=lambda one: abs(one.lateral_m))
    parts = [one.only(np.isin(one.frequency_hz, sorted(common))) for one in ordered]
    sigma = [np.sqrt(np.diag(one.covariance_m2)[::2]) / np.abs(one.phasor_m) for one in parts]
    try:
        speed = shear_speed(
            [abs(one.lateral_m) for one in parts],
            parts[0].frequency_hz,
            np.array([np.angle(one.phasor_m) for one in parts]),
            np.array(sigma),
        )
        return fit_voigt(speed, density_kg_per_m3), ""
    except ValueError as error:
        return None, str(error)


def _lines(result: ModuliResult) -> Iterator[str]:
    best, places = result.best, result.vibrations
    yield result.title
    numbers = sum(2 * one.frequency_hz.size for one in places)
    source = "SIMULATED, " if result.simulated else ""
    beside = len({(one.place, one.lateral_m) for one in places})
    gates = f", {len(places)} gates" if len(places) > beside else ""
    yield f"{source}{beside} place{'s' * (beside > 1)}{gates}, {numbers} numbers"
    yield ""
    for fit, probability in zip(result.fits, result.probability, strict=True):
        yield f"{law_of(fit.law).title}, {_verdict(fit, probability)}"
        if fit is best or not fit.excluded:
            yield from (f"  {line}" for line in _values(fit))
    if result.plane_wave is not None:
        wave = result.plane_wave
        yield f"plane wave, for comparison: mu1 {wave.elasticity_pa * 1e-3:.4g} kPa, mu2 {wave.viscosity_pa_s:.3g} Pa s"
        yield "  within a wavelength or two of the push the wave is not plane: its speed comes out by a sixth too low"
    else:
        yield f"plane wave: {result.why_not}"
    if best.excluded:
        yield "no medium tried explains these vibrations: widths, places or the medium are not as assumed"
    for line in result.omitted:
        yield f"left out: {line}"


def _verdict(fit: Moduli, probability: float) -> str:
    misfit = f"chi-square {fit.chi_square:.4g} over {fit.freedom}"
    return f"EXCLUDED by the data ({misfit})" if fit.excluded else f"probability {probability:.2g} ({misfit})"


def _values(fit: Moduli) -> Iterator[str]:
    for name, value in fit.values.items():
        share = f" ({100 * fit.uncertainty[name] / value:.2g} %)" if value else ""
        yield f"{_name(name)} {_with_u(fit, name, '+-')}{share}"
    if fit.second is not None:
        other = ", ".join(f"{_name(name)} {value * _unit(name)[0]:.3g}" for name, value in fit.second[0].items())
        yield f"nearly as good: {other} (chi-square {fit.second[1]:.2g} higher)"
    for name in beyond_tested(fit):
        (low, high), (factor, unit) = TESTED[name], UNITS[name]
        tested = f"{low * factor:g} to {high * factor:g} {unit}, with which the field was tested"
        yield f"WARNING {NAMES[name]} lies outside {tested}"
    for name in fit.at_limit:
        yield f"{_name(name)} stands at the end of its range"
    for kind, by in ((fit.by_place, "place"), (fit.by_frequency, "frequency")):
        if kind:
            most = max(kind, key=lambda part: part.growth[0])
            yield f"most is owed to the {by} {most.label}: without it u of mu1 is {most.growth[0]:.2f} times as large"


def _with_u(fit: Moduli, name: str, sign: str) -> str:
    """Return a parameter with its uncertainty and unit, as many decimals as two digits of the uncertainty have."""
    factor, unit = _unit(name)
    value, u = fit.values[name] * factor, fit.uncertainty[name] * factor
    if not 0 < u < math.inf:
        return f"{value:.4f} {sign} {u:.2g} {unit}".rstrip()
    rounded = float(f"{u:.1e}")
    decimals = max(0, 1 - math.floor(math.log10(rounded)))
    return f"{value:.{decimals}f} {sign} {rounded:.{decimals}f} {unit}".rstrip()
