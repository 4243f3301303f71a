"""Estimates of every stored shot, with the ground truth beside them where the twin knows it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from hpe_rig.arrays import BoolArray, FloatArray
from hpe_rig.medium import BeamWidths, KnownMedium, RigidSphere
from hpe_rig.plan import Plan, Selection, Shot, reference_gate, select
from hpe_rig.processing.budget import Known, estimates_of, known_of, with_second_order_speckle
from hpe_rig.processing.echo.conditioning import (
    CodedVolts,
    GateStatistics,
    centred_volts,
    gate_statistics,
    joined_statistics,
    statistics_of,
    unlike_pulses,
)
from hpe_rig.processing.echo.echoes import EchoGate, Motion, gate_edge_relative, margin_samples, relative_to
from hpe_rig.processing.echo.gate_tracking import added, follow
from hpe_rig.processing.estimators import EstimatorSpec, Harmonic, Options, fit_motion, spec_of
from hpe_rig.processing.harmonics.aliasing_error import with_unresolved
from hpe_rig.processing.harmonics.harmonic_fit import HarmonicFit
from hpe_rig.processing.harmonics.medium_prior import MediumPrior, medium_prior
from hpe_rig.processing.harmonics.model import LinearModel, linear_model
from hpe_rig.processing.harmonics.quantisation import rounding_m
from hpe_rig.processing.harmonics.residual_line import Line, residual_line
from hpe_rig.processing.harmonics.stationarity import Drift, drift_between_halves
from hpe_rig.processing.motion.phase_shift import coherent
from hpe_rig.result import DETECTED, MOST_PULSES, Averaging, Estimate, ShotMotion, ShotResult
from hpe_rig.scene import Processing, Scene

if TYPE_CHECKING:
    from hpe_rig.store import GatedRecords, StoredRun

MOST_MODELLED = 20_000
"""Pulses of a shot up to which the model is laid through its displacement pulse by pulse: it takes a column a state."""
LARGE_STEP = 0.8
"""Quarter wavelengths a pulse from which on the next period of the carrier is close."""
LARGE_CONDITION = 10.0
UNLIKELY = 0.01
"""Probability, over the shots of a run, below which a motion is of no medium of the ensemble."""
NO_RECORDS = "no record of it was acquired"
DAMAGED = "fail their checksums and count as missing: the file is damaged; hpe-rig verify lists them"


@dataclass(frozen=True, slots=True)
class Estimates:
    """Results of the shots of a run, and of those that have none the reason, by the shot's index from 0."""

    shots: tuple[ShotResult, ...]
    without: Mapping[int, str]


def estimate_run(
    scene: Scene,
    plan: Plan,
    stored: StoredRun,
    estimator: str,
    averaging: tuple[Averaging | None, ...],
    beams: BeamWidths | None = None,
) -> Estimates:
    """Return the estimates of every shot that has records, with the ``averaging`` at each wanted frequency beside them.

    With ``beams`` a prior of media stands for the harmonics of the tonebursts, where scene and estimator take one, and
    where the scene declares no medium, the averaging is what the motion itself says of it. A shot that cannot be
    estimated, such as one in which the run stopped, costs no other its result.
    """
    spec, results, without = spec_of(estimator), list[ShotResult](), dict[int, str]()
    shots, pulses, _ = stored.records.shape
    kept = shots * pulses * len(scene.windows) <= MOST_PULSES
    for shot in plan.shots:
        try:
            found = _windows_of_shot(scene, shot, stored, spec, averaging, beams, UNLIKELY / len(plan.shots))
            results += found if kept else [replace(each, motion=None) for each in found]
        except ValueError as error:
            without[shot.index] = str(error)
    return Estimates(tuple(results), without)


