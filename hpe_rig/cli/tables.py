"""Result as a table on the terminal: nm, degrees, Hz."""

from __future__ import annotations

import math

from rich.console import Console
from rich.table import Table

from hpe_rig.result import Estimate, Result, ShotResult, rich_table, shot_warnings

TABLE_WIDTH = 120
LEAST_S = 0.005
"""Shorter stages would show as 0.00."""


def print_result(result: Result) -> None:
    """Print the table of each shot, the warnings, what was left out, and the run time by stage."""
    console = wide_console()
    source = "SIMULATED" if result.simulated else "measured"
    console.print(f"\n{result.title}", style="bold")
    console.print(f"{source}, {result.run_file}, estimator {result.estimator}")
    if result.simulated_specimen:
        console.print(f"simulated specimen: {result.simulated_specimen}")
    for shot in result.shots:
        console.print(_shot_table(shot))
    console.print(
        f"phase: {result.phase_reference}; uncertainties: standard, noise only, of corrected noise and speckle"
    )
    for warning in (*result.warnings, *shot_warnings(result.shots)):
        console.print(f"WARNING {warning}", style="bold")
    if result.omitted:
        console.print("left out: " + "; ".join(f"{what} ({why})" for what, why in result.omitted))
    total_s = sum(result.run_time_s.values())
    stages = ", ".join(f"{name} {seconds:.2f}" for name, seconds in result.run_time_s.items() if seconds >= LEAST_S)
    console.print(f"run time: {total_s:.2f} s ({stages})")


def wide_console() -> Console:
    """Return a console of at least `TABLE_WIDTH` columns: a pipe has no width, and 80 would squeeze a table."""
    return Console(soft_wrap=True, highlight=False, markup=False, width=max(TABLE_WIDTH, Console().width))


def _shot_table(shot: ShotResult) -> Table:
    known = any(estimate.true_amplitude_m is not None for estimate in shot.estimates)
    predicted = any(estimate.averaging_factor is not None for estimate in shot.estimates)
    headers = ["f\nHz", "amplitude\nnm", "u\nnm", "phase\ndeg", "u\ndeg", "SNR\ndB"]
    headers += ["true peak\nnm", "error\n%", "phase error\ndeg"] if known else []
    headers += ["averaging\npredicted", "speckle u\n%", "corrected\nnm", "u\nnm"] if predicted else []
    rows = [_row(estimate, known, predicted) for estimate in shot.estimates]
    return rich_table(headers, rows, words=0, title=_shot_title(shot))


def _shot_title(shot: ShotResult) -> str:
    words = [f"shot {shot.shot + 1}"]
    if shot.burst_length_s is not None:
        words.append(f"T_b = {shot.burst_length_s * 1e6:g} us")
    if shot.force_fraction is not None:
        words.append(f"F = {shot.force_fraction:g} F_0")
    words.append(f"{shot.pulses_used} pulses, residual {shot.residual_m * 1e9:.3g} nm rms")
    if shot.pulses_missing:
        words.append(f"{shot.pulses_missing} missing")
    return ", ".join(words)


def _row(estimate: Estimate, known: bool, predicted: bool) -> list[str]:
    degrees, degrees_u = math.degrees(estimate.phase_rad), math.degrees(estimate.phase_uncertainty_rad)
    row = [f"{estimate.frequency_hz:g}", _nm(estimate.amplitude_m), _nm(estimate.amplitude_uncertainty_m)]
    row += [f"{degrees:.2f}", f"{degrees_u:.2f}", f"{estimate.snr_db:.1f}"]
    if known:
        row.append(_or_dash(estimate.true_amplitude_m, 1e9, ".4g"))
        row.append(_or_dash(estimate.amplitude_error, 100, "+.1f"))
        row.append(_or_dash(estimate.phase_error_rad, 180 / math.pi, "+.2f"))
    if predicted:
        row += [_or_dash(estimate.averaging_factor, 1, ".3f"), _or_dash(estimate.speckle_relative, 100, ".1f")]
        row += [_or_dash(estimate.corrected_amplitude_m, 1e9, ".4g")]
        row += [_or_dash(estimate.corrected_uncertainty_m, 1e9, ".2g")]
    return row


def _nm(length_m: float) -> str:
    return f"{length_m * 1e9:.4g}"


def _or_dash(value: float | None, factor: float, form: str) -> str:
    return "-" if value is None else format(value * factor, form)
