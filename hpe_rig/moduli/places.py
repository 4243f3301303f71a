"""Vibrations at the places of a run, with their covariance and what is not known of each place.

Shots at the same place are averaged, weighted by their covariance. What cannot serve is left out, and said so.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hpe_rig.arrays import BoolArray, ComplexArray, FloatArray
from hpe_rig.moduli.vibration_model import Push, Vibration
from hpe_rig.plan import (
    DepthGate,
    Plan,
    Shot,
    apart,
    depth_gates,
    offsets_beside_m,
    places_of,
    shots_with_gate,
    with_gate,
)
from hpe_rig.prediction import beam_widths, depth_in_gate, force_of, tracked_spread
from hpe_rig.processing import HarmonicFit, residual_m, shot_fit
from hpe_rig.result import DETECTED
from hpe_rig.scene import Mistake, Scene, SettingsError
from hpe_rig.store import StoredRun

GAIN_UNCERTAINTY = 0.005
"""Relative, of one place against another: echo strength does not enter, what the gate's depth does is as small."""
PHASE_UNCERTAINTY_RAD = 0.002
WIDTH_UNCERTAINTY = 0.05
"""Relative, of the widths of the force, unless told otherwise."""
APERTURE_SHAPE = 0.005
"""Relative, of each amplitude: by how much two sums of Gaussians for one aperture differ, to 4 mm off the axis."""
LEAST_PULSES = 30
"""Pulses without which no correlation of residuals is worth its name."""
DEEPEST_SIGMAS = 2.0
"""Sigmas of the force along the beam, from the focus, beyond which its tail may be any, and a gate does not serve."""


@dataclass(frozen=True, slots=True)
class Source:
    """A run to take vibrations from: its name, scene, plan and records."""

    name: str
    scene: Scene
    plan: Plan
    stored: StoredRun


def push_of(scenes: Sequence[Scene], width_uncertainty: float = WIDTH_UNCERTAINTY) -> Push:
    """Return the force of the tonebursts; raise ``SettingsError`` where ``scenes`` do not say it, or unlike ones."""
    mistakes, pushes = list[Mistake](), list[Push]()
    for scene in scenes:
        excitation, beams = scene.excitation, scene.beams
        if excitation is None:
            what = "nothing pushes, so nothing tells of the medium"
            mistakes.append(Mistake("excitation", what, "a run with tonebursts"))
        if scene.sphere is not None:
            what = "a rigid sphere moves, and moduli are fitted to the medium's own motion"
            mistakes.append(Mistake("sphere", what, "a run of the medium without a sphere"))
        elif beams is None:
            mistakes.append(Mistake("beams", "the widths of force and tracking beam are not known", "[beams]"))
        elif not (beams.transducer_diameter_m or beams.excitation_scan) and not np.isclose(
            *beams.excitation_width_m[:2]
        ):
            what = f"a force of {beams.excitation_width_m[0]:g} m by {beams.excitation_width_m[1]:g} m is not round"
            mistakes.append(Mistake("beams.excitation_width_m", what, "equal widths across"))
        if excitation is not None and beams is not None:
            density = scene.medium.density_kg_per_m3 if scene.medium else 1000.0
            burst = excitation.burst_rate_hz, excitation.burst_length_s[0]
            force, widths = force_of(scene), (width_uncertainty, width_uncertainty)
            shape = APERTURE_SHAPE if force.unsure else 0.0
            pushes.append(Push(force, *burst, density, widths, shape_relative=shape))
    if any(push != pushes[0] for push in pushes):
        what = "runs push with unlike widths, burst rates or lengths, or in media of unlike density"
        mistakes.append(Mistake("excitation", what, "runs of one push, or each on its own"))
    if mistakes:
        raise SettingsError("the scene" if len(scenes) == 1 else "the scenes", list(dict.fromkeys(mistakes)))
    return pushes[0]


