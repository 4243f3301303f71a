"""Scene: what is measured and on which specimen. TOML, SI units, the unit in every key; validated at once."""

from __future__ import annotations

import itertools
import math
import os
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    PrivateAttr,
    ValidationInfo,
    WithJsonSchema,
    model_validator,
)

from hpe_rig.scene.estimator_table import BUILT_IN_ESTIMATORS, checked_estimator, properties_of
from hpe_rig.scene.notes import Notes
from hpe_rig.scene.quantities import (
    AmplitudeM,
    Count,
    DelayS,
    DensityKgPerM3,
    DurationS,
    Fraction,
    FrequencyHz,
    LengthM,
    ModulusPa,
    RatioDb,
    SpeedMPerS,
    VibrationHz,
    ViscosityPaS,
    VoltageV,
    Widths,
)
from hpe_rig.scene.validation import (
    STORED,
    Mistake,
    SettingsError,
    mistakes_of,
    named_text,
    parse_toml,
    path_of,
    validated,
)

if TYPE_CHECKING:
    from hpe_rig.scene.points import ScenePoint

Offset = Annotated[float, Field(ge=-0.1, le=0.1, strict=True)]


def _known_estimator(name: str, info: ValidationInfo) -> str:
    return checked_estimator(name, stored=info.context == STORED)


Estimator = Annotated[
    str,
    Field(strict=True, json_schema_extra={"examples": list(BUILT_IN_ESTIMATORS)}),
    AfterValidator(_known_estimator),
]
"""Name of an estimator, of this package or of an installed one."""


def _as_list(value: Any) -> Any:
    return value if isinstance(value, list | tuple) else [value]


OneOrMoreDurations = Annotated[
    tuple[DurationS, ...],
    BeforeValidator(_as_list, json_schema_input_type=DurationS | list[DurationS]),
    Field(min_length=1),
]
OneOrMoreFractions = Annotated[
    tuple[Fraction, ...],
    BeforeValidator(_as_list, json_schema_input_type=Fraction | list[Fraction]),
    Field(min_length=1),
]


def _one_line(text: str) -> str:
    if len(text) > MOST_TITLE or not text.isprintable():
        raise ValueError(f"a title is one line of at most {MOST_TITLE} characters: shorten it, without line breaks")
    return text


def _number(value: Any) -> Any:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise ValueError(f"{str(value)[:40]!r} is no number: a finite number without quotes")
    return value


AnyNumber = Annotated[Any, AfterValidator(_number), WithJsonSchema({"type": "number"})]
MOST_TITLE = 300
MOST_WIDTHS = 8.0
"""Sigmas from the middle of a force beyond which it moves 1e-14 of what it does there."""
Title = Annotated[str, AfterValidator(_one_line)]


class Section(BaseModel):
    """A frozen table of settings that refuses keys it does not know."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, defer_build=True)


class Excitation(Section):
    """The tonebursts that push; without this section nothing pushes and no excitation generator is opened."""

    burst_rate_hz: FrequencyHz
    """Repetition rate f_r of the tonebursts."""
    burst_length_s: OneOrMoreDurations
    """Length T_b of a toneburst; a list measures each length in turn."""
    burst_count: Count
    """Number of tonebursts in a train."""
    carrier_hz: FrequencyHz = 3.0e6
    """Frequency f_0 of the toneburst."""
    force_fraction: OneOrMoreFractions = (1.0,)
    """Radiation force F as a fraction of F_0, the force at the bench's full drive; a list measures each in turn."""


