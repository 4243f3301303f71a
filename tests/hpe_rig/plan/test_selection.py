"""Pulses and frequencies that a fit uses."""

from __future__ import annotations

import numpy as np
import pytest

from hpe_rig.bench import read_bench
from hpe_rig.plan.interference import disturbed_pulses
from hpe_rig.plan.selection import driven_frequencies_hz, select, window_pulse_count
from hpe_rig.plan.shots import make_plan
from hpe_rig.scene import Scene, parse_scene, shipped_scenes

SCENES, BENCH = shipped_scenes(), read_bench().bench


def scene(name: str, **processing: object) -> Scene:
    own = parse_scene(name, SCENES[name]).scene
    return own.model_copy(update={"processing": own.processing.model_copy(update=processing)})


@pytest.mark.parametrize(
    ("start_s", "length_s"), [(0.0, None), (0.05, None), (0.02501, 0.05), (0.0501, 0.0333), (0.0123, 0.02)]
)
def test_a_scene_counts_the_pulses_that_its_plan_selects(start_s: float, length_s: float | None) -> None:
    own = scene("muscle-force", window_start_s=start_s, window_length_s=length_s)
    assert select(own, make_plan(own, BENCH).shots[0]).window.sum() == window_pulse_count(own)


def test_window_edges_go_to_the_nearest_pulse() -> None:
    own = scene("table-1", window_start_s=2.4 / 4000, window_length_s=10 / 4000)
    assert np.flatnonzero(select(own, make_plan(own, BENCH).shots[0]).window).tolist() == list(range(2, 12))


def test_disturbed_pulses_are_not_used_where_the_scene_skips_them() -> None:
    own = scene("bovine-muscle")
    shot = make_plan(own, BENCH).shots[0]
    chosen = select(own, shot)
    assert 0 < np.count_nonzero(~chosen.used) < chosen.used.size / 4
    np.testing.assert_array_equal(chosen.used, ~disturbed_pulses(shot)[chosen.window])
    kept = own.model_copy(update={"tracking": own.tracking.model_copy(update={"disturbed": "keep"})})
    assert select(kept, shot).used.all()


def test_a_selection_can_be_limited_to_its_first_pulses() -> None:
    own = scene("muscle-force")
    shot = make_plan(own, BENCH).shots[0]
    whole, first = select(own, shot), select(own, shot, 30)
    np.testing.assert_array_equal(first.time_s, whole.time_s[:30])
    assert np.flatnonzero(first.window)[0] == np.flatnonzero(whole.window)[0]


def test_harmonics_are_driven_up_to_the_inverse_burst_length() -> None:
    own = scene("bovine-muscle")
    assert own.excitation is not None
    driven_hz = driven_frequencies_hz(own)
    assert driven_hz[0] == own.excitation.burst_rate_hz
    assert driven_hz[-1] <= 1 / own.excitation.burst_length_s[0] < driven_hz[-1] + driven_hz[0]
    assert driven_frequencies_hz(scene("table-1")).size == 0
