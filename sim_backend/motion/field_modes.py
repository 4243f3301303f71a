"""How the medium's own field moves the scatterers: the modes of `sim_backend.motion.field` at their places."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from sim_backend.motion.field import FocusField, focus_field
from sim_backend.motion.force import radiation_force
from sim_backend.settings import SimulationSettings, Specimen, Transmitter
from sim_backend.wiring import Bursts, Picoseconds

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class MediumMotion:
    """The field's modes at the scatterers, and what drives them."""

    shape: Floats
    """(mode, scatterer)"""
    field: FocusField
    specimen: Specimen
    transmitter: Transmitter
    travel_s: float

    def amplitudes_m(self, tonebursts: Bursts, time_ps: Picoseconds) -> Floats:
        """Return every mode's amplitude at ``time_ps`` (time,) under ``tonebursts``: (time, mode)."""
        force = radiation_force(tonebursts, self.specimen, self.travel_s, self.transmitter)
        return self.field.amplitudes(force, time_ps)


def medium_motion(settings: SimulationSettings, offset_m: Floats, travel_s: float) -> MediumMotion:
    """Return the motion of scatterers at ``offset_m`` (scatterer, 3) from the focus; needs ``settings.specimen``."""
    specimen = settings.specimen or Specimen()
    lateral_m, axial_m = np.hypot(offset_m[:, 0], offset_m[:, 1]), np.abs(offset_m[:, 2])
    # At least the force's own widths, so that a single scatterer at the focus leaves a field to tabulate.
    width_m = settings.beams.excitation_width_m
    reach_m = [max(float(at.max(initial=0.0)), width) for at, width in ((lateral_m, width_m[0]), (axial_m, width_m[2]))]
    field = _kept_field(specimen, width_m, *reach_m)
    return MediumMotion(field.shapes(lateral_m, axial_m).T, field, specimen, settings.transmitter, travel_s)


# Of the settings and the draw of scatterers alone: repeated measurements of one scene share it.
_kept_field = lru_cache(maxsize=8)(focus_field)
