"""The rules of the architecture hold, and each check fails on a copy of the packages that breaks its rule."""

import ast
import re
import runpy
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PACKAGES = ("hpe_rig", "drivers", "sim_backend")
HEAVY = ("numpy", "scipy", "matplotlib", "pyvisa", "h5py", "sim_backend", "xarray")


@cache
def parsed(text: str) -> ast.Module:
    """Return the syntax tree of a file's text; copies of the packages share most of them."""
    return ast.parse(text)


def modules_after(statement: str, root: Path = ROOT) -> set[str]:
    """Return the modules that a fresh interpreter has loaded after ``statement``."""
    code = f"{statement}\nimport sys; print(*sys.modules)"
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, capture_output=True, text=True, check=True, cwd=root)
    return set(done.stdout.splitlines()[-1].split())


def test_help_imports_no_numerics_and_no_instruments() -> None:
    loaded = modules_after(
        "import sys\nsys.argv = ['hpe-rig', '--help']\nfrom hpe_rig.cli import main\n"
        "try: main()\nexcept SystemExit: pass"
    )
    assert not loaded.intersection(HEAVY)


def test_the_light_core_imports_no_figures_no_signal_processing_and_no_visa() -> None:
    core = "\n".join(
        f"from hpe_rig.{name} import *" for name in ("scene", "plan", "bench", "measurement", "runs", "store")
    )
    loaded = modules_after(f"{core}\nfrom hpe_rig.cli import main")
    assert not loaded.intersection({"matplotlib", "scipy.signal", "xarray", "starlette", "pyvisa", "sim_backend"})


def test_checking_a_scene_for_a_real_bench_loads_neither_twin_nor_visa(real_bench: Callable[..., Path]) -> None:
    statement = (
        "from pathlib import Path\nfrom hpe_rig.measurement import prepare\n"
        f"prepare('bovine-muscle', Path({str(real_bench())!r}))"
    )
    assert not modules_after(statement).intersection({"sim_backend", "pyvisa"})


def lint(folder: Path) -> subprocess.CompletedProcess[str]:
    command = [str(Path(sys.executable).with_name("lint-imports")), "--no-cache"]
    return subprocess.run(command, capture_output=True, text=True, cwd=folder, check=False)


