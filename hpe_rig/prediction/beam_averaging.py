"""Beam averaging of a scene: tracked over peak displacement at every wanted frequency, with its uncertainty.

    factor = 1 - loss_scale (1 - |ratio|),    loss_scale = (1 - Gaussian in this gate) / (1 - Gaussian, dense limit)

The ratio is that of the shear field in the declared medium, else its mean over the ensemble of media. Few speckles and
scatterers change the loss in proportion to that of a Gaussian motion. Corrections follow for a force that is not
Gaussian, oblique waves, and a gate off the focus. Without tonebursts the motion is Gaussian, eq. (12) of the paper.
"""

from __future__ import annotations

import cmath
from dataclasses import replace

import numpy as np

from hpe_rig.arrays import ComplexArray, FloatArray
from hpe_rig.medium import (
    BeamWidths,
    Ensemble,
    HarmonicMedium,
    PushForce,
    beam_averaging_factor,
    medium_ensemble,
    tracked_motion,
    tracked_ratio,
)
from hpe_rig.prediction.conditions import resting_conditions
from hpe_rig.prediction.scene_physics import TYPICAL_VOIGT, beam_widths, medium_of, push_force, tracking_gate
from hpe_rig.prediction.speckle_spread import speckle_spread
from hpe_rig.processing import bounded_steepness, harmonic_range_hz, with_second_order_speckle
from hpe_rig.result import Averaging, AveragingRule
from hpe_rig.scene import Scene

OBLIQUITY_FOCAL_PLANE_MEAN = 0.913
"""Obliquity loss averaged over the focal plane with echo energy as weight, relative to the loss on the axis.

It does not depend on the aperture (docs/explanation/transducer.md, section 2)."""
SHAPE_RELATIVE = 0.004
"""Relative difference of the tracked displacement between beams of an aperture and Gaussians of equal echo energy.

From scripts/validation/aperture.py."""


AveragingRatio = tuple[ComplexArray, ComplexArray, ComplexArray]
"""Tracked over peak motion (frequency,), its standard deviation over media, and its steepness.

The steepness is the ratio's relative change per unit of the logarithm of the tracking beam's area. Off the axis it is
the root sum of squares with the change per unit of the beam's offset relative to its radius.
Deviation and steepness are pairs of real numbers: relative amplitude as real part, phase (rad) as imaginary part. Over
the ensemble the ratio is the exponential of its mean logarithm, the steepness a root mean square with the sign of the
mean."""


def predicted_averaging(
    scene: Scene, estimator: str, offsets_of_joint_fit_m: tuple[float, ...] = ()
) -> tuple[Averaging | None, ...]:
    """Return, for every wanted frequency, the predicted ratio of tracked to peak displacement, with its uncertainties.

    None for each if the scene has neither beams nor a sphere. ``check``, report, design and the error budget of a
    result use this one prediction. ``offsets_of_joint_fit_m``: all lateral offsets of a run, so that the random media
    of the prediction are computed once for all of them.
    """
    frequency_hz = np.array(scene.wanted_frequencies_hz)
    if scene.sphere is not None:
        # A sphere moves as a whole: all of its motion is tracked.
        return (Averaging(1.0, 0.0, 0.0),) * frequency_hz.size
    beams, resting = beam_widths(scene, estimator, offsets_of_joint_fit_m), resting_conditions(scene)
    if beams is None or resting is None:
        return (None,) * frequency_hz.size
    # A Gaussian motion: its ratio with few scatterers is known, and the relative standard deviations over speckle of
    # the tracked displacement and of the echo's mean frequency (0 for estimators that do not divide by the carrier).
    gaussian = beam_averaging_factor(beams.force_width_m, tracking_gate(scene, estimator), resting.scatterers_per_m3)
    speckle_sd, carrier_sd = speckle_spread(resting, estimator)
    if scene.excitation is None:
        gaussian_motion = Averaging(gaussian, 0.0, speckle_sd, carrier_relative=carrier_sd)
        return (_with_scene_offsets(scene, gaussian_motion),) * frequency_hz.size
    # The random media assume dense scatterers. Sparse scatterers change 1 - ratio; the same relative change as for a
    # Gaussian motion is assumed.
    loss_scale = (1 - gaussian) / (1 - beams.gaussian_averaging())
    # Speckle changes the tracked region: the logarithm of its area and, off the axis, its offset over its radius.
    # Both have this standard deviation: for N equal echoes 1 / sqrt(N), as the centroid over the radius, and the
    # variance x² + y² relative to its mean. ``steepness`` is the relative change of the ratio per unit of them.
    region_sd = speckle_sd / -beams.gaussian_steepness()
    ratio, deviation, steepness = averaging_ratio(scene, beams, frequency_hz)
    factor = 1 - loss_scale * (1 - np.abs(ratio))
    # Fields of ``Averaging``, (frequency,).
    columns = {
        "factor": factor,
        "phase_rad": np.angle(ratio),
        "speckle_relative": np.abs((region_sd * steepness).real),
        "factor_uncertainty": factor * deviation.real,
        "phase_uncertainty_rad": deviation.imag,
        "speckle_phase_rad": np.abs((region_sd * steepness).imag),
    }
    # For a posterior over media, whose ratio replaces this one.
    rule = AveragingRule(area_spread=region_sd, loss_scale=loss_scale)
    averagings = (
        Averaging(
            **{name: float(column[i]) for name, column in columns.items()},
            carrier_relative=carrier_sd,
            rule=rule,
            steepness=complex(steepness[i]),
        )
        for i in range(frequency_hz.size)
    )
    corrections = _aperture_correction(scene, beams, frequency_hz)
    return tuple(
        _times(_with_scene_offsets(scene, with_second_order_speckle(averaging)), correction)
        for averaging, correction in zip(averagings, corrections, strict=True)
    )


