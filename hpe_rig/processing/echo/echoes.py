"""Gated echoes, displacement and velocity: the values that every motion estimator shares."""

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
"""Carrier periods before and behind a gate that are read with it, if they are there."""

BLOCK_SAMPLES = 1 << 21
"""Samples of a block of volts that are not all held at once."""

EDGE_PERIODS = 11.7
EDGE_WITH_MARGIN, EDGE_WITHOUT_MARGIN, EDGE_WINDOWED = 5e-5, 7e-4, 3.6e-3
"""Relative errors that the edges leave in a gate of so many carrier periods (1 mm at 9 MHz)."""


class VoltsInBlocks(Protocol):
    """Volts (pulse, sample), float32, that are made a block of pulses at a time, for trains too long to be held.

    ``block`` returns those of some pulses; ``energy`` (pulse,) is that of the gate, V^2. Indexed like an array they are
    made as a whole.
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
    """Gated echoes of one train, ready for estimation, with what of each record lies around the gate.

    ``volts`` (..., pulse, sample): leading axes are independent realisations. ``margin``: how many of these samples
    come before the gate and how many behind it; with ``margin_samples`` of them the gate's edges cost nothing (see
    `band.band_spectrum`). ``pulse_time_s`` (pulse,): when each pulse senses the displacement (fired plus z/c),
    increasing. ``valid`` (pulse,): False where a record is missing or flagged; the samples of such a pulse do not
    matter. ``energy`` (..., pulse): the gate's, V^2.

    Any real type and byte order is taken, also volts that are made in blocks: ``volts`` become float32 where they fit
    into it, else float64, times float64.
    A realisation with samples that are not finite has NaN for a result. Raises ``TypeError`` for what is no real number
    and ``ValueError`` where shapes or values do not fit, or no realisation is finite.
    """

    volts: Volts | VoltsInBlocks
    sample_rate_hz: float
    pulse_time_s: FloatArray
    carrier_hz: float
    sound_speed_m_per_s: float
    valid: BoolArray
    margin: tuple[int, int] = (0, 0)
    energy: FloatArray = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        if not hasattr(self.volts, "block"):
            object.__setattr__(self, "volts", _native(np.asarray(self.volts), "volts"))
        object.__setattr__(self, "pulse_time_s", _native(self.pulse_time_s, "pulse_time_s").astype(float, copy=False))
        self._refuse_misfits()
        self._refuse_settings()
        volts = self.volts
        energy = pulse_energy(self.gate_volts) if isinstance(volts, np.ndarray) else volts.energy
        object.__setattr__(self, "energy", energy)
        if not np.isfinite(self.energy[..., self.valid]).all(axis=-1).any():
            raise ValueError("a pulse marked valid holds samples that are not finite: mark it invalid or read it again")

    def _refuse_misfits(self) -> None:
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
        if not 0 < self.carrier_hz < self.sample_rate_hz / 2 < np.inf:
            raise ValueError(
                f"a carrier of {self.carrier_hz:g} Hz does not lie between 0 and half the sampling rate, "
                f"{self.sample_rate_hz / 2:g} Hz: one of them is wrong, or its unit"
            )
        if not 0 < self.sound_speed_m_per_s < np.inf:
            raise ValueError(f"a sound speed of {self.sound_speed_m_per_s:g} m/s: it must be positive and finite")

    @property
    def gate(self) -> slice:
        """The gate's part of the samples."""
        return slice(self.margin[0], self.volts.shape[-1] - self.margin[1])

    @property
    def gate_volts(self) -> Volts:
        """The gate's samples, (..., pulse, sample)."""
        return self.volts[..., self.gate]

    @property
    def gate_samples(self) -> int:
        """How many samples the gate has."""
        return int(self.gate.stop - self.gate.start)

    def blocks(self, samples: slice) -> Iterator[tuple[slice, Volts]]:
        """Yield some ``samples`` of pulses, (..., pulse, sample), and which pulses; all at once where they are held."""
        if isinstance(self.volts, np.ndarray):
            yield slice(0, self.valid.size), self.volts[..., samples]
            return
        step = max(1, BLOCK_SAMPLES // self.volts.shape[-1])
        for first in range(0, self.valid.size, step):
            pulses = slice(first, min(first + step, self.valid.size))
            yield pulses, self.volts.block(pulses)[..., samples]

    def without(self, pulses: BoolArray) -> EchoGate:
        """Return the same gate, its ``pulses`` (pulse,) no longer valid."""
        fewer = copy(self)
        object.__setattr__(fewer, "valid", self.valid & ~pulses)
        return fewer


@dataclass(frozen=True, slots=True)
class Motion:
    """Displacement per pulse, up to a constant.

    ``time_s`` (pulse,); ``displacement_m`` (..., pulse), NaN where not valid; ``variance_m2`` (..., pulse), from the
    echoes' own scatter, not from the displacement; ``valid`` (pulse,). ``largest_step`` (...): the largest change
    between consecutive valid pulses in quarter wavelengths: near 1 the next period cannot be told from this one.
    ``walk`` (...): where the displacement is a sum of steps, the variance of the noise that is a step's own and adds up
    from pulse to pulse, over that of a pulse; None where each pulse stands for itself.
    """

    time_s: FloatArray
    displacement_m: FloatArray
    variance_m2: FloatArray
    valid: BoolArray
    largest_step: FloatArray | float = 0.0
    walk: FloatArray | None = None


@dataclass(frozen=True, slots=True)
class Velocity:
    """Mean velocity between consecutive pulses; interval n lies between pulses n and n + 1.

    ``time_s`` (interval,): its middle; ``interval_s`` (interval,): its length; ``velocity_m_per_s`` (..., interval),
    NaN where not valid; ``valid`` (interval,): both pulses are there.
    """

    time_s: FloatArray
    interval_s: FloatArray
    velocity_m_per_s: FloatArray
    valid: BoolArray


def velocity_between_pulses(motion: Motion) -> Velocity:
    """Return the mean velocity of every interval whose two pulses are valid."""
    interval_s = np.diff(motion.time_s)
    return Velocity(
        motion.time_s[:-1] + interval_s / 2,
        interval_s,
        np.diff(motion.displacement_m, axis=-1) / interval_s,
        motion.valid[:-1] & motion.valid[1:],
    )


def relative_to(motion: Motion, reference: Motion) -> Motion:
    """Return ``motion`` less that of a ``reference`` that stands still, at the pulses valid in both; variances add.

    Both come from the same records: a pulse fired late, or a clock read late, delays every echo of a record alike, so
    that the trigger jitter that both share cancels.
    Raises ``ValueError`` where their pulses differ.
    """
    if not np.array_equal(motion.time_s, reference.time_s):
        raise ValueError("motion and reference stand at different times: estimate both from the same records")
    walks = [each.walk for each in (motion, reference) if each.walk is not None]
    return Motion(
        motion.time_s,
        motion.displacement_m - reference.displacement_m,
        motion.variance_m2 + reference.variance_m2,
        motion.valid & reference.valid,
        motion.largest_step,
        np.asarray(sum(walks) / 2) if walks else None,
    )


def margin_samples(sample_rate_hz: float, carrier_hz: float) -> int:
    """Return how many samples before and behind the gate an estimator makes use of."""
    return math.ceil(MARGIN_PERIODS * sample_rate_hz / carrier_hz)


def gate_edge_relative(echoes: EchoGate, gate_window: str = "none") -> float:
    """Return the relative standard uncertainty of an amplitude that the gate's edges leave.

    Measured on rigid motion of 1 um at 6.5 % bandwidth over 1000 draws of scatterers; it falls with the gate's length.
    A ``gate_window`` is cut before the echoes are aligned, as the paper does, whatever margins there are.
    Source: the table "The gate's edge" in docs/explanation/estimation.md.
    """
    periods = echoes.gate_samples / echoes.sample_rate_hz * echoes.carrier_hz
    if gate_window != "none":
        return float(EDGE_WINDOWED * EDGE_PERIODS / periods)
    wanted = margin_samples(echoes.sample_rate_hz, echoes.carrier_hz)
    share = min(min(echoes.margin) / wanted, 1.0)
    # between no margin and all that is wanted the error falls about as a geometric series
    return float(EDGE_WITHOUT_MARGIN * (EDGE_WITH_MARGIN / EDGE_WITHOUT_MARGIN) ** share * EDGE_PERIODS / periods)


def valid_volts(echoes: EchoGate) -> Volts:
    """Return the echoes (..., valid pulse, sample); no copy where every pulse is valid."""
    volts = echoes.volts[...]
    return volts if echoes.valid.all() else volts[..., echoes.valid, :]


def pulse_energy(volts: Volts) -> FloatArray:
    """Return the energy (...) of volts (..., sample), in the precision that these have."""
    with np.errstate(invalid="ignore"):
        return np.asarray(np.einsum("...i,...i->...", volts, volts), dtype=np.float64)


def scatter(values: FloatArray, valid: BoolArray) -> FloatArray:
    """Return values (..., valid pulse) at their places among all pulses, NaN elsewhere."""
    if valid.all():
        return values
    placed = np.full((*values.shape[:-1], valid.size), np.nan)
    placed[..., valid] = values
    return placed


def _native(values: NDArray[Any], name: str) -> NDArray[np.floating[Any]]:
    """Return real ``values`` in this machine's byte order, float32 where no digit is lost, else float64."""
    found = np.asarray(values)
    if found.dtype.kind not in "iuf":
        raise TypeError(f"{name} of type {found.dtype}: real numbers are needed")
    single = np.can_cast(found.dtype, np.float32)
    return found.astype(np.float32 if single else np.float64, copy=False)
