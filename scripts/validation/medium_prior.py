"""Noise and aliasing errors of fits with the medium prior, compared with plain least squares: tables and a figure.

Usage: python scripts/validation/medium_prior.py [FOLDER]        all tables; default folder of the figure: docs/figures
       python scripts/validation/medium_prior.py --constants     effect of the constants of the prior
       python scripts/validation/medium_prior.py --narrow        beams or force of half the width
       python scripts/validation/medium_prior.py --little-noise  shipped scenes without jitter, noise reduced in steps

True motions are the fields of the media with 1000 harmonics, by another quadrature than that of the ensemble. Errors
are the largest of ten harmonics, for the mean over noise and its negative. Gain and u are relative to those of one
sinusoid in the same noise. Further tables have the coverage over random media of the families of the ensemble, together
and by family, and the muscle scene.
"""

from __future__ import annotations

import argparse
import functools
import itertools
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from unittest import mock

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

import hpe_rig as hpe
from hpe_rig.arrays import BoolArray, ComplexArray, FloatArray
from hpe_rig.medium import (
    PRIOR_POWER_MODULUS_HZ,
    PRIOR_RANGES,
    BeamWidths,
    HarmonicMedium,
    medium_ensemble,
    tracked_motion,
)
from hpe_rig.prediction import beam_widths
from hpe_rig.processing import (
    HarmonicFit,
    MediumPrior,
    Motion,
    harmonic_columns,
    least_squares,
    medium_fit,
    medium_prior,
    project_prior,
    shot_fit,
)

BEAMS = BeamWidths((0.34e-3, 0.34e-3, 3.60e-3), (0.078e-3, 0.078e-3, 0.83e-3), 0.3e-3)
NARROW = BeamWidths((0.17e-3, 0.17e-3, 1.80e-3), (0.155e-3, 0.155e-3, 1.68e-3), 0.3e-3)
"""Widths of eq. (12) and Table I."""
RATE_HZ, LENGTH_S = 100.0, 100e-6
HARMONIC = np.arange(1, 1001)
WANTED_HZ = RATE_HZ * np.arange(1.0, 11.0)
RMS_M = 0.5e-6
NOISE_M = (770e-9, 77e-9, 7.7e-9)
TRAINS = {"shifting 3990 Hz": (3990.0, 131e-6), "synchronous 4000 Hz": (4000.0, 130e-6), "2500 Hz": (2500.0, 130e-6)}
DRIVEN_HZ = 1 / LENGTH_S
FAMILIES = ("Voigt", "Zener", "power law", "nearly elastic", "Maxwell")
DRIVES = (0.01, 1.0, 100.0)
MEDIA, MEDIA_PER_FAMILY = 100, 40
"""Random media per row of the coverage tables."""
JITTER_S = 1e-9
SEEDS = 8
CONSTANTS: tuple[Mapping[str, float], ...] = (
    {},
    {"members": 480},
    {"PRIOR_WIDENING": 2.0},
    {"HARMONIC_DEVIATION": 0.01},
    {"PRIOR_WIDENING": 2.0, "HARMONIC_DEVIATION": 0.01},
    {"ENSEMBLE_RESIDUAL": 0.001},
    {"ENSEMBLE_RESIDUAL": 0.006},
    {"members": 480, "PRIOR_WIDENING": 2.0},
)
PRIOR, PLAIN = "#0072B2", "#D55E00"


def media() -> dict[str, tuple[ComplexArray, float]]:
    """Return modulus (harmonic,) and width of the force relative to the declared one, by name."""
    s = 2j * np.pi * RATE_HZ * HARMONIC
    elastic = np.full(HARMONIC.size, 9e3 + 1e-6j)
    moduli: dict[str, tuple[ComplexArray, float]] = {
        "Voigt 2 kPa, 1 Pa s": (2e3 + s * 1.0, 1.0),
        "Voigt 9 kPa, 2 Pa s": (9e3 + s * 2.0, 1.0),
        "Voigt 30 kPa, 3 Pa s": (30e3 + s * 3.0, 1.0),
        "Zener 5 + 20 kPa, 3 Pa s": (5e3 + 1 / (1 / 20e3 + 1 / (s * 3.0)), 1.0),
        "power law 9 kPa, 0.3": (9e3 * (s / (2 * np.pi * 150)) ** 0.3, 1.0),
        "Voigt, force twice as wide": (9e3 + s * 2.0, 2.0),
        "elastic 9 kPa": (elastic, 1.0),
        "Maxwell 9 kPa, 5 Pa s": (1 / (1 / 9e3 + 1 / (s * 5.0)), 1.0),
    }
    return moduli


