"""The echo pulse that the settings ask for, and what attenuation on the way to the focus and back makes of it."""

from __future__ import annotations

import functools

import numpy as np

from sim_backend.echoes.pulse import Pulse, attenuated, band_limited_burst, gaussian_pulse, hann_pulse, sampled_pulse
from sim_backend.settings import SimulationSettings

_BURST_CYCLES = 3.0


def echo_pulse(settings: SimulationSettings, carrier_hz: float) -> Pulse:
    """Return the echo of one scatterer at the focus for a tracking pulse of ``carrier_hz``, eq. (9) or its like.

    With attenuation its strength falls and, but for the Hann pulse's own support, its centre frequency with it, by
    alpha L sigma_f^2 for a Gaussian spectrum of variance sigma_f^2 (alpha L in Np/Hz).
    """
    scatterers = settings.scatterers
    pulse = _pulse(scatterers.pulse, carrier_hz, scatterers.bandwidth, scatterers.band_centre_hz)
    if scatterers.measured_pulse is not None:
        rate_hz, samples = scatterers.measured_pulse_rate_hz, scatterers.measured_pulse
        pulse = sampled_pulse(np.array(samples), rate_hz, -(len(samples) - 1) / 2 / rate_hz)
    return behind_the_way(settings, pulse)


def behind_the_way(settings: SimulationSettings, pulse: Pulse) -> Pulse:
    """Return ``pulse`` after the loss to the focus and back."""
    scatterers = settings.scatterers
    if scatterers.attenuation_db_per_cm_mhz == 0:
        return pulse
    way_cm = 2 * settings.beams.focus_depth_m * 100
    return attenuated(pulse, scatterers.attenuation_db_per_cm_mhz * way_cm / 1e6)


@functools.lru_cache(maxsize=64)
def _pulse(kind: str, carrier_hz: float, bandwidth: float, band_centre_hz: float) -> Pulse:
    if kind == "gaussian":
        return gaussian_pulse(carrier_hz, bandwidth)
    if kind == "burst":
        return band_limited_burst(carrier_hz, _BURST_CYCLES, band_centre_hz, bandwidth)
    return hann_pulse(carrier_hz, bandwidth)
