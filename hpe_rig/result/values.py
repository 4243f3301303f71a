"""Values of a result: amplitude and phase of a frequency, with uncertainty budget, by shot and by gate."""

from __future__ import annotations

import cmath
import math
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from hpe_rig.result.influence import Influence
from hpe_rig.result.interval import interval_95, phase_interval_95_rad
from hpe_rig.result.motion import ShotMotion

DERIVED = (
    "amplitude_m",
    "amplitude_uncertainty_m",
    "phase_rad",
    "phase_uncertainty_rad",
    "corrected",
    "interval_95_m",
    "interval_95_rad",
    "amplitude_error",
    "phase_error_rad",
    "snr_db",
    "predicted_amplitude_m",
    "tracked_amplitude_error",
    "tracked_phase_error_rad",
)
"""Properties of an estimate that JSON and CSV contain."""
EARLIER_NAMES = {
    "corrected_amplitude_m": "amplitude_m",
    "corrected_uncertainty_m": "amplitude_uncertainty_m",
    "corrected_phase_rad": "phase_rad",
    "corrected_phase_uncertainty_rad": "phase_uncertainty_rad",
    "corrected_amplitude_error": "amplitude_error",
    "corrected_phase_error_rad": "phase_error_rad",
}
"""Names of the corrected values before version 1.0, where the present names stated the tracked values."""


def earlier_headline(values: Any, name: str) -> Any:
    """Return ``values`` itself, with a warning, for its earlier attribute ``headline``; refuse any other ``name``."""
    if name != "headline":
        raise AttributeError(f"{type(values).__name__!r} object has no attribute {name!r}", name=name, obj=values)
    kind = type(values).__name__
    warnings.warn(f"the values of headline are those of the {kind} itself", FutureWarning, stacklevel=3)
    return values


@dataclass(frozen=True, slots=True)
class AveragingRule:
    """How the averaging follows from the complex ratio r of tracked to peak motion in a medium.

        factor = (1 - deficit_scale (1 - |r|)) geometry_factor,    phase = arg r + geometry_phase_rad

    ``deficit_scale``: deficit 1 - |r| with few speckles and scatterers over that with many. ``region_sd``: standard
    deviation, over speckle, of ln(area of the tracked region), and also of the region's offset over its radius. The
    geometry is that of a gate off the focus, oblique waves and a force that is not Gaussian.
    """

    region_sd: float = 0.0
    deficit_scale: float = 1.0
    geometry_factor: float = 1.0
    geometry_phase_rad: float = 0.0


@dataclass(frozen=True, slots=True)
class Averaging:
    """Predicted tracked over peak displacement at one frequency: ``factor``, phase, and their uncertainties.

    All uncertainties are standard deviations, except the covariances. Sources:

    * speckle, which varies laterally: ``speckle_relative`` and ``speckle_phase_rad``
    * unknown medium: ``factor_uncertainty`` and ``phase_uncertainty_rad``; their covariances with the aliasing error
      are ``shared_relative`` and ``shared_phase_rad2``
    * unknown distance of the gate from the focus: ``offset_relative``
    * beams that are not Gaussian: ``shape_relative``
    * spread of the echo's mean frequency, for an estimator that divides by the carrier: ``carrier_relative``

    ``rule`` gives the averaging of another medium. ``steepness``: relative change of the tracked motion with the
    logarithm of the tracking beam's area, amplitude as real part, phase (rad) as imaginary part.
    """

    factor: float
    phase_rad: float
    speckle_relative: float
    factor_uncertainty: float = 0.0
    phase_uncertainty_rad: float = 0.0
    speckle_phase_rad: float = 0.0
    offset_relative: float = 0.0
    shape_relative: float = 0.0
    carrier_relative: float = 0.0
    rule: AveragingRule = AveragingRule()
    shared_relative: float = 0.0
    shared_phase_rad2: float = 0.0
    steepness: complex = 0.0


RECTIFIED = "rectified noise"
"""Name of the source for the Rician bias: the additional error of an amplitude that may be noise alone."""


@dataclass(frozen=True, slots=True)
class Component:
    """One source of uncertainty: the standard uncertainties of amplitude and phase from this source alone.

    ``degrees_of_freedom`` is infinite (null in JSON) for a source that is not estimated from the scatter of the pulses.
    """

    source: str
    amplitude_m: float
    phase_rad: float
    degrees_of_freedom: float = math.inf


