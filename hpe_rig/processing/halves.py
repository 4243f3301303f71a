"""Whether the amplitude stayed what it was: both halves of the pulses, each estimated on its own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hpe_rig.processing.echoes import BoolArray, EchoGate, FloatArray
from hpe_rig.processing.estimators import PLAIN, Estimator, Options, estimate


@dataclass(frozen=True, slots=True)
class Drift:
    """How the amplitudes changed from the first half of the pulses to the second.

    All (..., frequency): ``relative_change`` (A_2 - A_1) / A, with A the mean of both; ``significance``, that change
    over its standard uncertainty; ``suspicious``: more than 5 standard uncertainties and more than 10 % of A.
    """

    frequency_hz: FloatArray
    relative_change: FloatArray
    significance: FloatArray
    suspicious: BoolArray


def drift_between_halves(
    echoes: EchoGate,
    frequencies_hz: FloatArray | Sequence[float],
    estimator: Estimator = "coherent",
    also_hz: FloatArray | Sequence[float] = (),
    options: Options = PLAIN,
) -> Drift:
    """Return the change of amplitude between both halves: suspicious where bursts are missing or motion decays.

    Raises ``ValueError`` as ``estimate`` does when half the pulses cannot carry the estimate.
    """
    middle = echoes.valid.size // 2
    halves = (_part(echoes, part) for part in (slice(0, middle), slice(middle, None)))
    first, second = (estimate(half, frequencies_hz, estimator, also_hz, options) for half in halves)
    mean = (first.amplitude_m + second.amplitude_m) / 2
    change = second.amplitude_m - first.amplitude_m
    sigma = np.sqrt(first.covariance[..., 0, 0] + second.covariance[..., 0, 0])
    tiny = np.finfo(np.float64).tiny
    suspicious = np.abs(change) > np.maximum(5 * sigma, 0.1 * mean)
    return Drift(first.frequency_hz, change / mean.clip(min=tiny), change / sigma.clip(min=tiny), suspicious)


def _part(echoes: EchoGate, part: slice) -> EchoGate:
    return replace(
        echoes,
        volts=echoes.volts[..., part, :],
        pulse_time_s=echoes.pulse_time_s[part],
        valid=echoes.valid[part],
    )
