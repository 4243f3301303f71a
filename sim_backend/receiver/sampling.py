"""When the digitizer really samples: aperture jitter and a sample clock that runs fast or slow."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sim_backend.settings import Instruments

Floats = NDArray[np.float64]

# Central differences, exact for polynomials of degree six: 2e-4 of the slope at 9 MHz and 100 MHz.
_SLOPE = np.array([-1, 9, -45, 0, 45, -9, 1]) / 60
STENCIL = 3
"""Samples that a slope needs on either side."""


def samples_late(instruments: Instruments) -> bool:
    """Return whether the sample clock is anything but perfect."""
    return instruments.sample_clock_jitter_s > 0 or instruments.sample_clock_offset != 0


def sampled_late(
    volts: Floats, kept: slice, period_s: float, instruments: Instruments, rng: np.random.Generator
) -> Floats:
    """Return ``volts`` (record, sample) in ``kept`` as an imperfect clock takes them: (record, kept sample).

    ``kept`` leaves `STENCIL` samples on either side. To first order in the lateness, whose second order is
    (2 pi 9 MHz x 0.1 ns)^2 / 2 = 2e-5 for a jitter of 0.1 ns.
    """
    first, last = kept.start, kept.stop
    slope = sum(
        weight * volts[:, first + shift : last + shift : kept.step]
        for shift, weight in zip(range(-STENCIL, STENCIL + 1), _SLOPE, strict=True)
        if weight
    )
    exact = volts[:, kept]
    step = kept.step or 1
    late = np.arange(exact.shape[1]) * (step * instruments.sample_clock_offset)
    if instruments.sample_clock_jitter_s:
        late = late + rng.standard_normal(exact.shape) * (instruments.sample_clock_jitter_s / period_s)
    return np.asarray(exact + late * slope)
