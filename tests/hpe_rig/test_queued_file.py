"""Queued files: whoever writes never waits, nothing but messages is dropped, and dropped lines are counted."""

from __future__ import annotations

import errno
import io
import threading

from hpe_rig.queued_file import MAX_CHUNKS, QueuedFile, WritingThread, queued_text


class Target(io.RawIOBase):
    """A file that takes at most five bytes at a time, and none before ``reads`` is set; its ``errors`` come first."""

    def __init__(self, errors: tuple[OSError | None, ...] = ()) -> None:
        self.reads, self.taken, self._errors = threading.Event(), b"", list(errors)

    def write(self, data: memoryview, /) -> int | None:  # type: ignore[override]
        self.reads.wait(20)
        if self._errors:
            error = self._errors.pop(0)
            if error is None:
                return None
            raise error
        self.taken += bytes(data[:5])
        return min(5, len(data))


def notice(lines: int) -> str:
    return f"({lines} lines)\n"


def test_lines_that_nobody_reads_are_dropped_and_counted_where_they_are_missing() -> None:
    target = Target()
    file = QueuedFile(target, WritingThread(), notice)
    stream = queued_text(file, "utf-8")
    # One line is being written, so it is not queued any more.
    print("first", file=stream)
    while vars(file)["_thread"].waiting:
        pass
    for number in range(MAX_CHUNKS + 7):
        print(number, file=stream)
    target.reads.set()
    assert file.wait_written(20)
    print("later", file=stream)
    assert file.wait_written(20)
    expected = ["first", *map(str, range(MAX_CHUNKS)), "(7 lines)", "later"]
    assert target.taken.decode().split("\n") == [*expected, ""]


def test_results_are_never_dropped_and_come_in_the_order_of_all_streams_of_a_terminal() -> None:
    target, thread = Target(), WritingThread()
    results, messages = (queued_text(QueuedFile(target, thread, item), "utf-8") for item in (None, notice))
    for number in range(2 * MAX_CHUNKS):
        print(number, file=results)
    print("dropped", file=messages)
    target.reads.set()
    assert thread.marker().wait(20)
    print("shown", file=messages)
    assert thread.marker().wait(20)
    assert target.taken.decode().split("\n") == [*map(str, range(2 * MAX_CHUNKS)), "(1 lines)", "shown", ""]


def test_a_failed_write_is_stated_and_the_next_chunk_is_tried_again() -> None:
    target = Target((OSError(errno.ENOSPC, "no room"),))
    target.reads.set()
    file = QueuedFile(target, WritingThread())
    stream = queued_text(file, "ascii")
    print("lost", file=stream)
    print("größer", file=stream)
    assert file.wait_written(20)
    assert file.failure is not None
    assert file.failure.errno == errno.ENOSPC
    assert target.taken == b"gr??er\n"


def test_a_full_descriptor_that_another_program_made_non_blocking_is_tried_until_it_takes_all() -> None:
    target = Target((None, None))
    target.reads.set()
    file = QueuedFile(target, WritingThread())
    file.write(b"a line of the log")
    assert file.wait_written(20)
    assert target.taken == b"a line of the log"
