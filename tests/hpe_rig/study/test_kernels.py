"""Noise drawn in the band, and states from spectra: exactly what the estimators make of noisy samples."""

from __future__ import annotations

import numpy as np
import pytest

from hpe_rig.processing import ESTIMATORS, Options, estimate, noisy_peak_steps, orthonormal_rows
from hpe_rig.processing.motion.spectral_peak import peak_steps
from hpe_rig.scene import Estimator
from hpe_rig.study.kernels import Train, form_of, spectral_kernels, states

TRAIN = Train(4000.0, 40, 0.0, 9e6, 1540.0, 100e6, 130, (200.0,), Options())
OTHERS = [
    Train(6000.0, 60, 1e-4, 9e6, 1540.0, 200e6, 519, (200.0, 400.0), Options()),
    Train(2000.0, 50, 0.0, 5e6, 1500.0, 50e6, 66, (200.0,), Options(background_order=1)),
]


def _echoes(train: Train, draws: int) -> np.ndarray:
    """Return echoes of five targets a draw that move by 1 um, (draw, pulse, sample)."""
    rng = np.random.default_rng(5)
    delay_s = rng.uniform(-0.3, 0.3, (draws, 5)) * train.samples / train.sample_rate_hz
    moved_s = 2e-6 / train.sound_speed_m_per_s * np.sin(2 * np.pi * 200 * train.pulse_time_s + 0.3)
    time_s = (np.arange(train.samples) - (train.samples - 1) / 2) / train.sample_rate_hz
    age_s = time_s - delay_s[:, :, None, None] - moved_s[:, None]
    pulse = np.exp(-((age_s * 0.15 * train.carrier_hz) ** 2)) * np.cos(2 * np.pi * train.carrier_hz * age_s)
    return pulse.sum(axis=1)


@pytest.mark.parametrize("train", [TRAIN, *OTHERS])
@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_an_estimator_sees_of_white_noise_what_the_band_holds(train: Train, estimator: Estimator) -> None:
    kernels, echoes = spectral_kernels(train), _echoes(train, 1)
    noise = np.random.default_rng(6).standard_normal((1, 2, train.pulses, train.samples))
    fit = estimate(train.gate(echoes[:, None] + 0.3 * noise), train.frequencies_hz, estimator, options=train.options)
    form = form_of(estimator)
    numbers = noise @ kernels.basis[form].T
    clean = echoes @ kernels.of_volts[form] if form in kernels.of_volts else echoes
    estimated = states(
        train, estimator, clean, np.arange(train.pulses), np.array([0.3]), numbers @ kernels.of_coefficients[form]
    )
    # Rounding (7e-15 measured) and the band's cut at 1e-13, tenfold.
    wanted = fit.state[..., : 2 * len(train.frequencies_hz)]
    np.testing.assert_allclose(estimated, wanted, rtol=0, atol=1e-12 * np.abs(wanted).max())


@pytest.mark.parametrize("train", [TRAIN, *OTHERS])
def test_the_band_is_far_smaller_than_the_gate_and_its_numbers_are_white(train: Train) -> None:
    for basis in spectral_kernels(train).basis.values():
        assert len(basis) < 0.95 * train.samples
        np.testing.assert_allclose(basis @ basis.T, np.eye(len(basis)), atol=1e-13)


@pytest.mark.parametrize("train", [TRAIN, *OTHERS])
def test_what_multiplies_the_random_numbers_does_not_hang_on_rounding(train: Train) -> None:
    kernels = spectral_kernels(train)
    angle = 2 * np.pi * np.outer(np.arange(train.samples) / train.sample_rate_hz, kernels.grid_hz["plain"])
    columns = np.hstack([np.cos(angle), -np.sin(angle), kernels.of_volts["peak"]])
    rounded = columns * (1 + 1e-15 * np.random.default_rng(8).standard_normal(columns.shape))
    basis = orthonormal_rows(rounded)
    np.testing.assert_allclose(basis @ kernels.of_volts["peak"], kernels.of_coefficients["peak"], rtol=0, atol=1e-13)
    tapered = kernels.of_volts["plain"]
    basis = orthonormal_rows(tapered * (1 + 1e-15 * np.random.default_rng(8).standard_normal(tapered.shape)))
    np.testing.assert_allclose(basis @ tapered, kernels.of_coefficients["plain"], rtol=0, atol=1e-13)


def test_the_compiled_peak_search_is_that_of_the_paper_s_chain() -> None:
    pytest.importorskip("numba")
    kernels, rng = spectral_kernels(TRAIN), np.random.default_rng(7)
    clean = _echoes(TRAIN, 3) @ kernels.of_volts["peak"]
    noise = rng.standard_normal((3, 4, TRAIN.pulses, len(kernels.basis["peak"]))) @ kernels.of_coefficients["peak"]
    which, level = rng.integers(0, TRAIN.pulses, TRAIN.pulses), np.array([0.0, 0.3, 3.0])
    spectra = clean[:, None, which] + level[:, None, None, None] * noise
    fast, plain = peak_steps(spectra, use_compiled=True), peak_steps(spectra, use_compiled=False)
    np.testing.assert_array_equal(fast.peak, plain.peak)
    np.testing.assert_allclose(fast.step, plain.step, rtol=0, atol=1e-13)
    np.testing.assert_allclose(fast.product, plain.product, rtol=0, atol=1e-13 * np.abs(plain.product).max())
    np.testing.assert_allclose(fast.energy, plain.energy, rtol=1e-13)
    for way in (True, False):
        step, peak = noisy_peak_steps(clean, which, level, noise, use_compiled=way)
        np.testing.assert_array_equal(peak, plain.peak)
        np.testing.assert_allclose(step, plain.step, rtol=0, atol=1e-13)


@pytest.mark.parametrize("volts", [1e-4, 1.0, 1e4])
def test_the_compiled_peak_search_finds_weak_and_strong_echoes_alike(volts: float) -> None:
    pytest.importorskip("numba")
    spectra = _echoes(TRAIN, 3) @ spectral_kernels(TRAIN).of_volts["peak"]
    estimated, wanted = peak_steps(volts * spectra, use_compiled=True), peak_steps(spectra, use_compiled=False)
    np.testing.assert_array_equal(estimated.peak, wanted.peak)
    np.testing.assert_allclose(estimated.step, wanted.step, rtol=0, atol=1e-13)


def test_a_refused_realisation_is_no_number_and_the_others_are() -> None:
    kernels, echoes = spectral_kernels(TRAIN), _echoes(TRAIN, 2)
    volts = echoes @ kernels.of_volts["plain"]
    volts[1] = 0.0
    estimated = states(
        TRAIN, "coherent", volts, np.arange(TRAIN.pulses), np.zeros(2), np.zeros((2, 1, TRAIN.pulses, volts.shape[-1]))
    )
    assert np.isfinite(estimated[0]).all()
    assert np.isnan(estimated[1]).all()
