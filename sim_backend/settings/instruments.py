"""Settings of the simulated instruments: memory, latencies, clocks, and faults of the digitizer's triggers."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator

from sim_backend.settings.quantities import JitterS, TimeS
from sim_backend.settings.section import Section

ClockError = Annotated[float, Field(gt=-1e-2, lt=1e-2, strict=True)]


class StampJump(Section):
    """A step in the trigger times of one capture."""

    record: Annotated[int, Field(ge=0, le=10_000_000, strict=True)]
    """First record with shifted trigger times, counted from 0."""
    jump_s: Annotated[float, Field(ge=-1e6, le=1e6, strict=True)]
    """Time added to it and to all later ones."""


class TriggerFaults(Section):
    """Faults of the digitizer's trigger input and of its trigger times, equal in every capture; by default none."""

    lost: tuple[Annotated[int, Field(ge=0, le=10_000_000, strict=True)], ...] = ()
    """Triggers that the digitizer misses, counted from 0 among those that arrive after arming."""
    stray_s: tuple[Annotated[float, Field(ge=-10.0, le=100.0, strict=True)], ...] = ()
    """Times of triggers that no instrument sent, relative to the first trigger that arrives after arming."""
    stamp_jumps: tuple[StampJump, ...] = ()
    """Steps in the trigger times."""
    frozen_stamps: tuple[int, int] | None = None
    """First and last record with the trigger time of the first one of them, counted from 0."""
    stamp_bits: Annotated[int, Field(ge=8, le=40, strict=True)] = 40
    """Width of the counter of trigger times, which wraps to zero (manual: 40)."""

    @model_validator(mode="after")
    def _check_frozen_stamps(self) -> TriggerFaults:
        first, last = self.frozen_stamps or (0, 1)
        if not 0 <= first < last:
            raise ValueError(
                f"frozen_stamps = [{first}, {last}]: the first record must be at least 0 and before the last"
            )
        return self


class ClockErrors(Section):
    """Relative error of each instrument's clock rate, positive if it is fast; by default none.

    The frequencies, delays, samples and time stamps of an instrument follow its own clock.
    """

    master: ClockError = 0.0
    """Clock of the master trigger."""
    burst_train: ClockError = 0.0
    """Clock of the burst train."""
    toneburst: ClockError = 0.0
    """Clock of the toneburst's generator, which sets its carrier and length."""
    tracking_train: ClockError = 0.0
    """Clock of the tracking train."""
    tracking_pulser: ClockError = 0.0
    """Clock of the tracking pulser, which sets the pulses' carrier and length."""
    digitizer: ClockError = 0.0
    """Clock of the digitizer, which sets its samples and time stamps."""


class Instruments(Section):
    """Properties of the simulated instruments."""

    dual_port_memory: Annotated[bool, Field(strict=True)] = True
    """Whether the digitizer has the optional dual-port memory that AutoDMA needs."""
    samples_per_channel: Annotated[int, Field(ge=1024, le=2**40, strict=True)] = 8_388_608
    """On-board memory of the digitizer (assumed)."""
    fpga_version: Annotated[int, Field(ge=1, le=1000, strict=True)] = 19
    """FPGA version of the digitizer; 18 and below hold at most 1000 single-port records (manual)."""
    serial_numbers: Annotated[bool, Field(strict=True)] = True
    """Whether the generators have different serial numbers, or labels where the model has none; False: neither."""
    generator_latency_s: TimeS = 100.0e-9
    """Trigger input to first output edge of a 33250A (manual, from memory: < 100 ns)."""
    digitizer_latency_s: TimeS = 0.0
    """Trigger input to sample 0 without trigger delay (assumed)."""
    aux_latency_s: TimeS = 0.0
    """Trigger input to rising edge of the AUX trigger output (assumed)."""
    aux_waits_for_trigger_delay: Annotated[bool, Field(strict=True)] = False
    """Whether that edge waits for the digitizer's trigger delay (assumed: no)."""
    message_time_s: Annotated[TimeS, Field(ge=1e-6)] = 1.0e-3
    """Duration of one SCPI message (assumed)."""
    trigger_jitter_s: JitterS = 0.0
    """Root-mean-square jitter of each 33250A from trigger to output."""
    sample_clock_jitter_s: JitterS = 0.0
    """Root-mean-square aperture jitter of the digitizer."""
    clock_error: ClockErrors = ClockErrors()
    """Relative error of each instrument's clock rate."""
    trigger_faults: TriggerFaults = TriggerFaults()
    """Faults of the digitizer's triggers and of their times."""
