"""Error due to the edges of the gate: rigid motion of 1 um, by estimator, gate length and margin.

Noise-free echoes of scatterers on the axis; the table has mean and standard deviation over draws of scatterers.
"""

from __future__ import annotations

import argparse

import numpy as np

from hpe_rig.arrays import FloatArray
from hpe_rig.processing import ESTIMATORS, EchoGate, estimate, margin_samples
from hpe_rig.scene import Estimator

SAMPLE_RATE_HZ, CARRIER_HZ, SOUND_SPEED, LENGTH_S = 100e6, 9e6, 1540.0, 1 / (0.065 * 9e6)
PULSE_TIME_S = np.arange(20) / 4000.0
DISPLACEMENT_M = 1e-6 * np.sin(2 * np.pi * 200.0 * PULSE_TIME_S + 0.3)


def main() -> None:
    """Print the table, one row per estimator, gate and margin."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--draws", type=int, default=400)
    draws = parser.parse_args().draws
    print(f"{'estimator':20}{'gate':>8}{'margin':>8}{'mean':>12}{'sd':>12}")
    for gate_m in (1e-3, 0.5e-3):
        for margin in (0, margin_samples(SAMPLE_RATE_HZ, CARRIER_HZ)):
            volts = echoes(gate_m, margin, draws)
            for name in ESTIMATORS:
                errors = 100 * relative_errors(volts, margin, name)
                print(f"{name:20}{gate_m * 1e3:5g} mm{margin:8}{errors.mean():10.4f} %{errors.std():10.4f} %")


def echoes(gate_m: float, margin: int, draws: int) -> FloatArray:
    """Return noise-free echoes (draw, pulse, sample) of a rigidly moving medium."""
    generator = np.random.default_rng(1)
    samples = round(2 * gate_m / SOUND_SPEED * SAMPLE_RATE_HZ) + 2 * margin
    time_s = np.arange(samples) / SAMPLE_RATE_HZ
    # 40 scatterers per mm, over the gate and the length of a pulse on each side.
    span_s = time_s[-1] + 2 * LENGTH_S
    count = round(40 * span_s * SOUND_SPEED / 2 / 1e-3)
    volts = np.empty((draws, DISPLACEMENT_M.size, samples))
    for draw in volts:
        delay_s = generator.uniform(-LENGTH_S, time_s[-1] + LENGTH_S, count)
        reflectivity = generator.standard_normal(count)
        for row, displacement_m in zip(draw, DISPLACEMENT_M, strict=True):
            age_s = time_s[:, None] - delay_s - 2 * displacement_m / SOUND_SPEED
            # Hann pulse with a bandwidth of 6.5 %.
            pulse = (np.abs(age_s) < LENGTH_S / 2) * np.cos(np.pi * age_s / LENGTH_S) ** 2
            row[:] = (pulse * np.cos(2 * np.pi * CARRIER_HZ * age_s)) @ reflectivity
    return volts


def relative_errors(volts: FloatArray, margin: int, name: Estimator) -> FloatArray:
    """Return the relative error of the amplitude (draw,)."""
    valid = np.ones(PULSE_TIME_S.size, dtype=bool)
    gate = EchoGate(volts, SAMPLE_RATE_HZ, PULSE_TIME_S, CARRIER_HZ, SOUND_SPEED, valid, (margin, margin))
    return np.asarray(estimate(gate, [200.0], name).amplitude_m[:, 0] / 1e-6 - 1)


if __name__ == "__main__":
    main()
