"""Amplitude and phase of a motion that another program has estimated: displacement or velocity, without echoes.

    D(t) = sum_i A_i sin(2 pi f_i t + phi_i) + v t + constant                            least squares
    V(t) = sum_i 2 pi f_i A_i cos(2 pi f_i t + phi_i) + v

The noise of consecutive values counts as independent. Its variance is that of the residual. u includes the error of the
frequencies by the clock of the pulses, as a delay of the motion.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from hpe_rig.arrays import BoolArray, FloatArray, largest_change
from hpe_rig.processing.budget import ErrorSources, estimates_of
from hpe_rig.processing.error_influences import error_influences
from hpe_rig.processing.harmonics.fit_checks import residual_line
from hpe_rig.processing.harmonics.harmonic_fit import FitQuality, HarmonicFit, fit_from_state
from hpe_rig.processing.harmonics.model import linear_model
from hpe_rig.processing.motion.displacement import Motion
from hpe_rig.processing.shot_warnings import fit_warnings, line_warnings
from hpe_rig.processing.shots import FALSE_ALARM_PROBABILITY, Estimates
from hpe_rig.result import PHASE_VARIANCE_LIMIT, BadPixel, MotionMap, ShotResult
from hpe_rig.scene import engineering

StatedQuantity = Literal["displacement", "velocity"]
MAX_CHANGE = {"displacement": (0.03, "m"), "velocity": (30.0, "m/s")}
"""Largest change within a train, with its unit: tissue moves less, so a larger one has another unit."""


def fit_stated_motion(
    motion: FloatArray, valid: BoolArray, time_s: FloatArray, frequencies_hz: Sequence[float], quantity: StatedQuantity
) -> tuple[HarmonicFit, FloatArray, FloatArray]:
    """Return amplitude and phase of a motion known from elsewhere, and its mean velocity with standard uncertainty.

    ``motion`` (..., pulse) is the ``quantity`` displacement (m) or velocity (m/s) at ``time_s`` (pulse,), used where
    ``valid`` (pulse,). Amplitudes are those of the displacement. The residual of a velocity is divided by the lowest
    angular frequency. Mean velocity and its uncertainty have the shape (...). Raises ``ValueError`` if the pulses do
    not resolve the frequencies.
    """
    frequency_hz = np.asarray(frequencies_hz, np.float64)
    is_velocity, harmonic_states = quantity == "velocity", slice(2 * frequency_hz.size)
    # The constant of a velocity is the slope of the displacement.
    order = 0 if is_velocity else 1
    model = linear_model(time_s, valid, frequency_hz, background_order=order)
    pulses, states = model.matrix.shape
    state, residual = model.solve(motion[..., valid])
    # Noise variance of one value, from the residual and its degrees of freedom.
    variance = np.einsum("...i,...i->...", residual, residual) / (pulses - states)
    unit_covariance = model.root @ model.root.T
    # From the states of the motion to those of the displacement. The velocity of a phasor x is j w x, with the in-phase
    # and quadrature states -w Im x and w Re x.
    omega = 2 * np.pi * frequency_hz
    velocity_to_displacement = np.kron(np.diag(1 / omega), [[0.0, 1.0], [-1.0, 0.0]])
    to_displacement = velocity_to_displacement if is_velocity else np.eye(2 * frequency_hz.size)
    covariance_per_variance = to_displacement @ unit_covariance[harmonic_states, harmonic_states] @ to_displacement.T
    covariance = variance[..., None, None] * covariance_per_variance
    residual_m = np.asarray(np.sqrt(variance) / (omega.min() if is_velocity else 1.0))
    quality = FitQuality(residual_m, float(pulses - states), pulses, model.condition)
    fit = fit_from_state(frequency_hz, state[..., harmonic_states] @ to_displacement.T, covariance, quality)
    # The column of the slope runs from -1 to 1 over the train.
    per_second = 1.0 if is_velocity else 2 / (time_s[-1] - time_s[0])
    velocity_index = 2 * frequency_hz.size + order
    velocity_u = np.sqrt(variance * unit_covariance[velocity_index, velocity_index]) * per_second
    return fit, np.asarray(state[..., velocity_index] * per_second), np.asarray(velocity_u)


def _refuse_other_units(motion: NDArray[Any], quantity: StatedQuantity, axis: int) -> None:
    """Raise ``ValueError`` if a series of ``motion`` along ``axis``, m or m/s, changes by more than tissue can."""
    largest, unit = MAX_CHANGE[quantity]
    if (change_by := largest_change(motion, axis)) > largest:
        raise ValueError(
            f"the {quantity} changes by up to {engineering(change_by, unit)} within the train, tissue by at most "
            f"{engineering(largest, unit)}, so the values have another unit than stated: for values in um "
            f"quantity={quantity}_um{'' if unit == 'm' else '_per_s'} of a map, 1e-6 * motion for estimate_motion"
        )


def estimate_stated_motion(
    motion: FloatArray,
    pulse_rate_hz: float,
    frequencies_hz: Sequence[float],
    quantity: StatedQuantity,
    frequency_accuracy: float,
) -> Estimates:
    """Return amplitude and phase of each ``motion`` (series, pulse), m or m/s, with budget and warnings, as of shots.

    Values that are not finite are missing. ``frequency_accuracy``: relative standard uncertainty of the frequencies by
    the clock of the pulses. Raises ``ValueError`` if values have another unit, and the first one of
    ``fit_stated_motion`` if no series has an estimate.
    """
    _refuse_other_units(motion, quantity, axis=1)
    shots, errors = list[ShotResult](), dict[int, ValueError]()
    for index, series in enumerate(motion):
        try:
            shot = _estimate_series(series, pulse_rate_hz, frequencies_hz, quantity, frequency_accuracy, len(motion))
            shots.append(replace(shot, index=index))
        except ValueError as error:
            errors[index] = error
    if errors and not shots:
        raise errors[0]
    return Estimates(tuple(shots), {index: str(error) for index, error in errors.items()})


def _estimate_series(
    motion: FloatArray,
    pulse_rate_hz: float,
    frequencies_hz: Sequence[float],
    quantity: StatedQuantity,
    frequency_accuracy: float,
    series_count: int,
) -> ShotResult:
    """Return amplitude and phase of one ``motion`` (pulse,), one of ``series_count``."""
    time_s, valid = np.arange(motion.size) / pulse_rate_hz, np.isfinite(motion)
    fit = fit_stated_motion(motion, valid, time_s, frequencies_hz, quantity)[0]
    clock_m = None
    if frequency_accuracy:
        # Times that are wrong by e t delay the motion by e times their mean.
        delay_s = frequency_accuracy * float(time_s[valid].mean())
        clock_m = -2j * np.pi * fit.frequency_hz * delay_s * fit.amplitude_m * np.exp(1j * fit.phase_rad)
    sources = ErrorSources(sound_speed_uncertainty=0.0, time_base_m=clock_m)
    estimates = estimates_of(fit, sources)
    line = None
    # Few pulses leave no frequencies to test.
    with suppress(ValueError):
        values = Motion(time_s, motion, np.zeros(motion.size), valid)
        line = residual_line(values, fit.frequency_hz, background_order=int(quantity == "displacement"))
    if line is not None and quantity == "velocity":
        line = replace(line, amplitude_m=line.amplitude_m / (2 * math.pi * line.frequency_hz))
    return ShotResult(
        index=0,
        repeat=0,
        burst_length_s=None,
        force_fraction=None,
        pulses_used=int(valid.sum()),
        pulses_missing=int((~valid).sum()),
        residual_m=float(fit.quality.residual_rms_m),
        estimates=estimates,
        warnings=(
            *fit_warnings(fit, 0.0),
            *line_warnings(line, pulse_rate_hz, FALSE_ALARM_PROBABILITY / series_count, 0.0),
        ),
        pulse_rate_hz=pulse_rate_hz,
        influences=error_influences(fit, estimates, (None,) * fit.frequency_hz.size, False, sources),
    )


def map_stated_motion(
    motion: NDArray[Any],
    time_s: FloatArray,
    frequencies_hz: Sequence[float],
    quantity: StatedQuantity,
    depth_m: FloatArray,
    line_position_m: FloatArray | None = None,
    *,
    frequency_accuracy: float,
) -> MotionMap:
    """Return amplitude, phase and velocity with their uncertainties at every line and depth.

    ``motion`` (line, pulse, depth): m or m/s; each of its series is a pixel. A pixel with a value that is not finite,
    or without any change, is marked as bad and NaN. ``frequency_accuracy`` and ``ValueError`` as for
    ``estimate_stated_motion``.
    """
    _refuse_other_units(motion, quantity, axis=1)
    pixels = np.array(motion.swapaxes(1, 2), np.float64)
    bad = np.where(np.isfinite(pixels).all(axis=-1), BadPixel.GOOD, BadPixel.NOT_FINITE).astype(np.uint8)
    bad[(pixels == pixels[..., :1]).all(axis=-1)] = BadPixel.NO_ECHO
    pixels[bad > 0] = 0.0
    every_pulse = np.ones(time_s.size, bool)
    fit, velocity, velocity_u = fit_stated_motion(pixels, every_pulse, time_s, frequencies_hz, quantity)
    # One delay for all pixels, as in `_estimate_series`.
    clock_delay_u_s = frequency_accuracy * abs(float(time_s.mean()))
    clock_rad = np.minimum(2 * np.pi * fit.frequency_hz * clock_delay_u_s, math.sqrt(PHASE_VARIANCE_LIMIT))
    results: dict[str, Any] = {
        "amplitude_m": fit.amplitude_m,
        "amplitude_uncertainty_m": np.sqrt(fit.covariance[..., 0, 0]),
        "phase_rad": fit.phase_rad,
        "phase_uncertainty_rad": np.hypot(np.sqrt(fit.covariance[..., 1, 1]), clock_rad),
        "velocity_m_per_s": velocity,
        "velocity_uncertainty_m_per_s": velocity_u,
        "residual_m": np.asarray(fit.quality.residual_rms_m),
    }
    for values in results.values():
        values[bad > 0] = np.nan
    return MotionMap(
        frequency_hz=fit.frequency_hz,
        line_m=np.arange(len(pixels), dtype=float) if line_position_m is None else line_position_m,
        depth_m=depth_m,
        power=np.full(bad.shape, np.nan),
        bad=bad,
        lines_are_placed=line_position_m is not None,
        clock_delay_u_s=clock_delay_u_s,
        **results,
    )
