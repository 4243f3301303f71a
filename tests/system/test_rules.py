"""The rules of the architecture hold, and the machine that checks them notices when they do not."""

import ast
import importlib.util
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import pytest

ROOT = Path(__file__).parents[2]
PACKAGES = ("hpe_rig", "drivers", "sim_backend")
HEAVY = ("numpy", "scipy", "matplotlib", "pyvisa", "h5py", "sim_backend", "xarray")


@cache
def parsed(text: str) -> ast.Module:
    """Return the syntax tree of a file's text, which most copies of the tree share."""
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


def test_checking_a_scene_on_metal_loads_neither_twin_nor_visa(tmp_path: Path) -> None:
    bench = (ROOT / "hpe_rig" / "bench" / "shipped" / "simulated.toml").read_text(encoding="utf-8")
    for simulated, real in (
        ("simulated = true", "simulated = false"),
        ("Simulated bench, wired as Fig. 2 of the paper", "Bench on metal"),
        ("assumed: no hydrophone has seen it", "A. Tester, with a hydrophone"),
        ('model = "33250A"\n', 'model = "33250A"\naddress = "GPIB0::10::INSTR"\n'),
    ):
        bench = bench.replace(simulated, real)
    path = tmp_path / "metal.toml"
    path.write_text(bench, encoding="utf-8")
    statement = (
        "from pathlib import Path\nfrom hpe_rig.measurement import prepare\n"
        f"prepare('bovine-muscle', Path({str(path)!r}))"
    )
    assert not modules_after(statement).intersection({"sim_backend", "pyvisa"})


