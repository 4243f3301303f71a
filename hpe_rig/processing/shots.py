"""Stored records -> estimates of every shot, with the truth beside them where the twin knows it."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from hpe_rig.plan import Plan, Shot, disturbed_pulses, reference_gate, slow_time_window
from hpe_rig.processing.conditioning import centred_volts
from hpe_rig.processing.echoes import EchoGate, Motion
from hpe_rig.processing.estimators import Estimator, Options, fit_motion, motion_of
from hpe_rig.processing.flags import clipped_pulses, unlike_pulses
from hpe_rig.processing.harmonic import HarmonicFit
from hpe_rig.processing.maximum_likelihood import joint
from hpe_rig.processing.model import Design, design
from hpe_rig.processing.motion import coherent
from hpe_rig.processing.reference import relative_to
from hpe_rig.processing.stationarity import Drift, drift_between_halves
from hpe_rig.result import Averaging, Estimate, ShotResult
from hpe_rig.scene import Processing, Scene
from hpe_rig.store import ShotRecords, StoredRun

LARGE_STEP = 0.8
"""Quarter wavelengths a pulse from which on the next period of the carrier is close."""
LARGE_CONDITION = 10.0
DETECTED = 3.0
"""Amplitude over its uncertainty below which a harmonic may be noise: it exceeds that by chance in 1 % of cases."""
HIGHEST_DRIVEN_HZ = 2e4
"""A specimen follows no further: at 20 kHz a shear wave is far shorter than the beam is wide."""


def estimate_run(
    scene: Scene, plan: Plan, stored: StoredRun, estimator: Estimator, averaging: tuple[Averaging | None, ...]
) -> tuple[ShotResult, ...]:
    """Return the estimates of every shot that has records, with the ``averaging`` at each wanted frequency beside them.

    Raises ``ValueError`` where they cannot be made.
    """
    results = []
    for shot in plan.shots:
        # Of a long record only the gate comes into memory.
        records = stored.records.gated(shot.index, shot.gate)
        if not records.valid.any():
            continue
        truth_m = None
        if stored.true_displacement_m is not None:
            truth_m = stored.true_displacement_m.harmonics_m(shot.index, len(scene.wanted_frequencies_hz))
        reference = reference_gate(scene, shot)
        still = None if reference is None else stored.records.gated(shot.index, reference)
        for window in scene.windows:
            results.append(_estimate_shot(window, shot, records, still, truth_m, estimator, averaging))
    return tuple(results)


def options_of(processing: Processing) -> Options:
    """Return what of the estimation the scene chooses, apart from the estimator."""
    return Options(processing.background_order, processing.harmonic, processing.process_noise)


def driven_frequencies_hz(scene: Scene) -> NDArray[np.float64]:
    """Return every frequency up to 1/T_b that the tonebursts drive, wanted or not, shape (frequency,).

    Fitted along they are no noise, as far as the pulses can tell them apart; empty where nothing pushes.
    """
    if scene.excitation is None:
        return np.zeros(0)
    rate_hz = scene.excitation.burst_rate_hz
    count = math.floor(min(HIGHEST_DRIVEN_HZ, 1 / min(scene.excitation.burst_length_s)) / rate_hz)
    return rate_hz * np.arange(1.0, count + 1)


def _estimate_shot(
    scene: Scene,
    shot: Shot,
    records: ShotRecords,
    still: ShotRecords | None,
    truth_m: NDArray[np.float64] | None,
    estimator: Estimator,
    averaging: tuple[Averaging | None, ...],
) -> ShotResult:
    inside = slow_time_window(scene, shot)
    full_scale = clipped_pulses(records.codes, records.code_limits)
    echoes = shot_echoes(scene, shot, records, inside, full_scale)
    recorded = records.valid[inside]
    reference = None if still is None else coherent(shot_echoes(scene, shot, still, inside))
    frequencies_hz = np.array(scene.wanted_frequencies_hz, dtype=np.float64)
    also_hz = driven_frequencies_hz(scene)
    options = options_of(scene.processing)
    motion = None if estimator == "joint" else motion_of(echoes, estimator)
    fit, largest_step = _fit(echoes, motion, reference, frequencies_hz, estimator, also_hz, options)
    skipped = skipped_pulses(scene, shot)[inside]
    clipped = int((full_scale[inside] & recorded & ~skipped).sum())
    drift = None
    if reference is None:
        # It tells of the bench, not of the estimator: the one with the least noise looks.
        steady = motion if motion is not None and estimator == "coherent" else coherent(echoes)
        drift = _drift(steady, frequencies_hz, also_hz, options)
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
        estimates=tuple(_estimate(fit, truth_m, index, averaging[index]) for index in range(frequencies_hz.size)),
        warnings=(
            *_record_warnings(recorded, recorded & ~skipped & ~echoes.valid, clipped),
            *_fit_warnings(fit, largest_step),
            *_setting_warnings(scene, echoes.pulse_time_s, reference),
            *_drift_warnings(fit, drift),
        ),
    )


def skipped_pulses(scene: Scene, shot: Shot) -> NDArray[np.bool_]:
    """Return which pulses the scene leaves out because a toneburst disturbs them, shape (pulse,)."""
    disturbed = disturbed_pulses(shot)
    return disturbed if scene.tracking.disturbed == "skip" else np.zeros_like(disturbed)


def design_of(scene: Scene, shot: Shot) -> tuple[NDArray[np.float64], Design]:
    """Return the times of the pulses used, from the timeline's reference (pulse,), and the model fitted to them.

    As planned, none missing; ``ValueError`` where the pulses do not tell the wanted frequencies apart.
    """
    inside = slow_time_window(scene, shot)
    time_s, used = shot.timeline.sensing_s[inside] - shot.timeline.reference_s, ~skipped_pulses(scene, shot)[inside]
    wanted_hz = np.array(scene.wanted_frequencies_hz)
    return time_s[used], design(time_s, used, wanted_hz, also_hz=driven_frequencies_hz(scene))


def shot_echoes(
    scene: Scene,
    shot: Shot,
    records: ShotRecords,
    inside: NDArray[np.bool_],
    full_scale: NDArray[np.bool_] | None = None,
) -> EchoGate:
    """Return the gated echoes of the pulses ``inside`` (pulse,) the window, without those the scene leaves out.

    ``full_scale`` (pulse,), which records reach the digitizer's full scale, is found where not given.
    """
    if full_scale is None:
        full_scale = clipped_pulses(records.codes, records.code_limits)
    valid = (records.valid & ~skipped_pulses(scene, shot))[inside]
    codes = records.codes if inside.all() else records.codes[inside]
    sound = valid & ~full_scale[inside]
    echoes = EchoGate(
        volts=centred_volts(codes, records.volts_per_code, sound),
        sample_rate_hz=shot.capture.sample_rate_hz,
        pulse_time_s=shot.timeline.sensing_s[inside] - shot.timeline.reference_s,
        carrier_hz=scene.tracking.carrier_hz,
        sound_speed_m_per_s=scene.acquisition.sound_speed_m_per_s,
        valid=valid,
    )
    if not scene.processing.flag_pulses or scene.tracking.disturbed == "keep" or not valid.any():
        return echoes
    return echoes.without(unlike_pulses(echoes))


def _fit(
    echoes: EchoGate,
    motion: Motion | None,
    reference: Motion | None,
    frequencies_hz: NDArray[np.float64],
    estimator: Estimator,
    also_hz: NDArray[np.float64],
    options: Options,
) -> tuple[HarmonicFit, float]:
    """Return the fit and the largest step between pulses in quarter wavelengths, 0 where it has no meaning."""
    if motion is None:
        if reference is not None:
            raise ValueError("joint has no displacements to subtract processing.reference_gate_depth_m's from")
        return joint(echoes, frequencies_hz, also_hz=also_hz, background_order=options.background_order), 0.0
    if reference is not None:
        motion = relative_to(motion, reference)
    return fit_motion(motion, frequencies_hz, estimator, also_hz, options), float(motion.largest_step)


def _estimate(
    fit: HarmonicFit,
    truth_m: NDArray[np.float64] | None,
    index: int,
    averaging: Averaging | None,
) -> Estimate:
    known = truth_m is not None and bool(np.isfinite(truth_m[index]).all())
    in_phase_m, quadrature_m = truth_m[index] if truth_m is not None and known else (0.0, 0.0)
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


def _drift(
    motion: Motion, frequencies_hz: NDArray[np.float64], also_hz: NDArray[np.float64], options: Options
) -> Drift | None:
    order = options.background_order
    try:
        return drift_between_halves(motion, frequencies_hz, also_hz=also_hz, background_order=order)
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
            f"the pulses hardly tell the frequencies, or these and the background, apart (condition "
            f"{fit.condition:.3g}, 1 is best): the uncertainties say so; watch them for longer"
        )
    lost = fit.amplitude_m < DETECTED * np.sqrt(fit.covariance[:, 0, 0])
    if lost.any():
        yield (
            f"not told from noise at {', '.join(f'{f:g}' for f in fit.frequency_hz[lost])} Hz: the amplitude is below "
            f"{DETECTED:g} times its uncertainty, its phase means nothing; take more cycles, pulses or drive"
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
