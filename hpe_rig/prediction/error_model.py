"""Error model: bias and jitter of amplitude and phase that beams, gate, pulse, noise and estimator make of a motion.

Echoes stand as complex envelopes in the gate: draws of speckle, with and without the displacement as weight, blurred
by the pulse (no carrier, no pulses in slow time). Their ratios give bias and speckle jitter; noise enters through the
phase variance of a pulse and the part of a step's noise that does not return in the next step. The gate's ends are no
part of it: echoes are aligned before the gate cuts them, as far as the record reaches beyond it.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np

from hpe_rig.arrays import ComplexArray, FloatArray, Int64Array, SingleArray
from hpe_rig.processing import EstimatorSpec, hann, spec_of

"""Single precision takes half the time: what draws say is as good as their number, to a part in a hundred."""
Triple = tuple[float, float, float]

Moved = Callable[[SingleArray], SingleArray]
"""Displacement (scatterer,) of scatterers at (3, scatterer), m from the focus, over one of its own."""

INSTANTS = 64
BAND_OF_CARRIER = 1.0
"""Width of the band that the estimators sum, in carriers."""
PADDING = 4
FAR_FROM_NOISE = 5e3
"""Square of amplitude over noise, halved, from which on the mean of a Rice distribution is a series."""
NEGLIGIBLE = 1e-6
"""Of the largest singular value."""
PHASE_LIMIT = np.pi / np.sqrt(3)
GROUPS = 32
"""Groups of draws, of one strength of echo each, whose noise is told apart where a peak is read."""
MORE_NOISE = 6
"""How often the weakest eighth of them is given noise anew."""
MOST_SCATTERERS = 5000
"""Most that are drawn. With tens in every resolution cell the sums are as good as normal: the excess of their fourth
moment goes as one over the scatterers in a cell."""
BLOCK_DRAWS = 50
"""Draws summed at a time: what they need stays in the processor's cache, which halves their time."""
MOST_KEPT = 1e6
"""Scatterers up to which draws are kept for the next motion: 28 MB."""
LATERAL = 3.5
"""Half width of the drawn box in sigmas of the tracking beam: scatterers beyond echo 2e-3 of the peak."""


@dataclass(frozen=True, slots=True)
class Conditions:
    """What bias and jitter depend on; SI units, widths as sigmas, ``snr`` a power ratio in the gate.

    ``trigger_jitter_s``, between a pulse and the sampling clock, moves a whole echo, so that no gate reduces it.
    ``fit_gain``: noise of the fitted quadrature over that of a sinusoid fitted alone to all pulses.
    """

    excitation_width_m: Triple
    tracking_width_m: Triple
    gate_length_m: float
    pulse_length_m: float
    scatterers_per_m3: float
    carrier_hz: float
    sound_speed_m_per_s: float
    sample_rate_hz: float
    pulse_rate_hz: float
    pulses: int
    frequency_hz: float
    amplitude_m: float
    snr: float
    trigger_jitter_s: float = 0.0
    fit_gain: float = 1.0

    @property
    def trigger_jitter_variance(self) -> float:
        """Variance of a pulse's echo phase by trigger jitter, rad^2."""
        return float((2 * np.pi * self.carrier_hz * self.trigger_jitter_s) ** 2)

    @property
    def gate_samples(self) -> float:
        """Samples in the gate."""
        return 2 * self.gate_length_m / self.sound_speed_m_per_s * self.sample_rate_hz

    @property
    def metres_per_radian(self) -> float:
        """Displacement of a radian of echo phase."""
        return self.sound_speed_m_per_s / (4 * np.pi * self.carrier_hz)


@dataclass(frozen=True, slots=True)
class Expected:
    """Predicted for one estimator: all against the peak displacement and its phase; standard deviations.

    ``quadrature_m``: noise of each quadrature, about the stated uncertainty; ``noise_jitter_m``: what it makes of the amplitude, less where that is small. ``tracked``:
    mean of tracked over peak displacement, without noise.
    ``relative_variances``: of the noise in groups of equally many media over its mean, where it differs among them.
    """

    estimator: str
    bias_m: float
    quadrature_m: float
    noise_jitter_m: float
    speckle_jitter_m: float
    phase_bias_rad: float
    phase_jitter_rad: float
    tracked: float = 1.0
    relative_variances: tuple[float, ...] = (1.0,)

    @property
    def jitter_m(self) -> float:
        """Noise and speckle together."""
        return float(np.hypot(self.noise_jitter_m, self.speckle_jitter_m))


