"""Each command loads only the packages that its scene needs."""

import subprocess
import sys
from pathlib import Path

import pytest

import hpe_rig

# Packages import their modules on first use, after the imports that `-X importtime` lists.
NOTING_MODULES = """
import atexit, pathlib, runpy, sys
atexit.register(lambda: pathlib.Path("modules").write_text(" ".join(sys.modules), encoding="utf-8"))
runpy.run_module("hpe_rig", run_name="__main__", alter_sys=True)
"""
CORE = {"drivers", "h5py", "hpe_rig", "lazy_loader", "numpy", "pydantic", "typer"}
DEPENDENCIES = {
    *("annotated_doc", "annotated_types", "cython_runtime", "pydantic_core", "shellingham", "typing_extensions"),
    *("typing_inspection", "charset_normalizer", "colorama"),
}
"""Packages that pydantic, typer and NumPy import."""
DRAWING = {"jinja2", "markupsafe", "matplotlib"}
NEVER = {"h5netcdf", "hdf5plugin", "numba", "pandas", "pyvisa", "pyvisa_py", "serial", "starlette", "uvicorn"}
NEVER |= {"websockets", "xarray", "dask", "distributed", "tomlkit"}


def loaded_by(folder: Path, *arguments: str) -> set[str]:
    """Return the names of the modules loaded at the end of a command of ``hpe-rig``."""
    command = [sys.executable, "-c", NOTING_MODULES, *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=folder)
    assert done.returncode == 0, done.stderr
    return set((folder / "modules").read_text(encoding="utf-8").split())


def packages(loaded: set[str]) -> set[str]:
    """Return the top packages of ``loaded`` without the standard library and indirect dependencies."""
    top = {name.partition(".")[0] for name in loaded if not name.startswith("_")}
    return top - sys.stdlib_module_names - DEPENDENCIES


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a run of ``table-1`` and the list of modules of the process that measured it."""
    folder = tmp_path_factory.mktemp("loaded")
    measured = loaded_by(folder, "run", "table-1", "--output", "mine.h5", "--json")
    (folder / "run").write_text(" ".join(measured), encoding="utf-8")
    return folder


def test_a_run_of_a_prescribed_motion_loads_no_physics_of_the_push(folder: Path) -> None:
    loaded = set((folder / "run").read_text(encoding="utf-8").split())
    assert packages(loaded) == CORE | {"scipy", "sim_backend"}
    # No force, no shear field, no specimen.
    assert {name for name in loaded if name.startswith("sim_backend.motion.")} == {"sim_backend.motion.prescribed"}
    assert not loaded & {"sim_backend.receiver.chain", "hpe_rig.measurement.resumption", "hpe_rig.measurement.log"}
    assert not [name for name in loaded if name.startswith(("hpe_rig.report.", "hpe_rig.live.", "hpe_rig.moduli."))]


@pytest.mark.slow
def test_a_check_opens_no_twin_and_loads_neither_scipy_nor_hdf5(tmp_path: Path) -> None:
    loaded = loaded_by(tmp_path, "check", "table-1")
    # A check reads and writes no run file.
    assert packages(loaded) == CORE - {"h5py"} | {"sim_backend"}
    assert not [name for name in loaded if name.startswith("hpe_rig.store.")]
    assert "numpy.ma" not in loaded, "a quantile or a median of NumPy loads it"
    assert not loaded & {"hpe_rig.measurement.run", "hpe_rig.runs.run", "hpe_rig.bench.opening"}
    # Only the settings of the twin are validated: no echoes, no instruments.
    subpackages = {".".join(name.split(".")[:2]) for name in loaded if name.startswith("sim_backend.")}
    assert subpackages <= {f"sim_backend.{name}" for name in ("arrays", "motion", "settings", "wiring")}


@pytest.mark.slow
def test_processing_loads_no_simulated_physics(folder: Path) -> None:
    loaded = loaded_by(folder, "process", "mine.h5", "--json")
    assert packages(loaded) == CORE | {"scipy", "sim_backend"}
    assert not [name for name in loaded if name.startswith(("sim_backend.echoes", "sim_backend.digitizer"))]
    # Processing opens no instrument, acquires no shot and sweeps nothing.
    acquiring = {f"hpe_rig.measurement.{name}" for name in ("recording", "run", "sequencer")} | {
        "hpe_rig.runs.api",
        "hpe_rig.runs.reprocessing",
    }
    assert not loaded & (acquiring | {"hpe_rig.bench.opening", "hpe_rig.prediction.forecast"})


@pytest.mark.slow
def test_a_list_of_runs_loads_no_twin(folder: Path) -> None:
    assert packages(loaded_by(folder, "list")) == CORE | {"rich"}


@pytest.mark.slow
@pytest.mark.parametrize(
    "command",
    [
        ("report", "mine.h5"),
        ("run", "bovine-muscle", "--json"),
        ("check", "bovine-muscle"),
        ("check", "gelatin-moduli"),
        ("compare", "mine.h5", "mine.h5", "--json"),
    ],
)
def test_no_command_loads_an_extra_without_its_option(folder: Path, command: tuple[str, ...]) -> None:
    modules = loaded_by(folder, *command)
    loaded = packages(modules)
    # The physics of the transducer stays unloaded except the Gaussian intensity of the push.
    physics = {name for name in modules if name.startswith("sim_backend.transducer.")}
    assert physics <= {"sim_backend.transducer.intensity"}
    assert loaded >= CORE - {"h5py"} | {"scipy"}
    assert ("h5py" in loaded) == (command[0] != "check")
    # A forecast of moduli fits nothing.
    assert command[0] != "check" or "scipy.optimize" not in modules
    assert not loaded & NEVER
    assert bool(loaded & DRAWING) == (command[0] == "report")


STARTUP = Path(hpe_rig.__file__).with_name("startup.py")


def run_after_startup(program: str) -> subprocess.CompletedProcess[str]:
    """Run ``startup.py`` and then ``program`` in a fresh process."""
    code = f"import sys\nloaded = set(sys.modules)\nexec(open({str(STARTUP)!r}, encoding='utf-8').read())\n{program}"
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)


def test_startup_imports_no_module_that_python_has_not_loaded() -> None:
    assert run_after_startup("print(set(sys.modules) - loaded)").stdout.strip() == "set()"


def test_an_interrupt_during_the_import_of_signal_ends_with_one_line() -> None:
    done = run_after_startup(
        "class Strike:\n"
        "    def find_spec(self, *_):\n"
        "        raise KeyboardInterrupt\n"
        "sys.modules.pop('signal', None)\n"
        "sys.meta_path.insert(0, Strike())\n"
        "exit_on_interrupt()\n"
        "print('went on')"
    )
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "hpe-rig: interrupted\n")
