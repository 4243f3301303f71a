"""Beam averaging of a scene: tracked over peak displacement at every wanted frequency, with its uncertainty.

    factor = 1 - deficit_scale (1 - |ratio|)
    deficit_scale = (1 - Gaussian in this gate) / (1 - Gaussian, dense limit)

The ratio is that of the shear field in the declared medium, else its mean over the ensemble of media. Few speckles and
scatterers change the deficit 1 - |ratio| in proportion to that of a Gaussian motion. Corrections follow for a force
that is not Gaussian, oblique waves, and a gate off the focus. Without tonebursts the motion is Gaussian, eq. (12) of
the paper.
"""

from __future__ import annotations

import cmath
from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

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


class AveragingRatio(NamedTuple):
    """Tracked over peak motion ``ratio`` (frequency,), its scatter over media, and its change with speckle.

    ``deviation`` and ``steepness`` have relative amplitude as real part and phase (rad) as imaginary part.
    ``deviation``: standard deviation over media. ``steepness``: relative change per unit of the logarithm of the
    tracking beam's area, which speckle changes. Off the axis it is the root sum of squares with the change per unit of
    the beam's offset relative to its radius, which speckle changes as much.
    """

    ratio: ComplexArray
    deviation: ComplexArray
    steepness: ComplexArray


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
    # A Gaussian motion with the widths of the force: its factor among few scatterers, and the relative standard
    # deviations over speckle of the tracked displacement and of the echo's mean frequency.
    factor = beam_averaging_factor(beams.force_width_m, tracking_gate(scene, estimator), resting.scatterers_per_m3)
    speckle_sd, frequency_sd = speckle_spread(resting, estimator)
    gaussian = Averaging(factor, phase_rad=0.0, speckle_relative=speckle_sd, carrier_relative=frequency_sd)
    if scene.excitation is None:
        return (_with_scene_offsets(scene, gaussian),) * frequency_hz.size
    averagings = _with_few_scatterers(averaging_ratio(scene, beams, frequency_hz), beams, gaussian)
    corrections = _aperture_correction(scene, beams, frequency_hz)
    return tuple(
        _multiplied(_with_scene_offsets(scene, with_second_order_speckle(averaging)), correction)
        for averaging, correction in zip(averagings, corrections, strict=True)
    )


def _with_few_scatterers(dense: AveragingRatio, beams: BeamWidths, gaussian: Averaging) -> Iterator[Averaging]:
    """Yield the averaging at every frequency of ``dense``, corrected for few scatterers and with the effect of speckle.

    ``dense``: tracked over peak motion under tonebursts if scatterers are infinitely many. ``gaussian``: averaging of a
    Gaussian motion with the widths of the force, already with few scatterers and speckle.
    """
    # Few scatterers are assumed to change the deficit 1 - ratio by the same factor as for the Gaussian motion.
    deficit_scale = (1 - gaussian.factor) / (1 - beams.gaussian_averaging())
    factor = 1 - deficit_scale * (1 - np.abs(dense.ratio))
    # Standard deviation over speckle of ln(area of the tracked region) and of the region's offset over its radius: both
    # are 1 / sqrt(N) for N equal echoes. For the Gaussian motion it times the steepness, d ln(ratio) / d ln(area), is
    # the effect of speckle; this gives it.
    region_sd = gaussian.speckle_relative / -beams.gaussian_steepness()
    # Effect of speckle on this motion: relative amplitude as real part, phase as imaginary part.
    by_speckle = region_sd * dense.steepness
    phase_rad = np.angle(dense.ratio)
    for i in range(dense.ratio.size):
        yield Averaging(
            factor=float(factor[i]),
            phase_rad=float(phase_rad[i]),
            speckle_relative=float(np.abs(by_speckle[i].real)),
            speckle_phase_rad=float(np.abs(by_speckle[i].imag)),
            factor_uncertainty=float(factor[i] * dense.deviation[i].real),
            phase_uncertainty_rad=float(dense.deviation[i].imag),
            carrier_relative=gaussian.carrier_relative,
            # A fit that narrows down the medium repeats this computation with its own ratio.
            rule=AveragingRule(region_sd=region_sd, deficit_scale=deficit_scale),
            steepness=complex(dense.steepness[i]),
        )


def averaging_ratio(scene: Scene, beams: BeamWidths, frequency_hz: FloatArray) -> AveragingRatio:
    """Return tracked over peak motion at ``frequency_hz``, its standard deviation over media and change by speckle.

    They are those of the medium that the scene declares, without deviation, else statistics over the media of the
    prior. The medium of the twin is not used, as it is not known on a real bench.
    """
    medium = medium_of(scene, frequency_hz, simulated=False)
    if medium is None:
        return _ensemble_ratio(scene, beams, frequency_hz)
    tracked, peak, derivatives = tracked_motion(medium, beams)
    return AveragingRatio(tracked / peak, np.zeros_like(tracked), _sum_of_effects(derivatives / tracked))


