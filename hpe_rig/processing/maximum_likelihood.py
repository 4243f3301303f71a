"""Maximum likelihood of amplitudes and phases from all echoes at once, without displacements between.

S_k(f) = R(f) exp(-j 4 pi f u_k / c) + noise,    u_k = h_k x,

with the resting echo R(f) unknown. For given x the best R is the mean of the aligned spectra; what remains is a
least-squares problem for x, solved by Gauss-Newton steps, each a least-squares fit to one small displacement a pulse.
Derivation: docs/theory/estimation.md.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hpe_rig.processing.echoes import ComplexArray, EchoGate, FloatArray, band_spectrum, turned
from hpe_rig.processing.harmonic import HarmonicFit, fit_from_state
from hpe_rig.processing.model import LARGEST_CONDITION, linear_model, triangular_root
from hpe_rig.processing.motion import coherent

STEPS = 12
ENOUGH = 1e-12
"""Metres of change in the displacements, relative to a wavelength, below which steps end."""


def joint(
    echoes: EchoGate,
    frequencies_hz: FloatArray | Sequence[float],
    *,
    also_hz: FloatArray | Sequence[float] = (),
    background_order: int = 0,
    largest_condition: float = LARGEST_CONDITION,
) -> HarmonicFit:
    """Return the amplitudes and phases that make all echoes of a train most likely one echo, delayed.

    Seeded by ``coherent``, or by no motion where that is likelier (noise stronger than single echoes). The covariance
    follows from the pulses' residual displacements. A background of order 0 is part of the resting echo. Raises
    ``ValueError`` as ``coherent`` and ``least_squares``. Source: maximum likelihood with the resting echo as nuisance
    parameter (variable projection).
    """
    frequency_hz = np.asarray(frequencies_hz, dtype=np.float64)
    times = echoes.pulse_time_s, echoes.valid
    model = linear_model(*times, frequency_hz, largest_condition, background_order=background_order, also_hz=also_hz)
    constant = model.wanted.stop - 1 - background_order
    # the constant is the phase of the resting echo: centred columns are what is left once that is fitted
    matrix = np.delete(model.matrix, constant, axis=1) if background_order >= 0 else model.matrix
    matrix = matrix - matrix.mean(axis=0)
    root = triangular_root(matrix, model.condition if not len(also_hz) else largest_condition)
    spectrum, band_hz = band_spectrum(echoes, 2)
    reduced, residual = _most_likely(spectrum, band_hz, echoes, matrix, root @ (matrix @ root).T)
    variance = np.einsum("...i,...i->...", residual, residual) / (len(matrix) - matrix.shape[1] - 1)
    covariance = variance[..., None, None] * (root @ root.T)
    wanted = 2 * frequency_hz.size
    return fit_from_state(
        frequency_hz,
        reduced[..., :wanted],
        covariance[..., :wanted, :wanted],
        variance,
        len(matrix),
        model.condition,
    )


def _most_likely(
    spectrum: ComplexArray, band_hz: FloatArray, echoes: EchoGate, matrix: FloatArray, solver: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the states (..., state) and the residual displacement (..., pulse) at the largest likelihood."""
    seconds = 2 / echoes.sound_speed_m_per_s
    try:
        moved = coherent(echoes).displacement_m[..., echoes.valid] @ solver.T
    except ValueError:
        # single echoes drown in noise; all of them together may not
        moved = np.zeros((*spectrum.shape[:-2], matrix.shape[1]))
    # Noise can lead the seed astray; no motion at all is the other start, and each train takes the likelier one.
    likely = [_likelihood(turned(spectrum, x @ matrix.T * seconds, band_hz)) for x in (moved, 0 * moved)]
    state = np.where((likely[0] >= likely[1])[..., None], moved, 0.0)
    for _ in range(STEPS):
        # One Gauss-Newton step: undo the motion found so far, see what little each echo still moves, fit that.
        rest = _residual(turned(spectrum, state @ matrix.T * seconds, band_hz), band_hz, seconds)
        change = rest @ solver.T
        state = state + change
        if np.abs(change).max() < ENOUGH * echoes.sound_speed_m_per_s / echoes.carrier_hz:
            break
    return state, rest - change @ matrix.T


def _likelihood(aligned: ComplexArray) -> FloatArray:
    """Return the energy (...) of the sum of aligned echoes, which grows with the likelihood."""
    total = aligned.sum(axis=-2)
    return np.asarray(np.sum(np.abs(total) ** 2, axis=-1))


def _residual(aligned: ComplexArray, band_hz: FloatArray, seconds: float) -> FloatArray:
    """Return the displacement (..., pulse) by which each echo still departs from their mean."""
    # To first order an echo off by u is mean(f) (1 - j per_metre u): u follows from the projection on that slope.
    per_metre = 2 * np.pi * band_hz * seconds
    mean = aligned.mean(axis=-2)
    slope = -((aligned @ (np.conj(mean) * per_metre)[..., :, None])[..., 0]).imag
    power = np.abs(mean) ** 2 @ per_metre**2
    # noise of the mean adds to its power, not to the slope
    noise = (np.sum(np.abs(aligned) ** 2, axis=-2) / aligned.shape[-2] - np.abs(mean) ** 2) / (aligned.shape[-2] - 1)
    power = np.maximum(power - noise @ per_metre**2, power / 10)
    return np.asarray(slope / np.maximum(power, np.finfo(np.float64).tiny)[..., None])
