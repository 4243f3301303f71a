"""Push at its true pressure: the bowl's beam with all its harmonics, through layers that attenuate and steepen it.

    P_n(q, z + h) = exp(-j k_zn h) P_n(q, z),     k_zn = sqrt((k_n - j alpha_n)^2 - q^2)     diffraction and loss
    p_n(r, z)     = int P_n(q, z) J0(q r) q dq                                               to places across the beam
    p -> advance(p, h)                                                                       steepening, `burgers`

One-way Westervelt equation, each harmonic a spectrum of plane waves: wide angles are exact, and only what steepening
changes goes through space, from a window around the beam, weighted with k_n / k_zn as a wave at an angle has a longer
way. Half a step of diffraction, steepening, half a step of diffraction: second order. Harmonics are taken on as they
arise. Linear, it is the Rayleigh integral over the bowl to 1e-7. docs/explanation/nonlinear.md, section 2.
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

# Plane waves of the fundamental beyond 45 degrees fade out by 80: edge waves that never reach the focus.
_FADING_RAD, _LAST_RAD = math.radians(45), math.radians(80)
# Largest q of harmonic n over n k and the half aperture, which no product of the rim's own waves exceeds.
_WIDER = 1.25
# Gauss-Legendre nodes over those that just resolve the fastest wave.
_DENSITY = 1.3
_WINDOW_M, _MARGIN_M = 2.5e-3, 2.0e-3
_BEYOND_M = 12e-3


@dataclass(frozen=True, slots=True)
class Accuracy:
    """How finely the march goes."""

    harmonics: int = 32
    """Harmonics carried at most."""
    step: float = 0.06
    """Step over the distance from the focus."""
    least_step_m: float = 0.2e-3
    """Smallest step, around the focus."""
    threshold: float = 1e-4
    """Last harmonic over the fundamental from which more are taken on."""


@dataclass(frozen=True, slots=True)
class Beam:
    """A beam along its axis, step by step, and all of its force at once."""

    depth_m: FloatArray
    """Distance from the bowl's middle, (depth,)."""
    harmonic_pa: ComplexArray
    """Complex amplitudes of the harmonics on the axis, (depth, harmonic)."""
    heat_w_per_m3: FloatArray
    """Absorbed power a volume on the axis, all harmonics and shocks, (depth,)."""
    layer_impedance: FloatArray
    """rho c at the depths, (depth,)."""
    force_at: FloatArray
    """Rows of depth, distance from the axis, volume, force density in N/m^3: what the beam presses on, (4, place)."""

    def extremes_pa(self) -> tuple[FloatArray, FloatArray]:
        """Return the peak positive and peak negative pressure, both positive, (depth,)."""
        samples = 32 * self.harmonic_pa.shape[1]
        spectrum = np.zeros((len(self.depth_m), samples // 2 + 1), dtype=np.complex128)
        spectrum[:, 1 : self.harmonic_pa.shape[1] + 1] = self.harmonic_pa * (samples / 2)
        wave = np.fft.irfft(spectrum, samples, axis=1)
        return wave.max(axis=1), -wave.min(axis=1)

    def intensity_w_per_m2(self) -> FloatArray:
        """Return the intensity of all harmonics while the toneburst is on, (depth,)."""
        return np.asarray((np.abs(self.harmonic_pa) ** 2).sum(axis=1) / (2 * self.layer_impedance))


def nonlinear_beam(
    transducer: Transducer,
    layers: Sequence[Layer],
    frequency_hz: float,
    surface_pa: float,
    accuracy: Accuracy | None = None,
) -> Beam:
    """Return the beam of a bowl whose surface has a pressure amplitude ``surface_pa`` = rho c u0 in the first layer.

    ``layers`` from the bowl on, the last one as thick as need be. The march ends 12 mm behind the focus. Interfaces
    transmit as they do a plane wave that comes straight at them, and reflect nothing that comes back.
    """
    march = _March(transducer, layers[0], frequency_hz, surface_pa, accuracy or Accuracy())
    border_m = np.cumsum([layer.thickness_m for layer in layers[:-1]])
    for layer, upto_m in zip(layers, [*border_m, transducer.focal_length_m + _BEYOND_M], strict=True):
        march.enter(layer)
        march.go_to(float(upto_m))
    return march.beam()


def largest_table(transducer: Transducer, wavelength_m: float, harmonics: int) -> int:
    """Return how many values the largest table of Bessel functions of such a beam has, at the bowl or at its focus.

    Memory goes with it, the time of a march with it times ``harmonics``: 24 harmonics of the default bowl have half a
    million values, 128 have 13 million.
    """
    k, half_m = 2 * math.pi / wavelength_m, transducer.diameter_m / 2
    panel = _WIDER * transducer.half_aperture * k
    at_bowl = (_nodes(_reach_m(transducer) * k) + 60) * (_nodes(half_m * k) + 60)
    across, along = _nodes(_WINDOW_M * harmonics * panel) + 40, _nodes(1.15 * half_m * panel) + 16
    return max(at_bowl, across * along * harmonics)


def _reach_m(bowl: Transducer) -> float:
    return bowl.diameter_m / 2 + 1.2 * bowl.focal_length_m


class _March:
    """The spectra at one depth, and what was seen on the way."""

    def __init__(
        self, transducer: Transducer, layer: Layer, frequency_hz: float, surface_pa: float, accuracy: Accuracy
    ) -> None:
        self.transducer, self.layer, self.frequency_hz = transducer, layer, frequency_hz
        self.surface_pa, self.accuracy = surface_pa, accuracy
        self.depth_m, self.carried = 0.0, 4
        self.seen: list[tuple[float, ComplexArray, float, float]] = []
        self.pressed: list[FloatArray] = []
        self._window: tuple[float, int] | None = None
        k, bowl = 2 * np.pi * self.frequency_hz / self.layer.sound_speed_m_per_s, self.transducer
        angle, weight = _gauss(0, _LAST_RAD, _nodes(_reach_m(bowl) * k) + 60)
        fading = np.clip((angle - _FADING_RAD) / (_LAST_RAD - _FADING_RAD), 2e-3, 1 - 2e-3)
        # Infinitely smooth from 1 to 0, so that nothing rings.
        weight = weight / (1 + np.exp(1 / (1 - fading) - 1 / fading))
        self.q1, self.w1 = k * np.sin(angle), k**2 * np.sin(angle) * np.cos(angle) * weight
        self.panel = _WIDER * bowl.half_aperture * k
        each = _nodes(1.15 * bowl.diameter_m / 2 * self.panel) + 16
        node, weight = _gauss(0, self.panel, each)
        starts = self.panel * np.arange(self.accuracy.harmonics)[:, None]
        self.q = (starts + node).ravel()
        self.w = self.q * np.tile(weight, self.accuracy.harmonics)
        self.length = each * np.arange(1, self.accuracy.harmonics + 1)
        self.higher = [np.zeros(size, dtype=np.complex128) for size in self.length]
        self._wave_numbers()
        self.first = self._bowl()

    def _wave_numbers(self) -> None:
        n = np.arange(1, self.accuracy.harmonics + 1)
        self.k = self.layer.wave_number(np.asarray(n * self.frequency_hz, dtype=np.float64), self.frequency_hz)
        self.kz1 = np.sqrt(self.k[0] ** 2 - self.q1**2)
        self.kz = [np.sqrt(k**2 - self.q[:size] ** 2) for k, size in zip(self.k, self.length, strict=True)]

    def _bowl(self) -> ComplexArray:
        """Return the fundamental's spectrum at depth 0, as if the plane waves of every ring had come from there."""
        from scipy.special import j0

        bowl = self.transducer
        count = _nodes(bowl.diameter_m / 2 * abs(self.k[0])) + 60
        angle, weight = _gauss(0, math.asin(bowl.half_aperture), count)
        ring_m, ahead_m = (
            bowl.focal_length_m * np.sin(angle),
            bowl.focal_length_m * 2 * np.sin(angle / 2) ** 2,
        )
        strength = weight * bowl.focal_length_m * ring_m * apodisation(bowl, np.sin(angle) / bowl.half_aperture)
        rings = j0(np.outer(self.q1, ring_m)) * np.exp(1j * np.outer(self.kz1, ahead_m))
        return np.asarray(self.surface_pa * self.k[0].real * (rings @ strength) / self.kz1)

    def enter(self, layer: Layer) -> None:
        """Cross into ``layer``: the pressure that an interface lets through."""
        through = 2 * layer.impedance / (layer.impedance + self.layer.impedance)
        self.first *= through
        self.higher = [through * each for each in self.higher]
        self.layer = layer
        self._wave_numbers()

    def go_to(self, depth_m: float) -> None:
        """March to ``depth_m`` in steps that shrink towards the focus."""
        while depth_m - self.depth_m > 1e-9:
            left_m = abs(self.transducer.focal_length_m - self.depth_m)
            self._step(min(max(self.accuracy.step * left_m, self.accuracy.least_step_m), depth_m - self.depth_m))

    def _step(self, step_m: float) -> None:
        self._diffract(step_m / 2)
        self._open_window()
        before = self._pressure()
        # What is in front of the bowl alone steepens.
        bowl_m = self.transducer.focal_length_m - np.sqrt(
            np.maximum(self.transducer.focal_length_m**2 - self.r**2, 0.0)
        )
        there = self.depth_m >= bowl_m
        after, lost = before.copy(), np.zeros(len(self.r))
        after[there], lost[there] = advance(before[there], step_m, self.frequency_hz, self.layer)
        self._take_in((after - before) * (self.taper * self.weight)[:, None])
        self._note(before, lost / step_m, step_m)
        self._diffract(step_m / 2)
        if np.abs(after[:, -1]).max() > self.accuracy.threshold * np.abs(after[:, 0]).max():
            self.carried = min(self.accuracy.harmonics, self.carried + max(2, self.carried // 2))

    def _diffract(self, step_m: float) -> None:
        self.first *= np.exp(-1j * self.kz1 * step_m)
        for n in range(1, self.carried):
            self.higher[n] *= np.exp(-1j * self.kz[n] * step_m)
        self.depth_m += step_m

    def _open_window(self) -> None:
        """Place nodes across the beam where it is now, and the Bessel functions that lead there."""
        from scipy.special import j0

        bowl = self.transducer
        edge_m = abs(1 - self.depth_m / bowl.focal_length_m) * bowl.diameter_m / 2
        reach_m = max(edge_m + _MARGIN_M, _WINDOW_M)
        grid_m = 0.75e-3 if reach_m < 6e-3 else 3e-3
        window = (grid_m * math.ceil(reach_m / grid_m), self.carried)
        if window == self._window:
            return
        self._window = window
        fastest = max(self.carried * self.panel, abs(self.k[0]))
        self.r, weight = _gauss(0, window[0], _nodes(window[0] * fastest) + 40)
        self.weight = weight * self.r
        share = np.clip((self.r / window[0] - 0.8) / 0.2, 0, 1)
        self.taper = np.cos(np.pi / 2 * share) ** 2
        self.bessel1 = j0(np.outer(self.r, self.q1))
        # Single precision: half the time of the march, and 1e-6 of the harmonics.
        self.bessel = np.empty((len(self.r), self.length[self.carried - 1]), dtype=np.float32)
        for row, r_m in zip(self.bessel, self.r, strict=True):
            row[:] = j0(r_m * self.q[: len(row)])

    def _pressure(self) -> ComplexArray:
        """Return the harmonics at the window's nodes, (place, harmonic)."""
        first = self.bessel1 @ (self.first * self.w1)
        size = self.length[self.carried - 1]
        spectra = np.zeros((size, self.carried - 1), dtype=np.complex64)
        for n in range(1, self.carried):
            spectra[: self.length[n], n - 1] = self.higher[n] * self.w[: self.length[n]]
        higher = (self.bessel @ spectra.view(np.float32)).view(np.complex64)
        return np.column_stack([first, higher.astype(np.complex128)])

    def _take_in(self, change: ComplexArray) -> None:
        """Add what steepening changed, already weighted for the integral over places, to the spectra."""
        self.first += (self.bessel1.T @ change[:, 0]) * (self.k[0] / self.kz1)
        higher = np.ascontiguousarray(change[:, 1:], dtype=np.complex64).view(np.float32)
        spectra = (self.bessel.T @ higher).view(np.complex64)
        for n in range(1, self.carried):
            self.higher[n] += spectra[: self.length[n], n - 1] * (self.k[n] / self.kz[n])

    def _note(self, pressure: ComplexArray, shocked_w_per_m3: FloatArray, step_m: float) -> None:
        frequency_hz = np.asarray(np.arange(1, self.carried + 1) * self.frequency_hz, dtype=np.float64)
        loss = self.layer.attenuation_np_per_m(frequency_hz)
        heat = np.abs(pressure) ** 2 @ loss / self.layer.impedance + shocked_w_per_m3
        self.seen.append((self.depth_m, pressure[0], float(heat[0]), self.layer.impedance))
        volume = 2 * np.pi * self.weight * step_m
        force = heat / self.layer.sound_speed_m_per_s
        self.pressed.append(np.stack([np.full(len(self.r), self.depth_m), self.r, volume, force]))

    def beam(self) -> Beam:
        """Return what was seen."""
        depth_m, pressure, heat, impedance = zip(*self.seen, strict=True)
        on_axis = np.zeros((len(depth_m), self.accuracy.harmonics), dtype=np.complex128)
        for row, each in zip(on_axis, pressure, strict=True):
            row[: len(each)] = each
        return Beam(
            np.array(depth_m), on_axis, np.array(heat), np.array(impedance), np.concatenate(self.pressed, axis=1)
        )


def _nodes(turns_rad: float) -> int:
    """Return the nodes that a wave with ``turns_rad`` from one end to the other needs."""
    return math.ceil(_DENSITY * turns_rad / 2)


def _gauss(low: float, high: float, count: int) -> tuple[FloatArray, FloatArray]:
    """Return nodes and weights of Gauss-Legendre quadrature from ``low`` to ``high``."""
    node, weight = _legendre_nodes(count)
    return (high - low) / 2 * node + (high + low) / 2, (high - low) / 2 * weight


@lru_cache(maxsize=64)
def _legendre_nodes(count: int) -> tuple[FloatArray, FloatArray]:
    from scipy.special import roots_legendre

    node, weight = roots_legendre(count)
    return np.asarray(node), np.asarray(weight)
