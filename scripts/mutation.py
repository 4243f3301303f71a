"""Mutation run: small faults put into the code one at a time, and whether the tests that belong to it notice.

Works in a copy of the tree, never in the tree itself. Messages (f-strings), annotations and decorators stay as they
are. A mutant whose tests fail or run out of time is killed; one whose tests pass has survived. Where the tests fail on
the unchanged code as well, nothing is known.
"""

from __future__ import annotations

import argparse
import ast
import contextlib
import io
import multiprocessing
import os
import random
import shutil
import signal
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

ROOMS = {
    "plan": (["hpe_rig/plan"], ["tests/hpe_rig/plan"]),
    "bench": (
        [f"hpe_rig/bench/{name}.py" for name in ("opening", "instruments", "interrupts", "lock")],
        ["tests/hpe_rig/bench", "tests/system/test_safety.py"],
    ),
    "sequencer": (
        ["hpe_rig/acquire/sequencer.py"],
        ["tests/system/test_safety.py", "tests/system/test_watched_settings.py"],
    ),
    "store": (["hpe_rig/store"], ["tests/hpe_rig/store"]),
    "processing": (["hpe_rig/processing"], ["tests/hpe_rig/processing"]),
    "wiring": (
        ["sim_backend/wiring.py", "sim_backend/world.py"],
        ["tests/sim_backend/test_wiring.py", "tests/sim_backend/test_world.py"],
    ),
    "timing": (
        ["sim_backend/generator/emission.py", "sim_backend/generator/timing.py", "sim_backend/digitizer/board.py"],
        ["tests/sim_backend/test_wiring.py", "tests/sim_backend/generator", "tests/sim_backend/digitizer"],
    ),
    "generator driver": (["drivers/agilent"], ["tests/drivers/agilent"]),
    "board driver": (["drivers/alazar"], ["tests/drivers/alazar"]),
}
SWAPPED: dict[type[ast.AST], type[ast.AST]] = {
    one: other
    for pair in [
        (ast.Lt, ast.LtE), (ast.Gt, ast.GtE), (ast.Eq, ast.NotEq), (ast.Is, ast.IsNot), (ast.In, ast.NotIn),
        (ast.Add, ast.Sub), (ast.Mult, ast.Div), (ast.And, ast.Or),
    ]
    for one, other in (pair, pair[::-1])
}  # fmt: skip
PRELOADED = [
    "numpy",
    "scipy.signal",
    "scipy.optimize",
    "h5py",
    "pydantic",
    "pytest",
    "hypothesis",
    "hypothesis.extra.numpy",
]
UNSEEN_KEYWORDS = {"strict", "frozen", "slots", "dtype", "encoding"}


def mutations(source: str) -> list[tuple[ast.expr | ast.stmt, str]]:
    """Return every node that can be mutated, and the text that takes its place."""
    return [
        (node, ast.unparse(ast.fix_missing_locations(new))) for node in _nodes(ast.parse(source)) for new in _of(node)
    ]


def _nodes(node: ast.AST) -> Iterator[ast.AST]:
    """Yield ``node`` and what is below it, less messages, annotations, decorators, docstrings."""
    yield node
    for name, value in ast.iter_fields(node):
        if name in ("annotation", "returns", "decorator_list", "type_params", "op", "ops", "ctx"):
            continue
        for child in value if isinstance(value, list) else [value]:
            skipped = isinstance(child, ast.JoinedStr) or (
                isinstance(child, ast.keyword) and child.arg in UNSEEN_KEYWORDS
            )
            if isinstance(child, ast.AST) and not skipped:
                yield from _nodes(child)


def _of(node: ast.AST) -> Iterator[ast.AST]:
    """Yield the mutants of one node."""
    match node:
        case ast.Compare(left, [op], right) if type(op) in SWAPPED:
            yield ast.Compare(left, [SWAPPED[type(op)]()], right)
        case ast.BinOp(left, op, right) if type(op) in SWAPPED and not (_is_text(left) or _is_text(right)):
            yield ast.BinOp(left, SWAPPED[type(op)](), right)
        case ast.BoolOp(op, values):
            yield ast.BoolOp(SWAPPED[type(op)](), values)
        case ast.UnaryOp(ast.Not() | ast.USub(), operand):
            yield operand
        case ast.Constant(bool() as value):
            yield ast.Constant(not value)
        case ast.Constant(int() as value):
            yield ast.Constant(value + 1)
            yield ast.Constant(value - 1)
        case ast.Constant(float() as value):
            yield ast.Constant(value * 1.1 or 1.0)
        case ast.Return(ast.expr() as value) if not (isinstance(value, ast.Constant) and value.value is None):
            yield ast.Return(ast.Constant(None))


def _is_text(node: ast.AST) -> bool:
    return any(
        isinstance(part, ast.JoinedStr) or isinstance(getattr(part, "value", None), str) for part in ast.walk(node)
    )


