"""Calibration by a steel sphere: its vibration in gelatin beside the closed form, and the moduli fitted to it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from experiments import Experiment, Verdict, label, panels, result_of, seeded

from hpe_rig.arrays import ComplexArray, FloatArray
from hpe_rig.result import MARKS, Result
from hpe_rig.scene import Scene

HIGHEST = 100
"""Harmonics of the burst rate up to the first zero of a toneburst of 100 us."""
PAPER_MODULI = (7250.0, 1.0)
"""mu1, Pa, and mu2, Pa s, of 12 % gelatin (paper, Sec. IV.B)."""


@dataclass(frozen=True, slots=True)
class SphereFit:
    """Moduli fitted to a sphere's vibration, with their standard uncertainties by its noise; chi square a freedom."""

    mu1_pa: float
    mu2_pa_s: float
    mu1_u_pa: float
    mu2_u_pa_s: float
    chi_square: float


def sphere_phasors(scene: Scene, mu1_pa: float, mu2_pa_s: float, sampled: bool = True) -> ComplexArray:
    """Return the sphere's vibration at the wanted frequencies, m (frequency,), A exp(j phase).

    Of A sin(2 pi f t + phase), t from the push at the focus, in closed form, for the force that the scene declares.
    ``sampled``: what a fit at the instants of the pulses takes for it, the harmonics that alias onto it included.
    """
    from hpe_rig.bench import twin_settings
    from sim_backend.motion import sphere_response

    settings = twin_settings(scene)
    specimen, excitation = settings.specimen, scene.excitation
    if specimen is None or specimen.sphere is None or excitation is None:
        raise ValueError("the scene pushes no sphere: give it [excitation] and [simulation.specimen.sphere]")
    rate_hz, length_s = excitation.burst_rate_hz, excitation.burst_length_s[0]
    s: ComplexArray = np.asarray(2j * np.pi * rate_hz * np.arange(1, HIGHEST + 1), np.complex128)
    modulus_pa: ComplexArray = np.asarray(mu1_pa + s * mu2_pa_s, np.complex128)
    response = sphere_response(specimen.sphere, modulus_pa, specimen.density_kg_per_m3, s)
    # Eq. (18), one-sided; cos becomes sin by 90 degrees.
    force_n = 2 * specimen.sphere.force_n * rate_hz * length_s * np.sinc(s.imag / 2 / np.pi * length_s)
    phasor = 1j * force_n * np.exp(-s * length_s / 2) * response
    if sampled:
        count = round(scene.tracking.pulse_rate_hz / rate_hz)
        instants_s = scene.tracking.delay_s + np.arange(count) / scene.tracking.pulse_rate_hz
        turn = np.exp(np.outer(s, instants_s))
        phasor = 1j * np.conj(turn) @ (phasor @ turn).imag * (2 / count)
    wanted = np.rint(np.array(scene.wanted_frequencies_hz) / rate_hz).astype(int) - 1
    return np.asarray(phasor[wanted])


def fit_sphere(scene: Scene, result: Result) -> SphereFit:
    """Return mu1 and mu2 of a Voigt medium, the force unknown, fitted to amplitudes and phases of the first shot."""
    from scipy.optimize import least_squares

    shot = result.shots[0]
    estimates = shot.estimates
    found = np.array([each.amplitude_m * np.exp(1j * each.phase_rad) for each in estimates])
    # Noise is alike in both quadratures and at every frequency; what aliases is in the model.
    u_m = shot.residual_m * math.sqrt(2 / shot.pulses_used)

    def residual(parameters: FloatArray) -> FloatArray:
        model = sphere_phasors(scene, *np.exp(parameters[:2])) * parameters[2]
        off = (found - model) / u_m
        return np.concatenate([off.real, off.imag])

    fit = least_squares(residual, np.array([np.log(5e3), np.log(0.5), 1.0]), x_scale="jac")
    slope: FloatArray = np.asarray(fit.jac)
    covariance = np.linalg.inv(slope.T @ slope)
    mu1_pa, mu2_pa_s = np.exp(fit.x[:2])
    relative = np.sqrt(np.diag(covariance))
    chi_square = 2 * fit.cost / (len(fit.fun) - 3)
    return SphereFit(
        float(mu1_pa), float(mu2_pa_s), float(mu1_pa * relative[0]), float(mu2_pa_s * relative[1]), float(chi_square)
    )


