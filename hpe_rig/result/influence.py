"""Influences of the sources of uncertainty on the complex values of one shot."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from hpe_rig.arrays import ComplexArray

Scope = Literal["shot", "setting", "position", "run"]
"""Shots with a common error: none; repeats of the same settings; shots at the same position; all shots of a run."""
MAX_INFLUENCE_BYTES = 200_000_000
"""Influences of all shots up to which a result stores them: 1700 shots with ten frequencies in an unknown medium."""


@dataclass(frozen=True, slots=True, eq=False)
class Influence:
    """Errors of the complex values of one shot from one source.

    ``influence_m``, complex (frequency, variable): error of each value per standard deviation of each variable, m.
    ``common_to``: shots with the same variables. Sources with the same name of ``variables`` have common variables too.
    """

    source: str
    influence_m: ComplexArray
    common_to: Scope
    variables: str
    degrees_of_freedom: float = math.inf
