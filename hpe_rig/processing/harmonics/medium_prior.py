"""Harmonics of tonebursts with a prior from physics: what a medium can do, not only what the pulses tell apart.

Under a long train of tonebursts the displacement is periodic: d = A x + background + noise, x the in-phase and
quadrature states of every harmonic of the burst rate up to 40 kHz. What media make of the bursts' known spectrum spans
few directions of x: its covariance over an ensemble of media is s^2 F F', F (state, rank), s the rms displacement, and

    x = K d,   K = P A' (A P A' + R)^-1,   P = (k s)^2 F F'
    covariance of its error = K R K' + mean of (I - K A) x_m x_m' (I - K A)'        noise, and aliasing and shrinkage

s maximises the evidence; k = 3 leaves the weights to the data where s is a little off. The mean goes over the members
x_m of the ensemble, each as large and as likely as the data have it. The singular value decomposition A F = U L V'
turns all of it into sums over the rank. See docs/explanation/medium-prior.md.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hpe_rig.arrays import BoolArray, ComplexArray, FloatArray, IndexArray
from hpe_rig.medium import BeamWidths, Ensemble, KnownMedium, RigidSphere, medium_ensemble
from hpe_rig.processing.echo.echoes import Motion
from hpe_rig.processing.harmonics.harmonic_fit import (
    HarmonicFit,
    MediumPosterior,
    fit_from_state,
    of_changes,
    step_covariance,
)
from hpe_rig.processing.harmonics.kalman_filter import filter_constant, innovation_test
from hpe_rig.processing.harmonics.model import background_columns, harmonic_columns

HIGHEST_HZ = 4e4
"""Frequency up to which the bursts' harmonics are part of the model."""
WEIGHT = 3.0
"""Scale k of the weights over that of the evidence."""
VOIGT_SHARE = 10.0
"""Weight of a Voigt medium in P over that of a medium of another family: they are the rule, and pulses that stand still
against the bursts cannot tell."""
MISFIT = 3e-3
"""Standard deviation of a medium from what the ensemble spans, relative to its rms response at a frequency."""
FREEDOM = 0.03
"""The same for each wanted harmonic alone: reflections and layers, which no medium without end has."""
LEAST_MEMBERS = 15.0
"""Members that carry the error's mean at least: the ensemble has no more where the data narrow it down."""
LEAST_SHARE = 0.5
"""Of the likely members' rms motion at a frequency: the change of one that moves less is relative to this much."""
BROAD = 1e5
"""Standard deviation of a background state over the noise of a pulse, for the Kalman filter: nothing known."""
UNTOLD = 1e-3
"""Error of the model at any instant of a burst's period, relative to the rms motion: the ensemble's own, and that of
speckle and receiver. Pulses that come at the same instant share it."""
UNEXPLAINED = 4.0
"""Mean square of a residual, over that of the steps' noise, from which on more than this noise is in it."""
UNSEEN = 1e-10
"""Singular value over the largest up to which pulses see nothing of a direction."""
SAME_RAD = 1e-12
"""Phase of the burst rate up to which pulses are computed once: a thousandth of a picosecond at 100 Hz."""
ALIKE_S = 1 / (40 * HIGHEST_HZ)
"""How far apart in a burst's period pulses share what the model leaves untold, 0.6 us: a fortieth of the fastest
harmonic's period, far beyond the jitter of triggers and what times are rounded to in hours."""
SCAN = np.arange(0.0, 9.0, 0.1) * np.log(10)
"""Logarithms of the scales tried, over the one at which the strongest direction stands as high as a pulse's noise."""


