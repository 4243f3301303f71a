"""Errors and run times of nonlinear propagation, comparison with published beams, and the push over drive.

Tables: plane waves (Fubini, Blackstock); the bowl in its linear limit (Rayleigh integral) and its second harmonic
(Green's integral over the linear field); a published curve along the axis and a published focus; error against run
time; output in water relative to a linear wave; force, pressures and exponent over drive in the muscle of the twin, and
the displacement by the same force field at several frequencies. Times are processor times, comparable within one run.
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
    """Print all tables, or the named ones."""
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
    names = [table.__name__ for table in tables]
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("table", nargs="*", help=f"one of {', '.join(names)}")
    selected = parser.parse_args().table
    if unknown := set(selected) - set(names):
        parser.error(f"no table is called {', '.join(sorted(unknown))}: try one of {', '.join(names)}")
    for table in tables:
        if not selected or table.__name__ in selected:
            for line in table():
                print(line, flush=True)
            print()


def blackstock(sigma: float, count: int) -> np.ndarray:
    """Return the harmonics of an initially sinusoidal plane wave relative to the source, by weak shock theory (1966).

    ``B_n = 2 / (n pi) sin(x_s) + 2 / (n pi sigma) int_(x_s)^pi cos(n (x - sigma sin x)) dx`` with the shock at
    ``x_s = sigma sin(x_s)``; without one, x_s = 0, it is Fubini's series 2 J_n(n sigma) / (n sigma).
    """
    n = np.arange(1, count + 1)
    if sigma <= 1:
        return 2 * jv(n, n * sigma) / (n * sigma)
    # Newton iteration for the shock phase x_s, then the integral over the continuous part by Gauss quadrature.
    shock = np.pi
    for _ in range(500):
        shock = shock - (shock - sigma * np.sin(shock)) / (1 - sigma * np.cos(shock))
    node, weight = np.polynomial.legendre.leggauss(400)
    x = shock + (np.pi - shock) * (node + 1) / 2
    waves = np.cos(n[:, None] * (x - sigma * np.sin(x))) @ weight * (np.pi - shock) / 2
    return 2 / (n * np.pi) * np.sin(shock) + 2 / (n * np.pi * sigma) * waves


def plane_waves() -> Iterator[str]:
    """Yield the error of the first five harmonics of a plane wave, relative to the source."""
    yield "plane wave: largest error of harmonics 1 to 5 relative to the amplitude of the source"
    yield "| harmonics | sigma 0.5 (Fubini) | 0.9 (Fubini) | 1.5 (Blackstock) | 3 (Blackstock) |"
    yield "|---:|---:|---:|---:|---:|"
    for harmonics in (16, 32, 64, 128):
        cells = []
        for sigma in (0.5, 0.9, 1.5, 3.0):
            # A sinusoidal source of 1 MPa.
            start = np.zeros((1, harmonics), dtype=np.complex128)
            start[0, 0] = -1e6j
            # Distance for the normalised distance sigma of the shock formation.
            distance_m = sigma * 1000 * SPEED**3 / (4.0 * 2 * np.pi * FREQUENCY_HZ * 1e6)
            harmonic = np.abs(advance(start, distance_m, FREQUENCY_HZ, LOSSLESS)[0][0, :5]) / 1e6
            cells.append(f"{np.abs(harmonic - np.abs(blackstock(sigma, 5))).max():.1e}")
        yield f"| {harmonics} | " + " | ".join(cells) + " |"


def linear_limit() -> Iterator[str]:
    """Yield the error of the linear limit on the axis, from 20 mm in front of the focus to 10 mm behind it."""
    beam = nonlinear_beam(BOWL, [LOSSLESS], FREQUENCY_HZ, 1.0, Accuracy(harmonics=4))
    near_focus = (beam.depth_m > 50e-3) & (beam.depth_m < 80e-3)
    axial_m = beam.depth_m[near_focus] - BOWL.focal_length_m
    exact = bowl_pressure(BOWL, 2 * np.pi * FREQUENCY_HZ / SPEED + 0j, np.zeros(1), axial_m)[:, 0]
    error = np.abs(np.abs(beam.harmonic_pa[near_focus, 0]) - np.abs(exact)).max() / np.abs(exact).max()
    depths = near_focus.sum()
    yield f"linear limit against the Rayleigh integral (O'Neil's axis): {error:.1e} of the focus, {depths} depths"


def second_harmonic() -> Iterator[str]:
    """Compare the second harmonic of a weak beam on the axis with Green's integral over the linear field."""
    yield "second harmonic of a weak beam on the axis: difference from Green's integral, relative to the focus"
    source_pa, k = 100.0, 2 * np.pi * FREQUENCY_HZ / SPEED
    # Both start 15 mm from the centre of the bowl: Green's integral covers only the field beyond the rim.
    linear = replace(LOSSLESS, thickness_m=15e-3, nonlinearity=1e-9)
    beam = nonlinear_beam(BOWL, [linear, LOSSLESS], FREQUENCY_HZ, source_pa, Accuracy(4, 0.02, 0.1e-3))
    lateral_m, across = np.polynomial.legendre.leggauss(500)
    lateral_m, across = 12e-3 * (lateral_m + 1), 12e-3 * across
    axial_m = np.arange(-55e-3, 12e-3, 40e-6)
    field = source_pa * bowl_pressure(BOWL, k + 0j, lateral_m, axial_m + 20e-6)
    # (grad^2 + (2k)^2) p_2 = beta (2w)^2 / (2 rho c^4) p_1^2
    strength = 4.0 * (2 * 2 * np.pi * FREQUENCY_HZ) ** 2 / (2 * 1000 * SPEED**4)
    for depth_m in (-8e-3, -4e-3, -2e-3, 0.0, 2e-3, 4e-3):
        distance_m = np.hypot(lateral_m, axial_m[:, None] + 20e-6 - depth_m)
        green = np.exp(-2j * k * distance_m) / (4 * np.pi * distance_m)
        exact = strength * (field**2 * green) @ (2 * np.pi * lateral_m * across) * 40e-6
        value = np.interp(depth_m + BOWL.focal_length_m, beam.depth_m, np.abs(beam.harmonic_pa[:, 1]))
        focus = np.abs(beam.harmonic_pa[:, 1]).max()
        yield f"  {depth_m * 1e3:+.0f} mm: {100 * (value - abs(exact.sum())) / focus:+.2f} % of {focus * 1e-6:.3g} MPa"


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
"""Depth in cm, p+ and p- in MPa, from the figure on page 21 of the manual of HITU Simulator 2.0 (J. E. Soneson, US Food
and Drug Administration, 2019); its curves are vector graphics of 1000 points."""
AXIS_LARGEST = 21.15, 3.82


