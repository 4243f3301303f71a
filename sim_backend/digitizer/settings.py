"""Settings of the board: what each function changes, None for values that it refuses.

Source: docs/theory/instruments.md, 2.4 and 2.5.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from sim_backend.digitizer import codes
from sim_backend.digitizer.board import BoardSettings, Engine, Input

Changes = dict[str, Any]


def capture_clock(source: int, rate: int, edge: int, decimation: int) -> Changes | None:
    """Return the changes of an internal clock; the external clock is not simulated."""
    if source != 1 or edge not in (0, 1) or decimation or rate not in codes.SAMPLE_RATES_HZ:
        return None
    return {"sample_rate_hz": codes.SAMPLE_RATES_HZ[rate]}


def input_control(
    settings: BoardSettings, channel: int, coupling: int, range_id: int, impedance: int
) -> Changes | None:
    """Return the changes of one input; the largest ranges need 1 Mohm."""
    highest = {codes.IMPEDANCE_1_MOHM: max(codes.INPUT_RANGES_V), codes.IMPEDANCE_50_OHM: codes.HIGHEST_50_OHM_RANGE}
    if channel not in (1, 2) or coupling not in (1, 2) or not 1 <= range_id <= highest.get(impedance, 0):
        return None
    changed = list(settings.inputs)
    changed[channel - 1] = Input(codes.INPUT_RANGES_V[range_id], impedance)
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


def record_size(pre: int, post: int, samples_per_channel: int) -> Changes | None:
    """Return the changes of a record's samples before and after the trigger."""
    samples = pre + post
    valid = samples >= 128 and samples % 16 == 0 and pre % 64 == 0 and 0 <= pre <= samples - 64
    if not valid or samples + 16 > samples_per_channel:
        return None
    return {"pre_samples": pre, "post_samples": post}


def within(field: str, value: int, lowest: int, highest: int) -> Changes | None:
    """Return the change of one setting that takes a range of numbers."""
    return {field: value} if lowest <= value <= highest else None
