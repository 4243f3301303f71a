"""Coverage of the 95 % intervals with clocks that differ, with and without the rate error as an unknown.

Usage: python scripts/validation/clocks.py [--draws 20] [--window 1.0 ...] [--clocks 2e-6 ...] [--noise 13e-9]

Rows: windows of 0.2, 1, 10 and 250 s, and clocks of 2, 10, 20 and 50 ppm, with a rate error drawn for each. The motion
is that of a Voigt medium (9 kPa, 2 Pa s) under tonebursts at 100 Hz, with the noise of echoes of 40 dB, fitted with the
prior of media at ten harmonics. At 250 s ``hpe_rig.estimate`` gets echoes of one sinusoid at 200 Hz.
"""

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache

import numpy as np

import hpe_rig as hpe
from hpe_rig.arrays import ComplexArray, FloatArray
from hpe_rig.medium import BeamWidths, HarmonicMedium, tracked_motion
from hpe_rig.processing import (
    Motion,
    RateError,
    estimate_rate_error,
    medium_fit,
    medium_prior,
    with_rate_error,
)

WINDOWS_S, ACCURACIES = (0.2, 1.0, 10.0, 250.0), (2e-6, 10e-6, 20e-6, 50e-6)
BURST_HZ, BURST_S, PULSE_HZ, RMS_M = 100.0, 100e-6, 3990.0, 0.7e-6
NOISE_40_DB_M = 13e-9
WANTED_HZ = BURST_HZ * np.arange(1.0, 11.0)
BEAMS = BeamWidths((0.34e-3, 0.34e-3, 3.60e-3), (0.078e-3, 0.078e-3, 0.83e-3), 0.27e-3)
LONG_S, LONG_PULSE_HZ, LONG_HZ, LONG_M = 250.0, 500.0, 200.0, 1e-6
SAMPLES, SAMPLE_HZ, CARRIER_HZ = 64, 50e6, 9e6


@dataclass(frozen=True)
class Draw:
    """Errors of one draw over their u, amplitude and phase of every frequency: without and with the unknown.

    ``unknown_error``: error of the rate error over its u. ``is_named``: a sentence names the clocks.
    """

    without: FloatArray
    corrected: FloatArray
    unknown_error: float
    phase_error_deg: float
    is_named: bool


def medium_draw(window_s: float, accuracy: float, seed: int, noise_m: float = NOISE_40_DB_M) -> Draw:
    """Return a draw with tonebursts and a prior of media."""
    rng = np.random.default_rng(seed)
    prior = medium_prior(BEAMS, BURST_HZ, BURST_S)
    error = accuracy * rng.standard_normal()
    truth_m = voigt_motion()
    time_s = 0.05 + 131e-6 + np.arange(round(window_s * PULSE_HZ)) / PULSE_HZ
    in_period_s = time_s % (1 / BURST_HZ)
    valid = (in_period_s > 105e-6) & (in_period_s < 1 / BURST_HZ - 95e-6)
    displacement_m = noise_m * rng.standard_normal(time_s.size)
    for number, phasor_m in enumerate(truth_m, 1):
        displacement_m += (phasor_m * np.exp(2j * np.pi * BURST_HZ * number * (1 + error) * time_s)).imag
    motion = Motion(time_s, displacement_m, np.full(time_s.size, noise_m**2), valid)
    rate = estimate_rate_error(motion, WANTED_HZ, RateError(0.0, accuracy), also_hz=np.zeros(0), prior=prior)

    def fitted(rate_error: float) -> tuple[ComplexArray, FloatArray]:
        fit = medium_fit(with_rate_error(motion, rate_error), WANTED_HZ, prior).fit
        return fit.amplitude_m * np.exp(1j * fit.phase_rad), np.diagonal(fit.covariance, axis1=1, axis2=2)

    phasor_m, variance = fitted(rate.value)
    fast_m, slow_m = (fitted(rate.value + sign * rate.uncertainty)[0] for sign in (1, -1))
    change = (fast_m - slow_m) / 2 / phasor_m
    u = np.sqrt(variance + np.stack([(change.real * np.abs(phasor_m)) ** 2, change.imag**2], axis=1))
    nominal_m, nominal_variance = fitted(0.0)
    without = errors(nominal_m, truth_m[:10]) / np.sqrt(nominal_variance)
    shift_rad = 2 * np.pi * WANTED_HZ * abs(rate.value) * time_s.mean()
    is_named = abs(rate.value) > 3 * rate.uncertainty and bool(np.any(shift_rad > u[:, 1]))
    corrected = errors(phasor_m, truth_m[:10])
    return Draw(
        without=without,
        corrected=corrected / u,
        unknown_error=(rate.value - error) / rate.uncertainty,
        phase_error_deg=float(np.degrees(corrected[-1, 1])),
        is_named=is_named,
    )


