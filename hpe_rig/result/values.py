"""Displacement amplitude and phase with uncertainties, units, provenance and run time: what a measurement says."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import TYPE_CHECKING, Any

from hpe_rig.result.interval import interval_95, phase_interval_95_rad
from hpe_rig.result.motion import ShotMotion
from hpe_rig.result.provenance import UNKNOWN, Provenance
from hpe_rig.scene import Estimator

if TYPE_CHECKING:
    import pandas as pd
    import xarray
    from matplotlib.figure import Figure

    from hpe_rig.result.repeats import RepeatMean

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
"""Properties of an estimate that JSON and CSV hold too."""
MOST_NUMBERS = 12
"""Shots that a warning names; of more it says how many."""


@dataclass(frozen=True, slots=True)
class Averaging:
    """Predicted tracked over peak displacement at one frequency: ``factor`` and phase, and what is not known of them.

    Speckle changes the tracked amplitude by ``speckle_relative`` and its phase by ``speckle_phase_rad`` from place to
    place; ``factor_uncertainty`` and ``phase_uncertainty_rad`` come from what is not known of the medium, and
    ``shared_relative`` and ``shared_phase_rad2`` are the covariance of that with aliasing. ``offset_relative`` comes
    from what is not known of the gate's distance to the focus; ``carrier_relative`` is the spread of the echo's mean
    frequency about the carrier, for an estimator that divides by that. The others are standard deviations.

    ``offset_factor`` and ``offset_phase_rad`` are what of ``factor`` and phase a gate off the focus, oblique waves and
    a force that is no Gaussian make, ``shape_relative`` what beams that are no Gaussians leave uncertain. For other
    media: speckle changes the logarithm of the tracking beam's area by ``area_spread``, and few speckles and scatterers
    make what is lost ``loss_scale`` times that of many.
    """

    factor: float
    phase_rad: float
    speckle_relative: float
    factor_uncertainty: float = 0.0
    phase_uncertainty_rad: float = 0.0
    speckle_phase_rad: float = 0.0
    offset_relative: float = 0.0
    offset_factor: float = 1.0
    offset_phase_rad: float = 0.0
    shape_relative: float = 0.0
    carrier_relative: float = 0.0
    area_spread: float = 0.0
    loss_scale: float = 1.0
    shared_relative: float = 0.0
    shared_phase_rad2: float = 0.0


RECTIFIED = "rectified noise"
"""Source of what an amplitude's error has beyond that of a quadrature where all of it may be noise."""


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
    """Amplitude and phase that a result leads with, and their combined standard uncertainties.

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

    ``amplitude_uncertainty_m`` and ``phase_uncertainty_rad`` are the standard uncertainties of the tracked values that
    the fit states: of noise, and of aliasing where the fit knows it. ``averaging_factor`` and ``averaging_phase_rad``
    are the predicted ratio and lag of tracked to peak displacement, None where no beams are given. ``aliasing_factor``
    and ``aliasing_phase_rad`` are what unresolved harmonics make of the tracked values, as far as the motion tells; the
    headline is without. ``components`` are the independent sources of uncertainty of the headline, of which there is
    noise alone where none are listed. ``noise_freedom``: degrees of freedom of the residual that tells the noise.
    ``true_amplitude_m`` and ``true_phase_rad`` are the ground truth, the peak
    displacement at the focus, known on the twin alone.
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
        """The corrected amplitude and phase where beams are known, else the tracked ones; u of all components."""
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
    def budget(self) -> tuple[Component, ...]:
        """The components of the headline's uncertainty; noise, as the fit states it, where none are listed."""
        noise_m = self.amplitude_uncertainty_m / (self.averaging_factor or 1.0)
        return self.components or (Component("noise", noise_m, self.phase_uncertainty_rad, self.noise_freedom),)

    @property
    def snr_db(self) -> float:
        """Tracked amplitude over its standard uncertainty by the fit: noise, and aliasing where the fit knows it."""
        if self.amplitude_uncertainty_m == 0:
            return math.inf
        ratio = self.amplitude_m / self.amplitude_uncertainty_m
        return 20 * math.log10(ratio) if ratio > 0 else -math.inf

    @property
    def predicted_amplitude_m(self) -> float | None:
        """The true peak displacement as beams of the declared widths would track it."""
        if self.true_amplitude_m is None or self.averaging_factor is None:
            return None
        return self.true_amplitude_m * self.averaging_factor

    @property
    def corrected_amplitude_m(self) -> float | None:
        """The peak displacement that would be tracked as ``amplitude_m``, by the predicted averaging and aliasing."""
        return None if not self.averaging_factor else self.amplitude_m / self.averaging_factor / self.aliasing_factor

    @property
    def corrected_uncertainty_m(self) -> float | None:
        """Combined standard uncertainty of ``corrected_amplitude_m``, from all components."""
        return self.headline.amplitude_uncertainty_m if self.averaging_factor else None

    @property
    def corrected_phase_rad(self) -> float | None:
        """The phase of the peak displacement, by the predicted lag of what is tracked and aliasing; in [-pi, pi]."""
        if not self.averaging_factor:
            return None
        turned_rad = (self.averaging_phase_rad or 0.0) + self.aliasing_phase_rad
        return math.remainder(self.phase_rad - turned_rad, 2 * math.pi)

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
        """Relative error of the headline's amplitude against the true peak displacement at the focus."""
        return None if not self.true_amplitude_m else self.headline.amplitude_m / self.true_amplitude_m - 1

    @property
    def corrected_phase_error_rad(self) -> float | None:
        """Error of the headline's phase against the ground truth, within half a turn."""
        if self.true_phase_rad is None:
            return None
        return math.remainder(self.headline.phase_rad - self.true_phase_rad, 2 * math.pi)

    @property
    def amplitude_error(self) -> float | None:
        """Relative error of the amplitude against the true peak displacement at the focus."""
        return None if not self.true_amplitude_m else self.amplitude_m / self.true_amplitude_m - 1

    @property
    def phase_error_rad(self) -> float | None:
        """Error of the phase against the ground truth, within half a turn."""
        if self.true_phase_rad is None:
            return None
        return math.remainder(self.phase_rad - self.true_phase_rad, 2 * math.pi)