def mutated(source: str, node: ast.expr | ast.stmt, new: str) -> str:
    """Return ``source`` with the text of ``node`` replaced."""
    lines = source.encode().splitlines(keepends=True)
    start = sum(map(len, lines[: node.lineno - 1])) + node.col_offset
    end = sum(map(len, lines[: (node.end_lineno or 0) - 1])) + (node.end_col_offset or 0)
    text = new if isinstance(node, ast.stmt) else f"({new})"
    return (source.encode()[:start] + text.encode() + source.encode()[end:]).decode()


def tests_of(tree: Path, room: str, path: Path) -> list[str]:
    """Return the room's test files that import the file at ``path`` themselves; all of the room's where none does."""
    module = ".".join(path.relative_to(tree).with_suffix("").parts)
    places = [tree / place for place in ROOMS[room][1]]
    every = [file for place in places for file in (sorted(place.rglob("test_*.py")) if place.is_dir() else [place])]
    fitting = [file for file in every if f"from {module} import" in file.read_text("utf-8")]
    return [str(file.relative_to(tree)) for file in fitting or every]


def run_tests(tree: Path, tests: list[str]) -> None:
    """Run ``tests`` in ``tree`` and exit with pytest's code; for a process of its own."""
    import pytest

    # A program in the background may have been told to ignore Ctrl-C, and hands that down to the tests.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    os.chdir(tree)
    sys.path.insert(0, str(tree))
    sys.dont_write_bytecode = True
    quiet = ["-x", "-q", "-p", "no:cacheprovider", "-W", "ignore::pytest.PytestAssertRewriteWarning"]
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        code = pytest.main([*quiet, *tests])
    os._exit(int(code))


def verdict(tree: Path, tests: list[str], limit_s: float) -> str:
    """Return "killed", "timed out" or "survived"."""
    context = multiprocessing.get_context("forkserver" if os.name == "posix" else "spawn")
    process = context.Process(target=run_tests, args=(tree, tests))
    process.start()
    process.join(limit_s)
    if process.is_alive():
        process.kill()
        process.join()
        return "timed out"
    return "killed" if process.exitcode else "survived"


def main() -> None:
    """Mutate, test, print one line a mutant and a table at the end or at Ctrl-C."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("copy", type=Path, help="folder for the copy of the tree; replaced")
    parser.add_argument("--count", type=int, default=300)
    parser.add_argument("--skip", type=int, default=0, help="mutants of the same draw that are done already")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--limit-s", type=float, default=60.0, help="time-out of one mutant's tests")
    parser.add_argument("--rooms", nargs="*", choices=list(ROOMS), default=list(ROOMS))
    options = parser.parse_args()
    root, copy = Path(__file__).resolve().parents[1], options.copy.resolve()
    shutil.rmtree(copy, ignore_errors=True)
    shutil.copytree(root, copy, ignore=shutil.ignore_patterns(".git", "__pycache__", ".*_cache"))
    subprocess.run(["git", "init", "-q"], cwd=copy, check=True)
    os.environ.update(PYTHONPATH=str(copy), PYTHONDONTWRITEBYTECODE="1")
    if os.name == "posix":
        multiprocessing.set_forkserver_preload(PRELOADED)
    found: Counter[tuple[str, str]] = Counter()
    sound: set[tuple[str, ...]] = set()
    with contextlib.suppress(KeyboardInterrupt):
        for room, path, node, new in list(chosen(copy, options.rooms, options.count, options.seed))[options.skip :]:
            source = path.read_text("utf-8")
            path.write_text(mutated(source, node, new), "utf-8")
            tests = tests_of(copy, room, path)
            result = verdict(copy, tests, options.limit_s)
            path.write_text(source, "utf-8")
            # Whoever kills a mutant must let the code as it is live, or has seen nothing.
            seen = result == "survived" or tuple(tests) in sound
            if not seen and verdict(copy, tests, 10 * options.limit_s) != "survived":
                result = "unknown"
            else:
                sound.add(tuple(tests))
            found[room, result] += 1
            old = " ".join((ast.get_source_segment(source, node) or "").split())
            print(f"{result:9} {path.relative_to(copy)}:{node.lineno}: {old}  ->  {new}", flush=True)
    results = ("killed", "timed out", "survived", "unknown")
    print(f"\n{'room':20}" + "".join(f"{result:>10}" for result in results))
    for room in options.rooms:
        print(f"{room:20}" + "".join(f"{found[room, result]:10}" for result in results))


def chosen(tree: Path, rooms: list[str], count: int, seed: int) -> Iterator[tuple[str, Path, ast.expr | ast.stmt, str]]:
    """Yield ``count`` mutants drawn at random, room by room in turn, so that none is left out when time is short."""
    generator, queues = random.Random(seed), {}
    for room in rooms:
        places = [tree / place for place in ROOMS[room][0]]
        files = [file for place in places for file in (sorted(place.rglob("*.py")) if place.is_dir() else [place])]
        every = [(room, file, *mutation) for file in files for mutation in mutations(file.read_text("utf-8"))]
        queues[room] = generator.sample(every, min(len(every), count))
    turns = [row for number in range(count) for queue in queues.values() for row in queue[number : number + 1]]
    yield from turns[:count]


if __name__ == "__main__":
    main()
