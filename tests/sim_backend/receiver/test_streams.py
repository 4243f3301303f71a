"""Random numbers of blocks of records are those of the whole capture, in whatever order and sizes blocks are drawn."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from sim_backend.receiver import RecordStream
from sim_backend.wiring import Capture

SAMPLES = 16
RECORDS = 300


def drawn(stream: RecordStream, first: int, last: int, index: int = 0) -> NDArray[np.float64]:
    first_ps = 10**9 * np.arange(RECORDS, dtype=np.int64)[first:last]
    capture = Capture(index, 0, first_ps, 10_000, SAMPLES, first)
    return stream.generator_for(capture, SAMPLES).standard_normal((last - first, SAMPLES))


@pytest.mark.parametrize(
    "blocks",
    [
        [(0, 100), (100, 200), (200, 300)],
        [(0, 100), (100, 200), (100, 200), (200, 300)],
        [(0, 50), (50, 100), (150, 200), (200, 250), (0, 50), (50, 100), (100, 110), (110, 300)],
    ],
    ids=["in turn", "one twice", "back and forth"],
)
def test_blocks_have_the_numbers_of_the_whole_capture(blocks: list[tuple[int, int]]) -> None:
    whole, stream = drawn(RecordStream(3, 1), 0, RECORDS), RecordStream(3, 1)
    for first, last in blocks:
        np.testing.assert_array_equal(drawn(stream, first, last), whole[first:last])


def test_every_capture_has_numbers_of_its_own() -> None:
    stream = RecordStream(3, 1)
    one, other = drawn(stream, 0, 100), drawn(stream, 0, 100, index=1)
    assert np.abs(np.corrcoef(other.ravel(), one.ravel())[0, 1]) < 5 / np.sqrt(other.size)
