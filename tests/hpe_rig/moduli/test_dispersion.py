"""Dispersion from vibrations: exact on an independent field, true uncertainties, predicted bias, refusals."""

from __future__ import annotations

import csv
import io
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hpe_rig.arrays import FloatArray
from hpe_rig.medium import HarmonicMedium, PushForce, TrackedRegion, shear_motion
from hpe_rig.moduli import dispersion_of_vibrations
from hpe_rig.moduli.inversion import fit_medium
from hpe_rig.moduli.vibration_model import Push, Vibration
from hpe_rig.moduli.wavenumber_fit import DispersionCurve, curve_of_law, fit_wavenumbers

FREQUENCY_HZ = np.arange(100.0, 1001.0, 100.0)
PUSH = Push(PushForce((0.34e-3,), 3.6e-3), 100.0, 100e-6)
FIVE = (1e-3, 2.25e-3, 3.5e-3, 4.75e-3, 6e-3)
NOISE_M = 0.7e-9
ERRORS = {"gain_uncertainty": 0.005, "phase_uncertainty_rad": 0.002, "lateral_uncertainty_m": 40e-6}
HELD = json.loads((Path(__file__).parents[2] / "fixtures" / "held_shear_field.json").read_text(encoding="utf-8"))


def vibrations(
    modulus_pa: float = 9e3,
    viscosity_pa_s: float = 2.0,
    offsets_m: tuple[float, ...] = FIVE,
    frequency_hz: FloatArray = FREQUENCY_HZ,
    rng: np.random.Generator | None = None,
) -> list[Vibration]:
    """Return the exact motion at ``offsets_m``, 300 nm at the first; ``rng`` draws noise and errors of positions."""
    errors = np.zeros((3, len(offsets_m))) if rng is None else rng.standard_normal((3, len(offsets_m)))
    gain, phase, shift_m = errors * np.array([*ERRORS.values()])[:, None]
    medium = HarmonicMedium.voigt(modulus_pa, viscosity_pa_s, frequency_hz)
    region = TrackedRegion(np.array(offsets_m) + shift_m)
    field = shear_motion(medium, PUSH.force, region).value.T * PUSH.spectrum(frequency_hz)
    field *= 300e-9 / abs(field[0, 0]) * (1 + gain + 1j * phase)[:, None]
    if rng is not None:
        field += NOISE_M * rng.standard_normal((*field.shape, 2)).view(complex)[..., 0]
    covariance = NOISE_M**2 * np.eye(2 * frequency_hz.size)
    return [
        Vibration(f"{offset_m * 1e3:g} mm", frequency_hz, phasor, covariance, offset_m, **ERRORS)
        for offset_m, phasor in zip(offsets_m, field, strict=True)
    ]


def true_wave(modulus_pa: float, viscosity_pa_s: float, frequency_hz: FloatArray = FREQUENCY_HZ) -> Any:
    """Return phase velocity (m/s) and attenuation (Np/m) of a Voigt medium of 1000 kg/m3, (2, frequency)."""
    omega = 2 * np.pi * frequency_hz
    magnitude = np.hypot(modulus_pa, omega * viscosity_pa_s)
    # Chen, Fatemi, Greenleaf (2004); the attenuation is the same formula with a minus sign.
    speed = np.sqrt(2 * magnitude**2 / (1000 * (magnitude + modulus_pa)))
    return np.array([speed, omega * np.sqrt(1000 * (magnitude - modulus_pa) / 2) / magnitude])


