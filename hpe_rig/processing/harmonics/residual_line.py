"""Line in the residual: motion at a frequency that was not fitted, or that folds there from above half the pulse rate.

Under white noise each bin of the residual's periodogram is exponential, and the largest one's share g of their sum
exceeds what it is with the probability n (1 - g)^(n - 1) at most (Fisher 1929).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hpe_rig.arrays import FloatArray
from hpe_rig.processing.echo.echoes import Motion
from hpe_rig.processing.harmonics.medium_prior import MediumPrior, fit_residual
from hpe_rig.processing.harmonics.model import aliased_hz, linear_model, pulse_rate_hz

LEAST_BINS = 12
"""Free bins below which a largest one says nothing."""


@dataclass(frozen=True, slots=True)
class Line:
    """The strongest line: its frequency, amplitude, and how often white noise alone has one as strong."""

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
    """Return the strongest line in what the fit of one train leaves, None where too few bins are free of the fit.

    The fit is that of ``least_squares`` or, with a ``prior``, of ``medium_fit``. Pulses that are not valid count as
    zero. What folds onto a fitted frequency is no residual, and no spectrum shows it. Raises ``ValueError`` as the fit.
    """
    frequency_hz = np.asarray(frequencies_hz, dtype=np.float64)
    rate_hz = pulse_rate_hz(motion.time_s)
    if prior is None:
        model = linear_model(
            motion.time_s, motion.valid, frequency_hz, background_order=background_order, also_hz=also_hz
        )
        residual = model.solve(motion.displacement_m[motion.valid])[1]
        taken_hz = aliased_hz(np.concatenate([frequency_hz, np.asarray(also_hz, dtype=np.float64)]), rate_hz)
    else:
        residual, taken_hz = fit_residual(motion, frequency_hz, prior, background_order=background_order), np.zeros(0)
    place = np.round((motion.time_s - motion.time_s[0]) * rate_hz).astype(np.int64)
    series = np.zeros(int(place[-1]) + 1)
    series[place[motion.valid]] = residual
    grid_hz = np.fft.rfftfreq(series.size, 1 / rate_hz)
    # a polynomial has emptied about half a bin an order next to zero
    apart = np.abs(grid_hz[:, None] - taken_hz).min(axis=1, initial=np.inf) * series.size / rate_hz
    free = (apart > 1 + 1e-6) & (grid_hz * series.size / rate_hz > 0.5 + background_order / 2)
    free &= grid_hz < rate_hz / 2 * (1 - 1e-9)
    power = np.abs(np.fft.rfft(series)[free]) ** 2
    if power.size < LEAST_BINS or not power.sum() > 0:
        return None
    share = float(power.max() / power.sum())
    return Line(
        float(grid_hz[free][np.argmax(power)]),
        2 * float(np.sqrt(power.max())) / residual.size,
        min(1.0, power.size * (1 - share) ** (power.size - 1)),
    )