@pytest.fixture(scope="module")
def copied_tree(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a copy of packages and scripts."""
    folder = tmp_path_factory.mktemp("tree")
    for name in (*PACKAGES, "scripts"):
        shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "pyproject.toml", folder)
    return folder


@pytest.fixture
def tree(copied_tree: Path) -> Iterator[Path]:
    """Yield a copy of packages and scripts that a test may change; its changes are undone after the test."""
    before = file_states(copied_tree)
    yield copied_tree
    for path in {path for path, _ in before ^ file_states(copied_tree)}:
        original = ROOT / path.relative_to(copied_tree)
        if original.exists():
            shutil.copy(original, path)
        else:
            path.unlink()


def file_states(folder: Path) -> set[tuple[Path, tuple[int, int]]]:
    """Return every file in ``folder`` with its time of change and its size."""
    states = ((path, path.stat()) for path in folder.rglob("*.*") if path.is_file())
    return {(path, (state.st_mtime_ns, state.st_size)) for path, state in states}


def test_the_import_contracts_hold(tree: Path) -> None:
    done = lint(tree)
    assert done.returncode == 0, done.stdout


def test_the_import_contracts_detect_every_violation(tree: Path) -> None:
    violations = {
        "hpe_rig.plan.shots": "hpe_rig.measurement.run",
        "hpe_rig.measurement.sequencer": "drivers.alazar.digitizer",
        "hpe_rig.processing.motion.phase_shift": "sim_backend.echoes.engine",
        "sim_backend.echoes.engine": "hpe_rig.processing",
        "sim_backend.world": "drivers.interfaces",
        "drivers.agilent.scpi": "sim_backend.wiring",
    }
    for importer, imported in violations.items():
        with (tree / f"{importer.replace('.', '/')}.py").open("a", encoding="utf-8") as file:
            file.write(f"\n\ndef _violation() -> None:\n    import {imported}\n")
    done = lint(tree)
    assert done.returncode == 1
    assert "BROKEN" in done.stdout
    for importer, imported in violations.items():
        assert f"{importer} -> {imported} " in done.stdout


def public_interfaces(root: Path) -> dict[str, Path]:
    """Return the public interface, ``__init__.pyi``, of every package by the package's dotted name."""
    stubs = sorted(stub for package in PACKAGES for stub in (root / package).rglob("__init__.pyi"))
    return {".".join(stub.parent.relative_to(root).parts): stub for stub in stubs}


def public_names(stub: Path) -> dict[str, str]:
    """Return each name of a public interface, and the dotted module inside the package that defines it."""
    statements = [item for item in parsed(stub.read_text(encoding="utf-8")).body if isinstance(item, ast.ImportFrom)]
    return {alias.asname or alias.name: item.module or "" for item in statements for alias in item.names}


def defined_names(body: list[ast.stmt]) -> Iterator[str]:
    """Yield the names that a module's statements bind, also under ``if`` and ``try``."""
    for item in body:
        match item:
            case ast.FunctionDef(name=name) | ast.AsyncFunctionDef(name=name) | ast.ClassDef(name=name):
                yield name
            case ast.Assign(targets=targets):
                yield from (node.id for target in targets for node in ast.walk(target) if isinstance(node, ast.Name))
            case ast.AnnAssign(target=ast.Name(id=name)):
                yield name
            case ast.Import(names=names) | ast.ImportFrom(names=names):
                yield from (alias.asname or alias.name for alias in names)
            case ast.If() | ast.Try():
                handlers = [line for handler in getattr(item, "handlers", []) for line in handler.body]
                yield from defined_names([*item.body, *item.orelse, *handlers])


def interface_mistakes(root: Path) -> list[str]:
    """Return public names that do not exist, and public names that are modules of the package too."""
    mistakes = []
    for package, stub in public_interfaces(root).items():
        for name, module in public_names(stub).items():
            path = stub.parent.joinpath(*module.split("."))
            source = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
            inner_stub = source.with_suffix(".pyi")
            defined = set(public_names(inner_stub)) if inner_stub.exists() else set()
            if source.exists():
                defined |= set(defined_names(parsed(source.read_text(encoding="utf-8")).body))
            if name not in defined:
                mistakes.append(f"{package} offers {name}, which {module} does not define")
            shadow = stub.parent / name
            if shadow.is_dir() or shadow.with_suffix(".py").exists():
                mistakes.append(f"{package} offers {name}, which is also a module of it: importing that hides the name")
    return mistakes


@cache
def imports(text: str) -> list[tuple[int, str, list[str]]]:
    """Return line, module and names (none: the module itself) of every import in a file, in functions too."""
    return list(_imports(text))


def _imports(text: str) -> Iterator[tuple[int, str, list[str]]]:
    tree = parsed(text)
    # Imports are statements; only calls are inside expressions.
    for node in ast.walk(tree) if "import_module" in text else statements(tree):
        match node:
            case ast.ImportFrom(module=str(module), level=0, names=names):
                yield node.lineno, module, [alias.name for alias in names]
            case ast.Import(names=names):
                yield from ((node.lineno, alias.name, []) for alias in names)
            case ast.Call(func=ast.Name(id="import_module") | ast.Attribute(attr="import_module"), args=[first, *_]):
                name = first.values[0] if isinstance(first, ast.JoinedStr) and first.values else first
                if isinstance(name, ast.Constant):
                    yield node.lineno, str(name.value), []


def statements(node: ast.AST) -> Iterator[ast.AST]:
    """Yield the statements in ``node``, at any depth."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.stmt | ast.ExceptHandler | ast.match_case):
            yield child
            yield from statements(child)


def package_of(module: str, packages: dict[str, set[str]]) -> str:
    """Return the innermost package with a public interface that holds a dotted module, "" if there is none."""
    parts = module.split(".")
    outward = (".".join(parts[:length]) for length in range(len(parts), 1, -1))
    return next((name for name in outward if name in packages), "")


def private_imports(root: Path) -> list[str]:
    """Return every import that bypasses the public interface of a package, or uses it from inside the package."""
    packages = {package: set(public_names(stub)) for package, stub in public_interfaces(root).items()}
    files = [file for folder in (*PACKAGES, "scripts") for file in sorted((root / folder).rglob("*.py"))]
    mistakes = []
    for file in files:
        path = file.relative_to(root)
        importer = package_of(".".join(path.with_suffix("").parts), packages)
        for line, module, names in imports(file.read_text(encoding="utf-8")):
            package = package_of(module, packages)
            if not package:
                continue
            location = f"{path.as_posix()}:{line}"
            if package == importer:
                # A module may import a neighbour as a whole; a public name is imported from the module that defines it.
                if module == package and (not names or packages[package].intersection(names)):
                    mistakes.append(f"{location} imports from the public interface of its own package, {package}")
            elif module != package:
                mistakes.append(f"{location} imports {module}, which bypasses the public interface of {package}")
            else:
                private = [name for name in names if name not in packages[package]]
                mistakes += [f"{location} imports {name}, which {package} does not offer" for name in private]
    return mistakes


@pytest.fixture(scope="module")
def mistakes_in_tree() -> list[str]:
    """Return the private imports of the tree under test."""
    return private_imports(ROOT)


def test_packages_import_only_public_names_of_each_other(mistakes_in_tree: list[str]) -> None:
    assert mistakes_in_tree == []


def test_every_public_name_is_defined_and_no_module_hides_it() -> None:
    assert len(public_interfaces(ROOT)) >= 15
    assert interface_mistakes(ROOT) == []


@pytest.mark.parametrize(
    ("file", "statement", "message"),
    [
        (
            "hpe_rig/plan/shots.py",
            "from hpe_rig.scene.loading import Scene",
            "bypasses the public interface of hpe_rig.s",
        ),
        ("hpe_rig/plan/shots.py", "from hpe_rig.scene import nothing", "imports nothing, which hpe_rig.scene does"),
        ("hpe_rig/plan/shots.py", "from hpe_rig.plan import make_plan", "imports from the public interface of its own"),
        (
            "sim_backend/world.py",
            "from sim_backend.echoes.engine import x",
            "the public interface of sim_backend.echoes",
        ),
        ("hpe_rig/cli/app.py", "import_module(f'hpe_rig.report.{name}')", "the public interface of hpe_rig.report"),
    ],
)
def test_a_private_import_is_detected(
    tree: Path, mistakes_in_tree: list[str], file: str, statement: str, message: str
) -> None:
    path = tree / file
    text = path.read_text(encoding="utf-8")
    path.write_text(f"{text}\n\ndef _violation() -> None:\n    {statement}\n", encoding="utf-8")
    (mistake,) = set(private_imports(tree)) - set(mistakes_in_tree)
    assert mistake.startswith(f"{file}:")
    assert message in mistake


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("from .format import nothing as nothing", "offers nothing, which format does not define"),
        ("from .nowhere import FORMAT as FORMAT", "offers FORMAT, which nowhere does not define"),
        ("from .reader import read_run as writer", "offers writer, which is also a module of it"),
    ],
)
def test_a_wrong_public_interface_is_detected(tree: Path, line: str, message: str) -> None:
    stub = tree / "hpe_rig" / "store" / "__init__.pyi"
    stub.write_text(f"{stub.read_text(encoding='utf-8')}{line}\n", encoding="utf-8")
    assert any(message in mistake for mistake in interface_mistakes(tree))


def module_imports(root: Path) -> dict[str, set[str]]:
    """Return the modules that each module of the packages imports, in functions and under TYPE_CHECKING too.

    A name imported from a package counts as an import of the module that defines it.
    """
    paths = {path.relative_to(root): path for package in PACKAGES for path in sorted((root / package).rglob("*.py"))}
    modules = {".".join(path.with_suffix("").parts).removesuffix(".__init__"): file for path, file in paths.items()}
    stubs = {package: public_names(stub) for package, stub in public_interfaces(root).items()}

    def definition(module: str, name: str) -> str:
        if f"{module}.{name}" in modules:
            return f"{module}.{name}"
        inner = stubs.get(module, {}).get(name)
        return definition(f"{module}.{inner}", name) if inner else module

    graph: dict[str, set[str]] = {}
    for module, file in modules.items():
        imported = imports(file.read_text(encoding="utf-8"))
        targets = {definition(source, name) for _, source, names in imported for name in names or [""]}
        graph[module] = (targets & set(modules)) - {module}
    return graph


def import_circles(root: Path) -> list[list[str]]:
    """Return the modules on import circles, or between two of them: they remain when all others are removed."""
    graph = module_imports(root)
    while removable := [module for module, imported in graph.items() if not imported & set(graph)]:
        for module in removable:
            del graph[module]
    while removable := [module for module in graph if not any(module in imported for imported in graph.values())]:
        for module in removable:
            del graph[module]
    return [sorted(graph)] if graph else []


def test_no_module_imports_itself_through_others() -> None:
    assert import_circles(ROOT) == []


@pytest.mark.parametrize(
    "statement",
    [
        pytest.param("from hpe_rig.plan import select", marks=pytest.mark.slow),
        pytest.param("def late() -> None:\n    from hpe_rig.plan import select", marks=pytest.mark.slow),
        "if TYPE_CHECKING:\n    from hpe_rig.plan import select",
    ],
)
def test_an_import_circle_is_detected(tree: Path, statement: str) -> None:
    path = tree / "hpe_rig" / "plan" / "shots.py"
    path.write_text(f"{path.read_text(encoding='utf-8')}\n\n{statement}\n", encoding="utf-8")
    (circle,) = import_circles(tree)
    assert {"hpe_rig.plan.selection", "hpe_rig.plan.shots"} <= set(circle)


def unlisted_modules(root: Path) -> list[str]:
    """Return modules missing from the docstring of their package, and listed modules that do not exist."""
    mistakes = []
    # A row of the table of estimators lists the module of its function.
    table = (root / "hpe_rig" / "scene" / "estimator_table.py").read_text(encoding="utf-8")
    estimators = set(re.findall(r"_MOTION\}\.(\w+):", table))
    for init in sorted(file for package in PACKAGES for file in (root / package).rglob("__init__.py")):
        package, text = init.parent, ast.get_docstring(parsed(init.read_text(encoding="utf-8"))) or ""
        # A module is listed as `name`, as name.py, or at the start of a line; a package may be name/.
        groups = re.findall(r"(\w+)\.py\b|(\w+)/|`(\w+)`|^ *(\w+(?:, \w+)*) {2}", text, flags=re.MULTILINE)
        listed = {name for group in groups for name in ", ".join(group).split(", ")} | estimators
        modules = {file.stem for file in package.glob("*.py")}
        modules |= {inner.parent.name for inner in package.glob("*/__init__.py")}
        name = package.relative_to(root).as_posix()
        unlisted = sorted(module for module in modules - listed if not module.startswith("__"))
        mistakes += [f"{name} does not list {module}" for module in unlisted]
        existing = {file.name for file in package.rglob("*.py")}
        mistakes += [f"{name} lists {file}" for file in re.findall(r"\w+\.py\b", text) if file not in existing]
    return mistakes


def test_the_docstring_of_a_package_lists_its_modules() -> None:
    assert unlisted_modules(ROOT) == []


def test_an_unlisted_or_missing_module_is_detected(tree: Path) -> None:
    (tree / "hpe_rig" / "store" / "writer.py").rename(tree / "hpe_rig" / "store" / "scribe.py")
    (tree / "sim_backend" / "wiring.py").rename(tree / "sim_backend" / "cables.py")
    assert sorted(set(unlisted_modules(tree)) - set(unlisted_modules(ROOT))) == [
        "hpe_rig/store does not list scribe",
        "hpe_rig/store lists writer.py",
        "sim_backend does not list cables",
        "sim_backend lists wiring.py",
    ]


LIGHT = ("numpy", "pydantic", "h5py")


def test_importing_the_package_loads_no_numpy_pydantic_or_h5py() -> None:
    assert not modules_after("import hpe_rig").intersection(LIGHT)


@pytest.mark.parametrize(
    "library", [name if name == "numpy" else pytest.param(name, marks=pytest.mark.slow) for name in LIGHT]
)
def test_a_heavy_import_of_the_package_is_detected(tree: Path, library: str) -> None:
    package = tree / "hpe_rig" / "__init__.py"
    package.write_text(f"{package.read_text(encoding='utf-8')}\nimport {library}\n", encoding="utf-8")
    assert library in modules_after("import hpe_rig", tree)


def draw_architecture(root: Path, output: Path) -> None:
    """Draw the picture of the packages in ``root`` with the script of that folder; raise ``SystemExit`` if refused."""
    script = root / "scripts" / "figures" / "draw_architecture.py"
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(sys, "argv", [str(script), str(output)])
        runpy.run_path(str(script), run_name="__main__")


@pytest.mark.slow
def test_the_picture_of_the_architecture_shows_the_packages(tmp_path: Path) -> None:
    draw_architecture(ROOT, tmp_path / "now.svg")
    committed, drawn = (
        set(re.findall(r"<text[^>]*>([^<]+)</text>", path.read_text(encoding="utf-8")))
        for path in (ROOT / "docs" / "figures" / "architecture.svg", tmp_path / "now.svg")
    )
    assert {"scene", "cli", "measurement", "world", "alazar"} <= committed
    assert committed == drawn, "try: python scripts/figures/draw_architecture.py"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("file", "statement", "message"),
    [
        ("hpe_rig/plan/shots.py", "import hpe_rig.report", "hpe_rig.plan imports report, drawn no lower"),
        pytest.param(
            "hpe_rig/cellar/__init__.py",
            "import hpe_rig.scene",
            "hpe_rig.cellar has no box",
            marks=pytest.mark.slow,
        ),
    ],
)
def test_the_picture_refuses_an_upward_import_and_an_unknown_package(
    tree: Path, file: str, statement: str, message: str
) -> None:
    path = tree / file
    path.parent.mkdir(exist_ok=True)
    text = path.read_text(encoding="utf-8") if path.exists() else ""
    path.write_text(f"{text}\n{statement}\n", encoding="utf-8")
    with pytest.raises(SystemExit, match=message):
        draw_architecture(tree, tree / "wrong.svg")


PROGRAMS = sorted(file for file in (ROOT / "scripts").rglob("*.py") if "__main__" in file.read_text(encoding="utf-8"))


def test_every_script_reads_its_options_with_argparse() -> None:
    assert [file.name for file in PROGRAMS if "argparse.ArgumentParser(" not in file.read_text(encoding="utf-8")] == []


def test_no_message_prints_a_python_list() -> None:
    """Numbers are words of a sentence: 100, 200 Hz, not [100.0, 200.0] Hz. A list in TOML, as in scene.py, is one."""
    found = []
    for path in sorted((ROOT / "hpe_rig").rglob("*.py")):
        for node in ast.walk(parsed(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.FormattedValue):
                value = node.value
                name = getattr(value.func, "attr", getattr(value.func, "id", "")) if isinstance(value, ast.Call) else ""
                is_list = isinstance(value, ast.List | ast.ListComp | ast.Dict | ast.Set)
                if is_list or name in {"tolist", "list", "sorted", "set", "dict"}:
                    found.append((path.name, ast.unparse(value)))
    assert found == [("scene.py", "list(values)")]


@pytest.mark.slow
@pytest.mark.parametrize("script", PROGRAMS, ids=lambda file: file.stem)
def test_help_of_a_script_prints_its_usage_and_writes_nothing(script: Path, tmp_path: Path) -> None:
    answer = subprocess.run([sys.executable, script, "--help"], capture_output=True, text=True, cwd=tmp_path)
    assert (answer.returncode, answer.stderr, list(tmp_path.iterdir())) == (0, "", [])
    assert answer.stdout.startswith(f"usage: {script.name}")
