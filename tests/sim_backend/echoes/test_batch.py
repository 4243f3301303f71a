"""Batches: many draws, gates and parameter values in one call, against each alone; and their statistics."""

from dataclasses import replace

import numpy as np
import pytest

from sim_backend.echoes.delays import EchoDelays
from sim_backend.echoes.engine import synthesise
from sim_backend.echoes.exact_sums import running_sum
from sim_backend.echoes.many_draws import DRAWS_AT_ONCE, batch, drawn_echoes
from sim_backend.echoes.pulse import echo_pulse, hann_pulse
from sim_backend.echoes.scatterers import depth_delay_s, draw_field, draw_thinned
from sim_backend.echoes.series import ScattererRows
from sim_backend.settings import Scatterers, SimulationSettings

SOUND_SPEED = 1540.0
GATE_S = (np.arange(130) - 64.5) * 1e-8
PULSE = hann_pulse(9.0e6, 0.065)
CYCLE_M = 1e-6 * np.sin(2 * np.pi * np.arange(20) / 20)
SETTINGS = SimulationSettings()


def all_draws(count, seed=0, settings=SETTINGS, displacement_m=CYCLE_M, gate_s=GATE_S, **options):
    rng = np.random.default_rng(seed)
    return np.concatenate(list(drawn_echoes(settings, displacement_m, PULSE, gate_s, rng, count, **options)))


def exact_row(scene, row, time_s=GATE_S):
    in_row = scene.row == row
    delay_s = scene.rest_s[in_row] + scene.amplitude_s[row] @ scene.shape[:, in_row]
    return running_sum(delay_s, scene.weight[in_row], PULSE, time_s)


def rms_error(ours, expected):
    return np.sqrt(np.mean((ours - expected) ** 2) / np.mean(expected**2))


def three_rows(amplitude_m=(1e-6, 3e-6, 0.0)):
    field = draw_thinned(SETTINGS, (-2e-6, 2e-6), 1e-13, np.random.default_rng(1), 3)
    amplitude_s = np.array(amplitude_m)[:, None] * CYCLE_M / 1e-6 * 2 / SOUND_SPEED
    return ScattererRows(
        field.row, field.delay_s, field.tracking_weight, field.motion_weight[None], amplitude_s[:, :, None]
    )


@pytest.mark.parametrize("amplitude_m", [(1e-6, 3e-6, 0.0), (1e-6, 1e-4, 0.0)])
def test_every_row_of_a_batch_is_its_own_exact_sum(amplitude_m):
    scene = three_rows(amplitude_m)
    ours = batch(scene, PULSE, GATE_S, 1e-8)
    for row in range(3):
        exact = exact_row(scene, row)
        assert rms_error(ours[row], exact) < 1e-8


def test_gates_longer_than_the_pulse_and_gates_shifted_by_row_are_exact_too():
    scene, gate_s = three_rows(), (np.arange(400) - 200) * 1e-8
    start_s = np.array([0.0, 3e-7, -2e-7])
    moved = ScattererRows(scene.row, scene.rest_s - start_s[scene.row], scene.weight, scene.shape, scene.amplitude_s)
    ours = batch(moved, PULSE, gate_s, 1e-10)
    for row in range(3):
        exact = exact_row(scene, row, gate_s + start_s[row])
        assert rms_error(ours[row], exact) < 1e-9


def test_scatterers_of_no_weight_are_silent():
    scene = three_rows()
    assert not batch(replace(scene, weight=0 * scene.weight), PULSE, GATE_S).any()


@pytest.mark.parametrize("bandwidth", [0.065, 0.75])
def test_sample_rate_below_nyquist_is_refused_with_both_rates(bandwidth: float) -> None:
    highest = 9.0 * (1 + bandwidth)
    slow_s = np.arange(20) / (1.9e6 * highest)
    with pytest.raises(ValueError, match=f"highest frequency of {highest:.4g} MHz, so echoes would alias"):
        batch(three_rows(), hann_pulse(9.0e6, bandwidth), slow_s)


def test_times_in_single_precision_give_the_same_echoes():
    scene, single_s = three_rows(), GATE_S.astype(np.float32)
    ours = batch(scene, PULSE, single_s, 1e-9)
    assert np.array_equal(ours, batch(scene, PULSE, single_s.astype(np.float64), 1e-9))


def test_same_seed_gives_the_same_draws_whatever_their_number():
    many = all_draws(2 * DRAWS_AT_ONCE + 5)
    assert np.array_equal(many, all_draws(2 * DRAWS_AT_ONCE + 5))
    assert np.array_equal(many[:20], all_draws(20))
    assert np.abs(many - all_draws(2 * DRAWS_AT_ONCE + 5, seed=1)).max() > 0.1


