"""Tables of a run's page, with formatted cells: amplitudes in nm, phases in degrees."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

from hpe_rig.plan import Shot
from hpe_rig.prediction import conditions_of, predict
from hpe_rig.report.page_writer import PageTable
from hpe_rig.report.sweep import Sweep
from hpe_rig.result import Estimate, RepeatMean, Result, ShotResult, probability_text
from hpe_rig.scene import Estimator, Scene

MAX_ROWS = 1000
"""Rows of the table of all shots; the result file holds the others."""

Cells = dict[str, str]


def text_table(key: str, caption: str, rows: Sequence[Mapping[str, str]]) -> PageTable:
    """Return an unfolded table of formatted cells; it has no CSV, since the result file holds the full precision."""
    return PageTable(key, caption, rows, folded=False, downloadable=False)


def means_table(means: Sequence[RepeatMean]) -> PageTable:
    """Return the means over repeats with their chi-square tests."""
    rows = [
        {
            **_burst_cells(mean),
            "f_prf (Hz)": _number(mean.pulse_rate_hz),
            "T_s (ms)": _number(mean.window_length_s, 1e3),
            "repeats": f"{len(mean.shots)}",
            "f (Hz)": f"{mean.frequency_hz:g}",
            "complex mean (nm)": nm(mean.amplitude_m),
            "u (nm)": nm(mean.amplitude_uncertainty_m, 2),
            "phase (°)": deg(mean.phase_rad),
            "u (°)": deg(mean.phase_uncertainty_rad, ".2g"),
            "sd (nm)": nm(mean.amplitude_sd_m, 2),
            "sd (°)": deg(mean.phase_sd_rad, ".2g"),
            "chi-square": f"{mean.chi_square:.1f} of {mean.degrees_of_freedom}",
            "p": probability_text(mean.probability),
            "verdict": "agrees" if mean.agrees else "scatters",
        }
        for mean in means
    ]
    return text_table("means-table", "Means over repeats.", _without_empty(rows))


def _without_empty(rows: Sequence[Cells]) -> list[Cells]:
    """Return ``rows`` without the columns that hold only dashes."""
    empty = {name for name in rows[0] if all(row[name] == "–" for row in rows)} if rows else set()
    return [{name: text for name, text in row.items() if name not in empty} for row in rows]


def sweep_table(sweep: Sweep) -> PageTable:
    """Return lines over the force, ranges over another quantity, or means over repeats, a row for each curve."""
    rows: list[Cells] = []
    for curve in sweep.curves:
        row = {"f (Hz)": f"{curve.frequency_hz:g}"}
        largest_sd = {"largest sd (nm)": nm(curve.amplitude_sd_m.max(), 2)}
        if sweep.label == "repeat":
            row["mean of amplitudes (nm)"] = nm(curve.amplitude_m.mean())
            row |= {"sd (nm)": nm(curve.amplitude_m.std(ddof=1), 2), "repeats": f"{len(curve.x)}"}
        elif sweep.is_linear:
            line = curve.line
            row |= {
                "group": curve.group or "–",
                "slope (nm)": nm(line.slope) if line else "–",
                "u of slope (nm)": nm(line.slope_u, 2) if line else "–",
                "intercept (nm)": nm(line.intercept, 3) if line else "–",
                "u of intercept (nm)": nm(line.intercept_u, 2) if line else "–",
                "R²": f"{line.r_squared:.5f}" if line else "–",
                **largest_sd,
            }
        else:
            row |= {
                "group": curve.group or "–",
                "smallest amplitude (nm)": nm(curve.amplitude_m.min()),
                "largest amplitude (nm)": nm(curve.amplitude_m.max()),
                **largest_sd,
            }
        rows.append(row)
    return text_table("sweep-table", f"Over {sweep.name}.", rows)


def estimates_table(shot: ShotResult, has_truth: bool) -> PageTable:
    """Return amplitude and phase of a shot by frequency."""
    rows = [_estimate_cells(estimate, has_truth) for estimate in shot.estimates]
    return text_table("estimates-table", "Amplitude and phase by frequency.", rows)


def shots_table(result: Result, has_truth: bool) -> PageTable:
    """Return amplitude and phase of the first shots by frequency."""

    def rows() -> Iterator[Cells]:
        for shot in result.shots:
            settings = {
                "shot": f"{shot.shot}" + (" (untrusted)" if shot.untrusted else ""),
                **_burst_cells(shot),
                "repeat": f"{shot.repeat + 1}",
                **{name: f"{value:g}" for name, value in shot.swept.items()},
            }
            for estimate in shot.estimates:
                yield settings | _estimate_cells(estimate, has_truth)

    total = sum(len(shot.estimates) for shot in result.shots)
    caption = f"Table of {len(result.shots)} shots."
    if total > MAX_ROWS:
        caption += f" The first {MAX_ROWS} of {total} rows; the result file holds all."
    table = text_table("shots-table", caption, _without_empty(list(itertools.islice(rows(), MAX_ROWS))))
    return PageTable(table.key, table.caption, table.rows, folded=True, downloadable=False)


def budget_table(shot: ShotResult) -> PageTable:
    """Return the uncertainty of amplitude and phase by source and frequency."""
    rows = []
    for estimate in shot.estimates:
        row = {"f (Hz)": f"{estimate.frequency_hz:g}"}
        for component in estimate.budget:
            row[f"{component.source} (nm)"] = nm(component.amplitude_m, 2)
            row[f"{component.source} (°)"] = deg(component.phase_rad, ".2g")
        row["u (nm)"] = nm(estimate.amplitude_uncertainty_m, 2)
        row["u (°)"] = deg(estimate.phase_uncertainty_rad, ".2g")
        rows.append(row)
    # A source may be absent at some frequencies.
    columns = dict.fromkeys(name for row in rows for name in row)
    without_effect = [name for name in columns if all(row.get(name, "–") in ("0", "–") for row in rows)]
    caption = "Uncertainty by source."
    # A source with an effect on the phase alone is in the table.
    displayed = {name.rpartition(" ")[0] for name in columns if name not in without_effect}
    sources = dict.fromkeys(name.rpartition(" ")[0] for name in without_effect)
    if zero := [name for name in sources if name not in displayed]:
        caption += f" Zero at every frequency: {', '.join(zero)}."
    shown = [name for name in columns if name not in without_effect]
    return text_table("budget", caption, [{name: row.get(name, "–") for name in shown} for row in rows])


def prediction_table(scene: Scene, planned: Shot, shot: ShotResult, estimator: Estimator) -> PageTable | None:
    """Return predicted errors and the uncertainty of the fit by frequency.

    The prediction is for the amplitudes of ``shot`` and the pulses of ``planned``. None without [beams] or without a
    stated noise level.
    """
    rows = list(_prediction_cells(scene, planned, shot, estimator))
    return text_table("prediction", "Predicted errors, and the uncertainty of the fit.", rows) if rows else None


def _prediction_cells(scene: Scene, planned: Shot, shot: ShotResult, estimator: Estimator) -> Iterator[Cells]:
    """Yield the prediction of each estimate: noise by the error model, bias and speckle as in the budget."""
    for estimate in shot.estimates:
        # The noise of the phase is not defined without an amplitude.
        if not estimate.tracked_amplitude_m > 0:
            continue
        conditions = conditions_of(scene, planned, estimate.frequency_hz, estimator)
        if conditions is None:
            return
        (error,) = predict(replace(conditions, amplitude_m=estimate.tracked_amplitude_m), (estimator,)).expected
        # The components are those of the peak amplitude; the factor converts them to the tracked one.
        factor = estimate.averaging_factor or 1.0
        by_source = {component.source: component.amplitude_m * factor for component in estimate.components}
        speckle_m = math.hypot(by_source.get("speckle", 0.0), by_source.get("carrier", 0.0))
        yield {
            "f (Hz)": f"{estimate.frequency_hz:g}",
            "predicted bias (nm)": nm(estimate.tracked_amplitude_m * (1 - 1 / factor), 3),
            "predicted speckle sd (nm)": nm(speckle_m, 2),
            "predicted noise of a quadrature (nm)": nm(error.quadrature_m, 3),
            "u of the fit (nm)": nm(estimate.tracked_amplitude_uncertainty_m, 2),
            "predicted phase sd (°)": deg(error.phase_jitter_rad, ".2g"),
            "u of the fit (°)": deg(estimate.tracked_phase_uncertainty_rad, ".2g"),
        }


def run_times_table(result: Result) -> PageTable:
    """Return wall time by stage."""
    total = sum(result.run_time_s.values()) or 1.0
    rows = [
        {"stage": name, "seconds": f"{seconds:.3f}", "percentage": f"{100 * seconds / total:.0f} %"}
        for name, seconds in result.run_time_s.items()
    ]
    return text_table("run-times", "Wall time by stage.", rows)


def conditions_table(result: Result) -> PageTable | None:
    """Return the range of each condition over the run, None if none was read."""
    if not result.conditions:
        return None
    rows = [dict(condition.cells) for condition in result.conditions]
    return text_table("conditions", "Conditions before and after the shots.", rows)


def versions_table(result: Result, attributes: Mapping[str, str]) -> PageTable:
    """Return the versions of acquisition, from the run file's ``attributes``, and of this page."""
    rows = [
        {"package": name, "acquisition": attributes.get(f"version_{name}", "–"), "this page": version}
        for name, version in result.versions.items()
    ]
    return text_table("versions", "Versions.", rows)


