"""Text files: tables of any program and exports of oscilloscopes.

Encoding, delimiter, decimal sign and header are detected where the text determines them. A first column or row that is
linear holds times or an index, and is never a pulse. Every inference is reported.
"""

from __future__ import annotations

import codecs
import itertools
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from hpe_rig.recordings.contents import Contents
from hpe_rig.recordings.coordinates import MIN_LENGTH, Coordinate, align_records, find_coordinate
from hpe_rig.recordings.names import TIME_UNITS, VOLT_UNITS, setting_of
from hpe_rig.recordings.settings import Dimension, RecordingSettings

BYTE_ORDER_MARKS = ((codecs.BOM_UTF8, "utf-8-sig"), (codecs.BOM_UTF16_LE, "utf-16"), (codecs.BOM_UTF16_BE, "utf-16"))
DELIMITERS: Mapping[str, str | None] = {"tab": "\t", "semicolon": ";", "comma": ",", "blank": None}
"""Delimiters by their words, in the order of precedence: in a text with tabs, commas belong to numbers."""
SAMPLED_LINES = 20
"""Number of lines that determine delimiter and decimal sign."""
MIN_PULSES = 4
"""Columns below which each is a channel: fewer pulses do not determine a vibration."""
MIN_SAMPLE_RATE_HZ = 1e5
"""Rate of a time column above which rows are samples; below, they are pulses."""
MIN_ASCENDING = 0.9
"""Part of the steps of a first column that ascend if it holds times, some of them spoilt."""
SETTING = re.compile(
    r"([A-Za-z][\w .()/-]{0,60}?)[\"']?\s{0,20}[=:,;\t ]\s{0,20}[\"']?([-+]?\d[\d.eE+-]*)[ \"']*([A-Za-zµμ/]*)"
)
"""Name, number and unit in a header, such as "PRF: 4 kHz" or "Sample Interval,4e-08,s".

Names and gaps of unlimited length would take minutes to match in a line with thousands of columns or blanks.
"""
SEGMENT_TIME = re.compile(r"#\d+[,;\s].*[,;\s]([-+\d.eE]+)\s*$")
"""Line of a header with the time of the trigger of a segment."""
CHANNEL = re.compile(r"\bc(?:h|hannel)?[ _]?([1-8a-d])\b")
X_UNIT = re.compile(r"(?:horizontal|\bx)[ _-]?units?\W+([a-zµμ]+)")
Y_UNIT = re.compile(r"(?:vertical|\by)[ _-]?units?\W+([a-zµμ]+)")


@dataclass(frozen=True, slots=True)
class Layout:
    """Delimiter (None: blanks), decimal sign, number of lines before the numbers, columns that hold numbers."""

    delimiter: str | None
    decimal: str
    header_lines: int
    columns: tuple[int, ...]

    def numbers(self, line: str) -> list[Any] | None:
        """Return the numbers in the columns of ``line``; None if one is absent or is no number."""
        cells = _cells(line, self.delimiter)
        if len(cells) <= self.columns[-1]:
            return None
        return _numbers([cells[column] for column in self.columns], self.decimal)


@dataclass(slots=True)
class Table:
    """Table of a text, ``values`` (row, column), while times and indices are removed from it.

    ``names``: header of each column. ``unit_s``: unit of times in the header, s. ``coordinate``: of the rows, if known.
    """

    values: NDArray[Any]
    names: list[str]
    stated: dict[str, tuple[Any, str]]
    inferred: list[str]
    unit_s: float | None = None
    axes: tuple[Dimension, ...] | None = None
    coordinate: Coordinate | None = None
    trigger_time_s: list[float] = field(default_factory=list)


