"""The gate's edge: bias of a rigid motion by cut echoes, for every estimator; white noise alone; refused echoes."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
import pytest
from numpy.typing import NDArray

from hpe_rig.processing import (
    ESTIMATORS,
    EchoGate,
    coherent,
    estimate,
    least_squares,
)
from hpe_rig.processing.echo.spectrum import band_spectrum
from hpe_rig.processing.motion.phase_shift import are_correlated, kasai, pulse_steps
from hpe_rig.scene import Estimator

if TYPE_CHECKING:
    from conftest import TableOne

FloatArray = NDArray[np.float64]
OVER_THE_GATE: list[Estimator] = ["coherent", "cross_correlation", "loupas"]


def _rigid(table: TableOne, generator: np.random.Generator) -> FloatArray:
    """Return echoes (pulse, sample) of scatterers on the axis that move together by 1 um."""
    gate_s = table.gate_time_s()
    length_s = 1 / (table.bandwidth * table.carrier_hz)
    span_s = gate_s[-1] - gate_s[0] + 2 * length_s
    count = round(40 * span_s * table.sound_speed_m_per_s / 2 / 1e-3)
    position_s = generator.uniform(-span_s / 2, span_s / 2, count)
    echo = generator.standard_normal(count)
    displacement_m = table.amplitude_m * np.sin(2 * np.pi * table.frequency_hz * table.pulse_time_s + table.phase_rad)
    delay_s = 2 * displacement_m / table.sound_speed_m_per_s
    return np.stack([table.pulse(gate_s[:, None] - position_s - delay, table.bandwidth) @ echo for delay in delay_s])


@lru_cache(maxsize=4)
def _draws(table: TableOne, draws: int) -> FloatArray:
    """Return the echoes shared by all estimators, (draw, pulse, sample)."""
    generator = np.random.default_rng(41)
    volts = np.stack([_rigid(table, generator) for _ in range(draws)])
    volts.flags.writeable = False
    return volts


@lru_cache(maxsize=2)
def _noise(trials: int, samples: int) -> FloatArray:
    noise = np.random.default_rng(44).standard_normal((trials, 100, samples))
    noise.flags.writeable = False
    return noise


def _errors(table: TableOne, draws: int, estimator: Estimator) -> FloatArray:
    gate = table.gate(_draws(table, draws))
    return estimate(gate, [table.frequency_hz], estimator).amplitude_m[:, 0] / table.amplitude_m - 1


def _one_cycle(wide: TableOne, samples: int) -> TableOne:
    return replace(wide, pulses=20, samples=samples)


@pytest.mark.parametrize(("samples", "limit"), [(130, 2e-4), pytest.param(65, 5e-4, marks=pytest.mark.slow)])
@pytest.mark.parametrize("estimator", OVER_THE_GATE)
def test_the_gates_edges_do_not_bias_a_rigid_motion(
    wide: TableOne, estimator: Estimator, samples: int, limit: float
) -> None:
    errors = _errors(_one_cycle(wide, samples), 15, estimator)
    assert np.sqrt(np.mean(errors**2)) < limit


@pytest.mark.slow
@pytest.mark.parametrize(("samples", "limit"), [(130, 2e-4), (65, 5e-4)])
@pytest.mark.parametrize("estimator", OVER_THE_GATE)
def test_the_gates_edges_do_not_bias_a_rigid_motion_over_1000_draws(
    wide: TableOne, estimator: Estimator, samples: int, limit: float
) -> None:
    errors = _errors(_one_cycle(wide, samples), 1000, estimator)
    assert np.sqrt(np.mean(errors**2)) < limit


@pytest.mark.parametrize("estimator", OVER_THE_GATE)
@pytest.mark.parametrize("margin", [0, 67])
def test_the_stated_edge_uncertainty_is_the_error_of_a_rigid_motion(
    wide: TableOne, margin: int, estimator: Estimator
) -> None:
    table = replace(_one_cycle(wide, 130), margin=margin)
    error = np.sqrt(np.mean(_errors(table, 15, estimator) ** 2))
    stated = table.gate(np.zeros((20, 130 + 2 * margin))).edge_uncertainty()
    assert stated / 4 < error < 1.5 * stated


def test_a_rigid_motion_at_60_db_is_within_its_uncertainty(wide: TableOne) -> None:
    generator = np.random.default_rng(43)
    echoes = _rigid(wide, generator)
    volts = echoes + 1e-3 * echoes.std() * generator.standard_normal((40, *echoes.shape))
    fit = estimate(wide.gate(volts), [200.0])
    # 40 draws: the standard deviation of their mean square is sqrt(2 / 40) = 0.22; three of these; u is 0.2 nm of 1000
    error = (fit.amplitude_m - 1e-6) / np.sqrt(fit.covariance[:, :, 0, 0])
    assert np.mean(error**2) == pytest.approx(1.0, abs=0.7)


def test_the_gates_edges_do_not_bias_kasai_divided_by_the_mean_frequency(wide: TableOne) -> None:
    table = _one_cycle(wide, 130)
    echoes = table.gate(_draws(table, 15))
    mean_hz = pulse_steps(*band_spectrum(echoes)).mean_hz
    errors = least_squares(kasai(echoes), [200.0]).amplitude_m[:, 0] * echoes.carrier_hz / mean_hz / 1e-6 - 1
    assert np.sqrt(np.mean(errors**2)) < 2e-4


@pytest.mark.parametrize(
    ("margin", "estimator", "trials"),
    [
        *((0, name, 200) for name in ESTIMATORS),
        (67, "coherent", 200),
        *(pytest.param(margin, name, 600, marks=pytest.mark.slow) for margin in (0, 67) for name in ESTIMATORS),
    ],
)
def test_white_noise_alone_is_not_significant_motion(
    wide: TableOne, estimator: Estimator, margin: int, trials: int
) -> None:
    table = replace(wide, margin=margin)
    try:
        fit = estimate(table.gate(_noise(trials, 130 + 2 * margin)), [200.0], estimator)
    except ValueError:
        return
    with np.errstate(invalid="ignore"):
        alarms = np.sum(fit.amplitude_m[:, 0] > 3 * np.sqrt(fit.covariance[:, 0, 0, 0]))
    # exceeds three u by chance in exp(-9/2) = 1.1 %, never in refused trains; three deviations of the trials
    expected = np.exp(-4.5) * trials
    assert alarms <= expected + 3 * np.sqrt(expected)
    # one train in a thousand passes for echoes by chance
    assert np.isfinite(fit.amplitude_m[:, 0]).sum() <= 0.005 * trials


@pytest.mark.parametrize("estimator", ESTIMATORS)
@pytest.mark.parametrize("snr_db", [0.0, *(pytest.param(snr_db, marks=pytest.mark.slow) for snr_db in (10.0, 20.0))])
def test_echoes_above_their_noise_are_not_refused(
    wide: TableOne, wide_draws: FloatArray, estimator: Estimator, snr_db: float
) -> None:
    noise = np.random.default_rng(45).standard_normal((len(wide_draws), 100, wide_draws.shape[-1]))
    rms = np.sqrt(np.mean(wide_draws**2, axis=(-2, -1), keepdims=True) / 10 ** (snr_db / 10))
    fit = estimate(wide.gate(wide_draws + rms * noise), [200.0], estimator)
    assert np.isfinite(fit.amplitude_m).all()


@pytest.mark.parametrize("pulses", [2, *(pytest.param(pulses, marks=pytest.mark.slow) for pulses in (5, 30, 300))])
@pytest.mark.parametrize("independent", [3, 12])
def test_trains_of_noise_pass_for_echoes_once_in_a_thousand(pulses: int, independent: int) -> None:
    generator = np.random.default_rng(46)
    passed, trials = 0, 20_000 if pulses < 100 else 3000
    for batch in np.array_split(np.arange(trials), max(1, trials * pulses // 100_000)):
        normal = generator.standard_normal((2, batch.size, pulses, independent))
        echo = normal[0] + 1j * normal[1]
        cross = np.abs(np.einsum("...i,...i->...", np.conj(echo[:, :-1]), echo[:, 1:]))
        energy = np.einsum("...i,...i->...", echo, np.conj(echo)).real
        try:
            passed += int(are_correlated(cross, energy, independent).sum())
        except ValueError:
            continue
    # the mean of few pairs is not yet normal: up to three in a thousand, and three deviations of the trials
    assert passed <= 0.003 * trials + 3 * np.sqrt(0.003 * trials)


def test_bad_trains_of_a_batch_are_nan_and_do_not_affect_the_others(wide: TableOne, wide_draws: FloatArray) -> None:
    good = wide_draws[:4]
    bad = good.copy()
    bad[1], bad[2, 5, 70] = 0.0, np.nan
    for estimator in ESTIMATORS:
        expected, fit = (estimate(wide.gate(volts), [200.0], estimator) for volts in (good, bad))
        assert np.isnan(fit.amplitude_m[1:3]).all()
        np.testing.assert_allclose(fit.amplitude_m[[0, 3]], expected.amplitude_m[[0, 3]], rtol=1e-9)


@pytest.mark.parametrize("dtype", [">f8", ">f4", "<f2", "f16", "<i2", ">i4", "u1"])
def test_volts_and_times_may_have_any_real_type_and_byte_order(
    wide: TableOne, wide_draws: FloatArray, dtype: str
) -> None:
    kind = np.dtype("f16" if dtype == "f16" and hasattr(np, "float128") else dtype if dtype != "f16" else "f8")
    volts = np.round(100 + 80 * wide_draws[0] / np.abs(wide_draws[0]).max())
    plain = wide.gate(volts)
    times = np.arange(100)
    typed = replace(plain, volts=volts.astype(kind), pulse_time_s=times.astype(kind), margin=plain.margin)
    np.testing.assert_allclose(coherent(typed).displacement_m, coherent(plain).displacement_m, rtol=0, atol=1e-11)
    assert typed.volts.dtype.isnative


@pytest.mark.parametrize("kind", [bool, complex, object, str])
def test_volts_that_are_not_real_numbers_are_refused(wide: TableOne, wide_draws: FloatArray, kind: type) -> None:
    plain = wide.gate(wide_draws[0])
    with pytest.raises(TypeError, match="volts of type"):
        replace(plain, volts=plain.volts.astype(kind))


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"carrier_hz": 60e6}, "half the sampling rate"),
        ({"carrier_hz": 0.0}, "half the sampling rate"),
        ({"sound_speed_m_per_s": 0.0}, "must be positive"),
        ({"sound_speed_m_per_s": -1540.0}, "must be positive"),
        ({"margin": (200, 64)}, "leave no gate"),
    ],
)
def test_impossible_settings_are_refused(
    wide: TableOne, wide_draws: FloatArray, settings: dict[str, float], words: str
) -> None:
    gate: EchoGate = wide.gate(wide_draws[0])
    with pytest.raises(ValueError, match=words):
        replace(gate, **settings)