def published_axis() -> Iterator[str]:
    """Compare p+ and p- along the axis with the beam published for HITU Simulator.

    The case is that of Yuldashev and Khokhlova, Acoust. Phys. 57 (2011), p. 334.
    """
    yield "HITU Simulator 2.0, manual, page 21: bowl of 8.2 cm, focus at 15 cm, 1.7 MHz, 40 W, water; p+ and p- in MPa"
    beams = [_published_beam(Accuracy(harmonics, 0.02)) for harmonics in (24, 64)]
    peaks = [beam.extremes_pa() for beam in beams]
    yield "| z (cm) | p+ published | 24 harmonics | 64 | p- published | 24 harmonics | 64 |"
    yield "|---:|---:|---:|---:|---:|---:|---:|"
    for depth_cm, *published in AXIS:
        computed = [
            [np.interp(depth_cm * 1e-2, beam.depth_m, peak_pa) for peak_pa in peak]
            for beam, peak in zip(beams, peaks, strict=True)
        ]
        yield f"| {depth_cm:.1f} | {_cells(published, computed)} |"
    # The figure does not show depths near the rim of the bowl.
    beyond_rim = [beam.depth_m > 0.1 for beam in beams]
    computed = [[peak_pa[mask].max() for peak_pa in peak] for mask, peak in zip(beyond_rim, peaks, strict=True)]
    yield f"| largest | {_cells(AXIS_LARGEST, computed)} |"


