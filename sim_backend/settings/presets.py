"""Specimens and receive chains by name: what each sets where the scene is silent, with the source of every value."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

Preset = Literal["gelatin_8", "gelatin_12", "gelatin_15", "bovine_muscle"]


def _gelatin(shear_modulus_pa: float) -> dict[str, Any]:
    return {
        # Paper, Sec. IV.B, by its stainless steel sphere; a Voigt medium is what that method fits.
        "medium": "voigt",
        "shear_modulus_pa": shear_modulus_pa,
        "shear_viscosity_pa_s": 1.0,
        "density_kg_per_m3": 1000.0,  # assumed
        # Assumed; the paper says only that graphite, not gelatin, makes the attenuation.
        "attenuation_db_per_cm_mhz": 0.5,
        "depth_m": 12.5e-3,  # assumed, as of the muscle: the paper does not say how deep its gelatins were measured
    }


PRESETS: Mapping[str, Mapping[str, Any]] = {
    "gelatin_8": _gelatin(4.0e3),
    "gelatin_12": _gelatin(7.25e3),
    "gelatin_15": _gelatin(13.5e3),
    "bovine_muscle": {
        # The paper gives no moduli. Bovine muscle in vitro across the fibres, by shear wave dispersion, from the same
        # group: Chen, Urban, Pislaru, Kinnick, Zheng, Yao and Greenleaf, IEEE Trans. UFFC 56 (2009), p. 55 (from
        # memory; along the fibres 29 kPa and 9.9 Pa s). That the paper's waves crossed the fibres is assumed.
        "medium": "voigt",
        "shear_modulus_pa": 12.0e3,
        "shear_viscosity_pa_s": 5.7,
        "density_kg_per_m3": 1060.0,  # assumed, usual for muscle
        # Post rigor bovine muscle across the fibres, 4 MHz, 20 degrees C: abstract of "Attenuation of ultrasound in
        # post rigor bovine skeletal muscle". Sound speed: leave 1540 m/s or set simulation.sound_speed_m_per_s (1580).
        "attenuation_db_per_cm_mhz": 0.55,
    },
}


_BAND = {"centre_hz": 9.0e6, "bandwidth": 0.33}

CHAIN_PRESETS: Mapping[str, Mapping[str, Any]] = {
    "paper": {
        # Centres and widths: paper, Sec. III.B. Orders, switch, noise and amplifier: assumed, see their settings.
        "notch": {"centre_hz": 3.0e6, "bandwidth": 0.5},
        "recovery_time_s": 2.0e-6,
        "noise_v_per_sqrt_hz": 2.0e-9,
        "band_pass": _BAND,
        "log_amplifier": {},
        "second_band_pass": _BAND,
    },
}


def filled(given: Any, presets: Mapping[str, Mapping[str, Any]]) -> Any:
    """Return settings with what their ``preset`` names filled in; anything that is no table unchanged."""
    if not isinstance(given, Mapping):
        return given
    return {**presets.get(str(given.get("preset")), {}), **given}


def with_depth_as_stated(given: Any) -> Any:
    """Return the twin's settings with ``specimen.depth_m`` of a preset only where they do not say otherwise themselves.

    Another depth of ``propagation`` counts, and an attenuation of ``scatterers`` stands in place of the specimen's; a
    way to the focus that is shorter lies all in the specimen. Whatever has another form is returned unchanged.
    """
    sections = given if isinstance(given, Mapping) else {}
    specimen, scatterers, propagation, beams = (
        section if isinstance(section := sections.get(name), Mapping) else {}
        for name in ("specimen", "scatterers", "propagation", "beams")
    )
    depth_m = PRESETS.get(str(specimen.get("preset")), {}).get("depth_m")
    if depth_m is None or "depth_m" in specimen:
        return given
    way_m = beams.get("tracking_focus_depth_m", beams.get("focus_depth_m"))
    if scatterers.get("attenuation_db_per_cm_mhz"):
        depth_m = None
    elif "specimen_depth_m" in propagation:
        depth_m = propagation["specimen_depth_m"]
    elif isinstance(way_m, float) and 0 < way_m < depth_m:
        depth_m = way_m
    else:
        return given
    return {**given, "specimen": {**specimen, "depth_m": depth_m}}
