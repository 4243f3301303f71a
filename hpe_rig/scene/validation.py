"""Mistakes of a settings file, all at once: path, value, bound and a suggestion for a misspelt key."""

from __future__ import annotations

import difflib
import errno
import io
import math
import os
import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

Model = TypeVar("Model", bound=BaseModel)
KeyPath = tuple[str | int, ...]
STORED = "stored"
"""Context of settings that were measured with: which of them go together is not asked again."""


def printable(text: str) -> str:
    """Return ``text`` with everything but line ends escaped that a terminal would obey, such as names from files."""
    return "".join(c if c.isprintable() or c == "\n" else c.encode("unicode_escape").decode() for c in text)


@dataclass(frozen=True, slots=True)
class Mistake:
    """One thing wrong with a settings file: where it stands, what is wrong and what to do."""

    path: str
    what: str
    remedy: str

    def __str__(self) -> str:
        where = f"{self.path}: " if self.path else ""
        if self.remedy.startswith("did you mean"):
            return printable(f"{where}{self.what}; {self.remedy}")
        return printable(f"{where}{self.what}. Try: {self.remedy}{'' if self.remedy.endswith('?') else '.'}")


class SettingsError(Exception):
    """A settings file that cannot be used; ``mistakes`` holds all that was found."""

    def __init__(self, source: str, mistakes: Sequence[Mistake]) -> None:
        plural = "mistake" if len(mistakes) == 1 else "mistakes"
        lines = "\n".join(f"  {mistake}" for mistake in mistakes)
        super().__init__(f"{printable(source)}: {len(mistakes)} {plural}\n{lines}")
        self.source = source
        self.mistakes = tuple(mistakes)

    def __reduce__(self) -> tuple[type[SettingsError], tuple[str, tuple[Mistake, ...]]]:
        """Return how it is made again: an error comes back from another process as it left."""
        return SettingsError, (self.source, self.mistakes)


MOST_LEVELS = 20
"""Tables and lists within one another in a settings file; a scene has five."""
MOST_TEXT_BYTES = 1_000_000
"""Length of a settings file, UTF-8: as much as a run file holds of it."""


def read_settings_text(path: Path, most_bytes: int = MOST_TEXT_BYTES) -> str:
    """Return the text of the settings file ``path``.

    Raises ``OSError`` where it cannot be read or has more than ``most_bytes``, which an endless one has too, and
    ``UnicodeDecodeError`` where it is no UTF-8.
    """
    with path.open("rb") as file:
        content = file.read(most_bytes + 1)
    if len(content) > most_bytes:
        raise OSError(errno.EFBIG, f"it has more than {most_bytes} bytes, which no settings file needs", str(path))
    return io.TextIOWrapper(io.BytesIO(content), encoding="utf-8-sig").read()


_OBEYED = re.compile(r"[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f]")
"""Unicode's control characters but for line ends and tabs."""


def control_character(text: str) -> str:
    """Return the first character of ``text`` that a terminal would obey, line ends and tabs apart; "" for none."""
    found = _OBEYED.search(text)
    return found[0] if found else ""


def parse_toml(text: str, source: str, most_bytes: int = MOST_TEXT_BYTES) -> dict[str, Any]:
    """Return the tables of ``text``; raise ``SettingsError`` with line and column where it is not TOML.

    Also raised where tables are nested deeper than ``MOST_LEVELS``, a number has thousands of digits, or the text holds
    what no run file does: control characters, more than ``most_bytes``.
    """
    if mistake := _not_storable(text, most_bytes):
        raise SettingsError(source, [mistake])
    try:
        tables = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        mistake = _not_toml(text, str(error))
    except RecursionError:
        mistake = _TOO_DEEP
    except ValueError:
        # Python's own limit on what it converts to a whole number, at a place that it does not tell.
        mistake = Mistake("", "a whole number in it has thousands of digits", "a number that a setting can have")
    else:
        if tables and _levels(tables) <= MOST_LEVELS:
            return tables
        mistake = _TOO_DEEP if tables else Mistake("", "it is empty", "hpe-rig new, which writes one to start from")
    raise SettingsError(source, [mistake]) from None


def _not_storable(text: str, most_bytes: int) -> Mistake | None:
    if len(text.encode("utf-8", "surrogatepass")) > most_bytes:
        return Mistake("", f"it has more than {most_bytes} bytes", "a shorter file; comments count too")
    if found := control_character(text):
        line = text[: text.index(found)].count("\n") + 1
        what = f"line {line}: the control character U+{ord(found):04X}, which no run file holds"
        return Mistake("", what, "remove it")
    return None


