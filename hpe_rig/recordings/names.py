"""Names of settings in files of common programs, and the units of their numbers."""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import lru_cache

# Names in lower case, letters and digits only, by the key of ``RecordingSettings``; same unit as the key.
NAMES: Mapping[str, tuple[str, ...]] = {
    "sample_rate_hz": ("fs", "samplingfrequency", "samplerate", "samplingrate"),
    "pulse_rate_hz": ("prf", "pulserepetitionfrequency"),
    "carrier_hz": ("fc", "f0", "centerfrequency", "centrefrequency", "transmitfrequency"),
    "demodulation_hz": ("fdemod", "demodulationfrequency", "modulationfrequency"),
    "sound_speed_m_per_s": ("c", "c0", "soundspeed", "speedofsound"),
    "first_sample_s": ("t0", "initialtime", "initialtimes", "timetofirstsample", "tstart", "start", "xorigin", "xzero"),
    "pulse_time_s": ("pulsetime", "pulsetimes", "tslow"),
    "line_position_m": ("linepositions", "xl", "lateral"),
    "record_samples": ("nt", "length", "recordlength", "segmentsize", "nax"),
}
INTERVALS = ("dt", "sampleinterval", "samplinginterval", "tinterval", "increment", "xincrement", "xincr")
"""Names of the sampling interval, s."""
TIME_UNITS: Mapping[str, float] = {
    **dict.fromkeys(("s", "sec", "second", "seconds"), 1.0),
    **dict.fromkeys(("ms", "millisecond", "milliseconds"), 1e-3),
    **dict.fromkeys(("us", "µs", "μs", "microsecond", "microseconds"), 1e-6),
    **dict.fromkeys(("ns", "nanosecond", "nanoseconds"), 1e-9),
}
"""Seconds of the units of a time."""
FACTORS: Mapping[str, float] = {
    "khz": 1e3,
    "mhz": 1e6,
    "ghz": 1e9,
    "ms/s": 1e6,
    "msa/s": 1e6,
    "gsa/s": 1e9,
    **TIME_UNITS,
}
"""SI units in a unit of a rate or a time."""
VOLT_UNITS: Mapping[str, float] = {
    **dict.fromkeys(("v", "volt", "volts"), 1.0),
    **dict.fromkeys(("mv", "millivolt", "millivolts"), 1e-3),
    **dict.fromkeys(("uv", "µv", "μv", "microvolt", "microvolts"), 1e-6),
}
"""Volts of the units of a voltage."""
LENGTH_UNITS = ("m", "cm", "mm", "um", "µm", "μm")
MIN_RECORD = 8
"""Samples below which a number is no length of a record."""


@lru_cache(maxsize=1024)
def key_of(name: str) -> str | None:
    """Return the key of ``RecordingSettings`` with the meaning of ``name``; "sample_interval_s" for an interval.

    The last part of a path such as ``scan/fs`` or ``param.fs`` counts, in any case.
    """
    last = name.replace("/", ".").rpartition(".")[2].lower()
    plain = re.sub(r"[^a-z0-9]", "", last)
    if plain in INTERVALS:
        return "sample_interval_s"
    return next((key for key, names in NAMES.items() if last == key or plain in names), None)


def setting_of(name: str, number: str | float, unit: str = "") -> tuple[str, float] | None:
    """Return key and SI value of a setting in a file; None for another name or no number."""
    in_parentheses = re.search(r"\((\S+?)\)", name)
    key = key_of(re.sub(r"\(.*?\)", "", name))
    try:
        value = float(number) * FACTORS.get((unit or (in_parentheses[1] if in_parentheses else "")).lower(), 1.0)
    except ValueError:
        return None
    if key == "record_samples" and (unit.lower() in LENGTH_UNITS or value < MIN_RECORD or not value.is_integer()):
        # "Length" alone may be that of a probe or a path.
        return None
    if key == "sample_interval_s":
        return ("sample_rate_hz", float(f"{1 / value:.9g}")) if value > 0 else None
    return None if key is None else (key, value)
