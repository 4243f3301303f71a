"""Specimens and receive chains by name: settings that the scene omits, with the source of every value."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

Preset = Literal["gelatin_8", "gelatin_12", "gelatin_15", "bovine_muscle"]


def _gelatin(shear_modulus_pa: float) -> dict[str, Any]:
    """Return the specimen settings of a gelatin phantom of this shear modulus, measured in the paper or assumed."""
    return {
        # Paper, Sec. IV.B, by its stainless steel sphere, a method that fits a Voigt medium.
        "medium": "voigt",
        "shear_modulus_pa": shear_modulus_pa,
        "shear_viscosity_pa_s": 1.0,
        "density_kg_per_m3": 1000.0,  # assumed
        # Assumed; the paper states only that the graphite, not the gelatin, attenuates.
        "attenuation_db_per_cm_mhz": 0.5,
        "depth_m": 12.5e-3,  # assumed, as for the muscle: the paper does not state the depth in its gelatins
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


def with_preset(settings: Any, presets: Mapping[str, Mapping[str, Any]]) -> Any:
    """Return ``settings`` with missing values from the preset that they name.

    Anything but a table is returned unchanged.
    """
    if not isinstance(settings, Mapping):
        return settings
    return {**presets.get(str(settings.get("preset")), {}), **settings}


def with_preset_depth(settings: Any) -> Any:
    """Return the settings [simulation] with another ``specimen.depth_m`` where they contradict the preset's depth.

    The depth is the length of the path to the focus inside the specimen. The first of these cases decides it:

    * ``specimen`` names no preset with a depth, or states a depth itself: unchanged.
    * ``scatterers`` has an attenuation, which replaces the specimen's: None, no depth.
    * ``propagation`` has a depth of the specimen: that depth.
    * The focus is nearer than the preset's depth: the depth of the focus, since the whole path is in the specimen.
    * Otherwise unchanged, also for settings that are no table.
    """
    sections = settings if isinstance(settings, Mapping) else {}
    specimen, scatterers, propagation, beams = (
        section if isinstance(section := sections.get(name), Mapping) else {}
        for name in ("specimen", "scatterers", "propagation", "beams")
    )
    depth_m = PRESETS.get(str(specimen.get("preset")), {}).get("depth_m")
    if depth_m is None or "depth_m" in specimen:
        return settings
    focus_m = beams.get("tracking_focus_depth_m", beams.get("focus_depth_m"))
    if scatterers.get("attenuation_db_per_cm_mhz"):
        depth_m = None
    elif "specimen_depth_m" in propagation:
        depth_m = propagation["specimen_depth_m"]
    elif isinstance(focus_m, float) and 0 < focus_m < depth_m:
        depth_m = focus_m
    else:
        return settings
    return {**settings, "specimen": {**specimen, "depth_m": depth_m}}