def _not_toml(text: str, error: str) -> Mistake:
    """Return what is wrong where ``text`` is no TOML; ``error`` is the parser's own message, which ends with a line."""
    lines = text.splitlines()
    found = re.search(r"at line (\d+)", error)
    number = int(found[1]) if found else len(lines)
    line = lines[number - 1].strip() if 0 < number <= len(lines) else ""
    where = f"line {number}, {_shortened(line)!r}"
    if "overwrite" in error:
        return Mistake("", f"{where}: this key stands a second time in its table", "keep one of the two")
    if "twice" in error:
        return Mistake("", f"{where}: this table stands a second time", "put its keys under the first one")
    if re.search(r"=\s*-?\d+,\d", line):
        return Mistake("", f"{where}: a comma in a number", "a decimal point")
    # A backslash before the last quote takes it into the string, which then has no end.
    endless = '\\"' in line and re.search("Unterminated|Illegal", error)
    if endless or re.search("Unescaped|hex value|Escaped", error):
        what = f"{where}: between double quotes a backslash begins a special character"
        return Mistake("", what, "single quotes, as in 'C:\\scans\\push.csv', or / in place of each backslash")
    if line.count('"') % 2 or line.count("'") % 2:
        return Mistake("", f"{where}: a quotation mark is missing", "text between two quotation marks")
    what = f"{where}: not valid TOML ({error.partition(' (at ')[0]})"
    return Mistake("", what, "key = value, or [section], on that line")


_TOO_DEEP = Mistake(
    "", f"tables or lists are nested more than {MOST_LEVELS} deep", "the sections that hpe-rig schema lists"
)


def _levels(tables: Any) -> int:
    """Return how deep tables and lists are nested; without recursion, which deep ones would exhaust."""
    levels, inside = 0, [tables]
    while inside and levels <= MOST_LEVELS:
        holders = [item for item in inside if isinstance(item, dict | list)]
        inside = [inner for item in holders for inner in (item.values() if isinstance(item, dict) else item)]
        levels += bool(holders)
    return levels


def named_text(
    source: str | os.PathLike[str], shipped: Mapping[str, str], kind: str, folder: Path = Path()
) -> tuple[str, str]:
    """Return name and text of what ``source`` names: one of ``shipped``, or a file, from ``folder`` on.

    ``kind`` says in the ``SettingsError`` what it should have been, such as "scene".
    """
    if source in shipped:
        return str(source), shipped[str(source)]
    path = folder / source
    try:
        return path.stem, read_settings_text(path)
    except FileNotFoundError:
        what = f"there is no shipped {kind} and no file of that name"
        mistake = Mistake("", what, _meant(str(source), shipped, folder))
    except (OSError, ValueError) as error:
        mistake = Mistake("", f"it cannot be read ({unreadable(error)})", read_remedy(error))
    raise SettingsError(f"{kind} {source}", [mistake]) from None


def _meant(source: str, shipped: Mapping[str, str], folder: Path) -> str:
    """Return what to try in place of a name that nothing has: a file or a shipped name that is like it, or all."""
    beside = [path.name for path in folder.glob("*.toml")]
    if f"{source}.toml" in beside:
        return f"did you mean {source}.toml?"
    begins = [name for name in shipped if source and name.startswith(source)]
    # Another number is another thing, not a slip: fig-13 is not meant by fig-3.
    alike = [name for name in (*shipped, *beside) if re.findall(r"\d+", name) == re.findall(r"\d+", source)]
    close = begins[:3] or difflib.get_close_matches(source, alike, n=2, cutoff=0.7)
    return f"did you mean {' or '.join(close)}?" if close else f"a path, or one of {', '.join(shipped)}"


def unreadable(error: OSError | ValueError) -> str:
    """Return in words why a settings file cannot be read."""
    if isinstance(error, OSError):
        return str(error.strerror).lower()
    if not isinstance(error, UnicodeDecodeError):
        return "no file can have that name"
    return "it is saved as UTF-16" if _utf_16(error) else "it is no UTF-8 text"


def read_remedy(error: OSError | ValueError) -> str:
    """Return what to try where a settings file cannot be read."""
    if isinstance(error, UnicodeDecodeError):
        return "save it as UTF-8; editors ask for the encoding under Save as"
    return "another path"


def _utf_16(error: UnicodeDecodeError) -> bool:
    return bytes(error.object[:2]) in (b"\xff\xfe", b"\xfe\xff")


