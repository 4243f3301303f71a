"""Force, pressures and heat of the push over drive with nonlinear propagation, tabulated once for a scene.

    surface pressure -> nonlinear_beam -> force field -> equivalent force density F

F is the density of a Gaussian force with the widths of the push beam that causes the same static displacement at the
focus as the force field. It replaces the square of the drive in the twin's force. The surface pressure at the reference
drive is the one that gives the specimen's ``force_density_n_per_m3``. See docs/explanation/nonlinear.md, section 3.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from functools import lru_cache

import numpy as np

from sim_backend.arrays import BoolArray, FloatArray
from sim_backend.settings import Propagation, SimulationSettings, Specimen, Transducer
from sim_backend.transducer.burgers import Layer
from sim_backend.transducer.nonlinear import Accuracy, Beam, largest_table, nonlinear_beam

Triple = tuple[float, float, float]

# Largest table of a march, in values at the focus; the tables before it take several times as much.
_MAX_TABLE_VALUES = 20_000_000
# Surface pressures over the one that gives the reference force without nonlinearity; the lowest is linear to 1e-3.
LEVELS = (0.02, 0.2, 0.35, 0.5, 0.65, 0.8, 1.0)


@dataclass(frozen=True, slots=True)
class Push:
    """The push at ascending surface pressures; every array (level,)."""

    surface_pa: FloatArray
    """Pressure amplitude rho c u0 at the surface of the bowl."""
    force_n_per_m3: FloatArray
    """Equivalent force density F of the Gaussian push beam."""
    peak_force_n_per_m3: FloatArray
    """Largest force density, at the strongest shock: far above F."""
    positive_pa: FloatArray
    """Peak positive pressure."""
    negative_pa: FloatArray
    """Peak negative pressure."""
    sppa_w_per_m2: FloatArray
    """Largest intensity during a toneburst."""
    heat_w_per_m3: FloatArray
    """Largest heating rate during a toneburst."""

    def at(self, surface_pa: FloatArray) -> Push:
        """Return force, pressures and heat of the push at ``surface_pa`` (level,), interpolated from the table.

        Interpolated are the logarithms, so that the values continue as power laws outside the table.
        """
        log_table, log_surface = np.log(self.surface_pa), np.log(surface_pa)
        log_values = (np.log(getattr(self, field.name)) for field in fields(self))
        return Push(*(np.exp(_interpolated(log_table, log_value, log_surface)) for log_value in log_values))

    def relative_force(self, pressure: FloatArray, force_density_n_per_m3: float) -> FloatArray:
        """Return the force at relative pressures, as a multiple of ``force_density_n_per_m3``.

        ``pressure`` is relative to the surface pressure that gives that force.
        """
        reference_pa = self.surface_for(force_density_n_per_m3)
        with np.errstate(divide="ignore"):
            log_force = self._log_force(np.log(pressure * reference_pa))
        return np.asarray(np.exp(log_force) / force_density_n_per_m3)

    def surface_for(self, force_density_n_per_m3: float) -> float:
        """Return the surface pressure that gives this force density; raise ``ValueError`` if no drive reaches it.

        Loss in shocks can limit the force.
        """
        from scipy.optimize import brentq

        low, high = math.log(self.surface_pa[0]) - 20, math.log(self.surface_pa[-1]) + 5
        target, largest = math.log(force_density_n_per_m3), float(self._log_force(np.array(high)))
        if not float(self._log_force(np.array(low))) < target < largest:
            raise ValueError(
                f"no drive makes a force density of {force_density_n_per_m3:.3g} N/m^3 with this nonlinear "
                f"propagation, which ends at {math.exp(largest):.3g} N/m^3"
            )
        return math.exp(brentq(lambda x: float(self._log_force(np.array(x))) - target, low, high, xtol=1e-12))

    def exponent(self, force_density_n_per_m3: float) -> float:
        """Return the power of the force as a function of drive², at this force; 1 for linear propagation."""
        log_surface, step = math.log(self.surface_for(force_density_n_per_m3)), 0.05
        low, high = (float(self._log_force(np.array(log_surface + side * step))) for side in (-1, 1))
        power_of_drive = (high - low) / (2 * step)
        return power_of_drive / 2

    def _log_force(self, log_surface: FloatArray) -> FloatArray:
        """Return the logarithm of the force at logarithms of the surface pressure."""
        from scipy.interpolate import PchipInterpolator

        log_table = np.log(self.surface_pa)
        # Interpolate force over pressure squared: constant below the table, with the last slope above it.
        gain = np.log(self.force_n_per_m3) - 2 * log_table
        inside = PchipInterpolator(log_table, gain)(np.clip(log_surface, log_table[0], log_table[-1]))
        slope = (gain[-1] - gain[-2]) / (log_table[-1] - log_table[-2])
        return np.asarray(inside + slope * np.maximum(log_surface - log_table[-1], 0) + 2 * log_surface)


def _interpolated(table: FloatArray, value: FloatArray, at: FloatArray) -> FloatArray:
    """Return the monotone cubic through ``value`` at the ascending points ``table``, evaluated at ``at``, any shape.

    Outside the table it continues as a line, with the slope between the two outermost points.
    """
    from scipy.interpolate import PchipInterpolator

    inside = np.clip(at, table[0], table[-1])
    first_slope = (value[1] - value[0]) / (table[1] - table[0])
    last_slope = (value[-1] - value[-2]) / (table[-1] - table[-2])
    extrapolation = np.where(at < inside, first_slope, last_slope) * (at - inside)
    return np.asarray(PchipInterpolator(table, value)(inside) + extrapolation)


def push_of(settings: SimulationSettings, carrier_hz: float = 3.0e6) -> Push | None:
    """Return force, pressures and heat of the push over drive; None without nonlinear propagation.

    Computed once for the same arguments. Raises ``ValueError`` if it would take too much memory.
    """
    specimen, propagation = settings.specimen, settings.propagation
    if specimen is None or propagation is None:
        return None
    beams = settings.beams
    layers = path(specimen, propagation, settings.sound_speed_m_per_s, beams.focus_depth_m)
    reference_n_per_m3, width_m = specimen.force_density_n_per_m3, beams.excitation_width_m
    return _push(tuple(layers), propagation.harmonics, reference_n_per_m3, beams.transducer, width_m, carrier_hz)


@dataclass(frozen=True, slots=True)
class WaterOutput:
    """Acoustic output in water, as a hydrophone would measure it, not derated."""

    positive_pa: float
    """Peak positive pressure."""
    negative_pa: float
    """Peak negative pressure."""
    sppa_w_per_m2: float
    """Largest intensity during a toneburst."""


def water_output(settings: SimulationSettings, surface_pa: float, carrier_hz: float = 3.0e6) -> WaterOutput:
    """Return peak pressures and intensity of the transducer in water, at a surface pressure of ``surface_pa``.

    They include harmonics and shocks, in the water of ``settings.propagation``, and are computed once for a pressure.
    Raises ``ValueError`` without nonlinear propagation in the settings.
    """
    if settings.propagation is None:
        raise ValueError("no nonlinear propagation is declared. Try: [simulation.propagation]")
    transducer, speed_m_per_s = settings.beams.transducer, settings.sound_speed_m_per_s
    return _water_output(transducer, settings.propagation, speed_m_per_s, surface_pa, carrier_hz)


@lru_cache(maxsize=512)
def _water_output(
    transducer: Transducer, propagation: Propagation, speed_m_per_s: float, surface_pa: float, carrier_hz: float
) -> WaterOutput:
    """Return the peak pressures and the intensity of the beam in water, as a hydrophone would measure them.

    ``surface_pa``: pressure amplitude at the surface of the transducer.
    """
    _check_memory(transducer, speed_m_per_s / carrier_hz, propagation.harmonics)
    layer = _water_layer(propagation, speed_m_per_s, math.inf)
    beam = nonlinear_beam(transducer, [layer], carrier_hz, surface_pa, Accuracy(propagation.harmonics))
    # Peaks count from half the focal length on: a hydrophone is not placed closer to the bowl.
    in_reach = beam.depth_m > transducer.focal_length_m / 2
    return WaterOutput(*_peaks(beam, in_reach))


def _peaks(beam: Beam, selected: BoolArray) -> tuple[float, float, float]:
    """Return the peak positive and negative pressures and the largest intensity at the ``selected`` depths."""
    positive_pa, negative_pa = beam.extremes_pa()
    intensity = beam.intensity_w_per_m2()
    return float(positive_pa[selected].max()), float(negative_pa[selected].max()), float(intensity[selected].max())


# A table takes seconds to compute and some hundred bytes, so all values of a sweep are cached. The arguments exclude
# the moduli of the medium, on which it does not depend.
@lru_cache(maxsize=512)
def _push(
    layers: tuple[Layer, ...],
    harmonics: int,
    force_density_n_per_m3: float,
    transducer: Transducer,
    width_m: Triple,
    carrier_hz: float,
) -> Push:
    """Return force, heat and peak pressures of the push at several surface pressures around the reference force.

    ``force_density_n_per_m3``: reference force. ``width_m``: sigmas of the Gaussian force that replaces the beam's.
    """
    _check_memory(transducer, layers[0].sound_speed_m_per_s / carrier_hz, harmonics)
    start_m, speed_m_per_s = layers[0].thickness_m, layers[-1].sound_speed_m_per_s

    def force(beam: Beam) -> float:
        """Return the force density of the Gaussian force that moves the focus as the beam does."""
        return equivalent_force(beam, transducer.focal_length_m, width_m, start_m)

    # Surface pressures relative to the one that gives the reference force in linear propagation.
    linear_pa = 1e4
    linear_n_per_m3 = force(nonlinear_beam(transducer, layers, carrier_hz, linear_pa, Accuracy(harmonics=4)))
    surface_pa = linear_pa * math.sqrt(force_density_n_per_m3 / linear_n_per_m3) * np.array(LEVELS)
    rows = []
    for level_pa in surface_pa:
        beam = nonlinear_beam(transducer, layers, carrier_hz, float(level_pa), Accuracy(harmonics))
        in_specimen = beam.depth_m > start_m
        heat = beam.heat_w_per_m3[in_specimen].max()
        rows.append((force(beam), heat / speed_m_per_s, *_peaks(beam, in_specimen), heat))
    return Push(surface_pa, *np.array(rows).T)


def _check_memory(transducer: Transducer, wavelength_m: float, harmonics: int) -> None:
    """Raise ``ValueError`` if waves are too short relative to the bowl, or too many, for the memory limit."""
    ratio = largest_table(transducer, wavelength_m, harmonics) / _MAX_TABLE_VALUES
    if ratio > 1:
        raise ValueError(
            f"{harmonics} harmonics of waves {wavelength_m * 1e3:.3g} mm long, from a bowl of "
            f"{transducer.diameter_m * 1e3:.3g} mm, would take {ratio:.2g} times the memory that a push may"
        )


def path(specimen: Specimen, propagation: Propagation, speed_m_per_s: float, focus_m: float) -> list[Layer]:
    """Return the layers that the push crosses: water, then the specimen, with the twin's common sound speed."""
    water = _water_layer(propagation, speed_m_per_s, focus_m - propagation.specimen_depth_m)
    medium = Layer(
        thickness_m=math.inf,
        sound_speed_m_per_s=speed_m_per_s,
        density_kg_per_m3=specimen.density_kg_per_m3,
        nonlinearity=propagation.nonlinearity,
        attenuation_db_per_cm_mhz=specimen.attenuation_db_per_cm_mhz,
        attenuation_power=propagation.attenuation_power,
    )
    return [water, medium]