@dataclass(frozen=True, slots=True, eq=False)
class MediumPrior:
    """Prior of the states of all harmonics for a motion of 1 m rms; compared by identity, read-only.

    A medium is given by its response at a few nodes of frequency, real parts, then imaginary: ``2 * node`` directions.
    ``spectrum`` complex (harmonic, node) takes the response to A exp(j phase) of every harmonic's motion. ``root``
    (direction, direction) is a root of the directions' covariance, so F is ``states(all harmonics) @ root``.
    ``members`` (member, direction) are the ensemble, ``misfit`` (direction,) standard deviations from it;
    ``averaging``, complex (member, harmonic): peak over tracked motion; ``amplitude_m``, the same shape, real: that of
    a member's motion; ``steepness``: its relative change with the logarithm of the tracking beam's area.
    """

    burst_rate_hz: float
    spectrum: ComplexArray
    root: FloatArray
    members: FloatArray
    misfit: FloatArray
    averaging: ComplexArray
    amplitude_m: FloatArray
    steepness: ComplexArray

    @property
    def frequency_hz(self) -> FloatArray:
        """Frequencies (harmonic,) of the states."""
        return self.burst_rate_hz * np.arange(1.0, self.averaging.shape[1] + 1)

    def states(self, places: Sequence[int]) -> FloatArray:
        """Return the matrix (2 * place, direction) from directions to in-phase and quadrature of harmonics, from 0."""
        rows = self.spectrum[list(places)]
        pairs = np.hstack([rows.real, -rows.imag]), np.hstack([rows.imag, rows.real])
        return np.stack(pairs, axis=1).reshape(2 * len(rows), -1)

    def columns(self, time_s: FloatArray, places: Sequence[int]) -> tuple[FloatArray, FloatArray]:
        """Return the motion (pulse, direction) of every direction, and (pulse, 2 * place) of states of some harmonics.

        The same as ``harmonic_columns``, by powers of one exponential a pulse, once for all pulses that come at the
        same instant of a burst's period.
        """
        first, again = self.distinct(time_s)
        turns = _powers(self._turn(time_s[first]), len(self.spectrum))
        motion, wanted = turns @ self.spectrum, turns[:, list(places)]
        return np.hstack([motion.imag, motion.real])[again], _real_pairs(1j * np.conj(wanted))[again]

    def distinct(self, time_s: FloatArray) -> tuple[IndexArray, IndexArray]:
        """Return pulses (instant,) of which each comes at another instant, and (pulse,) which of these each repeats."""
        angle_rad = np.angle(self._turn(time_s))
        _, first, again = np.unique(np.rint(angle_rad / SAME_RAD), return_index=True, return_inverse=True)
        return first, again

    def _turn(self, time_s: FloatArray) -> ComplexArray:
        sin, cos = harmonic_columns(time_s, np.array([self.burst_rate_hz])).T
        return np.asarray(cos + 1j * sin)

    def instants(self, time_s: FloatArray) -> float:
        """Return at how many instants of a burst's period, ``ALIKE_S`` and more apart, the pulses come.

        Every pulse counts as its share of those that come when it does, jitter or none.
        """
        part, near = np.sort(self.burst_rate_hz * time_s % 1.0), self.burst_rate_hz * ALIKE_S
        round_it = np.concatenate([part - 1, part, part + 1])
        near_it = np.searchsorted(round_it, part + near, "right") - np.searchsorted(round_it, part - near, "left")
        return float(np.sum(1 / near_it))

    def places(self, frequency_hz: FloatArray) -> tuple[int, ...]:
        """Return which harmonics ``frequency_hz`` are, from 0; raise ``ValueError`` where one is none."""
        number = np.rint(frequency_hz / self.burst_rate_hz)
        near = np.abs(frequency_hz - number * self.burst_rate_hz) <= 1e-6 * self.burst_rate_hz
        if not np.all(near & (number >= 1) & (number <= self.averaging.shape[1])):
            raise ValueError(
                f"frequencies {frequency_hz.tolist()} Hz are not all multiples of the burst rate of "
                f"{self.burst_rate_hz:g} Hz up to {self.frequency_hz[-1]:g} Hz: the tonebursts drive no others; "
                "try least_squares"
            )
        return tuple((number.astype(int) - 1).tolist())


