"""Harmonic fit of one shot: options and prior from the scene, the fit, and the beam averaging that the fit implies."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hpe_rig.arrays import FloatArray
from hpe_rig.medium import BeamWidths, RigidSphere
from hpe_rig.plan import Selection, Shot, select
from hpe_rig.processing.budget import with_second_order_speckle
from hpe_rig.processing.estimators import Harmonic, Options, fit_motion, spec_of
from hpe_rig.processing.harmonics.drift import MAX_ITERATIONS, Drift, drift_of
from hpe_rig.processing.harmonics.harmonic_fit import HarmonicFit, MediumPosterior
from hpe_rig.processing.harmonics.medium_prior import MediumPrior, medium_prior
from hpe_rig.processing.harmonics.model import LinearModel, linear_model
from hpe_rig.processing.motion.displacement import Motion
from hpe_rig.processing.shot_tracking import WindowMotion
from hpe_rig.result import Averaging
from hpe_rig.scene import Processing, Scene


@dataclass(frozen=True, slots=True)
class HarmonicFitter:
    """The harmonic fit of an estimator as a function of the displacement; equal for equal settings, hence cacheable."""

    wanted_hz: tuple[float, ...]
    estimator: str
    driven_hz: tuple[float, ...]
    options: Options

    @classmethod
    def of(cls, selection: Selection, estimator: str, options: Options) -> HarmonicFitter:
        """Return the fit, as a function of a displacement, of the frequencies and pulses of ``selection``."""
        return cls(
            wanted_hz=tuple(selection.wanted_hz.tolist()),
            estimator=estimator,
            driven_hz=tuple(selection.driven_hz.tolist()),
            options=options,
        )

    def __call__(self, motion: Motion) -> HarmonicFit:
        """Return amplitude and phase of ``motion`` at the wanted frequencies."""
        return fit_motion(motion, self.wanted_hz, self.estimator, self.driven_hz, self.options)


def shot_drift(
    motion: WindowMotion, selection: Selection, options: Options, max_iterations: int = MAX_ITERATIONS
) -> Drift:
    """Return the change of a shot's ``motion`` over the window; raise ``ValueError`` if it cannot be fitted.

    The change is estimated from the coherent displacement if there is one, since it has least noise, else from the
    tracked displacement. Supply the prior of media in ``options.prior`` if one is available, even if the harmonic fit
    of the shot does not use it: it models the harmonics of tonebursts that would otherwise look like a drift.
    """
    return drift_of(
        motion.tracked if motion.coherent is None else motion.coherent,
        selection.wanted_hz,
        # The tonebursts push at all these harmonics of their rate, wanted or not.
        also_hz=selection.driven_hz,
        background_order=options.background_order,
        prior=options.prior,
        max_iterations=max_iterations,
    )


def options_of(processing: Processing, prior: MediumPrior | None = None) -> Options:
    """Return the options of the harmonic fit that the scene's [processing] selects.

    The default is a fit with the ``prior`` of media if there is one, else least squares. With a linear drift the mean
    displacement under the bursts drifts too, so that the background is at least linear.
    """
    default: Harmonic = "least_squares" if prior is None else "medium_prior"
    harmonic = default if processing.harmonic in (None, "medium_prior") else processing.harmonic
    return Options(
        background_order=max(processing.background_order, int(processing.drift == "linear")),
        harmonic=harmonic,
        process_noise=processing.process_noise,
        prior=prior,
    )


def shot_prior(scene: Scene, shot: Shot, estimator: str, beams: BeamWidths | None) -> MediumPrior | None:
    """Return the prior that the fit of the shot uses: the motions that media can have.

    None if the scene asks for least squares or process noise, the estimator takes no prior, or none is available.
    """
    if not spec_of(estimator).takes_prior:
        return None
    if scene.processing.harmonic == "least_squares" or scene.processing.process_noise:
        return None
    return available_prior(scene, shot, beams)


def available_prior(scene: Scene, shot: Shot, beams: BeamWidths | None) -> MediumPrior | None:
    """Return the prior of the motions that media can have under the shot's tonebursts; None if there is none.

    It is returned whether or not the fit uses it. The tonebursts push a rigid sphere or, through ``beams``, the tissue.
    Without a declared medium the prior covers all media of its ensemble.
    """
    length_s, excitation, medium = shot.timeline.burst_length_s, scene.excitation, scene.medium
    sphere = None if scene.sphere is None else RigidSphere(scene.sphere.radius_m, scene.sphere.density_kg_per_m3)
    pushed = sphere or beams
    if pushed is None or excitation is None or shot.is_control or not length_s or scene.without_prior is not None:
        return None
    if medium is None:
        return medium_prior(pushed, excitation.burst_rate_hz, length_s)
    known_medium = medium.shear_modulus_pa, medium.shear_viscosity_pa_s
    return medium_prior(pushed, excitation.burst_rate_hz, length_s, known_medium, medium.density_kg_per_m3)


def shot_model(scene: Scene, shot: Shot, with_driven: bool = True) -> tuple[FloatArray, LinearModel]:
    """Return the times (pulse,) of the pulses that the fit of ``shot`` uses, and the model fitted to them.

    The pulses are those of the plan, with no record missing. ``with_driven``: fit the further driven frequencies as
    well. Raises ``ValueError`` if the pulses do not resolve the wanted frequencies.
    """
    selection = select(scene, shot)
    model = linear_model(
        selection.time_s,
        selection.used,
        selection.wanted_hz,
        background_order=scene.processing.background_order,
        also_hz=selection.driven_hz if with_driven else (),
    )
    return selection.time_s[selection.used], model


def shot_averaging(
    scene: Scene, fit: HarmonicFit, predicted: tuple[Averaging | None, ...]
) -> tuple[Averaging | None, ...]:
    """Return the beam averaging (frequency,) of a shot: tracked over peak displacement.

    ``predicted``: that of the scene before the measurement. It is returned if the scene declares the medium; otherwise
    the fit with a prior has narrowed down the medium, and the averaging is that of the remaining media.
    """
    if scene.medium is not None or fit.medium is None:
        return predicted
    medium = fit.medium
    return tuple(
        averaging if averaging is None else posterior_averaging(medium, index, averaging)
        for index, averaging in enumerate(predicted)
    )


def posterior_averaging(medium: MediumPosterior, index: int, predicted: Averaging) -> Averaging:
    """Return the beam averaging (tracked over peak displacement) of frequency ``index``, given the measured motion.

    ``medium``: posterior of the medium, with means over the media that the motion leaves probable. ``predicted``: the
    averaging before the measurement. Speckle changes the area of the tracking beam: its effect is the standard
    deviation of log area times the rms change of the motion with log area (``steepness``).
    """
    # Tracked over peak displacement in those media, with the standard uncertainty of its magnitude and phase.
    rule, ratio = predicted.rule, 1 / complex(medium.peak_over_tracked[index])
    relative, phase_rad = np.sqrt(np.diag(medium.peak_covariance[index])).tolist()
    speckle_relative, speckle_phase_rad = (rule.region_sd * medium.steepness[index]).tolist()
    # Few speckles scale the deficit 1 - |ratio|; the geometry (gate off focus, oblique waves) adds factor and phase.
    factor = (1 - rule.deficit_scale * (1 - abs(ratio))) * rule.geometry_factor
    averaging = replace(
        predicted,
        factor=factor,
        phase_rad=float(np.angle(ratio)) + rule.geometry_phase_rad,
        speckle_relative=speckle_relative,
        speckle_phase_rad=speckle_phase_rad,
        factor_uncertainty=factor * relative,
        phase_uncertainty_rad=phase_rad,
        shared_relative=float(medium.aliasing_covariance[index, 0]),
        shared_phase_rad2=float(medium.aliasing_covariance[index, 1]),
    )
    return with_second_order_speckle(averaging)


def carrier_error(motion: Motion, reference: Motion | None) -> float:
    """Return the relative amplitude error of a ``motion`` that was converted from phase with the carrier; at most 1.

    Speckle shifts the echo's mean frequency from the carrier. ``reference`` is the same motion converted with the mean
    frequency. The error is the regression coefficient of ``motion`` on it, minus 1; 0 without a reference.
    """
    if reference is None:
        return 0.0
    common = motion.valid & reference.valid
    by_carrier, by_echo = (
        version.displacement_m[common] - version.displacement_m[common].mean() for version in (motion, reference)
    )
    energy = float(by_echo @ by_echo)
    return min(abs(float(by_carrier @ by_echo) / energy - 1), 1.0) if energy > 0 else 0.0
