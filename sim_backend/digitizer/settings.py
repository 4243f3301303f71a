"""Settings of the board: the changes that each function makes, None for refused values.

Source: docs/explanation/instruments.md, 2.4 and 2.5.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from sim_backend.digitizer import codes
from sim_backend.digitizer.board import BoardSettings, Engine, Input
from sim_backend.digitizer.boards import BoardType

Changes = dict[str, Any]
MIN_POST_TRIGGER_SAMPLES = 64
RECORD_OVERHEAD_SAMPLES = 16
"""Samples of the memory that a record needs in addition to its length."""


def clock_changes(board: BoardType, source: int, rate: int, edge: int, decimation: int) -> Changes | None:
    """Return the settings changed by a clock command; None if it is refused: only the internal clock is simulated."""
    if source != codes.INTERNAL_CLOCK or edge not in (0, 1) or decimation or rate not in board.rates_hz:
        return None
    return {"sample_rate_hz": board.rates_hz[rate]}


def input_changes(
    settings: BoardSettings, channel: int, coupling: int, range_id: int, impedance: int
) -> Changes | None:
    """Return the inputs with another range and impedance of one of them; None if the command is refused.

    The ranges depend on the impedance. Both couplings are accepted and behave alike. ``channel`` is the vendor's bit
    mask: 1 for the first input, 2 for the second.
    """
    range_v = settings.board.range_v(range_id, impedance)
    if coupling not in (codes.COUPLING_AC, codes.COUPLING_DC) or range_v is None:
        return None
    index = channel.bit_length() - 1
    inputs = list(settings.inputs)
    inputs[index] = Input(range_v, impedance)
    return {"inputs": tuple(inputs)}


def trigger_operation_changes(operation: int, engines: Sequence[int]) -> Changes | None:
    """Return the settings changed by a command to both trigger engines; None if it is refused.

    ``engines``: number (0 or 1), source, slope and level (0 to 255) of the first engine, then of the second, as codes
    of the vendor's library. ``operation``: its code for which engines trigger.
    """
    first, second = engines[:4], engines[4:]
    valid = len(engines) == 8 and 0 <= operation <= 6 and {first[0], second[0]} == {0, 1}
    slopes = codes.SLOPE_POSITIVE, codes.SLOPE_NEGATIVE
    valid = valid and all(
        source in (0, 1, 2, 3) and slope in slopes and 0 <= level <= 255 for _, source, slope, level in (first, second)
    )
    if not valid:
        return None
    by_number = {engine[0]: Engine(*engine[1:]) for engine in (first, second)}
    return {"operation": operation, "engines": (by_number[0], by_number[1])}


def external_trigger_changes(board: BoardType, coupling: int, range_id: int) -> Changes | None:
    """Return the settings changed by a command to the external trigger input; None if it is refused."""
    if coupling not in (codes.COUPLING_AC, codes.COUPLING_DC) or range_id not in board.trigger_ranges_v:
        return None
    return {"external_range_v": board.trigger_ranges_v[range_id]}


def record_size_changes(board: BoardType, pre: int, post: int, samples_per_channel: int) -> Changes | None:
    """Return the settings changed by a new number of samples before and after the trigger.

    None if the ``board`` refuses them or if the record does not fit ``samples_per_channel`` of its memory.
    """
    samples = pre + post
    valid = samples >= board.min_record and samples % board.record_multiple == 0
    valid = valid and pre % board.pre_trigger_multiple == 0 and 0 <= pre <= samples - MIN_POST_TRIGGER_SAMPLES
    if not valid or samples + RECORD_OVERHEAD_SAMPLES > samples_per_channel:
        return None
    return {"pre_samples": pre, "post_samples": post}


def trigger_delay_changes(board: BoardType, samples: int) -> Changes | None:
    """Return the change of the trigger delay; None if it is refused."""
    if samples % board.delay_multiple or not 0 <= samples <= codes.MAX_DELAY_SAMPLES:
        return None
    return {"delay_samples": samples}
