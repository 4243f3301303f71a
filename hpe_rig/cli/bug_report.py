"""Report of a problem: versions, and scenes, bench files and logs without addresses, serial numbers and names."""

from __future__ import annotations

import getpass
import platform
import re
import socket
from collections.abc import Iterable, Iterator
from contextlib import suppress
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer

from hpe_rig.cli.console import announce, guarded
from hpe_rig.cli.options import output_option

REMOVED: Final = "REMOVED"
RUN_SUFFIXES: Final = (".h5", ".hdf5")
TEXT_SUFFIXES: Final = (".toml", ".log", ".txt", ".json")
MAX_LOG_LINES: Final = 400
MAX_TEXT_BYTES: Final = 1_000_000
MIN_NAME: Final = 2
"""Shorter names of users and hosts are also parts of ordinary words, and stay."""

_NAMED_VALUE = re.compile(
    r"""(?imx) ^
      (\s* [\w."]*? (?:serial|who|operator|user|host|address|adapter|interface|command|label|email) "? \s* [=:])
      .* $"""
)
"""A line of TOML, JSON or a log that gives a key of this kind a value."""
_CALIBRATION_SOURCE = re.compile(r"(?m)^(\[calibration\][^\[]*?^source\s*=).*$")
_ADDRESSES = re.compile(
    r"""(?ix)
      \b (?:PRLGX-)? (?:TCPIP|GPIB|USB|ASRL|VXI|PXI) \d* (?:/[^\s"':]*|\w*)? :: [^\s"',;]+   # VISA resource names
    | \b \d{1,3} (?:\.\d{1,3}){3} \b                                                         # IPv4
    | \b (?:[0-9a-f]{1,4}:){4,} [0-9a-f:]+ \b                                                # IPv6
    | \b (?:[0-9a-f]{2}[:-]){5} [0-9a-f]{2} \b                                               # hardware addresses
    | \b [A-Z]{2} \d{6,} \b                                                                    # serial numbers
    | \b [\w.+-]+ @ [\w-]+ (?:\.[\w-]+)+ \b                                                  # mail
    """
)
_NOTES = re.compile(r"(?ms)^(\[notes\]\s*\n).*?(?=^\[|\Z)")

if TYPE_CHECKING:
    from hpe_rig.scene import Mistake

reporting = typer.Typer()


@reporting.command("bug-report")
@guarded
def bug_report(
    files: Annotated[
        list[Path] | None,
        typer.Argument(metavar="FILE ...", help="Run files, scenes, bench files and logs that belong to the problem."),
    ] = None,
    output: Annotated[
        Path,
        output_option("Text file; an existing one is not replaced."),
    ] = Path("bug-report.txt"),
) -> None:
    """Collect versions, scene, bench and log of a problem in one text file, without addresses and names."""
    from hpe_rig.scene import SettingsError
    from hpe_rig.store import write_file

    if mistakes := list(_mistakes(files or ())):
        raise SettingsError("bug-report", mistakes)
    sections = [("versions", _versions()), *((path.name, anonymous(_content(path))) for path in files or ())]
    text = "\n".join(f"==== {title} ====\n{content.rstrip()}\n" for title, content in sections)
    write_file(output, text, overwrite=False)
    announce(f"{output}: read it before you send it; it holds no echoes, addresses, serial numbers, notes or names")


def _mistakes(files: Iterable[Path]) -> Iterator[Mistake]:
    """Yield the files that do not exist or may hold echoes, such as recordings of other programs."""
    from hpe_rig.scene import Mistake

    for path in files:
        if not path.is_file():
            yield Mistake(str(path), "there is no such file", "run files, scenes, bench files, logs")
        elif path.suffix.lower() not in {*RUN_SUFFIXES, *TEXT_SUFFIXES}:
            what = "only run files, settings and logs are collected, without echoes"
            yield Mistake(str(path), what, f"a file that ends in {', '.join((*RUN_SUFFIXES, *TEXT_SUFFIXES))}")


def anonymous(text: str) -> str:
    """Return ``text`` without network and instrument addresses, serial numbers, notes, and names of user and host."""
    text = _NOTES.sub(rf"\g<1>{REMOVED}\n\n", text)
    text = _CALIBRATION_SOURCE.sub(rf"\g<1> {REMOVED}", text)
    text = _ADDRESSES.sub(REMOVED, _NAMED_VALUE.sub(rf"\g<1> {REMOVED}", text))
    for name in sorted(_names(), key=len, reverse=True):
        text = re.sub(rf"(?<!\w){re.escape(name)}(?!\w)", REMOVED, text, flags=re.IGNORECASE)
    return text


def _names() -> Iterator[str]:
    """Yield home folder, user and host, as they may occur in paths and messages."""
    with suppress(OSError, KeyError, ImportError, RuntimeError):
        yield str(Path.home())
        names = [getpass.getuser(), Path.home().name, socket.gethostname(), socket.gethostname().partition(".")[0]]
        yield from (name for name in names if len(name) >= MIN_NAME)


def _versions() -> str:
    from hpe_rig.store import versions

    required = {re.split(r"[^\w-]", text)[0] for text in metadata.requires("hpe-rig") or ()}
    lines = [f"{name} {version}" for name, version in versions().items()]
    lines.append(f"system {platform.system()} {platform.release()} {platform.machine()}")
    for name in sorted(required):
        with suppress(metadata.PackageNotFoundError):
            lines.append(f"{name} {metadata.version(name)}")
    return "\n".join(lines)


def _content(path: Path) -> str:
    """Return what ``path`` contributes: texts of a run file and the end of its log, or the text itself."""
    from hpe_rig.store import StoreError, read_run, reason

    if path.suffix.lower() not in RUN_SUFFIXES:
        try:
            return _end_of(path)
        except OSError as error:
            return f"cannot be read: {reason(error)}"
    try:
        run = read_run(path)
    except StoreError as error:
        return f"cannot be read: {error}"
    parts = [
        f"status: {run.status}, simulated: {run.simulated}, shots complete: {int(run.shot_complete.sum())}",
        *(f"damage: {text}" for text in run.damage),
        *(f"shot {shot + 1} untrusted: {text}" for shot, text in run.untrusted.items()),
        run.scene_toml,
        run.bench_toml,
    ]
    log = path.with_suffix(".log")
    return "\n".join([*parts, f"-- {log.name}", _end_of(log)] if log.is_file() else parts)


def _end_of(path: Path) -> str:
    """Return the last lines of a text file; bytes that are no UTF-8 text are replaced."""
    with path.open("rb") as file:
        file.seek(max(0, path.stat().st_size - MAX_TEXT_BYTES))
        return "\n".join(file.read(MAX_TEXT_BYTES).decode("utf-8", "replace").splitlines()[-MAX_LOG_LINES:])
