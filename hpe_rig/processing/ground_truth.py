"""Ground truth: amplitude and phase at the focus at exactly the wanted frequencies, independent of all other motion.

For a prescribed motion they are those of its components. For a specimen they are fitted to its motion at many
instants, not only at the pulses: short tonebursts drive frequencies far above half the pulse rate. Sampled at the
pulses, these would alias onto the wanted ones in the truth as in the measurement, and no comparison would reveal the
error.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from hpe_rig.arrays import FloatArray
from hpe_rig.bench import twin_of
from hpe_rig.plan import Shot, driven_frequencies_hz, select
from hpe_rig.scene import Scene

SAMPLES_PER_PULSE = 16


def true_harmonics_m(scene: Scene, shot: Shot, motion_m: Callable[[FloatArray], FloatArray]) -> FloatArray:
    """Return A cos(phase) and A sin(phase) of the peak displacement at every wanted frequency, m, (frequency, 2).

    ``motion_m`` gives the displacement at times after the master trigger's edge. For a specimen the fit covers the
    whole burst periods of the processing window, where the driven harmonics are orthogonal, minus the creep from period
    to period. Sine phases from the physical time zero, ``Timeline.time_zero_s``.
    """
    twin = twin_of(scene)
    if twin is not None and twin.prescribed:
        start_s = shot.timeline.time_zero_s
        phasors_m = np.array(
            [twin.prescribed_phasor_m(hz, start_s) for hz in scene.wanted_frequencies_hz], dtype=complex
        )
        return np.stack([phasors_m.real, phasors_m.imag], axis=-1)
    return _specimen_harmonics_m(scene, shot, motion_m)


def _specimen_harmonics_m(scene: Scene, shot: Shot, motion_m: Callable[[FloatArray], FloatArray]) -> FloatArray:
    """Return A cos(phase) and A sin(phase) (frequency, 2) of a simulated specimen's motion, by a fit at many instants.

    ``motion_m`` gives its displacement at any times after the master trigger.
    """
    # Imported here because they load SciPy, which the measurement does not need before its first shot is complete.
    from hpe_rig.processing.harmonics.harmonic_fit import least_squares
    from hpe_rig.processing.motion.displacement import Motion

    zero_s, sensing_s = shot.timeline.time_zero_s, shot.timeline.sensing_s[select(scene, shot).window]
    length_s = float(sensing_s[-1] - sensing_s[0])
    time_s = sensing_s[0] + _sample_times_s(scene, length_s)
    # Phases count by the clock of the bursts, as those of the fit.
    twin = twin_of(scene)
    rate = 1.0 if twin is None else twin.burst_clock_rate
    displacement_m = motion_m(time_s if rate == 1 else zero_s + (time_s - zero_s) / rate)
    displacement_m = displacement_m - _creep_m(scene, time_s, displacement_m)
    motion = Motion(
        time_s=time_s - zero_s,
        displacement_m=displacement_m,
        variance_m2=np.zeros(time_s.size),
        valid=np.ones(time_s.size, bool),
    )
    also_hz = _disturbing_frequencies_hz(scene, length_s)
    fit = least_squares(motion, list(scene.wanted_frequencies_hz), also_hz=also_hz)
    return np.stack([fit.amplitude_m * np.cos(fit.phase_rad), fit.amplitude_m * np.sin(fit.phase_rad)], axis=-1)


def _creep_m(scene: Scene, time_s: FloatArray, displacement_m: FloatArray) -> FloatArray:
    """Return a ramp (time,) for the creep: the last whole period minus the first, spread over all periods.

    The mean force of the bursts moves a viscous medium ever farther. A ramp has a component at every harmonic.
    """
    if scene.excitation is None:
        return np.zeros(time_s.size)
    # ``samples``: number of samples in a burst period; ``total_m``: creep from the first to the last period.
    samples = round(1 / (scene.excitation.burst_rate_hz * float(time_s[1] - time_s[0])))
    periods = time_s.size // samples
    if periods < 2:
        return np.zeros(time_s.size)
    last = slice((periods - 1) * samples, periods * samples)
    total_m = float(np.mean(displacement_m[last] - displacement_m[:samples]))
    return total_m * np.arange(time_s.size) / ((periods - 1) * samples)


def _disturbing_frequencies_hz(scene: Scene, length_s: float) -> FloatArray:
    """Return the driven frequencies (frequency,) that must be fitted together with the wanted ones.

    ``length_s``: length of the processing window. Empty if no other driven frequency can disturb the wanted ones.
    """
    if scene.excitation is None:
        return np.zeros(0)
    # Harmonics of the burst rate are orthogonal over whole burst periods. A window of at least one period is sampled
    # over whole periods (_sample_times_s).
    whole_periods = length_s * scene.excitation.burst_rate_hz >= 1
    harmonic = np.array(scene.wanted_frequencies_hz) / scene.excitation.burst_rate_hz
    orthogonal = whole_periods and np.allclose(harmonic, np.rint(harmonic), rtol=1e-9, atol=1e-9)
    return np.zeros(0) if orthogonal else driven_frequencies_hz(scene)


def _sample_times_s(scene: Scene, length_s: float) -> FloatArray:
    """Return even sample times from 0, ``SAMPLES_PER_PULSE`` per pulse or more.

    They span ``length_s``, or the whole burst periods in it, over which the harmonics are orthogonal.
    """
    rate_hz = scene.tracking.pulse_rate_hz * SAMPLES_PER_PULSE
    if scene.excitation is None or length_s * scene.excitation.burst_rate_hz < 1:
        return np.arange(math.floor(length_s * rate_hz) + 1) / rate_hz
    burst_rate_hz = scene.excitation.burst_rate_hz
    periods = math.floor(length_s * burst_rate_hz + 1e-9)
    samples = math.ceil(rate_hz / burst_rate_hz)
    return np.arange(periods * samples) / (samples * burst_rate_hz)
