"""Engineering notation: numbers with a unit as people read them, 3 MHz and 250 us, never 3e+06 Hz."""

from __future__ import annotations

import math

PREFIXES = {-15: "f", -12: "p", -9: "n", -6: "u", -3: "m", 0: "", 3: "k", 6: "M", 9: "G", 12: "T"}
PLAIN = (0.01, 1e5)
"""Numbers that need no prefix: a pulse rate of 3990 Hz stays one."""


def engineering(value: float, unit: str, digits: int = 4) -> str:
    """Return ``value`` with ``digits`` significant digits, and its unit with a prefix where the number needs one.

    >>> engineering(9e6, "Hz"), engineering(1.31e-4, "s"), engineering(3990.0, "Hz")
    ('9 MHz', '131 us', '3990 Hz')
    """
    if value == 0 or not math.isfinite(value):
        return f"{value:g} {unit}"
    # Of the rounded number: 999999.6 is 1 M.
    rounded = float(f"{value:.{digits}g}")
    if PLAIN[0] <= abs(rounded) < PLAIN[1]:
        return f"{value:.{max(digits, 5)}g} {unit}" if abs(rounded) >= 1000 else f"{value:.{digits}g} {unit}"
    power = min(max(3 * math.floor(math.log10(abs(rounded)) / 3), -15), 12)
    return f"{rounded / 10.0**power:.{digits}g} {PREFIXES[power]}{unit}"
