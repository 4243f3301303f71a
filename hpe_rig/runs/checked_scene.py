"""Check of a scene before it is measured: plan, conflicts and predictions. No instrument is opened."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import Any

from hpe_rig.bench import BenchFile, twin_of
from hpe_rig.extensions import ESTIMATORS, MEDIA, origin
from hpe_rig.measurement import BenchSource, Setup, prepare
from hpe_rig.plan import CheckResult, Shot
from hpe_rig.scene import BUILT_IN_ESTIMATORS, Scene, SceneSource

MAX_REFUSED_PULSES = 100_000
"""Pulses in a shot up to which a scene that is refused has predictions."""
MAX_COLUMNS = 114
"""Width of the drawing of a plan, unless the terminal is narrower."""


@dataclass(frozen=True, slots=True)
class CheckedScene:
    """Setup and predictions of a measurement; its ``str`` is the output of ``hpe-rig check``."""

    setup: Setup
    foreseen: tuple[str, ...]
    """Lines of text that predict the result."""

    @property
    def text(self) -> str:
        """Plan, failed checks and predictions, for a terminal of ordinary width."""
        return self.in_words()

    def in_words(self, columns: int | None = None, verbose: bool = False) -> str:
        """Return the text with a drawing of at most ``columns``; ``verbose`` adds the checks that passed."""
        from hpe_rig.plan import plan_text

        title, plan = self.setup.scene.scene.title, self.setup.plan
        drawing = plan_text(title, plan, self.findings, min(columns or MAX_COLUMNS, MAX_COLUMNS), verbose)
        return "\n".join([drawing, "", *self.foreseen])

    @property
    def findings(self) -> tuple[CheckResult, ...]:
        """Finding of each check, also of those that passed."""
        return self.setup.findings

    @property
    def refused(self) -> bool:
        """Whether a conflict forbids the measurement."""
        return any(finding.level == "refused" for finding in self.findings)

    def as_dict(self) -> dict[str, Any]:
        """Return verdict, plan, findings and predictions as plain values for JSON."""
        plan = self.setup.plan
        shot = plan.shots[0]
        return {
            "scene": self.setup.scene.name,
            "title": self.setup.scene.scene.title,
            "can_be_measured": not self.refused,
            "instruments": list(plan.roles),
            "shots": len(plan.shots),
            "pulse_rate_hz": shot.tracking_train.rate_hz,
            "pulses": shot.tracking_train.count,
            "duration_s": plan.duration_s,
            "record_bytes": plan.record_bytes,
            "findings": [asdict(finding) for finding in self.findings],
            "predictions": list(self.foreseen),
        }

    def __str__(self) -> str:
        return self.text

    def _repr_html_(self) -> str:
        """Return HTML for a notebook: timeline, conflicts, warnings and predictions."""
        from html import escape

        setup = self.setup
        count = len(setup.plan.shots)
        state = f"{count} shot{'' if count == 1 else 's'}; {'refused' if self.refused else 'may be measured'}"
        plan = plan_html(setup.scene.scene.title, state, setup.plan.shots[0], self.findings)
        # The lines contain columns: <pre> keeps them aligned.
        foreseen = escape("\n".join(self.foreseen))
        return f"{plan}\n<pre>{foreseen}</pre>"


def check(
    scene: SceneSource,
    bench: BenchSource = None,
    target: str | None = None,
    changes: Mapping[str, Any] | None = None,
) -> CheckedScene:
    """Return the plan of ``scene`` with every conflict and the expected bias and jitter; no instrument is opened.

    ``target`` is a wanted uncertainty such as "20nm": the text then states settings that reach it. ``changes``: values
    that replace those of the scene, by their path. Raises ``SettingsError`` as ``measure``.

    >>> checked = check("bovine-muscle")
    >>> checked.refused
    False
    >>> print(checked)
    """
    from hpe_rig.scene import length_m

    setup = prepare(scene, bench, refuse=False, changes=changes)
    target_m = None if target is None else length_m(target, "--target")
    return CheckedScene(setup, tuple(_predictions(setup, target_m)))


def _predictions(setup: Setup, target_m: float | None) -> Iterator[str]:
    """Yield the predictions: detection, aliasing, calibration, beam averaging, jitter."""
    from hpe_rig import prediction

    # The predictions are those of the first point of a sweep.
    first, shot = setup.scene.scene.points[0], setup.plan.shots[0]
    scene, bench = first.scene, setup.bench.bench.with_(first.bench)
    yield from _extensions_used(scene, bench)
    if not scene.wanted_frequencies_hz:
        yield "prediction: omitted, no vibration frequency is wanted"
        return
    if any(finding.check == "fit size" for finding in setup.findings):
        yield "prediction: omitted, the fit is larger than memory"
        return
    if any(finding.level == "refused" for finding in setup.findings) and shot.capture.record_count > MAX_REFUSED_PULSES:
        pulses = f"more than {MAX_REFUSED_PULSES} pulses in a shot"
        yield f"prediction: omitted, the scene is refused and has {pulses}, which may take minutes"
        return
    yield from prediction.detection_text(scene, bench.simulated, shot)
    yield from prediction.aliasing_text(scene, shot, bench.simulated)
    yield from prediction.calibration_text(scene, bench)
    yield from prediction.extrapolation_text(scene, bench)
    yield from prediction.averaging_text(scene)
    yield from prediction.prediction_text(scene, shot, target_m, bench.simulated)
    yield from prediction.time_base_text(scene, bench, shot)
    if len(scene.places) > 1:
        from hpe_rig.moduli import moduli_text

        yield from moduli_text(scene, setup.plan, bench.simulated)


def _extensions_used(scene: Scene, bench: BenchFile) -> Iterator[str]:
    """Yield a line with estimator and medium of other packages, if the scene uses any, with package and version."""
    twin, estimator = twin_of(scene) if bench.simulated else None, scene.processing.estimator
    extensions = [] if estimator in BUILT_IN_ESTIMATORS else [origin(ESTIMATORS, estimator)]
    if twin is not None and twin.foreign_medium is not None:
        extensions.append(origin(MEDIA, twin.foreign_medium))
    if extensions:
        yield f"of other packages: {', '.join(extensions)}"


def plan_html(title: str, state: str, shot: Shot, findings: Iterable[CheckResult]) -> str:
    """Return the HTML of a plan: ``title``, ``state``, the timing of ``shot`` and the checks that did not pass."""
    from hpe_rig.plan import timing_pictures
    from hpe_rig.result import image, symbols

    findings = list(findings)
    failures = [finding for finding in findings if finding.level != "passed"]
    lines = [
        f"<p><b>{symbols(title)}</b><br>{symbols(state)}</p>",
        "".join(image(figure) for figure in timing_pictures(shot)),
    ]
    lines.append(f"<p>{len(findings) - len(failures)} of {len(findings)} checks of the plan passed.</p>")
    return "\n".join([*lines, *(f"<p><b>{finding.level.upper()}</b> {symbols(finding)}</p>" for finding in failures)])
