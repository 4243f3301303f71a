"""Prescribed motion of the focus, eq. (1) and (13) of the paper, and of the whole specimen.

D(t) = sum_i D_i sin(2 pi f_i t + phi_i)

D_i, f_i, phi_i   amplitude, m; frequency, Hz; phase, rad
t                 time after the master trigger
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from sim_backend.arrays import FloatArray, Int64Array
from sim_backend.settings import BackgroundMotion, MotionComponent
from sim_backend.wiring import PS_PER_S

_TIMES_PER_CHUNK = 1 << 16


def motion_at(components: Sequence[MotionComponent], time_ps: Int64Array) -> FloatArray:
    """Return the prescribed displacement, a sum of sinusoids, at ``time_ps`` (time,) after the master trigger, m.

    The phase is exact to 1e-12 rad after 1e5 s.
    """
    displacement_m = np.zeros(time_ps.shape)
    for first in range(0, len(time_ps), _TIMES_PER_CHUNK):
        chunk = slice(first, first + _TIMES_PER_CHUNK)
        for component in components:
            phase_rad = 2 * np.pi * cycles_at(component.frequency_hz, time_ps[chunk]) + component.phase_rad
            displacement_m[chunk] += component.amplitude_m * np.sin(phase_rad)
    return displacement_m


def background_at(background: Sequence[BackgroundMotion], time_ps: Int64Array) -> FloatArray:
    """Return the displacement of the whole specimen, m, at ``time_ps`` (time,) after the master trigger."""
    return motion_at([component for motion in background for component in _components(motion)], time_ps)


def _components(background: BackgroundMotion) -> Iterator[MotionComponent]:
    """Yield the fundamental and the harmonics of a periodic background motion."""
    for order, relative_amplitude in enumerate((1.0, *background.harmonics), 1):
        yield MotionComponent(
            frequency_hz=order * background.frequency_hz,
            amplitude_m=abs(relative_amplitude) * background.amplitude_m,
            phase_rad=order * background.phase_rad + (math.pi if relative_amplitude < 0 else 0.0),
        )


def cycles_at(frequency_hz: float, time_ps: Int64Array) -> FloatArray:
    """Return frequency times time, up to a whole number of cycles, exact to 1e-13 for up to 1e6 Hz and 1e5 s.

    Whole hertz times whole seconds are whole cycles, so they are dropped as integers before rounding.
    """
    whole_s, remainder_ps = np.divmod(time_ps, PS_PER_S)
    whole_hz = int(frequency_hz)
    fraction_hz = frequency_hz - whole_hz
    # The upper 26 bits of the fraction times whole seconds, 17 bits, have 43 bits: a double holds the product exactly.
    # The product with the lower bits is below 1e-3 cycles, so that its rounding does not matter.
    upper_hz = np.round(fraction_hz * 2**26) / 2**26
    cycles_of_seconds = np.mod(upper_hz * whole_s, 1.0) + (fraction_hz - upper_hz) * whole_s
    cycles_of_remainder = np.mod(whole_hz * remainder_ps, PS_PER_S) / PS_PER_S + fraction_hz * (remainder_ps / PS_PER_S)
    return np.asarray(cycles_of_seconds + cycles_of_remainder)
