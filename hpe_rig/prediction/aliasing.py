"""Aliasing before a measurement: the error of the wanted harmonics from harmonics that the fit does not resolve.

The steady motion of the medium under the bursts, with all harmonics of several lobes of the force spectrum, is sampled
at the pulses and fitted without noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from functools import lru_cache

import numpy as np

from hpe_rig.arrays import ComplexArray, FloatArray
from hpe_rig.plan import Shot, select
from hpe_rig.prediction.linear_fit import fit_noise_free
from hpe_rig.prediction.scene_physics import focal_motion, force_spectrum
from hpe_rig.processing import harmonic_columns, spec_of
from hpe_rig.scene import Scene

LOBES = 10
"""Lobes of the force spectrum, each 1/T_b wide, in the simulated motion; the motion falls as their square."""


def fitted_over_true(
    scene: Scene, shot: Shot, simulated: bool = True, estimator: str | None = None
) -> ComplexArray | None:
    """Return the fitted over the true phasor of each wanted harmonic (frequency,), without noise.

    ``estimator`` defaults to the scene's. None if no medium is known, nothing pushes, or the wanted frequencies are no
    multiples of the burst rate.
    """
    return fitted_over_true_by_estimator(scene, shot, (estimator or scene.processing.estimator,), simulated)[0]


def fitted_over_true_by_estimator(
    scene: Scene, shot: Shot, estimators: Sequence[str], simulated: bool = True
) -> tuple[ComplexArray | None, ...]:
    """Return ``fitted_over_true`` for each of ``estimators``, from one motion."""
    motion = _steady_motion(scene, shot, simulated)
    if motion is None:
        return (None,) * len(estimators)
    return tuple(_over_true(scene, shot, name, *motion) for name in estimators)


def _over_true(
    scene: Scene, shot: Shot, estimator: str, true_m: ComplexArray, displacement_m: FloatArray
) -> ComplexArray | None:
    # A plan with conflicts may have no fit.
    with suppress(ValueError):
        return np.asarray(fit_noise_free(scene, shot, spec_of(estimator), displacement_m) / true_m)
    return None


def _steady_motion(scene: Scene, shot: Shot, simulated: bool) -> tuple[ComplexArray, FloatArray] | None:
    """Return A exp(j phase) of the wanted harmonics (frequency,) and the displacement at every pulse (pulse,)."""
    if scene.excitation is None or shot.toneburst is None or not scene.wanted_frequencies_hz:
        return None
    rate_hz, length_s = scene.excitation.burst_rate_hz, shot.toneburst.cycles / shot.toneburst.carrier_hz
    wanted_hz = np.array(scene.wanted_frequencies_hz)
    wanted_index = np.rint(wanted_hz / rate_hz).astype(np.int64)
    harmonic = np.arange(1, int(LOBES / (length_s * rate_hz)) + 1)
    frequency_hz = np.asarray(harmonic * rate_hz, dtype=np.float64)
    motion = focal_motion(scene, frequency_hz, simulated)
    if (
        motion is None
        or not np.allclose(wanted_index * rate_hz, wanted_hz, rtol=1e-9)
        or wanted_index.max() > harmonic.size
    ):
        return None
    # The sinusoid A sin(w t + phase) has A exp(j phase) = j times the coefficient of exp(j w t).
    phasor_m = 1j * motion[0] * force_spectrum(harmonic, rate_hz, length_s)
    states_m = np.stack([phasor_m.real, phasor_m.imag], axis=-1).ravel()
    time_s = select(scene, shot).time_s
    if not time_s.size:
        # A plan with conflicts may have no pulse in its window.
        return None
    displacement_m = _displacement_m(time_s.tobytes(), frequency_hz.tobytes(), states_m.tobytes())
    return np.asarray(phasor_m[wanted_index - 1]), displacement_m


@lru_cache(maxsize=4)
def _displacement_m(time_s: bytes, frequency_hz: bytes, states_m: bytes) -> FloatArray:
    """Return the displacement (pulse,); cached, because the forecast of every estimator needs the same motion."""
    columns = harmonic_columns(np.frombuffer(time_s), np.frombuffer(frequency_hz))
    displacement_m = np.asarray(columns @ np.frombuffer(states_m))
    displacement_m.setflags(write=False)
    return displacement_m
