"""Sections of a scene: the settings of one measurement, in SI units, the unit in every key.

The docstring below a key is its description in the reference and in the file that ``hpe-rig new --full`` writes.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Field, ValidationInfo, model_validator

from hpe_rig.scene.estimator_table import HarmonicFitName, properties_of
from hpe_rig.scene.quantities import (
    AmplitudeM,
    AnyNumber,
    Count,
    DelayS,
    DensityKgPerM3,
    DurationS,
    Estimator,
    FrequencyHz,
    LengthM,
    ModulusPa,
    OffsetM,
    OneOrMoreDurations,
    OneOrMoreFractions,
    RatioDb,
    SampleRateHz,
    SpeedMPerS,
    VibrationHz,
    ViscosityPaS,
    VoltageV,
    Widths,
)
from hpe_rig.scene.validation import STORED, Section


def refuse_first(conflicts: Iterator[str], info: ValidationInfo) -> None:
    """Raise ``ValueError`` with the first of the conflicts between settings, unless the scene is a stored one."""
    if info.context != STORED and (conflict := next(conflicts, None)):
        raise ValueError(conflict)


class Excitation(Section):
    """The tonebursts that push; without this section nothing pushes and no excitation generator is opened."""

    burst_rate_hz: FrequencyHz
    """Repetition rate f_r of the tonebursts."""
    burst_length_s: OneOrMoreDurations
    """Length T_b of a toneburst; a list measures every length."""
    burst_count: Count
    """Number of tonebursts in a train."""
    carrier_hz: FrequencyHz = 3.0e6
    """Frequency f_0 of the toneburst."""
    force_fraction: OneOrMoreFractions = (1.0,)
    """Radiation force F as a fraction of F_0, the force at the bench's full drive; a list measures every one."""


class Tracking(Section):
    """The pulses that track the motion."""

    pulse_rate_hz: FrequencyHz
    """Repetition rate f_prf of the tracking pulses."""
    delay_s: DelayS = 0.0
    """Delay t_d from the master trigger to the start of the tracking train."""
    pulse_count: Count | None = None
    """Number of tracking pulses; default: as many periods as the burst train lasts."""
    cycles: Annotated[int, Field(ge=1, le=1000, strict=True)] = 3
    """Cycles of one tracking pulse."""
    lateral_offset_m: OffsetM = 0.0
    """Offset along x of the tracking transducer's axis from the axis of the push; the motion is tracked there."""
    axial_offset_m: OffsetM = 0.0
    """Offset along the beam of the gate's centre from acquisition.gate_depth_m."""
    offset_uncertainty_m: Annotated[float, Field(ge=0, le=0.01, strict=True)] = 20e-6
    """Standard uncertainty of the lateral offset, as a stage or an operator sets it (assumed)."""
    carrier_hz: FrequencyHz = 9.0e6
    """Frequency f_f of the tracking pulse."""
    disturbed: Literal["refuse", "skip", "keep"] = "refuse"
    """What to do if a toneburst or its echo overlaps a tracking pulse or gate: refuse the scene; measure and skip
    those pulses in the estimate (necessary at a pulse rate that is no multiple of the burst rate); or keep them with a
    warning."""