def harmonics(modulus_pa: ComplexArray, width_scale: float, length_scale: float | None = None) -> ComplexArray:
    """Return the phasors A exp(j phase) of the tracked motion (harmonic,), with an rms of 0.5 um."""
    x, y, z = BEAMS.force_width_m
    width_m = width_scale * x, width_scale * y, (length_scale or width_scale) * z
    beams = BeamWidths(width_m, BEAMS.tracking_width_m, BEAMS.depth_sd_m)
    transfer = tracked_motion(HarmonicMedium(RATE_HZ * HARMONIC, modulus_pa), beams)[0]
    duty = RATE_HZ * LENGTH_S
    # Spectrum of a rectangular burst at the harmonics of the burst rate.
    wave = 1j * transfer * np.sinc(HARMONIC * duty) * np.exp(-1j * np.pi * HARMONIC * duty)
    return np.asarray(wave * RMS_M / np.sqrt(np.sum(np.abs(wave) ** 2) / 2))


def train(rate_hz: float, delay_s: float) -> tuple[FloatArray, BoolArray]:
    """Return times (pulse,) over 15 burst periods, from the onset of a burst, and a mask of undisturbed pulses."""
    # The first 50 ms hold the transient.
    time_s = 0.05 + delay_s + np.arange(round(0.15 * rate_hz)) / rate_hz
    phase_s = time_s % (1 / RATE_HZ)
    return time_s, (phase_s > 105e-6) & (phase_s < 1 / RATE_HZ - 95e-6)


@functools.cache
def harmonics_at(rate_hz: float, delay_s: float) -> FloatArray:
    """Return the columns of all harmonics at the pulses of a train, (pulse, 2 * harmonic)."""
    return harmonic_columns(train(rate_hz, delay_s)[0], RATE_HZ * HARMONIC)


def measured(
    rate_hz: float, delay_s: float, wave: ComplexArray, noise_m: float, trials: int = 40, seed: int = 1
) -> Motion:
    """Return the motion of ``wave`` (harmonic,) at a pulse train, with noise and with its negative."""
    time_s, valid = train(rate_hz, delay_s)
    state = np.stack([wave.real, wave.imag], axis=-1).ravel()
    noise = noise_m * np.random.default_rng(seed).standard_normal((trials, time_s.size))
    displacement_m = harmonics_at(rate_hz, delay_s) @ state + np.concatenate([noise, -noise])
    return Motion(time_s, displacement_m, np.full(displacement_m.shape, noise_m**2), valid)


def plain(motion: Motion) -> HarmonicFit:
    """Fit by least squares, with all driven harmonics that the pulses resolve as free parameters."""
    return least_squares(motion, WANTED_HZ, also_hz=RATE_HZ * np.arange(11.0, DRIVEN_HZ / RATE_HZ + 1))


def summary(fit: HarmonicFit, wave: ComplexArray, sinusoid_m: float) -> tuple[float, float, float, float, float]:
    """Return the largest error of the mean in percent and degrees, gain and u relative to a sinusoid, and NEV."""
    state = fit.state[..., :20]
    error = state - np.stack([wave[:10].real, wave[:10].imag], axis=-1).ravel()
    # The mean over noise and its negative is free of noise.
    ratio = (state.mean(axis=0)[::2] + 1j * state.mean(axis=0)[1::2]) / wave[:10]
    # Stated variances of the quadratures of the ten wanted harmonics.
    variance = np.diagonal(fit.state_covariance, axis1=-2, axis2=-1)[..., :20]
    return (
        float(np.abs(np.abs(ratio) - 1).max() * 100),
        float(np.degrees(np.abs(np.angle(ratio)).max())),
        float(np.sqrt(state.var(axis=0).mean()) / sinusoid_m),
        float(np.sqrt(variance.mean()) / sinusoid_m),
        float(np.mean(error**2 / variance)),
    )


