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
import scipy.special, numpy
assert "numpy.f2py.f2py2e" not in sys.modules
numpy.testing.assert_allclose(scipy.special.erf(0.0), 0.0)
assert numpy.f2py.__name__ == "numpy.f2py" and callable(numpy.f2py.run_main)
assert sum(each.__name__ == "_OnFirstUse" for each in sys.meta_path if isinstance(each, type)) == 1
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
