"""Damage of a file, in words and by shot and record."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from hpe_rig.arrays import BoolArray


@dataclass(frozen=True, slots=True)
class Damage:
    """Part of a file that fails its checksum.

    ``shot`` counts from 0; None if the damage belongs to no shot. ``records``: first and last of each series of
    consecutive damaged records, from 0.
    """

    what: str
    shot: int | None = None
    records: tuple[tuple[int, int], ...] = ()

    def __str__(self) -> str:
        """Return the damage in words, with the shot and the damaged records counted from 1."""
        where = "" if self.shot is None else f"shot {self.shot + 1}: "
        if not self.records:
            return f"{where}{self.what}"
        ranges = [str(first + 1) if first == last else f"{first + 1} to {last + 1}" for first, last in self.records]
        return f"{where}record {', '.join(ranges)} {self.what}"


def ranges(which: BoolArray) -> tuple[tuple[int, int], ...]:
    """Return first and last index of each series of consecutive true values in ``which``.

    >>> ranges(np.array([True, True, False, True]))
    ((0, 1), (3, 3))
    """
    edges: Iterable[int] = np.flatnonzero(np.diff(np.concatenate(([False], which, [False])).astype(np.int8))).tolist()
    return tuple((first, end - 1) for number, (first, end) in enumerate(pairwise(edges)) if not number % 2)