class Tracking(Section):
    """The pulses that track the motion."""

    pulse_rate_hz: FrequencyHz
    """Repetition rate f_prf of the tracking pulses."""
    delay_s: DelayS = 0.0
    """Delay t_d from the master trigger to the start of the tracking train."""
    pulse_count: Count | None = None
    """Number of tracking pulses; absent: as many periods as the burst train lasts."""
    cycles: Annotated[int, Field(ge=1, le=1000, strict=True)] = 3
    """Cycles of one tracking pulse."""
    lateral_offset_m: Offset = 0.0
    """Where the tracking transducer's axis lies beside the push, along x; what moves is tracked there."""
    axial_offset_m: Offset = 0.0
    """Where the gate's middle lies beyond acquisition.gate_depth_m."""
    offset_uncertainty_m: Annotated[float, Field(ge=0, le=0.01, strict=True)] = 20e-6
    """Standard uncertainty of the lateral offset, as the stage or its operator can set it (assumed)."""
    carrier_hz: FrequencyHz = 9.0e6
    """Frequency f_f of the tracking pulse."""
    disturbed: Literal["refuse", "skip", "keep"] = "refuse"
    """What to do where a toneburst or its echo meets a tracking pulse or gate: refuse the scene; measure and leave
    those pulses out of the estimate (a pulse rate that is no multiple of the burst rate cannot avoid a few); or keep
    them with a warning."""


class Acquisition(Section):
    """What is recorded."""

    gate_depth_m: LengthM
    """Distance from the transducer to the middle of the gate."""
    gate_length_m: LengthM = 1.0e-3
    """Gate length l_g."""
    sound_speed_m_per_s: SpeedMPerS = 1540.0
    """Longitudinal sound speed c assumed between transducer and gate."""
    sound_speed_uncertainty: Annotated[float, Field(ge=0, le=0.5, strict=True)] = 0.005
    """Relative standard uncertainty of that sound speed; every displacement goes with it."""
    sample_rate_hz: FrequencyHz = 100.0e6
    """Sampling rate F_s of the digitizer."""
    record_samples: Annotated[int, Field(ge=1, le=10_000_000, strict=True)] = 512
    """Samples of one record; the record is placed around the gate."""
    input_range_v: VoltageV = 0.8
    """Full scale of the digitizer's input, plus and minus; absent: the board's smallest range of at least this."""
    repeats: Count = 1
    """How often every shot is repeated."""
    shot_period_s: DurationS | None = None
    """Time between master triggers; absent: as soon as the trains have ended."""
    changed_settings: Literal["stop", "continue"] = "stop"
    """What follows a shot after which settings are not as before it; it is marked as untrusted either way."""


class Beams(Section):
    """What is known of the beams; without this section no beam-averaging factor is predicted."""

    excitation_width_m: Widths
    """E_x, E_y, E_z: sigmas of the displacement's Gaussian, eq. (12)."""
    tracking_width_m: Widths
    """T_x, T_y, T_z: sigmas of the tracking beam's Gaussian, eq. (8)."""
    pulse_length_m: Annotated[LengthM, Field(le=0.1)] | None = None
    """Axial length c T / 2 of the tracking pulse as received, T its full length; absent: that of its cycles."""
    focus_depth_m: LengthM | None = None
    """Distance from the transducer to the common focus; absent: the middle of the gate, put there by its echoes."""
    push_focus_depth_m: LengthM | None = None
    """The same of a pushing transducer that does not track; absent: one transducer does both. Needs focus_depth_m."""
    transducer_diameter_m: Annotated[LengthM, Field(le=1.0)] | None = None
    """Diameter of the circular, focused aperture that pushes and tracks: its intensity is the force's shape, and its
    oblique waves sense less of a displacement; absent: a Gaussian force and plane waves. Of two transducers that of
    the one that tracks, the force is Gaussian."""
    excitation_scan: Annotated[str, Field(min_length=1)] | None = None
    """Hydrophone's scan of the push, a CSV, HDF5 or MAT file: its intensity is the force's shape, whatever else is
    declared. Its path is taken from the folder in which a command runs. It is read again whenever a run is processed,
    from beside the run file where it is no longer there."""
    attenuation_db_per_cm_mhz: Annotated[float, Field(ge=0, le=10, strict=True)] | None = None
    """Attenuation of the push on its way, of an aperture; absent: 0.5, that of soft tissue. Of a scan: what the
    specimen adds to it around the focus; absent: none, within half of soft tissue's."""

    @model_validator(mode="after")
    def _two_distances_have_one_focus(self) -> Beams:
        if self.push_focus_depth_m is not None and self.focus_depth_m is None:
            raise ValueError("push_focus_depth_m is of the focus that focus_depth_m is of: give both")
        return self

    @property
    def push_farther_m(self) -> float:
        """How much farther from the focus the transducer stands that pushes than the one that tracks."""
        if self.push_focus_depth_m is None or self.focus_depth_m is None:
            return 0.0
        return self.push_focus_depth_m - self.focus_depth_m


