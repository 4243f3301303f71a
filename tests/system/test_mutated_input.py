"""Mutated scenes, benches, studies and arguments end in a result or a message; nothing else.

Mutation knows the structure: it changes tables, not characters, so that most of what it makes gets past the parser. A
number becomes another type, an extreme, or any number within or beside the bounds that the schema states; keys come
and go, are nested, doubled and swapped; texts hold any of Unicode. Inputs that once failed are separate cases in
`test_extreme_input.py`; run files are mutated in `test_tampered_run_files.py`.
"""

from __future__ import annotations

import copy
import json
import math
import re
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from hpe_rig.bench import read_bench
from hpe_rig.cli.app import app
from hpe_rig.measurement import Setup, prepare, record_run
from hpe_rig.plan import PlanError, plan_text
from hpe_rig.runs import json_schema, process
from hpe_rig.scene import SettingsError, parse_toml, shipped_scenes
from hpe_rig.store import StoreError
from hpe_rig.study.cases import points_of
from hpe_rig.study.definition import read_studies

Tables = dict[str, Any]
Path_ = tuple[str | int, ...]
Rng = np.random.Generator
MESSAGES = (StoreError, SettingsError, PlanError)
LIBRARY_WORDS = re.compile(r"nable to|synchronously|\berrno\b|\bH5[A-Z]|Traceback|object at 0x")
MOST_S = 30.0

MOST_BYTES = 3 << 30
"""Beyond what the process holds already, which a small scene does not need."""

EXTREMES: Sequence[Any] = (
    *(0, -1, 1, 2, 0.0, -0.0, 1e-300, -1e-300, 1e300, -1e300, float("nan"), float("inf"), float("-inf")),
    *(2**31, 2**31 - 1, 2**63, 2**64, -(2**63), 10**30, 10**400, 1e6, 1e9, 1e-9, 0.5),
)
TEXTS: Sequence[str] = (
    *(
        "",
        " ",
        "x",
        "nan",
        "1e3",
        "\u202e\u2066",
        "\U0001f50a" * 40,
        "e\u0301",
        "\x00",
        "\x1b[2J",
        "\n",
        "a\tb",
        "%s{}",
    ),
    *("\ufeff", "\ud7ff", "x" * 5000, "../../x", "/", "C:\\x", '"""', "'", "\\", "tracking.pulse_rate_hz", "[0]"),
)


def places(tables: Any, path: Path_ = ()) -> Iterator[Path_]:
    """Yield the path of everything in ``tables``."""
    inner = tables.items() if isinstance(tables, dict) else enumerate(tables) if isinstance(tables, list) else ()
    for key, value in inner:
        yield (*path, key)
        yield from places(value, (*path, key))


def at(tables: Any, path: Path_) -> Any:
    for part in path:
        tables = tables[part]
    return tables


@cache
def known_numbers(of: str) -> Sequence[tuple[tuple[str, ...], float, float, bool]]:
    """Return path, least, most and whether it is whole, of every number that a schema knows by a fixed path."""
    schema = json_schema(of)
    prefix = ("simulation",) if of == "simulation" else ()

    def walk(node: Mapping[str, Any], path: tuple[str, ...]) -> Iterator[tuple[tuple[str, ...], float, float, bool]]:
        if "$ref" in node:
            node = schema["$defs"][node["$ref"].rpartition("/")[2]]
        for choice in node.get("anyOf", ()):
            yield from walk(choice, path)
        for name, inner in node.get("properties", {}).items():
            yield from walk(inner, (*path, name))
        if node.get("type") in ("number", "integer"):
            least = node.get("minimum", node.get("exclusiveMinimum", 0.0))
            most = node.get("maximum", node.get("exclusiveMaximum", 1e30))
            yield path, float(least), float(most), node["type"] == "integer"

    return tuple(walk(schema, prefix))


def number_within(least: float, most: float, rng: Rng) -> float:
    """Return a number from a range that may span decades, or one of its ends."""
    kind = int(rng.integers(6))
    if kind < 2:
        return (least, most)[kind]
    if least > 0:
        return float(np.clip(10 ** rng.uniform(np.log10(least), np.log10(most)), least, most))
    near = float(10 ** rng.uniform(-12, np.log10(max(abs(least), abs(most), 1e-11))))
    return float(np.clip(-near if least < 0 and kind == 2 else near, least, most))