@dataclass(frozen=True, slots=True)
class ShotResult:
    """The estimates of one shot, with what was varied and what was missing.

    ``complete`` is False for a shot in which the run stopped. ``untrusted`` says why its records are not to be trusted,
    "" where nothing speaks against them. ``swept``: values of the
    sweep's axes by their full names. ``motion``: displacement, model and residual pulse by pulse, where it is kept.
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
    motion: ShotMotion | None = field(default=None, repr=False, compare=False)


@dataclass(frozen=True, slots=True)
class GateResult:
    """A shot as one gate over depth sees it: the gate's middle and length, m, and the estimates there.

    The headline is the motion on the tracking axis at that depth; no truth is known there. ``motion_m`` (time,): mean
    displacement in equal parts of the burst period, about its mean, at ``motion_time_s`` after a toneburst's arrival at
    the gate; empty where nothing pushes.
    """

    depth_m: float
    length_m: float
    shot: ShotResult
    motion_time_s: tuple[float, ...] = ()
    motion_m: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True)
class Result:
    """The result of a run, or of anybody's echoes (``hpe_rig.estimate``).

    ``run_file`` is "" where there is none; ``omitted``: what the scene did not need, and why; ``run_time_s``: wall time
    by stage; ``simulated_specimen`` names the default one, None where the scene describes its own or none was needed;
    ``shots_without_result``: the shots, counted from 0, that have no estimate, and why; ``notes``: the scene's;
    ``provenance``: who measured when and where; ``imported``: file and hash of imported records, None for others.

    >>> print(result)
    >>> result.shots[0].estimates[0].amplitude_m
    >>> result.to_frame().to_csv("result.csv")
    >>> result.to_xarray().displacement_m.sel(shot=0)
    >>> result.figure().savefig("result.pdf")
    """

    title: str
    run_file: str
    simulated: bool
    status: str
    estimator: Estimator
    phase_reference: str
    shots: tuple[ShotResult, ...]
    warnings: tuple[str, ...]
    omitted: tuple[tuple[str, str], ...]
    versions: Mapping[str, str]
    run_time_s: Mapping[str, float]
    simulated_specimen: str | None = None
    shots_without_result: tuple[tuple[int, str], ...] = ()
    profile: tuple[GateResult, ...] = ()
    notes: Mapping[str, str | int | float | bool] = field(default_factory=dict)
    provenance: Provenance = UNKNOWN
    imported: str | None = None

    @property
    def origin(self) -> str:
        """Whether this was measured, simulated or imported, and from where, as it stands on every output."""
        if self.imported is not None:
            return f"IMPORTED from {self.imported}"
        return "SIMULATED" if self.simulated else "measured"

    @property
    def means(self) -> tuple[RepeatMean, ...]:
        """The mean over repeats of each setting that was repeated, and of each frequency; empty without repeats."""
        from hpe_rig.result.repeats import repeat_means

        return repeat_means(self.shots)

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON; numbers that JSON cannot hold become None.

        ``omitted`` stands there as ``left_out`` too, its name in earlier versions.
        """
        # Displacements are arrays, for the result file: JSON goes without them.
        plainly = replace(self, shots=tuple(replace(shot, motion=None) for shot in self.shots))
        tables = {**asdict(plainly), "left_out": self.omitted}
        if self.simulated_specimen is None:
            del tables["simulated_specimen"]
        if self.imported is None:
            del tables["imported"]
        if means := [asdict(each) for each in self.means]:
            # What a reader should take first stands first.
            tables = {"means": means, **tables}
        if not self.profile:
            del tables["profile"]
        shots = [*self.shots, *(gate.shot for gate in self.profile)]
        own = [*tables["shots"], *(gate["shot"] for gate in tables.get("profile", ()))]
        for shot, table in zip(shots, own, strict=True):
            del table["motion"]
            for estimate, row in zip(shot.estimates, table["estimates"], strict=True):
                row.update({name: getattr(estimate, name) for name in DERIVED})
        plain: dict[str, Any] = json_values(tables)
        return plain

    def __str__(self) -> str:
        """Return amplitude and phase with standard uncertainties as a table, a row a shot and frequency."""
        from hpe_rig.result.rows import result_text

        return result_text(self)

    def to_frame(self) -> pd.DataFrame:
        """Return a pandas frame of one row a shot and frequency, SI units in the columns' names; unknown is None.

        Gates over depth have rows of their own, told by ``gate_depth_m``.
        Raises ``ModuleNotFoundError`` that names the extra where pandas is not installed.
        """
        from hpe_rig.result.rows import result_frame

        return result_frame(self)

    def to_xarray(self) -> xarray.Dataset:
        """Return an xarray Dataset: estimates over (shot, frequency), displacement, model and residual over pulses.

        Units are attributes, what was set in each shot coordinates, notes attributes of the whole. Raises
        ``ModuleNotFoundError`` that names the extra where xarray is not installed.
        """
        from hpe_rig.result.grid import result_dataset

        return result_dataset(self)

    def figure(self) -> Figure:
        """Return a matplotlib figure of amplitude and phase over frequency, with bars of 2 u."""
        from hpe_rig.result.figure import result_figure

        return result_figure(self)

    def _repr_html_(self) -> str:
        """Return figure and table, as a notebook shows a value."""
        from hpe_rig.result.html_repr import result_html

        return result_html(self)


def shot_warnings(shots: Sequence[ShotResult]) -> list[str]:
    """Return the warnings of ``shots``, alike but for their numbers taken together, with the shots that have them."""
    kinds: dict[str, dict[int, str]] = {}
    for shot in shots:
        for text in shot.warnings:
            kinds.setdefault(re.sub(r"\d[\d., ]*", "#", text), {}).setdefault(shot.shot + 1, text)
    if len(shots) == 1:
        return list(shots[0].warnings)
    return [_words(by_shot, len(shots)) for by_shot in kinds.values()]


def _words(by_shot: dict[int, str], shots: int) -> str:
    numbers = ", ".join(map(str, list(by_shot)[:MOST_NUMBERS]))
    if len(by_shot) > MOST_NUMBERS:
        numbers += f" ... ({len(by_shot)} of {shots} shots)"
    first, text = next(iter(by_shot.items()))
    example = "" if len(set(by_shot.values())) == 1 else f"such as in shot {first}, "
    return f"shot {numbers}: {example}{text}"


def json_values(value: Any) -> Any:
    """Return nested tables and lists with null for numbers that JSON does not have, such as an infinite ratio."""
    if isinstance(value, Mapping):
        return {key: json_values(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [json_values(inner) for inner in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