def _windows_of_shot(
    scene: Scene,
    shot: Shot,
    stored: StoredRun,
    spec: EstimatorSpec,
    averaging: tuple[Averaging | None, ...],
    beams: BeamWidths | None,
    unlikely: float,
) -> list[ShotResult]:
    """Return the result of each window of one shot; raise ``ValueError`` where one cannot be estimated."""
    # Of a long record only the gate and what its edges need come into memory, unless the gate follows.
    margin = margin_needed(scene, shot)
    # What a long one holds in the gate is looked at while its checksums are compared.
    looked = list[GateStatistics]()
    records = stored.records.in_blocks(
        shot.index, samples_needed(scene, shot), margin=margin, look=lambda codes: looked.append(statistics_of(codes))
    )
    if not records.valid.any():
        raise ValueError(
            NO_RECORDS if records.damaged is None or not records.damaged.any() else f"its records {DAMAGED}"
        )
    true_m = None
    if stored.true_displacement_m is not None:
        true_m = stored.true_displacement_m.harmonics_m(shot.index, len(scene.wanted_frequencies_hz))
    reference = reference_gate(scene, shot)
    still = None if reference is None else stored.records.in_blocks(shot.index, reference, margin=margin)
    known, complete = known_of(scene, stored.simulated), bool(stored.shot_complete[shot.index])
    results, found = [], joined_statistics(looked) if looked else gate_statistics(records)
    looked.clear()
    for window in scene.windows:
        share = unlikely / len(scene.windows)
        results.append(
            _estimate_shot(window, shot, records, found, still, true_m, spec, averaging, known, beams, share, complete)
        )
    return results


def shot_fit(
    scene: Scene, shot: Shot, stored: StoredRun, estimator: str, beams: BeamWidths | None = None
) -> HarmonicFit:
    """Return the fit of one shot, with the covariance of all its harmonics; as ``estimate_run`` fits it.

    Of the scene's own window. Raises ``ValueError`` where the shot cannot be estimated.
    """
    spec, margin = spec_of(estimator), margin_needed(scene, shot)
    records = stored.records.in_blocks(shot.index, samples_needed(scene, shot), margin=margin)
    if not records.valid.any():
        raise ValueError(NO_RECORDS)
    chosen, gate = select(scene, shot), reference_gate(scene, shot)
    echoes, reference = shot_echoes(scene, shot, records, chosen), None
    if gate is not None:
        still = stored.records.in_blocks(shot.index, gate, margin=margin)
        reference = coherent(shot_echoes(scene, shot, still, chosen))
    motion = shot_motion(scene, shot, echoes, spec.motion)
    options = options_of(scene.processing, shot_prior(scene, shot, spec.name, beams))
    return _fit(motion, reference, chosen, spec, options)[0]


def options_of(processing: Processing, prior: MediumPrior | None = None) -> Options:
    """Return what of the estimation the scene chooses, apart from the estimator; without ``prior`` least squares."""
    default: Harmonic = "least_squares" if prior is None else "medium_prior"
    chosen = default if processing.harmonic in (None, "medium_prior") else processing.harmonic
    return Options(processing.background_order, chosen, processing.process_noise, prior)


def shot_prior(scene: Scene, shot: Shot, estimator: str, beams: BeamWidths | None) -> MediumPrior | None:
    """Return the prior that stands for the shot's harmonics in the fit; None where scene or estimator take none."""
    if not spec_of(estimator).takes_prior:
        return None
    if scene.processing.harmonic == "least_squares" or scene.processing.process_noise:
        return None
    return shot_media(scene, shot, beams)


def shot_media(scene: Scene, shot: Shot, beams: BeamWidths | None) -> MediumPrior | None:
    """Return what media make of the shot's tonebursts, whatever the fit takes of it; None where there is no prior."""
    length_s, excitation, medium = shot.timeline.burst_length_s, scene.excitation, scene.medium
    sphere = None if scene.sphere is None else RigidSphere(scene.sphere.radius_m, scene.sphere.density_kg_per_m3)
    pushed = sphere or beams
    if pushed is None or excitation is None or not length_s or scene.without_prior is not None:
        return None
    if medium is None:
        return medium_prior(pushed, excitation.burst_rate_hz, length_s)
    known = KnownMedium(medium.shear_modulus_pa, medium.shear_viscosity_pa_s)
    return medium_prior(pushed, excitation.burst_rate_hz, length_s, known, medium.density_kg_per_m3)


