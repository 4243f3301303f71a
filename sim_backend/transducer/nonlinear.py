"""Beam of a bowl with harmonics, through layers that attenuate and steepen it.

    P_n(q, z + h) = exp(-j k_zn h) P_n(q, z),     k_zn = sqrt((k_n - j alpha_n)^2 - q^2)     diffraction and loss
    p_n(r, z)     = int P_n(q, z) J0(q r) q dq                                               to points across the beam
    p -> advance(p, h)                                                                       steepening (burgers.py)

    p_n, P_n    pressure of harmonic n, and its spectrum over lateral wave numbers q
    k_n, alpha_n, k_zn    wave number, attenuation and axial wave number of harmonic n, 1/m
    z, h        depth and step, m; r distance from the axis, m

This is the one-way Westervelt equation, with each harmonic a spectrum of plane waves. Wide angles are exact. Only the
change by steepening is computed in space, in a window around the beam, and weighted with k_n / k_zn because an oblique
wave has a longer path. Half a step of diffraction, steepening, and half a step of diffraction give second order.
Harmonics are added as they arise. A linear beam equals the Rayleigh integral to 1e-7. Derivation:
docs/explanation/nonlinear.md, section 2.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from sim_backend.arrays import ComplexArray, FloatArray
from sim_backend.settings import Transducer
from sim_backend.transducer.burgers import Layer, advance
from sim_backend.transducer.radiation import apodisation

# Plane waves of the fundamental fade out between these angles: edge waves that never reach the focus.
_FADE_START_RAD, _FADE_END_RAD = math.radians(45), math.radians(80)
# Largest q of harmonic n over n k and the half aperture; products of waves from the rim stay below 1.
_SPECTRUM_MARGIN = 1.25
# Gauss-Legendre nodes over the number that just resolves the fastest wave.
_NODE_DENSITY = 1.3
# Smallest window around the beam, and its margin beyond the geometric edge.
_MIN_WINDOW_M, _WINDOW_MARGIN_M = 2.5e-3, 2.0e-3
_DEPTH_BEHIND_FOCUS_M = 12e-3


@dataclass(frozen=True, slots=True)
class Accuracy:
    """Numerical parameters of the march along the beam."""

    harmonics: int = 32
    """Largest number of harmonics."""
    step: float = 0.06
    """Step relative to the distance from the focus."""
    min_step_m: float = 0.2e-3
    """Smallest step, around the focus."""
    threshold: float = 1e-4
    """Ratio of the last harmonic to the fundamental above which harmonics are added."""


@dataclass(frozen=True, slots=True)
class Beam:
    """Pressure along the axis of a beam, and its force everywhere."""

    depth_m: FloatArray
    """Distance from the middle of the bowl, (depth,)."""
    harmonic_pa: ComplexArray
    """Complex amplitudes of the harmonics on the axis, (depth, harmonic)."""
    heat_w_per_m3: FloatArray
    """Absorbed power density on the axis, of all harmonics and shocks, (depth,)."""
    layer_impedance: FloatArray
    """rho c at the depths, (depth,)."""
    force_at: FloatArray
    """Depth, distance from the axis, volume and force density in N/m³ of each node, (4, node)."""

    def extremes_pa(self) -> tuple[FloatArray, FloatArray]:
        """Return the peak positive and peak negative pressure on the axis, both as positive numbers, (depth,)."""
        samples = 32 * self.harmonic_pa.shape[1]
        spectrum = np.zeros((len(self.depth_m), samples // 2 + 1), dtype=np.complex128)
        spectrum[:, 1 : self.harmonic_pa.shape[1] + 1] = self.harmonic_pa * (samples / 2)
        wave = np.fft.irfft(spectrum, samples, axis=1)
        return wave.max(axis=1), -wave.min(axis=1)

    def intensity_w_per_m2(self) -> FloatArray:
        """Return the intensity of all harmonics during the toneburst, (depth,)."""
        return np.asarray((np.abs(self.harmonic_pa) ** 2).sum(axis=1) / (2 * self.layer_impedance))


def nonlinear_beam(
    transducer: Transducer,
    layers: Sequence[Layer],
    frequency_hz: float,
    surface_pa: float,
    accuracy: Accuracy | None = None,
) -> Beam:
    """Return the beam of a bowl through layers that attenuate and steepen it: pressures, heat and force.

    ``surface_pa`` = rho c u0 is the pressure amplitude at the bowl's surface. ``layers`` start at the bowl; the last
    one is as thick as necessary. The march ends 12 mm behind the focus. Interfaces transmit as for a plane wave at
    normal incidence; reflections are neglected.
    """
    march = _March(transducer, layers[0], frequency_hz, surface_pa, accuracy or Accuracy())
    interface_m = np.cumsum([layer.thickness_m for layer in layers[:-1]])
    for layer, end_m in zip(layers, [*interface_m, transducer.focal_length_m + _DEPTH_BEHIND_FOCUS_M], strict=True):
        march.enter(layer)
        march.go_to(float(end_m))
    return march.beam()


def largest_table(transducer: Transducer, wavelength_m: float, harmonics: int) -> int:
    """Return the number of values in the largest table of Bessel functions of a beam, at the bowl or at its focus.

    Memory is proportional to it, and run time to it times ``harmonics``. With 24 harmonics the default bowl has half a
    million values, with 128 it has 13 million.
    """
    k, half_m = 2 * math.pi / wavelength_m, transducer.diameter_m / 2
    panel = _SPECTRUM_MARGIN * transducer.half_aperture * k
    at_bowl = (_nodes(_reach_m(transducer) * k) + 60) * (_nodes(half_m * k) + 60)
    lateral_nodes, spectral_nodes = _nodes(_MIN_WINDOW_M * harmonics * panel) + 40, _nodes(1.15 * half_m * panel) + 16
    return max(at_bowl, lateral_nodes * spectral_nodes * harmonics)


def _reach_m(bowl: Transducer) -> float:
    """Return the largest distance that a plane wave of the spectrum must represent."""
    return bowl.diameter_m / 2 + 1.2 * bowl.focal_length_m


class _March:
    """Spectra of the harmonics at the present depth, and the results at the depths before."""

    def __init__(
        self, transducer: Transducer, layer: Layer, frequency_hz: float, surface_pa: float, accuracy: Accuracy
    ) -> None:
        """Start the march at the bowl: choose nodes over lateral wave numbers, and compute the fundamental's spectrum.

        ``fundamental`` and ``higher`` are the spectra. ``higher[n]`` is harmonic n + 1, with the first ``length[n]`` of
        the common wave numbers. ``q``: wave numbers across the beam, ``w``: their quadrature weights, ``kz``: wave
        numbers along the beam. The fundamental has its own, with the suffix ``_fundamental``.
        """
        self.transducer, self.layer, self.frequency_hz = transducer, layer, frequency_hz
        self.surface_pa, self.accuracy = surface_pa, accuracy
        self.depth_m, self.active_harmonics = 0.0, 4
        # Depth, pressure on the axis, heat on the axis and impedance; force at the nodes.
        self.axis_results: list[tuple[float, ComplexArray, float, float]] = []
        self.force_results: list[FloatArray] = []
        self._window: tuple[float, int] | None = None
        k, bowl = 2 * np.pi * self.frequency_hz / self.layer.sound_speed_m_per_s, self.transducer
        # Fundamental: nodes and weights over the angle of the plane waves.
        angle, weight = _gauss(0, _FADE_END_RAD, _nodes(_reach_m(bowl) * k) + 60)
        position = np.clip((angle - _FADE_START_RAD) / (_FADE_END_RAD - _FADE_START_RAD), 2e-3, 1 - 2e-3)
        # An infinitely smooth step from 1 to 0 avoids ringing.
        weight = weight / (1 + np.exp(1 / (1 - position) - 1 / position))
        self.q_fundamental = k * np.sin(angle)
        self.w_fundamental = k**2 * np.sin(angle) * np.cos(angle) * weight
        # Higher harmonics: common nodes q and weights w in panels; harmonic n uses the first n panels.
        self.panel = _SPECTRUM_MARGIN * bowl.half_aperture * k
        nodes_per_panel = _nodes(1.15 * bowl.diameter_m / 2 * self.panel) + 16
        node, weight = _gauss(0, self.panel, nodes_per_panel)
        starts = self.panel * np.arange(self.accuracy.harmonics)[:, None]
        self.q = (starts + node).ravel()
        self.w = self.q * np.tile(weight, self.accuracy.harmonics)
        self.length = nodes_per_panel * np.arange(1, self.accuracy.harmonics + 1)
        self.higher = [np.zeros(size, dtype=np.complex128) for size in self.length]
        self._set_wave_numbers()
        self.fundamental = self._bowl_spectrum()

    def _set_wave_numbers(self) -> None:
        """Set the wave numbers, and their components along the axis, of all harmonics in the present layer."""
        n = np.arange(1, self.accuracy.harmonics + 1)
        self.k = self.layer.wave_number(np.asarray(n * self.frequency_hz, dtype=np.float64), self.frequency_hz)
        # A plane wave with the lateral wave number q has sqrt(k² - q²) along the axis; harmonic n uses its first nodes.
        self.kz_fundamental = np.sqrt(self.k[0] ** 2 - self.q_fundamental**2)
        self.kz = [np.sqrt(k**2 - self.q[:size] ** 2) for k, size in zip(self.k, self.length, strict=True)]

    def _bowl_spectrum(self) -> ComplexArray:
        """Return the spectrum of the fundamental at depth 0, from the waves of every ring of the bowl."""
        from scipy.special import j0

        bowl = self.transducer
        count = _nodes(bowl.diameter_m / 2 * abs(self.k[0])) + 60
        angle, weight = _gauss(0, math.asin(bowl.half_aperture), count)
        # Radius and depth of every ring, and its source strength.
        ring_m, ring_depth_m = bowl.focal_length_m * np.sin(angle), bowl.focal_length_m * 2 * np.sin(angle / 2) ** 2
        strength = weight * bowl.focal_length_m * ring_m * apodisation(bowl, np.sin(angle) / bowl.half_aperture)
        # Each ring is a J0 over lateral wave numbers, moved back to depth 0 by its phase.
        rings = j0(np.outer(self.q_fundamental, ring_m)) * np.exp(1j * np.outer(self.kz_fundamental, ring_depth_m))
        return np.asarray(self.surface_pa * self.k[0].real * (rings @ strength) / self.kz_fundamental)

    def enter(self, layer: Layer) -> None:
        """Cross into ``layer``, with the pressure transmission at normal incidence."""
        transmission = 2 * layer.impedance / (layer.impedance + self.layer.impedance)
        self.fundamental *= transmission
        self.higher = [transmission * spectrum for spectrum in self.higher]
        self.layer = layer
        self._set_wave_numbers()

    def go_to(self, depth_m: float) -> None:
        """March to ``depth_m`` in steps that shrink towards the focus."""
        while depth_m - self.depth_m > 1e-9:
            to_focus_m = abs(self.transducer.focal_length_m - self.depth_m)
            self._step(min(max(self.accuracy.step * to_focus_m, self.accuracy.min_step_m), depth_m - self.depth_m))

    def _step(self, step_m: float) -> None:
        """Advance by ``step_m``: half of the diffraction, the steepening of the wave, the other half of diffraction.

        Diffraction acts on the spectra, steepening on the pressures (node, harmonic) at nodes across the beam.
        Harmonics become active, about half as many again each time, as the wave steepens.
        """
        self._diffract(step_m / 2)
        self._set_nodes_across_beam()
        before_pa = self._pressure()
        # Only points in front of the surface of the bowl steepen.
        focal_length_m = self.transducer.focal_length_m
        surface_m = focal_length_m - np.sqrt(np.maximum(focal_length_m**2 - self.r**2, 0.0))
        in_front = self.depth_m >= surface_m
        # Shocks take ``shock_loss`` (node,), W/m², from the intensity.
        after_pa, shock_loss = before_pa.copy(), np.zeros(len(self.r))
        after_pa[in_front], shock_loss[in_front] = advance(before_pa[in_front], step_m, self.frequency_hz, self.layer)
        # Transformed to spectra by quadrature over the radius. The taper ends the change smoothly at the window's edge.
        self._add_steepening((after_pa - before_pa) * (self.taper * self.weight)[:, None])
        self._record(before_pa, shock_heat_w_per_m3=shock_loss / step_m, step_m=step_m)
        self._diffract(step_m / 2)
        # More harmonics once the highest active one, relative to the fundamental, exceeds the threshold.
        if np.abs(after_pa[:, -1]).max() > self.accuracy.threshold * np.abs(after_pa[:, 0]).max():
            self.active_harmonics = min(
                self.accuracy.harmonics, self.active_harmonics + max(2, self.active_harmonics // 2)
            )

    def _diffract(self, step_m: float) -> None:
        """Propagate the spectra by ``step_m`` with diffraction and attenuation."""
        self.fundamental *= np.exp(-1j * self.kz_fundamental * step_m)
        for n in range(1, self.active_harmonics):
            self.higher[n] *= np.exp(-1j * self.kz[n] * step_m)
        self.depth_m += step_m

    def _set_nodes_across_beam(self) -> None:
        """Set the nodes across the beam at the present depth, and the tables of J0 from spectra to pressures there.

        The nodes fill a window around the beam: radii ``r`` with quadrature weights ``weight`` (of r dr) and ``taper``,
        1 inside and falling to 0 at the window's edge. ``j0_fundamental`` and ``j0_higher`` (node, wave number) are the
        tables of the fundamental and of the higher harmonics. Nothing changes while the window stays the same.
        """
        from scipy.special import j0

        bowl = self.transducer
        edge_m = abs(1 - self.depth_m / bowl.focal_length_m) * bowl.diameter_m / 2
        reach_m = max(edge_m + _WINDOW_MARGIN_M, _MIN_WINDOW_M)
        # Rounded up, so that few windows are computed.
        grid_m = 0.75e-3 if reach_m < 6e-3 else 3e-3
        radius_m = grid_m * math.ceil(reach_m / grid_m)
        if self._window == (radius_m, self.active_harmonics):
            return
        self._window = (radius_m, self.active_harmonics)
        largest_wave_number = max(self.active_harmonics * self.panel, abs(self.k[0]))
        self.r, weight = _gauss(0, radius_m, _nodes(radius_m * largest_wave_number) + 40)
        self.weight = weight * self.r
        # The outer fifth of the window: 0 at its inner and 1 at its outer edge.
        position = np.clip((self.r / radius_m - 0.8) / 0.2, 0, 1)
        self.taper = np.cos(np.pi / 2 * position) ** 2
        self.j0_fundamental = j0(np.outer(self.r, self.q_fundamental))
        # Single precision halves the time of the march, with an error of 1e-6 of the harmonics.
        self.j0_higher = np.empty((len(self.r), self.length[self.active_harmonics - 1]), dtype=np.float32)
        for node_table, r_m in zip(self.j0_higher, self.r, strict=True):
            node_table[:] = j0(r_m * self.q[: len(node_table)])

    def _pressure(self) -> ComplexArray:
        """Return the pressure of the harmonics at the nodes across the beam, (node, harmonic), from their spectra."""
        fundamental_pa = self.j0_fundamental @ (self.fundamental * self.w_fundamental)
        # The real table times complex spectra, as a product of real matrices: half the operations of a complex table.
        size = self.length[self.active_harmonics - 1]
        spectra = np.zeros((size, self.active_harmonics - 1), dtype=np.complex64)
        for n in range(1, self.active_harmonics):
            spectra[: self.length[n], n - 1] = self.higher[n] * self.w[: self.length[n]]
        higher_pa = (self.j0_higher @ spectra.view(np.float32)).view(np.complex64)
        return np.column_stack([fundamental_pa, higher_pa.astype(np.complex128)])

    def _add_steepening(self, weighted_change_pa: ComplexArray) -> None:
        """Add a step's steepening of the wave to the spectra of the harmonics.

        ``weighted_change_pa`` (radial node, harmonic): change of pressure, already times the nodes' quadrature weights.
        An oblique plane wave travels k / kz times the step along its own direction, so its steepening is multiplied by
        k / kz.
        """
        # Tables of J0 transform pressures over the radius to spectra. The fundamental has its own table and kz.
        self.fundamental += (self.j0_fundamental.T @ weighted_change_pa[:, 0]) * (self.k[0] / self.kz_fundamental)
        # A real table times complex pressures, as a product of real matrices.
        higher_pa = np.ascontiguousarray(weighted_change_pa[:, 1:], dtype=np.complex64).view(np.float32)
        spectra = (self.j0_higher.T @ higher_pa).view(np.complex64)
        for n in range(1, self.active_harmonics):
            self.higher[n] += spectra[: self.length[n], n - 1] * (self.k[n] / self.kz[n])

    def _record(self, pressure: ComplexArray, shock_heat_w_per_m3: FloatArray, step_m: float) -> None:
        """Store pressure and heat on the axis, and the force at the nodes across the beam, at the present depth."""
        frequency_hz = np.asarray(np.arange(1, self.active_harmonics + 1) * self.frequency_hz, dtype=np.float64)
        loss = self.layer.attenuation_np_per_m(frequency_hz)
        heat = np.abs(pressure) ** 2 @ loss / self.layer.impedance + shock_heat_w_per_m3
        self.axis_results.append((self.depth_m, pressure[0], float(heat[0]), self.layer.impedance))
        # Of the ring of each node; the force is the absorbed power over the sound speed.
        volume = 2 * np.pi * self.weight * step_m
        force = heat / self.layer.sound_speed_m_per_s
        self.force_results.append(np.stack([np.full(len(self.r), self.depth_m), self.r, volume, force]))

    def beam(self) -> Beam:
        """Return the results at all depths so far."""
        depth_m, pressure, heat, impedance = zip(*self.axis_results, strict=True)
        on_axis = np.zeros((len(depth_m), self.accuracy.harmonics), dtype=np.complex128)
        for row, harmonics in zip(on_axis, pressure, strict=True):
            row[: len(harmonics)] = harmonics
        return Beam(
            depth_m=np.array(depth_m),
            harmonic_pa=on_axis,
            heat_w_per_m3=np.array(heat),
            layer_impedance=np.array(impedance),
            force_at=np.concatenate(self.force_results, axis=1),
        )


def _nodes(phase_rad: float) -> int:
    """Return the number of nodes for a wave with the phase ``phase_rad`` from one end to the other."""
    return math.ceil(_NODE_DENSITY * phase_rad / 2)


def _gauss(low: float, high: float, count: int) -> tuple[FloatArray, FloatArray]:
    """Return nodes and weights of Gauss-Legendre quadrature from ``low`` to ``high``."""
    node, weight = _legendre_nodes(count)
    return (high - low) / 2 * node + (high + low) / 2, (high - low) / 2 * weight


@lru_cache(maxsize=64)
def _legendre_nodes(count: int) -> tuple[FloatArray, FloatArray]:
    """Return nodes and weights of Gauss-Legendre quadrature on -1 to 1."""
    from scipy.special import roots_legendre

    node, weight = roots_legendre(count)
    return np.asarray(node), np.asarray(weight)
