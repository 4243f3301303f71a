"""Signals around an open bench: the first unwinds, those after it wait, and none gets lost on a good way out."""

from __future__ import annotations

import os
import signal
import threading
import time
import weakref
from collections.abc import Callable

import pytest

from hpe_rig.bench import interrupts
from hpe_rig.bench.interrupts import Terminated, interruptible, uninterrupted

posix = pytest.mark.skipif(os.name == "nt", reason="Windows has neither SIGHUP nor signals sent to oneself")


@posix
@pytest.mark.parametrize("name", ["SIGTERM", "SIGHUP", "SIGQUIT"])
def test_what_ends_a_program_unwinds_like_ctrl_c(name: str) -> None:
    number = getattr(signal, name)
    before = signal.getsignal(number)
    with pytest.raises(Terminated, match=name) as caught, interruptible():
        signal.raise_signal(number)
    assert caught.value.number == number
    assert signal.getsignal(number) is before


@posix
def test_a_hang_up_that_is_ignored_on_purpose_stays_ignored() -> None:
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with interruptible():
            signal.raise_signal(signal.SIGHUP)
    finally:
        signal.signal(signal.SIGHUP, before)


class Destroyed:
    """Struck by Ctrl-C while it is destroyed."""

    def __del__(self) -> None:
        signal.raise_signal(signal.SIGINT)


class Key:
    """Struck by Ctrl-C when it is looked up after what it stands for has gone."""

    gone = False

    def __hash__(self) -> int:
        if self.gone:
            signal.raise_signal(signal.SIGINT)
        return 1


def in_a_destructor() -> None:
    Destroyed()


def in_a_weak_references_callback() -> None:
    key, value, known = Key(), threading.Event(), weakref.WeakValueDictionary[Key, threading.Event]()
    known[key] = value
    key.gone = True
    del value


@posix
@pytest.mark.parametrize("where", [in_a_destructor, in_a_weak_references_callback])
def test_a_signal_where_python_drops_what_is_raised_comes_through_right_after(where: Callable[[], None]) -> None:
    def measure() -> None:
        with interruptible():
            where()
            time.sleep(5)

    with pytest.raises(KeyboardInterrupt):
        measure()


@posix
def test_a_signal_that_is_held_back_comes_through_once_the_block_is_done() -> None:
    done = []

    def make_safe() -> None:
        with uninterrupted():
            signal.raise_signal(signal.SIGTERM)
            done.append("safe")
        done.append("never")

    with pytest.raises(Terminated), interruptible():
        make_safe()
    assert done == ["safe"]


@posix
def test_a_signal_on_the_way_into_what_makes_safe_keeps_nobody_from_it() -> None:
    """A second one comes where the first is being unwound, before anything holds it back."""
    done = []

    def unwind() -> None:
        try:
            with interruptible():
                signal.raise_signal(signal.SIGINT)
        except KeyboardInterrupt:
            signal.raise_signal(signal.SIGTERM)
            done.append("safe")
            raise

    with pytest.raises(KeyboardInterrupt), uninterrupted():
        unwind()
    assert done == ["safe"]


@posix
def test_a_signal_that_somebody_swallowed_can_be_given_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(interrupts, "REPEAT_S", 0.0)
    swallowed = []

    def swallow() -> None:
        try:
            signal.raise_signal(signal.SIGTERM)
        except Terminated:
            swallowed.append(1)
        signal.raise_signal(signal.SIGTERM)

    with pytest.raises(Terminated), interruptible():
        swallow()
    assert swallowed == [1]


@posix
def test_what_went_wrong_takes_precedence_over_a_signal_that_came_meanwhile() -> None:
    def unsafe() -> None:
        signal.raise_signal(signal.SIGINT)
        raise ValueError("unsafe")

    with pytest.raises(ValueError, match="unsafe"), interruptible(), uninterrupted():
        unsafe()


@posix
def test_a_block_that_may_be_interrupted_may_be_so_also_inside_one_that_may_not() -> None:
    done = []

    def measure() -> None:
        with uninterrupted():
            with interruptible():
                signal.raise_signal(signal.SIGTERM)
                done.append("measured on")
            done.append("never")

    with pytest.raises(Terminated):
        measure()
    assert done == []


@posix
def test_a_signal_that_is_held_back_comes_through_in_the_nearest_block_that_may_be_interrupted() -> None:
    done = []

    def measure() -> None:
        with uninterrupted():
            with interruptible():
                with uninterrupted():
                    signal.raise_signal(signal.SIGTERM)
                    done.append("safe")
                done.append("never")
            done.append("never")

    with pytest.raises(Terminated):
        measure()
    assert done == ["safe"]


@pytest.mark.parametrize(("event", "goes"), [(0, False), (1, False), (2, True), (5, True), (6, True)])
def test_a_console_closing_when_it_is_closed_and_at_log_off_and_shutdown(event: int, goes: bool) -> None:
    asked: list[int] = []
    assert interrupts._Interrupts().console_closing(event, lambda: asked.append(event)) == goes
    assert asked == [event] * goes


def test_another_thread_is_left_alone() -> None:
    before, seen = signal.getsignal(signal.SIGTERM), []

    def work() -> None:
        with interruptible(), uninterrupted():
            seen.append(signal.getsignal(signal.SIGTERM))

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert seen == [before]


def test_a_closing_windows_console_waits_until_the_bench_is_safe() -> None:
    """By what the console's own thread calls; whether Windows calls it, only Windows can show."""
    guard = interrupts._Interrupts()
    guard._finished.clear()
    asked: list[str] = []
    answers: list[bool] = []
    console = threading.Thread(
        target=lambda: answers.append(guard.console_closing(2, lambda: asked.append("interrupt"))), daemon=True
    )
    console.start()
    console.join(0.2)
    assert asked == ["interrupt"]
    assert not answers
    guard._finished.set()
    console.join(10.0)
    assert answers == [True]
    # Ctrl-C and Ctrl-Break are the C library's.
    assert not guard.console_closing(0, lambda: asked.append("again"))
    assert asked == ["interrupt"]


@posix
def test_a_repetition_that_was_held_back_asks_for_nothing_more(monkeypatch: pytest.MonkeyPatch) -> None:
    """What followed the first within ``REPEAT_S`` is dropped, also once the block that held it back is done."""
    monkeypatch.setattr(interrupts, "REPEAT_S", 60.0)
    done = []

    def unwind() -> None:
        try:
            signal.raise_signal(signal.SIGINT)
        except KeyboardInterrupt:
            with uninterrupted():
                signal.raise_signal(signal.SIGTERM)
            done.append("safe")

    with interruptible():
        unwind()
    assert done == ["safe"]
