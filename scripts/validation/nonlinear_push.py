"""Nonlinear propagation: error against closed forms and against run time, a published beam, and the push over drive.

Tables: plane waves (Fubini, Blackstock); the bowl in its linear limit (Rayleigh integral) and its second harmonic
(Green's integral over the linear field); a published curve along the axis and a published focus; what accuracy costs;
output in water over a linear wave's; force, pressures and exponent over drive in the twin's muscle, and what the same
force field moves at a frequency instead of at rest. Seconds are processor time; compare them within one run alone.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import replace

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.special import jv

from hpe_rig.prediction import focal_distortion
from hpe_rig.scene import load_scene
from sim_backend.settings import Beams, Propagation, SimulationSettings, Specimen, Transducer
from sim_backend.transducer import (
    Accuracy,
    Beam,
    Layer,
    advance,
    bowl_pressure,
    equivalent_force,
    nonlinear_beam,
    path,
    push_of,
    water_output,
)

FREQUENCY_HZ, SPEED = 3e6, 1540.0
BOWL = Transducer()
LOSSLESS = Layer(np.inf, SPEED, 1000.0, 4.0, 1e-9, 2.0)
SPECIMEN = Specimen(preset="bovine_muscle", force_density_n_per_m3=2.2e6)
BEAMS = Beams(excitation_width_m=(0.34e-3, 0.34e-3, 3.6e-3))


def main() -> None:
    """Print all tables, or those named."""
    tables = (
        plane_waves,
        linear_limit,
        second_harmonic,
        published_axis,
        published_differences,
        published_focus,
        accuracy,
        water,
        drive,
        frequencies,
    )
    named = [table.__name__ for table in tables]
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("table", nargs="*", help=f"one of {', '.join(named)}")
    given = parser.parse_args().table
    if wrong := set(given) - set(named):
        parser.error(f"no table is called {', '.join(sorted(wrong))}: try one of {', '.join(named)}")
    for table in tables:
        if not given or table.__name__ in given:
            for line in table():
                print(line, flush=True)
            print()


def blackstock(sigma: float, count: int) -> np.ndarray:
    """Return harmonics of an initially sinusoidal plane wave over its amplitude, by weak shock theory (1966).

    ``B_n = 2 / (n pi) sin(x_s) + 2 / (n pi sigma) int_(x_s)^pi cos(n (x - sigma sin x)) dx`` with the shock at
    ``x_s = sigma sin(x_s)``; without one, x_s = 0, it is Fubini's series 2 J_n(n sigma) / (n sigma).
    """
    n = np.arange(1, count + 1)
    if sigma <= 1:
        return 2 * jv(n, n * sigma) / (n * sigma)
    shock = np.pi
    for _ in range(500):
        shock = shock - (shock - sigma * np.sin(shock)) / (1 - sigma * np.cos(shock))
    node, weight = np.polynomial.legendre.leggauss(400)
    x = shock + (np.pi - shock) * (node + 1) / 2
    waves = np.cos(n[:, None] * (x - sigma * np.sin(x))) @ weight * (np.pi - shock) / 2
    return 2 / (n * np.pi) * np.sin(shock) + 2 / (n * np.pi * sigma) * waves


def plane_waves() -> Iterator[str]:
    """Yield the error of the first five harmonics of a plane wave, over the first."""
    yield "plane wave: largest error of harmonics 1 to 5 over the source's amplitude"
    yield "| harmonics | sigma 0.5 (Fubini) | 0.9 (Fubini) | 1.5 (Blackstock) | 3 (Blackstock) |"
    yield "|---:|---:|---:|---:|---:|"
    for harmonics in (16, 32, 64, 128):
        cells = []
        for sigma in (0.5, 0.9, 1.5, 3.0):
            start = np.zeros((1, harmonics), dtype=np.complex128)
            start[0, 0] = -1e6j
            way_m = sigma * 1000 * SPEED**3 / (4.0 * 2 * np.pi * FREQUENCY_HZ * 1e6)
            found = np.abs(advance(start, way_m, FREQUENCY_HZ, LOSSLESS)[0][0, :5]) / 1e6
            cells.append(f"{np.abs(found - np.abs(blackstock(sigma, 5))).max():.1e}")
        yield f"| {harmonics} | " + " | ".join(cells) + " |"


def linear_limit() -> Iterator[str]:
    """Yield the linear limit's error on the axis, from 20 mm before the focus to 10 mm behind, over the focus."""
    beam = nonlinear_beam(BOWL, [LOSSLESS], FREQUENCY_HZ, 1.0, Accuracy(harmonics=4))
    there = (beam.depth_m > 50e-3) & (beam.depth_m < 80e-3)
    axial_m = beam.depth_m[there] - BOWL.focal_length_m
    exact = bowl_pressure(BOWL, 2 * np.pi * FREQUENCY_HZ / SPEED + 0j, np.zeros(1), axial_m)[:, 0]
    error = np.abs(np.abs(beam.harmonic_pa[there, 0]) - np.abs(exact)).max() / np.abs(exact).max()
    yield f"linear limit against the Rayleigh integral (O'Neil's axis): {error:.1e} of the focus, {there.sum()} places"