def _plausible(tables: Tables, of: Sequence[str], rng: Rng) -> None:
    """Set a number that the schema knows, present or not, to one within its bounds."""
    known = known_numbers(of[int(rng.integers(len(of)))])
    path, least, most, whole = known[int(rng.integers(len(known)))]
    inside: Any = tables
    for part in path[:-1]:
        inside = inside.setdefault(part, {}) if isinstance(inside, dict) else {}
    if isinstance(inside, dict):
        value = number_within(least, most, rng)
        inside[path[-1]] = round(value) if whole else value


def _changed(value: Any, rng: Rng) -> Any:
    """Return ``value`` as another type, another size, or nested."""
    match int(rng.integers(12)):
        case 0 | 1:
            return EXTREMES[int(rng.integers(len(EXTREMES)))]
        case 2:
            return TEXTS[int(rng.integers(len(TEXTS)))]
        case 3 | 4 | 5 if isinstance(value, int | float) and not isinstance(value, bool):
            return value * 10.0 ** int(rng.integers(-12, 13))
        case 6 if isinstance(value, int | float) and not isinstance(value, bool):
            return float(np.nextafter(float(value), rng.choice([-np.inf, np.inf])))
        case 7:
            return [copy.deepcopy(value) for _ in range(int(rng.choice([0, 1, 2, 40])))]
        case 8:
            return {"x": copy.deepcopy(value)}
        case 9:
            return str(value)[:100] if not isinstance(value, dict | list) else not value
        case 10:
            for _ in range(int(rng.integers(1, 40))):
                value = [value] if rng.random() < 0.5 else {"y": value}
            return value
        case 11:
            return bool(rng.random() < 0.5)
    return -value if isinstance(value, int | float) else value


def mutated(tables: Tables, of: Sequence[str], rng: Rng) -> Tables:
    """Return ``tables`` with one to three changes; ``of`` names the schemas whose numbers may be set."""
    out = copy.deepcopy(tables)
    for _ in range(int(rng.integers(1, 4))):
        all_places = list(places(out))
        if not all_places:
            return out
        path = all_places[int(rng.integers(len(all_places)))]
        holder = at(out, path[:-1])
        match int(rng.integers(10)):
            case 0 | 1 | 2 | 3 if of:
                _plausible(out, of, rng)
            case 4:
                del holder[path[-1]]
            case 5:
                other = all_places[int(rng.integers(len(all_places)))]
                if other[: len(path)] != path and path[: len(other)] != other:
                    value = copy.deepcopy(at(out, other))
                    at(out, other[:-1])[other[-1]] = copy.deepcopy(holder[path[-1]])
                    holder[path[-1]] = value
            case 6:
                name = TEXTS[int(rng.integers(len(TEXTS)))]
                if isinstance(holder, dict):
                    holder[name] = copy.deepcopy(holder[path[-1]])
                else:
                    holder.append(copy.deepcopy(holder[path[-1]]))
            case _:
                holder[path[-1]] = _changed(holder[path[-1]], rng)
    return out


