"""Vibrations of stored runs at all lateral offsets and depths, with their covariance.

Shots at the same offset are averaged, weighted by the inverse of their covariance. Omissions are reported in words.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import groupby

import numpy as np

from hpe_rig.arrays import FloatArray
from hpe_rig.moduli.scene_geometry import (
    GateAtDepth,
    detected_part,
    gates_at_depths,
    has_strongest_push,
    vibration_at,
    with_shared_noise,
)
from hpe_rig.moduli.vibration_model import Vibration
from hpe_rig.plan import (
    Plan,
    Shot,
    depth_gates,
    off_axis_offsets_m,
    plans_at_offsets,
    shots_with_gate,
    with_gate,
    without_shared_echoes,
)
from hpe_rig.prediction import beam_widths
from hpe_rig.processing import HarmonicFit, assign_pulses, displacement_residual_m, estimate_controls, shot_fit
from hpe_rig.scene import Scene
from hpe_rig.store import StoredRun

MIN_PULSES = 30
"""Pulses below which the correlation of residuals is not estimated."""


@dataclass(frozen=True, slots=True)
class Source:
    """A stored run: its name, scene, plan and records."""

    name: str
    scene: Scene
    plan: Plan
    stored: StoredRun


def vibrations_of(
    sources: Sequence[Source], estimator: str | None = None, common_amplitude: bool = True
) -> tuple[list[Vibration], list[str]]:
    """Return the vibrations of all runs at every lateral offset and depth, and a list of omitted data in words.

    ``estimator`` defaults to each scene's own. ``common_amplitude``: the force was equally strong at all lateral
    offsets, else gains are unknown. Gates over depth that share echoes with another are omitted.
    """
    vibrations, omitted = list[Vibration](), list[str]()
    for source in sources:
        suffix = "" if len(sources) == 1 else f" ({source.name})"
        for scene, plan in plans_at_offsets(source.scene, source.plan):
            position = f"{source.name}, {scene.tracking.lateral_offset_m:g}"
            depths = [
                replace(vibration, position=position)
                for gate in gates_at_depths(scene, plan, omitted)
                for vibration in _detected_vibration(gate, source, estimator, _label(gate) + suffix, omitted)
            ]
            # Noise common to all depths of a record does not average out.
            correlation = _residual_correlation(scene, plan, source.stored) if len(depths) > 1 else 0.0
            vibrations += with_shared_noise(depths, correlation)
    return vibrations if common_amplitude else [vibration.with_free_gain() for vibration in vibrations], omitted


def _label(gate: GateAtDepth) -> str:
    """Return the lateral offset of a gate and, off the focus, its depth, in words."""
    offset = f"{gate.scene.tracking.lateral_offset_m * 1e3:g} mm"
    return f"{offset}, {gate.axial_m * 1e3:+.3g} mm deep" if abs(gate.axial_m) > 1e-9 else offset


def _detected_vibration(
    gate: GateAtDepth, source: Source, estimator: str | None, label: str, omitted: list[str]
) -> list[Vibration]:
    """Return the vibration in one gate at its detected frequencies, if there are any; add the others to ``omitted``."""
    estimator = estimator or gate.scene.processing.estimator
    fits = list(_fits(gate, source, estimator, label, omitted))
    if not fits:
        omitted.append(f"{label}: no shot can be estimated")
        return []
    return detected_part(_mean_vibration(gate, label, fits, estimator), omitted)


def _fits(gate: GateAtDepth, source: Source, estimator: str, label: str, omitted: list[str]) -> Iterator[HarmonicFit]:
    """Yield the harmonic fit of every usable shot of a gate; add the other shots, with the reason, to ``omitted``.

    Usable shots are complete, trusted, not marked bad, of the strongest force and the first burst length, and their
    first pulse is known.
    """
    shots_by_reason: dict[str, list[int]] = {}
    beams = beam_widths(gate.scene, estimator, off_axis_offsets_m(source.plan))
    controls = estimate_controls(gate.scene, gate.plan, source.stored, estimator)
    for shot in gate.plan.shots:
        if shot.is_control:
            continue
        # The fit is that of the scene's window, the first.
        control, *_ = controls.motions.get(shot.index, (None,))
        reason = _unusable(shot, source.stored, gate.plan)
        if shot.index in controls.failures:
            reason = reason or f"without a control ({controls.failures[shot.index]})"
        if not reason:
            # A shot that cannot be estimated is reported like an incomplete one.
            try:
                yield shot_fit(gate.scene, shot, source.stored, estimator, beams, control)
                continue
            except ValueError as error:
                reason = str(error)
        shots_by_reason.setdefault(reason, []).append(shot.index + 1)
    omitted += [f"{label}: {_shots_text(numbers)}, {reason}" for reason, numbers in shots_by_reason.items()]


def _shots_text(numbers: Sequence[int]) -> str:
    """Return increasing ``numbers`` of shots in words.

    >>> _shots_text([1, 2, 3, 5, 7, 8])
    'shots 1 to 3, 5, 7 to 8'
    """
    # Numbers of one series have the same difference to their position in the list.
    series = [list(group) for _, group in groupby(enumerate(numbers), lambda item: item[1] - item[0])]
    texts = [f"{pairs[0][1]} to {pairs[-1][1]}" if len(pairs) > 1 else f"{pairs[0][1]}" for pairs in series]
    return f"shot{'s' if len(numbers) > 1 else ''} {', '.join(texts)}"


def _unusable(shot: Shot, stored: StoredRun, plan: Plan) -> str:
    """Return why a shot is not used, "" if it is."""
    if not stored.shot_complete[shot.index]:
        return "incomplete"
    if reason := stored.untrusted.get(shot.index):
        return f"untrusted: {reason}"
    if mark := stored.marks.get(shot.index):
        return mark
    if not has_strongest_push(shot, plan):
        return "of a weaker force or another burst length"
    # The covariance of a fit does not contain a common shift of all its phases.
    is_unknown = max(assign_pulses(shot, stored).shifts) > 0
    return "triggers were lost, and it is unknown which pulse came first" if is_unknown else ""


def _mean_vibration(gate: GateAtDepth, label: str, fits: Sequence[HarmonicFit], estimator: str) -> Vibration:
    """Return the vibration in ``gate`` as the mean of its shots' ``fits``, weighted by their inverse covariances."""
    frequency_hz = fits[0].frequency_hz
    # The wanted harmonics are the first states: A cos(phase), A sin(phase), frequency by frequency.
    wanted_states = slice(2 * frequency_hz.size)
    information = [np.linalg.inv(fit.state_covariance[wanted_states, wanted_states]) for fit in fits]
    covariance = np.linalg.inv(np.sum(information, axis=0))
    weighted = [weight @ fit.state[wanted_states] for weight, fit in zip(information, fits, strict=True)]
    # The maximum-likelihood mean of estimates with different covariances.
    state = covariance @ np.sum(weighted, axis=0)
    measured = frequency_hz, state[0::2] + 1j * state[1::2], (covariance + covariance.T) / 2
    return vibration_at(gate.scene, estimator, label, measured, gate.axial_m)


