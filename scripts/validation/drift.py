"""Measure the effect of a drift within a train on results, how often it is reported, and how well it is removed.

The displacement is that of a Voigt medium (9 kPa, 2 Pa s) with 1000 harmonics, in the white noise of echoes of 15, 40
and 60 dB. It is steady, or it grows by 5 % and is delayed by 83 us, linearly over the train of 0.15 s, or modulus and
viscosity of the medium fall by 5 %. Results are those of the fit with the medium prior; u contains noise and aliasing.

Trials are stored in a folder, one file per row, and used again. The table of docs/validation/drift.md is replaced.

    python scripts/validation/drift.py --parts drift-parts --trials 60
    python scripts/validation/drift.py --parts drift-parts --trials 0        # the page only
"""

from __future__ import annotations

import argparse
import functools
import itertools
import json
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from medium_prior import BEAMS, HARMONIC, LENGTH_S, RATE_HZ, RMS_M, TRAINS, WANTED_HZ, train

from hpe_rig.arrays import ComplexArray, FloatArray
from hpe_rig.medium import HarmonicMedium, tracked_motion
from hpe_rig.processing import HarmonicFit, Motion, drift_of, medium_fit, medium_prior, with_drift_uncertainty

PAGE = Path(__file__).parents[2] / "docs" / "validation" / "drift.md"
TABLE_HEAD = """\
| pulses | SNR | change | reported | mean | first pulse | linear | NEV | u |
|---|---|---|---:|---:|---:|---:|---:|---:|"""
NOISE_M = {15: 212e-9, 40: 11.9e-9, 60: 1.19e-9}
"""Noise of a pulse by signal-to-noise ratio, dB: 130 samples at 9 MHz (docs/explanation/estimation.md)."""
MODULUS_PA, VISCOSITY_PA_S = 9e3, 2.0
GROWTH, DELAY_S, SOFTENING = 0.05, 83e-6, 0.05
CHANGES = ("none", "5 %, 83 us", "5 % softer")
COVERED_U = 1.96
FALSE_ALARM_PROBABILITY, VISIBLE_U = 0.01, 0.5
"""Limits of a warning, as in a result of one shot (hpe_rig/processing)."""
Trial = dict[str, list[float]]
"""Errors over u of amplitudes, then phases, by the value that they are compared with; 1 if the drift is reported."""


@functools.cache
def changed_phasors(change: str, position: float) -> ComplexArray:
    """Return the phasors (harmonic,), m, of the tracked motion at ``position``, 0 at the first pulse, 1 at the last."""

    def responses(softening: float) -> ComplexArray:
        modulus_pa = (1 - softening) * (MODULUS_PA + 2j * np.pi * RATE_HZ * HARMONIC * VISCOSITY_PA_S)
        duty = HARMONIC * RATE_HZ * LENGTH_S
        force = 1j * np.sinc(duty) * np.exp(-1j * np.pi * duty)
        return np.asarray(force * tracked_motion(HarmonicMedium(RATE_HZ * HARMONIC, modulus_pa), BEAMS)[0])

    steady = responses(0.0)
    scale_m = RMS_M / np.sqrt(np.sum(np.abs(steady) ** 2) / 2)
    if change == CHANGES[1]:
        delay_factor = np.exp(-2j * np.pi * RATE_HZ * HARMONIC * DELAY_S * position)
        return np.asarray(scale_m * steady * delay_factor * (1 + GROWTH * position))
    return scale_m * responses(SOFTENING * position if change == CHANGES[2] else 0.0)


def displacement_m(change: str, time_s: FloatArray) -> FloatArray:
    """Return the displacement (pulse,) of the motion that changes from the first pulse to the last."""
    position = (time_s - time_s[0]) / (time_s[-1] - time_s[0])
    first, middle, last = (changed_phasors(change, at) for at in (0.0, 0.5, 1.0))
    # Between the three the logarithm of each phasor is a parabola.
    to_middle, to_last = np.log(middle / first), np.log(middle / first) + np.log(last / middle)
    slope, curvature = 4 * to_middle - to_last, 2 * to_last - 4 * to_middle
    exponent = np.outer(position, slope) + np.outer(position**2, curvature)
    return np.asarray((first * np.exp(exponent + 2j * np.pi * RATE_HZ * np.outer(time_s, HARMONIC))).imag.sum(axis=1))


def errors_in_u(fit: HarmonicFit, phasor_m: ComplexArray) -> list[float]:
    """Return the errors of amplitudes, then phases, over their standard uncertainties."""
    wanted_m = phasor_m[: WANTED_HZ.size]
    amplitudes = (fit.amplitude_m - np.abs(wanted_m)) / np.sqrt(fit.covariance[:, 0, 0])
    phases = np.angle(np.exp(1j * fit.phase_rad) / wanted_m) / np.sqrt(fit.covariance[:, 1, 1])
    return [*amplitudes.tolist(), *phases.tolist()]


