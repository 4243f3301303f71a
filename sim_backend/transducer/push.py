"""Push over drive: what nonlinear propagation makes of force, pressures and heat, tabulated once for a scene.

    surface pressure -> nonlinear_beam -> force field -> the force density F that, with the widths of the push beam,
                                                         moves the focus as far as that field does at rest

F replaces drive^2 in the twin's force. The surface's pressure at the reference drive follows from the specimen's
``force_density_n_per_m3``, which holds there. docs/explanation/nonlinear.md, section 3.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from functools import lru_cache

import numpy as np

from sim_backend.arrays import FloatArray
from sim_backend.settings import Propagation, SimulationSettings, Specimen, Transducer
from sim_backend.transducer.burgers import Layer
from sim_backend.transducer.nonlinear import Accuracy, Beam, largest_table, nonlinear_beam

Triple = tuple[float, float, float]

# Values that the largest table of a march may have foreseen at its focus; those before it take some times as much.
_MOST_VALUES = 20_000_000
# Surface pressures over the one that would do without nonlinearity; the lowest is linear to 1e-3.
LEVELS = (0.02, 0.2, 0.35, 0.5, 0.65, 0.8, 1.0)


@dataclass(frozen=True, slots=True)
class Push:
    """The push at rising surface pressures, every array (level,)."""

    surface_pa: FloatArray
    """Pressure amplitude rho c u0 of the bowl's surface."""
    force_n_per_m3: FloatArray
    """Force density of the Gaussian push beam that moves the focus as far at rest."""
    peak_force_n_per_m3: FloatArray
    """Largest force density, where the shock is strongest: far above the former."""
    positive_pa: FloatArray
    """Peak positive pressure."""
    negative_pa: FloatArray
    """Peak negative pressure."""
    sppa_w_per_m2: FloatArray
    """Largest intensity while a toneburst is on."""
    heat_w_per_m3: FloatArray
    """Largest heating rate while a toneburst is on."""

    def at(self, surface_pa: FloatArray) -> Push:
        """Return the push at these surface pressures (level,): by monotone cubics in logarithms, powers beyond."""
        from scipy.interpolate import PchipInterpolator

        known, wanted = np.log(self.surface_pa), np.log(surface_pa)
        inside = np.clip(wanted, known[0], known[-1])

        def there(name: str) -> FloatArray:
            value = np.log(getattr(self, name))
            slopes = (value[1] - value[0]) / (known[1] - known[0]), (value[-1] - value[-2]) / (known[-1] - known[-2])
            beyond = np.where(wanted < inside, slopes[0], slopes[1]) * (wanted - inside)
            return np.asarray(np.exp(PchipInterpolator(known, value)(inside) + beyond))

        return Push(*(there(each.name) for each in fields(self)))

    def relative_force(self, pressure: FloatArray, force_density_n_per_m3: float) -> FloatArray:
        """Return the force over ``force_density_n_per_m3`` at ``pressure`` over that of the drive which makes it."""
        reference_pa = self.surface_for(force_density_n_per_m3)
        with np.errstate(divide="ignore"):
            log_force = self._log_force(np.log(pressure * reference_pa))
        return np.asarray(np.exp(log_force) / force_density_n_per_m3)

    def surface_for(self, force_density_n_per_m3: float) -> float:
        """Return the surface pressure that makes this force; raise ``ValueError`` where none does.

        Shocks lose what more drive adds: beyond the table the force may stop growing.
        """
        from scipy.optimize import brentq

        low, high = math.log(self.surface_pa[0]) - 20, math.log(self.surface_pa[-1]) + 5
        wanted, most = math.log(force_density_n_per_m3), float(self._log_force(np.array(high)))
        if not float(self._log_force(np.array(low))) < wanted < most:
            raise ValueError(
                f"no drive makes a force density of {force_density_n_per_m3:.3g} N/m^3 with this nonlinear "
                f"propagation, which ends at {math.exp(most):.3g} N/m^3"
            )
        return math.exp(brentq(lambda x: float(self._log_force(np.array(x))) - wanted, low, high, xtol=1e-12))

    def exponent(self, force_density_n_per_m3: float) -> float:
        """Return d ln force / d ln drive^2 where the push makes this force: 1 where propagation is linear."""
        at, step = math.log(self.surface_for(force_density_n_per_m3)), 0.05
        low, high = (float(self._log_force(np.array(at + side * step))) for side in (-1, 1))
        return (high - low) / (4 * step)

    def _log_force(self, log_pressure: FloatArray) -> FloatArray:
        from scipy.interpolate import PchipInterpolator

        known = np.log(self.surface_pa)
        gain = np.log(self.force_n_per_m3) - 2 * known
        # Below the table the push is linear; above, it goes on with its last slope.
        inside = PchipInterpolator(known, gain)(np.clip(log_pressure, known[0], known[-1]))
        slope = (gain[-1] - gain[-2]) / (known[-1] - known[-2])
        return np.asarray(inside + slope * np.maximum(log_pressure - known[-1], 0) + 2 * log_pressure)


def push_of(settings: SimulationSettings, carrier_hz: float = 3.0e6) -> Push | None:
    """Return the push of a scene over drive, None where it asks for no nonlinear propagation; computed once.

    Raises ``ValueError`` where it would take too much memory.
    """
    specimen, propagation = settings.specimen, settings.propagation
    if specimen is None or propagation is None:
        return None
    beams = settings.beams
    layers = path(specimen, propagation, settings.sound_speed_m_per_s, beams.focus_depth_m)
    own = beams.transducer, beams.excitation_width_m, carrier_hz
    return _push(tuple(layers), propagation.harmonics, specimen.force_density_n_per_m3, *own)


