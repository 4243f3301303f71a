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
# Gauss-Legendre nodes over the number that just resolves the fastest wave, and additional ones of each quadrature.
_NODE_DENSITY = 1.3
_BOWL_MARGIN_NODES, _WINDOW_MARGIN_NODES, _PANEL_MARGIN_NODES = 60, 40, 16
# The radius up to which the nodes of a panel resolve the higher harmonics, over the radius of the bowl.
_PANEL_RADIUS_RATIO = 1.15
# Smallest window around the beam, and its margin beyond the geometric edge.
_MIN_WINDOW_M, _WINDOW_MARGIN_M = 2.5e-3, 2.0e-3
_DEPTH_BEHIND_FOCUS_M = 12e-3
# Ratio of the last harmonic to the fundamental above which harmonics are added.
_NEW_HARMONICS_RATIO = 1e-4


@dataclass(frozen=True, slots=True)
class Accuracy:
    """Numerical parameters of the march along the beam."""

    harmonics: int = 32
    """Largest number of harmonics."""
    relative_step: float = 0.06
    """Step relative to the distance from the focus."""
    min_step_m: float = 0.2e-3
    """Smallest step, around the focus."""


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
    k, bowl_radius_m = 2 * math.pi / wavelength_m, transducer.diameter_m / 2
    panel = _SPECTRUM_MARGIN * transducer.half_aperture * k
    # At the bowl the table is wave numbers of the fundamental by rings of the bowl; at the focus it is nodes across the
    # smallest window by wave numbers of all harmonics.
    wave_numbers, rings = _nodes(_reach_m(transducer) * k), _nodes(bowl_radius_m * k)
    at_bowl = (wave_numbers + _BOWL_MARGIN_NODES) * (rings + _BOWL_MARGIN_NODES)
    lateral_nodes = _nodes(_MIN_WINDOW_M * harmonics * panel) + _WINDOW_MARGIN_NODES
    return max(at_bowl, lateral_nodes * _nodes_per_panel(transducer, panel) * harmonics)


def _reach_m(bowl: Transducer) -> float:
    """Return the largest distance that a plane wave of the spectrum must represent."""
    return bowl.diameter_m / 2 + 1.2 * bowl.focal_length_m


def _nodes_per_panel(bowl: Transducer, panel_per_m: float) -> int:
    """Return the number of nodes in a panel of this width, 1/m, of the wave numbers of the higher harmonics."""
    return _nodes(_PANEL_RADIUS_RATIO * bowl.diameter_m / 2 * panel_per_m) + _PANEL_MARGIN_NODES


