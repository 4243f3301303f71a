"""Coverage of the intervals of fits with the medium prior if a medium or burst violates its assumptions.

Usage: python scripts/validation/prior_limits.py [--seeds 100]     replaces the table of docs/validation/prior-limits.md

A seed draws the noise and the unknown of the case: the phase of a resonance, the distance of a wall, or a medium.
Motions are those of media with 1000 harmonics. "Before" takes the deviation from the ensemble as the prior states it,
"now" as estimated from the data. Coverage is the fraction of ten tracked amplitudes and ten phases within 1.96 u; NEV
is the mean of (error / u)^2. A run counts as warned if the test of the ensemble or that for a line in the residual
warns. Standard errors are those over seeds.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from unittest import mock

import numpy as np
from medium_prior import (
    BEAMS,
    FAMILIES,
    HARMONIC,
    LENGTH_S,
    RATE_HZ,
    TRAINS,
    WANTED_HZ,
    harmonics,
    measured,
    random_harmonics,
)

from hpe_rig.arrays import ComplexArray, FloatArray
from hpe_rig.processing import MediumPrior, Motion, medium_fit, medium_prior, residual_line

PAGE = Path(__file__).parents[2] / "docs" / "validation" / "prior-limits.md"
TABLE_HEAD = """\
| case | pulses | noise | before: amplitude, phase | NEV | now: amplitude, phase | NEV | warned |
|---|---|---|---|---|---|---|---|"""
SHIFTING, SYNCHRONOUS = "shifting 3990 Hz", "synchronous 4000 Hz"
NOISE_40_DB_M, NOISE_15_DB_M = 11e-9, 200e-9
"""Noise of a pulse of bovine-muscle at 40 and 15 dB."""
AMPLITUDE_M = 360e-9
"""Amplitude at 100 Hz."""
RESONANCE_HZ, QUALITY_FACTOR = 3700.0, 50.0
WALL_M = (2e-3, 10e-3)
"""Distances of a wall, uniform."""
WAVE_SPEED_M_PER_S = 3.0
MODULUS_PA = 12e3 + 2j * np.pi * RATE_HZ * HARMONIC * 5.7
"""Bovine muscle of the shipped scenes."""
FALSE_ALARM_PROBABILITY = 0.01

FIT_MODULE = sys.modules[medium_fit.__module__]
EVIDENCE = vars(FIT_MODULE)["evidence_of"]

DrawWave = Callable[[np.random.Generator, int], ComplexArray]


@dataclass(frozen=True)
class Case:
    """Motions that violate an assumption of the prior: ``wave`` draws their phasors (harmonic,) for a seed."""

    name: str
    wave: DrawWave
    trains: tuple[str, ...] = (SHIFTING, SYNCHRONOUS)
    noises_m: tuple[float, ...] = (NOISE_40_DB_M,)


def muscle() -> ComplexArray:
    """Return the phasors (harmonic,) of muscle, of 360 nm at 100 Hz."""
    wave = harmonics(MODULUS_PA, 1.0)
    return wave * (AMPLITUDE_M / abs(wave[0]))


def with_resonance(size_m: float) -> DrawWave:
    """Return muscle beside a resonance of ``size_m`` and of random phase."""

    def wave(generator: np.random.Generator, seed: int) -> ComplexArray:
        relative_hz = RATE_HZ * HARMONIC / RESONANCE_HZ
        resonance = 1 / (1 - relative_hz**2 + 1j * relative_hz / QUALITY_FACTOR) / QUALITY_FACTOR
        return np.asarray(muscle() + size_m * np.exp(2j * np.pi * generator.uniform()) * resonance)

    return wave


def with_wall(reflected: float, is_damped: bool) -> DrawWave:
    """Return muscle with an echo of a wall; its shear waves are damped as in muscle, or not at all."""

    def wave(generator: np.random.Generator, seed: int) -> ComplexArray:
        omega = 2 * np.pi * RATE_HZ * HARMONIC
        wave_number_per_m = omega * np.sqrt(1000.0 / MODULUS_PA) if is_damped else omega / WAVE_SPEED_M_PER_S
        path = np.exp(-2j * generator.uniform(*WALL_M) * wave_number_per_m)
        return np.asarray(muscle() * (1 - reflected * path))

    return wave


def with_long_burst(factor: float) -> DrawWave:
    """Return muscle under bursts ``factor`` times as long as declared, of the same amplitude at 100 Hz."""

    def wave(generator: np.random.Generator, seed: int) -> ComplexArray:
        duty = RATE_HZ * LENGTH_S
        declared, actual = (np.sinc(HARMONIC * d) * np.exp(-1j * np.pi * HARMONIC * d) for d in (duty, factor * duty))
        motion = muscle() / declared * actual
        return np.asarray(motion * (AMPLITUDE_M / abs(motion[0])))

    return wave


def random_medium(drive: float, scale: float | None) -> DrawWave:
    """Return random media of all families, with widths of the force ``scale`` times the declared ones, or random."""

    def wave(generator: np.random.Generator, seed: int) -> ComplexArray:
        widths = None if scale is None else (scale, scale)
        return drive * random_harmonics(FAMILIES[seed % len(FAMILIES)], generator, widths)

    return wave


def elastic(generator: np.random.Generator, seed: int) -> ComplexArray:
    """Return the phasors of an elastic medium of 9 kPa."""
    return harmonics(np.full(HARMONIC.size, 9e3 + 1e-6j), 1.0)


def maxwell(generator: np.random.Generator, seed: int) -> ComplexArray:
    """Return the phasors of a Maxwell medium of 9 kPa and 5 Pa s."""
    return harmonics(1 / (1 / 9e3 + 1 / (2j * np.pi * RATE_HZ * HARMONIC * 5.0)), 1.0)


BOTH_M, EXTREME_M = (NOISE_40_DB_M, NOISE_15_DB_M), (77e-9, 7.7e-9)
CASES = (
    Case("muscle, as the prior assumes", with_resonance(0.0), noises_m=BOTH_M),
    Case("resonance at 3.7 kHz, 10 nm", with_resonance(10e-9)),
    Case("resonance at 3.7 kHz, 30 nm", with_resonance(30e-9)),
    Case("wall, 10 %, undamped", with_wall(0.1, is_damped=False), noises_m=BOTH_M),
    Case("wall, 30 %, undamped", with_wall(0.3, is_damped=False), noises_m=BOTH_M),
    Case("wall, 30 %, damped", with_wall(0.3, is_damped=True), noises_m=BOTH_M),
    Case("burst 50 % longer", with_long_burst(1.5), noises_m=BOTH_M),
    Case("random media", random_medium(1.0, None), noises_m=EXTREME_M),
    Case("force of half the width", random_medium(1.0, 0.5), noises_m=EXTREME_M),
    Case("force of half the width, 100 times the drive", random_medium(100.0, 0.5), noises_m=EXTREME_M),
    Case("elastic, 9 kPa", elastic, noises_m=EXTREME_M),
    Case("Maxwell, 9 kPa, 5 Pa s", maxwell, noises_m=EXTREME_M),
)


def main() -> None:
    """Compute the table and replace that of the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--output", type=Path, default=PAGE)
    arguments = parser.parse_args()
    rows = list[str]()
    for row in table(arguments.seeds):
        print(row, flush=True)
        rows.append(row)
    before, _, after = PAGE.read_text(encoding="utf-8").partition(f"{TABLE_HEAD}\n")
    arguments.output.write_text(
        "\n".join([f"{before}{TABLE_HEAD}", *rows, "", after.partition("\n\n")[2]]), encoding="utf-8"
    )


