"""Settings of the receiver: level and noise of the echoes, and the elements between transducer and digitizer."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from sim_backend.settings.presets import CHAIN_PRESETS, with_preset
from sim_backend.settings.quantities import (
    FrequencyHz,
    LengthM,
    NonNegativeVoltageV,
    RatioDb,
    Strength,
    TimeS,
    VoltageV,
)
from sim_backend.settings.section import Section


class Receiver(Section):
    """Receive chain between transducer and digitizer."""

    snr_db: RatioDb | None = None
    """Echo power at rest in the reference gate over noise power; absent: no noise."""
    reference_gate_m: LengthM = 1.0e-3
    """Length of the gate around the focus for which ``snr_db`` and ``echo_rms_v`` are defined."""
    echo_rms_v: VoltageV = 0.1
    """Root mean square of the resting echo in the reference gate for a 3-cycle pulse of ``reference_pulse_vpp``."""
    reference_pulse_vpp: VoltageV = 1.0
    """Tracking pulse amplitude at the generator for ``echo_rms_v``."""
    reference_carrier_hz: FrequencyHz = 9.0e6
    """Carrier of the tracking pulse for ``echo_rms_v`` (paper: 9.0 MHz)."""
    toneburst_leak_v: NonNegativeVoltageV = 2.0
    """Amplitude at the digitizer while a toneburst of the specimen's reference drive is transmitted (assumed)."""
    toneburst_echo_gain: Annotated[Strength, Field(ge=0)] = 1.0
    """Echo of the toneburst relative to a tracking echo of the same drive, after the 3 MHz notch (assumed)."""


class BandFilter(Section):
    """A Butterworth band-pass or notch."""

    centre_hz: FrequencyHz
    """Centre frequency."""
    bandwidth: Annotated[float, Field(ge=1e-3, le=4, strict=True)]
    """Width between the -3 dB edges over the centre frequency."""
    order: Annotated[int, Field(ge=1, le=8, strict=True)] = 2
    """Pole pairs (assumed)."""


class LogAmplifier(Section):
    """A logarithmic amplifier."""

    slope_v_per_decade: VoltageV = 0.25
    """Output a decade of input (assumed)."""
    knee_v: VoltageV = 1.0e-4
    """Input amplitude of the transition from linear to logarithmic (assumed)."""
    saturation_v: VoltageV | None = 0.75
    """Largest output (assumed)."""


class ReceiveChain(Section):
    """Elements between transducer and digitizer; an absent element is not simulated.

    With this section the receiver's volts are those at the transducer, and the noise is the preamplifier's.
    """

    preset: Literal["paper"] | None = None
    """The paper's chain by name, which sets every omitted element (values that are not from the paper: assumed)."""
    notch: BandFilter | None = None
    """Notch for the toneburst's carrier (paper: 3.0 MHz, 50 %)."""
    recovery_time_s: TimeS | None = None
    """Time constant of the T/R switch after a transmission; absent: no switch."""
    noise_v_per_sqrt_hz: Annotated[float, Field(ge=1e-15, le=1.0, strict=True)] | None = None
    """Noise density of the preamplifier, at its input."""
    band_pass: BandFilter | None = None
    """First band-pass (paper: 9.0 MHz, 33 %)."""
    log_amplifier: LogAmplifier | None = None
    """Logarithmic amplifier."""
    second_band_pass: BandFilter | None = None
    """Second band-pass (paper: 9.0 MHz; its width is assumed to be the first's)."""
    third_harmonic: Annotated[Strength, Field(ge=0)] = 0.0
    """Third harmonic of a toneburst over its carrier at the transducer (assumed: none)."""
    oversampling: Literal[1, 2, 5, 10] = 1
    """Computed samples for one sample of the digitizer."""
    tail_tolerance: Annotated[float, Field(ge=1e-14, lt=1, strict=True)] = 1e-6
    """Relative decay of the filters before a record begins."""

    @model_validator(mode="before")
    @classmethod
    def _apply_preset(cls, settings: Any) -> Any:
        return with_preset(settings, CHAIN_PRESETS)
