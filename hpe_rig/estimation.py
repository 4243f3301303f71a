"""Stored records -> estimates of every shot, with the truth beside them where the twin knows it."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from hpe_rig.plan import Plan, Shot
from hpe_rig.processing import (
    Drift,
    EchoGate,
    Estimator,
    HarmonicFit,
    Motion,
    drift_between_halves,
    estimate,
    least_squares,
)
from hpe_rig.processing.conditioning import codes_to_volts, remove_offset
from hpe_rig.records import ShotRecords
from hpe_rig.result import Estimate, ShotResult
from hpe_rig.scene import Scene
from hpe_rig.store import StoredRun
from hpe_rig.theory import GateWindow, beam_averaging_factor, speckle_spread

CODE_LIMITS = (-8192, 8191)


def estimate_run(scene: Scene, plan: Plan, stored: StoredRun, estimator: Estimator) -> tuple[ShotResult, ...]:
    """Return the estimates of every shot that has records."""
    prediction = predicted_averaging(scene, estimator)
    results = []
    for shot in plan.shots:
        # Of a long record only the gate comes into memory.
        records = stored.records.gated(shot.index, shot.gate)
        if not records.valid.any():
            continue
        truth_m = None if stored.true_displacement_m is None else stored.true_displacement_m[shot.index]
        results.append(_estimate_shot(scene, shot, records, truth_m, estimator, prediction))
    return tuple(results)


def predicted_averaging(scene: Scene, estimator: Estimator) -> tuple[float | None, float | None]:
    """Return the predicted tracked over peak displacement and its relative speckle spread; None without beams."""
    if scene.beams is None:
        return None, None
    tracking, acquisition, beams = scene.tracking, scene.acquisition, scene.beams
    pulse_m = tracking.cycles / tracking.carrier_hz * acquisition.sound_speed_m_per_s / 2
    pulse_m = beams.pulse_length_m or pulse_m
    geometry = (beams.excitation_width_m, beams.tracking_width_m, acquisition.gate_length_m, pulse_m)
    window: GateWindow = "hann" if estimator == "cross_spectrum" else "none"
    # A fixed seed: a prediction is a function of the scene alone.
    spread = speckle_spread(*geometry, np.random.default_rng(0), gate_window=window)
    return beam_averaging_factor(*geometry, gate_window=window), spread


def driven_frequencies_hz(scene: Scene, pulses: int) -> NDArray[np.float64]:
    """Return every frequency that the tonebursts drive up to half the pulse rate, wanted or not, shape (frequency,).

    Empty where nothing pushes, and where ``pulses`` are too few to fit them all in each half of the window.
    """
    if scene.excitation is None:
        return np.zeros(0)
    rate_hz = scene.excitation.burst_rate_hz
    highest = math.floor(scene.tracking.pulse_rate_hz / 2 / rate_hz * (1 + 1e-9))
    driven = np.array([rate_hz * n for n in range(1, highest + 1)], dtype=np.float64)
    unknowns = 2 * (driven.size + len(scene.wanted_frequencies_hz)) + 1
    return driven if pulses > 4 * unknowns else np.zeros(0)


def slow_time_window(scene: Scene, shot: Shot) -> NDArray[np.bool_]:
    """Return which pulses lie in the processing window, shape (pulse,)."""
    processing = scene.processing
    after_first_s = shot.timeline.pulse_onset_s - shot.timeline.pulse_onset_s[0]
    end_s = math.inf if processing.window_length_s is None else processing.window_start_s + processing.window_length_s
    half_s = 0.5 / shot.tracking_train.rate_hz
    inside: NDArray[np.bool_] = (after_first_s > processing.window_start_s - half_s) & (after_first_s < end_s - half_s)
    return inside


def _estimate_shot(
    scene: Scene,
    shot: Shot,
    records: ShotRecords,
    truth_m: NDArray[np.float64] | None,
    estimator: Estimator,
    prediction: tuple[float | None, float | None],
) -> ShotResult:
    inside = slow_time_window(scene, shot)
    codes, valid = records.codes[inside], records.valid[inside]
    volts = codes_to_volts(codes, records.volts_per_code, records.volts_offset)
    time_s = shot.timeline.sensing_s[inside] - shot.timeline.reference_s
    echoes = EchoGate(
        volts=remove_offset(volts),
        sample_rate_hz=shot.capture.sample_rate_hz,
        pulse_time_s=time_s,
        carrier_hz=scene.tracking.carrier_hz,
        sound_speed_m_per_s=scene.acquisition.sound_speed_m_per_s,
        valid=valid,
    )
    frequencies_hz = np.array(scene.wanted_frequencies_hz, dtype=np.float64)
    also_hz = driven_frequencies_hz(scene, int(valid.sum()))
    fit = estimate(echoes, frequencies_hz, estimator, also_hz)
    truth = None if truth_m is None else _fit_truth(time_s, truth_m[inside], frequencies_hz, also_hz)
    clipped = int(np.isin(codes[valid], CODE_LIMITS).any(axis=-1).sum())
    return ShotResult(
        shot=shot.index,
        repeat=shot.repeat,
        burst_length_s=shot.timeline.burst_length_s or None,
        force_fraction=shot.force_fraction,
        pulses_used=int(valid.sum()),
        pulses_missing=int((~valid).sum()),
        residual_m=float(fit.residual_rms_m),
        estimates=tuple(_estimate(fit, truth, index, prediction) for index in range(frequencies_hz.size)),
        warnings=tuple(_warnings(valid, clipped, fit, _drift(echoes, frequencies_hz, estimator, also_hz))),
    )


def _fit_truth(
    time_s: NDArray[np.float64],
    truth_m: NDArray[np.float64],
    frequencies_hz: NDArray[np.float64],
    also_hz: NDArray[np.float64],
) -> HarmonicFit | None:
    known = np.isfinite(truth_m)
    if known.sum() < 2 * (frequencies_hz.size + also_hz.size) + 2:
        return None
    motion = Motion(time_s, np.where(known, truth_m, 0.0), np.zeros(truth_m.shape), known)
    return least_squares(motion, frequencies_hz, also_hz=also_hz)


def _estimate(
    fit: HarmonicFit, truth: HarmonicFit | None, index: int, prediction: tuple[float | None, float | None]
) -> Estimate:
    return Estimate(
        frequency_hz=float(fit.frequency_hz[index]),
        amplitude_m=float(fit.amplitude_m[index]),
        amplitude_uncertainty_m=math.sqrt(fit.covariance[index, 0, 0]),
        phase_rad=float(fit.phase_rad[index]),
        phase_uncertainty_rad=math.sqrt(fit.covariance[index, 1, 1]),
        averaging_factor=prediction[0],
        speckle_relative=prediction[1],
        true_amplitude_m=None if truth is None else float(truth.amplitude_m[index]),
        true_phase_rad=None if truth is None else float(truth.phase_rad[index]),
    )


def _drift(
    echoes: EchoGate, frequencies_hz: NDArray[np.float64], estimator: Estimator, also_hz: NDArray[np.float64]
) -> Drift | None:
    try:
        return drift_between_halves(echoes, frequencies_hz, estimator, also_hz)
    except ValueError:
        # Half the pulses cannot resolve the frequencies: nothing can be said about a change.
        return None


def _warnings(valid: NDArray[np.bool_], clipped: int, fit: HarmonicFit, drift: Drift | None) -> Iterator[str]:
    missing = int((~valid).sum())
    if missing:
        yield f"{missing} of {valid.size} records are missing: triggers were lost or came while the digitizer was busy"
    if clipped:
        yield f"{clipped} records reach the digitizer's full scale in the gate: raise acquisition.input_range_v"
    if drift is not None and drift.suspicious.any():
        rows = np.flatnonzero(drift.suspicious)
        words = ", ".join(f"{fit.frequency_hz[i]:g} Hz {drift.relative_change[i] * 100:+.0f} %" for i in rows)
        yield (
            f"the amplitude changes from the first half of the pulses to the second ({words}): tonebursts are missing, "
            "or the motion is not stationary; compare the bench's burst count with excitation.burst_count, or move "
            "processing.window_start_s past the start-up"
        )
