"""Beams of the aperture beside Gaussian beams: error against run time, tracked over peak displacement, cost of echoes.

Usage: python scripts/validation/aperture.py [--draws 400] [--moduli] [--measured] [--records SEED ...]

Run times are processor time, ratios within one run; milliseconds hold on no other machine.
"""

import argparse
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.integrate import quad
from scipy.special import j0, j1

from hpe_rig.arrays import ComplexArray, FloatArray
from sim_backend.acoustics import Acoustics
from sim_backend.echoes import EchoDelays, beam_response, draw_field, drawn_echoes, echo_pulse, echoes
from sim_backend.settings import SimulationSettings, Transducer
from sim_backend.transducer import bowl_pressure, push_intensity, wave_number
from sim_backend.wiring import Bursts, Capture

if TYPE_CHECKING:
    from hpe_rig.medium import PushForce
    from hpe_rig.moduli import Moduli

SPEED = 1540.0
PAPER = Transducer()
GATE_S = (np.arange(130) - 65) * 1e-8
APERTURE = {"field": "aperture"}
GAUSSIAN = {"excitation_width_m": (0.34e-3, 0.34e-3, 3.60e-3), "tracking_width_m": (0.110e-3, 0.110e-3, 1.19e-3)}


def timed(make: Callable[[], Any], times: int = 5) -> tuple[Any, float]:
    """Return what ``make`` makes and the shortest of its processor times, s: other work on the machine only adds."""
    taken = []
    for _ in range(times):
        begin = time.process_time()
        made = make()
        taken.append(time.process_time() - begin)
    return made, min(taken)


def on_axis(k: complex, axial_m: FloatArray) -> ComplexArray:
    """Return O'Neil's closed form on the axis."""
    focal_m, radius_m = PAPER.focal_length_m, PAPER.diameter_m / 2
    middle_m = focal_m + axial_m
    rim_m = np.hypot(middle_m - (focal_m - np.sqrt(focal_m**2 - radius_m**2)), radius_m)
    return np.asarray((np.exp(-1j * k * middle_m) - np.exp(-1j * k * rim_m)) / (1 - middle_m / focal_m))


def rayleigh(k: complex, lateral_m: float, axial_m: float, nodes: int) -> complex:
    """Return the Rayleigh integral by a product rule of ``nodes`` times ``nodes`` points."""
    node, weight = np.polynomial.legendre.leggauss(nodes)
    focal_m, sine = PAPER.focal_length_m, PAPER.half_aperture
    edge = np.sqrt(1 - sine**2)
    cosine, weight = edge + (1 - edge) * (node + 1) / 2, weight * (1 - edge) / 2
    turn = (np.arange(nodes) + 0.5) * 2 * np.pi / nodes
    across = focal_m * np.sqrt(1 - cosine**2)
    lateral = np.hypot(np.outer(across, np.cos(turn)) - lateral_m, np.outer(across, np.sin(turn)))
    distance_m = np.hypot(lateral, (focal_m * cosine + axial_m)[:, None])
    return complex(1j * k * focal_m**2 / nodes * (weight @ (np.exp(-1j * k * distance_m) / distance_m)).sum())


def adaptive(k: complex, lateral_m: float, axial_m: float) -> complex:
    """Return the Rayleigh integral by scipy's adaptive quadrature over both angles: slow, and nobody's own rule."""
    focal_m = PAPER.focal_length_m
    edge = np.sqrt(1 - PAPER.half_aperture**2)

    def ring(cosine: float, part: Callable[[complex], float]) -> float:
        across, along = focal_m * np.sqrt(1 - cosine**2), focal_m * cosine + axial_m

        def wave(turn: float) -> float:
            d = np.sqrt(across**2 + lateral_m**2 - 2 * across * lateral_m * np.cos(turn) + along**2)
            return part(np.exp(-1j * k * d) / d)

        return quad(wave, 0, np.pi, epsabs=1e-12, epsrel=1e-11, limit=400)[0] / np.pi

    real, imag = (quad(ring, edge, 1, (part,), epsabs=1e-10, epsrel=1e-10, limit=400)[0] for part in (np.real, np.imag))
    return 1j * k * focal_m**2 * complex(real, imag)