def second_harmonic() -> Iterator[str]:
    """Yield the second harmonic of a weak beam against Green's integral over the linear field, on the axis."""
    yield "second harmonic of a weak beam on the axis, its difference from Green's integral over the focus' value:"
    source_pa, k = 100.0, 2 * np.pi * FREQUENCY_HZ / SPEED
    # Both from 15 mm before the bowl's middle on: Green's integral needs the field in front of the rim alone.
    linear = replace(LOSSLESS, thickness_m=15e-3, nonlinearity=1e-9)
    beam = nonlinear_beam(BOWL, [linear, LOSSLESS], FREQUENCY_HZ, source_pa, Accuracy(4, 0.02, 0.1e-3))
    lateral_m, across = np.polynomial.legendre.leggauss(500)
    lateral_m, across = 12e-3 * (lateral_m + 1), 12e-3 * across
    axial_m = np.arange(-55e-3, 12e-3, 40e-6)
    field = source_pa * bowl_pressure(BOWL, k + 0j, lateral_m, axial_m + 20e-6)
    # (grad^2 + (2k)^2) p_2 = beta (2w)^2 / (2 rho c^4) p_1^2
    strength = 4.0 * (2 * 2 * np.pi * FREQUENCY_HZ) ** 2 / (2 * 1000 * SPEED**4)
    for at_m in (-8e-3, -4e-3, -2e-3, 0.0, 2e-3, 4e-3):
        distance_m = np.hypot(lateral_m, axial_m[:, None] + 20e-6 - at_m)
        green = np.exp(-2j * k * distance_m) / (4 * np.pi * distance_m)
        exact = strength * (field**2 * green) @ (2 * np.pi * lateral_m * across) * 40e-6
        found = np.interp(at_m + BOWL.focal_length_m, beam.depth_m, np.abs(beam.harmonic_pa[:, 1]))
        focus = np.abs(beam.harmonic_pa[:, 1]).max()
        yield f"  {at_m * 1e3:+.0f} mm: {100 * (found - abs(exact.sum())) / focus:+.2f} % of {focus * 1e-6:.3g} MPa"


AXIS = (
    (10.9, 1.087, 0.954),
    (12.3, 1.746, 1.418),
    (13.5, 2.302, 2.317),
    (14.0, 5.644, 3.402),
    (14.5, 13.996, 3.809),
    (14.7, 20.751, 3.820),
    (15.0, 20.765, 3.733),
    (15.5, 16.716, 3.395),
    (16.0, 9.994, 2.867),
)
"""Depth in cm, p+ and p- in MPa: the figure on page 21 of the manual of HITU Simulator 2.0 (J. E. Soneson, US Food and
Drug Administration, 2019), whose curves are vectors of 1000 points."""
AXIS_LARGEST = 21.15, 3.82


