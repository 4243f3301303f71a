"""Mutation test: put small faults into the code one at a time and see whether the tests fail. POSIX.

    python scripts/robustness/mutation.py FOLDER --count 400

The first call copies the tree to FOLDER/tree and records with coverage.py which tests run which lines. Each mutant
(`mutants.py`) is then put into the copy, and the tests that run its lines run until one fails: those of its package and
the fastest first, with a time limit, in a fork of a process that has loaded the large libraries. FOLDER/results.tsv has
a row for each mutant; the next call continues there. Needs coverage.py.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib
import io
import json
import os
import resource
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from mutants import PACKAGES, ROOT, Mutant, draw_mutants, earlier_mutants, explained_changes

if TYPE_CHECKING:
    from coverage import Coverage

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
MAX_TEST_S = 4.0
"""Tests that take more processor time are stopped while recording, and not used."""
MAX_MEMORY_BYTES = 8 << 30
EXIT_FORK_FAILED = 70


class Recorder:
    """Pytest plug-in that reports to coverage.py which test, or which shared fixture of a test file, is running.

    The current context is the test's or the fixture's name. ``users`` maps each shared fixture to its tests.
    """

    def __init__(self, coverage: Coverage) -> None:
        self.coverage, self.context, self.test = coverage, "", ""
        self.users: dict[str, list[str]] = {}
        self.seconds: dict[str, float] = defaultdict(float)
        self.failed: set[str] = set()

    def pytest_sessionstart(self) -> None:
        signal.signal(signal.SIGVTALRM, lambda *_: pytest.fail("takes too long for a mutation run"))

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        # A value cached by an earlier test would hide that this test runs the lines that compute it.
        clear_caches()
        self.context = self.test = item.nodeid
        self.coverage.switch_context(self.context)
        with self.timed():
            signal.setitimer(signal.ITIMER_VIRTUAL, MAX_TEST_S)
            try:
                return (yield)
            finally:
                signal.setitimer(signal.ITIMER_VIRTUAL, 0.0)

    @contextlib.contextmanager
    def timed(self) -> Iterator[None]:
        """Add the processor time of the block and its child processes to the context, without fixtures inside it."""
        context = self.context
        start_others_s = sum(self.seconds.values()) - self.seconds[context]
        start_s = sum(os.times()[:4])
        yield
        fixtures_s = sum(self.seconds.values()) - self.seconds[context] - start_others_s
        self.seconds[context] += sum(os.times()[:4]) - start_s - fixtures_s

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(
        self, fixturedef: pytest.FixtureDef[object], request: pytest.FixtureRequest
    ) -> Iterator[None]:
        if fixturedef.scope == "function":
            return (yield)
        test_context, file = self.context, self.test.partition("::")[0]
        self.context = f"{fixturedef.argname} of {file}"
        self.users[self.context] = [
            item.nodeid
            for item in request.session.items
            if fixturedef.argname in getattr(item, "fixturenames", ())
            and (fixturedef.scope == "session" or item.nodeid.partition("::")[0] == file)
        ]
        self.coverage.switch_context(self.context)
        remaining_s, _ = signal.setitimer(signal.ITIMER_VIRTUAL, 0.0)
        try:
            with self.timed():
                return (yield)
        finally:
            signal.setitimer(signal.ITIMER_VIRTUAL, remaining_s)
            self.context = test_context
            self.coverage.switch_context(test_context)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if not report.passed:
            self.failed.add(report.nodeid)


def clear_caches() -> None:
    """Empty the caches of all functions and methods in the project's modules."""
    for name, module in list(sys.modules.items()):
        if name.partition(".")[0] in ("hpe_rig", "drivers", "sim_backend"):
            values = list(vars(module).values())
            values += [attribute for value in values if isinstance(value, type) for attribute in vars(value).values()]
            for value in values:
                if callable(clear := getattr(value, "cache_clear", None)):
                    clear()


class Selection:
    """Pytest plug-in that runs the named tests only, in their order."""

    def __init__(self, names: Sequence[str]) -> None:
        self.order = {name: number for number, name in enumerate(names)}

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        items[:] = sorted((item for item in items if item.nodeid in self.order), key=lambda i: self.order[i.nodeid])


