"""Check of a harmonic fit: a spectral line in the residual.

It is motion at a frequency that was not fitted, or at one that aliases there. Under white noise each bin of the
residual's periodogram is exponentially distributed. The largest bin's fraction g of the sum over n bins is exceeded
with a probability of at most n (1 - g)^(n - 1) (Fisher, 1929).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hpe_rig.arrays import FloatArray
from hpe_rig.processing.harmonics.medium_fit import medium_fit
from hpe_rig.processing.harmonics.medium_prior import MediumPrior
from hpe_rig.processing.harmonics.model import aliased_hz, linear_model, pulse_rate_hz
from hpe_rig.processing.motion.displacement import Motion

MIN_BINS = 12
"""Number of free bins below which a line is not tested."""


@dataclass(frozen=True, slots=True)
class Line:
    """The strongest line: its frequency, its amplitude, and the probability of one as strong in white noise."""

    frequency_hz: float
    amplitude_m: float
    probability: float


def residual_line(
    motion: Motion,
    frequencies_hz: FloatArray | Sequence[float],
    *,
    also_hz: FloatArray | Sequence[float] = (),
    background_order: int = 0,
    prior: MediumPrior | None = None,
) -> Line | None:
    """Return the strongest spectral line in the residual of one train's fit, or None if too few bins are free of it.

    It reveals motion that was not fitted. The fit is least squares or, with a ``prior`` of media, that of
    ``medium_fit``. Motion that aliases onto a fitted frequency is not in the residual. Raises ``ValueError`` as the fit
    does.
    """
    frequency_hz = np.asarray(frequencies_hz, dtype=np.float64)
    rate_hz = pulse_rate_hz(motion.time_s)
    if prior is None:
        model = linear_model(
            motion.time_s, motion.valid, frequency_hz, background_order=background_order, also_hz=also_hz
        )
        residual = model.solve(motion.displacement_m[motion.valid])[1]
        fitted_hz = aliased_hz(np.concatenate([frequency_hz, np.asarray(also_hz, dtype=np.float64)]), rate_hz)
    else:
        residual = medium_fit(motion, frequency_hz, prior, background_order=background_order).residual_m(motion)
        fitted_hz = np.zeros(0)
    # An even series: skipped pulses are zero.
    index = np.round((motion.time_s - motion.time_s[0]) * rate_hz).astype(np.int64)
    series = np.zeros(int(index[-1]) + 1)
    series[index[motion.valid]] = residual
    grid_hz = np.fft.rfftfreq(series.size, 1 / rate_hz)
    # Free bins: more than one bin from every fitted frequency, above the bins of the polynomial (half a bin an order).
    distance = np.abs(grid_hz[:, None] - fitted_hz).min(axis=1, initial=np.inf) * series.size / rate_hz
    free = (distance > 1 + 1e-6) & (grid_hz * series.size / rate_hz > 0.5 + background_order / 2)
    free &= grid_hz < rate_hz / 2 * (1 - 1e-9)
    # Periodogram of the residual; under white noise its bins are exponentially distributed.
    power = np.abs(np.fft.rfft(series)[free]) ** 2
    if power.size < MIN_BINS or not power.sum() > 0:
        return None
    # In white noise, n (1 - fraction)^(n - 1) bounds the probability of so large a bin among n (Fisher, 1929).
    fraction = float(power.max() / power.sum())
    return Line(
        frequency_hz=float(grid_hz[free][np.argmax(power)]),
        amplitude_m=2 * float(np.sqrt(power.max())) / residual.size,
        probability=min(1.0, power.size * (1 - fraction) ** (power.size - 1)),
    )
