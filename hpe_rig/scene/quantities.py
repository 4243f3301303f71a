"""Quantities: types of the numbers in settings files, each with the bounds of what exists.

The bounds lie a decade or more beyond any bench or specimen. They catch a forgotten unit and a slipped exponent at the
key that holds it, and they keep all arithmetic behind them far from overflow.
"""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

FrequencyHz = Annotated[float, Field(ge=1e-3, le=1e9, strict=True)]
"""Rates, carriers and vibrations: from a period of a quarter of an hour to 1 GHz."""
VibrationHz = Annotated[float, Field(ge=1e-3, le=1e6, strict=True)]
"""Frequencies that tissue follows; far fewer than 1 MHz."""
DurationS = Annotated[float, Field(ge=1e-9, le=1e5, strict=True)]
"""Lengths of bursts, windows and shots: up to a day."""
DelayS = Annotated[float, Field(ge=0, le=1e3, strict=True)]
"""Delays that are programmed and windows that begin late."""
LatencyS = Annotated[float, Field(ge=0, le=1.0, strict=True)]
"""Delays of cables and of instruments themselves."""
LengthM = Annotated[float, Field(ge=1e-9, le=10.0, strict=True)]
"""Depths, gates and beam widths."""
AmplitudeM = Annotated[float, Field(ge=1e-15, le=1e-2, strict=True)]
"""Vibration amplitudes: up to 1 cm."""
SpeedMPerS = Annotated[float, Field(ge=10.0, le=1e5, strict=True)]
"""Longitudinal sound speeds; diamond has 18 km/s."""
ModulusPa = Annotated[float, Field(ge=1e-2, le=1e12, strict=True)]
"""Shear moduli; diamond has 0.5 TPa."""
ViscosityPaS = Annotated[float, Field(ge=0, le=1e6, strict=True)]
"""Shear viscosities."""
DensityKgPerM3 = Annotated[float, Field(ge=0.1, le=1e5, strict=True)]
"""Densities, from a gas to beyond any metal."""
VoltageV = Annotated[float, Field(ge=1e-6, le=1e4, strict=True)]
"""Amplitudes, ranges and levels."""
PressurePa = Annotated[float, Field(ge=1.0, le=1e9, strict=True)]
"""Sound pressures; water cavitates far below 1 GPa."""
IntensityWPerM2 = Annotated[float, Field(ge=1e-6, le=1e12, strict=True)]
"""Acoustic intensities; 1e12 W/m2 go with 1 GPa in water."""
RatioDb = Annotated[float, Field(ge=-100.0, le=200.0, strict=True)]
"""Ratios of powers."""
Fraction = Annotated[float, Field(ge=1e-12, le=1, strict=True)]
"""Parts of a whole, nothing of it left out."""
Count = Annotated[int, Field(ge=1, le=1_000_000, strict=True)]
"""How many of something."""
Seed = Annotated[int, Field(ge=0, le=2**63 - 1, strict=True)]
"""Seeds of random numbers, as a file stores them."""
Widths = tuple[LengthM, LengthM, LengthM]
