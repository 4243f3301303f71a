"""One step of a plane wave of finite amplitude: how its harmonics change over a distance.

    dp_n/dz = j n w beta / (2 rho c^3) * (harmonic n of p^2),          p(t) = Re sum_n p_n exp(j n w t)

    p_n       complex amplitude of harmonic n, Pa
    w         angular frequency of the fundamental, rad/s
    beta      coefficient of nonlinearity, 1 + B/2A
    rho, c    density, kg/m³; sound speed, m/s

This is Burgers' equation without losses; the beam applies those with diffraction. A truncated series conserves energy,
so the energy that a shock would turn into heat accumulates in the last harmonics. `advance` damps these in proportion
to the rate of steepening, and returns the loss. By weak shock theory the loss of a shock does not depend on its
mechanism, so this is the loss of the omitted harmonics. See docs/explanation/nonlinear.md, section 1.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sim_backend.arrays import ComplexArray, FloatArray

DB_PER_CM_TO_NP_PER_M = 100 * math.log(10) / 20
# Fraction of the harmonics without damping, and damping of the last one over its rate of steepening.
_UNDAMPED_FRACTION, _DAMPING = 0.4, 1.0
# n w beta p h / (rho c³) of the last harmonic in one Runge-Kutta step of length h; stable up to 2.8.
_MAX_PHASE_PER_STEP = 1.0


@dataclass(frozen=True, slots=True)
class Layer:
    """A homogeneous layer across the beam."""

    thickness_m: float
    sound_speed_m_per_s: float
    density_kg_per_m3: float
    nonlinearity: float
    """Coefficient beta = 1 + B/2A."""
    attenuation_db_per_cm_mhz: float
    """Attenuation at 1 MHz; it is proportional to the frequency to the power of ``attenuation_power``."""
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
        """Return the complex wave number k - j alpha, in the shape of ``frequency_hz``.

        It has the dispersion required by causality; the layer's sound speed applies at ``reference_hz``.
        """
        w, w0 = 2 * np.pi * frequency_hz, 2 * np.pi * reference_hz
        y = self.attenuation_power
        # alpha = a0 w^y, w in rad/s.
        a0 = self.attenuation_db_per_cm_mhz * DB_PER_CM_TO_NP_PER_M / (2e6 * np.pi) ** y
        # Change of 1 / c from the reference frequency, by the Kramers-Kronig relations for a power law.
        if y == 1:
            slowness = -2 / np.pi * a0 * np.log(w / w0)
        else:
            slowness = a0 * math.tan(math.pi * y / 2) * (w ** (y - 1) - w0 ** (y - 1))
        return np.asarray(w * (1 / self.sound_speed_m_per_s + slowness) - 1j * self.attenuation_np_per_m(frequency_hz))


def advance(
    pressure_pa: ComplexArray, step_m: float, frequency_hz: float, layer: Layer
) -> tuple[ComplexArray, FloatArray]:
    """Return the harmonics of a plane wave after it has steepened over ``step_m``, and its loss of intensity in shocks.

    ``pressure_pa`` (point, harmonic) are complex amplitudes of harmonics 1 to N; each row is a separate plane wave. The
    result has the same shape; the loss is (point,), W/m².
    """
    harmonics = pressure_pa.shape[1]
    n = np.arange(1, harmonics + 1)
    # Harmonic n grows along z by j n / 2 times this rate times harmonic n of the squared wave; 1 / (m Pa).
    rate = layer.nonlinearity * 2 * np.pi * frequency_hz / (layer.density_kg_per_m3 * layer.sound_speed_m_per_s**3)
    factor = 0.5j * rate * n
    # Runge-Kutta steps of length h, short enough for the last harmonic of the strongest wave.
    amplitude_pa = np.sqrt((np.abs(pressure_pa) ** 2).sum(axis=1))
    steps = max(1, math.ceil(1.5 * rate * amplitude_pa.max() * harmonics * abs(step_m) / _MAX_PHASE_PER_STEP))
    h = step_m / steps
    # Damping of a harmonic in a step, for an amplitude of 1 Pa: 0 up to a fraction of the harmonics, then quadratic.
    position = np.clip((n / harmonics - _UNDAMPED_FRACTION) / (1 - _UNDAMPED_FRACTION), 0, None)
    damping_per_pa = position**2 * (_DAMPING * rate * h * harmonics)
    value_pa, loss_pa2 = pressure_pa, np.zeros(len(pressure_pa))
    for _ in range(steps):
        k1 = factor * _squared(value_pa)
        k2 = factor * _squared(value_pa + h / 2 * k1)
        k3 = factor * _squared(value_pa + h / 2 * k2)
        k4 = factor * _squared(value_pa + h * k3)
        value_pa = value_pa + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        # The last harmonics lose energy in proportion to the amplitude of the wave, as in a shock.
        power_pa2 = np.abs(value_pa) ** 2
        transmission = np.exp(-np.sqrt(power_pa2.sum(axis=1))[:, None] * damping_per_pa)
        loss_pa2 += (power_pa2 * (1 - transmission**2)).sum(axis=1)
        value_pa = value_pa * transmission
    return value_pa, loss_pa2 / (2 * layer.impedance)


def _squared(pressure: ComplexArray) -> ComplexArray:
    """Return the harmonics of the squared wave, shape of ``pressure`` (point, harmonic), by an FFT without aliasing."""
    from scipy.fft import irfft, next_fast_len, rfft

    harmonics = pressure.shape[1]
    samples = next_fast_len(3 * harmonics + 2, real=True)
    spectrum = np.zeros((len(pressure), samples // 2 + 1), dtype=pressure.dtype)
    spectrum[:, 1 : harmonics + 1] = pressure * (samples / 2)
    wave = irfft(spectrum, samples, axis=1)
    return np.asarray(rfft(wave * wave, axis=1)[:, 1 : harmonics + 1] * (2 / samples))
