"""Boards that can be simulated, told apart by their kind: rates, inputs, sizes, memory.

Sources by column: kinds and ids from the vendor's header; bits, rates and ranges from data sheets, as an open program
for these boards states them; sizes of the ATS460 from the guide (docs/theory/instruments.md, 2.5), of the others from
that program; samples a count from the guide, but for the ATS9440, assumed. Assumed besides: the granule of the trigger
delay, and that a board on PCI Express is read while it captures without an option.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

IMPEDANCE_1_MOHM, IMPEDANCE_50_OHM = 1, 2
HERTZ_BY_ID: Final = {
    1: 1_000, 2: 2_000, 4: 5_000, 8: 10_000, 10: 20_000, 12: 50_000, 14: 100_000, 16: 200_000, 18: 500_000,
    20: 1_000_000, 24: 2_000_000, 26: 5_000_000, 28: 10_000_000, 30: 20_000_000, 34: 50_000_000, 36: 100_000_000,
    37: 125_000_000, 38: 160_000_000, 39: 180_000_000, 43: 250_000_000, 48: 500_000_000, 53: 1_000_000_000,
}  # fmt: skip
"""Sample rate by id, internal clock; each board has those up to 100 MS/s, and some of the others.

Time here has whole picoseconds: at 180 MS/s the clock is 80 ppm slow.
"""
COMMON: Final = 36
MILLIVOLTS_BY_ID: Final = {
    1: 20, 2: 40, 3: 50, 4: 80, 5: 100, 6: 200, 7: 400, 8: 500, 9: 800, 10: 1000, 11: 2000, 12: 4000, 13: 5000,
    14: 8000, 15: 10_000, 18: 16_000,
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class BoardType:
    """One type of board; sizes in samples. ``ranges`` holds the ids of the input ranges by impedance."""

    name: str
    kind: int
    bits: int
    channels: int
    fast_rates: tuple[int, ...]
    ranges: Mapping[int, tuple[int, ...]]
    shortest_record: int
    granule: int
    npt_granule: int
    pre_trigger_granule: int
    delay_granule: int
    samples_per_count: int = 2
    most_buffer_bytes: int = 64 << 20
    dual_port: bool = True
    old_fpga: int = 0

    @property
    def bytes_per_sample(self) -> int:
        """Bytes of a sample, its code in the upper bits."""
        return -(-self.bits // 8)

    @property
    def rates_hz(self) -> dict[int, int]:
        """Sample rates by id."""
        return {rate: hertz for rate, hertz in HERTZ_BY_ID.items() if rate <= COMMON or rate in self.fast_rates}

    def range_v(self, range_id: int, impedance: int) -> float | None:
        """Return the full scale of an input range; None where the board has no such range at that impedance."""
        return MILLIVOLTS_BY_ID[range_id] / 1000 if range_id in self.ranges.get(impedance, ()) else None


ONLY_50_OHM: Final = {IMPEDANCE_50_OHM: (2, 5, 6, 7, 10, 11, 12)}
BOARDS: Final[Mapping[str, BoardType]] = {
    board.name: board
    for board in (
        BoardType(
            "ATS460", 7, 14, 2, (37,),
            {IMPEDANCE_1_MOHM: tuple(range(1, 16)), IMPEDANCE_50_OHM: tuple(range(1, 13))},
            shortest_record=128, granule=16, npt_granule=32, pre_trigger_granule=64, delay_granule=1,
            most_buffer_bytes=4 << 20, dual_port=False, old_fpga=18,
        ),
        BoardType(
            "ATS9350", 14, 12, 2, (37, 43, 48), ONLY_50_OHM,
            shortest_record=256, granule=32, npt_granule=32, pre_trigger_granule=32, delay_granule=8,
        ),
        BoardType(
            "ATS9440", 16, 14, 4, (37,), {IMPEDANCE_50_OHM: (5, 6, 7, 10, 11, 12)},
            shortest_record=256, granule=32, npt_granule=32, pre_trigger_granule=32, delay_granule=8,
            samples_per_count=4,
        ),
        BoardType(
            "ATS9462", 11, 16, 2, (37, 38, 39),
            {IMPEDANCE_1_MOHM: (6, 7, 9, 11, 12, 14, 18), IMPEDANCE_50_OHM: (6, 7, 9, 11, 12)},
            shortest_record=256, granule=32, npt_granule=32, pre_trigger_granule=32, delay_granule=8,
        ),
        BoardType(
            "ATS9870", 13, 8, 2, (43, 48, 53), ONLY_50_OHM,
            shortest_record=256, granule=64, npt_granule=64, pre_trigger_granule=64, delay_granule=16,
        ),
    )
}  # fmt: skip
"""By the name that a bench file gives."""
