"""One thread of linear algebra, as the command line sets it, and the whole suite on every core.

Many small matrices gain nothing from more threads. Where files or tests are named, or workers by ``-n``, or where
pytest-xdist is missing, all runs in one process; ``pytest -n 0`` runs the whole suite so.
"""

import functools
import gc
import os
import sys
from pathlib import Path

import pytest
import typer.testing
from hypothesis import settings

for library in ("OMP", "OPENBLAS", "MKL"):
    os.environ.setdefault(f"{library}_NUM_THREADS", "1")

if os.environ.pop("PYTHONDONTWRITEBYTECODE", ""):
    # No bytecode beside the sources; but the processes of the suite, and those that they start, need not each compile
    # every file, with the tests' assertions taken apart.
    os.environ["PYTHONPYCACHEPREFIX"] = str(Path(__file__).parents[1] / ".pytest_cache" / "bytecode")
    sys.pycache_prefix, sys.dont_write_bytecode = os.environ["PYTHONPYCACHEPREFIX"], False

# The same examples in every run: what passes here passes there.
settings.register_profile("seeded", derandomize=True)
settings.load_profile("seeded")

# The tree of commands is the same at every call, and made anew takes longer than most commands of the tests.
typer.testing._get_command = functools.cache(typer.testing._get_command)

# What the tests leave behind is looked through for cycles seldom: objects to look through are many, cycles few.
gc.set_threshold(50_000)

MOST_WORKERS = 8
"""Each collects the tests for itself, so that more gain little. One more than there are cores: a fifth of the suite's
time is waiting for timeouts, sockets and other processes."""


@pytest.hookimpl(tryfirst=True)
def pytest_cmdline_main(config: pytest.Config) -> None:
    """Share the whole suite out, file by file: what a file's tests share is made once."""
    option, cores = config.option, os.cpu_count() or 1
    workers = min(cores + 1, MOST_WORKERS)
    whole = config.args_source is pytest.Config.ArgsSource.TESTPATHS and not hasattr(config, "workerinput")
    alone = cores == 1 or option.collectonly or option.usepdb or option.capture == "no"
    if whole and not alone and getattr(option, "numprocesses", 0) is None:
        option.numprocesses, option.dist = workers, "loadfile"
        # By number of tests the long files, of few tests, would come last, when nobody is left to share with.
        option.loadscopereorder = False


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the longest files: at the end workers wait for each other on short ones.

    What is collected stays to the end, so no search for garbage need look through it.
    """
    items.sort(key=lambda item: {"system", "transports"}.isdisjoint(item.path.parts))
    gc.collect()
    gc.freeze()


@pytest.fixture(autouse=True)
def no_stated_width(monkeypatch: pytest.MonkeyPatch) -> None:
    """Print to files as wide as it takes: the processes that share the suite find COLUMNS in their environment."""
    monkeypatch.delenv("COLUMNS", raising=False)