def averaging_ratio(scene: Scene, beams: BeamWidths, frequency_hz: FloatArray) -> AveragingRatio:
    """Return tracked over peak motion (frequency,), its standard deviation over media, and its steepness.

    The steepness is the relative change per unit of the logarithm of the tracking beam's area. Deviation and steepness
    have relative amplitude as real part and phase (rad) as imaginary part. All are those of the declared medium,
    without deviation, else statistics over the ensemble of media.
    """
    # Only a medium that the scene declares: the medium set in the twin is not known on a real bench.
    medium = medium_of(scene, frequency_hz, simulated=False)
    if medium is None:
        return _ensemble_ratio(scene, beams, frequency_hz)
    tracked, peak, by_speckle = tracked_motion(medium, beams)
    return tracked / peak, np.zeros_like(tracked), _of_both_effects(by_speckle / tracked)


def _ensemble_ratio(scene: Scene, beams: BeamWidths, frequency_hz: FloatArray) -> AveragingRatio:
    """Return tracked over peak motion (frequency,), its deviation and its steepness, over the media of the prior.

    Mean and standard deviation are those of the logarithm of the ratio: its real part is relative amplitude, its
    imaginary part is phase. The steepness, the relative change per unit of the logarithm of the tracking beam's area,
    is a root mean square with the sign of the mean.
    """
    assert scene.excitation is not None  # noqa: S101 (callers check)
    ensemble = _prior_ensemble(scene, beams, frequency_hz)
    # Motion of every medium at the wanted frequencies, (member, frequency).
    to_wanted = ensemble.interpolation(frequency_hz).T
    tracked, peak, by_speckle = (nodes @ to_wanted for nodes in (ensemble.tracked, ensemble.peak, ensemble.steepness))
    # All media are driven to the same rms motion, so a medium that hardly moves at a frequency has little weight there.
    burst_rate_hz = scene.excitation.burst_rate_hz
    harmonics = round(harmonic_range_hz(burst_rate_hz)[1] / burst_rate_hz)
    spectrum = ensemble.driven_spectrum(harmonics, burst_rate_hz, scene.excitation.burst_length_s[0])
    driven = ensemble.tracked @ spectrum.T
    power = np.abs(tracked) ** 2 / np.sum(np.abs(driven) ** 2, axis=1, keepdims=True)
    steepness = bounded_steepness(by_speckle / tracked, power / power.mean(axis=0))
    log_ratio = np.log(tracked / peak)

    def rms(values: FloatArray) -> FloatArray:
        """Return the root mean square over members (effect, member, frequency), with the signs of the means."""
        return np.asarray(np.copysign(np.sqrt(np.mean(values**2, axis=1)), values.mean(axis=1)))

    deviation = log_ratio.real.std(axis=0) + 1j * log_ratio.imag.std(axis=0)
    rms_steepness = np.asarray(rms(steepness.real) + 1j * rms(steepness.imag))
    return np.exp(log_ratio.mean(axis=0)), deviation, _of_both_effects(rms_steepness)


def _of_both_effects(steepness: ComplexArray) -> ComplexArray:
    """Return the root sum of squares over the effects of ``steepness`` (effect, frequency), with the first one's sign.

    Real part (amplitude) and imaginary part (phase) are summed each by itself.
    """
    amplitude, phase = (np.copysign(np.linalg.norm(part, axis=0), part[0]) for part in (steepness.real, steepness.imag))
    return np.asarray(amplitude + 1j * phase)


def _prior_ensemble(scene: Scene, beams: BeamWidths, frequency_hz: FloatArray) -> Ensemble:
    """Return the responses of the prior's media over the range of the harmonics.

    On the beam axis the range is widened to include ``frequency_hz``.
    """
    assert scene.excitation is not None  # noqa: S101 (callers check)
    lowest_hz, highest_hz = harmonic_range_hz(scene.excitation.burst_rate_hz)
    if beams.lateral_offset_m:
        # Off the axis the first nodes are the harmonics themselves, so that the range is fixed.
        return medium_ensemble(beams, lowest_hz, highest_hz)
    return medium_ensemble(beams, min(lowest_hz, float(frequency_hz.min())), max(highest_hz, float(frequency_hz.max())))


