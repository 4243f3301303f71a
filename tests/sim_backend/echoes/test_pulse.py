"""Pulses as sums of exponentials: each against its own formula."""

import numpy as np
import pytest
from scipy.special import erf

from sim_backend.echoes.pulse import (
    attenuated,
    band_limited_burst,
    echo_pulse,
    extended,
    gaussian_pulse,
    hann_pulse,
    phasors,
    waveform,
)
from sim_backend.settings import SimulationSettings

SIGMA_OVER_WIDTH = 1 / (2 * np.sqrt(2 * np.log(2)))


@pytest.mark.parametrize("bandwidth", [0.001, 0.065, 0.75, 2.0])
@pytest.mark.parametrize("tolerance", [1e-4, 1e-10])
def test_gaussian_pulse_is_a_cosine_under_a_gaussian(bandwidth, tolerance):
    pulse = gaussian_pulse(9.0e6, bandwidth, tolerance)
    sigma_hz = bandwidth * 9.0e6 * SIGMA_OVER_WIDTH
    time_s = np.linspace(1.5 * pulse.start_s, 1.5 * pulse.end_s, 4001)
    expected = np.exp(-0.5 * (2 * np.pi * sigma_hz * time_s) ** 2) * np.cos(2 * np.pi * 9.0e6 * time_s)
    # Cut in time at the tolerance and in frequency where the rest is below it.
    assert np.abs(waveform(pulse, time_s) - expected).max() < 2 * tolerance


def test_gaussian_spectrum_is_half_at_the_band_edges():
    pulse = gaussian_pulse(9.0e6, 0.4, 1e-12)
    time_s = np.arange(-4000, 4000) * 1e-9
    at = np.exp(-2j * np.pi * np.outer([9.0e6, 7.2e6, 10.8e6], time_s)) @ waveform(pulse, time_s)
    assert np.abs(at[1:] / at[0]) == pytest.approx(0.5, rel=1e-6)


def test_burst_through_a_band_is_the_convolution_of_both():
    """A complex burst under a Gaussian impulse response has an error function in closed form."""
    centre_hz, carrier_hz, bandwidth = 6.0e6, 9.0e6, 0.6
    pulse = band_limited_burst(carrier_hz, 3.0, centre_hz, bandwidth, 1e-12)
    s = 2 * np.pi * bandwidth * centre_hz * SIGMA_OVER_WIDTH
    w0, wc, length_s = 2 * np.pi * carrier_hz, 2 * np.pi * centre_hz, 3.0 / carrier_hz
    time_s = np.linspace(-0.3e-6, 0.7e-6, 401)
    # h(t) = 2 s/sqrt(2 pi) exp(-s^2 t^2 / 2) cos(wc t); convolved with sin(w0 t) on [0, length].
    total = np.zeros(len(time_s))
    for sign in (1, -1):
        d = w0 - sign * wc
        z = [(s * (time_s - edge) + 1j * d / s) / np.sqrt(2) for edge in (0.0, length_s)]
        total += (np.exp(1j * w0 * time_s) * np.exp(-(d**2) / (2 * s**2)) * (erf(z[0]) - erf(z[1])) / 2).imag
    assert waveform(pulse, time_s) == pytest.approx(total, abs=1e-9)


def test_attenuation_lowers_the_centre_frequency_of_a_gaussian_by_alpha_sigma_squared():
    """exp(-(f - f0)^2 / 2 s^2) exp(-a f) is the same Gaussian about f0 - a s^2, lower by exp(-a f0 + a^2 s^2 / 2)."""
    sigma_hz = 0.2 * 9.0e6 * SIGMA_OVER_WIDTH
    loss_db_per_hz = 20.0 / 9.0e6
    a = loss_db_per_hz * np.log(10) / 20
    source = gaussian_pulse(9.0e6, 0.2, 1e-13)
    pulse = attenuated(source, [loss_db_per_hz * hz for hz in source.frequency_hz])
    time_s = np.linspace(-1e-6, 1e-6, 2001)
    lower_hz = 9.0e6 - a * sigma_hz**2
    expected = np.exp(-a * 9.0e6 + (a * sigma_hz) ** 2 / 2) * np.exp(-0.5 * (2 * np.pi * sigma_hz * time_s) ** 2)
    # The Gaussian's cut at 1e-13, raised by what attenuation favours: exp(a 7.7 sigma) = 5; at 0 Hz, where
    # the loss has a kink, the spectrum is 12 sigma out.
    assert waveform(pulse, time_s) == pytest.approx(expected * np.cos(2 * np.pi * lower_hz * time_s), abs=1e-12)


def test_phasors_of_evenly_spaced_frequencies_equal_each_on_its_own():
    time_s = np.random.default_rng(0).uniform(-5e-6, 5e-6, 500)
    for pulse in (hann_pulse(9.0e6, 0.065), gaussian_pulse(9.0e6, 2.0, 1e-13)):
        omega = 2 * np.pi * np.array(pulse.frequency_hz)
        expected = np.exp(-1j * np.multiply.outer(omega, time_s))
        # Phases below 1000 rad rounded once, up to 16 products: 16 (1000 + 2) eps at worst, some 1e-13 in fact.
        assert np.abs(phasors(pulse, time_s, -1) - expected).max() < 1e-12


def test_extended_pulse_equals_the_pulse_inside_its_support():
    pulse = hann_pulse(9.0e6, 0.065)
    time_s = np.linspace(pulse.start_s, pulse.end_s, 100, endpoint=False)
    assert np.array_equal(extended(pulse, time_s), waveform(pulse, time_s))


def in_gelatin(depth_m: float | None, **scatterers: object) -> SimulationSettings:
    specimen = {"preset": "gelatin_8", "depth_m": depth_m}
    return SimulationSettings.model_validate({"specimen": specimen, "scatterers": scatterers})


def test_echoes_have_the_two_way_loss_of_specimen_and_water():
    """0.5 dB/cm/MHz over 1.25 cm of gelatin, 0.0018 dB/cm/MHz^2 over 5.75 cm of water, twice."""
    settings = in_gelatin(12.5e-3)
    assert settings.loss_to_focus_db(9.0e6) == pytest.approx(2 * (0.5 * 1.25 * 9 + 0.0018 * 5.75 * 81), rel=1e-12)
    assert settings.loss_to_focus_db(3.0e6) == pytest.approx(2 * (0.5 * 1.25 * 3 + 0.0018 * 5.75 * 9), rel=1e-12)
    assert in_gelatin(None).loss_to_focus_db(9.0e6) == 0
    assert settings.echo_attenuation_db_per_cm_mhz == 0.5


def test_the_centre_frequency_falls_with_the_depth_of_the_specimen():
    """By the slope of the loss at the carrier times the variance of the amplitude spectrum; the water's bends it."""
    sigma_hz = 0.3 * 9.0e6 * SIGMA_OVER_WIDTH

    def centre_hz(depth_m: float | None) -> float:
        pulse = echo_pulse(in_gelatin(depth_m, pulse="gaussian", bandwidth=0.3), 9.0e6)
        strength = np.abs(pulse.amplitude)
        return float(strength @ np.array(pulse.frequency_hz) / strength.sum())

    for depth_m in (12.5e-3, 30e-3):
        loss_db = in_gelatin(depth_m).loss_to_focus_db
        slope = (loss_db(9.001e6) - loss_db(8.999e6)) / 2e3 * np.log(10) / 20
        assert centre_hz(None) - centre_hz(depth_m) == pytest.approx(slope * sigma_hz**2, rel=0.02)
