"""Places of the tracking transducer: who moves it between shots, while every output is off.

The twin's moves by itself. On a bench a stage does where one is installed (entry point group ``hpe_rig.stages``: one
function that takes the lateral offset in metres and returns when it is there), else whoever is asked to.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib.metadata import entry_points

from hpe_rig.bench import Bench
from hpe_rig.plan import Plan
from hpe_rig.scene import Mistake, SettingsError

Mover = Callable[[float], None]
"""Moves the tracking transducer to a lateral offset from the push, m, and returns when it stands there."""
STAGES = "hpe_rig.stages"


def require_mover(plan: Plan, simulated: bool, move: Mover | None) -> None:
    """Raise ``SettingsError`` where the plan has several places and nobody can move the transducer."""
    if simulated or move is not None or len(plan.places_m) < 2 or _stages():
        return
    what = f"{len(plan.places_m)} places, and nobody to move the tracking transducer between them"
    remedy = f"hpe-rig run at a terminal, which asks; a stage's entry point in {STAGES}; or one place a run"
    raise SettingsError("the scene", [Mistake("sweep.lateral_offset_m", what, remedy)])


def mover_of(plan: Plan, bench: Bench, move: Mover | None) -> Mover:
    """Return what moves the tracking transducer of ``bench``: the twin's own, an installed stage, or ``move``.

    A single place on a bench is where the transducer stands already.
    """
    if bench.world is not None:
        return bench.world.move_tracking
    if len(plan.places_m) < 2:
        return _stay
    stages = _stages()
    if len(stages) > 1:
        what = f"{len(stages)} stages are installed: {', '.join(sorted(stages))}"
        raise SettingsError("the bench", [Mistake("", what, f"uninstall all but one entry point in {STAGES}")])
    for stage in stages.values():
        return stage()
    return move or _stay


def _stages() -> dict[str, Callable[[], Mover]]:
    return {each.name: each.load for each in entry_points(group=STAGES)}


def _stay(lateral_m: float) -> None:
    """Leave the transducer where it is."""
