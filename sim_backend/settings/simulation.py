"""Settings of the twin, the ``[simulation]`` section of a scene: beams, scatterers, and all tables together."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from sim_backend.settings.instruments import Instruments
from sim_backend.settings.presets import with_preset_depth
from sim_backend.settings.quantities import (
    AttenuationDbPerCmMHz,
    FrequencyHz,
    LengthM,
    PositionM,
    Seed,
    SpeedMPerS,
    Strength,
)
from sim_backend.settings.receiver import ReceiveChain, Receiver
from sim_backend.settings.section import Section
from sim_backend.settings.specimen import BackgroundMotion, MotionComponent, Propagation, Specimen

Widths = tuple[LengthM, LengthM, LengthM]

MAX_SCATTERERS = 10_000_000
"""Limit of memory, at some 100 bytes each; echoes cannot resolve that many."""
MAX_LOSS_DB = 400.0
"""Twice the ratio of the strongest pulse and the weakest noise."""
MAX_HALF_APERTURE = 0.95
"""Sine of a bowl's largest half aperture angle: an f-number of 0.53."""
MAX_ECHO_GATES = 1000.0
"""Largest echo length in reference gates; beyond it ``snr_db`` is wrong by 30 dB for a pulse within the gate."""
MAX_OFFSET_WIDTHS = 8.0
"""Largest distance of the beams' axes in sigmas; the tracking beam then has 1e-14 of its intensity on the push."""

Ratio = Annotated[float, Field(ge=1e-3, allow_inf_nan=True, strict=True)]


class Transducer(Section):
    """A circular transducer with the shape of a spherical bowl; it radiates both beams and receives the echoes."""

    diameter_m: LengthM = 45.0e-3
    """Diameter of the aperture (paper: 45 mm)."""
    focal_length_m: LengthM = 70.0e-3
    """Radius of curvature of the bowl, from its middle to the geometric focus (paper: 70 mm)."""
    apodisation: Literal["uniform", "parabolic", "hann"] = "uniform"
    """Velocity at the relative radius s of the aperture: 1, 1 - s^2, or cos^2(pi s / 2) (assumed: uniform)."""

    @property
    def half_aperture(self) -> float:
        """Sine of the angle between the axis and the rim, at the focus."""
        return self.diameter_m / 2 / self.focal_length_m

    @model_validator(mode="after")
    def _check_bowl(self) -> Transducer:
        """Refuse a bowl that is deeper than half a sphere."""
        if self.half_aperture > MAX_HALF_APERTURE:
            raise ValueError(
                f"a bowl of diameter_m {self.diameter_m:g} and focal_length_m {self.focal_length_m:g} is deeper than "
                "half a sphere or nearly so: a smaller diameter, or a longer focal length"
            )
        return self


class Beams(Section):
    """Excitation and tracking beams; widths are the sigmas E and T of eq. (8) and (12)."""

    field: Literal["gaussian", "aperture", "measured"] = "gaussian"
    """Shape of both beams: Gaussians of the widths below, the field of ``transducer``, or hydrophone scans."""
    transducer: Transducer = Transducer()
    """The transducer, for ``field = "aperture"``."""
    excitation_scan: Annotated[str, Field(min_length=1)] | None = None
    """File of the push's scan at ``specimen.resonance_hz``, for ``field = "measured"``: HDF5, CSV or MAT."""
    tracking_scan: Annotated[str, Field(min_length=1)] | None = None
    """File of the tracking beam's scan, one way, at ``receiver.reference_carrier_hz``."""
    excitation_width_m: Widths = (0.17e-3, 0.17e-3, 1.80e-3)
    """E_x, E_y, E_z (paper, Table I)."""
    tracking_width_m: Widths = (0.078e-3, 0.078e-3, 0.83e-3)
    """T_x, T_y, T_z (paper, Table I)."""
    width_ratio: tuple[Ratio, Ratio, Ratio] | None = None
    """W_x, W_y, W_z: the width of the motion is W times T instead of E; inf: it is uniform."""
    lateral_offset_m: tuple[PositionM, PositionM] = (0.0, 0.0)
    """Lateral offset of the tracking axis, x and y, from the excitation axis (assumed: 0)."""
    focus_depth_m: LengthM = 70.0e-3
    """Distance z_F from the transducer to the common focus (paper: 70 mm)."""
    tracking_focus_depth_m: LengthM | None = None
    """Distance from a separate tracking transducer to the focus; absent: one transducer pushes and tracks."""

    @model_validator(mode="after")
    def _check_ratio(self) -> Beams:
        """Refuse ratios that are not numbers."""
        if any(ratio != ratio for ratio in self.width_ratio or ()):
            raise ValueError("width_ratio holds nan: give numbers above 0, or inf for the same motion everywhere")
        return self

    @property
    def tracked_from_m(self) -> float:
        """Distance from the tracking transducer to the common focus."""
        return self.focus_depth_m if self.tracking_focus_depth_m is None else self.tracking_focus_depth_m

    def motion_width_m(self) -> tuple[float, float, float]:
        """Return the sigmas of the Gaussian displacement: width ratio times tracking widths, else the force's."""
        if self.width_ratio is None:
            return self.excitation_width_m
        (wx, wy, wz), (tx, ty, tz) = self.width_ratio, self.tracking_width_m
        return wx * tx, wy * ty, wz * tz


