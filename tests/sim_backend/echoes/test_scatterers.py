"""Scatterers: how many, where, and how strongly seen and moved."""

import numpy as np
import pytest

from sim_backend.echoes.scatterers import (
    NEGLIGIBLE_WEIGHT,
    depth_delay_s,
    draw_field,
    field_at,
    noticeable,
)
from sim_backend.settings.simulation import Beams, Scatterers, resolution_cell_m3, scatterer_count


def test_default_scene_has_the_resolution_cell_and_number_of_the_reference():
    assert resolution_cell_m3(Beams().tracking_width_m) == pytest.approx(0.0345e-9, rel=2e-3)
    assert scatterer_count(Scatterers(), Beams()) == 1593


def test_tracking_weight_is_half_on_the_surface_of_the_resolution_cell():
    axis = np.sqrt(2 * np.log(2)) * np.array(Beams().tracking_width_m)
    assert field_at(np.diag(axis), Beams()).tracking_weight == pytest.approx(0.5, rel=1e-14)


def test_weights_are_the_gaussians_of_eq_8_and_12():
    beams = Beams(excitation_width_m=(1e-4, 2e-4, 1e-3), tracking_width_m=(3e-5, 4e-5, 5e-4))
    x, y, z = 2e-5, -3e-5, 4e-4
    field = field_at(np.array([[x, y, z]]), beams)
    assert field.tracking_weight[0] == pytest.approx(
        np.exp(-(x**2) / (2 * 3e-5**2) - y**2 / (2 * 4e-5**2) - z**2 / (2 * 5e-4**2)), rel=1e-14
    )
    assert field.motion_weight[0] == pytest.approx(
        np.exp(-(x**2) / (2 * 1e-4**2) - y**2 / (2 * 2e-4**2) - z**2 / (2 * 1e-3**2)), rel=1e-14
    )


def test_scatterers_fill_the_box_uniformly():
    scatterers = Scatterers(per_cell=200.0)
    field = draw_field(scatterers, Beams(), np.random.default_rng(3))
    share = field.offset_m / np.array(scatterers.volume_m) + 0.5
    assert ((share >= 0) & (share < 1)).all()
    # Moments of N uniform draws, five standard errors: sd of the mean 1/sqrt(12 N), of the square 1/sqrt(180 N).
    error = 5 / np.sqrt(len(share))
    assert share.mean(axis=0) == pytest.approx(0.5, abs=error / np.sqrt(12))
    assert np.square(share - 0.5).mean(axis=0) == pytest.approx(1 / 12, abs=error / np.sqrt(180))
    assert (np.diff(field.offset_m[:, 2]) >= 0).all()


def test_no_scatterers_where_there_are_none_per_cell():
    assert len(draw_field(Scatterers(per_cell=0.0), Beams(), np.random.default_rng(3)).offset_m) == 0


def test_delay_is_two_way_or_none():
    field = field_at(np.array([[0.0, 0.0, -1e-3], [0.0, 0.0, 2e-3]]), Beams())
    assert depth_delay_s(field, "two_way", 1540.0) == pytest.approx([-2e-3 / 1540, 4e-3 / 1540], rel=1e-15)
    assert (depth_delay_s(field, "none", 1540.0) == 0.0).all()


def test_dropped_scatterers_change_the_echo_by_less_than_1e_14():
    for seed in range(20):
        field = draw_field(Scatterers(), Beams(), np.random.default_rng(seed))
        dropped = field.tracking_weight[~noticeable(field.tracking_weight)]
        # No pulse exceeds 1; an incoherent sum has the root of the summed squares.
        assert dropped.sum() <= 1e-14 * np.sqrt(np.square(field.tracking_weight).sum())
        assert len(dropped) == 0 or dropped.max() < NEGLIGIBLE_WEIGHT
