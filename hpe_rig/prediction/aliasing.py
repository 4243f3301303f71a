"""Aliasing: what harmonics of the bursts that the fit cannot resolve do to the wanted ones, before a measurement."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from functools import lru_cache

import numpy as np

from hpe_rig.arrays import ComplexArray, FloatArray
from hpe_rig.plan import Shot, select
from hpe_rig.prediction.beam_averaging import motion_of_medium
from hpe_rig.prediction.linear_fit import fitted
from hpe_rig.prediction.theory import force_spectrum
from hpe_rig.processing import harmonic_columns, spec_of
from hpe_rig.scene import Scene

LOBES = 10
"""Lobes of the force spectrum, each 1/T_b wide, whose harmonics are taken along; what moves falls as their square."""


def fitted_over_true(
    scene: Scene, shot: Shot, simulated: bool = True, estimator: str | None = None
) -> ComplexArray | None:
    """Return what the estimator's fit makes of each wanted harmonic over what it is (frequency,), without noise.

    ``estimator``: absent, the scene's.
    From the medium's steady motion under the bursts, tracked at the pulses that the estimate uses; None where no
    medium is known, nothing pushes, or the wanted frequencies are no multiples of the burst rate.
    """
    return each_fitted_over_true(scene, shot, (estimator or scene.processing.estimator,), simulated)[0]


def each_fitted_over_true(
    scene: Scene, shot: Shot, estimators: Sequence[str], simulated: bool = True
) -> tuple[ComplexArray | None, ...]:
    """Return ``fitted_over_true`` of each of ``estimators``, of one motion."""
    moved = _steady_motion(scene, shot, simulated)
    if moved is None:
        return (None,) * len(estimators)
    true, displacement_m = moved
    return tuple(_over_true(scene, shot, name, true, displacement_m) for name in estimators)


def _over_true(
    scene: Scene, shot: Shot, estimator: str, true: ComplexArray, displacement_m: FloatArray
) -> ComplexArray | None:
    # a plan with conflicts may have no fit at all
    with suppress(ValueError):
        return np.asarray(fitted(scene, shot, spec_of(estimator), displacement_m) / true)
    return None


def _steady_motion(scene: Scene, shot: Shot, simulated: bool) -> tuple[ComplexArray, FloatArray] | None:
    """Return A exp(j phase) of the wanted harmonics (frequency,) and the displacement at every pulse (pulse,)."""
    if scene.excitation is None or shot.toneburst is None or not scene.wanted_frequencies_hz:
        return None
    rate_hz, length_s = scene.excitation.burst_rate_hz, shot.toneburst.cycles / shot.toneburst.carrier_hz
    wanted_hz = np.array(scene.wanted_frequencies_hz)
    place = np.rint(wanted_hz / rate_hz).astype(np.int64)
    harmonic = np.arange(1, int(LOBES / (length_s * rate_hz)) + 1)
    frequency_hz = np.asarray(harmonic * rate_hz, dtype=np.float64)
    motion = motion_of_medium(scene, frequency_hz, simulated=simulated)
    if motion is None or not np.allclose(place * rate_hz, wanted_hz, rtol=1e-9) or place.max() > harmonic.size:
        return None
    # the sinusoid A sin(w t + phase) has the coefficient A exp(j phase) = j times that of exp(j w t)
    true = 1j * motion[0] * force_spectrum(harmonic, rate_hz, length_s)
    parts = np.stack([true.real, true.imag], axis=-1).ravel()
    time_s = select(scene, shot).time_s
    if not time_s.size:
        # a plan with conflicts may have no pulse in its window
        return None
    return np.asarray(true[place - 1]), _displacement_m(time_s.tobytes(), frequency_hz.tobytes(), parts.tobytes())


@lru_cache(maxsize=4)
def _displacement_m(time_s: bytes, frequency_hz: bytes, parts_m: bytes) -> FloatArray:
    """Kept: the aliasing of the scene's estimator and the forecast of all of them ask for the same motion."""
    moved = harmonic_columns(np.frombuffer(time_s), np.frombuffer(frequency_hz)) @ np.frombuffer(parts_m)
    moved.setflags(write=False)
    return np.asarray(moved)
