"""The receive chain between transducer and digitizer, element by element; provenance as in ``settings``."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from sim_backend.settings.presets import with_chain_preset
from sim_backend.settings.section import NonNegative, Positive, Section


class BandFilter(Section):
    """A Butterworth band-pass or notch."""

    centre_hz: Positive
    """Centre frequency."""
    bandwidth: Annotated[float, Field(gt=0, le=4)]
    """Width between the -3 dB edges over the centre frequency."""
    order: Annotated[int, Field(ge=1, le=8)] = 2
    """Pole pairs (assumed)."""


class LogAmplifier(Section):
    """A logarithmic amplifier."""

    slope_v_per_decade: Positive = 0.25
    """Output a decade of input (assumed)."""
    knee_v: Positive = 1.0e-4
    """Input amplitude around which it turns from linear to logarithmic (assumed)."""
    saturation_v: Positive | None = 0.75
    """Largest output (assumed)."""


class ReceiveChain(Section):
    """What stands between transducer and digitizer; an element that is absent is not simulated.

    With this section the receiver's volts are those at the transducer, and the noise is the preamplifier's.
    """

    preset: Literal["paper"] | None = None
    """The paper's chain by name, which fills in every element that is absent (values below assumed where not paper)."""
    notch: BandFilter | None = None
    """Notch for the toneburst's carrier (paper: 3.0 MHz, 50 %)."""
    recovery_time_s: NonNegative | None = None
    """Time constant with which the T/R switch opens after a transmission; absent: no switch."""
    noise_v_per_sqrt_hz: Positive | None = None
    """Noise density of the preamplifier, at its input."""
    band_pass: BandFilter | None = None
    """First band-pass (paper: 9.0 MHz, 33 %)."""
    log_amplifier: LogAmplifier | None = None
    """Logarithmic amplifier."""
    second_band_pass: BandFilter | None = None
    """Second band-pass (paper: 9.0 MHz; its width is assumed to be the first's)."""
    third_harmonic: NonNegative = 0.0
    """Third harmonic of a toneburst over its carrier at the transducer, added to that of the amplifier's ceiling."""
    oversampling: Literal[1, 2, 5, 10] = 1
    """Samples the chain computes for one of the digitizer."""
    tail_tolerance: Annotated[float, Field(gt=0, lt=1)] = 1e-6
    """How far the filters must have rung down before a record begins."""

    @model_validator(mode="before")
    @classmethod
    def _fill_in_preset(cls, given: Any) -> Any:
        return with_chain_preset(given)
