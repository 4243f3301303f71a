"""Errors and run times of the motion estimators on echoes of the twin; the paper's parameters are varied one by one."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from hpe_rig.arrays import FloatArray
from hpe_rig.medium import scatterer_density
from hpe_rig.prediction import Conditions, EstimatorErrors, draw_speckle, echo_bound, estimator_errors
from hpe_rig.processing import ESTIMATORS, EchoGate, estimate, harmonic_columns, margin_samples
from hpe_rig.scene import Estimator
from hpe_rig.validation.accuracy.work_precision import draw_panels, grouped, timed

PARAMETERS: dict[str, tuple[float, ...]] = {
    "snr_db": (0, 10, 20, 30, 40, 60),
    "amplitude_m": (100e-9, 500e-9, 1e-6, 5e-6, 10e-6),
    "cycles": (3, 5, 10, 15, 20),
    "points": (5, 10, 15, 20, 25, 30),
    "per_cell": (11, 16, 21, 27, 33),
    "gate_length_m": (0.5e-3, 1e-3, 2e-3),
    "sample_rate_hz": (50e6, 100e6, 200e6),
    "bandwidth": (0.065, 0.2, 0.4, 0.75),
}
"""Values of Figs. 4 to 11, by the paper's parameter: SNR, D_0, N_c, N_p, N_s, l_g, F_s, BW."""


@dataclass(frozen=True, slots=True)
class MotionCase:
    """Settings of one case, by default Table I. ``margin``: samples of the record on each side of the gate."""

    snr_db: float = 20.0
    amplitude_m: float = 1e-6
    cycles: float = 5
    points: float = 20
    per_cell: float = 11.0
    gate_length_m: float = 1e-3
    sample_rate_hz: float = 100e6
    bandwidth: float = 0.065
    frequency_hz: float = 200.0
    carrier_hz: float = 9e6
    sound_speed_m_per_s: float = 1540.0
    margin: int = 0

    @property
    def pulse_time_s(self) -> FloatArray:
        """Sampling times of the motion, s, (pulse,)."""
        return np.arange(round(self.cycles * self.points)) / (self.points * self.frequency_hz)

    @property
    def gate_s(self) -> FloatArray:
        """Sample times relative to the echo of the focus, margins included, s, (sample,)."""
        samples = round(2 * self.gate_length_m / self.sound_speed_m_per_s * self.sample_rate_hz) + 2 * self.margin
        return np.asarray((np.arange(samples) - (samples - 1) / 2) / self.sample_rate_hz, dtype=np.float64)

    def twin_echoes(self, draws: int, generator: np.random.Generator) -> FloatArray:
        """Return noise-free echoes of the twin (draw, pulse, sample) from scatterers that move by D_0 sin(2 pi f t)."""
        from sim_backend.echoes import drawn_echoes, hann_pulse
        from sim_backend.settings import Scatterers, SimulationSettings

        settings = SimulationSettings(
            scatterers=Scatterers(per_cell=self.per_cell, bandwidth=self.bandwidth),
            sound_speed_m_per_s=self.sound_speed_m_per_s,
        )
        displacement_m = self.amplitude_m * np.sin(2 * np.pi * self.frequency_hz * self.pulse_time_s)
        pulse = hann_pulse(self.carrier_hz, self.bandwidth)
        return np.concatenate(list(drawn_echoes(settings, displacement_m, pulse, self.gate_s, generator, draws, 1e-7)))

    def gate(self, volts: FloatArray) -> EchoGate:
        """Return echoes (..., pulse, sample) as input of the estimators."""
        valid, margins = np.ones(volts.shape[-2], dtype=bool), (self.margin, self.margin)
        carrier_hz, speed_m_per_s = self.carrier_hz, self.sound_speed_m_per_s
        return EchoGate(volts, self.sample_rate_hz, self.pulse_time_s, carrier_hz, speed_m_per_s, valid, margins)


@dataclass(frozen=True, slots=True)
class MotionRow:
    """Bias, jitters (standard deviations), efficiency and run time of one estimator in one case."""

    parameter: str
    value: float
    snr_db: float
    estimator: str
    draws: int
    bias_m: float
    noise_jitter_m: float
    speckle_jitter_m: float
    phase_bias_rad: float
    phase_jitter_rad: float
    bound_m: float
    efficiency: float
    """Bound over noise jitter, the jitter from the central 68 % of the errors."""
    normalised_error: float
    """Mean square noise error over the stated variance: 1 if the stated uncertainty is right."""
    predicted_bias_m: float
    predicted_noise_m: float
    predicted_speckle_m: float
    us_per_pulse: float
    cores: int


def rows(
    parameters: Sequence[str] = tuple(PARAMETERS),
    estimators: Sequence[Estimator] = ESTIMATORS,
    draws: int = 200,
    snr_db: Sequence[float] = (10.0, 40.0),
    seed: int = 0,
) -> Iterator[MotionRow]:
    """Yield a row for every value of each parameter, SNR and estimator. For ``snr_db`` the value replaces the SNR."""
    for name in parameters:
        for value in PARAMETERS[name]:
            for level in (value,) if name == "snr_db" else snr_db:
                change: dict[str, Any] = {name: value}
                case = replace(MotionCase(snr_db=level), **change)
                yield from case_rows(case, name, value, estimators, draws, seed)