def vibrations_of(sources: Sequence[Source], estimator: str | None = None) -> tuple[list[Vibration], list[str]]:
    """Return the vibration at every place and depth of all runs, and in words what was left out.

    ``estimator`` in place of each scene's own. Of gates over depth those that share no echo.
    """
    found, omitted = list[Vibration](), list[str]()
    for source in sources:
        places_m = offsets_beside_m(source.plan)
        for scene, plan in places_of(source.scene, source.plan):
            place, own = f"{source.name}, {scene.tracking.lateral_offset_m:g}", list[Vibration]()
            for there, shots, axial_m in depths_of(scene, plan, omitted):
                label = _label(there, axial_m, source, len(sources))
                chosen = estimator or scene.processing.estimator
                fits = list(_fits(there, shots, source.stored, chosen, places_m, label, omitted))
                if not fits:
                    omitted.append(f"{label}: no shot there can be estimated")
                    continue
                vibration = replace(_vibration(there, label, fits, chosen, axial_m), place=place)
                kept = detected(vibration)
                if not kept.all():
                    lost = ", ".join(f"{hz:g}" for hz in vibration.frequency_hz[~kept])
                    omitted.append(f"{label}: {lost} Hz, less than {DETECTED:g} times its uncertainty")
                if kept.any():
                    own.append(vibration.only(kept))
            shared = _shared(scene, plan, source.stored) if len(own) > 1 else 0.0
            found += with_shared_noise(own, shared)
    return found, omitted


def depths_of(scene: Scene, plan: Plan, omitted: list[str]) -> Iterator[tuple[Scene, Plan, float]]:
    """Yield scene, plan and distance from the focus of every gate that serves; the scene's own where it has no more."""
    gates = depth_gates(scene, plan.shots[0]) if plan.shots else ()
    if not gates:
        yield scene, plan, scene.gate_depth_m - _focus_m(scene)
        return
    focus_m, where = _focus_m(scene), f"{scene.tracking.lateral_offset_m * 1e3:g} mm"
    assert scene.beams is not None  # noqa: S101 (push_of has asked for them)
    reach_m = DEEPEST_SIGMAS * scene.beams.excitation_width_m[2]
    inside = [gate for gate in gates if abs(gate.depth_m - focus_m) <= reach_m]
    kept = apart(inside, scene.gate_depth_m)
    if far := [gate for gate in gates if gate not in inside]:
        omitted.append(f"{where}: gates at {_depths_mm(far)}, more than {reach_m * 1e3:.3g} mm from the focus")
    if shared := [gate for gate in inside if gate not in kept]:
        omitted.append(f"{where}: gates at {_depths_mm(shared)}, which share echoes with those used")
    for gate in kept:
        there = shots_with_gate(plan, gate, scene.acquisition.sound_speed_m_per_s)
        yield with_gate(scene, gate), there, gate.depth_m - focus_m


def _depths_mm(gates: Sequence[DepthGate]) -> str:
    return ", ".join(f"{gate.depth_m * 1e3:.4g}" for gate in gates) + " mm"


def with_shared_noise(depths: Sequence[Vibration], correlation: float) -> list[Vibration]:
    """Return the vibrations at the ``depths`` of a place, noisier by what all of them share.

    The mean of n equally noisy values of which any two correlate by c is 1 + (n - 1) c times as noisy, in variance, as
    that of independent ones: trigger jitter moves all depths of a record alike. Nothing changes where it is none.
    """
    noisier = 1 + (len(depths) - 1) * max(correlation, 0.0)
    return [replace(one, covariance_m2=one.covariance_m2 * noisier) for one in depths]


def _shared(scene: Scene, plan: Plan, stored: StoredRun) -> float:
    """Return the mean correlation of the residuals of gates that share no echo, of the first shot that has them."""
    gates = apart(depth_gates(scene, plan.shots[0]), scene.gate_depth_m)
    for index, shot in enumerate(plan.shots):
        if not stored.shot_complete[shot.index]:
            continue
        each = [shots_with_gate(plan, gate, scene.acquisition.sound_speed_m_per_s).shots[index] for gate in gates]
        rest = [residual_m(with_gate(scene, gate), one, stored) for gate, one in zip(gates, each, strict=True)]
        rows = np.array([row for row in rest if row is not None])
        both = np.isfinite(rows).all(axis=0)
        if len(rows) < 2 or both.sum() < LEAST_PULSES:
            return 0.0
        matrix = np.corrcoef(rows[:, both])
        return float(matrix[np.triu_indices(len(rows), 1)].mean())
    return 0.0


def _fits(
    scene: Scene,
    plan: Plan,
    stored: StoredRun,
    estimator: str,
    places_m: tuple[float, ...],
    label: str,
    omitted: list[str],
) -> Iterator[HarmonicFit]:
    """Yield the fit of every shot that can serve: whole, trusted, of the strongest force and the first burst length."""
    beams = beam_widths(scene, estimator, places_m)
    for shot in plan.shots:
        why = _unfit(shot, stored, plan)
        if not why:
            try:
                yield shot_fit(scene, shot, stored, estimator, beams)
                continue
            except ValueError as error:
                why = str(error)
        omitted.append(f"{label}: shot {shot.index + 1}, {why}")