@dataclass(frozen=True, slots=True)
class Estimate:
    """One vibration frequency of one shot, as tracked and as corrected to the peak displacement.

    ``amplitude_m`` and ``phase_rad`` are the headline values, with combined standard uncertainties: the peak
    displacement if ``corrected``, else the tracked displacement. ``tracked_amplitude_m`` and ``tracked_phase_rad`` are
    not corrected; their standard uncertainties are those of the fit: noise, plus aliasing for fits with a prior.
    ``averaging_factor`` and ``averaging_phase_rad`` are the predicted ratio and lag of tracked to peak displacement,
    None without beams. ``aliasing_factor`` and ``aliasing_phase_rad`` are the predicted effect of unresolved harmonics
    on the tracked values; the headline is corrected for it. ``components`` are the independent sources of the
    headline's uncertainty; empty: noise only. ``noise_freedom`` are the degrees of freedom of the fit's residual, which
    estimates the noise. ``true_amplitude_m`` and ``true_phase_rad`` are the peak displacement at the focus, which only
    the twin provides.
    """

    frequency_hz: float
    tracked_amplitude_m: float
    tracked_amplitude_uncertainty_m: float
    tracked_phase_rad: float
    tracked_phase_uncertainty_rad: float
    averaging_factor: float | None = None
    speckle_relative: float | None = None
    true_amplitude_m: float | None = None
    true_phase_rad: float | None = None
    averaging_phase_rad: float | None = None
    components: tuple[Component, ...] = ()
    aliasing_factor: float = 1.0
    aliasing_phase_rad: float = 0.0
    noise_freedom: float = math.inf

    @property
    def corrected(self) -> bool:
        """Whether amplitude and phase are those of the peak displacement; without beams they are as tracked."""
        return bool(self.averaging_factor)

    @property
    def amplitude_m(self) -> float:
        """Tracked amplitude, corrected for beam averaging and predicted aliasing if beams are declared."""
        factor = self.averaging_factor
        return self.tracked_amplitude_m / factor / self.aliasing_factor if factor else self.tracked_amplitude_m

    @property
    def phase_rad(self) -> float:
        """Tracked phase, corrected for the predicted lag and aliasing if beams are declared; in [-pi, pi]."""
        if not self.corrected:
            return self.tracked_phase_rad
        # The lag of the averaging and the phase error of aliasing add.
        lag_rad = (self.averaging_phase_rad or 0.0) + self.aliasing_phase_rad
        return math.remainder(self.tracked_phase_rad - lag_rad, 2 * math.pi)

    @property
    def amplitude_uncertainty_m(self) -> float:
        """Combined standard uncertainty of ``amplitude_m``, from all components."""
        return math.hypot(*(source.amplitude_m for source in self.budget))

    @property
    def phase_uncertainty_rad(self) -> float:
        """Combined standard uncertainty of ``phase_rad``, from all components."""
        return math.hypot(*(source.phase_rad for source in self.budget))

    @property
    def phasor_m(self) -> complex:
        """Headline value A exp(j phase): in-phase and quadrature component."""
        return cmath.rect(self.amplitude_m, self.phase_rad)

    @property
    def budget(self) -> tuple[Component, ...]:
        """Components of the headline's uncertainty; without ``components`` the noise of the fit."""
        noise_m = self.tracked_amplitude_uncertainty_m / (self.averaging_factor or 1.0)
        return self.components or (Component("noise", noise_m, self.tracked_phase_uncertainty_rad, self.noise_freedom),)

    @property
    def snr_db(self) -> float:
        """Tracked amplitude over its standard uncertainty from the fit, in dB."""
        if self.tracked_amplitude_uncertainty_m == 0:
            return math.inf
        ratio = self.tracked_amplitude_m / self.tracked_amplitude_uncertainty_m
        return 20 * math.log10(ratio) if ratio > 0 else -math.inf

    @property
    def predicted_amplitude_m(self) -> float | None:
        """True peak displacement times the predicted averaging of the declared beams."""
        if self.true_amplitude_m is None or self.averaging_factor is None:
            return None
        return self.true_amplitude_m * self.averaging_factor

    @property
    def interval_95_m(self) -> float:
        """Half width of the 95 % interval about ``amplitude_m``."""
        return interval_95([(source.amplitude_m, source.degrees_of_freedom) for source in self.budget])

    @property
    def interval_95_rad(self) -> float:
        """Half width of the 95 % interval about ``phase_rad``."""
        return phase_interval_95_rad([(source.phase_rad, source.degrees_of_freedom) for source in self.budget])

    @property
    def amplitude_error(self) -> float | None:
        """Relative error of ``amplitude_m`` against the true peak displacement at the focus."""
        return None if not self.true_amplitude_m else self.amplitude_m / self.true_amplitude_m - 1

    @property
    def phase_error_rad(self) -> float | None:
        """Error of ``phase_rad`` against the ground truth, in [-pi, pi]."""
        return self._phase_error_rad(self.phase_rad)

    @property
    def tracked_amplitude_error(self) -> float | None:
        """Relative error of the tracked amplitude against the true peak displacement at the focus."""
        return None if not self.true_amplitude_m else self.tracked_amplitude_m / self.true_amplitude_m - 1

    @property
    def tracked_phase_error_rad(self) -> float | None:
        """Error of the tracked phase against the ground truth, in [-pi, pi]."""
        return self._phase_error_rad(self.tracked_phase_rad)

    def _phase_error_rad(self, phase_rad: float) -> float | None:
        return None if self.true_phase_rad is None else math.remainder(phase_rad - self.true_phase_rad, 2 * math.pi)

    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any:
            """Return the value of one of ``EARLIER_NAMES`` with a warning; values were None without correction."""
            if name not in EARLIER_NAMES:
                return earlier_headline(self, name)
            present = EARLIER_NAMES[name]
            warnings.warn(f"{name} is called {present} since version 1.0", FutureWarning, stacklevel=2)
            return getattr(self, present) if self.corrected or name.endswith(("error", "error_rad")) else None