def steel_sphere(seed: int = 1) -> Experiment:
    """Vibration of a steel sphere in 12 % gelatin, and the moduli that it holds."""
    # The fit below has what aliases at the pulses in its model: no prior takes it away before.
    scene = seeded("steel-sphere", seed).with_({"sphere": None})
    result = result_of(scene)
    estimates = result.shots[0].estimates
    hz = np.array([each.frequency_hz for each in estimates])
    nm = np.array([each.amplitude_m for each in estimates]) * 1e9
    u_nm = np.array([each.amplitude_uncertainty_m for each in estimates]) * 1e9
    degrees = np.degrees(np.unwrap([each.phase_rad for each in estimates]))
    true_nm = np.array([each.true_amplitude_m or np.nan for each in estimates]) * 1e9
    closed, met = (sphere_phasors(scene, *PAPER_MODULI, sampled) for sampled in (False, True))
    fit = fit_sphere(scene, result)
    figure, (left, right) = panels(2)
    for panel, values, error, curve in (
        (left, nm, u_nm, np.abs(met) * 1e9),
        (right, degrees, np.degrees(u_nm / nm), np.degrees(np.unwrap(np.angle(met)))),
    ):
        panel.errorbar(hz, values, error, fmt="o", color=MARKS[0][1], ms=4, label="measured")
        panel.plot(hz, curve, color=MARKS[0][1], lw=1, label="closed form at the pulses")
    left.plot(hz, np.abs(closed) * 1e9, color="0.5", lw=1, ls=":", label="at every instant")
    label(left, "frequency (Hz)", "displacement (nm)", ylim=(0, None))
    label(right, "frequency (Hz)", "phase (degrees)")
    apart = np.abs(nm - np.abs(met) * 1e9) / u_nm
    exact = float(np.abs(true_nm / (np.abs(closed) * 1e9) - 1).max())
    off = [(fit.mu1_pa - PAPER_MODULI[0]) / fit.mu1_u_pa, (fit.mu2_pa_s - PAPER_MODULI[1]) / fit.mu2_u_pa_s]
    rows = [
        (f"{at:.0f} Hz", f"{one:.0f} +- {u:.0f} nm", f"{abs(a) * 1e9:.0f} nm", f"{abs(b) * 1e9:.0f} nm")
        for at, one, u, a, b in zip(hz, nm, u_nm, met, closed, strict=True)
    ]
    return Experiment(
        "Sphere",
        "steel sphere in 12 % gelatin",
        "Scene `steel-sphere`: the paper's sphere of 1.59 mm, pushed by 5 mN (assumed) for 100 us at 100 Hz, its front "
        "tracked at 4 kHz, least squares. Closed form: Oestreicher's rigid sphere in a Voigt medium "
        "(docs/explanation/medium.md); mu1, mu2 and force are fitted to ten harmonics, with what aliases at the instants of "
        "the pulses.",
        (("frequency", "measured", "closed form, at the pulses", "at every instant"), *rows),
        figure,
        (
            Verdict(
                "the twin's sphere moves as Oestreicher's formula says",
                f"true amplitudes within {exact:.0e} of it",
                exact < 1e-4,
            ),
            Verdict(
                "amplitudes as the closed form at the instants of the pulses, within three u",
                f"within {apart.max():.1f} u of each",
                apart.max() < 3,
            ),
            Verdict(
                "the sphere gives back 7.25 kPa and 1.0 Pa s, within three u",
                f"{fit.mu1_pa / 1e3:.2f} +- {fit.mu1_u_pa / 1e3:.2f} kPa, {fit.mu2_pa_s:.2f} +- {fit.mu2_u_pa_s:.2f} "
                f"Pa s, chi square {fit.chi_square:.1f} a degree of freedom",
                max(map(abs, off)) < 3,
            ),
        ),
    )