def _unfit(shot: Shot, stored: StoredRun, plan: Plan) -> str:
    """Return why a shot does not serve, "" where it does."""
    if not stored.shot_complete[shot.index]:
        return "incomplete"
    if why := stored.untrusted.get(shot.index):
        return f"untrusted: {why}"
    return "" if strongest(shot, plan) else "of a weaker force or another burst length"


def strongest(shot: Shot, plan: Plan) -> bool:
    """Return whether ``shot`` has the strongest force of ``plan`` and its first burst length: only such serve."""
    force = max(each.force_fraction or 0.0 for each in plan.shots)
    same = shot.timeline.burst_length_s == plan.shots[0].timeline.burst_length_s
    return same and (shot.force_fraction or 0.0) == force


def _vibration(scene: Scene, label: str, fits: Sequence[HarmonicFit], estimator: str, axial_m: float) -> Vibration:
    frequency_hz = fits[0].frequency_hz
    information = [np.linalg.inv(_states(each, frequency_hz.size)[1]) for each in fits]
    covariance = np.linalg.inv(np.sum(information, axis=0))
    weighted = [own @ _states(each, frequency_hz.size)[0] for own, each in zip(information, fits, strict=True)]
    state = covariance @ np.sum(weighted, axis=0)
    phasor_m = state[0::2] + 1j * state[1::2]
    return vibration_at(scene, estimator, label, frequency_hz, phasor_m, (covariance + covariance.T) / 2, axial_m)


def vibration_at(
    scene: Scene,
    estimator: str,
    label: str,
    frequency_hz: FloatArray,
    phasor_m: ComplexArray,
    covariance_m2: FloatArray,
    axial_m: float | None = None,
) -> Vibration:
    """Return the vibration at the place of ``scene`` with what is known of that place; the scene has [beams].

    ``axial_m``: from the focus, where it is not the scene's.
    """
    axial_m = scene.gate_depth_m - _focus_m(scene) if axial_m is None else axial_m
    beams = beam_widths(scene, estimator)
    assert beams is not None  # noqa: S101 (push_of has asked for them)
    seen = beams.tracking_width_m[0] ** 2 / 2
    area, middle_m, deep_m = tracked_spread(scene, estimator)
    shift_m, spread_m = depth_in_gate(scene, estimator, axial_m)
    return Vibration(
        label=label,
        frequency_hz=frequency_hz,
        phasor_m=phasor_m,
        covariance_m2=covariance_m2,
        lateral_m=scene.tracking.lateral_offset_m,
        axial_m=axial_m + shift_m if axial_m else 0.0,
        axial_uncertainty_m=deep_m if axial_m else 0.0,
        travel_s=axial_m / scene.acquisition.sound_speed_m_per_s,
        tracking_m2=(seen, spread_m**2),
        lateral_uncertainty_m=middle_m,
        place_uncertainty_m=scene.tracking.offset_uncertainty_m,
        gain_uncertainty=GAIN_UNCERTAINTY,
        phase_uncertainty_rad=PHASE_UNCERTAINTY_RAD,
        area_uncertainty=area,
    )


def _focus_m(scene: Scene) -> float:
    declared = scene.beams.focus_depth_m if scene.beams else None
    return scene.acquisition.gate_depth_m if declared is None else declared


def _states(fit: HarmonicFit, frequencies: int) -> tuple[FloatArray, FloatArray]:
    """Return the wanted harmonics' states A cos(phase), A sin(phase) in turn, and their covariance."""
    return fit.state[: 2 * frequencies], fit.state_covariance[: 2 * frequencies, : 2 * frequencies]


def detected(vibration: Vibration) -> BoolArray:
    """Return which frequencies stand out of their noise (frequency,), the larger of the two quadratures'."""
    sigma_m = np.sqrt(np.diag(vibration.covariance_m2).reshape(-1, 2).max(axis=1))
    return np.asarray(np.abs(vibration.phasor_m) > DETECTED * sigma_m)


def _label(scene: Scene, axial_m: float, source: Source, sources: int) -> str:
    where = f"{scene.tracking.lateral_offset_m * 1e3:g} mm"
    if abs(axial_m) > 1e-9:
        where += f", {axial_m * 1e3:+.3g} mm deep"
    return where if sources == 1 else f"{where} ({source.name})"