def mistakes_of(
    model: type[BaseModel], tables: Mapping[str, Any], prefix: KeyPath = (), context: str | None = None
) -> list[Mistake]:
    """Return all mistakes of ``tables`` as settings of ``model``; empty where there are none.

    ``context`` is what the model's own rules are told: `STORED`, or None.
    """
    try:
        model.model_validate(tables, context=context)
    except ValidationError as error:
        entries = [dict(entry) for entry in error.errors(include_url=False)]
        return [_mistake(entry, model, tables, prefix) for entry in entries if not _follows(entry)]
    return []


def validated(model: type[Model], tables: Mapping[str, Any], source: str) -> Model:
    """Return ``tables`` as settings of ``model``; raise ``SettingsError`` about ``source`` with every mistake."""
    if mistakes := mistakes_of(model, tables):
        raise SettingsError(source, mistakes)
    return model.model_validate(tables)


def _follows(entry: dict[str, Any]) -> bool:
    """Return whether a list counts as too short only because its wrong entries were left out."""
    context = entry.get("ctx", {})
    return bool(entry["type"] == "too_short" and len(entry["input"]) >= context["min_length"])


def dotted(path: KeyPath) -> str:
    """Return a TOML path in the form ``excitation.burst_length_s[2]``."""
    text = ""
    for part in path:
        text += f"[{part}]" if isinstance(part, int) else f".{_plain(part)}" if text else _plain(part)
    return text


def path_of(key: str) -> KeyPath:
    """Return the path of a key such as ``simulation.motion[0].amplitude_m``, the inverse of `dotted`."""
    return tuple(int(part) if part.isdigit() else part for part in re.findall(r"[^.\[\]]+", key))


MOST_SHOWN = 80
"""Characters of a value or key that a message shows."""


def _plain(key: str) -> str:
    """Return a key as a message may show it: what a terminal would execute, and what is endless, is replaced."""
    return _shortened(key if key.isprintable() else repr(key))


def _shown(value: Any) -> str:
    """Return a value as a message shows it."""
    if isinstance(value, int) and value.bit_length() > 3 * MOST_SHOWN:
        return f"a whole number of about {round(value.bit_length() * math.log10(2))} digits"
    try:
        return _shortened(repr(value))
    except ValueError:
        # Somewhere inside is a number that Python does not print.
        return f"a {'list' if isinstance(value, list) else 'table'} with a number of thousands of digits"


def _shortened(text: str) -> str:
    return text if len(text) <= MOST_SHOWN else f"{text[:MOST_SHOWN]}..."


def _mistake(entry: dict[str, Any], model: type[BaseModel], tables: Mapping[str, Any], prefix: KeyPath) -> Mistake:
    path = _written(entry["loc"], tables)
    if path and path[-1] == 0 and not isinstance(_value_at(tables, path[:-1]), list | tuple):
        path = path[:-1]
    what, remedy = _words(entry, path, _keys_at(model, path[:-1]), tables)
    return Mistake(dotted(prefix + path), what, remedy)


_BOUNDS = {
    "greater_than": ("gt", "above"),
    "greater_than_equal": ("ge", "at least"),
    "less_than": ("lt", "below"),
    "less_than_equal": ("le", "at most"),
}
_KINDS = {
    "float": "a number",
    "int": "a whole number",
    "bool": "true or false",
    "string": "a text in quotes",
    "tuple": "a list",
    "model": "a table",
    "dict": "a table",
}


def _words(entry: dict[str, Any], path: KeyPath, keys: Sequence[str], tables: Mapping[str, Any]) -> tuple[str, str]:
    kind, value, context = entry["type"], entry["input"], entry.get("ctx", {})
    if kind == "missing" and path and isinstance(path[-1], int):
        return "this entry of the list is absent", "give every entry; none is optional"
    if kind == "missing":
        return "this key is required and absent", "add it; hpe-rig new NAME --full writes every key with its meaning"
    if kind == "extra_forbidden":
        close = difflib.get_close_matches(str(path[-1]), keys, n=1, cutoff=0.5)
        known = f"remove it; the keys here are {', '.join(keys)}"
        return "unknown key", f"did you mean {close[0]}?" if close else known
    if kind in _BOUNDS:
        key, word = _BOUNDS[kind]
        bound = f"{word} {context[key]:g}{_unit(path)}"
        remedy = f"a value {'of ' if 'at' in word else ''}{bound}"
        meant = _perhaps_meant(path, value)
        return f"{_shown(value)} is out of bounds, it must be {bound}", f"{remedy}; {meant}" if meant else remedy
    if kind == "finite_number":
        return f"{_shown(value)} is not finite", "a finite number"
    if kind == "literal_error":
        close = difflib.get_close_matches(str(value), re.findall(r"'([^']+)'", str(context["expected"])), n=1)
        meant = f"; did you mean {close[0]!r}?" if close else ""
        return f"{_shown(value)} is not one of the choices", f"one of {context['expected']}{meant}"
    if kind in ("too_short", "too_long"):
        bound = context.get("min_length", context.get("max_length"))
        return f"{len(value)} entries where {bound} are needed", f"a list of {bound}"
    if kind == "float_type" and isinstance(value, int) and not isinstance(value, bool):
        return f"{_shown(value)} is out of all bounds", "a value as it occurs on a bench"
    expected = next((words for prefix, words in _KINDS.items() if kind.startswith(prefix)), None)
    if expected:
        return f"{_shown(value)} is not {expected}", f"{expected} without quotes" if "number" in expected else expected
    text = str(context.get("error", entry["msg"]))
    what, _, remedy = text.partition(": ")
    return what, remedy or "what hpe-rig schema says of this key"


