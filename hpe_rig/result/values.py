"""Values of a result: amplitude and phase of a frequency, with uncertainty budget, by shot and by gate."""

from __future__ import annotations

import cmath
import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from hpe_rig.result.influence import Influence
from hpe_rig.result.interval import interval_95, phase_interval_95_rad
from hpe_rig.result.motion import ShotMotion

DERIVED = (
    "snr_db",
    "corrected_amplitude_m",
    "corrected_uncertainty_m",
    "corrected_phase_rad",
    "corrected_phase_uncertainty_rad",
    "interval_95_m",
    "interval_95_rad",
    "corrected_amplitude_error",
    "corrected_phase_error_rad",
    "predicted_amplitude_m",
    "amplitude_error",
    "phase_error_rad",
)
"""Properties of an estimate that JSON and CSV contain."""


@dataclass(frozen=True, slots=True)
class AveragingRule:
    """How the averaging follows from the complex ratio r of tracked to peak motion in a medium.

        factor = (1 - loss_scale (1 - |r|)) geometry_factor,    phase = arg r + geometry_phase_rad

    ``loss_scale``: loss with few speckles and scatterers over the loss with many. ``area_spread``: standard deviation,
    over speckle, of the logarithm of the tracking beam's area. The geometry is that of a gate off the focus, oblique
    waves and a force that is not Gaussian.
    """

    area_spread: float = 0.0
    loss_scale: float = 1.0
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
class Headline:
    """Main amplitude and phase of an estimate, and their combined standard uncertainties.

    They describe the peak displacement if ``corrected``, otherwise (no beams declared) the tracked displacement.
    ``interval_95_m`` and ``interval_95_rad`` are the half widths of the 95 % intervals.
    """

    amplitude_m: float
    amplitude_uncertainty_m: float
    phase_rad: float
    phase_uncertainty_rad: float
    corrected: bool
    interval_95_m: float = math.nan
    interval_95_rad: float = math.nan


