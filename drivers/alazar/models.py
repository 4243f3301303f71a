"""Models of digitizer boards: what each accepts and how its codes are made (docs/theory/instruments.md, 2.4 to 2.6)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True, slots=True)
class BoardModel:
    """One board type; rates and ranges are those accepted, each with the vendor's id.

    ``rate_ids`` by sample rate in Hz, internal clock; ``range_ids`` by range in +-V at 50 ohm. Records are a multiple
    of ``record_multiple`` samples (``npt_record_multiple`` in NPT mode), ``record_minimum`` at least, and take
    ``record_overhead_samples`` more of the memory. FPGA versions up to ``old_fpga`` hold ``old_fpga_records`` records
    of a single-port capture, newer ones ``max_records``; the library states the trigger times of the first
    ``stamped_records``.
    """

    name: str
    kind: int
    code_bits: int
    rate_ids: Mapping[float, int]
    range_ids: Mapping[float, int]
    record_minimum: int
    record_multiple: int
    npt_record_multiple: int
    pre_trigger_multiple: int
    record_overhead_samples: int
    max_trigger_delay_samples: int
    trigger_range_v: float
    max_records: int
    old_fpga: int
    old_fpga_records: int
    stamped_records: int

    @property
    def sample_rates_hz(self) -> tuple[float, ...]:
        """The sample rates, ascending."""
        return tuple(self.rate_ids)

    @property
    def input_ranges_v(self) -> tuple[float, ...]:
        """The input ranges, ascending."""
        return tuple(self.range_ids)

    @property
    def code_limits(self) -> tuple[int, int]:
        """The lowest and the highest zero-centred code."""
        half = 1 << (self.code_bits - 1)
        return -half, half - 1

    def most_records(self, memory_samples: int, record_samples: int) -> int:
        """Return how many records a memory of ``memory_samples`` a channel holds."""
        return min(self.max_records, memory_samples // (record_samples + self.record_overhead_samples))

    def record_limit(self, fpga: int) -> int:
        """Return how many records of a single-port capture FPGA version ``fpga`` holds, however short they are."""
        return self.old_fpga_records if fpga <= self.old_fpga else self.max_records


RATE_IDS: Final = {
    1e3: 0x01, 2e3: 0x02, 5e3: 0x04, 10e3: 0x08, 20e3: 0x0A, 50e3: 0x0C, 100e3: 0x0E, 200e3: 0x10, 500e3: 0x12,
    1e6: 0x14, 2e6: 0x18, 5e6: 0x1A, 10e6: 0x1C, 20e6: 0x1E, 50e6: 0x22, 100e6: 0x24, 125e6: 0x25,
}  # fmt: skip
# From memory of the data sheet; the board answers 513 where this is wrong.
RANGE_IDS: Final = {
    0.02: 1, 0.04: 2, 0.05: 3, 0.08: 4, 0.1: 5, 0.2: 6, 0.4: 7, 0.5: 8, 0.8: 9, 1.0: 10, 2.0: 11, 4.0: 12,
}  # fmt: skip
ATS460_BOARD: Final = BoardModel(
    name="ATS460",
    kind=7,
    code_bits=14,
    rate_ids=RATE_IDS,
    range_ids=RANGE_IDS,
    record_minimum=128,
    record_multiple=16,
    npt_record_multiple=32,
    pre_trigger_multiple=64,
    record_overhead_samples=16,
    max_trigger_delay_samples=9_999_999,
    trigger_range_v=5.0,
    max_records=256_000,
    old_fpga=18,
    old_fpga_records=1000,
    stamped_records=1000,
)
MODELS: Final = (ATS460_BOARD,)


def model_named(name: str) -> BoardModel:
    """Return the board called ``name``; raise ``ValueError`` for one that has no driver here."""
    found = next((model for model in MODELS if model.name == name), None)
    if found is None:
        raise ValueError(f"no driver for a board {name!r}; there are {', '.join(model.name for model in MODELS)}")
    return found
