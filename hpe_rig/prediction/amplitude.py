"""Expected amplitude and SNR of a scene: as stated, else as its twin simulates."""

from __future__ import annotations

import math

from hpe_rig.bench import twin_of
from hpe_rig.medium import echo_power
from hpe_rig.plan import Shot
from hpe_rig.prediction.scene_physics import force_spectrum, pulse_length_m
from hpe_rig.scene import Scene

DEFAULT_AMPLITUDE_M = 100e-9
"""Amplitude for a scene that states none: the smallest ones that the paper's bench detects."""


def expected_snr_db(scene: Scene) -> float | None:
    """Return the SNR in the gate that the scene expects or its twin simulates; None if neither states one."""
    if scene.processing.expected_snr_db is not None:
        return scene.processing.expected_snr_db
    twin = twin_of(scene)
    if twin is None or twin.snr_db is None or scene.beams is None:
        return None if twin is None else twin.snr_db
    # The twin's SNR holds in its reference gate; a longer gate has less echo power on average.
    pulse = pulse_length_m(scene), scene.beams.tracking_width_m[2]
    power, reference = (
        echo_power(gate_m, *pulse) for gate_m in (scene.acquisition.gate_length_m, twin.reference_gate_m)
    )
    return twin.snr_db + 10 * math.log10(power / reference)


def expected_amplitude_m(scene: Scene, frequency_hz: float, shot: Shot | None = None) -> float:
    """Return the amplitude at ``frequency_hz`` that the scene expects, else that of its twin's motion.

    ``shot`` gives force and burst length (default: the scene's first).
    """
    if scene.processing.expected_amplitude_m is not None:
        return scene.processing.expected_amplitude_m
    twin = twin_of(scene)
    if twin is None:
        return DEFAULT_AMPLITUDE_M
    if twin.has_specimen:
        drive = relative_drive(scene, frequency_hz, shot)
        return drive * twin.steady_response_m(frequency_hz) if drive > 0 else DEFAULT_AMPLITUDE_M
    prescribed_m = abs(twin.prescribed_phasor_m(frequency_hz))
    return prescribed_m if prescribed_m > 0 else DEFAULT_AMPLITUDE_M


def relative_drive(scene: Scene, frequency_hz: float, shot: Shot | None = None) -> float:
    """Return the amplitude of the force at ``frequency_hz`` over F_0; 0 if nothing drives it."""
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