def rows(trains: Sequence[str] = tuple(TRAINS), noises_m: Sequence[float] = NOISE_M) -> Iterator[str]:
    """Yield the table, one row per train, noise and medium."""
    prior = medium_prior(BEAMS, RATE_HZ, LENGTH_S)
    yield "| pulses | noise | medium | prior: error | gain | u | NEV | p | plain: error | gain | NEV |"
    yield "|---|---|---|---|---|---|---|---|---|---|---|"
    for name, at in ((name, TRAINS[name]) for name in trains):
        for noise_m in noises_m:
            sinusoid_m = noise_m * float(np.sqrt(2 / train(*at)[1].sum()))
            for medium, (modulus_pa, width_scale) in media().items():
                wave = harmonics(modulus_pa, width_scale)
                motion = measured(*at, wave, noise_m)
                prior_fit = medium_fit(motion, WANTED_HZ, prior)
                percent, degrees, gain, u, nev = summary(prior_fit.fit, wave, sinusoid_m)
                plain_percent, plain_degrees, plain_gain, _, plain_nev = summary(plain(motion), wave, sinusoid_m)
                yield (
                    f"| {name} | {noise_m * 1e9:.3g} nm | {medium} | {percent:.2f} %, {degrees:.2f} deg | {gain:.2f} "
                    f"| {u:.2f} | {nev:.2f} | {float(np.median(prior_fit.evidence.significance)):.2f} "
                    f"| {plain_percent:.2f} %, {plain_degrees:.2f} deg | {plain_gain:.2f} | {plain_nev:.1f} |"
                )


def random_harmonics(
    family: str, generator: np.random.Generator, scales: tuple[float, float] | None = None
) -> ComplexArray:
    """Return the phasors (harmonic,) of a random medium of ``family``, from the distributions of the ensemble.

    ``scales``: width and length of the force relative to the declared ones; default random.
    """

    def log_even(limits: tuple[float, float]) -> float:
        return float(limits[0] * (limits[1] / limits[0]) ** generator.uniform())

    # Moduli are uniform in the logarithm over the range of the prior.
    s, modulus_pa = 2j * np.pi * RATE_HZ * HARMONIC, log_even(PRIOR_RANGES["modulus_pa"])
    match family:
        case "Zener":
            loss_pa, branch_pa = (
                s * log_even(PRIOR_RANGES["viscosity_pa_s"]),
                modulus_pa * log_even(PRIOR_RANGES["branch_over_modulus"]),
            )
            modulus = modulus_pa + loss_pa / (1 + loss_pa / branch_pa)
        case "power law":
            modulus = modulus_pa * (s / (2 * np.pi * PRIOR_POWER_MODULUS_HZ)) ** generator.uniform(
                *PRIOR_RANGES["power"]
            )
        case "Maxwell":
            loss_pa = s * log_even(PRIOR_RANGES["maxwell_viscosity_pa_s"])
            modulus = loss_pa / (1 + loss_pa / modulus_pa)
        case _:
            modulus = modulus_pa + s * log_even(
                PRIOR_RANGES["viscosity_pa_s"] if family == "Voigt" else PRIOR_RANGES["low_viscosity_pa_s"]
            )
    width_scale, length_scale = scales or np.exp(BEAMS.width_log_sd * generator.standard_normal(2)).tolist()
    return harmonics(np.asarray(modulus), width_scale, length_scale)


def coverage() -> Iterator[str]:
    """Yield NEV and coverage of the intervals of the quadratures over random media."""
    prior = medium_prior(BEAMS, RATE_HZ, LENGTH_S)
    yield f"| pulses | noise | drive | NEV | within u | within 1.96 u |   of {MEDIA} media each"
    yield "|---|---|---|---|---|---|"
    for name, at in TRAINS.items():
        for noise_m in NOISE_M:
            for drive in DRIVES:
                generator, ratio = np.random.default_rng(2), []
                for index in range(MEDIA):
                    wave = drive * random_harmonics(FAMILIES[index % len(FAMILIES)], generator)
                    ratio.append(_standardised_errors(prior, at, wave, noise_m, index))
                yield f"| {name} | {noise_m * 1e9:.3g} nm | {drive:g} | {_covered(ratio)} |"


def narrow() -> Iterator[str]:
    """Yield the table for narrow beams at the synchronous rate, and coverage for a force of half the width."""
    with mock.patch.object(sys.modules[__name__], "BEAMS", NARROW):
        yield from rows(["synchronous 4000 Hz"], NOISE_M[1:])
    yield ""
    prior = medium_prior(BEAMS, RATE_HZ, LENGTH_S)
    yield f"| pulses | noise | drive | NEV | within u | within 1.96 u |   half as wide, {MEDIA} media each"
    yield "|---|---|---|---|---|---|"
    for name, noise_m, drive in itertools.product(TRAINS, NOISE_M[1:], DRIVES[1:]):
        generator, ratio = np.random.default_rng(2), []
        for index in range(MEDIA):
            wave = drive * random_harmonics(FAMILIES[index % len(FAMILIES)], generator, (0.5, 0.5))
            ratio.append(_standardised_errors(prior, TRAINS[name], wave, noise_m, index))
        yield f"| {name} | {noise_m * 1e9:.3g} nm | {drive:g} | {_covered(ratio)} |"