class Medium(Section):
    """What is known of the specimen, a Voigt medium; it narrows the ensemble of media that the prior is made of.

    Without it the motion itself tells, as far as it can, how much of the peak is tracked.
    """

    shear_modulus_pa: ModulusPa
    """Shear elasticity mu1."""
    shear_viscosity_pa_s: ViscosityPaS
    """Shear viscosity mu2."""
    density_kg_per_m3: DensityKgPerM3 = 1000.0
    """Mass density."""


class Sphere(Section):
    """A rigid sphere in the medium, which the tonebursts push and whose front echoes, in place of [beams].

    It moves as a whole, so that nothing is averaged over the beam, and its vibration calibrates the medium's moduli.
    """

    radius_m: LengthM
    """Radius of the sphere, as its maker states it."""
    density_kg_per_m3: Annotated[float, Field(ge=100, le=20_000, strict=True)] = 7650.0
    """Its own mass density, that of steel unless given."""


class Gate(Section):
    """One more gate of the same records."""

    depth_m: LengthM
    """Distance from the transducer to its middle."""
    length_m: LengthM | None = None
    """Its length; absent: acquisition.gate_length_m."""


class Processing(Section):
    """How records become amplitude and phase."""

    estimator: Estimator = "coherent"
    """Motion estimator; cross_spectrum is the paper's chain."""
    harmonic: Literal["medium_prior", "least_squares", "kalman"] | None = None
    """How displacement becomes amplitude and phase; cross_spectrum has its own way. Absent: medium_prior,
    all harmonics of the tonebursts with a prior of media, where there is a train of them, [beams], and the wanted
    frequencies are multiples of its rate; else least_squares."""
    process_noise: Annotated[float, Field(ge=0, le=1e6, strict=True)] = 0.0
    """Change per pulse of a harmonic state that harmonic = "kalman" follows, variance over that of a pulse's noise."""
    background_order: Annotated[int, Field(ge=0, le=20, strict=True)] = 0
    """Background fitted along: 0 constant, 1 velocity, 2 acceleration, more: drift; cross_spectrum has a band-pass for
    it, and takes this for its u alone."""
    flag_pulses: Annotated[bool, Field(strict=True)] = True
    """Leave pulses out whose gate holds an energy unlike the others': leaked tonebursts, spikes, lost echoes."""
    follow_gate: Annotated[bool, Field(strict=True)] = False
    """Let the gate follow background motion longer than itself, such as heart beat or breathing, through the record;
    fit the background with background_order. Not with a reference gate."""
    reference_gate_depth_m: LengthM | None = None
    """Middle of a second gate, inside the record, whose echoes do not move: its apparent motion, the trigger jitter, is
    subtracted."""
    reference_gate_length_m: LengthM | None = None
    """Length of that gate; absent: acquisition.gate_length_m."""
    gates: Annotated[tuple[Gate, ...], Field(max_length=1000)] = ()
    """More gates, inside the record: amplitude and phase over depth from one acquisition."""
    gate_profile_step_m: LengthM | None = None
    """The same in gates of acquisition.gate_length_m, so far apart, as many as the record holds around the gate."""
    expected_snr_db: RatioDb | None = None
    """Echo power over noise power in the gate, for the prediction; absent: as the twin simulates."""
    expected_amplitude_m: AmplitudeM | None = None
    """Displacement amplitude, for the prediction; absent: as the twin's motion prescribes, or 100 nm."""
    frequencies_hz: Annotated[tuple[VibrationHz, ...], Field(min_length=1)] | None = None
    """Vibration frequencies f_v wanted; absent: f_r and its multiples up to the tenth below f_prf / 2."""
    window_start_s: DelayS = 0.0
    """Start of the slow-time window after the first tracking pulse."""
    window_length_s: DurationS | None = None
    """Length T_s of the slow-time window; absent: to the last pulse."""
    synchronous: Annotated[bool, Field(strict=True)] = False
    """Require a burst period that is a whole multiple of the pulse period."""

    @model_validator(mode="after")
    def _one_that_follows(self, info: ValidationInfo) -> Processing:
        if info.context == STORED:
            return self
        if self.follow_gate and self.reference_gate_depth_m is not None:
            raise ValueError("a reference gate stands still where follow_gate moves: remove one of them")
        return self

    @model_validator(mode="after")
    def _one_profile_of_standing_gates(self, info: ValidationInfo) -> Processing:
        if info.context == STORED:
            return self
        if self.gates and self.gate_profile_step_m is not None:
            raise ValueError("gates and gate_profile_step_m both say where gates over depth lie: remove one of them")
        if self.follow_gate and (self.gates or self.gate_profile_step_m is not None):
            raise ValueError("gates over depth stand still where follow_gate moves: remove one of them")
        return self

    @model_validator(mode="after")
    def _harmonic_that_is_used(self, info: ValidationInfo) -> Processing:
        if info.context == STORED:
            return self
        if self.harmonic == "medium_prior" and properties_of(self.estimator).velocity_chain:
            raise ValueError(
                f'{self.estimator} has its own way to amplitude and phase and takes no harmonic = "medium_prior": '
                'remove it, or set estimator = "coherent"'
            )
        if self.process_noise and self.harmonic != "kalman":
            raise ValueError(
                "process_noise is that of the Kalman filter, which is not chosen: "
                'set harmonic = "kalman", or remove process_noise'
            )
        return self


