"""Delays of the echoes of moving scatterers, eq. (10) and (11) of the paper.

tau_kn = tau_n + sum_r b_kr g_rn        b_kr = 2 A_kr / c

k, n, r       echo, scatterer, shape of the motion
tau_n         delay at rest, s
A_kr, g_rn    amplitude of the motion, m; shape of the motion, 1
c             sound speed, m/s
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from sim_backend.arrays import ComplexArray, FloatArray, Int64Array
from sim_backend.echoes.pulse import Pulse

EQUAL_ECHO_FRACTION = 0.01
"""Fraction of the tolerance below which two echoes count as equal."""


@dataclass(frozen=True, slots=True)
class EchoDelays:
    """Delays of scatterers that move in few spatial shapes: delay = rest + amplitude @ shape.

    A prescribed motion has one shape; a travelling wave of one frequency two (in phase and in quadrature); a medium's
    field one for each mode. As many shapes as scatterers describe any delays.
    """

    rest_s: FloatArray
    """(scatterer,), the echo delay at rest."""
    shape: FloatArray
    """(shape, scatterer)"""
    amplitude_s: FloatArray
    """(echo, shape), delay where the shape is 1: 2 A / c."""
    response: ComplexArray | None = None
    """(frequency, scatterer), relative response of the beam at each frequency of the pulse; None: 1."""

    @classmethod
    def of_motion(
        cls,
        rest_s: FloatArray,
        motion_weight: FloatArray,
        displacement_m: FloatArray,
        sound_speed_m_per_s: float,
        response: ComplexArray | None = None,
    ) -> EchoDelays:
        """Return the echo delays of scatterers in motion, eq. (11) of the paper: rest delay plus 2 displacement / c.

        ``motion_weight`` (scatterer,): displacement over that of the focus. ``displacement_m`` (echo,): of the focus.
        With several spatial shapes they are (shape, scatterer) and (echo, shape). ``response``: of the beam at each
        frequency.
        """
        shape = np.atleast_2d(motion_weight)
        displacement_m = displacement_m.reshape(len(displacement_m), len(shape))
        amplitude_s = displacement_m * (2 / sound_speed_m_per_s)
        return cls(rest_s=rest_s, shape=shape, amplitude_s=amplitude_s, response=response)

    @property
    def echo_count(self) -> int:
        """Number of echoes."""
        return len(self.amplitude_s)

    def max_change_s(self) -> float:
        """Return a bound on the change of any delay by the motion."""
        return float(np.abs(self.amplitude_s).max(axis=0) @ np.abs(self.shape).max(axis=1))

    def selected(self, scatterers: Int64Array | slice) -> EchoDelays:
        """Return the delays of the scatterers with the indices ``scatterers``."""
        response = None if self.response is None else self.response[:, scatterers]
        return replace(self, rest_s=self.rest_s[scatterers], shape=self.shape[:, scatterers], response=response)

    def shifted(self, shift_s: FloatArray) -> EchoDelays:
        """Return the delays relative to sample times that are later by ``shift_s`` (echo,).

        The delays (echo, scatterer) are ``rest_s + amplitude_s @ shape``.
        """
        if not shift_s.any():
            return self
        # Later sample times shorten the delays of all scatterers equally: one more shape, of ones, with the
        # amplitude -shift_s.
        shape = np.concatenate([self.shape, np.ones((1, self.shape.shape[1]))])
        amplitude_s = np.concatenate([self.amplitude_s, -shift_s[:, None]], axis=1)
        return replace(self, shape=shape, amplitude_s=amplitude_s)

    def delay_s(self) -> FloatArray:
        """Return the delay of every scatterer in every echo, (echo, scatterer)."""
        return self.rest_s + self.amplitude_s @ self.shape

    def chunks(self, max_pairs: int) -> Iterator[FloatArray]:
        """Yield the delays of consecutive echoes, (echo, scatterer), in arrays of about ``max_pairs`` values."""
        echoes_per_chunk = max(1, max_pairs // max(1, len(self.rest_s)))
        for first in range(0, len(self.amplitude_s), echoes_per_chunk):
            yield self.rest_s + self.amplitude_s[first : first + echoes_per_chunk] @ self.shape

    def centred(self) -> EchoDelays:
        """Return the same delays with the rest position in the middle of the motion, where the series is shortest."""
        high, low = self.amplitude_s.max(axis=0), self.amplitude_s.min(axis=0)
        middle_s = (high + low) / 2
        # A small offset costs no term of the series, but moving every delay costs time.
        if (np.abs(middle_s) <= 0.05 * (high - low)).all():
            return self
        return replace(self, rest_s=self.rest_s + middle_s @ self.shape, amplitude_s=self.amplitude_s - middle_s)


def distinct_echoes(
    amplitude_s: FloatArray, shape: FloatArray, pulse: Pulse, tolerance: float
) -> tuple[Int64Array, Int64Array]:
    """Return the index of one echo of each group of equal echoes, (group,), and the group of each echo, (echo,).

    The delay of a scatterer changes by ``amplitude_s`` (echo, shape) times ``shape`` (shape, scatterer). Within a group
    no scatterer's delay changes the phase of the pulse's highest frequency by more than `EQUAL_ECHO_FRACTION` of
    ``tolerance``, the relative error of an echo. Only one echo of a group has to be computed: of a periodic motion with
    n pulses per period there are n groups, however long it lasts.
    """
    highest_rad_per_s = 2 * np.pi * max(abs(hz) for hz in pulse.frequency_hz)
    # Phase for a unit of each amplitude, (shape,), at the scatterer that moves most. The shapes share the tolerance
    # equally, hence times their number.
    phase_rad_per_s = highest_rad_per_s * np.abs(shape).max(axis=1, initial=0.0) * len(shape)
    # Amplitudes rounded to multiples of the largest negligible difference; equal rows are one group.
    rounded = np.rint(amplitude_s * (phase_rad_per_s / (EQUAL_ECHO_FRACTION * tolerance))) if tolerance else amplitude_s
    # Equal rows become neighbours by sorting; each change starts a new group.
    order = np.lexsort(rounded.T)
    is_new = np.ones(len(order), dtype=np.bool_)
    is_new[1:] = (rounded[order[1:]] != rounded[order[:-1]]).any(axis=1)
    group = np.empty(len(order), dtype=np.int64)
    group[order] = np.cumsum(is_new) - 1
    return order[is_new], group


def check_sample_rate(pulse: Pulse, sample_time_s: FloatArray) -> None:
    """Raise ValueError if the samples are too far apart for the pulse's highest frequency."""
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
