"""Plain test echoes: direct sums over scatterers, written from the paper's equations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray

from hpe_rig.processing import EchoGate, margin_samples

FloatArray = NDArray[np.float64]
MARGIN = margin_samples(100e6, 9e6)


@dataclass(frozen=True)
class TableOne:
    """Table I: 5 cycles of 200 Hz, 20 pulses a cycle, 1 mm gate, 9 MHz, 6.5 % bandwidth, 100 MHz, D_0 = 1 um."""

    carrier_hz: float = 9e6
    sample_rate_hz: float = 100e6
    sound_speed_m_per_s: float = 1540.0
    bandwidth: float = 0.065
    frequency_hz: float = 200.0
    amplitude_m: float = 1e-6
    phase_rad: float = 0.3
    pulses: int = 100
    pulse_rate_hz: float = 4000.0
    samples: int = 130
    margin: int = 0
    excitation_width_m: tuple[float, float, float] = (0.17e-3, 0.17e-3, 1.80e-3)
    tracking_width_m: tuple[float, float, float] = (0.078e-3, 0.078e-3, 0.83e-3)
    scatterers_per_m3: float = 11 / 0.03452e-9

    @property
    def pulse_time_s(self) -> FloatArray:
        return np.arange(self.pulses) / self.pulse_rate_hz

    def gate(self, volts: FloatArray, valid: NDArray[np.bool_] | None = None) -> EchoGate:
        everything = np.ones(volts.shape[-2], dtype=bool)
        return EchoGate(
            volts,
            self.sample_rate_hz,
            self.pulse_time_s[: volts.shape[-2]],
            self.carrier_hz,
            self.sound_speed_m_per_s,
            everything if valid is None else valid,
            (self.margin, self.margin),
        )

    def pulse(self, time_s: FloatArray, bandwidth: float) -> FloatArray:
        """Hann pulse of eq. (9) times its carrier, centred on 0."""
        inside = np.abs(time_s) < 0.5 / (bandwidth * self.carrier_hz)
        carrier = 2 * np.pi * self.carrier_hz * time_s
        return np.asarray(inside * (0.5 + 0.5 * np.cos(bandwidth * carrier)) * np.cos(carrier), dtype=np.float64)

    def gate_time_s(self) -> FloatArray:
        samples = self.samples + 2 * self.margin
        return np.asarray((np.arange(samples) - (samples - 1) / 2) / self.sample_rate_hz, dtype=np.float64)

    def rigid(self, displacement_m: FloatArray, bandwidth: float = 0.2) -> FloatArray:
        """One target in the middle of the gate, its pulse wholly inside: (pulse, sample)."""
        delay_s = 2 * displacement_m / self.sound_speed_m_per_s
        return self.pulse(self.gate_time_s() - delay_s[:, None], bandwidth)

    def speckle(
        self,
        generator: np.random.Generator,
        draws: int,
        volume_m: tuple[float, float, float] = (1e-3, 1e-3, 5e-3),
        two_way: bool = True,
    ) -> FloatArray:
        """Eqs. (8) to (13) over 5 equal cycles, with or without the delay of depth: (draw, pulse, sample)."""
        pulses = round(self.pulse_rate_hz / self.frequency_hz)
        motion = np.sin(2 * np.pi * self.frequency_hz * self.pulse_time_s[:pulses] + self.phase_rad)
        cycle = np.stack([self._draw(generator, self.amplitude_m * motion, volume_m, two_way) for _ in range(draws)])
        return np.tile(cycle, (1, self.pulses // pulses, 1))

    def _draw(
        self, generator: np.random.Generator, focus_m: FloatArray, volume_m: tuple[float, float, float], two_way: bool
    ) -> FloatArray:
        count = round(self.scatterers_per_m3 * float(np.prod(volume_m)))
        position_m = (generator.random((count, 3)) - 0.5) * np.array(volume_m)
        echo = np.exp(-((position_m / np.array(self.tracking_width_m)) ** 2).sum(axis=1) / 2)
        # scatterers under 1e-3 of the peak change no figure here and would double the time
        position_m, echo = position_m[echo > 1e-3], echo[echo > 1e-3]
        force = np.exp(-((position_m / np.array(self.excitation_width_m)) ** 2).sum(axis=1) / 2)
        rest_s = 2 * position_m[:, 2] / self.sound_speed_m_per_s * two_way
        delay_s = rest_s + 2 * focus_m[:, None] * force / self.sound_speed_m_per_s
        return np.stack([self._echo(row, echo) for row in delay_s])

    def _echo(self, delay_s: FloatArray, echo: FloatArray) -> FloatArray:
        """``pulse`` at every delay, (sample, scatterer), times ``echo``, in a third of the time.

        The cosine of a difference of times is a product of their cosines and sines.
        """
        time_s, turns = self.gate_time_s(), 2 * np.pi * self.carrier_hz
        inside = np.abs(time_s[:, None] - delay_s) < 0.5 / (self.bandwidth * self.carrier_hz)
        carrier, hann = (
            _cos_and_sin(rate * time_s).T @ _cos_and_sin(rate * delay_s) for rate in (turns, self.bandwidth * turns)
        )
        hann += 1
        hann *= carrier
        hann *= inside
        return np.asarray(hann @ (echo / 2))


def _cos_and_sin(phase_rad: FloatArray) -> FloatArray:
    return np.stack([np.cos(phase_rad), np.sin(phase_rad)])


@pytest.fixture(scope="session")
def table_one() -> TableOne:
    return TableOne()


@pytest.fixture(scope="session")
def wide() -> TableOne:
    """Table I, each record reaching beyond the gate on both sides."""
    return TableOne(margin=MARGIN)


@pytest.fixture(scope="session")
def wide_draws(wide: TableOne) -> FloatArray:
    """Echoes of 30 scatterer draws with their margins, noise-free: (draw, pulse, sample)."""
    return wide.speckle(np.random.default_rng(20), 30)


@pytest.fixture(scope="session")
def speckle_draws(wide: TableOne, wide_draws: FloatArray) -> FloatArray:
    """Echoes of the same draws in the gate only, without margins."""
    return np.ascontiguousarray(wide_draws[..., wide.margin : -wide.margin])
