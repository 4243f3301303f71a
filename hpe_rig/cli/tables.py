"""Printed result: one sentence, then tables that fit the width of the terminal; nm, degrees, Hz."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import groupby
from typing import final

from rich.console import Console
from rich.table import Table

from hpe_rig.cli.terminal import terminal_columns, wrapped
from hpe_rig.result import (
    Component,
    Estimate,
    GateResult,
    Provenance,
    RepeatMean,
    Result,
    ShotResult,
    common_settings,
    control_text,
    estimate_at,
    frequency_error_text,
    headline_sentence,
    lead_frequency_hz,
    probability_text,
    rich_table,
    scale_of,
    setting_texts,
    shot_warnings,
    varied_settings,
)

TABLE_WIDTH = 110
FULL_WIDTH = 92
"""Width of the widest table of one shot."""
MAX_MEAN_TABLES = 2
"""Largest number of settings for which the means over repeats have a table each; else they have a line each."""
NM = 1e-9
MIN_STAGE_S = 0.005
"""Shorter stages would be printed as 0.00."""
MIN_VARIANCE_FRACTION = 0.01
"""Fraction of the variance below which a source of uncertainty is not listed."""


def print_result(result: Result, wide: bool = False) -> None:
    """Print the result: one sentence, tables, warnings, omitted steps, and the run time by stage.

    A single shot has a table of its frequencies. Several shots have means over repeats and a line each; ``wide`` prints
    every column and a table for every shot.
    """
    printer = Printer(wide)
    printer.text(f"\n{headline_sentence(result)}", bold=True)
    printer.text(f"\n{result.title}")
    printer.text(f"{result.origin}, {result.run_file}, estimator {result.estimator}")
    if result.provenance.started:
        printer.text(f"{times_text(result.provenance)}, {result.provenance.host}")
    for name, note in result.notes.items():
        printer.text(f"{name}: {note}")
    if result.simulated_specimen:
        printer.text(f"simulated specimen: {result.simulated_specimen}")
    _print_means(result, printer)
    if len(result.shots) > 1 and not wide:
        _print_shots(result, printer)
    else:
        _print_every_shot(result, printer)
    if text := control_text(result.shots):
        printer.text(text)
    _print_profile(result, printer)
    if result.conditions:
        rows = [condition.cells for condition in result.conditions]
        printer.text("\nCONDITIONS before and after the shots", bold=True)
        printer.table(rich_table(list(rows[0]), [list(row.values()) for row in rows], words=1))
    printer.text(f"\nphase: {result.phase_reference}\n{_legend(result)}")
    for warning in (*result.warnings, *shot_warnings(result.shots)):
        printer.text(f"WARNING {warning}", bold=True)
    if result.omitted:
        printer.text("omitted: " + "; ".join(f"{what} ({why})" for what, why in result.omitted))
    # The sum includes stages too short to be listed.
    total_s = sum(result.run_time_s.values())
    stages = ", ".join(f"{name} {seconds:.2f}" for name, seconds in result.run_time_s.items() if seconds >= MIN_STAGE_S)
    printer.text(f"run time: {total_s:.2f} s ({stages})")


def _print_every_shot(result: Result, printer: Printer) -> None:
    """Print a table and the sources of uncertainty of every shot."""
    for shot in result.shots:
        printer.text(f"\n{_shot_title(shot)}", bold=True)
        printer.table(_shot_table(shot, printer))
        if shot.estimates:
            printer.text(_budget_line(shot))


@final
class Printer:
    """Printer of a result, as wide as the terminal; `TABLE_WIDTH` columns without a terminal or with ``wide``.

    ``narrow``: the terminal is too narrow for the whole table, so that derived columns are left out.
    """

    def __init__(self, wide: bool = False) -> None:
        """Determine the width of the terminal."""
        self.wide = wide
        self._columns = None if wide else terminal_columns()
        self._console = wide_console() if self._columns else _console(TABLE_WIDTH)
        self.narrow = self._columns is not None and self._columns < FULL_WIDTH

    def text(self, text: str, bold: bool = False) -> None:
        """Print text, wrapped to the width of the terminal."""
        shown = wrapped(text, self._columns) if self._columns else text
        self._console.print(shown, style="bold" if bold else "", soft_wrap=True)

    def table(self, table: Table) -> None:
        """Print a table."""
        self._console.print(table)


def wide_console() -> Console:
    """Return a console as wide as the terminal, or of `TABLE_WIDTH` for a file or pipe."""
    return _console(terminal_columns() or TABLE_WIDTH)


def _console(columns: int) -> Console:
    return Console(soft_wrap=True, highlight=False, markup=False, width=columns)


def _print_means(result: Result, printer: Printer) -> None:
    """Print a table for every repeated setting, or a line each if there are more than `MAX_MEAN_TABLES`."""
    # Means of the same shots belong to one setting.
    groups = [list(group) for _, group in groupby(result.means, key=lambda mean: mean.shots)]
    if len(groups) <= MAX_MEAN_TABLES or printer.wide:
        for group in groups:
            # A title inside the table would be wrapped to the width of the table.
            printer.text(f"\n{_mean_title(group[0])}", bold=True)
            printer.table(_mean_table(group, printer))
        return
    frequency_hz = lead_frequency_hz([shot for shot in result.shots if shot.estimates])
    # One line per setting, at its frequency closest to that of the largest amplitude.
    leads = [min(group, key=lambda mean: abs(mean.frequency_hz - frequency_hz)) for group in groups]
    headers, settings = varied_settings(leads)
    printer.text(f"\nMEANS over repeats at {frequency_hz:g} Hz{common_settings(leads)}", bold=True)
    name = "peak" if leads[0].corrected else "tracked"
    scale, unit = _unit([mean.amplitude_m for mean in leads])
    headers = ["repeats\n", *headers, f"{name}\n{unit}", f"u\n{unit}", "phase\ndeg", "u\ndeg", "p\n"]
    rows = [
        (
            *(f"{len(mean.shots)}", *cells, *_polar(mean.amplitude_m, mean.amplitude_uncertainty_m, scale)),
            *(*_angle(mean.phase_rad, mean.phase_uncertainty_rad), probability_text(mean.probability)),
        )
        for mean, cells in zip(leads, settings, strict=True)
    ]
    printer.table(rich_table(headers, rows, words=0))


def _print_shots(result: Result, printer: Printer) -> None:
    """Print one line per shot, at the frequency with the largest amplitude."""
    shots = [shot for shot in result.shots if shot.estimates]
    if not shots:
        return
    frequency_hz = lead_frequency_hz(shots)
    estimates = [estimate_at(shot, frequency_hz) for shot in shots]
    varied, settings = varied_settings(shots)
    name = "peak" if estimates[0].corrected else "tracked"
    scale, unit = _unit([item.amplitude_m for item in estimates])
    headers = ["shot\n", *varied, f"{name}\n{unit}", f"u\n{unit}", "phase\ndeg", "u\ndeg", "residual\nnm"]
    rows = []
    for shot, estimate, cells in zip(shots, estimates, settings, strict=True):
        row = [f"{shot.shot}", *cells, *_polar(estimate.amplitude_m, estimate.amplitude_uncertainty_m, scale)]
        row += [*_angle(estimate.phase_rad, estimate.phase_uncertainty_rad), _digits(shot.residual_m * 1e9, 3)]
        rows.append((*row, " ".join(_flags(shot))))
    # The column of flags is printed only if a shot has any.
    if any(row[-1] for row in rows):
        table = rich_table([*headers, "\n"], rows, words=0)
    else:
        table = rich_table(headers, [row[:-1] for row in rows], words=0)
    printer.text(f"\n{len(shots)} shots at {frequency_hz:g} Hz{common_settings(shots)}", bold=True)
    printer.table(table)
    printer.text("other frequencies: --wide, --csv, or the report")


def _flags(shot: ShotResult) -> Iterator[str]:
    if shot.pulses_missing:
        yield f"{shot.pulses_missing} missing"
    if not shot.complete:
        yield "INCOMPLETE"
    if shot.untrusted:
        yield "UNTRUSTED"


def _unit(amplitudes_m: Sequence[float]) -> tuple[float, str]:
    """Return scale and unit of a column of amplitudes: nm, or um if the largest has five digits in nm."""
    scale, unit = scale_of(max(amplitudes_m, default=0.0))
    return (scale, unit) if scale > NM else (NM, "nm")


def times_text(provenance: Provenance) -> str:
    """Return begin and end of a run: 2026-03-05 14:02:11+01:00 to 14:10:07, after the shots copied from old.h5."""
    started, ended = provenance.started.replace("T", " "), provenance.ended.replace("T", " ")
    day, _, time = ended.partition(" ")
    # The date and offset of the end are omitted if they equal those of the begin.
    until = time[:8] if ended[:10] == started[:10] and ended[19:] == started[19:] else f"{day} {time}".strip()
    after = f", after the shots copied from {provenance.continues}" if provenance.continues else ""
    return (f"{started} to {until}" if ended else started) + after


def _shot_table(shot: ShotResult, printer: Printer) -> Table:
    has_truth = any(estimate.true_amplitude_m is not None for estimate in shot.estimates)
    corrected = any(estimate.corrected for estimate in shot.estimates)
    scale, unit = _unit([item.amplitude_m for item in shot.estimates])
    headers = ["f\nHz"]
    headers += [f"peak\n{unit}", f"u\n{unit}", "phase\ndeg", "u\ndeg"] if corrected else []
    headers += [f"tracked\n{unit}", f"u\n{unit}", "phase\ndeg", "u\ndeg", "SNR\ndB"]
    headers += [f"true peak\n{unit}", "error\n%", "error\ndeg"] if has_truth else []
    rows = [_row(estimate, has_truth, corrected, scale) for estimate in shot.estimates]
    if printer.narrow and corrected:
        # Without the tracked values and the truth, which --wide prints.
        columns = [0, 1, 2, 3, 4, 5, 9, *([11, 12] if has_truth else [])]
        headers, rows = [headers[column] for column in columns], [[row[column] for column in columns] for row in rows]
    return rich_table(headers, rows, words=0)


def _mean_table(means: Sequence[RepeatMean], printer: Printer) -> Table:
    has_truth = any(mean.true_amplitude_m is not None for mean in means)
    name = "peak" if means[0].corrected else "tracked"
    scale, unit = _unit([mean.amplitude_m for mean in means])
    headers = ["f\nHz", f"{name}\n{unit}", f"u\n{unit}", "phase\ndeg", "u\ndeg", f"sd\n{unit}", "sd\ndeg"]
    headers += ["chi-square\n", "p\n"]
    headers += [f"true peak\n{unit}", "error\n%", "error\ndeg"] if has_truth else []
    rows = [_mean_row(mean, has_truth, scale) for mean in means]
    if printer.narrow:
        columns = [0, 1, 2, 3, 4, 5, 6, 8, *([10, 11] if has_truth else [])]
        headers, rows = [headers[column] for column in columns], [[row[column] for column in columns] for row in rows]
    return rich_table(headers, rows, words=0)


def _print_profile(result: Result, printer: Printer) -> None:
    """Print a table over depth for every shot with gates over depth."""
    # A table has one lateral offset, shot and window.
    for _, gates in groupby(result.profile, key=lambda gate: gate.shot.lateral_offset_m):
        gates_by_shot = sorted(
            gates, key=lambda gate: (gate.shot.index, gate.shot.window_length_s or 0.0, gate.depth_m)
        )
        for _, shot_gates in groupby(gates_by_shot, key=lambda gate: (gate.shot.index, gate.shot.window_length_s)):
            profile = list(shot_gates)
            hz = lead_frequency_hz([gate.shot for gate in profile])
            words = [f"OVER DEPTH at {hz:g} Hz, shot {profile[0].shot.shot}", *setting_texts(profile[0].shot)]
            printer.text(f"\n{', '.join(words)}", bold=True)
            printer.table(_profile_table(profile))


def _profile_table(gates: Sequence[GateResult]) -> Table:
    """Return one row per gate, at the frequency with the largest amplitude; the result file holds the others."""
    hz = lead_frequency_hz([gate.shot for gate in gates])
    corrected = any(gate.shot.estimates[0].corrected for gate in gates)
    scale, unit = _unit([gate.shot.estimates[0].amplitude_m for gate in gates])
    headers = ["depth\nmm", "gate\nmm", "pulses\n"]
    headers += [f"peak\n{unit}", f"u\n{unit}", "phase\ndeg", "u\ndeg"] if corrected else []
    headers += [f"tracked\n{unit}", f"u\n{unit}", "phase\ndeg", "u\ndeg", "SNR\ndB"]
    rows = []
    for gate in gates:
        [estimate] = [item for item in gate.shot.estimates if item.frequency_hz == hz]
        where = [f"{gate.depth_m * 1e3:.4g}", f"{gate.length_m * 1e3:.3g}", str(gate.shot.pulses_used)]
        rows.append([*where, *_row(estimate, False, corrected, scale)[1:]])
    return rich_table(headers, rows, words=0)


def _mean_title(mean: RepeatMean) -> str:
    shots = mean.shots
    is_range = shots[-1] - shots[0] == len(shots) - 1
    numbers = f"{shots[0]} to {shots[-1]}" if is_range else ", ".join(map(str, shots))
    return ", ".join([f"MEAN of {len(shots)} repeats, shots {numbers}", *setting_texts(mean)])


def _mean_row(mean: RepeatMean, has_truth: bool, scale: float) -> list[str]:
    row = [f"{mean.frequency_hz:g}", *_polar(mean.amplitude_m, mean.amplitude_uncertainty_m, scale)]
    row += _angle(mean.phase_rad, mean.phase_uncertainty_rad)
    row += [_digits(mean.amplitude_sd_m / scale), _digits(math.degrees(mean.phase_sd_rad))]
    row += [f"{mean.chi_square:.1f} of {mean.degrees_of_freedom}", probability_text(mean.probability)]
    if has_truth and mean.true_amplitude_m and mean.true_phase_rad is not None:
        error_rad = math.remainder(mean.phase_rad - mean.true_phase_rad, 2 * math.pi)
        row += [f"{mean.true_amplitude_m / scale:.4g}", f"{(mean.amplitude_m / mean.true_amplitude_m - 1) * 100:+z.1f}"]
        row += [f"{math.degrees(error_rad):+z.2f}"]
    return row


def _shot_title(shot: ShotResult) -> str:
    words = [f"shot {shot.shot}", *setting_texts(shot)]
    words += [f"{shot.pulses_used} pulses", f"residual {_digits(shot.residual_m * 1e9, 3)} nm rms", *_flags(shot)]
    return ", ".join(words)


def _row(estimate: Estimate, has_truth: bool, corrected: bool, scale: float) -> list[str]:
    row = [f"{estimate.frequency_hz:g}"]
    # The columns are those of the headers of `_shot_table`.
    if corrected:
        row += _polar(estimate.amplitude_m, estimate.amplitude_uncertainty_m, scale)
        row += _angle(estimate.phase_rad, estimate.phase_uncertainty_rad)
    row += _polar(estimate.tracked_amplitude_m, estimate.tracked_amplitude_uncertainty_m, scale)
    row += [*_angle(estimate.tracked_phase_rad, estimate.tracked_phase_uncertainty_rad), f"{estimate.snr_db:z.1f}"]
    if has_truth:
        row.append(_or_dash(estimate.true_amplitude_m, 1 / scale, ".4g"))
        row.append(_or_dash(estimate.amplitude_error, 100, "+z.1f"))
        row.append(_or_dash(estimate.phase_error_rad, 180 / math.pi, "+z.2f"))
    return row


def _budget_line(shot: ShotResult) -> str:
    """Return the sources of the uncertainty of the largest amplitude of ``shot``, the largest source first."""
    lead = max(shot.estimates, key=lambda item: item.amplitude_m)
    components = sorted(lead.budget, key=lambda item: _variance_fraction(item, lead), reverse=True)
    words = [
        f"{item.source} {_digits(item.amplitude_m * 1e9)} nm"
        + (f" {_digits(math.degrees(item.phase_rad))} deg" if item.phase_rad else "")
        for item in components
        if _variance_fraction(item, lead) >= MIN_VARIANCE_FRACTION
    ]
    clock = frequency_error_text(shot)
    return f"u at {lead.frequency_hz:g} Hz: {', '.join(words)}" + (f"\n{clock}" if clock else "")


def _variance_fraction(component: Component, estimate: Estimate) -> float:
    """Return the fraction of ``component`` in the variance of the amplitude or the phase, the larger of the two."""
    amplitude = component.amplitude_m, estimate.amplitude_uncertainty_m
    phase = component.phase_rad, estimate.phase_uncertainty_rad
    # An infinite or zero uncertainty has no fractions.
    return max((value / u) ** 2 if u > 0 and math.isfinite(u) else 0.0 for value, u in (amplitude, phase))


def _legend(result: Result) -> str:
    if not any(item.corrected for shot in result.shots for item in shot.estimates):
        return "u: of the fit; SNR: amplitude over u; without [beams] the peak displacement is not corrected"
    return (
        "peak: corrected for beam averaging and predicted aliasing, u combined from all sources\n"
        "tracked: not corrected, u of the fit: noise, plus aliasing for estimators with a prior\n"
        "SNR: tracked amplitude over that u"
    )


def _polar(amplitude_m: float, uncertainty_m: float, scale: float) -> list[str]:
    return [_digits(amplitude_m / scale, 4), _digits(uncertainty_m / scale)]


def _angle(phase_rad: float, uncertainty_rad: float) -> list[str]:
    return [f"{math.degrees(phase_rad):z.2f}", f"{math.degrees(uncertainty_rad):.2f}"]


def _digits(value: float, digits: int = 2) -> str:
    """Return ``value`` with ``digits`` significant digits, without an exponent below 1e6."""
    # All digits before the point are printed, also beyond the significant ones.
    if 10**digits <= abs(value) < 1e6:
        return f"{value:.0f}"
    return format(value, f"#.{digits}g").removesuffix(".")


def _or_dash(value: float | None, factor: float, form: str) -> str:
    return "-" if value is None else format(value * factor, form)