@dataclass(frozen=True, slots=True)
class Evidence:
    """Scale, noise and test of the data against the prior, each (...), and how likely the members are.

    ``scale_m``: rms displacement of the ensemble; ``variance_m2`` of a pulse's noise; ``total_m2``: the same with what
    the model leaves untold, as if it differed from pulse to pulse; ``freedom``: degrees of freedom of the residual that
    tells the noise; ``significance``: probability that a medium of the ensemble gives data as unlikely as these.
    ``likelihood`` (..., member), of sum 1; ``square_m2`` (..., member), mean square of each member's own scale.
    """

    scale_m: FloatArray
    variance_m2: FloatArray
    total_m2: FloatArray
    freedom: FloatArray
    significance: FloatArray
    likelihood: FloatArray
    square_m2: FloatArray


@dataclass(frozen=True, slots=True)
class MediumFit:
    """Wanted harmonics with their total covariance, its two parts, and the evidence.

    ``noise_m2`` and ``aliasing_m2`` (..., 2 * frequency, 2 * frequency) add up to ``fit.state_covariance``; ``taken``
    (..., seen) is the share of the data that the estimate takes in each direction that the pulses see.
    """

    fit: HarmonicFit
    noise_m2: FloatArray
    aliasing_m2: FloatArray
    evidence: Evidence
    taken: FloatArray


@dataclass(frozen=True, slots=True)
class Seen:
    """What the valid pulses see of a prior, the background taken off: A F = left diag(value) right'.

    ``left`` (pulse, seen), ``value`` (seen,) ``right`` (seen, rank): right'; ``rows`` (2 * wanted, seen), F right of
    the wanted states. ``members`` (member, seen), in ``left``, and ``wanted_members`` (member, 2 * wanted): every
    member's motion; ``free`` and ``wanted_free`` the same of misfit and of the wanted harmonics' own freedom. For the
    filter ``factor`` (instant, rank), A F with its background, ``again`` (pulse,) which of its rows each pulse has,
    ``wanted`` (2 * wanted, rank), F of the wanted states, and ``background`` (pulse, order + 1), orthonormal.
    ``alike``: how many pulses come at the same instant of a burst's period, on average, times the share of what they
    share there that no residual shows.
    """

    left: FloatArray
    value: FloatArray
    right: FloatArray
    rows: FloatArray
    members: FloatArray
    wanted_members: FloatArray
    free: FloatArray
    wanted_free: FloatArray
    factor: FloatArray
    again: IndexArray
    wanted: FloatArray
    background: FloatArray
    alike: float


@functools.lru_cache(maxsize=8)
def medium_prior(
    pushed: BeamWidths | RigidSphere,
    burst_rate_hz: float,
    burst_length_s: float,
    known: KnownMedium | None = None,
    density_kg_per_m3: float = 1000.0,
) -> MediumPrior:
    """Return the prior of the motion under tonebursts of ``burst_length_s`` at ``burst_rate_hz``.

    Times count from a burst's onset at the focus. A ``known`` medium narrows the ensemble to Voigt media near it. The
    force's spectrum is that of rectangular pulses (``driven_spectrum``).
    """
    ensemble = medium_ensemble(pushed, *harmonic_range_hz(burst_rate_hz), known, density_kg_per_m3)
    spectrum = driven_spectrum(ensemble, burst_rate_hz, burst_length_s)
    tracked, peak = ensemble.tracked @ spectrum.T, ensemble.peak @ spectrum.T
    unit = np.sqrt(2 / np.sum(np.abs(tracked) ** 2, axis=1))[:, None]
    # a few ten node values, real and imaginary, hold each member: from there to the states by one matrix
    nodes = unit * ensemble.tracked
    members = np.hstack([nodes.real, nodes.imag])
    share = np.where(ensemble.voigt, VOIGT_SHARE, 1.0)
    power = (share / share.sum()) @ (members**2)
    misfit = MISFIT * np.sqrt(np.tile(power.reshape(2, -1).mean(axis=0), 2))
    weighted = np.sqrt(share / share.sum())[:, None] * members
    root = np.asarray(np.linalg.qr(np.vstack([weighted, np.diag(misfit)]), mode="r")).T
    steepness = ensemble.steepness @ spectrum.T / tracked
    seen = peak / tracked, unit * np.abs(tracked), steepness
    prior = MediumPrior(burst_rate_hz, spectrum, root, members, misfit, *seen)
    for array in (spectrum, root, members, misfit, *seen):
        array.flags.writeable = False
    return prior


