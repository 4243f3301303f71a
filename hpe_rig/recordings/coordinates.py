"""Rows and columns of a table that are times or indices instead of echoes: linear, with a positive step.

A table of echoes often has the times of its samples as first column, or the numbers of its pulses as first row. The
records of an oscilloscope may begin at different fractions of a sample after their triggers.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hpe_rig.arrays import FloatArray

MIN_LENGTH = 8
"""Values below which a linear sequence may be a record by chance."""
MAX_DEVIATION, MAX_ROUNDING = 0.05, 5e-6
"""Largest deviation from a line, in steps, or of the largest value: times are printed with six digits or more."""
MAX_OFFSET = 2.0
"""Largest difference of first-sample times that interpolation removes, in samples: ends of the records are lost."""
MIN_OFFSET = 1e-4
"""Difference of first-sample times without effect, in samples: 0.1 nm at 500 MS/s."""


@dataclass(frozen=True, slots=True)
class Coordinate:
    """Linear sequence of a table: ``step`` and, for each of its equal records, the first value ``starts`` (record,)."""

    step: float
    starts: FloatArray
    record_length: int

    @property
    def is_index(self) -> bool:
        """Whether the values are consecutive integers."""
        return self.step == 1 and bool(np.all(self.starts == np.round(self.starts)))


def find_coordinate(values: NDArray[Any]) -> Coordinate | None:
    """Return the coordinate in ``values`` (row,), which may restart with each record; None if it is not linear."""
    if values.size < MIN_LENGTH or values.dtype.kind not in "iuf" or not np.isfinite(values).all():
        return None
    values = values.astype(np.float64)
    restarts = np.flatnonzero(np.diff(values) < 0) + 1
    length = int(restarts[0]) if restarts.size else values.size
    if length < MIN_LENGTH or values.size % length or restarts.size != values.size // length - 1:
        return None
    records = values.reshape(-1, length)
    step = float(np.median((records[:, -1] - records[:, 0]) / (length - 1)))
    line = records[:, :1] + step * np.arange(length)
    # Half a step is left of a step that is lost in rounding; a row that is absent deviates by as much.
    tolerance = min(0.499 * step, max(MAX_DEVIATION * step, MAX_ROUNDING * float(np.abs(values).max())))
    if step <= 0 or np.abs(records - line).max() > tolerance:
        return None
    # Printed times have no more digits.
    return Coordinate(float(f"{step:.9g}"), np.asarray(records[:, 0]), length)


def align_records(records: NDArray[Any], offset_samples: FloatArray) -> tuple[NDArray[Any], str]:
    """Return ``records`` (record, ..., sample) as if all had begun with the first one, and a sentence about it.

    ``offset_samples`` (record,): how much later than the first record each one begins. Differences of up to two samples
    are removed by the shift theorem of the Fourier transform. The sentence is empty if nothing had to be changed.
    Raises ``ValueError`` for larger differences.
    """
    largest = float(np.abs(offset_samples).max())
    if largest <= MIN_OFFSET:
        return records, ""
    if largest > MAX_OFFSET:
        raise ValueError(
            f"records begin up to {largest:.4g} samples apart after their triggers: records with the same delay"
        )
    length = records.shape[-1]
    delay = offset_samples.reshape(-1, *[1] * (records.ndim - 1))
    phasor = np.exp(-2j * np.pi * np.fft.fftfreq(length) * delay)
    shifted: NDArray[Any] = np.fft.ifft(np.fft.fft(records, axis=-1) * phasor, axis=-1)
    shifted = shifted if np.iscomplexobj(records) else shifted.real
    return (
        shifted,
        f"records begin up to {largest:.3g} samples apart after their triggers: shifted to one time",
    )
