"""Delays of the echoes of moving scatterers, and the refusal of numbers that make no echo."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from sim_backend.arrays import ComplexArray, FloatArray, Int64Array
from sim_backend.echoes.pulse import Pulse

ALIKE_SHARE = 0.01
"""Of the tolerance, for echoes that are taken for the same one."""


@dataclass(frozen=True, slots=True)
class EchoDelays:
    """Delays of the echoes of scatterers that move in few spatial shapes: delay = rest + amplitude @ shape.

    A standing motion has one shape; a travelling wave of one frequency two (in phase and in quadrature), a medium's own
    field one a mode; pulses that come late add a shape of ones. As many shapes as scatterers stand for any delays.
    """

    rest_s: FloatArray
    """(scatterer,), the echo delay at rest."""
    shape: FloatArray
    """(shape, scatterer)"""
    amplitude_s: FloatArray
    """(echo, shape), delay where the shape is 1: 2 A / c."""
    colour: ComplexArray | None = None
    """(frequency, scatterer), what the echo has of every frequency of the pulse; None: all alike."""

    @property
    def echo_count(self) -> int:
        """How many echoes."""
        return len(self.amplitude_s)

    def range_s(self) -> tuple[FloatArray, FloatArray]:
        """Return bounds on each scatterer's earliest and latest delay, (scatterer,)."""
        reach_s = float(np.abs(self.amplitude_s).max(axis=0) @ np.abs(self.shape).max(axis=1))
        return self.rest_s - reach_s, self.rest_s + reach_s

    def of(self, part: Int64Array) -> EchoDelays:
        """Return the same of some scatterers."""
        colour = None if self.colour is None else self.colour[:, part]
        return EchoDelays(self.rest_s[part], self.shape[:, part], self.amplitude_s, colour)

    def delay_s(self) -> FloatArray:
        """Return the delay of every scatterer in every echo, (echo, scatterer)."""
        return self.rest_s + self.amplitude_s @ self.shape

    def parts(self, pairs_at_once: int) -> Iterator[FloatArray]:
        """Yield the delays of some echoes at a time, (echo, scatterer), about ``pairs_at_once`` of them."""
        at_once = max(1, pairs_at_once // max(1, len(self.rest_s)))
        for first in range(0, len(self.amplitude_s), at_once):
            yield self.rest_s + self.amplitude_s[first : first + at_once] @ self.shape

    def about_middle(self) -> EchoDelays:
        """Return the same motion about the middle of its range, where the series is shortest."""
        high, low = self.amplitude_s.max(axis=0), self.amplitude_s.min(axis=0)
        middle_s = (high + low) / 2
        # A small offset costs no term, moving every delay would.
        if (np.abs(middle_s) <= 0.05 * (high - low)).all():
            return self
        return EchoDelays(self.rest_s + middle_s @ self.shape, self.shape, self.amplitude_s - middle_s, self.colour)


def distinct_echoes(
    amplitude_s: FloatArray, shape: FloatArray, pulse: Pulse, tolerance: float
) -> tuple[Int64Array, Int64Array]:
    """Return one echo of each kind, (kind,), and the kind of each echo, (echo,).

    ``amplitude_s`` (echo, shape) and ``shape`` (shape, scatterer) as in `EchoDelays`. Echoes of a kind differ by less
    than `ALIKE_SHARE` of ``tolerance``: no scatterer's delay turns the pulse's highest frequency any further. A
    periodic motion that is tracked at a whole number of pulses a period has that many kinds, however long it lasts.
    """
    highest_rad_per_s = 2 * np.pi * max(abs(hz) for hz in pulse.frequency_hz)
    turn_per_s = highest_rad_per_s * np.abs(shape).max(axis=1, initial=0.0) * len(shape)
    step = np.rint(amplitude_s * (turn_per_s / (ALIKE_SHARE * tolerance))) if tolerance else amplitude_s
    order = np.lexsort(step.T)
    new = np.ones(len(order), dtype=np.bool_)
    new[1:] = (step[order[1:]] != step[order[:-1]]).any(axis=1)
    kind = np.empty(len(order), dtype=np.int64)
    kind[order] = np.cumsum(new) - 1
    return order[new], kind


def refuse_unusable(delays: EchoDelays, weight: FloatArray, sample_time_s: FloatArray, tolerance: float) -> None:
    """Raise ValueError for what `refuse_numbers` and `refuse_misfits` say of a motion."""
    axes = {"rest_s": "scatterer", "shape": "shape, scatterer", "amplitude_s": "echo, shape"}
    named = {name: getattr(delays, name) for name in axes} | {"weight": weight}
    refuse_misfits(named, axes | {"weight": "scatterer"})
    refuse_numbers(named, sample_time_s, tolerance)


def refuse_misfits(named: dict[str, FloatArray], axes: dict[str, str]) -> None:
    """Raise ValueError where an array lacks an axis or two disagree about the length of one."""
    length: dict[str, tuple[str, int]] = {}
    for name, value in named.items():
        own = axes[name].split(", ")
        if value.ndim != len(own):
            raise ValueError(f"{name} has shape {value.shape}: its axes must be ({axes[name]})")
        for axis, size in zip(own, value.shape, strict=True):
            first, known = length.setdefault(axis, (name, size))
            if size != known:
                raise ValueError(
                    f"{name} is {size} long along its axis '{axis}' and {first} {known}: give each {axis} one of both"
                )


def refuse_numbers(named: dict[str, FloatArray], sample_time_s: FloatArray, tolerance: float) -> None:
    """Raise ValueError for numbers that are not finite, by name and place, and for sample times that do not ascend."""
    for name, value in (named | {"sample_time_s": sample_time_s, "tolerance": np.array([tolerance])}).items():
        finite = np.isfinite(value)
        if not finite.all():
            place = tuple(np.argwhere(~finite)[0].tolist())
            raise ValueError(f"{name}{list(place)} is {value[place]}: every number that makes an echo must be finite")
    if tolerance < 0:
        raise ValueError(f"tolerance is {tolerance}: take 0 for exact sums or a relative error such as 1e-6")
    if (np.diff(sample_time_s) <= 0).any():
        raise ValueError("sample_time_s must ascend: sort the sample times")


def refuse_aliasing(pulse: Pulse, sample_time_s: FloatArray) -> None:
    """Raise ValueError where the samples are too far apart for the pulse's highest frequency."""
    if len(sample_time_s) < 2:
        return
    rate_hz = (len(sample_time_s) - 1) / float(sample_time_s[-1] - sample_time_s[0])
    highest_hz = max(abs(hz) for hz in pulse.frequency_hz)
    if rate_hz <= 2 * highest_hz:
        raise ValueError(
            f"the sample rate of {rate_hz / 1e6:.4g} MHz is below twice the pulse's highest frequency of "
            f"{highest_hz / 1e6:.4g} MHz, so echoes would alias: sample above {2 * highest_hz / 1e6:.4g} MHz or take a "
            "narrower pulse"
        )
