"""Between two shots, while every output is off: movement of the tracking transducer, wait for the bench's conditions.

The twin moves its transducer. On a real bench an installed stage does (entry point group ``hpe_rig.stages``), else the
``Mover`` of the caller, which asks the operator. The entry point of a stage is a ``Mover``.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Sequence
from importlib.metadata import entry_points
from typing import Final

from drivers.interfaces import InstrumentError
from hpe_rig.bench import Bench, Condition, Reading, read_conditions
from hpe_rig.plan import Plan
from hpe_rig.scene import Mistake, SettingsError

Mover = Callable[[float], None]
"""Moves the tracking transducer to a lateral offset from the push, m; returns after the movement."""
STAGES = "hpe_rig.stages"
_LOG: Final = logging.getLogger("hpe_rig")
READ_INTERVAL_S: Final = 2.0
"""Interval between two readings of conditions during a wait."""
POLL_INTERVAL_S: Final = 0.2
"""Interval between two checks for a request to stop."""


def require_mover(plan: Plan, simulated: bool, move: Mover | None) -> None:
    """Raise ``SettingsError`` if the plan has several lateral offsets and nothing can move the transducer."""
    if simulated or move is not None or len(plan.lateral_offsets_m) < 2 or _stages():
        return
    what = f"{len(plan.lateral_offsets_m)} lateral offsets, and no stage or operator moves the tracking transducer"
    remedy = f"hpe-rig run at a terminal, which asks; a stage's entry point in {STAGES}; or one offset per run"
    raise SettingsError("the scene", [Mistake("sweep.lateral_offset_m", what, remedy)])


def choose_mover(plan: Plan, bench: Bench, move: Mover | None) -> Mover:
    """Return the mover of the tracking transducer: the twin's, an installed stage, or ``move``.

    A plan with one lateral offset moves nothing on a real bench.
    """
    if bench.world is not None:
        return bench.world.move_tracking
    if len(plan.lateral_offsets_m) < 2:
        return _do_not_move
    stages = _stages()
    if len(stages) > 1:
        what = f"{len(stages)} stages are installed: {', '.join(sorted(stages))}"
        raise SettingsError("the bench", [Mistake("", what, f"uninstall all but one entry point in {STAGES}")])
    for load in stages.values():
        return load()
    return move or _do_not_move


def _stages() -> dict[str, Callable[[], Mover]]:
    return {entry_point.name: entry_point.load for entry_point in entry_points(group=STAGES)}


def _do_not_move(lateral_offset_m: float) -> None:
    """Leave the transducer at its position."""


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
