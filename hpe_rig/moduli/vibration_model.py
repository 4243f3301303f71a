"""Vibrations at several lateral offsets and depths, and the push that drives them.

The complex amplitude y_pn of sin(w_n t + phase) at the point p and the harmonic n is modelled as

    y_pn = g_p S_n exp(-j w_n tau) U(w_n, r_p, z_p; G, A_p, B) + noise,    |S_n| = 2 f_r T_b |sinc(n f_r T_b)|

S is the spectrum of the tonebursts (rate f_r, length T_b), tau their onset, U the displacement per body force
(``hpe_rig.medium.shear_motion``) in a medium of modulus G. r_p and z_p are the distances from axis and focus, g_p is
the gain, A_p and B are the variances over which the tracking beam averages. Derivation: docs/explanation/moduli.md.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hpe_rig.arrays import BoolArray, ComplexArray, FloatArray
from hpe_rig.medium import PushForce, burst_spectrum

APERTURE_SHAPE = 0.005
"""Relative error of each amplitude: difference of two sums of Gaussians for one aperture, to 4 mm off the axis."""


FREE_GAIN_UNCERTAINTY = 5.0
"""Uncertainty of the logarithm of a gain that is unknown."""


@dataclass(frozen=True, slots=True)
class Push:
    """The force of the tonebursts, and relative uncertainties of its widths (across, along).

    ``onset_uncertainty_s`` is that of the bursts' onset at the focus, the origin of the phases.
    """

    force: PushForce
    burst_rate_hz: float
    burst_length_s: float
    density_kg_per_m3: float = 1000.0
    width_uncertainty: tuple[float, float] = (0.05, 0.05)
    onset_uncertainty_s: float = 0.5e-6

    @property
    def shape_relative(self) -> float:
        """Model error of each amplitude (relative) and of its phase (rad) from the force's shape."""
        return APERTURE_SHAPE if self.force.weight_changes else 0.0

    def spectrum(self, frequency_hz: FloatArray) -> ComplexArray:
        """Return A exp(j phase) (frequency,) of the tonebursts' force, 1 during each burst and 0 between bursts.

        A and phase are those of A sin(wt + phase), with t from the onset of a burst.
        """
        # A real force is 2 Re[c exp(jwt)] with the Fourier coefficient c of exp(jwt); the sine convention A sin(wt +
        # phase) then has A exp(j phase) = 2j c.
        duty = self.burst_rate_hz * self.burst_length_s
        return 2j * duty * burst_spectrum(frequency_hz, self.burst_length_s)


@dataclass(frozen=True, slots=True)
class Vibration:
    """Measured complex amplitudes A exp(j phase) (frequency,), m, of A sin(2 pi f t + phase) in one gate.

    ``covariance_m2`` (2 * frequency, 2 * frequency) is that of A cos(phase), A sin(phase), frequency by frequency. Time
    counts from a burst's onset at the focus plus ``travel_s``, the sound's travel time from the focus to the gate.
    ``lateral_m`` and ``axial_m`` are distances from the push's axis and focus. ``tracking_m2``: variances across and
    along over which the tracking averages.

    Uncertainties: ``lateral_uncertainty_m`` and ``axial_uncertainty_m`` of the tracked position by speckle;
    ``stage_uncertainty_m`` of the transducer's position, common to all gates of one ``position``; gain and phase common
    to all frequencies; ``area_uncertainty``, relative, of the averaged area across by speckle.
    """

    label: str
    frequency_hz: FloatArray
    phasor_m: ComplexArray
    covariance_m2: FloatArray
    lateral_m: float
    axial_m: float = 0.0
    tracking_m2: tuple[float, float] = (0.0, 0.0)
    lateral_uncertainty_m: float = 0.0
    position: str = ""
    stage_uncertainty_m: float = 0.0
    travel_s: float = 0.0
    axial_uncertainty_m: float = 0.0
    gain_uncertainty: float = 0.0
    phase_uncertainty_rad: float = 0.0
    area_uncertainty: float = 0.0

    @property
    def has_free_gain(self) -> bool:
        """Whether nothing is known of the gain, so that amplitudes at different offsets do not compare."""
        return self.gain_uncertainty >= FREE_GAIN_UNCERTAINTY

    def with_free_gain(self) -> Vibration:
        """Return the vibration with an unknown gain."""
        return replace(self, gain_uncertainty=FREE_GAIN_UNCERTAINTY)

    def at_frequencies(self, selected: BoolArray) -> Vibration:
        """Return the vibration at the ``selected`` (frequency,) frequencies only."""
        # Two states, cosine and sine, for each frequency.
        states = np.repeat(selected, 2)
        return replace(
            self,
            frequency_hz=self.frequency_hz[selected],
            phasor_m=self.phasor_m[selected],
            covariance_m2=self.covariance_m2[np.ix_(states, states)],
        )