def published_axis() -> Iterator[str]:
    """Yield p+ and p- along the axis of a published beam: HITU Simulator's.

    The case is that of Yuldashev and Khokhlova, Acoust. Phys. 57 (2011), p. 334.
    """
    yield "HITU Simulator 2.0, manual, page 21: bowl of 8.2 cm, focus at 15 cm, 1.7 MHz, 40 W, water; p+ and p- in MPa"
    finer = Accuracy(24, 0.02), Accuracy(64, 0.02)
    beams = [_published_beam(each) for each in finer]
    peaks = [beam.extremes_pa() for beam in beams]
    yield "| z (cm) | p+ published | 24 harmonics | 64 | p- published | 24 harmonics | 64 |"
    yield "|---:|---:|---:|---:|---:|---:|---:|"
    for depth_cm, *known in AXIS:
        found = [
            [np.interp(depth_cm * 1e-2, beam.depth_m, each) for each in peak]
            for beam, peak in zip(beams, peaks, strict=True)
        ]
        yield f"| {depth_cm:.1f} | {_beside(known, found)} |"
    # the edge of the bowl is no part of the figure
    far = [beam.depth_m > 0.1 for beam in beams]
    found = [[each[own].max() for each in peak] for own, peak in zip(far, peaks, strict=True)]
    yield f"| largest | {_beside(AXIS_LARGEST, found)} |"


def _published_beam(accuracy: Accuracy, share: float = 1.0) -> Beam:
    bowl = Transducer(diameter_m=82e-3, focal_length_m=150e-3)
    cap_m2 = 2 * np.pi * 0.15 * (0.15 - np.sqrt(0.15**2 - 0.041**2))
    liquid = Layer(np.inf, 1500.0, 1000.0, 3.5, 0.00217, 2.0)
    surface_pa = float(np.sqrt(2 * liquid.impedance * 40 / cap_m2))
    return nonlinear_beam(bowl, [liquid], 1.7e6, share * surface_pa, accuracy)


def published_differences() -> Iterator[str]:
    """Yield what p+ of that beam changes by, of what that program is known to do otherwise; its figure has p+ so."""
    # The power of its source is the integral of |p|^2 / 2 rho c over a plane, of p ~ 1 / distance from the focus.
    plane_m2 = np.pi * 0.15**2 * np.log(0.15**2 / (0.15**2 - 0.041**2))
    share = float(np.sqrt(2 * np.pi * 0.15 * (0.15 - np.sqrt(0.15**2 - 0.041**2)) / plane_m2))
    cases: tuple[tuple[str, int, float, int], ...] = (
        ("this program, 64 harmonics", 64, 1.0, 0),
        ("128 harmonics", 128, 1.0, 0),
        (f"64 harmonics, {share:.4f} of the pressure at the source", 64, share, 0),
        ("and a first-order step in time, 1024 samples a period", 64, share, 1024),
        ("the same, 256 samples", 64, share, 256),
    )
    yield "| p+ (MPa) | 13.5 cm | 14 cm | 14.5 cm | 15 cm | largest |"
    yield "|---|---:|---:|---:|---:|---:|"
    depths_m = np.array([0.135, 0.14, 0.145, 0.15])
    for name, harmonics, part, samples in cases:
        with _first_order(samples) if samples else nullcontext():
            beam = _published_beam(Accuracy(harmonics, 0.02, 0.1e-3), part)
        high_pa = beam.extremes_pa()[0]
        shown = [*np.interp(depths_m, beam.depth_m, high_pa), high_pa[beam.depth_m > 0.1].max()]
        yield f"| {name} | " + " | ".join(f"{each * 1e-6:.2f}" for each in shown) + " |"
    yield "| published | 2.30 | 5.64 | 14.00 | 20.77 | 21.15 |"


