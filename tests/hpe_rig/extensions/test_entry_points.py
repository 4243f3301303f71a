"""Entry points: names without imports, equal names of two packages, and failures that name their package."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from importlib.metadata import EntryPoint
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from hpe_rig.extensions import ESTIMATORS, ExtensionError, call, entry_points as module, installed, load, named, origin


class Point(EntryPoint):
    """An entry point of a package that need not be installed."""

    @property
    def dist(self) -> Any:
        return PACKAGES.get(self.value)


PACKAGES = {
    "json:dumps": SimpleNamespace(name="alpha", version="1.0"),
    "json:loads": SimpleNamespace(name="beta", version="2.0"),
    "no_such_module:thing": SimpleNamespace(name="broken", version="0.1"),
}
POINTS = [
    Point("twice", "json:loads", ESTIMATORS),
    Point("twice", "json:dumps", ESTIMATORS),
    Point("broken", "no_such_module:thing", ESTIMATORS),
    Point("orphan", "json:JSONDecoder", ESTIMATORS),
]


@pytest.fixture(autouse=True)
def points(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr(module, "entry_points", lambda group: POINTS)
    module._group.cache_clear()
    load.cache_clear()
    yield
    monkeypatch.undo()
    module._group.cache_clear()
    load.cache_clear()


def test_names_are_listed_sorted_and_without_imports() -> None:
    assert installed(ESTIMATORS) == ("broken", "orphan", "twice")


def test_of_equal_names_the_first_package_applies() -> None:
    assert origin(ESTIMATORS, "twice") == f"twice ({ESTIMATORS}, of alpha 1.0)"
    assert load(ESTIMATORS, "twice").__name__ == "dumps"


def test_a_name_has_its_package_only_if_it_is_an_extension() -> None:
    assert named(ESTIMATORS, "coherent") == "coherent"
    assert named(ESTIMATORS, "orphan") == f"orphan ({ESTIMATORS}, of an unknown package)"


def leave() -> None:
    """End the program, as a plug-in must not."""
    raise SystemExit(0)


def test_code_of_another_package_cannot_end_the_program() -> None:
    with pytest.raises(ExtensionError, match=r"medium x tried to end the program \(SystemExit: 0\)\. Try: report it"):
        call("medium x", leave)


def test_code_that_hangs_is_named_after_its_time_and_not_called_again() -> None:
    returns, calls = threading.Event(), list[int]()

    def hang() -> None:
        calls.append(1)
        returns.wait(20)

    try:
        for words in (r"has not returned within 0 s", r"has not returned since an earlier call"):
            with pytest.raises(ExtensionError, match=rf"importer slow {words}\. Try"):
                call("importer slow", hang, timeout_s=0.05)
    finally:
        returns.set()
    assert calls == [1]


def test_expected_errors_and_the_settings_of_numpy_pass() -> None:
    with pytest.raises(KeyError, match="lost"):
        call("medium y", lambda: {}["lost"], expected=(KeyError,))
    with np.errstate(divide="raise"), pytest.raises(ExtensionError, match=r"medium y failed \(FloatingPointError"):
        call("medium y", lambda: np.ones(1) / np.zeros(1))


def test_a_failure_names_package_cause_and_remedy() -> None:
    with pytest.raises(ExtensionError, match=r"broken \(.*, of broken 0\.1\) does not load \(ModuleNotFoundError.*Try"):
        load(ESTIMATORS, "broken")
