"""Compare beams of an aperture with Gaussian beams: errors, run times, tracked displacement, and fitted moduli.

Usage: python scripts/validation/aperture.py [--draws 400] [--moduli] [--measured] [--records SEED ...]

Run times are processor times of this machine; only their ratios within one run are comparable.
"""

import argparse
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.integrate import quad
from scipy.special import j1

from hpe_rig.arrays import ComplexArray, FloatArray
from sim_backend.echoes import EchoDelays, beam_response, draw_field, echo_pulse, synthesise
from sim_backend.settings import SimulationSettings, Transducer
from sim_backend.transducer import bowl_pressure, push_intensity, wave_number

if TYPE_CHECKING:
    from hpe_rig.medium import PushForce
    from hpe_rig.moduli import Moduli

SPEED = 1540.0
PAPER = Transducer()
GATE_S = (np.arange(130) - 65) * 1e-8
APERTURE = {"field": "aperture"}
GAUSSIAN = {"excitation_width_m": (0.34e-3, 0.34e-3, 3.60e-3), "tracking_width_m": (0.110e-3, 0.110e-3, 1.19e-3)}


def timed(compute: Callable[[], Any], repeats: int = 5) -> tuple[Any, float]:
    """Return the value of ``compute()`` and the shortest of its processor times, s: disturbances only add to it."""
    times_s = []
    for _ in range(repeats):
        start_s = time.process_time()
        value = compute()
        times_s.append(time.process_time() - start_s)
    return value, min(times_s)


def on_axis(k: complex, axial_m: FloatArray) -> ComplexArray:
    """Return the pressure on the axis by O'Neil's closed form."""
    focal_m, radius_m = PAPER.focal_length_m, PAPER.diameter_m / 2
    # Waves from the centre and from the rim of the bowl interfere on the axis.
    centre_m = focal_m + axial_m
    rim_m = np.hypot(centre_m - (focal_m - np.sqrt(focal_m**2 - radius_m**2)), radius_m)
    return np.asarray((np.exp(-1j * k * centre_m) - np.exp(-1j * k * rim_m)) / (1 - centre_m / focal_m))


def rayleigh(k: complex, lateral_m: float, axial_m: float, nodes: int) -> complex:
    """Return the Rayleigh integral by a product rule of ``nodes`` times ``nodes`` points."""
    node, weight = np.polynomial.legendre.leggauss(nodes)
    focal_m, sine = PAPER.focal_length_m, PAPER.half_aperture
    # Gauss points in the cosine of the polar angle, equidistant points in azimuth.
    edge = np.sqrt(1 - sine**2)
    cosine, weight = edge + (1 - edge) * (node + 1) / 2, weight * (1 - edge) / 2
    angle = (np.arange(nodes) + 0.5) * 2 * np.pi / nodes
    across = focal_m * np.sqrt(1 - cosine**2)
    lateral = np.hypot(np.outer(across, np.cos(angle)) - lateral_m, np.outer(across, np.sin(angle)))
    distance_m = np.hypot(lateral, (focal_m * cosine + axial_m)[:, None])
    return complex(1j * k * focal_m**2 / nodes * (weight @ (np.exp(-1j * k * distance_m) / distance_m)).sum())


def adaptive(k: complex, lateral_m: float, axial_m: float) -> complex:
    """Return the Rayleigh integral by scipy's adaptive quadrature over both angles, which is slow and independent."""
    focal_m = PAPER.focal_length_m
    edge = np.sqrt(1 - PAPER.half_aperture**2)

    def ring(cosine: float, component: Callable[[complex], float]) -> float:
        across, along = focal_m * np.sqrt(1 - cosine**2), focal_m * cosine + axial_m

        def wave(angle: float) -> float:
            d = np.sqrt(across**2 + lateral_m**2 - 2 * across * lateral_m * np.cos(angle) + along**2)
            return component(np.exp(-1j * k * d) / d)

        return quad(wave, 0, np.pi, epsabs=1e-12, epsrel=1e-11, limit=400)[0] / np.pi

    real, imag = (
        quad(ring, edge, 1, (component,), epsabs=1e-10, epsrel=1e-10, limit=400)[0] for component in (np.real, np.imag)
    )
    return 1j * k * focal_m**2 * complex(real, imag)


