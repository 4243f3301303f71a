"""Settings of the whole suite: one thread per process, repeatable examples, unlimited width, locks of its own."""

import os
from collections.abc import Iterator

import pytest
from hypothesis import settings

# Small matrices gain nothing from more threads, and the worker processes share the cores. Set before NumPy is loaded.
for library in ("OMP", "OPENBLAS", "MKL"):
    os.environ.setdefault(f"{library}_NUM_THREADS", "1")

# Every run draws the same examples, so that a failure is repeatable.
settings.register_profile("seeded", derandomize=True)
settings.load_profile("seeded")


@pytest.fixture(autouse=True)
def without_terminal_width(monkeypatch: pytest.MonkeyPatch) -> None:
    """Remove COLUMNS, which pytest-xdist passes to its workers: output to a file is then as wide as its content."""
    monkeypatch.delenv("COLUMNS", raising=False)


@pytest.fixture(autouse=True, scope="session")
def folder_of_locks(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Keep the locks of each worker and its programs apart: all simulated boards have the same number."""
    with pytest.MonkeyPatch.context() as monkeypatch:
        monkeypatch.setenv("HPE_RIG_LOCKS", str(tmp_path_factory.mktemp("locks")))
        yield