def radiation() -> None:
    """Print the field's error and run time."""
    print("## Field of the bowl, error over the focus' pressure\n")
    print("| frequency | against | largest error | run time |")
    print("|---|---|---|---|")
    axial_m, lateral_m = np.linspace(-14.7e-3, 15e-3, 200), np.linspace(0, 4e-3, 100)
    for frequency_hz in (3e6, 9e6):
        for loss in (0.0, 0.5):
            k = wave_number(frequency_hz, SPEED, loss)
            made, taken = timed(lambda k=k: bowl_pressure(PAPER, k, lateral_m, axial_m))
            focus = np.abs(made).max()
            error = np.abs(made[:, 0] - on_axis(k, axial_m)).max() / focus
            print(f"| {frequency_hz / 1e6:g} MHz, {loss:g} dB/cm/MHz | O'Neil's axis, 200 depths | {error:.1e} | "
                  f"{taken * 1e3:.0f} ms for 20 000 places |")  # fmt: skip
            place = 1e-3, 2e-3
            own = bowl_pressure(PAPER, k, np.array([place[0]]), np.array([place[1]]))[0, 0]
            for nodes in (40, 80, 160):
                other, each = timed(lambda n=nodes, k=k, at=place: rayleigh(k, *at, n))
                print(f"| | Rayleigh, {nodes} x {nodes} points | {abs(other - own) / focus:.1e} | "
                      f"{each * 1e3:.2f} ms for one place |")  # fmt: skip
        k = wave_number(frequency_hz, SPEED)
        own = bowl_pressure(PAPER, k, np.array([0.3e-3]), np.array([1e-3]))[0, 0]
        other, each = timed(lambda k=k: adaptive(k, 0.3e-3, 1e-3), 1)
        focus = abs(bowl_pressure(PAPER, k, np.zeros(1), np.zeros(1))[0, 0])
        print(f"| | scipy's adaptive quadrature | {abs(other - own) / focus:.1e} | {each:.1f} s for one place |")
        place = np.linspace(0.02, 4, 100)
        made = np.abs(bowl_pressure(PAPER, k, place / (k.real * PAPER.half_aperture), np.zeros(1))[0])
        jinc = np.abs(2 * j1(place) / place)
        print(f"| {frequency_hz / 1e6:g} MHz | the focal plane's jinc | {np.abs(made / focus - jinc).max():.1e} "
              f"(what it leaves out) | |")  # fmt: skip


def push() -> None:
    """Print what the sum of Gaussians makes of the push."""
    settings = SimulationSettings.model_validate({"beams": APERTURE, "specimen": {}})
    shape, taken = timed(lambda: push_intensity.__wrapped__(settings) if hasattr(push_intensity, "__wrapped__") else push_intensity(settings), 1)  # fmt: skip  # noqa: E501
    k = wave_number(3e6, SPEED, 0.5)
    axial_m, lateral_m = np.linspace(-12e-3, 12e-3, 121), np.linspace(0, 3e-3, 151)
    intensity = np.abs(bowl_pressure(PAPER, k, lateral_m, axial_m)) ** 2
    intensity /= intensity[60, 0]
    place = np.meshgrid(lateral_m, axial_m)
    made = shape.at(place[0].ravel(), place[1].ravel()).reshape(intensity.shape)
    gauss = np.exp(-0.5 * (place[0] / 0.34e-3) ** 2 - 0.5 * (place[1] / 3.6e-3) ** 2)
    print("\n## The push's intensity at 3 MHz, 24 mm along and 6 mm across\n")
    print("| shape | largest error over the focus | rms error |")
    print("|---|---|---|")
    for name, each in (
        (f"{len(shape.centre_m)} x {len(shape.lateral_width_m)} Gaussians", made),
        ("one Gaussian", gauss),
    ):
        rms = np.sqrt(((each - intensity) ** 2 * lateral_m).sum() / (intensity**2 * lateral_m).sum())
        print(f"| {name} | {np.abs(each - intensity).max():.3f} | {rms:.3f} |")
    print(f"\nfitted in {taken:.2f} s, once a transducer and medium")


def settings_of(beams: dict[str, Any], **more: Any) -> SimulationSettings:
    """Return Table I's scatterers in these beams."""
    return SimulationSettings.model_validate({"beams": beams} | more)


