"""The logarithmic amplifier: linear for small signals, a fixed number of volts a decade for large ones."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sim_backend.settings import LogAmplifier

Floats = NDArray[np.float64]


def compressed(volts: Floats, amplifier: LogAmplifier) -> Floats:
    """Return the output ``slope asinh(v / 2 knee) / ln 10`` of the input ``volts``, any shape, limited to saturation.

    Odd and smooth, so that it keeps the sign of the carrier and, after a band-pass, its phase.
    """
    out = volts / (2 * amplifier.knee_v)
    np.arcsinh(out, out=out)
    out *= amplifier.slope_v_per_decade / np.log(10)
    if amplifier.saturation_v is not None:
        np.clip(out, -amplifier.saturation_v, amplifier.saturation_v, out=out)
    return out
