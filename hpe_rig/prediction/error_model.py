"""Error model: bias and jitter of amplitude and phase from beams, gate, pulse, noise and estimator.

    tracked over peak     r = (turning of the displaced echo) / (turning of the echo at rest)      each draw of speckle
    noise of a quadrature s = m sqrt(2 g (v + w / 4 sin^2(pi f / f_prf)) / N)                      windowed steps
                          s = m sqrt(2 v / N) times the gain of the fit                            least squares, w = 0

m is the displacement for one radian, g the noise factor of the slow-time window, N the number of pulses. The measured
phase step to pulse k has the error n_k - n_(k-1) + a_k: n_k, of variance v, cancels in the sum with the next step, and
a_k, of variance w, adds up. The phase is the sum of steps, with the error n_k - n_0 + a_1 + ... + a_k. The amplitude of
a vector with noise s in both components has a Rice distribution. The ends of the gate add no error: echoes are aligned
before the gate cuts them. Derivation: docs/explanation/prediction.md.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hpe_rig.arrays import ComplexArray, FloatArray
from hpe_rig.prediction.conditions import Conditions
from hpe_rig.prediction.peak_noise import peak_ratio, peak_statistics
from hpe_rig.prediction.speckle import BAND_OVER_CARRIER, INSTANTS, Speckle, instant_s, matmul, to_band
from hpe_rig.processing import EstimatorSpec, spec_of

RICE_SERIES_MIN = 5e3
"""Half of the squared amplitude over noise above which the mean of a Rice distribution is a short series."""
MAX_PHASE_SD_RAD = np.pi / np.sqrt(3)
"""Standard deviation of a phase that is uniform over a turn."""


@dataclass(frozen=True, slots=True)
class EstimatorErrors:
    """Predicted errors of one estimator against the peak displacement and its phase; standard deviations.

    ``quadrature_m``: noise of each quadrature, comparable with the stated uncertainty. ``noise_jitter_m``: resulting
    noise of the amplitude, smaller for small amplitudes. ``averaging_factor``: mean of tracked over peak displacement
    without noise. ``relative_variances``: noise variances in groups of equally many draws over their mean, if they
    differ.
    """

    estimator: str
    bias_m: float
    quadrature_m: float
    noise_jitter_m: float
    speckle_jitter_m: float
    phase_jitter_rad: float
    averaging_factor: float = 1.0
    relative_variances: tuple[float, ...] = (1.0,)

    @property
    def jitter_m(self) -> float:
        """Noise and speckle together."""
        return float(np.hypot(self.noise_jitter_m, self.speckle_jitter_m))


def estimator_errors(
    conditions: Conditions, estimator: str, speckle: Speckle, generator: np.random.Generator
) -> EstimatorErrors:
    """Return the predicted bias and jitter of amplitude and phase by ``estimator``.

    ``speckle``: random draws of echoes under the same ``conditions``.
    """
    spec = spec_of(estimator)
    # Tracked over peak displacement in every draw, and phase variances (rad^2) for each group of draws with equally
    # strong echoes: v of a pulse, and w that accumulates with every step (docstring of the module).
    if spec.reads_peak:
        ratio, variances = peak_statistics(conditions, speckle, generator)
    else:
        ratio, band_fraction = _whole_gate_ratio(conditions, speckle, spec.by_carrier)
        pulse_variance = spec.gate_noise / (conditions.gate_samples * conditions.snr)
        step_variance = _step_variance(conditions, pulse_variance) if spec.steps_add_up else 0.0
        variances = [(pulse_variance * band_fraction, step_variance)]
    jitter_variance = conditions.trigger_jitter_variance
    quadrature_sd_m = np.array(
        [_quadrature_sd_m(conditions, spec, pulse + jitter_variance, step) for pulse, step in variances]
    )
    rms_m = float(np.sqrt(np.mean(quadrature_sd_m**2)))
    relative = tuple((quadrature_sd_m**2 / rms_m**2).tolist()) if rms_m > 0 else (1.0,)
    return _with_rice_statistics(conditions, estimator, ratio, rms_m, relative)


def tracked_over_peak(conditions: Conditions, estimator: str, speckle: Speckle) -> FloatArray:
    """Return the tracked over the peak displacement in each draw of ``speckle`` (draw,), without noise.

    ``estimator`` reads the phase of the whole gate, or the phase at the peak of the spectrum.
    """
    spec = spec_of(estimator)
    return (
        peak_ratio(conditions, speckle)
        if spec.reads_peak
        else _whole_gate_ratio(conditions, speckle, spec.by_carrier)[0]
    )


def _whole_gate_ratio(conditions: Conditions, speckle: Speckle, by_carrier: bool) -> tuple[FloatArray, float]:
    """Return tracked over peak displacement (draw,) from the phase of the whole gate, and the band's energy fraction.

    A displacement u changes an echo a(t - 2u/c) exp(j w (t - 2u/c)) in proportion to its slope; the change of phase is
    the sum over the gate of the slope times the conjugate echo at rest. The tracked displacement is this phase over the
    mean frequency in the gate, or ``by_carrier`` over the carrier. Slopes are those of echoes that continue outside the
    gate, so its ends are no step.
    """
    carrier_rad_per_s = 2 * np.pi * conditions.carrier_hz

    def phase_per_delay(envelope: ComplexArray) -> FloatArray:
        """Return the change of phase for a delay of 1 s, rad/s, times the echo's energy, (draw,).

        ``envelope`` (draw, instant): echo at rest, or weighted by the displacement of its scatterers.
        """
        # Slope of the echo: that of its envelope, plus that of the carrier.
        slope = np.gradient(envelope, instant_s(conditions), axis=-1) + 1j * carrier_rad_per_s * envelope
        return np.asarray(np.sum(np.conj(speckle.resting) * slope, axis=-1).imag)

    energy = np.sum(np.abs(speckle.resting) ** 2, axis=-1)
    frequency = carrier_rad_per_s * energy if by_carrier else phase_per_delay(speckle.resting)
    ratio = phase_per_delay(speckle.displaced) / frequency
    band_energy = np.sum(np.abs(matmul(speckle.resting, to_band(conditions, INSTANTS))) ** 2)
    return np.asarray(ratio), float(band_energy / (INSTANTS * energy.sum()))


def _step_variance(conditions: Conditions, pulse_variance: float) -> float:
    """Return the phase variance w (rad^2) that noise adds to the sum of phase steps with every further pulse.

    Displacement by steps is the sum of the phase steps between consecutive pulses. The step to pulse k has the error
    n_k - n_(k-1) + a_k. The noise n_k of a pulse cancels with the next step; a_k, the product of the noises of two
    pulses, remains in the sum. With M independent samples in the gate, var n = ``pulse_variance`` = 1 / (2 M SNR) and
    w = var a = 2 M ``pulse_variance``^2.
    """
    # M of noise that is limited to the band before the gate cuts it: the sum of the squared eigenvalues of time and
    # band limiting (Slepian and Pollak, 1961), which is the sum over the squared covariance of the gate's samples.
    lag_s = instant_s(conditions) * np.subtract.outer(np.arange(INSTANTS), np.arange(INSTANTS))
    band_hz = BAND_OVER_CARRIER * conditions.carrier_hz
    sample_covariance = band_hz * instant_s(conditions) * np.sinc(band_hz * lag_s)
    independent_samples = float(np.sum(sample_covariance**2))
    return 2 * independent_samples * pulse_variance**2


def _quadrature_sd_m(conditions: Conditions, spec: EstimatorSpec, pulse_variance: float, step_variance: float) -> float:
    """Return the standard deviation of a fitted quadrature (in-phase or quadrature component), m.

    The error of the phase of pulse k is n_k + a_1 + ... + a_k: noise n of the pulse, with the ``pulse_variance``
    (rad^2), and, for a phase that is a sum of steps, noise a of each step, with the ``step_variance`` (rad^2).
    """
    if spec.fits_all_at_once:
        return conditions.fit_gain * _least_squares_sd_m(conditions, pulse_variance, step_variance)
    # A fit of the windowed steps. From pulse to pulse a motion changes by 2 sin(pi f / f_prf) = 2 ``half_step`` of its
    # amplitude. An error of a step, divided by this factor, is one of the amplitude.
    phase_variance = pulse_variance + step_variance / (4 * conditions.half_step**2)
    # The slow-time window w raises the noise by N sum w^2 / (sum w)^2, ``slow_time_noise``.
    return float(conditions.metres_per_radian * np.sqrt(2 * spec.slow_time_noise * phase_variance / conditions.pulses))


def _least_squares_sd_m(conditions: Conditions, pulse_variance: float, step_variance: float) -> float:
    """Return the standard deviation of a quadrature, m, fitted to the pulses with a constant by least squares.

    ``pulse_variance`` (rad^2): of the phase noise of each pulse. ``step_variance`` (rad^2): of the noise of each phase
    step. The latter adds up to a random walk, which has most power at low frequency; without a window it leaks into
    both quadratures.
    """
    if step_variance == 0:
        return float(conditions.metres_per_radian * np.sqrt(2 * pulse_variance / conditions.pulses))
    # Weights (quadrature, pulse) of the pulses in the fitted sine and cosine.
    angle = 2 * np.pi * conditions.frequency_hz / conditions.pulse_rate_hz * np.arange(conditions.pulses)
    weights = np.linalg.pinv(np.stack([np.sin(angle), np.cos(angle), np.ones_like(angle)], axis=-1))[:2]
    # A step shifts all later pulses, so its weight is the sum of theirs: cumulative from the last pulse to the second.
    step_weights = np.cumsum(weights[:, :0:-1], axis=1)
    # Mean of the two quadratures.
    phase_variance = pulse_variance * np.sum(weights**2) / 2 + step_variance * np.sum(step_weights**2) / 2
    return float(conditions.metres_per_radian * np.sqrt(phase_variance))


def _with_rice_statistics(
    conditions: Conditions, estimator: str, ratio: FloatArray, noise_m: float, relative_variances: tuple[float, ...]
) -> EstimatorErrors:
    """Return bias and jitter of amplitude and phase over speckle and noise in both quadratures.

    ``ratio`` (draw,): tracked over peak displacement in each draw of speckle. ``noise_m``: standard deviation of a
    quadrature. The amplitude of a phasor with such noise has a Rice distribution.
    """
    # Mean and variance of the noisy amplitude in each draw of speckle. Double precision: the variance is a small
    # difference.
    amplitude_m = np.abs(ratio, dtype=np.float64) * conditions.amplitude_m
    mean_m = _rice_mean(amplitude_m, noise_m)
    variance_m2 = np.maximum(amplitude_m**2 + 2 * noise_m**2 - mean_m**2, 0.0)
    phase_rad = np.minimum(noise_m / np.maximum(amplitude_m, np.finfo(np.float64).tiny), MAX_PHASE_SD_RAD)
    # The mean of 1/amplitude^2 depends on the few darkest draws: the last percent is clipped.
    phase_rad = np.minimum(phase_rad, np.sort(phase_rad)[int(0.99 * (phase_rad.size - 1))])
    return EstimatorErrors(
        estimator,
        bias_m=float(mean_m.mean() - conditions.amplitude_m),
        quadrature_m=noise_m,
        noise_jitter_m=float(np.sqrt(variance_m2.mean())),
        speckle_jitter_m=float(mean_m.std()),
        phase_jitter_rad=float(np.sqrt(np.mean(phase_rad**2))),
        averaging_factor=float(ratio.mean()),
        relative_variances=relative_variances,
    )


def _rice_mean(amplitude_m: FloatArray, noise_m: float) -> FloatArray:
    """Return the mean of a Rice distribution: the length of a phasor ``amplitude_m`` with noise in both components.

    ``noise_m``: standard deviation of each component.
    """
    if noise_m == 0:
        return amplitude_m
    if not amplitude_m.any():
        return np.full_like(amplitude_m, noise_m * np.sqrt(np.pi / 2))
    x = np.square(amplitude_m / noise_m) / 2
    if x.min() > RICE_SERIES_MIN:
        # sqrt(pi / 2) L_1/2(-x) by its asymptotic series; the remainder is below 1e-16.
        return np.asarray(amplitude_m * (1 + (1 / 4 + (1 / 32 + (3 / 128) / x) / x) / x))
    from scipy.special import ive

    # L_1/2(-x) = exp(-x/2) [(1 + x) I0(x/2) + x I1(x/2)]; ive includes the exponential.
    return np.asarray(noise_m * np.sqrt(np.pi / 2) * ((1 + x) * ive(0, x / 2) + x * ive(1, x / 2)))
