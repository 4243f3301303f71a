"""Phase velocity and attenuation by methods for plane and cylindrical waves, for comparison with the near-field fit.

    phase gradient    c = -w / (dphi/dr) by regression: Chen, Fatemi, Greenleaf (2004), JASA 115, 2781
    2-D FT            c = w / k at the maximum of |sum_r u(r, f) exp(jkr)|: Alleyne, Cawley (1991), JASA 89, 1159;
                      of shear waves: Bernal, Nenadic, Urban, Greenleaf (2011), JASA 129, 1344
    GST-SFK           the same spectrum of Stockwell transforms at the times t + r/v: Serdyukov and others (2019),
                      Geophysics 84, A19; of shear waves: Kijanka, Urban (2021), IEEE TMI 40, 1352
    LPVI              the same spectrum in short windows: Kijanka, Urban (2019), IEEE TMI 38, 894
    amplitude decay   alpha = -d ln(|u| sqrt(r)) / dr, a cylindrical wave: Deffieux and others (2009), IEEE TMI 28, 313

Fourier transforms over time are replaced by the harmonics: the motion is periodic. All phases are those of outward
waves exp(-jkr), which fall with distance.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hpe_rig.arrays import BoolArray, ComplexArray, FloatArray
from hpe_rig.result import MotionMap

WINDOW_OFFSETS = 3
"""Lateral offsets in a window of local phase velocity imaging: the fewest that have a neighbour on each side."""
WAVENUMBERS_PER_OFFSET, NEWTON_STEPS = 8, 5
"""Wave numbers of the search for a spectral maximum, at least 16 in its width, and Newton steps from the highest."""
TIMES, GROUP_SPEEDS = 16, 25
"""Times in a burst period and group velocities among which GST-SFK selects."""
STOCKWELL_WIDTH = 1.0
"""Standard deviation of the Stockwell transform's time window, in periods; 1 is the original transform."""


@dataclass(frozen=True, slots=True, eq=False)
class LateralField:
    """Phasors (..., offset, frequency) of one or more fields at ``offset_m`` > 0 from the push, in rising order.

    ``present`` (offset, frequency): whether there is a phasor, 0 otherwise. The first field selects the parameters of a
    method, so that the others are analysed in the same way.
    """

    offset_m: FloatArray
    frequency_hz: FloatArray
    phasor: ComplexArray
    present: BoolArray


@dataclass(frozen=True, slots=True)
class WaveMethod:
    """A method: ``estimate`` returns phase velocity (m/s), or attenuation (Np/m) if ``is_attenuation``.

    The result is (..., frequency), NaN where no wave runs outward. ``needs_sampling``: neighbouring offsets must be at
    most half a wavelength apart.
    """

    name: str
    estimate: Callable[[LateralField], FloatArray]
    is_attenuation: bool = False
    needs_sampling: bool = True


@dataclass(frozen=True, slots=True, eq=False)
class MethodCurve:
    """Result of one method with standard uncertainties, each (frequency,): m/s, or Np/m if ``is_attenuation``.

    NaN where the method has no value. ``predicted``: result of the same method from the exact field of the fitted
    medium, without noise. ``bias`` is the difference of ``predicted`` from the fitted medium.
    """

    name: str
    is_attenuation: bool
    value: FloatArray
    uncertainty: FloatArray
    predicted: FloatArray
    bias: FloatArray


def phase_gradient(field: LateralField) -> FloatArray:
    """Return the phase velocity (..., frequency) from the regression of the phase on distance."""

    def slope(offset_m: FloatArray, phasor: ComplexArray) -> FloatArray:
        """Return the slope (...) of the phase (..., offset) that is unwrapped from offset to offset, rad/m."""
        return _slope(offset_m, np.unwrap(np.angle(phasor), axis=-1))

    return _outward_speed(field, -_by_frequency(field, slope))


def spectral_maximum(field: LateralField) -> FloatArray:
    """Return the phase velocity (..., frequency) from the maximum of the spatial Fourier transform."""
    return _outward_speed(field, _by_frequency(field, peak_wavenumber))


