"""Echoes of one pulse train in a range gate: the input of every motion estimator."""

from __future__ import annotations

import math
from collections.abc import Iterator
from copy import copy
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from hpe_rig.arrays import BoolArray, FloatArray

Volts = NDArray[np.floating[Any]]

MARGIN_PERIODS = 6.0
"""Carrier periods read before and after the gate, if the record holds them."""
BLOCK_SAMPLES = 1 << 21
"""Samples per block of volts of a train too long to be held in memory."""


class BlockedVolts(Protocol):
    """Volts (pulse, sample), float32, computed one block of pulses at a time, for trains too long for memory.

    ``block`` returns the volts of some pulses; ``energy`` (pulse,) is the energy in the gate, V². Indexing computes all
    volts.
    """

    energy: FloatArray

    @property
    def shape(self) -> tuple[int, int]: ...
    @property
    def ndim(self) -> int: ...
    @property
    def dtype(self) -> np.dtype[np.float32]: ...
    def block(self, pulses: slice) -> Volts: ...
    def __getitem__(self, index: Any) -> Volts: ...


@dataclass(frozen=True, slots=True)
class EchoGate:
    """Echoes of one train in a range gate, with the samples around it.

    ``volts`` (..., pulse, sample): leading axes are independent realisations. ``margin``: samples before and after the
    gate; with ``margin_samples`` of them the gate's edges cause no error (see `band.Band`). ``pulse_time_s`` (pulse,):
    when each pulse senses the displacement (fired plus z/c), increasing. ``valid`` (pulse,): False if a record is
    missing or flagged; its samples are ignored. ``energy`` (..., pulse): in the gate, V².

    Volts and times may have any real type and byte order. Volts become float32 if it represents them exactly, else
    float64. A realisation with samples that are not finite gives NaN. Raises ``TypeError`` for values that are not real
    numbers, ``ValueError`` if shapes or values do not fit or no realisation is finite.
    """

    volts: Volts | BlockedVolts
    sample_rate_hz: float
    pulse_time_s: FloatArray
    carrier_hz: float
    sound_speed_m_per_s: float
    valid: BoolArray
    margin: tuple[int, int] = (0, 0)
    energy: FloatArray = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Convert the arrays to native types, check them and the settings, and compute the energy of each pulse."""
        if not hasattr(self.volts, "block"):
            object.__setattr__(self, "volts", _native(np.asarray(self.volts), "volts"))
        object.__setattr__(self, "pulse_time_s", _native(self.pulse_time_s, "pulse_time_s").astype(float, copy=False))
        self._refuse_misfits()
        self._refuse_settings()
        volts = self.volts
        energy = _pulse_energy(self.gate_volts) if isinstance(volts, np.ndarray) else volts.energy
        object.__setattr__(self, "energy", energy)
        if not np.isfinite(self.energy[..., self.valid]).all(axis=-1).any():
            raise ValueError("a pulse marked valid holds samples that are not finite: mark it invalid or read it again")

    def _refuse_misfits(self) -> None:
        """Raise an error if shapes, types or margins of the arrays contradict each other, or times do not increase."""
        pulses = self.volts.shape[-2] if self.volts.ndim >= 2 else 0
        if pulses == 0 or self.pulse_time_s.shape != (pulses,) or self.valid.shape != (pulses,):
            raise ValueError(
                f"volts {self.volts.shape}, pulse_time_s {self.pulse_time_s.shape} and valid {self.valid.shape} do not "
                "fit: volts needs the axes (..., pulse, sample), the others (pulse,)"
            )
        if self.valid.dtype != np.bool_:
            raise TypeError(f"valid of type {self.valid.dtype}: it needs True or False for every pulse")
        if min(self.margin) < 0 or sum(self.margin) >= self.volts.shape[-1]:
            raise ValueError(f"margins of {self.margin} samples leave no gate in records of {self.volts.shape[-1]}")
        if not np.all(np.diff(self.pulse_time_s) > 0):
            raise ValueError("pulse_time_s does not increase: records are out of order; sort them by pulse time")

    def _refuse_settings(self) -> None:
        """Raise ``ValueError`` for an impossible carrier or sound speed."""
        if not 0 < self.carrier_hz < self.sample_rate_hz / 2 < np.inf:
            raise ValueError(
                f"a carrier of {self.carrier_hz:g} Hz does not lie between 0 and half the sampling rate, "
                f"{self.sample_rate_hz / 2:g} Hz: one of them is wrong, or its unit"
            )
        if not 0 < self.sound_speed_m_per_s < np.inf:
            raise ValueError(f"a sound speed of {self.sound_speed_m_per_s:g} m/s: it must be positive and finite")

    @property
    def gate(self) -> slice:
        """The samples of the gate."""
        return slice(self.margin[0], self.volts.shape[-1] - self.margin[1])

    @property
    def gate_volts(self) -> Volts:
        """Volts in the gate, (..., pulse, sample)."""
        return self.volts[..., self.gate]

    @property
    def gate_samples(self) -> int:
        """Number of samples in the gate."""
        return int(self.gate.stop - self.gate.start)

    def blocks(self, samples: slice) -> Iterator[tuple[slice, Volts]]:
        """Yield blocks of pulses, each with its volts (..., pulse, sample) at ``samples``.

        Volts held in memory are one block; long trains are converted from codes block by block.
        """
        if isinstance(self.volts, np.ndarray):
            yield slice(0, self.valid.size), self.volts[..., samples]
            return
        step = max(1, BLOCK_SAMPLES // self.volts.shape[-1])
        for first in range(0, self.valid.size, step):
            pulses = slice(first, min(first + step, self.valid.size))
            yield pulses, self.volts.block(pulses)[..., samples]

    def without(self, pulses: BoolArray) -> EchoGate:
        """Return the same echoes with ``pulses`` (pulse,) marked invalid."""
        remaining = copy(self)
        object.__setattr__(remaining, "valid", self.valid & ~pulses)
        return remaining

    def edge_uncertainty(self, gate_window: str = "none") -> float:
        """Return the relative standard uncertainty of an amplitude caused by the edges of the gate.

        Fitted to rigid motion of 1 um at 6.5 % bandwidth, 1000 draws of scatterers, in a gate of 11.7 carrier periods
        (1 mm at 9 MHz): 5e-5 with full margins, 7e-4 without, 3.6e-3 if a ``gate_window`` cuts the echoes before they
        are aligned. It falls as the inverse of the gate's length.
        Source: the table "The gate's edge" in docs/explanation/estimation.md.
        """
        periods = self.gate_samples / self.sample_rate_hz * self.carrier_hz
        if gate_window != "none":
            relative = 3.6e-3
        else:
            full_margin = margin_samples(self.sample_rate_hz, self.carrier_hz)
            margin_fraction = min(min(self.margin) / full_margin, 1.0)
            # Between no margin and a full one the error falls about geometrically.
            relative = 7e-4 * (5e-5 / 7e-4) ** margin_fraction
        return float(relative * 11.7 / periods)


def margin_samples(sample_rate_hz: float, carrier_hz: float) -> int:
    """Return the number of samples before and after the gate that an estimator can use."""
    return math.ceil(MARGIN_PERIODS * sample_rate_hz / carrier_hz)


def expand_to_pulses(values: FloatArray, valid: BoolArray) -> FloatArray:
    """Return ``values`` (..., valid pulse) with NaN inserted at the invalid pulses: (..., pulse)."""
    if valid.all():
        return values
    expanded = np.full((*values.shape[:-1], valid.size), np.nan)
    expanded[..., valid] = values
    return expanded


def _pulse_energy(volts: Volts) -> FloatArray:
    """Return the energy (...) of volts (..., sample), summed in their own precision."""
    with np.errstate(invalid="ignore"):
        return np.asarray(np.einsum("...i,...i->...", volts, volts), dtype=np.float64)


def _native(values: NDArray[Any], name: str) -> NDArray[np.floating[Any]]:
    """Return real ``values`` in native byte order, float32 if it represents their type exactly, else float64."""
    array = np.asarray(values)
    if array.dtype.kind not in "iuf":
        raise TypeError(f"{name} of type {array.dtype}: real numbers are needed")
    single = np.can_cast(array.dtype, np.float32)
    return array.astype(np.float32 if single else np.float64, copy=False)