def _published_beam(accuracy: Accuracy, pressure_scale: float = 1.0) -> Beam:
    bowl = Transducer(diameter_m=82e-3, focal_length_m=150e-3)
    # Uniform pressure over the spherical cap for 40 W.
    cap_m2 = 2 * np.pi * 0.15 * (0.15 - np.sqrt(0.15**2 - 0.041**2))
    liquid = Layer(np.inf, 1500.0, 1000.0, 3.5, 0.00217, 2.0)
    surface_pa = float(np.sqrt(2 * liquid.impedance * 40 / cap_m2))
    return nonlinear_beam(bowl, [liquid], 1.7e6, pressure_scale * surface_pa, accuracy)


def published_differences() -> Iterator[str]:
    """Yield p+ of the published beam with the known differences between HITU Simulator and this program."""
    # HITU Simulator integrates |p|^2 / (2 rho c) over a plane, with p proportional to 1 / distance from the focus.
    plane_m2 = np.pi * 0.15**2 * np.log(0.15**2 / (0.15**2 - 0.041**2))
    scale = float(np.sqrt(2 * np.pi * 0.15 * (0.15 - np.sqrt(0.15**2 - 0.041**2)) / plane_m2))
    cases: tuple[tuple[str, int, float, int], ...] = (
        ("this program, 64 harmonics", 64, 1.0, 0),
        ("128 harmonics", 128, 1.0, 0),
        (f"64 harmonics, {scale:.4f} of the pressure at the source", 64, scale, 0),
        ("also a first-order step in time, 1024 samples per period", 64, scale, 1024),
        ("also a first-order step in time, 256 samples per period", 64, scale, 256),
    )
    yield "| p+ (MPa) | 13.5 cm | 14 cm | 14.5 cm | 15 cm | largest |"
    yield "|---|---:|---:|---:|---:|---:|"
    depths_m = np.array([0.135, 0.14, 0.145, 0.15])
    for name, harmonics, pressure_scale, samples in cases:
        with _first_order(samples) if samples else nullcontext():
            beam = _published_beam(Accuracy(harmonics, 0.02, 0.1e-3), pressure_scale)
        high_pa = beam.extremes_pa()[0]
        row_pa = [*np.interp(depths_m, beam.depth_m, high_pa), high_pa[beam.depth_m > 0.1].max()]
        yield f"| {name} | " + " | ".join(f"{pressure_pa * 1e-6:.2f}" for pressure_pa in row_pa) + " |"
    yield "| published | 2.30 | 5.64 | 14.00 | 20.77 | 21.15 |"