def slant_spectral_maximum(field: LateralField) -> FloatArray:
    """Return the phase velocity (..., frequency), m/s, from spatial spectra of Stockwell transforms of a wave packet.

    The Stockwell transform is the motion at frequency f in a time window about t. For a periodic motion with the
    harmonics U(f_n) and a window of s periods it is

        S(t, f) = sum_n U(f_n) exp(-2 (pi s (f_n - f) / f)^2 + 2 pi j (f_n - f) t).

    The window follows a packet that starts at t_0 and runs with the group velocity v: at the offset r its time is
    t = t_0 + r / v, a slanted line over r. It excludes waves that pass at other times. Of all candidates (t_0, v) the
    one with the highest maximum of the spatial spectrum is used. The first field selects it for all fields, so that all
    are analysed in the same way.
    """
    frequency_hz = field.frequency_hz
    steps_hz = np.diff(frequency_hz, prepend=0.0)
    start_s = np.arange(TIMES) / TIMES / steps_hz[steps_hz > 0].min()
    # From a third to three times the phase velocity of the plain spectrum, on a logarithmic scale.
    relative_speed = np.geomspace(1 / 3, 3, GROUP_SPEEDS)
    first_field_speed = spectral_maximum(field).reshape(-1, frequency_hz.size)[0]
    wavenumber = np.full((*field.phasor.shape[:-2], frequency_hz.size), np.nan)
    for index, (hz, speed) in enumerate(zip(frequency_hz, first_field_speed, strict=True)):
        present = field.present[:, index]
        if not np.isfinite(speed):
            continue
        offset_m = field.offset_m[present]
        # Harmonics (..., offset, harmonic) in the window of the transform about this frequency.
        window = np.exp(-2 * (np.pi * STOCKWELL_WIDTH * (frequency_hz / hz - 1)) ** 2)
        harmonics = (field.phasor * window)[..., present, :]
        # Times t_0 + r / v for all starts and group velocities, (candidate, offset).
        travel_s = offset_m / (speed * relative_speed[:, None])
        time_s = (travel_s[None] + start_s[:, None, None]).reshape(-1, offset_m.size)
        # Transforms of the first field along the line of each candidate, (candidate, offset), and their spatial
        # spectra, (candidate, k). The candidate with the highest maximum is the best one.
        shift_hz = frequency_hz - hz
        first_field = harmonics.reshape(-1, *harmonics.shape[-2:])[0]
        transform = np.sum(first_field * np.exp(2j * np.pi * shift_hz * time_s[..., None]), axis=-1)
        _, waves = _candidate_waves(offset_m)
        best = np.abs(transform @ waves).max(axis=-1).argmax()
        # The transforms (..., offset) of all fields along the line of that candidate.
        phase_factor = np.exp(2j * np.pi * shift_hz * time_s[best, :, None])
        wavenumber[..., index] = peak_wavenumber(offset_m, np.sum(harmonics * phase_factor, axis=-1))
    return _outward_speed(field, wavenumber)


def local_spectral_maximum(field: LateralField) -> FloatArray:
    """Return the mean local phase velocity (..., frequency): spatial spectra in windows of a few offsets."""

    def mean_wavenumber(offset_m: FloatArray, phasor: ComplexArray) -> FloatArray:
        """Return the wave number (...) of the mean speed in all windows of ``phasor`` (..., offset).

        NaN if a window has no outward wave.
        """
        taper = np.hanning(WINDOW_OFFSETS + 2)[1:-1]
        # Several runs may have the same offset: a window contains all their phasors.
        distinct_m, index = np.unique(offset_m, return_inverse=True)
        wavenumbers = []
        for first in range(distinct_m.size - WINDOW_OFFSETS + 1):
            in_window = (index >= first) & (index < first + WINDOW_OFFSETS)
            tapered = taper[index[in_window] - first] * phasor[..., in_window]
            wavenumbers.append(peak_wavenumber(offset_m[in_window], tapered))
        outward = np.where(np.array(wavenumbers) > 0, wavenumbers, np.nan)
        # The speed is inversely proportional to the wave number.
        return np.asarray(1 / np.mean(1 / outward, axis=0))

    return _outward_speed(field, _by_frequency(field, mean_wavenumber))


def amplitude_decay(field: LateralField) -> FloatArray:
    """Return the attenuation (..., frequency), Np/m, of a cylindrical wave from the decay of its amplitude."""

    def decay(offset_m: FloatArray, phasor: ComplexArray) -> FloatArray:
        """Return the decay (...) of the amplitude (..., offset) without that by geometric spreading, Np/m."""
        return -_slope(offset_m, np.log(np.abs(phasor) * np.sqrt(offset_m)))

    return _by_frequency(field, decay)


METHODS = (
    WaveMethod("phase gradient", phase_gradient),
    WaveMethod("2-D FT", spectral_maximum),
    WaveMethod("GST-SFK", slant_spectral_maximum),
    WaveMethod("LPVI", local_spectral_maximum),
    WaveMethod("amplitude decay", amplitude_decay, is_attenuation=True, needs_sampling=False),
)


