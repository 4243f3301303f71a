"""Motion of many lines and depths at once: per pixel amplitude, phase and velocity, from I and Q or from samples.

    z_k: baseband of pulse k in a gate,   p_k = sum over the gate of conj(z_k) z_k+1          Kasai's step
    D_k = -c / (4 pi f) (arg p_0 + ... + arg p_k-1),   f: mean frequency of the gate's energy
    D(t) = sum_i A_i sin(2 pi f_i t + phi_i) + v t + constant                                 least squares

With one sample per gate the steps add up to the phase of that sample, and the noise is white. With several samples
the phase is measured again against the mean of all aligned echoes. The uncertainty of a pixel combines noise and
decorrelation (pixel_noise.py) with the uncertainties of f, which grows where speckle interferes destructively, and of
the sound speed c.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from types import ModuleType
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from hpe_rig.arrays import BoolArray, ByteArray, ComplexSingleArray, FloatArray, SingleArray
from hpe_rig.processing.compilation import use_numba
from hpe_rig.processing.echo.band import BAND
from hpe_rig.processing.harmonics.model import LinearModel, linear_model
from hpe_rig.processing.maps import kernels
from hpe_rig.processing.maps.pixel_noise import NoiseModel, hidden_variance
from hpe_rig.result import BadPixel, MotionMap

RESULTS: Final = (
    "amplitude_m",
    "amplitude_uncertainty_m",
    "phase_rad",
    "phase_uncertainty_rad",
    "velocity_m_per_s",
    "velocity_uncertainty_m_per_s",
    "residual_m",
    "power",
)
"""Results of every pixel; the first four have a value for every frequency."""
BATCH_BYTES: Final = 6_400_000
"""Baseband per batch of lines: large enough that threads hardly wait for the interpreter lock."""
COMPILED_SAMPLES: Final = 150_000_000
"""Minimum number of samples for which the compiled kernels save more time than Numba takes to load."""
SERIAL_PRODUCTS: Final = 200_000
"""Products in one matrix multiplication; OpenBLAS starts its own threads from 262 144."""
MIN_POWER: Final = 1e-41
"""Power of a pixel, in units of the samples squared, that single precision (steps of 1e-45) resolves to 1e-4."""
MAX_STEP_VARIANCE: Final = 0.5
"""Mean square step of the residual, rad², above which a pixel is noise, or moves more than its steps can follow.