def _estimate_shot(
    scene: Scene,
    shot: Shot,
    records: GatedRecords,
    found: GateStatistics,
    still: GatedRecords | None,
    true_m: FloatArray | None,
    spec: EstimatorSpec,
    averaging: tuple[Averaging | None, ...],
    known: Known,
    beams: BeamWidths | None,
    unlikely: float,
    complete: bool,
) -> ShotResult:
    chosen, media = select(scene, shot), shot_media(scene, shot, beams)
    options = options_of(scene.processing, shot_prior(scene, shot, spec.name, beams))
    full_scale = found.at_full_scale(records.code_limits)
    echoes = shot_echoes(scene, shot, records, chosen, found)
    recorded = records.valid[chosen.window]
    damaged = np.zeros_like(recorded) if records.damaged is None else records.damaged[chosen.window]
    reference = None if still is None else coherent(shot_echoes(scene, shot, still, chosen))
    motion = shot_motion(scene, shot, echoes, spec.motion)
    fit, largest_step = _fit(motion, reference, chosen, spec, options)
    # They tell of bench, motion and medium, not of the estimator: the one with the least noise looks.
    steady = _steady(scene, shot, echoes, motion if spec.motion is coherent else None)
    moved = steady if steady is None or reference is None else relative_to(steady, reference)
    if fit.medium is None and media is not None and moved is not None:
        # Too few pulses say nothing of the medium.
        with suppress(ValueError):
            fit = with_unresolved(fit, moved, media, spec.name, chosen.driven_hz, options)
    clipped = int((full_scale[chosen.window] & recorded & chosen.used).sum())
    if scene.medium is None:
        averaging = tuple(averaging_seen(fit, index, each) for index, each in enumerate(averaging))
    here = replace(
        known,
        subtracts_jitter=reference is not None,
        gate_edge=gate_edge_relative(echoes, spec.gate_window),
        rounding_m=() if moved is None else rounding_m(echoes, records.volts_per_code, moved, fit),
        carrier_relative=off_carrier(motion, steady) if spec.by_carrier else 0.0,
    )
    drift = _drift(steady, chosen, options) if reference is None else None
    line = None if moved is None else _line(moved, chosen, options)
    tracked = motion if reference is None else relative_to(motion, reference)
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
        lateral_offset_m=shot.lateral_offset_m,
        axial_offset_m=shot.axial_offset_m,
        estimates=estimates_of(fit, here, averaging, true_m),
        warnings=(
            *(_missing_warnings(recorded, damaged) if complete else ()),
            *_damaged_warnings(damaged),
            *_record_warnings(recorded, recorded & chosen.used & ~echoes.valid, clipped),
            *_fit_warnings(fit, largest_step),
            *_medium_warnings(fit, unlikely),
            *_setting_warnings(scene, echoes.pulse_time_s, reference),
            *_drift_warnings(fit, drift),
            *_line_warnings(line, shot.tracking_train.rate_hz, unlikely),
        ),
        complete=complete,
        motion=_stored_motion(tracked, fit, chosen, options.background_order, spec.name),
    )


def _stored_motion(
    motion: Motion, fit: HarmonicFit, chosen: Selection, background_order: int, tracked_by: str
) -> ShotMotion:
    """Return ``motion`` with the uncertainty of each pulse and the model that ``fit`` makes of it."""
    kept, model_m = motion.valid, np.full(motion.valid.size, np.nan)
    variance_m2 = np.where(kept, motion.variance_m2, np.nan)
    if motion.valid.size <= MOST_MODELLED:
        with suppress(ValueError):
            fitted = fitted_motion(motion, fit, chosen.driven_hz, background_order)
            model_m[kept] = fitted.displacement_m
            left_m2 = float(np.mean((motion.displacement_m[kept] - fitted.displacement_m) ** 2))
            left_m2 = max(left_m2, float(fit.residual_rms_m) ** 2)
            # Echoes state their own noise; trigger jitter and motion across the gate show in the residual alone.
            variance_m2 *= max(1.0, left_m2 / float(np.mean(variance_m2[kept])))
    return ShotMotion(
        pulse=np.flatnonzero(chosen.window),
        time_s=motion.time_s,
        displacement_m=motion.displacement_m,
        uncertainty_m=np.sqrt(variance_m2),
        model_m=model_m,
        tracked_by=tracked_by,
    )


@dataclass(frozen=True, slots=True)
class FittedMotion:
    """Displacement that a fit makes of a motion's valid pulses, ``displacement_m`` (pulse,).

    ``matrix`` (pulse, unknown): the columns of the harmonics, the background and the others that are there as well.
    """

    displacement_m: FloatArray
    matrix: FloatArray


