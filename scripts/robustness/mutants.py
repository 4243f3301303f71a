"""Faults for `mutation.py`: which nodes of the source can be mutated and how, and which mutants a run tries.

A mutant is a comparison at equality or inverted, `+` for `-`, `*` for `/`, `and` for `or`, a `not` or a sign removed,
another number (integers by 1, others by 10 %), another truth value, None returned, or a call removed that is a
statement. Messages, log calls, annotations, decorators and `__all__` are not mutated.
"""

from __future__ import annotations

import ast
import random
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from difflib import SequenceMatcher
from functools import cached_property
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
EXPLAINED = ROOT / "docs" / "project" / "testing.md"
"""Page with the table of mutants that no test needs to detect."""
CODE_AND_TESTS = {
    "plan": ("hpe_rig/plan", "tests/hpe_rig/plan tests/system/test_extreme_input.py tests/system/test_sweep.py"),
    "bench": (
        "hpe_rig/bench",
        "tests/hpe_rig/bench tests/hpe_rig/measurement tests/system/test_safety.py tests/system/test_signals.py "
        "tests/system/test_queue.py tests/system/test_one_run_a_file.py tests/system/test_wires.py",
    ),
    "measurement": (
        "hpe_rig/measurement",
        "tests/hpe_rig/measurement tests/system/test_safety.py tests/system/test_watched_settings.py "
        "tests/system/test_boards.py tests/system/test_capture_modes.py tests/system/test_queue.py "
        "tests/system/test_resume.py tests/system/test_stopped_runs.py",
    ),
    "store": (
        "hpe_rig/store",
        "tests/hpe_rig/store tests/system/test_one_run_a_file.py tests/system/test_old_run_files.py "
        "tests/system/test_tampered_run_files.py tests/system/test_resume.py",
    ),
    "processing": ("hpe_rig/processing", "tests/hpe_rig/processing"),
    "wiring": (
        "sim_backend/wiring.py sim_backend/world.py",
        "tests/sim_backend/test_wiring.py tests/sim_backend/test_world.py",
    ),
    "timing": (
        "sim_backend/generator/emission.py sim_backend/generator/timing.py sim_backend/digitizer/board.py",
        "tests/sim_backend/test_wiring.py tests/sim_backend/generator tests/sim_backend/digitizer",
    ),
    "drivers": ("drivers", "tests/drivers tests/system/test_idle_connections.py"),
}
"""Files and folders that are mutated, and their tests, by package."""
PACKAGES = {package: (code.split(), tests.split()) for package, (code, tests) in CODE_AND_TESTS.items()}
SWAPS: dict[type[ast.AST], type[ast.AST]] = {
    operator: swapped
    for pair in [
        (ast.Lt, ast.LtE), (ast.Gt, ast.GtE), (ast.Eq, ast.NotEq), (ast.Is, ast.IsNot), (ast.In, ast.NotIn),
        (ast.Add, ast.Sub), (ast.Mult, ast.Div), (ast.And, ast.Or),
    ]
    for operator, swapped in (pair, pair[::-1])
}  # fmt: skip
SKIPPED_FIELDS = ("annotation", "returns", "decorator_list", "type_params", "op", "ops", "ctx")
SKIPPED_KEYWORDS = {"strict", "frozen", "slots", "dtype", "encoding"}
"""Keyword arguments that change no number."""


@dataclass(frozen=True)
class Mutant:
    """A fault: the file relative to the tree, the node and the text that replaces it."""

    package: str
    file: str
    node: ast.expr | ast.stmt
    replacement: str
    source: str

    @cached_property
    def text(self) -> str:
        """The file's text with the fault in it."""
        # Columns of the syntax tree count bytes.
        source = self.source.encode()
        lines = source.splitlines(keepends=True)
        first, last = self.node.lineno, self.node.end_lineno or self.node.lineno
        start = sum(map(len, lines[: first - 1])) + self.node.col_offset
        end = sum(map(len, lines[: last - 1])) + (self.node.end_col_offset or 0)
        replacement = self.replacement if isinstance(self.node, ast.stmt) else f"({self.replacement})"
        return (source[:start] + replacement.encode() + source[end:]).decode()

    @property
    def name(self) -> str:
        """Position, original and replacement, separated by tabs: the key in the file of results."""
        original = " ".join((ast.get_source_segment(self.source, self.node) or "").split())
        return f"{self.file}:{self.node.lineno}:{self.node.col_offset}\t{original}\t{self.replacement}"

    @cached_property
    def users(self) -> list[int]:
        """Lines that use a name that the node's top-level statement binds."""
        tree = ast.parse(self.source)
        top = next(statement for statement in tree.body if self._is_in(statement))
        stores = (item for item in ast.walk(top) if isinstance(item, ast.Name) and isinstance(item.ctx, ast.Store))
        names = {item.id for item in stores} | {getattr(top, "name", "")}
        return [item.lineno for item in ast.walk(tree) if isinstance(item, ast.Name) and item.id in names]

    @cached_property
    def lines(self) -> range:
        """Lines of the innermost statement around the node; one of them runs if the node does."""
        first = max(item.lineno for item in self._around if isinstance(item, ast.stmt))
        return range(first, (self.node.end_lineno or 0) + 1)

    @cached_property
    def change(self) -> tuple[str, str, str]:
        """File and function, the line, and the mutated line: the key in the table of explained mutants."""
        names = [item.name for item in self._around if isinstance(item, ast.FunctionDef | ast.ClassDef)]
        original, mutated = (text.splitlines()[self.node.lineno - 1].strip() for text in (self.source, self.text))
        return ":".join([self.file, *names[-1:]]), original, mutated

    @property
    def _around(self) -> list[ast.AST]:
        return [item for item in ast.walk(ast.parse(self.source)) if self._is_in(item)]

    def _is_in(self, item: ast.AST) -> bool:
        """Return whether ``item`` is a statement that contains the node's first line."""
        return isinstance(item, ast.stmt) and item.lineno <= self.node.lineno <= (item.end_lineno or 0)