@cache
def voigt_motion() -> ComplexArray:
    """Return the tracked phasors (harmonic,) under the tonebursts, up to 30 kHz, of ``RMS_M`` rms."""
    number = np.arange(1, 301)
    medium = HarmonicMedium(BURST_HZ * number, 9e3 + 2j * np.pi * BURST_HZ * number * 2.0)
    duty = BURST_HZ * BURST_S
    phasor = tracked_motion(medium, BEAMS)[0] * 1j * np.sinc(number * duty) * np.exp(-1j * np.pi * number * duty)
    return np.asarray(phasor * RMS_M / np.sqrt(np.sum(np.abs(phasor) ** 2) / 2))


def errors(estimate_m: ComplexArray, truth_m: ComplexArray) -> FloatArray:
    """Return the errors of amplitude and phase, (frequency, 2)."""
    return np.stack([np.abs(estimate_m) - np.abs(truth_m), np.angle(estimate_m / truth_m)], axis=1)


def long_draw(accuracy: float, seed: int) -> Draw:
    """Return a draw of ``hpe_rig.estimate`` with echoes of one sinusoid, 40 dB, for 250 s."""
    rng = np.random.default_rng(seed)
    error, phase_rad = accuracy * rng.standard_normal(), rng.uniform(-np.pi, np.pi)
    time_s = np.arange(round(LONG_S * LONG_PULSE_HZ)) / LONG_PULSE_HZ
    motion_m = LONG_M * np.sin(2 * np.pi * LONG_HZ * (1 + error) * time_s + phase_rad)
    delay_s = np.arange(SAMPLES) / SAMPLE_HZ - 2 * motion_m[:, None] / 1540.0
    centred_s = delay_s - SAMPLES / SAMPLE_HZ / 2
    echoes = np.exp(-((centred_s / 0.2e-6) ** 2)) * np.cos(2 * np.pi * CARRIER_HZ * centred_s)
    echoes += 0.01 * np.sqrt(np.mean(echoes**2)) * rng.standard_normal(echoes.shape)
    scores = []
    for stated in (0.0, accuracy):
        (shot,) = hpe.estimate(
            echoes,
            sample_rate_hz=SAMPLE_HZ,
            pulse_rate_hz=LONG_PULSE_HZ,
            carrier_hz=CARRIER_HZ,
            frequencies_hz=[LONG_HZ],
            frequency_accuracy=stated,
        ).shots
        estimate = shot.estimates[0]
        error_rad = float(np.angle(np.exp(1j * (estimate.phase_rad - phase_rad))))
        amplitude_score = (estimate.amplitude_m - LONG_M) / estimate.amplitude_uncertainty_m
        scores.append(np.array([[amplitude_score, error_rad / estimate.phase_uncertainty_rad]]))
    uncertainty = shot.frequency_error_uncertainty or np.inf
    return Draw(
        without=scores[0],
        corrected=scores[1],
        unknown_error=((shot.frequency_error or 0.0) - error) / uncertainty,
        phase_error_deg=float(np.degrees(error_rad)),
        is_named=any("clock of the motion" in text for text in shot.warnings),
    )


def row(window_s: float, accuracy: float, draws: list[Draw]) -> str:
    """Return the row of the table for the draws of one window and accuracy."""
    cells = []
    for scores in ([draw.without for draw in draws], [draw.corrected for draw in draws]):
        ratios = np.array(scores)
        inside = np.mean(np.abs(ratios) < 1.96, axis=(0, 1)) * 100
        cells += [f"{inside[0]:.0f}", f"{inside[1]:.0f}", f"{np.mean(ratios[..., 1] ** 2):.3g}"]
    wrong = [draw for draw in draws if np.abs(draw.without[:, 1]).max() > 3]
    rate = np.mean(np.square([draw.unknown_error for draw in draws]))
    phase = np.sqrt(np.mean(np.square([draw.phase_error_deg for draw in draws])))
    named = f"{sum(draw.is_named for draw in wrong)} of {len(wrong)}"
    return f"| {window_s:g} | {accuracy * 1e6:g} | {' | '.join(cells)} | {rate:.2f} | {phase:.2g} | {named} |"


def rows(windows_s: list[float], accuracies: list[float], count: int, noise_m: float) -> Iterator[str]:
    """Yield the rows of the table."""
    for window_s in windows_s:
        for accuracy in accuracies:
            draws = [
                long_draw(accuracy, seed) if window_s == LONG_S else medium_draw(window_s, accuracy, seed, noise_m)
                for seed in range(count)
            ]
            yield row(window_s, accuracy, draws)


def main() -> None:
    """Print the table row by row."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--draws", type=int, default=20, help="draws of clocks, noise and echoes a row")
    parser.add_argument("--window", type=float, nargs="+", default=list(WINDOWS_S), help="windows, s")
    parser.add_argument("--clocks", type=float, nargs="+", default=list(ACCURACIES), help="accuracies, such as 2e-6")
    parser.add_argument("--noise", type=float, default=NOISE_40_DB_M, help="noise of a pulse under tonebursts, m")
    arguments = parser.parse_args()
    print("| window, s | clocks, ppm | A 95 % | phase 95 % | NEV | A 95 % | phase 95 % | NEV | NEV e | deg | named |")
    print("|---|---|---|---|---|---|---|---|---|---|---|")
    for line in rows(arguments.window, arguments.clocks, arguments.draws, arguments.noise):
        print(line, flush=True)


if __name__ == "__main__":
    main()