class Acquisition(Section):
    """The records of the digitizer."""

    gate_depth_m: LengthM
    """Distance from the transducer to the centre of the gate."""
    gate_length_m: LengthM = 1.0e-3
    """Gate length l_g."""
    sound_speed_m_per_s: SpeedMPerS = 1540.0
    """Longitudinal sound speed c assumed between transducer and gate."""
    sound_speed_uncertainty: Annotated[float, Field(ge=0, le=0.5, strict=True)] = 0.005
    """Relative standard uncertainty of that sound speed; every displacement is proportional to it."""
    sample_rate_hz: SampleRateHz = 100.0e6
    """Sampling rate F_s of the digitizer."""
    record_samples: Annotated[int, Field(ge=1, le=10_000_000, strict=True)] = 512
    """Samples of one record; the record is centred on the gate."""
    input_range_v: VoltageV = 0.8
    """Full scale of the digitizer's input, plus and minus; default: the board's smallest range of at least this."""
    repeats: Count = 1
    """Number of times that every shot is repeated."""
    shot_period_s: DurationS | None = None
    """Time between master triggers; default: the length of the trains."""
    changed_settings: Literal["stop", "continue"] = "stop"
    """Action after a shot with changed settings; the shot is marked as untrusted in both cases."""
    control: Annotated[bool, Field(strict=True)] = False
    """Whether each shot is followed by its control, the same shot with the toneburst generator's output off. The motion
    at the wanted frequencies in the control, such as a hum, is subtracted from that in the shot."""


class Beams(Section):
    """Shapes of the beams; without this section no beam-averaging factor is predicted."""

    excitation_width_m: Widths
    """E_x, E_y, E_z: standard deviations of the displacement's Gaussian, eq. (12)."""
    tracking_width_m: Widths
    """T_x, T_y, T_z: standard deviations of the tracking beam's Gaussian, eq. (8)."""
    pulse_length_m: Annotated[LengthM, Field(le=0.1)] | None = None
    """Axial length c T / 2 of the received tracking pulse of full length T; default: from its cycles."""
    focus_depth_m: LengthM | None = None
    """Distance from the transducer to the common focus; default: the centre of the gate, adjusted by its echoes."""
    push_focus_depth_m: LengthM | None = None
    """Distance to the focus from a pushing transducer that does not track; default: one transducer does both. Needs
    focus_depth_m."""
    transducer_diameter_m: Annotated[LengthM, Field(le=1.0)] | None = None
    """Diameter of the circular, focused aperture that pushes and tracks: the force has the shape of its intensity, and
    its oblique waves measure less of a displacement; default: a Gaussian force and plane waves. With two transducers
    it is that of the tracking one, and the force is Gaussian."""
    excitation_scan: Annotated[str, Field(min_length=1)] | None = None
    """Hydrophone scan of the push, a CSV, HDF5 or MAT file; the force has the shape of its intensity, whatever other
    keys say. The path is relative to the working directory. The file is read again whenever a run is
    processed, from the folder of the run file if it is no longer at its path."""
    attenuation_db_per_cm_mhz: Annotated[float, Field(ge=0, le=10, strict=True)] | None = None
    """Attenuation of the push between transducer and focus, for an aperture; default: 0.5, as in soft tissue. For a
    scan: the specimen's additional attenuation around the focus; default: none, within half of soft tissue's."""

    @model_validator(mode="after")
    def _two_distances_have_one_focus(self) -> Beams:
        if self.push_focus_depth_m is not None and self.focus_depth_m is None:
            raise ValueError("push_focus_depth_m needs focus_depth_m, the other transducer's distance: give both")
        return self

    @property
    def push_farther_m(self) -> float:
        """Distance to the focus of the pushing transducer minus that of the tracking transducer."""
        if self.push_focus_depth_m is None or self.focus_depth_m is None:
            return 0.0
        return self.push_focus_depth_m - self.focus_depth_m


class Medium(Section):
    """Known properties of the specimen, a Voigt medium; they narrow the ensemble of media behind the prior.

    Without this section the fraction of the peak displacement that is tracked is estimated from the motion.
    """

    shear_modulus_pa: ModulusPa
    """Shear elasticity mu1."""
    shear_viscosity_pa_s: ViscosityPaS
    """Shear viscosity mu2."""
    density_kg_per_m3: DensityKgPerM3 = 1000.0
    """Mass density."""


class Sphere(Section):
    """A rigid sphere in the medium that the tonebursts push and that returns the echoes, instead of [beams].

    It moves as a whole, so that no beam averages its motion; its vibration calibrates the moduli of the medium.
    """

    radius_m: LengthM
    """Radius of the sphere, as its maker states it."""
    density_kg_per_m3: Annotated[float, Field(ge=100, le=20_000, strict=True)] = 7650.0
    """Mass density of the sphere; default: steel."""