def _water_layer(propagation: Propagation, speed_m_per_s: float, thickness_m: float) -> Layer:
    """Return a layer of the water that couples transducer and specimen; it attenuates with the frequency squared."""
    return Layer(
        thickness_m=thickness_m,
        sound_speed_m_per_s=speed_m_per_s,
        density_kg_per_m3=propagation.water_density_kg_per_m3,
        nonlinearity=propagation.water_nonlinearity,
        attenuation_db_per_cm_mhz=propagation.water_attenuation_db_per_cm_mhz2,
        attenuation_power=2.0,
    )


def equivalent_force(beam: Beam, focus_m: float, width_m: Triple, start_m: float) -> float:
    """Return the peak density of a Gaussian force of sigmas ``width_m`` with the same effect as the force of ``beam``.

    Both forces, summed beyond the depth ``start_m``, displace the focus equally in the static case. A point force along
    z at a distance R displaces an incompressible elastic medium in proportion to (1 + z²/R²) / R (Kelvin).
    """
    depth_m, lateral_m, volume_m3, force_n_per_m3 = beam.force_at[:, beam.force_at[0] > start_m]
    z_m = depth_m - focus_m
    distance_m = np.hypot(lateral_m, z_m)
    displacement = volume_m3 * (1 + (z_m / distance_m) ** 2) / distance_m
    lateral_width_m, _, axial_width_m = width_m
    gaussian = np.exp(-0.5 * ((lateral_m / lateral_width_m) ** 2 + (z_m / axial_width_m) ** 2))
    # Both sums use the same nodes, so the error from the singularity at R = 0 largely cancels in their ratio.
    return float((displacement * force_n_per_m3).sum() / (displacement * gaussian).sum())