def lint(folder: Path) -> subprocess.CompletedProcess[str]:
    command = [str(Path(sys.executable).with_name("lint-imports")), "--no-cache"]
    return subprocess.run(command, capture_output=True, text=True, cwd=folder, check=False)


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """A copy of packages and scripts that a test may spoil."""
    for name in (*PACKAGES, "scripts"):
        shutil.copytree(ROOT / name, tmp_path / name, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    return tmp_path


def test_the_import_contracts_hold(tree: Path) -> None:
    done = lint(tree)
    assert done.returncode == 0, done.stdout


def test_the_import_contracts_notice_every_violation(tree: Path) -> None:
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


def faces(root: Path) -> dict[str, Path]:
    """Return the face, ``__init__.pyi``, of every room by the room's dotted name."""
    files = sorted(face for package in PACKAGES for face in (root / package).rglob("__init__.pyi"))
    return {".".join(file.parent.relative_to(root).parts): file for file in files}


def offers(face: Path) -> dict[str, str]:
    """Return each name that a face offers, and the file of the room that it comes from, dotted."""
    statements = [item for item in parsed(face.read_text(encoding="utf-8")).body if isinstance(item, ast.ImportFrom)]
    return {alias.asname or alias.name: item.module or "" for item in statements for alias in item.names}


def defined(body: list[ast.stmt]) -> Iterator[str]:
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
                yield from defined([*item.body, *item.orelse, *handlers])


def face_mistakes(root: Path) -> list[str]:
    """Return what is wrong with the rooms' faces: names that do not exist, names that are also files of the room."""
    mistakes = []
    for room, face in faces(root).items():
        for name, module in offers(face).items():
            file = face.parent.joinpath(*module.split("."))
            source = file / "__init__.py" if file.is_dir() else file.with_suffix(".py")
            stub = source.with_suffix(".pyi")
            known = set(offers(stub)) if stub.exists() else set()
            if source.exists():
                known |= set(defined(parsed(source.read_text(encoding="utf-8")).body))
            if name not in known:
                mistakes.append(f"{room} offers {name}, which {module} does not define")
            shadow = face.parent / name
            if "." in room and (shadow.is_dir() or shadow.with_suffix(".py").exists()):
                mistakes.append(f"{room} offers {name}, which is also a file of it: importing that file hides the name")
    return mistakes


@cache
def imports(text: str) -> list[tuple[int, str, list[str]]]:
    """Return line, module and names (none: the module itself) of every import, wherever in a file's text it stands."""
    return list(_imports(text))


def _imports(text: str) -> Iterator[tuple[int, str, list[str]]]:
    for node in ast.walk(parsed(text)):
        match node:
            case ast.ImportFrom(module=str(module), level=0, names=names):
                yield node.lineno, module, [alias.name for alias in names]
            case ast.Import(names=names):
                yield from ((node.lineno, alias.name, []) for alias in names)
            case ast.Call(func=ast.Name(id="import_module") | ast.Attribute(attr="import_module"), args=[first, *_]):
                name = first.values[0] if isinstance(first, ast.JoinedStr) and first.values else first
                if isinstance(name, ast.Constant):
                    yield node.lineno, str(name.value), []


def room_of(module: str, rooms: dict[str, set[str]]) -> str:
    """Return the innermost room that a dotted module lies in, "" where it lies in none."""
    parts = module.split(".")
    inside = (".".join(parts[:length]) for length in range(len(parts), 1, -1))
    return next((name for name in inside if name in rooms), "")


def door_mistakes(root: Path) -> list[str]:
    """Return every import that enters a room past its face, and every one inside a room that goes by its own face."""
    rooms = {room: set(offers(face)) for room, face in faces(root).items()}
    files = [file for folder in (*PACKAGES, "scripts") for file in sorted((root / folder).rglob("*.py"))]
    mistakes = []
    for file in files:
        place = file.relative_to(root)
        here = room_of(".".join(place.with_suffix("").parts), rooms)
        for line, module, names in imports(file.read_text(encoding="utf-8")):
            room = room_of(module, rooms)
            if not room:
                continue
            where = f"{place.as_posix()}:{line}"
            if room == here:
                # A file may import the file beside it as a whole; what the face offers it takes from where it is.
                if module == room and (not names or rooms[room].intersection(names)):
                    mistakes.append(f"{where} imports from its own room's face, {room}")
            elif module != room:
                mistakes.append(f"{where} imports {module} past the face of {room}")
            else:
                mistakes += [
                    f"{where} imports {name}, which {room} does not offer" for name in names if name not in rooms[room]
                ]
    return mistakes


@pytest.fixture(scope="module")
def mistakes_here() -> list[str]:
    """Return the imports past a face of the tree as it is."""
    return door_mistakes(ROOT)


def test_rooms_are_entered_through_their_faces_alone(mistakes_here: list[str]) -> None:
    assert mistakes_here == []


def test_faces_offer_what_exists_under_names_of_their_own() -> None:
    assert len(faces(ROOT)) >= 15
    assert face_mistakes(ROOT) == []


@pytest.mark.parametrize(
    ("file", "statement", "message"),
    [
        ("hpe_rig/plan/shots.py", "from hpe_rig.scene.scene import Scene", "past the face of hpe_rig.scene"),
        ("hpe_rig/plan/shots.py", "import hpe_rig.bench.opening", "past the face of hpe_rig.bench"),
        ("hpe_rig/plan/shots.py", "from hpe_rig.scene import nothing", "imports nothing, which hpe_rig.scene does"),
        ("hpe_rig/plan/shots.py", "from hpe_rig.plan import make_plan", "imports from its own room's face"),
        ("scripts/measure.py", "from hpe_rig.store.writer import RunWriter", "past the face of hpe_rig.store"),
        ("sim_backend/world.py", "from sim_backend.echoes.engine import echoes", "past the face of sim_backend.echoes"),
        ("hpe_rig/cli/app.py", "import_module(f'hpe_rig.report.{name}')", "past the face of hpe_rig.report"),
    ],
)
def test_an_import_past_a_face_is_noticed(
    tree: Path, mistakes_here: list[str], file: str, statement: str, message: str
) -> None:
    path = tree / file
    text = path.read_text(encoding="utf-8")
    path.write_text(f"{text}\n\ndef _violation() -> None:\n    {statement}\n", encoding="utf-8")
    (mistake,) = set(door_mistakes(tree)) - set(mistakes_here)
    assert mistake.startswith(f"{file}:")
    assert message in mistake


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("from .format import nothing as nothing", "offers nothing, which format does not define"),
        ("from .nowhere import FORMAT as FORMAT", "offers FORMAT, which nowhere does not define"),
        ("from .reader import read_run as writer", "offers writer, which is also a file of it"),
    ],
)
def test_a_face_that_is_wrong_is_noticed(tree: Path, line: str, message: str) -> None:
    face = tree / "hpe_rig" / "store" / "__init__.pyi"
    face.write_text(f"{face.read_text(encoding='utf-8')}{line}\n", encoding="utf-8")
    assert any(message in mistake for mistake in face_mistakes(tree))


def unlisted(root: Path) -> list[str]:
    """Return the files and folders that their room's docstring does not list, and those that it lists in vain."""
    mistakes = []
    for face in sorted(file for package in PACKAGES for file in (root / package).rglob("__init__.py")):
        room, text = face.parent, ast.get_docstring(parsed(face.read_text(encoding="utf-8"))) or ""
        # A file is listed as `name`, as name.py, or with others at the start of a line; a folder may be name/.
        lists = re.findall(r"(\w+)\.py\b|(\w+)/|`(\w+)`|^ +(\w+(?:, \w+)*) {2}", text, flags=re.MULTILINE)
        listed = {name for found in lists for name in ", ".join(found).split(", ")}
        there = {file.stem for file in room.glob("*.py")} | {inner.parent.name for inner in room.glob("*/__init__.py")}
        place = room.relative_to(root).as_posix()
        mistakes += [f"{place} does not list {name}" for name in sorted(there - listed) if not name.startswith("__")]
        anywhere = {file.name for file in room.rglob("*.py")}
        mistakes += [f"{place} lists {name}" for name in re.findall(r"\w+\.py\b", text) if name not in anywhere]
    return mistakes


