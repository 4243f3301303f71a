"""The double sum of eq. (10) as written: the reference for every other evaluation."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sim_backend.echoes.pulse import Pulse, extended

Floats = NDArray[np.float64]


def direct(delay_s: Floats, weight: Floats, pulse: Pulse, sample_time_s: Floats) -> Floats:
    """Return the sum over scatterers of weighted, delayed pulses, float64 (echo, sample), eq. (10).

    ``delay_s`` (echo, scatterer), ``weight`` (scatterer,), ``sample_time_s`` (sample,).
    """
    echoes_out = np.empty((len(delay_s), len(sample_time_s)))
    for echo, tau in zip(echoes_out, delay_s, strict=True):
        # The support is compared as every evaluation does, so that an edge on a sample falls on the same side.
        inside = (sample_time_s[:, None] >= tau + pulse.start_s) & (sample_time_s[:, None] < tau + pulse.end_s)
        echo[:] = np.where(inside, extended(pulse, sample_time_s[:, None] - tau), 0.0) @ weight
    return echoes_out