@dataclass(frozen=True, slots=True)
class Estimate:
    """One vibration frequency of one shot, as tracked and as corrected to the peak displacement.

    ``amplitude_uncertainty_m`` and ``phase_uncertainty_rad`` are the standard uncertainties of the tracked values from
    the fit: noise, plus aliasing for fits with a prior. ``averaging_factor`` and ``averaging_phase_rad`` are the
    predicted ratio and lag of tracked to peak displacement, None without beams. ``aliasing_factor`` and
    ``aliasing_phase_rad`` are the predicted effect of unresolved harmonics on the tracked values; the headline is
    corrected for it. ``components`` are the independent sources of the headline's uncertainty; empty: noise only.
    ``noise_freedom`` are the degrees of freedom of the fit's residual, which estimates the noise.
    ``true_amplitude_m`` and ``true_phase_rad`` are the peak displacement at the focus, which only the twin provides.
    """

    frequency_hz: float
    amplitude_m: float
    amplitude_uncertainty_m: float
    phase_rad: float
    phase_uncertainty_rad: float
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
    def headline(self) -> Headline:
        """Corrected amplitude and phase if beams are declared, else the tracked ones; u of all components."""
        amplitude_m, phase_rad = self.corrected_amplitude_m, self.corrected_phase_rad
        corrected = amplitude_m is not None and phase_rad is not None
        sources_m = [(source.amplitude_m, source.degrees_of_freedom) for source in self.budget]
        sources_rad = [(source.phase_rad, source.degrees_of_freedom) for source in self.budget]
        return Headline(
            amplitude_m=amplitude_m if amplitude_m is not None else self.amplitude_m,
            amplitude_uncertainty_m=math.hypot(*(u_m for u_m, _ in sources_m)),
            phase_rad=phase_rad if phase_rad is not None else self.phase_rad,
            phase_uncertainty_rad=math.hypot(*(u_rad for u_rad, _ in sources_rad)),
            corrected=corrected,
            interval_95_m=interval_95(sources_m),
            interval_95_rad=phase_interval_95_rad(sources_rad),
        )

    @property
    def phasor_m(self) -> complex:
        """Headline value A exp(j phase): in-phase and quadrature component."""
        amplitude_m, phase_rad = self.corrected_amplitude_m, self.corrected_phase_rad
        if amplitude_m is None or phase_rad is None:
            return cmath.rect(self.amplitude_m, self.phase_rad)
        return cmath.rect(amplitude_m, phase_rad)

    @property
    def budget(self) -> tuple[Component, ...]:
        """Components of the headline's uncertainty; without ``components`` the noise of the fit."""
        noise_m = self.amplitude_uncertainty_m / (self.averaging_factor or 1.0)
        return self.components or (Component("noise", noise_m, self.phase_uncertainty_rad, self.noise_freedom),)

    @property
    def snr_db(self) -> float:
        """Tracked amplitude over its standard uncertainty from the fit, in dB."""
        if self.amplitude_uncertainty_m == 0:
            return math.inf
        ratio = self.amplitude_m / self.amplitude_uncertainty_m
        return 20 * math.log10(ratio) if ratio > 0 else -math.inf

    @property
    def predicted_amplitude_m(self) -> float | None:
        """True peak displacement times the predicted averaging of the declared beams."""
        if self.true_amplitude_m is None or self.averaging_factor is None:
            return None
        return self.true_amplitude_m * self.averaging_factor

    @property
    def corrected_amplitude_m(self) -> float | None:
        """Peak displacement: ``amplitude_m`` corrected for beam averaging and predicted aliasing."""
        return None if not self.averaging_factor else self.amplitude_m / self.averaging_factor / self.aliasing_factor

    @property
    def corrected_uncertainty_m(self) -> float | None:
        """Combined standard uncertainty of ``corrected_amplitude_m``, from all components."""
        return self.headline.amplitude_uncertainty_m if self.averaging_factor else None

    @property
    def corrected_phase_rad(self) -> float | None:
        """Phase of the peak displacement, corrected for the predicted lag and aliasing; in [-pi, pi]."""
        if not self.averaging_factor:
            return None
        # The lag of the averaging and the phase error of aliasing add.
        lag_rad = (self.averaging_phase_rad or 0.0) + self.aliasing_phase_rad
        return math.remainder(self.phase_rad - lag_rad, 2 * math.pi)

    @property
    def corrected_phase_uncertainty_rad(self) -> float | None:
        """Combined standard uncertainty of ``corrected_phase_rad``, from all components."""
        return self.headline.phase_uncertainty_rad if self.averaging_factor else None

    @property
    def interval_95_m(self) -> float:
        """Half width of the 95 % interval about the headline amplitude."""
        return self.headline.interval_95_m

    @property
    def interval_95_rad(self) -> float:
        """Half width of the 95 % interval about the headline phase."""
        return self.headline.interval_95_rad

    @property
    def corrected_amplitude_error(self) -> float | None:
        """Relative error of the headline amplitude against the true peak displacement at the focus."""
        return None if not self.true_amplitude_m else self.headline.amplitude_m / self.true_amplitude_m - 1

    @property
    def corrected_phase_error_rad(self) -> float | None:
        """Error of the headline phase against the ground truth, in [-pi, pi]."""
        if self.true_phase_rad is None:
            return None
        return math.remainder(self.headline.phase_rad - self.true_phase_rad, 2 * math.pi)

    @property
    def amplitude_error(self) -> float | None:
        """Relative error of the tracked amplitude against the true peak displacement at the focus."""
        return None if not self.true_amplitude_m else self.amplitude_m / self.true_amplitude_m - 1

    @property
    def phase_error_rad(self) -> float | None:
        """Error of the tracked phase against the ground truth, in [-pi, pi]."""
        if self.true_phase_rad is None:
            return None
        return math.remainder(self.phase_rad - self.true_phase_rad, 2 * math.pi)


@dataclass(frozen=True, slots=True)
class ShotResult:
    """The estimates of one shot, with its settings and the number of missing pulses.

    ``complete`` is False if the run stopped during the shot. ``untrusted`` states why the records are not to be
    trusted, "" without a reason. ``swept``: values of the sweep's axes by their full names. ``conditions``: by
    name, read before and after the shot, NaN if not read. ``motion``: displacement, model and residual of each pulse,
    None if not stored. ``pulse_rate_error``: relative error of the pulse rate by the digitizer's clock, with its
    standard uncertainty; None without trigger times. ``frequency_error``: relative error of the motion's frequencies
    (of the burst rate) by the clock of the pulses, which the estimates are corrected for, with its standard
    uncertainty; None for one common clock. ``control``: tracked motion in the control of the shot, which has been
    subtracted, at each frequency; empty without a control. ``influences``: errors of the estimates by source.
    """

    shot: int
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
    motion: ShotMotion | None = field(default=None, repr=False, compare=False)
    influences: tuple[Influence, ...] = field(default=(), repr=False, compare=False)


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