def test_a_rooms_docstring_lists_its_files() -> None:
    assert unlisted(ROOT) == []


def test_a_file_that_is_not_listed_or_not_there_is_noticed(tree: Path) -> None:
    (tree / "hpe_rig" / "store" / "writer.py").rename(tree / "hpe_rig" / "store" / "scribe.py")
    (tree / "sim_backend" / "wiring.py").rename(tree / "sim_backend" / "cables.py")
    assert unlisted(tree) == [
        "hpe_rig/store does not list scribe",
        "hpe_rig/store lists writer.py",
        "sim_backend does not list cables",
        "sim_backend lists wiring.py",
    ]


LIGHT = ("numpy", "pydantic", "h5py")


def test_importing_the_package_loads_no_numerics_no_validation_and_no_files() -> None:
    assert not modules_after("import hpe_rig").intersection(LIGHT)


@pytest.mark.parametrize("library", LIGHT)
def test_a_heavy_import_of_the_package_is_noticed(tree: Path, library: str) -> None:
    package = tree / "hpe_rig" / "__init__.py"
    package.write_text(f"{package.read_text(encoding='utf-8')}\nimport {library}\n", encoding="utf-8")
    assert library in modules_after("import hpe_rig", tree)


def draw(root: Path, output: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Draw the picture of the packages in ``root`` with the script beside them."""
    script = root / "scripts" / "figures" / "draw_architecture.py"
    spec = importlib.util.spec_from_file_location("draw_architecture", script)
    assert spec is not None
    assert spec.loader is not None
    program = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(program)
    # Of the files that a copy shares with the tree the syntax trees are there.
    monkeypatch.setattr(program, "ast", SimpleNamespace(**vars(ast) | {"parse": parsed}))
    monkeypatch.setattr(sys, "argv", [str(script), str(output)])
    program.main()


def test_the_picture_of_the_architecture_shows_the_rooms_that_there_are(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    draw(ROOT, tmp_path / "now.svg", monkeypatch)
    shown, now = (
        set(re.findall(r"<text[^>]*>([^<]+)</text>", path.read_text(encoding="utf-8")))
        for path in (ROOT / "docs" / "figures" / "architecture.svg", tmp_path / "now.svg")
    )
    assert {"scene", "cli", "measurement", "world", "alazar"} <= shown
    assert shown == now, "try: python scripts/figures/draw_architecture.py"


@pytest.mark.parametrize(
    ("file", "statement", "message"),
    [
        ("hpe_rig/plan/shots.py", "import hpe_rig.report", "hpe_rig.plan imports report, drawn no lower"),
        ("hpe_rig/cellar/__init__.py", "import hpe_rig.scene", "hpe_rig.cellar has no place"),
    ],
)
def test_the_picture_refuses_an_arrow_upwards_and_a_room_without_a_place(
    tree: Path, monkeypatch: pytest.MonkeyPatch, file: str, statement: str, message: str
) -> None:
    path = tree / file
    path.parent.mkdir(exist_ok=True)
    text = path.read_text(encoding="utf-8") if path.exists() else ""
    path.write_text(f"{text}\n{statement}\n", encoding="utf-8")
    # Ends the program with this message and a code that is not 0.
    with pytest.raises(SystemExit, match=re.escape(message)):
        draw(tree, tree / "wrong.svg", monkeypatch)


SCRIPTS = sorted(file for file in (ROOT / "scripts").rglob("*.py") if "__main__" in file.read_text(encoding="utf-8"))


def test_no_script_reads_its_words_without_argparse() -> None:
    by_itself = [file.name for file in SCRIPTS if not _asks_argparse(ast.parse(file.read_text(encoding="utf-8")))]
    assert by_itself == []


def _asks_argparse(script: ast.Module) -> bool:
    return any(isinstance(node, ast.Attribute) and node.attr == "ArgumentParser" for node in ast.walk(script))


@pytest.mark.slow
@pytest.mark.parametrize("script", SCRIPTS, ids=lambda file: file.stem)
def test_every_script_says_how_it_is_used_and_does_nothing_else(script: Path, tmp_path: Path) -> None:
    answer = subprocess.run([sys.executable, script, "--help"], capture_output=True, text=True, cwd=tmp_path)
    assert (answer.returncode, answer.stderr, list(tmp_path.iterdir())) == (0, "", [])
    assert answer.stdout.startswith(f"usage: {script.name}")