class Reflector(Section):
    """A strong reflector among the scatterers."""

    kind: Literal["point", "plane"] = "point"
    """A point, or a uniform plane across the beam."""
    position_m: tuple[PositionM, PositionM, PositionM] = (0.0, 0.0, 0.0)
    """x, y, z from the focus; for a plane only z."""
    strength: Strength = 10.0
    """Reflectivity relative to a scatterer; for a plane, of its whole beam-weighted area at the focus."""
    moves: Annotated[bool, Field(strict=True)] = True
    """Whether it moves with the specimen."""


class Scatterers(Section):
    """Point scatterers, uniform in a box around the focus."""

    volume_m: Widths = (1.0e-3, 1.0e-3, 5.0e-3)
    """Box x_v, y_v, z_v, centred on the focus (paper, Table I)."""
    per_cell: Annotated[float, Field(ge=0, le=1e20, strict=True)] = 11.0
    """Scatterers per resolution cell, the volume where the tracking beam is above -6 dB (paper, Table I)."""
    axial_delay: Literal["two_way", "none"] = "two_way"
    """Whether a scatterer's echo is delayed by its depth; "none" is eq. (11) taken literally."""
    bandwidth: Annotated[float, Field(ge=1e-4, le=2, strict=True)] = 0.065
    """Fractional bandwidth BW of the echo pulse relative to the tracking carrier: eq. (9)'s, or -6 dB width."""
    pulse: Literal["hann", "gaussian", "burst"] = "hann"
    """Echo pulse: Hann of eq. (9), Gaussian, or a 3-cycle burst through a Gaussian band about ``band_centre_hz``."""
    band_centre_hz: FrequencyHz = 9.0e6
    """Centre of the receive band of ``pulse = "burst"`` (paper: band-pass filter at 9.0 MHz)."""
    reflectivity: Literal["unit", "sign", "normal"] = "unit"
    """Reflectivity of each scatterer: 1 (paper), +1 or -1, or standard normal."""
    reflectors: tuple[Reflector, ...] = ()
    """Point and plane reflectors in addition to the scatterers."""
    echo_tolerance: Annotated[float, Field(ge=1e-14, lt=1, strict=True)] | None = None
    """Allowed relative rms error of the echoes; absent: 1e-8, or 2e-7 with ``specimen.field = "medium"``."""
    attenuation_db_per_cm_mhz: AttenuationDbPerCmMHz = 0.0
    """One-way loss, which attenuates the high frequencies of echoes most (assumed: none; soft tissue 0.5)."""


def resolution_cell_m3(tracking_width_m: tuple[float, float, float]) -> float:
    """Return the volume where the amplitude response of the tracking beam exceeds 1/2 (-6 dB).

    It is an ellipsoid with half axes T sqrt(2 ln 2), T the sigmas ``tracking_width_m``.
    """
    # exp(-r²/2T²) = 1/2 at r = T sqrt(2 ln 2).
    half_axis_per_width = math.sqrt(2 * math.log(2))
    return 4 / 3 * math.pi * math.prod(width_m * half_axis_per_width for width_m in tracking_width_m)


def scatterer_count(scatterers: Scatterers, beams: Beams) -> int:
    """Return the number of scatterers in the box: ``per_cell`` times the number of resolution cells in it."""
    return round(scatterers.per_cell * math.prod(scatterers.volume_m) / resolution_cell_m3(beams.tracking_width_m))