def _burst_cells(settings: ShotResult | RepeatMean) -> Cells:
    force = settings.force_fraction
    return {"T_b (us)": _number(settings.burst_length_s, 1e6), "F / F_0": "–" if force is None else f"{force:.4g}"}


def _estimate_cells(estimate: Estimate, has_truth: bool) -> Cells:
    cells = {"f (Hz)": f"{estimate.frequency_hz:g}"}
    if estimate.corrected:
        cells |= {
            "peak (nm)": nm(estimate.amplitude_m),
            "u of peak (nm)": nm(estimate.amplitude_uncertainty_m, 2),
            "phase (°)": deg(estimate.phase_rad),
            "u of phase (°)": deg(estimate.phase_uncertainty_rad, ".2g"),
        }
    cells |= {
        "tracked (nm)": nm(estimate.tracked_amplitude_m),
        "u of tracked (nm)": nm(estimate.tracked_amplitude_uncertainty_m, 2),
        "tracked phase (°)": deg(estimate.tracked_phase_rad),
        "u of tracked phase (°)": deg(estimate.tracked_phase_uncertainty_rad, ".2g"),
        "SNR (dB)": f"{estimate.snr_db:.1f}",
    }
    if has_truth:
        cells |= {
            "true peak (nm)": nm(estimate.true_amplitude_m),
            "error (%)": _percent(estimate.amplitude_error),
            "error (°)": deg(estimate.phase_error_rad, "+.2f"),
        }
    return cells


def nm(length_m: float | None, digits: int = 4) -> str:
    """Return a length in nm without exponent; a dash for None and infinite values."""
    if length_m is None or not math.isfinite(length_m):
        return "–"
    text = f"{length_m * 1e9:.{digits}g}"
    return f"{float(text):.0f}" if "e+" in text else text


def deg(angle_rad: float | None, form: str = ".2f") -> str:
    """Return an angle in degrees; a dash for None and infinite values."""
    return "–" if angle_rad is None or not math.isfinite(angle_rad) else format(math.degrees(angle_rad), form)


def _percent(ratio: float | None) -> str:
    return "–" if ratio is None or not math.isfinite(ratio) else f"{ratio * 100:+z.1f}"


def _number(value: float | None, factor: float = 1.0) -> str:
    return "–" if value is None else f"{value * factor:g}"
