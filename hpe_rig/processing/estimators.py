"""Estimators of amplitude and phase from echoes: one ``EstimatorSpec`` a row, nobody else asks for names."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, wraps
from typing import Any, Literal, Protocol

import numpy as np

from hpe_rig.arrays import ComplexArray, FloatArray
from hpe_rig.extensions import ESTIMATORS as EXTENSIONS, ExtensionError, installed, load, origin
from hpe_rig.processing.echo.band import Band
from hpe_rig.processing.echo.echoes import EchoGate, Motion, velocity_between_pulses
from hpe_rig.processing.harmonics.harmonic_fit import HarmonicFit, least_squares
from hpe_rig.processing.harmonics.kalman_filter import kalman
from hpe_rig.processing.harmonics.maximum_likelihood import joint
from hpe_rig.processing.harmonics.medium_prior import MediumPrior, medium_fit, medium_kalman
from hpe_rig.processing.harmonics.velocity_chain import velocity_to_harmonics
from hpe_rig.processing.motion.correlation import cross_correlation
from hpe_rig.processing.motion.phase_shift import coherent, coherent_phase, kasai, loupas
from hpe_rig.processing.motion.spectral_peak import cross_spectrum
from hpe_rig.scene import Estimator as Estimator, estimator_names

ESTIMATORS: tuple[Estimator, ...] = estimator_names()
"""Names of all estimators, those of installed packages last."""
Harmonic = Literal["medium_prior", "least_squares", "kalman"]
Window = Literal["none", "hann"]
Frequencies = FloatArray | Sequence[float]

WINDOW_NOISE: dict[Window, float] = {"none": 1.0, "hann": 1.5}
"""N sum w^2 / (sum w)^2: by how much a window raises the variance of what is estimated through it."""


@dataclass(frozen=True, slots=True)
class Options:
    """What of the estimation can be chosen, apart from the estimator.

    ``background_order``: polynomial fitted along (0 constant, 1 velocity, 2 acceleration, more: drift);
    ``process_noise``: variance of a harmonic state's change per pulse over that of the noise, for "kalman" alone;
    ``prior``: of what media make of the tonebursts, for "medium_prior", and for "kalman" without process noise.
    ``joint`` knows no Kalman filter and takes least squares for it; the paper's chain has its own, and a band-pass.
    """

    background_order: int = 0
    harmonic: Harmonic = "least_squares"
    process_noise: float = 0.0
    prior: MediumPrior | None = None


PLAIN = Options()


class FitEchoes(Protocol):
    """Amplitude and phase straight from echoes, as ``maximum_likelihood.joint``."""

    def __call__(
        self,
        echoes: EchoGate,
        frequencies_hz: Frequencies,
        *,
        also_hz: Frequencies,
        background_order: int,
        prior: MediumPrior | None,
    ) -> HarmonicFit: ...


class FitMotion(Protocol):
    """Amplitude and phase of a displacement per pulse."""

    def __call__(
        self, motion: Motion, frequencies_hz: Frequencies, also_hz: Frequencies, options: Options
    ) -> HarmonicFit: ...


def fit_displacement(
    motion: Motion, frequencies_hz: Frequencies, also_hz: Frequencies, options: Options
) -> HarmonicFit:
    """Return amplitude and phase by the prior of media, least squares or the Kalman filter, as ``options`` say.

    The prior holds every harmonic of the bursts, so that it takes no ``also_hz``.
    """
    order, prior = options.background_order, options.prior
    if prior is not None and options.harmonic == "medium_prior":
        return medium_fit(motion, frequencies_hz, prior, background_order=order).fit
    if prior is not None and options.harmonic == "kalman" and not options.process_noise:
        return medium_kalman(motion, frequencies_hz, prior, background_order=order).fit
    if options.harmonic == "kalman":
        noise = options.process_noise
        return kalman(motion, frequencies_hz, also_hz=also_hz, background_order=order, process_noise=noise)
    return least_squares(motion, frequencies_hz, also_hz=also_hz, background_order=order)


def fit_velocity(motion: Motion, frequencies_hz: Frequencies, also_hz: Frequencies, options: Options) -> HarmonicFit:
    """Return amplitude and phase by the paper's chain over velocities; of ``options`` it takes the background alone."""
    order = options.background_order
    return velocity_to_harmonics(
        velocity_between_pulses(motion), frequencies_hz, also_hz=also_hz, background_order=order
    )


