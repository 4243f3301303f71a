"""Codes coarser than the noise: what rounding leaves is in the uncertainty, and nothing is where noise dithers it."""

from __future__ import annotations

import numpy as np
import pytest

from hpe_rig.processing import EchoGate, coherent, fit_motion
from hpe_rig.processing.harmonics import quantisation
from hpe_rig.processing.harmonics.quantisation import quantisation_m, sawtooth_v

DRAWS, PULSES, SAMPLES, MARGIN = 30, 101, 256, 64
FREQUENCY_HZ = np.array([200.0, 600.0])


def echoes(generator: np.random.Generator, amplitude_m: float) -> np.ndarray:
    """Return echoes (pulse, sample) of 1 V rms that move rigidly, at 200 Hz and a third of that at 600 Hz."""
    frequency_hz = np.fft.rfftfreq(SAMPLES, 1e-8)
    spectrum = generator.standard_normal((2, frequency_hz.size)).T @ [1, 1j]
    spectrum *= np.exp(-(((frequency_hz - 9e6) / 0.6e6) ** 2))
    phase = 2 * np.pi * np.outer(np.arange(PULSES) / 4000, FREQUENCY_HZ)
    moved_m = amplitude_m * np.sin(phase) @ [1, 1 / 3]
    volts = np.fft.irfft(spectrum * np.exp(-4j * np.pi * frequency_hz * moved_m[:, None] / 1540), SAMPLES)
    return np.asarray(volts / volts.std())


@pytest.mark.parametrize(
    ("code_v", "noise_v"),
    [(0.08, 0.01), pytest.param(0.16, 0.01, marks=pytest.mark.slow), pytest.param(0.08, 0.03, marks=pytest.mark.slow)],
)
def test_errors_of_coarse_codes_are_as_large_as_stated(code_v: float, noise_v: float) -> None:
    generator, ratio = np.random.default_rng(3), []
    for _ in range(DRAWS):
        clean = echoes(generator, 1e-6)
        noisy = clean + noise_v * generator.standard_normal(clean.shape)
        states, valid = [], np.ones(PULSES, dtype=bool)
        for volts in (noisy, code_v * np.rint(noisy / code_v)):
            gate = EchoGate(volts, 100e6, np.arange(PULSES) / 4000, 9e6, 1540.0, valid, (MARGIN, MARGIN))
            motion = coherent(gate)
            fit = fit_motion(motion, FREQUENCY_HZ)
            states.append(fit.amplitude_m * np.exp(1j * fit.phase_rad))
        stated = np.array(quantisation_m(gate, code_v, motion, fit))
        off = (states[1] - states[0]) * np.exp(-1j * fit.phase_rad)
        # The random part of rounding, white, is in the noise of the fit: q / sqrt(12) beside noise_v.
        share = code_v**2 / 12 / (code_v**2 / 12 + noise_v**2)
        square = stated**2 + share * np.diagonal(fit.state_covariance)[:4].reshape(2, 2)
        ratio.append(np.stack([off.real, off.imag], axis=-1) ** 2 / square)
    # four quadratures of a draw, nearly independent, of one of which rounding is most
    assert np.mean(ratio) == pytest.approx(1, abs=4 * np.sqrt(2 / (2 * DRAWS)))


@pytest.mark.parametrize("amplitude_m", [1e-6, 0.2e-6])
def test_the_noise_before_rounding_is_estimated_with_part_of_the_rounding_in_the_mean_echo(
    amplitude_m: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    generator, found = np.random.default_rng(3), list[float]()
    plainly = quantisation._noise_v2

    def noted(scatter_v2: float, code_v: float, resting: np.ndarray) -> float:
        found.append(plainly(scatter_v2, code_v, resting))
        return found[-1]

    monkeypatch.setattr(quantisation, "_noise_v2", noted)
    for _ in range(12):
        clean = echoes(generator, amplitude_m)
        codes = np.rint((clean + 0.01 * generator.standard_normal(clean.shape)) / 0.08)
        timing = 100e6, np.arange(PULSES) / 4000, 9e6, 1540.0
        gate = EchoGate(0.08 * codes, *timing, np.ones(PULSES, dtype=bool), (MARGIN, MARGIN))
        motion = coherent(gate)
        quantisation_m(gate, 0.08, motion, fit_motion(motion, FREQUENCY_HZ))
    # the scatter less q^2 / 12 would be 0.6 and none of it; 0.36 and 0.29 from draw to draw, three of the mean's
    assert np.mean(found) / 0.01**2 == pytest.approx(1.0, abs=3 * 0.36 / np.sqrt(12))


@pytest.mark.parametrize("noise_codes", [0.0, 0.1, 0.2])
@pytest.mark.parametrize("harmonic", [1, 2, 3])
def test_noise_smooths_the_sawtooth_of_rounding(harmonic: int, noise_codes: float) -> None:
    """Against sums over volts and noise, in steps of a 2000th of a code and a 20th of the noise."""
    code_v = 0.3
    volts = (np.arange(2000) + 0.5) / 2000 * code_v
    noise = np.linspace(-6, 6, 241)
    weight = np.exp(-(noise**2) / 2)
    seen = volts[:, None] + noise_codes * code_v * noise
    error_v = (code_v * np.round(seen / code_v) - seen) @ weight / weight.sum()
    found = 2 * abs(np.mean(error_v * np.exp(2j * np.pi * harmonic * volts / code_v)))
    # Sums miss the jumps by half a step.
    assert sawtooth_v(harmonic, code_v, (noise_codes * code_v) ** 2) == pytest.approx(found, abs=1e-3 * code_v)


def test_fine_codes_leave_nothing_and_cost_nothing() -> None:
    generator = np.random.default_rng(4)
    clean = echoes(generator, 1e-6)
    gate = EchoGate(
        clean + 0.01 * generator.standard_normal(clean.shape),
        *(100e6, np.arange(PULSES) / 4000, 9e6, 1540.0, np.ones(PULSES, dtype=bool), (MARGIN, MARGIN)),
    )
    motion = coherent(gate)
    assert quantisation_m(gate, 0.01, motion, fit_motion(motion, FREQUENCY_HZ)) == ()