@dataclass(frozen=True, slots=True)
class Speckle:
    """Envelopes (draw, instant) of echoes at rest and weighted by their displacement."""

    resting: ComplexArray
    moved: ComplexArray


def expected(conditions: Conditions, estimator: str, speckle: Speckle, generator: np.random.Generator) -> Expected:
    """Return bias and jitter of ``estimator`` for speckle drawn by ``draw_speckle`` under the same conditions."""
    spec = spec_of(estimator)
    if spec.reads_peak:
        ratio, variances = _peak_statistics(conditions, speckle, generator)
    else:
        ratio, share = _whole_gate(conditions, speckle, spec.by_carrier)
        pulse = spec.gate_noise / (conditions.gate_samples * conditions.snr)
        variances = [(pulse * share, _walk(conditions, pulse) if spec.steps_add_up else 0.0)]
    jitter = conditions.trigger_jitter_variance
    deviations = np.array([_quadrature_deviation(conditions, spec, pulse + jitter, walk) for pulse, walk in variances])
    deviation = float(np.sqrt(np.mean(deviations**2)))
    relative = tuple((deviations**2 / deviation**2).tolist()) if deviation > 0 else (1.0,)
    return _with_noise(conditions, estimator, ratio, deviation, relative)


def tracked_over_peak(conditions: Conditions, estimator: str, speckle: Speckle) -> FloatArray:
    """Return what the estimator tracks of the peak displacement in each draw of ``speckle`` (draw,), without noise."""
    spec = spec_of(estimator)
    if not spec.reads_peak:
        return _whole_gate(conditions, speckle, spec.by_carrier)[0]
    to_band = _to_band(conditions, PADDING * INSTANTS, hann(INSTANTS))
    resting, moved = _times(speckle.resting, to_band), _times(speckle.moved, to_band)
    peak = np.argmax(np.abs(resting), axis=-1)[:, None]
    return np.asarray(_taken(moved / resting, peak).real)


@dataclass(frozen=True, slots=True)
class Scattering:
    """Draws of scatterers summed into cells of depth, (draw, cell): echo and echo weighted by the displacement."""

    echo: ComplexArray
    moved: ComplexArray
    depth_m: FloatArray

    def speckle(self, gate_length_m: float, pulse_length_m: float) -> Speckle:
        """Return the envelopes in a gate around the focus that a Hann pulse makes of these scatterers.

        Draws without an echo in the gate, as sparse scatterers have, tell nothing and are left out.
        """
        instant = ((np.arange(INSTANTS) + 0.5) / INSTANTS - 0.5) * gate_length_m
        distance = (instant - self.depth_m[:, None]) / pulse_length_m
        blur = np.where(np.abs(distance) < 0.5, np.cos(np.pi * distance) ** 2, 0.0)
        resting, moved = _times(self.echo, blur), _times(self.moved, blur)
        seen = np.any(resting != 0, axis=-1)
        return Speckle(resting[seen], moved[seen]) if seen.any() and not seen.all() else Speckle(resting, moved)


def draw_speckle(
    conditions: Conditions, generator: np.random.Generator, draws: int = 1000, moved: Moved | None = None
) -> Speckle:
    """Return envelopes of ``draws`` independent speckles: scatterers of the conditions's density, placed at random.

    ``moved`` as in ``draw_scattering``.
    """
    scattering = draw_scattering(conditions, generator, draws, *_cells(conditions), moved)
    return scattering.speckle(conditions.gate_length_m, conditions.pulse_length_m)


@functools.lru_cache(maxsize=4)
def seeded_speckle(conditions: Conditions, draws: int, moved: Moved | None = None) -> Speckle:
    """Return speckle as ``draw_speckle`` of seeds of its own: a prediction is a function of the scene alone.

    Echoes alike have the same scatterers, whatever moves them, and of more draws the first are the same: those are
    kept, unless they are too many.
    """
    echoes = replace(conditions, excitation_width_m=(0.0, 0.0, 0.0), pulses=1, frequency_hz=0.0, amplitude_m=0.0)
    echoes = replace(echoes, snr=np.inf, trigger_jitter_s=0.0, fit_gain=1.0)
    few = draws * _scatterers_expected(conditions, _cells(conditions)[0]) < MOST_KEPT
    block = _seeded_block if few else _seeded_block.__wrapped__
    blocks = (block(echoes, number, size) for number, size in enumerate(_block_sizes(draws)))
    scattering = _displaced(blocks, conditions, _cells(conditions)[0], moved)
    return scattering.speckle(conditions.gate_length_m, conditions.pulse_length_m)


