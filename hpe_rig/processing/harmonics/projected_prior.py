"""Prior of media projected onto a pulse train: the part of it that the pulses can observe.

A samples the states at the valid pulses, with the background projected out; F is the prior's factor (medium_prior.py),
extended by an independent deviation of each wanted harmonic. A motion has the states x = F a; the prior of the
coordinates a is independent, with unit variance for a motion of 1 m rms. The singular value decomposition

    A F = U diag(l) V'

expresses it in *patterns*, the columns of U: orthonormal displacements (pulse,). A motion has the coefficient l_i
(V'a)_i of pattern i, so that l_i is the standard deviation of that coefficient under the prior. All sums of the fit are
sums over patterns. Combinations with l = 0 are not observed.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np

from hpe_rig.arrays import BoolArray, FloatArray
from hpe_rig.processing.harmonics.medium_prior import MediumPrior
from hpe_rig.processing.harmonics.model import PulseTimes, background_columns

HARMONIC_DEVIATION = 0.03
"""Standard deviation of each wanted harmonic from the ensemble's span, relative to its rms amplitude: reflections and
layers, which the infinite media of the ensemble do not have."""
RANK_TOLERANCE = 1e-10
"""Singular value over the largest below which a pattern counts as unobserved."""


@dataclass(frozen=True, slots=True)
class ProjectedPrior:
    """A prior of media at the valid pulses of one train, as the decomposition A F = U diag(l) V'.

    ``patterns`` (pulse, pattern), U: the orthonormal displacements of which observable motions consist.
    ``pattern_sd`` (pattern,), l: standard deviation of a motion's coefficient of each, for 1 m rms.
    ``response_per_pattern`` (response component, pattern), L V: response of a medium whose motion has one standard
    deviation of a pattern. ``wanted_per_pattern`` (wanted state, pattern), F V: in-phase and quadrature states of the
    wanted harmonics in that motion.

    Sample motions of the prior: ``members`` media of the ensemble, then independent deviations from them, those of the
    wanted harmonics last. ``sample_coefficients`` (sample, pattern): of the patterns in each motion. ``sample_states``
    (sample, wanted state). ``background`` (pulse, order + 1): orthonormal columns of the background.
    ``hidden_variance_factor``: see ``hidden_variance_factor()``.
    """

    patterns: FloatArray
    pattern_sd: FloatArray
    response_per_pattern: FloatArray
    wanted_per_pattern: FloatArray
    members: int
    sample_coefficients: FloatArray
    sample_states: FloatArray
    background: FloatArray
    hidden_variance_factor: float

    @property
    def member_coefficients(self) -> FloatArray:
        """Coefficients (member, pattern) of the media of the ensemble."""
        return self.sample_coefficients[: self.members]

    @property
    def deviation_coefficients(self) -> FloatArray:
        """Coefficients (deviation, pattern) of the deviations from the ensemble."""
        return self.sample_coefficients[self.members :]

    def without_background(self, displacement_m: FloatArray) -> FloatArray:
        """Return ``displacement_m`` (..., valid pulse) minus its projection onto the background."""
        return np.asarray(displacement_m - (displacement_m @ self.background) @ self.background.T)

    def residual(self, data: FloatArray, shrinkage: FloatArray) -> FloatArray:
        """Return ``data`` (..., valid pulse) minus the fraction ``shrinkage`` (..., pattern) of each pattern in it."""
        return np.asarray(data - (shrinkage * (data @ self.patterns)) @ self.patterns.T)


def project_prior(
    prior: MediumPrior, time_s: FloatArray, valid: BoolArray, frequency_hz: FloatArray, background_order: int = 0
) -> ProjectedPrior:
    """Return ``prior`` as patterns of displacement (pulse,) that the valid pulses at ``time_s`` (pulse,) can observe.

    ``frequency_hz``: wanted harmonics. The result is cached for trains of the same timing. Raises ``ValueError`` for
    frequencies that are no harmonics of the bursts and for too few pulses.
    """
    pulses = int(valid.sum())
    if pulses <= background_order + 3:
        raise ValueError(f"{pulses} valid pulses: too few for an amplitude and its uncertainty; try more pulses")
    return _projected(prior, PulseTimes.of(time_s, valid), prior.harmonic_indices(frequency_hz), background_order)


@functools.lru_cache(maxsize=4)
def _projected(prior: MediumPrior, pulses: PulseTimes, harmonic_indices: tuple[int, ...], order: int) -> ProjectedPrior:
    """Return ``prior`` at ``pulses``, for the harmonics with these indices and a background polynomial of ``order``.

    It is the singular value decomposition A F = U diag(l) V': F is the root of the prior's covariance, and A samples
    its motions at the pulses, minus the background.
    """
    time_s, valid = pulses.time_s, pulses.valid
    background = np.linalg.qr(background_columns(time_s, order)[valid])[0]
    # Pulses at the same instant of the burst period have equal rows, unless the background differs between them.
    index = np.arange(np.count_nonzero(valid))
    first, repeats = (index, index) if order else prior.distinct_instants(time_s[valid])
    count = np.bincount(repeats)[:, None]
    # From a medium's response, and from wanted states, to the displacement at the instants; from response to states.
    of_response, of_states = prior.displacement_matrices(time_s[valid][first], harmonic_indices)
    response_to_states = prior.states_of_response(harmonic_indices)
    # F, the root of the prior's covariance, is extended by a deviation of each wanted harmonic, equal in both states.
    harmonic_root = response_to_states @ prior.response_root
    mean_square = np.sum(harmonic_root**2, axis=1).reshape(-1, 2).mean(axis=1)
    wanted_deviation = np.diag(HARMONIC_DEVIATION * np.sqrt(np.repeat(mean_square, 2)))
    sampled_deviation = of_states @ wanted_deviation
    factor = np.hstack([of_response @ prior.response_root, sampled_deviation])
    # A F: one row for each instant; ``count`` pulses share it.
    centred = factor - background[first] @ ((count * background[first]).T @ factor)
    # The triangle of a QR decomposition has the same singular values as all pulses, at far less work; U follows from
    # it.
    _, singular_values, right_vectors = np.linalg.svd(np.linalg.qr(np.sqrt(count) * centred, mode="r"))
    observed = singular_values > RANK_TOLERANCE * singular_values[0]
    pattern_sd, v = singular_values[observed], right_vectors[: observed.size][observed].T
    patterns = centred @ (v / pattern_sd)
    # V has a row for each column of F: components of the response first, then deviations of the wanted harmonics.
    v_response, v_deviation = np.split(v, [len(prior.response_root)])
    # Coefficients of the patterns in each sample motion, U' A x, and its wanted states.
    response_coefficients = of_response.T @ (count * patterns)
    return ProjectedPrior(
        patterns=patterns[repeats],
        pattern_sd=pattern_sd,
        response_per_pattern=prior.response_root @ v_response,
        wanted_per_pattern=harmonic_root @ v_response + wanted_deviation @ v_deviation,
        members=prior.members,
        sample_coefficients=np.vstack(
            [prior.sample_responses @ response_coefficients, sampled_deviation.T @ (count * patterns)]
        ),
        sample_states=np.vstack([prior.sample_responses @ response_to_states.T, wanted_deviation]),
        background=background,
        hidden_variance_factor=hidden_variance_factor(
            int(valid.sum()), prior.instant_count(time_s[valid]), pattern_sd.size
        ),
    )


def hidden_variance_factor(pulses: int, instants: float, rank: int) -> float:
    """Return the part of the model error that the residual does not contain, as a factor on its variance.

    The model error e is the deviation of the prior's motion from the true one. Pulses at the same instant of the burst
    period share it. The mean of m = pulses / ``instants`` of them has the full variance e², like independent errors of
    variance m e² in every pulse. The residual contains only what remains after ``rank`` patterns are fitted to the
    instants, spread over all its degrees of freedom. The result is m minus that part.
    """
    # m minus m (instants - rank) / (pulses - rank).
    return pulses / instants * (pulses - instants) / (pulses - min(rank, instants))
