"""Closed forms and quadratures: spectrum of the radiation force, beam averaging of a Gaussian motion.

Derivations and what supports them: docs/theory/prediction.md.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from hpe_rig.arrays import ComplexArray, FloatArray, Int64Array
from hpe_rig.processing import Window, hann

Triple = tuple[float, float, float]

DEPTHS = 256
INSTANTS = 96

WATER_DENSITY, WATER_NONLINEARITY = 1000.0, 3.5
"""kg/m^3, and the coefficient beta = 1 + B/2A."""


def echo_power(gate_length_m: float, pulse_length_m: float, tracking_depth_m: float) -> float:
    """Return the mean echo power in a gate around the focus, relative to that at the focus.

    Of a Hann pulse and scatterers weighted by the tracking beam, whose width along the axis is ``tracking_depth_m``.
    """
    places = (np.arange(INSTANTS) + 0.5) / INSTANTS - 0.5
    depth = places * gate_length_m + places[:, None] * pulse_length_m
    blur = np.cos(np.pi * places[:, None]) ** 4
    weight = np.exp(-np.square(depth / tracking_depth_m))
    return float((blur * weight).sum() / (INSTANTS * blur.sum()))


def force_spectrum(
    harmonic: Int64Array | int, burst_rate_hz: float, burst_length_s: float, amplitude: float = 1.0
) -> ComplexArray:
    """Return the complex Fourier coefficients F_n of the force pulse train, time from a burst's onset.

    Shape and order of ``harmonic`` (n, negative ones too), unit of ``amplitude``; the sinusoid at n f_r has the peak
    2 |F_n|. Source: paper eq. (18).
    """
    duty = burst_rate_hz * burst_length_s
    n = np.asarray(harmonic)
    return np.asarray(amplitude * duty * np.sinc(n * duty) * np.exp(-1j * np.pi * n * duty))


def beam_averaging_factor(
    excitation_width_m: Triple,
    tracking_width_m: Triple,
    gate_length_m: float,
    pulse_length_m: float,
    gate_window: Window = "none",
    scatterers_per_m3: float = np.inf,
) -> float:
    """Return the expected tracked over peak displacement for coaxial Gaussian beams with a common focus mid-gate.

    Widths are the sigmas E and T of eqs. (12) and (8). Speckle weights each scatterer by its echo's energy in the
    (windowed) gate: I^2 laterally, factors 1/sqrt(1 + T^2 / (2 E^2)), axially a quadrature with a Hann pulse whose full
    length is ``pulse_length_m``, c/2 times its duration. Two corrections of leading order follow, each below 1 %: the
    gate holds few independent speckles, and few scatterers where ``scatterers_per_m3`` is finite.
    """
    beams = excitation_width_m, tracking_width_m
    depth = _midpoints(gate_length_m + pulse_length_m, DEPTHS)
    echo = _gate_echoes(depth, tracking_width_m, gate_length_m, pulse_length_m, gate_window)
    overlap = (echo.T @ echo) ** 2
    energy = np.sum(echo**2, axis=0)
    speckles = energy.sum() ** 2 / overlap.sum()
    # one speckle: exactly half the correction of a ratio of sums; many: all of it
    mean = _ratio_of_sums(beams, depth, energy, scatterers_per_m3, 1 - 1 / (2 * speckles))
    lateral = _lateral_moment(*beams, 2, 1)
    moved = lateral * _axial_motion(depth, excitation_width_m)
    expected = energy @ moved / energy.sum()
    return float(mean - (overlap.sum(axis=0) @ (moved - expected)) / energy.sum() ** 2)


def gate_energy(
    tracking_width_m: Triple, gate_length_m: float, pulse_length_m: float, gate_window: Window = "none"
) -> tuple[FloatArray, FloatArray]:
    """Return depths about the gate's middle, m, and the energy that each puts into the (windowed) gate, (depth,)."""
    depth = _midpoints(gate_length_m + pulse_length_m, DEPTHS)
    echo = _gate_echoes(depth, tracking_width_m, gate_length_m, pulse_length_m, gate_window)
    return depth, np.sum(echo**2, axis=0)


def carrier_spread(
    tracking_depth_m: float,
    gate_length_m: float,
    pulse_length_m: float,
    wave_number_per_m: float,
    gate_window: Window = "none",
) -> float:
    """Return the standard deviation of the echo's mean frequency in a gate about the carrier, relative to it.

    Of fully developed speckle g, complex normal: the mean is k + g^H B g / g^H A g, A the energy of the gate's echoes
    and B its derivative in depth, k = ``wave_number_per_m`` (4 pi f / c). Its variance is
    int_0^inf t tr(B M B M) / det(1 + t A) dt with M = (1 + t A)^-1, by exp(-t g^H A g) under the mean.
    """
    depth = _midpoints(gate_length_m + pulse_length_m, INSTANTS)
    echo, slope = (
        _gate_echoes(depth, (1.0, 1.0, tracking_depth_m), gate_length_m, pulse_length_m, gate_window, envelope)
        for envelope in (_pulse, _pulse_slope)
    )
    share, turn = np.linalg.eigh(echo.T @ echo)
    derivative = np.square(turn.T @ (echo.T @ slope - slope.T @ echo) @ turn / 2) / share[-1] ** 2
    # the logarithm of t, from where nothing is damped to where all is
    step = 0.125
    t = np.exp(np.arange(-12.0, 40.0, step))[:, None]
    damped = 1 / (1 + t * share.clip(min=0) / share[-1])
    each = np.prod(damped, axis=1) * np.einsum("ti,ij,tj->t", damped, derivative, damped)
    return float(np.sqrt(np.sum(each * t[:, 0] ** 2) * step) / wave_number_per_m)