@functools.lru_cache(maxsize=100)
def _seeded_block(echoes: Conditions, number: int, draws: int) -> _Block:
    return _draw_block(echoes, np.random.default_rng([0, number]), draws, *_cells(echoes))


def _cells(conditions: Conditions) -> tuple[float, int]:
    """Return how deep a gate's scatterers lie, m, and in how many cells of depth they are summed."""
    deep_m = conditions.gate_length_m + conditions.pulse_length_m
    return deep_m, int(np.clip(4 * np.ceil(deep_m / conditions.pulse_length_m), 48, 192))


def draw_scattering(
    conditions: Conditions,
    generator: np.random.Generator,
    draws: int,
    deep_m: float,
    cells: int,
    moved: Moved | None = None,
) -> Scattering:
    """Return ``draws`` draws of the conditions's scatterers in ``cells`` cells within ``deep_m`` around the focus.

    They are displaced as ``moved`` says, without it by the Gaussian of eq. (12). What they echo hangs on the tracking
    beam and density alone: the same draws serve any gate and pulse that stay within. Of more scatterers a draw than
    ``MOST_SCATTERERS`` so many are drawn: what draws say does not depend on how strong the echo is.
    """
    blocks = (_draw_block(conditions, generator, size, deep_m, cells) for size in _block_sizes(draws))
    return _displaced(blocks, conditions, deep_m, moved)


@dataclass(frozen=True, slots=True)
class _Block:
    """Scatterers of some draws: place (3, scatterer), m, real and imaginary echo, and cell, counted over the draws.

    ``echo``: summed into the cells, (draw, cell).
    """

    place_m: SingleArray
    parts: tuple[SingleArray, SingleArray]
    cell: Int64Array
    echo: ComplexArray

    def displaced(self, moved: Moved) -> ComplexArray:
        """Return the echoes times the displacement summed into the cells, (draw, cell)."""
        weight = moved(self.place_m)
        return _summed(self.cell, (self.parts[0] * weight, self.parts[1] * weight), self.echo.shape)


def _summed(cell: Int64Array, parts: Iterable[SingleArray], shape: tuple[int, ...]) -> ComplexArray:
    # real and imaginary parts one by one: sums are of real numbers, and complex exponentials cost thrice as much
    real, imaginary = (np.bincount(cell, part, math.prod(shape)) for part in parts)
    return (real + 1j * imaginary).reshape(shape).astype(np.complex64)


def _block_sizes(draws: int) -> list[int]:
    return [min(BLOCK_DRAWS, draws - first) for first in range(0, draws, BLOCK_DRAWS)]


def _displaced(blocks: Iterable[_Block], conditions: Conditions, deep_m: float, moved: Moved | None) -> Scattering:
    """Return scatterers displaced as ``moved`` says, without it by the Gaussian of ``conditions``."""
    moved = moved or functools.partial(_gaussian, conditions.excitation_width_m)
    echo, weighted = zip(*((block.echo, block.displaced(moved)) for block in blocks), strict=True)
    cells = echo[0].shape[1]
    return Scattering(np.concatenate(echo), np.concatenate(weighted), ((np.arange(cells) + 0.5) / cells - 0.5) * deep_m)


def _draw_block(
    conditions: Conditions, generator: np.random.Generator, draws: int, deep_m: float, cells: int
) -> _Block:
    count = generator.poisson(_scatterers_expected(conditions, deep_m), draws)
    place, phase = (generator.random((rows, count.sum()), dtype=np.float32) for rows in (3, 1))
    at_m, angle = (place - np.float32(0.5)) * _box_m(conditions, deep_m)[:, None], np.float32(2 * np.pi) * phase[0]
    echo = _gaussian(conditions.tracking_width_m, at_m)
    cell = np.minimum((place[2] * np.float32(cells)).astype(np.int64), cells - 1)
    cell += cells * np.repeat(np.arange(draws), count)
    parts = echo * np.cos(angle), echo * np.sin(angle)
    return _Block(at_m, parts, cell, _summed(cell, parts, (draws, cells)))


def _box_m(conditions: Conditions, deep_m: float) -> SingleArray:
    """Return the sides of the drawn box, m."""
    return np.array([*(2 * LATERAL * width for width in conditions.tracking_width_m[:2]), deep_m], dtype=np.float32)


def _scatterers_expected(conditions: Conditions, deep_m: float) -> float:
    return min(conditions.scatterers_per_m3 * float(np.prod(_box_m(conditions, deep_m))), MOST_SCATTERERS)


