"""The placement of records on the pulse train by their trigger times, and its limits."""

from __future__ import annotations

import numpy as np
import pytest

from hpe_rig.store.placement import Placement, place_records

RATE_HZ, PULSES = 4000.0, 800
TRAIN = np.arange(PULSES)


def placed(period: np.ndarray, steps_s: dict[int, float] | None = None, clock: float = 1.0) -> Placement:
    """Return the placement of records at ``period`` (record,) whose times step by ``steps_s``, by record."""
    time_s = 0.3 + np.asarray(period, float) / RATE_HZ * clock
    for record, step_s in (steps_s or {}).items():
        time_s[record:] += step_s
    return of_times(time_s)


def of_times(time_s: np.ndarray) -> Placement:
    delivered, padded_s = np.zeros(PULSES, bool), np.full(PULSES, np.nan)
    delivered[: time_s.size], padded_s[: time_s.size] = True, time_s
    return place_records(delivered, padded_s, RATE_HZ)


def test_a_complete_train_has_the_numbers_of_its_records() -> None:
    placement = placed(TRAIN)
    assert placement.is_identity
    assert (placement.unlocated, placement.stray, placement.remarks) == (0, (), ())
    assert not placement.loose.any()


@pytest.mark.parametrize("clock", [1 - 1e-2, 1 + 1e-4, 1 + 1e-2])
def test_lost_triggers_leave_gaps_with_any_clock(clock: float) -> None:
    pulses = np.delete(TRAIN, [7, *range(100, 180)])
    placement = placed(pulses, clock=clock)
    np.testing.assert_array_equal(placement.pulse[: pulses.size], pulses)
    assert placement.unlocated == 0


def test_shifted_records_beyond_an_end_of_the_train_and_those_without_a_pulse_have_none() -> None:
    delivered = np.array([True, True, True, False])
    placement = Placement(np.array([0, 2, -1, -1]), delivered, ~delivered)
    assert not placement.is_identity
    assert placement.record.tolist() == [0, -1, 1, -1]
    for step, pulse in ((1, [1, 3, -1, -1]), (2, [2, -1, -1, -1]), (0, [0, 2, -1, -1])):
        assert placement.shifted(np.full(4, step)).pulse.tolist() == pulse
    assert Placement(np.array([0, 1, 2, -1]), delivered, ~delivered).is_identity


def test_two_records_one_period_apart_are_the_train_and_a_single_one_before_them_is_stray() -> None:
    delivered = np.array([True, True, True, False, False])
    time_s = np.array([0.3, 1.0, 2.0, np.nan, np.nan]) / RATE_HZ
    placement = place_records(delivered, time_s, RATE_HZ)
    assert placement.pulse.tolist() == [-1, 0, 1, -1, -1]
    assert placement.stray == (0,)


def test_of_two_records_that_are_further_apart_than_the_train_is_long_the_first_is_stray() -> None:
    delivered = np.array([True] * 2 + [False] * 5)
    time_s = np.array([0.3, 10.3, *[np.nan] * 5]) / RATE_HZ
    placement = place_records(delivered, time_s, RATE_HZ)
    assert placement.pulse.tolist() == [-1, 0, -1, -1, -1, -1, -1]
    assert placement.stray == (0,)


@pytest.mark.parametrize("lost", [[0], [799], [0, 1, 799]])
def test_pulses_missing_at_an_end_have_no_known_place(lost: list[int]) -> None:
    pulses = np.delete(TRAIN, lost)
    placement = placed(pulses)
    np.testing.assert_array_equal(placement.pulse[: pulses.size], pulses - pulses[0])
    assert placement.unlocated == len(lost)


@pytest.mark.parametrize("stray", [[-3.5], [-3.0], [10.4], [10.93, 300.5], [799.0 - 0.5]])
def test_stray_triggers_shift_no_record(stray: list[float]) -> None:
    period = np.sort([*TRAIN, *stray])[:PULSES]
    placement = placed(period)
    expected = np.where(np.isin(period, TRAIN), np.round(period), -1)
    np.testing.assert_array_equal(placement.pulse, expected)
    assert placement.stray == tuple(np.flatnonzero(expected < 0))
    # The capture ended with its last record, before the end of the train.
    assert placement.unlocated == len(stray)


