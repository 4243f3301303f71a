"""Beam averaging: the ratio of the displacement that a beam tracks to the peak displacement at the focus.

    u_tracked / u_peak = prod_i 1 / sqrt(1 + S_i^2 / E_i^2)      Gaussian motion of sigmas E_i

These are eqs. (8) and (12) of the paper. Echoes are weighted by their energy: S_i = T_i / sqrt(2) across, T_i the
sigmas of the tracking beam; along the axis S_i is the standard deviation of echo depth in the gate. A shear wave is
broader than the force that drives it, so its displacement loses less than the Gaussian motion of eq. (12), and the
tracked displacement lags the peak.

    BeamWidths, beam_averaging_factor             Gaussian motion: dense scatterers; few of them in a short gate
    tracked_motion, off_axis_motion               shear field of a medium, on the axis and off it
    tracked_ratio                                 under a force that is not Gaussian
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np

from hpe_rig.arrays import ComplexArray, FloatArray
from hpe_rig.medium.focal_field import FINE_DIRECTIONS, focal_displacement
from hpe_rig.medium.gate_echoes import TrackingGate, Triple
from hpe_rig.medium.material_laws import HarmonicMedium
from hpe_rig.medium.push_force import PushForce

WIDTH_SCALES = (0.05, 1e3)
"""Range of the scale of a Gaussian motion's width; at the upper end the tracked motion equals the peak to 1e-7."""


@dataclass(frozen=True, slots=True)
class BeamWidths:
    """Sigmas (x, y, z) of the Gaussian body force and of the tracking beam's amplitude, m; both are round, so x counts.

    ``depth_sd_m``: standard deviation of echo depth in the gate. ``width_log_sd``: standard deviation of the logarithm
    of the force's widths, which are not measured in the medium. ``lateral_offset_m``: offset of the tracking beam
    from the force. ``offsets_of_joint_fit_m``: all offsets of a run, this one included; their ensembles are computed at
    once. ``force``: the force's shape if it is not Gaussian, used on the axis only.
    """

    force_width_m: Triple
    tracking_width_m: Triple
    depth_sd_m: float
    width_log_sd: float = 0.3
    lateral_offset_m: float = 0.0
    offsets_of_joint_fit_m: tuple[float, ...] = ()
    force: PushForce | None = None

    @property
    def tracking_variance_m2(self) -> float:
        """Variance of the tracking beam's echo energy along x, or along y: T^2 / 2, in proportion to its area."""
        return self.tracking_width_m[0] ** 2 / 2

    def gaussian_averaging(self) -> float:
        """Return tracked over peak displacement for a Gaussian motion among many scatterers, eq. (12) of the paper.

        The motion has the widths of the force (E in the paper). Tracking beam and gate average over it.
        """
        return float(np.prod([1 / np.hypot(1, echo_m / motion_m) for echo_m, motion_m in self._gaussian_sigmas_m()]))

    def _gaussian_sigmas_m(self) -> list[tuple[float, float]]:
        """Return, by axis, the sigma S of the echo energy and the sigma E of the force."""
        # The energy is the beam's amplitude squared, hence T / sqrt(2) across; ``depth_sd_m`` is of the energy already.
        echo_sigmas_m = [width / np.sqrt(2) for width in self.tracking_width_m[:2]] + [self.depth_sd_m]
        return list(zip(echo_sigmas_m, self.force_width_m, strict=True))

    def gaussian_steepness(self) -> float:
        """Return the derivative of ln(``gaussian_averaging``) by the logarithm of the tracking beam's area.

        It gives the effect of speckle, which weights the beam unevenly and so changes its effective area.
        """
        # Derivative of ln prod 1 / sqrt(1 + S^2 / E^2) by ln S^2, with S^2 = T^2 / 2 along x and y.
        pairs = zip(self.tracking_width_m[:2], self.force_width_m[:2], strict=True)
        variance_ratios = [tracking_m**2 / 2 / force_m**2 for tracking_m, force_m in pairs]
        return -sum(ratio / (1 + ratio) for ratio in variance_ratios) / 2

    def width_scale(self, averaging: float) -> float:
        """Return the factor on the force's widths, within ``WIDTH_SCALES``, that gives this ``gaussian_averaging``."""
        # With x = 1 / scale**2, 1 / averaging**2 is the product of 1 + (echo sigma / motion sigma)**2 x over the axes.
        polynomial = np.polynomial.Polynomial([1.0])
        for echo_m, motion_m in self._gaussian_sigmas_m():
            polynomial *= np.polynomial.Polynomial([1.0, (echo_m / motion_m) ** 2])
        # It rises from 1 with x, so that the largest real part of a root belongs to the only positive root.
        inverse_square = float(np.max(np.real((polynomial - averaging**-2).roots())))
        narrowest, widest = WIDTH_SCALES
        return float(np.clip(inverse_square**-0.5, narrowest, widest)) if inverse_square > 0 else widest


