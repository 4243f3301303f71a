"""Units: which one a key has, numbers with a unit as people write them, lengths given on the command line."""

from __future__ import annotations

import math
import re

from hpe_rig.scene.mistakes import KeyPath, Mistake, SettingsError

_UNITS = {
    "hz": "Hz",
    "s": "s",
    "m": "m",
    "v": "V",
    "vpp": "Vpp",
    "pa": "Pa",
    "pa_s": "Pa s",
    "db": "dB",
    "rad": "rad",
    "ohm": "ohm",
    "per_s": "1/s",
    "s_per_s": "s/s",
    "m_per_s": "m/s",
    "kg_per_m3": "kg/m3",
    "n_per_m3": "N/m3",
    "w_per_m2": "W/m2",
    "db_per_cm_mhz": "dB/cm/MHz",
    "v_per_sqrt_hz": "V/sqrt(Hz)",
}
_PREFIXES = {-15: "f", -12: "p", -9: "n", -6: "u", -3: "m", 0: "", 3: "k", 6: "M", 9: "G", 12: "T"}
_WITHOUT_PREFIX = (0.01, 1e5)
"""Range of numbers that need no prefix: a pulse rate stays 3990 Hz."""
_METRES = {"nm": 1e-9, "um": 1e-6, "mm": 1e-3, "m": 1.0}
MIN_LENGTH_M, MAX_LENGTH_M = 1e-15, 1e-3
"""Bounds of an uncertainty of a length: a larger one lacks its unit, a smaller one is below the size of a nucleus."""


def unit_of(key: str) -> str:
    """Return the unit that the name of a key ends with; empty if it has none."""
    # The longest ending applies: sound_speed_m_per_s ends with _s too.
    endings = sorted((ending for ending in _UNITS if key.endswith(f"_{ending}")), key=len)
    return _UNITS[endings[-1]] if endings else ""


def unit_of_path(path: KeyPath) -> str:
    """Return the unit of the last key of ``path``, which may end with an index; empty if it has none."""
    return unit_of(next((segment for segment in reversed(path) if isinstance(segment, str)), ""))


def engineering(value: float, unit: str, digits: int = 4) -> str:
    """Return ``value`` with ``digits`` significant digits, and its unit with a prefix where the number needs one.

    >>> engineering(9e6, "Hz"), engineering(1.31e-4, "s"), engineering(3990.0, "Hz")
    ('9 MHz', '131 us', '3990 Hz')
    """
    if value == 0 or not math.isfinite(value):
        return f"{value:g} {unit}"
    # The prefix follows from the rounded number: 999999.6 is 1 M.
    rounded = float(f"{value:.{digits}g}")
    # Without prefix a number from 1000 on needs five digits: 12345 Hz must not become 1.234e+04 Hz.
    if _WITHOUT_PREFIX[0] <= abs(rounded) < _WITHOUT_PREFIX[1]:
        return f"{value:.{max(digits, 5)}g} {unit}" if abs(rounded) >= 1000 else f"{value:.{digits}g} {unit}"
    power = min(max(3 * math.floor(math.log10(abs(rounded)) / 3), -15), 12)
    return f"{rounded / 10.0**power:.{digits}g} {_PREFIXES[power]}{unit}"


def plural(count: int, noun: str) -> str:
    """Return ``count`` and ``noun``, with an s unless it is one: 1 shot, 3 shots."""
    return f"{count} {noun}{'' if count == 1 else 's'}"


def length_m(text: str, key: str, max_m: float = MAX_LENGTH_M) -> float:
    """Return a length from 1 fm to ``max_m``, given as "20nm" or "2e-8"; raise ``SettingsError`` naming ``key``."""
    match = re.fullmatch(r"\s*([0-9.eE+-]+)\s*(nm|um|mm|m)?\s*", text)
    try:
        value = float(match[1]) * _METRES[match[2] or "m"] if match else math.nan
    except ValueError:
        value = math.nan
    if not MIN_LENGTH_M <= value <= max_m:
        what = f"{text!r} is no length from 1 fm to {max_m * 1e3:g} mm"
        raise SettingsError("command line", [Mistake(key, what, "a number with unit, such as 20nm")])
    return value