def _perhaps_meant(path: KeyPath, value: Any) -> str:
    """Return 'perhaps 70e-3?' where a forgotten unit explains that a scene's value is out of bounds; else nothing."""
    # keys.py describes a scene and so imports this file.
    from hpe_rig.scene.keys import perhaps_meant

    meant = perhaps_meant(dotted(path), value) if isinstance(value, int | float) else ""
    return f"perhaps {meant}?" if meant else ""


_UNITS = {
    "hz": "Hz",
    "s": "s",
    "m": "m",
    "v": "V",
    "vpp": "Vpp",
    "pa": "Pa",
    "pa_s": "Pa s",
    "db": "dB",
    "rad": "rad",
    "ohm": "ohm",
    "m_per_s": "m/s",
    "kg_per_m3": "kg/m3",
    "n_per_m3": "N/m3",
    "w_per_m2": "W/m2",
    "db_per_cm_mhz": "dB/cm/MHz",
    "v_per_sqrt_hz": "V/sqrt(Hz)",
}


def unit_of(key: str) -> str:
    """Return the unit that the name of a key ends with; empty where it has none."""
    endings = sorted((ending for ending in _UNITS if key.endswith(f"_{ending}")), key=len)
    return _UNITS[endings[-1]] if endings else ""


def _unit(path: KeyPath) -> str:
    """Return the unit of the last key of ``path`` behind a space; empty where it has none."""
    unit = unit_of(next((part for part in reversed(path) if isinstance(part, str)), ""))
    return f" {unit}" if unit else ""


def _written(path: KeyPath, tables: Any) -> KeyPath:
    """Return ``path`` without the validator's own names, such as those of alternatives: what is in the file."""
    *parts, last = path or (None,)
    written: list[str | int] = []
    for part in parts:
        if isinstance(part, int):
            tables = tables[part] if isinstance(tables, list | tuple) else None
        elif isinstance(tables, Mapping) and part in tables:
            tables = tables[part]
        else:
            continue
        written.append(part)
    return (*written, *([] if last in (None, "[key]") else [last]))


def _value_at(tables: Any, path: KeyPath) -> Any:
    for part in path:
        tables = tables[part] if isinstance(tables, Mapping) and part in tables else None
    return tables


def _keys_at(model: type[BaseModel], path: KeyPath) -> list[str]:
    """Return the keys of the section at ``path``, following sub-models through options, lists and tuples."""
    for part in path:
        if isinstance(part, str) and part in model.model_fields:
            model = next(models_in(model.model_fields[part].annotation), model)
    return list(model.model_fields)


def models_in(annotation: Any) -> Iterator[type[BaseModel]]:
    """Yield every model in ``annotation``, through options, lists and tuples."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for inner in getattr(annotation, "__args__", ()):
        yield from models_in(inner)


SMALLEST_M, LARGEST_M = 1e-15, 1e-3
"""A larger uncertainty is a forgotten unit, a smaller one than a nucleus a slipped exponent."""
_UNITS_M = {"nm": 1e-9, "um": 1e-6, "mm": 1e-3, "m": 1.0}


def length_m(text: str, key: str, largest_m: float = LARGEST_M) -> float:
    """Return a length from 1 fm to ``largest_m``, 1 mm, such as "20nm" or "2e-8".

    Raises ``SettingsError`` naming ``key`` for others.
    """
    match = re.fullmatch(r"\s*([0-9.eE+-]+)\s*(nm|um|mm|m)?\s*", text)
    try:
        value = float(match[1]) * _UNITS_M[match[2] or "m"] if match else math.nan
    except ValueError:
        value = math.nan
    if not SMALLEST_M <= value <= largest_m:
        what = f"{text!r} is no length from 1 fm to {largest_m * 1e3:g} mm"
        raise SettingsError("command line", [Mistake(key, what, "a number with unit, such as 20nm")])
    return value