def peak_wavenumber(offset_m: FloatArray, phasor: ComplexArray) -> FloatArray:
    """Return the wave number k (...) in rad/m where the spatial spectrum of ``phasor`` (..., offset) is highest.

    The spectrum is |sum_r u(r) exp(jkr)|, up to the wave number with two samples in a wavelength.
    """
    wavenumbers, waves = _candidate_waves(offset_m)
    k = wavenumbers[np.abs(phasor @ waves).argmax(axis=-1)]
    # Newton's method on |F|^2: about the middle of the offsets, so that F varies slowly.
    distance_m = offset_m - offset_m.mean()
    for _ in range(NEWTON_STEPS):
        terms = phasor * np.exp(1j * k[..., None] * distance_m)
        # F and its derivatives by k; then half of the derivatives of |F|^2.
        value, first, second = (np.sum(terms * (1j * distance_m) ** order, axis=-1) for order in range(3))
        slope = (value.conj() * first).real
        curvature = (np.abs(first) ** 2) + (value.conj() * second).real
        k = k - np.divide(slope, curvature, out=np.zeros_like(slope), where=curvature < 0)
    return np.asarray(k)


def phase_velocity_map(motion_map: MotionMap, window_m: float) -> FloatArray:
    """Return the local phase velocity (line, depth, frequency), m/s, in a map of waves that run away from the push.

    Local phase velocity imaging, along the lines at each depth: the maximum of the spatial spectrum in a tapered window
    of width ``window_m``, which is centred at every line. The value is NaN for a bad pixel, if the window crosses the
    axis of the push or the edge of the map, and without an outward wave. Lines must be at most half a wavelength apart.
    Raises ``ValueError`` if the lines have no positions or no window holds three of them.

    >>> speed = hpe.phase_velocity_map(motion_map, window_m=3e-3)
    >>> matplotlib.pyplot.imshow(speed[..., 0].T)
    """
    line_m = motion_map.line_m
    if not motion_map.lines_are_placed:
        raise ValueError(
            "the lines of the map have no positions. Try: line_pitch_m or line_position_m of the recording"
        )
    lines = [np.flatnonzero(np.abs(line_m - centre_m) < window_m / 2) for centre_m in line_m]
    if max(map(len, lines)) < WINDOW_OFFSETS:
        raise ValueError(f"no {WINDOW_OFFSETS} lines of the map are within {window_m:g} m. Try: a wider window_m")
    is_bad = (motion_map.bad != 0)[..., None]
    phasor = np.where(is_bad, 0, motion_map.amplitude_m * np.exp(1j * motion_map.phase_rad))
    wavenumber = np.full(phasor.shape, np.nan)
    for index, (centre_m, window) in enumerate(zip(line_m, lines, strict=True)):
        inside = line_m.min() <= centre_m - window_m / 2 and centre_m + window_m / 2 <= line_m.max()
        if not inside or abs(centre_m) < window_m / 2 or window.size < WINDOW_OFFSETS:
            continue
        # Lines in rising distance from the push; the taper is a Hann window.
        window = window[np.argsort(np.abs(line_m[window]))]
        taper = np.cos(np.pi * (line_m[window] - centre_m) / window_m) ** 2
        tapered = np.moveaxis(phasor[window], 0, -1) * taper
        wavenumber[index] = peak_wavenumber(np.abs(line_m[window]), tapered)
    omega = 2 * np.pi * motion_map.frequency_hz
    is_outward = ~is_bad & (wavenumber > 0)
    return np.where(is_outward, omega / np.where(is_outward, wavenumber, 1.0), np.nan)


def _candidate_waves(offset_m: FloatArray) -> tuple[FloatArray, ComplexArray]:
    """Return wave numbers k (k,), rad/m, from 0 to two offsets in a wavelength, and exp(jkr) for offset r, (offset, k).

    The product of phasors (..., offset) with the second array is their spatial spectrum (..., k).
    """
    wavenumbers = np.linspace(0, np.pi / np.diff(offset_m).max(), WAVENUMBERS_PER_OFFSET * offset_m.size)
    return wavenumbers, np.exp(1j * np.outer(offset_m, wavenumbers))


def _by_frequency(field: LateralField, estimate: Callable[[FloatArray, ComplexArray], FloatArray]) -> FloatArray:
    """Return ``estimate`` (...) of the offsets (offset,) and phasors (..., offset) that are present, by frequency."""
    pairs = zip(field.present.T, np.moveaxis(field.phasor, -1, 0), strict=True)
    return np.stack([estimate(field.offset_m[present], phasor[..., present]) for present, phasor in pairs], axis=-1)


def _slope(offset_m: FloatArray, values: FloatArray) -> FloatArray:
    """Return the slope (...) of the regression of ``values`` (..., offset) on the offset."""
    distance_m = offset_m - offset_m.mean()
    return np.asarray(values @ distance_m / np.sum(distance_m**2))


def _outward_speed(field: LateralField, wavenumber: FloatArray) -> FloatArray:
    """Return the phase velocity of ``wavenumber`` (..., frequency), NaN unless it is positive."""
    omega = np.broadcast_to(2 * np.pi * field.frequency_hz, wavenumber.shape)
    speed = np.divide(omega, wavenumber, out=np.full(wavenumber.shape, np.nan), where=wavenumber > 0)
    return np.asarray(speed)