def driven_spectrum(ensemble: Ensemble, burst_rate_hz: float, burst_length_s: float) -> ComplexArray:
    """Return what takes responses at the ensemble's nodes to A exp(j phase) of every harmonic, (harmonic, node).

    Of the motion under rectangular tonebursts, paper eq. (18), up to ``harmonic_range_hz``.
    """
    harmonic = np.arange(1.0, round(harmonic_range_hz(burst_rate_hz)[1] / burst_rate_hz) + 1)
    duty = burst_rate_hz * burst_length_s
    # A sin(w t + phase) has A exp(j phase) = j times the amplitude of exp(jwt), which is twice the coefficient
    force = 2j * np.sinc(harmonic * duty) * np.exp(-1j * np.pi * harmonic * duty)
    return np.asarray(force[:, None] * ensemble.interpolation(np.asarray(burst_rate_hz * harmonic)))


def harmonic_range_hz(burst_rate_hz: float) -> tuple[float, float]:
    """Return the first and the last of the bursts' harmonics that are part of the model."""
    return burst_rate_hz, burst_rate_hz * max(1, int(HIGHEST_HZ / burst_rate_hz * (1 + 1e-9)))


def medium_fit(
    motion: Motion,
    frequencies_hz: FloatArray | Sequence[float],
    prior: MediumPrior,
    *,
    background_order: int = 0,
) -> MediumFit:
    """Return amplitudes and phases of the wanted harmonics with the prior of media, in closed form.

    Every valid pulse has the same weight: what the echoes state of each scatters more than their noise differs, and
    trigger jitter, the same for all, is no part of it. The noise is therefore that of the residual, over the degrees of
    freedom that the prior leaves; of accumulated steps it is white plus a random walk. Raises ``ValueError`` for
    frequencies that are no harmonics of the bursts and for too few pulses.
    """
    frequency_hz = np.asarray(frequencies_hz, dtype=np.float64)
    seen = seen_by(prior, motion.time_s, motion.valid, frequency_hz, background_order)
    data = _without_background(motion, seen)
    along = data @ seen.left
    evidence = _evidence(seen, data, along)
    gain = _gain(seen, evidence)
    weights = seen.rows * gain[..., None, :]
    taken = gain * seen.value
    white = weights @ np.swapaxes(weights, -1, -2)
    noise, freedom = evidence.total_m2[..., None, None] * white, evidence.freedom
    if motion.walk is not None:
        residual, walk = data - (taken * along) @ seen.left.T, np.asarray(motion.walk)
        columns = np.hstack([seen.background, seen.left])
        shares = np.concatenate([np.ones((*taken.shape[:-1], seen.background.shape[1])), taken], axis=-1)
        energy, freedom = of_changes(columns, shares, walk)
        pulse, of_steps = step_covariance(residual, walk, weights @ seen.left.T, energy)
        # Steps do not see what drifts slowly, a creep say; where a residual is far larger than they explain, it counts.
        explained = pulse * (1 + walk * len(seen.left) / 6)
        drifts = evidence.variance_m2 > UNEXPLAINED * explained
        untold = (evidence.total_m2 - evidence.variance_m2)[..., None, None] * white
        noise = of_steps + np.where(drifts[..., None, None], noise, untold)
    aliasing, missed = _aliasing(seen, weights, evidence)
    state = (gain * along) @ seen.rows.T
    variance, used = evidence.variance_m2, len(seen.left)
    fit = fit_from_state(frequency_hz, state, noise + aliasing, variance, used, aliasing_m2=aliasing, freedom=freedom)
    fit = replace(fit, medium=medium_posterior(prior, evidence, fit, missed))
    return MediumFit(fit, noise, aliasing, evidence, taken)


