"""Measure the coverage of phase velocity and attenuation by the near-field fit, and the bias of other methods.

The bias is that of noise-free exact fields. For the coverage a seed draws noise and every quantity with a stated
uncertainty: widths of the force (5 % each), onset (0.5 us), lateral offset (40 um: stage and speckle), gain (0.5 %) and
phase (2 mrad). The fit uses only the stated values. The geometry is that of the scene gelatin-moduli: lateral offsets
from 1 to 6 mm, a force with sigmas of 0.34 and 3.6 mm. Results are added to FILE, one line per seed, so that a campaign
can be stopped and continued.

    python scripts/validation/dispersion.py FILE               # 200 seeds, about 0.3 s each, then the tables
    python scripts/validation/dispersion.py FILE --seeds 0     # tables only
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np

from hpe_rig.arrays import ComplexArray, FloatArray
from hpe_rig.medium import HarmonicMedium, PushForce, TrackedRegion, shear_motion
from hpe_rig.moduli import DispersionCurve, Push, Vibration, dispersion_of_vibrations, fit_wavenumbers

FREQUENCY_HZ = np.arange(100.0, 1001.0, 100.0)
OFFSETS_M = np.array([1.0, 2.25, 3.5, 4.75, 6.0]) * 1e-3
NEAR_OFFSETS_M = np.array([1.0, 2.0, 3.0, 4.0]) * 1e-3
SIGMA_M, NARROW_SIGMA_M = (0.34e-3, 3.6e-3), (0.17e-3, 1.8e-3)
"""Sigmas of the force across and along: of the transducer, and of the paper's simulation (Table I)."""
MEDIA = ((4e3, 1.0), (7.25e3, 1.0), (13.5e3, 1.0), (9e3, 2.0), (12e3, 5.7))
TRUE = (9e3, 2.0)
NOISE_M, CORRELATION, FIRST_M = 0.7e-9, 0.3, 300e-9
"""Noise of a quadrature, its correlation between neighbouring states, amplitude of the first harmonic at 1 mm."""
ERRORS = {"gain_uncertainty": 0.005, "phase_uncertainty_rad": 0.002, "lateral_uncertainty_m": 40e-6}
WIDTH_UNCERTAINTY, ONSET_S = 0.05, 0.5e-6
K_95 = 1.959964


def push_of(sigma_m: tuple[float, float]) -> Push:
    """Return tonebursts of 100 us at 100 Hz with a Gaussian force of the sigmas ``sigma_m``, across and along."""
    widths = (WIDTH_UNCERTAINTY, WIDTH_UNCERTAINTY)
    return Push(PushForce(sigma_m[:1], sigma_m[1]), 100.0, 100e-6, 1000.0, widths, ONSET_S)


def exact_field(medium: tuple[float, float], push: Push, offsets_m: FloatArray) -> ComplexArray:
    """Return the phasors (offset, frequency) per unit force in a Voigt ``medium`` of modulus (Pa), viscosity (Pa s)."""
    harmonic = HarmonicMedium.voigt(*medium, FREQUENCY_HZ)
    field = shear_motion(harmonic, push.force, TrackedRegion(offsets_m)).value.T
    return np.asarray(field * push.spectrum(FREQUENCY_HZ))


def vibrations(field: ComplexArray, covariance_m2: FloatArray, offsets_m: FloatArray) -> list[Vibration]:
    """Return ``field`` (offset, frequency) as vibrations."""
    return [
        Vibration(f"{offset_m * 1e3:g} mm", FREQUENCY_HZ, phasor, covariance_m2, float(offset_m), **ERRORS)
        for offset_m, phasor in zip(offsets_m, field, strict=True)
    ]


def true_wave(medium: tuple[float, float]) -> tuple[FloatArray, FloatArray]:
    """Return phase velocity (m/s) and attenuation (Np/m) of a Voigt medium, (frequency,) each."""
    omega = 2 * np.pi * FREQUENCY_HZ
    q = omega * np.sqrt(1000.0 / (medium[0] + 1j * omega * medium[1]))
    return omega / q.real, -q.imag


def print_bias() -> None:
    """Print the bias of every method on exact fields, in per cent."""
    covariance_m2 = (1e-3 * NOISE_M) ** 2 * np.eye(2 * FREQUENCY_HZ.size)
    shown = [0, 1, 4, 9]
    columns = " | ".join(f"{hz:g} Hz" for hz in FREQUENCY_HZ[shown])
    print(f"| medium | sigmas, offsets | method | {columns} |\n|---|---|---|{'---:|' * len(shown)}")
    geometries = [(SIGMA_M, OFFSETS_M, MEDIA), (NARROW_SIGMA_M, NEAR_OFFSETS_M, (TRUE,))]
    cases = [(sigma_m, offsets_m, medium) for sigma_m, offsets_m, media in geometries for medium in media]
    for sigma_m, offsets_m, medium in cases:
        push = push_of(sigma_m)
        field = exact_field(medium, push, offsets_m)
        measured = vibrations(field * FIRST_M / abs(field[0, 0]), covariance_m2, offsets_m)
        widths = f"{sigma_m[0] * 1e3:g}, {sigma_m[1] * 1e3:g} mm; {offsets_m[0] * 1e3:g} to {offsets_m[-1] * 1e3:g} mm"
        name = f"{medium[0] / 1e3:g} kPa, {medium[1]:g} Pa s | {widths}"
        for method in dispersion_of_vibrations(measured, push).methods:
            true = true_wave(medium)[method.is_attenuation]
            errors = 100 * (method.value / true - 1)
            print(f"| {name} | {method.name} | {' | '.join(f'{errors[i]:+.1f}' for i in shown)} |")