def trial(motion: Motion, change: str) -> Trial:
    """Return errors and the report for one ``motion`` with noise."""
    prior = medium_prior(BEAMS, RATE_HZ, LENGTH_S)
    mean = medium_fit(motion, WANTED_HZ, prior).fit
    tested = drift_of(motion, WANTED_HZ, prior=prior, max_iterations=1)
    drift = drift_of(motion, WANTED_HZ, prior=prior, background_order=1)
    in_u = [
        np.abs(tested.log_change.real) * mean.amplitude_m / np.sqrt(mean.covariance[:, 0, 0]),
        np.abs(tested.log_change.imag) / np.sqrt(mean.covariance[:, 1, 1]),
    ]
    steady = replace(motion, displacement_m=motion.displacement_m - drift.change_m(motion.time_s))
    linear = with_drift_uncertainty(medium_fit(steady, WANTED_HZ, prior, background_order=1).fit, drift)
    u_ratio = np.sqrt(np.diagonal(linear.covariance / mean.covariance, axis1=-2, axis2=-1).T)
    # The mean of a phasor that is a parabola in its logarithm, by Simpson's rule.
    first, middle, last = (changed_phasors(change, at) for at in (0.0, 0.5, 1.0))
    return {
        "mean": errors_in_u(mean, (first + 4 * middle + last) / 6),
        "first pulse": errors_in_u(mean, first),
        "linear": errors_in_u(linear, first),
        "u": u_ratio.ravel().tolist(),
        "reported": [float(tested.probability < FALSE_ALARM_PROBABILITY and np.max(in_u) > VISIBLE_U)],
    }


def rows(folder: Path, trials: int) -> Iterator[str]:
    """Yield the rows of the table; measure the trials that ``folder`` does not contain."""
    for pulses, snr_db, change in itertools.product(("shifting 3990 Hz", "synchronous 4000 Hz"), NOISE_M, CHANGES):
        path = folder / f"{pulses} {snr_db} {CHANGES.index(change)}.json"
        done: list[Trial] = json.loads(path.read_text(encoding="utf-8")) if path.exists() else []
        time_s, valid = train(*TRAINS[pulses])
        clean_m = displacement_m(change, time_s)
        for seed in range(len(done), trials):
            noise_m = NOISE_M[snr_db] * np.random.default_rng(seed).standard_normal(time_s.size)
            motion = Motion(time_s, clean_m + noise_m, np.full(time_s.size, NOISE_M[snr_db] ** 2), valid)
            done.append(trial(motion, change))
            if (seed + 1) % 20 == 0:
                path.write_text(json.dumps(done), encoding="utf-8")
        if done:
            yield _row(pulses, snr_db, change, done)


def _row(pulses: str, snr_db: int, change: str, trials: Sequence[Trial]) -> str:
    """Return a row: fractions of amplitudes and phases within their 95 % interval, in percent, and mean squares."""

    def pair(name: str, number: str) -> str:
        amplitudes, phases = np.hsplit(np.abs([item[name] for item in trials]), 2)
        if number == "%":
            return f"{np.mean(amplitudes < COVERED_U):.0%}, {np.mean(phases < COVERED_U):.0%}".replace("%", "")
        power = 2 if number == "NEV" else 1
        return f"{np.mean(amplitudes**power):.2g}, {np.mean(phases**power):.2g}"

    reported = sum(item["reported"][0] for item in trials)
    coverages = " | ".join(pair(name, "%") for name in ("mean", "first pulse", "linear"))
    return (
        f"| {pulses} | {snr_db} dB | {change} | {reported:.0f} of {len(trials)} | {coverages} | "
        f"{pair('linear', 'NEV')} | {pair('u', 'mean')} |"
    )


def main() -> None:
    """Measure the requested trials and write the table into the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--parts", type=Path, required=True, help="folder of the stored trials")
    parser.add_argument("--trials", type=int, default=60, help="trials per row")
    arguments = parser.parse_args()
    arguments.parts.mkdir(parents=True, exist_ok=True)
    table = "\n".join([TABLE_HEAD, *rows(arguments.parts, arguments.trials)])
    text = PAGE.read_text(encoding="utf-8")
    before, after = text[: text.index("| pulses |")], text[text.index("| pulses |") :]
    PAGE.write_text(before + table + "\n" + after[after.index("\n\n") + 1 :], encoding="utf-8")
    print(table)


if __name__ == "__main__":
    main()
