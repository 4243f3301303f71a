"""Motion of many lines and depths at once: per pixel amplitude, phase and velocity, from I and Q or from samples.

    z_k = baseband of pulse k in a gate,   p_k = sum over the gate of conj(z_k) z_k+1          Kasai's step
    D_k = -c / (4 pi f) (arg p_0 + ... + arg p_k-1),   f: where the gate's energy lies
    D(t) = sum_i A_i sin(2 pi f_i t + phi_i) + v t + constant                                    least squares

With one sample a gate the steps add up to the sample's own phase, and the noise is white; over several samples the
phase is taken anew against the mean of all aligned echoes. The uncertainty is that of the residual, pixel by pixel,
and of the frequency by which the phase is divided: it differs over a gate where the speckle interferes to little.
"""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, Final, cast

import numpy as np
from numpy.typing import NDArray

from hpe_rig.arrays import BoolArray, ByteArray, ComplexSingleArray, FloatArray, SingleArray
from hpe_rig.processing.echo.band import BAND, compiled
from hpe_rig.processing.harmonics.model import LinearModel, linear_model
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
"""What is found of every pixel, the first four at every frequency."""

BATCH_BYTES: Final = 6_400_000
"""Baseband samples that a thread works on at a time: a step on them takes longer than to wait for the interpreter."""
COMPILED_WORTH: Final = 150_000_000
"""Samples from which on the compiled passes save more than Numba takes to load; before, where it is loaded."""
ALONE: Final = 200_000
"""Products of two numbers in a matrix product; from 262 144 on OpenBLAS wakes threads of its own for it."""
LEAST_POWER: Final = 1e-41
"""Of a pixel, in the square of what samples are in, known to 1e-4: single precision counts it in steps of 1e-45."""
NOISY_RAD: Final = 0.5
"""Residual of a pixel's phase, root mean square, from which on it is noise, or moves beyond what steps can follow."""
NEAR_RAD: Final = math.pi / 2
"""Phase against the first pulse within which nothing can have turned by a whole turn unseen."""
STRIDE: Final = 12
"""Of how many pulses one tells the frequency of the echo, which is nearly the same in all."""
UNKNOWN_PHASE_RAD: Final = np.float32(math.pi / math.sqrt(3))
"""Standard deviation of a phase of which nothing is known."""
FADE: Final = 0.2
"""Part of the band, at either end, over which it fades: the baseband then ends within a few periods."""


@dataclass(frozen=True, slots=True)
class MapSettings:
    """How a map is made: rates and carrier, Hz; ``gate_samples`` of the input are a pixel.

    ``demodulation_hz``: what I and Q were mixed down by, None for real samples.
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
    """Return the motion in every gate of every line.

    ``samples`` (line, pulse, sample), real, or complex for I and Q; ``time_s`` (pulse,). Gates follow each other from
    the first sample on. ``progress`` is told how many lines are done, of how many. A pixel that cannot be estimated is
    NaN and marked, never an error. Raises ``ValueError`` where the settings or the pulses cannot carry a map.
    """
    lines, pulses, count = samples.shape
    is_iq = np.iscomplexobj(samples)
    gates = count // settings.gate_samples
    _refuse(settings, gates, is_iq)
    model = linear_model(time_s, np.ones(pulses, bool), np.asarray(frequencies_hz, float), background_order=1)
    if is_iq:
        factor, mixed_hz = 1, settings.demodulation_hz or settings.carrier_hz
    else:
        factor, mixed_hz = _decimation(settings), settings.carrier_hz
    fast = compiled() and (samples.size > COMPILED_WORTH or "numba" in sys.modules)
    pixels = _Pixels(settings, model, time_s, np.asarray(frequencies_hz, float), factor, mixed_hz, fast)
    shapes = [(len(frequencies_hz),)] * 4 + [()] * 4
    found = [np.empty((lines, gates, *shape), np.float32) for shape in shapes]
    bad = np.zeros((lines, gates), np.uint8)
    step = max(1, BATCH_BYTES // max(1, 8 * pulses * count // factor))
    batches = [slice(first, min(first + step, lines)) for first in range(0, lines, step)]

    def work(batch: slice) -> int:
        of_batch, marks = pixels.estimate(samples[batch], gates)
        for whole, part in zip(found, of_batch, strict=True):
            whole[batch] = part
        bad[batch] = marks
        return int(batch.stop - batch.start)

    done = 0
    with ThreadPoolExecutor(max_workers=_workers()) as pool:
        for finished in pool.map(work, batches):
            done += finished
            if progress is not None:
                progress(done, lines)
    middle_s = settings.first_sample_s + (np.arange(gates) + 0.5) * settings.gate_samples / settings.sample_rate_hz
    return MotionMap(
        frequency_hz=np.asarray(frequencies_hz, float),
        line_m=np.arange(lines, dtype=float) if line_position_m is None else line_position_m,
        depth_m=middle_s * settings.sound_speed_m_per_s / 2,
        bad=bad,
        lines_are_placed=line_position_m is not None,
        **dict[str, Any](zip(RESULTS, found, strict=True)),
    )


def _workers() -> int:
    affinity = getattr(os, "sched_getaffinity", None)
    return len(affinity(0)) if affinity is not None else os.cpu_count() or 1


def _refuse(settings: MapSettings, gates: int, is_iq: bool) -> None:
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
    """Return the largest whole factor of the gate's samples that leaves the baseband its width."""
    widest = settings.sample_rate_hz / ((BAND[1] - BAND[0]) * settings.carrier_hz)
    factors = (factor for factor in range(1, settings.gate_samples + 1) if settings.gate_samples % factor == 0)
    return max((factor for factor in factors if factor <= widest), default=1)


