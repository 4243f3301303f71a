"""Timeline of a plan, in words and as a small drawing, for ``hpe-rig check``."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from hpe_rig.plan.checks.check_result import CheckResult
from hpe_rig.plan.interference import admissible_delays_s, forbidden_window_s
from hpe_rig.plan.shots import Plan, Shot

WIDTH = 96


def plan_text(title: str, plan: Plan, found: Sequence[CheckResult]) -> str:
    """Return the plan of a measurement as text: drawing, table, what is omitted, checks."""
    shot = max(plan.shots, key=lambda item: item.timeline.burst_length_s)
    lines = [title, "", *_drawing(shot), "", *_table(plan, shot), "", "omitted:"]
    lines += [f"  {item.what}: {item.why}" for item in plan.omitted] or ["  nothing"]
    lines += ["", "checks:"]
    lines += [f"  {_MARK[finding.level]} {finding}" for finding in sorted(found, key=lambda item: _ORDER[item.level])]
    return "\n".join(lines)


_MARK = {"passed": "ok     ", "warning": "WARNING", "refused": "REFUSED"}
_ORDER = {"refused": 0, "warning": 1, "passed": 2}


def _drawing(shot: Shot) -> Iterator[str]:
    """Draw the first pulse periods after the first toneburst; one column is the same time in every row."""
    line, period_s = shot.timeline, 1 / shot.tracking_train.rate_hz
    start_s, span_s = float(line.burst_onset_s[0]) if line.burst_onset_s.size else 0.0, 2 * period_s
    pulses = [time_s for time_s in line.pulse_onset_s[:8] if time_s < start_s + span_s]
    bursts = [time_s for time_s in line.burst_onset_s[:8] if time_s < start_s + span_s]

    def row(name: str, mark: str, intervals: Sequence[tuple[float, float]]) -> str:
        columns = [" "] * WIDTH
        for low, high in intervals:
            begin, end = (min(max(float(time_s) - start_s, -span_s), 2 * span_s) / span_s for time_s in (low, high))
            first = math.floor(begin * WIDTH)
            last = max(first, math.ceil(end * WIDTH) - 1)
            for column in range(max(0, first), min(WIDTH, last + 1)):
                columns[column] = mark
        return f"{name:>14} |{''.join(columns)}|"

    def after(times_s: Sequence[float], low_s: float, high_s: float) -> list[tuple[float, float]]:
        return [(time_s + low_s, time_s + high_s) for time_s in times_s]

    yield f"{'':14}  0{f'{span_s * 1e6:g} us':>{WIDTH - 1}}"
    if bursts:
        yield row("toneburst", "#", after(bursts, 0, line.burst_length_s))
        yield row("its echoes", "~", after(bursts, 0, line.burst_length_s + line.gate_offset_s[1]))
    yield row("tracking pulse", "|", after(pulses, 0, line.pulse_length_s))
    yield row("record", ".", after(pulses, *line.record_offset_s))
    yield row("gate", "=", after(pulses, *line.gate_offset_s))


def _table(plan: Plan, shot: Shot) -> Iterator[str]:
    train, capture, burst_train = shot.tracking_train, shot.capture, shot.burst_train
    rows: list[tuple[str, str]] = [("instruments", ", ".join(plan.roles)), ("shots", f"{len(plan.shots)}")]
    if burst_train is not None:
        lengths = sorted({item.timeline.burst_length_s for item in plan.shots})
        burst = f"{burst_train.count} at {burst_train.rate_hz:g} Hz, "
        rows.append(("tonebursts", burst + ", ".join(f"{length * 1e6:g} us" for length in lengths)))
        start_s, end_s = forbidden_window_s(shot)
        forbidden = f"from {-start_s * 1e6:.4g} us before a toneburst to {end_s * 1e6:.4g} us after its onset"
        rows.append(("no pulse", forbidden))
        free = admissible_delays_s(shot)
        words = " or ".join(f"{low * 1e6:.4g} to {high * 1e6:.4g} us" for low, high in free) or "none"
        rows.append(("admissible t_d", f"{words}, plus multiples of {1e6 / train.rate_hz:g} us"))
    rows += [
        ("tracking", f"{train.count} pulses at {train.rate_hz:g} Hz from t_d = {train.delay_s * 1e6:g} us"),
        ("record", f"{capture.record_samples} samples, {capture.trigger_delay_samples} after the trigger"),
        ("gate", f"samples {shot.gate.start} to {shot.gate.stop}"),
        ("duration", f"{plan.duration_s:.3g} s without programming"),
        ("run file", f"{plan.record_bytes / 1e6:.3g} MB of records"),
    ]
    return (f"{name:>14}  {text}" for name, text in rows)
