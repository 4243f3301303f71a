"""Settings of what moves the scatterers: specimen, propagation, prescribed and background motion."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from sim_backend.settings.installed_media import BUILT_IN_MEDIA, check_parameters, known_medium
from sim_backend.settings.presets import PRESETS, Preset, with_preset
from sim_backend.settings.quantities import (
    AmplitudeM,
    AttenuationDbPerCmMHz,
    DensityKgPerM3,
    ForceDensityNPerM3,
    FrequencyHz,
    LengthM,
    ModulusPa,
    PhaseRad,
    Strength,
    VibrationHz,
    ViscosityPaS,
    VoltageV,
)
from sim_backend.settings.section import Section


def _as_pairs(table: Any) -> Any:
    return tuple(table.items()) if isinstance(table, dict) else table


MediumParameters = Annotated[
    tuple[tuple[str, Annotated[float, Field(strict=True)]], ...],
    BeforeValidator(_as_pairs, json_schema_input_type=dict[str, float]),
]
"""A table of numbers by name, stored as pairs so that settings are hashable."""


class Sphere(Section):
    """A rigid sphere with its front at the focus; the toneburst pushes it instead of the medium."""

    radius_m: LengthM = 0.795e-3
    """Radius (paper: steel 440-C, diameter 1.59 mm)."""
    density_kg_per_m3: Annotated[float, Field(ge=100, le=20_000, strict=True)] = 7650.0
    """Mass density (assumed: steel 440-C)."""
    force_n: Annotated[float, Field(gt=0, le=10, strict=True)] = 5.0e-3
    """Radiation force on it while a toneburst of ``specimen.reference_drive_vpp`` is on (assumed)."""


class Specimen(Section):
    """A viscoelastic medium driven by the radiation force of the excitation beam."""

    preset: Preset | None = None
    """A specimen by name, which sets every omitted medium setting."""
    medium: Annotated[str, Field(strict=True), AfterValidator(known_medium)] = "voigt"
    """Law of the complex shear modulus: voigt, maxwell, zener, power_law, or a medium of an installed package."""
    parameters: MediumParameters = ()
    """Parameters of an installed package's medium by their names; not used by the others."""
    shear_modulus_pa: ModulusPa = 7.25e3
    """Shear elasticity mu1 (paper: gelatin 12 %, 7.25 kPa); of a power law, the modulus at the reference frequency."""
    shear_viscosity_pa_s: ViscosityPaS = 1.0
    """Shear viscosity mu2 (paper: 1.0 Pa s)."""
    branch_modulus_pa: ModulusPa = 10.0e3
    """Spring in series with the viscosity, of a Zener medium (assumed)."""
    power: Annotated[float, Field(ge=0, lt=1, strict=True)] = 0.2
    """Exponent of a power law's frequency (assumed)."""
    reference_frequency_hz: VibrationHz = 100.0
    """Frequency of a power law's ``shear_modulus_pa``."""
    attenuation_db_per_cm_mhz: Annotated[AttenuationDbPerCmMHz, Field(ge=1e-4)] = 0.5
    """Attenuation of the medium (assumed); with the force it determines the intensity at the focus."""
    depth_m: LengthM | None = None
    """Depth of the focus in the specimen, with water in front of it. Both attenuate tracking pulses and tonebursts,
    high frequencies most; absent: only the attenuation in ``scatterers``."""
    density_kg_per_m3: DensityKgPerM3 = 1000.0
    """Mass density (assumed)."""
    field: Literal["medium", "gaussian"] = "medium"
    """Motion around the focus: the medium's shear field, or the Gaussian of eq. (12)."""
    force_density_n_per_m3: ForceDensityNPerM3 = 4.0e6
    """Body force at the focus while a toneburst of ``reference_drive_vpp`` is on (assumed)."""
    reference_drive_vpp: VoltageV = 1.0
    """Toneburst amplitude at the generator for ``force_density_n_per_m3``; the force is proportional to its square."""
    growth_per_s: Annotated[float, Field(ge=-1, le=10, strict=True)] = 0.0
    """Relative growth of the motion under a toneburst per second after the first one, as in tissue that warms."""
    delay_growth_s_per_s: Annotated[float, Field(ge=-0.01, le=0.01, strict=True)] = 0.0
    """Growth of the delay of that motion per second, as off the push in tissue that softens."""
    sphere: Sphere | None = None
    """A rigid sphere at the focus, to calibrate moduli by its motion; absent: none."""
    resonance_hz: FrequencyHz = 3.0e6
    """Centre of the transducer's transmit band (paper: 3.0 MHz)."""
    resonance_quality: Annotated[float, Field(ge=1e-3, le=1e6, strict=True)] = 2.34
    """Quality of that band as one damped mode (paper: -16 dB at 9 MHz)."""

    @model_validator(mode="before")
    @classmethod
    def _apply_preset(cls, settings: Any) -> Any:
        return with_preset(settings, PRESETS)

    @model_validator(mode="after")
    def _check_parameters(self) -> Specimen:
        """Refuse parameters that do not belong to the medium."""
        if self.medium not in BUILT_IN_MEDIA:
            check_parameters(self.medium, dict(self.parameters))
        elif self.parameters:
            raise ValueError(
                f"parameters are those of an installed package's medium, medium is {self.medium}: remove them"
            )
        return self

    @model_validator(mode="after")
    def _check_maxwell(self) -> Specimen:
        """Refuse a Maxwell medium without viscosity."""
        if self.medium == "maxwell" and self.shear_viscosity_pa_s == 0:
            raise ValueError("a maxwell medium without viscosity resists nothing: raise shear_viscosity_pa_s above 0")
        return self


