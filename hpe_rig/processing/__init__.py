"""From gated echoes to displacement amplitude and phase: pure functions, leading axes are independent realisations.

    codes -> volts -> gate                                        conditioning.py
    D(t) = sum_i A_i sin(2 pi f_i t + phi_i)                      eq. (1)

    "coherent"        u_k = -c arg<mean of others, r_k> / (4 pi f_mean)          motion.coherent
                      A_i, phi_i and a constant at once, least squares           harmonic.least_squares

    "cross_spectrum"  v_n = -c dtheta_n(f_c) / (4 pi f_c T_prf)   eqs. (5), (6)  motion.cross_spectrum
                      D_n = v_n / w_i -> band-pass -> Hann -> Kalman -> times 2  velocity_chain.velocity_to_harmonics
                      then off with sinc(f_i / f_prf), T_prf / 2 and 90 degrees

Positive displacement is away from the transducer.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from hpe_rig.processing.harmonic import HarmonicFit, kalman, least_squares
from hpe_rig.processing.motion import EchoGate, Motion, Velocity, coherent, cross_spectrum
from hpe_rig.processing.velocity_chain import velocity_to_harmonics

__all__ = [
    "Drift",
    "EchoGate",
    "Estimator",
    "HarmonicFit",
    "Motion",
    "Velocity",
    "coherent",
    "cross_spectrum",
    "drift_between_halves",
    "estimate",
    "kalman",
    "least_squares",
    "velocity_to_harmonics",
]

FloatArray = NDArray[np.float64]
Estimator = Literal["coherent", "cross_spectrum"]


def estimate(
    echoes: EchoGate,
    frequencies_hz: FloatArray | list[float],
    estimator: Estimator = "coherent",
    also_hz: FloatArray | Sequence[float] = (),
) -> HarmonicFit:
    """Return amplitude and phase of the motion at every frequency, from all valid pulses.

    ``also_hz`` are frequencies that the motion has as well and that are not wanted; "coherent" fits them along, the
    band-pass of "cross_spectrum" needs no such help. Raises ``ValueError`` for an unknown estimator, and when echoes or
    pulses cannot carry the estimate.
    """
    if estimator == "coherent":
        return least_squares(coherent(echoes), frequencies_hz, also_hz=also_hz)
    if estimator == "cross_spectrum":
        return velocity_to_harmonics(cross_spectrum(echoes), frequencies_hz)
    raise ValueError(f"estimator {estimator!r} does not exist: try 'coherent' or 'cross_spectrum'")


@dataclass(frozen=True, slots=True)
class Drift:
    """How the amplitudes changed from the first half of the pulses to the second.

    All (..., frequency): ``relative_change`` (A_2 - A_1) / A, with A the mean of both; ``significance``, that change
    over its standard uncertainty; ``suspicious``: more than 5 standard uncertainties and more than 10 % of A.
    """

    frequency_hz: FloatArray
    relative_change: FloatArray
    significance: FloatArray
    suspicious: NDArray[np.bool_]


def drift_between_halves(
    echoes: EchoGate,
    frequencies_hz: FloatArray | list[float],
    estimator: Estimator = "coherent",
    also_hz: FloatArray | Sequence[float] = (),
) -> Drift:
    """Return the change of amplitude between both halves: suspicious where bursts are missing or motion decays.

    Raises ``ValueError`` as ``estimate`` does when half the pulses cannot carry the estimate.
    """
    middle = echoes.valid.size // 2
    first, second = (estimate(_part(echoes, part), frequencies_hz, estimator, also_hz) for part in _halves(middle))
    mean = (first.amplitude_m + second.amplitude_m) / 2
    change = second.amplitude_m - first.amplitude_m
    sigma = np.sqrt(first.covariance[..., 0, 0] + second.covariance[..., 0, 0])
    tiny = np.finfo(np.float64).tiny
    suspicious = np.abs(change) > np.maximum(5 * sigma, 0.1 * mean)
    return Drift(first.frequency_hz, change / mean.clip(min=tiny), change / sigma.clip(min=tiny), suspicious)


def _halves(middle: int) -> tuple[slice, slice]:
    return slice(0, middle), slice(middle, None)


def _part(echoes: EchoGate, part: slice) -> EchoGate:
    return replace(
        echoes,
        volts=echoes.volts[..., part, :],
        pulse_time_s=echoes.pulse_time_s[part],
        valid=echoes.valid[part],
    )
