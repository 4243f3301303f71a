"""Models of digitizer boards: what each accepts, one row a board (docs/explanation/instruments.md, 2.4 to 2.6)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

MIB: Final = 2**20

# The vendor's numbers for sample rates (Hz, internal clock), input ranges (+-V) and external trigger ranges (+-V).
RATE_IDS: Final = {
    1e3: 0x01, 2e3: 0x02, 5e3: 0x04, 10e3: 0x08, 20e3: 0x0A, 50e3: 0x0C, 100e3: 0x0E, 200e3: 0x10, 500e3: 0x12,
    1e6: 0x14, 2e6: 0x18, 5e6: 0x1A, 10e6: 0x1C, 20e6: 0x1E, 50e6: 0x22, 100e6: 0x24,
    125e6: 0x25, 160e6: 0x26, 180e6: 0x27, 200e6: 0x28, 250e6: 0x2B, 400e6: 0x2D, 500e6: 0x30, 800e6: 0x32,
    1e9: 0x35, 1.2e9: 0x37, 1.5e9: 0x3A, 1.6e9: 0x3B, 1.8e9: 0x3D, 2e9: 0x3F,
}  # fmt: skip
RANGE_IDS: Final = {
    0.02: 1, 0.04: 2, 0.05: 3, 0.08: 4, 0.1: 5, 0.2: 6, 0.4: 7, 0.5: 8, 0.8: 9, 1.0: 10, 2.0: 11, 4.0: 12,
}  # fmt: skip
TRIGGER_RANGE_IDS: Final = {5.0: 0, 1.0: 1, 2.5: 3}


@dataclass(frozen=True, slots=True)
class BoardModel:
    """One board type.

    Attributes:
        name: as in the bench file.
        kind: the vendor's number of the board type.
        code_bits: bits of a sample.
        sample_rates_hz: with the internal clock, ascending.
        input_ranges_v: +-V at 50 ohm, ascending.
        record_minimum: samples of the shortest record.
        record_multiple: a record is a multiple of so many samples, in NPT mode of ``npt_record_multiple``.
        pre_trigger_multiple: as above, for the samples before the trigger.
        trigger_delay_multiple: as above, for the trigger delay.
        trigger_range_v: full scale (+-V) of the external trigger input.
        samples_per_timestamp: samples a count in the record headers, if the board does not report it.
        buffer_limit_bytes: an AutoDMA buffer is smaller than this.
        always_dual_port: the memory can be read during a capture, without an option.
        record_overhead_samples: samples of the memory that a record needs in addition to its length.
        max_records: of a single-port capture; ``old_fpga_records`` with FPGA versions up to ``old_fpga``.
        stamped_records: the library states the trigger times of the first so many single-port records.
        clock_accuracy: largest relative error of the internal clock (data sheets, from memory; ATS9462 assumed).
    """

    name: str
    kind: int
    code_bits: int
    sample_rates_hz: tuple[float, ...]
    input_ranges_v: tuple[float, ...]
    record_minimum: int = 256
    record_multiple: int = 32
    npt_record_multiple: int = 32
    pre_trigger_multiple: int = 32
    trigger_delay_multiple: int = 16
    trigger_range_v: float = 5.0
    samples_per_timestamp: int = 2
    buffer_limit_bytes: int = 64 * MIB
    always_dual_port: bool = True
    record_overhead_samples: int = 16
    max_trigger_delay_samples: int = 9_999_999
    max_records: int = 256_000
    old_fpga: int = 0
    old_fpga_records: int = 0
    stamped_records: int = 1000
    clock_accuracy: float = 2e-6

    @property
    def rate_ids(self) -> Mapping[float, int]:
        """The vendor's numbers of the sample rates, by Hz."""
        return {rate_hz: RATE_IDS[rate_hz] for rate_hz in self.sample_rates_hz}

    @property
    def range_ids(self) -> Mapping[float, int]:
        """The vendor's numbers of the input ranges, by +-V."""
        return {range_v: RANGE_IDS[range_v] for range_v in self.input_ranges_v}

    @property
    def trigger_range_id(self) -> int:
        """The vendor's number of the external trigger range."""
        return TRIGGER_RANGE_IDS[self.trigger_range_v]

    @property
    def sample_bytes(self) -> int:
        """Bytes of a sample in memory and in buffers."""
        return 1 if self.code_bits <= 8 else 2

    @property
    def code_limits(self) -> tuple[int, int]:
        """The lowest and the highest zero-centred code.

        A run file marks a missing record with the lowest int16, so a 16-bit board's lowest code is raised by one.
        """
        half = 1 << (self.code_bits - 1)
        return max(-half, -(2**15) + 1), half - 1

    def range_from_v(self, min_range_v: float) -> float:
        """Return the smallest input range of at least ``min_range_v``, else the largest range."""
        return next((range_v for range_v in self.input_ranges_v if range_v >= min_range_v), self.input_ranges_v[-1])

    def most_records(self, memory_samples: int, record_samples: int) -> int:
        """Return how many records fit into ``memory_samples`` of a channel."""
        return min(self.max_records, memory_samples // (record_samples + self.record_overhead_samples))

    def record_limit(self, fpga: int) -> int:
        """Return the largest record count of a single-port capture with FPGA version ``fpga``."""
        return self.old_fpga_records if fpga <= self.old_fpga else self.max_records


def _rates_from(min_hz: float, *above_100_mhz: float) -> tuple[float, ...]:
    return (*(rate_hz for rate_hz in RATE_IDS if min_hz <= rate_hz <= 100e6), *above_100_mhz)


# Sources. Kinds and vendor's numbers: the vendor's header. Bits, rates, ranges at 50 ohm: data sheets, and two open
# programs that agree with them. Record sizes of the ATS460, samples a count of ATS9350, ATS9462 and ATS9870: SDK guide.
# Other record sizes: the same open programs. Trigger delay of the ATS9440 in steps of 8: an open driver.
# Assumed: the other delay steps (16 is valid wherever 1, 2, 4, 8 are), the ATS9440's samples a count (the board is
# asked), and that PCI Express boards have dual-port memory. One open driver numbers the ATS9440's 125 MS/s 0x26, which
# the header gives to 160 MS/s.
# fmt: off
ATS460_BOARD: Final = BoardModel(
    "ATS460", kind=7, code_bits=14, sample_rates_hz=_rates_from(1e3, 125e6), input_ranges_v=tuple(RANGE_IDS),
    record_minimum=128, record_multiple=16, npt_record_multiple=32, pre_trigger_multiple=64, trigger_delay_multiple=1,
    buffer_limit_bytes=4 * MIB, always_dual_port=False, old_fpga=18, old_fpga_records=1000,
    clock_accuracy=25e-6,
)
MODELS: Final = (
    ATS460_BOARD,
    BoardModel(
        "ATS9350", kind=14, code_bits=12, sample_rates_hz=_rates_from(1e3, 125e6, 250e6, 500e6),
        input_ranges_v=(0.04, 0.1, 0.2, 0.4, 1.0, 2.0, 4.0),
    ),
    BoardModel(
        "ATS9440", kind=16, code_bits=14, sample_rates_hz=_rates_from(1e3, 125e6),
        input_ranges_v=(0.1, 0.2, 0.4, 1.0, 2.0, 4.0), trigger_delay_multiple=8,
    ),
    BoardModel(
        "ATS9462", kind=11, code_bits=16, sample_rates_hz=_rates_from(1e3, 125e6, 160e6, 180e6),
        input_ranges_v=(0.2, 0.4, 0.8, 2.0, 4.0), clock_accuracy=25e-6,
    ),
    BoardModel(
        "ATS9870", kind=13, code_bits=8, sample_rates_hz=_rates_from(1e3, 250e6, 500e6, 1e9),
        input_ranges_v=(0.04, 0.1, 0.2, 0.4, 1.0, 2.0, 4.0),
        record_multiple=64, npt_record_multiple=64, pre_trigger_multiple=64,
    ),
)
# fmt: on
BOARD_NAMES: Final = tuple(model.name for model in MODELS)


def model_named(name: str) -> BoardModel:
    """Return the board called ``name``; raise ``ValueError`` if there is no driver for it."""
    for model in MODELS:
        if model.name == name:
            return model
    raise ValueError(f"no driver for a board {name!r}; there are {', '.join(BOARD_NAMES)}")