def radiation() -> None:
    """Print error and run time of the field of the bowl."""
    print("## Field of the bowl, error relative to the pressure at the focus\n")
    print("| frequency | against | largest error | run time |")
    print("|---|---|---|---|")
    axial_m, lateral_m = np.linspace(-14.7e-3, 15e-3, 200), np.linspace(0, 4e-3, 100)
    for frequency_hz in (3e6, 9e6):
        for loss in (0.0, 0.5):
            k = wave_number(frequency_hz, SPEED, loss)
            field, field_s = timed(lambda k=k: bowl_pressure(PAPER, k, lateral_m, axial_m))
            focus = np.abs(field).max()
            error = np.abs(field[:, 0] - on_axis(k, axial_m)).max() / focus
            print(f"| {frequency_hz / 1e6:g} MHz, {loss:g} dB/cm/MHz | O'Neil's axis, 200 depths | {error:.1e} | "
                  f"{field_s * 1e3:.0f} ms for 20 000 points |")  # fmt: skip
            point = 1e-3, 2e-3
            pressure = bowl_pressure(PAPER, k, np.array([point[0]]), np.array([point[1]]))[0, 0]
            for nodes in (40, 80, 160):
                exact, exact_s = timed(lambda n=nodes, k=k, at=point: rayleigh(k, *at, n))
                print(f"| | Rayleigh, {nodes} x {nodes} points | {abs(exact - pressure) / focus:.1e} | "
                      f"{exact_s * 1e3:.2f} ms for one point |")  # fmt: skip
        k = wave_number(frequency_hz, SPEED)
        pressure = bowl_pressure(PAPER, k, np.array([0.3e-3]), np.array([1e-3]))[0, 0]
        exact, exact_s = timed(lambda k=k: adaptive(k, 0.3e-3, 1e-3), 1)
        focus = abs(bowl_pressure(PAPER, k, np.zeros(1), np.zeros(1))[0, 0])
        print(
            f"| | scipy's adaptive quadrature | {abs(exact - pressure) / focus:.1e} | {exact_s:.1f} s for one point |"
        )
        argument = np.linspace(0.02, 4, 100)
        field = np.abs(bowl_pressure(PAPER, k, argument / (k.real * PAPER.half_aperture), np.zeros(1))[0])
        jinc = np.abs(2 * j1(argument) / argument)
        error = np.abs(field / focus - jinc).max()
        print(f"| {frequency_hz / 1e6:g} MHz | jinc (approximate) in the focal plane | {error:.1e} | |")


def push() -> None:
    """Print the error of the sum of Gaussians that approximates the intensity of the push."""
    settings = SimulationSettings.model_validate({"beams": APERTURE, "specimen": {}})
    # The fit is cached: its first call is timed.
    uncached = getattr(push_intensity, "__wrapped__", push_intensity)
    shape, fit_s = timed(lambda: uncached(settings), 1)
    k = wave_number(3e6, SPEED, 0.5)
    axial_m, lateral_m = np.linspace(-12e-3, 12e-3, 121), np.linspace(0, 3e-3, 151)
    intensity = np.abs(bowl_pressure(PAPER, k, lateral_m, axial_m)) ** 2
    intensity /= intensity[60, 0]
    lateral, axial = np.meshgrid(lateral_m, axial_m)
    approximation = shape.at(lateral.ravel(), axial.ravel()).reshape(intensity.shape)
    gauss = np.exp(-0.5 * (lateral / 0.34e-3) ** 2 - 0.5 * (axial / 3.6e-3) ** 2)
    print("\n## Intensity of the push at 3 MHz, within 24 mm axially and 6 mm laterally\n")
    print("| shape | largest error relative to the focus | rms error |")
    print("|---|---|---|")
    for name, values in (
        (f"{len(shape.centre_m)} x {len(shape.lateral_width_m)} Gaussians", approximation),
        ("one Gaussian", gauss),
    ):
        # Rms over the cross-section: the weight is the radius.
        rms = np.sqrt(((values - intensity) ** 2 * lateral_m).sum() / (intensity**2 * lateral_m).sum())
        print(f"| {name} | {np.abs(values - intensity).max():.3f} | {rms:.3f} |")
    print(f"\nfitted in {fit_s:.2f} s, once per transducer and medium")


