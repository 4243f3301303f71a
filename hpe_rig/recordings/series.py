"""Recordings of several files, one pulse or frame each, as one array."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hpe_rig.recordings.contents import Contents
from hpe_rig.recordings.coordinates import align_records
from hpe_rig.recordings.importers import read_contents
from hpe_rig.recordings.settings import Dimension, RecordingSettings

SAME = 1e-6
"""Relative difference of equal settings."""


def series_name(paths: Sequence[Path]) -> str:
    """Return the name of a recording of several files."""
    return f"{paths[0].name} to {paths[-1].name}"


def read_series(paths: Sequence[Path], settings: RecordingSettings) -> tuple[str, Contents, str]:
    """Return format, content and SHA-256 of files in the order of their pulses; the first axis counts the files.

    Raises ``ValueError`` if the files differ in shape or settings, ``OSError`` if one cannot be read.
    """
    digest, file_format = hashlib.sha256(), ""
    arrays, start_s = list[NDArray[Any]](), list[float]()
    first: Contents | None = None
    for path in paths:
        try:
            file_format, contents = read_contents(path, settings)
            arrays.append(_samples(contents, settings.variable))
            first = contents if first is None else first
            _check_same(contents, first, paths[0].name)
        except ValueError as error:
            raise ValueError(f"{path.name}: {error}") from error
        if arrays[-1].shape != arrays[0].shape:
            shapes = f"{path.name} holds samples of {arrays[-1].shape}, {paths[0].name} of {arrays[0].shape}"
            raise ValueError(f"{shapes}: records of one length")
        digest.update(path.read_bytes())
        start_s.append(contents.stated.get("first_sample_s", (0.0, ""))[0])
    if first is None:
        raise ValueError("no file is given: the files of a recording")
    axes: tuple[Dimension, ...] | None = ("sample",) if arrays[0].ndim == 1 else first.axes
    leading: Dimension = "shot" if axes is not None and "pulse" in axes else "pulse"
    inferred = [f"{len(paths)} files, one {leading} each: {series_name(paths)}", *first.inferred]
    stacked = np.stack(arrays)
    rate_hz = settings.sample_rate_hz or first.stated.get("sample_rate_hz", (None, ""))[0]
    if axes is not None and rate_hz is not None:
        # Samples become the last axis for the shift.
        last = np.moveaxis(stacked, 1 + axes.index("sample"), -1)
        aligned, sentence = align_records(last, (np.array(start_s) - start_s[0]) * rate_hz)
        stacked = np.moveaxis(aligned, -1, 1 + axes.index("sample"))
        inferred += [sentence] if sentence else []
    return (
        file_format,
        Contents(
            {"files": stacked},
            first.stated,
            axes=None if axes is None else (leading, *axes),
            board=first.board,
            inferred=tuple(inferred),
        ),
        digest.hexdigest(),
    )


def _samples(contents: Contents, variable: str | None) -> NDArray[Any]:
    """Return the stated array of a file, or its only largest one, without axes of length 1."""
    arrays = contents.arrays
    if variable is not None and variable in arrays:
        return arrays[variable].squeeze()
    largest_size = max((array.size for array in arrays.values()), default=0)
    largest = [name for name, array in arrays.items() if array.size == largest_size]
    if variable is not None or len(largest) != 1:
        names = ", ".join(arrays) or "none"
        raise ValueError(f"the array of the samples is not determined, there are {names}: variable with its name")
    return arrays[largest[0]].squeeze()


def _check_same(contents: Contents, first: Contents, first_name: str) -> None:
    """Raise ``ValueError`` for a setting that differs from that of the first file; starts of records may."""
    for key, (value, name) in contents.stated.items():
        if key == "first_sample_s" or key not in first.stated:
            continue
        # Most settings are single equal numbers, for which NumPy is slow.
        if isinstance(value, float) and value == first.stated[key][0]:
            continue
        if np.shape(value) != np.shape(first.stated[key][0]) or not np.allclose(value, first.stated[key][0], rtol=SAME):
            raise ValueError(f"its {name!r} differs from that in {first_name}: files of one recording, or {key}")