@contextmanager
def _first_order(samples: int) -> Iterator[None]:
    """Let beams steepen by upwind differences of first order in time, ``samples`` a period, as that program does."""
    march = sys.modules[nonlinear_beam.__module__]

    def steepen(
        pressure_pa: np.ndarray, step_m: float, frequency_hz: float, layer: Layer
    ) -> tuple[np.ndarray, np.ndarray]:
        harmonics = pressure_pa.shape[1]
        spectrum = np.zeros((len(pressure_pa), samples // 2 + 1), dtype=np.complex128)
        spectrum[:, 1 : harmonics + 1] = pressure_pa * (samples / 2)
        wave = np.fft.irfft(spectrum, samples, axis=1)
        rate = layer.nonlinearity / (2 * layer.density_kg_per_m3 * layer.sound_speed_m_per_s**3)
        share = rate * step_m * frequency_hz * samples
        steps = int(np.ceil(2 * share * np.abs(wave).max() / 0.9))
        for _ in range(steps):
            square = wave**2
            rise = np.where(wave < 0, square - np.roll(square, 1, axis=1), np.roll(square, -1, axis=1) - square)
            wave = wave + share / steps * rise
        return np.fft.rfft(wave, axis=1)[:, 1 : harmonics + 1] * (2 / samples), np.zeros(len(wave))

    march.advance = steepen  # type: ignore[attr-defined]
    try:
        yield
    finally:
        march.advance = advance  # type: ignore[attr-defined]


def _beside(known_mpa: Sequence[float], found_pa: Sequence[Sequence[float]]) -> str:
    """Return cells: what is known, then what each beam has, first of p+ and then of p-."""
    rows = zip(known_mpa, zip(*found_pa, strict=True), strict=True)
    return " | ".join(f"{known:.2f} | " + " | ".join(f"{each * 1e-6:.2f}" for each in own) for known, own in rows)


def published_focus() -> Iterator[str]:
    """Yield the focus of the beam of Canney and others (J. Acoust. Soc. Am. 124, 2008, p. 2406), in water."""
    yield "Canney and others 2008: 2 MHz, aperture and focal length 44 mm, water; p+ to 80, p- to 15 MPa at 24 kW/cm2"
    bowl = Transducer(diameter_m=44e-3, focal_length_m=44e-3)
    water = Layer(np.inf, 1486.0, 998.0, 3.5, 0.0022, 2.0)
    yield "| surface (kPa) | p+ (MPa) | p- (MPa) | intensity (kW/cm2) | s |"
    yield "|---:|---:|---:|---:|---:|"
    for surface_pa in (100e3, 200e3, 300e3, 400e3, 450e3):
        start = time.process_time()
        beam = nonlinear_beam(bowl, [water], 2e6, surface_pa, Accuracy(48))
        high_pa, low_pa = (each.max() * 1e-6 for each in beam.extremes_pa())
        intensity = beam.intensity_w_per_m2().max() * 1e-7
        seconds = time.process_time() - start
        yield f"| {surface_pa * 1e-3:.0f} | {high_pa:.1f} | {low_pa:.1f} | {intensity:.1f} | {seconds:.0f} |"


def accuracy() -> Iterator[str]:
    """Yield what harmonics and steps do to the force and the peaks in muscle, against the finest."""
    yield "muscle, 0.28 MPa at the surface: difference from the finest, against processor time"
    yield "| harmonics | step | least step (mm) | force | p+ | p- | s |"
    yield "|---:|---:|---:|---:|---:|---:|---:|"
    layers = path(SPECIMEN, Propagation(), SPEED, 70e-3)
    finest: list[float] = []
    finer = (64, 0.015, 0.1e-3), (32, 0.03, 0.2e-3), (24, 0.03, 0.2e-3), (24, 0.06, 0.2e-3)
    for harmonics, step, least_m in (*finer, (24, 0.06, 0.4e-3), (16, 0.06, 0.2e-3), (12, 0.06, 0.4e-3)):
        start = time.process_time()
        beam = nonlinear_beam(BOWL, layers, FREQUENCY_HZ, 0.28e6, Accuracy(harmonics, step, least_m))
        seconds = time.process_time() - start
        high_pa, low_pa = beam.extremes_pa()
        each = [equivalent_force(beam, 70e-3, BEAMS.excitation_width_m, layers[0].thickness_m)]
        each += [float(high_pa.max()), float(low_pa.max())]
        finest = finest or each
        cells = " | ".join(f"{100 * (one / best - 1):+.1f} %" for one, best in zip(each, finest, strict=True))
        yield f"| {harmonics} | {step:g} | {least_m * 1e3:g} | {cells} | {seconds:.1f} |"


def water() -> Iterator[str]:
    """Yield the output in water over a linear wave's, by the distortion of that wave at the focus (IEC 61949)."""
    yield "output in water over a linear wave's; diameter and focus in mm, carrier in MHz"
    yield "| bowl | distortion | I_sppa | p- | p+ |"
    yield "|---|---:|---:|---:|---:|"
    for diameter_m, focus_m, carrier_hz in ((45e-3, 70e-3, 3e6), (20e-3, 60e-3, 3e6), (45e-3, 50e-3, 2e6)):
        beams = Beams(transducer=Transducer(diameter_m=diameter_m, focal_length_m=focus_m), focus_depth_m=focus_m)
        settings = SimulationSettings(specimen=SPECIMEN, beams=beams, propagation=Propagation(specimen_depth_m=5e-3))
        width_m = 1.03 / 2.3548 * SPEED / carrier_hz * focus_m / diameter_m
        weak = water_output(settings, 1e3, carrier_hz)
        for distortion in (0.02, 0.04, 0.07, 0.10, 0.14, 0.20, 0.28, 0.39):
            one = focal_distortion(weak.sppa_w_per_m2, carrier_hz, focus_m, diameter_m, width_m, SPEED)
            more = distortion / one
            here = water_output(settings, 1e3 * more, carrier_hz)
            over = (
                here.sppa_w_per_m2 / weak.sppa_w_per_m2 / more**2,
                here.negative_pa / weak.negative_pa / more,
                here.positive_pa / weak.positive_pa / more,
            )
            cells = " | ".join(f"{100 * (each - 1):+.0f} %" for each in over)
            bowl = f"{diameter_m * 1e3:g}, {focus_m * 1e3:g}, {carrier_hz * 1e-6:g}"
            yield f"| {bowl} | {distortion:.2f} | {cells} |"


def drive() -> Iterator[str]:
    """Yield the push in muscle over drive squared, 1 being the scenes' 2.2 MN/m^3."""
    settings = SimulationSettings(specimen=SPECIMEN, beams=BEAMS, propagation=Propagation())
    push = push_of(settings)
    if push is None:
        return
    at_pa = push.surface_for(SPECIMEN.force_density_n_per_m3)
    yield f"muscle: the reference drive is {at_pa * 1e-3:.0f} kPa at the surface"
    yield "V^2; force over the linear one; d ln force / d ln V^2; peaks in MPa; I_sppa in W/cm2; largest force in MN/m3"
    yield "| V^2 | force | exponent | p+ | p- | I_sppa | largest |"
    yield "|---:|---:|---:|---:|---:|---:|---:|"
    squares = np.array([0.01, 0.04, 0.09, 0.16, 0.25, 0.36, 0.49, 0.64, 0.81, 1.0])
    force = push.relative_force(np.sqrt(squares), SPECIMEN.force_density_n_per_m3)
    here = push.at(np.sqrt(squares) * at_pa)
    columns = here.positive_pa, here.negative_pa, here.sppa_w_per_m2, here.peak_force_n_per_m3
    gain = force / squares / (force[0] / squares[0])
    for square, share, over, *other in zip(squares, force, gain, *columns, strict=True):
        exponent = push.exponent(float(share) * SPECIMEN.force_density_n_per_m3)
        yield (
            f"| {square:.2f} | {over:.2f} | {exponent:.2f} | {other[0] * 1e-6:.1f} | {other[1] * 1e-6:.1f} | "
            f"{other[2] * 1e-4:.0f} | {other[3] * 1e-6:.2f} |"
        )


def frequencies() -> Iterator[str]:
    """Yield the force over drive by what it moves at a frequency: where shocks form it is nearer to the focus."""
    layers = path(SPECIMEN, Propagation(), SPEED, 70e-3)
    squares = np.array([0.01, 0.09, 0.25, 0.36, 0.49, 0.64, 0.81, 1.0])
    beams = [nonlinear_beam(BOWL, layers, FREQUENCY_HZ, 283e3 * each**0.5, Accuracy(24)) for each in squares]
    at_hz = 0.0, 100.0, 200.0, 400.0, 1000.0
    force = {hz: np.array([moving(beam, layers[0].thickness_m, hz) for beam in beams]) for hz in at_hz}
    yield "muscle, 283 kPa at V^2 = 1: force over the linear one, by what it moves at the focus"
    yield f"| V^2 | {' | '.join(f'{hz:g} Hz' for hz in at_hz)} |"
    yield f"|{'---:|' * (len(at_hz) + 1)}"
    gains = [force[hz] / squares / (force[hz][0] / squares[0]) for hz in at_hz]
    for square, *row in zip(squares, *gains, strict=True):
        yield f"| {square:.2f} | " + " | ".join(f"{each:.2f}" for each in row) + " |"
    steepest = [f"{(np.diff(np.log(each)) / np.diff(np.log(squares))).max():.2f}" for each in force.values()]
    yield f"| largest exponent | {' | '.join(steepest)} |"
    shares = np.array(load_scene("muscle-force").excitation.force_fraction)  # type: ignore[union-attr]
    for count in (9, 11, 13):
        top = np.sort(shares)[-count:]
        offsets = []
        for each in force.values():
            gain = PchipInterpolator(np.log(squares), np.log(each / squares))
            slope, offset = np.polyfit(top, top * np.exp(gain(np.log(top))), 1)
            offsets.append(f"{offset / slope:.2f}")
        yield f"| offset over slope, highest {count} of Fig. 15 | {' | '.join(offsets)} |"


def moving(beam: Beam, start_m: float, frequency_hz: float) -> float:
    """Return the force density of a Gaussian of the push beam that moves the focus as far at ``frequency_hz``.

    What a point force along z moves at a distance R in an incompressible Voigt medium (Stokes 1851, by correspondence):
    ``(A + B z^2 / R^2) / (4 pi mu R)``, A and B of ``x = j w R sqrt(rho / mu)``, both 1/2 at rest (Kelvin).
    """
    depth_m, lateral_m, volume_m3, force = beam.force_at[:, beam.force_at[0] > start_m]
    omega, z = 2 * np.pi * frequency_hz, depth_m - BOWL.focal_length_m
    distance_m = np.hypot(lateral_m, z)
    near = far = np.full(len(z), 0.5 + 0j)
    if omega:
        modulus_pa = SPECIMEN.shear_modulus_pa + 1j * omega * SPECIMEN.shear_viscosity_pa_s
        x = 1j * omega * np.sqrt(SPECIMEN.density_kg_per_m3 / modulus_pa) * distance_m
        near = np.exp(-x) * (1 + 1 / x + 1 / x**2) - 1 / x**2
        far = 3 / x**2 - np.exp(-x) * (1 + 3 / x + 3 / x**2)
    moved = volume_m3 * (near + far * (z / distance_m) ** 2) / distance_m
    wide_m, _, along_m = BEAMS.excitation_width_m
    gaussian = np.exp(-0.5 * ((lateral_m / wide_m) ** 2 + (z / along_m) ** 2))
    return float(abs((moved * force).sum() / (moved * gaussian).sum()))


if __name__ == "__main__":
    main()