def mutants_of(package: str, file: str, source: str) -> list[Mutant]:
    """Return all mutants of one file."""
    return [
        Mutant(package, file, node, ast.unparse(ast.fix_missing_locations(new)), source)
        for node in _nodes(ast.parse(source))
        for new in _replacements(node)
    ]


def _nodes(node: ast.AST) -> Iterator[ast.AST]:
    """Yield ``node`` and the nodes below it, without those that are not mutated."""
    yield node
    for name, value in ast.iter_fields(node):
        if name in SKIPPED_FIELDS:
            continue
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.AST) and not _is_skipped(child):
                yield from _nodes(child)


def _is_skipped(node: ast.AST) -> bool:
    """Return whether ``node`` is a message, a log call, a list of names or a keyword without effect on numbers."""
    match node:
        case ast.JoinedStr() | ast.Return(ast.JoinedStr()) | ast.Assign([ast.Name("__all__")]):
            return True
        case ast.Call(ast.Attribute(ast.Name("_LOG"))) | ast.Expr(ast.Call(ast.Attribute(ast.Name("_LOG")))):
            return True
        case ast.keyword(arg=name):
            return name in SKIPPED_KEYWORDS
    return False


def _replacements(node: ast.AST) -> Iterator[ast.AST]:
    match node:
        case ast.Compare(left, [op], right) if type(op) in SWAPS:
            yield ast.Compare(left, [SWAPS[type(op)]()], right)
        case ast.BinOp(left, op, right) if type(op) in SWAPS and not (_has_text(left) or _has_text(right)):
            yield ast.BinOp(left, SWAPS[type(op)](), right)
        case ast.BoolOp(op, values):
            yield ast.BoolOp(SWAPS[type(op)](), values)
        case ast.UnaryOp(ast.Not() | ast.USub(), operand):
            yield operand
        case ast.Constant(bool() as value):
            yield ast.Constant(not value)
        case ast.Constant(int() as value):
            yield ast.Constant(value + 1)
            yield ast.Constant(value - 1)
        case ast.Constant(float() as value):
            yield ast.Constant(value * 1.1 or 1.0)
        case ast.Expr(ast.Call()):
            yield ast.Pass()
        case ast.Return(ast.expr() as value) if not (isinstance(value, ast.Constant) and value.value is None):
            yield ast.Return(ast.Constant(None))


def _has_text(node: ast.AST) -> bool:
    items = list(ast.walk(node))
    return any(isinstance(item, ast.JoinedStr) or isinstance(getattr(item, "value", None), str) for item in items)


def explained_changes() -> set[tuple[str, str, str]]:
    """Return the ``change`` of every mutant in the table of ``EXPLAINED``."""
    pattern = r"^\| `(\S+)` \| `(.+?)` \| `(.+?)` \| .+ \|$"
    return set(re.findall(pattern, EXPLAINED.read_text("utf-8"), re.MULTILINE))


def draw_mutants(tree: Path, packages: Sequence[str], count: int, seed: int) -> list[Mutant]:
    """Return ``count`` random mutants, alternating between packages, so that a short run reaches all of them."""
    generator, queues = random.Random(seed), []
    for package in packages:
        paths = [tree / path for path in PACKAGES[package][0]]
        files = [file for path in paths for file in (sorted(path.rglob("*.py")) if path.is_dir() else [path])]
        sources = {str(file.relative_to(tree)): file.read_text("utf-8") for file in files}
        mutants = [mutant for name, source in sources.items() for mutant in mutants_of(package, name, source)]
        queues.append(generator.sample(mutants, min(len(mutants), count)))
    # One of each package, then the second of each, and so on.
    alternating = [mutant for number in range(count) for queue in queues for mutant in queue[number : number + 1]]
    return alternating[:count]


def earlier_mutants(rows: Sequence[Sequence[str]], earlier_tree: Path, tree: Path) -> Iterator[Mutant]:
    """Yield the mutants of an earlier run's result rows that can be applied to ``tree``, in their order.

    A mutant applies if its line is unchanged, possibly at another line number.
    """
    by_position: dict[str, dict[tuple[int, int, str], Mutant]] = {}
    for _, package, _, _, position, _, replacement in rows:
        file, line, column = position.split(":")
        if file not in by_position:
            before, now = ((root / file).read_text("utf-8") for root in (earlier_tree, tree))
            # Line numbers of the earlier tree, for lines that both trees have.
            blocks = SequenceMatcher(None, before.splitlines(), now.splitlines(), autojunk=False).get_matching_blocks()
            earlier_lines = {b + n + 1: a + n + 1 for a, b, size in blocks for n in range(size)}
            by_position[file] = {
                (earlier_lines.get(mutant.node.lineno, 0), mutant.node.col_offset, mutant.replacement): mutant
                for mutant in mutants_of(package, file, now)
            }
        if mutant := by_position[file].get((int(line), int(column), replacement)):
            yield mutant