def _gaussian(width_m: Triple, place_m: SingleArray) -> SingleArray:
    """Return a Gaussian of the sigmas ``width_m`` at ``place_m`` (3, scatterer) from its middle."""
    return np.asarray(np.exp((-0.5 / np.square(width_m)).astype(np.float32) @ np.square(place_m)))


def _whole_gate(conditions: Conditions, speckle: Speckle, by_carrier: bool) -> tuple[FloatArray, float]:
    """Return tracked over peak displacement (draw,) of the phase of the whole gate, and the energy's share in the band.

    A moved echo a(t - 2u/c) exp(j w (t - 2u/c)) turns by its derivative against the echo at rest; that over the mean
    frequency in the gate, or ``by_carrier`` over the carrier, is what is tracked. Derivatives are those of echoes that
    go on beyond the gate: what its ends cut is no step.
    """
    carrier = 2 * np.pi * conditions.carrier_hz

    def turning(envelope: ComplexArray) -> FloatArray:
        slope = np.gradient(envelope, _instant_s(conditions), axis=-1) + 1j * carrier * envelope
        return np.asarray(np.sum(np.conj(speckle.resting) * slope, axis=-1).imag)

    energy = np.sum(np.abs(speckle.resting) ** 2, axis=-1)
    ratio = turning(speckle.moved) / (carrier * energy if by_carrier else turning(speckle.resting))
    in_band = np.sum(np.abs(_times(speckle.resting, _to_band(conditions, INSTANTS))) ** 2)
    return np.asarray(ratio), float(in_band / (INSTANTS * energy.sum()))


def _walk(conditions: Conditions, pulse: float) -> float:
    """Return the phase variance of a step's own noise for one correlation over the whole band.

    With M independent numbers in the gate and ``pulse`` = 1/(2 M s) of white noise, a step has 2 M ``pulse``^2 of its
    own. Of noise limited to the band B before a gate T cuts it, M is the sum of the squared eigenvalues of time and
    band limiting (Slepian and Pollak, 1961): less than B T, since at the gate's ends neighbours are alike.
    """
    between_s = _instant_s(conditions) * np.subtract.outer(np.arange(INSTANTS), np.arange(INSTANTS))
    band_hz = BAND_OF_CARRIER * conditions.carrier_hz
    covariance = band_hz * _instant_s(conditions) * np.sinc(band_hz * between_s)
    return 2 * float(np.sum(covariance**2)) * pulse**2


def _quadrature_deviation(conditions: Conditions, spec: EstimatorSpec, pulse: float, walk: float) -> float:
    """Return the standard deviation, m, of a quadrature from the phase variances of a pulse and of a step's own."""
    if spec.fits_all_at_once:
        return conditions.fit_gain * _fitted_deviation(conditions, pulse, walk)
    return _windowed_deviation(conditions, pulse, walk, spec.slow_time_noise)


def _windowed_deviation(conditions: Conditions, pulse: float, walk: float, window_noise: float) -> float:
    """Return the standard deviation, m, of a quadrature after a window over steps, N sum w^2 / (sum w)^2 its noise."""
    half_step = np.sin(np.pi * conditions.frequency_hz / conditions.pulse_rate_hz)
    level = pulse + walk / (4 * half_step**2)
    return float(conditions.metres_per_radian * np.sqrt(2 * window_noise * level / conditions.pulses))


def _fitted_deviation(conditions: Conditions, pulse: float, walk: float) -> float:
    """Return the standard deviation, m, of a quadrature fitted to the pulses with a constant, by least squares.

    A random walk is strongest at its slowest, and a fit without window lets that into the quadratures.
    """
    if walk == 0:
        return float(conditions.metres_per_radian * np.sqrt(2 * pulse / conditions.pulses))
    angle = 2 * np.pi * conditions.frequency_hz / conditions.pulse_rate_hz * np.arange(conditions.pulses)
    rows = np.linalg.pinv(np.stack([np.sin(angle), np.cos(angle), np.ones_like(angle)], axis=-1))[:2]
    over_steps = np.cumsum(rows[:, :0:-1], axis=1)
    level = pulse * np.sum(rows**2) / 2 + walk * np.sum(over_steps**2) / 2
    return float(conditions.metres_per_radian * np.sqrt(level))


