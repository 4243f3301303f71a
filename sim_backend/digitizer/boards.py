"""Boards that can be simulated, one row a board: rates, inputs, sizes, memory.

Sources (docs/explanation/instruments.md, 2.5 and 2.10). Kinds and ids: the vendor's header. Bits, rates and ranges:
data sheets, and an open program for these boards. Sizes of the ATS460, samples a count: the guide. Other sizes: that
program. Assumed: the ATS9440's samples a count, the multiples of the trigger delay, and that a PCI Express board is
read during a capture without an option.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

IMPEDANCE_1_MOHM, IMPEDANCE_50_OHM = 1, 2
HERTZ_BY_ID: Final = {
    1: 1_000, 2: 2_000, 4: 5_000, 8: 10_000, 10: 20_000, 12: 50_000, 14: 100_000, 16: 200_000, 18: 500_000,
    20: 1_000_000, 24: 2_000_000, 26: 5_000_000, 28: 10_000_000, 30: 20_000_000, 34: 50_000_000, 36: 100_000_000,
    37: 125_000_000, 38: 160_000_000, 39: 180_000_000, 40: 200_000_000, 43: 250_000_000, 45: 400_000_000,
    48: 500_000_000, 50: 800_000_000, 53: 1_000_000_000, 55: 1_200_000_000, 58: 1_500_000_000, 59: 1_600_000_000,
    61: 1_800_000_000, 63: 2_000_000_000,
}  # fmt: skip
"""Sample rate by id, internal clock. The clock has whole picoseconds: at 180 MS/s it is 80 ppm slow."""
UP_TO_100_MHZ: Final = tuple(range(1, 37))
"""Ids of every sample rate up to 100 MS/s; numbers without a rate have no effect."""
MILLIVOLTS_BY_ID: Final = {
    1: 20, 2: 40, 3: 50, 4: 80, 5: 100, 6: 200, 7: 400, 8: 500, 9: 800, 10: 1000, 11: 2000, 12: 4000, 13: 5000,
    14: 8000, 15: 10_000, 18: 16_000,
}  # fmt: skip
"""Full scale of an input by range id."""
TRIGGER_RANGES_V: Final = {0: 5.0, 1: 1.0}
"""Full scale of the external trigger input by range id, for boards without another entry."""


@dataclass(frozen=True, slots=True)
class BoardType:
    """One type of board; sizes in samples.

    ``ranges`` holds the ids of the input ranges by impedance. Records are a multiple of ``record_multiple``, in NPT
    mode of ``npt_multiple``; ``pre_trigger_multiple`` and ``delay_multiple`` hold for the samples before the trigger
    and for the trigger delay. FPGA versions up to ``old_fpga`` hold fewer records.
    """

    name: str
    kind: int
    bits: int
    rate_ids: tuple[int, ...]
    ranges: Mapping[int, tuple[int, ...]]
    channels: int = 2
    min_record: int = 256
    record_multiple: int = 32
    npt_multiple: int = 32
    pre_trigger_multiple: int = 32
    delay_multiple: int = 8
    samples_per_count: int = 2
    max_buffer_bytes: int = 64 << 20
    dual_port: bool = True
    old_fpga: int = 0
    trigger_ranges_v: Mapping[int, float] = field(default_factory=TRIGGER_RANGES_V.copy)

    @property
    def bytes_per_sample(self) -> int:
        """Bytes of a sample, with its code in the upper bits."""
        return -(-self.bits // 8)

    @property
    def rates_hz(self) -> dict[int, int]:
        """Sample rates by id."""
        return {rate: hertz for rate, hertz in HERTZ_BY_ID.items() if rate in self.rate_ids}

    def range_v(self, range_id: int, impedance: int) -> float | None:
        """Return the full scale of an input range, None if the board has no such range at that impedance."""
        return MILLIVOLTS_BY_ID[range_id] / 1000 if range_id in self.ranges.get(impedance, ()) else None


BOARDS: Final[Mapping[str, BoardType]] = {
    board.name: board
    for board in (
        BoardType(
            "ATS460", kind=7, bits=14, rate_ids=(*UP_TO_100_MHZ, 37),
            ranges={IMPEDANCE_1_MOHM: tuple(range(1, 16)), IMPEDANCE_50_OHM: tuple(range(1, 13))},
            min_record=128, record_multiple=16, npt_multiple=32, pre_trigger_multiple=64, delay_multiple=1,
            max_buffer_bytes=4 << 20, dual_port=False, old_fpga=18,
        ),
        BoardType(
            "ATS9350", kind=14, bits=12, rate_ids=(*UP_TO_100_MHZ, 37, 43, 48),
            ranges={IMPEDANCE_50_OHM: (2, 5, 6, 7, 10, 11, 12)},
        ),
        BoardType(
            "ATS9440", kind=16, bits=14, rate_ids=(*UP_TO_100_MHZ, 37), channels=4,
            ranges={IMPEDANCE_50_OHM: (5, 6, 7, 10, 11, 12)}, samples_per_count=4,
        ),
        BoardType(
            "ATS9462", kind=11, bits=16, rate_ids=(*UP_TO_100_MHZ, 37, 38, 39),
            ranges={IMPEDANCE_1_MOHM: (6, 7, 9, 11, 12, 14, 18), IMPEDANCE_50_OHM: (6, 7, 9, 11, 12)},
        ),
        BoardType(
            "ATS9870", kind=13, bits=8, rate_ids=(*UP_TO_100_MHZ, 43, 48, 53),
            ranges={IMPEDANCE_50_OHM: (2, 5, 6, 7, 10, 11, 12)},
            record_multiple=64, npt_multiple=64, pre_trigger_multiple=64, delay_multiple=16,
        ),
    )
}  # fmt: skip
"""By the name in the bench file."""