def _flat(tables: Mapping[str, Any], before: str = "") -> Iterator[tuple[str, Any]]:
    """Yield what stands in nested tables by its dotted path."""
    for name, value in tables.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{before}{name}.")
        else:
            yield f"{before}{name}", value


class Sweep(Section):
    """Settings that are taken in turn besides forces and burst lengths; one run, one report.

    Besides the keys below, any number of the scene, or of the bench file as "bench.PATH", by its name, with its values:
    "tracking.delay_s" = [0.0, 1e-4].
    """

    model_config = ConfigDict(json_schema_extra={"additionalProperties": True})

    pulse_rate_hz: Annotated[tuple[FrequencyHz, ...], Field(min_length=1, max_length=100)] = ()
    """Pulse rates f_prf, measured in turn in place of tracking.pulse_rate_hz, with equally many pulses each."""
    window_length_s: Annotated[tuple[DurationS, ...], Field(min_length=1, max_length=100)] = ()
    """Slow-time windows T_s, taken in turn from the same records in place of processing.window_length_s."""
    lateral_offset_m: Annotated[tuple[Offset, ...], Field(min_length=1, max_length=1000)] = ()
    """Places of the tracking transducer beside the push, taken in turn in place of tracking.lateral_offset_m; between
    them every output is off, and a stage or the operator moves it."""
    axial_offset_m: Annotated[tuple[Offset, ...], Field(min_length=1, max_length=100)] = ()
    """Offsets of the gate along the beam, taken in turn in place of tracking.axial_offset_m."""
    axes: dict[str, Annotated[tuple[AnyNumber, ...], Field(min_length=1, max_length=1000)]] = Field(
        default_factory=dict, max_length=10
    )
    """Any other numbers, each with its values; keys that stand in [sweep] itself are put here."""
    combine: Literal["product", "zip"] = "product"
    """How several axes go together: each value with each, or the first values, the second ones and so on."""

    @model_validator(mode="before")
    @classmethod
    def _axes_among_the_keys(cls, given: Any) -> Any:
        if not isinstance(given, Mapping):
            return given
        own = {name: value for name, value in given.items() if name in cls.model_fields}
        others = dict(_flat({name: value for name, value in given.items() if name not in cls.model_fields}))
        if not others:
            return given
        axes = own.get("axes", {})
        return {**own, "axes": {**axes, **others}} if isinstance(axes, Mapping) else given


