"""Conditions of a prediction: the quantities that bias and jitter of an estimate depend on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hpe_rig.bench import twin_of
from hpe_rig.medium import scatterer_density
from hpe_rig.prediction.scene_physics import pulse_length_m
from hpe_rig.scene import Scene

Triple = tuple[float, float, float]

DEVELOPED_SPECKLE_PER_CELL = 11.0
"""Scatterers per resolution cell if none are stated: fully developed speckle (paper, Table I)."""


@dataclass(frozen=True, slots=True)
class Conditions:
    """Conditions of a prediction; SI units, widths as sigmas, ``snr`` a power ratio in the gate.

    ``trigger_jitter_s`` between a pulse and the sampling clock moves a whole echo, so that no gate reduces it.
    ``fit_gain``: noise of the fitted quadrature over that of a single sinusoid fitted to all pulses.
    """

    excitation_width_m: Triple
    tracking_width_m: Triple
    gate_length_m: float
    pulse_length_m: float
    scatterers_per_m3: float
    carrier_hz: float
    sound_speed_m_per_s: float
    sample_rate_hz: float
    pulse_rate_hz: float
    pulses: int
    frequency_hz: float
    amplitude_m: float
    snr: float
    trigger_jitter_s: float = 0.0
    fit_gain: float = 1.0

    @property
    def trigger_jitter_variance(self) -> float:
        """Variance of a pulse's echo phase by trigger jitter, rad^2."""
        return float((2 * np.pi * self.carrier_hz * self.trigger_jitter_s) ** 2)

    @property
    def gate_samples(self) -> float:
        """Samples in the gate."""
        return 2 * self.gate_length_m / self.sound_speed_m_per_s * self.sample_rate_hz

    @property
    def metres_per_radian(self) -> float:
        """Displacement for one radian of echo phase."""
        return self.sound_speed_m_per_s / (4 * np.pi * self.carrier_hz)

    @property
    def half_step(self) -> float:
        """Half of the change of a unit motion between two pulses, sin(pi f / f_prf)."""
        return float(np.sin(np.pi * self.frequency_hz / self.pulse_rate_hz))


def resting_conditions(scene: Scene) -> Conditions | None:
    """Return the conditions of echoes at rest without noise; None without beams or wanted frequencies.

    Speckle is fully developed unless the twin states a scatterer density.
    """
    if scene.beams is None or not scene.wanted_frequencies_hz:
        return None
    acquisition, tracking, beams, twin = scene.acquisition, scene.tracking, scene.beams, twin_of(scene)
    per_cell = 0.0 if twin is None else twin.scatterers_per_cell
    return Conditions(
        excitation_width_m=beams.excitation_width_m,
        tracking_width_m=beams.tracking_width_m,
        gate_length_m=acquisition.gate_length_m,
        pulse_length_m=pulse_length_m(scene),
        scatterers_per_m3=scatterer_density(beams.tracking_width_m, per_cell or DEVELOPED_SPECKLE_PER_CELL),
        carrier_hz=tracking.carrier_hz,
        sound_speed_m_per_s=acquisition.sound_speed_m_per_s,
        sample_rate_hz=acquisition.sample_rate_hz,
        pulse_rate_hz=tracking.pulse_rate_hz,
        pulses=1,
        frequency_hz=scene.wanted_frequencies_hz[0],
        amplitude_m=0.0,
        snr=np.inf,
    )