def _ensemble_ratio(scene: Scene, beams: BeamWidths, frequency_hz: FloatArray) -> AveragingRatio:
    """Return mean, standard deviation and change by speckle of tracked over peak motion, over the media of the prior.

    Mean and standard deviation are those of the logarithm of the ratio: its real part is relative amplitude, its
    imaginary part is phase. The change by speckle is a root mean square with the sign of the mean.
    """
    assert scene.excitation is not None  # noqa: S101 (callers check)
    ensemble = _prior_ensemble(scene, beams, frequency_hz)
    # From the nodes to the wanted frequencies: motion of every medium (member, frequency), and the derivatives (effect,
    # member, frequency) of the tracked motion by the area and the offset of the tracking beam.
    to_wanted = ensemble.interpolation(frequency_hz).T
    tracked, peak, derivatives = (nodes @ to_wanted for nodes in (ensemble.tracked, ensemble.peak, ensemble.steepness))
    # All media are driven to the same rms motion, so a medium that hardly moves at a frequency has little weight there.
    burst_rate_hz = scene.excitation.burst_rate_hz
    harmonics = round(harmonic_range_hz(burst_rate_hz)[1] / burst_rate_hz)
    spectrum = ensemble.driven_spectrum(harmonics, burst_rate_hz, scene.excitation.burst_length_s[0])
    driven = ensemble.tracked @ spectrum.T
    power = np.abs(tracked) ** 2 / np.sum(np.abs(driven) ** 2, axis=1, keepdims=True)
    steepness = bounded_steepness(derivatives / tracked, power / power.mean(axis=0))

    def rms(values: FloatArray) -> FloatArray:
        """Return the root mean square over members (effect, member, frequency), with the signs of the means."""
        return np.asarray(np.copysign(np.sqrt(np.mean(values**2, axis=1)), values.mean(axis=1)))

    log_ratio = np.log(tracked / peak)
    return AveragingRatio(
        ratio=np.exp(log_ratio.mean(axis=0)),
        deviation=log_ratio.real.std(axis=0) + 1j * log_ratio.imag.std(axis=0),
        steepness=_sum_of_effects(np.asarray(rms(steepness.real) + 1j * rms(steepness.imag))),
    )


def _sum_of_effects(steepness: ComplexArray) -> ComplexArray:
    """Return the root sum of squares (frequency,) of the independent effects of speckle, with the first one's sign.

    ``steepness`` (effect, frequency): relative change of the tracked motion with the tracking beam's area and, off the
    axis, with its offset. Real part (amplitude) and imaginary part (phase) are summed separately.
    """
    amplitude, phase = (
        np.copysign(np.linalg.norm(change, axis=0), change[0]) for change in (steepness.real, steepness.imag)
    )
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


def _multiplied(averaging: Averaging, correction: complex, **uncertainties: float) -> Averaging:
    """Return ``averaging`` with tracked over peak displacement multiplied by the complex ``correction``.

    The rule, which gives the averaging of another medium, is multiplied too. ``uncertainties``: of the correction, by
    their field in ``Averaging``.
    """
    size, angle = abs(correction), cmath.phase(correction)
    rule = replace(
        averaging.rule,
        geometry_factor=averaging.rule.geometry_factor * size,
        geometry_phase_rad=averaging.rule.geometry_phase_rad + angle,
    )
    factor, phase_rad = averaging.factor * size, averaging.phase_rad + angle
    return replace(averaging, factor=factor, phase_rad=phase_rad, rule=rule, **uncertainties)


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
    return _multiplied(averaging, obliquity, shape_relative=SHAPE_RELATIVE)


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
    return _multiplied(averaging, factor, offset_relative=factor_sd)


def obliquity_factor(diameter_m: float, focal_length_m: float) -> float:
    """Return the factor on the echo delay 2 u / c of a displacement u by the oblique waves of a focused bowl.

    Waves from a bowl reach the focus at all angles up to its half angle: their mean cosine is below 1. The factor is a
    mean over the focal plane, weighted by echo energy (docs/explanation/transducer.md, section 2).
    """
    sine = min(diameter_m / 2 / focal_length_m, 1.0)
    loss_on_axis = (1 - np.sqrt(1 - sine**2)) / 2
    return float(1 - OBLIQUITY_FOCAL_PLANE_MEAN * loss_on_axis)


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