@dataclass(frozen=True, slots=True)
class WaterOutput:
    """Acoustic output in water, as a hydrophone would measure it: nothing derated."""

    positive_pa: float
    """Peak positive pressure."""
    negative_pa: float
    """Peak negative pressure."""
    sppa_w_per_m2: float
    """Largest intensity while a toneburst is on."""


def water_output(settings: SimulationSettings, surface_pa: float, carrier_hz: float = 3.0e6) -> WaterOutput:
    """Return the output of a scene's transducer in water, driven to ``surface_pa``; raise ``ValueError`` without one.

    With the water of ``settings.propagation``, harmonics and shocks included; computed once for a pressure.
    """
    if settings.propagation is None:
        raise ValueError("no nonlinear propagation is declared. Try: [simulation.propagation]")
    return _water(settings.beams.transducer, settings.propagation, settings.sound_speed_m_per_s, surface_pa, carrier_hz)


@lru_cache(maxsize=512)
def _water(
    transducer: Transducer, propagation: Propagation, speed_m_per_s: float, surface_pa: float, carrier_hz: float
) -> WaterOutput:
    _refuse_too_many(transducer, speed_m_per_s / carrier_hz, propagation.harmonics)
    layer = _water_layer(propagation, speed_m_per_s, math.inf)
    beam = nonlinear_beam(transducer, [layer], carrier_hz, surface_pa, Accuracy(propagation.harmonics))
    # The bowl's own edge is no place that a hydrophone comes to.
    near = beam.depth_m > transducer.focal_length_m / 2
    positive_pa, negative_pa = beam.extremes_pa()
    peaks = positive_pa[near].max(), negative_pa[near].max(), beam.intensity_w_per_m2()[near].max()
    return WaterOutput(*(float(each) for each in peaks))


# Seconds for a table of some hundred bytes: kept for every value of a sweep. By what it depends on alone, so that a
# sweep of the medium's moduli computes none anew.
@lru_cache(maxsize=512)
def _push(
    layers: tuple[Layer, ...],
    harmonics: int,
    force_density_n_per_m3: float,
    transducer: Transducer,
    width_m: Triple,
    carrier_hz: float,
) -> Push:
    _refuse_too_many(transducer, layers[0].sound_speed_m_per_s / carrier_hz, harmonics)
    start_m, speed_m_per_s = layers[0].thickness_m, layers[-1].sound_speed_m_per_s

    def force(beam: Beam) -> float:
        return equivalent_force(beam, transducer.focal_length_m, width_m, start_m)

    linear_pa = 1e4
    linear = force(nonlinear_beam(transducer, layers, carrier_hz, linear_pa, Accuracy(harmonics=4)))
    surface_pa = linear_pa * math.sqrt(force_density_n_per_m3 / linear) * np.array(LEVELS)
    rows = []
    for each_pa in surface_pa:
        beam = nonlinear_beam(transducer, layers, carrier_hz, float(each_pa), Accuracy(harmonics))
        inside = beam.depth_m > start_m
        positive_pa, negative_pa = beam.extremes_pa()
        heat = beam.heat_w_per_m3[inside].max()
        peaks = positive_pa[inside].max(), negative_pa[inside].max(), beam.intensity_w_per_m2()[inside].max()
        rows.append((force(beam), heat / speed_m_per_s, *peaks, heat))
    return Push(surface_pa, *np.array(rows).T)


def _refuse_too_many(transducer: Transducer, wavelength_m: float, harmonics: int) -> None:
    """Raise ``ValueError`` where waves are so short beside the bowl, or so many, that memory would not hold them."""
    more = largest_table(transducer, wavelength_m, harmonics) / _MOST_VALUES
    if more > 1:
        raise ValueError(
            f"{harmonics} harmonics of waves {wavelength_m * 1e3:.3g} mm long, from a bowl of "
            f"{transducer.diameter_m * 1e3:.3g} mm, would take {more:.2g} times the memory that a push may"
        )


def path(specimen: Specimen, propagation: Propagation, speed_m_per_s: float, focus_m: float) -> list[Layer]:
    """Return what the push goes through: water, then the specimen, with one sound speed as everywhere in the twin."""
    water = _water_layer(propagation, speed_m_per_s, focus_m - propagation.specimen_depth_m)
    loss = specimen.attenuation_db_per_cm_mhz
    own = specimen.density_kg_per_m3, propagation.nonlinearity, loss, propagation.attenuation_power
    return [water, Layer(math.inf, speed_m_per_s, *own)]


def _water_layer(propagation: Propagation, speed_m_per_s: float, thickness_m: float) -> Layer:
    own = propagation.water_density_kg_per_m3, propagation.water_nonlinearity
    return Layer(thickness_m, speed_m_per_s, *own, propagation.water_attenuation_db_per_cm_mhz2, 2.0)


def equivalent_force(beam: Beam, focus_m: float, width_m: Triple, start_m: float) -> float:
    """Return the force density of a Gaussian of ``width_m`` that moves the focus at rest as far as ``beam`` does.

    Both forces on the same nodes from ``start_m`` on, each with what a point force along z moves at a distance R in an
    incompressible elastic medium, (1 + z^2/R^2) / R (Kelvin): what the nodes leave out of its pole is left out of both.
    """
    depth_m, lateral_m, volume_m3, force = beam.force_at[:, beam.force_at[0] > start_m]
    z = depth_m - focus_m
    distance_m = np.hypot(lateral_m, z)
    moved = volume_m3 * (1 + (z / distance_m) ** 2) / distance_m
    x, _, along = width_m
    gaussian = np.exp(-0.5 * ((lateral_m / x) ** 2 + (z / along) ** 2))
    return float((moved * force).sum() / (moved * gaussian).sum())