def focal_distortion(
    intensity_w_per_m2: float,
    carrier_hz: float,
    focus_m: float,
    diameter_m: float,
    width_m: float,
    sound_speed_m_per_s: float,
) -> float:
    """Return the local distortion parameter of IEC 61949, z p 2 pi f beta / (rho c^3 sqrt(F_a)), in water.

    Of an aperture ``diameter_m`` across whose intensity at the focus has the sigma ``width_m``: F_a is 0.69 times
    the source's area over that of the -6 dB beam. p is the pressure of a linear wave of that intensity. Up to 0.5 the
    standard takes a field for nearly linear.
    """
    pressure_pa = np.sqrt(2 * WATER_DENSITY * sound_speed_m_per_s * intensity_w_per_m2)
    beam_m = 2 * width_m * np.sqrt(2 * np.log(4))
    area_ratio = 0.69 * (diameter_m / beam_m) ** 2
    steepening = 2 * np.pi * carrier_hz * WATER_NONLINEARITY / (WATER_DENSITY * sound_speed_m_per_s**3)
    return float(focus_m * pressure_pa * steepening / np.sqrt(area_ratio))


def scatterer_density(tracking_width_m: Triple, per_cell: float) -> float:
    """Return scatterers per m^3 from those in the ellipsoid where the tracking beam is above -6 dB (half its peak)."""
    return float(per_cell / (4 / 3 * np.pi * np.prod(np.asarray(tracking_width_m) * np.sqrt(2 * np.log(2)))))


def _lateral_moment(excitation_width_m: Triple, tracking_width_m: Triple, power: int, order: int) -> float:
    """Return the mean of (u/u_0)^order over x and y under the weight I^power."""
    squares = [(t / e) ** 2 for e, t in zip(excitation_width_m[:2], tracking_width_m[:2], strict=True)]
    return float(np.prod([1 / np.sqrt(1 + order * square / power) for square in squares]))


def _midpoints(length_m: float, count: int) -> FloatArray:
    return (np.arange(count) + 0.5) / count * length_m - length_m / 2


def _pulse(offset_m: FloatArray, pulse_length_m: float) -> FloatArray:
    """Return the Hann pulse's envelope, eq. (9), at a distance from its middle."""
    inside = np.abs(offset_m) < pulse_length_m / 2
    return np.where(inside, np.cos(np.pi * offset_m / pulse_length_m) ** 2, 0.0)


def _pulse_slope(offset_m: FloatArray, pulse_length_m: float) -> FloatArray:
    """Return the derivative of ``_pulse``."""
    inside = np.abs(offset_m) < pulse_length_m / 2
    return np.where(inside, -np.pi / pulse_length_m * np.sin(2 * np.pi * offset_m / pulse_length_m), 0.0)


def _axial_motion(depth: FloatArray, excitation_width_m: Triple) -> FloatArray:
    return np.asarray(np.exp(-(depth**2) / (2 * excitation_width_m[2] ** 2)))


def _gate_echoes(
    depth: FloatArray,
    tracking_width_m: Triple,
    gate_length_m: float,
    pulse_length_m: float,
    window: Window,
    pulse: Callable[[FloatArray, float], FloatArray] = _pulse,
) -> FloatArray:
    """Return the envelope (instant, depth) in the windowed gate of a scatterer on the axis at each depth."""
    envelope = pulse(_midpoints(gate_length_m, INSTANTS)[:, None] - depth, pulse_length_m)
    weight = hann(INSTANTS) if window == "hann" else np.ones(INSTANTS)
    return np.asarray(weight[:, None] * envelope * np.exp(-(depth**2) / (2 * tracking_width_m[2] ** 2)))


def _ratio_of_sums(
    beams: tuple[Triple, Triple], depth: FloatArray, weight: FloatArray, density: float, share: float
) -> float:
    """Return E[sum w u / sum w] over random scatterers with w = weight(z) I^2 across, u = 1 at the focus.

    ``share`` scales the correction for the finite number of scatterers, -sum w^2 (u - mean) / (sum w)^2.
    """
    moved = _axial_motion(depth, beams[0])
    mean = _lateral_moment(*beams, 2, 1) * (weight @ moved) / weight.sum()
    squared = _lateral_moment(*beams, 4, 1) * (weight**2 @ moved) / np.sum(weight**2)
    # areas of I^2 and I^4 across the beam: their ratio is the area that the scatterers share
    area = 4 * np.pi * beams[1][0] * beams[1][1] / 2
    number = density * area * weight.sum() ** 2 / np.sum(weight**2) * (depth[1] - depth[0])
    return float(mean - share * (squared - mean) / number)
