"""Motion without tonebursts, from the control of each shot, and the uncertainty that its subtraction leaves.

    y = shot - control,    u² = u_c² + 2 s²

y is the complex amplitude at a wanted frequency, u_c the noise of the control, and s² the variance, in each quadrature,
of the motion without tonebursts from shot to shot. A hum of fixed phase relative to the master trigger has s = 0. One
of amplitude h and random phase has s² = h²/2: subtraction does not remove it, and u states it. The scatter of the
controls about their mean, less their noise, estimates s². A single control has no scatter: its phase counts as random.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from hpe_rig.arrays import FloatArray
from hpe_rig.processing.harmonics.harmonic_fit import HarmonicFit, with_state_error
from hpe_rig.processing.harmonics.model import harmonic_columns


@dataclass(frozen=True, slots=True)
class ControlMotion:
    """Motion in the control of one shot, in one processing window.

    ``fit``: its harmonics at the wanted frequencies, without a prior of media. ``scatter_m2`` (frequency,): 2 s², with
    ``scatter_freedom`` degrees of freedom.
    """

    fit: HarmonicFit
    scatter_m2: FloatArray
    scatter_freedom: float

    @property
    def noise_m2(self) -> FloatArray:
        """Noise variance (frequency,) of the control in each quadrature."""
        return _noise_m2(self.fit)

    def displacement_m(self, time_s: FloatArray) -> FloatArray:
        """Return the displacement (pulse,) of the control's harmonics at ``time_s`` (pulse,)."""
        columns = harmonic_columns(time_s, self.fit.frequency_hz)
        return np.asarray(columns @ self.fit.state[: columns.shape[1]])

    def with_error(self, fit: HarmonicFit) -> HarmonicFit:
        """Return ``fit``, of a motion less this control, with the uncertainty of the control."""
        return with_state_error(fit, np.diag(np.repeat(self.noise_m2 + self.scatter_m2, 2)))


def control_motions(fits: Mapping[int, HarmonicFit]) -> dict[int, ControlMotion]:
    """Return the motion of every control (a shot without tonebursts), with the scatter between controls.

    ``fits``: harmonics of each control, at least one. The scatter is 2 s², the variance of the difference of two shots;
    s² is the variance between controls minus their noise, in one quadrature.
    """
    states_m = np.array([fit.state[: 2 * fit.frequency_hz.size] for fit in fits.values()])
    phasors_m = states_m[:, 0::2] + 1j * states_m[:, 1::2]
    count = len(phasors_m)
    # The deviation of a single control is from 0, the mean over random phases.
    deviations_m = phasors_m - (phasors_m.mean(axis=0) if count > 1 else 0.0)
    freedom = 2 * max(count - 1, 1)
    # Variances in one quadrature: the squared magnitude of a phasor contains two.
    between_m2 = np.sum(np.abs(deviations_m) ** 2, axis=0) / freedom
    noise_m2 = np.mean([_noise_m2(fit) for fit in fits.values()], axis=0)
    scatter_m2 = 2 * np.maximum(between_m2 - noise_m2, 0.0)
    return {key: ControlMotion(fit, scatter_m2, float(freedom)) for key, fit in fits.items()}


def _noise_m2(fit: HarmonicFit) -> FloatArray:
    """Return the mean variance (frequency,) of in-phase and quadrature values."""
    variances_m2 = np.diag(fit.state_covariance)[: 2 * fit.frequency_hz.size]
    return np.asarray(variances_m2.reshape(-1, 2).mean(axis=1))