TrackedMotion = tuple[ComplexArray, ComplexArray, ComplexArray]
"""Tracked and peak displacement, complex (frequency, ...), and steepness (effect, frequency, ...).

All are up to one real factor, with the time factor exp(+jwt). The steepness has the derivatives of the tracked
displacement by the quantities that speckle changes: the logarithm of the tracking beam's area and, off the axis of the
force, the beam's offset over its radius T / sqrt(2). Speckle changes both independently with one standard deviation:
that of N equal echoes is 1 / sqrt(N) for both."""


def tracked_motion(medium: HarmonicMedium, beams: BeamWidths) -> TrackedMotion:
    """Return tracked and peak displacement (frequency,) in ``medium``, and the effects of speckle on the former.

    The effects (effect, frequency) are derivatives by the area of the tracking beam and, at a lateral offset of
    ``beams``, by its position: ``TrackedMotion``. The force is Gaussian. Averaging over a Gaussian beam of variance
    T^2 / 2 equals tracking at a point under a wider force: T^2 / 2 is added to the force's variance, and its spectrum
    over wave numbers keeps its height.
    """
    if beams.lateral_offset_m:
        tracked, peak, steepness = off_axis_motion(medium, beams, np.array([beams.lateral_offset_m]))
        return tracked[:, 0], peak[:, 0], steepness[..., 0]
    variance_m2 = beams.tracking_variance_m2
    across_m2, along_m2 = beams.force_width_m[0] ** 2, beams.force_width_m[2] ** 2
    # Rows: the force widened by the tracking beam, for the tracked displacement, and the force itself, for the peak.
    (tracked, peak), (by_variance, _) = focal_displacement(
        np.stack([medium.shear_k2, medium.shear_k2]),
        np.array([across_m2 + variance_m2, across_m2]),
        np.array([along_m2 + beams.depth_sd_m**2, along_m2]),
        FINE_DIRECTIONS,
    )
    # The area is proportional to the variance: d / d ln(area) = variance d / d(variance).
    by_area = variance_m2 * by_variance
    # The closed form is the displacement times the modulus.
    return tracked / medium.modulus_pa, peak / medium.modulus_pa, by_area[None] / medium.modulus_pa


def off_axis_motion(medium: HarmonicMedium, beams: BeamWidths, lateral_m: FloatArray) -> TrackedMotion:
    """Return tracked and peak displacement (frequency, offset), and the effects of speckle on the former.

    The beam is at the distances ``lateral_m`` (offset,) from the force's axis; the peak is the displacement at that
    point. All are per unit of body force. Speckle changes area and position of the tracked region. Its effects (effect,
    frequency, offset) are therefore two derivatives of the tracked displacement: by ln(area), then by a shift of the
    beam in units of its radius (``TrackedMotion``).
    """
    # A function-level import: a prescribed motion has no medium and must not load SciPy.
    from hpe_rig.medium.shear_field import focal_plane_motion

    # Averaging over the beam equals a force that is wider by the beam's variances across and along.
    (x_m, _, z_m), variance_m2 = beams.force_width_m, beams.tracking_variance_m2
    tracked, by_variance, by_distance = focal_plane_motion(
        medium, (x_m, z_m), x_m**2 + variance_m2, z_m**2 + beams.depth_sd_m**2, lateral_m
    )
    peak, *_ = focal_plane_motion(medium, (x_m, z_m), x_m**2, z_m**2, lateral_m)
    # The area is proportional to the variance: d / d ln(area) = variance d / d(variance).
    by_area, by_offset = variance_m2 * by_variance, np.sqrt(variance_m2) * by_distance
    return tracked, peak, np.stack([by_area, by_offset])


def tracked_ratio(medium: HarmonicMedium, force: PushForce, beams: BeamWidths) -> ComplexArray:
    """Return tracked over peak displacement (frequency,) under ``force``, of any shape, at the offset of ``beams``."""
    modulus, frequency = tuple(medium.modulus_pa.tolist()), tuple(medium.frequency_hz.tolist())
    return np.array(_tracked_ratio(modulus, frequency, medium.density_kg_per_m3, force, beams))


