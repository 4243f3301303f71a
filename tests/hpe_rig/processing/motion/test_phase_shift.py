"""Echoes to motion: `coherent` and `cross_spectrum` on targets with exactly known motion."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
from numpy.typing import NDArray

from hpe_rig.processing import (
    EchoGate,
    Motion,
    coherent,
    estimate,
    velocity_between_pulses,
)
from hpe_rig.processing.echo import spectrum as spectrum_module
from hpe_rig.processing.echo.spectrum import band_spectrum
from hpe_rig.processing.motion.correlation import cross_correlation
from hpe_rig.processing.motion.displacement import Velocity
from hpe_rig.processing.motion.phase_shift import coherent_phase
from hpe_rig.processing.motion.spectral_peak import cross_spectrum as cross_spectrum_motion
from hpe_rig.scene import Estimator

if TYPE_CHECKING:
    from conftest import TableOne

FloatArray = NDArray[np.float64]


def _sine(table_one: TableOne, amplitude_m: float = 1e-6) -> FloatArray:
    return amplitude_m * np.sin(2 * np.pi * table_one.frequency_hz * table_one.pulse_time_s + table_one.phase_rad)


def cross_spectrum(echoes: EchoGate) -> Velocity:
    return velocity_between_pulses(cross_spectrum_motion(echoes))


# cross_spectrum reads one bin, which may be half a bin (100 MHz / 2048 / 2) off the centre of the echo
BIN = 100e6 / 2048 / 2 / 9e6


@pytest.mark.parametrize("amplitude_m", [1e-13, 1e-9, 1e-6])
@pytest.mark.parametrize(("estimator", "tolerance"), [("coherent", 1e-6), ("cross_spectrum", BIN)])
def test_a_rigid_target_without_noise_is_recovered(
    table_one: TableOne, estimator: Estimator, tolerance: float, amplitude_m: float
) -> None:
    # rounding: 1e-13 m turns the phase by 7e-9 rad, known to 1e-16 / sqrt(bins x pulses): 1e-8 of it
    fit = estimate(table_one.gate(table_one.rigid(_sine(table_one, amplitude_m))), [200.0], estimator)
    assert fit.amplitude_m[0] == pytest.approx(amplitude_m, rel=tolerance, abs=0)
    assert fit.phase_rad[0] == pytest.approx(table_one.phase_rad, abs=1e-6)


def test_motion_away_from_the_transducer_is_positive(table_one: TableOne) -> None:
    ramp = np.linspace(0, 2e-6, 50)
    echoes = table_one.gate(table_one.rigid(ramp))
    np.testing.assert_allclose(np.diff(coherent(echoes).displacement_m), np.diff(ramp), rtol=1e-3)
    np.testing.assert_allclose(cross_spectrum(echoes).velocity_m_per_s, np.diff(ramp) * 4000, rtol=1e-3)


@pytest.mark.parametrize("estimator", [coherent, cross_correlation])
def test_motion_of_many_wavelengths_is_followed(table_one: TableOne, estimator: Callable[[EchoGate], Motion]) -> None:
    # 100 um is 2.3 wavelengths of phase; the largest step, 31 um, stays below the quarter wavelength of 42.8 um
    truth = _sine(table_one, 100e-6)
    displacement_m = estimator(table_one.gate(table_one.rigid(truth))).displacement_m
    np.testing.assert_allclose(displacement_m - displacement_m[0], truth - truth[0], atol=1e-3 * 100e-6)


@pytest.mark.parametrize("estimator", ["coherent", "cross_spectrum"])
def test_leading_axes_equal_a_loop_and_a_gain_changes_nothing(
    table_one: TableOne, speckle_draws: FloatArray, estimator: Estimator
) -> None:
    together = estimate(table_one.gate(7.3 * speckle_draws[:4].reshape(2, 2, 100, 130)), [200.0], estimator)
    for index in range(4):
        alone = estimate(table_one.gate(speckle_draws[index]), [200.0], estimator)
        np.testing.assert_allclose(together.amplitude_m.reshape(4, 1)[index], alone.amplitude_m, rtol=1e-9)


def test_missing_pulses_do_not_affect_coherent_at_the_others(table_one: TableOne, speckle_draws: FloatArray) -> None:
    valid = np.ones(100, dtype=bool)
    valid[[0, 17, 18, 60]] = False
    volts = np.where(valid[:, None], speckle_draws[0], np.nan)
    gappy = coherent(table_one.gate(volts, valid))
    complete = table_one.gate(speckle_draws[0])
    short = coherent(
        replace(
            complete,
            volts=complete.volts[valid],
            pulse_time_s=complete.pulse_time_s[valid],
            valid=np.ones(96, dtype=bool),
        )
    )
    np.testing.assert_array_equal(gappy.displacement_m[valid], short.displacement_m)
    assert np.isnan(gappy.displacement_m[~valid]).all()


def test_a_missing_pulse_invalidates_two_intervals_of_cross_spectrum(
    table_one: TableOne, speckle_draws: FloatArray
) -> None:
    valid = np.ones(100, dtype=bool)
    valid[40] = False
    gappy = cross_spectrum(table_one.gate(np.where(valid[:, None], speckle_draws[0], np.nan), valid))
    complete = cross_spectrum(table_one.gate(speckle_draws[0]))
    assert np.flatnonzero(~gappy.valid).tolist() == [39, 40]
    # equal up to the rounding of the sum of steps
    np.testing.assert_allclose(
        gappy.velocity_m_per_s[gappy.valid], complete.velocity_m_per_s[gappy.valid], rtol=0, atol=1e-15
    )


@pytest.mark.parametrize("estimator", ["coherent", "cross_spectrum"])
def test_twenty_missing_pulses_do_not_bias_the_estimate(table_one: TableOne, estimator: Estimator) -> None:
    valid = np.ones(100, dtype=bool)
    valid[np.random.default_rng(3).choice(100, 20, replace=False)] = False
    echoes = table_one.gate(np.where(valid[:, None], table_one.rigid(_sine(table_one)), np.nan), valid)
    fit = estimate(echoes, [200.0], estimator)
    assert fit.amplitude_m[0] == pytest.approx(1e-6, rel=BIN, abs=0)
    assert fit.phase_rad[0] == pytest.approx(table_one.phase_rad, abs=1e-6)
    assert fit.quality.pulses <= 80


def _leak_3_mhz(table: TableOne, volts: FloatArray) -> FloatArray:
    """Return a tone of 3.077 MHz and amplitude 1, the fourth bin of the gate, at the samples of ``volts``."""
    return np.cos(2 * np.pi * 4 * (np.arange(volts.shape[-1]) - table.margin) / 130)


@pytest.mark.parametrize(("estimator", "leak"), [("coherent", 5), ("cross_spectrum", 50)])
def test_a_strong_offset_and_3_mhz_leak_outside_the_band_are_not_tracked(
    wide: TableOne, wide_draws: FloatArray, estimator: Estimator, leak: float
) -> None:
    # the echo is of 0.7 rms: an offset 70 times that, a tone 5 or, under the Hann gate, 50 times as strong
    unwanted = 50 + leak * _leak_3_mhz(wide, wide_draws)
    clean, dirty = (
        estimate(wide.gate(volts), [200.0], estimator).amplitude_m[0]
        for volts in (wide_draws[1], wide_draws[1] + unwanted)
    )
    assert dirty == pytest.approx(clean, rel=2e-2)


@pytest.mark.parametrize("leak", [5, 15, 50])
def test_a_stationary_leak_reduces_the_motion_by_at_most_its_fraction_of_the_band_energy(
    wide: TableOne, wide_draws: FloatArray, leak: float
) -> None:
    """With a stationary tone of e^2 times the echo's energy in the band, 1 / (1 + e^2) of the motion is measured."""
    tone = leak * _leak_3_mhz(wide, wide_draws)
    echo, with_tone = (band_spectrum(wide.gate(volts))[0] for volts in (wide_draws, wide_draws + tone))
    ratio = np.mean(np.abs(with_tone - echo) ** 2) / np.mean(np.abs(echo) ** 2)
    clean, dirty = (
        estimate(wide.gate(volts), [200.0], "coherent").amplitude_m[:, 0] for volts in (wide_draws, wide_draws + tone)
    )
    # only the energy in the gate matters: it is less, since the tapers that admit the tone are outside the gate
    lost = 1 - dirty / clean
    assert 0 < lost.mean() < ratio / (1 + ratio)
    # a draw has its own energy and overlaps with the tone by chance
    assert np.abs(lost).max() < 4 * ratio