def families() -> Iterator[str]:
    """Yield NEV and coverage of the intervals by family of media."""
    prior = medium_prior(BEAMS, RATE_HZ, LENGTH_S)
    yield f"| pulses | noise | family | NEV | within u | within 1.96 u |   of {MEDIA_PER_FAMILY} media each"
    yield "|---|---|---|---|---|---|"
    for name, at in TRAINS.items():
        for noise_m in NOISE_M[1:]:
            for family in FAMILIES:
                generator, ratio = np.random.default_rng(2), []
                for index in range(MEDIA_PER_FAMILY):
                    ratio.append(_standardised_errors(prior, at, random_harmonics(family, generator), noise_m, index))
                yield f"| {name} | {noise_m * 1e9:.3g} nm | {family} | {_covered(ratio)} |"


def _standardised_errors(
    prior: MediumPrior, at: tuple[float, float], wave: ComplexArray, noise_m: float, seed: int
) -> FloatArray:
    """Return the errors of the quadratures in units of u (train, state)."""
    fit = medium_fit(measured(*at, wave, noise_m, 2, seed), WANTED_HZ, prior).fit
    error = fit.state[..., :20] - np.stack([wave[:10].real, wave[:10].imag], axis=-1).ravel()
    return np.asarray(error / np.sqrt(np.diagonal(fit.state_covariance, axis1=-2, axis2=-1)[..., :20]))


def _covered(ratio: list[FloatArray]) -> str:
    percentages = [100 * np.mean(np.abs(ratio) < k) for k in (1.0, 1.96)]
    return f"{np.mean(np.square(ratio)):.2f} | {percentages[0]:.0f} % | {percentages[1]:.0f} %"


def muscle_scene() -> Iterator[str]:
    """Yield the stated u of the shipped muscle scene relative to one sinusoid, with and without jitter."""
    yield "| bovine-muscle | noise a pulse | rms | worst | of noise | of aliasing | worst |"
    yield "|---|---|---|---|---|---|---|"
    for jitter_s in (0.0, JITTER_S):
        for name, change in (
            ("prior", {}),
            ("prior, [medium]", {"medium.shear_modulus_pa": 12e3, "medium.shear_viscosity_pa_s": 5.7}),
            ("least squares", {"processing.harmonic": "least_squares"}),
        ):
            fit = muscle_fit(jitter_s, change)
            # Standard deviation of a quadrature of one sinusoid in the same noise.
            sinusoid_m = float(fit.quality.residual_rms_m) * np.sqrt(2 / fit.quality.pulses)
            variance_m2 = quadratures_m2(fit.covariance, fit)
            aliasing_m2 = np.zeros_like(variance_m2) if fit.aliasing is None else quadratures_m2(fit.aliasing, fit)
            worst = np.unravel_index(np.argmax(variance_m2), variance_m2.shape)
            ratios = [np.sqrt(m2) / sinusoid_m for m2 in (variance_m2.mean(), variance_m2[worst])]
            ratios += [np.sqrt(m2[worst]) / sinusoid_m for m2 in (variance_m2 - aliasing_m2, aliasing_m2)]
            cells = " | ".join(f"{ratio:.2f}" for ratio in ratios)
            noise_nm, worst_nm = float(fit.quality.residual_rms_m) * 1e9, float(np.sqrt(variance_m2[worst])) * 1e9
            yield f"| {name}, {jitter_s * 1e9:g} ns | {noise_nm:.1f} nm | {cells} | {worst_nm:.3g} nm |"


def muscle_fit(jitter_s: float, change: Mapping[str, Any]) -> HarmonicFit:
    """Measure the shipped muscle scene on the twin and fit it with a ``change`` of its processing."""
    scene = hpe.load_scene("bovine-muscle").with_({"simulation.instruments.trigger_jitter_s": jitter_s})
    with TemporaryDirectory() as folder:
        run = hpe.measure(scene, path=Path(folder) / "run.h5")
        scene = run.scene.with_(change)
        return shot_fit(scene, run.plan.shots[0], run.stored, "coherent", beam_widths(scene, "coherent"))


