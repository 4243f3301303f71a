"""Calibration with a steel sphere: its vibration in gelatin compared with the closed form, and fitted moduli."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from experiments import Experiment, Verdict, label, panels, result_of, seeded

from hpe_rig.arrays import ComplexArray, FloatArray
from hpe_rig.result import MARKS, Result
from hpe_rig.scene import Scene

HARMONICS = 100
"""Number of harmonics of the burst rate below the first zero of a toneburst of 100 us."""
PAPER_MODULI = (7250.0, 1.0)
"""mu1, Pa, and mu2, Pa s, of 12 % gelatin (paper, Sec. IV.B)."""


@dataclass(frozen=True, slots=True)
class SphereFit:
    """Moduli fitted to the vibration of a sphere, standard uncertainties due to noise, and reduced chi-square."""

    mu1_pa: float
    mu2_pa_s: float
    mu1_u_pa: float
    mu2_u_pa_s: float
    chi_square: float


def sphere_phasors(scene: Scene, mu1_pa: float, mu2_pa_s: float, sampled: bool = True) -> ComplexArray:
    """Return the phasors A exp(j phase) of the sphere at the wanted frequencies, m (frequency,), in closed form.

    The motion is A sin(2 pi f t + phase) with t from the push at the focus, for the force declared by the scene.
    ``sampled``: phasors of a fit at the pulses, with aliasing.
    """
    from hpe_rig.bench import twin_settings
    from sim_backend.motion import sphere_response

    settings = twin_settings(scene)
    specimen, excitation = settings.specimen, scene.excitation
    if specimen is None or specimen.sphere is None or excitation is None:
        raise ValueError("the scene has no sphere: add [excitation] and [simulation.specimen.sphere]")
    rate_hz, length_s = excitation.burst_rate_hz, excitation.burst_length_s[0]
    s: ComplexArray = np.asarray(2j * np.pi * rate_hz * np.arange(1, HARMONICS + 1), np.complex128)
    modulus_pa: ComplexArray = np.asarray(mu1_pa + s * mu2_pa_s, np.complex128)
    response = sphere_response(specimen.sphere, modulus_pa, specimen.density_kg_per_m3, s)
    # Eq. (18), one-sided; the factor 1j turns a cosine into a sine.
    force_n = 2 * specimen.sphere.force_n * rate_hz * length_s * np.sinc(s.imag / 2 / np.pi * length_s)
    phasor = 1j * force_n * np.exp(-s * length_s / 2) * response
    if sampled:
        count = round(scene.tracking.pulse_rate_hz / rate_hz)
        # Sample one burst period at the pulses and fit each harmonic to the samples.
        pulse_s = scene.tracking.delay_s + np.arange(count) / scene.tracking.pulse_rate_hz
        phasors = np.exp(np.outer(s, pulse_s))
        phasor = 1j * np.conj(phasors) @ (phasor @ phasors).imag * (2 / count)
    indices = np.rint(np.array(scene.wanted_frequencies_hz) / rate_hz).astype(int) - 1
    return np.asarray(phasor[indices])


def fit_sphere(scene: Scene, result: Result) -> SphereFit:
    """Return mu1 and mu2 of a Voigt medium, fitted with an unknown force to the phasors of the first shot."""
    from scipy.optimize import least_squares

    shot = result.shots[0]
    estimates = shot.estimates
    measured = np.array(
        [estimate.tracked_amplitude_m * np.exp(1j * estimate.tracked_phase_rad) for estimate in estimates]
    )
    # The noise is equal in both quadratures and at all frequencies; the model includes aliasing.
    u_m = shot.residual_m * math.sqrt(2 / shot.pulses_used)

    def residual(parameters: FloatArray) -> FloatArray:
        model = sphere_phasors(scene, *np.exp(parameters[:2])) * parameters[2]
        error = (measured - model) / u_m
        return np.concatenate([error.real, error.imag])

    fit = least_squares(residual, np.array([np.log(5e3), np.log(0.5), 1.0]), x_scale="jac")
    slope: FloatArray = np.asarray(fit.jac)
    # Parameters are logarithms, so their standard errors are relative ones.
    covariance = np.linalg.inv(slope.T @ slope)
    mu1_pa, mu2_pa_s = np.exp(fit.x[:2])
    relative = np.sqrt(np.diag(covariance))
    chi_square = 2 * fit.cost / (len(fit.fun) - 3)
    return SphereFit(
        float(mu1_pa), float(mu2_pa_s), float(mu1_pa * relative[0]), float(mu2_pa_s * relative[1]), float(chi_square)
    )


def steel_sphere(seed: int = 1) -> Experiment:
    """Measure the vibration of a steel sphere in 12 % gelatin, and fit the moduli."""
    # The model of the fit includes aliasing, so the estimate must not be corrected by a prior.
    scene = seeded("steel-sphere", seed).with_({"sphere": None})
    result = result_of(scene)
    estimates = result.shots[0].estimates
    hz = np.array([estimate.frequency_hz for estimate in estimates])
    nm = np.array([estimate.tracked_amplitude_m for estimate in estimates]) * 1e9
    u_nm = np.array([estimate.tracked_amplitude_uncertainty_m for estimate in estimates]) * 1e9
    degrees = np.degrees(np.unwrap([estimate.tracked_phase_rad for estimate in estimates]))
    true_nm = np.array([estimate.true_amplitude_m or np.nan for estimate in estimates]) * 1e9
    exact, sampled_exact = (sphere_phasors(scene, *PAPER_MODULI, sampled) for sampled in (False, True))
    fit = fit_sphere(scene, result)
    figure, (left, right) = panels(2)
    for panel, values, error, curve in (
        (left, nm, u_nm, np.abs(sampled_exact) * 1e9),
        (right, degrees, np.degrees(u_nm / nm), np.degrees(np.unwrap(np.angle(sampled_exact)))),
    ):
        panel.errorbar(hz, values, error, fmt="o", color=MARKS[0][1], ms=4, label="measured")
        panel.plot(hz, curve, color=MARKS[0][1], lw=1, label="closed form with aliasing")
    left.plot(hz, np.abs(exact) * 1e9, color="0.5", lw=1, ls=":", label="closed form")
    label(left, "frequency (Hz)", "displacement (nm)", ylim=(0, None))
    label(right, "frequency (Hz)", "phase (degrees)")
    deviation = np.abs(nm - np.abs(sampled_exact) * 1e9) / u_nm
    true_error = float(np.abs(true_nm / (np.abs(exact) * 1e9) - 1).max())
    deviations = [(fit.mu1_pa - PAPER_MODULI[0]) / fit.mu1_u_pa, (fit.mu2_pa_s - PAPER_MODULI[1]) / fit.mu2_u_pa_s]
    rows = [
        (f"{at:.0f} Hz", f"{measured:.0f} +- {u:.0f} nm", f"{abs(a) * 1e9:.0f} nm", f"{abs(b) * 1e9:.0f} nm")
        for at, measured, u, a, b in zip(hz, nm, u_nm, sampled_exact, exact, strict=True)
    ]
    return Experiment(
        "Sphere",
        "steel sphere in 12 % gelatin",
        "Scene `steel-sphere`: the paper's sphere of 1.59 mm, pushed by 5 mN (assumed) for 100 us at 100 Hz. Its front "
        "is tracked at 4 kHz and fitted by least squares. Closed form: Oestreicher's rigid sphere in a Voigt medium "
        "(docs/explanation/medium.md). The fit of mu1, mu2 and force to ten harmonics includes aliasing.",
        (("frequency", "measured", "closed form with aliasing", "closed form"), *rows),
        figure,
        (
            Verdict(
                "the motion of the twin's sphere equals Oestreicher's formula",
                f"true amplitudes within {true_error:.0e} of it",
                true_error < 1e-4,
            ),
            Verdict(
                "amplitudes equal the closed form with aliasing within three u",
                f"largest deviation {deviation.max():.1f} u",
                deviation.max() < 3,
            ),
            Verdict(
                "the fitted moduli equal 7.25 kPa and 1.0 Pa s within three u",
                f"{fit.mu1_pa / 1e3:.2f} +- {fit.mu1_u_pa / 1e3:.2f} kPa, {fit.mu2_pa_s:.2f} +- {fit.mu2_u_pa_s:.2f} "
                f"Pa s, reduced chi-square {fit.chi_square:.1f}",
                max(map(abs, deviations)) < 3,
            ),
        ),
    )
