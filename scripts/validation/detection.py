"""False alarms of the detection floor by simulation, without motion, with and without trigger jitter.

First table: scene `table-1` without its motion, with new scatterers and noise in every trial. By estimator and SNR, it
has the fraction of amplitudes at 200 Hz above the floor of `hpe-rig check`, and the fraction above three times their
uncertainty. Second table: the floor of `bovine-muscle` without tonebursts, and the 95 % quantile of the simulated
amplitudes, with and without 1 ns of trigger jitter, for the medium prior and for least squares.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator, Sequence

import numpy as np

import hpe_rig as hpe
from hpe_rig.arrays import FloatArray
from hpe_rig.measurement import prepare
from hpe_rig.plan import select
from hpe_rig.prediction import FALSE_ALARMS, beam_widths, detection_floor, noise_gain
from hpe_rig.processing import (
    ESTIMATORS,
    EchoGate,
    Motion,
    estimate,
    fit_motion,
    margin_samples,
    options_of,
    shot_prior,
)
from sim_backend.echoes import drawn_echoes, hann_pulse
from sim_backend.settings import SimulationSettings

SNR_DB = (0.0, 10.0, 20.0, 40.0)
SAMPLE_RATE_HZ, CARRIER_HZ, BANDWIDTH = 100e6, 9e6, 0.065
BATCH = 50
"""Trials per call of the estimator."""
JITTER_S = (0.0, 1e-9)
ABOVE_3_U = math.exp(-9 / 2)
"""Probability that an amplitude of noise alone exceeds three times its uncertainty (Rayleigh distribution)."""


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=int, default=4000)
    parser.add_argument("--estimators", nargs="+", default=list(ESTIMATORS), choices=ESTIMATORS)
    arguments = parser.parse_args()
    for line in alarm_table(arguments.estimators, arguments.trials):
        print(line, flush=True)
    print()
    for line in jitter_table(arguments.trials):
        print(line, flush=True)


def alarm_table(estimators: Sequence[str], trials: int) -> Iterator[str]:
    """Yield the percentages above floor and 3 u, by estimator (row) and SNR (column), and their Monte Carlo errors."""
    yield "| estimator | " + " | ".join(f"{snr_db:g} dB" for snr_db in SNR_DB) + " |"
    yield "|---|" + "---:|" * len(SNR_DB)
    for name in estimators:
        cells = []
        for snr_db in SNR_DB:
            floor_m, amplitude_m, u_m = at_rest(snr_db, name, trials)
            above, significant = (100 * np.mean(amplitude_m > least_m) for least_m in (floor_m, 3 * u_m))
            cells.append(f"{above:.1f} % of {floor_m * 1e9:.3g} nm, {significant:.2f} %")
        yield f"| {name} | " + " | ".join(cells) + " |"
    errors = (f"{100 * math.sqrt(p * (1 - p) / trials):.2g} % of {100 * p:.3g} %" for p in (FALSE_ALARMS, ABOVE_3_U))
    yield f"\n{trials} trials; Monte Carlo standard errors: {', '.join(errors)}."


def at_rest(snr_db: float, estimator: str, trials: int) -> tuple[float, FloatArray, FloatArray]:
    """Return the detection floor, and amplitudes and u (trial,) of stationary echoes, NaN if refused; m."""
    changes = {"processing.expected_snr_db": snr_db, "processing.estimator": estimator}
    setup = prepare(hpe.load_scene("table-1").with_(changes))
    scene, shot = setup.scene.scene, setup.plan.shots[0]
    time_s, speed_m_per_s = select(scene, shot).time_s, scene.acquisition.sound_speed_m_per_s
    # The echo continues beyond both ends of the gate, as in a record.
    margin = margin_samples(SAMPLE_RATE_HZ, CARRIER_HZ)
    samples = shot.gate.stop - shot.gate.start + 2 * margin
    gate_s = (np.arange(samples) - (samples - 1) / 2) / SAMPLE_RATE_HZ
    settings, pulse = SimulationSettings(), hann_pulse(CARRIER_HZ, BANDWIDTH)
    # Scatterers and noise have independent seeds.
    scatterers, noise = np.random.default_rng([7, 0]), np.random.default_rng([7, 1])
    valid, batches = np.ones(time_s.size, dtype=bool), list[FloatArray]()
    # Without motion all pulses have the same echo; the noise differs.
    for clean in drawn_echoes(settings, np.zeros(1), pulse, gate_s, scatterers, trials, 1e-6):
        for echo in np.array_split(clean, max(1, len(clean) // BATCH)):
            gated = echo[..., margin : samples - margin]
            noise_v = np.sqrt(np.mean(gated**2, axis=(-2, -1), keepdims=True) / 10 ** (snr_db / 10))
            volts = echo + noise_v * noise.standard_normal((len(echo), time_s.size, samples))
            gate = EchoGate(volts, SAMPLE_RATE_HZ, time_s, CARRIER_HZ, speed_m_per_s, valid, margin=(margin, margin))
            fit = estimate(gate, [200.0], estimator)
            batches.append(np.stack([fit.amplitude_m[:, 0], np.sqrt(fit.covariance[:, 0, 0, 0])]))
    amplitude_m, u_m = np.concatenate(batches, axis=1)
    return detection_floor(scene, True, shot).detected_m, amplitude_m, u_m


def jitter_table(trials: int) -> Iterator[str]:
    """Yield the floors of the muscle scene by trigger jitter and fit."""
    yield "| trigger jitter | fit | stated floor | 95 % quantile | alarms at the worst frequency |"
    yield "|---|---|---:|---:|---:|"
    for jitter_s in JITTER_S:
        for harmonic in ("least_squares", "medium_prior"):
            floor_m, amplitude_m = muscle_at_rest(jitter_s, harmonic, trials)
            quantile_m = np.quantile(amplitude_m, 1 - FALSE_ALARMS, axis=0).max()
            alarms = np.mean(amplitude_m > floor_m, axis=0).max()
            yield (
                f"| {jitter_s * 1e9:g} ns | {harmonic} | {floor_m * 1e9:.3g} nm | {quantile_m * 1e9:.3g} nm "
                f"| {100 * alarms:.1f} % |"
            )


def muscle_at_rest(jitter_s: float, harmonic: str, trials: int) -> tuple[float, FloatArray]:
    """Return the floor, and amplitudes (trial, frequency) of noise and jitter alone, m.

    Displacements are white noise with the variance per pulse that the floor assumes, so the fit alone is tested.
    """
    changes = {"processing.harmonic": harmonic, "simulation.instruments.trigger_jitter_s": jitter_s}
    setup = prepare(hpe.load_scene("bovine-muscle").with_(changes))
    scene, shot = setup.scene.scene, setup.plan.shots[0]
    floor, pulses = detection_floor(scene, True, shot), select(scene, shot)
    options = options_of(scene.processing, shot_prior(scene, shot, "coherent", beam_widths(scene, "coherent")))
    # The floor states the noise of a quadrature; the fit has a known noise gain.
    pulse_m = floor.quadrature_m / noise_gain(scene, shot).max()
    noise = np.random.default_rng(11).standard_normal((trials, pulses.time_s.size)) * pulse_m
    motion = Motion(pulses.time_s, np.where(pulses.used, noise, np.nan), np.full(noise.shape, pulse_m**2), pulses.used)
    fit = fit_motion(motion, pulses.wanted_hz, "coherent", pulses.driven_hz, options)
    return floor.detected_m, fit.amplitude_m


if __name__ == "__main__":
    main()
