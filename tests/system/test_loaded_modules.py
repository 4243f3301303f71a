"""Each command loads what its scene needs: the modules of a fresh process at its end."""

import subprocess
import sys
from pathlib import Path

import pytest

import hpe_rig

# What a room offers is imported on first use, which `-X importtime` does not see.
NOTING_MODULES = """
import atexit, pathlib, runpy, sys
atexit.register(lambda: pathlib.Path("modules").write_text(" ".join(sys.modules), encoding="utf-8"))
runpy.run_module("hpe_rig", run_name="__main__", alter_sys=True)
"""
CORE = {"drivers", "h5py", "hpe_rig", "lazy_loader", "numpy", "pydantic", "typer"}
BROUGHT_ALONG = {
    *("annotated_doc", "annotated_types", "cython_runtime", "pydantic_core", "shellingham", "typing_extensions"),
    *("typing_inspection", "charset_normalizer", "colorama"),
}
"""By pydantic, typer and NumPy."""
DRAWING = {"jinja2", "markupsafe", "matplotlib"}
NEVER = {"h5netcdf", "hdf5plugin", "numba", "pandas", "pyvisa", "pyvisa_py", "serial", "starlette", "uvicorn"}
NEVER |= {"websockets", "xarray", "dask", "distributed", "tomlkit"}


def loaded_by(folder: Path, *arguments: str) -> set[str]:
    """Return the modules that ``hpe-rig`` has loaded at the end of a command."""
    command = [sys.executable, "-c", NOTING_MODULES, *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=folder)
    assert done.returncode == 0, done.stderr
    return set((folder / "modules").read_text(encoding="utf-8").split())


UNASKED = {"numpy.f2py.f2py2e", "numpy.testing._private", "unittest", "numpy.ma"}
"""What SciPy would have NumPy load, and nothing uses; NumPy's masked arrays, which some of its functions load."""
UNDOCUMENTED = {"pydoc", "scipy._lib._docscrape", "scipy.special._basic"}
"""What rewrites the documentation of SciPy's functions."""


def packages(loaded: set[str]) -> set[str]:
    """Return which packages these modules are of, but for Python's own and those that others bring along."""
    top = {name.partition(".")[0] for name in loaded if not name.startswith("_")}
    return top - sys.stdlib_module_names - BROUGHT_ALONG


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a run of ``table-1``, and the modules of the process that measured it."""
    folder = tmp_path_factory.mktemp("loaded")
    measured = loaded_by(folder, "run", "table-1", "--output", "mine.h5", "--json")
    (folder / "run").write_text(" ".join(measured), encoding="utf-8")
    return folder


def test_a_run_of_a_prescribed_motion_loads_no_scipy_and_nothing_that_pushes(folder: Path) -> None:
    loaded = set((folder / "run").read_text(encoding="utf-8").split())
    assert packages(loaded) == CORE | {"sim_backend"}
    # Of the motion room its own file alone: no force, no field, no specimen.
    assert {name for name in loaded if name.startswith("sim_backend.motion.")} == {"sim_backend.motion.prescribed"}
    assert not loaded & {"sim_backend.receiver.chain", "hpe_rig.measurement.resumption", "hpe_rig.measurement.log"}
    assert not [name for name in loaded if name.startswith(("hpe_rig.report.", "hpe_rig.live.", "hpe_rig.moduli."))]
    assert not loaded & UNASKED


def test_a_check_opens_no_twin_and_loads_neither_scipy_nor_hdf5(tmp_path: Path) -> None:
    loaded = loaded_by(tmp_path, "check", "table-1")
    # No file of a run is read or written.
    assert packages(loaded) == CORE - {"h5py"} | {"sim_backend"}
    assert not [name for name in loaded if name.startswith("hpe_rig.store.")]
    assert "numpy.ma" not in loaded, "a quantile or a median of NumPy loads it"
    assert not loaded & {"hpe_rig.measurement.run", "hpe_rig.runs.run", "hpe_rig.bench.opening"}
    # What the twin's settings may say, and what they say of the motion: no echoes, no instruments.
    rooms = {".".join(name.split(".")[:2]) for name in loaded if name.startswith("sim_backend.")}
    assert rooms == {"sim_backend.motion", "sim_backend.settings", "sim_backend.wiring"}


def test_processing_loads_neither_scipy_nor_the_physics(folder: Path) -> None:
    loaded = loaded_by(folder, "process", "mine.h5", "--json")
    assert packages(loaded) == CORE | {"sim_backend"}
    assert not [name for name in loaded if name.startswith(("sim_backend.echoes", "sim_backend.digitizer"))]
    # No instrument is opened, no shot acquired, no point of a sweep made.
    acquiring = {f"hpe_rig.measurement.{name}" for name in ("recording", "run", "sequencer")} | {
        "hpe_rig.runs.api",
        "hpe_rig.runs.reprocessing",
    }
    assert not loaded & (acquiring | {"hpe_rig.bench.opening", "hpe_rig.prediction.forecast"})


def test_a_list_of_runs_loads_no_twin(folder: Path) -> None:
    assert packages(loaded_by(folder, "list")) == CORE | {"rich"}


@pytest.mark.slow
@pytest.mark.parametrize(
    "command", [("report", "mine.h5"), ("run", "bovine-muscle", "--json"), ("check", "bovine-muscle")]
)
def test_nothing_loads_extras_that_nobody_asked_for(folder: Path, command: tuple[str, ...]) -> None:
    modules = loaded_by(folder, *command)
    loaded = packages(modules)
    # of the transducer's physics what a Gaussian push is a sum of, and no more
    physics = {name for name in modules if name.startswith("sim_backend.transducer.")}
    assert physics <= {"sim_backend.transducer.intensity"}
    assert loaded >= CORE - {"h5py"} | {"scipy"}
    assert ("h5py" in loaded) == (command[0] != "check")
    assert not loaded & NEVER
    assert not modules & UNASKED or command[0] == "report", "Matplotlib has them loaded"
    assert not modules & UNDOCUMENTED
    assert "mpl_toolkits.mplot3d.axes3d" not in modules
    assert bool(loaded & DRAWING) == (command[0] == "report")


STARTUP = Path(hpe_rig.__file__).with_name("startup.py")


def begun_with(program: str) -> subprocess.CompletedProcess[str]:
    """Return what a fresh process says that runs ``startup.py`` alone, and then ``program``."""
    code = f"import sys\nloaded = set(sys.modules)\nexec(open({str(STARTUP)!r}, encoding='utf-8').read())\n{program}"
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)


def test_what_ends_the_program_plainly_imports_nothing_that_python_has_not() -> None:
    assert begun_with("print(set(sys.modules) - loaded)").stdout.strip() == "set()"


def test_an_interrupt_while_the_guard_itself_loads_is_said_plainly() -> None:
    done = begun_with(
        "class Strike:\n"
        "    def find_spec(self, *_):\n"
        "        raise KeyboardInterrupt\n"
        "sys.modules.pop('signal', None)\n"
        "sys.meta_path.insert(0, Strike())\n"
        "end_plainly()\n"
        "print('went on')"
    )
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "hpe-rig: interrupted\n")
