"""Settings of the whole suite: one thread per process, repeatable examples, unlimited width, locks of its own."""

import os
import re
from collections.abc import Callable, Iterator
from itertools import count
from pathlib import Path

import pytest
from hypothesis import settings

# Small matrices gain nothing from more threads, and the worker processes share the cores. Set before NumPy is loaded.
for library in ("OMP", "OPENBLAS", "MKL"):
    os.environ.setdefault(f"{library}_NUM_THREADS", "1")

# Every run draws the same examples, so that a failure is repeatable. Slow variants of a test state their own number.
settings.register_profile("seeded", derandomize=True, max_examples=25)
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


@pytest.fixture
def page_without_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have reports leave out the pictures of their shot, which take most of the time; for tests of their words."""
    monkeypatch.setattr("hpe_rig.report.page._display", lambda *_, **__: ([], [], None))


@pytest.fixture
def real_bench(tmp_path: Path) -> Callable[..., Path]:
    """Return a function that writes the shipped bench file with ``simulated = false`` and returns the path.

    ``edits`` are pieces of its text and their replacements. Addresses of the generators are numbered from 10.
    """

    def write(*edits: tuple[str, str], address: str = "GPIB0::{}::INSTR") -> Path:
        # Imported here, so that NumPy is loaded after the settings above.
        from hpe_rig.bench import read_bench

        text = read_bench().text
        for old, new in (
            ("simulated = true", "simulated = false"),
            ("Simulated bench, wired as Fig. 2 of the paper", "Bench in room 12"),
            ("assumed: no hydrophone has seen it", "A. Tester, with a hydrophone"),
            *edits,
        ):
            assert old in text, old
            text = text.replace(old, new)
        number = count(10)
        text = re.sub(
            r"\[generators\.\w+\]\n",
            lambda table: f'{table[0]}address = "{address.format(next(number))}"\nserial = "none"\n',
            text,
        )
        path = tmp_path / "metal.toml"
        path.write_text(text, encoding="utf-8")
        return path

    return write