def fitted_motion(
    motion: Motion, fit: HarmonicFit | Sequence[Estimate], also_hz: FloatArray, background_order: int
) -> FittedMotion:
    """Return harmonics as ``fit`` has them, with background and ``also_hz`` fitted to what they leave of ``motion``.

    Raises ``ValueError`` where the pulses cannot resolve the frequencies.
    """
    if isinstance(fit, HarmonicFit):
        frequency_hz, amplitude_m, phase_rad = fit.frequency_hz, fit.amplitude_m, fit.phase_rad
    else:
        columns = [[each.frequency_hz, each.amplitude_m, each.phase_rad] for each in fit]
        frequency_hz, amplitude_m, phase_rad = np.array(columns, dtype=np.float64).reshape(-1, 3).T
    matrix = linear_model(
        motion.time_s, motion.valid, frequency_hz, background_order=background_order, also_hz=also_hz
    ).matrix
    wanted, rest = np.split(matrix, [2 * frequency_hz.size], axis=1)
    state = (amplitude_m[:, None] * np.stack([np.cos(phase_rad), np.sin(phase_rad)], axis=1)).ravel()
    harmonics_m = wanted @ state
    left_m = motion.displacement_m[motion.valid] - harmonics_m
    return FittedMotion(harmonics_m + rest @ np.linalg.lstsq(rest, left_m, rcond=None)[0], matrix)