@dataclass(frozen=True, slots=True)
class EstimatorSpec:
    """Everything that distinguishes one estimator from another.

    How it computes:
    ``motion``: echoes to displacement per pulse; None where there is none between echoes and result, then
    ``fit_echoes`` does it all. ``fit_motion``: displacement to amplitude and phase. ``band_phase``: phase and its mean
    frequency from spectra in the band, where the estimator has that form, and whether in a compiled loop: a faster way
    for many realisations.

    What its noise is made of:
    ``gate_window`` and ``slow_time_window``: tapers over the samples of the gate and over the pulses. ``reads_peak``:
    the phase is that of the cross-spectrum's largest bin, which noise can move, not that of the whole band.
    ``by_carrier``: phase is divided by the carrier, not by the echo's mean frequency. ``steps_add_up``: displacement is
    a sum of steps between pulses whose own noise stays in every later one.

    ``label``: what figures and tables call it, by default its name; ``published``: the paper's own, which they show
    first.
    """

    name: str
    motion: Callable[[EchoGate], Motion] | None = None
    fit_echoes: FitEchoes | None = None
    fit_motion: FitMotion = fit_displacement
    band_phase: Callable[[ComplexArray, Band, bool], tuple[FloatArray, FloatArray, FloatArray]] | None = None
    gate_window: Window = "none"
    slow_time_window: Window = "none"
    reads_peak: bool = False
    by_carrier: bool = False
    steps_add_up: bool = False
    label: str = ""
    published: bool = False

    def __post_init__(self) -> None:
        """Take the name as the label where none is given."""
        object.__setattr__(self, "label", self.label or self.name)

    @property
    def gate_noise(self) -> float:
        """By how much the taper over the gate raises a pulse's variance."""
        return WINDOW_NOISE[self.gate_window]

    @property
    def slow_time_noise(self) -> float:
        """By how much the taper over the pulses raises a quadrature's variance."""
        return WINDOW_NOISE[self.slow_time_window]

    @property
    def takes_prior(self) -> bool:
        """Whether the displacement is fitted as the options say, with a prior of media where there is one."""
        return self.fit_motion is fit_displacement

    @property
    def fits_all_at_once(self) -> bool:
        """Whether all frequencies are fitted at once, so that resolving them costs noise; else one by one."""
        return self.slow_time_window == "none"


_SPECS = (
    EstimatorSpec("coherent", coherent, band_phase=coherent_phase),
    EstimatorSpec("joint", fit_echoes=joint),
    EstimatorSpec("cross_correlation", cross_correlation),
    EstimatorSpec("kasai", kasai, by_carrier=True, steps_add_up=True),
    EstimatorSpec("loupas", loupas, steps_add_up=True),
    EstimatorSpec(
        "cross_spectrum",
        cross_spectrum,
        fit_motion=fit_velocity,
        gate_window="hann",
        slow_time_window="hann",
        reads_peak=True,
        label="the paper's chain",
        published=True,
    ),
)
_BY_NAME = {each.name: each for each in _SPECS}


def spec_of(estimator: str) -> EstimatorSpec:
    """Return the estimator of that name; raise ``ValueError`` where there is none, or its package fails."""
    if estimator in _BY_NAME:
        return _BY_NAME[estimator]
    if estimator not in installed(EXTENSIONS):
        raise ValueError(f"estimator {estimator!r} does not exist: try one of {', '.join(ESTIMATORS)}")
    return _foreign(estimator)


