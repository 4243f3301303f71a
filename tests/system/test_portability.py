"""Windows as far as another system can tell: nothing here needs what only POSIX has, and nobody's folder gets in."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PACKAGES = ("hpe_rig", "drivers", "sim_backend")
# Other people's packages are asked first, as this system has them; then ours, anew, as Windows would.
AS_ON_WINDOWS = """
import importlib, os, pkgutil, signal, sys
PACKAGES = ("hpe_rig", "drivers", "sim_backend")
def import_all():
    for package in PACKAGES:
        for found in pkgutil.walk_packages(importlib.import_module(package).__path__, package + "."):
            if not found.name.endswith("__main__"):
                importlib.import_module(found.name)
LOAD_OTHERS
for name in [name for name in sys.modules if name.partition(".")[0] in PACKAGES]:
    del sys.modules[name]
for name in ("termios", "tty", "pty", "pwd", "grp", "resource", "syslog", "posix"):
    sys.modules[name] = None
for module, names in (
    (os, "fork forkpty openpty ttyname getuid geteuid getgid getpgid getpgrp setsid killpg nice uname wait3"),
    (os, "wait4 mkfifo set_blocking pread sched_getaffinity"),
    (signal, "SIGHUP SIGQUIT SIGKILL SIGUSR1 SIGUSR2 SIGALRM SIGCHLD SIGPIPE SIGTSTP SIGSTOP alarm setitimer pause"),
    (signal, "pthread_sigmask sigwait"),
):
    for name in names.split():
        if hasattr(module, name):
            delattr(module, name)
"""
# What asks for the system is told that it is Windows; what it calls there cannot be called here.
SAYS_SO = """
import types
sys.platform = "win32"
sys.modules["msvcrt"], sys.modules["fcntl"] = types.ModuleType("msvcrt"), None
import ctypes
from unittest.mock import MagicMock
ctypes.windll = MagicMock()
signal.SIGBREAK, ctypes.WINFUNCTYPE = 21, ctypes.CFUNCTYPE
"""
pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="takes away what Windows does not have")


def as_on_windows(code: str, folder: Path, others: str = "import_all()") -> subprocess.CompletedProcess[str]:
    begin = AS_ON_WINDOWS.replace("LOAD_OTHERS", others)
    command = [sys.executable, "-c", f"import sys\nsys.path.insert(0, {str(ROOT)!r})\n{begin}\n{code}"]
    return subprocess.run(command, capture_output=True, text=True, cwd=folder, check=False)


@pytest.mark.slow
def test_every_file_can_be_imported_without_what_only_posix_has(tmp_path: Path) -> None:
    done = as_on_windows(
        f"{SAYS_SO}\nimport_all()\nprint(len([n for n in sys.modules if n.startswith('hpe_rig')]))", tmp_path
    )
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) > 100


@pytest.mark.parametrize(
    "transport", ["serial", *(pytest.param(name, marks=pytest.mark.slow) for name in ("", "vxi11"))]
)
def test_a_measurement_runs_without_what_only_posix_has(transport: str, tmp_path: Path) -> None:
    # Serial lines are TCP sockets there. Files are locked by this system's own call, which Windows has another for.
    code = f"""
from pathlib import Path
from hpe_rig.bench import read_bench
from hpe_rig.measurement import prepare, record_run
bench = Path("bench.toml")
line = 'simulated = true' + ('\\ntransport = "{transport}"' if "{transport}" else "")
bench.write_text(read_bench().text.replace("simulated = true", line), encoding="utf-8")
record_run(prepare("table-1", bench), Path("run.h5"))
from hpe_rig.store import read_run
print(read_run(Path("run.h5")).status)
"""
    # Of other people's packages those of a measurement: one that is missing here would fail to load, and the test.
    others = "import h5py, numpy.random, pydantic, pyvisa_py, scipy.special, serial"
    done = as_on_windows(code, tmp_path, others)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["complete"]


def test_processes_are_spawned_never_forked() -> None:
    started = []
    starting = ("fork", "forkpty", "Process", "Pool", "set_start_method")
    texts = (
        (path, path.read_text(encoding="utf-8")) for package in PACKAGES for path in (ROOT / package).rglob("*.py")
    )
    # A file without any of these words need not be parsed.
    for file, text in (
        (file, text) for file, text in texts if any(name in text for name in (*starting, "get_context"))
    ):
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
                name = node.func.attr
                if name in starting:
                    started.append((file.name, name))
                if name == "get_context":
                    started.append((file.name, ast.literal_eval(node.args[0])))
    assert started == [("executor.py", "spawn")]
