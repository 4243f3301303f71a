"""Codes of the records of a shot: which records arrived, and their chunks, each compared with its checksum."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import h5py
import numpy as np

from hpe_rig.arrays import BoolArray, FloatArray, Int16Array
from hpe_rig.store.checksum import GROUP, digest
from hpe_rig.store.foreign_hdf5 import InvalidContentError
from hpe_rig.store.format import BITSHUFFLE
from hpe_rig.store.placement import Placement, place_records
from hpe_rig.store.records import MISSING
from hpe_rig.store.rows import Shape, dataset_by_pulse, row_or_blank
from hpe_rig.store.validation import CheckedFile, stored_values

CODE_LIMITS_UNSTATED: Final = (-8192, 8191)
"""Lowest and highest code in early files that do not state them: the 14 bits of the only digitizer at that time."""
MAX_MISSING_BYTES: Final = 256_000_000
"""Maximum memory for the missing records of a shot, which take no space in the file."""


@dataclass(frozen=True, slots=True)
class Arrival:
    """Which records of a shot are in the file, their trigger times, and which marks are damaged; each (pulse,)."""

    recorded: BoolArray
    trigger_time_s: FloatArray
    damaged: BoolArray


def arrival_of(checked: CheckedFile, shape: Shape, shot: int) -> Arrival:
    """Return which records of ``shot`` are in the file, with their trigger times.

    The marks of each chunk of records have a checksum; records with a missing or wrong one do not count.
    """
    marks = stored_values(dataset_by_pulse(checked, "records/recorded", shape, "u1"), (shot,))
    time_s = stored_values(dataset_by_pulse(checked, "records/trigger_time_s", shape), (shot,))
    recorded, damaged = marks == 1, np.zeros(shape[1], bool)
    if checked.has_checksums:
        # Marks and trigger times have one checksum for each chunk of records.
        name, size = "records/recorded", checked.file["records/echo"].chunks[1]
        for number, expected in enumerate(_sums(checked, name, shape, size)[shot]):
            rows = slice(number * size, (number + 1) * size)
            if not expected and not checked.is_written_once:
                # The writer was killed before it wrote this checksum.
                recorded[rows] = False
            elif checked.row_checksum(name, (shot, number), marks[rows].tobytes(), time_s[rows].tobytes()) != expected:
                recorded[rows], damaged[rows] = False, True
    return Arrival(recorded, np.where(recorded, time_s, np.nan), damaged)


def placement_of(checked: CheckedFile, shape: Shape, shot: int, arrival: Arrival) -> Placement:
    """Return the pulse of each record of ``shot`` by the trigger times; damaged records count as arrived.

    The pulse rate is that of the planned onsets; without them, or for one pulse, it is not finite.
    """
    name = "records/pulse_onset_s"
    onset_s = row_or_blank(checked, name, dataset_by_pulse(checked, name, shape), shot)
    with np.errstate(divide="ignore", invalid="ignore"):
        rate_hz = float((shape[1] - 1) / (onset_s[-1] - onset_s[0]))
    return place_records(arrival.recorded | arrival.damaged, arrival.trigger_time_s, rate_hz)


def _sums(checked: CheckedFile, name: str, shape: Shape, rows: int) -> h5py.Dataset:
    """Return the checksums of dataset ``name``, (shot, chunk), for chunks of ``rows`` records."""
    return checked.dataset(f"{GROUP}/{name}", "<u8", (shape[0], -(-shape[1] // rows)))


def read_codes(
    checked: CheckedFile,
    echo: h5py.Dataset,
    name: str,
    shot: int,
    arrival: Arrival,
    samples: slice,
    rows: slice | None = None,
) -> tuple[Int16Array, BoolArray]:
    """Return the codes of ``samples`` of the records ``rows``, (pulse, sample), and which are damaged, (pulse,).

    A record is damaged if its mark in ``arrival`` is, or if the chunk that holds it fails its checksum. Each chunk is
    checked before it is decompressed.
    """
    rows = slice(0, echo.shape[1]) if rows is None else slice(rows.start, min(rows.stop, echo.shape[1]))
    # Damaged marks are carried in from ``arrival``; damaged chunks are added below.
    recorded, damaged = arrival.recorded[rows], arrival.damaged[rows].copy()
    records_per_chunk: int = echo.chunks[1]
    # A file without checksums can have chunks of any shape. If its chunks span several shots or only part of a record,
    # HDF5 assembles the selection itself.
    if not checked.has_checksums and (echo.chunks[0] != 1 or echo.chunks[2] != echo.shape[2]):
        codes = echo[shot, rows, samples]
        codes[~recorded] = MISSING
        return codes, damaged
    codes = np.full((recorded.size, samples.stop - samples.start), MISSING)
    sums = _sums(checked, name, echo.shape, records_per_chunk) if checked.has_checksums and recorded.any() else None
    for number in range(rows.start // records_per_chunk, -(-rows.stop // records_per_chunk)):
        # Records that the chunk and ``rows`` share: indices in the shot, then in the result.
        first, last = max(number * records_per_chunk, rows.start), min((number + 1) * records_per_chunk, rows.stop)
        block = slice(first - rows.start, last - rows.start)
        if recorded[block].any():
            chunk_codes = _chunk(checked, echo, name, shot, number, sums)
            if chunk_codes is None:
                damaged[block] |= recorded[block]
            else:
                codes[block] = chunk_codes[
                    first - number * records_per_chunk : last - number * records_per_chunk, samples
                ]
    codes[~recorded | damaged] = MISSING
    return codes, damaged


def _chunk(
    checked: CheckedFile, echo: h5py.Dataset, name: str, shot: int, number: int, sums: h5py.Dataset | None
) -> Int16Array | None:
    """Return the codes of chunk ``number`` of a shot, (pulse, sample), None if it is damaged.

    A chunk is the piece that HDF5 stores at once. ``sums`` (shot, chunk): checksums, None in a file without. Those of
    format version 2 are of the stored bytes, later ones of the codes.
    """
    first = number * echo.chunks[1]
    shape = (min(echo.chunks[1], echo.shape[1] - first), echo.shape[2])
    if checked.codes is not None:
        chunk = checked.codes(name, shot, number, shape, first)
        return None if chunk is None else chunk[0]
    expected = None if sums is None else int(sums[shot, number])
    if not checked.is_written_once:
        stored = _stored_chunk(echo, shot, first)
        if not stored or expected not in (None, digest(name, (shot, number), stored)):
            return None
    codes = _codes_of_chunk(echo, shot, first, shape)
    if codes is None or not checked.is_written_once:
        return codes
    return codes if checked.row_checksum(name, (shot, number), codes.data) == expected else None


def _codes_of_chunk(echo: h5py.Dataset, shot: int, first: int, shape: tuple[int, int]) -> Int16Array | None:
    """Return the codes of the chunk of ``shape`` that begins with record ``first``; None if it cannot be read."""
    if not _is_compressed(echo):
        # HDF5's own checksum follows the codes; comparing one checksum takes half the time.
        stored, size = _stored_chunk(echo, shot, first), shape[0] * shape[1]
        return np.frombuffer(stored, "<i2", size).reshape(shape) if len(stored) >= 2 * size else None
    try:
        # HDF5 compares its own checksum before it decompresses the chunk.
        codes: Int16Array = echo[shot, first : first + shape[0]]
    except OSError:
        return None
    return codes


def _stored_chunk(echo: h5py.Dataset, shot: int, first: int) -> bytes:
    """Return the stored bytes of the chunk that begins with record ``first`` of ``shot``; none if it is not there."""
    try:
        _, stored = echo.id.read_direct_chunk((shot, first, 0))
    except (OSError, RuntimeError, ValueError):
        # The chunk lies beyond the end of the file or has no location.
        return b""
    content: bytes = stored
    return content


def refuse_excessive_size(checked: CheckedFile, echo: h5py.Dataset, recorded: BoolArray, samples: int) -> None:
    """Raise ``InvalidContentError`` if the declared records need far more memory than the file has bytes for them.

    ``samples``: number of samples that are read from each record.
    """
    _, pulses, record_samples = echo.shape
    size = checked.size if checked.codes else echo.id.get_storage_size()
    if (checked.codes or not _is_compressed(echo)) and int(recorded.sum()) * record_samples * 2 > size:
        raise InvalidContentError(f"it declares {int(recorded.sum())} stored records in {size} bytes")
    if 2 * pulses * samples > size + MAX_MISSING_BYTES:
        raise InvalidContentError(f"it declares {pulses} records a shot and holds {size} bytes")


def _is_compressed(echo: h5py.Dataset) -> bool:
    """Return whether the chunks of ``echo`` are compressed."""
    properties = echo.id.get_create_plist()
    return any(properties.get_filter(number)[0] == BITSHUFFLE for number in range(properties.get_nfilters()))


def echo_dataset(checked: CheckedFile, shape: Shape, name: str = "echo") -> h5py.Dataset:
    """Return the dataset of the records at input ``name``.

    Raises ``InvalidContentError`` unless each chunk, the piece that HDF5 stores at once, holds whole records of one
    shot.
    """
    echo = checked.dataset(f"records/{name}", "<i2", shape)
    if echo.chunks is None:
        raise InvalidContentError(f"/records/{name} is in one piece")
    # Only files without checksums may have other chunks.
    if checked.has_checksums and (echo.chunks[0] != 1 or echo.chunks[2] != shape[2]):
        raise InvalidContentError(f"/records/{name} has chunks of {echo.chunks}")
    return echo


def code_limits_of(checked: CheckedFile, name: str) -> tuple[int, int]:
    """Return the lowest and the highest code of the digitizer for the records in dataset ``name``."""
    if "valid_min" not in checked.file[name].attrs:
        return CODE_LIMITS_UNSTATED
    lowest, highest = (checked.attribute(key, int, name) for key in ("valid_min", "valid_max"))
    if not MISSING < lowest < highest <= np.iinfo(np.int16).max:
        raise InvalidContentError(f"/{name} has codes from {lowest} to {highest}")
    return lowest, highest