def test_the_variance_of_a_pulse_is_that_of_its_noise(table_one: TableOne, speckle_draws: FloatArray) -> None:
    generator = np.random.default_rng(4)
    echo = speckle_draws[2, 0]
    volts = echo + generator.standard_normal((40, 100, 130)) * np.sqrt(np.mean(echo**2) / 100)
    motion = coherent(table_one.gate(volts))
    spread = np.var(motion.displacement_m, axis=-1, ddof=1).mean()
    # 4000 displacements: the standard deviation of their variance is sqrt(2 / 4000) = 2.2 %; three of these
    assert motion.variance_m2.mean() == pytest.approx(spread, rel=0.067)


def test_inconsistent_echoes_are_refused_with_the_reason(table_one: TableOne) -> None:
    volts = table_one.rigid(_sine(table_one))
    broken = volts.copy()
    broken[3, 5] = np.nan
    with pytest.raises(ValueError, match="not finite"):
        table_one.gate(broken)
    with pytest.raises(ValueError, match="do not fit"):
        table_one.gate(volts, np.ones(99, dtype=bool))
    with pytest.raises(ValueError, match="out of order"):
        replace(table_one.gate(volts), pulse_time_s=table_one.pulse_time_s[::-1])


@pytest.mark.parametrize("estimator", [coherent, cross_spectrum])
def test_gates_without_echo_or_with_one_pulse_are_refused(table_one: TableOne, estimator: object) -> None:
    assert callable(estimator)
    silent = table_one.gate(np.zeros((100, 130)))
    with pytest.raises(ValueError, match="no echo"):
        estimator(silent)
    lonely: EchoGate = table_one.gate(np.ones((100, 130)), np.arange(100) == 5)
    with pytest.raises(ValueError, match="1 valid pulses"):
        estimator(lonely)