class Scene(Section):
    """One measurement."""

    title: Title
    """One line that says what is measured."""
    excitation: Excitation | None = None
    """The tonebursts that push."""
    tracking: Tracking
    """The pulses that track."""
    acquisition: Acquisition
    """What is recorded."""
    beams: Beams | None = None
    """What is known of the beams."""
    medium: Medium | None = None
    """What is known of the specimen, for beam averaging and the prior of media."""
    sphere: Sphere | None = None
    """A rigid sphere that is pushed and tracked instead of the medium."""
    processing: Processing = Processing()
    """How records become amplitude and phase."""
    sweep: Sweep = Sweep()
    """Pulse rates and windows that are taken in turn."""
    notes: Notes = Field(default_factory=dict)
    """Operator, sample, temperature or anything else, by names of one's own; kept with run, result and report."""
    simulation: dict[str, Any] | None = None
    """What the twin simulates, in the twin's own words; a real bench leaves it out."""
    _default_specimen: str | None = PrivateAttr(default=None)

    @property
    def default_specimen(self) -> str | None:
        """Name of the specimen that ``with_default_specimen`` filled in; None where the scene's own settings hold."""
        return self._default_specimen

    def with_(self, values: Mapping[str, Any]) -> Scene:
        """Return the scene with ``values`` by their full path; sections that are absent are made.

        ``scene.with_({"tracking.pulse_rate_hz": 4000.0, "excitation.force_fraction": [0.5, 1.0]})``; an entry of a list
        is ``"excitation.force_fraction[0]"``. Raises ``SettingsError`` with every mistake, ``TypeError`` for what is no
        mapping from text to values.
        """
        # keys.py describes a scene and so imports this file.
        from hpe_rig.scene.keys import with_values

        if not isinstance(values, Mapping):
            raise TypeError(f"settings are taken as a mapping from path to value, not as {type(values).__name__}")
        if wrong := [name for name in values if not isinstance(name, str)]:
            raise TypeError(f"a setting is named by its path in text, not by {type(wrong[0]).__name__} {wrong[0]!r}")
        tables = with_values(plain_tables(self), {path_of(name): value for name, value in values.items()})
        return validated(Scene, tables, "the scene")

    @property
    def wanted_frequencies_hz(self) -> tuple[float, ...]:
        """Vibration frequencies to estimate, in Hz, as asked or as the excitation implies."""
        if self.processing.frequencies_hz is not None:
            return self.processing.frequencies_hz
        if self.excitation is None:
            return ()
        rate_hz, slowest_hz = self.excitation.burst_rate_hz, min(self.pulse_rates_hz)
        return tuple(n * rate_hz for n in range(1, 11) if n * rate_hz < slowest_hz / 2)

    @property
    def without_prior(self) -> str | None:
        """Why no prior of media can stand for the harmonics of the tonebursts; None where one can."""
        if self.excitation is None:
            return "the scene has no [excitation]"
        if self.excitation.burst_count == 1:
            return "excitation.burst_count is 1, and one toneburst makes no periodic motion"
        if self.beams is None and self.sphere is None:
            return "the scene has no [beams]"
        number = [hz / self.excitation.burst_rate_hz for hz in self.wanted_frequencies_hz]
        if any(round(n) == 0 or not math.isclose(n, round(n), rel_tol=1e-6) for n in number):
            return "processing.frequencies_hz are not all multiples of excitation.burst_rate_hz"
        return None

    @property
    def gate_depth_m(self) -> float:
        """Distance from the transducer to the middle of the gate where it stands now."""
        return self.acquisition.gate_depth_m + self.tracking.axial_offset_m

    @property
    def points(self) -> tuple[ScenePoint, ...]:
        """The scene at each point of the sweep's axes, in the order in which they are measured; see ``sweep.axes``."""
        # It makes scenes, and so imports this file.
        from hpe_rig.scene.points import points_of_sweep

        return points_of_sweep(self)

    @property
    def pulse_rates_hz(self) -> tuple[float, ...]:
        """Pulse rates that are measured in turn."""
        return self.sweep.pulse_rate_hz or (self.tracking.pulse_rate_hz,)

    @property
    def windows(self) -> tuple[Scene, ...]:
        """The scene once for each slow-time window that is taken of its records."""
        lengths_s = self.sweep.window_length_s or (self.processing.window_length_s,)
        each = (self.processing.model_copy(update={"window_length_s": length_s}) for length_s in lengths_s)
        return tuple(self.model_copy(update={"processing": processing}) for processing in each)

    @property
    def places(self) -> tuple[Scene, ...]:
        """The scene once for each place of the tracking transducer, its other settings the same."""
        sweep, tracking = self.sweep, self.tracking
        if not (sweep.lateral_offset_m or sweep.axial_offset_m):
            return (self,)
        alike = {"sweep": sweep.model_copy(update={"lateral_offset_m": (), "axial_offset_m": ()})}
        lateral, axial = sweep.lateral_offset_m or (tracking.lateral_offset_m,), sweep.axial_offset_m
        each = itertools.product(lateral, axial or (tracking.axial_offset_m,))
        moved = (tracking.model_copy(update={"lateral_offset_m": x, "axial_offset_m": z}) for x, z in each)
        return tuple(self.model_copy(update={**alike, "tracking": one}) for one in moved)

    @property
    def rates(self) -> tuple[Scene, ...]:
        """The scene once for each pulse rate, its other settings the same: frequencies and number of pulses too."""
        if not self.sweep.pulse_rate_hz:
            return (self,)
        processing = self.processing.model_copy(update={"frequencies_hz": self.wanted_frequencies_hz or None})
        count = self.tracking.pulse_count
        if count is None and self.excitation is not None:
            train_s = self.excitation.burst_count / self.excitation.burst_rate_hz
            count = max(1, math.floor(train_s * max(self.sweep.pulse_rate_hz) + 1e-6))
        alike = {"processing": processing, "sweep": self.sweep.model_copy(update={"pulse_rate_hz": ()})}
        each = (
            self.tracking.model_copy(update={"pulse_rate_hz": rate_hz, "pulse_count": count})
            for rate_hz in self.sweep.pulse_rate_hz
        )
        return tuple(self.model_copy(update={**alike, "tracking": tracking}) for tracking in each)

    @model_validator(mode="after")
    def _prior_only_of_tonebursts(self, info: ValidationInfo) -> Scene:
        if info.context == STORED:
            return self
        if self.processing.harmonic == "medium_prior" and self.without_prior is not None:
            raise ValueError(
                f'processing.harmonic = "medium_prior" needs more, {self.without_prior}: set harmonic = "least_squares"'
            )
        return self

    @model_validator(mode="after")
    def _sphere_moves_as_a_whole(self, info: ValidationInfo) -> Scene:
        if info.context != STORED and self.sphere is not None and self.beams is not None:
            raise ValueError(
                "[sphere] moves as a whole, and nothing of it is averaged over [beams]: leave one of the two out"
            )
        over_depth = self.processing.gates or self.processing.gate_profile_step_m is not None
        if info.context != STORED and self.sphere is not None and over_depth:
            raise ValueError(
                "gates over depth see the medium, which moves unlike its [sphere]: leave one of the two out"
            )
        return self

    @model_validator(mode="after")
    def _aperture_is_part_of_its_sphere(self, info: ValidationInfo) -> Scene:
        if info.context == STORED or self.beams is None or self.beams.transducer_diameter_m is None:
            return self
        focus_m = self.beams.focus_depth_m or self.acquisition.gate_depth_m
        if self.beams.transducer_diameter_m >= 2 * focus_m:
            raise ValueError(
                f"beams.transducer_diameter_m is {self.beams.transducer_diameter_m:g} m, and a bowl that focuses at "
                f"{focus_m:g} m (beams.focus_depth_m, else the gate's depth) is less than {2 * focus_m:g} m across"
            )
        return self

    @model_validator(mode="after")
    def _gate_meets_the_force(self, info: ValidationInfo) -> Scene:
        if info.context == STORED:
            return self
        if self.beams is None or self.beams.focus_depth_m is None:
            return self
        off_m, width_m = abs(self.acquisition.gate_depth_m - self.beams.focus_depth_m), self.beams.excitation_width_m[2]
        if off_m > MOST_WIDTHS * width_m:
            raise ValueError(
                f"acquisition.gate_depth_m lies {off_m:.3g} m from beams.focus_depth_m, {off_m / width_m:.3g} times "
                "beams.excitation_width_m along the beam, where nothing moves: equal depths, or no focus_depth_m"
            )
        return self

    @model_validator(mode="after")
    def _pulse_has_a_cycle(self, info: ValidationInfo) -> Scene:
        if info.context == STORED:
            return self
        length_m = None if self.beams is None else self.beams.pulse_length_m
        half_wave_m = self.acquisition.sound_speed_m_per_s / (2 * self.tracking.carrier_hz)
        if length_m is not None and length_m < half_wave_m:
            raise ValueError(
                f"beams.pulse_length_m is {length_m:g} m, where a single cycle of tracking.carrier_hz takes "
                f"{half_wave_m:.3g} m: a larger value, or none for that of tracking.cycles"
            )
        return self

    @model_validator(mode="after")
    def _windows_within_slow_trains(self, info: ValidationInfo) -> Scene:
        if info.context == STORED:
            return self
        windows_s = self.sweep.window_length_s or (self.processing.window_length_s,)
        if self.sweep.pulse_rate_hz and None in windows_s:
            raise ValueError(
                "sweep.pulse_rate_hz gives slower trains that outlast the tonebursts: set processing.window_length_s "
                "or sweep.window_length_s, so that the same stretch of each is taken"
            )
        return self


