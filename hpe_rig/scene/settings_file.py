"""Settings files: reading their text and parsing their TOML, every failure with its cause and what to try."""

from __future__ import annotations

import difflib
import errno
import io
import os
import re
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from hpe_rig.scene.mistakes import Mistake, SettingsError, control_character, shortened

MAX_TEXT_BYTES = 1_000_000
"""Length of a settings file in UTF-8; a run file stores no longer text."""
MAX_LEVELS = 20
"""Depth of nested tables and lists in a settings file; a scene has five levels."""
_TOO_DEEP = Mistake(
    "", f"tables or lists are nested more than {MAX_LEVELS} deep", "the sections that hpe-rig schema lists"
)


def read_settings_text(path: Path, max_bytes: int = MAX_TEXT_BYTES) -> str:
    """Return the text of the settings file ``path``.

    Raises ``OSError`` if it cannot be read or exceeds ``max_bytes`` (a device may never end), ``UnicodeDecodeError`` if
    it is not UTF-8.
    """
    with path.open("rb") as file:
        content = file.read(max_bytes + 1)
    if len(content) > max_bytes:
        raise OSError(errno.EFBIG, f"it has more than {max_bytes} bytes, which no settings file needs", str(path))
    return io.TextIOWrapper(io.BytesIO(content), encoding="utf-8-sig").read()


def parse_toml(text: str, source: str, max_bytes: int = MAX_TEXT_BYTES) -> dict[str, Any]:
    """Return the tables of ``text``; raise ``SettingsError`` with the line if it is not TOML.

    Also raised for tables nested deeper than ``MAX_LEVELS``, for numbers with thousands of digits, and for text that a
    run file cannot store: control characters, or more than ``max_bytes``.
    """
    if mistake := _not_storable(text, max_bytes):
        raise SettingsError(source, [mistake])
    try:
        tables = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        mistake = _not_toml(text, str(error))
    except RecursionError:
        mistake = _TOO_DEEP
    except ValueError:
        # Python limits the digits that it converts to a whole number, and does not say where they are.
        mistake = Mistake("", "a whole number in it has thousands of digits", "a number within a setting's bounds")
    else:
        if tables and _levels(tables) <= MAX_LEVELS:
            return tables
        mistake = _TOO_DEEP if tables else Mistake("", "it is empty", "hpe-rig new, which writes one to start from")
    raise SettingsError(source, [mistake]) from None


def _not_storable(text: str, max_bytes: int) -> Mistake | None:
    if len(text.encode("utf-8", "surrogatepass")) > max_bytes:
        return Mistake("", f"it has more than {max_bytes} bytes", "a shorter file; comments count too")
    if character := control_character(text):
        line = text[: text.index(character)].count("\n") + 1
        what = f"line {line}: the control character U+{ord(character):04X}, which a run file cannot store"
        return Mistake("", what, "remove it")
    return None


def _not_toml(text: str, error: str) -> Mistake:
    """Return the likely mistake in a ``text`` that is not TOML; ``error`` is the parser's message, with a line."""
    lines = text.splitlines()
    match = re.search(r"at line (\d+)", error)
    number = int(match[1]) if match else len(lines)
    line = lines[number - 1].strip() if 0 < number <= len(lines) else ""
    where = f"line {number}, {shortened(line)!r}"
    # The parser's message comes first, then the usual mistakes in the line that it names.
    if "overwrite" in error:
        return Mistake("", f"{where}: this key occurs twice in its table", "keep one of the two")
    if "twice" in error:
        return Mistake("", f"{where}: this table occurs twice", "put its keys under the first one")
    if re.search(r"=\s*-?\d+,\d", line):
        return Mistake("", f"{where}: a comma in a number", "a decimal point")
    # A backslash before the closing quote makes that quote part of the string, which then has no end.
    escaped_quote = '\\"' in line and re.search("Unterminated|Illegal", error)
    if escaped_quote or re.search("Unescaped|hex value|Escaped", error):
        what = f"{where}: between double quotes a backslash begins a special character"
        return Mistake("", what, "single quotes, as in 'C:\\scans\\push.csv', or / in place of each backslash")
    if line.count('"') % 2 or line.count("'") % 2:
        return Mistake("", f"{where}: a quotation mark is missing", "text between two quotation marks")
    what = f"{where}: not valid TOML ({error.partition(' (at ')[0]})"
    return Mistake("", what, "key = value, or [section], on that line")