@pytest.mark.parametrize("step_s", [0.25, -0.25, 0.25013, 1e-3, -1e-3, -21990.23])
@pytest.mark.parametrize("lost", [[], [50], [600]])
def test_records_after_a_step_of_the_counter_are_counted_on(step_s: float, lost: list[int]) -> None:
    pulses = np.delete(TRAIN, lost)
    placement = placed(pulses, {311: step_s})
    np.testing.assert_array_equal(placement.pulse[: pulses.size], pulses)
    assert placement.remarks == (f"the trigger times jump by {step_s:.3g} s at record 312",)
    assert np.flatnonzero(placement.loose).tolist() == [311]


def test_a_counter_that_wraps_loses_no_record() -> None:
    placement = of_times((0.3 + TRAIN / RATE_HZ) % 0.02)
    np.testing.assert_array_equal(placement.pulse, TRAIN)
    (remark,) = placement.remarks
    assert remark.startswith("the trigger times jump by -0.02 s 10 times, first at record")
    assert remark.endswith("as their counter wraps")


@pytest.mark.parametrize("last", [104, 200, 799])
@pytest.mark.parametrize("resumes_late", [False, True])
def test_a_counter_that_stands_still_loses_no_record(last: int, resumes_late: bool) -> None:
    time_s = 0.3 + TRAIN / RATE_HZ
    if resumes_late:
        time_s[last + 1 :] -= time_s[last] - time_s[100]
    time_s[100 : last + 1] = time_s[100]
    placement = of_times(time_s)
    np.testing.assert_array_equal(placement.pulse, TRAIN)
    assert f"the trigger times stand still from record 101 to {last + 1}" in placement.remarks


def test_records_without_a_usable_time_are_left_out_where_triggers_were_lost_among_them() -> None:
    pulses = np.delete(TRAIN, 150)
    time_s = 0.3 + pulses / RATE_HZ
    time_s[100:201] = time_s[100]
    expected = np.where((pulses > 100) & (pulses <= 201), -1, pulses)
    np.testing.assert_array_equal(of_times(time_s).pulse[:799], expected)


def test_records_without_a_time_count_on_from_the_last_that_has_one() -> None:
    """Single-port records above 1000 have none."""
    pulses = np.delete(TRAIN, [7])
    time_s = np.where(np.arange(799) < 500, 0.3 + pulses / RATE_HZ, np.nan)
    placement = of_times(time_s)
    np.testing.assert_array_equal(placement.pulse[:799], pulses)
    assert placement.loose.sum() == 299
    assert of_times(np.full(30, np.nan)).pulse[:31].tolist() == [*range(30), -1]


def test_rows_that_already_have_the_numbers_of_their_pulses_keep_them() -> None:
    """Run files of earlier versions leave the rows of lost triggers empty."""
    delivered = np.ones(PULSES, bool)
    delivered[[7, 50, 51, 799]] = False
    time_s = np.where(delivered, 0.3 + TRAIN / RATE_HZ, np.nan)
    for times_s in (time_s, np.full(PULSES, np.nan)):
        assert place_records(delivered, times_s, RATE_HZ).is_identity


def test_a_second_trigger_after_each_pulse_is_stray() -> None:
    placement = placed(np.repeat(np.arange(400), 2) + np.tile([0.0, 0.4], 400))
    np.testing.assert_array_equal(placement.pulse, np.where(np.arange(800) % 2, -1, np.arange(800) // 2))


@pytest.mark.parametrize("seed", range(6))
def test_any_trigger_times_give_every_pulse_one_record_at_most(seed: int) -> None:
    random = np.random.default_rng(seed)
    count, scale = int(random.integers(1, PULSES + 1)), 10.0 ** random.uniform(-6, 3)
    time_s = random.choice([np.sort, np.array])(random.uniform(-scale, scale, count))
    if seed % 2:
        time_s = np.round(time_s * RATE_HZ * random.choice([0.5, 1.0, 2.0])) / RATE_HZ
    time_s[random.random(count) < 0.1] = np.nan
    pulse = of_times(time_s).pulse
    assert pulse[count:].max(initial=-1) == -1
    assert -1 <= pulse.min() <= pulse.max() < PULSES
    assert np.bincount(pulse[pulse >= 0]).max(initial=0) <= 1


def test_few_records_are_placed_without_a_train() -> None:
    assert of_times(np.array([0.1])).pulse[:2].tolist() == [0, -1]
    assert of_times(np.array([0.1, 0.1 + 0.4 / RATE_HZ])).pulse[:2].tolist() == [0, -1]
    assert not (place_records(np.zeros(4, bool), np.full(4, np.nan), RATE_HZ).pulse >= 0).any()
