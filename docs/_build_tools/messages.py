"""Error messages that users meet first, each provoked in an empty folder: printed as a page in Markdown.

Without an option those of this version, as the reference shows them.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import os
import re
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

SCENE = """title = "Try"
[excitation]
burst_rate_hz = 100.0
burst_length_s = 100e-6
burst_count = 20
[tracking]
pulse_rate_hz = 3990.0
disturbed = "skip"
[acquisition]
gate_depth_m = 70e-3
"""
BEFORE = Path(__file__).parents[2] / "docs" / "reference" / "messages-before.json"
"""What `--of` printed of the version before messages were reviewed."""
PATIENCE_S = 60.0
"""How long a process may take to answer; a mistake is answered in two seconds."""
MOST_LINES = 14
"""Lines of an answer that a page shows."""
BESIDE = """# Error messages, before and after

What is answered to the {mistakes} mistakes of [error messages](messages.md): *before* by version b37b133 of 22 November
2026, 05:46 (`python docs/_build_tools/messages.py --of FOLDER`, its packages in FOLDER), *after* by this one while the page was
written. {changed} answers changed. Before, {refused} of the mistakes were refused with exit code 2; now {now} are.
"""
Answer = tuple[int | None, str]
"""Exit code, ``None`` where no answer came, and what was said."""


@dataclass(frozen=True)
class Case:
    """One mistake: what is typed, in a folder with ``files``, and why it is one."""

    typed: str
    cause: str
    files: dict[str, str | bytes] = field(default_factory=dict)


def scene(old: str = "", new: str = "") -> dict[str, str | bytes]:
    """Return ``s.toml``, a scene that runs, with one place changed."""
    return {"s.toml": SCENE.replace(old, new) if old else SCENE}


def bench(old: str, new: str) -> dict[str, str | bytes]:
    """Return ``b.toml``, the simulated bench with one place changed."""
    from hpe_rig.bench import read_bench

    return {"b.toml": read_bench().text.replace(old, new, 1)}


AUX, MASTER = 'source = "digitizer.aux"', 'source = "master.output"'
NO_HDF5: dict[str, str | bytes] = {"run.h5": b"mine"}
CUT: dict[str, str | bytes] = {"run.h5": b"\x89HDF\r\n\x1a\n"}


def check(cause: str, files: dict[str, str | bytes]) -> Case:
    """Return the mistake that the scene in ``files`` is."""
    return Case("hpe-rig check s.toml", cause, files)


def cases() -> dict[str, list[Case]]:
    """Return the mistakes by subject."""
    return {
        "What is typed": [
            Case("hpe-rig chekc bovine-muscle", "a command's name is misspelt"),
            Case("hpe-rig run bovine-muscel", "a shipped scene's name is misspelt"),
            Case("hpe-rig run s", "the ending of a file's name is left out", scene()),
            Case("hpe-rig run no-such.toml", "the file is in another folder"),
            Case("hpe-rig run", "no scene is named"),
            Case("hpe-rig run bovine-muscle --estimator kasia", "an estimator's name is misspelt"),
            Case("hpe-rig run bovine-muscle --verbos", "an option's name is misspelt"),
            Case('hpe-rig run bovine-muscle --output ""', "an empty variable in a script"),
            Case("hpe-rig run bovine-muscle --output no-folder/run.h5", "the folder of the run file does not exist"),
            Case("hpe-rig run bovine-muscle --output run.h5", "a run of that name is there", NO_HDF5),
            Case("hpe-rig check bovine-muscle --target 20", "a length without unit is one in metres"),
            Case("hpe-rig new s", "a file of that name is there", scene()),
            Case("hpe-rig new mine --like bovine", "a shipped scene's name is cut short"),
            Case("hpe-rig schema scenes", "a schema's name is misspelt"),
            Case("hpe-rig study fig-3", "the paper's figure 3 is no study"),
            Case("hpe-rig study fig-7 --workers 0", "a study needs a process"),
            Case("hpe-rig emulate --transport usb", "the transport is none of the five"),
        ],
        "Scenes": [
            check("a key is misspelt", scene("burst_count", "burst_cout")),
            check("a section is misspelt", scene("[excitation]", "[exitation]")),
            check("a unit is forgotten: microseconds", scene("100e-6", "100")),
            check("a number stands in quotes", scene("3990.0", '"3990"')),
            check("a required key is absent", scene("gate_depth_m = 70e-3\n", "")),
            check("a choice is misspelt", scene('"skip"', '"skipp"')),
            check("a key stands twice", scene("burst_count = 20", "burst_count = 20\nburst_count = 30")),
            check("a table stands twice", scene("[acquisition]", "[tracking]\n[acquisition]")),
            check("a quotation mark is missing", scene('"Try"', '"Try')),
            check("a comma for a point", scene("3990.0", "3990,0")),
            check("saved as UTF-16, as Windows' Notepad can", {"s.toml": SCENE.encode("utf-16")}),
            check("the file is empty", {"s.toml": ""}),
            Case("hpe-rig check b.toml", "a bench file is given as the scene", bench("", "")),
            Case("hpe-rig run s.toml", "pulses meet tonebursts", scene('"skip"', '"refuse"')),
            Case("hpe-rig run s.toml", "pulses come faster than echoes return", scene("3990.0", "39900.0")),
        ],
        "Benches": [
            Case("hpe-rig run s.toml --bench s.toml", "a scene is given as the bench", scene()),
            Case("hpe-rig run bovine-muscle --bench bench.toml", "the bench file is in another folder"),
            Case("hpe-rig bench b.toml", "a real bench without addresses", bench("= true", "= false")),
            Case(
                "hpe-rig bench b.toml",
                "a cable is missing",
                bench(AUX, MASTER),
            ),
            Case("hpe-rig bench run.h5", "a run file is no bench", NO_HDF5),
        ],
        "Run files": [
            Case("hpe-rig report nofile.h5", "the run file is in another folder"),
            Case("hpe-rig report s.toml", "a scene is given as the run file", scene()),
            Case("hpe-rig live nofile.h5", "the run has another name"),
            Case(
                "hpe-rig process run.h5", "the file is no run file, or was cut short", {"run.h5": b"\x89HDF\r\n\x1a\n"}
            ),
        ],
    }


def provoked(answer: Callable[[str], Answer] | None = None) -> Iterator[tuple[str, Case, int | None, str]]:
    """Yield subject, mistake, exit code and message of every case, each in a folder of its own.

    ``answer`` runs what is typed: by default this version, in this process.
    """
    for subject, mistakes in cases().items():
        for case in mistakes:
            with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
                for name, content in case.files.items():
                    Path(name).write_bytes(content.encode() if isinstance(content, str) else content)
                code, said = (answer or _said)(case.typed)
                # Where a temporary folder stands says nothing.
                yield subject, case, code, re.sub(re.escape(os.fspath(Path.cwd())) + r"[/\\]?", "", said).strip()


@cache
def answered() -> tuple[tuple[str, Case, int | None, str], ...]:
    """Return what `provoked` yields of this version, found once for both pages."""
    return tuple(provoked())


def _said(typed: str) -> Answer:
    from typer.testing import CliRunner

    from hpe_rig.cli import commands

    with contextlib.redirect_stderr(io.StringIO()):
        done = CliRunner().invoke(commands, shlex.split(typed)[1:], prog_name="hpe-rig", env={"COLUMNS": "110"})
    return done.exit_code, done.stderr or done.stdout


def said_by(folder: Path, typed: str) -> Answer:
    """Return what the version whose packages are in ``folder`` answers, run as a process."""
    environment = {**os.environ, "PYTHONPATH": os.fspath(folder), "COLUMNS": "110", "PYTHONIOENCODING": "utf-8"}
    command = [sys.executable, "-m", "hpe_rig", *shlex.split(typed)[1:]]
    try:
        done = subprocess.run(
            command, env=environment, capture_output=True, stdin=subprocess.DEVNULL, timeout=PATIENCE_S
        )
    except subprocess.TimeoutExpired:
        return None, f"(no answer within {PATIENCE_S:g} s)"
    said = (done.stderr or done.stdout).decode().replace("python -m hpe_rig", "hpe-rig")
    return done.returncode, re.sub(r"[^\s(]*[/\\](hpe-rig-)\w+\.txt", r"\1....txt", said)


def as_json(folder: Path) -> str:
    """Return the answers of the version in ``folder``, exit code and message by cause."""
    found = provoked(lambda typed: said_by(folder, typed))
    return json.dumps({case.cause: [code, said] for _, case, code, said in found}, indent=1, ensure_ascii=False)


def beside() -> str:
    """Return the page of what was answered before beside what is answered now."""
    before: dict[str, Answer] = {
        cause: (code, said) for cause, (code, said) in json.loads(BEFORE.read_text("utf-8")).items()
    }
    found = answered()
    changed = [case for _, case, code, said in found if before[case.cause] != (code, said)]
    refused = sum(code == 2 for code, _ in before.values())
    now = sum(code == 2 for _, _, code, _ in found)
    lines = [BESIDE.format(mistakes=len(found), changed=len(changed), refused=refused, now=now)]
    for _, case, code, said in found:
        was = before[case.cause]
        lines += [f"## {case.cause[:1].upper()}{case.cause[1:]}", "", f"`{case.typed}`", ""]
        lines += [] if was == (code, said) else [f"Before ({_ended(was[0])}):", "", *_shown(was[1]), ""]
        lines += [f"{'As before' if was == (code, said) else 'After'} ({_ended(code)}):", "", *_shown(said), ""]
    return "\n".join(lines)


def _ended(code: int | None) -> str:
    return "waits" if code is None else f"exit code {code}"


def _shown(said: str) -> list[str]:
    lines = said.splitlines()
    more = [f"({len(lines) - MOST_LINES} lines more)"] if len(lines) > MOST_LINES else []
    return ["```text", *lines[:MOST_LINES], *more, "```"]


def markdown() -> str:
    """Return the page: what is typed, why it is a mistake, and what the program answers."""
    lines = [
        "# Error messages",
        "",
        "What users meet first: what is typed, the cause, and the answer, provoked while this ",
    ]
    lines += ["page was written. Every mistake of a file is named at once, with its key and what to try; nothing is "]
    lines += ["opened, switched on or written before all of them are mended. Symptoms of a *bench* stand under "]
    lines += ["[troubleshooting](../../how-to/troubleshooting.md).", ""]
    last = ""
    for subject, case, code, said in answered():
        lines += [] if subject == last else [f"## {subject}", ""]
        last = subject
        lines += [f"**{case.cause[:1].upper()}{case.cause[1:]}** (exit code {code})", "", "```text"]
        lines += [f"$ {case.typed}", *said.splitlines(), "```", ""]
    return "\n".join(lines)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    wanted = parser.add_mutually_exclusive_group()
    wanted.add_argument("--beside", action="store_true", help="beside those of the earlier version in docs/reference")
    wanted.add_argument(
        "--of", type=Path, metavar="FOLDER", help="of the version in FOLDER, in JSON, each by a process of its own"
    )
    given = parser.parse_args()
    print(as_json(given.of.resolve()) if given.of else beside() if given.beside else markdown())