class Deadline:
    """Pytest plug-in that ends the process if a test takes far longer than recorded.

    The name of the running test is in the file ``current``.
    """

    def __init__(self, seconds: Mapping[str, float], current: Path) -> None:
        self.seconds, self.current = seconds, current

    def pytest_runtest_logstart(self, nodeid: str) -> None:
        self.current.write_text(nodeid, "utf-8")
        # Processor time detects a loop also on a busy machine; elapsed time detects a wait without end.
        signal.setitimer(signal.ITIMER_VIRTUAL, 5.0 + 5 * self.seconds[nodeid])
        signal.setitimer(signal.ITIMER_REAL, 90.0 + 20 * self.seconds[nodeid])


def run_pytest(tree: Path, arguments: Iterable[str], plugins: list[object]) -> int:
    """Run tests of ``tree`` and return pytest's exit code; to be called in a fork, which it changes."""
    # A background process may ignore Ctrl-C, and the tests would inherit that.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    for number in (signal.SIGALRM, signal.SIGVTALRM):
        signal.signal(number, signal.SIG_DFL)
    sys.path.insert(0, str(tree))
    sys.dont_write_bytecode = True
    options = ["-q", "-n0", "-p", "no:cacheprovider", "-W", "ignore::pytest.PytestAssertRewriteWarning"]
    options.append(f"--basetemp={tree.parent / 'temporary'}")
    output = io.StringIO()
    with contextlib.redirect_stdout(output), contextlib.redirect_stderr(output):
        code = int(pytest.main([*options, *arguments], plugins))
    if code not in (pytest.ExitCode.OK, pytest.ExitCode.TESTS_FAILED):
        print(output.getvalue(), file=sys.stderr, flush=True)
    return code


def forked(call: Callable[[], int]) -> int:
    """Return the exit code of ``call`` in a fork with its own process group; minus the signal that ended it."""
    child = os.fork()
    if not child:
        os.setpgid(0, 0)
        resource.setrlimit(resource.RLIMIT_AS, (MAX_MEMORY_BYTES, resource.getrlimit(resource.RLIMIT_AS)[1]))
        code = EXIT_FORK_FAILED
        try:
            code = call()
        finally:
            os._exit(code)
    try:
        return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    finally:
        # Programs that a test started end with it.
        with contextlib.suppress(ProcessLookupError):
            os.killpg(child, signal.SIGKILL)


def record(tree: Path, target: Path, packages: Iterable[str]) -> int:
    """Run the tests of ``packages`` under coverage.py and write which lines they run and how long; in a fork."""
    from coverage import Coverage

    paths = [tree / path for code, _ in PACKAGES.values() for path in code]
    coverage = Coverage(None, include=[f"{path}/*" if path.is_dir() else str(path) for path in paths])
    coverage.start()
    recorder = Recorder(coverage)
    run_pytest(tree, sorted({test for package in packages for test in PACKAGES[package][1]}), [recorder])
    coverage.stop()
    data = coverage.get_data()
    lines = {str(Path(file).relative_to(tree)): data.contexts_by_lineno(file) for file in data.measured_files()}
    fields = {"seconds": recorder.seconds, "failed": sorted(recorder.failed), "users": recorder.users, "lines": lines}
    target.write_text(json.dumps(fields), "utf-8")
    return 0


