"""Cramer-Rao bound on amplitude and phase of harmonics from a scene's own echoes.

    Cov x >= [D' D sum_t (2 v'(t) / c)^2 / noise^2]^-1

v(t) is the echo at rest, c the sound speed, D the columns of the displacement D x with the mean over pulses removed.
Derivation: docs/explanation/prediction.md, "Bounds".
"""

from __future__ import annotations

import numpy as np
from scipy.interpolate import make_interp_spline

from hpe_rig.arrays import FloatArray


def echo_bound(
    resting_v: FloatArray,
    sample_rate_hz: float,
    noise_v: FloatArray | float,
    columns: FloatArray,
    sound_speed_m_per_s: float,
) -> FloatArray:
    """Return the smallest covariance (..., state, state) that any unbiased estimator of the motion can have.

    The echo ``resting_v`` (..., sample) shifts by the displacement ``columns`` (pulse, state) @ states. It is unknown
    itself, which costs the part that the columns have in common with a constant. ``noise_v`` is the rms of white noise.
    Source: Fisher information (Cramer-Rao bound) with the resting echo as nuisance parameter.
    """
    sample_s = np.arange(resting_v.shape[-1]) / sample_rate_hz
    # Change of voltage with displacement: the slope in time times 2 / c, by a quintic spline, since an FFT would treat
    # the gate's ends as a jump that moves.
    slope = make_interp_spline(sample_s, resting_v, 5, axis=-1)(sample_s, 1) * 2 / sound_speed_m_per_s
    information = np.sum(slope**2, axis=-1) / np.square(noise_v)
    centred = columns - columns.mean(axis=0)
    return np.asarray(np.linalg.inv(centred.T @ centred) / information[..., None, None])
