"""Types of the numbers in ``[simulation]``, with bounds.

The bounds lie a decade or more beyond any specimen or instrument; within them no arithmetic of the twin overflows.
"""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

FrequencyHz = Annotated[float, Field(ge=1e-3, le=1e9, strict=True)]
"""Carriers, bands and sample rates."""
VibrationHz = Annotated[float, Field(ge=1e-4, le=1e6, strict=True)]
"""Frequencies of tissue motion, from slow drift on."""
TimeS = Annotated[float, Field(ge=0, le=1.0, strict=True)]
"""Latencies and time constants of instruments."""
JitterS = Annotated[float, Field(ge=0, le=1e-6, strict=True)]
"""Standard deviations of trigger and clock."""
LengthM = Annotated[float, Field(ge=1e-9, le=10.0, strict=True)]
"""Depths, boxes and beam widths."""
PositionM = Annotated[float, Field(ge=-10.0, le=10.0, strict=True)]
"""Positions relative to the focus."""
AmplitudeM = Annotated[float, Field(ge=0, le=1.0, strict=True)]
"""Displacements, from a vibration's to a breath's."""
PhaseRad = Annotated[float, Field(ge=-1e6, le=1e6, strict=True)]
"""Phases, of as many turns as floating point resolves."""
SpeedMPerS = Annotated[float, Field(ge=10.0, le=1e5, strict=True)]
"""Longitudinal sound speeds."""
ModulusPa = Annotated[float, Field(ge=1e-2, le=1e12, strict=True)]
"""Shear moduli."""
ViscosityPaS = Annotated[float, Field(ge=0, le=1e6, strict=True)]
"""Shear viscosities."""
DensityKgPerM3 = Annotated[float, Field(ge=0.1, le=1e5, strict=True)]
"""Densities, from a gas to beyond any metal."""
AttenuationDbPerCmMHz = Annotated[float, Field(ge=0, le=40.0, strict=True)]
"""One-way losses: water 0.002, soft tissue 0.5, bone 20, lung 40."""
ForceDensityNPerM3 = Annotated[float, Field(ge=1e-6, le=1e10, strict=True)]
"""Body forces; exposures that the FDA allows reach some 1e7 N/m3."""
VoltageV = Annotated[float, Field(ge=1e-9, le=1e6, strict=True)]
"""Levels from below the noise to beyond any pulser's."""
NonNegativeVoltageV = Annotated[float, Field(ge=0, le=1e6, strict=True)]
"""Levels that may be zero."""
RatioDb = Annotated[float, Field(ge=-100.0, le=200.0, strict=True)]
"""Gains, losses and signal-to-noise ratios."""
Strength = Annotated[float, Field(ge=-1e6, le=1e6, strict=True)]
"""Relative amplitudes: reflectivities, samples of a pulse, harmonics."""
Seed = Annotated[int, Field(ge=0, le=2**63 - 1, strict=True)]
"""Seeds of random numbers, as a file stores them."""