@cache
def _foreign(name: str) -> EstimatorSpec:
    """Return the estimator of another package: its functions name it where they fail, their results are looked at."""
    spec, whose = load(EXTENSIONS, name), f"estimator {origin(EXTENSIONS, name)}"
    if not isinstance(spec, EstimatorSpec) or (spec.motion is None) == (spec.fit_echoes is None):
        raise ExtensionError(f"{whose} is no EstimatorSpec with either motion or fit_echoes. Try: its newest version")
    own_fit = spec.fit_motion in (fit_displacement, fit_velocity)
    return replace(
        spec,
        name=name,
        label=spec.label if spec.label != spec.name else name,
        motion=None if spec.motion is None else _watched(spec.motion, Motion, whose),
        fit_echoes=None if spec.fit_echoes is None else _watched(spec.fit_echoes, HarmonicFit, whose),
        fit_motion=spec.fit_motion if own_fit else _watched(spec.fit_motion, HarmonicFit, whose),
        published=False,
    )


def _watched(call: Callable[..., Any], gives: type, whose: str) -> Callable[..., Any]:
    @wraps(call)
    def watched(*args: Any, **kwargs: Any) -> Any:
        try:
            found = call(*args, **kwargs)
        except (MemoryError, KeyboardInterrupt):
            raise
        except ValueError as error:
            raise ValueError(f"{whose}: {error}") from error
        except Exception as error:
            raise ExtensionError(f"{whose} failed ({type(error).__name__}: {error}). Try: report it there") from error
        if not isinstance(found, gives):
            raise ExtensionError(f"{whose} gave {type(found).__name__} in place of {gives.__name__}")
        if isinstance(found, Motion):
            _refuse_misfit(found, args[0], whose)
        return found

    return watched


def _refuse_misfit(motion: Motion, echoes: EchoGate, whose: str) -> None:
    wanted = echoes.volts.shape[:-1]
    for name, values in (("displacement_m", motion.displacement_m), ("variance_m2", motion.variance_m2)):
        if np.shape(values) != wanted:
            raise ExtensionError(f"{whose} gave {name} of shape {np.shape(values)}, one of {wanted} is needed")
    if not np.isfinite(motion.displacement_m[..., motion.valid]).all(axis=-1).any():
        raise ValueError(f"{whose} found no displacement: noise without echo, or the wrong gate or carrier")


def estimate(
    echoes: EchoGate,
    frequencies_hz: Frequencies,
    estimator: str = "coherent",
    also_hz: Frequencies = (),
    options: Options = PLAIN,
) -> HarmonicFit:
    """Return amplitude and phase of the motion at every frequency, from all valid pulses.

    ``also_hz`` are frequencies that the motion has as well and that are not wanted: they are fitted along. Raises
    ``ValueError`` for an unknown estimator, and when echoes or pulses cannot carry the estimate.
    """
    spec = spec_of(estimator)
    if spec.fit_echoes is not None:
        prior = options.prior if options.harmonic == "medium_prior" else None
        order = options.background_order
        return spec.fit_echoes(echoes, frequencies_hz, also_hz=also_hz, background_order=order, prior=prior)
    return fit_motion(motion_of(echoes, estimator), frequencies_hz, estimator, also_hz, options)


def motion_of(echoes: EchoGate, estimator: str) -> Motion:
    """Return the displacement of every pulse; raise ``ValueError`` for bad echoes and estimators that have none."""
    spec = spec_of(estimator)
    if spec.motion is None:
        having = ", ".join(each.name for each in _SPECS if each.motion is not None)
        raise ValueError(f"{estimator} gives no displacement per pulse: try one of {having}")
    return spec.motion(echoes)


def fit_motion(
    motion: Motion,
    frequencies_hz: Frequencies,
    estimator: str = "coherent",
    also_hz: Frequencies = (),
    options: Options = PLAIN,
) -> HarmonicFit:
    """Return amplitude and phase of a motion by the way that belongs to its estimator."""
    return spec_of(estimator).fit_motion(motion, frequencies_hz, also_hz, options)
