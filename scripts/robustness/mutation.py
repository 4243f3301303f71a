"""Mutation run: small faults put into the code one at a time, and whether the tests notice; POSIX only.

The first call copies the tree and records, under coverage.py, which tests run which lines. Then each mutant is put into
the copy and gets the tests that run its lines, those of its own room and the fastest first, until one fails, with a
time limit; each in a fork of a process that has the large libraries already. Messages (f-strings, also where they are
all that is returned), what goes to the log, annotations, decorators and ``__all__`` stay as they are.

    python scripts/robustness/mutation.py FOLDER --count 400

goes on where it was left, for the results are in FOLDER/results.tsv. Needs coverage.py.
"""

from __future__ import annotations

import argparse
import ast
import contextlib
import functools
import gc
import importlib
import io
import json
import os
import random
import re
import resource
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from difflib import SequenceMatcher
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from coverage import Coverage

ROOMS = {
    "plan": (
        ["hpe_rig/plan"],
        ["tests/hpe_rig/plan"] + [f"tests/system/test_{name}.py" for name in ("found_by_mutation", "sweep")],
    ),
    "bench": (
        [f"hpe_rig/bench/{name}.py" for name in ("opening", "instruments", "interrupts", "lock")],
        ["tests/hpe_rig/bench", "tests/hpe_rig/acquire"]
        + [f"tests/system/test_{name}.py" for name in ("safety", "signals", "queue", "one_run_a_file", "wires")],
    ),
    "sequencer": (
        ["hpe_rig/acquire/sequencer.py"],
        ["tests/hpe_rig/acquire"]
        + [f"tests/system/test_{name}.py" for name in ("safety", "watched_settings", "boards", "capture_modes")],
    ),
    "store": (
        ["hpe_rig/store"],
        [
            "tests/hpe_rig/store",
            *(f"tests/system/test_{name}.py" for name in ("one_run_a_file", "old_run_files", "distrust", "resume")),
            "tests/system/test_integrity.py",
        ],
    ),
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
PRELOADED = (
    "numpy",
    "scipy.signal",
    "scipy.optimize",
    "h5py",
    "pydantic",
    "hypothesis.extra.numpy",
    "matplotlib.figure",
)
VERDICTS = ("killed", "timed out", "survived", "not run", "unknown", "explained")
EXPLAINED = "docs/project/testing.md"
LONGEST_S = 4.0
"""Processor time after which the recording gives up a test; it takes no part."""
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
            if isinstance(child, ast.AST) and not _is_unseen(child):
                yield from _nodes(child)


def _is_unseen(node: ast.AST) -> bool:
    """Return whether ``node`` is a message, a line of the log, a list of names or an option of no number."""
    match node:
        case ast.JoinedStr() | ast.Return(ast.JoinedStr()) | ast.Assign([ast.Name("__all__")]):
            return True
        case ast.Call(ast.Attribute(ast.Name("_LOG"))):
            return True
        case ast.keyword(arg=name):
            return name in UNSEEN_KEYWORDS
    return False


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


@dataclass(frozen=True)
class Mutant:
    """One fault: the file, relative to the copy, the node and the text that takes its place."""

    room: str
    file: str
    node: ast.expr | ast.stmt
    new: str
    source: str

    @cached_property
    def text(self) -> str:
        """The file's text with the fault in it."""
        lines = self.source.encode().splitlines(keepends=True)
        first, last = self.node.lineno, self.node.end_lineno or self.node.lineno
        start = sum(map(len, lines[: first - 1])) + self.node.col_offset
        end = sum(map(len, lines[: last - 1])) + (self.node.end_col_offset or 0)
        text = self.new if isinstance(self.node, ast.stmt) else f"({self.new})"
        return (self.source.encode()[:start] + text.encode() + self.source.encode()[end:]).decode()

    @property
    def name(self) -> str:
        old = " ".join((ast.get_source_segment(self.source, self.node) or "").split())
        return f"{self.file}:{self.node.lineno}:{self.node.col_offset}\t{old}\t{self.new}"

    @cached_property
    def used_at(self) -> list[int]:
        """The lines that use the name to which the node's statement at the top of the file is bound."""
        tree = ast.parse(self.source)
        top = next(item for item in tree.body if item.lineno <= self.node.lineno <= (item.end_lineno or 0))
        names = {
            part.id for part in ast.walk(top) if isinstance(part, ast.Name) and isinstance(part.ctx, ast.Store)
        } | {getattr(top, "name", "")}
        return [part.lineno for part in ast.walk(tree) if isinstance(part, ast.Name) and part.id in names]

    def lines(self) -> range:
        """The lines of the statement that the node is in, up to the node's end; one of them runs if the node does."""
        around = [
            item
            for item in ast.walk(ast.parse(self.source))
            if isinstance(item, ast.stmt) and item.lineno <= self.node.lineno <= (item.end_lineno or 0)
        ]
        return range(max(item.lineno for item in around), (self.node.end_lineno or 0) + 1)

    @cached_property
    def change(self) -> tuple[str, str, str]:
        """Where, and the line as it is and as it would be: what names a fault that was looked at before."""
        names = [
            item.name
            for item in ast.walk(ast.parse(self.source))
            if isinstance(item, ast.FunctionDef | ast.ClassDef)
            and item.lineno <= self.node.lineno <= (item.end_lineno or 0)
        ]
        old, new = (text.splitlines()[self.node.lineno - 1].strip() for text in (self.source, self.text))
        return ":".join([self.file, *names[-1:]]), old, new


def explained() -> set[tuple[str, str, str]]:
    """Return the faults that make no difference: the table of ``EXPLAINED``, place, line and mutated line."""
    text = (Path(__file__).resolve().parents[2] / EXPLAINED).read_text("utf-8")
    return set(re.findall(r"^\| `(\S+)` \| `(.+?)` \| `(.+?)` \| .+ \|$", text, re.MULTILINE))


def drawn_before(folder: Path, tree: Path) -> Iterator[Mutant]:
    """Yield the mutants of an earlier run whose line is still there, in its order."""
    there: dict[str, dict[tuple[int, int, str], Mutant]] = {}
    for _, room, _, _, where, _, new in Results(folder / "results.tsv").rows():
        file, line, column = where.split(":")
        if file not in there:
            before, now = ((root / file).read_text("utf-8") for root in (folder / "tree", tree))
            blocks = SequenceMatcher(None, before.splitlines(), now.splitlines(), autojunk=False).get_matching_blocks()
            earlier = {b + n + 1: a + n + 1 for a, b, size in blocks for n in range(size)}
            every = [Mutant(room, file, *item, now) for item in mutations(now)]
            there[file] = {(earlier.get(m.node.lineno, 0), m.node.col_offset, m.new): m for m in every}
        if mutant := there[file].get((int(line), int(column), new)):
            yield mutant


def chosen(tree: Path, rooms: Sequence[str], count: int, seed: int) -> Iterator[Mutant]:
    """Yield ``count`` mutants drawn at random, room by room in turn, so that none is left out when time is short."""
    generator, queues = random.Random(seed), []
    for room in rooms:
        places = [tree / place for place in ROOMS[room][0]]
        files = [file for place in places for file in (sorted(place.rglob("*.py")) if place.is_dir() else [place])]
        texts = {str(file.relative_to(tree)): file.read_text("utf-8") for file in files}
        every = [Mutant(room, name, *item, text) for name, text in texts.items() for item in mutations(text)]
        queues.append(generator.sample(every, min(len(every), count)))
    turns = [mutant for number in range(count) for queue in queues for mutant in queue[number : number + 1]]
    yield from turns[:count]


class Recorder:
    """Tells coverage.py which test is running, or which shared fixture is being made for which test file."""

    def __init__(self, coverage: Coverage) -> None:
        self.coverage, self.now, self.users = coverage, "", dict[str, list[str]]()
        self.seconds: dict[str, float] = defaultdict(float)
        self.failed: set[str] = set()
        self.item = ""
        self.caches: list[functools._lru_cache_wrapper[object]] = []

    def pytest_sessionstart(self) -> None:
        signal.signal(signal.SIGVTALRM, lambda *_: pytest.fail("takes too long for a mutation run"))

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        if self.item.partition("::")[0] != item.nodeid.partition("::")[0]:
            self.caches = [each for each in gc.get_objects() if isinstance(each, functools._lru_cache_wrapper)]
        for cache in self.caches:
            # What another test has worked out is worked out again, and so seen.
            cache.cache_clear()
        self.now = self.item = item.nodeid
        self.coverage.switch_context(self.now)
        with self.timed():
            signal.setitimer(signal.ITIMER_VIRTUAL, LONGEST_S)
            try:
                return (yield)
            finally:
                signal.setitimer(signal.ITIMER_VIRTUAL, 0.0)

    @contextlib.contextmanager
    def timed(self) -> Iterator[None]:
        """Add the processor time of what runs now and of what it starts, less that of a shared fixture inside it."""
        name, others_s, start_s = self.now, sum(self.seconds.values()) - self.seconds[self.now], sum(os.times()[:4])
        yield
        inside_s = sum(self.seconds.values()) - self.seconds[name] - others_s
        self.seconds[name] += sum(os.times()[:4]) - start_s - inside_s

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(
        self, fixturedef: pytest.FixtureDef[object], request: pytest.FixtureRequest
    ) -> Iterator[None]:
        before, file = self.now, self.item.partition("::")[0]
        if fixturedef.scope != "function":
            self.now = f"{fixturedef.argname} of {file}"
            self.users[self.now] = [
                item.nodeid
                for item in request.session.items
                if fixturedef.argname in getattr(item, "fixturenames", ())
                and (fixturedef.scope == "session" or item.nodeid.partition("::")[0] == file)
            ]
        if self.now == before:
            return (yield)
        self.coverage.switch_context(self.now)
        left_s, _ = signal.setitimer(signal.ITIMER_VIRTUAL, 0.0)
        try:
            with self.timed():
                return (yield)
        finally:
            signal.setitimer(signal.ITIMER_VIRTUAL, left_s)
            self.now = before
            self.coverage.switch_context(before)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if not report.passed:
            self.failed.add(report.nodeid)


class Only:
    """Keeps some tests of those collected, in the order in which they are named."""

    def __init__(self, names: Sequence[str]) -> None:
        self.place = {name: number for number, name in enumerate(names)}

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        items[:] = sorted((item for item in items if item.nodeid in self.place), key=lambda i: self.place[i.nodeid])


class Deadline:
    """Ends the process by SIGALRM where a test takes far longer than it did; keeps the name of the last in a file."""

    def __init__(self, seconds: Mapping[str, float], last: Path) -> None:
        self.seconds, self.last = seconds, last

    def pytest_runtest_logstart(self, nodeid: str) -> None:
        self.last.write_text(nodeid, "utf-8")
        # A busy machine makes others wait: processor time tells a loop, a long time a wait without end.
        signal.setitimer(signal.ITIMER_VIRTUAL, 5.0 + 5 * self.seconds[nodeid])
        signal.setitimer(signal.ITIMER_REAL, 90.0 + 20 * self.seconds[nodeid])


def run_pytest(tree: Path, arguments: Iterable[str], plugins: list[object]) -> int:
    """Return pytest's code for tests of ``tree``; for a fork, which is used up by it."""
    # A program in the background may have been told to ignore Ctrl-C, and hands that down to the tests.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    for number in (signal.SIGALRM, signal.SIGVTALRM):
        signal.signal(number, signal.SIG_DFL)
    sys.path.insert(0, str(tree))
    sys.dont_write_bytecode = True
    quiet = ["-q", "-p", "no:cacheprovider", "-p", "no:xdist", "-W", "ignore::pytest.PytestAssertRewriteWarning"]
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        return int(pytest.main([*quiet, f"--basetemp={tree.parent / 'temporary'}", *arguments], plugins))


def forked(call: Callable[[], int]) -> int:
    """Return the exit code of ``call`` in a fork with a process group of its own, minus the signal that ended it."""
    child = os.fork()
    if not child:
        os.setpgid(0, 0)
        resource.setrlimit(resource.RLIMIT_AS, (8 << 30, resource.getrlimit(resource.RLIMIT_AS)[1]))
        code = 70
        try:
            code = call()
        finally:
            os._exit(code)
    try:
        return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    finally:
        # What a test started goes with it.
        with contextlib.suppress(ProcessLookupError):
            os.killpg(child, signal.SIGKILL)


def tests_of_rooms(rooms: Iterable[str]) -> list[str]:
    """Return the files and folders of the tests of some rooms."""
    return sorted({path for room in rooms for path in ROOMS[room][1]})


def record(tree: Path, folder: Path, rooms: Iterable[str]) -> int:
    """Run the rooms' tests under coverage.py and write what they run and how long it takes; in a fork."""
    from coverage import Coverage

    places = [tree / place for room in ROOMS.values() for place in room[0]]
    coverage = Coverage(None, include=[f"{place}/*" if place.is_dir() else str(place) for place in places])
    coverage.start()
    recorder = Recorder(coverage)
    run_pytest(tree, tests_of_rooms(rooms), [recorder])
    coverage.stop()
    data = coverage.get_data()
    lines = {str(Path(file).relative_to(tree)): data.contexts_by_lineno(file) for file in data.measured_files()}
    tests = {"seconds": recorder.seconds, "failed": sorted(recorder.failed), "users": recorder.users, "lines": lines}
    (folder / "tests.json").write_text(json.dumps(tests), "utf-8")
    return 0


@dataclass(frozen=True)
class Record:
    """Which tests run which lines of the copy at ``tree``."""

    tree: Path
    lines: Mapping[str, Mapping[str, Sequence[str]]]
    seconds: Mapping[str, float]
    failed: frozenset[str]
    users: Mapping[str, Sequence[str]]

    @cached_property
    def fixtures(self) -> Mapping[str, set[str]]:
        """The shared fixtures of every test."""
        used: dict[str, set[str]] = defaultdict(set)
        for name, tests in self.users.items():
            for test in tests:
                used[test].add(name)
        return used

    def tests_of(self, mutant: Mutant, budget_s: float) -> list[str]:
        """Return the tests that run a mutant, those of its room first and the fastest first, up to ``budget_s``."""
        contexts = self.lines.get(mutant.file, {})
        names = {name for line in mutant.lines() for name in contexts.get(str(line), ())}
        if not names - {""}:
            # Run at import: what runs a line that uses the constant or makes the class, else whatever runs the file.
            used = [name for line in mutant.used_at for name in contexts.get(str(line), ()) if name]
            names = set(used or [name for some in contexts.values() for name in some] if names else [])
        tests = {test for name in names for test in self.users.get(name, (name,))} & self.seconds.keys() - self.failed
        tests -= self.users.keys()
        places = tuple(ROOMS[mutant.room][1])
        if not tests:
            # Some start programs of their own, in which nobody looked.
            tests |= {test for test in self.seconds if test.startswith(places)} - self.failed - self.users.keys()
        ordered = sorted(tests, key=lambda test: (not test.startswith(places), self.seconds[test]))
        taken, made, total_s = list[str](), set[str](), 0.0
        for test in ordered:
            fixtures = self.fixtures[test] - made
            total_s += self.seconds[test] + sum(self.seconds[name] for name in fixtures) + 0.01
            if total_s > budget_s and taken:
                break
            made |= fixtures
            taken.append(test)
        return taken


class Killer:
    """The test that killed a mutant, which must let the code as it is live, or has seen nothing."""

    def __init__(self, last: Path) -> None:
        self.last, self.sound = last, dict[str, bool]()

    def word(self, code: int, alone: Callable[[str], int]) -> str:
        """Return the verdict by an exit code; ``alone`` runs one test on the code as it is."""
        if not code:
            return "survived"
        name = self.last.read_text("utf-8")
        if name not in self.sound:
            self.sound[name] = alone(name) == 0
        return (
            ("timed out" if code in (-signal.SIGALRM, -signal.SIGVTALRM) else "killed")
            if self.sound[name]
            else "unknown"
        )


@contextlib.contextmanager
def in_place(tree: Path, mutant: Mutant) -> Iterator[None]:
    """Have the fault in the copy as well, for programs that a test starts."""
    path = tree / mutant.file
    path.write_text(mutant.text, "utf-8")
    try:
        yield
    finally:
        path.write_text(mutant.source, "utf-8")


class Results:
    """The file of results, one line a mutant: verdict, room, tests, seconds, place, what was there, what is."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def rows(self) -> list[list[str]]:
        """Return the latest row of every mutant."""
        lines = self.path.read_text("utf-8").splitlines() if self.path.exists() else []
        return list({line.split("\t", 4)[4]: line.split("\t") for line in lines}.values())

    def done(self, certain: bool = False) -> set[str]:
        """Return the names of the mutants that were judged; with ``certain`` of those that were killed."""
        sure = ("killed", "timed out") if certain else VERDICTS
        return {"\t".join(row[4:]) for row in self.rows() if row[0] in sure}

    def add(self, mutant: Mutant, verdict: str, tests: int, seconds: float) -> None:
        line = f"{verdict}\t{mutant.room}\t{tests}\t{seconds:.1f}\t{mutant.name}"
        print(line, file=sys.__stdout__, flush=True)
        with self.path.open("a", encoding="utf-8") as file:
            file.write(f"{line}\n")

    def table(self, rooms: Iterable[str]) -> str:
        found = Counter((row[1], row[0]) for row in self.rows())
        head = f"{'room':20}" + "".join(f"{verdict:>10}" for verdict in VERDICTS)
        rows = [f"{room:20}" + "".join(f"{found[room, verdict]:10}" for verdict in VERDICTS) for room in rooms]
        return "\n".join([head, *rows])


def _absolute(path: str) -> Path:
    return Path(path).resolve()


def main() -> None:
    """Copy and record where that has not been done, then one line a mutant and a table at the end or at Ctrl-C."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=_absolute, help="where the copy of the tree and the results are kept")
    parser.add_argument("--count", type=int, default=300)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--budget-s", type=float, default=30.0, help="tests of one mutant, by the time they took")
    parser.add_argument("--again", action="store_true", help="once more those that were not killed")
    parser.add_argument(
        "--of", type=_absolute, help="folder of an earlier run: its faults, as far as their line stands"
    )
    parser.add_argument("--rooms", nargs="*", choices=list(ROOMS), default=list(ROOMS))
    options = parser.parse_args()
    folder: Path = options.folder
    tree, results = folder / "tree", Results(folder / "results.tsv")
    if not (folder / "tests.json").exists():
        shutil.rmtree(tree, ignore_errors=True)
        root = Path(__file__).resolve().parents[2]
        shutil.copytree(root, tree, ignore=shutil.ignore_patterns(".git", "__pycache__", ".*_cache"))
        for command in ("init", "-q"), ("add", "-A"):
            subprocess.run(["git", *command], cwd=tree, check=True)
    # A run that was killed may have left its last fault there.
    subprocess.run(["git", "checkout-index", "-f", "-a"], cwd=tree, check=True)
    os.environ.update(PYTHONPATH=str(tree), PYTHONDONTWRITEBYTECODE="1")
    os.chdir(tree)
    for module in PRELOADED:
        importlib.import_module(module)
    if not (folder / "tests.json").exists():
        forked(lambda: record(tree, folder, options.rooms))
    tests = json.loads((folder / "tests.json").read_text("utf-8"))
    failed = frozenset(tests["failed"])
    known = Record(tree, tests["lines"], tests["seconds"], failed, tests["users"])
    wanted = list(
        drawn_before(options.of, tree) if options.of else chosen(tree, options.rooms, options.count, options.seed)
    )
    with contextlib.suppress(KeyboardInterrupt):
        done = results.done(certain=options.again)
        known_to_live = explained()
        killer = Killer(folder / "last")
        deadline = Deadline(known.seconds, killer.last)

        def code_of(names: Sequence[str]) -> int:
            files = sorted({name.partition("::")[0] for name in names})
            return forked(lambda: run_pytest(tree, ["-x", *files], [Only(names), deadline]))

        for mutant in wanted:
            if mutant.name in done:
                continue
            if mutant.change in known_to_live:
                results.add(mutant, "explained", 0, 0.0)
                continue
            names, start_s = known.tests_of(mutant, options.budget_s), time.monotonic()
            with in_place(tree, mutant):
                code = code_of(names) if names else 0
            word = killer.word(code, lambda name: code_of([name])) if names else "not run"
            results.add(mutant, word, len(names), time.monotonic() - start_s)
    print(f"\n{results.table(options.rooms)}")


if __name__ == "__main__":
    main()