class _March:
    """Spectra of the harmonics at the present depth, and the results at the depths before."""

    def __init__(
        self, transducer: Transducer, layer: Layer, frequency_hz: float, surface_pa: float, accuracy: Accuracy
    ) -> None:
        """Start the march at the bowl: choose nodes over lateral wave numbers, and compute the fundamental's spectrum.

        A spectrum is the amplitude of plane waves over the wave number q across the beam; along it the waves have
        kz = sqrt(k² - q²). The fundamental and the higher harmonics have different nodes q:

        * ``fundamental``, at ``q_fundamental`` with the quadrature weights ``weight_fundamental``.
        * ``higher[n]``: harmonic n + 1, at the first ``node_count[n]`` of the ``q`` with the weights ``q_weight``.
        """
        self.transducer, self.layer, self.frequency_hz = transducer, layer, frequency_hz
        self.surface_pa, self.accuracy = surface_pa, accuracy
        self.depth_m, self.active_harmonics = 0.0, 4
        # Depth, pressure on the axis, heat on the axis and impedance; force at the nodes.
        self.axis_results: list[tuple[float, ComplexArray, float, float]] = []
        self.force_results: list[FloatArray] = []
        self._window: tuple[float, int] | None = None
        k, bowl = 2 * np.pi * self.frequency_hz / self.layer.sound_speed_m_per_s, self.transducer
        # Fundamental: nodes over the angle of the plane waves. Wide angles fade out by an infinitely smooth step from 1
        # to 0, which avoids ringing.
        angle, weight = _gauss(0, _FADE_END_RAD, _nodes(_reach_m(bowl) * k) + _BOWL_MARGIN_NODES)
        position = np.clip((angle - _FADE_START_RAD) / (_FADE_END_RAD - _FADE_START_RAD), 2e-3, 1 - 2e-3)
        weight = weight / (1 + np.exp(1 / (1 - position) - 1 / position))
        # With q = k sin(angle) the integral over q dq is one over k² sin(angle) cos(angle) d(angle).
        self.q_fundamental = k * np.sin(angle)
        self.weight_fundamental = k**2 * np.sin(angle) * np.cos(angle) * weight
        # Higher harmonics: the nodes q are in panels of equal width, and harmonic n uses the first n panels.
        self.panel_per_m = _SPECTRUM_MARGIN * bowl.half_aperture * k
        nodes_per_panel = _nodes_per_panel(bowl, self.panel_per_m)
        node, weight = _gauss(0, self.panel_per_m, nodes_per_panel)
        panel_starts = self.panel_per_m * np.arange(self.accuracy.harmonics)[:, None]
        self.q = (panel_starts + node).ravel()
        self.q_weight = self.q * np.tile(weight, self.accuracy.harmonics)
        self.node_count = nodes_per_panel * np.arange(1, self.accuracy.harmonics + 1)
        self.higher = [np.zeros(size, dtype=np.complex128) for size in self.node_count]
        self._set_wave_numbers()
        self.fundamental = self._bowl_spectrum()

    def _set_wave_numbers(self) -> None:
        """Set the wave numbers ``k`` of all harmonics in the present layer, and ``kz`` of their plane waves along it.

        A plane wave with the wave number q across the beam has kz = sqrt(k² - q²) along it. The fundamental has its own
        nodes q, and each higher harmonic uses the first ones of the common nodes.
        """
        n = np.arange(1, self.accuracy.harmonics + 1)
        self.k = self.layer.wave_number(np.asarray(n * self.frequency_hz, dtype=np.float64), self.frequency_hz)
        self.kz_fundamental = np.sqrt(self.k[0] ** 2 - self.q_fundamental**2)
        self.kz = [np.sqrt(k**2 - self.q[:size] ** 2) for k, size in zip(self.k, self.node_count, strict=True)]

    def _bowl_spectrum(self) -> ComplexArray:
        """Return the spectrum of the fundamental at depth 0: the sum of the plane waves of every ring of the bowl."""
        from scipy.special import j0

        bowl = self.transducer
        count = _nodes(bowl.diameter_m / 2 * abs(self.k[0])) + _BOWL_MARGIN_NODES
        angle, weight = _gauss(0, math.asin(bowl.half_aperture), count)
        # Radius and depth of every ring, and its area (over 2 pi) times its relative velocity.
        ring_m, ring_depth_m = bowl.focal_length_m * np.sin(angle), bowl.focal_length_m * 2 * np.sin(angle / 2) ** 2
        strength = weight * bowl.focal_length_m * ring_m * apodisation(bowl, np.sin(angle) / bowl.half_aperture)
        # The spectrum of a ring is J0(q radius), (wave number, ring). The ring lies at its depth in front of depth 0;
        # the phase kz depth refers its waves to depth 0.
        rings = j0(np.outer(self.q_fundamental, ring_m)) * np.exp(1j * np.outer(self.kz_fundamental, ring_depth_m))
        # The pressure of a source of normal velocity u has the spectrum rho c u k / kz.
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
            step_m = max(self.accuracy.relative_step * to_focus_m, self.accuracy.min_step_m)
            self._step(min(step_m, depth_m - self.depth_m))

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
        surface_m = focal_length_m - np.sqrt(np.maximum(focal_length_m**2 - self.radius_m**2, 0.0))
        in_front = self.depth_m >= surface_m
        # Shocks take ``shock_loss`` (node,), W/m², from the intensity.
        after_pa, shock_loss = before_pa.copy(), np.zeros(len(self.radius_m))
        after_pa[in_front], shock_loss[in_front] = advance(before_pa[in_front], step_m, self.frequency_hz, self.layer)
        # Transformed to spectra by quadrature over the radius. The taper ends the change smoothly at the window's edge.
        self._add_steepening((after_pa - before_pa) * (self.taper * self.radius_weight_m2)[:, None])
        self._store_results(before_pa, shock_heat_w_per_m3=shock_loss / step_m, step_m=step_m)
        self._diffract(step_m / 2)
        # More harmonics once the highest active one, relative to the fundamental, is large enough.
        if np.abs(after_pa[:, -1]).max() > _NEW_HARMONICS_RATIO * np.abs(after_pa[:, 0]).max():
            self.active_harmonics = min(
                self.accuracy.harmonics, self.active_harmonics + max(2, self.active_harmonics // 2)
            )

    def _diffract(self, step_m: float) -> None:
        """Propagate the spectra by ``step_m`` with diffraction and attenuation: exp(-j kz step), kz complex."""
        self.fundamental *= np.exp(-1j * self.kz_fundamental * step_m)
        # ``higher[n]`` is harmonic n + 1; entry 0 is not used, as the fundamental has its own spectrum.
        for n in range(1, self.active_harmonics):
            self.higher[n] *= np.exp(-1j * self.kz[n] * step_m)
        self.depth_m += step_m

    def _set_nodes_across_beam(self) -> None:
        """Set the nodes across the beam at the present depth, and the tables that transform spectra to pressures there.

        The nodes fill a window around the beam: ``radius_m`` with quadrature weights ``radius_weight_m2`` (of r dr) and
        ``taper``, 1 inside and falling to 0 at the window's edge. The transform from wave numbers q to radii r is a
        Hankel transform: its tables ``j0_fundamental`` and ``j0_higher`` (node, wave number) hold J0(q r) of the
        fundamental and of the higher harmonics. Nothing changes while the window stays the same.
        """
        from scipy.special import j0

        bowl = self.transducer
        edge_m = abs(1 - self.depth_m / bowl.focal_length_m) * bowl.diameter_m / 2
        reach_m = max(edge_m + _WINDOW_MARGIN_M, _MIN_WINDOW_M)
        # Rounded up, so that the tables change only a few times on the way to the focus and behind it.
        grid_m = 0.75e-3 if reach_m < 6e-3 else 3e-3
        window_m = grid_m * math.ceil(reach_m / grid_m)
        if self._window == (window_m, self.active_harmonics):
            return
        self._window = (window_m, self.active_harmonics)
        # Harmonic n has wave numbers across the beam up to n times ``panel_per_m``.
        largest_wave_number = max(self.active_harmonics * self.panel_per_m, abs(self.k[0]))
        count = _nodes(window_m * largest_wave_number) + _WINDOW_MARGIN_NODES
        self.radius_m, weight = _gauss(0, window_m, count)
        self.radius_weight_m2 = weight * self.radius_m
        # The outer fifth of the window: 0 at its inner and 1 at its outer edge.
        position = np.clip((self.radius_m / window_m - 0.8) / 0.2, 0, 1)
        self.taper = np.cos(np.pi / 2 * position) ** 2
        self.j0_fundamental = j0(np.outer(self.radius_m, self.q_fundamental))
        # Single precision halves the time of the march, with an error of 1e-6 of the harmonics.
        self.j0_higher = np.empty((count, self.node_count[self.active_harmonics - 1]), dtype=np.float32)
        for node_table, radius_m in zip(self.j0_higher, self.radius_m, strict=True):
            node_table[:] = j0(radius_m * self.q[: len(node_table)])

    def _pressure(self) -> ComplexArray:
        """Return the pressure of the harmonics at the nodes across the beam, (node, harmonic), from their spectra."""
        fundamental_pa = self.j0_fundamental @ (self.fundamental * self.weight_fundamental)
        # The real table times complex spectra, as a product of real matrices: half the operations of a complex table.
        size = self.node_count[self.active_harmonics - 1]
        spectra = np.zeros((size, self.active_harmonics - 1), dtype=np.complex64)
        for n in range(1, self.active_harmonics):
            spectra[: self.node_count[n], n - 1] = self.higher[n] * self.q_weight[: self.node_count[n]]
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
            self.higher[n] += spectra[: self.node_count[n], n - 1] * (self.k[n] / self.kz[n])

    def _store_results(self, pressure_pa: ComplexArray, shock_heat_w_per_m3: FloatArray, step_m: float) -> None:
        """Store pressure and heat on the axis, and the force at the nodes across the beam, at the present depth.

        ``pressure_pa`` (node, harmonic), ``shock_heat_w_per_m3`` (node,): power density that shocks absorb.
        """
        frequency_hz = np.asarray(np.arange(1, self.active_harmonics + 1) * self.frequency_hz, dtype=np.float64)
        loss_np_per_m = self.layer.attenuation_np_per_m(frequency_hz)
        # Absorbed power density: 2 alpha times the intensity |p|² / 2 rho c, summed over harmonics.
        heat = np.abs(pressure_pa) ** 2 @ loss_np_per_m / self.layer.impedance + shock_heat_w_per_m3
        self.axis_results.append((self.depth_m, pressure_pa[0], float(heat[0]), self.layer.impedance))
        # A node represents a ring around the axis, as thick as the step. The force is absorbed power over sound speed.
        ring_m3 = 2 * np.pi * self.radius_weight_m2 * step_m
        force = heat / self.layer.sound_speed_m_per_s
        depth_m = np.full(len(self.radius_m), self.depth_m)
        self.force_results.append(np.stack([depth_m, self.radius_m, ring_m3, force]))

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