def _levels(tables: Any) -> int:
    """Return the nesting depth of tables and lists, at most ``MAX_LEVELS`` + 1; without recursion, which could fail."""
    levels, items = 0, [tables]
    while items and levels <= MAX_LEVELS:
        containers = [item for item in items if isinstance(item, dict | list)]
        items = [inner for item in containers for inner in (item.values() if isinstance(item, dict) else item)]
        levels += bool(containers)
    return levels


def named_text(
    source: str | os.PathLike[str], shipped: Mapping[str, str], kind: str, folder: Path = Path()
) -> tuple[str, str]:
    """Return name and text of ``source``: a name among ``shipped`` texts, or a file's path relative to ``folder``.

    ``kind`` names the expected file in the ``SettingsError``, such as "scene".
    """
    if source in shipped:
        return str(source), shipped[str(source)]
    path = folder / source
    try:
        return path.stem, read_settings_text(path)
    except FileNotFoundError:
        what = f"there is no shipped {kind} and no file of that name"
        mistake = Mistake("", what, _similar_names(str(source), shipped, folder))
    except (OSError, ValueError) as error:
        mistake = unreadable(error)
    raise SettingsError(f"{kind} {source}", [mistake]) from None


def _similar_names(source: str, shipped: Mapping[str, str], folder: Path) -> str:
    """Return the remedy for a name that does not exist: similar files or shipped names, or all shipped names."""
    files = [path.name for path in folder.glob("*.toml")]
    if f"{source}.toml" in files:
        return f"did you mean {source}.toml?"
    # A name typed in part suggests all that begin with it.
    begins = [name for name in shipped if source and name.startswith(source)]
    # A different number is another figure and no typing error: fig-3 does not suggest fig-13.
    same_digits = [name for name in (*shipped, *files) if re.findall(r"\d+", name) == re.findall(r"\d+", source)]
    close = begins[:3] or difflib.get_close_matches(source, same_digits, n=2, cutoff=0.7)
    return f"did you mean {' or '.join(close)}?" if close else f"a path, or one of {', '.join(shipped)}"


def unreadable(error: OSError | ValueError) -> Mistake:
    """Return the mistake of a settings file that cannot be read because of ``error``."""
    remedy = "another path"
    if isinstance(error, UnicodeDecodeError):
        utf_16 = bytes(error.object[:2]) in (b"\xff\xfe", b"\xfe\xff")
        cause = "it is saved as UTF-16" if utf_16 else "it is no UTF-8 text"
        remedy = "save it as UTF-8; editors ask for the encoding under Save as"
    elif isinstance(error, OSError):
        cause = str(error.strerror).lower()
    else:
        cause = "no file can have that name"
    return Mistake("", f"it cannot be read ({cause})", remedy)


def parse_settings(texts: Sequence[str]) -> dict[str, Any]:
    """Return the settings in texts KEY=VALUE; a value that is not valid TOML is a string.

    Raises ``SettingsError`` with every text that is no setting and every key that occurs twice.
    """
    options: dict[str, Any] = {}
    mistakes = []
    for text in texts:
        key, equals, value = map(str.strip, text.partition("="))
        if not key or not equals:
            mistakes.append(Mistake(text, "this is no setting", "KEY=VALUE, such as tracking.pulse_rate_hz=3990.0"))
        elif key in options:
            mistakes.append(Mistake(key, "this key is given twice", "one of the two values"))
        else:
            try:
                options[key] = tomllib.loads(f"value = {value}")["value"]
            except (tomllib.TOMLDecodeError, ValueError):
                options[key] = value
    if mistakes:
        raise SettingsError("--set", mistakes)
    return options
