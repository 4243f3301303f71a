"""Lateral offsets of the tracking transducer: scatterers and true motion of the twin off the push axis."""

from __future__ import annotations

import numpy as np
import pytest

from sim_backend.acoustics.acoustics import Acoustics
from sim_backend.echoes.scatterers import draw_field
from sim_backend.motion.field import field_transfer
from sim_backend.settings import Beams, MotionComponent, Reflector, Scatterers, SimulationSettings, Specimen
from sim_backend.wiring import Bursts, no_bursts

BOX_M = Scatterers().volume_m[0]


def rng_of(box: int) -> np.random.Generator:
    return np.random.default_rng([7, box % 2**32])


def offsets_of(lateral_offset_m: float) -> np.ndarray:
    return draw_field(Scatterers(), Beams(), rng_of(0), lateral_offset_m, rng_of).offset_m


def test_on_the_axis_nothing_changes() -> None:
    alone = draw_field(Scatterers(), Beams(), rng_of(0))
    np.testing.assert_array_equal(offsets_of(0.0), alone.offset_m)


@pytest.mark.parametrize("lateral_offset_m", [0.3e-3, -0.4e-3, 1e-3, 6.7e-3])
def test_the_box_moves_and_holds_as_many(lateral_offset_m: float) -> None:
    offset_m, count = offsets_of(lateral_offset_m), len(offsets_of(0.0))
    assert np.abs(offset_m[:, 0] - lateral_offset_m).max() <= BOX_M / 2
    assert abs(len(offset_m) - count) < 5 * np.sqrt(count)


def test_overlapping_positions_share_scatterers() -> None:
    on_axis, off_axis = offsets_of(0.0), offsets_of(0.25e-3)
    shared = {tuple(row) for row in on_axis} & {tuple(row) for row in off_axis}
    # the overlap is three quarters of the box
    assert abs(len(shared) - 0.75 * len(on_axis)) < 5 * np.sqrt(len(on_axis))
    assert not {tuple(row) for row in on_axis} & {tuple(row) for row in offsets_of(3e-3)}


@pytest.mark.parametrize(
    "lateral_offset_m", [pytest.param(1e-3, marks=pytest.mark.slow), pytest.param(4e-3, marks=pytest.mark.slow), -4e-3]
)
def test_the_true_motion_is_that_of_the_medium_at_the_offset(lateral_offset_m: float) -> None:
    """In the steady state of a train, point over focus at the push rate is the ratio of the transfer functions.

    The 30 pushes before leave a start-up of less than 0.1 %; the twin's table is good to 1e-5 of the static motion, far
    off some 1e-4 of what moves there: 0.3 %.
    """
    settings = SimulationSettings(specimen=Specimen(shear_modulus_pa=9e3, shear_viscosity_pa_s=2.0))
    onset_ps = np.arange(40) * 10**10
    push = Bursts(onset_ps, onset_ps + 10**9, np.full(40, 3e6), np.full(40, 3000.0), np.ones(40))
    time_ps = 30 * 10**10 + np.arange(400) * (10**10 // 400) + round(45.4545e6)
    width = (0.17e-3, 0.17e-3, 1.8e-3)
    moved = {at: Acoustics(settings, at).focus_displacement_m(push, time_ps, 0) for at in (0.0, lateral_offset_m)}
    turn = np.exp(-2j * np.pi * 100.0 * time_ps * 1e-12)
    ratio = (moved[lateral_offset_m] @ turn) / (moved[0.0] @ turn)
    field = field_transfer(
        settings.specimen, width, np.array([0.0, abs(lateral_offset_m)]), np.zeros(1), np.array([100.0])
    )
    expected = field[0, 1, 0] / field[0, 0, 0]
    assert abs(ratio - expected) < 3e-3 * abs(expected)


def test_a_prescribed_motion_falls_off_as_its_gaussian() -> None:
    settings = SimulationSettings(motion=(MotionComponent(frequency_hz=100.0, amplitude_m=1e-6),))
    time_ps = np.arange(10) * 10**9
    here, there = (Acoustics(settings, at).focus_displacement_m(no_bursts(), time_ps, 0) for at in (0.0, 0.17e-3))
    np.testing.assert_allclose(there, here * np.exp(-0.5), rtol=1e-12)


@pytest.mark.parametrize("moves", [True, False])
def test_a_reflector_at_rest_is_at_rest_in_a_medium_too(moves: bool) -> None:
    reflector = Reflector(position_m=(0.0, 0.0, -1e-3), moves=moves)
    settings = SimulationSettings(specimen=Specimen(), scatterers=Scatterers(per_cell=0.0, reflectors=(reflector,)))
    push = Bursts(np.zeros(1, np.int64), np.array([10**9]), np.array([3e6]), np.array([3000.0]), np.ones(1))
    medium = Acoustics(settings)._medium
    assert medium is not None
    moved_m = medium.amplitudes_m(push, np.array([10**9])) @ medium.shape
    assert bool(np.abs(moved_m).max() > 1e-9) == moves