@dataclass(frozen=True, slots=True)
class SceneText:
    """A scene with the text that it was read from, kept verbatim for the run file."""

    name: str
    text: str
    scene: Scene


SimulationCheck = Callable[[Mapping[str, Any]], list[Mistake]]


def parse_scene(
    name: str, text: str, simulation_check: SimulationCheck | None = None, stored: bool = False
) -> SceneText:
    """Return the scene in ``text``; raise ``SettingsError`` with every mistake.

    ``simulation_check`` is the twin's own check of ``[simulation]`` in the scene's tables; None leaves it unread. A
    ``stored`` scene, of a run file, has been measured: rules on which settings go together do not hold for it, since
    they may be younger than the run.
    """
    tables, context = parse_toml(text, f"scene {name}"), STORED if stored else None
    if {"generators", "limits"} <= tables.keys():
        mistake = Mistake("", "this is a bench file, not a scene", "a scene, and this file behind --bench")
        raise SettingsError(f"scene {name}", [mistake])
    mistakes = mistakes_of(Scene, tables, context=context)
    if simulation_check is not None:
        mistakes += simulation_check(tables)
    if mistakes:
        raise SettingsError(f"scene {name}", mistakes)
    scene = Scene.model_validate(tables, context=context)
    if scene.sweep.axes:
        # It describes a scene's keys, and so imports this file.
        from hpe_rig.scene.points import swept_twice

        if mistakes := swept_twice(scene):
            raise SettingsError(f"scene {name}", mistakes)
    return SceneText(name, text, scene)