def fit_residual(
    motion: Motion, frequencies_hz: FloatArray | Sequence[float], prior: MediumPrior, *, background_order: int = 0
) -> FloatArray:
    """Return what ``medium_fit`` leaves of the displacement, (..., valid pulse)."""
    frequency_hz = np.asarray(frequencies_hz, dtype=np.float64)
    found = medium_fit(motion, frequency_hz, prior, background_order=background_order)
    seen = seen_by(prior, motion.time_s, motion.valid, frequency_hz, background_order)
    data = _without_background(motion, seen)
    return np.asarray(data - (found.taken * (data @ seen.left)) @ seen.left.T)


def likely_states(
    motion: Motion, found: MediumFit, prior: MediumPrior, directions: FloatArray, background_order: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return any states (..., state) of the motion that ``found`` is the fit of, linear in the prior's directions.

    ``directions`` (state, direction) takes the directions to the states. And the covariance (..., state, state) of
    their error, of noise and of what media are likely, and by how much they miss each member's, of scale 1, (...,
    member, state).
    """
    seen, evidence = (
        seen_by(prior, motion.time_s, motion.valid, found.fit.frequency_hz, background_order),
        found.evidence,
    )
    # what each wanted harmonic has for itself is no direction
    rows = directions @ prior.root @ seen.right[:, : len(prior.root)].T
    free = np.zeros((len(seen.free), len(directions)))
    free[: prior.misfit.size] = prior.misfit[:, None] * directions.T
    gain = _gain(seen, evidence)
    weights = rows * gain[..., None, :]
    noise = evidence.total_m2[..., None, None] * (weights @ np.swapaxes(weights, -1, -2))
    of_these = replace(seen, wanted_members=prior.members @ directions.T, wanted_free=free)
    left, missed = _aliasing(of_these, weights, evidence)
    return (gain * (_without_background(motion, seen) @ seen.left)) @ rows.T, noise + left, missed


def _without_background(motion: Motion, seen: Seen) -> FloatArray:
    data = motion.displacement_m[..., motion.valid]
    return np.asarray(data - (data @ seen.background) @ seen.background.T)


def _gain(seen: Seen, evidence: Evidence) -> FloatArray:
    """Return the weights (..., seen) that take the data along ``seen.left`` to the prior's factor."""
    start = (WEIGHT * evidence.scale_m[..., None]) ** 2
    return np.asarray(start * seen.value / (evidence.total_m2[..., None] + start * seen.value**2))


def medium_kalman(
    motion: Motion,
    frequencies_hz: FloatArray | Sequence[float],
    prior: MediumPrior,
    *,
    background_order: int = 0,
) -> MediumFit:
    """Return the same by the square-root Kalman filter, its start covariance P, with the test of its innovations.

    The filter runs on x = F a, a of covariance (k s)^2 I at the start. Scale and noise are those of ``medium_fit``.
    """
    whole = medium_fit(motion, frequencies_hz, prior, background_order=background_order)
    seen = seen_by(prior, motion.time_s, motion.valid, whole.fit.frequency_hz, background_order)
    scale, noise = whole.evidence.scale_m.reshape(-1), np.sqrt(whole.evidence.total_m2.reshape(-1))
    data = motion.displacement_m[..., motion.valid]
    states, innovations = [], []
    for each, s, sigma in zip(data.reshape(-1, data.shape[-1]), scale.tolist(), noise.tolist(), strict=True):
        start = WEIGHT * s / sigma
        matrix = np.hstack([start * seen.factor[seen.again], BROAD * seen.background])
        found = filter_constant(matrix, each / sigma, 1.0, innovations=True)
        states.append(WEIGHT * s * seen.wanted @ found.state[: seen.wanted.shape[1]])
        innovations.append(found.innovations * sigma)
    test = innovation_test(motion, np.reshape(innovations, data.shape), seen.background.shape[1])
    known = whole.fit.state_covariance, whole.evidence.variance_m2, whole.fit.pulses
    state = np.reshape(states, (*data.shape[:-1], -1))
    rest = np.nan, test, whole.aliasing_m2
    fit = fit_from_state(whole.fit.frequency_hz, state, *known, *rest, freedom=whole.fit.freedom)
    return replace(whole, fit=replace(fit, medium=whole.fit.medium))


