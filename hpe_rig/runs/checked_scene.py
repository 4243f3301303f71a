"""Check: what can be said of a measurement before it is made. Opens nothing."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from hpe_rig.bench import BenchFile, twin_of
from hpe_rig.extensions import ESTIMATORS, MEDIA, origin
from hpe_rig.measurement import BenchSource, Setup, bench_path, prepare
from hpe_rig.plan import CheckResult, Shot
from hpe_rig.scene import BUILT_IN_ESTIMATORS, Scene, SceneSource

WIDEST = 114
"""Columns of the drawing of a plan where nobody wants fewer."""


@dataclass(frozen=True, slots=True)
class CheckedScene:
    """What is known of a measurement before it is made; ``str`` of it is what ``hpe-rig check`` prints."""

    setup: Setup
    foreseen: tuple[str, ...]
    """What can be said of the result beforehand, line by line."""

    @property
    def text(self) -> str:
        """Everything but the checks that passed, for a terminal of ordinary width."""
        return self.in_words()

    def in_words(self, columns: int | None = None, verbose: bool = False) -> str:
        """Return what is known as text with a drawing of at most ``columns``; ``verbose``: with every passed check."""
        from hpe_rig.plan import plan_text

        title, plan = self.setup.scene.scene.title, self.setup.plan
        shown = plan_text(title, plan, self.findings, min(columns or WIDEST, WIDEST), verbose)
        return "\n".join([shown, "", *self.foreseen])

    @property
    def findings(self) -> tuple[CheckResult, ...]:
        """What each check found, passed ones included."""
        return self.setup.findings

    @property
    def refused(self) -> bool:
        """Whether a conflict forbids the measurement."""
        return any(finding.level == "refused" for finding in self.findings)

    def __str__(self) -> str:
        return self.text

    def _repr_html_(self) -> str:
        """Return HTML for a notebook: the timeline as a figure, what fails or warns, what is foreseen."""
        from html import escape

        setup = self.setup
        count = len(setup.plan.shots)
        state = f"{count} shot{'' if count == 1 else 's'}; {'refused' if self.refused else 'may be measured'}"
        shown = plan_html(setup.scene.scene.title, state, setup.plan.shots[0], self.findings)
        # Columns among these lines stand under one another only as they are.
        foreseen = escape("\n".join(self.foreseen))
        return f"{shown}\n<pre>{foreseen}</pre>"


def check(scene: SceneSource, bench: BenchSource = None, target: str | None = None) -> CheckedScene:
    """Return the plan of ``scene`` in words with every conflict, expected bias and jitter; opens nothing.

    ``target``: a wanted uncertainty such as "20nm", to say what reaches it. Raises ``SettingsError`` as ``measure``.

    >>> checked = check("bovine-muscle")
    >>> checked.refused
    False
    >>> print(checked)
    """
    from hpe_rig.scene import length_m

    setup = prepare(scene, bench_path(bench), refuse=False)
    target_m = None if target is None else length_m(target, "--target")
    return CheckedScene(setup, tuple(_foreseen(setup, target_m)))


def _foreseen(setup: Setup, target_m: float | None) -> Iterator[str]:
    """Yield what can be said of the result beforehand: detection, aliasing, calibration, averaging, jitter."""
    from hpe_rig import prediction

    first, shot = setup.scene.scene.points[0], setup.plan.shots[0]
    scene, bench = first.scene, setup.bench.bench.with_(first.bench)
    yield from _of_others(scene, bench)
    if not scene.wanted_frequencies_hz:
        yield "prediction: left out, no vibration frequency is wanted"
        return
    if any(finding.check == "fit size" for finding in setup.findings):
        yield "prediction: left out, the fit is larger than memory"
        return
    yield from prediction.detection_text(scene, bench.simulated, shot)
    yield from prediction.aliasing_text(scene, shot, bench.simulated)
    yield from prediction.calibration_text(scene, bench)
    yield from prediction.extrapolation_text(scene, bench)
    yield from prediction.averaging_text(scene)
    yield from prediction.prediction_text(scene, shot, target_m, bench.simulated)
    if len(scene.places) > 1:
        from hpe_rig.moduli import moduli_text

        yield from moduli_text(scene, setup.plan, bench.simulated)


def _of_others(scene: Scene, bench: BenchFile) -> Iterator[str]:
    """Yield which estimator and medium other packages bring to the measurement, with these and their versions."""
    twin, estimator = twin_of(scene) if bench.simulated else None, scene.processing.estimator
    brought = [] if estimator in BUILT_IN_ESTIMATORS else [origin(ESTIMATORS, estimator)]
    if twin is not None and twin.foreign_medium is not None:
        brought.append(origin(MEDIA, twin.foreign_medium))
    if brought:
        yield f"of other packages: {', '.join(brought)}"


def plan_html(title: str, state: str, shot: Shot, findings: Iterable[CheckResult]) -> str:
    """Return a plan as a notebook shows it: ``title``, ``state``, the timing of ``shot``, what did not pass."""
    from hpe_rig.plan import timing
    from hpe_rig.result import image, symbols

    listed = list(findings)
    noticed = [each for each in listed if each.level != "passed"]
    lines = [f"<p><b>{symbols(title)}</b><br>{symbols(state)}</p>", "".join(image(each) for each in timing(shot))]
    lines.append(f"<p>{len(listed) - len(noticed)} of {len(listed)} checks of the plan passed.</p>")
    return "\n".join([*lines, *(f"<p><b>{each.level.upper()}</b> {symbols(each)}</p>" for each in noticed)])