def _with_noise(
    conditions: Conditions, estimator: str, ratio: FloatArray, deviation: float, relative: tuple[float, ...]
) -> Expected:
    """Return what noise makes of amplitudes ``ratio`` (draw,): a Rice distribution about each."""
    # in double precision: the spread is a small difference
    amplitude = np.abs(ratio, dtype=np.float64) * conditions.amplitude_m
    mean = _rice_mean(amplitude, deviation)
    spread = np.maximum(amplitude**2 + 2 * deviation**2 - mean**2, 0.0)
    phase = np.minimum(deviation / np.maximum(amplitude, np.finfo(np.float64).tiny), PHASE_LIMIT)
    # the mean of 1/amplitude^2 hangs on the few darkest draws: leave a hundredth out
    phase = np.minimum(phase, np.sort(phase)[int(0.99 * (phase.size - 1))])
    return Expected(
        estimator,
        float(mean.mean() - conditions.amplitude_m),
        deviation,
        float(np.sqrt(spread.mean())),
        float(mean.std()),
        0.0,
        float(np.sqrt(np.mean(phase**2))),
        float(ratio.mean()),
        relative,
    )


def _rice_mean(amplitude: FloatArray, deviation: float) -> FloatArray:
    """Return the mean of the length of a vector ``amplitude`` plus noise ``deviation`` in both its parts."""
    if deviation == 0:
        return amplitude
    if not amplitude.any():
        return np.full_like(amplitude, deviation * np.sqrt(np.pi / 2))
    x = np.square(amplitude / deviation) / 2
    if x.min() > FAR_FROM_NOISE:
        # sqrt(pi / 2) L_1/2(-x) by its asymptotic series: what it leaves out is below 1e-16
        return np.asarray(amplitude * (1 + (1 / 4 + (1 / 32 + (3 / 128) / x) / x) / x))
    from scipy.special import ive

    # L_1/2(-x) = exp(-x/2) [(1 + x) I0(x/2) + x I1(x/2)], the exponential inside the scaled functions
    return np.asarray(deviation * np.sqrt(np.pi / 2) * ((1 + x) * ive(0, x / 2) + x * ive(1, x / 2)))