White noise of 0.5 rad: intervals of 2 u cover 92 to 96 % up to it, 75 to 89 % above 0.8 rad. Steps of a phase without
echo have 3.3 rad².
"""
ECHO_PULSE_STEP: Final = 12
"""Every pulse of this step contributes to echo frequency and power, which are nearly equal in all pulses."""
BAND_FADE: Final = 0.2
"""Fraction of the band tapered at each end, so that the impulse response of the filter decays within few periods."""


@dataclass(frozen=True, slots=True)
class MapSettings:
    """Rates and carrier of the records, Hz; a pixel has ``gate_samples`` of the input.

    ``demodulation_hz``: mixing frequency of I and Q, None for real samples.
    """

    sample_rate_hz: float
    carrier_hz: float
    gate_samples: int
    sound_speed_m_per_s: float = 1540.0
    sound_speed_uncertainty: float = 0.005
    first_sample_s: float = 0.0
    demodulation_hz: float | None = None


def map_pixels(
    samples: NDArray[Any],
    time_s: FloatArray,
    frequencies_hz: Sequence[float],
    settings: MapSettings,
    line_position_m: FloatArray | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> MotionMap:
    """Return amplitude, phase and velocity of the motion in every gate of every line, with uncertainties.

    ``samples`` (line, pulse, sample): real, or complex for I and Q. ``time_s`` (pulse,). Gates are contiguous from the
    first sample on. ``progress`` is called with the numbers of finished and of all lines. A pixel without an estimate
    is NaN and marked as bad. Raises ``ValueError`` if the settings or the pulses do not allow a map.
    """
    lines, pulses, count = samples.shape
    frequency_hz = np.asarray(frequencies_hz, float)
    is_iq = np.iscomplexobj(samples)
    gates = count // settings.gate_samples
    _refuse(settings, gates, is_iq)
    decimation = 1 if is_iq else _decimation(settings)
    model = linear_model(time_s, np.ones(pulses, bool), frequency_hz, background_order=1)
    pixels = _Pixels(
        settings=settings,
        model=model,
        noise=NoiseModel.of(model),
        time_s=time_s,
        decimation=decimation,
        mixing_hz=settings.carrier_hz if settings.demodulation_hz is None else settings.demodulation_hz,
        kernels=_kernels(samples.size),
    )
    # Amplitude and phase with uncertainties have a value for each frequency; velocity, residual, power one for a pixel.
    per_frequency, per_pixel = (lines, gates, frequency_hz.size), (lines, gates)
    results = [np.empty(shape, np.float32) for shape in (per_frequency,) * 4 + (per_pixel,) * 4]
    bad = np.zeros(per_pixel, np.uint8)
    batch_lines = max(1, BATCH_BYTES // max(1, 8 * pulses * count // decimation))
    batches = [slice(first, min(first + batch_lines, lines)) for first in range(0, lines, batch_lines)]

    def estimate(batch: slice) -> int:
        """Write the results of some lines; return how many."""
        batch_results, bad[batch] = pixels.estimate(samples[batch], gates)
        for result, batch_result in zip(results, batch_results, strict=True):
            result[batch] = batch_result
        return int(batch.stop - batch.start)

    # Batches of lines run in threads, one for each core.
    done = 0
    with ThreadPoolExecutor(max_workers=_workers()) as pool:
        for finished in pool.map(estimate, batches):
            done += finished
            if progress is not None:
                progress(done, lines)
    middle_s = settings.first_sample_s + (np.arange(gates) + 0.5) * settings.gate_samples / settings.sample_rate_hz
    return MotionMap(
        frequency_hz=frequency_hz,
        line_m=np.arange(lines, dtype=float) if line_position_m is None else line_position_m,
        depth_m=middle_s * settings.sound_speed_m_per_s / 2,
        bad=bad,
        lines_are_placed=line_position_m is not None,
        **dict[str, Any](zip(RESULTS, results, strict=True)),
    )


def _workers() -> int:
    """Return the number of cores that this process may use."""
    affinity = getattr(os, "sched_getaffinity", None)
    return len(affinity(0)) if affinity is not None else os.cpu_count() or 1


def _kernels(samples: int) -> ModuleType:
    """Return the module with the inner loops for so many samples: compiled by Numba where that pays off, or NumPy's."""
    if not use_numba(samples, COMPILED_SAMPLES):
        return kernels
    from hpe_rig.processing.maps import kernels_numba

    return kernels_numba


def _refuse(settings: MapSettings, gates: int, is_iq: bool) -> None:
    """Raise ``ValueError`` for a gate longer than a record, an aliased carrier, or a gate shorter than its period."""
    if gates < 1:
        raise ValueError(f"a gate of {settings.gate_samples} samples is longer than a record: a shorter gate")
    if is_iq:
        return
    if settings.carrier_hz >= settings.sample_rate_hz / 2:
        raise ValueError(
            f"a carrier of {settings.carrier_hz:g} Hz does not lie below half the sampling rate of "
            f"{settings.sample_rate_hz:g} Hz: one of them is wrong"
        )
    periods = settings.gate_samples / settings.sample_rate_hz * settings.carrier_hz
    if periods < 1:
        raise ValueError(f"a gate of {periods:.2g} carrier periods holds no phase: a longer gate")


def _decimation(settings: MapSettings) -> int:
    """Return the largest decimation of the baseband that divides the gate's samples and does not alias."""
    # A complex baseband needs one sample per inverse bandwidth.
    limit = settings.sample_rate_hz / ((BAND[1] - BAND[0]) * settings.carrier_hz)
    factors = (factor for factor in range(1, settings.gate_samples + 1) if settings.gate_samples % factor == 0)
    return max((factor for factor in factors if factor <= limit), default=1)