class Gate(Section):
    """One more gate in the same records."""

    depth_m: LengthM
    """Distance from the transducer to its centre."""
    length_m: LengthM | None = None
    """Its length; default: acquisition.gate_length_m."""


UNSTATED_FREQUENCY_ACCURACY = 50e-6
"""Standard uncertainty of a frequency by the clock of the pulses if nothing is stated: two quartz clocks, each within
50 ppm (uniform), differ by 41 ppm rms."""


class Processing(Section):
    """How amplitude and phase are estimated from the records."""

    estimator: Estimator = "coherent"
    """Motion estimator; cross_spectrum is the paper's chain."""
    harmonic: HarmonicFitName | None = None
    """Fit of amplitude and phase to the displacement; cross_spectrum includes a fit. Default: medium_prior (all
    harmonics of the tonebursts, with a prior of media) for a train of tonebursts with [beams] and frequencies that are
    multiples of its rate, otherwise least_squares."""
    process_noise: Annotated[float, Field(ge=0, le=1e6, strict=True)] = 0.0
    """For harmonic = "kalman": variance of a harmonic state's change per pulse, over the noise variance of a pulse."""
    background_order: Annotated[int, Field(ge=0, le=20, strict=True)] = 0
    """Order of the background that is fitted with the harmonics: 0 constant, 1 velocity, 2 acceleration, higher: drift.
    cross_spectrum removes the background by a band-pass and uses the order for its u only."""
    drift: Literal["none", "linear"] = "none"
    """Change of the motion within the window, as of tissue that warms: "none", values are means over the window;
    "linear", amplitude and delay of every harmonic may change linearly, and values are those at its first pulse."""
    flag_pulses: Annotated[bool, Field(strict=True)] = True
    """Exclude pulses with outlying energy in the gate: leaked tonebursts, spikes, missing echoes."""
    follow_gate: Annotated[bool, Field(strict=True)] = False
    """Let the gate follow background motion that is longer than the gate, such as heart beat or breathing; fit the
    background with background_order. Not with a reference gate."""
    reference_gate_depth_m: LengthM | None = None
    """Centre of a second gate, inside the record, with stationary echoes: its apparent motion, the trigger jitter, is
    subtracted."""
    reference_gate_length_m: LengthM | None = None
    """Length of that gate; default: acquisition.gate_length_m."""
    gates: Annotated[tuple[Gate, ...], Field(max_length=1000)] = ()
    """More gates, inside the record: amplitude and phase over depth from one acquisition."""
    gate_profile_step_m: LengthM | None = None
    """Distance between gates of acquisition.gate_length_m over the whole record, instead of listed gates."""
    expected_snr_db: RatioDb | None = None
    """Echo power over noise power in the gate, for the prediction; default: as simulated."""
    expected_amplitude_m: AmplitudeM | None = None
    """Displacement amplitude, for the prediction; default: the prescribed motion of the twin, or 100 nm."""
    frequencies_hz: Annotated[tuple[VibrationHz, ...], Field(min_length=1)] | None = None
    """Vibration frequencies f_v to estimate; default: f_r and its multiples up to the tenth below f_prf / 2."""
    frequency_accuracy: Annotated[float, Field(ge=0, le=1e-2, strict=True)] | None = None
    """Relative standard uncertainty of all frequencies by the clock of the pulses; 0 for one clock. Default: from the
    clocks in the bench file; 50e-6 for a source of vibration that is not on the bench, and for imported recordings."""
    window_start_s: DelayS = 0.0
    """Start of the slow-time window after the first tracking pulse."""
    window_length_s: DurationS | None = None
    """Length T_s of the slow-time window; default: to the last pulse."""
    synchronous: Annotated[bool, Field(strict=True)] = False
    """Require a burst period that is a whole multiple of the pulse period."""

    @model_validator(mode="after")
    def _settings_fit_together(self, info: ValidationInfo) -> Processing:
        refuse_first(_processing_conflicts(self), info)
        return self