def table(seeds: int) -> Iterator[str]:
    """Yield a row for each case, train and noise."""
    prior = medium_prior(BEAMS, RATE_HZ, LENGTH_S)
    for case in CASES:
        for train in case.trains:
            for noise_m in case.noises_m:
                cells = [case.name, train.partition(" ")[0], f"{noise_m * 1e9:.3g} nm"]
                for evidence in (_evidence_as_stated, EVIDENCE):
                    with mock.patch.object(FIT_MODULE, "evidence_of", evidence):
                        errors, warned = _errors_over_u(case, train, noise_m, prior, seeds)
                    cells += _coverage(errors)
                yield f"| {' | '.join(cells)} | {100 * np.mean(warned):.0f} % |"


def _evidence_as_stated(*arguments: object) -> object:
    """Return the evidence of a fit with deviations from the ensemble as large as the prior states."""
    evidence = EVIDENCE(*arguments)
    return replace(evidence, deviation_factor=np.ones_like(evidence.deviation_factor))


def _errors_over_u(
    case: Case, train: str, noise_m: float, prior: MediumPrior, seeds: int
) -> tuple[FloatArray, list[bool]]:
    """Return the errors of amplitudes and phases over u, (seed, quantity, frequency), and whether each seed warns."""
    ratios, warned = list[FloatArray](), list[bool]()
    for seed in range(seeds):
        wave = case.wave(np.random.default_rng(seed), seed)
        motion = measured(*TRAINS[train], wave, noise_m, 1, seed + 1)
        single = Motion(motion.time_s, motion.displacement_m[0], motion.variance_m2[0], motion.valid)
        result = medium_fit(single, WANTED_HZ, prior)
        fit, u = result.fit, np.sqrt(np.diagonal(result.fit.covariance, axis1=-2, axis2=-1))
        errors_m = fit.amplitude_m - np.abs(wave[: WANTED_HZ.size])
        errors_rad = np.angle(np.exp(1j * fit.phase_rad) * np.conj(wave[: WANTED_HZ.size]))
        ratios.append(np.stack([errors_m, errors_rad]) / u.T)
        line = residual_line(single, WANTED_HZ, prior=prior)
        is_line = line is not None and line.probability < FALSE_ALARM_PROBABILITY
        warned.append(is_line or float(result.evidence.significance) < FALSE_ALARM_PROBABILITY)
    return np.stack(ratios), warned


def _coverage(ratio: FloatArray) -> tuple[str, str]:
    """Return the cells of coverage and NEV, of amplitude and phase each, with their standard errors over seeds."""
    within, squares = 100 * np.mean(np.abs(ratio) < 1.96, axis=2), np.mean(ratio**2, axis=2)
    cells = []
    for values, form in ((within, ".0f"), (squares, ".2f")):
        mean, error = values.mean(axis=0), values.std(axis=0) / np.sqrt(len(values))
        cells.append(", ".join(f"{m:{form}} ± {e:{form}}" for m, e in zip(mean, error, strict=True)))
    return cells[0], cells[1]


if __name__ == "__main__":
    main()
