"""Amplitude and phase from echoes by any estimator: echoes -> displacement of each pulse -> harmonics.

``estimate`` does both steps, ``motion_of`` the first and ``fit_motion`` the second. ``spec_of`` returns an estimator
with its functions and properties, from the table of this package or from another package.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache, wraps
from pkgutil import resolve_name
from typing import Any, Literal

import numpy as np

from hpe_rig.arrays import ComplexArray, FloatArray
from hpe_rig.extensions import ESTIMATORS as ENTRY_POINTS, TIMEOUT_S, VALUES_PER_S, ExtensionError, call, load, origin
from hpe_rig.processing.echo.band import Band
from hpe_rig.processing.echo.gate import EchoGate
from hpe_rig.processing.harmonics.harmonic_fit import HarmonicFit, least_squares
from hpe_rig.processing.harmonics.kalman_filter import kalman
from hpe_rig.processing.harmonics.medium_fit import medium_fit, medium_kalman
from hpe_rig.processing.harmonics.medium_prior import MediumPrior
from hpe_rig.processing.harmonics.velocity_chain import velocity_to_harmonics
from hpe_rig.processing.motion.displacement import Motion, velocity_between_pulses
from hpe_rig.scene import (
    BUILT_IN_ESTIMATORS,
    Estimator,
    EstimatorProperties,
    checked_estimator,
    estimator_names,
)

ESTIMATORS: tuple[Estimator, ...] = estimator_names()
"""Names of all estimators, those of other packages last."""
Harmonic = Literal["medium_prior", "least_squares", "kalman"]
Frequencies = FloatArray | Sequence[float]


@dataclass(frozen=True, slots=True)
class Options:
    """Settings of the harmonic fit.

    ``background_order``: polynomial fitted with the harmonics (0 constant, 1 velocity, 2 acceleration, more: drift).
    ``process_noise``, for "kalman" only: variance of a harmonic state's change per pulse over that of the pulse noise.
    ``prior``: motions that media can make under the tonebursts, for "medium_prior", and for "kalman" without process
    noise. The paper's chain uses the background order only: it has its own Kalman filter and band-pass.
    """

    background_order: int = 0
    harmonic: Harmonic = "least_squares"
    process_noise: float = 0.0
    prior: MediumPrior | None = None


PLAIN = Options()
MAX_VALUE = 10.0
"""Largest displacement (m) and phase (rad) of another package that is possible."""


FitMotion = Callable[[Motion, Frequencies, Frequencies, Options], HarmonicFit]
"""Function from displacement per pulse, wanted and further driven frequencies to amplitude and phase."""


@dataclass(frozen=True, slots=True)
class EstimatorSpec(EstimatorProperties):
    """An estimator: its functions, and the properties that determine its predicted noise.

    ``motion``: echoes to displacement per pulse.
    ``band_phase``: phase, its variance and the mean frequency from spectra in the band; the last argument asks for the
    compiled loop. Studies of many realisations use it instead of ``motion``.
    ``fit_motion``: displacement to amplitude and phase; None for the fit that the options choose, or for the paper's
    chain if ``velocity_chain`` is set.
    """

    motion: Callable[[EchoGate], Motion]
    band_phase: Callable[[ComplexArray, Band, bool], tuple[FloatArray, FloatArray, FloatArray]] | None = None
    fit_motion: FitMotion | None = None

    @property
    def takes_prior(self) -> bool:
        """Whether the options choose the fit, which then uses a prior of media if there is one."""
        return self.fit_motion is None and not self.velocity_chain


def estimate(
    echoes: EchoGate,
    frequencies_hz: Frequencies,
    estimator: str = "coherent",
    also_hz: Frequencies = (),
    options: Options = PLAIN,
) -> HarmonicFit:
    """Return amplitude and phase of the motion at every frequency, from all valid pulses.

    ``also_hz``: further frequencies of the motion, fitted but not wanted. Raises ``ValueError`` for an unknown
    estimator, and if echoes or pulses cannot support the estimate.
    """
    return fit_motion(motion_of(echoes, estimator), frequencies_hz, estimator, also_hz, options)


def motion_of(echoes: EchoGate, estimator: str) -> Motion:
    """Return the displacement of every pulse; raise ``ValueError`` for unusable echoes or an unknown estimator."""
    return spec_of(estimator).motion(echoes)


def fit_motion(
    motion: Motion,
    frequencies_hz: Frequencies,
    estimator: str = "coherent",
    also_hz: Frequencies = (),
    options: Options = PLAIN,
) -> HarmonicFit:
    """Return amplitude and phase of a displacement at every frequency, by the fit that belongs to ``estimator``.

    ``also_hz``: further frequencies of the motion, fitted but not returned.
    """
    spec = spec_of(estimator)
    if spec.fit_motion is not None:
        return spec.fit_motion(motion, frequencies_hz, also_hz, options)
    if spec.velocity_chain:
        velocity, order = velocity_between_pulses(motion), options.background_order
        return velocity_to_harmonics(velocity, frequencies_hz, also_hz=also_hz, background_order=order)
    return _fit_displacement(motion, frequencies_hz, also_hz, options)


def _fit_displacement(
    motion: Motion, frequencies_hz: Frequencies, also_hz: Frequencies, options: Options
) -> HarmonicFit:
    """Return amplitude and phase of a displacement by the fit that ``options.harmonic`` names.

    - "medium_prior": in closed form with the prior of media; least squares if ``options`` have no prior.
    - "kalman": Kalman filter with the prior of media; without prior if there is none, or with process noise.
    - "least_squares".
    """
    order, prior, noise = options.background_order, options.prior, options.process_noise
    # The prior contains every harmonic of the tonebursts, also_hz among them.
    if prior is not None and options.harmonic == "medium_prior":
        return medium_fit(motion, frequencies_hz, prior, background_order=order).fit
    if prior is not None and options.harmonic == "kalman" and not noise:
        return medium_kalman(motion, frequencies_hz, prior, background_order=order).fit
    if options.harmonic == "kalman":
        return kalman(motion, frequencies_hz, also_hz=also_hz, background_order=order, process_noise=noise)
    return least_squares(motion, frequencies_hz, also_hz=also_hz, background_order=order)


@cache
def spec_of(estimator: str) -> EstimatorSpec:
    """Return the estimator ``estimator`` with its functions, built in or from a plug-in.

    Raises ``ValueError`` if there is none of that name or its package fails.
    """
    if checked_estimator(estimator) not in BUILT_IN_ESTIMATORS:
        return _plug_in(estimator)
    # The table names the functions of built-in estimators; their modules are imported here.
    row = BUILT_IN_ESTIMATORS[estimator]
    band_phase = resolve_name(row.band_function) if row.band_function else None
    return EstimatorSpec(**asdict(row), motion=resolve_name(row.function), band_phase=band_phase)


def _plug_in(name: str) -> EstimatorSpec:
    """Return the estimator of another package, with checks of its results and its package named in its errors."""
    spec, package = load(ENTRY_POINTS, name), f"estimator {origin(ENTRY_POINTS, name)}"
    if not isinstance(spec, EstimatorSpec):
        raise ExtensionError(f"{package} is not an EstimatorSpec. Try: its newest version")
    return replace(
        spec,
        name=name,
        label=spec.label if spec.label != spec.name else name,
        motion=_checked(spec.motion, Motion, package),
        fit_motion=None if spec.fit_motion is None else _checked(spec.fit_motion, HarmonicFit, package),
        published=False,
    )


def _checked(function: Callable[..., Any], result_type: type, package: str) -> Callable[..., Any]:
    """Wrap a function of a plug-in: its errors name ``package``, and results of a wrong type or shape are errors."""

    @wraps(function)
    def checked(*args: Any, **kwargs: Any) -> Any:
        """Return the checked result of the plug-in's function."""
        values = args[0].volts if isinstance(args[0], EchoGate) else args[0].displacement_m
        timeout_s = TIMEOUT_S + math.prod(values.shape) / VALUES_PER_S
        try:
            result = call(package, lambda: function(*args, **kwargs), timeout_s, (ValueError,))
        except ExtensionError:
            raise
        except ValueError as error:
            raise ValueError(f"{package}: {error}") from error
        if not isinstance(result, result_type):
            raise ExtensionError(f"{package} returned {type(result).__name__} instead of {result_type.__name__}")
        if isinstance(result, Motion):
            _refuse_misfit(result, args[0], package)
        elif isinstance(result, HarmonicFit):
            variances = np.diagonal(result.covariance, axis1=-2, axis2=-1)
            _refuse_impossible("amplitude_m", result.amplitude_m, variances[..., 0], package)
            # The phase of a small amplitude has any variance.
            _refuse_impossible("phase_rad", result.phase_rad, np.minimum(variances[..., 1], 0.0), package)
        return result

    return checked