def costs() -> None:
    """Print what echoes cost through either beam, side by side."""
    print("\n## Run time of the echoes, aperture over Gaussian, in one run\n")
    print("| echoes | Gaussian | aperture | ratio |")
    print("|---|---|---|---|")
    motion = [{"frequency_hz": 200.0, "amplitude_m": 1e-6}]
    medium = {"shear_modulus_pa": 9e3, "shear_viscosity_pa_s": 2.0, "force_density_n_per_m3": 1.4e6}
    count = 800
    onset = np.arange(count) * 250_000_000
    pulses = Bursts(*(np.asarray(each) for each in (onset, onset + 333_333, np.full(count, 9e6), np.full(count, 3.0), np.ones(count))))  # noqa: E501  # fmt: skip
    pushes = np.arange(20) * 10_000_000_000 - 120_000_000
    bursts = Bursts(pushes, pushes + 100_000_000, np.full(20, 3e6), np.full(20, 300.0), np.ones(20))
    none = Bursts(*(np.zeros(0, dtype) for dtype in (np.int64, np.int64, float, float, float)))
    capture = Capture(0, 0, onset + 88_460_000, 10_000, 512)
    for name, more, driven in (
        ("prescribed motion, 800 echoes of 512 samples", {"motion": motion}, none),
        ("medium's field, 800 echoes of 512 samples", {"specimen": medium}, bursts),
    ):
        taken = []
        for beams in (GAUSSIAN, APERTURE):
            bench = Acoustics(settings_of(beams, **more))
            bench.record_volts(driven, pulses, capture)
            taken.append(timed(lambda b=bench, d=driven: b.record_volts(d, pulses, capture))[1])
        print(f"| {name} | {taken[0] * 1e3:.0f} ms | {taken[1] * 1e3:.0f} ms | {taken[1] / taken[0]:.2f} |")
    moved_m = 1e-6 * np.sin(2 * np.pi * 200 * np.arange(101) / 4000)
    taken = []
    for beams in (GAUSSIAN, APERTURE):
        settings = settings_of(beams)
        pulse = echo_pulse(settings, 9e6)
        rng = np.random.default_rng(1)
        list(drawn_echoes(settings, moved_m, pulse, GATE_S, rng, 16))
        taken.append(timed(lambda s=settings, p=pulse, r=rng: list(drawn_echoes(s, moved_m, p, GATE_S, r, 64)))[1] / 64)
    print(f"| a study's draw of 101 echoes | {taken[0] * 1e3:.2f} ms | {taken[1] * 1e3:.2f} ms | "
          f"{taken[1] / taken[0]:.2f} |")  # fmt: skip


def tracked(draws: int) -> None:
    """Print tracked over peak displacement in both beams, by the phase of all echoes at once."""
    print("\n## Tracked over peak displacement, noise-free, 1 mm gate, 200 nm\n")
    print(f"| motion | beams | mean of {draws} draws | standard deviation | of the mean |")
    print("|---|---|---|---|---|")
    medium = {"shear_modulus_pa": 9e3, "shear_viscosity_pa_s": 2.0}
    for name, more in (("Gaussian of eq. (12), 0.34 mm", {}), ("medium at 200 Hz, in phase", {"specimen": medium})):
        for label, beams in (("Gaussian", GAUSSIAN), ("aperture", APERTURE)):
            ratio = [_ratio(settings_of(beams | {"excitation_width_m": GAUSSIAN["excitation_width_m"]}, seed=seed, **more), seed) for seed in range(draws)]  # noqa: E501  # fmt: skip
            spread = np.std(ratio)
            print(f"| {name} | {label} | {np.mean(ratio):.4f} | {spread:.4f} | {spread / np.sqrt(draws):.4f} |")


def _ratio(settings: SimulationSettings, seed: int) -> float:
    """Return the tracked over the focus' displacement in one draw, by the echoes' correlation."""
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
    moved_m = np.array([0.0, 200e-9])
    delays = EchoDelays.of_motion(delay_s, shape * delay_ratio, moved_m, SPEED, response)
    made = echoes(delays, weight, pulse, GATE_S, 1e-9)
    # The lower sideband away: the phase of the correlation of analytic echoes, over that of their own mean frequency.
    analytic = [_analytic(each) for each in made]
    turned = np.angle(np.vdot(analytic[1], analytic[0]))
    step = np.angle(np.vdot(analytic[0][:-1], analytic[0][1:]))
    return float(turned / (step / 1e-8) * SPEED / 2 / 200e-9)


