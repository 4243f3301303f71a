"""The rules of the architecture hold, and the machine that checks them notices when they do not."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
HEAVY = ("numpy", "scipy", "matplotlib", "pyvisa", "h5py", "sim_backend", "xarray")


def modules_after(statement: str) -> set[str]:
    """Return the modules that a fresh interpreter has loaded after ``statement``."""
    code = f"{statement}\nimport sys; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    return set(done.stdout.splitlines()[-1].split())


def test_help_imports_no_numerics_and_no_instruments() -> None:
    loaded = modules_after(
        "import sys\nsys.argv = ['hpe-rig', '--help']\nfrom hpe_rig.cli import main\n"
        "try: main()\nexcept SystemExit: pass"
    )
    assert not loaded.intersection(HEAVY)


def test_the_light_core_imports_no_figures_no_signal_processing_and_no_visa() -> None:
    core = "\n".join(f"from hpe_rig.{name} import *" for name in ("scene", "plan", "bench", "acquire", "store"))
    loaded = modules_after(f"{core}\nfrom hpe_rig.cli import main")
    assert not loaded.intersection({"matplotlib", "scipy.signal", "xarray", "starlette", "pyvisa", "sim_backend"})


def test_checking_a_scene_on_metal_loads_neither_twin_nor_visa(tmp_path: Path) -> None:
    bench = (ROOT / "hpe_rig" / "bench" / "shipped" / "simulated.toml").read_text(encoding="utf-8")
    bench = bench.replace("simulated = true", "simulated = false").replace(
        'model = "33250A"\n', 'model = "33250A"\naddress = "GPIB0::10::INSTR"\n'
    )
    path = tmp_path / "metal.toml"
    path.write_text(bench, encoding="utf-8")
    statement = (
        f"from pathlib import Path\nfrom hpe_rig.acquire import prepare\nprepare('bovine-muscle', Path({str(path)!r}))"
    )
    assert not modules_after(statement).intersection({"sim_backend", "pyvisa"})


def lint(folder: Path) -> subprocess.CompletedProcess[str]:
    command = [str(Path(sys.executable).with_name("lint-imports")), "--no-cache"]
    return subprocess.run(command, capture_output=True, text=True, cwd=folder, check=False)


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """A copy of the packages that a test may spoil."""
    for name in ("hpe_rig", "drivers", "sim_backend"):
        shutil.copytree(ROOT / name, tmp_path / name, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    return tmp_path


def test_the_import_contracts_hold(tree: Path) -> None:
    done = lint(tree)
    assert done.returncode == 0, done.stdout


@pytest.mark.parametrize(
    ("file", "statement"),
    [
        ("hpe_rig/plan/shots.py", "import hpe_rig.acquire.run"),
        ("hpe_rig/acquire/sequencer.py", "import drivers.alazar.ats460"),
        ("hpe_rig/processing/motion.py", "import sim_backend.echoes.engine"),
        ("sim_backend/echoes/engine.py", "import hpe_rig.processing"),
        ("sim_backend/world.py", "import drivers.interfaces"),
        ("drivers/agilent/scpi.py", "import sim_backend.wiring"),
    ],
)
def test_the_import_contracts_notice_a_violation(tree: Path, file: str, statement: str) -> None:
    path = tree / file
    text = path.read_text(encoding="utf-8")
    path.write_text(f"{text}\n\ndef _violation() -> None:\n    {statement}\n", encoding="utf-8")
    done = lint(tree)
    assert done.returncode == 1
    assert "BROKEN" in done.stdout
