"""Wait between two shots until the conditions of the bench are within their limits; every output is off meanwhile."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Sequence
from typing import Final

from drivers.interfaces import InstrumentError
from hpe_rig.bench import Condition, Reading, read_conditions

_LOG: Final = logging.getLogger("hpe_rig")
READ_INTERVAL_S: Final = 2.0
"""Interval between two readings of conditions during a wait."""
POLL_INTERVAL_S: Final = 0.2
"""Interval between two checks for a request to stop."""


def wait_for_conditions(
    conditions: Sequence[Condition],
    shot_number: int,
    keep_watch: Callable[[], None],
    sleep: Callable[[float], None] = time.sleep,
    clock: Callable[[], float] = time.monotonic,
) -> tuple[float, ...]:
    """Return the values of ``conditions`` (condition,) as soon as all are within their limits, NaN if not read.

    ``keep_watch`` is called during the wait and may raise, which ends it. Begin and end of a wait are logged. Raises
    ``InstrumentError`` if a condition stays outside its limits for longer than its ``max_wait_s``.
    """
    if not conditions:
        return ()
    keep_watch()
    readings, start_s = read_conditions(conditions), clock()
    for reading in readings:
        _LOG.info("before shot %d: %s", shot_number, reading)
    has_waited = False
    while waiting := [reading for reading in readings if not reading.accepted]:
        waited_s = clock() - start_s
        _refuse_longer_wait(waiting, shot_number, waited_s)
        if not has_waited:
            max_wait_s = min(reading.condition.max_wait_s for reading in waiting)
            _LOG.warning(
                "paused before shot %d, all outputs are off: %s; waiting for at most %g s, Ctrl-C stops",
                *(shot_number, "; ".join(map(str, waiting)), max_wait_s),
            )
        has_waited = True
        until_s = clock() + READ_INTERVAL_S
        while clock() < until_s:
            keep_watch()
            sleep(POLL_INTERVAL_S)
        readings = read_conditions(conditions)
    if has_waited:
        _LOG.warning("continuing with shot %d: %s", shot_number, "; ".join(map(str, readings)))
    return tuple(reading.value for reading in readings)


def _refuse_longer_wait(waiting: Sequence[Reading], shot_number: int, waited_s: float) -> None:
    """Raise ``InstrumentError`` if one of the readings outside their limits has been awaited for too long."""
    expired = [reading for reading in waiting if waited_s >= reading.condition.max_wait_s]
    if expired:
        names = " and ".join(reading.condition.name for reading in expired)
        readings = "; ".join(map(str, expired))
        what = f"not within the limits for {waited_s:.0f} s before shot {shot_number}: {readings}"
        remedy = f"bring {names} back, then the same command or, after complete shots, hpe-rig resume"
        raise InstrumentError(
            "conditions", what, "the bench is not as the bench file asks, or its sensor fails", remedy
        )