class Propagation(Section):
    """Nonlinear propagation of the tonebursts through water into the specimen; absent: force as drive squared."""

    specimen_depth_m: LengthM = 12.5e-3
    """Depth of the focus in the specimen, behind water (paper: a section of 2.5 cm; assumed: its middle)."""
    nonlinearity: Annotated[float, Field(gt=0, le=20, strict=True)] = 4.7
    """beta = 1 + B/2A of the specimen (assumed: muscle, B/A 7.4)."""
    attenuation_power: Annotated[float, Field(ge=1, le=2, strict=True)] = 1.1
    """Exponent of frequency in the specimen's attenuation (assumed)."""
    water_nonlinearity: Annotated[float, Field(gt=0, le=20, strict=True)] = 3.6
    """beta of water (assumed: B/A 5.2)."""
    water_density_kg_per_m3: Annotated[float, Field(ge=500, le=2000, strict=True)] = 995.0
    """Density of the water, or of another coupling liquid (assumed: 30 degrees C)."""
    water_attenuation_db_per_cm_mhz2: Annotated[float, Field(gt=0, le=1, strict=True)] = 0.0018
    """Attenuation of the water at 1 MHz, proportional to frequency squared (assumed: 30 degrees C)."""
    harmonics: Annotated[int, Field(ge=4, le=128, strict=True)] = 24
    """Number of computed harmonics; a shock's loss beyond them is applied to the last ones."""


class MotionComponent(Section):
    """One sinusoid of a prescribed motion, D(t) = amplitude sin(2 pi f t + phase), t from the master trigger's edge."""

    frequency_hz: VibrationHz
    """Vibration frequency."""
    amplitude_m: AmplitudeM
    """Peak displacement D_0 at the focus."""
    phase_rad: PhaseRad = 0.0
    """Vibration phase."""


class BackgroundMotion(Section):
    """A periodic motion of the whole specimen along the beam, such as that of a heart beat or of breathing.

    ``b(t) = amplitude (sin a + sum_n h_n sin n a)``, ``a = 2 pi f t + phase``, t from the master trigger's edge. All
    scatterers move equally, by any number of wavelengths, with foci and beam widths (assumed: the motion stays
    within the depth of field). Not part of the true displacement.
    """

    frequency_hz: VibrationHz
    """Repetition rate f (heart: about 1.2 Hz; breathing: about 0.25 Hz)."""
    amplitude_m: AmplitudeM
    """Peak displacement of the fundamental, positive away from the transducer."""
    phase_rad: PhaseRad = 0.0
    """Phase of the fundamental."""
    harmonics: Annotated[tuple[Strength, ...], Field(max_length=100)] = ()
    """Amplitudes h of the second, third and further harmonics over the fundamental's."""
