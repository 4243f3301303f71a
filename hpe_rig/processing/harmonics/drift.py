"""Drift: a change of the motion within a train, such as that of tissue that warms while it is pushed.

    d(t) = Im sum_n x_n exp(g_n s) exp(j w_n t) + background + noise,    s from -1 at the first pulse to 1 at the last
    g_n  = (a - j w_n tau) / 2 + delta_n

x_n is the phasor of harmonic n in the middle of the train. From the first pulse to the last all motion grows by the
factor exp(a) and becomes later by tau; delta_n is the deviation of a wanted harmonic. Warming limits them: a, tau and
delta_n are normal with mean zero and the standard deviations below. They are estimated from the residual of the
harmonic fit by Gauss-Newton steps, together with the columns Q of that fit.

The test for a change uses the same columns without the prior: an F test of a and tau together, the change that all
harmonics have in common, and one of each harmonic alone. Derivation: docs/explanation/estimation.md.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hpe_rig.arrays import ComplexArray, FloatArray
from hpe_rig.processing.harmonics.harmonic_fit import HarmonicFit, with_state_error
from hpe_rig.processing.harmonics.medium_fit import driven_phasors_m, medium_fit
from hpe_rig.processing.harmonics.medium_prior import MediumPrior
from hpe_rig.processing.harmonics.model import LinearModel, harmonic_columns, linear_model
from hpe_rig.processing.motion.displacement import Motion

GROWTH_SD = 0.1
"""Standard deviation of the relative growth a of the amplitudes over a train."""
DELAY_SD_S = 1e-4
"""Standard deviation of the growth tau of the delay over a train."""
DEVIATION = 0.5
"""Standard deviation of the growth and delay of one harmonic from those of all, relative to the two above."""
RELATIVE_U = 0.1
"""Standard uncertainty of the change relative to itself. Heat that leaves the focus bends the line, which moves the
value at the first pulse by T / 3 t of half the change (T: length of the train; t = 0.8 s for a focus of 0.34 mm)."""
MAX_ITERATIONS = 30
"""Largest number of Gauss-Newton steps of an estimate."""
CONVERGED_U = 0.2
"""Change of every unknown in a step, in standard uncertainties, below which the estimate has converged."""
MAX_ALTERNATION_U = 1.0
"""Change of an unknown in the last step, in standard uncertainties, above which the estimate diverges."""
MIN_SHRINKAGE = 0.01
"""Patterns of a prior of media with at least this shrinkage count as columns of the fit."""
NEGLIGIBLE = 1e-3
"""Unwanted harmonics that are weaker than this, relative to the strongest of all, are omitted."""
RANK_TOLERANCE = 1e-10
"""Eigenvalue of the products of the columns over the largest, below which a combination counts as not observed."""
PULSES_AT_ONCE = 4096
"""Pulses for which all harmonics are computed at once, to bound the memory."""


@dataclass(frozen=True, slots=True)
class Harmonics:
    """Harmonics of a motion, fitted to a train, as a function of the unknowns of its drift.

    ``frequency_hz`` and ``phasor_m``, complex: (harmonic,), the wanted ones first. ``sensitivity``, complex (harmonic,
    unknown): change of each phasor's logarithm from the middle to the last pulse, g_n, for each unknown. The unknowns
    are growth a and delay tau in common, and for each wanted harmonic the deviations from these, all over their prior
    standard deviations. A ``position`` (pulse,) in the train is -1 at the first pulse and 1 at the last.
    """

    frequency_hz: FloatArray
    phasor_m: ComplexArray
    sensitivity: ComplexArray

    def displacement_m(self, time_s: FloatArray, position: FloatArray, unknowns: FloatArray) -> FloatArray:
        """Return the displacement (pulse,), m, at ``time_s``, with the phasors that the motion has at ``position``.

        ``position`` (pulse,): in the train, -1 at the first pulse, 1 at the last. ``unknowns`` (unknown,) of the drift.
        """
        return np.concatenate([phasors.imag.sum(axis=1) for phasors, _ in self._phasors(time_s, position, unknowns)])

    def derivatives_m(self, time_s: FloatArray, position: FloatArray, unknowns: FloatArray) -> FloatArray:
        """Return the derivatives (unknown, pulse) of the displacement by the unknowns."""
        blocks = self._phasors(time_s, position, unknowns)
        return np.concatenate([at * (phasors @ self.sensitivity).imag.T for phasors, at in blocks], axis=1)

    def _phasors(
        self, time_s: FloatArray, position: FloatArray, unknowns: FloatArray
    ) -> Iterator[tuple[ComplexArray, FloatArray]]:
        """Yield every harmonic as a complex value at each pulse (pulse, harmonic), and the positions of these pulses.

        The displacement is the sum of the imaginary parts. Each item covers up to ``PULSES_AT_ONCE`` pulses.
        """
        log_change = self.sensitivity @ unknowns
        for first in range(0, time_s.size, PULSES_AT_ONCE):
            pulses = slice(first, first + PULSES_AT_ONCE)
            exponent = np.outer(position[pulses], log_change) + 2j * np.pi * np.outer(time_s[pulses], self.frequency_hz)
            yield self.phasor_m * np.exp(exponent), position[pulses]


@dataclass(frozen=True, slots=True)
class Drift:
    """Change of the motion over a train.

    ``log_change``, complex (frequency,): g_n, half of the change of the logarithm of each wanted phasor from the first
    pulse to the last. ``covariance`` (2 * frequency, 2 * frequency): of its real and imaginary parts, interleaved.
    ``growth``, exp(a) - 1, and ``delay_s``, tau: the change that all motion has in common, with standard uncertainties
    ``growth_u`` and ``delay_u_s``.

    ``probability``: upper bound of the probability that a steady motion changes as significantly in any of the tests.
    ``harmonic_probability`` (frequency,): the same, of a change of this harmonic.

    ``harmonics`` and ``unknowns``: the motion that changes.
    """

    growth: float
    growth_u: float
    delay_s: float
    delay_u_s: float
    log_change: ComplexArray
    covariance: FloatArray
    probability: float
    harmonic_probability: FloatArray
    harmonics: Harmonics
    unknowns: FloatArray

    def change_m(self, time_s: FloatArray) -> FloatArray:
        """Return the displacement that the drift adds at the pulses, m (pulse,); 0 at the first pulse.

        A motion without drift keeps the amplitudes and phases of the first pulse. ``time_s`` (pulse,): the whole train.
        """
        drifting_m = self.harmonics.displacement_m(time_s, _positions(time_s), self.unknowns)
        # Positions in the train run from -1 to 1: a motion without drift stays at -1, the first pulse.
        steady_m = self.harmonics.displacement_m(time_s, np.full_like(time_s, -1.0), self.unknowns)
        return np.asarray(drifting_m - steady_m)


def drift_of(
    motion: Motion,
    frequencies_hz: FloatArray | Sequence[float],
    *,
    also_hz: FloatArray | Sequence[float] = (),
    background_order: int = 0,
    prior: MediumPrior | None = None,
    max_iterations: int = MAX_ITERATIONS,
) -> Drift:
    """Return the change of a ``motion`` (pulse,) over its train, with a test of whether there is any.

    The harmonics are fitted by least squares or, with a ``prior`` of media, by the fit with that prior. ``also_hz``:
    further frequencies of the motion. One iteration suffices for the test. Raises ``ValueError`` if the fit does, for
    too few pulses, and if the iterations diverge.
    """
    frequency_hz = np.asarray(frequencies_hz, dtype=np.float64)
    # ``steady`` is the motion minus the present estimate of its change, which the ``unknowns`` describe.
    time_s, unknowns, steady = motion.time_s, np.zeros(2 + 2 * frequency_hz.size), motion
    covariance: FloatArray = np.zeros((unknowns.size, unknowns.size))
    for iteration in range(max_iterations):
        harmonics, basis = _fitted(steady, frequency_hz, also_hz, background_order, prior)
        products, moments, degrees = _normal_equations(harmonics, basis, steady, unknowns)
        if iteration == 0:
            probability, harmonic_probability = _significance(products, moments, degrees)
        # Posterior of the unknowns, which have a prior variance of one.
        previous = unknowns
        posterior: FloatArray = np.asarray(np.linalg.inv(products + np.eye(unknowns.size)), dtype=np.float64)
        unknowns = posterior @ moments
        # In short trains the covariance depends on the iterate, which selects the patterns that the fit uses: the
        # largest one after the first iteration counts.
        if iteration < 2 or np.trace(posterior[:2, :2]) > np.trace(covariance[:2, :2]):
            covariance = posterior
        step_u = np.max(np.abs(unknowns - previous) / np.sqrt(np.diag(covariance)))
        if step_u < CONVERGED_U or iteration == max_iterations - 1:
            break
        # Positions in the train run from -1 to 1. The steady motion has the phasors of the middle, position 0.
        drifting_m = harmonics.displacement_m(time_s, _positions(time_s), unknowns)
        steady_m = harmonics.displacement_m(time_s, np.zeros_like(time_s), unknowns)
        steady = replace(motion, displacement_m=motion.displacement_m - (drifting_m - steady_m))
    # The iterates of a short train can alternate within their u, as the patterns that the fit uses do.
    if max_iterations > 1 and step_u > MAX_ALTERNATION_U:
        raise ValueError("the change within the train does not converge; use a longer window")
    # From the unknowns to the changes of the wanted phasors' logarithms: complex, and as real and imaginary parts.
    sensitivity = harmonics.sensitivity[: frequency_hz.size]
    real_imaginary = np.stack([sensitivity.real, sensitivity.imag], axis=1).reshape(-1, unknowns.size)
    log_change, common_u = sensitivity @ unknowns, np.hypot(np.sqrt(np.diag(covariance)), RELATIVE_U * unknowns)
    # Errors along and across the change, in common to all harmonics.
    relative = RELATIVE_U * np.stack([log_change, 1j * log_change]).view(np.float64)
    return Drift(
        growth=math.expm1(GROWTH_SD * unknowns[0]),
        growth_u=GROWTH_SD * float(common_u[0]) * math.exp(GROWTH_SD * unknowns[0]),
        delay_s=DELAY_SD_S * float(unknowns[1]),
        delay_u_s=DELAY_SD_S * float(common_u[1]),
        log_change=log_change,
        covariance=real_imaginary @ covariance @ real_imaginary.T + relative.T @ relative,
        probability=probability,
        harmonic_probability=harmonic_probability,
        harmonics=harmonics,
        unknowns=unknowns,
    )


def _positions(time_s: FloatArray) -> FloatArray:
    """Return the position (pulse,) of each pulse in the train, from -1 at the first to 1 at the last."""
    return np.asarray(2 * (time_s - time_s[0]) / (time_s[-1] - time_s[0]) - 1)


def with_drift_uncertainty(fit: HarmonicFit, drift: Drift) -> HarmonicFit:
    """Return ``fit`` with the uncertainty of ``drift``, which was removed from the motion before this fit."""
    phasor_m = fit.amplitude_m * np.exp(1j * fit.phase_rad)
    # A relative error g of a phasor is an error phasor * g of its in-phase and quadrature states.
    to_states = np.zeros(drift.covariance.shape)
    for n, phasor in enumerate(phasor_m):
        to_states[2 * n : 2 * n + 2, 2 * n : 2 * n + 2] = [[phasor.real, -phasor.imag], [phasor.imag, phasor.real]]
    drift_m2 = to_states @ drift.covariance @ to_states.T
    corrected = fit.aliasing_corrected
    return replace(
        with_state_error(fit, drift_m2),
        drift_m2=drift_m2,
        aliasing_corrected=None if corrected is None else with_drift_uncertainty(corrected, drift),
    )


def _fitted(
    motion: Motion,
    frequency_hz: FloatArray,
    also_hz: FloatArray | Sequence[float],
    background_order: int,
    prior: MediumPrior | None,
) -> tuple[Harmonics, FloatArray]:
    """Return the harmonics of a steady ``motion``, and orthonormal columns (valid pulse, column) of steady motions.

    The arguments are those of ``drift_of``.
    """
    wanted_count, all_hz = frequency_hz.size, frequency_hz
    if prior is None:
        times = motion.time_s, motion.valid
        model = linear_model(*times, frequency_hz, background_order=background_order, also_hz=also_hz)
        basis = _with_unresolved(model, motion.time_s[motion.valid], np.asarray(also_hz, dtype=np.float64))
        # In-phase and quadrature states of the wanted harmonics come first.
        states, _ = model.solve(motion.displacement_m[motion.valid])
        phasor_m = states[: 2 * wanted_count : 2] + 1j * states[1 : 2 * wanted_count : 2]
    else:
        fit = medium_fit(motion, frequency_hz, prior, background_order=background_order)
        # Orthonormal columns: background polynomials, and patterns, which combine to the prior's motions. A pattern
        # with little shrinkage takes its coefficient from the prior, so it absorbs no part of the data and is omitted.
        basis = np.hstack([fit.projected.background, fit.projected.patterns[:, fit.shrinkage > MIN_SHRINKAGE]])
        others_hz, others_m = driven_phasors_m(prior, fit)
        strong = np.abs(others_m) > NEGLIGIBLE * np.abs(others_m).max()
        strong[list(prior.harmonic_indices(frequency_hz))] = False
        all_hz = np.concatenate([frequency_hz, others_hz[strong]])
        phasor_m = np.concatenate([fit.fit.amplitude_m * np.exp(1j * fit.fit.phase_rad), others_m[strong]])
    # Change of every harmonic's logarithm for one standard deviation of growth and of delay, (harmonic, 2).
    common = np.stack([np.full(all_hz.size, GROWTH_SD / 2), -1j * np.pi * all_hz * DELAY_SD_S], axis=1)
    # Unknowns: growth and delay of all harmonics, then the deviations from these of each wanted harmonic n, which
    # change that harmonic only.
    sensitivity = np.zeros((all_hz.size, 2 + 2 * wanted_count), dtype=np.complex128)
    sensitivity[:, :2] = common
    for n in range(wanted_count):
        sensitivity[n, 2 + 2 * n : 4 + 2 * n] = DEVIATION * common[n]
    return Harmonics(all_hz, phasor_m, sensitivity), basis


def _with_unresolved(model: LinearModel, time_s: FloatArray, driven_hz: FloatArray) -> FloatArray:
    """Return orthonormal columns (valid pulse, column) of ``model`` and of the driven frequencies that it leaves out.

    Pulses at ``time_s`` do not resolve such a frequency from that of a column to which it nearly aliases. Its steady
    motion beats with that column over the train, as a drift does.
    """
    basis = model.matrix @ model.root
    unresolved_hz = np.setdiff1d(driven_hz, model.column_hz)
    if not unresolved_hz.size:
        return basis
    columns = harmonic_columns(time_s, unresolved_hz) * np.sqrt(2 / time_s.size)
    # Twice, because one projection leaves rounding errors of nearly dependent columns.
    for _ in range(2):
        columns -= basis @ (basis.T @ columns)
    directions, length, _ = np.linalg.svd(columns, full_matrices=False)
    return np.hstack([basis, directions[:, length > NEGLIGIBLE]])


def _normal_equations(
    harmonics: Harmonics, basis: FloatArray, steady: Motion, unknowns: FloatArray
) -> tuple[FloatArray, FloatArray, int]:
    """Return the normal equations J'J x = J'd for the unknowns x of a drift, and the noise's degrees of freedom.

    J has the derivatives of the displacement by the unknowns at their present estimate, ``unknowns``. d is the measured
    displacement. The columns of the harmonic fit are projected out of both. J'J (unknown, unknown) and J'd (unknown,)
    are divided by the noise variance. ``steady``: measured motion minus the drift of the present estimate. ``basis``
    (valid pulse, column): orthonormal columns of the harmonic fit of ``steady``. Raises ``ValueError`` if no degree of
    freedom is left.
    """
    derivatives = harmonics.derivatives_m(steady.time_s, _positions(steady.time_s), unknowns)[:, steady.valid]
    data = steady.displacement_m[steady.valid]
    # Project the columns of the fit out of data and derivatives, in place: no second copy of a long train.
    for row in (data, *derivatives):
        row -= (row @ basis) @ basis.T
    # d: ``steady`` lacks the drift of the present estimate, to first order J times ``unknowns``.
    data += unknowns @ derivatives
    products, moments = derivatives @ derivatives.T, derivatives @ data
    explained_m2, rank = _explained(products, moments)
    degrees = data.size - basis.shape[1] - rank
    if degrees < 1:
        raise ValueError(f"{data.size} valid pulses: too few for a change within the train; use a longer window")
    noise_m2 = max((float(data @ data) - explained_m2) / degrees, np.finfo(np.float64).tiny)
    return products / noise_m2, moments / noise_m2, degrees


def _explained(products: FloatArray, moments: FloatArray) -> tuple[float, int]:
    """Return the energy of data that least squares with some columns explains, and how many columns are independent.

    ``products`` (column, column): inner products of the columns; ``moments`` (column,): those of columns and data.
    """
    eigenvalue, eigenvector = np.linalg.eigh(products)
    # Combinations of columns that are not (nearly) zero; eigenvalues are in ascending order.
    is_independent = eigenvalue > RANK_TOLERANCE * eigenvalue[-1]
    component = moments @ eigenvector[:, is_independent]
    return float(np.sum(component**2 / eigenvalue[is_independent])), int(is_independent.sum())


def _significance(products: FloatArray, moments: FloatArray, degrees: int) -> tuple[float, FloatArray]:
    """Return bounds of the probability that a steady motion seems to change as much: in any test, by harmonic.

    ``products`` (unknown, unknown) and ``moments`` (unknown,): normal equations over the noise variance, which has
    ``degrees`` of freedom. Half of the false alarms go to the test of the common change, the other half to the tests of
    the harmonics (Bonferroni).
    """
    from scipy.special import fdtrc

    # F tests of pairs of unknowns, growth and delay: in common, then of each harmonic.
    probability = []
    for first in range(0, moments.size, 2):
        columns = slice(first, first + 2)
        energy, rank = _explained(products[columns, columns], moments[columns])
        probability.append(float(fdtrc(rank, degrees, energy / rank)) if rank else 1.0)
    harmonics = np.minimum(2 * (len(probability) - 1) * np.array(probability[1:]), 1.0)
    return min(2 * probability[0], float(harmonics.min())), harmonics