def _residual_correlation(scene: Scene, plan: Plan, stored: StoredRun) -> float:
    """Return the mean correlation of the displacement noise between gates, from the first complete good shot.

    Trigger jitter, for example, is common to all gates. The gates share no echoes.
    """
    gates = without_shared_echoes(depth_gates(scene, plan.shots[0]), scene.gate_depth_m)
    sound_speed_m_per_s = scene.acquisition.sound_speed_m_per_s
    for index, shot in enumerate(plan.shots):
        if not stored.shot_complete[shot.index] or shot.index in stored.marks:
            continue
        # Residuals of the same shot in every gate, pulse by pulse.
        residuals = (
            displacement_residual_m(
                with_gate(scene, gate), shots_with_gate(plan, gate, sound_speed_m_per_s).shots[index], stored
            )
            for gate in gates
        )
        return _mean_correlation(np.array([residual for residual in residuals if residual is not None]))
    return 0.0


def _mean_correlation(rows: FloatArray) -> float:
    """Return the mean correlation of pairs of ``rows`` (gate, pulse), 0 for fewer than two rows or few pulses."""
    finite = np.isfinite(rows).all(axis=0)
    if len(rows) < 2 or finite.sum() < MIN_PULSES:
        return 0.0
    # Each pair once: the triangle above the diagonal.
    matrix = np.asarray(np.corrcoef(rows[:, finite]))
    return float(matrix[np.triu_indices(len(rows), 1)].mean())
