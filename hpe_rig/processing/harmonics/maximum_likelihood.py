"""Maximum likelihood of amplitudes and phases from all echoes at once, without displacements between.

S_k(f) = R(f) exp(-j 4 pi f u_k / c) + noise,    u_k = h_k x,

with the resting echo R(f) unknown. For given x the best R is the mean of the aligned spectra; what remains is a
least-squares problem for x, solved by Gauss-Newton steps, each a least-squares fit to one small displacement a pulse.
Derivation: docs/theory/estimation.md.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hpe_rig.arrays import BoolArray, ComplexArray, FloatArray
from hpe_rig.processing.echo.band import Band, band_spectrum, energy_of, inner, turned
from hpe_rig.processing.echo.echoes import EchoGate, Motion, scatter
from hpe_rig.processing.harmonics.harmonic_fit import HarmonicFit, fit_from_state
from hpe_rig.processing.harmonics.medium_prior import MediumPrior, medium_fit
from hpe_rig.processing.harmonics.model import LARGEST_CONDITION, linear_model, triangular_root
from hpe_rig.processing.motion.phase_shift import coherent_phase, motion_of_phase
from hpe_rig.result import by_residual

STEPS = 12
ENOUGH = 1e-12
"""Change in the displacements that the next step would make, relative to a wavelength, below which steps end."""

TRAINS_AT_ONCE = 128
"""Trains that are aligned together: their spectra are gone over a dozen times, and stay in the cache meanwhile."""

ALIKE_BY_CHANCE = 1e-3
"""Share of trains of noise alone that pass for echoes."""


def joint(
    echoes: EchoGate,
    frequencies_hz: FloatArray | Sequence[float],
    *,
    also_hz: FloatArray | Sequence[float] = (),
    background_order: int = 0,
    largest_condition: float = LARGEST_CONDITION,
    prior: MediumPrior | None = None,
) -> HarmonicFit:
    """Return the amplitudes and phases that make all echoes of a train most likely one echo, delayed.

    Seeded by ``coherent``, or by no motion where that is likelier (noise stronger than single echoes). The covariance
    follows from the pulses' residual displacements. Steps end where the next one is foreseen to be below ``ENOUGH``: at
    60 dB the variance is within a relative 6e-8 of what one more step gives, far within what a train tells of it
    (sqrt(2 / freedom), 14 % with a hundred pulses). A background of order 0 is part of the resting echo. With a
    ``prior`` of media, what each echo moves once all are aligned best is fitted with that instead. Raises
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
    root = triangular_root(matrix, matrix.T @ matrix, model.condition if not len(also_hz) else largest_condition)
    reduced, residual = _most_likely_of_all(echoes, matrix, root @ (matrix @ root).T)
    if prior is not None:
        displacement_m = scatter(reduced @ matrix.T + residual, echoes.valid)
        # Every pulse has the same weight: its variance scales nothing.
        motion = Motion(echoes.pulse_time_s, displacement_m, np.ones_like(displacement_m), echoes.valid)
        return medium_fit(motion, frequency_hz, prior, background_order=background_order).fit
    freedom = len(matrix) - matrix.shape[1] - 1
    variance = np.einsum("...i,...i->...", residual, residual) / freedom
    covariance = variance[..., None, None] * (root @ root.T) * by_residual(freedom)
    wanted = 2 * frequency_hz.size
    return fit_from_state(
        frequency_hz,
        reduced[..., :wanted],
        covariance[..., :wanted, :wanted],
        variance,
        len(matrix),
        model.condition,
        freedom=freedom,
    )