@dataclass(frozen=True, slots=True)
class _Pixels:
    """Estimation of the pixels of some lines; everything here is shared by all batches."""

    settings: MapSettings
    model: LinearModel
    noise: NoiseModel
    time_s: FloatArray
    decimation: int
    mixing_hz: float
    kernels: ModuleType

    def estimate(self, samples: NDArray[Any], gates: int) -> tuple[list[SingleArray], ByteArray]:
        """Return the results of every pixel of some lines, and the marks of bad pixels (line, gate).

        ``samples`` (line, pulse, sample). Results are listed in the order of ``RESULTS``, each (line, gate, ...):
        amplitude, phase and velocity with uncertainties, residual, power.
        """
        length = self.settings.gate_samples // self.decimation
        not_finite = None
        if samples.dtype.kind != "i" and not _all_finite(samples):
            finite = np.isfinite(samples)
            in_gates = finite[..., : gates * self.settings.gate_samples]
            not_finite = ~in_gates.reshape(*in_gates.shape[:2], gates, -1).all(axis=(1, 3))
            samples = np.where(finite, samples, 0)
        baseband = self._baseband(samples, gates * length)
        # Pulses become the last axis, contiguous in memory, since all later operations run along them.
        z = np.ascontiguousarray(baseband.transpose(0, 2, 1)).reshape(samples.shape[0], gates, length, -1)
        power = _mean_power(z)
        phase, log_amplitude = self._phases(z)
        return self._fit(phase, log_amplitude, power, self._frequency_offset(z, power), not_finite)

    def _baseband(self, samples: NDArray[Any], count: int) -> ComplexSingleArray:
        """Return ``count`` samples of the complex baseband (line, pulse, sample), mixed by the carrier and decimated.

        I and Q are the baseband already. Real samples are band-passed around the carrier in the spectrum.
        """
        if np.iscomplexobj(samples):
            return np.asarray(samples[..., :count], np.complex64)
        from scipy.fft import ifft, rfft

        length = samples.shape[-1] - samples.shape[-1] % self.decimation
        spectrum = rfft(np.asarray(samples[..., :length], np.float32), axis=-1)
        bins = length // self.decimation
        carrier = round(self.settings.carrier_hz * length / self.settings.sample_rate_hz)
        # Half the width of the band, in bins.
        half = min(round((BAND[1] - 1) * carrier), (bins - 1) // 2)
        # Window over the bins carrier - half to carrier + half, with a ramp of ``fade`` bins at each end.
        window = np.ones(2 * half + 1, np.float32)
        fade = max(1, round(BAND_FADE * half))
        ramp = np.sin(np.pi / 2 * (np.arange(fade) + 0.5) / fade).astype(np.float32) ** 2
        window[:fade], window[-fade:] = ramp, ramp[::-1]
        low, high = max(carrier - half, 0), min(carrier + half, spectrum.shape[-1] - 1)
        # The part of the band within the spectrum, scaled to the analytic signal at the decimated rate.
        in_band = window[low - carrier + half : high - carrier + half + 1] * (2 / self.decimation)
        transmitted = spectrum[..., low : high + 1] * in_band
        # The carrier moves to bin 0 of the decimated spectrum.
        shifted = np.zeros((*samples.shape[:-1], bins), np.complex64)
        bins_below = carrier - low
        shifted[..., : transmitted.shape[-1] - bins_below] = transmitted[..., bins_below:]
        if bins_below:
            # Negative frequencies are at the end of the spectrum.
            shifted[..., -bins_below:] = transmitted[..., :bins_below]
        return np.asarray(ifft(shifted, axis=-1, overwrite_x=True)[..., :count], np.complex64)

    def _phases(self, z: ComplexSingleArray) -> tuple[SingleArray, SingleArray]:
        """Return the unwrapped phase of every pulse relative to the first, rad, and the logarithm of its amplitude.

        Both (line, gate, pulse). ``z`` (line, gate, sample, pulse): complex baseband of the echoes. The phase steps
        between consecutive echoes align all echoes. The phase of each aligned echo against the sum of the others is
        then added, which has less noise.
        """
        if z.shape[2] == 1:
            phase: SingleArray = self.kernels.unwrapped(z[:, :, 0])
            return phase, self.kernels.log_amplitude(z[:, :, 0])
        # Phase of each step, from the products of consecutive echoes summed over the gate.
        with_next = np.zeros((*z.shape[:2], z.shape[-1] - 1), np.complex64)
        for sample in range(z.shape[2]):
            with_next += z[:, :, sample, :-1].conj() * z[:, :, sample, 1:]
        accumulated = np.zeros((*z.shape[:2], z.shape[-1]), np.float32)
        np.cumsum(np.angle(with_next), axis=-1, out=accumulated[..., 1:])
        phasor = np.empty(accumulated.shape, np.complex64)
        np.cos(accumulated, out=phasor.real)
        np.sin(accumulated, out=phasor.imag)
        # Sum over pulses of the aligned echoes, (line, gate, sample).
        total = (z @ phasor.conj()[..., None])[..., 0]
        # Inner product over the gate of that sum with each aligned echo, (line, gate, pulse).
        with_others = (total.conj()[:, :, None] @ z)[:, :, 0] * phasor.conj()
        log_amplitude = self.kernels.log_amplitude(with_others)
        # The sum contains the pulse itself. Its noise would bias the phase to zero, so its energy is subtracted.
        with_others -= (z.real**2 + z.imag**2).sum(axis=2)
        return np.asarray(accumulated + np.angle(with_others), np.float32), log_amplitude

    def _frequency_offset(self, z: ComplexSingleArray, power: SingleArray) -> tuple[SingleArray, SingleArray]:
        """Return frequency and amplitude slope of the echo in each gate, both Hz (line, gate), weighted by energy.

        The frequency is relative to the mixing frequency. The amplitude slope is d(ln |z|)/dt / (2 pi) over fast time.
        Both follow from m = sum conj(z) dz/dt / (2 pi j sum |z|²) over the samples of the gate in every
        ``ECHO_PULSE_STEP``-th pulse: the frequency is Re m, the slope -Im m. ``z`` (line, gate, sample, pulse):
        baseband. ``power`` (line, gate): mean power of the pulses.
        """
        from scipy.fft import fft, ifft

        lines, gates, length, _ = z.shape
        # Whole lines, (line, pulse, gate and sample), and their derivative over depth divided by 2 pi j.
        echo = np.ascontiguousarray(z[..., ::ECHO_PULSE_STEP].transpose(0, 3, 1, 2)).reshape(lines, -1, gates * length)
        frequency_hz = np.fft.fftfreq(gates * length, self.decimation / self.settings.sample_rate_hz).astype(np.float32)
        spectrum = fft(echo, axis=-1)
        spectrum *= frequency_hz
        derivative = ifft(spectrum, axis=-1, overwrite_x=True)
        shape = (lines, -1, gates, length)
        echo, derivative = echo.reshape(shape), derivative.reshape(shape)
        # Sum over pulses and samples of each gate.
        moment = (echo.conj() * derivative).sum(axis=(1, 3))
        with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
            mean = np.asarray(moment / (power * np.float32(echo.shape[1] * length)))
        return mean.real, -mean.imag

    def _fit(
        self,
        phase: SingleArray,
        log_amplitude: SingleArray,
        power: SingleArray,
        frequency_offset: tuple[SingleArray, SingleArray],
        not_finite: BoolArray | None,
    ) -> tuple[list[SingleArray], ByteArray]:
        """Return the results of every pixel, in the order of ``RESULTS``, and marks of bad pixels (line, gate).

        ``phase`` (line, gate, pulse), rad, is fitted by vibrations of known frequency, a constant and a slope, the mean
        velocity. ``log_amplitude`` (line, gate, pulse) and ``power`` (line, gate): of the echo. ``frequency_offset``:
        its frequency relative to the mixing frequency, and the slope of ln(amplitude) over fast time / 2 pi, both Hz
        (line, gate). ``not_finite`` (line, gate): gates with samples that are not finite.
        """
        pixel_shape = phase.shape[:-1]
        offset_hz, amplitude_slope_hz = (values.reshape(-1) for values in frequency_offset)
        pulses, states = self.model.matrix.shape
        # Least-squares states (in-phase and quadrature of each frequency, constant, slope) are phases @ solver, with
        # (H'H)^-1 = root @ root.T, H the model's ``matrix`` (pulse, state).
        columns = np.ascontiguousarray(self.model.matrix.T.astype(np.float32))
        solver = (self.model.root @ (self.model.root.T @ self.model.matrix.T)).T.astype(np.float32)
        data = phase.reshape(-1, pulses)
        # BLAS must not start threads here, since batches of lines run in parallel on every core.
        state = _serial_matmul(data, solver)
        energies = self.kernels.residual_energies(_serial_matmul(state, columns), data)
        frequency_hz = np.float32(self.mixing_hz) + offset_hz
        with np.errstate(invalid="ignore", divide="ignore"):
            metres_per_radian = np.float32(-self.settings.sound_speed_m_per_s / (4 * np.pi)) / frequency_hz
            # The same fit to the logarithm of the amplitude. An echo that moves over the gate changes its phase in
            # proportion to its frequency, and ln(amplitude) to its slope. The remaining change is decorrelation.
            amplitude_state = _serial_matmul(log_amplitude.reshape(-1, pulses), solver)
            amplitude_state -= state * (amplitude_slope_hz / frequency_hz)[:, None]
        # Comparisons with NaN are false, so that a pixel with NaN is bad.
        steps_are_small = energies[:, 1] < MAX_STEP_VARIANCE * (pulses - 1)
        frequency_is_positive = metres_per_radian < 0
        has_power = power.reshape(-1) >= MIN_POWER
        bad = np.zeros(len(data), np.uint8)
        bad[~(steps_are_small & frequency_is_positive)] = BadPixel.NOISE
        bad[~has_power] = BadPixel.NO_ECHO
        if not_finite is not None:
            bad[not_finite.reshape(-1)] = BadPixel.NOT_FINITE
        has_echo = (bad == 0).reshape(pixel_shape)
        noise = self.noise.variances(energies, has_echo)
        covariance, slope_variance = self._state_covariance(noise, amplitude_state, power, has_echo)
        relative_variance = self._relative_variance(noise)
        estimates = self._estimates(state, covariance, slope_variance, metres_per_radian, relative_variance)
        residual_m = np.sqrt(energies[:, 0] / np.float32(pulses - states)) * np.abs(metres_per_radian)
        fitted = [*estimates, residual_m]
        # Bad pixels have a power, but no fitted results.
        if bad.any():
            for values in fitted:
                values[bad > 0] = np.nan
        results = [*fitted, power.reshape(-1)]
        return [values.reshape(*pixel_shape, *values.shape[1:]) for values in results], bad.reshape(pixel_shape)

    def _relative_variance(self, noise: SingleArray) -> SingleArray:
        """Return the relative variance (pixel,) of the metres per radian, from echo frequency and sound speed.

        ``noise`` (pixel, 3): its first column is the noise variance of one phase. The frequency follows from the phase
        step between two samples, which has twice that variance. Its mean is over every ``ECHO_PULSE_STEP``-th pulse.
        """
        # The phase step of a sample at the carrier, which is nearly the echo's frequency.
        phase_per_sample = 2 * np.pi * self.settings.carrier_hz / self.settings.sample_rate_hz * self.decimation
        of_frequency = noise[:, 0] * (2 * ECHO_PULSE_STEP / self.time_s.size / phase_per_sample**2)
        return np.asarray(of_frequency + self.settings.sound_speed_uncertainty**2, np.float32)

    def _state_covariance(
        self, noise: SingleArray, amplitude_state: SingleArray, power: SingleArray, has_echo: BoolArray
    ) -> tuple[SingleArray, SingleArray]:
        """Return the covariance of in-phase and quadrature of each frequency, and the slope's variance (pixel,), rad².

        The covariance (pixel, 3, frequency) is given as mean of both variances, half their difference, and covariance.
        ``noise`` (pixel, 3): variances of white noise, walk and smooth walk. ``amplitude_state`` (pixel, state): fit of
        the logarithm of the echo's amplitude, for the noise that the residual hides. ``power``, ``has_echo`` (line,
        gate).
        """
        # (kind of noise, state, state) for unit variance; in-phase and quadrature of each frequency, constant, slope.
        unit = self.noise.state_covariance
        slope = unit.shape[-1] - 1
        in_phase = np.arange(0, slope - 1, 2)
        quadrature = in_phase + 1
        sin_variance, cos_variance = unit[:, in_phase, in_phase], unit[:, quadrature, quadrature]
        # Mean and half difference give the variances along and across a phasor of any phase.
        mean, half_difference = (sin_variance + cos_variance) / 2, (sin_variance - cos_variance) / 2
        kinds = np.stack([mean, half_difference, unit[:, in_phase, quadrature]], axis=1).reshape(3, -1)
        covariance = _serial_matmul(noise, kinds.astype(np.float32)).reshape(-1, 3, in_phase.size)
        slope_variance = noise @ unit[:, slope, slope].astype(np.float32)
        # Slow decorrelation adds variance that the residual does not contain.
        visible = np.concatenate([covariance[:, 0].T, slope_variance[None]]).reshape(-1, *power.shape)
        hidden = hidden_variance(amplitude_state, visible, power, has_echo).reshape(len(visible), -1)
        covariance[:, 0] += hidden[:-1].T
        return covariance, slope_variance + hidden[-1]

    def _estimates(
        self,
        state: SingleArray,
        covariance: SingleArray,
        slope_variance: SingleArray,
        metres_per_radian: SingleArray,
        relative_variance: SingleArray,
    ) -> list[SingleArray]:
        """Return amplitude, phase (pixel, frequency) and velocity (pixel,), each followed by its standard uncertainty.

        ``state`` (pixel, state): fitted states of the phase, rad, with the ``covariance`` (pixel, 3, frequency) and
        ``slope_variance`` (pixel,). ``metres_per_radian`` (pixel,) converts them; it has the ``relative_variance``.
        """
        # Amplitude, its uncertainty, phase, its uncertainty.
        results = tuple(np.empty((len(state), covariance.shape[-1]), np.float32) for _ in range(4))
        self.kernels.write_amplitude_and_phase(state, covariance, metres_per_radian, relative_variance, results)
        # The column of the slope runs from -1 to 1 over the train.
        scale = metres_per_radian * np.float32(2 / (self.time_s[-1] - self.time_s[0]))
        velocity = state[:, -1] * scale
        # Errors of the fit and of the conversion factor, which are independent.
        return [*results, velocity, np.sqrt(slope_variance * scale**2 + relative_variance * velocity**2)]


def _mean_power(z: ComplexSingleArray) -> SingleArray:
    """Return the mean power (line, gate) of every ``ECHO_PULSE_STEP``-th pulse of ``z`` (line, gate, sample, pulse)."""
    subset = np.ascontiguousarray(z[..., ::ECHO_PULSE_STEP])
    real_and_imag = subset.view(np.float32)
    # Sum of squares over samples and pulses.
    energy = np.einsum("lgsp,lgsp->lg", real_and_imag, real_and_imag)
    return np.asarray(energy / np.float32(subset.shape[2] * subset.shape[3]))


def _serial_matmul(rows: SingleArray, matrix: SingleArray) -> SingleArray:
    """Return ``rows @ matrix``, computed in blocks of rows so small that BLAS starts no threads.

    Otherwise each thread of the pool would start as many BLAS threads, all on the same cores.
    """
    size = max(1, SERIAL_PRODUCTS // matrix.size)
    in_blocks = len(rows) // size * size
    product = np.empty((len(rows), matrix.shape[1]), np.float32)
    blocks = rows[:in_blocks].reshape(-1, size, rows.shape[1])
    np.matmul(blocks, matrix, out=product[:in_blocks].reshape(-1, size, matrix.shape[1]))
    np.matmul(rows[in_blocks:], matrix, out=product[in_blocks:])
    return product


def _all_finite(samples: NDArray[Any]) -> bool:
    """Return whether all samples are finite, from their sum of squares; False also if that overflows."""
    memory_order = np.argsort(samples.strides)[::-1]
    flat = samples.transpose(memory_order).reshape(-1)
    with np.errstate(over="ignore", invalid="ignore"):
        return bool(np.isfinite(np.vdot(flat, flat)))