@dataclass(frozen=True, slots=True)
class _Pixels:
    """What is the same for all batches of lines."""

    settings: MapSettings
    model: LinearModel
    time_s: FloatArray
    frequency_hz: FloatArray
    factor: int
    mixed_hz: float
    fast: bool

    def estimate(self, samples: NDArray[Any], gates: int) -> tuple[list[SingleArray], ByteArray]:
        """Return the results of some lines (line, pulse, sample), each (line, gate, ...), and which are bad."""
        length = self.settings.gate_samples // self.factor
        broken = None
        if samples.dtype.kind != "i" and not _is_finite(samples):
            sound = np.isfinite(samples)
            kept = sound[..., : gates * self.settings.gate_samples]
            broken = ~kept.reshape(*kept.shape[:2], gates, -1).all(axis=(1, 3))
            samples = np.where(sound, samples, 0)
        baseband = self._baseband(samples, gates * length)
        # pulses last: everything along them is then in one piece
        z = np.ascontiguousarray(baseband.transpose(0, 2, 1)).reshape(samples.shape[0], gates, length, -1)
        phase, power = _phases(z, self.fast)
        return self._fitted(phase, power, np.float32(self.mixed_hz) + self._frequency(z, power), broken)

    def _baseband(self, samples: NDArray[Any], count: int) -> ComplexSingleArray:
        """Return the baseband (line, pulse, sample) of the first gates, ``count`` samples of it."""
        if np.iscomplexobj(samples):
            return np.asarray(samples[..., :count], np.complex64)
        from scipy.fft import ifft, rfft

        length = samples.shape[-1] - samples.shape[-1] % self.factor
        spectrum = rfft(np.asarray(samples[..., :length], np.float32), axis=-1)
        bins = length // self.factor
        carrier = round(self.settings.carrier_hz * length / self.settings.sample_rate_hz)
        half = min(round((BAND[1] - 1) * carrier), (bins - 1) // 2)
        window = np.ones(2 * half + 1, np.float32)
        fade = max(1, round(FADE * half))
        ramp = np.sin(np.pi / 2 * (np.arange(fade) + 0.5) / fade).astype(np.float32) ** 2
        window[:fade], window[-fade:] = ramp, ramp[::-1]
        low, high = max(carrier - half, 0), min(carrier + half, spectrum.shape[-1] - 1)
        shifted = np.zeros((*samples.shape[:-1], bins), np.complex64)
        part = spectrum[..., low : high + 1] * (
            window[low - carrier + half : high - carrier + half + 1] * (2 / self.factor)
        )
        middle = carrier - low
        shifted[..., : part.shape[-1] - middle] = part[..., middle:]
        if middle:
            shifted[..., -middle:] = part[..., :middle]
        return np.asarray(ifft(shifted, axis=-1, overwrite_x=True)[..., :count], np.complex64)

    def _frequency(self, z: ComplexSingleArray, power: SingleArray) -> SingleArray:
        """Return where the energy of each gate lies (line, gate), Hz from the mixer; ``power`` as of `_phases`.

        As the echo's phase changes when it is late by little: Im sum conj(z) z' / sum |z|^2 over the gate and every
        ``STRIDE``-th pulse, the derivative along the whole line.
        """
        from scipy.fft import fft, ifft

        lines, gates, length, _ = z.shape
        some = np.ascontiguousarray(z[..., ::STRIDE].transpose(0, 3, 1, 2)).reshape(lines, -1, gates * length)
        rate_hz = np.fft.fftfreq(gates * length, self.factor / self.settings.sample_rate_hz).astype(np.float32)
        spectrum = fft(some, axis=-1)
        spectrum *= rate_hz
        along = ifft(spectrum, axis=-1, overwrite_x=True)
        shape = (lines, -1, gates, length)
        echo, along = some.reshape(shape), along.reshape(shape)
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.asarray(_inner(echo, along) / (power * np.float32(echo.shape[1] * length)))

    def _fitted(
        self,
        phase: SingleArray,
        power: SingleArray,
        frequency_hz: SingleArray,
        broken: BoolArray | None,
    ) -> tuple[list[SingleArray], ByteArray]:
        shape, (pulses, states) = phase.shape[:-1], self.model.matrix.shape
        matrix = np.ascontiguousarray(self.model.matrix.T.astype(np.float32))
        flat = phase.reshape(-1, pulses)
        state = _product(flat, (self.model.root @ (self.model.root.T @ self.model.matrix.T)).T.astype(np.float32))
        variance = _choice(self.fast, "distance")(_product(state, matrix), flat) / np.float32(pulses - states)
        with np.errstate(invalid="ignore", divide="ignore"):
            metres = np.float32(-self.settings.sound_speed_m_per_s / (4 * np.pi)) / frequency_hz.reshape(-1)
            # of the echo's frequency, which every STRIDE-th pulse tells
            relative = variance * self._frequency_noise + np.float32(self.settings.sound_speed_uncertainty**2)
        noise_m2 = variance * metres**2
        found = self._estimates(state, noise_m2, metres, relative)
        bad = np.zeros(flat.shape[0], np.uint8)
        bad[~(variance < NOISY_RAD**2) | ~(metres < 0)] = BadPixel.NOISE
        bad[~(power.reshape(-1) >= LEAST_POWER)] = BadPixel.NO_ECHO
        if broken is not None:
            bad[broken.reshape(-1)] = BadPixel.NOT_FINITE
        found += [np.sqrt(noise_m2), power.reshape(-1)]
        if bad.any():
            for each in found[:-1]:
                each[bad > 0] = np.nan
        return [each.reshape(*shape, *each.shape[1:]) for each in found], bad.reshape(shape)

    @property
    def _frequency_noise(self) -> np.float32:
        """Relative variance of the echo's frequency over the variance of a pulse's phase."""
        per_sample = 2 * np.pi * self.mixed_hz / self.settings.sample_rate_hz * self.factor
        return np.float32(2 * STRIDE / self.time_s.size / per_sample**2)

    def _estimates(
        self, state: SingleArray, noise_m2: SingleArray, metres: SingleArray, relative: SingleArray
    ) -> list[SingleArray]:
        """Return amplitude, phase (pixel, frequency) and velocity (pixel,), each with u, from ``state`` in rad."""
        count = self.frequency_hz.size
        covariance = (self.model.root @ self.model.root.T).astype(np.float32)
        at = 2 * np.arange(count)
        own, other, crossed = covariance[at, at], covariance[at + 1, at + 1], covariance[at, at + 1]
        shares = np.stack([(own + other) / 2, (own - other) / 2, crossed])
        found = tuple(np.empty((len(state), count), np.float32) for _ in range(4))
        _choice(self.fast, "estimates")(state, noise_m2, metres, relative, shares, found)
        # the line of the background runs from -1 to 1 over the train
        per_second = np.float32(2 / (self.time_s[-1] - self.time_s[0]))
        velocity = state[:, 2 * count + 1] * metres * per_second
        own_v = covariance[2 * count + 1, 2 * count + 1] * per_second**2
        velocity_u = np.sqrt(noise_m2 * own_v + relative * velocity**2)
        return [*found, velocity, velocity_u]


def _choice(fast: bool, name: str) -> Callable[..., Any]:
    """Return the compiled form of a pass or NumPy's."""
    plain: dict[str, Callable[..., Any]] = {"followed": _followed, "distance": _distance, "estimates": _estimates}
    if not fast:
        return plain[name]
    from hpe_rig.processing import motion_map_numba

    return cast("Callable[..., Any]", getattr(motion_map_numba, name))


def _distance(fitted: SingleArray, phase: SingleArray) -> SingleArray:
    """Return the sum of squares (pixel,) of ``fitted``, which is overwritten, less ``phase`` (pixel, pulse)."""
    fitted -= phase
    return np.asarray(np.einsum("ij,ij->i", fitted, fitted))


def _estimates(
    state: SingleArray,
    noise_m2: SingleArray,
    metres: SingleArray,
    relative: SingleArray,
    covariance: SingleArray,
    found: tuple[SingleArray, SingleArray, SingleArray, SingleArray],
) -> None:
    """Write amplitude and phase (pixel, frequency), each followed by its u, of ``state`` (pixel, state) in rad.

    ``covariance`` (3, frequency): mean of in-phase and quadrature, half their difference, what crosses them.
    """
    amplitude, amplitude_u, phase, phase_u = found
    mean, half, crossed = covariance
    scaled = state[:, : 2 * mean.size] * metres[:, None]
    in_phase, quadrature = scaled[:, ::2], scaled[:, 1::2]
    squared = in_phase**2 + quadrature**2
    np.sqrt(squared, out=amplitude)
    np.arctan2(quadrature, in_phase, out=phase)
    with np.errstate(invalid="ignore", divide="ignore"):
        # the covariance along the phasor and across it, which are the mean plus and minus what its angle makes
        turned = (half * (in_phase**2 - quadrature**2) + 2 * crossed * in_phase * quadrature) / squared
        np.sqrt(noise_m2[:, None] * (mean + turned) + relative[:, None] * squared, out=amplitude_u)
        np.sqrt(noise_m2[:, None] * (mean - turned) / squared, out=phase_u)
    np.minimum(phase_u, UNKNOWN_PHASE_RAD, out=phase_u)


def _inner(one: ComplexSingleArray, other: ComplexSingleArray) -> SingleArray:
    """Return Re sum conj(one) other over pulses and samples: (line, pulse, gate, sample) to (line, gate)."""
    parts = ((one.real, other.real), (one.imag, other.imag))
    return np.asarray(sum(np.einsum("lpgs,lpgs->lg", a, b) for a, b in parts))


def _product(left: SingleArray, right: SingleArray) -> SingleArray:
    """Return ``left @ right``, by blocks of rows that BLAS leaves in this thread.

    Each of the pool's threads would else wake as many of BLAS's own, all on the same cores.
    """
    rows = max(1, ALONE // right.size)
    whole = len(left) // rows * rows
    out = np.empty((len(left), right.shape[1]), np.float32)
    blocks = left[:whole].reshape(-1, rows, left.shape[1])
    np.matmul(blocks, right, out=out[:whole].reshape(-1, rows, right.shape[1]))
    np.matmul(left[whole:], right, out=out[whole:])
    return out


def _is_finite(samples: NDArray[Any]) -> bool:
    """Return whether all samples are, at a glance where they lie in one piece; in doubt False."""
    order = np.argsort(samples.strides)[::-1]
    flat = samples.transpose(order).reshape(-1)
    with np.errstate(over="ignore", invalid="ignore"):
        return bool(np.isfinite(np.vdot(flat, flat)))


def _phases(z: ComplexSingleArray, fast: bool = False) -> tuple[SingleArray, SingleArray]:
    """Return the phase of every pulse (line, gate, pulse), followed from pulse to pulse, and the power (line, gate)."""
    some = z[..., ::STRIDE]
    parts = np.ascontiguousarray(some).view(np.float32)
    power = np.einsum("lgsp,lgsp->lg", parts, parts) / np.float32(some.shape[2] * some.shape[3])
    if z.shape[2] == 1:
        return _choice(fast, "followed")(z[:, :, 0]), power
    product = np.zeros((*z.shape[:2], z.shape[-1] - 1), np.complex64)
    for at in range(z.shape[2]):
        product += z[:, :, at, :-1].conj() * z[:, :, at, 1:]
    first = np.zeros((*z.shape[:2], z.shape[-1]), np.float32)
    np.cumsum(np.angle(product), axis=-1, out=first[..., 1:])
    turn = np.empty(first.shape, np.complex64)
    np.cos(first, out=turn.real)
    np.sin(first, out=turn.imag)
    mean = (z @ turn.conj()[..., None])[..., 0]
    others = (mean.conj()[:, :, None] @ z)[:, :, 0] * turn.conj()
    # a pulse's own noise in the mean would pull its phase to zero
    others -= (z.real**2 + z.imag**2).sum(axis=2)
    return np.asarray(first + np.angle(others), np.float32), power


def _followed(z: ComplexSingleArray) -> SingleArray:
    """Return the phase of ``z`` (..., pulse) against the first pulse, without its jumps by whole turns."""
    angle = np.arctan2(np.ascontiguousarray(z.imag), np.ascontiguousarray(z.real))
    angle -= angle[..., :1].copy()
    # no single one is farther where all of them together are not
    far = np.einsum("...p,...p->...", angle, angle) >= NEAR_RAD**2
    if far.any():
        # farther than a quarter turn from the first, or about to change sign there: from pulse to pulse
        moving = angle[far]
        jumps = np.rint(np.diff(moving, axis=-1) * np.float32(1 / (2 * np.pi)))
        moving[:, 1:] -= np.cumsum(jumps, axis=-1) * np.float32(2 * np.pi)
        angle[far] = moving
    return angle
