"""Choice of the array that holds the samples, the names of its axes, and its lines."""

from __future__ import annotations

import itertools
import re
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hpe_rig.recordings.coordinates import find_coordinate
from hpe_rig.recordings.settings import DIMENSIONS, Dimension
from hpe_rig.recordings.statements import Statements
from hpe_rig.scene import Mistake

MIN_PULSES, MIN_SAMPLES = 4, 8
"""Lengths below which an axis holds no pulses of a vibration, and no samples of an echo."""
MIN_PULSE_SIMILARITY = 0.9
"""Correlation of neighbouring pulses at an SNR of 10 dB; a lower one suggests lines of an image."""
DEFAULT_AXES: Mapping[int, tuple[Dimension, ...]] = {
    1: ("sample",),
    2: ("pulse", "sample"),
    3: ("line", "pulse", "sample"),
    4: ("line", "shot", "pulse", "sample"),
}


def select_array(statements: Statements) -> tuple[str, NDArray[Any] | None]:
    """Return name and array of the samples: the stated one, or the largest. None and a mistake if ambiguous."""
    variable = statements.settings.variable
    arrays = {name: array for name, array in statements.contents.arrays.items() if array.size}
    if variable is None:
        # Vectors are samples only if there is nothing else: most are times or positions.
        tables = {name: array for name, array in arrays.items() if array.ndim > 1 and array.size > max(array.shape)}
        arrays = tables or arrays
    if variable is not None:
        by_name = {name.strip("/"): array for name, array in arrays.items()}
        if variable.strip("/") in by_name:
            return variable, by_name[variable.strip("/")]
        statements.add_mistake(
            "variable",
            f"{variable!r} is no array of numbers in the file",
            f"one of {', '.join(arrays)}" if arrays else "a file with samples",
        )
        return variable, None
    if not arrays:
        what = "the file holds no array of numbers"
        statements.add_mistake("", what, "a file with samples")
        return "", None
    # Without a stated name the largest array holds the samples, unless two are equally large.
    sizes = sorted(((array.size, name) for name, array in arrays.items()), reverse=True)
    largest = [name for name, array in arrays.items() if array.size == sizes[0][0]]
    if len(largest) > 1:
        what = f"several arrays may be the samples: {', '.join(largest)}"
        statements.add_mistake("variable", what, f'"{sizes[0][1]}"')
        return "", None
    if len(arrays) > 1:
        statements.inferred.append(f"samples: {largest[0]!r}, the largest array of {', '.join(arrays)}")
    return largest[0], arrays[largest[0]]


def with_axes(
    statements: Statements, array: NDArray[Any], label: str
) -> tuple[NDArray[Any], tuple[Dimension, ...]] | tuple[None, None]:
    """Return the array, without axes of length 1 and divided into records, and its axes; None and a mistake."""
    axes = statements.settings.axes or statements.contents.axes
    if array.ndim != len(axes or ()) and 1 in array.shape:
        statements.inferred.append(f"{label!r} of {array.shape}: axes of length 1 are dropped")
        array = array.squeeze()
    axes = axes or _axes_of_records(statements, array) or _infer_axes(statements, array, label)
    if axes is None:
        return None, None
    if len(axes) != array.ndim:
        what = f"{', '.join(axes)} are {len(axes)} axes, {label!r} has {array.ndim}: {array.shape}"
        statements.add_mistake("axes", what, f"{array.ndim} names in the order of the file")
        return None, None
    if "iq" in axes and array.shape[axes.index("iq")] != 2:
        what = f"axis iq has a length of {array.shape[axes.index('iq')]}"
        statements.add_mistake("axes", what, "a length of 2, for I and Q")
        return None, None
    _refuse_coordinates(statements, array, label)
    return (array, axes) if "pulse" in axes else _divide(statements, array, axes)