def toml(value: Any) -> str:
    """Return a value as inline TOML; a tenth of the time of a library that keeps comments."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{toml(str(key))} = {toml(inner)}" for key, inner in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(toml, value)) + "]"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    return str(value).lower() if isinstance(value, bool) else repr(value)


def document(tables: Tables) -> str:
    return "\n".join(f"{toml(str(key))} = {toml(value)}" for key, value in tables.items())


def text_of(tables: Tables, rng: Rng) -> str:
    """Return ``tables`` as TOML, now and then with a character or line too many, or nested beyond all measure."""
    text = document(tables)
    if rng.random() < 0.05:
        place = int(rng.integers(len(text) + 1))
        text = text[:place] + chr(int(rng.integers(1, 0x300))) + text[place + int(rng.integers(2)) :]
    if rng.random() < 0.05:
        lines = text.splitlines()
        place = int(rng.integers(len(lines))) if lines else 0
        lines[place:place] = lines[place : place + 1]
        text = "\n".join(lines)
    if rng.random() < 0.02:
        depth = int(rng.choice([15, 300, 3000]))
        text = f"deep = {'[' * depth}{']' * depth}\n{text}"
    if rng.random() < 0.02:
        text = f"long = {'0x' if rng.random() < 0.5 else ''}{'9' * int(rng.choice([400, 5000]))}\n{text}"
    return text


def outcome(call: Callable[[], object]) -> str:
    try:
        call()
    except MESSAGES as error:
        assert not LIBRARY_WORDS.search(str(error)), error  # noqa: PT017
        assert "Try:" in str(error) or "did you mean" in str(error), error  # noqa: PT017
        assert str(error).replace("\n", "").isprintable(), error  # noqa: PT017
        return "message"
    return "success"


def outcomes_of(calls: Iterator[tuple[str, Callable[[], object]]]) -> dict[str, int]:
    """Make every call; return how often each outcome came, and fail on any other, naming every case."""
    found: dict[str, int] = {"success": 0, "message": 0}
    failed: list[str] = []
    for name, call in calls:
        start_s = time.process_time()
        try:
            found[outcome(call)] += 1
        except Exception as error:
            failed.append(f"{name}: {type(error).__name__}: {error}")
        if time.process_time() - start_s > MOST_S:
            failed.append(f"{name}: a hang")
    assert not failed, f"{len(failed)} of {sum(found.values()) + len(failed)}\n" + "\n".join(failed[:20])
    return found


SMALL = {
    "table-1": {"tracking.pulse_count": 48, "acquisition.record_samples": 256},
    "bovine-muscle": {"excitation.burst_count": 4, "processing.window_start_s": 0.0},
    "cardiac-background": {},
    "gelatin-12": {"excitation.burst_count": 4},
}


@cache
def scene_tables() -> Sequence[Tables]:
    """Return shipped scenes as tables, some of them small enough to be measured in a moment."""
    shipped = {name: parse_toml(text, name) for name, text in shipped_scenes().items()}
    for name, changes in SMALL.items():
        for key, value in changes.items():
            section, _, last = key.partition(".")
            shipped[name][section][last] = value
    return [shipped[name] for name in SMALL]


@cache
def bench_tables() -> Tables:
    return parse_toml(read_bench().text, "bench")


def planned_of(folder: Path, scene: str, bench: str) -> Setup:
    """Write both files; do what every command does first."""
    (folder / "s.toml").write_text(scene, encoding="utf-8")
    (folder / "b.toml").write_text(bench, encoding="utf-8")
    setup = prepare(str(folder / "s.toml"), folder / "b.toml", refuse=False)
    assert plan_text(setup.scene.scene.title, setup.plan, setup.findings)
    return setup


@pytest.fixture(autouse=True)
def bounded_memory() -> Iterator[None]:
    """Let nothing here take much more memory than there is already, where the system can say so."""
    if not Path("/proc/self/statm").exists():
        yield
        return
    import resource

    before = resource.getrlimit(resource.RLIMIT_AS)
    used = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + MOST_BYTES, before[1]))
    yield
    resource.setrlimit(resource.RLIMIT_AS, before)


MANY = 1000
"""Cases from which on the long ones are among them."""


def takes_long(scene: str, cases: int) -> bool:
    """Return whether the push of ``scene`` takes rightly too long for so many cases: seconds, or minutes as is said."""
    harmonics = re.search(r'"propagation" = {[^}]*"harmonics" = ([0-9]+)', scene)
    return "propagation" in scene and (cases < MANY or (harmonics is not None and int(harmonics[1]) > 55))


@pytest.mark.parametrize("cases", [60, pytest.param(12_000, marks=pytest.mark.slow)])
def test_mutated_scenes_and_benches_end_in_a_plan_or_a_message(tmp_path: Path, cases: int) -> None:
    rng = np.random.default_rng(6)

    def calls() -> Iterator[tuple[str, Callable[[], object]]]:
        bench = document(bench_tables())
        for number in range(cases):
            tables = scene_tables()[number % len(SMALL)]
            if number % 4:
                texts = text_of(mutated(tables, ("scene", "simulation"), rng), rng), bench
            else:
                texts = document(tables), text_of(mutated(bench_tables(), ("bench",), rng), rng)
            if takes_long(texts[0], cases):
                continue
            yield repr(texts[number % 4 == 0][:3000]), partial(planned_of, tmp_path, *texts)

    found = outcomes_of(calls())
    assert found["success"] >= cases // 10
    assert found["message"] >= cases // 3


STUDY = """
title = "Two rates and two noises"
scene = "table-1"
scatterers = 2
common = ["f_prf"]
set = {"processing.expected_snr_db" = 20.0}
[[axes]]
name = "f_prf"
unit = "Hz"
keys = {"tracking.pulse_rate_hz" = [2000.0, 4000.0], "tracking.pulse_count" = [50, 100]}
[[axes]]
name = "snr"
keys = {"simulation.receiver.snr_db" = {start = 20.0, stop = 40.0, count = 2}}
"""


@pytest.mark.parametrize("cases", [40, pytest.param(3000, marks=pytest.mark.slow)])
def test_mutated_studies_end_in_cases_or_a_message(tmp_path: Path, cases: int) -> None:
    rng, tables, path = np.random.default_rng(8), parse_toml(STUDY, "study"), tmp_path / "study.toml"
    tables["set"] = {"simulation.scatterers.per_cell": 5.0}

    def expanded(text: str) -> None:
        path.write_text(text, encoding="utf-8")
        for name, (definition, folder) in read_studies(path).items():
            # What is large is no mistake, but takes its time.
            if math.prod(len(axis) for axis in definition.sweep_axes) <= 100:
                points_of(name, definition, folder)

    def calls() -> Iterator[tuple[str, Callable[[], object]]]:
        for _ in range(cases):
            text = text_of(mutated(tables, (), rng), rng)
            yield repr(text[:3000]), partial(expanded, text)

    found = outcomes_of(calls())
    assert found["success"] >= cases // 20
    assert found["message"] >= cases // 3


OPTIONS: Mapping[str, Sequence[str]] = {
    "check": ("--bench", "--target"),
    "process": ("--estimator",),
    "report": ("--estimator", "--shot", "--output"),
    "resume": ("--scene", "--output", "--bench"),
    "bench": ("--compare",),
    "schema": (),
    "new": ("--like",),
    "design": ("--over", "--minimise", "--bound", "--longest-s", "--target", "--seed", "--draws", "--output"),
    "study": ("--points", "--scatterers", "--noise", "--seed", "--workers", "--tls-ca"),
}


@pytest.mark.parametrize("cases", [12, pytest.param(4000, marks=pytest.mark.slow)])
def test_mutated_arguments_end_in_a_result_or_a_message(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cases: int
) -> None:
    """No argument is right here, so that nothing long is computed: what is tested is what is said."""
    monkeypatch.chdir(tmp_path)
    rng, runner = np.random.default_rng(11), CliRunner()
    words = [*TEXTS, *(repr(value) for value in EXTREMES), "no/such/file.h5", "x" * 300, "--", "-", ".", "loop"]
    (tmp_path / "loop").symlink_to("loop")
    failed = []
    for _ in range(cases):
        command = list(OPTIONS)[int(rng.integers(len(OPTIONS)))]
        arguments = [command, words[int(rng.integers(len(words)))]]
        for option in OPTIONS[command]:
            if rng.random() < 0.5:
                arguments += [option, words[int(rng.integers(len(words)))]]
        done = runner.invoke(app, arguments)
        good = done.exit_code in (0, 1, 2) and isinstance(done.exception, SystemExit | None)
        if not good or "Traceback" in done.output:
            failed.append(f"{arguments}: {done.exit_code} {done.output[-300:]} {done.exception!r}")
    assert not failed, f"{len(failed)} of {cases}\n" + "\n".join(failed[:20])


def measured(folder: Path, scene: str, bench: str) -> str:
    """Do what ``check`` and ``run`` do; what ``check`` accepts must come to a result."""
    try:
        setup = planned_of(folder, scene, bench)
    except MESSAGES:
        return "message"
    if any(finding.level == "refused" for finding in setup.findings):
        return "refused"
    path = folder / "run.h5"
    path.unlink(missing_ok=True)
    process(record_run(setup, path))
    return "result"


@pytest.mark.parametrize("cases", [3, pytest.param(1500, marks=pytest.mark.slow)])
def test_what_check_accepts_is_measured_and_estimated(tmp_path: Path, cases: int) -> None:
    rng = np.random.default_rng(7)
    found = {"message": 0, "refused": 0, "result": 0}
    failed = []
    for number in range(cases):
        tables, bench = copy.deepcopy(scene_tables()[number % 2]), copy.deepcopy(bench_tables())
        for _ in range(int(rng.integers(1, 3))):
            _plausible(tables, ("scene", "simulation"), rng)
        if number % 4 == 0:
            _plausible(bench, ("bench",), rng)
        if tables["tracking"].get("pulse_count", 0) > 10_000 or tables["acquisition"].get("repeats", 1) > 100:
            # Right, and long.
            continue
        texts = document(tables), document(bench)
        if takes_long(texts[0], cases):
            continue
        try:
            found[measured(tmp_path, *texts)] += 1
        except Exception as error:
            failed.append(f"{texts}: {type(error).__name__}: {error}")
    assert not failed, f"{len(failed)} of {cases}\n" + "\n".join(failed[:20])
    assert found["result"] >= cases // 10