def read_text(path: Path, settings: RecordingSettings) -> Contents:
    """Return the numbers of a text file; times in its first column or row become settings."""
    inferred: list[str] = []
    lines = _decoded(path.read_bytes(), settings.encoding, inferred).splitlines()[settings.skip_rows :]
    while lines and not lines[-1].strip(" \t\x1a,;"):
        lines.pop()
    layout = _layout(lines, settings)
    table = Table(_values(lines, layout, settings.skip_rows), [], {}, inferred)
    _read_header(table, lines, layout)
    _check_segments(table)
    if settings.transpose:
        table.values, table.names = table.values.T, []
    _remove_first_row(table)
    removable = _select_columns(table, settings.columns)
    _remove_first_columns(table, removable, settings)
    _state_volts(table)
    _split_into_records(table)
    return Contents({path.stem: table.values}, table.stated, axes=table.axes, inferred=tuple(inferred))


def _decoded(data: bytes, encoding: str | None, inferred: list[str]) -> str:
    """Return the text of ``data`` in the stated encoding, that of its byte-order mark, UTF-8 or Latin-1."""
    detected = encoding or next((name for mark, name in BYTE_ORDER_MARKS if data.startswith(mark)), None)
    try:
        if detected is None and b"\0" in data[:4096]:
            raise ValueError("it holds bytes of value 0, as no UTF-8 text does: encoding, such as utf-16-le, or format")
        text = data.decode(detected or "utf-8")
    except LookupError:
        raise ValueError(f"encoding {encoding!r} is not known: such as utf-8, utf-16, latin-1") from None
    except UnicodeDecodeError as error:
        if detected is not None:
            raise ValueError(f"it is no {detected} text (byte {error.start + 1}): the right encoding") from None
        # A µ or a degree sign of Windows in a header.
        detected, text = "latin-1", data.decode("latin-1")
        if re.search(r"[\x00-\x08\x0e-\x19\x1b-\x1f]", text[:100_000]):
            raise ValueError("it is no text (it has control characters): format, such as raw") from None
    if detected is not None and encoding is None and detected != "utf-8-sig":
        inferred.append(f"encoding: {detected}")
    return text


def _cells(line: str, delimiter: str | None) -> list[str]:
    return [cell.strip().strip('"') for cell in line.split(delimiter)]


def _numbers(cells: Sequence[str], decimal: str) -> list[Any] | None:
    """Return the real or complex numbers in ``cells``; None if one is no number."""
    if decimal == ",":
        cells = [cell.replace(",", ".") for cell in cells]
    try:
        return [float(cell) for cell in cells]
    except ValueError:
        try:
            return [complex(cell.replace(" ", "").replace("i", "j")) for cell in cells]
        except ValueError:
            return None