@dataclass(frozen=True)
class RecordedTests:
    """The tests that run each line of each file, and their processor times."""

    lines: Mapping[str, Mapping[str, Sequence[str]]]
    """Names of tests and shared fixtures by file and line number."""
    seconds: Mapping[str, float]
    failed: Sequence[str]
    users: Mapping[str, Sequence[str]]
    """Tests of each shared fixture."""

    @cached_property
    def fixtures(self) -> Mapping[str, set[str]]:
        """The shared fixtures of every test."""
        fixtures: dict[str, set[str]] = defaultdict(set)
        for name, tests in self.users.items():
            for test in tests:
                fixtures[test].add(name)
        return fixtures

    def tests_of(self, mutant: Mutant, budget_s: float, all_tests: bool = False) -> list[str]:
        """Return the tests that run a mutant, those of its package and the fastest first, up to ``budget_s``.

        With ``all_tests`` all others of its package follow: a test that compares constants runs none of its lines.
        """
        usable = self.seconds.keys() - set(self.failed) - self.users.keys()
        package_tests = tuple(PACKAGES[mutant.package][1])
        tests = {test for name in self._contexts_of(mutant) for test in self.users.get(name, (name,))} & usable
        candidates = set(tests)
        if all_tests or not tests:
            # Lines that only programs started by tests run are not recorded: try all tests of the package.
            candidates |= {test for test in usable if test.startswith(package_tests)}
        ordered = sorted(
            candidates, key=lambda test: (test not in tests, not test.startswith(package_tests), self.seconds[test])
        )
        return self._within_budget(ordered, budget_s)

    def _contexts_of(self, mutant: Mutant) -> set[str]:
        """Return the names of tests and fixtures that run the mutant's lines."""
        by_line = self.lines.get(mutant.file, {})
        names = {name for line in mutant.lines for name in by_line.get(str(line), ())}
        if names != {""}:
            return names - {""}
        # The line runs at import only. Its tests run a line that uses the constant or class, or any line of the file.
        users = {name for line in mutant.users for name in by_line.get(str(line), ())} - {""}
        return users or {name for contexts in by_line.values() for name in contexts} - {""}

    def _within_budget(self, tests: Sequence[str], budget_s: float) -> list[str]:
        """Return the first tests that fit ``budget_s`` together with their shared fixtures; at least one."""
        selection, fixtures, total_s = list[str](), set[str](), 0.0
        for test in tests:
            new_fixtures = self.fixtures[test] - fixtures
            # 10 ms are pytest's own time per test.
            total_s += self.seconds[test] + sum(self.seconds[name] for name in new_fixtures) + 0.01
            if total_s > budget_s and selection:
                break
            fixtures |= new_fixtures
            selection.append(test)
        return selection


class Judge:
    """Runs tests on the copy of the tree and gives the verdict on a mutant."""

    def __init__(self, tree: Path, tests: RecordedTests, budget_s: float, all_tests: bool) -> None:
        self.tree, self.tests, self.budget_s, self.all_tests = tree, tests, budget_s, all_tests
        self.current = tree.parent / "last"
        self.passes_unmutated: dict[str, bool] = {}

    def verdict(self, mutant: Mutant) -> tuple[str, int]:
        """Return the verdict and the number of tests that were selected."""
        names = self.tests.tests_of(mutant, self.budget_s, self.all_tests)
        if not names:
            return "not run", 0
        with applied(self.tree, mutant):
            code = self._exit_code(names)
        if not code:
            return "survived", len(names)
        # A test that also fails on the unmutated code is no evidence.
        failure = self.current.read_text("utf-8")
        if failure not in self.passes_unmutated:
            self.passes_unmutated[failure] = self._exit_code([failure]) == 0
        if not self.passes_unmutated[failure]:
            return "unknown", len(names)
        return "timed out" if code in (-signal.SIGALRM, -signal.SIGVTALRM) else "killed", len(names)

    def _exit_code(self, names: Sequence[str]) -> int:
        files = sorted({name.partition("::")[0] for name in names})
        plugins = [Selection(names), Deadline(self.tests.seconds, self.current)]
        return forked(lambda: run_pytest(self.tree, ["-x", *files], plugins))


@contextlib.contextmanager
def applied(tree: Path, mutant: Mutant) -> Iterator[None]:
    """Write the fault into the tree, where programs that a test starts find it too; restore the file at the end."""
    path = tree / mutant.file
    path.write_text(mutant.text, "utf-8")
    try:
        yield
    finally:
        path.write_text(mutant.source, "utf-8")


