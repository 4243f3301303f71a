"""Settings of the board: what each function changes, None for values that it refuses.

Source: docs/theory/instruments.md, 2.4 and 2.5.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from sim_backend.digitizer import codes
from sim_backend.digitizer.board import BoardSettings, Engine, Input
from sim_backend.digitizer.boards import BoardType

Changes = dict[str, Any]


def capture_clock(board: BoardType, source: int, rate: int, edge: int, decimation: int) -> Changes | None:
    """Return the changes of an internal clock; the external clock is not simulated."""
    if source != 1 or edge not in (0, 1) or decimation or rate not in board.rates_hz:
        return None
    return {"sample_rate_hz": board.rates_hz[rate]}


def input_control(
    settings: BoardSettings, channel: int, coupling: int, range_id: int, impedance: int
) -> Changes | None:
    """Return the changes of one input; some ranges need another impedance."""
    range_v = settings.board.range_v(range_id, impedance)
    if coupling not in (1, 2) or range_v is None:
        return None
    changed = list(settings.inputs)
    changed[channel.bit_length() - 1] = Input(range_v, impedance)
    return {"inputs": tuple(changed)}


def trigger_operation(operation: int, engines: Sequence[int]) -> Changes | None:
    """Return the changes of both trigger engines, (engine, source, slope, level) each."""
    first, second = engines[:4], engines[4:]
    valid = len(engines) == 8 and 0 <= operation <= 6 and {first[0], second[0]} == {0, 1}
    valid = valid and all(
        source in (0, 1, 2, 3) and slope in (1, 2) and 0 <= level <= 255 for _, source, slope, level in (first, second)
    )
    if not valid:
        return None
    by_engine = {engine[0]: Engine(*engine[1:]) for engine in (first, second)}
    return {"operation": operation, "engines": (by_engine[0], by_engine[1])}


def external_trigger(coupling: int, range_id: int) -> Changes | None:
    """Return the changes of the external trigger input."""
    if coupling not in (1, 2) or range_id not in codes.EXTERNAL_RANGES_V:
        return None
    return {"external_range_v": codes.EXTERNAL_RANGES_V[range_id]}


def record_size(board: BoardType, pre: int, post: int, samples_per_channel: int) -> Changes | None:
    """Return the changes of a record's samples before and after the trigger."""
    samples = pre + post
    valid = samples >= board.shortest_record and samples % board.granule == 0
    valid = valid and pre % board.pre_trigger_granule == 0 and 0 <= pre <= samples - 64
    if not valid or samples + 16 > samples_per_channel:
        return None
    return {"pre_samples": pre, "post_samples": post}


def within(field: str, value: int, lowest: int, highest: int) -> Changes | None:
    """Return the change of one setting that takes a range of numbers."""
    return {field: value} if lowest <= value <= highest else None


def trigger_delay(board: BoardType, samples: int) -> Changes | None:
    """Return the change of the trigger delay."""
    return None if samples % board.delay_granule else within("delay_samples", samples, 0, codes.MOST_DELAY_SAMPLES)
