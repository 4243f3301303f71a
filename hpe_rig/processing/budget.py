"""Uncertainty budget of an estimate: the independent sources of error, each as standard uncertainties.

u^2 = sum_i u_i^2 for amplitude and phase alike (Guide to the expression of uncertainty in measurement, 5.1.2), every
u_i being that of the value corrected to the peak displacement. docs/explanation/numbers.md says what each source is.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hpe_rig.arrays import FloatArray
from hpe_rig.bench import twin_of
from hpe_rig.processing.harmonics.harmonic_fit import HarmonicFit
from hpe_rig.result import PHASE_VARIANCE_LIMIT, RECTIFIED, Averaging, Component, Estimate
from hpe_rig.scene import Scene

TINY_M = 1e-30
TRACKED = Averaging(1.0, 0.0, 0.0)
"""Averaging where no beams are known: what is tracked is taken as it is."""
SPECKLE_KURTOSIS = 6.0
"""Kurtosis of the speckle error: fully developed speckle, gate of 1 mm (docs/theory/prediction.md)."""


@dataclass(frozen=True, slots=True)
class Known:
    """What is known of the errors besides a fit: of what the bench does, and of the scale of every displacement.

    Where nothing is said of the sound speed it is as uncertain, relatively, as a scene takes it to be.
    ``trigger_jitter_s``, root mean square, is 0 where nobody states it: it is then within noise, as the residual holds
    both. ``subtracts_jitter``: a reference gate's motion has been subtracted, and the jitter with it. ``gate_edge``:
    relative error of a rigid motion that the gate's ends leave: a gain, which turns no phase. ``rounding_m``: what the
    digitizer's codes leave along and across the phasor of each frequency, nothing where they are fine.
    ``carrier_relative``: by how much the echo's mean frequency is off the carrier that a phase is divided by, where no
    averaging predicts it.
    """

    sound_speed_m_per_s: float = 1540.0
    sound_speed_uncertainty: float = 0.005
    trigger_jitter_s: float = 0.0
    subtracts_jitter: bool = False
    gate_edge: float = 0.0
    rounding_m: tuple[tuple[float, float], ...] = ()
    carrier_relative: float = 0.0

    @property
    def jitter_m(self) -> float:
        """Displacement noise of one pulse by trigger jitter, u = c t / 2."""
        return 0.0 if self.subtracts_jitter else self.sound_speed_m_per_s * self.trigger_jitter_s / 2


def known_of(scene: Scene, simulated: bool) -> Known:
    """Return what ``scene`` says of the errors; a real bench's trigger jitter is not known."""
    twin = twin_of(scene) if simulated else None
    return Known(
        scene.acquisition.sound_speed_m_per_s,
        scene.acquisition.sound_speed_uncertainty,
        0.0 if twin is None else twin.trigger_jitter_s,
    )


def estimates_of(
    fit: HarmonicFit,
    known: Known | None = None,
    averaging: Sequence[Averaging | None] | None = None,
    true_m: FloatArray | None = None,
) -> tuple[Estimate, ...]:
    """Return the estimates of one ``fit`` with their budgets.

    ``averaging`` (frequency,) is what beams and medium make of the peak displacement, None where it is not known;
    ``true_m`` (frequency, 2) the ground truth, A cos(phase) and A sin(phase), NaN or None where it is not known.
    """
    count = fit.frequency_hz.size
    each = averaging if averaging is not None else (None,) * count
    return tuple(_estimate(fit, index, known or Known(), each[index], true_m) for index in range(count))


def _estimate(
    fit: HarmonicFit, index: int, known: Known, averaging: Averaging | None, true_m: FloatArray | None
) -> Estimate:
    # What aliasing is on the mean is taken off the headline alone.
    best = fit if averaging is None or fit.unaliased is None else fit.unaliased
    tracked_m, best_m = float(fit.amplitude_m[index]), float(best.amplitude_m[index])
    is_known = true_m is not None and bool(np.isfinite(true_m[index]).all())
    in_phase_m, quadrature_m = true_m[index] if true_m is not None and is_known else (0.0, 0.0)
    return Estimate(
        frequency_hz=float(fit.frequency_hz[index]),
        amplitude_m=tracked_m,
        amplitude_uncertainty_m=math.sqrt(fit.covariance[index, 0, 0]),
        phase_rad=float(fit.phase_rad[index]),
        phase_uncertainty_rad=math.sqrt(fit.covariance[index, 1, 1]),
        averaging_factor=None if averaging is None else averaging.factor,
        speckle_relative=None if averaging is None else averaging.speckle_relative,
        true_amplitude_m=math.hypot(in_phase_m, quadrature_m) if is_known else None,
        true_phase_rad=math.atan2(quadrature_m, in_phase_m) if is_known else None,
        averaging_phase_rad=None if averaging is None else averaging.phase_rad,
        components=components(best, index, known, averaging or TRACKED),
        aliasing_factor=tracked_m / best_m if tracked_m and best_m else 1.0,
        aliasing_phase_rad=math.remainder(float(fit.phase_rad[index] - best.phase_rad[index]), 2 * math.pi),
        noise_freedom=float(best.freedom),
    )


