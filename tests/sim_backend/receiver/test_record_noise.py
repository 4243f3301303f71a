"""Noise of blocks is that of the whole capture, in whatever order and sizes they are asked for."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from sim_backend.receiver import RecordNoise, RecordStream, record_noise
from sim_backend.settings import Receiver
from sim_backend.wiring import Capture

SAMPLES = 16
RECORDS = 300


def capture(records: slice, index: int = 0) -> Capture:
    first_ps = 10**9 * np.arange(RECORDS, dtype=np.int64)[records]
    return Capture(index, 0, first_ps, 10_000, SAMPLES, records.start)


def noise(snr_db: float | None = 20.0) -> RecordNoise:
    return RecordNoise(Receiver(snr_db=snr_db), RecordStream(3, 1))


@pytest.fixture
def whole() -> NDArray[np.float64]:
    return noise().source_for(capture(slice(0, RECORDS)))().copy()


@pytest.mark.parametrize("at_once", [1, 1 << 30], ids=["in a thread", "at once"])
@pytest.mark.parametrize(
    "blocks",
    [
        [(0, 100), (100, 200), (200, 300)],
        [(0, 80), (80, 160), (160, 240), (240, 300)],
        [(0, 100), (100, 200), (100, 200), (200, 300)],
        [(0, 50), (50, 100), (150, 200), (200, 250), (0, 50), (50, 100), (100, 110), (110, 300)],
        [(0, 60), (60, 120), (120, 130), (130, 140), (240, 300), (180, 240)],
    ],
    ids=["in turn", "a short last one", "one twice", "back and forth", "other sizes"],
)
def test_blocks_have_the_noise_of_the_whole_capture(
    whole: NDArray[np.float64], blocks: list[tuple[int, int]], at_once: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(record_noise, "MIN_THREAD_SAMPLES", at_once)
    block = noise()
    for first, last in blocks:
        begun = block.source_for(capture(slice(first, last)))
        np.testing.assert_array_equal(begun(), whole[first:last])
        # What is added to it stays, and does not come back with the next block.
        begun()[...] += 1.0
        np.testing.assert_array_equal(begun(), whole[first:last] + 1.0)


def test_every_capture_has_noise_of_its_own(monkeypatch: pytest.MonkeyPatch, whole: NDArray[np.float64]) -> None:
    monkeypatch.setattr(record_noise, "MIN_THREAD_SAMPLES", 1)
    block = noise()
    for first in (0, 100):
        block.source_for(capture(slice(first, first + 100)))()
    other = block.source_for(capture(slice(0, 100), index=1))()
    assert np.abs(np.corrcoef(other.ravel(), whole[:100].ravel())[0, 1]) < 5 / np.sqrt(other.size)
    np.testing.assert_array_equal(block.source_for(capture(slice(200, 300)))(), whole[200:])


def test_without_noise_there_are_zeros() -> None:
    assert not noise(None).source_for(capture(slice(0, 10)))().any()
