"""Echoes combined of a few exact ones: against the exact sum, and given up where the motion has too many freedoms."""

import numpy as np
import pytest

from sim_backend.echoes.combined import combined
from sim_backend.echoes.delays import EchoDelays
from sim_backend.echoes.engine import synthesise
from sim_backend.echoes.exact_sums import running_sum
from sim_backend.echoes.pulse import hann_pulse

PULSE = hann_pulse(9.0e6, 0.065)
GATE_S = (np.arange(200) - 100) * 1e-8
SCATTERERS, ECHOES = 500, 300


def scene(shapes, reach_m, seed=3):
    rng = np.random.default_rng(seed)
    rest_s = np.sort(rng.uniform(-2.5e-6, 2.5e-6, SCATTERERS))
    place = rest_s / 2.5e-6
    field = np.stack([np.cos(0.5 * (order + 1) * place + rng.uniform(0, 6)) for order in range(shapes)])
    share = 0.4 ** np.arange(shapes)
    amplitude_s = 2 / 1540.0 * reach_m * share * rng.standard_normal((ECHOES, shapes))
    return rest_s + amplitude_s @ field, rng.standard_normal(SCATTERERS)


def any_motion(delay_s):
    """A shape a scatterer: its delays are whatever they are."""
    return EchoDelays(np.zeros(SCATTERERS), np.eye(SCATTERERS), delay_s)


def rms_error(ours, exact):
    return np.sqrt(np.mean((ours - exact) ** 2) / np.mean(exact**2))


@pytest.mark.parametrize(
    ("shapes", "reach_m", "tolerance"), [(1, 1e-9, 1e-9), (4, 3e-7, 1e-6), (10, 1e-6, 1e-6), (6, 5e-6, 1e-4)]
)
def test_combined_echoes_meet_the_tolerance_with_few_exact_ones(shapes, reach_m, tolerance):
    delay_s, weight = scene(shapes, reach_m)
    found = combined(delay_s, weight, PULSE, GATE_S, tolerance)
    assert found is not None
    # Six echoes tell the error of all but for chance.
    assert rms_error(found[0], running_sum(delay_s, weight, PULSE, GATE_S)) < 2 * tolerance
    assert found[1] < ECHOES / 3


@pytest.mark.parametrize("reach_m", [1e-6, 1e-3])
def test_motion_of_too_many_freedoms_is_summed_exactly(reach_m):
    delay_s, weight = scene(4, 1e-7)
    delay_s = delay_s + 2 / 1540.0 * reach_m * np.random.default_rng(5).standard_normal(delay_s.shape)
    assert combined(delay_s, weight, PULSE, GATE_S, 1e-6) is None
    made = synthesise(any_motion(delay_s), weight, PULSE, GATE_S, 1e-6)
    assert made.method == "running_sum"
    assert np.array_equal(made.echo, running_sum(delay_s, weight, PULSE, GATE_S))


def test_few_freedoms_are_noticed_without_being_told():
    delay_s, weight = scene(5, 5e-7)
    assert synthesise(any_motion(delay_s), weight, PULSE, GATE_S, 1e-6).method == "combined"


def test_echoes_at_rest_are_one_echo():
    delay_s, weight = scene(2, 0.0)
    found = combined(delay_s, weight, PULSE, GATE_S, 1e-9)
    assert found is not None
    assert found[1] == 1