def shipped_scenes() -> dict[str, str]:
    """Return the shipped scenes' texts by name."""
    folder = resources.files("hpe_rig.scene") / "shipped"
    files = sorted((file for file in folder.iterdir() if file.name.endswith(".toml")), key=lambda file: file.name)
    return {file.name.removesuffix(".toml"): file.read_text(encoding="utf-8") for file in files}


SceneSource = str | os.PathLike[str] | Scene
"""What is taken as a scene: the name of a shipped one, the path of a TOML file, or a ``Scene``."""


def load_scene(source: SceneSource) -> Scene:
    """Return the scene that ``source`` names: a shipped one's name, a TOML file's path, or a ``Scene`` itself.

    Raises ``SettingsError`` with every mistake, and ``TypeError`` for anything else.

    >>> load_scene("table-1").tracking.pulse_rate_hz
    4000.0
    """
    return source if isinstance(source, Scene) else parse_scene(*scene_text(source)).scene


def scene_text(source: SceneSource) -> tuple[str, str]:
    """Return the name and the TOML text of a scene; raises as ``load_scene``, naming the shipped scenes."""
    if isinstance(source, Scene):
        return "scene", _toml(source)
    if not isinstance(source, str | os.PathLike):
        taken = "the name of a shipped one, the path of a TOML file or a Scene"
        raise TypeError(f"a scene is taken as {taken}, not as {type(source).__name__}")
    return named_text(source, shipped_scenes(), "scene")