def shot_model(scene: Scene, shot: Shot, with_driven: bool = True) -> tuple[FloatArray, LinearModel]:
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
    scene: Scene, shot: Shot, records: GatedRecords, chosen: Selection, found: GateStatistics | None = None
) -> EchoGate:
    """Return the echoes of the ``chosen`` pulses, of the ``records``' samples: see ``samples_needed``.

    What the records hold in the gate is ``found`` where it is not given.
    """
    # here: a forecast, which shares the model of a shot, opens no file
    from hpe_rig.store import ShotRecords

    found = found or gate_statistics(records)
    window = chosen.window
    valid = records.valid[window] & chosen.used
    sound = valid & ~found.at_full_scale(records.code_limits)[window]
    gate = slice(records.margin[0], records.shape[1] - records.margin[1])
    first = int(np.argmax(window))
    pulses = slice(first, first + valid.size)
    echoes = EchoGate(
        volts=centred_volts(records.block(pulses), records.volts_per_code, sound, gate)
        if isinstance(records, ShotRecords)
        else CodedVolts(records, pulses, sound, found),
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


def samples_needed(scene: Scene, shot: Shot) -> slice:
    """Return the samples of each record in which motion is found: the gate, or all of them where the gate follows."""
    return slice(0, shot.capture.record_samples) if scene.processing.follow_gate else shot.gate


def margin_needed(scene: Scene, shot: Shot) -> int:
    """Return how many samples around ``samples_needed`` the gate's edges need; a gate that follows has them inside."""
    rate_hz, carrier_hz = shot.capture.sample_rate_hz, scene.tracking.carrier_hz
    return 0 if scene.processing.follow_gate else margin_samples(rate_hz, carrier_hz)


def shot_motion(scene: Scene, shot: Shot, echoes: EchoGate, motion: Callable[[EchoGate], Motion]) -> Motion:
    """Return what ``motion`` finds in ``echoes``, in a gate that follows them where the scene says so."""
    if not scene.processing.follow_gate:
        return motion(echoes)
    cut, cuts = follow(echoes, shot.gate)
    return added(motion(cut), cuts)


def _fit(
    motion: Motion,
    reference: Motion | None,
    chosen: Selection,
    spec: EstimatorSpec,
    options: Options,
) -> tuple[HarmonicFit, float]:
    """Return the fit and the largest step between pulses in quarter wavelengths."""
    frequencies = chosen.wanted_hz, spec.name, chosen.driven_hz
    if reference is not None:
        motion = relative_to(motion, reference)
    return fit_motion(motion, *frequencies, options), float(motion.largest_step)


def averaging_seen(fit: HarmonicFit, index: int, predicted: Averaging | None) -> Averaging | None:
    """Return the averaging of one frequency in the media that the motion leaves likely; else as ``predicted``.

    What speckle does is to make the tracking beam wider or narrower: how much that matters is the root mean square over
    those media, widths of the force included.
    """
    if predicted is None or fit.medium is None:
        return predicted
    ratio = 1 / complex(fit.medium.peak_over_tracked[index])
    relative, phase_rad = np.sqrt(np.diag(fit.medium.peak_covariance[index])).tolist()
    speckle, turned = (predicted.area_spread * fit.medium.steepness[index]).tolist()
    factor = (1 - predicted.loss_scale * (1 - abs(ratio))) * predicted.offset_factor
    seen = replace(
        predicted,
        factor=factor,
        phase_rad=float(np.angle(ratio)) + predicted.offset_phase_rad,
        speckle_relative=speckle,
        speckle_phase_rad=turned,
        factor_uncertainty=factor * relative,
        phase_uncertainty_rad=phase_rad,
        shared_relative=float(fit.medium.shared[index, 0]),
        shared_phase_rad2=float(fit.medium.shared[index, 1]),
    )
    return with_second_order_speckle(seen)


def _steady(scene: Scene, shot: Shot, echoes: EchoGate, motion: Motion | None) -> Motion | None:
    """Return the coherent motion, ``motion`` where it is known; None where single echoes drown in noise."""
    if motion is not None:
        return motion
    try:
        return shot_motion(scene, shot, echoes, coherent)
    except ValueError:
        return None


def off_carrier(motion: Motion | None, by_echo: Motion | None) -> float:
    """Return by how much a ``motion`` divided by the carrier is off the same divided ``by_echo``, relative; at most 1.

    The echo's mean frequency in a gate is not the carrier: speckle draws it.
    """
    if motion is None or by_echo is None:
        return 0.0
    both = motion.valid & by_echo.valid
    one, other = (each.displacement_m[both] - each.displacement_m[both].mean() for each in (motion, by_echo))
    energy = float(other @ other)
    return min(abs(float(one @ other) / energy - 1), 1.0) if energy > 0 else 0.0


def _drift(motion: Motion | None, chosen: Selection, options: Options) -> Drift | None:
    if motion is None:
        return None
    order = options.background_order
    try:
        return drift_between_halves(
            motion, chosen.wanted_hz, also_hz=chosen.driven_hz, background_order=order, prior=options.prior
        )
    except ValueError:
        # Half the pulses cannot resolve the frequencies: nothing can be said about a change.
        return None


def _line(motion: Motion, chosen: Selection, options: Options) -> Line | None:
    order = options.background_order
    try:
        return residual_line(
            motion, chosen.wanted_hz, also_hz=chosen.driven_hz, background_order=order, prior=options.prior
        )
    except ValueError:
        return None


def _missing_warnings(recorded: BoolArray, damaged: BoolArray) -> Iterator[str]:
    """Yield what missing records of a complete shot mean; where a run stopped they never came."""
    missing = int((~recorded & ~damaged).sum())
    if missing and not recorded[-1] and not damaged[-1]:
        yield (
            "the last record is missing: were the first triggers lost instead of the last, every phase is off by "
            "whole pulse periods"
        )
    if missing:
        yield (
            f"{missing} of {recorded.size} records are missing: triggers were lost or came while the digitizer was busy"
        )


def _damaged_warnings(damaged: BoolArray) -> Iterator[str]:
    if damaged.any():
        yield f"{int(damaged.sum())} of {damaged.size} records {DAMAGED}"


def _record_warnings(recorded: BoolArray, unlike: BoolArray, clipped: int) -> Iterator[str]:
    left_out = int(unlike.sum())
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
    # White innovations are noise, however large: trigger jitter is no part of what echoes state, and where the motion
    # changes over the gate they state more.
    if found is not None and abs(float(found.autocorrelation)) > found.autocorrelation_tolerance:
        yield (
            f"the Kalman filter's innovations follow from each other (correlation {float(found.autocorrelation):+.2f} "
            "from pulse to pulse, 0 is best): motion that the model lacks; raise processing.background_order or "
            "process_noise"
        )


def _medium_warnings(fit: HarmonicFit, unlikely: float) -> Iterator[str]:
    if fit.medium is not None and float(fit.medium.significance) < unlikely:
        yield (
            f"the medium lies outside the ensemble that the prior knows (significance {fit.medium.significance:.1g}): "
            "reflections, layers, another force than [beams] and the burst length say, another medium than [medium], "
            "or motion that is not periodic; check these and the start-up (processing.window_start_s), or compare with "
            'processing.harmonic = "least_squares"'
        )


def _setting_warnings(scene: Scene, pulse_time_s: FloatArray, reference: Motion | None) -> Iterator[str]:
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


def _line_warnings(line: Line | None, pulse_rate_hz: float, unlikely: float) -> Iterator[str]:
    if line is not None and line.probability < unlikely:
        yield (
            f"the residual has a line of {line.amplitude_m * 1e9:.3g} nm at {line.frequency_hz:.4g} Hz: motion that is "
            "not fitted, there or at a frequency that folds onto it, such as "
            f"{pulse_rate_hz - line.frequency_hz:.5g} Hz; more of it may fold onto the wanted frequencies unseen: "
            "compare another tracking.pulse_rate_hz, or fit it along (processing.frequencies_hz)"
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
