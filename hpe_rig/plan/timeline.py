"""Timeline of a plan, in words and as a small drawing, for ``hpe-rig check``."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from hpe_rig.plan.checks.check_result import CheckResult, in_us
from hpe_rig.plan.interference import admissible_delays_s, disturbed_pulses, forbidden_window_s
from hpe_rig.plan.shots import Plan, Shot
from hpe_rig.scene import engineering

NAME_COLUMNS = 18
"""Columns of names and borders in the drawing."""
MAX_DRAWN = 8
"""Pulses and tonebursts that are drawn."""


def plan_text(title: str, plan: Plan, results: Sequence[CheckResult], columns: int = 114, verbose: bool = False) -> str:
    """Return the plan of a measurement as text: verdict, conflicts, drawing, table, omissions.

    ``columns`` is the width of the drawing; ``verbose`` also lists the checks that passed.
    """
    shot = max(plan.shots, key=lambda item: item.timeline.burst_length_s)
    # A default specimen is always mentioned, although its check passes.
    shown = [item for item in results if item.level != "passed" or item.check == "simulated specimen"]
    by_level = sorted(shown, key=lambda item: _ORDER[item.level])
    passed = [item for item in results if item.level == "passed"]
    is_refused = any(item.check == "interference" and item.level == "refused" for item in results)
    lines = [title, "", verdict(results), *(f"  {_MARK[item.level]} {item}" for item in by_level)]
    lines += ["", *_drawing(shot, max(columns - NAME_COLUMNS, 20)), "", *_table(plan, shot, is_refused), "", "omitted:"]
    lines += [f"  {what}: {why}" for what, why in plan.omitted] or ["  nothing"]
    lines += ["", f"checks: {len(passed)} of {len(results)} passed{'' if verbose else ' (--verbose lists them)'}"]
    return "\n".join([*lines, *(f"  {_MARK[item.level]} {item}" for item in passed if verbose and item not in shown)])


def verdict(results: Sequence[CheckResult]) -> str:
    """Return in one line whether a plan can be measured."""
    refused, warned = (sum(item.level == level for item in results) for level in ("refused", "warning"))
    warnings = f"{warned} warning{'s' if warned > 1 else ''}"
    if refused:
        and_warnings = f" and {warnings}" if warned else ""
        return f"CANNOT BE MEASURED: {refused} conflict{'s' if refused > 1 else ''}{and_warnings}"
    return f"CAN BE MEASURED, with {warnings}" if warned else "CAN BE MEASURED"


_MARK = {"passed": "ok     ", "warning": "WARNING", "refused": "REFUSED"}
_ORDER = {"refused": 0, "warning": 1, "passed": 2}


def _drawing(shot: Shot, width: int) -> Iterator[str]:
    """Draw the first two pulse periods after the first toneburst, with one time axis for all rows."""
    line, period_s = shot.timeline, 1 / shot.tracking_train.rate_hz
    start_s, span_s = float(line.burst_onset_s[0]) if line.burst_onset_s.size else 0.0, 2 * period_s
    pulses = [time_s for time_s in line.pulse_onset_s[:MAX_DRAWN] if time_s < start_s + span_s]
    bursts = [time_s for time_s in line.burst_onset_s[:MAX_DRAWN] if time_s < start_s + span_s]

    def row(name: str, mark: str, intervals: Sequence[tuple[float, float]]) -> str:
        columns = [" "] * width
        for low, high in intervals:
            low_ratio, high_ratio = (
                min(max(float(time_s) - start_s, -span_s), 2 * span_s) / span_s for time_s in (low, high)
            )
            first = math.floor(low_ratio * width)
            last = max(first, math.ceil(high_ratio * width) - 1)
            for column in range(max(0, first), min(width, last + 1)):
                columns[column] = mark
        return f"{name:>14} |{''.join(columns)}|"

    def after(times_s: Sequence[float], low_s: float, high_s: float) -> list[tuple[float, float]]:
        return [(time_s + low_s, time_s + high_s) for time_s in times_s]

    yield f"{'':14}  0{in_us(span_s):>{width - 1}}"
    if bursts:
        yield row("toneburst", "#", after(bursts, 0, line.burst_length_s))
        yield row("its echoes", "~", after(bursts, 0, line.burst_length_s + line.gate_offset_s[1] + line.push_delay_s))
    yield row("tracking pulse", "|", after(pulses, 0, line.pulse_length_s))
    yield row("record", ".", after(pulses, *line.record_offset_s))
    yield row("gate", "=", after(pulses, *line.gate_offset_s))


def _table(plan: Plan, shot: Shot, is_refused: bool) -> Iterator[str]:
    """Yield the values of the plan by name; ``is_refused``: disturbed pulses are not allowed."""
    train, capture, burst_train = shot.tracking_train, shot.capture, shot.burst_train
    controls = sum(item.is_control for item in plan.shots)
    shots = f"{len(plan.shots)}" + (f", {controls} of them controls with tonebursts off" if controls else "")
    rows: list[tuple[str, str]] = [("instruments", ", ".join(plan.roles)), ("shots", shots)]
    if burst_train is not None:
        lengths = sorted({item.timeline.burst_length_s for item in plan.shots})
        burst = f"{burst_train.count} at {burst_train.rate_hz:g} Hz, "
        rows.append(("tonebursts", burst + ", ".join(map(in_us, lengths))))
        start_s, end_s = forbidden_window_s(shot)
        forbidden = f"from {in_us(-start_s)} before a toneburst to {in_us(end_s)} after its onset"
        rows.append(("no pulse", forbidden))
        free = admissible_delays_s(shot)
        words = " or ".join(f"{low * 1e6:.4g} to {high * 1e6:.4g} us" for low, high in free)
        more = f", plus multiples of {in_us(1 / train.rate_hz)}"
        disturbed = int(disturbed_pulses(shot).sum())
        none = f"at any delay some pulses are disturbed, at this one {disturbed} of {train.count}"
        none = f"none: {none}" if is_refused else f"all: {none}, which are skipped"
        rows.append(("admissible t_d", f"{words}{more}" if free else none))
    rows += [
        ("tracking", f"{train.count} pulses at {train.rate_hz:g} Hz from t_d = {in_us(train.delay_s)}"),
        ("record", f"{capture.record_samples} samples, {capture.trigger_delay_samples} after the trigger"),
        ("gate", f"samples {shot.gate.start} to {shot.gate.stop}"),
        ("duration", f"{engineering(plan.duration_s, 's', 3)} without programming"),
        ("run file", f"{engineering(plan.record_bytes, 'B', 3)} of records"),
    ]
    return (f"{name:>14}  {text}" for name, text in rows)
