"""Properties of all estimators: recovery, precision, invariance, background motion, and echoes that they refuse."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from numpy.typing import NDArray

from hpe_rig.processing import (
    ESTIMATORS,
    EchoGate,
    Options,
    coherent,
    estimate,
    least_squares,
    motion_of,
    relative_to,
)
from hpe_rig.processing.echo.conditioning import deviating_pulses
from hpe_rig.processing.motion.correlation import _peak_delay_s
from hpe_rig.processing.motion.gate_tracking import add_gate_motion, track_gate
from hpe_rig.processing.motion.phase_shift import kasai
from hpe_rig.scene import Estimator

if TYPE_CHECKING:
    from conftest import TableOne

FloatArray = NDArray[np.float64]

PAIRWISE: list[Estimator] = ["kasai", "loupas"]
MEAN_ECHO: list[Estimator] = ["coherent", "cross_correlation"]


def _sine(table_one: TableOne, amplitude_m: float = 1e-6) -> FloatArray:
    return amplitude_m * np.sin(2 * np.pi * table_one.frequency_hz * table_one.pulse_time_s + table_one.phase_rad)


def _noisy(echo: FloatArray, draws: int, snr_db: float, seed: int = 24) -> FloatArray:
    noise_v = np.sqrt(np.mean(echo**2) / 10 ** (snr_db / 10))
    noisy: FloatArray = echo + noise_v * np.random.default_rng(seed).standard_normal((draws, *echo.shape))
    return noisy


# kasai divides by the carrier: the mean frequency of a Hann pulse of 20 % is off by (0.2)^2/12 of it at most
@pytest.mark.parametrize(("estimator", "tolerance"), [("kasai", 4e-3), ("loupas", 4e-3), ("cross_correlation", 2e-3)])
def test_other_estimators_recover_a_rigid_target(table_one: TableOne, estimator: Estimator, tolerance: float) -> None:
    fit = estimate(table_one.gate(table_one.rigid(_sine(table_one))), [200.0], estimator)
    assert fit.amplitude_m[0] == pytest.approx(1e-6, rel=tolerance, abs=0)
    assert fit.phase_rad[0] == pytest.approx(table_one.phase_rad, abs=tolerance)


def test_the_delay_of_the_largest_correlation_is_found_to_rounding() -> None:
    frequency_hz = np.linspace(6e6, 12e6, 24)
    delay_s = np.linspace(-0.49, 0.49, 41) / 9e6
    power = np.exp(-(((frequency_hz - 9e6) / 1e6) ** 2))
    cross = power * np.exp(-2j * np.pi * frequency_hz * delay_s[:, None])
    # phases of 2 pi are known to 1e-15 of a turn; Newton's method squares the error to below that
    np.testing.assert_allclose(_peak_delay_s(cross, frequency_hz, 9e6), delay_s, rtol=0, atol=1e-12 / 9e6)


@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_float32_volts_give_the_same_amplitude_as_float64(
    table_one: TableOne, speckle_draws: FloatArray, estimator: Estimator
) -> None:
    double = estimate(table_one.gate(speckle_draws[0]), [200.0], estimator)
    single = estimate(table_one.gate(speckle_draws[0].astype(np.float32)), [200.0], estimator)
    # 24 bits of 100 x 130 samples: phase noise of 6e-8 / sqrt(13000), in the peak's single bin ten times that
    assert single.amplitude_m[0] == pytest.approx(double.amplitude_m[0], rel=1e-6, abs=0)


@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_pulse_times_of_1e5_s_do_not_reduce_precision(
    table_one: TableOne, speckle_draws: FloatArray, estimator: Estimator
) -> None:
    echoes = table_one.gate(speckle_draws[0])
    shifted = replace(echoes, pulse_time_s=echoes.pulse_time_s + 1e5)
    fit, shifted_fit = (estimate(gate, [200.0], estimator) for gate in (echoes, shifted))
    # 1e5 s is a whole number of cycles; such times have a resolution of 1.5e-11 s, 2e-8 rad at 200 Hz
    assert shifted_fit.phase_rad[0] == pytest.approx(fit.phase_rad[0], abs=1e-7)
    assert shifted_fit.amplitude_m[0] == pytest.approx(fit.amplitude_m[0], rel=1e-6, abs=0)


@pytest.mark.parametrize("estimator", ESTIMATORS)
@pytest.mark.parametrize("volts", [0.0, 1.7, -0.3])
def test_constant_records_are_refused_as_no_echo(table_one: TableOne, estimator: Estimator, volts: float) -> None:
    with pytest.raises(ValueError, match="no echo"):
        estimate(table_one.gate(np.full((100, 130), volts)), [200.0], estimator)


@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_spikes_and_clipping_give_finite_results(
    table_one: TableOne, speckle_draws: FloatArray, estimator: Estimator
) -> None:
    spiked = speckle_draws[0].copy()
    spiked[40, 65] = 1e6
    top = 0.3 * np.abs(speckle_draws[0]).max()
    for volts in (spiked, np.clip(speckle_draws[0], -top, top)):
        fit = estimate(table_one.gate(volts), [200.0], estimator)
        assert np.isfinite(fit.amplitude_m).all()
        assert np.isfinite(fit.covariance).all()


def test_clipping_to_a_third_biases_less_than_speckle(table_one: TableOne, speckle_draws: FloatArray) -> None:
    top = 0.3 * np.abs(speckle_draws[1]).max()
    unclipped, clipped = (
        estimate(table_one.gate(volts), [200.0]).amplitude_m[0]
        for volts in (speckle_draws[1], np.clip(speckle_draws[1], -top, top))
    )
    # the phase of zero crossings survives; speckle alone spreads by 6 %
    assert clipped == pytest.approx(unclipped, rel=0.06)


def test_a_leaking_toneburst_is_flagged_and_then_harmless(table_one: TableOne, speckle_draws: FloatArray) -> None:
    volts = _noisy(speckle_draws[0], 1, 40.0)[0]
    dirty = volts.copy()
    leak = 20 * np.abs(volts).max() * np.sin(2 * np.pi * 3e6 * np.arange(130) / 100e6)
    dirty[[10, 50, 90]] += leak
    flagged = deviating_pulses(table_one.gate(dirty))
    assert np.flatnonzero(flagged).tolist() == [10, 50, 90]
    fit, clean = estimate(table_one.gate(dirty, ~flagged), [200.0]), estimate(table_one.gate(volts), [200.0])
    # three pulses less of a hundred, noise of 1.7 nm
    assert fit.amplitude_m[0] == pytest.approx(clean.amplitude_m[0], abs=2e-9)


def test_pulses_that_deviate_by_noise_only_are_not_flagged(table_one: TableOne, speckle_draws: FloatArray) -> None:
    for snr_db in (0.0, 40.0):
        assert not deviating_pulses(table_one.gate(_noisy(speckle_draws[0], 10, snr_db))).any()


def test_the_largest_step_is_reported_in_quarter_wavelengths(table_one: TableOne) -> None:
    quarter_m = 1540 / (4 * 9e6)
    small, large = (
        coherent(table_one.gate(table_one.rigid(step * quarter_m * np.tile([0.0, 1.0], 50)))).largest_step
        for step in (0.1, 0.9)
    )
    assert small == pytest.approx(0.1, rel=0.02)
    assert large == pytest.approx(0.9, rel=0.02)


def test_a_reference_gate_cancels_a_nanosecond_of_trigger_jitter(table_one: TableOne) -> None:
    generator = np.random.default_rng(5)
    jitter_m = 1540 / 2 * 1e-9 * generator.standard_normal((40, 100))
    moving = np.stack([table_one.rigid(_sine(table_one) + row) for row in jitter_m])
    stationary = np.stack([table_one.rigid(row) for row in jitter_m])
    noise_v = 0.01 * np.sqrt(np.mean(moving**2))
    motion, reference = (
        coherent(table_one.gate(volts + noise_v * generator.standard_normal(volts.shape)))
        for volts in (moving, stationary)
    )
    without_gate = least_squares(motion, [200.0]).amplitude_m.std()
    with_gate = least_squares(relative_to(motion, reference), [200.0]).amplitude_m.std()
    # c 1 ns / 2 = 0.77 um a pulse, sqrt(2/100) of it in the amplitude: 109 nm, measured to 1 / sqrt(80) = 11 %
    assert without_gate == pytest.approx(109e-9, rel=0.34)
    assert with_gate < without_gate / 10


def test_variances_of_motion_and_reference_add(table_one: TableOne, speckle_draws: FloatArray) -> None:
    motion, reference = (coherent(table_one.gate(_noisy(speckle_draws[k], 1, 20.0, k)[0])) for k in (0, 1))
    variance_m2 = relative_to(motion, reference).variance_m2
    np.testing.assert_allclose(variance_m2, motion.variance_m2 + reference.variance_m2, rtol=1e-12)


def test_the_step_noise_ratio_of_added_steps_is_the_mean_of_both_gates(
    table_one: TableOne, speckle_draws: FloatArray
) -> None:
    motion, reference = (kasai(table_one.gate(_noisy(speckle_draws[k], 1, 20.0, k)[0])) for k in (0, 1))
    assert motion.step_noise_ratio is not None
    assert reference.step_noise_ratio is not None
    np.testing.assert_allclose(
        relative_to(motion, reference).step_noise_ratio,
        (motion.step_noise_ratio + reference.step_noise_ratio) / 2,
        rtol=1e-12,
    )


def test_pulses_removed_from_a_gate_are_like_missing_pulses(table_one: TableOne, speckle_draws: FloatArray) -> None:
    excluded = np.arange(100) % 9 == 4
    removed, marked = table_one.gate(speckle_draws[0]).without(excluded), table_one.gate(speckle_draws[0], ~excluded)
    np.testing.assert_array_equal(coherent(removed).displacement_m, coherent(marked).displacement_m)


def test_accumulated_step_errors_do_not_raise_the_noise_of_a_long_coherent_train(table_one: TableOne) -> None:
    long_train = replace(table_one, pulses=3000)
    echoes = _noisy(long_train.rigid(np.zeros(3000)), 1, 0.0, 1)[0]
    bound_m = 1540 / (4 * np.pi * 9e6) / np.sqrt(130)
    # 3000 pulses measure it to 1.3 %; aligned once only, with an error of 5 rad at the end, it would be 7.5 % larger
    assert coherent(long_train.gate(echoes)).displacement_m.std() < 1.05 * bound_m


def test_motion_and_reference_of_different_records_are_refused(table_one: TableOne) -> None:
    motion = coherent(table_one.gate(table_one.rigid(_sine(table_one))))
    with pytest.raises(ValueError, match="same records"):
        relative_to(motion, replace(motion, time_s=motion.time_s + 1e-3))


def _shifted(base: FloatArray, displacement_m: FloatArray) -> FloatArray:
    """Return the records of a rigid medium: one long echo, delayed by the exact phase of every frequency."""
    delay_s = 2 * displacement_m[:, None] / 1540.0
    frequency_hz = np.fft.rfftfreq(base.size, 1e-8)
    return np.fft.irfft(np.fft.rfft(base) * np.exp(-2j * np.pi * frequency_hz * delay_s), base.size)


@pytest.mark.parametrize("estimator", ["coherent", "loupas"])
def test_100_nm_survive_5_mm_of_background_motion_at_1_hz(estimator: Estimator) -> None:
    generator = np.random.default_rng(6)
    time_s = np.arange(400) / 4000
    moved_m = 5e-3 * np.sin(2 * np.pi * time_s + 0.3) + 100e-9 * np.sin(2 * np.pi * 200 * time_s + 0.7)
    frequency_hz = np.fft.rfftfreq(2048, 1e-8)
    band = np.exp(-(((frequency_hz - 9e6) / 1e6) ** 2))
    base = np.fft.irfft(band * (generator.standard_normal(1025) + 1j * generator.standard_normal(1025)), 2048)
    volts = _shifted(base, moved_m)
    volts += 0.01 * base.std() * generator.standard_normal(volts.shape)
    records = EchoGate(volts, 100e6, time_s, 9e6, 1540.0, np.ones(400, dtype=bool))
    tracked, gate_motion = track_gate(records, slice(959, 1089))
    fit = least_squares(add_gate_motion(motion_of(tracked, estimator), gate_motion), [200.0], background_order=12)
    assert abs(fit.amplitude_m[0] - 100e-9) < 3 * np.sqrt(fit.covariance[0, 0, 0])
    # bound of 400 pulses at 40 dB: 0.84 nm; speckle rolls through the gate, which costs more
    assert np.sqrt(fit.covariance[0, 0, 0]) < 5e-9


def test_echoes_that_leave_the_records_are_refused(table_one: TableOne) -> None:
    volts = _shifted(table_one.rigid(np.zeros(1), 0.2)[0], np.linspace(0, 1e-3, 100))
    with pytest.raises(ValueError, match="a record has 130"):
        track_gate(table_one.gate(volts), slice(0, 130))


def test_an_acceleration_of_1_m_per_s2_is_fitted_as_background(table_one: TableOne) -> None:
    time_s = table_one.pulse_time_s
    # 25 ms: 0.31 mm; the pulse stays in the 1 mm gate
    drifting = table_one.gate(table_one.rigid(_sine(table_one, 1e-7) + 0.5 * time_s**2 - 0.15e-3, 0.2))
    plain, fitted = (estimate(drifting, [200.0], "coherent", options=Options(order)) for order in (0, 2))
    assert abs(plain.amplitude_m[0] - 1e-7) > 1e-6
    assert fitted.amplitude_m[0] == pytest.approx(1e-7, rel=0.02)


@given(gain=st.floats(1e-3, 1e3), lift=st.floats(-1, 1), shift=st.integers(0, 5), seed=st.integers(0, 99))
@settings(max_examples=10, deadline=None)
@pytest.mark.parametrize("estimator", [*MEAN_ECHO, *PAIRWISE])
def test_scale_constant_order_and_origin_do_not_matter(
    table_one: TableOne,
    speckle_draws: FloatArray,
    estimator: Estimator,
    gain: float,
    lift: float,
    shift: int,
    seed: int,
) -> None:
    order = np.random.default_rng(seed).permutation(3)
    echoes = table_one.gate(speckle_draws[:3])
    volts = gain * (speckle_draws[:3][order] + lift)
    transformed = replace(table_one.gate(volts), pulse_time_s=echoes.pulse_time_s + shift * 1e-3)
    plain, changed = (estimate(gate, [200.0], estimator) for gate in (echoes, transformed))
    np.testing.assert_allclose(changed.amplitude_m, plain.amplitude_m[order], rtol=1e-8)
    turn = np.angle(np.exp(1j * (changed.phase_rad - plain.phase_rad[order] + 2 * np.pi * 200 * shift * 1e-3)))
    np.testing.assert_allclose(turn, 0, atol=1e-8)


def test_an_estimator_that_does_not_exist_is_refused(table_one: TableOne) -> None:
    echoes = table_one.gate(table_one.rigid(_sine(table_one)))
    with pytest.raises(ValueError, match="is not one of the choices"):
        estimate(echoes, [200.0], "best")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"joint.*was removed, use coherent"):
        motion_of(echoes, "joint")