def _refuse_coordinates(statements: Statements, array: NDArray[Any], label: str) -> None:
    """Add a mistake if the first row or column of a table holds times or an index instead of echoes."""
    if array.ndim != 2 or statements.settings.columns is not None:
        return
    for name, values, remedy in (("column", array[:, 0], "[:, 1:]"), ("row", array[0], "[1:]")):
        if coordinate := find_coordinate(values):
            what = f"the first {name} of {label!r} ascends by {coordinate.step:g}: times or an index, no echoes"
            statements.add_mistake("variable", what, f"the array without it, {label}{remedy}, and the rate")


def _axes_of_records(statements: Statements, array: NDArray[Any]) -> tuple[Dimension, ...] | None:
    """Return sample, or sample and line, for an array with an axis of several stated records; else None."""
    length = statements.settings.record_samples
    if array.ndim == 1:
        return ("sample",) if statements.settings.quantity is None else ("pulse",)
    if length is None or array.ndim != 2 or length in array.shape:
        return None
    multiples = [index for index, size in enumerate(array.shape) if size > length and size % length == 0]
    if len(multiples) != 1:
        return None
    statements.inferred.append(f"axes: {array.shape[multiples[0]]} samples in records of {length}, and lines")
    return ("sample", "line") if multiples[0] == 0 else ("line", "sample")