def components(fit: HarmonicFit, index: int, known: Known, averaging: Averaging) -> tuple[Component, ...]:
    """Return the sources of uncertainty of frequency ``index`` of ``fit``, corrected by ``averaging``."""
    amplitude_m = float(fit.amplitude_m[index])
    peak_m = amplitude_m / averaging.factor
    # Variances of (amplitude, phase): what the pulses' residual says, of which trigger jitter explains a share.
    total = np.diagonal(fit.covariance[index])
    aliasing = np.zeros(2) if fit.aliasing is None else np.diagonal(fit.aliasing[index])
    random = np.maximum(total - aliasing, 0.0)
    residual_m2 = float(fit.residual_rms_m) ** 2
    share = min(known.jitter_m**2 / residual_m2, 1.0) if residual_m2 > 0 else 0.0
    unit = np.array([amplitude_m, 1.0])
    lost = np.array([averaging.factor_uncertainty / averaging.factor, averaging.phase_uncertainty_rad]) * unit
    shared = np.array([averaging.shared_relative, averaging.shared_phase_rad2]) * unit**2
    aliasing, lost = _with_shared(aliasing, lost**2, shared)

    def fitted(source: str, variance: FloatArray, degrees_of_freedom: float = math.inf) -> Component:
        u_m, u_rad = np.sqrt(variance).tolist()
        return Component(source, u_m / averaging.factor, u_rad, degrees_of_freedom)

    def relative(source: str, amplitude: float, phase_rad: float = 0.0) -> Component:
        return Component(source, amplitude * peak_m, phase_rad)

    # Jitter is stated, noise is the rest of the residual's variance. These degrees of freedom of noise make those of
    # both together (Welch-Satterthwaite) equal to the residual's.
    nu = float(fit.freedom)
    noise_nu, jitter_nu = (nu * (1 - share) ** 2, math.inf) if share < 1 else (nu, nu)
    rounding = np.array(known.rounding_m[index] if known.rounding_m else (0.0, 0.0)) / (1.0, max(amplitude_m, TINY_M))
    off_carrier = averaging.carrier_relative or known.carrier_relative
    carrier = (relative("carrier", off_carrier),) if off_carrier else ()
    shape = (relative("beam shape", averaging.shape_relative),) if averaging.shape_relative else ()
    return (
        fitted("noise", random * (1 - share), noise_nu),
        fitted("trigger jitter", random * share, jitter_nu),
        Component(RECTIFIED, math.sqrt(fit.rectified_m2[index]) / averaging.factor, 0.0, nu),
        fitted("quantisation", np.minimum(rounding**2, (np.inf, PHASE_VARIANCE_LIMIT))),
        fitted("aliasing", aliasing),
        relative("speckle", averaging.speckle_relative, averaging.speckle_phase_rad),
        fitted("beam averaging", lost),
        relative("gate edge", known.gate_edge),
        relative("sound speed", known.sound_speed_uncertainty),
        relative("gate off focus", averaging.offset_relative),
        *carrier,
        *shape,
    )


def with_second_order_speckle(averaging: Averaging) -> Averaging:
    """Return ``averaging`` with the second-order effect of speckle on the amplitude added to ``speckle_relative``.

    The tracked phasor is (1 + x + j t) times its mean. A relative error t across it also raises the amplitude by t^2/2.
    Its root mean square is sqrt(k) u^2 / 2, with u the standard deviation and k the kurtosis of t. Both orders are
    added as independent errors.
    """
    second_order = math.sqrt(SPECKLE_KURTOSIS) / 2 * averaging.speckle_phase_rad**2
    return replace(averaging, speckle_relative=math.hypot(averaging.speckle_relative, second_order))


def _with_shared(aliasing: FloatArray, lost: FloatArray, shared: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the variances of aliasing and beam averaging whose sum has what they share, a covariance, in it.

    Both are errors about the medium. What beam averaging adds to aliasing is its own; where it makes the sum smaller,
    aliasing is.
    """
    most = np.sqrt(aliasing * lost)
    added = lost + 2 * np.clip(shared, -most, most)
    return aliasing + np.minimum(added, 0.0), np.maximum(added, 0.0)
