"""HTML of a run and of a checked scene, as a notebook shows them: what it is, its timing, what the checks say."""

from __future__ import annotations

from collections.abc import Iterable

from hpe_rig.plan import CheckResult, Shot, timing
from hpe_rig.result import image, symbols


def plan_html(title: str, state: str, shot: Shot, findings: Iterable[CheckResult]) -> str:
    """Return HTML that needs nothing else: ``title``, ``state``, the timing of ``shot``, what did not pass."""
    listed = list(findings)
    noticed = [each for each in listed if each.level != "passed"]
    lines = [f"<p><b>{symbols(title)}</b><br>{symbols(state)}</p>", "".join(image(each) for each in timing(shot))]
    lines.append(f"<p>{len(listed) - len(noticed)} of {len(listed)} checks of the plan passed.</p>")
    return "\n".join([*lines, *(f"<p><b>{each.level.upper()}</b> {symbols(each)}</p>" for each in noticed)])