def settings_of(beams: dict[str, Any], **sections: Any) -> SimulationSettings:
    """Return the settings with the scatterers of Table I and these beams."""
    return SimulationSettings.model_validate({"beams": beams} | sections)


def tracked(draws: int) -> None:
    """Print the ratio of tracked to peak displacement with both kinds of beam, from the phase of the complete echo."""
    print("\n## Tracked / peak displacement, noise-free, 1 mm gate, 200 nm\n")
    print(f"| motion | beams | mean of {draws} draws | standard deviation | standard error |")
    print("|---|---|---|---|---|")
    medium = {"shear_modulus_pa": 9e3, "shear_viscosity_pa_s": 2.0}
    for name, sections in (("Gaussian of eq. (12), 0.34 mm", {}), ("medium at 200 Hz, in phase", {"specimen": medium})):
        for label, beams in (("Gaussian", GAUSSIAN), ("aperture", APERTURE)):
            beams_of_push = beams | {"excitation_width_m": GAUSSIAN["excitation_width_m"]}
            ratio = [_ratio(settings_of(beams_of_push, seed=seed, **sections), seed) for seed in range(draws)]
            sd = np.std(ratio)
            print(f"| {name} | {label} | {np.mean(ratio):.4f} | {sd:.4f} | {sd / np.sqrt(draws):.4f} |")


def _ratio(settings: SimulationSettings, seed: int) -> float:
    """Return tracked / peak displacement of one draw, from the correlation of the echoes."""
    field = draw_field(settings.scatterers, settings.beams, np.random.default_rng(seed))
    pulse = echo_pulse(settings, 9e6)
    weight, response, delay_ratio = field.tracking_weight, None, np.ones(1)
    if settings.beams.field == "aperture":
        beam = beam_response(settings, field.offset_m, pulse)
        weight, response, delay_ratio = beam.weight * field.reflectivity, beam.response, beam.delay_ratio
    shape = field.motion_weight
    if settings.specimen is not None:
        shape = _in_phase(settings, field.offset_m)
    delay_s = 2 * field.offset_m[:, 2] / SPEED
    displacement_m = np.array([0.0, 200e-9])
    delays = EchoDelays.of_motion(delay_s, shape * delay_ratio, displacement_m, SPEED, response)
    volts = synthesise(delays, weight, pulse, GATE_S, 1e-9).echo
    # Displacement from the phase between analytic echoes, scaled by the mean frequency of the echo.
    analytic = [_analytic(echo) for echo in volts]
    phase = np.angle(np.vdot(analytic[1], analytic[0]))
    phase_step = np.angle(np.vdot(analytic[0][:-1], analytic[0][1:]))
    return float(phase / (phase_step / 1e-8) * SPEED / 2 / 200e-9)


