"""The true amplitude and phase at the focus, from the twin's motion at every instant and not only at the pulses.

Tonebursts are short, so they move the specimen at frequencies far above half the pulse rate too. Sampled at the pulses,
these fold onto the wanted ones, in the truth as in the measurement, and no comparison would show it.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from hpe_rig.plan import Shot
from hpe_rig.scene import Scene

INSTANTS_A_PULSE = 16
HIGHEST_HARMONIC_HZ = 1e4
"""Driven harmonics fitted along in a window that is no whole number of burst periods; 1/T_b at T_b = 100 us."""


def true_harmonics_m(
    scene: Scene, shot: Shot, inside: NDArray[np.bool_], motion_m: Callable[[NDArray[np.float64]], NDArray[np.float64]]
) -> NDArray[np.float64]:
    """Return A cos(phase) and A sin(phase) of the peak displacement at every wanted frequency, m, (frequency, 2).

    ``inside`` (pulse,) are the pulses of the processing window; ``motion_m`` gives the displacement at times after the
    master trigger's edge. Phases as in the result: sine, from ``Timeline.reference_s``.
    """
    from hpe_rig.processing import Motion, least_squares

    step_s = 1 / (shot.tracking_train.rate_hz * INSTANTS_A_PULSE)
    first_s = shot.timeline.sensing_s[inside][0]
    time_s = first_s + step_s * np.arange(int(inside.sum()) * INSTANTS_A_PULSE)
    displacement_m = motion_m(time_s)
    motion = Motion(
        time_s - shot.timeline.reference_s, displacement_m, np.zeros(time_s.size), np.ones(time_s.size, bool)
    )
    fit = least_squares(motion, list(scene.wanted_frequencies_hz), also_hz=_driven_hz(scene, time_s.size))
    return np.stack([fit.amplitude_m * np.cos(fit.phase_rad), fit.amplitude_m * np.sin(fit.phase_rad)], axis=-1)


def _driven_hz(scene: Scene, instants: int) -> list[float]:
    if scene.excitation is None:
        return []
    rate_hz = scene.excitation.burst_rate_hz
    count = min(int(HIGHEST_HARMONIC_HZ / rate_hz), instants // 8)
    return [n * rate_hz for n in range(1, count + 1)]
