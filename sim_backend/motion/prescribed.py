"""Prescribed motion: of the focus, eq. (1) and (13), and of the whole specimen."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from sim_backend.arrays import FloatArray, Int64Array
from sim_backend.settings import BackgroundMotion, MotionComponent
from sim_backend.wiring import PS_PER_S

_TIMES_AT_ONCE = 1 << 16


def motion_at(components: Sequence[MotionComponent], time_ps: Int64Array) -> FloatArray:
    """Return the sum of sinusoids D sin(2 pi f t + phi), m, at ``time_ps`` (time,) after the master trigger.

    The phase is right to 1e-12 rad after 1e5 s.
    """
    displacement_m = np.zeros(time_ps.shape)
    for first in range(0, len(time_ps), _TIMES_AT_ONCE):
        some = slice(first, first + _TIMES_AT_ONCE)
        for component in components:
            phase_rad = 2 * np.pi * turns(component.frequency_hz, time_ps[some]) + component.phase_rad
            displacement_m[some] += component.amplitude_m * np.sin(phase_rad)
    return displacement_m


def background_at(background: Sequence[BackgroundMotion], time_ps: Int64Array) -> FloatArray:
    """Return how far the whole specimen has moved, m, at ``time_ps`` (time,) after the master trigger."""
    return motion_at([part for each in background for part in _components(each)], time_ps)


def _components(background: BackgroundMotion) -> Iterator[MotionComponent]:
    for order, share in enumerate((1.0, *background.harmonics), 1):
        yield MotionComponent(
            frequency_hz=order * background.frequency_hz,
            amplitude_m=abs(share) * background.amplitude_m,
            phase_rad=order * background.phase_rad + (math.pi if share < 0 else 0.0),
        )


def turns(frequency_hz: float, time_ps: Int64Array) -> FloatArray:
    """Return f t less its whole turns: those of whole hertz and whole seconds are dropped as integers, before rounding.

    Exact but for 1e-13 turns up to 1e6 Hz and 1e5 s.
    """
    whole_s, rest_ps = np.divmod(time_ps, PS_PER_S)
    whole_hz = int(frequency_hz)
    part_hz = frequency_hz - whole_hz
    # Split so that each product with up to 2^17 seconds is exact: 26 bits of a hertz, and what is left.
    coarse_hz = np.round(part_hz * 2**26) / 2**26
    of_whole_s = np.mod(coarse_hz * whole_s, 1.0) + (part_hz - coarse_hz) * whole_s
    of_rest = np.mod(whole_hz * rest_ps, PS_PER_S) / PS_PER_S + part_hz * (rest_ps / PS_PER_S)
    return np.asarray(of_whole_s + of_rest)
