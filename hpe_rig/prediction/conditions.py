"""Conditions of a prediction: expected amplitude and SNR, and what else bias and jitter of an estimate depend on."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hpe_rig.bench import twin_of
from hpe_rig.medium import echo_power, scatterer_density
from hpe_rig.plan import Shot
from hpe_rig.prediction.scene_physics import force_spectrum, pulse_length_m
from hpe_rig.scene import Scene

Triple = tuple[float, float, float]

DEFAULT_AMPLITUDE_M = 100e-9
"""Amplitude for a scene that states none: the smallest ones that the paper's bench detects."""
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
    """Return beams, gate and scatterers for the prediction of speckle, without motion and noise.

    None without beams or wanted frequencies. Speckle is fully developed unless the twin states a scatterer density.
    """
    if scene.beams is None or not scene.wanted_frequencies_hz:
        return None
    acquisition, tracking, beams, twin = scene.acquisition, scene.tracking, scene.beams, twin_of(scene)
    per_cell = 0.0 if twin is None else twin.settings.scatterers.per_cell
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


def expected_snr_db(scene: Scene) -> float | None:
    """Return the SNR in the gate, dB, that the scene expects or its twin simulates; None if neither states one."""
    if scene.processing.expected_snr_db is not None:
        return scene.processing.expected_snr_db
    twin = twin_of(scene)
    receiver = None if twin is None else twin.settings.receiver
    if receiver is None or receiver.snr_db is None or scene.beams is None:
        return None if receiver is None else receiver.snr_db
    # The twin's SNR holds in its reference gate; a longer gate has less echo power on average.
    pulse = pulse_length_m(scene), scene.beams.tracking_width_m[2]
    power, reference = (
        echo_power(gate_m, *pulse) for gate_m in (scene.acquisition.gate_length_m, receiver.reference_gate_m)
    )
    return float(receiver.snr_db + 10 * math.log10(power / reference))


def expected_amplitude_m(scene: Scene, frequency_hz: float, shot: Shot | None = None) -> float:
    """Return the peak displacement at ``frequency_hz`` that the scene expects, else that of its twin, else a default.

    ``shot`` gives force and burst length (default: the scene's first).
    """
    if scene.processing.expected_amplitude_m is not None:
        return scene.processing.expected_amplitude_m
    twin = twin_of(scene)
    if twin is None:
        return DEFAULT_AMPLITUDE_M
    if twin.settings.specimen is not None:
        drive = relative_drive(scene, frequency_hz, shot)
        return drive * twin.steady_response_m(frequency_hz) if drive > 0 else DEFAULT_AMPLITUDE_M
    prescribed_m = abs(twin.prescribed_phasor_m(frequency_hz))
    return prescribed_m if prescribed_m > 0 else DEFAULT_AMPLITUDE_M


def relative_drive(scene: Scene, frequency_hz: float, shot: Shot | None = None) -> float:
    """Return the force's amplitude at ``frequency_hz`` over the full force F_0 of a toneburst; 0 if nothing drives it.

    ``shot`` gives force and burst length (default: the scene's first).
    """
    excitation = scene.excitation
    if excitation is None:
        return 0.0
    # Tonebursts drive multiples of their rate only.
    harmonic = round(frequency_hz / excitation.burst_rate_hz)
    if harmonic == 0 or not math.isclose(harmonic * excitation.burst_rate_hz, frequency_hz, rel_tol=1e-6):
        return 0.0
    length_s = (shot.timeline.burst_length_s if shot is not None else 0.0) or excitation.burst_length_s[0]
    fraction = (shot.force_fraction if shot is not None else None) or excitation.force_fraction[0]
    return 2 * abs(complex(force_spectrum(harmonic, excitation.burst_rate_hz, length_s))) * fraction