def test_each_draw_may_have_its_own_motion():
    own_m = np.linspace(0.0, 2.0, 20)[:, None] * CYCLE_M
    ours = all_draws(20, displacement_m=own_m)
    assert np.array_equal(ours[0], np.repeat(ours[0][:1], 20, axis=0))
    # The largest motion fixes what is drawn, so the last row keeps it; what is cut off, below the tolerance of 1e-6,
    # depends on the other draws of its chunk.
    same_m = np.vstack([np.tile(own_m[10], (19, 1)), own_m[-1:]])
    assert rms_error(ours[10], all_draws(20, displacement_m=same_m)[10]) < 1e-6


def test_thinned_draws_have_the_count_and_the_positions_of_full_draws():
    field = draw_thinned(SETTINGS, (-1e-6, 1.5e-6), 0.0, np.random.default_rng(2), 500)
    fraction = (1e-6 + 1.5e-6) * SOUND_SPEED / 2 / 5e-3
    count = np.bincount(field.row, minlength=500)
    # Binomial of 1593: five standard errors of mean and variance over 500 draws.
    sd = np.sqrt(1593 * fraction * (1 - fraction))
    assert count.mean() == pytest.approx(1593 * fraction, abs=5 * sd / np.sqrt(500))
    assert count.var() == pytest.approx(sd**2, rel=5 * np.sqrt(2 / 500))
    position = (field.delay_s + 1e-6) / 2.5e-6
    assert ((position >= 0) & (position < 1)).all()
    assert position.mean() == pytest.approx(0.5, abs=5 / np.sqrt(12 * len(position)))
    assert np.square(position - 0.5).mean() == pytest.approx(1 / 12, abs=5 / np.sqrt(180 * len(position)))
    assert (np.diff(field.delay_s)[np.diff(field.row) == 0] >= 0).all()


def one_draw(settings, displacement_m, gate_s, rng, tolerance=1e-9):
    """Echoes of one draw of scatterers, (echo, sample), 0 the arrival of the resting focus' echo."""
    field, speed = draw_field(settings.scatterers, settings.beams, rng), settings.sound_speed_m_per_s
    delay_s = depth_delay_s(field, settings.scatterers.axial_delay, speed)
    weight, moves, pulse = field.tracking_weight, field.motion_weight, echo_pulse(settings, 9.0e6)
    return synthesise(
        EchoDelays.of_motion(delay_s, moves, displacement_m, speed), weight, pulse, gate_s, tolerance
    ).echo


@pytest.mark.parametrize(
    "scatterers",
    [
        pytest.param(Scatterers(), marks=pytest.mark.slow),
        pytest.param(Scatterers(axial_delay="none"), marks=pytest.mark.slow),
        # Without delays reflectivity of zero mean tells by the power: it makes the sum incoherent.
        pytest.param(Scatterers(axial_delay="none", reflectivity="normal"), marks=pytest.mark.slow),
        Scatterers(axial_delay="none", reflectivity="sign"),
    ],
)
def test_thinned_echoes_have_the_mean_power_of_full_draws(scatterers):
    settings, draws = SimulationSettings(scatterers=scatterers), 250
    thinned = np.square(all_draws(draws, settings=settings, displacement_m=np.zeros(1))[:, 0]).mean(axis=1)
    rng = np.random.default_rng(3)
    full = np.square([one_draw(settings, np.zeros(1), GATE_S, rng)[0] for _ in range(draws)]).mean(axis=1)
    error = np.sqrt((thinned.var() + full.var()) / draws)
    assert thinned.mean() == pytest.approx(full.mean(), abs=4 * error)


def test_a_thinned_draw_of_nothing_is_silent():
    silent = SimulationSettings(scatterers=Scatterers(per_cell=0.0))
    assert (all_draws(3, settings=silent) == 0.0).all()


def test_reflectors_add_their_own_echo_to_every_draw():
    """Echoes are linear: what a plane and a resting point add to a draw is what they make without scatterers."""
    reflectors = [
        {"kind": "plane", "position_m": (0.0, 0.0, 3e-4), "strength": 5.0},
        {"position_m": (2e-5, 0.0, -1e-4), "strength": 20.0, "moves": False},
    ]
    settings = SimulationSettings.model_validate({"scatterers": {"reflectors": reflectors}})
    alone = SimulationSettings.model_validate({"scatterers": {"reflectors": reflectors, "per_cell": 0.0}})
    added = all_draws(18, settings=settings, tolerance=1e-12) - all_draws(18, tolerance=1e-12)
    expected = one_draw(alone, CYCLE_M, GATE_S, np.random.default_rng(0), tolerance=0.0)
    assert np.abs(expected).max() > 10
    for draw in added:
        # Three sums of 1e-12 each, of an echo of rms 10.
        assert np.abs(draw - expected).max() < 1e-9
