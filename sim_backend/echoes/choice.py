"""Choice of the faster evaluation that meets a tolerance, and of the scatterers that it must include.

Run times are models fitted to measurements on one x86-64 core (docs/explanation/echoes.md, section 5).
"""

from __future__ import annotations

import math
from typing import Literal

import numpy as np

from sim_backend.arrays import FloatArray, Int64Array
from sim_backend.echoes.delays import EchoDelays
from sim_backend.echoes.pulse import Pulse
from sim_backend.echoes.series import series_terms, shape_angles_rad

Method = Literal["running_sum", "series"]

FINEST_TOLERANCE = 1e-14
"""Below it rounding exceeds the error of the series."""
OMITTED_FRACTION = 0.1
"""Fraction of the tolerance for the scatterers left out."""

# Fewer scatterers are not worth a search for negligible ones.
_MIN_SCATTERERS_TO_OMIT = 64


def method_times_s(
    delays: EchoDelays, pulse: Pulse, sample_time_s: FloatArray, tolerance: float
) -> dict[Method, float]:
    """Return the estimated run time, s, of each method of echo synthesis that meets the tolerance.

    A time is a sum of numbers of operations, each times the measured time of one operation, s.
    """
    echo_count, samples = delays.echo_count, len(sample_time_s)
    scatterers, frequencies = len(delays.rest_s), len(pulse.frequency_hz)
    duration_s = float(sample_time_s[-1] - sample_time_s[0])
    blocks = max(1, math.ceil(duration_s / (pulse.end_s - pulse.start_s)))
    # Running sums of one echo: exponentials of every scatterer in each block that it reaches (two at most, or three if
    # it moves far), and sums at every sample.
    echo_s = min(blocks, 2) * (20e-9 + 30e-9 * frequencies) * scatterers + 57e-9 * frequencies * samples
    times_s: dict[Method, float] = {"running_sum": 3e-4 * blocks + echo_count * echo_s}
    if tolerance < FINEST_TOLERANCE:
        return times_s
    terms = series_terms(shape_angles_rad(pulse, delays.shape, delays.centred().amplitude_s), tolerance)
    if terms is not None:
        # A term is a product of powers of the motion's amplitudes; the last term has the highest degree.
        term_count, degrees = len(terms), sum(terms[-1]) + 1
        # Samples that the start and the end of all pulses cross as the scatterers move.
        sample_period_s = duration_s / max(1, samples - 1) or 1.0
        reach_s = (np.ptp(delays.amplitude_s, axis=0) / 2) @ np.abs(delays.shape)
        crossings = 4 * float(reach_s.sum()) / sample_period_s
        # The series: sums over the scatterers, common to all echoes; a correction for each crossing of each echo; and
        # the product of sums and amplitude factors at every sample of each echo.
        sums_s = 5e-4 * blocks + scatterers * (160e-9 + 10e-9 * term_count * frequencies)
        corrections_s, products_s = 7e-10 * degrees * crossings * echo_count, 4e-10 * term_count * echo_count * samples
        times_s["series"] = sums_s + corrections_s + products_s
    return times_s


def reachable_scatterers(delays: EchoDelays, weight: FloatArray, pulse: Pulse, sample_time_s: FloatArray) -> Int64Array:
    """Return the indices of scatterers with an echo that overlaps a sample time."""
    early_s, late_s = delays.rest_s - delays.max_change_s(), delays.rest_s + delays.max_change_s()
    touches = (early_s + pulse.start_s <= sample_time_s[-1]) & (late_s + pulse.end_s >= sample_time_s[0])
    touches &= weight != 0
    return np.flatnonzero(touches)


def negligible_weight(weight: FloatArray, pulse: Pulse, sample_time_s: FloatArray, tolerance: float) -> float:
    """Return the weight below which all scatterers together stay within ``OMITTED_FRACTION`` of the tolerance.

    No echo exceeds its scatterer's weight times the pulse's summed amplitudes, so N scatterers of weights below w add
    less than N w times these amplitudes. The bound is relative to the rms of an incoherent sum; the caller checks it
    against the echoes.
    """
    if len(weight) < _MIN_SCATTERERS_TO_OMIT or tolerance <= 0:
        return 0.0
    pulse_bound = float(np.abs(pulse.amplitude).sum())
    return OMITTED_FRACTION * tolerance * incoherent_rms(weight, pulse, sample_time_s) / (pulse_bound * len(weight))


def incoherent_rms(weight: FloatArray, pulse: Pulse, sample_time_s: FloatArray) -> float:
    """Return the expected rms over the gate of the echoes' sum, if the phases of the scatterers are independent.

    Then their powers add. ``weight`` (scatterer,): those of all scatterers with an echo that reaches the gate.
    """
    # Mean power of a pulse while it lasts: half the squared amplitude of each exponential.
    pulse_power = float(np.square(np.abs(pulse.amplitude)).sum()) / 2
    # The delays of these scatterers extend over gate and pulse; at any sample only those within one pulse are alive.
    pulse_s, gate_s = pulse.end_s - pulse.start_s, float(sample_time_s[-1] - sample_time_s[0])
    return math.sqrt(float(weight @ weight) * pulse_power * (pulse_s / (pulse_s + gate_s)))
