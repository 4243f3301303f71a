"""Ground truth: amplitude and phase at the focus at exactly the wanted frequencies, whatever else moves.

Of a prescribed motion they are those of its own components. Of a specimen they come from its motion at every instant
and not only at the pulses: tonebursts are short, so they move it at frequencies far above half the pulse rate too.
Sampled at the pulses, these alias onto the wanted ones, in the truth as in the measurement, and no comparison would
show it.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from hpe_rig.arrays import FloatArray
from hpe_rig.bench import twin_of
from hpe_rig.plan import Shot, driven_frequencies_hz, select
from hpe_rig.scene import Scene

INSTANTS_A_PULSE = 16


def true_harmonics_m(scene: Scene, shot: Shot, motion_m: Callable[[FloatArray], FloatArray]) -> FloatArray:
    """Return A cos(phase) and A sin(phase) of the peak displacement at every wanted frequency, m, (frequency, 2).

    Of a specimen over the whole burst periods of the processing window, where every driven harmonic is orthogonal to
    every other, without what it creeps from period to period; the driven ones are fitted along where a wanted frequency
    is none of them. ``motion_m`` gives the displacement at times after the master trigger's edge. Phases as in the
    result: sine, from ``Timeline.reference_s``.
    """
    twin = twin_of(scene)
    if twin is not None and twin.prescribed:
        start_s = shot.timeline.reference_s
        each = np.array([twin.prescribed_phasor_m(hz, start_s) for hz in scene.wanted_frequencies_hz], dtype=complex)
        return np.stack([each.real, each.imag], axis=-1)
    return _of_specimen_m(scene, shot, motion_m)


def _of_specimen_m(scene: Scene, shot: Shot, motion_m: Callable[[FloatArray], FloatArray]) -> FloatArray:
    # They bring scipy along: the measurement, which imports this file, does without until its first shot is done.
    from hpe_rig.processing.echo.echoes import Motion
    from hpe_rig.processing.harmonics.harmonic_fit import least_squares

    sensing_s = shot.timeline.sensing_s[select(scene, shot).window]
    time_s = sensing_s[0] + _instants_s(scene, float(sensing_s[-1] - sensing_s[0]))
    displacement_m = motion_m(time_s)
    displacement_m = displacement_m - _creep(scene, time_s, displacement_m)
    motion = Motion(
        time_s - shot.timeline.reference_s, displacement_m, np.zeros(time_s.size), np.ones(time_s.size, bool)
    )
    also_hz = _also_hz(scene, float(sensing_s[-1] - sensing_s[0]))
    fit = least_squares(motion, list(scene.wanted_frequencies_hz), also_hz=also_hz)
    return np.stack([fit.amplitude_m * np.cos(fit.phase_rad), fit.amplitude_m * np.sin(fit.phase_rad)], axis=-1)


def _creep(scene: Scene, time_s: FloatArray, displacement_m: FloatArray) -> FloatArray:
    """Return the even creep (time,): what the last whole period is beyond the first, spread over all.

    Under bursts the mean force carries a medium that flows ever farther, and a ramp has a part at every harmonic.
    """
    if scene.excitation is None:
        return np.zeros(time_s.size)
    instants = round(1 / (scene.excitation.burst_rate_hz * float(time_s[1] - time_s[0])))
    periods = time_s.size // instants
    if periods < 2:
        return np.zeros(time_s.size)
    last = slice((periods - 1) * instants, periods * instants)
    metres = float(np.mean(displacement_m[last] - displacement_m[:instants]))
    return metres * np.arange(time_s.size) / ((periods - 1) * instants)


def _also_hz(scene: Scene, length_s: float) -> FloatArray:
    """Return the frequencies to fit along (frequency,): none where the instants make them orthogonal to the wanted."""
    if scene.excitation is None:
        return np.zeros(0)
    number = np.array(scene.wanted_frequencies_hz) / scene.excitation.burst_rate_hz
    orthogonal = length_s * scene.excitation.burst_rate_hz >= 1 and np.allclose(number, np.rint(number), 1e-9, 1e-9)
    return np.zeros(0) if orthogonal else driven_frequencies_hz(scene)


def _instants_s(scene: Scene, length_s: float) -> FloatArray:
    rate_hz = scene.tracking.pulse_rate_hz * INSTANTS_A_PULSE
    if scene.excitation is None or length_s * scene.excitation.burst_rate_hz < 1:
        return np.arange(math.floor(length_s * rate_hz) + 1) / rate_hz
    burst_rate_hz = scene.excitation.burst_rate_hz
    periods = math.floor(length_s * burst_rate_hz + 1e-9)
    instants = math.ceil(rate_hz / burst_rate_hz)
    return np.arange(periods * instants) / (instants * burst_rate_hz)
