"""What every medium owes physics: it does not move before it is pushed, gives no work back, and adds up."""

import numpy as np
from hypothesis import given, settings, strategies

from sim_backend.motion.force import ForcePulses
from sim_backend.motion.specimen import frequency_response, tabulate_step_response, transient_displacement
from sim_backend.settings import Specimen

WIDTH_M = (0.17e-3, 0.17e-3, 1.80e-3)


def decades(low, high):
    return strategies.floats(low, high).map(lambda power: 10.0**power)


media = strategies.builds(
    Specimen,
    medium=strategies.sampled_from(["voigt", "maxwell", "zener", "power_law"]),
    shear_modulus_pa=decades(0, 9),
    shear_viscosity_pa_s=decades(-6, 4),
    branch_modulus_pa=decades(0, 9),
    power=strategies.floats(0, 0.95),
)
trains = strategies.builds(
    lambda onsets_us, burst_us, strengths: ForcePulses(
        np.sort(np.array(onsets_us[: len(strengths)], np.int64)) * 1_000_000,
        np.sort(np.array(onsets_us[: len(strengths)], np.int64)) * 1_000_000 + burst_us * 1_000_000,
        np.array(strengths[: len(onsets_us)]),
    ),
    strategies.lists(strategies.integers(0, 100_000_000), min_size=1, max_size=6),
    strategies.integers(1, 10_000),
    strategies.lists(strategies.floats(0, 1e7), min_size=1, max_size=6),
)


@settings(max_examples=60, deadline=None)
@given(media, decades(-3, 6))
def test_every_medium_takes_power_and_gives_none_back(specimen, frequency_hz):
    """The force's mean power is w |F|^2 / 2 times -Im U."""
    response = frequency_response(specimen, WIDTH_M, np.array([frequency_hz]))[0]
    # Rounding of a loss that is nothing beside the stored energy.
    assert -response.imag >= -1e-13 * abs(response)


@settings(max_examples=10, deadline=None)
@given(media, trains)
def test_nothing_moves_before_the_first_burst(specimen, train):
    response = tabulate_step_response(specimen, WIDTH_M)
    first_ps = int(train.onset_ps[0])
    before_ps = first_ps - np.array([0, 1, 1_000, 1_000_000, 10**12], np.int64)
    assert (transient_displacement(response, train, before_ps) == 0.0).all()


@settings(max_examples=10, deadline=None)
@given(media, trains, trains)
def test_two_trains_move_the_medium_by_the_sum_of_each(specimen, one, two):
    response = tabulate_step_response(specimen, WIDTH_M)
    time_ps = np.arange(0, 110_000_000_000_000, 1_777_000_000_000)
    both = ForcePulses(*(np.concatenate([getattr(one, name), getattr(two, name)]) for name in ForcePulses.__slots__))
    apart = [transient_displacement(response, train, time_ps) for train in (one, two)]
    together = transient_displacement(response, both, time_ps)
    assert np.abs(together - apart[0] - apart[1]).max() <= 1e-12 * max(np.abs(part).max() for part in apart)


@settings(max_examples=10, deadline=None)
@given(media)
def test_a_constant_push_moves_the_medium_forward_and_never_past_twice_the_end(specimen):
    response = tabulate_step_response(specimen, WIDTH_M)
    course = response.at(np.logspace(-11, 4, 200))
    assert (course > 0).all()
    assert course.max() <= 2 * course[-1] * (1 + 1e-9)
