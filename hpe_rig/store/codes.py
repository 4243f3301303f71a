"""Codes of the records of a shot: which records arrived, and their chunks, each compared with its checksum."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import h5py
import numpy as np

from hpe_rig.arrays import BoolArray, FloatArray, Int16Array
from hpe_rig.store.checksum import digest
from hpe_rig.store.foreign_hdf5 import InvalidContentError
from hpe_rig.store.format import BITSHUFFLE
from hpe_rig.store.placement import Placement, place_records
from hpe_rig.store.records import MISSING
from hpe_rig.store.rows import checked_row
from hpe_rig.store.validation import CheckedFile, filters, stored_values

CODE_LIMITS_UNSTATED: Final = (-8192, 8191)
"""Lowest and highest code in early files that do not state them: the 14 bits of the only digitizer at that time."""
MAX_MISSING_BYTES: Final = 256_000_000
"""Maximum memory for the missing records of a shot, which take no space in the file."""


@dataclass(frozen=True, slots=True)
class Arrival:
    """Which records of a shot are in the file with an intact mark, and their trigger times, NaN for others; (pulse,).

    ``damaged``: records whose mark fails its checksum. ``unverified``: records with a mark but without a checksum,
    because the program was killed before it wrote that (version 2).
    """

    recorded: BoolArray
    trigger_time_s: FloatArray
    damaged: BoolArray
    unverified: BoolArray


def arrival_of(checked: CheckedFile, shot: int) -> Arrival:
    """Return which records of ``shot`` are in the file, with their trigger times."""
    marks, time_s = (
        stored_values(checked.dataset(f"records/{name}"), (shot,)) for name in ("recorded", "trigger_time_s")
    )
    recorded = marks == 1
    damaged, unverified = np.zeros_like(recorded), np.zeros_like(recorded)
    sums = checked.checksums("records/recorded")
    for number, expected in enumerate([] if sums is None else sums[shot]):
        # Marks and trigger times have one checksum for each chunk of records.
        rows = slice(number * checked.chunk_records, (number + 1) * checked.chunk_records)
        if not expected and not checked.is_written_once:
            unverified[rows] = recorded[rows]
        elif expected != checked.row_checksum("records/recorded", (shot, number), marks[rows].data, time_s[rows].data):
            damaged[rows] = True
    recorded &= ~(damaged | unverified)
    return Arrival(recorded, np.where(recorded, time_s, np.nan), damaged, unverified)


def placement_of(checked: CheckedFile, shot: int, arrival: Arrival) -> Placement:
    """Return the pulse of each record of ``shot`` by the trigger times; damaged records count as arrived.

    The pulse rate is that of the planned onsets; without them, or for one pulse, it is not finite.
    """
    onset_s = checked_row(checked, "records/pulse_onset_s", shot)[0]
    with np.errstate(divide="ignore", invalid="ignore"):
        rate_hz = float((onset_s.size - 1) / (onset_s[-1] - onset_s[0]))
    return place_records(arrival.recorded | arrival.damaged, arrival.trigger_time_s, rate_hz)


def read_codes(
    checked: CheckedFile, name: str, shot: int, recorded: BoolArray, samples: slice, records: slice = slice(None)
) -> tuple[Int16Array, BoolArray]:
    """Return the codes of ``samples`` of the ``records`` of ``shot``, (record, sample), and which are damaged.

    ``name``: dataset of the input. ``recorded``: which records of the shot are in the file. A record is damaged if the
    chunk that holds it fails its checksum. Each chunk is checked before it is decompressed.
    """
    echo, sums, chunk_records = checked.dataset(name), checked.checksums(name), checked.chunk_records
    start, stop, _ = records.indices(recorded.size)
    codes = np.full((max(0, stop - start), samples.stop - samples.start), MISSING)
    damaged = np.zeros(recorded.size, bool)
    for number in range(start // chunk_records, -(-stop // chunk_records)):
        # Records of the shot that the chunk and ``records`` share.
        chunk_start = number * chunk_records
        first, last = max(chunk_start, start), min(chunk_start + chunk_records, stop)
        if recorded[first:last].any():
            chunk = _chunk(checked, echo, shot, number, None if sums is None else int(sums[shot, number]))
            if chunk is None:
                damaged[first:last] = recorded[first:last]
            else:
                codes[first - start : last - start] = chunk[first - chunk_start : last - chunk_start, samples]
    codes[~recorded[start:stop] | damaged[start:stop]] = MISSING
    return codes, damaged[start:stop]


def _chunk(checked: CheckedFile, echo: h5py.Dataset, shot: int, number: int, expected: int | None) -> Int16Array | None:
    """Return the codes of chunk ``number`` of a shot, (record, sample), None if it is damaged.

    A chunk is the piece that HDF5 stores at once. ``expected``: its checksum, None in a file without. That of format
    version 2 is of the stored bytes, later ones of the codes.
    """
    name, first = echo.name[1:], number * checked.chunk_records
    shape = (min(checked.chunk_records, echo.shape[1] - first), echo.shape[2])
    if checked.codes is not None:
        chunk = checked.codes(name, shot, number)
        return None if chunk is None else chunk[0]
    try:
        compressed = BITSHUFFLE in filters(echo)
        # Read as stored, where possible: HDF5's own checksum follows the codes, and comparing one takes half the time.
        stored = b"" if compressed and checked.is_written_once else echo.id.read_direct_chunk((shot, first, 0))[1]
        if not checked.is_written_once and expected not in (None, digest(name, (shot, number), stored)):
            return None
        codes: Int16Array = (
            # HDF5 compares its own checksum, if there is one, before it decompresses the chunk.
            echo[shot, first : first + shape[0]]
            if compressed
            else np.frombuffer(stored, "<i2", shape[0] * shape[1]).reshape(shape)
        )
    except (OSError, RuntimeError, ValueError):
        # The chunk lies beyond the end of the file, is shorter than its records, or has no location.
        return None
    is_intact = not checked.is_written_once or checked.row_checksum(name, (shot, number), codes.data) == expected
    return codes if is_intact else None


def refuse_excessive_size(checked: CheckedFile, name: str, recorded: BoolArray, samples: int) -> None:
    """Raise ``InvalidContentError`` if the declared records need far more memory than the file has bytes for them.

    ``name``: dataset of the input. ``samples``: number of samples that are read from each record.
    """
    echo = checked.dataset(name)
    size = checked.size if checked.codes else echo.id.get_storage_size()
    is_compressed = not checked.codes and BITSHUFFLE in filters(echo)
    if not is_compressed and int(recorded.sum()) * echo.shape[2] * 2 > size:
        raise InvalidContentError(f"it declares {int(recorded.sum())} stored records in {size} bytes")
    if 2 * recorded.size * samples > size + MAX_MISSING_BYTES:
        raise InvalidContentError(f"it declares {recorded.size} records a shot and holds {size} bytes")


def code_limits_of(checked: CheckedFile, name: str) -> tuple[int, int]:
    """Return the lowest and the highest code of the digitizer for the records in dataset ``name``."""
    if "valid_min" not in checked.file[name].attrs:
        return CODE_LIMITS_UNSTATED
    lowest, highest = (checked.attribute(key, int, name) for key in ("valid_min", "valid_max"))
    if not MISSING < lowest < highest <= np.iinfo(np.int16).max:
        raise InvalidContentError(f"/{name} has codes from {lowest} to {highest}")
    return lowest, highest
