"""Estimates of every stored shot, with the ground truth beside them where the twin knows it."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from hpe_rig.plan import Plan, Selection, Shot, reference_gate, select
from hpe_rig.processing.conditioning import centred_volts, clipped_pulses, unlike_pulses
from hpe_rig.processing.echoes import EchoGate, Motion, margin_samples, relative_to
from hpe_rig.processing.estimators import EstimatorSpec, Options, estimate, fit_motion, spec_of
from hpe_rig.processing.harmonic import HarmonicFit
from hpe_rig.processing.model import LinearModel, linear_model
from hpe_rig.processing.motion import coherent
from hpe_rig.processing.stationarity import Drift, drift_between_halves
from hpe_rig.result import Averaging, Estimate, ShotResult
from hpe_rig.scene import Processing, Scene
from hpe_rig.store import ShotRecords, StoredRun

LARGE_STEP = 0.8
"""Quarter wavelengths a pulse from which on the next period of the carrier is close."""
LARGE_CONDITION = 10.0
DETECTED = 3.0
"""Amplitude over its uncertainty below which a harmonic may be noise: it exceeds that by chance in 1 % of cases."""


def estimate_run(
    scene: Scene, plan: Plan, stored: StoredRun, estimator: str, averaging: tuple[Averaging | None, ...]
) -> tuple[ShotResult, ...]:
    """Return the estimates of every shot that has records, with the ``averaging`` at each wanted frequency beside them.

    Raises ``ValueError`` where they cannot be made.
    """
    spec, results = spec_of(estimator), []
    for shot in plan.shots:
        # Of a long record only the gate and what its edges need comes into memory.
        margin = margin_samples(shot.capture.sample_rate_hz, scene.tracking.carrier_hz)
        records = stored.records.gated(shot.index, shot.gate, margin=margin)
        if not records.valid.any():
            continue
        true_m = None
        if stored.true_displacement_m is not None:
            true_m = stored.true_displacement_m.harmonics_m(shot.index, len(scene.wanted_frequencies_hz))
        reference = reference_gate(scene, shot)
        still = None if reference is None else stored.records.gated(shot.index, reference, margin=margin)
        for window in scene.windows:
            results.append(_estimate_shot(window, shot, records, still, true_m, spec, averaging))
    return tuple(results)


def options_of(processing: Processing) -> Options:
    """Return what of the estimation the scene chooses, apart from the estimator."""
    return Options(processing.background_order, processing.harmonic, processing.process_noise)


def _estimate_shot(
    scene: Scene,
    shot: Shot,
    records: ShotRecords,
    still: ShotRecords | None,
    true_m: NDArray[np.float64] | None,
    spec: EstimatorSpec,
    averaging: tuple[Averaging | None, ...],
) -> ShotResult:
    chosen = select(scene, shot)
    full_scale = clipped_pulses(records.gate_codes, records.code_limits)
    echoes = shot_echoes(scene, shot, records, chosen, full_scale)
    recorded = records.valid[chosen.window]
    reference = None if still is None else coherent(shot_echoes(scene, shot, still, chosen))
    options = options_of(scene.processing)
    motion = None if spec.motion is None else spec.motion(echoes)
    fit, largest_step = _fit(echoes, motion, reference, chosen, spec, options)
    clipped = int((full_scale[chosen.window] & recorded & chosen.used).sum())
    drift = None
    if reference is None:
        # It tells of the bench, not of the estimator: the one with the least noise looks.
        steady = motion if motion is not None and spec.motion is coherent else coherent(echoes)
        drift = _drift(steady, chosen, options)
    return ShotResult(
        shot=shot.index,
        repeat=shot.repeat,
        burst_length_s=shot.timeline.burst_length_s or None,
        force_fraction=shot.force_fraction,
        pulses_used=int(echoes.valid.sum()),
        pulses_missing=int((~recorded).sum()),
        residual_m=float(fit.residual_rms_m),
        pulse_rate_hz=shot.tracking_train.rate_hz,
        window_length_s=scene.processing.window_length_s,
        estimates=tuple(_estimate(fit, true_m, index, averaging[index]) for index in range(chosen.wanted_hz.size)),
        warnings=(
            *_record_warnings(recorded, recorded & chosen.used & ~echoes.valid, clipped),
            *_fit_warnings(fit, largest_step),
            *_setting_warnings(scene, echoes.pulse_time_s, reference),
            *_drift_warnings(fit, drift),
        ),
    )


def shot_model(scene: Scene, shot: Shot, with_driven: bool = True) -> tuple[NDArray[np.float64], LinearModel]:
    """Return the times (pulse,) of the pulses that the fit of ``shot`` uses, and the model fitted to them.

    As planned, no record missing; without the other driven frequencies where an estimator does not fit them along.
    Raises ``ValueError`` where the pulses do not resolve the wanted frequencies.
    """
    chosen = select(scene, shot)
    model = linear_model(
        chosen.time_s,
        chosen.used,
        chosen.wanted_hz,
        background_order=scene.processing.background_order,
        also_hz=chosen.driven_hz if with_driven else (),
    )
    return chosen.time_s[chosen.used], model


def shot_echoes(
    scene: Scene,
    shot: Shot,
    records: ShotRecords,
    chosen: Selection,
    full_scale: NDArray[np.bool_] | None = None,
) -> EchoGate:
    """Return the gated echoes of the ``chosen`` pulses.

    ``full_scale`` (pulse of the shot,), which records reach the digitizer's full scale, is found where not given.
    """
    if full_scale is None:
        full_scale = clipped_pulses(records.gate_codes, records.code_limits)
    window = chosen.window
    valid = records.valid[window] & chosen.used
    codes = records.codes if window.all() else records.codes[window]
    sound = valid & ~full_scale[window]
    gate = slice(records.margin[0], codes.shape[1] - records.margin[1])
    echoes = EchoGate(
        volts=centred_volts(codes, records.volts_per_code, sound, gate),
        sample_rate_hz=shot.capture.sample_rate_hz,
        pulse_time_s=chosen.time_s,
        carrier_hz=scene.tracking.carrier_hz,
        sound_speed_m_per_s=scene.acquisition.sound_speed_m_per_s,
        valid=valid,
        margin=records.margin,
    )
    if not scene.processing.flag_pulses or scene.tracking.disturbed == "keep" or not valid.any():
        return echoes
    return echoes.without(unlike_pulses(echoes))


def _fit(
    echoes: EchoGate,
    motion: Motion | None,
    reference: Motion | None,
    chosen: Selection,
    spec: EstimatorSpec,
    options: Options,
) -> tuple[HarmonicFit, float]:
    """Return the fit and the largest step between pulses in quarter wavelengths, 0 where it has no meaning."""
    frequencies = chosen.wanted_hz, spec.name, chosen.driven_hz
    if motion is None:
        if reference is not None:
            raise ValueError(f"{spec.name} has no displacements to subtract processing.reference_gate_depth_m's from")
        return estimate(echoes, *frequencies, options), 0.0
    if reference is not None:
        motion = relative_to(motion, reference)
    return fit_motion(motion, *frequencies, options), float(motion.largest_step)


def _estimate(
    fit: HarmonicFit,
    true_m: NDArray[np.float64] | None,
    index: int,
    averaging: Averaging | None,
) -> Estimate:
    known = true_m is not None and bool(np.isfinite(true_m[index]).all())
    in_phase_m, quadrature_m = true_m[index] if true_m is not None and known else (0.0, 0.0)
    return Estimate(
        frequency_hz=float(fit.frequency_hz[index]),
        amplitude_m=float(fit.amplitude_m[index]),
        amplitude_uncertainty_m=math.sqrt(fit.covariance[index, 0, 0]),
        phase_rad=float(fit.phase_rad[index]),
        phase_uncertainty_rad=math.sqrt(fit.covariance[index, 1, 1]),
        averaging_factor=None if averaging is None else averaging.factor,
        speckle_relative=None if averaging is None else averaging.speckle_relative,
        true_amplitude_m=math.hypot(in_phase_m, quadrature_m) if known else None,
        true_phase_rad=math.atan2(quadrature_m, in_phase_m) if known else None,
    )


def _drift(motion: Motion, chosen: Selection, options: Options) -> Drift | None:
    order = options.background_order
    try:
        return drift_between_halves(motion, chosen.wanted_hz, also_hz=chosen.driven_hz, background_order=order)
    except ValueError:
        # Half the pulses cannot resolve the frequencies: nothing can be said about a change.
        return None


def _record_warnings(recorded: NDArray[np.bool_], unlike: NDArray[np.bool_], clipped: int) -> Iterator[str]:
    missing, left_out = int((~recorded).sum()), int(unlike.sum())
    if missing and not recorded[-1]:
        yield (
            "the last record is missing: were the first triggers lost instead of the last, every phase is off by "
            "whole pulse periods"
        )
    if missing:
        yield (
            f"{missing} of {recorded.size} records are missing: triggers were lost or came while the digitizer was busy"
        )
    if left_out:
        yield (
            f"{left_out} of {recorded.size} pulses are left out, their energy is unlike the others': something "
            "disturbs them; see tracking.delay_s and processing.flag_pulses"
        )
    if clipped:
        yield f"{clipped} records reach the digitizer's full scale in the gate: raise acquisition.input_range_v"


def _fit_warnings(fit: HarmonicFit, largest_step: float) -> Iterator[str]:
    if largest_step > LARGE_STEP:
        yield (
            f"the echo moves by up to {largest_step:.2f} quarter wavelengths from pulse to pulse: at 1 the "
            "displacement jumps by a half wavelength; raise tracking.pulse_rate_hz, or the echoes drown in noise"
        )
    if fit.condition > LARGE_CONDITION:
        yield (
            f"the pulses barely resolve the frequencies, or these and the background (condition "
            f"{fit.condition:.3g}, 1 is best): the uncertainties include it; use a longer window"
        )
    lost = fit.amplitude_m < DETECTED * np.sqrt(fit.covariance[:, 0, 0])
    if lost.any():
        yield (
            f"not significant at {', '.join(f'{f:g}' for f in fit.frequency_hz[lost])} Hz: the amplitude is below "
            f"{DETECTED:g} u; ignore its phase, or take more cycles, pulses or drive"
        )
    found = fit.innovations
    if found is not None and abs(float(found.nis) - 1) > max(found.nis_tolerance, 0.5):
        yield (
            f"the Kalman filter's innovations are {float(found.nis):.2f} times what the echoes' noise explains (NIS): "
            "motion that the model lacks (processing.background_order, process_noise), trigger jitter, or bad pulses"
        )


def _setting_warnings(scene: Scene, pulse_time_s: NDArray[np.float64], reference: Motion | None) -> Iterator[str]:
    excitation = scene.excitation
    if excitation is not None and excitation.burst_count > 1:
        late = int((pulse_time_s > excitation.burst_count / excitation.burst_rate_hz).sum())
        if late > 0.02 * pulse_time_s.size:
            yield (
                f"{late} of {pulse_time_s.size} pulses come after the last toneburst's period, where the motion "
                "decays: shorten processing.window_length_s or raise excitation.burst_count"
            )
    if reference is not None and float(reference.largest_step) > LARGE_STEP:
        yield (
            f"the reference gate's echo moves by up to {float(reference.largest_step):.2f} quarter wavelengths from "
            "pulse to pulse, which an echo that stands still does not: there is none, or it drowns in noise; choose "
            "another processing.reference_gate_depth_m"
        )


def _drift_warnings(fit: HarmonicFit, drift: Drift | None) -> Iterator[str]:
    if drift is not None and drift.suspicious.any():
        rows = np.flatnonzero(drift.suspicious)
        words = ", ".join(f"{fit.frequency_hz[i]:g} Hz {drift.relative_change[i] * 100:+.0f} %" for i in rows)
        yield (
            f"the amplitude changes from the first half of the pulses to the second ({words}): tonebursts are missing, "
            "or the motion is not stationary; compare the bench's burst count with excitation.burst_count, or move "
            "processing.window_start_s past the start-up"
        )
