"""A task on a disk that does not respond is given up with its cause, and its late product is undone."""

from __future__ import annotations

import threading

import pytest

from hpe_rig.store.task import make_or_undo


def test_a_wait_that_another_thread_cancels_does_not_claim_the_whole_time_limit() -> None:
    cancelled, disk_answers, undone = threading.Event(), threading.Event(), threading.Event()

    def make(cancelled: threading.Event) -> str:
        disk_answers.wait(10)
        return "late product"

    threading.Timer(0.05, cancelled.set).start()
    with pytest.raises(OSError, match="has not answered before the program stopped waiting"):
        make_or_undo(make, lambda product: undone.set(), cancelled)
    assert not undone.is_set()
    disk_answers.set()
    assert undone.wait(10)