DEFAULT_SPECIMEN = "default muscle"
"""Name of the specimen that the twin takes where a scene has no [simulation]."""
DEFAULT_SPECIMEN_SCENE = "bovine-muscle"
"""The shipped scene whose [simulation] it is; its comments say where each value comes from."""


def with_default_specimen(scene: Scene) -> Scene:
    """Return ``scene`` with the default muscle, in focus at the gate, where it has no [simulation].

    Without [beams] the muscle's own push it, those of the transducer.
    """
    if scene.simulation is not None:
        return scene
    muscle = _default_specimen()
    apart = scene.beams is not None and scene.beams.push_focus_depth_m is not None
    beams: dict[str, Any] = {} if apart else {"focus_depth_m": scene.acquisition.gate_depth_m}
    if scene.beams is None and muscle.beams is not None:
        beams["excitation_width_m"] = muscle.beams.excitation_width_m
    simulation = {**(muscle.simulation or {}), "beams": beams}
    filled = scene.model_copy(update={"simulation": simulation})
    filled._default_specimen = DEFAULT_SPECIMEN
    return filled


@cache
def _default_specimen() -> Scene:
    return load_scene(DEFAULT_SPECIMEN_SCENE)


def plain_tables(scene: Scene) -> dict[str, Any]:
    """Return what was set in ``scene``, as the tables of a TOML file."""
    tables: dict[str, Any] = _plain(scene.model_dump(exclude_unset=True, exclude_none=True))
    return tables


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _plain(inner) for key, inner in value.items()}
    return [_plain(inner) for inner in value] if isinstance(value, list | tuple) else value


def _toml(scene: Scene) -> str:
    import tomlkit

    tables = plain_tables(scene)
    if scene.default_specimen is not None:
        # What was filled in is nobody's setting: it is filled in again where a twin needs it.
        del tables["simulation"]
    return tomlkit.dumps(tables)
