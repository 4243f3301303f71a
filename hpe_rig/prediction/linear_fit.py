"""Linear form of the harmonic fit of a shot: its response to noise and to harmonics that it does not fit.

    in-phase and quadrature of a wanted frequency = weights @ displacement

The weights are those of the later fit, least squares or the medium prior, at the pulses that it will use. All
predictions of noise and aliasing use them, so that they agree.

Aliasing is the error of the wanted harmonics from harmonics that the fit does not resolve. The steady motion of the
medium under the bursts, with all harmonics of several lobes of the force spectrum, is sampled at the pulses and fitted
without noise.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress

import numpy as np

from hpe_rig.arrays import ComplexArray, FloatArray
from hpe_rig.bench import twin_of
from hpe_rig.plan import Shot, select
from hpe_rig.prediction.conditions import expected_amplitude_m, expected_snr_db
from hpe_rig.prediction.scene_physics import beam_widths, focal_motion, force_spectrum
from hpe_rig.processing import (
    PRIOR_WIDENING,
    EstimatorSpec,
    MediumPrior,
    Motion,
    fit_motion,
    harmonic_columns,
    options_of,
    project_prior,
    shot_model,
    shot_prior,
    spec_of,
)
from hpe_rig.scene import Scene

PULSES_PER_BLOCK = 32_768
"""Number of pulses for which all harmonics are computed at once, to bound the memory."""
LOBES = 10
"""Lobes of the force spectrum, each 1/T_b wide, in the simulated motion; the motion falls as their square."""


def noise_gain(scene: Scene, shot: Shot, estimator: str | None = None) -> FloatArray:
    """Return the noise of a fitted quadrature over the noise of a pulse, (frequency,), rms of the two quadratures.

    It is sqrt(2/N) for a single sinusoid fitted to N pulses over whole cycles, and more if skipped pulses hardly
    separate the wanted from the other fitted harmonics. ``estimator`` defaults to the scene's. Raises ``ValueError`` if
    the pulses do not resolve the wanted frequencies.
    """
    spec = spec_of(estimator or scene.processing.estimator)
    if spec.fits_all_at_once:
        return np.asarray(np.sqrt(np.mean(np.sum(fit_weights(scene, shot, spec) ** 2, axis=-1), axis=-1)))
    # Raises if the pulses do not resolve the frequencies.
    shot_model(scene, shot, False)
    pulses = select(scene, shot)
    return np.full(pulses.wanted_hz.size, math.sqrt(2 * spec.slow_time_noise / pulses.used.sum()))


def larger_quadrature(scene: Scene, shot: Shot) -> FloatArray:
    """Return the noise of the larger principal quadrature over the rms of both, (frequency,).

    It is 1 if all phases are equally certain, up to sqrt(2) if skipped pulses leave one of the two uncertain.
    """
    spec = spec_of(scene.processing.estimator)
    if not spec.fits_all_at_once:
        return np.ones(select(scene, shot).wanted_hz.size)
    weights = fit_weights(scene, shot, spec)
    # Eigenvalues of the 2 x 2 covariance of the quadratures are the principal variances.
    variance = np.linalg.eigvalsh(weights @ np.swapaxes(weights, -1, -2))
    return np.asarray(np.sqrt(variance[:, 1] / variance.mean(axis=-1)))


def fit_weights(scene: Scene, shot: Shot, spec: EstimatorSpec) -> FloatArray:
    """Return the weights (frequency, quadrature, pulse) of the used pulses in the fitted quadratures.

    They are those of the later fit, with the prior of media or by least squares, at the pulses that it will use.
    """
    pulses = select(scene, shot)
    prior = shot_prior(scene, shot, spec.name, beam_widths(scene, spec.name))
    if prior is not None:
        weights = _prior_weights(scene, shot, spec, prior)
    else:
        _, model = shot_model(scene, shot)
        # Least squares: (H'H)^-1 H', with the inverse as root root'. The wanted harmonics are the first rows.
        weights = (model.root @ model.root.T)[: 2 * pulses.wanted_hz.size] @ model.matrix.T
    return weights.reshape(pulses.wanted_hz.size, 2, -1)


def fit_noise_free(scene: Scene, shot: Shot, spec: EstimatorSpec, displacement_m: FloatArray) -> ComplexArray:
    """Return the fitted A exp(j phase) (frequency,), m, of a noise-free displacement at every pulse of the window."""
    pulses = select(scene, shot)
    if spec.fits_all_at_once:
        quadratures_m = fit_weights(scene, shot, spec) @ displacement_m[pulses.used]
        return np.asarray(quadratures_m @ np.array([1, 1j]))
    # The pulses' variance scales the uncertainty only; its value does not matter.
    motion = Motion(
        time_s=pulses.time_s,
        displacement_m=displacement_m,
        variance_m2=np.full(displacement_m.size, 1e-18),
        valid=pulses.used,
    )
    fit = fit_motion(motion, pulses.wanted_hz, spec.name, pulses.driven_hz, options_of(scene.processing))
    return np.asarray(fit.amplitude_m * np.exp(1j * fit.phase_rad))


def _prior_weights(scene: Scene, shot: Shot, spec: EstimatorSpec, prior: MediumPrior) -> FloatArray:
    """Return the weights (2 * frequency, pulse) of the pulses in the quadratures of a fit with the prior of media.

    The fit estimates the noise of a pulse and the amplitude of the motion; the weights are those for the values that
    the scene expects.
    """
    pulses = select(scene, shot)
    projected = project_prior(prior, pulses.time_s, pulses.used, pulses.wanted_hz, scene.processing.background_order)
    # Rms amplitude of the prior's media at the first wanted frequency, in the unit of the prior.
    prior_amplitude = math.sqrt(float(np.mean(np.sum(projected.sample_states[: projected.members, :2] ** 2, axis=1))))
    noise_m = math.hypot(echo_noise_m(scene, spec), trigger_noise_m(scene))
    # The fit does not distinguish amplitudes below its noise.
    min_amplitude_m = noise_m * math.sqrt(2 / len(projected.patterns))
    amplitude_m = max(expected_amplitude_m(scene, float(pulses.wanted_hz[0]), shot), min_amplitude_m)
    prior_variance_m2 = (PRIOR_WIDENING * amplitude_m / prior_amplitude) ** 2
    # Wiener gain of each pattern of displacement: its signal over signal plus noise variance.
    gain = prior_variance_m2 * projected.pattern_sd / (noise_m**2 + prior_variance_m2 * projected.pattern_sd**2)
    return np.asarray((projected.wanted_per_pattern * gain) @ projected.patterns.T)


def echo_noise_m(scene: Scene, spec: EstimatorSpec) -> float:
    """Return the displacement noise of one pulse, m, from echo noise: phase variance 1 / (gate samples x SNR).

    Twice that variance with a reference gate: its echoes are assumed to be as noisy. 0 if no SNR is known.
    """
    acquisition, snr_db = scene.acquisition, expected_snr_db(scene)
    if snr_db is None:
        return 0.0
    samples = 2 * acquisition.gate_length_m / acquisition.sound_speed_m_per_s * acquisition.sample_rate_hz
    metres_per_radian = acquisition.sound_speed_m_per_s / (4 * math.pi * scene.tracking.carrier_hz)
    gates = 1 if scene.processing.reference_gate_depth_m is None else 2
    return metres_per_radian * math.sqrt(gates * spec.gate_noise / (samples * 10 ** (snr_db / 10)))


def trigger_noise_m(scene: Scene, simulated: bool = True) -> float:
    """Return the apparent displacement of one pulse caused by trigger jitter, rms, m.

    0 on a real bench, where it is not known, and with a reference gate, which removes it.
    """
    if scene.processing.reference_gate_depth_m is not None:
        return 0.0
    twin = twin_of(scene) if simulated else None
    jitter_s = 0.0 if twin is None else twin.settings.instruments.trigger_jitter_s
    return jitter_s * scene.acquisition.sound_speed_m_per_s / 2


def fitted_over_true(scene: Scene, shot: Shot, simulated: bool = True) -> ComplexArray | None:
    """Return ``fitted_over_true_by_estimator`` for the estimator of the scene."""
    return fitted_over_true_by_estimator(scene, shot, (scene.processing.estimator,), simulated)[0]


def fitted_over_true_by_estimator(
    scene: Scene, shot: Shot, estimators: Sequence[str], simulated: bool = True
) -> tuple[ComplexArray | None, ...]:
    """Return the fitted over the true phasor of each wanted harmonic (frequency,), for each of ``estimators``.

    Without noise the ratio is 1 except for aliasing. The motion is computed once for all. ``simulated``: without a
    declared medium, that of the twin (the table [simulation]) is used. All are None if no medium is known, nothing
    pushes, or the wanted frequencies are no multiples of the burst rate. One is None if that estimator cannot resolve
    the frequencies.
    """
    motion = _steady_motion(scene, shot, simulated)
    ratios: list[ComplexArray | None] = [None] * len(estimators)
    if motion is not None:
        true_m, displacement_m = motion
        for i, name in enumerate(estimators):
            # The plan may break rules of the scene, such as too few pulses: the fit then raises ValueError.
            with suppress(ValueError):
                ratios[i] = fit_noise_free(scene, shot, spec_of(name), displacement_m) / true_m
    return tuple(ratios)


def _steady_motion(scene: Scene, shot: Shot, simulated: bool) -> tuple[ComplexArray, FloatArray] | None:
    """Return the steady motion under the tonebursts: phasors (frequency,) and displacement at every pulse (pulse,), m.

    The phasors A exp(j phase) are those of the wanted harmonics; the displacement contains all harmonics.
    ``simulated``: without a declared medium, that of the twin is used. None if no medium is known, nothing pushes, or
    the wanted frequencies are no multiples of the burst rate.
    """
    if scene.excitation is None or shot.toneburst is None or not scene.wanted_frequencies_hz:
        return None
    rate_hz, length_s = scene.excitation.burst_rate_hz, shot.toneburst.cycles / shot.toneburst.carrier_hz
    wanted_hz = np.array(scene.wanted_frequencies_hz)
    wanted_index = np.rint(wanted_hz / rate_hz).astype(np.int64)
    # All harmonics of the burst rate up to several lobes of the force's spectrum.
    harmonic = np.arange(1, int(LOBES / (length_s * rate_hz)) + 1)
    frequency_hz = np.asarray(harmonic * rate_hz, dtype=np.float64)
    motion, time_s = focal_motion(scene, frequency_hz, simulated), select(scene, shot).time_s
    # A plan that breaks rules of the scene may have no pulse in its window.
    if (
        motion is None
        or not time_s.size
        or not np.allclose(wanted_index * rate_hz, wanted_hz, rtol=1e-9)
        or wanted_index.max() > harmonic.size
    ):
        return None
    # The sinusoid A sin(w t + phase) has A exp(j phase) = j times the coefficient of exp(j w t).
    phasor_m = 1j * motion[0] * force_spectrum(harmonic, rate_hz, length_s)
    quadratures_m = np.stack([phasor_m.real, phasor_m.imag], axis=-1).ravel()
    return np.asarray(phasor_m[wanted_index - 1]), summed_harmonics_m(time_s, frequency_hz, quadratures_m)


def summed_harmonics_m(time_s: FloatArray, frequency_hz: FloatArray, quadratures_m: FloatArray) -> FloatArray:
    """Return the displacement (pulse,) at ``time_s`` of harmonics with A cos(phase), A sin(phase) (2 * frequency,)."""
    # In blocks: with hundreds of harmonics the columns of a long train take gigabytes.
    starts = range(0, time_s.size, PULSES_PER_BLOCK)
    blocks = (harmonic_columns(time_s[start : start + PULSES_PER_BLOCK], frequency_hz) for start in starts)
    return np.concatenate([columns @ quadratures_m for columns in blocks])