@pytest.mark.parametrize("medium", HELD["media"][:1], ids=lambda medium: f"{medium['shear_modulus_pa']:g} Pa")
def test_an_independent_field_gives_phase_velocity_and_attenuation_to_1e_6(medium: dict[str, Any]) -> None:
    """The field is the one by quadrature of scripts/validation/held_shear_field.py, which uses none of our code."""
    phasors = np.array(medium["real_m"]) + 1j * np.array(medium["imaginary_m"])
    covariance = NOISE_M**2 * np.eye(2 * FREQUENCY_HZ.size)
    measured = [
        Vibration(f"{offset_m:g} m", FREQUENCY_HZ, phasor, covariance, offset_m)
        for offset_m, phasor in zip(HELD["lateral_m"], phasors, strict=True)
    ]
    curve = fit_wavenumbers(measured, PUSH).curve
    true = true_wave(medium["shear_modulus_pa"], medium["viscosity_pa_s"])
    assert curve.phase_velocity_m_per_s == pytest.approx(true[0], rel=1e-6)
    assert curve.attenuation_np_per_m == pytest.approx(true[1], rel=1e-6)


def test_the_curve_of_a_law_has_the_uncertainty_of_its_parameters() -> None:
    fit = fit_medium(vibrations(), PUSH)
    curve = curve_of_law(fit, FREQUENCY_HZ, 1000.0)
    assert np.array([curve.phase_velocity_m_per_s, curve.attenuation_np_per_m]) == pytest.approx(
        true_wave(9e3, 2.0), rel=1e-6
    )
    # Draws of the parameters: 5 standard deviations of the estimated one, 5 / sqrt(2 * 4000) = 5.6 %.
    draws = np.random.default_rng(1).multivariate_normal(list(fit.values.values()), fit.covariance, 4000)
    waves = np.array([true_wave(*draw) for draw in draws])
    stated = np.array([curve.phase_velocity_uncertainty_m_per_s, curve.attenuation_uncertainty_np_per_m])
    assert waves.std(axis=0) == pytest.approx(stated, rel=0.056)


@pytest.mark.slow
@pytest.mark.parametrize("seeds", [60])
def test_the_intervals_contain_the_truth_as_often_as_they_state(seeds: int) -> None:
    """The mean of z^2 is 1 within 3 sqrt(2 / seeds); docs/validation/dispersion.md has 200 seeds."""
    three_hz, true = FREQUENCY_HZ[[0, 3, 8]], true_wave(9e3, 2.0, FREQUENCY_HZ[[0, 3, 8]])
    z = []
    for seed in range(seeds):
        curve = fit_wavenumbers(vibrations(frequency_hz=three_hz, rng=np.random.default_rng(seed)), PUSH).curve
        z.append((curve.phase_velocity_m_per_s - true[0]) / curve.phase_velocity_uncertainty_m_per_s)
    assert np.all(abs(np.mean(np.square(z), axis=0) - 1) < 3 * np.sqrt(2 / seeds))


def test_methods_are_biased_as_predicted_and_their_u_is_the_scatter() -> None:
    """9 kPa, 2 Pa s at 1 to 6 mm: every method is a tenth too slow at 100 Hz, within its u of the prediction."""
    exact = {method.name: method for method in dispersion_of_vibrations(vibrations(), PUSH).methods}
    gradient = exact["phase gradient"]
    # Without noise the result is the prediction. An eighth too low: independent of the fit, from the exact phases.
    assert gradient.value == pytest.approx(gradient.predicted, rel=1e-6)
    phases = np.unwrap([np.angle(vibration.phasor_m[0]) for vibration in vibrations()])
    slope = np.polyfit(FIVE, phases, 1)[0]
    assert gradient.value[0] == pytest.approx(-2 * np.pi * 100 / slope, rel=1e-9)
    assert gradient.bias[0] / true_wave(9e3, 2.0)[0, 0] == pytest.approx(-0.126, abs=0.002)
    for name in ("2-D FT", "GST-SFK", "LPVI"):
        assert -0.13 < exact[name].bias[0] / true_wave(9e3, 2.0)[0, 0] < -0.11
    noisy = [dispersion_of_vibrations(vibrations(rng=np.random.default_rng(seed)), PUSH) for seed in range(2)]
    for index, method in enumerate(noisy[0].methods):
        # To 500 Hz, where no near-zero amplitude makes a method nonlinear. 4 sigma contains all 50 values with 99.7 %.
        curves = [result.methods[index] for result in noisy]
        z = [(curve.value - exact[method.name].value)[:5] / curve.uncertainty[:5] for curve in curves]
        assert np.abs(z).max() < 4
        assert np.sqrt(np.mean(np.square(z))) == pytest.approx(1.0, abs=0.6)


