"""Radiation force at the focus: the square of the pressure, rectified and low-passed, eq. (17) of the paper.

drive voltage -> linear power stage -> transducer at the carrier -> pressure² -> body force

F / F_ref = (p / p_ref)²
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from sim_backend.arrays import FloatArray, Int64Array
from sim_backend.settings import SimulationSettings, Specimen
from sim_backend.wiring import PS_PER_S, Bursts, to_ps

ForceScale = Callable[[FloatArray, FloatArray], FloatArray]
"""Force over the reference force, from pressure over the reference pressure and carrier in Hz, all (pulse,)."""


@dataclass(frozen=True, slots=True)
class ForcePulses:
    """Rectangular pulses of body force at the focus; every array has shape (pulse,)."""

    onset_ps: Int64Array
    end_ps: Int64Array
    force_density_n_per_m3: FloatArray


def transmit_response(frequency_hz: FloatArray, resonance_hz: float, quality: float) -> FloatArray:
    """Return the transducer's pressure per volt at ``frequency_hz``, relative to its resonance: one damped mode.

    The single mode has no third harmonic. Its quality factor follows from the one published figure (see `Specimen`).
    """
    ratio = frequency_hz / resonance_hz
    return np.asarray(1 / np.hypot(1.0, quality * (ratio - 1 / ratio)))


def radiation_force(
    tonebursts: Bursts,
    specimen: Specimen,
    travel_time_s: float,
    force_scale: ForceScale | None = None,
) -> ForcePulses:
    """Return the pulses of body force at the focus, one while each toneburst passes it, eq. (17) of the paper.

    ``travel_time_s`` is z_F/c. The force is the mean over the carrier, so a burst that the generator cuts short gives a
    shorter pulse of the same height. With nonlinear propagation ``force_scale``, a function of relative pressure and
    carrier, replaces the square of the pressure. A specimen that changes is simulated by its force: later pulses are
    stronger (``growth_per_s``) and delayed (``delay_growth_s_per_s``).
    """
    # Pressure over that of the reference drive at resonance.
    pressure = tonebursts.amplitude_vpp / specimen.reference_drive_vpp
    pressure *= transmit_response(tonebursts.carrier_hz, specimen.resonance_hz, specimen.resonance_quality)
    relative_force = np.square(pressure) if force_scale is None else force_scale(pressure, tonebursts.carrier_hz)
    delay_ps = np.full(tonebursts.onset_ps.shape, to_ps(travel_time_s))
    if tonebursts.onset_ps.size and (specimen.growth_per_s or specimen.delay_growth_s_per_s):
        elapsed_ps = tonebursts.onset_ps - tonebursts.onset_ps[0]
        relative_force = relative_force * (1 + specimen.growth_per_s * elapsed_ps / PS_PER_S)
        delay_ps += np.rint(specimen.delay_growth_s_per_s * elapsed_ps).astype(np.int64)
    return ForcePulses(
        tonebursts.onset_ps + delay_ps,
        tonebursts.end_ps + delay_ps,
        specimen.force_density_n_per_m3 * relative_force,
    )


def force_scale(settings: SimulationSettings) -> ForceScale | None:
    """Return the function from pressure to force, both over their reference values, for nonlinear propagation.

    None for linear propagation, where the force is the square of the pressure.
    """
    specimen = settings.specimen
    if settings.propagation is None or specimen is None:
        return None

    def relative_force(pressure_ratio: FloatArray, carrier_hz: FloatArray) -> FloatArray:
        """Return the force over ``specimen.force_density_n_per_m3``, (burst,), of bursts with nonlinear propagation.

        ``pressure_ratio`` (burst,): pressure at the transducer over the one that gives this force density.
        """
        from sim_backend.transducer import push_of

        force = np.zeros_like(pressure_ratio)
        # The beam is computed once for each carrier, and then cached.
        for hz in np.unique(carrier_hz):
            push, selected = push_of(settings, float(hz)), carrier_hz == hz
            if push is not None:
                force[selected] = push.relative_force(pressure_ratio[selected], specimen.force_density_n_per_m3)
        return force

    return relative_force