@functools.lru_cache(maxsize=16)
def _tracked_ratio(
    modulus_pa: tuple[complex, ...],
    frequency_hz: tuple[float, ...],
    density: float,
    force: PushForce,
    beams: BeamWidths,
) -> tuple[complex, ...]:
    """Return tracked over peak displacement (frequency,) under ``force`` in a medium of moduli ``modulus_pa``.

    Arguments and result are tuples so that they can be cached.
    """
    from hpe_rig.medium.shear_field import TrackedRegion, shear_motion

    medium, offset_m = HarmonicMedium(np.array(frequency_hz), np.array(modulus_pa), density), beams.lateral_offset_m
    beam = TrackedRegion(
        lateral_m=np.array([offset_m]), across_m2=beams.tracking_variance_m2, along_m2=beams.depth_sd_m**2
    )
    tracked, peak = (
        shear_motion(medium, force, region).value[:, 0] for region in (beam, TrackedRegion(np.array([offset_m])))
    )
    return tuple((tracked / peak).tolist())


def beam_averaging_factor(force_width_m: Triple, gate: TrackingGate, scatterers_per_m3: float = np.inf) -> float:
    """Return the expected tracked over peak displacement of a Gaussian motion, for coaxial beams focused mid-gate.

    ``force_width_m`` and the gate's tracking widths are the sigmas E and T of eqs. (12) and (8) of the paper. Each
    scatterer has the energy of its echo as weight: factors 1 / sqrt(1 + T^2 / (2 E^2)) across, a sum over depths along.
    Two corrections of leading order, each below 1 %: few independent speckles in the gate, and few scatterers if their
    density is finite.
    """
    # Echo envelopes (instant of the gate, depth), and the energy from each depth.
    depth_m, echo = gate.echoes()
    energy = np.sum(echo**2, axis=0)
    axial_motion = np.asarray(np.exp(-(depth_m**2) / (2 * force_width_m[2] ** 2)))
    squared_ratios = [(t / e) ** 2 for e, t in zip(force_width_m[:2], gate.tracking_width_m[:2], strict=True)]
    lateral_mean = _lateral_mean(squared_ratios, weight_power=2)
    # Mean motion over many scatterers, weighted by echo energy.
    mean = lateral_mean * (energy @ axial_motion) / energy.sum()
    # Squared elements of the energy matrix M = echo' echo of the depths.
    overlap = (echo.T @ echo) ** 2
    # Mean motion over the depths with the energies squared, which few scatterers approach.
    mean_of_squares = _lateral_mean(squared_ratios, weight_power=4) * (energy**2 @ axial_motion) / np.sum(energy**2)
    scatterers = _effective_scatterers(gate, depth_m, energy, scatterers_per_m3)
    scatterer_error = _completeness(energy, overlap) * (mean_of_squares - mean) / scatterers
    return float(float(mean - scatterer_error) - _speckle_error(energy, overlap, lateral_mean * axial_motion))


def _lateral_mean(squared_ratios: list[float], weight_power: int) -> float:
    """Return the mean of u / u_0 over x and y, with the tracking beam's intensity to ``weight_power`` as weight.

    ``squared_ratios`` are (T / E)^2 along x and y.
    """
    return float(np.prod([1 / np.sqrt(1 + square / weight_power) for square in squared_ratios]))


def _effective_scatterers(
    gate: TrackingGate, depth_m: FloatArray, energy: FloatArray, scatterers_per_m3: float
) -> float:
    """Return the effective number of scatterers, (sum w)^2 / sum w^2, with the energies w of their echoes.

    w is ``energy`` (depth,) times the square of the tracking beam's intensity across.
    """
    area_m2 = 4 * np.pi * gate.tracking_width_m[0] * gate.tracking_width_m[1] / 2
    depth_step_m = depth_m[1] - depth_m[0]
    return float(scatterers_per_m3 * area_m2 * energy.sum() ** 2 / np.sum(energy**2) * depth_step_m)


def _completeness(energy: FloatArray, overlap: FloatArray) -> float:
    """Return the factor on the correction for few scatterers: 1 for many independent speckles, 1/2 for one.

    The number of independent speckles is tr(M)^2 / tr(M^2), with M the energy matrix of the depths. ``energy`` (depth,)
    is its diagonal, ``overlap`` (depth, depth) has its squared elements.
    """
    speckles = energy.sum() ** 2 / overlap.sum()
    return float(1 - 1 / (2 * speckles))


def _speckle_error(energy: FloatArray, overlap: FloatArray, motion: FloatArray) -> float:
    """Return the error of the energy-weighted mean of ``motion`` (depth,) as expected for few independent speckles.

    ``overlap`` (depth, depth): squared elements of the energy matrix. It replaces the squared weights in the correction
    for few scatterers, -sum w^2 (u - mean) / (sum w)^2, because the echoes of neighbouring depths overlap.
    """
    deviation = motion - energy @ motion / energy.sum()
    return float((overlap.sum(axis=0) @ deviation) / energy.sum() ** 2)