class SimulationSettings(Section):
    """All settings of the twin, apart from the drivers' commands."""

    seed: Seed = 1
    """Seed of all random numbers."""
    sound_speed_m_per_s: SpeedMPerS = 1540.0
    """Longitudinal sound speed c (paper, Table I)."""
    specimen: Specimen | None = None
    """A medium moved by the tonebursts; excludes ``motion``."""
    propagation: Propagation | None = None
    """Nonlinear propagation of the tonebursts; absent: linear."""
    motion: tuple[MotionComponent, ...] | None = None
    """Prescribed motion (eq. 13); excludes ``specimen``."""
    background: tuple[BackgroundMotion, ...] = ()
    """Additional motion of the whole specimen, which a gate must track."""
    beams: Beams = Beams()
    """Excitation and tracking beams."""
    scatterers: Scatterers = Scatterers()
    """Sources of echoes."""
    receiver: Receiver = Receiver()
    """Level and noise of the echoes at the digitizer."""
    receive_chain: ReceiveChain | None = None
    """Elements of the receive chain; absent: an ideal one."""
    instruments: Instruments = Instruments()
    """Properties of the simulated instruments."""

    @model_validator(mode="before")
    @classmethod
    def _adapt_preset_depth(cls, settings: Any) -> Any:
        return with_preset_depth(settings)

    @property
    def _in_specimen(self) -> bool:
        return self.specimen is not None and self.specimen.depth_m is not None

    @property
    def echo_attenuation_db_per_cm_mhz(self) -> float:
        """One-way attenuation of echoes around the focus.

        It is the specimen's if its depth is stated, else the scatterers'.
        """
        if self.specimen is not None and self.specimen.depth_m is not None:
            return self.specimen.attenuation_db_per_cm_mhz
        return self.scatterers.attenuation_db_per_cm_mhz

    def loss_to_focus_db(self, frequency_hz: float) -> float:
        """Return the two-way loss of a pulse, from the tracking transducer to the focus and back, dB.

        The path is water, then the specimen for the last ``specimen.depth_m`` before the focus. The loss is
        proportional to frequency in the specimen, to its square in water. Without that depth, the loss of
        ``scatterers`` acts all the way.
        """
        mhz, focus_cm = abs(frequency_hz) / 1e6, 100 * self.beams.tracked_from_m
        if self.specimen is None or self.specimen.depth_m is None:
            return 2 * focus_cm * self.scatterers.attenuation_db_per_cm_mhz * mhz
        # Two ways, each through water and then the specimen.
        specimen_cm = 100 * self.specimen.depth_m
        water = (self.propagation or Propagation()).water_attenuation_db_per_cm_mhz2
        specimen_db = specimen_cm * self.specimen.attenuation_db_per_cm_mhz * mhz
        return 2 * (specimen_db + (focus_cm - specimen_cm) * water * mhz**2)

    @model_validator(mode="after")
    def _check_sphere(self) -> SimulationSettings:
        """Refuse settings that a rigid sphere excludes: scatterers around it, a field, propagation or an aperture."""
        if self.specimen is None or self.specimen.sphere is None:
            return self
        mistakes = []
        if self.scatterers.per_cell:
            mistakes.append(
                "specimen.sphere's front alone may echo, as the motion of the medium around it is not simulated: "
                "scatterers.per_cell = 0, and a point among scatterers.reflectors"
            )
        if self.specimen.field != "gaussian":
            mistakes.append('specimen.sphere moves as a whole, not as the medium does around it: field = "gaussian"')
        if self.propagation is not None or self.beams.field != "gaussian":
            mistakes.append('specimen.sphere has force_n as its force: no propagation, and beams.field = "gaussian"')
        if mistakes:
            raise ValueError("; ".join(mistakes))
        return self

    @model_validator(mode="after")
    def _check_depths(self) -> SimulationSettings:
        """Refuse contradictory depths of the specimen, and attenuation that is stated twice."""
        depth_m = None if self.specimen is None else self.specimen.depth_m
        if depth_m is None:
            return self
        mistakes = []
        if depth_m > self.beams.tracked_from_m:
            focus_m = self.beams.tracked_from_m
            mistakes.append(
                f"specimen.depth_m is {depth_m:g} m and the way to the focus, beams.focus_depth_m, {focus_m:g} m"
            )
        if self.propagation is not None and self.propagation.specimen_depth_m != depth_m:
            other_m = self.propagation.specimen_depth_m
            mistakes.append(f"specimen.depth_m is {depth_m:g} m and propagation.specimen_depth_m {other_m:g} m")
        if self.scatterers.attenuation_db_per_cm_mhz:
            mistakes.append("specimen.depth_m and scatterers.attenuation_db_per_cm_mhz attenuate the same echoes twice")
        if mistakes:
            raise ValueError(
                f"{'; '.join(mistakes)}: the focus lies in one specimen, at one depth: change one of the two"
            )
        return self

    @model_validator(mode="after")
    def _check_echo_level(self) -> SimulationSettings:
        """Refuse attenuation and lateral offsets that leave no echo, and a pulse too long for its reference gate."""
        loss_db = self.loss_to_focus_db(self.receiver.reference_carrier_hz)
        if loss_db > MAX_LOSS_DB:
            section = "specimen" if self._in_specimen else "scatterers"
            raise ValueError(
                f"{section}.attenuation_db_per_cm_mhz takes {loss_db:.3g} dB of receiver.reference_carrier_hz on the "
                f"way to beams.focus_depth_m and back, {MAX_LOSS_DB:g} dB leave no echo: less of one of the three"
            )
        receiver = self.receiver
        # echo_rms_v scales to other pulses only if the reference pulse fits its gate.
        pulse_m = self.sound_speed_m_per_s / (2 * self.scatterers.bandwidth * receiver.reference_carrier_hz)
        if pulse_m > MAX_ECHO_GATES * receiver.reference_gate_m:
            raise ValueError(
                f"an echo at receiver.reference_carrier_hz with scatterers.bandwidth is {pulse_m:.3g} m long, more "
                f"than {MAX_ECHO_GATES:g} times receiver.reference_gate_m: a higher carrier, a larger bandwidth or gate"
            )
        offset, width = self.beams.lateral_offset_m, self.beams.tracking_width_m
        if any(abs(offset[axis]) > MAX_OFFSET_WIDTHS * width[axis] for axis in (0, 1)):
            raise ValueError(
                f"beams.lateral_offset_m is more than {MAX_OFFSET_WIDTHS:g} times beams.tracking_width_m, so that the "
                "beams do not meet: a smaller offset"
            )
        return self

    @model_validator(mode="after")
    def _check_memory(self) -> SimulationSettings:
        """Refuse more scatterers than the memory holds."""
        if (count := scatterer_count(self.scatterers, self.beams)) > MAX_SCATTERERS:
            raise ValueError(
                f"scatterers.per_cell and volume_m with beams.tracking_width_m make {count:.3g} scatterers, memory "
                f"holds {MAX_SCATTERERS:.0e}: fewer per cell, or a smaller box"
            )
        return self

    @model_validator(mode="after")
    def _check_aperture(self) -> SimulationSettings:
        """Refuse settings that need Gaussian beams if the beams are those of an aperture."""
        if self.beams.field == "gaussian":
            return self
        mistakes = []
        if self.beams.tracking_focus_depth_m is not None:
            mistakes.append(f'beams.tracking_focus_depth_m needs beams.field = "gaussian", not "{self.beams.field}"')
        if self.beams.field == "measured":
            scans = {name: getattr(self.beams, name) for name in ("excitation_scan", "tracking_scan")}
            mistakes += [f'beams.field = "measured" needs beams.{name}' for name, path in scans.items() if path is None]
        focus_m, focal_m = self.beams.focus_depth_m, self.beams.transducer.focal_length_m
        if abs(focus_m - focal_m) > 1e-9 * focal_m:
            mistakes.append(
                f"beams.focus_depth_m is {focus_m:g} m and beams.transducer.focal_length_m {focal_m:g} m: the focus of "
                "a bowl is its centre of curvature; make both equal"
            )
        if any(reflector.kind == "plane" for reflector in self.scatterers.reflectors):
            mistakes.append(
                "a plane among scatterers.reflectors is summed over a Gaussian beam: points, or no aperture"
            )
        if self.scatterers.axial_delay == "none":
            mistakes.append(
                'scatterers.axial_delay = "none" has no depths, an aperture\'s beam has: "two_way" or Gaussians'
            )
        if mistakes:
            raise ValueError("; ".join(mistakes))
        return self

    @model_validator(mode="after")
    def _check_exclusive_settings(self) -> SimulationSettings:
        """Refuse settings that exclude each other."""
        if self.receive_chain is not None and self.receiver.snr_db is not None:
            raise ValueError(
                "receiver.snr_db and receive_chain exclude each other: with a chain the noise is the preamplifier's, "
                "receive_chain.noise_v_per_sqrt_hz"
            )
        if self.specimen is not None and self.specimen.field == "medium" and self.beams.field == "gaussian":
            x, y, _ = self.beams.excitation_width_m
            remedy = 'specimen.field = "gaussian"'
            if abs(x - y) > 1e-12 * x:
                raise ValueError(
                    f"the medium's own field is that of a round force, beams.excitation_width_m is {x:g} m by {y:g} m: "
                    f"make both equal, or set {remedy}"
                )
            if self.beams.width_ratio is not None:
                raise ValueError(f"beams.width_ratio sets the shape of a Gaussian motion: remove it, or set {remedy}")
        if self.specimen is not None and self.motion is not None:
            raise ValueError(
                "specimen and motion exclude each other: remove [simulation.specimen] or [[simulation.motion]]"
            )
        return self
