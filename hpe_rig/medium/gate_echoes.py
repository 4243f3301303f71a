"""Echoes in a range gate around the focus: their energy by depth, power, mean frequency and scatterer density.

A scatterer at depth z from the focus contributes at the instant t of the gate (both in metres)

    e(t, z) = w(t) h(t - z) exp(-z^2 / 2 T_z^2)

w is the estimator's window over the gate, h the Hann pulse, eq. (9) of the paper, T_z the sigma of the tracking beam
along its axis. Derivations: docs/explanation/prediction.md.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hpe_rig.arrays import FloatArray

Triple = tuple[float, float, float]
DEPTHS = 256
INSTANTS = 96
"""Midpoint nodes over depth and over the gate."""


@dataclass(frozen=True, slots=True)
class TrackingGate:
    """Tracking beam (sigmas x, y, z), gate and received pulse length, m; ``hann_window``: the gate is windowed."""

    tracking_width_m: Triple
    gate_length_m: float
    pulse_length_m: float
    hann_window: bool = False

    def echoes(self) -> tuple[FloatArray, FloatArray]:
        """Return depths from the gate's centre, m, and the envelope e(t, z), (instant, depth)."""
        depth_m = self._depths(DEPTHS)
        return depth_m, self._envelopes(depth_m, _pulse)

    def energy(self) -> tuple[FloatArray, FloatArray]:
        """Return depths from the gate's centre, m, and the echo energy from each of them, (depth,)."""
        depth_m, echo = self.echoes()
        return depth_m, np.sum(echo**2, axis=0)

    def depth_moments(self, focus_offset_m: float = 0.0) -> tuple[float, float]:
        """Return the energy-weighted mean and standard deviation (m) of echo depth relative to the gate's centre.

        ``focus_offset_m``: the gate's centre behind the focus, z_c. The tracking beam is stronger on the focal side:
        weights are those of a gate at the focus times exp(-2 z_c z / T_z^2), with T_z the beam's sigma along its axis.
        """
        depth_m, energy = self.energy()
        exponent = -2 * focus_offset_m * depth_m / self.tracking_width_m[2] ** 2
        energy = energy * np.exp(exponent - exponent.max())
        mean_m = float(energy @ depth_m / energy.sum())
        return mean_m, float(np.sqrt(energy @ (depth_m - mean_m) ** 2 / energy.sum()))

    def depth_sd_m(self) -> float:
        """Return the rms depth of the echoes of a gate at the focus, weighted by their energy."""
        depth_m, energy = self.energy()
        return float(np.sqrt(energy @ depth_m**2 / energy.sum()))

    def carrier_spread(self, wave_number_per_m: float) -> float:
        """Return the standard deviation over speckle of the echo's mean frequency, relative to the carrier.

        For fully developed speckle g, complex normal, the mean is k + g^H B g / g^H A g. A is the energy matrix of the
        gate's echoes over depth, B its derivative by depth, k = ``wave_number_per_m`` = 4 pi f / c. The variance of the
        quotient is int_0^inf t tr(B M B M) / det(1 + t A) dt with M = (1 + t A)^-1, from the mean of exp(-t g^H A g).
        """
        depth_m = self._depths(INSTANTS)
        # A = E'E and B = (E'S - S'E) / 2, for the echo amplitudes E (instant, depth) and their slopes S by depth.
        echo, echo_slope = (self._envelopes(depth_m, pulse) for pulse in (_pulse, _pulse_slope))
        # In the eigenbasis of A, normalised by its largest eigenvalue.
        eigenvalues, basis = np.linalg.eigh(echo.T @ echo)
        derivative = basis.T @ (echo.T @ echo_slope - echo_slope.T @ echo) @ basis / 2
        squared_derivative = np.square(derivative) / eigenvalues[-1] ** 2
        # Trapezoidal rule over ln t, from where 1 + t A is 1 to where it damps everything. M and A are diagonal.
        log_step = 0.125
        t = np.exp(np.arange(-12.0, 40.0, log_step))[:, None]
        m = 1 / (1 + t * eigenvalues.clip(min=0) / eigenvalues[-1])
        integrand = np.prod(m, axis=1) * np.einsum("ti,ij,tj->t", m, squared_derivative, m)
        return float(np.sqrt(np.sum(integrand * t[:, 0] ** 2) * log_step) / wave_number_per_m)

    def _depths(self, count: int) -> FloatArray:
        """Return ``count`` depths (depth,), m, over all scatterers that echo into the gate."""
        return midpoints(self.gate_length_m + self.pulse_length_m, count)

    def _envelopes(self, depth_m: FloatArray, pulse: Callable[[FloatArray, float], FloatArray]) -> FloatArray:
        """Return the echo amplitude (instant, depth) of scatterers at ``depth_m`` over the instants of the gate.

        It is the product of the gate window, the ``pulse`` delayed by depth, and the tracking beam on its axis.
        """
        envelope = pulse(midpoints(self.gate_length_m, INSTANTS)[:, None] - depth_m, self.pulse_length_m)
        window = np.sin(np.pi * (np.arange(INSTANTS) + 0.5) / INSTANTS) ** 2 if self.hann_window else np.ones(INSTANTS)
        beam = np.exp(-(depth_m**2) / (2 * self.tracking_width_m[2] ** 2))
        return np.asarray(window[:, None] * envelope * beam)


def echo_power(gate_length_m: float, pulse_length_m: float, tracking_depth_m: float) -> float:
    """Return the mean echo power in a gate around the focus, relative to the power at the focus.

    The pulse is a Hann pulse; scatterers are weighted by the tracking beam of sigma ``tracking_depth_m`` along its
    axis.
    """
    points = (np.arange(INSTANTS) + 0.5) / INSTANTS - 0.5
    depth_m = points * gate_length_m + points[:, None] * pulse_length_m
    pulse_energy = np.cos(np.pi * points[:, None]) ** 4
    beam_energy = np.exp(-np.square(depth_m / tracking_depth_m))
    return float((pulse_energy * beam_energy).sum() / (INSTANTS * pulse_energy.sum()))


def scatterer_density(tracking_width_m: Triple, per_cell: float) -> float:
    """Return scatterers per m^3 for ``per_cell`` in the ellipsoid where the tracking beam exceeds half its peak."""
    return float(per_cell / (4 / 3 * np.pi * np.prod(np.asarray(tracking_width_m) * np.sqrt(2 * np.log(2)))))


def midpoints(length_m: float, count: int) -> FloatArray:
    """Return the midpoints of ``count`` equal parts of a length centred on 0."""
    return (np.arange(count) + 0.5) / count * length_m - length_m / 2


def _pulse(offset_m: FloatArray, pulse_length_m: float) -> FloatArray:
    """Return the Hann pulse's envelope, eq. (9) of the paper, at a distance from its centre."""
    inside = np.abs(offset_m) < pulse_length_m / 2
    return np.where(inside, np.cos(np.pi * offset_m / pulse_length_m) ** 2, 0.0)


def _pulse_slope(offset_m: FloatArray, pulse_length_m: float) -> FloatArray:
    """Return the derivative of ``_pulse``."""
    inside = np.abs(offset_m) < pulse_length_m / 2
    return np.where(inside, -np.pi / pulse_length_m * np.sin(2 * np.pi * offset_m / pulse_length_m), 0.0)
