"""Statements of a scene for an inversion: push, gates over depth, and uncertainties of a tracked position."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hpe_rig.arrays import ComplexArray, FloatArray
from hpe_rig.moduli.vibration_model import Push, Vibration
from hpe_rig.plan import DepthGate, Plan, Shot, depth_gates, shots_with_gate, with_gate, without_shared_echoes
from hpe_rig.prediction import beam_widths, push_force, tracked_region_spread, tracking_gate
from hpe_rig.result import DETECTED
from hpe_rig.scene import Mistake, Scene, SettingsError

GAIN_UNCERTAINTY = 0.005
"""Relative, between lateral offsets: echo strength does not enter, and the effect of the gate's depth is as small."""
PHASE_UNCERTAINTY_RAD = 0.002
WIDTH_UNCERTAINTY = 0.05
"""Relative, of the widths of the force, unless stated."""
MAX_DEPTH_SIGMAS = 2.0
"""Distance of a gate from the focus, in sigmas of the force, beyond which the tail of the force is unknown."""


@dataclass(frozen=True, slots=True)
class GateAtDepth:
    """Scene and plan with one gate, and the gate's distance from the focus."""

    scene: Scene
    plan: Plan
    axial_m: float


def push_of(scenes: Sequence[Scene], width_uncertainty: float = WIDTH_UNCERTAINTY) -> Push:
    """Return the force of the tonebursts that all ``scenes`` share.

    ``width_uncertainty``: relative, of its widths. Raises ``SettingsError`` if a scene states none or they differ.
    """
    mistakes = [mistake for scene in scenes for mistake in _push_mistakes(scene)]
    # All mistakes are reported at once, so scenes with mistakes contribute their push as well if they state one.
    pushes = [
        Push(
            force=push_force(scene),
            burst_rate_hz=excitation.burst_rate_hz,
            burst_length_s=excitation.burst_length_s[0],
            density_kg_per_m3=scene.medium.density_kg_per_m3 if scene.medium else 1000.0,
            width_uncertainty=(width_uncertainty, width_uncertainty),
        )
        for scene in scenes
        if (excitation := scene.excitation) is not None and scene.beams is not None
    ]
    if any(push != pushes[0] for push in pushes):
        what = "the runs differ in widths, burst rate, burst length or density of the medium"
        mistakes.append(Mistake("excitation", what, "runs with the same push, or a fit of each run"))
    if mistakes:
        raise SettingsError("the scene" if len(scenes) == 1 else "the scenes", list(dict.fromkeys(mistakes)))
    return pushes[0]


def _push_mistakes(scene: Scene) -> Iterator[Mistake]:
    """Yield the reasons why the moduli cannot be fitted to a run of ``scene``."""
    beams = scene.beams
    if scene.excitation is None:
        yield Mistake("excitation", "nothing pushes, so no motion depends on the medium", "a run with tonebursts")
    if scene.sphere is not None:
        what = "a rigid sphere moves, and moduli are fitted to the motion of the medium itself"
        # Nothing else needs to be stated for a run that cannot be fitted.
        yield Mistake("sphere", what, "a run of the medium without a sphere")
        return
    if beams is None:
        yield Mistake("beams", "the widths of force and tracking beam are not known", "[beams]")
        return
    # An aperture or a scan gives the shape of the force, so that the declared widths do not have to be round.
    has_own_force = beams.transducer_diameter_m or beams.excitation_scan
    if not has_own_force and not np.isclose(*beams.excitation_width_m[:2]):
        what = f"a force of {beams.excitation_width_m[0]:g} m by {beams.excitation_width_m[1]:g} m is not round"
        yield Mistake("beams.excitation_width_m", what, "equal widths across")


def gates_at_depths(scene: Scene, plan: Plan, omitted: list[str]) -> Iterator[GateAtDepth]:
    """Yield every gate over depth that the moduli can be fitted to, or the scene's own gate if it has no others.

    Gates must be near the focus and share no echoes. Omissions are added to ``omitted`` in words.
    """
    gates, focus_m = depth_gates(scene, plan.shots[0]) if plan.shots else (), focus_depth_m(scene)
    if not gates:
        yield GateAtDepth(scene, plan, scene.gate_depth_m - focus_m)
        return
    label = f"{scene.tracking.lateral_offset_m * 1e3:g} mm"
    assert scene.beams is not None  # noqa: S101 (push_of requires them)
    max_distance_m = MAX_DEPTH_SIGMAS * scene.beams.excitation_width_m[2]
    near = [gate for gate in gates if abs(gate.depth_m - focus_m) <= max_distance_m]
    separate = without_shared_echoes(near, scene.gate_depth_m)
    if far := [gate for gate in gates if gate not in near]:
        omitted.append(f"{label}: gates at {_depths_mm(far)}, more than {max_distance_m * 1e3:.3g} mm from the focus")
    if overlapping := [gate for gate in near if gate not in separate]:
        omitted.append(f"{label}: gates at {_depths_mm(overlapping)}, which share echoes with those used")
    for gate in separate:
        gate_plan = shots_with_gate(plan, gate, scene.acquisition.sound_speed_m_per_s)
        yield GateAtDepth(with_gate(scene, gate), gate_plan, gate.depth_m - focus_m)