def medium_posterior(prior: MediumPrior, evidence: Evidence, fit: HarmonicFit, missed: FloatArray) -> MediumPosterior:
    """Return what the data say of the medium, every member as likely as they have it.

    ``fit`` has the frequencies and how large the amplitudes are; ``missed`` (..., member, 2 * frequency) is by how much
    the estimate misses the states of every member of scale 1, true less estimated.
    """
    places, likelihood = list(prior.places(fit.frequency_hz)), evidence.likelihood
    ratio, own_m2 = (
        np.log(prior.averaging[:, places]),
        evidence.square_m2[..., None] * prior.amplitude_m[:, places] ** 2,
    )
    # where nothing moves at all, squares may be below the smallest number
    mean_m2 = np.maximum(np.einsum("...m,...mf->...f", likelihood, own_m2), np.finfo(np.float64).tiny)
    steepness = _parts(bounded_steepness(prior.steepness[:, places], own_m2 / mean_m2[..., None, :]))
    mean = likelihood @ ratio
    off = _parts(np.asarray(ratio - mean[..., None, :]))
    phasor_m = fit.amplitude_m * np.exp(1j * fit.phase_rad)
    each = missed[..., ::2] + 1j * missed[..., 1::2]
    short = _parts(np.asarray(each / np.where(phasor_m == 0, np.inf, phasor_m)[..., None, :], np.complex128))
    return MediumPosterior(
        evidence.significance,
        np.exp(mean),
        np.einsum("...m,...mfi,...mfj->...fij", likelihood, off, off),
        np.sqrt(np.einsum("...m,...mfi->...fi", likelihood, steepness**2)),
        np.einsum("...m,...mfi,...mfi->...fi", likelihood * np.sqrt(evidence.square_m2), short, off),
    )


def bounded_steepness(steepness: ComplexArray, power: FloatArray) -> ComplexArray:
    """Return the relative change of each member's motion, over no less than ``LEAST_SHARE`` of the members' rms motion.

    ``power`` (..., member, frequency): square of a member's motion over the mean square. Beside a push there are media
    and frequencies of which two waves leave nothing: what then changes is small, though without bound in proportion.
    """
    return np.asarray(steepness * np.minimum(1.0, np.sqrt(power) / LEAST_SHARE))


def _parts(values: ComplexArray) -> FloatArray:
    return np.stack([values.real, values.imag], axis=-1)


def seen_by(
    prior: MediumPrior, time_s: FloatArray, valid: BoolArray, frequency_hz: FloatArray, background_order: int = 0
) -> Seen:
    """Return what the valid pulses at ``time_s`` (pulse,) see of the prior; kept for the next train of the same times.

    Raises ``ValueError`` for frequencies that are no harmonics of the bursts and for too few pulses.
    """
    found = int(valid.sum())
    if found <= background_order + 3:
        raise ValueError(f"{found} valid pulses: too few for an amplitude and its uncertainty; try more pulses")
    return _seen(prior, time_s.tobytes(), valid.tobytes(), prior.places(frequency_hz), background_order)


