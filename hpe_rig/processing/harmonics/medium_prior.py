"""Prior of the states of all harmonics: the motions that media can make under known tonebursts.

Under a long train of tonebursts the displacement is periodic. x are the in-phase and quadrature states of every
harmonic of the burst rate up to 40 kHz. An ensemble of media responds to the known spectrum of the bursts; few linear
combinations of x describe all of its media:

    Cov x = s² F F',    F = S L (state, column)          s: rms displacement of the motion

A medium is described by its complex response at a few frequency nodes. A *response component* is the real or imaginary
part of the response at one node. S (``MediumPrior.states_of_response``) converts these components to states:
interpolation between nodes times the spectrum of the bursts. L (``MediumPrior.response_root``) is a root of the
components' covariance over the ensemble. Fits with this prior: medium_fit.py. Derivation:
docs/explanation/medium-prior.md.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hpe_rig.arrays import ComplexArray, FloatArray, IndexArray, numbers_text
from hpe_rig.medium import BeamWidths, RigidSphere, medium_ensemble
from hpe_rig.processing.harmonics.model import harmonic_columns

HIGHEST_HZ = 4e4
"""Highest frequency of the bursts' harmonics in the model."""
VOIGT_WEIGHT = 10.0
"""Weight of a Voigt medium in the prior over that of other families: most media are close to Voigt media, and pulses
synchronous with the bursts cannot distinguish the families."""
ENSEMBLE_RESIDUAL = 3e-3
"""Standard deviation of a medium from the span of the ensemble, relative to its rms response at a frequency."""
IDENTICAL_RAD = 1e-12
"""Phases of the burst rate that count as equal, so that their pulses are computed once: 1e-15 s at 100 Hz."""
MAX_INSTANTS = 1 << 13
"""Largest number of instants of the burst period that are computed. At 100 Hz merged pulses are 0.5 us rms apart, which
moves 1 kHz by 3 mrad in each pulse and by 4e-5 rad in the mean of so many."""
INSTANT_WIDTH_S = 1 / (40 * HIGHEST_HZ)
"""Pulses closer than this in the burst period share the model error: 0.6 us, 1/40 of the period of the highest
harmonic, far above trigger jitter and the rounding of times."""


