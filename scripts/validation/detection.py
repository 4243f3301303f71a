"""The detection floor by simulation: how often echoes at rest exceed it, and what trigger jitter makes of it.

First table: scene `table-1` without its motion, new scatterers and noise in every trial; by estimator and SNR, share of
trials whose amplitude at 200 Hz exceeds the floor that `hpe-rig check` states, and share in which it exceeds three
times its own uncertainty. Second table: floor of `bovine-muscle` and the simulated amplitudes that one in twenty
measurements exceeds while no toneburst pushes, with and without 1 ns of trigger jitter, by the prior of media and by
least squares.
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
AT_ONCE = 50
JITTER_S = (0.0, 1e-9)
ABOVE_3_U = math.exp(-9 / 2)
"""Share of measurements without motion whose amplitude is above three times its uncertainty."""


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=int, default=4000)
    parser.add_argument("--estimators", nargs="+", default=list(ESTIMATORS), choices=ESTIMATORS)
    asked = parser.parse_args()
    for line in alarm_table(asked.estimators, asked.trials):
        print(line, flush=True)
    print()
    for line in jitter_table(asked.trials):
        print(line, flush=True)


def alarm_table(estimators: Sequence[str], trials: int) -> Iterator[str]:
    """Yield the shares above floor and 3 u, a row an estimator, a column an SNR, and their Monte Carlo errors below."""
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
    """Return the detection floor, and amplitudes and their u (trial,) of echoes at rest, NaN where refused; m."""
    asked = {"processing.expected_snr_db": snr_db, "processing.estimator": estimator}
    setup = prepare(hpe.load_scene("table-1").with_(asked))
    scene, shot = setup.scene.scene, setup.plan.shots[0]
    time_s, speed_m_per_s = select(scene, shot).time_s, scene.acquisition.sound_speed_m_per_s
    # As in a record, echo goes on at both ends of the gate.
    margin = margin_samples(SAMPLE_RATE_HZ, CARRIER_HZ)
    samples = shot.gate.stop - shot.gate.start + 2 * margin
    gate_s = (np.arange(samples) - (samples - 1) / 2) / SAMPLE_RATE_HZ
    settings, pulse = SimulationSettings(), hann_pulse(CARRIER_HZ, BANDWIDTH)
    scatterers, noise = np.random.default_rng([7, 0]), np.random.default_rng([7, 1])
    everything, found = np.ones(time_s.size, dtype=bool), list[FloatArray]()
    # At rest all pulses bring the same echo.
    for still in drawn_echoes(settings, np.zeros(1), pulse, gate_s, scatterers, trials, 1e-6):
        for some in np.array_split(still, max(1, len(still) // AT_ONCE)):
            held = some[..., margin : samples - margin]
            rms = np.sqrt(np.mean(held**2, axis=(-2, -1), keepdims=True) / 10 ** (snr_db / 10))
            volts = some + rms * noise.standard_normal((len(some), time_s.size, samples))
            gate = EchoGate(
                volts, SAMPLE_RATE_HZ, time_s, CARRIER_HZ, speed_m_per_s, everything, margin=(margin, margin)
            )
            fit = estimate(gate, [200.0], estimator)
            found.append(np.stack([fit.amplitude_m[:, 0], np.sqrt(fit.covariance[:, 0, 0, 0])]))
    amplitude_m, u_m = np.concatenate(found, axis=1)
    return detection_floor(scene, True, shot).detected_m, amplitude_m, u_m


def jitter_table(trials: int) -> Iterator[str]:
    """Yield the floors of the muscle scene, a row a trigger jitter and way to fit."""
    yield "| trigger jitter | fit | stated floor | exceeded by 5 % | alarms at the worst frequency |"
    yield "|---|---|---:|---:|---:|"
    for jitter_s in JITTER_S:
        for harmonic in ("least_squares", "medium_prior"):
            floor_m, amplitude_m = muscle_at_rest(jitter_s, harmonic, trials)
            reached_m = np.quantile(amplitude_m, 1 - FALSE_ALARMS, axis=0).max()
            alarms = np.mean(amplitude_m > floor_m, axis=0).max()
            yield (
                f"| {jitter_s * 1e9:g} ns | {harmonic} | {floor_m * 1e9:.3g} nm | {reached_m * 1e9:.3g} nm "
                f"| {100 * alarms:.1f} % |"
            )


def muscle_at_rest(jitter_s: float, harmonic: str, trials: int) -> tuple[float, FloatArray]:
    """Return the floor and the amplitudes (trial, frequency) that noise and jitter alone make, m.

    Displacements are drawn as white noise of the variance that the floor takes for a pulse: what is tested is the fit.
    """
    asked = {"processing.harmonic": harmonic, "simulation.instruments.trigger_jitter_s": jitter_s}
    setup = prepare(hpe.load_scene("bovine-muscle").with_(asked))
    scene, shot = setup.scene.scene, setup.plan.shots[0]
    floor, chosen = detection_floor(scene, True, shot), select(scene, shot)
    options = options_of(scene.processing, shot_prior(scene, shot, "coherent", beam_widths(scene, "coherent")))
    pulse_m = floor.quadrature_m / noise_gain(scene, shot).max()
    noise = np.random.default_rng(11).standard_normal((trials, chosen.time_s.size)) * pulse_m
    motion = Motion(chosen.time_s, np.where(chosen.used, noise, np.nan), np.full(noise.shape, pulse_m**2), chosen.used)
    fit = fit_motion(motion, chosen.wanted_hz, "coherent", chosen.driven_hz, options)
    return floor.detected_m, fit.amplitude_m


if __name__ == "__main__":
    main()