def _depths_mm(gates: Sequence[DepthGate]) -> str:
    return ", ".join(f"{gate.depth_m * 1e3:.4g}" for gate in gates) + " mm"


def focus_depth_m(scene: Scene) -> float:
    """Return the depth of the tracking focus; that of the gate if none is declared."""
    declared = scene.beams.focus_depth_m if scene.beams else None
    return scene.acquisition.gate_depth_m if declared is None else declared


def vibration_at(
    scene: Scene,
    estimator: str,
    label: str,
    measured: tuple[FloatArray, ComplexArray, FloatArray],
    axial_m: float = 0.0,
) -> Vibration:
    """Return the vibration measured in the gate of ``scene``, with the uncertainties of the tracked position.

    ``measured``: frequencies (frequency,), Hz; phasors (frequency,), m; and their covariance, m^2, of real and
    imaginary parts (2 * frequency, 2 * frequency). ``axial_m``: the gate's distance from the focus. The scene has
    [beams].
    """
    beams = beam_widths(scene, estimator)
    assert beams is not None  # noqa: S101 (push_of requires them)
    area_spread, lateral_spread_m, axial_spread_m = tracked_region_spread(scene, estimator)
    mean_depth_m, depth_sd_m = tracking_gate(scene, estimator).depth_moments(axial_m)
    return Vibration(
        label,
        *measured,
        lateral_m=scene.tracking.lateral_offset_m,
        # A gate at the focus is symmetric about it: neither shift nor first-order effect of depth.
        axial_m=axial_m + mean_depth_m if axial_m else 0.0,
        axial_uncertainty_m=axial_spread_m if axial_m else 0.0,
        travel_s=axial_m / scene.acquisition.sound_speed_m_per_s,
        tracking_m2=(beams.tracking_variance_m2, depth_sd_m**2),
        lateral_uncertainty_m=lateral_spread_m,
        stage_uncertainty_m=scene.tracking.offset_uncertainty_m,
        gain_uncertainty=GAIN_UNCERTAINTY,
        phase_uncertainty_rad=PHASE_UNCERTAINTY_RAD,
        area_uncertainty=area_spread,
    )


def detected_part(vibration: Vibration, omitted: list[str]) -> list[Vibration]:
    """Return the vibration at the frequencies that exceed its noise, if there are any; add the others to ``omitted``.

    The threshold is ``DETECTED`` times the larger noise of the two quadratures.
    """
    # Variances of A cos(phase) and A sin(phase), frequency by frequency.
    sigma_m = np.sqrt(np.diag(vibration.covariance_m2).reshape(-1, 2).max(axis=1))
    is_detected = np.asarray(np.abs(vibration.phasor_m) > DETECTED * sigma_m)
    if not is_detected.all():
        weak = ", ".join(f"{hz:g}" for hz in vibration.frequency_hz[~is_detected])
        omitted.append(f"{vibration.label}: {weak} Hz, less than {DETECTED:g} times its uncertainty")
    return [vibration.at_frequencies(is_detected)] if is_detected.any() else []


def with_shared_noise(depths: Sequence[Vibration], correlation: float) -> list[Vibration]:
    """Return the vibrations of one lateral offset with the noise variance that their common noise requires.

    The mean of n values with pairwise correlation c has 1 + (n - 1) c times the variance of n independent ones. Trigger
    jitter moves all depths of a record alike.
    """
    variance_factor = 1 + (len(depths) - 1) * max(correlation, 0.0)
    return [replace(vibration, covariance_m2=vibration.covariance_m2 * variance_factor) for vibration in depths]


def has_strongest_push(shot: Shot, plan: Plan) -> bool:
    """Return whether ``shot`` has the strongest force of ``plan`` and its first burst length."""
    force = max(candidate.force_fraction or 0.0 for candidate in plan.shots)
    same_length = shot.timeline.burst_length_s == plan.shots[0].timeline.burst_length_s
    return same_length and (shot.force_fraction or 0.0) == force