@dataclass(frozen=True, slots=True, eq=False)
class MediumPrior:
    """Prior of the motion of media under tonebursts, for a motion of 1 m rms; compared by identity, arrays read-only.

    A response component is the real or imaginary part of a medium's complex response at one frequency node: real parts
    of all nodes first, then imaginary parts. ``node_to_harmonic``, complex (harmonic, node): converts responses to A
    exp(j phase) of every harmonic of the bursts. ``sample_responses`` (sample, component): the ``members`` media of the
    ensemble, then one standard deviation of each component from the ensemble's span. ``response_root`` (component,
    component): root of the covariance, deviations included.

    ``peak_over_tracked``, complex (member, harmonic): peak over tracked motion. ``amplitude_m`` (member, harmonic):
    tracked amplitude. ``steepness``, complex (effect, member, harmonic): relative change of the tracked motion with the
    logarithm of the tracking beam's area and, off the axis of the force, with the beam's offset relative to its radius.
    """

    burst_rate_hz: float
    node_to_harmonic: ComplexArray
    response_root: FloatArray
    sample_responses: FloatArray
    peak_over_tracked: ComplexArray
    amplitude_m: FloatArray
    steepness: ComplexArray

    @property
    def members(self) -> int:
        """Number of media in the ensemble."""
        return len(self.amplitude_m)

    @property
    def frequency_hz(self) -> FloatArray:
        """Frequencies (harmonic,) of the states."""
        return self.burst_rate_hz * np.arange(1.0, self.peak_over_tracked.shape[1] + 1)

    def states_of_response(self, harmonic_indices: Sequence[int]) -> FloatArray:
        """Return the matrix S (2 * harmonic, response component) from a medium's response to its motion.

        The motion is given by the in-phase and quadrature states of the harmonics with these indices, counted from 0.
        """
        rows = self.node_to_harmonic[list(harmonic_indices)]
        # Real and imaginary part of (rows @ response), with the response split into real and imaginary parts.
        pairs = np.hstack([rows.real, -rows.imag]), np.hstack([rows.imag, rows.real])
        return np.stack(pairs, axis=1).reshape(2 * len(rows), -1)

    def displacement_matrices(
        self, time_s: FloatArray, harmonic_indices: Sequence[int]
    ) -> tuple[FloatArray, FloatArray]:
        """Return two matrices that give the displacement at ``time_s`` (pulse,): of a medium, and of some harmonics.

        The first (pulse, response component) is multiplied by the response of a medium. The second (pulse, state)
        is multiplied by in-phase and quadrature states of the harmonics in ``harmonic_indices``.
        """
        # Computed once for each distinct instant of the burst period, then repeated for the pulses at that instant.
        first, repeats = self.distinct_instants(time_s)
        phasors = self._harmonic_phasors(time_s[first])
        # The displacement is Im(weights @ response), (instant, node): the response's real part has the factor
        # Im(weights), its imaginary part Re(weights).
        weights = phasors @ self.node_to_harmonic
        of_response = np.hstack([weights.imag, weights.real])
        # sin and cos of the first harmonic, then of the next: j conj(exp(jwt)) = sin + j cos.
        sin_cos = 1j * np.conj(phasors[:, list(harmonic_indices)])
        of_harmonics = np.stack([sin_cos.real, sin_cos.imag], axis=-1).reshape(len(sin_cos), -1)
        return of_response[repeats], of_harmonics[repeats]

    def velocity_m_per_s(self, time_s: FloatArray, phasor_m: ComplexArray) -> FloatArray:
        """Return the velocity (pulse,) at ``time_s`` of the motion with ``phasor_m`` A exp(j phase), (harmonic,)."""
        first, repeats = self.distinct_instants(time_s)
        phasors = self._harmonic_phasors(time_s[first])
        velocity: FloatArray = (phasors @ (2j * np.pi * self.frequency_hz * phasor_m)).imag
        return velocity[repeats]

    def distinct_instants(self, time_s: FloatArray) -> tuple[IndexArray, IndexArray]:
        """Return the index of one pulse for each distinct instant of the burst period, and each pulse's instant.

        Pulses at the same instant of the period see the same periodic motion, so it is computed once for all of them.
        More than ``MAX_INSTANTS`` are merged with their neighbours.
        """
        angle_rad = np.angle(self._burst_phasor(time_s))
        _, first, repeats = np.unique(np.rint(angle_rad / IDENTICAL_RAD), return_index=True, return_inverse=True)
        if first.size > MAX_INSTANTS:
            bins = np.rint(angle_rad * MAX_INSTANTS / (2 * np.pi)) % MAX_INSTANTS
            _, first, repeats = np.unique(bins, return_index=True, return_inverse=True)
        return first, repeats

    def _burst_phasor(self, time_s: FloatArray) -> ComplexArray:
        """Return exp(j 2 pi f t) at the burst rate."""
        sin, cos = harmonic_columns(time_s, np.array([self.burst_rate_hz])).T
        return np.asarray(cos + 1j * sin)

    def _harmonic_phasors(self, time_s: FloatArray) -> ComplexArray:
        """Return exp(jwt) of every harmonic, (pulse, harmonic)."""
        # Powers of the first are faster than an exponential for each. Rounding adds up to 1e-13 at the 400th.
        first = self._burst_phasor(time_s)[:, None]
        return np.asarray(np.cumprod(np.broadcast_to(first, (time_s.size, len(self.node_to_harmonic))), axis=1))

    def instant_count(self, time_s: FloatArray) -> float:
        """Return the effective number of different instants of the burst period that the pulses at ``time_s`` sample.

        Pulses closer than ``INSTANT_WIDTH_S`` in the period share one error of the model. Each pulse counts as one over
        the number of pulses that close to it.
        """
        phase, width = np.sort(self.burst_rate_hz * time_s % 1.0), self.burst_rate_hz * INSTANT_WIDTH_S
        unwrapped = np.concatenate([phase - 1, phase, phase + 1])
        neighbours = np.searchsorted(unwrapped, phase + width, "right") - np.searchsorted(
            unwrapped, phase - width, "left"
        )
        return float(np.sum(1 / neighbours))

    def harmonic_indices(self, frequency_hz: FloatArray) -> tuple[int, ...]:
        """Return the index of each frequency among the bursts' harmonics, from 0; raise ``ValueError`` for others."""
        number = np.rint(frequency_hz / self.burst_rate_hz)
        close = np.abs(frequency_hz - number * self.burst_rate_hz) <= 1e-6 * self.burst_rate_hz
        if not np.all(close & (number >= 1) & (number <= self.peak_over_tracked.shape[1])):
            raise ValueError(
                f"frequencies {numbers_text(frequency_hz)} Hz are not all multiples of the burst rate of "
                f"{self.burst_rate_hz:g} Hz up to {self.frequency_hz[-1]:g} Hz: the tonebursts drive no others; "
                "try least_squares"
            )
        return tuple((number.astype(int) - 1).tolist())