def test_free_amplitudes_leave_the_phase_methods_their_u_and_no_amplitude_decay() -> None:
    """Gains of 0.5 to 2 that the fit does not know: c and u of the phase gradient do not depend on them.

    u of the other methods stays that of noise and positions with these weights, within a factor of 2.
    """
    gains, measured = (1.0, 2.0, 0.5, 1.5, 0.7), vibrations(frequency_hz=FREQUENCY_HZ[:5], rng=np.random.default_rng(1))
    known = dispersion_of_vibrations(measured, PUSH)
    scaled = [
        replace(one, phasor_m=gain * one.phasor_m, covariance_m2=gain**2 * one.covariance_m2).with_free_gain()
        for gain, one in zip(gains, measured, strict=True)
    ]
    free = dispersion_of_vibrations(scaled, PUSH)
    for method, reference in zip(free.methods[:-1], known.methods[:-1], strict=True):
        assert np.all(np.isfinite(method.uncertainty)), method.name
        ratio = method.uncertainty / reference.uncertainty
        assert np.all((ratio > 0.5) & (ratio < 2)), method.name
        # The exact field has the gains of the fit, so that the predicted error is that of the weights of the data.
        assert np.abs(method.value - method.predicted)[:5] == pytest.approx(0, abs=4 * method.uncertainty[:5].max())
    gradient, reference = free.methods[0], known.methods[0]
    assert gradient.value == pytest.approx(reference.value, rel=1e-9)
    assert gradient.uncertainty == pytest.approx(reference.uncertainty, rel=0.01)
    assert np.isnan(free.methods[-1].value).all()
    assert "amplitude decay: the amplitude at every offset is free" in str(free)
    legend = {text.get_text() for text in free.figure().legends[0].get_texts()}
    assert legend == {"near field", "phase gradient", "2-D FT", "GST-SFK", "LPVI"}


def test_an_undetermined_u_is_stated() -> None:
    """Noise as large as the farthest amplitudes: an error of one u turns a phase beyond the next offset's."""
    noisy = [replace(one, covariance_m2=3e5 * one.covariance_m2) for one in vibrations(frequency_hz=FREQUENCY_HZ[:3])]
    result = dispersion_of_vibrations(noisy, PUSH)
    gradient = result.methods[0]
    undetermined = np.isfinite(gradient.value) & ~np.isfinite(gradient.uncertainty)
    assert undetermined.any()
    assert "Hz: u is undetermined" in str(result)
    assert ", no u (" in str(result)


def test_offsets_too_far_apart_have_no_phase_velocity() -> None:
    far = dispersion_of_vibrations(vibrations(4e3, 1.0), PUSH)
    half_wave_m = true_wave(4e3, 1.0)[0] / FREQUENCY_HZ / 2
    for method in far.methods:
        missing = np.isnan(method.value)
        assert np.array_equal(missing, ~method.is_attenuation & (half_wave_m < 1.25e-3))
    assert far.near_field.phase_velocity_m_per_s == pytest.approx(true_wave(4e3, 1.0)[0], rel=1e-5)


def test_what_is_left_out_is_stated() -> None:
    coarse = dispersion_of_vibrations(vibrations(4e3, 1.0, (1e-3, 3e-3, 5e-3, 7e-3)), PUSH)
    assert any("2-D FT at 700, 800, 900, 1000 Hz: offsets up to 2 mm apart" in line for line in coarse.omitted)
    near, *others = vibrations(offsets_m=FIVE[:3])
    without_last = [near, *(one.at_frequencies(FREQUENCY_HZ < 950) for one in others)]
    result = dispersion_of_vibrations(without_last, PUSH, "gel", simulated=True)
    assert result.near_field.frequency_hz.tolist() == FREQUENCY_HZ[:-1].tolist()
    assert "1000 Hz: significant at 1 of 3 offsets" in result.omitted
    assert "SIMULATED, lateral offsets 1, 2.25, 3.5 mm, 9 frequencies" in str(result)