@functools.lru_cache(maxsize=4)
def _seen(prior: MediumPrior, time_s: bytes, valid: bytes, places: tuple[int, ...], order: int) -> Seen:
    times, used = np.frombuffer(time_s), np.frombuffer(valid, dtype=bool)
    background = np.linalg.qr(background_columns(times, order)[used])[0]
    # Pulses that come again at an instant of the period see the same again, unless the background has moved on.
    every = np.arange(np.count_nonzero(used))
    first, again = (every, every) if order else prior.distinct(times[used])
    count = np.bincount(again)[:, None]
    directions, columns = prior.columns(times[used][first], places)
    basis = prior.states(places)
    # each wanted harmonic's own freedom, the same in both its states
    power = np.sum((basis @ prior.root) ** 2, axis=1).reshape(-1, 2).mean(axis=1)
    own = np.diag(FREEDOM * np.sqrt(np.repeat(power, 2)))
    own_seen = columns @ own
    factor, wanted = np.hstack([directions @ prior.root, own_seen]), np.hstack([basis @ prior.root, own])
    moving = factor - background[first] @ ((count * background[first]).T @ factor)
    # a triangle has the same singular values, and left vectors follow: much less work than those of all pulses
    _, value, right = np.linalg.svd(np.linalg.qr(np.sqrt(count) * moving, mode="r"))
    kept = value > UNSEEN * value[0]
    value, right = value[kept], right[: kept.size][kept]
    left = moving @ (right.T / value)
    seen = directions.T @ (count * left)
    return Seen(
        left[again],
        value,
        right,
        wanted @ right.T,
        prior.members @ seen,
        prior.members @ basis.T,
        np.vstack([prior.misfit[:, None] * seen, own_seen.T @ (count * left)]),
        np.vstack([prior.misfit[:, None] * basis.T, own]),
        factor,
        again,
        wanted,
        background,
        _unshown(int(used.sum()), prior.instants(times[used]), value.size),
    )


def _unshown(pulses: int, instants: float, seen: int) -> float:
    """Return how many times the variance of what all pulses of an instant share is missing from that of the residual.

    Their mean errs by it in full, as by m = pulses / instants times as much in every pulse. Of that the residual has
    what is left of the instants once the ``seen`` directions are fitted, spread over all its degrees of freedom.
    """
    return pulses / instants * (pulses - instants) / (pulses - min(seen, instants))


def _evidence(seen: Seen, data: FloatArray, along: FloatArray) -> Evidence:
    """Return the scale of the largest evidence, the noise and the test.

    With ratio = s / sigma the noise that maximises the evidence is a closed form, so one dimension is scanned:
    -2 log evidence = n log sigma^2 + sum_i log p_i, n sigma^2 = sum_i z_i^2 / p_i + rest,
    p_i = 1 + ratio^2 (L_i^2 + untold^2): pulses see the same instants again and again, and the same error there.
    """
    from scipy.special import fdtrc

    count = data.shape[-1] - seen.background.shape[1]
    rest = np.einsum("...i,...i->...", data, data) - np.einsum("...i,...i->...", along, along)
    tried = SCAN - np.log(seen.value[0])
    untold = seen.alike * UNTOLD**2
    seen_power = seen.value**2 + untold
    power = 1 + np.exp(2 * tried)[:, None] * seen_power
    tiny = np.finfo(np.float64).tiny
    variance = np.maximum(along**2 @ (1 / power).T + rest[..., None].clip(min=0), tiny) / count
    evidence = -(count * np.log(variance) + np.log(power).sum(axis=1)) / 2
    best = _highest(tried, evidence)
    # No medium needs more than the one that the pulses see least of: beyond it lies what no medium explains.
    most = np.sqrt(np.sum(along**2, axis=-1) / np.sum(seen.members**2, axis=1).min())
    at_best = np.take_along_axis(variance, np.argmax(evidence, axis=-1)[..., None], axis=-1)[..., 0]
    ratio = np.minimum(np.exp(best), np.maximum(most / np.sqrt(at_best), np.exp(tried[0])))[..., None]
    # Noise from the residual, over the degrees of freedom that it keeps: right for a medium off the ensemble as well.
    kept = 1 / (1 + ratio**2 * seen_power)
    freedom = count - np.sum(1 - kept, axis=-1)
    noise = np.maximum(np.sum((along * kept) ** 2, axis=-1) + rest.clip(min=0), tiny) / freedom
    scale = ratio[..., 0] * np.sqrt(noise)
    statistic = np.sum(along**2 * kept, axis=-1) / noise / seen.value.size
    significance = fdtrc(seen.value.size, freedom, statistic)
    total = noise + untold * scale**2
    return Evidence(scale, noise, total, freedom, significance, *_likelihood(seen, along, total))