def _aperture_correction(scene: Scene, beams: BeamWidths, frequency_hz: FloatArray) -> list[complex]:
    """Return, for each frequency, tracked over peak motion with the true shape of the force over that with a Gaussian.

    The medium is the declared one, else a typical one. The paper's aperture has 1.005 at 100 Hz and less above,
    and 0.1 deg of lag at all frequencies, nearly independent of the medium.
    """
    # The ensemble has the tracked over peak ratio of a Gaussian force; the correction is that of one medium.
    force = push_force(scene)
    if force.is_gaussian:
        return [1.0 + 0j] * frequency_hz.size
    typical = HarmonicMedium.voigt(*TYPICAL_VOIGT, frequency_hz)
    medium = medium_of(scene, frequency_hz, simulated=False) or typical
    shaped, gaussian = (
        tracked_ratio(medium, shape, beams).tolist() for shape in (force, PushForce.gaussian(beams.force_width_m))
    )
    return [ratio / reference for ratio, reference in zip(shaped, gaussian, strict=True)]


def _times(averaging: Averaging, correction: complex, **errors: float) -> Averaging:
    """Return ``averaging`` with ratio and rule multiplied by the complex ``correction``, and with ``errors`` set.

    ``errors``: uncertainties of the correction, fields of ``Averaging`` by name.
    """
    size, angle = abs(correction), cmath.phase(correction)
    rule = replace(
        averaging.rule,
        geometry_factor=averaging.rule.geometry_factor * size,
        geometry_phase_rad=averaging.rule.geometry_phase_rad + angle,
    )
    factor, phase_rad = averaging.factor * size, averaging.phase_rad + angle
    return replace(averaging, factor=factor, phase_rad=phase_rad, rule=rule, **errors)


def _with_scene_offsets(scene: Scene, averaging: Averaging) -> Averaging:
    """Return ``averaging`` with the oblique waves of the declared aperture and the gate's offset from the focus."""
    return _with_focus_offset(scene, _with_obliquity(scene, averaging))


def _with_obliquity(scene: Scene, averaging: Averaging) -> Averaging:
    """Return ``averaging`` times ``obliquity_factor`` of the declared aperture; unchanged if none is declared.

    A declared aperture also adds the uncertainty ``SHAPE_RELATIVE``, because its beam is not Gaussian.
    """
    if scene.beams is None or scene.beams.transducer_diameter_m is None:
        return averaging
    focus_m = scene.beams.focus_depth_m or scene.acquisition.gate_depth_m
    obliquity = obliquity_factor(scene.beams.transducer_diameter_m, focus_m)
    return _times(averaging, obliquity, shape_relative=SHAPE_RELATIVE)


def _with_focus_offset(scene: Scene, averaging: Averaging) -> Averaging:
    """Return ``averaging`` for a gate off the declared focus; unchanged if neither focus nor offset is declared.

    A gate aligned to the focus by its echoes stays there for any sound speed. A gate placed by its depth is off by the
    error of the sound speed.
    """
    if scene.beams is None or (scene.beams.focus_depth_m is None and not scene.tracking.axial_offset_m):
        return averaging
    gate_m, focus_m = scene.gate_depth_m, scene.beams.focus_depth_m
    relative_uncertainty = scene.acquisition.sound_speed_uncertainty
    if focus_m is None:
        # Aligned by its echoes, then moved by a known distance.
        focus_m, relative_uncertainty = scene.acquisition.gate_depth_m, 0.0
    width_m = scene.beams.excitation_width_m[2]
    factor, factor_sd = axial_offset_factor(gate_m - focus_m, gate_m * relative_uncertainty, width_m)
    return _times(averaging, factor, offset_relative=factor_sd)


def obliquity_factor(diameter_m: float, focal_length_m: float) -> float:
    """Return the echo delay of a displacement u in a focused beam over 2 u / c, weighted by echo energy.

    Waves from a bowl reach the focus at all angles up to its half angle: their mean cosine is below 1.
    docs/explanation/transducer.md, section 2.
    """
    sine = min(diameter_m / 2 / focal_length_m, 1.0)
    return float(1 - OBLIQUITY_FOCAL_PLANE_MEAN * (1 - np.sqrt(1 - sine**2)) / 2)


def axial_offset_factor(offset_m: float, uncertainty_m: float, width_m: float) -> tuple[float, float]:
    """Return displacement at ``offset_m`` along the beam over that at the focus, and its relative uncertainty.

    The force, of sigma ``width_m`` along the beam, is much longer than wide: the displacement follows it as d(z) =
    exp(-z^2 / 2 E_z^2), E_z = ``width_m``. The uncertainty is the rms of d(z) / d(offset) - 1 over z normal about
    ``offset_m`` with standard deviation ``uncertainty_m``. It also holds at the focus, where the slope of d vanishes.
    """
    factor = np.exp(-(offset_m**2) / (2 * width_m**2))

    def moment(order: int) -> float:
        """Return the mean of d(z)^order."""
        variance_m2 = width_m**2 + order * uncertainty_m**2
        return float(width_m / np.sqrt(variance_m2) * np.exp(-order * offset_m**2 / (2 * variance_m2)))

    mean_square = moment(2) - 2 * factor * moment(1) + factor**2
    return float(factor), float(np.sqrt(max(mean_square, 0.0)) / factor)
