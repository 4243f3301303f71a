"""Methods for plane and cylindrical waves, on waves of known phase velocity and attenuation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import hankel2

from hpe_rig.arrays import FloatArray
from hpe_rig.moduli.wave_methods import (
    METHODS,
    LateralField,
    WaveMethod,
    amplitude_decay,
    peak_wavenumber,
    phase_velocity_map,
)
from hpe_rig.result import BadPixel, MotionMap

FREQUENCY_HZ = np.arange(100.0, 701.0, 100.0)
OFFSET_M = np.array([1.0, 2.0, 3.5, 4.5, 6.0]) * 1e-3
SPEED = 2.0 + FREQUENCY_HZ / 1000.0
ATTENUATION = 0.2 * FREQUENCY_HZ
SPEED_METHODS = [pytest.param(method, id=method.name) for method in METHODS if not method.is_attenuation]


def field_of(phasor: np.ndarray, offset_m: FloatArray = OFFSET_M) -> LateralField:
    """Return ``phasor`` (..., offset, frequency) as a field without missing values."""
    return LateralField(offset_m, FREQUENCY_HZ, phasor, np.ones(phasor.shape[-2:], np.bool_))


def plane_wave(speed: FloatArray = SPEED) -> np.ndarray:
    wavenumber = 2 * np.pi * FREQUENCY_HZ / speed - 1j * ATTENUATION
    return np.asarray(800e-9 * np.exp(0.3j - 1j * np.outer(OFFSET_M, wavenumber)))


@pytest.mark.parametrize("method", SPEED_METHODS)
def test_the_speed_of_a_plane_wave_is_exact(method: WaveMethod) -> None:
    # All harmonics are equally fast: a Stockwell transform mixes neighbours, and GST-SFK follows their dispersion.
    speed = np.full(FREQUENCY_HZ.size, 2.7) if method.name == "GST-SFK" else SPEED
    assert method.estimate(field_of(plane_wave(speed))) == pytest.approx(speed, rel=1e-9)


def test_gst_sfk_of_one_frequency_is_the_spectral_maximum() -> None:
    wave, methods = plane_wave()[:, 3:4], {method.name: method for method in METHODS}
    field = LateralField(OFFSET_M, FREQUENCY_HZ[3:4], wave, np.ones(wave.shape, np.bool_))
    assert methods["GST-SFK"].estimate(field) == pytest.approx(methods["2-D FT"].estimate(field), rel=1e-12)


def test_gst_sfk_excludes_a_wave_that_passes_at_another_time() -> None:
    """Where a harmonic has neighbours on both sides, Stockwell's window of a period excludes a wave 5 ms later."""
    offset_m, wavenumber = np.linspace(1e-3, 6e-3, 6), 2 * np.pi * FREQUENCY_HZ / 2.7
    later = np.exp(-1j * np.outer(0.4 * offset_m, wavenumber) - 2j * np.pi * FREQUENCY_HZ * 5e-3)
    field = field_of(np.exp(-1j * np.outer(offset_m, wavenumber)) + 0.7 * later, offset_m)
    errors = {method.name: abs(method.estimate(field)[2:6] / 2.7 - 1).max() for method in METHODS}
    assert errors["GST-SFK"] < 0.05
    assert errors["2-D FT"] > 0.2


def test_the_decay_of_a_cylindrical_wave_is_exact_where_its_amplitude_falls_with_the_root_of_distance() -> None:
    wave = plane_wave() / np.sqrt(OFFSET_M[:, None])
    assert amplitude_decay(field_of(wave)) == pytest.approx(ATTENUATION, rel=1e-9)


@pytest.mark.parametrize("method", METHODS, ids=lambda method: method.name)
def test_a_far_hankel_wave_is_cylindrical(method: WaveMethod) -> None:
    """H0^(2)(kr) has the phase -kr + pi/4 + 1/8kr and the amplitude sqrt(2/pi kr), each to the next order of 1/kr."""
    offset_m = OFFSET_M + 40e-3
    wavenumber = 2 * np.pi * FREQUENCY_HZ / 2.7 - 20j
    field = field_of(np.asarray(hankel2(0, np.outer(offset_m, wavenumber))), offset_m)
    # The phase has the relative slope 1 + 1/8(kr)^2, ln(|u| sqrt(r)) has 1 + 1/8(kr)^2 + 1/8 alpha r (kr)^2.
    true, terms = (20.0, 1 + 1 / (20.0 * offset_m[0])) if method.is_attenuation else (2.7, 1.0)
    next_order = terms / (8 * (wavenumber.real * offset_m[0]) ** 2)
    assert np.all(abs(method.estimate(field) / true - 1) < 1.1 * next_order)