def _likelihood(seen: Seen, along: FloatArray, variance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return likelihood, of sum 1, and mean square scale of every member (..., member).

    exp(-distance / 2 T), distance in noise of the data from the member at its best scale, T >= 1 a power of two.
    """
    power = np.sum(seen.members**2, axis=1)
    scale = np.maximum(along @ seen.members.T, 0.0) / power
    distance = -(scale**2) * power / variance[..., None]
    distance -= distance.min(axis=-1, keepdims=True)
    widening = np.ones(variance.shape)
    for _ in range(60):
        weight = np.exp(-distance / 2 / widening[..., None])
        few = weight.sum(axis=-1) ** 2 < LEAST_MEMBERS * np.sum(weight**2, axis=-1)
        if not few.any():
            break
        widening = np.where(few, 2 * widening, widening)
    return weight / weight.sum(axis=-1, keepdims=True), scale**2 + variance[..., None] / power


def _highest(place: FloatArray, height: FloatArray) -> FloatArray:
    """Return where ``height`` (..., place) is highest, by the parabola through its highest value and its neighbours."""
    top = np.clip(np.argmax(height, axis=-1), 1, place.size - 2)[..., None]
    before, at, after = (np.take_along_axis(height, top + step, axis=-1)[..., 0] for step in (-1, 0, 1))
    bend = np.minimum(before - 2 * at + after, -np.finfo(np.float64).tiny)
    return np.asarray(place[top[..., 0]] + np.clip((before - after) / bend / 2, -1, 1) * (place[1] - place[0]))


def _aliasing(seen: Seen, weights: FloatArray, evidence: Evidence) -> tuple[FloatArray, FloatArray]:
    """Return the covariance (..., state, state) of what ``weights`` (..., state, seen) make wrong without noise.

    And by how much they miss the states of every member, of scale 1, (..., member, state).
    """
    turned = np.swapaxes(weights, -1, -2)
    missed, free = seen.wanted_members - seen.members @ turned, seen.wanted_free - seen.free @ turned
    share = (evidence.likelihood * evidence.square_m2)[..., None]
    total = np.swapaxes(missed, -1, -2) @ (share * missed)
    return total + evidence.scale_m[..., None, None] ** 2 * (np.swapaxes(free, -1, -2) @ free), missed


def _powers(turn: ComplexArray, count: int) -> ComplexArray:
    """Return the powers 1 to ``count`` (pulse, power) of ``turn`` (pulse,): products of two of a few."""
    few = int(np.ceil(np.sqrt(count)))
    low = np.cumprod(np.broadcast_to(turn[:, None], (turn.size, few)), axis=1)
    high = np.cumprod(np.broadcast_to(low[:, -1:], (turn.size, few)), axis=1) / low[:, -1:]
    return np.asarray((high[:, :, None] * low[:, None, :]).reshape(turn.size, -1)[:, :count])


def _real_pairs(values: ComplexArray) -> FloatArray:
    """Return real and imaginary parts (..., 2 * column) of ``values`` (..., column), in turn."""
    return np.stack([values.real, values.imag], axis=-1).reshape(*values.shape[:-1], -1)