def _layout(lines: Sequence[str], settings: RecordingSettings) -> Layout:
    """Return the stated layout, or the one that makes most lines numbers alone."""
    # The second half of a long file has no header.
    last = lines[len(lines) // 2 :] if len(lines) > 2 * SAMPLED_LINES else lines
    sampled = [line for line in last[:: max(1, len(last) // SAMPLED_LINES)] if line.strip() and line[0] != "#"]
    signs, rows = _separators(sampled, settings)
    # A column of numbers has them in most lines; a line that differs is reported later.
    counts = Counter(column for row in rows for column, cell in enumerate(row) if cell)
    columns = tuple(sorted(column for column, count in counts.items() if 2 * count >= len(rows)))
    layout = Layout(*signs, 0, columns)
    are_numbers = (line[:1] != "#" and layout.numbers(line) is not None for line in lines)
    header_lines = next((index for index, has_numbers in enumerate(are_numbers) if has_numbers), 0)
    if header_lines and _is_spoilt(_cells(lines[header_lines - 1], signs[0]), signs[1]):
        _raise_no_numbers(header_lines + settings.skip_rows, lines[header_lines - 1])
    return Layout(*signs, header_lines, columns)


def _separators(lines: Sequence[str], settings: RecordingSettings) -> tuple[tuple[str | None, str], list[list[str]]]:
    """Return delimiter (None: blanks) and decimal sign that make most ``lines`` numbers, and the cells of those lines.

    Raises ``ValueError`` if no line is one of numbers, or if commas may be either.
    """
    delimiters = [settings.delimiter] if settings.delimiter else list(DELIMITERS)
    decimals = [settings.decimal] if settings.decimal else [".", ","]
    best, rows_of_best = None, list[list[str]]()
    for word, decimal in itertools.product(delimiters, decimals):
        delimiter = DELIMITERS.get(word, word)
        rows = _rows_of_numbers(lines, delimiter, decimal)
        if len(rows) > len(rows_of_best) and delimiter != decimal:
            best, rows_of_best = (delimiter, decimal), rows
    if best is None:
        raise ValueError("it holds no line of numbers: rows of values, or skip_rows, delimiter and decimal")
    texts = list(itertools.chain(*rows_of_best))
    are_integers = best == (",", ".") and not any("." in text for text in texts)
    # No program writes an integer with a leading zero: 0,05 is one number.
    if are_integers and not settings.delimiter and any(re.match(r"[-+]?0\d", text) for text in texts):
        raise ValueError("commas may separate numbers or be decimal signs: delimiter and decimal")
    return best, rows_of_best


def _rows_of_numbers(lines: Sequence[str], delimiter: str | None, decimal: str) -> list[list[str]]:
    """Return the cells of the ``lines`` that hold the delimiter, and numbers alone."""
    rows = [_cells(line, delimiter) for line in lines if delimiter is None or delimiter in line]
    return [row for row in rows if any(row) and _numbers([cell for cell in row if cell], decimal) is not None]


def _is_spoilt(cells: Sequence[str], decimal: str) -> bool:
    """Return whether more than half of the cells are numbers with decimals, as in a line of data and no header."""
    numbers = [cell for cell in cells if re.search(r"\d[.,e]\d|[.,]\d", cell) and _numbers([cell], decimal)]
    return 2 * len(numbers) > sum(map(bool, cells))


def _raise_no_numbers(number: int, line: str) -> NoReturn:
    what = f"line {number} has values that are not numbers, {line.strip()[:40]!r}"
    raise ValueError(f"{what}: numbers alone, or skip_rows")


def _values(lines: Sequence[str], layout: Layout, skipped: int) -> NDArray[Any]:
    """Return the numbers (row, column); raise ``ValueError`` for a line that has others or another count of them."""
    data = [line for line in lines[layout.header_lines :] if line.strip() and line[0] != "#"]
    numbers = layout.numbers(data[0])
    dtype = complex if any(isinstance(number, complex) for number in numbers or []) else float
    texts: Iterator[str] = iter(data)
    if layout.decimal == ",":
        texts = (line.replace(",", ".") for line in texts)
    if dtype is complex:
        texts = (line.replace("i", "j") for line in texts)
    try:
        if layout.delimiter is not None and len({line.count(layout.delimiter) for line in data}) > 1:
            raise ValueError
        values = np.loadtxt(
            texts,
            dtype,
            comments=None,
            delimiter=layout.delimiter,
            usecols=layout.columns,
            quotechar='"' if '"' in data[0] else None,
            ndmin=2,
        )
    except (ValueError, TypeError):
        # NumPy refuses delimiters of several characters, and names no line.
        values = np.array(_checked_rows(lines, layout, skipped, dtype is float), dtype)
    return values


def _checked_rows(lines: Sequence[str], layout: Layout, skipped: int, is_real: bool) -> list[list[Any]]:
    """Return the numbers of each line as ``_values``, slowly; the error names the line."""
    rows = list[list[Any]]()
    count = len(_cells(lines[layout.header_lines], layout.delimiter))
    for index, line in enumerate(lines[layout.header_lines :], layout.header_lines):
        if not line.strip() or line[0] == "#":
            continue
        cells, numbers = _cells(line, layout.delimiter), layout.numbers(line)
        if any(cells[count:]) or len(cells) <= layout.columns[-1]:
            raise ValueError(
                f"line {index + 1 + skipped} has {len(cells)} values, earlier lines {count}: rows of equal length"
            )
        if numbers is None or (is_real and any(isinstance(number, complex) for number in numbers)):
            _raise_no_numbers(index + 1 + skipped, line)
        rows.append(numbers)
    return rows


def _read_header(table: Table, lines: Sequence[str], layout: Layout) -> None:
    """Read settings, names of columns and the unit of times from the lines before the numbers."""
    header = [line for line in lines[: layout.header_lines] if line.strip(" \t,;")]
    # Some oscilloscopes write their settings to the left of the first numbers.
    side_header = [line for line in lines[:SAMPLED_LINES] if layout.columns[0] > 0 and line not in header]
    for line in header + side_header:
        _read_header_line(table, line)
    _read_column_names(table, header, layout)
    if header:
        table.inferred.append(f"lines of header: {layout.header_lines}, the last one {header[-1].strip()[:60]!r}")
    if layout.delimiter not in (",", None) or layout.decimal == ",":
        word = next((word for word, text in DELIMITERS.items() if text == layout.delimiter), layout.delimiter)
        table.inferred.append(f"delimiter: {word}, decimal sign: {layout.decimal}")


def _read_header_line(table: Table, line: str) -> None:
    """Read settings, the trigger time of a segment, and the units of both axes from a line of the header."""
    for name, number, unit in SETTING.findall(line):
        if setting := setting_of(name, number, unit):
            table.stated.setdefault(setting[0], (setting[1], name.strip()))
    if match := SEGMENT_TIME.match(line):
        table.trigger_time_s.append(float(match[1]))
    if (match := X_UNIT.search(line.lower())) and match[1] in TIME_UNITS:
        table.unit_s = TIME_UNITS[match[1]]
    if (match := Y_UNIT.search(line.lower())) and match[1] in VOLT_UNITS:
        table.stated["scale_v"] = (VOLT_UNITS[match[1]], match[0])


def _read_column_names(table: Table, header: Sequence[str], layout: Layout) -> None:
    """Read the names of the columns, and settings with their names above their values, from the ``header`` lines."""
    rows = [_cells(line.lstrip("#% "), layout.delimiter) for line in header]
    for above, below in itertools.pairwise(rows):
        for name, number in zip(above, below, strict=False):
            if setting := setting_of(name, number, ""):
                table.stated.setdefault(setting[0], (setting[1], name))
    named = [row for row in rows[-2:] if len(row) > layout.columns[-1]]
    table.names = [" ".join(row[column] for row in named).strip() for column in layout.columns]


def _remove_first_row(table: Table) -> None:
    """Remove a first row of numbers of the columns, or of the times of samples along each row."""
    # The corner of a table with times along rows and columns may hold anything.
    for corner in (0, 1):
        coordinate = find_coordinate(table.values[0, corner:])
        if coordinate is None or coordinate.starts.size > 1 or (corner and not find_coordinate(table.values[1:, 0])):
            continue
        table.values = table.values[1:]
        if coordinate.is_index:
            table.inferred.append("the first row of numbers counts the columns: an index, no samples")
        else:
            _state_sample_times(table, coordinate, "the first row", table.unit_s)
            table.axes = ("pulse", "sample")
        return


def _select_columns(table: Table, text: str | None) -> int:
    """Select the stated columns, such as "2-61", and those before them; return how many may be times or an index."""
    count = table.values.shape[1]
    if text is None:
        return int(min(2, count - 1))
    numbers = list[int]()
    for item in text.replace(" ", "").split(","):
        match = re.fullmatch(r"(\d{1,7})(?:-(\d{1,7}))?", item)
        first, last = (int(match[1]), int(match[2] or match[1])) if match else (0, 0)
        if not 1 <= first <= last <= count:
            raise ValueError(f'columns = {text!r} names none of the {count} columns: such as columns = "2-{count}"')
        numbers += range(first - 1, last)
    leading = list(range(min(numbers)))
    table.values = table.values[:, leading + numbers]
    table.names = [table.names[index] for index in leading + numbers] if table.names else []
    return len(leading)


def _remove_first_columns(table: Table, removable: int, settings: RecordingSettings) -> None:
    """Remove the ``removable`` first columns that are times or an index, and all that are not selected."""
    removed = 0
    for number in range(1, min(2, removable) + 1):
        coordinate = find_coordinate(table.values[:, removed])
        if coordinate is None:
            break
        name = f"column {number}" + (f" ({table.names[removed]})" if table.names and table.names[removed] else "")
        removed += 1
        unit_s = _unit_of(name, TIME_UNITS) or table.unit_s
        if coordinate.is_index and unit_s is None:
            table.inferred.append(f"{name} counts the rows: an index, no pulse")
            table.coordinate = coordinate
            if "sample_rate_hz" in table.stated:
                table.axes = ("sample", "pulse")
                _shift_start(table, float(coordinate.starts[0]))
            continue
        _state_times(table, coordinate, name, unit_s, settings)
        break
    if removed == 0 and removable and settings.columns is None:
        _refuse_uneven_times(table, settings)
    table.values = table.values[:, max(removed, removable if settings.columns else 0) :]


def _shift_start(table: Table, index: float) -> None:
    """Move the time of the first sample in the header, that of index 0, to the sample with ``index``."""
    if index > 1 and "first_sample_s" in table.stated:
        start_s, name = table.stated["first_sample_s"]
        table.stated["first_sample_s"] = (start_s + index / table.stated["sample_rate_hz"][0], name)


def _unit_of(name: str, units: Mapping[str, float]) -> float | None:
    """Return the SI value of the unit in ``name``, such as "time_us", "t (ms)" or "CH1 [mV]"."""
    words = re.findall(r"[a-zµμ]+", name.lower())
    return next((units[word] for word in words if word in units), None)


def _state_volts(table: Table) -> None:
    """State the volts of a value of 1 by the unit in the names of the columns of samples.

    Raises ``ValueError`` if the columns have different units.
    """
    named = {_unit_of(name, VOLT_UNITS): name for name in table.names[-table.values.shape[1] :]}
    named.pop(None, None)
    if len(named) > 1:
        raise ValueError(f"its columns have different units ({', '.join(named.values())}): columns of one unit")
    for scale_v, name in named.items():
        table.stated["scale_v"] = (scale_v, name)


def _state_times(
    table: Table, coordinate: Coordinate, name: str, unit_s: float | None, settings: RecordingSettings
) -> None:
    """State the times of a column: those of samples, or those of pulses if they are too slow for samples."""
    if unit_s is None and coordinate.step * MIN_SAMPLE_RATE_HZ > 1 and settings.axes is None:
        raise ValueError(
            f"{name} ascends by {coordinate.step:g} and has no unit: a header such as time_us, or columns "
            f'= "2-{table.values.shape[1]}" and the rates'
        )
    rate_hz = 1 / (coordinate.step * (unit_s or 1.0))
    rows = settings.axes[0] if settings.axes else "sample" if rate_hz >= MIN_SAMPLE_RATE_HZ else "pulse"
    if rows == "sample":
        _state_sample_times(table, coordinate, name, unit_s)
        table.axes, table.coordinate = ("sample", "pulse"), coordinate
        return
    time_s = (coordinate.starts[0] + coordinate.step * np.arange(coordinate.record_length)) * (unit_s or 1.0)
    table.stated["pulse_time_s"] = (tuple(time_s.tolist()), name)
    table.axes = ("pulse", "sample")


def _state_sample_times(table: Table, coordinate: Coordinate, name: str, unit_s: float | None) -> None:
    """State sampling rate and time of the first sample; they take precedence over those of the header."""
    table.stated["sample_rate_hz"] = (float(f"{1 / (coordinate.step * (unit_s or 1.0)):.9g}"), name)
    table.stated["first_sample_s"] = (float(coordinate.starts[0]) * (unit_s or 1.0), name)
    unit = "s (no unit is stated)" if unit_s is None else f"units of {unit_s:g} s" if unit_s < 1 else "s"
    table.inferred.append(f"{name} holds the times of the samples in {unit}")
    table.inferred.append("time 0 of the file counts as the onset of the pulse")


def _refuse_uneven_times(table: Table, settings: RecordingSettings) -> None:
    """Raise ``ValueError`` for a first column that ascends unevenly; as times of pulses it becomes a setting."""
    first = table.values[:, 0]
    if first.size < MIN_LENGTH or np.iscomplexobj(first) or np.mean(np.diff(first) > 0) < MIN_ASCENDING:
        return
    if settings.axes and settings.axes[0] == "pulse":
        table.stated["pulse_time_s"] = (tuple(first.tolist()), "column 1")
        table.values = table.values[:, 1:]
        return
    raise ValueError(
        f"column 1 ascends unevenly from {first[0]:g} to {first[-1]:g}, as no pulse does: axes = pulse,sample if it "
        f'holds the times of the pulses, or columns = "2-{table.values.shape[1]}"'
    )


def _check_segments(table: Table) -> None:
    """Raise ``ValueError`` if the rows are not those of the segments that the header states."""
    segments, rows = len(table.trigger_time_s), len(table.values)
    length = int(table.stated.get("record_samples", (rows,))[0])
    if segments > 1 and segments * length != rows:
        raise ValueError(
            f"the header states {segments} segments of {length} samples, {rows} rows follow: "
            "a whole copy, or one file per segment"
        )


def _are_channels(names: Sequence[str]) -> bool:
    """Return whether ``names`` of columns are those of different channels, such as CH1 and CH2."""
    channels = [match[1] for name in names if (match := CHANNEL.search(name.lower()))]
    return 1 < len(names) == len(channels) == len(set(channels))


def _split_into_records(table: Table) -> None:
    """Split rows of consecutive records: at each restart of their times, or by the segments in the header."""
    coordinate, values = table.coordinate, table.values
    length = values.shape[0] if coordinate is None else coordinate.record_length
    segment_length = int(table.stated.get("record_samples", (length,))[0])
    if len(table.trigger_time_s) > 1:
        times = np.array(table.trigger_time_s)
        table.stated["pulse_time_s"] = (tuple((times - times[0]).tolist()), "the times of the triggers")
        length = segment_length
    elif table.axes == ("sample", "pulse") and length % segment_length:
        raise ValueError(f"the header states {segment_length} samples, {length} rows follow: a whole copy")
    count = values.shape[0] // length
    channels = 1 < values.shape[1] < MIN_PULSES or _are_channels(table.names[-values.shape[1] :])
    if count > 1:
        table.inferred.append(f"{values.shape[0]} rows are {count} consecutive records of {length} samples")
        table.values = np.moveaxis(values.reshape(count, length, -1), 2, 0)
        table.axes = ("line", "pulse", "sample")
        if coordinate is not None and coordinate.starts.size == count:
            offset = (coordinate.starts - coordinate.starts[0]) / coordinate.step
            aligned, sentence = align_records(np.moveaxis(table.values, 0, 1), offset)
            table.values = np.moveaxis(aligned, 1, 0)
            table.inferred += [sentence] if sentence else []
        if table.values.shape[0] == 1:
            table.values, table.axes = table.values[0], ("pulse", "sample")
    elif table.axes == ("sample", "pulse") and channels:
        table.axes = ("sample", "line")
        table.inferred.append(f"{values.shape[1]} columns are channels, too few for pulses: each is a line")
    elif table.axes == ("sample", "pulse") and values.shape[1] == 1:
        table.values, table.axes = values[:, 0], ("sample",)
