"""What moves the tracking transducer between lateral offsets: the twin, an installed stage, or the operator."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from hpe_rig.bench import Bench
from hpe_rig.measurement import between_shots, prepare, record_run
from hpe_rig.measurement.between_shots import STAGES, choose_mover, require_mover
from hpe_rig.plan import Plan
from hpe_rig.scene import SettingsError, load_scene

REAL_BENCH = cast("Bench", SimpleNamespace(world=None))


@pytest.fixture(scope="module")
def plan() -> Plan:
    offsets = {"sweep.lateral_offset_m": [0.0, 2e-3], "excitation.burst_count": 4, "processing.window_start_s": 0.0}
    return prepare(load_scene("gelatin-moduli").with_(offsets)).plan


@pytest.fixture
def stages(monkeypatch: pytest.MonkeyPatch) -> dict[str, list[float]]:
    """Return the movements of installed stages by name; a key adds a stage."""
    movements: dict[str, list[float]] = {}

    def entry_points(group: str) -> list[Any]:
        assert group == STAGES
        return [SimpleNamespace(name=name, load=lambda name=name: movements[name].append) for name in movements]

    monkeypatch.setattr(between_shots, "entry_points", entry_points)
    return movements


def test_an_installed_stage_moves_the_transducer_of_a_real_bench(plan: Plan, stages: dict[str, list[float]]) -> None:
    stages["linear"], by_hand = [], list[float]()
    require_mover(plan, simulated=False, move=None)
    choose_mover(plan, REAL_BENCH, by_hand.append)(2e-3)
    assert (stages["linear"], by_hand) == ([2e-3], [])
    stages["rotary"] = []
    with pytest.raises(SettingsError, match="2 stages are installed: linear, rotary"):
        choose_mover(plan, REAL_BENCH, None)


@pytest.mark.usefixtures("stages")
def test_without_a_stage_the_operator_moves_it_and_a_run_without_both_is_refused(plan: Plan) -> None:
    by_hand: list[float] = []
    choose_mover(plan, REAL_BENCH, by_hand.append)(2e-3)
    assert by_hand == [2e-3]
    require_mover(plan, simulated=True, move=None)
    with pytest.raises(SettingsError, match="2 lateral offsets, and no stage or operator"):
        require_mover(plan, simulated=False, move=None)


@pytest.mark.usefixtures("stages")
def test_a_run_that_nothing_can_move_is_refused_before_its_file_is_made(
    tmp_path: Path, real_bench: Callable[..., Path]
) -> None:
    offsets = {"sweep.lateral_offset_m": [0.0, 2e-3], "excitation.burst_count": 4, "processing.window_start_s": 0.0}
    scene = load_scene("gelatin-moduli").with_(offsets)
    setup = replace(prepare(scene, real_bench(), refuse=False), findings=())
    with pytest.raises(SettingsError, match="2 lateral offsets, and no stage or operator"):
        record_run(setup, tmp_path / "run.h5")
    assert not (tmp_path / "run.h5").exists()


def test_a_run_at_one_offset_moves_nothing_on_a_real_bench(stages: dict[str, list[float]]) -> None:
    single, by_hand = prepare("table-1").plan, list[float]()
    stages["linear"] = []
    require_mover(single, simulated=False, move=None)
    choose_mover(single, REAL_BENCH, by_hand.append)(0.0)
    assert (stages["linear"], by_hand) == ([], [])
