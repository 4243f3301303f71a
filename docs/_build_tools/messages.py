"""Frequent error messages, each provoked in an empty folder: printed as a page in Markdown."""

from __future__ import annotations

import argparse
import contextlib
import io
import os
import re
import shlex
import tempfile
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


@dataclass(frozen=True)
class Case:
    """One mistake: the command typed in a folder with ``files``, and its cause."""

    typed: str
    cause: str
    files: dict[str, str | bytes] = field(default_factory=dict)


def scene(old: str = "", new: str = "") -> dict[str, str | bytes]:
    """Return ``s.toml``, a valid scene with ``old`` replaced by ``new``."""
    return {"s.toml": SCENE.replace(old, new) if old else SCENE}


def bench(old: str, new: str) -> dict[str, str | bytes]:
    """Return ``b.toml``, the simulated bench with ``old`` replaced by ``new``."""
    from hpe_rig.bench import read_bench

    return {"b.toml": read_bench().text.replace(old, new, 1)}


AUX, MASTER = 'source = "digitizer.aux"', 'source = "master.output"'
NOT_HDF5: dict[str, str | bytes] = {"run.h5": b"mine"}
TRUNCATED: dict[str, str | bytes] = {"run.h5": b"\x89HDF\r\n\x1a\n"}


def check(cause: str, files: dict[str, str | bytes]) -> Case:
    """Return the mistake of checking the scene in ``files``."""
    return Case("hpe-rig check s.toml", cause, files)


def cases() -> dict[str, list[Case]]:
    """Return the mistakes by subject."""
    return {
        "Command line": [
            Case("hpe-rig chekc bovine-muscle", "a command's name is misspelt"),
            Case("hpe-rig run bovine-muscel", "a shipped scene's name is misspelt"),
            Case("hpe-rig run s", "the ending of a file name is missing", scene()),
            Case("hpe-rig run no-such.toml", "the file is in another folder"),
            Case("hpe-rig run", "no scene is named"),
            Case("hpe-rig run bovine-muscle --estimator kasia", "an estimator's name is misspelt"),
            Case("hpe-rig run bovine-muscle --verbos", "an option's name is misspelt"),
            Case('hpe-rig run bovine-muscle --output ""', "an empty variable in a script"),
            Case("hpe-rig run bovine-muscle --output no-folder/run.h5", "the folder of the run file does not exist"),
            Case("hpe-rig run bovine-muscle --output run.h5", "a run file of that name exists", NOT_HDF5),
            Case("hpe-rig check bovine-muscle --target 20", "a length without unit is in metres"),
            Case("hpe-rig new s", "a file of that name exists", scene()),
            Case("hpe-rig new mine --like bovine", "the name of a shipped scene is incomplete"),
            Case("hpe-rig schema scenes", "a schema's name is misspelt"),
            Case("hpe-rig study fig-3", "figure 3 of the paper is not a study"),
            Case("hpe-rig study fig-7 --workers 0", "a study needs a process"),
            Case("hpe-rig emulate --transport usb", "the transport is unknown"),
        ],
        "Scenes": [
            check("a key is misspelt", scene("burst_count", "burst_cout")),
            check("a section is misspelt", scene("[excitation]", "[exitation]")),
            check("a unit is forgotten: microseconds", scene("100e-6", "100")),
            check("a number is in quotes", scene("3990.0", '"3990"')),
            check("a required key is missing", scene("gate_depth_m = 70e-3\n", "")),
            check("a choice is misspelt", scene('"skip"', '"skipp"')),
            check("a key is given twice", scene("burst_count = 20", "burst_count = 20\nburst_count = 30")),
            check("a table is given twice", scene("[acquisition]", "[tracking]\n[acquisition]")),
            check("a quotation mark is missing", scene('"Try"', '"Try')),
            check("a comma for a point", scene("3990.0", "3990,0")),
            check("saved as UTF-16, as Windows' Notepad can", {"s.toml": SCENE.encode("utf-16")}),
            check("the file is empty", {"s.toml": ""}),
            Case("hpe-rig check b.toml", "a bench file is given as the scene", bench("", "")),
            Case("hpe-rig run s.toml", "pulses coincide with tonebursts", scene('"skip"', '"refuse"')),
            Case("hpe-rig run s.toml", "pulses come faster than echoes return", scene("3990.0", "39900.0")),
        ],
        "Benches": [
            Case("hpe-rig run s.toml --bench s.toml", "a scene is given as the bench", scene()),
            Case("hpe-rig run bovine-muscle --bench bench.toml", "the bench file is in another folder"),
            Case("hpe-rig bench b.toml", "a real bench without addresses", bench("= true", "= false")),
            Case("hpe-rig bench b.toml", "a cable is missing", bench(AUX, MASTER)),
            Case("hpe-rig bench run.h5", "a run file is given as the bench", NOT_HDF5),
        ],
        "Run files": [
            Case("hpe-rig report nofile.h5", "the run file is in another folder"),
            Case("hpe-rig report s.toml", "a scene is given as the run file", scene()),
            Case("hpe-rig live nofile.h5", "the run has another name"),
            Case("hpe-rig process run.h5", "the file is not a run file, or is truncated", TRUNCATED),
        ],
    }


@cache
def provoked() -> tuple[tuple[str, Case, int, str], ...]:
    """Return subject, mistake, exit code and message of every case, each run in an empty folder."""
    answers = []
    for subject, mistakes in cases().items():
        for case in mistakes:
            with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
                for name, content in case.files.items():
                    Path(name).write_bytes(content.encode() if isinstance(content, str) else content)
                code, message = _run(case.typed)
                # The path of the temporary folder differs from run to run.
                message = re.sub(re.escape(os.fspath(Path.cwd())) + r"[/\\]?", "", message).strip()
            answers.append((subject, case, code, message))
    return tuple(answers)


def _run(typed: str) -> tuple[int, str]:
    """Run a command in this process; return its exit code and message."""
    from typer.testing import CliRunner

    from hpe_rig.cli import commands

    with contextlib.redirect_stderr(io.StringIO()):
        done = CliRunner().invoke(commands, shlex.split(typed)[1:], prog_name="hpe-rig", env={"COLUMNS": "110"})
    return done.exit_code, done.stderr or done.stdout


def markdown() -> str:
    """Return the page: each command with its mistake and the answer of the program."""
    lines = [
        "# Error messages",
        "",
        "Frequent mistakes, each with the message of this version. All mistakes of a file are reported together.",
        "Each names the key, the likely cause and a remedy. Nothing is opened, switched on or written before they are",
        "corrected. For symptoms of a bench see [troubleshooting](../../how-to/troubleshooting.md).",
        "",
    ]
    previous = ""
    for subject, case, code, message in provoked():
        lines += [] if subject == previous else [f"## {subject}", ""]
        previous = subject
        lines += [f"**{case.cause[:1].upper()}{case.cause[1:]}** (exit code {code})", "", "```text"]
        lines += [f"$ {case.typed}", *message.splitlines(), "```", ""]
    return "\n".join(lines)


if __name__ == "__main__":
    argparse.ArgumentParser(description=__doc__).parse_args()
    print(markdown())