def _refuse_impossible(name: str, values: FloatArray, variances: FloatArray, package: str) -> None:
    """Raise ``ExtensionError`` for ``values`` or ``variances`` of them that no echo can have; NaN is no value.

    ``name`` of the values.
    """
    is_value = ~np.isnan(values)
    values, variances = values[is_value], variances[is_value]
    largest = float(np.abs(values).max(initial=0.0))
    if largest > MAX_VALUE:
        what = f"returned {name} up to {largest:g}, more than {MAX_VALUE:g}"
        raise ExtensionError(f"{package} {what}. Try: report it there")
    # A variance that is not a number fails both comparisons.
    if not ((variances >= 0) & (variances <= MAX_VALUE**2)).all():
        what = f"returned a variance of {name} that is negative, not finite or above {MAX_VALUE**2:g}"
        raise ExtensionError(f"{package} {what}. Try: report it there")


def _refuse_misfit(motion: Motion, echoes: EchoGate, package: str) -> None:
    """Raise an error if a plug-in's ``motion`` has not one value per pulse of ``echoes``, or no finite displacement."""
    shape = echoes.volts.shape[:-1]
    for name, values in (("displacement_m", motion.displacement_m), ("variance_m2", motion.variance_m2)):
        if np.shape(values) != shape:
            raise ExtensionError(f"{package} returned {name} of shape {np.shape(values)}, {shape} is needed")
    valid = np.asarray(motion.valid)
    if valid.dtype != np.bool_ or valid.shape != shape[-1:] or not np.array_equal(motion.time_s, echoes.pulse_time_s):
        raise ExtensionError(f"{package} returned other pulses than those of the echoes. Try: report it there")
    displacement_m, variance_m2 = motion.displacement_m[..., valid], motion.variance_m2[..., valid]
    _refuse_impossible("displacement_m", displacement_m, variance_m2, package)
    if not np.isfinite(displacement_m).all(axis=-1).any():
        raise ValueError(f"{package} returned no displacement: noise without echo, or the wrong gate or carrier")