def draw(seed: int) -> dict[str, Any]:
    """Return deviations over u of phase velocity and attenuation, and relative u, by frequency."""
    rng = np.random.default_rng(seed)
    states = np.arange(2 * FREQUENCY_HZ.size)
    covariance_m2 = NOISE_M**2 * CORRELATION ** abs(np.subtract.outer(states, states))
    gain, phase, shift_m = rng.standard_normal((3, OFFSETS_M.size)) * np.array([*ERRORS.values()])[:, None]
    across, along = np.exp(WIDTH_UNCERTAINTY * rng.standard_normal(2)) * SIGMA_M
    onset_s = ONSET_S * rng.standard_normal()
    field = exact_field(TRUE, push_of((float(across), float(along))), OFFSETS_M + shift_m)
    nominal = exact_field(TRUE, push_of(SIGMA_M), OFFSETS_M)
    field *= FIRST_M / abs(nominal[0, 0]) * (1 + gain + 1j * phase)[:, None]
    field *= np.exp(-2j * np.pi * FREQUENCY_HZ * onset_s)
    noise_m = rng.multivariate_normal(np.zeros(states.size), covariance_m2, OFFSETS_M.size)
    measured = vibrations(field + noise_m[:, 0::2] + 1j * noise_m[:, 1::2], covariance_m2, OFFSETS_M)
    push, (speed, attenuation) = push_of(SIGMA_M), true_wave(TRUE)
    # From the truth: other starts lead to the same minimum, in ten times the time.
    unknown = np.full(FREQUENCY_HZ.size, np.nan)
    fit = fit_wavenumbers(measured, push, DispersionCurve(FREQUENCY_HZ, speed, unknown, attenuation, unknown))
    u_speed, u_attenuation = fit.curve.phase_velocity_uncertainty_m_per_s, fit.curve.attenuation_uncertainty_np_per_m
    return {
        "seed": seed,
        "speed": ((fit.curve.phase_velocity_m_per_s - speed) / u_speed).tolist(),
        "attenuation": ((fit.curve.attenuation_np_per_m - attenuation) / u_attenuation).tolist(),
        "relative_u": [(u_speed / speed).tolist(), (u_attenuation / attenuation).tolist()],
        "chi_square": fit.chi_square / fit.freedom,
    }


def print_coverage(draws: list[dict[str, Any]]) -> None:
    """Print how often the truth lies within 1.96 u, by frequency."""
    speed, attenuation = (np.array([draw[name] for draw in draws]) for name in ("speed", "attenuation"))
    u = np.mean([draw["relative_u"] for draw in draws], axis=0)
    print(f"\n{len(draws)} seeds, chi-square per degree {np.mean([draw['chi_square'] for draw in draws]):.3f}\n")
    print(
        "| Hz | c: u | mean | sd | 95 % | alpha: u | mean | sd | 95 % |\n|---:|---:|---:|---:|---:|---:|---:|---:|---:|"
    )
    for index, hz in enumerate(FREQUENCY_HZ):
        cells = []
        for kind, z in enumerate((speed[:, index], attenuation[:, index])):
            inside = 100 * np.mean(np.abs(z) < K_95)
            cells += [f"{100 * u[kind, index]:.2f} %", f"{z.mean():+.2f}", f"{z.std(ddof=1):.2f}", f"{inside:.1f}"]
        print(f"| {hz:g} | {' | '.join(cells)} |")
    pooled = [100 * np.mean(np.abs(z) < K_95) for z in (speed, attenuation)]
    print(f"\nall frequencies: c {pooled[0]:.1f} %, alpha {pooled[1]:.1f} %")


def main() -> None:
    """Draw the missing seeds, then print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("file", type=Path)
    parser.add_argument("--seeds", type=int, default=200)
    arguments = parser.parse_args()
    lines = arguments.file.read_text(encoding="utf-8").splitlines() if arguments.file.exists() else []
    draws = [json.loads(line) for line in lines]
    for seed in range(len(draws), arguments.seeds):
        draws.append(draw(seed))
        with arguments.file.open("a", encoding="utf-8") as stream:
            stream.write(json.dumps(draws[-1]) + "\n")
    print_bias()
    if draws:
        print_coverage(draws)


if __name__ == "__main__":
    main()