def _peak_statistics(
    conditions: Conditions, speckle: Speckle, generator: np.random.Generator
) -> tuple[FloatArray, list[tuple[float, float]]]:
    """Return ratio (draw,) at the cross-spectrum's peak, and its phase's pulse variance and a step's own variance.

    The variances are those of ``GROUPS`` of equally many draws, from the weakest echo to the strongest. Three noisy
    pulses a draw, so two steps: s_1 = p_2(f_1) - p_1(f_1) and s_2 = p_3(f_2) - p_2(f_2). Pulse noise v and own noise w
    give Var s = 2 v + w and Cov(s_1, s_2) = -v; where noise moves the peak, f_1 differs from f_2. Steps q at f_1 alone,
    of phases against the clean echo, have no noise of their own: their Var q + 2 Cov(q_1, q_2) is what chance makes of
    the draws at hand, and is taken off. So is the difference of -Cov of the phases' linear form at the clean peak from
    what it is known to be, the noise in a bin over the peak's power. w is that of the weakest echoes, nearly all of it:
    they are given more noise.
    """
    to_band = _to_band(conditions, PADDING * INSTANTS, hann(INSTANTS))
    power = np.mean(np.abs(speckle.resting) ** 2, axis=-1, keepdims=True)
    # noise of the real signal's band, seen through the gate: its share in INSTANTS samples of the envelope
    scale = np.sqrt(power * INSTANTS / (conditions.gate_samples * conditions.snr))
    clean, moved = _times(speckle.resting, to_band), _times(speckle.moved, to_band)
    weakness = np.square(scale[:, 0] / np.abs(clean).max(axis=-1), dtype=np.float64)
    groups = np.array_split(np.argsort(-weakness), GROUPS)
    first, second, pulse, own = _two_steps(clean, scale, to_band, generator)
    ratios = [_taken(moved / clean, peak).real for peak in (first, second)]
    weak = np.concatenate(groups[: GROUPS // 8])
    more = [_two_steps(clean[weak], scale[weak], to_band, generator)[2:] for _ in range(MORE_NOISE)]
    for values, number in ((pulse, 0), (own, 1)):
        values[weak] = np.mean([values[weak], *(each[number] for each in more)], axis=0)
    # a step of the motion read at one peak or the other
    half_step = np.sin(np.pi * conditions.frequency_hz / conditions.pulse_rate_hz)
    step_power = 2 * np.square(conditions.amplitude_m / conditions.metres_per_radian * half_step)
    own += float(np.mean((ratios[0] - ratios[1]) ** 2)) / 2 * step_power
    known = float(np.square(hann(INSTANTS)).sum() * weakness.mean())
    mean_pulse = max(known + float(pulse.mean()), 0.0)
    variances = [
        (mean_pulse * float(weakness[group].mean() / weakness.mean()), max(float(own[group].mean()), 0.0))
        for group in groups
    ]
    return (ratios[0] + ratios[1]) / 2, variances


def _two_steps(
    clean: ComplexArray, scale: FloatArray, to_band: ComplexArray, generator: np.random.Generator
) -> tuple[Int64Array, Int64Array, FloatArray, FloatArray]:
    """Return both peaks (draw, 1), and of each draw (draw,) what adds up to variances.

    Of the pulse's, beyond that of its phase's linear form, and of a step's own.
    """
    shape = (len(clean), 3, clean.shape[1])
    noisy = _noise_in_band(to_band, math.prod(shape[:2]), generator).reshape(shape) * scale[:, None] + clean[:, None]
    level = noisy.real**2 + noisy.imag**2
    first, second = (np.argmax(level[:, k] * level[:, k + 1], axis=-1)[:, None] for k in (0, 1))
    steps = [_phase_step(noisy[:, k], noisy[:, k + 1], peak) for k, peak in ((0, first), (1, second))]
    phases = [_phase_step(clean, noisy[:, k], first) for k in range(3)]
    own = _own_variance(*steps) - _own_variance(phases[1] - phases[0], phases[2] - phases[1])
    middle = np.argmax(np.abs(clean), axis=-1)[:, None]
    at_peak = _taken(clean, middle)
    linear = [(np.conj(at_peak) * _taken(noisy[:, k], middle)).imag / np.abs(at_peak) ** 2 for k in range(3)]
    beyond = (linear[1] - linear[0]) * (linear[2] - linear[1]) - steps[0] * steps[1]
    return first, second, np.asarray(beyond, dtype=np.float64), own


def _own_variance(first: FloatArray, second: FloatArray) -> FloatArray:
    return np.asarray((first**2 + second**2) / 2 + 2 * first * second, dtype=np.float64)


def _noise_in_band(to_band: ComplexArray, count: int, generator: np.random.Generator) -> ComplexArray:
    """Return ``count`` draws of white noise, each of its parts of variance 1, after ``to_band``.

    Neighbouring bins are nearly alike: some sixteen numbers make them all.
    """
    _, size, direction = np.linalg.svd(to_band, full_matrices=False)
    kept = size > NEGLIGIBLE * size[0]
    parts = generator.standard_normal((count, np.count_nonzero(kept), 2), dtype=np.float32)
    return np.asarray(parts.view(np.complex64)[..., 0] @ (size[kept, None] * direction[kept]), dtype=np.complex64)


def _instant_s(conditions: Conditions) -> float:
    return 2 * conditions.gate_length_m / conditions.sound_speed_m_per_s / INSTANTS


def _band_hz(conditions: Conditions, bins: int) -> FloatArray:
    """Return the frequencies (bin,) of the envelope's spectrum of ``bins`` that lie in the searched band."""
    every = np.fft.fftfreq(bins, _instant_s(conditions))
    return np.asarray(every[np.abs(every) <= conditions.carrier_hz * BAND_OF_CARRIER / 2])


def _to_band(conditions: Conditions, bins: int, window: FloatArray | float = 1.0) -> ComplexArray:
    """Return the matrix (instant, bin) from envelopes to their spectrum of ``bins``, zeros appended, in the band.

    ``window`` (instant,) weights the envelopes. The band is a sixth of the bins: the product costs a third of the
    Fourier transform of them all.
    """
    turn = 2 * np.pi * _instant_s(conditions) * np.outer(_band_hz(conditions, bins), np.arange(INSTANTS))
    return np.asarray((window * np.exp(-1j * turn)).T)


def _times(drawn: ComplexArray, matrix: ComplexArray | FloatArray) -> ComplexArray:
    """Return ``drawn`` times ``matrix``, as precise as what is drawn."""
    return np.asarray(drawn @ matrix.astype(drawn.dtype))


def _taken(values: ComplexArray, place: Int64Array) -> ComplexArray:
    return np.take_along_axis(values, place, axis=-1)[:, 0]


def _phase_step(before: ComplexArray, after: ComplexArray, place: Int64Array) -> FloatArray:
    return np.asarray(np.angle(np.conj(_taken(before, place)) * _taken(after, place)))
