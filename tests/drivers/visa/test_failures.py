"""Reasons of failed connections: in words for every error of the system, pyvisa and pyvisa-py."""

from __future__ import annotations

import errno
import re
import socket
import threading

import pytest
from pyvisa import VisaIOError
from pyvisa.constants import StatusCode

from drivers.visa.bounded import within
from drivers.visa.failures import failure_of


@pytest.mark.parametrize("code", [code for code in StatusCode if code < 0], ids=lambda code: code.name)
def test_no_status_code_of_visa_is_shown_as_a_number(code: StatusCode) -> None:
    for error in (VisaIOError(code), Exception(str(int(code))), Exception(f"failed with {int(code)}")):
        failure = failure_of(error)
        assert not re.search(r"-?\d{6,}", failure.what)
        assert re.search(r"[a-z]{4}", failure.what)
        assert failure.why
        assert failure.remedy


@pytest.mark.parametrize(
    ("error", "what"),
    [
        (OSError(errno.ECONNREFUSED, "x"), "refuses the connection"),
        (OSError(errno.EHOSTUNREACH, "x"), "nothing answers there"),
        (TimeoutError("timed out"), "nothing answers there"),
        (socket.gaierror(-2, "x"), "host name is unknown"),
        (FileNotFoundError(errno.ENOENT, "x"), "no such device"),
        (PermissionError(errno.EACCES, "x"), "may not use the device"),
        (OSError(errno.EBUSY, "x"), "another program"),
        (ConnectionResetError(errno.ECONNRESET, "x"), "closed the connection"),
        (Exception("error creating link: 3"), "no such device"),
        (Exception("Could not configure port: (25, 'Inappropriate ioctl for device')"), "no serial line"),
        (ValueError("its own words."), "its own words"),
        (EOFError(), "EOFError"),
    ],
)
def test_an_error_is_named_by_its_kind(error: Exception, what: str) -> None:
    assert what in failure_of(error).what


def test_the_innermost_cause_is_reported() -> None:
    error = VisaIOError(StatusCode.error_resource_not_found)
    error.__cause__ = ConnectionRefusedError(errno.ECONNREFUSED, "refused")
    assert "refuses the connection" in failure_of(error).what


def test_what_a_call_returns_too_late_is_discarded() -> None:
    release, discarded = threading.Event(), threading.Event()

    def call() -> str:
        release.wait(60.0)
        return "line"

    # The call returns after its time-out only.
    with pytest.raises(TimeoutError, match=r"longer than 0\.1 s"):
        within(0.1, call, lambda line: discarded.set())
    assert not discarded.is_set()
    release.set()
    assert discarded.wait(60.0)


def test_a_call_in_time_returns_its_value_or_raises_its_exception() -> None:
    assert within(5.0, lambda: "line", print) == "line"
    with pytest.raises(ZeroDivisionError):
        within(5.0, lambda: 1 / 0, print)
    with pytest.raises(TimeoutError, match="its own"):
        within(5.0, lambda: (_ for _ in ()).throw(TimeoutError("its own")), print)