def test_spectra_by_fft_equal_those_by_projection(wide: TableOne, monkeypatch: pytest.MonkeyPatch) -> None:
    volts = 3.0 + np.random.default_rng(1).normal(size=(2, 100, wide.samples + 2 * wide.margin))
    spectra = []
    for by_fft in (True, False):
        monkeypatch.setattr(spectrum_module, "fft_is_faster", lambda *_, by_fft=by_fft: by_fft)
        spectra.append(band_spectrum(wide.gate(volts))[0])
    np.testing.assert_allclose(spectra[0], spectra[1], rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("margins", [pytest.param(False, marks=pytest.mark.slow), True])
def test_the_compiled_phase_equals_that_of_numpy(
    table_one: TableOne, wide: TableOne, speckle_draws: FloatArray, wide_draws: FloatArray, margins: bool
) -> None:
    pytest.importorskip("numba")
    table, draws = (wide, wide_draws) if margins else (table_one, speckle_draws)
    volts = draws[:5] + 0.1 * draws.std() * np.random.default_rng(3).standard_normal(draws[:5].shape)
    # one train without an echo, and one of noise alone
    volts[1], volts[3] = 0.0, np.random.default_rng(4).standard_normal(volts[3].shape)
    spectrum, band = band_spectrum(table.gate(volts))
    # rounding: of the largest 1e-14 for phases and 5e-13 for variances, measured on a thousand trains
    for plain, fast in zip(coherent_phase(spectrum, band, False), coherent_phase(spectrum, band, True), strict=True):
        np.testing.assert_allclose(fast, plain, rtol=0, atol=1e-11 * np.nanmax(np.abs(plain)))
        assert np.isnan(fast[[1, 3]]).all()
    with pytest.raises(ValueError, match="noise"):
        coherent_phase(spectrum[3:4], band, True)
