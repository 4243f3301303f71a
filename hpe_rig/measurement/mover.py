"""Movement of the tracking transducer between shots, while every output is off.

The twin moves its transducer. On a real bench an installed stage does (entry point group ``hpe_rig.stages``), else the
``Mover`` of the caller, which asks the operator. The entry point of a stage is a ``Mover``.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib.metadata import entry_points

from hpe_rig.bench import Bench
from hpe_rig.plan import Plan
from hpe_rig.scene import Mistake, SettingsError

Mover = Callable[[float], None]
"""Moves the tracking transducer to a lateral offset from the push, m; returns after the movement."""
STAGES = "hpe_rig.stages"


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