class Results:
    """File with a line per mutant: verdict, package, tests, seconds, position, original, replacement."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def rows(self) -> list[list[str]]:
        """Return the latest row of every mutant."""
        lines = self.path.read_text("utf-8").splitlines() if self.path.exists() else []
        return list({line.split("\t", 4)[4]: line.split("\t") for line in lines}.values())

    def names(self, verdicts: Sequence[str]) -> set[str]:
        """Return the names of the mutants with one of ``verdicts``."""
        return {"\t".join(row[4:]) for row in self.rows() if row[0] in verdicts}

    def add(self, mutant: Mutant, verdict: str, tests: int, seconds: float) -> None:
        line = f"{verdict}\t{mutant.package}\t{tests}\t{seconds:.1f}\t{mutant.name}"
        print(line, flush=True)
        with self.path.open("a", encoding="utf-8") as file:
            file.write(f"{line}\n")

    def table(self, packages: Iterable[str]) -> str:
        """Return the numbers of verdicts by package."""
        counts = Counter((row[1], row[0]) for row in self.rows())
        head = f"{'package':20}" + "".join(f"{verdict:>10}" for verdict in VERDICTS)
        rows = [f"{name:20}" + "".join(f"{counts[name, verdict]:10}" for verdict in VERDICTS) for name in packages]
        return "\n".join([head, *rows])


def prepare_tree(folder: Path, packages: Iterable[str]) -> RecordedTests:
    """Copy the tree and record its tests on the first call; enter the copy and return the recorded tests."""
    tree, recording = folder / "tree", folder / "tests.json"
    if not recording.exists():
        shutil.rmtree(tree, ignore_errors=True)
        shutil.copytree(ROOT, tree, ignore=shutil.ignore_patterns(".git", "__pycache__", ".*_cache"))
        # The index of a repository of the copy restores mutated files.
        for command in ("init", "-q"), ("add", "-A"):
            subprocess.run(["git", *command], cwd=tree, check=True)
    # A killed run may have left a fault in the copy.
    subprocess.run(["git", "checkout-index", "-f", "-a"], cwd=tree, check=True)
    os.environ.update(PYTHONPATH=str(tree), PYTHONDONTWRITEBYTECODE="1")
    os.chdir(tree)
    # Forks share these libraries, which saves loading them for every mutant.
    for module in PRELOADED:
        importlib.import_module(module)
    if not recording.exists():
        forked(lambda: record(tree, recording, packages))
    return RecordedTests(**json.loads(recording.read_text("utf-8")))


def parse_options() -> argparse.Namespace:
    def absolute(path: str) -> Path:
        return Path(path).resolve()

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=absolute, help="folder for the copy of the tree and the results")
    parser.add_argument("--count", type=int, default=300, help="number of mutants")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--budget-s", type=float, default=30.0, help="recorded time of the tests of one mutant")
    parser.add_argument("--again", action="store_true", help="repeat the mutants that were not killed")
    parser.add_argument(
        "--own-tests", action="store_true", help="all tests in the folders that mirror the package, no others"
    )
    parser.add_argument("--of", type=absolute, help="folder of an earlier run: its mutants of unchanged lines")
    parser.add_argument("--packages", nargs="*", choices=list(PACKAGES), default=list(PACKAGES))
    return parser.parse_args()


def main() -> None:
    """Print a line per mutant, and a table at the end or after Ctrl-C."""
    options = parse_options()
    if options.own_tests:
        for code, tests in PACKAGES.values():
            folders = tuple(f"tests/{Path(path).parent if path.endswith('.py') else path}" for path in code)
            tests[:] = [test for test in tests if test.startswith(folders)]
    tree, results = options.folder / "tree", Results(options.folder / "results.tsv")
    judge = Judge(tree, prepare_tree(options.folder, options.packages), options.budget_s, options.own_tests)
    if options.of:
        mutants = list(earlier_mutants(Results(options.of / "results.tsv").rows(), options.of / "tree", tree))
    else:
        mutants = draw_mutants(tree, options.packages, options.count, options.seed)
    done = results.names(("killed", "timed out") if options.again else VERDICTS)
    explained = explained_changes()
    with contextlib.suppress(KeyboardInterrupt):
        for mutant in mutants:
            if mutant.name in done:
                continue
            start_s = time.monotonic()
            verdict, tests = ("explained", 0) if mutant.change in explained else judge.verdict(mutant)
            results.add(mutant, verdict, tests, time.monotonic() - start_s)
    print(f"\n{results.table(options.packages)}")


if __name__ == "__main__":
    main()
