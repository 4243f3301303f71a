"""Prior of media projected onto a pulse train: the part of it that the pulses can observe.

A samples the states at the valid pulses, with the background projected out; F is the prior's factor (medium_prior.py),
extended by an independent deviation of each wanted harmonic. The singular value decomposition

    A F = U diag(l) V'

turns all sums of the fit into sums over the rank. Directions with l = 0 are not observed.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np

from hpe_rig.arrays import BoolArray, FloatArray, IndexArray
from hpe_rig.processing.harmonics.medium_prior import MediumPrior
from hpe_rig.processing.harmonics.model import PulseTimes, background_columns

HARMONIC_DEVIATION = 0.03
"""Standard deviation of each wanted harmonic from the ensemble's span, relative to its rms amplitude: reflections and
layers, which the infinite media of the ensemble do not have."""
RANK_TOLERANCE = 1e-10
"""Singular value over the largest below which a direction counts as unobserved."""


@dataclass(frozen=True, slots=True)
class ProjectedPrior:
    """A prior of media at the valid pulses of one train, as the decomposition A F = U diag(l) V'.

    ``left_vectors`` (pulse, rank) is U, ``value`` (rank,) is l, ``right_vectors`` (rank, column of F) is V'.
    ``wanted_rows`` (wanted state, rank): F V, from coordinates along V to the wanted states.
    ``members`` (member, rank): motion of every member in coordinates along U. ``wanted_members`` (member, wanted
    state). ``deviation`` and ``wanted_deviation``: as members, for each independent deviation from the ensemble's span.
    ``background`` (pulse, order + 1): orthonormal columns of the background.
    ``hidden_variance_factor``: see ``hidden_variance_factor()``.

    For the Kalman filter: ``factor`` (instant, column of F) is A F with its background, ``repeats`` (pulse,) its row
    for each pulse, ``wanted_factor`` (wanted state, column of F) is F of the wanted states.
    """

    left_vectors: FloatArray
    value: FloatArray
    right_vectors: FloatArray
    wanted_rows: FloatArray
    members: FloatArray
    wanted_members: FloatArray
    deviation: FloatArray
    wanted_deviation: FloatArray
    background: FloatArray
    hidden_variance_factor: float
    factor: FloatArray
    repeats: IndexArray
    wanted_factor: FloatArray

    def without_background(self, displacement_m: FloatArray) -> FloatArray:
        """Return ``displacement_m`` (..., valid pulse) minus its projection onto the background."""
        return np.asarray(displacement_m - (displacement_m @ self.background) @ self.background.T)


def project_prior(
    prior: MediumPrior, time_s: FloatArray, valid: BoolArray, frequency_hz: FloatArray, background_order: int = 0
) -> ProjectedPrior:
    """Return the part of ``prior`` that the valid pulses at ``time_s`` (pulse,) can observe.

    ``frequency_hz``: wanted harmonics. The result is cached for trains of the same timing. Raises ``ValueError`` for
    frequencies that are no harmonics of the bursts and for too few pulses.
    """
    pulses = int(valid.sum())
    if pulses <= background_order + 3:
        raise ValueError(f"{pulses} valid pulses: too few for an amplitude and its uncertainty; try more pulses")
    return _projected(prior, PulseTimes.of(time_s, valid), prior.harmonic_indices(frequency_hz), background_order)


@functools.lru_cache(maxsize=4)
def _projected(prior: MediumPrior, pulses: PulseTimes, harmonic_indices: tuple[int, ...], order: int) -> ProjectedPrior:
    """Return the part of ``prior`` that ``pulses`` observe, for wanted harmonics and a background of ``order``.

    It is the singular value decomposition A F = U diag(l) V': F is the root of the prior's covariance, and A samples
    its motions at the pulses, minus the background.
    """
    time_s, valid = pulses.time_s, pulses.valid
    background = np.linalg.qr(background_columns(time_s, order)[valid])[0]
    # Pulses at the same instant of the burst period have equal rows, unless the background differs between them.
    index = np.arange(np.count_nonzero(valid))
    first, repeats = (index, index) if order else prior.distinct_instants(time_s[valid])
    count = np.bincount(repeats)[:, None]
    # Motion of each direction of the prior, and of each wanted state, at the instants.
    directions, columns = prior.sampled_motions(time_s[valid][first], harmonic_indices)
    basis = prior.states(harmonic_indices)
    # F, the root of the prior's covariance, is extended by a deviation of each wanted harmonic, equal in both states.
    power = np.sum((basis @ prior.root) ** 2, axis=1).reshape(-1, 2).mean(axis=1)
    wanted_deviation = np.diag(HARMONIC_DEVIATION * np.sqrt(np.repeat(power, 2)))
    sampled_deviation = columns @ wanted_deviation
    factor = np.hstack([directions @ prior.root, sampled_deviation])
    wanted_factor = np.hstack([basis @ prior.root, wanted_deviation])
    # A F: one row for each instant; ``count`` pulses share it.
    centred = factor - background[first] @ ((count * background[first]).T @ factor)
    # The triangle of a QR decomposition has the same singular values as all pulses, at far less work; U follows from
    # it.
    _, value, right_vectors = np.linalg.svd(np.linalg.qr(np.sqrt(count) * centred, mode="r"))
    observed = value > RANK_TOLERANCE * value[0]
    value, right_vectors = value[observed], right_vectors[: observed.size][observed]
    left_vectors = centred @ (right_vectors.T / value)
    along = directions.T @ (count * left_vectors)  # motion of each direction along U
    return ProjectedPrior(
        left_vectors=left_vectors[repeats],
        value=value,
        right_vectors=right_vectors,
        wanted_rows=wanted_factor @ right_vectors.T,
        members=prior.members @ along,
        wanted_members=prior.members @ basis.T,
        deviation=np.vstack([prior.deviation[:, None] * along, sampled_deviation.T @ (count * left_vectors)]),
        wanted_deviation=np.vstack([prior.deviation[:, None] * basis.T, wanted_deviation]),
        background=background,
        hidden_variance_factor=hidden_variance_factor(int(valid.sum()), prior.instant_count(time_s[valid]), value.size),
        factor=factor,
        repeats=repeats,
        wanted_factor=wanted_factor,
    )


def hidden_variance_factor(pulses: int, instants: float, rank: int) -> float:
    """Return the model-error variance that the residual does not contain, over the variance of one pulse's model error.

    Pulses at the same instant share the model error. The mean of m = pulses / instants of them has its full variance,
    like an error of m times the variance in every pulse. The residual contains only the part left after ``rank``
    directions are fitted to the instants, spread over all its degrees of freedom.
    """
    # The full error m minus its part in the residual, m (instants - rank) / (pulses - rank).
    return pulses / instants * (pulses - instants) / (pulses - min(rank, instants))