def _analytic(echo: FloatArray) -> ComplexArray:
    spectrum = np.fft.fft(np.pad(echo * np.hanning(len(echo)), 190))
    spectrum[len(spectrum) // 2 :] = 0
    return np.asarray(np.fft.ifft(spectrum))


_SHAPES: dict[str, Any] = {}


def _in_phase(settings: SimulationSettings, offset_m: FloatArray) -> FloatArray:
    """Return the medium's displacement at 200 Hz at the scatterers, in phase with the focus' and over it."""
    from scipy.interpolate import RectBivariateSpline

    from sim_backend.motion import field_transfer, force_shape

    key = settings.beams.field
    if key not in _SHAPES:
        assert settings.specimen is not None
        lateral_m, axial_m = np.linspace(0, 0.75e-3, 16), np.linspace(-2.5e-3, 2.5e-3, 21)
        value = field_transfer(settings.specimen, force_shape(settings), lateral_m, axial_m, np.array([200.0]))[0]
        focus = value[0, 10]
        _SHAPES[key] = RectBivariateSpline(lateral_m, axial_m, (value / focus).real)
    return np.asarray(_SHAPES[key].ev(np.hypot(offset_m[:, 0], offset_m[:, 1]), offset_m[:, 2]))


NOISE_M, PEAK_M = 0.7e-9, 800e-9
PLACES_M = {"1 to 6 mm, five": (1e-3, 2.25e-3, 3.5e-3, 4.75e-3, 6e-3), "1 mm": (1e-3,), "axis": (0.0,)}


def moduli() -> None:
    """Print what a fit of moduli makes of the twin's push, by a Gaussian force and by the aperture's own."""
    from hpe_rig.medium import PushForce, aperture_force

    own = aperture_force(PAPER.diameter_m, PAPER.focal_length_m, 3e6, SPEED)
    pushes = {"Gaussian": PushForce((0.34e-3,), 3.6e-3), "aperture": own}
    print("\n| medium | places | force of the fit | mu1 | mu2 | chi-square |\n|---|---|---|---:|---:|---:|")
    for mu1, mu2 in ((7.25e3, 1.0), (9e3, 2.0)):
        settings = settings_of(APERTURE, specimen={"shear_modulus_pa": mu1, "shear_viscosity_pa_s": mu2})
        for name in PLACES_M:
            for kind, force in pushes.items():
                print(
                    f"| {mu1 * 1e-3:g} kPa, {mu2:g} Pa s | {name} | {kind} | {fitted(settings, name, force)} |",
                    flush=True,
                )


def measured() -> None:
    """Print what a fit makes of bowls that move unevenly, by the force of an even bowl and by that of a scan of theirs.

    The scan is one without phase, every 50 um across and 0.25 mm along, 9 mm and 22 mm to each side.
    """
    from hpe_rig.bench import scanned_push
    from hpe_rig.medium import aperture_force, scanned_force

    even = aperture_force(PAPER.diameter_m, PAPER.focal_length_m, 3e6, SPEED)
    k = wave_number(3e6, SPEED, 0.5)
    print("\n| surface moves | places | force of the fit | mu1 | mu2 | chi-square |\n|---|---|---|---:|---:|---:|")
    for shape in ("uniform", "parabolic", "hann"):
        bowl = Transducer(apodisation=shape)
        with TemporaryDirectory() as folder:
            path = str(Path(folder) / "push.csv")
            _scan_push(bowl, k, path)
            scanned = scanned_force(scanned_push(path, 3e6, SPEED), 3e6)
        settings = settings_of(APERTURE, specimen={"shear_modulus_pa": 7.25e3, "shear_viscosity_pa_s": 1.0})
        beams = settings.beams.model_copy(update={"transducer": bowl})
        settings = settings.model_copy(update={"beams": beams})
        for name in PLACES_M:
            for kind, force in (("even bowl", even), ("scanned", scanned)):
                print(f"| {shape} | {name} | {kind} | {fitted(settings, name, force)} |", flush=True)


def _scan_push(bowl: Transducer, wave_number_per_m: complex, path: str) -> None:
    """Write a scan of the bowl's beam, from the axis outwards."""
    across_m, along_m = np.linspace(0, 9e-3, 181), np.linspace(-22e-3, 22e-3, 177)
    pressure = np.abs(bowl_pressure(bowl, wave_number_per_m, across_m, along_m))
    z, x = np.meshgrid(along_m, across_m, indexing="ij")
    table = np.stack([x, 0 * x, z, 1e4 * pressure], axis=-1).reshape(-1, 4)
    np.savetxt(path, table, delimiter=",", header="x_m,y_m,z_m,pressure_pa", comments="")


def fitted(settings: SimulationSettings, places: str, force: "PushForce") -> str:
    """Return errors of mu1 and mu2 with their u, and chi-square, from noise-free motion at ``places`` with weights."""
    from hpe_rig.moduli import Push, Vibration, fit_medium
    from sim_backend.motion import field_transfer

    assert settings.specimen is not None
    specimen, frequency_hz = settings.specimen, np.arange(100.0, 1001.0, 100.0)
    places_m = PLACES_M[places]
    where = np.array([0.0, *places_m])
    field = field_transfer(specimen, push_intensity(settings), where, np.zeros(1), frequency_hz)
    push = Push(force, 100.0, 100e-6)
    motion = field[:, :, 0] * push.spectrum(frequency_hz)[:, None]
    motion *= PEAK_M / abs(motion[0, 0])
    known = {"gain_uncertainty": 0.005, "phase_uncertainty_rad": 0.002, "place_uncertainty_m": 20e-6}
    seen = [
        Vibration(f"{at:g}", frequency_hz, each, NOISE_M**2 * np.eye(20), at, **known)
        for at, each in zip(places_m, motion.T[1:], strict=True)
    ]
    return compared(fit_medium(seen, push), specimen.shear_modulus_pa, specimen.shear_viscosity_pa_s)


def compared(fit: "Moduli", mu1_pa: float, mu2_pa_s: float) -> str:
    """Return the errors of a Voigt fit with their u, and chi-square."""
    truth = (("shear_modulus_pa", mu1_pa), ("viscosity_pa_s", mu2_pa_s))
    off = [
        f"{100 * (fit.values[key] / true - 1):+.1f} ± {100 * fit.uncertainty[key] / true:.1f} %" for key, true in truth
    ]
    return f"{off[0]} | {off[1]} | {fit.chi_square:.3g} over {fit.freedom}"


def records(seeds: Sequence[int]) -> None:
    """Print what fits make of ``gelatin-moduli``, measured on the twin in the aperture's beams, two media a seed."""
    from hpe_rig import load_scene, measure
    from hpe_rig.moduli import Source, fit_medium, push_of, vibrations_of

    gaussian = load_scene("gelatin-moduli").with_(
        {"beams.tracking_width_m": (0.110e-3, 0.110e-3, 1.19e-3), "simulation.beams.field": "aperture"}
    )
    scene = gaussian.with_({"beams.transducer_diameter_m": PAPER.diameter_m})
    pushes = {"aperture": push_of([scene]), "Gaussian": push_of([gaussian])}
    print("\n| seed | medium | places | force of the fit | mu1 | mu2 | chi-square |\n|---|---|---|---|---:|---:|---:|")
    for seed in seeds:
        for mu1, mu2 in ((7.25e3, 1.0), (9e3, 2.0)):
            medium = {"simulation.specimen.shear_modulus_pa": mu1, "simulation.specimen.shear_viscosity_pa_s": mu2}
            with TemporaryDirectory() as folder:
                run = measure(scene.with_(medium | {"simulation.seed": seed}), path=Path(folder) / "run.h5")
                vibrations, _ = vibrations_of([Source("", run.scene, run.plan, run.stored)])
            for places, some in (("1 to 6 mm, five", vibrations), ("1 mm", vibrations[:1])):
                for kind, push in pushes.items():
                    found = compared(fit_medium(some, push), mu1, mu2)
                    print(f"| {seed} | {mu1 * 1e-3:g} kPa, {mu2:g} Pa s | {places} | {kind} | {found} |", flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--draws", type=int, default=400)
    parser.add_argument("--moduli", action="store_true", help="the table of fitted moduli alone")
    parser.add_argument("--measured", action="store_true", help="the table of moduli by beams that are no even bowl's")
    parser.add_argument("--records", type=int, nargs="+", metavar="SEED", help="the table of moduli from records alone")
    given = parser.parse_args()
    assert j0(0) == 1
    if given.records:
        records(given.records)
        raise SystemExit
    if given.measured:
        measured()
        raise SystemExit
    if not given.moduli:
        radiation()
        push()
        costs()
        tracked(given.draws)
    moduli()