def draw_motion(rows: Sequence[MotionRow], path: Path) -> None:
    """Draw noise jitter over its bound against time per pulse, one panel per parameter."""
    panels = {
        name: {
            estimator: [(row.us_per_pulse, row.noise_jitter_m / row.bound_m) for row in estimator_rows]
            for estimator, estimator_rows in grouped(parameter_rows, lambda row: row.estimator).items()
        }
        for name, parameter_rows in grouped(rows, lambda row: row.parameter).items()
    }
    draw_panels(panels, path, "time per pulse (us)", "noise jitter / bound", over_bound=True)


def case_rows(
    case: MotionCase, parameter: str, value: float, estimators: Sequence[Estimator], draws: int, seed: int
) -> Iterator[MotionRow]:
    """Yield a row for every estimator, from the same echoes and noise and with the margins of a record."""
    # Estimators need echoes beyond the gate, as a record has them.
    case = replace(case, margin=margin_samples(case.sample_rate_hz, case.carrier_hz))
    clean = case.twin_echoes(draws, np.random.default_rng([seed, 0]))
    gated = clean[..., case.margin : -case.margin]
    # The noise of each draw is relative to the energy of its echoes, as the SNR is defined.
    noise_v = np.sqrt(np.mean(gated**2, axis=(-2, -1), keepdims=True) / 10 ** (case.snr_db / 10))
    noisy = clean + noise_v * np.random.default_rng([seed, 1]).standard_normal(clean.shape)
    # Cramer-Rao bound of the amplitude for the known echoes.
    columns = harmonic_columns(case.pulse_time_s, np.array([case.frequency_hz]))
    bound = echo_bound(gated[:, 0], case.sample_rate_hz, noise_v[:, 0, 0], columns, case.sound_speed_m_per_s)
    conditions = conditions_of(case)
    speckle = draw_speckle(conditions, np.random.default_rng([seed, 2]))
    for name in estimators:
        model = estimator_errors(conditions, name, speckle, np.random.default_rng([seed, 3]))
        yield _row(case, parameter, value, name, clean, noisy, np.sqrt(bound[:, 0, 0]), model)


def conditions_of(case: MotionCase) -> Conditions:
    """Return the case as input of the analytic error model."""
    tracking = (0.078e-3, 0.078e-3, 0.83e-3)
    return Conditions(
        excitation_width_m=(0.17e-3, 0.17e-3, 1.80e-3),
        tracking_width_m=tracking,
        gate_length_m=case.gate_length_m,
        pulse_length_m=case.sound_speed_m_per_s / 2 / (case.bandwidth * case.carrier_hz),
        scatterers_per_m3=scatterer_density(tracking, case.per_cell),
        carrier_hz=case.carrier_hz,
        sound_speed_m_per_s=case.sound_speed_m_per_s,
        sample_rate_hz=case.sample_rate_hz,
        pulse_rate_hz=case.points * case.frequency_hz,
        pulses=case.pulse_time_s.size,
        frequency_hz=case.frequency_hz,
        amplitude_m=case.amplitude_m,
        snr=10 ** (case.snr_db / 10),
    )


def _row(
    case: MotionCase,
    parameter: str,
    value: float,
    name: Estimator,
    clean: FloatArray,
    noisy: FloatArray,
    bound_m: FloatArray,
    model: EstimatorErrors,
) -> MotionRow:
    noise_free = estimate(case.gate(clean), [case.frequency_hz], name)
    fit, time_s = timed(lambda: estimate(case.gate(noisy), [case.frequency_hz], name))
    amplitude_m, phase_rad = fit.amplitude_m[:, 0], fit.phase_rad[:, 0]
    error_m = amplitude_m - noise_free.amplitude_m[:, 0]
    # Half the width of the central 68 % is robust against jumps by a wavelength.
    low, high = np.quantile(error_m / bound_m, [0.1587, 0.8413])
    return MotionRow(
        parameter=parameter,
        value=value,
        snr_db=case.snr_db,
        estimator=name,
        draws=len(clean),
        bias_m=float(amplitude_m.mean() - case.amplitude_m),
        noise_jitter_m=float(np.sqrt(np.mean((error_m - error_m.mean()) ** 2))),
        speckle_jitter_m=float(noise_free.amplitude_m[:, 0].std()),
        phase_bias_rad=float(phase_rad.mean()),
        phase_jitter_rad=float(phase_rad.std()),
        bound_m=float(np.sqrt(np.mean(bound_m**2))),
        efficiency=float(2 / (high - low)),
        normalised_error=float(np.mean(error_m**2 / fit.covariance[:, 0, 0, 0])),
        predicted_bias_m=model.bias_m,
        predicted_noise_m=model.noise_jitter_m,
        predicted_speckle_m=model.speckle_jitter_m,
        us_per_pulse=time_s / (amplitude_m.size * case.pulse_time_s.size) * 1e6,
        cores=os.cpu_count() or 1,
    )