@contextmanager
def _first_order(samples: int) -> Iterator[None]:
    """Replace the steepening step by first-order upwind differences in time, as in HITU Simulator."""
    march = sys.modules[nonlinear_beam.__module__]

    def steepen(
        pressure_pa: np.ndarray, step_m: float, frequency_hz: float, layer: Layer
    ) -> tuple[np.ndarray, np.ndarray]:
        # The waveform in time from its harmonics.
        harmonics = pressure_pa.shape[1]
        spectrum = np.zeros((len(pressure_pa), samples // 2 + 1), dtype=np.complex128)
        spectrum[:, 1 : harmonics + 1] = pressure_pa * (samples / 2)
        wave = np.fft.irfft(spectrum, samples, axis=1)
        rate = layer.nonlinearity / (2 * layer.density_kg_per_m3 * layer.sound_speed_m_per_s**3)
        courant = rate * step_m * frequency_hz * samples
        steps = int(np.ceil(2 * courant * np.abs(wave).max() / 0.9))
        for _ in range(steps):
            square = wave**2
            # Upwind differences of the Burgers equation in conservative form.
            rise = np.where(wave < 0, square - np.roll(square, 1, axis=1), np.roll(square, -1, axis=1) - square)
            wave = wave + courant / steps * rise
        return np.fft.rfft(wave, axis=1)[:, 1 : harmonics + 1] * (2 / samples), np.zeros(len(wave))

    march.advance = steepen  # type: ignore[attr-defined]
    try:
        yield
    finally:
        march.advance = advance  # type: ignore[attr-defined]


def _cells(published_mpa: Sequence[float], computed_pa: Sequence[Sequence[float]]) -> str:
    """Return table cells: the published value and that of each beam, for p+ and then p-."""
    rows = zip(published_mpa, *computed_pa, strict=True)
    return " | ".join(
        " | ".join([f"{published:.2f}", *(f"{value_pa * 1e-6:.2f}" for value_pa in values_pa)])
        for published, *values_pa in rows
    )


def published_focus() -> Iterator[str]:
    """Compare with the focus of the beam of Canney and others in water (J. Acoust. Soc. Am. 124, 2008, p. 2406)."""
    yield "Canney and others 2008: 2 MHz, aperture and focal length 44 mm, water; p+ to 80, p- to 15 MPa at 24 kW/cm2"
    bowl = Transducer(diameter_m=44e-3, focal_length_m=44e-3)
    water = Layer(np.inf, 1486.0, 998.0, 3.5, 0.0022, 2.0)
    yield "| surface (kPa) | p+ (MPa) | p- (MPa) | intensity (kW/cm2) | s |"
    yield "|---:|---:|---:|---:|---:|"
    for surface_pa in (100e3, 200e3, 300e3, 400e3, 450e3):
        start = time.process_time()
        beam = nonlinear_beam(bowl, [water], 2e6, surface_pa, Accuracy(48))
        high_pa, low_pa = (peak_pa.max() * 1e-6 for peak_pa in beam.extremes_pa())
        intensity = beam.intensity_w_per_m2().max() * 1e-7
        seconds = time.process_time() - start
        yield f"| {surface_pa * 1e-3:.0f} | {high_pa:.1f} | {low_pa:.1f} | {intensity:.1f} | {seconds:.0f} |"


def accuracy() -> Iterator[str]:
    """Yield the error of force and peaks in muscle by harmonics and step, relative to the finest setting."""
    yield "muscle, 0.28 MPa at the surface: difference from the finest setting, and processor time"
    yield "| harmonics | step | least step (mm) | force | p+ | p- | s |"
    yield "|---:|---:|---:|---:|---:|---:|---:|"
    layers = path(SPECIMEN, Propagation(), SPEED, 70e-3)
    finest: list[float] = []
    fine_settings = (64, 0.015, 0.1e-3), (32, 0.03, 0.2e-3), (24, 0.03, 0.2e-3), (24, 0.06, 0.2e-3)
    for harmonics, step, least_m in (*fine_settings, (24, 0.06, 0.4e-3), (16, 0.06, 0.2e-3), (12, 0.06, 0.4e-3)):
        start = time.process_time()
        beam = nonlinear_beam(BOWL, layers, FREQUENCY_HZ, 0.28e6, Accuracy(harmonics, step, least_m))
        seconds = time.process_time() - start
        high_pa, low_pa = beam.extremes_pa()
        values = [equivalent_force(beam, 70e-3, BEAMS.excitation_width_m, layers[0].thickness_m)]
        values += [float(high_pa.max()), float(low_pa.max())]
        finest = finest or values
        cells = " | ".join(f"{100 * (value / best - 1):+.1f} %" for value, best in zip(values, finest, strict=True))
        yield f"| {harmonics} | {step:g} | {least_m * 1e3:g} | {cells} | {seconds:.1f} |"


def water() -> Iterator[str]:
    """Yield the output in water relative to a linear wave, by its distortion at the focus (IEC 61949)."""
    yield "output in water relative to a linear wave; diameter and focus in mm, carrier in MHz"
    yield "| bowl | distortion | I_sppa | p- | p+ |"
    yield "|---|---:|---:|---:|---:|"
    for diameter_m, focus_m, carrier_hz in ((45e-3, 70e-3, 3e6), (20e-3, 60e-3, 3e6), (45e-3, 50e-3, 2e6)):
        beams = Beams(transducer=Transducer(diameter_m=diameter_m, focal_length_m=focus_m), focus_depth_m=focus_m)
        settings = SimulationSettings(specimen=SPECIMEN, beams=beams, propagation=Propagation(specimen_depth_m=5e-3))
        width_m = 1.03 / 2.3548 * SPEED / carrier_hz * focus_m / diameter_m
        # The linear reference: a wave of 1 kPa at the surface.
        weak = water_output(settings, 1e3, carrier_hz)
        for distortion in (0.02, 0.04, 0.07, 0.10, 0.14, 0.20, 0.28, 0.39):
            weak_distortion = focal_distortion(weak.sppa_w_per_m2, carrier_hz, focus_m, diameter_m, width_m, SPEED)
            scale = distortion / weak_distortion
            output = water_output(settings, 1e3 * scale, carrier_hz)
            ratios = (
                output.sppa_w_per_m2 / weak.sppa_w_per_m2 / scale**2,
                output.negative_pa / weak.negative_pa / scale,
                output.positive_pa / weak.positive_pa / scale,
            )
            cells = " | ".join(f"{100 * (ratio - 1):+.0f} %" for ratio in ratios)
            bowl = f"{diameter_m * 1e3:g}, {focus_m * 1e3:g}, {carrier_hz * 1e-6:g}"
            yield f"| {bowl} | {distortion:.2f} | {cells} |"


def drive() -> Iterator[str]:
    """Yield the push in muscle over drive squared; 1 corresponds to the 2.2 MN/m^3 of the scenes."""
    settings = SimulationSettings(specimen=SPECIMEN, beams=BEAMS, propagation=Propagation())
    push = push_of(settings)
    if push is None:
        return
    surface_pa = push.surface_for(SPECIMEN.force_density_n_per_m3)
    yield f"muscle: the reference drive is {surface_pa * 1e-3:.0f} kPa at the surface"
    yield "force relative to linear; d ln force / d ln V^2; peaks in MPa; I_sppa in W/cm2; largest force in MN/m3"
    yield "| V^2 | force | exponent | p+ | p- | I_sppa | largest |"
    yield "|---:|---:|---:|---:|---:|---:|---:|"
    squares = np.array([0.01, 0.04, 0.09, 0.16, 0.25, 0.36, 0.49, 0.64, 0.81, 1.0])
    force = push.relative_force(np.sqrt(squares), SPECIMEN.force_density_n_per_m3)
    output = push.at(np.sqrt(squares) * surface_pa)
    columns = output.positive_pa, output.negative_pa, output.sppa_w_per_m2, output.peak_force_n_per_m3
    # Relative to the weakest drive, which is nearly linear.
    gain = force / squares / (force[0] / squares[0])
    for square, relative_force, gain_at, *values in zip(squares, force, gain, *columns, strict=True):
        exponent = push.exponent(float(relative_force) * SPECIMEN.force_density_n_per_m3)
        yield (
            f"| {square:.2f} | {gain_at:.2f} | {exponent:.2f} | {values[0] * 1e-6:.1f} | {values[1] * 1e-6:.1f} | "
            f"{values[2] * 1e-4:.0f} | {values[3] * 1e-6:.2f} |"
        )


def frequencies() -> Iterator[str]:
    """Yield the force over drive by its displacement of the focus at several frequencies.

    Shocks concentrate the force near the focus, so the ratios depend on frequency.
    """
    layers = path(SPECIMEN, Propagation(), SPEED, 70e-3)
    squares = np.array([0.01, 0.09, 0.25, 0.36, 0.49, 0.64, 0.81, 1.0])
    # One beam per drive; its force field does not depend on the vibration frequency.
    beams = [nonlinear_beam(BOWL, layers, FREQUENCY_HZ, 283e3 * square**0.5, Accuracy(24)) for square in squares]
    frequencies_hz = 0.0, 100.0, 200.0, 400.0, 1000.0
    force = {
        hz: np.array([force_by_displacement(beam, layers[0].thickness_m, hz) for beam in beams])
        for hz in frequencies_hz
    }
    yield "muscle, 283 kPa at V^2 = 1: force relative to linear propagation, by displacement of the focus"
    yield f"| V^2 | {' | '.join(f'{hz:g} Hz' for hz in frequencies_hz)} |"
    yield f"|{'---:|' * (len(frequencies_hz) + 1)}"
    gains = [force[hz] / squares / (force[hz][0] / squares[0]) for hz in frequencies_hz]
    for square, *row in zip(squares, *gains, strict=True):
        yield f"| {square:.2f} | " + " | ".join(f"{gain:.2f}" for gain in row) + " |"
    steepest = [f"{(np.diff(np.log(values)) / np.diff(np.log(squares))).max():.2f}" for values in force.values()]
    yield f"| largest exponent | {' | '.join(steepest)} |"
    fractions = np.array(load_scene("muscle-force").excitation.force_fraction)  # type: ignore[union-attr]
    # Regression lines through the same numbers of points as in the paper.
    for count in (9, 11, 13):
        top = np.sort(fractions)[-count:]
        offsets = []
        for values in force.values():
            gain = PchipInterpolator(np.log(squares), np.log(values / squares))
            slope, offset = np.polyfit(top, top * np.exp(gain(np.log(top))), 1)
            offsets.append(f"{offset / slope:.2f}")
        yield f"| offset over slope, highest {count} of Fig. 15 | {' | '.join(offsets)} |"


def force_by_displacement(beam: Beam, start_m: float, frequency_hz: float) -> float:
    """Return the force density of a Gaussian push beam with the same displacement of the focus at ``frequency_hz``.

    The displacement by a point force along z at a distance R in an incompressible Voigt medium (Stokes 1851, by
    correspondence) is ``(A + B z^2 / R^2) / (4 pi mu R)``, with A and B functions of ``x = j w R sqrt(rho / mu)``. Both
    are 1/2 at zero frequency (Kelvin).
    """
    depth_m, lateral_m, volume_m3, force = beam.force_at[:, beam.force_at[0] > start_m]
    omega, z = 2 * np.pi * frequency_hz, depth_m - BOWL.focal_length_m
    distance_m = np.hypot(lateral_m, z)
    near = far = np.full(len(z), 0.5 + 0j)
    if omega:
        modulus_pa = SPECIMEN.shear_modulus_pa + 1j * omega * SPECIMEN.shear_viscosity_pa_s
        # Dimensionless distance of the shear wave.
        x = 1j * omega * np.sqrt(SPECIMEN.density_kg_per_m3 / modulus_pa) * distance_m
        near = np.exp(-x) * (1 + 1 / x + 1 / x**2) - 1 / x**2
        far = 3 / x**2 - np.exp(-x) * (1 + 3 / x + 3 / x**2)
    green = volume_m3 * (near + far * (z / distance_m) ** 2) / distance_m
    lateral_width_m, _, axial_width_m = BEAMS.excitation_width_m
    # The Gaussian beam of the scene is the reference for the force density.
    gaussian = np.exp(-0.5 * ((lateral_m / lateral_width_m) ** 2 + (z / axial_width_m) ** 2))
    return float(abs((green * force).sum() / (green * gaussian).sum()))


if __name__ == "__main__":
    main()