def _analytic(echo: FloatArray) -> ComplexArray:
    """Return the analytic signal of a windowed echo."""
    # Negative frequencies are removed; the padding refines the correlation.
    spectrum = np.fft.fft(np.pad(echo * np.hanning(len(echo)), 190))
    spectrum[len(spectrum) // 2 :] = 0
    return np.asarray(np.fft.ifft(spectrum))


_SHAPES: dict[str, Any] = {}


def _in_phase(settings: SimulationSettings, offset_m: FloatArray) -> FloatArray:
    """Return the displacement at 200 Hz at the scatterers, in phase with that of the focus and relative to it."""
    from scipy.interpolate import RectBivariateSpline

    from sim_backend.motion import field_transfer, force_shape

    key = settings.beams.field
    if key not in _SHAPES:
        assert settings.specimen is not None
        # The field is smooth: a spline through few points is accurate enough.
        lateral_m, axial_m = np.linspace(0, 0.75e-3, 16), np.linspace(-2.5e-3, 2.5e-3, 21)
        value = field_transfer(settings.specimen, force_shape(settings), lateral_m, axial_m, np.array([200.0]))[0]
        focus = value[0, 10]
        _SHAPES[key] = RectBivariateSpline(lateral_m, axial_m, (value / focus).real)
    return np.asarray(_SHAPES[key].ev(np.hypot(offset_m[:, 0], offset_m[:, 1]), offset_m[:, 2]))


NOISE_M, PEAK_M = 0.7e-9, 800e-9
OFFSETS_M = {"1 to 6 mm, five": (1e-3, 2.25e-3, 3.5e-3, 4.75e-3, 6e-3), "1 mm": (1e-3,), "axis": (0.0,)}


def moduli() -> None:
    """Print moduli fitted to the push of the twin, with a Gaussian force and with the force of the aperture."""
    from hpe_rig.medium import PushForce, aperture_force

    aperture = aperture_force(PAPER.diameter_m, PAPER.focal_length_m, 3e6, SPEED)
    pushes = {"Gaussian": PushForce((0.34e-3,), 3.6e-3), "aperture": aperture}
    print("\n| medium | offsets | force of the fit | mu1 | mu2 | chi-square |\n|---|---|---|---:|---:|---:|")
    for mu1, mu2 in ((7.25e3, 1.0), (9e3, 2.0)):
        settings = settings_of(APERTURE, specimen={"shear_modulus_pa": mu1, "shear_viscosity_pa_s": mu2})
        for name in OFFSETS_M:
            for kind, force in pushes.items():
                print(
                    f"| {mu1 * 1e-3:g} kPa, {mu2:g} Pa s | {name} | {kind} | {fitted(settings, name, force)} |",
                    flush=True,
                )


def measured() -> None:
    """Print moduli fitted for bowls with non-uniform velocity, with the force of a uniform bowl and of a scanned beam.

    The scan has magnitudes only, every 50 um laterally and 0.25 mm axially, to 9 mm and 22 mm on each side.
    """
    from hpe_rig.bench import scanned_push
    from hpe_rig.medium import aperture_force, scanned_force

    uniform = aperture_force(PAPER.diameter_m, PAPER.focal_length_m, 3e6, SPEED)
    k = wave_number(3e6, SPEED, 0.5)
    print("\n| surface velocity | offsets | force of the fit | mu1 | mu2 | chi-square |\n|---|---|---|---:|---:|---:|")
    for shape in ("uniform", "parabolic", "hann"):
        bowl = Transducer(apodisation=shape)
        with TemporaryDirectory() as folder:
            path = str(Path(folder) / "push.csv")
            _scan_push(bowl, k, path)
            scanned = scanned_force(scanned_push(path, 3e6, SPEED), 3e6)
        settings = settings_of(APERTURE, specimen={"shear_modulus_pa": 7.25e3, "shear_viscosity_pa_s": 1.0})
        beams = settings.beams.model_copy(update={"transducer": bowl})
        settings = settings.model_copy(update={"beams": beams})
        for name in OFFSETS_M:
            for kind, force in (("uniform bowl", uniform), ("scanned", scanned)):
                print(f"| {shape} | {name} | {kind} | {fitted(settings, name, force)} |", flush=True)


def _scan_push(bowl: Transducer, wave_number_per_m: complex, path: str) -> None:
    """Write a scan of the beam of the bowl, from the axis outwards."""
    across_m, along_m = np.linspace(0, 9e-3, 181), np.linspace(-22e-3, 22e-3, 177)
    pressure = np.abs(bowl_pressure(bowl, wave_number_per_m, across_m, along_m))
    z, x = np.meshgrid(along_m, across_m, indexing="ij")
    table = np.stack([x, 0 * x, z, 1e4 * pressure], axis=-1).reshape(-1, 4)
    np.savetxt(path, table, delimiter=",", header="x_m,y_m,z_m,pressure_pa", comments="")


def fitted(settings: SimulationSettings, offsets: str, force: "PushForce") -> str:
    """Return errors of mu1 and mu2 with u, and chi-square, fitted to noise-free motion at ``offsets`` with weights."""
    from hpe_rig.moduli import Push, Vibration, fit_medium
    from sim_backend.motion import field_transfer

    assert settings.specimen is not None
    specimen, frequency_hz = settings.specimen, np.arange(100.0, 1001.0, 100.0)
    offsets_m = OFFSETS_M[offsets]
    axis_and_offsets_m = np.array([0.0, *offsets_m])
    field = field_transfer(specimen, push_intensity(settings), axis_and_offsets_m, np.zeros(1), frequency_hz)
    push = Push(force, 100.0, 100e-6)
    motion = field[:, :, 0] * push.spectrum(frequency_hz)[:, None]
    # The peak displacement on the axis at 100 Hz is 800 nm.
    motion *= PEAK_M / abs(motion[0, 0])
    uncertainties = {"gain_uncertainty": 0.005, "phase_uncertainty_rad": 0.002, "stage_uncertainty_m": 20e-6}
    vibrations = [
        Vibration(f"{lateral_m:g}", frequency_hz, phasor_m, NOISE_M**2 * np.eye(20), lateral_m, **uncertainties)
        for lateral_m, phasor_m in zip(offsets_m, motion.T[1:], strict=True)
    ]
    return compared(fit_medium(vibrations, push), specimen.shear_modulus_pa, specimen.shear_viscosity_pa_s)


def compared(fit: "Moduli", mu1_pa: float, mu2_pa_s: float) -> str:
    """Return errors of a Voigt fit with u, and chi-square."""
    truth = (("shear_modulus_pa", mu1_pa), ("viscosity_pa_s", mu2_pa_s))
    errors = [
        f"{100 * (fit.values[key] / true - 1):+.1f} ± {100 * fit.uncertainty[key] / true:.1f} %" for key, true in truth
    ]
    return f"{errors[0]} | {errors[1]} | {fit.chi_square:.3g} over {fit.freedom}"


def records(seeds: Sequence[int]) -> None:
    """Print moduli fitted to ``gelatin-moduli`` on the twin with the beams of the aperture, two media per seed."""
    from hpe_rig import load_scene, measure
    from hpe_rig.moduli import Source, fit_medium, push_of, vibrations_of

    gaussian = load_scene("gelatin-moduli").with_(
        {"beams.tracking_width_m": (0.110e-3, 0.110e-3, 1.19e-3), "simulation.beams.field": "aperture"}
    )
    scene = gaussian.with_({"beams.transducer_diameter_m": PAPER.diameter_m})
    pushes = {"aperture": push_of([scene]), "Gaussian": push_of([gaussian])}
    print("\n| seed | medium | offsets | force of the fit | mu1 | mu2 | chi-square |\n|---|---|---|---|---:|---:|---:|")
    for seed in seeds:
        for mu1, mu2 in ((7.25e3, 1.0), (9e3, 2.0)):
            medium = {"simulation.specimen.shear_modulus_pa": mu1, "simulation.specimen.shear_viscosity_pa_s": mu2}
            with TemporaryDirectory() as folder:
                run = measure(scene.with_(medium | {"simulation.seed": seed}), path=Path(folder) / "run.h5")
                vibrations, _ = vibrations_of([Source("", run.scene, run.plan, run.stored)])
            for offsets, subset in (("1 to 6 mm, five", vibrations), ("1 mm", vibrations[:1])):
                for kind, push in pushes.items():
                    errors = compared(fit_medium(subset, push), mu1, mu2)
                    print(f"| {seed} | {mu1 * 1e-3:g} kPa, {mu2:g} Pa s | {offsets} | {kind} | {errors} |", flush=True)


def main() -> None:
    """Print the requested tables; default: all except those of --measured and --records."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--draws", type=int, default=400)
    parser.add_argument("--moduli", action="store_true", help="only: table of fitted moduli")
    parser.add_argument("--measured", action="store_true", help="only: moduli for bowls with non-uniform velocity")
    parser.add_argument(
        "--records", type=int, nargs="+", metavar="SEED", help="only: moduli from records of these seeds"
    )
    arguments = parser.parse_args()
    if arguments.records:
        records(arguments.records)
        return
    if arguments.measured:
        measured()
        return
    if not arguments.moduli:
        radiation()
        push()
        tracked(arguments.draws)
    moduli()


if __name__ == "__main__":
    main()
