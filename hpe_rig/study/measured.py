"""Cases by whole measurements: every realisation is a simulated measurement of the scene, from plan to result.

Specimen, field, background, receive chain, jitter, interference, window, estimator and prior are those of
``hpe-rig run``. A draw is a new seed; its noise realisations are repeats of the shot over the same scatterers. Far
slower than the gate alone (`engine.py`).
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Mapping
from functools import partial
from importlib.metadata import version
from pathlib import Path

import numpy as np

from hpe_rig.arrays import FloatArray
from hpe_rig.measurement import prepare, record_run
from hpe_rig.result import Estimate
from hpe_rig.runs import open_run
from hpe_rig.scene import Estimator
from hpe_rig.store import StoreError
from hpe_rig.study.engine import is_precise, peak_memory_bytes
from hpe_rig.study.measured_case import MeasuredCase
from hpe_rig.study.results import CaseRecord
from hpe_rig.study.statistics import errors, phase_errors

DRAWS_PER_CHECK = 16
"""Draws between two checks of a case's standard error."""


def measure_case(case: MeasuredCase) -> CaseRecord:
    """Return the record of a case; every draw is measured into a temporary run file."""
    since = time.process_time()
    frequencies = len(case.scene.wanted_frequencies_hz)
    # (draw, noise, frequency, value): amplitude, phase, true amplitude, true phase, whether the shot has warnings
    values = {name: np.full((case.scatterers, case.noise, frequencies, 5), np.nan) for name in case.estimators}
    # A precise case stops early, checked every DRAWS_PER_CHECK draws.
    draws = 0
    while draws < case.scatterers and not is_precise(draws, case.standard_error_m, partial(_rows, case, values, draws)):
        for draw in range(draws, min(draws + DRAWS_PER_CHECK, case.scatterers)):
            _measure(case, draw, {name: table[draw] for name, table in values.items()})
        draws = draw + 1
    return {
        "case": case.key,
        "estimates": _rows(case, values, draws),
        "draws": draws,
        "noise": case.noise,
        "seconds": time.process_time() - since,
        "peak_memory_bytes": peak_memory_bytes(),
        "version": version("hpe-rig"),
    }


def _measure(case: MeasuredCase, draw: int, values: Mapping[Estimator, FloatArray]) -> None:
    """Write every estimator's values of a draw to ``values`` (noise, frequency, 5); a refused estimate stays NaN."""
    with tempfile.TemporaryDirectory() as folder:
        run = open_run(record_run(prepare(case.seeded(draw)), Path(folder) / "run.h5"))
        for name, table in values.items():
            try:
                result = run.estimate(name)
            except StoreError:
                # No shot of the run carries an estimate.
                continue
            for shot in result.shots:
                warned = bool(shot.warnings)
                table[shot.index] = [(*_values(item, case.corrected), warned) for item in shot.estimates]


def _values(item: Estimate, corrected: bool) -> tuple[float | None, ...]:
    """Return estimated and true amplitude and phase; NumPy turns None into NaN."""
    value = (item.amplitude_m, item.phase_rad) if corrected else (item.tracked_amplitude_m, item.tracked_phase_rad)
    return *value, item.true_amplitude_m, item.true_phase_rad


def _rows(case: MeasuredCase, values: Mapping[Estimator, FloatArray], draws: int) -> list[CaseRecord]:
    """Return bias and jitter of amplitude and phase, a row for each estimator and frequency."""
    rows = []
    for name, table in values.items():
        for index, hz in enumerate(case.scene.wanted_frequencies_hz):
            amplitude_m, phase_rad, true_m, true_rad, warned = np.moveaxis(table[:draws, :, index], -1, 0)
            row: CaseRecord = {"estimator": name, "frequency_hz": hz, "amplitude_true_m": _first_finite(true_m)}
            row |= errors(amplitude_m - true_m).named("amplitude", "m")
            row["phase_true_rad"] = _first_finite(true_rad)
            row |= phase_errors(phase_rad - true_rad, 0.0).named("phase", "rad")
            row["refused"] = int(np.isnan(amplitude_m).sum())
            row["warned"] = int(np.nansum(warned))
            rows.append(row)
    return rows


def _first_finite(values: FloatArray) -> float:
    """Return the first finite value, NaN if there is none; true values differ between realisations by jitter alone."""
    finite = values[np.isfinite(values)]
    return float(finite[0]) if finite.size else float("nan")