def _divide(
    statements: Statements, array: NDArray[Any], axes: tuple[Dimension, ...]
) -> tuple[NDArray[Any], tuple[Dimension, ...]] | tuple[None, None]:
    """Return the array with its axis sample divided into (pulse, sample); None and a mistake if that fails."""
    index, length = axes.index("sample"), statements.settings.record_samples
    samples = array.shape[index]
    if length is None or samples % length or samples == length:
        what = f"a signal of {samples} samples has no axis pulse"
        what += "" if length is None else f", and is not several records of {length} samples"
        remedy = "record_samples of consecutive records; or one file per pulse: import shot_1.csv shot_2.csv"
        statements.add_mistake("record_samples", what, remedy)
        return None, None
    statements.inferred.append(f"{samples} samples are {samples // length} consecutive records of {length}")
    shape = (*array.shape[:index], samples // length, length, *array.shape[index + 1 :])
    return array.reshape(shape), (*axes[:index], "pulse", *axes[index:])


def _infer_axes(statements: Statements, array: NDArray[Any], label: str) -> tuple[Dimension, ...] | None:
    """Return the only order of axes that has the known lengths; None and a mistake if it is not unique."""
    if array.ndim not in DEFAULT_AXES:
        what = f"{label!r} has {array.ndim} axes: {array.shape}"
        remedy = f"axes with {array.ndim} names of {', '.join(DIMENSIONS)}, or another array"
        statements.add_mistake("axes", what, remedy)
        return None
    default = DEFAULT_AXES[array.ndim]
    lengths = {name: length for name, length in _known_lengths(statements).items() if length is not None}
    # Try every order of the default axes against the lengths that settings, file or scene state.
    orders = [
        order
        for order in itertools.permutations(default)
        if all(lengths.get(name, length) == length for name, length in zip(order, array.shape, strict=True))
    ]
    known_text = ", ".join(f"{length:g} along {name}" for name, length in lengths.items())
    if len(orders) == 1:
        order_text = f"axes: {', '.join(orders[0])} for {array.shape}"
        statements.inferred.append(f"{order_text}, the only order with {known_text}")
        return orders[0]
    what = f"the order of axes of {array.shape} is not stated"
    if known_text:
        what += f", and {'several orders have' if orders else 'none has'} {known_text}"
    statements.add_mistake("axes", what, _suggestion(array, default))
    return None


def _suggestion(array: NDArray[Any], default: tuple[Dimension, ...]) -> str:
    """Return the most plausible axes of ``array`` in words; consecutive pulses are nearly equal."""
    names = default
    if array.ndim > 2 and array.shape[-1] == 2 and np.isrealobj(array):
        names = (*default[1:], "iq")
    orders = [order for order in itertools.permutations(names) if _is_possible(order, array.shape)]
    if not orders:
        signal = "sample,line" if array.shape[0] > array.shape[-1] else "line,sample"
        return f'axes = "{signal}" and record_samples for a signal of several channels, or another array'
    similarity = [_similarity(array, axis) for axis in range(array.ndim)]
    best = max(orders, key=lambda order: (similarity[order.index("pulse")], array.shape[order.index("sample")]))
    most_similar = int(np.argmax(similarity))
    if array.shape[most_similar] < MIN_PULSES and similarity[best.index("pulse")] < MIN_PULSE_SIMILARITY:
        what = f"neighbours are most alike along the axis of {array.shape[most_similar]}, too short for pulses"
        return f"a recording of {MIN_PULSES} pulses or more ({what}), or axes"
    lengths = ", ".join(f"{length} along {name}" for name, length in zip(best, array.shape, strict=True))
    return f'such as axes = "{",".join(best)}" ({lengths}; neighbours are most alike along pulse)'


def _is_possible(order: tuple[Dimension, ...], shape: tuple[int, ...]) -> bool:
    """Return whether axes of these lengths can hold pulses, samples, and I and Q as the last axis."""
    lengths = dict(zip(order, shape, strict=True))
    iq_is_last = "iq" not in lengths or order[-1] == "iq"
    return lengths["pulse"] >= MIN_PULSES and lengths["sample"] >= MIN_SAMPLES and iq_is_last


def _similarity(array: NDArray[Any], axis: int) -> float:
    """Return the correlation of neighbours along ``axis``, from a few values along the other axes."""
    steps = [1 if index == axis else max(1, length // 32) for index, length in enumerate(array.shape)]
    values = np.moveaxis(array[tuple(slice(None, None, step) for step in steps)], axis, 0).astype(np.complex128)
    energy = float(np.sum(np.abs(values) ** 2))
    pairs = len(values) - 1
    if not energy > 0 or not pairs:
        return 0.0
    return float(np.abs(np.sum(values[1:] * values[:-1].conj()))) / energy * len(values) / pairs


def _known_lengths(statements: Statements) -> dict[str, float | None]:
    times, positions = statements.stated("pulse_time_s"), statements.stated("line_position_m")
    scene, in_file = statements.scene, statements.stated("record_samples")
    samples = scene.get("record_samples") if statements.settings.samples is None else None
    return {
        "pulse": scene.get("pulse_count") if times is None else len(times[0]),
        "sample": samples if in_file is None else in_file[0],
        "line": None if positions is None else len(positions[0]),
    }


def select_lines(text: str | None, count: int) -> tuple[slice, bool] | Mistake:
    """Return the range of the selected of ``count`` lines, and whether to average them; a mistake for invalid text.

    Lines count from 1 in ``text``: "12", "10-20", "all", "mean", "mean:10-20". None selects the only line.
    """
    if text is None:
        if count == 1:
            return slice(0, 1), False
        what = f"the recording has {count} lines and none is selected"
        return Mistake("lines", what, f'"{(count + 1) // 2}" for one, "mean" for their mean, "all" for each')
    words = text.strip().lower().replace(" ", "")
    mean = words.startswith("mean")
    numbers = words.removeprefix("mean").removeprefix(":") if mean else words
    if numbers == "all" or (mean and not numbers):
        return slice(0, count), mean
    match = re.fullmatch(r"(\d{1,9})(?:-(\d{1,9}))?", numbers)
    if match is None:
        return Mistake("lines", f"{text!r} names no line", '"12", "10-20", "all", "mean" or "mean:10-20"')
    first = int(match[1])
    last = int(match[2] or first)
    if not 1 <= first <= last <= count:
        return Mistake("lines", f"{text!r} is not within the {count} lines of the recording", f'"1-{count}"')
    return slice(first - 1, last), mean
