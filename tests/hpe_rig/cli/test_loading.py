"""Which commands typer builds, and what is left unloaded."""

import subprocess
import sys

import pytest

from hpe_rig.cli.app import _asked_for, app

LATE = """
import sys
from hpe_rig.cli.loading import load_what_is_used
load_what_is_used()
load_what_is_used()
import numpy, scipy.special
wofz, functions = scipy.special.wofz, sys.modules["scipy.special._ufuncs"]
assert wofz is functions.wofz and not {"numpy.f2py.f2py2e", "scipy.special._basic"} & set(sys.modules)
assert abs(scipy.special.logsumexp([0.0, 0.0]) - numpy.log(2)) < 1e-15 and "erf" in scipy.special.__all__
assert "scipy.special._basic" in sys.modules and scipy.special.wofz is wofz
numpy.testing.assert_allclose(scipy.special.erf(0.0), 0.0)
assert numpy.f2py.__name__ == "numpy.f2py" and callable(numpy.f2py.run_main)
assert sum(each.__name__ == "_OfWhatIsUsed" for each in sys.meta_path if isinstance(each, type)) == 1
"""
END = """
import atexit, gc
atexit.register(lambda: print(gc.get_freeze_count() > 1000, flush=True))
from hpe_rig.cli.loading import load_what_is_used
load_what_is_used()
"""
KEPT = """
import gc
from hpe_rig.cli.loading import load_what_is_used
load_what_is_used()
before = [[] for _ in range(110_000)]
assert gc.get_freeze_count() > 100_000, "the first search keeps what is there"
found = []
gc.callbacks.append(lambda phase, info: found.append(info["collected"]) if phase == "stop" else None)
for _ in range(110_000):
    cycle = []
    cycle.append(cycle)
assert sum(found) > 80_000, "later ones find cycles"
"""
ARTISTS = """
from hpe_rig.cli.loading import load_what_is_used
load_what_is_used()
from matplotlib.lines import Line2D
line = Line2D([0.0, 1.0], [0.0, 2.0])
line.set(linewidth=3.0, color="red")
assert (line.get_linewidth(), line.get_color()) == (3.0, "red") and "antialiased" not in Line2D.set.__doc__
"""


@pytest.mark.parametrize("words", [["check", "table-1"], ["--log-level=debug", "list"], ["accuracy"]])
def test_the_command_asked_for_is_built_alone(words: list[str]) -> None:
    alone = _asked_for(words)
    assert len(alone.registered_commands) == 1
    assert not alone.registered_groups
    assert len(app.registered_commands) > 10, "the whole command line stays as it is"


@pytest.mark.parametrize("words", [[], ["--help"], ["chek"], ["list_command"], ["--log-level", "debug", "check"]])
def test_where_no_command_is_known_all_are_built(words: list[str]) -> None:
    assert _asked_for(words) is app


def test_what_nobody_uses_is_loaded_when_it_is_used() -> None:
    subprocess.run([sys.executable, "-c", LATE], check=True)


def test_artists_that_list_no_properties_take_them() -> None:
    subprocess.run([sys.executable, "-c", ARTISTS], check=True)


def test_searches_for_cycles_leave_out_what_was_loaded_alone() -> None:
    subprocess.run([sys.executable, "-c", KEPT], check=True)


def test_at_the_end_nothing_is_looked_for_that_could_be_freed() -> None:
    done = subprocess.run([sys.executable, "-c", END], check=True, capture_output=True, text=True)
    assert done.stdout == "True\n"
