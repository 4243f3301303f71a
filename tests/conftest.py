"""Settings of the whole suite: one thread of linear algebra per process, repeatable examples, unlimited width."""

import os

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
