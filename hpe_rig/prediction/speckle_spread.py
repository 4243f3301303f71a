"""Standard deviations over speckle: tracked displacement, echo frequency, position and area of the tracked region."""

from __future__ import annotations

import functools

import numpy as np

from hpe_rig.medium import TrackingGate
from hpe_rig.prediction.conditions import Conditions, resting_conditions
from hpe_rig.prediction.error_model import tracked_over_peak
from hpe_rig.prediction.speckle import Displacement, seeded_speckle
from hpe_rig.processing import spec_of
from hpe_rig.scene import Scene

SPECKLE_DRAWS = 2000
REFERENCE_ESTIMATOR = "coherent"
"""An estimator of the whole gate that divides the phase by the echo's own mean frequency."""


def tracked_region_spread(scene: Scene, estimator: str) -> tuple[float, float, float]:
    """Return the result of ``region_spread`` for the echoes of ``scene``; zeros without beams."""
    resting = resting_conditions(scene)
    return (0.0, 0.0, 0.0) if resting is None else region_spread(resting, estimator)


@functools.lru_cache(maxsize=16)
def region_spread(resting: Conditions, estimator: str) -> tuple[float, float, float]:
    """Return the standard deviations over speckle of the tracked region: relative area, lateral and axial centre, m.

    ``resting``: beams and gate. The tracked displacement is a mean of the displacement, weighted by the echoes. A
    displacement equal to the position x therefore gives the region's centre along x, and (x^2 + y^2) / 2 its area.
    """

    def statistics(displacement: Displacement) -> tuple[float, float]:
        """Return mean and standard deviation over speckle of the tracked ``displacement``, a function of position."""
        ratio = tracked_over_peak(resting, estimator, seeded_speckle(resting, SPECKLE_DRAWS, displacement))
        return float(ratio.mean()), float(ratio.std())

    # In units of the beam width, single precision loses no digits.
    unit_m = resting.tracking_width_m[0]
    mean_area, area_sd = statistics(lambda position_m: np.square(position_m[:2] / unit_m).sum(axis=0) / 2)
    _, lateral_sd = statistics(lambda position_m: np.asarray(position_m[0] / np.float32(unit_m)))
    _, axial_sd = statistics(lambda position_m: np.asarray(position_m[2] / np.float32(unit_m)))
    return area_sd / mean_area, unit_m * lateral_sd, unit_m * axial_sd


@functools.lru_cache(maxsize=16)
def speckle_spread(resting: Conditions, estimator: str) -> tuple[float, float]:
    """Return the relative standard deviations over speckle of (1) tracked displacement and (2) the echo's frequency.

    ``resting``: beams and gate. (1) is from random draws (Monte Carlo) of a Gaussian motion with the widths of the
    force. Dark spots of the speckle give it a heavy tail, and it repeats to about 2 / sqrt(``SPECKLE_DRAWS``). (2), of
    the mean frequency, has a closed form. It is 0 unless the estimator divides the phase by the carrier instead of the
    echo's frequency.
    """
    spec = spec_of(estimator)
    # Only (2) contains the scatter of the echo's frequency: for (1), an estimator that divides by the carrier is
    # replaced by one that divides by the echo's frequency.
    ratio_estimator = REFERENCE_ESTIMATOR if spec.by_carrier else estimator
    ratio = tracked_over_peak(resting, ratio_estimator, seeded_speckle(resting, SPECKLE_DRAWS))
    gate = TrackingGate(
        tracking_width_m=resting.tracking_width_m,
        gate_length_m=resting.gate_length_m,
        pulse_length_m=resting.pulse_length_m,
        hann_window=spec.gate_window == "hann",
    )
    frequency_sd = gate.carrier_spread(1 / resting.metres_per_radian) if spec.by_carrier else 0.0
    return float(ratio.std() / ratio.mean()), frequency_sd
