"""Plane waves of finite amplitude: the step from harmonics to harmonics that every nonlinear beam is made of.

    dp_n/dz = j n w beta / (2 rho c^3) * (harmonic n of p^2),          p(t) = Re sum_n p_n exp(j n w t)

Burgers' equation without its losses, which the beam applies where it diffracts. A truncated series conserves energy, so
what a shock would turn into heat piles up in the last harmonics: `advance` damps these in proportion to the rate at
which the wave steepens, and says how much that took. By weak shock theory a shock's loss does not depend on what makes
it, so this is the loss of the harmonics that are not carried. docs/explanation/nonlinear.md, section 1.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sim_backend.arrays import ComplexArray, FloatArray

DB_PER_CM_TO_NP_PER_M = 100 * math.log(10) / 20
# Of the harmonics carried, the share that is not damped, and how fast the last is, over its own rate of steepening.
_UNDAMPED, _DAMPING = 0.4, 1.0
# n w beta p h / (rho c^3) of the last harmonic in one Runge-Kutta step: stable to 2.8.
_STEP = 1.0


@dataclass(frozen=True, slots=True)
class Layer:
    """A homogeneous medium between two planes across the beam."""

    thickness_m: float
    sound_speed_m_per_s: float
    density_kg_per_m3: float
    nonlinearity: float
    """Coefficient beta = 1 + B/2A."""
    attenuation_db_per_cm_mhz: float
    """Attenuation at 1 MHz; it grows as frequency to ``attenuation_power``."""
    attenuation_power: float

    @property
    def impedance(self) -> float:
        """Characteristic impedance rho c, Pa s/m."""
        return self.density_kg_per_m3 * self.sound_speed_m_per_s

    def attenuation_np_per_m(self, frequency_hz: FloatArray) -> FloatArray:
        """Return the attenuation at ``frequency_hz``, any shape."""
        loss_np_per_m = self.attenuation_db_per_cm_mhz * DB_PER_CM_TO_NP_PER_M
        return np.asarray(loss_np_per_m * (frequency_hz * 1e-6) ** self.attenuation_power)

    def wave_number(self, frequency_hz: FloatArray, reference_hz: float) -> ComplexArray:
        """Return k - j alpha, any shape, with the dispersion that causality demands; c holds at ``reference_hz``."""
        w, w0 = 2 * np.pi * frequency_hz, 2 * np.pi * reference_hz
        y = self.attenuation_power
        # alpha = a0 w^y, w in rad/s.
        a0 = self.attenuation_db_per_cm_mhz * DB_PER_CM_TO_NP_PER_M / (2e6 * np.pi) ** y
        if y == 1:
            slowness = -2 / np.pi * a0 * np.log(w / w0)
        else:
            slowness = a0 * math.tan(math.pi * y / 2) * (w ** (y - 1) - w0 ** (y - 1))
        return np.asarray(w * (1 / self.sound_speed_m_per_s + slowness) - 1j * self.attenuation_np_per_m(frequency_hz))


def advance(
    pressure_pa: ComplexArray, step_m: float, frequency_hz: float, layer: Layer
) -> tuple[ComplexArray, FloatArray]:
    """Return the harmonics ``step_m`` farther on, (place, harmonic), and the intensity lost on the way, W/m^2 (place,).

    ``pressure_pa`` complex amplitudes of the harmonics 1 to N. Every row is a plane wave of its own.
    """
    harmonics = pressure_pa.shape[1]
    n = np.arange(1, harmonics + 1)
    rate = layer.nonlinearity * 2 * np.pi * frequency_hz / (layer.density_kg_per_m3 * layer.sound_speed_m_per_s**3)
    size = np.sqrt((np.abs(pressure_pa) ** 2).sum(axis=1))
    steps = max(1, math.ceil(1.5 * rate * size.max() * harmonics * abs(step_m) / _STEP))
    h = step_m / steps
    into = 0.5j * rate * n
    damped = np.clip((n / harmonics - _UNDAMPED) / (1 - _UNDAMPED), 0, None) ** 2 * (_DAMPING * rate * h * harmonics)
    value, lost = pressure_pa, np.zeros(len(pressure_pa))
    for _ in range(steps):
        k1 = into * _squared(value)
        k2 = into * _squared(value + h / 2 * k1)
        k3 = into * _squared(value + h / 2 * k2)
        k4 = into * _squared(value + h * k3)
        value = value + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        power = np.abs(value) ** 2
        kept = np.exp(-np.sqrt(power.sum(axis=1))[:, None] * damped)
        lost += (power * (1 - kept**2)).sum(axis=1)
        value = value * kept
    return value, lost / (2 * layer.impedance)


def _squared(pressure: ComplexArray) -> ComplexArray:
    """Return the harmonics of the wave's square, free of aliasing, shape of ``pressure``."""
    from scipy.fft import irfft, next_fast_len, rfft

    harmonics = pressure.shape[1]
    samples = next_fast_len(3 * harmonics + 2, real=True)
    spectrum = np.zeros((len(pressure), samples // 2 + 1), dtype=pressure.dtype)
    spectrum[:, 1 : harmonics + 1] = pressure * (samples / 2)
    wave = irfft(spectrum, samples, axis=1)
    return np.asarray(rfft(wave * wave, axis=1)[:, 1 : harmonics + 1] * (2 / samples))