def quadratures_m2(covariance: FloatArray, fit: HarmonicFit) -> FloatArray:
    """Return the variances (frequency, 2) along and across the phasors."""
    return np.stack([covariance[:, 0, 0], covariance[:, 1, 1] * fit.amplitude_m**2], axis=-1)


def constants() -> Iterator[str]:
    """Yield the effect of the prior's constants on the worst quadrature of the muscle scene and on aliasing errors."""
    of_fit, of_prior, of_projection = (
        sys.modules[function.__module__] for function in (medium_fit, medium_prior, project_prior)
    )
    yield "| changed | worst quadrature | synchronous, Voigt: error |"
    yield "|---|---|---|"
    voigt = [harmonics(*medium) for name, medium in media().items() if name.startswith("Voigt") and medium[1] == 1]
    # Noise of 23 nm per pulse.
    trains = [measured(*TRAINS["synchronous 4000 Hz"], wave, 23e-9) for wave in voigt]
    for changed in CONSTANTS:
        size = {"members": int(changed["members"])} if "members" in changed else {}
        with (
            mock.patch.object(of_fit, "PRIOR_WIDENING", changed.get("PRIOR_WIDENING", of_fit.PRIOR_WIDENING)),
            mock.patch.object(
                of_projection, "HARMONIC_DEVIATION", changed.get("HARMONIC_DEVIATION", of_projection.HARMONIC_DEVIATION)
            ),
            mock.patch.object(
                of_prior, "ENSEMBLE_RESIDUAL", changed.get("ENSEMBLE_RESIDUAL", of_prior.ENSEMBLE_RESIDUAL)
            ),
            mock.patch.object(of_prior, "medium_ensemble", functools.partial(medium_ensemble, **size)),
        ):
            # Cached priors and projections hold the old constants.
            for cached in (of_prior.medium_prior, of_projection._projected):
                cached.cache_clear()
            fit = muscle_fit(0.0, {})
            sinusoid_m = float(fit.quality.residual_rms_m) * np.sqrt(2 / fit.quality.pulses)
            worst = np.sqrt(quadratures_m2(fit.covariance, fit).max()) / sinusoid_m
            prior: MediumPrior = medium_prior(BEAMS, RATE_HZ, LENGTH_S)
            errors = [
                summary(medium_fit(train, WANTED_HZ, prior).fit, wave, 1.0)[:2]
                for train, wave in zip(trains, voigt, strict=True)
            ]
        percent, degrees = np.max(errors, axis=0)
        name = ", ".join(f"{key} {value:g}" for key, value in changed.items()) or "unchanged"
        yield f"| {name} | {worst:.3f} | {percent:.2f} %, {degrees:.2f} deg |"


def little_noise() -> Iterator[str]:
    """Yield NEV, error and u of corrected amplitudes and phases of shipped scenes without jitter, in reduced noise."""
    yield f"| scene | relative noise | NEV, amplitude | phase | largest | error, rms | u, rms |   of {SEEDS} seeds"
    yield "|---|---|---|---|---|---|---|"
    for name in ("gelatin-8", "bovine-muscle"):
        for noise_scale in (1.0, 0.1, 0.01, 0.001):
            ratios = np.array([row for seed in range(SEEDS) for row in _reduced_noise_errors(name, noise_scale, seed)])
            (amplitude, phase), (error, u) = (
                np.mean(ratios[:, :2] ** 2, axis=0),
                100 * np.sqrt(np.mean(ratios[:, 2:] ** 2, 0)),
            )
            largest = np.abs(ratios[:, :2]).max()
            nev = f"{amplitude:.2f} | {phase:.2f} | {largest:.1f} u"
            yield f"| {name} | {noise_scale:g} | {nev} | {error:.2f} % | {u:.2f} % |"


def _reduced_noise_errors(name: str, noise_scale: float, seed: int) -> Iterator[tuple[float, float, float, float]]:
    """Yield, per estimate, the errors of amplitude and phase in u, and relative error and u of the amplitude."""
    scene = hpe.load_scene(name)
    twin = scene.simulation or {}
    noise: dict[str, Any] = {"simulation.seed": seed + 1, "acquisition.repeats": 1}
    if "receive_chain" in twin:
        # Scenes with a receive chain state their noise in volts, others as SNR.
        level = twin["receive_chain"]["noise_v_per_sqrt_hz"]
        noise |= {"simulation.receive_chain.noise_v_per_sqrt_hz": level * noise_scale}
        noise |= {"simulation.instruments.trigger_jitter_s": 0.0}
    else:
        noise |= {"simulation.receiver.snr_db": twin["receiver"]["snr_db"] - 20 * np.log10(noise_scale)}
    with TemporaryDirectory() as folder:
        result = hpe.measure(scene.with_(noise), path=Path(folder) / "run.h5").estimate("coherent")
    for item in result.shots[0].estimates:
        true_m, error, error_rad = item.true_amplitude_m, item.amplitude_error, item.phase_error_rad
        assert true_m is not None
        assert error is not None
        assert error_rad is not None
        stated = item.amplitude_uncertainty_m / true_m
        yield error / stated, error_rad / item.phase_uncertainty_rad, error, stated


