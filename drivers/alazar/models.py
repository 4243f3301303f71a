"""Models of digitizer boards: what each accepts and how its codes are made (docs/theory/instruments.md, 2.4 to 2.6)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

MIB: Final = 2**20


@dataclass(frozen=True, slots=True)
class BoardModel:
    """One board type; rates and ranges are those accepted, each with the vendor's id.

    ``rate_ids`` by sample rate in Hz, internal clock; ``range_ids`` by range in +-V at 50 ohm. Records are a multiple
    of ``record_multiple`` samples (``npt_record_multiple`` in NPT mode), ``record_minimum`` at least, and take
    ``record_overhead_samples`` more of the memory. FPGA versions up to ``old_fpga`` hold ``old_fpga_records`` records
    of a single-port capture, newer ones ``max_records``; the library states the trigger times of the first
    ``stamped_records``. ``samples_per_timestamp`` is how many samples a count in the record headers stands for, where
    the board does not report it. ``always_dual_port``: the memory can be read while the board captures, without option.
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
    trigger_delay_multiple: int = 1
    samples_per_timestamp: int = 2
    buffer_limit_bytes: int = 64 * MIB
    always_dual_port: bool = True
    record_overhead_samples: int = 16
    max_trigger_delay_samples: int = 9_999_999
    trigger_range_v: float = 5.0
    max_records: int = 256_000
    old_fpga: int = 0
    old_fpga_records: int = 0
    stamped_records: int = 1000

    @property
    def sample_rates_hz(self) -> tuple[float, ...]:
        """The sample rates, ascending."""
        return tuple(self.rate_ids)

    @property
    def input_ranges_v(self) -> tuple[float, ...]:
        """The input ranges, ascending."""
        return tuple(self.range_ids)

    @property
    def sample_bytes(self) -> int:
        """Bytes of a sample in memory and in buffers."""
        return 1 if self.code_bits <= 8 else 2

    @property
    def code_limits(self) -> tuple[int, int]:
        """The lowest and the highest zero-centred code.

        Of a 16-bit board the lowest is taken for its neighbour: in 16 bits it is what marks a missing record.
        """
        half = 1 << (self.code_bits - 1)
        return max(-half, -(2**15) + 1), half - 1

    def range_from_v(self, least_v: float) -> float:
        """Return the smallest input range of at least ``least_v``, the largest where none is."""
        return next((volts for volts in self.input_ranges_v if volts >= least_v), self.input_ranges_v[-1])

    def most_records(self, memory_samples: int, record_samples: int) -> int:
        """Return how many records a memory of ``memory_samples`` a channel holds."""
        return min(self.max_records, memory_samples // (record_samples + self.record_overhead_samples))

    def record_limit(self, fpga: int) -> int:
        """Return how many records of a single-port capture FPGA version ``fpga`` holds, however short they are."""
        return self.old_fpga_records if fpga <= self.old_fpga else self.max_records


# The vendor's header ("new header").
RATE_IDS: Final = {
    1e3: 0x01, 2e3: 0x02, 5e3: 0x04, 10e3: 0x08, 20e3: 0x0A, 50e3: 0x0C, 100e3: 0x0E, 200e3: 0x10, 500e3: 0x12,
    1e6: 0x14, 2e6: 0x18, 5e6: 0x1A, 10e6: 0x1C, 20e6: 0x1E, 50e6: 0x22, 100e6: 0x24,
}  # fmt: skip
FASTER: Final = {125e6: 0x25, 160e6: 0x26, 180e6: 0x27, 250e6: 0x2B, 500e6: 0x30, 1e9: 0x35}
RANGE_IDS: Final = {
    0.02: 1, 0.04: 2, 0.05: 3, 0.08: 4, 0.1: 5, 0.2: 6, 0.4: 7, 0.5: 8, 0.8: 9, 1.0: 10, 2.0: 11, 4.0: 12,
}  # fmt: skip


def _rates(*faster_hz: float) -> dict[float, int]:
    return RATE_IDS | {rate_hz: FASTER[rate_hz] for rate_hz in faster_hz}


def _ranges(*ranges_v: float) -> dict[float, int]:
    return {range_v: RANGE_IDS[range_v] for range_v in ranges_v}


# Kinds, rates, ranges at 50 ohm, record minimum and multiples: headers, guide and data sheets as two open programs for
# these boards state them alike. Record minimum, multiples and time stamps of the ATS460, and two samples a count of
# ATS9350, ATS9462 and ATS9870: guide. The ATS9440's delay of multiples of 8: an open driver; the others' are assumed,
# coarse on purpose: a multiple of 16 is one of 1, 2, 4 and 8 too. The ATS9440's samples a count are assumed, the board
# is asked. Buffers below 64 MiB: the newer guide. From memory: that PCI Express boards always have dual-port memory.
# One open driver gives 125 MS/s of the ATS9440 the id 0x26, which the header gives to 160 MS/s.
ATS460_BOARD: Final = BoardModel(
    name="ATS460",
    kind=7,
    code_bits=14,
    rate_ids=_rates(125e6),
    # The board answers 513 where this is wrong.
    range_ids=RANGE_IDS,
    record_minimum=128,
    record_multiple=16,
    npt_record_multiple=32,
    pre_trigger_multiple=64,
    buffer_limit_bytes=4 * MIB,
    always_dual_port=False,
    old_fpga=18,
    old_fpga_records=1000,
)
# fmt: off
MODELS: Final = (
    ATS460_BOARD,
    BoardModel(
        name="ATS9350", kind=14, code_bits=12, rate_ids=_rates(125e6, 250e6, 500e6),
        range_ids=_ranges(0.04, 0.1, 0.2, 0.4, 1.0, 2.0, 4.0),
        record_minimum=256, record_multiple=32, npt_record_multiple=32, pre_trigger_multiple=32,
        trigger_delay_multiple=16,
    ),
    BoardModel(
        name="ATS9440", kind=16, code_bits=14, rate_ids=_rates(125e6), range_ids=_ranges(0.1, 0.2, 0.4, 1.0, 2.0, 4.0),
        record_minimum=256, record_multiple=32, npt_record_multiple=32, pre_trigger_multiple=32,
        trigger_delay_multiple=8,
    ),
    BoardModel(
        name="ATS9462", kind=11, code_bits=16, rate_ids=_rates(125e6, 160e6, 180e6),
        range_ids=_ranges(0.2, 0.4, 0.8, 2.0, 4.0),
        record_minimum=256, record_multiple=32, npt_record_multiple=32, pre_trigger_multiple=32,
        trigger_delay_multiple=16,
    ),
    BoardModel(
        name="ATS9870", kind=13, code_bits=8, rate_ids=_rates(250e6, 500e6, 1e9),
        range_ids=_ranges(0.04, 0.1, 0.2, 0.4, 1.0, 2.0, 4.0),
        record_minimum=256, record_multiple=64, npt_record_multiple=64, pre_trigger_multiple=64,
        trigger_delay_multiple=16,
    ),
)
# fmt: on


def model_named(name: str) -> BoardModel:
    """Return the board called ``name``; raise ``ValueError`` for one that has no driver here."""
    found = next((model for model in MODELS if model.name == name), None)
    if found is None:
        raise ValueError(f"no driver for a board {name!r}; there are {', '.join(model.name for model in MODELS)}")
    return found