def _processing_conflicts(processing: Processing) -> Iterator[str]:
    gates_over_depth = processing.gates or processing.gate_profile_step_m is not None
    if processing.follow_gate and processing.reference_gate_depth_m is not None:
        yield "a reference gate is fixed and follow_gate moves the gate: remove one of them"
    if processing.gates and processing.gate_profile_step_m is not None:
        yield "gates and gate_profile_step_m both place gates over depth: remove one of them"
    if processing.follow_gate and gates_over_depth:
        yield "gates over depth are fixed and follow_gate moves the gate: remove one of them"
    if processing.harmonic == "medium_prior" and properties_of(processing.estimator).velocity_chain:
        yield (
            f'{processing.estimator} includes a fit of amplitude and phase, so harmonic = "medium_prior" cannot apply: '
            'remove it, or set estimator = "coherent"'
        )
    if processing.process_noise and processing.harmonic != "kalman":
        yield (
            "process_noise is a setting of the Kalman filter, which is not chosen: "
            'set harmonic = "kalman", or remove process_noise'
        )


SWEPT_LISTS: Mapping[str, str] = {
    "tracking.pulse_rate_hz": "pulse_rate_hz",
    "processing.window_length_s": "window_length_s",
    "tracking.lateral_offset_m": "lateral_offset_m",
    "tracking.axial_offset_m": "axial_offset_m",
}
"""Keys that a list in [sweep] replaces, and the key of that list."""


class Sweep(Section):
    """Settings that vary within one run, in addition to forces and burst lengths.

    In addition to the keys below: any number of the scene, or of the bench file as "bench.PATH", with its values, as in
    "tracking.delay_s" = [0.0, 1e-4].
    """

    model_config = ConfigDict(json_schema_extra={"additionalProperties": True})

    pulse_rate_hz: Annotated[tuple[FrequencyHz, ...], Field(min_length=1, max_length=100)] = ()
    """Pulse rates f_prf, instead of tracking.pulse_rate_hz, with equally many pulses each."""
    window_length_s: Annotated[tuple[DurationS, ...], Field(min_length=1, max_length=100)] = ()
    """Slow-time windows T_s of the same records, instead of processing.window_length_s."""
    lateral_offset_m: Annotated[tuple[OffsetM, ...], Field(min_length=1, max_length=1000)] = ()
    """Lateral offsets of the tracking transducer, instead of tracking.lateral_offset_m; between them
    every output is off, and a stage or the operator moves the transducer."""
    axial_offset_m: Annotated[tuple[OffsetM, ...], Field(min_length=1, max_length=100)] = ()
    """Offsets of the gate along the beam, instead of tracking.axial_offset_m."""
    axes: dict[str, Annotated[tuple[AnyNumber, ...], Field(min_length=1, max_length=1000)]] = Field(
        default_factory=dict, max_length=10
    )
    """Any other numbers, each with its values; other keys of [sweep] are moved here."""
    combine: Literal["product", "zip"] = "product"
    """How several axes combine: "product", each value with each; "zip", the first values, then the second ones."""

    @model_validator(mode="before")
    @classmethod
    def _axes_from_other_keys(cls, settings: Any) -> Any:
        if not isinstance(settings, Mapping):
            return settings
        own_keys = {name: value for name, value in settings.items() if name in cls.model_fields}
        axis_values = dict(_flat({name: value for name, value in settings.items() if name not in cls.model_fields}))
        axes = own_keys.get("axes", {})
        return {**own_keys, "axes": {**axes, **axis_values}} if axis_values and isinstance(axes, Mapping) else settings


def _flat(tables: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the values of nested tables by dotted path."""
    for name, value in tables.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value