def _most_likely_of_all(echoes: EchoGate, matrix: FloatArray, solver: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the states (..., state) and the residual displacement (..., valid pulse) at the largest likelihood."""
    pulses, states = matrix.shape
    found, nothing = list[tuple[FloatArray, FloatArray]](), list[ValueError]()
    for some in echoes.of_trains(TRAINS_AT_ONCE):
        try:
            found.append(_most_likely(some, matrix, solver))
        except ValueError as error:
            # only where no train has an echo is there no result
            nothing.append(error)
            trains = some.volts.shape[:-2]
            found.append((np.full((*trains, states), np.nan), np.full((*trains, pulses), np.nan)))
    if len(nothing) == len(found):
        raise nothing[0]
    state, residual = (np.concatenate(parts) if len(parts) > 1 else parts[0] for parts in zip(*found, strict=True))
    trains = echoes.volts.shape[:-2]
    return state.reshape(*trains, states), residual.reshape(*trains, pulses)


def _most_likely(echoes: EchoGate, matrix: FloatArray, solver: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the same of trains that are aligned together."""
    spectrum, band = band_spectrum(echoes, 2)
    seconds = 2 / echoes.sound_speed_m_per_s

    def still(state: FloatArray) -> ComplexArray:
        """Return the echoes without the motion of a state."""
        return turned(spectrum, state @ matrix.T * seconds, band.frequency_hz)

    moved = np.nan_to_num(_seed(spectrum, band, echoes) @ solver.T)
    # Noise can lead the seed astray; no motion at all is the other start, and each train takes the likelier one.
    aligned = still(moved)
    likelier = _likelihood(aligned, band) >= _likelihood(spectrum, band)
    state = np.where(likelier[..., None], moved, 0.0)
    if not likelier.all():
        aligned = still(state)
    # what moves turns, and its energy stays but for what the margins take
    energy = None if band.root.size else energy_of(spectrum)
    enough_m, before_m = ENOUGH * echoes.sound_speed_m_per_s / echoes.carrier_hz, np.inf
    for _ in range(STEPS):
        # One Gauss-Newton step: see what little each echo still moves, fit that, and undo it as well.
        rest = _residual(aligned, band, seconds, energy)
        change = rest @ solver.T
        state = state + change
        change_m = float(np.nanmax(np.abs(change)))
        # steps shrink by about the same factor each: the next one need not be made to know its size
        if change_m < enough_m or change_m**2 < enough_m * before_m < np.inf:
            break
        before_m = change_m
        aligned = still(state)
    common = _has_common_part(aligned, band, matrix.shape[1], energy)[..., None]
    return np.where(common, state, np.nan), np.where(common, rest - change @ matrix.T, np.nan)


def _seed(spectrum: ComplexArray, band: Band, echoes: EchoGate) -> FloatArray:
    """Return a first displacement (..., valid pulse), 0 or NaN where single echoes drown in noise: all may not."""
    try:
        phase, variance, mean_hz = coherent_phase(spectrum, band)
    except ValueError:
        return np.zeros(spectrum.shape[:-1])
    return motion_of_phase(echoes, phase, variance, mean_hz[..., None]).displacement_m[..., echoes.valid]


def _likelihood(aligned: ComplexArray, band: Band) -> FloatArray:
    """Return the energy (...) of the sum of aligned echoes in the gate, which grows with the likelihood."""
    total = aligned.sum(axis=-2)
    return inner(band.gated(total), total)


def _gate_energy(aligned: ComplexArray, band: Band) -> FloatArray:
    """Return the energy (..., pulse) of aligned echoes in the gate."""
    return energy_of(aligned) - energy_of(band.outside(aligned))


def _has_common_part(aligned: ComplexArray, band: Band, states: int, energy: FloatArray | None = None) -> BoolArray:
    """Return which trains (...) have more in common, once aligned, than noise that is aligned as well as can be.

    Raises ``ValueError`` where none has.
    """
    from scipy.special import gammaincinv

    # Every echo at unit energy, so that one spike does not count for a train. Noise alone sums to the number of pulses
    # times a gamma variable of as many degrees as there are independent numbers; the states chosen for the largest sum
    # add theirs.
    energy = np.maximum(_gate_energy(aligned, band) if energy is None else energy, np.finfo(np.float64).tiny)
    chance = gammaincinv(band.independent + states, 1 - ALIKE_BY_CHANCE) / band.independent
    with np.errstate(invalid="ignore"):
        total = ((1 / np.sqrt(energy))[..., None, :] @ aligned)[..., 0, :]
        found = inner(band.gated(total), total) > aligned.shape[-2] * chance
    if not found.any():
        raise ValueError(
            "the echoes have nothing in common that noise alone would not have: noise without "
            "echo, or too few pulses; check gate, tracking pulser and input range"
        )
    return np.asarray(found)


def _residual(aligned: ComplexArray, band: Band, seconds: float, energy: FloatArray | None = None) -> FloatArray:
    """Return the displacement (..., pulse) by which each echo still departs from their mean.

    ``energy`` (..., pulse), that in the gate, is found where not given.
    """
    # To first order an echo off by u is mean(f) (1 - j per_hz f u): u follows from the projection on that slope.
    per_hz, pulses = 2 * np.pi * seconds, aligned.shape[-2]
    mean = aligned.mean(axis=-2)
    gated, turning = band.gated(mean), mean * band.frequency_hz
    # A taper that reaches into the gate changes a moving echo along that slope, not along the echo itself, whose phase
    # says nearly as much: the difference is the square of the relative bandwidth.
    along = gated if band.fades_gate else (gated * band.frequency_hz + band.gated(turning)) / 2
    slope = -((aligned @ np.conj(along)[..., :, None])[..., 0]).imag
    power = inner(along, turning)
    # noise of the mean adds to its power, not to the slope
    energy = _gate_energy(aligned, band) if energy is None else energy
    noise = (energy.mean(axis=-1) - inner(gated, mean)) / (pulses - 1)
    of_noise = _noise_moment(band, 1 if band.fades_gate else 2)
    power = np.maximum(power - noise * of_noise, power / 10) * per_hz
    return np.asarray(slope / np.maximum(power, np.finfo(np.float64).tiny)[..., None])


def _noise_moment(band: Band, order: int) -> float:
    """Return the mean frequency of white noise in the gate, or its mean square, Hz^order."""
    return float(np.diagonal(band.gated_noise).real @ band.frequency_hz**order / band.noise_energy)