def test_fewer_than_three_offsets_are_refused() -> None:
    reason = r"^no frequency is significant at 3 lateral offsets.*"
    with pytest.raises(
        ValueError, match=reason + r"with a vibration: 1 mm, 2\.25 mm\. Try: more values of sweep\.lateral"
    ):
        dispersion_of_vibrations(vibrations(offsets_m=FIVE[:2]), PUSH)
    # Enough offsets, but each frequency is significant at one of them only.
    scattered = [one.at_frequencies(hz == FREQUENCY_HZ) for one, hz in zip(vibrations(), FREQUENCY_HZ, strict=False)]
    with pytest.raises(ValueError, match=reason + "or a stronger push"):
        dispersion_of_vibrations(scattered, PUSH)
    # An offset on the axis counts for the near field; beside the push two are left.
    axis = dispersion_of_vibrations(vibrations(offsets_m=(0.0, *FIVE[:2])), PUSH)
    assert all(np.isnan(method.value).all() for method in axis.methods)
    assert any("fewer than 3 offsets beside the push" in line for line in axis.omitted)


def test_the_gate_nearest_to_the_focus_counts_at_every_offset() -> None:
    measured = vibrations(offsets_m=FIVE[:3], frequency_hz=FREQUENCY_HZ[:1])
    deeper = [replace(one, axial_m=1e-3, phasor_m=2 * one.phasor_m, position=one.label) for one in measured]
    together = [vibration for pair in zip(deeper, measured, strict=True) for vibration in pair]
    together = [replace(one, position=f"{one.lateral_m}") for one in together]
    value = dispersion_of_vibrations(together, PUSH).methods[0].value
    assert value == pytest.approx(dispersion_of_vibrations(measured, PUSH).methods[0].value, rel=1e-9)


def test_runs_at_the_same_offsets_are_analysed_together() -> None:
    measured = vibrations(offsets_m=FIVE[:3], frequency_hz=FREQUENCY_HZ[:1])
    repeated = [replace(one, position=f"{run}, {one.label}") for run in range(2) for one in measured]
    curves = zip(*(dispersion_of_vibrations(runs, PUSH).methods for runs in (measured, repeated)), strict=True)
    for one_run, two_runs in curves:
        assert two_runs.value == pytest.approx(one_run.value, rel=1e-9)


def test_the_fit_finds_the_minimum_from_a_curve_without_dispersion() -> None:
    flat = np.ones(3)
    start = DispersionCurve(FREQUENCY_HZ[[0, 3, 8]], 2.9 * flat, flat, 20 * flat, flat)
    curve = fit_wavenumbers(vibrations(frequency_hz=start.frequency_hz), PUSH, start).curve
    assert curve.phase_velocity_m_per_s == pytest.approx(true_wave(9e3, 2.0, start.frequency_hz)[0], rel=1e-6)


def test_rows_hold_every_method_and_frequency() -> None:
    result = dispersion_of_vibrations(vibrations(frequency_hz=FREQUENCY_HZ[:2]), PUSH)
    rows = list(csv.DictReader(io.StringIO(result.to_csv())))
    assert len(rows) == 6 * 2
    first = rows[0]
    assert (first["method"], float(first["frequency_hz"])) == ("near field", 100.0)
    assert float(first["attenuation_db_per_cm"]) == pytest.approx(
        20 * np.log10(np.e) * float(first["attenuation_np_per_m"]) / 100, rel=1e-12
    )
    assert [row["phase_velocity_m_per_s"] == "" for row in rows] == [row["method"] == "amplitude decay" for row in rows]
    figure = result.figure(figsize=(3.3, 4.4))
    assert len(figure.axes) == 2
    assert {text.get_text() for text in figure.legends[0].get_texts()} == {row["method"] for row in rows}
