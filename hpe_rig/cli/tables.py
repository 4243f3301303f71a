"""Result as a table on the terminal: nm, degrees, Hz."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import groupby

from rich.console import Console
from rich.table import Table

from hpe_rig.result import (
    Component,
    Estimate,
    GateResult,
    Provenance,
    RepeatMean,
    Result,
    ShotResult,
    rich_table,
    shot_warnings,
)

TABLE_WIDTH = 110
LEAST_S = 0.005
"""Shorter stages would show as 0.00."""
LEAST_SHARE = 0.01
"""Share of the variance below which a source of uncertainty is not named."""


def print_result(result: Result) -> None:
    """Print means over repeats, the table of each shot, the warnings, what was omitted, and the run time by stage."""
    console = wide_console()
    console.print(f"\n{result.title}", style="bold")
    console.print(f"{result.origin}, {result.run_file}, estimator {result.estimator}")
    if result.provenance.started:
        console.print(f"{times_text(result.provenance)}, {result.provenance.host}")
    for name, note in result.notes.items():
        console.print(f"{name}: {note}")
    if result.simulated_specimen:
        console.print(f"simulated specimen: {result.simulated_specimen}")
    for _, means in groupby(result.means, key=lambda mean: mean.shots):
        group = list(means)
        # A title of the table's own would be broken at the table's width.
        console.print(f"\n{_mean_title(group[0])}", style="bold")
        console.print(_mean_table(group))
    for shot in result.shots:
        console.print(f"\n{_shot_title(shot)}", style="bold")
        console.print(_shot_table(shot))
        if shot.estimates:
            console.print(_budget_line(shot))
    for _, gates in groupby(result.profile, key=lambda gate: gate.shot.lateral_offset_m):
        at_place = sorted(gates, key=lambda gate: (gate.shot.shot, gate.shot.window_length_s or 0.0, gate.depth_m))
        for _, of_shot in groupby(at_place, key=lambda gate: (gate.shot.shot, gate.shot.window_length_s)):
            group_of_gates = list(of_shot)
            console.print(f"\n{_profile_title(group_of_gates)}", style="bold")
            console.print(_profile_table(group_of_gates))
    console.print(f"\nphase: {result.phase_reference}\n{_legend(result)}")
    for warning in (*result.warnings, *shot_warnings(result.shots)):
        console.print(f"WARNING {warning}", style="bold")
    if result.omitted:
        console.print("omitted: " + "; ".join(f"{what} ({why})" for what, why in result.omitted))
    total_s = sum(result.run_time_s.values())
    stages = ", ".join(f"{name} {seconds:.2f}" for name, seconds in result.run_time_s.items() if seconds >= LEAST_S)
    console.print(f"run time: {total_s:.2f} s ({stages})")


def times_text(provenance: Provenance) -> str:
    """Return in words when a run was: 2026-03-05 14:02:11+01:00 to 14:10:07."""
    started, ended = provenance.started.replace("T", " "), provenance.ended.replace("T", " ")
    day, _, time = ended.partition(" ")
    until = time[:8] if ended[:10] == started[:10] and ended[19:] == started[19:] else f"{day} {time}".strip()
    return f"{started} to {until}" if ended else started


def wide_console() -> Console:
    """Return a console of at least `TABLE_WIDTH` columns: a pipe has no width, and 80 would squeeze a table."""
    return Console(soft_wrap=True, highlight=False, markup=False, width=max(TABLE_WIDTH, Console().width))


def _shot_table(shot: ShotResult) -> Table:
    known = any(estimate.true_amplitude_m is not None for estimate in shot.estimates)
    corrected = any(estimate.headline.corrected for estimate in shot.estimates)
    headers = ["f\nHz"]
    headers += ["peak\nnm", "u\nnm", "phase\ndeg", "u\ndeg"] if corrected else []
    headers += ["tracked\nnm", "u\nnm", "phase\ndeg", "u\ndeg", "SNR\ndB"]
    headers += ["true peak\nnm", "error\n%", "error\ndeg"] if known else []
    rows = [_row(estimate, known, corrected) for estimate in shot.estimates]
    return rich_table(headers, rows, words=0)


def _profile_title(gates: Sequence[GateResult]) -> str:
    hz = _strongest_hz(gates)
    return ", ".join([f"OVER DEPTH at {hz:g} Hz, shot {gates[0].shot.shot + 1}", *_settings(gates[0].shot)])


def _profile_table(gates: Sequence[GateResult]) -> Table:
    """Return a row a gate, of the frequency that moves most in any; the result file has the others."""
    hz, corrected = _strongest_hz(gates), any(gate.shot.estimates[0].headline.corrected for gate in gates)
    headers = ["depth\nmm", "gate\nmm", "pulses\n"]
    headers += ["peak\nnm", "u\nnm", "phase\ndeg", "u\ndeg"] if corrected else []
    headers += ["tracked\nnm", "u\nnm", "phase\ndeg", "u\ndeg", "SNR\ndB"]
    rows = []
    for gate in gates:
        [estimate] = [each for each in gate.shot.estimates if each.frequency_hz == hz]
        where = [f"{gate.depth_m * 1e3:.4g}", f"{gate.length_m * 1e3:.3g}", str(gate.shot.pulses_used)]
        rows.append([*where, *_row(estimate, False, corrected)[1:]])
    return rich_table(headers, rows, words=0)


def _strongest_hz(gates: Sequence[GateResult]) -> float:
    every = [estimate for gate in gates for estimate in gate.shot.estimates]
    return max(every, key=lambda estimate: estimate.amplitude_m).frequency_hz


def _mean_table(means: Sequence[RepeatMean]) -> Table:
    known = any(mean.true_amplitude_m is not None for mean in means)
    name = "peak" if means[0].corrected else "tracked"
    headers = ["f\nHz", f"{name}\nnm", "u\nnm", "phase\ndeg", "u\ndeg", "sd\nnm", "sd\ndeg", "chi-square\n", "p\n"]
    headers += ["true peak\nnm", "error\n%", "error\ndeg"] if known else []
    return rich_table(headers, [_mean_row(mean, known) for mean in means], words=0)


def _mean_title(mean: RepeatMean) -> str:
    shots = [shot + 1 for shot in mean.shots]
    in_a_row = shots[-1] - shots[0] == len(shots) - 1
    numbers = f"{shots[0]} to {shots[-1]}" if in_a_row else ", ".join(map(str, shots))
    return ", ".join([f"MEAN of {len(shots)} repeats, shots {numbers}", *_settings(mean)])


def _mean_row(mean: RepeatMean, known: bool) -> list[str]:
    row = [f"{mean.frequency_hz:g}", *_polar(mean.amplitude_m, mean.amplitude_uncertainty_m)]
    row += _angle(mean.phase_rad, mean.phase_uncertainty_rad)
    row += [_figure(mean.amplitude_sd_m * 1e9), _figure(math.degrees(mean.phase_sd_rad))]
    row += [f"{mean.chi_square:.1f} of {mean.degrees_of_freedom}", f"{mean.probability:.2g}"]
    if known and mean.true_amplitude_m and mean.true_phase_rad is not None:
        error_rad = math.remainder(mean.phase_rad - mean.true_phase_rad, 2 * math.pi)
        row += [f"{mean.true_amplitude_m * 1e9:.4g}", f"{(mean.amplitude_m / mean.true_amplitude_m - 1) * 100:+z.1f}"]
        row += [f"{math.degrees(error_rad):+z.2f}"]
    return row


def _shot_title(shot: ShotResult) -> str:
    words = [f"shot {shot.shot + 1}", *_settings(shot)]
    missing = f" ({shot.pulses_missing} missing)" if shot.pulses_missing else ""
    words.append(f"{shot.pulses_used} pulses{missing}, residual {_figure(shot.residual_m * 1e9, 3)} nm rms")
    words += [] if shot.complete else ["INCOMPLETE"]
    words += ["UNTRUSTED"] if shot.untrusted else []
    return ", ".join(words)


def _settings(of: ShotResult | RepeatMean) -> Iterator[str]:
    if of.burst_length_s is not None:
        yield f"T_b = {of.burst_length_s * 1e6:g} us"
    if of.force_fraction is not None:
        yield f"F = {of.force_fraction:g} F_0"
    if of.pulse_rate_hz is not None:
        yield f"f_prf = {of.pulse_rate_hz:g} Hz"
    if of.window_length_s is not None:
        yield f"T_s = {of.window_length_s * 1e3:g} ms"
    if of.lateral_offset_m:
        yield f"{of.lateral_offset_m * 1e3:g} mm beside the push"
    if of.axial_offset_m:
        yield f"{of.axial_offset_m * 1e3:+g} mm deep"
    yield from (f"{name} = {value:g}" for name, value in of.swept.items())


def _row(estimate: Estimate, known: bool, corrected: bool) -> list[str]:
    row, peak = [f"{estimate.frequency_hz:g}"], estimate.headline
    if corrected:
        row += _polar(peak.amplitude_m, peak.amplitude_uncertainty_m)
        row += _angle(peak.phase_rad, peak.phase_uncertainty_rad)
    row += _polar(estimate.amplitude_m, estimate.amplitude_uncertainty_m)
    row += [*_angle(estimate.phase_rad, estimate.phase_uncertainty_rad), f"{estimate.snr_db:z.1f}"]
    if known:
        row.append(_or_dash(estimate.true_amplitude_m, 1e9, ".4g"))
        row.append(_or_dash(estimate.corrected_amplitude_error, 100, "+z.1f"))
        row.append(_or_dash(estimate.corrected_phase_error_rad, 180 / math.pi, "+z.2f"))
    return row


def _budget_line(shot: ShotResult) -> str:
    """Return where the uncertainty of the strongest frequency of ``shot`` comes from, largest source first."""
    lead = max(shot.estimates, key=lambda item: item.amplitude_m)
    parts = sorted(lead.budget, key=lambda each: _share(each, lead), reverse=True)
    words = [
        f"{each.source} {_figure(each.amplitude_m * 1e9)} nm"
        + (f" {_figure(math.degrees(each.phase_rad))} deg" if each.phase_rad else "")
        for each in parts
        if _share(each, lead) >= LEAST_SHARE
    ]
    return f"u at {lead.frequency_hz:g} Hz: {', '.join(words)}"


def _share(component: Component, estimate: Estimate) -> float:
    """Return the larger of the shares that ``component`` has in the variances of amplitude and phase."""
    whole = estimate.headline
    pairs = (
        (component.amplitude_m, whole.amplitude_uncertainty_m),
        (component.phase_rad, whole.phase_uncertainty_rad),
    )
    return max((part / u) ** 2 if u > 0 and math.isfinite(u) else 0.0 for part, u in pairs)


def _legend(result: Result) -> str:
    if not any(item.headline.corrected for shot in result.shots for item in shot.estimates):
        return "u: by the fit; SNR: amplitude over u; no [beams] says how much of the peak displacement is tracked"
    return (
        "peak: corrected for the averaging over the beams, u combined from all sources\n"
        "tracked: as it is, u by the fit (noise, and aliasing where it knows it); SNR: tracked amplitude over that u"
    )


def _polar(amplitude_m: float, uncertainty_m: float) -> list[str]:
    return [_figure(amplitude_m * 1e9, 4), _figure(uncertainty_m * 1e9)]


def _angle(phase_rad: float, uncertainty_rad: float) -> list[str]:
    return [f"{math.degrees(phase_rad):z.2f}", f"{math.degrees(uncertainty_rad):.2f}"]


def _figure(value: float, digits: int = 2) -> str:
    """Return ``value`` with that many digits, without an exponent where a reader does not need one."""
    if 10**digits <= abs(value) < 1e6:
        return f"{value:.0f}"
    return format(value, f"#.{digits}g").removesuffix(".")


def _or_dash(value: float | None, factor: float, form: str) -> str:
    return "-" if value is None else format(value * factor, form)