@functools.lru_cache(maxsize=8)
def medium_prior(
    pushed: BeamWidths | RigidSphere,
    burst_rate_hz: float,
    burst_length_s: float,
    known_medium: tuple[float, float] | None = None,
    density_kg_per_m3: float = 1000.0,
) -> MediumPrior:
    """Return the prior of the motion that media make under tonebursts of ``burst_length_s`` at ``burst_rate_hz``.

    It is an ensemble of media, each described by its complex response at a few frequencies (nodes). ``pushed``: beams
    that push the tissue, or a rigid sphere. Times count from the onset of a burst at the focus. A
    ``known_medium``, shear modulus (Pa) and viscosity (Pa s), narrows the ensemble to Voigt media near it.
    """
    lowest_hz, highest_hz = harmonic_range_hz(burst_rate_hz)
    ensemble = medium_ensemble(pushed, lowest_hz, highest_hz, known_medium, density_kg_per_m3)
    node_to_harmonic = ensemble.driven_spectrum(round(highest_hz / burst_rate_hz), burst_rate_hz, burst_length_s)
    # Tracked and peak motion of every member, (member, harmonic).
    tracked, peak = ensemble.tracked @ node_to_harmonic.T, ensemble.peak @ node_to_harmonic.T
    # Each member is scaled to a tracked motion of 1 m rms.
    scale = np.sqrt(2 / np.sum(np.abs(tracked) ** 2, axis=1))[:, None]
    responses = scale * ensemble.tracked
    member_responses = np.hstack([responses.real, responses.imag])
    # Weight of each member; Voigt media weigh more.
    weight = np.where(ensemble.voigt, VOIGT_WEIGHT, 1.0)
    weight /= weight.sum()
    # Standard deviation of a medium from the ensemble's span: a fraction of the rms response at each node, equal in
    # the real and imaginary part.
    mean_square = (weight @ member_responses**2).reshape(2, -1).mean(axis=0)
    deviation = ENSEMBLE_RESIDUAL * np.sqrt(np.tile(mean_square, 2))
    sample_responses = np.vstack([member_responses, np.diag(deviation)])
    # Root L of the covariance L L' = sum of weight * response * response' over the samples, by a QR decomposition.
    root_weight = np.sqrt(np.concatenate([weight, np.ones(deviation.size)]))
    prior = MediumPrior(
        burst_rate_hz=burst_rate_hz,
        node_to_harmonic=node_to_harmonic,
        response_root=np.asarray(np.linalg.qr(root_weight[:, None] * sample_responses, mode="r")).T,
        sample_responses=sample_responses,
        peak_over_tracked=peak / tracked,
        amplitude_m=scale * np.abs(tracked),
        steepness=ensemble.steepness @ node_to_harmonic.T / tracked,
    )
    for array in (node_to_harmonic, prior.response_root, sample_responses):
        array.flags.writeable = False
    for array in (prior.peak_over_tracked, prior.amplitude_m, prior.steepness):
        array.flags.writeable = False
    return prior


def harmonic_range_hz(burst_rate_hz: float) -> tuple[float, float]:
    """Return the lowest and highest harmonic of the bursts in the model."""
    return burst_rate_hz, burst_rate_hz * max(1, int(HIGHEST_HZ / burst_rate_hz * (1 + 1e-9)))