@dataclass(frozen=True, slots=True)
class ShotResult:
    """The estimates of one shot, with its settings and the number of missing pulses.

    ``index``: that of the shot's records (``run.records[index]``), from 0, as ``repeat``; tables count both from 1.
    ``complete`` is False if the run stopped during the shot. ``untrusted`` states why the records are not to be
    trusted, "" without a reason. ``swept``: values of the sweep's axes by their full names. ``conditions``: by name,
    read before and after the shot, NaN if not read. ``motion``: displacement, model and residual of each pulse, None if
    not stored. ``pulse_rate_error``: relative error of the pulse rate by the digitizer's clock, with its standard
    uncertainty; None without trigger times. ``frequency_error``: relative error of the motion's frequencies (of the
    burst rate) by the clock of the pulses, which the estimates are corrected for, with its standard uncertainty; None
    for one common clock. ``frequency_error_from_tonebursts``: whether tonebursts recorded at the second input measured
    it, and not the motion. ``control``: tracked motion in the control of the shot, which has been subtracted, at each
    frequency; empty without a control. ``influences``: errors of the estimates by source.
    """

    index: int
    repeat: int
    burst_length_s: float | None
    force_fraction: float | None
    pulses_used: int
    pulses_missing: int
    residual_m: float
    estimates: tuple[Estimate, ...]
    warnings: tuple[str, ...]
    pulse_rate_hz: float | None = None
    window_length_s: float | None = None
    lateral_offset_m: float = 0.0
    axial_offset_m: float = 0.0
    complete: bool = True
    untrusted: str = ""
    swept: Mapping[str, float] = field(default_factory=dict)
    conditions: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    pulse_rate_error: float | None = None
    pulse_rate_uncertainty: float | None = None
    control: tuple[Estimate, ...] = ()
    frequency_error: float | None = None
    frequency_error_uncertainty: float | None = None
    frequency_error_from_tonebursts: bool = False
    motion: ShotMotion | None = field(default=None, repr=False, compare=False)
    influences: tuple[Influence, ...] = field(default=(), repr=False, compare=False)

    @property
    def shot(self) -> int:
        """Number of the shot in the run, from 1."""
        return self.index + 1


@dataclass(frozen=True, slots=True)
class GateResult:
    """The estimates of a shot in one gate over depth, with the gate's centre and length, m.

    The headline is the motion on the tracking axis at that depth, without ground truth. ``motion_m`` (time,) is the
    mean displacement, less its mean, in equal divisions of the burst period at ``motion_time_s`` after the arrival of a
    toneburst at the gate; empty without tonebursts.
    """

    depth_m: float
    length_m: float
    shot: ShotResult
    motion_time_s: tuple[float, ...] = ()
    motion_m: tuple[float, ...] = ()