def draw() -> Figure:
    """Draw errors over frequency at the synchronous rate, and u over noise at the shifting rate."""
    prior = medium_prior(BEAMS, RATE_HZ, LENGTH_S)
    figure = Figure(figsize=(8.4, 3.2), layout="constrained")
    left, right = figure.subplots(1, 2)
    for index, name in enumerate(("Voigt 9 kPa, 2 Pa s", "Zener 5 + 20 kPa, 3 Pa s", "elastic 9 kPa")):
        wave = harmonics(*media()[name])
        motion = measured(*TRAINS["synchronous 4000 Hz"], wave, 7.7e-9)
        style = ("-", "--", ":")[index]
        for colour, fit in ((PLAIN, plain(motion)), (PRIOR, medium_fit(motion, WANTED_HZ, prior).fit)):
            state = fit.state[..., :20].mean(axis=0)
            error = np.abs((state[::2] + 1j * state[1::2]) / wave[:10] - 1)
            label = f"{'least squares' if colour == PLAIN else 'prior'}, {name.split()[0]}"
            left.semilogy(WANTED_HZ, 100 * error, style, color=colour, label=label)
    left.set(xlabel="vibration frequency (Hz)", ylabel="error without noise (%)", title="4000 Hz, synchronous")
    left.set_ylim(0.006, 100)
    left.legend(frameon=False, fontsize=7, ncols=2)
    wave, noise_m = harmonics(*media()["Voigt 9 kPa, 2 Pa s"]), np.geomspace(2e-9, 2e-6, 13)
    for colour, label in ((PLAIN, "least squares"), (PRIOR, "prior")):
        stated = []
        for sd_m in noise_m.tolist():
            motion = measured(*TRAINS["shifting 3990 Hz"], wave, sd_m, 5)
            fit = plain(motion) if colour == PLAIN else medium_fit(motion, WANTED_HZ, prior).fit
            sinusoid_m = sd_m * float(np.sqrt(2 / motion.valid.sum()))
            stated.append(summary(fit, wave, sinusoid_m)[3])
        right.loglog(noise_m * 1e9, stated, "o-", ms=3, color=colour, label=label)
    right.axhline(1.0, color="0.45", lw=0.8)
    right.annotate("one sinusoid in the same noise", (1900, 1.04), fontsize=7, color="0.45", ha="right")
    right.set(xlabel="noise of a pulse (nm)", ylabel="stated u / u of one sinusoid", title="3990 Hz, shifting")
    right.legend(frameon=False, fontsize=8)
    for axes in (left, right):
        axes.spines[["top", "right"]].set_visible(False)
        axes.grid(alpha=0.25)
    return figure


def main() -> None:
    """Print the tables and write medium-prior.svg, or print the requested table only."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    default = Path(__file__).parents[2] / "docs" / "figures"
    parser.add_argument("folder", nargs="?", type=Path, default=default, help="folder of the figure")
    parser.add_argument("--constants", action="store_true", help="only: effect of the constants of the prior")
    parser.add_argument("--little-noise", action="store_true", help="only: shipped scenes in reduced noise")
    parser.add_argument("--narrow", action="store_true", help="only: beams or force of half the width")
    arguments = parser.parse_args()
    for requested, table in (
        (arguments.constants, constants),
        (arguments.little_noise, little_noise),
        (arguments.narrow, narrow),
    ):
        if requested:
            for line in table():
                print(line, flush=True)
            return
    path = arguments.folder
    for table in (rows(), coverage(), families(), muscle_scene()):
        for line in table:
            print(line, flush=True)
        print()
    path.mkdir(parents=True, exist_ok=True)
    with rc_context({"svg.hashsalt": "hpe_rig", "svg.fonttype": "none"}):
        draw().savefig(path / "medium-prior.svg", metadata={"Date": None})


if __name__ == "__main__":
    main()