def test_a_hankel_wave_near_its_axis_has_the_slope_of_its_phase() -> None:
    """The phase gradient of near points is the derivative of the phase of H0^(2), 2 / (pi r |H0|^2): DLMF 10.18."""
    wavenumber, offset_m = 2 * np.pi * FREQUENCY_HZ / 2.7, np.array([0.999e-3, 1e-3, 1.001e-3])
    field = field_of(np.asarray(hankel2(0, np.outer(offset_m, wavenumber))), offset_m)
    gradient = 2 / (np.pi * 1e-3 * abs(hankel2(0, wavenumber * 1e-3)) ** 2)
    assert METHODS[0].estimate(field) == pytest.approx(2 * np.pi * FREQUENCY_HZ / gradient, rel=1e-5)


def test_missing_offsets_are_left_out_and_many_fields_are_analysed_together() -> None:
    wave, present = plane_wave(), np.ones((OFFSET_M.size, FREQUENCY_HZ.size), np.bool_)
    present[-1, 4] = False
    fields = np.stack([wave, 2 * wave, wave.conj()])
    fields[:, ~present] = 0
    for method in METHODS[:2]:
        speed = method.estimate(LateralField(OFFSET_M, FREQUENCY_HZ, fields, present))
        assert speed[:2] == pytest.approx(np.stack([SPEED, SPEED]), rel=1e-9)
        # An inward wave has no phase velocity.
        if method.name == "phase gradient":
            assert np.isnan(speed[2]).all()


def test_the_spectral_maximum_is_between_the_wave_numbers_of_the_search() -> None:
    for k in (0.123, 333.3, 1234.5):
        assert peak_wavenumber(OFFSET_M, np.exp(-1j * k * OFFSET_M)) == pytest.approx(k, rel=1e-9)


def two_media_map(bad: tuple[int, int] = (15, 1)) -> MotionMap:
    """Return a map of a plane wave from the push at 0 mm, of 2 m/s to 6 mm and of 3 m/s beyond, on both sides."""
    frequency_hz, line_m = np.array([200.0, 500.0]), np.arange(-60, 61) * 0.2e-3
    distance_m = np.abs(line_m)
    slowness_m = np.minimum(distance_m, 6e-3) / 2.0 + np.maximum(distance_m - 6e-3, 0) / 3.0
    phase = -2 * np.pi * frequency_hz * slowness_m[:, None, None] + np.zeros((1, 2, 1))
    amplitude = np.broadcast_to(np.exp(-100 * distance_m)[:, None, None] * 1e-6, phase.shape)
    marks = np.zeros(phase.shape[:2], np.uint8)
    marks[bad] = BadPixel.NOISE
    pixel, zero = np.zeros(phase.shape[:2]), np.zeros(phase.shape)
    rows = (frequency_hz, line_m, np.array([60e-3, 61e-3]), amplitude, zero, phase, zero, pixel, pixel, pixel, pixel)
    return MotionMap(*rows, bad=marks, lines_are_placed=True)


def test_a_map_has_the_local_phase_velocity_of_two_media() -> None:
    """Windows of 2 mm inside one medium are exact; at the boundary, 6 mm from the push, c is between the two speeds."""
    motion_map = two_media_map()
    speed = phase_velocity_map(motion_map, 2e-3)
    distance_m = np.round(np.abs(motion_map.line_m), 9)
    first, second = (distance_m >= 1e-3) & (distance_m <= 5e-3), (distance_m >= 7e-3) & (distance_m <= 11e-3)
    assert speed[first] == pytest.approx(np.full((first.sum(), 2, 2), 2.0), rel=1e-9)
    expected = np.full((second.sum(), 2, 2), 3.0)
    expected[np.flatnonzero(second) == 15, 1] = np.nan
    # The window of a neighbour lacks the bad pixel, which changes nothing in a plane wave.
    assert speed[second] == pytest.approx(expected, rel=1e-9, nan_ok=True)
    assert np.isnan(speed[(distance_m < 1e-3) | (distance_m > 11e-3)]).all()
    assert np.all(abs(speed[distance_m == 6e-3] - 2.5) < 0.4)


def test_a_map_without_positions_or_with_a_narrow_window_is_refused() -> None:
    with pytest.raises(ValueError, match=r"no positions\. Try: line_pitch_m"):
        phase_velocity_map(replace(two_media_map(), lines_are_placed=False), 2e-3)
    with pytest.raises(ValueError, match=r"no 3 lines of the map are within 0\.0003 m"):
        phase_velocity_map(two_media_map(), 0.3e-3)
