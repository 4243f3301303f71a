"""The pulse-echo beam against the bowl's field, point by point, and the echo it makes against a Fourier transform."""

import numpy as np
import pytest

from sim_backend.echoes import EchoDelays, beam_response, hann_pulse, synthesise, waveform
from sim_backend.echoes.pulse import gaussian_pulse
from sim_backend.settings import SimulationSettings, Transducer
from sim_backend.transducer import bowl_pressure, pulse_echo_beam, wave_number

APERTURE = SimulationSettings.model_validate(
    {"beams": {"field": "aperture"}, "scatterers": {"attenuation_db_per_cm_mhz": 0.5}}
)
SPEED = APERTURE.sound_speed_m_per_s


def plain_share(frequency_hz: float, lateral_m: float, axial_m: float) -> complex:
    """Return the echo's share of the focus' at one frequency, without the plane wave's delay."""
    k = wave_number(frequency_hz, SPEED, 0.5)
    there, focus = (
        bowl_pressure(Transducer(), k, np.array([r]), np.array([z]))[0, 0]
        for r, z in ((lateral_m, axial_m), (0.0, 0.0))
    )
    return complex((there / focus) ** 2 * np.exp(2j * k.real * axial_m))


def test_the_table_is_the_square_of_the_bowls_field() -> None:
    beam = pulse_echo_beam(APERTURE, (8.0e6, 9.0e6), 0.8e-3, 2.6e-3)
    rng = np.random.default_rng(1)
    lateral_m, axial_m = rng.uniform(0, 0.8e-3, 8), rng.uniform(-2.6e-3, 2.6e-3, 8)
    response, _ = beam.at(lateral_m, axial_m)
    for row, frequency_hz in enumerate((8.0e6, 9.0e6)):
        for n in range(8):
            assert abs(response[row, n] - plain_share(frequency_hz, lateral_m[n], axial_m[n])) < 2e-6
    assert np.abs(beam.at(np.zeros(1), np.zeros(1))[0] - 1).max() < 1e-6


def test_obliquity_reduces_the_delay_of_a_displacement() -> None:
    beam = pulse_echo_beam(APERTURE, (9.0e6,), 0.3e-3, 1.0e-3)
    for lateral_m, axial_m in ((0.0, 0.0), (0.05e-3, 0.4e-3)):
        _, sensed = beam.at(np.array([lateral_m]), np.array([axial_m]))
        ahead, behind = (plain_share(9.0e6, lateral_m, axial_m + step) for step in (1e-7, -1e-7))
        turned = np.angle(ahead / behind) / 2e-7 / (2 * 2 * np.pi * 9.0e6 / SPEED)
        assert sensed[0] == pytest.approx(1 - turned, abs=2e-4)
    # A bowl's waves arrive under up to 18.7 degrees: their mean cosine is (1 + cos) / 2.
    assert beam.at(np.zeros(1), np.zeros(1))[1][0] == pytest.approx((1 + np.sqrt(1 - (22.5 / 70) ** 2)) / 2, abs=2e-3)


def test_the_echo_off_the_axis_is_that_of_every_frequency_on_its_own() -> None:
    pulse, points_m = gaussian_pulse(9.0e6, 0.3), np.array([[0.12e-3, 0.0, 0.7e-3]])
    time_s = np.arange(-100, 101) * 1e-8
    beam = beam_response(APERTURE, points_m, pulse)
    delays = EchoDelays(2 * points_m[:, 2] / SPEED, np.zeros((1, 1)), np.zeros((1, 1)), beam.response)
    echo = synthesise(delays, beam.weight, pulse, time_s).echo[0]
    # The pulse on a long period, every line of its spectrum through the beam.
    grid_s = (np.arange(4096) - 2048) * 2e-9
    lines_hz = np.fft.rfftfreq(4096, 2e-9)
    spectrum = np.fft.rfft(np.fft.ifftshift(waveform(pulse, grid_s)))
    strong = np.flatnonzero(np.abs(spectrum) > 1e-5 * np.abs(spectrum).max())
    through = np.zeros(len(lines_hz), complex)
    for line in strong:
        through[line] = spectrum[line] * plain_share(lines_hz[line], 0.12e-3, 0.7e-3)
    turn = np.exp(2j * np.pi * np.outer(time_s - 2 * 0.7e-3 / SPEED, lines_hz[strong]))
    expected = 2 / 4096 * (turn @ through[strong]).real
    assert np.abs(echo - expected).max() < 1e-4 * np.abs(expected).max()


def test_every_evaluation_gives_the_same_echoes_of_an_aperture() -> None:
    rng = np.random.default_rng(2)
    points_m = rng.uniform(-0.5, 0.5, (300, 3)) * [1e-3, 1e-3, 3e-3]
    points_m = points_m[np.argsort(points_m[:, 2])]
    pulse, time_s = hann_pulse(9.0e6, 0.065), (np.arange(130) - 65) * 1e-8
    beam = beam_response(APERTURE, points_m, pulse)
    moved_s = 2e-6 / SPEED * np.sin(np.arange(150))[:, None]
    delays = EchoDelays(2 * points_m[:, 2] / SPEED, beam.delay_ratio[None], moved_s, beam.response)
    exact = synthesise(delays, beam.weight, pulse, time_s, 0.0).echo
    # As written: pulse by pulse, each line of it with the scatterer's own share.
    plain = np.zeros(130)
    for n, tau in enumerate(delays.delay_s()[7]):
        lit = (time_s >= tau + pulse.start_s) & (time_s < tau + pulse.end_s)
        for line, (hz, amplitude) in enumerate(zip(pulse.frequency_hz, pulse.amplitude, strict=True)):
            wave = amplitude * beam.response[line, n] * np.exp(2j * np.pi * hz * (time_s - tau))
            plain += beam.weight[n] * np.where(lit, wave.real, 0.0)
    assert np.abs(exact[7] - plain).max() < 1e-12 * np.abs(plain).max()
    series = synthesise(delays, beam.weight, pulse, time_s, 1e-6, "series").echo
    assert np.sqrt(np.mean((series - exact) ** 2) / np.mean(exact**2)) < 1e-6


def test_all_mistakes_of_an_aperture_are_reported_at_once() -> None:
    with pytest.raises(ValueError, match="centre of curvature") as error:
        SimulationSettings.model_validate(
            {
                "beams": {"field": "aperture", "focus_depth_m": 60e-3},
                "scatterers": {"axial_delay": "none", "reflectors": [{"kind": "plane"}]},
            }
        )
    assert "plane among" in str(error.value)
    assert "has no depths" in str(error.value)
    with pytest.raises(ValueError, match="half a sphere"):
        SimulationSettings.model_validate({"beams": {"transducer": {"diameter_m": 0.15}}})
