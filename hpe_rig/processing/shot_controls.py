"""Motion in the controls of a stored run: the same shots with tonebursts off."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from hpe_rig.plan import Plan, Shot, control_shots, select
from hpe_rig.processing.control import ControlMotion, control_motions
from hpe_rig.processing.estimators import spec_of
from hpe_rig.processing.harmonics.harmonic_fit import HarmonicFit
from hpe_rig.processing.shot_fitting import HarmonicFitter, options_of
from hpe_rig.processing.shot_tracking import read_shot, window_motion
from hpe_rig.scene import Scene

if TYPE_CHECKING:
    from hpe_rig.store import StoredRun


@dataclass(frozen=True, slots=True)
class Controls:
    """Controls of the shots of a plan, by index of the shot that they belong to.

    ``motions``: the control's motion in each processing window. ``failures``: why there is no control to subtract.
    """

    motions: Mapping[int, tuple[ControlMotion, ...]] = field(default_factory=dict)
    failures: Mapping[int, str] = field(default_factory=dict)


def estimate_controls(scene: Scene, plan: Plan, stored: StoredRun, estimator: str) -> Controls:
    """Return the motion in each control of ``plan`` (a shot without tonebursts), in each processing window.

    All shots of ``plan`` have one position of the tracking transducer.
    """
    fits, failures = dict[int, list[HarmonicFit]](), dict[int, str]()
    for index, control in control_shots(plan).items():
        try:
            fits[index] = list(_window_fits(scene, control, stored, estimator))
        except ValueError as error:
            failures[index] = f"shot {control.index + 1}: {error}"
    if not fits:
        return Controls(failures=failures)
    # The scatter is that between controls, so it is estimated window by window; then the motions are sorted by control.
    windows = [
        control_motions({index: of_windows[number] for index, of_windows in fits.items()})
        for number in range(len(scene.windows))
    ]
    return Controls({index: tuple(window[index] for window in windows) for index in fits}, failures)


def _window_fits(scene: Scene, control: Shot, stored: StoredRun, estimator: str) -> Iterator[HarmonicFit]:
    """Yield the harmonics of a control in each processing window; raise ``ValueError`` if it cannot be used."""
    reason = stored.marks.get(control.index) or stored.untrusted.get(control.index)
    if reason or not stored.shot_complete[control.index]:
        raise ValueError(reason or "incomplete")
    records, spec = read_shot(scene, control, stored), spec_of(estimator)
    for window in scene.windows:
        selection = select(window, control)
        motion = window_motion(window, control, records, selection, spec.motion)
        # Tonebursts are off: no further harmonics of theirs are fitted, which would add noise.
        fitter = HarmonicFitter(tuple(selection.wanted_hz.tolist()), spec.name, (), options_of(window.processing))
        yield fitter(motion.tracked)
