"""Linear form of the harmonic fit of a shot: what it makes of noise, and of harmonics that it does not fit.

    in-phase and quadrature of a wanted frequency = weights @ displacement

The weights are those of the model that the estimate really uses, least squares or the prior of media, at the pulses
that it really uses. Every prediction of noise and aliasing goes through here, so that all print the same numbers.
"""

from __future__ import annotations

import math

import numpy as np

from hpe_rig.arrays import ComplexArray, FloatArray
from hpe_rig.bench import twin_of
from hpe_rig.plan import Shot, select
from hpe_rig.prediction.amplitude import expected_amplitude_m, expected_snr_db
from hpe_rig.prediction.beam_averaging import beam_widths
from hpe_rig.processing import (
    WEIGHT,
    EstimatorSpec,
    MediumPrior,
    Motion,
    fit_motion,
    options_of,
    seen_by,
    shot_model,
    shot_prior,
    spec_of,
)
from hpe_rig.scene import Scene


def noise_gain(scene: Scene, shot: Shot, estimator: str | None = None) -> FloatArray:
    """Return the noise of a quadrature of each wanted frequency over that of a pulse (frequency,), mean of the two.

    sqrt(2/N) for a sinusoid fitted alone to N pulses over whole cycles; more where pulses are skipped and hardly tell
    the wanted from the other driven harmonics, fitted along. ``estimator``: absent, the scene's. Raises ``ValueError``
    where the pulses do not resolve the wanted frequencies.
    """
    spec = spec_of(estimator or scene.processing.estimator)
    if spec.fits_all_at_once:
        return np.asarray(np.sqrt(np.mean(np.sum(fit_weights(scene, shot, spec)[0] ** 2, axis=-1), axis=-1)))
    shot_model(scene, shot, False)
    chosen = select(scene, shot)
    return np.full(chosen.wanted_hz.size, math.sqrt(2 * spec.slow_time_noise / chosen.used.sum()))


def larger_quadrature(scene: Scene, shot: Shot, estimator: str | None = None) -> FloatArray:
    """Return the noise of the larger principal quadrature of each wanted frequency over their mean (frequency,).

    1 where every phase is as well known as any other, up to sqrt(2) where skipped pulses leave one alone uncertain.
    """
    spec = spec_of(estimator or scene.processing.estimator)
    if not spec.fits_all_at_once:
        return np.ones(select(scene, shot).wanted_hz.size)
    weights = fit_weights(scene, shot, spec)[0]
    variance = np.linalg.eigvalsh(weights @ np.swapaxes(weights, -1, -2))
    return np.asarray(np.sqrt(variance[:, 1] / variance.mean(axis=-1)))


def fit_weights(scene: Scene, shot: Shot, spec: EstimatorSpec) -> tuple[FloatArray, FloatArray]:
    """Return weights (frequency, 2, pulse) of the used pulses' displacement, and when these sense it (pulse,)."""
    chosen = select(scene, shot)
    prior = shot_prior(scene, shot, spec.name, beam_widths(scene, spec.name))
    if prior is not None:
        weights = _prior_weights(scene, shot, spec, prior)
        return weights.reshape(chosen.wanted_hz.size, 2, -1), chosen.time_s[chosen.used]
    time_s, model = shot_model(scene, shot)
    rows = (model.root @ model.root.T)[: 2 * chosen.wanted_hz.size] @ model.matrix.T
    return rows.reshape(chosen.wanted_hz.size, 2, -1), time_s


def fitted(scene: Scene, shot: Shot, spec: EstimatorSpec, displacement_m: FloatArray) -> ComplexArray:
    """Return A exp(j phase) (frequency,) that the fit makes of a displacement (pulse,) known without noise.

    Of every pulse in the processing window, used or not.
    """
    chosen = select(scene, shot)
    if spec.fits_all_at_once:
        states = fit_weights(scene, shot, spec)[0] @ displacement_m[chosen.used]
        return np.asarray(states @ np.array([1, 1j]))
    # The variance of a pulse scales the uncertainty alone; its value does not matter.
    motion = Motion(chosen.time_s, displacement_m, np.full(displacement_m.size, 1e-18), chosen.used)
    fit = fit_motion(motion, chosen.wanted_hz, spec.name, chosen.driven_hz, options_of(scene.processing))
    return np.asarray(fit.amplitude_m * np.exp(1j * fit.phase_rad))


def _prior_weights(scene: Scene, shot: Shot, spec: EstimatorSpec, prior: MediumPrior) -> FloatArray:
    """Return the weights (2 * frequency, pulse) of the prior, its scale and the noise those that are expected."""
    chosen = select(scene, shot)
    seen = seen_by(prior, chosen.time_s, chosen.used, chosen.wanted_hz, scene.processing.background_order)
    unit_m = math.sqrt(float(np.mean(np.sum(seen.wanted_members[:, :2] ** 2, axis=1))))
    noise_m = pulse_noise_m(scene, spec)
    # Of less than its noise alone the fit would make as much: the evidence knows no smaller scale.
    least_m = noise_m * math.sqrt(2 / len(seen.left))
    expected_m = max(expected_amplitude_m(scene, float(chosen.wanted_hz[0]), shot), least_m)
    start = (WEIGHT * expected_m / unit_m) ** 2
    gain = start * seen.value / (noise_m**2 + start * seen.value**2)
    return np.asarray((seen.rows * gain) @ seen.left.T)


def pulse_noise_m(scene: Scene, spec: EstimatorSpec, simulated: bool = True) -> float:
    """Return the noise of one pulse's displacement, m: of its echo, and of the twin's trigger jitter."""
    return math.hypot(echo_noise_m(scene, spec), trigger_noise_m(scene, simulated))


def echo_noise_m(scene: Scene, spec: EstimatorSpec) -> float:
    """Return the noise of one pulse's displacement, m, from echo noise: phase variance 1 / (gate samples x SNR).

    Twice that variance where a reference gate is subtracted, whose echoes are taken to be as noisy.
    """
    acquisition, snr_db = scene.acquisition, expected_snr_db(scene)
    if snr_db is None:
        return 0.0
    samples = 2 * acquisition.gate_length_m / acquisition.sound_speed_m_per_s * acquisition.sample_rate_hz
    metres_per_radian = acquisition.sound_speed_m_per_s / (4 * math.pi * scene.tracking.carrier_hz)
    gates = 1 if scene.processing.reference_gate_depth_m is None else 2
    return metres_per_radian * math.sqrt(gates * spec.gate_noise / (samples * 10 ** (snr_db / 10)))


def trigger_noise_m(scene: Scene, simulated: bool = True) -> float:
    """Return the apparent displacement of one pulse by trigger jitter, m.

    0 on a real bench, where it is not known, and where a reference gate takes it away.
    """
    if scene.processing.reference_gate_depth_m is not None:
        return 0.0
    twin = twin_of(scene) if simulated else None
    return 0.0 if twin is None else twin.trigger_jitter_s * scene.acquisition.sound_speed_m_per_s / 2
